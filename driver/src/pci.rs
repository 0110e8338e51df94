//! A function on the PCI bus, through sysfs.
//! It is found and enabled, and its BAR and command register are checked.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::card_profile::AddressSpace;

/// Directory in which the kernel lists the bus.
const SYSFS: &str = "/sys/bus/pci/devices";
/// Flags of a resource, from the kernel's ioport.h.
const RESOURCE_IO: u64 = 0x100;
const RESOURCE_MEM: u64 = 0x200;
/// Kernel drivers that leave a card's registers to a program, or unused.
const FOR_PROGRAMS: [&str; 3] = ["pci-stub", "uio_pci_generic", "vfio-pci"];

/// Identifies one PCI function.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PciFunctionSelector {
    /// Vendor and device; exactly one such card must be present.
    Card(u16, u16),
    /// Its place on the bus, `0000:00:04.0`.
    Address(String),
}

impl PciFunctionSelector {
    /// `1af4:1110` or `0000:00:04.0`.
    pub fn parse(text: &str) -> Option<Self> {
        if let Some((vendor, device)) = crate::card_profile::pci_id(text) {
            return Some(Self::Card(vendor, device));
        }
        let (bus, function) = text.rsplit_once('.')?;
        let parts: Vec<&str> = bus.split(':').collect();
        let hex = |s: &str, digits| s.len() == digits && s.bytes().all(|b| b.is_ascii_hexdigit());
        let [domain, bus, device] = parts[..] else { return None };
        let is =
            hex(domain, 4) && hex(bus, 2) && hex(device, 2) && matches!(function.as_bytes(), [b'0'..=b'7']);
        is.then(|| Self::Address(text.to_ascii_lowercase()))
    }
}

impl fmt::Display for PciFunctionSelector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Card(vendor, device) => write!(f, "{vendor:04x}:{device:04x}"),
            Self::Address(address) => f.write_str(address),
        }
    }
}

/// Reason why a PCI function cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum PciError {
    #[error("no PCI card {0}: `rtecctl card list` shows which cards are there")]
    Absent(PciFunctionSelector),
    #[error("{} PCI cards {id}, at {}: name one by its address", addresses.len(), addresses.join(" and "))]
    Several { id: PciFunctionSelector, addresses: Vec<String> },
    #[error("PCI card {address}, BAR {bar}: found {found}, expected {expected}")]
    Bar { address: String, bar: u8, found: String, expected: String },
    #[error(
        "PCI card {address}: command register {command:#06x} leaves {space} access off: nobody has enabled the card \
         (rtecd does), or the firmware gave it no addresses"
    )]
    Off { address: String, command: u16, space: &'static str },
    #[error(
        "PCI card {address} is in the hands of the kernel's driver {driver}: use that driver's device (/dev/parportN, \
         /dev/uioN, a GPIO chip), or free the card: cd /sys/bus/pci/devices/{address} && echo pci-stub > driver_override && \
         echo {address} > driver/unbind"
    )]
    Held { address: String, driver: String },
    #[error("{op} {}: {source}", path.display())]
    Io { op: &'static str, path: PathBuf, source: io::Error },
}

/// A base address register.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bar {
    /// First address of the region, on the memory or the I/O bus.
    pub start: u64,
    /// Size, bytes.
    pub size: u64,
    /// Memory or port I/O.
    pub space: AddressSpace,
    /// The file in sysfs that can be mapped.
    pub file: PathBuf,
}

/// A function on the bus.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PciFunction {
    /// Its place, `0000:00:04.0`.
    pub address: String,
    /// Vendor and device.
    pub id: (u16, u16),
    directory: PathBuf,
}

/// All functions on the bus, in the order of their addresses.
/// Empty on a machine without a PCI bus.
pub fn functions() -> Vec<PciFunction> {
    functions_in(Path::new(SYSFS))
}

fn functions_in(sysfs: &Path) -> Vec<PciFunction> {
    let number = |path: PathBuf| {
        let text = fs::read_to_string(path).ok()?;
        u16::from_str_radix(text.trim().trim_start_matches("0x"), 16).ok()
    };
    let entries = fs::read_dir(sysfs).into_iter().flatten().flatten();
    let mut all: Vec<_> = entries
        .filter_map(|entry| {
            let directory = entry.path();
            let id = (number(directory.join("vendor"))?, number(directory.join("device"))?);
            Some(PciFunction { address: entry.file_name().into_string().ok()?, id, directory })
        })
        .collect();
    all.sort_by(|a, b| a.address.cmp(&b.address));
    all
}

/// Finds the one function that `which` names.
///
/// # Errors
/// When it is not there, or there is more than one.
pub fn find(which: &PciFunctionSelector) -> Result<PciFunction, PciError> {
    find_in(Path::new(SYSFS), which)
}

/// Finds the one function that `which` names on the bus below this directory.
///
/// # Errors
/// As [`find`].
pub fn find_in(sysfs: &Path, which: &PciFunctionSelector) -> Result<PciFunction, PciError> {
    choose(functions_in(sysfs), which)
}

