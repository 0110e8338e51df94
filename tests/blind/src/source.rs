//! The error that each source adds to a run.
//!
//! The formulas are written from the file format's table alone, and share nothing with the code under test.

use crate::dice::Dice;
use crate::run::Run;
use std::f64::consts::{PI, TAU};

/// An error source of the true machine.
#[derive(Clone, Debug)]
pub struct Source {
    /// Name that the answer must give; a shape outside the dictionary has a `?`.
    pub name: String,
    /// Parameters with one value, by name.
    pub num: Vec<(&'static str, f64)>,
    /// Parameters with one value per knot.
    pub arr: Vec<(&'static str, Vec<f64>)>,
    /// Names of the sensors, by key (`sensor`, `minus`).
    pub text: Vec<(&'static str, String)>,
}

impl Source {
    pub(crate) fn new(name: String) -> Self {
        Self { name, num: vec![], arr: vec![], text: vec![] }
    }
    pub(crate) fn p(mut self, key: &'static str, v: f64) -> Self {
        self.num.push((key, v));
        self
    }
    /// Value of a parameter with one value; 0 where it is missing.
    pub fn val(&self, key: &str) -> f64 {
        self.num.iter().find(|(k, _)| *k == key).map_or(0.0, |(_, v)| *v)
    }
    pub(crate) fn has(&self, key: &str) -> bool {
        self.num.iter().any(|(k, _)| *k == key)
    }
    pub(crate) fn array(&self, key: &str) -> &[f64] {
        self.arr.iter().find(|(k, _)| *k == key).map_or(&[], |(_, v)| &v[..])
    }
    pub(crate) fn word(&self, key: &str) -> Option<&str> {
        self.text.iter().find(|(k, _)| *k == key).map(|(_, v)| &v[..])
    }
    pub(crate) fn law(&self) -> &str {
        self.name.split('.').next().unwrap_or("")
    }
    pub(crate) fn part(&self, i: usize) -> &str {
        self.name.split('.').nth(i).unwrap_or("")
    }
    /// Keys of the parameters that scale the effect's size.
    fn sizes(&self) -> Vec<&'static str> {
        self.num
            .iter()
            .map(|(k, _)| *k)
            .filter(|k| {
                ![
                    "period_mm",
                    "period_um",
                    "phase_rad",
                    "length_mm",
                    "tau_s",
                    "at_s",
                    "lobes",
                    "centre_rad",
                    "width_rad",
                    "reference_degC",
                    "c",
                ]
                .contains(k)
            })
            .collect()
    }
    /// Scales the effect by a factor.
    pub fn scale(&mut self, by: f64) {
        let sizes = self.sizes();
        for (k, v) in &mut self.num {
            if sizes.contains(k) {
                *v *= by;
            }
        }
        for (k, v) in &mut self.arr {
            if *k == "um" {
                v.iter_mut().for_each(|v| *v *= by);
            }
        }
    }
    /// Makes its parameters slightly wrong, as in a model that was fitted earlier.
    pub fn off(&mut self, dice: &mut Dice, share: f64) {
        let sizes = self.sizes();
        for (k, v) in &mut self.num {
            match *k {
                "period_mm" | "period_um" => *v *= 1.0 + 1e-4 * dice.normal(),
                "phase_rad" => *v += share * dice.normal(),
                "at_s" | "lobes" | "reference_degC" => {}
                "centre_rad" => *v += 0.1 * share * dice.normal(),
                _ if sizes.contains(k) || *k == "tau_s" || *k == "length_mm" || *k == "width_rad" => {
                    *v *= 1.0 + share * dice.normal();
                }
                _ => {}
            }
        }
        if let [_, (_, um)] = &mut self.arr[..] {
            let by = 1.0 + share * dice.normal();
            um.iter_mut().for_each(|v| *v *= by);
        }
    }

    /// Subtracts a map's constant and straight line, which are other effects.
    /// They are taken over the rows that show the map.
    pub fn level(&mut self, runs: &[Run]) {
        let (response, along) =
            (format!("error.{}", self.part(1)), self.name.rsplit('.').next().unwrap_or(""));
        let role = format!("position.{along}");
        let [(_, knots), (_, um)] = &mut self.arr[..] else { return };
        let places = |response: &str| -> Vec<f64> {
            let shown = runs.iter().filter(|r| r.responses.iter().any(|own| own == response));
            shown.filter_map(|r| r.get(&role)).flatten().copied().collect()
        };
        let mut p = places(&response);
        if p.is_empty() {
            // Along a bar the error counts as it is, not by the axis's share.
            p = places("error.r");
        }
        if p.is_empty() {
            return;
        }
        let n = p.len() as f64;
        let middle = p.iter().sum::<f64>() / n;
        // Beyond its knots a map is constant, and so is a line that is subtracted from its heights.
        let sums = |heights: &[f64]| {
            let at: Vec<f64> = p.iter().map(|p| broken_line(knots, heights, *p)).collect();
            let turned = p.iter().zip(&at).map(|(p, e)| (p - middle) * e).sum::<f64>();
            [at.iter().sum::<f64>() / n, turned]
        };
        let rising: Vec<f64> = knots.iter().map(|k| k - middle).collect();
        let ([mean, turned], [own_mean, own_turned]) = (sums(um), sums(&rising));
        let slope = if own_turned > 0.0 { turned / own_turned } else { 0.0 };
        for (u, k) in um.iter_mut().zip(&rising) {
            *u -= mean + slope * (k - own_mean);
        }
    }
    /// The source as `[[effect]]` of a model.
    pub fn toml(&self) -> String {
        let mut s = format!("[[effect]]\nname = \"{}\"\n", self.name);
        for (k, v) in &self.text {
            s += &format!("{k} = \"{v}\"\n");
        }
        for (k, v) in &self.num {
            if *k == "lobes" {
                s += &format!("{k} = {}\n", *v as i64);
            } else {
                s += &format!("{k} = {v:?}\n");
            }
        }
        for (k, v) in &self.arr {
            s += &format!("{k} = {v:?}\n");
        }
        s + "\n"
    }

    /// The source in one line.
    pub(crate) fn in_words(&self) -> String {
        self.toml().replace("[[effect]]\nname = ", "").replace('\n', " ")
    }

    fn delta(&self, run: &Run) -> Vec<f64> {
        let a = run.named(self.word("sensor").unwrap_or(""));
        if let Some(m) = self.word("minus") {
            a.iter().zip(run.named(m)).map(|(a, b)| a - b).collect()
        } else {
            let reference = self.num.iter().find(|(k, _)| *k == "reference_degC").map_or(20.0, |(_, v)| *v);
            a.iter().map(|a| a - reference).collect()
        }
    }

    /// Error that this source adds to one response over a run.
    pub fn on(&self, run: &Run, response: &str) -> Vec<f64> {
        let n = run.n;
        let zero = vec![0.0; n];
        let axis = response.split('.').nth(1).unwrap_or("");
        if let (Some((_, plane)), "r", false) = (&run.bar, axis, self.part(1).is_empty()) {
            let angle = run.get("angle").unwrap_or_default();
            let [a, b] = [0, 1].map(|k| self.on(run, &format!("error.{}", plane[k])));
            return (0..n).map(|i| a[i] * angle[i].cos() + b[i] * angle[i].sin()).collect();
        }
        let force = response.starts_with("force");
        let a = self.part(1);
        let col = |role: String| run.get(&role).map_or_else(|| vec![0.0; n], <[f64]>::to_vec);
        let pos = |ax: &str| col(format!("position.{ax}"));
        let vel = |ax: &str| col(format!("velocity.{ax}"));
        let law = self.law();
        let is_force = law.starts_with("friction")
            || law.starts_with("inertia")
            || law == "force_offset"
            || law.starts_with("?f");
        if is_force != force {
            return zero;
        }
        if law == "rotation" {
            let other = if axis == a { self.part(2) } else { a };
            if axis != a && axis != self.part(2) {
                return zero;
            }
            let s = if axis == a { -1.0 } else { 1.0 };
            return pos(other).iter().map(|p| s * self.val("urad") * p / 1000.0).collect();
        }
        if !a.is_empty() && axis != a {
            return zero;
        }
        // Without a known direction there is no reversal.
        if law.starts_with("reversal") && run.dir(a).len() != n {
            return zero;
        }
        let map = |v: Vec<f64>, f: &dyn Fn(f64) -> f64| v.into_iter().map(f).collect::<Vec<_>>();
        match law {
            "offset" => vec![self.val("um"); n],
            "scale" => map(pos(a), &|p| self.val("ppm") * p / 1000.0),
            "position_map" => map(pos(a), &|p| broken_line(self.array("knots_mm"), self.array("um"), p)),
            "straightness" => {
                map(pos(self.part(2)), &|p| broken_line(self.array("knots_mm"), self.array("um"), p))
            }
            "screw_periodic" => map(pos(a), &|p| {
                self.val("um") * (TAU * p / self.val("period_mm") + self.val("phase_rad")).sin()
            }),
            "subdivision" => map(pos(a), &|p| {
                self.val("um") * (TAU * p * 1000.0 / self.val("period_um") + self.val("phase_rad")).sin()
            }),
            "reversal" => map(run.dir(a), &|d| self.val("um") * d / 2.0),
            "reversal_spike" => {
                let (p, d) = (pos(a), run.dir(a));
                let mut since: Option<f64> = None;
                (0..n)
                    .map(|i| {
                        if i > 0 && d[i] * d[i - 1] < 0.0 {
                            since = Some(0.0);
                        }
                        since = since.map(|way| way + (p[i] - p[i - 1]).abs());
                        since.map_or(0.0, |way| self.val("um") * d[i] * (-way / self.val("length_mm")).exp())
                    })
                    .collect()
            }
            "squareness" => map(pos(self.part(2)), &|p| self.val("urad") * p / 1000.0),
            "angular" => pos(self.part(2))
                .iter()
                .zip(pos(self.part(3)))
                .map(|(b, c)| self.val("urad_per_m") * b * c / 1e6)
                .collect(),
            "thermal_expansion" => self
                .delta(run)
                .iter()
                .zip(pos(a))
                .map(|(d, p)| self.val("ppm_per_K") * d * p / 1000.0)
                .collect(),
            "thermal_growth" => {
                map(self.delta(run), &|d| self.val("um_per_K") * d + self.val("um_per_K2") * d * d)
            }
            "thermal_lag" => {
                // The exact response of the lag to a straight line between two rows.
                let (d, t, tau) = (self.delta(run), run.time(), self.val("tau_s"));
                let mut y = d[0];
                (0..n)
                    .map(|i| {
                        if i > 0 && t[i] > t[i - 1] {
                            let h = t[i] - t[i - 1];
                            let k = (d[i] - d[i - 1]) / h;
                            y = (d[i] - k * tau) + (y - d[i - 1] + k * tau) * (-h / tau).exp();
                        }
                        self.val("um_per_K") * y + self.val("um_per_K2") * y * y
                    })
                    .collect()
            }
            "warm_up" => map(run.time(), &|t| self.val("um") * (1.0 - (-t / self.val("tau_s")).exp())),
            "coolant" => map(col("coolant".into()), &|w| if w > 0.5 { self.val("um") } else { 0.0 }),
            "spindle_speed" => map(col("spindle_speed".into()), &|r| {
                let k = r / 1000.0;
                self.val("um_per_krpm") * k + self.val("um_per_krpm2") * k * k
            }),
            "following_error" => map(vel(a), &|v| self.val("ms") * v),
            "acceleration_error" => {
                map(col(format!("acceleration.{a}")), &|v| self.val("um_per_m_s2") * v / 1000.0)
            }
            "stiffness" => map(col(format!("load.{a}")), &|f| self.val("um_per_N") * f),
            "lost_counts" => map(run.time(), &|t| if t >= self.val("at_s") { self.val("um") } else { 0.0 }),
            "probe_latency" => map(vel(a), &|v| self.val("us") * v / 1000.0),
            "probe_lobing" => map(col("angle".into()), &|w| {
                self.val("um") * (self.val("lobes") * w + self.val("phase_rad")).cos()
            }),
            "form_bump" => map(col("angle".into()), &|w| {
                let d = (w - self.val("centre_rad") + PI).rem_euclid(TAU) - PI;
                if d.abs() > self.val("width_rad") / 2.0 {
                    0.0
                } else {
                    self.val("um") * (1.0 + (TAU * d / self.val("width_rad")).cos()) / 2.0
                }
            }),
            "channel" => map(run.named(self.part(2)), &|z| self.val("gain") * z),
            "inertia" => map(col(format!("acceleration.{a}")), &|v| self.val("kg") * v / 1000.0),
            "friction_viscous" => map(vel(a), &|v| self.val("N_s_per_m") * v / 1000.0),
            "friction_coulomb" => map(vel(a), &|v| if v == 0.0 { 0.0 } else { self.val("N") * v.signum() }),
            "friction_asymmetric" => map(vel(a), &|v| self.val("N_s_per_m") * v.abs() / 1000.0),
            "force_offset" => vec![self.val("N"); n],
            _ => self.stranger(run, a),
        }
    }
}

pub(crate) fn broken_line(x: &[f64], y: &[f64], at: f64) -> f64 {
    if at <= x[0] {
        return y[0];
    }
    for k in 1..x.len() {
        if at <= x[k] {
            return y[k - 1] + (y[k] - y[k - 1]) * (at - x[k - 1]) / (x[k] - x[k - 1]);
        }
    }
    y[y.len() - 1]
}

/// Subtracts the constant and the straight line from values at knots.
pub(crate) fn flatten(x: &[f64], y: &mut [f64]) {
    let n = x.len() as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let sxx: f64 = x.iter().map(|v| (v - mx).powi(2)).sum();
    let sxy: f64 = x.iter().zip(y.iter()).map(|(a, b)| (a - mx) * (b - my)).sum();
    for (a, b) in x.iter().zip(y) {
        *b -= my + sxy / sxx * (a - mx);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A levelled map has no constant or straight line over the measured rows.
    /// That holds wherever the map's knots end. Regression: a case hid a scale with a map, and the truth did not list
    /// it.
    #[test]
    fn a_level_map_has_no_line_over_its_rows() {
        let p: Vec<f64> = (0..60).map(|i| f64::from(i * i % 61) - 20.0).collect();
        for (from, to) in [(-30.0, 50.0), (0.0, 30.0), (10.0, 15.0)] {
            for (response, role) in [("error.x", "position.x"), ("error.r", "position.x")] {
                let mut run = Run { responses: vec![response.into()], ..Run::default() };
                run.add("p", role, "mm", p.clone(), response == "error.x");
                let mut map = Source::new("position_map.x".into());
                let knots: Vec<f64> = (0..5).map(|k| from + (to - from) * f64::from(k) / 4.0).collect();
                map.arr = vec![("knots_mm", knots), ("um", vec![3.0, -1.0, 7.0, 2.0, 9.0])];
                map.level(&[run]);
                let [(_, knots), (_, um)] = &map.arr[..] else { panic!("two arrays") };
                let at: Vec<f64> = p.iter().map(|p| broken_line(knots, um, *p)).collect();
                let (mean, middle) = (at.iter().sum::<f64>() / 60.0, p.iter().sum::<f64>() / 60.0);
                let turned: f64 = p.iter().zip(&at).map(|(p, e)| (p - middle) * e).sum();
                assert!(mean.abs() < 1e-12 && turned.abs() < 1e-9, "{response} {from}: {mean} {turned}");
                assert!(um.iter().any(|u| u.abs() > 0.5));
            }
        }
    }
}
