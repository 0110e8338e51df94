//! Scatter of consecutive readings while the machine drifts.

use crate::gauge_resolution::step_of;
use crate::motion_from_positions::{FEWEST, beyond_cubic};

/// Readings that are used to find the gauge's resolution.
const READINGS: usize = 4096;

/// Scatter of one reading, row by row.
#[derive(Debug, Clone, Default)]
pub(super) struct Scatter {
    /// Times of the last rows of a stretch, s.
    t: Vec<f64>,
    /// Readings of those rows.
    e: Vec<f64>,
    squares: f64,
    count: usize,
    first: Vec<f64>,
}

impl Scatter {
    /// Begins a new stretch, whose rows are no neighbours of those before.
    pub(super) fn begin(&mut self) {
        self.t.clear();
        self.e.clear();
    }

    /// The next row of a stretch.
    pub(super) fn see(&mut self, t: f64, e: f64) {
        if self.first.len() < READINGS {
            self.first.push(e);
        }
        if self.t.len() == FEWEST {
            self.t.remove(0);
            self.e.remove(0);
        }
        self.t.push(t);
        self.e.push(e);
        if self.t.len() == FEWEST {
            // Rows with equal times of a coarse clock count as evenly spaced.
            let rises = self.t.windows(2).all(|w| w[1] > w[0]);
            let t = if rises { &self.t[..] } else { &[0.0, 1.0, 2.0, 3.0, 4.0] };
            self.squares += beyond_cubic(t, &self.e).powi(2);
            self.count += 1;
        }
    }

    /// Standard deviation of one reading, in its unit.
    /// From neighbouring rows, and at least that of rounding; 0 if neither shows.
    pub(super) fn of_a_reading(&self) -> f64 {
        let rounding = step_of(&self.first).unwrap_or(0.0) / 12.0_f64.sqrt();
        (self.squares / self.count.max(1) as f64).sqrt().max(rounding)
    }
}
