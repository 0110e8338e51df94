//! Code that the daemon and its command line share.
//! It has the configuration, the checks on this computer, and the control protocol.
//!
//! | module | what |
//! |---|---|
//! | [`config`] | `rtec.toml`, read strictly: every finding with its line |
//! | [`protocol`] | requests and answers of the control socket |
//! | [`role`] | roles and their requests |
//! | [`audit`] | the record of every command: written, read, checked |
//! | [`client`] | the client's end of the socket |
//! | [`metrics`] | the status as `OpenMetrics` and Prometheus text |
//! | [`card`] | the real card that a configuration names, opened |
//! | [`wires`] | readings of a card's wired lines, and whether its outputs switch |
//! | [`profile`] | card profiles, from their files |
//! | [`ledger`] | an axis's ledger as files for a replay |
//! | [`lock`] | locks that allow one program per socket and per card |
//! | `closed` | directories that only their owners can write to |
//! | [`belongings`] | the files that make up a machine's set-up |
//! | `lines` | the lines and register bits that a configuration names |
//!
//! These do not belong here: decisions of the control law (`rtec-correct`), anything of a simulated machine
//! (`rtec-sim`), the daemon's own state.
//!
//! At work: `cargo run -p rtec-control --example check_config`, which the tests run too.

pub mod audit;
pub mod belongings;
pub mod card;
pub mod client;
mod closed;
pub mod config;
pub mod ledger;
mod lines;
pub mod lock;
pub mod metrics;
mod needs;
pub mod profile;
pub mod protocol;
pub mod role;
pub mod wires;
