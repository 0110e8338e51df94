//! Leadscrew compensation of Beckhoff TF5200 and ISG: `kw.ssfk.*` value lists.
//!
//! Values are position reached less commanded position, in 0.1 µm, as in the maker's example (TF5200,
//! 308695435). Positions are in 0.1 µm, each stated (`interval 0`), as in that example. Values beyond the
//! ends are those at the ends.

use super::{CompensationFormat, CompensationPoint, CompensationTable, FormatRequirements, usage};
use rtec_files::Result;
use std::fmt::Write as _;

/// Most points in builds before V3.1.3079.06.
/// Also in later builds unless P-COMP-00059 states another number.
pub(super) const MOST: usize = 1500;

/// A compensation value list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BeckhoffSsfkFormat {
    /// Logical number of the axis (P-COMP-00001), 1 to 65535.
    pub axis_number: u16,
    /// Most points: 1500, or the value of P-COMP-00059.
    pub most: usize,
}

fn tenths(um: f64) -> i64 {
    (10.0 * um).round() as i64
}

impl CompensationFormat for BeckhoffSsfkFormat {
    fn rules(&self) -> FormatRequirements {
        FormatRequirements::both_directions(self.most, 1e-4, 0.1)
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        if self.axis_number == 0 {
            return Err(usage("--axis-number 0", "the controller's logical axis number, from 1"));
        }
        let of = |p: &CompensationPoint| [1000.0 * p.position_mm, p.up_um, p.down_um].map(tenths);
        let values: Vec<[i64; 3]> = table.points.iter().map(of).collect();
        if let Some(v) = values.iter().flatten().find(|v| i32::try_from(**v).is_err()) {
            return Err(usage(format!("{v} x 0.1 um"), "values of 32 bits, as the controller takes"));
        }
        let mut text = format!("kopf.achs_nr {}\n", self.axis_number);
        let (start, count) = (tenths(1000.0 * table.start_mm()), values.len());
        let _ = write!(
            text,
            "kw.ssfk.interval 0\nkw.ssfk.kw_startpos {start}\nkw.ssfk.kw_nr_max {count}\n\
             kw.ssfk.unit 1\nkw.ssfk.bilateral 1\nkw.ssfk.modulo 0\n"
        );
        for (column, key) in ["setpoint", "pos", "neg"].iter().enumerate() {
            for (i, v) in values.iter().enumerate() {
                let _ = writeln!(text, "kw.ssfk.table[{i}].{key} {}", v[column]);
            }
        }
        Ok(text)
    }

    fn advice(&self, table: &CompensationTable) -> Vec<String> {
        let mut advice = vec![format!(
            "switched on by lr_param.ssfk 1 in the list of axis {}; no backlash compensation beside it",
            self.axis_number
        )];
        let wide = |um: f64| i16::try_from(tenths(um)).is_err();
        if table.points.iter().any(|p| wide(p.up_um) || wide(p.down_um)) {
            advice.push("values beyond 16 bits: older builds do not take them".to_owned());
        }
        advice
    }
}
