//! Accuracy and repeatability of positioning, ISO 230-2:2014.

use super::conditions::REFERENCE_DEGC;
use super::{
    ALIKE, ExpandingBody, MeasuredPosition, PositioningUncertainty, TestConditions, alike, lacks, largest,
    mean_and_s, mean_of, no_temperature, places, range, spread, targets,
};
use crate::gauge_resolution::ReadingResolution;
use crate::plot::{Chart, Colour, Series, Style};
use rtec_files::Result;
use rtec_files::text_file::short;
use rtec_model::record::{Axis, Column, Record, Role, mean};
use serde::Serialize;
use std::collections::BTreeMap;

mod drift_or_step;

use drift_or_step::{DriftOrStep, UNCHANGED};
pub use drift_or_step::{SharedDrift, SharedStep};

/// Axes longer than this, mm, have one approach from each side and no s.
/// (ISO 230-2:2014, 5.3.3.)
pub(crate) const LONG_AXIS_MM: f64 = 2000.0;
/// Largest mean distance of targets on a long axis, mm.
pub(crate) const LONG_INTERVAL_MM: f64 = 250.0;
/// Fewest targets on an axis and per metre, and fewest approaches from each side.
pub(crate) const FEWEST: usize = 5;
/// µrad in an arcsecond.
const URAD_PER_ARCSEC: f64 = std::f64::consts::PI / 648_000.0 * 1e6;

/// Options of an evaluation.
#[derive(Debug, Clone, Default)]
pub struct PositioningOptions {
    /// Evaluate runs approached from one side only, with the one-sided figures.
    pub one_way: bool,
    /// Conditions of the test.
    pub conditions: TestConditions,
}

/// One target of a positioning run.
/// Values in µm (of tilts in µrad) unless named otherwise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TargetResult {
    /// Target position, mm.
    pub position_mm: f64,
    /// Mean deviation approaching upwards, x̄↑.
    pub mean_up: Option<f64>,
    /// Mean deviation approaching downwards, x̄↓.
    pub mean_down: Option<f64>,
    /// Estimator of the standard uncertainty of positioning upwards, s↑.
    pub s_up: Option<f64>,
    /// Estimator of the standard uncertainty of positioning downwards, s↓.
    pub s_down: Option<f64>,
    /// Reversal value Bᵢ = x̄↑ − x̄↓.
    #[serde(rename = "B")]
    pub reversal: Option<f64>,
    /// Bidirectional repeatability of positioning at this target, Rᵢ.
    #[serde(rename = "R")]
    pub repeatability: Option<f64>,
    /// Approaches upwards and downwards.
    pub approaches: [usize; 2],
}

/// Accuracy and repeatability of positioning, ISO 230-2:2014.
/// Values in µm, of tilts in µrad; `None` if the run has one direction only, or (figures with s) for a long
/// axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(non_snake_case)]
#[allow(missing_docs)] // the standard's own symbols
pub struct PositioningResult {
    pub axis: String,
    /// The response, as `error.y` or `angle_error.x.b`.
    pub response: String,
    /// Unit of the figures: um or urad.
    pub unit: &'static str,
    pub A: Option<f64>,
    pub A_up: Option<f64>,
    pub A_down: Option<f64>,
    pub E: Option<f64>,
    pub E_up: Option<f64>,
    pub E_down: Option<f64>,
    pub R: Option<f64>,
    pub R_up: Option<f64>,
    pub R_down: Option<f64>,
    pub B: Option<f64>,
    pub B_mean: Option<f64>,
    pub M: Option<f64>,
    /// The figures of a tilt in arcseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arcsec: Option<BTreeMap<String, Option<f64>>>,
    /// Expanded uncertainties, if the conditions state contributors.
    pub uncertainty: Option<PositioningUncertainty>,
    /// Rounding error of the means in a coarse gauge; set if most repeats are equal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resolution: Option<GaugeResolution>,
    /// The drift of the approaches, if it is beyond chance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drift: Option<SharedDrift>,
    /// The step of the approaches, if it explains them better than a drift.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<SharedStep>,
    /// Distance from the first to the last target, mm.
    pub travel_mm: f64,
    /// Which test of the standard it is.
    pub test: &'static str,
    pub targets: Vec<TargetResult>,
    pub warnings: Vec<String>,
}

