//! `warm_up.A`: drift from the start with no logged cause.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State};

#[derive(Debug)]
pub(super) struct WarmUp(Card);

const UM: usize = 0;
const TAU: usize = 1;

impl WarmUp {
    pub(super) fn new() -> Self {
        Self(Card {
            name: "warm_up".to_owned(),
            law: "e = um·(1 − exp(−t/tau_s)), from t = 0".to_owned(),
            cause: "warming that no sensor of the record follows".to_owned(),
            naming: Naming::One,
            quantity: Quantity::Error,
            parameters: vec![
                Parameter::linear("um", "um", 500.0),
                Parameter::new("tau_s", "s", [30.0, 36_000.0], Search::Smooth).limits(1e-6, 1e9),
            ],
            needs: vec![Need::Time],
            experiment: "drift from a cold start with temperatures logged at every heat source (ISO 230-3)"
                .to_owned(),
        })
    }
}

impl Law for WarmUp {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        out[0] = -(-now.t_s.max(0.0) / effect.scalar(TAU)).exp_m1();
    }

    fn slopes(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        let (t, tau) = (now.t_s.max(0.0), effect.scalar(TAU));
        let e = (-t / tau).exp();
        out[UM] = 1.0 - e;
        out[TAU] = -effect.scalar(UM) * e * t / (tau * tau);
    }
}
