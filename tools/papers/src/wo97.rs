//! WO 97/43703: global differential wet modelling.

use crate::PaperError;
use crate::rows::{Is, Rows, shown};
use rtec_fit::thermal::{self, Options, ROUNDS};
use rtec_model::effect::Need;
use rtec_model::machine::{Machine, Provenance};
use rtec_model::record::{Record, Role};
use rtec_sim::described::Described;
use rtec_sim::experiment::{Experiment, Findings, Gauged, Setting};
use rtec_sim::heat::{FIGURE_9, SENSORS};
use serde::Deserialize;
use std::path::Path;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Centre {
    machine: String,
    redundant: f64,
    equation: Vec<Equation>,
}

/// One of equations 2 to 4.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Equation {
    axis: String,
    constant_mm: f64,
    terms: Vec<Term>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case, reason = "the unit is kelvin")]
struct Term {
    sensor: String,
    minus: String,
    mm_per_K: f64,
    mm_per_K2: f64,
}

impl Equation {
    fn mm(&self, degc: impl Fn(&str) -> f64) -> f64 {
        let of = |t: &Term| {
            let k = degc(&t.sensor) - degc(&t.minus);
            t.mm_per_K * k + t.mm_per_K2 * k * k
        };
        self.constant_mm + self.terms.iter().map(of).sum::<f64>()
    }
}

/// µm in an inch.
const INCH_UM: f64 = 25_400.0;
const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Rows of tables 4 and 5: what, and from which minute to which.
const PHASES: [(&str, usize, usize); 8] = [
    ("5500 rpm, 3 h", 0, 180),
    ("1 h cooling", 180, 240),
    ("3000 rpm, 1 h", 240, 300),
    ("1 h cooling again", 300, 360),
    ("1500 rpm, 15 min", 360, 375),
    ("3000 rpm, 15 min", 380, 395),
    ("5500 rpm, 15 min", 400, 415),
    ("3000 rpm, 15 min, the last", 420, 435),
];
/// Tables 4 and 5: drift in X, Y, Z, inches, and tilt in X and Y, arcseconds, of each phase.
const TABLE_4: [[f64; 5]; 8] = [
    [0.0027, 0.0017, -0.0048, 11.6, -21.3],
    [0.0003, -0.0002, 0.0006, 3.1, 1.1],
    [0.0002, -0.0001, -0.0007, -1.0, -3.5],
    [0.0002, -0.0001, 0.0001, 1.7, 1.1],
    [0.0001, -0.0003, 0.0003, -3.4, 4.5],
    [0.0001, 0.0, 0.0001, 4.5, -3.5],
    [-0.0002, 0.0002, -0.0006, 2.3, -4.6],
    [0.0, 0.0001, 0.0002, 1.1, -6.9],
];
const TABLE_5: [[f64; 5]; 8] = [
    [-0.0029, 0.0041, -0.0036, 6.1, -12.1],
    [0.0005, -0.0015, -0.001, 3.5, -7.6],
    [-0.0004, 0.001, 0.001, -8.4, 4.2],
    [0.0001, -0.0012, -0.001, 3.3, -3.1],
    [0.0001, 0.0001, 0.0001, -9.5, 4.2],
    [0.0001, 0.0005, -0.0004, -8.4, 2.9],
    [0.0, 0.0005, -0.0005, -5.3, 2.1],
    [-0.0001, 0.0004, 0.0008, -5.2, -2.5],
];

struct Run<'a> {
    truth: &'a Machine,
    seed: u64,
}

impl Run<'_> {
    fn experiment(&self, name: &str, known: &Machine) -> Result<Findings, PaperError> {
        let setting = Setting { truth: self.truth, known, seed: self.seed, out: Path::new("") };
        let experiment =
            Experiment::find(name).ok_or_else(|| PaperError::Cannot(format!("no experiment {name}")))?;
        Ok(experiment.run(&setting)?)
    }
}

