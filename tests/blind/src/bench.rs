//! Experiments with the irregularities of real ones.
//! Targets are coarse and uneven, records have gaps, sensors have noise, and several records share one clock.

use crate::choose::Places;
use crate::dice::Dice;
use crate::run::Run;
use std::f64::consts::TAU;

/// Kind of an experiment.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Kind {
    /// One axis, with targets up and down.
    Line,
    /// Gauges at standstill during warm-up.
    Drift,
    /// Errors of two axes over their plane.
    Plate,
    /// Circles, with the errors of both axes.
    Circle,
    /// Circles with a ballbar: the error along the bar.
    Radial,
}

/// Settings of an experiment.
/// Another `turn` of the same bench is another run.
#[derive(Clone, Debug)]
pub struct Bench {
    /// Kind of the experiment.
    pub kind: Kind,
    /// Axes: the first is measured, the second spans the plane with it.
    pub axes: [String; 3],
    /// Wanted number of rows.
    pub rows: usize,
    /// Length of the first axis, mm.
    pub travel_mm: f64,
    /// Clock of the first row, s.
    pub start_s: f64,
    /// Name of the gauges' zero, if the record has its own.
    pub zero: Option<String>,
    /// Arrangement of its places.
    pub places: Places,
    seed: u64,
    targets: usize,
    centred: bool,
    clock: bool,
    dwell_s: f64,
    pub(crate) responses: usize,
    pub(crate) gaps: usize,
    pub(crate) speeds: bool,
    pub(crate) wet: Option<f64>,
    rig: Option<Heat>,
    decoys: usize,
}

/// Heat of a spindle and a drive, and the sensors that read it.
/// The heat flows through first-order elements to the sensors.
#[derive(Clone, Debug)]
pub struct Heat {
    seed: u64,
    /// Number of sensors.
    pub sensors: usize,
    /// Noise of the sensors, K.
    pub noise_k: f64,
    /// Step of the sensors' readings, K; 0 for none.
    pub step_k: f64,
}

impl Heat {
    /// Random heat sources and sensors.
    pub fn new(dice: &mut Dice) -> Self {
        Self {
            seed: dice.seed(),
            sensors: dice.int(2, 6),
            noise_k: dice.within(0.01, 0.03),
            step_k: if dice.chance(0.4) { 0.0625 } else { 0.0 },
        }
    }

    /// Load of spindle and drive over a time span, 0 to 1.
    /// It has ramps, cycles, duty cycles or stairs.
    fn load(dice: &mut Dice, t: &[f64], span: f64, t0: f64) -> Vec<f64> {
        let kind = dice.int(0, 3);
        let (rate, phase, duty) = (dice.log(0.8, 6.0), dice.unit(), dice.within(0.25, 0.75));
        let stairs: Vec<f64> =
            (0..12).map(|_| if dice.chance(0.3) { 0.0 } else { dice.within(0.2, 1.0) }).collect();
        t.iter()
            .map(|t| {
                let s = (t - t0) / span;
                let cycle = (rate * s + phase).rem_euclid(1.0);
                match kind {
                    0 => (2.0 * s).clamp(0.0, 1.0),
                    1 => 0.5 - 0.5 * (TAU * cycle).cos(),
                    2 => f64::from(u8::from(cycle < duty)),
                    _ => stairs[((s * 9.0).max(0.0) as usize).min(11)],
                }
            })
            .collect()
    }

