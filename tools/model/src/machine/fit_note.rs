//! The record of a fit: its sources, dates, intervals and range of validity.

use crate::effect::{Effect, TemperatureDifference};
use crate::record::{Record, Role, RunKind};
use std::collections::BTreeMap;
use std::path::PathBuf;

use super::relative_paths::folder_of;

/// Half width of a normal distribution's 95 % interval in standard deviations.
pub const NORMAL_95: f64 = 1.96;

/// Possible error of a temperature effect at a row, µm, beyond the fit's own.
/// It is the slope at the bound times the excess. Soon after a start (`elapsed_s`) it also has a part from
/// the unknown state of the lag.
pub fn unknown_um(
    gain: f64,
    bend: f64,
    asked_k: f64,
    held_k: f64,
    start_k: f64,
    tau_s: f64,
    elapsed_s: f64,
) -> f64 {
    let slope = gain.abs().max((gain + 2.0 * bend * held_k).abs());
    let start = if tau_s > 0.0 { NORMAL_95 * start_k * (-elapsed_s / tau_s).exp() } else { 0.0 };
    slope * (asked_k - held_k).hypot(start)
}

/// A record that a fit used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceRecord {
    /// Name of the record's CSV.
    pub file: String,
    /// SHA-256 of it, in hexadecimal.
    pub sha256: String,
    /// Its folder; `None` if it is beside the model.
    pub folder: Option<PathBuf>,
}

impl SourceRecord {
    /// The source entry of a record.
    pub fn of(record: &Record) -> Self {
        let folder = Some(folder_of(&record.path));
        Self { file: record.file.clone(), sha256: record.sha256.clone(), folder }
    }
}

/// The provenance of an effect. An effect written by a person may have none of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// The program or person that added the effect.
    pub added_by: Option<String>,
    /// The date, as ISO 8601.
    pub date: Option<String>,
    /// The records it was fitted on.
    pub from: Vec<SourceRecord>,
    /// Interval of each parameter, one pair per value.
    pub interval: BTreeMap<String, Vec<[f64; 2]>>,
    /// Whether it is the zero of the gauges and not an error of the machine.
    /// It is part of a record's prediction, but is never corrected live.
    pub set_up: bool,
}

/// An effect of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectWithProvenance {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Its records, dates and intervals.
    pub provenance: Provenance,
}

impl EffectWithProvenance {
    /// The name that identifies it among a machine's effects.
    /// The zero of a set-up and the machine's own offset have different ones.
    pub fn identity(&self) -> String {
        let set_up = if self.provenance.set_up { ", set_up" } else { "" };
        format!("{}{set_up}", self.effect.identity())
    }
}

/// The range of a temperature difference in which a fit is valid.
#[derive(Debug, Clone, PartialEq)]
pub struct ValidTemperatureRange {
    /// The difference; the model may or may not read it.
    pub difference: TemperatureDifference,
    /// The range in which it was seen, K.
    pub range_k: [f64; 2],
    /// How much the response changed with it, µm/K.
    pub um_per_k: f64,
}

impl ValidTemperatureRange {
    /// The difference at every row of a record.
    /// `None` if the record lacks one of its sensors.
    pub fn of(&self, record: &Record) -> Option<Vec<f64>> {
        let delta = self.difference.find(|sensor| record.temperature(sensor).ok_or(())).ok()?;
        Some((0..record.rows()).map(|row| delta.kelvin(|degc| degc[row])).collect())
    }

    /// The possible error of being this far outside the range, µm.
    pub fn outside_um(&self, delta_k: f64) -> f64 {
        self.um_per_k * (delta_k - self.range_k[1]).max(self.range_k[0] - delta_k).max(0.0)
    }
}

/// The record of a fit: its response, date, sources, quality and validity.
#[derive(Debug, Clone, PartialEq)]
pub struct FitNote {
    /// The response that was fitted, as `error.z`.
    pub response: String,
    /// The date of the fit, as ISO 8601.
    pub date: String,
    /// The last day on which the fit may be used without a new check.
    pub valid_until: String,
    /// RMS on blocks of time that were left out of the fit, µm.
    /// For a force this and all widths here are in N.
    pub rms_um: f64,
    /// Half width of the 95 % prediction interval, µm.
    pub half_width_um: f64,
    /// Ranges of validity; outside of these, the interval is wider.
    pub valid: Vec<ValidTemperatureRange>,
    /// Range of each axis while it was seen, mm; axes that are not named stood still.
    /// Elsewhere there is no interval, because no record shows the machine there. `None` if the model does
    /// not state it.
    pub at_mm: Option<BTreeMap<String, [f64; 2]>>,
    /// The half width by kind of run, as `positioning`.
    /// A kind that no run has shown gets the largest of all.
    pub by_kind_um: BTreeMap<String, f64>,
    /// The records that it was fitted on.
    pub from: Vec<SourceRecord>,
}

