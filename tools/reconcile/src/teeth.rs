//! Saw teeth and square steps: shapes of no name whose turns and phase are refined.

use crate::lanes::in_a_turn;
use crate::problem::Stack;

/// Saw teeth or square steps that repeat over the time of all records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Teeth {
    pub(crate) response: usize,
    pub(crate) saw: bool,
    /// How often they repeat.
    pub(crate) turns: f64,
    /// Where in a turn the first row lies.
    pub(crate) phase: f64,
}

impl Teeth {
    /// Its column, not weighed.
    pub(crate) fn column(&self, stack: &Stack<'_>) -> Vec<f64> {
        let [lo, hi] = stack.time_s;
        let span = (hi - lo).max(1e-300);
        let mut out = vec![0.0; stack.n];
        for s in stack.segments.iter().filter(|s| s.response == self.response) {
            let (time, out) = (stack.record(s).time_s(), &mut out[s.rows.clone()]);
            for (x, t) in out.iter_mut().zip(time) {
                *x = self.turns * (t - lo) / span + self.phase;
            }
            in_a_turn(out);
            for x in out {
                *x = if self.saw { *x - 0.5 } else { f64::from(u8::from(*x < 0.5)) - 0.5 };
            }
        }
        out
    }
}
