//! Fits circles and lines to probed points.
//! The fits are geometric least squares, the two-step fit of NISTIR 4854 and a robust one.

use rtec_least_squares::{compress_rows, dot, solve};
use rtec_model::record::mean;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// A point or a direction in the turning plane, in mm.
/// `z` is along the part's axis, `x` is the distance from it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Zx {
    /// Along the axis of the part.
    pub z: f64,
    /// Across it: a radius, not a diameter.
    pub x: f64,
}

impl Zx {
    /// A point from its two coordinates.
    pub const fn new(z: f64, x: f64) -> Self {
        Self { z, x }
    }

    /// The unit direction at an angle from the +Z axis.
    pub fn at_angle(angle_rad: f64) -> Self {
        Self::new(angle_rad.cos(), angle_rad.sin())
    }

    /// Distance from the origin.
    pub fn norm(self) -> f64 {
        self.z.hypot(self.x)
    }

    /// Scalar product with another vector.
    pub fn dot(self, other: Self) -> f64 {
        self.z * other.z + self.x * other.x
    }

    /// Direction of a line with this normal.
    pub(crate) const fn along(self) -> Self {
        Self::new(self.x, -self.z)
    }

    /// Angle from the +Z axis, in rad.
    pub fn angle_rad(self) -> f64 {
        self.x.atan2(self.z)
    }

    /// The same direction with length 1; `None` for a vector without direction.
    pub fn unit(self) -> Option<Self> {
        let length = self.norm();
        (length.is_finite() && length > 1e-12).then(|| self * (1.0 / length))
    }
}

impl std::ops::Add for Zx {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.z + other.z, self.x + other.x)
    }
}

impl std::ops::Sub for Zx {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.z - other.z, self.x - other.x)
    }
}

impl std::ops::Mul<f64> for Zx {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self::new(self.z * factor, self.x * factor)
    }
}

impl std::iter::Sum for Zx {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::new(0.0, 0.0), |sum, p| sum + p)
    }
}

/// The shape that is fitted to the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FitShape {
    /// A circle with free centre and radius.
    Circle,
    /// A straight line in any direction: cylinder, taper or face.
    Line,
}

impl FitShape {
    /// Number of free parameters.
    pub const fn parameters(self) -> usize {
        match self {
            Self::Circle => 3,
            Self::Line => 2,
        }
    }
}

/// A shape with its fitted parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FittedShape {
    /// Centre and radius, in mm.
    Circle {
        /// Centre, mm.
        centre: Zx,
        /// Radius of the circle.
        radius_mm: f64,
    },
    /// A point of the line (the points' centroid) and its unit normal.
    Line {
        /// The points' centroid, mm.
        through: Zx,
        /// Unit normal; deviations are positive on its side.
        normal: Zx,
    },
}

impl FittedShape {
    /// Deviation of a point, in mm.
    /// It is positive outside the circle or on the normal's side of the line.
    pub fn deviation_mm(&self, p: Zx) -> f64 {
        match *self {
            Self::Circle { centre, radius_mm } => (p - centre).norm() - radius_mm,
            Self::Line { through, normal } => (p - through).dot(normal),
        }
    }

    /// Outward unit normal of the shape at the foot of a point.
    pub fn normal_at(&self, p: Zx) -> Zx {
        match *self {
            Self::Circle { centre, .. } => (p - centre).unit().unwrap_or(Zx::new(1.0, 0.0)),
            Self::Line { normal, .. } => normal,
        }
    }

    /// Place of a point along the shape: angle (rad) or distance (mm).
    pub(crate) fn place(&self, p: Zx) -> f64 {
        match *self {
            Self::Circle { centre, .. } => (p - centre).angle_rad(),
            Self::Line { through, normal } => (p - through).dot(normal.along()),
        }
    }
}

