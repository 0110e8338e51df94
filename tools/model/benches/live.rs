//! A model at one instant: one effect of every law, and as many more. Prints, asserts nothing: `cargo bench --workspace --bench live`.

use rtec_model::effect::{Dictionary, Difference, Effect, Naming, Need};
use rtec_model::live::{AxisNow, Frame, Layout, Live};
use rtec_model::record::Axis;
use std::hint::black_box;
use std::time::Instant;

fn axis(name: &str) -> Axis {
    Axis::new(name).expect("a letter is an axis name")
}

/// One effect of every law of the dictionary (thirty).
fn every_law() -> Vec<Effect> {
    let d = Dictionary::default();
    let mut effects = Vec::new();
    for law in d.laws() {
        let name = &law.describe().name;
        let name = match law.describe().naming {
            Naming::Plain => name.clone(),
            Naming::One => format!("{name}.x"),
            Naming::Two | Naming::Pair => format!("{name}.x.z"),
            Naming::Three => format!("{name}.x.y.z"),
            Naming::Channel => format!("{name}.x.load"),
        };
        let mut e = d.effect(&name).expect("the dictionary's own names");
        if e.description().needs.contains(&Need::Delta) {
            e.delta = Some(Difference::pair("T1", "T2"));
        }
        effects.push(e);
    }
    effects
}

/// One effect of every law, again and again until there are `count`.
fn live(count: usize) -> Live {
    let effects: Vec<Effect> = every_law().into_iter().cycle().take(count).collect();
    let layout = Layout {
        axes: vec![axis("x"), axis("y"), axis("z")],
        sensors: vec!["T1".into(), "T2".into()],
        channels: vec!["load".into()],
    };
    Live::new(&effects, layout).expect("everything is in the layout")
}

/// Asks at some instants, from a time on.
fn ask(live: &mut Live, t: &mut f64, instants: usize) {
    for _ in 0..instants {
        *t += 0.01;
        let axes =
            [AxisNow::moving(100.0 * t.sin(), t.cos()), AxisNow::moving(*t, 1.0), AxisNow::moving(2.0, -1.0)];
        live.evaluate(&Frame {
            t_s: *t,
            axes: &axes,
            temperatures_degc: &[25.0, 20.0],
            channels: &[1.0],
            ..Frame::default()
        });
        black_box(live.errors_um());
    }
}

fn main() {
    // `[EFFECTS] N`: N instants and no more, for counting instructions.
    let words = std::env::args().skip(1).filter(|a| a != "--bench");
    let numbers: Vec<usize> = words.map(|w| w.parse().expect("a whole number")).collect();
    let mut t = 0.0;
    match numbers[..] {
        [] => {}
        [instants] => return ask(&mut live(30), &mut t, instants),
        [count, instants, ..] => return ask(&mut live(count), &mut t, instants),
    }
    for (count, instants) in [(30, 1000), (300, 100), (1000, 30)] {
        let mut live = live(count);
        let mut ns: Vec<f64> = (0..200)
            .map(|_| {
                let start = Instant::now();
                ask(&mut live, &mut t, instants);
                start.elapsed().as_nanos() as f64 / instants as f64
            })
            .collect();
        ns.sort_by(f64::total_cmp);
        println!("live: {count} effects in {:.2} µs", ns[ns.len() / 2] / 1e3);
    }
}
