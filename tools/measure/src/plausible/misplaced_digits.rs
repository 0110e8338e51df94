//! Detects single positions with a misplaced decimal point or a lost digit.
//! Other rows between the same places, or the course of the run, show where the axis was.

use super::robust_stats::{median, middle_range, steps};
use super::{MistakeKind, Suspicion};
use rtec_model::record::{Column, Record, Role};

/// Fewest rows that show the course of a run.
const FEWEST: usize = 10;
/// Factors of a decimal point misplaced by one or two digits.
const SLIPS: [f64; 4] = [10.0, 0.1, 100.0, 0.01];
/// Positions within this share of the median step are one place.
const NEAR_STEP: f64 = 0.05;
/// Positions within this share of the travel are one place.
const NEAR_TRAVEL: f64 = 0.002;
/// Largest distance of a corrected position from its neighbours' middle, as share.
const MIDDLE: f64 = 0.35;
/// Least distance of a wrong position outside its neighbours, as share.
const BESIDE: f64 = 0.5;
/// More wrong positions than one row in this many are part of how the run is made.
const ONE_IN: usize = 25;
/// Most comparisons of rows; a longer run that turns often is not checked.
const MOST_PAIRS: usize = 50_000_000;

pub(super) fn look(record: &Record, out: &mut Vec<Suspicion>) {
    if record.rows() < FEWEST {
        return;
    }
    for c in record.columns.iter().filter(|c| matches!(c.role, Role::Position(_))) {
        let way = PositionSequence { motion: motion(record, c), ..PositionSequence::of(&c.data) };
        let beside: Vec<usize> = (1..record.rows() - 1).filter(|i| way.is_beside(*i)).collect();
        if beside.len() * record.rows() > MOST_PAIRS {
            continue;
        }
        let meant = |i| Some((i, way.meant(i)?)).filter(|(i, meant)| !way.comes_there(*i, *meant));
        let found: Vec<(usize, f64)> = beside.into_iter().filter_map(meant).collect();
        let rows: Vec<usize> = found.iter().map(|f| f.0).collect();
        let Some((first, meant)) = found.first().filter(|_| rows.len() <= 1 + record.rows() / ONE_IN) else {
            continue;
        };
        let (at, n) = (c.data[*first], rows.len());
        let more = if n > 1 { format!(", as in {n} rows") } else { String::new() };
        let slip = "a slip of the decimal point, or of a digit";
        let text = format!("goes to {at} where the run goes through {meant}: {slip}{more}");
        out.push(Suspicion::new(record, &c.name, MistakeKind::Outliers, &rows, text));
    }
}

/// The positions of a run in row order.
struct PositionSequence<'p> {
    p: &'p [f64],
    /// Positions closer than this are one place, mm.
    near: f64,
    /// The run moves in sweeps: it turns in less than about a quarter of its rows.
    sweeps: bool,
    /// Times and velocities of the rows, if both are logged.
    motion: Option<[&'p [f64]; 2]>,
}

/// Times and velocities of an axis, if a record logs both.
fn motion<'r>(record: &'r Record, position: &Column) -> Option<[&'r [f64]; 2]> {
    let velocity = Role::Velocity(position.role.axis()?.clone());
    Some([record.data(&Role::Time)?, record.data(&velocity)?])
}

impl<'p> PositionSequence<'p> {
    fn of(p: &'p [f64]) -> Self {
        let own = steps(p);
        let sizes: Vec<f64> = own.iter().map(|d| d.abs()).filter(|d| *d > 0.0).collect();
        let near = (NEAR_STEP * median(sizes)).max(NEAR_TRAVEL * middle_range(p));
        let turns = own.windows(2).filter(|w| w[0] * w[1] < 0.0 && w[0].abs().min(w[1].abs()) > near);
        let sweeps = turns.count() * 4 <= p.len() + 8;
        Self { p, near, sweeps, motion: None }
    }

    fn at(&self, a: f64, b: f64) -> bool {
        (a - b).abs() <= self.near
    }

    /// Positions of the rows before and after one.
    fn around(&self, i: usize) -> [f64; 2] {
        [self.p[i - 1], self.p[i + 1]]
    }

    /// Whether the row lies farther outside its neighbours than a reversal explains.
    fn is_beside(&self, i: usize) -> bool {
        let (own, [a, b]) = (self.p[i], self.around(i));
        let (lo, hi) = (a.min(b), a.max(b));
        let before = i.checked_sub(2).map_or(0.0, |k| (a - self.p[k]).abs());
        let behind = self.p.get(i + 2).map_or(0.0, |p| (p - b).abs());
        let turns = before.min(behind);
        let off = (lo - own).max(own - hi);
        own != 0.0 && self.near > 0.0 && off > self.near.max(BESIDE * (hi - lo)).max(turns)
    }

