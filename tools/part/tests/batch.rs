//! Batches from a measuring machine.
//! The tests separate systematic errors, chance, and errors that a probe on the machine cannot see.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_files::InputError;
use rtec_part::batch_evaluation::{BatchEvaluation, PlaceFinding, SignificanceLimits, evaluate_columns};
use rtec_part::error_cor_file::PointError;
use std::fmt::Write as _;
use test_needs::fewer;

const JUDGEMENT: SignificanceLimits = SignificanceLimits { alpha: 0.01, least_um: 1.0 };

fn judged(text: &str, seen: Option<&[PointError]>) -> Result<BatchEvaluation, InputError> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cmm.csv");
    std::fs::write(&file, text).unwrap();
    evaluate_columns(&file, &[], seen, JUDGEMENT)
}

fn normal(rng: &mut Xoshiro256PlusPlus) -> f64 {
    let mut uniform = || ((rng.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let (u, v) = (uniform(), uniform());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn finding(batch: &BatchEvaluation, feature: &str) -> PlaceFinding {
    batch.places.iter().find(|p| p.feature == feature).unwrap().finding
}

#[test]
fn the_t_test_is_the_textbooks() {
    // scipy.stats.ttest_1samp([3.1, 2.4, 2.9, 3.6, 2.0], 0): t = 10.090, p = 0.0005427; trend of the same by
    // scipy.stats.linregress: slope -0.10, p = 0.679.
    let text = "part,feature,error_um\n1,d,3.1\n2,d,2.4\n3,d,2.9\n4,d,3.6\n5,d,2.0\n";
    let place = &judged(text, None).unwrap().places[0];
    assert!((place.mean_um - 2.8).abs() < 1e-12);
    assert!((place.p_value - 0.000_542_733).abs() < 1e-7, "{}", place.p_value);
    assert!((place.trend_p_value - 0.679_094_922).abs() < 1e-7, "{}", place.trend_p_value);
    assert!((place.interval_um.unwrap()[0] - 2.029_567_750).abs() < 1e-6, "{:?}", place.interval_um);
}

#[test]
fn a_step_between_parts_is_no_trend_and_a_trend_no_step() {
    type Beside = fn(f64) -> f64;
    let kinds: [(PlaceFinding, Beside); 4] = [
        (PlaceFinding::Step, |k| if k < 8.0 { 0.0 } else { 12.0 }),
        (PlaceFinding::Step, |k| if k < 5.0 { 6.0 } else { -3.0 }),
        (PlaceFinding::Trend, |k| 0.8 * k),
        (PlaceFinding::Trend, |k| 10.0 * (1.0 - (-k / 12.0).exp())),
    ];
    for (n, (kind, beside)) in kinds.into_iter().enumerate() {
        let mut right = 0;
        for seed in 0..50 {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(100 * n as u64 + seed);
            let mut text = "part,feature,error_um\n".to_owned();
            for part in 0..20 {
                let _ = writeln!(text, "p{part},d,{:.3}", beside(f64::from(part)) + 0.8 * normal(&mut rng));
            }
            let batch = judged(&text, None).unwrap();
            right += u32::from(batch.places[0].finding == kind);
            if n == 0 && kind == batch.places[0].finding {
                let step = batch.places[0].step.as_ref().unwrap();
                assert!(step.part == "p8" && (step.um - 12.0).abs() < 2.0, "{step:?}");
                assert!(batch.offers[0].contains("from part p8 on, a step"), "{:?}", batch.offers);
            }
        }
        assert!(right >= 45, "case {n}: {right} of 50");
    }
}

#[test]
fn system_trend_and_chance_are_told_apart() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(6);
    let mut text = "part,feature,nominal_mm,measured_mm\n".to_owned();
    for part in 0..12 {
        for (feature, error_um) in [("bore", 6.0), ("face", 0.0), ("length", 1.5 * f64::from(part))] {
            let _ = writeln!(
                text,
                "{part},{feature},40,{:.6}",
                40.0 + (error_um + 1.2 * normal(&mut rng)) * 1e-3
            );
        }
    }
    let batch = judged(&text, None).unwrap();
    assert_eq!(finding(&batch, "bore"), PlaceFinding::Systematic);
    assert_eq!(finding(&batch, "face"), PlaceFinding::Nothing);
    assert_eq!(finding(&batch, "length"), PlaceFinding::Trend);
    assert_eq!(batch.offers.len(), 2);
    let bore = batch.places.iter().find(|p| p.feature == "bore").unwrap();
    assert!(bore.interval_um.is_some_and(|[low, high]| low < 6.0 && high > 6.0), "{bore:?}");
}

#[test]
fn chance_alone_raises_few_alarms() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(61);
    let mut alarms = 0;
    let all = fewer(400);
    for _ in 0..all {
        let mut text = "part,feature,error_um,angle_rad\n".to_owned();
        for part in 0..8 {
            for k in 0..10 {
                let _ = writeln!(text, "{part},nose,{:.6},{}", 5.0 * normal(&mut rng), f64::from(k) * 0.1);
            }
        }
        alarms +=
            u64::from(judged(&text, None).unwrap().places.iter().any(|p| p.finding != PlaceFinding::Nothing));
    }
    // Two families of tests at 1 % each: 8 of 400 on average.
    assert!(alarms <= all / 20, "{alarms} of {all}");
}

#[test]
fn a_lobe_that_tool_and_probe_trace_alike_is_not_observable() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(62);
    // The measuring machine finds three lobes and a bump; the probe on the machine finds only the bump.
    let lobe = |a: f64| 8.0 * (3.0 * a).cos();
    let bump = |a: f64| if (a - 0.3).abs() < 0.15 { 20.0 } else { 0.0 };
    let angles: Vec<f64> = (0..20).map(|k| f64::from(k) * 0.08).collect();
    let mut text = "part,feature,angle_rad,error_um\n".to_owned();
    for part in 0..6 {
        for a in &angles {
            let _ = writeln!(text, "{part},nose,{a:.4},{:.4}", lobe(*a) + bump(*a) + normal(&mut rng));
        }
    }
    let seen: Vec<PointError> = angles
        .iter()
        .map(|&angle_rad| PointError { angle_rad, error_um: bump(angle_rad), along_mm: None })
        .collect();
    let batch = judged(&text, Some(&seen)).unwrap();
    for p in &batch.places {
        let a = p.angle_rad.unwrap();
        let expected = if bump(a) > 0.0 {
            PlaceFinding::Systematic
        } else if lobe(a).abs() > 4.0 {
            PlaceFinding::NotObservable
        } else {
            continue; // too little to say
        };
        assert_eq!(p.finding, expected, "{p:?}");
    }
    assert!(batch.offers.iter().any(|o| o.contains("not observable")));
    assert!(
        batch.offer_table.iter().all(|o| bump(o.error.angle_rad) > 0.0),
        "only what is observable is offered to the table"
    );
}

