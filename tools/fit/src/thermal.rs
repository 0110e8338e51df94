//! Sensor selection (CASC) and the fit of equation 1 of WO 97/43703, with a lag where it earns its place.
//!
//! Growth is fitted as a constant plus terms of temperature differences: to the environment, between sensors, their
//! squares, each either as measured or passed through a first-order lag. Which terms: the best single difference
//! first, then the next best while R improves by more than 1 %, at most five rounds (the patent's rule). *Best* is
//! judged by blocked cross-validation in time, never by the fit itself: sixteen sensors that warm together fit any
//! stretch of the past in hundreds of ways. Where cross-validation cannot choose either, physics does: heat flows
//! from its source outwards and growth follows, so the difference that leads the growth most (that needs the longest
//! lag) is nearest to the cause, and one that runs beside it is not; the first difference has the sign of the hottest
//! body's, any difference to the environment keeps the sign of its own correlation, and no gain is beyond what the
//! dictionary holds plausible.
//!
//! The 95 % interval of a row is √(h² + x²): h from what the worst of the blocks left, and x for what the fit cannot know there: a
//! difference beyond the range it was fitted on (held at the bound, so that gain · excess is left out), any difference,
//! chosen or not, beyond the range it was seen in, and, just after a start, how far the lagged difference was from
//! equilibrium (fading with its lag).

use nalgebra::{DMatrix, DVector};
use rtec_files::InputError;
use rtec_measure::iso230::correlation;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::date;
use rtec_model::effect::laws::{coolant, offset, spindle_speed, thermal_growth, thermal_lag};
use rtec_model::effect::{Against, Dictionary, Difference, Effect, Heat, Lag, ValueError};
use rtec_model::machine::{FitNote, Machine, Provenance, Source, Validity, unknown_um};
use rtec_model::record::{Axis, Column, Record, Role};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Two sensors of a higher autocorrelation watch the same source of heat (WO 97/43703, "0.97 was selected").
pub const REDUNDANT: f64 = 0.97;
/// The refit goes on while R improves by more than this.
pub const R_GAIN: f64 = 0.01;
/// Rounds of the refit; more were seldom needed (WO 97/43703).
pub const ROUNDS: usize = 5;
/// Rows that the search sees at most: neighbours in time are averaged, temperatures change slowly.
const BINS: usize = 512;
/// Lags tried, from one minute on, each this much longer than the one before.
const LAG_STEP: f64 = 1.15;
/// Of the lags, those that the screening of candidates looks at: every so many.
const SCREEN_LAGS: usize = 4;
/// Candidates that pass the screening of a round.
const SCREENED: usize = 12;
/// Sensors that a model may read, the environment's among them ("the final number may generally be only 4 or 5").
const SENSORS: usize = 5;
/// A difference may be believed so far beyond what was seen, as a share of its range; further out it is held.
const BEYOND: f64 = 0.1;

/// What to fit and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// Differences to choose from; empty for all sensors. A sensor without `minus` is taken against the environment.
    pub sensors: Vec<Difference>,
    /// The sensor of the environment; the coldest on average where it is not given.
    pub environment: Option<String>,
    /// Blocks of the cross-validation.
    pub folds: usize,
    /// Offer lags.
    pub lag: bool,
    /// Offer squares.
    pub square: bool,
    /// What is known already: its effects are kept, and the rest is fitted.
    pub base: Option<Machine>,
    /// The date that the model will carry, days since 1970-01-01.
    pub date: i64,
    /// Days that it may be used for without being looked at again.
    pub valid_days: i64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            sensors: Vec::new(),
            environment: None,
            folds: 10,
            lag: true,
            square: true,
            base: None,
            date: 0,
            valid_days: 365,
        }
    }
}

impl Options {
    /// Differences that the base has an effect of on this response already: sensor and the one taken off.
    fn base_differences(&self, response: &Role) -> Vec<(String, Option<String>)> {
        let own = |e: &&Effect| e.description().heat == Heat::Growth;
        let of = |e: &Effect| {
            let d = e.delta.as_ref().filter(|_| e.axes().first() == response.axis())?;
            let minus = match &d.against {
                Against::Sensor(m) => Some(m.clone()),
                _ => None,
            };
            Some((d.sensor.clone(), minus))
        };
        self.base.iter().flat_map(Machine::effects).filter(own).filter_map(of).collect()
    }

    /// The base has an effect of this name.
    fn base_has(&self, name: &str) -> bool {
        self.base.as_ref().is_some_and(|m| m.effects().any(|e| e.name() == name))
    }
}

/// A sensor or pair with its correlation to the response.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Ranked {
    /// The sensor, or pair as `T8-T18`.
    pub sensor: String,
    /// γ: correlation of the difference with the response, as the patent has it.
    pub gamma: f64,
    /// γ of the lagged difference, where a lag earned its place.
    pub gamma_lagged: f64,
    /// That lag, s; 0 for none.
    pub tau_s: f64,
    /// Range of the sensor, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
    /// RMS of blocked cross-validation with this difference alone, µm.
    pub cv_rms_um: f64,
}

/// A sensor left out because another one watches the same source.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Dropped {
    /// The sensor.
    pub sensor: String,
    /// α: its autocorrelation with the one kept.
    pub alpha: f64,
    /// The one kept.
    pub with: String,
    /// Its own γ.
    pub gamma: f64,
    /// γ of its lagged difference.
    pub gamma_lagged: f64,
    /// Range of the sensor, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
}

/// One round of the refit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Round {
    /// What it added; after the rounds of the refit, what it put in the place of what.
    pub added: String,
    /// R after it.
    #[serde(rename = "R")]
    pub r: f64,
    /// RMS of blocked cross-validation after it, µm.
    pub cv_rms_um: f64,
}

/// A parameter with its 95 % interval (delete-one-block jackknife).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// An effect of the fitted model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fitted {
    /// `thermal_lag.z`
    pub name: String,
    /// The sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// The one taken off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minus: Option<String>,
    /// Its parameters.
    pub parameters: BTreeMap<String, Estimate>,
}

impl Fitted {
    pub(crate) fn of(effect: &Effect, interval: &Intervals) -> Self {
        let minus = effect.delta.as_ref().and_then(|d| match &d.against {
            Against::Sensor(m) => Some(m.clone()),
            _ => None,
        });
        let parameter = |(i, p): (usize, &rtec_model::effect::Parameter)| {
            let value = effect.scalar(i);
            let [low, high] = interval.get(&p.name).map_or([value, value], |v| v[0]);
            (p.name.clone(), Estimate { value, low, high })
        };
        Self {
            name: effect.name(),
            sensor: effect.delta.as_ref().map(|d| d.sensor.clone()),
            minus,
            parameters: effect.description().parameters.iter().enumerate().map(parameter).collect(),
        }
    }
}

/// RMS of what is left, µm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rms {
    /// On the data of the fit.
    pub train: f64,
    /// On every block, structure and parameters chosen without it.
    pub folds: Vec<f64>,
    /// Their mean.
    pub folds_mean: f64,
    /// On every hold-out.
    pub holdout: Vec<f64>,
}

/// The 95 % prediction interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Interval {
    /// Half width where the model knows most, µm; wider after a start and beyond the range of the fit.
    pub half_width_um: f64,
    /// Share of the rows inside, each block judged by the others' width.
    pub coverage_folds: f64,
    /// Share of the rows inside on every hold-out.
    pub coverage_holdout: Vec<f64>,
    /// Mean half width over the rows of every hold-out, µm.
    pub mean_half_width_holdout_um: Vec<f64>,
}

/// The same structure fitted on dry and on wet rows alone, as the patent compares them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DryWet {
    /// Growth per kelvin, dry, by term.
    pub dry: BTreeMap<String, f64>,
    /// The same wet.
    pub wet: BTreeMap<String, f64>,
    /// Range of the growth on the dry rows, µm.
    pub growth_dry_um: f64,
    /// The same on the wet rows.
    pub growth_wet_um: f64,
    /// RMS of the dry model on the wet rows, µm: what it costs to model dry and cut wet.
    pub dry_model_on_wet_rms_um: f64,
    /// RMS of the wet model on the wet rows, µm.
    pub wet_model_on_wet_rms_um: f64,
}

/// What the fit of one response found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// `error.z`
    pub response: String,
    /// The sensor of the environment.
    pub environment: Option<String>,
    /// How it was found.
    pub environment_by: String,
    /// Sensors kept, best first.
    pub kept: Vec<Ranked>,
    /// Sensors left out as redundant.
    pub dropped: Vec<Dropped>,
    /// The best pairs, best first.
    pub pairs: Vec<Ranked>,
    /// The refit, round by round.
    pub rounds: Vec<Round>,
    /// First sensors that the data cannot tell from the one chosen.
    pub alternatives: Vec<Ranked>,
    /// The fitted effects.
    pub effects: Vec<Fitted>,
    /// RMS of what is left.
    pub rms_um: Rms,
    /// RMS of what simpler predictions leave on the same blocks (mean) and hold-outs.
    pub baselines: BTreeMap<String, Rms>,
    /// The prediction interval.
    pub interval95: Interval,
    /// Dry against wet, where the data have both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dry_wet: Option<DryWet>,
    /// What to know before trusting it.
    pub warnings: Vec<String>,
}

