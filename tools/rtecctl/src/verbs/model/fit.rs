//! `rtecctl model fit` and `select-sensors`: choose sensors and fit growth.
//! The model is judged on data that it has not seen.

use crate::prelude::*;
use crate::uncertainty_rounding::with_bounds;
use crate::verbs::{input_notices, read_records};
use rtec_files::date;
use rtec_fit::thermal::{self, FittedEffect, ThermalFitReport};
use rtec_fit::workflow::{self, FitRequest, ThermalFitResult};
use rtec_measure::plot::Chart;
use rtec_model::machine::{FitNote, Machine};

/// What both verbs take
#[derive(Debug, clap::Args)]
#[allow(clippy::struct_excessive_bools)] // each is an option of its own
pub(crate) struct FitAndSelectArgs {
    /// Records to fit on
    #[arg(long = "record", value_name = "TRAIN.run.toml", required = true)]
    records: Vec<PathBuf>,
    /// Differences to choose from, as T0 (to the environment) or T8-T18; all sensors where it is left out
    #[arg(long, value_delimiter = ',', value_name = "T0,T8-T18")]
    sensors: Vec<String>,
    /// The sensor of the environment; the coldest on average where it is left out
    #[arg(long, value_name = "SENSOR")]
    environment: Option<String>,
    /// Blocks of the cross-validation in time
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u8).range(3..=50))]
    folds: u8,
    /// Offer no lags: the patent's equation 1 as it is
    #[arg(long)]
    no_lag: bool,
    /// Offer no squares
    #[arg(long)]
    no_square: bool,
    /// Offer no spindle speed: temperatures alone, as the patent's equation 1
    #[arg(long)]
    no_speed: bool,
    /// What is known already: its effects are kept, and only what they leave is fitted
    #[arg(long, value_name = "machine.toml")]
    base: Option<PathBuf>,
    /// Draw correlation and range of every sensor into this SVG file, as the patent's figure 17; with --effects what is
    /// left, one file per record and response
    #[arg(long, value_name = "FILE.svg", value_parser = crate::verbs::drawing())]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Choose sensors by correlation (CASC), without fitting a model
#[derive(Debug, clap::Args)]
pub(crate) struct SelectSensorsArgs {
    #[command(flatten)]
    common: FitAndSelectArgs,
}

/// Fit growth from temperatures: sensors chosen, blocks of time left out, hold-outs judged
#[derive(Debug, clap::Args)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    common: FitAndSelectArgs,
    /// Records that never influence the fit, only the last figures
    #[arg(long, value_name = "LATER.run.toml")]
    holdout: Vec<PathBuf>,
    /// Fit these effects alone, by name, beside what the base holds: scale.x, squareness.x.y, thermal_expansion.x:T3-T20
    #[arg(long, value_delimiter = ',', value_name = "NAME[:SENSOR[-SENSOR]]",
          conflicts_with_all = ["sensors", "environment", "no_lag", "no_square", "no_speed", "holdout"])]
    effects: Vec<String>,
    /// The machine model to write
    #[arg(long, value_name = "machine.toml", value_parser = crate::verbs::output())]
    out: PathBuf,
    /// The date the model carries; that of the latest record where it is left out, today (UTC) where none has one
    #[arg(long, value_name = "YYYY-MM-DD")]
    date: Option<String>,
    /// Days the model may be used for without being looked at again
    #[arg(long, default_value_t = 365)]
    valid_days: u16,
    /// Fit and write although a record looks as if a unit, a sign, a direction or a column were wrong
    #[arg(long)]
    despite_suspicions: bool,
}

impl FitAndSelectArgs {
    fn asked(&self) -> anyhow::Result<FitRequest> {
        Ok(FitRequest {
            sensors: self.sensors.clone(),
            options: thermal::ThermalFitOptions {
                environment: self.environment.clone(),
                folds: usize::from(self.folds),
                lag: !self.no_lag,
                square: !self.no_square,
                speed: !self.no_speed,
                base: self.base.as_deref().map(Machine::read).transpose()?,
                ..thermal::ThermalFitOptions::default()
            },
            ..FitRequest::default()
        })
    }

    fn fit(&self, holdout: &[PathBuf], asked: &FitRequest) -> anyhow::Result<ThermalFitResult> {
        let (train, holdout) = (read_records(&self.records)?, read_records(holdout)?);
        let done = workflow::fit(train, holdout, asked, &mut input_notices::say)?;
        if let Some(path) = &self.plot {
            draw(path, &done.reports.iter().map(ThermalFitReport::chart).collect::<Vec<_>>())?;
        }
        Ok(done)
    }
}

pub(crate) fn select(args: &SelectSensorsArgs) -> anyhow::Result<()> {
    let asked = FitRequest { date: Some(0), ..args.common.asked()? };
    let done = args.common.fit(&[], &asked)?;
    if args.common.json {
        return say_pretty(&done.selection()?);
    }
    for r in &done.reports {
        print_sensor_selection(r);
    }
    Ok(())
}

