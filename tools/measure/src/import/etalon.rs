//! Etalon's exchange format, variant "Vendor".
//! An INI-like file with `//` comments and one block per error component, in mm and rad (ISG kernel
//! documentation, 296430091).
//!
//! `EXY` is the error in X while Y moves; its `Gridpoints` are position and value.

use super::{add_note, finite};
use rtec_files::{InputError, Result};
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use std::path::Path;

struct ErrorComponentBlock {
    name: String,
    line: usize,
    points: Vec<(f64, f64)>,
}

fn blocks(from: &Path, text: &str) -> Result<Vec<ErrorComponentBlock>> {
    let mut blocks: Vec<ErrorComponentBlock> = Vec::new();
    let mut open: Option<usize> = None;
    for (i, raw) in text.lines().enumerate() {
        let line = raw.split("//").next().unwrap_or("").trim();
        let line = if line.starts_with([';', '#']) { "" } else { line };
        let at = |found: String, expected: &str| InputError::line(from, i + 1, found, expected);
        if line.is_empty() {
            continue;
        }
        let number = |word: &str| finite(word).ok_or_else(|| at(format!("`{word}`"), "a number"));
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            if let Some(start) = open {
                let found = format!("[{name}] before the }} of line {start}");
                return Err(at(found, "the end of the gridpoints, }"));
            }
            if blocks.iter().any(|b| b.name == name) {
                return Err(at(format!("[{name}] a second time"), "each block once"));
            }
            blocks.push(ErrorComponentBlock {
                name: name.trim().to_owned(),
                line: i + 1,
                points: Vec::new(),
            });
            continue;
        }
        let Some(block) = blocks.last_mut() else {
            return Err(at(format!("`{line}`"), "a block as [EXX] first"));
        };
        let mut body = line;
        if open.is_none() {
            let (key, value) = line.split_once('=').map_or((line, ""), |(k, v)| (k.trim(), v.trim()));
            match key {
                "VALUE" => {
                    number(value)?;
                    continue;
                }
                "Gridpoints" => {
                    let points = value.strip_prefix('{');
                    body = points.ok_or_else(|| at(format!("`{line}`"), "Gridpoints = {"))?.trim();
                    open = Some(i + 1);
                }
                // A key of another program; a misspelt `Gridpoints` is found by its numbers.
                _ if line.contains('=') => continue,
                _ => return Err(at(format!("`{line}`"), "VALUE = …, or Gridpoints = {")),
            }
        }
        if let Some(before) = body.strip_suffix('}') {
            open = None;
            body = before.trim();
        }
        let words: Vec<&str> = body.split_whitespace().collect();
        match words[..] {
            [] => {}
            [position, value] => block.points.push((number(position)?, number(value)?)),
            _ => return Err(at(format!("`{body}`"), "position and value")),
        }
    }
    match open {
        Some(start) => Err(InputError::line(from, start, "Gridpoints without an end", "a line with }")),
        None => Ok(blocks),
    }
}

/// Reads the errors of an axis's motion.
/// `EXA`, `EYA`, `EZA` of axis A become `error.x`, `error.y`, `error.z` over its position, with the file's
/// sign. Angles and other blocks are left out and named in the note.
///
/// # Errors
/// An invalid line, no such block, blocks with different positions, positions that do not rise.
pub fn etalon(from: &Path, text: &str, axis: &Axis, to: &Path) -> Result<Record> {
    let blocks = blocks(from, text)?;
    let moving = axis.as_str().to_ascii_uppercase();
    let mut columns = Vec::new();
    let (mut positions, mut left): (Vec<f64>, Vec<String>) = (Vec::new(), Vec::new());
    for block in &blocks {
        let component = ["X", "Y", "Z"].iter().find(|c| block.name == format!("E{c}{moving}"));
        let Some(component) = component.filter(|_| !block.points.is_empty()) else {
            left.push(block.name.clone());
            continue;
        };
        let at: Vec<f64> = block.points.iter().map(|p| p.0).collect();
        let error = |found: &str, expected: &str| {
            InputError::line(from, block.line, format!("[{}] {found}", block.name), expected)
        };
        if at.windows(2).any(|w| w[1] <= w[0]) {
            return Err(error("with positions that do not rise", "positions that rise"));
        }
        if positions.is_empty() {
            positions = at;
        } else if positions != at {
            let expected = "the same positions in all three";
            return Err(error("has other positions than the block before", expected));
        }
        let Some(response) = Axis::new(&component.to_lowercase()) else { continue };
        let um = block.points.iter().map(|p| 1000.0 * p.1).collect();
        columns.push(Column::new(&block.name, Role::Error(response), um));
    }
    if columns.is_empty() {
        let names: Vec<&str> = blocks.iter().map(|b| b.name.as_str()).collect();
        let expected =
            format!("gridpoints of EX{moving}, EY{moving} or EZ{moving}: the errors while {moving} moves");
        return Err(InputError::whole(from, format!("blocks {}", names.join(", ")), expected));
    }
    columns.insert(0, Column::new(axis.as_str(), Role::Position(axis.clone()), positions));
    let mut record = Record::new(to, RunKind::Positioning, columns)?;
    let note = "Etalon exchange file; signs as the file has them: hold one against a measurement of your own";
    add_note(&mut record, note);
    if !left.is_empty() {
        add_note(&mut record, &format!("left out: {}", left.join(", ")));
    }
    Ok(record)
}
