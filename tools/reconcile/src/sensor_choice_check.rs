//! Compares the sensors with those that a fit of growth chooses on the same drift.
//! It returns the reason if they differ.

use crate::findings_from_estimate::FoundEffect;
use rtec_fit::thermal;
use rtec_model::effect::{TemperatureDifference, ThermalDependence};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role, RunKind};

/// The two sensors of a difference, in either order.
fn pair(d: &TemperatureDifference) -> [Option<&str>; 2] {
    let mut both = [Some(d.sensor.as_str()), d.minus()];
    both.sort_unstable();
    both
}

fn list(differences: &[&TemperatureDifference]) -> String {
    differences.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// The other temperatures that `rtecctl model fit` would read, and why.
pub(crate) fn other_sensors(
    effects: &[(FoundEffect, Vec<f64>)],
    train: &[Record],
    machine: &Machine,
) -> Option<String> {
    if !train.iter().all(|r| r.kind == RunKind::Drift && r.column(&Role::Time).is_some()) {
        return None;
    }
    let growth = |f: &&FoundEffect| {
        f.effect.description().heat == ThermalDependence::Growth && f.effect.delta.is_some()
    };
    let found: Vec<&FoundEffect> = effects.iter().map(|(f, _)| f).filter(growth).collect();
    let records: Vec<&Record> = train.iter().collect();
    let base = (machine.effects().count() > 0).then(|| machine.clone());
    let beyond: Vec<Record> = match &base {
        Some(base) => records.iter().map(|r| base.without_prediction(r)).collect::<Result<_, _>>().ok()?,
        None => train.to_vec(),
    };
    let options = thermal::ThermalFitOptions { base, ..thermal::ThermalFitOptions::default() };
    let mut said = Vec::new();
    let mut axes: Vec<_> = found.iter().map(|f| f.effect.axes()[0].clone()).collect();
    axes.sort();
    axes.dedup();
    for axis in axes {
        let ours =
            found.iter().filter(|f| f.effect.axes()[0] == axis).filter_map(|f| f.effect.delta.as_ref());
        let ours: Vec<&TemperatureDifference> = ours.collect();
        // The rows are few or unsuitable for a fit, so there is no other choice.
        let response = Role::Error(axis);
        let Ok(theirs) = thermal::select_differences(&beyond.iter().collect::<Vec<_>>(), &response, &options)
        else {
            continue;
        };
        let theirs: Vec<&TemperatureDifference> = theirs.iter().collect();
        let alike = |a: &[&TemperatureDifference], b: &[&TemperatureDifference]| {
            a.iter().all(|d| b.iter().any(|e| pair(d) == pair(e)))
        };
        if alike(&ours, &theirs) && alike(&theirs, &ours) {
            continue;
        }
        let fits = if theirs.is_empty() { "none".to_owned() } else { list(&theirs) };
        said.push(format!(
            "for the growth of {response} this reads {}, model fit {fits}: model fit asks which temperatures predict \
             stretches of time that were left out, this which explain all rows with the fewest values; a record with \
             more warm-ups tells them apart",
            list(&ours)
        ));
    }
    (!said.is_empty()).then(|| said.join("; "))
}
