//! The runs and the model as one least-squares problem: every response of every record one under the other.

use rtec_model::effect::{Effect, Search};
use rtec_model::record::{Record, Role};
use std::ops::Range;

/// One response of one record: a stretch of rows of the stack.
#[derive(Debug, Clone)]
pub(crate) struct Segment {
    pub(crate) record: usize,
    pub(crate) response: usize,
    pub(crate) rows: Range<usize>,
}

/// All rows of all responses, measured.
#[derive(Debug)]
pub(crate) struct Stack<'r> {
    pub(crate) records: &'r [Record],
    pub(crate) responses: Vec<Role>,
    pub(crate) segments: Vec<Segment>,
    pub(crate) ranges: Vec<Range<usize>>,
    pub(crate) n: usize,
    /// First and last instant of all records, s.
    pub(crate) time_s: [f64; 2],
    pub(crate) measured: Vec<f64>,
    /// What each response is divided by, so that its noise has about unit size.
    pub(crate) sigma: Vec<f64>,
}

impl<'r> Stack<'r> {
    pub(crate) fn new(records: &'r [Record]) -> Self {
        let mut responses: Vec<Role> = Vec::new();
        for column in records.iter().flat_map(Record::responses) {
            if !responses.contains(&column.role) {
                responses.push(column.role.clone());
            }
        }
        // A response's rows stand together: most columns are zero in all others.
        let (mut segments, mut measured) = (Vec::new(), Vec::new());
        for (response, role) in responses.iter().enumerate() {
            for (r, record) in records.iter().enumerate() {
                if let Some(column) = record.column(role) {
                    let start = measured.len();
                    measured.extend_from_slice(&column.data);
                    segments.push(Segment { record: r, response, rows: start..measured.len() });
                }
            }
        }
        let ranges = segments.iter().map(|s| s.rows.clone()).collect();
        let sigma = vec![1.0; responses.len()];
        let times = records.iter().flat_map(|r| r.time_s().iter().copied());
        let time_s = times.fold([f64::MAX, f64::MIN], |[lo, hi], t| [lo.min(t), hi.max(t)]);
        Self { records, responses, segments, ranges, n: measured.len(), time_s, measured, sigma }
    }

    /// The rows of a response.
    pub(crate) fn rows(&self, response: usize) -> Range<usize> {
        let mut own = self.segments.iter().filter(|s| s.response == response).map(|s| s.rows.clone());
        own.next().map_or(0..0, |first| own.fold(first, |all, rows| all.start..rows.end))
    }

