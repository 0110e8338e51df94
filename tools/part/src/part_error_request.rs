//! A feature's errors from probed points as users give them.
//! It checks the request, reports what is left out, and refuses implausible numbers.

use crate::geometric_fit::{self, FitShape, FittedShape, Zx};
use crate::length_unit::LengthUnit;
use crate::part_errors::{NominalShape, PartErrorReport, ProbedPoints};
use crate::probe_path::{approaches, read_expected, read_pathfin};
#[cfg(feature = "clap")]
use rtec_files::cli_option_parsers::one_of;
use rtec_files::{InputError, InputNotice};
use rtec_model::effect::{Effect, RequiredInput};
use rtec_model::machine::Machine;
use std::path::{Path, PathBuf};

/// Where messages for people go.
pub type Sink<'s> = &'s mut dyn FnMut(InputNotice);

rtec_files::choice! {
    /// The kind of feature that was probed.
    pub enum ProbedFeatureKind {
        Circle = "circle", "A sphere or a fillet";
        Line = "line", "A cylinder, a face or a taper";
    }
}

// The documentation of the fields is the help of `rtecctl part errors`.
/// The request for a feature's errors
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct PartErrorRequest {
    /// Probed points: a CSV `z_mm,x_mm[,approach_z,approach_x]`, the tip's centre at each trip
    #[cfg_attr(feature = "clap", arg(long))]
    pub points: PathBuf,
    /// Columns of the file that have other names, or none, each by its name or number from 1; all others are left out
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME=COLUMN", value_delimiter = ','))]
    pub columns: Vec<String>,
    /// Nominal radius of the circle, in mm; a straight feature has none
    #[cfg_attr(feature = "clap", arg(long))]
    pub radius_mm: Option<f64>,
    /// Radius of the probe's tip, in mm; 0 where the points already are on the surface [default: 0, and it is said]
    #[cfg_attr(feature = "clap", arg(long))]
    pub tip_mm: Option<f64>,
    /// What was probed [default: recognised from the points]
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&ProbedFeatureKind::ALL, &[])))]
    pub feature: Option<ProbedFeatureKind>,
    /// Nominal inclination of a taper to the part's axis, in degrees: the difference is shown, error.cor does not take it out
    #[cfg_attr(feature = "clap", arg(long))]
    pub taper_deg: Option<f64>,
    /// Take out what this machine's model predicts at each point; the temperatures are the record's columns T0, T1, …
    #[cfg_attr(feature = "clap", arg(long))]
    pub machine: Option<PathBuf>,
    /// Machine position at the part's zero, in mm, for the model
    #[cfg_attr(feature = "clap", arg(long, value_name = "Z,X", value_delimiter = ',', num_args = 1))]
    pub origin_mm: Option<Vec<f64>>,
    /// The expected trips: every point must be near its own
    #[cfg_attr(feature = "clap", arg(long, value_name = "PROBPATH.CDL"))]
    pub expected: Option<PathBuf>,
    /// The probe's path, where the points have no approach: from which side each was touched
    #[cfg_attr(feature = "clap", arg(long, value_name = "PATHFIN.CDL"))]
    pub path: Option<PathBuf>,
    /// Unit of the expected trips and of the path
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&LengthUnit::ALL, &[]), default_value = "mm"))]
    pub path_units: LengthUnit,
    /// How near a trip must be to its expected place, in mm
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 1.0))]
    pub trip_window_mm: f64,
    /// Put the constant error (size) into error.cor too; without it the table takes out the form alone
    #[cfg_attr(feature = "clap", arg(long))]
    pub with_size: bool,
}

