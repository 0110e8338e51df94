//! Charts of a fit: the sensors' merit, prediction against measurement, residuals.

use super::report::ThermalFitReport;
use crate::statistics::mean;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::record::{Column, Record, Role, span};

impl ThermalFitReport {
    /// The patent's figure 17: γ and temperature range of every sensor.
    /// Bars show γ upwards and the range downwards, best to the right. In addition a dot shows γ of the lagged difference.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let kept = self.kept.iter().map(|k| (k.sensor.clone(), [k.gamma, k.gamma_lagged, k.range_k]));
        let redundant =
            self.dropped.iter().map(|d| (format!("({})", d.sensor), [d.gamma, d.gamma_lagged, d.range_k]));
        let mut all: Vec<(String, [f64; 3])> = kept.chain(redundant).collect();
        all.sort_by(|a, b| a.1[0].abs().total_cmp(&b.1[0].abs()));
        let widest = all.iter().map(|a| a.1[2]).fold(1e-9, f64::max);
        let title = format!(
            "{}: correlation γ (up) and temperature range (down); in brackets: redundant",
            self.response
        );
        let points = |of: &dyn Fn([f64; 3]) -> f64| {
            all.iter().enumerate().map(|(i, a)| (i as f64, of(a.1))).collect::<Vec<_>>()
        };
        let mut chart = Chart::new(&title, "difference", &format!("|γ| up, range down (1 is {widest:.1} K)"));
        chart.x_names = all.iter().map(|a| a.0.clone()).collect();
        chart
            .with(Series::new("|γ|", Style::Bars, points(&|v| v[0].abs())))
            .with(Series::new("range", Style::Bars, points(&|v| -v[2] / widest)))
            .with(Series::new("|γ| behind its lag", Style::Dots, points(&|v| v[1].abs())))
    }
}

/// Measured and predicted response of a record over time.
/// It has the 95 % interval if there is one (the patent's figure 18).
#[must_use]
pub fn prediction_chart(
    record: &Record,
    response: &Column,
    predicted: &[f64],
    half_widths_um: Option<&[f64]>,
) -> Chart {
    let (name, x) = record.over_time();
    let over_time = |v: &mut dyn Iterator<Item = f64>| x.iter().copied().zip(v).collect::<Vec<(f64, f64)>>();
    let title = format!("{}: {} measured and predicted", record.file, response.role);
    let mut chart = Chart::new(&title, name, "error (µm)")
        .with(Series::new("measured", Style::Dots, over_time(&mut response.data.iter().copied())))
        .with(Series::new("predicted", Style::Line, over_time(&mut predicted.iter().copied())));
    if let Some(widths) = half_widths_um {
        let edge = |sign: f64| predicted.iter().zip(widths).map(|(p, w)| p + sign * w).collect::<Vec<_>>();
        chart = chart.with(Series::band("95 % interval", &x, &edge(-1.0), &edge(1.0)));
    }
    chart
}

/// Residual of a response before and after a fit, each less its mean.
/// A gauge's zero is arbitrary, so the mean is removed. The abscissa is the position that moves most, or time
/// if none moves.
#[must_use]
pub fn residual_chart(record: &Record, response: &Role, before_um: &[f64], after_um: &[f64]) -> Chart {
    let span = |v: &[f64]| {
        let [low, high] = span(v);
        high - low
    };
    let moves = record.columns.iter().filter(|c| matches!(c.role, Role::Position(_)) && span(&c.data) > 0.0);
    let along = moves.max_by(|a, b| span(&a.data).total_cmp(&span(&b.data)));
    let (name, x) = match along {
        Some(c) => (format!("{} (mm)", c.role), c.data.clone()),
        None => over_time(record),
    };
    let points = |v: &[f64]| {
        let m = mean(v);
        x.iter().copied().zip(v.iter().map(|v| v - m)).collect::<Vec<(f64, f64)>>()
    };
    Chart::new(&format!("{}: {response} before and after the fit", record.file), &name, "error (µm)")
        .with(Series::new("before", Style::Dots, points(before_um)))
        .with(Series::new("left", Style::Dots, points(after_um)))
}

fn over_time(record: &Record) -> (String, Vec<f64>) {
    let (name, x) = record.over_time();
    (name.to_owned(), x)
}