/// A model term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Term {
    /// Difference of two sensors (or one and the reference) at a lag of the grid, maybe squared.
    Thermal { sensor: usize, minus: Option<usize>, lag: usize, square: bool },
    /// Coolant on.
    Coolant,
    /// Spindle speed, krpm.
    Speed,
}

/// All rows of the training records, ready for the search.
struct Problem {
    sensors: Vec<String>,
    environment: Option<usize>,
    /// Offered: (sensor, minus).
    offered: Vec<(usize, Option<usize>)>,
    /// Pairs offered beside them from the second term on.
    pairs: Vec<(usize, Option<usize>)>,
    /// Largest gains that are plausible, µm/K and µm/K².
    plausible: [f64; 2],
    explicit: bool,
    taus: Vec<f64>,
    /// Per sensor and lag: one value per bin.
    binned: Vec<Vec<Vec<f64>>>,
    y: Vec<f64>,
    weight: Vec<f64>,
    fold: Vec<usize>,
    folds: usize,
    coolant: Option<Vec<f64>>,
    speed: Option<Vec<f64>>,
    square: bool,
}

/// Largest gains that the dictionary holds plausible, µm/K and µm/K².
fn plausible_gains() -> [f64; 2] {
    Dictionary::default().effect(&format!("{}.x", thermal_growth::NAME)).map_or([f64::INFINITY; 2], |e| {
        let bound = |i: usize| e.description().parameters[i].plausible[1];
        [bound(0), bound(1)]
    })
}

/// All records have the response and the first one's sensors.
fn check_columns(records: &[&Record], sensors: &[String], response: &Role) -> Result<(), InputError> {
    if sensors.is_empty() {
        return Err(InputError::whole(&records[0].path, "no temperature", "columns of role temperature"));
    }
    for r in records {
        if let Some(s) = sensors.iter().find(|s| r.temperature(s).is_none()) {
            return Err(InputError::whole(&r.path, format!("no sensor {s}"), "the first record's sensors"));
        }
        if r.data(response).is_none() {
            return Err(InputError::whole(&r.path, format!("no {response}"), "the first record's responses"));
        }
    }
    Ok(())
}

/// No lag, then lags from one minute to a third of the longest record, in equal ratios.
fn lag_grid(records: &[&Record], offered: bool) -> Vec<f64> {
    let span = records.iter().map(|r| r.time_s()[r.rows() - 1] - r.time_s()[0]).fold(0.0, f64::max);
    let timed = records.iter().all(|r| r.column(&Role::Time).is_some());
    let lags =
        std::iter::successors(Some(60.0), |tau| Some(tau * LAG_STEP)).take_while(|tau| *tau <= span / 3.0);
    let none = std::iter::once(0.0);
    if offered && timed { none.chain(lags).collect() } else { none.collect() }
}

/// The environment is the coldest body of a machine that makes heat; of those within 1 K of the coldest it is the one
/// that moves fastest: air, not a casting that follows it.
fn environment_of(sensors: &[String], records: &[&Record]) -> usize {
    let of = |s: &String| {
        let (mut sum, mut n, mut moves) = (0.0, 0.0, 0.0);
        for t in records.iter().filter_map(|r| r.temperature(s)) {
            sum += t.iter().sum::<f64>();
            n += t.len() as f64;
            moves += t.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>();
        }
        (sum / n, moves)
    };
    let all: Vec<(f64, f64)> = sensors.iter().map(of).collect();
    let coldest = all.iter().map(|a| a.0).fold(f64::INFINITY, f64::min);
    let near = (0..all.len()).filter(|i| all[*i].0 <= coldest + 1.0);
    near.max_by(|a, b| all[*a].1.total_cmp(&all[*b].1)).unwrap_or(0)
}

/// Rows by record in bins of so many, which never cross records; folds are stretches of bins.
fn bins_of(records: &[&Record], per_bin: usize) -> Vec<(usize, std::ops::Range<usize>)> {
    let mut bins = Vec::new();
    for (n, r) in records.iter().enumerate() {
        let starts = (0..r.rows()).step_by(per_bin);
        bins.extend(starts.map(|at| (n, at..(at + per_bin).min(r.rows()))));
    }
    bins
}

/// A structure with its cross-validation.
#[derive(Debug, Clone)]
struct Judged {
    terms: Vec<Term>,
    /// Mean square per fold.
    mse: Vec<f64>,
    r: f64,
    /// Constant, then one coefficient per term.
    coefficients: Vec<f64>,
}

impl Judged {
    /// Root of the mean over the folds.
    fn rms(&self) -> f64 {
        (self.mse.iter().sum::<f64>() / self.mse.len() as f64).sqrt()
    }

    /// This one is better than `other` by more than the standard error of the difference over the folds.
    fn beats(&self, other: &Self) -> bool {
        let d: Vec<f64> = other.mse.iter().zip(&self.mse).map(|(o, s)| o - s).collect();
        let n = d.len() as f64;
        let mean = d.iter().sum::<f64>() / n;
        let var = d.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        mean > (var / n).sqrt()
    }
}

fn lagged(t: &[f64], u: &[f64], tau_s: f64) -> Vec<f64> {
    let mut lag = Lag::new(tau_s);
    t.iter().zip(u).map(|(t, u)| lag.next(*t, *u)).collect()
}

impl Problem {
    fn new(records: &[&Record], response: &Role, options: &Options) -> Result<Self, InputError> {
        let first = records[0];
        let sensors: Vec<String> = first.names(&Role::Temperature).map(str::to_owned).collect();
        let place = |name: &str| {
            sensors.iter().position(|s| s == name).ok_or_else(|| {
                let has = sensors.join(", ");
                InputError::whole(&first.path, format!("no sensor {name}"), format!("one of {has}"))
            })
        };
        check_columns(records, &sensors, response)?;
        let environment = match &options.environment {
            Some(name) => Some(place(name)?),
            None if sensors.len() < 2 => None,
            None => Some(environment_of(&sensors, records)),
        };
        let mut offered: Vec<(usize, Option<usize>)> = Vec::new();
        for d in &options.sensors {
            let s = place(&d.sensor)?;
            offered.push(match &d.against {
                Against::Sensor(m) => (s, Some(place(m)?)),
                _ => (s, environment.filter(|e| *e != s)),
            });
        }
        let explicit = !offered.is_empty();
        if !explicit {
            offered =
                (0..sensors.len()).filter(|s| Some(*s) != environment).map(|s| (s, environment)).collect();
        }
        let known = options.base_differences(response);
        let is_new = |(s, m): &(usize, Option<usize>)| {
            let m = m.map(|m| sensors[m].as_str());
            !known.iter().any(|k| (k.0.as_str(), k.1.as_deref()) == (sensors[*s].as_str(), m))
        };
        offered.retain(is_new);
        let mut pairs = Vec::new();
        if !explicit {
            let others: Vec<usize> = (0..sensors.len()).filter(|s| Some(*s) != environment).collect();
            for (i, a) in others.iter().enumerate() {
                pairs.extend(others[i + 1..].iter().map(|b| (*a, Some(*b))));
            }
            pairs.retain(is_new);
        }
        let rows: usize = records.iter().map(|r| r.rows()).sum();
        if rows < 4 * options.folds || options.folds < 3 {
            let expected = format!("at least {} (four per fold, three folds)", 4 * options.folds.max(3));
            return Err(InputError::whole(&first.path, format!("{rows} rows"), expected));
        }
        let taus = lag_grid(records, options.lag);
        let bins = bins_of(records, rows.div_ceil(BINS));
        let average = |of: &dyn Fn(usize) -> Vec<f64>| -> Vec<f64> {
            let data: Vec<Vec<f64>> = (0..records.len()).map(of).collect();
            bins.iter().map(|(n, b)| data[*n][b.clone()].iter().sum::<f64>() / b.len() as f64).collect()
        };
        let column = |n: usize, role: &Role| {
            records[n].data(role).map_or_else(|| vec![0.0; records[n].rows()], <[f64]>::to_vec)
        };
        let binned = sensors
            .iter()
            .map(|s| {
                let of = |tau: f64| {
                    average(&|n| {
                        let u = records[n].temperature(s).unwrap_or_default();
                        if tau > 0.0 { lagged(records[n].time_s(), u, tau) } else { u.to_vec() }
                    })
                };
                taus.iter().map(|tau| of(*tau)).collect()
            })
            .collect();
        // A dry run that logs no coolant is dry; one that logs no speed may have had any.
        let everywhere =
            |role: &Role| *role == Role::Coolant || records.iter().all(|r| r.column(role).is_some());
        let varies = |v: &Vec<f64>| v.iter().any(|x| (x - v[0]).abs() > 1e-9);
        let optional = |role: Role, effect: &str, of: fn(f64) -> f64| {
            let all = everywhere(&role).then(|| average(&|n| column(n, &role).into_iter().map(of).collect()));
            let axis = response.axis().map_or("", Axis::as_str);
            let known = options.base_has(&format!("{effect}.{axis}"));
            all.filter(|v| varies(v) && !explicit && !known)
        };
        let fold = (0..bins.len()).map(|i| i * options.folds / bins.len()).collect();
        Ok(Self {
            y: average(&|n| column(n, response)),
            weight: bins.iter().map(|(_, b)| b.len() as f64).collect(),
            coolant: optional(Role::Coolant, "coolant", |v| f64::from(v > 0.5)),
            speed: optional(Role::SpindleSpeed, "spindle_speed", |v| v / 1000.0),
            fold,
            folds: options.folds,
            square: options.square,
            sensors,
            environment,
            offered,
            pairs,
            plausible: plausible_gains(),
            explicit,
            taus,
            binned,
        })
    }

