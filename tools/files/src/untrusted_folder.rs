//! A folder that other users may write to.
//! Examples are a shop's share, a spool, and the target of a restored backup. Every step uses an open folder
//! (openat(2)) and follows no link, so that nobody can redirect a write or a read.

use crate::atomic_write::sync_folder;
use nix::dir::Dir;
use nix::errno::Errno;
use nix::fcntl::{AtFlags, Flock, FlockArg, OFlag, RenameFlags, openat, renameat, renameat2};
use nix::sys::stat::{Mode, fchmod, fstatat, mkdirat};
use nix::unistd::{UnlinkatFlags, unlinkat};
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// The prefix of the names of temporary files.
const TEMPORARY: &str = ".rtec-part-";
/// Bytes that are written between two checks whether to continue.
const PIECE: usize = 1 << 20;

/// An open folder.
#[derive(Debug)]
pub struct UntrustedFolder {
    fd: OwnedFd,
    path: PathBuf,
}

impl UntrustedFolder {
    /// Opens an existing folder.
    /// Links in `path` itself are followed, because the caller chose it.
    ///
    /// # Errors
    /// It is no folder, or cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        if !file.metadata()?.is_dir() {
            return Err(io::ErrorKind::NotADirectory.into());
        }
        Ok(Self { fd: file.into(), path: path.to_owned() })
    }

    /// The path that it was opened with, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The permission bits of the folder.
    ///
    /// # Errors
    /// What the system reports.
    pub fn mode(&self) -> io::Result<u32> {
        Ok(File::from(self.fd.try_clone()?).metadata()?.permissions().mode() & 0o7777)
    }

    /// Opens a folder in this one.
    ///
    /// # Errors
    /// Nothing has that name, or it is something else, for example a link.
    pub fn folder(&self, name: &str) -> io::Result<Self> {
        let path = self.path.join(plain(name)?);
        let flags = OFlag::O_RDONLY | OFlag::O_DIRECTORY | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
        let fd = openat(&self.fd, name, flags, Mode::empty()).map_err(|e| linked(&path, e))?;
        Ok(Self { fd, path })
    }

    /// Makes a new folder in this one.
    ///
    /// # Errors
    /// Something has that name already (kind `AlreadyExists`), or it cannot be made.
    pub fn new_folder(&self, name: &str) -> io::Result<Self> {
        mkdirat(&self.fd, plain(name)?, Mode::from_bits_truncate(0o777))?;
        self.folder(name)
    }

    /// Opens a folder in this one, and makes it if it is missing.
    ///
    /// # Errors
    /// As [`UntrustedFolder::folder`], or it cannot be made.
    pub fn make_folder(&self, name: &str) -> io::Result<Self> {
        match self.new_folder(name) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => self.folder(name),
            made => made,
        }
    }

    /// Whether something in it has this name; a link counts too.
    ///
    /// # Errors
    /// What the system reports.
    pub fn has(&self, name: &str) -> io::Result<bool> {
        match fstatat(&self.fd, plain(name)?, AtFlags::AT_SYMLINK_NOFOLLOW) {
            Ok(_) => Ok(true),
            Err(Errno::ENOENT) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Opens a regular file in it.
    ///
    /// # Errors
    /// Nothing has that name, or it is a link or no regular file.
    pub fn file(&self, name: &str) -> io::Result<File> {
        let path = self.path.join(plain(name)?);
        // Non-blocking, because opening a pipe would wait before its kind could be checked.
        let flags = OFlag::O_RDONLY | OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
        let file = File::from(openat(&self.fd, name, flags, Mode::empty()).map_err(|e| linked(&path, e))?);
        if !file.metadata()?.is_file() {
            let text = format!(
                "{}: found a folder, pipe, socket or device, expected a regular file",
                path.display()
            );
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
        Ok(file)
    }

    /// Reads a regular file; `None` if nothing has that name.
    ///
    /// # Errors
    /// As [`UntrustedFolder::file`], or it is longer than `longest` bytes.
    pub fn read(&self, name: &str, longest: u64) -> io::Result<Option<Vec<u8>>> {
        let file = match self.file(name) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            file => file?,
        };
        let mut bytes = Vec::new();
        file.take(longest + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > longest {
            let text = format!("{}: found more than {longest} bytes", self.path.join(name).display());
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
        }
        Ok(Some(bytes))
    }

    /// Writes a file in one step: it appears whole or not at all.
    /// It replaces whatever had its name before, a link too. `go_on` is called between pieces; if it returns
    /// false, nothing is written.
    ///
    /// # Errors
    /// What the file system reports; of kind `Interrupted` if `go_on` stopped it.
    pub fn write(&self, name: &str, content: &[u8], mode: u32, go_on: &dyn Fn() -> bool) -> io::Result<()> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        plain(name)?;
        self.sweep_parts()?;
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let part = format!("{TEMPORARY}{}-{number}", std::process::id());
        let flags = OFlag::O_WRONLY | OFlag::O_CREAT | OFlag::O_EXCL | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
        let file = File::from(openat(&self.fd, part.as_str(), flags, Mode::from_bits_truncate(mode))?);
        // The lock is held while writing. An unlocked file therefore shows that its writer has died. Some
        // shares have no locks.
        let held = Flock::lock(file, FlockArg::LockExclusiveNonblock);
        let mut file = match &held {
            Ok(held) => held.try_clone()?,
            Err((file, _)) => file.try_clone()?,
        };
        let written = (|| {
            // Independent of the process's umask.
            fchmod(&file, Mode::from_bits_truncate(mode))?;
            for piece in content.chunks(PIECE) {
                if !go_on() {
                    return Err(given_up());
                }
                file.write_all(piece)?;
            }
            file.sync_all()?;
            if !go_on() {
                return Err(given_up());
            }
            Ok(renameat(&self.fd, part.as_str(), &self.fd, name)?)
        })();
        if written.is_err() {
            let _ = self.remove(&part);
        }
        written.and_then(|()| self.sync())
    }

    /// Removes temporary files of writers that were killed.
    fn sweep_parts(&self) -> io::Result<()> {
        for name in self.names()? {
            if name.starts_with(TEMPORARY)
                && let Ok(file) = self.file(&name)
                && Flock::lock(file, FlockArg::LockExclusiveNonblock).is_ok()
            {
                let _ = self.remove(&name);
            }
        }
        Ok(())
    }

    /// Renames a file or folder, within this folder or into another.
    /// An existing target stays, and is an error of kind `AlreadyExists`.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn rename(&self, name: &str, to: &Self, new: &str) -> io::Result<()> {
        plain(name)?;
        plain(new)?;
        match renameat2(&self.fd, name, &to.fd, new, RenameFlags::RENAME_NOREPLACE) {
            // The file system has no such flag, so the names are checked first.
            Err(Errno::EINVAL | Errno::ENOSYS) if to.has(new)? => Err(io::ErrorKind::AlreadyExists.into()),
            Err(Errno::EINVAL | Errno::ENOSYS) => Ok(renameat(&self.fd, name, &to.fd, new)?),
            done => Ok(done?),
        }
    }

    /// Removes a file, or a link but not its target.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        Ok(unlinkat(&self.fd, plain(name)?, UnlinkatFlags::NoRemoveDir)?)
    }

    /// Removes an empty folder in it.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn remove_folder(&self, name: &str) -> io::Result<()> {
        Ok(unlinkat(&self.fd, plain(name)?, UnlinkatFlags::RemoveDir)?)
    }

    /// Locks the folder for this process; `None` if another one holds the lock.
    /// File systems that cannot lock folders give an error.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn lock(&self) -> io::Result<Option<Flock<File>>> {
        match Flock::lock(File::from(self.fd.try_clone()?), FlockArg::LockExclusiveNonblock) {
            Ok(held) => Ok(Some(held)),
            Err((_, Errno::EWOULDBLOCK)) => Ok(None),
            Err((_, error)) => Err(error.into()),
        }
    }

    /// The names in it, sorted; names that are not UTF-8 are left out.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn names(&self) -> io::Result<Vec<String>> {
        let flags = OFlag::O_RDONLY | OFlag::O_DIRECTORY | OFlag::O_CLOEXEC;
        let mut dir = Dir::openat(&self.fd, ".", flags, Mode::empty())?;
        let mut names = Vec::new();
        for entry in dir.iter() {
            let entry = entry?;
            if let Ok(name) = entry.file_name().to_str()
                && !matches!(name, "." | "..")
            {
                names.push(name.to_owned());
            }
        }
        names.sort();
        Ok(names)
    }

    /// The space of its regular files on the disk, bytes: at least a block each.
    /// Files in its subfolders are not counted.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn bytes(&self) -> io::Result<u64> {
        let mut bytes = 0_u64;
        for name in self.names()? {
            if let Ok(file) = self.file(&name) {
                bytes += (file.metadata()?.blocks() * 512).max(4096);
            }
        }
        Ok(bytes)
    }

    /// Makes renames in it safe on the disk.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn sync(&self) -> io::Result<()> {
        sync_folder(&File::from(self.fd.try_clone()?))
    }
}

