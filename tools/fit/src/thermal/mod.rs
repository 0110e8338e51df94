//! Sensor selection (CASC) and the fit of equation 1 of WO 97/43703.
//! A lag is added if it is justified.
//!
//! Growth is fitted as a constant plus terms of temperature differences: to the environment, between sensors,
//! and their squares. Each is as measured or passed through a first-order lag. The best single difference
//! comes first, then the next best, in at most five rounds.
//! The patent's rule asks R to improve by 1 %, which no term can do above 0.99. So here each term must be
//! justified: it must predict unseen blocks better, by more than the best of as many chance columns. If none
//! does, nothing is added. *Best* is judged by blocked cross-validation in time, never by the fit itself,
//! because sixteen sensors that warm together fit any stretch of the past in hundreds of ways.
//! If cross-validation cannot decide, physics does. Heat flows from its source outwards and growth follows,
//! so the difference that leads the growth most (it needs the longest lag) is nearest to the cause. The first
//! difference has the sign of the hottest body's. Any difference to the environment keeps the sign of its own
//! correlation. No gain is beyond the dictionary's plausible range.
//!
//! The 95 % interval of a row is √(h² + x²). h is the residual of the worst block; x is what the fit cannot
//! know in that row. x grows with any difference beyond its fitted range, where it is held at the bound, so
//! that gain · excess is left out. It also grows with any other difference beyond the range seen. Just after
//! a start it contains the lagged difference's distance from equilibrium, which fades with its lag.
//!
//! | module | what |
//! |---|---|
//! | `fit_candidates`, `term` | the candidates: differences, lags, the rows binned for the search |
//! | `cross_validation` | a structure judged by blocked cross-validation |
//! | `sensor_selection_only` | the choice of sensors alone, for comparison |
//! | `term_selection` | CASC, the refit, and the exchange of terms |
//! | `least_squares_rows` | least squares over every row |
//! | `prediction_interval`, `jackknife` | 95 % intervals of the prediction, and of the parameters |
//! | `terms_to_effects` | the structure as effects of the dictionary |
//! | `baselines_and_holdouts` | simpler predictions, hold-outs, dry against wet |
//! | `report`, `charts` | the results, as figures and charts |

mod baselines_and_holdouts;
mod charts;
mod cross_validation;
mod fit_candidates;
mod jackknife;
mod least_squares_rows;
mod prediction_interval;
mod report;
mod sensor_selection_only;
mod term;
mod term_selection;
mod terms_to_effects;

pub use charts::{prediction_chart, residual_chart};
pub(crate) use jackknife::{Intervals, jackknife_interval};
pub use report::{
    CrossValidatedRms, DryWetComparison, FittedEffect, ParameterEstimate, PredictionInterval, RankedSensor,
    RedundantSensor, RefitRound, ThermalFitReport,
};
pub use sensor_selection_only::select_differences;
pub use term_selection::{REDUNDANT, ROUNDS};

use crate::statistics::mean_square;
use crate::temperature_denoising::{SmoothingUncertainty, smoothed};
use baselines_and_holdouts::{baselines, dry_wet, judge_holdouts};
use cross_validation::CrossValidatedTerms;
use fit_candidates::TermSelectionProblem;
use jackknife::{JackknifeIntervals, jackknife, tuned};
use least_squares_rows::LeastSquaresRows;
use prediction_interval::{OfferedTemperatureDifferences, halves, mean_only, nested};
use rtec_files::InputError;
use rtec_files::date;
use rtec_model::effect::{Effect, ParameterValueError, TemperatureDifference, ThermalDependence};
use rtec_model::machine::{EffectWithProvenance, FitNote, Machine, Provenance, RecordRanges, SourceRecord};
use rtec_model::record::{Record, Role};
use std::collections::BTreeMap;
use term::{Term, unlagged};
use terms_to_effects::effects;