    pub(crate) fn record(&self, segment: &Segment) -> &'r Record {
        &self.records[segment.record]
    }

    /// What is known beforehand of the coefficient of a map's free direction over these rows: its heights are no larger than a few
    /// times what was measured there. Where rows tell heights apart that says nothing; where they do not, heights that
    /// cancel each other at hundreds of µm fitted the rows as well, and nothing beside them.
    pub(crate) fn height_known(&self, rows: &Range<usize>) -> f64 {
        let size = rms(&self.measured[rows.clone()]);
        if size > 0.0 { (HIGHEST * size).powi(-2) } else { 0.0 }
    }

    /// Divides a stacked column by the noise size of each response.
    pub(crate) fn weigh(&self, column: &mut [f64]) {
        for s in &self.segments {
            for x in &mut column[s.rows.clone()] {
                *x /= self.sigma[s.response];
            }
        }
    }

    /// A stacked column from a function of record and row, only for one response (or all of them).
    pub(crate) fn column(&self, only: Option<usize>, value: impl Fn(&Record, usize) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; self.n];
        for s in self.segments.iter().filter(|s| only.is_none_or(|o| o == s.response)) {
            let record = self.record(s);
            for (row, x) in out[s.rows.clone()].iter_mut().enumerate() {
                *x = value(record, row);
            }
        }
        out
    }

    /// The constants of records that do not share the gauges' zero with the others: one column for each such zero and
    /// response.
    pub(crate) fn zeros(&self) -> Vec<Vec<f64>> {
        let mut names: Vec<&Option<String>> = self.records.iter().map(|r| &r.zero).collect();
        names.sort();
        names.dedup();
        if names.len() < 2 {
            return Vec::new();
        }
        let named = names.into_iter().filter(|n| n.is_some());
        let each = named.flat_map(|name| (0..self.responses.len()).map(move |j| (name, j)));
        each.map(|(name, j)| self.column(Some(j), |r, _| f64::from(u8::from(r.zero == *name))))
            .filter(|c| c.iter().any(|x| *x != 0.0))
            .collect()
    }

    /// Takes the mean off the rows of each record, or records, with a zero of their own: what their constants leave.
    pub(crate) fn without_zeros(&self, column: &mut [f64]) {
        for zero in self.zeros() {
            let (mut sum, mut n) = (0.0, 0.0);
            for (c, z) in column.iter().zip(&zero) {
                sum += c * z;
                n += z;
            }
            column.iter_mut().zip(&zero).for_each(|(c, z)| *c -= z * sum / n);
        }
    }

    /// Sum of effects, stacked. An effect whose sensor a record lacks is absent there.
    pub(crate) fn predict<'e>(&self, effects: impl IntoIterator<Item = &'e Effect>) -> Vec<f64> {
        let mut out = vec![0.0; self.n];
        for effect in effects {
            for s in &self.segments {
                let role = &self.responses[s.response];
                let _absent = effect.add(self.record(s), role, &mut out[s.rows.clone()]);
            }
        }
        out
    }

    /// Measured minus the sum of effects, stacked, not weighed.
    pub(crate) fn missing<'e>(&self, effects: impl IntoIterator<Item = &'e Effect>) -> Vec<f64> {
        let simulated = self.predict(effects);
        self.measured.iter().zip(&simulated).map(|(m, s)| m - s).collect()
    }

    /// The basis columns of an effect, stacked; constraints taken in, so that the columns are free.
    pub(crate) fn basis(&self, effect: &Effect) -> Vec<Vec<f64>> {
        let k = effect.coefficient_count();
        let raw = self.collect(effect, k, |bound, component, out| bound.basis(effect, component, out));
        if !leaves_a_line(effect) {
            return raw;
        }
        let directions = free_directions(&self.levels(effect, &raw), k);
        let mut columns: Vec<Vec<f64>> = directions
            .iter()
            .map(|weights| {
                let mut out = vec![0.0; self.n];
                for (w, column) in weights.iter().zip(&raw) {
                    out.iter_mut().zip(column).for_each(|(o, c)| *o += w * c);
                }
                out
            })
            .collect();
        let largest = columns.iter().map(|c| rms(c)).fold(0.0, f64::max);
        // A height that no row is near would be anything: a place on the next knot leaves it what was rounded off.
        for column in columns.iter_mut().filter(|c| rms(c) < ROUNDED_OFF * largest) {
            column.fill(0.0);
        }
        columns
    }

    /// What constant and straight line over the rows are made of, in a map's heights: one row of weights each. Offset,
    /// scale and squareness are for those. The rows are those of the axis's own error where there are any; in a circle's
    /// radial error the map counts as it is, not by its share. `raw`: the columns of its heights.
    pub(crate) fn levels(&self, effect: &Effect, raw: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let Some(along) = effect.axes().last() else { return Vec::new() };
        let role = Role::Position(along.clone());
        let own = effect.axes().first().map(|a| Role::Error(a.clone()));
        let of_own = |s: &&Segment| Some(&self.responses[s.response]) == own.as_ref();
        let any_own = self.segments.iter().any(|s| of_own(&s));
        // An axis that a record does not log stands still in it: that row is no part of a line.
        let mut place = vec![f64::NAN; self.n];
        for s in &self.segments {
            if let Some(data) = self.record(s).data(&role) {
                place[s.rows.clone()].copy_from_slice(data);
            }
        }
        let rows: Vec<usize> = self
            .segments
            .iter()
            .filter(|s| !any_own || of_own(s))
            .flat_map(|s| s.rows.clone())
            .filter(|row| !place[*row].is_nan())
            .collect();
        // Heights at a row add up to one, in a radial error to the axis's share.
        let mut share = vec![0.0; rows.len()];
        for column in raw {
            share.iter_mut().zip(&rows).for_each(|(share, row)| *share += column[*row]);
        }
        let weight = |of: &dyn Fn(f64) -> f64| -> Vec<f64> {
            // A row has a part in two heights at most.
            let at = |c: &Vec<f64>| {
                let each =
                    rows.iter().zip(&share).filter(|(row, s)| c[**row] != 0.0 && s.abs() > LEAST_SHARE);
                each.map(|(row, s)| c[*row] / s * of(place[*row])).sum()
            };
            raw.iter().map(at).collect()
        };
        let rows = weight(&|_| 1.0);
        let whole: f64 = rows.iter().sum::<f64>().max(1.0);
        let middle = weight(&|p| p).iter().sum::<f64>() / whole;
        vec![rows, weight(&|p| p - middle)]
    }

    /// The free directions of an effect's coefficients: all but a constant and a straight line of a map. Empty where each
    /// is free by itself.
    pub(crate) fn directions(&self, effect: &Effect) -> Vec<Vec<f64>> {
        if !leaves_a_line(effect) {
            return Vec::new();
        }
        let k = effect.coefficient_count();
        let raw = self.collect(effect, k, |bound, component, out| bound.basis(effect, component, out));
        free_directions(&self.levels(effect, &raw), k)
    }

    /// Derivatives of an effect by its values, stacked.
    pub(crate) fn slopes(&self, effect: &Effect) -> Vec<Vec<f64>> {
        self.collect(effect, effect.values().len(), |bound, component, out| {
            bound.slopes(effect, component, out);
        })
    }

    fn collect(
        &self,
        effect: &Effect,
        k: usize,
        fill: impl Fn(&rtec_model::effect::Bound<'_>, usize, &mut [f64]),
    ) -> Vec<Vec<f64>> {
        let mut out: Vec<Vec<f64>> = (0..k).map(|_| vec![0.0; self.n]).collect();
        let mut buffer = Vec::new();
        for s in &self.segments {
            let record = self.record(s);
            let acts = effect.acts_on(record);
            let role = &self.responses[s.response];
            let (Some((_, component)), Ok(bound)) =
                (acts.iter().find(|(r, _)| r == role), effect.bind(record))
            else {
                continue;
            };
            let rows = record.rows();
            if let [only] = &mut out[..] {
                fill(&bound, *component, &mut only[s.rows.clone()]);
                continue;
            }
            buffer.clear();
            buffer.resize(rows * k, 0.0);
            fill(&bound, *component, &mut buffer);
            for (column, part) in out.iter_mut().zip(buffer.chunks(rows)) {
                column[s.rows.clone()].copy_from_slice(part);
            }
        }
        out
    }
}

