//! `rtecctl`: the command line of the real-time error corrector.
//!
//! | file | what |
//! |---|---|
//! | `verbs/` | one file per verb: its arguments, what it calls, what it prints |
//! | `help` | verbs by their users, examples, exit codes |
//! | `prelude` | names that nearly every verb uses |
//! | `http_server` | a server for a few readers on this computer |
//! | `progress` | progress of a long computation |
//! | `terminal` | the output's colours and width, and a reader that has gone |
//! | `archive` | a tar file readable only by its user |
//! | `daemon_connection` | the connection to the daemon, and its answers as exit codes |
//!
//! These do not belong here: a formula, a file format, a decision. Verbs connect the crates below and print.

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

/// Ends a verb with a [`CommandFailure`] of this kind and text.
macro_rules! fail {
    ($kind:ident, $($what:tt)*) => { return Err($crate::CommandFailure::$kind(format!($($what)*)).into()) };
}
/// As `fail`, unless the condition holds.
macro_rules! ensure {
    ($holds:expr, $kind:ident, $($what:tt)*) => { if !$holds { fail!($kind, $($what)*) } };
}

mod archive;
mod daemon_connection;
mod full_screen;
mod help;
mod http_server;
mod json_output;
mod prelude;
mod progress;
mod terminal;
mod uncertainty_rounding;
mod verbs;

use clap::{Args as _, FromArgMatches as _, Parser, Subcommand};
use help::{ASKS, JUDGES, READS, SHOWS};
use rtec_files::InputError;
use std::ffi::OsString;
use std::io::{ErrorKind, IsTerminal as _, Write as _};
use std::process::ExitCode;

/// Real-time error corrector: correct a machine tool's repeatable errors in its position feedback.
#[derive(Debug, Parser)]
#[command(name = "rtecctl", version, propagate_version = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    verb: Option<Verb>,
}

// One line per verb: the variant, the file of `verbs` with its arguments and function, its role, an example, exit codes.
macro_rules! verbs {
    ($($verb:ident $file:ident $role:literal $example:literal $codes:expr;)*) => {
        #[derive(Debug, Subcommand)]
        enum Verb {
            $($verb(verbs::$file::Args),)*
        }

        impl Verb {
            /// The description of one verb, by its name.
            pub(crate) fn described(name: &str) -> Option<clap::Command> {
                match name {
                    $(stringify!($file) => Some(verbs::$file::Args::augment_args(clap::Command::new(stringify!($file)))),)*
                    _ => None,
                }
            }

            fn run(&self) -> anyhow::Result<()> {
                match self {
                    $(Self::$verb(args) => verbs::$file::run(args),)*
                }
            }
        }

        /// Verb, index of its role, example, exit codes.
        pub(crate) const VERBS: &[(&str, usize, &str, &str)] = &[$((stringify!($file), $role, $example, $codes)),*];
    };
}

/// Whether a verb computes and so shows its progress.
/// Others wait for a daemon, a machine or a person, and print as they go on.
fn computes(verb: &str) -> bool {
    let of_models = matches!(verb, "characterise" | "history" | "model" | "part" | "reconcile" | "ship");
    of_models || matches!(verb, "designs" | "example" | "replay" | "simulate" | "trace")
}

