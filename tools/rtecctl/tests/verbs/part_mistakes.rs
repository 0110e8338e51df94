//! Users' mistakes at `rtecctl part`: each is refused or reported.

use serde_json::Value;
use std::fmt::Write as _;

use crate::parts::{drawing, json, part, taper};

/// A diameter given as radius, of the part or of the tip.
/// These are the commonest mistakes; both are reported.
#[test]
fn a_diameter_for_a_radius_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
        let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
        text + &format!("{:.6},{:.6}\n", 127.0 + 40.854 * a.cos(), 40.854 * a.sin())
    });
    std::fs::write(folder.join("p.csv"), points).unwrap();
    let run = |words: &[&str]| {
        let out = part(folder, &[&["errors", "--points", "p.csv"], words].concat());
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, said) = run(&["--radius-mm", "76.708", "--tip-mm", "2.5"]);
    assert!(code == Some(2) && said.contains("diameter"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "5"]);
    assert!(code == Some(0) && said.contains("half of --tip-mm"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "40.854", "--tip-mm", "2.5"]);
    assert!(code == Some(0) && said.contains("as much as --tip-mm"), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "5", "--with-size", "--out", "o"]);
    assert!(code == Some(2) && said.contains("--with-size") && !folder.join("o").exists(), "{code:?} {said}");
    let (code, said) = run(&["--radius-mm", "38.354", "--tip-mm", "2.5"]);
    assert!(code == Some(0) && said.is_empty(), "{code:?} {said}");
}

/// A part 50 µm too large, but of good form, is not accepted.
#[test]
fn a_part_of_the_wrong_size_is_not_accepted() {
    let dir = tempfile::tempdir().unwrap();
    let points = |radius_mm: f64| {
        (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
            let r = radius_mm + 2.5;
            text + &format!("{:.6},{:.6}\n", 127.0 + r * a.cos(), r * a.sin())
        })
    };
    std::fs::write(dir.path().join("before.csv"), points(38.354)).unwrap();
    for (radius_mm, code) in [(38.15, 1), (38.1, 0)] {
        std::fs::write(dir.path().join("after.csv"), points(radius_mm)).unwrap();
        let words = "inspect --before before.csv --after after.csv --before-radius-mm 38.354 --radius-mm 38.1 --tip-mm 2.5 --limit-um 2";
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        let text = String::from_utf8(out.stdout).unwrap();
        assert_eq!(out.status.code(), Some(code), "{text}");
        assert!(text.contains("farthest from nominal"), "{text}");
        assert!(out.stderr.is_empty() || code == 1);
        let bare = words.replace("--tip-mm 2.5 ", "");
        let out = part(dir.path(), &bare.split(' ').collect::<Vec<_>>());
        assert!(String::from_utf8_lossy(&out.stderr).contains("no --tip-mm"));
    }
}

/// A bump changes the fitted size, and both together are less than the bump.
/// A feature that was not probed again is not accepted either.
#[test]
fn a_bump_that_the_size_hides_is_not_accepted() {
    let dir = tempfile::tempdir().unwrap();
    let points = |from: f64, to: f64, bump_um: f64| {
        (0..40).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let a = from + (to - from) * f64::from(k) / 39.0;
            let r = 38.0 + 2.5 + 1e-3 * bump_um * (-((a - 0.8) / 0.12_f64).powi(2)).exp();
            text + &format!("{:.6},{:.6}\n", r * a.cos(), r * a.sin())
        })
    };
    let words = "inspect --before before.csv --after after.csv --before-radius-mm 38 --radius-mm 38 --tip-mm 2.5 --limit-um 5";
    let run = |after: String| {
        std::fs::write(dir.path().join("after.csv"), after).unwrap();
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        (
            out.status.code(),
            format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr)),
        )
    };
    std::fs::write(dir.path().join("before.csv"), points(0.05, 1.5, 17.0)).unwrap();
    let (code, said) = run(points(0.05, 1.5, 8.0));
    assert!(code == Some(1) && said.contains("not kept"), "{code:?} {said}");
    let (code, said) = run(points(0.05, 1.5, 1.0));
    assert!(code == Some(0), "{code:?} {said}");
    let (code, said) = run(points(1.1, 1.5, 1.0));
    assert!(code == Some(2) && said.contains("before from 0.05 to 1.50 rad"), "{code:?} {said}");
}

