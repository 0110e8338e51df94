//! `characterise record`: feeds, gaps and ends.

use super::{feed, rtecctl, said};
use std::time::Duration;

#[test]
fn one_nan_costs_its_row_and_not_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| if (10..13).contains(&i) { "gz nan\n".to_owned() } else { format!("gz {i}\n") });
    let words =
        ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "gz=error.z", "--period", "0.02"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["--duration", "1.5"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(err.contains("'gz nan' is no line NAME VALUE") && err.contains("rows are missing"), "{err}");
    let record = rtec_measure::run_record_files::read(&dir.path().join("r.run.toml")).unwrap();
    assert!(record.rows() > 20 && !dir.path().join("r.run.csv.part").exists(), "{}", record.rows());
}

/// Regression: a time with its unit, as other verbs take it, was refused.
#[test]
fn a_time_with_its_unit_is_as_one_in_seconds() {
    if !test_needs::long() {
        return;
    }
    for (duration, period) in [("2", "0.1"), ("2s", "100ms")] {
        let dir = tempfile::tempdir().unwrap();
        let from = feed(|i| format!("gz {i}\n"));
        let words = ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "gz=error.z"];
        let times = ["--duration", duration, "--period", period];
        let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &times].concat()));
        assert!(code == Some(0) && err.contains(" of 2 s, "), "{code:?} {err}");
        let rows = rtec_measure::run_record_files::read(&dir.path().join("r.run.toml")).unwrap().rows();
        assert!((2..=21).contains(&rows), "{rows} rows in {duration} every {period}");
    }
}

/// Regression: only the last of several bad lines was named.
/// A closed connection looked like a pause.
#[test]
fn every_refused_line_and_a_lost_feed_are_said() {
    let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let from = server.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        let (mut line, _) = server.accept().unwrap();
        std::io::Write::write_all(&mut line, b"e nan\ne 1,5\ne\ne 1 2\ne 1e400\ne 0.5\n").unwrap();
        std::thread::sleep(Duration::from_millis(400));
    });
    let dir = tempfile::tempdir().unwrap();
    let words =
        ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "e=error.x", "--period", "0.1"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["--duration", "1"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    for what in
        ["'e nan'", "'e 1,5'", "'e'", "'e 1 2'", "'e 1e400'", "no readings: 5\n", "closed by the other side"]
    {
        assert!(err.contains(what), "{what}: {err}");
    }
}

/// Regression: a run of a rotary axis was recorded.
/// Every verb that reads it then refused it.
#[test]
fn a_rotary_axis_is_refused_before_it_is_recorded() {
    let dir = tempfile::tempdir().unwrap();
    for columns in ["b=position.b,e=error.x", "e=error.c"] {
        let words = [
            "record",
            "--out",
            "r.run.toml",
            "--feed",
            "127.0.0.1:9",
            "--columns",
            columns,
            "--duration",
            "1",
        ];
        let (code, _, err) = said(&rtecctl(dir.path(), &words));
        assert!(code == Some(2) && err.contains("of a rotary axis"), "{columns}: {err}");
    }
    assert!(std::fs::read_dir(dir.path()).unwrap().next().is_none());
}

/// Ctrl-C ends a run and keeps its rows.
/// The next run must not remove the rows of one that was killed.
#[test]
fn a_run_that_is_interrupted_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let part = dir.path().join("r.run.csv.part");
    let start = |duration: &str| {
        let from = feed(|i| format!("gz {i}\n"));
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_rtecctl"));
        command.args([
            "characterise",
            "record",
            "--out",
            "r.run.toml",
            "--feed",
            &from,
            "--columns",
            "gz=error.z",
        ]);
        command.args(["--period", "0.02", "--duration", duration]).current_dir(dir.path());
        command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap()
    };
    let rows = || std::fs::read_to_string(&part).unwrap_or_default().lines().count();
    let end = |run: std::process::Child, signal: &str| {
        while rows() < 12 {
            std::thread::sleep(Duration::from_millis(10));
        }
        std::process::Command::new("kill").args([signal, &run.id().to_string()]).status().unwrap();
        run.wait_with_output().unwrap()
    };
    let out = end(start("600"), "-INT");
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success() && err.contains("of 600 s: ") && err.contains("rows are kept"), "{err}");
    assert!(
        rtec_measure::run_record_files::read(&dir.path().join("r.run.toml")).unwrap().rows() >= 11
            && !part.exists()
    );
    assert!(!end(start("600"), "-KILL").status.success());
    let left = std::fs::read(&part).unwrap();
    let (code, _, err) = said(&start("0.1").wait_with_output().unwrap());
    assert!(code == Some(2) && err.contains("rows of a run that was cut off"), "{code:?} {err}");
    assert!(std::fs::read(&part).unwrap() == left);
}

/// A gauge that falls silent while its connection stays open gives no more rows.
/// Its last value is not used as a reading.
#[test]
fn a_gauge_that_goes_silent_gives_no_more_rows() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| if i < 20 { format!("gz {i}.5\nT1 20.0\n") } else { "T1 20.1\n".to_owned() });
    let words = ["record", "--out", "r.run.toml", "--feed", &from, "--columns", "gz=error.z,T1=temperature"];
    let to = ["--period", "0.02", "--duration", "1.5"];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &to].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(err.contains("gz no new reading") && err.contains("rows are missing"), "{err}");
    let record = rtec_measure::run_record_files::read(&dir.path().join("r.run.toml")).unwrap();
    let mut readings = record.responses().next().unwrap().data.clone();
    let rows = readings.len();
    readings.dedup();
    assert!(rows <= 20 && readings.len() == rows, "{rows} rows of 20 readings: {readings:?}");
}

#[test]
fn a_shift_without_a_response_is_recorded_and_two_alike_are_refused_first() {
    let dir = tempfile::tempdir().unwrap();
    let from = feed(|i| format!("T1 20.{}\n", i % 10));
    let words = [
        "record",
        "--out",
        "s.run.toml",
        "--feed",
        &from,
        "--period",
        "0.02",
        "--duration",
        "0.6",
        "--columns",
    ];
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["T1=temperature"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    assert!(rtec_measure::run_record_files::read_log(&dir.path().join("s.run.toml")).unwrap().rows() > 5);
    let (code, _, err) = said(&rtecctl(dir.path(), &[&words[..], &["a=error.x,b=error.x"]].concat()));
    assert!(code == Some(2) && err.contains("two columns of role error.x"), "{code:?} {err}");
}
