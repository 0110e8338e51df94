//! Aliases of a period at places that lie on a grid.

/// The pitch of a grid on which all places are, to within `close`.
/// The places are in rising order. `None` if there is no such grid, or the places hardly repeat.
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
    // The mean over the whole grid, so that errors of single places do not add up.
    let pitch = (last - first) / ((last - first) / least).round();
    let off = |x: &f64| {
        let k = (x - first) / pitch;
        (k - k.round()).abs() * pitch > close
    };
    (!places.iter().any(off)).then_some(pitch)
}

/// Largest distance from a grid at which places count as on it, in periods.
/// A wave cannot distinguish them from the grid.
pub(crate) const GRID_SHARE: f64 = 0.02;

/// Multiples of a grid's frequency that are searched for usual periods.
const MULTIPLES: usize = 200;

/// Frequencies that look the same as `f` on a grid, slowest first.
/// They are inside a range. At most `most` are returned, and in addition those of periods that machines are
/// made with.
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

/// Whether a period is a usual one of machines.
fn is_made(period_mm: f64, usual_mm: &[f64]) -> bool {
    usual_mm.iter().any(|l| (period_mm / l - 1.0).abs() < 0.005)
}

#[cfg(test)]
mod tests {
    use super::*;

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

    /// Regression: at 50 mm steps the rivals must include a screw of 12 mm.
    /// It was missing from the eight that were listed.
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
}
