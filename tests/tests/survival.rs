//! What `rtecd` survives, and what the MTC sees of it (laws 2 and 3): kills at any moment, a control side that stalls or is
//! flooded, full disks, stepped clocks. Not one jump, not one illegal transition; the ledger balances or a fault is latched.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_tests::daemon::{CONFIG, Daemon, Machine, program, until, user};
use rtec_tests::skipped;
use rtec_tests::supervisor::Trial;
use serde_json::Value;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Each daemon keeps a CPU busy: one at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[test]
fn killed_twenty_times_it_leaves_no_jump_and_no_illegal_state() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("rtec.toml"), CONFIG.replace("CARD", "card")).unwrap();
    let machine = Machine::start(&at("card"));
    let rtecd = program("rtecd");
    let trial = Trial { rtecd, config: at("rtec.toml"), socket: at("s"), kills: 20, seed: 7 };
    let tally = trial.run(&machine, std::io::stderr()).unwrap();
    assert!(tally.kills == 20 && tally.halfway >= 5 && tally.inverted >= 1, "{tally:?}");
    assert!(tally.faults.len() as u32 >= tally.halfway, "{tally:?}");
}

/// A bench: machine and controller on a card of shared memory.
struct Bench {
    machine: Machine,
    directory: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let directory = tempfile::tempdir().unwrap();
        std::fs::write(directory.path().join("rtec.toml"), CONFIG.replace("CARD", "card")).unwrap();
        Self { machine: Machine::start(&directory.path().join("card")), directory }
    }

    fn at(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    fn command(&self) -> Command {
        let mut command = Command::new(program("rtecd"));
        command.arg("--config").arg(self.at("rtec.toml")).arg("--socket").arg(self.at("s"));
        command
    }

    fn daemon(&self) -> Daemon {
        Daemon::spawn(&mut self.command(), &self.at("s"))
    }

    fn user(&self, args: &[&str]) -> (Option<i32>, String) {
        let run = user(&self.at("s"), args);
        (run.status.code(), String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned())
    }

    fn x(&self) -> Value {
        let run = user(&self.at("s"), &["status", "--json"]);
        let status: Value = serde_json::from_slice(&run.stdout).unwrap_or_default();
        status["axes"][0].clone()
    }

    /// Sets the axis going, homes it and enables corrections.
    fn go(&self) {
        self.machine.move_axis(true);
        let place = || self.x()["position_counts"].as_i64();
        until("an answer", || place().is_some());
        let from = place().unwrap();
        until("two edges", || place().is_some_and(|p| (p - from).abs() >= 2));
        assert_eq!(self.user(&["home"]).0, Some(0));
        assert_eq!(self.user(&["enable"]).0, Some(0));
    }

    fn correct(&self, counts: i64) {
        let (code, text) = self.user(&["correct", "x", &counts.to_string(), "--large"]);
        assert_eq!(code, Some(0), "{text}");
        until("completed", || self.x()["completed"] == counts);
    }

    /// The MTC has what the daemon says, and has seen nothing illegal.
    fn balances(&self) {
        until("an insertion is finished", || !self.machine.halfway());
        self.machine.look_twice();
        assert_eq!(self.machine.illegal(), 0);
        assert_eq!(self.x()["in_effect"], self.machine.offset());
    }
}

/// A process that is ended with its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_log_that_is_full_or_not_read_stops_nothing() {
    let _alone = alone();
    // A disk that is full, and a pipe that is full because nobody reads it.
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let (_unread, writer) = std::io::pipe().unwrap();
    let flags = nix::fcntl::OFlag::O_NONBLOCK;
    nix::fcntl::fcntl(&writer, nix::fcntl::FcntlArg::F_SETFL(flags)).unwrap();
    while (&writer).write(&[b'.'; 4096]).is_ok() {}
    nix::fcntl::fcntl(&writer, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::empty())).unwrap();
    for stderr in [Stdio::from(full), Stdio::from(writer)] {
        let bench = Bench::new();
        let _daemon = Running(bench.command().stderr(stderr).spawn().unwrap());
        bench.go();
        bench.correct(2);
        bench.balances();
    }
}

/// A file system that goes with its test.
struct Mounted(PathBuf);

impl Drop for Mounted {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_is_an_error_before_the_start_and_nothing_after_it() {
    let _alone = alone();
    let bench = Bench::new();
    let disk = bench.at("disk");
    std::fs::create_dir(&disk).unwrap();
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=16k", "tmpfs"]).arg(&disk).output();
    if !mount.is_ok_and(|m| m.status.success()) {
        return skipped("no file system can be mounted here");
    }
    let _mounted = Mounted(disk.clone());
    let config = format!("{}[control]\nstate_file = 'disk/state'\n", CONFIG.replace("CARD", "card"));
    std::fs::write(bench.at("rtec.toml"), config).unwrap();
    let fill = || {
        let mut file = std::fs::File::create(disk.join("fill")).unwrap();
        while file.write(&[0; 1024]).is_ok_and(|n| n > 0) {}
    };
    fill();
    let run = bench.command().output().unwrap();
    let text = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code() == Some(1) && text.contains("state file"), "{:?} {text}", run.status);
    assert!(text.contains("No space left on device"), "{text}");

