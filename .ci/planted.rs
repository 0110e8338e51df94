//! Faults made on purpose, one a mode: the detectors that `.ci/run` relies on must find them, and must stay quiet on
//! the right program. Compiled by `.ci/run` alone, with a sanitizer; no part of the workspace.

use std::cell::UnsafeCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

struct Shared {
    value: UnsafeCell<u64>,
    full: AtomicBool,
}

// SAFETY: right as long as `full` hands `value` over; the mode `race` breaks that, and is to be found out.
unsafe impl Sync for Shared {}

fn pass(orderly: bool) -> u64 {
    let shared = Arc::new(Shared { value: UnsafeCell::new(0), full: AtomicBool::new(false) });
    let writer = Arc::clone(&shared);
    let thread = std::thread::spawn(move || {
        for n in 0..10_000 {
            while orderly && writer.full.load(Ordering::Acquire) {
                std::thread::yield_now();
            }
            // SAFETY: the reader takes `value` only while `full` is set.
            unsafe { *writer.value.get() = n };
            writer.full.store(true, Ordering::Release);
        }
    });
    let mut sum = 0;
    for _ in 0..10_000 {
        while orderly && !shared.full.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        // SAFETY: the writer fills `value` only while `full` is clear.
        sum += unsafe { *shared.value.get() };
        shared.full.store(false, Ordering::Release);
    }
    thread.join().expect("the writer does not panic");
    sum
}

fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("clean") => println!("{}", pass(true)),
        Some("race") => println!("{}", pass(false)),
        Some("beyond") => {
            let bytes = std::hint::black_box(vec![1_u8; 16]);
            // SAFETY: none: one byte beyond the end is what AddressSanitizer is to find.
            println!("{}", unsafe { bytes.as_ptr().add(16).read() });
        }
        _ => panic!("usage: planted clean|race|beyond"),
    }
}
