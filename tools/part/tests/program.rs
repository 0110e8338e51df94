//! The NC probing program.
//! The tests cover parameters, comments, order of the first moves and units. LinuxCNC's own interpreter runs
//! a program.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_part::contour::{Contour, Segment};
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{PathPoint, PathPointRole, ProbeGeometry, ProbingPlan};
use rtec_part::probing_program::{BUILT_IN, DialectWithTemplate, ProbingProgramInputs, VariableValues};
use std::path::Path;
use std::process::Command;

fn records() -> Vec<PathPoint> {
    let nose = Segment::Arc {
        centre: Zx::new(127.0, 0.0),
        radius_mm: 38.1,
        start_rad: 0.0,
        sweep_rad: std::f64::consts::FRAC_PI_2,
    };
    let part = Contour::new(vec![(nose, "ARC".to_owned())], false);
    let mut plan =
        ProbingPlan::new(ProbeGeometry { tip_mm: 2.5, stand_off_mm: 5.0, over_travel_mm: 2.5, stem: None });
    plan.add_number(&part, 0, 20, 0.0);
    plan.points[7].bypass = vec![Zx::new(165.0, 40.0)];
    plan.records()
}

fn text(name: &str, unit: LengthUnit, comments: bool, set: &[(&str, &str)]) -> String {
    let controller = DialectWithTemplate::built_in(name).unwrap().unwrap();
    let mut parameters = VariableValues::default();
    for (name, value) in set {
        parameters.set(name, value).unwrap();
    }
    let records = records();
    let made = "2026-11-21 10:00 UTC";
    ProbingProgramInputs {
        controller: &controller,
        parameters: &parameters,
        records: &records,
        unit,
        comments,
        made,
    }
    .text(Path::new(name))
    .unwrap()
}

/// The words of a block, as letter and value.
fn words(line: &str) -> Vec<(char, f64)> {
    line.split_whitespace()
        .take_while(|w| !w.starts_with(['!', '(']))
        .filter_map(|w| Some((w.chars().next()?, w[1..].parse().ok()?)))
        .collect()
}

fn word(line: &str, letter: char) -> Option<f64> {
    words(line).iter().find(|w| w.0 == letter).map(|w| w.1)
}

#[test]
fn the_segment_is_named_and_labelled_as_the_report_does() {
    let mut parameters = VariableValues::default();
    parameters.set("part", "6304").unwrap();
    assert_eq!(parameters.file_name(), "pt6304s2.dnc");
    let program = text("report", LengthUnit::MM, true, &[("part", "6304"), ("segment", "4"), ("tool", "7")]);
    assert!(program.starts_with("N0010 (ID, PROG, 6304s4, PART SEG4: GAUGING 2)"), "{program}");
    assert!(program.contains("T0700 "), "tool and offset number");
    assert!(program.contains("2026-11-21 10:00 UTC"));
    for (name, value) in [
        ("segment", "3"),
        ("part", "63"),
        ("feed", "fast"),
        ("note_1", "a (bracket)"),
        ("tool", "123"),
        ("colour", "red"),
    ] {
        assert!(parameters.set(name, value).is_err(), "{name} = {value}");
    }
    assert!(parameters.set("note_2", &"x".repeat(67)).is_err());
}

#[test]
fn lengths_nobody_gave_are_in_the_programs_unit_and_positions_are_asked_for_by_template() {
    let unset = |name: &str, set: &[(&str, &str)]| {
        let mut parameters = VariableValues::in_unit(LengthUnit::INCH);
        for (name, value) in set {
            parameters.set(name, value).unwrap();
        }
        parameters.unset(&DialectWithTemplate::built_in(name).unwrap().unwrap().template).collect::<Vec<_>>()
    };
    assert_eq!(unset("report", &[]), ["probing_start_z", "reference_z", "reference_x", "clear_z"]);
    assert_eq!(unset("linuxcnc", &[]), ["probing_start_z"], "its template asks for no other");
    assert!(unset("fanuc", &[("probing_start_z", "3")]).is_empty());
    let controller = DialectWithTemplate::built_in("report").unwrap().unwrap();
    let (parameters, records) = (VariableValues::in_unit(LengthUnit::INCH), records());
    let (unit, made) = (LengthUnit::INCH, "");
    let job = ProbingProgramInputs {
        controller: &controller,
        parameters: &parameters,
        records: &records,
        unit,
        comments: true,
        made,
    };
    let program = job.text(Path::new("template.prb")).unwrap();
    assert!(
        program.contains("TIP DIAMETER 0.1969, FEED 98.4252") && program.contains("MDI W0.7874"),
        "{program}"
    );
}

