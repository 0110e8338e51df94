//! Files and readings as people have them: a test for each kind, with the value that is right.

#![allow(clippy::format_collect, clippy::format_push_string, reason = "inputs of tests")]

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A folder with all inputs, those of the crates below too.
fn inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    for from in ["tests/verbs/kinds", "../measure/tests/field", "../part/tests/field"] {
        for entry in std::fs::read_dir(own.join(from)).unwrap() {
            let entry = entry.unwrap();
            std::fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
    }
    folder
}

struct Run {
    exit: i32,
    out: String,
    err: String,
}

impl Run {
    fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}\n{}", self.out, self.err))
    }

    fn figure(&self, pointer: &str) -> f64 {
        let json = self.json();
        json.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("no {pointer} in {json}"))
    }

    fn says(&self, text: &str) -> bool {
        self.out.contains(text) || self.err.contains(text)
    }
}

fn run(folder: &Path, words: &[&str]) -> Run {
    let done = Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(folder).args(words).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Run { exit: done.status.code().unwrap(), out: text(done.stdout), err: text(done.stderr) }
}

fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

/// The numbers of a CSV's column.
fn column(folder: &Path, file: &str, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(folder.join(file)).unwrap();
    let mut lines = text.lines();
    let place = lines.next().unwrap().split(',').position(|n| n.trim_matches('"') == name).unwrap();
    lines.map(|l| l.split(',').nth(place).unwrap().parse().unwrap()).collect()
}

#[test]
fn coarse_steps_are_said_and_in_intervals() {
    let folder = inputs();
    let fit = words("model fit --record dial10.run.toml --effects reversal.x,offset.x --out d.toml --json");
    let fit = run(folder.path(), &fit);
    let (low, high) =
        (fit.figure("/effects/0/parameters/um/low"), fit.figure("/effects/0/parameters/um/high"));
    assert!(low <= 6.0 && 6.0 <= high && high - low < 20.0, "the truth, 6 µm, is not in [{low}, {high}]");
    assert!(fit.says("readings in steps of 10 µm"), "{}", fit.err);
    let evaluated = run(folder.path(), &words("characterise evaluate dial10.run.toml --json"));
    assert!((evaluated.figure("/B_mean") - 6.0).abs() <= evaluated.figure("/resolution/reversal_within"));
}

#[test]
fn coarse_temperatures_are_said_and_in_intervals() {
    // 6 µm/K over 2 K, read by a sensor of 0.5 K.
    let folder = inputs();
    let (mut fine, mut coarse) = ("t,T,e\n".to_owned(), "t,T,e\n".to_owned());
    for i in 0..240 {
        let degc = 20.0 + 2.0 * (1.0 - (-f64::from(i) / 80.0).exp());
        let e = 6.0 * (degc - 20.0) + 0.1 * (f64::from(i) * 1.7).sin();
        fine += &format!("{},{degc:.4},{e:.4}\n", 30 * i);
        coarse += &format!("{},{:.1},{e:.4}\n", 30 * i, (2.0 * degc).round() / 2.0);
    }
    let mut widths = Vec::new();
    for (name, csv) in [("fine", fine), ("coarse", coarse)] {
        let sidecar = format!(
            "file = \"{name}.csv\"\nkind = \"drift\"\n[columns]\nt = {{ role = \"time\", unit = \"s\" }}\n\
             T = {{ role = \"temperature\", unit = \"degC\" }}\ne = {{ role = \"error.z\", unit = \"um\" }}\n"
        );
        std::fs::write(folder.path().join(format!("{name}.csv")), csv).unwrap();
        std::fs::write(folder.path().join(format!("{name}.run.toml")), sidecar).unwrap();
        let line = format!(
            "model fit --record {name}.run.toml --effects thermal_growth.z:T --out {name}.toml --json"
        );
        let fit = run(folder.path(), &words(&line));
        let (low, high) = (
            fit.figure("/effects/0/parameters/um_per_K/low"),
            fit.figure("/effects/0/parameters/um_per_K/high"),
        );
        assert!(low <= 6.0 && 6.0 <= high, "{name}: the truth, 6 µm/K, is not in [{low}, {high}]");
        assert_eq!(fit.says("T: readings in steps of 0.5 K over 2 K"), name == "coarse", "{}", fit.err);
        widths.push(high - low);
    }
    assert!(widths[1] > widths[0], "{widths:?}");
    let evaluated = run(folder.path(), &words("characterise evaluate coarse.run.toml"));
    assert!(evaluated.says("T: readings in steps of 0.5 K over 2 K"), "{}", evaluated.err);
}

/// A log of 10 s a row by a clock of whole minutes: the lag is named alone, with the truth in its interval.
#[test]
fn a_clock_of_minutes_makes_no_effects() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (mut csv, mut lagged) = ("t,T1,e\n".to_owned(), 0.0);
    for i in 0..400_u32 {
        let t = 10.0 * f64::from(i);
        let cold = 4.0 * (1.0 - (-2200.0_f64 / 900.0).exp());
        let warm =
            if t < 2200.0 { 4.0 * (1.0 - (-t / 900.0).exp()) } else { cold * (-(t - 2200.0) / 700.0).exp() };
        let keeps = (-10.0_f64 / 400.0).exp();
        lagged = if i == 0 { 0.0 } else { lagged * keeps + warm * (1.0 - keeps) };
        // Noise without a memory, the same in every run.
        let noise = (f64::from(i) * 12.9898).sin() * 43_758.545;
        let e = 6.0 * lagged + 0.4 * (noise - noise.floor() - 0.5);
        csv += &format!("{},{:.3},{e:.3}\n", 60 * (10 * i / 60), 20.0 + warm);
    }
    std::fs::write(at.join("a.csv"), csv).unwrap();
    let sidecar = "file = \"a.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\", unit = \"s\" }\n\
                   T1 = { role = \"temperature\", unit = \"degC\" }\ne = { role = \"error.z\", unit = \"um\" }\n";
    std::fs::write(at.join("a.run.toml"), sidecar).unwrap();
    std::fs::write(at.join("m.toml"), "name = \"m\"\neffect = []\n").unwrap();
    let found = run(at, &words("reconcile a.run.toml --model m.toml --json"));
    let effects = found.json()["effects"].as_array().unwrap().len();
    assert_eq!(
        (effects, found.json()["effects"][0]["name"].as_str()),
        (1, Some("thermal_lag.z")),
        "{}",
        found.out
    );
    for (parameter, truth) in [("um_per_K", 6.0), ("tau_s", 400.0)] {
        let [low, high] =
            ["low", "high"].map(|end| found.figure(&format!("/effects/0/parameters/{parameter}/{end}")));
        assert!(low <= truth && truth <= high, "{parameter}: {truth} is not in [{low}, {high}]");
    }
}

