//! Straightness of an axis's motion: the error across it, less a least-squares line over the travel (ISO 230-1:2012; its text was not at hand).

use super::{lacks, range, targets};
use crate::plot::{Chart, Colour, Series, Style};
use rtec_files::InputError;
use rtec_model::record::{Axis, Record, Role};
use serde::Serialize;

/// One place of a straightness run, µm about the reference line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StraightPlace {
    /// Where, mm along the axis that moves.
    pub position_mm: f64,
    /// Mean deviation moving upwards; every row where the run knows no direction.
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
pub struct Straightness {
    /// The axis that moves.
    pub axis: String,
    /// The direction of the error.
    pub across: String,
    /// Symbol after ISO 230-1: `EYX` is the error in Y while X moves.
    pub symbol: String,
    /// Straightness: largest minus smallest mean deviation from the line, µm.
    pub straightness_um: f64,
    /// The same of the rows moving upwards, each about its own line.
    pub straightness_up_um: Option<f64>,
    /// The same downwards.
    pub straightness_down_um: Option<f64>,
    /// Slope of the line, µrad: of straightedge and axis together. It is squareness only where the straightedge was squared.
    pub slope_urad: f64,
    /// Mean of up minus down, µm.
    pub reversal_um: Option<f64>,
    /// Largest range of readings at one place from one side, µm.
    pub repeatability_um: Option<f64>,
    /// From the first place to the last, mm.
    pub travel_mm: f64,
    /// The places, in order.
    pub places: Vec<StraightPlace>,
    /// What to know before using it.
    pub warnings: Vec<String>,
}

/// Fewer places make a line, not a straightness.
const FEWEST_PLACES: usize = 5;

/// Pairs of an axis that moves and the errors across it which a record holds.
fn pairs(record: &Record) -> Vec<(Axis, Axis)> {
    let moves = |a: &Axis| {
        let p = record.data(&Role::Position(a.clone()));
        p.is_some_and(|p| range(p.iter().map(|v| (*v, *v))).is_some_and(|r| r > 0.0))
    };
    let positions: Vec<Axis> = record
        .columns
        .iter()
        .filter_map(|c| match &c.role {
            Role::Position(a) if moves(a) => Some(a.clone()),
            _ => None,
        })
        .collect();
    // Where several axes move together an error across one of them is not that one's.
    let [axis] = positions.as_slice() else { return Vec::new() };
    let across = record.columns.iter().filter_map(|c| match &c.role {
        Role::Error(b) if b != axis => Some((axis.clone(), b.clone())),
        _ => None,
    });
    across.collect()
}

/// Whether a record holds an error across the one axis that moves.
#[must_use]
pub fn has_straightness(record: &Record) -> bool {
    !pairs(record).is_empty()
}

/// Straightness of every error across the axis that moves.
///
/// # Errors
/// No error across a moving axis; fewer than five places.
pub fn straightness(record: &Record) -> Result<Vec<Straightness>, InputError> {
    let pairs = pairs(record);
    if pairs.is_empty() {
        let expected = "one moving position.AXIS and the error across it, as position.x with error.y";
        return Err(lacks(record, "no error across an axis that moves", expected));
    }
    pairs.iter().map(|(axis, across)| of(record, axis, across)).collect()
}

/// Least squares: offset and slope per mm.
fn line(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let sxx: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    let sxy: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    let slope = sxy / sxx;
    (my - slope * mx, slope)
}

/// Range of deviations from the points' own line.
fn off_line_um(points: &[(f64, f64)]) -> Option<f64> {
    let (offset, slope) = (points.len() >= FEWEST_PLACES).then(|| line(points))?;
    range(points.iter().map(|(p, e)| e - offset - slope * p).map(|v| (v, v)))
}

