//! Looks for people's mistakes before anything is explained.
//! It reports what the records show by themselves (`rtec_measure::plausible`). It also reports a record that
//! agrees with the model only with another sign, unit, direction or sensor. Doubted data is reported and left
//! out of the analysis. It is never named as an effect.

use crate::findings_from_estimate::stated;
use crate::gap::{self, Gap};
use crate::suspicion_scope::{about, is_of_clock, is_one_of_several, is_sensor, whole};
use crate::verdict::SkippedRecord;
use rtec_estimate::evidence_without_hypotheses;
use rtec_estimate::measurement_model::UnitAssumption;
use rtec_measure::plausible::{self, MistakeKind, Suspicion};
use rtec_model::effect::{Effect, ThermalDependence};
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role};

/// Ratio of the gap after to the gap before from which chance is excluded.
const WORSE: f64 = 1.1;
/// Smallest number of rows that allows a judgement.
const FEWEST: usize = 12;
/// Ratio of residual to training noise that indicates another machine or state.
/// It is formed for each hold-out, under the better model.
const OTHER: f64 = 4.0;

/// The suspicions, and the records to analyse.
pub(crate) struct ScreenedRecords {
    pub(crate) suspicions: Vec<Suspicion>,
    /// The training records without doubted data; empty if all is doubted.
    pub(crate) train: Vec<Record>,

    /// What was left out of the training, one line each.
    pub(crate) left_out: Vec<String>,
    holdout: Vec<Record>,
    of_holdout: Vec<Suspicion>,
}

/// Checks all records by themselves and against each other.
/// A hold-out's findings do not affect the training.
pub(crate) fn doubts(train: &[Record], holdout: &[Record], machine: &Machine) -> ScreenedRecords {
    let all: Vec<&Record> = train.iter().chain(holdout).collect();
    let twice = plausible::repeated(&all);
    let again = |(first, k): &(usize, usize)| Suspicion::again(all[*first], all[*k]);
    let mut left_out: Vec<String> =
        twice.iter().map(|(_, k)| format!("{}: given twice", all[*k].path.display())).collect();
    let mut said: Vec<Suspicion> = twice.iter().map(again).collect();
    let once = |from: usize, records: &[Record]| -> Vec<Record> {
        let new = |k: &usize| twice.iter().all(|(_, again)| *again != from + k);
        (0..records.len()).filter(new).map(|k| records[k].clone()).collect()
    };
    let (train, holdout) = (once(0, train), once(train.len(), holdout));
    let of_train = suspicions(&train, machine);
    let mut together = Vec::new();
    if !holdout.is_empty() {
        together = suspicions(&[&train[..], &holdout].concat(), machine);
    }
    together.retain(|s| !of_train.contains(s));
    // Suspicions of training records that only hold-outs show are reported without further effect.
    let (mut of_holdout, beside): (Vec<_>, Vec<_>) =
        together.into_iter().partition(|s| holdout.iter().any(|r| about(s, r)));
    // If two records have opposite signs and the model accuses the training, the hold-out is not accused.
    let turned = |s: &Suspicion| {
        s.what == MistakeKind::Sign && of_train.iter().any(|t| (t.what, &t.column) == (s.what, &s.column))
    };
    of_holdout.retain(|s| !turned(s));
    said.extend(of_train.iter().chain(&beside).chain(&of_holdout).cloned());
    let left: Vec<Record> = train.iter().filter_map(|r| without(r, &of_train, machine)).collect();
    left_out.extend(lines(&train, &left, &of_train));
    ScreenedRecords { suspicions: said, train: left, left_out, holdout, of_holdout }
}

/// The mistakes that records show by themselves.
/// Outlying readings count only if the model does not explain them.
fn suspicions(records: &[Record], machine: &Machine) -> Vec<Suspicion> {
    let mut found = plausible::suspicions(records);
    let is_wild = |s: &Suspicion| s.what == MistakeKind::Outliers && !s.is_of_sensor();
    if found.iter().any(is_wild) {
        let model: Vec<Effect> = machine.effects().cloned().collect();
        let beside = |r: &Record| {
            let (mut left, n) = (r.clone(), r.rows());
            let values = rtec_estimate::unexplained(r, &model);
            let responses = left.columns.iter_mut().filter(|c| c.role.is_response());
            responses.zip(values.chunks(n)).for_each(|(c, v)| c.data.copy_from_slice(v));
            left
        };
        let still = plausible::suspicions(&records.iter().map(beside).collect::<Vec<_>>());
        let same = |s: &Suspicion, o: &Suspicion| {
            (&s.record, &s.column, s.what) == (&o.record, &o.column, o.what)
                && s.row_list().iter().any(|row| o.row_list().contains(row))
        };
        found.retain(|s| !is_wild(s) || still.iter().any(|o| same(s, o)));
    }
    found
}

