//! Shapes of no name: what a residual may look like that no effect of the dictionary explains, over every channel and the
//! products that physics suggests.

use crate::cause::{Cause, Shape};
use crate::hypotheses::{Atom, Hypotheses, Hypothesis};
use crate::lanes;
use crate::problem::Stack;
use crate::teeth::Teeth;
use crate::waves::Wave;
use rtec_model::effect::{STANDARD_DEGC, sign};
use rtec_model::record::{Axis, Record, Role};
use std::f64::consts::TAU;

/// What an explanation without a name costs beyond one with a name.
const SHAPE_COST: f64 = 2.0;
/// Either half of a channel's range is divided into so many parts; a knee is tried where they meet.
const KNEES: i32 = 5;
/// Numbers of hats over the position that are more than a map's.
const FINE: [usize; 2] = [64, 96];
/// Products of more temperatures than these are too many to look at.
const MOST_SENSORS: usize = 6;
/// A product beside its two factors is so much less likely, as if it were one of so many grid points.
const SENSORS_GRID: usize = 50;
/// Fewest rows that saw teeth are looked for in.
const ROWS_FOR_TEETH: usize = 40;
/// Fewest rows, but one, that a knee is looked for in.
const ROWS_FOR_KNEES: usize = 20;

/// A shape with its columns in the bank and the price of its own grid.
type Made = (Cause, Vec<usize>, f64);

impl Hypotheses {
    /// Shapes without a name, over every channel and the products that physics suggests.
    pub(crate) fn shapes(&mut self, stack: &Stack<'_>, waves: &mut Vec<Wave>) {
        let mut made: Vec<Made> = Vec::new();
        for j in 0..stack.responses.len() {
            if let Some(mut one) = Shapes::of(self, stack, j, &mut made) {
                one.all();
                waves.extend(one.waves());
            }
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
}

/// The shapes of one response in the making.
struct Shapes<'m, 's, 'r> {
    all: &'m mut Hypotheses,
    stack: &'s Stack<'r>,
    made: &'m mut Vec<Made>,
    /// The response: its number, its name, its axis, whether it is a force.
    number: usize,
    name: String,
    axis: Axis,
    force: bool,
    records: Vec<&'r Record>,
    /// Its rows in the stack.
    rows: Vec<usize>,
    time: Vec<f64>,
    /// Channels that any smooth function of is tried, with their labels: time first.
    scalars: Vec<(String, Vec<f64>)>,
    position: Option<Vec<f64>>,
    velocity: Option<Vec<f64>>,
    direction: Option<Vec<f64>>,
}

impl<'m, 's, 'r> Shapes<'m, 's, 'r> {
    /// None for a response without an axis.
    fn of(
        all: &'m mut Hypotheses,
        stack: &'s Stack<'r>,
        number: usize,
        made: &'m mut Vec<Made>,
    ) -> Option<Self> {
        let role = &stack.responses[number];
        let axis = role.axis()?.clone();
        let of = stack.segments.iter().filter(|s| s.response == number);
        let mut shapes = Self {
            all,
            stack,
            made,
            number,
            name: role.to_string(),
            axis: axis.clone(),
            force: matches!(role, Role::Force(_)),
            records: of.map(|s| stack.record(s)).collect(),
            rows: stack.rows(number).collect(),
            time: stack.column(Some(number), |rec, row| rec.time_s()[row]),
            scalars: Vec::new(),
            position: None,
            velocity: None,
            direction: None,
        };
        shapes.scalars = shapes.scalars();
        shapes.position = shapes.get(&Role::Position(axis.clone())).map(|p| centred(&p, &shapes.rows));
        shapes.velocity = shapes.get(&Role::Velocity(axis.clone()));
        let by_velocity = || Some(shapes.velocity.as_ref()?.iter().map(|v| sign(*v)).collect());
        shapes.direction = shapes.get(&Role::Direction(axis)).or_else(by_velocity);
        Some(shapes)
    }

    fn has(&self, role: &Role) -> bool {
        self.records.iter().all(|r| r.column(role).is_some())
    }

    /// A stacked channel; none where a record lacks it.
    fn get(&self, role: &Role) -> Option<Vec<f64>> {
        self.has(role)
            .then(|| self.stack.column(Some(self.number), |r, row| r.data(role).map_or(0.0, |d| d[row])))
    }

