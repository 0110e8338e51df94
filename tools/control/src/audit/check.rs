//! The record read, and the chain of its lines checked.

use super::writer::Link;
use super::{Entry, Head, LONGEST_LINE, NOTHING, files, head_path, read_head};
use rtec_model::record::hex;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A record that changes while it is read is read again, so often at most.
const TRIES: usize = 5;
/// And after this time.
const MOMENT: Duration = Duration::from_millis(5);

/// A line that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// The file.
    pub file: PathBuf,
    /// Its line, from 1.
    pub line: usize,
    /// What it says; or what is wrong with it.
    pub entry: Result<Entry, String>,
    /// The line as it stands.
    pub text: String,
    hash: String,
}

/// Reads the record, oldest line first.
///
/// # Errors
/// A file that cannot be read.
pub fn read(path: &Path, each: &mut dyn FnMut(Line)) -> io::Result<()> {
    let all = files(path);
    if all.is_empty() {
        // Says that it is not there, in the system's words.
        File::open(path)?;
    }
    for file in all {
        // A pipe would be waited for, a device has no end.
        let open = rtec_files::text::open_regular(&file).map_err(|error| io::Error::other(error.found))?;
        let mut reader = BufReader::new(open);
        let mut line = 0;
        loop {
            let mut bytes = Vec::new();
            if (&mut reader).take(LONGEST_LINE).read_until(b'\n', &mut bytes)? == 0 {
                break;
            }
            line += 1;
            let whole = bytes.ends_with(b"\n");
            let text = String::from_utf8_lossy(bytes.trim_ascii_end()).into_owned();
            each(understand(&file, line, text, whole));
        }
    }
    Ok(())
}

fn understand(file: &Path, line: usize, text: String, whole: bool) -> Line {
    let hash = text.rsplit_once(",\"hash\":\"").map(|(body, hash)| (body, hash.trim_end_matches("\"}")));
    let entry = match hash {
        _ if !whole => Err("it has no end".to_owned()),
        None => Err("it has no hash".to_owned()),
        Some((body, hash)) if hex(&Sha256::digest(body)) != hash => {
            Err("it was changed: its hash is another".to_owned())
        }
        Some((body, _)) => serde_json::from_str(&format!("{body}}}")).map_err(|e| e.to_string()),
    };
    let hash = hash.map_or(String::new(), |(_, hash)| hash.to_owned());
    Line { file: file.to_owned(), line, entry, text, hash }
}

/// What was found wrong with the chain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Broken {
    /// The file.
    pub file: PathBuf,
    /// Its line, from 1; 0 where it is about the file.
    pub line: usize,
    /// What is wrong.
    pub what: String,
}

/// What a look at the whole chain found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Verified {
    /// Lines that were read.
    pub lines: u64,
    /// Number of the first and of the last one.
    pub numbers: [u64; 2],
    /// Commands that could not be recorded, by the record's own word.
    pub lost: u64,
    /// Everything that is wrong; empty where the record is whole.
    pub broken: Vec<Broken>,
}

/// Checks every line, and that none is missing, changed or in another place.
///
/// # Errors
/// A file that cannot be read.
pub fn verify(path: &Path) -> io::Result<Verified> {
    let mut last = None;
    for _ in 0..TRIES {
        let found = check(path, read_head(path).as_ref());
        match found {
            Ok(found) if found.broken.is_empty() || last.as_ref() == Some(&found) => return Ok(found),
            Ok(found) => last = Some(found),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => return Err(error),
            Err(_) => last = None,
        }
        // A line half written, files that change their names: a moment later they are as they should be.
        std::thread::sleep(MOMENT);
    }
    check(path, read_head(path).as_ref())
}

fn check(path: &Path, head: Option<&Head>) -> io::Result<Verified> {
    let mut found = Verified::default();
    let mut before: Option<(u64, String)> = None;
    let mut marks: BTreeMap<u64, String> = BTreeMap::new();
    read(path, &mut |read| {
        found.lines += 1;
        let mut broken = |what: String| {
            found.broken.push(Broken { file: read.file.clone(), line: read.line, what });
        };
        let entry = match &read.entry {
            Ok(entry) => entry,
            Err(why) => {
                broken(why.clone());
                // What follows is judged by what this line claims to be.
                if let Ok(link) = serde_json::from_str::<Link>(&read.text) {
                    before = Some((link.n, link.hash));
                }
                return;
            }
        };
        match &before {
            Some((n, _)) if entry.n != n + 1 => {
                broken(format!("line number {} after {n}: lines are missing, or in another place", entry.n));
            }
            Some((_, hash)) if *hash != entry.prev => {
                broken("it does not follow the line before it".to_owned());
            }
            // Earlier lines than it must have are no loss.
            None if head.is_some_and(|h| h.first_n < entry.n) => {
                let first = head.map_or(1, |h| h.first_n);
                broken(format!("the record begins with line number {}, and should with {first}", entry.n));
            }
            None if entry.n == 1 && entry.prev != NOTHING => {
                broken("the first line follows another one".to_owned());
            }
            _ => {}
        }
        if found.numbers[0] == 0 {
            found.numbers[0] = entry.n;
        }
        found.numbers[1] = entry.n;
        if entry.what == "lost" {
            found.lost += entry.times.unwrap_or(0);
        }
        if head.is_some_and(|h| h.n == entry.n) {
            marks.insert(entry.n, read.hash.clone());
        }
        before = Some((entry.n, read.hash));
    })?;
    // What was written while it was read is no surprise.
    let now_n = read_head(path).map_or(0, |h| h.n);
    let what = match head {
        None => Some(format!(
            "{} is missing or not to be read: whether the end is whole is not known",
            head_path(path).display()
        )),
        Some(head) if found.numbers[1] < head.n => {
            Some(format!("it ends with line number {}, and should with {}", found.numbers[1], head.n))
        }
        // One line may have been written just before a crash; more than that nobody wrote here.
        Some(head) if found.numbers[1] > head.n.max(now_n) + 1 => {
            Some(format!("it ends with line number {}, and should with {}", found.numbers[1], head.n))
        }
        Some(head) if marks.get(&head.n).is_some_and(|hash| *hash != head.hash) => {
            Some(format!("line number {} is another one than was written last", head.n))
        }
        Some(_) => None,
    };
    if let Some(what) = what {
        found.broken.push(Broken { file: path.to_owned(), line: 0, what });
    }
    Ok(found)
}
