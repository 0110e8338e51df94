//! Readers of the daemon: ledger, single values, JSON lines, bug reports.
//! It also checks the texts of refusals.

use rtec_files::quadrature_trace::TraceReader;
use rtec_tests::daemon::{Daemon, among_others, program, until};
use rtec_tests::judge::{LINUXCNC, LinuxCnc, available};
use rtec_tests::ledger::walk;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};

fn corrected() -> (tempfile::TempDir, Daemon) {
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    for total in [12, 0, -6, 4, 14, 20] {
        daemon.expect(0, &["correct", "x", &total.to_string()]);
        until("completed", || daemon.status()["axes"][0]["completed"] == total);
    }
    daemon.expect(0, &["correct", "y", "-12"]);
    until("completed", || daemon.status()["axes"][1]["completed"] == -12);
    (directory, daemon)
}

#[test]
fn a_ledger_replays_to_the_same_totals() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let (directory, daemon) = corrected();
    let out = directory.path().join("ledger");
    let name = |file: &str| out.join(file).to_str().unwrap().to_owned();
    let said = daemon.expect(0, &["ledger", "export", "--out", out.to_str().unwrap()]);
    assert!(said.contains("axis x: ") && said.contains("replayed: the same"), "{said}");
    for (axis, total) in [("x", 20), ("y", -12), ("z", 0)] {
        let run = Command::new(program("rtecctl"))
            .args(["replay", "--json", "--trace", &name(&format!("{axis}_trace.csv"))])
            .args(["--requests", &name(&format!("{axis}_requests.csv"))])
            .args(["--out", &name(&format!("{axis}_mtc.csv"))])
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
        let replayed: Value = serde_json::from_slice(&run.stdout).unwrap();
        assert_eq!(
            (&replayed["completed"], &replayed["requested"]),
            (&total.into(), &total.into()),
            "{axis}"
        );
        assert_eq!(replayed["illegal_out"], 0);
        // LinuxCNC counts the MTC's trace as the ledger does, at every state.
        if available(LINUXCNC) {
            let read =
                |kind: &str| TraceReader::open(Path::new(&name(&format!("{axis}_{kind}.csv")))).unwrap();
            let mut judge = LinuxCnc::new().unwrap();
            let totals = walk(read("trace"), read("mtc"), |point, due| judge.show(point.state, due)).unwrap();
            let verdict = judge.verdict().unwrap();
            assert_eq!((totals.inserted, verdict.wrong, verdict.judged), (total, 0, totals.states), "{axis}");
        }
    }
    // Every insertion is between two looks.
    let table = std::fs::read_to_string(name("x_insertions.csv")).unwrap();
    let rows: Vec<Vec<i64>> =
        table.lines().skip(1).map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect();
    assert!(rows.is_sorted_by_key(|r| r[2]) && rows.iter().all(|r| r[0] <= r[2]), "{table}");
    let insertions = daemon.status()["axes"][0]["insertions"].as_i64().unwrap();
    assert_eq!(rows.last().map(|r| (r[5], r[7])), Some((20, insertions)));
    let document: Value =
        serde_json::from_str(&std::fs::read_to_string(name("ledger.json")).unwrap()).unwrap();
    assert_eq!(
        (&document["axes"][0]["replays"], &document["axes"][0]["changes_dropped"]),
        (&true.into(), &0.into())
    );
    assert!(
        daemon
            .expect(2, &["ledger", "export", "--axis", "w", "--out", out.to_str().unwrap()])
            .contains("x, y, z")
    );
}

#[test]
fn one_value_and_a_document_a_line() {
    let _room = among_others();
    let (directory, daemon) = corrected();
    let get = |name: &str| daemon.expect(0, &["get", name]);
    assert_eq!(get("axes.x.completed"), "20\n");
    assert_eq!(get("axes.1.completed"), "-12\n");
    assert_eq!(get("mode"), "run\n");
    assert_eq!(daemon.expect(0, &["get", "mode", "--json"]), "\"run\"\n");
    let names: Vec<String> = serde_json::from_str(&daemon.expect(0, &["get", "--json"])).unwrap();
    assert_eq!(names.join("\n") + "\n", daemon.expect(0, &["get"]));
    assert_eq!(get("protocol"), "1\n");
    assert!(get("rt.poll_gap_ns.p9999").trim().parse::<u64>().unwrap() > 0);
    assert!(daemon.expect(2, &["get", "axes.w.completed"]).contains("expected one of axes's x, y, z"));
    assert!(daemon.expect(1, &["get", "model.sha256"]).contains("no model is loaded"));
    let socket = directory.path().join("s");
    let mut watch = Command::new(program("rtecctl"))
        .args(["status", "--watch", "--json", "--every", "20ms", "--socket"])
        .arg(&socket)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines: Vec<String> =
        BufReader::new(watch.stdout.take().unwrap()).lines().take(5).map(Result::unwrap).collect();
    let _ = watch.kill();
    watch.wait().unwrap();
    let up: Vec<f64> = lines
        .iter()
        .map(|l| serde_json::from_str::<Value>(l).unwrap()["uptime_s"].as_f64().unwrap())
        .collect();
    assert!(up.len() == 5 && up.is_sorted(), "{up:?}");
    drop(daemon);
    let gone =
        Command::new(program("rtecctl")).args(["get", "mode", "--socket"]).arg(&socket).output().unwrap();
    assert_eq!(gone.status.code(), Some(3));
}