/// Resolution of a gauge, in the unit of the figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GaugeResolution {
    /// The step that all readings are multiples of.
    pub step: f64,
    /// Largest rounding error of a mean.
    pub mean_within: f64,
    /// Largest rounding error of a reversal, the difference of two means.
    pub reversal_within: f64,
}

/// Whether a record holds an error (or tilt) along an axis beside its position.
pub fn has_positioning(record: &Record) -> bool {
    record.columns.iter().any(|c| match &c.role {
        Role::Error(axis) | Role::AngleError(axis, _) => record.position(axis).is_some(),
        _ => false,
    })
}

/// Evaluates a positioning run, axis by axis.
///
/// # Errors
/// As [`positioning_with`].
pub fn positioning(record: &Record) -> Result<Vec<PositioningResult>> {
    positioning_with(record, &PositioningOptions::default())
}

/// Evaluates a positioning run, axis by axis: errors in µm, tilts in µrad.
///
/// # Errors
/// No axis with error (or tilt), position and direction of approach; an invalid direction; position and error
/// swapped.
/// One side only without `one_way`; no target with two approaches from one side on an axis of up to 2 m; a
/// sensor of the conditions that the record lacks.
pub fn positioning_with(record: &Record, options: &PositioningOptions) -> Result<Vec<PositioningResult>> {
    let mut found = Vec::new();
    for column in &record.columns {
        let (Role::Error(axis) | Role::AngleError(axis, _)) = &column.role else { continue };
        let Some(position) = record.position(axis) else { continue };
        let direction = direction_of(record, axis)?;
        swapped(record, column, position)?;
        let (error, notes) = (column.data.clone(), Vec::new());
        let mut run = AxisRun { record, axis, column, position, direction, error, notes };
        if column.unit == "arcsec" {
            run.error.iter_mut().for_each(|v| *v *= URAD_PER_ARCSEC);
        } else if matches!(column.role, Role::Error(_)) {
            run.reduce(&options.conditions)?;
        }
        found.push(run.evaluate(options)?);
    }
    if found.is_empty() {
        let expected = "columns error.AXIS (or angle_error.AXIS.ABOUT) and position.AXIS of the same axis; an error across the axis \
                        that moves is its straightness (--standard straightness)";
        return Err(lacks(record, "no axis with both error and position", expected));
    }
    Ok(found)
}

/// The direction of approach of every row.
fn direction_of<'r>(record: &'r Record, axis: &Axis) -> Result<&'r [f64]> {
    let role = Role::Direction(axis.clone());
    let expected = "a column of role direction.AXIS";
    let direction = record
        .direction_or_velocity(axis)
        .ok_or_else(|| lacks(record, "no direction of approach", expected))?;
    let count = |of: fn(f64) -> bool| direction.iter().filter(|d| of(**d)).count();
    let (zeros, ups, downs) = (count(|d| d == 0.0), count(|d| d > 0.0), count(|d| d < 0.0));
    // A row of direction 0 belongs to neither side; a quarter of such rows is a mistake.
    if zeros > 0 && (ups == 0) != (downs == 0) && 4 * zeros > direction.len() {
        let (seen, lost) = if ups > 0 { (1, "downwards") } else { (-1, "upwards") };
        let rows = ups + downs;
        let only = format!("a {role} of only 0 ({zeros} rows) and {seen:+} ({rows} rows)");
        let found = format!("{only}: 0 looks as if it stood for {lost}");
        return Err(lacks(record, &found, "+1 for an approach upwards and -1 for one downwards"));
    }
    if ups + downs == 0 {
        return Err(lacks(record, &format!("a {role} of 0 in every row"), "+1 upwards, -1 downwards"));
    }
    Ok(direction)
}

