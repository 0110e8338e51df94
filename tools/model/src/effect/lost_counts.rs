//! `lost_counts.A`: a step at one moment that stays.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State};

#[derive(Debug)]
pub(super) struct LostCounts(Card);

const UM: usize = 0;
const AT: usize = 1;

impl LostCounts {
    pub(super) fn new() -> Self {
        Self(Card {
            name: "lost_counts".to_owned(),
            law: "e = um from at_s on; whole counts".to_owned(),
            cause: "edges lost or gained by a decoder, a connector, a scale that is dirty".to_owned(),
            naming: Naming::One,
            quantity: Quantity::Error,
            parameters: vec![
                Parameter::linear("um", "um", 10_000.0),
                Parameter::new("at_s", "s", [0.0, 1e6], Search::Chosen),
            ],
            needs: vec![Need::Time],
            experiment: "return to a fixed stop or to the reference mark before and after".to_owned(),
        })
    }
}

impl Law for LostCounts {
    fn card(&self) -> &Card {
        &self.0
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        out[0] = f64::from(now.t_s >= effect.scalar(AT));
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut State, out: Out<'_>) {
        self.basis(effect, now, component, state, &mut out[UM..=UM]);
    }
}
