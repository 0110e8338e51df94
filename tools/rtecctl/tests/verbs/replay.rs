//! `rtecctl replay` as a user sees it.
//! `RTEC_BLESS=1 cargo test` rewrites the golden files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/replay").join(name)
}

fn rtecctl(args: &[&str], paths: &[(&str, &Path)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
    command.args(args);
    for (flag, path) in paths {
        command.arg(flag).arg(path);
    }
    command.output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn same(name: &str, found: &str) {
    let golden = golden(name);
    if std::env::var_os("RTEC_BLESS").is_some() {
        std::fs::write(&golden, found).unwrap();
    }
    // Not assert_eq, because its message would print a whole trace.
    assert!(found == std::fs::read_to_string(&golden).unwrap_or_default(), "{name} differs");
}

#[test]
fn a_recorded_trace_is_replayed_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let (motion, requests) = (golden("motion.csv"), golden("requests.csv"));
    for design in ["c", "a", "original", "b", "ecc"] {
        let out = directory.path().join("out.csv");
        let vcd = directory.path().join("out.vcd");
        let paths: &[(&str, &Path)] =
            &[("--trace", &motion), ("--requests", &requests), ("--out", &out), ("--vcd", &vcd)];
        let run = rtecctl(&["replay", "--json", "--design", design], paths);
        assert_eq!(run.status.code(), Some(0), "{design}: {}", text(&run.stderr));
        same(&format!("{design}.json"), &text(&run.stdout));
        same(&format!("{design}.csv"), &std::fs::read_to_string(&out).unwrap());
        if design == "c" {
            same("c.vcd", &std::fs::read_to_string(&vcd).unwrap());
        }
        // The same motion as a VCD gives the same result.
        let again = directory.path().join("motion.vcd");
        assert!(rtecctl(&["trace", "convert"], &[]).status.code() == Some(2));
        let made = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["trace", "convert"])
            .args([&motion, &again])
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", text(&made.stderr));
        let other = rtecctl(
            &["replay", "--json", "--design", design],
            &[("--trace", &again), ("--requests", &requests)],
        );
        assert_eq!(text(&run.stdout), text(&other.stdout));
    }
}

#[test]
fn the_document_has_the_keys_of_the_contract() {
    let (motion, requests) = (golden("motion.csv"), golden("requests.csv"));
    let run = rtecctl(&["replay", "--json"], &[("--trace", &motion), ("--requests", &requests)]);
    let document = crate::document(&run.stdout);
    for key in [
        "counts_in",
        "counts_out",
        "requested",
        "completed",
        "insertions",
        "illegal_in",
        "illegal_out",
        "min_edge_separation_ns",
        "waited_for_gate",
        "refused",
        "faults",
    ] {
        assert!(document.get(key).is_some(), "no {key} in {document}");
    }
    // 140 is inserted; 9999 is beyond ±1000 and is refused.
    assert_eq!(
        (&document["requested"], &document["refused"][0]["why"]),
        (&140.into(), &"above_maximum".into())
    );
    assert_eq!(document["completed"], 140);
    assert!(document["min_edge_separation_ns"].as_u64().unwrap() >= 500);
    // Without --json the output is a table.
    let run = rtecctl(&["replay"], &[("--trace", &motion), ("--requests", &requests)]);
    assert!(text(&run.stdout).contains("balances"), "{}", text(&run.stdout));
}

const CONFIG: &str = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=9\n\
                      max_correction_counts=1000\nwindow_counts=30\nmin_separation_ns=500\n";