#[test]
fn every_dialect_moves_z_first_then_x_and_touches_every_point() {
    for (name, ..) in BUILT_IN {
        for unit in [LengthUnit::MM, LengthUnit::INCH] {
            let program = text(name, unit, true, &[]);
            let controller = DialectWithTemplate::built_in(name).unwrap().unwrap();
            let diameter = if controller.dialect.x_is_diameter { 2.0 } else { 1.0 };
            let first: Vec<&str> = program.lines().filter(|l| l.contains("ONLY")).collect();
            let start = records()[0].at;
            // Half of the last decimal: 3 decimals in mm, 4 in inches.
            let near = |a: f64, b: f64| (a - b).abs() <= if unit == LengthUnit::MM { 6e-4 } else { 6e-5 };
            assert!(near(word(first[0], 'Z').unwrap(), start.z / unit.0) && word(first[0], 'X').is_none());
            assert!(near(word(first[1], 'X').unwrap(), start.x * diameter / unit.0));
            assert!(word(first[1], 'Z').is_none());
            let touches: Vec<&str> = program.lines().filter(|l| l.contains("TOUCH POINT")).collect();
            assert_eq!(touches.len(), 20, "{name}");
            assert!(touches.iter().all(|l| word(l, 'F') == Some(2500.0)), "{name}");
            let targets = records().into_iter().filter(|r| matches!(r.role, PathPointRole::Touch(_)));
            for (line, r) in touches.iter().zip(targets) {
                assert!(near(word(line, 'X').unwrap(), r.at.x * diameter / unit.0), "{name} {line}");
            }
            assert!(program.contains("BY-PASS"));
            // Block numbers ascend without repetition.
            let blocks: Vec<f64> = program.lines().filter_map(|l| word(l, 'N')).collect();
            assert!(blocks.len() > 60 && blocks.windows(2).all(|w| w[0] < w[1]), "{name}: {blocks:?}");
            let other =
                if unit == LengthUnit::MM { &controller.dialect.inch } else { &controller.dialect.mm };
            assert!(!program.split_whitespace().any(|w| w == other), "{name}");
        }
    }
}

#[test]
fn minimal_comments_make_a_smaller_file_with_the_same_moves() {
    for (name, ..) in BUILT_IN {
        let (full, minimal) = (text(name, LengthUnit::MM, true, &[]), text(name, LengthUnit::MM, false, &[]));
        assert!(minimal.len() * 4 < full.len() * 3, "{name}: {} of {}", minimal.len(), full.len());
        let code = |t: &str| -> Vec<Vec<(char, f64)>> { t.lines().map(words).collect() };
        assert_eq!(code(&full), code(&minimal), "{name}");
        assert!(minimal.contains("TIP DIAMETER 5"), "the header's notes stay");
    }
}

#[test]
fn a_template_that_asks_for_the_unknown_is_named() {
    let mut controller = DialectWithTemplate::built_in("report").unwrap().unwrap();
    let (parameters, records) = (VariableValues::default(), records());
    for (template, line, column) in [
        ("N0010 X\nN0020 $99\n$21\n", 2, 7),
        ("N0010 @77\n$21\n", 1, 7),
        ("N0010 $\n$21\n", 1, 7),
        ("N0010 @5\n$21\n", 1, 7),
        ("N0010\n", 0, 0),
    ] {
        controller.template = template.to_owned();
        let job = ProbingProgramInputs {
            controller: &controller,
            parameters: &parameters,
            records: &records,
            unit: LengthUnit::MM,
            comments: true,
            made: "",
        };
        let e = job.text(Path::new("template.prb")).unwrap_err();
        assert_eq!((e.line, e.column), (line, column), "{template:?}: {e}");
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("p.toml");
    for (bad, line) in [("feed = 100\npart = \"1\"\n", 2), ("x = \n", 1), ("feed = [1]\n", 1)] {
        std::fs::write(&file, bad).unwrap();
        assert_eq!(VariableValues::default().read(&file).unwrap_err().line, line, "{bad:?}");
    }
    std::fs::write(&file, "nam = \"fanuc\"\n").unwrap();
    assert!(DialectWithTemplate::read(&file, &file).unwrap_err().line == 1);
}

/// LinuxCNC's interpreter runs the program; its canonical moves equal the path.
#[test]
fn linuxcnc_runs_its_dialect() {
    if !test_needs::installed("rs274", "linuxcnc-uspace") {
        return;
    }
    for unit in [LengthUnit::MM, LengthUnit::INCH] {
        let folder = tempfile::tempdir().unwrap();
        let (program, tools, vars) =
            (folder.path().join("pt0101s2.ngc"), folder.path().join("t.tbl"), folder.path().join("v.var"));
        std::fs::write(&program, text("linuxcnc", unit, true, &[("probing_start_z", "300")])).unwrap();
        std::fs::write(&tools, "T1 P1 Z0 D0\n").unwrap();
        std::fs::write(&vars, "").unwrap();
        let output = Command::new("rs274")
            .args(["-g", "-t"])
            .arg(&tools)
            .arg("-v")
            .arg(&vars)
            .arg(&program)
            .output()
            .unwrap();
        let canon = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{canon}{}", String::from_utf8_lossy(&output.stderr));
        // "   58 N0230  STRAIGHT_PROBE(5.123, 0.0, 130.2, 0, …)"; x, y, z in the program's unit
        let moves: Vec<(&str, Zx)> = canon
            .lines()
            .filter_map(|l| {
                let (kind, values) = l.split_once("STRAIGHT_")?.1.split_once('(')?;
                let values: Vec<f64> =
                    values.split([',', ')']).filter_map(|v| v.trim().parse().ok()).collect();
                Some((kind, Zx::new(*values.get(2)?, *values.first()?) * unit.0))
            })
            .collect();
        for (kind, role) in [("PROBE", PathPointRole::Touch(0)), ("FEED", PathPointRole::Finish)] {
            let got: Vec<Zx> = moves.iter().filter(|m| m.0 == kind).map(|m| m.1).collect();
            let same = |r: &&PathPoint| std::mem::discriminant(&r.role) == std::mem::discriminant(&role);
            let records = records();
            let wanted: Vec<Zx> = records.iter().filter(same).map(|r| r.at).collect();
            assert_eq!((got.len(), wanted.len()), (20, 20), "{kind}:\n{canon}");
            for (got, want) in got.iter().zip(&wanted) {
                // The interpreter prints four decimals.
                assert!((*got - *want).norm() < 1e-4 * unit.0, "{got:?} {want:?}");
            }
        }
    }
}
