//! Positioning by ISO 230-2, against numpy and by hand.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_builders::column;
use rtec_measure::iso230::{
    PositioningOptions, PositioningResult, TestConditions, diagonals, positioning, positioning_with,
};
use rtec_model::record::{Column, Record, Role, RunKind};
use std::path::Path;
use std::process::Command;

fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 11) as f64 / (1_u64 << 53) as f64
}

/// Rows (target, direction) of so many cycles up and down these targets.
fn cycles(targets: &[f64], count: usize) -> Vec<(f64, f64)> {
    let up = targets.iter().map(|t| (*t, 1.0));
    let down = targets.iter().rev().map(|t| (*t, -1.0));
    let one: Vec<_> = up.chain(down).collect();
    std::iter::repeat_n(one, count).flatten().collect()
}

fn uneven(length_mm: f64, count: usize) -> Vec<f64> {
    let step = length_mm / (count - 1) as f64;
    (0..count).map(|k| k as f64 * step + 0.03 * step * ((k * 3) % 5) as f64).collect()
}

fn run(rows: &[(f64, f64)], error: impl FnMut((f64, f64)) -> f64) -> Record {
    let columns = vec![
        column("y", "position.y", rows.iter().map(|r| r.0).collect()),
        column("dir", "direction.y", rows.iter().map(|r| r.1).collect()),
        column("e", "error.y", rows.iter().copied().map(error).collect()),
    ];
    Record::new(Path::new("y.run.toml"), RunKind::Positioning, columns).unwrap()
}

fn noisy(rows: &[(f64, f64)]) -> Record {
    let mut state = 9;
    run(rows, |(p, way)| 0.02 * p + 5.0 * (p / 70.0).sin() + 2.0 * way + 3.0 * (uniform(&mut state) - 0.5))
}

const CONDITIONS: &str = "[uncertainty]\ndevice_um = 0.3\ndevice_um_per_m = 0.8\nmisalignment_mm = 1.5\nmachine_temperature_K = 0.4\n\
                          machine_ppm_per_K = 11.0\nmachine_expansion_ppm_per_K = 2.0\nmachine_off_20_K = 3.0\ndrift_um = 1.7\n\
                          set_up_um = 0.5\n";

#[test]
fn numpy_finds_the_same() {
    let record = noisy(&cycles(&uneven(800.0, 9), 5));
    let conditions = TestConditions::parse(Path::new("c.toml"), CONDITIONS).unwrap();
    let found =
        &positioning_with(&record, &PositioningOptions { conditions, ..PositioningOptions::default() })
            .unwrap()[0];
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("y.csv");
    std::fs::write(&csv, rtec_measure::run_record_files::to_csv(&record)).unwrap();
    let judge = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/judges/iso230_2.py");
    let stated = CONDITIONS.lines().skip(1).map(|l| l.replace(' ', ""));
    if !test_needs::python("numpy", "python3-numpy") {
        return;
    }
    let out = Command::new(test_needs::PYTHON)
        .arg(judge)
        .arg(csv)
        .args(["y", "dir", "e"])
        .args(stated)
        .output()
        .unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let out = String::from_utf8(out.stdout).unwrap();
    let number = |text: &str, key: &str| -> f64 {
        let at = text.find(&format!("\"{key}\": ")).unwrap() + key.len() + 4;
        text[at..].split([',', '}']).next().unwrap().trim().parse().unwrap()
    };
    let (figures, uncertainties) = out.split_once("\"U\"").unwrap();
    for (name, value) in found.figures() {
        let (got, want) = (value.unwrap(), number(figures, name));
        assert!((got - want).abs() < 1e-9, "{name}: {got} and {want}");
    }
    let u = found.uncertainty.as_ref().unwrap();
    for name in ["A", "E", "R", "R_up", "B", "M"] {
        let (got, want) = (u.of(name).unwrap(), number(uncertainties, name));
        // The judge takes the cosine error by the hypotenuse.
        assert!((got - want).abs() < 1e-5, "{name}: {got} and {want}");
    }
}

fn error_of(record: &Record) -> String {
    let e = positioning(record).unwrap_err();
    format!("{e}")
}

