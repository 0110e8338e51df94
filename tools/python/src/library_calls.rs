//! Calls of the libraries: documents as text, plots as data.

use crate::border::{Answered, Failure, quietly, work};
use crate::machine::Machine;
use crate::record::Record;
use numpy::PyArray1;
use pyo3::prelude::*;
use rtec_control::config::Config;
use rtec_driver::quadrature::State;
use rtec_files::date;
use rtec_files::file_format_stamp::signed;
use rtec_files::quadrature_trace::{RequestedTotalReader, TraceReader, request_columns, trace_columns};
use rtec_files::{InputError, InputNotice};
use rtec_fit::kinematic_chain_fit::{
    self as chain_fit, ChainFitReport, ChainResponseRows, FittedChainTerm, RecordWithToolPoint,
};
use rtec_fit::thermal::{self, prediction_chart};
use rtec_fit::workflow;
use rtec_measure::compensation_export::linuxcnc::LinuxcncLinearUnit;
use rtec_measure::evaluation::{self, Standard};
use rtec_measure::figure_history::FigureTolerances;
use rtec_measure::iso230::TestConditions;
use rtec_measure::plan::{PlanAxis, for_machine, markdown};
use rtec_measure::plausible;
use rtec_measure::plot::PlotSpec;
use rtec_measure::{compensation_export, import};
use rtec_model::ballbar_circle::Circle;
use rtec_model::kinematic_chain::KinematicChain;
use rtec_model::record::Axis;
use rtec_part::part_error_request;
use rtec_reconcile::{
    ReconciliationOptions, RegressionArrays, RegressionColumn, RegressionRows, SEED, SetUpTermsIncluded,
};
use rtec_rt::axis::AxisConfig;
use rtec_sim::compensation_experiments::{EXPERIMENTS, ExperimentInputs};
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::corrected_machine_sim::MachineSpec;
use rtec_sim::engine_replay::ReplayError;
use rtec_sim::example_machines::EXAMPLES;
use rtec_sim::insertion_design_bench::{InsertionDesign, replay_any};
use rtec_sim::insertion_design_comparison::{TestMotion, compare};
use serde_json::json;
use std::path::{Path, PathBuf};

fn inners(records: Vec<Record>) -> Vec<rtec_model::record::Record> {
    records.into_iter().map(|r| r.inner).collect()
}

fn outers(records: Vec<rtec_model::record::Record>) -> Vec<Record> {
    records.into_iter().map(|inner| Record { inner }).collect()
}

fn bad(argument: &str, found: impl Into<String>, expected: impl Into<String>) -> Failure {
    InputError::whole(Path::new(argument), found, expected).into()
}

fn day(text: &str) -> Result<i64, Failure> {
    date::parse(text).ok_or_else(|| bad("date", format!("`{text}`"), "a day as YYYY-MM-DD"))
}

/// A document as `rtecctl … --json` prints it.
fn pretty(document: &impl serde::Serialize) -> Result<String, Failure> {
    Ok(signed(serde_json::to_string_pretty(document)?))
}

fn drawn(pictures: impl Iterator<Item = impl serde::Serialize>) -> Result<String, Failure> {
    Ok(serde_json::to_string(&pictures.collect::<Vec<_>>())?)
}

