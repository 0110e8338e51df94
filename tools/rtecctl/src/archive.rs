//! Archives: tar files, with the size of each member, readable only by this user.

use crate::CommandFailure;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};
use tempfile::TempPath;

/// An archive that is being written.
/// Without [`ArchiveWriter::finish`] it is removed.
pub(crate) struct ArchiveWriter {
    tar: tar::Builder<File>,
    path: TempPath,
    now_s: u64,
}

impl ArchiveWriter {
    /// Creates it. It never overwrites a file and never follows a symbolic link.
    pub(crate) fn create(path: &Path) -> anyhow::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let file = file.map_err(|e| {
            CommandFailure::Bad(format!("{}: {e}; expected a name that is free", path.display()))
        })?;
        Ok(Self { tar: tar::Builder::new(file), path: TempPath::try_from_path(path)?, now_s: now_s() })
    }

    pub(crate) fn add(&mut self, name: &str, bytes: &[u8]) -> std::io::Result<()> {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o600);
        header.set_mtime(self.now_s);
        header.set_cksum();
        self.tar.append_data(&mut header, name, bytes)
    }

    /// Completes the archive and waits until it is on the disk.
    pub(crate) fn finish(self) -> std::io::Result<()> {
        self.tar.into_inner()?.sync_all()?;
        self.path.keep()?;
        Ok(())
    }
}

/// Seconds since 1970.
pub(crate) fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}
