//! Joint interval of a spike's height and length.
//!
//! Height and length are correlated, and the law is not linear in the length, so a symmetric interval is too
//! short on one side. The profile of the likelihood is used instead: all heights and lengths whose sum of
//! squares is within the level. The level includes autocorrelation and structure.

use super::CircleTrace;
use super::diagnosis::{DiagnosisFit, FitTerm};
use nalgebra::{DMatrix, DVector};
use rtec_least_squares::orthonormal;
use rtec_model::record::Axis;

/// Number of lengths tried between the shortest and longest that the level allows.
const LENGTHS: i32 = 24;
/// Halvings towards an end of the lengths: of the way, then of the last step.
const HALVINGS: i32 = 14;

/// Best height of a spike of one length, beside the other terms.
struct BestHeightAtLength {
    gain: f64,
    um: f64,
    /// Rise of the sum of squares per µm², from the best height.
    curvature: f64,
}

impl DiagnosisFit<'_> {
    /// Intervals of a spike's height (µm) and length (mm).
    /// `rises` are the allowed rises of the sum of squares.
    ///
    /// The law counts the travel from the last row of the old direction, but the axis turned after it. The
    /// height at the turn is smaller by the decay over that travel. The interval holds both heights.
    pub(super) fn spike_profile(&self, spike: &FitTerm, rises: [f64; 2]) -> Option<[[f64; 2]; 2]> {
        let (effect, _) = spike.parts.first()?;
        let others = self.terms.iter().filter(|t| t.name != spike.name).flat_map(|t| self.slopes(t));
        let others: Vec<DVector<f64>> = others.map(|c| self.white(&c)).collect();
        let q = orthonormal(DMatrix::from_columns(&others));
        let apart = |c: &DVector<f64>| self.apart(&q, c);
        let measured = apart(&(self.left() + self.value(spike)));
        let at = |length_mm: f64| {
            let shape = apart(self.basis(&effect.with(&[(1, length_mm)])?, None).first()?);
            let (curvature, with) = (shape.norm_squared(), shape.dot(&measured));
            let gain = with * with / curvature;
            (curvature > 0.0).then(|| BestHeightAtLength { gain, um: with / curvature, curvature })
        };
        let best_mm = effect.scalar(1);
        let best = at(best_mm)?.gain;
        let allowed = |mm: f64, rise: f64| at(mm).is_some_and(|f| best - f.gain <= rise);
        // The farthest allowed length towards a bound: growing steps, then bisection.
        let end = |bound: f64, rise: f64| {
            let whole = (bound / best_mm).ln();
            let far = |k: i32| whole * (0.5_f64.powi(HALVINGS - k));
            let outside = (0..=HALVINGS).find(|k| !allowed(best_mm * far(*k).exp(), rise));
            let Some(k) = outside else { return bound };
            let (mut inside, mut outside) = (if k > 0 { far(k - 1) } else { 0.0 }, far(k));
            for _ in 0..HALVINGS {
                let middle = 0.5 * (inside + outside);
                if allowed(best_mm * middle.exp(), rise) { inside = middle } else { outside = middle }
            }
            best_mm * inside.exp()
        };
        let [shortest, longest] = effect.description().parameters[1].bounds;
        let lengths = |rise: f64| [end(shortest, rise), end(longest, rise)];
        let [from, to] = lengths(rises[0]);
        let axis = effect.axes().first()?;
        let unseen_mm = mean_unseen_mm(self.traces, axis);
        let mut um = [f64::INFINITY, f64::NEG_INFINITY];
        for k in 0..=LENGTHS {
            let mm = from * (to / from).powf(f64::from(k) / f64::from(LENGTHS));
            let Some(fitted) = at(mm) else { continue };
            let half = ((rises[0] - best + fitted.gain).max(0.0) / fitted.curvature).sqrt();
            let at_turn = (-unseen_mm / mm).exp();
            for end in [fitted.um - half, fitted.um + half].into_iter().flat_map(|e| [e, e * at_turn]) {
                um = [um[0].min(end), um[1].max(end)];
            }
        }
        Some([um, lengths(rises[1])])
    }
}

/// Mean travel from the last row of the old direction to the turn, mm.
fn mean_unseen_mm(traces: &[CircleTrace], axis: &Axis) -> f64 {
    let of = |t: &CircleTrace| -> Vec<f64> {
        let Some(circle) = t.record.circle() else { return Vec::new() };
        let (sin, cos) = (f64::sin as fn(f64) -> f64, f64::cos as fn(f64) -> f64);
        let (share, slope) = if circle.plane[0] == *axis { (cos, sin) } else { (sin, cos) };
        let (share, slope) = (|row: usize| share(t.angle[row]), |row: usize| slope(t.angle[row]));
        // Rows at which the slope changes sign within a contour; rows at the turn itself have none.
        let turns = t.contours.iter().flat_map(|(rows, _)| {
            let moving: Vec<usize> = rows.clone().filter(|row| slope(*row).abs() > 1e-9).collect();
            let turned = moving.windows(2).filter(|w| slope(w[0]) * slope(w[1]) < 0.0).map(|w| w[0]);
            turned.collect::<Vec<_>>()
        });
        turns.map(|row| circle.radius_mm * (1.0 - share(row).abs())).collect()
    };
    let all: Vec<f64> = traces.iter().flat_map(of).collect();
    all.iter().sum::<f64>() / all.len().max(1) as f64
}
