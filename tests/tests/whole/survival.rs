//! Failures that `rtecd` survives, as the MTC sees them (laws 2 and 3).
//! They are kills at any moment, a control side that stalls or is flooded, full disks and stepped clocks. There is no
//! jump and no illegal transition. The ledger balances, or a fault is latched.

use rtec_tests::daemon::{Bench, CONFIG, Daemon, EDGE, Machine, alone, program, until};
use rtec_tests::disk::SmallDisk;
use rtec_tests::supervisor::Trial;
use rtec_tests::{asked, skipped};
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Kills the daemon twenty times at random moments.
/// `RTEC_KILLS=1000` sets the number, and `RTEC_SEED` other moments.
#[test]
fn killed_twenty_times_it_leaves_no_jump_and_no_illegal_state() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("rtec.toml"), CONFIG.replace("CARD", "card")).unwrap();
    let machine = Machine::start(&at("card"));
    let rtecd = program("rtecd");
    let (kills, seed) = (asked("RTEC_KILLS", 20) as u32, asked("RTEC_SEED", 7));
    let trial = Trial { rtecd, config: at("rtec.toml"), socket: at("s"), kills, seed, within: 4 * EDGE };
    let tally = trial.run(&machine, std::io::stderr()).unwrap();
    println!("{tally:?}");
    assert!(tally.kills == kills && tally.halfway >= kills / 4 && tally.inverted >= 1, "{tally:?}");
    assert!(tally.faults.len() as u32 >= tally.halfway, "{tally:?}");
}

/// A process that ends with its test.
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
    // A full disk, and a pipe that is full because nobody reads it.
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let (_unread, writer) = std::io::pipe().unwrap();
    let flags = nix::fcntl::OFlag::O_NONBLOCK;
    nix::fcntl::fcntl(&writer, nix::fcntl::FcntlArg::F_SETFL(flags)).unwrap();
    while (&writer).write(&[b'.'; 4096]).is_ok() {}
    nix::fcntl::fcntl(&writer, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::empty())).unwrap();
    for stderr in [Stdio::from(full), Stdio::from(writer)] {
        let bench = Bench::default();
        let _daemon = Running(bench.command().stderr(stderr).spawn().unwrap());
        bench.go();
        bench.correct(2);
        bench.balances();
    }
}

#[test]
fn a_full_disk_is_an_error_before_the_start_and_nothing_after_it() {
    let _alone = alone();
    let bench = Bench::default();
    let Some(disk) = SmallDisk::mount(&bench.at("disk"), 16) else {
        return skipped("no file system can be mounted here");
    };
    let config = format!("{}[control]\nstate_file = 'disk/state'\n", CONFIG.replace("CARD", "card"));
    std::fs::write(bench.at("rtec.toml"), config).unwrap();
    disk.fill();
    let run = bench.command().output().unwrap();
    let text = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.code() == Some(1) && text.contains("state file"), "{:?} {text}", run.status);
    assert!(text.contains("No space left on device"), "{text}");

    disk.free();
    let daemon = bench.daemon();
    disk.fill();
    bench.go();
    bench.correct(6);
    bench.balances();
    daemon.end("KILL");
    // The next daemon finds the record on the disk that is still full.
    let _daemon = bench.daemon();
    bench.balances();
    assert_eq!(bench.x()["completed"], 6);
}

#[test]
fn a_daemon_that_was_stopped_for_a_while_latches_or_balances() {
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(2);
    assert_eq!(bench.user(&["correct", "x", "30"]).0, Some(0));
    daemon.pause(|| {
        // Edges that the stopped process cannot see.
        bench.edges(4);
        true
    });
    assert_eq!(bench.machine.illegal(), 0);
    // The control side may run again before the real-time thread does.
    until("what nobody saw is latched", || bench.x()["faults"].as_array().is_some_and(|all| !all.is_empty()));
    until("an insertion is finished", || !bench.machine.halfway());
    assert_eq!(bench.machine.illegal(), 0);
    assert_eq!(bench.user(&["status"]).0, Some(4));
}

