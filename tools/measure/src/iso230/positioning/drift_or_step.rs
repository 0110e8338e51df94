//! Drift or step that all approaches of a positioning run share over time.
//!
//! Candidates are compared by likelihood with Schwarz's criterion. A drift over time is a straight line or a
//! warm-up, each optionally growing along the axis, or a parabola. A step has a size and a row.

use super::{AxisRun, TargetResult, largest, mean_of, repeatability, targets};
use crate::iso230::{CHANCE, STEP_SIDE, is_alike};
use rtec_least_squares::{dot, solve};
use rtec_model::record::Role;
use serde::{Serialize, Serializer};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Time constants of a warm-up that are tried, as shares of the run.
const WARM_UPS: [f64; 6] = [0.05, 0.1, 0.2, 0.4, 0.8, 1.6];

/// Smallest share of a column that the one before it must not explain.
const LEAST_SHARE: f64 = 3e-5;

/// Figures that are also given without a drift or a step.
pub(super) const UNCHANGED: [&str; 5] = ["R", "R_up", "R_down", "B", "B_mean"];

/// The figures of [`UNCHANGED`] without a drift or a step.
type Unchanged = [Option<f64>; 5];

/// A drift of all targets together, in the unit of the figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SharedDrift {
    /// Change from the first row to the last, at the middle of the travel.
    pub drift: f64,
    /// Probability of a drift of this size by chance.
    pub p_value: f64,
    /// `R`, `R_up`, `R_down`, `B` and `B_mean` without it, where they exist.
    #[serde(flatten, serialize_with = "about_drift")]
    pub without: Unchanged,
}

/// A step of all targets together, in the unit of the figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SharedStep {
    /// The first row after it, from 1, in the file.
    pub row: usize,
    /// The cycle of that row.
    pub cycle: usize,
    /// Its size.
    pub step: f64,
    /// Standard error of its size.
    pub standard_error: f64,
    /// Probability of a step of this size at any row by chance.
    pub p_value: f64,
    /// `R`, `R_up`, `R_down`, `B` and `B_mean` without it, where they exist.
    #[serde(flatten, serialize_with = "about_step")]
    pub without: Unchanged,
}

fn about_drift<S: Serializer>(without: &Unchanged, to: S) -> Result<S::Ok, S::Error> {
    about("drift", without, to)
}

fn about_step<S: Serializer>(without: &Unchanged, to: S) -> Result<S::Ok, S::Error> {
    about("step", without, to)
}

fn about<S: Serializer>(change: &str, without: &Unchanged, to: S) -> Result<S::Ok, S::Error> {
    to.collect_map(UNCHANGED.iter().zip(without).map(|(symbol, v)| (format!("{symbol}_about_{change}"), v)))
}

/// A change over time that all approaches share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum DriftOrStep {
    Drift(SharedDrift),
    Step(SharedStep),
}

/// A shape over the rows that may explain the differences of repeats.
struct CandidateChange {
    /// One column, or a second one that grows along the axis.
    columns: Vec<Vec<f64>>,
    /// Number of non-linear parameters: a time constant, a row.
    sought: usize,
    /// Number of values of those that were tried.
    tried: usize,
    /// The row at which it steps.
    step_at: Option<usize>,
    /// Whether it is a parabola: its second column is the square of its first.
    bends: bool,
}

/// A fitted shape: its factors and the residual sum of squares.
struct FittedChange {
    shape: CandidateChange,
    factors: Vec<f64>,
    left: f64,
    /// Standard deviation of the first factor for noise of variance 1.
    standard_deviation: f64,
    /// Whether neighbouring residuals are alike: then it is no step.
    is_alike: bool,
}

impl FittedChange {
    fn parameters(&self) -> usize {
        self.shape.columns.len() + self.shape.sought
    }

