//! `rtecctl part errors`: probed points to part errors, `error.cor` and whiskers.

use super::features::Units;
use super::points::positive;
use super::{print, usage, write_all};
use rtec_model::effect::{Effect, Need};
use rtec_model::machine::Machine;
use rtec_part::errors::{ErrorReport, Nominal, Probed};
use rtec_part::fit::Zx;
use rtec_part::path::{approaches, read_expected, read_pathfin};
use std::fmt::Write as _;
use std::path::PathBuf;

/// Determine a part's form errors from probed points
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Probed points: a CSV `z_mm,x_mm[,approach_z,approach_x]`, the tip's centre at each trip
    #[arg(long)]
    points: PathBuf,
    /// Nominal radius of the circle, in mm; a straight feature has none
    #[arg(long)]
    radius_mm: Option<f64>,
    /// Radius of the probe's tip, in mm; 0 where the points already are on the surface [default: 0, and it is said]
    #[arg(long)]
    tip_mm: Option<f64>,
    /// What was probed [default: recognised from the points]
    #[arg(long, value_enum)]
    feature: Option<Feature>,
    /// Nominal inclination of a taper to the part's axis, in degrees: the difference is shown, error.cor does not take it out
    #[arg(long, allow_negative_numbers = true)]
    taper_deg: Option<f64>,
    /// Take out what this machine's model predicts at each point; the temperatures are the record's columns T0, T1, …
    #[arg(long)]
    machine: Option<PathBuf>,
    /// Machine position at the part's zero, in mm, for the model
    #[arg(long, value_name = "Z,X", value_delimiter = ',', num_args = 1, allow_negative_numbers = true)]
    origin_mm: Option<Vec<f64>>,
    /// The expected trips: every point must be near its own
    #[arg(long, value_name = "PROBPATH.CDL")]
    expected: Option<PathBuf>,
    /// The probe's path, where the points have no approach: from which side each was touched
    #[arg(long, value_name = "PATHFIN.CDL")]
    path: Option<PathBuf>,
    /// Unit of the expected trips and of the path
    #[arg(long, value_enum, default_value_t = Units::Mm)]
    path_units: Units,
    /// How near a trip must be to its expected place, in mm
    #[arg(long, default_value_t = 1.0)]
    trip_window_mm: f64,
    /// Put the constant error (size) into error.cor too; without it the table takes out the form alone
    #[arg(long)]
    with_size: bool,
    /// Write error.cor, whisker.svg and whisker.dxf into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A circle so many times larger or smaller than nominal is another one.
const OTHER_SIZE: f64 = 1.3;
/// A larger error of size is a wrong number, of radius or tip.
const NO_SIZE_ERROR_UM: f64 = 500.0;
/// A taper that is off by more was cut as another one, or asked for as another.
const OTHER_TAPER_DEG: f64 = 1.0;
/// An error of this size is no finish cut's.
const FALSE_TRIP_UM: f64 = 200.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Feature {
    /// A sphere or a fillet
    Circle,
    /// A cylinder, a face or a taper
    Line,
}

/// What was probed, as it was said or as the points have it.
fn nominal(args: &Args, probed: &Probed) -> anyhow::Result<Nominal> {
    let straight = match args.feature {
        Some(feature) => feature == Feature::Line,
        None => probed.is_straight(args.radius_mm.is_some())?,
    };
    match (straight, args.radius_mm) {
        (true, Some(radius_mm)) if args.feature.is_none() => {
            let found = "points on a straight line";
            let expected = format!(
                "an arc of {radius_mm} mm; a cylinder, face or taper is --feature line and has no --radius-mm"
            );
            Err(rtec_files::InputError::whole(&args.points, found, expected).into())
        }
        (true, _) => {
            if args.feature.is_none() {
                eprintln!("rtecctl: the points lie on a straight line: taken as a cylinder, face or taper");
            }
            Ok(Nominal::Line { taper_deg: args.taper_deg })
        }
        (false, Some(radius_mm)) if radius_mm.is_finite() && radius_mm > 0.0 => {
            Ok(Nominal::Circle { radius_mm })
        }
        (false, _) => Err(usage(
            "--radius-mm",
            "no positive radius",
            "the arc's nominal radius in mm; or --feature line",
        )),
    }
}

