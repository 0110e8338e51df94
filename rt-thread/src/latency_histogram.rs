//! Latency histograms in fixed memory.
//! One thread writes in a few nanoseconds. Any thread may read at any time.
//!
//! Log-linear buckets: every octave is cut into 64 equal buckets. So a bucket is never wider than 1/64 (1.6 %) of its
//! lowest value, and values below 128 ns are exact. The range ends at 2^40 ns (18 minutes). Values beyond it are
//! counted in the last bucket, and `max` is still exact.
//!
//! The two halves are types: [`Recorder`] (one per histogram, moved to the thread that measures) and [`Reader`]
//! (any number of them). Nothing is allocated after [`histogram`] returns the two, except by a reader's
//! [`Reader::snapshot`].

use serde::Serialize;
use serde::ser::{SerializeSeq, Serializer};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Buckets per octave, as a power of two.
const SUB_BITS: u32 = 6;
const SUB: usize = 1 << SUB_BITS;
/// Values of `2^TOP_BITS` ns and more share the last bucket.
const TOP_BITS: u32 = 40;
/// Number of buckets of every histogram.
pub const BUCKETS: usize = SUB * (TOP_BITS - SUB_BITS + 1) as usize;
/// The most by which a percentile may exceed the true one, as a fraction.
/// It is never below the true one. It holds for values below 2^40 ns.
pub const RELATIVE_ERROR: f64 = 1.0 / SUB as f64;

/// Fields that both halves share.
/// All accesses are relaxed, because a reader needs the numbers and not an order between them.
#[derive(Debug)]
#[repr(align(128))]
struct Shared {
    /// Smallest value, `u64::MAX` while empty.
    /// Written by: recorder. Read by: recorder, readers.
    min: AtomicU64,
    /// Largest value, 0 while empty. Written by: recorder. Read by: recorder, readers.
    max: AtomicU64,
    /// Sum of all values. Written by: recorder. Read by: recorder, readers.
    sum: AtomicU64,
    /// Count per bucket. Written by: recorder. Read by: recorder, readers.
    counts: [AtomicU64; BUCKETS],
}

/// A new, empty histogram: the half that writes and the half that reads.
#[allow(clippy::large_stack_arrays)] // 18 kB, once, before the thread starts; in place, a look finds its bucket without a pointer.
pub fn histogram() -> (Recorder, Reader) {
    let shared = Arc::new(Shared {
        min: AtomicU64::new(u64::MAX),
        max: AtomicU64::new(0),
        sum: AtomicU64::new(0),
        counts: [const { AtomicU64::new(0) }; BUCKETS],
    });
    (Recorder { shared: Arc::clone(&shared) }, Reader { shared })
}

/// The half that writes.
/// Exactly one exists per histogram, so plain loads and stores suffice.
#[derive(Debug)]
pub struct Recorder {
    shared: Arc<Shared>,
}

impl Recorder {
    /// Counts one value in ns.
    /// It never allocates, never locks and makes no system call. It takes a few ns.
    #[inline]
    pub fn record(&mut self, ns: u64) {
        let s = &*self.shared;
        let count = &s.counts[index(ns)];
        count.store(count.load(Relaxed) + 1, Relaxed);
        s.sum.store(s.sum.load(Relaxed).wrapping_add(ns), Relaxed);
        if ns < s.min.load(Relaxed) {
            s.min.store(ns, Relaxed);
        }
        if ns > s.max.load(Relaxed) {
            s.max.store(ns, Relaxed);
        }
    }
}

/// The half that reads, from any thread and without disturbing the writer.
#[derive(Debug, Clone)]
pub struct Reader {
    shared: Arc<Shared>,
}

impl Reader {
    /// A copy of the histogram at this moment.
    /// While the writer runs, the copy may miss values recorded meanwhile. It never holds a value that was not
    /// recorded.
    pub fn snapshot(&self) -> HistogramSnapshot {
        let s = &*self.shared;
        let counts: Box<[u64]> = s.counts.iter().map(|count| count.load(Relaxed)).collect();
        let samples = counts.iter().sum();
        HistogramSnapshot {
            samples,
            sum: s.sum.load(Relaxed),
            min: s.min.load(Relaxed),
            max: s.max.load(Relaxed),
            counts,
        }
    }
}