#[test]
fn a_configuration_brings_its_belief_window() {
    let directory = tempfile::tempdir().unwrap();
    let config = directory.path().join("rtec.toml");
    std::fs::write(&config, CONFIG).unwrap();
    let (motion, requests) = (golden("motion.csv"), golden("requests.csv"));
    let paths: &[(&str, &Path)] = &[("--trace", &motion), ("--requests", &requests), ("--config", &config)];
    let run = rtecctl(&["replay", "--json"], paths);
    let document = crate::document(&run.stdout);
    // 10 → −30 is a change of 40. The window of 30 refuses a total too far from the last accepted one.
    let refused: Vec<_> = document["refused"].as_array().unwrap().iter().map(|r| &r["why"]).collect();
    assert_eq!(refused, ["not_believed", "not_believed", "above_maximum"], "{document}");
    assert_eq!((run.status.code(), &document["requested"]), (Some(0), &11.into()));

    // Three refusals in a row latch a fault ("I still don't believe you"), exit 4; the ledger still balances.
    let wild = directory.path().join("wild.csv");
    std::fs::write(&wild, "t_ns,requested\n0,20\n1000000,500\n2000000,501\n3000000,502\n").unwrap();
    let run =
        rtecctl(&["replay", "--json"], &[("--trace", &motion), ("--requests", &wild), ("--config", &config)]);
    let document = crate::document(&run.stdout);
    assert_eq!(run.status.code(), Some(4), "{}", text(&run.stderr));
    assert_eq!(document["faults"][0]["fault"], "still_not_believed");
    assert_eq!(document["illegal_out"], 0);
    let number = |key: &str| document[key].as_i64().unwrap();
    assert_eq!(number("counts_out") - number("counts_in"), number("completed"));

    // An unknown axis, and a configuration with a mistake.
    let run = rtecctl(&["replay", "--axis", "y"], paths);
    assert_eq!(run.status.code(), Some(2));
    assert!(text(&run.stderr).contains("found no axis y, expected x"), "{}", text(&run.stderr));
    std::fs::write(&config, CONFIG.replace("window_counts", "windw_counts")).unwrap();
    let run = rtecctl(&["replay"], paths);
    assert_eq!(run.status.code(), Some(2));
    assert!(text(&run.stderr).contains("did you mean window_counts?"), "{}", text(&run.stderr));
}

#[test]
fn bad_input_is_named_and_leaves_nothing_behind() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str, text: &str| {
        let path = directory.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let good = at("good.csv", "t_ns,a,b\n0,0,0\n1000,1,0\n");
    let back = at("back.csv", "t_ns,a,b\n0,0,0\n2000,1,0\n1000,1,1\n");
    let none = at("none.csv", "t_ns,requested\n");
    let late = at("late.csv", "t_ns,requested\n5,1\n4,2\n");
    let missing = directory.path().join("missing.csv");
    let out = directory.path().join("out.csv");
    let as_text = directory.path().join("out.txt");
    for (trace, requests, out, wants) in [
        (&back, &none, &out, "back.csv:4:1: found '1000', expected a time after the row before, 2000 ns"),
        (&good, &late, &out, "late.csv:3:1: found '4'"),
        (&missing, &none, &out, "missing.csv: found No such file"),
        (&good, &none, &as_text, "expected a trace ending in .csv or .vcd"),
    ] {
        let paths: &[(&str, &Path)] = &[("--trace", trace), ("--requests", requests), ("--out", out)];
        let run = rtecctl(&["replay", "--json"], paths);
        assert_eq!(run.status.code(), Some(2), "{wants}: {}", text(&run.stderr));
        assert!(text(&run.stderr).contains(wants), "{}", text(&run.stderr));
        assert!(run.stdout.is_empty());
        assert!(!out.exists());
    }
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 4, "a temporary file was left");
    let run = rtecctl(&["replay", "--design", "d"], &[("--trace", &good), ("--requests", &none)]);
    assert_eq!(run.status.code(), Some(2));
    assert!(text(&run.stderr).contains("original, a, b, c, ecc"), "{}", text(&run.stderr));
}

#[test]
fn an_illegal_transition_is_a_latched_fault_not_a_guess() {
    let directory = tempfile::tempdir().unwrap();
    let trace = directory.path().join("t.csv");
    std::fs::write(
        &trace,
        "t_ns,a,b\n0,0,0\n1000000,1,0\n2000000,1,1\n3000000,0,0\n4000000,1,0\n5000000,1,1\n",
    )
    .unwrap();
    let requests = directory.path().join("r.csv");
    std::fs::write(&requests, "t_ns,requested\n0,10\n").unwrap();
    let run = rtecctl(&["replay", "--json"], &[("--trace", &trace), ("--requests", &requests)]);
    assert_eq!(run.status.code(), Some(4));
    assert!(text(&run.stderr).contains("illegal transition latched at 3000000 ns"), "{}", text(&run.stderr));
    let document = crate::document(&run.stdout);
    assert_eq!(document["illegal_in"], 1);
    assert_eq!(document["insertions"], 1);
}

