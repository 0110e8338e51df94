//! Circular tests on machines whose errors are known, written out here or by the machine's model.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::circles::{Noise, Run, column, map_without_line, near, one};
use rtec_measure::ballbar;
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Record, RunKind};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;
use test_needs::{cases, repetitions};

/// 25 µrad at 150 mm are 1.9 µm on the circle, and 25 µrad.
#[test]
fn a_radial_record_gives_ppm_urad_ms_and_um() {
    let run = Run::both(150.0, 25.0);
    let v = 25.0;
    let found = one(&[run.record("b.run.toml", |[_, a, turn]| {
        let (s, c) = a.sin_cos();
        let r = 0.150;
        let scale = r * (20.0 * c * c - 10.0 * s * s);
        let square = 25.0 * r * s * c;
        let reversal = 3.0 * -turn * s.signum() * c - 2.0 * turn * c.signum() * s;
        // x lags by 0.4 ms, y by 0.1 ms.
        let lag = turn * v * (-0.4 * -s * c - 0.1 * c * s);
        scale + square + reversal + lag + 3.0 * c - 5.0 * s
    })]);
    assert_eq!(found.plane, "x-y");
    let d = &found.diagnosis;
    near(d.scale_mismatch_ppm, 30.0, 1e-6);
    near(d.squareness_urad, 25.0, 1e-6);
    near(d.reversal["x"], 6.0, 1e-6);
    near(d.reversal["y"], -4.0, 1e-6);
    near(d.servo_mismatch_ms, -0.3, 1e-6);
    near(d.centre_um[0].unwrap(), 3.0, 1e-6);
    near(d.centre_um[1].unwrap(), -5.0, 1e-6);
    near(d.radius_um.unwrap(), 0.75, 1e-6);
    near(d.rms, 0.0, 1e-6);
    assert!(d.spike.is_empty() && d.cyclic.is_empty(), "{d:?}");
    near(found.contours[0].feed_mm_per_min, 1500.0, 1e-3);
}

/// Another program's least squares on the same file.
#[test]
fn numpy_finds_the_same() {
    if !test_needs::long() {
        return;
    }
    let mut run = Run::both(150.0, 25.0);
    run.rows = 735;
    let effects = "squareness.x.y urad = 25.0\nfollowing_error.x ms = 0.5\nreversal.y um = 3.0\nreversal.x um = -5.0\n\
                   scale.x ppm = 14.0\noffset.y um = 3.0";
    let record = run.of_machine(effects, &mut Noise(13), 0.2, 0.0);
    let found = one(std::slice::from_ref(&record));
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("b.csv");
    std::fs::write(&csv, rtec_measure::run_record_files::to_csv(&record)).unwrap();
    let judge = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/judges/ballbar.py");
    if !test_needs::python("numpy", "python3-numpy") {
        return;
    }
    let out = std::process::Command::new(test_needs::PYTHON).arg(judge).arg(csv).arg("150").output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let out = String::from_utf8(out.stdout).unwrap();
    let judged = |key: &str| -> f64 {
        let at = out.find(&format!("\"{key}\": ")).unwrap() + key.len() + 4;
        out[at..].split([',', '}']).next().unwrap().trim().parse().unwrap()
    };
    let d = &found.diagnosis;
    // Noise lets ours free a small spike too, and lets the judge's sense differ at the turning rows.
    near(d.scale_mismatch_ppm, judged("scale_mismatch_ppm"), 0.3);
    near(d.squareness_urad, judged("squareness_urad"), 0.2);
    near(d.servo_mismatch_ms, judged("servo_mismatch_ms"), 0.005);
    near(d.reversal["x"], judged("reversal_x"), 0.1);
    near(d.reversal["y"], judged("reversal_y"), 0.1);
    near(found.g_ccw, judged("G_ccw"), 0.05);
    near(found.g_cw, judged("G_cw"), 0.05);
}

