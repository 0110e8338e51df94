//! `rtecctl part probe`: run a probing path on the simulated machine, positions captured by the engine.

use super::bench::{BenchArgs, read_workpiece};
use super::features::Units;
use super::points::positive;
use super::{failed, print, usage, write_all};
use rtec_model::record::Record;
use rtec_part::path::{Role, read_expected, read_pathfin};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Probe a part on the simulated machine
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The workpiece, as `part finish` writes it
    #[arg(long)]
    workpiece: PathBuf,
    /// The probe's path
    #[arg(long)]
    path: PathBuf,
    /// The expected trips
    #[arg(long)]
    expected: PathBuf,
    /// Unit of both files
    #[arg(long, value_enum, default_value_t = Units::Mm)]
    path_units: Units,
    #[command(flatten)]
    bench: BenchArgs,
    /// Folder for probed.csv and the run record probing.run.toml
    #[arg(long)]
    out: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let setup = args.bench.setup()?;
    let part = read_workpiece(&args.workpiece)?;
    let unit = args.path_units.unit();
    let records = read_pathfin(&args.path, unit)?;
    let expected = read_expected(&args.expected, unit)?;
    let approach: Vec<_> = records
        .windows(2)
        .filter(|w| matches!(w[1].role, Role::Touch(_)))
        .filter_map(|w| (w[1].at - w[0].at).unit())
        .collect();
    if approach.len() != expected.len() {
        let found = format!("{} touches for {} expected trips", approach.len(), expected.len());
        return Err(usage("--expected", found, "the two files of one plan"));
    }
    let feed_mm_min = positive("--feed-mm-min", setup.motion.feed_mm_min)?;
    let session =
        setup.probe_path(&part, &records, &expected, &approach, feed_mm_min, setup.seed).map_err(failed)?;
    write_session(&args.out, &session.csv, session.record.as_ref())?;
    if args.json {
        let document = serde_json::json!({"trips": session.trips, "seconds": session.seconds});
        return print(&(serde_json::to_string_pretty(&document)? + "\n"));
    }
    let mut t = "point       Z mm       X mm  within µm\n".to_owned();
    for trip in &session.trips {
        let p = trip.tip_centre;
        let _ = writeln!(t, "{:>5} {:>10.4} {:>10.4} {:>10.3}", trip.point, p.z, p.x, trip.uncertainty_um);
    }
    let _ = writeln!(t, "{} points in {:.1} s", session.trips.len(), session.seconds);
    print(&t)
}

/// The points as `part errors` reads them, and the same as a run record of the machine.
fn write_session(folder: &Path, csv: &str, record: Option<&Record>) -> anyhow::Result<()> {
    let (rows, sidecar) = record.map(|r| (r.to_csv(), r.to_sidecar())).unzip();
    let mut files = vec![("probed.csv", csv.as_bytes())];
    if let (Some(rows), Some(sidecar)) = (&rows, &sidecar) {
        files.extend([("probing.csv", rows.as_bytes()), ("probing.run.toml", sidecar.as_bytes())]);
    }
    write_all(folder, &files)
}
