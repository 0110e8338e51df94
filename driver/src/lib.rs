//! The wires between scales, corrector and machine-tool controller (MTC).
//!
//! This crate reads no file formats: profiles and traces come as data. It contains no insertion, gate, ledger or
//! thread. It does not know what an axis should be corrected by, or when.
//!
//! At work: `cargo run -p rtec-driver --example count_edges`, which the tests run too.

pub mod card; // the interface of an I/O card to the engine
pub mod card_profile; // register and bit of each line, as data
pub mod clock; // the source of a card's time
pub mod gpio; // a card of GPIO lines, through the kernel's character device
pub mod mapped_registers; // registers that are memory: a file, a PCI BAR, UIO
pub mod mock_card; // a card in the same process
pub mod pci; // a card on the PCI bus: found, enabled, checked
pub mod port_io; // registers that are I/O ports: parallel port, 8255 cards
pub mod quadrature; // the state table of two signals in quadrature, and a decoder that counts
pub mod register_card; // a card of registers, and of the card's own counters, however they are reached
pub mod trace_replay; // a recorded trace on a virtual clock