#[test]
fn absolute_clocks_are_set_back_or_questioned() {
    let folder = inputs();
    let text = std::fs::read_to_string(folder.path().join("epoch.csv")).unwrap();
    let rows: Vec<(i64, &str)> = text
        .lines()
        .skip(1)
        .map(|l| l.split_once(',').unwrap())
        .map(|(t, e)| (t.parse().unwrap(), e))
        .collect();
    let day = |t: i64| ((t - 1_767_657_600) / 3600, (t - 1_767_657_600) / 60 % 60, (t - 1_767_657_600) % 60);
    let write = |name: &str, time: &dyn Fn(i64) -> String| {
        let rows: String = rows.iter().map(|(t, e)| format!("{},{e}\n", time(*t))).collect();
        std::fs::write(folder.path().join(name), format!("t,e\n{rows}")).unwrap();
    };
    write("ms.csv", &|t| format!("{}", 1000 * t));
    write("iso.csv", &|t| format!("2026-01-06T{:02}:{:02}:{:02}Z", day(t).0, day(t).1, day(t).2));
    write("german.csv", &|t| format!("06.01.2026 {:02}:{:02}:{:02}", day(t).0, day(t).1, day(t).2));
    write("blank.csv", &|t| format!("2026-01-06 {:02}:{:02}:{:02}", day(t).0, day(t).1, day(t).2));
    // All on one day: whether that is in January or in June, the times since the first row are the same.
    write("slashes.csv", &|t| format!("06/01/2026 {:02}:{:02}:{:02}", day(t).0, day(t).1, day(t).2));
    write("year-first.csv", &|t| format!("2026/1/6 {:02}:{:02}:{:02}", day(t).0, day(t).1, day(t).2));
    write("am-pm.csv", &|t| {
        let half = if day(t).0 < 12 { "AM" } else { "PM" };
        format!("1/6/2026 {}:{:02}:{:02} {half}", (day(t).0 + 11) % 12 + 1, day(t).1, day(t).2)
    });
    write("of-day.csv", &|t| format!("{:02}:{:02}:{:02}", day(t).0, day(t).1, day(t).2));
    for (file, time) in [
        ("epoch.csv", "t=time"),
        ("ms.csv", "t=time:ms"),
        ("iso.csv", "t=time"),
        ("blank.csv", "t=time"),
        ("german.csv", "t=time"),
        ("of-day.csv", "t=time"),
        ("slashes.csv", "t=time"),
        ("year-first.csv", "t=time"),
        ("am-pm.csv", "t=time"),
    ] {
        let line = format!(
            "characterise import {file} --format csv --columns {time},e=error.z --out {file}.run.toml"
        );
        let imported = run(folder.path(), &words(&line));
        assert_eq!(imported.exit, 0, "{file}: {}", imported.err);
        assert!(imported.says("time 0 is "), "{file}: {}", imported.err);
        let t = column(folder.path(), &format!("{file}.csv"), "t");
        assert_eq!((t[0], t[1], t.len()), (0.0, 30.0, 240), "{file}");
    }
    // Unix seconds that are said to be minutes are questioned.
    let minutes =
        "characterise import epoch.csv --format csv --columns t=time:min,e=error.z --out minutes.run.toml";
    let refused = run(folder.path(), &words(minutes));
    assert!(refused.exit == 2 && refused.says("Unix time in s, as t=time:s"), "{}", refused.err);
    // A record as it stands is questioned; dates in it have a way named.
    let evaluated = run(folder.path(), &words("characterise evaluate epoch.run.toml"));
    assert!(evaluated.says("t begins at 1767700000: Unix time in s (2026-01-06)"), "{}", evaluated.err);
    let sidecar = std::fs::read_to_string(folder.path().join("epoch.run.toml")).unwrap();
    std::fs::write(folder.path().join("dated.run.toml"), sidecar.replace("epoch.csv", "iso.csv")).unwrap();
    let dated = run(folder.path(), &words("characterise evaluate dated.run.toml"));
    assert!(
        dated.exit == 2 && dated.says("characterise import --format csv --columns t=time"),
        "{}",
        dated.err
    );
    // So for traces.
    for (first, second, exit, says) in [
        ("1767700000", "1767700001", 0, "time 0 of the trace is 1767700000, Unix time of 2026-01-06"),
        ("2026-01-06T11:46:40Z", "2026-01-06T11:46:41Z", 0, "time 0 of the trace is 2026-01-06T11:46:40Z"),
        ("2026-01-06 11:46:40", "2026-01-06 11:46:41", 0, "time 0 of the trace is 2026-01-06 11:46:40"),
        ("6.1.2026 11:46:40", "6.1.2026 11:46:41", 0, "time 0 of the trace is 6.1.2026 11:46:40"),
        ("12/8/2022 23:59:59", "13/8/2022 00:00:00", 0, "time 0 of the trace is 12/8/2022 23:59:59"),
        ("08/07/2022 23:59:59", "08/08/2022 00:00:00", 2, "no day above 12 tells which"),
        ("08/07/22 23:59:59", "08/07/22 23:59:59", 2, "has a year of four digits"),
        (
            "1767700000000",
            "1767700001000",
            2,
            "Unix time in ms, expected a time in s; or the column called t_ms",
        ),
    ] {
        let rows = format!("t_s,position_mm\n{first},0\n{second},0.01\n");
        std::fs::write(folder.path().join("p.csv"), rows).unwrap();
        let traced = run(folder.path(), &words("trace from-position p.csv --count-um 1 --out t.csv"));
        assert!(traced.exit == exit && traced.says(says), "{first}: {} {}", traced.exit, traced.err);
    }
    std::fs::write(
        folder.path().join("unix.csv"),
        "t_ns,a,b\n1767700000000000000,0,0\n1767700000000100000,1,0\n1767700000000200000,1,1\n",
    )
    .unwrap();
    let played = run(folder.path(), &words("replay --trace unix.csv --requests forty.csv"));
    assert!(
        played.says("the trace begins at 1767700000000000000 ns (Unix time, 2026-01-06)"),
        "{}",
        played.err
    );
}

