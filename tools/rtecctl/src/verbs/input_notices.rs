//! Prints the libraries' messages on standard error.

use rtec_files::InputNotice;
use rtec_measure::plausible;
use rtec_model::record::Record;

#[allow(clippy::needless_pass_by_value)] // the libraries pass it by value
pub(crate) fn say(said: InputNotice) {
    eprintln!("{said}");
}

/// Prints one message; a note as the program's own.
pub(crate) fn said(said: InputNotice) {
    match said {
        InputNotice::Warning(text) => eprintln!("warning: {text}"),
        InputNotice::Note(text) => eprintln!("rtecctl: {text}"),
    }
}

pub(crate) fn warn(records: &[Record]) {
    plausible::report_suspicions(records, &mut say);
}
