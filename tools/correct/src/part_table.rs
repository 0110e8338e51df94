//! A part's errors as a source, removed only where the tool cuts.
//! (NISTIR 4854, section 5)

use crate::AxisCorrectionSettings;
use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, AxisCountConversion, FinishCutArc};
use rtec_part::error_cor_file::FeatureErrors;
use rtec_part::geometric_fit::Zx;
use rtec_part::straight_finish_cut_table::StraightFinishCutTable;
use serde::{Deserialize, Serialize};

/// Distances from a feature, mm, for a part table's full effect and for its end.
/// A tool on its way elsewhere must not be moved.
pub(crate) const NEAR_MM: [f64; 2] = [2.0, 10.0];

/// Limit of every position, mm: a kilometre.
const FARTHEST_MM: f64 = 1e6;

/// The errors of a part along an arc or a straight feature, and the correcting cut.
/// Pairs are along the part's axis (Z) and across it (X).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartTable {
    /// Absolute path of `error.cor`: lines of angle, rad, and error, µm.
    /// The lines of a straight feature also have positions.
    pub errors: String,
    /// Names of the two axes.
    pub axes: [String; 2],
    /// Centre of the arc in part coordinates.
    /// None for a straight feature, whose errors have positions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub centre_mm: Option<[f64; 2]>,
    /// Radius of the finished surface; none for a straight feature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
    /// Radius of the tool's nose.
    pub nose_mm: f64,
    /// The arc is hollow, a fillet or a groove: the nose's centre runs inside it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hollow: bool,
    /// Machine position at which the nose's centre is at the part's origin.
    pub origin_mm: [f64; 2],
    /// Lead: totals are requested this long before the tool is there.
    pub lead_ms: f64,
}

/// Present effect of a loaded part table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PartTableState {
    /// Probed points in it.
    pub points: usize,
    /// `in_force`, `ready` if the tool is elsewhere, or `off`.
    pub state: String,
    /// Distance of the tool from the arc or the straight feature, mm: 0 on it.
    pub off_mm: f64,
    /// Distance within which the table acts, mm.
    pub acts_within_mm: f64,
    /// Error that it removes here, µm, in the order of its axes.
    /// If the table is not in force, the error that it would remove.
    pub um: [f64; 2],
    /// Reason why it is off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

#[derive(Debug)]
enum ArcOrStraightTable {
    Arc(ArcFinishCutTable),
    Line(StraightFinishCutTable),
}

/// The loaded part table.
#[derive(Debug)]
pub(crate) struct LoadedPartTable {
    pub(crate) shown: PartTable,
    table: ArcOrStraightTable,
    /// The table's two axes (Z and X of the part) as indices of the corrector's axes.
    pub(crate) axes: [usize; 2],
}

impl LoadedPartTable {
    /// A table on the corrector's axes `of`; `named` tells which a model can name.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub(crate) fn new(
        shown: PartTable,
        errors: FeatureErrors,
        of: &[AxisCorrectionSettings],
        named: impl Fn(usize) -> bool,
    ) -> Result<Self, String> {
        let mut axes = [0; 2];
        for (n, name) in axes.iter_mut().zip(&shown.axes) {
            let names = || of.iter().map(|a| a.name.as_str()).collect::<Vec<_>>().join(", ");
            let found = (0..of.len()).find(|k| of[*k].name == *name && named(*k));
            *n = found.ok_or_else(|| {
                format!("found axis {name:?} for the part table, expected one of {}", names())
            })?;
        }
        let [oz, ox] = shown.origin_mm;
        let within = |places: &[f64]| places.iter().all(|v| v.abs() <= FARTHEST_MM);
        let good = within(&[oz, ox])
            && (0.0..=1e3).contains(&shown.nose_mm)
            && (0.0..=1e3).contains(&shown.lead_ms)
            && axes[0] != axes[1];
        if !good {
            return Err("found a part table with a value out of range; expected two axes, finite places, nose_mm of 0 to 1000 and \
                        lead_ms of 0 to 1000"
                .to_owned());
        }
        let counts = axes.map(|n| AxisCountConversion {
            count_um: of[n].count_um,
            increment: of[n].increment_counts,
            sign: 1.0,
        });
        let (nose_mm, origin) = (shown.nose_mm, Zx::new(oz, ox));
        let table = match errors {
            FeatureErrors::Line(errors) => {
                if shown.radius_mm.is_some() || shown.centre_mm.is_some() || shown.hollow {
                    return Err("found a radius, a centre or a hollow arc for the errors of a straight feature, expected none: the \
                                errors bring their places"
                        .to_owned());
                }
                ArcOrStraightTable::Line(StraightFinishCutTable { errors, axes: counts, nose_mm, origin })
            }
            FeatureErrors::Arc(errors) => {
                let arc = shown.centre_mm.zip(shown.radius_mm);
                let arc = arc.filter(|(c, r)| within(c) && *r > 0.0 && *r <= FARTHEST_MM);
                let Some(([cz, cx], radius_mm)) = arc else {
                    return Err("found the errors of an arc without its place; expected a finite centre_mm and a positive \
                                radius_mm"
                        .to_owned());
                };
                if shown.hollow && nose_mm >= radius_mm {
                    return Err(format!(
                        "found a nose of {nose_mm} mm for a hollow arc of {radius_mm} mm, expected one that fits into it"
                    ));
                }
                let nose_mm = if shown.hollow { -nose_mm } else { nose_mm };
                let cut = FinishCutArc { centre: Zx::new(cz, cx), radius_mm, nose_mm, origin };
                ArcOrStraightTable::Arc(ArcFinishCutTable::new(cut, counts, errors))
            }
        };
        Ok(Self { shown, table, axes })
    }

    /// Error that it removes at a machine position reached after the table's lead, µm.
    pub(crate) fn components_um(&self, place: Zx, velocity_mm_s: Zx) -> Zx {
        let lead_s = self.shown.lead_ms * 1e-3;
        let off_mm = self.off_mm(place + velocity_mm_s * lead_s);
        let [near, far] = NEAR_MM;
        let share = ((far - off_mm) / (far - near)).clamp(0.0, 1.0);
        let um = match &self.table {
            ArcOrStraightTable::Arc(table) => table.components_um(place, velocity_mm_s, lead_s),
            ArcOrStraightTable::Line(table) => table.components_um(place, velocity_mm_s, lead_s),
        };
        um * share
    }

    /// Distance of a machine position from the path of the tool's nose, mm.
    pub(crate) fn off_mm(&self, place: Zx) -> f64 {
        match &self.table {
            ArcOrStraightTable::Arc(table) => {
                let cut = &table.cut;
                ((place - cut.origin - cut.centre).norm() - cut.radius_mm - cut.nose_mm).abs()
            }
            ArcOrStraightTable::Line(table) => table.off_mm(place),
        }
    }

    /// Number of probed points that the table was made from.
    pub(crate) fn points(&self) -> usize {
        match &self.table {
            ArcOrStraightTable::Arc(table) => table.points(),
            ArcOrStraightTable::Line(table) => table.errors.len(),
        }
    }
}