#[test]
fn sizes_have_standard_errors_and_no_advice_below() {
    let folder = inputs();
    let line = "part errors --points six-points.csv --radius-mm 27.3504";
    let json = run(folder.path(), &words(&format!("{line} --json")));
    assert!((json.figure("/plain_centre_mm/0") - 100.0).abs() < 5e-5);
    assert!((json.figure("/plain_centre_mm/1") - 60.0).abs() < 5e-5);
    assert!((json.figure("/plain_radius_mm") - 27.350_44).abs() < 5e-6);
    // Least squares on these six places: 7.948 times the scatter of 23.217 µm (3 degrees of freedom).
    assert!((json.figure("/plain_size_standard_error_um") - 184.5).abs() < 0.5);
    let text = run(folder.path(), &words(line));
    assert!(text.says("is no size: no offset is advised") && !text.says("takes it out"), "{}", text.out);
}

#[test]
fn drift_of_returns_is_not_their_scatter() {
    let folder = inputs();
    let line = "characterise evaluate creeping-probe.run.toml --standard repeatability --json";
    let found = run(folder.path(), &words(line));
    assert!((found.figure("/z/trend_um_per_return") + 1.1).abs() < 0.05);
    assert!((found.figure("/z/s_about_trend_um") - 0.65).abs() < 0.1);
    assert!(found.figure("/z/trend_standard_error_um") < 0.05);
    assert!(found.says("the returns drift by"), "{}", found.err);
}

#[test]
fn bad_readings_are_in_no_figure_of_any_verb() {
    let folder = inputs();
    let at = folder.path();
    let evaluated = run(at, &words("characterise evaluate power-on-85.run.toml --standard iso230-3 --json"));
    assert!((evaluated.figure("/temperatures/T1/range_K") - 7.74).abs() < 0.01);
    let model = |name: &str, um: f64| {
        let text = format!(
            "name = \"m\"\n[[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T1\"\nreference_degC = 20.0\num_per_K = {um}\n"
        );
        std::fs::write(at.join(name), text).unwrap();
    };
    model("a.toml", 3.3);
    model("b.toml", 3.0);
    let compared = run(at, &words("model compare a.toml b.toml --record power-on-85.run.toml --json"));
    // 0.3 µm/K over 7.7 K; with the readings of 85 °C it was 44 µm.
    let text = compared.json().to_string();
    assert!(compared.says("5 of 240 rows look misread and are in no figure"), "{}", compared.err);
    let apart = text.split("\"most_apart\":").nth(1).and_then(|t| t.split([',', '}']).next()).unwrap();
    assert!(apart.parse::<f64>().unwrap() < 2.5, "{text}");
    let judged = run(at, &words("model validate --machine a.toml --record power-on-85.run.toml --json"));
    assert!(judged.figure("/responses/0/largest_left") < 5.0, "{}", judged.out);
    let fit =
        run(at, &words("model fit --record power-on-85.run.toml --effects thermal_growth.z:T1 --out f.toml"));
    assert!(fit.says("left out of the fit: no sensor, 5 rows"), "{}", fit.err);
    let predicted =
        run(at, &words("model predict --machine a.toml --record power-on-85.run.toml --out p.csv"));
    assert!(predicted.says("5 readings that a sensor did not take"), "{}", predicted.err);
    let rehearsed = run(at, &words("model rehearse --machine a.toml --record power-on-85.run.toml --json"));
    assert!(rehearsed.figure("/axes/0/largest_um/1") < 30.0, "{}", rehearsed.out);
    let drawn =
        run(at, &words("model rehearse --machine a.toml --record power-on-85.run.toml --plot rehearse.svg"));
    assert!(drawn.says("drawn: rehearse.z.svg") && at.join("rehearse.z.svg").is_file(), "{}", drawn.err);
    // A sensor that took nothing at all has no figures.
    let csv = std::fs::read_to_string(at.join("power-on-85.csv")).unwrap();
    let dead: String = csv
        .lines()
        .map(|l| {
            let mut cells: Vec<&str> = l.split(',').collect();
            if cells[1] != "T1" {
                cells[1] = "-127";
            }
            cells.join(",") + "\n"
        })
        .collect();
    std::fs::write(at.join("power-on-85.csv"), dead).unwrap();
    let dead = run(at, &words("characterise evaluate power-on-85.run.toml --standard iso230-3 --json"));
    assert!(dead.json().pointer("/temperatures/T1").is_none(), "{}", dead.out);
    assert!(dead.json().pointer("/temperatures/T2").is_some(), "{}", dead.out);
}

