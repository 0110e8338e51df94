//! `rtecctl reconcile`: its verdicts, what it writes, and live runs.

use std::io::Write as _;
use std::net::TcpListener;
use std::process::Command;

/// A gauge that reads 5 µm and a small varying part, until the connection closes.
fn gauge() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            for i in 0_u32.. {
                // Scattered, not stepped: no period is in it, whichever readings are taken.
                let mixed = (i ^ i >> 16).wrapping_mul(0x7feb_352d);
                let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x846c_a68b);
                let little = f64::from((mixed ^ mixed >> 16) % 1000) / 1000.0 - 0.5;
                if writeln!(stream, "gz {}", 5.0 + little).is_err() {
                    break;
                }
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
        }
    });
    address
}

#[test]
fn a_live_run_is_recorded_and_reconciled() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    let feed = gauge();
    let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["reconcile", "--live", "run.run.toml", "--model", "machine.toml", "--json"])
        .args(["--feed", &feed, "--columns", "gz=error.z", "--period", "0.02", "--duration", "3"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(folder.path().join("run.run.toml").exists());
    let verdict = crate::document(&output.stdout);
    // Every gauge has its own zero, which belongs to the set-up.
    assert_eq!(verdict["verdict"], "nothing_missing", "{verdict}");
    let zero_um = verdict["set_up"]["run.run.toml"]["zero_um"].as_f64().unwrap();
    assert!((zero_um - 5.0).abs() < 0.2, "{verdict}");
}

#[test]
fn what_a_live_run_needs_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    for (arguments, expected) in [
        (vec!["--live", "run.run.toml"], "--duration"),
        (vec!["--live", "run.run.toml", "--duration", "1"], "no response"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "--model", "machine.toml"])
            .args(&arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(expected), "{said}");
        assert!(!folder.path().join("run.run.toml").exists());
    }
}

/// A record of one axis that warms up, and an empty model.
fn warm_up(folder: &std::path::Path) {
    let row = |i: u32| {
        let t = 20.0 * f64::from(i);
        format!("{t},{}\n", 20.0 * (1.0 - (-t / 600.0).exp()) + f64::from(i * 7919 % 1000) / 1000.0)
    };
    let rows: String = (0..120).map(row).collect();
    std::fs::write(folder.join("run.csv"), format!("t,e\n{rows}")).unwrap();
    let columns =
        "[columns]\nt = { role = \"time\", unit = \"s\" }\ne = { role = \"error.z\", unit = \"um\" }\n";
    std::fs::write(folder.join("run.run.toml"), format!("file = \"run.csv\"\nkind = \"drift\"\n{columns}"))
        .unwrap();
    std::fs::write(folder.join("machine.toml"), "name = \"m\"\n").unwrap();
}

#[test]
fn each_stage_does_its_own_part() {
    let folder = tempfile::tempdir().unwrap();
    warm_up(folder.path());
    for (stage, keys, files) in [
        ("find", vec!["level", "seed", "where"], vec!["verdict.json"]),
        ("name", vec!["verdict", "effects"], vec!["verdict.json"]),
        ("add", vec!["verdict", "effects"], vec!["model.toml", "verdict.json"]),
        ("show", vec!["verdict", "effects", "gap"], vec!["model.toml", "report.html", "verdict.json"]),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "run.run.toml", "--model", "machine.toml", "--json"])
            .args(["--stage", stage, "--out", stage])
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let document = crate::document(&output.stdout);
        let map = document.as_object().unwrap();
        assert!(keys.iter().all(|k| map.contains_key(*k)), "{stage}: {document}");
        assert_eq!(map.contains_key("gap"), stage == "show");
        if stage == "find" {
            assert_eq!(map.len(), keys.len() + 2, "{document}"); // and `format`, `by`
        } else {
            assert_eq!(document["effects"][0]["name"], "warm_up.z", "{document}");
        }
        let mut written: Vec<String> = std::fs::read_dir(folder.path().join(stage))
            .unwrap()
            .map(|f| f.unwrap().file_name().into_string().unwrap())
            .collect();
        written.sort();
        assert_eq!(written, files, "{stage}");
    }
}

