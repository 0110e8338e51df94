//! Reads files of other tools as run records.
//!
//! | module | contents | structure from |
//! |---|---|---|
//! | `table` | any table with named columns, units, factors and times | |
//! | `user_format` | the same, described by the user's file | |
//! | `renishaw_rtl` | `.rtl`: linear targets of a laser interferometer | programs that read it; no original file was available |
//! | `etalon` | Etalon's exchange format | ISG kernel documentation, 296430091 |
//! | `halsampler` | LinuxCNC's `halsampler` | its source, `sampler_usr.c` |
//! | `shdr` | a log of `MTConnect`'s SHDR lines | the agent's own logs |
//! | `linuxcnc_compensation` | LinuxCNC's compensation file | its loader, `usrmotintf.cc` |
//! | `ecmc` | ecmc's ISO 230-2 test | |
//! | `cmm_hole_table` | tables of holes | |
//!
//! `request` holds the options of an import. For times see `rtec_files::clock`.

mod cmm_hole_table;
mod ecmc;
mod etalon;
mod halsampler;
mod linuxcnc_compensation;
mod renishaw_rtl;
pub mod request;
mod shdr;
mod table;
mod user_format;

pub use cmm_hole_table::cmm_plate;
pub use ecmc::ecmc_dat;
pub use etalon::etalon;
pub use halsampler::{Sampling, halsampler};
pub use linuxcnc_compensation::linuxcnc_comp;
pub use renishaw_rtl::{any_text, rtl};
pub use shdr::shdr;
pub use table::{ImportColumn, TableSyntax, table};
pub use user_format::UserTableFormat;

use rtec_files::Result;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

/// A record of targets on an axis; a row is cycle, position, direction and error.
fn of_targets(to: &Path, axis: &Axis, rows: &[[f64; 4]]) -> Result<Record> {
    let get = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<_>>();
    let columns = vec![
        Column::new("cycle", Role::Cycle, get(0)),
        Column::new(axis.as_str(), Role::Position(axis.clone()), get(1)),
        Column::new("direction", Role::Direction(axis.clone()), get(2)),
        Column::new("error", Role::Error(axis.clone()), get(3)),
    ];
    Record::new(to, RunKind::Positioning, columns)
}

fn letter(name: &str) -> Axis {
    Axis::new(name).unwrap_or_else(|| unreachable!("a letter is an axis name"))
}

fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|v: &f64| v.is_finite())
}

/// A record of these columns.
/// A log, for example for a rehearsal, needs no response.
fn record_of(to: &Path, kind: RunKind, mut columns: Vec<Column>, log: bool) -> Result<Record> {
    let bare = log && !columns.iter().any(|c| c.role.is_response()) && !columns.is_empty();
    if bare {
        // Checked like any record, with a temporary response.
        let zeros = vec![0.0; columns[0].data.len()];
        columns.push(Column::new("\u{0}", Role::Error(letter("r")), zeros));
    }
    let mut record = Record::new(to, kind, columns)?;
    if bare {
        record.columns.pop();
    }
    Ok(record)
}

/// Adds to a record's note.
pub fn add_note(record: &mut Record, text: &str) {
    let before = record.note.take().map_or_else(String::new, |note| note + "; ");
    record.note = Some(before + text);
}
