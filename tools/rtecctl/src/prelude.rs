//! Names that nearly every verb uses.

pub(crate) use crate::CommandFailure;
pub(crate) use crate::daemon_connection::DaemonArgs;
pub(crate) use crate::json_output::{answer, list, pretty, say_line, say_pretty};
pub(crate) use crate::say;
pub(crate) use anyhow::Context as _;
pub(crate) use rtec_files::InputError;
pub(crate) use serde_json::{Value, json};
pub(crate) use std::fmt::Write as _;
pub(crate) use std::path::{Path, PathBuf};
pub(crate) use std::time::Duration;