#[test]
fn files_of_another_kind_are_refused_by_what_they_say() {
    let folder = inputs();
    let at = folder.path();
    std::fs::write(at.join("book.xlsx"), b"PK\x03\x04\x14\0\x06\0\x08\0\0\0!\0b\xee\x9dh\n").unwrap();
    std::fs::write(at.join("page.html"), "<!DOCTYPE html>\n<html></html>\n").unwrap();
    std::fs::write(at.join("degrees.cor"), "# deg um\n0.1 1.5\n0.2 1.0\n").unwrap();
    for (line, found) in [
        (
            "characterise import angular-table.rta --format rtl --axis x --out o.run.toml",
            "File type `rta` (angular",
        ),
        (
            "characterise import book.xlsx --format csv --columns t=time,e=error.x --out o.run.toml",
            "a spreadsheet's own",
        ),
        ("characterise import ghdl.vcd --format ecmc-dat --axis x --out o.run.toml", "a value change dump"),
        (
            "characterise import speck-1e-7.dxf --format linuxcnc-comp0 --axis x --out o.run.toml",
            "a DXF drawing",
        ),
        ("characterise import forty.csv --format etalon --axis x --out o.run.toml", "requested totals"),
        ("characterise import batch-point.csv --format rtl --axis x --out o.run.toml", "a batch of parts"),
        ("characterise import angular-table.rta --format cmm-plate --out o.run.toml", "data of a laser"),
        ("characterise evaluate inch-backlash.machine.toml", "a machine model"),
        ("part errors --points batch-point.csv --radius-mm 10", "a batch of parts"),
        ("part errors --points book.xlsx --radius-mm 10", "a spreadsheet's own"),
        ("part post-process --batch six-points.csv", "probed points"),
        ("part post-process --batch page.html", "XML or HTML"),
        ("part post-process --batch batch-point.csv --inspected degrees.cor", "'# deg um'"),
        ("part post-process --batch batch-point.csv --inspected ghdl.vcd", "a value change dump"),
        ("part features six-points.csv", "probed points"),
        ("part features ghdl.vcd", "a value change dump"),
        ("replay --trace forty.csv --requests forty.csv", "requested totals"),
        ("replay --trace b-broken.csv --requests b-broken.csv", "a quadrature trace"),
        ("model show --machine dial10.run.toml", "a run record"),
        ("model show --machine speck-1e-7.dxf", "a DXF drawing"),
        ("config check inch-backlash.machine.toml", "a machine model"),
    ] {
        let refused = run(at, &words(line));
        assert!(
            refused.exit == 2 && refused.err.contains(&format!("found {found}")),
            "{line}: {}",
            refused.err
        );
        assert!(!at.join("o.run.toml").exists() && !at.join("o.csv").exists(), "{line}");
    }
    // A chain and a card's profile, each where the other belongs.
    let chain = "tool_mm = [0, 0, 0]\n[[joint]]\nname = \"spindle\"\n";
    std::fs::write(at.join("chain.toml"), chain).unwrap();
    std::fs::write(at.join("m.toml"), "name = \"m\"\nchain = \"profile.toml\"\n").unwrap();
    let profile =
        "name = \"c\"\ninputs = [{ register = 0, width = 8 }]\noutputs = []\n[lines]\na = { input = 0 }\n";
    std::fs::write(at.join("profile.toml"), profile).unwrap();
    let shown = run(at, &words("model show --machine m.toml"));
    assert!(shown.exit == 2 && shown.says("found a card's profile"), "{}", shown.err);
    let config = std::fs::read_to_string(at.join("absent-chip.rtec.toml")).unwrap();
    let config = config
        .replace("\"gpio\"", "\"mapped\"\nfile = \"/dev/null\"\nprofile = \"chain.toml\"")
        .replace("chip = \"gpiochip0\"\n", "");
    std::fs::write(at.join("c.rtec.toml"), config).unwrap();
    let checked = run(at, &words("config check --elsewhere c.rtec.toml"));
    assert!(checked.exit == 2 && checked.says("found a kinematic chain"), "{}", checked.err);
}

#[test]
fn a_dead_channel_is_named_and_nothing_inserted() {
    let folder = inputs();
    let played = run(folder.path(), &words("replay --trace b-broken.csv --requests forty.csv --json"));
    assert_eq!(played.exit, 4, "{}", played.err);
    assert_eq!((played.figure("/insertions"), played.figure("/completed")), (0.0, 0.0));
    assert!(played.says("channel dead") && played.says("channel_dead"), "{}{}", played.out, played.err);
}

#[test]
fn unrelated_signals_do_not_stop_a_reader() {
    let folder = inputs();
    let played = run(folder.path(), &words("replay --trace ghdl.vcd --requests forty.csv --json"));
    assert_eq!(played.figure("/counts_in"), 28.0);
    let refused = run(folder.path(), &words("replay --trace ghdl-undefined-at-0.vcd --requests forty.csv"));
    assert!(refused.exit == 2 && refused.says("found U for signal a"), "{}", refused.err);
    // A pin of another type beside the two that are wanted.
    let samples: String = (0..30).map(|i| format!("{}.5 TRUE 0x1f {} \n", i, 2 * i)).collect();
    std::fs::write(folder.path().join("hal.txt"), samples).unwrap();
    let line = "characterise import hal.txt --format halsampler --period-s 0.001 --columns 1=position.x,4=error.x --out h.run.toml";
    let imported = run(folder.path(), &words(line));
    assert_eq!(imported.exit, 0, "{}", imported.err);
    assert_eq!(column(folder.path(), "h.csv", "4")[29], 58.0);
    // Lines of another program in front of the names; its own keys and comments.
    let log = "Logger 3.1\nSerial,17,B\n\nt,e,note\n0,1,a\n1,2.5,b\n";
    std::fs::write(folder.path().join("log.csv"), log).unwrap();
    let line = "characterise import log.csv --format csv --columns t=time,e=error.x --out l.run.toml";
    let imported = run(folder.path(), &words(line));
    assert_eq!((imported.exit, column(folder.path(), "l.csv", "e")), (0, vec![1.0, 2.5]), "{}", imported.err);
    assert!(imported.says("passed over 3 lines in front of the columns' names"), "{}", imported.err);
    let etalon = "; made by x\n[EXX]\nUnit = mm\nGridpoints = {\n0 0\n10 0.001\n}\n";
    std::fs::write(folder.path().join("e.txt"), etalon).unwrap();
    let line = "characterise import e.txt --format etalon --axis x --out e.run.toml";
    assert_eq!(run(folder.path(), &words(line)).exit, 0);
}

#[test]
fn a_table_states_what_it_leaves_applied() {
    let folder = inputs();
    let line = "model export --machine inch-backlash.machine.toml --axis x --from -254 --to 0 --unit inch --format linuxcnc --out x.comp --json";
    let exported = run(folder.path(), &words(line));
    assert!((exported.figure("/max_up_um") - 4.08).abs() < 0.05);
    assert!(exported.says("the table moves the drive by up to"), "{}", exported.err);
}

#[test]
fn near_zero_geometry_is_cleaned_and_said() {
    let folder = inputs();
    let features = |file: &str| run(folder.path(), &["part", "features", file]);
    for (file, says) in [
        ("speck-1e-7.dxf", "took 1 arc as straight"),
        ("speck-1e-13.dxf", "took 1 arc as straight"),
        ("vertex-twice.dxf", "left out 1 vertex"),
    ] {
        let found = features(file);
        assert!(
            found.exit == 0 && found.says("3 features") && found.says(says),
            "{file}: {}{}",
            found.out,
            found.err
        );
        assert!(found.says("cylinder   radius 20.0000 mm"), "{file}: {}", found.out);
    }
    let length = |found: &Run| -> f64 {
        let polyline = found.out.lines().filter(|l| l.contains("POLYLINE"));
        polyline
            .map(|l| l.split(" mm long").next().unwrap().rsplit(' ').next().unwrap().parse::<f64>().unwrap())
            .sum()
    };
    for file in ["spline-fit.dxf", "fitted-only.dxf"] {
        let found = features(file);
        assert!((length(&found) - 61.41).abs() < 0.01, "{file}: {}", found.out);
    }
    let layer = run(folder.path(), &["part", "features", "speck-1e-7.dxf", "--layer", "none"]);
    assert!(layer.exit == 2 && layer.says("one of the layers that hold anything: 0"), "{}", layer.err);
}