#[test]
fn squareness_alone_by_hand() {
    if !test_needs::long() {
        return;
    }
    let run = Run::both(100.0, 20.0);
    let found = one(&[run.record("b.run.toml", |[_, a, _]| 2.0 * (2.0 * a).sin() + 1.0)]);
    for g in [found.g_ccw, found.g_cw, found.g_b] {
        near(g, 4.0, 1e-2);
    }
    near(found.f_max, 3.0, 2e-2);
    near(found.f_min, -1.0, 2e-2);
    near(found.d, 1.0, 2e-2);
    near(found.h, 0.0, 0.04);
    near(found.diagnosis.squareness_urad, 40.0, 1e-6);
    assert_eq!(found.diagnosis.contributions[0].cause, "squareness");
    near(found.diagnosis.contributions[0].um, 4.0, 1e-3);
    near(found.diagnosis.contributions.iter().filter_map(|c| c.percent).sum::<f64>(), 100.0, 1e-9);
    assert!(found.diagnosis.contributions.is_sorted_by(|a, b| a.percent >= b.percent));
    // Backlash shows as hysteresis: both ways differ by it where the axis' error is radial.
    let backlash = |[_, a, turn]: [f64; 3]| 2.5 * -turn * a.sin().signum() * a.cos();
    near(one(&[run.record("b.run.toml", backlash)]).h, 5.0, 0.02);
}

/// Two lobes are a scale mismatch, whatever else an angle might do.
#[test]
fn two_lobes_are_a_scale_mismatch() {
    if !test_needs::long() {
        return;
    }
    let run = Run::both(150.0, 25.0);
    let found = one(&[run.record("b.run.toml", |[_, a, _]| 3.0 * (2.0 * a).cos())]);
    near(found.diagnosis.scale_mismatch_ppm, 40.0, 1e-6);
    assert_eq!(found.diagnosis.contributions[0].cause, "scale mismatch");
}

#[test]
fn spikes_and_cyclic_errors_are_found_with_length_and_period() {
    if !test_needs::long() {
        return;
    }
    let run = Run::both(150.0, 25.0);
    let effects = "reversal.x um = 5.0\nreversal_spike.x um = 7.0; length_mm = 0.8\n\
                   screw_periodic.y period_mm = 10.0; um = 1.2; phase_rad = 0.7";
    let found = one(&[run.of_machine(effects, &mut Noise(7), 0.3, 0.0)]);
    let d = &found.diagnosis;
    near(d.spike["x"].um, 7.0, 0.8);
    near(d.spike["x"].length_mm, 0.8, 0.25);
    near(d.cyclic["y"].period_mm, 10.0, 0.03);
    near(d.cyclic["y"].um, 1.2, 0.1);
    near(d.reversal["x"], 5.0, 0.15);
    assert!(!d.spike.contains_key("y") && !d.cyclic.contains_key("x"), "{d:?}");
}

/// A bug once.
/// A map of the axis was called a cyclic error of 39 mm, a lead that no screw has.
#[test]
fn a_period_of_no_screw_is_a_form_that_repeats() {
    if !test_needs::long() {
        return;
    }
    for (mm, of_a_screw) in
        [(39.0, false), (22.0, false), (10.0, true), (12.7, true), (5.0, true), (25.4, true)]
    {
        let mut noise = Noise(7);
        let effects = format!("screw_periodic.x period_mm = {mm:?}; um = 3.0; phase_rad = 0.4");
        let run = Run { rows: 720, ..Run::both(150.0, 20.0) };
        let found = one(&[run.of_machine(&effects, &mut noise, 0.1, 0.0)]);
        let d = &found.diagnosis;
        let (told, other) = if of_a_screw { (&d.cyclic, &d.form) } else { (&d.form, &d.cyclic) };
        near(told["x"].period_mm, mm, 0.01 * mm);
        assert!(other.is_empty(), "{mm}: {d:?}");
        let name = if of_a_screw { "cyclic.x.um" } else { "form.x.um" };
        assert!(d.interval_95.contains_key(name), "{mm}: {:?}", d.interval_95);
    }
}

/// A map of kinks 37.5 mm apart has something at every period, at those of screws too.
#[test]
fn a_wave_smaller_than_the_map_beside_it_is_a_form() {
    if !test_needs::long() {
        return;
    }
    let map = "knots_mm = [-150.0, -112.5, -75.0, -37.5, 0.0, 37.5, 75.0, 112.5, 150.0]; um = [0.0, 3.0, -2.0, 4.0, -1.0, 3.0, -3.0, 2.0, 0.0]";
    let effects = format!("following_error.x ms = 0.12\nscale.x ppm = 20.0\nposition_map.x {map}");
    for seed in 1..=3 {
        let d = one(&[Run::both(150.0, 41.7).of_machine(&effects, &mut Noise(seed), 0.3, 0.0)]).diagnosis;
        let rms = d.unexplained_um.unwrap();
        let ranked = d.contributions.iter().find(|c| c.cause.starts_with("not explained")).unwrap();
        assert!(ranked.um > 2.0 * rms && d.cyclic.is_empty(), "{seed}: {d:?}");
        near(d.servo_mismatch_ms, 0.12, 0.02);
        // A screw's wave that is larger than the map is one all the same.
        let both = format!("{effects}\nscrew_periodic.x period_mm = 10.0; um = 4.0; phase_rad = 0.4");
        let d = one(&[Run::both(150.0, 41.7).of_machine(&both, &mut Noise(seed), 0.3, 0.0)]).diagnosis;
        near(d.cyclic["x"].um, 4.0, 0.4);
    }
}