/// The reason why points do not give a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FitError {
    /// Fewer points than one more than the number of free parameters.
    #[error("{found} points, {needed} are needed")]
    TooFew {
        /// Number of points given.
        found: usize,
        /// Fewest points that the shape needs.
        needed: usize,
    },
    /// The points do not determine the shape: on one line, or all in one place.
    #[error("the points do not determine the shape (on one line, or all in one place)")]
    Degenerate,
    /// The iteration did not converge.
    #[error("the fit did not settle in {iterations} iterations")]
    NoConvergence {
        /// Number of iterations done.
        iterations: usize,
    },
}

const MAX_ITERATIONS: usize = 200;

/// Geometric (orthogonal-distance) least squares, optionally weighted.
///
/// # Errors
/// [`FitError`]: too few points, points that do not determine the shape, no convergence.
pub fn least_squares(
    shape: FitShape,
    points: &[Zx],
    weights: Option<&[f64]>,
) -> Result<FittedShape, FitError> {
    let weighted: Vec<(Zx, f64)> =
        points.iter().enumerate().map(|(i, p)| (*p, weights.map_or(1.0, |w| w[i]))).collect();
    let counted = weighted.iter().filter(|(_, w)| *w > 0.0).count();
    if counted < shape.parameters() {
        return Err(FitError::TooFew { found: counted, needed: shape.parameters() });
    }
    let total: f64 = weighted.iter().map(|(_, w)| w).sum();
    let centroid = weighted.iter().map(|(p, w)| *p * *w).sum::<Zx>() * (1.0 / total);
    let moment = |f: fn(Zx) -> f64| weighted.iter().map(|(p, w)| w * f(*p - centroid)).sum::<f64>();
    let (zz, zx, xx) = (moment(|p| p.z * p.z), moment(|p| p.z * p.x), moment(|p| p.x * p.x));
    let spread = zz + xx;
    if !spread.is_finite() || spread <= 0.0 {
        return Err(FitError::Degenerate);
    }
    match shape {
        FitShape::Line => {
            if (zz - xx).hypot(2.0 * zx) < 1e-9 * spread {
                return Err(FitError::Degenerate); // a round cloud has no direction
            }
            let along = 0.5 * (2.0 * zx).atan2(zz - xx);
            let normal = Zx::new(-along.sin(), along.cos());
            // The normal points away from the part's axis; for a face towards +Z.
            let outward = if normal.x.abs() > 1e-9 { normal.x > 0.0 } else { normal.z > 0.0 };
            Ok(FittedShape::Line { through: centroid, normal: if outward { normal } else { normal * -1.0 } })
        }
        FitShape::Circle => {
            // The smaller of the two moments about the principal axes.
            if 0.5 * (spread - (zz - xx).hypot(2.0 * zx)) <= 1e-14 * spread {
                return Err(FitError::Degenerate);
            }
            // Start: the chord equations about the centroid, |p|² = 2 p·c + constant.
            let column =
                |f: fn(Zx) -> f64| weighted.iter().map(|(p, w)| w.sqrt() * f(*p - centroid)).collect();
            let columns: [Vec<f64>; 3] = [column(|_| 1.0), column(|p| 2.0 * p.z), column(|p| 2.0 * p.x)];
            let start = solve(&columns, &column(|p| p.dot(p))).map_err(|_| FitError::Degenerate)?;
            circle_from(&weighted, total, centroid, Zx::new(start.values[1], start.values[2]))
        }
    }
}

