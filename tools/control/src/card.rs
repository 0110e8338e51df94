//! The real cards that a configuration names, opened.

use crate::config::MappedPlace;
use rtec_driver::clock::Monotonic;
use rtec_driver::gpio::{GpioCard, GpioError, GpioSetup};
use rtec_driver::mapped::{MapError, MappedCard};
use rtec_driver::pci::{self, PciError, PciId};
use rtec_driver::port::{Parport, PortError, Ports};
use rtec_driver::profile::{Profile, Space};
use rtec_driver::registers::{RegisterCard, SetUpError};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

/// Why a card could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The GPIO lines cannot be had.
    #[error(transparent)]
    Gpio(#[from] GpioError),
    /// The registers cannot be mapped.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A card on the PCI bus.
    #[error(transparent)]
    Pci(#[from] PciError),
    /// The I/O ports cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The card is not what its profile says.
    #[error(transparent)]
    SetUp(#[from] SetUpError),
}

/// GPIO lines; `kept` are the output requests of the process before.
///
/// # Errors
/// As [`GpioCard::open`].
pub fn gpio(setup: &GpioSetup, kept: Vec<OwnedFd>) -> Result<GpioCard<Monotonic>, OpenError> {
    Ok(GpioCard::open(setup, kept, Monotonic)?)
}

/// The file that the mapped registers are in, and which map of it: of a PCI card the BAR's, once the card is enabled.
///
/// # Errors
/// When the PCI card is not as it should be.
pub fn register_file(place: &MappedPlace, profile: &Profile) -> Result<(PathBuf, u8), OpenError> {
    Ok(match place {
        MappedPlace::File(file) => (file.clone(), 0),
        MappedPlace::Uio(file, map) => (file.clone(), *map),
        MappedPlace::Pci(id, bar) => (pci::find(id)?.prepare(*bar, Space::Memory, profile.size())?.file, 0),
    })
}

/// A file of registers.
///
/// # Errors
/// As [`MappedCard::open_map`].
pub fn mapped(file: &Path, map: u8, profile: &Profile) -> Result<MappedCard<Monotonic>, OpenError> {
    Ok(MappedCard::open_map(file, map, profile, Monotonic)?)
}

/// A parallel port by its driver.
///
/// # Errors
/// When it cannot be claimed, or is not as the profile says.
pub fn parport(file: &Path, profile: &Profile) -> Result<RegisterCard<Parport, Monotonic>, OpenError> {
    Ok(RegisterCard::new(Parport::open(file)?, profile, Monotonic)?)
}

/// The first I/O port of a BAR, once the card is enabled.
///
/// # Errors
/// When the PCI card is not as it should be.
pub fn io_bar(id: &PciId, bar: u8, profile: &Profile) -> Result<u16, OpenError> {
    Ok(pci::find(id)?.prepare(bar, Space::Io, profile.size())?.start as u16)
}

/// I/O ports by the processor's own instructions.
///
/// # Errors
/// When the kernel refuses them, or the card is not as the profile says.
pub fn ports(base: u16, profile: &Profile) -> Result<RegisterCard<Ports, Monotonic>, OpenError> {
    Ok(RegisterCard::new(Ports::open(base, profile.size())?, profile, Monotonic)?)
}
