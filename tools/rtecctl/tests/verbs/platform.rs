//! `rtecctl platform` on a recorded machine.
//! It is an office PC with Debian as installed, nothing set up yet, and a GPIO card.

use std::process::{Command, Output};

fn platform(options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .arg("platform")
        .args(options)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/platform"))
        .output()
        .expect("the binary was built with this test")
}

#[test]
fn text_is_as_recorded() {
    let out = platform(&["--root", "machine", "--config", "gpio.toml"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("a real card would not be armed: "));
    assert_eq!(String::from_utf8_lossy(&out.stdout), include_str!("../platform/machine.txt"));
}

#[test]
fn json_is_as_recorded() {
    let out = platform(&["--root", "machine", "--config", "gpio.toml", "--json"]);
    assert_eq!(out.status.code(), Some(1));
    assert_eq!(String::from_utf8_lossy(&out.stdout), include_str!("../platform/machine.json"));
}

#[test]
fn on_the_running_machine_it_prints_one_document_and_changes_nothing() {
    let throttling = || std::fs::read_to_string("/proc/sys/kernel/sched_rt_runtime_us").unwrap_or_default();
    let before = throttling();
    let out = platform(&["--json", "--cpu", "0"]);
    let document = crate::document(&out.stdout);
    let findings = document["findings"].as_array().expect("a list");
    for name in ["scheduler", "affinity", "memory_lock", "stack", "cpu_dma_latency", "rt_throttling"] {
        assert!(findings.iter().any(|f| f["name"] == name), "{name}");
    }
    let all_there = findings.iter().all(|f| f["ok"] == true || f["needed_to_arm"] == false);
    assert_eq!(document["can_arm"], all_there);
    assert_eq!(out.status.code(), Some(i32::from(!all_there)));
    assert_eq!(throttling(), before);
}

#[test]
fn a_priority_that_does_not_exist_is_a_usage_error() {
    assert_eq!(platform(&["--priority", "100"]).status.code(), Some(2));
}
