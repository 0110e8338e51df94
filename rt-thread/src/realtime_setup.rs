//! The real-time set-up of a thread and its process.
//! Each setting is applied where permitted, and read back from the kernel. The report has the wanted value, the value
//! found, the errno and the remedy. Corrections need a verified set-up.
//!
//! | finding | applied here | read back from | needed to arm |
//! |---|---|---|---|
//! | scheduler | `sched_setscheduler` | `sched_getscheduler`, `sched_getparam` | yes |
//! | affinity | `sched_setaffinity` | `sched_getaffinity` | yes |
//! | `memory_lock` | `mlockall` | `/proc/self/status`, `VmLck` | yes |
//! | stack | written to its depth | a second pass causes no page fault (`getrusage`) | yes |
//! | `cpu_dma_latency` | `/dev/cpu_dma_latency`, held open | the same file | yes |
//! | `rt_throttling` | – | `/proc/sys/kernel/sched_rt_runtime_us` | yes |
//! | `fair_server` | – | debugfs, kernels from 6.12 | when it can be read |
//! | the others | – | `/proc`, `/sys` | no: the latency self-test measures what they cost |

use serde::Serialize;
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Bytes of stack that the real-time thread may use without a page fault.
const STACK_BYTES: usize = 256 * 1024;
const PAGE: usize = 4096;
const STACK_PAGES: usize = STACK_BYTES / PAGE;
/// Bits of `CapEff` in `/proc/thread-self/status`, from capability.h.
const CAP_IPC_LOCK: u32 = 14;
const CAP_SYS_NICE: u32 = 23;

/// A system call or file that failed: which, and the kernel's answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct OsError {
    /// The system call, or `open`, `read`, `write` with the path.
    pub operation: String,
    /// The error number of errno(3).
    /// 0 where the kernel gave none (a file without the expected content).
    pub errno: i32,
}

impl OsError {
    /// The failed operation with the error number of `error`.
    pub fn of(operation: impl Into<String>, error: &io::Error) -> Self {
        Self { operation: operation.into(), errno: error.raw_os_error().unwrap_or(0) }
    }

    fn last(operation: &str) -> Self {
        Self::of(operation, &io::Error::last_os_error())
    }
}

impl fmt::Display for OsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.operation, io::Error::from_raw_os_error(self.errno))
    }
}

impl std::error::Error for OsError {}

/// One setting: the wanted value, the value found, and the remedy.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct SetupFinding {
    /// The setting, see the module's table.
    pub name: &'static str,
    /// The wanted value.
    pub wanted: String,
    /// The value read back.
    pub got: String,
    /// Whether the two agree.
    pub ok: bool,
    /// A real card is not armed unless this one is ok.
    pub needed_to_arm: bool,
    /// The kernel's error when applying or reading the setting failed.
    pub errno: Option<OsError>,
    /// What the user should do; empty when ok.
    pub remedy: String,
}

impl SetupFinding {
    /// A finding that is not needed to arm, without a remedy.
    pub fn new(name: &'static str, wanted: impl Into<String>, got: impl Into<String>, ok: bool) -> Self {
        Self { name, wanted: wanted.into(), got: got.into(), ok, ..Self::default() }
    }

    /// A finding that could not be read, which counts as not ok.
    pub fn unknown(name: &'static str, wanted: impl Into<String>, error: OsError) -> Self {
        Self::new(name, wanted, "unknown", false).failed(Some(error))
    }

    /// Makes the finding needed to arm a real card.
    #[must_use]
    pub fn needed(mut self) -> Self {
        self.needed_to_arm = true;
        self
    }

    fn failed(mut self, error: Option<OsError>) -> Self {
        self.errno = error;
        self
    }

    /// Adds the remedy where the finding is not ok.
    #[must_use]
    pub fn remedy(mut self, remedy: impl Into<String>) -> Self {
        if !self.ok {
            self.remedy = remedy.into();
        }
        self
    }
}

/// All findings about one CPU, and after [`apply`] about the thread that called it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SetupReport {
    /// The kernel's release, as `uname -r` prints it.
    pub kernel: String,
    /// The CPU for the real-time thread.
    pub cpu: usize,
    /// The emulator's name when instructions are emulated (QEMU's TCG).
    /// Its times are no evidence for any machine.
    pub emulated: Option<String>,
    /// Kernel command line that reserves this CPU for the real-time thread.
    /// Empty with one CPU only.
    pub kernel_command_line: String,
    /// The part of it that the running kernel was not booted with.
    pub kernel_command_line_lacks: String,
    /// The findings, one per setting.
    pub findings: Vec<SetupFinding>,
}