    /// Whether the logged velocity supports the written position rather than `meant`.
    /// The neighbour that fits better decides, because a pause or a turn may lie on the other side.
    fn comes_there(&self, i: usize, meant: f64) -> bool {
        let Some([t, v]) = self.motion else { return false };
        let off = |place: f64| {
            let by = |k: usize| (place - self.p[k] - f64::midpoint(v[i], v[k]) * (t[i] - t[k])).abs();
            by(i - 1).min(by(i + 1))
        };
        off(self.p[i]) < off(meant)
    }

    /// The position that a row probably had; `None` if the written one is plausible.
    fn meant(&self, i: usize) -> Option<f64> {
        let (p, n) = (self.p, self.p.len());
        let (own, [a, b]) = (p[i], self.around(i));
        // Other rows between the same two places.
        let same = |k: &usize| {
            let [c, d] = self.around(*k);
            *k != i && (self.at(a, c) && self.at(b, d) || self.at(a, d) && self.at(b, c))
        };
        let others: Vec<f64> = (1..n - 1).filter(same).map(|k| p[k]).collect();
        let alone = (0..n).all(|k| k == i || !self.at(p[k], own));
        // If targets come in any order, another target between the same two is normal.
        if others.iter().any(|o| self.at(*o, own)) || !(self.sweeps || alone && others.len() >= 2) {
            return None;
        }
        // A value near zero stays near zero with any decimal point.
        let slipped = || SLIPS.iter().map(|by| own * by).filter(|q| q.abs() > 4.0 * self.near);
        if let Some(place) = others.iter().find(|o| slipped().any(|q| self.at(q, **o))) {
            return Some(*place);
        }
        let alike = others.len() >= 2 && others.iter().all(|o| self.at(*o, others[0]));
        if alike && with_a_digit_more(own).any(|q| self.at(q, others[0])) {
            return Some(others[0]);
        }
        // In a sweep that passes this place only once, the two neighbours decide.
        let (middle, apart) = (f64::midpoint(a, b), (b - a).abs());
        let through = |q: &f64| apart > 2.0 * self.near && (q - middle).abs() < MIDDLE * apart;
        if self.sweeps && alone { slipped().find(through) } else { None }
    }
}

/// Values from which dropping one digit gives this value.
fn with_a_digit_more(value: f64) -> impl Iterator<Item = f64> {
    let text = value.to_string();
    let places: Vec<usize> = (usize::from(value < 0.0)..=text.len()).collect();
    places.into_iter().flat_map(move |at| {
        let text = text.clone();
        (0..10).filter_map(move |digit| format!("{}{digit}{}", &text[..at], &text[at..]).parse().ok())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_builders::{column, record};
    use rtec_model::record::RunKind;

    /// A reading at a reversal may lie outside both neighbours, by less than a step.
    /// A lost digit lies farther off.
    #[test]
    fn where_a_run_turns_no_digit_is_lost() {
        let said = |lost: Option<usize>| {
            let mut x: Vec<f64> = Vec::new();
            for sweep in 0..6 {
                let way = (0..40).map(|i| -90.0 - 1.8 * f64::from(i) - 0.03 * f64::from(sweep));
                if sweep % 2 == 0 { x.extend(way.rev()) } else { x.extend(way) }
            }
            if let Some(row) = lost {
                x[row] /= 10.0;
            }
            let e = (0..x.len()).map(|i| (i as f64).sin()).collect();
            let columns = vec![column("x", "position.x", x), column("e", "error.x", e)];
            let mut out = Vec::new();
            look(&record("r.run.toml", RunKind::Dynamics, columns), &mut out);
            out.len()
        };
        assert_eq!((said(None), said(Some(100))), (0, 1));
    }

    /// A late reading at a reversal looks like a lost digit; its speed explains it.
    #[test]
    fn a_speed_that_comes_there_shows_that_no_digit_is_lost() {
        let said = |with_speed: bool| {
            let (mut t, mut y, mut v) = (Vec::new(), Vec::new(), Vec::new());
            let mut now_s = 0.0;
            for sweep in 0..4 {
                let top = if sweep == 2 { 99.8974 } else { 99.1 };
                let up = [0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 95.0, 97.0, 98.2];
                let down = up.iter().rev().skip(1).map(|p| (*p - 0.2, -40.0));
                let rows = up.iter().map(|p| (*p, 40.0)).chain([(top, -2.0), (98.0, -20.0)]).chain(down);
                for (i, (place, speed)) in rows.enumerate() {
                    let after_the_turn = i == up.len() + 1;
                    now_s += if after_the_turn { (top - 98.0) / 11.0 } else { 0.25 };
                    t.push(now_s);
                    y.push(place);
                    v.push(speed);
                }
            }
            let e = (0..y.len()).map(|i| (i as f64).sin()).collect();
            let mut columns =
                vec![column("t", "time", t), column("y", "position.y", y), column("e", "error.y", e)];
            columns.extend(with_speed.then(|| column("v", "velocity.y", v)));
            let mut out = Vec::new();
            look(&record("r.run.toml", RunKind::FeedSweep, columns), &mut out);
            out.len()
        };
        assert_eq!((said(false), said(true)), (1, 0));
    }
}
