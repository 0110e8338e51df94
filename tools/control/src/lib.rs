//! What the daemon and its command line share.
//! It has the configuration, the checks on this computer, and the control protocol.
//!
//! | module | what |
//! |---|---|
//! | [`config`] | `rtec.toml`, read strictly: every finding with its line |
//! | [`protocol`] | requests and answers of the control socket |
//! | [`role`] | who may ask for what |
//! | [`audit`] | the record of every command: written, read, checked |
//! | [`client`] | the client's end of it |
//! | [`metrics`] | the status as `OpenMetrics` and Prometheus text |
//! | [`card`] | the real card that a configuration names, opened |
//! | [`wires`] | what a card's wired lines say, and whether its outputs switch |
//! | [`profile`] | card profiles, from their files |
//! | [`ledger`] | an axis's ledger as files that a replay plays |
//! | [`lock`] | one program at a time on a socket, on a card |
//! | `closed` | directories into which nobody but their owners can put anything |
//! | [`belongings`] | the files that make up a machine's set-up |
//! | `lines` | the lines and register bits that a configuration names |
//!
//! What must not live here: decisions of the control law (`rtec-correct`), anything of a simulated machine (`rtec-sim`),
//! the daemon's own state.
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
