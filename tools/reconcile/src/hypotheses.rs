//! What may be missing: every effect of the dictionary that these runs could show, over a grid of its non-linear
//! parameters, and shapes of no name that stand for "something else".

use crate::gram::{Bank, Products};
use crate::problem::Stack;
use rtec_model::effect::{self, Description, Dictionary, Difference, Effect, Extent, Point, Quantity};
use rtec_model::record::{Axis, Record, Role};
use std::f64::consts::TAU;
use std::ops::Range;

/// A shape that is in no dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The response it is seen in.
    pub response: String,
    /// What it runs along: roles, as in `where`.
    pub against: Vec<String>,
    /// In words: smooth, periodic, differs by direction, …
    pub manner: String,
}

/// An explanation.
#[derive(Debug, Clone)]
pub(crate) enum Cause {
    /// An effect with its non-linear parameters set; which coefficients are free, and whether its reference
    /// temperature is.
    Effect { effect: Effect, free: Vec<usize>, reference: bool },
    /// No effect of the dictionary.
    Shape(Shape),
    /// The same, of a kind whose turns and phase are refined.
    Teeth(Shape, Teeth),
}

impl Cause {
    /// The shape, where it is no effect of the dictionary.
    pub(crate) fn shape(&self) -> Option<&Shape> {
        match self {
            Self::Effect { .. } => None,
            Self::Shape(s) | Self::Teeth(s, _) => Some(s),
        }
    }
}

/// Saw teeth or square steps that repeat over the time of all records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Teeth {
    pub(crate) response: usize,
    pub(crate) saw: bool,
    /// How often they repeat.
    pub(crate) turns: f64,
    /// Where in a turn the first row lies.
    pub(crate) phase: f64,
}

impl Teeth {
    /// Its column, not weighed.
    pub(crate) fn column(&self, stack: &Stack<'_>) -> Vec<f64> {
        let [lo, hi] = stack.time_s;
        let span = (hi - lo).max(1e-300);
        stack.column(Some(self.response), |record, row| {
            let place = (self.turns * (record.time_s()[row] - lo) / span + self.phase).rem_euclid(1.0);
            if self.saw {
                place - 0.5
            } else if place < 0.5 {
                0.5
            } else {
                -0.5
            }
        })
    }
}

/// An explanation with its columns.
#[derive(Debug, Clone)]
pub(crate) struct Atom {
    pub(crate) cause: Cause,
    /// Columns in the bank.
    pub(crate) columns: Vec<usize>,
    /// Which hypothesis it is a grid point of.
    pub(crate) hypothesis: usize,
    /// log of the number of distinguishable grid points (times the share of its family): the price of searching.
    pub(crate) cost: f64,
}

/// One hypothesis: one name with its sensors.
#[derive(Debug, Clone)]
pub(crate) struct Hypothesis {
    pub(crate) name: String,
    /// The effect with its sensors; none for a shape.
    pub(crate) effect: Option<Effect>,
}

impl Hypothesis {
    /// Whether it is an effect of the dictionary.
    pub(crate) fn named(&self) -> bool {
        self.effect.is_some()
    }

    /// Its law, where it has one.
    pub(crate) fn law(&self) -> Option<&Description> {
        self.effect.as_ref().map(Effect::description)
    }

    /// The temperature difference that it reads.
    pub(crate) fn sensor(&self) -> Option<&Difference> {
        self.effect.as_ref()?.delta.as_ref()
    }

    /// Whether it is the zero of an axis.
    pub(crate) fn is_offset(&self) -> bool {
        self.law().is_some_and(|l| l.constant && l.quantity == Quantity::Error)
    }

    /// Name and sensors, as one text.
    pub(crate) fn label(&self) -> String {
        match self.sensor() {
            Some(d) => format!("{} ({d})", self.name),
            None => self.name.clone(),
        }
    }
}

