//! The NC probing program (NISTIR 4854, section 4 and figure 8).
//! It is made from a template, named parameters and the probe's moves.

use crate::geometric_fit::Zx;
use crate::length_unit::LengthUnit;
use crate::probe_path::{PathPoint, PathPointRole};
use rtec_files::strict_toml::Document;
use rtec_files::{InputError, date};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// The program format of one controller, as data.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dialect {
    /// The controller's name, as reports show it.
    pub name: String,
    /// The marks that open and close a comment.
    pub comment: [String; 2],
    /// Word of rapid positioning, as `G00`.
    pub rapid: String,
    /// The move that touches.
    pub touch: String,
    /// The move back off the surface.
    pub retract: String,
    /// Word that sets inches, as `G20`.
    pub inch: String,
    /// Word that sets millimetres, as `G21`.
    pub mm: String,
    /// Decimals of a coordinate in inches.
    pub decimals_inch: usize,
    /// Decimals of a coordinate in mm.
    pub decimals_mm: usize,
    /// Whether X words are diameters.
    pub x_is_diameter: bool,
    /// Digits of a block number.
    pub block_digits: usize,
    /// Step from one block number to the next.
    pub block_step: u32,
    /// The first block number that moves may not use.
    pub program_end: u32,
}

/// A dialect with its template.
#[derive(Debug, Clone)]
pub struct DialectWithTemplate {
    /// The format of its programs.
    pub dialect: Dialect,
    /// `template.prb`, copied unchanged except for `$n` and `@n`.
    pub template: String,
}

macro_rules! built_in {
    ($name:literal) => {
        (
            $name,
            include_str!(concat!("../dialects/", $name, "/dialect.toml")),
            include_str!(concat!("../dialects/", $name, "/template.prb")),
        )
    };
}

/// The built-in dialects: name, dialect, template.
pub const BUILT_IN: [(&str, &str, &str); 3] =
    [built_in!("report"), built_in!("linuxcnc"), built_in!("fanuc")];

/// One program parameter: the `n` of its `$n`, its name, its default, its meaning.
#[derive(Debug, Clone, Copy)]
pub struct NumberedVariable {
    /// The `n` of its `$n` in a template.
    pub number: u32,
    /// Key in a parameter file.
    pub name: &'static str,
    /// Default value.
    pub default: &'static str,
    /// Its meaning, for the help text.
    pub meaning: &'static str,
}

type Text = &'static str;

const fn parameter(number: u32, name: Text, default: Text, meaning: Text) -> NumberedVariable {
    NumberedVariable { number, name, default, meaning }
}

/// All parameters, with the numbers of the report's template.
/// `$21` is replaced by the moves. Lengths are in the program's unit.
pub const PARAMETERS: [NumberedVariable; 22] = [
    parameter(1, "part", "0101", "two digits of the part and two of its version"),
    parameter(2, "segment", "2", "one even digit: probing segments lie between machining segments"),
    parameter(3, "title", "PART", "name of the part"),
    parameter(4, "tool", "1", "turret place of the probe"),
    parameter(5, "extension", "", "a remark on the probe, as ' WITH EXTENSION'"),
    parameter(6, "holder", "BORING BAR", "what holds the probe"),
    parameter(7, "length_z", "0", "length of the probe along Z"),
    parameter(8, "length_x", "0", "length of the probe along X"),
    parameter(9, "offset_z", "0", "tool offset in Z"),
    parameter(10, "offset_x", "0", "tool offset in X"),
    parameter(11, "touch_off", "20", "from the part's face to probing start"),
    parameter(12, "feed", "2500", "probing feed per minute"),
    parameter(13, "probing_start_z", "0", "machine Z of probing start"),
    parameter(14, "tip_diameter", "5", "diameter of the probe's tip"),
    parameter(15, "register", "1", "number of the variable that holds probing start"),
    parameter(16, "note_1", "", "first line of notes, at most 66 characters"),
    parameter(17, "note_2", "", "second line of notes"),
    parameter(18, "note_3", "", "third line of notes"),
    parameter(19, "reference_z", "0", "Z of the reference, in part coordinates"),
    parameter(20, "offset_number", "0", "tool offset number, 0 for none"),
    parameter(22, "reference_x", "0", "X of the reference, in part coordinates"),
    parameter(23, "clear_z", "0", "machine Z to leave the probe at"),
];

