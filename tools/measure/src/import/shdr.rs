//! A log of `MTConnect` SHDR lines: `TIME|KEY|VALUE`, several pairs a line.
//! Lines that are not samples of a wanted key are ignored.

use super::table::ImportColumn;
use super::{add_note, finite, record_of};
use rtec_files::clock_column::{self, EpochTime, day, iso8601_ns};
use rtec_files::message_text::is_comment;
use rtec_files::{InputError, Result};
use rtec_model::record::{Column, Record, Role, RunKind};
use std::path::Path;

/// Reads the wanted keys.
/// Every change of a key gives a row; the other keys keep their last values. Rows begin when all are known,
/// and pause while one is `UNAVAILABLE`. Times are ISO 8601, or seconds; time 0 is the first row's.
///
/// # Errors
/// An invalid or decreasing time, a wanted value that is not a number, a wanted key without a value.
pub fn shdr(
    from: &Path,
    text: &str,
    wanted: &[ImportColumn],
    kind: RunKind,
    log: bool,
    to: &Path,
) -> Result<Record> {
    if let Some(w) = wanted.iter().find(|w| w.role == Role::Time) {
        let expected = "no column for the time: it stands in front of every line";
        return Err(InputError::whole(from, format!("`{}` as time", w.column), expected));
    }
    let mut now: Vec<Option<f64>> = vec![None; wanted.len()];
    let mut told = vec![false; wanted.len()];
    let mut data: Vec<Vec<f64>> = vec![Vec::new(); wanted.len()];
    let (mut times, mut start): (Vec<i128>, Option<(i128, String)>) = (Vec::new(), None);
    let mut lines = text.lines().enumerate();
    while let Some((i, line)) = lines.next() {
        // Protocol lines (`* PING`), comments and empty lines.
        if line.trim().is_empty() || line.starts_with('*') || is_comment(line) {
            continue;
        }
        let mut fields = line.split('|');
        let stamp = fields.next().unwrap_or_default();
        // A duration may follow the time after an @.
        let time = stamp.split('@').next().unwrap_or(stamp);
        let ns = nanoseconds(time).ok_or_else(|| {
            let expected = "a time as 2022-08-08T13:51:37.25Z, or seconds, then |";
            InputError::line(from, i + 1, format!("`{stamp}`"), expected)
        })?;
        let fields: Vec<&str> = fields.collect();
        // A document, up to the line that repeats its mark.
        if let Some(mark) = fields.last().filter(|f| f.starts_with("--multiline--")) {
            if !lines.any(|(_, line)| line.trim_end() == mark.trim_end()) {
                let expected = "the same mark at the end of what it begins";
                return Err(InputError::line(from, i + 1, format!("`{mark}`"), expected));
            }
            continue;
        }
        let mut changed = false;
        let mut rest = &fields[..];
        while let [key, value, more @ ..] = rest {
            if let Some(place) = wanted.iter().position(|w| w.column == *key) {
                (told[place], changed) = (true, true);
                let scaled = |v: f64| v * wanted[place].scale[0] + wanted[place].scale[1];
                now[place] = sample(value.trim()).map(|v| v.map(scaled)).ok_or_else(|| {
                    let (at, value) = (line.find(key).unwrap_or(0) + 1, value.trim());
                    InputError::at(from, i + 1, at, format!("`{value}` of {key}"), "a number, or UNAVAILABLE")
                })?;
            }
            rest = more;
        }
        if !changed || now.iter().any(Option::is_none) {
            continue;
        }
        if times.last().is_some_and(|last| ns < *last) {
            let found = format!("`{stamp}` before the time of the row in front");
            return Err(InputError::line(from, i + 1, found, "times that never decrease"));
        }
        if times.last() == Some(&ns) {
            // Changes at one time give one row.
            times.pop();
            for data in &mut data {
                data.pop();
            }
        }
        start.get_or_insert_with(|| (ns, time.to_owned()));
        times.push(ns);
        for (data, v) in data.iter_mut().zip(now.iter().flatten()) {
            data.push(*v);
        }
    }
    if let Some((w, _)) = wanted.iter().zip(&told).find(|(_, told)| !**told) {
        return Err(InputError::whole(from, format!("no `{}`", w.column), "every wanted key at least once"));
    }
    let Some((first, text)) = start else {
        return Err(InputError::whole(from, "no time at which all wanted keys are known", "at least one"));
    };
    let times = times.iter().map(|t| (t - first) as f64 / 1e9).collect();
    let mut columns = vec![Column::new("t", Role::Time, times)];
    columns.extend(wanted.iter().zip(data).map(|(w, data)| w.filled(data)));
    let mut record = record_of(to, kind, columns, log)?;
    let counted = text.parse().ok().and_then(clock_column::recognise_epoch_time);
    record.date = match &counted {
        Some(EpochTime { day, .. }) => Some(day.clone()),
        None => text.contains('-').then(|| day(first)),
    };
    let what = counted.map_or_else(String::new, |c| format!(", {} of {}", c.what, c.day));
    add_note(&mut record, &format!("time 0 is {text}{what}; values hold until the next is told"));
    Ok(record)
}

/// ISO 8601, or seconds.
fn nanoseconds(time: &str) -> Option<i128> {
    let seconds = || finite(time).filter(|t| t.abs() < 1e12);
    iso8601_ns(time).or_else(|| seconds().map(|s| (s * 1e9).round() as i128))
}

/// Value of a sample, `Some(None)` if unavailable; `None` if it is not a sample.
#[allow(clippy::option_option)]
fn sample(value: &str) -> Option<Option<f64>> {
    if value.is_empty() || value.eq_ignore_ascii_case("UNAVAILABLE") {
        return Some(None);
    }
    finite(value).map(Some)
}
