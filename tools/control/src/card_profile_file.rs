//! Card profiles read from their files: which register and which bit a line is.
//!
//! ```toml
//! name = "shared-memory test card"
//! source = "docs of the card: title, section"
//! inputs  = [{ register = 0x00, width = 32 }]          # read, in this order, into one word from bit 0
//! outputs = [{ register = 0x04, width = 32 }]          # must read back what was written
//! [lines]                                              # name = place; every bit that can be wired
//! in0  = { input = 0 }
//! out0 = { output = 0, active_low = true }
//!
//! # What only some cards need:
//! [pci]                                                # where the registers are on a PCI card
//! id = "1af4:1110"                                     # vendor:device
//! bar = 2
//! space = "memory"                                     # or "io": a backend = "port" card
//! [[setup]]                                            # written once, when the card comes fresh out of its reset
//! register = 3
//! width = 8
//! value = 0x92
//! after_reset = 0x9b                                   # what it reads then; any other value is refused
//! [[counter]]                                          # the card counts itself: its count is taken, not ours
//! a = 0                                                # input bits of the lines that it counts
//! b = 1
//! count = { register = 0x10, width = 32 }              # up when A leads B
//! latch = { register = 0x14, width = 32, value = 1 }   # optional: written before the count is read
//! overflow = { register = 0x18, width = 32, bit = 0 }  # optional: flags that are latched as faults
//! error = { register = 0x18, width = 32, bit = 1 }
//! clear = { register = 0x18, width = 32, value = 3 }   # optional: written after a flag was seen
//! ```

use rtec_driver::card_profile::{
    AddressSpace, CardProfile, Counter, IoBit, PciBarSpec, Register, RegisterBit, RegisterPreset,
    RegisterWrite, Width, pci_id,
};
use rtec_files::file_kind::FileKind;
use rtec_files::strict_toml::{Document, Table, TomlKeyValue};
use rtec_files::{InputError, nearest};
use std::path::Path;

/// Profiles that come with the program: name in `profile = "…"` and text.
pub const SHIPPED: [(&str, &str); 5] = [
    ("8255-pci", include_str!("../../../driver/profiles/8255-pci.toml")),
    ("counter-card", include_str!("../../../driver/profiles/counter-card.toml")),
    ("parallel-port", include_str!("../../../driver/profiles/parallel-port.toml")),
    ("shared-memory", include_str!("../../../driver/profiles/shared-memory.toml")),
    ("wch-ch382l", include_str!("../../../driver/profiles/wch-ch382l.toml")),
];

/// A profile that comes with the program.
pub fn shipped(name: &str) -> Option<CardProfile> {
    let (file, text) = SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
    match parse(Path::new(file), text) {
        Ok(profile) => Some(profile),
        // A constant of this program, covered by a test: it parses.
        Err(error) => unreachable!("{error}"),
    }
}

/// Message for a profile name that does not exist.
pub fn names_for(named: &str) -> String {
    let shipped = SHIPPED.map(|(name, _)| name);
    let hint = nearest(named, &shipped).map_or(String::new(), |near| format!("; did you mean \"{near}\"?"));
    format!("the path of a card profile, or one of {}{hint}", shipped.join(", "))
}

/// Checks the text of a profile; `file` is its name in findings.
///
/// # Errors
/// The first finding, with its line.
pub fn parse(file: &Path, text: &str) -> Result<CardProfile, InputError> {
    let mistaken = |e: InputError| FileKind::Profile.finding(file, text, e);
    let document = Document::parse(file, text).map_err(mistaken)?;
    let root = document.root();
    root.only(&["name", "source", "inputs", "outputs", "lines", "pci", "setup", "counter"])
        .map_err(mistaken)?;
    let name = root.required("name", "the card's name")?.str("the card's name")?.to_owned();
    let source = root.get("source").map(|e| e.str("where the registers are documented")).transpose()?;
    let (inputs, input_bits) = word(root.required("inputs", REGISTERS)?)?;
    let (outputs, output_bits) = word(root.required("outputs", REGISTERS)?)?;
    let tables = |key| root.get(key).map(|e| e.tables(&format!("[[{key}]] tables"))).transpose();
    let setup = tables("setup")?.unwrap_or_default();
    let counters = tables("counter")?.unwrap_or_default();
    let mut profile = CardProfile {
        name,
        source: source.unwrap_or_default().to_owned(),
        inputs,
        outputs,
        input_invert: 0,
        output_invert: 0,
        lines: std::collections::BTreeMap::new(),
        pci: root.get("pci").map(|e| pci(e.table("a table [pci]")?)).transpose()?,
        setup: setup.into_iter().map(set_up).collect::<Result<_, _>>()?,
        counters: counters.into_iter().map(|t| counter(t, input_bits)).collect::<Result<_, _>>()?,
    };
    for entry in root.required("lines", "a table [lines]")?.table("a table [lines]")?.entries() {
        let (place, active_low) = line(entry, input_bits, output_bits)?;
        match place {
            IoBit::Input(bit) => profile.input_invert |= u64::from(active_low) << bit,
            IoBit::Output(bit) => profile.output_invert |= u64::from(active_low) << bit,
        }
        profile.lines.insert(entry.key().to_owned(), place);
    }
    Ok(profile)
}