#[test]
fn bad_batches_are_named() {
    let line = |text: &str| judged(text, None).unwrap_err().line;
    assert_eq!(line("part,feature,error_um\n1,d,1\n1,d,2\n2,d,1\n"), 3);
    assert_eq!(line("part,feature,error_um\n1,d,1\n2,d,2\n"), 0);
    assert_eq!(line("part,feature\n1,d\n"), 1);
    assert_eq!(line("part,feature,error_um\n1,,1\n"), 2);
    assert_eq!(line("part,feature,error_um\n"), 0);
    // Readings without scatter.
    let same = judged("part,feature,error_um\n1,d,4\n2,d,4\n3,d,4\n1,e,0\n2,e,0\n3,e,0\n", None).unwrap();
    assert_eq!(finding(&same, "d"), PlaceFinding::Systematic);
    assert_eq!(finding(&same, "e"), PlaceFinding::Nothing);
}

/// The sums of such numbers overflow.
#[test]
fn errors_and_angles_of_no_part_are_refused() {
    for (rows, found) in [
        ("1,d,1.7e308,0\n2,d,1.7e308,0\n3,d,1.7e308,0\n", "a larger error, 17"),
        ("1,d,1,0\n2,d,2,1e300\n3,d,1,0\n", "a larger angle, 1"),
    ] {
        let e = judged(&format!("part,feature,error_um,angle_rad\n{rows}"), None).unwrap_err();
        assert!(e.found.starts_with(found) && e.line > 1, "{e}");
    }
    let e = judged("part,feature,nominal_mm,measured_mm\n1,d,0,1e6\n", None).unwrap_err();
    assert_eq!((e.found.as_str(), e.line), ("a larger error, 1000000000", 2));
}

