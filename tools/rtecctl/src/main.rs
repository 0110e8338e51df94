//! `rtecctl`: the command line of the real-time error corrector. One file per verb.

mod verbs;

use clap::{Parser, Subcommand};
use rtec_driver::input::InputError;
use std::process::ExitCode;

/// Real-time error corrector: correct a machine tool's repeatable errors in its position feedback.
#[derive(Debug, Parser)]
#[command(name = "rtecctl", version, arg_required_else_help = true, propagate_version = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Characterise(verbs::characterise::Args),
    Completions(verbs::completions::Args),
    Designs(verbs::designs::Args),
    Man(verbs::man::Args),
    Model(verbs::model::Args),
    Simulate(verbs::simulate::Args),
}

/// Why a command ends without success: the exit codes of the command contract that are not usage errors.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Outcome {
    /// Exit 1: the run finished and the answer is no.
    #[error("{0}")]
    #[allow(dead_code)]
    No(String),
    /// Exit 3: the daemon or the hardware could not be reached.
    #[error("{0}")]
    #[allow(dead_code)]
    Unreachable(String),
    /// Exit 4: a fault is latched.
    #[error("{0}")]
    #[allow(dead_code)]
    Fault(String),
}

fn main() -> ExitCode {
    let done = match Cli::parse().verb {
        Verb::Characterise(args) => verbs::characterise::run(&args),
        Verb::Completions(args) => verbs::completions::run(&args),
        Verb::Designs(args) => verbs::designs::run(&args),
        Verb::Man(args) => verbs::man::run(&args),
        Verb::Model(args) => verbs::model::run(&args),
        Verb::Simulate(args) => verbs::simulate::run(&args),
    };
    let Err(error) = done else { return ExitCode::SUCCESS };
    eprintln!("rtecctl: {error:#}");
    ExitCode::from(exit_code(&error))
}

/// Exit code of an error: 1 the answer is no, 2 bad input, 3 unreachable, 4 fault latched; anything else is 1.
fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<InputError>() {
            return 2;
        }
        if let Some(outcome) = cause.downcast_ref::<Outcome>() {
            return match outcome {
                Outcome::No(_) => 1,
                Outcome::Unreachable(_) => 3,
                Outcome::Fault(_) => 4,
            };
        }
    }
    1
}
