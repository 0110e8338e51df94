//! The GPIO backend on the kernel's simulated chip.

use super::{
    A, AXIS, BACK, DISABLE, EDGE, GPIO, GPIO_LINES, HOLD, PROBE, agreed, armed, corrected, daemon, faults,
    refused,
};
use anyhow::{Context, ensure};
use gpiocdev::line::{Direction, Info as LineInfo};
use rtec_driver::card::MachineLines;
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::gpio::{
    Bias, Drive, GpioCard, GpioCardConfig, GpioInputConfig, GpioLineId, GpioLineSettings, GpioOutputConfig,
};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::RequestToRt;
use rtec_tests::daemon::{Machine, until};
use rtec_tests::gpio_sim::{self, GpioSim};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub(super) fn gpio((chip, directory): &(String, PathBuf)) -> anyhow::Result<Vec<String>> {
    let mut said = Vec::new();
    let axis = format!("{AXIS}{GPIO_LINES}");

    // Another program has a line.
    let taken = gpiocdev_request(chip, 10, "somebody-else")?;
    let (code, text) = refused(GPIO, &format!("{AXIS}{}", GPIO_LINES.replace("X_B", "TAKEN")))?;
    ensure!(code == Some(3) && text.contains("is taken by \"somebody-else\""), "{code:?}: {text}");
    drop(taken);
    let (code, text) = refused(GPIO, &format!("{AXIS}{}", GPIO_LINES.replace("X_B", "X_Q")))?;
    ensure!(code == Some(3) && text.contains("there is no line \"X_Q\""), "{code:?}: {text}");
    said.push(
        "a line taken by somebody else is named with its holder, a line that is not there too".to_owned(),
    );

    // The closed loop, edge by edge.
    let machine = Machine::paced(GpioSim::open(directory, &[0, 1, 2, 3])?, EDGE);
    let (corrector, held) = daemon(GPIO, &axis)?;
    armed(&corrector);
    machine.move_axis(true);
    for counts in [8, -4] {
        corrected(&corrector, counts);
        agreed(&machine, counts);
    }
    said.push(
        "edges: +8 and then -4 counts requested, completed, counted by the controller; ledger balances"
            .to_owned(),
    );
    // Ends at zero, so that the next daemon's machine begins with both inverters off.
    corrected(&corrector, 0);
    agreed(&machine, 0);

    // A probe's trip is captured between the edges on both sides of it.
    corrector.expect(0, &["probe", "on", "--captures", "0"]);
    until("probing", || corrector.status()["mode"] == "probe");
    gpio_sim::pull(directory, PROBE, true)?;
    until("the trip is reported", || corrector.log().contains("probe tripped at"));
    gpio_sim::pull(directory, PROBE, false)?;
    corrector.expect(0, &["probe", "off"]);
    until("corrections again", || corrector.status()["mode"] == "run");
    said.push("the probe's trip is captured".to_owned());

    // The disable switch.
    gpio_sim::pull(directory, DISABLE, true)?;
    until("the switch is seen", || corrector.status()["mode"] == "disabled");
    gpio_sim::pull(directory, DISABLE, false)?;
    // Its release enables nothing; the operator does that.
    until("corrections may be enabled", || {
        assert_eq!(corrector.status()["mode"], "disabled");
        corrector.user(&["enable"]).status.success()
    });
    until("corrections again", || corrector.status()["mode"] == "run");
    said.push("the disable switch stops corrections, and only `enable` lets them go on".to_owned());
    machine.move_axis(false);
    drop(machine);

    // A merged edge: two edges come while the interrupt threads cannot run.
    let threads = interrupt_threads()?;
    policy(&threads, libc::SCHED_IDLE, 0)?;
    let mut tries = 0;
    while !faults(&corrector).contains("sequence_gap") {
        tries += 1;
        ensure!(tries <= 50, "no gap in the sequence after {tries} tries: {}", faults(&corrector));
        corrector.expect(0, &["clear"]);
        for n in 0..200 {
            gpio_sim::pull(directory, A, n % 2 == 0)?;
        }
        // The queued edges must be read before the faults are checked.
        let polls = corrector.status()["rt"]["polls"].as_u64();
        until("the daemon looks again", || corrector.status()["rt"]["polls"].as_u64() > polls.map(|p| p + 5));
    }
    ensure!(corrector.status()["mode"] == "fault" && gpio_sim::level(directory, HOLD)?, "no feed hold");
    ensure!(corrector.status()["axes"][0]["homed"] == false, "still homed");
    said.push(format!("merged edges latch a sequence gap, feed hold and the loss of home (try {tries})"));

    // A full queue: more edges come than the kernel keeps while the daemon cannot read.
    policy(&threads, libc::SCHED_FIFO, 50)?;
    corrector.expect(0, &["clear"]);
    until("nothing latched", || corrector.status()["mode"] != "fault");
    corrector.signal("STOP");
    for n in 0..1500 {
        gpio_sim::pull(directory, A, n % 2 == 0)?;
    }
    corrector.signal("CONT");
    until("the overflow is latched", || faults(&corrector).contains("queue_overflow"));
    said.push("1500 edges during a stop: the queue's overflow is latched".to_owned());

    // After these faults it can be homed again and continues.
    corrector.expect(0, &["clear"]);
    until("nothing latched", || corrector.status()["mode"] != "fault");
    until("a standstill", || {
        corrector.status()["axes"][0]["edge_rate_hz"].as_f64().is_some_and(|r| r < 50.0)
    });
    corrector.expect(0, &["home", "--controller-homed"]);
    until("homed", || corrector.status()["axes"][0]["homed"] == true);
    let (code, log) = corrector.end("TERM");
    ensure!(code == Some(0), "{code:?}: {log}");
    drop(held);

    said.extend(gates(directory, &axis)?);
    said.extend(active_low(chip, directory, &axis)?);
    said.push(allocates_nothing(chip, directory)?);
    Ok(said)
}