#[test]
fn one_way_refuses_two_sided_figures() {
    let rows: Vec<_> = cycles(&uneven(800.0, 9), 5).into_iter().filter(|r| r.1 > 0.0).collect();
    let record = noisy(&rows);
    let e = error_of(&record);
    assert!(e.contains("upwards only") && e.contains("--one-way"), "{e}");
    let found =
        &positioning_with(&record, &PositioningOptions { one_way: true, ..PositioningOptions::default() })
            .unwrap()[0];
    assert!(found.A_up.is_some() && found.E_up.is_some() && found.R_up.is_some());
    assert!([found.A, found.E, found.R, found.B, found.B_mean, found.M].iter().all(Option::is_none));
}

#[test]
fn a_direction_of_0_and_1_is_named() {
    let rows: Vec<_> =
        cycles(&uneven(800.0, 9), 5).into_iter().map(|(p, w)| (p, if w > 0.0 { 1.0 } else { 0.0 })).collect();
    let e = error_of(&noisy(&rows));
    assert!(e.contains("only 0 (45 rows) and +1 (45 rows)") && e.contains("stood for downwards"), "{e}");
    let rows: Vec<_> = rows.into_iter().map(|(p, _)| (p, 0.0)).collect();
    assert!(error_of(&noisy(&rows)).contains("0 in every row"));
}

#[test]
fn swapped_columns_are_named() {
    let right = noisy(&cycles(&uneven(800.0, 11), 5));
    let get = |name: &str| right.columns.iter().find(|c| c.name == name).unwrap().data.clone();
    let columns = vec![
        column("y", "position.y", get("e")),
        column("dir", "direction.y", get("dir")),
        column("e", "error.y", get("y")),
    ];
    let wrong = Record::new(Path::new("y.run.toml"), RunKind::Positioning, columns).unwrap();
    let e = error_of(&wrong);
    assert!(
        e.contains("look swapped") && e.contains("targets in 110 rows") && e.contains("11 values"),
        "{e}"
    );
}

fn warned(p: &PositioningResult, words: &str) -> bool {
    p.warnings.iter().any(|w| w.contains(words))
}

#[test]
fn the_standard_s_numbers_of_targets_and_approaches_are_asked_for() {
    let found = |mm: f64, targets: usize, count: usize| {
        positioning(&noisy(&cycles(&uneven(mm, targets), count))).unwrap().swap_remove(0)
    };
    let good = found(800.0, 9, 5);
    assert!(!warned(&good, "asks for"), "{:?}", good.warnings);
    assert!(warned(&found(1600.0, 7, 5), "asks for at least 9"));
    assert!(warned(&found(300.0, 4, 5), "asks for at least 5"));
    assert!(warned(&found(800.0, 9, 3), "five approaches"));
    let even: Vec<f64> = (0..9).map(|k| 100.0 * f64::from(k)).collect();
    assert!(warned(&positioning(&noisy(&cycles(&even, 5))).unwrap()[0], "equal distances of 100.0000 mm"));
}

/// On more than 2 m one approach from each side will do: E, B and M, but no A and R.
#[test]
fn a_long_axis_is_tested_its_own_way() {
    let long = &positioning(&noisy(&cycles(&uneven(3000.0, 14), 1))).unwrap()[0];
    assert!(long.test.contains("long axis") && long.E.is_some() && long.B.is_some() && long.M.is_some());
    assert!(long.A.is_none() && long.R.is_none() && long.R_up.is_none());
    assert!(!warned(long, "apart"), "{:?}", long.warnings);
    let sparse = &positioning(&noisy(&cycles(&uneven(3000.0, 9), 1))).unwrap()[0];
    assert!(warned(sparse, "at most 250 mm"), "{:?}", sparse.warnings);
    // A short axis takes two.
    assert!(error_of(&noisy(&cycles(&uneven(800.0, 9), 1))).contains("approached twice"));
}

/// Targets at the ends can be approached from inside only.
/// They count one-sided and are named.
#[test]
fn the_ends_of_the_travel_are_one_sided() {
    let targets = uneven(800.0, 9);
    let rows: Vec<_> = cycles(&targets, 5)
        .into_iter()
        .filter(|(p, w)| !((*p <= targets[0] && *w > 0.0) || (*p >= targets[8] && *w < 0.0)))
        .collect();
    let found = &positioning(&noisy(&rows)).unwrap()[0];
    assert!(warned(found, "2 targets approached from one side only"), "{:?}", found.warnings);
    assert_eq!(found.targets[0].mean_up, None);
}