fn usage(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> InputError {
    InputError::whole(Path::new(argument), found, expected)
}

/// Ratio to the nominal radius above which a circle is another one.
const OTHER_SIZE: f64 = 1.3;
/// Largest error of size; a larger one shows a wrong radius or tip.
const NO_SIZE_ERROR_UM: f64 = 500.0;
/// Largest error of a taper; a larger one shows another taper.
const OTHER_TAPER_DEG: f64 = 1.0;
/// Errors of this size are not those of a finish cut, µm.
const FALSE_TRIP_UM: f64 = 200.0;

/// The nominal feature, as requested or as recognised from the points.
fn nominal(
    args: &PartErrorRequest,
    probed: &ProbedPoints,
    say: Sink<'_>,
) -> Result<NominalShape, InputError> {
    let straight = match args.feature {
        Some(feature) => feature == ProbedFeatureKind::Line,
        None => probed.is_straight(args.radius_mm.is_some())?,
    };
    match (straight, args.radius_mm) {
        (true, Some(radius_mm)) if args.feature.is_none() => {
            let found = "points on a straight line";
            let expected = format!(
                "an arc of {radius_mm} mm; a cylinder, face or taper is --feature line and has no --radius-mm"
            );
            Err(InputError::whole(&args.points, found, expected))
        }
        (true, _) => {
            if args.feature.is_none() {
                let taken = "the points lie on a straight line: taken as a cylinder, face or taper";
                say(InputNotice::Note(taken.to_owned()));
            }
            Ok(NominalShape::Line { taper_deg: args.taper_deg })
        }
        (false, Some(radius_mm)) if radius_mm.is_finite() && radius_mm > 0.0 => {
            Ok(NominalShape::Circle { radius_mm })
        }
        (false, _) => {
            let expected = "the arc's nominal radius in mm; or --feature line";
            Err(usage("--radius-mm", "no positive radius", expected))
        }
    }
}

/// Reads the points, the side of each touch and the expected places.
/// It subtracts the prediction of the machine's model.
fn read(args: &PartErrorRequest, say: Sink<'_>) -> Result<(ProbedPoints, Option<Vec<Zx>>), InputError> {
    let mut probed = ProbedPoints::read_columns(&args.points, &args.columns)?;
    if let Some(written) = probed.written() {
        say(InputNotice::Note(written));
    }
    if let Some(file) = &args.path {
        let path = read_pathfin(file, args.path_units)?;
        probed.touched_by(&approaches(&path))?;
        probed.met_on(&path)?;
    }
    let mut places = None;
    if let Some(file) = &args.expected {
        let expected = read_expected(file, args.path_units)?;
        if !(args.trip_window_mm.is_finite() && args.trip_window_mm > 0.0) {
            return Err(usage("--trip-window-mm", args.trip_window_mm.to_string(), "a positive number"));
        }
        probed.check_expected(&expected, args.trip_window_mm)?;
        places = Some(expected);
    }
    if let Some(file) = &args.machine {
        let machine = Machine::read(file)?;
        let origin = match args.origin_mm.as_deref() {
            Some(&[z, x]) if z.is_finite() && x.is_finite() => Zx::new(z, x),
            Some(other) => {
                let found = other.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
                return Err(usage("--origin-mm", found, "Z,X: two numbers in mm, as 300,100"));
            }
            None => {
                let needs_place = |n: &RequiredInput| matches!(n, RequiredInput::Position(_));
                let placed = |e: &&Effect| e.description().needs.iter().any(needs_place);
                if let Some(effect) = machine.effects().find(placed) {
                    say(InputNotice::Warning(format!(
                        "no --origin-mm: the part's zero is taken as the machine's zero, and {} reads the machine's position",
                        effect.name()
                    )));
                }
                Zx::new(0.0, 0.0)
            }
        };
        let blind = probed.read_blind(&machine);
        if !blind.is_empty() {
            say(InputNotice::Warning(format!(
                "{} of the model: the points do not record what is read (approach_z,approach_x or --path for a direction, t_s \
                 for the time, no column for others); it counts as none, of the time as the row's number",
                blind.join(", ")
            )));
        }
        for beyond in probed.beyond_stated(&machine, origin) {
            say(InputNotice::Warning(format!(
                "{beyond}; is --origin-mm Z,X, the machine's position at the part's zero?"
            )));
        }
        probed.correct_geometric_thermal(&machine, origin)?;
    }
    Ok((probed, places))
}

/// Reports places that were touched several times, and points that may be false.
fn say_touches(args: &PartErrorRequest, probed: &ProbedPoints, report: &PartErrorReport, say: Sink<'_>) {
    if let Some(repeats) = &report.repeats {
        let between = match repeats.sd_between_um {
            Some(um) => {
                format!("the places by {um:.2} µm about the fit: the standard errors are of the places")
            }
            None => "too few places for a standard error".to_owned(),
        };
        say(InputNotice::Note(format!(
            "{} points are touches of {} places: touches of one place scatter by {:.2} µm, {between}",
            report.points, repeats.places, repeats.sd_within_um
        )));
    }
    if let Some(row) = probed.at_zero() {
        say(InputNotice::Warning(format!(
            "{}:{row}: a point at exactly Z 0 X 0: was no position captured there? Then take its row out",
            args.points.display()
        )));
    }
}

/// Range of a circle's size relative to nominal.
const ONE_SIZE: std::ops::RangeInclusive<f64> = 0.9..=1.1;
/// Ratio of deviations above which half of X gives the better circle.
const NEARER: f64 = 20.0;

/// The radius of the circle through the points with half of their X.
/// It is returned if the points as given are on no circle, because a lathe shows diameters.
fn radius_if_x_is_diameter(points: &[Zx]) -> Option<f64> {
    let halved: Vec<Zx> = points.iter().map(|p| Zx::new(p.z, 0.5 * p.x)).collect();
    let fit = |points: &[Zx]| geometric_fit::two_step(FitShape::Circle, points).ok();
    let by_half = fit(&halved)?;
    let FittedShape::Circle { radius_mm, .. } = by_half.plain else { return None };
    // Three points are on a circle either way.
    let is_nearer = fit(points).is_none_or(|whole| whole.sd_before_um > NEARER * by_half.sd_before_um);
    (points.len() > FitShape::Circle.parameters() + 1 && is_nearer).then_some(radius_mm)
}

/// Refuses points of a circle whose X is a diameter.
fn refuse_diameters(args: &PartErrorRequest, points: &[Zx]) -> Result<(), InputError> {
    if let Some(nominal) = args.radius_mm
        && let Some(radius) = radius_if_x_is_diameter(points).filter(|r| ONE_SIZE.contains(&(r / nominal)))
    {
        let found = format!(
            "points that lie on a circle of {radius:.3} mm by half of their X, and on none as they are"
        );
        return Err(InputError::whole(&args.points, found, "X as a radius: these look like diameters"));
    }
    Ok(())
}

/// Whether a ratio is close to `times`, as for a diameter and its radius.
pub(crate) fn is_times(ratio: f64, times: f64) -> bool {
    (ratio / times - 1.0).abs() < 0.02
}

/// Possible meaning of a circle of twice or half its nominal size.
fn double_hint(nominal_to_found: f64) -> &'static str {
    match () {
        () if is_times(nominal_to_found, 2.0) => "; twice that is its diameter",
        () if is_times(nominal_to_found, 0.5) => "; half of that: are the points, or the radius, diameters?",
        () => "",
    }
}