    fn column(&self, term: Term) -> Vec<f64> {
        match term {
            Term::Coolant => self.coolant.clone().unwrap_or_default(),
            Term::Speed => self.speed.clone().unwrap_or_default(),
            Term::Thermal { sensor, minus, lag, square } => {
                let u = &self.binned[sensor][lag];
                let d = |i: usize| {
                    u[i] - minus.map_or(rtec_model::effect::STANDARD_DEGC, |m| self.binned[m][lag][i])
                };
                (0..u.len()).map(|i| if square { d(i) * d(i) } else { d(i) }).collect()
            }
        }
    }

    /// Fits the terms on the given folds and judges them by leaving out each in turn; `None` when the columns are
    /// dependent.
    fn judge(&self, terms: &[Term], folds: &[usize]) -> Option<Judged> {
        let columns: Vec<Vec<f64>> = terms.iter().map(|t| self.column(*t)).collect();
        self.judge_columns(terms, &columns, folds)
    }

    fn judge_columns(&self, terms: &[Term], columns: &[Vec<f64>], folds: &[usize]) -> Option<Judged> {
        let p = columns.len() + 2;
        let rows: Vec<usize> = (0..self.y.len()).filter(|i| folds.contains(&self.fold[*i])).collect();
        // Means are taken off and scales made one, so that the normal equations keep their digits.
        let total: f64 = rows.iter().map(|i| self.weight[*i]).sum();
        let mut mean = vec![0.0; p];
        let mut scale = vec![1.0; p];
        for j in 1..p {
            let v = if j + 1 == p { &self.y } else { &columns[j - 1] };
            mean[j] = rows.iter().map(|i| self.weight[*i] * v[*i]).sum::<f64>() / total;
            let var = rows.iter().map(|i| self.weight[*i] * (v[*i] - mean[j]).powi(2)).sum::<f64>() / total;
            if var <= 1e-18 {
                return None;
            }
            scale[j] = var.sqrt();
        }
        let mut grams = vec![DMatrix::<f64>::zeros(p, p); self.folds];
        let mut row = vec![1.0; p];
        for &i in &rows {
            for j in 1..p {
                let v = if j + 1 == p { self.y[i] } else { columns[j - 1][i] };
                row[j] = (v - mean[j]) / scale[j];
            }
            let g = &mut grams[self.fold[i]];
            for a in 0..p {
                for b in a..p {
                    g[(a, b)] += self.weight[i] * row[a] * row[b];
                }
            }
        }
        let mut all = DMatrix::<f64>::zeros(p, p);
        for g in &mut grams {
            g.fill_lower_triangle_with_upper_triangle();
            all += &*g;
        }
        let solve = |g: &DMatrix<f64>| {
            let c = g.view((0, 0), (p - 1, p - 1)).into_owned().cholesky()?;
            // Columns that are nearly one another leave a diagonal near zero.
            let least = c.l_dirty().diagonal().iter().map(|d| d * d).fold(f64::INFINITY, f64::min);
            (least > 1e-7 * g[(0, 0)]).then(|| c.solve(&g.view((0, p - 1), (p - 1, 1)).into_owned()))
        };
        let rss = |g: &DMatrix<f64>, c: &DMatrix<f64>| {
            let mut v = DVector::from_element(p, -1.0);
            v.rows_mut(0, p - 1).copy_from(&c.column(0));
            (v.transpose() * g * &v)[(0, 0)].max(0.0) * scale[p - 1] * scale[p - 1]
        };
        let fit = solve(&all)?;
        let mut mse = Vec::with_capacity(folds.len());
        for f in folds {
            let c = solve(&(&all - &grams[*f]))?;
            mse.push(rss(&grams[*f], &c) / grams[*f][(0, 0)].max(1e-300));
        }
        let left = rss(&all, &fit) / (total * scale[p - 1] * scale[p - 1]);
        let mut coefficients: Vec<f64> = (0..p - 1).map(|j| fit[(j, 0)] * scale[p - 1] / scale[j]).collect();
        coefficients[0] = mean[p - 1] + fit[(0, 0)] * scale[p - 1]
            - (1..p - 1).map(|j| coefficients[j] * mean[j]).sum::<f64>();
        Some(Judged { terms: terms.to_vec(), mse, r: (1.0 - left).max(0.0).sqrt(), coefficients })
    }

    fn gamma(&self, term: Term, folds: &[usize]) -> f64 {
        let u = self.column(term);
        let rows = (0..u.len()).filter(|i| folds.contains(&self.fold[*i]));
        let (x, y): (Vec<f64>, Vec<f64>) = rows.map(|i| (u[i], self.y[i])).unzip();
        correlation(&x, &y)
    }

    /// Differences to the environment keep the sign of their own correlation: the sign is known, and a fit that
    /// turns it round lives on collinearity, as one with gains beyond reason does.
    fn physical(&self, judged: &Judged, folds: &[usize]) -> bool {
        judged.terms.iter().zip(&judged.coefficients[1..]).all(|(t, c)| match t {
            Term::Thermal { square: true, .. } => c.abs() <= self.plausible[1],
            Term::Thermal { minus, .. } => {
                c.abs() <= self.plausible[0]
                    && (*minus != self.environment || self.gamma(*t, folds) * c >= 0.0)
            }
            _ => true,
        })
    }

    /// Of the offered, those whose growth goes the way that the hottest body's does: heat comes from there. Where
    /// that body says nothing, all.
    fn driven_by_the_source(&self, singles: Vec<Judged>, folds: &[usize]) -> Vec<Judged> {
        let rows: Vec<usize> = (0..self.y.len()).filter(|i| folds.contains(&self.fold[*i])).collect();
        let warmth = |j: &Judged| {
            let Some((sensor, minus)) = pair_of(j.terms[0]) else { return 0.0 };
            let u = self.column(Term::Thermal { sensor, minus, lag: 0, square: false });
            rows.iter().map(|i| u[*i]).sum::<f64>() / rows.len() as f64
        };
        let hottest = singles.iter().max_by(|a, b| warmth(a).total_cmp(&warmth(b)));
        let way = hottest.map_or(0.0, |j| self.gamma(j.terms[0], folds));
        if self.explicit || way.abs() < 0.5 {
            return singles;
        }
        singles.into_iter().filter(|j| j.coefficients[1] * way > 0.0).collect()
    }

    /// The candidates that explain most of what these terms leave, whatever their lag.
    fn screen(
        &self,
        terms: &[Term],
        candidates: &[(usize, Option<usize>)],
        folds: &[usize],
    ) -> Vec<(usize, Option<usize>)> {
        let rows: Vec<usize> = (0..self.y.len()).filter(|i| folds.contains(&self.fold[*i])).collect();
        let pick = |v: &[f64]| rows.iter().map(|i| v[*i]).collect::<Vec<f64>>();
        let weight = pick(&self.weight);
        let dot =
            |a: &[f64], b: &[f64]| a.iter().zip(b).zip(&weight).map(|((a, b), w)| w * a * b).sum::<f64>();
        // An orthonormal basis of the constant and the terms; what is left of a column beside it.
        let mut basis: Vec<Vec<f64>> = Vec::new();
        let beside = |basis: &[Vec<f64>], mut v: Vec<f64>| {
            for q in basis {
                let c = dot(q, &v);
                v.iter_mut().zip(q).for_each(|(v, q)| *v -= c * q);
            }
            v
        };
        let mut columns = vec![vec![1.0; rows.len()]];
        columns.extend(terms.iter().map(|t| pick(&self.column(*t))));
        for c in columns {
            let c = beside(&basis, c);
            let norm = dot(&c, &c).sqrt();
            if norm > 0.0 {
                basis.push(c.into_iter().map(|v| v / norm).collect());
            }
        }
        let left = beside(&basis, pick(&self.y));
        let score = |(sensor, minus): (usize, Option<usize>)| {
            let lags = (0..self.taus.len()).step_by(SCREEN_LAGS);
            let of = lags.map(|lag| {
                let column = pick(&self.column(Term::Thermal { sensor, minus, lag, square: false }));
                let d = beside(&basis, column);
                let (own, with) = (dot(&d, &d), dot(&d, &left));
                if own > 1e-12 { with * with / own } else { 0.0 }
            });
            of.fold(0.0, f64::max)
        };
        let mut scored: Vec<_> = candidates.iter().map(|c| (*c, score(*c))).collect();
        scored.sort_by(|a, b| b.1.total_cmp(&a.1));
        scored.into_iter().take(SCREENED).map(|(c, _)| c).collect()
    }

