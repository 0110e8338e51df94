//! Probing paths.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_part::probe_path::{pathfin, read_expected, read_pathfin};
use rtec_part::unit::Unit;

fuzz_target!(|data: &[u8]| {
    let file = rtec_fuzz::put("a.cdl", data);
    rtec_fuzz::checked(read_expected(&file, Unit::MM));
    let Some(records) = rtec_fuzz::checked(read_pathfin(&file, Unit::MM)) else { return };
    let written = pathfin(&records, Unit::MM);
    let again = read_pathfin(&rtec_fuzz::put("b.cdl", written.as_bytes()), Unit::MM)
        .expect("what is written is read");
    assert_eq!(pathfin(&again, Unit::MM), written);
    assert_eq!(again.len(), records.len());
});
