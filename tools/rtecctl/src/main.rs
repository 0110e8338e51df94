//! `rtecctl`: the command line of the real-time error corrector.
//!
//! | file | what |
//! |---|---|
//! | `verbs/` | one file per verb: its arguments, what it calls, what it prints |
//! | `daemon` | the running daemon: where its socket is, its answers as exit codes |
//!
//! What must not live here: a formula, a file format, a decision: verbs connect the crates below and print.

// Before the modules, so that all of them print this way.
macro_rules! print {
    ($($what:tt)*) => { $crate::say(&format!($($what)*)) };
}
macro_rules! println {
    () => { $crate::say("\n") };
    ($($what:tt)*) => { $crate::say(&(format!($($what)*) + "\n")) };
}

mod daemon;
mod verbs;

use clap::{Parser, Subcommand};
use rtec_files::InputError;
use std::io::{ErrorKind, Write as _};
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
    Demo(verbs::demo::Args),
    Card(verbs::card::Args),
    Characterise(verbs::characterise::Args),
    Commission(verbs::commission::Args),
    Completions(verbs::completions::Args),
    Config(verbs::config::Args),
    Designs(verbs::designs::Args),
    Man(verbs::man::Args),
    Status(verbs::status::Args),
    Home(verbs::home::Args),
    Enable(verbs::enable::Args),
    Explain(verbs::explain::Args),
    Disable(verbs::disable::Args),
    Shadow(verbs::shadow::Args),
    Correct(verbs::correct::Args),
    Probe(verbs::probe::Args),
    Hold(verbs::hold::Args),
    Clear(verbs::clear::Args),
    Papers(verbs::papers::Args),
    Park(verbs::park::Args),
    Part(verbs::part::Args),
    Model(verbs::model::Args),
    Reconcile(verbs::reconcile::Args),
    Replay(verbs::replay::Args),
    Trace(verbs::trace::Args),
    Platform(verbs::platform::Args),
    Selftest(verbs::selftest::Args),
    Simulate(verbs::simulate::Args),
}

/// Why a command ends without success: the exit codes of the command contract that are not usage errors.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Outcome {
    /// Exit 1: the run finished and the answer is no.
    #[error("{0}")]
    No(String),
    /// Exit 2: the request itself is wrong.
    #[error("{0}")]
    Bad(String),
    /// Exit 3: the daemon or the hardware could not be reached.
    #[error("{0}")]
    Unreachable(String),
    /// Exit 4: a fault is latched.
    #[error("{0}")]
    Fault(String),
}

fn main() -> ExitCode {
    let done = match Cli::parse().verb {
        Verb::Demo(args) => verbs::demo::run(&args),
        Verb::Card(args) => verbs::card::run(&args),
        Verb::Characterise(args) => verbs::characterise::run(&args),
        Verb::Commission(args) => verbs::commission::run(&args),
        Verb::Completions(args) => verbs::completions::run(&args),
        Verb::Config(args) => verbs::config::run(&args),
        Verb::Designs(args) => verbs::designs::run(&args),
        Verb::Man(args) => verbs::man::run(&args),
        Verb::Status(args) => verbs::status::run(&args),
        Verb::Home(args) => verbs::home::run(&args),
        Verb::Enable(args) => verbs::enable::run(&args),
        Verb::Explain(args) => verbs::explain::run(&args),
        Verb::Disable(args) => verbs::disable::run(&args),
        Verb::Shadow(args) => verbs::shadow::run(&args),
        Verb::Correct(args) => verbs::correct::run(&args),
        Verb::Probe(args) => verbs::probe::run(&args),
        Verb::Hold(args) => verbs::hold::run(&args),
        Verb::Clear(args) => verbs::clear::run(&args),
        Verb::Papers(args) => verbs::papers::run(&args),
        Verb::Park(args) => verbs::park::run(&args),
        Verb::Part(args) => verbs::part::run(&args),
        Verb::Model(args) => verbs::model::run(&args),
        Verb::Reconcile(args) => verbs::reconcile::run(&args),
        Verb::Replay(args) => verbs::replay::run(&args),
        Verb::Trace(args) => verbs::trace::run(&args),
        Verb::Platform(args) => verbs::platform::run(&args),
        Verb::Selftest(args) => verbs::selftest::run(&args),
        Verb::Simulate(args) => verbs::simulate::run(&args),
    };
    let Err(error) = done else { return ExitCode::SUCCESS };
    eprintln!("rtecctl: {error:#}");
    ExitCode::from(exit_code(&error))
}

/// Prints to standard output. A reader that has gone away (`| head`) is no error: what is to be done goes on, and its exit
/// code is what it would have been. Standard output that takes nothing for another reason ends the command.
pub(crate) fn say(text: &str) {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            eprintln!("rtecctl: writing to standard output: {e}");
            std::process::exit(1);
        }
        _ => {}
    }
}

/// Exit code of an error: 1 the answer is no, 2 bad input, 3 unreachable, 4 fault latched; anything else is 1.
pub(crate) fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<InputError>() || cause.is::<rtec_control::config::ConfigFindings>() {
            return 2;
        }
        if let Some(outcome) = cause.downcast_ref::<Outcome>() {
            return match outcome {
                Outcome::No(_) => 1,
                Outcome::Bad(_) => 2,
                Outcome::Unreachable(_) => 3,
                Outcome::Fault(_) => 4,
            };
        }
    }
    1
}

/// Compares a text with a golden file of `tests/golden`; `RTEC_BLESS=1` writes it anew.
#[cfg(test)]
#[track_caller]
pub(crate) fn golden(name: &str, text: &str) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    if std::env::var_os("RTEC_BLESS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap_or(&path)).unwrap();
        std::fs::write(&path, text).unwrap();
    }
    assert_eq!(text, std::fs::read_to_string(&path).unwrap_or_default(), "{}", path.display());
}