#[test]
fn tilts_are_in_urad_and_arcsec() {
    let rows = cycles(&uneven(800.0, 9), 5);
    let mut columns = noisy(&rows).columns;
    columns[0] = column("x", "position.x", columns[0].data.clone());
    columns[1] = column("dir", "direction.x", columns[1].data.clone());
    let urad = columns[2].data.clone();
    columns[2] = column("rx", "angle_error.x.b", urad.clone());
    let record = |columns: &[Column]| {
        positioning(&Record::new(Path::new("t.run.toml"), RunKind::Positioning, columns.to_vec()).unwrap())
            .unwrap()
    };
    let as_urad = &record(&columns)[0];
    assert_eq!((as_urad.response.as_str(), as_urad.unit), ("angle_error.x.b", "urad"));
    // 1″ = π/648000 rad = 4.848 µrad
    columns[2].unit = "arcsec".into();
    columns[2].data = urad.iter().map(|v| v / 4.848_136_811_095_36).collect();
    let as_arcsec = &record(&columns)[0];
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
    near(as_urad.A.unwrap(), as_arcsec.A.unwrap());
    near(as_urad.arcsec.as_ref().unwrap()["A"].unwrap(), as_urad.A.unwrap() / 4.848_136_811_095_36);
    assert!(as_urad.uncertainty.is_none());
}

/// A scale at 23 °C with 8.5 ppm/K is 25.5 µm/m too long.
/// Against a work piece at 22 °C with 11.5 ppm/K 2.5 µm/m too long.
#[test]
fn lengths_are_reduced_to_20_degrees() {
    let rows = cycles(&uneven(1000.0, 9), 5);
    let grown = |ppm: f64| {
        let mut columns = run(&rows, |(p, way)| ppm * p / 1000.0 + way).columns;
        columns.push(column("T3", "temperature", vec![23.0; rows.len()]));
        columns.push(column("T5", "temperature", vec![22.0; rows.len()]));
        Record::new(Path::new("y.run.toml"), RunKind::Positioning, columns).unwrap()
    };
    let scale = "[thermal]\nscale = { sensor = \"T3\", ppm_per_K = 8.5 }\n";
    let piece = "workpiece = { sensor = \"T5\", ppm_per_K = 11.5 }\n";
    let evaluated = |record: &Record, text: &str| {
        let conditions = TestConditions::parse(Path::new("c.toml"), text).unwrap();
        positioning_with(record, &PositioningOptions { conditions, ..PositioningOptions::default() })
    };
    for (ppm, text) in [(25.5, scale.to_owned()), (2.5, format!("{scale}{piece}"))] {
        let found = &evaluated(&grown(ppm), &text).unwrap()[0];
        assert!((found.E_up.unwrap()).abs() < 1e-9 && (found.B.unwrap() - 2.0).abs() < 1e-9, "{found:?}");
        assert!(
            warned(found, "reduced to 20 °C: scale T3 at 23.00 °C with 8.5 ppm/K"),
            "{:?}",
            found.warnings
        );
    }
    let e = evaluated(&grown(1.0), &scale.replace("T3", "T9")).unwrap_err().to_string();
    assert!(e.contains("no temperature T9") && e.contains("T3, T5"), "{e}");
}

