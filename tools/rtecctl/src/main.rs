//! `rtecctl`: the command line of the real-time error corrector.
//!
//! | file | what |
//! |---|---|
//! | `verbs/` | one file per verb: its arguments, what it calls, what it prints |
//! | `help` | verbs by their users, examples, exit codes |
//! | `http` | a server for a few readers on this computer |
//! | `terminal` | where the output goes: colours, width, a reader that has gone |
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
macro_rules! eprintln {
    () => { $crate::tell("\n") };
    ($($what:tt)*) => { $crate::tell(&(format!($($what)*) + "\n")) };
}
macro_rules! eprint {
    ($($what:tt)*) => { $crate::tell(&format!($($what)*)) };
}

mod daemon;
mod figures;
mod help;
mod http;
#[cfg(test)]
mod reference;
mod terminal;
mod verbs;

use clap::{FromArgMatches as _, Parser, Subcommand};
use rtec_files::InputError;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::process::ExitCode;

/// Real-time error corrector: correct a machine tool's repeatable errors in its position feedback.
#[derive(Debug, Parser)]
#[command(name = "rtecctl", version, propagate_version = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    verb: Option<Verb>,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Demo(verbs::demo::Args),
    Bugreport(verbs::bugreport::Args),
    Card(verbs::card::Args),
    Characterise(verbs::characterise::Args),
    Commission(verbs::commission::Args),
    Completions(verbs::completions::Args),
    Config(verbs::config::Args),
    Designs(verbs::designs::Args),
    Man(verbs::man::Args),
    Ledger(verbs::ledger::Args),
    Metrics(verbs::metrics::Args),
    Status(verbs::status::Args),
    Get(verbs::get::Args),
    Home(verbs::home::Args),
    Enable(verbs::enable::Args),
    Example(verbs::example::Args),
    Explain(verbs::explain::Args),
    Disable(verbs::disable::Args),
    Shadow(verbs::shadow::Args),
    Correct(verbs::correct::Args),
    Probe(verbs::probe::Args),
    History(verbs::history::Args),
    Hold(verbs::hold::Args),
    Clear(verbs::clear::Args),
    Log(verbs::log::Args),
    Papers(verbs::papers::Args),
    Park(verbs::park::Args),
    Part(verbs::part::Args),
    Model(verbs::model::Args),
    Reconcile(verbs::reconcile::Args),
    Replay(verbs::replay::Args),
    Top(verbs::top::Args),
    Trace(verbs::trace::Args),
    Platform(verbs::platform::Args),
    Selftest(verbs::selftest::Args),
    Ship(verbs::ship::Args),
    Simulate(verbs::simulate::Args),
    Whoami(verbs::whoami::Args),
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

/// A value may be a negative number everywhere: what is out of range is said as that, not as an unknown option.
pub(crate) fn with_negative_values(command: clap::Command) -> clap::Command {
    let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
    let command = command.mut_args(|a| {
        match (a.get_action().takes_values(), a.get_value_delimiter()) {
            (false, _) => a,
            // A list of numbers is no number to the parser.
            (true, Some(_)) => a.allow_hyphen_values(true),
            (true, None) => a.allow_negative_numbers(true),
        }
    });
    names.into_iter().fold(command, |c, name| c.mut_subcommand(name, with_negative_values))
}

