//! Reduces many points to those that are visible.
//! A million points over some hundred pixel columns mostly overlap.

use std::collections::HashSet;

type Point = (f64, f64);
type Pixel = (i32, i32);

/// A pixel column, and its first, lowest, highest and last point.
/// Each is an index, a point and a pixel height.
type Column = (i32, [(usize, Point, i32); 4]);

/// Fewest points that are reduced.
const MANY: usize = 2000;

/// The points with finite coordinates.
pub(super) fn finite(points: &[Point]) -> impl Iterator<Item = Point> {
    points.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite())
}

/// A subset of a line's points that touches the same pixels.
/// Of consecutive points in one pixel column it keeps the first, lowest, highest and last.
pub(super) fn line(points: &[Point], pixel: impl Fn(&Point) -> Pixel) -> Vec<Point> {
    if points.len() < MANY {
        return finite(points).collect();
    }
    let mut kept = Vec::new();
    let mut column: Option<Column> = None;
    let mut close = |column: Option<Column>| {
        let Some((_, mut four)) = column else { return };
        four.sort_by_key(|(number, ..)| *number);
        let before = kept.len();
        for (number, point, _) in four {
            if kept.len() == before || kept.last().is_some_and(|(last, _)| *last != number) {
                kept.push((number, point));
            }
        }
    };
    for (number, point) in finite(points).enumerate() {
        let (x, y) = pixel(&point);
        let now = (number, point, y);
        match &mut column {
            Some((of, [_, low, high, last])) if *of == x => {
                *last = now;
                *low = if y > low.2 { now } else { *low };
                *high = if y < high.2 { now } else { *high };
            }
            _ => close(column.replace((x, [now; 4]))),
        }
    }
    close(column);
    kept.into_iter().map(|(_, point)| point).collect()
}

/// One dot per pixel.
pub(super) fn dots(points: &[Point], pixel: impl Fn(&Point) -> Pixel) -> Vec<Point> {
    if points.len() < MANY {
        return finite(points).collect();
    }
    let mut taken = HashSet::new();
    finite(points).filter(|p| taken.insert(pixel(p))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn whole(p: &Point) -> Pixel {
        (p.0.round() as i32, p.1.round() as i32)
    }

    /// The pixels of a line, by runs of one column.
    /// Each run has its lowest and highest pixel, and where the line enters and leaves.
    fn traced(points: &[Point]) -> Vec<[i32; 5]> {
        let mut runs: Vec<[i32; 5]> = Vec::new();
        for (x, y) in finite(points).map(|p| whole(&p)) {
            match runs.last_mut() {
                Some([of, _, low, high, last]) if *of == x => {
                    (*low, *high, *last) = ((*low).min(y), (*high).max(y), y);
                }
                _ => runs.push([x, y, y, y, y]),
            }
        }
        runs
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(test_needs::fewer(256) as u32))]
        #[test]
        fn a_line_of_fewer_points_touches_the_same_pixels(
            steps in prop::collection::vec((-0.2..0.3_f64, -40.0..40.0_f64, 0..50_u8), MANY..6000),
        ) {
            let mut x = 0.0;
            let points: Vec<Point> = steps.iter().map(|(step, y, hole)| {
                x += step;
                (x, if *hole == 0 { f64::NAN } else { *y })
            }).collect();
            let thin = line(&points, whole);
            prop_assert_eq!(traced(&thin), traced(&points));
            prop_assert!(thin.len() <= 4 * traced(&points).len() && thin.len() < points.len());
            let lie: HashSet<Pixel> = finite(&points).map(|p| whole(&p)).collect();
            let dots = dots(&points, whole);
            prop_assert_eq!(dots.len(), lie.len());
            prop_assert_eq!(dots.iter().map(whole).collect::<HashSet<_>>(), lie);
        }
    }

    /// Few points are not reduced.
    #[test]
    fn few_points_stay_as_they_are() {
        let points: Vec<Point> = (0..1999).map(|i| (f64::from(i) / 100.0, f64::from(i * 7 % 31))).collect();
        assert_eq!(line(&points, whole), points);
        assert_eq!(dots(&points, whole), points);
        let many: Vec<Point> =
            (0..1_000_000).map(|i| (f64::from(i) / 2000.0, f64::from(i * 7 % 31))).collect();
        assert!(line(&many, whole).len() <= 4 * 501);
    }
}
