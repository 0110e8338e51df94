//! `rtecctl platform`: whether this computer suits a real-time thread.
//! It says what to change.

use crate::prelude::*;
use rtec_control::config::{CardConfig, Config, INSTALLED, RegisterPlace};
use rtec_driver::card_profile::AddressSpace;
use rtec_driver::gpio::{GpioCardConfig, chip_names};
use rtec_platform::device_access_check::{self, CardDevice};
use rtec_rt::realtime_setup::{RtSettings, SetupReport, SystemRoot, apply};
use serde::Serialize;
use std::collections::BTreeSet;

/// What this kernel and machine can do for the real-time thread, and what to change
///
/// Exit 1 where a real card would not be armed. Every setting is tried on a thread of this command's own, read back from the kernel, and gone when it ends.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The CPU for the real-time thread [default: the configuration's, else the first isolated one, else the last one online]
    #[arg(long, value_name = "N")]
    cpu: Option<usize>,
    /// The `SCHED_FIFO` priority to ask for [default: the configuration's]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u8).range(1..=99))]
    priority: Option<u8>,
    /// The configuration whose card is looked at [default: /etc/rtec/rtec.toml where it exists]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Look at a copy of another machine's /proc, /sys and /dev in DIR; nothing is tried then
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct PlatformReportJson<'a> {
    can_arm: bool,
    #[serde(flatten)]
    report: &'a SetupReport,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let system = args.root.as_deref().map_or_else(SystemRoot::live, SystemRoot::at);
    let config = match &args.config {
        Some(file) => Config::load(file)?,
        None if args.root.is_none() && Path::new(INSTALLED).exists() => Config::load(Path::new(INSTALLED))?,
        None => Config::embedded(),
    };
    let (devices, events) = devices(&config.card)?;
    let cpu = args.cpu.or(config.rt.cpu).unwrap_or_else(|| system.default_cpu());
    let priority = args.priority.unwrap_or(config.rt.priority);
    let mut report = if args.root.is_some() {
        system.inspect(cpu, priority)
    } else {
        let wanted = RtSettings { cpu, priority };
        let system = system.clone();
        std::thread::Builder::new()
            .spawn(move || apply(&system, wanted).1)
            .context("starting a thread to try the settings on")?
            .join()
            .map_err(|_| anyhow::anyhow!("the thread that tried the settings panicked"))?
    };
    report.findings.extend(device_access_check::card(&system, &devices, events, cpu));
    let document = PlatformReportJson { can_arm: report.can_arm(), report: &report };
    answer(args.json, &document, || text(&report))?;
    let stops = list(report.missing().map(|f| f.name));
    ensure!(report.can_arm(), No, "a real card would not be armed: {stops}");
    Ok(())
}

/// The devices that the card's backend opens, and whether it wakes the thread.
fn devices(card: &CardConfig) -> anyhow::Result<(Vec<CardDevice>, bool)> {
    Ok(match card {
        CardConfig::Mock | CardConfig::Replay { .. } => (Vec::new(), false),
        CardConfig::Gpio(setup) => (gpio_chips(setup)?, setup.events),
        CardConfig::Registers { place, .. } => {
            let device = match place {
                RegisterPlace::File(file) | RegisterPlace::Uio(file, _) | RegisterPlace::Parport(file) => {
                    CardDevice::of_file(&std::path::absolute(file)?)
                }
                RegisterPlace::Io(_) => CardDevice::Ports(None),
                RegisterPlace::Pci(id, _, AddressSpace::Io) => CardDevice::Ports(Some(id.clone())),
                RegisterPlace::Pci(id, bar, AddressSpace::Memory) => CardDevice::Bar(id.clone(), *bar),
            };
            (vec![device], false)
        }
    })
}

/// The chips of a configuration.
/// For labels and line names the chips themselves must be asked.
fn gpio_chips(setup: &GpioCardConfig) -> anyhow::Result<Vec<CardDevice>> {
    let lines = setup.inputs.iter().map(|i| &i.line).chain(setup.outputs.iter().map(|o| &o.line));
    let direct = |chip: &String| {
        let name = chip.strip_prefix("/dev/").unwrap_or(chip);
        let number = name.strip_prefix("gpiochip")?;
        number.parse::<u32>().ok().map(|_| name.to_owned())
    };
    let named: Option<BTreeSet<String>> = lines.map(|line| line.chip.as_ref().and_then(direct)).collect();
    let only = "only root may ask all chips for their labels and lines";
    let asked = || chip_names(setup).map_err(|e| CommandFailure::Unreachable(format!("{e}; {only}")));
    let names = named.map_or_else(asked, Ok)?;
    Ok(names.into_iter().map(CardDevice::Gpio).collect())
}

fn text(report: &SetupReport) -> String {
    let mut out = String::new();
    let mut line = |text: std::fmt::Arguments| {
        let _ = out.write_fmt(text); // writing to a String does not fail
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
    let by_service = ["rt_throttling", "fair_server", "governor"];
    let to_change: Vec<_> = report.findings.iter().filter(|f| !f.ok).collect();
    if !to_change.is_empty() {
        line(format_args!("\nwhat to change"));
        for f in to_change {
            line(format_args!("  {:<20}  {}", f.name, f.remedy));
        }
    }
    if report.findings.iter().any(|f| !f.ok && by_service.contains(&f.name)) {
        line(format_args!(
            "\n{} are set at each start of the service by\n  install -Dm 644 -t /etc/systemd/system/rtecd.service.d /usr/share/rtec/realtime.conf && systemctl daemon-reload",
            by_service.join(", ")
        ));
    }
    if !report.kernel_command_line.is_empty() {
        let lacks = match report.kernel_command_line_lacks.as_str() {
            "" => "nothing",
            words => words,
        };
        let uses = &report.kernel_command_line;
        line(format_args!("\nkernel command line\n  to use  {uses}\n  to add  {lacks}"));
    }
    match list(report.missing().map(|f| f.name)).as_str() {
        "" => line(format_args!(
            "\nA real card can be armed. `rtecctl selftest latency` measures what the notes cost."
        )),
        stops => line(format_args!("\nA real card will not be armed: {stops}.")),
    }
    out
}