/// The options of a fit.
#[derive(Debug, Clone)]
pub struct ThermalFitOptions {
    /// Differences to choose from; empty for all sensors.
    /// A sensor without `minus` is compared with the environment.
    pub sensors: Vec<TemperatureDifference>,
    /// The sensor of the environment; `None` for the coldest on average.
    pub environment: Option<String>,
    /// Blocks of the cross-validation.
    pub folds: usize,
    /// Whether to offer lags.
    pub lag: bool,
    /// Whether to offer squares.
    pub square: bool,
    /// Whether to offer the spindle's speed.
    /// Equation 1 of WO 97/43703 has only temperatures; a speed acts at once, and heat does not.
    pub speed: bool,
    /// A known model: its effects are kept, and the rest is fitted.
    pub base: Option<Machine>,
    /// The date that the model will carry, days since 1970-01-01.
    pub date: i64,
    /// Days for which it may be used without a new check.
    pub valid_days: i64,
}

impl Default for ThermalFitOptions {
    fn default() -> Self {
        Self {
            sensors: Vec::new(),
            environment: None,
            folds: 10,
            lag: true,
            square: true,
            speed: true,
            base: None,
            date: 0,
            valid_days: 365,
        }
    }
}

impl ThermalFitOptions {
    /// Differences of the base's growth effects on this response.
    /// They are pairs of a sensor and the one subtracted.
    fn base_differences(&self, response: &Role) -> Vec<(String, Option<String>)> {
        let own = |e: &&Effect| e.description().heat == ThermalDependence::Growth;
        let of = |e: &Effect| {
            let d = e.delta.as_ref().filter(|_| e.axes().first() == response.axis())?;
            Some((d.sensor.clone(), d.minus().map(str::to_owned)))
        };
        self.base.iter().flat_map(Machine::effects).filter(own).filter_map(of).collect()
    }

    /// Whether the options name this sensor.
    fn names(&self, sensor: &str) -> bool {
        self.environment.as_deref() == Some(sensor)
            || self.sensors.iter().any(|d| d.sensors().any(|own| own == sensor))
    }

    /// Whether the base has an effect of this name.
    fn base_has(&self, name: &str) -> bool {
        self.base.as_ref().is_some_and(|m| m.effects().any(|e| e.name() == name))
    }
}

