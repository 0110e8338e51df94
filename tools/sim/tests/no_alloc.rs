//! The thread's loop allocates nothing: the allocator aborts while it runs.

#![allow(clippy::unwrap_used)]

use rtec_driver::card::{AxisLines, MachineLines};
use rtec_driver::clock::Virtual;
use rtec_driver::mock_card::MockCard;

use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::journal::Journal;
use rtec_rt::link::link;
use rtec_rt::link_messages::RequestToRt;
use rtec_sim::stroking_axes::{StrokeMotion, moving_axes};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Guard;

thread_local! {
    static FORBIDDEN: Cell<bool> = const { Cell::new(false) };
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Guard {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if FORBIDDEN.get() {
            eprintln!("an allocation of {} bytes in the loop", layout.size());
            std::process::abort();
        }
        // SAFETY: the caller's promise about the layout is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        if FORBIDDEN.get() {
            eprintln!("memory released in the loop");
            std::process::abort();
        }
        // SAFETY: the caller's promise about pointer and layout is passed on.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static GUARD: Guard = Guard;

/// A clock that advances by a fixed step at every look.
struct Ticking(Virtual);

impl rtec_driver::clock::Clock for Ticking {
    fn now_ns(&mut self) -> u64 {
        self.0.now_ns += 1000;
        self.0.now_ns
    }
}

/// The thread's loop allocates nothing in any of its work.
/// It moves axes, takes requests, refuses, latches faults, probes, and writes journal and link.
#[test]
fn the_loop_neither_allocates_nor_releases() {
    let motion =
        StrokeMotion { stroke_counts: 500.0, feed_counts_s: 20_000.0, dwell_s: 0.001, on_feedback: true };
    let lines = [0, 1, 2].map(|n| AxisLines::standard(n, true));
    let (axes, operator) = moving_axes(&lines.map(|l| (l, motion)), MachineLines::standard());
    let mut card = MockCard::new(axes, Ticking(Virtual::default()));
    let configs =
        lines.map(|lines| AxisConfig { lines, window_counts: 10, detect_ns: 5000, ..AxisConfig::default() });
    let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
    let mut engine = Engine::new(&mut card, &configs, machine, &[]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    engine.keep_journal(Journal::open(&folder.path().join("state"), "a machine").unwrap().0).unwrap();
    engine.start_homed(&mut card, &mut |_| true).unwrap();
    operator.cycle_start();
    let (mut control, mut rt) = link(engine.status());

    FORBIDDEN.set(true);
    for n in 0..200_000_i64 {
        if n % 2000 == 0 {
            let axis = (n / 2000 % 4) as u8;
            // Some within the window, some not, and some for an axis that does not exist.
            let total_counts = if n % 14_000 == 0 { 90 } else { n / 2000 % 9 };
            let _ = control.send(RequestToRt::Correct { axis, total_counts, large: false });
        }
        match n {
            150_000 => control.send(RequestToRt::Probe(true)).unwrap(),
            170_000 => control.send(RequestToRt::Probe(false)).unwrap(),
            180_000 => control.send(RequestToRt::Hold { on: true, by: 0 }).unwrap(),
            190_000 => control.send(RequestToRt::Clear).unwrap(),
            _ => {}
        }
        if let Some(request) = rt.request() {
            engine.take(request, &mut card, &mut |e| rt.report(e)).unwrap();
        }
        engine.poll(&mut card, u64::MAX, &mut |e| rt.report(e)).unwrap();
        if n % 1000 == 0 {
            rt.publish(engine.status());
        }
    }
    FORBIDDEN.set(false);

    let status = engine.status();
    assert!(status.axes().iter().map(|a| a.insertions).sum::<u64>() > 20, "{status:?}");
    assert!(status.balanced());
    assert!(control.event().is_some());
}
