//! One axis's errors as a table for a controller that compensates itself.
//! The table is calculated from the model and checked against it.
//!
//! | module | contents | source |
//! |---|---|---|
//! | `linuxcnc` | `COMP_FILE` of type 0 and 1 | LinuxCNC 2.9, `usrmotintf.cc`, `command.c`, `control.c` |
//! | `beckhoff` | TF5200 and ISG kernel, `kw.ssfk.*` | Beckhoff Infosys, TF5200, 308695435 and 308687883 |
//! | `siemens` | `$AA_ENC_COMP` | Siemens 6FC5397-1BP40-3BA1, K3, 4.4.2; 808D function manual, p. 106 |
//! | `siemens_cec` | `$AN_CEC`, one axis's error along another axis | the same, 4.4.3, p. 248 and 249; 802D sl, p. 222 |
//! | `user_format` | a format described by the user's file | |
//! | `request` | options of an export, and messages about it | |
//!
//! A controller interpolates the table linearly and holds the end values beyond it. The residual is computed
//! with the values as written, at places that match no period.

mod beckhoff;
pub mod linuxcnc;
pub mod request;
mod siemens_cec;
mod siemens_enc_comp;
pub mod user_format;

use crate::each_once;
use rtec_files::{InputError, Result, nearest};
use rtec_model::effect::{AffectedQuantity, Effect, EffectNameAxes, RequiredInput, TemperatureDifference};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, LINEAR};
use std::fmt::Write as _;
use std::ops::RangeInclusive;
use std::path::Path;

/// Longest axis of a machine tool, mm.
const LONGEST_MM: f64 = 100_000.0;
/// Places between two points at which a table is checked, and their largest total.
const PLACES: (usize, usize) = (24, 40_000);
/// Most points of any controller.
const MANY: usize = 100_000;
/// Round steps, as multiples of a power of ten.
const ROUND: [f64; 6] = [8.0, 5.0, 4.0, 2.5, 2.0, 1.0];

/// One point of a table: the axis's error in both directions of approach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CompensationPoint {
    /// Commanded position, mm.
    pub position_mm: f64,
    /// Position reached less commanded position, moving up, µm.
    pub up_um: f64,
    /// The same moving down.
    pub down_um: f64,
}

impl CompensationPoint {
    /// Mean of both directions, µm.
    pub(crate) fn mean_um(&self) -> f64 {
        f64::midpoint(self.up_um, self.down_um)
    }
}

/// Requirements of a format.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FormatRequirements {
    pub most: usize,
    pub position_mm: f64,
    pub value_um: f64,
    /// Whether it has values for both directions; otherwise it takes their mean.
    pub both: bool,
    /// The position at which the value must be zero, mm.
    pub zero_at_mm: Option<f64>,
    /// Where the controller looks a value up.
    pub lookup: LookupPosition,
}

impl FormatRequirements {
    /// Rules for values in both directions, looked up at the commanded position.
    fn both_directions(most: usize, position_mm: f64, value_um: f64) -> Self {
        Self { most, position_mm, value_um, both: true, zero_at_mm: None, lookup: LookupPosition::Commanded }
    }

    /// Rules of SINUMERIK: one value for both directions, zero at a reference point.
    fn siemens(most: usize, reference_mm: f64) -> Self {
        let (zero_at_mm, lookup) = (Some(reference_mm), LookupPosition::Encoder);
        Self { both: false, zero_at_mm, lookup, ..Self::both_directions(most, 1e-4, 1e-3) }
    }
}

/// The position at which a controller looks up a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LookupPosition {
    /// The commanded position.
    /// The value moves the drive to another position, where the error differs.
    Commanded,
    /// The position that the encoder reads: value and error belong to one place.
    Encoder,
}

/// A format of tables.
pub(crate) trait CompensationFormat {
    fn rules(&self) -> FormatRequirements;

    fn text(&self, table: &CompensationTable) -> Result<String>;

