//! Records for tests.

use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

pub(crate) fn axis() -> Axis {
    Axis::new("x").expect("a letter is an axis")
}

/// Rows 5 s apart at positions that never repeat, with an error by row number.
pub(crate) fn record(rows: usize, error: impl Fn(f64) -> f64) -> Record {
    let of = |f: &dyn Fn(f64) -> f64| (0..rows).map(|i| f(i as f64)).collect::<Vec<f64>>();
    let columns = vec![
        Column::new("t", Role::Time, of(&|i| 5.0 * i)),
        Column::new("p", Role::Position(axis()), of(&|i| (i * 61.803_398_875) % 100.0)),
        Column::new("e", Role::Error(axis()), of(&error)),
    ];
    Record::new(Path::new("run.run.toml"), RunKind::Positioning, columns).expect("a sound record")
}

/// A repeatable sequence of nearly normal numbers.
/// Each is the sum of twelve uniform ones.
pub(crate) fn noise(seed: u64, n: usize) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as f64 / u64::MAX as f64
    };
    (0..n).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
}