impl SetupReport {
    /// Whether every setting that a real card needs is in effect.
    pub fn can_arm(&self) -> bool {
        self.missing().next().is_none()
    }

    /// The settings that keep a real card from being armed.
    pub fn missing(&self) -> impl Iterator<Item = &SetupFinding> {
        self.findings.iter().filter(|f| f.needed_to_arm && !f.ok)
    }

    /// The finding of that name.
    pub fn finding(&self, name: &str) -> Option<&SetupFinding> {
        self.findings.iter().find(|f| f.name == name)
    }
}

/// Root of `/proc`, `/sys` and `/dev`: the running system or a copy of it.
#[derive(Debug, Clone)]
pub struct SystemRoot {
    root: PathBuf,
    /// Whether it is the running system.
    /// CPU instructions and signals to the kernel apply to that one only.
    live: bool,
}

impl SystemRoot {
    /// The running system.
    pub fn live() -> Self {
        Self { root: PathBuf::from("/"), live: true }
    }

    /// A directory that holds `proc`, `sys` and `dev` as a system would show them.
    pub fn at(root: &Path) -> Self {
        Self { root: root.to_owned(), live: false }
    }

    /// Number of CPUs online, whichever of them the calling thread may use.
    /// 0 where the kernel does not report it.
    pub fn cpus_online(&self) -> usize {
        self.online().len()
    }

    /// The CPU for a polling thread: the first isolated one, else the last one online.
    pub fn default_cpu(&self) -> usize {
        let isolated = self.cpus("sys/devices/system/cpu/isolated");
        isolated.first().or(self.online().last()).copied().unwrap_or(0)
    }

    /// Inspects the settings of this machine for a real-time thread on `cpu`.
    /// It changes nothing.
    pub fn inspect(&self, cpu: usize, priority: u8) -> SetupReport {
        SetupReport {
            kernel: self.read("proc/sys/kernel/osrelease").unwrap_or_else(|_| "unknown".into()),
            cpu,
            emulated: self.emulator(),
            kernel_command_line_lacks: self.lacks(&self.kernel_command_line(cpu), cpu),
            kernel_command_line: self.kernel_command_line(cpu),
            findings: vec![
                self.rt_throttling(),
                self.fair_server(cpu),
                self.preempt_rt(),
                self.cpu_in_list("isolated", "isolcpus", "sys/devices/system/cpu/isolated", cpu),
                self.cpu_in_list("nohz_full", "nohz_full", "sys/devices/system/cpu/nohz_full", cpu),
                self.rcu_nocbs(cpu),
                self.irq_affinity(cpu),
                self.governor(cpu),
                self.smt(cpu),
                self.clocksource(),
                self.transparent_hugepage(),
                self.swap(),
                self.memlock_limit(),
                self.rtprio_limit(priority),
                self.hypervisor(),
            ],
        }
    }

    /// Path of a file below the root.
    pub fn path(&self, path: impl AsRef<Path>) -> PathBuf {
        self.root.join(path)
    }

    /// Text of a file, without the white space around it.
    ///
    /// # Errors
    /// When it cannot be read, or is no text.
    pub fn read(&self, path: impl AsRef<Path>) -> Result<String, OsError> {
        let path = self.path(path);
        std::fs::read_to_string(&path)
            .map(|text| text.trim().to_owned())
            .map_err(|e| OsError::of(format!("read {}", path.display()), &e))
    }

    fn exists(&self, path: &str) -> bool {
        self.root.join(path).exists()
    }

    fn cpus(&self, path: &str) -> Vec<usize> {
        self.read(path).map(|text| cpu_list(&text)).unwrap_or_default()
    }

    fn online(&self) -> Vec<usize> {
        self.cpus("sys/devices/system/cpu/online")
    }

    /// The CPUs left for everything else, as a list that the kernel understands.
    /// Empty with one CPU only.
    pub fn housekeeping(&self, cpu: usize) -> String {
        let others: Vec<String> =
            self.online().into_iter().filter(|c| *c != cpu).map(|c| c.to_string()).collect();
        others.join(",")
    }

    fn kernel_command_line(&self, cpu: usize) -> String {
        let others = self.housekeeping(cpu);
        if others.is_empty() {
            return String::new();
        }
        format!("isolcpus=managed_irq,domain,{cpu} nohz_full={cpu} rcu_nocbs={cpu} irqaffinity={others}")
    }