/// All explanations that are tried over a grid.
#[derive(Debug, Default)]
pub(crate) struct Hypotheses {
    pub(crate) list: Vec<Hypothesis>,
    pub(crate) atoms: Vec<Atom>,
    pub(crate) bank: Bank,
    /// Products among the columns of each atom, packed by rows of the lower triangle.
    pub(crate) own: Vec<Vec<Products>>,
    /// Price of the family choice alone, per law and per shape.
    pub(crate) family_cost: f64,
}

/// A variable that a periodic effect or shape runs along, for the search of its period.
#[derive(Debug, Clone)]
pub(crate) struct Wave {
    pub(crate) hypothesis: usize,
    pub(crate) effect: Option<Effect>,
    pub(crate) shape: Option<Shape>,
    /// The rows of its response.
    pub(crate) rows: Range<usize>,
    /// The variable at those rows.
    pub(crate) along: Vec<f64>,
    /// The same in rising order, each value once.
    pub(crate) places: Vec<f64>,
    /// Frequencies to search, in periods per unit of the variable.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Unit of the period parameter in units of the variable.
    pub(crate) unit: f64,
}

impl Wave {
    fn new(stack: &Stack<'_>, hypothesis: usize, response: usize, along: &[f64], from: f64, to: f64) -> Self {
        let rows = stack.rows(response);
        let along = along[rows.clone()].to_vec();
        let mut places = along.clone();
        places.sort_by(f64::total_cmp);
        places.dedup();
        Self { hypothesis, effect: None, shape: None, rows, along, places, from, to, unit: 1.0 }
    }

    /// The variable's extent.
    pub(crate) fn span(&self) -> f64 {
        span(&self.places)
    }
}

/// Either half of a channel's range is divided into so many parts; a knee is tried where they meet.
const KNEES: i32 = 5;
/// What an explanation without a name costs beyond one with a name.
const SHAPE_COST: f64 = 2.0;

impl Hypotheses {
    pub(crate) fn new(stack: &Stack<'_>, dictionary: &Dictionary) -> (Self, Vec<Wave>) {
        let mut all = Self { bank: Bank::new(&stack.ranges), ..Self::default() };
        let mut waves = Vec::new();
        let mut candidates: Vec<Effect> = Vec::new();
        for record in stack.records {
            for effect in dictionary.candidates(&[record]) {
                let effect = effect.in_order();
                if !candidates.iter().any(|c| c.name() == effect.name() && c.delta == effect.delta) {
                    candidates.push(effect);
                }
            }
        }
        let laws: Vec<String> = candidates.iter().map(|c| c.description().name.clone()).collect();
        let mut families = laws.clone();
        families.sort();
        families.dedup();
        all.family_cost = (families.len().max(1) as f64).ln();
        for effect in &candidates {
            // Without movement of what it reads an effect is a constant, or nothing.
            let share = laws.iter().filter(|l| **l == effect.description().name).count() as f64;
            let cost = all.family_cost + share.ln();
            all.effect(stack, effect, cost, &mut waves);
        }
        all.shapes(stack, &mut waves);
        all.square();
        (all, waves)
    }

    fn square(&mut self) {
        self.own = self.atoms.iter().map(|a| self.bank.own(&a.columns)).collect();
    }

    /// Only the periods near a periodic effect's own: 3 % either way.
    pub(crate) fn periods(stack: &Stack<'_>, effect: &Effect) -> (Self, Vec<Wave>) {
        let mut all = Self { bank: Bank::new(&stack.ranges), ..Self::default() };
        let mut waves = Vec::new();
        all.effect(stack, effect, 0.0, &mut waves);
        for w in &mut waves {
            let own = 1.0 / (effect.scalar(0) * w.unit);
            (w.from, w.to) = (own * 0.97, own * 1.03);
        }
        all.square();
        (all, waves)
    }

    fn hypothesis(&mut self, effect: &Effect) -> usize {
        self.list.push(Hypothesis { name: effect.name(), effect: Some(effect.clone()) });
        self.list.len() - 1
    }

    fn push(&mut self, stack: &Stack<'_>, mut column: Vec<f64>) -> usize {
        stack.weigh(&mut column);
        self.bank.push(&column)
    }

