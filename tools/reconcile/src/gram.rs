//! Least squares under autocorrelated noise, for many candidate columns at once.
//!
//! Noise is a first-order autoregression inside each segment (a response of a record), of any coefficient φ. With
//! whitening W the inner product ⟨x, v⟩ = (Wx)·(Wv) is, for every φ at once,
//!
//! (1 + φ²)·Σxᵢvᵢ − φ·Σ(xᵢvᵢ₋₁ + xᵢ₋₁vᵢ) − φ²·(first and last product of each segment),
//!
//! so three [`Products`] per pair of columns serve every noise model, and a fit costs nothing that grows with the rows.

use crate::threads::in_parts;
use std::ops::Range;

/// The three sums that give the whitened inner product of two columns at any φ.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Products {
    plain: f64,
    lagged: f64,
    ends: f64,
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
    neighbours: Vec<f64>,
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
    fn is_zero(&self, rows: &Range<usize>) -> bool {
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
fn beside(column: &[f64], segments: &[Range<usize>], out: &mut [f64]) {
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

fn ends(x: &[f64], v: &[f64], segments: &[Range<usize>]) -> f64 {
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

/// Lanes of a dot product: enough for the additions not to wait for one another.
const LANES: usize = 8;

/// A function for any processor, and the same again for one with registers of 256 bits: the same digits, as no products
/// and sums are fused.
macro_rules! wide {
    ($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty $body:block) => {
        $(#[$doc])*
        $vis fn $name($($arg: $type),*) -> $out {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($arg: $type),*) -> $out $body
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has what the function is compiled for.
                    return unsafe { wide($($arg),*) };
                }
            }
            $body
        }
    };
}

/// Dot product in several lanes, in a fixed order of summation.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    if a.len() < LANES { a.iter().zip(b).map(|(x, y)| x * y).sum() } else { long_dot(a, b) }
}

wide! {
    fn long_dot(a: &[f64], b: &[f64]) -> f64 {
        let mut lanes = [0.0; LANES];
        let (ca, cb) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
        let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
        for (x, y) in ca.zip(cb) {
            for k in 0..LANES {
                lanes[k] += x[k] * y[k];
            }
        }
        fold(lanes) + tail
    }
}

wide! {
    /// `[a·c, b·c]` in one run through the memory.
    pub(crate) fn dots(a: &[f64], b: &[f64], c: &[f64]) -> [f64; 2] {
        let (mut first, mut second) = ([0.0; LANES], [0.0; LANES]);
        let (ca, cb, cc) = (a.chunks_exact(LANES), b.chunks_exact(LANES), c.chunks_exact(LANES));
        let mut tail = [0.0; 2];
        for ((x, y), z) in ca.remainder().iter().zip(cb.remainder()).zip(cc.remainder()) {
            tail[0] += x * z;
            tail[1] += y * z;
        }
        for ((x, y), z) in ca.zip(cb).zip(cc) {
            for k in 0..LANES {
                first[k] += x[k] * z[k];
                second[k] += y[k] * z[k];
            }
        }
        [fold(first) + tail[0], fold(second) + tail[1]]
    }
}

wide! {
    /// `[[a·c, b·c], [a·d, b·d]]` in one run through the memory, each to the last digit as [`dots`] has it.
    fn dots_of_two(a: &[f64], b: &[f64], c: &[f64], d: &[f64]) -> [[f64; 2]; 2] {
        let mut lanes = [[[0.0; LANES]; 2]; 2];
        let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
        let ((c, c_rest), (d, d_rest)) = (c.as_chunks::<LANES>(), d.as_chunks::<LANES>());
        for ((x, y), (z, w)) in a.iter().zip(b).zip(c.iter().zip(d)) {
            for k in 0..LANES {
                lanes[0][0][k] += x[k] * z[k];
                lanes[0][1][k] += y[k] * z[k];
                lanes[1][0][k] += x[k] * w[k];
                lanes[1][1][k] += y[k] * w[k];
            }
        }
        let tail = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let [[ac, bc], [ad, bd]] = lanes.map(|two| two.map(fold));
        [
            [ac + tail(a_rest, c_rest), bc + tail(b_rest, c_rest)],
            [ad + tail(a_rest, d_rest), bd + tail(b_rest, d_rest)],
        ]
    }
}

wide! {
    /// The same with c in single precision; all arithmetic is done in full.
    fn dots_with(a: &[f64], b: &[f64], c: &[f32]) -> [f64; 2] {
        let (mut first, mut second) = ([0.0; LANES], [0.0; LANES]);
        let (ca, cb, cc) = (a.chunks_exact(LANES), b.chunks_exact(LANES), c.chunks_exact(LANES));
        let mut tail = [0.0; 2];
        for ((x, y), z) in ca.remainder().iter().zip(cb.remainder()).zip(cc.remainder()) {
            tail[0] += x * f64::from(*z);
            tail[1] += y * f64::from(*z);
        }
        for ((x, y), z) in ca.zip(cb).zip(cc) {
            for k in 0..LANES {
                let z = f64::from(z[k]);
                first[k] += x[k] * z;
                second[k] += y[k] * z;
            }
        }
        [fold(first) + tail[0], fold(second) + tail[1]]
    }
}

