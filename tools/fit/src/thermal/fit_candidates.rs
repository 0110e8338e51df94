//! The candidates of a fit.
//! These are sensors, differences and lags, and the rows binned for the search.

use super::ThermalFitOptions;
use super::term::{Pair, Term};
use crate::statistics::mean;
use crate::temperature_denoising::SmoothingUncertainty;
use rtec_files::InputError;
use rtec_least_squares::dot;
use rtec_model::effect::laws::thermal_growth;
use rtec_model::effect::{Dictionary, Lag, ParallelLags, STANDARD_DEGC, TemperatureDifference};
use rtec_model::record::{Axis, Record, Role};
use std::ops::Range;

/// Largest number of rows in the search.
/// Neighbours in time are averaged, because temperatures change slowly.
const BINS: usize = 512;
/// Largest number of sensors whose differences are all offered by default.
/// The number of pairs grows with the square.
const MOST_SENSORS: usize = 256;
/// Ratio of one lag to the one before; lags begin at one minute.
const LAG_STEP: f64 = 1.02;
/// Stride between the lags at which candidates are screened.
const SCREEN_LAGS: usize = 28;
/// Number of lags that are computed in one pass through the rows.
const TOGETHER: usize = 8;

/// All rows of the training records, ready for the search.
pub(super) struct TermSelectionProblem {
    pub(super) sensors: Vec<String>,
    /// Sensors that are not offered, because they read the same in every row.
    pub(super) still: Vec<String>,
    pub(super) environment: Option<usize>,
    /// Offered differences: (sensor, minus).
    pub(super) offered: Vec<Pair>,
    /// Pairs that are offered in addition from the second term on.
    pub(super) pairs: Vec<Pair>,
    /// Largest gains that are plausible, µm/K and µm/K².
    pub(super) plausible: [f64; 2],
    pub(super) explicit: bool,
    pub(super) taus: Vec<f64>,
    /// Per sensor and lag: one value per bin.
    pub(super) binned: Vec<Vec<Vec<f64>>>,
    /// The lags that candidates are screened at.
    pub(super) screened: Vec<ScreeningColumnsAtLag>,
    pub(super) y: Vec<f64>,
    pub(super) weight: Vec<f64>,
    /// The bins of each fold.
    pub(super) stretches: Vec<Range<usize>>,
    pub(super) folds: usize,
    pub(super) coolant: Option<Vec<f64>>,
    pub(super) speed: Option<Vec<f64>>,
    pub(super) square: bool,
    /// Uncertainty of each record's smoothed temperatures, if known.
    pub(super) spread: Vec<SmoothingUncertainty>,
}

/// The data for screening candidates at one lag, computed once for many pairs.
pub(super) struct ScreeningColumnsAtLag {
    /// Per sensor one value per bin, about its mean.
    pub(super) centred: Vec<Vec<f64>>,
    /// Per pair and fold the sum of squares of their difference.
    squares: Vec<Vec<f64>>,
}

impl ScreeningColumnsAtLag {
    fn new(problem: &TermSelectionProblem, lag: usize) -> Self {
        let centre = |lags: &Vec<Vec<f64>>| {
            let mean = mean(&lags[lag]);
            lags[lag].iter().map(|v| v - mean).collect::<Vec<f64>>()
        };
        let centred: Vec<Vec<f64>> = problem.binned.iter().map(centre).collect();
        let mut squares = vec![Vec::new(); centred.len() * (centred.len() + 1)];
        for (sensor, minus) in problem.offered.iter().chain(&problem.pairs) {
            let of = |u: &[f64], i: usize| u[i] - minus.map_or(0.0, |m| centred[m][i]);
            let d: Vec<f64> = (0..problem.y.len()).map(|i| of(&centred[*sensor], i)).collect();
            let weighted: Vec<f64> = d.iter().zip(&problem.weight).map(|(d, w)| d * w).collect();
            let fold = |s: &Range<usize>| dot(&weighted[s.clone()], &d[s.clone()]);
            squares[place_of((*sensor, *minus), centred.len())] =
                problem.stretches.iter().map(fold).collect();
        }
        Self { centred, squares }
    }

    /// The sum of squares of a difference over these folds.
    pub(super) fn squares(&self, sensors: usize, pair: Pair, folds: &[usize]) -> f64 {
        let own = &self.squares[place_of(pair, sensors)];
        folds.iter().map(|f| own[*f]).sum()
    }
}

