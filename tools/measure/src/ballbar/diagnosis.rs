//! What makes a circle's deviations: the model's own effects fitted to the radial errors of one plane.
//!
//! Linear effects first; then spikes and cyclic errors over a grid of lengths and periods; then all of it together by
//! Gauss and Newton, with noise of the autocorrelation that is left. Intervals hold 95 %.

use super::{ByAxis, Trace, law};
use crate::iso230::lacks;
use nalgebra::{DMatrix, DVector};
use rtec_files::InputError;
use rtec_model::effect::{Bound, Dictionary, Effect, laws};
use rtec_model::record::{Axis, Role};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// A reversal spike of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spike {
    /// Height right after the reversal, µm, with the sign of the new direction.
    pub um: f64,
    /// Travel over which it dies out to 1/e, mm.
    pub length_mm: f64,
}

/// A cyclic error of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Cyclic {
    /// Period along the axis, mm.
    pub period_mm: f64,
    /// Amplitude, µm.
    pub um: f64,
}

/// One cause's share in the circular deviation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Contribution {
    /// The cause.
    pub cause: String,
    /// Range of what it does to the radius, µm.
    pub um: f64,
}

/// What makes the deviations of a plane. `None` where the runs do not tell; effects that do not show beyond the noise are
/// left out of spikes and cyclic errors.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Diagnosis {
    /// Centre of the first record's circle: its set-up, µm.
    pub centre_um: [f64; 2],
    /// Mean radius of the first record minus the nominal one, µm.
    pub radius_um: f64,
    /// Scale of the first axis minus that of the second, ppm.
    pub scale_mismatch_ppm: Option<f64>,
    /// Squareness, µrad: positive when the angle between the positive axes is below 90°, as `squareness.A.B`.
    pub squareness_urad: Option<f64>,
    /// Reversal per axis, µm, as `reversal.A`: mean up minus mean down.
    pub reversal: ByAxis<f64>,
    /// Spike per axis.
    pub spike: ByAxis<Spike>,
    /// Following error of the first axis minus that of the second, ms, as `following_error.A`.
    pub servo_mismatch_ms: Option<f64>,
    /// Cyclic error per axis.
    pub cyclic: ByAxis<Cyclic>,
    /// 95 % intervals by name.
    pub interval_95: BTreeMap<String, [f64; 2]>,
    /// Causes by their share, largest first.
    pub contributions: Vec<Contribution>,
    /// RMS of what is left, µm.
    pub rms: f64,
}

/// A spike is taken into the fit from so many squared standard deviations on, so that it does not bend what stands beside
/// it, and told from more on: one in a thousand circles of noise over all lengths.
const SPIKE_FITTED: f64 = 6.0;
const SPIKE_TOLD: f64 = 18.0;
/// A cyclic error by chance: one in a thousand circles over all periods.
const CYCLIC_RISK: f64 = 1e-3;
/// Screw pitches and pitch circles, mm.
const PERIODS_MM: [f64; 2] = [0.5, 60.0];
/// Columns that leave less than this of themselves beside the others cannot be told from them.
const DISTINCT: f64 = 1e-4;
/// More autocorrelation than this is structure that no cause here explains.
const MOST_MEMORY: f64 = 0.95;

/// A term of the fit: effects with the weights of their sum, and which of the first one's values are free.
struct Term {
    name: String,
    parts: Vec<(Effect, f64)>,
    free: Vec<usize>,
    /// Only in this record: its centre and radius.
    only: Option<usize>,
}

struct Fit<'t> {
    traces: &'t [Trace],
    /// First stacked row of each trace.
    start: Vec<usize>,
    n: usize,
    y: DVector<f64>,
    terms: Vec<Term>,
    /// Rows that follow the one before them in the same contour.
    follows: Vec<bool>,
    /// Noise's coefficient from row to row.
    phi: f64,
}

