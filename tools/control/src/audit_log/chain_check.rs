//! Reads the record and checks the chain of its lines.

use super::writer::AuditChainLink;
use super::{AuditChainHead, Entry, LONGEST_LINE, NOTHING, files, head_path, read_head, refused_path};
use rtec_model::record::hex;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A record that changes while it is read is read again, at most this often.
const TRIES: usize = 5;
/// Wait before it is read again.
const MOMENT: Duration = Duration::from_millis(5);

/// A line that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct ChainLine {
    /// The file.
    pub file: PathBuf,
    /// Its line, from 1.
    pub line: usize,
    /// The entry, or what is wrong with the line.
    pub entry: Result<Entry, String>,
    /// The line's text.
    pub text: String,
    /// It is in the chain of refusals.
    pub refused: bool,
    hash: String,
}

/// Reads the record and its refusals, oldest line first.
///
/// # Errors
/// A file that cannot be read.
pub fn read(path: &Path, each: &mut dyn FnMut(ChainLine)) -> io::Result<()> {
    let refused = refused_path(path);
    if files(path).is_empty() {
        // Reports in the system's words that it does not exist.
        File::open(path)?;
    }
    let mut chains =
        [AuditChainLines::of(path, false).peekable(), AuditChainLines::of(&refused, true).peekable()];
    loop {
        // Merged by time; as text, times sort by year. A damaged line keeps its place among its neighbours.
        let time = |line: Option<&io::Result<ChainLine>>| match line? {
            Ok(ChainLine { entry: Ok(entry), .. }) => Some(entry.t.clone()),
            _ => Some(String::new()),
        };
        let [first, second] = &mut chains;
        let (a, b) = (time(first.peek()), time(second.peek()));
        // At equal times the command comes first, then the fault that it latched.
        let chain = if b.is_none() || a.is_some() && a < b { first } else { second };
        let Some(line) = chain.next() else { return Ok(()) };
        each(line?);
    }
}

/// The lines of one chain, oldest first.
struct AuditChainLines {
    files: VecDeque<PathBuf>,
    refused: bool,
    /// The file being read, and the number of lines read from it.
    open: Option<(PathBuf, BufReader<File>, usize)>,
}

impl AuditChainLines {
    fn of(path: &Path, refused: bool) -> Self {
        Self { files: files(path).into(), refused, open: None }
    }

    fn read(&mut self) -> io::Result<Option<ChainLine>> {
        loop {
            let Some((file, reader, line)) = &mut self.open else {
                let Some(file) = self.files.pop_front() else { return Ok(None) };
                // A pipe would block, and a device has no end.
                let open =
                    rtec_files::text_file::open_regular(&file).map_err(|e| io::Error::other(e.found))?;
                self.open = Some((file, BufReader::new(open), 0));
                continue;
            };
            let mut bytes = Vec::new();
            if reader.take(LONGEST_LINE).read_until(b'\n', &mut bytes)? == 0 {
                self.open = None;
                continue;
            }
            *line += 1;
            let whole = bytes.ends_with(b"\n");
            let text = String::from_utf8_lossy(bytes.trim_ascii_end()).into_owned();
            return Ok(Some(ChainLine { refused: self.refused, ..understand(file, *line, text, whole) }));
        }
    }
}

impl Iterator for AuditChainLines {
    type Item = io::Result<ChainLine>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

fn understand(file: &Path, line: usize, text: String, whole: bool) -> ChainLine {
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
    ChainLine { file: file.to_owned(), line, entry, text, refused: false, hash }
}

/// A mistake found in the chain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ChainBreak {
    /// The file.
    pub file: PathBuf,
    /// Its line, from 1; 0 if the mistake concerns the whole file.
    pub line: usize,
    /// The mistake, in words.
    pub what: String,
}

/// The end of a chain, published where the daemon's rights do not reach.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChainAnchor {
    /// It belongs to the chain of refusals.
    pub refused: bool,
    /// Number of the line.
    pub n: u64,
    /// Its hash.
    pub hash: String,
}

const ANCHORED: &str = "record of commands: line ";
const ANCHORED_REFUSED: &str = "; of refusals: line ";

impl ChainAnchor {
    /// Text that publishes the ends of both chains.
    pub fn text((n, hash): (u64, &str), refused: Option<(u64, &str)>) -> String {
        let refused = refused.map_or(String::new(), |(n, hash)| format!("{ANCHORED_REFUSED}{n} {hash}"));
        format!("{ANCHORED}{n} {hash}{refused}")
    }

    /// All anchors in a text, as `journalctl` prints it.
    pub fn all(text: &str) -> Vec<Self> {
        let one = |text: &str, refused| {
            let mut words = text.split(|c: char| !c.is_ascii_alphanumeric());
            let (n, hash) = (words.next()?.parse().ok()?, words.next()?);
            (hash.len() == NOTHING.len()).then(|| Self { refused, n, hash: hash.to_owned() })
        };
        let of =
            |line: &str, mark: &str, refused| line.split_once(mark).and_then(|(_, rest)| one(rest, refused));
        text.lines().flat_map(|l| [of(l, ANCHORED, false), of(l, ANCHORED_REFUSED, true)]).flatten().collect()
    }
}

