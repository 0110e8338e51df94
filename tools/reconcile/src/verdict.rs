//! The whole answer of a reconciliation.

use crate::findings_from_estimate::FoundEffect;
use crate::gap::{Gap, ResidualTrace, chance, unit_of};
use crate::residual_localisation::ResidualStructure;
use rtec_estimate::priors::HELD;
use rtec_estimate::set_up_terms::SetUpTermKind;
use rtec_estimate::{TriedExplanation, UnnamedShape};
use rtec_files::InputNotice;
use rtec_measure::plausible::{self, Suspicion};
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};
use serde::Serialize;
use std::fmt;

/// The verdict: the answer in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Effects of the dictionary explain what was missing.
    Named,
    /// Model and measurement agree, apart from parameters that the data corrected.
    NothingMissing,
    /// Something is missing that no effect of the dictionary explains.
    UnknownEffect,
    /// Something is missing, but the data do not decide between several names.
    NotSeparable,
}

impl Verdict {
    /// The verdict from what was added to the model and what stayed unexplained.
    /// A shape makes it unknown. A name, or a mode of it, with too small a posterior share makes it not
    /// separable.
    #[must_use]
    pub fn of(added: &[(FoundEffect, Vec<f64>)], unexplained: &[UnnamedShape]) -> Self {
        let holds = |f: &FoundEffect| f.name_mass >= HELD && f.mode_mass >= HELD;
        match (unexplained, added) {
            ([_, ..], _) => Self::UnknownEffect,
            ([], []) => Self::NothingMissing,
            ([], all) if all.iter().all(|(f, _)| holds(f)) => Self::Named,
            _ => Self::NotSeparable,
        }
    }

    /// Its name in `verdict.json`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Named => "named",
            Self::NothingMissing => "nothing_missing",
            Self::UnknownEffect => "unknown_effect",
            Self::NotSeparable => "not_separable",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A correction of an effect that the model already has.
#[derive(Debug, Clone)]
pub struct RevisedEffect {
    /// Its index in the model.
    pub place: usize,
    /// The effect before the correction.
    pub before: Effect,
    /// The corrected effect, and half widths of its intervals.
    pub after: (Effect, Vec<f64>),
}

/// The set-up found for one record: it is not part of any model.
#[derive(Debug, Clone)]
pub struct RecordSetUp {
    /// The record's sidecar.
    pub record: String,
    /// Term, value and half width of its 95 % interval.
    /// Terms are `zero_um.error.x`, `centre_um`, `bar_um`, `line_um_per_h`, `line_um_per_run` (if the run has
    /// no time) and `jump_um`.
    pub terms: Vec<(String, f64, f64)>,
}

impl RecordSetUp {
    /// The set-ups per record, in the records' order.
    pub(crate) fn of(records: &[Record], found: &[rtec_estimate::SetUpEstimate]) -> Vec<Self> {
        let timed = |s: &rtec_estimate::SetUpEstimate| records[s.record].column(&Role::Time).is_some();
        // The estimator assumes for a run without times the hours that a creep keeps its direction.
        let runs = |s: &rtec_estimate::SetUpEstimate| {
            if s.what == SetUpTermKind::Line && !timed(s) { rtec_estimate::priors::LINE_HOURS } else { 1.0 }
        };
        let name = |s: &rtec_estimate::SetUpEstimate| match (s.what, s.response.as_str()) {
            (SetUpTermKind::Zero, "error.r") => "bar_um".to_owned(),
            (SetUpTermKind::Zero, response) => format!("zero_um.{response}"),
            (SetUpTermKind::CentreFirst, _) => "centre_um.0".to_owned(),
            (SetUpTermKind::CentreSecond, _) => "centre_um.1".to_owned(),
            (SetUpTermKind::Line, response) => {
                format!("line_um_per_{}.{response}", if timed(s) { "h" } else { "run" })
            }
            _ => "jump_um".to_owned(),
        };
        let of = |(i, r): (usize, &Record)| Self {
            record: r.path.display().to_string(),
            terms: found
                .iter()
                .filter(|s| s.record == i)
                .map(|s| (name(s), s.value * runs(s), s.half * runs(s)))
                .collect(),
        };
        records.iter().enumerate().map(of).collect()
    }
}

/// The whole answer.
#[derive(Debug)]
pub struct ReconciliationResult {
    /// The answer in one word.
    pub verdict: Verdict,
    /// Where measured and simulated disagree.
    pub places: Vec<ResidualStructure>,
    /// Mistakes that the data show; the data concerned were left out.
    pub suspicions: Vec<Suspicion>,
    /// What was left out, one line each: records, rows, sensors.
    pub left_out: Vec<String>,
    /// Records that were left out whole, which the verdict does not cover.
    pub skipped_records: Vec<SkippedRecord>,
    /// Velocities and accelerations that were derived from positions, one line each.
    pub derived: Vec<String>,
    /// Added effects, strongest first, with half widths of their intervals.
    pub effects: Vec<(FoundEffect, Vec<f64>)>,
    /// Structure without a name.
    pub unexplained: Vec<UnnamedShape>,
    /// On request: the curve for what is unexplained, and the text of its law's file.
    pub curve: Option<(Effect, String)>,
    /// Why there is no such curve, where one was asked for.
    pub no_curve: Option<String>,
    /// Corrected parameters.
    pub refined: Vec<RevisedEffect>,
    /// The gap, one per unit.
    pub gap: Vec<Gap>,
    /// Whether the findings make the hold-outs no worse; `None` without a hold-out.
    pub confirmed: Option<bool>,
    /// The set-up found for each record.
    pub set_up: Vec<RecordSetUp>,
    /// The experiment that would separate what these data cannot.
    pub advice: String,
    /// Names that were tried.
    pub ranking: Vec<TriedExplanation>,
    /// The better model.
    pub model: Machine,
    /// The training records as used: without what was left out.
    pub records: Vec<Record>,
    /// Per record and response: role, measured minus simulated before and after.
    pub traces: Vec<ResidualTrace>,
    /// False-alarm rate.
    pub level: f64,
    /// Autocorrelation of the noise from row to row.
    pub phi: f64,
    /// The stride between analysed rows, of the record with the largest: 1 for all.
    pub every: usize,
}

/// A record that was left out whole.
#[derive(Debug, Clone)]
pub struct SkippedRecord {
    /// Its sidecar, as the user named it.
    pub record: String,
    /// What it is suspected of.
    pub why: String,
}

impl fmt::Display for SkippedRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { record, why } = self;
        if why.is_empty() { f.write_str(record) } else { write!(f, "{record} ({why})") }
    }
}