/// Whether an effect is a map, whose constant and straight line are other effects.
pub(crate) fn leaves_a_line(effect: &Effect) -> bool {
    !effect.constraints().is_empty()
}

/// Directions in coefficient space that fulfil the constraints, orthonormal; empty where there are none.
pub(crate) fn free_directions(constraints: &[Vec<f64>], k: usize) -> Vec<Vec<f64>> {
    if constraints.is_empty() {
        return Vec::new();
    }
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let units = (0..k).map(|i| (0..k).map(|j| f64::from(u8::from(i == j))).collect::<Vec<f64>>());
    for (i, mut v) in constraints.iter().cloned().chain(units).enumerate() {
        for _ in 0..2 {
            for b in &basis {
                let d: f64 = v.iter().zip(b).map(|(x, y)| x * y).sum();
                v.iter_mut().zip(b).for_each(|(x, y)| *x -= d * y);
            }
        }
        let len = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if len > 1e-6 || i < constraints.len() {
            basis.push(v.iter().map(|x| x / len.max(1e-300)).collect());
        }
    }
    basis.split_off(constraints.len())
}

/// A way in which an effect of the present model may be a little off.
#[derive(Debug, Clone)]
pub(crate) struct Known {
    /// Place of the effect in the model; none for a record's own constant.
    pub(crate) effect: Option<usize>,
    /// How it moves the effect's values: one of them, or all heights of a map in proportion.
    pub(crate) along: Vec<(usize, f64)>,
    /// Slope, weighed.
    pub(crate) column: Vec<f64>,
    /// Expected deviation from the file, along the way.
    pub(crate) sd: f64,
    /// The file's values minus those it is linearised at, along the way.
    pub(crate) target: f64,
}

