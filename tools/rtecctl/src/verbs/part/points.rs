//! `rtecctl part points`: probing points and the probe's path.

use super::features::{DrawingArgs, read};
use super::probing_plan_page::{ProbingPlanEditor, ProbingPlanPageServer};
use super::{usage, within, write_all};
use crate::prelude::*;
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{Collision, ProbeGeometry, ProbingMotion, ProbingPlan, StylusStem, number_at};
use std::str::FromStr;

/// Choose probing points and write the probe's path
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    drawing: DrawingArgs,
    /// Points on a feature: F1:20 puts 20 points on F1, F1:5mm one at least every 5 mm
    #[arg(long = "feature", value_name = "NAME:POINTS")]
    features: Vec<FeaturePointSelection>,
    /// Points from a CSV `z_mm,x_mm`, each moved to the nearest place of the contour
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,
    /// How far a point of the file may be off the contour, in mm
    #[arg(long, default_value_t = 0.1)]
    off_mm: f64,
    /// Keep this far from the ends of each feature, in mm
    #[arg(long, default_value_t = 0.0)]
    margin_mm: f64,
    /// Radius of the probe's tip, in mm
    #[arg(long)]
    tip_mm: f64,
    #[command(flatten)]
    motion: ProbingMotion,
    /// Distance from the start of a touch to the trip, in mm; by default from feed and acceleration
    #[arg(long)]
    stand_off_mm: Option<f64>,
    /// Distance from the trip to the end of a touch, in mm; by default from feed and deceleration
    #[arg(long)]
    over_travel_mm: Option<f64>,
    /// The stylus behind the tip: length and radius in mm, and where it points to from +Z, in degrees
    #[arg(
        long,
        value_name = "LENGTH,RADIUS,DEG",
        value_delimiter = ',',
        num_args = 1,
        allow_negative_numbers = true
    )]
    stem: Option<Vec<f64>>,
    /// Put by-pass points where the way to the next point meets the part, with this clearance in mm
    #[arg(long, value_name = "CLEARANCE_MM")]
    bypass: Option<f64>,
    /// Open a page on this machine to pick the points in
    #[arg(long)]
    web: bool,
    /// Port of the page; 0 takes a free one
    #[arg(long, default_value_t = 0, requires = "web")]
    port: u16,
    /// Folder for pathfin.cdl, probpath.cdl (in inches of a drawing in inches, else in mm) and points.svg
    #[arg(long)]
    out: PathBuf,
    /// Print one JSON document
    #[arg(long, conflicts_with = "web")]
    json: bool,
}

pub(crate) fn checked(motion: ProbingMotion) -> anyhow::Result<ProbingMotion> {
    positive("--feed-mm-min", motion.feed_mm_min)?;
    positive("--accel-mm-s2", motion.accel_mm_s2)?;
    positive("--decel-mm-s2", motion.decel_mm_s2)?;
    positive("--window-mm", motion.window_mm)?;
    Ok(motion)
}

/// Points closer than this share of the tip's radius show one position.
const SAME_PLACE: f64 = 0.1;

pub(crate) fn positive(name: &str, value: f64) -> anyhow::Result<f64> {
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(usage(name, value.to_string(), "a positive number"))
    }
}

#[derive(Debug, Clone)]
struct FeaturePointSelection {
    feature: String,
    by: PointCountOrSpacing,
}

/// Largest number of points on one feature; more would take days to probe.
const MOST_POINTS: usize = 10_000;

#[derive(Debug, Clone, Copy)]
enum PointCountOrSpacing {
    Number(usize),
    SpacingMm(f64),
}

impl FeaturePointSelection {
    /// Number of points on a stretch of this length.
    fn number(&self, between_mm: f64) -> anyhow::Result<usize> {
        let mm = match self.by {
            PointCountOrSpacing::Number(n) => return Ok(n),
            PointCountOrSpacing::SpacingMm(mm) => mm,
        };
        let points = between_mm / mm;
        if points > MOST_POINTS as f64 {
            let found = format!("{}:{mm}mm, {points:.0} points on {between_mm:.4} mm", self.feature);
            let least_mm = between_mm / MOST_POINTS as f64;
            let expected = format!("at most {MOST_POINTS} points, {least_mm:.4} mm apart or more");
            return Err(usage("--feature", found, expected));
        }
        Ok(number_at(between_mm, mm))
    }
}

