//! The record's writer: one process at a time.
//! It must not run on a thread that cannot wait for a disk.

use super::{
    AuditChainHead, Entry, FILES, FULL, LONGEST_LINE, NOTHING, files, head_path, read_head, with_suffix,
};
use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use serde::Deserialize;
use std::fs::{File, Metadata, OpenOptions, Permissions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};

/// Writes the record.
/// Only one process may use it at a time, on a thread that may wait for a disk.
#[derive(Debug)]
pub struct AuditLogWriter {
    path: PathBuf,
    file: Option<File>,
    bytes: u64,
    pub(super) full: u64,
    group: Option<u32>,
    head: AuditChainHead,
    /// The locked file of the head; the lock keeps other writers out.
    held: Option<Flock<File>>,
    /// The head on disk is older than the record's last line.
    head_behind: bool,
    /// Number of files kept.
    keeps: usize,
    /// Number of removed or renamed files or heads, and number of full files.
    moved: u64,
    rotated: u64,
}

impl AuditLogWriter {
    /// A writer that continues where the record ends.
    /// It opens the file at its first line.
    pub fn new(path: &Path) -> Self {
        let head = AuditChainHead { n: 0, hash: NOTHING.to_owned(), first_n: 1 };
        Self {
            path: path.to_owned(),
            file: None,
            bytes: 0,
            full: FULL,
            group: None,
            head,
            held: None,
            head_behind: false,
            keeps: FILES,
            moved: 0,
            rotated: 0,
        }
    }

    /// Sets the number of files that are kept.
    #[must_use]
    pub fn keeping(self, files: usize) -> Self {
        Self { keeps: files, ..self }
    }

    /// How often others removed or renamed the file or its head.
    pub fn moved(&self) -> u64 {
        self.moved
    }

    /// How often a full file was renamed.
    pub fn rotated(&self) -> u64 {
        self.rotated
    }

    /// Sets a group whose members may read the files.
    #[must_use]
    pub fn readable_by(self, group: Option<u32>) -> Self {
        Self { group, ..self }
    }

    /// Number and hash of the last line.
    pub fn last(&self) -> (u64, &str) {
        (self.head.n, &self.head.hash)
    }

    /// Adds a line, whole or not at all.
    ///
    /// # Errors
    /// What the file system reports; the chain continues with the next line.
    pub fn append(&mut self, mut entry: Entry) -> io::Result<()> {
        self.look()?;
        if self.file.is_none() {
            self.open()?;
        }
        if self.bytes >= self.full {
            self.rotate()?;
        }
        (entry.n, entry.prev) = (self.head.n + 1, self.head.hash.clone());
        let (mut line, hash) = entry.line()?;
        line.push('\n');
        let Some(file) = &mut self.file else { return Err(io::ErrorKind::NotFound.into()) };
        if let Err(error) = file.write_all(line.as_bytes()) {
            // Removes half a line. If that fails too, the next start finds it torn.
            let _ = file.set_len(self.bytes);
            self.file = None;
            return Err(error);
        }
        self.bytes += line.len() as u64;
        (self.head.n, self.head.hash) = (entry.n, hash);
        // The line is written, even if its head is not: `sync` reports that.
        self.head_behind = self.write_head().is_err();
        Ok(())
    }

    /// Starts new files if the open ones were removed or renamed, and records that.
    fn look(&mut self) -> io::Result<()> {
        let is_there = |file: Option<&File>, path: &Path| {
            file.is_none_or(|file| {
                let same = |a: Metadata, b: Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
                std::fs::symlink_metadata(path)
                    .is_ok_and(|now| file.metadata().is_ok_and(|open| same(open, now)))
            })
        };
        let file = is_there(self.file.as_ref(), &self.path);
        let head = is_there(self.held.as_deref(), &head_path(&self.path));
        if file && head {
            return Ok(());
        }
        self.moved += 1;
        let what = if file { "its head was" } else { "its file was" };
        self.file = None;
        if !head {
            self.held = None;
        }
        self.open()?;
        let text = format!("{what} removed or renamed: another one was begun");
        self.append(Entry { text, ..Entry::now("moved") })
    }

    /// Waits until everything written is on the disk.
    ///
    /// # Errors
    /// What the file system reports.
    pub fn sync(&mut self) -> io::Result<()> {
        if self.head_behind {
            self.write_head()?;
            self.head_behind = false;
        }
        self.file.as_ref().map_or(Ok(()), File::sync_data)
    }

