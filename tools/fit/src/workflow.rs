//! A fit from records as users give them.
//! It reports and leaves out suspicious data, then selects sensors or fits named effects. It also makes the
//! document for programs.

use crate::linear_least_squares::{self, EffectFitReport};
use crate::thermal::{self, ThermalFitOptions, ThermalFitReport};
use rtec_files::date;
use rtec_files::{InputError, InputNotice};
use rtec_measure::gauge_resolution;
use rtec_measure::plausible::{self, Suspicion};
use rtec_measure::plot::Chart;
use rtec_model::effect::TemperatureDifference;
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role, RunKind};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// The options of a fit, as the user gives them.
#[derive(Debug, Clone, Default)]
pub struct FitRequest {
    /// Differences to choose from, as `T0` (to the environment) or `T8-T18`.
    /// Empty for all sensors.
    pub sensors: Vec<String>,
    /// The model's date, days since 1970-01-01.
    /// `None` means the day of the latest record, or today if none has one.
    pub date: Option<i64>,
    /// Whether to fit even if a record's unit, sign, direction or column looks wrong.
    pub despite_suspicions: bool,
    /// The other options; their sensors and date are not read.
    pub options: ThermalFitOptions,
}

/// A fit, and the suspicions against its records.
#[derive(Debug)]
pub struct ThermalFitResult {
    /// The model with the fitted effects.
    pub machine: Machine,
    /// A report per response.
    pub reports: Vec<ThermalFitReport>,
    /// Suspicions against the records.
    pub doubts: Vec<Suspicion>,
    /// The training records as used for the fit.
    pub records: Vec<Record>,
}

/// A fit of named effects.
#[derive(Debug)]
pub struct NamedEffectFitResult {
    /// The model with the fitted effects.
    pub machine: Machine,
    /// The report of the fit.
    pub report: EffectFitReport,
    /// Suspicions against the records.
    pub doubts: Vec<Suspicion>,
    /// The records as used for the fit.
    pub records: Vec<Record>,
}

/// Shortest drift test without a warning, s.
/// A spindle's housing takes half an hour and more to warm through. A shorter test shows only the beginning,
/// or has minutes for seconds.
const SHORT_S: f64 = 1800.0;

/// Selects sensors and fits growth. `holdout` only affects the last figures.
/// Messages go to `say`. A model of suspicious records is only for inspection: call [`ThermalFitResult::is_to_be_written`]
/// before it is kept.
///
/// # Errors
/// No record; a sensor that is missing; records that do not show growth.
pub fn fit(
    train: Vec<Record>,
    holdout: Vec<Record>,
    asked: &FitRequest,
    say: &mut dyn FnMut(InputNotice),
) -> Result<ThermalFitResult, InputError> {
    let doubts = plausible::report_suspicions(&[train.as_slice(), &holdout].concat(), say);
    let (train, holdout) = plausible::once(train, holdout);
    if train.is_empty() {
        return Err(InputError::whole(Path::new("model fit"), "no record", "a record to fit on"));
    }
    // Suspicions that hold-outs show remove nothing from the training.
    let train = plausible::usable(&train, &plausible::suspicions(&train), say);
    let of_holdout = plausible::suspicions(&holdout);
    let usable = plausible::in_figures(&holdout, &of_holdout);
    let good = |(record, all): (&Record, &Record)| plausible::good_rows(record, all.rows(), say).into_owned();
    let holdout: Vec<Record> = usable.iter().zip(&holdout).map(good).collect();
    for record in train.iter().chain(&holdout).filter(|r| r.column(&Role::Time).is_none()) {
        let file = record.path.display();
        say(InputNotice::Warning(format!(
            "{file}: no column of role time: lags and spans of time in it are numbers of rows"
        )));
    }
    for record in train.iter().filter(|r| r.kind == RunKind::Drift && r.column(&Role::Time).is_some()) {
        let span_s = record.time_s().last().zip(record.time_s().first()).map_or(0.0, |(b, a)| b - a);
        if span_s < SHORT_S {
            say(InputNotice::Warning(format!(
                "{}: the run lasts {:.1} min, in which hardly a machine warms: is its time in another unit than stated?",
                record.path.display(),
                span_s / 60.0
            )));
        }
    }
    for record in &train {
        for note in gauge_resolution::resolution_notes(record, true) {
            say(InputNotice::Warning(format!("{}: {note}", record.path.display())));
        }
    }
    let sensors = asked.sensors.iter().map(|s| difference(s, &train[0])).collect::<Result<Vec<_>, _>>()?;
    for d in closed(&sensors) {
        say(InputNotice::Warning(format!(
            "--sensors: {d} is the sum of others of them: which of these the machine grows with no record tells; leave one out"
        )));
    }
    let options = ThermalFitOptions {
        sensors,
        date: asked.date.unwrap_or_else(|| day_of(&train)),
        ..asked.options.clone()
    };
    let (machine, reports) =
        thermal::fit(&train.iter().collect::<Vec<_>>(), &holdout.iter().collect::<Vec<_>>(), &options)?;
    for r in &reports {
        for w in &r.warnings {
            say(InputNotice::Warning(format!("{}: {w}", r.response)));
        }
    }
    Ok(ThermalFitResult { machine, reports, doubts, records: train })
}

