//! A smooth function of one position: linear between knots, constant beyond.

use super::{
    Effect, EffectInputColumns, EffectMemory, Input, Law, LawDescription, LawParameter, Out,
    ParameterFitMethod, ParameterValueError, RecordExtent, SearchGridPoint,
};

/// A function of one axis's position, linear between knots.
#[derive(Debug)]
pub(super) struct PiecewiseLinearLaw {
    pub(super) description: LawDescription,
    /// Index of the axis in the name that the knots lie on.
    pub(super) along: usize,
}

const KNOTS: usize = 0;
const UM: usize = 1;

/// The two knots around a position, each with its weight.
/// Beyond the end knots, the end knot alone.
fn shares(knots: &[f64], p_mm: f64) -> [(usize, f64); 2] {
    let after = knots.partition_point(|k| *k <= p_mm);
    if after == 0 || after == knots.len() {
        let end = after.saturating_sub(1);
        return [(end, 1.0), (end, 0.0)];
    }
    let w = (p_mm - knots[after - 1]) / (knots[after] - knots[after - 1]);
    [(after - 1, 1.0 - w), (after, w)]
}

impl Law for PiecewiseLinearLaw {
    fn describe(&self) -> &LawDescription {
        &self.description
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        out.fill(0.0);
        for (height, share) in shares(effect.get(KNOTS), now.p_mm[self.along]) {
            out[height] += share;
        }
    }

    fn basis_rows(
        &self,
        effect: &Effect,
        bound: &EffectInputColumns<'_>,
        _: usize,
        _: &mut EffectMemory,
        out: Out<'_>,
    ) {
        out.fill(0.0);
        let (knots, rows) = (effect.get(KNOTS), bound.rows());
        let p_mm = bound.p_mm[self.along];
        for row in 0..rows {
            for (height, share) in shares(knots, p_mm.map_or(0.0, |p| p[row])) {
                out[height * rows + row] += share;
            }
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut EffectMemory, out: Out<'_>) {
        let n = effect.width();
        self.basis(effect, now, component, state, &mut out[n * UM..]);
    }

    fn stretch_mm(&self, effect: &Effect) -> Option<(usize, [f64; 2])> {
        let knots = effect.get(KNOTS);
        Some((self.along, [*knots.first()?, *knots.last()?]))
    }

    /// A constant and a straight line over the knots.
    /// Offset, scale and squareness explain them.
    fn constraints(&self, effect: &Effect) -> Vec<Vec<f64>> {
        let knots = effect.get(KNOTS);
        let middle = knots.iter().sum::<f64>() / knots.len() as f64;
        vec![vec![1.0; knots.len()], knots.iter().map(|k| k - middle).collect()]
    }

    fn check(&self, effect: &Effect) -> Result<(), ParameterValueError> {
        if effect.get(KNOTS).windows(2).all(|w| w[0] < w[1]) {
            return Ok(());
        }
        Err(ParameterValueError::new(
            "knots_mm",
            format!("{:?}", effect.get(KNOTS)),
            "knots that increase strictly",
        ))
    }

    /// Sets of even knots, from 4 to 48.
    /// They cover the whole travel. If there are few places, one set has a knot at every place.
    fn grid(&self, effect: &Effect, records: &dyn RecordExtent) -> Vec<SearchGridPoint> {
        let axis = &effect.axes()[self.along];
        let places = records.places_mm(axis);
        let mut all = even(&places, records.rows());
        if PLACES.contains(&places.len()) && places.len() < records.rows() / 2 {
            all.push(places.clone());
        }
        let level = |knots: Vec<f64>| {
            let values: Vec<f64> = knots.iter().copied().chain(knots.iter().map(|_| 0.0)).collect();
            Some(SearchGridPoint { effect: effect.with_values(&values)?, price: 1.0 })
        };
        all.into_iter().filter_map(level).collect()
    }
}

/// Sets of even knots from the first place to the last.
/// Sizes that the places cannot tell apart are left out.
fn even(places: &[f64], rows: usize) -> Vec<Vec<f64>> {
    let (Some(lo), Some(hi)) = (places.first(), places.last()) else { return Vec::new() };
    let sizes = SIZES.into_iter().filter(|k| *k < places.len().min(rows / 3));
    let all = sizes.map(|k| (0..k).map(|i| lo + (hi - lo) * i as f64 / (k - 1) as f64).collect());
    let mut all: Vec<Vec<f64>> = all.map(|knots| with_places(knots, places)).collect();
    all.dedup();
    all
}

/// The knots that have a measured place nearest to them.
/// Elsewhere nothing was measured, and a height would be arbitrary.
fn with_places(knots: Vec<f64>, places: &[f64]) -> Vec<f64> {
    let mut has = vec![false; knots.len()];
    for p in places {
        let after = knots.partition_point(|k| k < p);
        let near = |k: &usize| (knots[*k] - p).abs();
        let nearest = [after.saturating_sub(1), after.min(knots.len() - 1)];
        if let Some(k) = nearest.into_iter().min_by(|a, b| near(a).total_cmp(&near(b))) {
            has[k] = true;
        }
    }
    knots.into_iter().zip(has).filter_map(|(k, has)| has.then_some(k)).collect()
}

/// Numbers of even knots that a search tries.
const SIZES: [usize; 17] = [4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 20, 24, 28, 34, 40, 48];
/// Numbers of places for which each place may have a knot.
const PLACES: std::ops::RangeInclusive<usize> = 4..=48;

/// The parameters of a map: knots and heights.
pub(super) fn parameters() -> Vec<LawParameter> {
    vec![
        LawParameter::new("knots_mm", "mm", [-1e4, 1e4], ParameterFitMethod::Chosen)
            .within([-1e6, 1e6], "no axis travels a kilometre")
            .array()
            .telling_apart(),
        LawParameter::linear("um", "um", 500.0)
            .typically(3.0)
            .within([-10_000.0, 10_000.0], "no guideway or scale is 10 mm off")
            .array(),
    ]
}

#[cfg(test)]
mod tests {
    use super::with_places;

    /// Regression: heights of 92 µm between targets.
    /// Places are dense in the middle, as on a circle, with a few targets over the travel.
    #[test]
    fn knots_stay_where_something_was_measured() {
        let places: Vec<f64> =
            (0..9).map(|i| 30.0 * f64::from(i)).chain((0..60).map(|i| 100.0 + f64::from(i))).collect();
        let even: Vec<f64> = (0..41).map(|i| 6.0 * f64::from(i)).collect();
        let knots = with_places(even.clone(), &places);
        let own = |k: &f64| places.iter().any(|p| (p - k).abs() <= 3.0);
        assert!(knots.len() < even.len() && knots.iter().all(own), "{knots:?}");
        assert!(places.iter().all(|p| knots.iter().any(|k| (p - k).abs() <= 3.0)), "{knots:?}");
        assert_eq!(with_places(even.clone(), &even), even);
    }
}
