//! `.rtl` files of a laser interferometer: linear targets.
//! Sections end in `::`; deviations are `run target value`.
//!
//! The structure is that of other programs that read such files; no original file or description was
//! available. Targets are in mm, deviations in µm, measured less target. Targets are identified by number,
//! not by the order of rows.

use super::{add_note, finite, of_targets};
use rtec_files::{InputError, Result};
use rtec_model::record::{Axis, Record};
use std::path::Path;

/// Decodes a text in any encoding: UTF-16 or UTF-8 if it is, otherwise Latin-1.
///
/// # Errors
/// UTF-16 with half a character.
pub fn any_text(file: &Path, bytes: &[u8]) -> Result<String> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return rtec_files::text_file::decode(file, bytes);
    }
    Ok(rtec_files::text_file::decode(file, bytes)
        .unwrap_or_else(|_| bytes.iter().map(|b| char::from(*b)).collect()))
}

/// A section `NAME::` and its lines.
struct RtlSection<'t> {
    name: &'t str,
    /// Line number and text.
    lines: Vec<(usize, &'t str)>,
}

fn sections(text: &str) -> Vec<RtlSection<'_>> {
    let mut sections: Vec<RtlSection<'_>> = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if let Some(name) = line.strip_suffix("::") {
            sections.push(RtlSection { name: name.trim(), lines: Vec::new() });
        } else if let Some(section) = sections.last_mut().filter(|_| !line.is_empty()) {
            section.lines.push((i + 1, line));
        }
    }
    sections
}

/// Reads a file of linear targets.
/// Directions are those in which a run goes through its targets.
///
/// # Errors
/// A missing section, a wrong count, a run without one of its targets, a file of angles.
pub fn rtl(from: &Path, text: &str, axis: &Axis, to: &Path) -> Result<Record> {
    let sections = sections(text);
    let section = |name: &str| {
        let found = sections.iter().find(|s| s.name.eq_ignore_ascii_case(name));
        let expected = "a Renishaw .rtl file of linear targets";
        found.ok_or_else(|| InputError::whole(from, format!("no section {name}::"), expected))
    };
    let value = |section: &RtlSection<'_>, key: &str| {
        let found = section.lines.iter().find_map(|(n, l)| {
            let (k, v) = l.split_once(':')?;
            let plain = |key: &str| key.trim().replace('-', " ").to_ascii_lowercase();
            (plain(k) == plain(key)).then(|| (*n, v.trim().to_owned()))
        });
        let absent = || format!("no `{key}:` in {}::", section.name);
        found.ok_or_else(|| InputError::whole(from, absent(), format!("`{key}: …`")))
    };
    let count = |section: &RtlSection<'_>, key: &str| {
        let (line, text) = value(section, key)?;
        let n = text.parse::<usize>().ok().filter(|n| *n > 0);
        n.ok_or_else(|| InputError::line(from, line, format!("`{key}: {text}`"), "a whole number from 1"))
    };
    let target_data = section("TARGET DATA")?;
    let header = section("HEADER")?;
    if let Ok((line, kind)) = value(header, "File type").map(|(l, k)| (l, k.to_ascii_lowercase()))
        && let Some(is) = other_type(&kind)
    {
        let found = format!("File type `{kind}` ({is})");
        return Err(InputError::line(from, line, found, "File type `rtl`, linear targets in mm"));
    }
    let kinds = ["angular", "straightness", "squareness", "flatness", "rotary"];
    let other = target_data.lines.iter().chain(&header.lines).find(|(_, l)| {
        let low = l.to_ascii_lowercase();
        kinds.iter().any(|k| low.contains(k))
    });
    if let Some((n, line)) = other {
        let expected = "linear targets: the units of other files are not known";
        return Err(InputError::line(from, *n, format!("`{line}`"), expected));
    }
    let targets = targets(from, target_data, count(target_data, "Target-count")?)?;
    let runs = count(section("RUNS")?, "Run-count")?;
    let listed = deviations(from, section("DEVIATIONS")?, targets.len(), runs)?;
    let (rows, notes) = rows(from, &listed, &targets)?;
    let mut record = of_targets(to, axis, &rows)?;
    if let Ok(user) = section("USER-TEXT") {
        for key in ["Machine", "Serial No", "Date", "By", "Axis", "Location", "TITLE"] {
            // Free text becomes a note.
            let Ok((line, text)) = value(user, key) else { continue };
            let own = text.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
            if key == "Axis" && own.len() == 1 && !own.eq_ignore_ascii_case(axis.as_str()) {
                let expected = format!("--axis {}, or a file of the axis {axis}", own.to_ascii_lowercase());
                let found = format!("`Axis: {text}` with --axis {axis}");
                return Err(InputError::line(from, line, found, expected));
            }
            if key == "Date" && rtec_files::date::parse(&text).is_some() {
                record.date = Some(text);
            } else if !text.is_empty() {
                add_note(&mut record, &format!("{key}: {text}"));
            }
        }
    }
    for note in notes {
        add_note(&mut record, &note);
    }
    Ok(record)
}