/// The points, from which side and where they were expected, and without what the machine's model says.
fn read(args: &Args) -> anyhow::Result<(Probed, Option<Vec<Zx>>)> {
    let mut probed = Probed::read(&args.points)?;
    if let Some(file) = &args.path {
        let path = read_pathfin(file, args.path_units.unit())?;
        probed.touched_by(&approaches(&path))?;
        probed.met_on(&path)?;
    }
    let mut places = None;
    if let Some(file) = &args.expected {
        let expected = read_expected(file, args.path_units.unit())?;
        probed.check_expected(&expected, positive("--trip-window-mm", args.trip_window_mm)?)?;
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
                let placed =
                    |e: &&Effect| e.description().needs.iter().any(|n| matches!(n, Need::Position(_)));
                if let Some(effect) = machine.effects().find(placed) {
                    eprintln!(
                        "warning: no --origin-mm: the part's zero is taken as the machine's zero, and {} reads the machine's position",
                        effect.name()
                    );
                }
                Zx::new(0.0, 0.0)
            }
        };
        let blind = probed.read_blind(&machine);
        if !blind.is_empty() {
            eprintln!(
                "warning: {} of the model: the points do not record what is read (approach_z,approach_x or --path for a direction, t_s \
                 for the time, no column for others); it counts as none, of the time as the row's number",
                blind.join(", ")
            );
        }
        for beyond in probed.beyond_stated(&machine, origin) {
            eprintln!("warning: {beyond}; is --origin-mm Z,X, the machine's position at the part's zero?");
        }
        probed.correct_geometric_thermal(&machine, origin)?;
    }
    Ok((probed, places))
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
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
    let (probed, places) = read(args)?;
    let mut report = probed.errors(nominal(args, &probed)?, tip_mm)?;
    if report.hollow {
        eprintln!(
            "rtecctl: touched from inside, a hollow arc: a positive error is too little material; part table wants --hollow"
        );
    }
    if let Some((off, hint)) = taper_slip(args, &report) {
        eprintln!("warning: {off:+.3}° from --taper-deg{hint}");
    }
    if report.feature == "line" && probed.approach.is_none() {
        eprintln!(
            "rtecctl: no approach_z,approach_x and no --path: taken as touched from outside, away from the part's axis; a bore's \
             errors would come out with the other sign"
        );
    }
    if args.tip_mm.is_none() {
        eprintln!(
            "rtecctl: no --tip-mm: the points are taken as on the part's surface; if they are the centres of a probe's tip, \
             the radius (a straight feature's place) is off by the tip's; the form is not"
        );
    }
    if let (Some(nominal), Some(radius)) = (args.radius_mm, report.radius_mm)
        && !(1.0 / OTHER_SIZE..=OTHER_SIZE).contains(&(radius / nominal))
    {
        let found = format!("a circle of {radius:.3} mm through the points");
        let hint =
            if (nominal / radius / 2.0 - 1.0).abs() < 0.02 { "; twice that is its diameter" } else { "" };
        let expected = format!(
            "one near {nominal} mm, the radius in mm{hint}; points of a straight feature are --feature line"
        );
        return Err(rtec_files::InputError::whole(&args.points, found, expected).into());
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
        eprintln!(
            "warning: point {n} is {:+.0} µm off the {}, and error.cor takes it as the part's: if it was a false trip, take its row \
             out, or give the expected trips (--expected)",
            e.error_um, report.feature
        );
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
        eprintln!("warning: {off_um:+.0} µm from nominal{like}");
        if args.with_size {
            return Err(usage(
                "--with-size",
                format!("a size error of {off_um:+.0} µm"),
                "one that a finish cut takes out, within 500 µm",
            ));
        }
    }
    if let Some((own, robust)) = sizes_differ(&report) {
        eprintln!(
            "warning: the size is not certain: {own:+.1} µm by the fit of error.cor, {robust:+.1} µm by the robust fit, which leaves \
             out {} points; a form error over much of the arc pulls the first{}",
            report.robust.down_weighted.len(),
            if args.with_size { ", and it goes into error.cor" } else { "" }
        );
    }
    if let Some(folder) = &args.out {
        let (table, svg, dxf) =
            (report.error_cor(args.with_size), report.whisker_svg(), report.whisker_dxf()?);
        let files = [
            ("error.cor", table.as_bytes()),
            ("whisker.svg", svg.as_bytes()),
            ("whisker.dxf", dxf.as_slice()),
        ];
        write_all(folder, &files)?;
    }
    if args.json {
        print(&(serde_json::to_string_pretty(&report)? + "\n"))
    } else {
        print(&text(&report, args.with_size))
    }
}

