//! Causes of a circle's deviations: effects of the model fitted to radial errors.
//!
//! Linear effects are fitted first, then spikes and cyclic errors over a grid of lengths and periods. Last,
//! all are fitted together by Gauss–Newton, with the autocorrelation of the residual. Structure that no
//! effect explains is fitted beside them and widens the intervals (`structure`). Intervals are 95 %.

use super::unexplained_structure::{self, StructureVariance, UnexplainedHarmonics};
use super::{ByAxis, CircleTrace, law};
use crate::each_once;
use crate::iso230::lacks;
use nalgebra::{DMatrix, DVector};
use rtec_files::Result;
use rtec_least_squares::{DeterminedDirections, orthonormal, projected_out};
use rtec_model::ballbar_circle::{rates, tick};
use rtec_model::effect::{Dictionary, Effect, EffectInputColumns, laws};
use rtec_model::record::{Axis, Role, median, rounding_error};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::ops::Range;

/// A reversal spike of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FittedReversalSpike {
    /// Height right after the reversal, µm, with the sign of the new direction.
    pub um: f64,
    /// Travel over which it decays to 1/e, mm.
    pub length_mm: f64,
}

/// A cyclic error of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FittedCyclicError {
    /// Period along the axis, mm.
    pub period_mm: f64,
    /// Amplitude, µm.
    pub um: f64,
}

impl FittedCyclicError {
    /// Whether the period is one of a screw: a lead, or half of it (bearing).
    /// The tolerance is the period's interval, or the dictionary's bound of a scale error, which is slightly
    /// above the loosest screw of ISO 3408-3.
    fn is_of_a_screw(&self, half_mm: f64) -> bool {
        let dictionary = Dictionary::default();
        let scale = dictionary.laws().find(|l| l.describe().name == laws::scale::NAME);
        let off = scale.map_or(0.0, |l| 1e-6 * l.describe().parameters[0].bounds[1]);
        let within = |lead: f64| (self.period_mm - lead).abs() <= half_mm.max(off * lead);
        made_periods_mm().any(within)
    }
}

/// Periods of screws, mm.
/// Metric leads (from the law), inch leads, and half of each.
fn made_periods_mm() -> impl Iterator<Item = f64> {
    let metric = Dictionary::default()
        .laws()
        .find(|l| l.describe().name == laws::screw_periodic::NAME)
        .and_then(|l| l.describe().searched.wave.as_ref())
        .map_or(&[][..], |w| w.usual_mm);
    metric.iter().chain(&INCH_LEADS_MM).flat_map(|lead| [*lead, 0.5 * lead])
}

/// The share of one cause in the circular deviation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CauseContribution {
    /// The cause.
    pub cause: String,
    /// Range of its effect on the radius, µm.
    pub um: f64,
    /// Its share of the sum of all ranges, %; `None` if its interval contains zero.
    pub percent: Option<f64>,
}

/// Free values, each with the half width of its interval.
type Values = BTreeMap<String, (f64, f64)>;

/// Causes that these runs cannot separate: only their sum is known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InseparableCauses {
    /// The causes.
    pub causes: [&'static str; 2],
    /// Range of their joint effect on the radius, µm.
    pub um: f64,
    /// Its 95 % interval, µm.
    pub interval_95: [f64; 2],
}

/// Causes of the deviations of a plane.
/// `None` where the runs do not determine a value. Spikes and cyclic errors below the noise are left out.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Diagnosis {
    /// Centre of the first record's circle: its set-up, µm.
    /// With one direction of rotation, that of the least-squares circle, without an interval.
    pub centre_um: [Option<f64>; 2],
    /// Mean radius of the first record minus the nominal one, µm.
    /// With one direction of rotation as for the centre.
    pub radius_um: Option<f64>,
    /// Scale of the first axis minus that of the second, ppm.
    pub scale_mismatch_ppm: Option<f64>,
    /// Squareness, µrad.
    /// Positive when the angle between the positive axes is below 90°, as `squareness.A.B`.
    pub squareness_urad: Option<f64>,
    /// Reversal per axis, µm, as `reversal.A`: mean up minus mean down.
    pub reversal: ByAxis<f64>,
    /// Spike per axis.
    pub spike: ByAxis<FittedReversalSpike>,
    /// Following error of the first axis minus the second, ms: `following_error.A`.
    pub servo_mismatch_ms: Option<f64>,
    /// Cyclic error per axis with a period of a screw.
    pub cyclic: ByAxis<FittedCyclicError>,
    /// Cyclic error per axis with a period that no screw has.
    /// It may be a map as well as a wave.
    pub form: ByAxis<FittedCyclicError>,
    /// 95 % intervals by name.
    pub interval_95: BTreeMap<String, [f64; 2]>,
    /// Separable causes: those with a share, largest first, then the others.
    pub contributions: Vec<CauseContribution>,
    /// Causes that one direction of rotation at one feed cannot separate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_separable: Option<InseparableCauses>,
    /// RMS of the least residual that the causes can leave, µm.
    pub rms: f64,
    /// Standard deviation of one reading, µm, of the record where it is largest.
    pub scatter_um: f64,
    /// RMS of unexplained structure that is the same in both directions, µm.
    /// Maps and bends, from the third harmonic up. `None` if it is below the noise. It widens the intervals.
    pub unexplained_um: Option<f64>,
}

