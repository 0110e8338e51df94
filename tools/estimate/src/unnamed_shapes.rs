//! Shapes without a name: errors that no effect of the dictionary describes.
//! Each kind has one function; a new one needs its function and a line in [`SHAPES`].

use crate::gaussian_process::{Kernel, directions, knots, shares};
use crate::hypothesis_contribution::UnnamedShape;
use crate::priors::{CONTRIBUTION, KNOTS, LENGTHS};
use crate::rows_and_noise::{MeasuredRows, ResponseSegment};
use crate::search_limits::{
    CHANGING, CREEPS, FEWEST_CYCLES, MOST_PLACES, MOST_SENSORS, PLACE_RAD, PLANE_RANK, SHAPE_FEWEST_ROWS,
    SHAPE_RANK,
};
use crate::set_up_terms::place_of;
use crate::wave_periodogram::Periodogram;
use rtec_least_squares::{add, dot};
use rtec_model::effect::sign;
use rtec_model::record::{Axis, Role};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A function of one variable that a named effect has.
type Curve = fn(f64) -> f64;
/// A shape with its columns, each at one standard deviation.
pub type Shaped = (UnnamedShape, Vec<Vec<f64>>);

/// A response and the quantities that its rows log.
pub struct ResponseWithInputs<'r> {
    rows: &'r MeasuredRows<'r>,
    number: usize,
    name: String,
    axis: Option<Axis>,
    own: Vec<usize>,
}