/// Fits effects by their names, in addition to those of the base.
/// Names are such as `scale.x` and `thermal_expansion.x:T3-T20`.
///
/// # Errors
/// No record; a suspicion against one, unless overruled; an unknown effect, or one that these records do not
/// show.
pub fn fit_named(
    records: Vec<Record>,
    effects: &[String],
    asked: &FitRequest,
    say: &mut dyn FnMut(InputNotice),
) -> Result<NamedEffectFitResult, InputError> {
    let paths: Vec<_> = records.iter().map(|r| r.path.clone()).collect();
    let doubts = plausible::report_suspicions(&records, say);
    let (records, _) = plausible::once(records, Vec::new());
    if records.is_empty() {
        return Err(InputError::whole(Path::new("model fit"), "no record", "a record to fit on"));
    }
    let records = plausible::usable(&records, &doubts, say);
    if !asked.despite_suspicions {
        plausible::refuse(&doubts, &paths.iter().map(AsRef::as_ref).collect::<Vec<_>>())?;
    }
    let base = asked
        .options
        .base
        .clone()
        .unwrap_or_else(|| Machine::ideal(&format!("fit of {}", effects.join(", "))));
    let day = date::format(asked.date.unwrap_or_else(|| day_of(&records)));
    let borrowed: Vec<&Record> = records.iter().collect();
    let (machine, report) =
        linear_least_squares::fit_named(&base, effects, &borrowed, &day, asked.options.valid_days)?;
    for w in &report.warnings {
        say(InputNotice::Warning(w.clone()));
    }
    Ok(NamedEffectFitResult { machine, report, doubts, records })
}

impl ThermalFitResult {
    /// Whether the model may be kept.
    /// It may not if a unit, a sign, a direction or a column of a training record looks wrong.
    ///
    /// # Errors
    /// The first such suspicion.
    pub fn is_to_be_written(&self, train: &[&Path]) -> Result<(), InputError> {
        plausible::refuse(&self.doubts, train)
    }

    /// The fit as a document for programs.
    ///
    /// # Errors
    /// A figure that JSON does not have.
    pub fn document(&self) -> serde_json::Result<Value> {
        self.of(|r| serde_json::to_value(r))
    }

    /// The selection of sensors alone as a document for programs.
    ///
    /// # Errors
    /// A figure that JSON does not have.
    pub fn selection(&self) -> serde_json::Result<Value> {
        self.of(|r| {
            Ok(serde_json::json!({
                "response": r.response, "environment": r.environment, "environment_by": r.environment_by,
                "kept": r.kept, "dropped": r.dropped, "pairs": r.pairs, "rounds": r.rounds,
                "alternatives": r.alternatives, "warnings": r.warnings,
            }))
        })
    }

