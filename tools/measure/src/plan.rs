//! The test sequence that characterises a machine, after WO 97/43703.
//! What to mount, how to move and what to record ("Geometric characterization … three phases", spindle cycles
//! dry and wet).

use crate::Sink;
use crate::iso230::{LONG_AXIS_MM, LONG_INTERVAL_MM, fewest_targets};
use rtec_files::{InputError, InputNotice, Result};
use rtec_model::record::{Axis, LINEAR};
use serde::Serialize;
use std::path::Path;

/// A linear axis to be characterised.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanAxis {
    /// The axis's name, as records have it.
    pub name: String,
    /// Travel from its lowest to its highest position, mm.
    pub travel_mm: f64,
}

/// One run of the sequence.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannedRun {
    /// Number in the sequence, from 1.
    pub number: usize,
    /// Name of the record to take.
    pub record: String,
    /// Kind of the record.
    pub kind: &'static str,
    /// Required state of the machine.
    pub state: &'static str,
    /// What to mount, and where.
    pub mount: String,
    /// How to move and what to read.
    pub run: String,
    /// The columns to record.
    pub columns: Vec<String>,
    /// How the record is evaluated.
    pub evaluate: String,
    /// Approximate duration, min.
    pub minutes: f64,
}

/// Contouring feeds of the patent's table 1, mm/min (10, 50 and 100 in/min).
pub const FEEDS_MM_PER_MIN: [f64; 3] = [254.0, 1270.0, 2540.0];

const TEMPERATURES: &str = "every temperature sensor";

/// Usual ballbar lengths, longest first, mm.
const BARS_MM: [f64; 3] = [150.0, 100.0, 50.0];

/// Checks the description of a machine.
///
/// # Errors
/// No axis, a repeated or invalid name, a travel, speed or bar that is not a number above zero, a circle
/// larger than an axis.
pub fn check(axes: &[PlanAxis], max_rpm: f64, ballbar_mm: Option<f64>) -> Result<()> {
    const FORM: &str = "AXIS=TRAVEL in mm, as x=500";
    let usage =
        |found: String, expected: &str| InputError::whole(Path::new("characterise plan"), found, expected);
    if axes.is_empty() {
        return Err(usage("no axis".to_owned(), FORM));
    }
    for (i, PlanAxis { name, travel_mm }) in axes.iter().enumerate() {
        let given = format!("--axes {name}={travel_mm}");
        let Some(axis) = Axis::new(name).filter(|_| travel_mm.is_finite() && *travel_mm > 0.0) else {
            return Err(usage(given, FORM));
        };
        if axis.is_rotary() {
            return Err(usage(given + ": a rotary axis", LINEAR));
        }
        if axes[..i].iter().any(|a| a.name == *name) {
            return Err(usage(format!("{given}: {name} a second time"), "each axis once"));
        }
    }
    let given = [("--max-rpm", Some(max_rpm)), ("--ballbar-mm", ballbar_mm)];
    for (name, v) in given.into_iter().filter_map(|(name, v)| Some((name, v?))) {
        if !(v.is_finite() && v > 0.0) {
            return Err(usage(format!("{name} {v}"), "a number above zero"));
        }
    }
    let shortest = shortest_mm(axes);
    if let Some(radius) = ballbar_mm.filter(|r| axes.len() > 1 && 2.0 * r > shortest) {
        let across = 2.0 * radius;
        let found = format!("--ballbar-mm {radius}: a circle {across} mm across on an axis of {shortest} mm");
        return Err(usage(found, "a bar whose circle fits every axis"));
    }
    Ok(())
}

fn shortest_mm(axes: &[PlanAxis]) -> f64 {
    axes.iter().map(|a| a.travel_mm).fold(f64::INFINITY, f64::min)
}