/// Fits one plane.
pub(super) fn diagnose(traces: &[Trace], warnings: &mut Vec<String>) -> Result<Diagnosis, InputError> {
    let Some(circle) =
        traces[0].record.circle().filter(|_| traces.iter().all(|t| t.record.circle().is_some()))
    else {
        warnings.push(
            "no radius_mm and plane in the sidecar: no squareness, scale, reversal or servo mismatch"
                .to_owned(),
        );
        return Ok(plain(&traces[0]));
    };
    let [a, b] = &circle.plane;
    let mut fit = Fit::new(traces);
    let d = Dictionary::default();
    let one = |name: &str, axis: &Axis| Some((law(&d, name, &[axis])?, 1.0));
    let mismatch = |name: &str| Some(vec![(one(name, a)?.0, 0.5), (one(name, b)?.0, -0.5)]);
    let timed = traces.iter().all(|t| t.record.column(&Role::Time).is_some());
    fit.push("scale_mismatch_ppm", mismatch(laws::scale::NAME));
    for axis in [a, b] {
        fit.push(&format!("reversal.{axis}"), one(laws::reversal::NAME, axis).map(|e| vec![e]));
    }
    fit.push("squareness_urad", law(&d, laws::squareness::NAME, &[a, b]).map(|e| vec![(e, 1.0)]));
    if timed {
        fit.push("servo_mismatch_ms", mismatch(laws::following_error::NAME));
    } else {
        warnings.push("no time: no feed, and so no servo mismatch".to_owned());
    }
    if fit.n < 4 * (fit.terms.len() + 6) {
        return Err(lacks(&traces[0].record, &format!("{} rows", fit.n), "a circle of more rows than that"));
    }
    if !fit.drop_alike("servo_mismatch_ms", timed) {
        // Without the other sense an ellipse at 45° may be either.
        fit.terms.retain(|t| t.name != "squareness_urad" && t.name != "servo_mismatch_ms");
        warnings.push(
            "one sense of turning at one feed: squareness and servo mismatch look alike; measure both ways"
                .to_owned(),
        );
    }
    fit.memory();
    let mut told: Vec<String> = Vec::new();
    for axis in [a, b] {
        if let Some((effect, gain)) = fit.best_spike(&d, axis).filter(|(_, gain)| *gain > SPIKE_FITTED) {
            let name = format!("spike.{axis}");
            fit.push(&name, Some(vec![(effect, 1.0)]));
            told.extend((gain > SPIKE_TOLD).then_some(name));
        }
    }
    for axis in [a, b] {
        if let Some(effect) = fit.best_wave(&d, axis) {
            let name = format!("cyclic.{axis}");
            fit.push(&name, Some(vec![(effect, 1.0)]));
            told.push(name);
        }
    }
    fit.memory();
    fit.free_all();
    Ok(fit.answer([a, b], &told))
}

/// Where neither radius nor plane are known.
fn plain(trace: &Trace) -> Diagnosis {
    let contours = trace.evaluate();
    let n = contours.len().max(1) as f64;
    let mean = |of: &dyn Fn(&super::Contour) -> f64| contours.iter().map(of).sum::<f64>() / n;
    Diagnosis {
        centre_um: [mean(&|c| c.centre_um[0]), mean(&|c| c.centre_um[1])],
        radius_um: mean(&|c| c.radius_um),
        ..Diagnosis::default()
    }
}

impl<'t> Fit<'t> {
    fn new(traces: &'t [Trace]) -> Self {
        let mut start = Vec::new();
        let (mut n, mut y, mut follows) = (0, Vec::new(), Vec::new());
        for t in traces {
            start.push(n);
            n += t.radial.len();
            y.extend_from_slice(&t.radial);
            let inside = |i: usize| t.contours.iter().any(|(rows, _)| rows.contains(&i) && i > rows.start);
            follows.extend((0..t.radial.len()).map(inside));
        }
        let mut fit =
            Self { traces, start, n, y: DVector::from_vec(y), terms: Vec::new(), follows, phi: 0.0 };
        let d = Dictionary::default();
        for (record, t) in traces.iter().enumerate() {
            let Some(circle) = t.record.circle() else { continue };
            let r = Axis::new("r");
            let axes = [r.as_ref(), Some(&circle.plane[0]), Some(&circle.plane[1])];
            for (what, axis) in ["radius", "centre.0", "centre.1"].iter().zip(axes) {
                let effect = axis.and_then(|a| law(&d, laws::offset::NAME, &[a]));
                fit.push(&format!("{what}.{record}"), effect.map(|e| vec![(e, 1.0)]));
                if let Some(t) = fit.terms.last_mut() {
                    t.only = Some(record);
                }
            }
        }
        fit
    }

