//! Figures of a displacement over some rows, in two passes.
//! The rows are those of a column, or of a file that is read twice.

use super::{DriftFigures, SensorDrift};
use std::collections::VecDeque;

/// An hour, s.
const HOUR_S: f64 = 3600.0;

/// A row: time, displacement, temperature columns, and row index in those columns.
pub(super) type Row<'d> = (f64, f64, &'d [&'d [f64]], usize);

/// First pass: sums that the second pass needs.
#[derive(Debug, Clone, Default)]
pub(super) struct FirstPassSums {
    rows: usize,
    first_s: f64,
    last_s: f64,
    t: f64,
    e: f64,
    /// Sum and count of each sensor's valid readings; invalid ones are NaN.
    degc: Vec<(f64, usize)>,
}

impl FirstPassSums {
    pub(super) fn new(sensors: usize) -> Self {
        Self { degc: vec![(0.0, 0); sensors], ..Self::default() }
    }

    pub(super) fn see(&mut self, (t, e, degc, row): Row<'_>) {
        if self.rows == 0 {
            self.first_s = t;
        }
        self.rows += 1;
        self.last_s = t;
        self.t += t;
        self.e += e;
        for ((sum, n), v) in self.degc.iter_mut().zip(degc).filter(|(_, v)| v[row].is_finite()) {
            *sum += v[row];
            *n += 1;
        }
    }
}

/// Smallest and largest value so far.
#[derive(Debug, Clone, Copy, Default)]
struct MinMax(Option<[f64; 2]>);

impl MinMax {
    fn see(&mut self, v: f64) {
        let [low, high] = self.0.unwrap_or([v; 2]);
        self.0 = Some([low.min(v), high.max(v)]);
    }

    fn range(self) -> f64 {
        self.0.map_or(0.0, |[low, high]| high - low)
    }
}

/// Sums and numbers of the values in the first and in the last 1 % of the rows.
#[derive(Debug, Clone, Copy, Default)]
struct FirstLastSums([(f64, usize); 2]);

impl FirstLastSums {
    fn see(&mut self, v: f64, ends: [bool; 2]) {
        for ((sum, rows), _) in self.0.iter_mut().zip(ends).filter(|(_, is_there)| *is_there) {
            *sum += v;
            *rows += 1;
        }
    }

    /// Mean of the last less that of the first, each `otherwise` without a value.
    fn change(self, otherwise: [f64; 2]) -> f64 {
        let mean = |k: usize| match self.0[k] {
            (_, 0) => otherwise[k],
            (sum, rows) => sum / rows as f64,
        };
        mean(1) - mean(0)
    }
}

/// Sums of a sensor and its products with the displacement.
#[derive(Debug, Clone, Default)]
struct SecondPassSensorSums {
    mean: f64,
    /// Number of its readings.
    rows: usize,
    span: MinMax,
    ends: FirstLastSums,
    first: Option<f64>,
    last: f64,
    /// Sums of products of deviations: with time, with itself, with the displacement.
    tv: f64,
    vv: f64,
    ve: f64,
    /// Time about its mean over all rows: sum and sum of squares over its readings.
    t: [f64; 2],
    /// The same for the displacement.
    e: [f64; 2],
}

impl SecondPassSensorSums {
    fn of((sum, rows): (f64, usize)) -> Self {
        Self { mean: sum / rows as f64, rows, ..Self::default() }
    }

    fn see(&mut self, v: f64, [about_t, about_e]: [f64; 2], ends: [bool; 2]) {
        if !v.is_finite() {
            return;
        }
        self.span.see(v);
        self.first.get_or_insert(v);
        self.last = v;
        self.ends.see(v, ends);
        let about = v - self.mean;
        self.tv += about_t * about;
        self.vv += about * about;
        self.ve += about * about_e;
        for (sums, about) in [(&mut self.t, about_t), (&mut self.e, about_e)] {
            sums[0] += about;
            sums[1] += about * about;
        }
    }

    fn figures(&self) -> SensorDrift {
        // About the means over the sensor's own readings.
        let about = |[sum, squares]: [f64; 2]| squares - sum * sum / self.rows as f64;
        let (tt, ee) = (about(self.t), about(self.e));
        SensorDrift {
            range_k: self.span.range(),
            end_k: self.ends.change([self.first.unwrap_or(self.last), self.last]),
            rate_k_per_h: if tt > 0.0 { self.tv / tt * HOUR_S } else { 0.0 },
            gamma: if self.vv > 0.0 && ee > 0.0 { self.ve / (self.vv * ee).sqrt() } else { 0.0 },
        }
    }
}

/// Second pass over the same rows in the same order.
#[derive(Debug, Clone, Default)]
pub(super) struct SecondPassSums {
    of: FirstPassSums,
    seen: usize,
    /// Number of rows in 1 % of all, at least one.
    few: usize,
    mean_t: f64,
    mean_e: f64,
    first_hour: MinMax,
    all: MinMax,
    last_hour: MinMax,
    ends: FirstLastSums,
    tt: f64,
    te: f64,
    /// The rows of the last hour.
    window: VecDeque<(f64, f64)>,
    max_rate_per_h: Option<f64>,
    sensors: Vec<SecondPassSensorSums>,
}

impl SecondPassSums {
    pub(super) fn at(of: FirstPassSums) -> Self {
        let n = of.rows as f64;
        Self {
            few: (of.rows / 100).max(1),
            mean_t: of.t / n,
            mean_e: of.e / n,
            sensors: of.degc.iter().copied().map(SecondPassSensorSums::of).collect(),
            of,
            ..Self::default()
        }
    }

    pub(super) fn see(&mut self, (t, e, degc, row): Row<'_>) {
        let ends = [self.seen < self.few, self.seen >= self.of.rows - self.few];
        self.seen += 1;
        self.all.see(e);
        if t <= self.of.first_s + HOUR_S {
            self.first_hour.see(e);
        }
        if t >= self.of.last_s - HOUR_S {
            self.last_hour.see(e);
        }
        self.ends.see(e, ends);
        let (about_t, about_e) = (t - self.mean_t, e - self.mean_e);
        self.tt += about_t * about_t;
        self.te += about_t * about_e;
        self.slide(t, e);
        for (sensor, v) in self.sensors.iter_mut().zip(degc) {
            sensor.see(v[row], [about_t, about_e], ends);
        }
    }

    fn slide(&mut self, t: f64, e: f64) {
        self.window.push_back((t, e));
        while self.window.front().is_some_and(|(from_s, _)| t - from_s > HOUR_S) {
            self.window.pop_front();
        }
        if let Some((from_s, from)) = self.window.front().filter(|(from_s, _)| t - from_s >= 0.95 * HOUR_S) {
            let rate = (e - from).abs() / (t - from_s) * HOUR_S;
            self.max_rate_per_h = Some(self.max_rate_per_h.map_or(rate, |most| most.max(rate)));
        }
    }

    /// The figures; `names` are those of the sensors.
    pub(super) fn figures<'n>(&self, names: impl Iterator<Item = &'n str>) -> DriftFigures {
        let read = names.zip(&self.sensors).filter(|(_, s)| s.rows > 0);
        DriftFigures {
            d_60: self.first_hour.range(),
            d_t: self.all.range(),
            d_last_60: self.last_hour.range(),
            end: self.ends.change([0.0; 2]),
            // Slope of the straight line through the rows.
            rate_per_h: if self.tt > 0.0 { self.te / self.tt * HOUR_S } else { 0.0 },
            max_rate_per_h: self.max_rate_per_h,
            t_min: (self.of.last_s - self.of.first_s) / 60.0,
            temperatures: read.map(|(name, s)| (name.to_owned(), s.figures())).collect(),
        }
    }
}