#[test]
fn one_way_at_one_feed_cannot_tell_squareness_from_a_lag_and_two_feeds_can() {
    if !test_needs::long() {
        return;
    }
    let mut run = Run::both(150.0, 25.0);
    run.circles = vec![(1.0, 25.0)];
    let effects = "squareness.x.y urad = 25.0\nfollowing_error.x ms = 0.5";
    let found = one(&[run.of_machine(effects, &mut Noise(3), 0.05, 0.0)]);
    assert_eq!((found.diagnosis.squareness_urad, found.diagnosis.servo_mismatch_ms), (None, None));
    assert!(found.warnings.iter().any(|w| w.contains("look alike")), "{:?}", found.warnings);
    assert_eq!((found.g_b, found.h, found.d), (None, None, None));
    // 25 µrad on 150 mm and 0.5 ms at 25 mm/s are ranges of 3.75 and 12.5 µm, which add up or take from each other.
    let together = found.diagnosis.not_separable.as_ref().unwrap();
    let [low, high] = together.interval_95;
    assert!([8.75, 16.25].iter().any(|um| (low..high).contains(um)), "{together:?}");
    assert!(found.diagnosis.contributions.iter().all(|c| !c.cause.contains("servo")), "{found:?}");
    run.circles = vec![(1.0, 10.0), (1.0, 50.0)];
    let found = one(&[run.of_machine(effects, &mut Noise(3), 0.05, 0.0)]);
    // A spike that one way does not show could have moved it.
    let [lo, hi] = found.diagnosis.interval_95["squareness_urad"];
    assert!(lo < 25.0 && 25.0 < hi && hi - lo < 10.0, "{lo} {hi}");
    near(found.diagnosis.servo_mismatch_ms, 0.5, 0.02);
    assert_eq!(found.contours.len(), 2);
}

/// One way a record, two feeds, two planes: what belongs together is put together.
#[test]
fn several_records_are_one_diagnosis_per_plane() {
    if !test_needs::long() {
        return;
    }
    let mut noise = Noise(11);
    let effects = "squareness.x.y urad = 25.0\nfollowing_error.x ms = 0.5\nreversal.y um = 3.0\nsquareness.z.x urad = -40.0";
    let mut records = Vec::new();
    for plane in [["x", "y"], ["z", "x"]] {
        for circles in [vec![(1.0, 10.0)], vec![(-1.0, 10.0)], vec![(1.0, 50.0), (-1.0, 50.0)]] {
            let run = Run { plane, circles, ..Run::both(150.0, 1.0) };
            records.push(run.of_machine(effects, &mut noise, 0.1, 0.0));
        }
    }
    let all = ballbar::evaluate(&records).unwrap();
    assert_eq!(all.iter().map(|b| b.plane.as_str()).collect::<Vec<_>>(), ["x-y", "z-x"]);
    near(all[0].diagnosis.squareness_urad, 25.0, 0.5);
    near(all[0].diagnosis.servo_mismatch_ms, 0.5, 0.02);
    near(all[0].diagnosis.reversal["y"], 3.0, 0.1);
    near(all[1].diagnosis.squareness_urad, -40.0, 0.5);
    near(all[1].diagnosis.servo_mismatch_ms, -0.5, 0.02);
    assert_eq!(all[0].contours.len(), 4);
}

