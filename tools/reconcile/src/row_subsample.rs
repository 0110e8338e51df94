//! Draws a subsample of very many rows: one row from each stretch.

use rtec_model::record::Record;
use std::borrow::Cow;

/// Largest number of rows that are analysed.
/// It determines an effect's value to a hundredth of the noise. The search needs time in proportion to rows
/// times candidates: minutes, and a gigabyte.
pub(crate) const MOST_ROWS: usize = 20_000;

/// The records themselves, or a subsample of [`MOST_ROWS`] at most.
pub(crate) fn bounded(train: &[Record]) -> Cow<'_, [Record]> {
    match at_least_every(train) {
        1 => Cow::Borrowed(train),
        every => train.iter().map(|r| r.select(&subsample(r.rows(), every))).collect(),
    }
}

/// The stride between analysed rows before anything is known about them.
/// It is the least power of two that leaves at most [`MOST_ROWS`].
pub(crate) fn at_least_every(records: &[Record]) -> usize {
    let rows: usize = records.iter().map(Record::rows).sum();
    rows.div_ceil(MOST_ROWS).next_power_of_two()
}

/// Draws one row from each stretch of `every` rows.
/// A fixed sequence chooses the place in the stretch: evenly spaced rows may all belong to one target or one direction.
fn subsample(rows: usize, every: usize) -> Vec<usize> {
    (0..rows)
        .step_by(every)
        .map(|from| {
            let dice = (from as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            from + (dice >> 33) as usize % every.min(rows - from)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::subsample;

    /// One row from each stretch in order, at varying places, for any length.
    #[test]
    fn rows_are_drawn_one_of_each_stretch() {
        for (rows, every) in [(1, 1), (7, 2), (8, 2), (1000, 8), (40_001, 4)] {
            let of = subsample(rows, every);
            assert_eq!(of.len(), rows.div_ceil(every));
            assert!(
                of.iter().enumerate().all(|(n, row)| row / every == n && *row < rows),
                "{rows} by {every}"
            );
        }
        let places = subsample(80_000, 8).into_iter().fold([0; 8], |mut of, row| {
            of[row % 8] += 1;
            of
        });
        assert!(places.iter().all(|n| (1000..1500).contains(n)), "{places:?}");
    }
}