/// A record of X by its rows: time, position, error.
fn of_x(folder: &std::path::Path, rows: impl Iterator<Item = [f64; 3]>) {
    let rows = rows.map(|[t, p, e]| format!("{t},{p},{e:.4}\n")).collect::<Vec<_>>().concat();
    std::fs::write(folder.join("run.csv"), format!("t,p,e\n{rows}")).unwrap();
    let columns = "[columns]\nt = { role = \"time\", unit = \"s\" }\np = { role = \"position.x\", unit = \"mm\" }\n\
                   e = { role = \"error.x\", unit = \"um\" }\n";
    std::fs::write(
        folder.join("run.run.toml"),
        format!("file = \"run.csv\"\nkind = \"positioning\"\n{columns}"),
    )
    .unwrap();
    std::fs::write(folder.join("machine.toml"), "name = \"m\"\n").unwrap();
}

/// Independent numbers between −½ and ½.
fn scatter(i: u32) -> f64 {
    let mixed = (i + 1).wrapping_mul(2_654_435_761);
    f64::from((mixed ^ (mixed >> 15)).wrapping_mul(2_246_822_519) >> 8) / f64::from(1 << 24) - 0.5
}

/// A sawtooth in time has no name, so a curve is written in its place.
/// The result loads again from a folder that did not exist.
#[test]
fn an_unexplained_curve_is_written_and_loads_again() {
    let folder = tempfile::tempdir().unwrap();
    let saw = |i: u32| 8.0 * ((f64::from(i) / 90.0).fract() - 0.5) + scatter(i);
    of_x(folder.path(), (0..240).map(|i| [5.0 * f64::from(i), f64::from(i * 37 % 101), saw(i)]));
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
        command.args(arguments).current_dir(folder.path()).output().unwrap()
    };
    let output = run(&[
        "reconcile",
        "run.run.toml",
        "--model",
        "machine.toml",
        "--unexplained",
        "--out",
        "found",
        "--json",
    ]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let document = crate::document(&output.stdout);
    assert_eq!(document["verdict"], "unknown_effect", "{document}");
    assert!(folder.path().join("found/unexplained.toml").exists());
    // It is judged on rows that it was not fitted to, where it leaves more.
    let left = |rows: &str| document["gap"][rows]["after"].as_f64().unwrap_or(f64::NAN);
    assert!(left("cross_validation") > left("train"), "{}", document["gap"]);
    let shown = run(&["model", "show", "--machine", "found/model.toml"]);
    let said = String::from_utf8_lossy(&shown.stdout);
    assert!(shown.status.success() && said.contains("unexplained"), "{said}");
    // The written model can be reconciled again, into a directory that does not exist yet.
    let again = run(&["reconcile", "run.run.toml", "--model", "found/model.toml", "--out", "again"]);
    assert!(again.status.success(), "{}", String::from_utf8_lossy(&again.stderr));
    assert!(run(&["model", "show", "--machine", "again/model.toml"]).status.success());
}

/// What the first stage prints of `run.run.toml` with `machine.toml` in a folder.
fn found_first(folder: &std::path::Path) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["reconcile", "run.run.toml", "--model", "machine.toml", "--stage", "find"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Two short bursts are against no variable, yet are more than noise.
#[test]
fn nowhere_is_said_at_the_floor_alone() {
    let folder = tempfile::tempdir().unwrap();
    let found_with = |burst_um: f64| {
        let burst = |i: u32| if matches!(i, 50..53 | 150..153) { burst_um } else { 0.0 };
        let row = |i: u32| [5.0 * f64::from(i), f64::from(i * 37 % 101), burst(i) + scatter(i)];
        of_x(folder.path(), (0..300).map(row));
        found_first(folder.path())
    };
    let said = found_with(0.0);
    assert!(said.contains("nowhere"), "{said}");
    for burst_um in [3.0, 10.0] {
        let said = found_with(burst_um);
        assert!(!said.contains("nowhere") && said.contains("error.x against"), "{burst_um} µm: {said}");
    }
}

/// A drift, a wave and errors that repeat at targets are found; noise is not.
#[test]
fn the_first_stage_finds_time_period_and_place() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let find = || found_first(folder.path());
    let time = |i: u32| 60.0 * f64::from(i);
    let place = |i: u32| f64::from(i % 60) * 7.3;
    // A slow drift: three of its blocks are the whole run.
    of_x(folder.path(), (0..300).map(|i| [time(i), place(i), 4.0 * (time(i) / 6000.0).sin() + scatter(i)]));
    let said = find();
    assert!(said.contains("error.x against time"), "{said}");
    // A screw's wave, with many periods over the travel.
    let wave = |p: f64| 0.6 * (std::f64::consts::TAU * p / 11.0).sin();
    of_x(
        folder.path(),
        (0..300).map(|i| [time(i), place(i) + 0.01 * scatter(7 * i), wave(place(i)) + scatter(i)]),
    );
    let said = find();
    assert!(said.contains("error.x against position.x"), "{said}");
    // Another error at each target, up and down from one to the next.
    let target = |i: u32| 30.0 * f64::from(i % 30);
    of_x(folder.path(), (0..300).map(|i| [time(i), target(i), 1.5 * scatter(1000 + i % 30) + scatter(i)]));
    let said = find();
    assert!(said.contains("error.x against position.x"), "{said}");
    // In noise, something is found as often as the stated rate allows.
    let noise = |seed: u32, i: u32| scatter(10_000 * (seed + 1) + i);
    let somewhere = (0..20).filter(|seed| {
        of_x(folder.path(), (0..300).map(|i| [time(i), place(i), noise(*seed, i)]));
        !find().contains("nowhere")
    });
    assert!(somewhere.count() <= 3);
}

