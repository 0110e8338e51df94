//! Fits on a base, and records that judge a model.

use super::{TRUE_MACHINE, rtecctl};
use std::process::Command;

/// A model written into another folder than its base keeps the base's chain.
#[test]
fn a_fit_on_a_base_with_a_chain_may_be_written_anywhere() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    for folder in ["base", "records", "out"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    let joint = "[[joint]]\nname = \"x slide\"\nbranch = \"tool\"\naxis = \"x\"\ncomponent = [{ of = \"dx\", terms = [{ p = 1, \
                 value = 2.0 }] }]\n";
    std::fs::write(at("base/chain.toml"), joint).unwrap();
    std::fs::write(at("base/m.toml"), "name = \"m\"\nchain = \"chain.toml\"\n").unwrap();
    // 2 µm per 100 mm belong to the chain, 30 ppm are new.
    let rows: Vec<String> = (0..40).map(|k| format!("{},{}", 10 * k, 0.5 * f64::from(k))).collect();
    std::fs::write(at("records/r.csv"), format!("x,e\n{}\n", rows.join("\n"))).unwrap();
    let sidecar = "file = \"r.csv\"\nkind = \"positioning\"\n[columns]\nx = { role = \"position.x\", unit = \"mm\" }\n\
                   e = { role = \"error.x\", unit = \"um\" }\n";
    std::fs::write(at("records/r.run.toml"), sidecar).unwrap();
    let found = rtecctl(
        dir.path(),
        "model fit --base base/m.toml --effects scale.x --record records/r.run.toml --out out/m.toml --json",
    );
    let ppm = found["effects"][0]["parameters"]["ppm"]["value"].as_f64().unwrap();
    assert!((ppm - 30.0).abs() < 1e-6, "{found}");
    let left = rtecctl(dir.path(), "model validate --machine out/m.toml --record records/r.run.toml --json");
    assert!(left["responses"][0]["rms"].as_f64().unwrap() < 1e-6, "{left}");
    let written = std::fs::read_to_string(at("out/m.toml")).unwrap();
    assert!(
        written.contains("chain = \"../base/chain.toml\"") && written.contains("folder = \"../records\""),
        "{written}"
    );
}

/// The same records give the same bytes.
/// The base's effects stay, and the model has the record's date.
#[test]
fn a_base_is_kept_and_the_date_is_the_records() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("true.toml"), TRUE_MACHINE).unwrap();
    std::fs::write(dir.path().join("ideal.toml"), "name = \"centre\"\n").unwrap();
    rtecctl(dir.path(), "simulate drift --machine true.toml --model ideal.toml --seed 5 --out ch");
    let sidecar = dir.path().join("ch/drift-wet.run.toml");
    let text = std::fs::read_to_string(&sidecar).unwrap();
    std::fs::write(&sidecar, format!("date = \"2025-03-09\"\n{text}")).unwrap();
    let base = "name = \"kept\" # mine\n[[effect]]\nname = \"thermal_lag.z\" # known\nsensor = \"T13\"\nminus = \"T18\"\n\
                um_per_K = -22.0\ntau_s = 900.0\n";
    std::fs::write(dir.path().join("base.toml"), base).unwrap();
    let go = |out: &str| {
        rtecctl(
            dir.path(),
            &format!("model fit --base base.toml --record ch/drift-wet.run.toml --out {out} --valid-days 30"),
        );
        std::fs::read_to_string(dir.path().join(out)).unwrap()
    };
    let written = go("a.toml");
    assert_eq!(written, go("b.toml"));
    // New effects follow the old ones, and the file's own two lines follow its name.
    let rest = base.trim_end().strip_prefix("name = \"kept\" # mine\n").unwrap();
    assert!(
        written.starts_with("name = \"kept\" # mine\nformat = 1\nby = ") && written.contains(rest),
        "{written}"
    );
    for line in ["date = \"2025-03-09\"", "valid_until = \"2025-04-08\"", "valid = ["] {
        assert!(written.contains(line), "{line}: {written}");
    }
}

/// A run of returns to one position has the kind positioning.
/// Without a direction of approach, its evaluation must be named.
#[test]
fn returns_to_one_position_are_told_of_their_own_evaluation() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("r.csv"), "t,e\n0,1.0\n5,1.5\n10,0.5\n").unwrap();
    let run = "file = 'r.csv'\nkind = 'positioning'\n[columns]\nt = { role = 'time', unit = 's' }\n\
               e = { role = 'error.x', unit = 'um' }\n";
    std::fs::write(dir.path().join("r.run.toml"), run).unwrap();
    let evaluate = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
        command.current_dir(dir.path()).args(["characterise", "evaluate", "r.run.toml"]).args(words);
        let out = command.output().unwrap();
        (out.status.code(), String::from_utf8([out.stdout, out.stderr].concat()).unwrap())
    };
    let (code, text) = evaluate(&[]);
    assert!(code == Some(2) && text.contains("--standard repeatability"), "{code:?} {text}");
    let (code, text) = evaluate(&["--standard", "repeatability"]);
    assert!(code == Some(0) && text.contains("range (µm)") && text.contains("1.00"), "{code:?} {text}");
}