/// Points without directions.
/// For a face, the probe's path gives the side, or nothing does. For a cylinder, the assumption is reported.
#[test]
fn the_side_of_a_straight_feature_comes_from_the_path() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let mut path = String::new();
    for k in 0..12 {
        let (x, n) = (10.0 + 2.0 * f64::from(k), k + 1);
        let _ = writeln!(
            path,
            "POINT start 12.5, {x}, 0\nPOINT touch {n}, 5.0, {x}, 0\nPOINT finish 12.5, {x}, 0"
        );
    }
    std::fs::write(folder.join("pathfin.cdl"), path).unwrap();
    let write = |name: &str, place: &dyn Fn(f64, f64) -> [f64; 2]| {
        let text = (0..12).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let off = 0.03 + if (4..7).contains(&k) { 0.012 } else { 0.0 };
            let [z, x] = place(10.0 + 2.0 * f64::from(k), off);
            text + &format!("{z:.7},{x:.7}\n")
        });
        std::fs::write(folder.join(name), text).unwrap();
    };
    for tilt in [1e-5, -1e-5] {
        write("face.csv", &|s, off| [7.5 + off + tilt * (s - 21.0), s]);
        let errors = ["errors", "--points", "face.csv", "--tip-mm", "2.5", "--json"];
        let out = part(folder, &errors);
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(2) && said.contains("--path PATHFIN.CDL"), "{said}");
        let document = json(folder, &[&errors[..], &["--path", "pathfin.cdl"]].concat());
        assert!(
            (document["errors"][5]["error_um"].as_f64().unwrap() - 12.0).abs() < 0.1,
            "{tilt}: {document}"
        );
        assert!((document["centre_mm"][0].as_f64().unwrap() - 5.03).abs() < 1e-3, "{tilt}: {document}");
        // The path of the other side, and of another face.
        for (start, end) in [("-2.5", "5.0"), ("112.5", "105.0")] {
            let path = std::fs::read_to_string(folder.join("pathfin.cdl")).unwrap();
            let other = path.replace("12.5,", &format!("{start},")).replace(" 5.0,", &format!(" {end},"));
            std::fs::write(folder.join("other.cdl"), other).unwrap();
            let out = part(folder, &[&errors[..], &["--path", "other.cdl"]].concat());
            let said = String::from_utf8_lossy(&out.stderr).into_owned();
            assert!(out.status.code() == Some(2) && said.contains("the way of its touch"), "{said}");
        }
    }
    write("cylinder.csv", &|s, off| [s, 22.5 + off]);
    let out = part(folder, &["errors", "--points", "cylinder.csv", "--tip-mm", "2.5"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success() && said.contains("taken as touched from outside"), "{said}");
}

/// `offer.cor` is the table of one feature only.
#[test]
fn changes_of_two_features_make_no_offer() {
    let dir = tempfile::tempdir().unwrap();
    let batch = (0..5).fold("part,feature,angle_rad,error_um\n".to_owned(), |text, p| {
        let e = 8.0 + 0.1 * f64::from(p);
        text + &format!("{p},nose,0.3,{e}\n{p},fillet,0.3,-{e}\n")
    });
    std::fs::write(dir.path().join("batch.csv"), batch).unwrap();
    let out = part(dir.path(), &["post-process", "--batch", "batch.csv", "--out", "o"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && said.contains("changes of fillet and of nose"), "{said}");
    assert!(!dir.path().join("o").exists());
    let document = json(dir.path(), &["post-process", "--batch", "batch.csv", "--json"]);
    assert_eq!(document["offer_table"][0]["feature"], "fillet", "{document}");
}

/// A model's input that was not given is not silently taken as zero.
#[test]
fn a_model_without_the_machines_place_or_direction_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
        let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
        text + &format!("{:.6},{:.6}\n", 127.0 + 40.6 * a.cos(), 40.6 * a.sin())
    });
    std::fs::write(folder.join("p.csv"), points).unwrap();
    let model = "name = \"m\"\n[[effect]]\nname = \"scale.z\"\nppm = 40.0\n[[effect]]\nname = \"reversal.x\"\num = 4.0\n";
    std::fs::write(folder.join("m.toml"), model).unwrap();
    std::fs::write(folder.join("flat.toml"), "name = \"m\"\n[[effect]]\nname = \"offset.z\"\num = 4.0\n")
        .unwrap();
    let run = |more: &str| {
        let line = format!("errors --points p.csv --radius-mm 38.1 --tip-mm 2.5 {more}");
        let out = part(folder, &line.split_whitespace().collect::<Vec<_>>());
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, said) = run("--machine m.toml");
    assert!(code == Some(0) && said.contains("no --origin-mm") && said.contains("scale.z reads"), "{said}");
    assert!(said.contains("warning: reversal.x of the model"), "{said}");
    let (code, said) = run("--machine m.toml --origin-mm 300,0");
    assert!(code == Some(0) && !said.contains("--origin-mm") && said.contains("reversal.x"), "{said}");
    assert_eq!(run("--machine flat.toml"), (Some(0), String::new()));
    let (code, said) = run("--machine m.toml --origin-mm 300");
    assert!(code == Some(2) && said.contains("--origin-mm: found 300, expected Z,X"), "{said}");
}

