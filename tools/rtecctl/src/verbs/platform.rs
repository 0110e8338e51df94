//! `rtecctl platform`: what this kernel and machine can do for a real-time thread, and what to change.

use anyhow::Context;
use rtec_rt::setup::{Report, System, Wanted, apply};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// What this kernel and machine can do for the real-time thread, and what to change
///
/// Every setting is tried on a thread of this command's own, read back from the kernel, and gone when it ends.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The CPU for the real-time thread [default: the first isolated one, else the last one online]
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
    /// The `SCHED_FIFO` priority to ask for
    #[arg(long, value_name = "P", default_value_t = 80, value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: u8,
    /// Look at a copy of another machine's /proc, /sys and /dev in DIR; nothing is tried then
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    can_arm: bool,
    #[serde(flatten)]
    report: &'a Report,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let system = args.root.as_deref().map_or_else(System::live, System::at);
    let cpu = args.cpu.unwrap_or_else(|| system.default_cpu());
    let report = if args.root.is_some() {
        system.inspect(cpu, args.priority)
    } else {
        let wanted = Wanted { cpu, priority: args.priority };
        std::thread::Builder::new()
            .spawn(move || apply(&system, wanted).1)
            .context("starting a thread to try the settings on")?
            .join()
            .map_err(|_| anyhow::anyhow!("the thread that tried the settings panicked"))?
    };
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&Document { can_arm: report.can_arm(), report: &report })?
        );
    } else {
        print!("{}", text(&report));
    }
    Ok(())
}

fn text(report: &Report) -> String {
    let mut out = String::new();
    let mut line = |text: std::fmt::Arguments| {
        let _ = out.write_fmt(text); // a String takes everything
        out.truncate(out.trim_end_matches(' ').len());
        out.push('\n');
    };
    line(format_args!("kernel {}, CPU {} for the real-time thread", report.kernel, report.cpu));
    if let Some(emulator) = &report.emulated {
        line(format_args!("emulated by {emulator}: no time measured here is evidence for any machine"));
    }
    line(format_args!(""));
    line(format_args!("      {:<20}  {:<26}  found", "setting", "wanted"));
    for f in &report.findings {
        let mark = match (f.ok, f.needed_to_arm) {
            (true, _) => "ok",
            (false, true) => "STOP",
            (false, false) => "note",
        };
        let error = f.errno.as_ref().map(|e| format!(" ({e})")).unwrap_or_default();
        line(format_args!("{mark:<4}  {:<20}  {:<26}  {}{error}", f.name, f.wanted, f.got));
    }
    let to_change: Vec<_> = report.findings.iter().filter(|f| !f.ok).collect();
    if !to_change.is_empty() {
        line(format_args!("\nwhat to change"));
        for f in to_change {
            line(format_args!("  {:<20}  {}", f.name, f.remedy));
        }
    }
    if !report.kernel_command_line.is_empty() {
        line(format_args!("\nkernel command line\n  {}", report.kernel_command_line));
    }
    let stops: Vec<&str> = report.missing().map(|f| f.name).collect();
    if stops.is_empty() {
        line(format_args!(
            "\nA real card can be armed. `rtecctl selftest latency` measures what the notes cost."
        ));
    } else {
        line(format_args!("\nA real card will not be armed: {}.", stops.join(", ")));
    }
    out
}
