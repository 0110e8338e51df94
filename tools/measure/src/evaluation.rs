//! Runs evaluated by the standard that fits them: the document that programs read and the report that people read.

use crate::iso230::{self, Conditions, Options};
use crate::plausible::{self, Suspicion, What};
use crate::plot::PlotError;
use crate::report::{self, Report};
use crate::{ballbar, plate};
use rtec_files::{InputError, Said};
use rtec_model::record::{Kind, Record, Role};
use serde_json::{Value, json};
use std::path::Path;

/// The evaluations, by the names that they are asked for with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standard {
    /// Positioning: accuracy and repeatability; tilts too.
    Iso230_2,
    /// Straightness of an axis's motion (ISO 230-1).
    Straightness,
    /// Thermal effects, phase by phase.
    Iso230_3,
    /// Body or face diagonals.
    Iso230_6,
    /// Circular test, ISO 230-4.
    Ballbar,
    /// Plate of holes.
    Plate,
    /// Returning to one position.
    Repeatability,
}

impl Standard {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 7] = [
        ("iso230-2", Self::Iso230_2),
        ("straightness", Self::Straightness),
        ("iso230-3", Self::Iso230_3),
        ("iso230-6", Self::Iso230_6),
        ("ballbar", Self::Ballbar),
        ("plate", Self::Plate),
        ("repeatability", Self::Repeatability),
    ];

    /// The evaluation of this name; `iso230-4` is the ballbar's too.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        let name = if name == "iso230-4" { "ballbar" } else { name };
        Self::ALL.iter().find(|(own, _)| *own == name).map(|(_, standard)| *standard)
    }

    /// The evaluation that belongs to a record's kind.
    ///
    /// # Errors
    /// None does.
    pub fn of(record: &Record) -> Result<Self, InputError> {
        match (iso230::standard_for(record.kind), record.kind) {
            // What was measured across an axis alone is its straightness, not its positioning.
            (Some("iso230-2"), _) if !iso230::has_positioning(record) && iso230::has_straightness(record) => {
                Ok(Self::Straightness)
            }
            (Some("iso230-2"), _) => Ok(Self::Iso230_2),
            (Some("iso230-3"), _) => Ok(Self::Iso230_3),
            (Some("ballbar"), _) => Ok(Self::Ballbar),
            (_, Kind::Plate) => Ok(Self::Plate),
            (_, kind) => Err(InputError::whole(
                &record.path,
                format!("a run of kind {}", kind.name()),
                "--standard, as no evaluation belongs to this kind",
            )),
        }
    }

    /// What the conditions state and this evaluation has no use for.
    fn unused(self, conditions: &Conditions, records: &[Record]) -> Option<String> {
        let lengths = records.iter().flat_map(Record::responses).any(|c| matches!(c.role, Role::Error(_)));
        if matches!(self, Self::Iso230_2 | Self::Iso230_6) && lengths {
            // The scale alone is right beside an interferometer; a workpiece is compared with a scale, and both grow.
            let one = conditions.workpiece.is_some() && conditions.scale.is_none();
            let said = "[thermal] has a sensor of the workpiece alone: the scale is taken to be at 20 °C";
            return one.then(|| said.to_owned());
        }
        let thermal = conditions.scale.is_some() || conditions.workpiece.is_some();
        let parts = [
            thermal.then_some("[thermal]: nothing is reduced to 20 °C"),
            (!conditions.stated.is_empty()).then_some("[uncertainty]: no figure has one"),
        ];
        let said: Vec<&str> = parts.into_iter().flatten().collect();
        (!said.is_empty())
            .then(|| format!("of the conditions this evaluation does not use {}", said.join(", ")))
    }
}

/// What an evaluation is asked with.
#[derive(Debug, Clone, Default)]
pub struct Asked {
    /// The evaluation; by the first record's kind where it is left out.
    pub standard: Option<Standard>,
    /// What the test was done under.
    pub conditions: Conditions,
    /// Positioning: targets approached from one side only are accepted, and the one-sided figures given alone.
    pub one_way: bool,
    /// Plates: the sum of fourth powers is made small instead of that of squares.
    pub fourth_powers: bool,
}

/// An evaluation.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// What programs read.
    pub document: Value,
    /// What people read.
    pub report: Report,
    /// Mistakes that the records show.
    pub doubts: Vec<Suspicion>,
}

/// Evaluates runs as their standard defines it; what is to be said on the way goes to `say`.
///
/// # Errors
/// No record; a kind without a standard; what the standard needs and the records lack; a sensor that reads nonsense and
/// that lengths are to be reduced with.
pub fn evaluate(
    records: &[Record],
    asked: &Asked,
    say: &mut dyn FnMut(Said),
) -> Result<Evaluation, InputError> {
    let Some(first) = records.first() else {
        return Err(InputError::whole(Path::new("characterise evaluate"), "no record", "a record"));
    };
    let doubts = plausible::said(records, say);
    reducible(&asked.conditions, &doubts)?;
    let standard = asked.standard.map_or_else(|| Standard::of(first), Ok)?;
    let (mut document, mut report) = by(standard, records, asked, say)?;
    if let Some(unused) = standard.unused(&asked.conditions, records) {
        report.warn(&unused);
    }
    for doubt in &doubts {
        report.doubt(&doubt.to_string(), of_rows(doubt));
    }
    for warning in report.warnings().iter().skip(doubts.len()) {
        say(Said::Warning(format!("{}: {warning}", first.path.display())));
    }
    if doubts.iter().any(of_rows) {
        say(Said::Warning(report::KEPT.to_owned()));
    }
    plausible::enter(&mut document, &doubts);
    Ok(Evaluation { document, report, doubts })
}

