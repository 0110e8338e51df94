//! Everything that a model may lack: effects of the dictionary, and unnamed shapes.
//! Each is a family of hypotheses over its non-linear parameters. Effects that the rows cannot show are left
//! out.

use crate::gaussian_process::{Kernel, directions, knots, shares};
use crate::hypothesis_column_bank::HypothesisColumnBank;
use crate::hypothesis_contribution::{HypothesisContribution, UnnamedShape, sizes};
use crate::priors::{IMPLAUSIBLE, JUMP_UM_PROBABILITY, KNOTS, LENGTHS, NAMED_SHARE, PAIR_SHARE, PRICE};
use crate::rows_and_noise::{MeasuredRows, ResponseSegment, is_placed};
use crate::set_up_terms;
use crate::unnamed_shapes::shapes;
use crate::wave_periodogram::Periodogram;
use rtec_model::effect::{
    AffectedQuantity, Dictionary, Effect, ParameterFitMethod, ParameterRefinement, RequiredInput,
    SearchGridPoint, TemperatureDifference, ThermalDependence,
};
use rtec_model::record::{Axis, Record, Role};
use std::sync::Arc;

/// One name, or one shape.
#[derive(Debug)]
pub struct HypothesesOfOneName {
    /// An effect without its sensor and values; `None` for a shape.
    pub effect: Option<Effect>,
    /// Index of the model's effect that it replaces.
    pub replaces: Option<usize>,
    /// The shape; `None` for an effect.
    pub shape: Option<UnnamedShape>,
    /// It belongs to the instrument, so it is never reported as missing.
    pub set_up: bool,
    /// Log prior of the name.
    pub prior: f64,
    /// Where its members are searched.
    pub scan: HypothesisSearchSpace,
}

/// Where the members of a family are searched.
#[derive(Debug)]
pub enum HypothesisSearchSpace {
    /// A group of columns for each point of a grid, with its log weight.
    Grid(Vec<(usize, f64, HypothesisContribution)>),
    /// Temperature differences.
    /// For each time constant it has a group with a column for each sensor, alone or against another.
    Sensors {
        /// The sensors' names.
        sensors: Vec<String>,
        /// Group, log weight of the time constant, effect.
        points: Vec<(usize, f64, Effect)>,
    },
    /// A wave that accompanies other waves, with their periods.
    Beside {
        /// The law of the other waves.
        law: &'static str,
        /// Periods of the model's own waves.
        known: Vec<f64>,
    },
    /// A wave of any period.
    Wave {
        /// The variable it runs along.
        along: Periodogram,
        /// Unit of the period in that of the variable.
        unit: f64,
    },
}

impl HypothesesOfOneName {
    fn unnamed(shape: UnnamedShape, scan: HypothesisSearchSpace) -> Self {
        Self { effect: None, replaces: None, shape: Some(shape), set_up: false, prior: 0.0, scan }
    }

    /// Whether it is an effect of the dictionary.
    #[must_use]
    pub fn is_named(&self) -> bool {
        self.effect.is_some()
    }

    /// Name of the effect, or the variables of the shape.
    #[must_use]
    pub fn label(&self) -> String {
        match (&self.effect, &self.shape) {
            (Some(e), _) => e.name(),
            (None, Some(s)) => s.label(),
            (None, None) => String::new(),
        }
    }

    /// Whether several of its members may act at once.
    #[must_use]
    pub fn repeats(&self) -> bool {
        self.effect.as_ref().is_some_and(|e| e.description().searched.repeats || e.delta.is_some())
            || matches!(self.scan, HypothesisSearchSpace::Sensors { .. })
    }
}

/// All families, and the columns of those on a fixed grid.
#[derive(Debug)]
pub struct CandidateHypotheses {
    /// The families.
    pub list: Vec<HypothesesOfOneName>,
    /// Their columns.
    pub bank: HypothesisColumnBank,
}