/// A drawing in inches that is read as millimetres on request is reported.
/// The same unit given twice needs no report.
#[test]
fn a_unit_other_than_the_headers_is_said() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("inch.dxf"), drawing(38.1).replace("70\n4\n", "70\n1\n")).unwrap();
    let said = |units: &[&str]| {
        let out = part(dir.path(), &[&["features", "inch.dxf"], units].concat());
        assert!(out.status.success());
        String::from_utf8(out.stderr).unwrap()
    };
    let over = said(&["--units", "mm"]);
    assert!(over.contains("says 1 unit = 25.4 mm, --units says 1 mm") && over.lines().count() == 1, "{over}");
    assert_eq!(said(&["--units", "inch"]) + &said(&[]), "");
    // The path is in the drawing's inches, or in mm: 127 + 38.1 + 2.5 mm at the first point.
    let first = |dxf: &str, units: &str| {
        let out = part(
            dir.path(),
            &["points", dxf, "--units", units, "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o"],
        );
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let path = std::fs::read_to_string(dir.path().join("o/probpath.cdl")).unwrap();
        let z: f64 = path.split([' ', ',']).nth(4).unwrap().parse().unwrap();
        (z, String::from_utf8_lossy(&out.stderr).contains("--path-units inch"))
    };
    let cm = drawing(3.81).replace("70\n4\n", "70\n5\n").replace("127.0", "12.7");
    std::fs::write(dir.path().join("cm.dxf"), cm).unwrap();
    let inch = drawing(1.5).replace("70\n4\n", "70\n1\n").replace("127.0", "5.0");
    std::fs::write(dir.path().join("in.dxf"), inch).unwrap();
    assert_eq!(first("inch.dxf", "mm"), (167.6, false));
    let (z, said) = first("in.dxf", "inch");
    assert!((z - 167.6 / 25.4).abs() < 1e-5 && said, "{z}");
    let out = part(dir.path(), &["points", "cm.dxf", "--feature", "F1:5", "--tip-mm", "2.5", "--out", "o"]);
    assert!(out.status.success());
    let path = std::fs::read_to_string(dir.path().join("o/probpath.cdl")).unwrap();
    assert!(path.starts_with("POINT touch 1, 167.600000, 0.000000"), "{path}");
}

/// In a hollow arc the nose runs inside, at 5 mm less 0.8 mm from the centre.
/// It stays away from the surface that it cuts by its own radius.
#[test]
fn the_nose_runs_inside_a_hollow_arc() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    let points = (0..12).fold("z_mm,x_mm,approach_z,approach_x\n".to_owned(), |text, k| {
        let (sin, cos) = (185.0 + 80.0 * f64::from(k) / 11.0_f64).to_radians().sin_cos();
        let off = if k == 6 { 0.004 } else { 0.0 };
        text + &format!("{:.6},{:.6},{cos:.5},{sin:.5}\n", 50.0 + (4.0 + off) * cos, 30.0 + (4.0 + off) * sin)
    });
    std::fs::write(folder.join("fillet.csv"), points).unwrap();
    let line = "errors --points fillet.csv --radius-mm 5 --tip-mm 1 --out o";
    let out = part(folder, &line.split(' ').collect::<Vec<_>>());
    assert!(String::from_utf8_lossy(&out.stderr).contains("part table wants --hollow"));
    let table = |more: &str| {
        let line = "table --errors o/error.cor --centre-z-mm 50 --centre-x-mm 30 --radius-mm 5 --g01-um 1 --out t --json";
        let line = format!("{line} --nose-mm {more}");
        part(folder, &line.split(' ').collect::<Vec<_>>())
    };
    let inside = table("0.8 --hollow");
    assert!(inside.status.success(), "{}", String::from_utf8_lossy(&inside.stderr));
    let document: Value = serde_json::from_slice(&inside.stdout).unwrap();
    for row in document["rows"].as_array().unwrap() {
        let at = |key: &str| row["part_mm"][key].as_f64().unwrap();
        let (z, x) = (at("z") - 50.0, at("x") - 30.0);
        assert!((z.hypot(x) - 4.2).abs() < 1e-6 && z < 0.0 && x < 0.0, "{row}");
    }
    // The moves are nearer to the centre where the fillet is cut too deep.
    let moves = std::fs::read_to_string(folder.join("t/g01.nc")).unwrap();
    for line in moves.lines() {
        let at = |c: char| line.split(c).nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
        let r = (at('Z') - 50.0).hypot(at('X') - 30.0);
        assert!((4.194..4.203).contains(&r), "{line}: {r}");
    }
    assert_eq!(table("5 --hollow").status.code(), Some(2));
}

