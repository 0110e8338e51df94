//! Sag and angularity compensation of SINUMERIK (840D, 828D): `$AN_CEC`.
//! The position of one axis compensates another.
//!
//! The structure is that of the function manual (6FC5397-1BP40-3BA1, K3, 4.4.3, p. 248 and 249; 802D sl,
//! 6FC5397-1CP10-5BA0, p. 222). Values beyond the ends are those at the ends. No public page states in which
//! direction a positive value moves the compensation axis. The user must try it on the machine and state it.

use super::siemens_enc_comp::check_axis_name;
use super::{CompensationFormat, CompensationTable, FormatRequirements, number, usage};
use rtec_files::Result;
use std::fmt::Write as _;

/// Points of a table of an 828D (the manual, p. 264).
/// An 840D has the number in MD18342.
pub(super) const MOST: usize = 200;

/// A table of sag compensation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SagCompensationFormat {
    /// Name of the compensation axis in the controller, such as Y1.
    pub axis: String,
    /// Name of the basic axis, whose position is looked up, such as X1.
    pub along: String,
    /// Number of the table, from 0.
    pub table: u16,
    /// Reference point of the basic axis, mm: the value is zero there.
    pub reference_mm: f64,
    /// Most points: 200, or the value of MD18342.
    pub most: usize,
    /// Whether a positive value moves the compensation axis up.
    pub positive_moves_up: bool,
}

impl CompensationFormat for SagCompensationFormat {
    fn rules(&self) -> FormatRequirements {
        FormatRequirements::siemens(self.most, self.reference_mm)
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        check_axis_name("--axis-name", &self.axis)?;
        check_axis_name("--along-name", &self.along)?;
        if self.axis == self.along {
            return Err(usage(format!("--along-name {}", self.along), "another axis than --axis-name"));
        }
        let t = self.table;
        let mut text = "%_N_NC_CEC_INI\nCHANDATA(1)\n".to_owned();
        let against = if self.positive_moves_up { -1.0 } else { 1.0 };
        for (i, p) in table.points.iter().enumerate() {
            let _ = writeln!(text, "$AN_CEC[{t},{i}]={}", number(against * p.mean_um() / 1000.0, 6));
        }
        let (Self { along, axis, .. }, [step, min, max]) = (self, table.grid());
        let _ = write!(
            text,
            "$AN_CEC_INPUT_AXIS[{t}]=({along})\n$AN_CEC_OUTPUT_AXIS[{t}]=({axis})\n$AN_CEC_STEP[{t}]={step}\n$AN_CEC_MIN[{t}]={min}\n\
             $AN_CEC_MAX[{t}]={max}\n$AN_CEC_DIRECTION[{t}]=0\n$AN_CEC_MULT_BY_TABLE[{t}]=0\n$AN_CEC_IS_MODULO[{t}]=0\nM17\n"
        );
        Ok(text)
    }

    fn advice(&self, table: &CompensationTable) -> Vec<String> {
        let way = if self.positive_moves_up { "up" } else { "down" };
        vec![
            format!(
                "loaded with MD32710 = 0, then MD32710 = 1 and SD41300 for table {}; MD18342 at least {}; zero at {} mm of {}; mm",
                self.table,
                table.points.len(),
                self.reference_mm,
                self.along
            ),
            format!(
                "its sign holds where a positive value moves {} {way}: measure once more with the table on, the error must shrink",
                self.axis
            ),
        ]
    }
}