/// Columns that cannot be meant are refused.
/// They are degrees for radians, an error that its own columns contradict, an inspection of other places.
#[test]
fn columns_that_cannot_be_meant_so_are_refused() {
    let batch = |head: &str, row: &dyn Fn(i32, f64) -> String| {
        (0..5).fold(format!("part,feature,{head}\n"), |text, part| {
            (0..4).fold(text, |text, k| text + &format!("{part},nose,{}\n", row(part, 0.3 * f64::from(k))))
        })
    };
    let degrees = batch("angle_rad,error_um", &|p, a| format!("{:.3},{}", a.to_degrees(), 5 + p));
    let e = judged(&degrees, None).unwrap_err();
    assert!(e.line == 3 && e.found == "a larger angle, 17.189" && e.expected.contains("degrees"), "{e}");

    let both = |sign: f64, off_um: f64| {
        batch("angle_rad,nominal_mm,measured_mm,error_um", &|p, a| {
            let e = 5.0 + 0.3 * f64::from(p);
            format!("{a},40,{:.3},{:.3}", 40.0 + e * 1e-3, sign * e + off_um)
        })
    };
    assert!(judged(&both(1.0, 0.4), None).is_ok(), "rounded to a micrometre");
    for wrong in [both(-1.0, 0.0), both(1.0, 5.0), both(0.001, 0.0)] {
        let e = judged(&wrong, None).unwrap_err();
        assert!(e.line == 2 && e.found.contains("beside measured minus nominal of 5.000 µm"), "{e}");
    }

    let radians = batch("angle_rad,error_um", &|p, a| format!("{a:.3},{}", 5 + p));
    let seen = |angle_rad| [PointError { angle_rad, error_um: 5.0, along_mm: None }];
    assert!(judged(&radians, Some(&seen(0.31))).is_ok());
    let e = judged(&radians, Some(&seen(1.5))).unwrap_err();
    assert!(e.found == "angle_rad 0.000 to 0.900" && e.expected.contains("1.500 to 1.500"), "{e}");
    assert!(judged("part,feature,error_um\n1,d,4\n2,d,5\n3,d,4\n", Some(&seen(0.3))).is_err());
}

/// An inspection of one feature gives no information about another one's angles.
#[test]
fn an_inspection_is_held_against_its_own_feature_only() {
    let text = (0..5).fold("part,feature,angle_rad,error_um\n".to_owned(), |text, p| {
        let e = 0.1 * f64::from(p);
        text + &format!("{p},nose,0.3,{}\n{p},fillet,0.3,{}\n", 8.0 + e, -8.0 - e)
    });
    let seen = [PointError { angle_rad: 0.3, error_um: 8.0, along_mm: None }];
    let e = judged(&text, Some(&seen)).unwrap_err();
    assert!(e.found.contains("fillet and nose"), "{e}");
    let batch = judged(&text, None).unwrap();
    let offered: Vec<_> = batch.offer_table.iter().map(|o| (o.feature.as_str(), o.error.error_um)).collect();
    assert_eq!(offered, [("fillet", -8.2), ("nose", 8.2)]);
}

/// A batch in millimetres or with two spellings of a feature is refused.
/// The millimetres are under µm, in the batch or in the inspection.
#[test]
fn a_batch_in_millimetres_or_in_two_spellings_is_refused() {
    let batch = |per_um: f64, name: &dyn Fn(i32) -> String| {
        (0..5).fold("part,feature,angle_rad,error_um\n".to_owned(), |text, p| {
            text + &format!("{p},{},0.3,{}\n", name(p), (6.0 + 0.1 * f64::from(p)) * per_um)
        })
    };
    let plain = |_: i32| "F1".to_owned();
    let seen = |um: f64| [PointError { angle_rad: 0.3, error_um: um, along_mm: None }];
    assert!(judged(&batch(1.0, &plain), Some(&seen(6.0))).is_ok());
    for (per_um, inspected) in [(1e-3, 6.0), (1e-3 / 25.4, 6.0), (1.0, 6e-3)] {
        let e = judged(&batch(per_um, &plain), Some(&seen(inspected))).unwrap_err();
        assert!(e.expected.contains("are these mm or inches?"), "{e}");
    }
    // A part without any error, to the last digit, is accepted.
    assert!(judged(&batch(0.0, &plain), None).is_ok());
    for other in ["f1", "F1 ", " f1"] {
        let e = judged(&batch(1.0, &|p| if p == 3 { format!("\"{other}\"") } else { plain(p) }), None)
            .unwrap_err();
        assert!(e.found.contains("the feature") && e.expected == "one spelling of one feature", "{e}");
    }
}