    /// The wanted words that the running kernel was not booted with.
    /// A word for more CPUs than this one is accepted.
    fn lacks(&self, wanted: &str, cpu: usize) -> String {
        let booted = self.read("proc/cmdline").unwrap_or_default();
        let there = |word: &&str| {
            let Some((key, value)) = word.split_once('=') else { return false };
            let found =
                booted.split_whitespace().filter_map(|w| w.strip_prefix(key)?.strip_prefix('=')).next_back();
            let Some(found) = found else { return false };
            if key == "irqaffinity" {
                return !cpu_list(found).contains(&cpu);
            }
            let flags = value.split(',').filter(|part| part.parse::<usize>().is_err());
            cpu_list(found).contains(&cpu) && flags.clone().all(|flag| found.split(',').any(|f| f == flag))
        };
        wanted.split_whitespace().filter(|word| !there(word)).collect::<Vec<_>>().join(" ")
    }

    /// The finding that a file shows.
    /// `judge` returns what it says, and whether that is wanted. `absent` is the same for a kernel without the file.
    fn shown_by(
        &self,
        (name, wanted): (&'static str, &str),
        path: &str,
        absent: Option<(&str, bool)>,
        judge: impl FnOnce(&str) -> (String, bool),
    ) -> SetupFinding {
        let error = match self.read(path) {
            Ok(text) => {
                let (got, ok) = judge(&text);
                return SetupFinding::new(name, wanted, got, ok);
            }
            Err(error) => error,
        };
        match absent.filter(|_| error.errno == libc::ENOENT) {
            Some((got, ok)) => SetupFinding::new(name, wanted, got, ok),
            None => SetupFinding::unknown(name, wanted, error),
        }
    }

    /// As [`Self::shown_by`], where the file's whole text must be the wanted one.
    fn equals(
        &self,
        name: &'static str,
        wanted: &str,
        path: &str,
        absent: Option<(&str, bool)>,
    ) -> SetupFinding {
        self.shown_by((name, wanted), path, absent, |text| (text.to_owned(), text == wanted))
    }

    fn rt_throttling(&self) -> SetupFinding {
        self.equals("rt_throttling", "-1", "proc/sys/kernel/sched_rt_runtime_us", None).needed().remedy(
            "sysctl kernel.sched_rt_runtime_us=-1: a polling thread loses up to 50 ms of every second otherwise",
        )
    }

    /// Finding of the deadline server of Linux 6.12 and later.
    /// A CPU that a real-time thread does not leave runs fair tasks for 50 ms of every second, whatever
    /// `sched_rt_runtime_us` says. The switch is in debugfs, which is often unreadable. Then it is reported but not
    /// required.
    fn fair_server(&self, cpu: usize) -> SetupFinding {
        const NAME: &str = "fair_server";
        let release = self.read("proc/sys/kernel/osrelease").unwrap_or_default();
        let path = format!("sys/kernel/debug/sched/fair_server/cpu{cpu}/runtime");
        if version(&release) < (6, 12) {
            return SetupFinding::new(NAME, "0", "none in this kernel", true);
        }
        let remedy = format!(
            "echo 0 > /{path}: with any ordinary task on CPU {cpu} a polling thread loses 50 ms of every second otherwise"
        );
        let finding = self.equals(NAME, "0", &path, None);
        if finding.errno.is_none() { finding.needed() } else { finding }.remedy(remedy)
    }

    fn preempt_rt(&self) -> SetupFinding {
        let realtime = self.read("sys/kernel/realtime").is_ok_and(|text| text == "1");
        let version = self.read("proc/version").unwrap_or_default();
        let model = ["PREEMPT_RT", "PREEMPT RT", "PREEMPT_DYNAMIC", "PREEMPT"]
            .into_iter()
            .find(|word| version.contains(word))
            .unwrap_or("not preemptible");
        let ok = realtime || model.ends_with("RT");
        let got = if ok { "PREEMPT_RT" } else { model };
        SetupFinding::new("preempt_rt", "PREEMPT_RT", got, ok)
            .remedy("boot a PREEMPT_RT kernel (Debian: linux-image-rt-amd64)")
    }

    fn cpu_in_list(&self, name: &'static str, parameter: &str, path: &str, cpu: usize) -> SetupFinding {
        let judge = |text: &str| {
            let got = if text.is_empty() { "none" } else { text };
            (got.to_owned(), cpu_list(text).contains(&cpu))
        };
        self.shown_by((name, &format!("CPU {cpu}")), path, Some(("none", false)), judge)
            .remedy(format!("boot with {parameter}={cpu}"))
    }

    /// Finding of RCU callbacks, which the kernel does not list by CPU.
    /// A CPU in `nohz_full` is always free of them.
    fn rcu_nocbs(&self, cpu: usize) -> SetupFinding {
        let wanted = format!("CPU {cpu}");
        let remedy = format!("boot with rcu_nocbs={cpu}");
        let command_line = match self.read("proc/cmdline") {
            Ok(text) => text,
            Err(error) => return SetupFinding::unknown("rcu_nocbs", wanted, error).remedy(remedy),
        };
        let of = |key: &str| {
            command_line
                .split_whitespace()
                .find_map(|word| word.strip_prefix(key)?.strip_prefix('='))
                .unwrap_or_default()
        };
        let (rcu, nohz) = (of("rcu_nocbs"), of("nohz_full"));
        let got = if rcu.is_empty() { nohz } else { rcu };
        let ok = rcu == "all" || cpu_list(rcu).contains(&cpu) || cpu_list(nohz).contains(&cpu);
        SetupFinding::new("rcu_nocbs", wanted, if got.is_empty() { "none" } else { got }, ok).remedy(remedy)
    }

    /// Finding of the interrupts in use that may land on the CPU.
    fn irq_affinity(&self, cpu: usize) -> SetupFinding {
        let wanted = format!("no interrupt on CPU {cpu}");
        let others = self.housekeeping(cpu);
        let remedy =
            format!("boot with irqaffinity={others}, or write {others} to /proc/irq/*/smp_affinity_list");
        let path = self.root.join("proc/irq");
        let entries = match std::fs::read_dir(&path) {
            Ok(entries) => entries,
            Err(e) => {
                let error = OsError::of(format!("read {}", path.display()), &e);
                return SetupFinding::unknown("irq_affinity", wanted, error).remedy(remedy);
            }
        };
        let mut here: Vec<(u32, String)> = entries
            .flatten()
            .filter_map(|entry| {
                let number: u32 = entry.file_name().to_str()?.parse().ok()?;
                // A handler shows as a directory with the device's name; without one the interrupt is not in use.
                let device = std::fs::read_dir(entry.path())
                    .ok()?
                    .flatten()
                    .find(|inner| inner.file_type().is_ok_and(|t| t.is_dir()))?;
                // The interrupt of our own lines belongs here: see `card_irq` of `rtecctl platform`.
                (device.file_name() != "rtec" && cpu_list(&self.irq_cpus(number)?).contains(&cpu))
                    .then(|| (number, format!("{number} {}", device.file_name().to_string_lossy())))
            })
            .collect();
        here.sort();
        let got = match here.len() {
            0 => "none".into(),
            n => {
                let names: Vec<&str> = here.iter().take(4).map(|(_, name)| name.as_str()).collect();
                format!("{n}: {}{}", names.join(", "), if n > names.len() { ", …" } else { "" })
            }
        };
        SetupFinding::new("irq_affinity", wanted, got, here.is_empty()).remedy(remedy)
    }

    /// The CPUs that an interrupt lands on.
    pub fn irq_cpus(&self, number: u32) -> Option<String> {
        let list = |name| self.read(format!("proc/irq/{number}/{name}")).ok().filter(|text| !text.is_empty());
        list("effective_affinity_list").or_else(|| list("smp_affinity_list"))
    }

    fn governor(&self, cpu: usize) -> SetupFinding {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor");
        self.equals("governor", "performance", &path, Some(("no frequency scaling", true)))
            .remedy(format!("echo performance > /{path}"))
    }

    fn smt(&self, cpu: usize) -> SetupFinding {
        let path = format!("sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list");
        match self.read(&path) {
            Ok(text) => {
                let siblings: Vec<String> =
                    cpu_list(&text).into_iter().filter(|c| *c != cpu).map(|c| c.to_string()).collect();
                let got =
                    if siblings.is_empty() { "none".into() } else { format!("CPU {}", siblings.join(",")) };
                SetupFinding::new("smt", "no sibling thread", got, siblings.is_empty()).remedy(format!(
                    "switch hyper-threading off (boot with nosmt), or echo 0 > /sys/devices/system/cpu/cpu{}/online",
                    siblings.first().map_or("N", String::as_str)
                ))
            }
            Err(error) => SetupFinding::unknown("smt", "no sibling thread", error)
                .remedy("switch hyper-threading off in the firmware"),
        }
    }

    fn clocksource(&self) -> SetupFinding {
        // These are read without a system call. Every other one costs one, a microsecond or more.
        const FAST: [&str; 3] = ["tsc", "arch_sys_counter", "riscv_clocksource"];
        let wanted = if cfg!(target_arch = "x86_64") { "tsc" } else { "one that needs no system call" };
        let path = "sys/devices/system/clocksource/clocksource0/current_clocksource";
        let judge = |text: &str| (text.to_owned(), FAST.contains(&text));
        self.shown_by(("clocksource", wanted), path, None, judge)
        .remedy("boot with tsc=reliable if the kernel dropped a sound TSC; the firmware or the host decides otherwise")
    }

    fn transparent_hugepage(&self) -> SetupFinding {
        let name = ("transparent_hugepage", "madvise or never");
        let path = "sys/kernel/mm/transparent_hugepage/enabled";
        let judge = |text: &str| {
            let chosen = text.split(['[', ']']).nth(1).unwrap_or(text);
            (chosen.to_owned(), chosen == "madvise" || chosen == "never")
        };
        self.shown_by(name, path, Some(("none in this kernel", true)), judge)
            .remedy("echo madvise > /sys/kernel/mm/transparent_hugepage/enabled")
    }

    fn swap(&self) -> SetupFinding {
        let judge = |text: &str| {
            let areas: Vec<&str> =
                text.lines().skip(1).filter_map(|line| line.split_whitespace().next()).collect();
            (if areas.is_empty() { "none".into() } else { areas.join(", ") }, areas.is_empty())
        };
        self.shown_by(("swap", "none"), "proc/swaps", None, judge)
            .remedy("swapoff -a, and take it out of /etc/fstab")
    }

    fn memlock_limit(&self) -> SetupFinding {
        self.limit("memlock_limit", "Max locked memory", "unlimited", u64::MAX, CAP_IPC_LOCK, "memlock")
    }

    fn rtprio_limit(&self, priority: u8) -> SetupFinding {
        let (wanted, least) = (format!("at least {priority}"), u64::from(priority));
        self.limit("rtprio_limit", "Max realtime priority", &wanted, least, CAP_SYS_NICE, "rtprio")
    }

    /// Finding of a resource limit that a capability overrides.
    fn limit(
        &self,
        name: &'static str,
        row: &str,
        wanted: &str,
        at_least: u64,
        capability: u32,
        item: &str,
    ) -> SetupFinding {
        let remedy =
            format!("give the group rtec the limit in /etc/security/limits.d, as: @rtec - {item} {wanted}")
                .replace("at least ", "");
        let has_capability = self.read("proc/thread-self/status").is_ok_and(|text| {
            text.lines()
                .find_map(|line| line.strip_prefix("CapEff:"))
                .and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok())
                .is_some_and(|set| set >> capability & 1 == 1)
        });
        let limits = match self.read("proc/self/limits") {
            Ok(text) => text,
            Err(error) => return SetupFinding::unknown(name, wanted, error).remedy(remedy),
        };
        let soft = limits
            .lines()
            .find_map(|line| line.strip_prefix(row))
            .and_then(|rest| rest.split_whitespace().next())
            .unwrap_or("unknown");
        let value = if soft == "unlimited" { u64::MAX } else { soft.parse().unwrap_or(0) };
        let got =
            if has_capability { format!("{soft}, overridden by a capability") } else { soft.to_owned() };
        SetupFinding::new(name, wanted, got, has_capability || value >= at_least).remedy(remedy)
    }

