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
//! | [`line_readings`] | readings of a card's wired lines, and whether its outputs switch |
//! | [`profile`] | card profiles, from their files |
//! | [`ledger`] | an axis's ledger as files for a replay |
//! | [`lock`] | locks that allow one program per socket and per card |
//! | `owned_directory` | directories that only their owners can write to |
//! | [`setup_files`] | the files that make up a machine's set-up |
//! | `line_names` | the lines and register bits that a configuration names |
//!
//! These do not belong here: decisions of the control law (`rtec-correct`), anything of a simulated machine
//! (`rtec-sim`), the daemon's own state.
//!
//! At work: `cargo run -p rtec-control --example check_config`, which the tests run too.

pub mod audit;
pub mod card;
pub mod client;
pub mod config;
pub mod ledger;
mod line_names;
pub mod line_readings;
pub mod lock;
pub mod metrics;
mod owned_directory;
pub mod profile;
pub mod protocol;
mod required_role;
pub mod role;
pub mod setup_files;