fn one_of<T: Copy>(argument: &str, name: &str, all: &[(&'static str, T)]) -> Result<T, Failure> {
    let names = || all.iter().map(|a| a.0).collect::<Vec<_>>().join(", ");
    let found = all.iter().find(|a| a.0 == name).map(|a| a.1);
    found.ok_or_else(|| bad(argument, format!("`{name}`"), format!("one of {}", names())))
}

/// A library's values with their names alone.
fn named<T, const N: usize>(all: [(&'static str, T, &'static str); N]) -> [(&'static str, T); N] {
    all.map(|(name, value, _)| (name, value))
}

/// Document, text, page and plots.
type Evaluated = (String, String, String, String);

#[pyfunction]
pub(crate) fn evaluate(
    py: Python<'_>,
    records: Vec<Record>,
    standard: Option<String>,
    conditions: Option<PathBuf>,
    one_way: bool,
    norm: u8,
) -> Answered<Evaluated> {
    work(py, move |say| {
        let names = || Standard::ALL.map(|s| s.0).join(", ");
        let parsed = |name: &String| {
            Standard::parse(name)
                .ok_or_else(|| bad("standard", format!("`{name}`"), format!("one of {}", names())))
        };
        if !(2..=4).contains(&norm) {
            return Err(bad("norm", norm.to_string(), "2 (squares) to 4 (fourth powers)"));
        }
        let asked = evaluation::EvaluationRequest {
            standard: standard.as_ref().map(parsed).transpose()?,
            conditions: conditions.as_deref().map(TestConditions::read).transpose()?.unwrap_or_default(),
            one_way,
            fourth_powers: norm != 2,
        };
        let found = evaluation::evaluate(&inners(records), &asked, say)?;
        let report = &found.report;
        Ok((pretty(&found.document)?, report.text(), report.html(), drawn(report.pictures())?))
    })
}

/// The options of a fit, from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct FitOptions {
    sensors: Vec<String>,
    environment: Option<String>,
    folds: usize,
    lag: bool,
    square: bool,
    base: Option<Machine>,
    date: Option<String>,
    valid_days: u16,
    despite_suspicions: bool,
}

impl FitOptions {
    fn asked(self) -> Result<workflow::FitRequest, Failure> {
        if !(3..=50).contains(&self.folds) {
            return Err(bad("folds", self.folds.to_string(), "3 to 50 blocks"));
        }
        Ok(workflow::FitRequest {
            sensors: self.sensors,
            date: self.date.map(|text| day(&text)).transpose()?,
            despite_suspicions: self.despite_suspicions,
            options: thermal::ThermalFitOptions {
                environment: self.environment,
                folds: self.folds,
                lag: self.lag,
                square: self.square,
                base: self.base.map(|m| m.inner),
                valid_days: i64::from(self.valid_days),
                ..thermal::ThermalFitOptions::default()
            },
        })
    }
}

/// Document, model, plots and the records as fitted.
type Fitted = (String, Machine, String, Vec<Record>);

/// Fits growth by chosen sensors; with `selection` it only chooses them.
#[pyfunction]
pub(crate) fn fit(
    py: Python<'_>,
    train: Vec<Record>,
    holdout: Vec<Record>,
    asked: FitOptions,
    selection: bool,
) -> Answered<Fitted> {
    work(py, move |say| {
        let asked = asked.asked()?;
        let (train, holdout) = (inners(train), inners(holdout));
        let paths: Vec<PathBuf> = train.iter().map(|r| r.path.clone()).collect();
        let done = workflow::fit(train, holdout, &asked, say)?;
        if !selection && !asked.despite_suspicions {
            done.is_to_be_written(&paths.iter().map(AsRef::as_ref).collect::<Vec<_>>())?;
        }
        let document = if selection { done.selection()? } else { done.document()? };
        let pictures = drawn(done.reports.iter().map(|r| PlotSpec::from(r.chart())))?;
        Ok((pretty(&document)?, Machine { inner: done.machine }, pictures, outers(done.records)))
    })
}

#[pyfunction]
pub(crate) fn fit_named(
    py: Python<'_>,
    records: Vec<Record>,
    effects: Vec<String>,
    asked: FitOptions,
) -> Answered<Fitted> {
    work(py, move |say| {
        if effects.is_empty() {
            return Err(bad("effects", "none", "names of effects, as scale.x"));
        }
        let asked = asked.asked()?;
        let done = workflow::fit_named(inners(records), &effects, &asked, say)?;
        let pictures = done.charts(asked.options.base.as_ref())?.into_iter().map(PlotSpec::from);
        let (document, pictures) = (pretty(&done.document()?)?, drawn(pictures)?);
        Ok((document, Machine { inner: done.machine }, pictures, outers(done.records)))
    })
}

/// Document, the chain's text, plots, and the arrays behind the fit.
type FittedChain<'py> = (String, String, String, Arrays<'py>);

/// Fits components of a chain to records and the tool points that they measured.
#[pyfunction]
pub(crate) fn fit_chain(
    py: Python<'_>,
    chain: PathBuf,
    components: Vec<String>,
    records: Vec<Record>,
    tools_mm: Vec<Option<[f64; 3]>>,
) -> PyResult<FittedChain<'_>> {
    let (document, text, pictures, of) = quietly(py, move || {
        let from = KinematicChain::read(&chain)?;
        let good = |record| plausible::only_good(record, &mut |_| ());
        let records: Vec<_> = inners(records).into_iter().map(good).collect();
        if components.is_empty() || records.is_empty() {
            return Err(bad("fit_chain", "nothing to fit", "components, and records that measure them"));
        }
        if let Some(point) = tools_mm.iter().flatten().find(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(bad("tool_mm", format!("{point:?}"), "x, y, z in mm"));
        }
        let runs: Vec<RecordWithToolPoint<'_>> = records
            .iter()
            .zip(tools_mm)
            .map(|(record, tool_mm)| RecordWithToolPoint { record, tool_mm })
            .collect();
        let (fitted, report) = chain_fit::fit(&from, &components, &runs)?;
        let text = chain_fit::text(&chain, &fitted, &report)?;
        let pictures = report.charts(&records).into_iter().map(PlotSpec::from);
        Ok((pretty(&report)?, text, drawn(pictures)?, regression_of_chain(&records, &report)))
    })?;
    Ok((document, text, pictures, arrays(py, of)))
}

