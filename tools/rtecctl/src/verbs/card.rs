//! `rtecctl card`: known cards, cards in this computer, and their lines.

mod watch;

use crate::json_output;
use crate::prelude::*;
use rtec_control::card_line_readings;
use rtec_control::card_opening::{self, CardAccess, CardOpenError, LocatedRegisters};
use rtec_control::card_profile_file::{self, SHIPPED};
use rtec_control::config::{CardConfig, Config, ConfigFindings, INSTALLED};
use rtec_control::single_process_lock::{self, LockError, LockGuard};
use rtec_driver::card_profile::{AddressSpace, CardProfile, IoBit, PciBarSpec, Register};
use rtec_driver::gpio;
use rtec_driver::pci;
use rtec_rt::link_messages::MAX_AXES;
use std::io::{BufRead, Write};

super::verbs_below! {
    /// Cards: those known, those in this machine, and the lines of one
    Args;
    List ListArgs => list;
    Show ShowArgs => show;
    Probe ProbeArgs => probe;
}

/// The card profiles that come with this program, and what is in this machine
#[derive(Debug, clap::Args)]
struct ListArgs {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A card profile: where its registers are, its lines, and the datasheet it comes from
#[derive(Debug, clap::Args)]
struct ShowArgs {
    /// Name of a profile, or a profile's file
    profile: String,
    /// Print its text, as a start for your own
    #[arg(long, conflicts_with = "json")]
    toml: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Read the lines of the card that a configuration names; nothing is written unless --drive says so
#[derive(Debug, clap::Args)]
#[allow(clippy::struct_excessive_bools)] // One per option.
struct ProbeArgs {
    /// The configuration
    #[arg(long, value_name = "FILE", default_value = "/etc/rtec/rtec.toml")]
    config: PathBuf,
    /// Switch each output on and off again. THE MTC MUST BE OFF: every inverter that is switched moves its axis
    #[arg(long)]
    drive: bool,
    /// The MTC is off: do not ask
    #[arg(long, requires = "drive")]
    mtc_is_off: bool,
    /// Show the inputs live: levels, edges, edges per second, and whether both edges of each line were seen
    #[arg(long, conflicts_with = "drive")]
    watch: bool,
    /// With --watch: time between two pictures
    #[arg(long, value_name = "TIME", default_value = "500ms", requires = "watch", value_parser = pause)]
    every: Duration,
    /// With --watch: end after this time; without it: until Ctrl-C
    #[arg(long = "for", value_name = "TIME", requires = "watch", value_parser = rtec_files::cli_option_parsers::duration)]
    during: Option<Duration>,
    /// Print one JSON document; with --watch at the end of --for
    #[arg(long)]
    json: bool,
}

fn pause(text: &str) -> Result<Duration, String> {
    let time = rtec_files::cli_option_parsers::duration(text)?;
    let range = Duration::from_millis(20)..=Duration::from_secs(3600);
    if range.contains(&time) { Ok(time) } else { Err("from 20ms to 1h".into()) }
}

fn probe(args: &ProbeArgs) -> anyhow::Result<()> {
    let config = load(&args.config)?;
    if args.watch {
        let ends = args.during.is_some() || !args.json;
        ensure!(ends, Bad, "--watch --json needs --for TIME: the document comes at its end");
        // A counter is latched to be read, and its flags are cleared, which the daemon would then miss.
        let counts =
            matches!(&config.card, CardConfig::Registers { profile, .. } if !profile.counters.is_empty());
        let _alone = counts.then(|| lock_out_daemon(&config)).transpose()?;
        return watch::watch(&config, args);
    }
    if !args.drive {
        return show_lines(&config, args.json);
    }
    let _alone = lock_out_daemon(&config)?;
    if !args.mtc_is_off {
        confirm("every output of this card is switched on and off again, one after the other")?;
    }
    drive_outputs(&config, args.json)
}

/// Loads the configuration.
/// If it is the installed one and does not exist, the error says what to name instead.
fn load(file: &Path) -> Result<Config, ConfigFindings> {
    Config::load(file).map_err(|mut findings| {
        if file == Path::new(INSTALLED) && !file.exists() {
            for finding in &mut findings.0 {
                finding.expected = format!("--config FILE, or {}", finding.expected);
            }
        }
        findings
    })
}

/// The backend for a profile's registers.
fn backend(profile: &CardProfile, name: &str) -> &'static str {
    let ports = profile.pci.is_some_and(|p| p.space == AddressSpace::Io) || name == "parallel-port";
    if ports { "port" } else { "mapped" }
}

/// Vendor and device of a PCI card, as `lspci` writes them.
fn hex((vendor, device): (u16, u16)) -> String {
    format!("{vendor:04x}:{device:04x}")
}

/// Largest number of axes that a profile's lines allow, by two counts.
/// The first is without lines of the machine, the second with read-back and feed hold.
fn axes_that_fit(profile: &CardProfile) -> [usize; 2] {
    let inputs = profile.lines.values().filter(|p| matches!(p, IoBit::Input(_))).count();
    let outputs = profile.lines.len() - inputs;
    let fit = |inputs: usize, outputs: usize| inputs.min(outputs).min(MAX_AXES);
    [fit(inputs / 2, outputs / 2), fit(inputs / 4, outputs.saturating_sub(1) / 2)]
}

fn list(args: &ListArgs) -> anyhow::Result<()> {
    let mut profiles = Vec::new();
    for (name, _) in SHIPPED {
        // Every name is from the list itself, so it is found.
        let Some(p) = card_profile_file::shipped(name) else { continue };
        let [axes, wired_back] = axes_that_fit(&p);
        profiles.push(json!({
            "profile": name, "backend": backend(&p, name), "name": p.name, "pci": p.pci.map(|p| hex(p.id)), "axes": axes,
            "axes_with_read_back": wired_back,
        }));
    }
    let chip = |(chip, label, lines)| json!({"chip": chip, "label": label, "lines": lines});
    let chips: Vec<_> = gpio::chips().into_iter().map(chip).collect();
    let card = |f: pci::PciFunction| {
        let is = |(name, _): &&(&str, &str)| card_profile_file::shipped(name)?.pci.map(|p| p.id == f.id);
        let (name, _) = SHIPPED.iter().find(|s| is(s) == Some(true))?;
        Some(json!({"address": f.address, "pci": hex(f.id), "profile": name}))
    };
    let cards: Vec<_> = pci::functions().into_iter().filter_map(card).collect();
    let devices = |prefix: &str| -> Vec<String> {
        let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
        let names = entries.filter_map(|e| e.file_name().into_string().ok());
        let digits = |rest: &str| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit());
        let named = names.filter(|n| n.strip_prefix(prefix).is_some_and(digits));
        let mut found: Vec<_> = named.map(|n| format!("/dev/{n}")).collect();
        found.sort();
        found
    };
    let (parports, uio) = (devices("parport"), devices("uio"));
    if args.json {
        let here = json!({"gpio": chips, "pci": cards, "parport": parports, "uio": uio});
        return say_pretty(&json!({"profiles": profiles, "here": here}));
    }
    let text = |value: &Value, key: &str| match &value[key] {
        Value::String(text) => text.clone(),
        Value::Null => "–".to_owned(),
        other => other.to_string(),
    };
    println!("profiles (rtecctl card show NAME):");
    for p in &profiles {
        let [profile, backend, pci, axes, wired_back, name] =
            ["profile", "backend", "pci", "axes", "axes_with_read_back", "name"].map(|key| text(p, key));
        println!("  {profile:<15} {backend:<7} {pci:<10} axes {axes} ({wired_back} with read-back)  {name}");
    }
    println!("in this machine:");
    for c in &chips {
        let axes = c["lines"].as_u64().map_or(0, |lines| (lines / 4).min(MAX_AXES as u64));
        let [chip, label, lines] = ["chip", "label", "lines"].map(|key| text(c, key));
        println!("  gpio     {chip} \"{label}\", {lines} lines, axes {axes}");
    }
    for c in &cards {
        println!("  pci      {} {}, profile {}", text(c, "address"), text(c, "pci"), text(c, "profile"));
    }
    for (kind, found) in [("parport", &parports), ("uio", &uio)] {
        for device in found {
            println!("  {kind:<8} {device}");
        }
    }
    if chips.is_empty() && cards.is_empty() && parports.is_empty() && uio.is_empty() {
        println!(
            "  nothing that this program knows, or nothing that you may open\n  \
             next: `sudo rtecctl card list` sees what only root may open; /etc/rtec/devices names what the daemon\n  \
             may open (group rtec-dev); `rtecctl card show FILE` checks a profile of your own"
        );
    }
    Ok(())
}