pub(crate) fn run(
    described: &Described,
    seed: u64,
    progress: &mut dyn FnMut(&str),
) -> Result<Rows, PaperError> {
    let centre: Centre = described.read("wo97.toml")?;
    let truth = described.machine(&centre.machine)?;
    let run = Run { truth: &truth, seed };
    let ideal = Machine::ideal("nothing known");
    let mut rows = Rows::default();
    progress("WO 97/43703: circles in three planes");
    circles(&mut rows, &run.experiment("ballbar", &ideal)?);
    progress("WO 97/43703: linear displacement, tool changes");
    let linear = displacement(&mut rows, &run.experiment("linear-displacement", &ideal)?);
    let positioning = tool_changes(&mut rows, &run.experiment("tool-change-repeatability", &ideal)?);
    progress("WO 97/43703: the spindle cycle, dry and wet");
    let drift = run.experiment("drift", &ideal)?;
    let thermal = drifts(&mut rows, &drift);
    table_6(&mut rows, linear, positioning, thermal);
    dry_against_wet(&mut rows, &drift);
    equations(&mut rows, &centre, &drift);
    progress("WO 97/43703: sensors chosen, the wet model fitted");
    let model = wet_model(&mut rows, &centre, &run, &drift)?;
    progress("WO 97/43703: drilling, tests 1 to 3");
    drilling(&mut rows, &run, &model, (linear, positioning, thermal))?;
    for (place, what) in [
        ("Figure 1", "flow of modelling and compensation"),
        ("Figures 2, 3, 5, 7, 8, 16", "set-ups and places of sensors"),
        ("Figure 20", "block diagram of the controller"),
    ] {
        rows.not((place, what, ""), "diagram", "", "no figures in it");
    }
    Ok(rows)
}

fn column<'r>(record: &'r Record, role: &Role) -> &'r [f64] {
    record.data(role).unwrap_or_default()
}

fn error_of(record: &Record, axis: usize) -> Vec<f64> {
    let wanted = ["x", "y", "z"][axis];
    let of = |c: &&rtec_model::record::Column| matches!(&c.role, Role::Error(a) if a.as_str() == wanted);
    record.columns.iter().find(of).map_or_else(Vec::new, |c| c.data.clone())
}

fn record<'f>(findings: &'f Findings, name: &str) -> Result<&'f Record, PaperError> {
    let file = format!("{name}.run.toml");
    let found =
        findings.records.iter().find(|r| r.path.file_name().is_some_and(|n| n.to_string_lossy() == file));
    found.ok_or_else(|| PaperError::Cannot(format!("no record {name}")))
}

/// Table 1, inches ·10⁻⁴: plane, feed, total error clockwise and counter-clockwise, reversal error likewise.
type Circle = ((usize, usize), u32, [Option<f64>; 2], [Option<f64>; 2]);
const TABLE_1: [Circle; 9] = [
    ((0, 1), 10, [Some(9.0), Some(8.0)], [Some(3.0), Some(1.0)]),
    ((0, 1), 50, [Some(9.0), Some(12.0)], [Some(2.0), Some(2.0)]),
    ((0, 1), 100, [Some(11.0), Some(20.0)], [Some(2.0), Some(3.0)]),
    ((1, 2), 10, [Some(13.0), Some(11.0)], [Some(2.0), Some(1.0)]),
    ((1, 2), 50, [Some(15.0), Some(11.0)], [Some(8.0), Some(2.0)]),
    ((1, 2), 100, [Some(24.0), Some(18.0)], [Some(18.0), Some(3.0)]),
    ((2, 0), 10, [Some(6.0), Some(7.0)], [Some(2.0), None]),
    ((2, 0), 50, [None, Some(10.0)], [None, Some(2.0)]),
    ((2, 0), 100, [Some(17.0), Some(14.0)], [Some(9.0), Some(1.0)]),
];

/// Table 1: total error of each circle, largest minus smallest radial deviation about its own centre; and the largest step
/// of either axis where it turns.
fn circles(rows: &mut Rows, found: &Findings) {
    let names = ["x", "y", "z"];
    let each = || {
        TABLE_1.iter().flat_map(|circle| {
            let ((i, j), inches, ..) = *circle;
            let record = record(found, &format!("ballbar-{}{}-{inches}", names[i], names[j])).ok();
            // Clockwise is the second cycle of the experiment.
            record.into_iter().flat_map(move |r| [(circle, r, 0, "CW", 2.0), (circle, r, 1, "CCW", 1.0)])
        })
    };
    for (&((i, j), inches, totals, _), record, k, way, cycle) in each() {
        let angles = record.columns.iter().find(|c| c.role == Role::Angle).map_or(&[][..], |c| &c.data);
        let (a, b, n) = (error_of(record, i), error_of(record, j), column(record, &Role::Cycle));
        let radial: Vec<(f64, f64)> = (0..angles.len())
            .filter(|row| (n[*row] - cycle).abs() < 0.5)
            .map(|row| (angles[row], a[row] * angles[row].cos() + b[row] * angles[row].sin()))
            .collect();
        let inch = about_its_centre(&radial) / INCH_UM;
        let what = format!("{}{} {way}, {inches} in/min: total error", AXES[i], AXES[j]);
        let why = "squareness, scale, reversal and following errors of the machine file are fitted to this column by six numbers; its \
                   circles have no vibration, and their radius is ours (150 mm)";
        match totals[k] {
            Some(says) => rows.number(("Table 1", &what, "in"), says * 1e-4, inch, Is::Within(0.0006), why),
            None => rows.not(("Table 1", &what, "in"), "unreadable", &shown(inch), "lost in the scan"),
        }
    }
    for (&((i, j), inches, _, reversals), record, k, way, cycle) in each() {
        let inch = reversal(record, i, cycle).max(reversal(record, j, cycle)) / INCH_UM;
        let what = format!("{}{} {way}, {inches} in/min: largest reversal error", AXES[i], AXES[j]);
        let why = "the machine file's reversal is the same at every speed; on the real machine that of Z grew ninefold";
        match reversals[k] {
            Some(says) => rows.number(("Table 1", &what, "in"), says * 1e-4, inch, Is::Within(0.0004), why),
            None => rows.not(("Table 1", &what, "in"), "unreadable", &shown(inch), "lost in the scan"),
        }
    }
}

