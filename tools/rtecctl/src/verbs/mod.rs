//! One file per verb: its options and one function; `suspicions` is what several of them say of records.

pub(crate) mod bugreport;
pub(crate) mod card;
pub(crate) mod characterise;
pub(crate) mod clear;
pub(crate) mod commission;
pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod correct;
pub(crate) mod demo;
pub(crate) mod designs;
pub(crate) mod disable;
pub(crate) mod enable;
pub(crate) mod example;
pub(crate) mod explain;
pub(crate) mod get;
pub(crate) mod history;
pub(crate) mod hold;
pub(crate) mod home;
pub(crate) mod ledger;
pub(crate) mod log;
pub(crate) mod man;
pub(crate) mod metrics;
pub(crate) mod model;
pub(crate) mod papers;
pub(crate) mod park;
pub(crate) mod part;
pub(crate) mod platform;
pub(crate) mod probe;
pub(crate) mod reconcile;
pub(crate) mod replay;
pub(crate) mod selftest;
pub(crate) mod shadow;
pub(crate) mod ship;
pub(crate) mod simulate;
pub(crate) mod status;
pub(crate) mod suspicions;
pub(crate) mod top;
pub(crate) mod trace;
pub(crate) mod whoami;

use clap::builder::{PathBufValueParser, TypedValueParser};
use nix::unistd::{AccessFlags, access};
use std::path::{Path, PathBuf};

/// Of an option that names a file to write: whether it can be written is asked before the work, not after it.
pub(crate) fn output() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|file| can_be_written(&file).map(|()| file))
}

fn can_be_written(file: &Path) -> Result<(), String> {
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match std::fs::metadata(file) {
        Ok(there) if there.is_dir() => return Err("it is a folder, a file is to be written".to_owned()),
        // A pipe, a terminal: written through.
        Ok(there) if !there.is_file() => return Ok(()),
        _ => {}
    }
    if !folder.is_dir() {
        return Err(format!("no folder {} (make it first)", folder.display()));
    }
    access(folder, AccessFlags::W_OK)
        .map_err(|e| format!("nothing can be written into {}: {}", folder.display(), e.desc()))
}

#[cfg(test)]
mod tests {
    use super::can_be_written;

    #[test]
    fn a_file_that_cannot_be_written_is_refused_first() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("old.csv"), "t").unwrap();
        for name in ["new.csv", "old.csv"] {
            assert_eq!(can_be_written(&at(name)), Ok(()), "{name}");
        }
        assert_eq!(can_be_written(std::path::Path::new("/dev/null")), Ok(()));
        assert!(can_be_written(&at("none/new.csv")).unwrap_err().starts_with("no folder "));
        assert!(can_be_written(&at("old.csv/new.csv")).unwrap_err().starts_with("no folder "));
        assert!(can_be_written(folder.path()).unwrap_err().contains("is a folder"));
    }
}
