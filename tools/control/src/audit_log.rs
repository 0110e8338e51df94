//! The record of every command: its user, time, request and result.
//!
//! One JSON object a line, each with its number and chained to the one before it:
//!
//! ```text
//! {"n":7,"t":"2026-11-22T13:00:00.123Z","what":"command","by":{…},"request":{…},"result":"done",…,"prev":"…","hash":"…"}
//! ```
//! `hash` is the SHA-256 of the line before `,"hash":`, in which `prev` is the hash of the previous line. A
//! full file becomes `NAME.1`, that one `NAME.2` and so on, and the chain continues. `NAME.head` names the
//! last line and the first that is kept, so that lines cut off at either end are missed. The writer locks it.
//!
//! Refusals have a chain of their own, `NAME.refused`, so that no refusal displaces a command.
//!
//! Someone with the daemon's rights can forge all of these files. The chain reveals changes made by hand, not
//! those made with the daemon's tools. If its end is also published elsewhere from time to time ([`ChainAnchor`]),
//! older parts cannot be forged unseen.

use crate::protocol::ClientProcess;
use rtec_files::date;
use rtec_model::record::hex;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

mod chain_check;
mod writer;

pub use chain_check::{ChainAnchor, ChainBreak, ChainCheckResult, ChainLine, read, verify};
pub use writer::AuditLogWriter;

/// Size at which a file is renamed and a new one begun, bytes.
pub const FULL: u64 = 8 << 20;
/// Files that are kept, the current one included.
pub const FILES: usize = 10;
/// Files that are kept of refusals, the current one included.
pub const FILES_REFUSED: usize = 2;
/// Longest recorded text, characters.
const LONGEST_TEXT: usize = 1000;
/// Longest recorded text of a request, characters; then members of a list.
const LONGEST_WORD: usize = 200;
const LONGEST_LIST: usize = 16;
/// Value of `prev` in the first line.
const NOTHING: &str = "0000000000000000000000000000000000000000000000000000000000000000";
/// Longest line that is read, bytes.
const LONGEST_LINE: u64 = 64 << 10;

/// One line of the record, without its hash.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Its number, from 1.
    #[serde(default)]
    pub n: u64,
    /// When, UTC (RFC 3339).
    pub t: String,
    /// Kind of the entry.
    /// It is `command`, `start` or `stop`, or an event: `mode`, `fault`, `homed`, `control_stale`, `stood_still`
    /// (when it was first seen). `lost` counts lines that could not be written. `torn` is a line that a crash cut.
    /// `moved` means that its file or head was removed or renamed while it was written. `missing` means the same
    /// while there was no writer.
    pub what: String,
    /// The axis that it happened to; none for the machine as a whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// Who made the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<ClientProcess>,
    /// The request, in the protocol's form.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub request: Option<Value>,
    /// `done`, `refused`, `fault` or `bad`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub result: String,
    /// Reason of a refusal, or a remark.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub text: String,
    /// Number of equal refusals to the same caller within a second, if more than one.
    /// For `lost` and `torn` it is the number of lines or bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub times: Option<u64>,
    /// Totals before the command, by axis: requested and in effect, counts.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub before: BTreeMap<String, [i64; 2]>,
    /// Totals after the command, as `before`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub after: BTreeMap<String, [i64; 2]>,
    /// SHA-256 of the running machine model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Hash of the line before.
    #[serde(default)]
    pub prev: String,
}

impl Entry {
    /// An entry for something that happened now.
    pub fn now(what: &str) -> Self {
        Self { t: stamp(SystemTime::now()), what: what.to_owned(), ..Self::default() }
    }

    /// Whether this is a command that was not done.
    pub fn is_refusal(&self) -> bool {
        self.what == "command" && self.result != "done"
    }

    /// Cuts texts and lists to the lengths that a record may have.
    /// A caller whose requests are refused cannot fill the disk with them.
    #[must_use]
    pub fn bounded(mut self) -> Self {
        cut(&mut self.text, LONGEST_TEXT);
        if let Some(request) = &mut self.request {
            bound(request);
        }
        self
    }

    /// Whether the entry is about this axis.
    /// It is if it happened to the axis or the machine, or changed the axis's totals. It also is if the
    /// request named this axis or all.
    pub fn concerns(&self, axis: &str) -> bool {
        let asked = self.request.as_ref().and_then(|r| r.get("axis")).and_then(Value::as_str);
        let named = self.axis.as_deref().or(asked);
        let changed = self.before.get(axis).is_some_and(|before| Some(before) != self.after.get(axis));
        named.is_none_or(|name| name == axis) || changed
    }

