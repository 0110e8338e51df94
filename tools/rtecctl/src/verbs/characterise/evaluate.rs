//! `rtecctl characterise evaluate`: runs' figures as their standard defines them, as text, JSON, plots or a page.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::iso230::{self, Conditions, Options};
use rtec_measure::plausible::{Suspicion, What};
use rtec_measure::report::{self, Report};
use rtec_measure::{ballbar, plate};
use rtec_model::record::{Kind, Record, Role};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Evaluate runs as their standard defines it
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run records: one, or all circles of a machine, or all diagonals of a box
    #[arg(value_name = "NAME.run.toml", required = true)]
    records: Vec<PathBuf>,
    /// The evaluation; by the record's kind where it is left out
    #[arg(long, value_enum)]
    standard: Option<Standard>,
    /// What the test was done under: machine, instrument, sensors and coefficients for 20 °C, contributors of the
    /// uncertainty
    #[arg(long, value_name = "FILE.toml")]
    conditions: Option<PathBuf>,
    /// Positioning: accept targets approached from one side only, and give the one-sided figures alone
    #[arg(long)]
    one_way: bool,
    /// Plates: what the fit makes small, the sum of squares (2) or of fourth powers (4)
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=4))]
    norm: u8,
    /// Draw the evaluation into this SVG file, further plots into FILE.2.svg, FILE.3.svg …
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Write a report with tables and plots as one page, ready to print
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Standard {
    /// Positioning: accuracy and repeatability; tilts too
    #[value(name = "iso230-2")]
    Iso230_2,
    /// Straightness of an axis's motion: the error across it, about a least-squares line (ISO 230-1)
    Straightness,
    /// Thermal effects, phase by phase
    #[value(name = "iso230-3")]
    Iso230_3,
    /// Body or face diagonals
    #[value(name = "iso230-6")]
    Iso230_6,
    /// Circular test, ISO 230-4
    #[value(alias = "iso230-4")]
    Ballbar,
    /// Plate of holes: offset, scale, rotation, quadrupole
    Plate,
    /// Returning to one position: standard deviation and range per axis
    Repeatability,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let records =
        args.records.iter().map(|p| rtec_measure::record::read(p)).collect::<Result<Vec<_>, _>>()?;
    let conditions = args.conditions.as_deref().map(Conditions::read).transpose()?.unwrap_or_default();
    let doubts = suspicions::warn(&records);
    reducible(&conditions, &doubts)?;
    let standard = match args.standard {
        Some(s) => s,
        None => by_kind(&records[0])?,
    };
    let unused = unused(standard, &conditions, &records);
    let (mut found, mut report) = evaluate(args, &records, standard, conditions)?;
    if let Some(unused) = unused {
        report.warn(&unused);
    }
    for doubt in &doubts {
        report.doubt(&doubt.to_string(), matches!(doubt.what, What::Outliers | What::Doubled));
    }
    for warning in report.warnings().iter().skip(doubts.len()) {
        eprintln!("warning: {}: {warning}", args.records[0].display());
    }
    if doubts.iter().any(|d| matches!(d.what, What::Outliers | What::Doubled)) {
        eprintln!("warning: {}", report::KEPT);
    }
    if let Some(path) = &args.plot {
        for (i, svg) in report.plots().enumerate() {
            let path = if i == 0 { path.clone() } else { path.with_extension(format!("{}.svg", i + 1)) };
            write(&path, svg)?;
        }
    }
    if let Some(path) = &args.html {
        write(path, &report.html())?;
    }
    if args.json {
        suspicions::enter(&mut found, &doubts);
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print!("{}", report.text());
    }
    Ok(())
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

/// What the conditions state and this evaluation has no use for.
fn unused(standard: Standard, conditions: &Conditions, records: &[Record]) -> Option<String> {
    let lengths = records.iter().flat_map(Record::responses).any(|c| matches!(c.role, Role::Error(_)));
    if matches!(standard, Standard::Iso230_2 | Standard::Iso230_6) && lengths {
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
    (!said.is_empty()).then(|| format!("of the conditions this evaluation does not use {}", said.join(", ")))
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    rtec_files::write::whole(path, text.as_bytes()).with_context(|| format!("writing {}", path.display()))
}

fn by_kind(record: &Record) -> Result<Standard, InputError> {
    match (iso230::standard_for(record.kind), record.kind) {
        // What was measured across an axis alone is its straightness, not its positioning.
        (Some("iso230-2"), _) if !iso230::has_positioning(record) && iso230::has_straightness(record) => {
            Ok(Standard::Straightness)
        }
        (Some("iso230-2"), _) => Ok(Standard::Iso230_2),
        (Some("iso230-3"), _) => Ok(Standard::Iso230_3),
        (Some("ballbar"), _) => Ok(Standard::Ballbar),
        (_, Kind::Plate) => Ok(Standard::Plate),
        (_, kind) => Err(InputError::whole(
            &record.path,
            format!("a run of kind {}", kind.name()),
            "--standard, as no evaluation belongs to this kind",
        )),
    }
}

/// One of them as it is, several as a list under a name.
fn one_or(name: &str, mut list: Vec<Value>) -> Value {
    if list.len() == 1 { list.remove(0) } else { json!({ name: list }) }
}

fn values(all: &[impl serde::Serialize]) -> serde_json::Result<Vec<Value>> {
    all.iter().map(serde_json::to_value).collect()
}

/// The only record of an evaluation that takes one at a time.
fn single(records: &[Record]) -> Result<&Record, InputError> {
    match records {
        [one] => Ok(one),
        [_, second, ..] => {
            let found = format!("{} records", records.len());
            Err(InputError::whole(&second.path, found, "one record at a time by this standard"))
        }
        [] => Err(InputError::whole(Path::new("characterise evaluate"), "no record", "a record")),
    }
}

fn evaluate(
    args: &Args,
    records: &[Record],
    standard: Standard,
    conditions: Conditions,
) -> anyhow::Result<(Value, Report)> {
    let options = Options { one_way: args.one_way, conditions };
    let conditions = &options.conditions;
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
                eprintln!(
                    "note: {}: errors across the moving axis too: --standard straightness evaluates them",
                    record.path.display()
                );
            }
            let report = report::positioning(&all, records, conditions)?;
            (one_or("axes", values(&all)?), report)
        }
        Standard::Straightness => {
            let record = single(records)?;
            let all = iso230::straightness(record)?;
            (one_or("motions", values(&all)?), report::straightness(&all, record, conditions)?)
        }
        Standard::Iso230_3 => {
            let record = single(records)?;
            let all = iso230::drift(record)?;
            (one_or("axes", values(&all)?), report::drift(&all, record, conditions)?)
        }
        Standard::Iso230_6 => {
            let found = iso230::diagonals(records, &options)?;
            let report = report::diagonals(&found, records, conditions)?;
            (serde_json::to_value(found)?, report)
        }
        Standard::Ballbar => {
            let planes = ballbar::evaluate(records)?;
            let report = report::ballbar(&planes, records, conditions)?;
            (one_or("planes", values(&planes)?), report)
        }
        Standard::Plate => {
            let record = single(records)?;
            let norm = if args.norm == 2 { plate::Norm::Squares } else { plate::Norm::Fourth };
            let found = plate::evaluate(record, norm)?;
            let report = report::plate(&found, record, conditions)?;
            (serde_json::to_value(found)?, report)
        }
        Standard::Repeatability => {
            let record = single(records)?;
            let axes = iso230::repeatability(record);
            if axes.is_empty() {
                let expected = "a column of role error.AXIS with two returns at least";
                return Err(InputError::whole(&record.path, "nothing that returned twice", expected).into());
            }
            let of = |(axis, [s, range]): (&String, &[f64; 2])| {
                (axis.clone(), json!({"s_um": s, "range_um": range}))
            };
            let found = axes.iter().map(of).collect::<serde_json::Map<_, _>>();
            (Value::Object(found), report::repeatability(&axes, record, conditions)?)
        }
    })
}