fn main() -> ExitCode {
    let asked = help::command().try_get_matches();
    let cli = match asked.and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            // Where standard error takes nothing there is nowhere to say so.
            let _ = error.print();
            let verb = std::env::args_os().nth(1).unwrap_or_default();
            tell(&help::next(&verb.to_string_lossy(), &error.render().to_string()));
            return ExitCode::from(2);
        }
        // Help and version are output as any other.
        Err(help) => {
            let text = help.render();
            let styled = terminal::colour();
            say(&if styled { text.ansi().to_string() } else { text.to_string() });
            return ExitCode::SUCCESS;
        }
    };
    let Some(verb) = cli.verb else {
        say(&help::begin());
        return ExitCode::SUCCESS;
    };
    let done = match verb {
        Verb::Demo(args) => verbs::demo::run(&args),
        Verb::Bugreport(args) => verbs::bugreport::run(&args),
        Verb::Card(args) => verbs::card::run(&args),
        Verb::Characterise(args) => verbs::characterise::run(&args),
        Verb::Commission(args) => verbs::commission::run(&args),
        Verb::Completions(args) => verbs::completions::run(&args),
        Verb::Config(args) => verbs::config::run(&args),
        Verb::Designs(args) => verbs::designs::run(&args),
        Verb::Man(args) => verbs::man::run(&args),
        Verb::Ledger(args) => verbs::ledger::run(&args),
        Verb::Metrics(args) => verbs::metrics::run(&args),
        Verb::Status(args) => verbs::status::run(&args),
        Verb::Get(args) => verbs::get::run(&args),
        Verb::Home(args) => verbs::home::run(&args),
        Verb::Enable(args) => verbs::enable::run(&args),
        Verb::Example(args) => verbs::example::run(&args),
        Verb::Explain(args) => verbs::explain::run(&args),
        Verb::Disable(args) => verbs::disable::run(&args),
        Verb::Shadow(args) => verbs::shadow::run(&args),
        Verb::Correct(args) => verbs::correct::run(&args),
        Verb::Probe(args) => verbs::probe::run(&args),
        Verb::History(args) => verbs::history::run(&args),
        Verb::Hold(args) => verbs::hold::run(&args),
        Verb::Clear(args) => verbs::clear::run(&args),
        Verb::Log(args) => verbs::log::run(&args),
        Verb::Papers(args) => verbs::papers::run(&args),
        Verb::Park(args) => verbs::park::run(&args),
        Verb::Part(args) => verbs::part::run(&args),
        Verb::Model(args) => verbs::model::run(&args),
        Verb::Reconcile(args) => verbs::reconcile::run(&args),
        Verb::Replay(args) => verbs::replay::run(&args),
        Verb::Top(args) => verbs::top::run(&args),
        Verb::Trace(args) => verbs::trace::run(&args),
        Verb::Platform(args) => verbs::platform::run(&args),
        Verb::Selftest(args) => verbs::selftest::run(&args),
        Verb::Ship(args) => verbs::ship::run(&args),
        Verb::Simulate(args) => verbs::simulate::run(&args),
        Verb::Whoami(args) => verbs::whoami::run(&args),
    };
    let Err(error) = done else { return ExitCode::SUCCESS };
    let colour = std::io::stderr().is_terminal() && terminal::colours_are_wanted();
    let text = rtec_files::words::whole(error.as_ref());
    eprintln!("{} {text}", terminal::toned("rtecctl:", terminal::Tone::Wrong, colour));
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

/// Prints to standard error. Where that takes nothing there is nowhere to say so.
pub(crate) fn tell(text: &str) {
    let mut out = std::io::stderr().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
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
    test_needs::golden(
        &std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name),
        text,
    );
}

#[cfg(test)]
mod tests {
    use crate::help::command;
    use clap::error::ErrorKind;

    /// Every option of every command, given a negative number: it may be refused, but as a value.
    #[test]
    fn a_negative_number_is_a_value_everywhere() {
        let mut tried = 0;
        for_all(&command(), &mut Vec::new(), &mut |path, arg| {
            let option = match (arg.get_long(), arg.get_short()) {
                (Some(long), _) => format!("--{long}"),
                (None, Some(short)) => format!("-{short}"),
                (None, None) => return,
            };
            for value in ["-1.5", "-2"].into_iter().chain(arg.get_value_delimiter().map(|_| "-1.5,-2")) {
                let mut words = vec!["rtecctl".to_owned()];
                words.extend(path.iter().cloned());
                words.extend([option.clone(), value.to_owned()]);
                let said = command().try_get_matches_from(&words);
                tried += 1;
                if let Err(e) = said {
                    assert_ne!(e.kind(), ErrorKind::UnknownArgument, "{words:?}: {e}");
                }
            }
        });
        assert!(tried > 200, "{tried}");
    }

    fn for_all(c: &clap::Command, path: &mut Vec<String>, each: &mut dyn FnMut(&[String], &clap::Arg)) {
        for arg in c.get_arguments().filter(|a| a.get_action().takes_values()) {
            each(path, arg);
        }
        for sub in c.get_subcommands() {
            path.push(sub.get_name().to_owned());
            for_all(sub, path, each);
            path.pop();
        }
    }
}
