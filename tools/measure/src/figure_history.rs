//! One machine's figures of merit over time, with limits and trends.

use crate::ballbar;
use crate::evaluation::{Standard, is_same_figure};
use crate::iso230::{self, PositioningOptions};
use crate::plausible::{self, Suspicion};
use crate::plot::PlotError;
use crate::report::{self, Report};
use rtec_files::strict_toml::Document;
use rtec_files::{InputError, Result, date};
use rtec_model::record::{Column, Record, mean, span};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;
use std::path::Path;

/// Smallest temperature range to determine growth, K.
const LEAST_RANGE_K: f64 = 1.0;
/// Fewest records for a straight line over time.
const FEWEST: usize = 3;
/// Days of a year.
const YEAR: f64 = 365.25;
/// A limit that a trend reaches after more days than this gives no warning.
const FAR_DAYS: f64 = 3650.0;
/// Figures of positioning in a history.
const POSITIONING: [&str; 5] = ["A", "E", "M", "R", "B_mean"];

/// Limits of figures, on both sides of zero.
/// By whole name (`x.A`) or for every axis (`A`).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FigureTolerances(BTreeMap<String, f64>);

impl FigureTolerances {
    /// Reads a file with a table `[limits]`: `"x.A" = 12.0`, `B_mean = 5.0`.
    ///
    /// # Errors
    /// The first finding: an unknown key or figure, a limit that is not a number above zero.
    pub fn read(path: &Path) -> Result<Self> {
        let text = rtec_files::text_file::read(path)?;
        let document = Document::parse(path, &text)?;
        let root = document.root();
        root.only(&["limits"])?;
        let value = root.required("limits", "a table [limits]")?;
        let table = value.table("a table [limits]")?;
        let mut limits = BTreeMap::new();
        for entry in table.entries() {
            let name = entry.key();
            let figure = name.rsplit('.').next().unwrap_or(name);
            if !NAMES.contains(&figure) {
                let expected = format!("one of {}, or with an axis, as \"x.A\"", NAMES.join(", "));
                return Err(entry.key_error(format!("figure `{name}`"), expected));
            }
            limits.insert(name.to_owned(), entry.positive("a limit above zero")?);
        }
        Ok(Self(limits))
    }

    /// From limits by name.
    pub fn of(limits: impl IntoIterator<Item = (String, f64)>) -> Self {
        Self(limits.into_iter().collect())
    }

    fn for_figure(&self, name: &str) -> Option<f64> {
        let short = name.rsplit('.').next().unwrap_or(name);
        self.0.get(name).or_else(|| self.0.get(short)).copied()
    }

    /// The limits that apply to no figure of the history.
    pub fn without(&self, history: &MachineHistory) -> Vec<&str> {
        let of = |limit: &str, figure: &str| figure == limit || figure.rsplit('.').next() == Some(limit);
        let limits = self.0.keys().map(String::as_str);
        limits.filter(|limit| !history.figures.iter().any(|f| of(limit, &f.name))).collect()
    }
}

/// Names of all figures of a history.
pub const NAMES: [&str; 7] = ["A", "E", "M", "R", "B_mean", "squareness_urad", "growth_um_per_K"];

/// The value of a figure in one record.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FigureValue {
    /// The day of the record.
    pub date: String,
    /// Path of the record, as given.
    pub record: String,
    /// The figure, in its unit.
    pub value: f64,
    /// The figure with every row, if it differs.
    /// Set if rows of the record are left out of all figures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_every_row: Option<f64>,
    #[serde(skip)]
    day: i64,
}

/// A straight line over time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FigureTrend {
    /// Change per year.
    pub per_year: f64,
    /// Its 95 % interval.
    pub interval: [f64; 2],
    /// Whether the interval excludes zero.
    pub drifts: bool,
    #[serde(skip)]
    now: f64,
}

/// A figure over time.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct FigureHistory {
    /// Axis (or plane) and figure, as `x.A`.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// The sensor that the growth refers to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// Its values, in order of time.
    pub points: Vec<FigureValue>,
    /// Its limit, on both sides of zero.
    pub limit: Option<f64>,
    /// Whether the last value exceeds the limit.
    pub beyond: bool,
    /// Its trend; `None` for fewer than three days.
    pub trend: Option<FigureTrend>,
    /// The day on which the trend reaches the limit, if it does.
    pub reaches: Option<String>,
}