/// Levenberg-Marquardt on the centre.
/// The best radius for a centre is the mean distance.
fn circle_from(points: &[(Zx, f64)], total: f64, centroid: Zx, start: Zx) -> Result<FittedShape, FitError> {
    let radius_at = |c: Zx| points.iter().map(|(p, w)| w * (*p - centroid - c).norm()).sum::<f64>() / total;
    let cost_at = |c: Zx, r: f64| -> f64 {
        points.iter().map(|(p, w)| w * ((*p - centroid - c).norm() - r).powi(2)).sum()
    };
    let (mut c, mut r) = (start, radius_at(start));
    let mut cost = cost_at(c, r);
    let mut damping = 1e-6;
    for _ in 0..MAX_ITERATIONS {
        let unit = |p: Zx| (p - centroid - c).unit().unwrap_or(Zx::new(0.0, 0.0));
        // The change of each distance by the radius and the centre, and the rows that damp the latter.
        let column =
            |f: &dyn Fn(Zx) -> f64| points.iter().map(|(p, w)| w.sqrt() * f(*p)).collect::<Vec<f64>>();
        let mut columns = [column(&|_| 1.0), column(&|p| unit(p).z), column(&|p| unit(p).x)];
        let mut distances = column(&|p| (p - centroid - c).norm() - r);
        for (k, own) in columns.iter_mut().enumerate() {
            let size = dot(own, own);
            own.extend([0.0; 2]);
            if k > 0 {
                own[points.len() + k - 1] = (damping * size).sqrt();
            }
        }
        distances.extend([0.0; 2]);
        let step = solve(&columns, &distances).map_err(|_| FitError::Degenerate)?.values;
        let step = Zx::new(step[1], step[2]);
        let next = c + step;
        let next_r = radius_at(next);
        let next_cost = cost_at(next, next_r);
        let settled = step.norm() <= 1e-13 * next_r;
        if next_cost <= cost || settled {
            (c, r, cost) = (next, next_r, next_cost.min(cost));
            damping = (damping * 0.1).max(1e-15);
        } else {
            damping *= 10.0;
        }
        if settled {
            return Ok(FittedShape::Circle { centre: c + centroid, radius_mm: r });
        }
    }
    Err(FitError::NoConvergence { iterations: MAX_ITERATIONS })
}

/// Deviations of all points from a shape, in µm.
pub fn deviations_um(fitted: &FittedShape, points: &[Zx]) -> Vec<f64> {
    points.iter().map(|&p| fitted.deviation_mm(p) * 1e3).collect()
}

/// Sample standard deviation (divisor n − 1) of selected values.
/// `keep` selects by index. It is 0 for fewer than two values.
pub fn sd(values: &[f64], keep: impl Fn(usize) -> bool) -> f64 {
    let kept: Vec<f64> = values.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, v)| *v).collect();
    if kept.len() < 2 {
        return 0.0;
    }
    let mean = mean(&kept);
    (kept.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (kept.len() - 1) as f64).sqrt()
}

/// Standard errors of a fitted shape, from the scatter of points about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandardErrors {
    /// For a circle: of its centre along Z and X, µm.
    /// For a line: of its place along its normal, twice.
    pub centre_um: [f64; 2],
    /// For a circle: of its radius, µm. For a line: of its place along its normal.
    pub size_um: f64,
    /// For a line: of its inclination, rad.
    pub inclination_rad: Option<f64>,
}

/// Standard errors of a least-squares fit through `points`.
/// `sd_um` is the standard deviation of their deviations. `None` if the points do not determine the shape.
pub fn standard_errors(fitted: &FittedShape, points: &[Zx], sd_um: f64) -> Option<StandardErrors> {
    let n = points.len() as f64;
    match *fitted {
        FittedShape::Circle { centre, .. } => {
            let units: Vec<Zx> = points.iter().filter_map(|p| (*p - centre).unit()).collect();
            let [size, z, x] = solve(&circle_columns(&units), &vec![0.0; units.len()]).ok()?.spread()[..]
            else {
                return None;
            };
            Some(StandardErrors {
                centre_um: [z * sd_um, x * sd_um],
                size_um: size * sd_um,
                inclination_rad: None,
            })
        }
        FittedShape::Line { .. } => {
            let along: Vec<f64> = points.iter().map(|p| fitted.place(*p)).collect();
            let mean = mean(&along);
            let spread = along.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
            (spread > 0.0).then(|| StandardErrors {
                centre_um: [sd_um / n.sqrt(); 2],
                size_um: sd_um / n.sqrt(),
                inclination_rad: Some(sd_um * 1e-3 / spread.sqrt()),
            })
        }
    }
}

/// How the distances change with the radius and with the centre.
/// The points' directions are those seen from the centre.
fn circle_columns(units: &[Zx]) -> [Vec<f64>; 3] {
    let column = |f: fn(&Zx) -> f64| units.iter().map(f).collect();
    [column(|_| 1.0), column(|u| u.z), column(|u| u.x)]
}