    /// Advice for the person who loads the table.
    fn advice(&self, _: &CompensationTable) -> Vec<String> {
        Vec::new()
    }
}

/// Plain columns: `position_mm,error_up_um,error_down_um`.
#[derive(Debug)]
pub(crate) struct CompensationCsvFormat;

impl CompensationFormat for CompensationCsvFormat {
    fn rules(&self) -> FormatRequirements {
        FormatRequirements::both_directions(MANY, 1e-6, 1e-6)
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        let mut text = "position_mm,error_up_um,error_down_um\n".to_owned();
        for p in &table.points {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{},{},{}", p.position_mm, p.up_um, p.down_um);
        }
        Ok(text)
    }
}

// The documentation of the fields is the help of `rtecctl model export`.
/// Range and accuracy of a table
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct TableRange {
    /// Lowest position, mm
    #[cfg_attr(feature = "clap", arg(long = "from", value_name = "FROM"))]
    pub from_mm: f64,
    /// Highest position, mm
    #[cfg_attr(feature = "clap", arg(long = "to", value_name = "TO"))]
    pub to_mm: f64,
    /// Distance between positions, mm; chosen from the model where it is not given
    #[cfg_attr(feature = "clap", arg(long = "step", value_name = "STEP"))]
    pub step_mm: Option<f64>,
    /// How far the table may be off the model between its positions, um; a warning above
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 0.5))]
    pub limit_um: f64,
    /// Most positions (linuxcnc 256; siemens 200 unless MD38000 says more; ssfk 1500 unless P-COMP-00059 says more)
    #[cfg_attr(feature = "clap", arg(long = "max-points", value_name = "MAX_POINTS"))]
    pub most: Option<usize>,
}

fn usage(found: impl Into<String>, expected: impl Into<String>) -> InputError {
    InputError::whole(Path::new("model export"), found, expected)
}

/// The model's errors of one axis at rest, by direction of approach.
/// Parts that depend on speed, time and load are left out.
#[derive(Debug)]
pub(crate) struct StaticErrors<'m> {
    machine: &'m Machine,
    axis: Axis,
    layout: MachineStateLayout,
    degc: Vec<f64>,
    /// Positions of the axes in the layout's order, mm; the table's own comes first.
    places_mm: Vec<f64>,
    /// Axes of a chain without a stated position.
    unstated: Vec<String>,
    /// Index in the layout of the table's axis; 0 except for cross tables.
    moving: usize,
}

