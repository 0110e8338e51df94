//! Warnings about a model before it is used.
//! They report unlikely values, expired fits, changed records, and inputs outside the fitted ranges.

use super::record_prediction::differences;
use super::relative_paths::folder_of;
use super::{EffectWithProvenance, FitNote, Machine, ValidTemperatureRange};
use crate::effect::{Effect, States, TemperatureDifference};
use crate::record::{Axis, Record, Role, sha256_of};
use rtec_files::date;

/// Allowed travel beyond the last knot, as a share of the knots' range.
/// Farther travel is reported.
const OVER_TRAVEL: f64 = 0.02;

impl Machine {
    /// Reasons not to use the model on a day (days since 1970-01-01).
    /// They are parameters outside the plausible range, expired fits and fits dated in the future.
    pub fn doubts(&self, today: i64) -> Vec<String> {
        let mut found = Vec::new();
        for e in self.effects() {
            for (i, p) in e.description().parameters.iter().enumerate() {
                let [lo, hi] = p.plausible;
                if let Some(v) = e.get(i).iter().find(|v| **v < lo || **v > hi) {
                    found.push(format!(
                        "{}: {} = {v} {} is outside {lo} to {hi}, unlikely",
                        e.name(),
                        p.name,
                        p.unit
                    ));
                }
            }
        }
        // An older model may have been fitted before zeros were marked.
        let of_a_gauge = |l: &&EffectWithProvenance| {
            let by_fit = l.provenance.added_by.as_deref() == Some("model fit");
            l.effect.description().may_be_set_up() && by_fit && !l.provenance.set_up
        };
        found.extend(self.listed().iter().filter(of_a_gauge).map(|l| {
            format!(
                "{}: a fit took it from the gauges' zero, and it is corrected live: `set_up = true` beside it, or a new fit, keeps it out",
                l.effect.name()
            )
        }));
        found.extend(self.expired(today));
        let early = self.fits().iter().filter(|f| date::parse(&f.date).is_some_and(|d| d > today));
        found.extend(early.map(|f| {
            let now = date::format(today);
            format!(
                "{}: fitted on {}, and it is {now} by this machine's clock: is the clock right?",
                f.response, f.date
            )
        }));
        found
    }

    /// Fits whose validity ended before a day (days since 1970-01-01).
    pub fn expired(&self, today: i64) -> Vec<String> {
        let ended = self.fits.iter().filter(|f| date::parse(&f.valid_until).is_some_and(|d| d < today));
        ended.map(|f| format!("{}: the fit's validity ended on {}", f.response, f.valid_until)).collect()
    }

    /// Age of the oldest fit on a day (days since 1970-01-01), in days.
    /// `None` without fits.
    pub fn age_days(&self, today: i64) -> Option<i64> {
        self.fits.iter().filter_map(|f| date::parse(&f.date)).min().map(|oldest| today - oldest)
    }

    /// Days until the first fit expires, on a day (days since 1970-01-01).
    /// It is 0 on the last valid day. `None` without fits.
    pub fn days_left(&self, today: i64) -> Option<i64> {
        self.fits.iter().filter_map(|f| date::parse(&f.valid_until)).min().map(|first| first - today)
    }

    /// Records it was fitted on whose files have changed since.
    pub fn changed_sources(&self) -> Vec<String> {
        let fits = self.fits.iter().flat_map(|f| &f.from);
        let mut found = Vec::new();
        for source in fits.chain(self.listed.iter().flat_map(|l| &l.provenance.from)) {
            let folder = source.folder.clone().unwrap_or_default();
            let path = folder_of(&self.path).join(folder).join(&source.file);
            if sha256_of(&path).is_ok_and(|now| now != source.sha256) {
                found.push(format!("{} has changed since the model was fitted on it", source.file));
            }
        }
        found.dedup();
        found
    }

    /// Where a record leaves the ranges that the model was fitted on, by effect.
    /// There the temperature differences are held at the bound.
    pub fn out_of_range(&self, record: &Record) -> Vec<String> {
        let mut asked = FitRangeCheck::of(self);
        asked.see(record);
        asked.out_of_range()
    }

    /// Effects that are evaluated beyond the range that their values were stated on.
    /// There the end values apply, whatever the machine does. `places_mm` gives the machine positions along
    /// an axis, or `None` if they are not known.
    pub fn beyond_stated(&self, places_mm: impl Fn(&Axis) -> Option<Vec<f64>>) -> Vec<String> {
        let beyond = |effect: &Effect| {
            let mut places = MapPositionRangeCheck::default();
            places.see(effect, &places_mm(MapPositionRangeCheck::axis(effect)?)?);
            places.beyond_stated(effect)
        };
        self.effects().filter_map(beyond).collect()
    }
}