/// The errors of the feature that was probed.
/// Messages go to `say`.
///
/// # Errors
/// A file that cannot be read, an implausible number, points that do not determine the feature.
pub fn determine(args: &PartErrorRequest, say: Sink<'_>) -> Result<PartErrorReport, InputError> {
    if let Some(taper) = args.taper_deg.filter(|t| !(t.is_finite() && t.abs() < 90.0)) {
        return Err(usage("--taper-deg", format!("{taper}"), "an angle in degrees, below 90"));
    }
    let tip_mm = args.tip_mm.unwrap_or(0.0);
    if !(0.0..=1000.0).contains(&tip_mm) {
        return Err(usage("--tip-mm", format!("{tip_mm}"), "a radius in mm, 0 or more"));
    }
    if args.radius_mm.is_some_and(|r| !(r.is_finite() && r > 0.0)) {
        return Err(usage("--radius-mm", "no positive radius", "the arc's nominal radius in mm"));
    }
    let (probed, places) = read(args, say)?;
    refuse_diameters(args, &probed.tip_centre)?;
    let mut report = probed.errors(nominal(args, &probed, say)?, tip_mm)?;
    if let Some(step) = report.step_um {
        say(InputNotice::Warning(format!(
            "the points are written in steps of {} µm, more than they scatter by: what rounding may do is in the standard errors",
            rtec_files::text_file::short(1e-6 * (1e6 * step).round())
        )));
    }
    say_touches(args, &probed, &report, say);
    if report.hollow {
        say(InputNotice::Note("touched from inside, a hollow arc: a positive error is too little material; part table wants --hollow".to_owned()));
    }
    if let Some((off, hint)) = taper_slip(args, &report) {
        say(InputNotice::Warning(format!("{off:+.3}° from --taper-deg{hint}")));
    }
    if report.feature == "line" && probed.approach.is_none() {
        say(InputNotice::Note("no approach_z,approach_x and no --path: taken as touched from outside, away from the part's axis; a bore's \
             errors would come out with the other sign".to_owned()));
    }
    if args.tip_mm.is_none() {
        say(InputNotice::Note("no --tip-mm: the points are taken as on the part's surface; if they are the centres of a probe's tip, \
             the radius (a straight feature's place) is off by the tip's; the form is not".to_owned()));
    }
    if let (Some(nominal), Some(radius)) = (args.radius_mm, report.radius_mm)
        && !(1.0 / OTHER_SIZE..=OTHER_SIZE).contains(&(radius / nominal))
    {
        let found = format!("a circle of {radius:.3} mm through the points");
        let hint = double_hint(nominal / radius);
        let expected = format!(
            "one near {nominal} mm, the radius in mm{hint}; points of a straight feature are --feature line"
        );
        return Err(InputError::whole(&args.points, found, expected));
    }
    if let (None, Some(expected)) = (report.size_error_um, &places) {
        report.size_error_um = probed.outside_um(&report, expected);
    }
    if args.with_size && report.size_error_um.is_none() {
        let expected = "--expected PROBPATH.CDL beside it: without places to compare with, a straight feature has no size";
        return Err(usage("--with-size", "a straight feature", expected));
    }
    let farthest =
        report.errors.iter().enumerate().max_by(|a, b| a.1.error_um.abs().total_cmp(&b.1.error_um.abs()));
    if let Some((n, e)) = farthest.filter(|(_, e)| e.error_um.abs() > FALSE_TRIP_UM) {
        say(InputNotice::Warning(format!(
            "point {} is {:+.0} µm off the {}, and error.cor takes it as the part's: if it was a false trip, take its row \
             out, or give the expected trips (--expected)",
            n + 1,
            e.error_um,
            report.feature
        )));
    }
    if let Some(off_um) = report.size_error_um.filter(|s| s.abs() > NO_SIZE_ERROR_UM) {
        let tip_um = 1000.0 * tip_mm;
        let like = if tip_mm > 0.0 && (off_um.abs() - tip_um).abs() < 0.02 * tip_um {
            ": as much as --tip-mm; is that the tip's diameter, or are the points on the surface already?"
        } else if tip_mm > 0.0 && (off_um.abs() - tip_um / 2.0).abs() < 0.02 * tip_um {
            ": half of --tip-mm; is that the tip's diameter?"
        } else {
            ": more than a cut part is off; look at --radius-mm and --tip-mm"
        };
        say(InputNotice::Warning(format!("{off_um:+.0} µm from nominal{like}")));
        if args.with_size {
            let expected = "one that a finish cut takes out, within 500 µm";
            return Err(usage("--with-size", format!("a size error of {off_um:+.0} µm"), expected));
        }
    }
    if let Some((own, robust)) = sizes_differ(&report) {
        say(InputNotice::Warning(format!(
            "the size is not certain: {own:+.1} µm by the fit of error.cor, {robust:+.1} µm by the robust fit, which leaves \
             out {} points; a form error over much of the arc pulls the first{}",
            report.robust.down_weighted.len(),
            if args.with_size { ", and it goes into error.cor" } else { "" }
        )));
    }
    Ok(report)
}

