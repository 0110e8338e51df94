//! `model export`: tables read back and applied by another program.
//! Also spacing, limits, and all refusals.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// A 10 mm screw that 50 mm steps cannot show, a map's corner, reversal and heat.
const MACHINE: &str = r#"
name = "screw"
effect = [
    { name = "offset.x", um = 3.0 },
    { name = "scale.x", ppm = 30.0 },
    { name = "screw_periodic.x", um = 4.0, period_mm = 10.0, phase_rad = 0.5 },
    { name = "position_map.x", knots_mm = [-200.0, -40.0, 130.0, 300.0], um = [0.0, 6.0, -5.0, 2.0] },
    { name = "reversal.x", um = 6.0 },
    { name = "thermal_growth.x", sensor = "T1", um_per_K = 1.5 },
    { name = "scale.y", ppm = 12.0 },
    { name = "coolant.y", um = 3.0 },
]
"#;

fn rtecctl(dir: &Path, words: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl"))
        .current_dir(dir)
        .args(words.split_whitespace())
        .output()
        .unwrap()
}

fn export(dir: &Path, words: &str) -> (Value, String) {
    let out = rtecctl(dir, &format!("model export --machine m.toml --json {words}"));
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{words}: {said}");
    (crate::document(&out.stdout), said)
}

fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("m.toml"), MACHINE).unwrap();
    dir
}

/// The judge's verdict on a table; `None` without Python 3.11.
fn judged(dir: &Path, words: &str) -> Option<(bool, String)> {
    let judge = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/judges/tables.py");
    if !test_needs::python("tomllib", "python3, 3.11 or later") {
        return None;
    }
    let out = Command::new(test_needs::PYTHON)
        .arg(judge)
        .args(words.split_whitespace())
        .current_dir(dir)
        .output()
        .unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    Some((out.status.success(), said))
}

/// An effect of heat is in the table at one temperature, which is reported.
#[test]
fn the_temperatures_that_a_table_holds_at_are_said() {
    let dir = folder();
    let words = "--axis x --from 0 --to 300 --format csv --out t.csv";
    let (document, said) = export(dir.path(), words);
    assert!(said.contains("it holds at these temperatures: T1 20 degC"), "{said}");
    assert_eq!(document["temperatures_degC"]["T1"], 20.0);
    let (_, said) = export(dir.path(), &format!("{words} --temperatures T1=31.5"));
    assert!(said.contains("it holds at these temperatures: T1 31.5 degC"), "{said}");
    let (document, said) = export(dir.path(), &words.replace("--axis x", "--axis y"));
    assert!(
        !said.contains("temperatures") && document["temperatures_degC"].as_object().unwrap().is_empty(),
        "{said}"
    );
}

/// A table knows position and direction, but not the travel since the axis turned.
#[test]
fn what_a_table_cannot_hold_is_said() {
    let dir = folder();
    let spike = "{ name = \"reversal_spike.x\", um = 8.0, length_mm = 1.0 },\n]";
    std::fs::write(dir.path().join("m.toml"), MACHINE.replace("\n]", &format!("\n{spike}"))).unwrap();
    let (document, _) = export(dir.path(), "--axis x --from 0 --to 300 --format csv --out t.csv");
    let warnings = document["warnings"].to_string();
    assert!(
        warnings.contains("reversal_spike.x: the table holds its value far from where the axis turned"),
        "{warnings}"
    );
}

/// Regression: it was in the table as its value at angle 0.
#[test]
fn an_effect_over_an_angle_is_not_in_the_table() {
    let dir = folder();
    let law = "[[law]]\nname = \"bend\"\nnaming = \"A\"\nacts_on = \"error\"\nlaw = \"a line over angle\"\ncause = \"unknown\"\n\
               experiment = \"a circle\"\nparameters = [{ name = \"um\", unit = \"um\", terms = [{ cos = 1 }] }]\n";
    std::fs::write(dir.path().join("own.toml"), law).unwrap();
    let words = "--axis y --from 0 --to 300 --format csv --out t.csv";
    let table = || std::fs::read_to_string(dir.path().join("t.csv")).unwrap();
    export(dir.path(), words);
    let without = table();
    let bend = "\ndictionary = \"own.toml\"\neffect = [\n    { name = \"bend.y\", um = 40.0 },";
    std::fs::write(dir.path().join("m.toml"), MACHINE.replace("\neffect = [", bend)).unwrap();
    let (_, said) = export(dir.path(), words);
    assert_eq!(table(), without);
    assert!(
        said.contains("bend.y: is over the angle of a circle") && said.contains("it is not in the table"),
        "{said}"
    );
}

