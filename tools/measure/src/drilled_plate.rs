//! A plate of holes drilled by the machine and measured elsewhere.
//!
//! There are two fits. The plate's owners (SDSS plug plates) fit offset, scale and rotation first, then a
//! quadrupole to the residual; only that fit is comparable with theirs. If the holes do not fill a square or
//! a disc, the first fit takes part of the quadrupole. [`AffineFit`] fits all linear terms at once and does not.

use crate::iso230::moments;
use crate::plot::VectorPlot;
use nalgebra::{DMatrix, DVector};
use rtec_files::{InputError, Result};
use rtec_model::record::{Axis, Record, Role};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Channel of a plate's record that holds each hole's nominal diameter, mm.
pub const NOMINAL_DIAMETER: &str = "nominal_d";

/// Linear thermal expansion of aluminium, 1/K.
/// It converts a scale into a temperature.
pub const ALUMINIUM_PER_K: f64 = 23.1e-6;

/// A plate's fit.
/// Measured = scale · R(rotation) · nominal + offset, then a quadrupole.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DrilledPlateFit {
    /// Number of holes that the fit used.
    pub holes: usize,
    /// Offset of the measured holes, mm.
    pub offset_mm: [f64; 2],
    /// Scale, measured over nominal.
    pub scale: f64,
    /// The scale's difference from 1, ppm.
    pub scale_ppm: f64,
    /// Rotation of the measured plate, degrees, counter-clockwise positive.
    pub rotation_deg: f64,
    /// The same, µrad.
    pub rotation_urad: f64,
    /// RMS of the residual's length after offset, scale and rotation, µm.
    pub rms_um: f64,
    /// The same per nominal diameter (mm), if the record has it; drills differ.
    pub rms_um_by_diameter: BTreeMap<String, f64>,
    /// Magnitude m of the residual's quadrupole, mm per mm, as its owners define it.
    /// A hole at r, θ about the origin of the positions is shifted by r·m·cos 2(θ − φ) along its radius only.
    pub quadrupole: f64,
    /// The same in ppm: elongation along φ and contraction across it.
    pub quadrupole_ppm: f64,
    /// Its angle φ, degrees: the direction in which the plate is longest.
    pub quadrupole_deg: f64,
    /// RMS of the residual's length after the quadrupole too, µm.
    pub rms_quadrupole_um: f64,
    /// The joint fit's mean scale as a temperature of an aluminium plate, K.
    /// The data cannot separate scale and temperature.
    #[serde(rename = "scale_as_aluminium_K")]
    pub scale_as_aluminium_k: f64,
    /// Standard errors of offset, scale and rotation.
    pub standard_error: PlateStandardErrors,
    /// All linear terms fitted at once.
    pub joint: AffineFit,
    /// What the data cannot separate.
    pub remark: String,
    /// Residual of every hole after offset, scale and rotation, µm (x, y), in the record's order.
    pub residual_um: Vec<[f64; 2]>,
}

/// Terms of a plate's joint fit, or their standard errors.
/// Error x = `scale_x·x + c·y`, error y = `scale_y·y + d·x`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AffineTerms<Angle> {
    /// Offset of the measured holes, mm.
    /// That of [`DrilledPlateFit`] belongs to the other fit.
    pub offset_mm: [f64; 2],
    /// Scale of x, ppm, as the effect `scale.x`.
    pub scale_x_ppm: f64,
    /// Scale of y, ppm.
    pub scale_y_ppm: f64,
    /// Squareness c + d, µrad, as `squareness.x.y`.
    /// Positive where the angle between the positive axes is below 90°.
    pub squareness_urad: f64,
    /// Rotation d of rows along x, µrad, from x towards y.
    /// As `rotation.x.y` in a model with that `squareness.x.y`.
    pub rotation_urad: f64,
    /// Quadrupole as a pure stretch, ppm: longer along its angle, shorter across.
    pub quadrupole_ppm: f64,
    /// The direction in which it is longest, degrees from x.
    /// It has no standard error if the quadrupole is below its own.
    pub quadrupole_deg: Angle,
}

/// Offset, a scale for each axis, squareness and rotation by one fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AffineFit {
    /// The terms.
    #[serde(flatten)]
    pub terms: AffineTerms<f64>,
    /// RMS of the residual's length, µm.
    pub rms_um: f64,
    /// Standard errors of the terms.
    pub standard_error: AffineTerms<Option<f64>>,
}