impl FromStr for FeaturePointSelection {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "NAME:NUMBER or NAME:SPACINGmm, as F1:20 or F1:5mm";
        let (feature, points) = text.split_once(':').ok_or(expected)?;
        let by = if let Some(mm) = points.strip_suffix("mm") {
            let mm = mm.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0);
            PointCountOrSpacing::SpacingMm(mm.ok_or(expected)?)
        } else {
            let is_whole = !points.is_empty() && points.bytes().all(|byte| byte.is_ascii_digit());
            // A number too large for an integer is still a number.
            let number = points.parse().ok().or_else(|| is_whole.then_some(usize::MAX)).ok_or(expected)?;
            if !(1..=MOST_POINTS).contains(&number) {
                let asks = format!("{feature}:{points} asks for {points} points");
                return Err(format!("{asks}; 1 to {MOST_POINTS} are expected"));
            }
            PointCountOrSpacing::Number(number)
        };
        Ok(Self { feature: feature.to_owned(), by })
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (contour, drawn) = read(&args.drawing.drawing, &args.drawing.how)?;
    // A path file does not state its unit, and the steps that read it know mm and inch only.
    let unit = if drawn == LengthUnit::INCH { drawn } else { LengthUnit::MM };
    if unit == LengthUnit::INCH {
        eprintln!(
            "rtecctl: pathfin.cdl and probpath.cdl are in inches, as the drawing: the steps that read them want --path-units inch"
        );
    }
    let motion = checked(args.motion)?;
    let stem = match args.stem.as_deref() {
        None => None,
        Some(&[length_mm, radius_mm, deg]) if length_mm > 0.0 && radius_mm > 0.0 && deg.is_finite() => {
            Some(StylusStem { length_mm, radius_mm, angle_rad: deg.to_radians() })
        }
        Some(other) => {
            let found = other.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
            return Err(usage("--stem", found, "LENGTH,RADIUS,DEG, the first two above 0, as 60,2,90"));
        }
    };
    within("--margin-mm", args.margin_mm, 0.0..=f64::MAX, "a length in mm, 0 or more")?;
    positive("--off-mm", args.off_mm)?;
    args.bypass.map(|clear_mm| positive("--bypass", clear_mm)).transpose()?;
    let probe = ProbeGeometry {
        tip_mm: positive("--tip-mm", args.tip_mm)?,
        stand_off_mm: positive("--stand-off-mm", args.stand_off_mm.unwrap_or(motion.stand_off_mm()))?,
        over_travel_mm: positive("--over-travel-mm", args.over_travel_mm.unwrap_or(motion.over_travel_mm()))?,
        stem,
    };
    let mut plan = ProbingPlan::new(probe);
    let twice =
        |(k, c): &(usize, &FeaturePointSelection)| args.features[..*k].iter().any(|o| o.feature == c.feature);
    if let Some((_, choice)) = args.features.iter().enumerate().find(twice) {
        return Err(usage("--feature", format!("{} twice", choice.feature), "each feature once"));
    }
    for choice in &args.features {
        let feature = contour.features.iter().position(|f| f.name == choice.feature).ok_or_else(|| {
            let names = list(contour.features.iter().map(|f| &f.name));
            usage("--feature", choice.feature.clone(), format!("one of {names}"))
        })?;
        let length_mm = contour.features[feature].segment.length_mm();
        if 2.0 * args.margin_mm >= length_mm {
            let found = format!("{} at each end of {}", args.margin_mm, choice.feature);
            let expected = format!("less than half of its {length_mm:.4} mm, below {:.4}", length_mm / 2.0);
            return Err(usage("--margin-mm", found, expected));
        }
        let number = choice.number(length_mm - 2.0 * args.margin_mm)?;
        let apart_mm = (length_mm - 2.0 * args.margin_mm) / (number.max(2) - 1) as f64;
        if number > 1 && apart_mm < SAME_PLACE * args.tip_mm {
            eprintln!(
                "warning: the points of {} are {apart_mm:.3} mm apart, which a tip of {} mm does not tell apart: look at --margin-mm",
                choice.feature, args.tip_mm
            );
        }
        plan.add_number(&contour, feature, number, args.margin_mm);
    }
    if let Some(file) = &args.points {
        plan.add_file(&contour, file, args.off_mm)?;
    }
    if let Some(clear_mm) = args.bypass {
        plan.add_bypasses(&contour, clear_mm);
    }
    if args.web {
        let page = ProbingPlanPageServer::listen(args.port)?;
        eprintln!("open {} and say Done there when you are", page.url());
        let clear_mm = args.bypass.unwrap_or(2.0);
        let session = ProbingPlanEditor { contour, plan, unit, folder: args.out.clone(), clear_mm };
        return Ok(page.serve(session)?);
    }
    if plan.points.is_empty() {
        return Err(usage("--feature", "no point", "--feature, --points or --web"));
    }
    write_all(&args.out, &plan.files(&contour, unit))?;
    let hits = plan.hits(&contour);
    let expected: Vec<[f64; 2]> = plan.expected().iter().map(|p| [p.z, p.x]).collect();
    let document = serde_json::json!({"points": plan.points.len(), "stand_off_mm": probe.stand_off_mm,
        "over_travel_mm": probe.over_travel_mm, "path": plan.records(), "expected_mm": expected, "hits": hits});
    answer(args.json, &document, || text(&plan, &hits))?;
    let n = hits.len();
    ensure!(n == 0, No, "{n} collisions: add --bypass, a margin or a shorter stand-off");
    Ok(())
}

fn text(plan: &ProbingPlan, hits: &[Collision]) -> String {
    let (points, ProbeGeometry { stand_off_mm, over_travel_mm, .. }) = (plan.points.len(), &plan.probe);
    let mut t =
        format!("{points} points, stand-off {stand_off_mm:.3} mm, over-travel {over_travel_mm:.3} mm\n");
    for Collision { by, feature, point, at: Zx { z, x }, touching, .. } in hits {
        let when = if *touching { "in the touch of" } else { "on the way to" };
        let _ = writeln!(
            t,
            "COLLISION: the {by} meets {feature} {when} point {point}, tip at Z {z:.3} X {x:.3} mm"
        );
    }
    t
}