/// Refuses a record in which the error and the position look exchanged.
/// Targets are a few repeated places, errors are not.
fn swapped(record: &Record, error: &Column, position: &[f64]) -> Result<()> {
    let n = position.len();
    let (places, values) = (targets(position).len(), alike(&error.data, ALIKE).len());
    let is_wider = spread(&error.data) > spread(position);
    if n >= 10 && 2 * places > n && 4 * values <= n && values > 1 && is_wider {
        let found = format!(
            "{places} targets in {n} rows, while `{}` (role {}) has {values} values again and again: position and error \
             look swapped",
            error.name, error.role
        );
        let expected = "a few target positions, approached several times each, and the error there";
        return Err(lacks(record, &found, expected));
    }
    Ok(())
}

/// One axis of a run.
struct AxisRun<'r> {
    record: &'r Record,
    axis: &'r Axis,
    column: &'r Column,
    position: &'r [f64],
    direction: &'r [f64],
    error: Vec<f64>,
    notes: Vec<String>,
}

impl AxisRun<'_> {
    /// Corrects the error for the laser's air and reduces it to 20 °C.
    /// Scale and work piece have the expansions and sensors of the conditions.
    fn reduce(&mut self, conditions: &TestConditions) -> Result<()> {
        if let Some(air) = &conditions.air {
            let (corrected, words) = air.corrected(self.record, self.position, &self.error)?;
            self.error = corrected;
            self.notes.push(words);
        } else if *conditions != TestConditions::default() {
            let note = "the laser's air is as the instrument took it: no [air] in the conditions";
            self.notes.push(note.to_owned());
        }
        let mut words = Vec::new();
        let bodies = [(&conditions.scale, "scale", 1.0), (&conditions.workpiece, "workpiece", -1.0)];
        for (body, what, sign) in bodies {
            let Some(ExpandingBody { sensor, ppm_per_k }) = body else { continue };
            let expected = "the sensor that the conditions name";
            let error = || no_temperature(self.record, sensor, what, expected);
            let degc = self.record.temperature(sensor).ok_or_else(error)?;
            for ((e, p), t) in self.error.iter_mut().zip(self.position).zip(degc) {
                *e -= sign * ppm_per_k * (t - REFERENCE_DEGC) * p / 1000.0;
            }
            words.push(format!("{what} {sensor} at {:.2} °C with {ppm_per_k} ppm/K", mean(degc)));
        }
        if !words.is_empty() {
            self.notes.push(format!("reduced to 20 °C: {}", words.join(", ")));
        }
        Ok(())
    }

    /// The targets with these errors.
    fn list_of(&self, error: &[f64]) -> Vec<TargetResult> {
        let of = |MeasuredPosition { position_mm, up, down }: MeasuredPosition| {
            let (mean_up, mean_down) = (mean_of(&up), mean_of(&down));
            let [s_up, s_down] = [&up, &down].map(|v| mean_and_s(v).map(|m| m.1));
            let reversal = mean_up.zip(mean_down).map(|(u, d)| u - d);
            let repeatability = repeatability(reversal, [s_up, s_down]);
            let approaches = [up.len(), down.len()];
            TargetResult {
                position_mm,
                mean_up,
                mean_down,
                s_up,
                s_down,
                reversal,
                repeatability,
                approaches,
            }
        };
        places(self.position, Some(self.direction), error).into_iter().map(of).collect()
    }

    fn evaluate(mut self, options: &PositioningOptions) -> Result<PositioningResult> {
        let list = self.list_of(&self.error);
        let role = &self.column.role;
        let bidirectional = list.iter().any(|t| t.reversal.is_some());
        if !bidirectional && !options.one_way {
            let seen = |m: fn(&TargetResult) -> Option<f64>| list.iter().any(|t| m(t).is_some());
            let how = match (seen(|t| t.mean_up), seen(|t| t.mean_down)) {
                (true, true) => "approached upwards or downwards, none both ways",
                (true, false) => "approached upwards only",
                _ => "approached downwards only",
            };
            let found = format!("targets of {} {how}: no A, E, R, B or M", self.axis);
            let expected = "approaches from both sides; --one-way gives the one-sided figures alone";
            return Err(lacks(self.record, &found, expected));
        }
        let span = list.last().zip(list.first()).map_or(0.0, |(b, a)| b.position_mm - a.position_mm);
        let repeated = list.iter().any(|t| t.s_up.is_some() || t.s_down.is_some());
        let long = span > LONG_AXIS_MM && !repeated;
        if !repeated && !long {
            let found = format!("no target of {} approached twice from one side", self.axis);
            return Err(lacks(self.record, &found, "at least two cycles, better the standard's five"));
        }
        self.warn(&list, span, long);
        // All figures use the same approaches; single approaches count on a long axis only.
        let listed = list;
        let list: Vec<TargetResult> = listed.iter().map(|t| t.counted(long)).collect();
        let ups: Vec<(f64, f64)> = list.iter().filter_map(|t| t.mean_up.zip(t.s_up)).collect();
        let downs: Vec<(f64, f64)> = list.iter().filter_map(|t| t.mean_down.zip(t.s_down)).collect();
        let accuracy = |v: &[(f64, f64)]| range(v.iter().map(|(m, s)| (m - 2.0 * s, m + 2.0 * s)));
        let mean_range = |m: fn(&TargetResult) -> Option<f64>| spread(list.iter().filter_map(m));
        let both: Vec<(f64, f64)> = ups.iter().chain(&downs).copied().collect();
        let means = list.iter().flat_map(|t| [t.mean_up, t.mean_down]).flatten();
        let reversals: Vec<f64> = list.iter().filter_map(|t| t.reversal).collect();
        let only = |v: Option<f64>| v.filter(|_| bidirectional);
        let centres = list.iter().filter_map(|t| Some(f64::midpoint(t.mean_up?, t.mean_down?)));
        let tilt = matches!(role, Role::AngleError(..));
        let approaches = list.iter().flat_map(|t| t.approaches).filter(|n| *n > 0).min().unwrap_or(1);
        let uncertainty = options.conditions.uncertainty(span, approaches).filter(|_| !tilt);
        if uncertainty.is_none() && !tilt {
            self.notes.push("no uncertainty: --conditions with a table [uncertainty] states it".to_owned());
        }
        let unit = if tilt { "µrad" } else { "µm" };
        let repeatability = largest(list.iter().filter_map(|t| t.repeatability));
        let reversal = [largest(reversals.iter().map(|b| b.abs())), mean_of(&reversals)];
        let resolution = self.resolution(unit);
        let [r_up, r_down] = [&ups, &downs].map(|side| largest(side.iter().map(|(_, s)| 4.0 * s)));
        let (drift, step) = match self.change([repeatability, r_up, r_down, reversal[0], reversal[1]], unit) {
            Some(DriftOrStep::Drift(drift)) => (Some(drift), None),
            Some(DriftOrStep::Step(step)) => (None, Some(step)),
            None => (None, None),
        };
        let mut found = PositioningResult {
            axis: self.axis.to_string(),
            response: role.to_string(),
            unit: if tilt { "urad" } else { "um" },
            A: only(accuracy(&both)),
            A_up: accuracy(&ups),
            A_down: accuracy(&downs),
            E: only(spread(means)),
            E_up: mean_range(|t| t.mean_up),
            E_down: mean_range(|t| t.mean_down),
            R: repeatability,
            R_up: r_up,
            R_down: r_down,
            B: reversal[0],
            B_mean: reversal[1],
            M: only(spread(centres)),
            arcsec: None,
            uncertainty,
            resolution,
            drift,
            step,
            travel_mm: span,
            test: if long { "long axis, one approach from each side" } else { "standard test cycle" },
            targets: listed,
            warnings: self.notes,
        };
        if tilt {
            let in_arcsec = |(k, v): (&str, Option<f64>)| (k.to_owned(), v.map(|v| v / URAD_PER_ARCSEC));
            found.arcsec = Some(found.figures().map(in_arcsec).into());
        }
        Ok(found)
    }

    /// Rounding error of the means in a coarse gauge; adds a warning.
    fn resolution(&mut self, unit: &str) -> Option<GaugeResolution> {
        let column = Column { data: self.error.clone(), ..self.column.clone() };
        let steps =
            ReadingResolution::of_response(self.record, &column).filter(ReadingResolution::is_coarse)?;
        let (step, mean_within) = (steps.step, steps.half_width());
        let reversal_within = 2.0 * mean_within;
        let [q, mean, reversal] = [step, mean_within, reversal_within].map(short);
        self.notes.push(format!(
            "readings in steps of {q} {unit}, most repeats alike: each mean may be off by up to {mean} {unit}, a reversal by up to {reversal} {unit}; \
             scatter below a step does not show in R. A finer gauge shows both"
        ));
        Some(GaugeResolution { step, mean_within, reversal_within })
    }

    /// Largest scatter of the positions of one target, mm.
    fn scatter_mm(&self) -> f64 {
        let of = |rows: &Vec<usize>| spread(rows.iter().map(|r| self.position[*r]));
        largest(targets(self.position).iter().filter_map(of)).unwrap_or(0.0)
    }

    /// Warns of requirements of the standard that this test does not meet.
    fn warn(&mut self, list: &[TargetResult], span: f64, long: bool) {
        let (n, scatter_mm) = (list.len(), self.scatter_mm());
        let mut note = |is_so: bool, text: String| self.notes.extend(Some(text).filter(|_| is_so));
        let count = |of: &dyn Fn([usize; 2]) -> bool| list.iter().filter(|t| of(t.approaches)).count();
        let interval = span / (n.max(2) - 1) as f64;
        let asked =
            format!("ISO 230-2 asks for at most {LONG_INTERVAL_MM:.0} mm on an axis of more than 2 m");
        let is_wide = span > LONG_AXIS_MM && interval > LONG_INTERVAL_MM;
        note(is_wide, format!("targets {interval:.0} mm apart: {asked}"));
        let only = "E, B and M only, no A and R (ISO 230-2, 5.3.3)";
        note(long, format!("more than 2 m with one approach from each side: {only}"));
        let wanted = fewest_targets(span);
        let text = format!("{n} targets on {span:.0} mm: ISO 230-2 asks for at least {wanted}");
        note(!long && n < wanted, text);
        let few = count(&|sides| sides.iter().any(|n| *n > 0 && *n < FEWEST));
        let text = format!("{few} targets with fewer than the five approaches ISO 230-2 asks for");
        note(!long && few > 0, text);
        let steps: Vec<f64> = list.windows(2).map(|w| w[1].position_mm - w[0].position_mm).collect();
        let is_even = n > 2 && spread(&steps).is_some_and(|all| all < 1e-3 * span / n as f64);
        let what = "an error of that period does not show";
        note(is_even, format!("targets at equal distances of {interval:.4} mm: {what}"));
        let alone = count(&|sides| sides.contains(&1));
        let why = "those approaches are in no figure, as they have no s";
        note(!long && alone > 0, format!("{alone} targets approached once only from a side: {why}"));
        let why = "read instead of commanded? The figures are of their means";
        let text = format!("the positions of one target differ by up to {scatter_mm:.3} mm: {why}");
        note(scatter_mm > 2.0 * ALIKE * span, text);
        let odd = count(&|[up, down]| (up == 0) != (down == 0));
        let what = "approached from one side only (the ends of the travel?)";
        note(odd > 0 && odd < n, format!("{odd} targets {what}: not in B, R and M"));
    }
}

