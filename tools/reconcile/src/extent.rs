//! What records span, as the grids of the laws ask, and how places lie: on a grid, in steps, alike for several periods.

use crate::problem::Stack;
use rtec_model::effect::Extent;
use rtec_model::record::{Axis, Role};

impl Extent for Stack<'_> {
    fn rows(&self) -> usize {
        self.n
    }

    fn time_constants_s(&self) -> Vec<f64> {
        taus(self)
    }

    fn moments_s(&self) -> Vec<f64> {
        moments(self)
    }

    fn places_mm(&self, axis: &Axis) -> Vec<f64> {
        distinct(self, &Role::Position(axis.clone())).unwrap_or_default()
    }

    fn stretches_mm(&self, axis: &Axis) -> Vec<[f64; 2]> {
        let role = Role::Position(axis.clone());
        let span = |p: &[f64]| {
            let of = |f: fn(f64, f64) -> f64| p.iter().copied().reduce(f);
            Some([of(f64::min)?, of(f64::max)?])
        };
        let mut all: Vec<[f64; 2]> =
            self.records.iter().filter_map(|r| span(r.data(&role)?)).filter(|[lo, hi]| lo < hi).collect();
        let whole = span(&all.concat()).unwrap_or_default();
        let near = ALIKE * (whole[1] - whole[0]);
        let alike = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).abs() <= near && (a[1] - b[1]).abs() <= near;
        all.sort_by(|a, b| (b[1] - b[0]).total_cmp(&(a[1] - a[0])));
        let mut out: Vec<[f64; 2]> = Vec::new();
        for part in all {
            if !alike(&part, &whole) && !out.iter().any(|o| alike(o, &part)) {
                out.push(part);
            }
        }
        out.truncate(MOST_STRETCHES);
        out
    }
}

/// Ends that are nearer than this share of all that was travelled are the same.
const ALIKE: f64 = 0.05;
/// So many parts of it are looked at.
const MOST_STRETCHES: usize = 2;

/// Time constants to try: from three rows to twice the longest record.
pub(crate) fn taus(stack: &Stack<'_>) -> Vec<f64> {
    let longest = stack
        .records
        .iter()
        .map(|r| (span(r.time_s()), r.rows()))
        .fold((0.0, 1), |a, b| if b.0 > a.0 { b } else { a });
    if longest.0 <= 0.0 {
        return Vec::new();
    }
    let lo = (longest.0 / longest.1 as f64 * 2.0).max(longest.0 / 300.0);
    let hi = longest.0 * 2.0;
    let count = 14;
    (0..count).map(|i| lo * (hi / lo).powf(f64::from(i) / f64::from(count - 1))).collect()
}

/// Moments at which a step may fall: every row's time but the first and last few.
pub(crate) fn moments(stack: &Stack<'_>) -> Vec<f64> {
    let mut times: Vec<f64> = stack.records.iter().flat_map(|r| r.time_s().iter().copied()).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let cut = 3.min(times.len() / 2);
    times[cut..times.len() - cut].to_vec()
}

fn span(x: &[f64]) -> f64 {
    x.last().zip(x.first()).map_or(0.0, |(b, a)| b - a)
}

fn distinct(stack: &Stack<'_>, role: &Role) -> Option<Vec<f64>> {
    let mut all: Vec<f64> = stack.records.iter().filter_map(|r| r.data(role)).flatten().copied().collect();
    all.sort_by(f64::total_cmp);
    let (lo, hi) = (*all.first()?, *all.last()?);
    let close = (hi - lo) / 300.0;
    // Targets that are approached again and again differ by little: each cluster is one place.
    let mut out: Vec<(f64, f64)> = Vec::new();
    for x in all {
        match out.last_mut() {
            Some((sum, count)) if x - *sum / *count <= close => {
                *sum += x;
                *count += 1.0;
            }
            _ => out.push((x, 1.0)),
        }
    }
    Some(out.into_iter().map(|(s, c)| s / c).collect())
}

/// The pitch of a grid that all places, in rising order, lie on to within `close`; `None` where they lie on none, or hardly repeat.
pub(crate) fn pitch(places: &[f64], close: f64) -> Option<f64> {
    let mut distinct: Vec<f64> = Vec::new();
    for x in places {
        if distinct.last().is_none_or(|d| x - d > 2.0 * close) {
            distinct.push(*x);
        }
    }
    let least = distinct.windows(2).map(|w| w[1] - w[0]).fold(f64::MAX, f64::min);
    let (first, last) = (*distinct.first()?, *distinct.last()?);
    if distinct.len() < 3 || least < 4.0 * close {
        return None;
    }
    // The mean over the whole grid: an error of each place must not add up.
    let pitch = (last - first) / ((last - first) / least).round();
    let off = |x: &f64| {
        let k = (x - first) / pitch;
        (k - k.round()).abs() * pitch > close
    };
    (!places.iter().any(off)).then_some(pitch)
}

/// How far from a grid the places may lie that a wave cannot tell from it, in periods.
pub(crate) const GRID_SHARE: f64 = 0.02;

/// The step that positions were read in, mm: 1, 2 or 5 times a power of ten, the largest that all are multiples of.
pub(crate) fn resolution(places: &[f64]) -> Option<f64> {
    let steps = (0..=6).flat_map(|k| [5.0, 2.0, 1.0].map(|m| m / 10_f64.powi(k)));
    let whole = |x: &f64, step: f64| (x / step - (x / step).round()).abs() < 1e-3;
    steps.into_iter().find(|step| places.iter().all(|x| whole(x, *step)))
}

/// So many multiples of a grid's frequency are looked through for periods that machines are made with.
const MULTIPLES: usize = 200;