/// How much a form error changes a circle's size, µm per µm of amplitude.
/// It is for the worst of two to four waves per turn. Around a whole circle it is 1 or less. On a short arc
/// it is far larger, because such waves look like another radius there. `None` if the points do not determine
/// a circle.
pub fn form_in_size(angles_rad: &[f64]) -> Option<f64> {
    let columns = circle_columns(&angles_rad.iter().map(|a| Zx::at_angle(*a)).collect::<Vec<_>>());
    let held = |waves: f64| {
        let size = |wave: fn(f64) -> f64| {
            let form: Vec<f64> = angles_rad.iter().map(|a| wave(waves * a)).collect();
            Some(solve(&columns, &form).ok()?.values[0])
        };
        Some(size(f64::cos)?.hypot(size(f64::sin)?))
    };
    [2.0, 3.0, 4.0].map(held).into_iter().try_fold(0.0, |most: f64, of| Some(most.max(of?)))
}

/// A fit through all points, and a second one without some of them.
#[derive(Debug, Clone)]
pub struct OutlierRejectionFit {
    /// Least squares through all points.
    pub plain: FittedShape,
    /// Least squares through the points that were kept.
    pub fitted: FittedShape,
    /// Indices of the points that were dropped, ascending.
    pub rejected: Vec<usize>,
    /// SD of all points about `plain`, in µm.
    pub sd_before_um: f64,
    /// SD of the kept points about `fitted`, in µm.
    pub sd_after_um: f64,
    /// Deviations of all points, dropped ones too, from `fitted`, in µm.
    pub errors_um: Vec<f64>,
}

impl OutlierRejectionFit {
    /// The second fit leaves out the points of these indices, ascending.
    ///
    /// # Errors
    /// As [`least_squares`].
    pub fn without(shape: FitShape, points: &[Zx], rejected: Vec<usize>) -> Result<Self, FitError> {
        let needed = shape.parameters() + 1;
        if points.len() < needed {
            return Err(FitError::TooFew { found: points.len(), needed });
        }
        let plain = least_squares(shape, points, None)?;
        let sd_before_um = sd(&deviations_um(&plain, points), |_| true);
        let kept = |i: usize| rejected.binary_search(&i).is_err();
        let weights: Vec<f64> = (0..points.len()).map(|i| f64::from(u8::from(kept(i)))).collect();
        let fitted = least_squares(shape, points, Some(&weights))?;
        let errors_um = deviations_um(&fitted, points);
        let sd_after_um = sd(&errors_um, kept);
        Ok(Self { plain, fitted, rejected, sd_before_um, sd_after_um, errors_um })
    }
}

/// The two-step fit of NISTIR 4854, section 3.
///
/// Fits all points, drops the largest deviations, fits again.
/// Both end points are kept. The deviations are those of all points.
///
/// It drops deviations on the side of the worst point that exceed 0.5 SD.
///
/// A form error has one sign: a worn tool leaves material, a chipped one removes it. The other side has the
/// good points, which the first circle is pulled away from.
///
/// Of white noise the rule drops about 30 % of the points, all on one side. The size is then off by about
/// half an SD, whatever the number of points. `part errors` uses [`beyond_noise`] instead.
///
/// # Errors
/// As [`least_squares`].
pub fn two_step(shape: FitShape, points: &[Zx]) -> Result<OutlierRejectionFit, FitError> {
    let needed = shape.parameters() + 1;
    if points.len() < needed {
        return Err(FitError::TooFew { found: points.len(), needed });
    }
    let plain = least_squares(shape, points, None)?;
    let first = deviations_um(&plain, points);
    let order = sequence(&plain, points);
    let ends = [order[0], order[points.len() - 1]];
    let worst = (0..points.len())
        .filter(|i| !ends.contains(i))
        .max_by(|&a, &b| first[a].abs().total_cmp(&first[b].abs()))
        .unwrap_or(0);
    // Deviations below a picometre are rounding.
    let threshold_um = (0.5 * sd(&first, |_| true)).max(1e-6);
    let is_far = |i: &usize| !ends.contains(i) && first[*i] * first[worst].signum() > threshold_um;
    let mut rejected: Vec<usize> = (0..points.len()).filter(is_far).collect();
    if points.len() - rejected.len() < needed {
        // Too few points would remain, so only the worst are dropped.
        rejected.sort_by(|&a, &b| first[b].abs().total_cmp(&first[a].abs()));
        rejected.truncate(points.len() - needed);
        rejected.sort_unstable();
    }
    OutlierRejectionFit::without(shape, points, rejected)
}