impl CandidateHypotheses {
    /// All families that these rows could show in addition to a model.
    #[must_use]
    pub fn new(rows: &MeasuredRows<'_>, dictionary: &Dictionary, model: &[Effect]) -> Self {
        let mut all = Self { list: Vec::new(), bank: HypothesisColumnBank::new(rows.n) };
        let mut candidates: Vec<Effect> = Vec::new();
        for record in rows.records {
            for effect in dictionary.candidates(&[record]) {
                let effect = effect.in_order();
                if !candidates.iter().any(|c| c.name() == effect.name() && c.delta == effect.delta) {
                    candidates.push(effect);
                }
            }
        }
        let mut names: Vec<String> = Vec::new();
        for effect in &candidates {
            let name = effect.name();
            if !names.contains(&name) {
                names.push(name.clone());
                let own: Vec<&Effect> = candidates.iter().filter(|c| c.name() == name).collect();
                all.effect(rows, &own, model);
            }
        }
        for (place, effect) in model.iter().enumerate() {
            all.replaced(rows, place, effect);
        }
        let named = all.list.len();
        for (shape, columns) in shapes(rows) {
            let cause = HypothesisContribution::Shape(Arc::new((shape.clone(), columns.clone())));
            let group = all.bank.push(columns);
            let scan = HypothesisSearchSpace::Grid(vec![(group, 0.0, cause)]);
            all.list.push(HypothesesOfOneName::unnamed(shape, scan));
        }
        all.unnamed_waves(rows);
        let shapes = all.list.len() - named;
        for (i, f) in all.list.iter_mut().enumerate() {
            let (share, of) = if i < named { (NAMED_SHARE, named) } else { (1.0 - NAMED_SHARE, shapes) };
            f.prior += share.ln() - (of as f64).ln() - PRICE;
        }
        for t in set_up_terms::jumps(rows) {
            let segment = rows.segments.iter().find(|s| t.column[s.rows.end - 1] != 0.0);
            let response = segment.map_or(String::new(), |s| rows.responses[s.response].to_string());
            let shape = UnnamedShape {
                response,
                against: vec!["time".to_owned()],
                manner: "a jump at a pause".to_owned(),
            };
            let columns = vec![t.column.iter().map(|x| x * JUMP_UM_PROBABILITY.0).collect::<Vec<f64>>()];
            let cause = HypothesisContribution::Shape(Arc::new((shape.clone(), columns.clone())));
            let scan = HypothesisSearchSpace::Grid(vec![(all.bank.push(columns), 0.0, cause)]);
            let prior = JUMP_UM_PROBABILITY.1.ln();
            all.list.push(HypothesesOfOneName {
                set_up: true,
                prior,
                ..HypothesesOfOneName::unnamed(shape, scan)
            });
        }
        all
    }

    fn push(&mut self, effect: &Effect, scan: HypothesisSearchSpace) {
        let mut effect = effect.clone();
        effect.delta = None;
        let prior = -effect.description().searched.price;
        self.list.push(HypothesesOfOneName {
            effect: Some(effect),
            replaces: None,
            shape: None,
            set_up: false,
            prior,
            scan,
        });
    }

    /// Adds a family for a known effect of the model that has changed.
    fn replaced(&mut self, rows: &MeasuredRows<'_>, place: usize, effect: &Effect) {
        let free = effect.coefficient_count();
        if free > 4 {
            return;
        }
        let cause = HypothesisContribution::Effect { effect: effect.clone(), free, reference: false };
        let columns = cause.columns(rows);
        if columns.iter().all(|c| c.iter().all(|x| *x == 0.0)) {
            return;
        }
        let group = self.bank.push(columns);
        let prior = crate::priors::KNOWN_REPLACED.ln() + PRICE;
        self.list.push(HypothesesOfOneName {
            effect: Some(effect.clone()),
            replaces: Some(place),
            shape: None,
            set_up: false,
            prior,
            scan: HypothesisSearchSpace::Grid(vec![(group, 0.0, cause)]),
        });
    }

