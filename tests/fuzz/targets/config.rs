//! `rtec.toml`: the same TOML in another form must read the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::config::Config;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let file = Path::new(rtec_fuzz::NAME);
    match Config::parse(file, &text) {
        Ok(config) => {
            rtec_fuzz::fit(&config.identity());
            assert!(!config.axes.is_empty() && config.engine_axes().len() == config.axes.len());
            let Some(anew) = rtec_fuzz::said_anew(&text) else { return };
            assert_eq!(
                Config::parse(file, &anew).expect("the same in other words is read"),
                config,
                "{anew}"
            );
        }
        Err(findings) => {
            assert!(!findings.0.is_empty());
            for finding in &findings.0 {
                rtec_fuzz::fit(&finding.to_string());
                // Other findings are about a profile that the file names.
                if finding.file == file {
                    rtec_fuzz::placed(finding, &text);
                }
            }
        }
    }
});
