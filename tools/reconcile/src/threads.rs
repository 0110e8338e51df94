//! What is long is done by as many threads as there are processors; what comes out is the same to the last digit, however many.

use std::ops::Range;
use std::sync::OnceLock;
use std::thread;

/// So many products are worth a thread of their own: some twenty times what it takes to begin one.
const WORTH: usize = 1 << 20;
/// More share one way to the memory.
const MOST: usize = 4;

/// Processors that this program may use, up to [`MOST`].
fn processors() -> usize {
    static PROCESSORS: OnceLock<usize> = OnceLock::new();
    *PROCESSORS.get_or_init(|| thread::available_parallelism().map_or(1, |n| n.get().min(MOST)))
}

/// Whether so many products are worth a second thread.
pub(crate) fn worth(products: usize) -> bool {
    products / 2 >= WORTH && processors() > 1
}

/// Both, at the same time where so many products are worth it.
pub(crate) fn both<A, B: Send>(
    products: usize,
    here: impl FnOnce() -> A,
    beside: impl FnOnce() -> B + Send,
) -> (A, B) {
    if !worth(products) {
        return (here(), beside());
    }
    thread::scope(|scope| {
        let beside = scope.spawn(beside);
        (here(), joined(beside))
    })
}

/// What comes of `0..count`, some at a time, in order: all at once, or in parts of about as many where `products` are worth it.
pub(crate) fn in_parts<T: Send>(
    count: usize,
    products: usize,
    work: impl Fn(Range<usize>) -> T + Sync,
) -> Vec<T> {
    let parts = (products / WORTH).clamp(1, processors()).min(count.max(1));
    let part = |i: usize| count * i / parts..count * (i + 1) / parts;
    if parts == 1 {
        return vec![work(part(0))];
    }
    thread::scope(|scope| {
        let work = &work;
        let beside: Vec<_> = (1..parts).map(|i| scope.spawn(move || work(part(i)))).collect();
        let first = work(part(0));
        std::iter::once(first).chain(beside.into_iter().map(joined)).collect()
    })
}

/// What a thread has worked out; where it has panicked, so does this one.
fn joined<T>(handle: thread::ScopedJoinHandle<'_, T>) -> T {
    handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_all_of_it_in_order() {
        for (count, products) in [(0, 0), (1, 100 * WORTH), (7, 0), (7, 2 * WORTH), (1000, 100 * WORTH)] {
            let parts = in_parts(count, products, Vec::from_iter);
            assert!(parts.len() <= processors());
            assert_eq!(parts.concat(), (0..count).collect::<Vec<usize>>());
        }
        assert_eq!(both(100 * WORTH, || 1, || 2), (1, 2));
    }
}