/// A' and B' read back: gates that do not follow, and gates that do.
fn gates(directory: &Path, axis: &str) -> anyhow::Result<Vec<String>> {
    let mut said = Vec::new();
    let wired_back =
        axis.replace("invert_b = 'X_IB'", "invert_b = 'X_IB', read_back_a = 'X_RA', read_back_b = 'X_RB'");
    let machine = Machine::paced(GpioSim::open(directory, &[0, 1, 2, 3])?, EDGE);
    let (corrector, held) = daemon(GPIO, &wired_back)?;
    armed(&corrector);
    machine.move_axis(true);
    corrector.expect(0, &["correct", "x", "2"]);
    until("the read-back is missed", || faults(&corrector).contains("read_back_mismatch"));
    drop((corrector, held, machine));
    said.push("A' and B' that stay as they were latch a read-back mismatch".to_owned());
    released(directory)?;

    // Gates that follow, read by edges and by levels.
    for mode in ["edges", "levels"] {
        let lines = GpioSim::open(directory, &[0, 1, 2, 3])?.wired_back(directory, BACK)?;
        let machine = Machine::paced(lines, EDGE);
        let (corrector, held) = daemon(&format!("{GPIO}mode = '{mode}'\n"), &wired_back)?;
        armed(&corrector);
        machine.move_axis(true);
        for counts in [4, 0] {
            corrected(&corrector, counts);
            agreed(&machine, counts);
        }
        ensure!(faults(&corrector) == "[]", "{mode}: {}", faults(&corrector));
        drop((corrector, held, machine));
        released(directory)?;
    }
    said.push(
        "A' and B' that follow, read back with edges and with levels: +4 counts and back, no fault"
            .to_owned(),
    );
    Ok(said)
}

/// Active-low lines with bias and drive, as the kernel reports them.
/// The axis is read by levels instead of edges.
fn active_low(chip: &str, directory: &Path, axis: &str) -> anyhow::Result<Vec<String>> {
    for (line, up) in [(2, true), (3, true), (DISABLE, true)] {
        gpio_sim::pull(directory, line, up)?;
    }
    let low = axis
        .replace("'X_A'", "{ line = 'X_A', active_low = true, bias = 'pull-up' }")
        .replace("'X_B'", "{ line = 'X_B', active_low = true, bias = 'pull-up' }")
        .replace("'X_IA'", "{ line = 'X_IA', active_low = true }")
        .replace("'X_IB'", "{ line = 'X_IB', active_low = true }");
    let card = GPIO.replace("hold = 'HOLD'", "hold = { line = 'HOLD', drive = 'open-drain' }");
    let machine = Machine::paced(GpioSim::open(directory, &[0, 1, 2, 3])?.active_low(), EDGE);
    let (corrector, _held) = daemon(&format!("{card}mode = 'levels'\n"), &low)?;
    line_is(chip, 0, |l| l.active_low && l.bias == Some(Bias::PullUp) && l.direction == Direction::Input)?;
    line_is(chip, 2, |l| l.active_low && l.direction == Direction::Output && l.consumer == "rtec")?;
    line_is(chip, HOLD, |l| !l.active_low && l.drive == Some(Drive::OpenDrain))?;
    line_is(chip, DISABLE, |l| l.bias == Some(Bias::PullDown))?;
    ensure!(gpio_sim::pulled(directory, DISABLE)? == "pull-down", "the bias did not reach the line");
    armed(&corrector);
    machine.move_axis(true);
    corrected(&corrector, 4);
    agreed(&machine, 4);
    corrected(&corrector, 0);
    agreed(&machine, 0);
    machine.move_axis(false);
    drop((corrector, machine));
    released(directory)?;
    Ok(vec![
        "levels, active low: +4 counts and back, ledger balances; bias and open drain are the kernel's own"
            .to_owned(),
    ])
}