#[test]
fn two_axes_with_their_errors_are_a_circle_too() {
    if !test_needs::long() {
        return;
    }
    let rows = Run::both(100.0, 20.0).rows();
    let by = |of: &dyn Fn(f64, f64) -> f64| rows.iter().map(|r| of(r[1], r[2])).collect::<Vec<_>>();
    let columns = vec![
        column("x", "position.x", by(&|a, _| 300.0 + 100.0 * a.cos())),
        column("y", "position.y", by(&|a, _| -50.0 + 100.0 * a.sin())),
        column("ex", "error.x", by(&|a, w| 0.030 * 100.0 * a.sin() - 2.0 * w * a.sin().signum())),
        column("ey", "error.y", by(&|a, _| 0.010 * 100.0 * a.sin())),
    ];
    let record = Record::new(Path::new("g.run.toml"), RunKind::Ballbar, columns).unwrap();
    let found = one(&[record]);
    near(found.radius_mm, 100.0, 0.01);
    near(found.diagnosis.squareness_urad, 30.0, 0.05);
    near(found.diagnosis.scale_mismatch_ppm, -10.0, 0.05);
    near(found.diagnosis.reversal["x"], 4.0, 0.01);
    assert!(found.warnings.iter().any(|w| w.contains("no time")), "{:?}", found.warnings);
}

/// The same machine by three quarters of a circle.
/// The middle of its positions is not the centre.
#[test]
fn an_arc_by_its_positions_has_its_own_centre() {
    let rows: Vec<[f64; 2]> = (0..900)
        .map(|i| {
            let (way, k) = if i < 450 { (1.0, i) } else { (-1.0, 899 - i) };
            [0.75 * TAU * f64::from(k) / 449.0, way]
        })
        .collect();
    let by = |of: &dyn Fn(f64, f64) -> f64| rows.iter().map(|r| of(r[0], r[1])).collect::<Vec<_>>();
    let columns = vec![
        column("x", "position.x", by(&|a, _| 300.0 + 100.0 * a.cos())),
        column("y", "position.y", by(&|a, _| -50.0 + 100.0 * a.sin())),
        column("ex", "error.x", by(&|a, w| 0.030 * 100.0 * a.sin() - 2.0 * w * a.sin().signum())),
        column("ey", "error.y", by(&|a, _| 0.010 * 100.0 * a.sin())),
    ];
    let found = one(&[Record::new(Path::new("arc.run.toml"), RunKind::Ballbar, columns).unwrap()]);
    near(found.radius_mm, 100.0, 1e-6);
    near(found.diagnosis.squareness_urad, 30.0, 0.05);
    near(found.diagnosis.scale_mismatch_ppm, -10.0, 0.05);
}

/// One way each on circles of two radii are not one contour both ways.
/// A scale of 50 ppm on both, and no play, gave a hysteresis of the difference of their radii.
#[test]
fn circles_of_two_radii_share_no_figure() {
    if !test_needs::long() {
        return;
    }
    let run = |radius_mm: f64, turn: f64| Run { circles: vec![(turn, 8.0)], ..Run::both(radius_mm, 8.0) };
    let oval = |r: f64| move |[_, a, _]: [f64; 3]| 0.05 * r * a.cos().powi(2);
    let pair = |a: f64, b: f64| {
        [run(a, 1.0).record("a.run.toml", oval(a)), run(b, -1.0).record("b.run.toml", oval(b))]
    };
    let same = one(&pair(150.0, 150.0));
    near(same.h, 0.0, 0.1);
    near(same.radius_mm, 150.0, 1e-9);
    let two = one(&pair(50.0, 150.0));
    assert_eq!((two.g_b, two.h, two.d, two.radius_mm), (None, None, None, None));
    assert!(two.warnings.iter().any(|w| w.contains("different radii (50, 150 mm)")), "{:?}", two.warnings);
    near(two.diagnosis.scale_mismatch_ppm, 50.0, 0.05);
}

#[test]
fn without_plane_and_radius_there_are_deviations_only() {
    let rows = Run::both(100.0, 20.0).rows();
    let columns = vec![
        column("a", "angle", rows.iter().map(|r| r[1]).collect()),
        column("e", "error.r", rows.iter().map(|r| 2.0 * (2.0 * r[1]).sin()).collect()),
    ];
    let found = one(&[Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap()]);
    near(found.g_b, 4.0, 0.01);
    assert_eq!(found.diagnosis.squareness_urad, None);
    assert!(found.warnings.iter().any(|w| w.contains("radius_mm")), "{:?}", found.warnings);
}

