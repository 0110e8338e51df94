//! Candidate columns, many at once: kept in single precision where they are not zero, multiplied in panels that stay near the core.

use crate::gram::{Products, Vector, beside, ends};
use crate::lanes::{dot, dot_of_singles, dots_with, widen};
use crate::threads::in_parts;
use std::ops::Range;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gram::products;

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
}