/// The test [`sequence`] for a described machine; messages go to `say`.
/// Without a bar, it uses the longest usual one whose circle fits every axis.
///
/// # Errors
/// As [`check`].
pub fn for_machine(
    axes: &[PlanAxis],
    max_rpm: f64,
    ballbar_mm: Option<f64>,
    say: Sink<'_>,
) -> Result<Vec<PlannedRun>> {
    check(axes, max_rpm, ballbar_mm)?;
    let shortest = shortest_mm(axes);
    let bar_mm = ballbar_mm.or_else(|| BARS_MM.into_iter().find(|r| 2.0 * r <= shortest));
    if bar_mm.is_none() && axes.len() > 1 {
        say(InputNotice::Note(format!(
            "no circles: none of the bars of 150, 100 and 50 mm fits an axis of {shortest} mm; --ballbar-mm names another"
        )));
    }
    Ok(sequence(axes, max_rpm, bar_mm))
}

/// The sequence for these axes and this highest spindle speed.
/// Warm runs come last. *Cold* means a machine that has been off over night. Without a bar there are no
/// circles.
pub fn sequence(axes: &[PlanAxis], max_rpm: f64, ball_radius_mm: Option<f64>) -> Vec<PlannedRun> {
    let mut steps = ball_radius_mm.map_or_else(Vec::new, |radius_mm| contouring(axes, radius_mm));
    steps.extend(axes.iter().flat_map(displacement));
    steps.extend(axes.iter().flat_map(|a| axes.iter().filter(|b| b.name != a.name).map(|b| straight(a, b))));
    let errors: Vec<String> = axes.iter().map(|a| format!("error.{}", a.name)).collect();
    steps.push(PlannedRun {
        number: 0,
        record: "tool_change".to_owned(),
        kind: "drift",
        state: "cold, spindle at rest",
        mount: "precision ball in the tool holder, displacement gauges on the table along every axis".to_owned(),
        run: "ten times: read, retract, put the tool into the magazine, move all axes over their travel, fetch it, \
              return, read"
            .to_owned(),
        columns: [words(&["time", "cycle"]), errors.clone()].concat(),
        evaluate: "--standard repeatability: standard deviation and range per axis".to_owned(),
        minutes: 30.0,
    });
    steps.extend(spindle(axes, &errors, max_rpm));
    for (i, s) in steps.iter_mut().enumerate() {
        s.number = i + 1;
    }
    steps
}

fn words(of: &[&str]) -> Vec<String> {
    of.iter().map(|w| (*w).to_owned()).collect()
}

/// Circles in every plane, at three feeds, both directions (the patent's table 1).
fn contouring(axes: &[PlanAxis], radius_mm: f64) -> Vec<PlannedRun> {
    let evaluate =
        "ballbar, all records of the plane together: circularity, reversal, squareness, servo mismatch";
    let circle = |a: &str, b: &str, feed: f64, turn: &str| PlannedRun {
        number: 0,
        record: format!("ballbar_{a}{b}_{feed:.0}_{turn}"),
        kind: "ballbar",
        state: "cold, spindle at rest",
        mount: format!(
            "ballbar of {radius_mm} mm between spindle and table in plane {a}-{b}; the record states radius_mm = {radius_mm:?} and \
             plane = [\"{a}\", \"{b}\"]"
        ),
        run: format!("full circle {turn} at {feed:.0} mm/min, half a turn of run-in before and after"),
        columns: words(&["time", "angle", "error.r", TEMPERATURES]),
        evaluate: evaluate.to_owned(),
        minutes: 2.0 * std::f64::consts::TAU * radius_mm / feed + 2.0,
    };
    let mut steps = Vec::new();
    for (i, a) in axes.iter().enumerate() {
        for b in &axes[i + 1..] {
            for feed in FEEDS_MM_PER_MIN {
                steps.extend(["ccw", "cw"].map(|turn| circle(&a.name, &b.name, feed, turn)));
            }
        }
    }
    steps
}

