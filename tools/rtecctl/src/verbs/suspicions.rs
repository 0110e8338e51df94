//! What the libraries say on the way, on standard error.

use rtec_files::Said;
use rtec_measure::plausible;
use rtec_model::record::Record;

/// One line.
#[allow(clippy::needless_pass_by_value)] // it is what the libraries hand over
pub(crate) fn say(said: Said) {
    eprintln!("{said}");
}

/// One line, a note as the program's own.
pub(crate) fn said(said: Said) {
    match said {
        Said::Warning(text) => eprintln!("warning: {text}"),
        Said::Note(text) => eprintln!("rtecctl: {text}"),
    }
}

/// Warns of what these records show of mistakes.
pub(crate) fn warn(records: &[Record]) {
    plausible::said(records, &mut say);
}