fn of_rows(doubt: &Suspicion) -> bool {
    matches!(doubt.what, What::Outliers | What::Doubled)
}

/// A sensor that reads nonsense would carry it into every figure by the reduction to 20 °C.
fn reducible(conditions: &Conditions, doubts: &[Suspicion]) -> Result<(), InputError> {
    for body in [&conditions.scale, &conditions.workpiece].into_iter().flatten() {
        let Some(doubt) = doubts.iter().find(|d| d.is_of_sensor() && d.column == body.sensor) else {
            continue;
        };
        let found = format!(
            "{}: {}: {}, and lengths are to be reduced to 20 °C with it",
            doubt.column, doubt.what, doubt.text
        );
        let expected =
            "another sensor in [thermal] of the conditions, a record without those rows, or no [thermal]";
        return Err(InputError::whole(Path::new(&doubt.record), found, expected));
    }
    Ok(())
}

/// One of them as it is, several as a list under a name.
fn one_or(name: &str, mut list: Vec<Value>) -> Value {
    if list.len() == 1 { list.remove(0) } else { json!({ name: list }) }
}

/// The only record of an evaluation that takes one at a time.
fn single(records: &[Record]) -> Result<&Record, InputError> {
    match records {
        [_, second, ..] => {
            let found = format!("{} records", records.len());
            Err(InputError::whole(&second.path, found, "one record at a time by this standard"))
        }
        one => Ok(&one[0]),
    }
}

fn by(
    standard: Standard,
    records: &[Record],
    asked: &Asked,
    say: &mut dyn FnMut(Said),
) -> Result<(Value, Report), InputError> {
    let file = &records[0].path;
    let unwritten =
        |e: serde_json::Error| InputError::whole(file, e.to_string(), "figures that can be written");
    let undrawn = |e: PlotError| InputError::whole(file, e.to_string(), "figures that can be drawn");
    let options = Options { one_way: asked.one_way, conditions: asked.conditions.clone() };
    let conditions = &asked.conditions;
    Ok(match standard {
        Standard::Iso230_2 => {
            let mut all = Vec::new();
            for record in records {
                all.extend(iso230::positioning_with(record, &options).map_err(|mut e| {
                    e.expected.push_str(
                        "; where the machine only returned to one position, --standard repeatability",
                    );
                    e
                })?);
            }
            for record in records.iter().filter(|r| iso230::has_straightness(r)) {
                say(Said::Note(format!(
                    "{}: errors across the moving axis too: --standard straightness evaluates them",
                    record.path.display()
                )));
            }
            let report = report::positioning(&all, records, conditions).map_err(undrawn)?;
            (one_or("axes", values(&all).map_err(unwritten)?), report)
        }
        Standard::Straightness => {
            let record = single(records)?;
            let all = iso230::straightness(record)?;
            let report = report::straightness(&all, record, conditions).map_err(undrawn)?;
            (one_or("motions", values(&all).map_err(unwritten)?), report)
        }
        Standard::Iso230_3 => {
            let record = single(records)?;
            let all = iso230::drift(record)?;
            let report = report::drift(&all, record, conditions).map_err(undrawn)?;
            (one_or("axes", values(&all).map_err(unwritten)?), report)
        }
        Standard::Iso230_6 => {
            let found = iso230::diagonals(records, &options)?;
            let report = report::diagonals(&found, records, conditions).map_err(undrawn)?;
            (serde_json::to_value(found).map_err(unwritten)?, report)
        }
        Standard::Ballbar => {
            let planes = ballbar::evaluate(records)?;
            let report = report::ballbar(&planes, records, conditions).map_err(undrawn)?;
            (one_or("planes", values(&planes).map_err(unwritten)?), report)
        }
        Standard::Plate => {
            let record = single(records)?;
            let norm = if asked.fourth_powers { plate::Norm::Fourth } else { plate::Norm::Squares };
            let found = plate::evaluate(record, norm)?;
            let report = report::plate(&found, record, conditions).map_err(undrawn)?;
            (serde_json::to_value(found).map_err(unwritten)?, report)
        }
        Standard::Repeatability => returns(single(records)?, conditions)?,
    })
}

fn returns(record: &Record, conditions: &Conditions) -> Result<(Value, Report), InputError> {
    let axes = iso230::repeatability(record);
    if axes.is_empty() {
        let expected = "a column of role error.AXIS with two returns at least";
        return Err(InputError::whole(&record.path, "nothing that returned twice", expected));
    }
    let of = |(axis, [s, range]): (&String, &[f64; 2])| (axis.clone(), json!({"s_um": s, "range_um": range}));
    let found = axes.iter().map(of).collect::<serde_json::Map<_, _>>();
    let report = report::repeatability(&axes, record, conditions)
        .map_err(|e| InputError::whole(&record.path, e.to_string(), "figures that can be drawn"))?;
    Ok((Value::Object(found), report))
}

fn values(all: &[impl serde::Serialize]) -> serde_json::Result<Vec<Value>> {
    all.iter().map(serde_json::to_value).collect()
}
