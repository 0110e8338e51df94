//! `rtecctl selftest latency`: the ledger, the document and the text's shape.
//! No figure is asserted, because times depend on the computer.

use serde_json::Value;
use std::process::{Command, Output};
use test_needs::skipped;

fn latency(options: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["selftest", "latency", "--duration", "600ms"])
        .args(options)
        .output()
        .expect("the binary was built with this test")
}

fn text(out: &Output) -> String {
    String::from_utf8(out.stdout.clone()).expect("UTF-8")
}

/// The shape of a line, for comparison.
/// Every number becomes one 9, and runs of blanks may vary with its width.
fn shape(line: &str) -> String {
    let mut shape = String::new();
    for c in line.chars() {
        let c = if c.is_ascii_digit() { '9' } else { c };
        if !(matches!(c, '9' | ' ') && shape.ends_with(c)) {
            shape.push(c);
        }
    }
    shape.replace(": 9", ":9").replace("( 9", "(9")
}

#[test]
fn the_document_has_every_key_and_the_far_side_counted_what_the_engine_completed() {
    for backend in ["mock", "mapped"] {
        let out = latency(&["--json", "--backend", backend]);
        let document = crate::document(&out.stdout);
        for key in [
            "wakeup_ns",
            "poll_gap_ns",
            "edge_to_done_ns",
            "poll_gap_with_requests_ns",
            "edge_to_done_with_requests_ns",
        ] {
            for figure in ["min", "p50", "p99", "p9999", "max", "samples"] {
                assert!(document[key][figure].is_u64(), "{backend}: {key}.{figure}");
            }
            let counts =
                document[key]["histogram"].as_array().expect("buckets").iter().map(|b| b[2].as_u64());
            assert_eq!(counts.sum::<Option<u64>>(), document[key]["samples"].as_u64());
        }
        let verdict = document["verdict"].as_str().expect("a verdict");
        assert_eq!(out.status.code(), Some(i32::from(verdict == "fail")));
        assert_eq!(verdict == "pass", document["reason"] == "");
        let safe = &document["max_safe_edge_rate_hz"]["default"];
        assert!(safe.is_f64() || safe.is_null() && verdict == "fail");
        assert!(document["wakeup_ns"]["samples"].as_u64() > Some(0));
        if document["far_side"].is_null() {
            skipped("one CPU only, so nobody can play the machine while the engine polls");
            continue;
        }
        assert_eq!(document["ledger_balanced"], true);
        for key in ["edge_to_done_ns", "edge_to_done_with_requests_ns"] {
            assert!(document[key]["samples"].as_u64() > Some(0), "{backend}: no insertion, {key}");
        }
        assert!(document["requests"].as_u64() > Some(0), "{backend}: no request streamed in");
        // The gate gets the worse of the two.
        let detect_ns = document["rt"]["detect_ns"].as_u64();
        assert!(detect_ns >= document["poll_gap_ns"]["max"].as_u64());
        assert!(detect_ns >= document["poll_gap_with_requests_ns"]["max"].as_u64());
        assert_eq!(document["far_side"]["illegal"], 0);
        // At every single insertion the MTC had its separation after the edge and between the inversions.
        assert!(document["edge_to_done_ns"]["min"].as_u64() >= document["separations_ns"].as_u64());
    }
}

#[test]
fn unmet_settings_fail_with_their_remedy() {
    let out = latency(&["--json"]);
    let document = crate::document(&out.stdout);
    let missing = document["missing_to_arm"].as_array().expect("a list");
    let reason = document["reason"].as_str().expect("a text");
    for name in missing {
        assert!(reason.contains(name.as_str().expect("a name")), "{reason}");
    }
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(reason.is_empty() || stderr.contains(reason), "{stderr}");
}

