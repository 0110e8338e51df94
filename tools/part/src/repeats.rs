//! Places that were touched several times.
//! Their touches share the part's form, so they are not independent points.

use crate::fit::{FittedShape, Zx, deviations_um};
use serde::Serialize;

/// Largest distance of touches of one place, as a share of the distance of places.
const NEAR: f64 = 0.1;

/// Places that were touched several times, and the scatter of their touches.
#[derive(Debug, Clone, Serialize)]
pub struct Repeats {
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
}

/// The place of each point along a shape, and the length once around it, mm.
/// That length is infinite for a line.
fn along(fitted: &FittedShape, points: &[Zx]) -> (Vec<f64>, f64) {
    match *fitted {
        FittedShape::Circle { centre, radius_mm, .. } => {
            let turn = std::f64::consts::TAU * radius_mm;
            (points.iter().map(|p| (*p - centre).angle_rad() * radius_mm).collect(), turn)
        }
        FittedShape::Line { through, normal } => {
            let way = Zx::new(normal.x, -normal.z);
            (points.iter().map(|p| (*p - through).dot(way)).collect(), f64::INFINITY)
        }
    }
}

/// Groups points on a shape into places; the shape has so many `parameters`.
/// `None` if most points have a place of their own.
pub(crate) fn find(fitted: &FittedShape, points: &[Zx], parameters: usize) -> Option<Repeats> {
    let (along_mm, turn_mm) = along(fitted, points);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| along_mm[*a].total_cmp(&along_mm[*b]));
    let gap = |w: &[usize]| along_mm[w[1]] - along_mm[w[0]];
    let around = along_mm[*order.first()?] + turn_mm - along_mm[*order.last()?];
    let mut gaps: Vec<f64> = order.windows(2).map(gap).collect();
    gaps.sort_by(f64::total_cmp);
    // Finds the step from gaps within places to gaps between them. At least half of the gaps are within.
    let split = ((gaps.len() / 2).max(2)..gaps.len()).find(|k| gaps[k - 1] <= NEAR * gaps[*k])?;
    let widest = gaps[split - 1];
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (n, point) in order.iter().enumerate() {
        match groups.last_mut() {
            Some(group) if gap(&order[n - 1..=n]) <= widest => group.push(*point),
            _ => groups.push(vec![*point]),
        }
    }
    if groups.len() > 1 && around <= widest {
        let last = groups.pop().unwrap_or_default();
        groups[0].extend(last);
    }
    let deviations = deviations_um(fitted, points);
    let mean = |group: &[usize]| group.iter().map(|k| deviations[*k]).sum::<f64>() / group.len() as f64;
    let within: f64 =
        groups.iter().flat_map(|group| group.iter().map(|k| (deviations[*k] - mean(group)).powi(2))).sum();
    let between: f64 = groups.iter().map(|group| mean(group).powi(2)).sum();
    let (places, free) = (groups.len(), groups.len().checked_sub(parameters).filter(|n| *n > 0));
    let centre = |group: &Vec<usize>| {
        group.iter().fold(Zx::new(0.0, 0.0), |sum, k| sum + points[*k]) * (1.0 / group.len() as f64)
    };
    Some(Repeats {
        places,
        sd_within_um: (within / (points.len() - places) as f64).sqrt(),
        sd_between_um: free.map(|free| (between / free as f64).sqrt()),
        means: groups.iter().map(centre).collect(),
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
        // With so few places there is no standard error.
        let points: Vec<Zx> =
            (0..8).map(|k| Zx::new(f64::from(k / 4) * 9.0, 20.0 + 1e-4 * f64::from(k))).collect();
        let found = find(&line, &points, 2).unwrap();
        assert!(found.places == 2 && found.sd_between_um.is_none(), "{found:?}");
    }
}
