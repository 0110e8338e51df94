//! Least squares under autocorrelated noise, for many candidate columns at once.
//!
//! Noise is a first-order autoregression inside each segment (a response of a record), of any coefficient φ. With
//! whitening W the inner product ⟨x, v⟩ = (Wx)·(Wv) is, for every φ at once,
//!
//! (1 + φ²)·Σxᵢvᵢ − φ·Σ(xᵢvᵢ₋₁ + xᵢ₋₁vᵢ) − φ²·(first and last product of each segment),
//!
//! so three [`Products`] per pair of columns serve every noise model, and a fit costs nothing that grows with the rows.

use crate::lanes::{dot, dots, dots_of_two};
use std::ops::Range;

/// The three sums that give the whitened inner product of two columns at any φ.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Products {
    pub(crate) plain: f64,
    pub(crate) lagged: f64,
    pub(crate) ends: f64,
}

impl Products {
    /// The same with so much more, whatever φ is about.
    pub(crate) fn and(self, more: f64) -> Self {
        Self { plain: self.plain + more, ..self }
    }

    /// The whitened inner product at φ.
    pub(crate) fn at(self, phi: f64) -> f64 {
        (1.0 + phi * phi) * self.plain - phi * self.lagged - phi * phi * self.ends
    }
}

/// A column with what its products need: itself and the sum of its neighbours inside each segment.
#[derive(Debug, Clone)]
pub(crate) struct Vector {
    pub(crate) data: Vec<f64>,
    pub(crate) neighbours: Vec<f64>,
    /// Outside these rows it is zero.
    pub(crate) covers: Range<usize>,
    /// Of a map's height: what is known of its coefficient before the rows are looked at, as much as so many squares of it beside
    /// nothing say.
    pub(crate) known: Option<f64>,
}

impl Vector {
    pub(crate) fn new(data: Vec<f64>, segments: &[Range<usize>]) -> Self {
        let mut neighbours = vec![0.0; data.len()];
        beside(&data, segments, &mut neighbours);
        let zero = |s: &&Range<usize>| data[(*s).clone()].iter().all(|x| *x == 0.0);
        let from = segments.iter().find(|s| !zero(s)).map_or(0, |s| s.start);
        let to = segments.iter().rev().find(|s| !zero(s)).map_or(from, |s| s.end);
        Self { data, neighbours, covers: from..to, known: None }
    }

    /// Whether it is zero at all of these rows, as it is at those of another response than its own.
    pub(crate) fn is_zero(&self, rows: &Range<usize>) -> bool {
        self.covers.end <= rows.start || rows.end <= self.covers.start
    }

    /// With two columns in one run through the memory.
    pub(crate) fn products_with(&self, two: [&[f64]; 2], segments: &[Range<usize>]) -> [Products; 2] {
        let Some(rows) = rows_of(segments).filter(|rows| !self.is_zero(rows)) else {
            return [Products::default(); 2];
        };
        let [first, second] = two.map(|column| &column[rows.clone()]);
        let sums = dots_of_two(&self.data[rows.clone()], &self.neighbours[rows.clone()], first, second);
        [0, 1].map(|k| {
            let [plain, lagged] = sums[k];
            Products { plain, lagged, ends: ends(&self.data, two[k], segments) }
        })
    }

    pub(crate) fn products(&self, other: &[f64], segments: &[Range<usize>]) -> Products {
        let Some(rows) = rows_of(segments).filter(|rows| !self.is_zero(rows)) else {
            return Products::default();
        };
        let [plain, lagged] = dots(&self.data[rows.clone()], &self.neighbours[rows.clone()], &other[rows]);
        Products { plain, lagged, ends: ends(&self.data, other, segments) }
    }
}

/// The sum of each row's neighbours inside its segment.
pub(crate) fn beside(column: &[f64], segments: &[Range<usize>], out: &mut [f64]) {
    for s in segments {
        let (x, out) = (&column[s.clone()], &mut out[s.clone()]);
        if let [_, second, ..] = x {
            let last = x.len() - 1;
            (out[0], out[last]) = (*second, x[last - 1]);
            for ((out, before), after) in out[1..last].iter_mut().zip(x).zip(&x[2..]) {
                *out = before + after;
            }
        } else {
            out.fill(0.0);
        }
    }
}

/// From the first of these segments, which stand one after the other, to the last.
fn rows_of(segments: &[Range<usize>]) -> Option<Range<usize>> {
    Some(segments.first()?.start..segments.last()?.end)
}

/// The segments from the first to the last in which some of the columns are not zero all along: most columns are one
/// response's.
pub(crate) fn covered<'s>(columns: &[Vec<f64>], segments: &'s [Range<usize>]) -> &'s [Range<usize>] {
    let zero = |s: &Range<usize>| columns.iter().all(|c| c[s.clone()].iter().all(|x| *x == 0.0));
    let from = segments.iter().position(|s| !zero(s)).unwrap_or(0);
    let to = segments.iter().rposition(|s| !zero(s)).map_or(from, |to| to + 1);
    &segments[from..to]
}

/// First and last product of each segment.
pub(crate) fn ends(x: &[f64], v: &[f64], segments: &[Range<usize>]) -> f64 {
    segments.iter().map(|s| x[s.start] * v[s.start] + x[s.end - 1] * v[s.end - 1]).sum()
}

/// Products of two columns of which neither's neighbours are at hand.
pub(crate) fn products(x: &[f64], v: &[f64], segments: &[Range<usize>]) -> Products {
    let lagged = segments
        .iter()
        .map(|s| {
            let (x, v) = (&x[s.clone()], &v[s.clone()]);
            let last = x.len() - 1;
            dot(&x[1..], &v[..last]) + dot(&x[..last], &v[1..])
        })
        .sum();
    let rows = rows_of(segments).unwrap_or(0..0);
    Products { plain: dot(&x[rows.clone()], &v[rows]), lagged, ends: ends(x, v, segments) }
}