fn choose(all: Vec<PciFunction>, which: &PciFunctionSelector) -> Result<PciFunction, PciError> {
    let is = |f: &PciFunction| match which {
        PciFunctionSelector::Card(vendor, device) => f.id == (*vendor, *device),
        PciFunctionSelector::Address(address) => f.address == *address,
    };
    let mut found: Vec<_> = all.into_iter().filter(is).collect();
    if found.len() > 1 {
        let addresses = found.into_iter().map(|f| f.address).collect();
        return Err(PciError::Several { id: which.clone(), addresses });
    }
    found.pop().ok_or_else(|| PciError::Absent(which.clone()))
}

impl PciFunction {
    /// Reads one of the function's BARs.
    ///
    /// # Errors
    /// When sysfs cannot be read, or the card has no such BAR.
    pub fn bar(&self, bar: u8) -> Result<Bar, PciError> {
        let path = self.directory.join("resource");
        let text = fs::read_to_string(&path);
        let text = text.map_err(|source| PciError::Io { op: "reading", path, source })?;
        let line = text.lines().nth(usize::from(bar)).unwrap_or_default();
        let words: Vec<u64> = line
            .split_whitespace()
            .filter_map(|word| u64::from_str_radix(word.trim_start_matches("0x"), 16).ok())
            .collect();
        let space = match words[..] {
            [_, _, flags] if flags & RESOURCE_IO != 0 => Some(AddressSpace::Io),
            [_, _, flags] if flags & RESOURCE_MEM != 0 => Some(AddressSpace::Memory),
            _ => None,
        };
        let (Some(space), [start, end, _]) = (space, &words[..]) else {
            return Err(self.wrong_bar(
                bar,
                "none".to_owned(),
                "a BAR that the firmware gave an address".to_owned(),
            ));
        };
        let file = self.directory.join(format!("resource{bar}"));
        Ok(Bar { start: *start, size: end - start + 1, space, file })
    }

    /// Enables the card and checks its BAR as [`PciFunction::check`] does.
    ///
    /// # Errors
    /// When it is not as wanted, or the system refuses.
    pub fn prepare(&self, bar: u8, space: AddressSpace, size: usize) -> Result<Bar, PciError> {
        self.free()?;
        self.fits(bar, space, size)?;
        let enable = &self.directory.join("enable");
        let io = |op| move |source| PciError::Io { op, path: enable.clone(), source };
        if fs::read_to_string(enable).map_err(io("reading"))?.trim() == "0" {
            fs::write(enable, "1").map_err(io("enabling the card by"))?;
        }
        self.check(bar, space, size)
    }

    /// Checks that no kernel driver uses the card.
    /// Otherwise two masters would write the same registers. A driver that takes the memory would also remove our
    /// mapping.
    fn free(&self) -> Result<(), PciError> {
        let Ok(driver) = fs::read_link(self.directory.join("driver")) else { return Ok(()) };
        let driver = driver.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        if FOR_PROGRAMS.contains(&driver.as_str()) {
            return Ok(());
        }
        Err(PciError::Held { address: self.address.clone(), driver })
    }

