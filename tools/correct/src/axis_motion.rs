//! The axes' motion from the engine's status.
//! It gives position, velocity, acceleration and the direction of the last motion.

use crate::AxisCorrectionSettings;
use rtec_model::live_evaluation::AxisMotionState;
use rtec_rt::link_messages::{AxisStatus, CorrectorStatus};
use std::collections::VecDeque;

/// Counts beyond an increment by which an axis must come back to have reversed.
const TURNED_COUNTS: i64 = 2;
/// Number of states kept: half a second of them.
const KEPT: usize = 64;
/// Evaluations after which a drive has followed an insertion.
const SETTLED: usize = 30;
/// Number of evaluations over which velocity is taken.
const SPEED_OVER: usize = 3;

/// Recent states of the machine, and the motion of each axis computed from them.
#[derive(Debug)]
pub(crate) struct AxisMotionTracker {
    /// The engine's states that velocity is taken from, newest last.
    seen: VecDeque<CorrectorStatus>,
    turning: Vec<ReversalTracker>,
    now: Vec<AxisMotionState>,
}

/// The direction of an axis's last motion and its furthest places in it.
/// There is one place for the scale and one for the MTC's count.
#[derive(Debug, Clone, Copy, Default)]
struct ReversalTracker {
    direction: i64,
    /// None until the axis has been seen, at the start and after homing.
    furthest_counts: Option<[i64; 2]>,
    /// Furthest position of the table in its direction, whatever moved it.
    table_counts: i64,
    /// Total that the axis approaches, and its part by direction, counts.
    total_counts: i64,
    part_counts: i64,
}

impl ReversalTracker {
    /// Follows the direction of motion, ignoring the effect of our own insertions.
    /// An insertion moves the MTC's count first, and the scale once the drive has followed. An axis has
    /// therefore reversed only if both counts show it, by more than was inserted a moment ago. A position
    /// that our insertions alone may have reached is never the furthest.
    fn follow(&mut self, at_counts: [i64; 2], enough_counts: i64, own_counts: i64) {
        let Some(furthest_counts) = &mut self.furthest_counts else {
            (self.furthest_counts, self.table_counts) = (Some(at_counts), at_counts[0]);
            return;
        };
        let moved = [0, 1].map(|k| at_counts[k] - furthest_counts[k]);
        let turned = |d: i64| moved.iter().all(|m| m * d > enough_counts);
        if let Some(d) = [1, -1].into_iter().find(|d| turned(*d) && *d != self.direction) {
            (self.direction, *furthest_counts, self.table_counts) = (d, at_counts, at_counts[0]);
            return;
        }
        for (furthest, at) in furthest_counts.iter_mut().zip(at_counts) {
            let surely = at - self.direction * own_counts;
            if (surely - *furthest) * self.direction > 0 {
                *furthest = surely;
            }
        }
        let ahead = (at_counts[0] - self.table_counts) * self.direction;
        self.table_counts += ahead.max(0) * self.direction;
    }

    /// Turns an axis at rest that a correction will take back.
    ///
    /// Lost motion follows the table, whatever moves it. The total of the other direction is therefore right
    /// if the table comes back with that total too. If it comes back with only one of the two totals, neither
    /// fits, and the direction stays.
    fn turned_by_a_correction(&mut self, s: &AxisStatus, enough_counts: i64) {
        let goes_to = s.position_counts + s.in_effect - self.total_counts;
        let back =
            [goes_to, goes_to + 2 * self.part_counts].map(|p| (self.table_counts - p) * self.direction);
        if back.iter().all(|b| *b > enough_counts) {
            self.direction = -self.direction;
            self.furthest_counts = Some([s.position_counts, s.position_counts + s.in_effect]);
            self.table_counts = s.position_counts;
        }
    }
}

impl AxisMotionTracker {
    pub(crate) fn new(axes: usize) -> Self {
        Self {
            seen: VecDeque::with_capacity(KEPT),
            turning: vec![ReversalTracker::default(); axes],
            now: vec![AxisMotionState::default(); axes],
        }
    }

    /// Present motion of every axis, without its load.
    pub(crate) fn now(&self) -> &[AxisMotionState] {
        &self.now
    }

    /// Sets the total that an axis approaches, and its part by direction, counts.
    pub(crate) fn total_is(&mut self, axis: usize, total_counts: i64, part_counts: i64) {
        (self.turning[axis].total_counts, self.turning[axis].part_counts) = (total_counts, part_counts);
    }

    /// Age of the velocity, s: it is a mean over the time until now.
    pub(crate) fn speed_age_s(&self) -> f64 {
        match (self.seen.iter().rev().nth(SPEED_OVER), self.seen.back()) {
            (Some(from), Some(to)) => (to.t_ns - from.t_ns) as f64 * 0.5e-9,
            _ => 0.0,
        }
    }

    /// Forgets positions after their counters were set to zero.
    pub(crate) fn forget(&mut self) {
        self.seen.clear();
        // The direction of the last motion is still what it was.
        self.turning.iter_mut().for_each(|t| t.furthest_counts = None);
    }

