//! Hole tables of coordinate measuring machines.

use super::letter;
use crate::drilled_plate::NOMINAL_DIAMETER;
use rtec_files::{DecimalMarks, InputError, Result};
use rtec_model::record::{Column, Record, Role, RunKind};
use std::path::Path;

/// Reads a hole table of a coordinate measuring machine as a plate.
/// Columns are `Meas X`, `Meas Y`, `Nom X`, `Nom Y`, `Nom D`, …, mm.
///
/// # Errors
/// No line with the headings; a row that is too short or has no numbers.
pub fn cmm_plate(from: &Path, text: &str, to: &Path) -> Result<Record> {
    const HEADINGS: [&str; 5] = ["Meas X", "Meas Y", "Nom X", "Nom Y", "Nom D"];
    let mut places: Option<[usize; 5]> = None;
    let mut rows: Vec<[f64; 5]> = Vec::new();
    // The decimal mark, as far as the rows show it.
    let mut marks = None;
    for (i, line) in text.lines().enumerate() {
        let at = |found: String, expected: &str| InputError::line(from, i + 1, found, expected);
        let Some(places) = places else {
            // Headings contain single spaces and are two or more apart.
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
        marks = marks.or_else(|| DecimalMarks::mark_of(words.iter().copied()));
        let numbers = DecimalMarks::of(words.iter().copied(), marks, ' ');
        let mut row = [0.0; 5];
        for (value, place) in row.iter_mut().zip(places) {
            let word = words.get(place).ok_or_else(|| at(format!("{} values", words.len()), "a full row"))?;
            *value = numbers.parse(word).ok_or_else(|| at(format!("`{word}`"), numbers.expected(word)))?;
        }
        rows.push(row);
    }
    if places.is_none() {
        let headings = HEADINGS.join(" | ");
        let expected = format!("a line with the headings {headings}, two spaces or more between them");
        return Err(InputError::whole(from, "no table of holes", expected));
    }
    // Rounded to 1e-9 µm, which removes floating-point noise of decimal numbers.
    let um = |mm: f64| (1e12 * mm).round() / 1e9;
    let get = |of: &dyn Fn(&[f64; 5]) -> f64| rows.iter().map(of).collect::<Vec<_>>();
    let columns = vec![
        Column::new("x", Role::Position(letter("x")), get(&|r| r[2])),
        Column::new("y", Role::Position(letter("y")), get(&|r| r[3])),
        Column::new("ex", Role::Error(letter("x")), get(&|r| um(r[0] - r[2]))),
        Column::new("ey", Role::Error(letter("y")), get(&|r| um(r[1] - r[3]))),
        Column { unit: "mm".to_owned(), ..Column::new(NOMINAL_DIAMETER, Role::Channel, get(&|r| r[4])) },
    ];
    Record::new(to, RunKind::Plate, columns)
}
