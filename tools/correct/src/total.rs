//! From what is wanted, in micrometres, to a total in counts: ramp, hysteresis, limits, window.
//!
//! A total follows the axis at once. A change that no motion of the axis asks for (a model loaded, corrections enabled,
//! a sensor back) is a ramp, never a jump. No step is larger than the belief window, so that the engine believes it.

/// A total changes when it is further than half an increment and this share of one off: what trembles on a boundary must
/// not send counts back and forth. While the axes move, they themselves carry it past the boundary.
const MOVING: f64 = 0.02;
/// The same while they stand: only the noise of the sensors is left, some tenths of a micrometre.
const STANDING: f64 = 0.25;

/// The counts of one axis.
#[derive(Debug, Clone)]
pub(crate) struct Total {
    count_um: f64,
    increment_counts: i64,
    window_counts: i64,
    max_counts: i64,
    /// What the ramp has still to go, µm.
    offset_um: f64,
    /// What is asked for without the operator, µm, and as counts.
    out_um: f64,
    counts: i64,
    operator_counts: i64,
    following: bool,
    limited: bool,
}

/// What bears on a total at one tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TickInputs {
    /// What the sources ask for, µm.
    pub um: f64,
    /// The total that the engine has been asked for, counts.
    pub requested: i64,
    /// How far the ramp may go now, µm; 0 while the axis holds.
    pub ramp_um: f64,
    /// A source has changed: what is new in it is approached in a ramp.
    pub changed: bool,
    /// An axis has moved since the total last changed.
    pub moved: bool,
    /// No source but the operator is left.
    pub last: bool,
}

impl Total {
    pub(crate) fn new(count_um: f64, increment_counts: i64, window_counts: i64, max_counts: i64) -> Self {
        Self {
            count_um,
            increment_counts,
            window_counts,
            max_counts: max_counts / increment_counts * increment_counts,
            offset_um: 0.0,
            out_um: 0.0,
            counts: 0,
            operator_counts: 0,
            following: false,
            limited: false,
        }
    }

    /// The nearest whole number of insertions, counts.
    fn rounded(&self, um: f64) -> i64 {
        let increments = um / self.count_um / self.increment_counts as f64;
        increments.round() as i64 * self.increment_counts
    }

    /// The total that these micrometres and the operator's counts make in the end, within the limit.
    pub(crate) fn goal(&self, um: f64) -> i64 {
        (self.rounded(um) + self.operator_counts).clamp(-self.max_counts, self.max_counts)
    }

    /// The total of [`Self::goal`], counts, without the limit.
    pub(crate) fn unlimited(&self, um: f64) -> i64 {
        self.rounded(um) + self.operator_counts
    }

    /// The axis must not follow now; when it does again, it starts from where it is.
    pub(crate) fn rest(&mut self) {
        self.following = false;
    }

    /// Homed: all counters are zero.
    pub(crate) fn zero(&mut self) {
        (self.operator_counts, self.following, self.counts) = (0, false, 0);
        (self.out_um, self.offset_um) = (0.0, 0.0);
    }

    /// The total to ask for now; none where it stands already.
    pub(crate) fn next(&mut self, wanted: TickInputs) -> Option<i64> {
        let TickInputs { um, requested, ramp_um, changed, moved, last } = wanted;
        if !self.following {
            // Where the axis is: what it was asked for before counts, wherever that came from.
            self.following = true;
            self.counts = requested - self.operator_counts;
            self.out_um = self.counts as f64 * self.count_um;
            self.offset_um = self.out_um - um;
        } else if changed {
            self.offset_um = self.out_um - um;
        }
        self.offset_um -= self.offset_um.clamp(-ramp_um, ramp_um);
        self.out_um = um + self.offset_um;
        let counts = self.out_um / self.count_um;
        let hysteresis = if moved { MOVING } else { STANDING };
        if (counts - self.counts as f64).abs() > (0.5 + hysteresis) * self.increment_counts as f64 {
            self.counts = self.rounded(self.out_um);
        } else if last && self.out_um == 0.0 {
            self.counts = 0;
        }
        let goal = self.counts + self.operator_counts;
        let bounded = goal.clamp(-self.max_counts, self.max_counts);
        self.limited = bounded != goal;
        // Catching up after a rapid, in steps that are believed.
        let next = bounded.clamp(requested - self.window_counts, requested + self.window_counts);
        (next != requested).then_some(next)
    }

