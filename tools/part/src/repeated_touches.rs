//! Places that were touched several times.
//! Their touches share the part's form, so they are not independent points.

use crate::geometric_fit::{FittedShape, Zx, deviations_um, sequence};
use serde::Serialize;

/// Largest distance of touches of one place, as a share of the distance of places.
const NEAR: f64 = 0.1;
/// Largest distance of touches of one place, mm.
/// Over less than the feed of a finish cut a surface has one form.
const ONE_PLACE_MM: f64 = 0.1;

/// Places that were touched several times, and the scatter of their touches.
#[derive(Debug, Clone, Serialize)]
pub struct RepeatedTouches {
    /// Number of places.
    pub places: usize,
    /// SD of the touches of one place about their mean, pooled, in µm.
    pub sd_within_um: f64,
    /// SD of the places' means about the fit, in µm.
    /// `None` if there are too few places.
    pub sd_between_um: Option<f64>,
    /// Mean of each place, mm.
    #[serde(skip)]
    pub(crate) means: Vec<Zx>,
    /// Touches of each place.
    #[serde(skip)]
    groups: Vec<Vec<usize>>,
}

impl RepeatedTouches {
    /// The touches of these places, in ascending order.
    pub(crate) fn touches(&self, places: &[usize]) -> Vec<usize> {
        let mut touches: Vec<usize> = places.iter().flat_map(|place| self.groups[*place].clone()).collect();
        touches.sort_unstable();
        touches
    }
}

/// Distance along a shape from a point to the next one, mm.
fn way_mm(fitted: &FittedShape, from: Zx, to: Zx) -> f64 {
    match *fitted {
        FittedShape::Circle { centre, radius_mm } => {
            let turn = (to - centre).angle_rad() - (from - centre).angle_rad();
            turn.rem_euclid(std::f64::consts::TAU) * radius_mm
        }
        FittedShape::Line { normal, .. } => (to - from).dot(normal.along()),
    }
}

/// Groups points on a shape with this number of `parameters` into places.
/// `None` if most points have a place of their own.
pub(crate) fn find(fitted: &FittedShape, points: &[Zx], parameters: usize) -> Option<RepeatedTouches> {
    // Starts after the widest gap, so that no arc and no place is cut in two.
    let order = sequence(fitted, points);
    let gap = |w: &[usize]| way_mm(fitted, points[w[0]], points[w[1]]);
    let mut gaps: Vec<f64> = order.windows(2).map(gap).collect();
    gaps.sort_by(f64::total_cmp);
    // Finds the step from gaps within places to gaps between them. At least half of the gaps are within.
    let is_split = |k: &usize| gaps[k - 1] <= ONE_PLACE_MM.min(NEAR * gaps[*k]);
    let split = ((gaps.len() / 2).max(2)..gaps.len()).find(is_split)?;
    let widest = gaps[split - 1];
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (n, point) in order.iter().enumerate() {
        match groups.last_mut() {
            Some(group) if gap(&order[n - 1..=n]) <= widest => group.push(*point),
            _ => groups.push(vec![*point]),
        }
    }
    let deviations = deviations_um(fitted, points);
    let mean = |group: &[usize]| group.iter().map(|k| deviations[*k]).sum::<f64>() / group.len() as f64;
    let within: f64 =
        groups.iter().flat_map(|group| group.iter().map(|k| (deviations[*k] - mean(group)).powi(2))).sum();
    let between: f64 = groups.iter().map(|group| mean(group).powi(2)).sum();
    let (places, free) = (groups.len(), groups.len().checked_sub(parameters).filter(|n| *n > 0));
    let centre =
        |group: &Vec<usize>| group.iter().map(|k| points[*k]).sum::<Zx>() * (1.0 / group.len() as f64);
    Some(RepeatedTouches {
        places,
        sd_within_um: (within / (points.len() - places) as f64).sqrt(),
        sd_between_um: free.map(|free| (between / free as f64).sqrt()),
        means: groups.iter().map(centre).collect(),
        groups,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn touches_of_one_place_are_found_and_single_points_are_none() {
        let circle = FittedShape::Circle { centre: Zx::new(100.0, 0.0), radius_mm: 25.0 };
        let line = FittedShape::Line { through: Zx::new(0.0, 20.0), normal: Zx::new(0.0, 1.0) };
        let off = |place: usize, touch: usize| 1e-3 * ((7 * place + 3 * touch) % 5) as f64;
        for touches in [1_usize, 2, 3, 4] {
            let places: Vec<(usize, usize)> =
                (0..7).flat_map(|p| (0..touches).map(move |t| (p, t))).collect();
            let around = |(p, t): &(usize, usize)| {
                // The touches of a place at half a turn are on both sides of the jump in the angle.
                let angle = std::f64::consts::PI - 0.4 * *p as f64 + 1e-5 * (*t as f64 - 0.5);
                Zx::new(100.0, 0.0) + Zx::at_angle(angle) * (25.0 + off(*p, *t))
            };
            let straight =
                |(p, t): &(usize, usize)| Zx::new(5.0 * *p as f64 + 1e-3 * *t as f64, 20.0 + off(*p, *t));
            for (shape, points, parameters) in [
                (&circle, places.iter().map(around).collect::<Vec<_>>(), 3),
                (&line, places.iter().map(straight).collect(), 2),
            ] {
                let found = find(shape, &points, parameters);
                assert_eq!(found.map(|r| r.places), (touches > 1).then_some(7), "{touches}: {shape:?}");
            }
        }
        // Single points on any arc and with any gap: a hole, a groove.
        for n in [8_u32, 12, 16, 20, 30] {
            let at = |deg: f64| Zx::new(100.0, 0.0) + Zx::at_angle(deg.to_radians()) * 25.0;
            let share = |k: u32| f64::from(k) / f64::from(n - 1);
            for arc in (100..360).step_by(5).chain([179, 181, 359]) {
                let points: Vec<Zx> = (0..n).map(|k| at(-20.0 + f64::from(arc) * share(k))).collect();
                assert!(find(&circle, &points, 3).is_none(), "{n} points over {arc} degrees");
            }
            let sectors: Vec<Zx> =
                (0..2 * n).map(|k| at(180.0 * f64::from(k / n) + 20.0 * share(k % n))).collect();
            assert!(find(&circle, &sectors, 3).is_none(), "{n} points on either side");
            let lands: Vec<Zx> =
                (0..2 * n).map(|k| Zx::new(30.0 * f64::from(k / n) + 5.0 * share(k % n), 20.0)).collect();
            assert!(find(&line, &lands, 2).is_none(), "{n} points on either side of a groove");
        }
        // With so few places there is no standard error.
        let points: Vec<Zx> =
            (0..8).map(|k| Zx::new(f64::from(k / 4) * 9.0, 20.0 + 1e-4 * f64::from(k))).collect();
        let found = find(&line, &points, 2).unwrap();
        assert!(found.places == 2 && found.sd_between_um.is_none(), "{found:?}");
    }
}
