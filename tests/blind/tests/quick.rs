//! A few dozen blind cases: the whole suite is the program `rtec-blind`.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_blind::case::{Hides, make};
use rtec_blind::judge;
use rtec_blind::score::{Mark, mark};
use rtec_blind::world::Manner;

fn right(hides: Hides, seeds: std::ops::Range<u64>) -> (usize, Vec<String>) {
    let mut good = 0;
    let mut bad = Vec::new();
    for seed in seeds {
        let manner = if seed % 2 == 0 { Manner::First } else { Manner::Second };
        let dir = tempfile::tempdir().unwrap();
        let case = make(seed, hides, None, manner, dir.path()).unwrap();
        let (reply, _) = judge(&case).unwrap();
        if matches!(mark(&case, &reply), Mark::Exact | Mark::Group) {
            good += 1;
        } else {
            bad.push(format!(
                "seed {seed}: hidden {:?}, answered {} {:?}",
                case.truth, reply.verdict, reply.effects
            ));
        }
    }
    (good, bad)
}

#[test]
fn one_hidden_effect_is_named() {
    let (good, bad) = right(Hides::One, 40_000..40_016);
    assert!(good >= 15, "{bad:#?}");
}

#[test]
fn nothing_hidden_nothing_found() {
    let (good, bad) = right(Hides::Nothing, 40_100..40_110);
    assert!(good >= 9, "{bad:#?}");
}

#[test]
fn a_strange_shape_is_called_unknown() {
    let (good, bad) = right(Hides::Stranger, 40_200..40_206);
    assert!(good >= 4, "{bad:#?}");
}

#[test]
fn the_same_data_give_the_same_document() {
    let dir = tempfile::tempdir().unwrap();
    let case = make(40_300, Hides::Two, None, Manner::First, dir.path()).unwrap();
    let once = || {
        let train: Vec<_> = case.train.iter().map(|p| rtec_model::record::Record::read(p).unwrap()).collect();
        let machine = rtec_model::machine::Machine::read(&case.model).unwrap();
        rtec_reconcile::reconcile(&train, &[], &machine, &rtec_reconcile::Options::default())
            .unwrap()
            .to_json()
            .to_string()
    };
    assert_eq!(once(), once());
}
