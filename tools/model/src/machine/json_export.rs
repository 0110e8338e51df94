//! A model as JSON for programs.

use super::{EffectWithProvenance, Machine};
use serde_json::{Value, json};
use std::collections::BTreeMap;

impl Machine {
    /// The model as JSON: effects with parameters, intervals and sources, fits, chain.
    pub fn to_json(&self) -> Value {
        let effects: Vec<Value> = self.listed().iter().map(effect_json).collect();
        let fits: Vec<Value> = self
            .fits()
            .iter()
            .map(|f| {
                let [rms, half_width, by_kind] = super::FitNote::keys_of(&f.response);
                json!({"response": f.response, "date": f.date, "valid_until": f.valid_until, rms: f.rms_um,
                       half_width: f.half_width_um, by_kind: f.by_kind_um})
            })
            .collect();
        json!({"name": self.name(), "effects": effects, "fits": fits, "chain": self.chain().map(crate::kinematic_chain::KinematicChain::to_json)})
    }
}

fn effect_json(l: &EffectWithProvenance) -> Value {
    let parameters: BTreeMap<&str, Value> = l
        .effect
        .description()
        .parameters
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let value = if p.array { json!(l.effect.get(i)) } else { json!(l.effect.scalar(i)) };
            let interval = l.provenance.interval.get(&p.name);
            (p.name.as_str(), json!({"value": value, "unit": p.unit, "interval": interval}))
        })
        .collect();
    json!({
        "name": l.effect.name(), "law": l.effect.description().law, "delta": l.effect.delta.as_ref().map(ToString::to_string),
        "parameters": parameters, "range_K": l.effect.range_k, "added_by": l.provenance.added_by,
        "set_up": l.provenance.set_up,
        "experiment": l.effect.description().experiment,
    })
}
