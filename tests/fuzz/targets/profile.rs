//! Card profiles.
//!
//! Nothing writes them. So the same TOML in another form must read the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::card_profile_file;
use rtec_driver::card_profile::IoBit;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let file = Path::new(rtec_fuzz::NAME);
    let profile = match card_profile_file::parse(file, &text) {
        Ok(profile) => profile,
        Err(finding) => return rtec_fuzz::placed(&finding, &text),
    };
    assert!(profile.size() <= (1 << 24) + 4, "registers beyond 16 MiB");
    let bits = |registers: &[rtec_driver::card_profile::Register]| {
        registers.iter().map(|r| r.width.bits()).sum::<u32>()
    };
    for place in profile.lines.values() {
        assert!(match *place {
            IoBit::Input(bit) => u32::from(bit) < bits(&profile.inputs),
            IoBit::Output(bit) => u32::from(bit) < bits(&profile.outputs),
        });
    }
    let Some(anew) = rtec_fuzz::said_anew(&text) else { return };
    assert_eq!(
        card_profile_file::parse(file, &anew).expect("the same in other words is read"),
        profile,
        "{anew}"
    );
});
