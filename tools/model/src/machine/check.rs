//! What to know before a model is trusted: values that are unlikely, fits past their date, records that have changed,
//! ranges that are left.

use super::evaluate::differences;
use super::places::folder_of;
use super::{FitNote, Machine, Validity};
use crate::date;
use crate::effect::{Difference, Effect};
use crate::record::{Axis, Record, Role, hex};
use sha2::{Digest, Sha256};

/// A run goes beyond the last knot by as much without a word, of the knots' stretch.
const OVER_TRAVEL: f64 = 0.02;

impl Machine {
    /// What to know before trusting it on a day (days since 1970-01-01): parameters outside what a sound machine
    /// shows, fits past their date.
    #[must_use]
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

    /// Fits whose validity has ended before a day (days since 1970-01-01).
    #[must_use]
    pub fn expired(&self, today: i64) -> Vec<String> {
        let ended = self.fits.iter().filter(|f| date::parse(&f.valid_until).is_some_and(|d| d < today));
        ended.map(|f| format!("{}: the fit's validity ended on {}", f.response, f.valid_until)).collect()
    }

    /// Days since the oldest of its fits, on a day (days since 1970-01-01); none without fits.
    #[must_use]
    pub fn age_days(&self, today: i64) -> Option<i64> {
        self.fits.iter().filter_map(|f| date::parse(&f.date)).min().map(|oldest| today - oldest)
    }

    /// Days until the first of its fits ends, on a day (days since 1970-01-01): 0 on its last day; none without fits.
    #[must_use]
    pub fn days_left(&self, today: i64) -> Option<i64> {
        self.fits.iter().filter_map(|f| date::parse(&f.valid_until)).min().map(|first| first - today)
    }

    /// Records it was fitted on that stand beside it and are no longer what they were.
    #[must_use]
    pub fn changed_sources(&self) -> Vec<String> {
        let fits = self.fits.iter().flat_map(|f| &f.from);
        let mut found = Vec::new();
        for source in fits.chain(self.listed.iter().flat_map(|l| &l.provenance.from)) {
            let folder = source.folder.clone().unwrap_or_default();
            let path = folder_of(&self.path).join(folder).join(&source.file);
            if let Ok(bytes) = rtec_files::text::bytes(&path)
                && hex(&Sha256::digest(bytes)) != source.sha256
            {
                found.push(format!("{} has changed since the model was fitted on it", source.file));
            }
        }
        found.dedup();
        found
    }

    /// Where a record asks the model beyond the range it was fitted on, effect by effect: the differences are held
    /// at the bound there.
    #[must_use]
    pub fn out_of_range(&self, record: &Record) -> Vec<String> {
        let mut found = Vec::new();
        for effect in self.effects() {
            let (Some([lo, hi]), Some(delta)) = (effect.range_k, &effect.delta) else { continue };
            let Some(asked) = differences(effect, record) else { continue };
            let outside = asked.iter().filter(|d| **d < lo || **d > hi).count();
            if outside > 0 {
                let share = 100.0 * outside as f64 / record.rows() as f64;
                found.push(format!(
                    "{} {delta}: {share:.1} % of the rows outside {lo:.2} to {hi:.2} K, held at the bound",
                    effect.name()
                ));
            }
        }
        found.extend(self.fits().iter().filter_map(|fit| self.unseen(fit, record)));
        found.extend(
            self.beyond_stated(|axis| record.data(&Role::Position(axis.clone())).map(<[f64]>::to_vec)),
        );
        found
    }

    /// Effects that are asked beyond the stretch of an axis that their values were stated on: their end values stand there,
    /// whatever the machine does. `places_mm` gives the machine positions along an axis, where they are known.
    #[must_use]
    pub fn beyond_stated(&self, places_mm: impl Fn(&Axis) -> Option<Vec<f64>>) -> Vec<String> {
        let beyond = |effect: &Effect| {
            let (along, [lo, hi]) = effect.stretch_mm()?;
            let axis = effect.axes().get(along)?;
            let places = places_mm(axis)?;
            let slack = OVER_TRAVEL * (hi - lo);
            let outside = places.iter().filter(|p| **p < lo - slack || **p > hi + slack).count();
            let (from, to) = places.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(*p), h.max(*p)));
            (outside > 0).then(|| {
                format!(
                    "{} has values from {lo} to {hi} mm of {axis}, and {:.1} % of the rows are beyond ({from:.1} to {to:.1} mm): its end values \
                     stand there",
                    effect.name(),
                    100.0 * outside as f64 / places.len() as f64
                )
            })
        };
        self.effects().filter_map(beyond).collect()
    }

    /// The difference that leaves most what a fit saw of it, where no effect of the fit's response reads it: what grows with it
    /// there is not in the model at all.
    fn unseen(&self, fit: &FitNote, record: &Record) -> Option<String> {
        let axis = fit.response.split('.').nth(1)?;
        let read = |d: &Difference| {
            let own = self.effects().filter(|e| e.axes().first().is_some_and(|a| a.as_str() == axis));
            own.filter_map(|e| e.delta.as_ref()).any(|e| e == d)
        };
        let farthest = |v: &Validity| -> Option<(f64, f64, usize)> {
            let all = v.of(record)?;
            let cost = |d: &f64| v.outside_um(*d);
            let worst = all.iter().copied().max_by(|a, b| cost(a).total_cmp(&cost(b)))?;
            Some((cost(&worst), worst, all.iter().filter(|d| cost(d) > 0.0).count()))
        };
        let own = fit.valid.iter().filter(|v| !read(&v.difference)).filter_map(|v| Some((v, farthest(v)?)));
        let (v, (um, worst, rows)) = own.max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        let share = 100.0 * rows as f64 / record.rows() as f64;
        (um > fit.half_width_um).then(|| {
            format!(
                "{}: {} reaches {worst:.2} K, and the fit saw {:.2} to {:.2} K ({share:.1} % of the rows outside): what grows with it there \
                 is not in the model",
                fit.response, v.difference, v.range_k[0], v.range_k[1]
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
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
        // What is no day would never end.
        let e = fit("\"2026-05-01\"", "\"soon\"").unwrap_err();
        assert_eq!((e.line, e.found.as_str(), e.expected.as_str()), (5, "`soon`", "a day as YYYY-MM-DD"));
        assert!(fit("\"1. Mai 2026\"", "\"2027-05-01\"").is_err());
    }

    /// A fit that has seen no temperature states an interval for a machine as it was, not for one that warms by 12 K.
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
            Record::new(Path::new("r.run.toml"), Kind::Drift, columns).unwrap()
        };
        let response = Role::parse("error.x").unwrap();
        let cold = parse(&format!("name = \"m\"\n{note}{effect}")).unwrap();
        assert!(cold.half_widths_um(&run(0.5), &response).is_some());
        assert!(cold.half_widths_um(&run(12.0), &response).is_none());
        let warm = parse(&format!("name = \"m\"\n{note}{valid}{effect}")).unwrap();
        assert!(warm.half_widths_um(&run(12.0), &response).is_some());
    }

    /// A map from 0 to 300 mm, asked at 640 mm: its last value stands there, and that is said.
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

    /// A model that has no effect of a difference, asked where that one is by far what the fit saw of it.
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
            Record::new(Path::new("r.run.toml"), Kind::Drift, columns).unwrap()
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