/// A record that is not in the history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ExcludedRecord {
    /// Path of the record, as given.
    pub record: String,
    /// The reason.
    pub why: String,
}

/// One machine's history.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MachineHistory {
    /// The machine.
    pub machine: String,
    /// Its figures, by name.
    pub figures: Vec<FigureHistory>,
    /// Records without a date, or that cannot be read or evaluated.
    pub left_out: Vec<ExcludedRecord>,
    /// Suspicions against the records; their rows are in no figure.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub suspicions: Vec<Suspicion>,
    /// Messages about figures that contain a drift or a step of their run.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<String>,
}

/// One machine's history from its records, each by its path.
/// Records that cannot be read are listed in `left_out`.
pub fn history(
    machine: &str,
    records: &[(String, Result<Record>)],
    limits: &FigureTolerances,
) -> MachineHistory {
    let mut found: BTreeMap<String, FigureHistory> = BTreeMap::new();
    let (mut left_out, mut suspicions, mut changes) = (Vec::new(), Vec::new(), Vec::new());
    let mut rows = |record: &Record| GoodAndAllRows::of(record, &mut suspicions);
    let records: Vec<(&String, Result<GoodAndAllRows, &InputError>)> =
        records.iter().map(|(path, record)| (path, record.as_ref().map(&mut rows))).collect();
    let sensors = sensors(records.iter().filter_map(|r| r.1.as_ref().ok()).map(|rows| &rows.good));
    for (path, rows) in records {
        let said = rows.map_err(ToString::to_string).and_then(|GoodAndAllRows { good: r, every }| {
            let day = r.date.as_deref().and_then(date::parse);
            let day = day.ok_or_else(|| "no date = \"YYYY-MM-DD\" in it".to_owned())?;
            let every = every.and_then(|every| figures(&every, &sensors).ok()).unwrap_or_default();
            let figures = figures(&r, &sensors).map_err(|e| e.to_string())?;
            Ok((r, day, figures, every))
        });
        match said {
            Err(why) => left_out.push(ExcludedRecord { record: path.clone(), why }),
            Ok((record, day, figures, every)) => {
                changes.extend(held_changes(&record).into_iter().map(|held| format!("{path}: {held}")));
                for (name, unit, sensor, value) in figures {
                    let with = every.iter().find(|f| f.0 == name).map(|f| f.3);
                    let with_every_row = with.filter(|with| !is_same_figure(*with, value));
                    let limit = limits.for_figure(&name);
                    let figure = found.entry(name.clone());
                    let figure = figure.or_insert(FigureHistory {
                        name,
                        unit,
                        sensor,
                        limit,
                        ..FigureHistory::default()
                    });
                    let (date, record) = (record.date.clone().unwrap_or_default(), path.clone());
                    figure.points.push(FigureValue { date, record, value, with_every_row, day });
                }
            }
        }
    }
    let figures = found.into_values().map(judged).collect();
    MachineHistory { machine: machine.to_owned(), figures, left_out, suspicions, changes }
}