wide! {
    /// Dot product of two columns in single precision; all arithmetic is done in full.
    fn dot_of_singles(a: &[f32], b: &[f32]) -> f64 {
        let mut lanes = [0.0; LANES];
        let (ca, cb) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
        let both = |x: f32, y: f32| f64::from(x) * f64::from(y);
        let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| both(*x, *y)).sum();
        for (x, y) in ca.zip(cb) {
            for k in 0..LANES {
                lanes[k] += both(x[k], y[k]);
            }
        }
        fold(lanes) + tail
    }
}

wide! {
    /// `b - by·a` in place of b.
    fn long_minus(b: &mut [f64], by: f64, a: &[f64]) -> () {
        for (b, a) in b.iter_mut().zip(a) {
            *b -= by * a;
        }
    }
}

/// `b - by·a` in place of b.
pub(crate) fn minus(b: &mut [f64], by: f64, a: &[f64]) {
    // What acts on different responses has nothing in common.
    if by == 0.0 {
        return;
    }
    if a.len() < LANES {
        b.iter_mut().zip(a).for_each(|(b, a)| *b -= by * a);
    } else {
        long_minus(b, by, a);
    }
}

wide! {
    /// Where in a turn so many turns are: the same digits as a remainder, in a fraction of its time.
    pub(crate) fn in_a_turn(turns: &mut [f64]) -> () {
        for x in turns {
            *x -= x.floor();
        }
    }
}

wide! {
    /// Single into double precision.
    fn widen(from: &[f32], to: &mut [f64]) -> () {
        for (o, x) in to.iter_mut().zip(from) {
            *o = f64::from(*x);
        }
    }
}

fn fold(lanes: [f64; LANES]) -> f64 {
    let mut half = LANES;
    let mut lanes = lanes;
    while half > 1 {
        half /= 2;
        for k in 0..half {
            lanes[k] += lanes[k + half];
        }
    }
    lanes[0]
}

wide! {
    /// [`wave`] of so many turns per unit at some places.
    pub(crate) fn waves(turns: f64, places: &[f64], sines: &mut [f64], cosines: &mut [f64]) -> () {
        for ((place, sine), cosine) in places.iter().zip(sines).zip(cosines) {
            (*sine, *cosine) = wave(turns * place);
        }
    }
}

/// Sine and cosine of so many turns, to the last digit or two, the same on every machine and quick over many values:
/// polynomials over an eighth of a turn either way.
#[inline]
pub(crate) fn wave(turns: f64) -> (f64, f64) {
    // Adding this puts the nearest whole number into the last bits.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let quarters = turns * 4.0;
    let shifted = quarters + ROUND;
    let quadrant = shifted.to_bits() & 3;
    let x = (quarters - (shifted - ROUND)) * std::f64::consts::FRAC_PI_2;
    let y = x * x;
    let sin = x
        * (1.0
            + y * (-1.0 / 6.0
                + y * (1.0 / 120.0
                    + y * (-1.0 / 5040.0
                        + y * (1.0 / 362_880.0
                            + y * (-1.0 / 39_916_800.0
                                + y * (1.0 / 6_227_020_800.0 - y / 1_307_674_368_000.0)))))));
    let cos = 1.0
        + y * (-0.5
            + y * (1.0 / 24.0
                + y * (-1.0 / 720.0
                    + y * (1.0 / 40_320.0
                        + y * (-1.0 / 3_628_800.0
                            + y * (1.0 / 479_001_600.0
                                + y * (-1.0 / 87_178_291_200.0 + y / 20_922_789_888_000.0)))))));
    let (s, c) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let sign = |value: f64, minus: u64| f64::from_bits(value.to_bits() ^ (minus << 63));
    (sign(s, quadrant >> 1), sign(c, (quadrant ^ (quadrant >> 1)) & 1))
}

/// Up to so many vectors a matrix product spends its time on putting the columns in order.
const FEW: usize = 3;
/// Columns, and rows of them, that are multiplied at once: they and as many rows of a few vectors stay near the core.
const PANEL: usize = 96;
const ROWS: usize = 256;
/// As many columns in single precision.
const PANEL_OF_SINGLES: usize = 256;

/// Candidate columns, one after the other. Each is kept only over the segments in which it is not zero all along, and to
/// seven digits: what is kept is the candidate, and all arithmetic with it is done in full.
#[derive(Debug, Clone, Default)]
pub(crate) struct Bank {
    segments: Vec<Range<usize>>,
    /// Their values, one column after the other; in several lists where several banks have become one.
    data: Vec<Vec<f32>>,
    places: Vec<Place>,
    /// Products of each column with itself.
    squares: Vec<Products>,
    /// Weight that was taken off each column: column = stored · scale.
    pub(crate) scale: Vec<f64>,
}