impl<'m> StaticErrors<'m> {
    /// The axis's errors at these temperatures and positions of the other axes.
    /// Sensors without a value are at 20 °C, axes at 0 mm.
    pub(crate) fn of(
        machine: &'m Machine,
        axis: &str,
        temperatures: &[(String, f64)],
        others_mm: &[(String, f64)],
    ) -> Result<Self> {
        if Axis::new(axis).is_some_and(|a| a.is_rotary()) {
            return Err(usage(format!("--axis {axis}: a rotary axis"), LINEAR));
        }
        let known = axes(machine);
        let Some(axis) = Axis::new(axis).filter(|a| known.contains(a)) else {
            let names: Vec<&str> = known.iter().map(Axis::as_str).collect();
            let expected = match (nearest(axis, &names), names.is_empty()) {
                (_, true) => "a model with position errors".to_owned(),
                (Some(near), _) => format!("an axis that the model has errors of; did you mean {near}?"),
                _ => format!("an axis that the model has errors of: {}", names.join(", ")),
            };
            return Err(usage(format!("--axis {axis}"), expected));
        };
        let names = machine.sensors();
        let mut degc = vec![20.0; names.len()];
        let expected = if names.is_empty() {
            "no temperatures: the model reads no sensor".to_owned()
        } else {
            format!("SENSOR=degC with a sensor of the model: {}", names.join(", "))
        };
        let range = (-100.0..=200.0, "a temperature from -100 to 200 degC");
        for (place, value) in
            placed("--temperatures", temperatures, &names, [&expected, "each sensor once"], range)?
        {
            degc[place] = value;
        }
        let mut axes = vec![axis.clone()];
        axes.extend(machine.effects().flat_map(Effect::axes).cloned());
        if let Some(chain) = machine.chain() {
            axes.extend(chain.joints.iter().filter_map(|j| j.axis.as_ref().map(|(a, _)| a.clone())));
        }
        let channels = machine.effects().filter_map(Effect::channel).map(str::to_owned);
        let layout =
            MachineStateLayout { axes: each_once(axes), sensors: names, channels: each_once(channels) };
        let mut places_mm = vec![0.0; layout.axes.len()];
        let others: Vec<String> = layout.axes[1..].iter().map(ToString::to_string).collect();
        let of = if others.is_empty() { "the model reads none".to_owned() } else { others.join(", ") };
        let expected = format!("AXIS=mm with another axis of the model: {of}");
        let range = (-1e6..=1e6, "a place from -1e6 to 1e6 mm");
        for (place, value) in placed("--at", others_mm, &others, [&expected, "each axis once"], range)? {
            places_mm[place + 1] = value;
        }
        let stated = |a: &&Axis| others_mm.iter().any(|(name, _)| name == a.as_str());
        let of_chain = layout.axes[1..].iter().filter(|_| machine.chain().is_some());
        let unstated = of_chain.filter(|a| !stated(a)).map(ToString::to_string).collect();
        Ok(Self { machine, axis, layout, degc, places_mm, unstated, moving: 0 })
    }

    /// The errors along another axis, with the own axis at `own_mm`: a cross table.
    /// They come from squareness, straightness and sag.
    pub(crate) fn across(mut self, along: &str, own_mm: f64) -> Result<Self> {
        let acts = |e: &&Effect| acts_on(e, &self.axis);
        let mut others: Vec<&str> =
            self.machine.effects().filter(acts).flat_map(Effect::axes).map(Axis::as_str).collect();
        if self.machine.chain().is_some() {
            others.extend(self.layout.axes.iter().map(Axis::as_str));
        }
        others.sort_unstable();
        others.dedup();
        others.retain(|a| *a != self.axis.as_str());
        if !others.contains(&along) {
            let found = format!("--along {along}: no error of {} depends on it", self.axis);
            let expected = match others.as_slice() {
                [] => "no --along: the model has no error of this axis across another".to_owned(),
                all => format!("an axis that an error of {} depends on: {}", self.axis, all.join(", ")),
            };
            return Err(usage(found, expected));
        }
        self.moving = self.layout.axes.iter().position(|a| a.as_str() == along).unwrap_or_default();
        self.places_mm[0] = own_mm;
        Ok(self)
    }

    /// Whether an effect is in the table.
    /// A cross table holds effects of the axis that it runs along.
    fn is_in_table(&self, effect: &Effect) -> bool {
        acts_on(effect, &self.axis)
            && (self.moving == 0 || effect.axes().contains(&self.layout.axes[self.moving]))
    }

    /// Errors at these rising positions, µm, approached from below (`up`) or above.
    pub(crate) fn along(&self, positions_mm: &[f64], up: bool) -> Result<Vec<f64>> {
        let mut live = self.live()?;
        let (mut column, n) = (vec![0.0; positions_mm.len()], positions_mm.len());
        for k in 0..n {
            let i = if up { k } else { n - 1 - k };
            column[i] = self.at(&mut live, positions_mm[i], if up { 1.0 } else { -1.0 });
        }
        Ok(column)
    }