    /// Name of the emulator, if the CPU's instructions are emulated.
    fn emulator(&self) -> Option<String> {
        let signature = if self.live { hypervisor_signature() } else { None };
        if signature.as_deref() == Some("TCGTCGTCGTCG") {
            return Some("QEMU TCG".into());
        }
        // Without cpuid (another architecture, a recorded tree) the CPU's name shows TCG.
        let cpuinfo = self.read("proc/cpuinfo").unwrap_or_default();
        cpuinfo.contains("QEMU TCG").then(|| "QEMU TCG".into())
    }

    fn hypervisor(&self) -> SetupFinding {
        let cpuinfo = self.read("proc/cpuinfo").unwrap_or_default();
        let flagged = cpuinfo
            .lines()
            .find(|line| line.starts_with("flags"))
            .is_some_and(|flags| flags.split_whitespace().any(|flag| flag == "hypervisor"));
        let signature = if self.live { hypervisor_signature() } else { None };
        let got = match (self.emulator(), signature) {
            (Some(name), _) => format!("emulated by {name}"),
            (None, Some(signature)) => format!("virtual machine ({signature})"),
            (None, None) if flagged => "virtual machine".into(),
            (None, None) => "none".into(),
        };
        let ok = got == "none";
        SetupFinding::new("hypervisor", "none", got, ok)
            .remedy("run on the machine itself: a host takes the CPU away for milliseconds without notice")
    }
}