/// Fits every error response of the training records.
/// Returns the model and a report per response.
///
/// # Errors
/// No temperatures, a sensor that is missing, too few rows, no structure that can be fitted.
pub fn fit(
    train: &[&Record],
    holdout: &[&Record],
    options: &ThermalFitOptions,
) -> Result<(Machine, Vec<ThermalFitReport>), InputError> {
    // The name lists the responses; every effect lists its records.
    let responses: Vec<String> = train[0]
        .responses()
        .filter(|c| matches!(c.role, Role::Error(_)))
        .map(|c| c.role.to_string())
        .collect();
    let ideal = || Machine::ideal(&format!("growth of {} by temperatures", responses.join(", ")));
    let mut machine = options.base.clone().unwrap_or_else(ideal);
    // The base's prediction is subtracted first.
    let beyond = |records: &[&Record]| {
        let of = |r: &&Record| match &options.base {
            Some(base) => base.without_prediction(r),
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

/// The whole fit of one response.
/// It finds the structure, its parameters with their intervals, and its quality.
fn fit_response(
    train: &[&Record],
    holdout: &[&Record],
    response: &Role,
    options: &ThermalFitOptions,
    machine: &mut Machine,
) -> Result<ThermalFitReport, InputError> {
    // Select terms and fit values on smoothed temperatures. Judge predictions on raw logs, as the live model
    // reads them.
    let (quiet, spread): (Vec<Record>, Vec<SmoothingUncertainty>) = train.iter().map(|r| smoothed(r)).unzip();
    let quiet: &[&Record] = &quiet.iter().collect::<Vec<_>>();
    let mut problem = TermSelectionProblem::new(quiet, response, options)?;
    problem.spread = spread;
    let all: Vec<usize> = (0..problem.folds).collect();
    let whole = |found: &str, expected: &str| InputError::whole(&train[0].path, found, expected);
    let nothing = || whole("temperatures that explain nothing", "a run in which temperatures and error vary");
    let chosen = problem.select(&all).ok_or_else(nothing)?;
    let baselines = baselines(&problem, train, holdout, response)?;
    let mut blocks = nested(&problem, train, response)?.ok_or_else(nothing)?;
    let mut terms = chosen.structure.terms.clone();
    let still = |s: &String| {
        format!(
            "{s} reads the same in every row and is not offered: is it read? --sensors or --environment takes it all the same"
        )
    };
    let mut warnings: Vec<String> = problem.still.iter().map(still).collect();
    if !terms.is_empty() && blocks.mean_square() > baselines["mean"].mean_square() {
        // Nested cross-validation rejects it: structures selected without a block predict that block worse
        // than the mean.
        warnings.push(format!(
            "{} is left out: chosen without a block of rows, it says less of that block than the mean does; a run in which these temperatures move more \
             would tell",
            terms.iter().map(|t| problem.name(*t)).collect::<Vec<_>>().join(", ")
        ));
        terms.clear();
        blocks = mean_only(&problem, train, response)?;
    }
    let RetainedTerms { terms, coefficients, mut intervals, left_out } =
        settle(&mut problem, terms, quiet, response, &all)?.ok_or_else(nothing)?;
    if let Some(left_out) = left_out {
        warnings.push(left_out);
        blocks = mean_only(&problem, train, response)?;
    }
    intervals.allow_for_squares(&mut problem, &terms, quiet, response)?;
    let rows = LeastSquaresRows::new(&problem, &terms, train, response)?;
    let plain = LeastSquaresRows::new(&problem, &unlagged(&terms), train, response)?;
    let guards = rows.guards(&problem, &terms, &plain, &|_| true);
    let effects = effects(&problem, &terms, &coefficients, &intervals, &guards, response)
        .map_err(|e| whole(&e.to_string(), "parameters within the law's bounds"))?;
    // The half width must not be below the rows' own scatter, which the allowance for other times may exceed.
    let half_width_um = blocks.half_width_um.max(rows.scatter_um(&coefficients));
    let mut own = Machine::ideal("fit");
    let fitted = enter(effects, train, options, &mut own, machine)
        .map_err(|e| whole(&e.to_string(), "each effect once"))?;
    let note = FitNote {
        response: response.to_string(),
        date: date::format(options.date),
        valid_until: date::format(options.date + options.valid_days),
        rms_um: blocks.mean_square().sqrt(),
        half_width_um: half_width_um.max(1e-9),
        valid: OfferedTemperatureDifferences::new(&problem, train, response)?.ranges(&problem, &|_| true),
        at_mm: None,
        by_kind_um: by_kind(train, half_width_um.max(1e-9)),
        from: train.iter().map(|r| SourceRecord::of(r)).collect(),
    };
    own.note_fit(note.clone());
    // For the whole model, the base's uncertainty is added to that of the fit.
    let mut note = FitNote { at_mm: Some(FitNote::places(train)), ..note };
    if let Some(earlier) = machine.fits().iter().find(|f| f.response == note.response) {
        note.add_earlier_fit(earlier, rows.noise_um(&coefficients));
    }
    machine.note_fit(note);
    let later = judge_holdouts(&own, holdout, response)?;
    warnings.extend(later.warnings);
    if problem.coolant.is_some() {
        let silent = train.iter().filter(|r| r.column(&Role::Coolant).is_none());
        warnings.extend(silent.map(|r| format!("{}: no coolant logged, taken as dry", r.path.display())));
    }
    warnings.extend(long_lags(&fitted, train));
    let coverage_halves = halves(&problem, train, response, half_width_um)?;
    warnings.extend(coverage_halves.and_then(|held| unlike(held, half_width_um)));
    warnings.extend(outdone(&baselines, &blocks.folds));
    let ranked = |j: &CrossValidatedTerms| problem.ranked(j, &all);
    let kept: Vec<RankedSensor> = chosen.kept.iter().map(ranked).collect();
    warnings.extend(chosen.rivals(&problem).filter(|_| !terms.is_empty()));
    warnings.extend(chosen.by_all_rows(&problem).filter(|_| !terms.is_empty()));
    Ok(ThermalFitReport {
        response: response.to_string(),
        environment_by: problem.environment_by(options),
        environment: problem.environment.map(|e| problem.sensors[e].clone()),
        dropped: chosen.redundant(&ranked, &kept),
        rounds: chosen.history(&problem),
        alternatives: chosen.tied.iter().map(ranked).collect(),
        kept,
        pairs: problem.ranked_pairs(&all),
        effects: fitted,
        rms_um: CrossValidatedRms {
            train: rows.rms(&coefficients, &|_| true),
            folds_rms: blocks.mean_square().sqrt(),
            folds: blocks.folds,
            holdout: later.rms,
        },
        baselines,
        interval95: PredictionInterval {
            half_width_um,
            coverage_folds: blocks.coverage,
            coverage_halves,
            coverage_holdout: later.coverage,
            mean_half_width_holdout_um: later.width_um,
        },
        dry_wet: dry_wet(&problem, &terms, train, &rows),
        warnings,
    })
}

/// The terms that are kept, with their values.
struct RetainedTerms {
    terms: Vec<Term>,
    coefficients: Vec<f64>,
    intervals: JackknifeIntervals,
    /// A message about a single growth that was removed because it may be zero.
    left_out: Option<String>,
}

/// Tunes the terms and removes squares, or a single growth, that may be zero.
/// `None` if the rows do not determine the values.
fn settle(
    problem: &mut TermSelectionProblem,
    mut terms: Vec<Term>,
    train: &[&Record],
    response: &Role,
    all: &[usize],
) -> Result<Option<RetainedTerms>, InputError> {
    let mut left_out = None;
    loop {
        terms = tuned(problem, terms, train, response)?;
        let rows = LeastSquaresRows::new(problem, &terms, train, response)?;
        let Some(coefficients) = rows.solve(&|_| true) else { return Ok(None) };
        // The search averages rows. Over every row a gain may exceed the law's bounds; then the term is
        // dropped.
        if let Some(k) = problem.implausible(&terms, &coefficients) {
            terms.remove(k);
            continue;
        }
        let intervals = jackknife(problem, &terms, train, response, &coefficients)?;
        if let Some(k) = intervals.idle_square(problem, &terms, train, response, all)? {
            terms.remove(k);
            continue;
        }
        if let Some(k) = intervals.alone_and_idle(&terms) {
            left_out = Some(format!(
                "{} is left out: its interval holds zero; a run in which these temperatures move more would tell",
                problem.name(terms.remove(k))
            ));
            continue;
        }
        // Without its square a difference may be replaceable by one to the environment.
        match problem.judge(&terms, all).map(|j| problem.to_environment(j, all).terms) {
            Some(other) if other != terms => terms = other,
            _ => return Ok(Some(RetainedTerms { terms, coefficients, intervals, left_out })),
        }
    }
}

/// Largest lag whose end is well visible, as a share of the longest record.
const LONG: f64 = 0.25;

/// Messages about lags for which the records are hardly long enough.
fn long_lags(fitted: &[FittedEffect], train: &[&Record]) -> Vec<String> {
    let span = |r: &&Record| r.time_s().last().zip(r.time_s().first()).map_or(0.0, |(b, a)| b - a);
    let longest_s = train.iter().map(span).fold(0.0, f64::max);
    let of = |e: &FittedEffect| {
        let tau = e.parameters.get("tau_s").filter(|tau| tau.value > LONG * longest_s)?;
        let name = e.sensor.iter().chain(&e.minus).map(String::as_str).collect::<Vec<_>>().join("-");
        Some(format!(
            "the lag of {name}, {:.0} s, is as long as records of {longest_s:.0} s can show: what lags more looks like it, and may belong to another \
             difference; a record of more than four times the lag would tell",
            tau.value
        ))
    };
    fitted.iter().filter_map(of).collect()
}

/// Largest share of rows outside the interval of the other half's fit.
/// 5 % would be expected.
const UNHELD: f64 = 0.10;

/// A message if the interval holds only for states that the records show.
fn unlike([later, earlier]: [f64; 2], half_width_um: f64) -> Option<String> {
    (later.min(earlier) < 1.0 - UNHELD).then(|| {
        format!(
            "the interval is of states as these records show them: fitted on their earlier half alone, ±{half_width_um:.2} µm holds {:.0} % of \
             the later one, and {:.0} % the other way round; a run of the states to come, as a --holdout or in the fit, tells",
            100.0 * later,
            100.0 * earlier
        )
    })
}

/// Ratio by which a single linear difference must beat the fit to be reported.
const OUTDONE: f64 = 1.1;

/// A message if a simple prediction has smaller residuals than the fit.
fn outdone(baselines: &BTreeMap<String, CrossValidatedRms>, folds: &[f64]) -> Option<String> {
    let own = mean_square(folds).sqrt();
    let lines = baselines.iter().filter(|(name, _)| name.starts_with("linear "));
    let (name, line) = lines.map(|(n, b)| (n, b.mean_square().sqrt())).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (own > OUTDONE * line).then(|| {
        let difference = name.trim_start_matches("linear ");
        format!(
            "{difference} alone, as a straight line, leaves {line:.2} µm of the same blocks, this fit {own:.2} µm: what is chosen here changes \
             from block to block; --sensors {difference} --no-lag --no-square fits the line"
        )
    })
}

/// The same half width for every kind of these records.
fn by_kind(records: &[&Record], half_width_um: f64) -> BTreeMap<String, f64> {
    records.iter().filter_map(|r| FitNote::kind_of(r)).map(|kind| (kind, half_width_um)).collect()
}

/// Adds the fitted effects to the fit's own machine and to the requested one.
fn enter(
    effects: Vec<(Effect, Intervals)>,
    train: &[&Record],
    options: &ThermalFitOptions,
    own: &mut Machine,
    machine: &mut Machine,
) -> Result<Vec<FittedEffect>, ParameterValueError> {
    let mut fitted = Vec::new();
    for (effect, interval) in effects {
        fitted.push(FittedEffect::of(&effect, &interval));
        let provenance = provenance(&effect, train, date::format(options.date), interval);
        own.push(effect.clone(), provenance.clone())?;
        add_fitted_effect(machine, effect, provenance, train)?;
    }
    Ok(fitted)
}

/// The provenance of a fitted effect.
pub(crate) fn provenance(
    effect: &Effect,
    records: &[&Record],
    date: String,
    interval: Intervals,
) -> Provenance {
    let from = records.iter().map(|r| SourceRecord::of(r)).collect();
    let set_up = effect.description().may_be_set_up();
    Provenance { added_by: Some("model fit".to_owned()), date: Some(date), from, interval, set_up }
}

/// Adds a fitted effect to a machine.
/// The set-up zeros of an earlier fit and of this one are added. The earlier one counts only if it acts in
/// these
/// runs, because then it was subtracted before this fit.
fn add_fitted_effect(
    machine: &mut Machine,
    effect: Effect,
    provenance: Provenance,
    train: &[&Record],
) -> Result<(), ParameterValueError> {
    let earlier = |l: &EffectWithProvenance| {
        l.provenance.set_up && provenance.set_up && l.effect.name() == effect.name()
    };
    let place = machine.listed().iter().position(earlier);
    let Some(n) = place else { return machine.push(effect, provenance) };
    let earlier = &machine.listed()[n];
    let taken_off = train.iter().any(|r| machine.acts_in(earlier, &RecordRanges::of(r)));
    let base = if taken_off { earlier.effect.scalar(0) } else { 0.0 };
    let [lo, hi] = provenance.interval.get("um").map_or([effect.scalar(0); 2], |i| i[0]);
    machine.set(n, "um", &[base + effect.scalar(0)], Some(&[[base + lo, base + hi]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_does_better_on_the_same_blocks_is_named() {
        let rms = |folds: &[f64]| CrossValidatedRms {
            train: 1.0,
            folds: folds.to_vec(),
            folds_rms: mean_square(folds).sqrt(),
            holdout: Vec::new(),
        };
        let baselines = |line: &[f64]| {
            [
                ("mean", rms(&[9.0, 9.0])),
                ("persistence", rms(&[0.1, 0.1])),
                ("linear T1", rms(line)),
                ("linear T8-T18", rms(&[5.0, 5.0])),
            ]
            .map(|(n, r)| (n.to_owned(), r))
            .into()
        };
        let said = outdone(&baselines(&[1.0, 1.2]), &[2.0, 1.5]).unwrap();
        assert!(said.starts_with("T1 alone") && said.contains("--sensors T1 "), "{said}");
        assert_eq!(outdone(&baselines(&[1.7, 1.7]), &[1.8, 1.8]), None, "no more than a tenth better");
    }
}