/// A circle whose first and last rows were cut off is one all the same.
/// One that lacks ten degrees is an arc, and is said to be.
#[test]
fn a_circle_without_its_start_and_stop_is_a_full_one() {
    if !test_needs::long() {
        return;
    }
    let says_arc = |rows: usize, turned_deg: f64| {
        let step = turned_deg.to_radians() / rows as f64;
        let angle: Vec<f64> = (0..rows).map(|i| i as f64 * step).collect();
        let columns = vec![
            column("t", "time", (0..rows).map(|i| i as f64 * 0.1).collect()),
            column("e", "error.r", angle.iter().map(|a| 2.0 * (2.0 * a).cos()).collect()),
            column("a", "angle", angle),
        ];
        let record = Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap();
        let circle =
            Circle { radius_mm: 150.0, plane: ["x", "y"].map(|n| Axis::new(n).unwrap()), centre_mm: None };
        let found = one(&[record.with_circle(circle).unwrap()]);
        found.warnings.iter().any(|w| w.contains("less than a full circle"))
    };
    for (rows, turned_deg) in [(360, 360.0), (358, 358.0), (359, 359.0), (70, 350.0), (3600, 358.5)] {
        assert!(!says_arc(rows, turned_deg), "{rows} rows over {turned_deg}°");
    }
    for (rows, turned_deg) in [(350, 350.0), (68, 340.0), (3560, 356.0)] {
        assert!(says_arc(rows, turned_deg), "{rows} rows over {turned_deg}°");
    }
}

#[test]
fn half_a_quadrant_is_no_circle() {
    let whole = Run::both(100.0, 20.0).record("b.run.toml", |_| 0.0);
    let part = whole.select(&(0..60).collect::<Vec<_>>());
    assert!(ballbar::evaluate(&[part]).is_err());
}

/// Random machines: how often the 95 % interval of each figure holds the truth.
#[test]
fn intervals_hold_the_truth_on_random_machines() {
    if !test_needs::long() {
        return;
    }
    let mut noise = Noise(20);
    let mut held: BTreeMap<&str, (u32, u32)> = BTreeMap::new();
    for machine in 0..cases(75) {
        let scale = [noise.within(-30.0, 30.0), noise.within(-30.0, 30.0)];
        let square = noise.within(-40.0, 40.0);
        let reversal = [noise.within(-8.0, 8.0), noise.within(-8.0, 8.0)];
        let servo = [noise.within(-1.0, 1.0), noise.within(-1.0, 1.0)];
        let offset = [noise.within(-20.0, 20.0), noise.within(-20.0, 20.0)];
        let mut effects = format!(
            "scale.x ppm = {}\nscale.y ppm = {}\nsquareness.x.y urad = {square}\nreversal.x um = {}\n\
             reversal.y um = {}\nfollowing_error.x ms = {}\nfollowing_error.y ms = {}\noffset.x um = {}\noffset.y um = {}\n",
            scale[0], scale[1], reversal[0], reversal[1], servo[0], servo[1], offset[0], offset[1]
        );
        let spike = (noise.unit() < 0.5).then(|| [noise.within(2.0, 10.0), noise.within(0.3, 3.0)]);
        if let Some([um, mm]) = spike {
            let _ = writeln!(effects, "reversal_spike.x um = {um}; length_mm = {mm}");
        }
        let wave = (noise.unit() < 0.5).then(|| [noise.within(6.0, 25.0), noise.within(0.5, 2.0)]);
        if let Some([mm, um]) = wave {
            let _ = writeln!(effects, "screw_periodic.y period_mm = {mm}; um = {um}; phase_rad = 0.5");
        }
        let run = Run { rows: 360, ..Run::both(150.0, noise.within(10.0, 50.0)) };
        let phi = if machine % 2 == 0 { 0.0 } else { 0.5 };
        let found = one(&[run.of_machine(&effects, &mut noise, 0.4, phi)]);
        let d = &found.diagnosis;
        let mut count = |kind: &'static str, name: &str, truth: f64| {
            // A wave of a period that no screw is made with is a form that repeats.
            let other = name.replace("cyclic.", "form.");
            let Some([lo, hi]) = d.interval_95.get(name).or(d.interval_95.get(&other)) else { return };
            let (n, all) = held.entry(kind).or_default();
            *n += u32::from((*lo..=*hi).contains(&truth));
            *all += 1;
        };
        count("scale", "scale_mismatch_ppm", scale[0] - scale[1]);
        count("squareness", "squareness_urad", square);
        count("servo", "servo_mismatch_ms", servo[0] - servo[1]);
        count("reversal", "reversal.x", reversal[0]);
        count("reversal", "reversal.y", reversal[1]);
        count("centre", "centre_um.x", offset[0]);
        count("centre", "centre_um.y", offset[1]);
        if let Some([um, mm]) = spike {
            assert!(um < 5.0 || d.spike.contains_key("x"), "{effects}{d:?}");
            count("spike", "spike.x.um", um);
            count("length", "spike.x.length_mm", mm);
        }
        if let Some([mm, um]) = wave {
            count("period", "cyclic.y.period_mm", mm);
            count("amplitude", "cyclic.y.um", um);
        }
    }
    for (name, (n, all)) in &held {
        let share = f64::from(*n) / f64::from(*all);
        eprintln!("{name:12} {n} of {all}: {:.1} %", 100.0 * share);
    }
    let (n, all) = held.values().fold((0, 0), |a, v| (a.0 + v.0, a.1 + v.1));
    assert!((0.93..=0.97).contains(&(f64::from(n) / f64::from(all))), "{n} of {all}");
    for (name, (n, all)) in held {
        let share = f64::from(n) / f64::from(all);
        // Of some thirty, chance alone takes a share of 95 % as far as this.
        let (least, most) = if all > 50 { (0.90, 0.99) } else { (0.85, 1.0) };
        assert!(all > 25 && (least..=most).contains(&share), "{name}: {n} of {all}");
    }
}

