//! A variable that a wave may run along: what the search of its period needs.

use crate::cause::{Cause, Shape};
use crate::extent::pitch;
use crate::problem::Stack;
use rtec_model::effect::Effect;
use std::ops::Range;

/// A variable that a periodic effect or shape runs along, for the search of its period.
#[derive(Debug, Clone)]
pub(crate) struct Wave {
    pub(crate) hypothesis: usize,
    pub(crate) effect: Option<Effect>,
    pub(crate) shape: Option<Shape>,
    /// The rows of its response.
    pub(crate) rows: Range<usize>,
    /// The variable at those rows.
    pub(crate) along: Vec<f64>,
    /// What the wave is multiplied with at those rows (its axis' share in a circle's radial error); empty for one.
    pub(crate) share: Vec<f64>,
    /// Further rows that show it: a circle's radial error beside the axis's own; each with the variable and the share.
    pub(crate) also: Vec<(Range<usize>, Vec<f64>, Vec<f64>)>,
    /// The segments from the first to the last of all rows that show it, whichever response's rows come first.
    pub(crate) segments: Vec<Range<usize>>,
    /// The variable in rising order, each value once.
    pub(crate) places: Vec<f64>,
    /// The variable's extent where it is longest.
    pub(crate) span: f64,
    /// Frequencies to search, in periods per unit of the variable.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Unit of the period parameter in units of the variable.
    pub(crate) unit: f64,
}

impl Wave {
    pub(crate) fn new(
        stack: &Stack<'_>,
        hypothesis: usize,
        response: usize,
        along: &[f64],
        from: f64,
        to: f64,
    ) -> Self {
        let rows = stack.rows(response);
        let along = along[rows.clone()].to_vec();
        let mut places = along.clone();
        places.sort_by(f64::total_cmp);
        places.dedup();
        Self {
            hypothesis,
            effect: None,
            shape: None,
            segments: within(&stack.ranges, &rows).to_vec(),
            rows,
            span: extent(&along),
            along,
            share: Vec::new(),
            also: Vec::new(),
            places,
            from,
            to,
            unit: 1.0,
        }
    }

    /// Further rows that show it, with the variable and the share of it there.
    pub(crate) fn push(&mut self, stack: &Stack<'_>, rows: Range<usize>, along: Vec<f64>, share: Vec<f64>) {
        self.span = self.span.max(extent(&along));
        self.also.push((rows, along, share));
        let first = self.parts().map(|(rows, ..)| rows.start).min().unwrap_or(0);
        let end = self.parts().map(|(rows, ..)| rows.end).max().unwrap_or(first);
        self.segments = within(&stack.ranges, &(first..end)).to_vec();
    }

    /// A column of its rows, each value by its share.
    pub(crate) fn shared(&self, column: &mut [f64]) {
        column.iter_mut().zip(&self.share).for_each(|(v, share)| *v *= share);
    }

    /// Periods per unit of the variable of one of its causes.
    pub(crate) fn frequency(&self, cause: &Cause) -> Option<f64> {
        match cause {
            Cause::Effect { effect, .. } => Some(1.0 / (effect.scalar(0) * self.unit)),
            Cause::Sum(_) | Cause::Shape(_) | Cause::Teeth(..) => None,
        }
    }

    /// How many frequencies the extent tells apart.
    pub(crate) fn independent(&self) -> f64 {
        let span = self.span;
        ((self.to - self.from.max(0.5 / span)) * span).max(2.0)
    }

    /// The pitch of the grid that all its places lie on; none where further rows show it between them.
    pub(crate) fn pitch(&self, close: f64) -> Option<f64> {
        if self.also.is_empty() { pitch(&self.places, close) } else { None }
    }

    /// Its own rows and the further ones, each with the variable and the share of it there.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&Range<usize>, &[f64], &[f64])> {
        let further = self.also.iter().map(|(rows, along, share)| (rows, &along[..], &share[..]));
        std::iter::once((&self.rows, &self.along[..], &self.share[..])).chain(further)
    }
}

fn extent(x: &[f64]) -> f64 {
    let (least, most) = x.iter().fold((f64::MAX, f64::MIN), |(l, m), x| (l.min(*x), m.max(*x)));
    (most - least).max(0.0)
}

/// The segments of some rows, which stand one after the other.
fn within<'s>(segments: &'s [Range<usize>], rows: &Range<usize>) -> &'s [Range<usize>] {
    let from = segments.partition_point(|s| s.end <= rows.start);
    let to = segments.partition_point(|s| s.start < rows.end);
    &segments[from..to]
}