    /// Position of an axis at the kept state nearest to a time, counts.
    /// The time is on the card's clock.
    pub(crate) fn position_counts_at(&self, axis: usize, t_ns: u64) -> Option<i64> {
        let nearest = self.seen.iter().min_by_key(|s| s.t_ns.abs_diff(t_ns))?;
        Some(nearest.axes[axis].position_counts)
    }

    /// Adds the latest state.
    pub(crate) fn follow(&mut self, status: &CorrectorStatus, axes: &[AxisCorrectionSettings]) {
        if self.seen.back().is_none_or(|last| last.t_ns < status.t_ns) {
            if self.seen.len() == KEPT {
                self.seen.pop_front();
            }
            self.seen.push_back(*status);
        }
        let back = |k: usize| self.seen.iter().rev().nth(k);
        let settled = back(SETTLED).or(self.seen.front());
        for (n, (axis, s)) in axes.iter().zip(status.axes()).enumerate() {
            let own_counts = settled.map_or(0, |b| s.in_effect.abs_diff(b.axes[n].in_effect)) as i64;
            self.turning[n].follow(
                [s.position_counts, s.position_counts + s.in_effect],
                axis.increment_counts + TURNED_COUNTS + own_counts,
                own_counts,
            );
            let ends = [2 * SPEED_OVER, SPEED_OVER, 0].map(back);
            let turning = &mut self.turning[n];
            let went =
                |b: &CorrectorStatus| (s.position_counts - b.axes[n].position_counts) * turning.direction;
            if ends[1].is_some_and(|b| went(b) <= 0) {
                turning.turned_by_a_correction(s, axis.increment_counts + TURNED_COUNTS);
            }
            let before = mm_s(ends[0], ends[1], n, axis.count_um);
            let velocity_mm_s = mm_s(ends[1], ends[2], n, axis.count_um);
            let between_s = match (ends[0], ends[2]) {
                (Some(a), Some(b)) => (b.t_ns - a.t_ns) as f64 * 0.5e-9,
                _ => 0.0,
            };
            self.now[n] = AxisMotionState {
                position_mm: s.position_counts as f64 * axis.count_um / 1000.0,
                velocity_mm_s,
                acceleration_mm_s2: if between_s > 0.0 { (velocity_mm_s - before) / between_s } else { 0.0 },
                direction: self.turning[n].direction as f64,
                load_n: 0.0,
            };
        }
    }
}