/// What the diagnosis has no law for (maps, bends, several waves on a screw, warming up) neither passes for one of its causes nor
/// leaves intervals too narrow.
#[test]
fn intervals_hold_the_truth_beside_effects_that_have_no_law_here() {
    if !test_needs::long() {
        return;
    }
    let mut noise = Noise(31);
    let mut held: BTreeMap<&str, (u32, u32)> = BTreeMap::new();
    let (mut false_spikes, mut false_waves) = (0, 0);
    let machines = cases(60);
    for machine in 0..machines {
        let scale = [noise.within(-30.0, 30.0), noise.within(-30.0, 30.0)];
        let square = noise.within(-40.0, 40.0);
        let reversal = [noise.within(-8.0, 8.0), 0.0];
        let servo = noise.within(-1.0, 1.0);
        let mut effects = format!(
            "scale.x ppm = {}\nscale.y ppm = {}\nsquareness.x.y urad = {square}\nreversal.x um = {}\n\
             following_error.x ms = {servo}\n",
            scale[0], scale[1], reversal[0]
        );
        let waves = machine % 4 == 0;
        if waves {
            for axis in ["x", "y"] {
                for mm in [noise.within(4.0, 7.0), noise.within(9.0, 20.0)] {
                    let (um, phase) = (noise.within(0.5, 2.5), noise.within(0.0, TAU));
                    let _ = writeln!(
                        effects,
                        "screw_periodic.{axis} period_mm = {mm}; um = {um}; phase_rad = {phase}"
                    );
                }
            }
        }
        if machine % 4 == 1 || machine % 4 == 3 {
            for axis in ["x", "y"] {
                let _ = writeln!(effects, "position_map.{axis} {}", map_without_line(&mut noise, 4.0));
            }
            if machine % 8 == 1 {
                let _ = writeln!(effects, "straightness.x.y {}", map_without_line(&mut noise, 4.0));
            }
        }
        if machine % 4 >= 2 {
            for axis in ["x", "y"] {
                let (um, tau) = (noise.within(-15.0, 15.0), noise.within(60.0, 2000.0));
                let _ = writeln!(effects, "warm_up.{axis} um = {um}; tau_s = {tau}");
            }
        }
        let run = Run { rows: 360, ..Run::both(150.0, noise.within(5.0, 50.0)) };
        let phi = if machine % 2 == 0 { 0.0 } else { 0.5 };
        let found = one(&[run.of_machine(&effects, &mut noise, 0.2, phi)]);
        let d = &found.diagnosis;
        let mut count = |kind: &'static str, name: &str, truth: f64| {
            let [lo, hi] = d.interval_95[name];
            let (n, all) = held.entry(kind).or_default();
            *n += u32::from((lo..=hi).contains(&truth));
            *all += 1;
            if std::env::var("SHOW").is_ok() {
                eprintln!("{machine} {kind} {truth:.2} [{lo:.2}, {hi:.2}] {}", (lo..=hi).contains(&truth));
            }
        };
        count("scale", "scale_mismatch_ppm", scale[0] - scale[1]);
        count("squareness", "squareness_urad", square);
        count("servo", "servo_mismatch_ms", servo);
        count("reversal x", "reversal.x", reversal[0]);
        count("reversal y", "reversal.y", reversal[1]);
        false_spikes += d.spike.len();
        false_waves += if waves { 0 } else { d.cyclic.len() };
    }
    for (name, (n, all)) in &held {
        eprintln!("{name:12} {n} of {all}: {:.1} %", 100.0 * f64::from(*n) / f64::from(*all));
    }
    eprintln!("spikes told where there were none: {false_spikes}, waves {false_waves}");
    let (n, all) = held.values().fold((0, 0), |a, v| (a.0 + v.0, a.1 + v.1));
    assert!((0.90..=0.99).contains(&(f64::from(n) / f64::from(all))), "{n} of {all}");
    for (name, (n, all)) in held {
        assert!((0.90..=1.0).contains(&(f64::from(n) / f64::from(all))), "{name}: {n} of {all}");
    }
    assert!(false_spikes as u64 * 20 <= machines, "{false_spikes}");
    assert!(false_waves as u64 * 20 <= machines, "{false_waves}");
}

