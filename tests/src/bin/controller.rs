//! `controller`: LinuxCNC as the controller of a simulated, corrected lathe.
//! The lathe has a known error. LinuxCNC turns a part (a taper, arcs, a full circle) without and with the corrector,
//! and the tool's path is compared with the part's. Then it probes a part, fast and slowly. The corrector's captures
//! are compared with the contacts and with LinuxCNC's own probing results.
//!
//! Run it by `cargo run --release -p rtec-tests --bin controller`. Exit 1 means one of two failures. The corrected path
//! error is above the machine's own plus the resolution, or a probed point is not where it should be.

use anyhow::{Context, ensure};
use rtec_part::contour::{Contour, Segment};
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{ProbeGeometry, ProbingMotion, ProbingPlan};
use rtec_part::probe_trip_check::assign;
use rtec_part::probing_program::{DialectWithTemplate, ProbingProgramInputs, VariableValues};
use rtec_sim::lathe_program_run::captured;
use rtec_tests::machine::{AXES, AxisError, COUNT_UM, Job, PROBE_LOG, Round, Run, run};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;
use std::path::Path;

type Point = [f64; AXES];

/// A segment of the part's outline, (X radius, Z) in mm.
enum Piece {
    Line(Point, Point),
    Circle { centre: Point, radius: f64 },
}

impl Piece {
    fn distance(&self, p: Point) -> f64 {
        match *self {
            Self::Line(a, b) => {
                let (along, to) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
                let square = along[0] * along[0] + along[1] * along[1];
                let part = ((along[0] * to[0] + along[1] * to[1]) / square).clamp(0.0, 1.0);
                (to[0] - part * along[0]).hypot(to[1] - part * along[1])
            }
            Self::Circle { centre, radius } => ((p[0] - centre[0]).hypot(p[1] - centre[1]) - radius).abs(),
        }
    }
}

/// The program and outline of the part.
/// It is a taper, a quarter arc out and one back, a straight line, and a full circle about its end.
fn part() -> (String, Vec<Piece>) {
    let program = "\
        G21 G18 G8 G90 G61 F1200\n\
        G1 X10 Z-30\n\
        G2 X20 Z-40 I10 K0\n\
        G3 X30 Z-50 I0 K-10\n\
        G1 X30 Z-60\n\
        G3 X30 Z-60 I-12 K0\n\
        M2\n";
    let outline = vec![
        Piece::Line([0.0, 0.0], [10.0, -30.0]),
        Piece::Circle { centre: [20.0, -30.0], radius: 10.0 },
        Piece::Circle { centre: [20.0, -50.0], radius: 10.0 },
        Piece::Line([30.0, -50.0], [30.0, -60.0]),
        Piece::Circle { centre: [18.0, -60.0], radius: 12.0 },
    ];
    (program.to_owned(), outline)
}

/// Largest and root mean square distance of a path from the outline, µm.
fn deviation_um(path: &[Point], outline: &[Piece]) -> (f64, f64) {
    let distance =
        |p: &Point| outline.iter().map(|piece| piece.distance(*p)).fold(f64::INFINITY, f64::min) * 1e3;
    let (max, squares) =
        path.iter().map(distance).fold((0.0, 0.0), |(m, s): (f64, f64), d| (m.max(d), s + d * d));
    (max, (squares / path.len() as f64).sqrt())
}

fn check(name: &str, run: &Run) -> anyhow::Result<()> {
    ensure!(run.complaints.is_empty(), "{name}: {:?}", &run.complaints[..run.complaints.len().min(5)]);
    ensure!(run.illegal == 0, "{name}: {} illegal transitions at the counter card", run.illegal);
    for n in 0..AXES {
        let (mtc, scale, completed) = (run.mtc_counts[n], run.scale_counts[n], run.completed[n]);
        ensure!(mtc - scale == completed, "{name}, axis {n}: {mtc} - {scale} is not {completed}");
    }
    Ok(())
}

fn main() -> anyhow::Result<()> {
    let (program, outline) = part();
    let error = [
        AxisError { ppm: -600.0, periodic_um: 5.0, period_mm: 5.0 },
        AxisError { ppm: 500.0, periodic_um: 8.0, period_mm: 10.0 },
    ];
    let mut table = String::new();
    let mut max_um = Vec::new();
    for (name, error, job) in [
        ("ideal machine", Default::default(), Job::Plain),
        ("with error", error, Job::Plain),
        ("with error, corrected", error, Job::Correct),
    ] {
        let run = run(&program, error, job)?;
        check(name, &run)?;
        let (commanded, _) = deviation_um(&run.command_mm, &outline);
        let (max, rms) = deviation_um(&run.tool_mm, &outline);
        writeln!(
            table,
            "{name:<24} {max:>8.2} {rms:>8.2} {commanded:>10.2} {:>10} {:>14} {:>8}",
            run.insertions,
            format!("{:+} {:+}", run.completed[0], run.completed[1]),
            run.periods
        )?;
        max_um.push(max);
    }
    println!("path of the tool against the part, LinuxCNC as the controller, counts of {COUNT_UM} µm");
    println!(
        "{:<24} {:>8} {:>8} {:>10} {:>10} {:>14} {:>8}",
        "", "max µm", "RMS µm", "command µm", "insertions", "completed x z", "periods"
    );
    print!("{table}");
    let [ideal, wrong, corrected] = max_um[..] else { unreachable!("three runs") };
    // One insertion is two counts, rounded to the nearest: a count either way on each of two axes.
    let allowed = ideal + 2.0 * COUNT_UM * f64::sqrt(2.0);
    println!("allowed: {allowed:.2} µm (the ideal machine's {ideal:.2} and the resolution)");
    ensure!(wrong > 3.0 * allowed, "the error of {wrong:.2} µm is too small to show anything");
    ensure!(corrected <= allowed, "corrected {corrected:.2} µm, allowed {allowed:.2} µm");
    fast_and_slow()
}

