//! Judges a model on records.
//! It gives the residual, the share of rows in the interval, and where the model is used outside its range.

use crate::thermal::prediction_chart;
use rtec_files::date;
use rtec_files::{InputError, InputNotice};
use rtec_measure::gauge_resolution;
use rtec_measure::motion_from_positions;
use rtec_measure::plausible;
use rtec_measure::plot::Chart;
use rtec_model::machine::{FitNote, Machine, RecordRanges};
use rtec_model::record::{Column, Record};
use serde_json::{Value, json};

/// Smallest acceptable share of the rows within a 95 % interval.
const HOLDS: f64 = 0.9;

/// The results: one entry for each response of each record.
#[derive(Debug)]
pub struct ValidationResults {
    /// `{"responses", "no_better", "suspicions"}`: output of `model validate --json`.
    pub document: Value,
    /// Responses that the model predicts no better than zero does.
    pub no_better: Vec<String>,
    /// Measured, predicted and the interval over time, one for each response.
    pub charts: Vec<Chart>,
}

/// Judges a model on records that it has not seen.
///
/// # Errors
/// A record lacks an input of an effect.
pub fn validate(
    machine: &Machine,
    records: &[Record],
    say: &mut dyn FnMut(InputNotice),
) -> Result<ValidationResults, InputError> {
    let (mut found, mut no_better, mut charts) = (Vec::new(), Vec::new(), Vec::new());
    let doubts = plausible::report_suspicions(records, say);
    for (record, all) in plausible::in_figures(records, &doubts).iter().zip(records) {
        let path = record.path.display();
        let record = plausible::good_rows(record, all.rows(), say);
        let record = record.as_ref();
        for note in gauge_resolution::resolution_notes(record, true) {
            say(InputNotice::Warning(format!("{path}: {note}")));
        }
        let (prediction, notes) = motion_from_positions::predict(machine, record)?;
        for note in notes {
            say(InputNotice::Note(format!("{path}: {note}")));
        }
        for (column, (_, predicted)) in record.responses().zip(&prediction.columns) {
            let widths = machine.half_widths_um(record, &column.role);
            let no_interval = machine.fit_with_interval(&RecordRanges::of(record), &column.role).err();
            charts.push(prediction_chart(record, column, predicted, widths.as_deref()));
            let mut judged = judge(machine, record, column, predicted, widths.as_deref(), say);
            judged.figures["no_interval"] = json!(no_interval);
            if let Some(response) = judged.no_better {
                no_better.push(response);
            }
            found.push(judged.figures);
        }
        for (effect, role) in &prediction.taken_as_zero {
            say(InputNotice::Warning(format!("{path}: no {role}, taken as zero for {effect}")));
        }
        for warning in machine.out_of_range(record) {
            say(InputNotice::Warning(format!("{path}: {warning}")));
        }
    }
    for warning in machine.doubts(date::today()) {
        say(InputNotice::Warning(format!("{}: {warning}", machine.path.display())));
    }
    let mut document = json!({ "responses": found, "no_better": no_better });
    plausible::enter(&mut document, &doubts);
    Ok(ValidationResults { document, no_better, charts })
}

/// The result for one response.
struct ResponseValidation {
    figures: Value,
    no_better: Option<String>,
}

fn judge(
    machine: &Machine,
    record: &Record,
    column: &Column,
    predicted: &[f64],
    widths: Option<&[f64]>,
    say: &mut dyn FnMut(InputNotice),
) -> ResponseValidation {
    let (path, response) = (record.path.display(), column.role.to_string());
    let seen = machine.fits().iter().any(|f| f.from.iter().any(|s| s.sha256 == record.sha256));
    let n = column.data.len() as f64;
    let rms = |v: &mut dyn Iterator<Item = f64>| (v.map(|d| d * d).sum::<f64>() / n).sqrt();
    let mean = column.data.iter().sum::<f64>() / n;
    let left: Vec<f64> = column.data.iter().zip(predicted).map(|(m, p)| m - p).collect();
    let (before, after) = (rms(&mut column.data.iter().copied()), rms(&mut left.iter().copied()));
    // A model cannot predict a run's own zero (homing, the gauge's set-up).
    let zero = left.iter().sum::<f64>() / n;
    let within = |about: f64| {
        widths.map(|w| left.iter().zip(w).filter(|(v, w)| (*v - about).abs() <= **w).count() as f64 / n)
    };
    let (inside, about_zero) = (within(0.0), within(zero));
    let width = widths.map(|w| w.iter().sum::<f64>() / n);
    if let (Some(inside), Some(about)) = (inside, about_zero)
        && inside < HOLDS
        && about >= HOLDS
    {
        say(InputNotice::Note(format!(
            "{path}: {response}: what is left is {zero:+.3} µm all along, the run's own zero (homing, the gauge's set-up) or a \
             lost count: the interval is of the shape, and holds {:.1} % about it",
            100.0 * about
        )));
    }
    let no_better = (after >= before && before > 0.0).then(|| format!("{path}: {response}"));
    if let (Some(response), Some(why)) = (&no_better, why_worse(column, predicted)) {
        say(InputNotice::Warning(format!("{response}: {why}")));
    }
    let width_key =
        if FitNote::unit_of(&response) == "N" { "mean_half_width_N" } else { "mean_half_width_um" };
    let figures = json!({
        "record": record.path, "response": response, "rms": after, "rms_without_model": before,
        "sd": rms(&mut column.data.iter().map(|v| v - mean)), "mean_left": zero,
        "largest_left": left.iter().map(|v| v.abs()).fold(0.0, f64::max), width_key: width,
        "coverage": inside, "coverage_about_mean": about_zero, "fitted_on_this_record": seen,
    });
    ResponseValidation { figures, no_better }
}

/// The reason in words why a prediction does not help.
fn why_worse(measured: &Column, predicted: &[f64]) -> Option<&'static str> {
    let square = |v: &[f64]| v.iter().map(|p| p * p).sum::<f64>();
    let both = square(predicted);
    if both == 0.0 {
        return Some("the model has no effect on it");
    }
    let along = measured.data.iter().zip(predicted).map(|(m, p)| m * p).sum::<f64>();
    let (share, alike) = (along / both, along / (both * square(&measured.data)).sqrt());
    (alike < -0.8 && (-2.0..-0.5).contains(&share))
        .then_some("what is measured is the prediction with the other sign; error = actual minus nominal")
}