type RecordFigure = (String, &'static str, Option<String>, f64);

/// The rows of a record for its figures.
struct GoodAndAllRows {
    /// The rows used in figures.
    good: Record,
    /// Every row, if some are left out of figures.
    every: Option<Record>,
}

impl GoodAndAllRows {
    /// Adds the suspicions of the record to `found`.
    fn of(record: &Record, found: &mut Vec<Suspicion>) -> Self {
        let records = std::slice::from_ref(record);
        let doubts = plausible::suspicions(records);
        let usable = plausible::in_figures(records, &doubts);
        let good = plausible::good_rows(&usable[0], record.rows(), &mut |_| ()).into_owned();
        let every = doubts.iter().any(Suspicion::is_of_rows).then(|| {
            let every = plausible::every_row(records, &doubts);
            plausible::good_rows(&every[0], record.rows(), &mut |_| ()).into_owned()
        });
        found.extend(doubts);
        Self { good, every }
    }
}

/// Messages about positioning figures that contain a drift or step of the run.
fn held_changes(record: &Record) -> Vec<String> {
    if !matches!(Standard::of(record), Ok(Standard::Iso230_2)) {
        return Vec::new();
    }
    let options = PositioningOptions { one_way: true, ..PositioningOptions::default() };
    let held = |p: &iso230::PositioningResult| {
        let (by, unit) = (p.changes_by()?, if p.unit == "urad" { "µrad" } else { "µm" });
        let kept = p.figures().into_iter().filter(|(s, _)| !s.starts_with("R_") || p.R.is_none());
        let words = |(s, with): (&str, Option<f64>)| {
            Some(format!("{s} {:.2} instead of {:.2} {unit}", p.without_change(s)?, with?))
        };
        let figures: Vec<String> = kept.filter_map(words).collect();
        Some(format!("{} holds a {by} of its run; without it {}", p.response, figures.join(", ")))
    };
    iso230::positioning_with(record, &options).iter().flatten().filter_map(held).collect()
}

/// The figures of a record; none for evaluations without a history.
fn figures(record: &Record, sensors: &BTreeMap<String, String>) -> Result<Vec<RecordFigure>> {
    Ok(match Standard::of(record) {
        Ok(Standard::Iso230_2) => {
            let all = iso230::positioning_with(
                record,
                &PositioningOptions { one_way: true, ..PositioningOptions::default() },
            )?;
            let of = |p: &iso230::PositioningResult| {
                let name = |symbol: &str| match p.response.strip_prefix("error.") {
                    Some(axis) => format!("{axis}.{symbol}"),
                    None => format!("{}.{symbol}", p.response),
                };
                let unit = if p.unit == "urad" { "urad" } else { "um" };
                let kept = p.figures().into_iter().filter(|(s, _)| POSITIONING.contains(s));
                kept.filter_map(|(s, v)| Some((name(s), unit, None, v?))).collect::<Vec<_>>()
            };
            all.iter().flat_map(of).collect()
        }
        Ok(Standard::Ballbar) => {
            let planes = ballbar::evaluate(std::slice::from_ref(record))?;
            let of = |b: &ballbar::BallbarResult| {
                let urad = b.diagnosis.squareness_urad?;
                Some((format!("{}.squareness_urad", b.plane), "urad", None, urad))
            };
            planes.iter().filter_map(of).collect()
        }
        Ok(Standard::Iso230_3) => {
            let of = |c: &Column| {
                let response = c.role.to_string();
                let sensor = sensors.get(&response)?;
                let (slope, _, _) = slope(record.temperature(sensor)?, &c.data)?;
                let axis = c.role.axis().map_or_else(|| response.clone(), ToString::to_string);
                Some((format!("{axis}.growth_um_per_K"), "um/K", Some(sensor.clone()), slope))
            };
            record.responses().filter_map(of).collect()
        }
        _ => Vec::new(),
    })
}

/// For each response the sensor that explains its growth best in all drift records.
fn sensors<'r>(records: impl Iterator<Item = &'r Record>) -> BTreeMap<String, String> {
    let mut merit: BTreeMap<(String, String), f64> = BTreeMap::new();
    for record in records.filter(|r| matches!(Standard::of(r), Ok(Standard::Iso230_3))) {
        for response in record.responses() {
            for sensor in record.temperatures() {
                let gamma = slope(&sensor.data, &response.data).map_or(0.0, |s| s.2.abs());
                *merit.entry((response.role.to_string(), sensor.name.clone())).or_default() += gamma;
            }
        }
    }
    let mut best: BTreeMap<String, (String, f64)> = BTreeMap::new();
    for ((response, sensor), sum) in merit.into_iter().filter(|m| m.1 > 0.0) {
        let entry = best.entry(response).or_insert_with(|| (sensor.clone(), sum));
        if sum > entry.1 {
            *entry = (sensor, sum);
        }
    }
    best.into_iter().map(|(response, (sensor, _))| (response, sensor)).collect()
}

/// Slope of a straight line, its standard error, and the correlation.
/// `None` if x hardly varies.
fn slope(x: &[f64], y: &[f64]) -> Option<(f64, f64, f64)> {
    let [xx, xy, yy] = iso230::moments(x, y);
    let [low, high] = span(x);
    if x.len() < FEWEST || high - low < LEAST_RANGE_K {
        return None;
    }
    let slope = xy / xx;
    let left = (yy - slope * xy).max(0.0);
    let gamma = if yy > 0.0 { xy / (xx * yy).sqrt() } else { 0.0 };
    Some((slope, (left / (x.len() as f64 - 2.0) / xx).sqrt(), gamma))
}

