//! Writes files that appear whole or not at all.
//! A file is written under another name in its folder, made safe on the disk, then renamed. Until then, and
//! on any error, the previous file stays.

use crate::input_error::InputError;
use nix::fcntl::{AT_FDCWD, AtFlags};
use nix::unistd::linkat;
use std::collections::HashSet;
use std::fs::{File, Metadata, OpenOptions, Permissions};
use std::io::{self, Seek, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use tempfile::NamedTempFile;

/// The files that this process has read, by device and inode.
/// `None` if they are not recorded.
static INPUTS: Mutex<Option<HashSet<(u64, u64)>>> = Mutex::new(None);

/// From now on this process overwrites no file that it has read.
/// This suits a program that does one thing and ends: there a result in place of a measurement or a model is
/// a slip. It does not suit a daemon, which reads back what it writes.
pub fn spare_inputs() {
    INPUTS.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_default();
}

/// Records a file that is being read.
pub(crate) fn is_input(file: &File) {
    if let Some(inputs) = &mut *INPUTS.lock().unwrap_or_else(PoisonError::into_inner)
        && let Ok(is) = file.metadata()
    {
        inputs.insert((is.dev(), is.ino()));
    }
}

/// Refuses to overwrite a file that was read, so that the user loses nothing.
fn refuse_input_overwrite(file: &Path) -> io::Result<()> {
    is_no_input(file).map_err(io::Error::other)
}

/// Checks that a file to be written was not read, before the work begins.
///
/// # Errors
/// After [`spare_inputs`], the file was read.
pub fn is_no_input(file: &Path) -> Result<(), InputError> {
    let (Some(inputs), Ok(is)) =
        (&*INPUTS.lock().unwrap_or_else(PoisonError::into_inner), std::fs::metadata(file))
    else {
        return Ok(());
    };
    if !inputs.contains(&(is.dev(), is.ino())) {
        return Ok(());
    }
    let (found, expected) = ("a file that this command reads", "another name for what it writes");
    Err(InputError::whole(file, found, expected))
}

/// Writes a file whole or not at all.
///
/// # Errors
/// What the file system reports; then nothing is left behind, and the previous file stays.
pub fn write_atomically(file: &Path, content: &[u8]) -> io::Result<()> {
    let mut out = AtomicFile::create(file)?;
    out.write_all(content)?;
    out.finish()
}

/// A file that is being written.
/// It gets its name only in [`AtomicFile::finish`]; if it is dropped before, it leaves nothing.
///
/// A symbolic link stays; its target is replaced and keeps its permissions. What is not a regular file (a
/// pipe, a terminal, `/dev/null`) is written directly, because it cannot be replaced.
#[derive(Debug)]
pub struct AtomicFile(WriteTarget);

#[derive(Debug)]
enum WriteTarget {
    /// A file without a name until it is complete: a killed program leaves nothing.
    Unnamed {
        temporary: File,
        folder: PathBuf,
        file: PathBuf,
    },
    /// A file with another name, on file systems without nameless files.
    Beside {
        temporary: NamedTempFile,
        folder: PathBuf,
        file: PathBuf,
    },
    Through(File),
}

impl AtomicFile {
    /// Starts a file.
    ///
    /// # Errors
    /// Its folder cannot be written to; or, after [`spare_inputs`], it was read.
    pub fn create(file: &Path) -> io::Result<Self> {
        let before = std::fs::metadata(file).ok();
        if before.as_ref().is_some_and(|m| !m.is_file() && !m.is_dir()) {
            return Ok(Self(WriteTarget::Through(OpenOptions::new().write(true).open(file)?)));
        }
        refuse_input_overwrite(file)?;
        let file = if before.is_some() { std::fs::canonicalize(file)? } else { file.to_owned() };
        let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
        // As for any new file: read and write for all, less the process's umask.
        let mode = before.as_ref().map_or(0o666, |m| m.permissions().mode() & 0o777);
        let before = before.as_ref().map(Metadata::permissions);
        let unnamed = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_TMPFILE)
            .mode(mode | 0o200)
            .open(&folder);
        if let Ok(temporary) = unnamed {
            before.map(|before| temporary.set_permissions(before)).transpose()?;
            return Ok(Self(WriteTarget::Unnamed { temporary, folder, file }));
        }
        let temporary = beside(&folder, mode)?;
        before.map(|before| temporary.as_file().set_permissions(before)).transpose()?;
        Ok(Self(WriteTarget::Beside { temporary, folder, file }))
    }

    /// Gives the file its name, once all of it is safe on the disk.
    ///
    /// # Errors
    /// What the file system reports, or, after [`spare_inputs`], the file was read. Nothing is left behind
    /// then.
    pub fn finish(self) -> io::Result<()> {
        match self.0 {
            WriteTarget::Through(mut out) => out.flush(),
            WriteTarget::Unnamed { temporary, folder, file } => {
                refuse_input_overwrite(&file)?;
                temporary.sync_all()?;
                let mut named = tempfile::Builder::new();
                let named = named.prefix(HIDDEN).make_in(&folder, |path| name(&temporary, path));
                match named {
                    Ok(named) => named.persist(file).map_err(|e| e.error)?,
                    Err(_) => return Self::copied(temporary, &folder, &file),
                }
                sync_folder(&File::open(folder)?)
            }
            WriteTarget::Beside { temporary, folder, file } => {
                refuse_input_overwrite(&file)?;
                temporary.as_file().sync_all()?;
                temporary.persist(file).map_err(|e| e.error)?;
                sync_folder(&File::open(folder)?)
            }
        }
    }

    fn file(&mut self) -> &mut File {
        match &mut self.0 {
            WriteTarget::Unnamed { temporary, .. } => temporary,
            WriteTarget::Beside { temporary, .. } => temporary.as_file_mut(),
            WriteTarget::Through(out) => out,
        }
    }

    /// Copies a nameless file if it cannot be given a name: without /proc.
    fn copied(mut temporary: File, folder: &Path, file: &Path) -> io::Result<()> {
        let permissions = temporary.metadata()?.permissions();
        let mut named = beside(folder, permissions.mode())?;
        temporary.rewind()?;
        io::copy(&mut temporary, &mut named)?;
        named.as_file().set_permissions(permissions)?;
        named.as_file().sync_all()?;
        named.persist(file).map_err(|e| e.error)?;
        sync_folder(&File::open(folder)?)
    }
}

