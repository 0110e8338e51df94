//! Passes errors and long work between Rust and Python.

use pyo3::prelude::*;
use rtec_files::cancellable_computation::ComputationHandle;
use rtec_files::{InputError, InputNotice};
use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Makes an error. Its class is written in Python, because it has two bases.
fn raised<'py, A: pyo3::call::PyCallArgs<'py>>(py: Python<'py>, class: &str, arguments: A) -> PyErr {
    let made = py.import("rtec._errors").and_then(|m| m.getattr(class)).and_then(|c| c.call1(arguments));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// Whether a file does not exist, by the system's error (ENOENT).
fn is_missing(error: &InputError) -> bool {
    const ENOENT: i32 = 2;
    error.found.contains(&std::io::Error::from_raw_os_error(ENOENT).to_string())
}

/// The error that ended work without an answer.
pub(crate) struct Failure(Box<dyn Error + Send + Sync>);

impl<E: Error + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self(Box::new(error))
    }
}

impl Failure {
    fn raise(self, py: Python<'_>) -> PyErr {
        if let Some(e) = self.0.downcast_ref::<InputError>() {
            let file = e.file.display().to_string();
            let about = (e.to_string(), file, e.line, e.column, &e.found, &e.expected, is_missing(e));
            return raised(py, "input_error", about);
        }
        match self.0.downcast::<std::io::Error>() {
            Ok(error) => (*error).into(),
            Err(other) => raised(py, "RtecError", (other.to_string(),)),
        }
    }
}

/// Interval at which a call checks for Ctrl-C and reports progress.
const LOOK: Duration = Duration::from_millis(40);

/// An answer with its messages, or an error.
pub(crate) type Answered<T> = PyResult<(T, Vec<String>)>;

type Done<T> = std::thread::Result<Option<(Result<T, Failure>, Vec<String>)>>;

/// Works in a separate thread, without the interpreter's lock.
/// Ctrl-C, or an error of the hook `rtec.progress`, ends the call at once; the thread ends at its next step.
/// Messages are returned with the answer, or added to the notes of an error.
pub(crate) fn work<T: Send + 'static>(
    py: Python<'_>,
    of: impl FnOnce(&mut dyn FnMut(InputNotice)) -> Result<T, Failure> + Send + 'static,
) -> Answered<T> {
    let watch = Arc::new(ComputationHandle::default());
    let (send, done) = mpsc::channel::<Done<T>>();
    let watched = Arc::clone(&watch);
    let working = move || {
        let mut said = Vec::new();
        let of = || watched.run_cancellable(|| of(&mut |s: InputNotice| said.push(s.to_string())));
        // After a panic all that the work used is dropped, so nothing reads it again.
        let done = catch_unwind(AssertUnwindSafe(of));
        // After Ctrl-C nobody waits for the answer.
        let _ = send.send(done.map(|answer| answer.map(|answer| (answer, said))));
    };
    // The stack is as large as that of the main thread.
    std::thread::Builder::new().name("rtec".to_owned()).stack_size(8 << 20).spawn(working)?;
    let (error, said) = match waited(py, &watch, done)? {
        Ok(Some((Ok(answer), said))) => return Ok((answer, said)),
        Ok(Some((Err(failure), said))) => (failure.raise(py), said),
        Ok(None) => (bug(py, "a call ended that nobody gave up"), Vec::new()),
        Err(panic) => {
            let why = panic.downcast_ref::<String>().map(String::as_str);
            (bug(py, why.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic")), Vec::new())
        }
    };
    for line in said {
        error.value(py).call_method1("add_note", (line,))?;
    }
    Err(error)
}

fn bug(py: Python<'_>, why: &str) -> PyErr {
    raised(py, "Bug", (format!("{why}; this is a mistake of rtec's, not of its input"),))
}

/// Waits for the work. Meanwhile it checks Python's signals and calls its hook.
fn waited<T: Send>(
    py: Python<'_>,
    watch: &ComputationHandle,
    mut done: Receiver<Done<T>>,
) -> PyResult<Done<T>> {
    let start = Instant::now();
    loop {
        let answer;
        (done, answer) = py.detach(move || {
            let answer = done.recv_timeout(LOOK);
            (done, answer)
        });
        match answer {
            Ok(done) => return Ok(done),
            Err(RecvTimeoutError::Disconnected) => return Err(bug(py, "the work ended without an answer")),
            Err(RecvTimeoutError::Timeout) => {}
        }
        let told = || {
            let hook = py.import("rtec._progress")?.getattr("tell")?;
            hook.call1((start.elapsed().as_secs_f64(), watch.steps()))
        };
        if let Err(error) = py.check_signals().and_then(|()| told()) {
            watch.give_up();
            return Err(error);
        }
    }
}

/// Work without messages.
pub(crate) fn quietly<T: Send + 'static>(
    py: Python<'_>,
    of: impl FnOnce() -> Result<T, Failure> + Send + 'static,
) -> PyResult<T> {
    work(py, |_| of()).map(|(answer, _)| answer)
}