#[test]
fn a_bug_report_is_for_its_owner_and_whole() {
    let _room = among_others();
    let (directory, daemon) = corrected();
    let config = directory.path().join("rtec.toml");
    std::fs::write(&config, "[machine]\nname = \"m\"\npassword = \"hunter2\"\n").unwrap();
    let out = directory.path().join("report.tar");
    let args = ["bugreport", "--out", out.to_str().unwrap(), "--of", config.to_str().unwrap()];
    // A journal with lines of the service.
    let bin = directory.path().join("bin");
    std::fs::create_dir(&bin).unwrap();
    let put = |script: &str| {
        std::fs::write(bin.join("journalctl"), script).unwrap();
        std::fs::set_permissions(bin.join("journalctl"), std::fs::Permissions::from_mode(0o755)).unwrap();
    };
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let report = |args: &[&str]| {
        let mut command = Command::new(program("rtecctl"));
        command.args(args).arg("--socket").arg(directory.path().join("s")).env("PATH", &path);
        let run = command.current_dir(directory.path()).output().unwrap();
        (run.status.code(), String::from_utf8([run.stdout, run.stderr].concat()).unwrap())
    };
    put("#!/bin/sh\necho started\n");
    let (code, said) = report(&args);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("state.json: ") && said.contains("read it before"), "{said}");
    assert!(!said.contains("missing") && !said.contains("is of machine"), "{said}");
    assert_eq!(std::fs::metadata(&out).unwrap().permissions().mode() & 0o777, 0o600);
    let read = |name: &str| {
        let run =
            Command::new("tar").arg("-xOf").arg(&out).arg(format!("rtec-bugreport/{name}")).output().unwrap();
        assert!(run.status.success(), "{name}: {}", String::from_utf8_lossy(&run.stderr));
        String::from_utf8(run.stdout).unwrap()
    };
    let state: Value = serde_json::from_str(&read("state.json")).unwrap();
    assert_eq!(state["status"]["axes"][0]["completed"], 20);
    assert!(read("rtec.toml").contains("(left out)") && !read("rtec.toml").contains("hunter2"));
    assert!(read("versions.txt").contains("rtec ") && read("contents.txt").contains("platform.json"));
    // An existing file is never overwritten.
    assert!(daemon.expect(2, &args).contains("expected a name that is free"));
    // A missing part is named, with exit code 1. The archive is written all the same.
    put("#!/bin/sh\n");
    let args = ["bugreport", "--out", "2.tar", "--of", "none.toml"];
    let (code, said) = report(&args);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.ends_with("2.tar is written without rtec.toml, log.txt\n"), "{said}");
    assert!(said.contains("log.txt: missing: the journal has no line"), "{said}");
    assert!(directory.path().join("2.tar").exists());
    // Files that the configuration names are included.
    let axis =
        "name='x'\ncount_um=1\ntravel_mm=40\nmax_correction_counts=9\nwindow_counts=9\nmin_separation_ns=500";
    let text =
        format!("[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\n{axis}\n[model]\nfile='own.toml'\n");
    std::fs::write(directory.path().join("full.toml"), text).unwrap();
    std::fs::write(directory.path().join("own.toml"), "name = 'own'\n").unwrap();
    std::fs::write(directory.path().join("devices"), "uio my-card\n").unwrap();
    put("#!/bin/sh\necho started\n");
    let (code, said) = report(&["bugreport", "--out", "4.tar", "--of", "full.toml"]);
    assert_eq!(code, Some(0), "{said}");
    let other =
        "rtec.toml is of machine \"m\", but the daemon that answered runs \"embedded default\": `--of FILE`";
    for part in ["model/own.toml: 13 bytes", "devices/devices: 12 bytes", "devices.txt: ", other] {
        assert!(said.contains(part), "{part}: {said}");
    }
    drop(daemon);
    let (code, said) = report(&["bugreport", "--out", "3.tar", "--json"]);
    assert_eq!(code, Some(3), "{said}");
    let document: Value = serde_json::from_str(said.lines().next().unwrap()).unwrap();
    assert!(document["missing"].as_array().unwrap().contains(&"state.json".into()), "{document}");
    assert!(directory.path().join("3.tar").exists());
}

