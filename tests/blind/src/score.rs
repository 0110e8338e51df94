//! The score of an answer, and the table of all.

use crate::case::{Case, Hides};

/// What an answer came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Mark {
    /// The hidden effects are named, and no other.
    Exact,
    /// Called not separable, with the truth in the group.
    Group,
    /// Nothing found where something was hidden.
    Missed,
    /// Some of several found, nothing wrong beside them.
    Partial,
    /// A wrong name given with confidence.
    Wrong,
    /// Called unknown where it has a name.
    CalledUnknown,
    /// Called not separable, the truth not in the group.
    WrongGroup,
    /// The case's files were refused.
    Refused,
}

/// Verdict of an answer that is none: the files were refused.
pub const REFUSED: &str = "refused";

/// An answer: verdict, names, and for each name its alternatives.
pub struct Reply {
    /// As in the verdict.
    pub verdict: String,
    /// Names with their alternatives.
    pub effects: Vec<(String, Vec<String>)>,
}

/// Marks a reply against what the case hides.
#[must_use]
pub fn mark(case: &Case, reply: &Reply) -> Mark {
    if reply.verdict == REFUSED {
        return Mark::Refused;
    }
    let named = |set: &Vec<String>| {
        // The constant and the straight line of a map go by names of their own.
        let beside = |n: &str| n.starts_with("offset.") || n.starts_with("scale.");
        let mut names: Vec<&str> =
            reply.effects.iter().map(|(n, _)| n.as_str()).filter(|n| !beside(n)).collect();
        names.sort_unstable();
        names.iter().eq(set.iter())
    };
    if case.also.iter().any(named) {
        return Mark::Exact;
    }
    let mut got: Vec<&str> = reply.effects.iter().map(|(n, _)| n.as_str()).collect();
    let mut want: Vec<&str> = case.truth.iter().map(String::as_str).collect();
    let same: Vec<String> = got.iter().map(|g| unordered(g)).collect();
    got = same.iter().map(String::as_str).collect();
    let wanted: Vec<String> = want.iter().map(|g| unordered(g)).collect();
    want = wanted.iter().map(String::as_str).collect();
    // A constant is the gauge's zero, and no finding.
    let constant = |n: &&str| !n.starts_with("offset.");
    got.retain(constant);
    want.retain(constant);
    got.sort_unstable();
    want.sort_unstable();
    if want.is_empty() && matches!(case.hides, Hides::One | Hides::Two) {
        let quiet = reply.verdict == "nothing_missing" || reply.verdict == "named" && got.is_empty();
        return if quiet { Mark::Exact } else { Mark::Wrong };
    }
    match (case.hides, reply.verdict.as_str()) {
        (Hides::Nothing, "nothing_missing") | (Hides::Stranger, "unknown_effect") => Mark::Exact,
        (Hides::Nothing, _) => Mark::Wrong,
        (Hides::Stranger, "nothing_missing") => Mark::Missed,
        (Hides::Stranger, "not_separable") => Mark::WrongGroup,
        (Hides::Stranger, _) => Mark::Wrong,
        (_, "unknown_effect") => Mark::CalledUnknown,
        (_, "nothing_missing") => Mark::Missed,
        (_, "named") if got == want => Mark::Exact,
        (_, "named") if got.iter().all(|g| want.contains(g)) => Mark::Partial,
        (_, "named") => Mark::Wrong,
        _ => {
            let covered = |w: &str| {
                reply
                    .effects
                    .iter()
                    .any(|(n, alt)| unordered(n) == w || alt.iter().any(|a| unordered(a) == w))
            };
            if want.iter().all(|w| covered(w)) && got.len() <= want.len() {
                Mark::Group
            } else {
                Mark::WrongGroup
            }
        }
    }
}

/// angular.A.B.C is the same product whichever of B and C comes first.
pub(crate) fn unordered(name: &str) -> String {
    let mut parts: Vec<&str> = name.split('.').collect();
    if parts[0] == "angular" && parts.len() == 4 {
        parts[2..].sort_unstable();
    }
    parts.join(".")
}