/// An axis that moves by less counts as standing still, mm.
const STILL_MM: f64 = 1.0;

/// Largest change of temperature, K, for a fit that has seen no temperature.
/// A machine that warms by more within a record is not the one that was fitted.
const WARMS_K: f64 = 2.0;

/// The ranges of a record's axes and temperatures, gathered piece by piece.
/// An interval depends on the ranges of all rows.
#[derive(Debug, Clone, Default)]
pub struct RecordRanges {
    kind: Option<RunKind>,
    /// Range of every axis, mm.
    at_mm: BTreeMap<String, [f64; 2]>,
    /// Range of every sensor, °C.
    degc: BTreeMap<String, [f64; 2]>,
}

impl RecordRanges {
    /// The ranges of a whole record.
    pub fn of(record: &Record) -> Self {
        let mut reach = Self::default();
        reach.see(record);
        reach
    }

    /// Adds the next rows.
    pub fn see(&mut self, record: &Record) {
        let widen = |all: &mut BTreeMap<String, [f64; 2]>, name: &str, data: &[f64]| {
            let range = all.entry(name.to_owned()).or_insert([f64::INFINITY, f64::NEG_INFINITY]);
            *range = data.iter().fold(*range, |[l, h], v| [l.min(*v), h.max(*v)]);
        };
        self.kind = Some(record.kind);
        for axis in record.axes(Role::Position) {
            let p = record.data(&Role::Position(axis.clone())).unwrap_or_default();
            widen(&mut self.at_mm, axis.as_str(), p);
        }
        for c in record.columns.iter().filter(|c| c.role == Role::Temperature) {
            widen(&mut self.degc, &c.name, &c.data);
        }
    }

    fn warms(&self) -> bool {
        self.degc.values().any(|[l, h]| h - l > WARMS_K)
    }

    /// The ranges of the axes that do not stand still, mm.
    fn places(&self) -> impl Iterator<Item = (&String, &[f64; 2])> {
        self.at_mm.iter().filter(|(_, [l, h])| *h - *l > STILL_MM)
    }

    /// The kind of the record for an interval.
    /// `None` for a drift in which an axis moves, because that resembles no kind.
    fn kind(&self) -> Option<RunKind> {
        self.kind.filter(|kind| *kind != RunKind::Drift || self.places().next().is_none())
    }
}

fn joined([a, b]: [f64; 2], [low, high]: [f64; 2]) -> [f64; 2] {
    [a.min(low), b.max(high)]
}