#[test]
fn without_privileges_it_measures_all_the_same_and_names_what_is_missing() {
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::process::CommandExt;
    const NOBODY: u32 = 65534;
    let dir = tempfile::tempdir().expect("a directory");
    let program = dir.path().join("rtecctl");
    std::fs::copy(env!("CARGO_BIN_EXE_rtecctl"), &program).expect("a copy that everybody may run");
    for path in [dir.path(), &program] {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).expect("our own file");
    }
    let mut command = Command::new(&program);
    command.args(["selftest", "latency", "--duration", "600ms", "--json"]);
    let root = std::fs::metadata("/proc/self").is_ok_and(|me| std::os::unix::fs::MetadataExt::uid(&me) == 0);
    if root {
        command.uid(NOBODY).gid(NOBODY).current_dir("/");
    }
    let out = command.output().expect("the copy runs");
    let document = crate::document(&out.stdout);
    assert!(document["poll_gap_ns"]["samples"].as_u64() > Some(0));
    assert_eq!(document["ledger_balanced"], true, "{document}");
    let missing =
        |name: &str| document["missing_to_arm"].as_array().is_some_and(|m| m.iter().any(|f| f == name));
    // A user with a real-time limit gets the priority without being root.
    if root || missing("scheduler") {
        assert!(missing("scheduler"));
        assert_eq!((out.status.code(), &document["verdict"]), (Some(1), &Value::from("fail")));
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(stderr.contains("sched_setscheduler: Operation not permitted"), "{stderr}");
        assert!(stderr.contains("CAP_SYS_NICE"), "{stderr}");
    }
}

#[test]
fn text_and_histogram_file_have_the_shape_of_cyclictest() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("histogram");
    let out = text(&latency(&["--histfile", file.to_str().expect("UTF-8")]));
    let histogram = std::fs::read_to_string(&file).expect("the histogram file");
    assert!(
        !out.contains("# Histogram") && out.lines().count() < 60,
        "as with cyclictest, in the file alone: {out}"
    );
    let without = text(&latency(&[]));
    let rows = without.lines().filter(|l| l.starts_with("000")).count();
    assert!(without.contains("# Histogram\n000000 ") && rows == 400, "without a file, {rows} rows");
    assert_eq!(std::fs::read_dir(dir.path()).expect("a directory").count(), 1, "no temporary file stays");
    assert_eq!(out.lines().filter(|l| l.starts_with("T:")).count(), 3);
    // As plotting scripts read it: rows are lines that are neither empty nor comments, and the maximum is in
    // a comment.
    let rows: Vec<&str> = histogram.lines().filter(|l| !l.is_empty() && !l.starts_with('#')).collect();
    assert_eq!(rows.len(), 400);
    assert!(rows.iter().enumerate().all(|(us, row)| row.starts_with(&format!("{us:06} "))));

    let arguments = ["-q", "-l", "20", "-i", "1000", "-t", "3", "-h", "400"];
    let Ok(cyclictest) = Command::new("cyclictest").args(arguments).output() else {
        skipped("cyclictest (Debian rt-tests) is not there to be compared with");
        return;
    };
    let theirs = text(&cyclictest);
    let their_rows: Vec<&str> = theirs.lines().filter(|l| !l.is_empty() && !l.starts_with('#')).collect();
    assert_eq!(their_rows.len(), rows.len());
    for (ours, theirs) in rows.iter().zip(&their_rows) {
        assert_eq!(shape(ours), shape(theirs));
        assert_eq!(ours.split_once(' ').map(|s| s.0), theirs.split_once(' ').map(|s| s.0));
    }
    for key in [
        "# Histogram",
        "# Total:",
        "# Min Latencies:",
        "# Avg Latencies:",
        "# Max Latencies:",
        "# Histogram Overflows:",
    ] {
        let line = |text: &str| text.lines().find(|l| l.starts_with(key)).map(shape);
        assert!(line(&theirs).is_some(), "{key} in cyclictest's output:\n{theirs}");
        assert_eq!(line(&histogram), line(&theirs), "{key}");
    }
    let plain = Command::new("cyclictest").args(["-q", "-l", "20", "-i", "1000", "-t", "3"]).output();
    let plain = text(&plain.expect("it ran a moment ago"));
    let thread = |text: &str| text.lines().find(|l| l.starts_with("T: 0")).map(shape);
    assert_eq!(thread(&out), thread(&plain));
}

