//! A model's prediction of a record, and its interval.

use super::fit_note::unknown_um;
use super::{EffectWithProvenance, FitNote, Machine, RecordRanges};
use crate::effect::laws::reversal;
use crate::effect::{Effect, States, ThermalDependence};
use crate::record::{Record, Role};
use rtec_files::InputError;

impl Machine {
    /// Predicts a record: the sum of the effects at every row, per response.
    /// The responses are in the record's order. The result also lists the quantities that the record does not
    /// log and that were taken as zero.
    ///
    /// # Errors
    /// An effect reads a sensor or channel that the record does not have.
    pub fn predict(&self, record: &Record) -> Result<RecordPrediction, InputError> {
        ChunkedRecordPredictor::of(self).next(record)
    }

    /// Whether a listed effect acts in a run that goes so far.
    /// The zero of a set-up is the gauges' of the runs that it was fitted on; every other run has its own.
    pub fn acts_in(&self, listed: &EffectWithProvenance, reach: &RecordRanges) -> bool {
        let of = |note: &&FitNote| {
            let response = note.response.strip_prefix("error.");
            listed.effect.axes().first().is_some_and(|a| response == Some(a.as_str()))
        };
        !listed.provenance.set_up || self.fits.iter().find(of).is_some_and(|note| note.has_zero_of(reach))
    }

    /// The record with this machine's prediction subtracted from its errors.
    ///
    /// # Errors
    /// As [`Machine::predict`].
    pub fn without_prediction(&self, record: &Record) -> Result<Record, InputError> {
        let mut left = record.clone();
        let predicted = self.predict(record)?.columns;
        let responses = left.columns.iter_mut().filter(|c| c.role.is_response());
        for (column, (_, says)) in responses.zip(predicted) {
            column.data.iter_mut().zip(says).for_each(|(e, p)| *e -= p);
        }
        Ok(left)
    }

    /// Reversal that a correction at rest may leave in a response, µm.
    /// Such a correction moves the table. Where it takes the table back by some counts only, nobody knows
    /// whether the tool came with it. Where the tool leads the scale (`um` above zero), neither direction's
    /// total fits before the table has come back by the whole reversal.
    pub fn turned_back_um(&self, response: &str) -> f64 {
        let of = |axis: &str| format!("{}.{axis}", reversal::NAME);
        let Some(name) = response.strip_prefix("error.").map(of) else { return 0.0 };
        self.effects().filter(|e| e.name() == name).map(|e| e.scalar(0)).sum::<f64>().abs()
    }

    /// What a corrected response is promised to stay within, 95 %, µm.
    /// It holds where temperatures are in the range of the fit. A reversal is no scatter but stays as it is,
    /// so it is added to the interval.
    pub fn promised_um(&self, fit: &FitNote) -> f64 {
        fit.half_width_um + self.turned_back_um(&fit.response)
    }

    /// Half width of the 95 % prediction interval at every row of a record, µm.
    /// `None` unless a fit of the response has stated it for this kind of run and has seen these axis
    /// positions.
    /// The interval is wider just after the record's start, because the state of the lags is unknown. It is
    /// also wider where a difference is held at the bound of its fitted range.
    pub fn half_widths_um(&self, record: &Record, response: &Role) -> Option<Vec<f64>> {
        Some(ChunkedHalfWidthPredictor::of(self, &RecordRanges::of(record), response)?.next(record))
    }

    /// The fit that states a response's interval for a record's reach.
    ///
    /// # Errors
    /// The reason why no fit does, in words.
    pub fn fit_with_interval(&self, reach: &RecordRanges, response: &Role) -> Result<&FitNote, String> {
        let note = self.fits.iter().find(|f| f.response == response.to_string());
        let note = note.ok_or("the model states no interval")?;
        note.why_interval_not_valid(reach).map_or(Ok(note), |why| Err(format!("no interval: {why}")))
    }
}

