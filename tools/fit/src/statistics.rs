//! Means and quantiles.

/// The value below which this share of the values is (nearest rank, rounded up).
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values[rank.clamp(1, values.len()) - 1]
}

/// Mean of the squares.
pub(crate) fn mean_square(rms: &[f64]) -> f64 {
    rms.iter().map(|v| v * v).sum::<f64>() / rms.len().max(1) as f64
}

/// Root of the mean square.
pub(crate) fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

/// Arithmetic mean.
pub(crate) fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len().max(1) as f64
}