/// Largest minus smallest of radial deviations, their first harmonic (the circle's centre) taken out.
fn about_its_centre(radial: &[(f64, f64)]) -> f64 {
    let n = radial.len().max(1) as f64;
    let mean = radial.iter().map(|r| r.1).sum::<f64>() / n;
    let of = |f: fn(f64) -> f64| radial.iter().map(|(a, e)| 2.0 * (e - mean) * f(*a)).sum::<f64>() / n;
    let (c, s) = (of(f64::cos), of(f64::sin));
    let left = radial.iter().map(|(a, e)| e - mean - c * a.cos() - s * a.sin());
    let (lo, hi) = left.fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), e| (lo.min(e), hi.max(e)));
    (hi - lo).max(0.0)
}

/// The step of an axis' own error where it turns, µm: between the rows a few degrees before and after. The first and the last
/// degrees speed up and slow down.
fn reversal(record: &Record, axis: usize, cycle: f64) -> f64 {
    let (error, n) = (error_of(record, axis), column(record, &Role::Cycle));
    let wanted = ["x", "y", "z"][axis];
    let direction =
        record.columns.iter().find(|c| matches!(&c.role, Role::Direction(a) if a.as_str() == wanted));
    let Some(direction) = direction.map(|c| &c.data) else { return 0.0 };
    let own: Vec<usize> = (0..error.len()).filter(|k| (n[*k] - cycle).abs() < 0.5).collect();
    let steady = own.get(8..own.len().saturating_sub(8)).unwrap_or_default();
    let mean = |r: std::ops::Range<usize>| error[r.clone()].iter().sum::<f64>() / r.len() as f64;
    let turns = steady.iter().filter(|k| direction[**k] * direction[**k - 1] < 0.0);
    turns.map(|k| (mean(k + 1..k + 3) - mean(k - 3..k - 1)).abs()).fold(0.0, f64::max)
}

/// Table 2: the mean of both directions over the travel, and what sets the directions apart.
fn displacement(rows: &mut Rows, found: &Findings) -> [f64; 3] {
    let mut scales = [0.0; 3];
    for (p, (scale, reversal)) in
        [(0.0013, 0.0004), (0.0006, 0.0002), (0.0027, 0.0003)].into_iter().enumerate()
    {
        let Ok(record) = record(found, &format!("linear-displacement-{}", ["x", "y", "z"][p])) else {
            continue;
        };
        let wanted = ["x", "y", "z"][p];
        let of = |wants: fn(&Role) -> Option<&str>| {
            record.columns.iter().find(|c| wants(&c.role) == Some(wanted)).map_or(&[][..], |c| &c.data)
        };
        let place = of(|r| if let Role::Position(a) = r { Some(a.as_str()) } else { None });
        let direction = of(|r| if let Role::Direction(a) = r { Some(a.as_str()) } else { None });
        let error = error_of(record, p);
        // Targets in order: their mean by direction.
        let mut targets: Vec<f64> = place.iter().map(|v| v.round()).collect();
        targets.sort_by(f64::total_cmp);
        targets.dedup();
        let mean = |t: f64, up: bool| {
            let own: Vec<f64> = (0..error.len())
                .filter(|k| (place[*k].round() - t).abs() < 1.5 && (direction[*k] > 0.0) == up)
                .map(|k| error[k])
                .collect();
            own.iter().sum::<f64>() / own.len().max(1) as f64
        };
        let both: Vec<[f64; 2]> = targets.iter().map(|t| [mean(*t, true), mean(*t, false)]).collect();
        let first = both.first().map_or(0.0, |b| b[0]);
        let um = both.iter().flatten().map(|e| (e - first).abs()).fold(0.0, f64::max);
        let apart = both.iter().map(|[u, d]| (u - d).abs()).sum::<f64>() / both.len().max(1) as f64;
        scales[p] = um;
        rows.number(
            ("Table 2", &format!("{} axis: largest scale error", AXES[p]), "in"),
            scale,
            um / INCH_UM,
            Is::Within(0.0003),
            "over 95 % of the travel, from its first target; the error is put in as a straight line",
        );
        rows.number(
            ("Table 2", &format!("{} axis: reversal error", AXES[p]), "in"),
            reversal,
            apart / INCH_UM,
            Is::Within(0.0001),
            "the mean over the targets",
        );
    }
    rows.not(
        ("Figures 4a to 4c", "plots of the mean error over the travel", "in"),
        "plotted from -0.0012 to 0.0004, to 0.0006, -0.0025 to 0.0005",
        "",
        "curves without figures; their extremes are table 2's",
    );
    scales
}

