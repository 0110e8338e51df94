//! The structure as effects of the dictionary.

use super::fit_candidates::TermSelectionProblem;
use super::jackknife::{Intervals, JackknifeIntervals};
use super::prediction_interval::TemperatureDifferenceBounds;
use super::term::Term;
use rtec_model::effect::laws::{coolant, offset, spindle_speed, thermal_growth, thermal_lag};
use rtec_model::effect::{Dictionary, Effect, ParameterValueError};
use rtec_model::record::{Axis, Role};

/// The structure as effects of the dictionary.
/// Each has its intervals and the range it was fitted on.
pub(super) fn effects(
    problem: &TermSelectionProblem,
    terms: &[Term],
    coefficients: &[f64],
    jackknife: &JackknifeIntervals,
    guards: &[TemperatureDifferenceBounds],
    response: &Role,
) -> Result<Vec<(Effect, Intervals)>, ParameterValueError> {
    let dictionary = Dictionary::default();
    let axis = response.axis().map_or("x", Axis::as_str);
    let one = |v: [f64; 2]| vec![v];
    let mut offset = dictionary.effect(&format!("{}.{axis}", offset::NAME))?;
    offset.set("um", &[coefficients[0]])?;
    let mut found = vec![(offset, Intervals::from([("um".to_owned(), one(jackknife.coefficients[0]))]))];
    for (k, term) in terms.iter().enumerate() {
        let (value, interval) = (coefficients[k + 1], jackknife.coefficients[k + 1]);
        match *term {
            Term::Coolant => {
                let mut e = dictionary.effect(&format!("{}.{axis}", coolant::NAME))?;
                e.set("um", &[value])?;
                found.push((e, Intervals::from([("um".to_owned(), one(interval))])));
            }
            Term::Speed => {
                let mut e = dictionary.effect(&format!("{}.{axis}", spindle_speed::NAME))?;
                e.set("um_per_krpm", &[value])?;
                found.push((e, Intervals::from([("um_per_krpm".to_owned(), one(interval))])));
            }
            Term::Thermal { sensor, minus, lag, square } => {
                let law = if lag > 0 { thermal_lag::NAME } else { thermal_growth::NAME };
                let delta = problem.difference((sensor, minus));
                let key = if square { "um_per_K2" } else { "um_per_K" };
                let tau = problem.taus[lag];
                let same = |e: &Effect| {
                    e.delta.as_ref() == Some(&delta)
                        && e.value("tau_s").map_or(0.0_f64, |v| v[0]).to_bits() == tau.to_bits()
                };
                if let Some((e, intervals)) = found.iter_mut().find(|(e, _)| same(e)) {
                    e.set(key, &[value])?;
                    intervals.insert(key.to_owned(), one(interval));
                    continue;
                }
                let mut e = dictionary.effect(&format!("{law}.{axis}"))?;
                e.delta = Some(delta);
                let mut intervals = Intervals::from([(key.to_owned(), one(interval))]);
                if let Some(i) = jackknife.squares.get(&k) {
                    intervals.insert("um_per_K2".to_owned(), one(*i));
                }
                e.set(key, &[value])?;
                if lag > 0 {
                    e.set("tau_s", &[tau])?;
                    if let Some(i) = jackknife.tau_s.get(&k) {
                        intervals.insert("tau_s".to_owned(), one(*i));
                    }
                }
                if let Some(g) = guards.iter().find(|g| g.term == k) {
                    e.range_k = Some(g.range_k);
                    e.start_k = (lag > 0).then_some(g.start_k);
                }
                found.push((e, intervals));
            }
        }
    }
    Ok(found)
}