/// Standard errors of a plate's first fit, if the residual is random.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlateStandardErrors {
    /// Of the offset, mm.
    pub offset_mm: [f64; 2],
    /// Of the scale, ppm.
    pub scale_ppm: f64,
    /// Of the rotation, µrad.
    pub rotation_urad: f64,
    /// Of the quadrupole, ppm.
    pub quadrupole_ppm: f64,
    /// Of its angle, degrees; `None` if the quadrupole is below its standard error.
    pub quadrupole_deg: Option<f64>,
    /// Of the scale as a temperature of aluminium, K.
    pub scale_as_aluminium_k: f64,
}

/// Standard error of a quadrupole's angle, degrees: half that of its phase.
fn angle_error_deg(size: f64, error: f64) -> Option<f64> {
    (size > error).then(|| (error / size / 2.0).to_degrees())
}

impl PlateStandardErrors {
    /// From the covariances of the similarity and of the quadrupole of this `size`.
    fn of(
        fit: &DMatrix<f64>,
        quadrupole: &DMatrix<f64>,
        scale: f64,
        size: f64,
        joint: &AffineTerms<Option<f64>>,
    ) -> Self {
        let of_size = f64::midpoint(quadrupole[(0, 0)], quadrupole[(1, 1)]).sqrt();
        Self {
            quadrupole_deg: angle_error_deg(size, of_size),
            scale_as_aluminium_k: joint.scale_x_ppm.hypot(joint.scale_y_ppm) / 2e6 / ALUMINIUM_PER_K,
            offset_mm: [0, 1].map(|i| fit[(i, i)].sqrt()),
            scale_ppm: 1e6 * fit[(2, 2)].sqrt(),
            rotation_urad: 1e6 * fit[(3, 3)].sqrt() / scale,
            quadrupole_ppm: 1e6 * of_size,
        }
    }
}

impl AffineFit {
    /// From offsets, µm, and the slopes x on x, y on y, x on y and y on x, µm/mm.
    fn of(fit: &DVector<f64>, covariance: &DMatrix<f64>, rms_um: f64) -> Self {
        let error = |of: &[(usize, f64)]| {
            let terms =
                of.iter().flat_map(|(i, a)| of.iter().map(move |(j, b)| a * b * covariance[(*i, *j)]));
            terms.sum::<f64>().max(0.0).sqrt()
        };
        let [sx, sy, c, d] = [2, 3, 4, 5].map(|i| 1000.0 * fit[i]);
        let quadrupole = (sx - sy).hypot(c + d) / 2.0;
        let squareness_error = 1000.0 * error(&[(4, 1.0), (5, 1.0)]);
        // Its two parts, (sx − sy)/2 and (c + d)/2.
        let parts = [500.0 * error(&[(2, 1.0), (3, -1.0)]), squareness_error / 2.0];
        let quadrupole_error = (f64::midpoint(parts[0].powi(2), parts[1].powi(2))).sqrt();
        Self {
            terms: AffineTerms {
                offset_mm: [fit[0] / 1000.0, fit[1] / 1000.0],
                scale_x_ppm: sx,
                scale_y_ppm: sy,
                squareness_urad: c + d,
                rotation_urad: d,
                quadrupole_ppm: quadrupole,
                quadrupole_deg: ((c + d).atan2(sx - sy) / 2.0).to_degrees(),
            },
            rms_um,
            standard_error: AffineTerms {
                offset_mm: [0, 1].map(|i| error(&[(i, 1.0)]) / 1000.0),
                scale_x_ppm: 1000.0 * error(&[(2, 1.0)]),
                scale_y_ppm: 1000.0 * error(&[(3, 1.0)]),
                squareness_urad: squareness_error,
                rotation_urad: 1000.0 * error(&[(5, 1.0)]),
                quadrupole_ppm: quadrupole_error,
                quadrupole_deg: angle_error_deg(quadrupole, quadrupole_error),
            },
        }
    }
}

/// Loss function of a plate's fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlateFitLoss {
    /// Sum of squared residual lengths.
    Squares,
    /// Sum of their fourth powers, as in some published fits.
    /// The worst holes count more.
    Fourth,
}

/// Values of a fit, residuals, and covariance of the values.
type Solved = (DVector<f64>, DVector<f64>, DMatrix<f64>);

