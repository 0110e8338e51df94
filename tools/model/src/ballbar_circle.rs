//! A circular run measured by a ballbar.
//! The run's angle and the bar's length give the errors of the two axes that drive the circle.
//!
//! θ is the angle from the first axis of the plane towards the second. The axes are at (R·cos θ, R·sin θ)
//! about the circle's centre. The bar reads `e_a·cos θ + e_b·sin θ` of their errors `e_a` and `e_b` (ISO
//! 230-4; guide, "Run records").

use crate::role::{Axis, Column, Role};
use crate::statistics::median;
use std::f64::consts::{PI, TAU};

/// The circle of a run with a radial error.
#[derive(Debug, Clone, PartialEq)]
pub struct Circle {
    /// The bar's nominal length, mm.
    pub radius_mm: f64,
    /// The two axes: the angle runs from the first towards the second.
    pub plane: [Axis; 2],
    /// Where its centre is on the machine's axes, mm; `None` if not stated.
    pub centre_mm: Option<[f64; 2]>,
}

/// Columns that are computed from the angle, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ColumnsFromAngle {
    /// Share of each axis' error in the radial one: cos θ and sin θ.
    pub(crate) share: [Vec<f64>; 2],
    /// Positions, velocities and directions that the record does not log.
    pub(crate) columns: Vec<Column>,
}

/// An axis whose sine or cosine is below this reverses: its velocity there is zero.
const AT_REST: f64 = 1e-9;

impl Circle {
    /// Computes the columns of the two axes that the record does not log.
    /// Velocities need the time.
    pub(crate) fn derive(
        &self,
        angle: &[f64],
        time_s: Option<&[f64]>,
        logged: &[Column],
    ) -> ColumnsFromAngle {
        let share = [angle.iter().map(|a| a.cos()).collect(), angle.iter().map(|a| a.sin()).collect()];
        let rows: Vec<f64> = (0..angle.len()).map(|row| row as f64).collect();
        let rate = rates(angle, time_s.unwrap_or(&rows));
        let mut columns = Vec::new();
        let centre_mm = self.centre_mm.unwrap_or_default();
        let has = |role: Role| logged.iter().any(|c| c.role == role);
        for (n, axis) in self.plane.iter().enumerate() {
            let along = |row: usize| [angle[row].cos(), angle[row].sin()][n];
            // Derivative of the cosine or sine by the angle.
            let slope = |row: usize| [-angle[row].sin(), angle[row].cos()][n];
            let mut add = |of: fn(Axis) -> Role, what: &str, value: &dyn Fn(usize) -> f64| {
                let data = (0..angle.len()).map(value).collect();
                columns.push(Column::new(&format!("{what}.{axis} by the angle"), of(axis.clone()), data));
            };
            if !has(Role::Position(axis.clone())) {
                add(Role::Position, "position", &|row| centre_mm[n] + self.radius_mm * along(row));
            }
            let velocity = has(Role::Velocity(axis.clone()));
            if !velocity && time_s.is_some() {
                add(Role::Velocity, "velocity", &|row| self.radius_mm * slope(row) * rate[row]);
            }
            if !velocity && !has(Role::Direction(axis.clone())) {
                let sign = |v: f64| if v.abs() < AT_REST { 0.0 } else { v.signum() };
                add(Role::Direction, "direction", &|row| sign(slope(row)) * crate::role::sign(rate[row]));
            }
        }
        ColumnsFromAngle { share, columns }
    }
}

/// Angular velocity at every row, radians per unit of time.
/// It is the mean of the steps before and after the row. If the two differ by more than half, one of them is
/// a pause or a jump between two circles. Then the step nearer to the run's usual rate is used. If the
/// clock's steps are coarse compared with the rows, more rows are taken.
pub fn rates(angle: &[f64], time_s: &[f64]) -> Vec<f64> {
    let tick = tick(time_s);
    // Of the rows that share a time, the first is nearest to that time. The others get its rate.
    let first = |row: &usize| *row == 0 || time_s[*row] > time_s[*row - 1];
    let firsts: Vec<usize> = (0..angle.len()).filter(first).collect();
    if firsts.len() < 3 || firsts.len() == angle.len() {
        return rates_of(angle, time_s, tick);
    }
    let pick = |of: &[f64]| firsts.iter().map(|row| of[*row]).collect::<Vec<_>>();
    let own = rates_of(&pick(angle), &pick(time_s), tick);
    let ends = firsts[1..].iter().copied().chain(std::iter::once(angle.len()));
    let rows = own.into_iter().zip(firsts.iter().zip(ends));
    rows.flat_map(|(rate, (from, to))| std::iter::repeat_n(rate, to - from)).collect()
}

/// [`rates`] of rows whose times differ, by a clock of this step.
fn rates_of(angle: &[f64], time_s: &[f64], tick: Option<f64>) -> Vec<f64> {
    let near = near_rates(angle, time_s);
    let Some(tick) = tick else { return near };
    let first_s = tick / FIRST_WITHIN;
    let first = widened(angle, time_s, &near, ALIKE_NEAR, [0.0, first_s]);
    widened(angle, time_s, &first, ALIKE, [first_s, tick / RATE_WITHIN])
}