/// Four body diagonals of a box whose axes have known scales and squareness.
#[test]
fn body_diagonals_give_squareness() {
    let size = [400.0, 300.0, 500.0];
    let (scale, xy, xz, yz) = ([20.0, -10.0, 5.0], 25.0, -15.0, 8.0);
    let one = |signs: [f64; 3], by_axis: bool| {
        let share: Vec<f64> = uneven(1.0, 9).into_iter().map(|s| s.min(1.0)).collect();
        let rows = cycles(&share, 5);
        let d = size.iter().map(|s| s * s).sum::<f64>().sqrt();
        let place = |k: usize, s: f64| size[k] * if signs[k] > 0.0 { s } else { 1.0 - s };
        let error = |(s, way): (f64, f64)| -> [f64; 3] {
            let [x, y, z] = [place(0, s), place(1, s), place(2, s)];
            // e_x = … + xy·y + xz·z, e_y = … + yz·z; a reversal of 2 µm of z.
            [
                (scale[0] * x + xy * y + xz * z) / 1000.0,
                (scale[1] * y + yz * z) / 1000.0,
                scale[2] * z / 1000.0 + way,
            ]
        };
        let of = |f: &dyn Fn((f64, f64)) -> f64| rows.iter().copied().map(f).collect::<Vec<f64>>();
        let mut columns = vec![
            column("x", "position.x", of(&|r| place(0, r.0))),
            column("y", "position.y", of(&|r| place(1, r.0))),
            column("z", "position.z", of(&|r| place(2, r.0))),
            column("dz", "direction.z", of(&|r| r.1)),
        ];
        if by_axis {
            for (k, n) in ["x", "y", "z"].iter().enumerate() {
                columns.push(column(&format!("e{n}"), &format!("error.{n}"), of(&|r| error(r)[k])));
            }
        } else {
            let along = |r| (0..3).map(|k| error(r)[k] * signs[k] * size[k] / d).sum::<f64>();
            columns.push(column("e", "error.d", of(&along)));
        }
        Record::new(Path::new("d.run.toml"), RunKind::Positioning, columns).unwrap()
    };
    for by_axis in [false, true] {
        let records: Vec<Record> = [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0, -1.0, 1.0]]
            .map(|s| one(s, by_axis))
            .to_vec();
        let found = diagonals(&records, &PositioningOptions::default()).unwrap();
        assert_eq!(found.kind, "body");
        let senses: Vec<&str> = found.diagonals.iter().map(|d| d.sense.as_str()).collect();
        assert_eq!(senses, ["PPP", "NPP", "PNP", "NNP"]);
        for (pair, want) in [("x.y", xy), ("x.z", xz), ("y.z", yz)] {
            let got = found.squareness_urad[pair];
            assert!((got - want).abs() < 0.01, "{pair}: {got} and {want}");
        }
        let d = size.iter().map(|s| s * s).sum::<f64>().sqrt();
        assert!((found.b_d.unwrap() - 2.0 * size[2] / d).abs() < 1e-9, "{:?}", found.b_d);
        let mean = size.iter().zip(scale).map(|(s, ppm)| s * s * ppm).sum::<f64>() / d / d;
        assert!((found.scale_ppm - mean).abs() < 0.01, "{} {mean}", found.scale_ppm);
        let three = diagonals(&records[..3], &PositioningOptions::default()).unwrap();
        assert!(three.squareness_urad.is_empty() && three.warnings.iter().any(|w| w.contains("four")));
    }
}

/// A device that counts from the diagonal's other end.
/// Its direction says so, or what is assumed is said.
#[test]
fn a_diagonal_may_be_logged_from_its_other_end() {
    let (size, xy) = ([400.0_f64, 300.0], 25.0);
    let d = size[0].hypot(size[1]);
    // Along x = ±y; the device counts up from share 0, where y is low or high.
    let one = |x_way: f64, y_way: f64, said: &str| {
        let rows = cycles(&uneven(1.0, 9).into_iter().map(|s| s.min(1.0)).collect::<Vec<_>>(), 5);
        let of = |f: &dyn Fn((f64, f64)) -> f64| rows.iter().copied().map(f).collect::<Vec<f64>>();
        let at = |way: f64, s: f64, size: f64| size * if way > 0.0 { s } else { 1.0 - s };
        // e_x = xy·y, from the place where the device starts; 1 µm of reversal along the device.
        let error = |(s, dir): (f64, f64)| {
            let y = at(y_way, s, size[1]) - at(y_way, 0.0, size[1]);
            xy * y / 1000.0 * x_way * size[0] / d + dir
        };
        let mut columns = vec![
            column("x", "position.x", of(&|r| at(x_way, r.0, size[0]))),
            column("y", "position.y", of(&|r| at(y_way, r.0, size[1]))),
            column("e", "error.r", of(&error)),
        ];
        let way = if said == "direction.r" { 1.0 } else { y_way };
        columns.push(column("d", said, of(&|r| r.1 * way)));
        Record::new(Path::new("d.run.toml"), RunKind::Positioning, columns).unwrap()
    };
    for [a, b] in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
        // The diagonal where both rise together, and the other one.
        let records = [one(a, a, "direction.r"), one(b, -b, "direction.r")];
        let found = diagonals(&records, &PositioningOptions::default()).unwrap();
        let got = found.squareness_urad["x.y"];
        assert!((got - xy).abs() < 0.01, "{a} {b}: {got}");
        assert!((found.b_d.unwrap().abs() - 2.0).abs() < 1e-9, "{:?}", found.b_d);
        assert!(!found.warnings.iter().any(|w| w.contains("taken as positive")), "{:?}", found.warnings);
    }
    // Sorted by target, the rows do not say how the device counts.
    let sorted = |way: f64| {
        let mut r = one(1.0, way, "direction.r");
        let mut order: Vec<usize> = (0..r.rows()).collect();
        let (y, dir) = (r.columns[1].data.clone(), r.columns[3].data.clone());
        order.sort_by(|a, b| (y[*a], dir[*a] * way).partial_cmp(&(y[*b], dir[*b] * way)).unwrap());
        for c in &mut r.columns {
            let turned = if way < 0.0 && ["e", "d"].contains(&c.name.as_str()) { -1.0 } else { 1.0 };
            c.data = order.iter().map(|k| turned * c.data[*k]).collect();
        }
        Record::new(Path::new("d.run.toml"), RunKind::Positioning, r.columns).unwrap()
    };
    let found = diagonals(&[sorted(1.0), sorted(-1.0)], &PositioningOptions::default()).unwrap();
    assert!((found.squareness_urad["x.y"] - xy).abs() < 0.01, "{:?}", found.squareness_urad);
    // An axis across the diagonal is not along it.
    let mut across = one(1.0, 1.0, "direction.y");
    across.columns[2].role = Role::parse("error.z").unwrap();
    let e = diagonals(&[across], &PositioningOptions::default()).unwrap_err();
    assert!(e.found.contains("no error along the diagonal"), "{e}");
    let assumed = |y_way: f64| {
        let found = diagonals(&[one(y_way, y_way, "direction.y")], &PositioningOptions::default()).unwrap();
        found.warnings.iter().any(|w| w.contains("error.r is taken as positive with y"))
    };
    assert!(assumed(-1.0) && !assumed(1.0));
}