/// Name that a hypervisor reports.
/// `None` on a machine without one, and on other architectures.
#[allow(unused_unsafe)] // newer compilers know that CPUID is safe, 1.88 does not
fn hypervisor_signature() -> Option<String> {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::__cpuid;
        // SAFETY: every x86-64 CPU has CPUID, and the instruction touches no memory.
        let (features, leaf) = unsafe { (__cpuid(1), __cpuid(0x4000_0000)) };
        hypervisor_letters(features.ecx, [leaf.ebx, leaf.ecx, leaf.edx])
    }
    #[cfg(not(target_arch = "x86_64"))]
    None
}

/// The hypervisor's twelve letters from CPUID leaf 4000 0000h.
/// They are valid only where the features of leaf 1 report a hypervisor.
#[cfg(any(target_arch = "x86_64", test))]
fn hypervisor_letters(features_ecx: u32, leaf: [u32; 3]) -> Option<String> {
    const PRESENT: u32 = 1 << 31;
    if features_ecx & PRESENT == 0 {
        return None;
    }
    let bytes: Vec<u8> = leaf.iter().flat_map(|r| r.to_le_bytes()).collect();
    let letters: String = bytes
        .iter()
        .take_while(|b| **b != 0)
        .map(|b| char::from(*b))
        .filter(char::is_ascii_graphic)
        .collect();
    (!letters.is_empty()).then_some(letters)
}