    /// Time of the entry, s since 1970; none if the text is not a time.
    pub fn seconds(&self) -> Option<f64> {
        seconds(&self.t)
    }

    /// The line without its line end, and its hash.
    fn line(&self) -> io::Result<(String, String)> {
        let mut line = serde_json::to_string(self).map_err(io::Error::other)?;
        line.pop();
        let hash = hex(&Sha256::digest(&line));
        Ok((format!("{line},\"hash\":\"{hash}\"}}"), hash))
    }
}

fn cut(text: &mut String, characters: usize) {
    if let Some((at, _)) = text.char_indices().nth(characters) {
        let more = text.len() - at;
        text.truncate(at);
        *text = format!("{text}… ({more} bytes more)");
    }
}

fn bound(value: &mut Value) {
    match value {
        Value::String(text) => cut(text, LONGEST_WORD),
        Value::Array(all) => {
            all.truncate(LONGEST_LIST);
            all.iter_mut().for_each(bound);
        }
        Value::Object(all) => all.values_mut().for_each(bound),
        _ => {}
    }
}

/// Path of the chain of refusals.
pub fn refused_path(file: &Path) -> PathBuf {
    with_suffix(file, "refused")
}

/// A moment as RFC 3339, to the millisecond, UTC.
pub fn stamp(time: SystemTime) -> String {
    let since = time.duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    let (day, second) = (since.as_secs() / 86_400, since.as_secs() % 86_400);
    let (hour, minute) = (second / 3600, second / 60 % 60);
    let day = date::format(day as i64);
    format!("{day}T{hour:02}:{minute:02}:{:02}.{:03}Z", second % 60, since.subsec_millis())
}

/// Seconds since 1970 of a day or a time.
/// Forms are `2026-11-22`, `2026-11-22T13:00` and `2026-11-22T13:00:00.123Z`.
pub fn seconds(text: &str) -> Option<f64> {
    let day = date::parse(text)?;
    let rest = text.get(10..)?.trim_start_matches(['T', ' ']).trim_end_matches('Z');
    let mut seconds = 0.0;
    for (part, (worth, below)) in rest.split(':').zip([(3600.0, 24.0), (60.0, 60.0), (1.0, 61.0)]) {
        if part.is_empty() {
            continue;
        }
        seconds += part.parse::<f64>().ok().filter(|v| (0.0..below).contains(v))? * worth;
    }
    (rest.split(':').count() <= 3).then_some(day as f64 * 86_400.0 + seconds)
}

/// The end of the chain, kept in a file beside the record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct AuditChainHead {
    n: u64,
    hash: String,
    /// The first line that is kept.
    first_n: u64,
}

fn read_head(file: &Path) -> Option<AuditChainHead> {
    std::fs::read(head_path(file)).ok().and_then(|bytes| serde_json::from_slice(&bytes).ok())
}

/// Number and hash of the last line, as the head has them; none without a head.
pub fn end(file: &Path) -> Option<(u64, String)> {
    read_head(file).map(|head| (head.n, head.hash))
}

fn head_path(file: &Path) -> PathBuf {
    with_suffix(file, "head")
}

pub(crate) fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(format!(".{suffix}"));
    PathBuf::from(name)
}

