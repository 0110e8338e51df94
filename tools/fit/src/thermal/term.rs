//! The terms of a model, and the terms derived from them.

/// A sensor and the subtracted one, by their indices.
/// `None` for the reference temperature.
pub(super) type Pair = (usize, Option<usize>);

/// A model term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Term {
    /// Difference of two sensors, or to the reference, at a lag; possibly squared.
    Thermal { sensor: usize, minus: Option<usize>, lag: usize, square: bool },
    /// Whether coolant is on.
    Coolant,
    /// Spindle speed, krpm.
    Speed,
}

impl Term {
    /// A difference without lag or square.
    pub(super) fn plain((sensor, minus): Pair) -> Self {
        Self::Thermal { sensor, minus, lag: 0, square: false }
    }
}

/// The difference of a term; `None` for other terms.
pub(super) fn pair_of(term: Term) -> Option<Pair> {
    match term {
        Term::Thermal { sensor, minus, .. } => Some((sensor, minus)),
        _ => None,
    }
}

/// The square of a difference at the same lag.
pub(super) fn squared(term: Term) -> Option<Term> {
    match term {
        Term::Thermal { sensor, minus, lag, square: false } => {
            Some(Term::Thermal { sensor, minus, lag, square: true })
        }
        _ => None,
    }
}

/// The same terms with another lag for the k-th.
/// The square of the same difference gets it too.
pub(super) fn relagged(terms: &[Term], k: usize, other: usize) -> Vec<Term> {
    let Term::Thermal { sensor: s, minus: m, lag: l, .. } = terms[k] else { return terms.to_vec() };
    let of = |t: &Term| match *t {
        Term::Thermal { sensor, minus, lag, square } if (sensor, minus, lag) == (s, m, l) => {
            Term::Thermal { sensor, minus, lag: other, square }
        }
        t => t,
    };
    terms.iter().map(of).collect()
}

/// The same terms without their lags.
pub(super) fn unlagged(terms: &[Term]) -> Vec<Term> {
    let of = |t: &Term| match *t {
        Term::Thermal { sensor, minus, square, .. } => Term::Thermal { sensor, minus, lag: 0, square },
        t => t,
    };
    terms.iter().map(of).collect()
}