fn show(args: &ShowArgs) -> anyhow::Result<()> {
    let (name, path) = (args.profile.as_str(), Path::new(&args.profile));
    let shipped = SHIPPED.iter().find(|(shipped, _)| *shipped == name);
    let text = match shipped {
        Some((_, text)) => (*text).to_owned(),
        None => rtec_files::text_file::read(path)
            .map_err(|e| InputError { expected: card_profile_file::names_for(name), ..e })?,
    };
    if args.toml {
        print!("{text}");
        return Ok(());
    }
    let p = card_profile_file::parse(path, &text)?;
    let space = |space| if space == AddressSpace::Io { "I/O ports" } else { "memory" };
    if args.json {
        let register = |r: &Register| json!({"offset": r.offset, "bits": r.width.bits()});
        let registers = |list: &[Register]| list.iter().map(register).collect::<Vec<_>>();
        let lines = p.lines.iter().map(|(line, place)| {
            let (what, bit, low) = described(&p, *place);
            json!({"line": line, "direction": what, "bit": bit, "active_low": low})
        });
        let setup = p.setup.iter().map(|s| {
            json!({"offset": s.order.register.offset, "value": s.order.value, "after_reset": s.after_reset})
        });
        let counters = p.counters.iter().map(|c| {
            json!({"a": c.lines.0, "b": c.lines.1, "offset": c.count.offset, "bits": c.count.width.bits(),
                   "overflow": c.overflow.is_some(), "error": c.error.is_some()})
        });
        let pci = |p: PciBarSpec| json!({"id": hex(p.id), "bar": p.bar, "space": space(p.space)});
        return say_pretty(&json!({
            "name": p.name, "source": p.source, "backend": backend(&p, name), "pci": p.pci.map(pci),
            "inputs": registers(&p.inputs), "outputs": registers(&p.outputs), "lines": lines.collect::<Vec<_>>(),
            "setup": setup.collect::<Vec<_>>(), "counters": counters.collect::<Vec<_>>(),
        }));
    }
    println!("{}", p.name);
    println!("  source   {}", p.source);
    println!("  backend  {}", backend(&p, name));
    if let Some(PciBarSpec { id, bar, space: of }) = p.pci {
        println!("  pci      {}, BAR {bar}, {}", hex(id), space(of));
    }
    for (what, registers) in [("inputs", &p.inputs), ("outputs", &p.outputs)] {
        let at =
            json_output::list(registers.iter().map(|r| format!("{:#x} ({} bits)", r.offset, r.width.bits())));
        println!("  {what:<8} {at}");
    }
    for s in &p.setup {
        let (offset, value, reset) = (s.order.register.offset, s.order.value, s.after_reset);
        println!("  set up   {offset:#x} = {value:#x}, once, when it reads {reset:#x} after a reset");
    }
    for c in &p.counters {
        let ((a, b), offset) = (c.lines, c.count.offset);
        let flags = match (c.overflow, c.error) {
            (Some(_), Some(_)) => "overflow, error",
            (Some(_), None) => "overflow",
            (None, Some(_)) => "error",
            (None, None) => "none",
        };
        println!("  counter  of inputs {a} and {b} at {offset:#x}; flags: {flags}");
    }
    for (line, place) in &p.lines {
        let (what, bit, low) = described(&p, *place);
        println!("  line     {line:<10} {what} {bit}{}", if low { ", active low" } else { "" });
    }
    Ok(())
}

