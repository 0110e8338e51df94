//! A slow walk in addition to a response's noise (Ornstein–Uhlenbeck).
//! It lasts longer than the noise's correlation and does not repeat. The residual's spectrum decides, which
//! is flat for noise alone (Whittle 1953).

use crate::gaussian_process::{Kernel, directions, knots, shares};
use crate::measurement_model::EstimationProblem;
use crate::priors::{NAMED_SHARE, PRICE, WALK_KINDS};
use crate::rows_and_noise::{MeasuredRows, ResponseNoise, ResponseSegment};
use crate::search_limits::{WALK_FEWEST_ROWS, WALK_MEMORIES, WALK_RANK, WALK_SIZES};
use crate::set_up_terms::{SetUpTerm, SetUpTermKind};
use crate::wave_periodogram::transformed;
use realfft::RealFftPlanner;

/// A walk found in a response.
#[derive(Debug, Clone, PartialEq)]
pub struct Wander {
    /// Index of the response.
    pub response: usize,
    /// Its standard deviation, in the response's unit.
    pub size: f64,
    /// Its correlation length, rows.
    pub rows: f64,
    /// Log odds against noise alone.
    pub odds: f64,
}

/// The likeliest walk of each response, if it is likelier than none.
/// It is searched in a whitened residual.
#[must_use]
pub fn wanders(problem: &EstimationProblem<'_>, noise: &ResponseNoise, residual: &[f64]) -> Vec<Wander> {
    let rows = problem.rows;
    let mut planner = RealFftPlanner::new();
    let mut out = Vec::new();
    // If the noise is rounding, its steps look like a walk.
    for response in 0..rows.responses.len() {
        // Each with its noise's autocorrelation.
        let mut spectra: Vec<(f64, Vec<f64>)> = Vec::new();
        let own = |((s, floor), _): &((&ResponseSegment, &f64), &f64)| {
            s.response == response && **floor <= 0.0 && s.rows.len() >= WALK_FEWEST_ROWS
        };
        for ((s, _), phi) in rows.segments.iter().zip(&problem.floors).zip(&noise.phi).filter(own) {
            let part = &residual[s.rows.clone()];
            let mean = part.iter().sum::<f64>() / part.len() as f64;
            let mut x: Vec<f64> = part.iter().map(|v| (v - mean).clamp(-5.0, 5.0)).collect();
            let n = x.len() as f64;
            let sums = transformed(&*planner.plan_fft_forward(x.len()), &mut x);
            // Begins at the second frequency, because the set-up terms absorb the first.
            spectra.push((*phi, sums[2..part.len() / 2].iter().map(|c| c.norm_sqr() / n).collect()));
        }
        if spectra.is_empty() {
            continue;
        }
        let (all, count) = spectra.iter().flat_map(|(_, p)| p).fold((0.0, 0.0), |(s, n), p| (s + p, n + 1.0));
        let level = all / f64::max(count, 1.0);
        let (mut mass, mut best) = (Vec::new(), (f64::NEG_INFINITY, 0.0, 0.0));
        for variance in WALK_SIZES {
            for memory in WALK_MEMORIES {
                // Spectrum of the walk after whitening.
                let rho = (-1.0_f64 / memory).exp();
                let mut gain = 0.0;
                let shape = |phi: f64, w: f64| {
                    let walk = variance * (1.0 - rho * rho) / (1.0 - 2.0 * rho * w.cos() + rho * rho);
                    walk * (1.0 - 2.0 * phi * w.cos() + phi * phi)
                };
                // The flat part is the remaining level of the noise.
                let mean = spectra
                    .iter()
                    .flat_map(|(phi, p)| (0..p.len()).map(move |k| shape(*phi, frequency(k, p.len()))))
                    .sum::<f64>()
                    / count;
                for (phi, p) in &spectra {
                    for (k, power) in p.iter().enumerate() {
                        let s = level * (1.0 + shape(*phi, frequency(k, p.len()))) / (1.0 + mean);
                        gain += (level / s).ln() + power / level - power / s;
                    }
                }
                mass.push(gain);
                if gain > best.0 {
                    best = (gain, variance / (1.0 + mean), memory);
                }
            }
        }
        let top = best.0;
        let total = top + mass.iter().map(|g| (g - top).exp()).sum::<f64>().ln() - (mass.len() as f64).ln();
        let odds = total - PRICE + (1.0 - NAMED_SHARE).ln() - WALK_KINDS.ln();
        if odds > 0.0 {
            let size = (best.1 * level).sqrt() * noise.sigma[response];
            out.push(Wander { response, size, rows: best.2, odds });
        }
    }
    out
}

fn frequency(k: usize, half: usize) -> f64 {
    std::f64::consts::PI * (k + 2) as f64 / (half + 2) as f64
}

/// Columns of a walk; with them nothing else needs to explain it.
#[must_use]
pub fn terms(rows: &MeasuredRows<'_>, wander: &Wander) -> Vec<SetUpTerm> {
    let mut out = Vec::new();
    let all: usize = rows.count(wander.response);
    for s in rows.segments.iter().filter(|s| s.response == wander.response) {
        let n = s.rows.len();
        let rank = (WALK_RANK * n / all.max(1)).clamp(8, WALK_RANK);
        let order: Vec<f64> = (0..n).map(|i| i as f64).collect();
        let places = knots(&order, rank.min(n));
        for d in directions(&places, Kernel::Rough(wander.rows), &[], rank) {
            let mut column = vec![0.0; rows.n];
            for (i, x) in order.iter().enumerate() {
                column[s.rows.start + i] = shares(&places, *x).iter().map(|(k, w)| w * d[*k]).sum();
            }
            out.push(SetUpTerm { what: SetUpTermKind::Wander, record: s.record, column, sd: wander.size });
        }
    }
    out
}
