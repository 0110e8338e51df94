//! `rtecctl part errors`: probed points to part errors, `error.cor` and whiskers.

use super::features::Units;
use super::points::positive;
use super::{print, usage, write_all};
use rtec_model::machine::Machine;
use rtec_part::errors::{ErrorReport, Nominal, Probed, error_cor};
use rtec_part::fit::Zx;
use rtec_part::path::read_expected;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Determine a part's form errors from probed points
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Probed points: a CSV `z_mm,x_mm[,approach_z,approach_x]`, the tip's centre at each trip
    #[arg(long)]
    points: PathBuf,
    /// Nominal radius of the circle, in mm
    #[arg(long, required_if_eq("feature", "circle"))]
    radius_mm: Option<f64>,
    /// Radius of the probe's tip, in mm: 0 where the points already are on the surface
    #[arg(long, default_value_t = 0.0)]
    tip_mm: f64,
    /// What was probed
    #[arg(long, value_enum, default_value_t = Feature::Circle)]
    feature: Feature,
    /// Nominal inclination of a taper to the part's axis, in degrees
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
    /// Unit of the expected trips
    #[arg(long, value_enum, default_value_t = Units::Mm)]
    path_units: Units,
    /// How near a trip must be to its expected place, in mm
    #[arg(long, default_value_t = 1.0)]
    trip_window_mm: f64,
    /// Write whisker.svg, whisker.dxf and, of a circle, error.cor into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Feature {
    /// A sphere or a fillet
    Circle,
    /// A cylinder, a face or a taper
    Line,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let nominal = match (args.feature, args.radius_mm) {
        (Feature::Circle, Some(radius_mm)) if radius_mm.is_finite() && radius_mm > 0.0 => {
            Nominal::Circle { radius_mm }
        }
        (Feature::Circle, _) => return Err(usage("--radius-mm", "no positive radius", "a radius in mm")),
        (Feature::Line, _) => Nominal::Line { taper_deg: args.taper_deg },
    };
    if !(args.tip_mm.is_finite() && args.tip_mm >= 0.0) {
        return Err(usage("--tip-mm", format!("{}", args.tip_mm), "a radius in mm, 0 or more"));
    }
    let mut probed = Probed::read(&args.points)?;
    if let Some(file) = &args.expected {
        let expected = read_expected(file, args.path_units.unit())?;
        probed.check_expected(&expected, positive("--trip-window-mm", args.trip_window_mm)?)?;
    }
    if let Some(file) = &args.machine {
        let origin = match args.origin_mm.as_deref() {
            Some(&[z, x]) => Zx::new(z, x),
            _ => Zx::new(0.0, 0.0),
        };
        probed.correct_geometric_thermal(&Machine::read(file)?, origin)?;
    }
    let report = probed.errors(nominal, args.tip_mm)?;
    if let Some(folder) = &args.out {
        let (table, svg, dxf) = (error_cor(&report.errors), report.whisker_svg(), report.whisker_dxf()?);
        let mut files = vec![("whisker.svg", svg.as_bytes()), ("whisker.dxf", dxf.as_slice())];
        if args.feature == Feature::Circle {
            files.push(("error.cor", table.as_bytes()));
        } else {
            eprintln!("rtecctl: no error.cor, which is by angle: a straight feature has only one");
        }
        write_all(folder, &files)?;
    }
    if args.json { print(&(serde_json::to_string_pretty(&report)? + "\n")) } else { print(&text(&report)) }
}

fn text(r: &ErrorReport) -> String {
    let mut t = String::new();
    let [z, x] = r.centre_mm;
    let _ = writeln!(
        t,
        "{} through {} points, {} left out of the second fit",
        r.feature,
        r.points,
        r.rejected.len()
    );
    let _ = writeln!(t, "centre          Z {z:.5} mm  X {x:.5} mm");
    if let (Some(radius), Some(off)) = (r.radius_mm, r.size_error_um) {
        let _ = writeln!(t, "radius          {radius:.5} mm ({off:+.1} µm from nominal)");
    }
    if let Some(deg) = r.inclination_deg {
        let _ = writeln!(t, "inclination     {deg:.5}°");
    }
    if let Some(deg) = r.inclination_error_deg {
        let _ = writeln!(t, "from nominal    {deg:+.5}°");
    }
    let _ = writeln!(
        t,
        "SD              {:.2} µm with all points, {:.2} µm after",
        r.sd_before_um, r.sd_after_um
    );
    let _ = writeln!(t, "form            {:.2} µm, largest minus smallest", r.form_um);
    let [rz, rx] = r.robust.centre_mm;
    let _ = writeln!(t, "robust fit      Z {rz:.5} mm  X {rx:.5} mm, scale {:.2} µm", r.robust.scale_um);
    let _ = writeln!(t, "\n   #  angle rad  error µm  robust µm");
    for (i, e) in r.errors.iter().enumerate() {
        let mark = if r.rejected.contains(&i) { "  left out" } else { "" };
        let _ = writeln!(
            t,
            "{i:>4} {:>10.6} {:>9.2} {:>10.2}{mark}",
            e.angle_rad, e.error_um, r.robust.errors_um[i]
        );
    }
    t
}