/// A taper of the other sign, a whole angle, an angle to the face: all reported.
#[test]
fn another_taper_is_said() {
    let dir = tempfile::tempdir().unwrap();
    taper(dir.path());
    let said = |deg: &str| {
        let out = part(
            dir.path(),
            &["errors", "--points", "taper.csv", "--tip-mm", "0", &format!("--taper-deg={deg}")],
        );
        assert!(out.status.success());
        String::from_utf8(out.stderr).unwrap()
    };
    for (deg, hint) in
        [("20", "other sign"), ("-40", "whole angle"), ("-70", "to the face"), ("5", "order of z_mm")]
    {
        assert!(said(deg).contains(hint), "{deg}: {}", said(deg));
    }
    assert!(!said("-20.5").contains("from --taper-deg"));
}

/// A feature given twice, and points that a tip cannot resolve.
#[test]
fn points_on_one_place_are_said() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("nose.dxf"), drawing(38.1)).unwrap();
    let run = |more: &str| {
        let words = format!("points nose.dxf --tip-mm 2.5 --out o {more}");
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        (out.status.code(), String::from_utf8(out.stderr).unwrap())
    };
    let (code, said) = run("--feature F1:20");
    assert!(code == Some(0) && !said.contains("warning"), "{said}");
    let (code, said) = run("--feature F1:20 --feature F1:10");
    assert!(code == Some(2) && said.contains("F1 twice"), "{said}");
    // A quarter of 38.1 mm is 59.85 mm long.
    let (code, said) = run("--feature F1:20 --margin-mm 29.9");
    assert!(code == Some(0) && said.contains("look at --margin-mm"), "{code:?} {said}");
}

/// A part that was clamped elsewhere, or is another one.
/// Its form says nothing about the earlier one.
#[test]
fn an_arc_in_another_place_is_not_the_one_before() {
    let dir = tempfile::tempdir().unwrap();
    let points = |centre_z_mm: f64| {
        (0..20).fold("z_mm,x_mm\n".to_owned(), |text, k| {
            let a = std::f64::consts::FRAC_PI_2 * f64::from(k) / 19.0;
            text + &format!("{:.6},{:.6}\n", centre_z_mm + 40.6 * a.cos(), 40.6 * a.sin())
        })
    };
    std::fs::write(dir.path().join("before.csv"), points(127.0)).unwrap();
    for (centre_z_mm, code) in [(127.0, 0), (127.4, 0), (130.0, 2)] {
        std::fs::write(dir.path().join("after.csv"), points(centre_z_mm)).unwrap();
        let words = "inspect --before before.csv --after after.csv --before-radius-mm 38.1 --radius-mm 38.1 --tip-mm 2.5 --limit-um 2";
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(code), "{said}");
        assert!(code == 0 || said.contains("arcs 3.00 mm apart"), "{said}");
    }
}

/// `--origin-mm` X,Z instead of Z,X: the model is used beyond its map.
#[test]
fn an_origin_beyond_the_models_map_is_said() {
    let dir = tempfile::tempdir().unwrap();
    taper(dir.path());
    let map =
        "name = \"lathe\"\n[[effect]]\nname = \"position_map.x\"\nknots_mm = [0, 75, 150]\num = [0, 3, -2]\n";
    std::fs::write(dir.path().join("m.toml"), map).unwrap();
    let said = |origin: &str| {
        let words = format!("errors --points taper.csv --tip-mm 2.5 --machine m.toml --origin-mm {origin}");
        let out = part(dir.path(), &words.split(' ').collect::<Vec<_>>());
        assert!(out.status.success());
        String::from_utf8(out.stderr).unwrap()
    };
    assert!(!said("600,50").contains("position_map.x"), "{}", said("600,50"));
    assert!(said("50,600").contains("position_map.x has values from 0 to 150 mm"), "{}", said("50,600"));
}

/// The position of an arc, given with errors of a straight feature, is not ignored.
#[test]
fn an_arc_s_place_for_a_taper_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    taper(dir.path());
    json(dir.path(), &["errors", "--points", "taper.csv", "--tip-mm", "2.5", "--out", "o", "--json"]);
    let out = part(dir.path(), &["table", "--errors", "o/error.cor", "--radius-mm", "38.1", "--out", "t"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && said.contains("errors bring their places"), "{said}");
}
