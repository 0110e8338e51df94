//! Shapes outside the dictionary.

use crate::dice::Dice;
use crate::run::Run;
use crate::source::Source;
use std::f64::consts::{PI, TAU};

impl Source {
    /// A shape outside the dictionary; `c` is its free number.
    pub(crate) fn stranger(&self, run: &Run, a: &str) -> Vec<f64> {
        let n = run.n;
        let c = self.val("c");
        let col = |role: String| run.get(&role).map_or_else(|| vec![0.0; n], <[f64]>::to_vec);
        let p = unit(col(format!("position.{a}")));
        let v = unit_size(col(format!("velocity.{a}")));
        let t = unit(run.time());
        let d = run.dir(a);
        let sensor = self.word("sensor").map(|s| unit(run.named(s))).unwrap_or_default();
        let wider = self.wider(run, [&p, &t], &d);
        let shape: Vec<f64> = (0..n)
            .map(|i| match self.law() {
                "?dir_times_position" => d[i] * p[i],
                "?dir_times_wave" => d[i] * (PI * c * p[i]).sin(),
                "?time_wave" => (PI * c * (t[i] + 1.0)).sin(),
                "?time_burst" => (-((t[i] - c) / 0.12).powi(2)).exp(),
                "?time_saw" => (c * (t[i] + 1.0)).fract() - 0.5,
                "?speed_squared" | "?f_speed_squared" => v[i] * v[i].abs() - 0.77 * v[i],
                "?stribeck" | "?f_stribeck" => v[i].signum() * (-(v[i] / 0.15).powi(2)).exp(),
                "?f_cogging" => (PI * c * p[i]).sin(),
                "?f_position_friction" => p[i] * v[i].signum(),
                "?temperature_wave" => (PI * c * sensor[i]).sin(),
                "?temperature_knee" => (sensor[i] - c).max(0.0),
                "?angle_square" => {
                    let w = run.get("angle").unwrap_or_default();
                    (c * w[i]).sin().signum()
                }
                "?angle_saw" => {
                    let w = run.get("angle").unwrap_or_default();
                    (c * w[i] / TAU).rem_euclid(1.0) - 0.5
                }
                "?drifting_scale" => p[i] * t[i],
                "?position_time_wave" => p[i] * (PI * c * t[i]).sin(),
                "?load_squared" => {
                    let f = run.get(&format!("load.{a}")).unwrap_or_default();
                    let m = f.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
                    let z = f[i] / m;
                    z * z.abs() - 0.7 * z
                }
                "?saddle" => {
                    let b = run.get(&format!("position.{}", self.part(2))).unwrap_or_default();
                    let m = b.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
                    (PI * c * p[i]).sin() * (PI * b[i] / m).sin()
                }
                _ => wider[i],
            })
            .collect();
        shape.into_iter().map(|s| self.val("um") * s).collect()
    }