/// Leads of inch screws, mm: 0.1, 0.2, 0.25, 0.4, 0.5 and 1 inch.
const INCH_LEADS_MM: [f64; 6] = [2.54, 5.08, 6.35, 10.16, 12.7, 25.4];
/// Rows nearer than this to a reversal are not fitted, mm.
/// Up to 20 µm of play is taken up by then, and the row's direction may be uncertain.
const SETTLED_MM: f64 = 0.03;
/// Width left out around a reversal, as a multiple of the play found.
const TAKEN_UP: f64 = 1.5;
/// Largest play of a machine tool, mm.
const LONGEST_PLAY_MM: f64 = 0.5;
/// Factor on the variance where structure is fitted: laws were chosen in it.
const CHOSEN_AMONG: f64 = 1.5;
/// Structure is reported from this ratio of its RMS to the noise.
const SHOWS: f64 = 0.5;
/// Least independent share of a column; below it, other columns explain it.
const DISTINCT: f64 = 1e-4;
/// Share of the radius after which a spike at the start has decayed.
/// An axis may have reversed just before the record, so its spike is unknown.
const DIED_OUT: f64 = 0.25;
/// Largest relative difference of a row's speed from the feed.
const AT_FEED: f64 = 0.02;
/// Name of the sum that one direction of rotation at one feed shows.
const TOGETHER: &str = "squareness and servo mismatch";
/// A value is reported only if this share of it lies in the observable directions.
const RESOLVED: f64 = 0.99;
/// Largest autocorrelation of the noise; more is unexplained structure.
const MOST_MEMORY: f64 = 0.95;

/// Prior drift of a bar's radius and centre in a record, 1 σ, µm.
/// It is that of 0.6 K in a steel bar of 300 mm.
const DRIFT_UM: f64 = 2.0;

/// Iterations of the correction of rounding.
const ROUNDING_STEPS: usize = 3;

/// A term of the fit: a weighted sum of effects.
/// `free` lists the free values of the first effect.
#[derive(Clone)]
pub(super) struct FitTerm {
    pub(super) name: String,
    pub(super) parts: Vec<(Effect, f64)>,
    pub(super) free: Vec<usize>,
    /// The only record that the term applies to: its centre and radius.
    pub(super) only: Option<usize>,
}

impl FitTerm {
    /// Whether it is reported: spikes and cyclic errors only if they are in `told`.
    fn is_told(&self, told: &[String]) -> bool {
        !(self.name.starts_with("spike.") || self.name.starts_with("cyclic.")) || told.contains(&self.name)
    }
}

/// The fit of one plane.
#[derive(Clone)]
pub(super) struct DiagnosisFit<'t> {
    pub(super) traces: &'t [CircleTrace],
    /// First stacked row of each trace.
    pub(super) start: Vec<usize>,
    pub(super) n: usize,
    /// Radial errors about each record's least-squares circle.
    pub(super) y: DVector<f64>,
    /// That circle of each record: radius and centre, µm.
    circle: Vec<[f64; 3]>,
    pub(super) terms: Vec<FitTerm>,
    /// Rows that follow the one before them in the same contour.
    pub(super) follows: Vec<bool>,
    /// Rows that are fitted.
    pub(super) counts: Vec<bool>,
    /// Autocorrelation of the noise from row to row.
    pub(super) phi: f64,
    /// Structure without laws.
    pub(super) structure: UnexplainedHarmonics,
    /// Number of drift columns, the last ones of `beside`.
    pub(super) drift: usize,
    /// Columns fitted beside the terms.
    pub(super) beside: DMatrix<f64>,
    /// Orthonormal basis of those columns after whitening.
    pub(super) beside_white: DMatrix<f64>,
}

/// Uncertainty of the free values, in the order of the terms.
pub(super) struct ValueUncertainty {
    /// Half the width of each 95 % interval.
    pub(super) halves: Vec<f64>,
    /// Allowed rise of the sum of squares for each interval.
    rises: Vec<f64>,
    /// Whether the runs determine the value.
    resolved: Vec<bool>,
    /// Structure in the laws' orders.
    beside: Option<StructureVariance>,
}

/// Fits one plane.
pub(super) fn diagnose(traces: &[CircleTrace], warnings: &mut Vec<String>) -> Result<Diagnosis> {
    let mut settled_mm = SETTLED_MM;
    loop {
        let mut said = Vec::new();
        let finer = without_rounding(traces, settled_mm)?;
        let found = diagnose_beyond(finer.as_deref().unwrap_or(traces), settled_mm, &mut said)?;
        // Rows within the play found must not be fitted: repeat with more left out.
        let play_mm = found.reversal.values().map(|um| um.abs() / 1000.0).fold(0.0, f64::max);
        if TAKEN_UP * play_mm <= settled_mm || settled_mm > LONGEST_PLAY_MM {
            warnings.append(&mut said);
            return Ok(found);
        }
        settled_mm = 2.0 * TAKEN_UP * play_mm;
    }
}

