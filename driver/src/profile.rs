//! Card profiles: which register and which bit a line is, as data.
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

use crate::input::InputError;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Width of a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// One byte.
    Bits8,
    /// Two bytes.
    Bits16,
    /// Four bytes.
    Bits32,
}

impl Width {
    /// Bits in the register.
    #[must_use]
    pub const fn bits(self) -> u32 {
        match self {
            Self::Bits8 => 8,
            Self::Bits16 => 16,
            Self::Bits32 => 32,
        }
    }

    /// All ones.
    #[must_use]
    pub const fn mask(self) -> u64 {
        (1 << self.bits()) - 1
    }
}

/// A register: its byte offset and width.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Register {
    /// Byte offset from the start of the mapping.
    pub offset: usize,
    /// Its width.
    pub width: Width,
}

/// A line's place in the card's input or output word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Bit of the input word.
    Input(u8),
    /// Bit of the output word.
    Output(u8),
}

/// A value that is written to a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// The register.
    pub register: Register,
    /// What is written.
    pub value: u32,
}

/// One bit of a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flag {
    /// The register.
    pub register: Register,
    /// The bit.
    pub bit: u8,
}

/// A register that must hold a value before the card is of use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SetUp {
    /// What must stand in which register.
    pub order: Order,
    /// What it reads after the card's reset: only then is it written.
    pub after_reset: u32,
}

/// A quadrature counter of the card's own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counter {
    /// Input bits of the A and B that it counts.
    pub lines: (u8, u8),
    /// The count; up when A leads B.
    pub count: Register,
    /// Written before the count is read.
    pub latch: Option<Order>,
    /// The counter has overflowed.
    pub overflow: Option<Flag>,
    /// The card's decoder has seen an illegal transition.
    pub error: Option<Flag>,
    /// Written after a flag was seen.
    pub clear: Option<Order>,
}

impl Counter {
    fn registers(&self) -> impl Iterator<Item = Register> {
        let orders = [self.latch, self.clear].into_iter().flatten().map(|o| o.register);
        let flags = [self.overflow, self.error].into_iter().flatten().map(|f| f.register);
        std::iter::once(self.count).chain(orders).chain(flags)
    }
}

/// How a card's registers are reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Space {
    /// Memory.
    Memory,
    /// Port I/O.
    Io,
}

/// Where a PCI card has its registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PciPlace {
    /// Vendor and device.
    pub id: (u16, u16),
    /// Base address register, 0 to 5.
    pub bar: u8,
    /// What that register must say.
    pub space: Space,
}

/// A card's registers and lines, checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Profile {
    /// What the card is called.
    pub name: String,
    /// Where the register map is documented.
    pub source: String,
    /// Registers of the input word, from bit 0.
    pub inputs: Vec<Register>,
    /// Registers of the output word, from bit 0.
    pub outputs: Vec<Register>,
    /// Input bits that are active low.
    pub input_invert: u64,
    /// Output bits that are active low.
    pub output_invert: u64,
    /// The lines by name.
    pub lines: BTreeMap<String, Place>,
    /// Where it is on the PCI bus.
    pub pci: Option<PciPlace>,
    /// Registers to be set before use.
    pub setup: Vec<SetUp>,
    /// The card's own counters.
    pub counters: Vec<Counter>,
}