const REGISTERS: &str = "registers, as [{ register = 0, width = 32 }]";
const REGISTER: &str = "a register, as { register = 0, width = 32 }";

/// Reads the registers of one direction; returns them and their number of bits.
fn word(entry: TomlKeyValue<'_>) -> Result<(Vec<Register>, u32), InputError> {
    let mut registers = Vec::new();
    for table in entry.tables(REGISTERS)? {
        table.only(&["register", "width"])?;
        registers.push(register(table)?);
    }
    let bits = registers.iter().map(|r| r.width.bits()).sum();
    if registers.is_empty() || bits > 64 {
        let found = format!("{} = registers of {bits} bits", entry.key());
        return Err(
            entry.error(found, "at least one register and at most 64 bits each for inputs and outputs")
        );
    }
    Ok((registers, bits))
}

fn register(table: Table<'_>) -> Result<Register, InputError> {
    let width = table.required("width", REGISTER)?;
    let (checked, bytes) = match width.as_integer() {
        Some(8) => (Width::Bits8, 1),
        Some(16) => (Width::Bits16, 2),
        Some(32) => (Width::Bits32, 4),
        _ => return Err(width.mismatch("8, 16 or 32")),
    };
    let register = table.required("register", REGISTER)?;
    let wanted = format!("a byte offset divisible by {bytes}, below 16 MiB");
    let offset: usize = register.integer(&wanted)?;
    if !offset.is_multiple_of(bytes) || offset > 1 << 24 {
        return Err(register.mismatch(wanted));
    }
    Ok(Register { offset, width: checked })
}

fn value(table: Table<'_>, key: &str) -> Result<u32, InputError> {
    let expected = "a value of at most 32 bits";
    table.required(key, expected)?.integer(expected)
}

fn order(entry: TomlKeyValue<'_>) -> Result<RegisterWrite, InputError> {
    let table = entry.table("{ register = 0, width = 32, value = 1 }")?;
    table.only(&["register", "width", "value"])?;
    Ok(RegisterWrite { register: register(table)?, value: value(table, "value")? })
}

fn set_up(table: Table<'_>) -> Result<RegisterPreset, InputError> {
    table.only(&["register", "width", "value", "after_reset"])?;
    let order = RegisterWrite { register: register(table)?, value: value(table, "value")? };
    Ok(RegisterPreset { order, after_reset: value(table, "after_reset")? })
}

fn flag(entry: TomlKeyValue<'_>) -> Result<RegisterBit, InputError> {
    let table = entry.table("{ register = 0, width = 32, bit = 0 }")?;
    table.only(&["register", "width", "bit"])?;
    let register = register(table)?;
    let wanted = format!("a bit from 0 to {}", register.width.bits() - 1);
    let entry = table.required("bit", &wanted)?;
    let bit: u8 = entry.integer(&wanted)?;
    if u32::from(bit) >= register.width.bits() {
        return Err(entry.mismatch(wanted));
    }
    Ok(RegisterBit { register, bit })
}

fn counter(table: Table<'_>, input_bits: u32) -> Result<Counter, InputError> {
    table.only(&["a", "b", "count", "latch", "overflow", "error", "clear"])?;
    let wanted = format!("two different input bits, 0 to {}", input_bits - 1);
    let line = |key| table.required(key, &wanted)?.integer::<u8>(&wanted);
    let (a, b) = (line("a")?, line("b")?);
    if a == b || u32::from(a.max(b)) >= input_bits {
        return Err(table.error(format!("counter of a = {a}, b = {b}"), wanted));
    }
    let count = table.required("count", REGISTER)?.table(REGISTER)?;
    count.only(&["register", "width"])?;
    Ok(Counter {
        lines: (a, b),
        count: register(count)?,
        latch: table.get("latch").map(order).transpose()?,
        overflow: table.get("overflow").map(flag).transpose()?,
        error: table.get("error").map(flag).transpose()?,
        clear: table.get("clear").map(order).transpose()?,
    })
}

fn pci(table: Table<'_>) -> Result<PciBarSpec, InputError> {
    table.only(&["id", "bar", "space"])?;
    let wanted = "vendor:device in hexadecimal, as \"1af4:1110\"";
    let entry = table.required("id", wanted)?;
    let id = pci_id(entry.str(wanted)?).ok_or_else(|| entry.mismatch(wanted))?;
    let entry = table.required("bar", "0 to 5")?;
    let bar = entry.integer("0 to 5")?;
    if bar > 5 {
        return Err(entry.mismatch("0 to 5"));
    }
    let entry = table.required("space", "\"memory\" or \"io\"")?;
    let space = match entry.as_str() {
        Some("memory") => AddressSpace::Memory,
        Some("io") => AddressSpace::Io,
        _ => return Err(entry.mismatch("\"memory\" or \"io\"")),
    };
    Ok(PciBarSpec { id, bar, space })
}

