//! `vm`: what is shown on a real `PREEMPT_RT` kernel in a virtual machine (`tests/vm/run`).
//!
//! ```text
//! vm guest [ITEM…]      in the machine, as root: every item, or these
//! vm card FILE          on the host: the far side of the PCI card whose BAR is this file
//! vm port LOG CONSOLE   on the host: what the emulated parallel port saw, against what was asked for in the machine
//! ```
//!
//! Each item prints `ITEM n: …` when all of it was as it should be. Behaviour only: time is emulated here.

use anyhow::{Context, ensure};
use gpiocdev::line::{Direction, Info as LineInfo};
use rtec_control::config::{Config, Measured};
use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample};
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::gpio::{Bias, Drive, GpioCard, GpioInput, GpioLine, GpioOutput, GpioSetup, LineId};
use rtec_driver::mapped::{MappedCard, Registers};
use rtec_driver::pci::{self, PciId};
use rtec_driver::port::Ports;
use rtec_driver::profile::{Profile, Space, Width};
use rtec_driver::quadrature::{Decoder, State};
use rtec_driver::registers::Bus;
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::event::Request;
use rtec_rt::setup;
use rtec_tests::daemon::{Daemon, Lines, Machine, program, until};
use rtec_tests::gpio_sim::{self, GpioSim};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let done = match args[..] {
        ["guest", ref items @ ..] => return guest(items),
        ["card", file] => far_side(Path::new(file)),
        ["port", log, console] => port_seen(Path::new(log), Path::new(console)),
        _ => Err(anyhow::anyhow!("usage: vm guest [ITEM…] | vm card FILE | vm port LOG CONSOLE")),
    };
    done.map_or_else(
        |error| {
            println!("FAILED: {error:#}");
            ExitCode::FAILURE
        },
        |()| ExitCode::SUCCESS,
    )
}