const FORMATS: [(&str, &str); 6] = [
    ("linuxcnc0", "--format linuxcnc"),
    ("linuxcnc1", "--format linuxcnc-type1"),
    ("linuxcnc0,inch", "--format linuxcnc --unit inch"),
    ("linuxcnc1,inch", "--format linuxcnc-type1 --unit inch"),
    ("ssfk", "--format ssfk --axis-number 1"),
    ("siemens", "--format siemens --axis-name X1 --reference-mm 12.5 --max-points 800"),
];

#[test]
fn every_table_leaves_what_was_said_by_another_programs_reading() {
    if !test_needs::long() {
        return;
    }
    let dir = folder();
    for (judge, flags) in test_needs::repetitions(FORMATS) {
        for (range, limit) in [("--from -100 --to 100", 0.5), ("--from -7.5 --to 31", 0.1)] {
            let words = format!("--axis x {range} --temperatures T1=24 --limit-um {limit} --out t {flags}");
            let (said, text) = export(dir.path(), &words);
            println!("{judge} {range}: {text}");
            assert!(said["between_um"].as_f64().unwrap() <= limit, "{judge}: {said}");
            let left = said["max_up_um"].as_f64().unwrap();
            if judge == "siemens" {
                assert!((left - 3.0).abs() < limit, "half the reversal stays: {said}");
                assert!(text.contains("one value serves both directions"), "{text}");
            } else {
                assert!(left <= limit && said["warnings"] == Value::Array(vec![]), "{said}");
            }
            std::fs::write(dir.path().join("said.json"), said.to_string()).unwrap();
            let words = format!("{judge} t m.toml said.json --axis x --at T1=24 --reference 12.5");
            let Some((good, verdict)) = judged(dir.path(), &words) else { return };
            assert!(good, "{judge} {range}: {verdict}");
            // A comment before the table, and a value that is off by five micrometres, are both found.
            let table = std::fs::read_to_string(dir.path().join("t")).unwrap();
            let mut lines: Vec<String> = table.lines().map(str::to_owned).collect();
            let middle =
                lines.iter().position(|l| l.contains("].pos") || l.contains("ENC_COMP[0,2,")).unwrap_or(1);
            let (head, last) = lines[middle].rsplit_once(['=', ' ']).unwrap();
            let by = if judge == "ssfk" {
                50.0
            } else if judge.ends_with("inch") {
                0.005 / 25.4
            } else {
                0.005
            };
            let between = &lines[middle][head.len()..=head.len()];
            let off: f64 = last.parse::<f64>().unwrap() + by;
            lines[middle] = format!("{head}{between}{off:.*}", if judge == "ssfk" { 0 } else { 9 });
            std::fs::write(dir.path().join("t"), lines.join("\n") + "\n").unwrap();
            let (good, verdict) = judged(dir.path(), &words).unwrap();
            assert!(!good && verdict.contains("um left, said"), "{judge}: {verdict}");
            std::fs::write(dir.path().join("t"), format!("# a table\n{table}")).unwrap();
            assert!(!judged(dir.path(), &words).unwrap().0, "{judge}");
        }
    }
}

/// The table reports positions beyond a map's knots or beyond the fit's records.
/// The axis's error is not known there.
#[test]
fn a_table_beyond_what_is_known_is_said() {
    let dir = folder();
    let said = |range: &str| export(dir.path(), &format!("--axis x {range} --out e.csv --format csv")).1;
    assert!(said("--from -300 --to 600").contains("position_map.x has values from -200 to 300 mm"));
    assert!(!said("--from -200 --to 300").contains("position_map.x has"));
    let fit = "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 0.1\n\
               half_width_um = 0.2\nat_mm = { x = [11.0, 489.0] }\n[[effect]]\nname = \"scale.x\"\nppm = 25.0\n";
    std::fs::write(dir.path().join("m.toml"), fit).unwrap();
    assert!(said("--from -2000 --to 2000").contains("no record has shown what the axis does there"));
    assert!(!said("--from 0 --to 500").contains("no record has shown"));
}