    fn push(&mut self, name: &str, parts: Option<Vec<(Effect, f64)>>) {
        let Some(parts) = parts else { return };
        let free = vec![0; usize::from(!parts.is_empty())];
        self.terms.push(Term { name: name.to_owned(), parts, free, only: None });
    }

    /// Stacks what `fill` says of each record, `width` columns.
    fn stack(
        &self,
        effect: &Effect,
        only: Option<usize>,
        width: usize,
        fill: impl Fn(&Bound<'_>, usize, &mut [f64]),
    ) -> Vec<DVector<f64>> {
        let mut out = vec![DVector::zeros(self.n); width];
        for (i, t) in self.traces.iter().enumerate().filter(|(i, _)| only.is_none_or(|o| o == *i)) {
            let radial = |r: &Role| r.to_string() == "error.r";
            let acts = effect.acts_on(&t.record).into_iter().find(|(r, _)| radial(r));
            let (Some((_, component)), Ok(bound)) = (acts, effect.bind(&t.record)) else { continue };
            let rows = t.radial.len();
            let mut buffer = vec![0.0; rows * width];
            fill(&bound, component, &mut buffer);
            for (column, part) in out.iter_mut().zip(buffer.chunks(rows)) {
                column.rows_mut(self.start[i], rows).copy_from_slice(part);
            }
        }
        out
    }

    fn basis(&self, effect: &Effect, only: Option<usize>) -> Vec<DVector<f64>> {
        self.stack(effect, only, effect.coefficient_count(), |b, c, out| b.basis(effect, c, out))
    }

    /// Derivatives of a term by its free values; those of a linear term are its columns.
    fn slopes(&self, term: &Term) -> Vec<DVector<f64>> {
        let mut sum: Vec<DVector<f64>> = Vec::new();
        for (effect, weight) in &term.parts {
            let width = effect.values().len();
            let all = self.stack(effect, term.only, width, |b, c, out| b.slopes(effect, c, out));
            let free: Vec<DVector<f64>> = term.free.iter().map(|i| &all[*i] * *weight).collect();
            if sum.is_empty() {
                sum = free;
            } else {
                sum.iter_mut().zip(free).for_each(|(s, f)| *s += f);
            }
        }
        sum
    }

    fn value(&self, term: &Term) -> DVector<f64> {
        let mut out = DVector::zeros(self.n);
        for (effect, weight) in &term.parts {
            let columns = self.basis(effect, term.only);
            for (c, column) in effect.coefficients().iter().zip(&columns) {
                out.axpy(c * weight, column, 1.0);
            }
        }
        out
    }

    /// The noise taken white: each row less what the one before foretells.
    fn white(&self, column: &DVector<f64>) -> DVector<f64> {
        let share = (1.0 - self.phi * self.phi).sqrt();
        DVector::from_fn(self.n, |i, _| {
            if self.follows[i] { column[i] - self.phi * column[i - 1] } else { share * column[i] }
        })
    }

    fn jacobian(&self) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> =
            self.terms.iter().flat_map(|t| self.slopes(t)).map(|c| self.white(&c)).collect();
        DMatrix::from_columns(&columns)
    }

    /// Whether a term can be told from the others, where it is there at all.
    fn drop_alike(&self, name: &str, there: bool) -> bool {
        let Some(i) = self.terms.iter().position(|t| t.name == name).filter(|_| there) else {
            // Without a feed the other sense alone tells squareness from a lag.
            let senses: Vec<f64> = self.traces.iter().flat_map(|t| &t.contours).map(|c| c.1).collect();
            return senses.iter().any(|s| *s > 0.0) && senses.iter().any(|s| *s < 0.0);
        };
        let j = self.jacobian();
        let own = j.column(i).into_owned();
        let others = j.remove_column(i);
        let left = residual(&others, &own);
        left.norm_squared() > DISTINCT * own.norm_squared()
    }

