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
}

/// The shared-memory test card: inputs at byte 0, outputs at byte 4.
const SHARED_MEMORY: &str = include_str!("../profiles/shared-memory.toml");

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    #[serde(default)]
    source: String,
    inputs: Vec<FileRegister>,
    outputs: Vec<FileRegister>,
    lines: toml::Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileRegister {
    register: toml::Spanned<usize>,
    width: toml::Spanned<u32>,
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
        // A constant of this program, covered by a test: it parses.
        let Ok(profile) = Self::parse(Path::new("shared-memory.toml"), SHARED_MEMORY) else { unreachable!() };
        profile
    }

    /// Reads and checks a profile.
    ///
    /// # Errors
    /// The first finding, with its line.
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
        let registers = |list: Vec<FileRegister>| {
            let mut bits = 0;
            let mut registers = Vec::new();
            for r in list {
                let width = match r.width.get_ref() {
                    8 => Width::Bits8,
                    16 => Width::Bits16,
                    32 => Width::Bits32,
                    other => {
                        let at = r.width.span().start;
                        return Err(InputError::at_offset(
                            path,
                            text,
                            at,
                            format!("width = {other}"),
                            "8, 16 or 32",
                        ));
                    }
                };
                let offset = *r.register.get_ref();
                let bytes = width.bits() as usize / 8;
                if !offset.is_multiple_of(bytes) || offset > 1 << 24 {
                    let found = format!("register = {offset:#x}");
                    let wanted = format!("a byte offset divisible by {bytes}, below 16 MiB");
                    return Err(InputError::at_offset(path, text, r.register.span().start, found, wanted));
                }
                bits += width.bits();
                registers.push(Register { offset, width });
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
        let mut profile = Self {
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

    /// Bytes that a mapping must have.
    #[must_use]
    pub fn size(&self) -> usize {
        let ends = self.inputs.iter().chain(&self.outputs).map(|r| r.offset + r.width.bits() as usize / 8);
        ends.max().unwrap_or(0)
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
            ("outpts=[]\n", "card.toml:3:1: found unknown field `outpts`"),
        ] {
            let found = parse(&format!("{head}{text}")).unwrap_err().to_string();
            assert!(found.contains(wants), "{found}\n  wants {wants}");
        }
    }
}
