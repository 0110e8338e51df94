//! Prints the libraries' messages on standard error.

use rtec_files::InputMessage;
use rtec_measure::plausible;
use rtec_model::record::Record;

#[allow(clippy::needless_pass_by_value)] // the libraries pass it by value
pub(crate) fn say(said: InputMessage) {
    eprintln!("{said}");
}

/// Prints one message; a note as the program's own.
pub(crate) fn said(said: InputMessage) {
    match said {
        InputMessage::Warning(text) => eprintln!("warning: {text}"),
        InputMessage::Note(text) => eprintln!("rtecctl: {text}"),
    }
}

pub(crate) fn warn(records: &[Record]) {
    plausible::said(records, &mut say);
}
