//! `rtecctl part inspect`: before and after in one report.

use super::points::positive;
use super::{usage, within, write_all};
use crate::prelude::*;
use rtec_model::record::span;
use rtec_part::part_errors::{NominalShape, PartErrorReport, ProbedPoints};
use rtec_part::session_comparison_html::{logged, side_by_side};

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
    /// Radius of the probe's tip, in mm [default: 0, and it is said]
    #[arg(long)]
    tip_mm: Option<f64>,
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

/// Largest shift of an arc's centre by a finish cut, mm.
/// Only allowances that differ in Z and X shift it.
const OTHER_PLACE_MM: f64 = 1.0;

/// Relative difference of radius from which an arc is another one.
const OTHER_SIZE: f64 = 0.1;

/// The part of an arc that was probed before but not after, if above a tenth.
fn not_looked_at(before: &PartErrorReport, after: &PartErrorReport) -> Option<String> {
    let ends = |r: &PartErrorReport| span(r.errors.iter().map(|e| e.angle_rad));
    let ([lo, hi], [from, to]) = (ends(before), ends(after));
    let slack = 0.1 * (hi - lo);
    (from > lo + slack || to < hi - slack)
        .then(|| format!("points from {from:.2} to {to:.2} rad, before from {lo:.2} to {hi:.2} rad"))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let tip_mm = args.tip_mm.unwrap_or(0.0);
    let tip_mm = within("--tip-mm", tip_mm, 0.0..=f64::MAX, "a radius in mm, 0 or more")?;
    if args.tip_mm.is_none() {
        eprintln!(
            "rtecctl: no --tip-mm: the points are taken as on the part's surface; a tip's radius would be in the size"
        );
    }
    let read = |file: &Path, name: &str, radius_mm: f64| -> anyhow::Result<PartErrorReport> {
        let radius_mm = positive(name, radius_mm)?;
        Ok(ProbedPoints::read(file)?.errors(NominalShape::Circle { radius_mm }, tip_mm)?)
    };
    let before = read(&args.before, "--before-radius-mm", args.before_radius_mm)?;
    let after = read(&args.after, "--radius-mm", args.radius_mm)?;
    let asked = [
        ("--before", "--before-radius-mm", &args.before, &before, args.before_radius_mm),
        ("--after", "--radius-mm", &args.after, &after, args.radius_mm),
    ];
    let near = |own: f64, radius_mm: f64| (own - radius_mm).abs() <= OTHER_SIZE * radius_mm;
    let is_of = |r: &PartErrorReport, radius_mm: f64| r.radius_mm.is_none_or(|own| near(own, radius_mm));
    for (n, (name, option, file, report, radius_mm)) in asked.iter().enumerate() {
        if !is_of(report, *radius_mm) {
            let other = &asked[1 - n];
            let both = is_of(report, other.4) && is_of(other.3, *radius_mm);
            let exchanged = if both { ": the two files are exchanged" } else { "" };
            let radius = report.radius_mm.unwrap_or_default();
            let found = format!("{}: an arc of {radius:.3} mm{exchanged}", file.display());
            return Err(usage(name, found, format!("the points of the arc of {option} {radius_mm}")));
        }
    }
    if let (true, Some(rest)) = (args.limit_um.is_some(), not_looked_at(&before, &after)) {
        return Err(usage("--after", rest, "points over the whole of what was probed before"));
    }
    let off_mm = (before.centre_mm[0] - after.centre_mm[0]).hypot(before.centre_mm[1] - after.centre_mm[1]);
    // A short arc determines its centre badly, so it does not prove another position.
    let errors = [&before, &after].map(|r| r.centre_standard_error_um.unwrap_or([f64::INFINITY; 2]));
    let known_mm = 2e-3 * errors.iter().flatten().fold(0.0, |sum: f64, um| sum.hypot(*um));
    if off_mm > OTHER_PLACE_MM.max(known_mm) {
        let at = |r: &PartErrorReport| format!("Z {:.3} X {:.3} mm", r.centre_mm[0], r.centre_mm[1]);
        let found = format!("arcs {off_mm:.2} mm apart, about {} and {}", at(&before), at(&after));
        let expected = "the points of the same arc of the same part, in the same clamping";
        return Err(usage("--before and --after", found, expected));
    }
    let largest = |r: &PartErrorReport| r.errors.iter().map(|e| e.error_um.abs()).fold(0.0, f64::max);
    let [(was_um, was_sd_um), (is_um, is_sd_um)] =
        [&before, &after].map(|report| (largest(report), report.sd_before_um));
    let mut decisions =
        vec![format!("largest error {was_um:.2} -> {is_um:.2} µm, SD {was_sd_um:.2} -> {is_sd_um:.2} µm")];
    // A part with the right form but the wrong size is not accepted.
    let size_um = after.size_error_um.unwrap_or(0.0);
    let farthest_um = after.errors.iter().map(|e| (e.error_um + size_um).abs()).fold(0.0, f64::max);
    if let Some(size_um) = after.size_error_um {
        let error =
            after.size_standard_error_um.map_or_else(String::new, |e| format!(" (standard error {e:.2} µm)"));
        decisions.push(format!(
            "size {size_um:+.2} µm{error}; farthest from nominal, size and form together, {farthest_um:.2} µm"
        ));
    }
    // A bump changes the fitted size, and both together may hide it. So the form is judged by itself too.
    let judged_um = farthest_um.max(is_um);
    let limit = args.limit_um.map(|limit_um| (limit_um, judged_um <= limit_um));
    if let Some((limit_um, kept)) = limit {
        let what = if kept { "kept: accepted" } else { "not kept: refused" };
        decisions.push(format!("limit of {limit_um} µm {what}"));
    }
    if let Some(folder) = &args.out {
        let page = side_by_side(&before, &after) + &logged(&decisions);
        let log = decisions.join("\n") + "\n";
        write_all(folder, &[("inspection.html", page), ("decisions.log", log)])?;
    }
    let document = serde_json::json!({"before": before, "after": after, "decisions": decisions});
    answer(args.json, &document, || decisions.join("\n") + "\n")?;
    let Some((limit_um, false)) = limit else { return Ok(()) };
    fail!(No, "{judged_um:.2} µm from nominal, more than {limit_um} µm")
}
