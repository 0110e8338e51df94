//! `straightness.A.B`: the error of A along the travel of B.
//! A straight line is not part of it.

use crate::effect::piecewise_linear::{PiecewiseLinearLaw, parameters};
use crate::effect::{LawDescription, Law, EffectNameAxes, RequiredInput};
use std::sync::Arc;

/// Index of the axis in the name that the knots lie on.
const ALONG: usize = 1;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "straightness".into(),
        law: "e_A = smooth non-linear function of p_B: linear between knots, constant beyond".into(),
        cause: "a guideway that is not straight".into(),
        experiment: "straightedge or laser along B read across it, forward and turned over (ISO 230-1)"
            .into(),
        naming: EffectNameAxes::Two,
        parameters: parameters(),
        needs: vec![RequiredInput::Position(ALONG)],
        ..LawDescription::default()
    };
    Arc::new(PiecewiseLinearLaw { description, along: ALONG })
}
