//! `rtecctl characterise evaluate`: figures of runs by their standard.
//! The output is text, JSON, plots or a page.

use crate::json_output::{answer, write};
use crate::verbs::input_notices;
use rtec_files::cli_option_parsers::one_of;
use rtec_measure::evaluation::{EvaluationRequest, Standard, evaluate_files};
use rtec_measure::iso230::TestConditions;
use std::path::PathBuf;

/// Evaluate runs as their standard defines it
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run records: one, or all circles of a machine, or all diagonals of a box
    #[arg(value_name = "NAME.run.toml", required = true)]
    records: Vec<PathBuf>,
    /// The evaluation; by the record's kind where it is left out
    #[arg(long, value_parser = one_of(&Standard::ALL, &[Standard::CIRCULAR]))]
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
    #[arg(long, value_name = "FILE.svg", value_parser = crate::verbs::drawing())]
    plot: Option<PathBuf>,
    /// Write a report with tables and plots as one page, ready to print
    #[arg(long, value_name = "FILE.html", value_parser = crate::verbs::output())]
    html: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let asked = EvaluationRequest {
        standard: args.standard,
        conditions: args.conditions.as_deref().map(TestConditions::read).transpose()?.unwrap_or_default(),
        one_way: args.one_way,
        fourth_powers: args.norm != 2,
    };
    let found = evaluate_files(&args.records, &asked, &mut input_notices::say)?;
    if let Some(path) = &args.plot {
        for (i, svg) in found.report.plots().enumerate() {
            let path = if i == 0 { path.clone() } else { path.with_extension(format!("{}.svg", i + 1)) };
            write(&path, svg)?;
        }
    }
    if let Some(path) = &args.html {
        write(path, &found.report.html())?;
    }
    answer(args.json, &found.document, || found.report.text())
}