#[test]
fn a_flooded_socket_changes_nothing_at_the_mtc() {
    let _alone = alone();
    let bench = Bench::default();
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

/// A library that changes the time of day for a process.
const LIBRARY: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1";

#[test]
fn a_stepped_clock_changes_nothing() {
    let _alone = alone();
    if !Path::new(LIBRARY).exists() {
        return skipped("libfaketime is not installed (Debian: faketime)");
    }
    let bench = Bench::default();
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
        // The step really shows in a process that reads the time of day.
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
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let bench = Bench::default();
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

    // An axis at rest gives no edge; `park` reports that, and gives up.
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

/// A stopped thread of a process; the other threads go on.
pub(crate) struct Stopped(i32);

impl Stopped {
    pub(crate) fn thread(tid: i32) -> Self {
        // SAFETY: both requests have no arguments and touch no memory of this process.
        let done = unsafe {
            libc::ptrace(libc::PTRACE_SEIZE, tid, 0, 0) == 0
                && libc::ptrace(libc::PTRACE_INTERRUPT, tid, 0, 0) == 0
        };
        assert!(done, "ptrace: {}", std::io::Error::last_os_error());
        let mut status = 0;
        // SAFETY: the call writes one integer that lives through it.
        let stopped = unsafe { libc::waitpid(tid, &raw mut status, libc::__WALL) };
        assert!(stopped == tid && libc::WIFSTOPPED(status), "{stopped} {status:#x}");
        Self(tid)
    }

    /// Waits until its process has ended, without letting it run.
    pub(crate) fn dies(self) {
        // SAFETY: a null pointer is allowed: nobody asks for the status.
        let ended = unsafe { libc::waitpid(self.0, std::ptr::null_mut(), libc::__WALL) };
        assert_eq!(ended, self.0);
        std::mem::forget(self);
    }
}

impl Drop for Stopped {
    fn drop(&mut self) {
        // SAFETY: as above; the thread goes on.
        unsafe { libc::ptrace(libc::PTRACE_DETACH, self.0, 0, 0) };
    }
}

#[test]
fn a_control_thread_that_stalls_alone_leaves_the_real_time_thread_at_work() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let bench = Bench::default();
    let daemon = bench.daemon();
    bench.go();
    bench.correct(2);
    assert_eq!(bench.user(&["correct", "x", "40"]).0, Some(0));
    let stopped = Stopped::thread(daemon.id() as i32);
    // Beyond `stale_ms`, half a second, and an insertion under way is finished.
    bench.edges(1500 / EDGE.as_millis() as u32);
    until("an insertion is finished", || !bench.machine.halfway());
    let frozen = bench.machine.offset();
    bench.edges(6);
    assert_eq!((bench.machine.offset(), bench.machine.illegal()), (frozen, 0), "no insertion begins");
    assert!((2..40).contains(&frozen), "{frozen}");
    drop(stopped);
    // The stall is named, the daemon answers again, and no edge of the meantime is lost.
    until("it is named", || daemon.log().contains("the control side is silent"));
    until("it answers again", || daemon.status()["rt"]["control_stale"] == false);
    let status = daemon.status();
    assert_eq!((&status["mode"], &status["balanced"]), (&"disabled".into(), &true.into()));
    // The return of the control side enables nothing.
    assert_eq!((bench.user(&["enable"]).0, bench.machine.offset()), (Some(0), frozen));
    until("corrections go on", || bench.machine.offset() > frozen);
    assert_eq!(bench.x()["faults"], serde_json::json!([]));
    bench.correct(2);
    bench.balances();
}

fn in_effect(bench: &Bench) -> i64 {
    bench.x()["in_effect"].as_i64().unwrap_or(i64::MIN)
}

/// A sensor on a line that is a file, which can go away.
struct Line {
    file: PathBuf,
    stop: Arc<AtomicBool>,
    writer: Option<JoinHandle<()>>,
}

impl Line {
    fn reading(file: &Path, degc: f64) -> Self {
        nix::unistd::mkfifo(file, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        // Opened for reading and writing, so that opening does not wait.
        let mut pipe = std::fs::File::options().read(true).write(true).open(file).unwrap();
        let end = Arc::clone(&stop);
        let writer = std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) && writeln!(pipe, "T1 {degc}").is_ok() {
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        Self { file: file.to_owned(), stop, writer: Some(writer) }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        std::fs::remove_file(&self.file).unwrap();
        self.stop.store(true, Ordering::Relaxed);
        self.writer.take().map(JoinHandle::join);
    }
}

#[test]
fn a_sensor_whose_file_goes_away_is_named_and_its_correction_stands() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let sensor = directory.path().join("sensor");
    let bench = Bench::with(&format!(
        "[model]\nfile = 'machine.toml'\nramp_um_s = 200\n[[sensor]]\nname = 'T1'\nplace = 'spindle'\nsource = 'line'\n\
         from = '{}'\nperiod_s = 0.2\ntimeout_s = 1\nfreeze_s = 2\nmax_rate_K_per_min = 10000\n",
        sensor.display()
    ));
    let growth = "name = 'bench'\n[[effect]]\nname = 'thermal_growth.x'\nsensor = 'T1'\nreference_degC = 20.0\num_per_K = 2.0\n";
    std::fs::write(bench.at("machine.toml"), growth).unwrap();
    let line = Line::reading(&sensor, 23.0);
    let daemon = bench.daemon();
    bench.go();
    let says = |what: &str| until(what, || bench.user(&["status"]).1.contains(what));
    says("sensors: 1 of 1 good");
    let (code, text) = bench.user(&["model", "load", "--yes"]);
    assert_eq!(code, Some(0), "{text}");
    until("the model's correction", || in_effect(&bench).abs() == 6);
    let grown = in_effect(&bench);

    drop(line);
    says("sensors: 0 of 1 good");
    until("its last good value stands", || {
        let (_, text) = bench.user(&["explain", "x"]);
        text.contains("sensor T1: ") && text.contains("its last good value is")
    });
    bench.balances();
    assert_eq!((in_effect(&bench), daemon.status()["mode"].clone()), (grown, "run".into()));

    // The sensor is back, and two degrees warmer.
    let _line = Line::reading(&sensor, 25.0);
    says("sensors: 1 of 1 good");
    says("sensor T1 is good again: `rtecctl enable` takes its correction up");
    assert_eq!((in_effect(&bench), bench.user(&["enable"]).0), (grown, Some(0)));
    until("the model goes on", || in_effect(&bench).abs() == 10);
    bench.balances();
}

#[test]
fn parking_with_a_model_takes_its_correction_out_and_leaves_it_out() {
    let _alone = alone();
    let bench = Bench::with("[model]\nfile = 'machine.toml'\nramp_um_s = 200\n");
    std::fs::write(bench.at("machine.toml"), "name = 'bench'\n[[effect]]\nname = 'offset.x'\num = 6.0\n")
        .unwrap();
    let daemon = bench.daemon();
    bench.go();
    assert_eq!(bench.user(&["model", "load", "--yes"]).0, Some(0));
    until("the model's correction", || in_effect(&bench).abs() == 6);
    bench.balances();
    let (code, text) = bench.user(&["park", "--to-zero"]);
    assert!(code == Some(0) && text.contains("the machine model is unloaded"), "{code:?} {text}");
    bench.balances();
    assert_eq!((bench.machine.offset(), daemon.status()["mode"].clone()), (0, "disabled".into()));
    assert!(text.contains("`rtecctl model again` takes it up again"), "{text}");
    let says = |text: &str| bench.user(&["status"]).1.contains(text);
    let unloaded = "the model was unloaded: `rtecctl model again` takes it up as it was";
    assert!(says(unloaded) && !says("`rtecctl model load`"));
    // Corrections are enabled again, and nothing moves by itself.
    let (code, text) = bench.user(&["enable"]);
    assert!(code == Some(0) && text.contains("nothing moves"), "{code:?} {text}");
    assert_eq!((bench.x()["requested"].clone(), in_effect(&bench)), (0.into(), 0));
    assert!(says(unloaded) && !says("`rtecctl model load`"));
    let (code, text) = bench.user(&["model", "again"]);
    assert_eq!(code, Some(0), "{text}");
    until("the model's correction", || in_effect(&bench).abs() == 6);
    assert!(!says(unloaded));
}
