//! `rtecctl trace` as a user sees it, and on a real axis's record.

use rtec_driver::quadrature::Decoder;
use rtec_files::quadrature_trace::TraceReader;
use std::process::{Command, Output};

fn trace(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl")).arg("trace").args(args).output().unwrap()
}

#[test]
fn a_trace_goes_there_and_back() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (csv, vcd, back) = (path("t.csv"), path("t.vcd"), path("back.csv"));
    let text = "t_ns,a,b\n5,0,0\n1000,1,0\n2500,1,1\n2501,0,0\n";
    std::fs::write(&csv, text).unwrap();
    let run = trace(&["convert", &csv, &vcd, "--json"]);
    assert!(run.status.success(), "{run:?}");
    let document = crate::document(&run.stdout);
    let want = serde_json::json!({
        "out": vcd, "edges": 3, "net_counts": 2, "illegal": 1, "start_ns": 5, "end_ns": 2501,
        "min_edge_separation_ns": 1, "format": 1, "by": document["by"],
    });
    assert_eq!(document, want);
    assert!(trace(&["convert", &vcd, &back]).status.success());
    assert_eq!(std::fs::read_to_string(&back).unwrap(), text);
    // The output may not replace the input, which stays.
    assert_eq!(trace(&["convert", &back, &back]).status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(&back).unwrap(), text);
}

#[test]
fn bad_input_ends_with_2_says_where_and_leaves_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let (bad, out) = (path("bad.csv"), path("out.vcd"));
    std::fs::write(&bad, "t_ns,a,b\n5,0,0\n4,1,0\n").unwrap();
    for (args, message) in [
        (
            ["convert", &bad, &out].as_slice(),
            "bad.csv:3:1: found '4', expected a time after the row before, 5 ns",
        ),
        (&["convert", &path("none.csv"), &out], "No such file or directory"),
        (&["convert", &bad, &path("out.xml")], "expected a trace ending in .csv or .vcd"),
        (
            &["from-position", &bad, "--count-um", "1", "--out", &out],
            "one column whose name begins with position",
        ),
        (&["from-position", &bad, "--count-um", "0", "--out", &out], "expected a number above 0"),
    ] {
        let run = trace(args);
        let said = String::from_utf8(run.stderr).unwrap();
        assert!(run.status.code() == Some(2) && said.contains(message) && run.stdout.is_empty(), "{said}");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1, "{args:?} left a file");
    }
}

/// At every sample the trace's count agrees with the record.
/// The difference is within the interpolator's hysteresis.
#[test]
fn a_real_axis_is_followed_to_the_count() {
    const HYSTERESIS_COUNTS: f64 = 0.25;
    if !test_needs::long() {
        return;
    }
    let Some(record) = test_needs::shared("data/axis_dynamics/identification.csv") else { return };
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("scale.csv");
    let (from, to) = (record.to_str().unwrap(), out.to_str().unwrap());
    let hysteresis = HYSTERESIS_COUNTS.to_string();
    let run =
        trace(&["from-position", from, "--count-um", "1", "--out", to, "--hysteresis-counts", &hysteresis]);
    assert!(run.status.success(), "{run:?}");

    let mut edges = TraceReader::open(&out).unwrap().map(Result::unwrap).peekable();
    let mut scale = Decoder::new(edges.next().unwrap().state);
    let (mut start, mut samples) = (None, 0);
    for row in std::fs::read_to_string(&record).unwrap().lines().skip(1) {
        let mut fields = row.split(',').map(|field| field.parse::<f64>().unwrap());
        let (t_s, position_m) = (fields.next().unwrap(), fields.nth(1).unwrap());
        let t_ns = (t_s * 1e9).round() as u64;
        while let Some(edge) = edges.next_if(|edge| edge.t_ns <= t_ns) {
            assert!(scale.update(edge.state).is_some(), "both signals change at {} ns", edge.t_ns);
        }
        let counts = position_m * 1e6;
        let start = *start.get_or_insert(counts.floor());
        // A count means the micrometre above it; the hysteresis widens that by half of itself on either side.
        let within = counts - start - scale.count() as f64;
        let half = HYSTERESIS_COUNTS / 2.0 + 1e-6;
        assert!((-half..=1.0 + half).contains(&within), "{within} counts off at {t_s} s");
        samples += 1;
    }
    assert_eq!((edges.next(), samples), (None, 24_841));
}