/// The prefix of the name of a file that is being written.
const HIDDEN: &str = ".rtec-";

fn beside(folder: &Path, mode: u32) -> io::Result<NamedTempFile> {
    let mut temporary = tempfile::Builder::new();
    temporary.prefix(HIDDEN).permissions(Permissions::from_mode(mode | 0o200)).tempfile_in(folder)
}

/// Gives a nameless file a name.
fn name(unnamed: &File, path: &Path) -> io::Result<()> {
    let own = format!("/proc/self/fd/{}", unnamed.as_raw_fd());
    linkat(AT_FDCWD, own.as_str(), AT_FDCWD, path, AtFlags::AT_SYMLINK_FOLLOW).map_err(io::Error::from)
}

/// Makes the names in a folder safe on the disk.
pub(crate) fn sync_folder(folder: &File) -> io::Result<()> {
    match folder.sync_all() {
        // Some file systems cannot sync a folder.
        Err(e) if e.kind() == io::ErrorKind::InvalidInput => Ok(()),
        done => done,
    }
}

impl Write for AtomicFile {
    fn write(&mut self, content: &[u8]) -> io::Result<usize> {
        self.file().write(content)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file().flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::{FileTypeExt, symlink};
    use std::os::unix::net::UnixListener;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_there_whole_or_as_before() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.toml");
        let mut out = AtomicFile::create(&file).unwrap();
        out.write_all(b"half").unwrap();
        assert!(!file.exists());
        drop(out);
        assert!(names(folder.path()).is_empty());
        write_atomically(&file, b"one").unwrap();
        let mut out = AtomicFile::create(&file).unwrap();
        out.write_all(b"half").unwrap();
        drop(out);
        assert_eq!(fs::read(&file).unwrap(), b"one");
        write_atomically(&file, b"two").unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"two");
        assert_eq!(names(folder.path()), ["a.toml"]);
    }

    #[test]
    fn a_file_being_written_has_no_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.toml");
        let mut out = AtomicFile::create(&file).unwrap();
        out.write_all(b"half").unwrap();
        // A killed program runs no destructor.
        assert!(!matches!(out.0, WriteTarget::Unnamed { .. }) || names(folder.path()).is_empty());
        out.finish().unwrap();
        let mut copied = AtomicFile::create(&file).unwrap();
        copied.write_all(b"other").unwrap();
        if let WriteTarget::Unnamed { temporary, folder, file } = copied.0 {
            AtomicFile::copied(temporary, &folder, &file).unwrap();
            assert_eq!(fs::read(&file).unwrap(), b"other");
        }
        assert_eq!(names(folder.path()), ["a.toml"]);
    }

    #[test]
    fn nothing_is_left_behind_when_the_name_cannot_be_taken() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        fs::write(taken.join("inside"), "x").unwrap();
        write_atomically(&taken, b"no").unwrap_err();
        assert_eq!(names(folder.path()), ["taken"]);
        write_atomically(&folder.path().join("none/a.toml"), b"no").unwrap_err();
        assert_eq!(names(folder.path()), ["taken"]);
    }

    #[test]
    fn permissions_and_links_stay() {
        let folder = tempfile::tempdir().unwrap();
        let (plain, file, link) =
            (folder.path().join("plain"), folder.path().join("f"), folder.path().join("link"));
        // Another program's new file has the permissions that the umask leaves; so has this one.
        fs::write(&plain, "x").unwrap();
        write_atomically(&file, b"one").unwrap();
        let mode = |f: &Path| fs::metadata(f).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&file), mode(&plain));
        fs::set_permissions(&file, Permissions::from_mode(0o640)).unwrap();
        symlink("f", &link).unwrap();
        write_atomically(&link, b"two").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!((fs::read(&file).unwrap().as_slice(), mode(&file)), (b"two".as_slice(), 0o640));
        assert_eq!(names(folder.path()), ["f", "link", "plain"]);
    }

    #[test]
    fn what_is_no_regular_file_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("socket");
        let _listener = UnixListener::bind(&file).unwrap();
        write_atomically(&file, b"x").unwrap_err();
        assert!(fs::symlink_metadata(&file).unwrap().file_type().is_socket());
        assert_eq!(names(folder.path()), ["socket"]);
    }
}