impl FitNote {
    /// The unit of a response, and so of its RMS and widths.
    pub fn unit_of(response: &str) -> &'static str {
        if response.starts_with("force.") { "N" } else { "µm" }
    }

    /// The file's keys of RMS, half width and half widths by kind of run.
    pub(super) fn keys_of(response: &str) -> [&'static str; 3] {
        match Self::unit_of(response) {
            "N" => ["rms_N", "half_width_N", "by_kind_N"],
            _ => ["rms_um", "half_width_um", "by_kind_um"],
        }
    }

    /// The range of each axis that moves in these records, mm.
    pub fn places(records: &[&Record]) -> BTreeMap<String, [f64; 2]> {
        let mut reach = RecordRanges::default();
        for record in records {
            reach.see(record);
        }
        reach.places().map(|(axis, range)| (axis.clone(), *range)).collect()
    }

    /// The reason why the interval does not apply to a record; `None` if it does.
    /// The fit must have seen the range of every axis that moves; a tenth of the range beyond is allowed. If
    /// the fit has seen no temperature, it does not apply to a machine that warms.
    pub fn why_interval_not_valid(&self, reach: &RecordRanges) -> Option<String> {
        if self.valid.is_empty() && reach.warms() {
            return Some(format!(
                "the fit saw no temperature, and one moves by more than {WARMS_K} K in this run"
            ));
        }
        let at = self.at_mm.as_ref()?;
        let seen = |axis, range: [f64; 2]| at.get(axis).is_some_and(|seen| Self::reaches(*seen, range));
        let (axis, [low, high]) = reach.places().find(|(axis, range)| !seen(*axis, **range))?;
        Some(match at.get(axis) {
            Some([l, h]) => {
                format!(
                    "the fit saw {axis} from {l:.0} to {h:.0} mm, and this run goes from {low:.0} to {high:.0} mm"
                )
            }
            None => format!(
                "the fit saw {axis} at one place, and it moves from {low:.0} to {high:.0} mm in this run"
            ),
        })
    }

    /// Whether a run is of a kind and at places that it was fitted on.
    /// The gauges of such a run have the fit's zero.
    pub fn has_zero_of(&self, reach: &RecordRanges) -> bool {
        let known = |kind: RunKind| self.by_kind_um.is_empty() || self.by_kind_um.contains_key(kind.name());
        reach.kind().is_none_or(known) && self.why_interval_not_valid(reach).is_none()
    }

    /// Whether a seen range of an axis covers another one, mm.
    /// A tenth of the seen range beyond its ends is allowed.
    pub fn reaches([from, to]: [f64; 2], [low, high]: [f64; 2]) -> bool {
        let margin = 0.1 * (to - from);
        low >= from - margin && high <= to + margin
    }

    /// The kind of a record for an interval.
    /// `None` for a drift in which an axis moves, because that resembles no kind.
    pub fn kind_of(record: &Record) -> Option<String> {
        RecordRanges::of(record).kind().map(|kind| kind.name().to_owned())
    }

    /// Half width of the 95 % interval for a record, µm.
    pub fn half_width_for_um(&self, reach: &RecordRanges) -> f64 {
        let own = reach.kind().and_then(|kind| self.by_kind_um.get(kind.name()));
        own.copied().unwrap_or(self.half_width_um)
    }

    /// Adds an earlier fit of the same response, on top of which this one was made.
    /// Their uncertainties add up, less the gauge's noise (one standard deviation, µm), which is in both.
    /// Their ranges are joined.
    /// A kind of run that only one of them has seen keeps its uncertainty, because a drift at one place does
    /// not show changes from place to place.
    pub fn add_earlier_fit(&mut self, earlier: &Self, noise_um: f64) {
        let own_um = self.half_width_um;
        let beyond_um = (own_um.powi(2) - (NORMAL_95 * noise_um).powi(2)).max(0.0).sqrt();
        for (kind, um) in &earlier.by_kind_um {
            self.by_kind_um
                .entry(kind.clone())
                .and_modify(|own| *own = own.max(*um))
                .or_insert(um.hypot(beyond_um));
        }
        self.half_width_um = beyond_um.hypot(earlier.half_width_um).max(own_um);
        self.rms_um = self.rms_um.hypot(earlier.rms_um);
        for v in &earlier.valid {
            match self.valid.iter_mut().find(|own| own.difference == v.difference) {
                Some(own) => own.range_k = joined(own.range_k, v.range_k),
                None => self.valid.push(v.clone()),
            }
        }
        if let (Some(own), Some(at)) = (&mut self.at_mm, &earlier.at_mm) {
            for (axis, range) in at {
                own.entry(axis.clone()).and_modify(|own| *own = joined(*own, *range)).or_insert(*range);
            }
        }
        let known: Vec<String> = self.from.iter().map(|s| s.sha256.clone()).collect();
        self.from.extend(earlier.from.iter().filter(|s| !known.contains(&s.sha256)).cloned());
    }

    /// The range that the fit saw, in words; empty if not stated.
    pub fn place_text(&self) -> String {
        match &self.at_mm {
            None => String::new(),
            Some(at) if at.is_empty() => " at the place of the fit".to_owned(),
            Some(at) => {
                let of = |(axis, [l, h]): (&String, &[f64; 2])| format!("{axis} {l:.0} to {h:.0} mm");
                format!(" for {}", at.iter().map(of).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The range of a warm run stays valid under a later cold fit.
    #[test]
    fn a_fit_on_another_joins_their_ranges() {
        let note = |valid: &[(&str, [f64; 2])]| FitNote {
            response: "error.y".into(),
            date: "2026-05-01".into(),
            valid_until: "2027-05-01".into(),
            rms_um: 0.1,
            half_width_um: 0.2,
            valid: valid
                .iter()
                .map(|(sensor, range_k)| ValidTemperatureRange {
                    difference: TemperatureDifference::single(sensor),
                    range_k: *range_k,
                    um_per_k: 1.3,
                })
                .collect(),
            at_mm: None,
            by_kind_um: BTreeMap::new(),
            from: Vec::new(),
        };
        let mut cold = note(&[("T8", [-0.1, 0.2]), ("T9", [0.0, 1.0])]);
        cold.add_earlier_fit(&note(&[("T8", [0.0, 14.0]), ("T6", [-2.0, 8.0])]), 0.0);
        let ranges: Vec<_> = cold.valid.iter().map(|v| (v.difference.to_string(), v.range_k)).collect();
        let expected = [("T8", [-0.1, 14.0]), ("T9", [0.0, 1.0]), ("T6", [-2.0, 8.0])];
        assert_eq!(ranges, expected.map(|(name, range)| (name.to_owned(), range)));
    }
}
