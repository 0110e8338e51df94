//! `rtecctl part probe`: a probing session, simulated or by the daemon.
//! The engine captures the positions.

use super::points::positive;
use super::simulated_machine_args::SimMachineArgs;
use super::{failed, usage, write_all};
use crate::daemon_connection::{self, unreachable};
use crate::prelude::*;
use rtec_control::daemon_client::{ClientError, DaemonConnection};
use rtec_control::protocol::{self, ClientRequest, DaemonResponse};
use rtec_files::cli_option_parsers::one_of;
use rtec_measure::run_record_files::{to_csv, to_sidecar};
use rtec_model::record::Record;
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{approaches, read_expected, read_pathfin};
use rtec_part::probe_trip_check::{
    CapturedTrips, GaugingPointTrip, ProbeTripFault, assign, probed_csv, run_record,
};
use rtec_sim::workpiece::Workpiece;
use std::io::ErrorKind;
use std::time::{Duration, Instant};

/// Probe a part: through the daemon while the controller runs the probing program, or on the simulated machine
///
/// A missed or a second trip, a bounce, and a trip outside its window end the session and name the point. Positions are
/// as the scales read; the temperatures at each trip are kept for the off-line correction (`part errors --machine`).
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Probe this workpiece, as `part finish` writes it, on the simulated machine
    #[arg(long, required_unless_present = "daemon")]
    workpiece: Option<PathBuf>,
    /// Take the trips from the daemon
    #[arg(long, conflicts_with = "workpiece")]
    daemon: bool,
    #[command(flatten)]
    live: DaemonProbingArgs,
    /// The probe's path
    #[arg(long)]
    path: PathBuf,
    /// The expected trips
    #[arg(long)]
    expected: PathBuf,
    /// Unit of both files
    #[arg(long, value_parser = one_of(&LengthUnit::ALL, &[]), default_value = "mm")]
    path_units: LengthUnit,
    #[command(flatten)]
    bench: SimMachineArgs,
    /// Folder for probed.csv and the run record probing.run.toml
    #[arg(long)]
    out: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A session through the daemon
#[derive(Debug, clap::Args)]
struct DaemonProbingArgs {
    /// The daemon's control socket [default: the installed one's]
    #[arg(long, value_name = "PATH", requires = "daemon")]
    socket: Option<PathBuf>,
    /// Hold the feed until probing is on, then release it
    #[arg(long, requires = "daemon")]
    start: bool,
    /// Machine position at the part's origin with the probe in place
    #[arg(long, value_name = "Z,X", value_delimiter = ',', num_args = 1, allow_negative_numbers = true)]
    origin_mm: Option<Vec<f64>>,
    /// The daemon's axis along the part
    #[arg(long, default_value = "z")]
    z_axis: String,
    /// The daemon's axis across the part
    #[arg(long, default_value = "x")]
    x_axis: String,
    /// A trip that has not come after so long is missed, in s
    #[arg(long, default_value_t = 60.0)]
    patience_s: f64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let setup = args.bench.setup()?;
    let unit = args.path_units;
    let records = read_pathfin(&args.path, unit)?;
    let expected = read_expected(&args.expected, unit)?;
    let approach = approaches(&records);
    if approach.len() != expected.len() {
        let found = format!("{} touches for {} expected trips", approach.len(), expected.len());
        return Err(usage("--expected", found, "the two files of one plan"));
    }
    let Some(workpiece) = &args.workpiece else {
        let seen = watch(&args.live, &expected, setup.window_mm)?;
        let sensors: Vec<&str> = seen.sensors.iter().map(String::as_str).collect();
        let csv = probed_csv(&seen.trips, &approach, &sensors, &seen.degc);
        let record = run_record(&seen.trips, &expected, &approach, seen.origin, &sensors, &seen.degc);
        write_session(&args.out, csv, record.as_ref())?;
        return show(args.json, &seen.trips, seen.seconds);
    };
    let part = Workpiece::read(workpiece)?;
    let feed_mm_min = positive("--feed-mm-min", setup.motion.feed_mm_min)?;
    let session =
        setup.probe_path(&part, &records, &expected, &approach, feed_mm_min, setup.seed).map_err(failed)?;
    write_session(&args.out, session.csv, session.record.as_ref())?;
    show(args.json, &session.trips, session.seconds)
}

fn show(json: bool, trips: &[GaugingPointTrip], seconds: f64) -> anyhow::Result<()> {
    answer(json, &serde_json::json!({"trips": trips, "seconds": seconds}), || {
        let mut t = "point       Z mm       X mm  within µm\n".to_owned();
        for GaugingPointTrip { point, tip_centre: p, uncertainty_um, .. } in trips {
            let _ = writeln!(t, "{point:>5} {:>10.4} {:>10.4} {uncertainty_um:>10.3}", p.z, p.x);
        }
        t + &format!("{} points in {seconds:.1} s\n", trips.len())
    })
}

/// Results of a session by the daemon.
struct ProbingResult {
    trips: Vec<GaugingPointTrip>,
    sensors: Vec<String>,
    /// Temperatures at each trip, one value per sensor, °C.
    degc: Vec<Vec<f64>>,
    origin: Zx,
    seconds: f64,
}

/// Wait for a second trip after the last one.
const SETTLED: Duration = Duration::from_secs(1);

