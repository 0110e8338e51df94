//! Steps of a position record that no machine makes.
//! They are signs of a wrong column, unit or counter.

use super::PositionRecord;
use crate::clock_column;
use crate::text_file::short;

/// Speed that no axis of a machine tool exceeds, m/s.
const FASTEST_M_S: f64 = 10.0;
/// Bits of counters that wrap around.
const COUNTER_BITS: [u32; 4] = [16, 20, 24, 32];
/// Share of the range within which a jump is a wrap-around.
const NEAR_RANGE: f64 = 0.02;

/// Times that are kept to see what their clock is.
const FIRST_TIMES: usize = 1000;
/// Changes of the position from which its resolution is known.
const COARSE_CHANGES: usize = 5;

/// Greatest common step of two lengths, µm; 0 below a nanometre.
fn common_step(mut a: f64, mut b: f64) -> f64 {
    const NOTHING_UM: f64 = 1e-3;
    while b > NOTHING_UM {
        let rest = a % b;
        (a, b) = (b, if b - rest < NOTHING_UM { 0.0 } else { rest });
    }
    a
}

/// Range of a counter with this number of bits, counts.
pub(super) fn range_of(bits: u32) -> f64 {
    2_f64.powi(i32::try_from(bits).unwrap_or(0))
}

/// Steps from row to row that are impossible for a machine.
#[derive(Default)]
pub(super) struct PositionJumps {
    last: Option<(u64, f64)>,
    found: usize,
    /// The first jump: line, step in µm, speed in m/s.
    first: Option<(usize, f64, f64)>,
    /// Largest and smallest jump, and largest ordinary step, µm.
    largest_jump_um: f64,
    smallest_jump_um: f64,
    largest_step_um: f64,
    /// Resolution of the written positions, µm, and number of changes.
    written_um: f64,
    changes: usize,
    /// The first times, s, and the number of rows.
    times_s: Vec<f64>,
    rows: usize,
}

impl PositionJumps {
    pub(super) fn see(&mut self, t_ns: u64, at_um: f64, line: usize) {
        self.rows += 1;
        if self.times_s.len() < FIRST_TIMES {
            self.times_s.push(t_ns as f64 / 1e9);
        }
        let Some((from_ns, from_um)) = self.last.replace((t_ns, at_um)) else { return };
        let step_um = at_um - from_um;
        if step_um != 0.0 {
            self.changes += 1;
            self.written_um = common_step(self.written_um, step_um.abs());
        }
        // µm/ns are thousands of m/s.
        let m_s = step_um.abs() / (t_ns - from_ns) as f64 * 1e3;
        if m_s <= FASTEST_M_S {
            self.largest_step_um = self.largest_step_um.max(step_um.abs());
            return;
        }
        if self.first.is_none() {
            (self.first, self.smallest_jump_um) = (Some((line, step_um, m_s)), step_um.abs());
        }
        self.found += 1;
        self.largest_jump_um = self.largest_jump_um.max(step_um.abs());
        self.smallest_jump_um = self.smallest_jump_um.min(step_um.abs());
    }

    /// A note if the resolution of the positions is more than a count.
    pub(super) fn coarse(&self, record: &PositionRecord) -> Option<String> {
        let counts = self.written_um / record.count_um;
        let step_um = short(1e-6 * (1e6 * self.written_um).round());
        (self.changes >= COARSE_CHANGES && counts > 1.5).then(|| {
            format!(
                "positions in steps of {step_um} µm, {counts:.0} counts: the edges within a step are spread evenly over the time between \
                 two rows, where the axis may have moved otherwise"
            )
        })
    }

    /// A note if the position never changes.
    pub(super) fn no_motion_note(&self) -> Option<String> {
        let rows = self.rows;
        (self.changes == 0 && rows > 1).then(|| {
            format!(
                "the position is the same in all {rows} rows, so the trace has no edge: did the axis stand, or is the channel dead?"
            )
        })
    }

    /// A note if times in seconds are rather the days of a spreadsheet.
    pub(super) fn dates(&self) -> Option<String> {
        let (day, first_s) = (clock_column::spreadsheet_in_s(&self.times_s)?, self.times_s[0]);
        Some(format!(
            "the time begins at {first_s} s: a spreadsheet's date ({day}) in days? --time-unit d takes those"
        ))
    }

    /// Bits of the counter whose range is near all jumps.
    fn bits(&self, record: &PositionRecord) -> Option<u32> {
        let near = |um: f64, bits: u32| (um / record.count_um / range_of(bits) - 1.0).abs() < NEAR_RANGE;
        let all = |bits: &u32| near(self.largest_jump_um, *bits) && near(self.smallest_jump_um, *bits);
        COUNTER_BITS.into_iter().find(|bits| self.found > 0 && all(bits))
    }

    /// Bits of a counter that wraps around, and a note about it.
    /// None if the wrap would leave a step that is unusual in this record.
    pub(super) fn counter(&self, record: &PositionRecord) -> Option<(u32, String)> {
        let (line, ..) = self.first?;
        let bits = self.bits(record)?;
        let range_um = range_of(bits) * record.count_um;
        let left = (self.largest_jump_um - range_um).abs().max((range_um - self.smallest_jump_um).abs());
        (left <= 2.0 * self.largest_step_um + record.count_um).then(|| {
            let times = if self.found > 1 { format!(", {} times in all", self.found) } else { String::new() };
            let said = format!(
                "{}:{line}: a counter of {bits} bits begins again here{times}, and the trace goes on by what is left, as in the rows \
                 beside; --counter-bits 0 follows the file as it stands",
                record.file.display()
            );
            (bits, said)
        })
    }

    pub(super) fn jump_note(&self, record: &PositionRecord) -> Option<String> {
        let (line, step_um, m_s) = self.first?;
        let why = match self.bits(record) {
            Some(bits) => format!("a counter of {bits} bits that began again? Then --counter-bits {bits}."),
            None => "was a counter set anew? Then take the rows before it out. Is the unit another? Then --unit or --count-um."
                .to_owned(),
        };
        let more =
            if self.found > 1 { format!(", and at {} rows more", self.found - 1) } else { String::new() };
        let (file, mm) = (record.file.display(), step_um / 1e3);
        Some(format!(
            "{file}:{line}: the position jumps by {mm:+.3} mm, {m_s:.1} m/s{more}: {why} The trace goes along with it"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_in_coarse_steps_show_them() {
        for (values, step) in [
            (&[0.01, 0.03, 0.02, 0.07, 0.0, 0.05, 0.06][..], 10.0),
            (&[0.0, 0.0254, 0.0508, 0.0254, 0.1016, 0.127, 0.1016], 25.4),
            (&[0.0, 0.0123, 0.0457, 0.0211, 0.0999, 0.05, 0.0731], 0.1),
        ] {
            let mut jumps = PositionJumps::default();
            for (n, mm) in values.iter().enumerate() {
                jumps.see(n as u64 * 1_000_000, mm * 1e3, n);
            }
            assert!((jumps.written_um - step).abs() < 1e-6, "{values:?}: {}", jumps.written_um);
        }
    }
}
