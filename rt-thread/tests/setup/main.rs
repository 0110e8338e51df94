//! The set-up of a real-time thread, on trees of files and on this machine.
//! Every finding is tested on a tree of files that looks like a system.
#![allow(clippy::unwrap_used)] // a test may
mod applied;
mod cases;

use rtec_rt::realtime_setup::{
    OsError, RtSettings, SetupFinding, SetupReport, SystemRoot, apply, move_off_cpu,
};
use std::fs;
use std::path::Path;

/// An ideal machine that reserves CPU 3 for real time.
const IDEAL: &[(&str, &str)] = &[
    ("proc/sys/kernel/osrelease", "6.12.48-rt-amd64\n"),
    (
        "proc/version",
        "Linux version 6.12.48-rt-amd64 (Debian) #1 SMP PREEMPT_RT Debian 6.12.48-1 (2025-09-20)\n",
    ),
    ("proc/cmdline", "quiet isolcpus=managed_irq,domain,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0-2\n"),
    ("proc/cpuinfo", "processor\t: 0\nmodel name\t: A CPU\nflags\t\t: fpu tsc constant_tsc nonstop_tsc\n"),
    ("proc/swaps", "Filename\t\t\t\tType\t\tSize\t\tUsed\t\tPriority\n"),
    ("proc/sys/kernel/sched_rt_runtime_us", "-1\n"),
    ("proc/thread-self/status", "Name:\trtec\nCapEff:\t0000000000000000\n"),
    (
        "proc/self/limits",
        "Limit                     Soft Limit           Hard Limit           Units     \n\
         Max locked memory         unlimited            unlimited            bytes     \n\
         Max realtime priority     95                   95                             \n",
    ),
    ("proc/irq/9/acpi/.keep", ""),
    ("proc/irq/9/effective_affinity_list", "0\n"),
    ("proc/irq/30/smp_affinity_list", "0-3\n"),
    ("sys/kernel/realtime", "1\n"),
    ("sys/kernel/debug/sched/fair_server/cpu3/runtime", "0\n"),
    ("sys/kernel/mm/transparent_hugepage/enabled", "always [madvise] never\n"),
    ("sys/devices/system/cpu/online", "0-3\n"),
    ("sys/devices/system/cpu/isolated", "3\n"),
    ("sys/devices/system/cpu/nohz_full", "3\n"),
    ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "performance\n"),
    ("sys/devices/system/cpu/cpu3/topology/thread_siblings_list", "3\n"),
    ("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n"),
];

fn put(root: &Path, path: &str, text: &str) {
    let path = root.join(path);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

fn ideal() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    for (path, text) in IDEAL {
        put(root.path(), path, text);
    }
    root
}

fn not_ok(report: &SetupReport) -> Vec<&str> {
    report.findings.iter().filter(|f| !f.ok).map(|f| f.name).collect()
}

#[test]
fn an_ideal_machine_has_no_remedy() {
    let root = ideal();
    let system = SystemRoot::at(root.path());
    assert_eq!(system.default_cpu(), 3);
    let report = system.inspect(3, 80);
    assert_eq!(not_ok(&report), Vec::<&str>::new());
    assert!(report.can_arm());
    assert!(report.findings.iter().all(|f| f.remedy.is_empty() && f.errno.is_none()));
    assert_eq!(report.kernel, "6.12.48-rt-amd64");
    assert_eq!(
        report.kernel_command_line,
        "isolcpus=managed_irq,domain,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0,1,2"
    );
}

#[test]
fn the_command_line_is_compared_with_what_the_kernel_was_booted_with() {
    for (booted, lacks) in [
        ("quiet isolcpus=managed_irq,domain,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0-2", ""),
        // More CPUs than this one, and fewer for interrupts, are accepted.
        ("isolcpus=domain,managed_irq,2-3 nohz_full=2-3 rcu_nocbs=1-3 irqaffinity=0", ""),
        (
            "isolcpus=3 nohz_full=2 irqaffinity=0-3",
            "isolcpus=managed_irq,domain,3 nohz_full=3 rcu_nocbs=3 irqaffinity=0,1,2",
        ),
        // The kernel uses the last of two.
        ("nohz_full=3 nohz_full=2 isolcpus=managed_irq,domain,3 rcu_nocbs=3 irqaffinity=0-2", "nohz_full=3"),
    ] {
        let root = ideal();
        put(root.path(), "proc/cmdline", booted);
        assert_eq!(SystemRoot::at(root.path()).inspect(3, 80).kernel_command_line_lacks, lacks, "{booted}");
    }
}

