//! NISTIR 4854: fast probing, a part-form error and its compensation.

use crate::rows::Agreement::{AtLeast, AtMost, Share, Within};
use crate::rows::Rows;
use crate::{PaperError, Progress};
use rtec_model::machine::Machine;
use rtec_part::arc_finish_cut_table::ArcFinishCutTable;
use rtec_part::contour::nose;
use rtec_part::error_cor_file::PointError;
use rtec_part::geometric_fit::Zx;
use rtec_part::part_errors::{MAGNIFICATION, PartErrorReport};
use rtec_part::probe_path::{PathPointRole, ProbeGeometry, ProbingMotion, ProbingPlan};
use rtec_part::probing_program::{DialectWithTemplate, VariableValues};
use rtec_sim::axis::AxisSpec;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::lathe::{self, LatheSpec};
use rtec_sim::nc_block::Block;
use rtec_sim::turning_experiment::{TurningExperimentInputs, TurningExperimentResult};
use serde::Deserialize;
use std::path::Path;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Lathe {
    machine: String,
    design: String,
    radius_mm: f64,
    allowance_mm: f64,
    points: usize,
    tip_mm: f64,
    probing_mm_min: f64,
    cut_mm_min: f64,
    longest_axis_mm: f64,
    correction_bits: u32,
    part_number: String,
    size_error_um: f64,
    g01_um: f64,
    bench: LatheSpec,
}

impl Lathe {
    fn read(described: &MachineDescriptions) -> Result<Self, PaperError> {
        let lathe: Self = described.read("4854.toml")?;
        lathe.bench.check().map_err(|(key, expected)| {
            described.refuse("4854.toml", key, format!("{key} out of range"), expected.to_owned())
        })?;
        Ok(lathe)
    }

    fn setup(&self, seed: u64) -> TurningExperimentInputs {
        TurningExperimentInputs {
            design: self.design.clone(),
            radius_mm: self.radius_mm,
            allowance_mm: self.allowance_mm,
            points: self.points,
            tip_mm: self.tip_mm,
            cut_feed_mm_min: self.cut_mm_min,
            motion: ProbingMotion {
                feed_mm_min: self.probing_mm_min,
                accel_mm_s2: self.bench.accel_mm_s2,
                decel_mm_s2: self.bench.decel_mm_s2,
                ..ProbingMotion::REPORT
            },
            // One control period and the lag of the position loop.
            lead_s: self.bench.control_ms * 1e-3 + 1.0 / self.bench.gain,
            bench: self.bench.clone(),
            seed,
            ..TurningExperimentInputs::default()
        }
    }
}

const INCH: f64 = 25.4;