/// This number of targets over a length, mm, to the micrometre.
/// All distances differ (ISO 230-2:2014, 5.3.1). Multiples of an irrational number by squares place the
/// targets within their intervals (Weyl 1916). Multiples by whole numbers would give three
/// distances, and a period that fits all three. Eleven targets resolve periods from about 0.5 mm.
fn targets(from_mm: f64, length_mm: f64, count: usize) -> Vec<f64> {
    let step = length_mm / (count - 1) as f64;
    let off = |k: usize| {
        let inner = f64::from(!k.is_multiple_of(count - 1));
        UNEVEN * step * (2.0 * ((k * k) as f64 * std::f64::consts::PI).fract() - 1.0) * inner
    };
    (0..count).map(|k| (1e3 * (from_mm + k as f64 * step + off(k))).round() / 1e3).collect()
}

/// A run over unevenly spaced targets, in both directions.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetRun {
    /// Targets from the lower end, mm.
    pub targets_mm: Vec<f64>,
    /// Approaches to each target from each side.
    pub cycles: usize,
    /// How much warmer the machine is in the second half of the cycles, K.
    pub warmer_k: Option<f64>,
}

/// Time of one reading, min: movement, dwell and reading.
const MINUTES_EACH: f64 = 0.36;
/// Time to warm a machine by some kelvin, min.
const WARMING_MIN: f64 = 60.0;
/// Largest shift of a target from even spacing, as a share of the spacing.
/// Neighbours are then at least a fifth of the spacing apart.
const UNEVEN: f64 = 0.4;

impl TargetRun {
    /// A run with this number of targets over an axis.
    pub fn uneven(axis: &PlanAxis, count: usize, cycles: usize, warmer_k: Option<f64>) -> Self {
        let margin_mm = margin_mm(axis);
        let targets_mm = targets(margin_mm, axis.travel_mm - 2.0 * margin_mm, count);
        Self { targets_mm, cycles, warmer_k }
    }

    /// All readings in order: cycle from 1, direction, target in mm, warm or not.
    pub fn readings(&self) -> impl Iterator<Item = (usize, f64, f64, bool)> {
        let cycles = self.cycles * if self.warmer_k.is_some() { 2 } else { 1 };
        (1..=cycles).flat_map(move |cycle| {
            let warm = cycle > self.cycles;
            let up = self.targets_mm.iter().map(move |t| (cycle, 1.0, *t, warm));
            up.chain(self.targets_mm.iter().rev().map(move |t| (cycle, -1.0, *t, warm)))
        })
    }

    /// Time between readings, s.
    pub fn seconds_each(&self) -> f64 {
        60.0 * MINUTES_EACH
    }

    /// Approximate duration, min.
    pub fn minutes(&self) -> f64 {
        let warming = self.warmer_k.map_or(0.0, |_| WARMING_MIN);
        MINUTES_EACH * self.readings().count() as f64 + warming
    }
}

/// The plan's step for such a run; the gauge reads the error of axis `response`.
pub fn target_run(record: &str, axis: &PlanAxis, response: &str, run: &TargetRun) -> PlannedRun {
    let n = &axis.name;
    let warm = run.warmer_k.map_or_else(String::new, |k| {
        format!("; then warm the machine by about {k:.0} K with strokes and spindle, and the same once more")
    });
    let across = || format!("straightness optics or a straightedge along {n}, read across it in {response}");
    PlannedRun {
        number: 0,
        record: record.to_owned(),
        kind: "positioning",
        state: "cold, spindle at rest",
        mount: if n == response { laser_along(n) } else { across() },
        run: format!(
            "targets {} mm from the lower end, up and down, {} cycles, the end targets from beyond them, 3 s at rest before each \
             reading{warm}; the record states turns = \"overtravel\"",
            listed(&run.targets_mm),
            run.cycles
        ),
        columns: columns_along(n, response),
        evaluate: "reconcile, together with the records of the verdict".to_owned(),
        minutes: run.minutes(),
    }
}