    #[allow(clippy::too_many_lines)] // one arm for each way in which a law is looked for
    fn effect(&mut self, rows: &MeasuredRows<'_>, own: &[&Effect], model: &[Effect]) {
        let effect = own[0];
        let law = effect.description();
        if law.constant && law.quantity == AffectedQuantity::Error {
            // Every gauge has its own zero, so a constant cannot be attributed to the machine.
            return;
        }
        let known = |e: &Effect| {
            model.iter().any(|m| {
                m.name() == e.name()
                    && m.delta.as_ref().map(|d| &d.sensor) == e.delta.as_ref().map(|d| &d.sensor)
            })
        };
        let reads = |n: RequiredInput| law.needs.contains(&n);
        if let Some(beside) =
            law.searched.beside.filter(|_| law.place(ParameterFitMethod::Amplitude).is_some())
        {
            let same = |m: &&Effect| m.description().name == beside && m.axes() == effect.axes();
            let known = model.iter().filter(same).map(|m| m.scalar(0)).collect();
            self.push(effect, HypothesisSearchSpace::Beside { law: beside, known });
            return;
        }
        if let Some(facts) = law.searched.wave {
            let axis = effect.axes()[0].clone();
            let Some(share) = rows.share(&axis) else { return };
            let mut along = Vec::new();
            for s in &rows.segments {
                let record = rows.record(s);
                let Some(p) =
                    record.data(&Role::Position(axis.clone())).filter(|_| is_placed(record, effect))
                else {
                    continue;
                };
                for (i, p) in p.iter().enumerate() {
                    let row = s.rows.start + i;
                    if share[row] != 0.0 {
                        along.push((row, *p, share[row]));
                    }
                }
            }
            let [lo, hi] = law.parameters[0].bounds;
            let mut range = [1.0 / (hi * facts.unit_mm), 1.0 / (lo * facts.unit_mm)];
            if let (Some(steps), Some(step)) = (facts.steps, step_of(&along)) {
                range[1] = range[1].min(1.0 / (steps * step));
            }
            if let Some(along) = Periodogram::new(along, range) {
                self.push(effect, HypothesisSearchSpace::Wave { along, unit: facts.unit_mm });
            }
            return;
        }
        if reads(RequiredInput::Delta)
            && matches!(law.heat, ThermalDependence::Growth | ThermalDependence::Expansion)
        {
            let mut sensors: Vec<String> = Vec::new();
            for d in own.iter().filter_map(|e| e.delta.as_ref()) {
                for s in d.sensors().map(str::to_owned) {
                    if !sensors.contains(&s) {
                        sensors.push(s);
                    }
                }
            }
            let mut points = Vec::new();
            let grid = effect.grid(rows);
            let even = -(grid.len() as f64).ln();
            for SearchGridPoint { effect, .. } in grid {
                let weight = even + implausible(&effect);
                if weight == f64::NEG_INFINITY {
                    continue;
                }
                let mut columns = Vec::new();
                for s in &sensors {
                    let mut e = effect.clone();
                    e.delta = Some(TemperatureDifference::single(s));
                    let mut c = rows.basis(&e).swap_remove(0);
                    let size = sizes(&e)[0];
                    for x in &mut c {
                        *x *= size;
                    }
                    columns.push(c);
                }
                if columns.iter().all(|c| c.iter().all(|x| *x == 0.0)) {
                    continue;
                }
                let group = self.bank.push(columns);
                points.push((group, weight, effect));
            }
            if !points.is_empty() {
                self.push(effect, HypothesisSearchSpace::Sensors { sensors, points });
            }
            return;
        }
        let mut grid = Vec::new();
        for effect in own
            .iter()
            .filter(|e| !known(e) || e.description().searched.repeats || !e.constraints().is_empty())
        {
            if !effect.constraints().is_empty() {
                grid.extend(maps(rows, effect));
                continue;
            }
            let points = effect.grid(rows);
            let weight = -(own.len() as f64).ln();
            for SearchGridPoint { effect, price } in points {
                let free = effect.coefficient_count();
                let weight = weight + implausible(&effect);
                grid.push((
                    weight - price,
                    HypothesisContribution::Effect { effect, free, reference: false },
                ));
            }
        }
        let mut points = Vec::new();
        for (weight, cause) in grid.into_iter().filter(|g| g.0.is_finite()) {
            let columns = cause.columns(rows);
            if columns.iter().any(|c| c.iter().any(|x| *x != 0.0)) {
                points.push((self.bank.push(columns), weight, cause));
            }
        }
        if !points.is_empty() {
            self.push(effect, HypothesisSearchSpace::Grid(points));
        }
    }