/// Rates from windows that widen to both sides until they last `enough_s`.
/// A window holds rows whose rates so far differ by no more than the share `alike`, so it ends where the axes
/// speed up or stop. A row whose window does not exceed `least_s` keeps its rate.
fn widened(
    angle: &[f64],
    time_s: &[f64],
    rate: &[f64],
    alike: f64,
    [least_s, enough_s]: [f64; 2],
) -> Vec<f64> {
    let goes_on = |row: usize, other: usize| {
        rate[other] * rate[row] > 0.0 && is_same_rate(rate[row], rate[other], alike)
    };
    (0..angle.len())
        .map(|row| {
            let (mut from, mut to, mut turned) = (row, row, 0.0);
            while time_s[to] - time_s[from] < enough_s {
                let before = from.checked_sub(1).filter(|other| goes_on(row, *other));
                let behind = Some(to + 1).filter(|other| *other < angle.len() && goes_on(row, *other));
                if before.is_none() && behind.is_none() {
                    break;
                }
                if let Some(other) = before {
                    turned += turn_rad(angle[other], angle[from]);
                    from = other;
                }
                if let Some(other) = behind {
                    turned += turn_rad(angle[to], angle[other]);
                    to = other;
                }
            }
            let h = time_s[to] - time_s[from];
            if h > least_s && to > from + 1 { turned / h } else { rate[row] }
        })
        .collect()
}

/// Largest relative error of a rate that the clock's steps may cause.
const RATE_WITHIN: f64 = 0.005;

/// The same of the first rates, which find where a feed begins and ends.
/// By two steps of the clock alone, half the feed looks like the feed.
const FIRST_WITHIN: f64 = 0.05;

/// Share by which the first rates of one feed differ.
const ALIKE: f64 = 2.0 * FIRST_WITHIN;

/// Share by which rates of one motion differ by two steps of a coarse clock.
/// A step of the clock holds one row or two, or a row holds one step or two.
const ALIKE_NEAR: f64 = 0.55;

/// Whether two rates can belong to one motion.
fn is_same_rate(a: f64, b: f64, alike: f64) -> bool {
    (a - b).abs() <= alike * a.abs().max(b.abs())
}

/// The step of a coarse clock, s.
/// All times are multiples of it, and rows are less than 100 steps apart.
pub fn tick(time_s: &[f64]) -> Option<f64> {
    let steps: Vec<f64> = time_s.windows(2).map(|w| w[1] - w[0]).filter(|h| *h > 0.0).collect();
    // The median by size. The median by order is the pause if both senses of turning are in one record.
    let usual = (!steps.is_empty()).then(|| median(steps.iter().copied()))?;
    // Clocks step by a decimal fraction of a second.
    let tick = (-1..=6)
        .map(|n| 1.0 / 10f64.powi(n))
        .find(|tick| steps.iter().all(|h| *h > 0.5 * tick && (h / tick - (h / tick).round()).abs() < 0.01))?;
    // If rows are as regular as their clock, their times are not rounded to it. Rows that share a time are
    // rounded.
    let shared = steps.len() + 1 < time_s.len();
    let rounded = shared || steps.iter().any(|h| (h - steps[0]).abs() > 0.5 * tick);
    (rounded && usual < 100.0 * tick).then_some(tick)
}

/// The signed angle from one angle to the next, the shorter way, rad.
pub fn turn_rad(from: f64, to: f64) -> f64 {
    (to - from + PI).rem_euclid(TAU) - PI
}