/// A map's heights are no larger than so many times what was measured: one standard deviation.
const HIGHEST: f64 = 5.0;
/// A map's height that moves the rows by so much less than another one's says nothing of itself.
const ROUNDED_OFF: f64 = 1e-3;
/// Where an axis has a smaller share in a circle's radial error it shows nothing there.
const LEAST_SHARE: f64 = 1e-6;
/// How far a model's value may be off, as a share of what its effect does to the error: one standard deviation.
const TRUST: f64 = 0.1;
/// The same for what bends the shape of an effect: a period, a lag, a phase.
const TRUST_BENT: f64 = 0.15;
/// A value may be so many standard errors off, however small its effect.
const ERRORS: f64 = 1.0;
/// A record's own zero may be anywhere: so much of the noise.
const ANYWHERE: f64 = 1e4;

/// The ways in which an effect that the model has may move: each of its values by itself, and a map in proportion, without
/// the constant and the straight line that this would carry over the rows. A change of a map's shape is another map.
pub(crate) fn ways(stack: &Stack<'_>, effect: &Effect) -> Vec<Vec<(usize, f64)>> {
    let width = effect.width();
    let law = effect.description();
    if !leaves_a_line(effect) {
        let free = |v: &usize| law.parameters[v / width].search != Search::Chosen;
        return (0..effect.values().len()).filter(free).map(|v| vec![(v, 1.0)]).collect();
    }
    let Some(heights) = law.place(Search::Linear) else { return Vec::new() };
    let k = effect.coefficient_count();
    let raw = stack.collect(effect, k, |bound, component, out| bound.basis(effect, component, out));
    let um = effect.get(heights);
    // The straight line over the rows, as heights: least squares of the two levels.
    let levels = stack.levels(effect, &raw);
    let knots = law.place(Search::Chosen).map_or(&[][..], |p| effect.get(p));
    let constant = vec![1.0; k];
    let over =
        |heights: &[f64], level: &[f64]| -> f64 { heights.iter().zip(level).map(|(h, l)| h * l).sum() };
    let (n, tilt) = (over(&constant, &levels[0]), over(knots, &levels[1]));
    let (mean, lean) = (over(um, &levels[0]) / n.max(1e-300), over(um, &levels[1]));
    let slope = if tilt.abs() > 1e-12 { lean / tilt } else { 0.0 };
    let middle = over(knots, &levels[0]) / n.max(1e-300);
    let of = |(i, u): (usize, &f64)| (heights * width + i, u - mean - slope * (knots[i] - middle));
    vec![um.iter().enumerate().map(of).collect()]
}

/// The parameters of the model's effects, linearised at `now`; `file` holds the values the file gives. `noise`: its
/// size in units of the stack's. Beside them the constants of records that do not share the gauges' zero.
pub(crate) fn known(stack: &Stack<'_>, noise: f64, file: &[Effect], now: &[Effect]) -> Vec<Known> {
    let mut out = Vec::new();
    for (e, (effect, listed)) in now.iter().zip(file).enumerate() {
        let mut size = stack.predict([effect]);
        stack.weigh(&mut size);
        let size = rms(&size);
        let slopes = stack.slopes(effect);
        let map = leaves_a_line(effect);
        for along in ways(stack, effect) {
            let mut column = vec![0.0; stack.n];
            for (v, weight) in &along {
                column.iter_mut().zip(&slopes[*v]).for_each(|(c, s)| *c += weight * s);
            }
            stack.weigh(&mut column);
            let reach = rms(&column);
            if reach < 1e-12 {
                continue;
            }
            let bent =
                |v: usize| effect.description().parameters[v / effect.width()].search != Search::Linear;
            let trust = if along.iter().any(|(v, _)| bent(*v)) { TRUST_BENT } else { TRUST };
            // A map moves by a share of itself, whatever part of it the rows show.
            let share = if map { trust } else { trust * size / reach };
            let sd = share.max(ERRORS * noise / (stack.n as f64).sqrt() / reach);
            let squares: f64 = along.iter().map(|(_, w)| w * w).sum();
            let off = |(v, w): &(usize, f64)| w * (listed.values()[*v] - effect.values()[*v]);
            let target = along.iter().map(off).sum::<f64>() / squares.max(1e-300);
            out.push(Known { effect: Some(e), along, column, sd, target });
        }
    }
    for mut column in stack.zeros() {
        stack.weigh(&mut column);
        let sd = ANYWHERE * noise / rms(&column).max(1e-300);
        out.push(Known { effect: None, along: Vec::new(), column, sd, target: 0.0 });
    }
    out
}