    /// Sensors that these terms read.
    fn sensor_count(terms: &[Term]) -> usize {
        let mut read: Vec<usize> =
            terms.iter().filter_map(|t| pair_of(*t)).flat_map(|(s, m)| [Some(s), m]).flatten().collect();
        read.sort_unstable();
        read.dedup();
        read.len()
    }

    /// The lags once more, each with the others held, now that all terms are there.
    fn retune(&self, mut now: Judged, folds: &[usize]) -> Judged {
        for k in 0..now.terms.len() {
            let Term::Thermal { lag: 1.., square: false, .. } = now.terms[k] else { continue };
            let fits =
                (1..self.taus.len()).filter_map(|lag| self.judge(&relagged(&now.terms, k, lag), folds));
            let best = fits.filter(|j| self.physical(j, folds)).min_by(|a, b| a.rms().total_cmp(&b.rms()));
            if let Some(best) = best.filter(|b| b.rms() < now.rms()) {
                now = best;
            }
        }
        now
    }

    /// The best lag of a difference beside the terms that are there; no lag unless it earns its place.
    fn best_lag(
        &self,
        terms: &[Term],
        sensor: usize,
        minus: Option<usize>,
        folds: &[usize],
    ) -> Option<Judged> {
        let mut columns: Vec<Vec<f64>> = terms.iter().map(|t| self.column(*t)).collect();
        let mut at = |lag: usize| {
            let term = Term::Thermal { sensor, minus, lag, square: false };
            if terms.contains(&term) {
                return None;
            }
            columns.push(self.column(term));
            let judged = self.judge_columns(&[terms, &[term]].concat(), &columns, folds);
            columns.pop();
            judged.filter(|j| self.physical(j, folds))
        };
        let without = at(0);
        let with = (1..self.taus.len()).filter_map(&mut at).min_by(|a, b| a.rms().total_cmp(&b.rms()));
        match (without, with) {
            (Some(a), Some(b)) => Some(if b.beats(&a) { b } else { a }),
            (a, b) => a.or(b),
        }
    }

    /// The whole selection on the given folds: the structure, its rounds, the rivals of its first term.
    fn select(&self, folds: &[usize]) -> Option<Selection> {
        let mut singles: Vec<Judged> =
            self.offered.iter().filter_map(|(s, m)| self.best_lag(&[], *s, *m, folds)).collect();
        singles.sort_by(|a, b| a.rms().total_cmp(&b.rms()));
        let sources = self.driven_by_the_source(singles.clone(), folds);
        let best = sources.first()?.clone();
        // What the data cannot tell from the best; of these the one nearest to the source of heat.
        let mut tied: Vec<Judged> = sources.into_iter().filter(|j| !best.beats(j)).collect();
        let lag = |j: &Judged| match j.terms[0] {
            Term::Thermal { lag, .. } => lag,
            _ => 0,
        };
        tied.sort_by_key(|j| std::cmp::Reverse(lag(j)));
        let first = tied.remove(0);
        // CASC: in order of merit, a sensor that watches what a better one watches is left out.
        let mut order = vec![first.clone()];
        order.extend(singles.iter().filter(|j| j.terms != first.terms).cloned());
        let mut kept: Vec<Judged> = Vec::new();
        let mut dropped: Vec<(Judged, f64, usize)> = Vec::new();
        for j in order {
            let column = |j: &Judged| self.column(j.terms[0]);
            let own = column(&j);
            let alphas = kept.iter().enumerate().map(|(k, o)| (k, correlation(&own, &column(o)).abs()));
            match alphas.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, alpha)| *alpha >= REDUNDANT) {
                Some((with, alpha)) => dropped.push((j, alpha, with)),
                None => kept.push(j),
            }
        }
        let mut now = first;
        let mut rounds = vec![now.clone()];
        let mut candidates: Vec<(usize, Option<usize>)> =
            kept.iter().filter_map(|j| pair_of(j.terms[0])).collect();
        candidates.extend(&self.pairs);
        while rounds.len() < ROUNDS {
            let few = |(s, m): &(usize, Option<usize>)| {
                let term = Term::Thermal { sensor: *s, minus: *m, lag: 0, square: false };
                Self::sensor_count(&[now.terms.as_slice(), &[term]].concat()) <= SENSORS
            };
            let offered: Vec<_> = candidates.iter().copied().filter(few).collect();
            let screened = self.screen(&now.terms, &offered, folds);
            let mut next: Vec<Judged> =
                screened.iter().filter_map(|(s, m)| self.best_lag(&now.terms, *s, *m, folds)).collect();
            let mut extra: Vec<Term> = Vec::new();
            if self.coolant.is_some() {
                extra.push(Term::Coolant);
            }
            if self.speed.is_some() {
                extra.push(Term::Speed);
            }
            if self.square {
                extra.extend(now.terms.iter().filter_map(|t| squared(*t)));
            }
            extra.retain(|t| !now.terms.contains(t));
            next.extend(extra.into_iter().filter_map(|t| {
                let judged = self.judge(&[now.terms.as_slice(), &[t]].concat(), folds)?;
                self.physical(&judged, folds).then_some(judged)
            }));
            let Some(best) = next.into_iter().min_by(|a, b| a.rms().total_cmp(&b.rms())) else { break };
            let best = self.retune(best, folds);
            // The patent's rule asks R; the blocks must agree.
            if best.r - now.r <= R_GAIN * now.r || !best.beats(&now) {
                break;
            }
            now = best;
            rounds.push(now.clone());
        }
        // Each term was the best beside those before it: is another one better beside all? (Not of a single term: that
        // one was physics' choice.)
        let mut swaps = Vec::new();
        let mut swapped = now.terms.len() > 1;
        for _ in 0..ROUNDS {
            if !std::mem::take(&mut swapped) {
                break;
            }
            for k in 0..now.terms.len() {
                if pair_of(now.terms[k]).is_none()
                    || squared(now.terms[k]).is_none_or(|q| now.terms.contains(&q))
                {
                    continue;
                }
                let mut rest = now.terms.clone();
                rest.remove(k);
                let screened = self.screen(&rest, &candidates, folds);
                let fits = screened.iter().filter_map(|(s, m)| self.best_lag(&rest, *s, *m, folds));
                let few = fits.filter(|j| Self::sensor_count(&j.terms) <= SENSORS);
                let best = few.min_by(|a, b| a.rms().total_cmp(&b.rms()));
                if let Some(best) = best.filter(|b| b.beats(&now)) {
                    let out = now.terms[k];
                    now = self.retune(best, folds);
                    swapped = true;
                    // The same difference with its lag found anew is no other one.
                    if now.terms.last().and_then(|t| pair_of(*t)) != pair_of(out) {
                        swaps.push((now.clone(), out));
                    }
                }
            }
        }
        Some(Selection { structure: now, rounds, swaps, kept, dropped, tied })
    }

    fn name(&self, term: Term) -> String {
        match term {
            Term::Coolant => "coolant".to_owned(),
            Term::Speed => "spindle_speed".to_owned(),
            Term::Thermal { sensor, minus, lag, square } => {
                let minus = minus.map_or("20".to_owned(), |m| self.sensors[m].clone());
                let lag = if lag > 0 { format!(" lag {:.0} s", self.taus[lag]) } else { String::new() };
                format!("{}-{minus}{lag}{}", self.sensors[sensor], if square { " squared" } else { "" })
            }
        }
    }

    fn ranked(&self, j: &Judged, folds: &[usize]) -> Ranked {
        let Term::Thermal { sensor, minus, lag, .. } = j.terms[j.terms.len() - 1] else {
            unreachable!("only differences are ranked")
        };
        let plain = Term::Thermal { sensor, minus, lag: 0, square: false };
        let t = &self.binned[sensor][0];
        let bound = |f: fn(f64, f64) -> f64| t.iter().copied().fold(t[0], f);
        Ranked {
            sensor: self.name(plain),
            gamma: self.gamma(plain, folds),
            gamma_lagged: self.gamma(Term::Thermal { sensor, minus, lag, square: false }, folds),
            tau_s: self.taus[lag],
            range_k: bound(f64::max) - bound(f64::min),
            cv_rms_um: j.rms(),
        }
    }
}

fn pair_of(term: Term) -> Option<(usize, Option<usize>)> {
    match term {
        Term::Thermal { sensor, minus, .. } => Some((sensor, minus)),
        _ => None,
    }
}

fn squared(term: Term) -> Option<Term> {
    match term {
        Term::Thermal { sensor, minus, lag, square: false } => {
            Some(Term::Thermal { sensor, minus, lag, square: true })
        }
        _ => None,
    }
}