    /// What the sources other than the operator asked for is still on its way back.
    pub(crate) fn on_its_way(&self) -> bool {
        self.offset_um != 0.0 || self.counts != 0
    }

    /// Nothing is on its way any more: this total stands, unless the axis moves or a source changes.
    pub(crate) fn settled(&self, requested: i64) -> bool {
        let goal = (self.counts + self.operator_counts).clamp(-self.max_counts, self.max_counts);
        self.following && self.offset_um == 0.0 && requested == goal
    }

    /// What the ramp has still to go, µm, while the axis follows.
    pub(crate) fn ramp_left_um(&self) -> f64 {
        if self.following { self.offset_um } else { 0.0 }
    }

    pub(crate) fn following(&self) -> bool {
        self.following
    }

    /// The limit, counts, where more is asked for.
    pub(crate) fn limited(&self) -> Option<i64> {
        self.limited.then_some(self.max_counts)
    }

    /// The operator's share, counts and µm.
    pub(crate) fn operator(&self) -> (i64, f64) {
        (self.operator_counts, self.operator_counts as f64 * self.count_um)
    }

    pub(crate) fn set_operator(&mut self, counts: i64) {
        self.operator_counts = counts;
    }

    /// The total with another operator's share, counts.
    pub(crate) fn with_operator(&self, operator_counts: i64) -> i64 {
        self.counts + operator_counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(um: f64, requested: i64) -> TickInputs {
        TickInputs { um, requested, ramp_um: 0.05, changed: false, moved: false, last: false }
    }

    fn following() -> Total {
        let mut total = Total::new(1.0, 2, 10, 101);
        assert_eq!(total.next(wanted(0.0, 0)), None);
        total
    }

    #[test]
    fn a_value_that_trembles_on_a_boundary_sends_nothing_back_and_forth() {
        let mut total = following();
        assert_eq!(total.next(wanted(1.4, 0)), None, "within half an increment and the hysteresis");
        assert_eq!(total.next(wanted(1.6, 0)), Some(2));
        for um in [1.0, 0.6, 1.4, 0.51] {
            assert_eq!(total.next(wanted(um, 2)), None, "{um}");
        }
        assert_eq!(total.next(wanted(0.49, 2)), Some(0));
    }

    #[test]
    fn an_axis_that_moves_is_followed_more_closely() {
        let mut total = following();
        let moved = |um, requested| TickInputs { moved: true, ..wanted(um, requested) };
        assert_eq!(total.next(moved(1.03, 0)), None);
        assert_eq!(total.next(moved(1.05, 0)), Some(2));
        assert_eq!(total.next(wanted(0.95, 2)), None, "it stands now");
        assert_eq!(total.next(moved(0.95, 2)), Some(0));
    }

    #[test]
    fn no_step_is_larger_than_the_window_and_no_total_than_the_limit() {
        let mut total = following();
        assert_eq!(total.next(wanted(500.0, 0)), Some(10));
        assert_eq!(total.next(wanted(500.0, 10)), Some(20));
        assert_eq!(total.next(wanted(500.0, 95)), Some(100), "a whole number of insertions");
        assert_eq!((total.limited(), total.next(wanted(500.0, 100))), (Some(100), None));
    }

    #[test]
    fn a_changed_source_is_a_ramp_and_motion_is_not() {
        let mut total = following();
        assert_eq!(total.next(TickInputs { changed: true, ..wanted(8.0, 0) }), None);
        let mut requested = 0;
        let steps = (0..200).filter(|_| {
            let next = total.next(wanted(8.0, requested));
            requested = next.unwrap_or(requested);
            next.is_some()
        });
        assert_eq!(steps.count(), 4, "two counts at a time");
        assert_eq!(requested, 8);
        assert_eq!(total.next(wanted(16.0, 8)), Some(16), "the axis has moved");
    }

    #[test]
    fn taken_up_again_it_starts_from_where_it_is() {
        let mut total = following();
        total.rest();
        assert_eq!(total.next(wanted(0.0, 40)), None, "40 counts were there: a ramp takes them back");
        assert!((total.ramp_left_um() - 39.95).abs() < 1e-9);
    }
}