/// Where a column is kept, and the segments that it covers.
#[derive(Debug, Clone, PartialEq)]
struct Place {
    list: usize,
    at: usize,
    covers: Range<usize>,
}

impl Bank {
    /// A bank for columns over these segments, which stand one after the other.
    pub(crate) fn new(segments: &[Range<usize>]) -> Self {
        Self { segments: segments.to_vec(), data: vec![Vec::new()], ..Self::default() }
    }

    pub(crate) fn len(&self) -> usize {
        self.scale.len()
    }

    fn all_rows(&self) -> usize {
        self.segments.last().map_or(0, |s| s.end)
    }

    /// The rows of some segments.
    fn rows(&self, covers: &Range<usize>) -> Range<usize> {
        self.segments[covers.start].start..self.segments[covers.end - 1].end
    }

    /// How many values are kept.
    fn kept(&self) -> usize {
        self.data.iter().map(Vec::len).sum()
    }

    /// The stored column, over the rows that it covers.
    fn stored(&self, column: usize) -> &[f32] {
        let Place { list, at, covers } = &self.places[column];
        &self.data[*list][*at..at + self.rows(covers).len()]
    }

    /// The rows outside which a column is zero.
    pub(crate) fn covered(&self, column: usize) -> Range<usize> {
        self.rows(&self.places[column].covers)
    }

    /// The stored column over the rows of some segments that hold all of it.
    fn read(&self, column: usize, over: &Range<usize>, out: &mut [f64]) {
        let place = &self.places[column];
        let (rows, over) = (self.rows(&place.covers), self.rows(over));
        let (before, rest) = out.split_at_mut(rows.start - over.start);
        let (inside, after) = rest.split_at_mut(rows.len());
        before.fill(0.0);
        after.fill(0.0);
        widen(self.stored(column), inside);
    }

    /// The stored column over all rows.
    pub(crate) fn column(&self, at: usize) -> Vec<f64> {
        let mut out = vec![0.0; self.all_rows()];
        self.read(at, &(0..self.segments.len()), &mut out);
        out
    }

    /// Adds a column, scaled to a mean square of one; gives its number.
    pub(crate) fn push(&mut self, column: &[f64]) -> usize {
        let zero = |s: &Range<usize>| column[s.clone()].iter().all(|x| *x == 0.0);
        // A column that is zero everywhere is kept in the first segment.
        let from = self.segments.iter().position(|s| !zero(s)).unwrap_or(0);
        let to = self.segments.iter().rposition(|s| !zero(s)).unwrap_or(0) + 1;
        let list = self.data.len() - 1;
        let place = Place { list, at: self.data[list].len(), covers: from..to };
        let column = &column[self.rows(&place.covers)];
        let rms = (dot(column, column) / self.all_rows().max(1) as f64).sqrt();
        let scale = if rms > 0.0 { rms } else { 1.0 };
        let by = 1.0 / scale;
        self.data[list].extend(column.iter().map(|x| (x * by) as f32));
        self.places.push(place);
        self.scale.push(scale);
        let at = self.scale.len() - 1;
        self.squares.push(self.pair(at, at));
        at
    }

    /// The columns with each segment's rows so many times as large.
    pub(crate) fn weigh(&mut self, by: &[f64]) {
        let n = self.all_rows().max(1) as f64;
        for at in 0..self.len() {
            let Place { list, at: begin, covers } = self.places[at].clone();
            let own = &by[covers.clone()];
            let alike = own.iter().all(|b| (b / own[0] - 1.0).abs() < f64::EPSILON);
            if alike {
                // Of unit size as before.
                self.scale[at] *= own[0];
                continue;
            }
            let first = self.segments[covers.start].start;
            let mut column = vec![0.0; self.rows(&covers).len()];
            self.read(at, &covers, &mut column);
            for (s, by) in self.segments[covers].iter().zip(own) {
                column[s.start - first..s.end - first].iter_mut().for_each(|x| *x *= by);
            }
            let rms = (dot(&column, &column) / n).sqrt();
            let scale = if rms > 0.0 { rms } else { 1.0 };
            for (kept, x) in self.data[list][begin..].iter_mut().zip(&column) {
                *kept = (x / scale) as f32;
            }
            self.scale[at] *= scale;
            self.squares[at] = self.pair(at, at);
        }
    }

    /// Whether a column lies in segments of which these numbers are not all the same.
    pub(crate) fn differs(&self, column: usize, by: &[f64]) -> bool {
        let own = &by[self.places[column].covers.clone()];
        own.iter().any(|b| (b / own[0] - 1.0).abs() >= f64::EPSILON)
    }

