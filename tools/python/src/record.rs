//! Run records as numpy arrays, in both directions.

use crate::border::{Failure, quietly};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::{PyIndexError, PyKeyError};
use pyo3::prelude::*;
use rtec_files::InputError;
use rtec_files::date;
use rtec_measure::plausible;
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Column, Role, RunKind};
use std::path::{Path, PathBuf};

type Inner = rtec_model::record::Record;

/// One run: its columns in order, rows in order of acquisition.
#[pyclass(frozen, module = "rtec", from_py_object)]
#[derive(Clone)]
pub(crate) struct Record {
    pub(crate) inner: Inner,
}

/// A column from Python: name, role, unit, values.
/// Without a unit it has the role's own.
type ColumnInput<'py> = (String, String, Option<String>, PyReadonlyArray1<'py, f64>);

struct RecordProperties {
    count_um: Option<f64>,
    date: Option<String>,
    note: Option<String>,
    zero: Option<String>,
    circle: Option<(f64, [String; 2])>,
    sha256: Option<String>,
}

fn made(
    path: &Path,
    kind: &str,
    columns: Vec<(String, String, Option<String>, Vec<f64>)>,
    about: RecordProperties,
    log: bool,
) -> Result<Inner, Failure> {
    let bad = |found: String, expected: &str| InputError::whole(path, found, expected);
    let kinds = || RunKind::ALL.map(|k| k.0).join(", ");
    let kind =
        RunKind::parse(kind).ok_or_else(|| bad(format!("kind `{kind}`"), &format!("one of {}", kinds())))?;
    let named = |(name, role, unit, data): (String, String, Option<String>, Vec<f64>)| {
        let own = Role::parse(&role).ok_or_else(|| {
            bad(format!("role `{role}` of `{name}`"), rtec_measure::run_record_files::ROLES)
        })?;
        let column = Column::new(&name, own, data);
        Ok(match unit {
            Some(unit) => Column { unit, ..column },
            None => column,
        })
    };
    let columns = columns.into_iter().map(named).collect::<Result<Vec<_>, InputError>>()?;
    if columns.is_empty() {
        return Err(bad("no column".to_owned(), "a column of role error.AXIS or force.AXIS").into());
    }
    let make = if log { Inner::log } else { Inner::new };
    let mut record = make(path, kind, columns)?;
    if let Some(um) = about.count_um.filter(|um| !(um.is_finite() && *um > 0.0)) {
        return Err(bad(format!("count_um = {um}"), "a number above zero, µm").into());
    }
    if let Some(day) = about.date.as_ref().filter(|d| date::parse(d).is_none()) {
        return Err(bad(format!("date `{day}`"), "a day as YYYY-MM-DD").into());
    }
    (record.count_um, record.date, record.note, record.zero) =
        (about.count_um, about.date, about.note, about.zero);
    record.sha256 = about.sha256.unwrap_or(record.sha256);
    if let Some((radius_mm, [first, second])) = about.circle {
        let axis = |n: &String| {
            Axis::new(n).ok_or_else(|| bad(format!("plane of `{n}`"), "two axes, as [\"x\", \"y\"]"))
        };
        let plane = [axis(&first)?, axis(&second)?];
        record = record
            .with_circle(Circle { radius_mm, plane, centre_mm: None })
            .map_err(|(found, expected)| bad(found, expected))?;
    }
    rtec_measure::run_record_files::can_be_written(&record)?;
    Ok(record)
}