/// Existing files of a chain, oldest first.
fn files(file: &Path) -> Vec<PathBuf> {
    let older = (1..FILES).rev().map(|n| with_suffix(file, &n.to_string()));
    older.chain([file.to_owned()]).filter(|f| f.exists()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;
    use std::io::Write as _;

    fn entry(axis: &str, total: i64) -> Entry {
        let totals = |t| BTreeMap::from([(axis.to_owned(), [t, t])]);
        Entry {
            request: Some(serde_json::json!({"do": "correct", "axis": axis, "total_counts": total})),
            result: "done".into(),
            before: totals(0),
            after: totals(total),
            ..Entry::now("command")
        }
    }

    fn written(lines: i64, full: u64) -> (tempfile::TempDir, PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let mut writer = AuditLogWriter::new(&path);
        writer.full = full;
        for n in 0..lines {
            writer.append(entry("x", n)).unwrap();
        }
        writer.sync().unwrap();
        (directory, path)
    }

    fn entries(path: &Path) -> Vec<Entry> {
        let mut all = Vec::new();
        read(path, &mut |line| all.push(line.entry.unwrap())).unwrap();
        all
    }

    fn says(path: &Path, wants: &str) {
        says_with(path, &[], wants);
    }

    fn says_with(path: &Path, anchors: &[ChainAnchor], wants: &str) {
        let found = verify(path, anchors).unwrap();
        assert!(found.broken.iter().any(|b| b.what.contains(wants)), "{wants}: {:?}", found.broken);
    }

    #[test]
    fn a_whole_record_is_whole_and_goes_on_after_a_restart() {
        let (_directory, path) = written(20, FULL);
        let mut writer = AuditLogWriter::new(&path);
        writer.append(Entry::now("start")).unwrap();
        assert_eq!(writer.last().0, 21);
        let found = verify(&path, &[]).unwrap();
        assert_eq!((found.lines, found.numbers, found.broken), (21, [1, 21], vec![]));
        // sha256sum(1) gives the same hash of a line, with cut and paste.
        let text = std::fs::read_to_string(&path).unwrap();
        let line = text.lines().nth(7).unwrap();
        let (body, hash) = line.split_once(",\"hash\":\"").unwrap();
        let file = path.with_file_name("body");
        std::fs::write(&file, body).unwrap();
        let sum = std::process::Command::new("sha256sum").arg(&file).output().unwrap();
        assert!(String::from_utf8(sum.stdout).unwrap().starts_with(hash.trim_end_matches("\"}")));
        assert!(
            text.lines().nth(8).unwrap().contains(&format!("\"prev\":\"{}", hash.trim_end_matches("\"}")))
        );
    }

    #[test]
    fn whatever_is_done_to_a_line_is_found() {
        let change = |what: &dyn Fn(&mut Vec<String>)| {
            let (directory, path) = written(20, FULL);
            let text = std::fs::read_to_string(&path).unwrap();
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            what(&mut lines);
            std::fs::write(&path, lines.join("\n") + "\n").unwrap();
            (directory, path)
        };
        says(&change(&|l| l[7] = l[7].replace("\"total_counts\":7", "\"total_counts\":8")).1, "was changed");
        says(&change(&|l| drop(l.remove(7))).1, "lines are missing");
        says(&change(&|l| l.swap(7, 8)).1, "in another place");
        says(&change(&|l| drop(l.remove(0))).1, "begins with line number 2");
        says(&change(&|l| l.truncate(15)).1, "ends with line number 15, and should with 20");
        says(&change(&|l| l[7] = "nonsense".into()).1, "no hash");
        says(&change(&|l| l.insert(7, l[6].clone())).1, "lines are missing, or in another place");
        // A changed line with a matching hash of its own: the next line does not follow it.
        let forged = change(&|l| {
            let body =
                l[7].split_once(",\"hash\"").unwrap().0.replace("\"result\":\"done\"", "\"result\":\"bad\"");
            l[7] = format!("{body},\"hash\":\"{}\"}}", hex(&Sha256::digest(&body)));
        });
        says(&forged.1, "does not follow");
        // The last line, forged in the same way.
        let forged = change(&|l| {
            let body =
                l[19].split_once(",\"hash\"").unwrap().0.replace("\"result\":\"done\"", "\"result\":\"bad\"");
            l[19] = format!("{body},\"hash\":\"{}\"}}", hex(&Sha256::digest(&body)));
        });
        says(&forged.1, "another one than was written last");
    }

    #[test]
    fn the_chain_goes_through_all_files_and_the_oldest_go() {
        let (_directory, path) = written(300, 4096);
        let kept = files(&path);
        assert_eq!(kept.len(), FILES);
        let found = verify(&path, &[]).unwrap();
        assert_eq!(found.broken, []);
        assert!(found.numbers[0] > 1 && found.numbers[1] == 300, "{:?}", found.numbers);
        std::fs::remove_file(&kept[4]).unwrap();
        says(&path, "lines are missing");
        std::fs::remove_file(&kept[0]).unwrap();
        says(&path, "the record begins with");
    }

    #[test]
    fn a_torn_line_is_cut_and_told_and_cut_lines_are_missed_after_a_restart_too() {
        let (_directory, path) = written(5, FULL);
        OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{\"n\":6,\"t\":\"20").unwrap();
        says(&path, "no end");
        let mut writer = AuditLogWriter::new(&path);
        writer.append(Entry::now("start")).unwrap();
        let all = entries(&path);
        assert_eq!((all[5].what.as_str(), all[5].times, all[6].what.as_str()), ("torn", Some(14), "start"));
        assert_eq!(verify(&path, &[]).unwrap().broken, []);
        drop(writer);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.lines().take(4).collect::<Vec<_>>().join("\n") + "\n").unwrap();
        AuditLogWriter::new(&path).append(Entry::now("start")).unwrap();
        says(&path, "line number 8 after 4");
    }

    #[test]
    fn moments_and_axes() {
        assert_eq!(stamp(UNIX_EPOCH + Duration::from_millis(1_764_032_405_678)), "2025-11-25T01:00:05.678Z");
        assert_eq!(seconds("2025-11-25T01:00:05.678Z"), Some(1_764_032_405.678));
        assert_eq!(seconds("2025-11-25T01:00"), Some(1_764_032_400.0));
        assert_eq!(seconds("2025-11-25"), Some(1_764_028_800.0));
        for bad in ["yesterday", "2025-11-25T25:00", "2025-11-25T1:2:3:4", "2025-13-01"] {
            assert_eq!(seconds(bad), None, "{bad}");
        }
        assert!(entry("x", 3).concerns("x") && !entry("x", 3).concerns("y"));
        // A request for all axes, or an event of the machine, concerns each axis.
        let all =
            Entry { request: Some(serde_json::json!({"do": "home", "axis": null})), ..Entry::now("command") };
        assert!(all.concerns("x") && Entry::now("mode").concerns("y"));
        let after = BTreeMap::from([("x".to_owned(), [2, 2]), ("y".to_owned(), [4, 4])]);
        let fault = Entry { axis: Some("x".into()), after, ..Entry::now("fault") };
        assert!(fault.concerns("x") && !fault.concerns("y"));
    }

    #[test]
    fn a_crash_in_the_middle_of_a_rotation_looks_like_no_tampering() {
        // The state after each of the renames but the last.
        for renamed in 0..FILES - 1 {
            let (_directory, path) = written(300, 4096);
            let mut writer = AuditLogWriter::new(&path);
            writer.full = 4096;
            writer.append(Entry::now("start")).unwrap();
            writer.begin_rotation().unwrap();
            for n in (0..FILES - 1).rev().take(renamed) {
                let name = |n: usize| if n == 0 { path.clone() } else { with_suffix(&path, &n.to_string()) };
                std::fs::rename(name(n), name(n + 1)).unwrap();
            }
            drop(writer);
            assert_eq!(verify(&path, &[]).unwrap().broken, [], "{renamed}");
            let mut writer = AuditLogWriter::new(&path);
            writer.full = 4096;
            for n in 0..40 {
                writer.append(entry("x", n)).unwrap();
            }
            let found = verify(&path, &[]).unwrap();
            assert_eq!((found.broken, found.numbers[1]), (vec![], 341), "{renamed}");
        }
    }

    #[test]
    fn one_process_writes_it_at_a_time() {
        let (_directory, path) = written(3, FULL);
        let mut first = AuditLogWriter::new(&path);
        first.append(Entry::now("start")).unwrap();
        let error = AuditLogWriter::new(&path).append(Entry::now("start")).unwrap_err();
        assert!(error.to_string().contains("another process writes it"), "{error}");
        assert_eq!(verify(&path, &[]).unwrap().broken, []);
        drop(first);
        AuditLogWriter::new(&path).append(Entry::now("start")).unwrap();
        assert_eq!(verify(&path, &[]).unwrap().numbers, [1, 5]);
    }

    #[test]
    fn a_record_that_is_written_to_meanwhile_is_no_broken_one() {
        let (_directory, path) = written(3, 4096);
        let going = std::sync::atomic::AtomicBool::new(true);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let mut writer = AuditLogWriter::new(&path);
                writer.full = 64 << 10;
                for n in 0.. {
                    if !going.load(std::sync::atomic::Ordering::Relaxed) {
                        break;
                    }
                    writer.append(entry("x", n)).unwrap();
                    std::thread::sleep(Duration::from_micros(200));
                }
            });
            let found: Vec<_> = (0..20).map(|_| verify(&path, &[]).unwrap().broken).collect();
            going.store(false, std::sync::atomic::Ordering::Relaxed);
            assert!(found.iter().all(Vec::is_empty), "{found:?}");
        });
    }

    #[test]
    fn what_could_not_be_recorded_is_counted() {
        let (_directory, path) = written(2, FULL);
        for times in [40, 2] {
            AuditLogWriter::new(&path).append(Entry { times: Some(times), ..Entry::now("lost") }).unwrap();
        }
        let found = verify(&path, &[]).unwrap();
        assert_eq!((found.lost, found.broken), (42, vec![]));
    }

    #[test]
    fn a_record_is_a_regular_file() {
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("audit.log");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        for file in [&pipe, Path::new("/dev/zero")] {
            let error = read(file, &mut |_| panic!("a line")).unwrap_err();
            assert_eq!(error.to_string(), "a pipe, socket or device");
        }
    }

    #[test]
    fn files_that_are_removed_or_renamed_meanwhile_are_told_and_found() {
        for (what, says_so) in
            [("audit.log", "begins with"), ("audit.log.head", ""), ("rename", "begins with")]
        {
            let (_directory, path) = written(5, FULL);
            let mut writer = AuditLogWriter::new(&path);
            writer.append(entry("x", 5)).unwrap();
            if what == "rename" {
                std::fs::rename(&path, path.with_file_name("elsewhere")).unwrap();
            } else {
                std::fs::remove_file(path.with_file_name(what)).unwrap();
            }
            writer.append(entry("x", 6)).unwrap();
            assert_eq!((writer.moved(), writer.last().0), (1, 8), "{what}");
            let all = entries(&path);
            let last: Vec<_> = all.iter().rev().take(2).map(|e| (e.n, e.what.as_str())).collect();
            assert_eq!(last, [(8, "command"), (7, "moved")], "{what}");
            let found = verify(&path, &[]).unwrap().broken;
            assert_eq!(found.is_empty(), says_so.is_empty(), "{what}: {found:?}");
            assert!(found.iter().all(|b| b.what.contains(says_so)), "{what}: {found:?}");
        }
        // A removal while nobody writes is reported at the next start.
        let (_directory, path) = written(5, FULL);
        std::fs::remove_file(&path).unwrap();
        AuditLogWriter::new(&path).append(Entry::now("start")).unwrap();
        let all = entries(&path);
        let all: Vec<_> = all.iter().map(|e| (e.n, e.what.as_str())).collect();
        assert_eq!(all, [(6, "missing"), (7, "start")]);
        says(&path, "begins with line number 6");
    }

    #[test]
    fn a_story_that_was_written_anew_does_not_fit_its_anchors() {
        let (_directory, path) = written(20, FULL);
        let mut refused = AuditLogWriter::new(&refused_path(&path));
        refused.append(Entry { result: "refused".into(), ..Entry::now("command") }).unwrap();
        let mut writer = AuditLogWriter::new(&path);
        writer.append(Entry::now("start")).unwrap();
        let journal =
            format!("Nov 26 rtecd: {}\nother\n", ChainAnchor::text(writer.last(), Some(refused.last())));
        let anchors = ChainAnchor::all(&journal);
        assert_eq!(anchors.len(), 2, "{journal}");
        writer.append(entry("x", 21)).unwrap();
        drop((writer, refused));
        let found = verify(&path, &anchors).unwrap();
        assert_eq!((found.broken, found.refused), (vec![], 1));
        // Somebody with the daemon's rights replaces the record with one that is consistent in itself.
        let (_other, other) = written(25, FULL);
        for suffix in ["", ".head"] {
            let name = |p: &Path| PathBuf::from(format!("{}{suffix}", p.display()));
            std::fs::copy(name(&other), name(&path)).unwrap();
        }
        assert_eq!(verify(&path, &[]).unwrap().broken, []);
        says_with(&path, &anchors, "line number 21 is another one than the anchor says");
        let (_other, other) = written(20, FULL);
        says_with(&other, &anchors[..1], "the anchor knows line number 21");
        // The refusals are removed too.
        std::fs::remove_file(refused_path(&path)).unwrap();
        std::fs::remove_file(head_path(&refused_path(&path))).unwrap();
        says_with(&path, &anchors[1..], "the anchor knows line number 1");
    }

    #[test]
    fn what_is_recorded_of_a_request_has_an_end() {
        let long = "µ".repeat(4096);
        let request = serde_json::json!({"do": "explain", "axis": long, "files": vec![long.as_str(); 100]});
        let entry = Entry { request: Some(request), text: long.clone(), ..Entry::now("command") }.bounded();
        let line = serde_json::to_string(&entry).unwrap();
        assert!(line.len() < 12_000 && line.contains("bytes more"), "{}", line.len());
    }
}