type Make = fn(&ResponseWithInputs<'_>, &mut Vec<Shaped>);

/// All kinds of shapes.
pub const SHAPES: [Make; 12] = [
    along_scalars,
    wander,
    creep,
    with_position,
    with_direction,
    with_velocity,
    with_load,
    around,
    over_plane,
    two_temperatures,
    place_by_place,
    cycle_by_cycle,
];

/// All shapes that these rows could show.
#[must_use]
pub fn shapes(rows: &MeasuredRows<'_>) -> Vec<Shaped> {
    let mut out = Vec::new();
    for number in 0..rows.responses.len() {
        let response = ResponseWithInputs::new(rows, number);
        for make in SHAPES {
            make(&response, &mut out);
        }
    }
    out.retain(|(_, columns)| columns.iter().any(|c| c.iter().any(|x| *x != 0.0)));
    out
}

impl<'r> ResponseWithInputs<'r> {
    fn new(rows: &'r MeasuredRows<'r>, number: usize) -> Self {
        let own =
            rows.segments.iter().filter(|s| s.response == number).flat_map(|s| s.rows.clone()).collect();
        let role = &rows.responses[number];
        Self { rows, number, name: role.to_string(), axis: role.axis().cloned(), own }
    }

    /// A quantity that all records of the response log; zero in other rows.
    fn get(&self, of: &dyn Fn(&rtec_model::record::Record) -> Option<Vec<f64>>) -> Option<Vec<f64>> {
        let mut out = vec![0.0; self.rows.n];
        for s in self.rows.segments.iter().filter(|s| s.response == self.number) {
            out[s.rows.clone()].copy_from_slice(&of(self.rows.record(s))?);
        }
        Some(out)
    }

    fn role(&self, role: &Role) -> Option<Vec<f64>> {
        self.get(&|r| r.data(role).map(<[f64]>::to_vec))
    }

    fn axis_role(&self, of: fn(Axis) -> Role) -> Option<(String, Vec<f64>)> {
        let role = of(self.axis.clone()?);
        Some((role.to_string(), self.role(&role)?))
    }

    fn direction(&self) -> Option<(String, Vec<f64>)> {
        self.axis_role(Role::Direction).or_else(|| {
            let (_, v) = self.axis_role(Role::Velocity)?;
            Some((format!("direction.{}", self.axis.as_ref()?), v.into_iter().map(sign).collect()))
        })
    }

    /// Directions of the other axes.
    fn other_directions(&self) -> Vec<(Axis, String, Vec<f64>)> {
        let Some(first) = self.rows.segments.iter().find(|s| s.response == self.number) else {
            return Vec::new();
        };
        let others = self.rows.record(first).axes(Role::Direction).filter(|a| Some(*a) != self.axis.as_ref());
        let of = |a: &Axis| {
            let role = Role::Direction(a.clone());
            Some((a.clone(), role.to_string(), self.role(&role)?))
        };
        others.filter_map(of).collect()
    }

    fn time(&self) -> Vec<f64> {
        self.get(&|r| Some(r.time_s().to_vec())).unwrap_or_default()
    }

    /// All logged quantities that vary, with labels.
    /// Positions are left out, because effects with names depend on them.
    fn scalars(&self) -> Vec<(String, Vec<f64>)> {
        let mut out = vec![("time".to_owned(), self.time())];
        let Some(first) = self.rows.segments.iter().find(|s| s.response == self.number) else { return out };
        for c in &self.rows.record(first).columns {
            let skip = c.role.is_measured()
                || matches!(c.role, Role::Time | Role::Position(_) | Role::Direction(_) | Role::Angle);
            if skip {
                continue;
            }
            let name = c.name.clone();
            let data = match c.role {
                Role::Temperature => self.get(&|r| r.temperature(&name).map(<[f64]>::to_vec)),
                Role::Channel => self.get(&|r| r.channel(&name).map(<[f64]>::to_vec)),
                ref role => self.role(role),
            };
            out.extend(data.map(|d| (c.label(), d)));
        }
        let varies = |d: &Vec<f64>| self.own.iter().any(|i| (d[*i] - d[self.own[0]]).abs() > 1e-12);
        out.retain(|(_, d)| varies(d));
        out
    }

    fn shape(&self, against: &[&str], manner: &str) -> UnnamedShape {
        let against = against.iter().map(|a| (*a).to_owned()).collect();
        UnnamedShape { response: self.name.clone(), against, manner: manner.to_owned() }
    }

    fn over(&self, f: &dyn Fn(usize) -> f64) -> Vec<f64> {
        let mut out = vec![0.0; self.rows.n];
        self.own.iter().for_each(|i| out[*i] = f(*i));
        out
    }

    /// A separate level in each group of rows.
    fn levels(&self, groups: impl Iterator<Item = Vec<usize>>) -> Vec<Vec<f64>> {
        let level = |rows: Vec<usize>| {
            let mut own = vec![0.0; self.rows.n];
            for i in rows {
                own[i] = CONTRIBUTION;
            }
            own
        };
        groups.map(level).collect()
    }

    /// A smooth function of a variable.
    /// It is without its constant, and without its straight line if a name explains that.
    fn smooth(&self, v: &[f64], kernel: &dyn Fn(f64) -> Kernel, line: bool) -> Vec<Vec<f64>> {
        let line: &[Curve] = if line { &[|x| x] } else { &[] };
        self.smooth_without(v, kernel, line)
    }

    /// A smooth function of a variable.
    /// It is without its constant, and without these functions, which have names.
    fn smooth_without(&self, v: &[f64], kernel: &dyn Fn(f64) -> Kernel, named: &[Curve]) -> Vec<Vec<f64>> {
        let values: Vec<f64> = self.own.iter().map(|i| v[*i]).collect();
        let knots = knots(&values, KNOTS);
        if knots.len() < 4 || self.own.len() < SHAPE_FEWEST_ROWS {
            return Vec::new();
        }
        let k = knots.len();
        let range = knots[k - 1] - knots[0];
        let mut without = vec![vec![0.0; k]; 1 + named.len()];
        for x in &values {
            for (i, w) in shares(&knots, *x) {
                without[0][i] += w;
                for (row, f) in without[1..].iter_mut().zip(named) {
                    row[i] += w * f(*x);
                }
            }
        }
        let found = directions(&knots, kernel(range), &without, SHAPE_RANK);
        let mut out = vec![vec![0.0; self.rows.n]; found.len()];
        for i in &self.own {
            for (knot, w) in shares(&knots, v[*i]) {
                for (column, d) in out.iter_mut().zip(&found) {
                    column[*i] += w * d[knot] * CONTRIBUTION;
                }
            }
        }
        out
    }
}

fn times(columns: Vec<Vec<f64>>, by: &[f64]) -> Vec<Vec<f64>> {
    let of = |c: Vec<f64>| c.iter().zip(by).map(|(c, b)| c * b).collect();
    columns.into_iter().map(of).collect()
}

/// The part of a column that is orthogonal to others.
fn apart(mut column: Vec<f64>, others: &[Vec<f64>]) -> Vec<f64> {
    let whole = dot(&column, &column);
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut reduce = |c: &mut Vec<f64>, keep: bool| {
        for b in &basis {
            let share = dot(c, b);
            add(c, -share, b);
        }
        let size = dot(c, c).sqrt();
        if keep && size > 0.0 {
            basis.push(c.iter().map(|x| x / size).collect());
        }
    };
    for other in others {
        reduce(&mut other.clone(), true);
    }
    reduce(&mut column, false);
    if dot(&column, &column) < 1e-9 * whole { vec![0.0; column.len()] } else { column }
}

/// Scales a variable to the range from −1 to 1.
fn unit(x: &[f64], own: &[usize]) -> Vec<f64> {
    let (lo, hi) = own.iter().fold((f64::MAX, f64::MIN), |(l, h), i| (l.min(x[*i]), h.max(x[*i])));
    x.iter().map(|x| if hi > lo { (2.0 * x - lo - hi) / (hi - lo) } else { 0.0 }).collect()
}

fn along_scalars(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    for (label, data) in r.scalars() {
        for length in LENGTHS {
            // Named effects explain a line in temperature, speed or load, but not in time. Friction has several names.
            let forms: &[&[Curve]] = match label.as_str() {
                l if l == "time" || l.starts_with("cycle") => &[&[]],
                l if l.starts_with("velocity") => &[&[|v| v, sign, f64::abs]],
                // Its line may be part of it: a resonance is not a line with a bump.
                _ => &[&[|x| x], &[]],
            };
            for named in forms {
                let columns = r.smooth_without(&data, &|range| Kernel::Smooth(length * range), named);
                out.push((r.shape(&[&label], "smooth"), columns));
            }
        }
    }
}

/// A slow walk over time that does not repeat.
fn wander(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let columns = r.smooth(&r.time(), &|range| Kernel::Rough(0.1 * range), false);
    out.push((r.shape(&["time"], "wanders"), columns));
}

/// Creep of stands, glue and magnetic bases with the logarithm of time.
/// In each run it starts at the beginning and has its own size.
fn creep(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let own: Vec<_> = r.rows.segments.iter().filter(|s| s.response == r.number).collect();
    for share in CREEPS {
        let of = |s: &&ResponseSegment| {
            let t = r.rows.record(s).time_s();
            let (Some(first), Some(last)) = (t.first(), t.last()) else { return vec![0.0; r.rows.n] };
            let whole = share.recip().ln_1p();
            let mut column = vec![0.0; r.rows.n];
            for (x, t) in column[s.rows.clone()].iter_mut().zip(t) {
                *x = CONTRIBUTION * ((t - first) / (share * (last - first)).max(1e-9)).ln_1p() / whole;
            }
            column
        };
        out.push((r.shape(&["time"], "settles with the logarithm of time"), own.iter().map(of).collect()));
    }
}

fn with_position(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some((p_name, p)) = r.axis_role(Role::Position) else { return };
    let u = unit(&p, &r.own);
    for (label, data) in r.scalars() {
        if label == "time" || label.starts_with("temperature") || label.starts_with("cycle") {
            let columns =
                times(r.smooth(&data, &|range| Kernel::Smooth(LENGTHS[0] * range), label != "time"), &u);
            out.push((r.shape(&[&p_name, &label], "in proportion to position, smooth"), columns));
        }
    }
    let t = unit(&r.time(), &r.own);
    let drifting = r.over(&|i| CONTRIBUTION * u[i] * t[i]);
    out.push((r.shape(&[&p_name, "time"], "in proportion to position, drifting"), vec![drifting]));
    let bowed = [2, 3].map(|k| r.over(&|i| CONTRIBUTION * u[i].powi(k) * t[i]));
    out.push((r.shape(&[&p_name, "time"], "over the position, drifting"), bowed.into()));
    for (label, data) in r.scalars().into_iter().filter(|(l, _)| l.starts_with("temperature")) {
        let w = unit(&data, &r.own);
        let bowed = [2, 3].map(|k| r.over(&|i| CONTRIBUTION * u[i].powi(k) * w[i]));
        out.push((r.shape(&[&p_name, &label], "bends with the temperature"), bowed.into()));
    }
}

fn with_direction(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    for (axis, name, d) in r.other_directions() {
        let signs = r.over(&|i| CONTRIBUTION * d[i]);
        out.push((r.shape(&[&name], &format!("differs by the direction of {axis}")), vec![signs]));
    }
    let Some((d_name, d)) = r.direction() else { return };
    let t = r.time();
    let in_time = times(r.smooth(&t, &|range| Kernel::Smooth(LENGTHS[0] * range), false), &d);
    out.push((r.shape(&[&d_name, "time"], "differs by direction, drifting"), in_time));
    let Some((p_name, p)) = r.axis_role(Role::Position) else { return };
    for length in LENGTHS {
        let columns = times(r.smooth(&p, &|range| Kernel::Smooth(length * range), true), &d);
        out.push((r.shape(&[&d_name, &p_name], "differs by direction, smooth"), columns));
    }
}

fn with_velocity(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some((name, v)) = r.axis_role(Role::Velocity) else { return };
    let top = r.own.iter().fold(1e-12_f64, |m, i| m.max(v[*i].abs()));
    // Friction, lag and backlash have names, so the shape is orthogonal to them.
    let named = [r.over(&|_| 1.0), v.clone(), r.over(&|i| sign(v[i])), r.over(&|i| v[i].abs())];
    let of = |f: &dyn Fn(f64) -> f64| vec![apart(r.over(&|i| CONTRIBUTION * f(v[i] / top)), &named)];
    out.push((r.shape(&[&name], "quadratic, with the sign of the velocity"), of(&|v| v * v.abs())));
    out.push((r.shape(&[&name], "quadratic"), of(&|v| v * v)));
    if !r.rows.is_force(r.number) {
        let speed = vec![r.over(&|i| CONTRIBUTION * v[i].abs() / top)];
        out.push((r.shape(&[&name], "in proportion to the speed"), speed));
    }
    for v0 in [0.05, 0.15, 0.4] {
        let stribeck = move |v: f64| sign(v) * (-(v / v0).powi(2)).exp();
        out.push((r.shape(&[&name], "at low speed, with the sign of the velocity"), of(&stribeck)));
    }
    let speed: Vec<f64> = v.iter().map(|v| v.abs()).collect();
    for length in LENGTHS {
        out.push((
            r.shape(&[&name], "smooth in the speed"),
            r.smooth(&speed, &|range| Kernel::Smooth(length * range), false),
        ));
    }
    if let Some((p_name, p)) = r.axis_role(Role::Position) {
        let u = unit(&p, &r.own);
        let both = r.over(&|i| CONTRIBUTION * u[i] * v[i] / top);
        out.push((r.shape(&[&name, &p_name], "velocity times position"), vec![both]));
        let signs = r.over(&|i| CONTRIBUTION * u[i] * sign(v[i]));
        if r.rows.is_force(r.number) {
            out.push((r.shape(&[&name, &p_name], "sign of the velocity times position"), vec![signs]));
            for length in LENGTHS {
                out.push((
                    r.shape(&[&p_name], "smooth"),
                    r.smooth(&p, &|range| Kernel::Smooth(length * range), false),
                ));
            }
        }
    }
}

fn with_load(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some((name, f)) = r.axis_role(Role::Load) else { return };
    if let Some((p_name, p)) = r.axis_role(Role::Position) {
        let (u, w) = (unit(&p, &r.own), unit(&f, &r.own));
        let both = r.over(&|i| CONTRIBUTION * u[i] * w[i]);
        out.push((r.shape(&[&name, &p_name], "load times position"), vec![both]));
    }
}

/// Around a circle: harmonics, from the second on.
fn around(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some(angle) = r.role(&Role::Angle) else { return };
    let turns = r.own.windows(2).map(|w| (angle[w[1]] - angle[w[0]]).abs()).sum::<f64>() / TAU;
    for harmonics in [4_i32, 10, 30].into_iter().filter(|h| 2.0 * f64::from(*h) * turns < r.own.len() as f64)
    {
        let mut columns = Vec::new();
        for k in 2..=harmonics {
            let size = CONTRIBUTION / f64::from(harmonics).sqrt();
            columns.push(r.over(&|i| size * (f64::from(k) * angle[i]).cos()));
            columns.push(r.over(&|i| size * (f64::from(k) * angle[i]).sin()));
        }
        out.push((r.shape(&["angle"], "repeats with the angle"), columns));
    }
    for k in 1..=4 {
        let k = f64::from(k);
        let steps = r.over(&|i| CONTRIBUTION * (k * angle[i]).sin().signum());
        out.push((r.shape(&["angle"], "steps with the angle"), vec![steps]));
        let teeth = r.over(&|i| 2.0 * CONTRIBUTION * ((k * angle[i] / TAU).rem_euclid(1.0) - 0.5));
        out.push((r.shape(&["angle"], "saw-tooth in the angle"), vec![teeth]));
    }
}

fn over_plane(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some((p_name, p)) = r.axis_role(Role::Position) else { return };
    let u = unit(&p, &r.own);
    let Some(first) = r.rows.segments.iter().find(|s| s.response == r.number) else { return };
    let others: Vec<Axis> =
        r.rows.record(first).axes(Role::Position).filter(|a| Some(*a) != r.axis.as_ref()).cloned().collect();
    for other in others {
        let Some(q) = r.role(&Role::Position(other.clone())) else { continue };
        let w = unit(&q, &r.own);
        let columns = [(1, 1), (2, 1), (1, 2), (3, 1), (1, 3), (2, 2)];
        let columns = columns.map(|(a, b)| r.over(&|i| CONTRIBUTION * u[i].powi(a) * w[i].powi(b)));
        out.push((
            r.shape(&[&p_name, &format!("position.{other}")], "smooth over the plane"),
            columns.into(),
        ));
        // The product of two smooth functions: dents and hills.
        let [first, second] = [&p, &q].map(|x| {
            let mut along = r.smooth(x, &|range| Kernel::Smooth(LENGTHS[0] * range), false);
            along.truncate(PLANE_RANK);
            along
        });
        let both = |a: &Vec<f64>| {
            let by = |b: &Vec<f64>| r.over(&|i| a[i] * b[i] / CONTRIBUTION);
            second.iter().map(by).collect::<Vec<_>>()
        };
        let columns = first.iter().flat_map(both).collect();
        out.push((r.shape(&[&p_name, &format!("position.{other}")], "dented over the plane"), columns));
    }
}

/// A separate level at each position that was measured at several times.
fn place_by_place(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some(first) = r.rows.segments.iter().find(|s| s.response == r.number) else { return };
    let mut labels: Vec<String> = Vec::new();
    let mut places: Vec<Vec<i64>> = Vec::new();
    for axis in r.rows.record(first).axes(Role::Position) {
        let Some(p) = r.role(&Role::Position(axis.clone())) else { return };
        let at: Vec<i64> = p.iter().map(|mm| place_of(*mm)).collect();
        if r.own.iter().any(|i| at[*i] != at[r.own[0]]) {
            labels.push(format!("position.{axis}"));
            places.push(at);
        }
    }
    if let Some(angle) = r.role(&Role::Angle) {
        labels.push("angle".to_owned());
        let turn = (TAU / PLACE_RAD).round();
        places.push(angle.iter().map(|x| (x / PLACE_RAD).round().rem_euclid(turn) as i64).collect());
    }
    let direction = r.direction().filter(|d| r.own.iter().any(|i| d.1[*i] * d.1[r.own[0]] < 0.0));
    for way in [None, direction] {
        let mut groups: BTreeMap<Vec<i64>, Vec<usize>> = BTreeMap::new();
        for i in &r.own {
            let mut key: Vec<i64> = places.iter().map(|p| p[*i]).collect();
            key.extend(way.iter().map(|d| d.1[*i] as i64));
            groups.entry(key).or_default().push(*i);
        }
        let once = groups.values().filter(|g| g.len() == 1).count();
        if places.is_empty() || groups.len() < 6 || groups.len() > MOST_PLACES || 10 * once > r.own.len() {
            continue;
        }
        let columns = r.levels(groups.into_values());
        let against: Vec<&str> =
            labels.iter().map(String::as_str).chain(way.iter().map(|d| d.0.as_str())).collect();
        out.push((r.shape(&against, "repeats at each place"), columns));
    }
}

/// A separate level in each cycle of each record.
/// It was clamped or homed again before the cycle.
fn cycle_by_cycle(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let Some(cycle) = r.role(&Role::Cycle) else { return };
    let mut groups: BTreeMap<(usize, i64), Vec<usize>> = BTreeMap::new();
    for (number, s) in r.rows.segments.iter().enumerate().filter(|(_, s)| s.response == r.number) {
        for i in s.rows.clone() {
            groups.entry((number, cycle[i] as i64)).or_default().push(i);
        }
    }
    if groups.len() < FEWEST_CYCLES || groups.len() > MOST_PLACES || 2 * groups.len() > r.own.len() {
        return;
    }
    out.push((r.shape(&["cycle"], "differs from cycle to cycle"), r.levels(groups.into_values())));
}

fn two_temperatures(r: &ResponseWithInputs<'_>, out: &mut Vec<Shaped>) {
    let warm: Vec<(String, Vec<f64>)> =
        r.scalars().into_iter().filter(|(l, _)| l.starts_with("temperature")).collect();
    if warm.len() > MOST_SENSORS {
        return;
    }
    for (i, (a, x)) in warm.iter().enumerate() {
        for (b, y) in &warm[i + 1..] {
            let (x, y) = (unit(x, &r.own), unit(y, &r.own));
            let both = r.over(&|i| CONTRIBUTION * x[i] * y[i]);
            out.push((r.shape(&[a, b], "in proportion to two temperatures"), vec![both]));
        }
    }
}

/// Sizes of a wave that changes along its travel, at all of `n` rows.
/// Each is a smooth function of the position. However often it bends, it bends as much.
#[must_use]
pub fn envelopes(along: &Periodogram, n: usize) -> Vec<Vec<f64>> {
    let knots = knots(&along.positions(), KNOTS);
    if knots.len() < 8 {
        return Vec::new();
    }
    let range = knots[knots.len() - 1] - knots[0];
    let of = |d: Vec<f64>| {
        let size = (dot(&d, &d) / d.len() as f64).sqrt();
        along.at(n, |place| shares(&knots, place).iter().map(|(k, w)| w * d[*k]).sum::<f64>() / size)
    };
    directions(&knots, Kernel::Kinked(LENGTHS[1] * range), &[], CHANGING).into_iter().map(of).collect()
}

/// A wave whose size changes, from sine and cosine of a frequency and its sizes.
#[must_use]
pub fn changing_wave(basis: &[Vec<f64>], envelopes: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let size = 2.0 / ((basis.len() * envelopes.len()) as f64).sqrt();
    let of = |(b, e): (&Vec<f64>, &Vec<f64>)| b.iter().zip(e).map(|(b, e)| size * b * e).collect();
    basis.iter().flat_map(|b| envelopes.iter().map(move |e| (b, e))).map(of).collect()
}