/// The same terms with another lag of the k-th; the square of the same difference shares it.
fn relagged(terms: &[Term], k: usize, other: usize) -> Vec<Term> {
    let Term::Thermal { sensor: s, minus: m, lag: l, .. } = terms[k] else { return terms.to_vec() };
    let of = |t: &Term| match *t {
        Term::Thermal { sensor, minus, lag, square } if (sensor, minus, lag) == (s, m, l) => {
            Term::Thermal { sensor, minus, lag: other, square }
        }
        t => t,
    };
    terms.iter().map(of).collect()
}

struct Selection {
    structure: Judged,
    rounds: Vec<Judged>,
    /// After the rounds: what a term that went out for a better one left, its last term being the new one.
    swaps: Vec<(Judged, Term)>,
    kept: Vec<Judged>,
    /// Sensor, α, and the kept one (by number) it is redundant with.
    dropped: Vec<(Judged, f64, usize)>,
    tied: Vec<Judged>,
}

impl Selection {
    /// The sensors left out, each with the kept one that watches the same.
    fn redundant(&self, ranked: &dyn Fn(&Judged) -> Ranked, kept: &[Ranked]) -> Vec<Dropped> {
        let of = |(j, alpha, with): &(Judged, f64, usize)| {
            let own = ranked(j);
            Dropped {
                sensor: own.sensor,
                alpha: *alpha,
                with: kept[*with].sensor.clone(),
                gamma: own.gamma,
                gamma_lagged: own.gamma_lagged,
                range_k: own.range_k,
            }
        };
        self.dropped.iter().map(of).collect()
    }

    /// Says which sensors the data could not tell from the one chosen.
    fn rivals(&self, problem: &Problem) -> Option<String> {
        let names: Vec<String> = self.tied.iter().map(|j| problem.name(j.terms[0])).collect();
        let chosen = problem.name(self.rounds[0].terms[0]);
        (!names.is_empty()).then(|| {
            let names = names.join(", ");
            format!(
                "the data cannot tell {names} from {chosen}; the one that leads the growth most was taken"
            )
        })
    }
}

/// 1 at the rows of a record at which coolant is on; a record that logs none is dry.
fn wet(record: &Record) -> Vec<f64> {
    let logged = record.data(&Role::Coolant).map(|c| c.iter().map(|v| f64::from(*v > 0.5)).collect());
    logged.unwrap_or_else(|| vec![0.0; record.rows()])
}

/// The columns of a structure at every row of a record.
fn full_columns(problem: &Problem, terms: &[Term], record: &Record) -> Result<Vec<Vec<f64>>, InputError> {
    let lacks =
        |what: String| InputError::whole(&record.path, format!("no {what}"), "what the model was fitted on");
    let sensor = |s: usize, lag: usize| {
        let u = record.temperature(&problem.sensors[s]).ok_or_else(|| lacks(problem.sensors[s].clone()))?;
        let tau = problem.taus[lag];
        Ok::<_, InputError>(if lag > 0 { lagged(record.time_s(), u, tau) } else { u.to_vec() })
    };
    let role = |role: Role, of: fn(f64) -> f64| {
        let data = record.data(&role).ok_or_else(|| lacks(role.to_string()))?;
        Ok::<_, InputError>(data.iter().map(|v| of(*v)).collect::<Vec<f64>>())
    };
    terms
        .iter()
        .map(|t| match *t {
            Term::Coolant => Ok(wet(record)),
            Term::Speed => role(Role::SpindleSpeed, |v| v / 1000.0),
            Term::Thermal { sensor: s, minus, lag, square } => {
                let mut u = sensor(s, lag)?;
                let m = minus.map(|m| sensor(m, lag)).transpose()?;
                for (i, v) in u.iter_mut().enumerate() {
                    *v -= m.as_ref().map_or(rtec_model::effect::STANDARD_DEGC, |m| m[i]);
                    if square {
                        *v *= *v;
                    }
                }
                Ok(u)
            }
        })
        .collect()
}

/// All rows of all records under one another.
struct Rows {
    columns: Vec<Vec<f64>>,
    y: Vec<f64>,
    fold: Vec<usize>,
    /// Time since the start of the row's record, s.
    elapsed_s: Vec<f64>,
}

/// What a fit knows of one difference, and so where it knows less.
struct Guard {
    /// Places of the difference among the columns, and of its square.
    term: usize,
    square: Option<usize>,
    /// Beyond this the difference is held, K.
    range_k: [f64; 2],
    /// How far the lagged difference used to be from the difference itself, RMS, K: what is not known at a start.
    start_k: f64,
    tau_s: f64,
}

impl Rows {
    fn new(
        problem: &Problem,
        terms: &[Term],
        records: &[&Record],
        response: &Role,
    ) -> Result<Self, InputError> {
        let mut columns = vec![Vec::new(); terms.len()];
        let (mut y, mut elapsed_s) = (Vec::new(), Vec::new());
        for r in records {
            for (all, own) in columns.iter_mut().zip(full_columns(problem, terms, r)?) {
                all.extend(own);
            }
            y.extend_from_slice(r.data(response).unwrap_or_default());
            elapsed_s.extend(r.time_s().iter().map(|t| t - r.time_s()[0]));
        }
        let n = y.len();
        let fold = (0..n).map(|i| i * problem.folds / n).collect();
        Ok(Self { columns, y, fold, elapsed_s })
    }

    /// What a fit on the rows that `take` chooses knows of its differences; `plain` has the same terms without lag.
    fn guards(
        &self,
        problem: &Problem,
        terms: &[Term],
        plain: &Self,
        take: &dyn Fn(usize) -> bool,
    ) -> Vec<Guard> {
        let mut found = Vec::new();
        for (k, term) in terms.iter().enumerate() {
            let Term::Thermal { sensor, minus, lag, square: false } = *term else { continue };
            let square = terms.iter().position(|t| *t == Term::Thermal { sensor, minus, lag, square: true });
            let (mut lo, mut hi, mut late, mut n) = (f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0);
            for i in (0..self.y.len()).filter(|i| take(*i)) {
                let v = self.columns[k][i];
                (lo, hi) = (lo.min(v), hi.max(v));
                late += (v - plain.columns[k][i]).powi(2);
                n += 1.0;
            }
            let margin = BEYOND * (hi - lo);
            found.push(Guard {
                term: k,
                square,
                range_k: [lo - margin, hi + margin],
                start_k: (late / f64::max(n, 1.0)).sqrt(),
                tau_s: problem.taus[lag],
            });
        }
        found
    }

    /// What the model says of a row with its differences held in their ranges, and x of its interval.
    fn held(&self, c: &[f64], guards: &[Guard], i: usize) -> (f64, f64) {
        let mut says = c[0] + self.columns.iter().zip(&c[1..]).map(|(u, c)| c * u[i]).sum::<f64>();
        let mut x2 = 0.0;
        for g in guards {
            let asked = self.columns[g.term][i];
            let held = asked.clamp(g.range_k[0], g.range_k[1]);
            let gain = c[g.term + 1];
            let bend = g.square.map_or(0.0, |k| c[k + 1]);
            says += gain * (held - asked) + bend * (held * held - asked * asked);
            x2 += unknown_um(gain, bend, asked, held, g.start_k, g.tau_s, self.elapsed_s[i]).powi(2);
        }
        (says, x2.sqrt())
    }

    /// Least squares on the rows that `take` chooses: constant, then one coefficient per column.
    fn solve(&self, take: &dyn Fn(usize) -> bool) -> Option<Vec<f64>> {
        let rows: Vec<usize> = (0..self.y.len()).filter(|i| take(*i)).collect();
        let p = self.columns.len() + 1;
        let n = rows.len() as f64;
        let mean = |v: &[f64]| rows.iter().map(|i| v[*i]).sum::<f64>() / n;
        let means: Vec<f64> = self.columns.iter().map(|c| mean(c)).collect();
        let my = mean(&self.y);
        let a = DMatrix::from_fn(rows.len(), p - 1, |i, j| self.columns[j][rows[i]] - means[j]);
        let b = DVector::from_fn(rows.len(), |i, _| self.y[rows[i]] - my);
        let g = a.tr_mul(&a);
        let c = g.cholesky()?.solve(&a.tr_mul(&b));
        let constant = my - c.iter().zip(&means).map(|(c, m)| c * m).sum::<f64>();
        Some(std::iter::once(constant).chain(c.iter().copied()).collect())
    }

    fn residual(&self, c: &[f64], i: usize) -> f64 {
        let model: f64 = c[0] + self.columns.iter().zip(&c[1..]).map(|(u, c)| c * u[i]).sum::<f64>();
        self.y[i] - model
    }

    fn rms(&self, c: &[f64], take: &dyn Fn(usize) -> bool) -> f64 {
        let rows: Vec<f64> =
            (0..self.y.len()).filter(|i| take(*i)).map(|i| self.residual(c, i).powi(2)).collect();
        (rows.iter().sum::<f64>() / rows.len().max(1) as f64).sqrt()
    }
}

fn rms(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count().max(1) as f64;
    (values.map(|v| v * v).sum::<f64>() / n).sqrt()
}

fn mean(v: &[f64]) -> f64 {
    v.iter().sum::<f64>() / v.len().max(1) as f64
}

