//! How errors and work cross the border.

use pyo3::exceptions::{PyException, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rtec_files::Said;
use std::panic::{AssertUnwindSafe, catch_unwind};

pyo3::create_exception!(rtec, RtecError, PyException, "What cannot be done, and why.");
pyo3::create_exception!(
    rtec,
    InputError,
    PyValueError,
    "Bad input: `file`, `line` and `column` (from 1; 0 where it has none), `found`, `expected`."
);
pyo3::create_exception!(
    rtec,
    Bug,
    PyRuntimeError,
    "A mistake of the program, not of its input: please report it."
);

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
                let raised = InputError::new_err(e.to_string());
                let value = raised.value(py);
                let set = value
                    .setattr("file", e.file.display().to_string())
                    .and_then(|()| value.setattr("line", e.line))
                    .and_then(|()| value.setattr("column", e.column))
                    .and_then(|()| value.setattr("found", &e.found))
                    .and_then(|()| value.setattr("expected", &e.expected));
                set.err().unwrap_or(raised)
            }
            Self::Io(e) => e.into(),
            Self::Other(text) => RtecError::new_err(text),
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
    let raised = match done {
        Ok(Ok(answer)) => return Ok((answer, said)),
        Ok(Err(failure)) => failure.raise(py),
        Err(panic) => {
            let why = panic.downcast_ref::<String>().map(String::as_str);
            let why = why.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
            Bug::new_err(format!("{why}; this is a mistake of rtec's, not of its input"))
        }
    };
    for line in said {
        raised.value(py).call_method1("add_note", (line,))?;
    }
    Err(raised)
}

/// Work that says nothing on the way.
pub(crate) fn quietly<T: Send>(
    py: Python<'_>,
    of: impl FnOnce() -> Result<T, Failure> + Send,
) -> PyResult<T> {
    work(py, |_| of()).map(|(answer, _)| answer)
}
