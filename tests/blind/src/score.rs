//! Marks of answers.

use crate::case::{Case, Hides};

/// Mark of an answer.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Mark {
    /// The hidden effects are named, and no other.
    Exact,
    /// Called not separable, with the truth in the group.
    Group,
    /// Nothing found although something was hidden.
    Missed,
    /// Some of several found, and nothing wrong.
    Partial,
    /// A wrong name given with confidence.
    Wrong,
    /// Called unknown although it has a name.
    CalledUnknown,
    /// Called not separable, without the truth in the group.
    WrongGroup,
    /// The case's files were refused.
    Refused,
}

/// Verdict where the files were refused.
pub const REFUSED: &str = "refused";

/// An answer: verdict, names, and for each name its alternatives.
pub struct Reply {
    /// The verdict's word.
    pub verdict: String,
    /// Names with their alternatives.
    pub effects: Vec<(String, Vec<String>)>,
}

/// Marks a reply against what the case hides.
pub fn mark(case: &Case, reply: &Reply) -> Mark {
    if reply.verdict == REFUSED {
        return Mark::Refused;
    }
    let named = |set: &Vec<String>| {
        // The constant and the straight line of a map have names of their own.
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

/// A name with sorted factors: `angular.A.B.C` equals `angular.A.C.B`.
pub(crate) fn unordered(name: &str) -> String {
    let mut parts: Vec<&str> = name.split('.').collect();
    if parts[0] == "angular" && parts.len() == 4 {
        parts[2..].sort_unstable();
    }
    parts.join(".")
}