/// Direction, bit, and whether the line is active low.
fn described(profile: &CardProfile, place: IoBit) -> (&'static str, u8, bool) {
    let (what, bit, inverted) = match place {
        IoBit::Input(bit) => ("input", bit, profile.input_invert),
        IoBit::Output(bit) => ("output", bit, profile.output_invert),
    };
    (what, bit, inverted >> bit & 1 == 1)
}

/// Error for a card whose lines cannot be read or switched.
fn refused(config: &Config, error: CardOpenError) -> anyhow::Error {
    let CardOpenError::NoLines(_) = error else { return unreachable(error) };
    let text = format!(
        "backend \"{}\" has no lines outside the daemon: there is nothing to probe; `rtecctl status` shows its axes, \
         `rtecctl card list` what [card] of rtec.toml may name",
        config.card.backend()
    );
    CommandFailure::Bad(text).into()
}

pub(crate) fn unreachable(error: impl std::fmt::Display) -> anyhow::Error {
    CommandFailure::Unreachable(error.to_string()).into()
}

/// Keeps the daemon from starting while the value lives.
/// It would correct with the lines that are switched here.
pub(crate) fn lock_out_daemon(config: &Config) -> anyhow::Result<Vec<LockGuard>> {
    let stop = |e: LockError| {
        CommandFailure::No(format!("{e}: stop it first (systemctl stop rtecd); nothing was written"))
    };
    let mut held: Vec<_> =
        single_process_lock::keep_out(&config.control.socket).map_err(stop)?.into_iter().collect();
    if let CardConfig::Registers { place, profile } = &config.card
        && place.space() == AddressSpace::Memory
        && let LocatedRegisters::Map(file, _) =
            card_opening::find(place, profile, CardAccess::Drive).map_err(unreachable)?
    {
        held.push(single_process_lock::card(&file).map_err(|e| match e {
            LockError::Taken { .. } => stop(e),
            LockError::Io { .. } => CommandFailure::Unreachable(e.to_string()),
        })?);
    }
    Ok(held)
}

