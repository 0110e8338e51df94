//! The latest state, for a reader that never stops the writer: a triple buffer.
//!
//! There are three slots. The writer owns one, the reader owns one, and the third is exchanged through one atomic byte.
//! Both sides are wait-free. The reader sees whole values only, and never an older one after a newer one.

#[cfg(loom)]
use loom::{
    cell::UnsafeCell,
    sync::Arc,
    sync::atomic::{AtomicU8, Ordering},
};
#[cfg(not(loom))]
use std::{
    sync::Arc,
    sync::atomic::{AtomicU8, Ordering},
};

use crossbeam_utils::CachePadded;

/// `std`'s cell with the interface of loom's, so that both builds share their code.
#[cfg(not(loom))]
#[derive(Debug)]
struct UnsafeCell<T>(std::cell::UnsafeCell<T>);

#[cfg(not(loom))]
impl<T> UnsafeCell<T> {
    const fn new(value: T) -> Self {
        Self(std::cell::UnsafeCell::new(value))
    }

    fn with<R>(&self, f: impl FnOnce(*const T) -> R) -> R {
        f(self.0.get())
    }

    fn with_mut<R>(&self, f: impl FnOnce(*mut T) -> R) -> R {
        f(self.0.get())
    }
}

/// The exchanged slot holds a value that the reader has not seen.
const FRESH: u8 = 4;
const SLOT: u8 = 3;

#[derive(Debug)]
struct SharedSlots<T> {
    /// Each slot is touched only by the side that owns it at the moment.
    slots: [CachePadded<UnsafeCell<T>>; 3],
    /// Index of the slot between the two sides, and [`FRESH`].
    /// Swapped by the writer at every write and by the reader when it takes a fresh value.
    between: CachePadded<AtomicU8>,
}

// SAFETY: a slot's index is held by the writer, the reader or `between`, never by two of them. Ownership passes by an
// acquire-release swap. So no slot is ever touched from two threads at once.
unsafe impl<T: Send> Sync for SharedSlots<T> {}

/// The side that writes.
#[derive(Debug)]
pub struct SnapshotWriter<T> {
    shared: Arc<SharedSlots<T>>,
    own: u8,
}

/// The side that reads.
#[derive(Debug)]
pub struct SnapshotReader<T> {
    shared: Arc<SharedSlots<T>>,
    own: u8,
}

/// A snapshot that begins as `value`, split into its two sides.
pub fn snapshot<T: Copy + Send>(value: T) -> (SnapshotWriter<T>, SnapshotReader<T>) {
    let slot = || CachePadded::new(UnsafeCell::new(value));
    let shared = Arc::new(SharedSlots {
        slots: [slot(), slot(), slot()],
        between: CachePadded::new(AtomicU8::new(1)),
    });
    (SnapshotWriter { shared: Arc::clone(&shared), own: 0 }, SnapshotReader { shared, own: 2 })
}

impl<T: Copy + Send> SnapshotWriter<T> {
    /// Makes `value` the latest. Never waits.
    #[inline]
    pub fn write(&mut self, value: T) {
        // SAFETY: `own` is in no other hand, see `Shared`.
        self.shared.slots[usize::from(self.own)].with_mut(|slot| unsafe { *slot = value });
        self.own = self.shared.between.swap(self.own | FRESH, Ordering::AcqRel) & SLOT;
    }
}

impl<T: Copy + Send> SnapshotReader<T> {
    /// The latest value. Never waits, and never holds the writer up.
    #[inline]
    pub fn read(&mut self) -> T {
        if self.shared.between.load(Ordering::Relaxed) & FRESH != 0 {
            self.own = self.shared.between.swap(self.own, Ordering::AcqRel) & SLOT;
        }
        // SAFETY: `own` is in no other hand, see `Shared`.
        self.shared.slots[usize::from(self.own)].with(|slot| unsafe { *slot })
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn without_a_new_value_the_latest_is_read_again() {
        let (mut writer, mut reader) = snapshot(0);
        for n in 1..10 {
            (0..n % 4).for_each(|k| writer.write(10 * n + k));
            let latest = reader.read();
            assert!(n % 4 == 0 || latest == 10 * n + n % 4 - 1);
            assert_eq!([reader.read(), reader.read()], [latest; 2]);
        }
    }

    #[test]
    fn the_latest_value_is_read_whole_and_never_runs_back() {
        let (mut writer, mut reader) = snapshot([0_u64; 16]);
        let writing = std::thread::spawn(move || {
            for n in 1..=100_000 {
                writer.write([n; 16]);
            }
        });
        let mut last = 0;
        while last < 100_000 {
            let value = reader.read();
            assert!(value.iter().all(|v| *v == value[0]) && value[0] >= last);
            last = value[0];
        }
        writing.join().unwrap();
    }
}

#[cfg(all(test, loom))]
mod tests {
    use super::*;

    #[test]
    fn every_interleaving_reads_whole_values_in_order() {
        loom::model(|| {
            let (mut writer, mut reader) = snapshot([0_u64; 2]);
            let writing = loom::thread::spawn(move || {
                for n in 1..=3 {
                    writer.write([n; 2]);
                }
            });
            let mut last = 0;
            for _ in 0..3 {
                let value = reader.read();
                assert!(value[0] == value[1] && value[0] >= last);
                last = value[0];
            }
            writing.join().unwrap();
            assert_eq!(reader.read(), [3, 3]);
        });
    }
}