/// The readings of a coarse gauge less the rounding error that the laws predict.
/// Equal values round alike, so rounding looks like a cause. Where noise or structure dithers the readings
/// the correction vanishes. `None` for gauges without steps.
fn without_rounding(traces: &[CircleTrace], settled_mm: f64) -> Result<Option<Vec<CircleTrace>>> {
    let axes = traces[0].record.circle().map(|c| c.plane.clone());
    let Some(axes) = axes.filter(|_| traces.iter().any(|t| t.step_um > 0.0)) else { return Ok(None) };
    let mut finer = traces.to_vec();
    for _ in 0..ROUNDING_STEPS {
        let mut fit = DiagnosisFit::of_laws(&finer, [&axes[0], &axes[1]], settled_mm, &mut Vec::new())?;
        fit.memory();
        let left = fit.left();
        let start = fit.start;
        for ((read, now), start) in traces.iter().zip(&mut finer).zip(&start) {
            let q = read.step_um;
            let predicted = |row: usize| now.radial[row] - left[start + row];
            let off = |row: usize| read.radial[row] - predicted(row);
            let rows = 0..read.radial.len();
            let square = rows.clone().map(|row| off(row) * off(row)).sum::<f64>() / rows.len() as f64;
            let variance = (square - q * q / 12.0).max(0.0);
            let error = |row| rounding_error(q, predicted(row) - read.radial[0], variance);
            let without = |row| read.radial[row] - if q > 0.0 { error(row) } else { 0.0 };
            now.radial = rows.map(without).collect();
        }
    }
    Ok(Some(finer))
}

/// As `diagnose`, from rows at least this far from both axes' reversals, mm.
fn diagnose_beyond(traces: &[CircleTrace], settled_mm: f64, warnings: &mut Vec<String>) -> Result<Diagnosis> {
    let all_circles = traces.iter().all(|t| t.record.circle().is_some());
    let Some(circle) = traces[0].record.circle().filter(|_| all_circles) else {
        let no_circle =
            "no radius_mm and plane in the sidecar: no squareness, scale, reversal or servo mismatch";
        warnings.push(no_circle.to_owned());
        let [radius, a, b] = circle_of(&traces[0]);
        return Ok(Diagnosis {
            centre_um: [Some(a), Some(b)],
            radius_um: Some(radius),
            scatter_um: traces[0].scatter_um(&traces[0].radial),
            ..Diagnosis::default()
        });
    };
    let axes = circle.plane.each_ref();
    let mut told = Vec::new();
    let mut fit = DiagnosisFit::of_laws(traces, axes, settled_mm, warnings)?;
    fit.search(axes, &mut told);
    // With one direction of rotation structure looks like reversal and squareness: assume it is there.
    if !fit.structure.both_ways || fit.harmonics_show() {
        // Effects found before may have been structure.
        told.clear();
        fit = DiagnosisFit::of_laws(traces, axes, settled_mm, &mut Vec::new())?;
        fit.take_beside(&fit.structure.columns.clone());
        fit.search(axes, &mut told);
    }
    if !fit.structure.both_ways {
        let text = "one sense of turning: reversals and spikes look as maps and bends do, and are not given; squareness and scale \
                    have wider intervals for it; measure both ways";
        warnings.push(text.to_owned());
    }
    let mut shown = fit.value_uncertainty();
    fit.average(axes, &told, &mut shown);
    let found = fit.answer(axes, &told, &shown);
    let lost = fit.not_told(&told, &shown);
    if !lost.is_empty() {
        let (lost, cure) = (lost.join(", "), "full circles both ways in one record do");
        warnings.push(format!("these runs do not tell {lost} apart: {cure}"));
    }
    if let Some(um) = found.unexplained_um {
        warnings.push(format!(
            "not explained by these causes: {um:.2} µm RMS that is the same both ways round (a map, a bend); the intervals are widened by it"
        ));
    }
    Ok(found)
}

/// Mean radius and centre of a record's least-squares circles, µm.
fn circle_of(trace: &CircleTrace) -> [f64; 3] {
    let contours = trace.evaluate();
    let n = contours.len().max(1) as f64;
    let mean = |of: &dyn Fn(&super::ContourResult) -> f64| contours.iter().map(of).sum::<f64>() / n;
    [mean(&|c| c.radius_um), mean(&|c| c.centre_um[0]), mean(&|c| c.centre_um[1])]
}