    fn effect(&mut self, stack: &Stack<'_>, effect: &Effect, cost: f64, waves: &mut Vec<Wave>) {
        if let Some(facts) = effect.description().searched.wave {
            waves.extend(self.wave(stack, effect, &facts));
            return;
        }
        let hypothesis = self.hypothesis(effect);
        for Point { effect, price } in effect.grid(stack) {
            self.point(stack, hypothesis, &effect, cost + effect.description().searched.price + price);
        }
    }

    /// The search of a wave's period.
    fn wave(&mut self, stack: &Stack<'_>, effect: &Effect, facts: &effect::Wave) -> Option<Wave> {
        let response = response_of(stack, effect)?;
        let axis = effect.axes()[0].clone();
        let along = stack
            .column(Some(response), |r, row| r.data(&Role::Position(axis.clone())).map_or(0.0, |p| p[row]));
        let h = self.hypothesis(effect);
        let [lo, hi] = effect.description().parameters[0].bounds;
        let (from, to) = (1.0 / (hi * facts.unit_mm), 1.0 / (lo * facts.unit_mm));
        let mut wave = Wave::new(stack, h, response, &along, from, to);
        if let (Some(steps), Some(step)) = (facts.steps, resolution(&wave.places)) {
            // What is finer than the positions are read cannot be told from something coarser.
            let finest = 1.0 / (steps * step);
            wave.to = if finest > from { to.min(finest) } else { to };
        }
        Some(Wave { effect: Some(effect.clone()), unit: facts.unit_mm, ..wave })
    }

    /// A grid point: one atom for each choice of free coefficients.
    fn point(&mut self, stack: &Stack<'_>, hypothesis: usize, effect: &Effect, cost: f64) {
        let columns: Vec<usize> = stack.basis(effect).into_iter().map(|c| self.push(stack, c)).collect();
        let pair = effect.delta.as_ref().is_some_and(Difference::is_pair);
        let mut level = None;
        for choice in &effect.description().searched.choices {
            if choice.reference && pair {
                continue;
            }
            let free: Vec<usize> = (0..choice.coefficients.unwrap_or(columns.len())).collect();
            let mut own = columns[..free.len()].to_vec();
            if choice.reference {
                own.push(*level.get_or_insert_with(|| self.push(stack, reference_column(stack, effect))));
            }
            let cause = Cause::Effect { effect: effect.clone(), free, reference: choice.reference };
            self.atoms.push(Atom { cause, columns: own, hypothesis, cost: cost + choice.price });
        }
    }

    /// Shapes without a name, over every channel and the products that physics suggests.
    fn shapes(&mut self, stack: &Stack<'_>, waves: &mut Vec<Wave>) {
        let mut made: Vec<(Cause, Vec<usize>, f64)> = Vec::new();
        for j in 0..stack.responses.len() {
            self.shapes_of(stack, j, &mut made, waves);
        }
        // Grid points of one shape stand one after the other.
        let count =
            made.iter().zip(made.iter().skip(1)).filter(|(a, b)| a.0.shape() != b.0.shape()).count() + 1;
        let price = self.family_cost + SHAPE_COST + (count as f64).ln();
        let mut last: Option<Shape> = None;
        for (cause, columns, grid) in made {
            let Some(shape) = cause.shape() else { continue };
            let cost = price + grid;
            if last.as_ref() != Some(shape) {
                let name = format!("unnamed {}", shape.against.join("·"));
                self.list.push(Hypothesis { name, effect: None });
                last = Some(shape.clone());
            }
            let h = self.list.len() - 1;
            self.atoms.push(Atom { cause, columns, hypothesis: h, cost });
        }
    }

