//! What other tools wrote, as run records: the data file of ecmc's ISO 230-2 test, LinuxCNC's compensation file.

use crate::plate::NOMINAL_DIAMETER;
use crate::record::{Axis, Column, Kind, Record, Role};
use rtec_driver::input::InputError;
use std::collections::BTreeMap;
use std::path::Path;

fn column(name: &str, role: Role, data: Vec<f64>) -> Column {
    let unit = role.unit().unwrap_or("1").to_owned();
    Column { name: name.to_owned(), role, unit, data }
}

/// Reads the data file of ecmc's ISO 230-2 test (`TGT_DATA[i]`, `REF_DATA_FWD[i,j]`, `REF_DATA_BWD[i,j]`, mm).
///
/// Rows follow the test: cycle by cycle, forward up the targets, backward down them. *Forward* and *backward* are
/// taken as the file names them.
///
/// # Errors
/// An assignment that is not understood, an index outside its range, a reading or target that is missing.
pub fn ecmc_dat(from: &Path, text: &str, axis: &Axis, to: &Path) -> Result<Record, InputError> {
    let mut targets: BTreeMap<usize, f64> = BTreeMap::new();
    let mut readings: BTreeMap<(usize, bool, usize), f64> = BTreeMap::new();
    for (i, line) in text.lines().enumerate() {
        let at = |found: &str, expected: &str| InputError::at(from, i + 1, 1, format!("`{found}`"), expected);
        let body = line.split('#').next().unwrap_or("").trim();
        let Some((key, value)) = body.split_once('=').map(|(k, v)| (k.trim(), v.trim())) else {
            if body.is_empty() {
                continue;
            }
            return Err(at(body, "KEY=VALUE"));
        };
        let number =
            || value.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| at(value, "a number"));
        match key.split_once('[').map(|(k, rest)| (k, rest.trim_end_matches(']'))) {
            None if key == "UNIT" && value != "mm" => return Err(at(body, "UNIT=mm")),
            None => {} // names of the sources and counts; the data speak for themselves
            Some(("TGT_DATA", index)) => {
                let i = index.trim().parse().map_err(|_| at(index, "a target's number"))?;
                targets.insert(i, number()?);
            }
            Some((name @ ("REF_DATA_FWD" | "REF_DATA_BWD"), index)) => {
                let pair = index
                    .split_once(',')
                    .and_then(|(i, j)| Some((i.trim().parse().ok()?, j.trim().parse().ok()?)));
                let (i, j): (usize, usize) = pair.ok_or_else(|| at(index, "target, cycle"))?;
                readings.insert((j, name == "REF_DATA_BWD", i), number()?);
            }
            Some((name, _)) => return Err(at(name, "TGT_DATA, REF_DATA_FWD or REF_DATA_BWD")),
        }
    }
    let whole = |found: String, expected: &str| InputError::whole(from, found, expected);
    let mut rows: Vec<[f64; 4]> = Vec::new();
    let cycles = readings.keys().map(|k| k.0).max().unwrap_or(0);
    for cycle in 1..=cycles {
        for back in [false, true] {
            let mut order: Vec<(&usize, &f64)> = targets.iter().collect();
            if back {
                order.reverse();
            }
            for (i, target) in order {
                let reading = readings.get(&(cycle, back, *i)).ok_or_else(|| {
                    let name = if back { "BWD" } else { "FWD" };
                    whole(
                        format!("no REF_DATA_{name}[{i},{cycle}]"),
                        "a reading per target, cycle and direction",
                    )
                })?;
                rows.push([
                    cycle as f64,
                    *target,
                    if back { -1.0 } else { 1.0 },
                    (reading - target) * 1000.0,
                ]);
            }
        }
    }
    if rows.len() != readings.len() {
        return Err(whole(format!("{} readings for {} places", readings.len(), rows.len()), "one per place"));
    }
    let get = |k: usize| rows.iter().map(|r| r[k]).collect::<Vec<_>>();
    let name = axis.as_str();
    let columns = vec![
        column("cycle", Role::Cycle, get(0)),
        column(name, Role::Position(axis.clone()), get(1)),
        column("direction", Role::Direction(axis.clone()), get(2)),
        column("error", Role::Error(axis.clone()), get(3)),
    ];
    let mut record = Record::new(to, Kind::Positioning, columns)?;
    record.note = Some("forward and backward as the imported file names them".to_owned());
    Ok(record)
}