/// Probability per feature that a good point is left out.
const CHANCE: f64 = 0.01;

/// A linear fit that takes one row after another.
/// It holds as many rows as columns, which have the solution of all rows so far.
#[derive(Debug, Clone, Default)]
struct GrowingFit {
    columns: Vec<Vec<f64>>,
    response: Vec<f64>,
    residual_square_sum: f64,
}

impl GrowingFit {
    /// The fit with one more row.
    fn with(&self, row: &[f64], response: f64) -> Self {
        let mut columns = self.columns.clone();
        columns.resize(row.len(), Vec::new());
        columns.iter_mut().zip(row).for_each(|(c, v)| c.push(*v));
        let mut responses = self.response.clone();
        responses.push(response);
        let square = dot(&responses, &responses);
        let (columns, response) = compress_rows(&columns, &responses);
        let residual_square_sum = self.residual_square_sum + (square - dot(&response, &response)).max(0.0);
        Self { columns, response, residual_square_sum }
    }
}

/// Indices of the points that are farther from the shape than noise explains.
/// The half of the points nearest to the robust shape belongs to the surface. The others join it, the nearest
/// first. The deviation of the next one from the fit of those before it follows Student's law. From the first
/// significant one on, all are left out (Rosner, Technometrics 25, 1983). White noise loses a point in one to
/// three of a hundred features. `least_um` is the smallest standard deviation of a point. The indices ascend.
pub fn beyond_noise(robust: &FittedShape, points: &[Zx], least_um: f64) -> Vec<usize> {
    let (n, off_um) = (points.len(), deviations_um(robust, points));
    // Change of the surface at each point per small change of the shape.
    let slopes: Vec<Vec<f64>> = match *robust {
        FittedShape::Circle { .. } => {
            points.iter().map(|p| robust.normal_at(*p)).map(|n| vec![1.0, n.z, n.x]).collect()
        }
        FittedShape::Line { .. } => points.iter().map(|p| vec![1.0, robust.place(*p)]).collect(),
    };
    let parameters = slopes.first().map_or(0, Vec::len);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| off_um[*a].abs().total_cmp(&off_um[*b].abs()));
    let core = n.midpoint(parameters + 1).min(n);
    let joined = |fit: &GrowingFit, k: usize| fit.with(&slopes[k], off_um[k]);
    let mut fit = order[..core].iter().fold(GrowingFit::default(), |fit, k| joined(&fit, *k));
    for m in core..n {
        let next = joined(&fit, order[m]);
        if let Ok(law) = StudentsT::new(0.0, 1.0, m.saturating_sub(parameters) as f64) {
            let variance =
                (fit.residual_square_sum / (m - parameters) as f64).max(least_um.max(1e-6).powi(2));
            let off = ((next.residual_square_sum - fit.residual_square_sum) / variance).sqrt();
            if law.sf(off) < CHANCE / (2.0 * (m + 1) as f64) {
                let mut out = order.split_off(m);
                out.sort_unstable();
                return out;
            }
        }
        fit = next;
    }
    Vec::new()
}

/// Indices of the points in sequence along a shape.
/// On a circle the sequence starts after the widest gap.
pub fn sequence(fitted: &FittedShape, points: &[Zx]) -> Vec<usize> {
    let key: Vec<f64> = points.iter().map(|p| fitted.place(*p)).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| key[a].total_cmp(&key[b]));
    if let (FittedShape::Circle { .. }, Some(&last)) = (fitted, order.last()) {
        let gap = |k: usize| match k {
            0 => key[order[0]] + std::f64::consts::TAU - key[last],
            k => key[order[k]] - key[order[k - 1]],
        };
        let widest = (0..order.len()).max_by(|&a, &b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
        order.rotate_left(widest);
    }
    order
}