/// The profiles that come with the program: the name in `profile = "…"`, and their text.
pub const SHIPPED: [(&str, &str); 5] = [
    ("8255-pci", include_str!("../profiles/8255-pci.toml")),
    ("counter-card", include_str!("../profiles/counter-card.toml")),
    ("parallel-port", include_str!("../profiles/parallel-port.toml")),
    ("shared-memory", include_str!("../profiles/shared-memory.toml")),
    ("wch-ch382l", include_str!("../profiles/wch-ch382l.toml")),
];

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    #[serde(default)]
    source: String,
    inputs: Vec<FileRegister>,
    outputs: Vec<FileRegister>,
    lines: toml::Table,
    pci: Option<FilePci>,
    #[serde(default)]
    setup: Vec<FileSetUp>,
    #[serde(default)]
    counter: Vec<toml::Spanned<FileCounter>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileRegister {
    register: toml::Spanned<usize>,
    width: toml::Spanned<u32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePci {
    id: toml::Spanned<String>,
    bar: toml::Spanned<u8>,
    space: Space,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileOrder {
    register: toml::Spanned<usize>,
    width: toml::Spanned<u32>,
    value: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileFlag {
    register: toml::Spanned<usize>,
    width: toml::Spanned<u32>,
    bit: toml::Spanned<u8>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileSetUp {
    register: toml::Spanned<usize>,
    width: toml::Spanned<u32>,
    value: u32,
    after_reset: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileCounter {
    a: u8,
    b: u8,
    count: FileRegister,
    latch: Option<FileOrder>,
    overflow: Option<FileFlag>,
    error: Option<FileFlag>,
    clear: Option<FileOrder>,
}

/// Vendor and device as `lspci -n` writes them, `1af4:1110`.
#[must_use]
pub fn pci_id(text: &str) -> Option<(u16, u16)> {
    let (vendor, device) = text.split_once(':')?;
    let word = |digits: &str| {
        let plain = digits.len() == 4 && digits.bytes().all(|b| b.is_ascii_hexdigit());
        plain.then(|| u16::from_str_radix(digits, 16).ok())?
    };
    Some((word(vendor)?, word(device)?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileLine {
    input: Option<u8>,
    output: Option<u8>,
    #[serde(default)]
    active_low: bool,
}

impl Profile {
    /// The profile of the shared-memory test card: 32 inputs `in0`… at byte 0, 32 outputs `out0`… at byte 4.
    #[must_use]
    pub fn shared_memory() -> Self {
        // A constant of this program, covered by a test: it is there and parses.
        let Some(profile) = Self::shipped("shared-memory") else { unreachable!() };
        profile
    }

    /// A profile that comes with the program.
    #[must_use]
    pub fn shipped(name: &str) -> Option<Self> {
        let (file, text) = SHIPPED.iter().find(|(shipped, _)| *shipped == name)?;
        match Self::parse(Path::new(file), text) {
            Ok(profile) => Some(profile),
            // A constant of this program, covered by a test: it parses.
            Err(error) => unreachable!("{error}"),
        }
    }

    /// Reads and checks a profile.
    ///
    /// # Errors
    /// The first finding, with its line.
    #[allow(clippy::too_many_lines)] // One table after the other.
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        let file: File = toml::from_str(text).map_err(|e| {
            InputError::at_offset(
                path,
                text,
                e.span().map_or(0, |s| s.start),
                e.message().trim(),
                "a card profile",
            )
        })?;
        let bad =
            |at: usize, found: String, wanted: String| InputError::at_offset(path, text, at, found, wanted);
        let register = |register: &toml::Spanned<usize>, width: &toml::Spanned<u32>| {
            let bits = *width.get_ref();
            let checked = match bits {
                8 => Width::Bits8,
                16 => Width::Bits16,
                32 => Width::Bits32,
                _ => return Err(bad(width.span().start, format!("width = {bits}"), "8, 16 or 32".into())),
            };
            let (offset, bytes) = (*register.get_ref(), bits as usize / 8);
            if !offset.is_multiple_of(bytes) || offset > 1 << 24 {
                let wanted = format!("a byte offset divisible by {bytes}, below 16 MiB");
                return Err(bad(register.span().start, format!("register = {offset:#x}"), wanted));
            }
            Ok(Register { offset, width: checked })
        };
        let registers = |list: Vec<FileRegister>| {
            let mut bits = 0;
            let mut registers = Vec::new();
            for r in list {
                let checked = register(&r.register, &r.width)?;
                bits += checked.width.bits();
                registers.push(checked);
            }
            if registers.is_empty() || bits > 64 {
                return Err(InputError::whole(
                    path,
                    format!("registers of {bits} bits in one direction"),
                    "at least one register and at most 64 bits each for inputs and outputs",
                ));
            }
            Ok((registers, bits))
        };
        let (inputs, input_bits) = registers(file.inputs)?;
        let (outputs, output_bits) = registers(file.outputs)?;
        let order = |o: FileOrder| Ok(Order { register: register(&o.register, &o.width)?, value: o.value });
        let flag = |f: FileFlag| {
            let register = register(&f.register, &f.width)?;
            if u32::from(*f.bit.get_ref()) >= register.width.bits() {
                let wanted = format!("a bit from 0 to {}", register.width.bits() - 1);
                return Err(bad(f.bit.span().start, format!("bit = {}", f.bit.get_ref()), wanted));
            }
            Ok(Flag { register, bit: *f.bit.get_ref() })
        };
        let mut counters = Vec::new();
        for at in file.counter {
            let start = at.span().start;
            let c = at.into_inner();
            if c.a == c.b || u32::from(c.a.max(c.b)) >= input_bits {
                let wanted = format!("two different input bits, 0 to {}", input_bits - 1);
                return Err(bad(start, format!("counter of a = {}, b = {}", c.a, c.b), wanted));
            }
            counters.push(Counter {
                lines: (c.a, c.b),
                count: register(&c.count.register, &c.count.width)?,
                latch: c.latch.map(order).transpose()?,
                overflow: c.overflow.map(flag).transpose()?,
                error: c.error.map(flag).transpose()?,
                clear: c.clear.map(order).transpose()?,
            });
        }
        let mut setup = Vec::new();
        for s in file.setup {
            let order = Order { register: register(&s.register, &s.width)?, value: s.value };
            setup.push(SetUp { order, after_reset: s.after_reset });
        }
        let pci = match file.pci {
            None => None,
            Some(pci) => {
                let Some(id) = pci_id(pci.id.get_ref()) else {
                    let wanted = "vendor:device in hexadecimal, as \"1af4:1110\"".to_owned();
                    return Err(bad(pci.id.span().start, format!("id = \"{}\"", pci.id.get_ref()), wanted));
                };
                if *pci.bar.get_ref() > 5 {
                    let found = format!("bar = {}", pci.bar.get_ref());
                    return Err(bad(pci.bar.span().start, found, "0 to 5".into()));
                }
                Some(PciPlace { id, bar: *pci.bar.get_ref(), space: pci.space })
            }
        };
        let mut profile = Self {
            pci,
            setup,
            counters,
            name: file.name,
            source: file.source,
            inputs,
            outputs,
            input_invert: 0,
            output_invert: 0,
            lines: BTreeMap::new(),
        };
        for (name, value) in file.lines {
            let line_of = |needle: &str| {
                let n = text.lines().position(|l| l.trim_start().starts_with(needle));
                n.map_or(0, |n| n + 1)
            };
            let bad = |found: String| {
                InputError::at(
                    path,
                    line_of(&name),
                    0,
                    found,
                    "{ input = BIT } or { output = BIT }, BIT within the registers",
                )
            };
            let line =
                FileLine::deserialize(value).map_err(|e| bad(format!("line {name}: {}", e.message())))?;
            let place = match (line.input, line.output) {
                (Some(bit), None) if u32::from(bit) < input_bits => {
                    profile.input_invert |= u64::from(line.active_low) << bit;
                    Place::Input(bit)
                }
                (None, Some(bit)) if u32::from(bit) < output_bits => {
                    profile.output_invert |= u64::from(line.active_low) << bit;
                    Place::Output(bit)
                }
                _ => {
                    return Err(bad(format!(
                        "line {name} = input {:?}, output {:?}",
                        line.input, line.output
                    )));
                }
            };
            profile.lines.insert(name, place);
        }
        Ok(profile)
    }

    /// Every register that is used.
    pub fn registers(&self) -> impl Iterator<Item = Register> {
        let words = self.inputs.iter().chain(&self.outputs).copied();
        let others = self.setup.iter().map(|s| s.order.register);
        words.chain(others).chain(self.counters.iter().flat_map(Counter::registers))
    }

    /// Bytes that a mapping must have.
    #[must_use]
    pub fn size(&self) -> usize {
        self.registers().map(|r| r.offset + r.width.bits() as usize / 8).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Profile, InputError> {
        Profile::parse(Path::new("card.toml"), text)
    }

    #[test]
    fn embedded_profile_has_its_lines() {
        let p = Profile::shared_memory();
        assert_eq!((p.size(), p.lines.len()), (8, 64));
        assert_eq!(p.lines["in3"], Place::Input(3));
        assert_eq!(p.lines["out31"], Place::Output(31));
    }

    #[test]
    fn every_shipped_profile_parses_and_names_its_datasheet() {
        for (name, _) in SHIPPED {
            let p = Profile::shipped(name).unwrap();
            assert!(p.source.len() > 20 && p.lines.len() > 3, "{name}: {p:?}");
        }
        let pci = |name| Profile::shipped(name).unwrap().pci.unwrap();
        assert_eq!((pci("8255-pci").id, pci("8255-pci").space), ((0x144a, 0x7224), Space::Io));
        assert_eq!((pci("wch-ch382l").id, pci("wch-ch382l").bar), ((0x1c00, 0x3050), 2));
        assert_eq!((pci("shared-memory").id, pci("shared-memory").space), ((0x1af4, 0x1110), Space::Memory));
        let counters = Profile::shipped("counter-card").unwrap().counters;
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
                "card.toml:3:20: found register = 0x2, expected a byte offset divisible by 4",
            ),
            (
                "outputs=[{register=4,width=12}]\n[lines]\n",
                "card.toml:3:28: found width = 12, expected 8, 16 or 32",
            ),
            ("outputs=[]\n[lines]\n", "expected at least one register"),
            ("outputs=[{register=4,width=32}]\n[lines]\nin40={input=40}\n", "card.toml:5: found line in40"),
            ("outputs=[{register=4,width=32}]\n[lines]\nx={input=1,output=2}\n", "card.toml:5: found line x"),
            (
                "outputs=[{register=4,width=32}]\n[lines]\n[pci]\nid='1af4'\nbar=0\nspace='io'\n",
                "card.toml:6:4: found id = \"1af4\", expected vendor:device",
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
            ("outpts=[]\n", "card.toml:3:1: found unknown field `outpts`"),
        ] {
            let found = parse(&format!("{head}{text}")).unwrap_err().to_string();
            assert!(found.contains(wants), "{found}\n  wants {wants}");
        }
    }
}