    /// Spike after a reversal at a position, µm, which no table of positions can hold.
    pub(crate) fn behind_turn_um(&self, position_mm: f64) -> Result<f64> {
        let behind = |up: bool| -> Result<f64> {
            let way = if up { 1.0 } else { -1.0 };
            let (mut turns, mut goes_on) = (self.live()?, self.live()?);
            self.at(&mut turns, position_mm, -way);
            let turned = self.at(&mut turns, position_mm, way);
            Ok((turned - self.at(&mut goes_on, position_mm, way)).abs())
        };
        Ok(behind(true)?.max(behind(false)?))
    }

    fn live(&self) -> Result<LiveModel> {
        LiveModel::at_work(self.machine, self.layout.clone())
            .map_err(|e| usage(e.to_string(), "sensors and axes only"))
    }

    fn at(&self, live: &mut LiveModel, position_mm: f64, direction: f64) -> f64 {
        let at = |p: &f64| AxisMotionState { position_mm: *p, ..AxisMotionState::default() };
        let mut axes: Vec<AxisMotionState> = self.places_mm.iter().map(at).collect();
        axes[self.moving] = AxisMotionState { position_mm, direction, ..AxisMotionState::default() };
        let channels = vec![0.0; self.layout.channels.len()];
        let (axes, temperatures_degc, channels) = (&axes[..], &self.degc[..], &channels[..]);
        live.evaluate(&MachineState { axes, temperatures_degc, channels, ..MachineState::default() });
        live.errors_um()[0]
    }

    /// Sensors that the axis's errors use, with the table's temperatures, °C.
    /// A sensor without a stated temperature is at 20 °C.
    pub(crate) fn temperatures_degc(&self) -> Result<Vec<(&str, f64)>> {
        let live = self.live()?;
        let parts = live.parts().filter(|p| self.is_in_table(p.effect));
        let read: Vec<&str> =
            parts.filter_map(|p| p.effect.delta.as_ref()).flat_map(TemperatureDifference::sensors).collect();
        let all = self.layout.sensors.iter().zip(&self.degc);
        let chained = self.machine.chain().is_some();
        let own = all.filter(|(name, _)| chained || read.contains(&name.as_str()));
        Ok(own.map(|(name, degc)| (name.as_str(), *degc)).collect())
    }

    /// Warnings about the table.
    /// Effects of the axis that a table of positions cannot hold, and temperatures outside the range of a
    /// fit.
    pub(crate) fn doubts(&self) -> Result<Vec<String>> {
        let mut live = self.live()?;
        self.at(&mut live, 0.0, 1.0);
        let mut doubts = Vec::new();
        if !self.unstated.is_empty() {
            let others = self.unstated.join(", ");
            doubts.push(format!("the table holds with {others} at 0 mm; --at states another place"));
        }
        let angular =
            |e: &&Effect| e.description().needs.contains(&RequiredInput::Angle) && self.is_in_table(e);
        for effect in self.machine.effects().filter(angular) {
            let why = "is over the angle of a circle, which a table of positions does not have";
            doubts.push(format!("{}: {why}: it is not in the table", effect.name()));
        }
        let along = &self.layout.axes[self.moving];
        for part in live.parts().filter(|p| self.is_in_table(p.effect)) {
            let own = part.effect.axes().first() == Some(along);
            let held = |need: &RequiredInput| match need {
                RequiredInput::Position(n) if part.effect.axes()[*n] != *along => {
                    Some("with the other axes where --at puts them, otherwise at 0 mm")
                }
                RequiredInput::Direction if !own => Some("with the other axes at rest"),
                RequiredInput::Position(_)
                | RequiredInput::Direction
                | RequiredInput::Delta
                | RequiredInput::Angle => None,
                RequiredInput::Time => Some("at time 0"),
                RequiredInput::Velocity | RequiredInput::Acceleration => Some("at rest"),
                RequiredInput::Load => Some("without load"),
                RequiredInput::SpindleSpeed => Some("with the spindle at rest"),
                RequiredInput::Coolant => Some("without coolant"),
                RequiredInput::Channel => Some("with its channel at 0"),
            };
            let turned = part.effect.description().after_turn.then_some("far from where the axis turned");
            if let Some(held) = part.effect.description().needs.iter().find_map(held).or(turned) {
                doubts.push(format!("{}: the table holds its value {held}", part.effect.name()));
            }
            let (name, outside_k, percent) = (part.effect.name(), part.outside_k, 100.0 * part.weight);
            if outside_k > 0.0 {
                doubts.push(format!(
                    "{name}: the temperatures are {outside_k:.1} K outside the range that it was fitted on; {percent:.0} % of it is in the table"
                ));
            }
        }
        Ok(doubts)
    }
}