#[test]
fn a_chip_that_is_absent_is_named() {
    let folder = inputs();
    let config = std::fs::read_to_string(folder.path().join("absent-chip.rtec.toml")).unwrap();
    let config = config.replace("gpiochip0", "gpiochip4095").replace("cpu = 1", "cpu = 4095");
    std::fs::write(folder.path().join("c.rtec.toml"), config).unwrap();
    let checked = run(folder.path(), &words("config check c.rtec.toml"));
    assert_eq!(checked.exit, 2, "{}", checked.err);
    assert!(
        checked.says("GPIO chip gpiochip4095")
            && checked.says("cpu = 4095, which this computer does not have")
    );
    let socket = format!("/tmp/{}", "s".repeat(103));
    let status = run(folder.path(), &["status", "--socket", &socket]);
    assert!(
        status.exit == 2 && status.says("found a path of 108 bytes, expected at most 107"),
        "{}",
        status.err
    );
}

/// The same table as programs and spreadsheets of several countries write it.
fn dialects(table: &str) -> Vec<(&'static str, Vec<u8>)> {
    let german = |by: &str| table.replace(',', by).replace('.', ",");
    let rows = |text: &str, row: &dyn Fn(&str) -> String| text.lines().map(row).collect::<String>();
    let cells = |line: &str| {
        line.split(',').map(|cell| format!("\"{}\"", cell.replace('.', ","))).collect::<Vec<_>>()
    };
    let utf16 =
        |text: &str| -> Vec<u16> { format!("\u{feff}{text}").replace('\n', "\r\n").encode_utf16().collect() };
    vec![
        ("semicolons", german(";").into_bytes()),
        ("tabs", german("\t").into_bytes()),
        ("bars", table.replace(',', "|").into_bytes()),
        ("a line sep=", format!("sep=;\n{}", german(";")).into_bytes()),
        ("quotes", rows(table, &|line| cells(line).join(",") + "\n").into_bytes()),
        ("UTF-16, little end first", utf16(&german(";")).into_iter().flat_map(u16::to_le_bytes).collect()),
        ("UTF-16, big end first", utf16(table).into_iter().flat_map(u16::to_be_bytes).collect()),
        ("a byte-order mark", format!("\u{feff}{}", table.replace('\n', "\r\n")).into_bytes()),
        ("separators at the end", rows(&german(";"), &|line| format!("{line};;\n")).into_bytes()),
        ("blanks", table.replace(',', " , ").into_bytes()),
        ("comments", format!("# bench 3\n\n{table}\n# end\n").into_bytes()),
    ]
}

#[test]
fn every_reader_takes_every_dialect() {
    let record = "file = \"in.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\", unit = \"s\" }\ne = { role = \"error.z\", unit = \"um\" }\n";
    for (table, line) in [
        (
            "t,e\n0,1.5\n10,2.25\n20,3.125\n30,2.5\n",
            "characterise import in.csv --format csv --columns t=time,e=error.z --out o.run.toml",
        ),
        ("t,e\n0,1.5\n600,2.25\n1200,3.125\n1800,2.5\n", "characterise evaluate in.run.toml --json"),
        (
            "z_mm,x_mm\n110.0,0.0\n108.0,6.0\n106.0,8.0\n100.0,10.0\n94.0,8.0\n",
            "part errors --points in.csv --radius-mm 10 --tip-mm 0 --json",
        ),
        (
            "part,feature,error_um\n1,D1,11.5\n2,D1,12.25\n3,D1,11.75\n",
            "part post-process --batch in.csv --json",
        ),
        (
            "t_s,position_mm\n0.0,0.0\n0.001,0.0015\n0.002,0.0035\n",
            "trace from-position in.csv --count-um 1 --out o.csv --json",
        ),
        (
            "t_ns,a,b\n0,0,0\n10000,1,0\n20000,1,1\n30000,0,1\n",
            "replay --trace in.csv --requests totals.csv --json",
        ),
        ("t_ns,requested\n0,0\n15000,2\n", "replay --trace trace.csv --requests in.csv --json"),
    ] {
        let read = |bytes: &[u8]| {
            let folder = tempfile::tempdir().unwrap();
            let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
            put("in.csv", bytes);
            put("in.run.toml", record.as_bytes());
            put("totals.csv", b"t_ns,requested\n0,0\n15000,2\n");
            put("trace.csv", b"t_ns,a,b\n0,0,0\n10000,1,0\n20000,1,1\n30000,0,1\n");
            let done = run(folder.path(), &words(line));
            let written = std::fs::read_to_string(folder.path().join("o.csv")).unwrap_or_default();
            assert_eq!(done.exit, 0, "{line}: {}{}", String::from_utf8_lossy(bytes), done.err);
            (done.out, written)
        };
        let plain = read(table.as_bytes());
        for (dialect, bytes) in dialects(table) {
            assert_eq!(read(&bytes), plain, "{dialect}: {line}");
        }
    }
}

/// Separators at the end of every row part nothing; at the end of some rows they are said.
#[test]
fn separators_at_the_end_of_some_rows_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let says = "2 rows end with a separator behind the last column (line 3 first), 3 do not: is a cell missing there?";
    for (text, said) in [
        ("t,e\n1,2,\n2,3,\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e,\n1,2,\n2,3,\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e,\n1,2\n2,3\n3,4\n4,5\n5,6\n", false),
        ("t,e,note\n1,2,\n2,3,late\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e\n1,2\n2,3,\n3,4\n4,5,,\n5,6\n", true),
        ("t;e\n1;2\n2;3;\n3;4\n4;5;\n5;6\n", true),
    ] {
        std::fs::write(at.join("in.csv"), text).unwrap();
        let line = "characterise import in.csv --format csv --columns t=time,e=error.x --out o.run.toml";
        let imported = run(at, &words(line));
        assert_eq!((imported.exit, column(at, "o.csv", "e")), (0, vec![2.0, 3.0, 4.0, 5.0, 6.0]), "{text}");
        assert_eq!(imported.says(says), said, "{text}: {}", imported.err);
    }
    // A further value is no separator.
    std::fs::write(at.join("in.csv"), "t,e\n1,2,\n2,3,late\n").unwrap();
    let line = "characterise import in.csv --format csv --columns t=time,e=error.x --out o.run.toml";
    let refused = run(at, &words(line));
    assert!(refused.exit == 2 && refused.says("in.csv:3:5: found 'late'"), "{}", refused.err);
}