#[test]
fn a_kernel_that_is_not_preempt_rt_is_named() {
    let root = ideal();
    fs::remove_file(root.path().join("sys/kernel/realtime")).unwrap();
    put(root.path(), "proc/version", "Linux version 6.18.44 #1 SMP PREEMPT_DYNAMIC @0\n");
    let report = SystemRoot::at(root.path()).inspect(3, 80);
    assert_eq!(not_ok(&report), ["preempt_rt"]);
    assert_eq!(report.finding("preempt_rt").unwrap().got, "PREEMPT_DYNAMIC");
}

#[test]
fn a_capability_overrides_a_limit() {
    let root = ideal();
    put(
        root.path(),
        "proc/self/limits",
        "Max locked memory 8388608 8388608 bytes\nMax realtime priority 0 0\n",
    );
    put(root.path(), "proc/thread-self/status", "CapEff:\t0000000000804000\n");
    assert_eq!(not_ok(&SystemRoot::at(root.path()).inspect(3, 80)), Vec::<&str>::new());
    put(root.path(), "proc/thread-self/status", "CapEff:\t0000000000004000\n");
    assert_eq!(not_ok(&SystemRoot::at(root.path()).inspect(3, 80)), ["rtprio_limit"]);
}

#[test]
fn emulation_is_named_from_the_cpu_s_name() {
    let root = ideal();
    put(root.path(), "proc/cpuinfo", "model name\t: QEMU TCG CPU version 2.5+\nflags\t\t: fpu hypervisor\n");
    let report = SystemRoot::at(root.path()).inspect(3, 80);
    assert_eq!(report.emulated.as_deref(), Some("QEMU TCG"));
    assert_eq!(report.finding("hypervisor").unwrap().got, "emulated by QEMU TCG");
}

#[test]
fn an_older_kernel_has_no_fair_server_and_a_hidden_one_cannot_be_required() {
    let root = ideal();
    fs::remove_dir_all(root.path().join("sys/kernel/debug")).unwrap();
    let hidden = SystemRoot::at(root.path()).inspect(3, 80);
    let finding = hidden.finding("fair_server").unwrap();
    assert!(!finding.ok && !finding.needed_to_arm && hidden.can_arm());
    assert_eq!(finding.errno.as_ref().unwrap().errno, libc::ENOENT);
    put(root.path(), "proc/sys/kernel/osrelease", "6.6.101-rt59\n");
    assert!(SystemRoot::at(root.path()).inspect(3, 80).finding("fair_server").unwrap().ok);
}

#[test]
fn an_empty_tree_arms_nothing_and_says_which_file_is_missing() {
    let root = tempfile::tempdir().unwrap();
    let system = SystemRoot::at(root.path());
    assert_eq!(system.default_cpu(), 0);
    let report = system.inspect(0, 80);
    assert!(!report.can_arm());
    let throttling = report.missing().next().unwrap();
    assert_eq!(throttling.name, "rt_throttling");
    let error = throttling.errno.as_ref().unwrap();
    assert_eq!(error.errno, libc::ENOENT);
    assert!(error.operation.contains("sched_rt_runtime_us"), "{error}");
    assert_eq!(report.kernel_command_line, "", "one CPU cannot be set apart");
}

#[test]
fn the_report_is_one_json_object() {
    let root = ideal();
    put(root.path(), "proc/sys/kernel/sched_rt_runtime_us", "950000\n");
    let json = serde_json::to_value(SystemRoot::at(root.path()).inspect(3, 80)).unwrap();
    assert_eq!(json["cpu"], 3);
    let throttling = &json["findings"][0];
    assert_eq!(throttling["name"], "rt_throttling");
    assert_eq!(
        (throttling["ok"].as_bool(), throttling["needed_to_arm"].as_bool()),
        (Some(false), Some(true))
    );
}

#[test]
fn online_cpus_are_those_of_the_machine_not_of_the_thread() {
    let root = tempfile::tempdir().unwrap();
    put(root.path(), "sys/devices/system/cpu/online", "0-2,5\n");
    assert_eq!(SystemRoot::at(root.path()).cpus_online(), 4);
    assert_eq!(SystemRoot::at(&root.path().join("nowhere")).cpus_online(), 0);
}

#[test]
fn what_failed_is_said_in_the_kernels_words() {
    let error = OsError { operation: "open /dev/cpu_dma_latency".into(), errno: libc::EACCES };
    assert_eq!(error.to_string(), "open /dev/cpu_dma_latency: Permission denied (os error 13)");
}

