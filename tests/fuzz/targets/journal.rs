//! The daemon's state file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_rt::journal::{AxisStateRecord, HoldAndFaultsRecord, Journal};
use rtec_rt::link_messages::{FaultSet, FeedHoldSource, MAX_AXES};

const OURS: &str = "machine \"fuzz\"";

fuzz_target!(|data: &[u8]| {
    // A file of the right size that begins with the input.
    let mut bytes = data.to_vec();
    if let Some((_, sized)) = data.split_first().filter(|(first, _)| **first == b'=') {
        bytes = sized.to_vec();
        bytes.resize(8192, 0);
    }
    let path = rtec_fuzz::put("state", &bytes);
    let Some((mut journal, before)) = rtec_fuzz::checked(Journal::open(&path, OURS)) else {
        assert_eq!(std::fs::read(&path).expect("it is there"), bytes, "refused and changed");
        return;
    };
    assert!(before.records.iter().flatten().flatten().all(|r| r.inverters < 4));
    // A record noted now is found next, whatever the file held before.
    let noted = [(1, 4), (3, 6)].map(|(inverters, completed)| AxisStateRecord {
        inverters,
        completed,
        faults: FaultSet::NONE,
        mtc_known: completed > 4,
    });
    noted.iter().for_each(|record| journal.record(2, *record, 1000));
    let machine = HoldAndFaultsRecord {
        held: Some(FeedHoldSource::User(1)),
        hold_output: true,
        faults: FaultSet::NONE,
    };
    journal.record_machine(machine, 1000);
    journal.place().expect("it is there already");
    drop(journal);
    let (_, after) = Journal::open(&path, OURS).expect("it is ours now");
    assert_eq!(after.records[2], [Some(noted[1]), Some(noted[0])]);
    assert_eq!(after.machine, Some(machine));
    assert!((0..MAX_AXES).filter(|n| *n != 2).all(|n| after.records[n] == before.records[n]));
});
