//! A small disk that a test can fill.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A small file system in memory, mounted at a path for as long as this lives.
#[derive(Debug)]
pub struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts a disk of `size_kb` in a new directory.
    /// Returns `None` where nothing can be mounted.
    pub fn mount(at: &Path, size_kb: u32) -> Option<Self> {
        std::fs::create_dir(at).unwrap_or_else(|e| panic!("{}: {e}", at.display()));
        let size = format!("size={size_kb}k");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output();
        mount.is_ok_and(|m| m.status.success()).then(|| Self(at.to_owned()))
    }

    fn filler(&self) -> PathBuf {
        self.0.join("fill")
    }

    /// Fills the disk.
    pub fn fill(&self) {
        let mut file = File::create(self.filler()).unwrap_or_else(|e| panic!("{}: {e}", self.0.display()));
        while file.write(&[0; 1024]).is_ok_and(|n| n > 0) {}
    }

    /// Removes the file that filled it.
    pub fn free(&self) {
        std::fs::remove_file(self.filler()).unwrap_or_else(|e| panic!("{}: {e}", self.0.display()));
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
    }
}