/// A histogram at rest: percentiles, buckets. All values in ns.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HistogramSnapshot {
    samples: u64,
    sum: u64,
    min: u64,
    max: u64,
    counts: Box<[u64]>,
}

impl Default for HistogramSnapshot {
    fn default() -> Self {
        Self { samples: 0, sum: 0, min: u64::MAX, max: 0, counts: vec![0; BUCKETS].into() }
    }
}

impl HistogramSnapshot {
    /// Number of values.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Smallest value in ns, exact; 0 when there is none.
    pub fn min(&self) -> u64 {
        if self.samples == 0 { 0 } else { self.min }
    }

    /// Largest value in ns, exact; 0 when there is none.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// Sum of all values in ns, exact (wraps after 584 years).
    pub fn sum(&self) -> u64 {
        self.sum
    }

    /// Mean in ns; 0 when there is none.
    pub fn mean(&self) -> f64 {
        if self.samples == 0 { 0.0 } else { self.sum as f64 / self.samples as f64 }
    }

    /// The value in ns that a fraction `q` of all values does not exceed.
    /// `q` is 0 to 1, and the rank is the nearest. The result is never below the true value, and never above it by more
    /// than [`RELATIVE_ERROR`]. It is 0 when there are no values.
    pub fn quantile(&self, q: f64) -> u64 {
        let rank = ((q * self.samples as f64).ceil() as u64).clamp(1, self.samples.max(1));
        let mut seen = 0;
        for bucket in self.buckets() {
            seen += bucket.count;
            if seen >= rank {
                return bucket.high.min(self.max).max(self.min());
            }
        }
        self.max
    }

    /// The median, see [`Self::quantile`].
    pub fn p50(&self) -> u64 {
        self.quantile(0.5)
    }

    /// The 99 % quantile, see [`Self::quantile`].
    pub fn p99(&self) -> u64 {
        self.quantile(0.99)
    }

    /// The 99.9 % quantile, see [`Self::quantile`].
    pub fn p999(&self) -> u64 {
        self.quantile(0.999)
    }

    /// The 99.99 % quantile, see [`Self::quantile`].
    pub fn p9999(&self) -> u64 {
        self.quantile(0.9999)
    }

    /// The values in `rows` linear buckets of `width_ns`, and the number beyond them.
    /// Plotting scripts need this form. The values of a bucket are spread evenly over the rows that it overlaps.
    pub fn linear(&self, width_ns: u64, rows: usize) -> (Vec<u64>, u64) {
        let mut linear = vec![0; rows];
        let mut placed = 0;
        for b in self.buckets() {
            let (low, high) = (b.low.max(self.min), b.high.min(self.max));
            let width = u128::from(high - low) + 1;
            let mut before = 0;
            for row in (low / width_ns..=high / width_ns).take_while(|row| *row < rows as u64) {
                let reach = u128::from((row + 1) * width_ns - low).min(width);
                let up_to = (u128::from(b.count) * reach / width) as u64;
                linear[row as usize] += up_to - before;
                before = up_to;
            }
            placed += before;
        }
        (linear, self.samples - placed)
    }

    /// The buckets that are not empty, in rising order.
    pub fn buckets(&self) -> impl Iterator<Item = Bucket> + '_ {
        self.counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(i, &count)| {
            let (low, high) = bounds(i);
            Bucket { low, high, count }
        })
    }
}

/// Serialises as a map of figures and the histogram as `[low_ns, high_ns, count]`.
/// The keys are `min`, `p50`, `p99`, `p999`, `p9999`, `max`, `mean`, `samples` and `histogram`.
impl Serialize for HistogramSnapshot {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Figures<'a> {
            min: u64,
            p50: u64,
            p99: u64,
            p999: u64,
            p9999: u64,
            max: u64,
            mean: f64,
            samples: u64,
            histogram: Buckets<'a>,
        }
        struct Buckets<'a>(&'a HistogramSnapshot);
        impl Serialize for Buckets<'_> {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                let mut seq = serializer.serialize_seq(None)?;
                for b in self.0.buckets() {
                    seq.serialize_element(&[b.low, b.high.min(self.0.max), b.count])?;
                }
                seq.end()
            }
        }
        Figures {
            min: self.min(),
            p50: self.p50(),
            p99: self.p99(),
            p999: self.p999(),
            p9999: self.p9999(),
            max: self.max(),
            mean: self.mean(),
            samples: self.samples,
            histogram: Buckets(self),
        }
        .serialize(serializer)
    }
}

