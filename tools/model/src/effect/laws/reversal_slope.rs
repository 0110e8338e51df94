//! `reversal_slope.A`: a reversal that grows along the axis.
//! A worn screw causes it.

use crate::effect::{LawDescription, Law, LinearLaw, RequiredInput, LawParameter, LawSearchSettings};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "reversal_slope".into(),
        law: "e = um_per_m·p/1000·dir/2".into(),
        cause: "a screw or rack that is worn more at one end of the travel".into(),
        experiment: "bidirectional linear displacement over the whole travel (ISO 230-2)".into(),
        parameters: vec![
            LawParameter::linear("um_per_m", "um/m", 200.0)
                .typically(8.0)
                .within([-1000.0, 1000.0], "lost motion that grows by a millimetre in a metre is a broken screw"),
        ],
        needs: vec![RequiredInput::Direction, RequiredInput::Position(0)],
        searched: LawSearchSettings { beside: Some(super::reversal::NAME), ..LawSearchSettings::default() },
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.p_mm[0] / 1000.0 * i.dir / 2.0 })
}