    /// A message about a drift that turns back.
    fn bend_note(&self, time: &[f64], unit: &str, without: &str, number: impl Fn(usize) -> usize) -> String {
        let [slope, bend] = [self.factors[0], self.factors[1]];
        let turn = (-0.5 * slope / bend).clamp(0.0, 1.0);
        let farthest = slope * turn + bend * turn * turn;
        let until = time[0] + turn * (time[time.len() - 1] - time[0]);
        let row = time.iter().position(|t| *t >= until).unwrap_or(time.len() - 1);
        let way = if turn > 0.0 && turn < 1.0 {
            let (row, at_last) = (number(row), slope + bend);
            format!("{farthest:+.2} {unit} up to row {row} and to {at_last:+.2} {unit} at the last")
        } else {
            format!("{:+.2} {unit} from first to last", slope + bend)
        };
        format!(
            "the approaches drift by {way}, and the figures hold that drift; about it {without}. Let the machine and its hall come \
             to rest, and test again"
        )
    }

    /// Schwarz's criterion for this number of rows; less is better.
    fn criterion(&self, rows: f64, least: f64) -> f64 {
        rows * self.left.max(least).ln() + self.parameters() as f64 * rows.ln()
    }
}

/// What columns times these factors leave of `y`.
fn residual(y: &[f64], columns: &[Vec<f64>], factors: &[f64]) -> Vec<f64> {
    let explained = |row: usize| columns.iter().zip(factors).map(|(c, f)| c[row] * f).sum::<f64>();
    y.iter().enumerate().map(|(row, v)| v - explained(row)).collect()
}

/// Rows of one target and side, and values within them.
struct RepeatGroups {
    groups: Vec<Vec<usize>>,
    rows: usize,
}

impl RepeatGroups {
    /// Each value less the mean of its group; 0 for rows without a group.
    fn within(&self, values: &[f64]) -> Vec<f64> {
        let mut all = vec![0.0; self.rows];
        for group in &self.groups {
            let mean = group.iter().map(|r| values[*r]).sum::<f64>() / group.len() as f64;
            for row in group {
                all[*row] = values[*row] - mean;
            }
        }
        all
    }

    /// Least-squares fit to the differences of repeats (`y`).
    /// `None` if a column is zero or the columns are equal.
    fn fit(&self, shape: CandidateChange, y: &[f64]) -> Option<FittedChange> {
        let columns: Vec<Vec<f64>> = shape.columns.iter().map(|c| self.within(c)).collect();
        let found = solve(&columns, y).ok()?;
        if found.independent.iter().any(|share| *share <= LEAST_SHARE) {
            return None;
        }
        let (left, is_alike) = (found.left(), self.is_alike(&found.residual));
        let standard_deviation = found.spread()[0];
        Some(FittedChange { shape, factors: found.values, left, standard_deviation, is_alike })
    }

    /// Whether consecutive residuals are more alike than chance makes them.
    fn is_alike(&self, residual: &[f64]) -> bool {
        let mut rows: Vec<usize> = self.groups.iter().flatten().copied().collect();
        rows.sort_unstable();
        let own: Vec<f64> = rows.iter().map(|row| residual[*row]).collect();
        let squares: f64 = own.iter().map(|r| r * r).sum();
        let pairs: f64 = own.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
        squares > 0.0 && is_alike(pairs / squares, own.len())
    }

    /// The step that explains most of `y`.
    fn best_step(&self, y: &[f64]) -> Option<CandidateChange> {
        let mut group_of = vec![None; self.rows];
        for (g, rows) in self.groups.iter().enumerate() {
            for row in rows {
                group_of[*row] = Some(g);
            }
        }
        // Rows after the step, per group: their change of the column's square and of its product with y.
        let mut behind = vec![0_usize; self.groups.len()];
        let (mut square, mut product, mut used) = (0.0, 0.0, 0);
        let (mut best, mut tried) = (None, 0);
        let all = group_of.iter().flatten().count();
        for row in (0..self.rows).rev() {
            let Some(g) = group_of[row] else { continue };
            let size = self.groups[g].len() as f64;
            let of = |n: usize| n as f64 * (1.0 - n as f64 / size);
            square += of(behind[g] + 1) - of(behind[g]);
            behind[g] += 1;
            product += y[row];
            used += 1;
            if used < STEP_SIDE || all - used < STEP_SIDE || square <= 1e-9 {
                continue;
            }
            tried += 1;
            let explains = product * product / square;
            if best.is_none_or(|(_, most)| explains > most) {
                best = Some((row, explains));
            }
        }
        let (at, _) = best?;
        let column = (0..self.rows).map(|row| f64::from(row >= at)).collect();
        Some(CandidateChange { columns: vec![column], sought: 1, tried, step_at: Some(at), bends: false })
    }
}

