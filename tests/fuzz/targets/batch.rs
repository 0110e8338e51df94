//! A batch measured on a coordinate measuring machine.
//!
//! Nothing writes it. So the same rows in another form must be judged the same, and with all errors negated the
//! opposite.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_files::{CsvTable, csv};
use rtec_part::batch_evaluation::{BatchEvaluation, SignificanceLimits, evaluate_text};
use std::fmt::Write as _;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let file = Path::new(rtec_fuzz::NAME);
    let evaluated = |text: &str| {
        evaluate_text(file, text, None, SignificanceLimits { alpha: 0.01, least_um: 1.0 })
            .inspect_err(|finding| rtec_fuzz::placed(finding, text))
    };
    let Ok(batch) = evaluated(&text) else { return };
    for p in &batch.places {
        assert!(
            p.parts > 2 && (0.0..=1.0).contains(&p.p_value) && (0.0..=1.0).contains(&p.trend_p_value),
            "{p:?}"
        );
        let figures = [p.mean_um, p.sd_um, p.trend_um_per_part];
        assert!(figures.iter().chain(p.interval_um.iter().flatten()).all(|v| v.is_finite()), "{p:?}");
    }
    batch.offers.iter().for_each(|offer| rtec_fuzz::fit(offer));

    let [same, turned] = [1.0, -1.0].map(|sign| {
        let anew = written(&text, sign);
        evaluated(&anew).unwrap_or_else(|finding| panic!("{finding}\n{anew}"))
    });
    assert_eq!(format!("{same:?}"), format!("{batch:?}"));
    let means = |batch: &BatchEvaluation, sign: f64| -> Vec<_> {
        let of = |p: &rtec_part::batch_evaluation::PlaceStatistics| {
            let of_sign = |[low, high]: [f64; 2]| if sign < 0.0 { [-high, -low] } else { [low, high] };
            let interval = p.interval_um.map(of_sign);
            (
                p.mean_um * sign,
                p.sd_um,
                interval,
                p.p_value,
                p.trend_um_per_part * sign,
                p.trend_p_value,
                p.finding,
            )
        };
        batch.places.iter().map(of).collect()
    };
    assert_eq!(means(&turned, -1.0), means(&batch, 1.0));
});

/// The same rows in another form, with all errors times `sign`.
/// The columns have another order, there are comments and blanks, and errors replace nominal and measured values.
fn written(text: &str, sign: f64) -> String {
    let sheet = CsvTable::parse(Path::new(rtec_fuzz::NAME), text, &[], |_| true).expect("it was read");
    let words = |name| sheet.words(name).expect("it was read");
    let numbers = |name| sheet.optional(name).expect("it was read");
    let errors = numbers("error_um").unwrap_or_else(|| {
        let (nominal, measured) = (numbers("nominal_mm"), numbers("measured_mm"));
        let pairs = measured.into_iter().flatten().zip(nominal.into_iter().flatten());
        pairs.map(|(m, n)| (m - n) * 1e3).collect()
    });
    let angles = numbers("angle_rad");
    let mut anew = "# said anew\r\n\nerror_um, feature,part".to_owned();
    anew += if angles.is_some() { ",angle_rad\r\n" } else { "\r\n" };
    for (row, (feature, part)) in words("feature").iter().zip(words("part")).enumerate() {
        // Writing to a String does not fail.
        let _ = write!(anew, "{}, {}\t,{}", errors[row] * sign, csv::cell(feature), csv::cell(&part));
        if let Some(angles) = &angles {
            let _ = write!(anew, ",{:e}", angles[row]);
        }
        anew += " # µm\n";
    }
    anew
}