/// Settings that the real-time thread asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtSettings {
    /// The CPU to run on; the thread runs on no other.
    pub cpu: usize,
    /// `SCHED_FIFO` priority, 1 to 99.
    pub priority: u8,
}

/// Keeps the set-up in effect: `/dev/cpu_dma_latency` counts only while it is open.
#[derive(Debug)]
#[must_use = "the CPU may sleep deeply again as soon as this is dropped"]
pub struct DmaLatencyHold {
    _cpu_dma_latency: Option<File>,
}

/// Sets up the calling thread and its process, and reads everything back.
/// The report includes [`SystemRoot::inspect`]. Without privileges the thread runs on as it is, and the report says what
/// is missing. It takes some milliseconds and allocates. Call it before the loop, on the thread that runs the loop.
pub fn apply(system: &SystemRoot, wanted: RtSettings) -> (DmaLatencyHold, SetupReport) {
    // Memory comes first, so that the stack is locked when it is touched.
    let memory_lock = memory_lock(system);
    let (cpu_dma_latency, dma_finding) = cpu_dma_latency(system);
    let mut report = system.inspect(wanted.cpu, wanted.priority);
    let thread = [scheduler(wanted.priority), affinity(wanted.cpu), memory_lock, stack(), dma_finding]
        .map(SetupFinding::needed);
    report.findings.splice(0..0, thread);
    (DmaLatencyHold { _cpu_dma_latency: cpu_dma_latency }, report)
}

/// Keeps the calling thread and those it starts off a CPU until it is dropped.
#[derive(Debug)]
#[must_use = "the thread may run everywhere again as soon as this is dropped"]
pub struct OffCpuGuard {
    before: nix::sched::CpuSet,
}

/// Moves the calling thread off `cpu`.
/// Then nothing competes with the real-time thread. Threads that it starts meanwhile are moved too. Returns `None` when
/// it has no other CPU; then it stays.
#[must_use]
pub fn move_off_cpu(cpu: usize) -> Option<OffCpuGuard> {
    let me = nix::unistd::Pid::from_raw(0);
    let before = nix::sched::sched_getaffinity(me).ok()?;
    let mut others = before;
    let _ = others.unset(cpu); // fails only for a CPU that cannot be in the set
    nix::sched::sched_setaffinity(me, &others).ok().map(|()| OffCpuGuard { before })
}

impl Drop for OffCpuGuard {
    fn drop(&mut self) {
        // It was allowed a moment ago. Where it no longer is, the thread stays where it is.
        let _ = nix::sched::sched_setaffinity(nix::unistd::Pid::from_raw(0), &self.before);
    }
}