/// The half widths of a record that is evaluated piece by piece.
/// At each row they equal those of [`Machine::half_widths_um`] for the whole.
#[derive(Debug)]
pub struct ChunkedHalfWidthPredictor<'m> {
    machine: &'m Machine,
    response: Role,
    /// Half width for this kind of record, µm.
    own_um: f64,
    /// Per effect: the state of the lag of its temperature difference.
    states: Vec<States>,
    /// Time of the record's first row, s.
    start_s: Option<f64>,
}

impl<'m> ChunkedHalfWidthPredictor<'m> {
    /// The state before the first piece of a record with this reach.
    /// `None` if [`Machine::half_widths_um`] gives no interval.
    pub fn of(machine: &'m Machine, reach: &RecordRanges, response: &Role) -> Option<Self> {
        let note = machine.fit_with_interval(reach, response).ok()?;
        let states = vec![States::default(); machine.effects().count()];
        let (response, own_um) = (response.clone(), note.half_width_for_um(reach));
        Some(Self { machine, response, own_um, states, start_s: None })
    }

    /// The half widths of the next rows, µm.
    pub fn next(&mut self, record: &Record) -> Vec<f64> {
        let mut squares = vec![self.own_um * self.own_um; record.rows()];
        let t = record.time_s();
        let start_s = *self.start_s.get_or_insert(t[0]);
        let response = self.response.to_string();
        let fits = self.machine.fits.iter().filter(|f| f.response == response);
        let mut outside = vec![0.0_f64; record.rows()];
        for v in fits.flat_map(|f: &FitNote| &f.valid) {
            // A sensor that the model does not read may be missing here.
            let Some(differences) = v.of(record) else { continue };
            outside.iter_mut().zip(differences).for_each(|(o, d)| *o = o.max(v.outside_um(d)));
        }
        squares.iter_mut().zip(&outside).for_each(|(s, o)| *s += o * o);
        for (effect, states) in self.machine.effects().zip(&mut self.states) {
            if effect.axes().first() != self.response.axis() {
                continue;
            }
            let (Some(range), Some(asked)) = (effect.range_k, differences(effect, record, states)) else {
                continue;
            };
            let of = |name: &str| effect.value(name).map_or(0.0, |v| v[0]);
            let (gain, bend, tau_s) = (of("um_per_K"), of("um_per_K2"), of("tau_s"));
            for (row, (square, asked)) in squares.iter_mut().zip(&asked).enumerate() {
                let held = asked.clamp(range[0], range[1]);
                let (start_k, elapsed_s) = (effect.start_k.unwrap_or(0.0), t[row] - start_s);
                *square += unknown_um(gain, bend, *asked, held, start_k, tau_s, elapsed_s).powi(2);
            }
        }
        squares.into_iter().map(f64::sqrt).collect()
    }
}

/// A machine that predicts a record piece by piece.
/// At each row it predicts the same as [`Machine::predict`] for the whole.
#[derive(Debug)]
pub struct ChunkedRecordPredictor<'m> {
    machine: &'m Machine,
    /// The states of each effect, one for each response that it acts on.
    states: Vec<Vec<States>>,
}

impl<'m> ChunkedRecordPredictor<'m> {
    /// The state before the first piece.
    pub fn of(machine: &'m Machine) -> Self {
        Self { machine, states: vec![Vec::new(); machine.effects().count()] }
    }