/// Collects where a record leaves what a model was fitted on, piece by piece.
#[derive(Debug)]
pub struct FitRangeCheck<'m> {
    machine: &'m Machine,
    rows: usize,
    /// Per effect: the number of rows outside its fitted range, and its lag's state.
    outside: Vec<(usize, States)>,
    /// Per effect: the positions of its axis.
    places: Vec<MapPositionRangeCheck>,
    /// Per fit and per difference that it saw: the row farthest outside.
    farthest: Vec<Vec<Option<LargestRangeExcess>>>,
}

impl<'m> FitRangeCheck<'m> {
    /// The state before the first piece.
    pub fn of(machine: &'m Machine) -> Self {
        let effects = machine.effects().count();
        Self {
            machine,
            rows: 0,
            outside: vec![(0, States::default()); effects],
            places: vec![MapPositionRangeCheck::default(); effects],
            farthest: machine.fits().iter().map(|f| vec![None; f.valid.len()]).collect(),
        }
    }

    /// Adds the next rows.
    pub fn see(&mut self, record: &Record) {
        self.rows += record.rows();
        for (effect, (outside, states)) in self.machine.effects().zip(&mut self.outside) {
            let Some([lo, hi]) = effect.range_k.filter(|_| effect.delta.is_some()) else { continue };
            let Some(asked) = differences(effect, record, states) else { continue };
            *outside += asked.iter().filter(|d| **d < lo || **d > hi).count();
        }
        for (effect, places) in self.machine.effects().zip(&mut self.places) {
            let of = |axis: &Axis| record.data(&Role::Position(axis.clone()));
            if let Some(along) = MapPositionRangeCheck::axis(effect).and_then(of) {
                places.see(effect, along);
            }
        }
        for (fit, farthest) in self.machine.fits().iter().zip(&mut self.farthest) {
            for (v, farthest) in fit.valid.iter().zip(farthest) {
                if let Some(all) = v.of(record) {
                    LargestRangeExcess::see(farthest, v, &all);
                }
            }
        }
    }

    /// The findings of [`Machine::out_of_range`] for all rows so far.
    pub fn out_of_range(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (effect, (outside, _)) in self.machine.effects().zip(&self.outside) {
            let (Some([lo, hi]), Some(delta), true) = (effect.range_k, &effect.delta, *outside > 0) else {
                continue;
            };
            let share = 100.0 * *outside as f64 / self.rows as f64;
            found.push(format!(
                "{} {delta}: {share:.1} % of the rows outside {lo:.2} to {hi:.2} K, held at the bound",
                effect.name()
            ));
        }
        let fits = self.machine.fits().iter().zip(&self.farthest);
        found.extend(fits.filter_map(|(fit, farthest)| self.unseen(fit, farthest)));
        let places = self.machine.effects().zip(&self.places);
        found.extend(places.filter_map(|(effect, places)| places.beyond_stated(effect)));
        found
    }

    /// The temperature difference farthest outside the fit that no effect reads.
    /// The model lacks any growth with that difference.
    fn unseen(&self, fit: &FitNote, farthest: &[Option<LargestRangeExcess>]) -> Option<String> {
        let axis = fit.response.split('.').nth(1)?;
        let read = |d: &TemperatureDifference| {
            let own = self.machine.effects().filter(|e| e.axes().first().is_some_and(|a| a.as_str() == axis));
            own.filter_map(|e| e.delta.as_ref()).any(|e| e == d)
        };
        let own = fit.valid.iter().zip(farthest).filter(|(v, _)| !read(&v.difference));
        let own = own.filter_map(|(v, farthest)| Some((v, farthest.as_ref()?)));
        let (v, worst) = own.max_by(|a, b| a.1.um.total_cmp(&b.1.um))?;
        let share = 100.0 * worst.rows as f64 / self.rows as f64;
        (worst.um > fit.half_width_um).then(|| {
            format!(
                "{}: {} reaches {:.2} K, and the fit saw {:.2} to {:.2} K ({share:.1} % of the rows outside): what grows with it there \
                 is not in the model",
                fit.response, v.difference, worst.delta_k, v.range_k[0], v.range_k[1]
            )
        })
    }
}

/// How far a difference went outside the range of a fit.
/// It holds the possible error there, µm, the difference, K, and the number of rows outside.
#[derive(Debug, Clone)]
struct LargestRangeExcess {
    um: f64,
    delta_k: f64,
    rows: usize,
}