impl ReconciliationResult {
    /// Whether more is left of the training rows than their noise.
    /// Of the rows count as many as the noise's memory leaves independent.
    #[must_use]
    pub fn is_above_floor(&self, gap: &Gap) -> bool {
        let own = self.traces.iter().filter(|t| !t.holdout && unit_of(&t.response) == gap.unit);
        let rows: usize = own.map(|t| t.before.len()).sum();
        let independent = rows as f64 * (1.0 - self.phi) / (1.0 + self.phi);
        gap.train[0].powi(2) > gap.floor.powi(2) * chance(independent)
    }

    /// Reports derived columns, suspicions, and conditions that are no mistakes.
    pub fn say_of(&self, train: &[Record], holdout: &[Record], say: &mut dyn FnMut(InputNotice)) {
        self.derived.iter().cloned().map(InputNotice::Note).for_each(&mut *say);
        self.suspicions.iter().map(ToString::to_string).map(InputNotice::Warning).for_each(&mut *say);
        for records in [train, holdout] {
            plausible::say_conditions(records, &self.suspicions, say);
        }
    }

    /// What limits the verdict, for its headline.
    /// Hold-outs that got worse, and records that it does not cover.
    #[must_use]
    pub fn reservation(&self) -> Option<String> {
        let records: Vec<String> = self.skipped_records.iter().map(ToString::to_string).collect();
        let unsaid = format!("nothing is said of {}: left out", records.join(", "));
        let worse = (self.confirmed == Some(false)).then(|| "not confirmed by the hold-out".to_owned());
        let parts: Vec<String> = worse.into_iter().chain((!records.is_empty()).then_some(unsaid)).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_model::effect::Dictionary;

    #[test]
    fn the_document_and_people_read_one_name() {
        for verdict in
            [Verdict::Named, Verdict::NothingMissing, Verdict::UnknownEffect, Verdict::NotSeparable]
        {
            assert_eq!(serde_json::json!(verdict), verdict.to_string());
        }
    }

    #[test]
    fn a_name_that_does_not_hold_its_place_is_not_separable() {
        let finding = |name_mass: f64, mode_mass: f64| {
            let effect = Dictionary::default().effect("scale.x").unwrap();
            let rivals = Vec::new();
            (
                FoundEffect {
                    effect,
                    held: Vec::new(),
                    p_value: 0.0,
                    evidence: 9.0,
                    name_mass,
                    mode_mass,
                    rivals,
                },
                vec![0.1],
            )
        };
        let shape = UnnamedShape {
            response: "error.x".into(),
            against: vec!["time".into()],
            manner: "smooth".into(),
        };
        assert_eq!(Verdict::of(&[], &[]), Verdict::NothingMissing);
        assert_eq!(Verdict::of(&[finding(0.99, 0.97)], &[]), Verdict::Named);
        assert_eq!(Verdict::of(&[finding(0.99, 0.9), finding(0.7, 0.9)], &[]), Verdict::NotSeparable);
        assert_eq!(Verdict::of(&[finding(0.99, 0.9)], &[]), Verdict::NotSeparable);
        assert_eq!(Verdict::of(&[finding(0.99, 0.9)], &[shape]), Verdict::UnknownEffect);
    }
}