    /// Predicts the next piece: the following rows, with the same columns.
    ///
    /// # Errors
    /// As [`Machine::predict`].
    pub fn next(&mut self, record: &Record) -> Result<RecordPrediction, InputError> {
        let mut columns: Vec<(String, Vec<f64>)> =
            record.responses().map(|c| (c.name.clone(), vec![0.0; record.rows()])).collect();
        let mut taken_as_zero = Vec::new();
        let reach = RecordRanges::of(record);
        for (listed, states) in self.machine.listed().iter().zip(&mut self.states) {
            let effect = &listed.effect;
            let acts = effect.acts_on(record);
            if acts.is_empty() || !self.machine.acts_in(listed, &reach) {
                continue;
            }
            let bound = effect.bind(record).map_err(|m| m.of(record))?;
            states.resize(acts.len(), States::default());
            for ((role, component), states) in acts.into_iter().zip(states) {
                let place = record.responses().position(|c| c.role == role);
                if let Some((_, out)) = place.and_then(|p| columns.get_mut(p)) {
                    bound.add_on(effect, component, states, out);
                }
            }
            taken_as_zero.extend(bound.taken_as_zero().iter().map(|r| (effect.name(), r.to_string())));
        }
        if let Some(chain) = &self.machine.chain {
            let acts = |r: &Role| matches!(r, Role::Error(a) if ["x", "y", "z"].contains(&a.as_str()));
            if record.responses().any(|c| acts(&c.role)) {
                let zero = chain.taken_as_zero(record).into_iter();
                taken_as_zero.extend(zero.map(|role| ("chain".to_owned(), role.to_string())));
            }
            for (column, (_, out)) in record.responses().zip(&mut columns) {
                chain.add(record, &column.role, out).map_err(|m| m.of(record))?;
            }
        }
        Ok(RecordPrediction { columns, taken_as_zero })
    }
}

/// The (lagged) temperature difference of growth at every row, not held at a bound.
/// `None` for other laws, or if the record lacks a sensor. The states are those after the previous rows.
pub(super) fn differences(effect: &Effect, record: &Record, states: &mut States) -> Option<Vec<f64>> {
    if effect.delta.is_none() || effect.description().heat != ThermalDependence::Growth {
        return None;
    }
    let n = effect.coefficient_count();
    let bound = effect.bind(record).ok()?;
    let mut free = effect.clone();
    free.range_k = None;
    let mut basis = vec![0.0; n * bound.rows()];
    bound.basis_on(&free, 0, states, &mut basis);
    // The first basis column of growth and lag is the (lagged) difference itself.
    basis.truncate(bound.rows());
    Some(basis)
}

/// A model's prediction of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordPrediction {
    /// Per response: its column's name and the sum of the effects at every row.
    pub columns: Vec<(String, Vec<f64>)>,
    /// Effect and role of each quantity that an effect reads and the record lacks.
    /// It was taken as zero.
    pub taken_as_zero: Vec<(String, String)>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{Axis, Column, RunKind};
    use std::path::Path;

    /// A bug once: the zero of a drift test was taken off a plate.
    /// The wave that it came from was taken off as well.
    #[test]
    fn a_gauge_s_zero_is_of_its_own_runs_alone() {
        let text = "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = \"2026-01-01\"\nvalid_until = \"2027-01-01\"\n\
                    rms_um = 0.1\nhalf_width_um = 0.2\nby_kind_um = { drift = 0.2 }\nat_mm = {}\n\
                    [[effect]]\nname = \"offset.x\"\num = 2.9\nset_up = true\n";
        let machine = Machine::parse(Path::new("m.toml"), text).unwrap();
        let x = Axis::new("x").unwrap();
        let says = |machine: &Machine, kind: RunKind, to_mm: f64, um: f64| {
            let place = (0..9).map(|i| f64::from(i) * to_mm / 8.0).collect();
            let columns = vec![
                Column::new("x", Role::Position(x.clone()), place),
                Column::new("e", Role::Error(x.clone()), vec![0.0; 9]),
            ];
            let record = Record::new(Path::new("r.run.toml"), kind, columns).unwrap();
            let said = machine.predict(&record).unwrap().columns[0].1[0];
            assert!((said - um).abs() < 1e-12, "{kind:?} to {to_mm} mm: {said} and {um}");
        };
        says(&machine, RunKind::Drift, 0.0, 2.9);
        says(&machine, RunKind::Drift, 300.0, 0.0);
        says(&machine, RunKind::Plate, 0.0, 0.0);
        let own = Machine::parse(Path::new("m.toml"), &text.replace("set_up = true\n", "")).unwrap();
        says(&own, RunKind::Plate, 300.0, 2.9);
    }
}
