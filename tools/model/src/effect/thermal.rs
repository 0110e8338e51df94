//! `thermal_expansion.A`, `thermal_growth.A`, `thermal_lag.A`: what a temperature difference does, per length, at a point,
//! and at a point that follows the sensor late.

use super::{Bound, Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State};
use std::sync::Arc;

#[derive(Debug)]
struct Expansion(Card);
#[derive(Debug)]
struct Growth(Card);
#[derive(Debug)]
struct Lag(Card);

impl Law for Expansion {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        out[0] = effect.bounded(now.delta_k) * now.p_mm[0] / 1000.0;
    }
}

impl Law for Growth {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        let d = effect.bounded(now.delta_k);
        out[0] = d;
        out[1] = d * d;
    }

    fn basis_rows(&self, effect: &Effect, bound: &Bound<'_>, _: usize, out: Out<'_>) {
        let (first, second) = out.split_at_mut(bound.rows);
        for (row, (a, b)) in first.iter_mut().zip(second).enumerate() {
            *a = effect.bounded(bound.delta_k(row));
            *b = *a * *a;
        }
    }
}

const TAU: usize = 2;

/// What a first-order lag does over one step of time.
#[derive(Debug, Clone, Copy, Default)]
struct Decay {
    h_s: f64,
    /// 1 − exp(−h/τ).
    gone: f64,
}

impl Decay {
    fn over(h_s: f64, tau_s: f64) -> Self {
        Self { h_s, gone: -(-h_s / tau_s).exp_m1() }
    }

    /// The lagged value after the step, exact for an input that is linear from u0 to u:
    /// y = u − s·τ·(1 − E) + (y0 − u0)·E, E = exp(−h/τ), s its slope.
    fn step(self, tau_s: f64, [y0, u0, u]: [f64; 3]) -> f64 {
        let s = (u - u0) / self.h_s;
        u - s * tau_s * self.gone + (y0 - u0) * (1.0 - self.gone)
    }

    /// The derivative by tau after the step.
    fn step_slope(self, tau_s: f64, dy0: f64, [y0, u0, u]: [f64; 3]) -> f64 {
        let e = 1.0 - self.gone;
        let de = e * self.h_s / (tau_s * tau_s);
        let s = (u - u0) / self.h_s;
        -s * self.gone + s * tau_s * de + dy0 * e + (y0 - u0) * de
    }
}

/// The last few steps of different lengths: a record's rows are a step apart, but for rounding.
#[derive(Default)]
struct Decays([Decay; 8]);

impl Decays {
    fn over(&mut self, h_s: f64, tau_s: f64) -> Decay {
        let place = &mut self.0[(h_s.to_bits().wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 61) as usize];
        if place.h_s.to_bits() != h_s.to_bits() {
            *place = Decay::over(h_s, tau_s);
        }
        *place
    }
}

/// State of the lag: lagged ΔT, its derivative by tau, the input and the time of the instant before.
fn advance(tau_s: f64, now: &Input, state: &mut State) -> (f64, f64) {
    let u = now.delta_k;
    if !state.started {
        *state = State { started: true, x: [u, 0.0, u, now.t_s] };
        return (u, 0.0);
    }
    let [mut y, mut dy, u0, t0] = state.x;
    let h = now.t_s - t0;
    if h > 0.0 {
        let decay = Decay::over(h, tau_s);
        dy = decay.step_slope(tau_s, dy, [y, u0, u]);
        y = decay.step(tau_s, [y, u0, u]);
    }
    state.x = [y, dy, u, now.t_s];
    (y, dy)
}

impl Law for Lag {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, state: &mut State, out: Out<'_>) {
        let (y, _) = advance(effect.scalar(TAU), now, state);
        let y = effect.bounded(y);
        out[0] = y;
        out[1] = y * y;
    }

    fn basis_rows(&self, effect: &Effect, bound: &Bound<'_>, _: usize, out: Out<'_>) {
        let tau_s = effect.scalar(TAU);
        let (first, second) = out.split_at_mut(bound.rows);
        let mut decays = Decays::default();
        let [mut y, mut u0, mut t0] = [0.0; 3];
        for (row, (a, b)) in first.iter_mut().zip(second).enumerate() {
            let (u, t) = (bound.delta_k(row), bound.t[row]);
            if row == 0 {
                y = u;
            } else if t > t0 {
                y = decays.over(t - t0, tau_s).step(tau_s, [y, u0, u]);
            }
            (u0, t0) = (u, t);
            let inside = effect.bounded(y);
            *a = inside;
            *b = inside * inside;
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, state: &mut State, out: Out<'_>) {
        let (y, dy) = advance(effect.scalar(TAU), now, state);
        let inside = effect.bounded(y);
        out[0] = inside;
        out[1] = inside * inside;
        let moved = if inside.to_bits() == y.to_bits() { dy } else { 0.0 };
        out[TAU] = (effect.scalar(0) + 2.0 * effect.scalar(1) * y) * moved;
    }
}

pub(super) fn laws(laws: &mut Vec<Arc<dyn Law>>) {
    let growth = || {
        vec![
            Parameter::linear("um_per_K", "um/K", 100.0),
            Parameter::linear("um_per_K2", "um/K2", 10.0).or(0.0),
        ]
    };
    let card = |name: &str, law: &str, parameters, needs, cause: &str, experiment: &str| Card {
        name: name.to_owned(),
        law: law.to_owned(),
        cause: cause.to_owned(),
        naming: Naming::One,
        quantity: Quantity::Error,
        parameters,
        needs,
        experiment: experiment.to_owned(),
    };
    laws.push(Arc::new(Expansion(card(
        "thermal_expansion",
        "e = ppm_per_K·ΔT·p/1000",
        vec![Parameter::linear("ppm_per_K", "ppm/K", 50.0)],
        vec![Need::Delta, Need::Position(0)],
        "scale, screw or work longer than at the reference temperature",
        "linear displacement over the whole travel, cold and warm (ISO 230-2 and 230-3)",
    ))));
    laws.push(Arc::new(Growth(card(
        "thermal_growth",
        "e = um_per_K·ΔT + um_per_K2·ΔT²",
        growth(),
        vec![Need::Delta],
        "spindle, housing or column growing as it warms",
        "spindle warm-up from cold with gauges at the nose, dry and wet, then cool-down (ISO 230-3)",
    ))));
    let mut lag = growth();
    lag.push(Parameter::new("tau_s", "s", [30.0, 36_000.0], Search::Smooth).limits(1e-6, 1e9));
    laws.push(Arc::new(Lag(card(
        "thermal_lag",
        "e = um_per_K·L + um_per_K2·L², L = ΔT passed through a first-order lag",
        lag,
        vec![Need::Delta, Need::Time],
        "a massive part that follows the measured temperature late",
        "spindle warm-up in steps, each held shorter and longer than the lag, then cool-down (ISO 230-3)",
    ))));
}
