//! `rtecctl part program`: the NC probing program from the path and a template.

use super::linuxcnc_download::DownloadArgs;
use super::points::positive;
use super::{usage, write_all};
use crate::prelude::*;
use rtec_files::cli_option_parsers::one_of;
use rtec_part::length_unit::LengthUnit;
use rtec_part::probe_path::{PathPointRole, read_pathfin};
use rtec_part::probing_program::{
    BUILT_IN, DialectWithTemplate, PARAMETERS, ProbingProgramInputs, VariableValues, date_time,
};
use std::time::{SystemTime, UNIX_EPOCH};

/// Write the NC probing program
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The probe's path
    #[arg(long, required_unless_present = "parameters")]
    path: Option<PathBuf>,
    /// Unit of the path file
    #[arg(long, value_parser = one_of(&LengthUnit::ALL, &[]), default_value = "mm")]
    path_units: LengthUnit,
    /// Unit of the program; by default that of the path
    #[arg(long, value_parser = one_of(&LengthUnit::ALL, &[]))]
    units: Option<LengthUnit>,
    /// Controller: report, linuxcnc or fanuc
    #[arg(long, default_value = "report")]
    dialect: String,
    /// A controller of your own, as the built-in dialect.toml files
    #[arg(long, requires = "template", conflicts_with = "dialect")]
    dialect_file: Option<PathBuf>,
    /// A template of your own instead of the dialect's
    #[arg(long)]
    template: Option<PathBuf>,
    /// Program parameters as TOML, `name = value`
    #[arg(long)]
    params: Option<PathBuf>,
    /// One parameter, over the file's
    #[arg(long, value_name = "NAME=VALUE")]
    set: Vec<String>,
    /// Probing feed, in mm/min; the parameter `feed` is in the program's unit
    #[arg(long, default_value_t = 2500.0)]
    feed_mm_min: f64,
    /// Comments in the program
    #[arg(long, value_enum, default_value_t = CommentLevel::Full)]
    comments: CommentLevel,
    /// Date and time as the program shows them; by default now, or `SOURCE_DATE_EPOCH`
    #[arg(long)]
    date: Option<String>,
    /// List the program parameters and end
    #[arg(long)]
    parameters: bool,
    /// Folder for the program
    #[arg(long, default_value = ".")]
    out: PathBuf,
    #[command(flatten)]
    download: DownloadArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum CommentLevel {
    /// Every move explained
    Full,
    /// Only the header's notes: a smaller file
    Minimal,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let Some(path) = args.path.as_deref().filter(|_| !args.parameters) else {
        for p in PARAMETERS {
            let default = format!("'{}'", p.default);
            println!("${:<3} {:<16} {default:<12} {}", p.number, p.name, p.meaning);
        }
        return Ok(());
    };
    let path_unit = args.path_units;
    let unit = args.units.unwrap_or(path_unit);
    let records = read_pathfin(path, path_unit)?;
    let mut controller = match (&args.dialect_file, DialectWithTemplate::built_in(&args.dialect)) {
        (Some(dialect), _) => {
            DialectWithTemplate::read(dialect, args.template.as_deref().unwrap_or(dialect))?
        }
        (None, Some(built_in)) => built_in?,
        (None, None) => {
            let expected = format!("one of {}", list(BUILT_IN.iter().map(|b| b.0)));
            return Err(usage("--dialect", args.dialect.clone(), expected));
        }
    };
    if let Some(template) = &args.template {
        controller.template = rtec_files::text_file::read(template)?;
    }
    let mut parameters = VariableValues::in_unit(unit);
    let feed = positive("--feed-mm-min", args.feed_mm_min)? / unit.0;
    let mut set = vec![("feed".to_owned(), format!("{}", (feed * 1e4).round() / 1e4))];
    for pair in &args.set {
        let (name, value) = pair.split_once('=').ok_or_else(|| usage("--set", pair.clone(), "NAME=VALUE"))?;
        set.push((name.trim().to_owned(), value.trim().to_owned()));
    }
    // The feed of the command line is a default; a file or --set overrides it.
    for (k, (name, value)) in set.iter().enumerate() {
        parameters.set(name, value).map_err(|(found, expected)| usage("--set", found, expected))?;
        if let (0, Some(file)) = (k, &args.params) {
            parameters.read(file)?;
        }
    }
    let unset = list(parameters.unset(&controller.template));
    if !unset.is_empty() {
        eprintln!("rtecctl: machine positions left at 0: {unset}; set them before the program runs");
    }
    let made = args.date.clone().map_or_else(|| Ok(date_time(now_s()?)), anyhow::Ok)?;
    let (controller, parameters, records) = (&controller, &parameters, &records);
    let (comments, made) = (args.comments == CommentLevel::Full, made.as_str());
    let job = ProbingProgramInputs { controller, parameters, records, unit, comments, made };
    let text = job.text(args.template.as_deref().unwrap_or(Path::new("template.prb")))?;
    let name = parameters.file_name();
    write_all(&args.out, &[(&name, &text)])?;
    args.download.bring(&name, &text, &controller.dialect.name)?;
    let points = records.iter().filter(|r| matches!(r.role, PathPointRole::Touch(_))).count();
    let lines = text.lines().count();
    let document = serde_json::json!({"file": args.out.join(&name), "dialect": controller.dialect.name,
        "points": points, "lines": lines, "bytes": text.len()});
    answer(args.json, &document, || {
        let shown: Vec<&str> = text.lines().take(20).collect();
        format!("{}\n… {lines} lines, {points} points\n", shown.join("\n"))
    })
}

fn now_s() -> anyhow::Result<u64> {
    match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(text) => text.parse().map_err(|_| usage("SOURCE_DATE_EPOCH", text, "seconds since 1970")),
        Err(_) => Ok(SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs()),
    }
}