#[test]
fn the_configuration_s_axes_have_their_own_rates() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("rtec.toml");
    let text = include_str!("../../../control/src/default.toml");
    std::fs::write(&file, text).expect("a writable directory");
    let names: Vec<String> =
        rtec_control::config::Config::embedded().axes.into_iter().map(|a| a.name).collect();
    let out = latency(&["--json", "--config", file.to_str().expect("UTF-8")]);
    let document = crate::document(&out.stdout);
    let rates = document["max_safe_edge_rate_hz"].as_object().expect("an object");
    assert!(names.iter().all(|name| rates.contains_key(name)) && rates.len() == names.len(), "{rates:?}");
    assert!(document["rt"]["detect_ns"].is_u64() && document["rt"]["write_ns"].is_u64());

    std::fs::write(&file, "[machine]\nnmae = \"x\"\n").expect("a writable directory");
    let out = latency(&["--config", file.to_str().expect("UTF-8")]);
    assert_eq!(out.status.code(), Some(2));
    assert!(out.stdout.is_empty() && String::from_utf8_lossy(&out.stderr).contains("rtec.toml:2"));
}

#[test]
fn a_duration_that_is_none_is_a_usage_error() {
    let out = latency(&["--duration", "soon"]);
    assert_eq!(out.status.code(), Some(2));
}

#[test]
fn a_histogram_file_that_cannot_be_written_is_known_before_the_measurement() {
    let out = latency(&["--histfile", "/nonexistent/histogram"]);
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(2));
    assert!(stderr.contains("/nonexistent/histogram") && !stderr.contains("wake-up"), "{stderr}");
}

/// A card that is a file of registers, and a configuration that names it.
struct Bench {
    directory: tempfile::TempDir,
}

impl Bench {
    fn new(registers: Option<&[u8]>) -> Self {
        let bench = Self { directory: tempfile::tempdir().expect("a directory") };
        if let Some(registers) = registers {
            std::fs::write(bench.at("registers"), registers).expect("registers");
        }
        let text = "[machine]\nname = 'bench'\n[card]\nbackend = 'mapped'\nfile = 'registers'\nhold = 'out28'\n[[axis]]\n\
            name = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 100\nwindow_counts = 50\n\
            min_separation_ns = 500\nmax_accel_mm_s2 = 1000.0\nrapid_mm_min = 1.0\n\
            lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }\n[control]\nsocket = 's'\n";
        std::fs::write(bench.at("rtec.toml"), text).expect("a configuration");
        bench
    }

    fn at(&self, name: &str) -> std::path::PathBuf {
        self.directory.path().join(name)
    }

    fn latency(&self, options: &[&str]) -> (Option<i32>, String, String) {
        let config = self.at("rtec.toml");
        let out = latency(&[&["--config", config.to_str().expect("UTF-8")], options].concat());
        (out.status.code(), text(&out), String::from_utf8(out.stderr).expect("UTF-8"))
    }

    fn bytes(&self) -> Vec<u8> {
        std::fs::read(self.at("registers")).expect("registers")
    }
}

/// Feed hold and both inverters on, as a daemon may leave them.
const LEFT_ON: [u8; 8] = [0, 0, 0, 0, 3, 0, 0, 0x10];