/// Rows and columns of a chain's fit.
/// The columns are its coefficients, and the zero of each response of each record.
fn regression_of_chain(records: &[rtec_model::record::Record], report: &ChainFitReport) -> RegressionArrays {
    let file =
        |path: &Path| records.iter().find(|r| r.path == path).map_or_else(String::new, |r| r.file.clone());
    let of_rows = |r: &ChainResponseRows| RegressionRows {
        record: file(&r.record),
        response: r.response.clone(),
        unit: "um",
        count: r.measured.len(),
    };
    let together = |of: &dyn Fn(usize, &ChainResponseRows) -> Vec<f64>| -> Vec<f64> {
        report.rows.iter().enumerate().flat_map(|(k, r)| of(k, r)).collect()
    };
    let coefficient = |(n, t): (usize, &FittedChainTerm)| RegressionColumn {
        name: format!("{}.{}", t.joint, t.component),
        parameter: format!("p{} dT{}", t.p, t.dt),
        unit: if t.component.starts_with('d') { "um" } else { "urad" }.to_owned(),
        value: Some(t.value),
        half_width: Some(0.5 * (t.interval[1] - t.interval[0])),
        derivative: together(&|_, r| r.derivatives[n].clone()),
    };
    let zero = |(n, r): (usize, &ChainResponseRows)| RegressionColumn {
        name: format!("zero of {}", r.response),
        parameter: file(&r.record),
        unit: "um".to_owned(),
        value: None,
        half_width: None,
        derivative: together(&|k, r| vec![f64::from(u8::from(k == n)); r.measured.len()]),
    };
    let coefficients = report.terms.iter().enumerate().map(coefficient);
    RegressionArrays {
        rows: report.rows.iter().map(of_rows).collect(),
        measured: together(&|_, r| r.measured.clone()),
        predicted: together(&|_, r| r.predicted.clone()),
        columns: coefficients.chain(report.rows.iter().enumerate().map(zero)).collect(),
    }
}

/// Document and plots.
#[pyfunction]
pub(crate) fn validate(py: Python<'_>, machine: Machine, records: Vec<Record>) -> Answered<(String, String)> {
    work(py, move |say| {
        if records.is_empty() {
            return Err(bad("validate", "no record", "records that the model has not seen"));
        }
        let found = rtec_fit::validate::validate(&machine.inner, &inners(records), say)?;
        Ok((pretty(&found.document)?, drawn(found.charts.into_iter().map(PlotSpec::from))?))
    })
}