fn scheduler(priority: u8) -> SetupFinding {
    let wanted = libc::sched_param { sched_priority: i32::from(priority) };
    // Threads started from here are helpers, which must not inherit the priority.
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: 0 is the calling thread, and the parameter outlives the call.
    let failed = unsafe { libc::sched_setscheduler(0, policy, &raw const wanted) } != 0;
    let error = failed.then(|| OsError::last("sched_setscheduler"));
    let mut there = libc::sched_param { sched_priority: 0 };
    // SAFETY: 0 is the calling thread, and the parameter outlives the calls.
    let (policy, read) = unsafe { (libc::sched_getscheduler(0), libc::sched_getparam(0, &raw mut there)) };
    let name = match policy & !libc::SCHED_RESET_ON_FORK {
        libc::SCHED_FIFO => "SCHED_FIFO",
        libc::SCHED_RR => "SCHED_RR",
        libc::SCHED_OTHER => "SCHED_OTHER",
        libc::SCHED_BATCH => "SCHED_BATCH",
        libc::SCHED_IDLE => "SCHED_IDLE",
        _ => "another policy",
    };
    let ok = name == "SCHED_FIFO" && read == 0 && there.sched_priority == i32::from(priority);
    SetupFinding::new(
        "scheduler",
        format!("SCHED_FIFO {priority}"),
        format!("{name} {}", there.sched_priority),
        ok,
    )
    .failed(error)
    .remedy(format!("a priority from 1 to 99, and CAP_SYS_NICE or an rtprio limit of at least {priority}"))
}

fn affinity(cpu: usize) -> SetupFinding {
    let me = nix::unistd::Pid::from_raw(0);
    let mut only = nix::sched::CpuSet::new();
    let applied = only.set(cpu).and_then(|()| nix::sched::sched_setaffinity(me, &only));
    let error = applied.err().map(|e| OsError::of("sched_setaffinity", &e.into()));
    let remedy =
        format!("name a CPU that is online and that cpusets leave to this process (CPU {cpu} is not)");
    let wanted = format!("CPU {cpu}");
    match nix::sched::sched_getaffinity(me) {
        Ok(set) => {
            let cpus: Vec<String> = (0..nix::sched::CpuSet::count())
                .filter(|c| set.is_set(*c).unwrap_or(false))
                .map(|c| c.to_string())
                .collect();
            let got = format!("CPU {}", cpus.join(","));
            let ok = got == wanted;
            SetupFinding::new("affinity", wanted, got, ok).failed(error)
        }
        Err(e) => SetupFinding::unknown("affinity", wanted, OsError::of("sched_getaffinity", &e.into())),
    }
    .remedy(remedy)
}

fn memory_lock(system: &SystemRoot) -> SetupFinding {
    use nix::sys::mman::{MlockAllFlags, mlockall};
    // Under a limit, locking future memory would make every allocation beyond the limit fail.
    let unlimited = system.memlock_limit().ok;
    let future = if unlimited { MlockAllFlags::MCL_FUTURE } else { MlockAllFlags::empty() };
    let error =
        mlockall(MlockAllFlags::MCL_CURRENT | future).err().map(|e| OsError::of("mlockall", &e.into()));
    let locked = system.read("proc/self/status").map(|text| {
        let kilobytes = text.lines().find_map(|line| line.strip_prefix("VmLck:")?.split_whitespace().next());
        kilobytes.and_then(|kb| kb.parse::<u64>().ok()).unwrap_or(0)
    });
    match locked {
        Ok(kilobytes) => {
            let ok = unlimited && error.is_none() && kilobytes > 0;
            SetupFinding::new("memory_lock", "all pages locked", format!("{kilobytes} kB locked"), ok)
                .failed(error)
        }
        Err(unread) => SetupFinding::unknown("memory_lock", "all pages locked", error.unwrap_or(unread)),
    }
    .remedy("CAP_IPC_LOCK or an unlimited memlock limit")
}

/// Touches the stack to its working depth twice. The second pass must not fault.
fn stack() -> SetupFinding {
    let faults = || {
        nix::sys::resource::getrusage(nix::sys::resource::UsageWho::RUSAGE_THREAD)
            .map(|usage| usage.minor_page_faults() + usage.major_page_faults())
            .map_err(|e| OsError::of("getrusage", &e.into()))
    };
    touch_stack(STACK_PAGES);
    let wanted = format!("{} KiB, no page fault", STACK_BYTES / 1024);
    let second = faults().and_then(|before| {
        touch_stack(STACK_PAGES);
        Ok(faults()? - before)
    });
    match second {
        Ok(n) => SetupFinding::new("stack", wanted, format!("{n} page faults"), n == 0),
        Err(error) => SetupFinding::unknown("stack", wanted, error),
    }
    .remedy("lock the memory first: pages were taken away again")
}

#[inline(never)]
fn touch_stack(pages: usize) {
    let mut page = [0_u8; PAGE];
    std::hint::black_box(&mut page);
    if pages > 1 {
        touch_stack(pages - 1);
    }
    // A use after the call keeps the compiler from folding the frames into one.
    std::hint::black_box(&mut page);
}

