//! Opens the real cards that a configuration names, for work or only for reading.

use crate::config::{CardConfig, RegisterPlace};
use rtec_driver::card::{Card, CardError};
use rtec_driver::card_profile::{AddressSpace, CardProfile};
use rtec_driver::clock::Monotonic;
use rtec_driver::gpio::{GpioCard, GpioCardConfig, GpioError};
use rtec_driver::mapped_registers::{MapError, MappedCard, MappedRegisterFile};
use rtec_driver::pci::{self, PciError};
use rtec_driver::port_io::{IoPorts, Parport, PortError};
use rtec_driver::register_card::{RegisterAccess, RegisterCard, SetUpError};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

/// Reason why a card could not be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum CardOpenError {
    #[error(transparent)]
    Gpio(#[from] GpioError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Pci(#[from] PciError),
    #[error(transparent)]
    Port(#[from] PortError),
    #[error(transparent)]
    SetUp(#[from] SetUpError),
    #[error(transparent)]
    Card(#[from] CardError),
    #[error(
        "register {offset:#x} reads {found:#x}, expected {value:#x}: the card has not been set up since its reset, and only \
         reading does not set it up. Start the daemon once, or use --drive with the MTC off"
    )]
    NotSetUp { offset: usize, found: u32, value: u32 },
    #[error("backend \"{0}\" has no lines outside the daemon")]
    NoLines(&'static str),
}

/// An operation on a card of any backend.
pub trait CardOperation {
    /// Its result.
    type Output;

    /// Performs the operation.
    fn on<C: Card + Send + 'static>(self, card: C) -> Self::Output;
}

/// Whether a card may be written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CardAccess {
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
pub fn with<W: CardOperation>(
    card: &CardConfig,
    access: CardAccess,
    what: W,
) -> Result<W::Output, CardOpenError> {
    match card {
        CardConfig::Mock | CardConfig::Replay { .. } => Err(CardOpenError::NoLines(card.backend())),
        CardConfig::Gpio(setup) => {
            let mut setup = setup.clone();
            if access == CardAccess::Read {
                setup.outputs.clear();
            }
            Ok(what.on(gpio(&setup, Vec::new())?))
        }
        CardConfig::Registers { place, profile } => match find(place, profile, access)? {
            LocatedRegisters::Map(file, map) => {
                on_registers(open_map(&file, map, profile)?, profile, access, what)
            }
            LocatedRegisters::Parport(file) => on_registers(Parport::open(&file)?, profile, access, what),
            LocatedRegisters::Ports(base) => {
                on_registers(IoPorts::open(base, profile.size())?, profile, access, what)
            }
        },
    }
}

fn on_registers<B: RegisterAccess + Send + 'static, W: CardOperation>(
    bus: B,
    profile: &CardProfile,
    access: CardAccess,
    what: W,
) -> Result<W::Output, CardOpenError> {
    let mut profile = profile.clone();
    if access == CardAccess::Read {
        for setup in &profile.setup {
            let (register, value) = (setup.order.register, setup.order.value);
            let found = bus.read(register.offset, register.width)?;
            if found != value {
                return Err(CardOpenError::NotSetUp { offset: register.offset, found, value });
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
pub fn gpio(setup: &GpioCardConfig, kept: Vec<OwnedFd>) -> Result<GpioCard<Monotonic>, CardOpenError> {
    Ok(GpioCard::open(setup, kept, Monotonic)?)
}

/// Where registers were found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LocatedRegisters {
    /// The file to be mapped, and the number of its map.
    Map(PathBuf, u8),
    /// The parallel port's device.
    Parport(PathBuf),
    /// The first I/O port.
    Ports(u16),
}

/// Finds registers: those of a PCI card by its BAR.
/// With [`CardAccess::Drive`] it also enables the PCI card.
///
/// # Errors
/// When the PCI card is not as it should be.
pub fn find(
    place: &RegisterPlace,
    profile: &CardProfile,
    access: CardAccess,
) -> Result<LocatedRegisters, CardOpenError> {
    Ok(match place {
        RegisterPlace::File(file) => LocatedRegisters::Map(file.clone(), 0),
        RegisterPlace::Uio(file, map) => LocatedRegisters::Map(file.clone(), *map),
        RegisterPlace::Parport(file) => LocatedRegisters::Parport(file.clone()),
        RegisterPlace::Io(base) => LocatedRegisters::Ports(*base),
        RegisterPlace::Pci(id, bar, space) => {
            let (card, size) = (pci::find(id)?, profile.size());
            let bar = match access {
                CardAccess::Read => card.check(*bar, *space, size)?,
                CardAccess::Drive => card.prepare(*bar, *space, size)?,
            };
            if *space == AddressSpace::Memory {
                LocatedRegisters::Map(bar.file, 0)
            } else {
                LocatedRegisters::Ports(bar.start as u16)
            }
        }
    })
}

pub(crate) fn open_map(
    file: &Path,
    map: u8,
    profile: &CardProfile,
) -> Result<MappedRegisterFile, CardOpenError> {
    Ok(MappedRegisterFile::open_map(file, map, profile.size(), &profile.name)?)
}

/// Opens a file of registers.
///
/// # Errors
/// As [`MappedCard::open_map`].
pub fn mapped(file: &Path, map: u8, profile: &CardProfile) -> Result<MappedCard<Monotonic>, CardOpenError> {
    Ok(MappedCard::open_map(file, map, profile, Monotonic)?)
}

/// Opens a parallel port through its driver.
///
/// # Errors
/// When it cannot be claimed, or is not as the profile says.
pub fn parport(
    file: &Path,
    profile: &CardProfile,
) -> Result<RegisterCard<Parport, Monotonic>, CardOpenError> {
    Ok(RegisterCard::new(Parport::open(file)?, profile, Monotonic)?)
}

/// Opens I/O ports accessed by the processor's own instructions.
///
/// # Errors
/// When the kernel refuses them, or the card is not as the profile says.
pub fn ports(base: u16, profile: &CardProfile) -> Result<RegisterCard<IoPorts, Monotonic>, CardOpenError> {
    Ok(RegisterCard::new(IoPorts::open(base, profile.size())?, profile, Monotonic)?)
}
