//! The chain model: errors of each joint, combined by homogeneous transforms.
//! Sources: NISTIR 4854; Donmez et al., "A general methodology for machine tool accuracy enhancement", 1986.
//!
//! Two branches start at the machine's bed: one ends at the work, one at the tool. A joint moves by its axis'
//! position and has six error components. Each component is a polynomial of the position and of a temperature
//! difference. The error is the tool point's place in the frame of the work, minus the place where it should
//! be.

use crate::effect::{MissingInput, ResolvedTemperatureDifference, TemperatureDifference, read_difference};
use crate::record::{Axis, LINEAR, Record, Role};
use rtec_files::InputError;
use rtec_files::file_kind::FileKind;
use rtec_files::strict_toml::{Document, Table, TomlKeyValue};
use std::path::Path;

/// The six components of a joint's error.
/// They are displacements (µm) along x, y, z, and rotations (µrad) about x, y, z.
pub const COMPONENTS: [&str; 6] = ["dx", "dy", "dz", "ex", "ey", "ez"];

/// Which end of the machine a joint carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Branch {
    /// The branch from the bed to the work.
    Work,
    /// The branch from the bed to the tool.
    Tool,
}

/// One term of a component: coefficient · (p/100 mm)^i · ΔT^j.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolynomialTerm {
    /// Power of the position in units of 100 mm.
    /// With this unit coefficients keep the component's order of magnitude.
    pub position: u8,
    /// Power of the temperature difference, K.
    pub temperature: u8,
    /// The coefficient, in µm (displacements) or µrad (tilts).
    pub coefficient: f64,
}

/// One component of a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct JointErrorComponent {
    /// Which of the six motions it is: index into [`COMPONENTS`].
    pub kind: usize,
    /// The temperature difference of its terms; `None` if no term depends on it.
    pub delta: Option<TemperatureDifference>,
    /// The terms, whose sum is the component.
    pub terms: Vec<PolynomialTerm>,
}

/// A joint: a frame at an offset from the one before.
/// It moves along an axis and has errors.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// The joint's name.
    pub name: String,
    /// The branch of the chain that it belongs to.
    pub branch: Branch,
    /// The axis whose position moves it, with the direction in the machine's frame.
    /// `None` for a joint at rest (spindle, tool post).
    pub axis: Option<(Axis, [f64; 3])>,
    /// Offset from the frame before, mm.
    pub offset_mm: [f64; 3],
    /// Its error motions; those not listed are zero.
    pub components: Vec<JointErrorComponent>,
}

/// A kinematic chain from the workpiece to the tool.
#[derive(Debug, Clone, PartialEq)]
pub struct KinematicChain {
    /// The joints of each branch in order from the bed.
    pub joints: Vec<Joint>,
    /// The tool point in the last frame of the tool branch, mm.
    pub tool_mm: [f64; 3],
}

/// The axis of a joint, and the temperature difference of each component.
#[derive(Debug, Clone)]
pub(crate) struct JointInputIndices<A, S> {
    axis: Option<A>,
    deltas: Vec<Option<ResolvedTemperatureDifference<S>>>,
}

/// A homogeneous transform: a point is turned, then shifted (mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// The rotation matrix, row by row.
    turn: [[f64; 3]; 3],
    shift_mm: [f64; 3],
}

