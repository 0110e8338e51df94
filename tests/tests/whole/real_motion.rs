//! A real axis's recorded motion as edges, with corrections throughout.
//! It runs `rtecctl trace`, then `rtecctl replay`.

use rtec_tests::{daemon::program, shared};
use serde_json::Value;
use std::fmt::Write;
use std::process::Command;

/// A ball-screw axis: 0.25 m strokes over 24.8 s, noisy at rest.
/// The record is the EMPS benchmark (Janot, Gautier, Brunot).
#[test]
fn every_request_is_served_and_the_ledger_balances() {
    if !test_needs::long() {
        return;
    }
    let Some(record) = shared("data/axis_dynamics/identification.csv") else { return };
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    // A total every 100 ms, up and down by at most 60 counts a step. The last one leaves time to complete it.
    let mut requests = String::from("t_ns,requested\n");
    let total = |n: i64| 2 * ((n as f64 / 5.0).sin() * 150.0) as i64;
    for n in 1..=240 {
        writeln!(requests, "{},{}", n * 100_000_000, total(n)).unwrap();
    }
    std::fs::write(at("requests.csv"), requests).unwrap();
    // Finer counts are left to the stage `real`, with another program as the judge: 0.1 µm are 20 million states.
    for count_um in ["1", "0.5"] {
        let mut trace = Command::new(program("rtecctl"));
        trace.args(["trace", "from-position", "--column", "position_m", "--count-um", count_um]).arg(&record);
        assert!(trace.arg("--out").arg(at("scale.csv")).status().unwrap().success());
        let mut replay = Command::new(program("rtecctl"));
        replay.args(["replay", "--json", "--trace"]).arg(at("scale.csv"));
        let run = replay.arg("--requests").arg(at("requests.csv")).output().unwrap();
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        let outcome: Value = serde_json::from_slice(&run.stdout).unwrap();
        eprintln!("{count_um} µm: {outcome}");
        let number = |key: &str| outcome[key].as_i64().unwrap();
        assert_eq!((number("requested"), number("completed")), (total(240), total(240)));
        assert_eq!(number("counts_out") - number("counts_in"), number("completed"));
        assert_eq!((number("illegal_in"), number("illegal_out")), (0, 0));
        assert_eq!(
            (&outcome["refused"], &outcome["faults"]),
            (&serde_json::json!([]), &serde_json::json!([]))
        );
        assert!(number("insertions") > 1000 && number("min_edge_separation_ns") >= 500);
    }
}