impl TargetResult {
    /// The target with those sides only that the figures use.
    /// A side needs two approaches, except on a long axis.
    fn counted(&self, long: bool) -> Self {
        let mut own = self.clone();
        if !long {
            own.mean_up = own.mean_up.filter(|_| own.s_up.is_some());
            own.mean_down = own.mean_down.filter(|_| own.s_down.is_some());
            own.reversal = own.mean_up.zip(own.mean_down).map(|(u, d)| u - d);
        }
        own
    }
}

/// Bidirectional repeatability of a target, from its reversal and both s.
fn repeatability(reversal: Option<f64>, [up, down]: [Option<f64>; 2]) -> Option<f64> {
    let (b, up, down) = (reversal?, up?, down?);
    Some((2.0 * up + 2.0 * down + b.abs()).max(4.0 * up).max(4.0 * down))
}

/// Fewest targets on this travel of up to 2 m.
pub(crate) fn fewest_targets(span_mm: f64) -> usize {
    FEWEST.max((span_mm / 1000.0 * FEWEST as f64).ceil() as usize)
}

impl PositioningResult {
    /// `drift` or `step`, if the approaches show one beyond repeatability.
    pub fn changes_by(&self) -> Option<&'static str> {
        self.drift.map(|_| "drift").or(self.step.map(|_| "step"))
    }

    /// A figure without the drift or step; `None` for figures not in `UNCHANGED`.
    pub fn without_change(&self, symbol: &str) -> Option<f64> {
        let place = UNCHANGED.iter().position(|s| *s == symbol)?;
        self.drift.map(|d| d.without).or(self.step.map(|s| s.without))?[place]
    }

    /// Position of each target, mm, and mean of its directions.
    pub(crate) fn means(&self) -> impl Iterator<Item = (f64, f64)> {
        let of = |t: &TargetResult| {
            let known: Vec<f64> = [t.mean_up, t.mean_down].into_iter().flatten().collect();
            (!known.is_empty()).then(|| (t.position_mm, mean(&known)))
        };
        self.targets.iter().filter_map(of)
    }

    /// The figures in the order of the standard.
    pub fn figures(&self) -> [(&'static str, Option<f64>); 12] {
        [
            ("A", self.A),
            ("A_up", self.A_up),
            ("A_down", self.A_down),
            ("E", self.E),
            ("E_up", self.E_up),
            ("E_down", self.E_down),
            ("M", self.M),
            ("R", self.R),
            ("R_up", self.R_up),
            ("R_down", self.R_down),
            ("B", self.B),
            ("B_mean", self.B_mean),
        ]
    }

    /// The standard's diagram: mean deviations with ±2s, one colour per direction.
    pub fn chart(&self) -> Chart {
        type TargetFigure = fn(&TargetResult) -> Option<f64>;
        let (unit, what) = if self.unit == "urad" { ("µrad", "tilt") } else { ("µm", "deviation") };
        let title = match self.response.strip_prefix("angle_error.") {
            Some(axes) => format!("Tilt {axes} (as ISO 230-2)"),
            None => format!("Positioning of axis {} (ISO 230-2)", self.axis),
        };
        let mut chart =
            Chart::new(&title, &format!("position {} (mm)", self.axis), &format!("{what} ({unit})"));
        let over_travel = |of: &dyn Fn(&TargetResult) -> Option<f64>| -> Vec<(f64, f64)> {
            self.targets.iter().filter_map(|t| Some((t.position_mm, of(t)?))).collect()
        };
        let sides: [(&str, Colour, [TargetFigure; 2]); 2] = [
            ("up ↑", Colour::Up, [|t| t.mean_up, |t| t.s_up]),
            ("down ↓", Colour::Down, [|t| t.mean_down, |t| t.s_down]),
        ];
        for (label, colour, [mean, s]) in sides {
            let band = [-2.0, 2.0].map(|k| over_travel(&|t| Some(mean(t)? + k * s(t)?))).concat();
            if !band.is_empty() {
                chart = chart.with(Series::new(&format!("{label} ± 2s"), Style::Band, band).coloured(colour));
            }
            chart = chart.with_side(&format!("{label} mean"), over_travel(&mean), colour);
        }
        chart
    }
}