const MOVES: u32 = 21;
const MAX_TEXT: usize = 66;

/// Values of the parameters, by number.
#[derive(Debug, Clone)]
pub struct VariableValues(BTreeMap<u32, String>);

impl Default for VariableValues {
    fn default() -> Self {
        Self(PARAMETERS.iter().map(|p| (p.number, p.default.to_owned())).collect())
    }
}

impl VariableValues {
    /// Reads values from a TOML file of `name = value`.
    ///
    /// # Errors
    /// Not TOML, an unknown name, a value that is not a string or number, or one that the parameter does not
    /// take.
    pub fn read(&mut self, file: &Path) -> Result<(), InputError> {
        let text = rtec_files::text_file::read(file)?;
        for entry in Document::parse(file, &text)?.root().entries() {
            let number =
                || entry.as_integer().map(|i| i.to_string()).or(entry.as_number().map(|f| f.to_string()));
            let value = entry.as_str().map(str::to_owned).or_else(number);
            let value = value.ok_or_else(|| entry.mismatch("a text or a number"))?;
            self.set(entry.key(), &value).map_err(|(found, expected)| entry.key_error(found, expected))?;
        }
        Ok(())
    }

    /// Sets one parameter.
    ///
    /// # Errors
    /// What was found and what was expected: an unknown name, or a value that the parameter does not take.
    pub fn set(&mut self, name: &str, value: &str) -> Result<(), (String, String)> {
        let Some(p) = PARAMETERS.iter().find(|p| p.name == name) else {
            let names: Vec<&str> = PARAMETERS.iter().map(|p| p.name).collect();
            return Err((format!("'{name}'"), format!("one of {}", names.join(", "))));
        };
        let digits = |n: usize| value.len() == n && value.bytes().all(|b| b.is_ascii_digit());
        let is_text =
            || value.chars().count() <= MAX_TEXT && !value.contains(['(', ')', '\n', '\r', '$', '@', '%']);
        let (fits, expected) = match p.number {
            1 => (digits(4), "four digits: part and version"),
            2 => (matches!(value, "2" | "4" | "6" | "8"), "an even digit, 2 to 8"),
            4 | 15 | 20 => ((1..=2).any(digits), "one or two digits"),
            3 | 5 | 6 | 16..=18 => (is_text(), "at most 66 characters without ( ) $ @ %"),
            _ => (value.parse().is_ok_and(|v: f64| v.is_finite()), "a finite number"),
        };
        if !fits {
            return Err((format!("{name} = '{value}'"), expected.to_owned()));
        }
        self.0.insert(p.number, value.to_owned());
        Ok(())
    }

    /// The default values in a program's unit.
    pub fn in_unit(unit: LengthUnit) -> Self {
        let mut all = Self::default();
        for p in PARAMETERS.iter().filter(|p| matches!(p.number, 11 | 12 | 14)) {
            if let Ok(mm) = p.default.parse::<f64>() {
                all.0.insert(p.number, format!("{}", (mm / unit.0 * 1e4).round() / 1e4));
            }
        }
        all
    }

    /// Machine positions of a template that are not set.
    /// A program that moves to them is not ready for a machine.
    pub fn unset(&self, template: &str) -> impl Iterator<Item = &'static str> {
        let asked = |n: u32| {
            let symbol = format!("${n}");
            let ends = |(at, _): (usize, &str)| {
                !template[at + symbol.len()..].starts_with(|c: char| c.is_ascii_digit())
            };
            template.match_indices(&symbol).any(ends)
        };
        let positions =
            PARAMETERS.iter().filter(move |p| matches!(p.number, 13 | 19 | 22 | 23) && asked(p.number));
        positions.filter(|p| self.get(p.number) == p.default).map(|p| p.name)
    }

    fn get(&self, number: u32) -> &str {
        self.0.get(&number).map_or("", String::as_str)
    }

    /// The program's file name: `pt`, part, version, `s`, segment, `.dnc`.
    pub fn file_name(&self) -> String {
        format!("pt{}s{}.dnc", self.get(1), self.get(2))
    }
}

