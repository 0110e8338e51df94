//! `[card]` and the lines of the machine and its axes.

use super::{RegisterPlace, backend_of, beside, keys};
use crate::card_line_names::{BIASES, CardLineName, DRIVES, gpio_line, line};
use crate::card_profile_file;
use rtec_driver::card::{AxisLines, MachineLines};
use rtec_driver::card_profile::{AddressSpace, CardProfile, IoBit, Width};
use rtec_driver::gpio::{
    self, GpioCardConfig, GpioError, GpioInputConfig, GpioLineId, GpioLineSettings, GpioOutputConfig,
};
use rtec_driver::pci::{self, PciFunctionSelector};
use rtec_files::nearest;
use rtec_files::toml_section_keys::{FileWithFindings, LocatedValue, TomlSection};
use rtec_rt::link_messages::MAX_AXES;
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

impl CardSection {
    /// Whether the lines lead out of this process.
    pub(super) fn is_real(&self) -> bool {
        matches!(self.kind, Some(CardBackend::Gpio | CardBackend::Registers(_)))
    }
}

/// Values of `[card]`; `None` fields were reported.
pub(super) struct CardSection {
    pub(super) kind: Option<CardBackend>,
    pub(super) place: Option<RegisterPlace>,
    pub(super) profile: Option<CardProfile>,
    pub(super) gpio: ParsedGpioLines,
    pub(super) lines: MachineLines,
    /// User of each line, by direction and bit.
    pub(super) taken: BTreeMap<(bool, u8), String>,
}