impl Transform {
    /// The transform that leaves every point where it is.
    pub const IDENTITY: Self =
        Self { turn: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], shift_mm: [0.0; 3] };

    fn apply(&self, point_mm: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|row| dot(self.turn[row], point_mm) + self.shift_mm[row])
    }

    /// The transform that applies `inner` first, then this one.
    fn after(&self, inner: &Self) -> Self {
        let columns = [0, 1, 2].map(|k| inner.column(k));
        let turn = self.turn.map(|row| columns.map(|column| dot(row, column)));
        Self { turn, shift_mm: self.apply(inner.shift_mm) }
    }

    /// The point that this transform moves to `point_mm`, by Cramer's rule.
    /// `None` for a singular matrix, which no transform near the identity has.
    fn undo(&self, point_mm: [f64; 3]) -> Option<[f64; 3]> {
        let p = [0, 1, 2].map(|row| point_mm[row] - self.shift_mm[row]);
        let [a, b, c] = [0, 1, 2].map(|k| self.column(k));
        let determinant = dot(a, cross(b, c));
        let found = [dot(p, cross(b, c)), dot(a, cross(p, c)), dot(a, cross(b, p))];
        (determinant != 0.0).then(|| found.map(|v| v / determinant))
    }

    fn column(&self, k: usize) -> [f64; 3] {
        self.turn.map(|row| row[k])
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross([a, b, c]: [f64; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

/// The transform of a displacement (mm) and small rotations (rad).
/// It is exact to the first order, as in the method.
pub fn transform(displacement_mm: [f64; 3], rotation_rad: [f64; 3]) -> Transform {
    let [a, b, c] = rotation_rad;
    Transform { turn: [[1.0, -c, b], [c, 1.0, -a], [-b, a, 1.0]], shift_mm: displacement_mm }
}

impl KinematicChain {
    /// The temperature differences that its components read.
    pub fn deltas(&self) -> impl Iterator<Item = &TemperatureDifference> {
        self.joints.iter().flat_map(|j| &j.components).filter_map(|c| c.delta.as_ref())
    }

    /// The axes that move its joints, each once.
    pub fn axes(&self) -> Vec<Axis> {
        let mut axes: Vec<Axis> = Vec::new();
        for (axis, _) in self.joints.iter().filter_map(|j| j.axis.as_ref()) {
            if !axes.contains(axis) {
                axes.push(axis.clone());
            }
        }
        axes
    }

    /// The positions that the chain reads and the record does not log.
    pub fn taken_as_zero(&self, record: &Record) -> Vec<Role> {
        let roles = self.axes().into_iter().map(Role::Position);
        roles.filter(|role| record.data(role).is_none()).collect()
    }

    /// The same chain with its tool point moved by a gauge's offset, mm along x, y, z.
    #[must_use]
    pub fn with_tool_moved(&self, by_mm: [f64; 3]) -> Self {
        let mut moved = self.clone();
        moved.tool_mm.iter_mut().zip(by_mm).for_each(|(t, by)| *t += by);
        moved
    }

    /// Error of the tool point in the frame of the work, µm (machine x, y, z).
    /// The two functions look up axis positions (mm) and temperature differences (K). Allocates nothing.
    pub fn error_um(
        &self,
        position_mm: impl Fn(&Axis) -> f64,
        delta_k: impl Fn(&TemperatureDifference) -> f64,
    ) -> [f64; 3] {
        let position = |joint: usize| self.joints[joint].axis.as_ref().map_or(0.0, |(a, _)| position_mm(a));
        let delta = |joint: usize, component: usize| {
            self.joints[joint].components[component].delta.as_ref().map_or(0.0, &delta_k)
        };
        self.error_by_um(&position, &delta)
    }

    /// As [`Self::error_um`], with joints and components given by their index.
    fn error_by_um(
        &self,
        position_mm: &impl Fn(usize) -> f64,
        delta_k: &impl Fn(usize, usize) -> f64,
    ) -> [f64; 3] {
        let seen = |with_errors: bool| {
            let end = |branch| self.end(branch, with_errors, position_mm, delta_k);
            let tip = end(Branch::Tool).apply(self.tool_mm);
            end(Branch::Work).undo(tip).unwrap_or(tip)
        };
        let (real, ideal) = (seen(true), seen(false));
        [0, 1, 2].map(|k| 1000.0 * (real[k] - ideal[k]))
    }

    fn end(
        &self,
        branch: Branch,
        with_errors: bool,
        position_mm: &impl Fn(usize) -> f64,
        delta_k: &impl Fn(usize, usize) -> f64,
    ) -> Transform {
        let mut end = Transform::IDENTITY;
        for (number, joint) in self.joints.iter().enumerate().filter(|(_, j)| j.branch == branch) {
            let mut at = joint.offset_mm;
            let mut p = 0.0;
            if let Some((_, direction)) = &joint.axis {
                p = position_mm(number);
                for (a, d) in at.iter_mut().zip(direction) {
                    *a += d * p;
                }
            }
            end = end.after(&transform(at, [0.0; 3]));
            if with_errors {
                let mut six = [0.0; 6];
                for (component, c) in joint.components.iter().enumerate() {
                    let delta = if c.delta.is_some() { delta_k(number, component) } else { 0.0 };
                    six[c.kind] += c.value(p, delta);
                }
                let [dx, dy, dz, ex, ey, ez] = six;
                let shift_mm = [dx * 1e-3, dy * 1e-3, dz * 1e-3];
                end = end.after(&transform(shift_mm, [ex * 1e-6, ey * 1e-6, ez * 1e-6]));
            }
        }
        end
    }

    /// Looks up once what the chain reads.
    /// It finds each joint's axis and the sensors of each component's difference.
    pub(crate) fn places<A, S, E>(
        &self,
        axis: impl Fn(&Axis) -> Result<Option<A>, E>,
        sensor: impl Fn(&str) -> Result<S, E>,
    ) -> Result<Vec<JointInputIndices<A, S>>, E> {
        let joints = self.joints.iter();
        let axes = joints.clone().map(|j| j.axis.as_ref().map_or(Ok(None), |(a, _)| axis(a)));
        let axes = axes.collect::<Result<Vec<_>, E>>()?;
        let delta = |c: &JointErrorComponent| c.delta.as_ref().map(|delta| delta.find(&sensor)).transpose();
        let joint = |(j, axis): (&Joint, _)| {
            Ok(JointInputIndices { axis, deltas: j.components.iter().map(delta).collect::<Result<_, E>>()? })
        };
        joints.zip(axes).map(joint).collect()
    }

    /// As [`Self::error_um`], with the places that [`Self::places`] found.
    /// Positions (mm) and temperatures (°C) are given by place. A value without a place is zero.
    pub(crate) fn error_at_um<A, S>(
        &self,
        places: &[JointInputIndices<A, S>],
        position_mm: impl Fn(&A) -> f64,
        degc: impl Fn(&S) -> f64,
    ) -> [f64; 3] {
        let position = |joint: usize| places[joint].axis.as_ref().map_or(0.0, &position_mm);
        let delta = |joint: usize, component: usize| {
            places[joint].deltas[component].as_ref().map_or(0.0, |delta| delta.kelvin(&degc))
        };
        self.error_by_um(&position, &delta)
    }

    /// Reads a chain.
    ///
    /// # Errors
    /// The first finding, with file, line and column.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        Self::parse(path, &rtec_files::text_file::read(path)?)
    }

    /// As [`KinematicChain::read`], from text; `path` is for messages.
    ///
    /// # Errors
    /// As [`KinematicChain::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let mistaken = |e: InputError| FileKind::Chain.finding(path, text, e);
        let doc = Document::parse(path, text).map_err(mistaken)?;
        let root = doc.root();
        root.only(&["note", "tool_mm", "joint"]).map_err(mistaken)?;
        let tool_mm = triple(root.get("tool_mm"), "tool_mm = [x, y, z], mm")?.unwrap_or_default();
        let mut joints: Vec<Joint> = Vec::new();
        for t in root.required("joint", "[[joint]] tables")?.tables("[[joint]] tables")? {
            let joint = read_joint(t)?;
            if joints.iter().any(|j| j.name == joint.name) {
                return Err(t
                    .required("name", "")?
                    .error(format!("joint `{}` twice", joint.name), "each name once"));
            }
            joints.push(joint);
        }
        Ok(Self { joints, tool_mm })
    }

    /// Adds the chain's errors to a record's responses, row by row.
    /// Responses are the errors x, y and z, or the radial one of a circle.
    /// The position of an axis that the record does not log is zero ([`KinematicChain::taken_as_zero`]).
    ///
    /// # Errors
    /// A sensor that the record does not have.
    pub fn add(&self, record: &Record, response: &Role, out: &mut [f64]) -> Result<(), MissingInput> {
        let Role::Error(axis) = response else { return Ok(()) };
        let place = |axis: &Axis| ["x", "y", "z"].iter().position(|n| *n == axis.as_str());
        // The chain's x, y and z that the response takes, with the share of each (`None`: all of it).
        let parts: Vec<(usize, Option<&[f64]>)> = match (place(axis), record.circle()) {
            (Some(own), _) => vec![(own, None)],
            (None, Some(circle)) if axis.as_str() == "r" => {
                circle.plane.iter().filter_map(|a| Some((place(a)?, record.share(a)))).collect()
            }
            _ => return Ok(()),
        };
        let missing = |what: String| MissingInput { effect: "chain".to_owned(), what, has: String::new() };
        let places = self.places(
            |axis| Ok(record.data(&Role::Position(axis.clone()))),
            |s| record.temperature(s).ok_or_else(|| missing(format!("temperature.{s}"))),
        )?;
        for (row, o) in out.iter_mut().enumerate() {
            let e = self.error_at_um(&places, |p| p[row], |t| t[row]);
            *o += parts.iter().map(|(place, share)| e[*place] * share.map_or(1.0, |s| s[row])).sum::<f64>();
        }
        Ok(())
    }
}

impl JointErrorComponent {
    /// Its value, µm or µrad, at a position (mm) and temperature difference (K).
    pub fn value(&self, p_mm: f64, delta_k: f64) -> f64 {
        let of = |t: &PolynomialTerm| {
            t.coefficient
                * (p_mm / 100.0).powi(i32::from(t.position))
                * delta_k.powi(i32::from(t.temperature))
        };
        self.terms.iter().map(of).sum()
    }
}

fn triple(entry: Option<TomlKeyValue<'_>>, form: &str) -> Result<Option<[f64; 3]>, InputError> {
    let Some(entry) = entry else { return Ok(None) };
    match entry.numbers(form)?[..] {
        [x, y, z] if [x, y, z].iter().all(|v| v.abs() <= 1e6) => Ok(Some([x, y, z])),
        _ => Err(entry.error(entry.text(), form)),
    }
}

fn read_joint(t: Table<'_>) -> Result<Joint, InputError> {
    t.only(&["name", "branch", "axis", "direction", "offset_mm", "component"])?;
    let name = t.required("name", "the joint's name")?.str("the joint's name")?.to_owned();
    let entry = t.required("branch", "branch = \"work\" or \"tool\"")?;
    let branch = match entry.str("\"work\" or \"tool\"")? {
        "work" => Branch::Work,
        "tool" => Branch::Tool,
        other => return Err(entry.error(format!("branch `{other}`"), "\"work\" or \"tool\"")),
    };
    let axis = match t.get("axis") {
        None => None,
        Some(entry) => {
            let text = entry.str("an axis")?;
            let axis = Axis::new(text).ok_or_else(|| entry.error(text, "an axis' name"))?;
            if axis.is_rotary() {
                return Err(entry.error(format!("axis `{text}`, which is rotary"), LINEAR));
            }
            let form =
                "direction = [x, y, z]: where a positive position moves the joint, in the machine's frame";
            let own = |n: &str| f64::from(n == axis.as_str());
            let direction = triple(t.get("direction"), form)?.unwrap_or([own("x"), own("y"), own("z")]);
            if direction.iter().all(|d| *d == 0.0) {
                return Err(entry.error(format!("axis `{text}` without direction"), form));
            }
            Some((axis, direction))
        }
    };
    let offset_mm = triple(t.get("offset_mm"), "offset_mm = [x, y, z], mm")?.unwrap_or_default();
    let mut components = Vec::new();
    for c in t.get("component").map(|e| e.tables("component tables")).transpose()?.unwrap_or_default() {
        c.only(&["of", "sensor", "minus", "reference_degC", "terms"])?;
        let of = c.required("of", "the component, as of = \"ey\"")?;
        let kind = COMPONENTS
            .iter()
            .position(|n| Some(*n) == of.str("a component").ok())
            .ok_or_else(|| of.error(of.text(), format!("one of {}", COMPONENTS.join(", "))))?;
        let heated = ["sensor", "minus", "reference_degC"].iter().any(|key| c.get(key).is_some());
        let delta = heated.then(|| read_difference(c)).transpose()?;
        let form =
            "terms = [{ p = 1, dT = 0, value = 2.5 }]: coefficient (µm or µrad) of (p/100 mm)^p · ΔT^dT";
        let mut terms = Vec::new();
        for term in c.required("terms", form)?.tables(form)? {
            term.only(&["p", "dT", "value", "interval"])?;
            term.get("interval").map(|e| e.pair("a pair [low, high]")).transpose()?;
            let power = |key: &str| match term.get(key) {
                None => Ok(0),
                Some(e) => match e.number("a whole power from 0 to 8")? {
                    v if v.fract() == 0.0 && (0.0..=8.0).contains(&v) => Ok(v as u8),
                    v => Err(e.error(v.to_string(), "a whole power from 0 to 8")),
                },
            };
            let temperature = power("dT")?;
            if temperature > 0 && delta.is_none() {
                return Err(term.error("a power of ΔT without `sensor`", "the sensor of the component"));
            }
            terms.push(PolynomialTerm {
                position: power("p")?,
                temperature,
                // A tenth of a metre, or of a radian, per decimetre or kelvin.
                coefficient: term.required("value", form)?.within([-1e5, 1e5], "µm or µrad")?,
            });
        }
        components.push(JointErrorComponent { kind, delta, terms });
    }
    Ok(Joint { name, branch, axis, offset_mm, components })
}
/// The unit of a component, by its place in [`COMPONENTS`].
pub fn unit(kind: usize) -> &'static str {
    if kind < 3 { "µm" } else { "µrad" }
}

impl Branch {
    /// The branch's name in a chain file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Work => "work",
            Self::Tool => "tool",
        }
    }
}

impl KinematicChain {
    /// The chain as JSON.
    pub fn to_json(&self) -> serde_json::Value {
        let component = |c: &JointErrorComponent| {
            let terms: Vec<serde_json::Value> = (c.terms.iter())
                .map(|t| serde_json::json!({"p": t.position, "dT": t.temperature, "value": t.coefficient}))
                .collect();
            serde_json::json!({"of": COMPONENTS[c.kind], "unit": unit(c.kind), "delta": c.delta.as_ref().map(ToString::to_string),
                   "terms": terms})
        };
        let joints: Vec<serde_json::Value> = (self.joints.iter())
            .map(|j| {
                serde_json::json!({"name": j.name, "branch": j.branch.name(), "offset_mm": j.offset_mm,
                       "axis": j.axis.as_ref().map(|a| a.0.as_str()), "direction": j.axis.as_ref().map(|a| a.1),
                       "components": j.components.iter().map(component).collect::<Vec<_>>()})
            })
            .collect();
        serde_json::json!({"tool_mm": self.tool_mm, "joints": joints})
    }
}
