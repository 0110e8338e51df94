//! Output of verbs for people: no JSON without --json.
//! Every thing has its proper name.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

fn rtecctl(dir: &Path, words: &str) -> (String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .current_dir(dir)
        .args(words.split_whitespace())
        .output()
        .unwrap();
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{words}: {said}");
    (String::from_utf8(out.stdout).unwrap(), said)
}

#[track_caller]
fn readable(text: &str) {
    let digits = text.split(|c: char| !c.is_ascii_digit()).map(str::len).max().unwrap_or(0);
    assert!(!text.contains(['{', '}', '"']) && digits < 9, "{text}");
}

#[test]
fn figures_are_for_people_and_json_for_programs() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write(
        "a.toml",
        "name = \"a\"\neffect = [{ name = \"scale.x\", ppm = 12.345678901234567 }, { name = \"reversal.x\", um = 4.0 }]\n",
    );
    write(
        "b.toml",
        "name = \"b\"\neffect = [{ name = \"scale.x\", ppm = 13.1 }, { name = \"position_map.x\", knots_mm = [0.0, 100.0], um = [0.0, 1.0] }]\n",
    );
    let (text, _) = rtecctl(dir.path(), "simulate linear-displacement --machine a.toml --out sim");
    readable(&text);
    assert!(
        text.contains("linear-displacement-x\n  x with ") && text.contains("max ") && text.contains("rms "),
        "{text}"
    );
    let (text, _) =
        rtecctl(dir.path(), "model compare a.toml b.toml --record sim/linear-displacement-x.run.toml");
    readable(&text);
    assert!(text.contains("ppm: 12.346 -> 13.1\n"), "{text}");
    assert!(text.contains("left by 1st") && text.contains("\nerror.x "), "{text}");
    write(
        "c.toml",
        "name = \"c\"\neffect = [{ name = \"thermal_lag.x\", sensor = \"T1\", um_per_K = 1.0, tau_s = 1234.567890123456 }]\n",
    );
    let (text, _) = rtecctl(dir.path(), "model compare b.toml c.toml");
    readable(&text);
    assert!(text.contains("thermal_lag.x T1 tau_s=1234.6 "), "{text}");
    let (text, _) =
        rtecctl(dir.path(), "model validate --machine a.toml --record sim/linear-displacement-x.run.toml");
    assert!(text.contains("the model states no interval\n"), "{text}");
    for words in [
        "simulate linear-displacement --machine a.toml --out sim --json",
        "model compare a.toml b.toml --record sim/linear-displacement-x.run.toml --json",
    ] {
        let (json, _) = rtecctl(dir.path(), words);
        serde_json::from_str::<serde_json::Value>(&json).unwrap();
    }
}

/// A usage error is the parser's, with its code, and ends with an example.
/// Help that is shown already has one.
#[test]
fn a_usage_error_ends_with_an_example() {
    for (words, ends, times) in [
        ("simulate", "\nExample: rtecctl simulate --list\n", 1),
        ("example lathe", "\nNames: rtecctl example --list\n", 1),
        ("model show nope", "\nExample: rtecctl model show --machine machine.toml\n", 1),
        ("statos", "\n", 0),
        ("model", "\n", 1),
    ] {
        let out =
            Command::new(env!("CARGO_BIN_EXE_rtecctl")).args(words.split_whitespace()).output().unwrap();
        let said = String::from_utf8(out.stderr).unwrap();
        assert!(
            out.status.code() == Some(2) && out.stdout.is_empty() && said.ends_with(ends),
            "{words}: {said}"
        );
        assert_eq!(said.matches("Example:").count(), times, "{words}: {said}");
    }
}

