//! A real `rtecd`, a user with `rtecctl`, and a machine on a shared-memory card.

use rtec_driver::card::AxisLines;
use rtec_driver::card_profile::Width;
use rtec_driver::mapped_registers::MappedRegisterFile;
use rtec_driver::quadrature::{Decoder, State};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest time that anything here may take. No test is judged by its duration.
const PATIENCE: Duration = Duration::from_secs(60);

/// A program of this workspace, built in the profile of the running test.
/// Without cargo, `RTEC_PROGRAMS` names the directory that holds it.
pub fn program(name: &str) -> PathBuf {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    let directory = BUILT.get_or_init(|| {
        if let Some(directory) = std::env::var_os("RTEC_PROGRAMS") {
            return directory.into();
        }
        // …/target[/TRIPLE]/PROFILE/deps/TEST
        let test = std::env::current_exe().unwrap_or_default();
        let profile = test.ancestors().nth(2).unwrap_or(Path::new("")).to_owned();
        let mut cargo = Command::new(env!("CARGO"));
        // Builds all at once, as the run of all tests has done. Fewer packages would need other features of their
        // dependencies.
        cargo.args(["build", "--quiet", "--workspace", "--bins", "--examples"]).current_dir(crate::root());
        // Removes what cargo sets for the running test's crate. Otherwise build scripts that read it run again, and
        // their dependants are built again. The user's settings for cargo stay, because other settings would make
        // another build.
        let told = |name: &str| {
            ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_CRATE_", "CARGO_BIN_", "CARGO_CFG_"]
                .iter()
                .any(|p| name.starts_with(p))
                || matches!(name, "CARGO_PRIMARY_PACKAGE" | "CARGO_TARGET_TMPDIR")
        };
        for (name, _) in std::env::vars_os().filter(|(n, _)| n.to_str().is_some_and(told)) {
            cargo.env_remove(name);
        }
        if profile.ends_with("release") {
            cargo.arg("--release");
        }
        if let Some(triple) = profile.parent().and_then(Path::file_name).and_then(|n| n.to_str())
            && triple.contains("-linux-")
        {
            cargo.args(["--target", triple]);
        }
        assert!(cargo.status().is_ok_and(|s| s.success()), "rtecd and rtecctl could not be built");
        profile
    });
    directory.join(name)
}

