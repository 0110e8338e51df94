//! Turns the wanted correction in micrometres into a total in counts.
//! The steps are ramp, hysteresis, limits and window.
//!
//! A total follows the axes' motion at once. Every other change is a ramp, never a jump: a sensor's value, a
//! model loaded, corrections enabled, a sensor that is good again. No step is larger than the belief window,
//! so that the engine accepts it.
//!
//! The part that depends on sensors passes a dead band first. It varies with the sensors' noise. That noise
//! must not send counts back and forth at a boundary, whether the axis rests or moves.

/// Distance beyond half an increment at which a total changes, increments.
const HYSTERESIS: f64 = 0.02;
/// Half the dead band of the sensors' part, in increments (some tenths of a µm).
const DEAD: f64 = 0.25;
/// Limit above any axis's total, in increments.
/// It keeps the conversion to counts from overflowing.
const MOST_INCREMENTS: f64 = 1e9;

/// Total of one axis and its state.
#[derive(Debug, Clone, Default)]
pub(crate) struct AxisCorrectionTotal {
    count_um: f64,
    increment_counts: i64,
    window_counts: i64,
    max_counts: i64,
    /// Rest of the ramp, µm.
    offset_um: f64,
    /// Wanted correction without the operator, µm, and as counts.
    out_um: f64,
    counts: i64,
    operator_counts: i64,
    /// The sensors' part after dead band and ramp, µm.
    slow_um: f64,
    /// The sensors' part has not reached its value yet.
    slow_left: bool,
    following: bool,
    limited: bool,
}

/// Inputs of a total at one tick.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TotalTickInputs {
    /// Correction that the sources want at the axes' positions, µm.
    pub um: f64,
    /// Part by sensors and time, in addition to `um`, µm.
    pub slow_um: f64,
    /// Total last requested of the engine, counts.
    pub requested: i64,
    /// Largest step of the ramp now, µm; 0 while the axis holds.
    pub ramp_um: f64,
    /// A source has changed; the new value is approached in a ramp.
    pub changed: bool,
    /// No source other than the operator is left.
    pub last: bool,
}

impl AxisCorrectionTotal {
    pub(crate) fn new(count_um: f64, increment_counts: i64, window_counts: i64, max_counts: i64) -> Self {
        Self {
            count_um,
            increment_counts,
            window_counts,
            max_counts: max_counts / increment_counts * increment_counts,
            ..Self::default()
        }
    }

    /// The nearest whole number of insertions, counts.
    fn rounded(&self, um: f64) -> i64 {
        let increments = um / self.count_um / self.increment_counts as f64;
        increments.round().clamp(-MOST_INCREMENTS, MOST_INCREMENTS) as i64 * self.increment_counts
    }

    /// Final total for this correction and the operator's counts, limited.
    pub(crate) fn goal(&self, um: f64) -> i64 {
        (self.rounded(um) + self.operator_counts).clamp(-self.max_counts, self.max_counts)
    }

    /// The total of [`Self::goal`], counts, without the limit.
    pub(crate) fn unlimited(&self, um: f64) -> i64 {
        self.rounded(um) + self.operator_counts
    }

    /// Stops following; the next time it follows, it starts from where it is.
    pub(crate) fn stop_following(&mut self) {
        self.following = false;
    }

    /// Sets all counters to zero after homing.
    pub(crate) fn zero(&mut self) {
        (self.operator_counts, self.following, self.counts) = (0, false, 0);
        (self.out_um, self.offset_um) = (0.0, 0.0);
    }

    /// Total to request now; none if it is already requested.
    pub(crate) fn next(&mut self, wanted: TotalTickInputs) -> Option<i64> {
        let TotalTickInputs { um, slow_um, requested, ramp_um, changed, last } = wanted;
        if !self.following {
            // It begins at the total already requested, whatever requested it.
            self.following = true;
            self.counts = requested - self.operator_counts;
            self.begin(self.counts as f64 * self.count_um, um, slow_um);
        } else if changed {
            // The part beyond the limit was never in effect.
            let limit_um = self.max_counts as f64 * self.count_um;
            self.begin(self.out_um.clamp(-limit_um, limit_um), um, slow_um);
        } else {
            self.take_slow(slow_um, ramp_um);
        }
        self.offset_um -= self.offset_um.clamp(-ramp_um, ramp_um);
        self.out_um = um + self.slow_um + self.offset_um;
        let counts = self.out_um / self.count_um;
        let mut wish = self.counts;
        if (counts - self.counts as f64).abs() > (0.5 + HYSTERESIS) * self.increment_counts as f64 {
            wish = self.rounded(self.out_um);
        } else if last && self.out_um == 0.0 {
            wish = 0;
        }
        self.counts = wish.clamp(-self.max_counts, self.max_counts);
        let bounded = self.bounded();
        self.limited = bounded != wish + self.operator_counts;
        // Catches up after a rapid in steps within the belief window.
        let window = self.window_counts;
        let next = bounded.clamp(requested.saturating_sub(window), requested.saturating_add(window));
        (next != requested).then_some(next)
    }

