//! `rtecctl characterise evaluate`: a run's figures as its standard defines them, with a plot.

use crate::verbs::suspicions;
use anyhow::Context;
use rtec_files::InputError;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_measure::{iso230, plate};
use rtec_model::record::Record;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Evaluate a run as its standard defines it
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run record
    #[arg(value_name = "NAME.run.toml")]
    record: PathBuf,
    /// The evaluation; by the record's kind where it is left out
    #[arg(long, value_enum)]
    standard: Option<Standard>,
    /// Plates: what the fit makes small, the sum of squares (2) or of fourth powers (4)
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=4))]
    norm: u8,
    /// Draw the evaluation into this SVG file
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Standard {
    /// Positioning: accuracy and repeatability
    #[value(name = "iso230-2")]
    Iso230_2,
    /// Thermal drift
    #[value(name = "iso230-3")]
    Iso230_3,
    /// Circular test, ISO 230-4
    Ballbar,
    /// Plate of holes: offset, scale, rotation, quadrupole
    Plate,
    /// Returning to one position: standard deviation and range per axis
    Repeatability,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let record = rtec_measure::record::read(&args.record)?;
    let doubts = suspicions::warn(std::slice::from_ref(&record));
    let standard = match args.standard {
        Some(s) => s,
        None => by_kind(&record)?,
    };
    let (mut found, charts) = evaluate(&record, standard, args.norm)?;
    if let Some(list) = found.as_array().filter(|l| l.len() > 1) {
        found = json!({ "axes": list });
    } else if let Some(one) = found.as_array_mut().and_then(Vec::pop) {
        found = one;
    }
    for warning in warnings(&found) {
        eprintln!("warning: {}: {warning}", args.record.display());
    }
    if let Some(path) = &args.plot {
        for (i, chart) in charts.iter().enumerate() {
            let path = if i == 0 { path.clone() } else { path.with_extension(format!("{}.svg", i + 1)) };
            let svg = chart.svg(900, 560)?;
            rtec_files::write::whole(&path, svg.as_bytes())
                .with_context(|| format!("writing {}", path.display()))?;
        }
    }
    if args.json {
        suspicions::enter(&mut found, &doubts);
        println!("{}", serde_json::to_string_pretty(&found)?);
    } else {
        print_flat("", &found);
    }
    Ok(())
}

fn by_kind(record: &Record) -> Result<Standard, InputError> {
    match (iso230::standard_for(record.kind), record.kind) {
        (Some("iso230-2"), _) => Ok(Standard::Iso230_2),
        (Some("iso230-3"), _) => Ok(Standard::Iso230_3),
        (Some("ballbar"), _) => Ok(Standard::Ballbar),
        (_, rtec_model::record::Kind::Plate) => Ok(Standard::Plate),
        (_, kind) => Err(InputError::whole(
            &record.path,
            format!("a run of kind {}", kind.name()),
            "--standard, as no evaluation belongs to this kind",
        )),
    }
}

fn evaluate(record: &Record, standard: Standard, norm: u8) -> anyhow::Result<(Value, Vec<Chart>)> {
    Ok(match standard {
        Standard::Iso230_2 => {
            let all = iso230::positioning(record).map_err(|mut e| {
                e.expected
                    .push_str("; where the machine only returned to one position, --standard repeatability");
                e
            })?;
            let charts = all.iter().map(iso230::Positioning::chart).collect();
            (serde_json::to_value(all)?, charts)
        }
        Standard::Iso230_3 => (serde_json::to_value(iso230::drift(record)?)?, iso230::drift_charts(record)),
        Standard::Ballbar => (
            serde_json::to_value(rtec_measure::ballbar::evaluate(std::slice::from_ref(record))?)?,
            Vec::new(),
        ),
        Standard::Plate => {
            let norm = if norm == 2 { plate::Norm::Squares } else { plate::Norm::Fourth };
            let p = plate::evaluate(record, norm)?;
            let chart = p.chart(record);
            (serde_json::to_value(p)?, vec![chart])
        }
        Standard::Repeatability => {
            let of = |(axis, [s, range]): (&String, &[f64; 2])| {
                (axis.clone(), json!({"s_um": s, "range_um": range}))
            };
            let axes = iso230::repeatability(record).iter().map(of).collect::<serde_json::Map<_, _>>();
            let mut chart = Chart::new("Returning to one position", "return", "error, µm");
            for c in record.responses() {
                let points = c.data.iter().enumerate().map(|(i, e)| (i as f64 + 1.0, *e)).collect();
                chart = chart.with(Series::new(&c.role.to_string(), Style::Dots, points));
            }
            (Value::Object(axes), vec![chart])
        }
    })
}

fn warnings(found: &Value) -> Vec<String> {
    let own = found["warnings"].as_array().into_iter().flatten();
    let of_axes =
        found["axes"].as_array().into_iter().flatten().filter_map(|a| a["warnings"].as_array()).flatten();
    own.chain(of_axes).filter_map(|w| w.as_str().map(str::to_owned)).collect()
}

/// Every number with its key; lists of rows are left to JSON and the plot.
fn print_flat(prefix: &str, value: &Value) {
    match value {
        Value::Object(map) => {
            for (key, v) in map {
                let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                print_flat(&name, v);
            }
        }
        Value::Array(list) if prefix == "axes" => {
            for v in list {
                print_flat(v["axis"].as_str().or(v["response"].as_str()).unwrap_or(prefix), v);
            }
        }
        Value::Array(list) if list.iter().all(Value::is_number) && (1..=3).contains(&list.len()) => {
            let words: Vec<String> =
                list.iter().filter_map(Value::as_f64).map(|v| format!("{v:.4}")).collect();
            println!("{prefix:24} {}", words.join(", "));
        }
        Value::Number(n) if n.is_f64() => println!("{prefix:24} {:.4}", n.as_f64().unwrap_or_default()),
        Value::Number(n) => println!("{prefix:24} {n}"),
        Value::String(s) => println!("{prefix:24} {s}"),
        _ => {}
    }
}
