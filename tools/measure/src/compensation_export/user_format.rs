//! A table in a format described by the user's TOML file:
//!
//! ```toml
//! header = "axis {axis}, {points} points\n"   # once, in front; optional, as footer
//! line = "{n};{position};{forward};{reverse}" # for every point; or {mean} where one value serves both directions
//! footer = "end\n"
//! value = "error"             # reached minus commanded; or "correction", its negative; or "reached", the position itself
//! position_unit = "mm"        # mm, um, inch; "mm" where it is not given
//! value_unit = "um"           # mm, um, inch
//! position_decimals = 3
//! value_decimals = 1
//! max_points = 128
//! first_index = 1             # {n} of the first point; 0 where it is not given
//! zero_at_reference = true    # the value at --reference-mm is zero; false where it is not given
//! decimal_comma = true        # false where it is not given
//! line_end = "crlf"           # "lf" where it is not given
//! ```
//!
//! `{step}`, `{first}` and `{last}` are positions too; `{{` and `}}` stand for braces.

use super::{
    CompensationFormat, CompensationPoint, CompensationTable, FormatRequirements, LookupPosition, number,
    usage,
};
use rtec_files::Result;
use rtec_files::strict_toml::{Document, TomlKeyValue};
use std::path::Path;

const UNITS: [(&str, f64); 3] = [("mm", 1.0), ("um", 1e-3), ("inch", 25.4)];
const ONCE: [&str; 5] = ["axis", "points", "step", "first", "last"];
const EACH: [&str; 5] = ["n", "position", "forward", "reverse", "mean"];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum TabulatedQuantity {
    Error,
    Correction,
    Reached,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum TemplatePiece {
    Text(String),
    Place(&'static str),
}

/// A format read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct UserFormat {
    header: Vec<TemplatePiece>,
    line: Vec<TemplatePiece>,
    footer: Vec<TemplatePiece>,
    value: TabulatedQuantity,
    /// Unit of positions, mm, and decimals.
    position: (f64, usize),
    /// Unit of values, mm, and decimals.
    values: (f64, usize),
    most: usize,
    first_index: i64,
    zero_at_mm: Option<f64>,
    both: bool,
    decimal_comma: bool,
    line_end: &'static str,
}

fn template(entry: TomlKeyValue<'_>, known: &[&'static str]) -> Result<Vec<TemplatePiece>> {
    let names: Vec<String> = known.iter().map(|n| format!("{{{n}}}")).collect();
    let expected = format!("text with {}; {{{{ and }}}} for braces", names.join(", "));
    let text = entry.str(&expected)?;
    let (mut pieces, mut plain) = (Vec::new(), String::new());
    let mut rest = text;
    while let Some(at) = rest.find(['{', '}']) {
        plain.push_str(&rest[..at]);
        let tail = &rest[at..];
        if tail.starts_with("{{") || tail.starts_with("}}") {
            plain.push_str(&tail[..1]);
            rest = &tail[2..];
            continue;
        }
        let end = tail.find('}').filter(|_| tail.starts_with('{'));
        let end = end.ok_or_else(|| entry.error(format!("a brace alone in '{text}'"), &*expected))?;
        let name = &tail[1..end];
        let place = known.iter().find(|k| **k == name);
        let place = place.ok_or_else(|| entry.error(format!("{{{name}}}"), &*expected))?;
        pieces.push(TemplatePiece::Text(std::mem::take(&mut plain)));
        pieces.push(TemplatePiece::Place(place));
        rest = &tail[end + 1..];
    }
    plain.push_str(rest);
    pieces.push(TemplatePiece::Text(plain));
    Ok(pieces)
}

/// The value of the word that an entry states.
fn choice<T: Copy>(entry: TomlKeyValue<'_>, words: &[(&str, T)], expected: &str) -> Result<T> {
    let found = words.iter().find(|(word, _)| entry.as_str() == Some(word));
    found.map(|(_, value)| *value).ok_or_else(|| entry.mismatch(expected))
}

fn has(pieces: &[TemplatePiece], name: &str) -> bool {
    pieces.iter().any(|p| matches!(p, TemplatePiece::Place(n) if *n == name))
}

