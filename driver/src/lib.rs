//! The wires between scales, corrector and machine-tool controller (MTC).
//!
//! | module | what |
//! |---|---|
//! | [`quadrature`] | the state table of two signals in quadrature, and a decoder that counts |
//! | [`card`] | the interface of an I/O card to the engine |
//! | [`clock`] | the source of a card's time |
//! | [`profile`] | register and bit of each line, as data |
//! | [`gpio`] | a card of GPIO lines, through the kernel's character device |
//! | [`registers`] | a card of registers, and of the card's own counters, however they are reached |
//! | [`mapped`] | registers that are memory: a file, a PCI BAR, UIO |
//! | [`pci`] | a card on the PCI bus: found, enabled, checked |
//! | [`port`] | registers that are I/O ports: parallel port, 8255 cards |
//! | [`mock`] | a card in the same process |
//! | [`replay`] | a recorded trace on a virtual clock |
//!
//! This crate reads no file formats: profiles and traces come as data. It contains no insertion, gate, ledger or
//! thread. It does not know what an axis should be corrected by, or when.
//!
//! At work: `cargo run -p rtec-driver --example count_edges`, which the tests run too.

pub mod card;
pub mod clock;
pub mod gpio;
pub mod mapped;
pub mod mock;
pub mod pci;
pub mod port;
pub mod profile;
pub mod quadrature;
pub mod registers;
pub mod replay;