/// A pair's index among all pairs of each sensor with any other or none.
fn place_of((sensor, minus): Pair, sensors: usize) -> usize {
    sensor * (sensors + 1) + minus.unwrap_or(sensors)
}

impl TermSelectionProblem {
    /// The difference of these sensors by their names.
    pub(super) fn difference(&self, (sensor, minus): Pair) -> TemperatureDifference {
        let name = &self.sensors[sensor];
        minus.map_or_else(
            || TemperatureDifference::single(name),
            |m| TemperatureDifference::pair(name, &self.sensors[m]),
        )
    }

    pub(super) fn new(
        records: &[&Record],
        response: &Role,
        options: &ThermalFitOptions,
    ) -> Result<Self, InputError> {
        let first = records[0];
        let sensors: Vec<String> = first.names(&Role::Temperature).map(str::to_owned).collect();
        check_columns(records, &sensors, response)?;
        // A constant sensor causes no change. It does not measure air either, because a room's temperature
        // changes.
        let is_offered = |name: &String| options.names(name) || !stands_still(records, name);
        let (mut sensors, mut still): (Vec<String>, Vec<String>) = sensors.into_iter().partition(is_offered);
        if sensors.is_empty() {
            std::mem::swap(&mut sensors, &mut still);
        }
        let environment = match &options.environment {
            Some(name) => Some(place(first, &sensors, name)?),
            None if sensors.len() < 2 => None,
            None => Some(environment_of(&sensors, records)),
        };
        let explicit = !options.sensors.is_empty();
        if !explicit && sensors.len() > MOST_SENSORS {
            let found = format!("{} temperatures to choose from", sensors.len());
            let expected = format!(
                "{MOST_SENSORS} at most, whose pairs can all be looked at; --sensors names the differences to choose from"
            );
            return Err(InputError::whole(&first.path, found, expected));
        }
        let (offered, pairs) = differences(first, response, options, &sensors, environment)?;
        let rows: usize = records.iter().map(|r| r.rows()).sum();
        if rows < 4 * options.folds || options.folds < 3 {
            let expected = format!("at least {} (four per fold, three folds)", 4 * options.folds.max(3));
            return Err(InputError::whole(&first.path, format!("{rows} rows"), expected));
        }
        let taus = lag_grid(records, options.lag);
        let bins = RowBins::new(records, rows.div_ceil(BINS));
        let binned = sensors.iter().map(|s| bins.sensor(s, &taus)).collect();
        // A run without a coolant column is dry. One without a speed column may have had any speed.
        let everywhere =
            |role: &Role| *role == Role::Coolant || records.iter().all(|r| r.column(role).is_some());
        let varies = |v: &Vec<f64>| v.iter().any(|x| (x - v[0]).abs() > 1e-9);
        let optional = |role: Role, effect: &str, of: fn(f64) -> f64| {
            let all = everywhere(&role).then(|| bins.column(&role, of));
            let axis = response.axis().map_or("", Axis::as_str);
            let known = options.base_has(&format!("{effect}.{axis}"));
            all.filter(|v| varies(v) && !explicit && !known)
        };
        // Stretches of the same number of bins, or one more.
        let begin = |fold: usize| (fold * bins.spans.len()).div_ceil(options.folds);
        let mut problem = Self {
            screened: Vec::new(),
            y: bins.column(response, |v| v),
            weight: bins.spans.iter().map(|(_, b)| b.len() as f64).collect(),
            coolant: optional(Role::Coolant, "coolant", |v| f64::from(v > 0.5)),
            speed: optional(Role::SpindleSpeed, "spindle_speed", |v| v / 1000.0).filter(|_| options.speed),
            stretches: (0..options.folds).map(|f| begin(f)..begin(f + 1)).collect(),
            folds: options.folds,
            square: options.square,
            spread: Vec::new(),
            sensors,
            still,
            environment,
            offered,
            pairs,
            plausible: plausible_gains(),
            explicit,
            taus,
            binned,
        };
        let screened = (0..problem.taus.len()).step_by(SCREEN_LAGS);
        problem.screened = screened.map(|lag| ScreeningColumnsAtLag::new(&problem, lag)).collect();
        Ok(problem)
    }