impl UserFormat {
    /// Parses a format; `reference_mm` is the reference point, if the format needs one.
    ///
    /// # Errors
    /// The first finding, with its place.
    pub fn parse(file: &Path, text: &str, reference_mm: f64) -> Result<Self> {
        let document = Document::parse(file, text)?;
        let root = document.root();
        root.only(&[
            "header",
            "line",
            "footer",
            "value",
            "position_unit",
            "value_unit",
            "position_decimals",
            "value_decimals",
            "max_points",
            "first_index",
            "zero_at_reference",
            "decimal_comma",
            "line_end",
        ])?;
        let once = |key: &str| root.get(key).map_or(Ok(Vec::new()), |entry| template(entry, &ONCE));
        let line_entry =
            root.required("line", "what a point's line is, as line = \"{position} {forward} {reverse}\"")?;
        let line = template(line_entry, &EACH)?;
        let (mean, forward, reverse) = (has(&line, "mean"), has(&line, "forward"), has(&line, "reverse"));
        if mean == (forward || reverse) || forward != reverse {
            let expected = "both {forward} and {reverse}, or {mean} where one value serves both directions";
            return Err(line_entry.error(format!("'{}'", line_entry.text()), expected));
        }
        let unit = |key: &str, default: Option<f64>| -> Result<f64> {
            let expected = format!("{key} = \"mm\", \"um\" or \"inch\"");
            match (root.get(key), default) {
                (None, Some(mm)) => Ok(mm),
                _ => choice(root.required(key, &expected)?, &UNITS, &expected),
            }
        };
        let decimals = |key: &str| -> Result<usize> {
            let expected = format!("{key}, 0 to 12");
            let entry = root.required(key, &expected)?;
            let n: usize = entry.integer(&expected)?;
            if n > 12 { Err(entry.mismatch(expected)) } else { Ok(n) }
        };
        let flag = |key: &str| root.get(key).map_or(Ok(false), |e| e.bool("true or false"));
        let expected =
            "value = \"error\" (reached minus commanded), \"correction\" (its negative) or \"reached\"";
        let values = [
            ("error", TabulatedQuantity::Error),
            ("correction", TabulatedQuantity::Correction),
            ("reached", TabulatedQuantity::Reached),
        ];
        let value = choice(root.required("value", expected)?, &values, expected)?;
        let most = root.required("max_points", "max_points, the most points that the controller takes")?;
        let expected = "a whole number from 2 to 100000";
        let Some(count) = Some(most.integer::<usize>(expected)?).filter(|n| (2..=100_000).contains(n)) else {
            return Err(most.mismatch(expected));
        };
        let ends = [("lf", "\n"), ("crlf", "\r\n")];
        let expected = "line_end = \"lf\" or \"crlf\"";
        let line_end = root.get("line_end").map_or(Ok("\n"), |entry| choice(entry, &ends, expected))?;
        let zero = flag("zero_at_reference")?;
        if zero && value == TabulatedQuantity::Reached {
            let entry = root.required("zero_at_reference", "zero_at_reference")?;
            return Err(entry.mismatch("no zero where the values are positions reached"));
        }
        let expected = "a whole number within ±2147483647";
        let first_index = root.get("first_index").map_or(Ok(0), |e| e.integer::<i32>(expected));
        Ok(Self {
            header: once("header")?,
            line,
            footer: once("footer")?,
            value,
            position: (unit("position_unit", Some(1.0))?, decimals("position_decimals")?),
            values: (unit("value_unit", None)?, decimals("value_decimals")?),
            most: count,
            first_index: first_index?.into(),
            zero_at_mm: zero.then_some(reference_mm),
            both: !mean,
            decimal_comma: flag("decimal_comma")?,
            line_end,
        })
    }

    fn write(&self, number_: f64, decimals: usize) -> String {
        let text = number(number_, decimals);
        if self.decimal_comma { text.replace('.', ",") } else { text }
    }

    fn position(&self, mm: f64) -> String {
        self.write(mm / self.position.0, self.position.1)
    }

    fn value(&self, point: &CompensationPoint, um: f64) -> String {
        let mm = match self.value {
            TabulatedQuantity::Error => um / 1000.0,
            TabulatedQuantity::Correction => -um / 1000.0,
            TabulatedQuantity::Reached => point.position_mm + um / 1000.0,
        };
        self.write(mm / self.values.0, self.values.1)
    }
}

impl CompensationFormat for UserFormat {
    fn rules(&self) -> FormatRequirements {
        let resolution = |(mm, decimals): (f64, usize)| mm * 10f64.powi(-(decimals as i32));
        FormatRequirements {
            most: self.most,
            position_mm: resolution(self.position),
            value_um: 1000.0 * resolution(self.values),
            both: self.both,
            zero_at_mm: self.zero_at_mm,
            lookup: LookupPosition::Commanded,
        }
    }

    fn text(&self, table: &CompensationTable) -> Result<String> {
        let mut text = String::new();
        let once = |name: &str| match name {
            "axis" => table.axis.to_string(),
            "points" => table.points.len().to_string(),
            "step" => self.position(table.step_mm),
            "first" => self.position(table.start_mm()),
            _ => self.position(table.end_mm()),
        };
        let fill = |pieces: &[TemplatePiece], of: &dyn Fn(&str) -> String| -> String {
            let written = |p: &TemplatePiece| match p {
                TemplatePiece::Text(text) => text.clone(),
                TemplatePiece::Place(name) => of(name),
            };
            pieces.iter().map(written).collect()
        };
        text.push_str(&fill(&self.header, &once));
        let mut before = String::new();
        for (i, p) in table.points.iter().enumerate() {
            let position = self.position(p.position_mm);
            if position == before {
                let expected = "more position_decimals, or a larger --step";
                return Err(usage(format!("the position {position} twice"), expected));
            }
            let of = |name: &str| match name {
                "n" => (self.first_index + i as i64).to_string(),
                "position" => position.clone(),
                "forward" => self.value(p, p.up_um),
                "reverse" => self.value(p, p.down_um),
                _ => self.value(p, p.mean_um()),
            };
            text.push_str(&fill(&self.line, &of));
            text.push('\n');
            before = position;
        }
        text.push_str(&fill(&self.footer, &once));
        Ok(if self.line_end == "\n" { text } else { text.replace('\n', self.line_end) })
    }

    fn advice(&self, _: &CompensationTable) -> Vec<String> {
        vec!["what it leaves holds for a controller that goes straight from value to value, by the commanded position and direction".to_owned()]
    }
}
