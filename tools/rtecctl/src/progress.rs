//! The line that shows the progress of a long computation.
//! It is on standard error, on a terminal only. It disappears when the computation ends or anything else is
//! printed.

use rtec_files::cancellable_computation::ComputationHandle;
use std::io::{IsTerminal as _, Write as _};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A quicker computation shows no line.
const PATIENCE: Duration = Duration::from_secs(2);
/// Interval at which the line is renewed.
const RENEWED: Duration = Duration::from_millis(500);

/// Whether the line is on the terminal.
static SHOWN: Mutex<bool> = Mutex::new(false);

/// Removes the line before anything else is printed.
/// The guard prevents it from returning.
pub(crate) fn cleared() -> impl Drop {
    let mut shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if std::mem::take(&mut *shown) {
        write("\r\x1b[K");
    }
    shown
}

/// Asks a question in place of the line.
/// The guard prevents the line from returning before the answer.
pub(crate) fn asking(question: &str) -> impl Drop {
    let shown = cleared();
    write(question);
    shown
}

fn write(text: &str) {
    let mut out = std::io::stderr().lock();
    // If standard error cannot be written, there is nowhere to report it.
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Runs a computation and shows its progress on a terminal.
pub(crate) fn shown<T>(what: &str, work: impl FnOnce() -> T) -> T {
    if !std::io::stderr().is_terminal() {
        return work();
    }
    let (start, watch) = (Instant::now(), Arc::new(ComputationHandle::default()));
    let (done, waiting) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        let computing = Arc::clone(&watch);
        scope.spawn(move || {
            let mut pause = PATIENCE;
            while waiting.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
                let mut shown = SHOWN.lock().unwrap_or_else(PoisonError::into_inner);
                write(&format!("\r{}\x1b[K", line(what, start.elapsed(), computing.steps())));
                (*shown, pause) = (true, RENEWED);
            }
        });
        let answer = watch.run_cancellable(work);
        drop(done);
        drop(cleared());
        // Nothing cancels it: Ctrl-C ends the program.
        answer.unwrap_or_else(|| std::process::exit(130))
    })
}

fn line(what: &str, gone: Duration, steps: u64) -> String {
    let gone = gone.as_secs();
    match steps {
        0 => format!("{what}: {gone} s"),
        1 => format!("{what}: {gone} s, 1 step"),
        _ => format!("{what}: {gone} s, {steps} steps"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_seconds_and_steps_where_any_are_counted() {
        let said = |steps| line("reconcile", Duration::from_millis(3900), steps);
        assert_eq!(
            [0, 1, 2].map(said),
            ["reconcile: 3 s", "reconcile: 3 s, 1 step", "reconcile: 3 s, 2 steps"]
        );
    }
}