impl ScreenedRecords {
    /// The hold-outs without doubted columns that the model reads.
    /// Columns that it does not read may be wrong. Also says what was left out.
    pub(crate) fn holdouts(&self, model: &Machine) -> (Vec<Record>, Vec<String>) {
        let left: Vec<Record> =
            self.holdout.iter().filter_map(|r| without(r, &self.of_holdout, model)).collect();
        let lines = lines(&self.holdout, &left, &self.of_holdout);
        (left, lines)
    }

    /// Leaves out training records whose clock is in doubt; true if there were any.
    /// Such records cannot show a lag.
    pub(crate) fn without_clocks(&mut self) -> bool {
        let before = self.train.len();
        let said = std::mem::take(&mut self.suspicions);
        let of_clock = |r: &Record| said.iter().any(|s| about(s, r) && is_of_clock(s, r));
        self.drop_where(|r| of_clock(r).then_some(MistakeKind::Unit));
        self.suspicions = said;
        self.train.len() < before
    }

    /// Leaves out the training records with a mistake, the last one first.
    fn drop_where(&mut self, mistake: impl Fn(&Record) -> Option<MistakeKind>) {
        for record in std::mem::take(&mut self.train).into_iter().rev() {
            match mistake(&record) {
                Some(what) => self.left_out.push(format!("{}: all of it ({what})", record.path.display())),
                None => self.train.insert(0, record),
            }
        }
    }

    /// The given records that are used neither for learning nor for judging, and why.
    pub(crate) fn skipped_records(
        &self,
        train: &[Record],
        holdout: &[Record],
        model: &Machine,
    ) -> Vec<SkippedRecord> {
        let held = self.holdouts(model).0;
        let of = |all: &[Record], left: &[Record]| -> Vec<SkippedRecord> {
            let gone = all.iter().filter(|r| left.iter().all(|l| l.path != r.path));
            // A record that is given twice is reported once.
            let own =
                |r: &&Record| self.suspicions.iter().filter(|s| about(s, r)).collect::<Vec<&Suspicion>>();
            let again = |r: &&Record| own(r).iter().any(|s| s.what == MistakeKind::Doubled && whole(s, r));
            let unsaid = |r: &Record| {
                let mut why: Vec<&str> = own(&r).iter().map(|s| s.what.name()).collect();
                why.dedup();
                SkippedRecord { record: r.path.display().to_string(), why: why.join(", ") }
            };
            gone.filter(|r| !again(r)).map(unsaid).collect()
        };
        [of(train, &self.train), of(holdout, &held)].concat()
    }

    /// Adds suspicions of hold-outs, which are then left out.
    pub(crate) fn also_held(&mut self, more: Vec<Suspicion>) {
        self.suspicions.extend(more.iter().cloned());
        self.of_holdout.extend(more);
    }

    /// The hold-outs as given, without duplicates.
    pub(crate) fn given_hold_outs(&self) -> &[Record] {
        &self.holdout
    }

    /// Adds suspicions of whole training records, which are then left out.
    pub(crate) fn also(&mut self, more: Vec<Suspicion>) {
        self.drop_where(|r| more.iter().find(|s| about(s, r)).map(|s| s.what));
        self.suspicions.extend(more);
    }
}

/// What is missing from the records afterwards, one line each.
fn lines(before: &[Record], after: &[Record], said: &[Suspicion]) -> Vec<String> {
    let mut out = Vec::new();
    for record in before {
        let path = record.path.display();
        let mut why: Vec<&str> = said.iter().filter(|s| about(s, record)).map(|s| s.what.name()).collect();
        why.dedup();
        let why = if why.is_empty() { "in another record".to_owned() } else { why.join(", ") };
        let Some(left) = after.iter().find(|r| r.path == record.path) else {
            out.push(format!("{path}: all of it ({why})"));
            continue;
        };
        let rows = record.rows() - left.rows();
        if rows > 0 {
            out.push(format!("{path}: {rows} of {} rows ({why})", record.rows()));
        }
        let gone = |c: &&Column| left.columns.iter().all(|o| o.name != c.name);
        out.extend(record.columns.iter().filter(gone).map(|c| format!("{path}: {} ({why})", c.name)));
    }
    out
}