    /// Shapes of the wider classes.
    /// Position and time are scaled to −1 to 1. `c` is a period in rows, or the seed of their random numbers.
    fn wider(&self, run: &Run, [p, t]: [&[f64]; 2], d: &[f64]) -> Vec<f64> {
        let (n, c) = (run.n, self.val("c"));
        let mut dice = Dice::new(c as u64);
        let all = |f: &dyn Fn(usize) -> f64| (0..n).map(f).collect::<Vec<_>>();
        // Over the position, without the constant and the straight line, which are offset and scale.
        let bent = |f: &dyn Fn(f64) -> f64| {
            let y: Vec<f64> = p.iter().map(|x| f(*x)).collect();
            let (mp, my) = (p.iter().sum::<f64>() / n as f64, y.iter().sum::<f64>() / n as f64);
            let square: f64 = p.iter().map(|x| (x - mp).powi(2)).sum();
            let slope = p.iter().zip(&y).map(|(x, y)| (x - mp) * (y - my)).sum::<f64>() / square.max(1e-12);
            p.iter().zip(&y).map(|(x, y)| y - my - slope * (x - mp)).collect::<Vec<_>>()
        };
        let heat = |key: &str| self.word(key).map_or_else(|| vec![0.0; n], |s| unit(run.named(s)));
        let speed = |axis: &str| {
            let v = run.get(&format!("velocity.{axis}"));
            unit_size(v.map_or_else(|| vec![0.0; n], <[f64]>::to_vec))
        };
        // Time in rows, as if the record had no gap.
        let beat = || -> Vec<f64> {
            let time = run.time();
            let mut steps: Vec<f64> = time.windows(2).map(|w| w[1] - w[0]).collect();
            steps.sort_by(f64::total_cmp);
            let step = steps[steps.len() / 2].max(1e-9);
            time.iter().map(|t| (t - time[0]) / step / c).collect()
        };
        match self.law() {
            "?cycle_sine" => beat().iter().map(|b| (TAU * b).sin()).collect(),
            "?cycle_square" => beat().iter().map(|b| if b.fract() < 0.4 { 1.0 } else { -0.667 }).collect(),
            "?cycle_saw" => beat().iter().map(|b| b.fract() - 0.5).collect(),
            "?cycle_charge" => beat()
                .iter()
                .map(|b| {
                    // Charged in a third of the cycle and discharged in the rest, so that both ends meet.
                    let (x, up) = (b.fract(), 0.35);
                    let (rise, fall) = (1.0 - (-3.0_f64).exp(), (-3.0_f64).exp());
                    if x < up {
                        fall + rise * (1.0 - (-3.0 * x / up).exp()) - 0.5
                    } else {
                        (-3.0 * (x - up) / (1.0 - up)).exp() - 0.5
                    }
                })
                .collect(),
            "?chirp" => {
                let (slow, fast, phase) =
                    (dice.within(0.8, 2.5), dice.within(5.0, 14.0), dice.within(0.0, TAU));
                bent(&|x| {
                    let x = f64::midpoint(x, 1.0);
                    (TAU * (slow * x + (fast - slow) * x * x / 2.0) + phase).sin()
                })
            }
            "?waves" => {
                let many: Vec<[f64; 3]> = (0..dice.int(4, 6))
                    .map(|_| [dice.log(1.3, 12.0), dice.within(0.0, TAU), dice.within(0.6, 1.0)])
                    .collect();
                bent(&|x| many.iter().map(|[f, ph, g]| g * (TAU * f * (x + 1.0) / 2.0 + ph).sin()).sum())
            }
            "?kinks" => {
                let many: Vec<[f64; 2]> =
                    (0..dice.int(2, 4)).map(|_| [dice.within(-0.7, 0.7), dice.normal()]).collect();
                bent(&|x| many.iter().map(|[at, g]| g * (x - at).abs()).sum())
            }
            "?stairs" => {
                let many: Vec<[f64; 2]> =
                    (0..dice.int(2, 6)).map(|_| [dice.within(-0.8, 0.8), dice.normal()]).collect();
                bent(&|x| many.iter().map(|[at, g]| if x > *at { *g } else { 0.0 }).sum())
            }
            "?breathing" => {
                let many: Vec<[f64; 4]> = (0..dice.int(4, 7))
                    .map(|_| {
                        let height = dice.within(0.5, 1.5) * dice.sign();
                        [dice.within(-0.95, 0.8), dice.log(0.03, 0.1), dice.log(0.05, 0.2), height]
                    })
                    .collect();
                all(&|i| {
                    let pulse = |[at, rise, fall, g]: &[f64; 4]| {
                        let x = t[i] - at;
                        if x < 0.0 { 0.0 } else { g * (1.0 - (-x / rise).exp()) * (-x / fall).exp() }
                    };
                    many.iter().map(pulse).sum()
                })
            }
            "?place_two_sensors" => {
                let (a, b) = (heat("sensor"), heat("minus"));
                all(&|i| p[i] * a[i] * b[i])
            }
            "?hysteresis" => all(&|i| d.get(i).copied().unwrap_or(0.0) * (1.0 - 2.2 * p[i] * p[i])),
            "?one_way_wave" => {
                let (f, phase) = (dice.within(1.5, 5.0), dice.within(0.0, TAU));
                all(&|i| if d.get(i).is_some_and(|d| *d > 0.0) { (PI * f * p[i] + phase).sin() } else { 0.0 })
            }
            "?place_speed" => {
                let v = speed(self.part(1));
                all(&|i| p[i] * v[i])
            }
            "?dead_zone" => {
                let (a, c) = (heat("sensor"), dice.within(0.3, 0.6));
                all(&|i| a[i].signum() * (a[i].abs() - c).max(0.0))
            }
            "?cross_speed_squared" => speed(self.part(2)).iter().map(|v| v * v).collect(),
            "?ageing" => {
                let many: Vec<[f64; 3]> = (0..dice.int(5, 9))
                    .map(|_| [dice.within(-0.95, 0.9), dice.log(0.02, 0.15), dice.normal()])
                    .collect();
                all(&|i| {
                    let step = |[at, tau, g]: &[f64; 3]| {
                        if t[i] < *at { 0.0 } else { g * (1.0 - 0.7 * (-(t[i] - at) / tau).exp()) }
                    };
                    many.iter().map(step).sum()
                })
            }
            _ => vec![0.0; n],
        }
    }
}

/// Values scaled to −1 to 1.
fn unit(v: Vec<f64>) -> Vec<f64> {
    let (lo, hi) = v.iter().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
    v.into_iter().map(|x| if hi > lo { 2.0 * (x - lo) / (hi - lo) - 1.0 } else { 0.0 }).collect()
}

fn unit_size(v: Vec<f64>) -> Vec<f64> {
    let m = v.iter().fold(1e-9_f64, |m, x| m.max(x.abs()));
    v.into_iter().map(|x| x / m).collect()
}
