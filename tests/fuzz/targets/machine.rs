//! `machine.toml`, with the dictionary and the chain that it names.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let [model, dictionary, chain] = rtec_fuzz::parts(&text);
    let beside = |path: &Path| Ok(if path.ends_with("chain.toml") { chain } else { dictionary }.to_owned());
    let read =
        |text: &str| Machine::parse_from(Path::new(rtec_fuzz::NAME), text, Dictionary::default(), &beside);
    let Some(machine) = rtec_fuzz::checked(read(model)) else { return };
    let again = read(&machine.to_text()).expect("what is written is read");
    assert_eq!(format!("{:?}", machine.listed()), format!("{:?}", again.listed()));
    assert_eq!(format!("{:?}", machine.fits()), format!("{:?}", again.fits()));
    assert_eq!(machine.name(), again.name());
});