    /// Adds the sensors to a run, and the true temperatures, which are not logged.
    /// Returns the loads of spindle and drive.
    fn on(&self, r: &mut Run, t: &[f64], dice: &mut Dice) -> Vec<f64> {
        let mut fixed = Dice::new(self.seed);
        let (t0, span) = (t[0], (t[t.len() - 1] - t[0]).max(1.0));
        let spindle = Self::load(dice, t, span, t0);
        let drive = Self::load(dice, t, span, t0);
        let room = fixed.within(18.5, 23.0);
        let (swing, phase) = (fixed.within(0.1, 1.2), dice.within(0.0, TAU));
        let ambient: Vec<f64> =
            t.iter().map(|t| room + swing * (TAU * 0.6 * (t - t0) / span + phase).sin()).collect();
        let mut before: Vec<f64> = spindle.clone();
        for k in 0..self.sensors {
            let (tau, gain, part) =
                (span * fixed.log(0.02, 0.4), fixed.within(0.5, 1.1), fixed.within(0.0, 0.5));
            let reach = fixed.within(3.0, 10.0);
            let input: Vec<f64> =
                before.iter().zip(&drive).map(|(b, d)| gain * ((1.0 - part) * b + part * d)).collect();
            // A second body at the spindle, or one that the body before it warms.
            if fixed.chance(0.6) {
                let mut x = input[0] * dice.unit();
                before = (0..t.len())
                    .map(|i| {
                        if i > 0 {
                            x += (input[i] - x) * (1.0 - (-(t[i] - t[i - 1]) / tau).exp());
                        }
                        x
                    })
                    .collect();
            }
            let own = k + 1 == self.sensors && fixed.chance(0.6);
            let real: Vec<f64> = ambient
                .iter()
                .zip(&before)
                .map(|(a, x)| if own { *a } else { a + reach * x / 0.6_f64.powi(k as i32).max(0.2) * 0.5 })
                .collect();
            let read = real
                .iter()
                .map(|v| {
                    let v = v + self.noise_k * dice.normal();
                    if self.step_k > 0.0 {
                        (v / self.step_k).round() * self.step_k
                    } else {
                        (v * 1000.0).round() / 1000.0
                    }
                })
                .collect();
            let name = format!("T{}", k + 1);
            r.add(&name, "temperature", "degC", read, true);
            r.true_degc.push((name, real));
        }
        spindle
    }
}

impl Bench {
    /// A random bench of a kind; `rig` adds sensors.
    pub fn new(dice: &mut Dice, kind: Kind, rows: usize, rig: Option<Heat>) -> Self {
        let mut axes = ["x", "y", "z"].map(str::to_owned);
        if kind != Kind::Radial {
            let shift = dice.int(0, 2);
            axes.rotate_left(shift);
        }
        let regular = dice.chance(0.4);
        Self {
            kind,
            axes,
            rows,
            travel_mm: (dice.log(80.0, 1200.0) / 5.0).round() * 5.0,
            start_s: 0.0,
            zero: None,
            places: Places { regular, sweep: false },
            seed: dice.seed(),
            targets: dice.int(6, 31),
            centred: dice.chance(0.5),
            clock: dice.chance(0.85),
            dwell_s: dice.log(2.0, 40.0),
            responses: dice.int(1, 3),
            gaps: if dice.chance(0.3) { dice.int(1, 3) } else { 0 },
            speeds: dice.chance(0.5),
            wet: dice.chance(0.3).then(|| dice.log(8.0, 80.0)),
            rig,
            decoys: dice.int(0, 3),
        }
    }

    /// The same with a time column, and with `responses` error columns at standstill.
    #[must_use]
    pub fn on_the_clock(mut self, responses: usize) -> Self {
        (self.clock, self.responses) = (true, responses);
        self
    }

    /// The same with `targets` targets.
    #[must_use]
    pub fn with_targets(mut self, targets: usize, regular: bool) -> Self {
        self.targets = targets;
        self.places = Places { regular, sweep: targets > 60 };
        self
    }

    /// Start of its travel, mm.
    pub fn from_mm(&self) -> f64 {
        if self.centred { -self.travel_mm / 2.0 } else { 0.0 }
    }

