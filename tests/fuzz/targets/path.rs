//! Probing paths.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{pathfin, read_expected, read_pathfin};

fuzz_target!(|data: &[u8]| {
    let file = rtec_fuzz::put("a.cdl", data);
    rtec_fuzz::checked(read_expected(&file, LengthUnit::MM));
    let Some(records) = rtec_fuzz::checked(read_pathfin(&file, LengthUnit::MM)) else { return };
    let written = pathfin(&records, LengthUnit::MM);
    let again = read_pathfin(&rtec_fuzz::put("b.cdl", written.as_bytes()), LengthUnit::MM)
        .expect("what is written is read");
    assert_eq!(pathfin(&again, LengthUnit::MM), written);
    assert_eq!(again.len(), records.len());
});