    /// A column's product with itself.
    pub(crate) fn square(&self, column: usize) -> Products {
        self.squares[column]
    }

    /// Products among some columns, packed by rows of the lower triangle.
    pub(crate) fn own(&self, columns: &[usize]) -> Vec<Products> {
        let k = columns.len();
        if k <= FEW {
            let pairs = (0..k).flat_map(|i| (0..=i).map(move |j| (i, j)));
            let product = |(i, j): (usize, usize)| {
                if i == j { self.squares[columns[i]] } else { self.pair(columns[i], columns[j]) }
            };
            return pairs.map(product).collect();
        }
        let covers = columns.iter().map(|c| self.places[*c].covers.clone());
        let Some(over) = covers.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)) else {
            return Vec::new();
        };
        let rows = self.rows(&over);
        let segments: Vec<Range<usize>> =
            self.segments[over.clone()].iter().map(|s| s.start - rows.start..s.end - rows.start).collect();
        let mut data = vec![0.0; k * rows.len()];
        for (c, out) in columns.iter().zip(data.chunks_exact_mut(rows.len())) {
            self.read(*c, &over, out);
        }
        products_of_all(&data, rows.len(), &segments)
    }

    /// Products of two of the columns.
    fn pair(&self, i: usize, j: usize) -> Products {
        let (a, b) = (&self.places[i], &self.places[j]);
        let both = a.covers.start.max(b.covers.start)..a.covers.end.min(b.covers.end);
        let mut out = Products::default();
        for s in self.segments.get(both).unwrap_or_default() {
            let of = |column: usize, place: &Place| {
                let from = s.start - self.segments[place.covers.start].start;
                &self.stored(column)[from..from + s.len()]
            };
            let (x, v, last) = (of(i, a), of(j, b), s.len() - 1);
            out.plain += dot_of_singles(x, v);
            let later = dot_of_singles(&x[1..], &v[..last]);
            out.lagged += later + if i == j { later } else { dot_of_singles(&x[..last], &v[1..]) };
            out.ends += f64::from(x[0]) * f64::from(v[0]) + f64::from(x[last]) * f64::from(v[last]);
        }
        out
    }

    /// Products of every column with every vector: `out[v][column]`.
    pub(crate) fn products(&self, vectors: &[&Vector]) -> Vec<Vec<Products>> {
        if vectors.len() > FEW {
            return self.products_with_many(vectors);
        }
        let some = |columns: Range<usize>| {
            let mut out = vec![Vec::with_capacity(columns.len()); vectors.len()];
            // Every column is read once.
            for column in columns {
                vectors.iter().zip(&mut out).for_each(|(v, out)| out.push(self.product(column, v)));
            }
            out
        };
        one_after_the_other(in_parts(self.len(), self.kept() * vectors.len(), some))
    }

    fn products_with_many(&self, vectors: &[&Vector]) -> Vec<Vec<Products>> {
        let right: Vec<f64> =
            vectors.iter().flat_map(|v| [&v.data[..], &v.neighbours]).flatten().copied().collect();
        let all = self.all_rows();
        self.by_panels(vectors, PANEL, |stored, rows, sums| {
            let n = rows.len();
            let mut panel = Vec::new();
            for from in (0..n).step_by(ROWS) {
                let some = ROWS.min(n - from);
                panel.resize(stored.len() / n * some, 0.0);
                for (column, wide) in stored.chunks_exact(n).zip(panel.chunks_exact_mut(some)) {
                    widen(&column[from..from + some], wide);
                }
                multiply((&panel, some), (&right[rows.start + from..], all), some, sums);
            }
        })
    }

    /// Products of every column with vectors of noise, in single precision but for the sum over all rows: what is rounded off
    /// is no more than a millionth of what chance alone makes of them.
    pub(crate) fn products_with_noise(&self, vectors: &[Vector]) -> Vec<Vec<Products>> {
        let both = vectors.iter().flat_map(|v| [&v.data[..], &v.neighbours]);
        let right: Vec<f32> = both.flatten().map(|x| *x as f32).collect();
        let all = self.all_rows();
        self.by_panels(&vectors.iter().collect::<Vec<_>>(), PANEL_OF_SINGLES, |stored, rows, sums| {
            let n = rows.len();
            let mut some_rows = Vec::new();
            for from in (0..n).step_by(ROWS) {
                let some = ROWS.min(n - from);
                some_rows.clear();
                some_rows.resize(sums.len(), 0.0);
                multiply((&stored[from..], n), (&right[rows.start + from..], all), some, &mut some_rows);
                sums.iter_mut().zip(&some_rows).for_each(|(sum, some)| *sum += f64::from(*some));
            }
        })
    }

    /// Product of one column with a vector.
    pub(crate) fn product(&self, column: usize, v: &Vector) -> Products {
        let place = &self.places[column];
        let rows = self.rows(&place.covers);
        if v.is_zero(&rows) {
            return Products::default();
        }
        let column = self.stored(column);
        let [plain, lagged] = dots_with(&v.data[rows.clone()], &v.neighbours[rows], column);
        Products { plain, lagged, ends: ends_of(v, column, &self.segments[place.covers.clone()]) }
    }

    /// Products of the columns, of so many at once as lie alike, with all vectors. `multiply` adds up those of some columns as they
    /// are stored, over these rows, with each vector and with its neighbours.
    fn by_panels(
        &self,
        vectors: &[&Vector],
        most: usize,
        multiply: impl Fn(&[f32], &Range<usize>, &mut [f64]) + Sync,
    ) -> Vec<Vec<Products>> {
        let mut panels = Vec::new();
        let mut from = 0;
        while let Some(first) = self.places.get(from) {
            let beside = self.places[from..]
                .iter()
                .take(most)
                .take_while(|p| (p.list, &p.covers) == (first.list, &first.covers));
            panels.push(from..from + beside.count());
            from = panels[panels.len() - 1].end;
        }
        let some = |some: Range<usize>| {
            let mut out = vec![Vec::new(); vectors.len()];
            for panel in &panels[some] {
                self.by_panel(vectors, panel, &multiply, &mut out);
            }
            out
        };
        one_after_the_other(in_parts(panels.len(), self.kept() * vectors.len(), some))
    }

    /// The same of columns that lie alike, added to what is known of each vector.
    fn by_panel(
        &self,
        vectors: &[&Vector],
        panel: &Range<usize>,
        multiply: &impl Fn(&[f32], &Range<usize>, &mut [f64]),
        out: &mut [Vec<Products>],
    ) {
        let Place { list, at, covers } = &self.places[panel.start];
        let rows = self.rows(covers);
        if vectors.iter().all(|v| v.is_zero(&rows)) {
            for out in out {
                out.resize(out.len() + panel.len(), Products::default());
            }
            return;
        }
        // Columns stand in the order in which they came.
        let stored = &self.data[*list][*at..at + panel.len() * rows.len()];
        let mut sums = vec![0.0; 2 * vectors.len() * panel.len()];
        multiply(stored, &rows, &mut sums);
        let segments = &self.segments[covers.clone()];
        for ((v, out), sums) in vectors.iter().zip(out).zip(sums.chunks_exact(2 * panel.len())) {
            let (plain, lagged) = sums.split_at(panel.len());
            let columns = stored.chunks_exact(rows.len()).zip(plain.iter().zip(lagged));
            out.extend(columns.map(|(column, (plain, lagged))| Products {
                plain: *plain,
                lagged: *lagged,
                ends: ends_of(v, column, segments),
            }));
        }
    }

    /// Adds the columns of another bank over the same segments.
    pub(crate) fn append(&mut self, other: Self) {
        let lists = self.data.len();
        self.data.extend(other.data);
        self.places.extend(other.places.into_iter().map(|place| Place { list: lists + place.list, ..place }));
        self.squares.extend(other.squares);
        self.scale.extend(other.scale);
    }
}