    fn scalars(&self) -> Vec<(String, Vec<f64>)> {
        let mut scalars: Vec<(String, Vec<f64>)> = vec![("time".into(), self.time.clone())];
        for column in &self.records[0].columns {
            let wanted = match &column.role {
                Role::Temperature => self.records.iter().all(|r| r.temperature(&column.name).is_some()),
                Role::Channel => self.records.iter().all(|r| r.channel(&column.name).is_some()),
                Role::Velocity(a) | Role::Acceleration(a) | Role::Load(a) => {
                    *a == self.axis && self.has(&column.role)
                }
                Role::SpindleSpeed | Role::Cycle => self.has(&column.role),
                Role::Position(a) => *a == self.axis && self.force && self.has(&column.role),
                _ => false,
            };
            if wanted {
                let data = self.stack.column(Some(self.number), |rec, row| match &column.role {
                    Role::Temperature => rec.temperature(&column.name).map_or(0.0, |d| d[row]),
                    Role::Channel => rec.channel(&column.name).map_or(0.0, |d| d[row]),
                    r => rec.data(r).map_or(0.0, |d| d[row]),
                });
                scalars.push((column.label(), data));
            }
        }
        scalars
    }

    fn shape(&self, against: &[&str], manner: &str) -> Shape {
        Shape {
            response: self.name.clone(),
            against: against.iter().map(|s| (*s).to_owned()).collect(),
            manner: manner.to_owned(),
        }
    }

    fn push(&mut self, column: Vec<f64>) -> usize {
        self.all.push(self.stack, column)
    }

    /// A shape that is one of `grid` grid points; left out where a column is empty, or where it has as many columns as
    /// half the rows.
    fn offer(&mut self, against: &[&str], manner: &str, columns: Vec<Vec<f64>>, grid: usize) {
        let shape = self.shape(against, manner);
        if columns.len() + 8 < self.rows.len() / 2 && columns.iter().all(|c| c.iter().any(|x| *x != 0.0)) {
            let columns = columns.into_iter().map(|c| self.push(c)).collect();
            self.made.push((Cause::Shape(shape), columns, (grid as f64).ln()));
        }
    }

    fn add(&mut self, against: &[&str], manner: &str, columns: Vec<Vec<f64>>) {
        self.offer(against, manner, columns, 1);
    }

    fn hats(&self, x: &[f64], k: usize) -> Vec<Vec<f64>> {
        hats(x, &self.rows, k)
    }

    /// A function of a channel at the response's rows, zero elsewhere.
    fn over(&self, x: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; self.stack.n];
        for r in &self.rows {
            out[*r] = f(x[*r]);
        }
        out
    }

    /// Sine and cosine of so many turns per unit of a channel at the response's rows, zero elsewhere.
    fn wave_over(&self, x: &[f64], turns: f64) -> [Vec<f64>; 2] {
        let mut out = [vec![0.0; self.stack.n], vec![0.0; self.stack.n]];
        for r in &self.rows {
            (out[0][*r], out[1][*r]) = lanes::wave(turns * x[*r]);
        }
        out
    }

    /// All shapes.
    fn all(&mut self) {
        self.teeth();
        self.knees();
        self.in_time();
        self.smooth();
        self.sensors_together();
        self.by_direction();
        self.along_position();
        self.in_proportion_to_position();
        self.with_velocity();
        self.with_load();
        if let (Some(rpm), Some(wet)) = (self.get(&Role::SpindleSpeed), self.get(&Role::Coolant)) {
            let manner = "spindle speed while the coolant is on";
            self.add(&["spindle_speed", "coolant"], manner, vec![times(&rpm, &wet)]);
        }
        self.around();
    }

    fn teeth(&mut self) {
        let n = self.rows.len();
        if n < ROWS_FOR_TEETH {
            return;
        }
        for (saw, manner) in [(true, "saw teeth"), (false, "repeated steps")] {
            let shape = self.shape(&["time"], manner);
            for turn in 0..52 {
                let turns = 1.4 * 1.042_f64.powi(turn);
                for phase in 0..6 {
                    // The other half of a turn is the same with the other sign.
                    let phase = f64::from(phase) / if saw { 6.0 } else { 12.0 };
                    let teeth = Teeth { response: self.number, saw, turns, phase };
                    let column = self.push(teeth.column(self.stack));
                    self.made.push((Cause::Teeth(shape.clone(), teeth), vec![column], (n as f64).ln() + 3.0));
                }
            }
        }
    }

