//! `rtecctl part inspect`: before and after in one report.

use super::points::positive;
use super::{print, usage, write_all};
use crate::Outcome;
use rtec_part::errors::{ErrorReport, Nominal, Probed};
use rtec_part::page::inspection_page;
use std::path::{Path, PathBuf};

/// Compare the part before and after the finish cut
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Points probed after the semi-finish cut
    #[arg(long)]
    before: PathBuf,
    /// Points probed after the finish cut
    #[arg(long)]
    after: PathBuf,
    /// Nominal radius of the semi-finish cut, in mm
    #[arg(long)]
    before_radius_mm: f64,
    /// Nominal radius of the finish cut, in mm
    #[arg(long)]
    radius_mm: f64,
    /// Radius of the probe's tip, in mm
    #[arg(long, default_value_t = 0.0)]
    tip_mm: f64,
    /// The largest error that may be left, in µm
    #[arg(long)]
    limit_um: Option<f64>,
    /// Folder for inspection.html and decisions.log
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if !(args.tip_mm.is_finite() && args.tip_mm >= 0.0) {
        return Err(usage("--tip-mm", args.tip_mm.to_string(), "a radius in mm, 0 or more"));
    }
    let read = |file: &Path, name: &str, radius_mm: f64| -> anyhow::Result<ErrorReport> {
        let radius_mm = positive(name, radius_mm)?;
        Ok(Probed::read(file)?.errors(Nominal::Circle { radius_mm }, args.tip_mm)?)
    };
    let before = read(&args.before, "--before-radius-mm", args.before_radius_mm)?;
    let after = read(&args.after, "--radius-mm", args.radius_mm)?;
    let largest = |r: &ErrorReport| r.errors.iter().map(|e| e.error_um.abs()).fold(0.0, f64::max);
    let mut decisions = vec![format!(
        "largest error {:.2} -> {:.2} µm, SD {:.2} -> {:.2} µm",
        largest(&before),
        largest(&after),
        before.sd_before_um,
        after.sd_before_um
    )];
    // A part of the right form and the wrong size is not the part.
    let from_nominal = |r: &ErrorReport| {
        let size_um = r.size_error_um.unwrap_or(0.0);
        r.errors.iter().map(|e| (e.error_um + size_um).abs()).fold(0.0, f64::max)
    };
    if let Some(size_um) = after.size_error_um {
        decisions.push(format!(
            "size {size_um:+.2} µm; farthest from nominal, size and form together, {:.2} µm",
            from_nominal(&after)
        ));
    }
    let limit = args.limit_um.map(|limit_um| (limit_um, from_nominal(&after) <= limit_um));
    if let Some((limit_um, kept)) = limit {
        decisions.push(format!(
            "limit of {limit_um} µm {}",
            if kept { "kept: accepted" } else { "not kept: refused" }
        ));
    }
    if let Some(folder) = &args.out {
        let (page, log) = (inspection_page(&before, &after, &decisions), decisions.join("\n") + "\n");
        write_all(folder, &[("inspection.html", page.as_bytes()), ("decisions.log", log.as_bytes())])?;
    }
    if args.json {
        let document = serde_json::json!({"before": before, "after": after, "decisions": decisions});
        print(&(serde_json::to_string_pretty(&document)? + "\n"))?;
    } else {
        print(&(decisions.join("\n") + "\n"))?;
    }
    match limit {
        Some((limit_um, false)) => {
            Err(Outcome::No(format!("{:.2} µm from nominal, more than {limit_um} µm", from_nominal(&after)))
                .into())
        }
        _ => Ok(()),
    }
}