impl LargestRangeExcess {
    fn see(farthest: &mut Option<Self>, v: &ValidTemperatureRange, all: &[f64]) {
        for delta_k in all {
            let um = v.outside_um(*delta_k);
            let own = farthest.get_or_insert(Self { um, delta_k: *delta_k, rows: 0 });
            own.rows += usize::from(um > 0.0);
            if um.total_cmp(&own.um).is_ge() {
                (own.um, own.delta_k) = (um, *delta_k);
            }
        }
    }
}

/// Positions along the axis that an effect's values are stated on, mm.
#[derive(Debug, Clone)]
struct MapPositionRangeCheck {
    rows: usize,
    beyond: usize,
    from_mm: f64,
    to_mm: f64,
}

impl Default for MapPositionRangeCheck {
    fn default() -> Self {
        Self { rows: 0, beyond: 0, from_mm: f64::MAX, to_mm: f64::MIN }
    }
}

impl MapPositionRangeCheck {
    /// The axis of an effect whose values were stated on a range.
    fn axis(effect: &Effect) -> Option<&Axis> {
        effect.axes().get(effect.stretch_mm()?.0)
    }

    fn see(&mut self, effect: &Effect, places_mm: &[f64]) {
        let Some((_, [lo, hi])) = effect.stretch_mm() else { return };
        let slack = OVER_TRAVEL * (hi - lo);
        self.rows += places_mm.len();
        for p in places_mm {
            self.beyond += usize::from(*p < lo - slack || *p > hi + slack);
            (self.from_mm, self.to_mm) = (self.from_mm.min(*p), self.to_mm.max(*p));
        }
    }

