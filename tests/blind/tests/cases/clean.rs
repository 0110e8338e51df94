//! Clean records of the blind generator raise no suspicion.

#![allow(clippy::unwrap_used)] // helpers of tests count as tests

use rtec_blind::case::Hides;
use rtec_blind::class::Class;
use rtec_blind::plan::Manner;
use rtec_measure::plausible::suspicions;

/// Asserts that at most one clean case in `one_in` is suspected.
/// It makes the first `turns` seeds of each class.
fn quiet(classes: &[(Class, u64)], turns: u64, one_in: usize) {
    let (mut cases, mut wrong) = (0_usize, Vec::new());
    for (class, from) in classes {
        for turn in 0..turns {
            let seed = from + turn;
            let manner = if turn % 2 == 0 { Manner::First } else { Manner::Second };
            let dir = tempfile::tempdir().unwrap();
            let made = class.make(seed, manner, dir.path()).unwrap();
            // For a case with a mistake, its clean twin.
            let case = made.mistake.map_or(made.case, |(_, clean)| clean);
            let paths = case.train.iter().chain(&case.holdout);
            let records: Vec<_> = paths.map(|p| rtec_measure::run_record_files::read(p).unwrap()).collect();
            let found = suspicions(&records);
            cases += 1;
            if !found.is_empty() {
                let said = found.iter().map(ToString::to_string).collect::<Vec<_>>();
                wrong.push(format!("{} {seed} {} {:?}: {said:?}", class.word(), case.design, case.truth));
            }
        }
    }
    println!("{} of {cases} clean cases suspected: {wrong:#?}", wrong.len());
    assert!(wrong.len() <= usize::div_ceil(cases, one_in), "{wrong:#?}");
}

#[test]
fn clean_records_raise_no_suspicion() {
    if !test_needs::long() {
        return;
    }
    let kinds = [Hides::Nothing, Hides::One, Hides::Two, Hides::Stranger].into_iter().enumerate();
    quiet(&kinds.map(|(k, h)| (Class::Narrow(h), 7_000_000 + 1000 * k as u64)).collect::<Vec<_>>(), 75, 100);
}

/// Short runs, switched heat, and machines with a spike at reversals.
///
/// The few suspicions left are mostly about single outlying rows.
#[test]
fn clean_records_of_the_wider_kinds_raise_no_suspicion() {
    if !test_needs::long() {
        return;
    }
    let kinds = [Class::Many, Class::ManyZeros, Class::ManyRadial, Class::Heat, Class::Fast, Class::Pairs];
    quiet(&kinds.map(|c| (c, 7_100_000)), 30, 30);
}

#[test]
fn the_clean_twins_of_mistakes_raise_no_suspicion() {
    if !test_needs::long() {
        return;
    }
    quiet(&[(Class::Mistakes, 7_200_000)], 98, 100);
}