/// Fits two rows per hole; `of` gives the entries of a hole in a column.
fn solve(
    record: &Record,
    norm: PlateFitLoss,
    columns: usize,
    of: &dyn Fn(usize, usize) -> [f64; 2],
    to: &DVector<f64>,
) -> Result<Solved> {
    let n = to.len() / 2;
    let a: Vec<Vec<f64>> =
        (0..columns).map(|j| (0..2 * n).map(|row| of(row / 2, j)[row % 2]).collect()).collect();
    let squares = rtec_least_squares::solve(&a, to.as_slice())
        .map_err(|_| InputError::whole(&record.path, "holes that do not span a plane", "a plate of holes"))?;
    let mut fit = DVector::from_column_slice(&squares.values);
    let fitted = |fit: &DVector<f64>, i: usize| a.iter().zip(fit).map(|(a, f)| a[i] * f).sum::<f64>();
    let rest = |fit: &DVector<f64>| DVector::from_fn(2 * n, |i, _| to[i] - fitted(fit, i));
    let mut left = rest(&fit);
    if norm == PlateFitLoss::Fourth {
        // Newton's step for Σ r⁴ is a third of the way to the fit with weights r².
        for _ in 0..100 {
            let w: Vec<f64> = (0..2 * n).map(|i| left[i - i % 2].hypot(left[i - i % 2 + 1])).collect();
            let weighted = |v: &[f64]| v.iter().zip(&w).map(|(v, w)| v * w).collect::<Vec<f64>>();
            let columns: Vec<Vec<f64>> = a.iter().map(|c| weighted(c)).collect();
            // Holes without residual have no weight, and nothing can improve.
            let Ok(by_lengths) = rtec_least_squares::solve(&columns, &weighted(to.as_slice())) else { break };
            fit += (DVector::from_vec(by_lengths.values) - &fit) / 3.0;
            left = rest(&fit);
        }
    }
    // Covariance of the least-squares fit.
    let freedom = (2 * n).saturating_sub(columns).max(1) as f64;
    let covariance = squares.covariance() * (left.norm_squared() / freedom);
    Ok((fit, left, covariance))
}