#[test]
fn a_screw_is_not_stepped_over() {
    let dir = folder();
    let (chosen, _) = export(dir.path(), "--axis x --from 0 --to 200 --out a.comp");
    assert!(
        chosen["step_mm"].as_f64().unwrap() <= 2.0 && chosen["points"].as_u64().unwrap() > 100,
        "{chosen}"
    );
    // Steps of whole turns of the screw: every point has the same phase, so only a constant remains.
    let (given, said) = export(dir.path(), "--axis x --from 0 --to 200 --step 50 --out b.comp");
    assert!(given["max_up_um"].as_f64().unwrap() > 4.0 && given["points"] == 5, "{given}");
    assert!(said.contains("more than the limit of 0.5 um: a smaller --step, or none"), "{said}");
    // More than 256 points would be needed: the best possible table, with the warning.
    let (long, said) = export(dir.path(), "--axis x --from 0 --to 2000 --out c.comp");
    assert!(
        long["points"].as_u64().unwrap() <= 256 && said.contains("the format takes no more positions"),
        "{said}"
    );
    // A straight line needs only its ends.
    let (line, said) = export(dir.path(), "--axis y --from 0 --to 640 --out d.comp");
    assert_eq!(line["points"], 2, "{line}");
    assert!(said.contains("coolant.y: the table holds its value without coolant"), "{said}");
    // The table reaches the end of the travel.
    let (uneven, _) = export(dir.path(), "--axis y --from 0 --to 95 --step 10 --out e.comp");
    assert_eq!((uneven["points"].as_u64(), uneven["to_mm"].as_f64()), (Some(11), Some(100.0)));
}

