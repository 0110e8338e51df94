//! `rtecctl part features`: the features of a drawing, in probing order.

use super::write_all;
use crate::prelude::*;
use rtec_part::contour::{Contour, FeatureKind};
use rtec_part::contour_from_dxf::{self, DxfOptions};
use rtec_part::length_unit::LengthUnit;
use rtec_part::turning_plane_svg::SvgDrawing;

/// The drawing and how to read it
#[derive(Debug, clap::Args)]
pub(crate) struct DrawingArgs {
    /// The part's half profile as DXF: X along the axis, Y ≥ 0 the distance from it
    pub(crate) drawing: PathBuf,
    #[command(flatten)]
    pub(crate) how: DxfOptions,
}

/// Reads a drawing, and reports what is unusual in it.
pub(crate) fn read(drawing: &Path, how: &DxfOptions) -> anyhow::Result<(Contour, LengthUnit)> {
    let read = contour_from_dxf::read(drawing, how)?;
    if let (Some(asked), Some(header)) = (how.unit, contour_from_dxf::header_unit(drawing)?)
        && asked != header
    {
        let (LengthUnit(asked), LengthUnit(header), file) = (asked, header, drawing.display());
        let says = format!("its header ($INSUNITS) says 1 unit = {header} mm, --units says {asked} mm");
        eprintln!("warning: {file}: {says}: --units is taken");
    }
    for cleaned in &read.0.cleaned {
        eprintln!("note: {cleaned}");
    }
    Ok(read)
}

/// List the features of a drawing in probing order
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    drawing: DrawingArgs,
    /// Write features.svg into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn write_drawn(folder: &Path, contour: &Contour) -> anyhow::Result<()> {
    let mut svg = SvgDrawing::default();
    contour.draw(&mut svg, true);
    let drawn = svg.finish("Features", &[("outline", "the part"), ("axis", "the part's axis")]);
    write_all(folder, &[("features.svg", drawn)])
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let (contour, unit) = read(&args.drawing.drawing, &args.drawing.how)?;
    if let Some(folder) = &args.out {
        write_drawn(folder, &contour)?;
    }
    let features = contour.features.iter().map(|f| {
        let (a, b) = (f.segment.at(0.0), f.segment.at(1.0));
        json!({"name": f.name, "feature": f.kind, "start_mm": [a.z, a.x], "end_mm": [b.z, b.x],
               "length_mm": f.segment.length_mm(), "entity": f.entity})
    });
    let document =
        json!({"unit_mm": unit.0, "closed": contour.closed, "features": features.collect::<Vec<_>>()});
    answer(args.json, &document, || text(&contour, unit))
}

fn text(contour: &Contour, unit: LengthUnit) -> String {
    let mut t = format!("{} features, 1 drawing unit = {} mm\n", contour.features.len(), unit.0);
    for f in &contour.features {
        let what = match f.kind {
            FeatureKind::Cylinder { radius_mm } => format!("cylinder   radius {radius_mm:.4} mm"),
            FeatureKind::Step { z_mm } => format!("step       at Z {z_mm:.4} mm"),
            FeatureKind::Taper { angle_deg } => format!("taper      {angle_deg:.4}°"),
            FeatureKind::Arc { centre_z_mm, centre_x_mm, radius_mm } => {
                format!("arc        radius {radius_mm:.4} mm about Z {centre_z_mm:.4} X {centre_x_mm:.4}")
            }
            FeatureKind::Conic => "conic".to_owned(),
        };
        let _ = writeln!(t, "{:<4} {what:<52} {:>10.4} mm long  {}", f.name, f.segment.length_mm(), f.entity);
    }
    t
}
