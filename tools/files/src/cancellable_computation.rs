//! A long computation that another thread waits for.
//! It counts its steps, and ends early if the other thread stops waiting.
//!
//! The computing thread calls [`step`] often; the waiting thread holds the [`ComputationHandle`].

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The state that the computing thread and the waiting thread share.
#[derive(Debug, Default)]
pub struct ComputationHandle {
    given_up: AtomicBool,
    steps: AtomicU64,
}

thread_local! {
    static HERE: RefCell<Option<Arc<ComputationHandle>>> = const { RefCell::new(None) };
}

/// The payload that unwinds an abandoned computation; no panic hook runs for it.
struct AbandonedComputationPanic;

impl ComputationHandle {
    /// Steps so far.
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }

    /// Asks the computation to end at its next step.
    pub fn give_up(&self) {
        self.given_up.store(true, Ordering::Relaxed);
    }

    /// Computes in this thread, watched; `None` if it was given up.
    pub fn run_cancellable<T>(self: &Arc<Self>, work: impl FnOnce() -> T) -> Option<T> {
        let before = HERE.replace(Some(Arc::clone(self)));
        // Unwinding drops everything half done, so nothing reads it again.
        let done = catch_unwind(AssertUnwindSafe(work));
        HERE.set(before);
        match done {
            Ok(answer) => Some(answer),
            Err(why) if why.is::<AbandonedComputationPanic>() => None,
            Err(why) => resume_unwind(why),
        }
    }
}

/// Counts one step of a computation, for example a candidate or a block.
/// It does nothing if the computation is not watched.
pub fn step() {
    let given_up = HERE.with_borrow(|watch| {
        watch.as_ref().is_some_and(|w| {
            w.steps.fetch_add(1, Ordering::Relaxed);
            w.given_up.load(Ordering::Relaxed)
        })
    });
    if given_up {
        resume_unwind(Box::new(AbandonedComputationPanic));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn steps_are_counted_where_somebody_watches() {
        step();
        let watch = Arc::new(ComputationHandle::default());
        assert_eq!(watch.run_cancellable(|| (0..7).for_each(|_| step())), Some(()));
        step();
        assert_eq!(watch.steps(), 7);
    }

    #[test]
    fn what_is_given_up_ends_at_its_next_step() {
        let watch = Arc::new(ComputationHandle::default());
        let (begun, wait) = mpsc::channel();
        let computing = std::thread::spawn({
            let watch = Arc::clone(&watch);
            move || {
                watch.run_cancellable(|| {
                    loop {
                        step();
                        begun.send(()).unwrap_or_default();
                    }
                })
            }
        });
        wait.recv().unwrap();
        watch.give_up();
        assert_eq!(computing.join().unwrap(), None::<()>);
    }

    #[test]
    fn a_panic_is_no_giving_up() {
        let watch = Arc::new(ComputationHandle::default());
        let caught =
            catch_unwind(AssertUnwindSafe(|| watch.run_cancellable(|| resume_unwind(Box::new("mistake")))));
        assert!(caught.is_err_and(|why| why.is::<&str>()));
    }
}