/// Waits until `is` returns true.
pub fn until(what: &str, mut is: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is() {
        assert!(begun.elapsed() < PATIENCE, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A running daemon with a directory of its own.
#[derive(Debug)]
pub struct Daemon {
    child: Child,
    socket: PathBuf,
    log: Arc<Mutex<String>>,
    reader: Option<JoinHandle<()>>,
    /// Copy of `rtecctl` and user that speak to the daemon, where they are not ours.
    speaker: Option<(PathBuf, u32)>,
}

impl Daemon {
    /// Starts a daemon and waits until it answers.
    pub fn start(socket: &Path, config: Option<&Path>) -> Self {
        let mut command = Command::new(program("rtecd"));
        command.arg("--socket").arg(socket);
        if let Some(config) = config {
            command.arg("--config").arg(config);
        }
        Self::spawn(&mut command, socket)
    }

    /// A daemon on the embedded default, homed and enabled.
    pub fn enabled(socket: &Path) -> Self {
        let daemon = Self::start(socket, None);
        daemon.expect(0, &["home"]);
        daemon.expect(0, &["enable"]);
        daemon
    }

    /// Starts `command` as the daemon of `socket`.
    pub fn spawn(command: &mut Command, socket: &Path) -> Self {
        Self::spawn_for(None, command, socket)
    }

    /// The same, with a copy of `rtecctl` that a user of this number runs.
    pub fn spawn_for(speaker: Option<(PathBuf, u32)>, command: &mut Command, socket: &Path) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap_or_else(|e| panic!("{command:?}: {e}"));
        let log = Arc::new(Mutex::new(String::new()));
        let stderr = child.stderr.take().map(BufReader::new);
        let to = Arc::clone(&log);
        let reader = std::thread::spawn(move || {
            for line in stderr.into_iter().flat_map(BufRead::lines).map_while(Result::ok) {
                if let Ok(mut log) = to.lock() {
                    log.push_str(&line);
                    log.push('\n');
                }
            }
        });
        let mut daemon = Self { child, socket: socket.to_owned(), log, reader: Some(reader), speaker };
        until("the daemon answers", || {
            if let Ok(Some(status)) = daemon.child.try_wait() {
                panic!("rtecd ended with {status}: {}", daemon.log());
            }
            daemon.user(&["status", "--json"]).status.code() != Some(3)
        });
        daemon
    }

    /// The log so far.
    pub fn log(&self) -> String {
        self.log.lock().map(|log| log.clone()).unwrap_or_default()
    }

    /// The control socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// The daemon's process number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Runs `rtecctl` on it.
    pub fn user(&self, args: &[&str]) -> Output {
        let Some((rtecctl, uid)) = &self.speaker else { return user(&self.socket, args) };
        let mut command = Command::new(rtecctl);
        command.args(args).arg("--socket").arg(&self.socket).uid(*uid).gid(*uid);
        command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"))
    }

    /// Runs `rtecctl`, expects an exit code, and returns both outputs.
    #[track_caller]
    pub fn expect(&self, code: i32, args: &[&str]) -> String {
        let run = self.user(args);
        let text =
            format!("{}{}", String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
        assert_eq!(run.status.code(), Some(code), "rtecctl {args:?}: {text}\nlog: {}", self.log());
        text
    }

    /// The status as a JSON document.
    #[track_caller]
    pub fn status(&self) -> Value {
        let run = self.user(&["status", "--json"]);
        let found: Value = serde_json::from_slice(&run.stdout)
            .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&run.stderr)));
        assert!(found["format"] == 1 && found["by"].is_string(), "no format and writer: {found}");
        found
    }

    /// Sends the daemon a signal, by its name without `SIG`.
    pub fn signal(&self, name: &str) {
        let _ = Command::new("kill").arg(format!("-{name}")).arg(self.child.id().to_string()).status();
    }

    /// Stops the process until `long_enough` returns true.
    pub fn pause(&self, long_enough: impl FnMut() -> bool) {
        self.signal("STOP");
        let stat = || std::fs::read_to_string(format!("/proc/{}/stat", self.id())).unwrap_or_default();
        until("it is stopped", || stat().contains(") T "));
        until("that is long enough", long_enough);
        self.signal("CONT");
    }

    /// Sends a signal, waits for the end, and returns exit code and log.
    pub fn end(mut self, signal: &str) -> (Option<i32>, String) {
        self.signal(signal);
        let code = self.child.wait().ok().and_then(|s| s.code());
        if let Some(reader) = self.reader.take() {
            let _ = reader.join();
        }
        (code, self.log())
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Runs `rtecctl` on the daemon of a socket.
pub fn user(socket: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(program("rtecctl"));
    command.args(args).arg("--socket").arg(socket);
    command.output().unwrap_or_else(|e| panic!("{command:?}: {e}"))
}

/// Counts and outputs at the machine's end of a shared-memory card.
#[derive(Debug, Default)]
pub struct FarSideCounts {
    /// The scale's count, counts.
    pub scale: AtomicI64,
    /// The controller's count minus the scale's.
    pub offset: AtomicI64,
    /// Illegal transitions that the controller has seen.
    pub illegal: AtomicU64,
    /// Outputs of the card.
    pub outputs: AtomicU64,
    /// Number of the machine's looks at its lines.
    pub looks: AtomicU64,
}

/// The card's lines as the machine sees them, for one axis.
/// A and B are bits 0 and 1 of the inputs, their inverters bits 0 and 1 of the outputs.
pub trait Lines: Send {
    /// The inverters as the corrector has written them.
    fn outputs(&mut self) -> u64;
    /// Sets A (bit 0) and B (bit 1).
    fn show(&mut self, scale: State);
    /// Sets A' and B', on cards to which they are wired back.
    fn show_mtc(&mut self, _mtc: State) {}
}

/// Shared memory with the registers of the profile `shared-memory`.
impl Lines for MappedRegisterFile {
    fn outputs(&mut self) -> u64 {
        u64::from(self.read(4, Width::Bits32))
    }

    fn show(&mut self, scale: State) {
        self.write(0, Width::Bits32, u32::from(scale.bits()));
    }
}

/// One axis at the end of a card, which moves to and fro while it may.
#[derive(Debug)]
pub struct Machine {
    /// Counts of machine and controller, for the test to read.
    pub seen: Arc<FarSideCounts>,
    moving: Arc<AtomicBool>,
    glitch: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Time between two edges.
/// It is slow, and the separation in [`CONFIG`] is long. Daemon and controller are ordinary processes here, and each
/// must see every single change of the other.
pub const EDGE: Duration = Duration::from_millis(120);

/// A configuration for a [`Machine`]; `CARD` stands for the file of registers.
pub const CONFIG: &str = "[machine]\nname = 'bench'\n[card]\nbackend = 'mapped'\nfile = 'CARD'\nhold = 'out28'\n\
    probe = 'in28'\ndisable = 'in29'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\n\
    window_counts = 50\nmin_separation_ns = 16000000\nmax_accel_counts_s2 = 56\nhysteresis_counts = 0.2\n\
    lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }\n";

impl Machine {
    /// Makes the file of registers and starts the machine on it, at rest.
    pub fn start(card: &Path) -> Self {
        let made = std::fs::File::create(card).and_then(|f| f.set_len(4096));
        assert!(made.is_ok(), "{made:?}");
        Self::on(shared_memory(card))
    }

    /// Starts the machine on a card's lines, at rest.
    pub fn on(card: impl Lines + 'static) -> Self {
        Self::paced(card, EDGE)
    }

    /// The same, with this time between two edges.
    pub fn paced(mut card: impl Lines + 'static, between: Duration) -> Self {
        let seen = Arc::new(FarSideCounts::default());
        let [moving, glitch, stop] = [(); 3].map(|()| Arc::new(AtomicBool::new(false)));
        let (show, go, both, end) =
            (Arc::clone(&seen), Arc::clone(&moving), Arc::clone(&glitch), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            let lines = AxisLines::standard(0, false);
            let (mut state, mut scale, mut up) = (State::default(), 0_i64, true);
            let mut mtc = Decoder::new(State::default());
            let mut edge = Instant::now();
            while !end.load(Ordering::Relaxed) {
                let outputs = card.outputs();
                mtc.update(state.inverted(lines.inverters(outputs)));
                card.show_mtc(mtc.state());
                if both.swap(false, Ordering::Relaxed) {
                    state = state.inverted(3);
                } else if go.load(Ordering::Relaxed) && edge.elapsed() >= between {
                    edge = Instant::now();
                    up = if scale >= 20 { false } else { up || scale <= -20 };
                    state = state.next(up);
                    scale += if up { 1 } else { -1 };
                }
                card.show(state);
                mtc.update(state.inverted(lines.inverters(outputs)));
                card.show_mtc(mtc.state());
                show.scale.store(scale, Ordering::Relaxed);
                show.offset.store(mtc.count() - scale, Ordering::Relaxed);
                show.illegal.store(mtc.illegal(), Ordering::Relaxed);
                show.outputs.store(outputs, Ordering::Relaxed);
                show.looks.fetch_add(1, Ordering::Release);
                std::thread::sleep(Duration::from_micros(100));
            }
        });
        Self { seen, moving, glitch, stop, thread: Some(thread) }
    }

    /// Lets the axis move, or stops it.
    pub fn move_axis(&self, on: bool) {
        self.moving.store(on, Ordering::Relaxed);
    }

    /// Changes A and B at once, as a loose plug does.
    pub fn glitch(&self) {
        self.glitch.store(true, Ordering::Relaxed);
    }

    /// The controller's count minus the scale's.
    pub fn offset(&self) -> i64 {
        self.seen.offset.load(Ordering::Relaxed)
    }

    /// Illegal transitions that the controller has seen.
    pub fn illegal(&self) -> u64 {
        self.seen.illegal.load(Ordering::Relaxed)
    }

    /// Waits until the machine has made one whole look at its lines.
    pub fn look_twice(&self) {
        let from = self.seen.looks.load(Ordering::Acquire);
        until("the machine looks", || self.seen.looks.load(Ordering::Acquire) >= from + 2);
    }

    /// Whether both inverters of the axis are on.
    pub fn inverted(&self) -> bool {
        self.seen.outputs.load(Ordering::Relaxed) & 3 == 3
    }

    /// Whether an insertion is under way: one inverter is on, the other is off.
    pub fn halfway(&self) -> bool {
        matches!(self.seen.outputs.load(Ordering::Relaxed) & 3, 1 | 2)
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Lets daemons with a [`Machine`] run alone.
/// Each daemon keeps a CPU busy, and those with a machine must not look too late.
static ROOM: RwLock<()> = RwLock::new(());

/// Waits until no other daemon runs in this program.
pub fn alone() -> RwLockWriteGuard<'static, ()> {
    ROOM.write().unwrap_or_else(PoisonError::into_inner)
}

/// Runs beside others, for a daemon that simulates its machine itself.
pub fn among_others() -> RwLockReadGuard<'static, ()> {
    ROOM.read().unwrap_or_else(PoisonError::into_inner)
}

/// A machine on a shared-memory card, with a directory for its daemon.
/// The directory has the daemon's configuration and socket.
#[derive(Debug)]
pub struct Bench {
    /// The machine at the end of the card.
    pub machine: Machine,
    directory: tempfile::TempDir,
}

impl Default for Bench {
    fn default() -> Self {
        Self::with("")
    }
}

impl Bench {
    /// A bench with `more` appended to [`CONFIG`].
    pub fn with(more: &str) -> Self {
        Self::on(&format!("{}{more}", CONFIG.replace("CARD", "card")), shared_memory)
    }

    /// A bench with another configuration and another machine's side.
    /// `card` makes that side from the path of the file of registers.
    pub fn on<L: Lines + 'static>(config: &str, card: impl FnOnce(&Path) -> L) -> Self {
        let directory = tempfile::tempdir().unwrap_or_else(|e| panic!("{e}"));
        let file = directory.path().join("card");
        let made = std::fs::File::create(&file).and_then(|f| f.set_len(4096));
        let made = made.and_then(|()| std::fs::write(directory.path().join("rtec.toml"), config));
        assert!(made.is_ok(), "{made:?}");
        Self { machine: Machine::on(card(&file)), directory }
    }

    /// Path of a file of the bench.
    pub fn at(&self, name: &str) -> PathBuf {
        self.directory.path().join(name)
    }

    /// The command that starts its daemon.
    pub fn command(&self) -> Command {
        let mut command = Command::new(program("rtecd"));
        command.arg("--config").arg(self.at("rtec.toml")).arg("--socket").arg(self.at("s"));
        command
    }

    /// Starts the daemon on the bench's configuration.
    pub fn daemon(&self) -> Daemon {
        Daemon::spawn(&mut self.command(), &self.at("s"))
    }

    /// Runs `rtecctl`; returns its exit code and both outputs.
    pub fn user(&self, args: &[&str]) -> (Option<i32>, String) {
        let run = user(&self.at("s"), args);
        (run.status.code(), String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned())
    }

    /// The axis in the status.
    pub fn x(&self) -> Value {
        let run = user(&self.at("s"), &["status", "--json"]);
        let status: Value = serde_json::from_slice(&run.stdout).unwrap_or_default();
        status["axes"][0].clone()
    }

    /// Moves the axis, homes it and enables corrections.
    /// A speed is known only from the second edge on. Before that, every late look is a fault.
    pub fn go(&self) {
        self.machine.move_axis(true);
        let place = || self.x()["position_counts"].as_i64();
        until("an answer", || place().is_some());
        let from = place();
        until("two edges", || place().zip(from).is_some_and(|(p, from)| (p - from).abs() >= 2));
        for order in [&["home", "--controller-homed"][..], &["enable"]] {
            let (code, text) = self.user(order);
            assert_eq!(code, Some(0), "{order:?}: {text}");
        }
    }

    /// Waits until the scale has given `n` edges.
    pub fn edges(&self, n: u32) {
        for _ in 0..n {
            let scale = || self.machine.seen.scale.load(Ordering::Relaxed);
            let from = scale();
            until("an edge", || scale() != from);
        }
    }

    /// Requests a total and waits until it is completed.
    pub fn correct(&self, counts: i64) {
        let (code, text) = self.user(&["correct", "x", &counts.to_string(), "--large"]);
        assert_eq!(code, Some(0), "{text}");
        until("completed", || {
            let x = self.x();
            assert!(x["faults"].as_array().is_none_or(Vec::is_empty), "{x}");
            x["completed"] == counts
        });
    }

    /// Checks that the MTC has the daemon's total and saw no illegal state.
    pub fn balances(&self) {
        until("an insertion is finished", || !self.machine.halfway());
        self.machine.look_twice();
        assert_eq!(self.machine.illegal(), 0);
        assert_eq!(self.x()["in_effect"], self.machine.offset());
    }

    /// Checks that the MTC has this total, whether or not a daemon runs.
    pub fn balances_with(&self, counts: i64) {
        until("an insertion is finished", || !self.machine.halfway());
        self.machine.look_twice();
        assert_eq!((self.machine.illegal(), self.machine.offset()), (0, counts));
    }

    /// Outputs of the card.
    pub fn outputs(&self) -> u64 {
        self.machine.seen.outputs.load(Ordering::Relaxed)
    }
}

/// The registers of a shared-memory card, from the machine's side.
pub fn shared_memory(file: &Path) -> MappedRegisterFile {
    MappedRegisterFile::open(file, 8, "machine").unwrap_or_else(|e| panic!("{e}"))
}
