//! The live path allocates nothing: a counting allocator checks it.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_model::effect::{Dictionary, TemperatureDifference};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::record::Axis;
use std::alloc::{GlobalAlloc, Layout as Memory, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is passed on to the system's allocator unchanged; the counter is a thread's own and needs none.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Memory) -> *mut u8 {
        ALLOCATIONS.with(|a| a.set(a.get() + 1));
        // SAFETY: the caller's promise about the layout is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Memory) {
        // SAFETY: the memory came from the same allocator with this layout.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn evaluating_a_model_allocates_nothing() {
    let d = Dictionary::default();
    let mut effects = Vec::new();
    for (name, values) in [
        ("scale.x", &[12.0][..]),
        ("position_map.x", &[0.0, 50.0, 90.0, 1.0, 2.0, -1.0]),
        ("screw_periodic.x", &[5.0, 1.0, 0.3]),
        ("screw_slope.x", &[5.0, 6.0, 0.3]),
        ("reversal_slope.x", &[9.0]),
        ("reversal_spike.x", &[3.0, 2.0]),
        ("rotation.x.z", &[20.0]),
        ("thermal_lag.x", &[1.0, 0.1, 300.0]),
        ("warm_up.z", &[9.0, 600.0]),
    ] {
        let mut e = d.effect(name).unwrap();
        e.set_values(values).unwrap();
        e.delta = (name == "thermal_lag.x").then(|| TemperatureDifference::pair("T1", "T2"));
        effects.push(e);
    }
    let axes = vec![Axis::new("x").unwrap(), Axis::new("z").unwrap()];
    let layout = MachineStateLayout { axes, sensors: vec!["T1".into(), "T2".into()], channels: vec![] };
    let mut live = LiveModel::new(&effects, layout).unwrap();
    let before = ALLOCATIONS.with(Cell::get);
    let mut sum = 0.0;
    for i in 0..1000 {
        let t = f64::from(i) * 0.01;
        let axes =
            [AxisMotionState::moving(50.0 + 40.0 * t.sin(), 40.0 * t.cos()), AxisMotionState::moving(t, 1.0)];
        live.evaluate(&MachineState {
            t_s: t,
            axes: &axes,
            temperatures_degc: &[20.0 + t, 20.0],
            ..MachineState::default()
        });
        sum += live.errors_um().iter().sum::<f64>() + live.parts().map(|p| p.value[0]).sum::<f64>();
    }
    assert_eq!(ALLOCATIONS.with(Cell::get) - before, 0);
    assert!(sum.is_finite() && sum != 0.0);
}