/// Reads a LinuxCNC compensation file (`COMP_FILE`): `nominal forward backward` per line, one machine unit = 1 mm.
/// Type 0 gives the positions reached, type 1 the trims added to the command; an error is position reached minus
/// nominal either way.
///
/// # Errors
/// A line that is not three numbers.
pub fn linuxcnc_comp(
    from: &Path,
    text: &str,
    axis: &Axis,
    corrections: bool,
    to: &Path,
) -> Result<Record, InputError> {
    let mut rows: Vec<[f64; 3]> = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let body = line.split(['#', ';']).next().unwrap_or("").trim();
        if body.is_empty() {
            continue;
        }
        let numbers: Option<Vec<f64>> =
            body.split_whitespace().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        match numbers.as_deref() {
            Some(&[nominal, forward, backward]) => rows.push([nominal, forward, backward]),
            _ => {
                return Err(InputError::at(
                    from,
                    i + 1,
                    1,
                    format!("`{body}`"),
                    "nominal, forward, backward",
                ));
            }
        }
    }
    let error = |nominal: f64, v: f64| 1000.0 * if corrections { -v } else { v - nominal };
    let up = rows.iter().map(|r| (r[0], 1.0, error(r[0], r[1])));
    let down = rows.iter().rev().map(|r| (r[0], -1.0, error(r[0], r[2])));
    let all: Vec<(f64, f64, f64)> = up.chain(down).collect();
    let columns = vec![
        column(axis.as_str(), Role::Position(axis.clone()), all.iter().map(|r| r.0).collect()),
        column("direction", Role::Direction(axis.clone()), all.iter().map(|r| r.1).collect()),
        column("error", Role::Error(axis.clone()), all.iter().map(|r| r.2).collect()),
    ];
    Record::new(to, Kind::Positioning, columns)
}

/// Reads a hole table of a coordinate measuring machine (`Meas X`, `Meas Y`, `Nom X`, `Nom Y`, `Nom D`, …, mm) as a plate.
///
/// # Errors
/// No line with the headings, a row that is too short or holds no numbers.
pub fn cmm_plate(from: &Path, text: &str, to: &Path) -> Result<Record, InputError> {
    const HEADINGS: [&str; 5] = ["Meas X", "Meas Y", "Nom X", "Nom Y", "Nom D"];
    let mut places: Option<[usize; 5]> = None;
    let mut rows: Vec<[f64; 5]> = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let at = |found: String, expected: &str| InputError::at(from, i + 1, 1, found, expected);
        let Some(places) = places else {
            // Headings hold single spaces and stand two or more apart.
            let heads: Vec<&str> = line.split("  ").map(str::trim).filter(|h| !h.is_empty()).collect();
            if HEADINGS.iter().all(|h| heads.contains(h)) {
                places = Some(HEADINGS.map(|h| heads.iter().position(|x| *x == h).unwrap_or_default()));
            }
            continue;
        };
        if line.trim().is_empty() {
            continue;
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        let mut row = [0.0; 5];
        for (value, place) in row.iter_mut().zip(places) {
            let word = words.get(place).ok_or_else(|| at(format!("{} values", words.len()), "a full row"))?;
            let number = word.parse::<f64>().ok().filter(|v| v.is_finite());
            *value = number.ok_or_else(|| at(format!("`{word}`"), "a number"))?;
        }
        rows.push(row);
    }
    if places.is_none() {
        return Err(InputError::whole(
            from,
            "no table of holes",
            format!("a line with {}", HEADINGS.join(", ")),
        ));
    }
    let axis = |name: &str| Axis::new(name).unwrap_or_else(|| unreachable!("a letter is an axis name"));
    let get = |of: fn(&[f64; 5]) -> f64| rows.iter().map(of).collect::<Vec<_>>();
    let columns = vec![
        column("x", Role::Position(axis("x")), get(|r| r[2])),
        column("y", Role::Position(axis("y")), get(|r| r[3])),
        column("ex", Role::Error(axis("x")), get(|r| 1000.0 * (r[0] - r[2]))),
        column("ey", Role::Error(axis("y")), get(|r| 1000.0 * (r[1] - r[3]))),
        Column { unit: "mm".to_owned(), ..column(NOMINAL_DIAMETER, Role::Channel, get(|r| r[4])) },
    ];
    Record::new(to, Kind::Plate, columns)
}
