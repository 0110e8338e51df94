//! `rtec.toml`.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::config::Config;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    match Config::parse(Path::new(rtec_fuzz::NAME), &text) {
        Ok(config) => {
            rtec_fuzz::fit(&config.identity());
            assert!(!config.axes.is_empty() && config.engine_axes().len() == config.axes.len());
        }
        Err(findings) => {
            assert!(!findings.0.is_empty());
            findings.0.iter().for_each(|finding| rtec_fuzz::fit(&finding.to_string()));
        }
    }
});