pub(crate) fn run(
    described: &MachineDescriptions,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Rows, PaperError> {
    let lathe = Lathe::read(described)?;
    let machine = described.machine(&lathe.machine)?;
    let setup = lathe.setup(seed);
    let mut rows = Rows::default();
    progress("NISTIR 4854: constant velocity in a touch");
    gauging(&mut rows, &lathe, seed)?;
    let outcome = setup.run(&mut |step| progress(&format!("NISTIR 4854: {step}")))?;
    for ((_, report), figure) in outcome.reports.iter().zip([5, 6]) {
        rows.figures.push((format!("figure-{figure}.svg"), report.whisker_svg()));
    }
    probing(&mut rows, &lathe, &outcome);
    form(&mut rows, &outcome);
    let blank = rewritten(&lathe, &setup);
    program(&mut rows, &lathe, &outcome, blank);
    paths(&mut rows, &lathe)?;
    progress("NISTIR 4854: geometric-thermal errors, eleven components, a correction every 50 ms");
    geometric_thermal(&mut rows, &lathe, &setup, &machine, progress)?;
    Ok(rows)
}

/// Stand-off, over-travel, and what of them is at constant velocity.
fn gauging(rows: &mut Rows, lathe: &Lathe, seed: u64) -> Result<(), PaperError> {
    let place = "On-Machine Gauging";
    let setup = lathe.setup(seed);
    let from = "from the acceleration and deceleration of the machine file, which were read out of this very sentence";
    let (off, over) = (setup.motion.stand_off_mm(), setup.motion.over_travel_mm());
    rows.fitted().number((place, "stand-off", "mm"), 5.0, off, Within(0.05), from);
    rows.fitted().number((place, "over-travel", "mm"), 2.5, over, Within(0.05), from);
    let bench = &lathe.bench;
    let axis = AxisSpec {
        count_um: bench.count_um,
        accel_mm_s2: bench.accel_mm_s2,
        decel_mm_s2: bench.decel_mm_s2,
        jerk_mm_s3: 100_000.0,
        position_gain_per_s: bench.gain,
        backlash_um: 0.0,
        ..AxisSpec::new("z", lathe.longest_axis_mm)
    };
    let mut sim = CorrectedMachineSim::new(
        &MachineSpec::new(vec![axis]),
        &Machine::ideal("axis"),
        None,
        [0.0; 3],
        seed,
    )?;
    let v_mm_s = lathe.probing_mm_min / 60.0;
    sim.machine.load([Block::Feed { to: [0.0, 0.0, off + over], feed_mm_s: v_mm_s }]);
    let mut constant_mm = 0.0;
    let mut last = 0.0;
    while !sim.machine.finished() {
        sim.advance(0.0005)?;
        let now = sim.moment();
        if (now.axes[2].velocity_mm_s - v_mm_s).abs() < 0.01 * v_mm_s {
            constant_mm += now.axes[2].position_mm - last;
        }
        last = now.axes[2].position_mm;
    }
    let what = "of the touch at constant velocity (within 1 %)";
    let why = "\"about\"; the servo settles to 1 % of the velocity a little after the ramp";
    rows.fitted().number((place, what, "mm"), 2.0, constant_mm, Within(0.5), why);
    Ok(())
}

fn probing(rows: &mut Rows, lathe: &Lathe, o: &TurningExperimentResult) {
    let [fast, slow] = &o.probing;
    let place = "The RTEC";
    let what = "a capture 25 µs late at 2.5 m/min costs the position resolution";
    rows.given().number((place, what, "µm"), 1.0, fast.late_25us_um, Within(0.05), "41.7 mm/s times 25 µs");
    let what = "captured within the position resolution, largest of 20 trips";
    let why = "positions are interpolated between two counts";
    rows.number((place, what, "µm"), lathe.bench.count_um, fast.capture_worst_um, AtMost, why);
    let what =
        "a controller that looks once in milliseconds does not allow fast probing: 1 ms late costs more";
    rows.given().number((place, what, "µm"), 1.0, fast.late_1ms_um, AtLeast, "41.7 mm/s times 1 ms");
    let place = "The RTEC; Introduction of 4832";
    let what = "faster than commonly used: 10 to 20 times in feed";
    rows.given().number((place, what, "times"), 20.0, fast.feed_mm_min / slow.feed_mm_min, Within(0.0), "");
}

fn form(rows: &mut Rows, o: &TurningExperimentResult) {
    let place = "Part-Form Error; figure 5";
    let seeds = "one cut of one tool there, one of other noise here";
    let semi = &o.semi_finish;
    rows.fitted().number((place, "height of the bump", "µm"), 23.0, semi.bump_um, Within(1.5), seeds);
    rows.fitted().number((place, "largest error bar", "µm"), 21.4, semi.largest_um, Within(1.0), seeds);
    let report = &o.reports[0].1;
    let why = "the machine file has another number";
    rows.given().number((place, "points probed", ""), 20.0, report.errors.len() as f64, Within(0.0), why);
    let on_bump = report.errors.iter().filter(|e| e.error_um > 0.5).count();
    let why = "read off figure 5 there; points above 0.5 µm here";
    rows.number((place, "points on the bump, about", ""), 6.0, on_bump as f64, Within(1.0), why);
    let place = "Part Error Calculations";
    let why = "the shape of the bump beyond its height and points is not given";
    rows.number((place, "SD of the circle fit, all points", "µm"), 5.6, semi.sd_before_um, Within(0.7), why);
    let why = "the probe here repeats better than 1.7 µm, and the flanks of the bump are left out";
    rows.number((place, "SD of the second fit", "µm"), 1.7, semi.sd_after_um, Within(1.0), why);
    corrected(rows, o);
}

/// The finish cut, and what is drawn of it.
fn corrected(rows: &mut Rows, o: &TurningExperimentResult) {
    let report = &o.reports[0].1;
    let place = "Compensating for the Part-Form Error";
    let why = "the machine file has another design or count";
    rows.given().number((place, "one correction", "µm"), 4.0, o.increment_um, Within(0.0), why);
    let what = "corrections for the largest error";
    let gets = o.corrections as f64;
    rows.fitted().number((place, what, ""), 5.0, gets, Within(0.0), "21.4 µm in steps of 4 µm, rounded");
    let place = "Figure 6";
    let what = "longest error bar after the finish cut";
    let gets = o.finish.largest_um;
    rows.number((place, what, "µm"), 4.0, gets, AtMost, "ours may be less: half a correction is the least");
    let why = "less noise of probe and cut than the report's";
    rows.number((place, "SD of the circle fit", "µm"), 2.0, o.finish.sd_before_um, AtMost, why);
    let what = "the components of the errors are below the correction resolution";
    rows.number((place, what, "µm"), o.increment_um, component(&o.reports[1].1), AtMost, "");
    let why = "counted by the simulated controller's own decoders";
    let what = "the MTC's count less the scales' is what was inserted";
    let gets = if o.balanced() { "it is" } else { "it is not" };
    rows.holds(("Section 2", what), "it must be", gets, o.balanced(), why);
    let gets = 4e-3 * MAGNIFICATION;
    rows.given().number(("CAD Error Display", "a 4 µm error is drawn as", "mm"), 1.0, gets, Within(1e-9), "");
    let place = "The Determination of Part-Form Errors";
    let what = "radius of the nose";
    let gets = report_radius(&o.reports[1].1);
    rows.given().number((place, what, "mm"), 38.1, gets, Within(0.01), "as fitted to what was probed");
    let what = "the semi-finish cut is larger in radius by";
    let gets = report_radius(report) - report_radius(&o.reports[1].1);
    rows.given().number((place, what, "mm"), 0.254, gets, Within(0.005), "between the two fitted radii");
}

fn report_radius(report: &PartErrorReport) -> f64 {
    report.radius_mm.unwrap_or(0.0)
}

/// Largest component of an error along Z or X.
fn component(report: &PartErrorReport) -> f64 {
    let of = |e: &PointError| {
        let n = Zx::at_angle(e.angle_rad) * e.error_um;
        n.z.abs().max(n.x.abs())
    };
    report.errors.iter().map(of).fold(0.0, f64::max)
}

/// G01 lines for the plain arc.
fn rewritten(lathe: &Lathe, setup: &TurningExperimentInputs) -> usize {
    let round = (0..lathe.points.max(2)).map(|k| PointError {
        angle_rad: std::f64::consts::FRAC_PI_2 * k as f64 / (lathe.points.max(2) - 1) as f64,
        error_um: 0.0,
        along_mm: None,
    });
    let design = lathe::design(&lathe.design).unwrap_or(rtec_sim::corrected_axis::GateInsertionDesign::C);
    let table = ArcFinishCutTable::new(
        setup.cut(lathe.radius_mm),
        lathe::axes(&lathe.bench, design),
        round.collect(),
    );
    table.straight_moves(lathe.g01_um * 1e-3, 4).len().saturating_sub(1)
}

fn program(rows: &mut Rows, lathe: &Lathe, o: &TurningExperimentResult, plain: usize) {
    let place = "Compensating for the Part-Form Error";
    let what = "G01 lines that stay within about 1.5 µm of the arc";
    let why = "of the path of the nose's centre, and coordinates of four decimals";
    rows.number((place, what, ""), 90.0, plain as f64, Share(0.05), why);
    let what = "the same with the errors in them";
    let gets = o.program_lines as f64;
    rows.number((place, what, ""), 90.0, gets, Share(0.05), "shorter where the errors bend");
    let why = "the machine file has another axis";
    let what = "bits for the longest axis";
    let gets = bits(lathe.longest_axis_mm * 1e3 / lathe.bench.count_um);
    rows.given().number(("Implementing Corrections", what, "bits"), 20.0, gets, Within(0.0), why);
    let most = f64::from((1_u32 << (lathe.correction_bits - 1)) - 1);
    let why = "the report prints ±127 µm; ±127 corrections of 4 µm are ±508 µm, as NISTIR 4832 has it";
    let what = "range of the \"Correction Requested\" byte, ±";
    let gets = most * o.increment_um;
    rows.given().number(("Implementing Corrections", what, "µm"), 127.0, gets, Within(0.0), why);
}

fn bits(counts: f64) -> f64 {
    counts.max(2.0).log2().ceil()
}

/// Size and largest form error (µm) left by four ways to correct a tool whose dimension is off.
///
/// # Errors
/// A description that is not right, or a lathe that stops.
pub fn size_and_form(
    described: &MachineDescriptions,
    seed: u64,
) -> Result<[(&'static str, [f64; 2]); 4], PaperError> {
    let lathe = Lathe::read(described)?;
    let setup = lathe.setup(seed);
    let off_mm = lathe.size_error_um * 1e-3;
    let semi_mm = lathe.radius_mm + lathe.allowance_mm;
    let feed = setup.motion.feed_mm_min;
    let mut part = setup.raw();
    setup.turn(&mut part, semi_mm + off_mm, None, setup.seed)?;
    let session = setup.probe(&part, &setup.plan(semi_mm), feed, setup.seed + 1)?;
    let semi = setup.errors(&session, semi_mm)?;
    let size_um = semi.size_error_um.unwrap_or(0.0);
    let axes = lathe::axes(
        &lathe.bench,
        lathe::design(&lathe.design).unwrap_or(rtec_sim::corrected_axis::GateInsertionDesign::C),
    );
    let table = |with_um: f64| {
        let sized = semi.errors.iter().map(|e| PointError { error_um: e.error_um + with_um, ..*e });
        ArcFinishCutTable::new(setup.cut(lathe.radius_mm), axes, sized.collect())
    };
    let finish = |offset_um: f64, table: Option<&ArcFinishCutTable>| -> Result<[f64; 2], PaperError> {
        let mut part = part.clone();
        setup.turn(&mut part, lathe.radius_mm + off_mm - offset_um * 1e-3, table, setup.seed + 2)?;
        let session = setup.probe(&part, &setup.plan(lathe.radius_mm), feed, setup.seed + 3)?;
        let report = setup.errors(&session, lathe.radius_mm)?;
        let bump = report.errors.iter().map(|e| e.error_um.abs()).fold(0.0, f64::max);
        Ok([report.size_error_um.unwrap_or(0.0), bump])
    };
    Ok([
        ("tool offset alone", finish(size_um, None)?),
        ("table alone", finish(0.0, Some(&table(0.0)))?),
        ("tool offset and table", finish(size_um, Some(&table(0.0)))?),
        ("table with the size in it", finish(0.0, Some(&table(size_um)))?),
    ])
}

/// Figure 7 and the file's name.
fn paths(rows: &mut Rows, lathe: &Lathe) -> Result<(), PaperError> {
    let place = "Figure 7";
    // The part of figure 7, in inches: a nose of 1.5 in about Z 5 in, touched from 0.3 in off.
    let (centre, radius) = (Zx::new(5.0 * INCH, 0.0), 1.5 * INCH);
    let contour = nose(centre, radius);
    let off = 0.3 * INCH;
    let mut plan =
        ProbingPlan::new(ProbeGeometry { tip_mm: 0.0, stand_off_mm: off, over_travel_mm: 0.0, stem: None });
    plan.add_number(&contour, 0, lathe.points, 0.0);
    rows.figures.push(("figure-7.svg".to_owned(), plan.svg(&contour)));
    let n = plan.points.len();
    if n < 2 {
        return Err(PaperError::Cannot("NISTIR 4854: fewer than two probing points".to_owned()));
    }
    let records = plan.records();
    let of = |point: usize, wanted: PathPointRole| {
        let touch = records.iter().position(|r| r.role == PathPointRole::Touch(point)).unwrap_or(0);
        let at = if wanted == PathPointRole::Start { touch.saturating_sub(1) } else { touch };
        let p = records[at].at;
        [p.z / INCH, p.x / INCH]
    };
    let why = "the machine file has another number of points";
    for (what, point, role, says) in [
        ("start of point 1", n - 1, PathPointRole::Start, [5.148_643, 1.793_852]),
        ("touch of point 1", n - 1, PathPointRole::Touch(0), [5.123_869, 1.494_877]),
        ("start of point 2", n, PathPointRole::Start, [5.0, 1.8]),
        ("touch of point 2", n, PathPointRole::Touch(0), [5.0, 1.5]),
    ] {
        let got = of(point, role);
        for (k, axis) in ["Z", "X"].iter().enumerate() {
            rows.number((place, &format!("{what}, {axis}"), "in"), says[k], got[k], Within(2e-6), why);
        }
    }
    let place = "Requirements of NC Probing Code";
    let mut parameters = VariableValues::default();
    let bad = |(found, expected): (String, String)| {
        PaperError::from(rtec_files::InputError::whole(Path::new("4854.toml"), found, expected))
    };
    parameters.set("part", &lathe.part_number).map_err(bad)?;
    parameters.set("segment", "2").map_err(bad)?;
    let what = "file of the first probing segment of version 4 of part 63";
    rows.words((place, what), "pt6304s2.dnc", &parameters.file_name(), "the machine file has another part");
    let longest = (60..80).take_while(|n| parameters.clone().set("note_1", &"x".repeat(*n)).is_ok()).last();
    let what = "longest line of general comments";
    let gets = longest.unwrap_or(0) as f64;
    rows.given().number(("Operating Procedure", what, "characters"), 66.0, gets, Within(0.0), "");
    let controller = DialectWithTemplate::built_in("report").transpose()?;
    let template = controller.map(|c| c.template).unwrap_or_default();
    let says = ["N0010", "N0150", "T00", "G92 X", "M14", "M02", "(END, PROG)"];
    let there = says.iter().filter(|w| template.contains(**w)).count();
    let what = "words of template.prb that are in ours: N0010, N0150, T00, G92 X, M14, M02, (END, PROG)";
    rows.given().number(("Figure 8", what, "of 7"), says.len() as f64, there as f64, Within(0.0), "");
    Ok(())
}

/// Eleven components, corrected every 50 ms while the nose is cut.
fn geometric_thermal(
    rows: &mut Rows,
    lathe: &Lathe,
    setup: &TurningExperimentInputs,
    machine: &Machine,
    progress: Progress<'_>,
) -> Result<(), PaperError> {
    let place = "Compensation of G-T Errors";
    let components: usize = machine.chain().map_or(0, |c| c.joints.iter().map(|j| j.components.len()).sum());
    let what = "error components of the two-axis machine";
    let gets = components as f64;
    rows.given().number((place, what, ""), 11.0, gets, Within(0.0), "the machine file has another chain");
    let what = "a new correction about every";
    let gets = lathe.bench.control_ms;
    rows.given().number((place, what, "ms"), 50.0, gets, Within(0.0), "the machine file has another period");
    let what = "the tool moves in that time less than";
    let gets = lathe.cut_mm_min / 60.0 * lathe.bench.control_ms * 1e-3;
    rows.given().number((place, what, "mm"), 1.0, gets, AtMost, "at the feed of the finish cut");
    let known = TurningExperimentInputs {
        machine: machine.clone(),
        model: Some(machine.clone()),
        begin_s: 3600.0,
        ..setup.clone()
    };
    let o = known.run(&mut |step| progress(&format!("NISTIR 4854, G-T: {step}")))?;
    let what = "nose cut on that machine an hour after switching on: longest error bar";
    let why = "model and table together, probing corrected off line";
    rows.number((place, what, "µm"), 4.0, o.finish.largest_um, AtMost, why);
    Ok(())
}