    std::fs::remove_file(disk.join("fill")).unwrap();
    let daemon = bench.daemon();
    fill();
    bench.go();
    bench.correct(6);
    bench.balances();
    daemon.end("KILL");
    // Its successor finds the record, on the disk that is still full.
    let _daemon = bench.daemon();
    bench.balances();
    assert_eq!(bench.x()["completed"], 6);
}

#[test]
fn a_daemon_that_was_stopped_for_a_while_latches_or_balances() {
    let _alone = alone();
    let bench = Bench::new();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(2);
    assert_eq!(bench.user(&["correct", "x", "30"]).0, Some(0));
    daemon.signal("STOP");
    // Long enough for edges that nobody sees.
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(bench.machine.illegal(), 0);
    daemon.signal("CONT");
    let status = daemon.status();
    until("an insertion is finished", || !bench.machine.halfway());
    assert_eq!(bench.machine.illegal(), 0);
    let faults = bench.x()["faults"].as_array().unwrap().len();
    assert!(faults > 0, "edges were missed, and nothing is latched: {status}\n{}", daemon.log());
    assert_eq!(bench.user(&["status"]).0, Some(4));
}

#[test]
fn a_flooded_socket_changes_nothing_at_the_mtc() {
    let _alone = alone();
    let bench = Bench::new();
    let daemon = bench.daemon();
    bench.go();
    let deaf: Vec<_> = (0..4).map(|_| UnixStream::connect(bench.at("s")).unwrap()).collect();
    let flood = "{\"do\":\"correct\",\"axis\":\"x\",\"total_counts\":4}\n".repeat(2000);
    for mut stream in &deaf {
        stream.set_nonblocking(true).unwrap();
        while stream.write(flood.as_bytes()).is_ok_and(|n| n > 0) {}
    }
    bench.correct(4);
    bench.balances();
    assert!(!daemon.log().contains("control side is silent"), "{}", daemon.log());
}

/// A judge of what the time of day may do to a process.
const LIBRARY: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1";

#[test]
fn a_stepped_clock_changes_nothing() {
    let _alone = alone();
    if !Path::new(LIBRARY).exists() {
        return skipped("libfaketime is not installed (Debian: faketime)");
    }
    let bench = Bench::new();
    let clock = bench.at("clock");
    let stepped = |command: &mut Command| {
        command.env("LD_PRELOAD", LIBRARY).env("FAKETIME_TIMESTAMP_FILE", &clock);
        command.env("FAKETIME_NO_CACHE", "1").env("DONT_FAKE_MONOTONIC", "1");
    };
    let step = |by: &str| std::fs::write(&clock, by).unwrap();
    step("+0d\n");
    let mut command = bench.command();
    stepped(&mut command);
    let daemon = Daemon::spawn(&mut command, &bench.at("s"));
    bench.go();
    for (by, counts) in [("+4000d\n", 2), ("-4000d\n", 4)] {
        step(by);
        bench.correct(counts);
        bench.balances();
        // The step is really there for a process that asks for the time of day.
        let mut date = Command::new("date");
        stepped(date.arg("+%s"));
        let shown = String::from_utf8(date.output().unwrap().stdout).unwrap();
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
        let shown: u64 = shown.trim().parse().unwrap();
        assert!(shown.abs_diff(now) > 3000 * 86400, "{shown} {now}");
    }
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["rt"]["control_stale"]), (&"run".into(), &false.into()));
}

#[test]
fn parking_freezes_or_takes_the_correction_out_in_gated_steps() {
    let _alone = alone();
    let bench = Bench::new();
    let daemon = bench.daemon();
    assert!(bench.user(&["park", "--patience", "1s"]).1.contains("--to-zero"));
    bench.go();
    bench.correct(6);
    // Frozen: nothing moves, and nothing can be taken out while corrections are off.
    let (code, text) = bench.user(&["park"]);
    assert!(code == Some(0) && text.contains("frozen"), "{text}");
    bench.balances();
    assert_eq!(bench.x()["in_effect"], 6);
    let (code, text) = bench.user(&["park", "--to-zero"]);
    assert!(code == Some(1) && text.contains("corrections are off: `rtecctl enable`"), "{code:?} {text}");

    // At rest an axis gives no edge: it says so, and gives up.
    assert_eq!(bench.user(&["enable"]).0, Some(0));
    bench.machine.move_axis(false);
    let (code, text) = bench.user(&["park", "--to-zero", "--patience", "2s"]);
    assert!(code == Some(1) && text.contains("axis x: +6 counts left"), "{code:?} {text}");
    assert!(text.contains("jog it"), "{text}");
    assert_eq!(bench.x()["in_effect"], 6);

    bench.machine.move_axis(true);
    let (code, text) = bench.user(&["park", "--to-zero"]);
    assert!(code == Some(0) && text.contains("nothing is in effect"), "{code:?} {text}");
    bench.balances();
    assert_eq!((bench.machine.offset(), &daemon.status()["mode"]), (0, &"disabled".into()));
}