impl DialectWithTemplate {
    /// A built-in dialect.
    /// `None` if there is none of this name.
    ///
    /// # Errors
    /// Never for a name of [`BUILT_IN`]: a test reads them all.
    pub fn built_in(name: &str) -> Option<Result<Self, InputError>> {
        let (name, dialect, template) = BUILT_IN.iter().find(|(n, ..)| *n == name)?;
        Some(Self::parse(Path::new(name), dialect, template))
    }

    /// Reads a dialect and a template from files.
    ///
    /// # Errors
    /// Unreadable, or not a dialect: the finding names the key.
    pub fn read(dialect: &Path, template: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text_file::read(dialect)?;
        Self::parse(dialect, &text, &rtec_files::text_file::read(template)?)
    }

    fn parse(file: &Path, dialect: &str, template: &str) -> Result<Self, InputError> {
        let parsed = rtec_files::strict_toml::from_str(file, dialect, "a dialect's keys")?;
        Ok(Self { dialect: parsed, template: template.to_owned() })
    }
}

/// The inputs of an NC probing program.
#[derive(Debug, Clone)]
pub struct ProbingProgramInputs<'a> {
    /// The controller that it is for.
    pub controller: &'a DialectWithTemplate,
    /// Values of the template's `$n`.
    pub parameters: &'a VariableValues,
    /// The probe's path, record by record.
    pub records: &'a [PathPoint],
    /// The program's unit: inches or mm.
    pub unit: LengthUnit,
    /// Whether to explain every move.
    /// Without it moves and template code have no comments.
    pub comments: bool,
    /// Date and time of making, as text.
    pub made: &'a str,
}