/// Table 3: ten tool changes, inches ·10⁻⁴, X, Y and Z (below a ten-thousandth: 0.5).
const TABLE_3: [[f64; 3]; 10] = [
    [0.0, 0.0, 0.0],
    [-4.0, 1.0, 0.5],
    [-3.0, 2.0, 0.5],
    [-2.0, 2.0, 0.5],
    [-2.0, 3.0, 0.5],
    [-3.0, 2.0, 0.5],
    [-3.0, 3.0, 2.0],
    [-2.0, 3.0, 0.5],
    [-4.0, 3.0, 0.5],
    [-4.0, 4.0, 0.5],
];

fn tool_changes(rows: &mut Rows, found: &Findings) -> [f64; 3] {
    let mut largest = [0.0; 3];
    let Ok(record) = record(found, "tool-change-repeatability") else { return largest };
    for p in 0..3 {
        let error = error_of(record, p);
        let ours: Vec<f64> = error.iter().map(|e| (e - error[0]) / INCH_UM).collect();
        for (run, says) in TABLE_3.iter().enumerate() {
            let gets = ours.get(run).copied().unwrap_or(0.0);
            rows.number(
                ("Table 3 and figure 6", &format!("run {}, {} axis", run + 1, AXES[p]), "in"),
                says[p] * 1e-4,
                gets,
                Is::Within(0.0006),
                "how one holder seats once; here 1.2 µm of chance and the reversals of the way back, there a shift after the first \
                 change as well",
            );
        }
        largest[p] = ours.iter().map(|e| e.abs()).fold(0.0, f64::max) * INCH_UM;
    }
    largest
}

/// What the five gauges showed in a record.
fn gauges<'f>(found: &'f Findings, name: &str) -> &'f [Gauged] {
    found.gauges.iter().find(|g| g.0 == name).map_or(&[], |g| &g.1)
}

