//! What a fit says about itself and about its effects: records, dates, intervals, the range in which it is valid.

use crate::effect::{Against, Difference, Effect, STANDARD_DEGC};
use crate::record::{Kind, Record, Role};
use std::collections::BTreeMap;
use std::path::PathBuf;

use super::places::folder_of;

/// Half width of a normal distribution's 95 % interval in standard deviations.
pub const NORMAL_95: f64 = 1.96;

/// Possible error of a temperature effect at a row, µm, beyond what the fit leaves.
///
/// It is the slope at the bound times the excess. `elapsed_s` after a start it also has its part of an unknown state of
/// the lag.
#[must_use]
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

/// A record that something was fitted on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Name of the record's CSV.
    pub file: String,
    /// SHA-256 of it, in hexadecimal.
    pub sha256: String,
    /// Where it lies; none for beside the model.
    pub folder: Option<PathBuf>,
}

impl Source {
    /// The source that a record is.
    #[must_use]
    pub fn of(record: &Record) -> Self {
        let folder = Some(folder_of(&record.path));
        Self { file: record.file.clone(), sha256: record.sha256.clone(), folder }
    }
}

/// Where an effect comes from. All of it may be absent, as in what a person writes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// The program or person that added the effect.
    pub added_by: Option<String>,
    /// The date, as ISO 8601.
    pub date: Option<String>,
    /// The records it was fitted on.
    pub from: Vec<Source>,
    /// Interval of each parameter, one pair per value.
    pub interval: BTreeMap<String, Vec<[f64; 2]>>,
    /// It belongs to how the gauges stood (their zero), not to the machine: part of what is predicted of a record, never corrected
    /// live.
    pub set_up: bool,
}

/// An effect of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Records, dates and intervals that the effect comes with.
    pub provenance: Provenance,
}

impl Listed {
    /// What it is known by among a machine's effects: the zero of a set-up may stand beside the machine's own offset.
    #[must_use]
    pub fn identity(&self) -> String {
        let set_up = if self.provenance.set_up { ", set_up" } else { "" };
        format!("{}{set_up}", self.effect.identity())
    }
}

/// The range of a temperature difference in which a fit is valid.
#[derive(Debug, Clone, PartialEq)]
pub struct Validity {
    /// The difference, one that the model reads or not.
    pub difference: Difference,
    /// From where to where it was seen, K.
    pub range_k: [f64; 2],
    /// How much the response moved with it, µm/K.
    pub um_per_k: f64,
}

impl Validity {
    /// The difference at every row of a record.
    /// Nothing where the record lacks a sensor of it.
    #[must_use]
    pub fn of(&self, record: &Record) -> Option<Vec<f64>> {
        let u = record.temperature(&self.difference.sensor)?;
        let minus: &dyn Fn(usize) -> f64 = match &self.difference.against {
            Against::Sensor(m) => {
                let m = record.temperature(m)?;
                &move |row| m[row]
            }
            Against::Reference(degc) => &move |_| *degc,
            Against::Standard => &|_| STANDARD_DEGC,
        };
        Some(u.iter().enumerate().map(|(row, u)| u - minus(row)).collect())
    }

    /// What being so far outside may cost, µm.
    #[must_use]
    pub fn outside_um(&self, delta_k: f64) -> f64 {
        self.um_per_k * (delta_k - self.range_k[1]).max(self.range_k[0] - delta_k).max(0.0)
    }
}

/// What a fit says about itself: which response, when, on what, how good, how long it may be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct FitNote {
    /// The response that was fitted, as `error.z`.
    pub response: String,
    /// The date of the fit, as ISO 8601.
    pub date: String,
    /// The last day on which it may be used without being looked at again.
    pub valid_until: String,
    /// RMS on blocks of time that the fit had not seen, µm (N of a force, as all widths here).
    pub rms_um: f64,
    /// Half width of the 95 % prediction interval, µm.
    pub half_width_um: f64,
    /// Where it is valid: outside of these, the interval is wider.
    pub valid: Vec<Validity>,
    /// Where each axis was while it was seen, mm; axes that are not named stood still.
    ///
    /// Elsewhere there is no interval: what the machine does there no record has shown. None in a model that does not
    /// say.
    pub at_mm: Option<BTreeMap<String, [f64; 2]>>,
    /// The same by kind of run, as `positioning`.
    /// What no run has shown has the largest of all.
    pub by_kind_um: BTreeMap<String, f64>,
    /// The records that it was fitted on.
    pub from: Vec<Source>,
}

/// An axis that moves by less stands still, mm.
const STILL_MM: f64 = 1.0;

/// A machine whose temperatures move by more within a record is not the one that a fit without temperatures has seen, K.
const WARMS_K: f64 = 2.0;

/// From where to where a record's axes and temperatures go, gathered piece by piece: what an interval asks of all its rows.
#[derive(Debug, Clone, Default)]
pub struct Reach {
    kind: Option<Kind>,
    /// Of every axis, mm.
    at_mm: BTreeMap<String, [f64; 2]>,
    /// Of every sensor, °C.
    degc: BTreeMap<String, [f64; 2]>,
}

