//! Laws without state or shape parameter.
//! Each is a function of what is read, times one parameter (or two).

use super::{Basis, Effect, EffectMemory, Input, Law, LawDescription, Out};

/// A law whose parameters are all linear.
#[derive(Debug)]
pub(super) struct LinearLaw {
    pub(super) description: LawDescription,
    pub(super) basis: Basis,
}

impl Law for LinearLaw {
    fn describe(&self) -> &LawDescription {
        &self.description
    }

    fn basis(&self, _: &Effect, now: &Input, component: usize, _: &mut EffectMemory, out: Out<'_>) {
        (self.basis)(now, component, out);
    }

    fn stateless(&self) -> Option<Basis> {
        Some(self.basis)
    }
}
