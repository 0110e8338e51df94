//! Straightness of an axis's motion.
//! The error across it, less a least-squares line over the travel (ISO 230-1:2012; its text was not
//! available).

use super::{MeasuredPosition, lacks, line, mean_of, spread};
use crate::plot::{Chart, Colour};
use rtec_files::Result;
use rtec_model::record::{Axis, Record, Role};
use serde::Serialize;

/// One place of a straightness run, µm about the reference line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StraightnessPoint {
    /// Position along the axis that moves, mm.
    pub position_mm: f64,
    /// Mean deviation moving upwards; of all rows if no direction is logged.
    pub up_um: Option<f64>,
    /// Mean deviation moving downwards.
    pub down_um: Option<f64>,
    /// Mean of both sides.
    pub mean_um: f64,
    /// Readings taken there.
    pub readings: usize,
}

/// Straightness of one axis's motion in the direction of another.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StraightnessResult {
    /// The axis that moves.
    pub axis: String,
    /// The direction of the error.
    pub across: String,
    /// Symbol after ISO 230-1: `EYX` is the error in Y while X moves.
    pub symbol: String,
    /// Straightness: largest minus smallest mean deviation from the line, µm.
    pub straightness_um: f64,
    /// The same for rows moving upwards, about their own line.
    pub straightness_up_um: Option<f64>,
    /// The same downwards.
    pub straightness_down_um: Option<f64>,
    /// Slope of the line, µrad: of straightedge and axis together.
    /// It is squareness only if the straightedge was squared.
    pub slope_urad: f64,
    /// Standard error of that slope, if residuals are random, µrad.
    pub slope_standard_error_urad: f64,
    /// Mean of up minus down, µm.
    pub reversal_um: Option<f64>,
    /// Largest range of readings at one place from one side, µm.
    pub repeatability_um: Option<f64>,
    /// Distance from the first to the last place, mm.
    pub travel_mm: f64,
    /// The places, in order.
    pub places: Vec<StraightnessPoint>,
    /// Warnings about its use.
    pub warnings: Vec<String>,
}

/// Fewest places of a straightness.
const FEWEST_PLACES: usize = 5;

/// Pairs of the axis that moves and an error across it.
fn pairs(record: &Record) -> Vec<(Axis, Axis)> {
    let moves = |a: &Axis| record.position(a).and_then(spread).is_some_and(|r| r > 0.0);
    let positions: Vec<&Axis> = record.axes(Role::Position).filter(|a| moves(a)).collect();
    // If several axes move, an error across one of them has no single cause.
    let [axis] = positions[..] else { return Vec::new() };
    let across = record.columns.iter().filter_map(|c| match &c.role {
        Role::Error(b) if b != axis => Some((axis.clone(), b.clone())),
        _ => None,
    });
    across.collect()
}

/// Whether a record holds an error across the one axis that moves.
pub fn has_straightness(record: &Record) -> bool {
    !pairs(record).is_empty()
}

/// Straightness of every error across the axis that moves.
///
/// # Errors
/// No error across a moving axis; fewer than five places.
pub fn straightness(record: &Record) -> Result<Vec<StraightnessResult>> {
    let pairs = pairs(record);
    if pairs.is_empty() {
        let expected = "one moving position.AXIS and the error across it, as position.x with error.y";
        return Err(lacks(record, "no error across an axis that moves", expected));
    }
    pairs.iter().map(|(axis, across)| of(record, axis, across)).collect()
}

/// Residuals from the points' line and its slope per mm; `None` for too few.
fn off_line(points: &[(f64, f64)]) -> Option<(Vec<f64>, f64)> {
    let (p, e): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
    let (offset, slope, _) = (points.len() >= FEWEST_PLACES).then(|| line(&p, &e))??;
    Some((points.iter().map(|(p, e)| e - offset - slope * p).collect(), slope))
}

/// Standard error of the slope of places with these residuals, µm/mm.
fn slope_error(off: &[StraightnessPoint]) -> f64 {
    let n = off.len() as f64;
    let middle = off.iter().map(|p| p.position_mm).sum::<f64>() / n;
    let square: f64 = off.iter().map(|p| (p.position_mm - middle).powi(2)).sum();
    let left: f64 = off.iter().map(|p| p.mean_um.powi(2)).sum();
    (left / (n - 2.0) / square).sqrt()
}

