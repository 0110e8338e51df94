//! Archives: tar files, with the size of each member, readable only by this user.

use crate::CommandFailure;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// An archive that is being written.
/// Without [`Archive::finish`] it is removed.
pub(crate) struct Archive<'p> {
    path: &'p Path,
    tar: Option<tar::Builder<File>>,
    now_s: u64,
}

impl<'p> Archive<'p> {
    /// Creates it. It never overwrites a file and never follows a symbolic link.
    pub(crate) fn create(path: &'p Path) -> anyhow::Result<Self> {
        let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
        let file = file.map_err(|e| {
            CommandFailure::Bad(format!("{}: {e}; expected a name that is free", path.display()))
        })?;
        Ok(Self { path, tar: Some(tar::Builder::new(file)), now_s: now_s() })
    }

    pub(crate) fn add(&mut self, name: &str, bytes: &[u8]) -> std::io::Result<()> {
        let mut header = tar::Header::new_gnu();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o600);
        header.set_mtime(self.now_s);
        header.set_cksum();
        match &mut self.tar {
            Some(tar) => tar.append_data(&mut header, name, bytes),
            None => Ok(()),
        }
    }

    /// Completes the archive and waits until it is on the disk.
    pub(crate) fn finish(mut self) -> std::io::Result<()> {
        let Some(tar) = self.tar.take() else { return Ok(()) };
        let done = tar.into_inner().and_then(|file| file.sync_all());
        if done.is_err() {
            let _ = std::fs::remove_file(self.path);
        }
        done
    }
}

impl Drop for Archive<'_> {
    fn drop(&mut self) {
        if self.tar.is_some() {
            let _ = std::fs::remove_file(self.path);
        }
    }
}

/// Seconds since 1970.
pub(crate) fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}
