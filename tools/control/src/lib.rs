//! Code that the daemon and its command line share.
//! It has the configuration, the checks on this computer, and the control protocol.
//!
//! These do not belong here: decisions of the control law (`rtec-correct`), anything of a simulated machine
//! (`rtec-sim`), the daemon's own state.
//!
//! At work: `cargo run -p rtec-control --example check_config`, which the tests run too.

pub mod audit_log; // the record of every command: written, read, checked
mod card_line_names; // the lines and register bits that a configuration names
pub mod card_line_readings; // readings of a card's wired lines, and whether its outputs switch
pub mod card_opening; // the real card that a configuration names, opened
pub mod card_profile_file; // card profiles, from their files
pub mod client_role; // roles, their requests, and the role that each request needs
pub mod config; // `rtec.toml`, read strictly: every finding with its line
pub mod daemon_client; // the client's end of the socket
pub mod ledger_export; // an axis's ledger as files for a replay
pub mod metrics; // the status as `OpenMetrics` and Prometheus text
mod owner_only_directory; // directories that only their owners can write to
pub mod protocol; // requests and answers of the control socket
pub mod setup_files;
pub mod single_process_lock; // locks that allow one program per socket and per card // the files that make up a machine's set-up
