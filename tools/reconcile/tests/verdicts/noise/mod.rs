//! Repeatable noise for every run.

/// Nearly normal numbers, always the same for a seed.
pub(crate) fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as f64 / u64::MAX as f64
    };
    move || (0..12).map(|_| uniform()).sum::<f64>() - 6.0
}
