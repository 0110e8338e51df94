//! `rtec-demo`: the demo of `rtecctl` as a program that is built quickly.

use rtec_demo::{DemoError, Options, run};
use std::io::Write as _;
use std::process::ExitCode;

fn main() -> ExitCode {
    // If standard error cannot be written, there is nowhere to report anything.
    let tell = |text: &str| drop(writeln!(std::io::stderr(), "rtec-demo: {text}"));
    if std::env::args_os().len() > 1 {
        tell("expected no arguments; `rtecctl demo` has options");
        return ExitCode::from(2);
    }
    let Err(error) = run(&Options::default()) else { return ExitCode::SUCCESS };
    tell(&rtec_files::message_text::error_with_causes(error.as_ref()));
    let latched = matches!(error.downcast_ref(), Some(DemoError::Fault(_)));
    ExitCode::from(if latched { 4 } else { 1 })
}
