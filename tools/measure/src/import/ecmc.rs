//! The data file of ecmc's ISO 230-2 test.

use super::{finite, of_targets};
use rtec_files::{InputError, Result};
use rtec_model::record::{Axis, Record};
use std::collections::BTreeMap;
use std::path::Path;

/// Reads the data file of ecmc's ISO 230-2 test.
/// It holds `TGT_DATA[i]`, `REF_DATA_FWD[i,j]`, `REF_DATA_BWD[i,j]`, mm.
///
/// Rows follow the test: cycle by cycle, forward up the targets, backward down them. *Forward* and *backward*
/// are as the file names them.
///
/// # Errors
/// An invalid assignment, an index outside its range, a missing reading or target.
pub fn ecmc_dat(from: &Path, text: &str, axis: &Axis, to: &Path) -> Result<Record> {
    let mut targets: BTreeMap<usize, f64> = BTreeMap::new();
    let mut readings: BTreeMap<(usize, bool, usize), f64> = BTreeMap::new();
    for (i, line) in text.lines().enumerate() {
        let at = |found: &str, expected: &str| InputError::line(from, i + 1, format!("`{found}`"), expected);
        let body = line.split('#').next().unwrap_or("").trim();
        let Some((key, value)) = body.split_once('=').map(|(k, v)| (k.trim(), v.trim())) else {
            if body.is_empty() {
                continue;
            }
            return Err(at(body, "KEY=VALUE"));
        };
        let number = || finite(value).ok_or_else(|| at(value, "a number"));
        match key.split_once('[').map(|(k, rest)| (k, rest.trim_end_matches(']'))) {
            None if key == "UNIT" && value != "mm" => return Err(at(body, "UNIT=mm")),
            Some(("TGT_DATA", index)) => {
                let i = index.trim().parse().map_err(|_| at(index, "a target's number"))?;
                targets.insert(i, number()?);
            }
            Some((name @ ("REF_DATA_FWD" | "REF_DATA_BWD"), index)) => {
                let pair = |(i, j): (&str, &str)| Some((i.trim().parse().ok()?, j.trim().parse().ok()?));
                let pair = index.split_once(',').and_then(pair);
                let (i, j): (usize, usize) = pair.ok_or_else(|| at(index, "target, cycle"))?;
                readings.insert((j, name == "REF_DATA_BWD", i), number()?);
            }
            Some((name, _)) if name.starts_with("TGT_") || name.starts_with("REF_") => {
                return Err(at(name, "TGT_DATA, REF_DATA_FWD or REF_DATA_BWD"));
            }
            // Names, counts and keys of other tests or versions are ignored.
            _ => {}
        }
    }
    let whole = |found: String, expected: &str| InputError::whole(from, found, expected);
    let mut rows: Vec<[f64; 4]> = Vec::new();
    let cycles = readings.keys().map(|k| k.0).max().unwrap_or(0);
    if cycles > readings.len() {
        return Err(whole(format!("cycle {cycles} of {} readings", readings.len()), "cycles counted from 1"));
    }
    for cycle in 1..=cycles {
        let forward = targets.iter().map(|target| (false, target));
        for (back, (i, target)) in forward.chain(targets.iter().rev().map(|target| (true, target))) {
            let (name, way) = if back { ("BWD", -1.0) } else { ("FWD", 1.0) };
            let expected = "a reading per target, cycle and direction";
            let error = || whole(format!("no REF_DATA_{name}[{i},{cycle}]"), expected);
            let reading = readings.get(&(cycle, back, *i)).ok_or_else(error)?;
            rows.push([cycle as f64, *target, way, (reading - target) * 1000.0]);
        }
    }
    if rows.len() != readings.len() {
        return Err(whole(format!("{} readings for {} places", readings.len(), rows.len()), "one per place"));
    }
    let mut record = of_targets(to, axis, &rows)?;
    record.note = Some("forward and backward as the imported file names them".to_owned());
    Ok(record)
}