pub(crate) fn rms(v: &[f64]) -> f64 {
    (crate::lanes::dot(v, v) / v.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{axis, column, record};
    use rtec_model::effect::Dictionary;
    use rtec_model::record::Kind;
    use std::path::Path;

    fn effect(name: &str, values: &[f64]) -> Effect {
        let mut effect = Dictionary::default().effect(name).unwrap();
        effect.set_values(values).unwrap();
        effect
    }

    /// Two records, one with two responses: the rows of a response stand together, weighed each by its own noise.
    #[test]
    fn responses_stand_one_under_the_other() {
        let y = rtec_model::record::Axis::new("y").unwrap();
        let columns = vec![
            column("p", Role::Position(axis()), vec![0.0, 100.0]),
            column("ex", Role::Error(axis()), vec![1.0, 2.0]),
            column("ey", Role::Error(y), vec![5.0, 6.0]),
        ];
        let two = Record::new(Path::new("two.run.toml"), Kind::Plate, columns).unwrap();
        let records = [two, record(3, |i| 10.0 * i)];
        let mut stack = Stack::new(&records);
        assert_eq!(stack.measured, [1.0, 2.0, 0.0, 10.0, 20.0, 5.0, 6.0]);
        assert_eq!((stack.rows(0), stack.rows(1), stack.n), (0..5, 5..7, 7));
        stack.sigma = vec![2.0, 5.0];
        let mut weighed = stack.measured.clone();
        stack.weigh(&mut weighed);
        assert_eq!(weighed, [0.5, 1.0, 0.0, 5.0, 10.0, 1.0, 1.2]);
        // A scale of x does nothing to y.
        let missing = stack.missing(&[effect("scale.x", &[10.0])]);
        assert!((missing[1] - 1.0).abs() < 1e-12 && missing[5..] == [5.0, 6.0], "{missing:?}");
    }

    #[test]
    fn a_map_moves_without_its_constant_and_its_straight_line() {
        let map = effect("position_map.x", &[0.0, 30.0, 60.0, 100.0, 1.0, -1.0, 2.0, 0.0]);
        let free = free_directions(&map.constraints(), 4);
        assert_eq!(free.len(), 2);
        for (i, v) in free.iter().enumerate() {
            assert!(v.iter().sum::<f64>().abs() < 1e-12);
            for (j, w) in free.iter().enumerate() {
                let d: f64 = v.iter().zip(w).map(|(a, b)| a * b).sum();
                assert!((d - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        let records = [record(200, |i| i)];
        let stack = Stack::new(&records);
        assert_eq!(stack.basis(&map).len(), 2);
    }

    /// A row that rounding alone puts beside a knot says nothing of the next one's height: it was 10¹⁷ µm once, which no machine
    /// has, and the map was no name.
    #[test]
    fn a_height_that_no_row_is_near_stays_where_it_is() {
        let knots = [0.0, 20.0, 40.0, 60.0, 65.0, 70.0, 90.0, 100.0];
        let values: Vec<f64> = knots.into_iter().chain(knots.map(|k| 66.0 - k)).collect();
        let map = effect("position_map.x", &values);
        for (beside_mm, unmoved) in [(1e-12, 1), (2.0, 0)] {
            let mut run = record(200, |i| i);
            for p in &mut run.columns[1].data {
                *p = (*p / 10.0).round() * 10.0;
            }
            run.columns[1].data[7] = 60.0 + beside_mm;
            let records = [run];
            let columns = Stack::new(&records).basis(&map);
            let none = columns.iter().filter(|c| c.iter().all(|x| *x == 0.0)).count();
            assert_eq!((columns.len(), none), (6, unmoved), "a row {beside_mm} mm beside the knot at 60");
        }
    }

    /// What the file says counts: a value at another point is pulled back to the file's by as much as it is off.
    #[test]
    fn the_model_s_parameters_are_known_with_their_trust() {
        let records = [record(100, |i| i)];
        let stack = Stack::new(&records);
        let (file, now) = (effect("scale.x", &[50.0]), effect("scale.x", &[60.0]));
        let known = known(&stack, 1.0, &[file], &[now]);
        assert_eq!((known.len(), known[0].target), (1, -10.0));
        // 0.3 of what the effect does, in its own unit.
        assert!((known[0].sd - TRUST * 60.0).abs() < 1e-9, "{}", known[0].sd);
    }
}
