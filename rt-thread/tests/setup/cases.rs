//! Each finding by itself, in a tree of files.

use super::*;

/// One change of the ideal machine and the finding that must show it.
/// The fields are path, content, finding, value read, whether it forbids arming, and a word of its remedy.
type Case = (&'static str, &'static str, &'static str, &'static str, bool, &'static str);

const CASES: &[Case] = &[
    (
        "proc/sys/kernel/sched_rt_runtime_us",
        "950000\n",
        "rt_throttling",
        "950000",
        true,
        "sched_rt_runtime_us=-1",
    ),
    (
        "sys/kernel/debug/sched/fair_server/cpu3/runtime",
        "50000000\n",
        "fair_server",
        "50000000",
        true,
        "fair_server/cpu3/runtime",
    ),
    ("sys/devices/system/cpu/isolated", "\n", "isolated", "none", false, "isolcpus=3"),
    ("sys/devices/system/cpu/isolated", "1-2\n", "isolated", "1-2", false, "isolcpus=3"),
    ("sys/devices/system/cpu/nohz_full", "(null)\n", "nohz_full", "(null)", false, "nohz_full=3"),
    ("proc/cmdline", "quiet\n", "rcu_nocbs", "none", false, "rcu_nocbs=3"),
    ("proc/cmdline", "rcu_nocbs=1,2\n", "rcu_nocbs", "1,2", false, "rcu_nocbs=3"),
    ("proc/irq/9/effective_affinity_list", "2-3\n", "irq_affinity", "1: 9 acpi", false, "irqaffinity=0,1,2"),
    (
        "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
        "powersave\n",
        "governor",
        "powersave",
        false,
        "scaling_governor",
    ),
    ("sys/devices/system/cpu/cpu3/topology/thread_siblings_list", "1,3\n", "smt", "CPU 1", false, "nosmt"),
    (
        "sys/devices/system/clocksource/clocksource0/current_clocksource",
        "hpet\n",
        "clocksource",
        "hpet",
        false,
        "tsc",
    ),
    (
        "sys/kernel/mm/transparent_hugepage/enabled",
        "[always] madvise never\n",
        "transparent_hugepage",
        "always",
        false,
        "madvise",
    ),
    (
        "proc/swaps",
        "Filename Type Size Used Priority\n/dev/sda2 partition 999420 0 -2\n",
        "swap",
        "/dev/sda2",
        false,
        "swapoff",
    ),
    (
        "proc/self/limits",
        "Max locked memory         8388608   8388608  bytes\nMax realtime priority 95 95\n",
        "memlock_limit",
        "8388608",
        false,
        "@rtec - memlock unlimited",
    ),
    (
        "proc/self/limits",
        "Max locked memory unlimited unlimited bytes\nMax realtime priority     0  0\n",
        "rtprio_limit",
        "0",
        false,
        "@rtec - rtprio 80",
    ),
    (
        "proc/cpuinfo",
        "model name\t: A CPU\nflags\t\t: fpu hypervisor tsc\n",
        "hypervisor",
        "virtual machine",
        false,
        "machine itself",
    ),
];

#[test]
fn each_finding_tells_what_it_is_for_and_no_other_does() {
    for &(path, text, name, got, forbids, remedy) in CASES {
        let root = ideal();
        put(root.path(), path, text);
        let report = SystemRoot::at(root.path()).inspect(3, 80);
        assert_eq!(not_ok(&report), [name], "{path}");
        let finding = report.finding(name).unwrap();
        assert_eq!(finding.got, got);
        assert!(finding.remedy.contains(remedy), "{name}: {}", finding.remedy);
        assert_eq!(!report.can_arm(), forbids, "{name}");
    }
}