/// Asks a person to confirm that the MTC is off; `what` is switched.
pub(crate) fn confirm(what: &str) -> anyhow::Result<()> {
    const PHRASE: &str = "the MTC is off";
    eprintln!(
        "WARNING: {what}. An inverter that is switched\n\
         makes the MTC count, and its axis MOVES. Switch the MTC off first. Type: {PHRASE}"
    );
    std::io::stderr().flush()?;
    let mut answer = String::new();
    std::io::stdin().lock().read_line(&mut answer)?;
    ensure!(answer.trim() == PHRASE, No, "nothing was written");
    Ok(())
}

fn show_lines(config: &Config, as_json: bool) -> anyhow::Result<()> {
    let reading = card_line_readings::read(config).map_err(|e| refused(config, e))?;
    if as_json {
        return say_pretty(&reading);
    }
    if let Some(card) = &reading.card {
        println!("{card}");
    }
    for r in &reading.registers {
        let (width, colon) = (r.bits as usize / 4 + 2, if r.means.is_empty() { "" } else { ": " });
        println!("  register {:#04x} {:<8} {:#0width$x}{colon}{}", r.offset, r.purpose, r.value, r.means);
    }
    for l in &reading.lines {
        let found = match (l.bit, l.level) {
            (Some(bit), Some(level)) => format!("bit {bit:<3} {level}"),
            _ => l.kernel.clone().unwrap_or_default(),
        };
        println!("  {:<16} {:<6} {found}", l.line, l.direction);
    }
    Ok(())
}

fn drive_outputs(config: &Config, as_json: bool) -> anyhow::Result<()> {
    let mut outputs = Vec::new();
    card_line_readings::switch_outputs(config, |output| {
        if !as_json {
            let switched = if output.reads_back {
                "switched, read back, switched back"
            } else {
                "DOES NOT READ BACK what was written"
            };
            let follows = match &output.followed_by[..] {
                [] => "no input followed".to_owned(),
                inputs => format!("followed by {}", inputs.join(", ")),
            };
            println!("  {:<16} {switched}; {follows}", output.line);
        }
        outputs.push(output);
    })
    .map_err(|e| refused(config, e))?;
    if as_json {
        say_pretty(&json!({ "outputs": outputs }))?;
    }
    let wrong = outputs.iter().filter(|o| !o.reads_back).count();
    ensure!(wrong == 0, No, "{wrong} outputs do not read back what was written to them");
    Ok(())
}