/// Reads a line's place and whether it is active low.
fn line(entry: TomlKeyValue<'_>, input_bits: u32, output_bits: u32) -> Result<(IoBit, bool), InputError> {
    let wanted = "{ input = BIT } or { output = BIT }, BIT within the registers";
    let table = entry.table(wanted)?;
    table.only(&["input", "output", "active_low"])?;
    let bit = |key| table.get(key).map(|e| e.integer::<u8>(wanted)).transpose();
    let place = match (bit("input")?, bit("output")?) {
        (Some(bit), None) if u32::from(bit) < input_bits => IoBit::Input(bit),
        (None, Some(bit)) if u32::from(bit) < output_bits => IoBit::Output(bit),
        _ => return Err(entry.mismatch(wanted)),
    };
    let active_low = table.get("active_low").map(|e| e.bool("true or false")).transpose()?;
    Ok((place, active_low.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<CardProfile, InputError> {
        super::parse(Path::new("card.toml"), text)
    }

    #[test]
    fn the_test_cards_file_says_what_the_driver_says() {
        assert_eq!(shipped("shared-memory").unwrap(), CardProfile::shared_memory());
    }

    #[test]
    fn every_shipped_profile_parses_and_names_its_datasheet() {
        for (name, _) in SHIPPED {
            let p = shipped(name).unwrap();
            assert!(p.source.len() > 20 && p.lines.len() > 3, "{name}: {p:?}");
        }
        let pci = |name| shipped(name).unwrap().pci.unwrap();
        assert_eq!((pci("8255-pci").id, pci("8255-pci").space), ((0x144a, 0x7224), AddressSpace::Io));
        assert_eq!((pci("wch-ch382l").id, pci("wch-ch382l").bar), ((0x1c00, 0x3050), 2));
        assert_eq!(
            (pci("shared-memory").id, pci("shared-memory").space),
            ((0x1af4, 0x1110), AddressSpace::Memory)
        );
        let counters = shipped("counter-card").unwrap().counters;
        assert_eq!((counters.len(), counters[1].lines), (2, (2, 3)));
    }

    #[test]
    fn several_registers_make_one_word_and_polarity_is_kept() {
        let p = parse(
            "name='c'\ninputs=[{register=0,width=8},{register=1,width=8}]\noutputs=[{register=2,width=16}]\n\
             [lines]\nin9={input=9,active_low=true}\n",
        )
        .unwrap();
        assert_eq!((p.size(), p.input_invert), (4, 1 << 9));
    }

    #[test]
    fn findings_name_line_and_remedy() {
        let head = "name='c'\ninputs=[{register=0,width=32}]\n";
        for (text, wants) in [
            (
                "outputs=[{register=2,width=32}]\n[lines]\n",
                "card.toml:3:20: found register = 2, expected a byte offset divisible by 4",
            ),
            (
                "outputs=[{register=4,width=12}]\n[lines]\n",
                "card.toml:3:28: found width = 12, expected 8, 16 or 32",
            ),
            ("outputs=[]\n[lines]\n", "expected at least one register"),
            (
                "outputs=[{register=4,width=32}]\n[lines]\nin40={input=40}\n",
                "card.toml:5:6: found in40 = {input=40}, expected { input = BIT }",
            ),
            (
                "outputs=[{register=4,width=32}]\n[lines]\nx={input=1,output=2}\n",
                "card.toml:5:3: found x = {input=1,output=2}",
            ),
            (
                "outputs=[{register=4,width=32}]\n[lines]\n[pci]\nid='1af4'\nbar=0\nspace='io'\n",
                "card.toml:6:4: found id = '1af4', expected vendor:device",
            ),
            (
                "outputs=[{register=4,width=32}]\n[lines]\n[[counter]]\na=1\nb=1\ncount={register=8,width=32}\n",
                "card.toml:5:1: found counter of a = 1, b = 1, expected two different input bits, 0 to 31",
            ),
            (
                "outputs=[{register=4,width=32}]\n[lines]\n[[counter]]\na=1\nb=0\ncount={register=8,width=32}\n\
                 error={register=12,width=8,bit=8}\n",
                "card.toml:9:32: found bit = 8, expected a bit from 0 to 7",
            ),
            (
                "outpts=[]\n",
                "card.toml:3:1: found unknown key outpts, expected a key of the file; did you mean outputs?",
            ),
        ] {
            let found = parse(&format!("{head}{text}")).unwrap_err().to_string();
            assert!(found.contains(wants), "{found}\n  wants {wants}");
        }
    }
}