/// The value below which this share of the values lies (nearest rank, rounded up).
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values[rank.clamp(1, values.len()) - 1]
}

/// Fits every error response of the training records; gives the model and, per response, how it was found.
///
/// # Errors
/// No temperatures, a sensor that is not there, too few rows, no structure that can be fitted.
pub fn fit(
    train: &[&Record],
    holdout: &[&Record],
    options: &Options,
) -> Result<(Machine, Vec<Report>), InputError> {
    let name = train[0].path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let ideal = || Machine::ideal(name.strip_suffix(".run.toml").unwrap_or(&name));
    let mut machine = options.base.clone().unwrap_or_else(ideal);
    // What the base explains is taken off first.
    let beyond = |records: &[&Record]| {
        let of = |r: &&Record| match &options.base {
            Some(base) => base.beyond(r),
            None => Ok((*r).clone()),
        };
        records.iter().map(of).collect::<Result<Vec<Record>, InputError>>()
    };
    let (own_train, own_holdout) = (beyond(train)?, beyond(holdout)?);
    let train: &[&Record] = &own_train.iter().collect::<Vec<_>>();
    let holdout: &[&Record] = &own_holdout.iter().collect::<Vec<_>>();
    let mut reports = Vec::new();
    let responses: Vec<Role> =
        train[0].responses().map(|c| c.role.clone()).filter(|r| matches!(r, Role::Error(_))).collect();
    if responses.is_empty() {
        return Err(InputError::whole(&train[0].path, "no error response", "a column of role error.AXIS"));
    }
    for response in responses {
        reports.push(fit_response(train, holdout, &response, options, &mut machine)?);
    }
    Ok((machine, reports))
}

/// Every offered difference as measured, chosen or not: where one leaves the range that the fit has seen, the machine is
/// in a state that the fit does not know, whatever the chosen ones say.
struct Watched {
    rows: Rows,
    offered: Vec<Term>,
}

impl Watched {
    fn new(problem: &Problem, train: &[&Record], response: &Role) -> Result<Self, InputError> {
        let plain = |(sensor, minus): &(usize, Option<usize>)| Term::Thermal {
            sensor: *sensor,
            minus: *minus,
            lag: 0,
            square: false,
        };
        let offered: Vec<Term> = problem.offered.iter().map(plain).collect();
        Ok(Self { rows: Rows::new(problem, &offered, train, response)?, offered })
    }

    /// The range of each on the rows that `take` chooses, and how much the response moved with its movement: the ratio
    /// of their standard deviations, which noise does not make smaller as it does a slope.
    fn ranges(&self, problem: &Problem, take: &dyn Fn(usize) -> bool) -> Vec<Validity> {
        let rows: Vec<usize> = (0..self.rows.y.len()).filter(|i| take(*i)).collect();
        let sd = |v: &[f64]| {
            let m = rows.iter().map(|i| v[*i]).sum::<f64>() / rows.len() as f64;
            (rows.iter().map(|i| (v[*i] - m).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
        };
        let y = sd(&self.rows.y);
        let of = |(term, u): (&Term, &Vec<f64>)| {
            let Term::Thermal { sensor, minus, .. } = *term else {
                unreachable!("only differences are watched")
            };
            let (lo, hi) = rows
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), i| (l.min(u[*i]), h.max(u[*i])));
            let margin = BEYOND * (hi - lo);
            let name = &problem.sensors[sensor];
            let difference = match minus {
                Some(m) => Difference::pair(name, &problem.sensors[m]),
                None => Difference::single(name),
            };
            let um_per_k = (y / sd(u).max(1e-9)).min(problem.plausible[0]);
            Validity { difference, range_k: [lo - margin, hi + margin], um_per_k }
        };
        self.offered.iter().zip(&self.rows.columns).map(of).collect()
    }

    /// What being outside may cost at a row, µm.
    fn outside_um(&self, ranges: &[Validity], i: usize) -> f64 {
        ranges.iter().zip(&self.rows.columns).map(|(r, u)| r.outside_um(u[i])).fold(0.0, f64::max)
    }
}

/// What nested blocks say: structure and parameters chosen without the block they are judged on.
struct Nested {
    folds: Vec<f64>,
    half_width_um: f64,
    coverage: f64,
}

fn nested(problem: &Problem, train: &[&Record], response: &Role) -> Result<Option<Nested>, InputError> {
    let mut folds = Vec::new();
    // Per fold: what is left of every row, and x of its interval.
    let mut left: Vec<Vec<(f64, f64)>> = Vec::new();
    let watched = Watched::new(problem, train, response)?;
    for f in 0..problem.folds {
        let others: Vec<usize> = (0..problem.folds).filter(|o| *o != f).collect();
        let Some(inner) = problem.select(&others) else { return Ok(None) };
        let terms = &inner.structure.terms;
        let rows = Rows::new(problem, terms, train, response)?;
        let plain = Rows::new(problem, &unlagged(terms), train, response)?;
        let Some(c) = rows.solve(&|i| rows.fold[i] != f) else { return Ok(None) };
        let guards = rows.guards(problem, terms, &plain, &|i| rows.fold[i] != f);
        let ranges = watched.ranges(problem, &|i| rows.fold[i] != f);
        let own = (0..rows.y.len()).filter(|i| rows.fold[*i] == f).map(|i| {
            let (says, x) = rows.held(&c, &guards, i);
            (rows.y[i] - says, x.hypot(watched.outside_um(&ranges, i)))
        });
        let own: Vec<(f64, f64)> = own.collect();
        folds.push(rms(own.iter().map(|l| l.0)));
        left.push(own);
    }
    // h so that 95 % of a block's rows lie within √(h² + x²), in the worst of the blocks: neighbours in time are off
    // together, so a new stretch of time is one more block, not a thousand more rows, and of n + 1 blocks n are no worse than
    // the worst of n.
    let of_block = |rows: &Vec<(f64, f64)>| {
        quantile(rows.iter().map(|(r, x)| (r * r - x * x).max(0.0).sqrt()).collect(), 0.95)
    };
    let widths: Vec<f64> = left.iter().map(of_block).collect();
    let width_without = |f: Option<usize>| {
        widths.iter().enumerate().filter(|(g, _)| Some(*g) != f).map(|(_, w)| *w).fold(0.0, f64::max)
    };
    let inside = |(f, own): (usize, &Vec<(f64, f64)>)| {
        let h = width_without(Some(f));
        own.iter().filter(|(r, x)| r.abs() <= h.hypot(*x)).count()
    };
    let all: usize = left.iter().map(Vec::len).sum();
    let coverage = left.iter().enumerate().map(inside).sum::<usize>() as f64 / all as f64;
    Ok(Some(Nested { folds, half_width_um: width_without(None), coverage }))
}

/// The same terms without their lags.
fn unlagged(terms: &[Term]) -> Vec<Term> {
    let of = |t: &Term| match *t {
        Term::Thermal { sensor, minus, square, .. } => Term::Thermal { sensor, minus, lag: 0, square },
        t => t,
    };
    terms.iter().map(of).collect()
}

/// How a fitted model does on records it has not seen.
#[derive(Default)]
struct Later {
    rms: Vec<f64>,
    coverage: Vec<f64>,
    width_um: Vec<f64>,
    warnings: Vec<String>,
}

fn judge_holdouts(machine: &Machine, holdout: &[&Record], response: &Role) -> Result<Later, InputError> {
    let mut later = Later::default();
    for r in holdout {
        let Some(y) = r.data(response) else {
            return Err(InputError::whole(
                &r.path,
                format!("no {response}"),
                "the training record's responses",
            ));
        };
        let place = r.responses().position(|c| c.role == *response).unwrap_or_default();
        let predicted = &machine.predict(r)?.columns[place].1;
        let left = y.iter().zip(predicted).map(|(y, p)| y - p);
        let widths = machine.half_widths_um(r, response).unwrap_or_default();
        let inside = left.clone().zip(&widths).filter(|(v, w)| v.abs() <= **w).count();
        later.width_um.push(mean(&widths));
        later.coverage.push(inside as f64 / y.len() as f64);
        later.rms.push(rms(left));
        later
            .warnings
            .extend(machine.out_of_range(r).into_iter().map(|w| format!("{}: {w}", r.path.display())));
    }
    Ok(later)
}

/// Adds a fitted effect to a machine; an offset of the base and the fit's constant are one offset.
fn take_in(machine: &mut Machine, effect: Effect, provenance: Provenance) -> Result<(), ValueError> {
    let place = machine.effects().position(|e| e.description().constant && e.name() == effect.name());
    let Some(n) = place else { return machine.push(effect, provenance) };
    let base = machine.listed()[n].effect.scalar(0);
    let [lo, hi] = provenance.interval.get("um").map_or([effect.scalar(0); 2], |i| i[0]);
    machine.set(n, "um", &[base + effect.scalar(0)], Some(&[[base + lo, base + hi]]))
}

