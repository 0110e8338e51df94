//! `rtecctl model …`: the machine model, read, fitted, judged and shown.

mod fit;
mod predict;

/// Work with machine models: predict runs, choose sensors, fit growth
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Fit(fit::FitArgs),
    Predict(predict::Args),
    SelectSensors(fit::SelectArgs),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::Fit(args) => fit::run(args),
        Verb::Predict(args) => predict::run(args),
        Verb::SelectSensors(args) => fit::select(args),
    }
}