fn laser_along(axis: &str) -> String {
    let beside = "reflector in the spindle; a temperature sensor at scale or screw";
    format!("laser interferometer along {axis}, {beside}")
}

/// The columns of a run from target to target along an axis.
fn columns_along(axis: &str, response: &str) -> Vec<String> {
    let [position, direction] = ["position", "direction"].map(|role| format!("{role}.{axis}"));
    words(&["time", &position, &direction, "cycle", &format!("error.{response}"), TEMPERATURES])
}

/// Targets in mm, with blanks between them.
fn listed(targets_mm: &[f64]) -> String {
    targets_mm.iter().map(|t| format!("{t:.3}")).collect::<Vec<_>>().join(" ")
}

/// Travel beyond the first and the last target, needed for their approach, mm.
fn margin_mm(axis: &PlanAxis) -> f64 {
    (0.02 * axis.travel_mm).clamp(2.0, 25.0).min(axis.travel_mm / 10.0)
}

/// Bidirectional linear displacement of one axis (the patent's table 2, ISO 230-2).
/// An axis of more than 2 m has a run over its whole travel, once each way, and the standard's cycles on 2 m
/// of it.
fn displacement(axis: &PlanAxis) -> Vec<PlannedRun> {
    let travel_mm = axis.travel_mm;
    let margin_mm = margin_mm(axis);
    let length_mm = travel_mm - 2.0 * margin_mm;
    if length_mm <= LONG_AXIS_MM {
        let count = fewest_targets(length_mm).max(11);
        return vec![line(axis, "", &targets(margin_mm, length_mm, count), 5)];
    }
    let count = (length_mm / LONG_INTERVAL_MM).ceil() as usize + 1;
    let middle_mm = (travel_mm - LONG_AXIS_MM) / 2.0;
    let whole = line(axis, "", &targets(margin_mm, length_mm, count), 1);
    vec![whole, line(axis, "_2m", &targets(middle_mm, LONG_AXIS_MM, 11), 5)]
}

fn line(axis: &PlanAxis, of: &str, targets_mm: &[f64], cycles: usize) -> PlannedRun {
    let n = &axis.name;
    let (how_often, evaluate) = if cycles == 1 {
        ("once each way", "iso230-2: E, B, M of a long axis; scale, reversal, position map")
    } else {
        ("five cycles", "iso230-2: A, E, R, B, M; scale, reversal, position map, screw period")
    };
    PlannedRun {
        number: 0,
        record: format!("linear_{n}{of}"),
        kind: "positioning",
        state: "cold, spindle at rest",
        mount: laser_along(n),
        run: format!(
            "targets {} mm from the lower end, up and down, {how_often}, each approached from beyond the one before, 3 s at \
             rest before each reading",
            listed(targets_mm)
        ),
        columns: columns_along(n, n),
        evaluate: evaluate.to_owned(),
        minutes: MINUTES_EACH * (targets_mm.len() * 2 * cycles) as f64,
    }
}

/// Straightness of one axis's motion in the direction of another (ISO 230-1).
fn straight(axis: &PlanAxis, across: &PlanAxis) -> PlannedRun {
    let (n, b) = (&axis.name, &across.name);
    let margin_mm = margin_mm(axis);
    let length_mm = axis.travel_mm - 2.0 * margin_mm;
    let places = targets(margin_mm, length_mm, fewest_targets(length_mm).max(11));
    PlannedRun {
        number: 0,
        // Named as the effect `straightness.B.A`: the error of B while A moves.
        record: format!("straightness_{b}_{n}"),
        kind: "positioning",
        state: "cold, spindle at rest",
        mount: format!(
            "straightedge along {n}, or straightness optics, a gauge across it reading in {b}; the other axes stand"
        ),
        run: format!(
            "{} mm from the lower end, up and down, three cycles, 3 s at rest before each reading; where the straightedge's \
             form is not known, once more with it turned over",
            listed(&places)
        ),
        columns: columns_along(n, b),
        evaluate: format!(
            "straightness about the least-squares line (the effect straightness.{b}.{n} is E{0}{1} of ISO 230-1: error of {0} while {1} \
             moves); squareness where the straightedge was squared",
            b.to_uppercase(),
            n.to_uppercase()
        ),
        minutes: MINUTES_EACH * (places.len() * 2 * 3) as f64,
    }
}