impl<'t> DiagnosisFit<'t> {
    /// A fit with the linear laws.
    fn of_laws(
        traces: &'t [CircleTrace],
        [a, b]: [&Axis; 2],
        settled_mm: f64,
        warnings: &mut Vec<String>,
    ) -> Result<Self> {
        let mut fit = Self::new(traces, settled_mm);
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
            let found = format!("{} rows", fit.n);
            return Err(lacks(&traces[0].record, &found, "a circle of more rows than that"));
        }
        if !fit.drop_alike("servo_mismatch_ms", timed) {
            // One direction cannot separate an ellipse at 45°: both causes become one term.
            fit.terms.retain(|t| t.name != "servo_mismatch_ms");
            for t in fit.terms.iter_mut().filter(|t| t.name == "squareness_urad") {
                TOGETHER.clone_into(&mut t.name);
            }
            let alike = "squareness and servo mismatch look alike; measure both ways";
            warnings.push(format!("one sense of turning at one feed: {alike}"));
        }
        Ok(fit)
    }

    /// The terms, each with the places of its free values among all.
    pub(super) fn placed(&self) -> impl Iterator<Item = (&FitTerm, Range<usize>)> {
        self.terms.iter().scan(0, |end, t| {
            let start = *end;
            *end += t.free.len();
            Some((t, start..*end))
        })
    }

    /// Adds columns to those fitted beside the terms.
    pub(super) fn take_beside(&mut self, more: &DMatrix<f64>) {
        let all = [columns_of(&self.beside), columns_of(more)].concat();
        self.beside = unexplained_structure::matrix_of(self.n, &all);
        self.prepare_beside();
    }

    fn new(traces: &'t [CircleTrace], settled_mm: f64) -> Self {
        let mut start = Vec::new();
        let (mut n, mut y, mut follows, mut counts) = (0, Vec::new(), Vec::new(), Vec::new());
        let circle: Vec<[f64; 3]> = traces.iter().map(circle_of).collect();
        for (t, [radius, a, b]) in traces.iter().zip(&circle) {
            start.push(n);
            n += t.radial.len();
            // Set-up and radius may exceed the bounds of the laws.
            y.extend(t.angle.iter().zip(&t.radial).map(|(p, e)| e - radius - a * p.cos() - b * p.sin()));
            // At the start of a record, and after a change of direction, an earlier reversal is unknown.
            // Circles in one direction continue each other.
            let of = |(k, (rows, sense)): (usize, &(Range<usize>, f64))| {
                let goes_on = k > 0 && t.contours[k - 1].1 * sense > 0.0;
                if goes_on { rows.clone() } else { begun(&t.angle, rows)..rows.end }
            };
            let begun: Vec<Range<usize>> = t.contours.iter().enumerate().map(of).collect();
            let at_feed = at_feed(t);
            let is_begun = |i: usize| begun.iter().any(|rows| rows.contains(&i));
            let is_fitted = |i: usize| at_feed[i] && is_begun(i) && !turns(t, t.angle[i], settled_mm);
            let own: Vec<bool> = (0..t.angle.len()).map(is_fitted).collect();
            let inside =
                |i: usize| begun.iter().any(|rows| rows.contains(&i) && i > rows.start) && own[i - 1];
            follows.extend((0..t.radial.len()).map(inside));
            counts.extend(own);
        }
        let mut fit = Self {
            traces,
            start,
            n,
            y: DVector::from_vec(y),
            circle,
            terms: Vec::new(),
            follows,
            counts,
            phi: 0.0,
            structure: UnexplainedHarmonics::of(traces, n),
            drift: 0,
            beside: DMatrix::zeros(n, 0),
            beside_white: DMatrix::zeros(n, 0),
        };
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

    pub(super) fn push(&mut self, name: &str, parts: Option<Vec<(Effect, f64)>>) {
        let Some(parts) = parts else { return };
        let free = vec![0; usize::from(!parts.is_empty())];
        self.terms.push(FitTerm { name: name.to_owned(), parts, free, only: None });
    }

    /// Columns over all rows; `fill` writes the `width` columns of one record.
    pub(super) fn stack(
        &self,
        effect: &Effect,
        only: Option<usize>,
        width: usize,
        fill: impl Fn(&EffectInputColumns<'_>, usize, &mut [f64]),
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

    pub(super) fn basis(&self, effect: &Effect, only: Option<usize>) -> Vec<DVector<f64>> {
        self.stack(effect, only, effect.coefficient_count(), |b, c, out| b.basis(effect, c, out))
    }

    /// Derivatives of a term by its free values.
    pub(super) fn slopes(&self, term: &FitTerm) -> Vec<DVector<f64>> {
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

    /// Shift of a record's circle by a straight law, µm.
    /// Away from the machine's zero the law also shifts the centre, which is set-up and not shape.
    fn shift(&self, term: &FitTerm, trace: usize) -> [f64; 2] {
        if !["scale_mismatch_ppm", "squareness_urad"].contains(&term.name.as_str()) {
            return [0.0; 2];
        }
        // On a circle a straight law has harmonics of orders 0, 1 and 2.
        let angle = &self.traces[trace].angle;
        let of = |f: fn(f64) -> f64| angle.iter().map(|a| f(*a)).collect::<Vec<f64>>();
        let lobes =
            [of(|_| 1.0), of(f64::cos), of(f64::sin), of(|a| (2.0 * a).cos()), of(|a| (2.0 * a).sin())];
        let value = self.value(term);
        let found = rtec_least_squares::solve(&lobes, &value.as_slice()[self.start[trace]..][..angle.len()]);
        found.map_or([0.0; 2], |f| [f.values[1], f.values[2]])
    }

    /// Effect of a cause on the shape of the circles.
    fn shape(&self, term: &FitTerm) -> DVector<f64> {
        let mut out = self.value(term);
        for (k, (trace, start)) in self.traces.iter().zip(&self.start).enumerate() {
            let [a, b] = self.shift(term, k);
            for (angle, row) in trace.angle.iter().zip(*start..) {
                out[row] -= a * angle.cos() + b * angle.sin();
            }
        }
        out
    }

    pub(super) fn value(&self, term: &FitTerm) -> DVector<f64> {
        let mut out = DVector::zeros(self.n);
        for (effect, weight) in &term.parts {
            let columns = self.basis(effect, term.only);
            for (c, column) in effect.coefficients().iter().zip(&columns) {
                out.axpy(c * weight, column, 1.0);
            }
        }
        out
    }

    /// Whitens a column and projects out the columns beside the terms.
    pub(super) fn white(&self, column: &DVector<f64>) -> DVector<f64> {
        projected_out(&self.beside_white, self.whitened(column))
    }

    pub(super) fn whitened(&self, column: &DVector<f64>) -> DVector<f64> {
        let share = (1.0 - self.phi * self.phi).sqrt();
        DVector::from_fn(self.n, |i, _| match (self.counts[i], self.follows[i]) {
            (false, _) => 0.0,
            (true, true) => column[i] - self.phi * column[i - 1],
            (true, false) => share * column[i],
        })
    }

    fn all_whitened(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        self.each_column(columns, |c| self.whitened(c))
    }

    fn each_column(&self, all: &DMatrix<f64>, of: impl Fn(&DVector<f64>) -> DVector<f64>) -> DMatrix<f64> {
        unexplained_structure::matrix_of(self.n, &columns_of(all).iter().map(of).collect::<Vec<_>>())
    }

    /// Must follow a change of the columns beside or of the autocorrelation.
    fn prepare_beside(&mut self) {
        self.beside_white = orthonormal(self.all_whitened(&self.beside));
    }

    /// Residual of the terms and of the columns beside them.
    fn noise(&self) -> DVector<f64> {
        let left = self.left();
        if self.beside.ncols() == 0 {
            return left;
        }
        let amplitudes =
            DeterminedDirections::by(&self.all_whitened(&self.beside)).solve(&self.whitened(&left));
        left - &self.beside * amplitudes
    }

    pub(super) fn freedom(&self, terms: usize) -> f64 {
        self.rows().saturating_sub(terms + self.beside.ncols()).max(1) as f64
    }

    /// Number of fitted rows.
    fn rows(&self) -> usize {
        self.counts.iter().filter(|c| **c).count()
    }

    /// RMS over the fitted rows.
    fn rms(&self, v: &DVector<f64>) -> f64 {
        let own = v.iter().zip(&self.counts).filter(|(_, c)| **c).map(|(v, _)| v * v);
        (own.sum::<f64>() / self.rows().max(1) as f64).sqrt()
    }

    pub(super) fn jacobian(&self) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> =
            self.terms.iter().flat_map(|t| self.slopes(t)).map(|c| self.white(&c)).collect();
        DMatrix::from_columns(&columns)
    }

    /// Whether a term is distinguishable from the others, if it is `there`.
    fn drop_alike(&self, name: &str, there: bool) -> bool {
        let Some(i) = self.terms.iter().position(|t| t.name == name).filter(|_| there) else {
            // Without a feed only both directions separate squareness from lag.
            return self.structure.both_ways;
        };
        let j = self.jacobian();
        let own = j.column(i).into_owned();
        let others = j.remove_column(i);
        let left = residual(&others, &own);
        left.norm_squared() > DISTINCT * own.norm_squared()
    }

    /// Residual of the terms alone.
    pub(super) fn left(&self) -> DVector<f64> {
        let mut left = self.y.clone();
        for t in &self.terms {
            left -= self.value(t);
        }
        left
    }

    /// Fits linear values and autocorrelation twice: each depends on the other.
    pub(super) fn memory(&mut self) {
        for _ in 0..2 {
            self.step();
            let left = self.noise();
            let (mut own, mut next) = (0.0, 0.0);
            for i in (1..self.n).filter(|i| self.follows[*i]) {
                own += left[i - 1] * left[i - 1];
                next += left[i] * left[i - 1];
            }
            let seen = if own > 0.0 { next / own } else { 0.0 };
            self.phi = if self.beside.ncols() > 6 {
                self.structure.memory(seen, self.n, MOST_MEMORY)
            } else {
                seen.clamp(0.0, MOST_MEMORY)
            };
            self.prepare_beside();
        }
        self.step();
    }

    /// One Gauss–Newton step; returns the sum of squares after it.
    pub(super) fn step(&mut self) -> f64 {
        let before = self.white(&self.left()).norm_squared();
        let j = self.jacobian();
        let by = DeterminedDirections::by(&j).solve(&self.white(&self.left()));
        // Halve the step until it does not increase the sum.
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

    /// Moves the free values; returns whether all stayed within their bounds.
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

    /// Half widths and resolution of each free value, and the structure.
    pub(super) fn value_uncertainty(&self) -> ValueUncertainty {
        let j = self.jacobian();
        let left = self.left();
        let freedom = self.freedom(j.ncols());
        let white = self.white(&left);
        let variance = white.norm_squared() / freedom * UnexplainedHarmonics::excess_correlation(&white);
        let variance = if self.beside.ncols() > 0 { CHOSEN_AMONG * variance } else { variance };
        let variance = self.traces.iter().map(CircleTrace::rounding_um2).fold(variance, f64::max);
        let directions = DeterminedDirections::by(&j);
        let told_beside = self.structure_variance(&left, variance);
        // Change of each value per µm in each of the laws' orders.
        let moves = told_beside
            .map(|_| directions.solve_all(&self.each_column(&self.structure.taken, |c| self.white(c))));
        let half = |at: usize| {
            let noise = (variance * directions.covariance[(at, at)]).max(0.0);
            let (mut all, mut spread) = (noise, noise * noise / freedom);
            if let (Some(told), Some(moves)) = (&told_beside, &moves) {
                for k in 0..moves.ncols() {
                    let own = told.variance[k] * moves[(at, k)].powi(2);
                    all += own;
                    spread += own * own / told.freedom[k];
                }
            }
            // Effective degrees of freedom (Welch and Satterthwaite): few values give the structure's size.
            let effective = if spread > 0.0 { (all * all / spread).max(1.0) } else { freedom };
            let quantile = StudentsT::new(0.0, 1.0, effective).map_or(1.96, |t| t.inverse_cdf(0.975));
            let rise = if noise > 0.0 { quantile * quantile * variance * all / noise } else { 0.0 };
            (quantile * all.sqrt(), rise)
        };
        let (halves, rises): (Vec<f64>, Vec<f64>) = (0..j.ncols()).map(half).unzip();
        // A value is unresolved if its interval is wider than its physical range.
        let told = |(half, widest): (&f64, f64)| *half < widest;
        let within: Vec<bool> = halves.iter().zip(self.widest()).map(told).collect();
        let resolved =
            directions.resolution.iter().zip(within).map(|(r, within)| *r > RESOLVED && within).collect();
        ValueUncertainty { halves, rises, resolved, beside: told_beside }
    }

    /// Averages each value over fits with and without unreported spikes and drift.
    /// The weights are their Bayes factors. The interval includes the spread between both fits.
    fn average(&mut self, axes: [&Axis; 2], told: &[String], shown: &mut ValueUncertainty) {
        let untold = |name: &str| name.starts_with("spike.") && !told.iter().any(|t| t == name);
        let is_fitted =
            |axis: &&Axis| self.terms.iter().any(|t| t.name == format!("spike.{axis}") && untold(&t.name));
        let spikes: Vec<&Axis> = axes.into_iter().filter(is_fitted).collect();
        if !self.structure.both_ways || (spikes.is_empty() && self.drift == 0) {
            return;
        }
        let mut without = self.clone();
        without.terms.retain(|t| !untold(&t.name));
        let kept = self.beside.ncols() - self.drift;
        without.beside = self.beside.columns(0, kept).into_owned();
        without.drift = 0;
        without.prepare_beside();
        without.free_all(told);
        let drift = columns_of(&self.beside.columns(kept, self.drift).into_owned());
        let mut odds: f64 = spikes.iter().filter_map(|axis| without.spike_odds(axis)).sum();
        for columns in drift.chunks(unexplained_structure::DRIFTS) {
            odds += without.odds(columns, DRIFT_UM);
        }
        let share = (1.0 + (-odds).exp()).recip();
        let halves = without.value_uncertainty().halves;
        let values = without.terms.iter().flat_map(|t| t.free.iter().map(|i| t.parts[0].0.values()[*i]));
        let mut others = values.zip(halves);
        let mut at = 0;
        for t in &mut self.terms {
            for i in &t.free {
                // An omitted spike has height 0.
                let now = t.parts[0].0.values()[*i];
                let other = if untold(&t.name) { Some((0.0, 0.0)) } else { others.next() };
                if let Some((value, half)) = other {
                    let mean = share * now + (1.0 - share) * value;
                    let between = 1.96 * (now - value);
                    let square = share * shown.halves[at].powi(2) + (1.0 - share) * half.powi(2);
                    shown.halves[at] = (square + share * (1.0 - share) * between.powi(2)).sqrt();
                    for (effect, _) in &mut t.parts {
                        if let Some(e) = effect.with(&[(*i, mean)]) {
                            *effect = e;
                        }
                    }
                }
                at += 1;
            }
        }
    }

    /// The physical range of each free value.
    fn widest(&self) -> impl Iterator<Item = f64> {
        let of = |t: &FitTerm| -> Vec<f64> {
            let parameters = t.parts.first().map(|(e, _)| &e.description().parameters);
            let width = |i: &usize| parameters.map_or(f64::INFINITY, |p| p[*i].bounds[1] - p[*i].bounds[0]);
            t.free.iter().map(width).collect()
        };
        self.terms.iter().flat_map(of)
    }

    /// Least RMS that the causes alone can leave, µm.
    fn least_left(&self) -> f64 {
        let own = |v: &DVector<f64>| DVector::from_fn(self.n, |i, _| if self.counts[i] { v[i] } else { 0.0 });
        let columns: Vec<DVector<f64>> =
            self.terms.iter().flat_map(|t| self.slopes(t)).map(|c| own(&c)).collect();
        self.rms(&residual(&DMatrix::from_columns(&columns), &own(&self.left())))
    }

    fn scatter_um(&self) -> f64 {
        let left = self.left();
        let of =
            |(t, start): (&CircleTrace, &usize)| t.scatter_um(&left.as_slice()[*start..][..t.radial.len()]);
        self.traces.iter().zip(&self.start).map(of).fold(0.0, f64::max)
    }

    /// Causes and set-up terms that these runs cannot determine, in words.
    fn not_told(&self, told: &[String], shown: &ValueUncertainty) -> Vec<String> {
        let is_open = |(t, places): &(&FitTerm, Range<usize>)| {
            !shown.resolved[places.clone()].iter().all(|r| *r) && self.separates(&t.name) && t.is_told(told)
        };
        let set_up = |_| "the set-up (centre, radius)".to_owned();
        let name = |(t, _): (&FitTerm, _)| t.only.map_or_else(|| cause(&t.name), set_up);
        each_once(self.placed().filter(is_open).map(name))
    }

    /// Free values with their half widths, and the causes' contributions.
    /// Unresolved values are left out.
    fn values(
        &self,
        shown: &ValueUncertainty,
        told: &[String],
    ) -> (Values, Vec<CauseContribution>, Option<InseparableCauses>) {
        let mut values = Values::new();
        let (mut contributions, mut not_separable) = (Vec::new(), None);
        for (t, places) in
            self.placed().filter(|(_, places)| shown.resolved[places.clone()].iter().all(|r| *r))
        {
            let Some((effect, _)) = t.parts.first() else { continue };
            for (i, half) in t.free.iter().zip(&shown.halves[places]) {
                let parameter = || format!("{}.{}", t.name, effect.description().parameters[*i].name);
                let key = if t.free.len() > 1 { parameter() } else { t.name.clone() };
                values.insert(key, (effect.values()[*i], *half));
            }
            if t.only.is_none() && t.is_told(told) && self.separates(&t.name) {
                let shape = self.shape(t);
                let um = shape.max() - shape.min();
                if t.name == TOGETHER {
                    let share = values.get(&t.name).map_or(0.0, |(v, half)| half / v.abs());
                    let interval_95 = [um * (1.0 - share).max(0.0), um * (1.0 + share)];
                    let causes = ["squareness", "servo mismatch"];
                    not_separable = Some(InseparableCauses { causes, um, interval_95 });
                    continue;
                }
                let holds_zero = |(value, half): &(f64, f64)| value.abs() <= *half;
                let told = !values.get(&t.name).is_some_and(holds_zero);
                contributions.push(CauseContribution {
                    cause: cause(&t.name),
                    um,
                    percent: told.then_some(0.0),
                });
            }
        }
        if self.unexplained_um(shown).is_some() {
            let form = self.left() - self.noise();
            let cause = "not explained, the same both ways".to_owned();
            contributions.push(CauseContribution { cause, um: form.max() - form.min(), percent: Some(0.0) });
        }
        contributions
            .sort_by(|a, b| b.percent.is_some().cmp(&a.percent.is_some()).then(b.um.total_cmp(&a.um)));
        let sum: f64 = contributions.iter().filter(|c| c.percent.is_some()).map(|c| c.um).sum();
        for c in &mut contributions {
            c.percent = c.percent.map(|_| 100.0 * c.um / sum.max(f64::MIN_POSITIVE));
        }
        (values, contributions, not_separable)
    }

    /// RMS of structure that both directions share, µm; `None` if below the noise.
    fn unexplained_um(&self, shown: &ValueUncertainty) -> Option<f64> {
        // With one direction of rotation reversals are part of it.
        let beside = shown.beside.filter(|_| self.structure.both_ways);
        beside.map(|t| t.rms_um).filter(|um| *um > SHOWS * self.rms(&self.noise()))
    }

    fn answer(&self, axes: [&Axis; 2], told: &[String], shown: &ValueUncertainty) -> Diagnosis {
        let (values, mut contributions, not_separable) = self.values(shown, told);
        let get = |name: &str| values.get(name).map(|v| v.0);
        // The two values of a reported term, by axis.
        let of_axes = |what: &str, values: [&str; 2]| -> Vec<(String, [f64; 2])> {
            let of = |a: &&Axis| {
                let [one, other] = values.map(|value| get(&format!("{what}.{a}.{value}")));
                Some((a.to_string(), [one?, other?])).filter(|_| told.contains(&format!("{what}.{a}")))
            };
            axes.iter().filter_map(of).collect()
        };
        let reversal =
            axes.iter().map(|a| (a, format!("reversal.{a}"))).filter(|(_, name)| self.separates(name));
        let reversal = reversal.filter_map(|(a, name)| Some((a.to_string(), get(&name)?))).collect();
        let spike = of_axes("spike", ["um", "length_mm"]).into_iter();
        let spike = spike.map(|(a, [um, length_mm])| (a, FittedReversalSpike { um, length_mm }));
        let cyclic = of_axes("cyclic", ["period_mm", "um"]).into_iter();
        let cyclic = cyclic.map(|(a, [period_mm, um])| (a, FittedCyclicError { period_mm, um }));
        let unexplained_um = self.unexplained_um(shown);
        let (cyclic, form): (Vec<_>, Vec<_>) = cyclic.partition(|(a, c)| {
            let half_mm = values.get(&format!("cyclic.{a}.period_mm")).map_or(0.0, |v| v.1);
            // A wave weaker than the structure may be part of that, whatever its period.
            c.is_of_a_screw(half_mm) && unexplained_um.is_none_or(|rms| c.um > SQRT_2 * rms)
        });
        let form: ByAxis<FittedCyclicError> = form.into_iter().collect();
        for c in &mut contributions {
            if let Some(axis) = c.cause.strip_prefix("cyclic error ").filter(|a| form.contains_key(*a)) {
                c.cause = format!("form that repeats {axis}");
            }
        }
        // Centre as the contours have it, including the shift by straight laws.
        let circle_of = |k: usize| {
            let moved = self.terms.iter().map(|t| if k > 0 { self.shift(t, 0)[k - 1] } else { 0.0 });
            self.circle[0][k] + moved.sum::<f64>()
        };
        // With one direction reversals shift the set-up: use the least-squares circle.
        let set_up = ["radius.0", "centre.0.0", "centre.1.0"];
        let both_ways = self.structure.both_ways;
        let of =
            |k: usize| if both_ways { Some(get(set_up[k])? + circle_of(k)) } else { Some(self.circle[0][k]) };
        let [radius_um, centre_a, centre_b] = [0, 1, 2].map(of);
        let stands = |name: &str| {
            let hidden = |what: &str| {
                name.starts_with(what)
                    && !told.iter().any(|t| name == t || name.starts_with(&format!("{t}.")))
            };
            !(hidden("spike.") || hidden("cyclic.") || name.ends_with(".phase_rad") || !self.separates(name))
        };
        let set_up_names =
            ["radius_um".to_owned(), format!("centre_um.{}", axes[0]), format!("centre_um.{}", axes[1])];
        // Name for users, and what the value is counted from.
        let rename = |name: &str| match set_up.iter().position(|s| *s == name) {
            Some(k) if both_ways => Some((set_up_names[k].clone(), circle_of(k))),
            _ if name.starts_with("radius.") || name.starts_with("centre.") || name == TOGETHER => None,
            _ => {
                let is_form = |rest: &&str| rest.split('.').next().is_some_and(|a| form.contains_key(a));
                let form = name.strip_prefix("cyclic.").filter(is_form).map(|rest| format!("form.{rest}"));
                Some((form.unwrap_or_else(|| name.to_owned()), 0.0))
            }
        };
        let interval = |(name, (v, half)): (&String, &(f64, f64))| {
            let (words, circle) = rename(name).filter(|_| stands(name))?;
            Some((words, [v + circle - half, v + circle + half]))
        };
        let mut interval_95: BTreeMap<String, [f64; 2]> = values.iter().filter_map(interval).collect();
        interval_95.extend(self.spike_intervals(told, shown));
        Diagnosis {
            centre_um: [centre_a, centre_b],
            radius_um,
            scale_mismatch_ppm: get("scale_mismatch_ppm"),
            squareness_urad: get("squareness_urad"),
            reversal,
            spike: spike.collect(),
            servo_mismatch_ms: get("servo_mismatch_ms"),
            cyclic: cyclic.into_iter().collect(),
            form,
            interval_95,
            contributions,
            not_separable,
            rms: self.least_left(),
            scatter_um: self.scatter_um(),
            unexplained_um,
        }
    }

    /// Intervals of reported spikes, by the names of their values.
    fn spike_intervals(&self, told: &[String], shown: &ValueUncertainty) -> Vec<(String, [f64; 2])> {
        let mut intervals = Vec::new();
        for (t, places) in self.placed() {
            let known = shown.resolved[places.clone()].iter().all(|r| *r);
            if known && t.name.starts_with("spike.") && told.contains(&t.name) && t.free.len() == 2 {
                let rises = [shown.rises[places.start], shown.rises[places.start + 1]];
                let profile = self.spike_profile(t, rises);
                let named =
                    |ends| ["um", "length_mm"].map(|p| format!("{}.{p}", t.name)).into_iter().zip(ends);
                intervals.extend(profile.into_iter().flat_map(named));
            }
        }
        intervals
    }

    /// Whether these runs separate a term from a map or a bend.
    /// With one direction of rotation, reversals and spikes cannot be separated.
    fn separates(&self, name: &str) -> bool {
        self.structure.both_ways || !(name.starts_with("reversal.") || name.starts_with("spike."))
    }

    /// Estimates the structure in the laws' orders from the harmonics.
    fn structure_variance(&self, left: &DVector<f64>, variance: f64) -> Option<StructureVariance> {
        let harmonics = &self.structure.columns;
        if harmonics.ncols() == 0 {
            return None;
        }
        let all = self.all_whitened(harmonics);
        let directions = DeterminedDirections::by(&all);
        let variances = directions.covariance.diagonal() * variance;
        self.structure.structure_variance(&directions.solve(&self.whitened(left)), &variances)
    }
}

/// Rows at their contour's feed; all rows for a fine clock or an uneven feed.
/// A coarse clock does not resolve the speed of a start or stop, so lag would look like reversals and spikes.
fn at_feed(trace: &CircleTrace) -> Vec<bool> {
    let n = trace.angle.len();
    let Some(t) = trace.record.data(&Role::Time).filter(|t| tick(t).is_some()) else { return vec![true; n] };
    let speed: Vec<f64> = rates(&trace.angle, t).iter().map(|r| r.abs()).collect();
    let mut all = vec![true; n];
    for (rows, _) in &trace.contours {
        let usual = median(speed[rows.clone()].iter().copied());
        let keeps = |row: &usize| (speed[*row] - usual).abs() <= AT_FEED * usual;
        if 2 * rows.clone().filter(keeps).count() > rows.len() {
            rows.clone().for_each(|row| all[row] = keeps(&row));
        }
    }
    all
}

/// Whether an axis is so near its reversal that the row's direction is uncertain.
fn turns(trace: &CircleTrace, angle: f64, settled_mm: f64) -> bool {
    let radius_mm = trace.record.circle().map_or(f64::INFINITY, |c| c.radius_mm);
    [angle.cos(), angle.sin()].iter().any(|share| radius_mm * (1.0 - share.abs()) < settled_mm)
}

/// The first row of a contour from which both axes have a known history.
/// Each has reversed in the contour or moved far enough from its start.
fn begun(angle: &[f64], rows: &Range<usize>) -> usize {
    let own = &angle[rows.clone()];
    let by_axis = [f64::cos as fn(f64) -> f64, f64::sin].map(|share| {
        let mut farthest = 0.0_f64;
        own.iter().map(|a| (share(*a) - share(own[0])).abs()).position(|d| {
            farthest = farthest.max(d);
            // A decrease by more than the angle's resolution is a reversal.
            d >= DIED_OUT || d < farthest - 1e-3
        })
    });
    rows.start + by_axis.into_iter().flatten().max().unwrap_or(0)
}

/// Name of a term for users.
fn cause(name: &str) -> String {
    let (what, axis) = name.split_once('.').unwrap_or((name, ""));
    let words = match what {
        "scale_mismatch_ppm" => "scale mismatch",
        "squareness_urad" => "squareness",
        "servo_mismatch_ms" => "servo mismatch",
        "spike" => "reversal spike",
        "cyclic" => "cyclic error",
        other => other,
    };
    format!("{words} {axis}").trim_end().to_owned()
}

pub(super) fn columns_of(all: &DMatrix<f64>) -> Vec<DVector<f64>> {
    all.column_iter().map(nalgebra::Matrix::into_owned).collect()
}

fn residual(j: &DMatrix<f64>, y: &DVector<f64>) -> DVector<f64> {
    y - j * DeterminedDirections::by(j).solve(y)
}