/// A verb that is ended by a signal while it writes leaves nothing, not even a hidden file.
#[test]
fn an_interrupted_verb_leaves_no_file() {
    use std::io::Write as _;
    use std::os::unix::process::ExitStatusExt;
    for line in [
        "trace convert in.csv out.csv",
        "trace convert in.csv out.vcd",
        "trace from-position in.csv --count-um 1 --out out.csv",
        "replay --trace in.csv --requests totals.csv --out out.csv --vcd out.vcd",
    ] {
        for (name, signal) in [("INT", 2), ("TERM", 15)] {
            let folder = tempfile::tempdir().unwrap();
            let at = folder.path();
            std::fs::write(at.join("totals.csv"), "t_ns,requested\n0,0\n").unwrap();
            std::fs::write(at.join("out.csv"), "kept\n").unwrap();
            let made = Command::new("mkfifo").arg(at.join("in.csv")).status().unwrap();
            assert!(made.success());
            let mut verb = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
                .current_dir(at)
                .args(line.split(' '))
                .stdout(std::process::Stdio::null())
                .stderr(std::process::Stdio::null())
                .spawn()
                .unwrap();
            let mut rows = std::fs::OpenOptions::new().write(true).open(at.join("in.csv")).unwrap();
            let is_record = line.contains("from-position");
            rows.write_all(if is_record { b"t_s,position_mm\n" } else { b"t_ns,a,b\n" }).unwrap();
            // More than the pipe and the reader's buffer hold: when it is taken, rows have been written. The pipe stays open.
            let many: String = (0..100_000_u32)
                .map(|i| match i % 4 {
                    _ if is_record => format!("{i}.0,0.0{}\n", i % 2),
                    0 => format!("{},0,0\n", 1000 * i),
                    1 => format!("{},1,0\n", 1000 * i),
                    2 => format!("{},1,1\n", 1000 * i),
                    _ => format!("{},0,1\n", 1000 * i),
                })
                .collect();
            rows.write_all(many.as_bytes()).unwrap();
            let sent =
                Command::new("kill").args([&format!("-{name}"), &verb.id().to_string()]).status().unwrap();
            assert!(sent.success());
            let ended = verb.wait().unwrap();
            assert_eq!(ended.signal(), Some(signal), "{line}");
            drop(rows);
            let mut left: Vec<_> = std::fs::read_dir(at)
                .unwrap()
                .map(|e| e.unwrap().file_name().into_string().unwrap())
                .collect();
            left.sort();
            assert_eq!(left, ["in.csv", "out.csv", "totals.csv"], "{line} after SIG{name}");
            assert_eq!(std::fs::read_to_string(at.join("out.csv")).unwrap(), "kept\n", "{line}");
        }
    }
}

/// An import says which channel is dead, and which readings are codes of a sensor that did not measure.
#[test]
fn an_import_names_dead_channels_and_codes_of_sensors() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let import = |name: &str, t1: &dyn Fn(u32) -> f64| {
        let rows: String =
            (0..120).map(|i| format!("{},{:.3},{:.3}\n", 30 * i, t1(i), 0.05 * f64::from(i))).collect();
        std::fs::write(at.join(name), format!("t,T1,e\n{rows}")).unwrap();
        let line = format!(
            "characterise import {name} --format csv --columns t=time,T1=temperature,e=error.z --kind drift --out o.run.toml"
        );
        run(at, &words(&line))
    };
    let warm = |i: u32| 21.0 + 0.01 * f64::from(i);
    for (code, says) in [
        (85.0, "reads 85 degC: the power-on value of a DS18B20 in some rows (rows 1,41)"),
        (-127.0, "reads -127 degC: a DS18B20 that does not answer in some rows (rows 1,41)"),
        (0.0, "reads 0 degC: an input without a sensor in some rows (rows 1,41)"),
        (850.0, "reads 850 degC: an open PT100 in some rows (rows 1,41)"),
    ] {
        let imported = import("code.csv", &|i| if matches!(i, 0 | 40) { code } else { warm(i) });
        assert!(
            imported.exit == 0 && imported.says("unplugged: T1") && imported.says(says),
            "{}",
            imported.err
        );
    }
    let dead = import("dead.csv", &|_| 21.5);
    assert!(dead.says("T1 reads 21.5 degC in every row: is it read?"), "{}", dead.err);
    let good = import("good.csv", &warm);
    assert!(!good.says("T1"), "{}", good.err);
}