    fn beyond_stated(&self, effect: &Effect) -> Option<String> {
        let (Some((_, [lo, hi])), true) = (effect.stretch_mm(), self.beyond > 0) else { return None };
        Some(format!(
            "{} has values from {lo} to {hi} mm of {}, and {:.1} % of the rows are beyond ({:.1} to {:.1} mm): its end values \
             stand there",
            effect.name(),
            Self::axis(effect)?,
            100.0 * self.beyond as f64 / self.rows as f64,
            self.from_mm,
            self.to_mm
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::RecordRanges;
    use crate::record::RunKind;
    use rtec_files::InputError;
    use std::path::Path;

    fn parse(text: &str) -> Result<Machine, InputError> {
        Machine::parse(Path::new("m.toml"), text)
    }

    #[test]
    fn a_fit_has_days_and_ends() {
        let fit = |date: &str, until: &str| {
            parse(&format!(
                "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = {date}\nvalid_until = {until}\nrms_um = 1\n\
                 half_width_um = 2\n"
            ))
        };
        let day = |text: &str| date::parse(text).unwrap();
        let m = fit("2026-05-01", "\"2027-05-01\"").unwrap();
        assert!(m.expired(day("2027-05-01")).is_empty() && m.doubts(day("2026-05-01")).is_empty());
        assert_eq!(m.expired(day("2027-05-02")), ["error.x: the fit's validity ended on 2027-05-01"]);
        assert_eq!(m.doubts(day("2027-05-02")), m.expired(day("2027-05-02")));
        assert!(m.doubts(0)[0].contains("1970-01-01 by this machine's clock"), "{:?}", m.doubts(0));
        // An invalid date would never expire.
        let e = fit("\"2026-05-01\"", "\"soon\"").unwrap_err();
        assert_eq!((e.line, e.found.as_str(), e.expected.as_str()), (5, "`soon`", "a day as YYYY-MM-DD"));
        assert!(fit("\"1. Mai 2026\"", "\"2027-05-01\"").is_err());
    }

    /// A fit that saw no temperature gives no interval for a machine that warms up.
    #[test]
    fn an_interval_of_cold_geometry_is_none_for_a_warm_machine() {
        let note = "[[fit]]\nresponse = \"error.x\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 0.1\nhalf_width_um = 0.2\n";
        let valid = "valid = [{ sensor = \"T1\", range_K = [0.0, 12.0], um_per_K = 1.0 }]\n";
        let effect = "[[effect]]\nname = \"scale.x\"\nppm = 25.0\n";
        let run = |warm: f64| {
            let column = |name: &str, role, data| crate::record::Column::new(name, role, data);
            let columns = vec![
                column("T1", Role::Temperature, (0..10).map(|i| 20.0 + warm * f64::from(i) / 9.0).collect()),
                column("e", Role::parse("error.x").unwrap(), vec![0.0; 10]),
            ];
            Record::new(Path::new("r.run.toml"), RunKind::Drift, columns).unwrap()
        };
        let response = Role::parse("error.x").unwrap();
        let cold = parse(&format!("name = \"m\"\n{note}{effect}")).unwrap();
        assert!(cold.half_widths_um(&run(0.5), &response).is_some());
        assert!(cold.half_widths_um(&run(12.0), &response).is_none());
        let said = cold.fit_with_interval(&RecordRanges::of(&run(12.0)), &response).unwrap_err();
        assert!(said.contains("saw no temperature"), "{said}");
        let none = parse(&format!("name = \"m\"\n{effect}")).unwrap();
        assert_eq!(
            none.fit_with_interval(&RecordRanges::of(&run(0.5)), &response).unwrap_err(),
            "the model states no interval"
        );
        let warm = parse(&format!("name = \"m\"\n{note}{valid}{effect}")).unwrap();
        assert!(warm.half_widths_um(&run(12.0), &response).is_some());
    }

    /// There is no interval if an axis moves where the fit has not seen it.
    /// The reason names both ranges.
    #[test]
    fn an_interval_that_is_not_of_a_place_says_so() {
        let m = parse(
            "name = \"m\"\n[[fit]]\nresponse = \"error.y\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 0.1\n\
             half_width_um = 0.2\nat_mm = { y = [-150.0, 150.0] }\n[[effect]]\nname = \"scale.y\"\nppm = 25.0\n",
        )
        .unwrap();
        let response = Role::parse("error.y").unwrap();
        let said = |axis: &str, reach_mm: f64| {
            let at = Role::parse(&format!("position.{axis}")).unwrap();
            let columns = vec![
                crate::record::Column::new("p", at, vec![-reach_mm, reach_mm]),
                crate::record::Column::new("e", response.clone(), vec![0.0; 2]),
            ];
            let run = Record::new(Path::new("r.run.toml"), RunKind::Positioning, columns).unwrap();
            assert_eq!(
                m.half_widths_um(&run, &response).is_some(),
                m.fit_with_interval(&RecordRanges::of(&run), &response).is_ok()
            );
            m.fit_with_interval(&RecordRanges::of(&run), &response).err()
        };
        assert_eq!(said("y", 160.0), None, "a tenth of the range beyond");
        let far = said("y", 286.4).unwrap();
        assert!(far.contains("y from -150 to 150 mm") && far.contains("from -286 to 286 mm"), "{far}");
        assert!(said("x", 50.0).unwrap().contains("x at one place"));
    }

    /// A map from 0 to 300 mm is evaluated at 640 mm.
    /// Its last value applies there, and a warning says so.
    #[test]
    fn beyond_the_knots_is_said() {
        let m = parse(
            "name = \"m\"\n[[effect]]\nname = \"position_map.x\"\nknots_mm = [0, 150, 300]\num = [0, 4, -9]\n\
             [[effect]]\nname = \"straightness.y.x\"\nknots_mm = [0, 700]\num = [0, 4]\n",
        )
        .unwrap();
        let at = |places: &[f64]| m.beyond_stated(|axis| (axis.as_str() == "x").then(|| places.to_vec()));
        assert_eq!(at(&[0.0, 300.0, 305.0]), [""; 0], "a hair beyond is the run's over-travel");
        let said = at(&[0.0, 100.0, 200.0, 640.0]);
        assert!(
            said.len() == 1
                && said[0].starts_with("position_map.x has values from 0 to 300 mm of x, and 25.0 %"),
            "{said:?}"
        );
    }

    /// A difference that no effect reads goes far beyond the range that the fit saw.
    #[test]
    fn what_the_fit_never_saw_is_said() {
        let m = parse(
            "name = \"m\"\n[[fit]]\nresponse = \"error.z\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 0.4\n\
             half_width_um = 0.7\nvalid = [{ sensor = \"T1\", minus = \"T0\", range_K = [-0.2, 1.2], um_per_K = 3.7 }]\n\
             [[effect]]\nname = \"offset.z\"\num = 0.1\n",
        )
        .unwrap();
        let run = |warm: f64| {
            let column = |name: &str, role, data| crate::record::Column::new(name, role, data);
            let columns = vec![
                column("t", Role::Time, (0..10).map(f64::from).collect()),
                column("T0", Role::Temperature, vec![20.0; 10]),
                column("T1", Role::Temperature, (0..10).map(|i| 20.0 + warm * f64::from(i) / 9.0).collect()),
                column("e", Role::parse("error.z").unwrap(), vec![0.0; 10]),
            ];
            Record::new(Path::new("r.run.toml"), RunKind::Drift, columns).unwrap()
        };
        assert_eq!(m.out_of_range(&run(1.0)), [""; 0]);
        let said = m.out_of_range(&run(7.75));
        assert!(
            said.len() == 1
                && said[0].contains("T1-T0 reaches 7.75 K")
                && said[0].contains("not in the model"),
            "{said:?}"
        );
    }
}