    /// Starts the ramp from the correction in effect to the wanted one.
    fn begin(&mut self, in_effect_um: f64, um: f64, slow_um: f64) {
        (self.slow_um, self.slow_left) = (slow_um, false);
        self.offset_um = in_effect_um - um - slow_um;
    }

    /// Follows the sensors' part outside its dead band, at the ramp's rate.
    fn take_slow(&mut self, slow_um: f64, ramp_um: f64) {
        let dead_um = DEAD * self.increment_counts as f64 * self.count_um;
        let off_um = slow_um - self.slow_um;
        let due_um = off_um - off_um.clamp(-dead_um, dead_um);
        let step_um = due_um.clamp(-ramp_um, ramp_um);
        self.slow_um += step_um;
        self.slow_left = due_um.abs() > ramp_um;
    }

    /// Whether a correction by sources other than the operator, or its ramp, is left.
    pub(crate) fn on_its_way(&self) -> bool {
        self.offset_um != 0.0 || self.counts != 0
    }

    /// The total within the limit that is approached in windows, counts.
    pub(crate) fn bounded(&self) -> i64 {
        (self.counts + self.operator_counts).clamp(-self.max_counts, self.max_counts)
    }

    /// Whether this total is final, unless the axis moves or a source changes.
    pub(crate) fn settled(&self, requested: i64) -> bool {
        self.following && self.offset_um == 0.0 && !self.slow_left && requested == self.bounded()
    }

    /// Rest of the ramp, µm, while the axis follows.
    pub(crate) fn ramp_left_um(&self) -> f64 {
        if self.following { self.offset_um } else { 0.0 }
    }

    pub(crate) fn following(&self) -> bool {
        self.following
    }

    /// The limit, counts, if the sources want more.
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

    fn wanted(um: f64, requested: i64) -> TotalTickInputs {
        TotalTickInputs { um, slow_um: 0.0, requested, ramp_um: 0.05, changed: false, last: false }
    }

    fn following() -> AxisCorrectionTotal {
        let mut total = AxisCorrectionTotal::new(1.0, 2, 10, 101);
        assert_eq!(total.next(wanted(0.0, 0)), None);
        total
    }

    #[test]
    fn a_value_that_trembles_on_a_boundary_sends_nothing_back_and_forth() {
        let mut total = following();
        assert_eq!(total.next(wanted(1.03, 0)), None, "half an increment and the hysteresis");
        assert_eq!(total.next(wanted(1.05, 0)), Some(2));
        for um in [1.0, 0.97, 1.02] {
            assert_eq!(total.next(wanted(um, 2)), None, "{um}");
        }
        assert_eq!(total.next(wanted(0.95, 2)), Some(0));
    }

    /// Noise of the sensors' part within the dead band changes nothing.
    /// A larger change is a ramp, however sudden it is.
    #[test]
    fn what_sensors_ask_for_passes_a_dead_band_and_is_a_ramp() {
        let mut total = following();
        let slow = |slow_um, requested| TotalTickInputs { slow_um, ..wanted(0.8, requested) };
        for k in 0..1000 {
            let noise_um = 0.45 * f64::from(k * 7 % 5 - 2) / 2.0;
            assert_eq!(total.next(slow(noise_um, 0)), None, "{noise_um}");
        }
        let mut requested = 0;
        let ticks = (0..10_000).find(|_| {
            requested = total.next(slow(8.0, requested)).unwrap_or(requested);
            requested == 8
        });
        assert!((100..160).contains(&ticks.unwrap()), "7.5 µm at 0.05 µm a tick: {ticks:?}");
        assert_eq!(total.goal(1e300), 100, "held at the limit, whatever is asked for");
    }

    /// The dead band is a quarter of an increment to either side for every scale.
    /// Of 0.32 µm, 0.05 µm are held back.
    #[test]
    fn the_dead_band_goes_with_the_scale() {
        let mut total = AxisCorrectionTotal::new(0.1, 2, 10, 1000);
        assert_eq!(total.next(wanted(0.0, 0)), None);
        let mut requested = 0;
        for _ in 0..100 {
            let slow = TotalTickInputs { slow_um: 0.32, ..wanted(0.0, requested) };
            requested = total.next(slow).unwrap_or(requested);
        }
        assert_eq!(requested, 2, "2.7 counts; without the dead band they were 3.2, and that is 4");
        assert!(total.settled(2), "what stays in the dead band is not on its way");
        for _ in 0..100 {
            let slow = TotalTickInputs { slow_um: 0.40, ..wanted(0.0, requested) };
            requested = total.next(slow).unwrap_or(requested);
        }
        assert_eq!(requested, 4, "3.5 counts");
    }

