//! Machine models: read, looked at, asked, written.

use crate::border::{quietly, work};
use crate::record::Record;
use numpy::PyArray1;
use pyo3::prelude::*;
use rtec_files::InputError;
use rtec_model::date;
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
        quietly(py, || Ok(Self { inner: Inner::read(&path)? }))
    }

    #[staticmethod]
    #[pyo3(signature = (text, path=None))]
    fn parse(py: Python<'_>, text: String, path: Option<PathBuf>) -> PyResult<Self> {
        let path = path.unwrap_or_else(|| PathBuf::from("machine.toml"));
        quietly(py, || Ok(Self { inner: Inner::parse(&path, &text)? }))
    }

    #[staticmethod]
    fn ideal(name: &str) -> Self {
        Self { inner: Inner::ideal(name) }
    }

    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        quietly(py, || Ok(self.inner.write(&path)?))
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
        quietly(py, || Ok(serde_json::to_string_pretty(&self.inner.to_json())?))
    }

    /// Predicted response of every row, by the response's column name; and what was said.
    fn predict<'py>(&self, py: Python<'py>, record: &Record) -> PyResult<(Predicted<'py>, Vec<String>)> {
        let (columns, said) =
            work(py, |say| Ok(rtec_measure::prediction::predict(&self.inner, &record.inner, say)?))?;
        Ok((columns.into_iter().map(|(name, data)| (name, PyArray1::from_vec(py, data))).collect(), said))
    }

    fn predicted_csv(
        &self,
        py: Python<'_>,
        record: &Record,
        interval: bool,
    ) -> PyResult<(String, Vec<String>)> {
        work(py, |say| Ok(rtec_measure::prediction::csv(&self.inner, &record.inner, interval, say)?))
    }

    /// Half width of the 95 % interval at every row, µm; none where no fit of the response states one for such a run.
    fn half_widths_um<'py>(
        &self,
        py: Python<'py>,
        record: &Record,
        response: &str,
    ) -> PyResult<Option<Bound<'py, PyArray1<f64>>>> {
        let widths = quietly(py, || {
            let found = format!("response `{response}`");
            let expected = "error.AXIS or force.AXIS";
            let role = Role::parse(response)
                .ok_or_else(|| InputError::whole("half_widths_um".as_ref(), found, expected))?;
            Ok(self.inner.half_widths_um(&record.inner, &role))
        })?;
        Ok(widths.map(|w| PyArray1::from_vec(py, w)))
    }

    /// The record less what the model predicts.
    fn beyond(&self, py: Python<'_>, record: &Record) -> PyResult<Record> {
        quietly(py, || Ok(Record { inner: self.inner.beyond(&record.inner)? }))
    }

    fn doubts(&self, py: Python<'_>, today: Option<&str>) -> PyResult<Vec<String>> {
        quietly(py, || Ok(self.inner.doubts(day(today)?)))
    }

    fn days_left(&self, py: Python<'_>, today: Option<&str>) -> PyResult<Option<i64>> {
        quietly(py, || Ok(self.inner.days_left(day(today)?)))
    }

    fn __repr__(&self) -> String {
        let names: Vec<String> = self.inner.effects().map(rtec_model::effect::Effect::name).collect();
        format!("<rtec.Machine {:?}: {}>", self.inner.name(), names.join(", "))
    }
}
