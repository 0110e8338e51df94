//! Settings applied to this machine, and reports where that fails.

use super::*;

fn is_root() -> bool {
    // SAFETY: takes nothing, touches nothing.
    unsafe { libc::geteuid() == 0 }
}

/// The settings of the calling thread as the kernel shows them in `/proc`.
/// The set-up's own report is not used.
struct Shown {
    policy: u32,
    rt_priority: u32,
    cpus: String,
    locked_kb: u64,
}

fn shown() -> Shown {
    let stat = fs::read_to_string("/proc/thread-self/stat").unwrap();
    // Fields 40 and 41 of proc(5), counted after the name in brackets, which is field 2.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    let status = fs::read_to_string("/proc/thread-self/status").unwrap();
    let line = |key: &str| status.lines().find_map(|l| l.strip_prefix(key)).unwrap().trim().to_owned();
    Shown {
        rt_priority: fields[37].parse().unwrap(),
        policy: fields[38].parse().unwrap(),
        cpus: line("Cpus_allowed_list:"),
        locked_kb: line("VmLck:").trim_end_matches(" kB").parse().unwrap(),
    }
}

#[test]
fn root_gets_everything_that_is_ours_to_apply() {
    if !is_root() {
        return test_needs::skipped(
            "not root, so SCHED_FIFO, mlockall and cpu_dma_latency cannot be applied here",
        );
    }
    std::thread::spawn(|| {
        let system = SystemRoot::live();
        let cpu = system.default_cpu();
        let before = shown();
        let (held, report) = apply(&system, RtSettings { cpu, priority: 42 });
        let after = shown();
        assert_eq!((before.policy, before.rt_priority), (0, 0));
        assert_eq!((after.policy, after.rt_priority), (libc::SCHED_FIFO as u32, 42));
        assert_eq!(after.cpus, cpu.to_string());
        assert!(after.locked_kb > 1000, "{} kB locked", after.locked_kb);
        let open = |what: &str| {
            fs::read_dir("/proc/self/fd")
                .unwrap()
                .flatten()
                .any(|fd| fs::read_link(fd.path()).is_ok_and(|target| target == Path::new(what)))
        };
        assert!(open("/dev/cpu_dma_latency"));
        drop(held);
        assert!(!open("/dev/cpu_dma_latency"), "closed with the guard");
        for name in ["scheduler", "affinity", "memory_lock", "stack", "cpu_dma_latency"] {
            let finding: &SetupFinding = report.finding(name).unwrap();
            assert!(finding.ok && finding.needed_to_arm, "{finding:?}");
        }
    })
    .join()
    .unwrap();
}

#[test]
fn without_privileges_it_runs_on_and_names_what_is_missing() {
    std::thread::spawn(|| {
        // The system call itself, so that only this thread changes its user.
        // SAFETY: three numbers go in, no memory is touched.
        let dropped = unsafe { libc::syscall(libc::SYS_setresuid, 65534, 65534, 65534) } == 0;
        assert!(dropped || !is_root());
        let system = SystemRoot::live();
        let (_held, report) = apply(&system, RtSettings { cpu: system.default_cpu(), priority: 80 });
        assert!(!report.can_arm());
        let scheduler = report.finding("scheduler").unwrap();
        let limit = report.finding("rtprio_limit").unwrap();
        assert_eq!(scheduler.ok, limit.ok, "the limit explains the refusal");
        if !limit.ok {
            assert_eq!(scheduler.errno.as_ref().unwrap().errno, libc::EPERM);
            assert_eq!(scheduler.errno.as_ref().unwrap().operation, "sched_setscheduler");
            assert_eq!((shown().policy, shown().rt_priority), (0, 0));
            assert!(scheduler.remedy.contains("CAP_SYS_NICE"));
        }
        let affinity = report.finding("affinity").unwrap();
        assert!(affinity.ok, "needs no privilege: {affinity:?}");
    })
    .join()
    .unwrap();
}

#[test]
fn a_thread_leaves_the_cpu_and_may_come_back() {
    std::thread::spawn(|| {
        let before = shown().cpus;
        let cpu = SystemRoot::live().default_cpu();
        match move_off_cpu(cpu) {
            Some(left) => {
                assert!(
                    !std::thread::spawn(shown)
                        .join()
                        .unwrap()
                        .cpus
                        .split([',', '-'])
                        .any(|c| c == cpu.to_string())
                );
                drop(left);
            }
            None => assert_eq!(before, cpu.to_string(), "only with no other CPU"),
        }
        assert_eq!(shown().cpus, before);
    })
    .join()
    .unwrap();
}

#[test]
fn impossible_wishes_are_reported_not_fatal() {
    std::thread::spawn(|| {
        let (_held, report) = apply(&SystemRoot::live(), RtSettings { cpu: 1000, priority: 100 });
        let errno = |name: &str| report.finding(name).unwrap().errno.as_ref().unwrap().errno;
        assert_eq!(errno("scheduler"), libc::EINVAL);
        assert_eq!(errno("affinity"), libc::EINVAL);
        assert!(!report.can_arm());
    })
    .join()
    .unwrap();
}