/// Results of a probing session.
struct Session {
    /// Time from the first trip to the last, s.
    seconds: f64,
    /// Largest distance of the corrector's captures from the contacts, µm.
    /// It is measured along the touch, from the machine's own record.
    captured_um: f64,
    /// Smallest and largest distance of LinuxCNC's results (#5061, #5063), µm.
    /// It is measured alike; beyond the surface is positive.
    controller_um: (f64, f64),
    /// Largest half-width of the corrector's positions, µm.
    stated_um: f64,
}

/// Probes the nose of NISTIR 4854 with twenty G38.2 touches.
/// The program is in LinuxCNC's dialect. LinuxCNC also reads the probe, once a servo period. So its result is up to one
/// period's travel behind the contact.
fn probe(feed_mm_min: f64) -> anyhow::Result<Session> {
    let (centre, radius_mm, tip_mm) = (Zx::new(-100.0, 0.0), 38.1, 2.5);
    let nose = Segment::Arc { centre, radius_mm, start_rad: 0.0, sweep_rad: FRAC_PI_2 };
    let part = Contour::new(vec![(nose, "NOSE".to_owned())], false);
    let motion =
        ProbingMotion { feed_mm_min, accel_mm_s2: 500.0, decel_mm_s2: 500.0, ..ProbingMotion::REPORT };
    let (stand_off_mm, over_travel_mm) = (motion.stand_off_mm(), motion.over_travel_mm());
    let mut plan = ProbingPlan::new(ProbeGeometry { tip_mm, stand_off_mm, over_travel_mm, stem: None });
    plan.add_number(&part, 0, 20, 0.0);
    let mut parameters = VariableValues::default();
    for (name, value) in [("probing_start_z", "50"), ("feed", &feed_mm_min.to_string())] {
        parameters
            .set(name, value)
            .map_err(|(found, expected)| anyhow::anyhow!("{found}, expected {expected}"))?;
    }
    let controller = DialectWithTemplate::built_in("linuxcnc").context("no dialect linuxcnc")??;
    let program = ProbingProgramInputs {
        controller: &controller,
        parameters: &parameters,
        records: &plan.records(),
        unit: LengthUnit::MM,
        comments: true,
        made: "today",
    }
    .text(Path::new("template.prb"))?;
    let logged = format!("(PROBEOPEN {PROBE_LOG})\n{program}");
    let round = Round { centre_mm: [centre.x, centre.z], reach_mm: radius_mm + tip_mm };
    let mut run = run(&logged, Default::default(), Job::Probe(round))?;
    check("probing", &run)?;
    // Axis 0 is X here; the part's axis 0 is Z.
    run.events.iter_mut().for_each(|e| e.axis = e.axis.map(|n| 1 - n));
    let expected = plan.expected();
    let trips = assign(&captured(&run.events), &expected, COUNT_UM, Zx::new(0.0, 0.0), 0.5)?;
    ensure!(run.trips_mm.len() == 20, "{} contacts, 20 points", run.trips_mm.len());
    ensure!(run.controller_trips_mm.len() == 20, "LinuxCNC logged {} probes", run.controller_trips_mm.len());

    let mut session = Session {
        seconds: trips[19].t_s - trips[0].t_s,
        captured_um: 0.0,
        controller_um: (f64::INFINITY, f64::NEG_INFINITY),
        stated_um: 0.0,
    };
    let at = |[x, z]: Point| Zx::new(z, x);
    for (n, trip) in trips.iter().enumerate() {
        let inward = (centre - expected[n]).unit().context("a point at the centre")?;
        let contact = at(run.trips_mm[n]);
        session.captured_um = session.captured_um.max((trip.tip_centre - contact).dot(inward).abs() * 1e3);
        session.stated_um = session.stated_um.max(trip.uncertainty_um);
        let late_um = (at(run.controller_trips_mm[n]) - contact).dot(inward) * 1e3;
        session.controller_um = (session.controller_um.0.min(late_um), session.controller_um.1.max(late_um));
    }
    Ok(session)
}

/// Compares fast and slow probing, captured by the corrector and by LinuxCNC.
fn fast_and_slow() -> anyhow::Result<()> {
    println!("twenty points probed by LinuxCNC (G38.2), µm along the touch from where the contact was");
    println!(
        "{:>8} {:>10} {:>12} {:>12} {:>22}",
        "mm/min", "time s", "captured µm", "stated ± µm", "LinuxCNC's own µm"
    );
    for feed_mm_min in [2500.0, 125.0] {
        let s = probe(feed_mm_min)?;
        println!(
            "{feed_mm_min:>8} {:>10.1} {:>12.2} {:>12.2} {:>22}",
            s.seconds,
            s.captured_um,
            s.stated_um,
            format!("{:+.1} to {:+.1}", s.controller_um.0, s.controller_um.1)
        );
        ensure!(s.captured_um < 1.0, "more than the micrometre that fast probing is for");
        // LinuxCNC samples once a servo period, and in whole counts.
        let period_um = feed_mm_min / 60.0;
        let (low, high) = s.controller_um;
        ensure!(
            low > -COUNT_UM && high < period_um + COUNT_UM,
            "LinuxCNC measured {low:+.1} to {high:+.1} µm beyond the contact, a servo period is {period_um:.1} µm"
        );
    }
    Ok(())
}
