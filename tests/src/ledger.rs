//! The count due at every state of a corrected trace.
//! It is derived without counting the corrected trace itself.

use anyhow::{Context, bail};
use rtec_driver::trace_replay::TracePoint;
use rtec_files::InputError;

/// Sums over a corrected trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// States of the corrected trace.
    pub states: u64,
    /// Counts of the scale.
    pub scale_counts: i64,
    /// Counts that the inversions added.
    pub inserted: i64,
    /// Number of single inversions, of A or of B.
    pub inversions: u64,
    /// Insertions by phase: the scale's state, its last direction, and the sign.
    pub phases: [u64; 16],
}

impl Totals {
    /// Number of the sixteen phases with an insertion, and the fewest in any phase.
    pub fn phases_seen(&self) -> (usize, u64) {
        (self.phases.iter().filter(|n| **n > 0).count(), self.phases.iter().copied().min().unwrap_or(0))
    }
}

/// Passes each state of the MTC's trace with the count that is due there to `each`.
/// The count is that of the scale plus the counts of the inversions (NISTIR 4832, Design C). Inverting A adds where A =
/// B and subtracts elsewhere; inverting B does the opposite.
/// The XOR of the two traces shows which signals are inverted, because the gates are XOR gates. A change that the gates
/// cannot make is an error. So is one whose order within a nanosecond is unknown.
///
/// # Errors
/// Unreadable traces, states that no legal inversion explains (with their time), and errors of `each`.
pub fn walk(
    scale: impl Iterator<Item = Result<TracePoint, InputError>>,
    mtc: impl Iterator<Item = Result<TracePoint, InputError>>,
    mut each: impl FnMut(TracePoint, i64) -> anyhow::Result<()>,
) -> anyhow::Result<Totals> {
    let mut scale = scale.peekable();
    let mut totals = Totals::default();
    let mut at = scale.next().context("the scale's trace is empty")??;
    let (mut inverted, mut up) = (0, true);
    for (n, row) in mtc.enumerate() {
        let row = row?;
        let mut scale_moved = false;
        while let Some(next) = scale.next_if(|next| next.as_ref().map_or(true, |p| p.t_ns <= row.t_ns)) {
            let next = next?;
            if n > 0 && next.t_ns < row.t_ns {
                bail!("the scale's edge at {} ns is not in the MTC's trace", next.t_ns);
            }
            let Some(step) = at.state.step_to(next.state) else {
                bail!("the scale's trace has an illegal transition at {} ns", next.t_ns);
            };
            totals.scale_counts += i64::from(step);
            up = step > 0;
            scale_moved = next.t_ns == row.t_ns;
            at = next;
        }
        let now = at.state.bits() ^ row.state.bits();
        let flipped = std::mem::replace(&mut inverted, now) ^ now;
        if n == 0 {
            // The first row shows the state of the inverters, not a change.
        } else if flipped == 3 {
            bail!("at {} ns both inverters turn at once", row.t_ns);
        } else if flipped != 0 {
            if scale_moved {
                bail!("at {} ns an inverter and the scale change in one nanosecond", row.t_ns);
            }
            let a_equals_b = matches!(at.state.bits() ^ now ^ flipped, 0 | 3);
            let adds = a_equals_b == (flipped == 1);
            totals.inserted += if adds { 1 } else { -1 };
            totals.inversions += 1;
            // The first inversion of a pair: before it both inverters were alike.
            if matches!(now ^ flipped, 0 | 3) {
                totals.phases
                    [usize::from(at.state.bits()) << 2 | usize::from(up) << 1 | usize::from(adds)] += 1;
            }
        } else if !scale_moved {
            bail!("at {} ns a row of the MTC's trace changes nothing", row.t_ns);
        }
        totals.states += 1;
        each(row, totals.scale_counts + totals.inserted)?;
    }
    if let Some(rest) = scale.next() {
        bail!("the scale's edge at {} ns is not in the MTC's trace", rest?.t_ns);
    }
    Ok(totals)
}