/// Mean velocity of an axis between two states; 0 if one is missing.
fn mm_s(from: Option<&CorrectorStatus>, to: Option<&CorrectorStatus>, axis: usize, count_um: f64) -> f64 {
    let (Some(a), Some(b)) = (from, to) else { return 0.0 };
    let dt_s = (b.t_ns - a.t_ns) as f64 * 1e-9;
    let moved = b.axes[axis].position_counts - a.axes[axis].position_counts;
    if dt_s > 0.0 { moved as f64 * count_um / 1000.0 / dt_s } else { 0.0 }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)] // rest and a direction are exact

    use super::*;

    const COUNT_UM: f64 = 0.5;
    const EVERY_NS: u64 = 10_000_000;

    fn setup() -> AxisCorrectionSettings {
        AxisCorrectionSettings {
            name: "x".to_owned(),
            count_um: COUNT_UM,
            increment_counts: 2,
            window_counts: 50,
            max_counts: 1000,
        }
    }

    /// One axis at these positions, counts, every 10 ms.
    fn seen(places_counts: impl IntoIterator<Item = i64>) -> AxisMotionTracker {
        let mut motion = AxisMotionTracker::new(1);
        for (k, counts) in places_counts.into_iter().enumerate() {
            motion.follow(&status(k as u64, counts), &[setup()]);
        }
        motion
    }

    fn status(k: u64, position_counts: i64) -> CorrectorStatus {
        let mut status = CorrectorStatus { t_ns: k * EVERY_NS, axes_used: 1, ..CorrectorStatus::default() };
        status.axes[0].position_counts = position_counts;
        status
    }

    /// While the acceleration changes, both values are means over 30 ms.
    #[test]
    fn velocity_and_acceleration_are_of_the_last_thirty_milliseconds() {
        let place = |k: i64| k * k * k;
        let motion = seen((0..20).map(place));
        let now = motion.now()[0];
        let mm_s = |from: i64, to: i64| (place(to) - place(from)) as f64 * COUNT_UM / 1000.0 / 0.03;
        assert!((now.position_mm - 6859.0 * COUNT_UM / 1000.0).abs() < 1e-9, "{now:?}");
        assert!((now.velocity_mm_s - mm_s(16, 19)).abs() < 1e-9, "{now:?}");
        let mm_s2 = (mm_s(16, 19) - mm_s(13, 16)) / 0.03;
        assert!((now.acceleration_mm_s2 - mm_s2).abs() < 1e-9, "{now:?}");
        assert!((motion.speed_age_s() - 0.015).abs() < 1e-12, "a mean is as old as the middle of its time");
    }

    /// Velocity is zero until enough states were seen, at the start and after homing.
    #[test]
    fn an_axis_that_was_just_seen_stands_as_far_as_is_known() {
        for looks in 0..4 {
            let mut motion = seen((0..looks).map(|k| 1000 * k));
            motion.forget();
            motion.follow(&status(9, 77), &[setup()]);
            let now = motion.now()[0];
            assert_eq!((now.velocity_mm_s, now.acceleration_mm_s2, motion.speed_age_s()), (0.0, 0.0, 0.0));
        }
        let after_six = seen((0..6).map(|k| 100 * k));
        assert!((after_six.now()[0].velocity_mm_s - 100.0 * COUNT_UM / 10.0).abs() < 1e-9);
        assert_eq!(after_six.now()[0].acceleration_mm_s2, 0.0, "30 ms before the last 30 ms: not yet");
    }

    /// Reading the engine's state twice does not make an axis appear at rest.
    #[test]
    fn a_state_that_is_seen_twice_does_not_slow_an_axis_down() {
        let mut motion = AxisMotionTracker::new(1);
        for k in 0..20 {
            for _ in 0..5 {
                motion.follow(&status(k, 100 * k as i64), &[setup()]);
            }
        }
        assert!((motion.now()[0].velocity_mm_s - 100.0 * COUNT_UM / 10.0).abs() < 1e-9);
        assert_eq!(motion.now()[0].acceleration_mm_s2, 0.0);
    }

    /// A capture finds its position within the last half second, at the nearest state.
    /// An earlier capture takes the oldest state.
    #[test]
    fn places_are_known_for_half_a_second_and_no_memory_grows() {
        let motion = seen((0..1000).map(|k| 7 * k));
        let at = |k: u64| motion.position_counts_at(0, k * EVERY_NS + EVERY_NS / 3);
        assert_eq!((at(999), at(950)), (Some(7 * 999), Some(7 * 950)));
        assert_eq!(at(0), Some(7 * (1000 - KEPT as i64)));
        assert_eq!(motion.seen.len(), KEPT);
        assert_eq!(AxisMotionTracker::new(1).position_counts_at(0, 0), None);
    }

    /// A correction inserted at rest moves the table and thereby reverses the axis.
    /// One that is inserted while the axis moves on does not.
    #[test]
    fn a_correction_at_rest_turns_the_axis() {
        let direction_after = |total_counts: i64, part_counts: i64, goes_on: bool| {
            let mut motion = seen((0..40).map(|k| 10 * k));
            assert_eq!(motion.now()[0].direction, 1.0);
            motion.total_is(0, total_counts, part_counts);
            for k in 40..50 {
                let state = status(k, if goes_on { 10 * k as i64 } else { 390 });
                motion.follow(&state, &[setup()]);
            }
            motion.now()[0].direction
        };
        assert_eq!((direction_after(4, 0, false), direction_after(5, 0, false)), (1.0, -1.0));
        assert_eq!((direction_after(-100, 0, false), direction_after(100, 0, true)), (1.0, 1.0));
        // With a reversal of 20 counts, the total of the other direction takes the table back too, or does
        // not.
        assert_eq!((direction_after(24, 10, false), direction_after(25, 10, false)), (1.0, -1.0));
        assert_eq!((direction_after(4, -10, false), direction_after(5, -10, false)), (1.0, -1.0));
    }

    /// An insertion hides a reversal of the axis until the drive has followed.
    /// The large reversal is ahead of the scale, so that no correction turns this axis.
    #[test]
    fn an_insertion_hides_a_turn_only_until_the_drive_has_followed() {
        let direction_after = |wait: u64, back_counts: i64| {
            let mut motion = seen((0..40).map(|k| 10 * k));
            assert_eq!(motion.now()[0].direction, 1.0);
            motion.total_is(0, 100, 200);
            for k in 40..=40 + wait {
                let back_counts = if k == 40 + wait { back_counts } else { 0 };
                let mut state = status(k, 290 - back_counts);
                state.axes[0].in_effect = 100;
                motion.follow(&state, &[setup()]);
            }
            motion.now()[0].direction
        };
        let after = SETTLED as u64;
        assert_eq!((direction_after(after - 1, 50), direction_after(after, 50)), (1.0, -1.0));
        assert_eq!(direction_after(after, 0), 1.0);
    }

    /// A reversal is a way back by more than an increment and two counts.
    #[test]
    fn a_turn_is_more_than_an_increment_and_two_counts() {
        for increment_counts in [1, 2, 6] {
            let direction_after = |back_counts: i64| {
                let mut motion = AxisMotionTracker::new(1);
                let places = (0..40).map(|k| 10 * k).chain([390 - back_counts]);
                for (k, counts) in places.enumerate() {
                    motion.follow(
                        &status(k as u64, counts),
                        &[AxisCorrectionSettings { increment_counts, ..setup() }],
                    );
                }
                motion.now()[0].direction
            };
            let enough = increment_counts + TURNED_COUNTS;
            assert_eq!(
                (direction_after(enough), direction_after(enough + 1)),
                (1.0, -1.0),
                "{increment_counts}"
            );
        }
    }
}