/// A chain is shown, and exported for one axis with given positions of the others.
/// Both are compared with the law by hand.
#[test]
fn a_chain_is_shown_and_exported_along_an_axis() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("m.toml"), "name = \"lathe\"\nchain = \"chain.toml\"\n").unwrap();
    std::fs::write(
        at.join("chain.toml"),
        "tool_mm = [0.0, 0.0, 0.0]\n[[joint]]\nname = \"carriage\"\nbranch = \"tool\"\naxis = \"z\"\n\
         component = [{ of = \"ey\", terms = [{ value = 50.0 }] },\n\
         { of = \"dz\", sensor = \"T2\", terms = [{ p = 1, dT = 1, value = 1.2 }] }]\n\
         [[joint]]\nname = \"cross-slide\"\nbranch = \"tool\"\naxis = \"x\"\n",
    )
    .unwrap();
    let run = |line: &str| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(line.split_whitespace())
            .current_dir(at)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{line}: {said}");
        (String::from_utf8_lossy(&output.stdout).into_owned(), said)
    };
    let (shown, said) = run("model show --machine m.toml");
    assert!(!said.contains("an ideal machine"), "{said}");
    std::fs::write(at.join("ideal.toml"), "name = \"ideal\"\n").unwrap();
    let (bare, said) = run("model show --machine ideal.toml");
    assert!(
        bare == "ideal\n" && said.contains("no effects: an ideal machine; `rtecctl model fit`"),
        "{bare}{said}"
    );
    assert_eq!(run("model show --machine ideal.toml --json").1, "");
    for line in [
        "carriage (tool), offset 0, 0, 0 mm, moved by z along 0, 0, 1",
        "ey = +50 µrad",
        "dz = +1.2·(p/100 mm)·ΔT µm   ΔT = T2-20",
    ] {
        assert!(shown.contains(line), "{line} in {shown}");
    }
    let document: serde_json::Value =
        serde_json::from_str(&run("model show --machine m.toml --json").0).unwrap();
    assert_eq!(document["chain"]["joints"][0]["components"][1]["terms"][0]["value"], 1.2);
    let export =
        "model export --machine m.toml --axis z --from 0 --to 200 --step 100 --format csv --out t.csv";
    let table = |more: &str| -> Vec<f64> {
        let (_, said) = run(&format!("{export} {more}"));
        assert_eq!(said.contains("x at 0 mm"), !more.contains("--at"), "{said}");
        let text = std::fs::read_to_string(at.join("t.csv")).unwrap();
        text.lines().skip(1).map(|l| l.split(',').nth(1).unwrap().parse().unwrap()).collect()
    };
    // dz = 1.2 µm per 100 mm and K; the carriage's yaw of 50 µrad at the cross-slide's 80 mm: −ey·x = −4 µm.
    for (more, wants) in
        [("--temperatures T2=25", [0.0, 6.0, 12.0]), ("--temperatures T2=25 --at x=80", [-4.0, 2.0, 8.0])]
    {
        let got = table(more);
        assert!(got.iter().zip(wants).all(|(g, w)| (g - w).abs() < 1e-3), "{more}: {got:?}");
    }
    let bad = std::process::Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(format!("{export} --at y=1").split_whitespace())
        .current_dir(at)
        .output()
        .unwrap();
    assert_eq!(bad.status.code(), Some(2));
    // Simulated: without the chain's model the axis is off by the chain, with it the error is zero.
    let (said, _) = run("simulate linear-displacement --machine m.toml --out s --json");
    let document: serde_json::Value = serde_json::from_str(&said).unwrap();
    let summary = &document["summary"]["linear-displacement-x"];
    let worst = |key: &str| summary[key]["max"].as_f64().unwrap();
    assert!(worst("x_without") < 1.0, "{summary}");
    let z = &document["summary"]["linear-displacement-z"];
    assert!(z["z_without"]["max"].as_f64().is_some(), "{z}");
}