    fn knees(&mut self) {
        if self.rows.len() <= ROWS_FOR_KNEES {
            return;
        }
        for (label, data) in self.scalars.clone() {
            let u = centred(&data, &self.rows);
            if u.iter().all(|u| *u == 0.0) {
                continue;
            }
            let shape = self.shape(&[&label], "straight with a knee");
            let straight = self.push(u.clone());
            for i in 1..2 * KNEES {
                let knee = f64::from(i) / f64::from(KNEES) - 1.0;
                let bent = self.over(&u, |u| (u - knee).max(0.0));
                let bent = self.push(bent);
                let price = f64::from(2 * KNEES - 1).ln();
                self.made.push((Cause::Shape(shape.clone()), vec![bent, straight], price));
            }
        }
    }

    /// Bursts that pass, and what repeats.
    fn in_time(&mut self) {
        let clock = centred(&self.time, &self.rows);
        for width in [0.05, 0.12, 0.3] {
            for i in 0..=24 {
                let centre = -1.0 + f64::from(i) / 12.0;
                let burst = self.over(&clock, |u| (-((u - centre) / width).powi(2)).exp());
                self.offer(&["time"], "a passing burst", vec![burst], 75);
            }
        }
        for i in 4..30 {
            let turns = f64::from(i) * 0.25;
            let columns = (1..=4).flat_map(|k| self.wave_over(&clock, 0.5 * turns * f64::from(k))).collect();
            self.offer(&["time"], "repeats in time", columns, 26);
        }
    }

    fn smooth(&mut self) {
        for (label, data) in self.scalars.clone() {
            let sizes: &[usize] = if label == "time" { &[5, 8, 12, 20] } else { &[5, 9] };
            for k in sizes {
                let columns = self.hats(&data, *k);
                self.add(&[&label], "smooth", columns);
            }
        }
    }

    /// Products of two temperatures, and of these with the position.
    fn sensors_together(&mut self) {
        let warm: Vec<(String, Vec<f64>)> =
            self.scalars.iter().filter(|(l, _)| l.starts_with("temperature")).cloned().collect();
        if warm.len() > MOST_SENSORS {
            return;
        }
        let role = Role::Position(self.axis.clone());
        let place = self.get(&role).map(|p| (role.to_string(), p));
        for (i, (a, x)) in warm.iter().enumerate() {
            for (b, y) in &warm[i + 1..] {
                let from = |t: &[f64]| self.over(t, |t| t - STANDARD_DEGC);
                let both = times(&from(x), &from(y));
                let bent = vec![both.clone(), from(x), from(y)];
                if let Some((name, p)) = &place {
                    let with: Vec<Vec<f64>> = bent.iter().map(|c| times(c, p)).chain([p.clone()]).collect();
                    let manner = "in proportion to position and to two temperatures";
                    self.offer(&[name, a, b], manner, vec![with[0].clone()], 2);
                    self.offer(&[name, a, b], manner, with, SENSORS_GRID);
                }
                self.offer(&[a, b], "in proportion to two temperatures", vec![both], 2);
                self.offer(&[a, b], "in proportion to two temperatures", bent, SENSORS_GRID);
            }
        }
    }

    fn by_direction(&mut self) {
        let (p_name, d_name) = (format!("position.{}", self.axis), format!("direction.{}", self.axis));
        let Some(d) = self.direction.clone() else { return };
        if let Some(p) = self.position.clone() {
            let against = [d_name.as_str(), &p_name];
            self.add(&against, "differs by direction, in proportion to position", vec![times(&d, &p)]);
            for k in [5, 9] {
                let columns = self.hats(&p, k).iter().map(|h| times(&d, h)).chain([d.clone()]).collect();
                self.add(&against, "differs by direction, smooth", columns);
            }
        }
        let columns = self.hats(&self.time, 5).iter().map(|h| times(&d, h)).collect();
        self.add(&[&d_name, "time"], "differs by direction, drifting", columns);
    }

    /// What repeats over the position more finely than a map has knots.
    fn along_position(&mut self) {
        let Some(p) = self.position.clone() else { return };
        let name = format!("position.{}", self.axis);
        for k in FINE {
            if 4 * k < self.rows.len() {
                let columns = self.hats(&p, k);
                self.add(&[&name], "repeats, finer than a map", columns);
            }
        }
    }