/// Places of the named values of an option among the known names, with the values.
/// `expected` is one of the names, and each only once.
fn placed(
    option: &str,
    given: &[(String, f64)],
    known: &[String],
    [expected, once]: [&str; 2],
    (range, of_range): (RangeInclusive<f64>, &str),
) -> Result<Vec<(usize, f64)>> {
    let of = |(n, (name, value)): (usize, &(String, f64))| {
        let words = format!("{option} {name}={value}");
        match known.iter().position(|k| k == name) {
            None => Err(usage(words, expected)),
            _ if given[..n].iter().any(|(o, _)| o == name) => {
                Err(usage(format!("{words} a second time"), once))
            }
            _ if !range.contains(value) => Err(usage(words, of_range)),
            Some(place) => Ok((place, *value)),
        }
    };
    given.iter().enumerate().map(of).collect()
}

fn acts_on(effect: &Effect, axis: &Axis) -> bool {
    let description = effect.description();
    let components = if description.naming == EffectNameAxes::Pair { 2 } else { 1 };
    description.quantity == AffectedQuantity::Error
        && effect.axes().iter().take(components).any(|a| a == axis)
}

/// The axes with errors in a model.
fn axes(machine: &Machine) -> Vec<Axis> {
    let own = machine.listed().iter().filter(|l| !l.provenance.set_up).map(|l| &l.effect);
    let mut known: Vec<Axis> = own
        .flat_map(|e| e.axes().iter().filter(move |a| acts_on(e, a)).cloned())
        .chain(machine.chain().iter().flat_map(|_| ["x", "y", "z"]).filter_map(Axis::new))
        .collect();
    known.sort();
    known.dedup();
    known
}

/// A table with values as written, and its residual against the model.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CompensationTable {
    pub axis: Axis,
    /// Its points with rising positions, and values as written.
    pub points: Vec<CompensationPoint>,
    /// Distance between them, mm.
    pub step_mm: f64,
    /// Constant subtracted from all values so that the reference point is zero, µm.
    /// It shifts the zero of the axis.
    pub constant_um: f64,
    pub left: TableResidual,
    /// Largest error between points, µm, which more points could reduce.
    /// With one value for both directions, it is measured against their mean.
    pub between_um: f64,
}

/// Residual of the model over the compensated travel, without the constant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TableResidual {
    /// Largest absolute value moving up, µm.
    pub max_up_um: f64,
    /// Largest absolute value moving down, µm.
    pub max_down_um: f64,
    /// Root mean square over both directions, µm.
    pub rms_um: f64,
}

impl TableResidual {
    /// Largest absolute value of both directions, µm.
    pub(crate) fn max_um(&self) -> f64 {
        self.max_up_um.max(self.max_down_um)
    }
}

/// Errors of the model at many places.
struct DenseModelErrors {
    positions_mm: Vec<f64>,
    up_um: Vec<f64>,
    down_um: Vec<f64>,
}

/// Linear interpolation at rising places; the end values beyond the ends.
fn interpolate<'a>(
    points: &'a [CompensationPoint],
    places_mm: &'a [f64],
    value: fn(&CompensationPoint) -> f64,
) -> impl Iterator<Item = f64> + 'a {
    let mut next = 0;
    places_mm.iter().map(move |p| {
        while next < points.len() && points[next].position_mm < *p {
            next += 1;
        }
        match (next.checked_sub(1).map(|i| &points[i]), points.get(next)) {
            (Some(a), Some(b)) => {
                let part = (p - a.position_mm) / (b.position_mm - a.position_mm);
                value(a) + part * (value(b) - value(a))
            }
            (Some(one), None) | (None, Some(one)) => value(one),
            (None, None) => 0.0,
        }
    })
}