fn of(record: &Record, axis: &Axis, across: &Axis) -> Result<StraightnessResult> {
    let position = record.position(axis).unwrap_or_default();
    let error = record.data(&Role::Error(across.clone())).unwrap_or_default();
    let direction = record.direction_or_velocity(axis);
    let mut places = Vec::new();
    let mut spreads: Vec<f64> = Vec::new();
    for MeasuredPosition { position_mm, up, down } in super::places(position, direction, error) {
        spreads.extend([&up, &down].into_iter().filter(|v| v.len() > 1).filter_map(spread));
        let (up_um, down_um) = (mean_of(&up), mean_of(&down));
        let Some(mean_um) = up_um.zip(down_um).map(|(u, d)| f64::midpoint(u, d)).or(up_um).or(down_um) else {
            continue;
        };
        places.push(StraightnessPoint {
            position_mm,
            up_um,
            down_um,
            mean_um,
            readings: up.len() + down.len(),
        });
    }
    let side = |of: fn(&StraightnessPoint) -> Option<f64>| -> Vec<(f64, f64)> {
        places.iter().filter_map(|p| Some((p.position_mm, of(p)?))).collect()
    };
    let Some((off, slope)) = off_line(&side(|p| Some(p.mean_um))) else {
        let found = format!("{} places along {axis}", places.len());
        let expected = "five places at least: through fewer a line goes whatever the axis does";
        return Err(lacks(record, &found, expected));
    };
    let one_side = |of| off_line(&side(of)).and_then(|(off, _)| spread(&off));
    let (straightness_up_um, straightness_down_um) = (one_side(|p| p.up_um), one_side(|p| p.down_um));
    let travel_mm = places[places.len() - 1].position_mm - places[0].position_mm;
    let reversals: Vec<f64> = places.iter().filter_map(|p| Some(p.up_um? - p.down_um?)).collect();
    let one_sided = places.iter().filter(|p| p.up_um.is_none() || p.down_um.is_none()).count();
    let mut warnings = vec![
        "the straightedge's own form is in it: a run with the straightedge turned over takes it out, the mean of both".to_owned(),
    ];
    if one_sided > 0 && one_sided < places.len() {
        // Places from one side only contain half of the reversal as form.
        let why = "half of the reversal is in the form there";
        warnings.push(format!("{one_sided} places from one side only: {why}"));
    }
    for (p, off) in places.iter_mut().zip(off) {
        let line_um = p.mean_um - off;
        p.mean_um = off;
        p.up_um = p.up_um.map(|v| v - line_um);
        p.down_um = p.down_um.map(|v| v - line_um);
    }
    Ok(StraightnessResult {
        symbol: format!("E{}{}", across.to_string().to_uppercase(), axis.to_string().to_uppercase()),
        axis: axis.to_string(),
        across: across.to_string(),
        straightness_um: spread(places.iter().map(|p| p.mean_um)).unwrap_or(0.0),
        straightness_up_um: straightness_up_um.filter(|_| direction.is_some()),
        straightness_down_um,
        slope_urad: slope * 1000.0,
        slope_standard_error_urad: 1000.0 * slope_error(&places),
        reversal_um: mean_of(&reversals),
        repeatability_um: super::largest(spreads),
        travel_mm,
        places,
        warnings,
    })
}

impl StraightnessResult {
    /// Deviations from the line along the travel.
    pub fn chart(&self) -> Chart {
        type PlaceFigure = fn(&StraightnessPoint) -> Option<f64>;
        let title = format!("Straightness {}: {} while {} moves", self.symbol, self.across, self.axis);
        let mut chart =
            Chart::new(&title, &format!("position {} (mm)", self.axis), "deviation from the line (µm)");
        let sides: [(&str, Colour, PlaceFigure); 2] =
            [("up ↑", Colour::Up, |p| p.up_um), ("down ↓", Colour::Down, |p| p.down_um)];
        for (label, colour, of) in sides {
            let points: Vec<(f64, f64)> =
                self.places.iter().filter_map(|p| Some((p.position_mm, of(p)?))).collect();
            chart = chart.with_side(label, points, colour);
        }
        chart
    }
}