/// A clear reversal in Z is named, even if X has an error without a name.
#[test]
fn an_unknown_in_x_hides_no_reversal_in_z() {
    let folder = tempfile::tempdir().unwrap();
    let rows = (0..240)
        .map(|i| {
            let (t, p) = (5.0 * f64::from(i), f64::from(i % 24) * 10.0);
            // Up through the targets and down again.
            let up = i / 24 % 2 == 0;
            let z = if up { p } else { 230.0 - p };
            let dir = if up { 1.0 } else { -1.0 };
            let saw = 8.0 * ((f64::from(i) / 90.0).fract() - 0.5) + scatter(i);
            format!("{t},{z},{dir},{saw:.4},{:.4}\n", 3.0 * dir + scatter(5000 + i))
        })
        .collect::<Vec<_>>()
        .concat();
    std::fs::write(folder.path().join("run.csv"), format!("t,z,dir,ex,ez\n{rows}")).unwrap();
    let columns = "[columns]\nt = { role = \"time\", unit = \"s\" }\nz = { role = \"position.z\", unit = \"mm\" }\n\
                   dir = { role = \"direction.z\", unit = \"1\" }\nex = { role = \"error.x\", unit = \"um\" }\n\
                   ez = { role = \"error.z\", unit = \"um\" }\n";
    std::fs::write(
        folder.path().join("run.run.toml"),
        format!("file = \"run.csv\"\nkind = \"positioning\"\n{columns}"),
    )
    .unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    let document = reconciled(folder.path());
    let reversal = document["effects"].as_array().unwrap().iter().find(|e| e["name"] == "reversal.z");
    let um = reversal.and_then(|e| e["parameters"]["um"]["value"].as_f64());
    assert!(um.is_some_and(|um| (um - 6.0).abs() < 0.5), "{document}");
}