    /// Checks that no driver has the card and that its BAR is usable.
    /// The BAR must be in `space`, have `size` bytes, and be switched on. Writes nothing.
    ///
    /// # Errors
    /// When a check fails, or the system refuses.
    pub fn check(&self, bar: u8, space: AddressSpace, size: usize) -> Result<Bar, PciError> {
        self.free()?;
        let found = self.fits(bar, space, size)?;
        let path = self.directory.join("config");
        let bytes = fs::read(&path).map_err(|source| PciError::Io { op: "reading", path, source })?;
        // PCI Local Bus Specification 3.0, 6.2.2: bit 0 of the command register lets it answer to I/O, bit 1 to memory.
        let command = bytes.get(4..6).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]));
        let (bit, name) = match space {
            AddressSpace::Io => (0, "I/O"),
            AddressSpace::Memory => (1, "memory"),
        };
        if command >> bit & 1 == 0 {
            return Err(PciError::Off { address: self.address.clone(), command, space: name });
        }
        Ok(found)
    }

    fn fits(&self, bar: u8, space: AddressSpace, size: usize) -> Result<Bar, PciError> {
        let found = self.bar(bar)?;
        if found.space == space && found.size >= size as u64 {
            return Ok(found);
        }
        let shown = |space, size| match space {
            AddressSpace::Memory => format!("{size} bytes of memory"),
            AddressSpace::Io => format!("{size} I/O ports"),
        };
        let expected = format!("at least {}", shown(space, size as u64));
        Err(self.wrong_bar(bar, shown(found.space, found.size), expected))
    }

    fn wrong_bar(&self, bar: u8, found: String, expected: String) -> PciError {
        PciError::Bar { address: self.address.clone(), bar, found, expected }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bus with two cards, both disabled until `enable` is written.
    /// `04.0` has memory at BAR 2 and I/O at BAR 0.
    fn bus(command: u8) -> tempfile::TempDir {
        let sysfs = tempfile::tempdir().unwrap();
        for (address, device) in
            [("0000:00:04.0", "0x1110"), ("0000:00:05.0", "0x1110"), ("0000:00:06.0", "0x1000")]
        {
            let card = sysfs.path().join(address);
            fs::create_dir(&card).unwrap();
            fs::write(card.join("vendor"), "0x1af4\n").unwrap();
            fs::write(card.join("device"), device).unwrap();
            fs::write(card.join("enable"), "0\n").unwrap();
            let none = "0x0000000000000000 0x0000000000000000 0x0000000000000000\n";
            let io = "0x000000000000c000 0x000000000000c01f 0x0000000000040101\n";
            let memory = "0x00000000fea00000 0x00000000feafffff 0x000000000014220c\n";
            fs::write(card.join("resource"), [io, none, memory, none].concat()).unwrap();
            fs::write(card.join("config"), [0xf4, 0x1a, 0x10, 0x11, command, 0, 0, 0]).unwrap();
        }
        sysfs
    }

    #[test]
    fn identities_are_those_of_lspci() {
        assert_eq!(PciFunctionSelector::parse("1af4:1110"), Some(PciFunctionSelector::Card(0x1af4, 0x1110)));
        assert_eq!(
            PciFunctionSelector::parse("0000:00:1F.3"),
            Some(PciFunctionSelector::Address("0000:00:1f.3".into()))
        );
        for wrong in ["", "1af4", "1af4:11", "00:04.0", "0000:00:04.8", "0x1af4:0x1110", "1af4:1110:0"] {
            assert_eq!(PciFunctionSelector::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_card_is_found_by_identity_or_address() {
        let sysfs = bus(2);
        let find = |id: &str| choose(functions_in(sysfs.path()), &PciFunctionSelector::parse(id).unwrap());
        assert_eq!(find("1af4:1000").unwrap().address, "0000:00:06.0");
        assert_eq!(find("0000:00:05.0").unwrap().id, (0x1af4, 0x1110));
        assert!(
            find("1af4:1110").unwrap_err().to_string().contains("2 PCI cards 1af4:1110, at 0000:00:04.0 and")
        );
        assert!(find("8086:0000").unwrap_err().to_string().contains("no PCI card 8086:0000"));
    }

    #[test]
    fn a_card_is_enabled_and_its_bar_and_command_register_checked() {
        let sysfs = bus(2);
        let card = &functions_in(sysfs.path())[0];
        let bar = card.prepare(2, AddressSpace::Memory, 8).unwrap();
        assert_eq!((bar.start, bar.size), (0xfea0_0000, 1 << 20));
        assert_eq!(bar.file, sysfs.path().join("0000:00:04.0/resource2"));
        assert_eq!(fs::read_to_string(sysfs.path().join("0000:00:04.0/enable")).unwrap(), "1");
        for (bar, space, size, wants) in [
            (2, AddressSpace::Io, 4, "BAR 2: found 1048576 bytes of memory, expected at least 4 I/O ports"),
            (0, AddressSpace::Io, 64, "BAR 0: found 32 I/O ports, expected at least 64 I/O ports"),
            (1, AddressSpace::Io, 4, "BAR 1: found none"),
            (7, AddressSpace::Io, 4, "BAR 7: found none"),
            (0, AddressSpace::Io, 4, "command register 0x0002 leaves I/O access off"),
        ] {
            let found = card.prepare(bar, space, size).unwrap_err().to_string();
            assert!(found.contains(wants), "{found}\n  wants {wants}");
        }
    }

    #[test]
    fn a_card_that_a_driver_works_with_is_left_alone() {
        let sysfs = bus(2);
        let card = &functions_in(sysfs.path())[0];
        let driver = |name: &str| {
            let link = sysfs.path().join("0000:00:04.0/driver");
            let _ = fs::remove_file(&link);
            std::os::unix::fs::symlink(format!("../../../bus/pci/drivers/{name}"), link).unwrap();
        };
        driver("8255_pci");
        for refused in [card.prepare(2, AddressSpace::Memory, 8), card.check(2, AddressSpace::Memory, 8)] {
            let text = refused.unwrap_err().to_string();
            assert!(
                text.starts_with("PCI card 0000:00:04.0 is in the hands of the kernel's driver 8255_pci"),
                "{text}"
            );
            assert!(text.ends_with("echo 0000:00:04.0 > driver/unbind"), "{text}");
        }
        assert_eq!(fs::read_to_string(sysfs.path().join("0000:00:04.0/enable")).unwrap(), "0\n");
        for name in FOR_PROGRAMS {
            driver(name);
            assert!(card.prepare(2, AddressSpace::Memory, 8).is_ok(), "{name}");
        }
    }
}
