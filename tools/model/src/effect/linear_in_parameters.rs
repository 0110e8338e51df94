//! Laws without state or shape parameter.
//! Each is a function of what is read, times one parameter (or two).

use super::{Basis, Effect, EffectState, Input, Law, LawDescription, Out};

/// A law whose parameters are all linear.
#[derive(Debug)]
pub(super) struct Linear {
    pub(super) description: LawDescription,
    pub(super) basis: Basis,
}

impl Law for Linear {
    fn describe(&self) -> &LawDescription {
        &self.description
    }

    fn basis(&self, _: &Effect, now: &Input, component: usize, _: &mut EffectState, out: Out<'_>) {
        (self.basis)(now, component, out);
    }

    fn stateless(&self) -> Option<Basis> {
        Some(self.basis)
    }
}