/// The verdict on `run.run.toml` with `machine.toml` in a folder.
fn reconciled(folder: &std::path::Path) -> serde_json::Value {
    let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .args(["reconcile", "run.run.toml", "--model", "machine.toml", "--json"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// On a circle z² = r² − x²: a bow in Z is also a curve over X.
/// Neither is named without the other.
#[test]
fn a_bow_told_by_a_circle_has_its_rival() {
    // For any scatter.
    for scatter_um in [3.0, 1.0, 0.4] {
        bow_on_a_circle(scatter_um);
    }
}

fn bow_on_a_circle(scatter_um: f64) {
    let folder = tempfile::tempdir().unwrap();
    let (radius_mm, n) = (150.0, 360);
    let rows = (0..2 * n)
        .map(|i| {
            let way = if i < n { 1.0 } else { -1.0 };
            let (sin, cos) = (way * std::f64::consts::TAU * f64::from(i % n) / f64::from(n)).sin_cos();
            let um = 12.0 * sin * sin + scatter_um * scatter(i);
            let dirs = [-sin * way, cos * way].map(|v| if v > 0.0 { 1 } else { -1 });
            let (x, z, t) = (radius_mm * cos, radius_mm * sin, 0.1 * f64::from(i));
            format!("{t:.1},{x:.4},{z:.4},{},{},{um:.4}\n", dirs[0], dirs[1])
        })
        .collect::<Vec<_>>()
        .concat();
    std::fs::write(folder.path().join("run.csv"), format!("t,x,z,dx,dz,ex\n{rows}")).unwrap();
    let columns = "[columns]\nt = { role = \"time\", unit = \"s\" }\nx = { role = \"position.x\", unit = \"mm\" }\n\
                   z = { role = \"position.z\", unit = \"mm\" }\ndx = { role = \"direction.x\", unit = \"1\" }\n\
                   dz = { role = \"direction.z\", unit = \"1\" }\nex = { role = \"error.x\", unit = \"um\" }\n";
    let sidecar = format!("file = \"run.csv\"\nkind = \"plate\"\n{columns}");
    std::fs::write(folder.path().join("run.run.toml"), sidecar).unwrap();
    std::fs::write(folder.path().join("machine.toml"), "name = \"m\"\n").unwrap();
    let document = reconciled(folder.path());
    assert_eq!(document["verdict"], "not_separable", "{document}");
    let effects = document["effects"].as_array().unwrap();
    let rivals = effects.iter().flat_map(|e| e["alternatives"].as_array().unwrap());
    let mut names: Vec<&str> = effects.iter().chain(rivals).filter_map(|e| e["name"].as_str()).collect();
    names.sort_unstable();
    assert_eq!(names, ["position_map.x", "straightness.x.z"], "{document}");
}

/// The evidence for and against one name.
/// Cases: a name in the answer, a name next to it, one that no record shows. A name that is no effect is
/// refused.
#[test]
fn why_gives_the_evidence_for_and_against_one_name() {
    let folder = tempfile::tempdir().unwrap();
    warm_up(folder.path());
    let why = |name: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "run.run.toml", "--model", "machine.toml", "--why", name])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = [output.stdout, output.stderr].map(|t| String::from_utf8(t).unwrap()).concat();
        (output.status.code(), said)
    };
    let (code, said) = why("warm_up.z");
    assert_eq!(code, Some(0), "{said}");
    assert!(said.starts_with("warm_up.z: in the answer\n"), "{said}");
    for expected in ["to 1  the rows with warm_up.z", "% of its place", "to see"] {
        let spaced = said.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            spaced.contains(&expected.split_whitespace().collect::<Vec<_>>().join(" ")),
            "{expected}: {said}"
        );
    }
    let (code, said) = why("reversal.z");
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.starts_with("reversal.z: not in the answer\n") && said.contains("it needs direction.z"),
        "{said}"
    );
    let (code, said) = why("warm_op.z");
    assert_eq!(code, Some(2), "{said}");
    assert!(said.contains("warm_up"), "the nearest name: {said}");
}

#[test]
fn recorder_options_without_a_live_run_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    warm_up(folder.path());
    for (option, value) in
        [("--duration", "3s"), ("--feed", "localhost:1"), ("--kind", "drift"), ("--period", "1")]
    {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "run.run.toml", "--model", "machine.toml", "--out", "found", option, value])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(&format!("{option} without --live")), "{said}");
        assert!(!folder.path().join("found").exists());
    }
}

/// A result that would replace the model is refused before the work.
/// It is also refused before a run is recorded for it.
#[test]
fn a_result_in_the_place_of_the_model_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    warm_up(folder.path());
    std::fs::create_dir(folder.path().join("found")).unwrap();
    std::fs::rename(folder.path().join("machine.toml"), folder.path().join("found/model.toml")).unwrap();
    let reconcile = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_rtecctl"))
            .args(["reconcile", "--model", "found/model.toml", "--out", "found"])
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    // The record does not exist, so reading it would give that error instead.
    for arguments in [["none.run.toml"].as_slice(), &["--live", "new.run.toml", "--duration", "1"]] {
        let (code, said) = reconcile(arguments);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains("found/model.toml: found a file that this command reads"), "{said}");
    }
    // Files that this stage does not write cannot collide.
    assert_eq!(reconcile(&["run.run.toml", "--stage", "find"]), (Some(0), String::new()));
}