impl AsFd for UntrustedFolder {
    fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

/// Checks that a name is one path component that stays in the folder.
fn plain(name: &str) -> io::Result<&str> {
    let mut parts = Path::new(name).components();
    match (parts.next(), parts.next()) {
        (Some(Component::Normal(part)), None) if part == name => Ok(name),
        _ => {
            let text = format!("found {name:?}, expected the name of a file without a folder");
            Err(io::Error::new(io::ErrorKind::InvalidInput, text))
        }
    }
}

fn given_up() -> io::Error {
    io::Error::new(io::ErrorKind::Interrupted, "given up")
}

/// Says in words that opening failed because of a link.
fn linked(path: &Path, error: Errno) -> io::Error {
    let is_link = || path.symlink_metadata().is_ok_and(|m| m.is_symlink());
    match error {
        Errno::ELOOP | Errno::ENOTDIR if is_link() => {
            let text = format!(
                "{}: found a link, expected a file or folder: no link is followed here",
                path.display()
            );
            io::Error::new(io::ErrorKind::InvalidInput, text)
        }
        error => error.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    const ALWAYS: &dyn Fn() -> bool = &|| true;

    #[test]
    fn follows_no_link_in_any_place() {
        let (there, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let folder = UntrustedFolder::open(there.path()).unwrap();
        let precious = other.path().join("precious");
        std::fs::write(&precious, "mine").unwrap();
        symlink(other.path(), there.path().join("folder")).unwrap();
        symlink(&precious, there.path().join("file")).unwrap();
        for result in [folder.folder("folder").map(drop), folder.make_folder("folder").map(drop)] {
            assert!(result.unwrap_err().to_string().contains("found a link"));
        }
        assert!(folder.file("file").unwrap_err().to_string().contains("found a link"));
        // The written file replaces the link.
        folder.write("file", b"new", 0o644, ALWAYS).unwrap();
        assert_eq!(std::fs::read(&precious).unwrap(), b"mine");
        assert_eq!(folder.read("file", 10).unwrap().unwrap(), b"new");
        for name in ["../x", "a/b", "..", ".", "", "/etc/passwd"] {
            assert!(folder.write(name, b"", 0o644, ALWAYS).is_err(), "{name}");
            assert!(folder.read(name, 10).is_err(), "{name}");
        }
        assert!(folder.read("file", 2).unwrap_err().to_string().contains("more than 2 bytes"));
        assert!(folder.read("none", 2).unwrap().is_none());
    }

    #[test]
    fn leaves_nothing_behind_when_given_up_or_killed() {
        let there = tempfile::tempdir().unwrap();
        let folder = UntrustedFolder::open(there.path()).unwrap();
        let error = folder.write("a", &vec![0; 3 * PIECE], 0o600, &|| false).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::Interrupted);
        assert!(folder.names().unwrap().is_empty());
        // A killed writer holds no lock; a living one does.
        let (dead, alive) = (format!("{TEMPORARY}1-0"), format!("{TEMPORARY}1-1"));
        std::fs::write(there.path().join(&dead), "half").unwrap();
        let file = File::create(there.path().join(&alive)).unwrap();
        let _held = Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, e)| e).unwrap();
        folder.write("a", b"whole", 0o600, ALWAYS).unwrap();
        assert_eq!(folder.names().unwrap(), [alive, "a".to_owned()]);
    }

    #[test]
    fn renames_over_nothing() {
        let there = tempfile::tempdir().unwrap();
        let folder = UntrustedFolder::open(there.path()).unwrap();
        folder.write("a", b"1", 0o600, ALWAYS).unwrap();
        folder.write("b", b"2", 0o600, ALWAYS).unwrap();
        assert_eq!(folder.rename("a", &folder, "b").unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        folder.rename("a", &folder, "c").unwrap();
        assert_eq!(folder.names().unwrap(), ["b", "c"]);
        assert_eq!(folder.bytes().unwrap(), 8192);
    }
}
