//! `rtecctl characterise …`: plan, record, import and evaluate the runs that a model is made from.

mod evaluate;
mod import;
mod plan;
pub(crate) mod record;

/// Plan, record, import and evaluate measurements of a machine
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    Evaluate(evaluate::Args),
    Import(import::Args),
    Plan(plan::Args),
    Record(record::Args),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::Evaluate(args) => evaluate::run(args),
        Verb::Import(args) => import::run(args),
        Verb::Plan(args) => plan::run(args),
        Verb::Record(args) => record::run(args),
    }
}