/// [`rates`] from only the two steps beside each row.
fn near_rates(angle: &[f64], time_s: &[f64]) -> Vec<f64> {
    let step = |from: usize| {
        let turned = turn_rad(angle[from], angle[from + 1]);
        let h = time_s[from + 1] - time_s[from];
        if h > 0.0 { turned / h } else { 0.0 }
    };
    let steps: Vec<f64> = (0..angle.len().saturating_sub(1)).map(step).collect();
    let usual = median(steps.iter().map(|s| s.abs()).filter(|s| *s > 0.0));
    let unusual = |s: f64| (s.abs() - usual).abs();
    (0..angle.len())
        .map(|row| match (row.checked_sub(1).and_then(|i| steps.get(i)), steps.get(row)) {
            (Some(a), Some(b)) if is_same_rate(*a, *b, ALIKE_NEAR) => f64::midpoint(*a, *b),
            (Some(a), Some(b)) if (unusual(*a) - unusual(*b)).abs() < 1e-3 * usual => f64::midpoint(*a, *b),
            (Some(a), Some(b)) => {
                if unusual(*a) < unusual(*b) {
                    *a
                } else {
                    *b
                }
            }
            (Some(a), None) | (None, Some(a)) => *a,
            (None, None) => 0.0,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_and_a_new_start_are_no_motion() {
        // Half a turn at 0.1 rad/s, five seconds at rest, and back; the second half starts 1.5 rad further
        // on.
        let there: Vec<f64> = (0..30).map(|i| 0.1 * f64::from(i)).collect();
        let back = there.iter().rev().map(|a| a + 1.5);
        let angle: Vec<f64> = there.iter().copied().chain(back).collect();
        let time: Vec<f64> = (0..60).map(|i| f64::from(i) + if i < 30 { 0.0 } else { 5.0 }).collect();
        for (row, r) in rates(&angle, &time).iter().enumerate() {
            let want = if row < 30 { 0.1 } else { -0.1 };
            assert!((r - want).abs() < 1e-12, "row {row}: {r}");
        }
    }

    #[test]
    fn steps_of_the_clock_are_not_in_the_rate() {
        // 0.1375 rad/s, rows 63.5 ms apart, a clock in steps of 10 ms; half way the motion turns back.
        let there = |i: i32| 0.1375 * 0.0635 * f64::from(if i < 300 { i } else { 600 - i });
        let angle: Vec<f64> = (0..600).map(there).collect();
        let time: Vec<f64> = (0..600).map(|i| (6.35 * f64::from(i)).round() * 0.01).collect();
        for (row, r) in rates(&angle, &time).iter().enumerate().filter(|(row, _)| row.abs_diff(300) > 2) {
            let want = if row < 300 { 0.1375 } else { -0.1375 };
            assert!((r / want - 1.0).abs() < 0.01, "row {row}: {r}");
        }
    }

    /// Regression: a pause between both senses of turning hid a coarse clock.
    /// The pause was taken for the usual step, and the clock for a fine one.
    #[test]
    fn a_pause_in_the_middle_hides_no_coarse_clock() {
        for pause_s in [0.0, 3.0, 60.0] {
            let at = |i: i32| 0.1375 * 0.0324 * f64::from(if i < 300 { i } else { 599 - i });
            let angle: Vec<f64> = (0..600).map(at).collect();
            let clock =
                |i: i32| ((3.24 * f64::from(i) + 100.0 * if i < 300 { 0.0 } else { pause_s }).round()) * 0.01;
            let time: Vec<f64> = (0..600).map(clock).collect();
            assert!(tick(&time).is_some_and(|t| (t - 0.01).abs() < 1e-9), "{pause_s}");
            for (row, r) in rates(&angle, &time).iter().enumerate().filter(|(row, _)| row.abs_diff(300) > 2) {
                let want = if row < 300 { 0.1375 } else { -0.1375 };
                assert!((r / want - 1.0).abs() < 0.01, "pause {pause_s}, row {row}: {r}");
            }
        }
    }

    /// Regression: rows faster than their clock had no rate, or one a third too high.
    #[test]
    fn rows_faster_than_their_clock_have_the_rate_of_the_path() {
        for row_s in [0.001, 0.004, 0.0065, 0.0099, 0.016] {
            for tick_s in [0.01, 0.1] {
                let angle: Vec<f64> = (0..8000).map(|i| 0.2778 * row_s * f64::from(i)).collect();
                let time: Vec<f64> =
                    (0..8000).map(|i| (row_s * f64::from(i) / tick_s).floor() * tick_s).collect();
                for (row, r) in rates(&angle, &time).iter().enumerate() {
                    assert!(
                        (r / 0.2778 - 1.0).abs() < 0.02,
                        "rows of {row_s} s, clock {tick_s} s, row {row}: {r}"
                    );
                }
            }
        }
    }

    /// Regression: the rate beside a start was too low by 2 %.
    /// The mean over two seconds held a part of the start.
    #[test]
    fn a_start_is_not_smeared_over_the_feed() {
        let (start_s, row_s) = (0.3, 0.0025);
        let turned = |s: f64| 0.417 * if s < start_s { 0.5 * s * s / start_s } else { s - 0.5 * start_s };
        let at = |i: i32| f64::from(i) * row_s;
        let angle: Vec<f64> = (0..3000).map(|i| turned(at(i))).collect();
        let time: Vec<f64> = (0..3000).map(|i| (at(i) / 0.01).floor() * 0.01).collect();
        for (row, r) in rates(&angle, &time).iter().enumerate().skip((1.4 * start_s / row_s) as usize) {
            assert!((r / 0.417 - 1.0).abs() < 0.01, "row {row}: {r}");
        }
    }

    #[test]
    fn a_row_at_the_turning_point_has_no_direction() {
        let angle = [0.0, 0.1, 0.2, 0.3, 0.2, 0.1, 0.0];
        let want = [0.1, 0.1, 0.1, 0.0, -0.1, -0.1, -0.1];
        let time: Vec<f64> = (0..7).map(f64::from).collect();
        assert!(rates(&angle, &time).iter().zip(want).all(|(r, w)| (r - w).abs() < 1e-12));
    }
}