    /// Adds a lag between those of the grid and returns its index.
    pub(super) fn with_lag(&mut self, tau_s: f64, records: &[&Record]) -> usize {
        let rows: usize = records.iter().map(|r| r.rows()).sum();
        let bins = RowBins::new(records, rows.div_ceil(BINS));
        for (name, lags) in self.sensors.iter().zip(&mut self.binned) {
            lags.extend(bins.sensor(name, &[tau_s]));
        }
        self.taus.push(tau_s);
        self.taus.len() - 1
    }

    /// How the environment's sensor was chosen, in words.
    pub(super) fn environment_by(&self, options: &ThermalFitOptions) -> String {
        match (&options.environment, self.environment) {
            (Some(_), _) => "given".to_owned(),
            (None, Some(_)) => {
                "coldest, and of those within 1 K the one that moves fastest; --environment names another"
                    .to_owned()
            }
            (None, None) => "none: differences are to 20 degC".to_owned(),
        }
    }

    /// A term's values, one per bin.
    pub(super) fn column(&self, term: Term) -> Vec<f64> {
        match term {
            Term::Coolant => self.coolant.clone().unwrap_or_default(),
            Term::Speed => self.speed.clone().unwrap_or_default(),
            Term::Thermal { sensor, minus, lag, square } => {
                let u = &self.binned[sensor][lag];
                let mut column: Vec<f64> = match minus {
                    Some(m) => u.iter().zip(&self.binned[m][lag]).map(|(u, m)| u - m).collect(),
                    None => u.iter().map(|u| u - STANDARD_DEGC).collect(),
                };
                if square {
                    for d in &mut column {
                        *d *= *d;
                    }
                }
                column
            }
        }
    }

    pub(super) fn name(&self, term: Term) -> String {
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
}

/// Largest gains within the dictionary's plausible range, µm/K and µm/K².
fn plausible_gains() -> [f64; 2] {
    Dictionary::default().effect(&format!("{}.x", thermal_growth::NAME)).map_or([f64::INFINITY; 2], |e| {
        let bound = |i: usize| e.description().parameters[i].plausible[1];
        [bound(0), bound(1)]
    })
}

/// Checks that all records have the response and the first record's sensors.
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

/// Whether a sensor reads the same in every row of all records.
fn stands_still(records: &[&Record], name: &str) -> bool {
    let mut readings = records.iter().filter_map(|r| r.temperature(name)).flatten();
    let first = readings.next();
    readings.all(|degc| first.is_some_and(|first| first.to_bits() == degc.to_bits()))
}

/// No lag, then lags from a minute to a third of the longest record.
/// They are in equal ratios.
fn lag_grid(records: &[&Record], offered: bool) -> Vec<f64> {
    let span = records.iter().map(|r| r.time_s()[r.rows() - 1] - r.time_s()[0]).fold(0.0, f64::max);
    let timed = records.iter().all(|r| r.column(&Role::Time).is_some());
    let lags =
        std::iter::successors(Some(60.0), |tau| Some(tau * LAG_STEP)).take_while(|tau| *tau <= span / 3.0);
    let none = std::iter::once(0.0);
    if offered && timed { none.chain(lags).collect() } else { none.collect() }
}

/// Guesses the environment's sensor: the coldest of a machine that makes heat.
/// Of those within 1 K of the coldest it is the fastest: air, not a casting that follows it.
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

/// The index of a sensor that the options name.
fn place(record: &Record, sensors: &[String], name: &str) -> Result<usize, InputError> {
    sensors.iter().position(|s| s == name).ok_or_else(|| {
        let has = sensors.join(", ");
        InputError::whole(&record.path, format!("no sensor {name}"), format!("one of {has}"))
    })
}

/// The differences to choose from, and additional pairs if none are named.
/// Those of the base's effects are left out.
fn differences(
    first: &Record,
    response: &Role,
    options: &ThermalFitOptions,
    sensors: &[String],
    environment: Option<usize>,
) -> Result<(Vec<Pair>, Vec<Pair>), InputError> {
    let (mut offered, mut pairs): (Vec<Pair>, Vec<Pair>) = (Vec::new(), Vec::new());
    for d in &options.sensors {
        let s = place(first, sensors, &d.sensor)?;
        offered.push(match d.minus() {
            Some(m) => (s, Some(place(first, sensors, m)?)),
            None => (s, environment.filter(|e| *e != s)),
        });
    }
    if offered.is_empty() {
        let others: Vec<usize> = (0..sensors.len()).filter(|s| Some(*s) != environment).collect();
        offered = others.iter().map(|s| (*s, environment)).collect();
        for (i, a) in others.iter().enumerate() {
            pairs.extend(others[i + 1..].iter().map(|b| (*a, Some(*b))));
        }
    }
    let known = options.base_differences(response);
    let is_new = |(s, m): &Pair| {
        let m = m.map(|m| sensors[m].as_str());
        !known.iter().any(|k| (k.0.as_str(), k.1.as_deref()) == (sensors[*s].as_str(), m))
    };
    offered.retain(is_new);
    pairs.retain(is_new);
    Ok((offered, pairs))
}

/// Rows averaged in bins, which never cross records.
/// The folds of the search are stretches of these bins.
struct RowBins<'a> {
    records: &'a [&'a Record],
    /// Index of the record, and its rows.
    spans: Vec<(usize, Range<usize>)>,
}