#[test]
fn what_is_no_diagonal_is_refused() {
    let e = diagonals(&[noisy(&cycles(&uneven(800.0, 9), 5))], &PositioningOptions::default()).unwrap_err();
    assert!(e.to_string().contains("1 moving axes (y)"), "{e}");
}

/// A means what the standard says of all it is made of, so that A is never below E.
#[test]
fn what_is_approached_once_is_in_no_figure() {
    let targets = uneven(400.0, 11);
    let mut rows = cycles(&targets, 1);
    for _ in 0..4 {
        rows.extend(cycles(&targets[4..7], 1));
    }
    let whole = noisy(&rows);
    let p = &positioning(&whole).unwrap()[0];
    let few = noisy_only(&whole, &targets[4..7]);
    let own = &positioning(&few).unwrap()[0];
    assert_eq!(p.figures(), own.figures());
    assert!(p.A >= p.E && p.A_up >= p.E_up && p.A_down >= p.E_down, "{p:?}");
    assert!(warned(p, "8 targets approached once only"), "{:?}", p.warnings);
    assert_eq!(p.targets.len(), 11, "all are listed");
}

/// Those rows of a record that are of these targets.
fn noisy_only(record: &Record, targets: &[f64]) -> Record {
    let data = |role: &str| record.data(&Role::parse(role).unwrap()).unwrap().to_vec();
    let (y, dir, e) = (data("position.y"), data("direction.y"), data("error.y"));
    let kept: Vec<usize> = (0..y.len()).filter(|i| targets.contains(&y[*i])).collect();
    let rows: Vec<(f64, f64)> = kept.iter().map(|i| (y[*i], dir[*i])).collect();
    let mut errors = kept.iter().map(|i| e[*i]);
    run(&rows, |_| errors.next().unwrap())
}

/// Positions that are read scatter; targets stay what they are.
#[test]
fn positions_that_scatter_are_of_the_same_targets() {
    let targets = uneven(400.0, 11);
    let commanded = cycles(&targets, 5);
    let mut state = 4;
    let errors: Vec<f64> = commanded.iter().map(|(p, way)| 0.02 * p + way + uniform(&mut state)).collect();
    let of = |scatter_mm: f64| {
        let mut state = 7;
        let rows: Vec<_> = commanded
            .iter()
            .map(|(p, way)| (p + scatter_mm * (2.0 * uniform(&mut state) - 1.0), *way))
            .collect();
        let mut e = errors.iter();
        positioning(&run(&rows, |_| *e.next().unwrap())).unwrap().swap_remove(0)
    };
    let exact = of(0.0);
    for scatter_mm in [0.001, 0.02, 0.05, 0.1, 0.3, 1.0] {
        let p = of(scatter_mm);
        assert_eq!(p.figures(), exact.figures(), "{scatter_mm}");
        assert_eq!(
            warned(&p, "positions of one target differ"),
            scatter_mm > 0.04,
            "{scatter_mm}: {:?}",
            p.warnings
        );
    }
}