    /// What is left of the measured errors beside all terms.
    fn left(&self) -> DVector<f64> {
        let mut left = self.y.clone();
        for t in &self.terms {
            left -= self.value(t);
        }
        left
    }

    /// Linear values by least squares, then the noise's coefficient; twice, as each asks for the other.
    fn memory(&mut self) {
        for _ in 0..2 {
            self.step();
            let left = self.left();
            let (mut own, mut next) = (0.0, 0.0);
            for i in (1..self.n).filter(|i| self.follows[*i]) {
                own += left[i - 1] * left[i - 1];
                next += left[i] * left[i - 1];
            }
            self.phi = if own > 0.0 { (next / own).clamp(0.0, MOST_MEMORY) } else { 0.0 };
        }
        self.step();
    }

    /// One step of Gauss and Newton; the sum of squares after it.
    fn step(&mut self) -> f64 {
        let before = self.white(&self.left()).norm_squared();
        let j = self.jacobian();
        let by = solve(&j, &self.white(&self.left()));
        // Half the way, and half again, where the whole is too far.
        for k in 0..8 {
            let kept: Vec<Vec<(Effect, f64)>> = self.terms.iter().map(|t| t.parts.clone()).collect();
            let share = 0.5_f64.powi(k);
            if self.moved(&by, share) && self.white(&self.left()).norm_squared() <= before * (1.0 + 1e-12) {
                break;
            }
            self.terms.iter_mut().zip(kept).for_each(|(t, parts)| t.parts = parts);
        }
        self.white(&self.left()).norm_squared()
    }

    /// Moves the free values; whether all stayed within their bounds.
    fn moved(&mut self, by: &DVector<f64>, share: f64) -> bool {
        let mut at = 0;
        let mut inside = true;
        for t in &mut self.terms {
            for i in &t.free {
                for (effect, _) in &mut t.parts {
                    match effect.with(&[(*i, effect.values()[*i] + share * by[at])]) {
                        Some(e) => *effect = e,
                        None => inside = false,
                    }
                }
                at += 1;
            }
        }
        inside
    }

    /// Squared standard deviations that columns explain of what is left.
    fn gain(
        &self,
        q: &DMatrix<f64>,
        left: &DVector<f64>,
        variance: f64,
        columns: &[DVector<f64>],
    ) -> (f64, DVector<f64>) {
        let own: Vec<DVector<f64>> = columns
            .iter()
            .map(|c| {
                let c = self.white(c);
                &c - q * q.tr_mul(&c)
            })
            .collect();
        let m = DMatrix::from_columns(&own);
        let normal = m.tr_mul(&m);
        let with = m.tr_mul(left);
        let Some(beta) = normal.cholesky().map(|c| c.solve(&with)) else {
            return (0.0, DVector::zeros(columns.len()));
        };
        (beta.dot(&with) / variance, beta)
    }

    fn prepared(&self) -> (DMatrix<f64>, DVector<f64>, f64) {
        let j = self.jacobian();
        let left = self.white(&self.left());
        let variance = left.norm_squared() / (self.n - j.ncols()).max(1) as f64;
        (j.qr().q(), left, variance.max(1e-18))
    }

