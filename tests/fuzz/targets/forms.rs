//! Files in which a user describes formats, laws and conditions.
//! The first line says which.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_fuzz::checked;
use rtec_measure::{compensation_export, import, iso230};
use rtec_model::effect::Dictionary;
use rtec_model::kinematic_chain::KinematicChain;
use rtec_part::probing_program::{DialectWithTemplate, VariableValues};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new(rtec_fuzz::NAME);
    let Some(text) = rtec_fuzz::text(data) else { return };
    let Some((which, text)) = text.split_once('\n') else { return };
    match which {
        "chain" => _ = checked(KinematicChain::parse(file, text)),
        "laws" => _ = checked(Dictionary::default().add_own(file, text)),
        "conditions" => _ = checked(iso230::TestConditions::parse(file, text)),
        "export" => _ = checked(compensation_export::user_format::UserFormat::parse(file, text, 0.0)),
        "import" => _ = checked(import::UserTableFormat::parse(file, text)),
        "parameters" => {
            _ = checked(VariableValues::default().read(&rtec_fuzz::put("p.toml", text.as_bytes())))
        }
        "dialect" => {
            _ = checked({
                let dialect = rtec_fuzz::put("d.toml", text.as_bytes());
                DialectWithTemplate::read(&dialect, &dialect)
            })
        }
        _ => {}
    }
});