/// Typical batches: level, worn along the batch, with a new tool, coarse.
fn batches(rng: &mut Xoshiro256PlusPlus, parts: usize) -> Vec<Vec<f64>> {
    let mut of = |error_um: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
        (0..parts).map(|k| error_um(k, normal(rng))).collect()
    };
    vec![
        of(&|_, noise| 11.5 + noise),
        of(&|k, noise| 2.0 * k as f64 + noise),
        of(&|k, noise| if 2 * k < parts { noise } else { 25.0 + noise }),
        of(&|_, noise| (0.8 * noise).round() * 10.0),
        of(&|k, noise| if k + 2 < parts { noise } else { 60.0 + noise }),
    ]
}

fn written(errors_um: &[f64]) -> String {
    let rows = errors_um.iter().enumerate().map(|(k, um)| format!("{k},D1,{um:.2}\n"));
    std::iter::once("part,feature,error_um\n".to_owned()).chain(rows).collect()
}

/// A digit too many in one reading is reported with its line.
/// All figures are those of the batch without it.
#[test]
fn a_wild_reading_is_in_no_figure() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(39);
    for parts in [4, 5, 6, 8, 20, 60] {
        for (kind, clean) in batches(&mut rng, parts).into_iter().enumerate().take(4) {
            for at in [1, parts / 2, parts - 2] {
                let mut errors_um = clean.clone();
                errors_um[at] += 3000.0;
                let batch = judged(&written(&errors_um), None).unwrap();
                let place = &batch.places[0];
                let of = (parts, kind, at);
                assert_eq!(place.left_out.len(), 1, "{of:?}");
                assert_eq!(
                    (place.left_out[0].line, place.left_out[0].part.as_str()),
                    (at + 2, &*at.to_string())
                );
                errors_um.remove(at);
                let mean =
                    errors_um.iter().map(|um| (um * 100.0).round() / 100.0).sum::<f64>() / (parts - 1) as f64;
                assert!((place.mean_um - mean).abs() < 1e-9 && place.sd_um < 60.0, "{of:?}: {place:?}");
                let with = place.with_every_reading.unwrap();
                assert!(with.mean_um > mean + 40.0 && with.sd_um > 300.0, "{of:?}: {with:?}");
            }
        }
    }
}

/// Two of eight readings in millimetres hide each other from a one-by-one rule.
#[test]
fn two_wild_readings_do_not_hide_each_other() {
    let text = written(&[11.2, 12.4, 3011.0, 11.7, 12.9, 12.0, 3011.5, 11.6]);
    let place = &judged(&text, None).unwrap().places[0];
    let lines: Vec<usize> = place.left_out.iter().map(|w| w.line).collect();
    assert_eq!(lines, [4, 8]);
}

#[test]
fn clean_batches_have_no_wild_reading() {
    // One step of a gauge of 10 µm among parts that read zero.
    let coarse = judged(&written(&[0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0]), None).unwrap();
    assert!(coarse.places[0].left_out.is_empty(), "{:?}", coarse.places[0]);
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(40);
    let (mut looked_at, mut said) = (0, 0);
    let each = fewer(150);
    for parts in [3, 4, 5, 6, 8, 15, 40, 60] {
        for _ in 0..each {
            for errors_um in batches(&mut rng, parts) {
                looked_at += 1;
                said +=
                    usize::from(!judged(&written(&errors_um), None).unwrap().places[0].left_out.is_empty());
            }
        }
    }
    println!("{said} of {looked_at} clean batches with a wild reading");
    // Chance gives one in a thousand: 6 of 6000.
    assert!(said <= looked_at / 400, "{said} of {looked_at}");
}

