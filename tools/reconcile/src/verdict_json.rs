//! The answer as `verdict.json` (guide, "The verdict").

use crate::SEED;
use crate::findings_from_estimate::FoundEffect;
use crate::gap::Gap;
use crate::residual_localisation::LEAST_P;
use crate::verdict::{ReconciliationResult, RecordSetUp, RevisedEffect};
use rtec_estimate::RivalExplanation;
use rtec_model::effect::{Effect, ParameterFitMethod, ReferenceTemperature, TemperatureDifference};
use serde_json::{Map, Value, json};

fn sensor_keys(map: &mut Map<String, Value>, sensor: Option<&TemperatureDifference>) {
    if let Some(d) = sensor {
        map.insert("sensor".into(), json!(d.sensor));
        match &d.against {
            ReferenceTemperature::Sensor(m) => map.insert("minus".into(), json!(m)),
            ReferenceTemperature::Reference(degc) => map.insert("reference_degC".into(), json!(degc)),
            ReferenceTemperature::Standard => None,
        };
    }
}

fn parameters(
    effect: &Effect,
    half: &[f64],
    before: Option<&Effect>,
) -> (Map<String, Value>, Map<String, Value>) {
    let (mut beside, mut inside) = (Map::new(), Map::new());
    let width = effect.width();
    for (i, p) in effect.description().parameters.iter().enumerate() {
        let one = |v: Vec<f64>| if p.array { json!(v) } else { json!(v[0]) };
        if p.array && p.search == ParameterFitMethod::Chosen {
            beside.insert(p.name.clone(), json!(effect.get(i)));
            continue;
        }
        let h = &half[i * width..(i + 1) * width];
        let values = effect.get(i);
        let mut entry = Map::new();
        if let Some(b) = before {
            entry.insert("before".into(), one(b.get(i).to_vec()));
        }
        entry.insert("value".into(), one(values.to_vec()));
        entry.insert("low".into(), one(values.iter().zip(h).map(|(v, h)| v - h).collect()));
        entry.insert("high".into(), one(values.iter().zip(h).map(|(v, h)| v + h).collect()));
        inside.insert(p.name.clone(), Value::Object(entry));
    }
    (beside, inside)
}

/// An effect with its sensors and parameters.
/// It is an entry of `effects` and of `refined`.
fn effect(effect: &Effect, half: &[f64], before: Option<&Effect>) -> Map<String, Value> {
    let (mut map, inside) = parameters(effect, half, before);
    map.insert("name".into(), json!(effect.name()));
    sensor_keys(&mut map, effect.delta.as_ref());
    map.insert("parameters".into(), Value::Object(inside));
    map
}

fn rival(r: &RivalExplanation) -> Value {
    let mut map = Map::new();
    map.insert("name".into(), json!(r.name));
    sensor_keys(&mut map, r.sensor.as_ref());
    if let Some((parameter, value)) = &r.differs {
        map.insert(parameter.clone(), json!(value));
    }
    map.insert("log_odds".into(), json!(r.margin));
    Value::Object(map)
}

fn finding((f, half): &(FoundEffect, Vec<f64>)) -> Value {
    let mut map = effect(&f.effect, half, None);
    map.insert("p_value".into(), json!(f.p_value.max(LEAST_P)));
    map.insert("log_evidence".into(), json!(f.evidence));
    map.insert("alternatives".into(), f.rivals.iter().map(rival).collect());
    Value::Object(map)
}

fn refined(r: &RevisedEffect) -> Value {
    Value::Object(effect(&r.after.0, &r.after.1, Some(&r.before)))
}

fn gap(g: &Gap) -> Value {
    let pair = |p: [f64; 2]| json!({"before": p[0], "after": p[1]});
    json!({
        "train": pair(g.train),
        "holdout": g.holdout.map(pair),
        "holdout_without_suspected": g.without_strangers.map(pair),
        "cross_validation": g.blocked.map(pair),
        "floor": g.floor,
        "unit": g.unit,
        "closed": g.closed(),
    })
}

/// Set-ups by record; the two coordinates of a centre are joined.
fn set_up(all: &[RecordSetUp]) -> Value {
    let of = |s: &RecordSetUp| {
        let mut map = Map::new();
        let value = |key: &str| s.terms.iter().find(|t| t.0 == key).map(|t| t.1);
        if let (Some(a), Some(b)) = (value("centre_um.0"), value("centre_um.1")) {
            map.insert("centre_um".into(), json!([a, b]));
        }
        for (key, value, _) in s.terms.iter().filter(|t| !t.0.starts_with("centre_um")) {
            let key = if s.terms.iter().filter(|t| t.0.starts_with("zero_um")).count() == 1
                && key.starts_with("zero_um")
            {
                "zero_um"
            } else {
                key
            };
            map.insert(key.into(), json!(value));
        }
        (s.record.clone(), Value::Object(map))
    };
    Value::Object(all.iter().map(of).collect())
}

impl ReconciliationResult {
    /// The answer as a JSON document.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let gaps: Vec<Value> = self.gap.iter().map(gap).collect();
        json!({
            "verdict": self.verdict,
            "where": self.places,
            "effects": self.effects.iter().map(finding).collect::<Vec<_>>(),
            "refined": self.refined.iter().map(refined).collect::<Vec<_>>(),
            "stand_in": self.curve.as_ref().map(|(e, _)| json!({"name": e.name(), "file": crate::LAWS_FILE})),
            "no_stand_in": self.no_curve,
            "unexplained": self.unexplained.iter().map(|s| json!({
                "response": s.response, "against": s.against, "manner": s.manner,
            })).collect::<Vec<_>>(),
            "gap": if let [one] = &gaps[..] { one.clone() } else { json!(gaps) },
            "confirmed": self.confirmed,
            "set_up": set_up(&self.set_up),
            "suspicions": self.suspicions,
            "left_out": self.left_out,
            "nothing_said_of": self.skipped_records.iter().map(|u| &u.record).collect::<Vec<_>>(),
            "derived": self.derived,
            "advice": self.advice,
            "tried": self.ranking.iter().map(|t| json!({
                "name": t.label, "log_odds": t.odds, "accepted": t.accepted,
            })).collect::<Vec<_>>(),
            "level": self.level,
            "seed": SEED,
            "noise": {"autocorrelation": self.phi, "every_nth_row": self.every},
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::effect::Dictionary;

    #[test]
    fn parameters_carry_their_intervals_and_knots_stand_beside_them() {
        let dictionary = Dictionary::default();
        let mut map = dictionary.effect("position_map.x").unwrap();
        map.set_values(&[0.0, 50.0, 100.0, 1.0, -2.0, 1.0]).unwrap();
        let (beside, inside) = parameters(&map, &[0.0, 0.0, 0.0, 0.1, 0.2, 0.3], None);
        assert_eq!(beside["knots_mm"], json!([0.0, 50.0, 100.0]));
        assert_eq!(inside["um"]["high"], json!([1.1, -1.8, 1.3]));
        let mut after = dictionary.effect("thermal_growth.z").unwrap();
        after.delta = Some(TemperatureDifference {
            sensor: "T8".into(),
            against: ReferenceTemperature::Reference(21.5),
        });
        let entry =
            refined(&RevisedEffect { place: 0, before: after.clone(), after: (after, vec![0.5, 0.0]) });
        assert_eq!((&entry["sensor"], &entry["reference_degC"]), (&json!("T8"), &json!(21.5)));
        assert_eq!(
            entry["parameters"]["um_per_K"],
            json!({"before": 0.0, "value": 0.0, "low": -0.5, "high": 0.5})
        );
    }
}