#[test]
fn refuses_where_there_is_nothing_to_measure() {
    let absent = Bench::new(None);
    for options in [&["--json"][..], &["--drive", "--mtc-is-off"]] {
        let (code, out, said) = absent.latency(options);
        assert_eq!((code, out.as_str()), (Some(3), ""), "{said}");
        assert!(said.contains("registers: No such file"), "{said}");
    }
    let bench = Bench::new(Some(&LEFT_ON));
    for backend in ["mock", "gpio", "port"] {
        let (code, out, said) = bench.latency(&["--backend", backend]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{said}");
        assert!(said.contains("mapped") && said.contains("leave --backend out"), "{said}");
    }
    for backend in ["gpio", "port"] {
        let out = latency(&["--backend", backend]);
        assert_eq!(out.status.code(), Some(2));
        assert!(String::from_utf8_lossy(&out.stderr).contains("needs --config FILE"));
    }
    assert_eq!(latency(&["--drive"]).status.code(), Some(2), "no card is named");
    let replay = "[machine]\nname='m'\n[card]\nbackend='replay'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=9\n\
        max_correction_counts=8\nwindow_counts=8\nmin_separation_ns=500\ntrace='t.csv'\n";
    std::fs::write(bench.at("rtec.toml"), replay).expect("a configuration");
    let (code, out, said) = bench.latency(&[]);
    assert_eq!((code, out.as_str()), (Some(2), ""), "{said}");
    assert_eq!(bench.bytes(), LEFT_ON);
}

#[test]
fn reads_the_configured_card_and_holds_its_outputs() {
    let bench = Bench::new(Some(&LEFT_ON));
    let histogram = bench.at("histogram");
    let (code, out, said) = bench.latency(&["--json", "--histfile", histogram.to_str().expect("UTF-8")]);
    let document: Value = serde_json::from_str(&out).expect("one JSON document");
    let named = format!("mapped {}, shared-memory test card", bench.at("registers").display());
    assert_eq!(
        (code, &document["card"], &document["how"]),
        (Some(1), &named.as_str().into(), &"reads".into()),
        "{said}"
    );
    assert_eq!(
        (&document["rt"]["measured"]["card"], &document["backend"]),
        (&named.as_str().into(), &"mapped".into())
    );
    assert!(document["rt"]["write_ns"].is_null() && document["verdict"] == "fail");
    assert_eq!(bench.bytes(), LEFT_ON, "every output is as it was");
    assert!(said.contains(&named) && std::fs::read_to_string(histogram).expect("a file").contains(&named));
    if document["poll_gap_ns"]["samples"] == 0 {
        skipped("one CPU only, so nothing can be polled");
        return;
    }
    assert!(document["reason"].as_str().expect("a text").contains("--drive measures them"), "{document}");
    let gap = document["poll_gap_ns"]["max"].as_u64();
    assert!(document["rt"]["detect_ns"].as_u64() > gap, "an edge behind a reading waits for the one after");
    let (_, out, _) = bench.latency(&[]);
    assert!(out.contains(&format!("# Card: {named}")) && out.contains("every output was held"), "{out}");
    assert!(out.contains("# Verdict: fail") && out.contains("reads only: "), "{out}");
    assert!(out.contains("# Max Safe Edge Rate, axis x: not measured") && !out.contains("no speed"), "{out}");
    assert!(!out.contains("For the configuration"), "no figures before the writes are measured: {out}");
}

#[test]
fn drives_the_card_only_when_the_mtc_is_said_to_be_off() {
    let bench = Bench::new(Some(&LEFT_ON));
    let (code, out, said) = bench.latency(&["--drive"]);
    assert_eq!((code, out.as_str()), (Some(1), ""), "nobody has said anything: {said}");
    assert!(said.contains("the MTC is off") && said.contains("nothing was written"), "{said}");
    assert_eq!(bench.bytes(), LEFT_ON);

    let (_, out, said) = bench.latency(&["--drive", "--mtc-is-off", "--json"]);
    let document: Value = serde_json::from_str(&out).expect("one JSON document");
    assert_eq!(bench.bytes(), LEFT_ON, "the outputs end as they were found");
    if document["poll_gap_ns"]["samples"] == 0 {
        skipped("one CPU only, so nothing can be polled");
        return;
    }
    let how = &document["how"]["reads_and_writes"];
    assert_eq!((&how["restored"], &how["ended_by"]), (&true.into(), &Value::Null), "{document} {said}");
    assert!(
        document["seen_to_done_with_requests_ns"]["samples"].as_u64() > Some(0),
        "no insertion: {document}"
    );
    assert!(document["rt"]["write_ns"].is_u64() && document["ledger_balanced"] == true, "{document}");
    let (_, out, _) = bench.latency(&["--drive", "--mtc-is-off"]);
    // The lines can be copied unchanged below [rt].
    let lines = out.lines().skip_while(|l| !l.contains("these three lines")).skip(1).take(3);
    let lines: Vec<&str> = lines.collect();
    let keys: Vec<&str> = lines.iter().filter_map(|l| l.split(" = ").next()).collect();
    assert_eq!(keys, ["detect_ns", "write_ns", "measured"], "{out}");
    assert!(lines[2].starts_with("measured = { card = \"mapped "), "{out}");
}

#[test]
fn leaves_a_card_alone_that_a_daemon_works_with() {
    let bench = Bench::new(Some(&LEFT_ON));
    let _daemon = rtec_control::single_process_lock::socket(&bench.at("s")).expect("a lock");
    let (code, out, said) = bench.latency(&[]);
    assert_eq!((code, out.as_str()), (Some(1), ""), "{said}");
    assert!(said.contains("stop it first"), "{said}");
}