/// What was worked out for the first columns, then for those behind them: one list for each vector.
fn one_after_the_other(parts: Vec<Vec<Vec<Products>>>) -> Vec<Vec<Products>> {
    let add = |mut all: Vec<Vec<Products>>, more: Vec<Vec<Products>>| {
        all.iter_mut().zip(more).for_each(|(all, more)| all.extend(more));
        all
    };
    parts.into_iter().reduce(add).unwrap_or_default()
}

/// Products of a vector with a column at the first and the last rows of the column's segments.
fn ends_of(v: &Vector, column: &[f32], segments: &[Range<usize>]) -> f64 {
    let Some(begin) = segments.first().map(|s| s.start) else { return 0.0 };
    let at = |row: usize| v.data[row] * f64::from(column[row - begin]);
    segments.iter().map(|s| at(s.start) + at(s.end - 1)).sum()
}

/// Products among columns of so many rows that stand one after the other, packed by rows of the lower triangle.
fn products_of_all(columns: &[f64], rows: usize, segments: &[Range<usize>]) -> Vec<Products> {
    let mut neighbours = vec![0.0; columns.len()];
    for (x, out) in columns.chunks_exact(rows).zip(neighbours.chunks_exact_mut(rows)) {
        beside(x, segments, out);
    }
    let k = columns.len() / rows;
    let (mut plain, mut lagged) = (vec![0.0; k * k], vec![0.0; k * k]);
    multiply((columns, rows), (columns, rows), rows, &mut plain);
    multiply((&neighbours, rows), (columns, rows), rows, &mut lagged);
    let column = |i: usize| &columns[i * rows..(i + 1) * rows];
    let pairs = (0..k).flat_map(|i| (0..=i).map(move |j| (i, j)));
    let product = |(i, j)| Products {
        plain: plain[i * k + j],
        lagged: lagged[i * k + j],
        ends: ends(column(i), column(j), segments),
    };
    pairs.map(product).collect()
}

