//! `rtecctl model validate` and `rehearse`: judge a model before it is loaded.
//! They use data that it has not seen, or a recorded shift.

use super::fit::{draw, draw_beside};
use crate::prelude::*;
use crate::verbs::{input_notices, read_records};
use rtec_control::config::{Config, ConfiguredAxis};
use rtec_correct::rehearse::{self, AxisCorrectionChange};
use rtec_files::date;
use rtec_fit::validate;
use rtec_measure::plausible;
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::machine::{FitNote, Machine};
use rtec_model::record::Role;

/// Test a model on records: what is left, how often its interval holds, where it is used outside its range
#[derive(Debug, clap::Args)]
pub(crate) struct ValidateArgs {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Records it has not seen
    #[arg(long = "record", value_name = "NAME.run.toml", required = true)]
    records: Vec<PathBuf>,
    /// Draw measured, predicted and the 95 % interval over time, one file per record and response
    #[arg(long, value_name = "FILE.svg", value_parser = crate::verbs::drawing())]
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
    /// Draw both corrections, one file per axis: FILE.x.svg, FILE.y.svg …
    #[arg(long, value_name = "FILE.svg", value_parser = crate::verbs::drawing())]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn validate(args: &ValidateArgs) -> anyhow::Result<()> {
    let machine = Machine::read(&args.machine)?;
    let records = read_records(&args.records)?;
    let found = validate::validate(&machine, &records, &mut input_notices::said)?;
    if let Some(path) = &args.plot {
        draw(path, &found.charts)?;
    }
    let judged = found.document["responses"].as_array().into_iter().flatten();
    answer(args.json, &found.document, || judged.map(judged_line).collect())?;
    let no_better = found.no_better.join(", ");
    ensure!(no_better.is_empty(), No, "no better than without the model: {no_better}");
    Ok(())
}

fn judged_line(v: &Value) -> String {
    let f = |key: &str| v[key].as_f64().map_or("-".to_owned(), |v| format!("{v:.3}"));
    let unit = FitNote::unit_of(v["response"].as_str().unwrap_or_default());
    let interval = if let Some(why) = v["no_interval"].as_str() {
        why.to_owned()
    } else {
        let width = f(if unit == "N" { "mean_half_width_N" } else { "mean_half_width_um" });
        let [within, about] =
            ["coverage", "coverage_about_mean"].map(|key| 100.0 * v[key].as_f64().unwrap_or_default());
        format!(
            "95 % interval ±{width} {unit} (mean): {within:.1} % of the rows within it, {about:.1} % about the mean left"
        )
    };
    let unseen =
        if v["fitted_on_this_record"] == true { "; NOT unseen: the model was fitted on it" } else { "" };
    let [record, response] = ["record", "response"].map(|key| v[key].as_str().unwrap_or_default());
    let [left, without, sd, mean, largest] =
        ["rms", "rms_without_model", "sd", "mean_left", "largest_left"].map(f);
    let rest = format!("(SD {sd}), mean {mean}, largest {largest}; {interval}{unseen}");
    format!("{record} {response}: {left} left of {without} {unit} {rest}\n")
}

pub(crate) fn rehearse(args: &RehearseArgs) -> anyhow::Result<()> {
    let new = Machine::read(&args.machine)?;
    let present = Machine::read_or_ideal(args.against.as_deref(), "no model")?;
    let shift = plausible::only_good(
        rtec_measure::run_record_files::read_log(&args.record)?,
        &mut input_notices::said,
    );
    let config = args.config.as_deref().map(Config::load).transpose()?;
    let options = config.as_ref().map(options).unwrap_or_default();
    for effect in new.effects() {
        for role in effect.description().needs.iter().map(|need| need.role(effect.axes())) {
            if matches!(role, Role::Position(_)) && shift.column(&role).is_none() {
                let (record, effect) = (args.record.display(), effect.name());
                eprintln!("warning: {record}: no {role}, taken as zero for {effect}");
            }
        }
    }
    for warning in new.doubts(date::today()) {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    for FitNote { response, half_width_um, .. } in new.fits() {
        eprintln!("rtecctl: {response}: 95 % within ±{half_width_um:.2} {}", FitNote::unit_of(response));
    }
    for warning in new.out_of_range(&shift) {
        eprintln!("warning: {}: {warning}", args.record.display());
    }
    let found = rehearse::rehearse(&present, &new, &shift, &options)?;
    // If the shift has no times, row numbers take their place and are labelled as rows.
    let timed = shift.column(&Role::Time).is_some();
    if let Some(path) = &args.plot {
        let charts: Vec<Chart> = found.axes.iter().map(|a| chart(a, timed)).collect();
        let names = found.axes.iter().map(|a| a.axis.clone());
        draw_beside(path, names.zip(&charts), [900, 480])?;
    }
    if args.json {
        return say_pretty(&found);
    }
    for AxisCorrectionChange {
        axis,
        largest_um,
        change_um,
        change_at_s: at,
        change_rms_um,
        fastest_um_per_s,
        ..
    } in &found.axes
    {
        let ([before, after], per) = (largest_um, if timed { "s" } else { "row" });
        let at = if timed { format!("{at:.0} s") } else { format!("row {:.0}", at + 1.0) };
        println!(
            "{axis}: largest correction {before:.2} -> {after:.2} µm; largest change {change_um:+.2} µm at {at}, RMS \
             {change_rms_um:.2} µm; fastest {fastest_um_per_s:.3} µm/{per}"
        );
    }
    for AxisCorrectionChange { axis, held, .. } in found.axes.iter().filter(|a| a.held > 0.0) {
        println!(
            "{axis}: would not follow the new model for {:.1} % of the shift: how warm the machine is inside is not known yet",
            100.0 * held
        );
    }
    Ok(())
}

/// Settings of the law for a configured machine.
fn options(config: &Config) -> rehearse::RehearsalOptions {
    rehearse::RehearsalOptions {
        axes: config.axes.iter().map(ConfiguredAxis::axis_setup).collect(),
        ramp_um_s: config.model.ramp_um_s,
        lead_s: config.model.lead_ms * 1e-3,
    }
}

/// The present and the new correction of an axis over time.
fn chart(axis: &AxisCorrectionChange, timed: bool) -> Chart {
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
