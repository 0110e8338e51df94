//! Card profiles: register and bit of each line, as data.
//! Another crate reads their files. Those that come with the program are in `profiles/`.

use std::collections::BTreeMap;

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
    pub const fn bits(self) -> u32 {
        match self {
            Self::Bits8 => 8,
            Self::Bits16 => 16,
            Self::Bits32 => 32,
        }
    }

    /// All ones.
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
pub enum IoBit {
    /// Bit of the input word.
    Input(u8),
    /// Bit of the output word.
    Output(u8),
}

/// A value that is written to a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterWrite {
    /// The register.
    pub register: Register,
    /// The value to write.
    pub value: u32,
}

/// One bit of a register.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterBit {
    /// The register.
    pub register: Register,
    /// The bit.
    pub bit: u8,
}

/// A register that must hold a value before the card is of use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RegisterPreset {
    /// The register, and the value that it must hold.
    pub order: RegisterWrite,
    /// Value after the card's reset.
    /// The register is written only if it reads this value.
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
    pub latch: Option<RegisterWrite>,
    /// The counter has overflowed.
    pub overflow: Option<RegisterBit>,
    /// The card's decoder has seen an illegal transition.
    pub error: Option<RegisterBit>,
    /// Written after a flag was seen.
    pub clear: Option<RegisterWrite>,
}

impl Counter {
    fn registers(&self) -> impl Iterator<Item = Register> {
        let orders = [self.latch, self.clear].into_iter().flatten().map(|o| o.register);
        let flags = [self.overflow, self.error].into_iter().flatten().map(|f| f.register);
        std::iter::once(self.count).chain(orders).chain(flags)
    }
}

/// Address space of a card's registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AddressSpace {
    /// Memory.
    Memory,
    /// Port I/O.
    Io,
}

/// Location of a PCI card's registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PciBarSpec {
    /// Vendor and device.
    pub id: (u16, u16),
    /// Base address register, 0 to 5.
    pub bar: u8,
    /// Address space that this BAR must have.
    pub space: AddressSpace,
}

/// A card's registers and lines, checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CardProfile {
    /// Name of the card.
    pub name: String,
    /// Document that describes the register map.
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
    pub lines: BTreeMap<String, IoBit>,
    /// Location on the PCI bus.
    pub pci: Option<PciBarSpec>,
    /// Registers to be set before use.
    pub setup: Vec<RegisterPreset>,
    /// The card's own counters.
    pub counters: Vec<Counter>,
}

/// Vendor and device as `lspci -n` writes them, `1af4:1110`.
pub fn pci_id(text: &str) -> Option<(u16, u16)> {
    let (vendor, device) = text.split_once(':')?;
    let word = |digits: &str| {
        let plain = digits.len() == 4 && digits.bytes().all(|b| b.is_ascii_hexdigit());
        plain.then(|| u16::from_str_radix(digits, 16).ok())?
    };
    Some((word(vendor)?, word(device)?))
}

impl CardProfile {
    /// The profile of the shared-memory test card.
    /// 32 inputs `in0`… are at byte 0, 32 outputs `out0`… at byte 4.
    pub fn shared_memory() -> Self {
        let register = |offset| vec![Register { offset, width: Width::Bits32 }];
        let inputs = (0..32).map(|bit| (format!("in{bit}"), IoBit::Input(bit)));
        let outputs = (0..32).map(|bit| (format!("out{bit}"), IoBit::Output(bit)));
        Self {
            name: "shared-memory test card".to_owned(),
            source: "this project: inputs at byte 0, outputs at byte 4, little-endian. On the PCI bus it is QEMU's \
                     ivshmem-plain, whose BAR 2 is a file of the host (QEMU documentation, Device Specification for \
                     Inter-VM shared memory device)"
                .to_owned(),
            inputs: register(0),
            outputs: register(4),
            input_invert: 0,
            output_invert: 0,
            lines: inputs.chain(outputs).collect(),
            pci: Some(PciBarSpec { id: (0x1af4, 0x1110), bar: 2, space: AddressSpace::Memory }),
            setup: Vec::new(),
            counters: Vec::new(),
        }
    }

    /// Every register that the profile uses.
    pub fn registers(&self) -> impl Iterator<Item = Register> {
        let words = self.inputs.iter().chain(&self.outputs).copied();
        let others = self.setup.iter().map(|s| s.order.register);
        words.chain(others).chain(self.counters.iter().flat_map(Counter::registers))
    }

    /// Size that a mapping needs, bytes.
    pub fn size(&self) -> usize {
        self.registers().map(|r| r.offset + r.width.bits() as usize / 8).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_test_card_has_its_lines() {
        let p = CardProfile::shared_memory();
        assert_eq!((p.size(), p.lines.len()), (8, 64));
        assert_eq!(p.lines["in3"], IoBit::Input(3));
        assert_eq!(p.lines["out31"], IoBit::Output(31));
    }

    /// A mapping reaches to the last register used, of whatever kind.
    #[test]
    fn a_mapping_holds_the_registers_of_set_up_and_counters_too() {
        let register = |offset| Register { offset, width: Width::Bits16 };
        let order = |offset| RegisterWrite { register: register(offset), value: 1 };
        let flag = |offset| RegisterBit { register: register(offset), bit: 0 };
        let counter = Counter {
            lines: (0, 1),
            count: register(0x10),
            latch: Some(order(0x12)),
            overflow: Some(flag(0x14)),
            error: Some(flag(0x16)),
            clear: Some(order(0x18)),
        };
        let mut p = CardProfile::shared_memory();
        p.setup = vec![RegisterPreset { order: order(0xa), after_reset: 0 }];
        assert_eq!(p.size(), 0xc);
        let least = Counter { latch: None, overflow: None, error: None, clear: None, ..counter };
        for (counter, size) in [
            (least, 0x12),
            (Counter { latch: counter.latch, ..least }, 0x14),
            (Counter { overflow: counter.overflow, ..least }, 0x16),
            (Counter { error: counter.error, ..least }, 0x18),
            (counter, 0x1a),
        ] {
            p.counters = vec![counter];
            assert_eq!(p.size(), size);
        }
    }
}