impl Reach {
    /// That of a whole record.
    #[must_use]
    pub fn of(record: &Record) -> Self {
        let mut reach = Self::default();
        reach.see(record);
        reach
    }

    /// The next rows.
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

    /// Where the axes that do not stand still are, mm.
    fn places(&self) -> impl Iterator<Item = (&String, &[f64; 2])> {
        self.at_mm.iter().filter(|(_, [l, h])| *h - *l > STILL_MM)
    }

    /// The kind of the record as an interval knows it: a drift in which an axis moves is like no other.
    fn kind(&self) -> Option<Kind> {
        self.kind.filter(|kind| *kind != Kind::Drift || self.places().next().is_none())
    }
}

impl FitNote {
    /// The unit of a response, and so of its RMS and widths.
    #[must_use]
    pub fn unit_of(response: &str) -> &'static str {
        if response.starts_with("force.") { "N" } else { "µm" }
    }

    /// The keys of RMS, half width and half widths by kind of run in a file.
    pub(super) fn keys_of(response: &str) -> [&'static str; 3] {
        match Self::unit_of(response) {
            "N" => ["rms_N", "half_width_N", "by_kind_N"],
            _ => ["rms_um", "half_width_um", "by_kind_um"],
        }
    }

    /// Where the axes of records are: from where to where each moves, mm.
    #[must_use]
    pub fn places(records: &[&Record]) -> BTreeMap<String, [f64; 2]> {
        let mut reach = Reach::default();
        for record in records {
            reach.see(record);
        }
        reach.places().map(|(axis, range)| (axis.clone(), *range)).collect()
    }

    /// Why the interval says nothing of a record; `None` where it does.
    ///
    /// It was seen wherever the record's axes go: a tenth of its range beyond is as good. Where the fit has seen no
    /// temperature, a machine that warms is another one.
    #[must_use]
    pub fn not_of(&self, reach: &Reach) -> Option<String> {
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
    #[must_use]
    pub fn has_zero_of(&self, reach: &Reach) -> bool {
        let known = |kind: Kind| self.by_kind_um.is_empty() || self.by_kind_um.contains_key(kind.name());
        reach.kind().is_none_or(known) && self.not_of(reach).is_none()
    }

    /// Whether places seen, mm, tell of this stretch of the axis: within them, or a tenth of them beyond.
    #[must_use]
    pub fn reaches([from, to]: [f64; 2], [low, high]: [f64; 2]) -> bool {
        let margin = 0.1 * (to - from);
        low >= from - margin && high <= to + margin
    }

    /// The kind of a record as an interval knows it: a drift in which an axis moves is like no other.
    #[must_use]
    pub fn kind_of(record: &Record) -> Option<String> {
        Reach::of(record).kind().map(|kind| kind.name().to_owned())
    }

    /// Half width of the 95 % interval for a record, µm.
    #[must_use]
    pub fn half_width_for_um(&self, reach: &Reach) -> f64 {
        let own = reach.kind().and_then(|kind| self.by_kind_um.get(kind.name()));
        own.copied().unwrap_or(self.half_width_um)
    }

    /// This fit on top of an earlier one of the same response.
    ///
    /// Their uncertainties add up, less the gauge's noise (one standard deviation, µm), which is in both. Their ranges
    /// are joined.
    /// A kind of run that only one of them has seen keeps its uncertainty: a drift at one place does not see changes
    /// from place to place.
    pub fn on(&mut self, earlier: &Self, noise_um: f64) {
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
                Some(own) => {
                    own.range_k = [own.range_k[0].min(v.range_k[0]), own.range_k[1].max(v.range_k[1])];
                }
                None => self.valid.push(v.clone()),
            }
        }
        if let (Some(own), Some(at)) = (&mut self.at_mm, &earlier.at_mm) {
            for (axis, [l, h]) in at {
                let all = own.entry(axis.clone()).or_insert([*l, *h]);
                *all = [all[0].min(*l), all[1].max(*h)];
            }
        }
        let known: Vec<String> = self.from.iter().map(|s| s.sha256.clone()).collect();
        self.from.extend(earlier.from.iter().filter(|s| !known.contains(&s.sha256)).cloned());
    }

    /// Where it was seen, in words; empty where it does not say.
    #[must_use]
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

    /// What a warm run has shown stays valid under a later cold fit.
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
                .map(|(sensor, range_k)| Validity {
                    difference: Difference::single(sensor),
                    range_k: *range_k,
                    um_per_k: 1.3,
                })
                .collect(),
            at_mm: None,
            by_kind_um: BTreeMap::new(),
            from: Vec::new(),
        };
        let mut cold = note(&[("T8", [-0.1, 0.2]), ("T9", [0.0, 1.0])]);
        cold.on(&note(&[("T8", [0.0, 14.0]), ("T6", [-2.0, 8.0])]), 0.0);
        let ranges: Vec<_> = cold.valid.iter().map(|v| (v.difference.to_string(), v.range_k)).collect();
        let expected = [("T8", [-0.1, 14.0]), ("T9", [0.0, 1.0]), ("T6", [-2.0, 8.0])];
        assert_eq!(ranges, expected.map(|(name, range)| (name.to_owned(), range)));
    }
}