#[test]
fn a_form_of_ones_own_is_written_as_it_says() {
    let dir = folder();
    let form = "header = \"AXIS {axis} {{{points}}}\\n\"\nline = \"{n};{position};{forward};{reverse}\"\nfooter = \"END {first} {last} {step}\\n\"\n\
                value = \"correction\"\nvalue_unit = \"um\"\nposition_unit = \"mm\"\nposition_decimals = 1\nvalue_decimals = 2\n\
                max_points = 40\nfirst_index = 1\ndecimal_comma = true\nline_end = \"crlf\"\n";
    let path = dir.path().join("form.toml");
    std::fs::write(&path, form).unwrap();
    let words = "--axis y --from 0 --to 20 --step 10 --out y.txt --format own --form form.toml";
    export(dir.path(), words);
    let text = std::fs::read_to_string(dir.path().join("y.txt")).unwrap();
    assert_eq!(
        text,
        "AXIS y {3}\r\n1;0,0;0,00;0,00\r\n2;10,0;-0,12;-0,12\r\n3;20,0;-0,24;-0,24\r\nEND 0,0 20,0 10,0\r\n"
    );
    // One value for both directions, zero at the reference, in inches.
    let mean = "line = \"{position} {mean}\"\nvalue = \"error\"\nvalue_unit = \"inch\"\nposition_unit = \"inch\"\nposition_decimals = 6\n\
                value_decimals = 9\nmax_points = 9\nzero_at_reference = true\n";
    std::fs::write(&path, mean).unwrap();
    export(
        dir.path(),
        "--axis x --from 0 --to 50.8 --step 25.4 --reference-mm 25.4 --out y.txt --format own --form form.toml",
    );
    let text = std::fs::read_to_string(dir.path().join("y.txt")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().map(|l| l.split(' ').map(|w| w.parse().unwrap()).collect()).collect();
    assert_eq!(rows.iter().map(|r| r[0]).collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
    assert_eq!(rows[1][1], 0.0);
    // At 25.4 mm: the scale of 30 ppm, the map that falls by 11 µm over 170 mm, and the screw.
    let screw = |p: f64| 4.0 * (std::f64::consts::TAU * p / 10.0 + 0.5).sin();
    let expected = (30.0 * 25.4 / 1000.0 - 11.0 / 170.0 * 25.4 + screw(50.8) - screw(25.4)) / 25_400.0;
    assert!((rows[2][1] - expected).abs() < 2e-9, "{} against {expected}", rows[2][1]);
    for (from, to, line, column, found) in [
        ("{mean}", "{middle}", 1, 8, "{middle}"),
        ("{mean}", "{mean} {forward}", 1, 8, "{forward}"),
        ("{mean}", "{mean", 1, 8, "a brace alone"),
        ("value = \"error\"", "value = \"deviation\"", 2, 9, "deviation"),
        ("\"inch\"\nposition_unit", "\"feet\"\nposition_unit", 3, 14, "feet"),
        ("position_decimals = 6", "position_decimals = 60", 5, 21, "60"),
        ("max_points = 9", "max_points = 1", 7, 14, "max_points = 1"),
        ("max_points = 9\n", "", 1, 1, "no max_points"),
        ("zero_at", "zero_on", 8, 1, "unknown key zero_on_reference"),
    ] {
        std::fs::write(&path, mean.replacen(from, to, 1)).unwrap();
        let words = "model export --machine m.toml --axis x --from 0 --to 50.8 --out z.txt --format own --form form.toml";
        let out = rtecctl(dir.path(), words);
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{to}: {said}");
        assert!(
            said.contains(&format!("form.toml:{line}:{column}: found")) && said.contains(found),
            "{to}: {said}"
        );
        assert!(!dir.path().join("z.txt").exists());
    }
}

#[test]
fn bad_values_are_named_and_nothing_is_written() {
    let dir = folder();
    let good = "--axis x --from 0 --to 100";
    for (words, named) in [
        ("--axis q --from 0 --to 100", "--axis q, expected an axis that the model has errors of: x, y"),
        ("--axis X --from 0 --to 100", "did you mean x?"),
        ("--axis x --from 0 --to 1e300", "a range that rises, within 100000 mm"),
        ("--axis x --from -1e300 --to 1e300 --step 1", "a range that rises"),
        ("--axis x --from 5 --to 5", "a range that rises"),
        ("--axis x --from nan --to 5", "a range that rises"),
        (&format!("{good} --step 0"), "a step of at least"),
        (&format!("{good} --step nan"), "a step of at least"),
        (&format!("{good} --step -1"), "a step of at least"),
        (&format!("{good} --step 1e-5"), "at most 256 points, that is a --step of at least 0.3922 mm"),
        (&format!("{good} --limit-um 0"), "a limit above 0 um"),
        (&format!("{good} --limit-um nan"), "a limit above 0 um"),
        (&format!("{good} --max-points 300"), "from 2 to 256"),
        (
            &format!("{good} --temperatures T1=nan"),
            "--temperatures T1=NaN, expected a temperature from -100 to 200",
        ),
        (&format!("{good} --temperatures T1=1e300"), "a temperature from -100 to 200"),
        (&format!("{good} --temperatures T9=20"), "a sensor of the model: T1"),
        (&format!("{good} --temperatures T1"), "SENSOR=degC"),
        (&format!("{good} --temperatures T1=20,T1=21"), "a second time"),
        (&format!("{good} --format ssfk --axis-number 0"), "logical axis number, from 1"),
        (&format!("{good} --format ssfk"), "--axis-number"),
        (&format!("{good} --format ssfk --axis-number 1 --unit inch"), "--unit inch"),
        (&format!("{good} --format siemens --axis-name X1"), "--reference-mm"),
        (
            &format!("{good} --format siemens --axis-name X1 --reference-mm 200"),
            "the reference point within the range",
        ),
        (&format!("{good} --format siemens --axis-name X1 --reference-mm nan"), "--reference-mm NaN"),
        (&format!("{good} --format siemens --axis-name X1; --reference-mm 0"), "--axis-name X1;"),
        (
            &format!("{good} --format siemens --axis-name X1 --reference-mm 0 --step 0.33335"),
            "multiples of 0.0001 mm",
        ),
        (&format!("{good} --format heidenhain"), "invalid value 'heidenhain'"),
    ] {
        let out = rtecctl(dir.path(), &format!("model export --machine m.toml {words} --out bad.comp"));
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{words}: {said}");
        assert!(said.contains(named), "{words}: {said}");
        assert!(!said.contains("panicked") && !dir.path().join("bad.comp").exists(), "{words}: {said}");
    }
}
