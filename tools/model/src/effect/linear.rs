//! Laws that are one function of what is read, times one parameter each (or two): no state, no shape parameter.

use super::{Description, Effect, Input, Law, Out, State};

/// A law whose parameters are all linear.
#[derive(Debug)]
pub(super) struct Linear {
    pub(super) description: Description,
    /// The basis of each parameter at one instant, for the component (of a pair) that is asked for.
    pub(super) basis: fn(&Input, usize, Out<'_>),
}

impl Law for Linear {
    fn describe(&self) -> &Description {
        &self.description
    }

    fn basis(&self, _: &Effect, now: &Input, component: usize, _: &mut State, out: Out<'_>) {
        (self.basis)(now, component, out);
    }
}
