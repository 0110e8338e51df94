//! `vm`: checks on a real `PREEMPT_RT` kernel in a virtual machine.
//! `tests/vm/run` starts them.
//!
//! ```text
//! vm guest [ITEM…]      in the machine, as root: every item, or these
//! vm card FILE          on the host: the far side of the PCI card whose BAR is this file
//! vm port LOG CONSOLE   on the host: compares the emulated port's log with the requests made in the machine
//! ```
//!
//! Each item prints `ITEM n: …` when it passes. Only behaviour is checked, because time is emulated here.

mod gpio;
mod mapped;
mod port;
mod real_time;

use anyhow::{Context, ensure};
use gpio::gpio;
use mapped::{far_side, mapped};
use port::{port, port_seen};
use real_time::real_time;
use rtec_control::config::{Config, LatencyTestConditions};
use rtec_rt::realtime_setup;
use rtec_tests::daemon::{Daemon, Machine, program, until};
use rtec_tests::gpio_sim::{self};
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

/// Runs every item, also after one that fails.
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

/// Time between two edges, long for an emulated computer.
/// The axis is slow and the separation long. Daemon and machine are processes that wait for their turn, and each must
/// see every change of the other. The latencies are placeholders, not measurements.
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
    // The self-test would have measured the latencies here with this card. A card that is refused has no such file.
    let measured = match Config::parse(&file, &text) {
        Ok(config) => {
            format!("{}\n", LatencyTestConditions::here(&config.card, 1, &realtime_setup::SystemRoot::live()))
        }
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

/// Exit code and message of a daemon that does not start with this card.
fn refused(card: &str, axis: &str) -> anyhow::Result<(Option<i32>, String)> {
    let (directory, file) = configured(card, axis)?;
    let mut command = Command::new(program("rtecd"));
    let run = command.arg("--config").arg(&file).arg("--socket").arg(directory.path().join("s")).output()?;
    Ok((run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned()))
}

fn faults(daemon: &Daemon) -> String {
    daemon.status()["axes"][0]["faults"].to_string()
}

/// Requests a total and waits until it is completed and the ledger balances.
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

/// Checks that the controller counts the total beyond the scale, in legal states.
fn agreed(machine: &Machine, counts: i64) {
    until("the controller counts it", || {
        assert_eq!(machine.illegal(), 0, "illegal transitions at the controller");
        machine.offset() == counts
    });
}

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
