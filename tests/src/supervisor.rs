//! A service manager as `rtecd` sees one, and the trial that kills the daemon.
//! It follows `sd_notify(3)` and `sd_listen_fds(3)`.
//!
//! It listens to the main process only, keeps the descriptors that it is given, and passes them to the next process
//! under their names. Unlike systemd it has no unit files, no policy and no other services.

use crate::daemon::{Machine, until};
use anyhow::{Context, bail, ensure};
use nix::sys::signal::{Signal, kill};
use nix::sys::socket::{
    AddressFamily, ControlMessageOwned, MsgFlags, SockFlag, SockType, UnixAddr, UnixCredentials, bind,
    recvmsg, setsockopt, socket, sockopt,
};
use nix::unistd::Pid;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{ClientRequest, DaemonResponse, DaemonStatus};
use std::fs::File;
use std::io::{IoSliceMut, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd, RawFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

/// The first descriptor that is passed.
const FIRST: RawFd = 3;
/// Largest number of descriptors in the store, as `FileDescriptorStoreMax=` sets.
const STORE_MAX: usize = 16;
/// Longest time that anything may take. No trial is judged by its duration.
const PATIENCE: Duration = Duration::from_secs(60);

/// A service manager for one daemon.
/// It starts the daemon, reads its messages and keeps its descriptors.
#[derive(Debug)]
pub struct Supervisor {
    directory: tempfile::TempDir,
    socket: OwnedFd,
    store: Vec<(String, OwnedFd)>,
    watchdog: Duration,
    /// Keeps low descriptor numbers free of this process's own files.
    /// The descriptors to be passed get these numbers.
    _low: Vec<File>,
}

/// The running process of the service.
#[derive(Debug)]
pub struct Service {
    child: Child,
    /// `READY=1` was received.
    pub ready: bool,
    /// `STOPPING=1` was received.
    pub stopping: bool,
    /// The last `STATUS=` message.
    pub status: String,
    /// Number of `WATCHDOG=1` messages.
    pub fed: u64,
    /// Time of the last one, or when the process was ready.
    pub fed_at: Instant,
}

impl Supervisor {
    /// Opens the notification socket.
    ///
    /// # Errors
    /// When the system refuses it.
    pub fn new(watchdog: Duration) -> anyhow::Result<Self> {
        let mut low = Vec::new();
        loop {
            let file = File::open("/dev/null")?;
            let done = file.as_raw_fd() >= FIRST + STORE_MAX as RawFd;
            low.push(file);
            if done {
                break;
            }
        }
        let directory = tempfile::tempdir()?;
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = socket(AddressFamily::Unix, SockType::Datagram, flags, None)?;
        setsockopt(&socket, sockopt::PassCred, &true)?;
        bind(socket.as_raw_fd(), &UnixAddr::new(&directory.path().join("notify"))?)?;
        Ok(Self { directory, socket, store: Vec::new(), watchdog, _low: low })
    }

    /// Starts a program with the stored descriptors.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn start(&self, program: &Path, args: &[&str]) -> anyhow::Result<Service> {
        // The shell knows its own process number before it becomes the program.
        let script = "export LISTEN_PID=$$ WATCHDOG_PID=$$; exec \"$0\" \"$@\"";
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]).arg(program).args(args);
        let names: Vec<&str> = self.store.iter().map(|(name, _)| name.as_str()).collect();
        command
            .env("NOTIFY_SOCKET", self.directory.path().join("notify"))
            .env("WATCHDOG_USEC", self.watchdog.as_micros().to_string())
            .env("LISTEN_FDS", names.len().to_string())
            .env("LISTEN_FDNAMES", names.join(":"));
        let from: Vec<RawFd> = self.store.iter().map(|(_, fd)| fd.as_raw_fd()).collect();
        // SAFETY: between fork and exec only dup2 is called, on numbers made beforehand; dup2 is async-signal-safe.
        // Its targets are the low numbers that this process keeps taken by files closed at exec.
        unsafe {
            command.pre_exec(move || {
                for (n, from) in from.iter().enumerate() {
                    if libc::dup2(*from, FIRST + n as RawFd) < 0 {
                        return Err(std::io::Error::last_os_error());
                    }
                }
                Ok(())
            });
        }
        let child = command.spawn().with_context(|| format!("starting {}", program.display()))?;
        let fed_at = Instant::now();
        Ok(Service { child, ready: false, stopping: false, status: String::new(), fed: 0, fed_at })
    }

    /// Names of the stored descriptors.
    pub fn stored(&self) -> impl Iterator<Item = &str> {
        self.store.iter().map(|(name, _)| name.as_str())
    }

    /// Takes every message that was received.
    ///
    /// # Errors
    /// A message that no service may send, or a full store.
    pub fn listen(&mut self, service: &mut Service) -> anyhow::Result<()> {
        loop {
            let mut text = [0; 4096];
            let mut space = nix::cmsg_space!([RawFd; STORE_MAX], UnixCredentials);
            let (length, sender, mut fds) = {
                let mut into = [IoSliceMut::new(&mut text)];
                let flags = MsgFlags::MSG_CMSG_CLOEXEC;
                let message = match recvmsg::<()>(self.socket.as_raw_fd(), &mut into, Some(&mut space), flags)
                {
                    Err(nix::errno::Errno::EAGAIN) => return Ok(()),
                    message => message.context("notification socket")?,
                };
                let (mut sender, mut fds) = (None, Vec::new());
                for control in message.cmsgs()? {
                    match control {
                        ControlMessageOwned::ScmCredentials(who) => sender = Some(who.pid()),
                        ControlMessageOwned::ScmRights(raw) => {
                            // SAFETY: the kernel has just made these descriptors for us.
                            fds.extend(raw.into_iter().map(|fd| unsafe { OwnedFd::from_raw_fd(fd) }));
                        }
                        other => bail!("found {other:?} in a notification"),
                    }
                }
                (message.bytes, sender, fds)
            };
            // As NotifyAccess=main: messages of a dead predecessor or of anybody else are ignored.
            if sender != Some(service.child.id() as i32) {
                continue;
            }
            let text = std::str::from_utf8(&text[..length]).context("a notification")?;
            let value = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
            if value("FDSTORE") == Some("1") {
                let name = value("FDNAME").unwrap_or("stored");
                ensure!(!fds.is_empty(), "FDSTORE=1 without a descriptor");
                self.store.extend(fds.drain(..).map(|fd| (name.to_owned(), fd)));
                ensure!(self.store.len() <= STORE_MAX, "more than {STORE_MAX} descriptors in the store");
            }
            if value("FDSTOREREMOVE") == Some("1") {
                self.store.retain(|(name, _)| Some(name.as_str()) != value("FDNAME"));
            }
            if value("READY") == Some("1") {
                (service.ready, service.fed_at) = (true, Instant::now());
            }
            if value("WATCHDOG") == Some("1") {
                service.fed += 1;
                service.fed_at = Instant::now();
            }
            service.stopping |= value("STOPPING") == Some("1");
            if let Some(status) = value("STATUS") {
                status.clone_into(&mut service.status);
            }
        }
    }

    /// Waits until the service is ready.
    ///
    /// # Errors
    /// When it ends instead, or is not ready within a minute.
    pub fn wait_ready(&mut self, service: &mut Service) -> anyhow::Result<()> {
        let begun = Instant::now();
        while !service.ready {
            self.listen(service)?;
            if let Some(status) = service.child.try_wait()? {
                bail!("it ended with {status} before it was ready");
            }
            ensure!(begun.elapsed() < PATIENCE, "not ready within {PATIENCE:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Whether the watchdog would have ended the service by now.
    pub fn starved(&self, service: &Service) -> bool {
        service.ready && service.fed_at.elapsed() > self.watchdog
    }
}

impl Service {
    /// The daemon's process number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal.
    ///
    /// # Errors
    /// When the process has ended already.
    pub fn signal(&self, signal: Signal) -> anyhow::Result<()> {
        kill(Pid::from_raw(self.child.id() as i32), signal).with_context(|| format!("sending {signal}"))
    }

    /// Waits until the process ends.
    ///
    /// # Errors
    /// When the system refuses it.
    pub fn wait(&mut self) -> anyhow::Result<ExitStatus> {
        Ok(self.child.wait()?)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A trial: a daemon that corrects a moving axis is killed again and again.
#[derive(Debug)]
pub struct Trial {
    /// The daemon's program.
    pub rtecd: PathBuf,
    /// The daemon's configuration.
    pub config: PathBuf,
    /// The daemon's control socket.
    pub socket: PathBuf,
    /// Number of kills.
    /// Every fourth kill is aimed: between the two inversions of an insertion.
    pub kills: u32,
    /// Seed of the random moments and totals.
    pub seed: u64,
    /// Longest time from a start to a kill that is not aimed.
    /// Later kills would only repeat the same situation.
    pub within: Duration,
}

/// Counts of a trial without a violation.
#[derive(Debug, Default)]
pub struct Tally {
    /// Number of kills.
    pub kills: u32,
    /// Kills that left the inverters unequal.
    pub halfway: u32,
    /// Kills that left both inverters on.
    pub inverted: u32,
    /// Faults latched, each as it was reported.
    pub faults: Vec<String>,
    /// Insertions of all daemons together.
    pub insertions: u64,
    /// Descriptors in the store at the end.
    pub stored: usize,
}

impl Trial {
    fn ask(&self, request: &ClientRequest) -> anyhow::Result<DaemonResponse> {
        Ok(DaemonConnection::connect(&self.socket)?.ask(request)?)
    }

    fn status(&self) -> anyhow::Result<DaemonStatus> {
        match self.ask(&ClientRequest::Status {})? {
            DaemonResponse::Status(status) => Ok(*status),
            other => bail!("found {other:?}, expected a status"),
        }
    }

    fn done(&self, request: &ClientRequest) -> anyhow::Result<()> {
        match self.ask(request)? {
            DaemonResponse::Done { .. } => Ok(()),
            other => bail!("{request:?}: found {other:?}, expected it done"),
        }
    }

    /// Runs the trial. `say` gets a line for each kill.
    ///
    /// # Errors
    /// The first violation.
    ///
    /// Violations are an illegal transition at the MTC, a jump between two daemons, a ledger that does not balance
    /// without a fault, and a fault without a cause.
    pub fn run(&self, machine: &Machine, mut say: impl Write) -> anyhow::Result<Tally> {
        let mut supervisor = Supervisor::new(Duration::from_secs(20))?;
        let mut random = Xoshiro256PlusPlus::seed_from_u64(self.seed);
        let mut below = |n: u64| random.next_u64() % n;
        let config = self.config.display().to_string();
        let socket = self.socket.display().to_string();
        let args = ["--config", &config, "--socket", &socket];
        let mut tally = Tally::default();
        // The MTC's offset at homing, and whether the last kill left the inverters unequal.
        let (mut base, mut cut) = (machine.offset(), false);
        machine.move_axis(true);
        for n in 0..=self.kills {
            let mut service = supervisor.start(&self.rtecd, &args)?;
            supervisor.wait_ready(&mut service)?;
            until("a half insertion is finished", || !machine.halfway());
            let status = self.status()?;
            let faults = faults(&status);
            let offset = machine.offset() - base;
            ensure!(machine.illegal() == 0, "kill {n}: the MTC has seen an illegal transition");
            ensure!(cut != faults.is_empty(), "kill {n}: inverters left unequal: {cut}, faults: {faults:?}");
            if cut {
                self.done(&ClientRequest::Clear {})?;
            } else {
                let reported = status.axes[0].in_effect;
                ensure!(
                    reported == offset,
                    "kill {n}: the daemon reports {reported} counts, the MTC has {offset}"
                );
            }
            tally.faults.extend(faults);
            // The total of the dead process is kept. If the MTC's count is in doubt, it is homed too.
            let controller_homed = n == 0 || cut;
            self.go(controller_homed)?;
            if controller_homed {
                base = machine.offset();
            }
            self.done(&ClientRequest::Enable { accept_jump: false })?;
            if n == self.kills {
                self.park(&mut supervisor, service, machine, base)?;
                break;
            }

            let aimed = n % 4 == 3;
            let within_ms = self.within.as_millis() as u64;
            let end = Instant::now() + Duration::from_millis(below(within_ms));
            let begun = Instant::now();
            loop {
                supervisor.listen(&mut service)?;
                ensure!(!supervisor.starved(&service), "kill {n}: the watchdog was not fed");
                if if aimed { machine.halfway() } else { Instant::now() >= end } {
                    break;
                }
                ensure!(begun.elapsed() < PATIENCE, "kill {n}: no insertion to aim at");
                let status = self.status()?;
                ensure!(status.balanced || status.mode == "fault", "kill {n}: {status:?}");
                let x = &status.axes[0];
                if status.mode == "run" && x.completed == x.requested {
                    let total_counts = 2 * (below(21) as i64 - 10);
                    let request = ClientRequest::Correct { axis: x.name.clone(), total_counts, large: true };
                    self.done(&request)?;
                }
                tally.insertions = tally.insertions.max(x.insertions);
                if !aimed {
                    std::thread::sleep(Duration::from_millis(below(20)));
                }
            }
            tally.faults.extend(self::faults(&self.status()?));
            service.signal(Signal::SIGKILL)?;
            service.wait()?;
            // The last write of the dead process has reached the MTC by the machine's next look.
            machine.look_twice();
            cut = machine.halfway();
            let left = machine.offset();
            std::thread::sleep(Duration::from_millis(below(within_ms / 2)));
            let inverted = machine.inverted();
            ensure!(cut || machine.offset() == left, "kill {n}: a jump while nobody was there");
            writeln!(
                say,
                "kill {}: inverters {}, MTC minus scale {:+}, {} in the store",
                n + 1,
                if cut {
                    "unequal"
                } else if inverted {
                    "on"
                } else {
                    "off"
                },
                machine.offset() - base,
                supervisor.stored().count()
            )?;
            tally.kills += 1;
            tally.halfway += u32::from(cut);
            tally.inverted += u32::from(inverted && !cut);
        }
        ensure!(machine.illegal() == 0, "the MTC has seen an illegal transition");
        tally.stored = supervisor.stored().count();
        Ok(tally)
    }

    /// Waits for two edges, which give a speed, and homes.
    fn go(&self, controller_homed: bool) -> anyhow::Result<()> {
        let from = self.status()?.axes[0].position_counts;
        let begun = Instant::now();
        while (self.status()?.axes[0].position_counts - from).abs() < 2 {
            ensure!(begun.elapsed() < PATIENCE, "the axis does not move");
            std::thread::sleep(Duration::from_millis(10));
        }
        self.done(&ClientRequest::Home { axis: None, controller_homed: Some(controller_homed) })
    }

    /// Stops the daemon cleanly with a correction in effect, which must stay.
    fn park(
        &self,
        supervisor: &mut Supervisor,
        mut service: Service,
        machine: &Machine,
        base: i64,
    ) -> anyhow::Result<()> {
        let axis = self.status()?.axes[0].name.clone();
        self.done(&ClientRequest::Correct { axis, total_counts: 6, large: true })?;
        until("the last correction", || self.status().is_ok_and(|s| s.axes[0].completed == 6));
        service.signal(Signal::SIGTERM)?;
        let ended = service.wait()?;
        ensure!(ended.success(), "a clean stop ended with {ended}");
        supervisor.listen(&mut service)?;
        ensure!(service.stopping, "STOPPING=1 was not said");
        machine.look_twice();
        let offset = machine.offset() - base;
        ensure!(offset == 6 && !machine.halfway(), "parked with {offset} counts at the MTC, expected 6");
        Ok(())
    }
}

/// Latched faults of the machine and its axes, as the protocol names them.
fn faults(status: &DaemonStatus) -> Vec<String> {
    let axes = status.axes.iter().flat_map(|axis| &axis.faults);
    status.faults.iter().chain(axes).map(rtec_control::protocol::word).collect()
}
