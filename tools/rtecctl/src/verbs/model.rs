//! `rtecctl model …`: reads, fits, judges and shows machine models.

mod chain;
mod export;
mod fit;
mod load;
mod predict;
mod show;
mod validate;

/// Work with machine models: choose sensors, fit, predict, judge, rehearse, load, show, compare, export
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// Take the model up again that was unloaded last, as it was read when it was loaded
    Again(crate::daemon::Daemon),
    Compare(show::CompareArgs),
    Export(export::Args),
    Fit(fit::FitArgs),
    FitChain(chain::Args),
    Load(load::LoadArgs),
    Predict(predict::Args),
    Rehearse(validate::RehearseArgs),
    SelectSensors(fit::SelectArgs),
    Show(show::ShowArgs),
    /// Run without a model: corrections go back in a ramp
    Unload(crate::daemon::Daemon),
    Validate(validate::ValidateArgs),
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.verb {
        Verb::Again(args) => load::again(args),
        Verb::Compare(args) => show::compare(args),
        Verb::Export(args) => export::run(args),
        Verb::Fit(args) => fit::run(args),
        Verb::FitChain(args) => chain::run(args),
        Verb::Load(args) => load::load(args),
        Verb::Predict(args) => predict::run(args),
        Verb::Rehearse(args) => validate::rehearse(args),
        Verb::SelectSensors(args) => fit::select(args),
        Verb::Show(args) => show::show(args),
        Verb::Unload(args) => load::unload(args),
        Verb::Validate(args) => validate::validate(args),
    }
}