/// Tables 4 and 5 by phase, and how heating compares with cooling. Gives the drift of the wet three hours, µm.
fn drifts(rows: &mut Rows, found: &Findings) -> [[f64; 3]; 2] {
    let mut three_hours = [[0.0; 3]; 2];
    rows.number(
        ("Figure 9", "length of the cycle", "min"),
        435.0,
        FIGURE_9.iter().map(|c| c.1).sum(),
        Is::Within(0.0),
        "",
    );
    for (w, (name, table, place)) in
        [("drift-dry", TABLE_4, "Table 4 (dry)"), ("drift-wet", TABLE_5, "Table 5 (wet)")]
            .into_iter()
            .enumerate()
    {
        let seen = gauges(found, name);
        // A mean over three minutes: what a gauge shows at one instant has noise.
        let at = |minute: usize, f: &dyn Fn(&Gauged) -> f64| {
            let near = &seen[minute.saturating_sub(1)..(minute + 2).min(seen.len())];
            near.iter().map(f).sum::<f64>() / near.len().max(1) as f64
        };
        if seen.len() < 436 {
            continue;
        }
        for ((phase, from, to), says) in PHASES.iter().zip(table) {
            for p in 0..3 {
                let gauge = [1, 0, 2][p];
                let um = at(*to, &|g| g.um[gauge]) - at(*from, &|g| g.um[gauge]);
                if *from == 0 {
                    three_hours[w][p] = um;
                }
                rows.number(
                    (place, &format!("{phase}: drift in {}", AXES[p]), "in"),
                    says[p],
                    um / INCH_UM,
                    Is::Within(0.0008),
                    "growth of four terms per axis, on the sensors of a simulated thermal network, fitted to all sixteen phases at \
                     once: what such a model cannot follow stays",
                );
            }
            for p in 0..2 {
                let got = at(*to, &|g| g.tilt_arcsec[p]) - at(*from, &|g| g.tilt_arcsec[p]);
                rows.number(
                    (place, &format!("{phase}: tilt in {}", AXES[p]), "″"),
                    says[3 + p],
                    got,
                    Is::Within(8.0),
                    "four terms without lag in the chain; the table's short phases repeat to some seconds of arc only, and our \
                     gauges' 0.1 µm over 100 mm are 0.3″",
                );
            }
        }
        let back = |p: usize| {
            let gauge = [1, 0, 2][p];
            let grown = at(180, &|g| g.um[gauge]) - at(0, &|g| g.um[gauge]);
            let cooled = at(240, &|g| g.um[gauge]) - at(180, &|g| g.um[gauge]);
            -cooled / grown
        };
        let minutes = |share: f64| if share > 0.0 { -60.0 / (1.0 - share).ln() } else { f64::INFINITY };
        for p in 0..3 {
            let says = -table[1][p] / table[0][p];
            rows.number(
                (place, &format!("{} axis: share of the growth that an hour's rest takes back", AXES[p]), ""),
                says,
                back(p),
                Is::Within(0.2),
                "from the two phases above; below zero it goes on growing at rest",
            );
            rows.not(
                (place, &format!("{} axis: time constant of cooling by that share", AXES[p]), "min"),
                &if says > 0.0 { shown(minutes(says)) } else { "none: it goes on growing".to_owned() },
                &if back(p) > 0.0 { shown(minutes(back(p))) } else { "none: it goes on growing".to_owned() },
                "one exponential is no law of a machine of many masses: hours by either",
            );
            let gauge = [1, 0, 2][p];
            let whole = at(180, &|g| g.um[gauge]) - at(0, &|g| g.um[gauge]);
            let risen =
                (0..180).find(|m| (at(*m, &|g| g.um[gauge]) - at(0, &|g| g.um[gauge])) / whole >= 0.632);
            rows.not(
                (place, &format!("{} axis: time to 63 % of what three hours heat", AXES[p]), "min"),
                "-",
                &risen.map_or_else(|| "-".to_owned(), |m| shown(m as f64)),
                "the paper gives the end of the three hours only; heating is faster than cooling where fast masses are heated first",
            );
        }
    }
    three_hours
}

/// Table 6, and the uncertainties that its errors add up to.
fn table_6(rows: &mut Rows, scale: [f64; 3], positioning: [f64; 3], thermal: [[f64; 3]; 2]) {
    let place = "Table 6";
    let from = "the largest of the rows above";
    for (what, says, ours, tolerance) in [
        ("scale error", [0.0013, 0.0006, 0.0027], scale, 0.0003),
        ("positioning error", [0.0004, 0.0004, 0.0002], positioning, 0.0006),
        ("thermal, dry", [0.0027, 0.0017, 0.0048], thermal[0].map(f64::abs), 0.0008),
        ("thermal, wet", [0.0029, 0.0041, 0.0036], thermal[1].map(f64::abs), 0.0008),
    ] {
        for p in 0..3 {
            rows.number(
                (place, &format!("{what}, {} axis", AXES[p]), "in"),
                says[p],
                ours[p] / INCH_UM,
                Is::Within(tolerance),
                from,
            );
        }
    }
}

/// Figures 10, 11 and 13 to 15: housing and spindle, dry and wet.
fn dry_against_wet(rows: &mut Rows, found: &Findings) {
    let (Ok(dry), Ok(wet)) = (record(found, "drift-dry"), record(found, "drift-wet")) else { return };
    let degc = |r: &Record, sensor: &str, minute: usize| r.temperature(sensor).map_or(0.0, |t| t[minute]);
    let (front, middle, rear) = ("T8", "T7", "T9");
    for (place, r) in [("Figure 10", dry), ("Figure 11", wet)] {
        for (what, sensor) in [("front", front), ("middle", middle), ("rear", rear)] {
            let most = (0..=180).map(|m| degc(r, sensor, m)).fold(f64::MIN, f64::max);
            rows.number(
                (
                    place,
                    &format!(
                        "spindle housing {what}, hottest in three hours: within the figure's scale to 40 °C"
                    ),
                    "°C",
                ),
                40.0,
                most,
                Is::AtMost,
                "a curve without figures; its scale runs from 20 to 40 °C",
            );
        }
    }
    let gradient = |r: &Record| degc(r, rear, 180) - degc(r, front, 180);
    let (d, w) = (gradient(dry), gradient(wet));
    rows.holds(
        (
            "Figures 13 and 14; text after table 7",
            "gradient from front to rear of the housing: larger wet than dry",
        ),
        "larger wet",
        &format!("{} K dry, {} K wet after three hours", shown(d), shown(w)),
        w.abs() > d.abs(),
        "curves without figures",
    );
    for (what, sensor) in [("front", front), ("rear", rear)] {
        let (d, w) =
            (degc(dry, sensor, 180) - degc(dry, sensor, 0), degc(wet, sensor, 180) - degc(wet, sensor, 0));
        rows.not(
            (
                if what == "front" { "Figure 13" } else { "Figure 14" },
                &format!("rise of the housing's {what} in three hours, dry and wet"),
                "K",
            ),
            "curve",
            &format!("{} and {}", shown(d), shown(w)),
            "curves without figures",
        );
    }
    let growth = |r: &Record, p: usize| {
        let e = error_of(r, p);
        (e.get(140).copied().unwrap_or(0.0) - e.first().copied().unwrap_or(0.0)).abs()
    };
    for (p, says) in [(1, "more wet"), (2, "more wet")] {
        let (d, w) = (growth(dry, p), growth(wet, p));
        rows.holds(
            ("Figure 15; text after table 7", &format!("spindle growth in {} after 140 minutes", AXES[p])),
            says,
            &format!("{} µm dry, {} µm wet", shown(d), shown(w)),
            w > d,
            "the text says so of Y and Z; tables 4 and 5, which our machine follows, have Z grow less wet (0.0036 in) than dry (0.0048 in) \
             over three hours",
        );
    }
}