/// A taper so far from nominal is another one, and what may have been meant.
fn taper_slip(args: &Args, r: &ErrorReport) -> Option<(f64, &'static str)> {
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

/// The size by both fits, where they differ by more than what the points scatter by.
fn sizes_differ(r: &ErrorReport) -> Option<(f64, f64)> {
    let both = r.size_error_um.zip(r.robust.size_error_um)?;
    ((both.0 - both.1).abs() > (2.0 * r.robust.scale_um).max(1.0)).then_some(both)
}

fn text(r: &ErrorReport, with_size: bool) -> String {
    let mut t = String::new();
    let [z, x] = r.centre_mm;
    let _ = writeln!(
        t,
        "{} through {} points, {} left out of the second fit",
        r.feature,
        r.points,
        r.rejected.len()
    );
    if r.tip_mm == 0.0 {
        let _ = writeln!(t, "tip             0 mm: the points as they stand are taken as the part's surface");
    } else {
        let _ = writeln!(t, "tip             {} mm taken off: the points are its centres", r.tip_mm);
    }
    let _ = writeln!(t, "centre          Z {z:.5} mm  X {x:.5} mm");
    if let (Some(radius), Some(off)) = (r.radius_mm, r.size_error_um) {
        let _ = writeln!(t, "radius          {radius:.5} mm ({off:+.1} µm from nominal)");
    }
    if let Some(off) = r.size_error_um {
        let left = if with_size {
            "in error.cor too: the finish cut takes it out"
        } else {
            "constant, left by error.cor: a tool offset takes it out, or --with-size puts it in"
        };
        let _ = writeln!(t, "size            {off:+.1} µm {left}");
    }
    if let Some(deg) = r.inclination_deg {
        let _ = writeln!(t, "inclination     {deg:.5}°");
    }
    if let Some(deg) = r.inclination_error_deg {
        let _ = writeln!(
            t,
            "from nominal    {deg:+.5}° left by error.cor, which holds the form alone: turn the program's taper by it"
        );
    }
    let _ = writeln!(
        t,
        "SD              {:.2} µm with all points, {:.2} µm after",
        r.sd_before_um, r.sd_after_um
    );
    let _ = writeln!(t, "form            {:.2} µm, largest minus smallest", r.form_um);
    let [rz, rx] = r.robust.centre_mm;
    let size = r.robust.size_error_um.map_or_else(String::new, |s| format!(", size {s:+.1} µm"));
    let _ =
        writeln!(t, "robust fit      Z {rz:.5} mm  X {rx:.5} mm, scale {:.2} µm{size}", r.robust.scale_um);
    let _ = writeln!(t, "\n   #  angle rad  error µm  robust µm");
    for (i, e) in r.errors.iter().enumerate() {
        let mark = if r.rejected.contains(&i) { "  not in the fit" } else { "" };
        let _ = writeln!(
            t,
            "{i:>4} {:>10.6} {:>9.2} {:>10.2}{mark}",
            e.angle_rad, e.error_um, r.robust.errors_um[i]
        );
    }
    t
}