/// Requests zero wake-up latency from the CPU's sleep states.
/// Reads back the smallest latency that any process requested.
fn cpu_dma_latency(system: &SystemRoot) -> (Option<File>, SetupFinding) {
    const NAME: &str = "cpu_dma_latency";
    let path = system.root.join("dev/cpu_dma_latency");
    let remedy = format!("let the group rtec-dev write {} (see udev/)", path.display());
    let open = OpenOptions::new().read(true).write(true).open(&path);
    let mut file = match open {
        Ok(file) => file,
        Err(e) => {
            let error = OsError::of(format!("open {}", path.display()), &e);
            // No device and no sleep states to leave: nothing to ask for.
            if error.errno == libc::ENOENT && !system.exists("sys/devices/system/cpu/cpu0/cpuidle/state0") {
                return (None, SetupFinding::new(NAME, "0 µs", "no sleep states", true));
            }
            return (None, SetupFinding::unknown(NAME, "0 µs", error).remedy(remedy));
        }
    };
    let mut there = [0; 4];
    let asked = file
        .write_all(&0_i32.to_ne_bytes())
        .and_then(|()| io::Seek::rewind(&mut file))
        .and_then(|()| file.read_exact(&mut there))
        .map_err(|e| OsError::of(format!("write {}", path.display()), &e));
    match asked {
        Ok(()) => {
            let us = i32::from_ne_bytes(there);
            (Some(file), SetupFinding::new(NAME, "0 µs", format!("{us} µs"), us == 0).remedy(remedy))
        }
        Err(error) => (None, SetupFinding::unknown(NAME, "0 µs", error).remedy(remedy)),
    }
}

/// Parses a CPU list such as `0-2,5`.
/// Other words are skipped: `(null)`, or flags as in `isolcpus=domain,1`.
pub fn cpu_list(text: &str) -> Vec<usize> {
    text.trim()
        .split(',')
        .filter_map(|part| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            Some(first.trim().parse::<usize>().ok()?..=last.trim().parse::<usize>().ok()?)
        })
        .flatten()
        .collect()
}

/// Major and minor number of a kernel release.
fn version(release: &str) -> (u32, u32) {
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(|n| n.parse().unwrap_or(0));
    (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without a hypervisor the leaf means something else, and is not read as a name.
    #[test]
    fn a_hypervisor_has_twelve_letters_or_fewer() {
        let letters = |features_ecx, text: &[u8; 12]| {
            let word = |k: usize| u32::from_le_bytes([text[k], text[k + 1], text[k + 2], text[k + 3]]);
            hypervisor_letters(features_ecx, [word(0), word(4), word(8)])
        };
        let there = 0x8000_0201;
        assert_eq!(letters(there, b"KVMKVMKVM\0\0\0").as_deref(), Some("KVMKVMKVM"));
        assert_eq!(letters(there, b"VMwareVMware").as_deref(), Some("VMwareVMware"));
        assert_eq!(letters(there, &[0; 12]), None);
        assert_eq!([0, 0x7fff_ffff].map(|ecx| letters(ecx, b"VMwareVMware")), [None, None]);
    }

    /// In a fresh thread, the whole working stack is present after the set-up.
    /// The kernel reports each page. The stack is still present at a second check.
    #[test]
    #[allow(clippy::unwrap_used)] // a test may
    fn the_stack_is_there_to_its_working_depth() {
        // A size of its own, so that the stack of a thread that has ended is not reused.
        let thread = std::thread::Builder::new().stack_size(24 << 20).spawn(|| {
            let finding = stack();
            let here = std::ptr::from_ref(&finding) as usize / PAGE;
            let there = |page: usize| {
                let mut resident = 0_u8;
                // SAFETY: a page of this thread's own stack, of which nothing is read, and a byte to say so in.
                let failed = unsafe { libc::mincore((page * PAGE) as *mut _, PAGE, &raw mut resident) };
                failed == 0 && resident & 1 == 1
            };
            ((1..256 / 4).take_while(|below| there(here - below)).count(), finding)
        });
        let (pages, finding) = thread.unwrap().join().unwrap();
        assert_eq!((pages, finding.wanted.as_str()), (256 / 4 - 1, "256 KiB, no page fault"));
        // A page that the system took away in between is no failure.
        let faults: usize = finding.got.split(' ').next().unwrap().parse().unwrap();
        assert!(faults < 256 / 4 / 2, "{finding:?}");
    }
}