/// A trace and its requests as other programs name and write them are those of the contract.
#[test]
fn traces_and_requests_take_columns_by_name_and_number() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let put = |name: &str, text: &str| std::fs::write(at.join(name), text).unwrap();
    put("trace.csv", "t_ns,a,b\n0,0,0\n10000,1,0\n1200000,1,1\n2300000,0,1\n");
    put("totals.csv", "t_ns,requested\n0,0\n1500000,2\n");
    let good = run(at, &words("replay --trace trace.csv --requests totals.csv --json")).out;
    assert!(good.contains("\"counts_in\":3"), "{good}");
    for (trace, text, columns) in [
        (
            "named.csv",
            "Zeit;Kanal A;Kanal B\n0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n",
            "t_ns=Zeit,a=Kanal A,b=Kanal B",
        ),
        ("other.csv", "b;t;a\n0;0;0\n0;10000;1\n1;1200000;1\n1;2300000;0\n", "t_ns=2,a=3,b=1"),
        ("rows.csv", "0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n", "t_ns=1,a=2,b=3"),
        ("sep.csv", "sep=;\n0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n", "t_ns=1,a=2,b=3"),
        // What a lone mark is, the other cells of the column show.
        ("thousands.csv", "t;a;b\n0;0;0\n10.000;1;0\n1.200.000;1;1\n2.300.000;0;1\n", "t_ns=t,a=a,b=b"),
        (
            "quoted.csv",
            "t,a,b\n0,0,0\n\"10,000\",1,0\n\"1,200,000\",1,1\n\"2,300,000\",0,1\n",
            "t_ns=t,a=a,b=b",
        ),
        // A logic analyser in seconds; its third channel changes by itself.
        (
            "saleae.csv",
            "Time [s],Channel 0,Channel 1,Channel 2\n0.000000000,0,0,0\n0.000004000,0,0,1\n0.000010000,1,0,1\n\
             0.0012000000,1,1,1\n2.3e-3,0,1,0\n",
            "t_s=Time [s],a=Channel 0,b=Channel 1",
        ),
        ("german.csv", "t;a;b\n0,000000;0;0\n0,010000;1;0\n1,2;1;1\n2,3;0;1\n", "t_ms=t,a=a,b=b"),
        ("us.csv", "0|0|0\n10|1|0\n1200|1|1\n2300|0|1\n", "t_us=1,a=2,b=3"),
        (
            "d.vcd",
            "$timescale 1 us $end\n$var wire 1 ! D0 $end\n$var wire 4 # bus $end\n$var wire 1 % D1 $end\n\
             $enddefinitions $end\n#0 0! 0%\n#10 1!\n#1200 1%\n#2300 0!\n",
            "a=D0,b=2",
        ),
    ] {
        put(trace, text);
        let played = run(
            at,
            &["replay", "--trace", trace, "--columns", columns, "--requests", "totals.csv", "--json"],
        );
        assert_eq!((played.exit, &played.out), (0, &good), "{trace}: {}", played.err);
        let converted = run(at, &["trace", "convert", trace, "c.csv", "--columns", columns]);
        assert_eq!(converted.exit, 0, "{trace}: {}", converted.err);
        let text = |name: &str| std::fs::read_to_string(at.join(name)).unwrap();
        assert_eq!(text("c.csv"), text("trace.csv"), "{trace}");
    }
    for (totals, text, columns) in [
        ("r1.csv", "wann;Soll\n0;0\n1500000;2\n", "t_ns=wann,requested=Soll"),
        ("r2.csv", "0;0\n2;1500000\n", "t_ns=2,requested=1"),
        ("r3.csv", "when\ttotal\n0\t0\n0,0015\t2\n", "t_s=1,requested=2"),
        ("r4.csv", "note;t;n\nstart;0;0\nup;1.500.000;2\n", "t_ns=t,requested=n"),
    ] {
        put(totals, text);
        let played = run(
            at,
            &["replay", "--trace", "trace.csv", "--requests", totals, "--request-columns", columns, "--json"],
        );
        assert_eq!((played.exit, &played.out), (0, &good), "{totals}: {}", played.err);
    }
    for (columns, says) in [
        ("t_ns=Zeit,a=Kanal A", "--columns: found no b"),
        ("a=Kanal A,b=Kanal B", "--columns: found no time, expected one of t_ns, t_us, t_ms, t_s"),
        ("t_ns=Zeit,t_s=Zeit,a=Kanal A,b=Kanal B", "--columns: found two times"),
        ("t_ns=Zeit,a=Kanal A,b=Kanal A", "found one column for two names"),
        (
            "t_ns=Zeit,a=Kanal A,b=Kanal C",
            "found no column Kanal C, expected a column Kanal C among Zeit, Kanal A, Kanal B",
        ),
        ("t_ns=Zeit,a=Kanal A,z=Kanal B", "one of t_ns, t_us, t_ms, t_s, a, b in front of ="),
    ] {
        let refused =
            run(at, &["replay", "--trace", "named.csv", "--columns", columns, "--requests", "totals.csv"]);
        assert!(refused.exit == 2 && refused.says(says), "{columns}: {}", refused.err);
    }
    let refused = run(at, &words("replay --trace named.csv --requests totals.csv"));
    assert!(
        refused.exit == 2 && refused.says("or --columns with the columns' names or numbers"),
        "{}",
        refused.err
    );
    let refused = run(at, &words("replay --trace d.vcd --requests totals.csv"));
    assert!(
        refused.exit == 2 && refused.says("or --columns a=NAME,b=NAME with two of D0, D1"),
        "{}",
        refused.err
    );
    // A total is whole.
    put("half.csv", "t_ns,requested\n0,0\n1500000,1.4\n");
    let refused = run(at, &words("replay --trace trace.csv --requests half.csv"));
    assert!(refused.exit == 2 && refused.says("half.csv:3:9: found '1.4'"), "{}", refused.err);
    // One lone mark has two readings, and no other cell tells.
    put("lone.csv", "t;a;b\n0;0;0\n10.000;1;0\n");
    let refused = run(at, &words("replay --trace lone.csv --columns t_ns=t,a=a,b=b --requests totals.csv"));
    assert!(refused.exit == 2 && refused.says("lone.csv:3:1: found '10.000'"), "{}", refused.err);
}