    /// One run of the bench.
    pub fn run(&self, turn: u64) -> Run {
        let mut fixed = Dice::new(self.seed);
        let mut dice = Dice::new(self.seed ^ (turn + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let mut r = Run { zero: self.zero.clone(), ..Run::default() };
        match self.kind {
            Kind::Line => self.line(&mut r, &mut fixed, &mut dice),
            Kind::Drift => self.drift(&mut r, &mut dice),
            Kind::Plate => self.plate(&mut r, &mut fixed, &mut dice),
            Kind::Circle | Kind::Radial => self.circle(&mut r),
        }
        let t: Vec<f64> = (0..r.n).map(|i| i as f64 * self.dwell_s).collect();
        let t = r.get("time").map_or(t, <[f64]>::to_vec);
        if let Some(rig) = &self.rig {
            let spindle = rig.on(&mut r, &t, &mut dice);
            if self.kind == Kind::Drift {
                let rpm = spindle.iter().map(|s| (12.0 * s).round() * 500.0).collect();
                r.add("rpm", "spindle_speed", "rpm", rpm, true);
            }
        }
        if let Some(period) = self.wet {
            let phase = dice.unit();
            // The pump follows the clock, which continues in the gaps of the record.
            let usual = self.dwell_s.max(1e-6);
            let beat = if self.clock { t.iter().map(|t| t / usual).collect() } else { rows(r.n) };
            let wet = beat.iter().map(|b| f64::from(u8::from((b / period + phase).fract() > 0.5))).collect();
            r.add("wet", "coolant", "1", wet, true);
        }
        for k in 0..self.decoys {
            let smooth = fixed.within(0.0, 0.98);
            let mut x = dice.normal();
            let v = (0..r.n)
                .map(|_| {
                    x = smooth * x + (1.0 - smooth * smooth).sqrt() * dice.normal();
                    (x * 1e4).round() / 1e4
                })
                .collect();
            r.add(&format!("aux{k}"), "channel", "1", v, true);
        }
        r
    }

    /// Times of `n` rows, s, with the gaps of the record.
    fn time(&self, n: usize, dice: &mut Dice) -> Vec<f64> {
        let mut t = self.start_s;
        let breaks: Vec<usize> = (0..self.gaps).map(|_| dice.int(n / 10, n - 1)).collect();
        (0..n)
            .map(|i| {
                if breaks.contains(&i) {
                    t += self.dwell_s * dice.log(5.0, 60.0);
                }
                let now = (t * 10.0).round() / 10.0;
                t += self.dwell_s * dice.within(0.9, 1.1);
                now
            })
            .collect()
    }

    fn line(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let a = &self.axes[0];
        r.kind = "positioning";
        r.responses = vec![format!("error.{a}")];
        let step = self.travel_mm / (self.targets - 1) as f64;
        let at: Vec<f64> = (0..self.targets)
            .map(|i| {
                let off = if self.places.regular { 0.0 } else { fixed.within(-0.4, 0.4) };
                ((self.from_mm() + step * (i as f64 + off)) * 1000.0).round() / 1000.0
            })
            .collect();
        let cycles = (self.rows / (2 * self.targets)).max(1);
        let (mut p, mut d, mut v, mut c) = (vec![], vec![], vec![], vec![]);
        for cycle in 0..cycles {
            let feed = *dice.pick(&[5.0, 10.0, 20.0, 40.0]);
            for (dir, order) in [(1.0, at.clone()), (-1.0, at.iter().rev().copied().collect::<Vec<_>>())] {
                for q in order {
                    p.push(((q + 0.003 * dice.normal()) * 1e4).round() / 1e4);
                    d.push(dir);
                    v.push(feed * dir);
                    c.push(cycle as f64 + 1.0);
                }
            }
        }
        let t = self.time(p.len(), dice);
        r.add("t", "time", "s", t, self.clock);
        r.add(&format!("pos_{a}"), &format!("position.{a}"), "mm", p, true);
        r.add("dir", &format!("direction.{a}"), "1", d, true);
        if self.speeds {
            r.add("feed", &format!("velocity.{a}"), "mm/s", v, true);
        }
        if cycles > 1 {
            r.add("n", "cycle", "1", c, true);
        }
    }

    fn drift(&self, r: &mut Run, dice: &mut Dice) {
        r.kind = "drift";
        r.responses = self.axes.iter().take(self.responses).map(|a| format!("error.{a}")).collect();
        let t = self.time(self.rows, dice);
        r.add("t", "time", "s", t, self.clock);
    }

    fn plate(&self, r: &mut Run, fixed: &mut Dice, dice: &mut Dice) {
        let (a, b) = (&self.axes[0], &self.axes[1]);
        r.kind = "plate";
        r.responses = vec![format!("error.{a}"), format!("error.{b}")];
        r.responses.truncate(self.responses);
        let m = (self.rows as f64).sqrt() as usize;
        let jitter = if self.places.regular { 0.0 } else { 0.3 };
        let grid = |fixed: &mut Dice| -> Vec<f64> {
            (0..m)
                .map(|i| {
                    let i = i as f64 + jitter * fixed.within(-1.0, 1.0);
                    ((self.from_mm() + self.travel_mm * i / (m - 1) as f64) * 1000.0).round() / 1000.0
                })
                .collect()
        };
        let (x, y) = (grid(fixed), grid(fixed));
        let place = |k: usize| (k / m, if (k / m).is_multiple_of(2) { k % m } else { m - 1 - k % m });
        let n = m * m;
        let t = self.time(n, dice);
        r.add("t", "time", "s", t, self.clock);
        let pick = |f: &dyn Fn(usize) -> f64| (0..n).map(f).collect::<Vec<_>>();
        r.add("X", &format!("position.{a}"), "mm", pick(&|k| x[place(k).0]), true);
        r.add("Y", &format!("position.{b}"), "mm", pick(&|k| y[place(k).1]), true);
    }

    fn circle(&self, r: &mut Run) {
        let (a, b) = (&self.axes[0], &self.axes[1]);
        r.kind = "ballbar";
        let radial = self.kind == Kind::Radial;
        let radius = *[50.0, 100.0, 150.0, 300.0]
            .iter()
            .rfind(|r| 2.0 * **r <= self.travel_mm.max(100.0))
            .unwrap_or(&50.0);
        r.responses = vec![format!("error.{a}"), format!("error.{b}")];
        if radial {
            r.responses = vec!["error.r".into()];
            r.bar = Some((radius, [a.clone(), b.clone()]));
        }
        let feeds: &[f64] = if self.speeds { &[15.0, 50.0] } else { &[30.0] };
        let passes = 2 * feeds.len();
        let m = (self.rows / passes).max(30);
        let mut cols: [Vec<f64>; 9] = Default::default();
        let mut now = self.start_s;
        for pass in 0..passes {
            let turn = if pass % 2 == 0 { 1.0 } else { -1.0 };
            let w = turn * feeds[pass / 2] / radius;
            for i in 0..m {
                let th: f64 = turn * TAU * 1.05 * i as f64 / m as f64 + 0.4;
                let (s, c) = th.sin_cos();
                let row = [
                    now,
                    radius * c,
                    radius * s,
                    -radius * w * s,
                    radius * w * c,
                    -radius * w * w * c,
                    -radius * w * w * s,
                    th.rem_euclid(TAU),
                    pass as f64 + 1.0,
                ];
                cols.iter_mut().zip(row).for_each(|(c, v)| c.push(v));
                now += TAU * 1.05 / m as f64 / w.abs();
            }
            now += 5.0;
        }
        let [t, x, y, vx, vy, ax, ay, th, pass] = cols;
        r.add("t", "time", "s", t, self.clock);
        r.add("x", &format!("position.{a}"), "mm", x, !radial);
        r.add("y", &format!("position.{b}"), "mm", y, !radial);
        r.add("vx", &format!("velocity.{a}"), "mm/s", vx, true);
        r.add("vy", &format!("velocity.{b}"), "mm/s", vy, true);
        if !radial && self.centred {
            r.add("ax", &format!("acceleration.{a}"), "mm/s2", ax, true);
            r.add("ay", &format!("acceleration.{b}"), "mm/s2", ay, true);
        }
        if radial {
            r.add("ang", "angle", "rad", th, true);
        }
        r.add("pass", "cycle", "1", pass, true);
    }
}

fn rows(n: usize) -> Vec<f64> {
    (0..n).map(|i| i as f64).collect()
}
