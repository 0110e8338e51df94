//! The ceiling: least squares with the true names.
//! Periods, times and sensors are given; only sizes are fitted.

use crate::case::rms;
use crate::judge::{centred, closed};
use crate::linear::dot;
use crate::rivals::column;
use crate::scene::Scene;

/// The best result of an answer that knows the names.
pub struct Oracle {
    /// Whether each hidden effect is at least five standard errors in size.
    pub stands: Vec<bool>,
    /// Sizes within their 95 % interval, and their number.
    pub covered: [usize; 2],
    /// Share of the hold-outs' gap that is closed.
    pub closed: Option<f64>,
}

/// Standard errors above which an effect counts as significant.
const STANDS: f64 = 5.0;

/// Fits the sizes of all true effects to the measured rows.
pub fn oracle(scene: &Scene, before: Option<f64>, floor: f64) -> Oracle {
    let train = scene.runs.len();
    let y: Vec<f64> = scene.measured[..train].iter().flatten().flatten().copied().collect();
    let sources: Vec<_> = scene.hidden.iter().chain(&scene.known).collect();
    let mut columns: Vec<Vec<f64>> = sources.iter().map(|s| column(s, &scene.runs)).collect();
    // A record with a zero of its own has a constant for each response.
    let mut at = 0;
    for r in &scene.runs {
        for _ in &r.responses {
            if r.zero.is_some() {
                let mut c = vec![0.0; y.len()];
                c[at..at + r.n].fill(1.0);
                columns.push(c);
            }
            at += r.n;
        }
    }
    let Some((sizes, inverse)) = least_squares(&columns, &y) else {
        return Oracle { stands: vec![false; scene.hidden.len()], covered: [0, 0], closed: None };
    };
    let left: Vec<f64> =
        (0..y.len()).map(|i| y[i] - columns.iter().zip(&sizes).map(|(c, b)| c[i] * b).sum::<f64>()).collect();
    // Correlated rows count for fewer.
    let phi = scene.noise.phi;
    let variance = dot(&left, &left) / (y.len() - columns.len()).max(1) as f64 * (1.0 + phi) / (1.0 - phi);
    let error: Vec<f64> = (0..sizes.len()).map(|k| (variance * inverse[k][k]).sqrt()).collect();
    let hidden = scene.hidden.len();
    let inside = (0..hidden).filter(|k| (sizes[*k] - 1.0).abs() <= 1.96 * error[*k]).count();
    let held: Vec<f64> = scene
        .held
        .iter()
        .enumerate()
        .flat_map(|(k, run)| {
            let measured = &scene.measured[train + k];
            run.responses
                .iter()
                .enumerate()
                .flat_map(|(j, resp)| {
                    let mut e = measured[j].clone();
                    for (s, b) in sources.iter().zip(&sizes) {
                        e.iter_mut().zip(s.on(run, resp)).for_each(|(e, c)| *e -= b * c);
                    }
                    centred(&e)
                })
                .collect::<Vec<_>>()
        })
        .collect();
    Oracle {
        stands: (0..hidden).map(|k| sizes[k].abs() > STANDS * error[k]).collect(),
        covered: [inside, hidden],
        closed: before.filter(|_| !held.is_empty()).and_then(|b| closed(b, rms(&held), floor)),
    }
}

/// Sizes, and the inverse of the normal equations' matrix.
/// `None` where columns coincide.
fn least_squares(columns: &[Vec<f64>], y: &[f64]) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
    let k = columns.len();
    if k == 0 {
        return None;
    }
    let scale: Vec<f64> = columns.iter().map(|c| dot(c, c).sqrt().max(1e-300)).collect();
    // Gauss–Jordan elimination on [A | I], with unit columns.
    let mut m: Vec<Vec<f64>> = (0..k)
        .map(|i| {
            let mut row: Vec<f64> =
                (0..k).map(|j| dot(&columns[i], &columns[j]) / scale[i] / scale[j]).collect();
            row.extend((0..k).map(|j| f64::from(u8::from(i == j))));
            row
        })
        .collect();
    for i in 0..k {
        let top = (i..k).max_by(|a, b| m[*a][i].abs().total_cmp(&m[*b][i].abs()))?;
        m.swap(i, top);
        let pivot = m[i][i];
        if pivot.abs() < 1e-10 {
            return None;
        }
        m[i].iter_mut().for_each(|v| *v /= pivot);
        let row = m[i].clone();
        for (_, other) in m.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let by = other[i];
            other.iter_mut().zip(&row).for_each(|(o, r)| *o -= by * r);
        }
    }
    let inverse: Vec<Vec<f64>> =
        (0..k).map(|i| (0..k).map(|j| m[i][k + j] / scale[i] / scale[j]).collect()).collect();
    let right: Vec<f64> = columns.iter().map(|c| dot(c, y)).collect();
    let sizes = inverse.iter().map(|row| dot(row, &right)).collect();
    Some((sizes, inverse))
}