    fn shapes_of(
        &mut self,
        stack: &Stack<'_>,
        j: usize,
        made: &mut Vec<(Cause, Vec<usize>, f64)>,
        waves: &mut Vec<Wave>,
    ) {
        let role = &stack.responses[j];
        let Some(axis) = role.axis().cloned() else { return };
        let force = matches!(role, Role::Force(_));
        let records: Vec<&Record> =
            stack.segments.iter().filter(|s| s.response == j).map(|s| stack.record(s)).collect();
        let has = |r: &Role| records.iter().all(|rec| rec.column(r).is_some());
        let get =
            |r: Role| has(&r).then(|| stack.column(Some(j), |rec, row| rec.data(&r).map_or(0.0, |d| d[row])));
        let response = role.to_string();
        let rows: Vec<usize> = stack.rows(j).collect();
        let n = rows.len();
        let time = stack.column(Some(j), |rec, row| rec.time_s()[row]);
        for (saw, manner) in [(true, "saw teeth"), (false, "repeated steps")] {
            let shape =
                Shape { response: response.clone(), against: vec!["time".into()], manner: manner.into() };
            for turn in 0..52 {
                let turns = 1.4 * 1.042_f64.powi(turn);
                for phase in 0..6 {
                    // The other half of a turn is the same with the other sign.
                    let phase = f64::from(phase) / if saw { 6.0 } else { 12.0 };
                    let teeth = Teeth { response: j, saw, turns, phase };
                    if n >= 40 {
                        let column = self.push(stack, teeth.column(stack));
                        let cause = Cause::Teeth(shape.clone(), teeth);
                        made.push((cause, vec![column], (n as f64).ln() + 3.0));
                    }
                }
            }
        }
        let mut scalars: Vec<(String, Vec<f64>)> = vec![("time".into(), time.clone())];
        for column in &records[0].columns {
            let own = column.role == Role::Position(axis.clone());
            let wanted = match &column.role {
                Role::Temperature => records.iter().all(|r| r.temperature(&column.name).is_some()),
                Role::Channel => records.iter().all(|r| r.channel(&column.name).is_some()),
                Role::Velocity(a) | Role::Acceleration(a) | Role::Load(a) => *a == axis && has(&column.role),
                Role::SpindleSpeed | Role::Cycle => has(&column.role),
                Role::Position(_) => has(&column.role) && force && own,
                _ => false,
            };
            if !wanted {
                continue;
            }
            let data = stack.column(Some(j), |rec, row| match &column.role {
                Role::Temperature => rec.temperature(&column.name).map_or(0.0, |d| d[row]),
                Role::Channel => rec.channel(&column.name).map_or(0.0, |d| d[row]),
                r => rec.data(r).map_or(0.0, |d| d[row]),
            });
            scalars.push((column.label(), data));
        }
        for (label, data) in scalars.iter().filter(|_| n > 20) {
            let u = centred(data, &rows);
            if u.iter().all(|u| *u == 0.0) {
                continue;
            }
            let shape = Shape {
                response: response.clone(),
                against: vec![label.clone()],
                manner: "straight with a knee".into(),
            };
            let straight = self.push(stack, u.clone());
            for i in 1..2 * KNEES {
                let knee = f64::from(i) / f64::from(KNEES) - 1.0;
                let bent: Vec<f64> = u.iter().map(|u| (u - knee).max(0.0)).collect();
                let bent = self.push(stack, masked(&bent, &rows));
                made.push((Cause::Shape(shape.clone()), vec![bent, straight], f64::from(2 * KNEES - 1).ln()));
            }
        }
        let mut offer = |against: &[&str], manner: &str, columns: Vec<Vec<f64>>, grid: usize| {
            let shape = Shape {
                response: response.clone(),
                against: against.iter().map(|s| (*s).to_owned()).collect(),
                manner: manner.to_owned(),
            };
            if columns.len() + 8 < n / 2 && columns.iter().all(|c| c.iter().any(|x| *x != 0.0)) {
                let columns = columns.into_iter().map(|c| self.push(stack, c)).collect();
                made.push((Cause::Shape(shape), columns, (grid as f64).ln()));
            }
        };
        let hats = |x: &[f64], k: usize| hats(x, &rows, k);
        let times = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).collect::<Vec<f64>>();
        let clock = centred(&time, &rows);
        for width in [0.05, 0.12, 0.3] {
            for i in 0..=24 {
                let centre = -1.0 + f64::from(i) / 12.0;
                let burst: Vec<f64> = clock.iter().map(|u| (-((u - centre) / width).powi(2)).exp()).collect();
                offer(&["time"], "a passing burst", vec![masked(&burst, &rows)], 75);
            }
        }
        for i in 4..30 {
            let turns = f64::from(i) * 0.25;
            let columns = (1..=4)
                .flat_map(|k| {
                    let w = std::f64::consts::PI * turns * f64::from(k);
                    [
                        clock.iter().map(|u| (w * u).sin()).collect::<Vec<f64>>(),
                        clock.iter().map(|u| (w * u).cos()).collect(),
                    ]
                })
                .map(|c| masked(&c, &rows))
                .collect();
            offer(&["time"], "repeats in time", columns, 26);
        }
        let mut add =
            |against: &[&str], manner: &str, columns: Vec<Vec<f64>>| offer(against, manner, columns, 1);
        for (label, data) in &scalars {
            let sizes: &[usize] = if label == "time" { &[5, 8, 12, 20] } else { &[5, 9] };
            for k in sizes {
                add(&[label], "smooth", hats(data, *k));
            }
        }
        let position = get(Role::Position(axis.clone())).map(|p| centred(&p, &rows));
        let velocity = get(Role::Velocity(axis.clone()));
        let direction = get(Role::Direction(axis.clone()))
            .or_else(|| velocity.as_ref().map(|v| v.iter().map(|v| rtec_model::effect::sign(*v)).collect()));
        let (p_name, d_name, v_name) =
            (format!("position.{axis}"), format!("direction.{axis}"), format!("velocity.{axis}"));
        let t0 = centred(&time, &rows);
        if let (Some(p), Some(d)) = (&position, &direction) {
            add(&[&d_name, &p_name], "differs by direction, in proportion to position", vec![times(d, p)]);
            for k in [5, 9] {
                let columns = hats(p, k).iter().map(|h| times(d, h)).chain([d.clone()]).collect();
                add(&[&d_name, &p_name], "differs by direction, smooth", columns);
            }
        }
        if let Some(d) = &direction {
            add(
                &[&d_name, "time"],
                "differs by direction, drifting",
                hats(&time, 5).iter().map(|h| times(d, h)).collect(),
            );
        }
        if let Some(p) = &position {
            add(&[&p_name, "time"], "in proportion to position, drifting", vec![times(p, &t0)]);
            for (label, data) in &scalars {
                if label == "time" || label.starts_with("temperature") || label.starts_with("cycle") {
                    let k = if label == "time" { 7 } else { 5 };
                    let columns = hats(data, k).iter().map(|h| times(p, h)).chain([p.clone()]).collect();
                    add(&[&p_name, label], "in proportion to position, smooth", columns);
                }
            }
            if has(&Role::Position(axis.clone())) {
                for other in records[0]
                    .axes(Role::Position)
                    .filter(|o| **o != axis && has(&Role::Position((*o).clone())))
                {
                    let Some(q) = get(Role::Position(other.clone())) else { continue };
                    let (a, b) = (hats(p, 5), hats(&centred(&q, &rows), 5));
                    let columns = a.iter().flat_map(|x| b.iter().map(|y| times(x, y))).collect();
                    add(&[&p_name, &format!("position.{other}")], "smooth over the plane", columns);
                }
            }
        }
        if let Some(v) = &velocity {
            let top = rows.iter().fold(1e-12_f64, |m, r| m.max(v[*r].abs()));
            let map = |f: &dyn Fn(f64) -> f64| v.iter().map(|v| f(v / top)).collect::<Vec<f64>>();
            add(&[&v_name], "quadratic, with the sign of the velocity", vec![map(&|v| v * v.abs())]);
            add(&[&v_name], "quadratic", vec![map(&|v| v * v)]);
            if !force {
                add(&[&v_name], "in proportion to the speed", vec![map(&f64::abs)]);
            }
            for v0 in [0.05, 0.15, 0.4] {
                let stribeck = move |v: f64| rtec_model::effect::sign(v) * (-(v / v0).powi(2)).exp();
                add(&[&v_name], "at low speed, with the sign of the velocity", vec![map(&stribeck)]);
            }
            if let Some(p) = &position {
                let sign: Vec<f64> = v.iter().map(|v| rtec_model::effect::sign(*v)).collect();
                add(&[&v_name, &p_name], "sign of the velocity times position", vec![times(&sign, p)]);
                add(&[&v_name, &p_name], "velocity times position", vec![times(v, p)]);
            }
        }
        if let Some(f) = get(Role::Load(axis.clone())) {
            let bent: Vec<f64> = f.iter().map(|f| f * f.abs()).collect();
            add(&[&format!("load.{axis}")], "quadratic, with the sign of the load", vec![bent]);
            add(&[&format!("load.{axis}")], "quadratic", vec![times(&f, &f)]);
            if let Some(p) = &position {
                add(&[&format!("load.{axis}"), &p_name], "load times position", vec![times(&f, p)]);
            }
        }
        if let (Some(rpm), Some(wet)) = (get(Role::SpindleSpeed), get(Role::Coolant)) {
            add(
                &["spindle_speed", "coolant"],
                "spindle speed while the coolant is on",
                vec![times(&rpm, &wet)],
            );
        }
        if let Some(angle) = get(Role::Angle) {
            for harmonics in [4, 8] {
                let columns = (1..=harmonics)
                    .flat_map(|k| {
                        let wave = |f: fn(f64) -> f64| {
                            let mut c = vec![0.0; stack.n];
                            rows.iter().for_each(|r| c[*r] = f(f64::from(k) * angle[*r]));
                            c
                        };
                        [wave(f64::sin), wave(f64::cos)]
                    })
                    .collect();
                add(&["angle"], "repeats with the angle", columns);
            }
            for lobes in 1..=4 {
                let wave = |f: &dyn Fn(f64) -> f64| {
                    let mut c = vec![0.0; stack.n];
                    rows.iter().for_each(|r| c[*r] = f(f64::from(lobes) * angle[*r]));
                    c
                };
                add(&["angle"], "steps with the angle", vec![wave(&|w| w.sin().signum())]);
                add(&["angle"], "saw-tooth in the angle", vec![wave(&|w| (w / TAU).rem_euclid(1.0) - 0.5)]);
            }
            add(&["angle"], "smooth", hats(&angle, 24));
        }
        // Periodic along time, and along position where no periodic effect has a name.
        let mut wave = |label: &str, along: &[f64], top: f64| {
            let (lo, hi) = bounds(along, &rows);
            if hi <= lo {
                return;
            }
            let h = self.list.len();
            let name = format!("unnamed {label}");
            self.list.push(Hypothesis { name, effect: None });
            let shape = Shape {
                response: response.clone(),
                against: vec![label.to_owned()],
                manner: "periodic".to_owned(),
            };
            let (from, to) = (0.7 / (hi - lo), top / (hi - lo));
            waves.push(Wave { shape: Some(shape), ..Wave::new(stack, h, j, along, from, to) });
        };
        wave("time", &time, (n as f64 / 4.0).min(40.0));
        if force && let Some(p) = get(Role::Position(axis.clone())) {
            wave(&p_name, &p, (n as f64 / 4.0).min(200.0));
        }
    }
}