    /// Adds waves without a name.
    /// They run over time, over the position of a force's axis (cogging, teeth), or along an axis if the circle's
    /// position on it is unknown.
    fn unnamed_waves(&mut self, rows: &MeasuredRows<'_>) {
        let in_time = |r: &Record| Some((r.time_s().to_vec(), vec![1.0; r.rows()]));
        for j in 0..rows.responses.len() {
            let own: Vec<&ResponseSegment> = rows.segments.iter().filter(|s| s.response == j).collect();
            self.unnamed_wave(rows, j, "time", &own, &in_time);
            // What vibrates or switches in one record need not do so in another, and never in step.
            for alone in own.chunks(1).filter(|_| own.len() > 1) {
                self.unnamed_wave(rows, j, "time", alone, &in_time);
            }
            if let Role::Force(axis) = &rows.responses[j] {
                let place = Role::Position(axis.clone());
                let along = |r: &Record| Some((r.data(&place)?.to_vec(), vec![1.0; r.rows()]));
                self.unnamed_wave(rows, j, &place.to_string(), &own, &along);
            }
            if !matches!(&rows.responses[j], Role::Error(axis) if axis.as_str() == "r") {
                continue;
            }
            let circles = rows.records.iter().filter(|r| !r.knows_places()).filter_map(Record::circle);
            let mut axes: Vec<&Axis> = circles.flat_map(|c| &c.plane).collect();
            axes.sort();
            axes.dedup();
            for axis in axes {
                let along = |r: &Record| {
                    let circle = r.circle().filter(|_| !r.knows_places())?;
                    let number = circle.plane.iter().position(|a| a == axis)?;
                    let share = |a: &f64| [a.cos(), a.sin()][number];
                    let share: Vec<f64> = r.data(&Role::Angle)?.iter().map(share).collect();
                    Some((share.iter().map(|s| circle.radius_mm * s).collect(), share))
                };
                self.unnamed_wave(rows, j, &format!("position.{axis}"), &own, &along);
            }
        }
    }

    /// Adds a wave without a name in these segments of one response.
    /// `of` gives the positions of a record's rows, and the share of the wave that each shows.
    fn unnamed_wave(
        &mut self,
        rows: &MeasuredRows<'_>,
        response: usize,
        against: &str,
        segments: &[&ResponseSegment],
        of: &dyn Fn(&Record) -> Option<Shown>,
    ) {
        let mut along = Vec::new();
        let mut fastest = 0.0_f64;
        for s in segments {
            let Some((places, shares)) = of(rows.record(s)) else { continue };
            let way: f64 = places.windows(2).map(|p| (p[1] - p[0]).abs()).sum();
            if way > 0.0 {
                fastest = fastest.max(0.25 * places.len() as f64 / way);
            }
            for (i, (place, share)) in places.iter().zip(&shares).enumerate() {
                along.push((s.rows.start + i, *place, *share));
            }
        }
        let Some(along) = Periodogram::new(along, [0.0, fastest]) else { return };
        let response = rows.responses[response].to_string();
        let shape =
            UnnamedShape { response, against: vec![against.to_owned()], manner: "periodic".to_owned() };
        self.list.push(HypothesesOfOneName::unnamed(shape, HypothesisSearchSpace::Wave { along, unit: 1.0 }));
    }