/// B never changes while A does 300 times, or the other way round.
/// 40 counts are requested at 1 ms.
#[test]
fn latches_a_broken_wire_and_inserts_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let swapped = directory.path().join("a-broken.csv");
    let rows = std::fs::read_to_string(golden("b-broken.csv")).unwrap();
    let rows = rows.lines().skip(1).map(|row| {
        let fields: Vec<_> = row.split(',').collect();
        format!("{},{},{}\n", fields[0], fields[2], fields[1])
    });
    std::fs::write(&swapped, "t_ns,a,b\n".to_owned() + &rows.collect::<String>()).unwrap();
    for trace in [golden("b-broken.csv"), swapped] {
        for requests in ["t_ns,requested\n1000000,40\n", "t_ns,requested\n0,40\n"] {
            let asked = directory.path().join("requests.csv");
            std::fs::write(&asked, requests).unwrap();
            let run = rtecctl(&["replay", "--json"], &[("--trace", &trace), ("--requests", &asked)]);
            assert_eq!(run.status.code(), Some(4), "{}", text(&run.stderr));
            assert!(text(&run.stderr).contains("channel dead latched at 425000 ns"), "{}", text(&run.stderr));
            let document = crate::document(&run.stdout);
            assert_eq!(document["faults"][0]["fault"], "channel_dead");
            assert_eq!((&document["insertions"], &document["completed"]), (&0.into(), &0.into()));
        }
    }
}

/// NISTIR 4832, Design B: single counts.
/// CMTI (2014), figures 8 and 9: three pulses added, three subtracted.
#[test]
fn designs_that_drive_the_signals_themselves_replay_too() {
    let directory = tempfile::tempdir().unwrap();
    let (trace, requests) = (directory.path().join("t.csv"), directory.path().join("r.csv"));
    // 10 kHz encoder frequency, forward.
    let states = ["0,0", "1,0", "1,1", "0,1"];
    let rows = (0..4000).map(|n| format!("{},{}\n", n * 25_000, states[n % 4]));
    std::fs::write(&trace, "t_ns,a,b\n".to_owned() + &rows.collect::<Vec<_>>().concat()).unwrap();
    std::fs::write(&requests, "t_ns,requested\n20000000,13\n60000000,-12\n").unwrap();
    for (design, insertions) in [("b", 13 + 25), ("ecc", 2)] {
        let paths: &[(&str, &Path)] = &[("--trace", &trace), ("--requests", &requests)];
        let run = rtecctl(&["replay", "--json", "--design", design], paths);
        assert_eq!(run.status.code(), Some(0), "{design}: {}", text(&run.stderr));
        let document = crate::document(&run.stdout);
        assert_eq!(
            (&document["counts_in"], &document["completed"]),
            (&3999.into(), &(-12).into()),
            "{design}"
        );
        assert_eq!(
            (&document["counts_out"], &document["illegal_out"]),
            (&3987.into(), &0.into()),
            "{design}"
        );
        assert_eq!(document["insertions"], insertions, "{design}");
    }
}

/// The Error Correction Circuit requests only compensations sure to succeed.
/// On a slow axis it waits, and the ledger balances (CMTI 2014, section 2.2.2: the PLL doubles from 700 Hz of
/// the XOR signal).
#[test]
fn the_ecc_waits_on_a_slow_axis_and_balances() {
    let directory = tempfile::tempdir().unwrap();
    let (trace, requests) = (directory.path().join("t.csv"), directory.path().join("r.csv"));
    let states = ["0,0", "1,0", "1,1", "0,1"];
    std::fs::write(&requests, "t_ns,requested\n2000000,12\n").unwrap();
    for (period_ns, served) in [(5_000_000_u64, 0), (1_000_000, 0), (400_000, 0), (25_000, 12)] {
        let rows = (0..2000).map(|n| format!("{},{}\n", n * period_ns, states[(n % 4) as usize]));
        std::fs::write(&trace, "t_ns,a,b\n".to_owned() + &rows.collect::<Vec<_>>().concat()).unwrap();
        let run = rtecctl(
            &["replay", "--json", "--design", "ecc"],
            &[("--trace", &trace), ("--requests", &requests)],
        );
        assert_eq!(run.status.code(), Some(0), "{period_ns}: {}", text(&run.stderr));
        let document = crate::document(&run.stdout);
        let number = |key: &str| document[key].as_i64().unwrap();
        assert_eq!(number("counts_out") - number("counts_in"), served, "{document}");
        assert_eq!(number("completed"), served);
        assert_eq!(number("waited_for_gate") > 0, served == 0);
        let said = text(&run.stderr);
        assert_eq!(said.contains("+12 of the requested +12 counts were not made"), served == 0, "{said}");
    }
}