#[test]
fn refusals_say_their_figures_and_clear_what_it_released() {
    let _room = among_others();
    let (_directory, daemon) = corrected();
    let said = daemon.expect(1, &["correct", "x", "900"]);
    assert!(
        said.contains(
            "axis x: total +900, now +20 counts, window 12: the change is larger than window_counts"
        ),
        "{said}"
    );
    let said = daemon.expect(1, &["correct", "x", "1002"]);
    assert!(said.contains("at most 1000 either way"), "{said}");
    assert_eq!(daemon.expect(0, &["clear"]), "nothing was latched\n");
    for code in [1, 1, 4] {
        daemon.expect(code, &["correct", "x", "900"]);
    }
    let said = daemon.expect(0, &["clear"]);
    assert_eq!(said, "released: axis x: still_not_believed\ncorrections are off: `rtecctl enable`\n");
    // The record also has the events, with their axis.
    until("the record", || daemon.expect(0, &["log"]).contains("mode disabled"));
    let log = daemon.expect(0, &["log", "--axis", "x"]);
    for wanted in [
        "axis x homed\n",
        " mode run\n",
        "axis x fault: still_not_believed: three requests in a row were outside the belief window",
        " mode fault\n",
        "clear: done: latched before: axis x: still_not_believed",
        " home: done",
    ] {
        assert!(log.contains(wanted), "{wanted}: {log}");
    }
    let other = daemon.expect(0, &["log", "--axis", "z"]);
    assert!(other.contains(" mode run\n") && !other.contains("axis x fault"), "{other}");
    assert!(daemon.expect(2, &["log", "--axis", "q"]).contains("expected one of the record's: x, y, z"));
}

#[test]
fn a_total_beyond_the_warning_limit_is_taken_and_says_so() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    std::fs::write(
        &file,
        "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\nwarn_counts=30\n\
         max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n",
    )
    .unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), Some(&file));
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    assert_eq!(daemon.expect(0, &["correct", "x", "12"]), "axis x: +12 counts requested\n");
    let run = daemon.user(&["correct", "x", "-34"]);
    assert_eq!(String::from_utf8(run.stdout).unwrap(), "axis x: -34 counts requested\n");
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(said.starts_with("warning: axis x: total -34, now +12 counts, warning from 30 on"), "{said}");
    until("completed", || daemon.status()["axes"][0]["completed"] == -34);
    let answer = daemon.expect(0, &["correct", "x", "-36", "--json"]);
    assert!(answer.contains("\"warnings\":[\"axis x: total -36, now -34 counts"), "{answer}");
}

/// Runs a verb with both outputs on a full disk; returns its exit code.
fn full(args: &[&str], socket: &std::path::Path) -> Option<i32> {
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    let mut command = Command::new(program("rtecctl"));
    command.args(args).arg("--socket").arg(socket).stdin(Stdio::null()).stdout(full()).stderr(full());
    command.current_dir(socket.parent().unwrap());
    command.status().unwrap().code()
}

#[test]
fn outputs_that_take_nothing_are_an_error_and_no_panic() {
    let _room = among_others();
    let (directory, daemon) = corrected();
    let socket = directory.path().join("s");
    let help = Command::new(program("rtecctl")).arg("--help").output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    let verbs: Vec<&str> = (help.lines())
        .filter_map(|l| l.strip_prefix("  ").filter(|l| l.starts_with(|c: char| c.is_ascii_lowercase())))
        .filter_map(|l| l.split(' ').next())
        .collect();
    assert!(verbs.len() > 30 && verbs.contains(&"status"), "{verbs:?}");
    // Every verb without its arguments and without a daemon, and its help.
    let nobody = directory.path().join("nobody");
    for verb in verbs.iter().filter(|v| **v != "help") {
        assert!(matches!(full(&[verb], &nobody), Some(1..=4)), "{verb}");
        let out = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let run = Command::new(program("rtecctl")).args([verb, "--help"]).stdout(out).output().unwrap();
        let (code, said) = (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned());
        assert!(code == Some(1) && said.contains("No space left"), "{verb}: {code:?} {said}");
    }
    // The verbs that ask the daemon.
    let out = directory.path().join("l").display().to_string();
    for args in [
        &["status"][..],
        &["status", "--json"],
        &["status", "--watch"],
        &["status", "--watch", "--json"],
        &["get", "mode"],
        &["whoami"],
        &["explain"],
        &["metrics"],
        &["correct", "x", "4"],
        &["correct", "x", "4000"],
        &["probe", "on", "--captures", "0"],
        &["probe", "off"],
        &["hold", "on"],
        &["hold", "off"],
        &["shadow"],
        &["enable"],
        &["park"],
        &["disable"],
        &["clear"],
        &["commission", "x"],
        &["log"],
        &["log", "--verify"],
        &["log", "--follow"],
        &["ledger", "export", "--out", &out],
        &["model", "unload"],
        &["part", "unload"],
    ] {
        assert!(matches!(full(args, &socket), Some(1 | 2)), "{args:?}");
    }
    daemon.expect(0, &["status"]);
}

#[test]
fn what_follows_ends_with_its_reader() {
    let _room = among_others();
    let (directory, _daemon) = corrected();
    for args in [&["log", "--follow"][..], &["log", "--follow", "--json"], &["status", "--watch"]] {
        let mut follow = Command::new(program("rtecctl"))
            .args(args)
            .arg("--socket")
            .arg(directory.path().join("s"))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(follow.stdout.take().unwrap()).read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line}");
        if args.contains(&"--json") {
            assert_eq!(serde_json::from_str::<Value>(&line).unwrap()["n"], 1);
        }
        until("its end", || follow.try_wait().unwrap().is_some());
        assert_eq!(follow.wait().unwrap().code(), Some(0), "{args:?}");
    }
}