/// The report of a new thread set up by a tree of files.
/// The system calls are real; the files decide what is read back.
fn applied(root: &Path, priority: u8, before: impl FnOnce() + Send + 'static) -> SetupReport {
    let system = SystemRoot::at(root);
    std::thread::spawn(move || {
        before();
        apply(&system, RtSettings { cpu: SystemRoot::live().default_cpu(), priority }).1
    })
    .join()
    .unwrap()
}

/// Latency is requested only where the CPU has sleep states.
/// Without device and sleep states nothing is requested. With sleep states, a device that is missing or cannot be
/// opened is a failure.
#[test]
fn wake_up_latency_is_asked_for_where_there_is_something_to_wake_from() {
    let root = ideal();
    let latency = |root: &Path| applied(root, 100, || ()).finding("cpu_dma_latency").unwrap().clone();
    let none = latency(root.path());
    assert_eq!((none.got.as_str(), none.ok, none.errno), ("no sleep states", true, None));
    put(root.path(), "sys/devices/system/cpu/cpu0/cpuidle/state0/name", "POLL");
    let missing = latency(root.path());
    assert_eq!((missing.ok, missing.errno.as_ref().map(|e| e.errno)), (false, Some(libc::ENOENT)));
    let root = ideal();
    fs::create_dir_all(root.path().join("dev/cpu_dma_latency")).unwrap();
    let unopened = latency(root.path());
    assert_eq!((unopened.ok, unopened.errno.as_ref().map(|e| e.errno)), (false, Some(libc::EISDIR)));
    // The group is the one that the udev rule gives the device to.
    let rule =
        include_str!("../../../udev/60-rtec.rules").split_once("cpu_dma_latency\", GROUP:=\"").unwrap().1;
    let group = rule.split('"').next().unwrap();
    let asked = format!("let the group {group} write {}/dev/cpu_dma_latency ", root.path().display());
    assert!(unopened.remedy.starts_with(&asked), "{}", unopened.remedy);
}

/// Memory counts as locked where the kernel shows it and no limit excludes more.
#[test]
fn memory_is_locked_when_all_of_it_is_and_the_kernel_shows_it() {
    const LIMITED: &str = "Max locked memory 8388608 8388608 bytes\nMax realtime priority 95 95\n";
    let lock = |shown: &str, limits: Option<&str>| {
        let root = ideal();
        put(root.path(), "proc/self/status", shown);
        if let Some(text) = limits {
            put(root.path(), "proc/self/limits", text);
        }
        applied(root.path(), 100, || ()).finding("memory_lock").unwrap().clone()
    };
    let all = lock("VmLck:\t    4096 kB\n", None);
    // Without the right to lock memory, the call itself is refused, and that is reported.
    assert_eq!((all.got.as_str(), all.ok), ("4096 kB locked", all.errno.is_none()));
    assert!(all.ok || !is_root(), "{all:?}");
    let nothing = lock("VmLck:\t       0 kB\n", None);
    assert_eq!((nothing.got.as_str(), nothing.ok), ("0 kB locked", false));
    let in_part = lock("VmLck:\t    4096 kB\n", Some(LIMITED));
    assert_eq!((in_part.got.as_str(), in_part.ok), ("4096 kB locked", false));
    assert!(in_part.remedy.contains("unlimited memlock"));
}

/// The scheduler in effect is read back, not the wanted one.
/// A priority that no thread can have leaves the thread as it was.
#[test]
fn the_scheduler_that_is_there_is_read_back_by_name() {
    let set = |policy: i32, priority: i32| {
        move || {
            let wanted = libc::sched_param { sched_priority: priority };
            // SAFETY: 0 is the calling thread, and the parameter outlives the call.
            assert_eq!(unsafe { libc::sched_setscheduler(0, policy, &raw const wanted) }, 0);
        }
    };
    let root = ideal();
    let mut cases = vec![
        (libc::SCHED_OTHER, 0, "SCHED_OTHER 0"),
        (libc::SCHED_BATCH, 0, "SCHED_BATCH 0"),
        (libc::SCHED_IDLE, 0, "SCHED_IDLE 0"),
    ];
    if is_root() {
        cases.extend([(libc::SCHED_RR, 5, "SCHED_RR 5"), (libc::SCHED_FIFO, 7, "SCHED_FIFO 7")]);
    }
    for (policy, priority, got) in cases {
        let finding = applied(root.path(), 100, set(policy, priority)).finding("scheduler").unwrap().clone();
        let errno = finding.errno.as_ref().map(|e| e.errno);
        assert_eq!((finding.got.as_str(), finding.ok, errno), (got, false, Some(libc::EINVAL)));
    }
    let none = applied(root.path(), 0, || ()).finding("scheduler").unwrap().clone();
    assert!(
        none.got == "SCHED_OTHER 0" && !none.ok,
        "priority 0 of another scheduler is not what was wanted: {none:?}"
    );
}