/// Compares every trip with the plan; probing ends whatever happens.
fn watch(args: &DaemonProbingArgs, expected: &[Zx], window_mm: f64) -> anyhow::Result<ProbingResult> {
    let patience = Duration::from_secs_f64(positive("--patience-s", args.patience_s)?.min(86_400.0));
    let Some(&[z_mm, x_mm]) = args.origin_mm.as_deref() else {
        return Err(usage("--origin-mm", "nothing", "the machine's position at the part's origin, Z,X"));
    };
    let origin = Zx::new(z_mm, x_mm);
    let daemon = DaemonArgs::at(args.socket.clone());
    let ask = |request: &ClientRequest| daemon_connection::ask(&mut daemon.connect()?, request);
    let status = daemon_connection::status(&mut daemon.connect()?)?;
    for (option, name) in [("--z-axis", &args.z_axis), ("--x-axis", &args.x_axis)] {
        if status.axes.iter().all(|a| a.name != *name) {
            let names = list(status.axes.iter().map(|a| &a.name));
            return Err(usage(option, name.clone(), format!("one of {names}")));
        }
    }
    if let Some(why) = status.not_homed() {
        fail!(No, "{why}");
    }
    // The watch starts first, so that no trip can come in between.
    let mut events = daemon.connect()?;
    daemon_connection::ask(&mut events, &ClientRequest::Watch {})?;
    if args.start {
        ask(&ClientRequest::Hold { on: true })?;
    }
    ask(&ClientRequest::Probe { on: true })?;
    if args.start {
        ask(&ClientRequest::Hold { on: false })?;
    }
    eprintln!("probing is on, {} points; run the probing program", expected.len());
    let began = Instant::now();
    let done = follow(&mut events, args, expected, origin, window_mm, patience);
    // A failure to switch off must not hide an earlier error.
    let off = ask(&ClientRequest::Probe { on: false });
    let (trips, degc) = done?;
    off?;
    // A column needs a value at every trip.
    let known = |n: usize| degc.iter().all(|d| d.get(n).is_some_and(Option::is_some));
    let (kept, dropped): (Vec<usize>, Vec<usize>) = (0..status.sensors.len()).partition(|&n| known(n));
    let name = |n: usize| status.sensors[n].sensor.clone();
    if !dropped.is_empty() {
        eprintln!("no temperature at every trip, left out: {}", list(dropped.into_iter().map(name)));
    }
    let sensors = kept.iter().copied().map(name).collect();
    let degc = degc.iter().map(|d| kept.iter().filter_map(|&n| d[n]).collect()).collect();
    Ok(ProbingResult { trips, sensors, degc, origin, seconds: began.elapsed().as_secs_f64() })
}

/// Temperatures of each trip, in the order of the status's sensors.
type Temperatures = Vec<Vec<Option<f64>>>;

fn follow(
    events: &mut DaemonConnection,
    args: &DaemonProbingArgs,
    expected: &[Zx],
    origin: Zx,
    window_mm: f64,
    patience: Duration,
) -> anyhow::Result<(Vec<GaugingPointTrip>, Temperatures)> {
    let mut captured = CapturedTrips::default();
    let mut degc = Vec::new();
    // The two axes of a trip arrive when each meets its next edge; they share the trip's time.
    let mut half: Option<(usize, protocol::ProbeTripReport)> = None;
    let no = |fault: ProbeTripFault| anyhow::Error::from(CommandFailure::No(fault.to_string()));
    // The session's own clock begins at its first trip.
    let mut zero_ns = None;
    loop {
        let complete = captured.trips.len() == expected.len();
        events.wait_at_most(if complete { SETTLED } else { patience })?;
        let happened = match events.answer() {
            Ok(DaemonResponse::Event(happened)) => happened,
            Ok(_) => continue,
            Err(ClientError::Io(e)) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                // If all trips are there, the session is judged as a whole. Otherwise the next trip was
                // missed.
                return Ok((assign(&captured, expected, 1.0, origin, window_mm).map_err(no)?, degc));
            }
            Err(error) => return Err(unreachable(error)),
        };
        let trip = match (happened.kind.as_str(), happened.trip) {
            ("fault", _) => fail!(Fault, "{}", happened.text),
            ("mode", _) if ["disabled", "run", "shadow"].iter().any(|m| happened.text.ends_with(m)) => {
                fail!(No, "probing was switched off by somebody else")
            }
            ("bounce", _) => {
                captured.bounces.push(captured.trips.len() + 1);
                continue;
            }
            (_, Some(trip)) => trip,
            _ => continue,
        };
        let name = happened.axis.as_deref().unwrap_or_default();
        let Some(n) = [&args.z_axis, &args.x_axis].iter().position(|a| *a == name) else { continue };
        let Some((_, first)) = half.take_if(|(other, first)| *other != n && first.at_ns == trip.at_ns) else {
            half = Some((n, trip));
            continue;
        };
        let (z, x) = if n == 0 { (&trip, &first) } else { (&first, &trip) };
        let at_ns = u64::midpoint(trip.at_ns[0], trip.at_ns[1]);
        let after_s = at_ns.saturating_sub(*zero_ns.get_or_insert(at_ns)) as f64 / 1e9;
        let at_um = [z.position_mm * 1e3, x.position_mm * 1e3];
        captured.trips.push((at_um, z.uncertainty_um.hypot(x.uncertainty_um), after_s));
        degc.push(trip.degc);
        // A wrong trip ends the session at once; trips still missing do not.
        match assign(&captured, expected, 1.0, origin, window_mm) {
            Err(ProbeTripFault::Missed { point, .. }) if point == captured.trips.len() + 1 => {}
            judged => drop(judged.map_err(no)?),
        }
        eprintln!("point {} of {}", captured.trips.len(), expected.len());
    }
}

/// Writes the points for `part errors`, and as a run record of the machine.
fn write_session(folder: &Path, csv: String, record: Option<&Record>) -> anyhow::Result<()> {
    let mut files = vec![("probed.csv", csv)];
    if let Some(record) = record {
        files.extend([("probing.csv", to_csv(record)), ("probing.run.toml", to_sidecar(record))]);
    }
    write_all(folder, &files)
}
