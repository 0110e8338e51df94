//! The page that a metrologist signs.

#![allow(clippy::unwrap_used)] // a test's own helpers

use crate::noise::noise;
use rtec_model::ballbar_circle::Circle;
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use rtec_reconcile::{ReconciliationOptions, html, pictures, reconcile};
use std::path::Path;

fn page(model: &str, train: &[Record]) -> (String, serde_json::Value) {
    let machine = Machine::parse(Path::new("machine.toml"), model).unwrap();
    let answer = reconcile(train, &[], &machine, &ReconciliationOptions::default()).unwrap();
    (html(&answer, "mill <1>"), serde_json::to_value(pictures(&answer)).unwrap())
}

/// An axis with a bow of 12 µm, five cycles both ways over 21 uneven targets.
fn bowed() -> Record {
    let axis = Axis::new("x").unwrap();
    let mut dice = noise(3);
    let (mut p, mut d, mut e) = (Vec::new(), Vec::new(), Vec::new());
    for pass in 0..10 {
        for k in 0..21 {
            let k = if pass % 2 == 0 { k } else { 20 - k };
            let at = 25.0 * f64::from(k) + f64::from(k * 7 % 5) + 1.3;
            let s = at / 510.0;
            p.push(at);
            d.push(if pass % 2 == 0 { 1.0 } else { -1.0 });
            e.push(48.0 * s * (1.0 - s) * (1.0 + 0.8 * (9.0 * s).sin()) + 0.2 * dice());
        }
    }
    let columns = vec![
        Column::new("x", Role::Position(axis.clone()), p),
        Column::new("d", Role::Direction(axis.clone()), d),
        Column::new("e", Role::Error(axis), e),
    ];
    let mut record = Record::new(Path::new("bow.run.toml"), RunKind::Positioning, columns).unwrap();
    record.date = Some("2026-05-04".to_owned());
    record
}

#[test]
fn a_map_is_drawn_with_its_band_and_rows_over_the_position() {
    let (page, pictures) = page("name = \"m\"\n", &[bowed()]);
    for words in [
        "position_map.x, with its 95 % band",
        "position of x (mm)",
        "after, down",
        "Contributions, ranked",
        "Uncertainty of one reading",
        "noise of one reading",
        "zero of error.x",
        "@page{size:A4",
        "signature",
        "<td>2026-05-04</td>",
        "mill &lt;1&gt;",
    ] {
        assert!(page.contains(words), "{words}: {page}");
    }
    assert!(!page.contains("src=\"http") && !page.contains("href=\"http") && !page.contains(">row<"));
    let band =
        pictures.as_array().unwrap().iter().find(|p| p["title"].to_string().contains("95 % band")).unwrap();
    let edges = band["series"][0]["points"].as_array().unwrap();
    let half = edges.len() / 2;
    assert!(half > 3 && (0..half).all(|k| edges[k][1].as_f64() < edges[half + k][1].as_f64()), "{band}");
}

#[test]
fn shares_of_one_unit_are_a_hundred_per_cent() {
    let (page, _) = page("name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 20.0\n", &[bowed()]);
    let table = page.split("Contributions, ranked").nth(1).unwrap().split("</table>").next().unwrap();
    let shares = table.split(" %<td").filter_map(|cell| cell.rsplit('>').next()?.parse::<f64>().ok());
    let all: Vec<f64> = shares.collect();
    assert!(all.len() >= 2 && (all.iter().sum::<f64>() - 100.0).abs() <= 0.5 * all.len() as f64, "{all:?}");
    assert!(all.is_sorted_by(|a, b| a >= b), "{all:?}");
}

/// On a circle a constant moves the centre, which is the set-up's.
#[test]
fn a_zero_is_no_contribution() {
    for zero in ["um = 30.0", "um = 30.0\nadded_by = \"model fit\"", "um = 30.0\nset_up = true"] {
        let (page, _) =
            page(&format!("name = \"m\"\n[[effect]]\nname = \"offset.x\"\n{zero}\n"), &[circle()]);
        let table = page.split("Contributions, ranked").nth(1).unwrap().split("</table>").next().unwrap();
        assert!(table.contains("squareness") && !table.contains("offset.x"), "{zero}: {table}");
    }
}

/// A circle with a squareness, off its centre.
fn circle() -> Record {
    let mut dice = noise(9);
    let angle: Vec<f64> = (0..360).map(|i| f64::from(i).to_radians()).collect();
    let of = |a: &f64| 0.15 * 40.0 * a.sin() * a.cos() + 12.0 * a.cos() - 5.0 * a.sin() + 0.1 * dice();
    let e: Vec<f64> = angle.iter().map(of).collect();
    let columns =
        vec![Column::new("a", Role::Angle, angle), Column::new("e", Role::Error(Axis::new("r").unwrap()), e)];
    let plane = ["x", "y"].map(|n| Axis::new(n).unwrap());
    let circle = Circle { radius_mm: 150.0, plane, centre_mm: None };
    let record = Record::new(Path::new("c.run.toml"), RunKind::Ballbar, columns).unwrap();
    record.with_circle(circle).unwrap()
}

#[test]
fn a_circle_is_drawn_over_its_angle_and_its_centre_is_said() {
    let (page, _) = page("name = \"m\"\n", &[circle()]);
    for words in ["angle (°)", "centre, first axis of the plane", "length of the bar", "squareness"] {
        assert!(page.contains(words), "{words}: {page}");
    }
}
