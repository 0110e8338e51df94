//! Card profiles.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::profile;
use rtec_driver::profile::Place;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let Some(profile) = rtec_fuzz::checked(profile::parse(Path::new(rtec_fuzz::NAME), &text)) else { return };
    assert!(profile.size() <= (1 << 24) + 4, "registers beyond 16 MiB");
    let bits =
        |registers: &[rtec_driver::profile::Register]| registers.iter().map(|r| r.width.bits()).sum::<u32>();
    for place in profile.lines.values() {
        assert!(match *place {
            Place::Input(bit) => u32::from(bit) < bits(&profile.inputs),
            Place::Output(bit) => u32::from(bit) < bits(&profile.outputs),
        });
    }
});