/// Frequencies that look the same as `f` on a grid, inside a range, slowest first: so many, and beyond them those of periods
/// that machines are made with.
pub(crate) fn aliases(f: f64, pitch: f64, range: [f64; 2], most: usize, usual_mm: &[f64]) -> Vec<f64> {
    let whole = 1.0 / pitch;
    let rest = f.rem_euclid(whole);
    let near = rest.min(whole - rest);
    let first = (range[0] / whole).floor().max(0.0);
    let all = (0..MULTIPLES.max(most)).flat_map(|k| {
        let at = (first + k as f64) * whole;
        [at + near, at + whole - near]
    });
    let inside = all.filter(|g| (range[0]..=range[1]).contains(g)).enumerate();
    inside.filter(|(i, g)| *i < most || is_made(1.0 / g, usual_mm)).map(|(_, g)| g).collect()
}

/// Whether machines are made with a period, as far as it is known.
fn is_made(period_mm: f64, usual_mm: &[f64]) -> bool {
    usual_mm.iter().any(|l| (period_mm / l - 1.0).abs() < 0.005)
}

/// Which of several periods is the likeliest, being equally good otherwise: one that machines are made with, or the longest.
pub(crate) fn likeliest(periods_mm: &[f64], usual_mm: &[f64]) -> Option<usize> {
    periods_mm.iter().position(|p| is_made(*p, usual_mm)).or((!periods_mm.is_empty()).then_some(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{circle, record};

    #[test]
    fn positions_are_read_in_steps_of_a_scale() {
        let places = |step: f64| (0..200).map(|k| f64::from(k * k + 6 * k) * step - 30.0).collect::<Vec<_>>();
        for step in [0.5, 0.2, 0.1, 0.05, 0.002, 0.001, 0.0005, 0.000_1] {
            assert_eq!(resolution(&places(step)), Some(step));
        }
        let roots: Vec<f64> = (0..50).map(|k| f64::from(k).sqrt()).collect();
        assert_eq!(resolution(&roots), None);
    }

    /// What a circle and an axis's own targets span is not the same; what all records span is no part.
    #[test]
    fn parts_of_what_was_travelled_are_told_apart() {
        let x = crate::testing::axis();
        let line = record(100, |i| i);
        assert!(Stack::new(std::slice::from_ref(&line)).stretches_mm(&x).is_empty());
        let near = |stretch: [f64; 2], lo: f64, hi: f64| {
            (stretch[0] - lo).abs() < 2.0 && (stretch[1] - hi).abs() < 2.0
        };
        let within = [line.clone(), line.clone(), circle(100, 30.0, |a| a)];
        let parts = Stack::new(&within).stretches_mm(&x);
        assert!(parts.len() == 2 && near(parts[0], 0.0, 100.0) && near(parts[1], -30.0, 30.0), "{parts:?}");
        let wide = [circle(100, 150.0, |a| a), line];
        let parts = Stack::new(&wide).stretches_mm(&x);
        assert!(parts.len() == 1 && near(parts[0], 0.0, 100.0), "{parts:?}");
    }

    #[test]
    fn a_grid_has_a_pitch_and_uneven_places_have_none() {
        let mut places: Vec<f64> = (0..20).map(|k| 12.5 * f64::from(k) + 0.001 * f64::from(k % 3)).collect();
        assert!((pitch(&places, 0.01).unwrap() - 12.5).abs() < 1e-3);
        places.push(241.0);
        assert_eq!(pitch(&places, 0.01), None);
    }

    /// On a grid of 5 mm, 1/7 per mm looks like 1/5 − 1/7 and 1/5 + 1/7.
    #[test]
    fn aliases_are_alike_at_every_place() {
        let f = 1.0 / 7.0;
        let all = aliases(f, 5.0, [0.0, 1.0], 4, &[]);
        assert!(all.len() == 4 && all.is_sorted(), "{all:?}");
        for g in all {
            for k in 0..10 {
                let cos = |f: f64| (std::f64::consts::TAU * f * 5.0 * f64::from(k)).cos();
                assert!((cos(f) - cos(g)).abs() < 1e-9, "{g}");
            }
        }
    }

    /// A bug once: at 50 mm steps a screw of 12 mm was not among the eight that were listed beside it.
    #[test]
    fn what_machines_are_made_with_is_among_the_aliases() {
        let of = |usual: &[f64]| aliases(1.0 / 60.0, 50.0, [1.0 / 60.0, 2.0], 8, usual);
        assert!(
            of(&[]).is_sorted() && of(&[]).iter().any(|f| (1.0 / f - 12.0).abs() < 1e-9),
            "{:?}",
            of(&[])
        );
        let made = 60.0 / 7.0;
        let among = |usual: &[f64]| of(usual).iter().any(|f| (1.0 / f - made).abs() < 1e-9);
        assert!(among(&[12.0, made]) && !among(&[12.0]));
    }

    #[test]
    fn what_machines_are_made_with_is_likelier() {
        assert_eq!(likeliest(&[37.3, 10.02, 4.1], &[5.0, 10.0]), Some(1));
        assert_eq!(likeliest(&[37.3, 10.02], &[]), Some(0));
        assert_eq!(likeliest(&[], &[5.0]), None);
    }

    #[test]
    fn time_constants_go_from_a_few_rows_to_twice_the_run() {
        let records = [record(301, |i| i)];
        let stack = Stack::new(&records);
        let all = stack.time_constants_s();
        assert!((all[0] - 10.0).abs() < 0.1 && (all[all.len() - 1] - 3000.0).abs() < 1e-6, "{all:?}");
        assert_eq!(stack.moments_s().len(), 301 - 6);
        let records = [record(40, |i| i)];
        assert_eq!(Stack::new(&records).places_mm(&crate::testing::axis()).len(), 40);
    }
}
