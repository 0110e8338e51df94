//! Clean records of every kind that the blind generator makes raise no suspicion.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_blind::case::{Hides, make};
use rtec_blind::plan::Manner;
use rtec_measure::plausible::suspicions;

#[test]
fn clean_records_raise_no_suspicion() {
    let (mut cases, mut wrong) = (0, Vec::new());
    for (k, hides) in [Hides::Nothing, Hides::One, Hides::Two, Hides::Stranger].into_iter().enumerate() {
        for turn in 0..75 {
            let seed = 7_000_000 + 1000 * k as u64 + turn;
            let manner = if turn % 2 == 0 { Manner::First } else { Manner::Second };
            let dir = tempfile::tempdir().unwrap();
            let case = make(seed, hides, None, manner, dir.path()).unwrap();
            let paths = case.train.iter().chain(&case.holdout);
            let records: Vec<_> = paths.map(|p| rtec_measure::record::read(p).unwrap()).collect();
            let found = suspicions(&records);
            cases += 1;
            if !found.is_empty() {
                let said = found.iter().map(ToString::to_string).collect::<Vec<_>>();
                wrong.push(format!("seed {seed} {} {:?}: {said:?}", case.design, case.truth));
            }
        }
    }
    println!("{} of {cases} clean cases suspected: {wrong:#?}", wrong.len());
    assert!(wrong.len() * 100 <= cases, "{wrong:#?}");
}