/// Result of a check of the whole chain.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ChainCheckResult {
    /// Lines that were read.
    pub lines: u64,
    /// Numbers of the first and the last line.
    pub numbers: [u64; 2],
    /// Commands that could not be recorded, as the record states.
    pub lost: u64,
    /// Lines of refusals.
    pub refused: u64,
    /// All mistakes; empty if the record is whole.
    pub broken: Vec<ChainBreak>,
}

/// Checks that no line is missing, changed or moved.
/// It also checks that the chain contains every anchor.
///
/// # Errors
/// A file that cannot be read.
pub fn verify(path: &Path, anchors: &[ChainAnchor]) -> io::Result<ChainCheckResult> {
    let of = |refused: bool| {
        let of_chain = anchors.iter().filter(|a| a.refused == refused);
        of_chain.map(|a| (a.n, a.hash.as_str())).collect::<BTreeMap<_, _>>()
    };
    let refused = refused_path(path);
    let mut found = verify_chain(path, &of(false))?;
    let anchored = of(true);
    if !files(&refused).is_empty() || read_head(&refused).is_some() || !anchored.is_empty() {
        let beside = verify_chain(&refused, &anchored)?;
        found.refused = beside.lines;
        found.lost += beside.lost;
        found.broken.extend(beside.broken);
    }
    Ok(found)
}

fn verify_chain(path: &Path, anchors: &BTreeMap<u64, &str>) -> io::Result<ChainCheckResult> {
    let mut last = None;
    for _ in 0..TRIES {
        let found = check(path, read_head(path).as_ref(), anchors);
        match found {
            Ok(found) if found.broken.is_empty() || last.as_ref() == Some(&found) => return Ok(found),
            Ok(found) => last = Some(found),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => return Err(error),
            Err(_) => last = None,
        }
        // A line half written, or files being renamed: a moment later they are consistent.
        std::thread::sleep(MOMENT);
    }
    check(path, read_head(path).as_ref(), anchors)
}

fn check(
    path: &Path,
    head: Option<&AuditChainHead>,
    anchors: &BTreeMap<u64, &str>,
) -> io::Result<ChainCheckResult> {
    let mut found = ChainCheckResult::default();
    let mut before: Option<(u64, String)> = None;
    let mut marks: BTreeMap<u64, String> = BTreeMap::new();
    if files(path).is_empty() && anchors.is_empty() {
        File::open(path)?;
    }
    for read in AuditChainLines::of(path, false) {
        let read = read?;
        found.lines += 1;
        let mut broken = |what: String| {
            found.broken.push(ChainBreak { file: read.file.clone(), line: read.line, what });
        };
        let entry = match &read.entry {
            Ok(entry) => entry,
            Err(why) => {
                broken(why.clone());
                // The next lines are compared with what this line claims.
                if let Ok(link) = serde_json::from_str::<AuditChainLink>(&read.text) {
                    before = Some((link.n, link.hash));
                }
                continue;
            }
        };
        match &before {
            Some((n, _)) if entry.n != n + 1 => {
                broken(format!("line number {} after {n}: lines are missing, or in another place", entry.n));
            }
            Some((_, hash)) if *hash != entry.prev => {
                broken("it does not follow the line before it".to_owned());
            }
            // Lines older than the head requires are no fault.
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
        if anchors.get(&entry.n).is_some_and(|hash| *hash != read.hash) {
            broken(format!("line number {} is another one than the anchor says", entry.n));
        }
        if head.is_some_and(|h| h.n == entry.n) {
            marks.insert(entry.n, read.hash.clone());
        }
        before = Some((entry.n, read.hash));
    }
    if let Some((n, _)) = anchors.last_key_value().filter(|(n, _)| **n > found.numbers[1]) {
        let what =
            format!("it ends with line number {}, and the anchor knows line number {n}", found.numbers[1]);
        found.broken.push(ChainBreak { file: path.to_owned(), line: 0, what });
    }
    // Lines written during the check are accepted.
    let now_n = read_head(path).map_or(0, |h| h.n);
    let what = match head {
        None => Some(format!(
            "{} is missing or not to be read: whether the end is whole is not known",
            head_path(path).display()
        )),
        // A crash can leave one line that the head does not know, never more.
        Some(head) if !(head.n..=head.n.max(now_n) + 1).contains(&found.numbers[1]) => {
            Some(format!("it ends with line number {}, and should with {}", found.numbers[1], head.n))
        }
        Some(head) if marks.get(&head.n).is_some_and(|hash| *hash != head.hash) => {
            Some(format!("line number {} is another one than was written last", head.n))
        }
        Some(_) => None,
    };
    if let Some(what) = what {
        found.broken.push(ChainBreak { file: path.to_owned(), line: 0, what });
    }
    Ok(found)
}