verbs! {
    Status status 0 "rtecctl status --watch" "0 shown; 2 bad usage; 3 no daemon; 4 a fault is latched";
    Top top 0 "rtecctl top" SHOWS;
    Home home 0 "rtecctl home x" ASKS;
    Enable enable 0 "rtecctl enable" ASKS;
    Disable disable 0 "rtecctl disable" ASKS;
    Shadow shadow 0 "rtecctl shadow" ASKS;
    Park park 0 "rtecctl park --to-zero" ASKS;
    Probe probe 0 "rtecctl probe on --captures 5" ASKS;
    Hold hold 0 "rtecctl hold on" ASKS;
    Explain explain 0 "rtecctl explain z" SHOWS;
    Whoami whoami 0 "rtecctl whoami" SHOWS;
    Platform platform 1 "rtecctl platform --config /etc/rtec/rtec.toml" "0 a real card can be armed; 1 it would not be; 2 bad usage";
    Selftest selftest 1 "rtecctl selftest latency --duration 60s" "0 pass; 1 fail; 2 bad usage; 3 no card";
    Card card 1 "rtecctl card list" "0 done; 2 bad usage; 3 the card cannot be reached";
    Config config 1 "rtecctl config check --quiet /etc/rtec/rtec.toml" READS;
    Commission commission 1 "rtecctl commission x" ASKS;
    Correct correct 1 "rtecctl correct x 12" ASKS;
    Clear clear 1 "rtecctl clear" ASKS;
    Get get 1 "rtecctl get axes.x.completed" "0 printed; 1 no such value now; 2 no such name; 3 no daemon";
    Metrics metrics 1 "rtecctl metrics --listen 127.0.0.1:9837" "0 written; 1 cannot listen; 2 bad usage; 3 no daemon";
    Ledger ledger 1 "rtecctl ledger export --out ledger --last 60s" "0 written; 1 replayed it gives other totals; 2 bad usage; 3 no daemon";
    Log log 1 "rtecctl log --verify" JUDGES;
    Ship ship 1 "rtecctl ship --spool /var/spool/rtec --to /mnt/shop --machine mill-7" "0 sent; 2 bad input or usage; 3 the store is not there: what was not sent waits";
    Bugreport bugreport 1 "rtecctl bugreport --out report.tar" "0 whole; 1 parts are missing; 2 bad usage; 3 no daemon";
    Backup backup 1 "rtecctl backup --out mill-7.tar" READS;
    Restore restore 1 "rtecctl restore mill-7.tar --dry-run" "0 written; 1 the daemon runs, or files are there and differ; 2 bad input or usage";
    Characterise characterise 2 "rtecctl characterise evaluate x.run.toml --standard iso230-2" READS;
    Model model 2 "rtecctl model show --machine machine.toml" "0 done; 1 refused; 2 bad input or usage; 3 no daemon";
    History history 2 "rtecctl history records --limits limits.toml --html history.html" "0 within limits; 1 beyond one; 2 bad input or usage";
    Reconcile reconcile 2 "rtecctl reconcile x.run.toml --model machine.toml --out found" READS;
    Part part 3 "rtecctl part run --seed 1" "0 done; 1 refused; 2 bad input or usage; 3 no daemon; 4 a fault is latched";
    Demo demo 4 "rtecctl demo --duration 10s" JUDGES;
    Example example 4 "rtecctl example lathe lathe" READS;
    Simulate simulate 4 "rtecctl simulate --list" READS;
    Replay replay 4 "rtecctl replay --trace x.csv --requests totals.csv" "0 done; 1 the ledger does not balance; 2 bad input; 4 a fault was latched";
    Trace trace 4 "rtecctl trace convert x.csv x.vcd" READS;
    Designs designs 4 "rtecctl designs --json" READS;
    Completions completions 4 "rtecctl completions bash" READS;
    Man man 4 "rtecctl man target/man" READS;
}

/// Reasons why a command ends without success.
/// They are the exit codes of the command contract, except usage errors.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) enum CommandFailure {
    /// Exit 1: the run finished and the answer is no.
    No(String),
    /// Exit 2: the request itself is wrong.
    Bad(String),
    /// Exit 3: the daemon or the hardware could not be reached.
    Unreachable(String),
    /// Exit 4: a fault is latched.
    Fault(String),
}

/// Allows negative numbers as values everywhere.
/// A value out of range is then reported as such, not as an unknown option.
pub(crate) fn with_negative_values(command: clap::Command) -> clap::Command {
    let names: Vec<String> = command.get_subcommands().map(|c| c.get_name().to_owned()).collect();
    let command = command.mut_args(|a| {
        match (a.get_action().takes_values(), a.get_value_delimiter()) {
            (false, _) => a,
            // clap does not take a list of numbers for a number.
            (true, Some(_)) => a.allow_hyphen_values(true),
            (true, None) => a.allow_negative_numbers(true),
        }
    });
    names.into_iter().fold(command, |c, name| c.mut_subcommand(name, with_negative_values))
}

/// Parses the command line.
///
/// Describing every verb takes longer than most verbs run. So only the named verb is described first. If it does not
/// accept the words, all verbs are described, and help and errors are those of the whole command line.
fn parse_command_line(words: &[OsString]) -> Result<clap::ArgMatches, clap::Error> {
    let named = words.get(1).and_then(|w| help::command_of(w.to_str()?));
    match named.map(|command| command.try_get_matches_from(words)) {
        Some(Ok(matches)) => Ok(matches),
        _ => help::command().try_get_matches_from(words),
    }
}

