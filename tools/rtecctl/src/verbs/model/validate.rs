//! `rtecctl model validate` and `rehearse`: a model on data it has not seen, and on a shift before it is loaded.

use crate::Outcome;
use crate::verbs::suspicions;
use anyhow::Context;
use rtec_control::config::{Config, ConfiguredAxis};
use rtec_correct::rehearse::{self, AxisChange};
use rtec_fit::thermal;
use rtec_measure::plausible;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::date;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Role};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Judge a model on records: what is left, how often its interval holds, where it is asked too much
#[derive(Debug, clap::Args)]
pub(crate) struct ValidateArgs {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Records it has not seen
    #[arg(long = "record", value_name = "NAME.run.toml", required = true)]
    records: Vec<PathBuf>,
    /// Draw measured, predicted and the 95 % interval over time, one file per record and response
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Replay a recorded shift against a new model and show what would change
#[derive(Debug, clap::Args)]
pub(crate) struct RehearseArgs {
    /// The new model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// The present model; none where it is left out
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// The shift: positions and temperatures, no response needed
    #[arg(long, value_name = "NAME.run.toml")]
    record: PathBuf,
    /// The configuration whose axes, window, limits, ramp and lead the corrections go through
    #[arg(long, value_name = "rtec.toml")]
    config: Option<PathBuf>,
    /// Draw both corrections, one file per axis
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Less than this share of the rows within a 95 % interval is too little.
const HOLDS: f64 = 0.9;

pub(crate) fn validate(args: &ValidateArgs) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let mut found: Vec<Value> = Vec::new();
    let mut worse: Vec<String> = Vec::new();
    let records =
        args.records.iter().map(|p| rtec_measure::record::read(p)).collect::<Result<Vec<_>, _>>()?;
    let doubts = plausible::said(&records, &mut suspicions::say);
    for (path, record) in args.records.iter().zip(&records) {
        let prediction = machine.predict(record)?;
        let seen = machine.fits().iter().any(|f| f.from.iter().any(|s| s.sha256 == record.sha256));
        for (column, (_, predicted)) in record.responses().zip(&prediction.columns) {
            let n = column.data.len() as f64;
            let rms = |v: &mut dyn Iterator<Item = f64>| (v.map(|d| d * d).sum::<f64>() / n).sqrt();
            let mean = column.data.iter().sum::<f64>() / n;
            let left: Vec<f64> = column.data.iter().zip(predicted).map(|(m, p)| m - p).collect();
            let (before, after) = (rms(&mut column.data.iter().copied()), rms(&mut left.iter().copied()));
            let response = column.role.to_string();
            let widths = machine.half_widths_um(record, &column.role);
            let inside = widths
                .as_ref()
                .map(|w| left.iter().zip(w).filter(|(v, w)| v.abs() <= **w).count() as f64 / n);
            // A run's own zero (homing, the gauge's set-up) is no model's to tell.
            let zero = left.iter().sum::<f64>() / n;
            let about_zero = widths
                .as_ref()
                .map(|w| left.iter().zip(w).filter(|(v, w)| (*v - zero).abs() <= **w).count() as f64 / n);
            let width = widths.as_ref().map(|w| w.iter().sum::<f64>() / n);
            if let Some(path) = &args.plot {
                let path = if found.is_empty() {
                    path.clone()
                } else {
                    path.with_extension(format!("{}.svg", found.len() + 1))
                };
                let svg =
                    thermal::prediction_chart(record, column, predicted, widths.as_deref()).svg(1000, 520)?;
                rtec_files::write::whole(&path, svg.as_bytes())
                    .with_context(|| format!("writing {}", path.display()))?;
            }
            if let (Some(inside), Some(about)) = (inside, about_zero)
                && inside < HOLDS
                && about >= HOLDS
            {
                eprintln!(
                    "rtecctl: {}: {response}: what is left is {zero:+.3} µm all along, the run's own zero (homing, the gauge's set-up) or a \
                     lost count: the interval is of the shape, and holds {:.1} % about it",
                    path.display(),
                    100.0 * about
                );
            }
            if after >= before && before > 0.0 {
                worse.push(format!("{}: {response}", path.display()));
                if let Some(why) = why_worse(column, predicted) {
                    eprintln!("warning: {}: {response}: {why}", path.display());
                }
            }
            found.push(json!({
                "record": path, "response": response, "rms": after, "rms_without_model": before,
                "sd": rms(&mut column.data.iter().map(|v| v - mean)), "mean_left": zero,
                "largest_left": left.iter().map(|v| v.abs()).fold(0.0, f64::max), "mean_half_width_um": width,
                "coverage": inside, "coverage_about_mean": about_zero, "fitted_on_this_record": seen,
            }));
        }
        for (effect, role) in &prediction.taken_as_zero {
            eprintln!("warning: {}: no {role}, taken as zero for {effect}", path.display());
        }
        for warning in machine.out_of_range(record) {
            eprintln!("warning: {}: {warning}", path.display());
        }
    }
    for warning in machine.doubts(date::today()) {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    if args.json {
        let mut document = json!({ "responses": found, "no_better": worse });
        plausible::enter(&mut document, &doubts);
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        for v in &found {
            print_judged(v);
        }
    }
    if worse.is_empty() {
        return Ok(());
    }
    Err(Outcome::No(format!("no better than without the model: {}", worse.join(", "))).into())
}

/// What a prediction that helps nothing looks like.
fn why_worse(measured: &Column, predicted: &[f64]) -> Option<&'static str> {
    let square = |v: &[f64]| v.iter().map(|p| p * p).sum::<f64>();
    let both = square(predicted);
    if both == 0.0 {
        return Some("the model has no effect on it");
    }
    let along = measured.data.iter().zip(predicted).map(|(m, p)| m * p).sum::<f64>();
    let (share, alike) = (along / both, along / (both * square(&measured.data)).sqrt());
    (alike < -0.8 && (-2.0..-0.5).contains(&share))
        .then_some("what is measured is the prediction with the other sign; error = actual minus nominal")
}

/// One response, in a line.
fn print_judged(v: &Value) {
    let f = |key: &str| v[key].as_f64().map_or("-".to_owned(), |v| format!("{v:.3}"));
    let interval = if v["coverage"].is_null() {
        "the model states no interval".to_owned()
    } else {
        let percent = |key: &str| 100.0 * v[key].as_f64().unwrap_or_default();
        format!(
            "95 % interval ±{} (mean): {:.1} % of the rows within it, {:.1} % about the mean left",
            f("mean_half_width_um"),
            percent("coverage"),
            percent("coverage_about_mean")
        )
    };
    let unseen =
        if v["fitted_on_this_record"] == true { "; NOT unseen: the model was fitted on it" } else { "" };
    println!(
        "{} {}: {} left of {} (SD {}), mean {}, largest {}; {interval}{unseen}",
        v["record"].as_str().unwrap_or_default(),
        v["response"].as_str().unwrap_or_default(),
        f("rms"),
        f("rms_without_model"),
        f("sd"),
        f("mean_left"),
        f("largest_left"),
    );
}

pub(crate) fn rehearse(args: &RehearseArgs) -> anyhow::Result<()> {
    let new = Machine::read(&args.machine)?;
    let present = match &args.against {
        Some(path) => Machine::read(path)?,
        None => Machine::ideal("no model"),
    };
    let shift = rtec_measure::record::read_log(&args.record)?;
    let options = match &args.config {
        Some(file) => options(&Config::load(file)?),
        None => rehearse::Options::default(),
    };
    for effect in new.effects() {
        for role in effect.description().needs.iter().map(|need| need.role(effect.axes())) {
            if matches!(role, Role::Position(_)) && shift.column(&role).is_none() {
                eprintln!(
                    "warning: {}: no {role}, taken as zero for {}",
                    args.record.display(),
                    effect.name()
                );
            }
        }
    }
    for warning in new.doubts(date::today()) {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    let found = rehearse::rehearse(&present, &new, &shift, &options)?;
    // Where the shift has no times, its rows' numbers stand for seconds, and are called what they are.
    let timed = shift.column(&Role::Time).is_some();
    if let Some(path) = &args.plot {
        for axis in &found.axes {
            let path = path.with_extension(format!("{}.svg", axis.axis));
            let svg = chart(axis, timed).svg(900, 480)?;
            rtec_files::write::whole(&path, svg.as_bytes())
                .with_context(|| format!("writing {}", path.display()))?;
        }
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&found)?);
        return Ok(());
    }
    for a in &found.axes {
        println!(
            "{}: largest correction {:.2} -> {:.2} µm; largest change {:+.2} µm at {}, RMS {:.2} µm; fastest {:.3} µm/{}",
            a.axis,
            a.largest_um[0],
            a.largest_um[1],
            a.change_um,
            if timed { format!("{:.0} s", a.change_at_s) } else { format!("row {:.0}", a.change_at_s + 1.0) },
            a.change_rms_um,
            a.fastest_um_per_s,
            if timed { "s" } else { "row" }
        );
    }
    for a in found.axes.iter().filter(|a| a.held > 0.0) {
        println!(
            "{}: would not follow the new model for {:.1} % of the shift: how warm the machine is inside is not known yet",
            a.axis,
            100.0 * a.held
        );
    }
    for (effect, share) in &found.outside {
        println!("{effect}: outside the range it was fitted on for {:.1} % of the shift", 100.0 * share);
    }
    Ok(())
}

/// What the corrections of a configured machine go through.
fn options(config: &Config) -> rehearse::Options {
    rehearse::Options {
        axes: config.axes.iter().map(ConfiguredAxis::law).collect(),
        ramp_um_s: config.model.ramp_um_s,
        lead_s: config.model.lead_ms * 1e-3,
    }
}

/// The present and the new correction of an axis over time.
fn chart(axis: &AxisChange, timed: bool) -> Chart {
    let line = |name: &str, k: usize| {
        let um = |counts: i64| counts as f64 * axis.count_um;
        let points =
            axis.rows.iter().map(|(t_s, totals)| (if timed { t_s / 60.0 } else { t_s + 1.0 }, um(totals[k])));
        Series::new(name, Style::Line, points.collect())
    };
    Chart::new(
        &format!("Correction of axis {}", axis.axis),
        if timed { "time (min)" } else { "row" },
        "correction (µm)",
    )
    .with(line("present model", 0))
    .with(line("new model", 1))
}