impl AxisRun<'_> {
    /// The common drift or step of all approaches; R, B and mean B without it.
    /// It is reported if chance gives it in less than one of a hundred runs. `with` are the figures of
    /// [`UNCHANGED`] including it. It is removed row by row, because within a cycle the downward approaches
    /// come later than the upward ones.
    pub(super) fn change(&mut self, with: [Option<f64>; 5], unit: &str) -> Option<DriftOrStep> {
        let n = self.error.len();
        let rows: Vec<f64> = (0..n).map(|row| row as f64).collect();
        let time = self.record.data(&Role::Time).unwrap_or(&rows);
        let span = time.last()? - time.first()?;
        let middle = self.position.iter().sum::<f64>() / n as f64;
        let reach = self.position.iter().map(|p| (p - middle).abs()).fold(0.0, f64::max);
        if span <= 0.0 || reach <= 0.0 {
            return None;
        }
        let repeats = self.repeats();
        let used: usize = repeats.groups.iter().map(Vec::len).sum();
        let y = repeats.within(&self.error);
        let shapes = self.shapes(time, [middle, reach], repeats.best_step(&y));
        let before = dot(&y, &y);
        // Rounding to a step q leaves a variance of at least q²/12 per reading.
        let rounding = crate::gauge_resolution::step_of(&self.error).map_or(0.0, |q| q * q / 12.0);
        let least = (1e-12 * before).max(used as f64 * rounding).max(f64::MIN_POSITIVE);
        let better = |f: &FittedChange| f.criterion(used as f64, least);
        let fitted = shapes.into_iter().filter_map(|shape| repeats.fit(shape, &y));
        let fitted = fitted.filter(|f| f.shape.step_at.is_none() || f.left <= 1e-12 * before || !f.is_alike);
        let best = fitted.min_by(|a, b| better(a).total_cmp(&better(b)))?;
        let freedom = used.checked_sub(repeats.groups.len() + best.parameters()).filter(|f| *f > 0)? as f64;
        let columns = best.shape.columns.len() as f64;
        let variance = best.left.max(least) / freedom;
        let ratio = (before - best.left) / columns / variance;
        let p_value =
            (FisherSnedecor::new(columns, freedom).ok()?.sf(ratio) * best.shape.tried as f64).min(1.0);
        if p_value >= CHANCE || before <= 0.0 {
            return None;
        }
        let reduced = residual(&self.error, &best.shape.columns, &best.factors);
        // The parameters reduced the degrees of freedom.
        let lost = ((used - repeats.groups.len()) as f64 / freedom).sqrt();
        let about = |t: &TargetResult| repeatability(t.reversal, [t.s_up, t.s_down].map(|s| Some(s? * lost)));
        let list: Vec<TargetResult> = self.list_of(&reduced).iter().map(|t| t.counted(false)).collect();
        let reversals: Vec<f64> = list.iter().filter_map(|t| t.reversal).collect();
        let both_ways = largest(list.iter().filter_map(about));
        let one_way = |s: fn(&TargetResult) -> Option<f64>| {
            largest(list.iter().filter_map(|t| Some(4.0 * s(t)? * lost)))
        };
        let reversal = largest(reversals.iter().map(|b| b.abs()));
        let one_way = [one_way(|t| t.s_up), one_way(|t| t.s_down)];
        let values = [both_ways, one_way[0], one_way[1], reversal, mean_of(&reversals)];
        let figures = UNCHANGED.into_iter().zip(values).zip(with);
        // With approaches from both sides R includes R_up and R_down.
        let figures = figures.filter(|((symbol, _), _)| !symbol.starts_with("R_") || both_ways.is_none());
        let words = |((s, without), with): ((&str, Option<f64>), Option<f64>)| {
            Some(format!("{s} {:.2} instead of {:.2} {unit}", without?, with?))
        };
        let without = figures.filter_map(words).collect::<Vec<_>>().join(", ");
        let size = if best.shape.bends { best.factors[0] + best.factors[1] } else { best.factors[0] };
        Some(match best.shape.step_at {
            None => {
                if best.shape.bends && !without.is_empty() {
                    let note = best.bend_note(time, unit, &without, |row| self.record.row_number(row));
                    self.notes.push(note);
                } else if !without.is_empty() {
                    self.notes.push(format!(
                        "the approaches drift by {size:+.2} {unit} from first to last in the middle of the travel ({:+.2} more at its \
                         upper end), and the figures hold that drift; about it {without}. Let the machine warm up, or test it again",
                        best.factors[1],
                    ));
                }
                DriftOrStep::Drift(SharedDrift { drift: size, p_value, without: values })
            }
            Some(at) => {
                let (row, cycle) = (self.record.row_number(at), self.cycle(&repeats, at));
                let standard_error = variance.sqrt() * best.standard_deviation;
                if !without.is_empty() {
                    self.notes.push(format!(
                        "the approaches step by {size:+.2} ± {standard_error:.2} {unit} at row {row} (cycle {cycle}) and stay, and the \
                         figures hold that step; without it {without}. A step is no drift: look for what moved there (mirror, \
                         gauge, workpiece, lost counts), and test again"
                    ));
                }
                DriftOrStep::Step(SharedStep {
                    row,
                    cycle,
                    step: size,
                    standard_error,
                    p_value,
                    without: values,
                })
            }
        })
    }

    /// Shapes over time that may explain the differences of repeats.
    /// `middle` and `reach` are those of the positions, mm.
    fn shapes(
        &self,
        time: &[f64],
        [middle, reach]: [f64; 2],
        step: Option<CandidateChange>,
    ) -> Vec<CandidateChange> {
        let span = time[time.len() - 1] - time[0];
        let over_time = |of: &dyn Fn(f64) -> f64, sought: usize, tried: usize| {
            let own: Vec<f64> = time.iter().map(|t| of((t - time[0]) / span)).collect();
            let grows = own.iter().zip(self.position).map(|(v, p)| v * (p - middle) / reach).collect();
            CandidateChange { columns: vec![own, grows], sought, tried, step_at: None, bends: false }
        };
        let warm_up = |share: f64| {
            let at_end = 1.0 - (-1.0 / share).exp();
            over_time(&|m| (1.0 - (-m / share).exp()) / at_end, 1, WARM_UPS.len())
        };
        let mut shapes = vec![over_time(&|m| m, 0, 1)];
        shapes.extend(WARM_UPS.map(warm_up));
        // A drift that turns back, as in a hall that warms and cools.
        let moment: Vec<f64> = time.iter().map(|t| (t - time[0]) / span).collect();
        let columns = vec![moment.clone(), moment.iter().map(|m| m * m).collect()];
        shapes.push(CandidateChange { columns, sought: 0, tried: 1, step_at: None, bends: true });
        shapes.extend(step);
        shapes
    }

    /// The rows of each target and side that was approached more than once.
    fn repeats(&self) -> RepeatGroups {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for rows in targets(self.position) {
            let moving = rows.into_iter().filter(|r| self.direction[*r] != 0.0);
            let (up, down): (Vec<_>, Vec<_>) = moving.partition(|r| self.direction[*r] > 0.0);
            groups.extend([up, down].into_iter().filter(|g| g.len() > 1));
        }
        RepeatGroups { groups, rows: self.error.len() }
    }

    /// Cycle of a row: the record's own, or its approach's number at target and side.
    fn cycle(&self, repeats: &RepeatGroups, row: usize) -> usize {
        if let Some(own) = self.record.data(&Role::Cycle) {
            return own[row].round().max(0.0) as usize;
        }
        let place = repeats.groups.iter().find_map(|g| g.iter().position(|r| *r == row));
        place.map_or(1, |place| place + 1)
    }
}