fn response_of(stack: &Stack<'_>, effect: &Effect) -> Option<usize> {
    let axis = effect.axes().first()?;
    stack.responses.iter().position(|r| *r == Role::Error(axis.clone()))
}

/// The column that a free reference temperature adds: the effect of one kelvin, the same at all times.
pub(crate) fn reference_column(stack: &Stack<'_>, effect: &Effect) -> Vec<f64> {
    let level = effect.companion().and_then(|level| stack.basis(&level).into_iter().next());
    level.unwrap_or_else(|| vec![0.0; stack.n])
}

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
}

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

/// The step that positions were read in, mm: 1, 2 or 5 times a power of ten, the largest that all are multiples of.
fn resolution(places: &[f64]) -> Option<f64> {
    let steps = (0..=6).flat_map(|k| [5.0, 2.0, 1.0].map(|m| m / 10_f64.powi(k)));
    let whole = |x: &f64, step: f64| (x / step - (x / step).round()).abs() < 1e-3;
    steps.into_iter().find(|step| places.iter().all(|x| whole(x, *step)))
}

/// Frequencies that look the same as `f` on a grid, inside a range, slowest first; at most `most`.
pub(crate) fn aliases(f: f64, pitch: f64, range: [f64; 2], most: usize) -> Vec<f64> {
    let whole = 1.0 / pitch;
    let rest = f.rem_euclid(whole);
    let first = (range[0] / whole).floor().max(0.0);
    (0..=2 * most)
        .flat_map(|k| {
            let at = (first + k as f64) * whole;
            [at + rest, at + whole - rest]
        })
        .filter(|g| (range[0]..=range[1]).contains(g))
        .take(most)
        .collect()
}

