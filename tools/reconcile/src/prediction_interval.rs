//! The prediction interval of the better model, per response.
//! It has the form in which a fit states it.

use rtec_estimate::rows_and_noise::MeasuredRows;
use rtec_model::effect::{Effect, ThermalDependence};
use rtec_model::machine::{FitNote, Machine, SourceRecord, ValidTemperatureRange};
use rtec_model::record::{Record, Role, span};
use std::collections::BTreeMap;

/// Days for which such a model is valid, as for `model fit`.
const VALID_DAYS: i64 = 365;
/// Share of the rows that an interval should contain.
const HOLDS: f64 = 0.95;

/// States the interval of each response.
/// The residual of each row under the other blocks' fit (`left`) is the error that such a run may have. If
/// several records are of one kind, the widest interval is used.
pub(crate) fn add_prediction_intervals(model: &mut Machine, used: &[Record], left: &[f64], date: &str) {
    let rows = MeasuredRows::new(used);
    let day = rtec_files::date::parse(date).unwrap_or_else(rtec_files::date::today);
    for (j, role) in rows.responses.iter().enumerate() {
        let own = || rows.segments.iter().filter(|s| s.response == j && !s.rows.is_empty());
        let records: Vec<&Record> = own().map(|s| &used[s.record]).collect();
        let (mut half_width_um, mut by_kind_um) = (f64::MIN_POSITIVE, BTreeMap::new());
        let (mut squares, mut n) = (0.0, 0.0_f64);
        for s in own() {
            let mut sizes: Vec<f64> = left[s.rows.clone()].iter().map(|v| v.abs()).collect();
            sizes.sort_by(f64::total_cmp);
            let at = ((HOLDS * sizes.len() as f64).ceil() as usize).clamp(1, sizes.len());
            let half = sizes[at - 1].max(f64::MIN_POSITIVE);
            squares += sizes.iter().map(|v| v * v).sum::<f64>();
            n += sizes.len() as f64;
            half_width_um = half.max(half_width_um);
            if let Some(kind) = FitNote::kind_of(&used[s.record]) {
                by_kind_um.entry(kind).and_modify(|w: &mut f64| *w = w.max(half)).or_insert(half);
            }
        }
        let mut note = FitNote {
            response: role.to_string(),
            date: rtec_files::date::format(day),
            valid_until: rtec_files::date::format(day + VALID_DAYS),
            rms_um: (squares / n.max(1.0)).sqrt(),
            half_width_um,
            valid: model.effects().filter_map(|e| seen(e, role.axis()?.as_str(), &records)).collect(),
            at_mm: Some(FitNote::places(&records)),
            by_kind_um,
            from: records.iter().map(|r| SourceRecord::of(r)).collect(),
        };
        if let Some(earlier) = model.fits().iter().find(|f| f.response == note.response) {
            // These rows show the residuals of the whole model. For other kinds of runs the earlier fit is
            // used.
            for (kind, um) in &earlier.by_kind_um {
                note.by_kind_um.entry(kind.clone()).or_insert(*um);
            }
            note.half_width_um = note.by_kind_um.values().copied().fold(note.half_width_um, f64::max);
            let known =
                |v: &&ValidTemperatureRange| note.valid.iter().all(|own| own.difference != v.difference);
            let further: Vec<ValidTemperatureRange> = earlier.valid.iter().filter(known).cloned().collect();
            note.valid.extend(further);
        }
        model.note_fit(note);
    }
}

/// The range of the temperature difference that an effect reads in the records.
fn seen(effect: &Effect, axis: &str, records: &[&Record]) -> Option<ValidTemperatureRange> {
    let own = effect.axes().first().filter(|a| a.as_str() == axis)?;
    let um_per_k = match effect.description().heat {
        ThermalDependence::Growth => effect.scalar(0).abs(),
        ThermalDependence::Expansion => {
            let at_mm = records.iter().filter_map(|r| r.data(&Role::Position(own.clone()))).flatten();
            effect.scalar(0).abs() * at_mm.fold(0.0, |most: f64, p| most.max(p.abs())) / 1000.0
        }
        _ => return None,
    };
    let of = ValidTemperatureRange { difference: effect.delta.clone()?, range_k: [0.0; 2], um_per_k };
    let all: Vec<f64> = records.iter().filter_map(|r| of.of(r)).flatten().collect();
    let [low, high] = span(&all);
    (low <= high).then_some(ValidTemperatureRange { range_k: [low, high], ..of })
}