    /// The spike that explains most of what is left, over lengths from a twentieth of a millimetre to a third of the radius.
    fn best_spike(&self, d: &Dictionary, axis: &Axis) -> Option<(Effect, f64)> {
        let radius_mm = self.traces[0].record.circle()?.radius_mm;
        let spike = law(d, laws::reversal_spike::NAME, &[axis])?;
        let (q, left, variance) = self.prepared();
        let lengths = (0..).map(|k| 0.05 * 1.5_f64.powi(k)).take_while(|l| *l < radius_mm / 3.0);
        let of = |length: f64| {
            let effect = spike.with(&[(1, length)])?;
            let (gain, beta) = self.gain(&q, &left, variance, &self.basis(&effect, None));
            Some((effect.with(&[(0, beta[0])])?, gain))
        };
        lengths.filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The cyclic error that explains most of what is left, if more than chance does over all periods.
    fn best_wave(&self, d: &Dictionary, axis: &Axis) -> Option<Effect> {
        let wave = law(d, laws::screw_periodic::NAME, &[axis])?;
        let places = self.traces.iter().filter_map(|t| t.record.data(&Role::Position(axis.clone())));
        let mut steps: Vec<f64> =
            places.clone().flat_map(|p| p.windows(2)).map(|w| (w[1] - w[0]).abs()).collect();
        steps.sort_by(f64::total_cmp);
        let all = || places.clone().flatten().copied();
        let span = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
        let shortest = PERIODS_MM[0].max(2.5 * steps.get(steps.len() / 2)?);
        let (from, to) = (1.0 / PERIODS_MM[1].min(span / 3.0), 1.0 / shortest);
        if to <= from {
            return None;
        }
        let (q, left, variance) = self.prepared();
        let step = 0.3 / span;
        let count = ((to - from) / step).ceil().max(2.0) as usize;
        let of = |f: f64| {
            let mut effect = wave.with(&[(0, 1.0 / f)])?;
            let (gain, beta) = self.gain(&q, &left, variance, &self.basis(&effect, None));
            effect.set_coefficients(beta.as_slice());
            Some((effect, gain))
        };
        let (mut best, mut gain) =
            (0..count).filter_map(|i| of(from + step * i as f64)).max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mut h = step;
        for _ in 0..12 {
            h *= 0.5;
            for g in [-h, h] {
                if let Some(other) = of(1.0 / best.scalar(0) + g).filter(|o| o.1 > gain) {
                    (best, gain) = other;
                }
            }
        }
        (gain > 2.0 * (count as f64 / CYCLIC_RISK).ln() && best.scalar(1) > 0.0).then_some(best)
    }

    /// Frees lengths, periods and phases too, and descends.
    fn free_all(&mut self) {
        for t in &mut self.terms {
            if t.name.starts_with("spike.") {
                t.free = vec![0, 1];
            } else if t.name.starts_with("cyclic.") {
                t.free = vec![0, 1, 2];
            }
        }
        let mut before = f64::INFINITY;
        for _ in 0..30 {
            let now = self.step();
            if before - now <= 1e-9 * now {
                break;
            }
            before = now;
        }
    }

    fn answer(&self, axes: [&Axis; 2], told: &[String]) -> Diagnosis {
        let j = self.jacobian();
        let left = self.left();
        let freedom = (self.n - j.ncols()).max(1) as f64;
        let variance = self.white(&left).norm_squared() / freedom;
        let scaled: Vec<f64> = j.column_iter().map(|c| c.norm().max(1e-300)).collect();
        let unit = DMatrix::from_fn(j.nrows(), j.ncols(), |r, c| j[(r, c)] / scaled[c]);
        let inverse =
            unit.tr_mul(&unit).pseudo_inverse(1e-12).unwrap_or_else(|_| DMatrix::zeros(j.ncols(), j.ncols()));
        let quantile = StudentsT::new(0.0, 1.0, freedom).map_or(1.96, |t| t.inverse_cdf(0.975));
        let mut values: BTreeMap<String, (f64, f64)> = BTreeMap::new();
        let mut contributions = Vec::new();
        let mut at = 0;
        for t in &self.terms {
            let Some((effect, _)) = t.parts.first() else { continue };
            for i in &t.free {
                let half = quantile * (variance * inverse[(at, at)]).max(0.0).sqrt() / scaled[at];
                let key = if t.free.len() > 1 {
                    format!("{}.{}", t.name, effect.description().parameters[*i].name)
                } else {
                    t.name.clone()
                };
                values.insert(key, (effect.values()[*i], half));
                at += 1;
            }
            let fitted_only = t.only.is_some() || (t.free.len() > 1 && !told.contains(&t.name));
            if !fitted_only {
                let shape = self.value(t);
                contributions.push(Contribution { cause: cause(&t.name), um: shape.max() - shape.min() });
            }
        }
        contributions.sort_by(|a, b| b.um.total_cmp(&a.um));
        let get = |name: &str| values.get(name).map(|v| v.0);
        let of_axes = |what: &str| {
            axes.iter()
                .filter(|a| told.contains(&format!("{what}.{a}")))
                .map(ToString::to_string)
                .collect::<Vec<_>>()
        };
        let reversal =
            axes.iter().filter_map(|a| Some((a.to_string(), get(&format!("reversal.{a}"))?))).collect();
        let spike = of_axes("spike").into_iter().filter_map(|a| {
            let at = |p: &str| get(&format!("spike.{a}.{p}"));
            Some((a.clone(), Spike { um: at("um")?, length_mm: at("length_mm")? }))
        });
        let cyclic = of_axes("cyclic").into_iter().filter_map(|a| {
            let at = |p: &str| get(&format!("cyclic.{a}.{p}"));
            Some((a.clone(), Cyclic { period_mm: at("period_mm")?, um: at("um")? }))
        });
        let centre = |n: usize| get(&format!("centre.{n}.0")).unwrap_or(0.0);
        let shown = |name: &str| {
            let hidden = |what: &str| {
                name.starts_with(what) && !told.iter().any(|t| name.starts_with(&format!("{t}.")))
            };
            !(hidden("spike.") || hidden("cyclic.") || name.ends_with(".phase_rad"))
        };
        let rename = |name: &str| -> Option<String> {
            match name {
                "radius.0" => Some("radius_um".to_owned()),
                "centre.0.0" => Some(format!("centre_um.{}", axes[0])),
                "centre.1.0" => Some(format!("centre_um.{}", axes[1])),
                n if n.starts_with("radius.") || n.starts_with("centre.") => None,
                n => Some(n.to_owned()),
            }
        };
        let interval_95 = values
            .iter()
            .filter(|(name, _)| shown(name))
            .filter_map(|(name, (v, half))| Some((rename(name)?, [v - half, v + half])))
            .collect();
        Diagnosis {
            centre_um: [centre(0), centre(1)],
            radius_um: get("radius.0").unwrap_or(0.0),
            scale_mismatch_ppm: get("scale_mismatch_ppm"),
            squareness_urad: get("squareness_urad"),
            reversal,
            spike: spike.collect(),
            servo_mismatch_ms: get("servo_mismatch_ms"),
            cyclic: cyclic.collect(),
            interval_95,
            contributions,
            rms: (left.norm_squared() / self.n as f64).sqrt(),
        }
    }
}

/// A term as people call it.
fn cause(name: &str) -> String {
    let known = [
        ("scale_mismatch_ppm", "scale mismatch"),
        ("squareness_urad", "squareness"),
        ("servo_mismatch_ms", "servo mismatch"),
    ];
    if let Some((_, words)) = known.iter().find(|(n, _)| *n == name) {
        return (*words).to_owned();
    }
    let (what, axis) = name.split_once('.').unwrap_or((name, ""));
    let words = match what {
        "spike" => "reversal spike",
        "cyclic" => "cyclic error",
        other => other,
    };
    format!("{words} {axis}")
}

fn residual(j: &DMatrix<f64>, y: &DVector<f64>) -> DVector<f64> {
    y - j * solve(j, y)
}

/// Least squares by scaled normal equations.
fn solve(j: &DMatrix<f64>, y: &DVector<f64>) -> DVector<f64> {
    let scale: Vec<f64> = j.column_iter().map(|c| c.norm().max(1e-300)).collect();
    let unit = DMatrix::from_fn(j.nrows(), j.ncols(), |r, c| j[(r, c)] / scale[c]);
    let normal =
        unit.tr_mul(&unit).pseudo_inverse(1e-12).unwrap_or_else(|_| DMatrix::zeros(j.ncols(), j.ncols()));
    let beta = normal * unit.tr_mul(y);
    DVector::from_fn(j.ncols(), |i, _| beta[i] / scale[i])
}