/// Fits a plate over both axes together.
///
/// An RMS is the root of the mean squared length of the residuals.
///
/// # Errors
/// The record lacks position or error of x or y, has fewer than three holes, or holes on one line only.
pub fn evaluate(record: &Record, norm: PlateFitLoss) -> Result<DrilledPlateFit> {
    let get = |role: fn(Axis) -> Role, name: &str| {
        let expected = "columns position and error of x and y";
        let error = || InputError::whole(&record.path, format!("no {name} of a plate"), expected);
        Axis::new(name).and_then(|axis| record.data(&role(axis))).ok_or_else(error)
    };
    let (x, y) = (get(Role::Position, "x")?, get(Role::Position, "y")?);
    let (ex, ey) = (get(Role::Error, "x")?, get(Role::Error, "y")?);
    let n = x.len();
    if n < 3 {
        return Err(InputError::whole(&record.path, format!("{n} holes"), "at least three"));
    }
    if !spans_a_plane(x, y) {
        let found = "holes on one line: no scale across it, no squareness";
        return Err(InputError::whole(&record.path, found, "holes that span a plane"));
    }
    // measured = a·x − b·y + cx, b·x + a·y + cy: linear in (cx, cy, a, b)
    let solve = |columns: usize, of: &dyn Fn(usize, usize) -> [f64; 2], to: &DVector<f64>| {
        solve(record, norm, columns, of, to)
    };
    let reached = |p: &[f64], e: &[f64]| p.iter().zip(e).map(|(p, e)| p + e / 1000.0).collect::<Vec<f64>>();
    let (mx, my) = (reached(x, ex), reached(y, ey));
    let measured = DVector::from_fn(2 * n, |row, _| [&mx, &my][row % 2][row / 2]);
    let similarity = |i: usize, j: usize| [[1.0, 0.0], [0.0, 1.0], [x[i], y[i]], [-y[i], x[i]]][j];
    let (fit, left, covariance) = solve(4, &similarity, &measured)?;
    // residual = fitted position · m · cos 2(θ − φ), along the radius: linear in (m·cos 2φ, m·sin 2φ)
    let radial = |i: usize, j: usize| {
        let at = [mx[i] - left[2 * i], my[i] - left[2 * i + 1]];
        let theta = 2.0 * at[1].atan2(at[0]);
        let f = if j == 0 { theta.cos() } else { theta.sin() };
        at.map(|v| v * f)
    };
    let (quad, left_quad, of_quad) = solve(2, &radial, &left)?;
    let affine =
        |i: usize, j: usize| [[1.0, 0.0], [0.0, 1.0], [x[i], 0.0], [0.0, y[i]], [y[i], 0.0], [0.0, x[i]]][j];
    let errors = DVector::from_fn(2 * n, |row, _| [ex, ey][row % 2][row / 2]);
    // Errors in µm over positions in mm: 1 µm/mm is 1000 ppm or 1000 µrad.
    let (fit_all, left_all, of_all) = solve(6, &affine, &errors)?;
    let rms_of = |left: &DVector<f64>, rows: &[usize]| {
        let sum: f64 = rows.iter().map(|i| left[2 * i].powi(2) + left[2 * i + 1].powi(2)).sum();
        1000.0 * (sum / rows.len() as f64).sqrt()
    };
    let all: Vec<usize> = (0..n).collect();
    let mut kinds: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (i, d) in record.channel(NOMINAL_DIAMETER).unwrap_or_default().iter().enumerate() {
        kinds.entry(format!("{d}")).or_default().push(i);
    }
    let joint = AffineFit::of(&fit_all, &of_all, rms_of(&left_all, &all) / 1000.0);
    let (a, b) = (fit[2], fit[3]);
    let scale = a.hypot(b);
    let rotation = b.atan2(a);
    let (scale_x, scale_y, size) = (joint.terms.scale_x_ppm, joint.terms.scale_y_ppm, quad[0].hypot(quad[1]));
    let as_k = (scale_x + scale_y) / 2e6 / ALUMINIUM_PER_K;
    Ok(DrilledPlateFit {
        holes: n,
        offset_mm: [fit[0], fit[1]],
        scale,
        scale_ppm: (scale - 1.0) * 1e6,
        rotation_deg: rotation.to_degrees(),
        rotation_urad: rotation * 1e6,
        rms_um: rms_of(&left, &all),
        rms_um_by_diameter: kinds.iter().map(|(d, rows)| (d.clone(), rms_of(&left, rows))).collect(),
        quadrupole: size,
        quadrupole_ppm: size * 1e6,
        quadrupole_deg: (quad[1].atan2(quad[0]) / 2.0).to_degrees(),
        rms_quadrupole_um: rms_of(&left_quad, &all),
        scale_as_aluminium_k: as_k,
        standard_error: PlateStandardErrors::of(&covariance, &of_quad, scale, size, &joint.standard_error),
        joint,
        remark: format!(
            "a scale of {:+.1} ppm (mean of x and y) cannot be told from an aluminium plate measured {as_k:+.2} K from where it was drilled",
            f64::midpoint(scale_x, scale_y)
        ),
        residual_um: (0..n).map(|i| [1000.0 * left[2 * i], 1000.0 * left[2 * i + 1]]).collect(),
    })
}

/// Terms of the joint fit: offsets, scales, rotation and squareness.
const JOINT_TERMS: usize = 6;

impl DrilledPlateFit {
    /// Whether the joint scale differs from zero at 95 % (Student's t).
    /// Otherwise it does not imply a temperature.
    pub fn is_scale_beyond_chance(&self) -> bool {
        let freedom = (2 * self.holes).saturating_sub(JOINT_TERMS) as f64;
        let t = StudentsT::new(0.0, 1.0, freedom).map_or(f64::INFINITY, |law| law.inverse_cdf(0.975));
        self.scale_as_aluminium_k.abs() > t * self.standard_error.scale_as_aluminium_k
    }

    /// Residuals as arrows on the plate, enlarged.
    pub fn plot(&self, record: &Record) -> VectorPlot {
        let data = |name: &str| Axis::new(name).and_then(|a| record.position(&a)).unwrap_or_default();
        let places = data("x").iter().zip(data("y")).map(|(x, y)| [*x, *y]);
        VectorPlot {
            title: "Residuals after offset, scale and rotation".to_owned(),
            axes: ["x".to_owned(), "y".to_owned()],
            at: places.zip(self.residual_um.iter().copied()).collect(),
        }
    }
}

/// Holes on one line: least width of the holes, as a share of their length.
const ON_A_LINE: f64 = 1e-3;

fn spans_a_plane(x: &[f64], y: &[f64]) -> bool {
    let [xx, xy, yy] = moments(x, y);
    let (half, apart) = (f64::midpoint(xx, yy), ((xx - yy) / 2.0).hypot(xy));
    half - apart > ON_A_LINE.powi(2) * (half + apart)
}
