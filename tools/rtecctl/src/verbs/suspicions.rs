//! Prints the libraries' messages on standard error.

use rtec_files::Said;
use rtec_measure::plausible;
use rtec_model::record::Record;

/// Prints one message.
#[allow(clippy::needless_pass_by_value)] // the libraries pass it by value
pub(crate) fn say(said: Said) {
    eprintln!("{said}");
}

/// Prints one message; a note as the program's own.
pub(crate) fn said(said: Said) {
    match said {
        Said::Warning(text) => eprintln!("warning: {text}"),
        Said::Note(text) => eprintln!("rtecctl: {text}"),
    }
}

/// Warns of mistakes that these records show.
pub(crate) fn warn(records: &[Record]) {
    plausible::said(records, &mut say);
}
