//! Opens the real cards that a configuration names, for work or only for reading.

use crate::config::{CardConfig, MappedPlace, PortPlace};
use rtec_driver::card::{Card, CardError};
use rtec_driver::clock::Monotonic;
use rtec_driver::gpio::{GpioCard, GpioError, GpioSetup};
use rtec_driver::mapped::{MapError, MappedCard, Registers};
use rtec_driver::pci::{self, Bar, PciError, PciId};
use rtec_driver::port::{Parport, PortError, Ports};
use rtec_driver::profile::{Profile, Space};
use rtec_driver::registers::{Bus, RegisterCard, SetUpError};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

/// Reason why a card could not be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum OpenError {
    /// The GPIO lines cannot be requested.
    #[error(transparent)]
    Gpio(#[from] GpioError),
    /// The registers cannot be mapped.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The PCI card cannot be used.
    #[error(transparent)]
    Pci(#[from] PciError),
    /// The I/O ports cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The card is not what its profile says.
    #[error(transparent)]
    SetUp(#[from] SetUpError),
    /// A card that is opened for reading only does not answer.
    #[error(transparent)]
    Card(#[from] CardError),
    /// A card that is opened for reading only has not been set up since its reset.
    #[error(
        "register {offset:#x} reads {found:#x}, expected {value:#x}: the card has not been set up since its reset, and only \
         reading does not set it up. Start the daemon once, or use --drive with the MTC off"
    )]
    NotSetUp { offset: usize, found: u32, value: u32 },
    /// A simulated machine or a recording.
    #[error("backend \"{0}\" has no lines outside the daemon")]
    NoLines(&'static str),
}

/// An operation on a card of any backend.
pub trait OnCard {
    /// Its result.
    type Output;

    /// Performs the operation.
    fn on<C: Card + Send + 'static>(self, card: C) -> Self::Output;
}

/// Whether a card may be written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Nothing is enabled, set up or requested as an output.
    /// Reading may still latch the card's counters.
    Read,
    /// The card is opened as the daemon opens it.
    Drive,
}

/// Opens the card that a configuration names and passes it to `what`.
///
/// # Errors
/// When it cannot be opened, or is a simulated one.
pub fn with<W: OnCard>(card: &CardConfig, access: Access, what: W) -> Result<W::Output, OpenError> {
    match card {
        CardConfig::Mock | CardConfig::Replay { .. } => Err(OpenError::NoLines(card.backend())),
        CardConfig::Gpio(setup) => {
            let mut setup = setup.clone();
            if access == Access::Read {
                setup.outputs.clear();
            }
            Ok(what.on(gpio(&setup, Vec::new())?))
        }
        CardConfig::Mapped { place, profile } => {
            let (file, map) = register_file(place, profile, access)?;
            on_registers(
                Registers::open_map(&file, map, profile.size(), &profile.name)?,
                profile,
                access,
                what,
            )
        }
        CardConfig::Port { place, profile } => {
            let base = match place {
                PortPlace::Parport(file) => return on_registers(Parport::open(file)?, profile, access, what),
                PortPlace::Io(base) => *base,
                PortPlace::Pci(id, bar) => first_io_port(id, *bar, profile, access)?,
            };
            on_registers(Ports::open(base, profile.size())?, profile, access, what)
        }
    }
}

fn on_registers<B: Bus + Send + 'static, W: OnCard>(
    bus: B,
    profile: &Profile,
    access: Access,
    what: W,
) -> Result<W::Output, OpenError> {
    let mut profile = profile.clone();
    if access == Access::Read {
        for setup in &profile.setup {
            let (register, value) = (setup.order.register, setup.order.value);
            let found = bus.read(register.offset, register.width)?;
            if found != value {
                return Err(OpenError::NotSetUp { offset: register.offset, found, value });
            }
        }
        profile.setup.clear();
    }
    Ok(what.on(RegisterCard::new(bus, &profile, Monotonic)?))
}

/// Opens GPIO lines; `kept` are output requests of an earlier process.
///
/// # Errors
/// As [`GpioCard::open`].
pub fn gpio(setup: &GpioSetup, kept: Vec<OwnedFd>) -> Result<GpioCard<Monotonic>, OpenError> {
    Ok(GpioCard::open(setup, kept, Monotonic)?)
}

/// Finds a BAR of a PCI card; with [`Access::Drive`] also enables the card.
fn bar(id: &PciId, bar: u8, space: Space, profile: &Profile, access: Access) -> Result<Bar, PciError> {
    let card = pci::find(id)?;
    match access {
        Access::Read => card.check(bar, space, profile.size()),
        Access::Drive => card.prepare(bar, space, profile.size()),
    }
}

/// File of the mapped registers, and the number of its map.
/// For a PCI card it is the file of the BAR.
///
/// # Errors
/// When the PCI card is not as it should be.
pub fn register_file(
    place: &MappedPlace,
    profile: &Profile,
    access: Access,
) -> Result<(PathBuf, u8), OpenError> {
    Ok(match place {
        MappedPlace::File(file) => (file.clone(), 0),
        MappedPlace::Uio(file, map) => (file.clone(), *map),
        MappedPlace::Pci(id, n) => (bar(id, *n, Space::Memory, profile, access)?.file, 0),
    })
}

/// Opens a file of registers.
///
/// # Errors
/// As [`MappedCard::open_map`].
pub fn mapped(file: &Path, map: u8, profile: &Profile) -> Result<MappedCard<Monotonic>, OpenError> {
    Ok(MappedCard::open_map(file, map, profile, Monotonic)?)
}

/// Opens a parallel port through its driver.
///
/// # Errors
/// When it cannot be claimed, or is not as the profile says.
pub fn parport(file: &Path, profile: &Profile) -> Result<RegisterCard<Parport, Monotonic>, OpenError> {
    Ok(RegisterCard::new(Parport::open(file)?, profile, Monotonic)?)
}

/// The first I/O port of a BAR.
///
/// # Errors
/// When the PCI card is not as it should be.
pub fn first_io_port(id: &PciId, number: u8, profile: &Profile, access: Access) -> Result<u16, OpenError> {
    Ok(bar(id, number, Space::Io, profile, access)?.start as u16)
}

/// Opens I/O ports accessed by the processor's own instructions.
///
/// # Errors
/// When the kernel refuses them, or the card is not as the profile says.
pub fn ports(base: u16, profile: &Profile) -> Result<RegisterCard<Ports, Monotonic>, OpenError> {
    Ok(RegisterCard::new(Ports::open(base, profile.size())?, profile, Monotonic)?)
}
