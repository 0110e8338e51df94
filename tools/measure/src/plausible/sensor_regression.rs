//! Regression of one sensor (or error) on other sensors, applied to another run.

use rtec_least_squares::{QrFactor, add, dot};
use rtec_model::record::{Record, mean};

/// Time constants of heat that one body passes to another, s.
const LAGS_S: [f64; 2] = [600.0, 2400.0];

/// The record with lagged copies of these sensors, and all their names.
pub(super) fn with_lags(record: &Record, names: &[&str]) -> (Record, Vec<String>) {
    let mut wide = record.clone();
    let mut all: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
    for name in names {
        let own = record.temperatures().find(|c| c.name == *name);
        for (own, tau_s) in own.into_iter().flat_map(|own| LAGS_S.map(|tau_s| (own, tau_s))) {
            let mut late = own.clone();
            late.name = format!("{name} {tau_s} s late");
            late.data = lagged(&own.data, record.time_s(), tau_s);
            all.push(late.name.clone());
            wide.columns.push(late);
        }
    }
    (wide, all)
}

/// First-order lag, in equilibrium at the first row.
fn lagged(v: &[f64], t: &[f64], tau_s: f64) -> Vec<f64> {
    let mut x = v.first().copied().unwrap_or(0.0);
    let next = |i: usize| {
        let step = if i == 0 { 0.0 } else { t[i] - t[i - 1] };
        x += (v[i] - x) * (1.0 - (-step / tau_s).exp());
        x
    };
    (0..v.len()).map(next).collect()
}

/// Linear regression of a sensor or an error on sensors of a record.
pub(super) struct SensorRegression {
    constant: f64,
    slopes: Vec<f64>,
    /// Standard deviation of the residuals of the fit.
    pub(super) left: f64,
}

impl SensorRegression {
    pub(super) fn predict(&self, record: &Record, rest: &[&str]) -> Vec<f64> {
        let columns: Vec<&[f64]> = rest.iter().filter_map(|n| record.temperature(n)).collect();
        let of =
            |i: usize| self.constant + columns.iter().zip(&self.slopes).map(|(c, s)| s * c[i]).sum::<f64>();
        (0..record.rows()).map(of).collect()
    }
}

pub(super) fn sensor_regression(record: &Record, y: &[f64], rest: &[&str]) -> SensorRegression {
    let columns: Vec<&[f64]> = rest.iter().filter_map(|n| record.temperature(n)).collect();
    let means: Vec<f64> = columns.iter().map(|c| mean(c)).collect();
    let my = mean(y);
    let about: Vec<Vec<f64>> =
        columns.iter().zip(&means).map(|(c, m)| c.iter().map(|v| v - m).collect()).collect();
    // Ridge prior of a hundred usual slopes: collinear sensors share the coefficient.
    let squares: f64 = about.iter().map(|c| dot(c, c)).sum();
    let sd = (1e-4 * squares / columns.len().max(1) as f64 + 1e-9).sqrt().recip();
    let mut rest: Vec<f64> = y.iter().map(|v| v - my).collect();
    let mut factor = QrFactor::new(&rest);
    for column in &about {
        factor.push(&column.iter().map(|v| sd * v).collect::<Vec<_>>());
    }
    let slopes: Vec<f64> = factor.solve().iter().map(|v| sd * v).collect();
    for (column, slope) in about.iter().zip(&slopes) {
        add(&mut rest, -slope, column);
    }
    let left = (dot(&rest, &rest) / y.len() as f64).sqrt();
    let constant = my - slopes.iter().zip(&means).map(|(s, m)| s * m).sum::<f64>();
    SensorRegression { constant, slopes, left }
}