/// The options of an export, from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ExportOptions {
    axis: String,
    from_mm: f64,
    to_mm: f64,
    step_mm: Option<f64>,
    limit_um: f64,
    max_points: Option<usize>,
    temperatures_degc: Vec<(String, f64)>,
    at_mm: Vec<(String, f64)>,
    format: String,
    unit: String,
    along: Option<String>,
    along_name: Option<String>,
    table: u16,
    positive_moves: Option<String>,
    axis_name: Option<String>,
    encoder: u8,
    reference_mm: Option<f64>,
    axis_number: Option<u16>,
    form: Option<PathBuf>,
}

/// Document and the table's text.
#[pyfunction]
pub(crate) fn export_table(
    py: Python<'_>,
    machine: Machine,
    asked: ExportOptions,
) -> Answered<(String, String)> {
    work(py, move |say| {
        let order = compensation_export::request::ExportRequest {
            axis: asked.axis,
            wanted: compensation_export::TableRange {
                from_mm: asked.from_mm,
                to_mm: asked.to_mm,
                step_mm: asked.step_mm,
                limit_um: asked.limit_um,
                most: asked.max_points,
            },
            temperatures_degc: asked.temperatures_degc,
            at_mm: asked.at_mm,
            to: compensation_export::request::ControllerTableFormat {
                format: one_of(
                    "format",
                    &asked.format,
                    &named(compensation_export::request::ExportFormat::ALL),
                )?,
                unit: one_of("unit", &asked.unit, &named(LinuxcncLinearUnit::ALL))?,
                along: asked.along,
                along_name: asked.along_name,
                table: asked.table,
                positive_moves_up: asked
                    .positive_moves
                    .map(|way| one_of("positive_moves", &way, &[("up", true), ("down", false)]))
                    .transpose()?,
                axis_name: asked.axis_name,
                encoder: asked.encoder,
                reference_mm: asked.reference_mm,
                axis_number: asked.axis_number,
                form: asked.form,
            },
        };
        let done = order.of(&machine.inner)?;
        let file = machine.inner.path.display();
        done.warnings.iter().for_each(|w| say(InputNotice::Warning(format!("{file}: {w}"))));
        done.notes.into_iter().for_each(|n| say(InputNotice::Note(n)));
        Ok((pretty(&done.document)?, done.text))
    })
}

/// The options of an import, from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ImportOptions {
    file: PathBuf,
    format: String,
    out: PathBuf,
    axis: Option<String>,
    columns: Vec<String>,
    kind: String,
    decimal_comma: Option<bool>,
    log: bool,
    period_s: Option<f64>,
    numbered: bool,
    unit: String,
    form: Option<PathBuf>,
    derive: bool,
    radius_mm: Option<f64>,
    plane: Option<[String; 2]>,
}

/// Another tool's file as a record, which is not yet written.
#[pyfunction]
pub(crate) fn import_record(py: Python<'_>, asked: ImportOptions) -> Answered<Record> {
    work(py, move |say| {
        let circle = match (asked.radius_mm, asked.plane) {
            (Some(radius_mm), Some([a, b])) => {
                let axes = Axis::new(&a).zip(Axis::new(&b));
                let (a, b) = axes.ok_or_else(|| bad("plane", format!("{a}, {b}"), "two axes, as x and y"))?;
                Some(Circle { radius_mm, plane: [a, b], centre_mm: None })
            }
            _ => None,
        };
        let out = asked.out;
        let asked = import::request::ImportRequest {
            file: asked.file,
            format: one_of("format", &asked.format, &named(import::request::ImportFormat::ALL))?,
            axis: asked.axis,
            columns: asked.columns,
            kind: asked.kind,
            decimal_comma: asked.decimal_comma,
            log: asked.log,
            period_s: asked.period_s,
            numbered: asked.numbered,
            unit: one_of("unit", &asked.unit, &named(LinuxcncLinearUnit::ALL))?,
            form: asked.form,
            derive: asked.derive,
        };
        let inner = asked.read(circle, &out, say)?;
        if let Some(note) = &inner.note {
            say(InputNotice::Note(note.clone()));
        }
        plausible::report_suspicions(std::slice::from_ref(&inner), say);
        Ok(Record { inner })
    })
}

