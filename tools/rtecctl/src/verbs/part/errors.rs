//! `rtecctl part errors`: probed points to part errors, `error.cor` and whiskers.

use super::{print, usage, write_all};
use rtec_part::errors::{Nominal, Probed, Report, error_cor};
use rtec_part::fit::Zx;
use rtec_part::sheet::Sheet;
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
    /// What the machine was off at each point, by the geometric-thermal model: a CSV `error_z_um,error_x_um`
    #[arg(long)]
    geometric_thermal: Option<PathBuf>,
    /// Write error.cor, whisker.svg and whisker.dxf into this folder
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
    if let Some(file) = &args.geometric_thermal {
        let sheet = Sheet::read(file, &["error_z_um", "error_x_um"], |_| false)?;
        let z = sheet.numbers("error_z_um")?;
        let error_um: Vec<Zx> =
            z.into_iter().zip(sheet.numbers("error_x_um")?).map(|(z, x)| Zx::new(z, x)).collect();
        probed.correct_geometric_thermal(file, &error_um)?;
    }
    let report = probed.errors(nominal, args.tip_mm)?;
    if let Some(folder) = &args.out {
        write_all(
            folder,
            &[
                ("error.cor", error_cor(&report.errors).as_bytes()),
                ("whisker.svg", report.whisker_svg().as_bytes()),
                ("whisker.dxf", &report.whisker_dxf()?),
            ],
        )?;
    }
    if args.json { print(&(serde_json::to_string_pretty(&report)? + "\n")) } else { print(&text(&report)) }
}

fn text(r: &Report) -> String {
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
