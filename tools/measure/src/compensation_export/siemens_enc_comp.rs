//! Encoder and leadscrew error compensation of SINUMERIK (840D, 828D, 808D): `$AA_ENC_COMP`.
//!
//! The value is added to the actual position, so a positive value moves the axis in the negative direction
//! (Siemens 808D function manual, p. 106; 6FC5397-1BP40-3BA1, p. 238). The value is therefore the error
//! itself. One table serves both directions. Its points are evenly spaced, and it is zero at the reference
//! point.

use super::{CompensationFormat, CompensationTable, FormatRequirements, number, usage};
use rtec_files::Result;
use std::fmt::Write as _;

/// Points of an 808D; an 840D or 828D has the number in MD38000.
pub(super) const MOST: usize = 200;

/// A table of encoder compensation.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EncoderCompensationFormat {
    /// Name of the machine axis in the controller, such as X1.
    pub axis: String,
    /// The reference point, mm.
    pub reference_mm: f64,
    /// Number of the encoder, 0 or 1.
    pub encoder: u8,
    /// Most points: 200, or the value of MD38000.
    pub most: usize,
}

/// Refuses an axis name that SINUMERIK does not take.
pub(super) fn check_axis_name(option: &str, name: &str) -> Result<()> {
    let good = name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let expected = "the machine axis as the controller names it, as X1";
    if good { Ok(()) } else { Err(usage(format!("{option} {name}"), expected)) }
}

impl CompensationFormat for EncoderCompensationFormat {
    fn rules(&self) -> FormatRequirements {
        FormatRequirements::siemens(self.most, self.reference_mm)
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        check_axis_name("--axis-name", &self.axis)?;
        if self.encoder > 1 {
            return Err(usage(format!("--encoder {}", self.encoder), "encoder 0 or 1"));
        }
        let (e, axis) = (self.encoder, &self.axis);
        let mut text = "%_N_AX_EEC_INI\nCHANDATA(1)\n".to_owned();
        for (i, p) in table.points.iter().enumerate() {
            let _ = writeln!(text, "$AA_ENC_COMP[{e},{i},{axis}]={}", number(p.mean_um() / 1000.0, 6));
        }
        let [step, min, max] = table.grid();
        let _ = write!(
            text,
            "$AA_ENC_COMP_STEP[{e},{axis}]={step}\n$AA_ENC_COMP_MIN[{e},{axis}]={min}\n$AA_ENC_COMP_MAX[{e},{axis}]={max}\n\
             $AA_ENC_COMP_IS_MODULO[{e},{axis}]=0\nM17\n"
        );
        Ok(text)
    }

    fn advice(&self, table: &CompensationTable) -> Vec<String> {
        vec![format!(
            "loaded with MD32700 = 0, then MD32700 = 1; MD38000 at least {}; zero at the reference point {} mm; mm; it has the \
             mean of both directions, so a backlash compensation may stand beside it",
            table.points.len(),
            self.reference_mm
        )]
    }
}