    fn open(&mut self) -> io::Result<()> {
        self.hold()?;
        let mut file = own(OpenOptions::new().read(true).append(true).create(true)).open(&self.path)?;
        if !file.metadata()?.is_file() {
            return Err(io::Error::other("it is no regular file"));
        }
        self.grant_group_read(&file);
        let torn = whole_lines(&mut file)?;
        let known = self.head.n > 0;
        let mut missing = None;
        if !known {
            let head = read_head(&self.path);
            let last = files(&self.path).iter().rev().find_map(|f| last_line(f));
            // The head may know more lines than the files: lines that were cut off must be missed.
            if let Some(head) = head {
                self.head = head;
            }
            let ended = last.as_ref().map_or(0, |(n, _)| *n);
            missing = (ended < self.head.n)
                .then(|| format!("it ended with line number {ended}, and should with {}", self.head.n));
            if let Some((n, hash)) = last.filter(|(n, _)| *n > self.head.n) {
                (self.head.n, self.head.hash) = (n, hash);
            }
        }
        self.bytes = file.metadata()?.len();
        self.file = Some(file);
        if torn > 0 {
            self.append(Entry { times: Some(torn), ..Entry::now("torn") })?;
        }
        if let Some(text) = missing {
            self.append(Entry { text, ..Entry::now("missing") })?;
        }
        Ok(())
    }

    /// Lets the group read a file, regardless of the process's umask.
    /// If the group cannot be set, only the daemon's user may read it.
    fn grant_group_read(&self, file: &File) {
        if self.group.is_some() && fchown(file, None, self.group).is_ok() {
            let _ = file.set_permissions(Permissions::from_mode(0o640));
        }
    }

    /// Locks the head's file, once.
    fn hold(&mut self) -> io::Result<()> {
        if self.held.is_some() {
            return Ok(());
        }
        let file = own(OpenOptions::new().read(true).write(true).create(true)).open(head_path(&self.path))?;
        self.grant_group_read(&file);
        let held = Flock::lock(file, FlockArg::LockExclusiveNonblock).map_err(|(_, errno)| match errno {
            Errno::EWOULDBLOCK => {
                io::Error::other("another process writes it: each rtecd needs a record of its own")
            }
            errno => errno.into(),
        })?;
        self.held = Some(held);
        Ok(())
    }

    fn name(&self, n: usize) -> PathBuf {
        if n == 0 { self.path.clone() } else { with_suffix(&self.path, &n.to_string()) }
    }

    /// Notes the future first line before the files are renamed.
    /// A kill in between leaves more lines than promised, never fewer.
    pub(super) fn begin_rotation(&mut self) -> io::Result<()> {
        // The oldest file is overwritten if the one before it exists.
        let goes = self.name(self.keeps - 1);
        let kept =
            files(&self.path).into_iter().filter(|f| *f != goes || !self.name(self.keeps - 2).exists());
        self.head.first_n = kept.into_iter().find_map(|f| first_line(&f)).unwrap_or(self.head.n + 1);
        self.write_head()
    }

    fn rotate(&mut self) -> io::Result<()> {
        self.begin_rotation()?;
        for n in (0..self.keeps - 1).rev().filter(|n| self.name(*n).exists()) {
            std::fs::rename(self.name(n), self.name(n + 1))?;
        }
        self.file = None;
        self.rotated += 1;
        self.open()
    }

    fn write_head(&self) -> io::Result<()> {
        let Some(file) = &self.held else { return Err(io::ErrorKind::NotFound.into()) };
        let text = serde_json::to_string(&self.head).map_err(io::Error::other)?;
        // Padded to one length, so that a shorter text overwrites a longer one.
        file.write_all_at(format!("{text:<160}\n").as_bytes(), 0)
    }
}

/// Options of the record's files: readable by the group, no symbolic links.
fn own(options: &mut OpenOptions) -> &mut OpenOptions {
    options.mode(0o640).custom_flags((nix::fcntl::OFlag::O_NOFOLLOW | nix::fcntl::OFlag::O_NONBLOCK).bits())
}

/// Length of a file, bytes, and its end, in which at least one line is whole.
fn tail(file: &mut File) -> io::Result<(u64, Vec<u8>)> {
    let len = file.metadata()?.len();
    file.seek(SeekFrom::Start(len.saturating_sub(LONGEST_LINE)))?;
    let mut tail = Vec::new();
    file.take(LONGEST_LINE).read_to_end(&mut tail)?;
    Ok((len, tail))
}

/// Cuts off an unfinished last line; returns the bytes removed.
fn whole_lines(file: &mut File) -> io::Result<u64> {
    let (len, tail) = tail(file)?;
    let end = tail.iter().rposition(|b| *b == b'\n').map_or(0, |n| n + 1);
    let torn = (tail.len() - end) as u64;
    if torn > 0 {
        file.set_len(len - torn)?;
    }
    Ok(torn)
}

#[derive(Deserialize)]
pub(super) struct AuditChainLink {
    pub n: u64,
    pub hash: String,
}

fn last_line(file: &Path) -> Option<(u64, String)> {
    let (_, tail) = tail(&mut File::open(file).ok()?).ok()?;
    let line = tail.split(|b| *b == b'\n').rfind(|l| !l.is_empty())?;
    serde_json::from_slice(line).ok().map(|AuditChainLink { n, hash }| (n, hash))
}

fn first_line(file: &Path) -> Option<u64> {
    let mut line = Vec::new();
    BufReader::new(File::open(file).ok()?.take(LONGEST_LINE)).read_until(b'\n', &mut line).ok()?;
    serde_json::from_slice(&line).ok().map(|link: AuditChainLink| link.n)
}