fn round_to(value: f64, resolution: f64) -> f64 {
    // Division by a whole number gives decimal fractions exactly as written.
    let inverse = resolution.recip().round();
    if resolution < 1.0 && (inverse * resolution - 1.0).abs() < 1e-9 {
        (value * inverse).round() / inverse
    } else {
        (value / resolution).round() * resolution
    }
}

impl CompensationTable {
    /// The table for a format, with the given step or the widest within the limit.
    /// If no step keeps the limit, the table with the smallest error is used.
    pub(crate) fn of(
        errors: &StaticErrors<'_>,
        wanted: &TableRange,
        rules: &FormatRequirements,
    ) -> Result<Self> {
        let (from, to) = (wanted.from_mm, wanted.to_mm);
        if !(from.abs() <= LONGEST_MM && to.abs() <= LONGEST_MM && to - from >= rules.position_mm) {
            let step = rules.position_mm;
            let expected = format!("a range that rises, within {LONGEST_MM} mm of 0, in steps of {step} mm");
            return Err(usage(format!("--from {from} --to {to}"), expected));
        }
        if !(wanted.limit_um > 0.0 && wanted.limit_um.is_finite()) {
            return Err(usage(format!("--limit-um {}", wanted.limit_um), "a limit above 0 um"));
        }
        if let Some(zero) = rules.zero_at_mm.filter(|z| !(from..=to).contains(z)) {
            let expected = format!("the reference point within the range, {from} to {to} mm");
            return Err(usage(format!("--reference-mm {zero}"), expected));
        }
        let most = wanted.most.unwrap_or(rules.most);
        let takes = rules.most.clamp(2, MANY);
        if !(2..=takes).contains(&most) {
            let expected = format!("from 2 to {takes}, as the format takes");
            return Err(usage(format!("--max-points {most}"), expected));
        }
        let dense = DenseModelErrors::of(errors, from, to, most)?;
        if let Some(step) = wanted.step_mm {
            let smallest = rules.position_mm;
            if !(step >= smallest && step.is_finite()) {
                return Err(usage(format!("--step {step}"), format!("a step of at least {smallest} mm")));
            }
            let whole = |v: f64| (v / smallest - (v / smallest).round()).abs() < 1e-3;
            if !whole(step) || !whole(from) {
                let expected = format!("multiples of {smallest} mm, as the format writes positions");
                return Err(usage(format!("--from {from} --step {step}"), expected));
            }
            let points = ((to - from) / step - 1e-9).ceil() + 1.0;
            if points > most as f64 {
                let step = (to - from) / (most - 1) as f64;
                let least = format!("a --step of at least {step:.4} mm");
                let expected = format!("at most {most} points, that is {least}; or none, to have it chosen");
                return Err(usage(format!("{points} points"), expected));
            }
            return Self::with_step(errors, &dense, [from, to], step, rules)?.applied(errors, &dense, rules);
        }
        let mut best: Option<Self> = None;
        let mut applied: Option<Self> = None;
        for step in steps(to - from, most, rules.position_mm) {
            let table = Self::with_step(errors, &dense, [from, to], step, rules)?;
            if table.between_um <= wanted.limit_um {
                let table = table.applied(errors, &dense, rules)?;
                if !rules.both || table.left.max_um() <= wanted.limit_um {
                    return Ok(table);
                }
                // More points cannot reduce the error from the table's own movement.
                if table.left.max_um() - table.between_um >= wanted.limit_um {
                    return Ok(applied.unwrap_or(table));
                }
                applied = Some(table);
            } else if best.as_ref().is_none_or(|b| table.between_um < b.between_um) {
                best = Some(table);
            }
        }
        match (applied, best) {
            (Some(applied), _) => Ok(applied),
            (None, Some(best)) => best.applied(errors, &dense, rules),
            (None, None) => Err(usage(format!("--max-points {most}"), "enough points for the range")),
        }
    }