#[pymethods]
impl Record {
    #[new]
    #[pyo3(signature = (path, kind, columns, *, count_um=None, date=None, note=None, zero=None, circle=None, sha256=None, log=false))]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        kind: String,
        columns: Vec<ColumnInput<'_>>,
        count_um: Option<f64>,
        date: Option<String>,
        note: Option<String>,
        zero: Option<String>,
        circle: Option<(f64, [String; 2])>,
        sha256: Option<String>,
        log: bool,
    ) -> PyResult<Self> {
        let columns: Vec<_> =
            columns.into_iter().map(|(n, r, u, data)| (n, r, u, data.as_array().to_vec())).collect();
        let about = RecordProperties { count_um, date, note, zero, circle, sha256 };
        quietly(py, move || made(&path, &kind, columns, about, log)).map(|inner| Self { inner })
    }

    #[staticmethod]
    #[pyo3(signature = (path, *, log=false))]
    fn read(py: Python<'_>, path: PathBuf, log: bool) -> PyResult<Self> {
        let read =
            if log { rtec_measure::run_record_files::read_log } else { rtec_measure::run_record_files::read };
        quietly(py, move || Ok(read(&path)?)).map(|inner| Self { inner })
    }

    fn write(&self, py: Python<'_>, path: Option<PathBuf>) -> PyResult<Self> {
        let mut inner = self.inner.clone();
        quietly(py, move || {
            if let Some(path) = path {
                rtec_measure::run_record_files::at(&mut inner, &path)?;
            }
            rtec_measure::run_record_files::write(&mut inner)?;
            Ok(Self { inner })
        })
    }

    fn to_csv(&self, py: Python<'_>) -> PyResult<String> {
        let inner = self.inner.clone();
        quietly(py, move || Ok(rtec_measure::run_record_files::to_csv(&inner)))
    }

    fn to_sidecar(&self) -> String {
        rtec_measure::run_record_files::to_sidecar(&self.inner)
    }

    #[getter]
    fn path(&self) -> String {
        self.inner.path.display().to_string()
    }

    #[getter]
    fn file(&self) -> &str {
        &self.inner.file
    }

    #[getter]
    fn sha256(&self) -> &str {
        &self.inner.sha256
    }

    #[getter]
    fn kind(&self) -> &str {
        self.inner.kind.name()
    }

    #[getter]
    fn count_um(&self) -> Option<f64> {
        self.inner.count_um
    }

    #[getter]
    fn date(&self) -> Option<&str> {
        self.inner.date.as_deref()
    }

    #[getter]
    fn note(&self) -> Option<&str> {
        self.inner.note.as_deref()
    }

    #[getter]
    fn zero(&self) -> Option<&str> {
        self.inner.zero.as_deref()
    }

    #[getter]
    fn circle(&self) -> Option<(f64, [String; 2])> {
        self.inner.circle().map(|c| (c.radius_mm, c.plane.clone().map(|a| a.to_string())))
    }

    #[getter]
    fn columns(&self) -> Vec<(String, String, String)> {
        self.inner.columns.iter().map(|c| (c.name.clone(), c.role.to_string(), c.unit.clone())).collect()
    }

    #[getter]
    fn responses(&self) -> Vec<String> {
        self.inner.responses().map(|c| c.name.clone()).collect()
    }

    #[getter]
    fn time_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.inner.time_s())
    }

    fn __len__(&self) -> usize {
        self.inner.rows()
    }

    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let named = |c: &&Column| c.name == name || c.label() == name;
        let column = self.inner.columns.iter().find(named);
        let column = column.ok_or_else(|| PyKeyError::new_err(name.to_owned()))?;
        Ok(PyArray1::from_slice(py, &column.data))
    }

    fn select(&self, py: Python<'_>, rows: Vec<usize>) -> PyResult<Self> {
        if let Some(row) = rows.iter().find(|r| **r >= self.inner.rows()) {
            return Err(PyIndexError::new_err(format!("row {row} of {}", self.inner.rows())));
        }
        let from = self.inner.clone();
        quietly(py, move || {
            if rows.is_empty() {
                return Err(InputError::whole(&from.path, "no rows", "at least one").into());
            }
            let inner = from.select(&rows);
            // Checks that time does not decrease.
            Inner::new(&inner.path, inner.kind, inner.columns.clone())?;
            Ok(Self { inner })
        })
    }

    fn suspicions(&self, py: Python<'_>) -> PyResult<String> {
        let inner = self.inner.clone();
        quietly(py, move || Ok(serde_json::to_string(&plausible::suspicions(std::slice::from_ref(&inner)))?))
    }

    fn __repr__(&self) -> String {
        let roles: Vec<String> = self.inner.columns.iter().map(Column::label).collect();
        format!(
            "<rtec.Record {}: {}, {} rows of {}>",
            self.path(),
            self.kind(),
            self.inner.rows(),
            roles.join(", ")
        )
    }
}
