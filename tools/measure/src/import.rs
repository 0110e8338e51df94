//! What other tools wrote, as run records: the data file of ecmc's ISO 230-2 test, LinuxCNC's compensation file, tables of
//! holes, and any CSV whose columns somebody names.

use crate::plate::NOMINAL_DIAMETER;
use rtec_files::InputError;
use rtec_files::csv::Reader;
use rtec_model::record::{Axis, Column, Kind, Record, Role};
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

/// A column of a CSV that is to be imported.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportColumn {
    /// The column's name in the header.
    pub column: String,
    /// The role it takes in the record.
    pub role: Role,
    /// What the file has it in: factor to the role's own unit, and what to add then.
    pub scale: [f64; 2],
}

/// Name, factor, what to add.
type Unit = (&'static str, f64, f64);

/// Units that are turned into a role's own.
const UNITS: [(&str, &[Unit]); 8] = [
    ("s", &[("ns", 1e-9, 0.0), ("us", 1e-6, 0.0), ("ms", 1e-3, 0.0), ("min", 60.0, 0.0), ("h", 3600.0, 0.0)]),
    ("mm", &[("um", 1e-3, 0.0), ("m", 1e3, 0.0), ("in", 25.4, 0.0)]),
    ("um", &[("nm", 1e-3, 0.0), ("mm", 1e3, 0.0), ("m", 1e6, 0.0), ("in", 25_400.0, 0.0)]),
    (
        "mm/s",
        &[
            ("mm/min", 1.0 / 60.0, 0.0),
            ("m/min", 1000.0 / 60.0, 0.0),
            ("m/s", 1e3, 0.0),
            ("in/min", 25.4 / 60.0, 0.0),
        ],
    ),
    ("mm/s2", &[("m/s2", 1e3, 0.0)]),
    ("degC", &[("K", 1.0, -273.15), ("degF", 5.0 / 9.0, -160.0 / 9.0)]),
    ("rad", &[("deg", std::f64::consts::PI / 180.0, 0.0)]),
    ("N", &[("kN", 1e3, 0.0), ("lbf", 4.448_221_615_260_5, 0.0)]),
];

impl ImportColumn {
    /// `NAME=ROLE` or `NAME=ROLE:UNIT`, as `gauge=error.z:mm`.
    ///
    /// # Errors
    /// What was found and what was expected.
    pub fn parse(text: &str) -> Result<Self, (String, String)> {
        let form = "NAME=ROLE or NAME=ROLE:UNIT, as t=time:min or gauge=error.z:mm";
        let bad = |found: &str, expected: &str| (format!("`{found}`"), expected.to_owned());
        let (column, rest) = text.rsplit_once('=').ok_or_else(|| bad(text, form))?;
        let (role, unit) = rest.split_once(':').map_or((rest, None), |(r, u)| (r, Some(u)));
        let role = Role::parse(role)
            .ok_or_else(|| bad(role, "a role, as time, position.y, temperature, error.z"))?;
        let own = role.unit().unwrap_or("1");
        let others = UNITS.iter().find(|(u, _)| *u == own).map_or(&[][..], |(_, others)| others);
        let scale = match unit {
            None => [1.0, 0.0],
            Some(u) if u == own => [1.0, 0.0],
            Some(u) => {
                let known: Vec<&str> = std::iter::once(own).chain(others.iter().map(|o| o.0)).collect();
                let (_, factor, add) = others
                    .iter()
                    .find(|o| o.0 == u)
                    .ok_or_else(|| bad(u, &format!("a unit of {role}: {}", known.join(", "))))?;
                [*factor, *add]
            }
        };
        Ok(Self { column: column.to_owned(), role, scale })
    }
}

/// Reads the wanted columns of a CSV with a header line. Fields are parted by commas, by semicolons (numbers may then have
/// a decimal comma) or by tabs, whichever the header has.
///
/// # Errors
/// A wanted column that is not there or there twice, a row that is too short or too long, a field that is no number; and
/// what [`Record::new`] finds.
pub fn csv(
    from: &Path,
    text: &str,
    wanted: &[ImportColumn],
    kind: Kind,
    to: &Path,
) -> Result<Record, InputError> {
    let mut reader = Reader::new(from, text.as_bytes())?;
    let header = reader.header_by_any("a header line")?;
    let decimal_comma = reader.separator() == ';';
    let places = wanted.iter().map(|w| header.place(&w.column)).collect::<Result<Vec<_>, _>>()?;
    let mut data = vec![Vec::new(); wanted.len()];
    while let Some(row) = reader.row()? {
        let cells = header.cells(row)?;
        for ((w, place), data) in wanted.iter().zip(&places).zip(&mut data) {
            let cell = &cells[*place];
            let v = if decimal_comma {
                let number = cell.text().replace(',', ".").parse().ok().filter(|v: &f64| v.is_finite());
                number.ok_or_else(|| cell.finding("a finite number"))
            } else {
                cell.finite()
            };
            data.push(v.map_err(|e| header.named(*place, e))? * w.scale[0] + w.scale[1]);
        }
    }
    if data.first().is_none_or(Vec::is_empty) {
        return Err(header.no_rows());
    }
    let columns = wanted.iter().zip(data).map(|(w, data)| column(&w.column, w.role.clone(), data)).collect();
    Record::new(to, kind, columns)
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