fn main() -> ExitCode {
    rtec_files::file_format_stamp::built_from(env!("RTEC_COMMIT"));
    let words: Vec<OsString> = std::env::args_os().collect();
    if let [_, version] = &words[..]
        && (version == "--version" || version == "-V")
    {
        println!("rtecctl {}", rtec_files::file_format_stamp::VERSION);
        return ExitCode::SUCCESS;
    }
    let cli = match parse_command_line(&words).and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let error = help::with_meant(error, &words);
            // If standard error cannot be written, there is nowhere to report it.
            let _ = error.print();
            tell(&help::next(&words, &error.render().to_string()));
            return ExitCode::from(2);
        }
        // Help and version are printed like any other output.
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
    rtec_files::atomic_write::spare_inputs();
    let name = words[1].to_string_lossy();
    let done = if computes(&name) { progress::shown(&name, || verb.run()) } else { verb.run() };
    let Err(error) = done else { return ExitCode::SUCCESS };
    let colour = std::io::stderr().is_terminal() && terminal::colours_are_wanted();
    let text = rtec_files::message_text::error_with_causes(error.as_ref());
    eprintln!("{} {text}", terminal::toned("rtecctl:", terminal::ColourMeaning::Wrong, colour));
    ExitCode::from(exit_code(&error))
}

/// Prints to standard output.
/// A reader that has gone away (`| head`) is not an error: the work goes on, and the exit code stays the
/// same. If standard output cannot be written for another reason, the command ends.
pub(crate) fn say(text: &str) {
    let line = progress::cleared();
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            drop(line);
            eprintln!("rtecctl: writing to standard output: {e}");
            std::process::exit(1);
        }
        _ => {}
    }
}

/// Prints to standard error; if that fails, there is nowhere to report it.
pub(crate) fn tell(text: &str) {
    let _line = progress::cleared();
    let mut out = std::io::stderr().lock();
    let _ = out.write_all(text.as_bytes()).and_then(|()| out.flush());
}

/// Exit code of an error.
/// 1: the answer is no; 2: bad input; 3: unreachable; 4: a fault is latched. Anything else is 1.
pub(crate) fn exit_code(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        let refused = cause.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref);
        if cause.is::<InputError>()
            || cause.is::<rtec_control::config::ConfigFindings>()
            || matches!(refused, Some(e) if e.is::<InputError>())
        {
            return 2;
        }
        if matches!(cause.downcast_ref(), Some(rtec_demo::DemoError::Fault(_))) {
            return 4;
        }
        if let Some(outcome) = cause.downcast_ref::<CommandFailure>() {
            return match outcome {
                CommandFailure::No(_) => 1,
                CommandFailure::Bad(_) => 2,
                CommandFailure::Unreachable(_) => 3,
                CommandFailure::Fault(_) => 4,
            };
        }
    }
    1
}

/// Compares a text with a golden file, which `RTEC_BLESS=1` rewrites.
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
    use clap::FromArgMatches as _;
    use clap::error::ErrorKind;
    use std::ffi::OsString;

    /// Gives every option of every command a negative number.
    /// It may be refused, but only as a value.
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

    /// A verb described alone parses its arguments as the whole command line does.
    #[test]
    fn a_verb_alone_is_understood_as_among_all() {
        let both = |line: &str| {
            let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
            let alone = crate::help::command_of(words[1].to_str().unwrap()).unwrap();
            let understood = |command: clap::Command| {
                let matches = command.try_get_matches_from(&words)?;
                crate::Cli::from_arg_matches(&matches).map(|cli| format!("{cli:?}"))
            };
            (understood(alone), understood(command()))
        };
        for (name, example) in crate::help::tests::examples() {
            let (alone, among) = both(example);
            assert!(name == "help" || alone.is_ok(), "{example}: {alone:?}");
            assert_eq!(alone.ok(), among.ok(), "{example}");
            assert!(both(&format!("rtecctl {name} --no-such-option")).0.is_err());
        }
        // Words that the verb does not accept are answered by the whole command line.
        for line in [
            "rtecctl status --help",
            "rtecctl help status",
            "rtecctl statsu",
            "rtecctl status --wacth",
            "rtecctl correct x",
        ] {
            let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
            let said = crate::parse_command_line(&words).unwrap_err().render().to_string();
            assert_eq!(said, command().try_get_matches_from(&words).unwrap_err().render().to_string());
        }
        let version =
            command().try_get_matches_from(["rtecctl", "--version"]).unwrap_err().render().to_string();
        assert_eq!(version, format!("rtecctl {}\n", rtec_files::file_format_stamp::VERSION));
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
