//! What the daemon and its command line share: the configuration and the control protocol.
//!
//! | module | what |
//! |---|---|
//! | [`config`] | `rtec.toml`, read strictly: every finding with its line |

pub mod config;
mod section;