/// A plot of measured and predicted over time, with the interval if known.
#[pyfunction]
pub(crate) fn prediction_picture(py: Python<'_>, machine: &Machine, record: &Record) -> Answered<String> {
    let (machine, record) = (machine.inner.clone(), record.inner.clone());
    work(py, move |say| {
        let record = plausible::only_good(record, say);
        let says = rtec_measure::prediction::predict(&machine, &record, say)?;
        let chart = |(response, (_, data)): (&rtec_model::record::Column, &(String, Vec<f64>))| {
            let widths = machine.half_widths_um(&record, &response.role);
            PlotSpec::from(prediction_chart(&record, response, data, widths.as_deref()))
        };
        drawn(record.responses().zip(&says).map(chart))
    })
}

/// Document, model, page, plots, a law's file, records as used.
/// The law's file exists if a curve was requested and something was unexplained.
type Reconciled = (String, Machine, String, String, Option<String>, Vec<Record>);

#[pyfunction]
pub(crate) fn reconcile(
    py: Python<'_>,
    train: Vec<Record>,
    machine: Machine,
    holdout: Vec<Record>,
    level: f64,
    unexplained: bool,
    date: Option<String>,
) -> Answered<Reconciled> {
    work(py, move |say| {
        if train.is_empty() {
            return Err(bad("reconcile", "no record", "a record to learn from"));
        }
        if !(level > 0.0 && level < 0.5) {
            return Err(bad("level", level.to_string(), "a probability above 0 and below 0.5"));
        }
        date.as_deref().map(day).transpose()?;
        let date = date.or_else(|| Some(date::format(date::today())));
        let options = ReconciliationOptions { level, date, unexplained, figures: true };
        let (train, holdout) = (inners(train), inners(holdout));
        let answer = rtec_reconcile::reconcile(&train, &holdout, &machine.inner, &options)?;
        answer.say_of(&train, &holdout, say);
        let page = rtec_reconcile::html(&answer, machine.inner.name());
        let pictures = rtec_reconcile::pictures(&answer);
        let (document, laws) = (answer.to_json(), answer.curve.map(|(_, laws)| laws));
        let model = Machine { inner: answer.model };
        Ok((pretty(&document)?, model, page, drawn(pictures.iter())?, laws, outers(answer.records)))
    })
}

/// A column of a regression.
/// It has effect or set-up term, parameter, unit, value, half width and the derivative row by row.
type Column<'py> = (String, String, String, Option<f64>, Option<f64>, Bound<'py, PyArray1<f64>>);
/// Rows (record, response, unit, count), measured, predicted, columns.
type Arrays<'py> = (
    Vec<(String, String, &'static str, usize)>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Vec<Column<'py>>,
);

/// The regression behind a fit or a verdict.
#[pyfunction]
pub(crate) fn regression(
    py: Python<'_>,
    records: Vec<Record>,
    base: Option<Machine>,
    machine: Machine,
    of_verdict: bool,
) -> PyResult<Arrays<'_>> {
    let of = quietly(py, move || {
        let base = base.map_or_else(|| rtec_model::machine::Machine::ideal(""), |b| b.inner);
        let set_up = if of_verdict { SetUpTermsIncluded::ByHand } else { SetUpTermsIncluded::Zeros };
        Ok(RegressionArrays::new(&inners(records), &base, &machine.inner, set_up))
    })?;
    Ok(arrays(py, of))
}