/// `PREEMPT_RT` is known by the kernel's own word or by its version.
#[test]
fn preempt_rt_is_told_by_the_kernel_or_by_its_version() {
    let (rt, not) =
        ("Linux version 6.12.48 #1 SMP PREEMPT_RT", "Linux version 6.12.48 #1 SMP PREEMPT_DYNAMIC");
    for (realtime, version, got) in [
        (Some("1"), not, "PREEMPT_RT"),
        (None, rt, "PREEMPT_RT"),
        (None, "Linux version 4.19.1-rt1 #1 SMP PREEMPT RT", "PREEMPT_RT"),
        (Some("0"), not, "PREEMPT_DYNAMIC"),
        (None, "Linux version 6.1.0 #1 SMP", "not preemptible"),
    ] {
        let root = ideal();
        fs::remove_file(root.path().join("sys/kernel/realtime")).unwrap();
        if let Some(text) = realtime {
            put(root.path(), "sys/kernel/realtime", text);
        }
        put(root.path(), "proc/version", version);
        let report = SystemRoot::at(root.path()).inspect(3, 80);
        let finding = report.finding("preempt_rt").unwrap();
        assert_eq!((finding.got.as_str(), finding.ok), (got, got == "PREEMPT_RT"), "{realtime:?} {version}");
    }
}

/// Three options take the RCU callbacks off a CPU.
/// They are `all`, a list with this CPU, and `nohz_full` with this CPU.
#[test]
fn callbacks_are_taken_off_a_cpu_by_any_of_three_words() {
    for (booted, ok) in [
        ("rcu_nocbs=all", true),
        ("rcu_nocbs=1-3", true),
        ("nohz_full=3", true),
        ("rcu_nocbs=1 nohz_full=3", true),
        ("rcu_nocbs=1 nohz_full=2", false),
        ("rcu_nocbs=none", false),
    ] {
        let root = ideal();
        put(root.path(), "proc/cmdline", booted);
        let finding = SystemRoot::at(root.path()).inspect(3, 80).finding("rcu_nocbs").unwrap().clone();
        assert_eq!(finding.ok, ok, "{booted}: {finding:?}");
    }
}

/// A missing file means that the kernel lacks the feature.
/// A file that cannot be read means nothing, and is named.
#[test]
fn what_is_not_there_is_told_from_what_cannot_be_read() {
    for (path, name, without, fine) in [
        ("sys/devices/system/cpu/isolated", "isolated", "none", false),
        ("sys/devices/system/cpu/nohz_full", "nohz_full", "none", false),
        ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "governor", "no frequency scaling", true),
        ("sys/kernel/mm/transparent_hugepage/enabled", "transparent_hugepage", "none in this kernel", true),
    ] {
        let root = ideal();
        fs::remove_file(root.path().join(path)).unwrap();
        let missing = SystemRoot::at(root.path()).inspect(3, 80).finding(name).unwrap().clone();
        assert_eq!((missing.got.as_str(), missing.ok, missing.errno), (without, fine, None), "{name}");
        fs::create_dir(root.path().join(path)).unwrap();
        let unread = SystemRoot::at(root.path()).inspect(3, 80).finding(name).unwrap().clone();
        let errno = unread.errno.as_ref().map(|e| e.errno);
        assert_eq!((unread.got.as_str(), unread.ok, errno), ("unknown", false, Some(libc::EISDIR)), "{name}");
        assert!(!unread.remedy.is_empty(), "{name}");
    }
}

/// The name of a hypervisor is read where the kernel reports one.
/// The name has nine letters or more. Without a hypervisor there is none.
#[test]
fn a_hypervisor_is_named_by_its_letters() {
    let cpuinfo = fs::read_to_string("/proc/cpuinfo").unwrap();
    let flags = cpuinfo.lines().find(|line| line.starts_with("flags")).unwrap_or_default();
    let flagged = flags.split_whitespace().any(|flag| flag == "hypervisor");
    let report = SystemRoot::live().inspect(0, 80);
    let finding = report.finding("hypervisor").unwrap();
    let letters = finding.got.strip_prefix("virtual machine (").and_then(|rest| rest.strip_suffix(')'));
    assert_eq!(finding.ok, !flagged, "{finding:?}");
    match letters {
        Some(letters) => assert!((9..=12).contains(&letters.len()), "{finding:?}"),
        None => assert!(!flagged || report.emulated.is_some(), "{finding:?}"),
    }
}