#[test]
fn all_requests_refused_is_a_no() {
    let directory = tempfile::tempdir().unwrap();
    let (trace, requests) = (golden("motion.csv"), directory.path().join("r.csv"));
    for (asked, code) in [("0,9999\n5000000,-5000\n", 1), ("0,9999\n5000000,12\n", 0), ("", 0)] {
        std::fs::write(&requests, format!("t_ns,requested\n{asked}")).unwrap();
        let run = rtecctl(&["replay"], &[("--trace", &trace), ("--requests", &requests)]);
        assert_eq!(run.status.code(), Some(code), "{asked}: {}", text(&run.stderr));
        if code == 1 {
            assert!(text(&run.stderr).contains("every request was refused (above maximum)"));
        }
    }
}

/// A bad row right after the first is named like any other row.
#[test]
fn a_bad_second_row_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let (trace, requests) = (directory.path().join("bad.csv"), directory.path().join("r.csv"));
    std::fs::write(&trace, "t_ns,a,b\n0,0,0\n1000,1,x\n").unwrap();
    std::fs::write(&requests, "t_ns,requested\n0,10\n").unwrap();
    for design in ["c", "b", "ecc"] {
        let run = rtecctl(&["replay", "--design", design], &[("--trace", &trace), ("--requests", &requests)]);
        assert_eq!(run.status.code(), Some(2));
        assert!(text(&run.stderr).contains("bad.csv:3:"), "{design}: {}", text(&run.stderr));
    }
}

/// A reader that closes the pipe is not an error, for any verb.
#[test]
fn a_reader_that_goes_away_is_no_error() {
    let (motion, requests) = (golden("motion.csv"), golden("requests.csv"));
    let replay = ["replay", "--trace", motion.to_str().unwrap(), "--requests", requests.to_str().unwrap()];
    for arguments in [
        &replay[..],
        &["card", "list"],
        &["config", "default"],
        &["completions", "bash"],
        &["simulate", "--list"],
    ] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(arguments)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let said = text(&output.stderr);
        assert!(output.status.code() == Some(0) && !said.contains("panicked"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_motion_that_no_axis_makes_is_refused() {
    for option in ["--encoder-hz", "--accel"] {
        for value in ["1e300", "1e-300", "inf", "nan", "0", "-1"] {
            let run = rtecctl(&["designs", &format!("{option}={value}")], &[]);
            assert_eq!(run.status.code(), Some(2), "{option} {value}: {}", text(&run.stderr));
            assert!(text(&run.stderr).contains("expected a number from"), "{}", text(&run.stderr));
        }
    }
}

/// A replay adds to the times of a trace.
/// The latest time that the format allows leaves no room for that.
#[test]
fn refuses_to_play_the_latest_times() {
    let directory = tempfile::tempdir().unwrap();
    let requests = directory.path().join("requests.csv");
    std::fs::write(&requests, "t_ns,requested\n0,2\n18446744073709551615,4\n").unwrap();
    let vcd = "$timescale 1 ns $end\n$var wire 1 ! a $end\n$var wire 1 \" b $end\n$enddefinitions $end\n\
               #0\n0!\n0\"\n#9223372036854775808\n1!\n";
    for (name, content, wants) in [
        (
            "late.csv",
            "t_ns,a,b\n0,0,0\n10,1,0\n18446744073709551615,1,1\n",
            "late.csv:4: found the time 18446744073709551615 ns",
        ),
        (
            "first.csv",
            "t_ns,a,b\n9223372036854775808,0,0\n",
            "first.csv:2: found the time 9223372036854775808 ns",
        ),
        ("late.vcd", vcd, "found the time 9223372036854775808 ns"),
        (
            "latest.csv",
            "t_ns,a,b\n9223372036854775000,0,0\n9223372036854775400,1,0\n9223372036854775807,1,1\n",
            "",
        ),
    ] {
        let trace = directory.path().join(name);
        std::fs::write(&trace, content).unwrap();
        for design in ["c", "a", "original", "b", "ecc"] {
            let args = ["replay", "--json", "--design", design];
            let run = rtecctl(&args, &[("--trace", &trace), ("--requests", &requests)]);
            let said = text(&run.stderr);
            let refused = run.status.code() == Some(2)
                && said.contains(wants)
                && said.contains("expected a time of at most 9223372036854775807 ns");
            assert!(
                if wants.is_empty() { run.status.code() == Some(0) } else { refused },
                "{name} {design}: {said}"
            );
        }
    }
}