/// Checks the kernel's information on a line.
fn line_is(chip: &str, line: u32, wanted: impl Fn(&LineInfo) -> bool) -> anyhow::Result<()> {
    let chip = gpiocdev::Chip::from_name(chip).map_err(|e| anyhow::anyhow!("{chip}: {e}"))?;
    let info = chip.line_info(line).map_err(|e| anyhow::anyhow!("line {line}: {e}"))?;
    ensure!(wanted(&info), "{info:?}");
    Ok(())
}

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator with a count per thread.
struct Counting;

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise about the layout is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise about pointer and layout is passed on.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// Runs the engine on real GPIO edges in this thread, with insertions.
/// Nothing is allocated or released per edge.
fn allocates_nothing(chip: &str, directory: &Path) -> anyhow::Result<String> {
    let line = |name: &str| GpioLineSettings {
        chip: Some(chip.to_owned()),
        line: GpioLineId::Name(name.to_owned()),
        active_low: false,
        bias: None,
        drive: None,
    };
    let input = |name, bit| GpioInputConfig { line: line(name), bit, group: 0, edges: true };
    let output = |name, bit| GpioOutputConfig { line: line(name), bit };
    let setup = GpioCardConfig {
        inputs: vec![input("X_A", 0), input("X_B", 1)],
        outputs: vec![output("X_IA", 0), output("X_IB", 1)],
        events: true,
    };
    let machine = Machine::paced(GpioSim::open(directory, &[0, 1, 2, 3])?, Duration::from_millis(20));
    let mut card = GpioCard::open(&setup, Vec::new(), Monotonic)?;
    let axis = AxisConfig { max_accel_counts_s2: 100.0, ..AxisConfig::default() };
    let config = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(&mut card, &[axis], config, &[])?;
    engine.start_homed(&mut card, &mut |_| true)?;
    machine.move_axis(true);
    let (mut edges, mut insertions, mut allocations) = (0, 0, 0);
    let mut at = engine.status().axes[0].position_counts;
    while edges < 300 || insertions < 5 {
        let total_counts = if edges / 40 % 2 == 0 { 10 } else { -10 };
        let before = ALLOCATIONS.get();
        engine.take(RequestToRt::Correct { axis: 0, total_counts, large: true }, &mut card, &mut |_| true)?;
        let by_ns = Monotonic.now_ns() + 20_000_000;
        engine.poll(&mut card, by_ns, &mut |_| true)?;
        let axis = engine.status().axes[0];
        allocations += ALLOCATIONS.get() - before;
        ensure!(!axis.faults.any(), "{:?}", axis.faults.iter().collect::<Vec<_>>());
        edges += u64::from(axis.position_counts != at);
        (at, insertions) = (axis.position_counts, axis.insertions);
    }
    ensure!(allocations == 0, "{allocations} allocations in {edges} edges");
    Ok(format!(
        "{edges} edges with {insertions} insertions by the engine itself: nothing allocated or released"
    ))
}

/// Waits until no inverter is on.
/// This chip switches a line off when its last request is closed.
fn released(directory: &Path) -> anyhow::Result<()> {
    for line in [2, 3] {
        gpio_sim::pull(directory, line, false)?;
    }
    until("the inverters are off", || {
        [2, 3].iter().all(|l| gpio_sim::level(directory, *l).is_ok_and(|l| !l))
    });
    Ok(())
}

/// Takes a line as another program would.
fn gpiocdev_request(chip: &str, offset: u32, consumer: &str) -> anyhow::Result<gpiocdev::Request> {
    let request = gpiocdev::Request::builder()
        .on_chip(Path::new("/dev").join(chip))
        .with_consumer(consumer)
        .with_line(offset)
        .as_input()
        .request();
    request.map_err(|e| anyhow::anyhow!("taking line {offset}: {e}"))
}

/// The kernel's threads that handle the interrupts of our lines.
fn interrupt_threads() -> anyhow::Result<Vec<i32>> {
    let mut threads = Vec::new();
    for entry in fs::read_dir("/proc")?.flatten() {
        let name = entry.file_name().into_string().unwrap_or_default();
        let comm = fs::read_to_string(entry.path().join("comm")).unwrap_or_default();
        if comm.starts_with("irq/") && comm.trim_end().ends_with("rtec") {
            threads.push(name.parse().context("a process number")?);
        }
    }
    ensure!(!threads.is_empty(), "no interrupt thread of ours among the processes");
    Ok(threads)
}

fn policy(threads: &[i32], policy: i32, priority: i32) -> anyhow::Result<()> {
    let parameter = libc::sched_param { sched_priority: priority };
    for thread in threads {
        // SAFETY: the call reads the parameter and changes nothing of this process.
        let done = unsafe { libc::sched_setscheduler(*thread, policy, &raw const parameter) };
        ensure!(done == 0, "changing the scheduler of {thread}: {}", std::io::Error::last_os_error());
    }
    Ok(())
}