fn fit_response(
    train: &[&Record],
    holdout: &[&Record],
    response: &Role,
    options: &Options,
    machine: &mut Machine,
) -> Result<Report, InputError> {
    let problem = Problem::new(train, response, options)?;
    let all: Vec<usize> = (0..problem.folds).collect();
    let whole = |found: &str, expected: &str| InputError::whole(&train[0].path, found, expected);
    let nothing = || whole("temperatures that explain nothing", "a run in which temperatures and error vary");
    let chosen = problem.select(&all).ok_or_else(nothing)?;
    let terms = chosen.structure.terms.clone();
    let rows = Rows::new(&problem, &terms, train, response)?;
    let coefficients = rows.solve(&|_| true).ok_or_else(nothing)?;

    let blocks = nested(&problem, train, response)?.ok_or_else(nothing)?;
    let intervals = jackknife(&problem, &chosen.structure, &rows, &coefficients);
    let plain = Rows::new(&problem, &unlagged(&terms), train, response)?;
    let guards = rows.guards(&problem, &terms, &plain, &|_| true);
    let effects = effects(&problem, &terms, &coefficients, &intervals, &guards, response)
        .map_err(|e| whole(&e.to_string(), "parameters within the law's bounds"))?;
    let mut fitted = Vec::new();
    let mut own = Machine::ideal("fit");
    for (effect, interval) in effects {
        fitted.push(Fitted::of(&effect, &interval));
        let provenance = Provenance {
            added_by: Some("model fit".to_owned()),
            date: Some(date::format(options.date)),
            from: train.iter().map(|r| Source::of(r)).collect(),
            interval,
        };
        let twice = |e: ValueError| whole(&e.to_string(), "each effect once");
        own.push(effect.clone(), provenance.clone()).map_err(twice)?;
        take_in(machine, effect, provenance).map_err(twice)?;
    }
    let note = FitNote {
        response: response.to_string(),
        date: date::format(options.date),
        valid_until: date::format(options.date + options.valid_days),
        rms_um: mean(&blocks.folds),
        half_width_um: blocks.half_width_um.max(1e-9),
        valid: Watched::new(&problem, train, response)?.ranges(&problem, &|_| true),
        from: train.iter().map(|r| Source::of(r)).collect(),
    };
    own.note_fit(note.clone());
    machine.note_fit(note);
    let later = judge_holdouts(&own, holdout, response)?;
    let mut warnings = later.warnings;
    if problem.coolant.is_some() {
        let silent = train.iter().filter(|r| r.column(&Role::Coolant).is_none());
        warnings.extend(silent.map(|r| format!("{}: no coolant logged, taken as dry", r.path.display())));
    }
    let ranked = |j: &Judged| problem.ranked(j, &all);
    let kept: Vec<Ranked> = chosen.kept.iter().map(ranked).collect();
    let mut pairs: Vec<Ranked> = problem
        .pairs
        .iter()
        .filter_map(|(s, m)| problem.best_lag(&[], *s, *m, &all))
        .map(|j| problem.ranked(&j, &all))
        .collect();
    pairs.sort_by(|a, b| b.gamma_lagged.abs().total_cmp(&a.gamma_lagged.abs()));
    warnings.extend(chosen.rivals(&problem));
    let environment = problem.environment.map(|e| problem.sensors[e].clone());
    Ok(Report {
        response: response.to_string(),
        environment_by: match (&options.environment, &environment) {
            (Some(_), _) => "given".to_owned(),
            (None, Some(_)) => {
                "coldest, and of those within 1 K the one that moves fastest; --environment names another"
                    .to_owned()
            }
            (None, None) => "none: differences are to 20 degC".to_owned(),
        },
        environment,
        dropped: chosen.redundant(&ranked, &kept),
        rounds: chosen
            .rounds
            .iter()
            .map(|j| Round { added: problem.name(j.terms[j.terms.len() - 1]), r: j.r, cv_rms_um: j.rms() })
            .chain(chosen.swaps.iter().map(|(j, out)| {
                let added = problem.name(j.terms[j.terms.len() - 1]);
                Round { added: format!("{added} for {}", problem.name(*out)), r: j.r, cv_rms_um: j.rms() }
            }))
            .collect(),
        alternatives: chosen.tied.iter().map(ranked).collect(),
        kept,
        pairs,
        effects: fitted,
        rms_um: Rms {
            train: rows.rms(&coefficients, &|_| true),
            folds_mean: mean(&blocks.folds),
            folds: blocks.folds,
            holdout: later.rms,
        },
        baselines: baselines(&problem, train, holdout, response)?,
        interval95: Interval {
            half_width_um: blocks.half_width_um,
            coverage_folds: blocks.coverage,
            coverage_holdout: later.coverage,
            mean_half_width_holdout_um: later.width_um,
        },
        dry_wet: dry_wet(&problem, &terms, train, &rows),
        warnings,
    })
}

/// Simple predictions on the same blocks: the mean, the value one row before, each offered difference as a straight
/// line.
fn baselines(
    problem: &Problem,
    train: &[&Record],
    holdout: &[&Record],
    response: &Role,
) -> Result<BTreeMap<String, Rms>, InputError> {
    let mut found = BTreeMap::new();
    let mut judge = |name: String, terms: &[Term]| -> Result<(), InputError> {
        let rows = Rows::new(problem, terms, train, response)?;
        let Some(c) = rows.solve(&|_| true) else { return Ok(()) };
        let mut folds = Vec::new();
        for f in 0..problem.folds {
            if let Some(c) = rows.solve(&|i| rows.fold[i] != f) {
                folds.push(rows.rms(&c, &|i| rows.fold[i] == f));
            }
        }
        let mut out = Vec::new();
        for r in holdout {
            let own = Rows::new(problem, terms, &[r], response)?;
            out.push(own.rms(&c, &|_| true));
        }
        let train = rows.rms(&c, &|_| true);
        found.insert(name, Rms { train, folds_mean: mean(&folds), folds, holdout: out });
        Ok(())
    };
    judge("mean".to_owned(), &[])?;
    for (sensor, minus) in &problem.offered {
        let term = Term::Thermal { sensor: *sensor, minus: *minus, lag: 0, square: false };
        judge(format!("linear {}", problem.name(term)), &[term])?;
    }
    let steps = |r: &Record| {
        let y = r.data(response).unwrap_or_default();
        y.windows(2).map(|w| w[1] - w[0]).collect::<Vec<f64>>()
    };
    let all: Vec<f64> = train.iter().flat_map(|r| steps(r)).collect();
    let n = all.len();
    let fold = |f: usize| {
        let own = all.iter().enumerate().filter(move |(i, _)| i * problem.folds / n.max(1) == f);
        rms(own.map(|(_, v)| *v))
    };
    let folds: Vec<f64> = (0..problem.folds).map(fold).collect();
    found.insert(
        "persistence".to_owned(),
        Rms {
            train: rms(all.iter().copied()),
            folds_mean: mean(&folds),
            folds,
            holdout: holdout.iter().map(|r| rms(steps(r).iter().copied())).collect(),
        },
    );
    Ok(found)
}

/// 95 % intervals by leaving out each block: of every coefficient, and of the first term's lag.
struct Jackknife {
    coefficients: Vec<[f64; 2]>,
    tau_s: BTreeMap<usize, [f64; 2]>,
}

/// The 95 % interval of a value from what it is with each block left out.
pub(crate) fn jackknife_interval(value: f64, parts: &[f64]) -> [f64; 2] {
    let m = mean(parts);
    let n = parts.len() as f64;
    let t = StudentsT::new(0.0, 1.0, (n - 1.0).max(1.0)).map_or(2.26, |d| d.inverse_cdf(0.975));
    let se = ((n - 1.0) / n * parts.iter().map(|p| (p - m).powi(2)).sum::<f64>()).sqrt();
    [value - t * se, value + t * se]
}

fn jackknife(problem: &Problem, structure: &Judged, rows: &Rows, full: &[f64]) -> Jackknife {
    let folds = problem.folds;
    let spread = jackknife_interval;
    let parts: Vec<Vec<f64>> = (0..folds).filter_map(|f| rows.solve(&|i| rows.fold[i] != f)).collect();
    let coefficients =
        (0..full.len()).map(|k| spread(full[k], &parts.iter().map(|p| p[k]).collect::<Vec<f64>>())).collect();
    let mut tau_s = BTreeMap::new();
    for (k, term) in structure.terms.iter().enumerate() {
        let Term::Thermal { lag, square: false, .. } = *term else { continue };
        if lag == 0 {
            continue;
        }
        let parts: Vec<f64> = (0..folds)
            .filter_map(|f| {
                let others: Vec<usize> = (0..folds).filter(|o| *o != f).collect();
                let fits = (1..problem.taus.len())
                    .filter_map(|l| Some((l, problem.judge(&relagged(&structure.terms, k, l), &others)?.r)));
                fits.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(l, _)| problem.taus[l].ln())
            })
            .collect();
        let tau = problem.taus[lag];
        // One step of the grid is known no better than that.
        let [lo, hi] = spread(tau.ln(), &parts);
        let step = LAG_STEP.ln() / 2.0;
        tau_s.insert(k, [lo.min(tau.ln() - step).exp(), hi.max(tau.ln() + step).exp()]);
    }
    Jackknife { coefficients, tau_s }
}

