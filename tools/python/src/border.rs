//! How errors and work cross the border.

use pyo3::prelude::*;
use rtec_files::Said;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The classes are written in Python: each has two bases.
fn raised<'py, A: pyo3::call::PyCallArgs<'py>>(py: Python<'py>, class: &str, arguments: A) -> PyErr {
    let made = py.import("rtec._errors").and_then(|m| m.getattr(class)).and_then(|c| c.call1(arguments));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// Whether the system said of a file that it is not there (ENOENT).
fn is_missing(error: &rtec_files::InputError) -> bool {
    const ENOENT: i32 = 2;
    error.found.contains(&std::io::Error::from_raw_os_error(ENOENT).to_string())
}

/// Why work ended without an answer.
pub(crate) enum Failure {
    Input(Box<rtec_files::InputError>),
    Io(std::io::Error),
    Other(String),
}

impl From<rtec_files::InputError> for Failure {
    fn from(error: rtec_files::InputError) -> Self {
        Self::Input(Box::new(error))
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Self::Other(error.to_string())
    }
}

impl From<rtec_measure::plot::PlotError> for Failure {
    fn from(error: rtec_measure::plot::PlotError) -> Self {
        Self::Other(error.to_string())
    }
}

impl Failure {
    fn raise(self, py: Python<'_>) -> PyErr {
        match self {
            Self::Input(e) => {
                let file = e.file.display().to_string();
                let about = (e.to_string(), file, e.line, e.column, &e.found, &e.expected, is_missing(&e));
                raised(py, "input_error", about)
            }
            Self::Io(e) => e.into(),
            Self::Other(text) => raised(py, "RtecError", (text,)),
        }
    }
}

/// Works without the interpreter's lock. What was said is given with the answer, and stands in the notes of an error.
pub(crate) fn work<T: Send>(
    py: Python<'_>,
    of: impl FnOnce(&mut dyn FnMut(Said)) -> Result<T, Failure> + Send,
) -> PyResult<(T, Vec<String>)> {
    let (done, said) = py.detach(|| {
        let mut said = Vec::new();
        // What a panic leaves behind is dropped here: nothing of it is looked at again.
        let done = catch_unwind(AssertUnwindSafe(|| of(&mut |s: Said| said.push(s.to_string()))));
        (done, said)
    });
    let error = match done {
        Ok(Ok(answer)) => return Ok((answer, said)),
        Ok(Err(failure)) => failure.raise(py),
        Err(panic) => {
            let why = panic.downcast_ref::<String>().map(String::as_str);
            let why = why.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
            raised(py, "Bug", (format!("{why}; this is a mistake of rtec's, not of its input"),))
        }
    };
    for line in said {
        error.value(py).call_method1("add_note", (line,))?;
    }
    Err(error)
}

/// Work that says nothing on the way.
pub(crate) fn quietly<T: Send>(
    py: Python<'_>,
    of: impl FnOnce() -> Result<T, Failure> + Send,
) -> PyResult<T> {
    work(py, |_| of()).map(|(answer, _)| answer)
}