impl<'a> RowBins<'a> {
    fn new(records: &'a [&'a Record], per_bin: usize) -> Self {
        let mut spans = Vec::new();
        for (n, r) in records.iter().enumerate() {
            let starts = (0..r.rows()).step_by(per_bin);
            spans.extend(starts.map(|at| (n, at..(at + per_bin).min(r.rows()))));
        }
        Self { records, spans }
    }

    /// A temperature at each of these lags, of which some may be zero.
    /// Each lag has one value per bin.
    fn sensor(&self, name: &str, taus_s: &[f64]) -> Vec<Vec<f64>> {
        let mut found = Vec::with_capacity(taus_s.len());
        for some in taus_s.chunk_by(|a, b| (*a > 0.0) == (*b > 0.0)).flat_map(|c| c.chunks(TOGETHER)) {
            if some[0] > 0.0 {
                found.extend(self.lagged(name, some));
            } else {
                found.extend(
                    some.iter().map(|_| self.average(&|r| r.temperature(name).unwrap_or_default().to_vec())),
                );
            }
        }
        found
    }

    /// A temperature at a few lags, in one pass through the rows.
    fn lagged(&self, name: &str, taus_s: &[f64]) -> Vec<Vec<f64>> {
        let mut found = vec![Vec::with_capacity(self.spans.len()); taus_s.len()];
        // An incomplete group is filled by repeating its last lag.
        let mut lags = None;
        for (record, span) in &self.spans {
            let r = self.records[*record];
            let u = r.temperature(name).unwrap_or_default();
            if span.start == 0 {
                lags = Some(ParallelLags::<TOGETHER>::new(std::array::from_fn(|k| {
                    taus_s[k.min(taus_s.len() - 1)]
                })));
            }
            let Some(lags) = &mut lags else { continue };
            let mut sums = [0.0; TOGETHER];
            for (t, u) in r.time_s()[span.clone()].iter().zip(&u[span.clone()]) {
                sums.iter_mut().zip(lags.next(*t, *u)).for_each(|(sum, v)| *sum += v);
            }
            found.iter_mut().zip(sums).for_each(|(bins, sum)| bins.push(sum / span.len() as f64));
        }
        found
    }

    fn average(&self, of: &dyn Fn(&Record) -> Vec<f64>) -> Vec<f64> {
        let data: Vec<Vec<f64>> = self.records.iter().map(|r| of(r)).collect();
        let mean = |(n, b): &(usize, Range<usize>)| data[*n][b.clone()].iter().sum::<f64>() / b.len() as f64;
        self.spans.iter().map(mean).collect()
    }

    /// A column by its role, each value converted by `of`.
    /// A record without the column has zeros.
    fn column(&self, role: &Role, of: fn(f64) -> f64) -> Vec<f64> {
        self.average(&|r| {
            r.data(role).map_or_else(|| vec![0.0; r.rows()], |d| d.iter().map(|v| of(*v)).collect())
        })
    }
}

/// A temperature after a first-order lag, in equilibrium at the first row.
pub(super) fn lagged(t: &[f64], u: &[f64], tau_s: f64) -> Vec<f64> {
    let mut lag = Lag::new(tau_s);
    t.iter().zip(u).map(|(t, u)| lag.next(*t, *u)).collect()
}
