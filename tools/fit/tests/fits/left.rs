//! Residuals of a fit of named effects.
//! A wave or a bend is reported, and the intervals contain the truth beside it. Noise is not reported.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_fit::linear_least_squares::fit_named;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role, RunKind};
use std::f64::consts::TAU;
use std::path::Path;

struct Dice(u64);

impl Dice {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn within(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }
    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.unit()).ln()).sqrt() * (TAU * self.unit()).cos()
    }
}

/// Five runs both ways over targets at uneven distances.
/// `more` adds to scale and reversal an error by the position and half the travel.
fn run(d: &mut Dice, [ppm, um]: [f64; 2], noise: f64, more: impl Fn(f64, f64) -> f64) -> Record {
    let (half, count) = (d.within(150.0, 450.0), 11 + (d.unit() * 10.0) as usize);
    let pitch = 2.0 * half / (count - 1) as f64;
    let targets: Vec<f64> = (0..count).map(|k| -half + pitch * (k as f64 + 0.3 * (d.unit() - 0.5))).collect();
    let (mut p, mut dir, mut e) = (vec![], vec![], vec![]);
    let (phi, mut last) = (d.within(0.0, 0.5), 0.0);
    for _ in 0..5 {
        for up in [true, false] {
            for k in 0..count {
                let x = targets[if up { k } else { count - 1 - k }];
                let way = if up { 1.0 } else { -1.0 };
                last = phi * last + f64::sqrt(1.0 - phi * phi) * d.normal();
                p.push(x);
                dir.push(way);
                e.push(ppm * x / 1000.0 + um * way / 2.0 + more(x, half) + noise * last);
            }
        }
    }
    let column = |name: &str, role: &str, data: Vec<f64>| {
        let role = Role::parse(role).unwrap();
        Column { name: name.into(), unit: role.unit().unwrap().into(), role, data }
    };
    let columns =
        vec![column("x", "position.x", p), column("d", "direction.x", dir), column("e", "error.x", e)];
    Record::new(Path::new("x.run.toml"), RunKind::Positioning, columns).unwrap()
}

#[test]
fn a_wave_or_a_bend_that_is_left_is_said_and_held_by_the_intervals() {
    for (name, said_of) in [("nothing", 0..=2), ("wave", 140..=150), ("bend", 140..=150)] {
        let mut d = Dice(5);
        let (mut inside, mut warned) = ([0; 2], 0);
        for _ in 0..150 {
            let truth = [d.within(-60.0, 60.0), d.within(-6.0, 6.0)];
            let (size, period, phase) = (d.within(1.0, 3.0), d.within(3.0, 40.0), d.within(0.0, TAU));
            let more = |x: f64, half: f64| match name {
                "wave" => size * (TAU * x / period + phase).sin(),
                // An even function has no straight part, except through the targets' places.
                "bend" => size * (x / half).powi(2) * 2.0,
                _ => 0.0,
            };
            let noise = d.within(0.1, 0.4);
            let record = run(&mut d, truth, noise, more);
            let names = ["scale.x", "reversal.x"].map(str::to_owned);
            let (_, report) = fit_named(&Machine::ideal("m"), &names, &[&record], "2026-05-01", 365).unwrap();
            warned += report.warnings.len();
            for (k, parameter) in ["ppm", "um"].iter().enumerate() {
                let found = report.effects[k].parameters.iter().find(|(n, _)| n == parameter).unwrap().1;
                inside[k] += u32::from((found.low..=found.high).contains(&truth[k]));
            }
        }
        eprintln!(
            "{name}: scale held in {} of 150, reversal in {}, said {warned} times",
            inside[0], inside[1]
        );
        assert!(inside.iter().all(|n| *n >= 138), "{name}: {inside:?}");
        assert!(said_of.contains(&warned), "{name}: {warned}");
    }
}

/// An effect whose response no record has is refused for that reason.
#[test]
fn an_effect_without_its_response_is_refused_by_name() {
    let record = run(&mut Dice(1), [10.0, 2.0], 0.1, |_, _| 0.0);
    for (effect, role) in [("inertia.x", "force.x"), ("scale.y", "error.y")] {
        let fitted = fit_named(&Machine::ideal("m"), &[effect.to_owned()], &[&record], "2026-05-01", 365);
        let said = fitted.unwrap_err().to_string();
        assert!(said.contains("no record with a response") && said.contains(role), "{said}");
    }
}
