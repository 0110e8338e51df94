//! A part's errors as a source: taken out where the tool cuts (NISTIR 4854, section 5), and nowhere else.

use crate::AxisSetup;
use rtec_part::errors::PointError;
use rtec_part::fit::Zx;
use rtec_part::table::{AxisCounts, FinishCut, FinishTable};
use serde::{Deserialize, Serialize};

/// A part table acts in full within this distance of its arc, mm, and no more beyond the second: a tool on its way
/// elsewhere is none of its business.
pub(crate) const NEAR_MM: [f64; 2] = [2.0, 10.0];

/// The errors of a part along an arc, and the cut that takes them out. Pairs are along the part's axis (Z) and across
/// it (X).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartTable {
    /// `error.cor`, absolute: angle in rad and error in µm a line.
    pub errors: String,
    /// Names of the two axes.
    pub axes: [String; 2],
    /// Centre of the arc in part coordinates.
    pub centre_mm: [f64; 2],
    /// Radius of the finished surface.
    pub radius_mm: f64,
    /// Radius of the tool's nose.
    pub nose_mm: f64,
    /// Machine position at which the nose's centre is at the part's origin.
    pub origin_mm: [f64; 2],
    /// Totals are asked this long before the tool is there.
    pub lead_ms: f64,
}

/// What a loaded part table does now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TableNow {
    /// Probed points in it.
    pub points: usize,
    /// `in_force`, `ready` where the tool is elsewhere, or `off`.
    pub state: String,
    /// From the tool to the arc, mm: 0 on it.
    pub off_mm: f64,
    /// Within this distance of the arc it acts, mm.
    pub acts_within_mm: f64,
    /// What it takes out here, µm, in the order of its axes; when it is not in force, what it would.
    pub um: [f64; 2],
    /// Why it is off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// The part table that is loaded.
#[derive(Debug)]
pub(crate) struct PartErrors {
    pub(crate) shown: PartTable,
    table: FinishTable,
    /// The table's two axes (Z and X of the part) as indices of the corrector's axes.
    pub(crate) axes: [usize; 2],
}

impl PartErrors {
    /// A table on axes `of` the corrector that a model can name.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub(crate) fn new(
        shown: PartTable,
        errors: Vec<PointError>,
        of: &[AxisSetup],
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
        let [cz, cx] = shown.centre_mm;
        let [oz, ox] = shown.origin_mm;
        // A kilometre: the bounds of every position.
        let good = [cz, cx, oz, ox].iter().all(|v| v.abs() <= 1e6)
            && shown.radius_mm > 0.0
            && shown.radius_mm <= 1e6
            && (0.0..=1e3).contains(&shown.nose_mm)
            && (0.0..=1e3).contains(&shown.lead_ms)
            && axes[0] != axes[1];
        if !good {
            return Err(
                "found a part table with a value out of range; expected two axes, finite places, a positive \
                        radius_mm, nose_mm of 0 to 1000 and lead_ms of 0 to 1000"
                    .to_owned(),
            );
        }
        let cut = FinishCut {
            centre: Zx::new(cz, cx),
            radius_mm: shown.radius_mm,
            nose_mm: shown.nose_mm,
            origin: Zx::new(oz, ox),
        };
        let counts = axes.map(|n| AxisCounts {
            count_um: of[n].count_um,
            increment: of[n].increment_counts,
            sign: 1.0,
        });
        Ok(Self { table: FinishTable::new(cut, counts, errors), axes, shown })
    }

    /// What it takes out at a machine position that is reached in the table's lead, µm.
    pub(crate) fn components_um(&self, place: Zx, velocity_mm_s: Zx) -> Zx {
        let lead_s = self.shown.lead_ms * 1e-3;
        let off_mm = self.off_mm(place + velocity_mm_s * lead_s);
        let [near, far] = NEAR_MM;
        let share = ((far - off_mm) / (far - near)).clamp(0.0, 1.0);
        self.table.components_um(place, velocity_mm_s, lead_s) * share
    }

    /// From a machine position to the arc that the tool's nose runs on.
    pub(crate) fn off_mm(&self, place: Zx) -> f64 {
        let cut = &self.table.cut;
        ((place - cut.origin - cut.centre).norm() - cut.radius_mm - cut.nose_mm).abs()
    }

    /// Number of probed points that the table came from.
    pub(crate) fn points(&self) -> usize {
        self.table.points()
    }
}