fn arrays(py: Python<'_>, of: RegressionArrays) -> Arrays<'_> {
    let rows = of.rows.into_iter().map(|r| (r.record, r.response, r.unit, r.count)).collect();
    let array = |data: Vec<f64>| PyArray1::from_vec(py, data);
    let column =
        |c: RegressionColumn| (c.name, c.parameter, c.unit, c.value, c.half_width, array(c.derivative));
    (rows, array(of.measured), array(of.predicted), of.columns.into_iter().map(column).collect())
}

/// Only the first stage of a reconciliation.
#[pyfunction]
pub(crate) fn where_they_disagree(
    py: Python<'_>,
    train: Vec<Record>,
    machine: Machine,
    level: f64,
) -> PyResult<String> {
    quietly(py, move || {
        if train.is_empty() {
            return Err(bad("reconcile", "no record", "a record to learn from"));
        }
        let places = rtec_reconcile::find(&inners(train), &machine.inner, level)?;
        pretty(&json!({"where": places, "level": level, "seed": SEED}))
    })
}

/// The document, and the same as Markdown.
#[pyfunction]
pub(crate) fn plan(
    py: Python<'_>,
    axes: Vec<(String, f64)>,
    machine: String,
    max_rpm: f64,
    ballbar_mm: Option<f64>,
) -> Answered<(String, String)> {
    work(py, move |say| {
        let axes: Vec<PlanAxis> =
            axes.into_iter().map(|(name, travel_mm)| PlanAxis { name, travel_mm }).collect();
        let steps = for_machine(&axes, max_rpm, ballbar_mm, say)?;
        Ok((pretty(&steps)?, markdown(&machine, &steps)))
    })
}

/// The document, and the same as a table.
#[pyfunction]
pub(crate) fn designs(
    py: Python<'_>,
    computer: String,
    encoder_hz: f64,
    accel_counts_s2: f64,
    counts: u64,
    seed: u64,
) -> PyResult<(String, String)> {
    quietly(py, move || {
        let all = [("8051", ComputerTiming::i8051 as fn() -> ComputerTiming), ("dsp", ComputerTiming::dsp)];
        let computer = one_of("computer", &computer, &all)?();
        for (name, v, low, high) in
            [("encoder_hz", encoder_hz, 0.1, 1e8), ("accel_counts_s2", accel_counts_s2, 1.0, 1e12)]
        {
            if !(low..=high).contains(&v) {
                return Err(bad(name, v.to_string(), format!("a number from {low:e} to {high:e}")));
            }
        }
        if !(100..=10_000_000).contains(&counts) {
            return Err(bad("counts", counts.to_string(), "a number from 100 to 10000000"));
        }
        let motion = TestMotion { encoder_hz, accel_counts_s2, counts, ..TestMotion::default() };
        let comparison = compare(&computer, motion, seed);
        Ok((pretty(&comparison)?, comparison.to_table()))
    })
}

#[pyfunction]
pub(crate) fn replay(
    py: Python<'_>,
    trace: PathBuf,
    requests: PathBuf,
    columns: (Vec<String>, Vec<String>),
    design: String,
    config: Option<PathBuf>,
    axis: Option<String>,
) -> PyResult<(String, bool)> {
    quietly(py, move || {
        let (engine, large) = match &config {
            None => (AxisConfig::default(), true),
            Some(file) => (Config::load(file)?.replayed_axis(file, axis.as_deref())?, false),
        };
        let design = one_of("design", &design, &InsertionDesign::ALL.map(|d| (d.name(), d)))?;
        let trace = TraceReader::open_columns(&trace, &trace_columns(&columns.0)?)?;
        let requests = RequestedTotalReader::open_beside(&requests, &request_columns(&columns.1)?, &trace)?;
        let trace = trace.playable();
        let played = replay_any(design, engine, trace, requests, large, |_, _: State| {});
        let (outcome, _) = played.map_err(|error| match error {
            ReplayError::Input(error) => Failure::from(error),
            ReplayError::Start(error) => bad("replay", error.to_string(), "an axis that can be corrected"),
        })?;
        let sound = outcome.faults.is_empty() && outcome.balanced() && outcome.illegal_out == 0;
        Ok((signed(serde_json::to_string(&outcome)?), sound))
    })
}

/// The options for probed points, from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct PartErrorOptions {
    points: PathBuf,
    columns: Vec<String>,
    radius_mm: Option<f64>,
    tip_mm: Option<f64>,
    feature: Option<String>,
    taper_deg: Option<f64>,
    machine: Option<PathBuf>,
    origin_mm: Option<Vec<f64>>,
    expected: Option<PathBuf>,
    path: Option<PathBuf>,
    trip_window_mm: f64,
    with_size: bool,
}