/// What matrices are made of.
trait Number: Copy {
    const ONE: Self;
    const GEMM: Gemm<Self>;
}

/// `C = αAB + βC`: rows of A, columns of A, columns of B, then α, A, B, β, C, each matrix with its strides.
type Gemm<T> = unsafe fn(
    usize,
    usize,
    usize,
    T,
    *const T,
    isize,
    isize,
    *const T,
    isize,
    isize,
    T,
    *mut T,
    isize,
    isize,
);

impl Number for f64 {
    const ONE: Self = 1.0;
    const GEMM: Gemm<Self> = matrixmultiply::dgemm;
}

impl Number for f32 {
    const ONE: Self = 1.0;
    const GEMM: Gemm<Self> = matrixmultiply::sgemm;
}

/// Adds to `out` the products of every row of `left` with every row of `right`, all of `n` values, row by row of `right`. With the
/// rows of either: how far apart they begin.
fn multiply<T: Number>(left: (&[T], usize), right: (&[T], usize), n: usize, out: &mut [T]) {
    let rows = |(values, apart): (&[T], usize)| (values.len() + apart).saturating_sub(n) / apart;
    let (rows, columns) = (rows(left), rows(right));
    assert_eq!(out.len(), rows * columns, "one place for each product");
    let [from_left, from_right, across] = [left.1, right.1, rows].map(|apart| apart as isize);
    let (a, b, c) = (left.0.as_ptr(), right.0.as_ptr(), out.as_mut_ptr());
    // SAFETY: `left` holds `rows` and `right` `columns` rows of n values, so far apart, and `out` their products.
    unsafe {
        T::GEMM(rows, n, columns, T::ONE, a, from_left, 1, b, 1, from_right, T::ONE, c, 1, across);
    }
}

/// What of a column is no new explanation: so much of its square, of which others explain the rest. In the columns of the
/// bank, kept to seven digits, less would be what was rounded off, and it takes part in nothing. One measure for the search and
/// for what chance would find, as they are compared.
pub(crate) const KNOWN: f64 = 1e-6;

/// Where more is explained than there is: columns of which only all together make up one of them, so that none is nearly made up by the
/// ones before it, and what rounding leaves of the last one is anything. Then so much of its own square is added to each column's.
pub(crate) const RIDGE: f64 = 1e-8;

/// A lower Cholesky factor of a symmetric matrix, row by row.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cholesky {
    n: usize,
    l: Vec<f64>,
}

impl Cholesky {
    /// Factor of a matrix given row by row. A column that the ones before it explain to 1 part in 10⁹ is dropped: its
    /// coefficient will be zero.
    pub(crate) fn new(a: &[f64], n: usize) -> Self {
        Self::dropping(a, n, 1e-9)
    }

    /// The same where a column is dropped of which the ones before it leave less than this.
    pub(crate) fn dropping(a: &[f64], n: usize, least: f64) -> Self {
        Self::growing(&Self::default(), 0, a, n, least)
    }

    /// The same of a matrix whose first `same` rows and columns are those of one whose factor is at hand: these are taken from
    /// it, and are not looked at in `a`.
    pub(crate) fn growing(from: &Self, same: usize, a: &[f64], n: usize, least: f64) -> Self {
        let mut l = vec![0.0; n * n];
        for i in 0..same {
            l[i * n..=i * n + i].copy_from_slice(from.row(i));
        }
        for i in same..n {
            for j in 0..=i {
                let s = a[i * n + j] - dot(&l[i * n..i * n + j], &l[j * n..j * n + j]);
                if i == j {
                    l[i * n + i] = if s > least * a[i * n + i] { s.sqrt() } else { f64::INFINITY };
                } else {
                    l[i * n + j] = s / l[j * n + j];
                }
            }
        }
        Self { n, l }
    }

    /// L⁻¹b, in place.
    pub(crate) fn forward(&self, b: &mut [f64]) {
        self.forward_from(0, b);
    }

    /// The same where the first `same` values are L⁻¹b already.
    pub(crate) fn forward_from(&self, same: usize, b: &mut [f64]) {
        for i in same..self.n {
            let row = &self.l[i * self.n..];
            b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
        }
    }

    /// L⁻¹B, in place: B row by row, `width` values each.
    pub(crate) fn forward_many(&self, b: &mut [f64], width: usize) {
        for i in 0..self.n {
            let (before, at) = b.split_at_mut(i * width);
            let (row, at) = (self.row(i), &mut at[..width]);
            for (l, before) in row.iter().zip(before.chunks_exact(width)) {
                minus(at, *l, before);
            }
            for x in at {
                *x /= row[i];
            }
        }
    }

