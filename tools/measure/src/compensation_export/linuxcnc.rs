//! LinuxCNC's `COMP_FILE`: lines of `nominal forward reverse` in machine units.
//!
//! Its loader (`usrmotLoadComp` in `src/emc/motion/usrmotintf.cc`) stops silently at the first line that is
//! not three numbers, so the file has nothing else. Type 0 has positions reached, type 1 values added to the
//! motor's command. The loader converts type 0 to type 1 as nominal less reached.

use super::{CompensationFormat, CompensationTable, FormatRequirements, number, usage};
use rtec_files::Result;

/// Most points of LinuxCNC (`EMCMOT_COMP_SIZE`).
pub const MOST: usize = 256;
/// Size of its line buffer, bytes, with the terminator.
const LINE: usize = 255;

rtec_files::choice! {
    /// The machine's `[TRAJ] LINEAR_UNITS`.
    pub enum LinuxcncLinearUnit {
        Mm = "mm", "";
        Inch = "inch", "";
    }
}

impl LinuxcncLinearUnit {
    /// Length of the unit, mm.
    pub fn mm(self) -> f64 {
        match self {
            Self::Mm => 1.0,
            Self::Inch => 25.4,
        }
    }
}

/// A `COMP_FILE`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinuxcncCompFileFormat {
    /// Type 1 (trims); otherwise type 0 (positions reached).
    pub trims: bool,
    /// The machine's unit.
    pub unit: LinuxcncLinearUnit,
}

impl CompensationFormat for LinuxcncCompFileFormat {
    fn rules(&self) -> FormatRequirements {
        // A resolution of 1 nm is enough.
        FormatRequirements::both_directions(MOST, 1e-6, 1e-6)
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        let in_unit = |mm: f64| number(mm / self.unit.mm(), 9);
        let mut text = String::new();
        let mut before: Option<String> = None;
        for p in &table.points {
            let value = |um: f64| if self.trims { -um / 1000.0 } else { p.position_mm + um / 1000.0 };
            let nominal = in_unit(p.position_mm);
            if before.as_ref() == Some(&nominal) {
                return Err(usage(format!("the position {nominal} twice"), "a larger --step"));
            }
            let line = format!("{nominal} {} {}\n", in_unit(value(p.up_um)), in_unit(value(p.down_um)));
            if line.len() >= LINE {
                return Err(usage(format!("a line of {} bytes", line.len()), "lines below 255 bytes"));
            }
            text.push_str(&line);
            before = Some(nominal);
        }
        Ok(text)
    }

    fn advice(&self, _: &CompensationTable) -> Vec<String> {
        let unit = LinuxcncLinearUnit::ALL[self.unit as usize].0;
        vec![format!(
            "in the [JOINT_n] section: COMP_FILE = this file, COMP_FILE_TYPE = {}; the machine's LINEAR_UNITS are {unit}; BACKLASH is \
             ignored then; add no comment: LinuxCNC stops at the first line that is not three numbers",
            u8::from(self.trims)
        )]
    }
}