    /// Log prior share of each of `n` sensors alone, and of each pair.
    #[must_use]
    pub fn sensor_weights(sensors: usize) -> [f64; 2] {
        let n = sensors as f64;
        if sensors < 2 {
            return [0.0, f64::NEG_INFINITY];
        }
        [((1.0 - PAIR_SHARE) / n).ln(), (PAIR_SHARE / (0.5 * n * (n - 1.0))).ln()]
    }
}

/// Positions of a record's rows, and the share of a wave that each shows.
type Shown = (Vec<f64>, Vec<f64>);

/// Log prior penalty of a time constant outside the plausible range.
/// No part of a machine is faster, and few are slower.
fn implausible(effect: &Effect) -> f64 {
    let of = |(i, p): (usize, &rtec_model::effect::LawParameter)| {
        let [shortest, longest] = p.plausible;
        match (p.refine, p.array) {
            (ParameterRefinement::TimeConstant(_), false) if effect.scalar(i) < shortest => f64::NEG_INFINITY,
            (ParameterRefinement::TimeConstant(_), false) if effect.scalar(i) > longest => -IMPLAUSIBLE,
            _ => 0.0,
        }
    };
    effect.description().parameters.iter().enumerate().map(of).sum()
}

/// The step of which all distances of positions are multiples, mm.
/// Positions are written to a nanometre at most.
fn step_of(along: &[(usize, f64, f64)]) -> Option<f64> {
    let nm = |place: f64| (place * 1e6).round() as i64;
    let first = nm(along.first()?.1);
    let common = along.iter().fold(0, |common, r| gcd(common, (nm(r.1) - first).abs()));
    (common > 0).then_some(common as f64 * 1e-6)
}

/// The greatest common divisor (Euclid).
const fn gcd(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// A map on the measured positions, as long and as short waves.
fn maps(rows: &MeasuredRows<'_>, effect: &Effect) -> Vec<(f64, HypothesisContribution)> {
    use rtec_model::effect::RecordExtent as _;
    // Its knots are on the last axis of its name.
    let Some(axis) = effect.axes().last() else { return Vec::new() };
    let mut knots = knots(&rows.places_mm(axis), KNOTS);
    let k = knots.len();
    if k < 4 {
        return Vec::new();
    }
    // Positions close together are merged. The end knots keep the extreme positions, since a map is constant
    // beyond them.
    let of = |record: &Record| record.data(&Role::Position(axis.clone())).map(<[f64]>::to_vec);
    for p in rows.records.iter().filter(|r| r.knows_places()).filter_map(of).flatten() {
        (knots[0], knots[k - 1]) = (knots[0].min(p), knots[k - 1].max(p));
    }
    let range = knots[k - 1] - knots[0];
    // Constant and straight line over the rows belong to other effects.
    let mut without = vec![vec![0.0; k]; 2];
    for s in &rows.segments {
        let record = rows.record(s);
        let acts = effect.acts_on(record).iter().any(|(r, _)| *r == rows.responses[s.response]);
        let Some(p) =
            record.data(&Role::Position(axis.clone())).filter(|_| acts && is_placed(record, effect))
        else {
            continue;
        };
        for p in p {
            for (i, w) in shares(&knots, *p) {
                without[0][i] += w;
                without[1][i] += w * (p - knots[0]) / range;
            }
        }
    }
    let heights = vec![0.0; k];
    let Some(effect) = effect.with_values(&[knots.clone(), heights].concat()) else { return Vec::new() };
    let lengths = LENGTHS.map(|share| share * range);
    let (smooth, kinked) = (lengths.map(Kernel::Smooth), lengths.map(Kernel::Kinked));
    let kernels = [&smooth[..], &kinked, &[Kernel::Rough(range)]].concat();
    kernels
        .iter()
        .map(|kernel| {
            let found = directions(&knots, *kernel, &without, KNOTS);
            (
                -(kernels.len() as f64).ln(),
                HypothesisContribution::Map { effect: effect.clone(), directions: Arc::new(found) },
            )
        })
        .collect()
}
