//! `rtecctl part errors`: part errors, `error.cor` and whiskers from probed points.

use super::write_all;
use crate::prelude::*;
use crate::verbs::input_notices;
use rtec_part::geometric_fit;
use rtec_part::part_error_request::{self, PartErrorRequest};
use rtec_part::part_errors::PartErrorReport;

/// Determine a part's form errors from probed points
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    request: PartErrorRequest,
    /// Write error.cor, whisker.svg and whisker.dxf into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let with_size = args.request.with_size;
    let report = part_error_request::determine(&args.request, &mut input_notices::said)?;
    if with_size && !report.is_size_known() {
        let size = report.size_error_um.unwrap_or(0.0);
        let within = report.size_within_um().unwrap_or(f64::INFINITY);
        eprintln!(
            "warning: --with-size puts {size:+.1} µm into the table, which is known within ±{within:.1} µm (95 %) only"
        );
    }
    if let Some(folder) = &args.out {
        let table = report.error_cor(with_size);
        let (svg, dxf) = (report.whisker_svg(), report.whisker_dxf());
        write_all(folder, &[("error.cor", table), ("whisker.svg", svg), ("whisker.dxf", dxf)])?;
    }
    answer(args.json, &report, || text(&report, with_size))
}

/// Size error per µm of form error above which it is reported.
const MUCH_FORM: f64 = 5.0;

/// Advice for a size error of this amount.
/// `held`: largest share of it per µm of form error.
fn of_size(r: &PartErrorReport, off_um: f64, held: Option<f64>, with_size: bool) -> String {
    if !r.is_size_known() {
        let within = r.size_within_um().unwrap_or(f64::INFINITY);
        return format!(
            "±{within:.1} µm (95 %) is no size: no offset is advised; probe more of the feature, or more often"
        );
    }
    let advice = if with_size {
        "in error.cor too: the finish cut takes it out"
    } else {
        "constant, left by error.cor: a tool offset takes it out, or --with-size puts it in"
    };
    let Some(held) = held else { return advice.to_owned() };
    let most_um = off_um.abs() / held;
    format!(
        "{advice}; but it may be all form, unless that is below {most_um:.2} µm: probe more of the circle first"
    )
}

fn text(r: &PartErrorReport, with_size: bool) -> String {
    let PartErrorReport {
        feature,
        points,
        tip_mm,
        centre_mm: [z, x],
        sd_before_um,
        sd_after_um,
        form_um,
        ..
    } = r;
    let out = r.rejected.len();
    let mut t = format!("{feature} through {points} points, {out} left out of the second fit\n");
    let _ = if *tip_mm == 0.0 {
        writeln!(t, "tip             0 mm: the points as they stand are taken as the part's surface")
    } else {
        writeln!(t, "tip             {tip_mm} mm taken off: the points are its centres")
    };
    let error = match r.centre_standard_error_um {
        Some([along_z, along_x]) if r.radius_mm.is_some() => {
            format!(" (standard errors {along_z:.1} and {along_x:.1} µm)")
        }
        Some([along_normal, _]) => format!(" (standard error along the normal {along_normal:.1} µm)"),
        None => String::new(),
    };
    let _ = writeln!(t, "centre          Z {z:.5} mm  X {x:.5} mm{error}");
    let size_error =
        r.size_standard_error_um.map_or_else(String::new, |e| format!(", standard error {e:.1} µm"));
    if let (Some(radius), Some(off)) = (r.radius_mm, r.size_error_um) {
        let _ = writeln!(t, "radius          {radius:.5} mm ({off:+.1} µm from nominal{size_error})");
        let all = r.plain_radius_mm.zip(r.plain_size_standard_error_um).filter(|_| !r.rejected.is_empty());
        if let (Some((radius, error)), [z, x]) = (all, r.plain_centre_mm) {
            let error = format!("(standard error {error:.1} µm)");
            let _ = writeln!(t, "of all points   {radius:.5} mm {error} about Z {z:.5} mm  X {x:.5} mm");
        }
    }
    let angles: Vec<f64> = r.errors.iter().map(|e| e.angle_rad).collect();
    let held =
        geometric_fit::form_in_size(&angles).filter(|held| *held > MUCH_FORM && r.size_error_um.is_some());
    if let Some(held) = held {
        let _ = writeln!(
            t,
            "form in size    up to {held:.1} µm for each µm of form in two to four waves a turn: on so short an arc they look like \
             another radius, beyond the standard error"
        );
    }
    if let Some(off) = r.size_error_um {
        let _ = writeln!(t, "size            {off:+.1} µm {}", of_size(r, off, held, with_size));
    }
    if let Some(deg) = r.inclination_deg {
        let error = r.inclination_standard_error_deg.map(|e| format!(" (standard error {e:.5}°)"));
        let _ = writeln!(t, "inclination     {deg:.5}°{}", error.unwrap_or_default());
    }
    if let Some(deg) = r.inclination_error_deg {
        let advice = if r.is_inclination_known() {
            let turn = -deg;
            format!("left by error.cor, which holds the form alone: turn the program's taper by {turn:+.5}°")
        } else {
            let within = r.inclination_within_deg().unwrap_or(f64::INFINITY);
            format!("within ±{within:.5}° (95 %): no turn of the program's taper is advised")
        };
        let _ = writeln!(t, "from nominal    {deg:+.5}° {advice}");
    }
    let _ = writeln!(t, "SD              {sd_before_um:.2} µm with all points, {sd_after_um:.2} µm after");
    let _ = writeln!(t, "form            {form_um:.2} µm, largest minus smallest");
    let ([rz, rx], scale_um) = (r.robust.centre_mm, r.robust.scale_um);
    let size = r.robust.size_error_um.map_or_else(String::new, |s| format!(", size {s:+.1} µm"));
    let _ = writeln!(t, "robust fit      Z {rz:.5} mm  X {rx:.5} mm, scale {scale_um:.2} µm{size}");
    let _ = writeln!(t, "\n   #  angle rad  error µm  robust µm");
    for (i, (e, robust_um)) in r.errors.iter().zip(&r.robust.errors_um).enumerate() {
        let mark = if r.rejected.contains(&i) { "  not in the fit" } else { "" };
        let _ = writeln!(t, "{i:>4} {:>10.6} {:>9.2} {robust_um:>10.2}{mark}", e.angle_rad, e.error_um);
    }
    t
}