fn judged(mut figure: FigureHistory) -> FigureHistory {
    figure.points.sort_by(|a, b| (a.day, &a.record).cmp(&(b.day, &b.record)));
    let Some(last) = figure.points.last().cloned() else { return figure };
    figure.beyond = figure.limit.is_some_and(|l| last.value.abs() > l);
    let days: Vec<f64> = figure.points.iter().map(|p| (p.day - last.day) as f64).collect();
    let values: Vec<f64> = figure.points.iter().map(|p| p.value).collect();
    figure.trend = slope(&days, &values).and_then(|(per_day, error, _)| {
        let t = StudentsT::new(0.0, 1.0, days.len() as f64 - 2.0).ok()?.inverse_cdf(0.975);
        let interval = [YEAR * (per_day - t * error), YEAR * (per_day + t * error)];
        let drifts = interval[0] > 0.0 || interval[1] < 0.0;
        Some(FigureTrend {
            per_year: YEAR * per_day,
            interval,
            drifts,
            now: mean(&values) - per_day * mean(&days),
        })
    });
    if let (Some(trend), Some(limit)) = (figure.trend.filter(|t| t.drifts), figure.limit) {
        let to = if trend.per_year > 0.0 { limit } else { -limit };
        let in_days = (to - trend.now) / trend.per_year * YEAR;
        if !figure.beyond && (0.0..FAR_DAYS).contains(&in_days) {
            figure.reaches = Some(date::format(last.day + in_days as i64));
        }
    }
    figure
}

impl MachineHistory {
    /// Messages about figures that would differ with every row, by record.
    pub fn with_every_row(&self) -> impl Iterator<Item = String> {
        self.figures.iter().flat_map(|f| {
            f.points.iter().filter_map(|p| {
                let (with, unit) = (p.with_every_row?, f.written_unit());
                let (name, of, value) = (&f.name, &p.record, p.value);
                let now = format!("{of}: {name} is {value:.2} {unit}");
                Some(format!("{now}; with every row it would be {with:.2} {unit}"))
            })
        })
    }

    /// Figures whose last value exceeds their limit.
    pub fn beyond(&self) -> impl Iterator<Item = &FigureHistory> {
        self.figures.iter().filter(|f| f.beyond)
    }

    /// The history as a page and as text: a table, and each figure over time.
    ///
    /// # Errors
    /// A plot without a finite point.
    pub fn report(&self) -> Result<Report, PlotError> {
        report::history(self)
    }
}

impl FigureHistory {
    /// Its unit with the letter µ.
    pub(crate) fn written_unit(&self) -> String {
        self.unit.replace("um", "µm").replace("urad", "µrad")
    }

    /// Days since the first record, with the values.
    pub(crate) fn over_days(&self) -> Vec<(f64, f64)> {
        let first = self.points.first().map_or(0, |p| p.day);
        self.points.iter().map(|p| ((p.day - first) as f64, p.value)).collect()
    }

    /// Ends of the trend line over the same days.
    pub(crate) fn line(&self) -> Option<[(f64, f64); 2]> {
        let (trend, last) = (self.trend?, self.over_days().last()?.0);
        Some([(0.0, trend.now - trend.per_year / YEAR * last), (last, trend.now)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_read_strictly() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("limits.toml");
        for (text, line, found) in [
            ("[limits]\nwrong = 1.0\n", 2, "figure `wrong`"),
            ("[limits]\nA = -1.0\n", 2, "A"),
            ("[limit]\nA = 1.0\n", 1, "limit"),
        ] {
            std::fs::write(&file, text).unwrap();
            let e = FigureTolerances::read(&file).unwrap_err();
            assert!(e.line == line && e.found.contains(found), "{text}: {e}");
        }
        std::fs::write(&file, "[limits]\n\"x.A\" = 12.0\nA = 20\n").unwrap();
        let limits = FigureTolerances::read(&file).unwrap();
        assert_eq!((limits.for_figure("x.A"), limits.for_figure("y.A")), (Some(12.0), Some(20.0)));
    }
}