    fn in_proportion_to_position(&mut self) {
        let p_name = format!("position.{}", self.axis);
        let Some(p) = self.position.clone() else { return };
        let t0 = centred(&self.time, &self.rows);
        self.add(&[&p_name, "time"], "in proportion to position, drifting", vec![times(&p, &t0)]);
        for (label, data) in self.scalars.clone() {
            if label == "time" || label.starts_with("temperature") || label.starts_with("cycle") {
                let k = if label == "time" { 7 } else { 5 };
                let columns = self.hats(&data, k).iter().map(|h| times(&p, h)).chain([p.clone()]).collect();
                self.add(&[&p_name, &label], "in proportion to position, smooth", columns);
            }
        }
        for other in
            self.records[0].axes(Role::Position).filter(|o| **o != self.axis).cloned().collect::<Vec<_>>()
        {
            let Some(q) = self.get(&Role::Position(other.clone())) else { continue };
            let (a, b) = (self.hats(&p, 5), self.hats(&centred(&q, &self.rows), 5));
            let columns = a.iter().flat_map(|x| b.iter().map(|y| times(x, y))).collect();
            self.add(&[&p_name, &format!("position.{other}")], "smooth over the plane", columns);
        }
    }

    fn with_velocity(&mut self) {
        let Some(v) = self.velocity.clone() else { return };
        let (p_name, v_name) = (format!("position.{}", self.axis), format!("velocity.{}", self.axis));
        let top = self.rows.iter().fold(1e-12_f64, |m, r| m.max(v[*r].abs()));
        let map = |f: &dyn Fn(f64) -> f64| v.iter().map(|v| f(v / top)).collect::<Vec<f64>>();
        self.add(&[&v_name], "quadratic, with the sign of the velocity", vec![map(&|v| v * v.abs())]);
        self.add(&[&v_name], "quadratic", vec![map(&|v| v * v)]);
        if !self.force {
            self.add(&[&v_name], "in proportion to the speed", vec![map(&f64::abs)]);
        }
        for v0 in [0.05, 0.15, 0.4] {
            let stribeck = move |v: f64| sign(v) * (-(v / v0).powi(2)).exp();
            self.add(&[&v_name], "at low speed, with the sign of the velocity", vec![map(&stribeck)]);
        }
        if let Some(p) = self.position.clone() {
            let signs: Vec<f64> = v.iter().map(|v| sign(*v)).collect();
            self.add(&[&v_name, &p_name], "sign of the velocity times position", vec![times(&signs, &p)]);
            self.add(&[&v_name, &p_name], "velocity times position", vec![times(&v, &p)]);
        }
    }

    fn with_load(&mut self) {
        let Some(f) = self.get(&Role::Load(self.axis.clone())) else { return };
        let (p_name, f_name) = (format!("position.{}", self.axis), format!("load.{}", self.axis));
        let bent: Vec<f64> = f.iter().map(|f| f * f.abs()).collect();
        self.add(&[&f_name], "quadratic, with the sign of the load", vec![bent]);
        self.add(&[&f_name], "quadratic", vec![times(&f, &f)]);
        if let Some(p) = self.position.clone() {
            self.add(&[&f_name, &p_name], "load times position", vec![times(&f, &p)]);
        }
    }

    /// Around a circle.
    fn around(&mut self) {
        let Some(angle) = self.get(&Role::Angle) else { return };
        for harmonics in [4, 8] {
            let wave = |k: i32| {
                let k = f64::from(k);
                [self.over(&angle, |w| (k * w).sin()), self.over(&angle, |w| (k * w).cos())]
            };
            let columns = (1..=harmonics).flat_map(wave).collect();
            self.add(&["angle"], "repeats with the angle", columns);
        }
        for lobes in 1..=4 {
            let k = f64::from(lobes);
            let steps = self.over(&angle, |w| (k * w).sin().signum());
            self.add(&["angle"], "steps with the angle", vec![steps]);
            let teeth = self.over(&angle, |w| (k * w / TAU).rem_euclid(1.0) - 0.5);
            self.add(&["angle"], "saw-tooth in the angle", vec![teeth]);
        }
        let columns = self.hats(&angle, 24);
        self.add(&["angle"], "smooth", columns);
    }