/// Runs every item; one that fails does not keep the next from running.
fn guest(items: &[&str]) -> ExitCode {
    // SAFETY: no other thread runs yet.
    unsafe { std::env::set_var("RTEC_PROGRAMS", "/bin") };
    let mut failed = false;
    let mut item = |n: u32, run: &dyn Fn() -> anyhow::Result<Vec<String>>| {
        if !items.is_empty() && !items.contains(&n.to_string().as_str()) {
            return;
        }
        let result = std::panic::catch_unwind(AssertUnwindSafe(run));
        match result.unwrap_or_else(|_| Err(anyhow::anyhow!("a check did not hold: see above"))) {
            Ok(lines) => lines.iter().for_each(|line| println!("ITEM {n}: {line}")),
            Err(error) => {
                println!("ITEM {n} FAILED: {error:#}");
                failed = true;
            }
        }
    };
    let chip = gpio_sim::make_chip("card", &LINES).map_err(|e| format!("{e:#}"));
    let chip = || chip.clone().map_err(|e| anyhow::anyhow!("gpio-sim: {e}"));
    item(1, &|| gpio(&chip()?));
    item(4, &|| real_time(&chip()?));
    item(3, &port);
    item(2, &mapped);
    item(5, &|| killed(&chip()?));
    item(6, &selftest);
    if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// Lines of the simulated chip, by name.
const LINES: [&str; 11] =
    ["X_A", "X_B", "X_IA", "X_IB", "HOLD", "PROBE", "DISABLE", "X_RA", "X_RB", "SPARE", "TAKEN"];
const A: u32 = 0;
const HOLD: u32 = 4;
const PROBE: u32 = 5;
const DISABLE: u32 = 6;
const BACK: [u32; 2] = [7, 8];

/// The axis is slow and the separation long. Daemon and machine are processes of an emulated computer that waits for
/// its turn, and each must see every change of the other.
/// The latencies are no measurement; they only have to be there.
const EDGE: Duration = Duration::from_millis(1600);
const AXIS: &str = "[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\n\
    window_counts = 50\nmin_separation_ns = 160000000\nmax_accel_counts_s2 = 0.56\nhysteresis_counts = 0.2\nrapid_mm_min = 1\n";
const RT: &str = "[rt]\ncpu = 1\npriority = 80\ndetect_ns = 1000000\nwrite_ns = 1000000\n";
const GPIO: &str =
    "backend = 'gpio'\nhold = 'HOLD'\nprobe = 'PROBE'\ndisable = { line = 'DISABLE', bias = 'pull-down' }\n";
const GPIO_LINES: &str = "lines = { a = 'X_A', b = 'X_B', invert_a = 'X_IA', invert_b = 'X_IB' }\n";

/// A directory with a configuration in it.
fn configured(card: &str, axis: &str) -> anyhow::Result<(tempfile::TempDir, PathBuf)> {
    let directory = tempfile::tempdir()?;
    let file = directory.path().join("rtec.toml");
    let text = format!("[machine]\nname = 'vm'\n[card]\n{card}{axis}{RT}");
    // Where a self-test would have measured the latencies: here, with this card. A card that is refused has no such place.
    let measured = match Config::parse(&file, &text) {
        Ok(config) => format!("{}\n", Measured::here(&config.card, 1, &setup::System::live())),
        Err(_) => String::new(),
    };
    fs::write(&file, text + &measured)?;
    Ok((directory, file))
}

/// A daemon with this card and axis.
fn daemon(card: &str, axis: &str) -> anyhow::Result<(Daemon, tempfile::TempDir)> {
    let (directory, file) = configured(card, axis)?;
    Ok((Daemon::start(&directory.path().join("s"), Some(&file)), directory))
}

/// Why a daemon with this card does not start: its exit code and what it says.
fn refused(card: &str, axis: &str) -> anyhow::Result<(Option<i32>, String)> {
    let (directory, file) = configured(card, axis)?;
    let mut command = Command::new(program("rtecd"));
    let run = command.arg("--config").arg(&file).arg("--socket").arg(directory.path().join("s")).output()?;
    Ok((run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned()))
}

fn faults(daemon: &Daemon) -> String {
    daemon.status()["axes"][0]["faults"].to_string()
}

/// Asks for a total and waits until it is done; the ledger balances.
fn corrected(daemon: &Daemon, counts: i64) {
    daemon.expect(0, &["correct", "x", &counts.to_string()]);
    until("completed", || {
        let status = daemon.status();
        assert_ne!(status["mode"], "fault", "{status}\n{}", daemon.log());
        status["axes"][0]["completed"] == counts
    });
    assert_eq!(daemon.status()["balanced"], true);
}

fn armed(daemon: &Daemon) {
    daemon.expect(0, &["home", "--controller-homed"]);
    daemon.expect(0, &["enable"]);
}

/// What the machine's controller has counted beyond the scale is what was asked for, through legal states only.
fn agreed(machine: &Machine, counts: i64) {
    until("the controller counts it", || {
        assert_eq!(machine.illegal(), 0, "illegal transitions at the controller");
        machine.offset() == counts
    });
}

// ---------------------------------------------------------------------------------------------------------- 1. gpio
fn gpio((chip, directory): &(String, PathBuf)) -> anyhow::Result<Vec<String>> {
    let mut said = Vec::new();
    let axis = format!("{AXIS}{GPIO_LINES}");

    // Somebody else has a line.
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
    // What must end at zero for the next daemon's machine to begin with both inverters off.
    corrected(&corrector, 0);
    agreed(&machine, 0);

    // A probe's trip: captured between the edges on both sides of it.
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
    // Released, it re-arms nothing: whoever operates does.
    until("corrections may be enabled", || {
        assert_eq!(corrector.status()["mode"], "disabled");
        corrector.user(&["enable"]).status.success()
    });
    until("corrections again", || corrector.status()["mode"] == "run");
    said.push("the disable switch stops corrections, and only `enable` lets them go on".to_owned());
    machine.move_axis(false);
    drop(machine);

    // A merged edge: the interrupts' threads are kept from running while two edges come.
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
        // What is queued must have been read before the faults are asked for.
        let polls = corrector.status()["rt"]["polls"].as_u64();
        until("the daemon looks again", || corrector.status()["rt"]["polls"].as_u64() > polls.map(|p| p + 5));
    }
    ensure!(corrector.status()["mode"] == "fault" && gpio_sim::level(directory, HOLD)?, "no feed hold");
    ensure!(corrector.status()["axes"][0]["homed"] == false, "still homed");
    said.push(format!("merged edges latch a sequence gap, feed hold and the loss of home (try {tries})"));

    // A full queue: the daemon is kept from reading while more edges come than the kernel holds.
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

    // Nothing of this keeps it from being homed and going on.
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

/// A' and B' wired back: gates that do not follow, and gates that do.
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

    // Gates that follow, with edges and with levels.
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

/// Lines that are active low, with bias and drive, as the kernel has them; levels instead of edges.
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

/// What the kernel says of a line.
fn line_is(chip: &str, line: u32, wanted: impl Fn(&LineInfo) -> bool) -> anyhow::Result<()> {
    let chip = gpiocdev::Chip::from_name(chip).map_err(|e| anyhow::anyhow!("{chip}: {e}"))?;
    let info = chip.line_info(line).map_err(|e| anyhow::anyhow!("line {line}: {e}"))?;
    ensure!(wanted(&info), "{info:?}");
    Ok(())
}

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator, counted per thread.
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

/// The engine on real GPIO edges, with insertions, in this very thread: nothing is allocated or released per edge.
fn allocates_nothing(chip: &str, directory: &Path) -> anyhow::Result<String> {
    let line = |name: &str| GpioLine {
        chip: Some(chip.to_owned()),
        line: LineId::Name(name.to_owned()),
        active_low: false,
        bias: None,
        drive: None,
    };
    let input = |name, bit| GpioInput { line: line(name), bit, group: 0, edges: true };
    let output = |name, bit| GpioOutput { line: line(name), bit };
    let setup = GpioSetup {
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
        engine.take(Request::Correct { axis: 0, total_counts, large: true }, &mut card, &mut |_| true)?;
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

/// Waits until no inverter is on: what this chip does when the last request of a line is closed.
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

// ----------------------------------------------------------------------------------------------------- 4. real time
/// Reads the set-up from the kernel, not from the daemon's own report.
fn real_time((chip, _): &(String, PathBuf)) -> anyhow::Result<Vec<String>> {
    let axis = format!("{AXIS}{GPIO_LINES}");
    let (corrector, held) = daemon(GPIO, &axis)?;
    let process = PathBuf::from(format!("/proc/{}", corrector.id()));
    let mut thread = None;
    for task in fs::read_dir(process.join("task"))?.flatten() {
        if fs::read_to_string(task.path().join("comm"))?.trim() == "rtec-rt" {
            thread = Some(task.path());
        }
    }
    let thread = thread.context("no thread rtec-rt")?;
    let stat = fs::read_to_string(thread.join("stat"))?;
    // proc_pid_stat(5): after the name in parentheses field 3; 40 is the real-time priority, 41 the policy.
    let after = stat.rsplit_once(')').context("stat")?.1;
    let fields: Vec<&str> = after.split_whitespace().collect();
    ensure!((fields[37], fields[38]) == ("80", "1"), "priority {}, policy {}", fields[37], fields[38]);
    let status = fs::read_to_string(thread.join("status"))?;
    let value = |key: &str| status.lines().find_map(|l| l.strip_prefix(key)).map_or("", str::trim).to_owned();
    ensure!(value("Cpus_allowed_list:") == "1", "CPUs {}", value("Cpus_allowed_list:"));
    let locked: u64 = value("VmLck:").trim_end_matches(" kB").parse().unwrap_or(0);
    ensure!(locked > 1000, "{locked} kB locked");
    let mut latency = [0; 4];
    std::io::Read::read_exact(&mut fs::File::open("/dev/cpu_dma_latency")?, &mut latency)?;
    ensure!(latency == [0; 4], "cpu_dma_latency {latency:?}");
    let holds = fs::read_dir(process.join("fd"))?.flatten();
    let held_open = holds
        .filter_map(|fd| fs::read_link(fd.path()).ok())
        .any(|to| to == Path::new("/dev/cpu_dma_latency"));
    ensure!(held_open, "nobody holds /dev/cpu_dma_latency");
    ensure!(fs::read_to_string("/sys/kernel/realtime")?.trim() == "1", "no PREEMPT_RT kernel");
    let mut said = vec![format!(
        "from /proc: SCHED_FIFO 80, CPU 1, {locked} kB locked, cpu_dma_latency 0 held open, PREEMPT_RT"
    )];
    ensure!(corrector.status()["rt"]["may_arm"] == true, "{}", corrector.status()["rt"]);
    drop((corrector, held));

    // Without privileges: it runs, it names what is missing, and it cannot be armed.
    let (directory, file) = configured(GPIO, &axis)?;
    let (user, group) = (1000, 1000);
    for path in [directory.path(), &file, &Path::new("/dev").join(chip)] {
        std::os::unix::fs::chown(path, Some(user), Some(group))?;
    }
    let socket = directory.path().join("s");
    let mut command = Command::new(program("rtecd"));
    std::os::unix::process::CommandExt::uid(&mut command, user);
    command.arg("--config").arg(&file).arg("--socket").arg(&socket);
    // Spoken to as its own user: root trusts no stranger's process.
    let corrector = Daemon::spawn_for(Some((program("rtecctl"), user)), &mut command, &socket);
    let missing = corrector.status()["rt"]["missing"].to_string();
    for what in ["scheduler", "memory_lock", "CAP_SYS_NICE"] {
        ensure!(missing.contains(what), "{what} is not named: {missing}");
    }
    corrector.expect(0, &["home", "--controller-homed"]);
    ensure!(corrector.expect(1, &["enable"]).contains("real-time set-up"), "{}", corrector.log());
    said.push("without privileges it runs, names what is missing, and refuses to be armed".to_owned());
    Ok(said)
}

// ------------------------------------------------------------------------------------------------------ 3. the port
/// What the two ways to the port must write to its data lines: +4 counts (A and B equal: A first), then -2 (B first).
const PORT_WRITES: [(&str, &[u8]); 2] = [("ppdev", &[1, 3, 2, 0]), ("ioperm", &[2, 3])];

fn port() -> anyhow::Result<Vec<String>> {
    // Its inputs cannot be driven here: the axis stands still, and is corrected at rest.
    let axis = AXIS.replace("min_separation_ns = 160000000", "min_separation_ns = 1000000")
        + "rest_policy = 'insert'\nrest_quiet_ms = 5\n\
           lines = { a = 'nerror', b = 'select', invert_a = 'd0', invert_b = 'd1' }\n";
    let mut said = Vec::new();
    for (place, way, counts) in [("parport = '/dev/parport0'", "ppdev", 4), ("io = 0x378", "ioperm", -2)] {
        let (corrector, _held) = daemon(&format!("backend = 'port'\n{place}\n"), &axis)?;
        armed(&corrector);
        corrected(&corrector, counts);
        said.push(format!("{way}: {counts:+} counts at rest, ledger balances"));
    }
    let (code, text) = refused(
        "backend = 'port'\nprofile = '8255-pci'\n",
        &axis.replace(
            "'nerror', b = 'select', invert_a = 'd0', invert_b = 'd1'",
            "'pa0', b = 'pa1', invert_a = 'pc0', invert_b = 'pc1'",
        ),
    )?;
    ensure!(code == Some(3) && text.contains("no PCI card 144a:7224"), "{code:?}: {text}");
    said.extend(io_bar()?);
    Ok(said)
}

/// A PCI card of I/O ports: QEMU's `pci-serial`.
///
/// A 16550 looped back on itself: its modem outputs are its modem inputs, where the machine sets A and B.
/// Its scratch register holds the inverters. Its line control must be set up once.
const UART: &str = "name = 'a 16550 as a card'\nsource = 'PC16550D datasheet: line control at 3, modem control at 4, modem status \
    at 6, scratch at 7; bit 4 of modem control loops back'\n\
    inputs = [{ register = 6, width = 8 }]\noutputs = [{ register = 7, width = 8 }]\n\
    [lines]\ncts = { input = 4 }\ndsr = { input = 5 }\ns0 = { output = 0 }\ns1 = { output = 1 }\n\
    [pci]\nid = '1b36:0002'\nbar = 0\nspace = 'io'\n\
    [[setup]]\nregister = 3\nwidth = 8\nvalue = 0x03\nafter_reset = 0x00\n";
const LINE_CONTROL: usize = 3;
const MODEM_CONTROL: usize = 4;
const SCRATCH: usize = 7;

/// The far side of that card.
struct Uart(Ports);

impl Uart {
    fn set(&self, register: usize, value: u32) -> anyhow::Result<()> {
        Ok(self.0.write(register, Width::Bits8, value)?)
    }

    fn get(&self, register: usize) -> anyhow::Result<u32> {
        Ok(self.0.read(register, Width::Bits8)?)
    }
}

impl Lines for Uart {
    fn outputs(&mut self) -> u64 {
        u64::from(self.get(SCRATCH).unwrap_or(0))
    }

    fn show(&mut self, scale: State) {
        // DTR comes back as DSR, RTS as CTS. A write to a port that this thread has cannot fail.
        let _ = self.set(MODEM_CONTROL, 0x10 | u32::from(scale.bits()));
    }
}

fn io_bar() -> anyhow::Result<Vec<String>> {
    let directory = tempfile::tempdir()?;
    let profile = directory.path().join("uart.toml");
    fs::write(&profile, UART)?;
    let card = format!("backend = 'port'\nprofile = '{}'\n", profile.display());
    let axis = format!("{AXIS}lines = {{ a = 'dsr', b = 'cts', invert_a = 's0', invert_b = 's1' }}\n");
    let uart = pci::find(&PciId::Card(0x1b36, 2))?;

    // The kernel's own driver has it.
    let (code, text) = refused(&card, &axis)?;
    let held = format!("PCI card {} is in the hands of the kernel's driver serial", uart.address);
    ensure!(code == Some(3) && text.contains(&held), "{code:?}: {text}");
    // The remedy, as it is printed.
    let remedy =
        text.split("free the card: ").nth(1).context("no remedy")?.lines().next().unwrap_or("").trim();
    let freed = Command::new("/bin/sh").args(["-ec", remedy]).output()?;
    ensure!(freed.status.success(), "{remedy}: {}", String::from_utf8_lossy(&freed.stderr));

    let base = uart.prepare(0, Space::Io, 8)?.start as u16;
    let far = Uart(Ports::open(base, 8)?);
    let look = Uart(Ports::open(base, 8)?);
    for (register, value) in [(LINE_CONTROL, 0x1b), (SCRATCH, 0), (MODEM_CONTROL, 0x10)] {
        far.set(register, value)?;
    }
    let (code, text) = refused(&card, &axis)?;
    ensure!(
        code == Some(3) && text.contains("register 0x3 reads 0x1b, expected 0x3 (set up)"),
        "{code:?}: {text}"
    );
    ensure!(look.get(LINE_CONTROL)? == 0x1b, "it was written to all the same");
    far.set(LINE_CONTROL, 0)?;
    let machine = Machine::paced(far, EDGE);
    let (corrector, held) = daemon(&card, &axis)?;
    ensure!(look.get(LINE_CONTROL)? == 3, "not set up");
    armed(&corrector);
    machine.move_axis(true);
    for counts in [4, 0] {
        corrected(&corrector, counts);
        agreed(&machine, counts);
    }
    // Killed with the inverters on: they stay, and the successor takes them over.
    corrected(&corrector, 2);
    agreed(&machine, 2);
    corrector.end("KILL");
    ensure!(look.get(SCRATCH)? == 3, "the inverters are {:#x}", look.get(SCRATCH)?);
    let corrector = Daemon::start(&held.path().join("s"), Some(&held.path().join("rtec.toml")));
    ensure!(corrector.status()["axes"][0]["completed"] == 2, "{}", corrector.status());
    agreed(&machine, 2);
    let probed = corrector.expect(0, &["status"]);
    ensure!(probed.contains("ledger balances"), "{probed}");
    Ok(vec![
        "a PCI card that the kernel's driver has is refused, and freed by the command that is printed"
            .to_owned(),
        "I/O BAR by in and out: set up once, +4 counts and back, killed with inverters on and taken over"
            .to_owned(),
    ])
}

/// The emulated port's own record: the last data writes of each way, in order, one line at a time.
fn port_seen(log: &Path, console: &Path) -> anyhow::Result<()> {
    let console = fs::read_to_string(console)?;
    ensure!(
        console.lines().filter(|l| l.starts_with("ITEM 3: ") && l.contains("at rest")).count() == 2,
        "the port was not driven"
    );
    let text = fs::read_to_string(log).with_context(|| format!("{}", log.display()))?;
    let hex = |word: &str| u8::from_str_radix(word.trim_start_matches("0x"), 16).ok();
    let data: Vec<u8> = text
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace().skip_while(|w| *w != "addr").skip(1);
            let (address, _, value) = (words.next()?, words.next()?, words.next()?);
            // The inverters' two bits; the third is the feed hold.
            (hex(address)? % 8 == 0).then(|| hex(value).map(|v| v & 3))?
        })
        .collect();
    let mut from = 0;
    for (way, wanted) in PORT_WRITES {
        let found = data[from..].windows(wanted.len()).position(|w| w == wanted);
        let at = found.with_context(|| {
            format!("{way}: no {wanted:02x?} among the data writes {:02x?}", &data[from..])
        })?;
        from += at + wanted.len();
        println!("the emulated port saw, by {way}: {wanted:02x?}");
    }
    ensure!(from == data.len(), "writes that change nothing, or nobody asked for: {:02x?}", &data[from..]);
    Ok(())
}

// ---------------------------------------------------------------------------------------------------- 2. the PCI card
/// Words of the card's memory beside its registers (profile shared-memory: inputs at 0, outputs at 4).
const TICK: usize = 0x10;
const SEEN: usize = 0x14;
const PHASE: usize = 0x18;
const AT: usize = 0x1c;
const OFFSET: usize = 0x20;
const ILLEGAL: usize = 0x24;
const SCALE: usize = 0x28;
const BUSY: usize = 0x2c;
const BYTES: usize = 0x40;
/// What the far side is to do.
const SLOW: u32 = 1;
const STEPPED: u32 = 2;
const END: u32 = 3; // said by the host, when the machine is off

/// Counts of the stepped run, and its unit of time: a count takes six units, some 40 000 counts/s. An insertion takes four
/// of them; the last one shows that the second inversion is in effect.
const COUNTS: u32 = 1_000_000;
const COUNT_STEPS: u32 = 6;
const STEP_NS: u64 = 4_000;

/// The card's far side, on the host: does what the guest asks for until it is told to end.
fn far_side(file: &Path) -> anyhow::Result<()> {
    let words = Registers::open(file, BYTES, "far side")?;
    let phase = || words.read(PHASE, Width::Bits32);
    let say = |offset: i64, illegal: u64| {
        words.write(OFFSET, Width::Bits32, offset as u32);
        words.write(ILLEGAL, Width::Bits32, illegal as u32);
    };
    let (mut illegal, mut counts) = (0, 0);
    loop {
        let now = phase();
        match now {
            SLOW => {
                let machine = Machine::paced(Registers::open(file, 8, "machine")?, EDGE);
                machine.move_axis(true);
                words.write(AT, Width::Bits32, now);
                while phase() == now {
                    say(machine.offset(), machine.illegal());
                    std::thread::sleep(Duration::from_millis(1));
                }
                illegal += machine.illegal();
            }
            STEPPED => {
                let (scale, mtc) = in_step(&words, &say, &phase);
                println!(
                    "far side, in step: scale {scale}, controller {}, {} illegal",
                    mtc.count(),
                    mtc.illegal()
                );
                illegal += mtc.illegal();
                counts += scale;
            }
            END => break,
            _ => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    println!("far side of the PCI card: {counts} counts in step, {illegal} illegal transitions in all");
    ensure!(illegal == 0 && counts >= i64::from(COUNTS), "not what was asked for");
    Ok(())
}

/// In step with the guest: time goes on only when the guest has looked and acted.
///
/// It goes on by one unit while the guest has something to do, else to two units before the next edge. An edge right
/// after a late look may be as old as that look, and has no period.
fn in_step(words: &Registers, say: &impl Fn(i64, u64), phase: &impl Fn() -> u32) -> (i64, Decoder) {
    let lines = AxisLines::standard(0, false);
    let (mut state, mut mtc, mut scale, mut tick) =
        (State::default(), Decoder::new(State::default()), 0_i64, 0_u32);
    words.write(0, Width::Bits32, 0);
    words.write(AT, Width::Bits32, STEPPED);
    while phase() == STEPPED {
        let outputs = || u64::from(words.read(4, Width::Bits32));
        let idle = words.read(BUSY, Width::Bits32) == 0;
        tick += if idle { (COUNT_STEPS - 2).saturating_sub(tick % COUNT_STEPS).max(1) } else { 1 };
        // Beyond what is counted the axis goes on, so that the last request can still be served.
        if tick.is_multiple_of(COUNT_STEPS) {
            state = state.next(true);
            scale += 1;
            words.write(0, Width::Bits32, u32::from(state.bits()));
            mtc.update(state.inverted(lines.inverters(outputs())));
        }
        words.write(TICK, Width::Bits32, tick);
        let mut spins = 0_u64;
        while words.read(SEEN, Width::Bits32) != tick && phase() == STEPPED {
            spins += 1;
            // The guest may need this CPU to go on.
            if spins.is_multiple_of(4096) {
                std::thread::yield_now();
            }
        }
        mtc.update(state.inverted(lines.inverters(outputs())));
        say(mtc.count() - scale, mtc.illegal());
        words.write(SCALE, Width::Bits32, scale as u32);
    }
    (scale, mtc)
}

/// Time as the far side counts it.
struct FarTime(Registers);

impl Clock for FarTime {
    fn now_ns(&mut self) -> u64 {
        u64::from(self.0.read(TICK, Width::Bits32)) * STEP_NS
    }
}

/// The card under test, looked at once for every step of the far side.
struct InStep {
    card: MappedCard<FarTime>,
    words: Registers,
    tick: u32,
}

impl Card for InStep {
    fn sample(&mut self, wake_ns: u64) -> Result<Sample, CardError> {
        let now_ns = u64::from(self.tick) * STEP_NS;
        let busy = wake_ns < now_ns + u64::from(COUNT_STEPS) * STEP_NS;
        self.words.write(BUSY, Width::Bits32, u32::from(busy));
        self.words.write(SEEN, Width::Bits32, self.tick);
        while self.words.read(TICK, Width::Bits32) == self.tick {
            std::hint::spin_loop();
        }
        self.tick = self.words.read(TICK, Width::Bits32);
        self.card.sample(wake_ns)
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.card.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.card.outputs()
    }
}

/// The card's BAR, once enabled: mapped, and its file in sysfs.
fn bar() -> anyhow::Result<(Registers, PathBuf)> {
    let profile = Profile::shared_memory();
    let place = profile.pci.context("the profile's place on the bus")?;
    let card = pci::find(&PciId::Card(place.id.0, place.id.1))?;
    let file = card.prepare(place.bar, Space::Memory, BYTES)?.file;
    Ok((Registers::open(&file, BYTES, "vm")?, file))
}

fn phase(words: &Registers, phase: u32) {
    words.write(PHASE, Width::Bits32, phase);
    until("the far side follows", || words.read(AT, Width::Bits32) == phase);
}

fn mapped() -> anyhow::Result<Vec<String>> {
    let mut said = Vec::new();
    let (words, file) = bar()?;
    said.push(through_rtecd(&words, "pci = '1af4:1110'\nbar = 2", "PCI 1af4:1110, BAR 2 by sysfs")?);
    let (code, text) = refused("backend = 'mapped'\npci = '1af4:1110'\nbar = 1\n", &on_card())?;
    ensure!(code == Some(3) && text.contains("BAR 1: found none"), "{code:?}: {text}");
    said.push(a_million(&words, &file)?);
    drop(words);

    // A driver that shows the BARs as UIO maps takes the card; the mapping by sysfs is no longer valid then.
    // Kept away by the override that README names, until it is taken back.
    let device = file.parent().context("a directory")?;
    fs::write(device.join("driver_override"), "pci-stub")?;
    fs::write("/sys/bus/pci/drivers/hilscher/new_id", "1af4 1110")?;
    ensure!(!device.join("driver").exists(), "a driver took the card in spite of driver_override");
    said.push("driver_override keeps other drivers away".to_owned());
    fs::write(device.join("driver_override"), "\n")?;
    let address = device.file_name().and_then(|n| n.to_str()).context("an address")?;
    fs::write("/sys/bus/pci/drivers/hilscher/bind", address)?;
    let uio = Path::new("/dev/uio0");
    until("the UIO device", || uio.exists());
    let words = Registers::open_map(uio, 1, BYTES, "vm")?;
    said.push(through_rtecd(&words, "uio = '/dev/uio0'\nmap = 1", "the same BAR by UIO")?);
    Ok(said)
}

fn on_card() -> String {
    format!("{AXIS}lines = {{ a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }}\n")
}

/// A few counts through the daemon, with a slow machine on the far side.
fn through_rtecd(words: &Registers, card: &str, way: &str) -> anyhow::Result<String> {
    phase(words, SLOW);
    let (corrector, _held) = daemon(&format!("backend = 'mapped'\n{card}\n"), &on_card())?;
    armed(&corrector);
    for counts in [4, 0] {
        corrected(&corrector, counts);
        until("the controller counts it", || {
            assert_eq!(words.read(ILLEGAL, Width::Bits32), 0, "illegal transitions at the controller");
            i64::from(words.read(OFFSET, Width::Bits32) as i32) == counts
        });
    }
    Ok(format!("{way}: +4 counts and back through rtecd, ledger balances"))
}

/// A million counts with the engine itself, in step with the far side.
fn a_million(words: &Registers, file: &Path) -> anyhow::Result<String> {
    phase(words, STEPPED);
    let clock = FarTime(Registers::open(file, BYTES, "vm")?);
    let card = MappedCard::open(file, &Profile::shared_memory(), clock)?;
    let mut card = InStep { card, words: Registers::open(file, BYTES, "vm")?, tick: 0 };
    let axis = AxisConfig {
        max_correction_counts: 100_000,
        detect_ns: STEP_NS,
        write_ns: STEP_NS,
        ..AxisConfig::default()
    };
    let config = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(&mut card, &[axis], config, &[])?;
    let report = &mut |_| true;
    engine.start_homed(&mut card, report)?;
    let (mut requests, mut looks) = (0, 0_u64);
    loop {
        engine.poll(&mut card, u64::MAX, report)?;
        looks += 1;
        if !looks.is_multiple_of(500) {
            continue;
        }
        let axis = engine.status().axes[0];
        ensure!(!axis.faults.any(), "{:?}", axis.faults.iter().collect::<Vec<_>>());
        let last = words.read(SCALE, Width::Bits32) >= COUNTS;
        if last && axis.completed == 0 && axis.requested == 0 && engine.at_rest() {
            break;
        }
        requests += 1;
        let total_counts = if last { 0 } else { 2 * ((f64::from(requests) / 40.0).sin() * 200.0) as i64 };
        engine.take(Request::Correct { axis: 0, total_counts, large: true }, &mut card, report)?;
    }
    let (axis, balanced) = (engine.status().axes[0], engine.status().balanced());
    let counted = i64::from(words.read(OFFSET, Width::Bits32) as i32);
    ensure!(balanced && counted == axis.completed, "{counted}, {axis:?}");
    ensure!(words.read(ILLEGAL, Width::Bits32) == 0, "illegal transitions at the controller");
    ensure!(axis.insertions > 1000, "{} insertions only", axis.insertions);
    Ok(format!(
        "{} counts of the scale, {requests} requests, {} insertions; ledger balances, controller minus scale {counted}",
        words.read(SCALE, Width::Bits32),
        axis.insertions,
    ))
}

// ---------------------------------------------------------------------------------------------------------- 5. killed
fn killed((_, directory): &(String, PathBuf)) -> anyhow::Result<Vec<String>> {
    let (held, file) = configured(GPIO, &format!("{AXIS}{GPIO_LINES}"))?;
    let run = Command::new("/bin/supervisor")
        .args([
            "--rtecd",
            "/bin/rtecd",
            "--edge-ms",
            "1600",
            "--lines",
            "0",
            "1",
            "2",
            "3",
            "--kills",
            "20",
            "--config",
        ])
        .arg(&file)
        .arg("--socket")
        .arg(held.path().join("s"))
        .arg("--gpio-sim")
        .arg(directory)
        .output()
        .context("/bin/supervisor")?;
    let text = String::from_utf8_lossy(&run.stdout);
    ensure!(run.status.success(), "{text}{}", String::from_utf8_lossy(&run.stderr));
    Ok(text.lines().map(str::to_owned).collect())
}

// -------------------------------------------------------------------------------------------------------- 6. self-test
fn selftest() -> anyhow::Result<Vec<String>> {
    let run = Command::new(program("rtecctl"))
        .args(["selftest", "latency", "--duration", "2s", "--cpu", "1", "--json"])
        .output()?;
    let text = String::from_utf8_lossy(&run.stdout);
    let document: serde_json::Value =
        serde_json::from_str(&text).with_context(|| String::from_utf8_lossy(&run.stderr).into_owned())?;
    ensure!(run.status.code() == Some(1) && document["verdict"] == "fail", "{:?}: {text}", run.status.code());
    ensure!(text.contains("emulated time is no evidence for any machine"), "{text}");
    Ok(vec![format!("it runs, fails, and says: emulated time is no evidence ({})", document["emulated"])])
}