/// Four places of some parts, one reading of which is mistyped.
fn mistyped(rng: &mut Xoshiro256PlusPlus, parts: usize, typo: fn(f64) -> f64) -> (BatchEvaluation, String) {
    let (place, part) = (rng.next_u64() as usize % 4, rng.next_u64() as usize % parts);
    let mut text = "part,feature,error_um,angle_rad\n".to_owned();
    for k in 0..4 {
        let level = [6.0, -9.0, 12.0][rng.next_u64() as usize % 3];
        for p in 0..parts {
            let um = ((level + 0.8 * normal(rng)) * 10.0).round() / 10.0;
            let um = if (k, p) == (place, part) { typo(um) } else { um };
            let _ = writeln!(text, "p{p},nose,{um:.4},{:.1}", 0.1 * k as f64);
        }
    }
    (judged(&text, None).unwrap(), format!("p{part}"))
}

/// Each reading is judged by the law of the others, however few they are.
#[test]
fn one_mistyped_reading_is_named_and_no_other() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(41);
    let mut others = 0;
    let plus_100: fn(f64) -> f64 = |um| um + 100.0;
    for (parts, typo, least) in [
        (5, plus_100, 36),
        (5, |um| um * 10.0, 28),
        (8, plus_100, 40),
        (8, |um| um * 10.0, 40),
        (12, |um| -um, 39),
    ] {
        let mut named = 0;
        for _ in 0..40 {
            let (batch, part) = mistyped(&mut rng, parts, typo);
            let out: Vec<&str> =
                batch.places.iter().flat_map(|p| &p.left_out).map(|w| w.part.as_str()).collect();
            named += usize::from(out.contains(&part.as_str()));
            others += out.iter().filter(|p| **p != part).count();
        }
        println!("{parts} parts: {named} of 40");
        assert!(named >= least, "{named} of 40 with {parts} parts");
    }
    // One of a thousand batches by chance.
    assert!(others <= 2, "{others} others of 200 batches");
}

/// A step is in the output only where chance does not give it.
#[test]
fn clean_batches_have_no_step() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(42);
    let mut said = 0;
    let each = fewer(40);
    for parts in [5, 8, 12, 20] {
        for gauge_um in [0.1, 1.0, 10.0] {
            for _ in 0..each {
                let mut text = "part,feature,error_um,angle_rad\n".to_owned();
                for k in 0..8 {
                    // At the border of two steps too.
                    let level = 5.0 * f64::from(k % 3);
                    for p in 0..parts {
                        let um = ((level + 1.5 * normal(&mut rng)) / gauge_um).round() * gauge_um;
                        let _ = writeln!(text, "p{p},nose,{um:.1},{:.1}", 0.1 * f64::from(k));
                    }
                }
                let batch = judged(&text, None).unwrap();
                said += u64::from(batch.places.iter().any(|p| p.step.is_some()));
                assert!(batch.places.iter().filter_map(|p| p.step.as_ref()).all(|s| s.p_value < 0.01));
            }
        }
    }
    let files = 12 * each;
    println!("{said} of {files} files with a step");
    // One of a hundred by chance: 4.8 of 480.
    assert!(said <= files / 43, "{said} of {files}");
}

/// A step behind the third of twenty parts makes no trend, and is one.
#[test]
fn an_early_step_is_named() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(43);
    let rows: Vec<f64> = (0..20).map(|k| if k < 3 { 0.0 } else { 12.0 } + 0.8 * normal(&mut rng)).collect();
    let place = &judged(&written(&rows), None).unwrap().places[0];
    assert_eq!(place.finding, PlaceFinding::Step, "{place:?}");
    assert!(place.step.as_ref().is_some_and(|s| s.part == "3" && s.p_value < 1e-6), "{place:?}");
}

/// A gauge that shows 0 for every part hides up to half of an unknown step.
#[test]
fn zeros_alone_have_no_interval() {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(44);
    for parts in [3, 5, 12] {
        for _ in 0..100 {
            let mut text = "part,feature,error_um\n".to_owned();
            let levels =
                [0; 2].map(|_| 4.9 * (2.0 * (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64 - 1.0));
            for (k, level) in levels.iter().enumerate() {
                for p in 0..parts {
                    let um = ((level + 0.02 * normal(&mut rng)) / 10.0).round() * 10.0;
                    let _ = writeln!(text, "{p},F{k},{um:.1}");
                }
            }
            for (place, level) in judged(&text, None).unwrap().places.iter().zip(levels) {
                let holds = place.interval_um.is_none_or(|[low, high]| low <= level && level <= high);
                assert!(holds && place.finding == PlaceFinding::Nothing, "{level}: {place:?}");
            }
        }
    }
}
