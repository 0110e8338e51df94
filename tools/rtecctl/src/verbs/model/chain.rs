//! `rtecctl model fit-chain`: fits a chain's polynomials to records, by component.

use super::fit::draw;
use crate::prelude::*;
use crate::uncertainty_rounding::with_bounds;
use crate::verbs::input_notices;
use rtec_fit::kinematic_chain_fit::{self as chain_fit, RecordWithToolPoint};
use rtec_measure::plausible;
use rtec_model::kinematic_chain::KinematicChain;

/// Fit components of a kinematic chain on the records that measure them
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The chain: its joints, and the powers of every component's terms
    #[arg(long, value_name = "chain.toml")]
    chain: PathBuf,
    /// The components that the records measure, as "z slide.dx"; all others stay as they are
    #[arg(long = "component", value_name = "JOINT.COMPONENT", required = true, value_delimiter = ',')]
    components: Vec<String>,
    /// The records; a point other than the chain's tool point behind an @, as r.run.toml@0,0,-350 (mm): the same path at
    /// two points tells a rotation from a displacement
    #[arg(long = "record", value_name = "NAME.run.toml[@x,y,z]", required = true)]
    records: Vec<String>,
    /// The chain to write; comments and order of the first stay
    #[arg(long, value_name = "chain.toml", value_parser = crate::verbs::output())]
    out: PathBuf,
    /// Draw what is left into this SVG file, one per record and response
    #[arg(long, value_name = "FILE.svg", value_parser = crate::verbs::drawing())]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let chain = KinematicChain::read(&args.chain)?;
    let points = args.records.iter().map(|r| point(r)).collect::<Result<Vec<_>, _>>()?;
    let read = |(path, _): &(PathBuf, _)| {
        Ok::<_, InputError>(plausible::only_good(
            rtec_measure::run_record_files::read(path)?,
            &mut input_notices::said,
        ))
    };
    let records = points.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    let run = |(record, (_, tool_mm)): (_, &(PathBuf, _))| RecordWithToolPoint { record, tool_mm: *tool_mm };
    let runs: Vec<RecordWithToolPoint<'_>> = records.iter().zip(&points).map(run).collect();
    let (fitted, report) = chain_fit::fit(&chain, &args.components, &runs)?;
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    chain_fit::write(&args.chain, &fitted, &report, &args.out)?;
    if let Some(path) = &args.plot {
        draw(path, &report.charts(&records))?;
    }
    if args.json {
        return say_pretty(&report);
    }
    for t in &report.terms {
        let name = format!("{}.{}", t.joint, t.component);
        let [low, high] = t.interval;
        println!("{name:24} p^{} dT^{} {}", t.p, t.dt, with_bounds(t.value, low, high));
    }
    for (path, response, [before, after]) in &report.rms_um {
        println!("{} {response}: {before:.3} -> {after:.3} µm RMS", path.display());
    }
    Ok(())
}

/// Parses `NAME.run.toml`, optionally with the point that it measured.
fn point(text: &str) -> Result<(PathBuf, Option<[f64; 3]>), InputError> {
    let Some((path, point)) = text.rsplit_once('@').filter(|(_, p)| p.contains(',')) else {
        return Ok((PathBuf::from(text), None));
    };
    let numbers: Option<Vec<f64>> = point.split(',').map(|v| v.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([x, y, z]) if [x, y, z].iter().all(|v| v.is_finite()) => {
            Ok((PathBuf::from(path), Some([*x, *y, *z])))
        }
        _ => Err(InputError::whole(Path::new("--record"), format!("`@{point}`"), "@x,y,z in mm")),
    }
}
