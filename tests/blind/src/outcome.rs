//! One case, made, judged and marked, with the baselines and the oracle.

use crate::baseline;
use crate::case::{Case, Hides};
use crate::class::{Class, Made};
use crate::judge::{self, Covered, Heard};
use crate::many;
use crate::oracle::oracle;
use crate::plan::Manner;
use crate::scene::Scene;
use crate::score::{Mark, Reply, mark, unordered};
use rtec_model::machine::Machine;

/// Counts of an answer to many hidden effects.
#[derive(Clone, Copy, Default, Debug)]
pub struct Counts {
    /// Effects that must be found.
    pub asked: usize,
    /// Of these, named or listed as an alternative of a name.
    pub found: usize,
    /// Names in the answer.
    pub named: usize,
    /// Of these, true.
    pub true_names: usize,
}

/// Result of a case.
pub struct Outcome {
    /// Its class.
    pub class: Class,
    /// The case, whose files are removed.
    pub case: Case,
    /// Mark of the answer.
    pub mark: Mark,
    /// Marks of forward selection by BIC, and of the LASSO.
    pub base: [Mark; 2],
    /// Whether least squares with the true names finds every effect significant.
    pub oracle: bool,
    /// The answer.
    pub reply: Reply,
    /// Share of the gap that is closed.
    /// It is measured on the hold-outs, or else taken from the document.
    pub closed: Option<f64>,
    /// The same with the true names.
    pub oracle_closed: Option<f64>,
    /// For many effects, the counts of answer, both baselines and oracle.
    pub counts: [Counts; 4],
    /// Parameters of found effects, and whether the truth is within their interval.
    pub covered: Vec<Covered>,
    /// Sizes of the oracle within their interval, and their number.
    pub oracle_covered: [usize; 2],
    /// Values that no machine can have.
    pub impossible: Vec<String>,
    /// Why the files were refused, if they were.
    pub refused: Option<String>,
    /// A mistake's number, how it was treated, and the suspicions of its twin.
    pub mistake: Option<(usize, Heard, Vec<String>)>,
    /// Suspicions of the answer.
    pub suspicions: Vec<String>,
    /// Processor time of the reconciliation, s.
    pub seconds: f64,
}

/// Makes a case and judges it.
///
/// # Errors
/// When the case cannot be written, or a case of the narrow classes is refused.
pub fn outcome(class: Class, seed: u64, manner: Manner, baselines: bool) -> anyhow::Result<Outcome> {
    let dir = tempfile::tempdir()?;
    let Made { case, scene, mistake } = class.make(seed, manner, dir.path())?;
    let (v, refused) = judge::answer(&case);
    if let (Class::Narrow(_), Some(why)) = (class, &refused) {
        anyhow::bail!("{class:?} seed {seed}: {why}");
    }
    let mut base = [Mark::Missed; 2];
    let mut counts = [Counts::default(); 4];
    let told = scene.as_ref().filter(|_| case.hides == Hides::Many).map(|s| (s, many::detectable(s)));
    if let Some((s, told)) = &told {
        counts[0] = count(s, told, &v.reply);
    }
    if baselines && refused.is_none() {
        let train = case
            .train
            .iter()
            .map(|p| rtec_measure::run_record_files::read(p))
            .collect::<Result<Vec<_>, _>>()?;
        let machine = Machine::read(&case.model)?;
        for (k, way) in [baseline::forward_bic, baseline::lasso].iter().enumerate() {
            let names = way(&train, &machine);
            let verdict = if names.is_empty() { "nothing_missing" } else { "named" }.to_owned();
            let reply = Reply { verdict, effects: names.into_iter().map(|n| (n, vec![])).collect() };
            base[k] = mark(&case, &reply);
            if let Some((s, told)) = &told {
                counts[1 + k] = count(s, told, &reply);
                base[k] = many_mark(&reply, counts[1 + k]);
            }
        }
    }
    let mut result = if told.is_some() { many_mark(&v.reply, counts[0]) } else { mark(&case, &v.reply) };
    if refused.is_some() {
        result = Mark::Refused;
    }
    let mut ceiling = None;
    let mut closed = v.closed;
    // A record with a mistake has no ceiling.
    if let Some(s) = scene.as_ref().filter(|_| mistake.is_none()) {
        let floor = judge::floor(s);
        if let Some([before, after]) = v.held {
            closed = judge::closed(before, after, floor);
        }
        let o = oracle(s, v.held.map(|h| h[0]), floor);
        if let Some((_, told)) = &told {
            let found = told.iter().zip(&o.stands).filter(|(t, s)| **t && **s).count();
            let asked = told.iter().filter(|t| **t).count();
            counts[3] = Counts { asked, found, named: 1, true_names: 1 };
        }
        ceiling = Some(o);
    }
    let mistake = mistake.map(|(m, clean)| {
        let (twin, _) = judge::answer(&clean);
        let kind = crate::mistakes::KINDS.iter().position(|(_, text)| *text == m.text).unwrap_or(0);
        (kind, judge::heard(&v, &m, &case), judge::suspicions(&twin.document))
    });
    Ok(Outcome {
        class,
        mark: result,
        base,
        oracle: ceiling.as_ref().is_some_and(|o| {
            let asked = |k: usize| told.as_ref().is_none_or(|(_, t)| t[k]);
            o.stands.iter().enumerate().all(|(k, s)| *s || !asked(k))
        }),
        closed,
        oracle_closed: ceiling.as_ref().and_then(|o| o.closed),
        counts,
        covered: scene.as_ref().map_or(vec![], |s| judge::covered(&v.document, &s.hidden)),
        oracle_covered: ceiling.map_or([0, 0], |o| o.covered),
        impossible: judge::impossible(&v.document),
        suspicions: judge::suspicions(&v.document),
        refused,
        mistake,
        seconds: v.cpu_s,
        reply: v.reply,
        case,
    })
}

/// Counts of an answer to many effects.
/// A name whose alternatives contain the truth counts as true.
fn count(scene: &Scene, told: &[bool], reply: &Reply) -> Counts {
    let group = |(name, others): &(String, Vec<String>)| -> Vec<String> {
        std::iter::once(name).chain(others).map(|n| unordered(n)).collect()
    };
    let groups: Vec<Vec<String>> = reply.effects.iter().map(group).collect();
    let truth: Vec<String> = scene.hidden.iter().map(|h| unordered(&h.name)).collect();
    let found = |t: &String| groups.iter().any(|g| g.contains(t));
    Counts {
        asked: told.iter().filter(|t| **t).count(),
        found: truth.iter().zip(told).filter(|(t, asked)| **asked && found(t)).count(),
        named: groups.len(),
        true_names: groups.iter().filter(|g| truth.iter().any(|t| g.contains(t))).count(),
    }
}

fn many_mark(reply: &Reply, c: Counts) -> Mark {
    if c.true_names < c.named {
        Mark::Wrong
    } else if c.found == c.asked {
        Mark::Exact
    } else if c.found > 0 {
        Mark::Partial
    } else if reply.verdict == "unknown_effect" {
        Mark::CalledUnknown
    } else {
        Mark::Missed
    }
}