    fn with_step(
        errors: &StaticErrors<'_>,
        dense: &DenseModelErrors,
        [from, to]: [f64; 2],
        step_mm: f64,
        rules: &FormatRequirements,
    ) -> Result<Self> {
        let intervals = (((to - from) / step_mm - 1e-9).ceil() as usize).max(1);
        let places: Vec<f64> =
            (0..=intervals).map(|i| round_to(from + step_mm * i as f64, rules.position_mm)).collect();
        if places.windows(2).any(|w| w[1] <= w[0]) {
            let expected = format!("steps above {} mm", rules.position_mm);
            return Err(usage(format!("steps of {step_mm} mm"), expected));
        }
        let (up, down) = (errors.along(&places, true)?, errors.along(&places, false)?);
        let rows = places.iter().zip(up.iter().zip(&down));
        let mut points: Vec<CompensationPoint> = rows
            .map(|(&position_mm, (&up_um, &down_um))| CompensationPoint { position_mm, up_um, down_um })
            .collect();
        for p in points.iter_mut().filter(|_| !rules.both) {
            (p.up_um, p.down_um) = (p.mean_um(), p.mean_um());
        }
        let at = |zero: f64| interpolate(&points, &[zero], CompensationPoint::mean_um).next();
        let constant_um = rules.zero_at_mm.and_then(at).unwrap_or(0.0);
        for p in &mut points {
            p.up_um = round_to(p.up_um - constant_um, rules.value_um);
            p.down_um = round_to(p.down_um - constant_um, rules.value_um);
        }
        let (axis, left) = (errors.axis.clone(), TableResidual::default());
        let mut table = Self { axis, points, step_mm, constant_um, left, between_um: 0.0 };
        table.judge(dense, rules.both);
        if !(table.left.max_um().is_finite() && table.between_um.is_finite()) {
            return Err(usage("errors that are no numbers there", "positions at which the model has values"));
        }
        Ok(table)
    }

    /// The table with its residual where a controller applies it.
    /// A controller that looks up the commanded position moves the drive to a place with another error. Near
    /// a large reversal that is a good part of a screw's wave.
    fn applied(
        mut self,
        errors: &StaticErrors<'_>,
        dense: &DenseModelErrors,
        rules: &FormatRequirements,
    ) -> Result<Self> {
        if rules.lookup == LookupPosition::Encoder {
            // `judge` already used value and error of one place.
            return Ok(self);
        }
        let moved = |value: fn(&CompensationPoint) -> f64, up: bool| -> Result<Vec<f64>> {
            let values: Vec<f64> = interpolate(&self.points, &dense.positions_mm, value).collect();
            let places = dense.positions_mm.iter().zip(&values);
            let driven: Vec<f64> = places.map(|(p, um)| p - um / 1000.0).collect();
            let errors_um = errors.along(&driven, up)?;
            Ok(errors_um.iter().zip(&values).map(|(e, um)| e - self.constant_um - um).collect())
        };
        let (up, down) = (moved(|p| p.up_um, true)?, moved(|p| p.down_um, false)?);
        let largest = |left: &[f64]| left.iter().map(|um| um.abs()).fold(0.0, f64::max);
        let squares: f64 = up.iter().chain(&down).map(|um| um * um).sum();
        self.left = TableResidual {
            max_up_um: largest(&up),
            max_down_um: largest(&down),
            rms_um: (squares / (2 * up.len()) as f64).sqrt(),
        };
        Ok(self)
    }

