//! `error.cor`, and probed points.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_part::error_cor_file::{FeatureErrors, error_cor};
use rtec_part::part_errors::ProbedPoints;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new(rtec_fuzz::NAME);
    let Some(text) = rtec_fuzz::text(data) else { return };
    rtec_fuzz::checked(ProbedPoints::parse(file, &text));
    let Some(FeatureErrors::Arc(errors)) = rtec_fuzz::checked(FeatureErrors::parse(file, &text)) else {
        return;
    };
    // Rounded as in the file: micro-radians and nanometres.
    let written = error_cor(&errors);
    let Ok(FeatureErrors::Arc(again)) = FeatureErrors::parse(file, &written) else {
        assert!(errors.windows(2).any(|e| e[1].angle_rad - e[0].angle_rad < 2e-6), "{written}");
        return;
    };
    assert_eq!(error_cor(&again), written);
    assert_eq!(again.len(), errors.len());
});