pub(crate) type Intervals = BTreeMap<String, Vec<[f64; 2]>>;

/// The structure as effects of the dictionary, each with its intervals and the range it was fitted on.
fn effects(
    problem: &Problem,
    terms: &[Term],
    coefficients: &[f64],
    jackknife: &Jackknife,
    guards: &[Guard],
    response: &Role,
) -> Result<Vec<(Effect, Intervals)>, ValueError> {
    let dictionary = Dictionary::default();
    let axis = response.axis().map_or("x", Axis::as_str);
    let one = |v: [f64; 2]| vec![v];
    let mut offset = dictionary.effect(&format!("{}.{axis}", offset::NAME))?;
    offset.set("um", &[coefficients[0]])?;
    let mut found = vec![(offset, Intervals::from([("um".to_owned(), one(jackknife.coefficients[0]))]))];
    for (k, term) in terms.iter().enumerate() {
        let (value, interval) = (coefficients[k + 1], jackknife.coefficients[k + 1]);
        match *term {
            Term::Coolant => {
                let mut e = dictionary.effect(&format!("{}.{axis}", coolant::NAME))?;
                e.set("um", &[value])?;
                found.push((e, Intervals::from([("um".to_owned(), one(interval))])));
            }
            Term::Speed => {
                let mut e = dictionary.effect(&format!("{}.{axis}", spindle_speed::NAME))?;
                e.set("um_per_krpm", &[value])?;
                found.push((e, Intervals::from([("um_per_krpm".to_owned(), one(interval))])));
            }
            Term::Thermal { sensor, minus, lag, square } => {
                let law = if lag > 0 { thermal_lag::NAME } else { thermal_growth::NAME };
                let delta = match minus {
                    Some(m) => Difference::pair(&problem.sensors[sensor], &problem.sensors[m]),
                    None => Difference::single(&problem.sensors[sensor]),
                };
                let key = if square { "um_per_K2" } else { "um_per_K" };
                let tau = problem.taus[lag];
                let same = |e: &Effect| {
                    e.delta.as_ref() == Some(&delta)
                        && e.value("tau_s").map_or(0.0_f64, |v| v[0]).to_bits() == tau.to_bits()
                };
                if let Some((e, intervals)) = found.iter_mut().find(|(e, _)| same(e)) {
                    e.set(key, &[value])?;
                    intervals.insert(key.to_owned(), one(interval));
                    continue;
                }
                let mut e = dictionary.effect(&format!("{law}.{axis}"))?;
                e.delta = Some(delta);
                let mut intervals = Intervals::from([(key.to_owned(), one(interval))]);
                e.set(key, &[value])?;
                if lag > 0 {
                    e.set("tau_s", &[tau])?;
                    if let Some(i) = jackknife.tau_s.get(&k) {
                        intervals.insert("tau_s".to_owned(), one(*i));
                    }
                }
                if let Some(g) = guards.iter().find(|g| g.term == k) {
                    e.range_k = Some(g.range_k);
                    e.start_k = (lag > 0).then_some(g.start_k);
                }
                found.push((e, intervals));
            }
        }
    }
    Ok(found)
}

fn dry_wet(problem: &Problem, terms: &[Term], train: &[&Record], rows: &Rows) -> Option<DryWet> {
    let wet: Vec<bool> = train.iter().flat_map(|r| wet(r)).map(|v| v > 0.5).collect();
    let enough = |w: bool| wet.iter().filter(|v| **v == w).count() >= 20 * (terms.len() + 1);
    if wet.len() != rows.y.len() || !enough(true) || !enough(false) {
        return None;
    }
    // The coolant's own step is what the two fits' constants hold.
    let thermal: Vec<usize> = (0..terms.len()).filter(|k| terms[*k] != Term::Coolant).collect();
    let own = Rows {
        columns: thermal.iter().map(|k| rows.columns[*k].clone()).collect(),
        y: rows.y.clone(),
        fold: rows.fold.clone(),
        elapsed_s: Vec::new(),
    };
    let (dry_fit, wet_fit) = (own.solve(&|i| !wet[i])?, own.solve(&|i| wet[i])?);
    let named = |c: &[f64]| thermal.iter().zip(&c[1..]).map(|(k, c)| (problem.name(terms[*k]), *c)).collect();
    let growth = |w: bool| {
        let own = own.y.iter().zip(&wet).filter(|(_, is)| **is == w).map(|(y, _)| *y);
        own.clone().fold(f64::MIN, f64::max) - own.fold(f64::MAX, f64::min)
    };
    Some(DryWet {
        growth_dry_um: growth(false),
        growth_wet_um: growth(true),
        dry: named(&dry_fit),
        wet: named(&wet_fit),
        dry_model_on_wet_rms_um: own.rms(&dry_fit, &|i| wet[i]),
        wet_model_on_wet_rms_um: own.rms(&wet_fit, &|i| wet[i]),
    })
}

/// Measured and predicted response of a record over time, with the 95 % interval where there is one (the patent's
/// figure 18).
#[must_use]
pub fn prediction_chart(
    record: &Record,
    response: &Column,
    predicted: &[f64],
    half_widths_um: Option<&[f64]>,
) -> Chart {
    let over_time = |v: &mut dyn Iterator<Item = f64>| {
        record.time_s().iter().map(|t| t / 60.0).zip(v).collect::<Vec<(f64, f64)>>()
    };
    let title = format!("{}: {} measured and predicted", record.file, response.role);
    let mut chart = Chart::new(&title, "time, min", "error, µm")
        .with(Series::new("measured", Style::Dots, over_time(&mut response.data.iter().copied())))
        .with(Series::new("predicted", Style::Line, over_time(&mut predicted.iter().copied())));
    if let Some(widths) = half_widths_um {
        for (name, sign) in [("95 %, low", -1.0), ("95 %, high", 1.0)] {
            let bound = &mut predicted.iter().zip(widths).map(|(p, w)| p + sign * w);
            chart = chart.with(Series::new(name, Style::Line, over_time(bound)));
        }
    }
    chart
}

/// What is left of a response before and after a fit, each less its mean (a gauge's zero is arbitrary): over the position
/// that moves most, or over time where none does.
#[must_use]
pub fn residual_chart(record: &Record, response: &Role, before_um: &[f64], after_um: &[f64]) -> Chart {
    let span = |v: &[f64]| {
        v.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b)) - v.iter().fold(f64::INFINITY, |a, b| a.min(*b))
    };
    let moves = record.columns.iter().filter(|c| matches!(c.role, Role::Position(_)) && span(&c.data) > 0.0);
    let along = moves.max_by(|a, b| span(&a.data).total_cmp(&span(&b.data)));
    let (name, x): (String, Vec<f64>) = match along {
        Some(c) => (format!("{}, mm", c.role), c.data.clone()),
        None => ("time, min".to_owned(), record.time_s().iter().map(|t| t / 60.0).collect()),
    };
    let points = |v: &[f64]| {
        let m = mean(v);
        x.iter().copied().zip(v.iter().map(|v| v - m)).collect::<Vec<(f64, f64)>>()
    };
    Chart::new(&format!("{}: {response} before and after the fit", record.file), &name, "error, µm")
        .with(Series::new("before", Style::Dots, points(before_um)))
        .with(Series::new("left", Style::Dots, points(after_um)))
}

impl Report {
    /// The patent's figure 17: γ of every sensor as a bar upwards, its temperature range downwards, best to the right;
    /// and, which the patent has not, γ of the difference behind its lag as a dot.
    #[must_use]
    pub fn chart(&self) -> Chart {
        let kept = self.kept.iter().map(|k| (k.sensor.clone(), [k.gamma, k.gamma_lagged, k.range_k]));
        let redundant =
            self.dropped.iter().map(|d| (format!("({})", d.sensor), [d.gamma, d.gamma_lagged, d.range_k]));
        let mut all: Vec<(String, [f64; 3])> = kept.chain(redundant).collect();
        all.sort_by(|a, b| a.1[0].abs().total_cmp(&b.1[0].abs()));
        let widest = all.iter().map(|a| a.1[2]).fold(1e-9, f64::max);
        let title = format!(
            "{}: correlation γ (up) and temperature range (down); in brackets: redundant",
            self.response
        );
        let points = |of: &dyn Fn([f64; 3]) -> f64| {
            all.iter().enumerate().map(|(i, a)| (i as f64, of(a.1))).collect::<Vec<_>>()
        };
        let mut chart = Chart::new(&title, "difference", &format!("|γ| up, range down (1 is {widest:.1} K)"));
        chart.x_names = all.iter().map(|a| a.0.clone()).collect();
        chart
            .with(Series::new("|γ|", Style::Bars, points(&|v| v[0].abs())))
            .with(Series::new("range", Style::Bars, points(&|v| -v[2] / widest)))
            .with(Series::new("|γ| behind its lag", Style::Dots, points(&|v| v[1].abs())))
    }
}
