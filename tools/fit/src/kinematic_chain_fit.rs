//! Fits a chain's polynomials to records, component by component (NISTIR 4854).
//! Every record measures one component, or a combination whose other members are known.
//!
//! The chain's file states the powers of a component's terms. Least squares on all error responses finds
//! their coefficients; the rest of the chain stays fixed. The error is linear in the coefficients except for
//! products of two small quantities. A second pass includes those.

use crate::linear_least_squares::{FittedValue, LinearProblem, unread};
use crate::thermal::residual_chart;
use rtec_files::InputError;
use rtec_measure::plot::Chart;
use rtec_model::kinematic_chain::{COMPONENTS, KinematicChain};
use rtec_model::record::{Record, Role};
use serde::Serialize;
use std::path::{Path, PathBuf};
use toml_edit::{DocumentMut, Item, TableLike, Value, value};

/// Smallest response to one µm or µrad of a coefficient that counts, µm.
const SEEN_UM: f64 = 1e-4;

/// One fitted coefficient of a chain's component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedChainTerm {
    /// Name of the joint.
    pub joint: String,
    /// The component, as `dx`.
    pub component: String,
    /// Power of the position, in units of 100 mm.
    pub p: u8,
    /// Power of the temperature difference, K.
    #[serde(rename = "dT")]
    pub dt: u8,
    /// The coefficient: µm for a displacement, µrad for a tilt.
    pub value: f64,
    /// Ends of its 95 % interval, in the same unit.
    pub interval: [f64; 2],
}

/// The result of fitting a chain's components.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChainFitReport {
    /// The fitted coefficients.
    pub terms: Vec<FittedChainTerm>,
    /// RMS per record and response, before and after, µm.
    /// Each response's own zero is subtracted.
    pub rms_um: Vec<(PathBuf, String, [f64; 2])>,
    /// Residuals at every row of the same, before and after, µm. For plots.
    #[serde(skip)]
    pub left_um: Vec<[Vec<f64>; 2]>,
    /// Arrays behind the fit, per response of the records that show a coefficient.
    #[serde(skip)]
    pub rows: Vec<ChainResponseRows>,
    /// Messages about the gauges' steps.
    pub warnings: Vec<String>,
}

impl ChainFitReport {
    /// What is left of each response of these records, before and after the fit.
    pub fn charts(&self, records: &[Record]) -> Vec<Chart> {
        let of_each = self.rms_um.iter().zip(&self.left_um);
        let charts = of_each.filter_map(|((of, response, _), [before, after])| {
            let record = records.iter().find(|r| r.path == *of)?;
            Some(residual_chart(record, &Role::parse(response)?, before, after))
        });
        charts.collect()
    }
}

/// One response of a record in a chain's fit; it has its own zero.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainResponseRows {
    /// The record's sidecar.
    pub record: PathBuf,
    /// The response, as `error.x`.
    pub response: String,
    /// The measured values, µm.
    pub measured: Vec<f64>,
    /// The fitted chain's values, µm.
    pub predicted: Vec<f64>,
    /// Change of the response per µm or µrad of each coefficient, µm.
    /// The order is that of [`ChainFitReport::terms`].
    pub derivatives: Vec<Vec<f64>>,
}

/// A record with the point that it measured.
#[derive(Debug, Clone, Copy)]
pub struct RecordWithToolPoint<'r> {
    /// The run that measured it.
    pub record: &'r Record,
    /// The point in the last frame of the tool branch, mm.
    /// `None` means the chain's own tool point. The same path measured at two points distinguishes a rotation
    /// from a displacement.
    pub tool_mm: Option<[f64; 3]>,
}

/// Indices of a coefficient: joint, component, term.
type CoefficientIndex = [usize; 3];