    fn judge(&mut self, dense: &DenseModelErrors, both: bool) {
        let up = interpolate(&self.points, &dense.positions_mm, |p| p.up_um);
        let down = interpolate(&self.points, &dense.positions_mm, |p| p.down_um);
        let mut squares = 0.0;
        for ((up, down), (model_up, model_down)) in up.zip(down).zip(dense.up_um.iter().zip(&dense.down_um)) {
            let (u, d) = (model_up - self.constant_um - up, model_down - self.constant_um - down);
            self.left.max_up_um = self.left.max_up_um.max(u.abs());
            self.left.max_down_um = self.left.max_down_um.max(d.abs());
            squares += u * u + d * d;
            let between = if both { u.abs().max(d.abs()) } else { f64::midpoint(u, d).abs() };
            self.between_um = self.between_um.max(between);
        }
        self.left.rms_um = (squares / (2 * dense.positions_mm.len()) as f64).sqrt();
    }

    /// Step, lowest and highest position in mm, as SINUMERIK writes them.
    fn grid(&self) -> [String; 3] {
        [self.step_mm, self.start_mm(), self.end_mm()].map(|mm| number(mm, 4))
    }

    /// The lowest position, mm.
    pub(crate) fn start_mm(&self) -> f64 {
        self.points.first().map_or(0.0, |p| p.position_mm)
    }

    /// The highest position, mm.
    pub(crate) fn end_mm(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.position_mm)
    }
}

impl DenseModelErrors {
    /// Evenly spread places, each shifted within its interval by the golden ratio.
    /// So no period of an error matches them.
    fn of(errors: &StaticErrors<'_>, from: f64, to: f64, most: usize) -> Result<Self> {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let n = (most * PLACES.0).clamp(PLACES.1 / 4, PLACES.1);
        let stretch = (to - from) / n as f64;
        let mut positions_mm = vec![from];
        positions_mm.extend((0..n).map(|i| from + stretch * (i as f64 + (i as f64 * GOLDEN).fract())));
        positions_mm.push(to);
        let (up_um, down_um) = (errors.along(&positions_mm, true)?, errors.along(&positions_mm, false)?);
        Ok(Self { positions_mm, up_um, down_um })
    }
}

/// Steps to try: round steps that divide the travel, and fractions of it.
/// Those that end at the end of the travel come first, each group with the widest first.
fn steps(span_mm: f64, most: usize, position_mm: f64) -> Vec<f64> {
    let up = |step: f64| round_to((step / position_mm - 1e-6).ceil().max(1.0) * position_mm, position_mm);
    let mut steps = Vec::new();
    let whole = (span_mm / position_mm).round();
    for parts in 1..most.min(MANY) {
        let per = whole / parts as f64;
        if (span_mm / position_mm - whole).abs() < 1e-6 && (per - per.round()).abs() < 1e-9 && per >= 1.0 {
            steps.push(per * position_mm);
        }
    }
    for power in -7..=5 {
        for part in ROUND {
            let step = part * 10f64.powi(power);
            let parts = span_mm / step;
            let divides = (parts - parts.round()).abs() < 1e-6 && parts.round() >= 1.0;
            if divides && parts < most as f64 - 0.5 && (up(step) - step).abs() < 1e-9 {
                steps.push(step);
            }
        }
    }
    let mut parts = 1;
    while parts < most {
        steps.push(up(span_mm / parts as f64));
        parts = (parts * 9 / 8).max(parts + 1);
    }
    steps.push(up(span_mm / (most - 1) as f64));
    let past = |step: &f64| (span_mm / step - 1e-9).ceil().max(1.0) * step - span_mm > position_mm / 2.0;
    steps.sort_by(|a, b| past(a).cmp(&past(b)).then(b.total_cmp(a)));
    steps.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    steps
}

/// A number with this many decimals; zero has no sign.
pub(crate) fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let is_zero = text.trim_start_matches(['-', '0', '.']).is_empty();
    if is_zero { text.trim_start_matches('-').to_owned() } else { text }
}
