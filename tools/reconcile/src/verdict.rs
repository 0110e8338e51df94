//! The answer as a whole.

use crate::answer::{Finding, Rival, Tried};
use crate::cause::Shape;
use crate::gap::{Gap, Trace};
use crate::where_found::Place;
use rtec_measure::plausible::Suspicion;
use rtec_model::effect::{Effect, Search};
use rtec_model::machine::Machine;
use serde::Serialize;
use std::fmt;

/// The answer in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Effects of the dictionary explain what was missing.
    Named,
    /// Model and measurement agree, but for parameters of the model that the data corrected.
    NothingMissing,
    /// Something is missing that no effect of the dictionary explains.
    UnknownEffect,
    /// Something is missing, and these data do not tell which of several names it has.
    NotSeparable,
}

impl Verdict {
    /// From what was added to the model, and what stayed unexplained.
    #[must_use]
    pub fn of(added: &[(Finding, Vec<f64>)], unexplained: &[Shape]) -> Self {
        if !unexplained.is_empty() {
            Self::UnknownEffect
        } else if added.is_empty() {
            Self::NothingMissing
        } else if added
            .iter()
            .any(|(f, half)| !is_companion(f, added) && f.rivals.iter().any(|r| is_another(r, f, half)))
        {
            Self::NotSeparable
        } else {
            Self::Named
        }
    }

    /// As `verdict.json` has it.
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

/// At odds of one to less than so much neither of two is the likelier, nats.
const EVEN: f64 = 0.7;

/// Whether a rival is another explanation: another name, or another value where neither is likelier, or the size hangs on which of
/// them it is. Another sensor of the same name is none.
fn is_another(rival: &Rival, finding: &Finding, half: &[f64]) -> bool {
    let effect = &finding.effect;
    let size = effect.description().place(Search::Amplitude).filter(|_| effect.width() == 1);
    let open = |i: usize| half.get(i).is_some_and(|half| *half > effect.scalar(i).abs());
    rival.name != effect.name() || rival.differs.is_some() && (rival.margin < EVEN || size.is_some_and(open))
}

/// Whether a finding is the constant of another, a law's own zero: what else it may be does not matter. Lost counts are whole,
/// and none before they were lost: they have no zero of their own.
fn is_companion(finding: &Finding, added: &[(Finding, Vec<f64>)]) -> bool {
    let constant = finding.effect.description().constant;
    let beside = |f: &Finding| f.effect.companion().is_some_and(|c| c.name() == finding.effect.name());
    let zeroed =
        |f: &Finding| f.effect.name() != finding.effect.name() && !f.effect.description().whole_counts;
    added.iter().any(|(f, _)| beside(f) || (constant && zeroed(f)))
}

/// What the data correct in the present model.
#[derive(Debug, Clone)]
pub struct Refined {
    /// Place in the model.
    pub place: usize,
    /// The effect as it was.
    pub before: Effect,
    /// The effect as the data have it, and half widths of its intervals.
    pub after: (Effect, Vec<f64>),
}

/// The whole answer.
#[derive(Debug)]
pub struct Reconciliation {
    /// The answer in one word.
    pub verdict: Verdict,
    /// Where measured and simulated disagree.
    pub places: Vec<Place>,
    /// Mistakes that the data show: what they are against was left out.
    pub suspicions: Vec<Suspicion>,
    /// What was left out, a line each: records, rows, sensors.
    pub left_out: Vec<String>,
    /// Records that were left out whole: the verdict says nothing of them.
    pub unsaid: Vec<Unsaid>,
    /// Velocities and accelerations that were derived from positions, a line each.
    pub derived: Vec<String>,
    /// What was added, strongest first, with half widths of the intervals.
    pub effects: Vec<(Finding, Vec<f64>)>,
    /// Structure without a name.
    pub unexplained: Vec<Shape>,
    /// Where asked for: the curve that stands for what is unexplained, and the file of its law.
    pub curve: Option<(Effect, String)>,
    /// Corrected parameters.
    pub refined: Vec<Refined>,
    /// The gap, one per unit.
    pub gap: Vec<Gap>,
    /// The experiment that would separate what this data cannot.
    pub advice: String,
    /// Names that were tried.
    pub ranking: Vec<Tried>,
    /// The better model.
    pub model: Machine,
    /// Per record and response: role, measured minus simulated before and after.
    pub traces: Vec<Trace>,
    /// False-alarm rate.
    pub level: f64,
    /// Autocorrelation of the noise from row to row.
    pub phi: f64,
    /// Every so many rows were analysed: 1 for all.
    pub every: usize,
}

/// A record that was left out whole.
#[derive(Debug, Clone)]
pub struct Unsaid {
    /// Its sidecar as it was named.
    pub record: String,
    /// What it is suspected of.
    pub why: String,
}

impl fmt::Display for Unsaid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { record, why } = self;
        if why.is_empty() { f.write_str(record) } else { write!(f, "{record} ({why})") }
    }
}

impl Reconciliation {
    /// What the verdict does not speak of, for its headline; nothing where it speaks of all that was given.
    #[must_use]
    pub fn unsaid(&self) -> Option<String> {
        let records: Vec<String> = self.unsaid.iter().map(ToString::to_string).collect();
        (!records.is_empty()).then(|| format!("nothing is said of {}: left out", records.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::answer::Rival;
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
    fn rivals_make_it_not_separable_and_shapes_unknown() {
        let finding = |rivals: Vec<Rival>| {
            let effect = Dictionary::default().effect("scale.x").unwrap();
            (Finding { effect, held: Vec::new(), p_value: 0.0, evidence: 9.0, rivals }, vec![0.1])
        };
        let rival = Rival { name: "offset.x".into(), sensor: None, differs: None, margin: 1.0 };
        let shape =
            Shape { response: "error.x".into(), against: vec!["time".into()], manner: "smooth".into() };
        assert_eq!(Verdict::of(&[], &[]), Verdict::NothingMissing);
        assert_eq!(Verdict::of(&[finding(Vec::new())], &[]), Verdict::Named);
        assert_eq!(Verdict::of(&[finding(Vec::new()), finding(vec![rival])], &[]), Verdict::NotSeparable);
        assert_eq!(Verdict::of(&[finding(Vec::new())], &[shape]), Verdict::UnknownEffect);
    }

    /// A constant that may be heat is no name beside lost counts, which have no zero; beside a scale it is the record's.
    #[test]
    fn a_constant_s_rivals_count_beside_lost_counts() {
        let of = |name: &str, rivals: Vec<Rival>| {
            let effect = Dictionary::default().effect(name).unwrap();
            (Finding { effect, held: Vec::new(), p_value: 0.0, evidence: 9.0, rivals }, vec![0.1])
        };
        let heat = || vec![Rival { name: "warm_up.x".into(), sensor: None, differs: None, margin: 1.0 }];
        let offset = of("offset.x", heat());
        let beside = |name: &str| Verdict::of(&[of(name, Vec::new()), offset.clone()], &[]);
        assert_eq!(beside("lost_counts.x"), Verdict::NotSeparable);
        assert_eq!(beside("scale.x"), Verdict::Named);
        assert_eq!(beside("warm_up.x"), Verdict::Named);
    }
}