/// Which of several periods is the likeliest, being equally good otherwise: one that machines are made with, or the longest.
pub(crate) fn likeliest(periods_mm: &[f64], usual_mm: &[f64]) -> Option<usize> {
    let made = |p: &f64| usual_mm.iter().any(|l| (p / l - 1.0).abs() < 0.005);
    periods_mm.iter().position(made).or((!periods_mm.is_empty()).then_some(0))
}

fn bounds(x: &[f64], rows: &[usize]) -> (f64, f64) {
    rows.iter().fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(x[*r]), h.max(x[*r])))
}

fn masked(x: &[f64], rows: &[usize]) -> Vec<f64> {
    let mut out = vec![0.0; x.len()];
    rows.iter().for_each(|r| out[*r] = x[*r]);
    out
}

/// Minus the middle, over half the range; zero outside the rows.
fn centred(x: &[f64], rows: &[usize]) -> Vec<f64> {
    let (lo, hi) = bounds(x, rows);
    let mut out = vec![0.0; x.len()];
    if hi > lo {
        rows.iter().for_each(|r| out[*r] = (2.0 * x[*r] - lo - hi) / (hi - lo));
    }
    out
}

/// Hat functions over the range of a variable, without the constant: k − 1 columns that span k hats less their sum.
fn hats(x: &[f64], rows: &[usize], k: usize) -> Vec<Vec<f64>> {
    let mut values: Vec<f64> = rows.iter().map(|r| x[*r]).collect();
    values.sort_by(f64::total_cmp);
    let (lo, hi) = (values[0], values[values.len() - 1]);
    values.dedup_by(|a, b| (*a - *b).abs() <= (hi - lo) * 1e-3);
    if hi <= lo || values.len() < k + 1 {
        return vec![vec![0.0; x.len()]];
    }
    let mut out = vec![vec![0.0; x.len()]; k];
    for r in rows {
        let u = ((x[*r] - lo) / (hi - lo) * (k - 1) as f64).clamp(0.0, (k - 1) as f64);
        let i = (u.floor() as usize).min(k - 2);
        let w = u - i as f64;
        out[i][*r] = 1.0 - w;
        out[i + 1][*r] = w;
    }
    // Differences to the middle hat's share: any k − 1 of them with the constant span the same functions; the first
    // is left out so that a constant alone is no evidence for structure.
    let n = rows.len() as f64;
    for c in &mut out {
        let mean = rows.iter().map(|r| c[*r]).sum::<f64>() / n;
        rows.iter().for_each(|r| c[*r] -= mean);
    }
    out.remove(k / 2);
    out.retain(|c| c.iter().any(|v| *v != 0.0));
    if out.is_empty() { vec![vec![0.0; x.len()]] } else { out }
}

#[cfg(test)]
mod tests {
    use super::resolution;

    #[test]
    fn positions_are_read_in_steps_of_a_scale() {
        let places = |step: f64| (0..200).map(|k| f64::from(k * k + 6 * k) * step - 30.0).collect::<Vec<_>>();
        for step in [0.5, 0.2, 0.1, 0.05, 0.002, 0.001, 0.0005, 0.000_1] {
            assert_eq!(resolution(&places(step)), Some(step));
        }
        let roots: Vec<f64> = (0..50).map(|k| f64::from(k).sqrt()).collect();
        assert_eq!(resolution(&roots), None);
    }
}
