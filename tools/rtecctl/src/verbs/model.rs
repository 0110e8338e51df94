//! `rtecctl model …`: the machine model, read, fitted, judged and shown.

mod predict;

/// Work with machine models: predict a run
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Predict(predict::Args),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::Predict(args) => predict::run(args),
    }
}