/// One bucket: `count` values from `low` to `high` ns, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bucket {
    /// Lowest value that falls into it, in ns.
    pub low: u64,
    /// Highest value that falls into it, in ns; `u64::MAX` for the last.
    pub high: u64,
    /// Number of values in it.
    pub count: u64,
}

/// The bucket of a value: its octave and the six bits below its leading one.
#[inline]
fn index(ns: u64) -> usize {
    // Most gaps of a polled card are in this range.
    if ns < 2 * SUB as u64 {
        return ns as usize;
    }
    let ns = ns.min((1 << TOP_BITS) - 1);
    let octave = ns.ilog2() - SUB_BITS;
    ((octave as usize) << SUB_BITS) + (ns >> octave) as usize
}

/// The values of bucket `i`, both ends included.
fn bounds(i: usize) -> (u64, u64) {
    let octave = (i >> SUB_BITS).saturating_sub(1);
    let low = ((i - (octave << SUB_BITS)) as u64) << octave;
    let high = if i == BUCKETS - 1 { u64::MAX } else { low + (1 << octave) - 1 };
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn filled(values: &[u64]) -> HistogramSnapshot {
        let (mut recorder, reader) = histogram();
        for &v in values {
            recorder.record(v);
        }
        reader.snapshot()
    }

    #[test]
    fn buckets_tile_the_range_without_gap_or_overlap() {
        let mut next = 0;
        for i in 0..BUCKETS {
            let (low, high) = bounds(i);
            assert_eq!(low, next, "bucket {i}");
            assert_eq!(index(low), i);
            assert_eq!(index(high), i);
            assert!(i == BUCKETS - 1 || (high - low) as f64 <= low as f64 * RELATIVE_ERROR);
            next = high.wrapping_add(1);
        }
        assert_eq!(next, 0, "the last bucket ends at u64::MAX");
        assert_eq!(RELATIVE_ERROR.to_bits(), (1.0_f64 / 64.0).to_bits(), "no more than is promised");
    }

    #[test]
    fn figures_of_known_values() {
        // A thousand values: 980, 15, 4 and 1 of a kind.
        let times = |value, n| std::iter::repeat_n(value, n);
        let all: Vec<u64> = times(10, 980).chain(times(20, 15)).chain(times(30, 4)).chain([40]).collect();
        let s = filled(&all);
        assert_eq!([s.p50(), s.p99(), s.p999(), s.p9999(), s.max()], [10, 20, 30, 40, 40]);
        assert_eq!((s.samples(), s.sum(), s.min(), s.mean()), (1000, 10_260, 10, 10.26));
    }

    #[test]
    fn a_bucket_that_reaches_into_two_rows_is_shared_between_them() {
        assert_eq!(filled(&[0, 0, 5, 17, 130]).linear(10, 3), (vec![3, 1, 0], 1));
        // A bucket of 128 and 129 with a row's end between them, and a bucket cut off at the smallest and largest
        // value.
        assert_eq!(filled(&[127, 128, 129, 130]).linear(129, 2), (vec![2, 2], 0));
        assert_eq!(filled(&[129, 129]).linear(129, 2), (vec![0, 2], 0));
        // A bucket of 1024 to 1039 holds four values, so each row of 4 gets one.
        assert_eq!(filled(&[1000, 1024, 1028, 1032, 1039, 1050]).linear(4, 300).0[256..260], [1, 1, 1, 1]);
    }

    #[test]
    fn empty_reads_as_zero() {
        let s = filled(&[]);
        assert_eq!(
            (s.samples(), s.min(), s.max(), s.p50(), s.p9999(), s.buckets().count()),
            (0, 0, 0, 0, 0, 0)
        );
        assert_eq!(s, HistogramSnapshot::default());
    }

    #[test]
    fn beyond_the_range_the_maximum_is_still_exact() {
        let s = filled(&[5, u64::MAX]);
        assert_eq!((s.min(), s.p50(), s.max(), s.p9999()), (5, 5, u64::MAX, u64::MAX));
    }

    #[test]
    fn json_carries_the_contract_s_keys() {
        let json = serde_json::to_value(filled(&[100, 100, 5000])).unwrap();
        assert_eq!(json["min"], 100);
        assert_eq!(json["p50"], 100);
        assert_eq!(json["max"], 5000);
        assert_eq!(json["samples"], 3);
        assert_eq!(json["histogram"], serde_json::json!([[100, 100, 2], [4992, 5000, 1]]));
        for key in ["p99", "p9999"] {
            assert!(json[key].is_u64(), "{key}");
        }
    }

    /// Latencies of every size: uniform over the exponent, not over the value.
    fn latency() -> impl Strategy<Value = u64> {
        (0_u32..TOP_BITS, any::<u64>()).prop_map(|(bits, v)| v % (1 << bits).max(1))
    }

    proptest! {
        #[test]
        fn agrees_with_a_sorted_vector(
            mut values in prop::collection::vec(latency(), 1..500),
            q in prop::sample::select(vec![0.0, 0.01, 0.5, 0.9, 0.99, 0.999, 0.9999, 1.0]),
        ) {
            let s = filled(&values);
            values.sort_unstable();
            let n = values.len();
            prop_assert_eq!(s.samples(), n as u64);
            prop_assert_eq!(s.min(), values[0]);
            prop_assert_eq!(s.max(), values[n - 1]);
            prop_assert_eq!(s.sum(), values.iter().sum::<u64>());
            let truth = values[((q * n as f64).ceil() as usize).clamp(1, n) - 1];
            let got = s.quantile(q);
            prop_assert!(got >= truth, "{got} understates {truth}");
            prop_assert!((got - truth) as f64 <= truth as f64 * RELATIVE_ERROR, "{got} for {truth}");
        }

        #[test]
        fn linear_rows_keep_every_value_within_a_bucket_of_its_row(
            values in prop::collection::vec(0_u64..100_000, 1..300),
        ) {
            const ROWS: usize = 50;
            let (rows, beyond) = filled(&values).linear(1000, ROWS);
            prop_assert_eq!(rows.iter().sum::<u64>() + beyond, values.len() as u64);
            for (row, count) in rows.iter().enumerate() {
                // No value moves further than the width of its bucket.
                let reach = (row as u64 * 1000, row as u64 * 1000 + 999);
                let slack = (reach.1 as f64 * RELATIVE_ERROR) as u64 + 1;
                let near = |v: &&u64| (reach.0.saturating_sub(slack)..=reach.1 + slack).contains(*v);
                prop_assert!(*count <= values.iter().filter(near).count() as u64, "row {row}");
            }
        }
    }

    #[test]
    fn readers_see_only_what_was_recorded_while_the_writer_runs() {
        const N: u64 = 200_000;
        let (mut recorder, reader) = histogram();
        std::thread::scope(|scope| {
            let looking = reader.clone();
            let look = scope.spawn(move || {
                let mut last = 0;
                while last < N {
                    let s = looking.snapshot();
                    assert!(s.samples() >= last, "samples never fall");
                    last = s.samples();
                    for b in s.buckets() {
                        assert!(
                            [7, 300].iter().any(|v| (b.low..=b.high).contains(v)),
                            "{b:?} was never recorded"
                        );
                    }
                }
            });
            for i in 0..N {
                recorder.record(if i % 4 == 0 { 300 } else { 7 });
            }
            look.join().unwrap();
        });
        let s = reader.snapshot();
        assert_eq!((s.samples(), s.p50(), s.min(), s.max()), (N, 7, 7, 300));
        assert_eq!(s.sum(), N / 4 * 300 + N / 4 * 3 * 7);
    }
}
