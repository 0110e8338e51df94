//! One run of an experiment: the log, and the truth beside it.

/// One logged column of a run.
#[derive(Clone)]
pub struct Col {
    /// Name in the CSV.
    pub name: String,
    /// Role in the sidecar.
    pub role: String,
    /// Unit in the sidecar.
    pub unit: &'static str,
    /// Values. A true value that is not logged has `logged = false`.
    pub v: Vec<f64>,
    /// Whether it goes into the CSV.
    pub logged: bool,
}

/// One run of an experiment.
#[derive(Clone, Default)]
pub struct Run {
    /// Kind in the sidecar.
    pub kind: &'static str,
    /// The columns other than responses.
    pub cols: Vec<Col>,
    /// Roles of the responses.
    pub responses: Vec<String>,
    /// Number of rows.
    pub n: usize,
    /// True temperatures by sensor, °C, where the log has the sensor's noise.
    pub true_degc: Vec<(String, Vec<f64>)>,
    /// Name of the gauges' zero, if the record has its own.
    pub zero: Option<String>,
    /// A ballbar's nominal length, mm, and its plane.
    /// Then the error along the bar is a response.
    pub bar: Option<(f64, [String; 2])>,
}

impl Run {
    pub(crate) fn add(&mut self, name: &str, role: &str, unit: &'static str, v: Vec<f64>, logged: bool) {
        self.n = v.len();
        self.cols.push(Col { name: name.into(), role: role.into(), unit, v, logged });
    }
    pub(crate) fn get(&self, role: &str) -> Option<&[f64]> {
        self.cols.iter().find(|c| c.role == role).map(|c| &c.v[..])
    }
    pub(crate) fn has(&self, role: &str) -> bool {
        self.cols.iter().any(|c| c.role == role && c.logged)
    }
    pub(crate) fn named(&self, name: &str) -> Vec<f64> {
        if let Some((_, v)) = self.true_degc.iter().find(|(n, _)| n == name) {
            return v.clone();
        }
        self.cols.iter().find(|c| c.name == name).map_or_else(|| vec![0.0; self.n], |c| c.v.clone())
    }
    /// Names of the columns of a role.
    pub fn names(&self, role: &str) -> Vec<String> {
        self.cols.iter().filter(|c| c.role == role && c.logged).map(|c| c.name.clone()).collect()
    }
    pub(crate) fn time(&self) -> Vec<f64> {
        match self.cols.iter().find(|c| c.role == "time" && c.logged) {
            Some(c) => c.v.clone(),
            None => (0..self.n).map(|i| i as f64).collect(),
        }
    }
    pub(crate) fn dir(&self, axis: &str) -> Vec<f64> {
        if self.has(&format!("direction.{axis}")) {
            return self.get(&format!("direction.{axis}")).unwrap_or_default().to_vec();
        }
        let v = self.get(&format!("velocity.{axis}")).unwrap_or_default();
        v.iter().map(|&v| if v == 0.0 { 0.0 } else { v.signum() }).collect()
    }
}
