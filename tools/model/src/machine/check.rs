//! What to know before a model is trusted: values that are unlikely, fits past their date, records that have changed,
//! ranges that are left.

use super::Machine;
use super::evaluate::differences;
use super::places::folder_of;
use crate::date;
use crate::record::{Record, hex};
use sha2::{Digest, Sha256};

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
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
}