/// Each run has its own zero, from homing, which no model can predict.
/// The fit reports the zero that it removed, and a later run is judged with its own zero.
#[test]
fn a_run_s_own_zero_is_said_and_in_no_interval() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    for seed in [1, 7] {
        rtecctl(dir, &format!("simulate linear-displacement --seed {seed} --out s{seed} --json"));
    }
    let fit = rtecctl(
        dir,
        "model fit --effects scale.x,reversal.x --record s1/linear-displacement-x.run.toml --out m.toml --json",
    );
    let zero = &fit["zeros"][0];
    assert!(zero["response"] == "error.x" && zero["um"].as_f64().unwrap().abs() > 1.0, "{fit}");
    let later = "model validate --machine m.toml --record s7/linear-displacement-x.run.toml";
    let found = rtecctl(dir, &format!("{later} --json"));
    let v = &found["responses"][0];
    assert!(v["coverage"].as_f64().unwrap() < 0.1, "{v}");
    assert!((0.85..=1.0).contains(&v["coverage_about_mean"].as_f64().unwrap()), "{v}");
    let said =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(later.split(' ')).output().unwrap();
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains("the run's own zero"), "{said}");
}

/// A drift test of seven minutes, declared in seconds.
/// A lag of twenty minutes would be fitted as none.
#[test]
fn a_drift_test_of_few_minutes_is_not_fitted_in_silence() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    rtecctl(dir, "example lathe m");
    let records = dir.join("m/records");
    let text = std::fs::read_to_string(records.join("drift-dry.csv")).unwrap();
    let fit = || {
        let words = "model fit --record m/records/drift-dry.run.toml --sensors T8-T18 --out fitted.toml";
        let out = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .current_dir(dir)
            .args(words.split(' '))
            .output()
            .unwrap();
        String::from_utf8(out.stderr).unwrap()
    };
    assert!(!fit().contains("another unit"), "{}", fit());
    let minutes = |line: &str| match line.split_once(',') {
        Some((t, rest)) => t.parse::<f64>().map_or(line.to_owned(), |t| format!("{:.5},{rest}", t / 60.0)),
        None => line.to_owned(),
    };
    let rows: Vec<String> = text.lines().map(minutes).collect();
    std::fs::write(records.join("drift-dry.csv"), rows.join("\n") + "\n").unwrap();
    assert!(fit().contains("is its time in another unit than stated?"), "{}", fit());
}

/// A record that judges a model is checked like one that a model is fitted to.
/// The mistakes are a temperature in °F, the other sign, and an axis that the model lacks.
#[test]
fn a_model_is_not_judged_by_a_mistaken_record_in_silence() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    std::fs::write(
        dir.join("m.toml"),
        "name = \"m\"\n[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\num_per_K = 4.0\n",
    )
    .unwrap();
    let warm = |i: i32| 20.0 + 8.0 * (1.0 - (-f64::from(i) / 20.0).exp());
    let judge = |name: &str, axis: &str, sign: f64, of: fn(f64) -> f64| {
        let rows = (0..80).fold("t_s,T0,T1,e\n".to_owned(), |text, i| {
            let e = sign * (4.0 * (warm(i) - 20.0) + 0.3 * f64::from(i * 7 % 5 - 2));
            text + &format!(
                "{},{:.3},{:.3},{e:.3}\n",
                60 * i,
                of(20.0 + 0.01 * f64::from(i % 7)),
                of(warm(i))
            )
        });
        std::fs::write(dir.join(format!("{name}.csv")), rows).unwrap();
        let sidecar = format!(
            "kind = \"drift\"\nfile = \"{name}.csv\"\n[columns]\nt_s = {{ role = \"time\", unit = \"s\" }}\n\
             T0 = {{ role = \"temperature\", unit = \"degC\" }}\nT1 = {{ role = \"temperature\", unit = \"degC\" }}\n\
             e = {{ role = \"error.{axis}\", unit = \"um\" }}\n"
        );
        std::fs::write(dir.join(format!("{name}.run.toml")), sidecar).unwrap();
        let words = format!("model validate --machine m.toml --record {name}.run.toml");
        let out = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .current_dir(dir)
            .args(words.split(' '))
            .output()
            .unwrap();
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    assert_eq!(judge("clean", "z", 1.0, |t| t).1, "");
    let (_, said) = judge("fahrenheit", "z", 1.0, |t| t * 1.8 + 32.0);
    assert!(said.contains("looks like degrees Fahrenheit"), "{said}");
    let (code, said) = judge("sign", "z", -1.0, |t| t);
    assert!(code == Some(1) && said.contains("with the other sign"), "{said}");
    let (code, said) = judge("axis", "x", 1.0, |t| t);
    assert!(code == Some(1) && said.contains("the model has no effect on it"), "{said}");
}