/// The record without its doubted columns; `None` if nothing remains.
fn without(record: &Record, said: &[Suspicion], machine: &Machine) -> Option<Record> {
    let clocked = machine.effects().any(reads_clock);
    let useless = |s: &Suspicion| whole(s, record) || clocked && is_of_clock(s, record);
    if said.iter().any(|s| about(s, record) && useless(s)) {
        return None;
    }
    let read = |name: &str| {
        let reads = |e: &Effect| {
            e.channel() == Some(name) || e.delta.as_ref().is_some_and(|d| d.sensors().any(|n| n == name))
        };
        machine.effects().any(reads)
    };
    let of_rows: Vec<Suspicion> = said.iter().filter(|s| !is_sensor(record, &s.column)).cloned().collect();
    let mut rows = plausible::unusable(&of_rows).rows(record);
    let mut sensors: Vec<&str> = Vec::new();
    for s in said.iter().filter(|s| is_sensor(record, &s.column)) {
        let (own, few) = (s.row_list(), s.is_few());
        if few && about(s, record) {
            // A few bad readings cost only their rows.
            rows.extend(own);
        } else if !few && !read(&s.column) {
            // A sensor that is doubted in one record is not used as a cause in any.
            sensors.push(&s.column);
        } else if !few && about(s, record) {
            if own.is_empty() {
                return None;
            }
            rows.extend(own);
        }
    }
    rows.sort_unstable();
    rows.dedup();
    let keep: Vec<usize> = (0..record.rows()).filter(|i| rows.binary_search(i).is_err()).collect();
    if keep.len() < FEWEST.min(record.rows()) {
        return None;
    }
    let mut left = if keep.len() < record.rows() { record.select(&keep) } else { record.clone() };
    left.columns.retain(|c| !sensors.contains(&c.name.as_str()) || !is_sensor(record, &c.name));
    let still = |s: &&Suspicion| s.what == MistakeKind::Stuck && s.rows.is_empty() && about(s, record);
    for gauge in said.iter().filter(still).map(|s| &s.column) {
        if is_one_of_several(&left, gauge) {
            left.columns.retain(|c| c.name != *gauge);
        } else if left.responses().any(|c| c.name == *gauge) {
            return None;
        }
    }
    Some(left)
}

/// Whether an effect depends on the length of the clock's second.
pub(crate) fn reads_clock(effect: &Effect) -> bool {
    let law = effect.description();
    law.lag.is_some() || law.heat == ThermalDependence::FromStart
}

/// The indices of hold-outs that may be from another machine.
/// The better model describes them far worse than the training, and no better than the original model did.
/// The share of their gap that is closed is then meaningless. Each is judged by the residual after its own
/// set-up is removed.
pub(crate) fn other_machines(
    holdout: &[Record],
    before: &Machine,
    after: &Machine,
    gap: &[Gap],
) -> Vec<(usize, Suspicion)> {
    let mut found = Vec::new();
    for (k, record) in holdout.iter().enumerate() {
        let [old, new] = [before, after].map(|m| {
            let effects: Vec<Effect> = m.effects().cloned().collect();
            evidence_without_hypotheses(record, &effects, &stated(m), UnitAssumption::AsWritten).1
        });
        for g in gap {
            let size = |left: &[(Role, f64)]| {
                let own: Vec<f64> = left
                    .iter()
                    .filter(|(r, _)| gap::unit_of(&r.to_string()) == g.unit)
                    .map(|l| l.1)
                    .collect();
                gap::rms(&own)
            };
            let (before, after) = (size(&old), size(&new));
            let floor = g.floor.max(rtec_estimate::set_up_terms::resolution_um(record));
            let worse = after > WORSE * before.max(floor) && after > 2.0 * floor;
            if worse || (after > OTHER * floor && after > 0.7 * before) {
                let unit = if g.unit == "um" { "µm" } else { g.unit.as_str() };
                let text = format!(
                    "the model that leaves {floor:.2} {unit} of the training leaves {after:.2} {unit} of this hold-out: another \
                     machine, or another state of it?"
                );
                found.push((k, Suspicion::new(record, "", MistakeKind::OtherMachine, &[], text)));
                break;
            }
        }
    }
    found
}