    /// The operator's counts are part of the total, within the limit, in µm.
    #[test]
    fn an_axis_has_settled_with_the_operators_share() {
        let mut total = AxisCorrectionTotal::new(0.1, 2, 1000, 100);
        total.set_operator(6);
        assert_eq!(total.operator(), (6, 6.0 * 0.1));
        assert_eq!(total.next(wanted(0.0, 6)), None);
        assert_eq!(total.next(wanted(0.8, 6)), Some(14));
        assert!(total.settled(14) && !total.settled(8) && !total.settled(2));
        assert_eq!((total.with_operator(6), total.with_operator(-6)), (14, 2));
        total.set_operator(98);
        assert_eq!(total.next(wanted(0.8, 14)), Some(100), "at the limit");
        assert!(total.settled(100) && !total.settled(106));
        total.set_operator(-108);
        assert_eq!(total.next(wanted(0.7, 100)), Some(-100));
        assert!(total.settled(-100) && !total.settled(100));
    }

    /// A source that wants far more than the limit is withdrawn.
    /// The way back begins at the limit, and the operator can always reduce the total.
    #[test]
    fn beyond_the_limit_nothing_piles_up() {
        let mut total = following();
        let mut requested = 0;
        for _ in 0..20 {
            requested = total.next(wanted(1e6, requested)).unwrap_or(requested);
        }
        assert_eq!((requested, total.with_operator(0), total.limited()), (100, 100, Some(100)));
        let away = TotalTickInputs { changed: true, last: true, ..wanted(0.0, requested) };
        total.next(away);
        let ticks = (0..10_000).find(|_| {
            requested =
                total.next(TotalTickInputs { last: true, ..wanted(0.0, requested) }).unwrap_or(requested);
            requested == 0
        });
        assert!(ticks.unwrap() < 2100, "100 µm at 0.05 µm a tick: {ticks:?}");
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
        assert_eq!(total.next(TotalTickInputs { changed: true, ..wanted(8.0, 0) }), None);
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
        total.stop_following();
        assert_eq!(total.next(wanted(0.0, 40)), None, "40 counts were there: a ramp takes them back");
        assert!((total.ramp_left_um() - 39.95).abs() < 1e-9);
    }

    /// The operator's counts are part of the goal.
    /// The limit applies except to the unlimited goal.
    #[test]
    fn a_goal_is_within_the_limit_and_holds_the_operators_share() {
        let mut total = AxisCorrectionTotal::new(0.5, 2, 10, 100);
        total.set_operator(6);
        assert_eq!((total.goal(4.0), total.unlimited(4.0)), (14, 14));
        assert_eq!((total.goal(70.0), total.unlimited(70.0)), (100, 146));
    }

    /// A total on its way has not settled, in either direction.
    #[test]
    fn what_is_on_its_way_has_not_settled() {
        let mut total = following();
        assert!(!total.on_its_way() && total.settled(0) && total.following());
        // A changed source: eight micrometres in a ramp, not yet a count.
        total.next(TotalTickInputs { changed: true, ..wanted(8.0, 0) });
        assert!(total.on_its_way() && !total.settled(0));
        // The sensors want more than the ramp allows at once.
        let mut total = following();
        let slow = |slow_um, ramp_um| TotalTickInputs { slow_um, ramp_um, ..wanted(0.0, 0) };
        assert_eq!(total.next(slow(8.0, 0.05)), None);
        assert!(!total.settled(0));
        // The ramp allows exactly the part beyond the dead band of half a micrometre, so nothing is left.
        let mut total = following();
        assert_eq!(total.next(slow(1.0, 0.5)), None);
        assert!(total.settled(0));
        total.stop_following();
        assert!(!total.settled(0) && !total.following(), "nobody says where it goes");
    }

    /// A ramp begins at the requested counts, less what was beyond the limit.
    #[test]
    fn a_ramp_begins_at_what_is_in_effect_in_micrometres() {
        let mut total = AxisCorrectionTotal::new(0.1, 2, 1000, 100);
        assert_eq!(total.next(TotalTickInputs { um: 0.0, ..wanted(0.0, 40) }), None);
        assert!((total.ramp_left_um() - (4.0 - 0.05)).abs() < 1e-9, "{}", total.ramp_left_um());
        let mut total = AxisCorrectionTotal::new(0.1, 2, 1000, 100);
        total.next(wanted(0.0, 0));
        assert_eq!(total.next(wanted(1e6, 0)), Some(100));
        total.next(TotalTickInputs { changed: true, ..wanted(0.0, 100) });
        assert!((total.ramp_left_um() - (10.0 - 0.05)).abs() < 1e-9, "{}", total.ramp_left_um());
    }

    #[test]
    fn only_what_is_cut_off_is_limited() {
        let mut total = following();
        total.set_operator(6);
        assert_eq!((total.next(wanted(8.0, 6)), total.limited()), (Some(14), None));
        assert_eq!((total.next(wanted(100.0, 14)), total.limited()), (Some(24), Some(100)));
    }

    /// At exactly half an increment plus the hysteresis a total stays.
    #[test]
    fn on_the_boundary_itself_a_total_stands() {
        let mut total = following();
        assert_eq!(total.next(wanted((0.5 + HYSTERESIS) * 2.0, 0)), None);
    }
}
