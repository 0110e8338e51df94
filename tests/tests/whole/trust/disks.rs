//! Full disks, late looks and throttling.

use super::{Line, wants};
use rtec_tests::daemon::{Daemon, alone, program, until};
use rtec_tests::disk::SmallDisk;
use rtec_tests::skipped;
use std::process::Command;
use std::time::Instant;

#[test]
fn a_full_disk_under_the_record_stops_no_correction_and_is_told() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let Some(disk) = SmallDisk::mount(&at("disk"), 32) else {
        return skipped("no file system can be mounted here");
    };
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nlog_file='disk/audit.log'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    let mut line = Line::to(&at("s"));
    let mut log = || line.ask(&wants("observe"))["observed"]["log"].clone();
    until("the record has begun", || log()["last_n"].as_u64() >= Some(3));
    disk.fill();
    let mut n = 0;
    until("the record is in trouble", || {
        n += 2;
        daemon.expect(0, &["correct", "x", &(n % 40).to_string()]);
        log()["trouble"].is_string()
    });
    until("corrected", || daemon.status()["axes"][0]["completed"] == n % 40);
    disk.free();
    until("the record goes on", || log()["trouble"].is_null() && log()["lost"] == 0);
    assert!(daemon.expect(0, &["log"]).contains("lost, "));
    assert!(daemon.expect(0, &["log", "--verify"]).contains("lines, number 1 to"));
}

/// Regression: a model unloaded on a full disk came back at the next start.
#[test]
fn what_a_full_disk_does_not_remember_is_said_and_never_comes_back() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let Some(disk) = SmallDisk::mount(&at("disk"), 32) else {
        return skipped("no file system can be mounted here");
    };
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nstate_file='disk/state'\n\
                  [model]\nfile='m.toml'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    std::fs::write(at("m.toml"), "name = 'm'\n").unwrap();
    let start = || Daemon::start(&at("s"), Some(&at("rtec.toml")));
    let daemon = start();
    disk.fill();
    let said = daemon.expect(0, &["model", "load", "--yes"]);
    assert!(
        said.contains("loaded\n") && said.contains("a restart will not know which model was loaded"),
        "{said}"
    );
    disk.free();
    assert!(!daemon.expect(0, &["model", "load", "--yes"]).contains("warning"));
    disk.fill();
    assert!(!daemon.expect(0, &["model", "unload"]).contains("warning"));
    drop(daemon);
    disk.free();
    assert!(start().status()["model"].is_null());
}

#[test]
fn who_was_late_is_seen_on_the_mock_too() {
    if !test_needs::long() {
        return;
    }
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    // Longer than the silence that is logged.
    let (begun, stopped_s) = (Instant::now(), 3.1);
    daemon.pause(|| begun.elapsed().as_secs_f64() > stopped_s + 0.2);
    let max_s = || daemon.status()["rt"]["poll_gap_ns"]["max"].as_f64().unwrap() * 1e-9;
    assert!(max_s() >= stopped_s, "{} s, and it was stopped for {stopped_s} s", max_s());
    until("it says so", || daemon.log().contains("the daemon did not run for "));
    until("the record", || daemon.expect(0, &["log"]).contains("stood still: the daemon did not run for "));
}

#[test]
fn a_record_that_cannot_be_written_is_told_everywhere() {
    let _alone = alone();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[control]\nlog_file='later/audit.log'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    until("it says so", || daemon.log().contains("is not written: No such file or directory"));
    daemon.expect(0, &["home"]);
    let said = daemon.expect(0, &["status"]);
    assert!(
        said.contains("record of commands not written: ") && said.contains("corrections go on"),
        "{said}"
    );
    assert!(daemon.expect(0, &["metrics"]).contains("\nrtec_record_trouble 1\n"));
    let check =
        Command::new(program("rtecctl")).args(["config", "check"]).arg(at("rtec.toml")).output().unwrap();
    assert_eq!(check.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&check.stderr).contains("expected a folder that is there"), "{check:?}");
    std::fs::create_dir(at("later")).unwrap();
    until("it says so", || daemon.log().contains("is written again"));
    assert!(!daemon.expect(0, &["status"]).contains("record of commands"));
    // The record is whole up to its end, and says where it ends.
    let said = daemon.expect(0, &["log", "--verify"]);
    assert!(said.contains("commands were not recorded"), "{said}");
    // No other process writes it.
    let second = Daemon::start(&at("s2"), Some(&at("rtec.toml")));
    until("it says so", || second.log().contains("another process writes it"));
    daemon.expect(0, &["disable"]);
    assert_eq!(daemon.user(&["log", "--verify"]).status.code(), Some(0));
}

/// Settings of the whole machine are restored when the service has ended.
#[test]
fn the_machine_gets_its_throttling_back() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let put = |path: &str, text: &str| {
        let file = root.join(path);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, text).unwrap();
    };
    let get = |path: &str| std::fs::read_to_string(root.join(path)).unwrap().trim().to_owned();
    let [throttling, fair, governor] = [
        "proc/sys/kernel/sched_rt_runtime_us",
        "sys/kernel/debug/sched/fair_server/cpu0/runtime",
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
    ];
    put(throttling, "950000\n");
    put(fair, "50000000\n");
    put(governor, "schedutil\n");
    put("run/nothing", "");
    let script = rtec_tests::root().join("udev/realtime");
    let run = |what: &str| {
        let done = Command::new("sh").arg(&script).arg(what).env("RTEC_ROOT", root).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    // Twice: a restart without a stop between, as after a crash.
    for _ in 0..2 {
        run("set");
        assert_eq!([get(throttling), get(fair), get(governor)], ["-1", "0", "performance"]);
    }
    run("restore");
    assert_eq!([get(throttling), get(fair), get(governor)], ["950000", "50000000", "schedutil"]);
    run("restore");
    assert_eq!(get(throttling), "950000");
}