#[test]
fn a_fit_is_called_what_it_is_and_rows_are_rows() {
    let dir = tempfile::tempdir().unwrap();
    // Two hours of growth, one row per minute; the same without times.
    let (mut timed, mut bare) = ("t,T1,e\n".to_owned(), "T1,e\n".to_owned());
    for n in 0..240 {
        let warm = 8.0 * (1.0 - (-f64::from(n) / 50.0).exp()) + 0.05 * (f64::from(n) * 2.399).sin();
        let (degc, um) = (20.0 + warm, 1.7 * warm + 0.05 * (f64::from(n) * 1.7).cos());
        writeln!(timed, "{},{degc},{um}", n * 60).unwrap();
        writeln!(bare, "{degc},{um}").unwrap();
    }
    let sidecar = |file: &str, time: &str| {
        format!(
            "file = \"{file}\"\nkind = \"drift\"\n[columns]\n{time}T1 = {{ role = \"temperature\", unit = \"degC\" }}\n\
             e = {{ role = \"error.z\", unit = \"um\" }}\n"
        )
    };
    std::fs::write(dir.path().join("timed.csv"), timed).unwrap();
    std::fs::write(dir.path().join("bare.csv"), bare).unwrap();
    let time = "t = { role = \"time\", unit = \"s\" }\n";
    std::fs::write(dir.path().join("timed.run.toml"), sidecar("timed.csv", time)).unwrap();
    std::fs::write(dir.path().join("bare.run.toml"), sidecar("bare.csv", "")).unwrap();
    for (name, axis, other) in [("timed", "time (min)", "row<"), ("bare", "row<", "time (min)")] {
        let (_, said) = rtecctl(
            dir.path(),
            &format!("model fit --record {name}.run.toml --out {name}.toml --no-lag --date 2026-05-01"),
        );
        assert_eq!(
            said.contains("lags and spans of time in it are numbers of rows"),
            name == "bare",
            "{said}"
        );
        let model = std::fs::read_to_string(dir.path().join(format!("{name}.toml"))).unwrap();
        assert!(model.contains("name = \"growth of error.z by temperatures\""), "{model}");
        rtecctl(
            dir.path(),
            &format!("model validate --machine {name}.toml --record {name}.run.toml --plot {name}.svg"),
        );
        let svg = std::fs::read_to_string(dir.path().join(format!("{name}.svg"))).unwrap().replace('\n', "");
        assert!(svg.contains(axis) && !svg.contains(other), "{name}");
    }
    rtecctl(
        dir.path(),
        "model fit --effects thermal_growth.z:T1 --record timed.run.toml --out named.toml --date 2026-05-01",
    );
    let model = std::fs::read_to_string(dir.path().join("named.toml")).unwrap();
    assert!(model.contains("name = \"fit of thermal_growth.z:T1\""), "{model}");
}

/// A command's inputs are never overwritten, even by another path.
#[test]
fn nothing_that_was_read_is_written_over() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let model = "name = \"a\"\neffect = [{ name = \"scale.x\", ppm = 12.0 }]\n";
    std::fs::write(at("a.toml"), model).unwrap();
    rtecctl(dir.path(), "simulate linear-displacement --machine a.toml --out sim");
    std::fs::write(at("model.toml"), "name = \"a\"\n").unwrap();
    let before = || {
        ["a.toml", "model.toml", "sim/linear-displacement-x.csv", "sim/linear-displacement-x.run.toml"]
            .map(|name| std::fs::read(at(name)).unwrap())
    };
    let was = before();
    let record = "sim/linear-displacement-x.run.toml";
    for words in [
        &format!("model predict --machine a.toml --record {record} --out sim/linear-displacement-x.csv"),
        &format!("model predict --machine a.toml --record {record} --out sim/../a.toml"),
        &format!("model predict --machine a.toml --record {record} --out {record}"),
        &format!("model fit --base model.toml --effects scale.x --record {record} --out model.toml"),
        &format!("model fit --effects scale.x --record {record} --out sim/linear-displacement-x.csv"),
        &format!("characterise evaluate {record} --html sim/linear-displacement-x.csv"),
        &format!("reconcile {record} --model model.toml --out ."),
    ] {
        let run = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .current_dir(dir.path())
            .args(words.split_whitespace())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{words}: {said}");
        assert!(said.contains("expected another name for what it writes"), "{words}: {said}");
        assert!(before() == was, "{words}");
    }
}

/// A limit that was applied to nothing does not count as kept.
/// An unknown name is bad input.
#[test]
fn a_history_within_its_limits_has_judged_something() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("a.toml"), "name = \"a\"\neffect = [{ name = \"scale.x\", ppm = 12.0 }]\n").unwrap();
    rtecctl(dir.path(), "simulate linear-displacement --machine a.toml --out sim");
    let sidecar = at("sim/linear-displacement-x.run.toml");
    let ended = |words: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
        let run = command.current_dir(dir.path()).args(words.split_whitespace()).output().unwrap();
        (run.status.code(), String::from_utf8(run.stderr).unwrap())
    };
    std::fs::write(at("lim.toml"), "[limits]\n\"x.A\" = 1000.0\n").unwrap();
    // No record has a date yet, so all are left out.
    let (code, said) = ended("history sim --limits lim.toml");
    assert!(code == Some(1) && said.contains("no record here has x.A"), "{said}");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    std::fs::write(&sidecar, format!("date = \"2026-05-01\"\n{text}")).unwrap();
    let (code, said) = ended("history sim --limits lim.toml");
    assert_eq!(code, Some(0), "{said}");
    std::fs::write(at("lim.toml"), "[limits]\n\"w.A\" = 1.0\nA = 1000.0\n").unwrap();
    let (code, said) = ended("history sim --limits lim.toml");
    assert!(code == Some(1) && said.contains("no record here has w.A:"), "{said}");
    let (code, said) = ended("history nowhere --limits lim.toml");
    assert!(code == Some(2) && said.contains("nowhere"), "{said}");
}
