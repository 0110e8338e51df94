//! `position_map.A`: an axis's repeatable error beyond a straight line.

use crate::effect::piecewise_linear::{PiecewiseLinearLaw, parameters};
use crate::effect::{LawDescription, Law, RequiredInput};
use std::sync::Arc;

/// Index of the axis in the name that the knots lie on.
const ALONG: usize = 0;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "position_map".into(),
        law: "e = smooth, repeatable function of p beyond scale: linear between knots, constant beyond"
            .into(),
        cause: "graduation of the scale, lead variation of the screw, bending of the guideway".into(),
        experiment: "linear displacement with closely spaced targets (ISO 230-2), several cycles".into(),
        parameters: parameters(),
        needs: vec![RequiredInput::Position(ALONG)],
        ..LawDescription::default()
    };
    Arc::new(PiecewiseLinearLaw { description, along: ALONG })
}