/// A taper too far from nominal, and its possible meaning.
fn taper_slip(args: &PartErrorRequest, r: &PartErrorReport) -> Option<(f64, &'static str)> {
    let (asked, found) = args.taper_deg.zip(r.inclination_deg)?;
    let off = r.inclination_error_deg.filter(|off| off.abs() > OTHER_TAPER_DEG)?;
    let is = |meant: f64| ((found - meant + 90.0).rem_euclid(180.0) - 90.0).abs() <= OTHER_TAPER_DEG;
    let hint = if is(-asked) {
        ": as much as the angle of the other sign; positive is X rising with Z"
    } else if is(asked / 2.0) || is(-asked / 2.0) {
        ": half of it is there; is that the cone's whole angle? The taper is to the part's axis"
    } else if is(90.0 - asked) || is(asked - 90.0) {
        ": the rest to 90° is there; the taper is to the part's axis, not to the face"
    } else {
        ": more than a cut part is off; look at --taper-deg and at the order of z_mm and x_mm"
    };
    Some((off, hint))
}

/// The sizes of both fits, if they differ by more than the points scatter.
fn sizes_differ(r: &PartErrorReport) -> Option<(f64, f64)> {
    let both = r.size_error_um.zip(r.robust.size_error_um)?;
    ((both.0 - both.1).abs() > (2.0 * r.robust.scale_um).max(1.0)).then_some(both)
}