fn of(record: &Record, axis: &Axis, across: &Axis) -> Result<Straightness, InputError> {
    let empty: &[f64] = &[];
    let position = record.data(&Role::Position(axis.clone())).unwrap_or(empty);
    let error = record.data(&Role::Error(across.clone())).unwrap_or(empty);
    let direction =
        record.data(&Role::Direction(axis.clone())).or_else(|| record.data(&Role::Velocity(axis.clone())));
    let mut places = Vec::new();
    let mut spreads: Vec<f64> = Vec::new();
    for rows in targets(position) {
        let side = |up: bool| -> Vec<f64> {
            let on = |r: &&usize| direction.map_or(up, |d| if up { d[**r] > 0.0 } else { d[**r] < 0.0 });
            rows.iter().filter(on).map(|r| error[*r]).collect()
        };
        let (up, down) = (side(true), side(false));
        spreads.extend(
            [&up, &down]
                .into_iter()
                .filter(|v| v.len() > 1)
                .filter_map(|v| range(v.iter().map(|e| (*e, *e)))),
        );
        let mean = |v: &[f64]| (!v.is_empty()).then(|| v.iter().sum::<f64>() / v.len() as f64);
        let (up_um, down_um) = (mean(&up), mean(&down));
        let Some(mean_um) = up_um.zip(down_um).map(|(u, d)| f64::midpoint(u, d)).or(up_um).or(down_um) else {
            continue;
        };
        let position_mm = rows.iter().map(|r| position[*r]).sum::<f64>() / rows.len() as f64;
        places.push(StraightPlace { position_mm, up_um, down_um, mean_um, readings: up.len() + down.len() });
    }
    if places.len() < FEWEST_PLACES {
        let found = format!("{} places along {axis}", places.len());
        return Err(lacks(
            record,
            &found,
            "five places at least: through fewer a line goes whatever the axis does",
        ));
    }
    let side = |of: fn(&StraightPlace) -> Option<f64>| -> Vec<(f64, f64)> {
        places.iter().filter_map(|p| Some((p.position_mm, of(p)?))).collect()
    };
    let (ups, downs) = (side(|p| p.up_um), side(|p| p.down_um));
    let both: Vec<(f64, f64)> = places.iter().map(|p| (p.position_mm, p.mean_um)).collect();
    let (offset, slope) = line(&both);
    let travel_mm = both[both.len() - 1].0 - both[0].0;
    let reversals: Vec<f64> = places.iter().filter_map(|p| Some(p.up_um? - p.down_um?)).collect();
    let one_sided = places.iter().filter(|p| p.up_um.is_none() || p.down_um.is_none()).count();
    let mut warnings = vec![
        "the straightedge's own form is in it: a run with the straightedge turned over takes it out, the mean of both".to_owned(),
    ];
    if one_sided > 0 && one_sided < places.len() {
        // A mean of one side beside means of both carries half of the reversal as form.
        warnings.push(format!(
            "{one_sided} places from one side only: half of the reversal is in the form there"
        ));
    }
    let (straightness_up_um, straightness_down_um) = (off_line_um(&ups), off_line_um(&downs));
    let off = |p: f64| offset + slope * p;
    for p in &mut places {
        let line_um = off(p.position_mm);
        p.mean_um -= line_um;
        p.up_um = p.up_um.map(|v| v - line_um);
        p.down_um = p.down_um.map(|v| v - line_um);
    }
    Ok(Straightness {
        symbol: format!("E{}{}", across.to_string().to_uppercase(), axis.to_string().to_uppercase()),
        axis: axis.to_string(),
        across: across.to_string(),
        straightness_um: range(places.iter().map(|p| (p.mean_um, p.mean_um))).unwrap_or(0.0),
        straightness_up_um: straightness_up_um.filter(|_| direction.is_some()),
        straightness_down_um,
        slope_urad: slope * 1000.0,
        reversal_um: (!reversals.is_empty()).then(|| reversals.iter().sum::<f64>() / reversals.len() as f64),
        repeatability_um: super::largest(spreads),
        travel_mm,
        places,
        warnings,
    })
}

impl Straightness {
    /// Deviation from the line along the travel.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let title = format!("Straightness {}: {} while {} moves", self.symbol, self.across, self.axis);
        let mut chart =
            Chart::new(&title, &format!("position {} (mm)", self.axis), "deviation from the line (µm)");
        let mut side = |label: &str, colour: Colour, of: fn(&StraightPlace) -> Option<f64>| {
            let points: Vec<(f64, f64)> =
                self.places.iter().filter_map(|p| Some((p.position_mm, of(p)?))).collect();
            if !points.is_empty() {
                let line = Series::new(label, Style::Line, points.clone()).coloured(colour);
                let dots = Series::new("", Style::Dots, points).coloured(colour);
                chart = chart.clone().with(line).with(dots);
            }
        };
        side("up ↑", Colour::Up, |p| p.up_um);
        side("down ↓", Colour::Down, |p| p.down_um);
        chart
    }
}