/// The document, `error.cor` and the whiskers as SVG.
#[pyfunction]
pub(crate) fn part_errors(py: Python<'_>, asked: PartErrorOptions) -> Answered<(String, String, String)> {
    work(py, move |say| {
        let features = named(part_error_request::ProbedFeatureKind::ALL);
        let report = part_error_request::determine(
            &part_error_request::PartErrorRequest {
                points: asked.points,
                columns: asked.columns,
                radius_mm: asked.radius_mm,
                tip_mm: asked.tip_mm,
                feature: asked.feature.as_deref().map(|f| one_of("feature", f, &features)).transpose()?,
                taper_deg: asked.taper_deg,
                machine: asked.machine,
                origin_mm: asked.origin_mm,
                expected: asked.expected,
                path: asked.path,
                path_units: rtec_part::length_unit::LengthUnit::MM,
                trip_window_mm: asked.trip_window_mm,
                with_size: asked.with_size,
            },
            say,
        )?;
        let document = pretty(&report)?;
        Ok((document, report.error_cor(asked.with_size), report.whisker_svg()))
    })
}

/// An experiment's records and its figures.
/// The records are measured without and with compensation.
#[pyfunction]
pub(crate) fn simulate(
    py: Python<'_>,
    name: String,
    truth: Option<Machine>,
    known: Option<Machine>,
    seed: u64,
    out: PathBuf,
) -> PyResult<(Vec<Record>, String)> {
    quietly(py, move || {
        let found = one_of("simulate", &name, &EXPERIMENTS.each_ref().map(|e| (e.name, e)))?;
        let truth = if let Some(machine) = truth {
            machine.inner
        } else {
            let expected = format!("a machine: {name} brings none of its own");
            found.own_machine()?.ok_or_else(|| bad("simulate", "no machine", expected))?
        };
        let known = known.map(|m| m.inner);
        let spec = MachineSpec::machining_centre();
        let setting = ExperimentInputs { spec: &spec, truth: &truth, known: known.as_ref(), seed, out: &out };
        let done = found.run(&setting)?;
        Ok((outers(done.records), serde_json::to_string_pretty(&done.summary)?))
    })
}

/// Paths and texts.
type Texts = Vec<(String, String)>;

/// An example machine's records and files (path below the folder, text).
#[pyfunction]
pub(crate) fn example(py: Python<'_>, name: String, folder: PathBuf) -> PyResult<(Vec<Record>, Texts)> {
    quietly(py, move || {
        let found = one_of("example", &name, &EXAMPLES.each_ref().map(|e| (e.name, e)))?;
        let files = found.files.iter().map(|(n, t)| ((*n).to_owned(), (*t).to_owned())).collect();
        Ok((outers(found.records(&folder)?), files))
    })
}

/// The document, text, page, pictures.
#[pyfunction]
pub(crate) fn history(
    py: Python<'_>,
    machine: String,
    records: Vec<PathBuf>,
    made: Vec<Record>,
    limits: Vec<(String, f64)>,
    limits_file: Option<PathBuf>,
) -> PyResult<(String, String, String, String)> {
    quietly(py, move || {
        let limits = match limits_file {
            Some(file) => FigureTolerances::read(&file)?,
            None => FigureTolerances::of(limits),
        };
        let read = records.iter().map(|p| (p.display().to_string(), rtec_measure::run_record_files::read(p)));
        let made = inners(made).into_iter().map(|r| (r.path.display().to_string(), Ok(r)));
        let all: Vec<_> = read.chain(made).collect();
        let found = rtec_measure::figure_history::history(&machine, &all, &limits);
        let report = found.report()?;
        Ok((pretty(&found)?, report.text(), report.html(), drawn(report.pictures())?))
    })
}
