//! Output of LinuxCNC's `halsampler`.
//! Values are separated by blanks, with a blank at the end. With `-t` the sample's number comes first. A line
//! `overrun` marks lost samples. The file has no times, so the period is an option.

use super::add_note;
use super::table::{ImportColumn, TableSyntax, table};
use rtec_files::message_text::is_comment;
use rtec_files::{InputError, Result};
use rtec_model::record::{Column, Record, Role, RunKind};
use std::path::Path;

/// How the log was sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// Sampling period, s.
    pub period_s: f64,
    /// Whether the sample's number comes first (`-t`).
    pub numbered: bool,
}

/// Reads a halsampler log.
/// Columns are named by their numbers, from 1, without the sample's number.
///
/// # Errors
/// An invalid period, an overrun in a log without numbers, numbers that do not rise, and errors of [`table`].
pub fn halsampler(
    from: &Path,
    text: &str,
    wanted: &[ImportColumn],
    sampling: &Sampling,
    form: &TableSyntax,
    kind: RunKind,
    to: &Path,
) -> Result<Record> {
    /// Fewest lines that count by one and are not chance.
    const COUNTED: usize = 3;
    let Sampling { period_s, numbered } = *sampling;
    if !(period_s > 0.0 && period_s.is_finite()) {
        return Err(InputError::whole(from, format!("--period-s {period_s}"), "seconds a sample, above 0"));
    }
    let mut lost = Vec::new();
    let mut times = Vec::new();
    let mut plain = String::with_capacity(text.len());
    for (i, line) in text.lines().enumerate() {
        if line.trim() == "overrun" {
            if !numbered {
                let expected =
                    "a log without gaps, or one with the samples' numbers (halsampler -t) and --numbered";
                return Err(InputError::line(from, i + 1, "`overrun`: samples are lost here", expected));
            }
            lost.push((i + 1).to_string());
        } else if !(line.trim().is_empty() || is_comment(line)) {
            let word = line.split_whitespace().next().unwrap_or_default();
            let n = if numbered { word.parse().ok() } else { Some(times.len() as u64) };
            let expected = "the sample's number in front";
            let n = n.ok_or_else(|| InputError::line(from, i + 1, format!("`{word}`"), expected))?;
            times.push(n as f64 * period_s);
            plain.push_str(line);
        }
        plain.push('\n');
    }
    let firsts = text.lines().filter(|l| !is_comment(l)).filter_map(|l| l.split_whitespace().next());
    let numbers: Vec<u64> = firsts.map_while(|word| word.parse().ok()).collect();
    // Numbers skip where samples were lost.
    let by_one = numbers.windows(2).filter(|w| w[1] == w[0] + 1).count();
    let counts = numbers.len() == times.len() && 10 * (by_one + 1) >= 9 * numbers.len();
    if !numbered && counts && times.len() >= COUNTED && wanted.iter().any(|w| w.column == "1") {
        let expected = "a quantity: these are the samples' numbers (halsampler -t); say --numbered, which leaves them out of the columns; \
                        a quantity that counts like this is read by --format own";
        return Err(InputError::line(from, 1, "column 1 counts 0, 1, 2 … line by line", expected));
    }
    // The sample's number is a column of the file, but not of the user's count.
    let shift = |w: &ImportColumn| match w.column.parse::<usize>() {
        Ok(n) if numbered => ImportColumn { column: (n + 1).to_string(), ..w.clone() },
        _ => w.clone(),
    };
    let shifted: Vec<ImportColumn> = wanted.iter().map(shift).collect();
    let form = TableSyntax { by: Some(' '), nameless: true, ..form.clone() };
    let mut record = table(from, &plain, &shifted, &form, kind, to)?;
    if record.column(&Role::Time).is_some() {
        let expected = "none: the samples' period gives the time";
        return Err(InputError::whole(from, "a column of role time", expected));
    }
    let start = times.first().copied().unwrap_or(0.0);
    if let Some(k) = times.windows(2).position(|w| w[1] <= w[0]) {
        let (a, b) = (times[k] / period_s, times[k + 1] / period_s);
        return Err(InputError::whole(from, format!("sample {b} after {a}"), "numbers that rise"));
    }
    let mut columns = vec![Column::new("t", Role::Time, times.iter().map(|t| t - start).collect())];
    columns.append(&mut record.columns);
    let mut record = super::record_of(to, kind, columns, form.log)?;
    add_note(&mut record, &format!("halsampler, {period_s} s a sample"));
    if !lost.is_empty() {
        add_note(&mut record, &format!("samples lost at line {}", lost.join(", ")));
    }
    Ok(record)
}
