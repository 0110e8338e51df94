//! Signals, drawings and axes of another kind.

use super::{Run, column, inputs, run, words};

#[test]
fn a_dead_channel_is_named_and_nothing_inserted() {
    let folder = inputs();
    let played = run(folder.path(), &words("replay --trace b-broken.csv --requests forty.csv --json"));
    assert_eq!(played.exit, 4, "{}", played.err);
    assert_eq!((played.figure("/insertions"), played.figure("/completed")), (0.0, 0.0));
    assert!(played.says("channel dead") && played.says("channel_dead"), "{}{}", played.out, played.err);
    assert!(played.says("B does not change after"), "{}", played.err);
}

#[test]
fn unrelated_signals_do_not_stop_a_reader() {
    let folder = inputs();
    let played = run(folder.path(), &words("replay --trace ghdl.vcd --requests forty.csv --json"));
    assert_eq!(played.figure("/counts_in"), 28.0);
    let played =
        run(folder.path(), &words("replay --trace ghdl-undefined-at-0.vcd --requests forty.csv --json"));
    assert_eq!((played.exit, played.figure("/counts_in")), (0, 28.0), "{}", played.err);
    assert!(played.says("the level of a and b is unknown before #3000000000"), "{}", played.err);
    // A pin of another type next to the two that are wanted.
    let samples: String = (0..30).map(|i| format!("{}.5 TRUE 0x1f {} \n", i, 2 * i)).collect();
    std::fs::write(folder.path().join("hal.txt"), samples).unwrap();
    let line = "characterise import hal.txt --format halsampler --period-s 0.001 --columns 1=position.x,4=error.x --out h.run.toml";
    let imported = run(folder.path(), &words(line));
    assert_eq!(imported.exit, 0, "{}", imported.err);
    assert_eq!(column(folder.path(), "h.csv", "4")[29], 58.0);
    // Lines of another program before the names; its own keys and comments.
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

/// Rotary axes are refused by name wherever one can be named.
/// These are records, imports, plans, models and fits.
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
        "model export --machine m.toml --axis c --from 0 --to 10 --out t.txt",
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
