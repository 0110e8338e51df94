//! `probe_latency.A`: time from contact to capture.

use crate::effect::{LawDescription, Law, LinearLaw, MechanicalParameter, RequiredInput, EffectOwner, LawParameter, ProbingDependence};
use std::sync::Arc;

pub(super) fn law() -> Arc<dyn Law> {
    let description = LawDescription {
        name: "probe_latency".into(),
        law: "e = us·v/1000, in a record of kind probing".into(),
        cause: "time from the probe's contact to the captured position".into(),
        experiment: "one surface probed at several speeds, both ways".into(),
        parameters: vec![
            LawParameter::linear("us", "us", 20000.0).typically(300.0)
                .within([-1e6, 1e6], "no trigger of a probe is late by a second"),
        ],
        needs: vec![RequiredInput::Velocity],
        owner: EffectOwner::Probe,
        probing: ProbingDependence::Only,
        mechanism: Some(MechanicalParameter::ProbeDelay),
        ..LawDescription::default()
    };
    Arc::new(LinearLaw { description, basis: |i, _, out| out[0] = i.v_mm_s / 1000.0 })
}