#[test]
fn one_csv_front_serves_every_verb() {
    let folder = inputs();
    let at = folder.path();
    for dialect in ["point", "comma", "sep-line", "thousands", "utf16"] {
        let line = format!("part post-process --batch batch-{dialect}.csv --json");
        let judged = run(at, &words(&line));
        assert!((judged.figure("/places/0/mean_um") - 11.55).abs() < 0.005, "{dialect}");
        assert_eq!(judged.says("read as"), dialect != "point", "{dialect}: {}", judged.err);
    }
    let import = |file: &str, columns: &str| {
        let line = format!("characterise import {file} --format csv --columns {columns} --out o.run.toml");
        run(at, &words(&line))
    };
    for (file, at_line) in [("cells-div0.csv", "3:3: found '#DIV/0!'"), ("cells-na.csv", "3:3: found '#N/A'")]
    {
        let refused = import(file, "t=time,e=error.x");
        assert!(refused.exit == 2 && refused.says(at_line), "{file}: {}", refused.err);
    }
    let hash = run(
        at,
        &[
            "characterise",
            "import",
            "cells-hash-header.csv",
            "--format",
            "csv",
            "--columns",
            "Sample #=cycle,t=time,e=error.x",
            "--out",
            "o.run.toml",
        ],
    );
    assert_eq!((hash.exit, column(at, "o.csv", "Sample #")), (0, vec![1.0, 2.0]), "{}", hash.err);
    let parted = import("cells-sep.csv", "t=time,e=error.x");
    assert_eq!((parted.exit, column(at, "o.csv", "e")), (0, vec![1.5, 2.5]), "{}", parted.err);
    assert!(parted.says("read as columns parted by semicolons, decimal commas"), "{}", parted.err);
    let german = import("cells-german-time.csv", "time=time,e=error.x");
    assert_eq!((german.exit, column(at, "o.csv", "time")), (0, vec![0.0, 1.0]), "{}", german.err);
    let own = run(
        at,
        &words("characterise import probe-results.txt --format own --form form-quoted.toml --out o.run.toml"),
    );
    assert_eq!((own.exit, column(at, "o.csv", "x")[0]), (0, -25.4), "{}", own.err);

    // The same points and positions, with and without names, by name and by number.
    let points = std::fs::read_to_string(at.join("six-points.csv")).unwrap();
    let german: String =
        points.lines().skip(1).map(|l| l.replace(',', ";").replace('.', ",") + "\n").collect();
    let utf16: Vec<u8> = "\u{feff}"
        .encode_utf16()
        .chain(format!("Laenge;Radius\r\n{german}").encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(at.join("named.csv"), utf16).unwrap();
    std::fs::write(at.join("nameless.csv"), &german).unwrap();
    for (file, columns) in [
        ("named.csv", "z_mm=Laenge,x_mm=Radius"),
        ("named.csv", "z_mm=1,x_mm=2"),
        ("nameless.csv", "z_mm=1,x_mm=2"),
    ] {
        let line = format!("part errors --points {file} --columns {columns} --radius-mm 27.3504 --json");
        let found = run(at, &words(&line));
        assert!((found.figure("/plain_radius_mm") - 27.350_44).abs() < 5e-6, "{file} {columns}");
    }
    let refused = run(at, &words("part errors --points nameless.csv --radius-mm 27.3504"));
    assert!(refused.exit == 2 && refused.says("the line that names them is missing"), "{}", refused.err);
    let nameless = run(
        at,
        &words(
            "characterise import nameless.csv --format csv --columns 1=position.x,2=error.x --kind probing --out n.run.toml",
        ),
    );
    assert_eq!((nameless.exit, column(at, "n.csv", "1")[0]), (0, 125.451_984), "{}", nameless.err);
    std::fs::write(at.join("p.csv"), "sep=;\nZeit_ms;Weg\n0;0,1\n1000;0,25\n2000;1,5\n").unwrap();
    std::fs::write(at.join("q.csv"), "0;0,1\n1000;0,25\n2000;1,5\n").unwrap();
    for line in [
        "trace from-position p.csv --count-um 1 --column Weg --unit mm --time-column Zeit_ms --out t.csv --json",
        "trace from-position q.csv --count-um 1 --column 2 --unit mm --time-column 1 --time-unit ms --out t.csv --json",
    ] {
        let traced = run(at, &words(line));
        assert!(
            traced.exit == 0 && traced.says("read as columns parted by semicolons, decimal commas"),
            "{}",
            traced.err
        );
        assert!(traced.out.contains("1399"), "{}", traced.out);
    }
    for (file, from) in [("b.csv", "b-broken.csv"), ("f.csv", "forty.csv")] {
        let text = std::fs::read_to_string(at.join(from)).unwrap();
        std::fs::write(at.join(file), text.replace(',', ";")).unwrap();
    }
    let played = run(at, &words("replay --trace b.csv --requests f.csv"));
    assert!(played.exit == 4 && played.says("b.csv: read as columns parted by semicolons"), "{}", played.err);
    let converted = run(at, &words("trace convert b.csv c.csv"));
    assert_eq!(converted.exit, 0, "{}", converted.err);
    let [plain, again] =
        ["b-broken.csv", "c.csv"].map(|f| std::fs::read_to_string(at.join(f)).unwrap().replace('\r', ""));
    assert_eq!(plain, again);
}

/// Rotary axes are refused by name wherever one can be named: records, imports, plans, models, fits.
#[test]
fn rotary_axes_are_refused_by_name_in_every_verb() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let write = |name: &str, text: &str| std::fs::write(at.join(name), text).unwrap();
    let rows: String = (0..20).map(|i| format!("{},{},{}\n", i, 10 * i, 0.1 * f64::from(i))).collect();
    write("r.csv", &format!("t,c,e\n{rows}"));
    let record = |name: &str, position: &str, unit: &str, error: &str| {
        let text = format!(
            "file = \"r.csv\"\nkind = \"positioning\"\n[columns]\nt = {{ role = \"time\", unit = \"s\" }}\n\
             c = {{ role = \"{position}\", unit = \"{unit}\" }}\ne = {{ role = \"{error}\", unit = \"um\" }}\n"
        );
        write(name, &text);
    };
    record("c.run.toml", "position.c", "deg", "error.c");
    record("mm.run.toml", "position.a", "mm", "error.x");
    record("deg.run.toml", "position.x", "deg", "error.x");
    record("good.run.toml", "position.x", "mm", "error.x");
    write("c.toml", "name = \"m\"\n[[effect]]\nname = \"scale.c\"\nppm = 3.0\n");
    write("m.toml", "name = \"m\"\neffect = []\n");
    for line in [
        "characterise evaluate c.run.toml",
        "characterise evaluate mm.run.toml",
        "characterise evaluate deg.run.toml",
        "characterise plan --axes x=500,c=360",
        "characterise import r.csv --format csv --columns t=time,c=position.c:deg,e=error.c --kind positioning --out i.run.toml",
        "model show --machine c.toml",
        "model fit --record c.run.toml --out f.toml",
        "model fit --record good.run.toml --effects scale.c --out f.toml",
        "model validate --machine m.toml --record deg.run.toml",
        "model export --machine c.toml --axis c --from 0 --to 10 --out t.txt",
        "reconcile c.run.toml --model m.toml",
        "simulate linear-displacement --machine c.toml --out s",
    ] {
        let done = run(at, &words(line));
        assert!(
            done.exit == 2 && done.says("rotary axes (A, B and C of ISO 841) are not"),
            "{line}: {}",
            done.err
        );
    }
}