/// The numbers after `Targets :`, over several lines if needed.
fn targets(from: &Path, section: &RtlSection<'_>, count: usize) -> Result<Vec<f64>> {
    let mut targets = Vec::new();
    let mut inside = false;
    for (line, text) in &section.lines {
        let mut body = *text;
        if let Some((key, rest)) = text.split_once(':') {
            inside = key.trim().eq_ignore_ascii_case("Targets");
            body = rest;
        }
        if !inside {
            continue;
        }
        for word in body.split_whitespace() {
            let expected = "a target in mm (with a decimal point)";
            let error = || InputError::line(from, *line, format!("`{word}`"), expected);
            targets.push(finite(word).ok_or_else(error)?);
        }
    }
    if targets.len() != count {
        let found = format!("{} targets, Target-count {count}", targets.len());
        return Err(InputError::whole(from, found, "as many targets as the file counts"));
    }
    Ok(targets)
}

/// A deviation: line number, index of the target, µm.
type Deviation = (usize, usize, f64);

/// The deviations by run, one per target.
fn deviations(
    from: &Path,
    section: &RtlSection<'_>,
    targets: usize,
    runs: usize,
) -> Result<Vec<Vec<Deviation>>> {
    if runs > section.lines.len() {
        let found = format!("Run-count {runs} and {} lines of deviations", section.lines.len());
        return Err(InputError::whole(from, found, "a deviation for each target of each run"));
    }
    let mut listed: Vec<Vec<Deviation>> = vec![Vec::new(); runs];
    for (line, text) in &section.lines {
        if text.ends_with(':') {
            continue; // `Run Target Data:`
        }
        let at = |found: String, expected: String| InputError::line(from, *line, found, expected);
        let words: Vec<&str> = text.split_whitespace().collect();
        let parsed = match words[..] {
            [run, target, value] => run.parse().ok().zip(target.parse().ok()).zip(finite(value)),
            _ => None,
        };
        let expected = "run, target and deviation in um (with a decimal point)";
        let ((run, target), um): ((usize, usize), f64) =
            parsed.ok_or_else(|| at(format!("`{text}`"), expected.to_owned()))?;
        if !(1..=runs).contains(&run) || !(1..=targets).contains(&target) {
            let expected = format!("runs 1 to {runs} and targets 1 to {targets}, as the file counts them");
            return Err(at(format!("run {run}, target {target}"), expected));
        }
        if listed[run - 1].iter().any(|(_, t, _)| *t == target - 1) {
            let found = format!("target {target} of run {run} a second time");
            return Err(at(found, "each target once a run".to_owned()));
        }
        listed[run - 1].push((*line, target - 1, um));
    }
    if let Some(run) = listed.iter().position(|r| r.len() != targets) {
        let found = format!("{} deviations in run {}", listed[run].len(), run + 1);
        return Err(InputError::whole(from, found, format!("one for each of the {targets} targets")));
    }
    Ok(listed)
}

/// Rows of cycle, position, direction and error; and a message about rows left out.
fn rows(from: &Path, listed: &[Vec<Deviation>], targets: &[f64]) -> Result<(Vec<[f64; 4]>, Vec<String>)> {
    let mut rows: Vec<[f64; 4]> = Vec::new();
    let (mut notes, mut seen) = (Vec::new(), [0.0, 0.0]);
    let some = listed.iter().flatten().any(|(_, _, um)| *um != 0.0);
    for (n, run) in listed.iter().enumerate() {
        if some && run.iter().all(|(_, _, um)| *um == 0.0) {
            let why = "is all zeros and was left out: a direction that was not measured";
            notes.push(format!("run {} {why}", n + 1));
            continue;
        }
        let place = |k: usize| targets[run[k].1];
        let falls = if run.len() > 1 { place(run.len() - 1) < place(0) } else { n % 2 == 1 };
        let steps = (1..run.len()).map(|k| place(k) - place(k - 1));
        if let Some(k) = steps.into_iter().position(|s| (s < 0.0) != falls) {
            let found = format!("run {} turns back at target {}", n + 1, run[k + 1].1 + 1);
            let expected = "a run that goes through its targets one way";
            return Err(InputError::line(from, run[k + 1].0, found, expected));
        }
        seen[usize::from(falls)] += 1.0;
        let (cycle, way) = (seen[usize::from(falls)], if falls { -1.0 } else { 1.0 });
        rows.extend(run.iter().map(|(_, target, um)| [cycle, targets[*target], way, *um]));
    }
    Ok((rows, notes))
}

/// Content of files with another type than linear targets.
fn other_type(kind: &str) -> Option<&'static str> {
    match kind {
        "rta" => Some("angular targets, in degrees"),
        "rts" => Some("straightness"),
        "rtx" | "rtr" => Some("a rotary axis"),
        _ if kind.starts_with("rt") && kind != "rtl" => Some("not linear"),
        _ => None,
    }
}