    fn of(&self, one: impl Fn(&ThermalFitReport) -> serde_json::Result<Value>) -> serde_json::Result<Value> {
        let mut all = self.reports.iter().map(one).collect::<serde_json::Result<Vec<_>>>()?;
        let mut document =
            if all.len() == 1 { all.remove(0) } else { serde_json::json!({ "responses": all }) };
        plausible::enter(&mut document, &self.doubts);
        Ok(document)
    }
}

impl NamedEffectFitResult {
    /// The fit as a document for programs.
    ///
    /// # Errors
    /// A figure that JSON does not have.
    pub fn document(&self) -> serde_json::Result<Value> {
        let mut document = serde_json::to_value(&self.report)?;
        plausible::enter(&mut document, &self.doubts);
        Ok(document)
    }

    /// What the base and the fitted model leave of each response.
    ///
    /// # Errors
    /// As [`Machine::predict`].
    pub fn charts(&self, base: Option<&Machine>) -> Result<Vec<Chart>, InputError> {
        let ideal = Machine::ideal("");
        let mut charts = Vec::new();
        for record in &self.records {
            let (before, after) = (
                base.unwrap_or(&ideal).without_prediction(record)?,
                self.machine.without_prediction(record)?,
            );
            let both = before.responses().zip(after.responses());
            charts.extend(both.map(|(b, a)| thermal::residual_chart(record, &b.role, &b.data, &a.data)));
        }
        Ok(charts)
    }
}

/// The day of the latest record with a date; today if none has one.
fn day_of(records: &[Record]) -> i64 {
    let dated = records.iter().filter_map(|r| date::parse(r.date.as_deref()?)).max();
    dated.unwrap_or_else(date::today)
}

/// Parses `T8-T18` or `T8`; names that contain a minus are tried whole first.
fn difference(text: &str, record: &Record) -> Result<TemperatureDifference, InputError> {
    if record.temperature(text).is_some() {
        return Ok(TemperatureDifference::single(text));
    }
    let known = |s: &str| record.temperature(s).is_some();
    let places = text.match_indices('-').map(|(i, _)| (&text[..i], &text[i + 1..]));
    let pair = places.into_iter().find(|(a, b)| known(a) && known(b));
    pair.map(|(a, b)| TemperatureDifference::pair(a, b)).ok_or_else(|| {
        let has = record.names(&Role::Temperature).collect::<Vec<_>>().join(", ");
        InputError::whole(
            Path::new("--sensors"),
            format!("`{text}`"),
            format!("a sensor or SENSOR-SENSOR of {has}"),
        )
    })
}

/// Differences that depend on those before them: T1-T0 beside T1-T2 and T2-T0.
fn closed(differences: &[TemperatureDifference]) -> Vec<String> {
    // Sensors that differences connect form one group. A further difference within a group is redundant.
    let mut group: BTreeMap<String, usize> = BTreeMap::new();
    let mut out = Vec::new();
    for (k, d) in differences.iter().enumerate() {
        let ends = if d.is_pair() {
            d.sensors().map(str::to_owned).collect::<Vec<_>>()
        } else {
            // The environment, whichever sensor it is.
            vec![d.to_string(), String::new()]
        };
        let own: Vec<usize> =
            ends.iter().enumerate().map(|(i, e)| *group.entry(e.clone()).or_insert(2 * k + i)).collect();
        if own[0] == own[1] {
            out.push(d.to_string());
        }
        group.values_mut().filter(|g| **g == own[1]).for_each(|g| *g = own[0]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_that_others_make_up_is_found() {
        let of = |all: &[(&str, &str)]| {
            let each = |(a, b): &(&str, &str)| match *b {
                "" => TemperatureDifference::single(a),
                minus => TemperatureDifference::pair(a, minus),
            };
            closed(&all.iter().map(each).collect::<Vec<_>>())
        };
        assert_eq!(of(&[("T1", "T2"), ("T2", "T0"), ("T1", "T0")]), ["T1-T0"]);
        assert_eq!(of(&[("T1", ""), ("T2", ""), ("T2", "T1")]), ["T2-T1"]);
        assert_eq!(of(&[("T1", "T0"), ("T2", "T0"), ("T3", "T4")]), [""; 0]);
        assert_eq!(of(&[("T1", ""), ("T2", "")]), [""; 0]);
    }
}