/// Equations 2 to 4 as printed, with all temperatures alike, and at those of the simulated machine.
fn equations(rows: &mut Rows, centre: &Centre, found: &Findings) {
    let says = [("x", 0.4179), ("y", 0.4017), ("z", 0.5248)];
    for (equation, (axis, constant)) in centre.equation.iter().zip(says) {
        let place = format!("Equation {}", 2 + says.iter().position(|s| s.0 == axis).unwrap_or(0));
        rows.number(
            (&place, &format!("E_{axis} with all temperatures alike: the gauge's own reading, mm"), "mm"),
            constant,
            equation.mm(|_| 20.0),
            Is::Within(1e-9),
            "the machine file has another constant",
        );
        let Ok(wet) = record(found, "drift-wet") else { continue };
        let at = |minute: usize| equation.mm(|s| wet.temperature(s).map_or(20.0, |t| t[minute]));
        let p = says.iter().position(|s| s.0 == equation.axis).unwrap_or(0);
        let growth_in = (at(180) - at(0)) * 1e3 / INCH_UM;
        let why = "the equations belong to the temperatures of that machine, which are not printed: places of the sensors are in figure 8 \
                   only. In equation 2 the printed 0.114 mm/K would be 114 µm/K, which no machine has: a tenth of it suits the other \
                   axes. So these are the published coefficients at our temperatures, in millimetres, in inches here";
        rows.number(
            (&place, &format!("E_{axis} grows in three wet hours at 5500 rpm (table 5)"), "in"),
            TABLE_5[0][p],
            growth_in,
            Is::Within(0.0008),
            why,
        );
    }
    rows.not(
        ("Figures 18a to 18c", "growth, measured and modelled, over 1200 min", "mm"),
        "Y plotted from 0.3 to 0.38",
        "",
        "curves without figures; they show that equations 2 to 4 are in millimetres and that their constants are the gauges' readings",
    );
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len()) as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(x, y)| f(x - ma, y - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// Figure 17 and the choice of sensors; the model that the wet characterisation gives, on top of the geometry.
fn wet_model(
    rows: &mut Rows,
    centre: &Centre,
    run: &Run<'_>,
    found: &Findings,
) -> Result<Machine, PaperError> {
    let wet = record(found, "drift-wet")?;
    let z = error_of(wet, 2);
    let heated = 0..=180_usize;
    let of = |sensor: &str| wet.temperature(sensor).map_or_else(Vec::new, |t| t[heated.clone()].to_vec());
    let z_heated = z[heated.clone()].to_vec();
    let t13 = of("T13");
    rows.number(
        ("Figure 17", "γ of sensor 13 (spindle nose) with the growth in Z", ""),
        0.97,
        correlation(&t13, &z_heated).abs(),
        Is::Within(0.1),
        "wet, over the three hours of heating; the paper does not say over which run",
    );
    let range =
        |t: &[f64]| t.iter().copied().fold(f64::MIN, f64::max) - t.iter().copied().fold(f64::MAX, f64::min);
    let dry = record(found, "drift-dry")?;
    let dry13 = dry.temperature("T13").map_or_else(Vec::new, |t| t[heated.clone()].to_vec());
    rows.number(
        ("Figure 17", "temperature change of sensor 13", "K"),
        16.0,
        range(&dry13),
        Is::Within(1.5),
        "dry; 16 °C in one place of the text, 15 °C in another",
    );
    rows.number(
        ("CASC", "autocorrelation α of sensors 13 and 10", ""),
        0.985,
        correlation(&t13, &of("T10")),
        Is::Within(0.02),
        "places of the sensors are those of the simulated network",
    );
    let mut ranked: Vec<(f64, &str)> =
        SENSORS.iter().map(|s| (correlation(&of(s.0), &z_heated).abs(), s.0)).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    rows.not(
        ("Figure 17", "highest γ with the growth in Z: sensor", ""),
        "13",
        &format!("{}", ranked.first().map_or("", |r| r.1)),
        "which sensor leads depends on where it sits",
    );
    let offered = wet.names(&Role::Temperature).count();
    rows.number(("CASC", "sensors to begin with", ""), 20.0, offered as f64, Is::Within(0.0), "");
    let options = Options { base: Some(geometry(run.truth)?), date: 20_000, lag: true, ..Options::default() };
    let (model, reports) = thermal::fit(&[wet], &[], &options)?;
    for report in &reports {
        let mut sensors: Vec<String> = Vec::new();
        for e in &report.effects {
            sensors.extend(e.sensor.iter().chain(&e.minus).cloned());
        }
        sensors.sort();
        sensors.dedup();
        let axis = report.response.trim_start_matches("error.").to_uppercase();
        rows.number(
            ("CASC", &format!("sensors in the end for {axis}: 4 or 5"), ""),
            5.0,
            sensors.len() as f64,
            Is::AtMost,
            "fewer where fewer do",
        );
        rows.number(
            ("CASC", &format!("rounds of the refit for {axis}: seldom more than five"), ""),
            5.0,
            report.rounds.len().min(ROUNDS) as f64,
            Is::AtMost,
            "fewer where R no longer improves by 1 %",
        );
        let dropped = report.dropped.iter().map(|d| d.alpha.abs()).fold(f64::INFINITY, f64::min);
        if dropped.is_finite() {
            rows.number(
                ("CASC", &format!("least α at which a sensor was left out for {axis}"), ""),
                centre.redundant,
                dropped,
                Is::AtLeast,
                "",
            );
        }
        rows.not(
            (
                "Figures 18 and 19",
                &format!("left of the growth in {axis} by the fitted model, RMS over blocks it had not seen"),
                "µm",
            ),
            "curve",
            &shown(report.rms_um.folds_mean),
            "curves without figures",
        );
    }
    for (axis, says) in [("X", "T8, T15, T18"), ("Y", "T6, T8, T18"), ("Z", "T7, T9, T11, T18, T20")] {
        let own = reports.iter().find(|r| r.response == format!("error.{}", axis.to_lowercase()));
        let mut ours: Vec<String> = own
            .map(|r| r.effects.iter().flat_map(|e| e.sensor.iter().chain(&e.minus).cloned()).collect())
            .unwrap_or_default();
        ours.sort();
        ours.dedup();
        rows.not(
            ("Text before equation 2", &format!("sensors selected for {axis}"), ""),
            says,
            &ours.join(", "),
            "which sensors are chosen depends on where they sit: figure 8 shows it, without a list",
        );
    }
    Ok(model)
}

/// What the geometric characterisation gives: everything of the true machine that is at rest and cold.
fn geometry(truth: &Machine) -> Result<Machine, PaperError> {
    let mut known = Machine::ideal("geometry");
    for effect in truth.effects() {
        let needs = &effect.description().needs;
        let still = !needs.contains(&Need::Delta) && !needs.contains(&Need::Velocity);
        if still {
            let pushed = known.push(effect.clone(), Provenance::default());
            pushed.map_err(|e| PaperError::Cannot(e.to_string()))?;
        }
    }
    Ok(known)
}

/// Table 7, inches ·10⁻⁴: hole (and counterbore) by hole (and counterbore), X, Y, Z.
const TABLE_7: [(u32, [[f64; 3]; 2]); 11] = [
    (2, [[3.0, 12.0, 1.0], [0.0, 13.0, 1.0]]),
    (3, [[-3.0, 9.0, -1.0], [-5.0, 1.0, -1.0]]),
    (4, [[10.0, 9.0, 20.0], [5.0, 0.0, 20.0]]),
    (5, [[21.0, 19.0, 57.0], [18.0, 19.0, 57.0]]),
    (6, [[12.0, 18.0, 63.0], [8.0, 19.0, 63.0]]),
    (7, [[6.0, 16.0, 48.0], [3.0, 19.0, 48.0]]),
    (8, [[20.0, 17.0, 44.0], [18.0, 19.0, 44.0]]),
    (9, [[43.0, 53.0, 59.0], [40.0, 53.0, 59.0]]),
    (10, [[38.0, 52.0, 42.0], [36.0, 51.0, 42.0]]),
    (11, [[34.0, 49.0, 42.0], [32.0, 49.0, 42.0]]),
    (12, [[44.0, 50.0, 57.0], [42.0, 51.0, 57.0]]),
];

fn drilling(
    rows: &mut Rows,
    run: &Run<'_>,
    model: &Machine,
    (scale, positioning, thermal): ([f64; 3], [f64; 3], [[f64; 3]; 2]),
) -> Result<(), PaperError> {
    let cold = run.experiment("drilling", model)?;
    let warm = run.experiment("drilling-warm", model)?;
    let deviations = |found: &Findings, name: &str| -> Result<[Vec<f64>; 3], PaperError> {
        let record = record(found, name)?;
        Ok([0, 1, 2].map(|p| {
            let e = error_of(record, p);
            e.iter().map(|v| (v - e[0]) / INCH_UM).collect()
        }))
    };
    let test_1 = deviations(&cold, "drilling")?;
    let test_3 = deviations(&cold, "drilling-compensated")?;
    let test_2 = deviations(&warm, "drilling-warm-compensated")?;
    let sizes = "the paper drilled two months after the characterisation and gives sizes with reference to hole 1 only; ours is the \
                 machine of tables 1 to 5 in between, sign as the tool is off. Sizes are compared";
    for (hole, both) in TABLE_7 {
        for (k, name) in [(0, "hole"), (1, "counterbore")] {
            for p in 0..3 {
                let at = 2 * (hole as usize - 1) + k;
                let ours = test_1[p].get(at).copied().unwrap_or(0.0);
                rows.number(
                    ("Table 7 (test 1)", &format!("{name} {hole}, {}", AXES[p]), "in"),
                    both[k][p].abs() * 1e-4,
                    ours.abs(),
                    Is::Within(0.003),
                    if hole == 6 && k == 1 && p == 0 {
                        "0.008 in is printed, ten times its hole's 0.0012: read as 0.0008"
                    } else {
                        sizes
                    },
                );
            }
        }
    }
    let worst = |d: &[Vec<f64>; 3], p: usize, rows: std::ops::Range<usize>| {
        d[p].get(rows).unwrap_or_default().iter().map(|e| e.abs()).fold(0.0, f64::max)
    };
    for (p, says) in [0.0044, 0.0053, 0.0059].into_iter().enumerate() {
        rows.number(
            ("Text after table 7", &format!("errors of the machining test in {}", AXES[p]), "in"),
            says,
            worst(&test_1, p, 0..24),
            Is::Within(0.002),
            sizes,
        );
    }
    for (p, says) in [0.0033, 0.0042, 0.0045].into_iter().enumerate() {
        let rss = (scale[p].powi(2) + positioning[p].powi(2) + thermal[1][p].powi(2)).sqrt() / INCH_UM;
        rows.number(
            ("Text after table 7", &format!("uncertainty from the characterisation in {}", AXES[p]), "in"),
            says,
            rss,
            Is::Within(0.0008),
            "root sum of squares of table 6's scale, positioning and wet thermal errors, which gives the paper's figures of its own",
        );
    }
    for (figure, test, name) in [
        ("21", &test_1, "test 1, cold, not compensated"),
        ("22", &test_2, "test 2, warm, compensated"),
        ("23", &test_3, "test 3, cold, compensated"),
    ] {
        for (p, axis) in AXES.iter().enumerate() {
            for (cycle, holes) in [("I", 0..8), ("II", 8..16), ("III", 16..24)] {
                rows.not(
                    (
                        &format!("Figure {figure}{}", ["a", "b", "c"][p]),
                        &format!("{name}: largest deviation in {axis}, cycle {cycle}"),
                        "in",
                    ),
                    "plotted within ±0.004",
                    &shown(worst(test, p, holes)),
                    "curves without figures",
                );
            }
        }
    }
    for (test, name) in [(&test_2, "2, warm"), (&test_3, "3, cold")] {
        for (p, axis) in AXES.iter().enumerate() {
            let (with, without) = (worst(test, p, 0..24), worst(&test_1, p, 0..24));
            rows.holds(
                (
                    "Figures 22 and 23",
                    &format!("test {name}: errors in {axis} substantially reduced against test 1"),
                ),
                "substantially reduced",
                &format!("{} in of {} in", shown(with), shown(without)),
                with <= 0.3 * without,
                "below 30 % counts as substantial; the model was fitted on the wet spindle cycle alone",
            );
        }
    }
    Ok(())
}