/// The places of the components named `JOINT.COMPONENT`.
fn places(chain: &KinematicChain, components: &[String]) -> Result<Vec<CoefficientIndex>, InputError> {
    let mut found = Vec::new();
    for text in components {
        let usage =
            |expected: String| InputError::whole(Path::new("--component"), format!("`{text}`"), expected);
        let known = || {
            let names = chain
                .joints
                .iter()
                .flat_map(|j| j.components.iter().map(move |c| format!("{}.{}", j.name, COMPONENTS[c.kind])));
            format!("JOINT.COMPONENT, one of {}", names.collect::<Vec<_>>().join(", "))
        };
        let (joint, kind) = text.rsplit_once('.').ok_or_else(|| usage(known()))?;
        let mut any = false;
        for (j, of) in chain.joints.iter().enumerate().filter(|(_, j)| j.name == joint) {
            for (c, component) in of.components.iter().enumerate() {
                if COMPONENTS[component.kind] == kind {
                    found.extend((0..component.terms.len()).map(|t| [j, c, t]));
                    any = true;
                }
            }
        }
        if !any {
            return Err(usage(known()));
        }
    }
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// The error for records that do not determine a coefficient.
fn not_determined(chain: &KinematicChain, [j, c, t]: CoefficientIndex) -> InputError {
    let joint = &chain.joints[j];
    let (component, term) = (&joint.components[c], &joint.components[c].terms[t]);
    let name = format!("{}.{}", joint.name, COMPONENTS[component.kind]);
    let (p, dt) = (term.position, term.temperature);
    InputError::whole(
        Path::new("--component"),
        format!("records that do not determine {name}, p = {p}, dT = {dt}, beside the terms before it"),
        "records in which its axis moves and its temperature varies, a gauge at another offset (@x,y,z behind its record) \
         for a rotation beside a displacement; a constant displacement is the gauge's zero",
    )
}

/// Root mean square about the mean, µm.
fn about_mean_um(left: &[f64]) -> f64 {
    let n = left.len() as f64;
    let mean = left.iter().sum::<f64>() / n;
    (left.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Fits the named components (`z slide.dx`) of a chain to the records.
///
/// # Errors
/// A component that the chain does not have, a record that lacks an axis or a sensor, coefficients that these
/// records do not determine.
pub fn fit(
    chain: &KinematicChain,
    components: &[String],
    runs: &[RecordWithToolPoint<'_>],
) -> Result<(KinematicChain, ChainFitReport), InputError> {
    let places = places(chain, components)?;
    let mut now = chain.clone();
    let set = |chain: &mut KinematicChain, [j, c, t]: CoefficientIndex, v: f64| {
        chain.joints[j].components[c].terms[t].coefficient = v;
    };
    let get = |chain: &KinematicChain, [j, c, t]: CoefficientIndex| {
        chain.joints[j].components[c].terms[t].coefficient
    };
    let says = |chain: &KinematicChain, run: &RecordWithToolPoint<'_>, role: &Role| {
        let mut out = vec![0.0; run.record.rows()];
        let mut chain = chain.clone();
        chain.tool_mm = run.tool_mm.unwrap_or(chain.tool_mm);
        chain.add(run.record, role, &mut out).map_err(|m| m.of(run.record))?;
        Ok::<_, InputError>(out)
    };
    let measured = |record: &Record| -> Vec<(Role, Vec<f64>)> {
        let of = record
            .responses()
            .filter(|c| matches!(&c.role, Role::Error(a) if ["x", "y", "z"].contains(&a.as_str())));
        of.map(|c| (c.role.clone(), c.data.clone())).collect()
    };
    // Change of a response per µm or µrad of each coefficient.
    let slopes = |chain: &KinematicChain, run: &RecordWithToolPoint<'_>, role: &Role, base: &[f64]| {
        let mut columns = Vec::with_capacity(places.len());
        for place in &places {
            let mut more = chain.clone();
            set(&mut more, *place, get(chain, *place) + 1.0);
            let with = says(&more, run, role)?;
            columns.push(with.iter().zip(base).map(|(w, b)| w - b).collect::<Vec<f64>>());
        }
        // A component that moves this response only in products with other errors counts as not visible in
        // it.
        for c in columns.iter_mut().filter(|c| c.iter().all(|v| v.abs() < SEEN_UM)) {
            c.fill(0.0);
        }
        let seen = columns.iter().flatten().any(|v| *v != 0.0);
        Ok::<_, InputError>(seen.then_some(columns))
    };
    let (mut found, mut warnings): (Vec<FittedValue>, Vec<String>) = (Vec::new(), Vec::new());
    for _ in 0..2 {
        warnings.clear();
        let mut problem = LinearProblem::new(places.len());
        for run in runs {
            for (role, y) in measured(run.record) {
                let base = says(&now, run, &role)?;
                let Some(columns) = slopes(&now, run, &role, &base)? else { continue };
                if let Some(said) = run.record.column(&role).and_then(|read| unread(run.record, read)) {
                    warnings.push(said);
                    continue;
                }
                let left: Vec<f64> = y.iter().zip(&base).map(|(y, b)| y - b).collect();
                problem.push(&left, &columns, false);
                if let Some(read) = run.record.column(&role) {
                    warnings.extend(problem.rounded_as(run.record, read));
                }
            }
        }
        found = problem.solve().map_err(|k| not_determined(chain, places[k]))?;
        for (place, f) in places.iter().zip(&mut found) {
            let before = get(&now, *place);
            f.value += before;
            f.interval = f.interval.map(|v| v + before);
            set(&mut now, *place, f.value);
        }
    }
    let (mut rms_um, mut left_um, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for run in runs {
        for (role, y) in measured(run.record) {
            let left = |c: &KinematicChain| {
                let left: Vec<f64> = y.iter().zip(says(c, run, &role)?).map(|(y, s)| y - s).collect();
                Ok::<_, InputError>(left)
            };
            let both = [left(chain)?, left(&now)?];
            let rms = both.each_ref().map(|left| about_mean_um(left));
            rms_um.push((run.record.path.clone(), role.to_string(), rms));
            left_um.push(both);
            let predicted = says(&now, run, &role)?;
            if let Some(derivatives) = slopes(&now, run, &role, &predicted)? {
                let (record, response) = (run.record.path.clone(), role.to_string());
                rows.push(ChainResponseRows { record, response, measured: y, predicted, derivatives });
            }
        }
    }
    let term = |(&[j, c, t], f): (&CoefficientIndex, &FittedValue)| {
        let joint = &chain.joints[j];
        let (component, term) = (&joint.components[c], &joint.components[c].terms[t]);
        FittedChainTerm {
            joint: joint.name.clone(),
            component: COMPONENTS[component.kind].to_owned(),
            p: term.position,
            dt: term.temperature,
            value: f.value,
            interval: f.interval,
        }
    };
    let terms = places.iter().zip(&found).map(term).collect();
    Ok((now, ChainFitReport { terms, rms_um, left_um, rows, warnings }))
}

/// Writes a fitted chain, see [`text`].
///
/// # Errors
/// The file that it was read from does not exist any more, or the new one cannot be written.
pub fn write(
    from: &Path,
    chain: &KinematicChain,
    report: &ChainFitReport,
    to: &Path,
) -> Result<(), InputError> {
    rtec_files::atomic_write::write_atomically(to, text(from, chain, report)?.as_bytes())
        .map_err(|e| InputError::whole(to, format!("error `{e}`"), "a file that can be written"))
}

/// The text of a fitted chain.
/// It is the file that was read, with the fitted coefficients and their intervals. Comments and order stay.
///
/// # Errors
/// The file that it was read from does not exist any more.
pub fn text(from: &Path, chain: &KinematicChain, report: &ChainFitReport) -> Result<String, InputError> {
    let text = rtec_files::text_file::read(from)?;
    let mut doc: DocumentMut =
        text.parse().map_err(|e| InputError::whole(from, format!("{e}"), "the chain that was read"))?;
    let interval = |joint: &str, kind: usize, p: u8, dt: u8| {
        let of = report.terms.iter().find(|t| {
            (t.joint.as_str(), t.component.as_str(), t.p, t.dt) == (joint, COMPONENTS[kind], p, dt)
        });
        of.map(|t| t.interval)
    };
    for (j, joint) in chain.joints.iter().enumerate() {
        let Some(table) = nth(doc.get_mut("joint"), j) else { continue };
        for (c, component) in joint.components.iter().enumerate() {
            let Some(of) = nth(table.get_mut("component"), c) else { continue };
            for (t, term) in component.terms.iter().enumerate() {
                let Some(entry) = nth(of.get_mut("terms"), t) else { continue };
                let Some(i) = interval(&joint.name, component.kind, term.position, term.temperature) else {
                    continue;
                };
                entry.insert("value", value(term.coefficient));
                entry.insert("interval", value(i.into_iter().collect::<toml_edit::Array>()));
            }
        }
    }
    Ok(doc.to_string())
}

/// The n-th table of an array of tables, in either of TOML's notations.
fn nth(item: Option<&mut Item>, n: usize) -> Option<&mut dyn TableLike> {
    match item? {
        Item::ArrayOfTables(tables) => tables.get_mut(n).map(|t| t as &mut dyn TableLike),
        Item::Value(Value::Array(array)) => match array.get_mut(n) {
            Some(Value::InlineTable(t)) => Some(t as &mut dyn TableLike),
            _ => None,
        },
        _ => None,
    }
}
