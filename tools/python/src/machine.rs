//! Machine models: reading, properties, prediction, writing.

use crate::border::{Answered, quietly, work};
use crate::record::Record;
use numpy::PyArray1;
use pyo3::prelude::*;
use rtec_files::InputError;
use rtec_files::date;
use rtec_model::record::Role;
use std::collections::BTreeMap;
use std::path::PathBuf;

type Inner = rtec_model::machine::Machine;

/// A machine model: a named list of effects, the content of one `machine.toml`.
#[pyclass(frozen, module = "rtec", from_py_object)]
#[derive(Clone)]
pub(crate) struct Machine {
    pub(crate) inner: Inner,
}

/// Arrays by the response's column name.
type Predicted<'py> = BTreeMap<String, Bound<'py, PyArray1<f64>>>;

fn day(text: Option<&str>) -> Result<i64, InputError> {
    text.map_or_else(
        || Ok(date::today()),
        |t| {
            let expected = "a day as YYYY-MM-DD";
            date::parse(t).ok_or_else(|| InputError::whole("today".as_ref(), format!("`{t}`"), expected))
        },
    )
}

#[pymethods]
impl Machine {
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        quietly(py, move || Ok(Self { inner: Inner::read(&path)? }))
    }

    #[staticmethod]
    #[pyo3(signature = (text, path=None))]
    fn parse(py: Python<'_>, text: String, path: Option<PathBuf>) -> PyResult<Self> {
        let path = path.unwrap_or_else(|| PathBuf::from("machine.toml"));
        quietly(py, move || Ok(Self { inner: Inner::parse(&path, &text)? }))
    }

    #[staticmethod]
    fn ideal(name: &str) -> Self {
        Self { inner: Inner::ideal(name) }
    }

    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let inner = self.inner.clone();
        quietly(py, move || Ok(inner.write(&path)?))
    }

    fn to_text(&self) -> String {
        self.inner.to_text()
    }

    #[getter]
    fn name(&self) -> &str {
        self.inner.name()
    }

    #[getter]
    fn path(&self) -> String {
        self.inner.path.display().to_string()
    }

    #[getter]
    fn sha256(&self) -> &str {
        self.inner.sha256()
    }

    #[getter]
    fn sensors(&self) -> Vec<String> {
        self.inner.sensors()
    }

    fn to_json(&self, py: Python<'_>) -> PyResult<String> {
        let inner = self.inner.clone();
        quietly(py, move || {
            Ok(rtec_files::file_format_stamp::signed(serde_json::to_string_pretty(&inner.to_json())?))
        })
    }

    /// Predicted response of every row, by the response's column name.
    /// The second value holds the messages.
    fn predict<'py>(&self, py: Python<'py>, record: &Record) -> Answered<Predicted<'py>> {
        let (machine, record) = (self.inner.clone(), record.inner.clone());
        let (columns, said) =
            work(py, move |say| Ok(rtec_measure::prediction::predict(&machine, &record, say)?))?;
        Ok((columns.into_iter().map(|(name, data)| (name, PyArray1::from_vec(py, data))).collect(), said))
    }

    fn predicted_csv(&self, py: Python<'_>, record: &Record, interval: bool) -> Answered<String> {
        let (machine, record) = (self.inner.clone(), record.inner.clone());
        work(py, move |say| Ok(rtec_measure::prediction::csv(&machine, &record, interval, say)?))
    }

    /// Half width of the 95 % interval at every row, µm.
    /// `None` if no fit of the response states one for such a run.
    fn half_widths_um<'py>(
        &self,
        py: Python<'py>,
        record: &Record,
        response: &str,
    ) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let (machine, record, response) = (self.inner.clone(), record.inner.clone(), response.to_owned());
        let widths = quietly(py, move || {
            let found = format!("response `{response}`");
            let expected = "error.AXIS or force.AXIS";
            let role = Role::parse(&response)
                .ok_or_else(|| InputError::whole("half_widths_um".as_ref(), found, expected))?;
            Ok(machine.half_widths_um(&record, &role))
        })?;
        Ok(widths.map(|w| PyArray1::from_vec(py, w)))
    }

    /// The record with the model's prediction subtracted.
    fn beyond(&self, py: Python<'_>, record: &Record) -> PyResult<Record> {
        let (machine, record) = (self.inner.clone(), record.inner.clone());
        quietly(py, move || Ok(Record { inner: machine.without_prediction(&record)? }))
    }

    fn doubts(&self, py: Python<'_>, today: Option<String>) -> PyResult<Vec<String>> {
        let inner = self.inner.clone();
        quietly(py, move || Ok(inner.doubts(day(today.as_deref())?)))
    }

    fn days_left(&self, py: Python<'_>, today: Option<String>) -> PyResult<Option<i64>> {
        let inner = self.inner.clone();
        quietly(py, move || Ok(inner.days_left(day(today.as_deref())?)))
    }

    fn __repr__(&self) -> String {
        let names: Vec<String> = self.inner.effects().map(rtec_model::effect::Effect::name).collect();
        format!("<rtec.Machine {:?}: {}>", self.inner.name(), names.join(", "))
    }
}