impl ProbingProgramInputs<'_> {
    /// The text of the program.
    ///
    /// # Errors
    /// An unknown `$n` or `@n` of the template (`template` is its file's name), no `$21`, or more moves than
    /// block numbers.
    pub fn text(&self, template: &Path) -> Result<String, InputError> {
        let d = &self.controller.dialect;
        let (mut text, mut seen_moves) = (String::new(), false);
        let mut block = d.block_step;
        let mut after: BTreeMap<u32, u32> = BTreeMap::new();
        for (i, line) in self.controller.template.lines().enumerate() {
            let mut out = String::new();
            let mut rest = line;
            while let Some(at) = rest.find(['$', '@']) {
                out.push_str(&rest[..at]);
                let symbol = &rest[at..=at];
                let digits: String = rest[at + 1..].chars().take_while(char::is_ascii_digit).collect();
                let column = line.len() - rest.len() + at + 1;
                let known = "a parameter $n or a value @n that is known";
                let unknown = |name: String| InputError::at(template, i + 1, column, name, known);
                let number: u32 = digits.parse().map_err(|_| unknown(format!("'{symbol}{digits}'")))?;
                match (symbol, number) {
                    ("$", MOVES) => {
                        seen_moves = true;
                        out.push_str(&self.moves(&mut block));
                    }
                    ("$", n) if self.parameters.0.contains_key(&n) => out.push_str(self.parameters.get(n)),
                    ("@", 5..=8) if seen_moves => {
                        let n = *after.entry(number).or_insert_with(|| {
                            block += d.block_step;
                            block
                        });
                        let _ = write!(out, "{n:0width$}", width = d.block_digits);
                    }
                    ("@", n) => out.push_str(&self.value(n).ok_or_else(|| unknown(format!("'@{n}'")))?),
                    _ => return Err(unknown(format!("'{symbol}{number}'"))),
                }
                rest = &rest[at + 1 + digits.len()..];
            }
            out.push_str(rest);
            if !seen_moves {
                block = block_number(&out).unwrap_or(block);
            }
            if !self.comments {
                out = self.bare(&out);
            }
            text.push_str(out.trim_end());
            text.push('\n');
        }
        if !seen_moves {
            return Err(InputError::whole(template, "no $21", "$21 where the probe's moves go"));
        }
        if block >= d.program_end {
            let found = format!("block number {block}");
            return Err(InputError::whole(template, found, format!("fewer moves: below N{}", d.program_end)));
        }
        Ok(text)
    }

    fn value(&self, number: u32) -> Option<String> {
        let d = &self.controller.dialect;
        let inch = self.unit == LengthUnit::INCH;
        Some(match number {
            1 => "s".to_owned(),
            2 => (self.parameters.get(2).parse::<u32>().unwrap_or(2) / 2).to_string(),
            3 => self.made.to_owned(),
            4 => format!("{:0>2}", self.parameters.get(20)),
            9 => if inch { &d.inch } else { &d.mm }.clone(),
            10 => if inch { "INCH" } else { "MM" }.to_owned(),
            _ => return None,
        })
    }

    /// The code of a line without the comment after it.
    /// A line that is only a comment stays.
    fn bare(&self, line: &str) -> String {
        let [open, close] = &self.controller.dialect.comment;
        line.lines()
            .map(|line| {
                let code = line.find(open.as_str()).map_or(line, |at| &line[..at]);
                let only_number = code.trim_start_matches('N').trim().bytes().all(|b| b.is_ascii_digit());
                let ends = close.is_empty() || line.trim_end().ends_with(close.as_str());
                let keep = only_number || !ends || code.starts_with(['O', '%']);
                if keep { line } else { code.trim_end() }
            })
            .collect::<Vec<_>>()
            .join("\n")
    }

    /// The moves, one block each.
    /// The first move goes along Z alone, then along X alone, which keeps it farthest from the part.
    fn moves(&self, block: &mut u32) -> String {
        let d = &self.controller.dialect;
        let mut text = String::new();
        let mut put = |code: String, comment: &str| {
            *block += d.block_step;
            let _ = write!(text, "N{block:0width$} {code}", width = d.block_digits);
            if self.comments {
                let _ = write!(text, " {}{comment}{}", d.comment[0], d.comment[1]);
            }
            text.push('\n');
        };
        let decimals = if self.unit == LengthUnit::INCH { d.decimals_inch } else { d.decimals_mm };
        let word = |letter: char, mm: f64| {
            let scale = 10_f64.powi(decimals as i32);
            format!("{letter}{:.decimals$}", (mm / self.unit.0 * scale).round() / scale + 0.0)
        };
        let z = |at: Zx| word('Z', at.z);
        let x = |at: Zx| word('X', if d.x_is_diameter { 2.0 * at.x } else { at.x });
        let mut point = 0;
        for (i, r) in self.records.iter().enumerate() {
            let both = format!("{} {}", z(r.at), x(r.at));
            if i == 0 {
                put(format!("{} {}", d.rapid, z(r.at)), "FIRST ALONG Z ONLY");
                put(format!("{} {}", d.rapid, x(r.at)), "THEN ALONG X ONLY");
                continue;
            }
            let feed = format!(" F{}", self.parameters.get(12));
            let (code, feed, comment) = match r.role {
                PathPointRole::Start => (&d.rapid, "", format!("APPROACH POINT {}", point + 1)),
                PathPointRole::Touch(n) => {
                    point = n;
                    (&d.touch, feed.as_str(), format!("TOUCH POINT {n}"))
                }
                PathPointRole::Finish => (&d.retract, "", format!("RETRACT FROM POINT {point}")),
                PathPointRole::Bypass => (&d.rapid, "", "BY-PASS".to_owned()),
            };
            put(format!("{code} {both}{feed}"), &comment);
        }
        text.truncate(text.trim_end().len());
        text
    }
}

fn block_number(line: &str) -> Option<u32> {
    let digits: String = line.strip_prefix('N')?.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().ok()
}

/// Date and time of a Unix time, UTC, in the form of programs.
pub fn date_time(unix_s: u64) -> String {
    let (date, second) = (date::format((unix_s / 86_400) as i64), unix_s % 86_400);
    format!("{date} {:02}:{:02} UTC", second / 3600, second / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_the_calendars() {
        assert_eq!(date_time(0), "1970-01-01 00:00 UTC");
        assert_eq!(date_time(951_782_400), "2000-02-29 00:00 UTC");
        assert_eq!(date_time(709_171_199), "1992-06-21 23:59 UTC");
    }
}