    /// A row of L, up to its diagonal.
    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.l[i * self.n..=i * self.n + i]
    }

    /// L⁻ᵀb, in place.
    pub(crate) fn backward(&self, b: &mut [f64]) {
        for i in (0..self.n).rev() {
            let mut s = b[i];
            for (k, x) in b.iter().enumerate().skip(i + 1) {
                s -= self.l[k * self.n + i] * x;
            }
            b[i] = s / self.l[i * self.n + i];
        }
    }
}

/// L⁻¹b in place of b, L the Cholesky factor that takes the place of a matrix's lower triangle: [`Cholesky`] for what is
/// needed once, with columns dropped of which less than [`KNOWN`] is new.
pub(crate) fn reduce(a: &mut [f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        for j in 0..=i {
            let s = a[i * n + j] - dot(&a[i * n..i * n + j], &a[j * n..j * n + j]);
            a[i * n + j] = if i != j {
                s / a[j * n + j]
            } else if s > KNOWN * a[i * n + i] {
                s.sqrt()
            } else {
                f64::INFINITY
            };
        }
        b[i] = (b[i] - dot(&a[i * n..i * n + i], &b[..i])) / a[i * n + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whiten(x: &[f64], phi: f64, segments: &[Range<usize>]) -> Vec<f64> {
        let mut w = x.to_vec();
        for s in segments {
            w[s.start] = x[s.start] * (1.0 - phi * phi).sqrt();
            for i in s.start + 1..s.end {
                w[i] = x[i] - phi * x[i - 1];
            }
        }
        w
    }

    /// Columns of one segment and of two, then with the second segment's rows half as large: products and columns are those of a
    /// bank that was made so; those among many columns are those of each pair.
    #[test]
    fn columns_weighed_anew_are_those_made_so() {
        let segments = [0..6, 6..13];
        let of = |by: [f64; 2]| {
            let mut bank = Bank::new(&segments);
            for k in 0..6usize {
                let value = |i: usize| {
                    if (k == 1 && i < 6) || (k == 2 && i >= 6) {
                        0.0
                    } else {
                        ((i * i + 3 * k * i) % 11) as f64 - 4.3
                    }
                };
                let column: Vec<f64> = (0..13).map(|i| by[usize::from(i >= 6)] * value(i)).collect();
                bank.push(&column);
            }
            bank
        };
        let (mut bank, made) = (of([1.0, 1.0]), of([3.0, 0.5]));
        bank.weigh(&[3.0, 0.5]);
        let all: Vec<usize> = (0..6).collect();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "{a} and {b}");
        for c in 0..6 {
            near(bank.scale[c], made.scale[c]);
            bank.column(c).iter().zip(made.column(c)).for_each(|(a, b)| near(*a, b));
            assert_eq!(bank.differs(c, &[3.0, 0.5]), c != 1 && c != 2);
        }
        for phi in [0.0, 0.4] {
            let (own, want) = (bank.own(&all), made.own(&all));
            own.iter().zip(&want).for_each(|(a, b)| near(a.at(phi), b.at(phi)));
            for i in 0..6 {
                for j in 0..=i {
                    let pair = made.own(&[i, j]);
                    let both = if i == j { pair[0] } else { pair[1] };
                    assert!((both.at(phi) - want[i * (i + 1) / 2 + j].at(phi)).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn products_are_the_whitened_inner_product() {
        let segments = [0..5, 5..9];
        let x: Vec<f64> = (0..9).map(|i| f64::from(i * i % 7) - 2.0).collect();
        let v: Vec<f64> = (0..9).map(|i| f64::from(i * 5 % 11) - 4.0).collect();
        let mut bank = Bank::new(&segments);
        bank.push(&v);
        // Zero in the first segment, and in the second.
        let late: Vec<f64> = (0..9).map(|i| if i < 5 { 0.0 } else { v[i] }).collect();
        let early: Vec<f64> = (0..9).map(|i| if i < 5 { v[i] } else { 0.0 }).collect();
        bank.push(&late);
        bank.push(&early);
        let vector = Vector::new(x.clone(), &segments);
        let few = bank.products(&[&vector]);
        let many = bank.products(&[&vector; 5]);
        let own = bank.own(&[0, 1, 2]);
        for phi in [-0.3, 0.0, 0.6, 0.97] {
            let slow = dot(&whiten(&x, phi, &segments), &whiten(&v, phi, &segments));
            assert!((vector.products(&v, &segments).at(phi) - slow).abs() < 1e-12);
            for (i, column) in [&v, &late, &early].into_iter().enumerate() {
                let slow = dot(&whiten(&x, phi, &segments), &whiten(column, phi, &segments));
                for fast in [few[0][i], many[0][i], many[4][i]] {
                    assert!((fast.at(phi) * bank.scale[i] - slow).abs() < 1e-5);
                }
                let slow = dot(&whiten(&v, phi, &segments), &whiten(column, phi, &segments));
                let pair = own[i * (i + 1) / 2].at(phi) * bank.scale[0] * bank.scale[i];
                assert!((pair - slow).abs() < 1e-4 * slow.abs());
                let kept: Vec<f64> = bank.column(i).iter().map(|x| x * bank.scale[i]).collect();
                assert!(kept.iter().zip(column).all(|(a, b)| (a - b).abs() < 1e-6));
            }
            assert!((products(&x, &v, &segments).at(phi) - slow).abs() < 1e-12);
        }
    }

    /// Columns enough for several threads, in one bank and in two that became one: the same digits as each by itself.
    #[test]
    fn products_are_the_same_however_many_work_on_them() {
        let rows = 4000;
        let segments = [0..1500, 1500..rows];
        let column = |k: usize| crate::testing::noise(k as u64 + 1, rows);
        let [mut one, mut two, mut further] = [0, 1, 2].map(|_| Bank::new(&segments));
        for k in 0..600 {
            let column = column(k);
            one.push(&column);
            if k < 250 {
                two.push(&column)
            } else {
                further.push(&column)
            };
        }
        two.append(further);
        let vectors: Vec<Vector> = (700..705).map(|k| Vector::new(column(k), &segments)).collect();
        let vectors: Vec<&Vector> = vectors.iter().collect();
        assert!(crate::threads::worth(one.kept()), "as many values as are worth a second thread");
        for few in [&vectors[..2], &vectors] {
            let all = one.products(few);
            assert_eq!(all, two.products(few));
            assert_eq!(all.iter().map(Vec::len).collect::<Vec<_>>(), vec![600; few.len()]);
            for (v, all) in few.iter().zip(&all) {
                for (k, product) in all.iter().enumerate() {
                    let slow = one.product(k, v);
                    let off =
                        [product.plain - slow.plain, product.lagged - slow.lagged, product.ends - slow.ends];
                    assert!(off.iter().all(|o| o.abs() < 1e-9), "{k}: {product:?}, not {slow:?}");
                }
            }
        }
        assert!((0..600).all(|k| one.column(k) == two.column(k)));
    }

    #[test]
    fn wave_is_sine_and_cosine() {
        for i in -4000..4000 {
            let turns = f64::from(i) * 0.000_731;
            let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
            let (s, c) = wave(turns);
            assert!((s - sin).abs() < 1e-14 && (c - cos).abs() < 1e-14, "{turns}: {s} {c}");
        }
    }

    /// Of two columns that differ by so little of their square, the second is dropped or not.
    #[test]
    fn how_much_of_a_column_is_new_decides_whether_it_counts() {
        for (least, new, counts) in [(1e-9, 1e-7, true), (KNOWN, 1e-7, false), (KNOWN, 1e-5, true)] {
            let a = [1.0, 1.0, 1.0, 1.0 + new];
            let mut b = [1.0, 2.0];
            Cholesky::dropping(&a, 2, least).forward(&mut b);
            assert_eq!(b[1] != 0.0, counts, "{least} {new}: {b:?}");
        }
    }

    #[test]
    fn cholesky_solves_and_drops_what_is_explained_already() {
        // Third column = first + second.
        let a = [4.0, 2.0, 6.0, 2.0, 3.0, 5.0, 6.0, 5.0, 11.0];
        let c = Cholesky::new(&a, 3);
        let mut b = [8.0, 8.0, 16.0];
        c.forward(&mut b);
        // The same, grown out of the factor of the first row and column.
        let grown = Cholesky::growing(
            &Cholesky::new(&a[..1], 1),
            1,
            &[[f64::NAN; 3], [2.0, 3.0, 5.0], [6.0, 5.0, 11.0]].concat(),
            3,
            1e-9,
        );
        assert!((0..3).all(|i| grown.row(i) == c.row(i)));
        let mut on = [b[0], 8.0, 16.0];
        grown.forward_from(1, &mut on);
        assert_eq!(on.map(f64::to_bits), b.map(f64::to_bits));
        let (mut m, mut once) = (a, [8.0, 8.0, 16.0]);
        reduce(&mut m, &mut once);
        assert_eq!(once.map(f64::to_bits), b.map(f64::to_bits));
        // The same, twice as much beside it.
        let mut many = [8.0, 16.0, 8.0, 16.0, 16.0, 32.0];
        c.forward_many(&mut many, 2);
        for (pair, b) in many.chunks(2).zip(b) {
            assert!((pair[0] - b).abs() < 1e-12 && (pair[1] - 2.0 * b).abs() < 1e-12);
        }
        c.backward(&mut b);
        assert!((b[0] - 1.0).abs() < 1e-12 && (b[1] - 2.0).abs() < 1e-12 && b[2] == 0.0);
    }
}