    /// Periodic along time, up to half a turn from row to row, and along position where no periodic effect has a name.
    fn waves(mut self) -> Vec<Wave> {
        let quarter = self.rows.len() as f64 / 4.0;
        let time = std::mem::take(&mut self.time);
        let (lo, hi) = bounds(&time, &self.rows);
        let fastest = self.records.iter().filter_map(|r| nyquist(r.time_s())).fold(0.0, f64::max);
        let mut waves: Vec<Wave> = self.wave("time", &time, fastest * (hi - lo)).into_iter().collect();
        if self.force
            && let Some(p) = self.get(&Role::Position(self.axis.clone()))
        {
            let name = format!("position.{}", self.axis);
            waves.extend(self.wave(&name, &p, quarter.min(200.0)));
        }
        waves
    }

    /// A wave of up to `top` periods over the whole of a variable.
    fn wave(&mut self, label: &str, along: &[f64], top: f64) -> Option<Wave> {
        let (lo, hi) = bounds(along, &self.rows);
        if hi <= lo {
            return None;
        }
        let hypothesis = self.all.list.len();
        self.all.list.push(Hypothesis { name: format!("unnamed {label}"), effect: None });
        let (from, to) = (0.7 / (hi - lo), top / (hi - lo));
        let shape = Some(self.shape(&[label], "periodic"));
        Some(Wave { shape, ..Wave::new(self.stack, hypothesis, self.number, along, from, to) })
    }
}

/// Half a turn from row to row, in turns per unit of time, rows at their usual distance; none where time stands still.
fn nyquist(time: &[f64]) -> Option<f64> {
    let mut gaps: Vec<f64> = time.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > 0.0).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).map(|g| 0.5 / g)
}

fn times(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(x, y)| x * y).collect()
}

fn bounds(x: &[f64], rows: &[usize]) -> (f64, f64) {
    rows.iter().fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(x[*r]), h.max(x[*r])))
}

/// Minus the middle, over half the range; zero outside the rows.
fn centred(x: &[f64], rows: &[usize]) -> Vec<f64> {
    let (lo, hi) = bounds(x, rows);
    let mut out = vec![0.0; x.len()];
    if hi > lo {
        for r in rows {
            out[*r] = (2.0 * x[*r] - lo - hi) / (hi - lo);
        }
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
        for r in rows {
            c[*r] -= mean;
        }
    }
    out.remove(k / 2);
    out.retain(|c| c.iter().any(|v| *v != 0.0));
    if out.is_empty() { vec![vec![0.0; x.len()]] } else { out }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{axis, record};

    /// A saw of two and a half turns: what the bank has of it is what the record shows.
    #[test]
    fn teeth_repeat_over_the_time_of_all_records() {
        let records = [record(101, |_| 0.0)];
        let stack = Stack::new(&records);
        let teeth = Teeth { response: 0, saw: true, turns: 2.5, phase: 0.0 };
        let column = teeth.column(&stack);
        assert!((column[0] + 0.5).abs() < 1e-12 && (column[20] - 0.0).abs() < 1e-9, "{column:?}");
        assert!((column[39] - (39.0 / 40.0 - 0.5)).abs() < 1e-9 && (column[40] + 0.5).abs() < 1e-9);
    }

    #[test]
    fn hats_carry_no_constant_and_span_what_is_smooth() {
        let x: Vec<f64> = (0..60).map(f64::from).collect();
        let rows: Vec<usize> = (0..60).collect();
        let columns = hats(&x, &rows, 5);
        assert_eq!(columns.len(), 4);
        for c in &columns {
            assert!(c.iter().sum::<f64>().abs() < 1e-9);
        }
        // Too few different values for so many hats.
        let two: Vec<f64> = (0..60).map(|i| f64::from(i % 2)).collect();
        assert!(hats(&two, &rows, 5)[0].iter().all(|v| *v == 0.0));
    }

    #[test]
    fn shapes_run_along_what_all_records_have() {
        let records = [record(80, |i| i)];
        let stack = Stack::new(&records);
        let mut all = Hypotheses { bank: crate::bank::Bank::new(&stack.ranges), ..Hypotheses::default() };
        let mut waves = Vec::new();
        all.shapes(&stack, &mut waves);
        assert!(all.list.iter().all(|h| !h.named()));
        let against = |label: &str| {
            let along = |a: &Atom| a.cause.shape().is_some_and(|s| s.against.iter().any(|x| x == label));
            all.atoms.iter().any(along)
        };
        assert!(against("time") && against(&format!("position.{}", axis())));
        assert!(!against("angle") && !against("spindle_speed"));
        assert_eq!(waves.len(), 1, "time alone: along the position waves have names");
    }
}