/// Regression: with a clock of 10 ms the lag of a start was named a spike.
/// Several rows share a time, so the speed within the 0.3 s of a start is not known.
#[test]
fn a_coarse_clock_makes_no_spike() {
    if !test_needs::long() {
        return;
    }
    let (radius_mm, start_s, pause_s) = (100.0, 0.3, 2.0);
    let mut noise = Noise(7);
    for (feed_mm_s, row_s) in repetitions([(41.7, 0.0025), (83.3, 0.002), (83.3, 0.0035)]) {
        for lag_ms in [0.12, 0.3] {
            let way_mm = 1.1 * TAU * radius_mm;
            let whole_s = way_mm / feed_mm_s + start_s;
            let along_mm = |s: f64| {
                let ramp = |s: f64| 0.5 * feed_mm_s * s * s / start_s;
                if s < start_s {
                    ramp(s.max(0.0))
                } else if s > whole_s - start_s {
                    way_mm - ramp((whole_s - s).max(0.0))
                } else {
                    feed_mm_s * (s - 0.5 * start_s)
                }
            };
            let off_s = noise.within(0.0, 0.01);
            let mut rows: [Vec<f64>; 3] = Default::default();
            for i in 0..(2.0 * (whole_s + pause_s) / row_s) as usize {
                let s = i as f64 * row_s;
                let back = s > whole_s + 0.5 * pause_s;
                let angle_at = |s: f64| {
                    let along = if back { way_mm - along_mm(s - whole_s - pause_s) } else { along_mm(s) };
                    along / radius_mm - 0.35
                };
                let (a, turn) = (angle_at(s), if back { -1.0 } else { 1.0 });
                let v = (angle_at(s + 1e-5) - angle_at(s - 1e-5)) / 2e-5 * radius_mm;
                let (sin, cos) = a.sin_cos();
                let x = 2.0 * (-sin * turn).signum() + 0.02 * radius_mm * cos - lag_ms * sin * v;
                let y = 3.0 * (cos * turn).signum() + 0.015 * radius_mm * cos;
                rows[0].push(((s + off_s) / 0.01).floor() * 0.01);
                rows[1].push(a);
                rows[2].push(x * cos + y * sin + 0.1 * noise.normal());
            }
            let [t, a, e] = rows;
            let columns = vec![column("t", "time", t), column("a", "angle", a), column("e", "error.r", e)];
            let record = Record::new(Path::new("b.run.toml"), RunKind::Ballbar, columns).unwrap();
            let plane = ["x", "y"].map(|n| Axis::new(n).unwrap());
            let found = one(&[record.with_circle(Circle { radius_mm, plane, centre_mm: None }).unwrap()]);
            let d = &found.diagnosis;
            let said = format!("{feed_mm_s} mm/s, {row_s} s, {lag_ms} ms: {:?} {:?}", d.spike, d.interval_95);
            assert!(d.spike.is_empty(), "{said}");
            near(d.reversal["x"], 4.0, 0.1);
            near(d.reversal["y"], 6.0, 0.1);
            near(d.servo_mismatch_ms, lag_ms, 0.003);
        }
    }
}