/// GPIO lines read so far, and the defaults for the others.
pub(super) struct ParsedGpioLines {
    pub(super) setup: GpioCardConfig,
    pub(super) default: GpioLineSettings,
    /// Lines are looked up on this computer.
    here: bool,
    /// Chips that were not found; each is reported once.
    absent: BTreeSet<Option<String>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CardBackend {
    Mock,
    Gpio,
    Registers(AddressSpace),
    Replay,
}

/// Reads `[card]`; `here` if this is the computer that it is meant for.
pub(super) fn read(source: &mut FileWithFindings<'_>, root: &mut TomlSection<'_>, here: bool) -> CardSection {
    let mut section = root.table(source, "card", "[card]").with(keys::CARD);
    let registers = [AddressSpace::Memory, AddressSpace::Io].map(CardBackend::Registers);
    let kinds = [CardBackend::Mock, CardBackend::Gpio, registers[0], registers[1], CardBackend::Replay];
    let kind = section.pick(source, "backend", &kinds);
    let mut card = CardSection {
        kind: kind.map(|k| k.value),
        place: None,
        profile: None,
        gpio: ParsedGpioLines {
            setup: GpioCardConfig { inputs: Vec::new(), outputs: Vec::new(), events: true },
            default: GpioLineSettings {
                chip: None,
                line: GpioLineId::Offset(0),
                active_low: false,
                bias: None,
                drive: None,
            },
            here,
            absent: BTreeSet::new(),
        },
        lines: MachineLines::standard(),
        taken: BTreeMap::new(),
    };
    match kind.map(|k| k.value) {
        Some(CardBackend::Registers(space)) => {
            read_registers(source, &mut section, &mut card, (space, here));
            card.lines = machine_lines(source, &mut section, &mut card);
            section.finish(source);
        }
        Some(CardBackend::Gpio) => {
            card.gpio.setup.events = section.pick(source, "mode", &[true, false]).is_none_or(|m| m.value);
            let default = &mut card.gpio.default;
            default.chip = section.text(source, "chip").map(|c| c.value.to_owned());
            default.bias = section.pick(source, "bias", &BIASES.map(|b| b.1)).map(|b| b.value);
            default.drive = section.pick(source, "drive", &DRIVES.map(|d| d.1)).map(|d| d.value);
            card.lines = machine_lines(source, &mut section, &mut card);
            section.finish(source);
        }
        // Without a backend it is not known which keys belong to it.
        None => {}
        Some(CardBackend::Mock | CardBackend::Replay) => section.finish(source),
    }
    card
}

/// Reads where the registers are, and the profile that gives them meaning.
fn read_registers(
    source: &mut FileWithFindings<'_>,
    section: &mut TomlSection<'_>,
    card: &mut CardSection,
    (space, here): (AddressSpace, bool),
) {
    let port = space == AddressSpace::Io;
    let named = section.text(source, "profile");
    let default = if port { "parallel-port" } else { "shared-memory" };
    card.profile = match named {
        None => card_profile_file::shipped(default),
        Some(at) => card_profile_file::shipped(at.value)
            .or_else(|| load_profile(source, &beside(source.file, at.value), at.value, at.offset)),
    };
    let pci_at = section.text(source, "pci");
    let pci = pci_at.and_then(|at| {
        let id = PciFunctionSelector::parse(at.value);
        if id.is_none() {
            let expected =
                "vendor:device as \"1af4:1110\", or an address as \"0000:00:04.0\": lspci -nD shows both";
            source.finding(at.offset, format!("pci = \"{}\"", at.value), expected);
        }
        id
    });
    let bar = section.whole(source, "bar");
    // The bus is searched for a card only if a key names the card or its profile.
    let place = card.profile.as_ref().filter(|_| named.is_some()).and_then(|p| p.pci);
    let bar_of = bar.map(|b| b.value as u8).or(place.map(|p| p.bar));
    // A wrong place is reported, so the absence of any place is not.
    let mut places = usize::from(section.has("pci"));
    let config = source.file;
    let path = |at: LocatedValue<&str>| beside(config, at.value);
    if port {
        let parport = section.text(source, "parport");
        let io = section.whole(source, "io");
        places += usize::from(section.has("parport")) + usize::from(section.has("io"));
        is_there(source, parport.filter(|_| here), path);
        let parallel = parport.map(|at| RegisterPlace::Parport(path(at)));
        card.place = parallel.or(io.map(|io| RegisterPlace::Io(io.value as u16)));
        if let (Some(at), Some(profile)) = (parport, &card.profile)
            && profile.registers().any(|r| r.offset > 2 || r.width != Width::Bits8)
        {
            let found = format!("profile \"{}\" at {}", profile.name, at.value);
            let expected =
                "the registers of a parallel port (data, status, control); io or pci for other cards";
            source.finding(at.offset, found, expected);
        }
    } else {
        let file = section.text(source, "file");
        let uio = section.text(source, "uio");
        is_there(source, file.filter(|_| here), path);
        if let Some(at) = uio {
            is_uio(source, at, &path(at), here);
        }
        let map = section.whole(source, "map");
        places += usize::from(section.has("file")) + usize::from(section.has("uio"));
        let uio_map = map.map_or(0, |m| m.value as u8);
        let file = file.map(|at| RegisterPlace::File(path(at)));
        card.place = file.or(uio.map(|at| RegisterPlace::Uio(path(at), uio_map)));
        if let (Some(at), None) = (map, uio) {
            source.finding(at.offset, "map without uio", "uio = \"/dev/uio0\" beside it");
        }
    }
    if let Some(place) = place.filter(|p| p.space != space) {
        let name = card.profile.as_ref().map_or("", |p| &p.name);
        let of = if place.space == AddressSpace::Io { "I/O ports" } else { "mapped registers" };
        let (found, backend) = (format!("profile \"{name}\" of {of}"), backend_of(place.space));
        source.finding(named.map_or(section.offset, |p| p.offset), found, format!("backend = \"{backend}\""));
    }
    let of_profile = place.map(|p| PciFunctionSelector::Card(p.id.0, p.id.1)).filter(|_| places == 0);
    if let Some(id) = pci.or(of_profile) {
        if here && let Err(error) = pci::find(&id) {
            let at = pci_at.or(named).map_or(section.offset, |at| at.offset);
            source.finding(
                at,
                error.to_string(),
                "a card on this computer's bus; for another computer: --elsewhere",
            );
        }
        match bar_of {
            Some(bar) => card.place = Some(RegisterPlace::Pci(id, bar, space)),
            None => section.missing(source, "bar"),
        }
    } else if places == 0 && card.profile.is_some() {
        let (key, meaning) = places_of(port);
        section.say_missing(source, key, meaning);
    }
    if places > 1 {
        let found =
            if port { "more than one of parport, io and pci" } else { "more than one of file, uio and pci" };
        source.finding(section.offset, found, "one place where the registers are");
    }
    let no_pci = pci_at.is_none() && (places > 0 || place.is_none());
    if let Some(at) = bar.filter(|_| no_pci) {
        source.finding(at.offset, "bar without pci", "pci = \"vendor:device\" beside it");
    }
}

/// The keys for the registers' place, one of which is required, and their meaning.
const fn places_of(port: bool) -> (&'static str, &'static str) {
    if port {
        ("parport, io or pci", "where the ports are: \"/dev/parport0\", 0x378, or a card's \"vendor:device\"")
    } else {
        ("file, uio or pci", "where the registers are: a path, \"/dev/uio0\", or a card's \"vendor:device\"")
    }
}

fn load_profile(
    source: &mut FileWithFindings<'_>,
    path: &Path,
    named: &str,
    offset: usize,
) -> Option<CardProfile> {
    let text = match rtec_files::text_file::read(path) {
        Ok(text) => text,
        Err(error) => {
            let found = format!("profile {}: {}", path.display(), error.found);
            source.finding(offset, found, card_profile_file::names_for(named));
            return None;
        }
    };
    source.keep(card_profile_file::parse(path, &text))
}

/// Reads the lines that belong to no axis.
fn machine_lines(
    source: &mut FileWithFindings<'_>,
    section: &mut TomlSection<'_>,
    card: &mut CardSection,
) -> MachineLines {
    let mut wire = |key, output| wire(source, section, card, key, output, (MAX_AXES as u8, "the machine"));
    MachineLines {
        probe: wire("probe", false),
        disable: wire("disable", false),
        mtc_ready: wire("mtc_ready", false),
        hold: wire("hold", true),
    }
}

/// Gives a GPIO line the next free bit.
fn wire_gpio(
    source: &mut FileWithFindings<'_>,
    section: &mut TomlSection<'_>,
    gpio: &mut ParsedGpioLines,
    key: &'static str,
    output: bool,
    (group, owner): (u8, &str),
) -> Option<u8> {
    let LocatedValue { value: line, offset } = gpio_line(section, source, key, &gpio.default)?;
    if line.chip.is_none() && matches!(line.line, GpioLineId::Offset(_)) {
        let expected = "a name, or a chip too: chip = \"gpiochip0\" in [card], or in the line's own table";
        source.finding(offset, format!("{key} = {} on no chip", line.line), expected);
        return None;
    }
    if gpio.here
        && !gpio.absent.contains(&line.chip)
        && let Err(error) = gpio::look(&line)
    {
        let expected = match &error {
            GpioError::Chip { source, .. } if source.kind() == std::io::ErrorKind::PermissionDenied => {
                "a chip that may be opened: run this as root, or let the user in with the group of /dev/gpiochip*"
            }
            _ => {
                "a chip and a line of this computer (`rtecctl card list`); for another computer: --elsewhere"
            }
        };
        if matches!(error, GpioError::Chip { .. }) {
            gpio.absent.insert(line.chip.clone());
        }
        source.finding(offset, format!("{key} of {owner}: {error}"), expected);
    }
    let setup = &mut gpio.setup;
    let known = setup.inputs.iter().map(|i| &i.line).chain(setup.outputs.iter().map(|o| &o.line));
    if known.into_iter().any(|l| l.line == line.line && l.chip == line.chip) {
        let found = format!("{key} of {owner} on line {}, which is wired already", line.line);
        source.finding(offset, found, "a line of its own");
        return None;
    }
    // A' and B' are read when an inversion is in effect; their edges are not needed.
    let edges = !key.starts_with("read_back");
    let bit = if output { setup.outputs.len() } else { setup.inputs.len() } as u8;
    if output {
        setup.outputs.push(GpioOutputConfig { line, bit });
    } else {
        setup.inputs.push(GpioInputConfig { line, bit, group, edges });
    }
    Some(bit)
}

/// Bit of one line, checked against the profile and the lines in use.
fn wire(
    source: &mut FileWithFindings<'_>,
    section: &mut TomlSection<'_>,
    card: &mut CardSection,
    key: &'static str,
    output: bool,
    (group, owner): (u8, &str),
) -> Option<u8> {
    if card.kind == Some(CardBackend::Gpio) {
        return wire_gpio(source, section, &mut card.gpio, key, output, (group, owner));
    }
    let at = line(section, source, key)?;
    let profile = card.profile.as_ref()?;
    let direction = if output { "an output" } else { "an input" };
    let bit = match at.value {
        CardLineName::Name(name) => match (profile.lines.get(name), output) {
            (Some(IoBit::Input(bit)), false) | (Some(IoBit::Output(bit)), true) => *bit,
            (found, _) => {
                let what = if found.is_some() { ", which goes the other way" } else { "" };
                let names: Vec<&str> = profile.lines.keys().map(String::as_str).collect();
                let hint = match nearest(name, &names) {
                    Some(near) if near != name => format!("; did you mean \"{near}\"?"),
                    _ => String::new(),
                };
                let expected = format!("{direction} line of profile \"{}\"{hint}", profile.name);
                source.finding(at.offset, format!("{key} = \"{name}\"{what}"), expected);
                return None;
            }
        },
        CardLineName::Bit(bit) => {
            let registers = if output { &profile.outputs } else { &profile.inputs };
            let bits: u32 = registers.iter().map(|r| r.width.bits()).sum();
            if u32::from(bit) >= bits {
                let expected = format!("{direction} bit of profile \"{}\", 0 to {}", profile.name, bits - 1);
                source.finding(at.offset, format!("{key} = {bit}"), expected);
                return None;
            }
            bit
        }
    };
    let owner = format!("{key} of {owner}");
    if let Some(first) = card.taken.get(&(output, bit)) {
        source.finding(at.offset, format!("{owner} on bit {bit}, which is {first}"), "a line of its own");
        return None;
    }
    card.taken.insert((output, bit), owner);
    Some(bit)
}

/// Reads the lines of an axis from `lines`, or takes the standard layout.
pub(super) fn read_lines(
    source: &mut FileWithFindings<'_>,
    section: &mut TomlSection<'_>,
    n: u8,
    card: &mut CardSection,
    owner: &str,
) -> Option<AxisLines> {
    if !card.is_real() {
        if card.kind.is_some() && section.has("lines") {
            let expected = "no lines: the mock and the replay have theirs in fixed places";
            source.finding(section.offset, format!("lines of {owner}"), expected);
        }
        return Some(AxisLines::standard(n, card.kind == Some(CardBackend::Mock)));
    }
    if !section.has("lines") {
        let meaning = "{ a = \"in0\", b = \"in1\", invert_a = \"out0\", invert_b = \"out1\" }";
        section.say_missing(source, "lines", meaning);
        return None;
    }
    let mut lines = section.table(source, "lines", "lines").with(keys::LINES);
    let mut place = |source: &mut FileWithFindings<'_>, key, output, needed| {
        let bit = wire(source, &mut lines, card, key, output, (n, owner));
        if needed { lines.required(source, key, bit) } else { bit }
    };
    let a = place(source, "a", false, true);
    let b = place(source, "b", false, true);
    let invert_a = place(source, "invert_a", true, true);
    let invert_b = place(source, "invert_b", true, true);
    let back = (place(source, "read_back_a", false, false), place(source, "read_back_b", false, false));
    let read_back = match back {
        (Some(a), Some(b)) => Some((a, b)),
        (None, None) => None,
        _ => {
            source.finding(lines.offset, "one of read_back_a and read_back_b", "both, or neither");
            None
        }
    };
    lines.finish(source);
    Some(AxisLines { a: a?, b: b?, invert_a: invert_a?, invert_b: invert_b?, read_back })
}

/// Checks that a named path exists on this computer.
fn is_there(
    source: &mut FileWithFindings<'_>,
    at: Option<LocatedValue<&str>>,
    path: impl Fn(LocatedValue<&str>) -> PathBuf,
) {
    if let Some(at) = at
        && let Err(error) = std::fs::metadata(path(at))
    {
        let found = format!("\"{}\", which cannot be looked at: {error}", at.value);
        source.finding(at.offset, found, "a file of this computer; for another computer: --elsewhere");
    }
}

/// Checks that a UIO device is a character device below `/dev`.
fn is_uio(source: &mut FileWithFindings<'_>, at: LocatedValue<&str>, path: &Path, here: bool) {
    let is_device = || std::fs::metadata(path).map(|m| m.file_type().is_char_device());
    let why = match is_device() {
        _ if !path.starts_with("/dev") => "which is not below /dev".to_owned(),
        Ok(true) | Err(_) if !here => return,
        Ok(true) => return,
        Ok(false) => "which is no character device".to_owned(),
        Err(error) => format!("which cannot be looked at: {error}"),
    };
    source.finding(at.offset, format!("uio = \"{}\", {why}", at.value), "a UIO device, as \"/dev/uio0\"");
}
