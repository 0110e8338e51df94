//! A batch measured on a coordinate measuring machine.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_part::batch::{Judgement, evaluate_text};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let judgement = Judgement { alpha: 0.01, least_um: 1.0 };
    let Some(batch) = rtec_fuzz::checked(evaluate_text(Path::new(rtec_fuzz::NAME), &text, None, judgement))
    else {
        return;
    };
    for p in &batch.places {
        assert!(
            p.parts > 2 && (0.0..=1.0).contains(&p.p_value) && (0.0..=1.0).contains(&p.trend_p_value),
            "{p:?}"
        );
        let figures = [p.mean_um, p.sd_um, p.interval_um[0], p.interval_um[1], p.trend_um_per_part];
        assert!(figures.iter().all(|v| v.is_finite()), "{p:?}");
    }
    batch.offers.iter().for_each(|offer| rtec_fuzz::fit(offer));
});