/// Spindle cycles cold-dry, cold-wet, warm, production, and cooling down.
fn spindle(axes: &[PlanAxis], errors: &[String], max_rpm: f64) -> Vec<PlannedRun> {
    let [full, slowest, slow, middle] = [1.0, 0.2, 0.3, 0.6].map(|share| share * (0.9 * max_rpm));
    let cycle = |wet: &str| {
        format!(
            "{full:.0} rpm for 3 h, {wet}, gauges read every minute; then 15 min at each of {slow:.0}, {middle:.0} and \
             {full:.0} rpm with 5 min at rest between"
        )
    };
    let cooling = || "spindle and coolant off, gauges read for 3 h".to_owned();
    let warm =
        format!("speeds in random order between {slowest:.0} and {full:.0} rpm, 10 min each, coolant on");
    let production = "a production program without work piece, coolant as programmed, two cycles".to_owned();
    let runs = [
        ("spindle_cold_dry", "cold (over night)", cycle("no coolant"), 245.0),
        ("cool_down_dry", "as the run before left it", cooling(), 180.0),
        ("spindle_cold_wet", "cold (over night)", cycle("coolant on, aimed as in production"), 245.0),
        ("spindle_warm", "warm, straight after the run before", warm, 120.0),
        ("production_cycle", "warm", production, 90.0),
        ("cool_down", "as the run before left it", cooling(), 180.0),
    ];
    // The two gauges of X show the tilt of the spindle about B, those of Y the tilt about A.
    let tilts = [("x", "angle_error.s.b"), ("y", "angle_error.s.a")].into_iter();
    let tilts = tilts.filter(|(axis, _)| axes.iter().any(|a| a.name == *axis)).map(|t| t.1.to_owned());
    let causes = words(&["time", "spindle_speed", "coolant"]);
    let columns = [causes, errors.to_vec(), tilts.collect(), words(&[TEMPERATURES])].concat();
    let mount = "mandrel in the spindle, five gauges on the table: two radial pairs 100 mm apart and one axial; errors are \
                 those of the gauges at the nose; angle_error.s.b is the X gauge at the higher Z minus that at the lower, \
                 angle_error.s.a the Y gauge at the lower Z minus that at the higher: 10 µrad for each µm over 100 mm";
    let step = |(record, state, run, minutes): (&str, &'static str, String, f64)| PlannedRun {
        number: 0,
        record: record.to_owned(),
        kind: "drift",
        state,
        mount: mount.to_owned(),
        run,
        columns: columns.clone(),
        evaluate: "iso230-3; model fit, one run held out".to_owned(),
        minutes,
    };
    runs.into_iter().map(step).collect()
}

/// The sequence as Markdown.
pub fn markdown(machine: &str, steps: &[PlannedRun]) -> String {
    use std::fmt::Write as _;
    let hours = steps.iter().map(|s| s.minutes).sum::<f64>() / 60.0;
    let runs = steps.len();
    let mut out =
        format!("# Characterisation of {machine}\n\n{runs} runs, about {hours:.1} h of machine time.\n");
    for PlannedRun { number, record, kind, state, mount, run, columns, evaluate, minutes } in steps {
        let columns = columns.join(", ");
        let _ = write!(
            out,
            "\n## {number}. {record}\n\n| | |\n|---|---|\n| state | {state} |\n| mount | {mount} |\n| run | {run} |\n\
             | record | kind `{kind}`: {columns} |\n| evaluate | {evaluate} |\n| takes | {minutes:.0} min |\n"
        );
    }
    out
}