pub(crate) fn run(args: &FitArgs) -> anyhow::Result<()> {
    let day = |text: &String| {
        let wrong = || InputError::whole(Path::new("--date"), format!("`{text}`"), "a day as YYYY-MM-DD");
        date::parse(text).ok_or_else(wrong)
    };
    let day = args.date.as_ref().map(day).transpose()?;
    let despite_suspicions = args.despite_suspicions;
    let mut asked = FitRequest { date: day, despite_suspicions, ..args.common.asked()? };
    asked.options.valid_days = i64::from(args.valid_days);
    if !args.effects.is_empty() {
        return named(args, &asked);
    }
    let done = args.common.fit(&args.holdout, &asked)?;
    if !args.despite_suspicions {
        done.is_to_be_written(&args.common.records.iter().map(AsRef::as_ref).collect::<Vec<_>>())?;
    }
    done.machine.write(&args.out)?;
    if args.common.json {
        return say_pretty(&done.document()?);
    }
    for r in &done.reports {
        print_sensor_selection(r);
        print_effects(&r.effects);
        let list = |v: &[f64]| v.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(" ");
        let (rms, i) = (&r.rms_um, &r.interval95);
        println!("RMS (µm): train {:.3}, blocks {:.3} ({})", rms.train, rms.folds_rms, list(&rms.folds));
        if !rms.holdout.is_empty() {
            println!("          hold-out {}", list(&rms.holdout));
        }
        let (half_um, holds) = (i.half_width_um, 100.0 * i.coverage_folds);
        println!("95 % interval: ±{half_um:.3} µm; holds {holds:.1} % of the blocks");
        if let Some([later, earlier]) = i.coverage_halves.map(|both| both.map(|share| 100.0 * share)) {
            println!(
                "               {later:.1} % of the later half by a fit on the earlier one, {earlier:.1} % the other way round"
            );
        }
        for (c, w) in i.coverage_holdout.iter().zip(&i.mean_half_width_holdout_um) {
            println!("               and {:.1} % of a hold-out, ±{w:.3} µm wide there on average", 100.0 * c);
        }
        if let Some(d) = &r.dry_wet {
            println!("dry against wet: growth {:.2} and {:.2} µm", d.growth_dry_um, d.growth_wet_um);
            for (term, dry) in &d.dry {
                println!("  {term:34} dry {dry:10.4}  wet {:10.4}", d.wet.get(term).unwrap_or(&f64::NAN));
            }
            println!(
                "  wet rows: {:.3} µm left by the dry model, {:.3} µm by the wet one",
                d.dry_model_on_wet_rms_um, d.wet_model_on_wet_rms_um
            );
        }
        println!("simpler predictions on the same blocks (µm):");
        for (name, b) in &r.baselines {
            println!("  {name:24} {:.3}  {}", b.folds_rms, list(&b.holdout));
        }
    }
    Ok(())
}

/// Fits the effects that the user names, by least squares.
fn named(args: &FitArgs, asked: &FitRequest) -> anyhow::Result<()> {
    let done = workflow::fit_named(
        read_records(&args.common.records)?,
        &args.effects,
        asked,
        &mut input_notices::say,
    )?;
    let (machine, report) = (&done.machine, &done.report);
    if let Some(path) = &args.common.plot {
        draw(path, &done.charts(asked.options.base.as_ref())?)?;
    }
    machine.write(&args.out)?;
    if args.common.json {
        return say_pretty(&done.document()?);
    }
    print_effects(&report.effects);
    for (response, [before, after]) in &report.rms_um {
        let unit = FitNote::unit_of(response);
        println!("{response}: {before:.3} -> {after:.3} {unit} RMS about each record's own zero");
    }
    for z in &report.zeros {
        let unit = FitNote::unit_of(&z.response);
        println!("  {} {}: its own zero {:+.3} {unit}, no part of the model", z.record, z.response, z.um);
    }
    if !report.zeros.is_empty() {
        println!(
            "intervals are of the shape: another run's own zero (homing, the gauge's set-up) comes on top"
        );
    }
    Ok(())
}

fn print_effects(effects: &[FittedEffect]) {
    for e in effects {
        let of = [&e.sensor, &e.minus].into_iter().flatten().cloned().collect::<Vec<_>>().join("-");
        for (name, p) in &e.parameters {
            println!("  {:20} {of:10} {name:12} {}", e.name, with_bounds(p.value, p.low, p.high));
        }
    }
}

/// Writes the first chart to the file, each other one to a numbered file.
pub(crate) fn draw(path: &Path, charts: &[Chart]) -> anyhow::Result<()> {
    let numbers = (1..).map(|n| if n == 1 { String::new() } else { n.to_string() });
    draw_beside(path, numbers.zip(charts), [1000, 520])
}

/// Writes each chart to a file with its own word before the extension.
/// Without a word it is the file itself. Reports the files if they are others than the requested one.
pub(crate) fn draw_beside<'c>(
    path: &Path,
    charts: impl Iterator<Item = (String, &'c Chart)>,
    [width, height]: [u32; 2],
) -> anyhow::Result<()> {
    let mut drawn = Vec::new();
    for (word, chart) in charts {
        let path = if word.is_empty() { path.to_owned() } else { path.with_extension(format!("{word}.svg")) };
        let svg = chart.svg(width, height)?;
        crate::json_output::write(&path, &svg)?;
        drawn.push(path);
    }
    if drawn.iter().any(|d| d != path) {
        eprintln!("rtecctl: drawn: {}", list(drawn.iter().map(|d| d.display())));
    }
    Ok(())
}

fn print_sensor_selection(r: &ThermalFitReport) {
    println!("{}", r.response);
    if let Some(e) = &r.environment {
        println!("environment: {e} ({})", r.environment_by);
    }
    println!("  kept                  γ  γ lagged     lag s  range K     CV µm");
    for k in &r.kept {
        println!(
            "  {:14} {:8.4} {:9.4} {:9.0} {:8.2} {:9.3}",
            k.sensor, k.gamma, k.gamma_lagged, k.tau_s, k.range_k, k.cv_rms_um
        );
    }
    for d in &r.dropped {
        println!("  {:14} {:8.4} redundant: α {:.4} with {}", d.sensor, d.gamma, d.alpha, d.with);
    }
    for (i, round) in r.rounds.iter().enumerate() {
        println!("round {}: {:40} R {:.5}  CV {:.3} µm", i + 1, round.added, round.r, round.cv_rms_um);
    }
}
