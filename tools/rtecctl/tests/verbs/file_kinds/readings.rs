//! Coarse, bad and absolute readings.

use super::{column, inputs, run, words};

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
    // 6 µm/K over 2 K, read by a sensor with a resolution of 0.5 K.
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
    // All times on one day: in January or in June, the times since the first row are the same.
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
    // Unix seconds declared as minutes are questioned.
    let minutes =
        "characterise import epoch.csv --format csv --columns t=time:min,e=error.z --out minutes.run.toml";
    let refused = run(folder.path(), &words(minutes));
    assert!(refused.exit == 2 && refused.says("Unix time in s, as t=time:s"), "{}", refused.err);
    // A written record is questioned; for dates in it the way to import them is named.
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
    // The same for traces.
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
    // Least squares at these six positions: 7.948 times the scatter of 23.217 µm (3 degrees of freedom).
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
    // A sensor without any good reading has no figures.
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

/// A log with 10 s per row by a clock of whole minutes.
/// Only the lag is named, and its interval contains the truth.
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
        // Noise without correlation, the same in every run.
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

/// An import names dead channels, and readings that are error codes of a sensor.
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
