//! Files in which a user describes formats, laws and conditions.
//! The first line says which.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_fuzz::checked;
use rtec_measure::{export, import, iso230};
use rtec_model::chain::Chain;
use rtec_model::effect::Dictionary;
use rtec_part::probing_program::{DialectWithTemplate, Parameters};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new(rtec_fuzz::NAME);
    let Some(text) = rtec_fuzz::text(data) else { return };
    let Some((which, text)) = text.split_once('\n') else { return };
    match which {
        "chain" => _ = checked(Chain::parse(file, text)),
        "laws" => _ = checked(Dictionary::default().add_own(file, text)),
        "conditions" => _ = checked(iso230::Conditions::parse(file, text)),
        "export" => _ = checked(export::user_format::UserFormat::parse(file, text, 0.0)),
        "import" => _ = checked(import::UserTableFormat::parse(file, text)),
        "parameters" => _ = checked(Parameters::default().read(&rtec_fuzz::put("p.toml", text.as_bytes()))),
        "dialect" => {
            _ = checked({
                let dialect = rtec_fuzz::put("d.toml", text.as_bytes());
                DialectWithTemplate::read(&dialect, &dialect)
            })
        }
        _ => {}
    }
});