/// A robust fit (MM-estimate).
/// Points that do not belong to the shape have no weight.
#[derive(Debug, Clone)]
pub struct RobustFit {
    /// The shape on which most of the points agree.
    pub fitted: FittedShape,
    /// Robust scale of the deviations that belong to the shape, in µm.
    pub scale_um: f64,
    /// Weight of each point, 0 (does not belong) to 1.
    pub weights: Vec<f64>,
    /// Deviations of all points, in µm.
    pub errors_um: Vec<f64>,
}

/// Constant of Tukey's biweight, 95 % efficient for normal deviations.
/// Source: Huber & Ronchetti, Robust Statistics, 2nd ed.
const BIWEIGHT: f64 = 4.685;
/// Most points from which candidates are formed.
/// All triples of 24 points are 2024 circles.
const CANDIDATE_POINTS: usize = 24;

/// An MM-estimate of the shape.
/// Candidates are all shapes through as few points as determine one. The one with the smallest median
/// absolute deviation gives start and scale. Iterated reweighting with Tukey's biweight at that scale
/// follows.
/// Nothing is random: the same points give the same answer.
///
/// # Errors
/// As [`least_squares`].
pub fn robust(shape: FitShape, points: &[Zx]) -> Result<RobustFit, FitError> {
    let (n, p) = (points.len(), shape.parameters());
    if n < p + 1 {
        return Err(FitError::TooFew { found: n, needed: p + 1 });
    }
    let m = n.min(CANDIDATE_POINTS);
    let picked: Vec<usize> = (0..m).map(|k| k * (n - 1) / (m - 1)).collect();
    let mut best: Option<(f64, FittedShape)> = None;
    let mut consider = |chosen: &[Zx]| {
        // Points that do not determine a shape give no candidate.
        let Ok(candidate) = least_squares(shape, chosen, None) else { return };
        let mut size: Vec<f64> = deviations_um(&candidate, points).iter().map(|e| e.abs()).collect();
        // Rousseeuw & Leroy: the h-th smallest with h = (n + p + 1) / 2.
        let h = n.midpoint(p + 1).clamp(1, n) - 1;
        let median = *size.select_nth_unstable_by(h, f64::total_cmp).1;
        if best.as_ref().is_none_or(|(least, _)| median < *least) {
            best = Some((median, candidate));
        }
    };
    for (a, &i) in picked.iter().enumerate() {
        for (b, &j) in picked.iter().enumerate().skip(a + 1) {
            match shape {
                FitShape::Line => consider(&[points[i], points[j]]),
                FitShape::Circle => {
                    for &k in &picked[b + 1..] {
                        consider(&[points[i], points[j], points[k]]);
                    }
                }
            }
        }
    }
    let Some((median, mut fitted)) = best else { return Err(FitError::Degenerate) };
    // 1.4826 turns the median into the SD of normal deviations; the second factor corrects its bias in small
    // samples.
    let scale_um = (1.4826 * (1.0 + 5.0 / (n - p) as f64) * median).max(1e-6);
    let mut weights = vec![1.0; n];
    for _ in 0..MAX_ITERATIONS {
        let errors = deviations_um(&fitted, points);
        let weight = |e: &f64| {
            let u = e / (BIWEIGHT * scale_um);
            if u.abs() < 1.0 { (1.0 - u * u).powi(2) } else { 0.0 }
        };
        let next: Vec<f64> = errors.iter().map(weight).collect();
        let change = next.iter().zip(&weights).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        weights = next;
        fitted = least_squares(shape, points, Some(&weights))?;
        if change < 1e-9 {
            break;
        }
    }
    let errors_um = deviations_um(&fitted, points);
    Ok(RobustFit { fitted, scale_um, weights, errors_um })
}
