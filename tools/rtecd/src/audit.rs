//! The record of commands, written by a thread of its own: the control side never waits for a disk, and one that is full
//! or gone stops nothing. What could not be written is counted, and told by the first line that can be written again.

use nix::unistd::Gid;
use rtec_control::audit::{Entry, Writer};
use rtec_control::protocol::{Caller, Happened, LogState};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Lines that may wait for the disk.
const WAITING: usize = 1024;
/// The same refusal to the same caller is one line in this time.
const TOGETHER: Duration = Duration::from_secs(1);
/// A simulated axis is asked where it stands many times a second: the same question of one caller is one line in this time.
const LOOKING: Duration = Duration::from_secs(60);
/// Different refusals of one user that are told apart at a time: whoever varies what is refused him would else write the
/// record full, and what was in it is lost.
const KINDS: usize = 16;
/// After a line that could not be written the next one is tried so much later.
const RETRY: Duration = Duration::from_secs(1);

/// Totals of each axis: requested and in effect, counts.
pub(crate) type Totals = BTreeMap<String, [i64; 2]>;

/// A command that was answered.
pub(crate) struct Command {
    pub by: Caller,
    pub request: Value,
    pub result: &'static str,
    pub text: String,
    pub before: Totals,
    pub after: Totals,
    pub model: Option<String>,
}

struct Repeated {
    since: Instant,
    last: Instant,
    entry: Entry,
    times: u64,
    /// A jog that was done: held as long as it comes again, not only for a moment.
    looks: bool,
}

impl Repeated {
    fn is_due(&self, now: Instant) -> bool {
        if self.looks {
            return now.duration_since(self.last) >= TOGETHER || now.duration_since(self.since) >= LOOKING;
        }
        now.duration_since(self.since) >= TOGETHER
    }
}

/// What waits to be written, and how the writing goes.
#[derive(Default)]
struct Shared {
    state: LogState,
}

/// The control side's end.
pub(crate) struct Audit {
    lines: Option<SyncSender<Entry>>,
    shared: Arc<Mutex<Shared>>,
    /// By user and by what was refused.
    repeated: BTreeMap<(u32, String), Repeated>,
    /// Lines that found the queue full; the writer is told with the next one.
    lost: u64,
}

impl Audit {
    /// Starts the thread; `group` may read the record.
    pub(crate) fn start(path: &Path, group: Option<Gid>) -> std::io::Result<Self> {
        let shared = Arc::new(Mutex::new(Shared::default()));
        lock(&shared).state.file = path.display().to_string();
        let (lines, waiting) = sync_channel(WAITING);
        let (path, state) = (path.to_owned(), Arc::clone(&shared));
        // It may hang in a disk: nobody waits for it.
        std::thread::Builder::new()
            .name("audit".into())
            .spawn(move || write(&path, group, &waiting, &state))?;
        Ok(Self { lines: Some(lines), shared, repeated: BTreeMap::new(), lost: 0 })
    }

    /// Records something that was no command.
    pub(crate) fn note(&mut self, what: &str, text: String, after: Totals) {
        self.send(Entry { text, after, ..Entry::now(what) });
    }

    /// Records what the machine did by itself, where somebody may ask for it later.
    pub(crate) fn happened(&mut self, happened: &Happened, after: Totals) {
        let Happened { axis, kind, text, .. } = happened;
        let asked_for_later = ["mode", "fault", "homed", "control_stale", "stood_still", "record_lost"];
        if asked_for_later.contains(&kind.as_str()) {
            self.send(Entry { axis: axis.clone(), text: text.clone(), after, ..Entry::now(kind) });
        }
    }

    /// Records a command. A refusal that comes again and again is one line with its number, and so is a jog that asks for
    /// nothing new: where a simulated axis stands, or what it is asked for already.
    pub(crate) fn command(&mut self, command: Command) {
        let Command { by, request, result, text, before, after, model } = command;
        let looks = result == "done" && request["do"] == "jog";
        let uid = by.uid;
        let mut key =
            (looks || result != "done").then(|| (uid, format!("{} {} {result} {request}", by.pid, by.role)));
        // What was asked before stands before what is done now; other questions change nothing.
        let new = key.as_ref().is_none_or(|key| !self.repeated.contains_key(key));
        if new && result == "done" && !(looks && request["display_mm"].is_null()) {
            let (looked, held) = std::mem::take(&mut self.repeated).into_iter().partition(|(_, r)| r.looks);
            self.repeated = held;
            self.release(looked);
        }
        // Too many to be told apart: by their verbs alone, which are few.
        let of_user = || self.repeated.range((uid, String::new())..=(uid, char::MAX.to_string())).count();
        if let Some(key) =
            key.as_mut().filter(|key| !looks && !self.repeated.contains_key(*key) && of_user() >= KINDS)
        {
            key.1 = format!("{result} {}", request["do"]);
        }
        let entry = Entry {
            by: Some(by),
            request: Some(request),
            result: result.to_owned(),
            text,
            before,
            after,
            model,
            ..Entry::now("command")
        };
        let Some(key) = key else { return self.send(entry) };
        if let Some(known) = self.repeated.get_mut(&key) {
            (known.times, known.last) = (known.times + 1, Instant::now());
            // The first of them had the totals before.
            let before = if known.times == 1 { entry.before.clone() } else { known.entry.before.clone() };
            known.entry = Entry { before, ..entry };
            return;
        }
        self.send(entry.clone());
        let now = Instant::now();
        self.repeated.insert(key, Repeated { since: now, last: now, entry, times: 0, looks });
    }

    /// Lets what was held together go.
    pub(crate) fn turn(&mut self) {
        let now = Instant::now();
        let (due, held) = std::mem::take(&mut self.repeated)
            .into_iter()
            .partition(|(_, r): &((u32, String), Repeated)| r.is_due(now));
        self.repeated = held;
        self.release(due);
    }

    fn release(&mut self, due: BTreeMap<(u32, String), Repeated>) {
        for Repeated { entry, times, .. } in due.into_values().filter(|r| r.times > 0) {
            self.send(Entry { times: Some(times), ..entry });
        }
    }

    fn send(&mut self, entry: Entry) {
        let Some(lines) = &self.lines else { return };
        if self.lost > 0 && lines.try_send(lost(self.lost, "more came than could be written")).is_ok() {
            self.lost = 0;
        }
        if lines.try_send(entry).is_err() {
            self.lost += 1;
        }
    }

    /// How the record stands.
    pub(crate) fn state(&self) -> LogState {
        let state = lock(&self.shared).state.clone();
        LogState { lost: state.lost + self.lost, ..state }
    }

    /// Writes what is left, for so long at most.
    pub(crate) fn end(mut self, patience: Duration) {
        let due = std::mem::take(&mut self.repeated);
        self.release(due);
        drop(self.lines.take());
        let deadline = Instant::now() + patience;
        // The thread holds the other end until all is written.
        while Arc::strong_count(&self.shared) > 1 && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// What stands in the record for lines that do not.
fn lost(times: u64, why: &str) -> Entry {
    Entry { times: Some(times), text: format!("not recorded: {why}"), ..Entry::now("lost") }
}

fn lock(shared: &Mutex<Shared>) -> std::sync::MutexGuard<'_, Shared> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn write(path: &Path, group: Option<Gid>, waiting: &Receiver<Entry>, shared: &Mutex<Shared>) {
    let mut writer = Writer::new(path).readable_by(group.map(Gid::as_raw));
    let (mut lost, mut not_before) = (Lost::default(), None::<Instant>);
    loop {
        let mut batch = match waiting.recv_timeout(RETRY) {
            Ok(entry) => vec![entry],
            Err(RecvTimeoutError::Timeout) if lost.lines > 0 => Vec::new(),
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        // What has come meanwhile is made safe on the disk together with it.
        batch.extend(waiting.try_iter().take(WAITING));
        let mut trouble = None;
        if not_before.is_some_and(|then| Instant::now() < then) {
            lost.lines += batch.len() as u64;
        } else {
            trouble = write_batch(&mut writer, batch, &mut lost).err().map(|e| e.to_string());
            not_before = trouble.as_ref().map(|_| Instant::now() + RETRY);
        }
        let mut shared = lock(shared);
        let (n, hash) = writer.last();
        (shared.state.last_n, shared.state.last_hash) = (n, hash.to_owned());
        shared.state.lost = lost.lines;
        if not_before.is_none() || trouble.is_some() {
            shared.state.trouble = trouble;
        }
    }
}

/// Lines that could not be written since the last one that could.
#[derive(Default)]
struct Lost {
    lines: u64,
    /// Since when, and why.
    began: String,
}

/// Writes lines, after one that tells of those that were lost before; counts those that could not be written.
fn write_batch(writer: &mut Writer, batch: Vec<Entry>, so_far: &mut Lost) -> std::io::Result<()> {
    let mut left = batch.len() as u64;
    let before = so_far.lines;
    let all = || {
        if so_far.lines > 0 {
            writer.append(lost(so_far.lines, &so_far.began))?;
            so_far.lines = 0;
        }
        for entry in batch {
            writer.append(entry)?;
            left -= 1;
        }
        writer.sync()
    };
    let done: std::io::Result<()> = all();
    if let Err(error) = &done
        && before == 0
    {
        so_far.began = format!("from {} on: {error}", Entry::now("lost").t);
    }
    so_far.lines += left;
    done
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::audit::{Line, read, verify};

    fn command(pid: i32, result: &'static str) -> Command {
        Command {
            by: Caller { uid: 7, pid, ..Caller::default() },
            request: serde_json::json!({"do": "enable"}),
            result,
            text: String::new(),
            before: Totals::new(),
            after: Totals::new(),
            model: None,
        }
    }

    fn lines(path: &Path) -> Vec<Entry> {
        let mut all = Vec::new();
        read(path, &mut |line: Line| all.push(line.entry.unwrap())).unwrap();
        all
    }

    #[test]
    fn what_is_refused_again_and_again_is_one_line_with_its_number() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let mut audit = Audit::start(&path, None).unwrap();
        for _ in 0..1000 {
            audit.command(command(1, "refused"));
            audit.command(command(2, "refused"));
        }
        audit.command(command(1, "done"));
        audit.end(Duration::from_secs(30));
        let all = lines(&path);
        assert_eq!(all.len(), 5, "{all:?}");
        let repeated: Vec<_> = all.iter().filter_map(|e| e.times).collect();
        assert_eq!(repeated, [999, 999]);
        assert!(verify(&path).unwrap().broken.is_empty());
    }

    /// `commission` asks a simulated axis every 20 ms whether it is there: commands must be found between it.
    #[test]
    fn a_jog_that_is_asked_again_and_again_is_one_line_with_its_number_and_every_new_one_its_own() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let mut audit = Audit::start(&path, None).unwrap();
        let jog = |mm: Option<f64>| serde_json::json!({"do": "jog", "axis": "x", "display_mm": mm});
        for mm in [1.0, 2.0] {
            audit.command(Command { request: jog(Some(mm)), ..command(1, "done") });
            for _ in 0..400 {
                audit.command(Command { request: jog(None), ..command(1, "done") });
                audit.turn();
            }
            audit.command(command(1, "done"));
        }
        audit.command(Command { request: jog(None), ..command(1, "done") });
        // Somebody else's is another line.
        audit.command(Command { request: jog(None), ..command(2, "done") });
        audit.end(Duration::from_secs(30));
        let told = |e: &Entry| {
            let request = e.request.as_ref().unwrap();
            (request["do"].as_str().unwrap().to_owned(), request["display_mm"].as_f64(), e.times)
        };
        let all: Vec<_> = lines(&path).iter().map(told).collect();
        let round = |mm| {
            [("jog", Some(mm), None), ("jog", None, None), ("jog", None, Some(399)), ("enable", None, None)]
        };
        let expected: Vec<_> =
            [round(1.0), round(2.0)].concat().into_iter().chain([("jog", None, None); 2]).collect();
        let all: Vec<_> = all.iter().map(|(what, mm, times)| (what.as_str(), *mm, *times)).collect();
        assert_eq!(all, expected);
        assert!(verify(&path).unwrap().broken.is_empty());
    }

    #[test]
    fn refusals_that_are_never_the_same_do_not_write_the_record_full() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let mut audit = Audit::start(&path, None).unwrap();
        for n in 0..5000 {
            let request = serde_json::json!({"do": "correct", "total_counts": n});
            audit.command(Command { request, ..command(n, "refused") });
        }
        let by = Caller { uid: 8, ..Caller::default() };
        audit.command(Command { by, ..command(1, "refused") });
        audit.end(Duration::from_secs(30));
        let all = lines(&path);
        let of =
            |uid| all.iter().filter(|e| e.by.as_ref().is_some_and(|by| by.uid == uid)).collect::<Vec<_>>();
        assert_eq!((of(7).len(), of(8).len()), (KINDS + 2, 1));
        assert_eq!(of(7).last().unwrap().times, Some(5000 - KINDS as u64 - 1));
    }

    #[test]
    fn what_happens_is_recorded_with_its_axis() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let mut audit = Audit::start(&path, None).unwrap();
        for (kind, axis) in [("fault", Some("x")), ("trip", Some("x")), ("mode", None)] {
            let (axis, text) = (axis.map(str::to_owned), "t".to_owned());
            let happened = Happened { t_ns: 0, axis, kind: kind.to_owned(), text, trip: None };
            audit.happened(&happened, Totals::new());
        }
        audit.end(Duration::from_secs(30));
        let all: Vec<_> = lines(&path).into_iter().map(|e| (e.what, e.axis)).collect();
        assert_eq!(all, [("fault".to_owned(), Some("x".to_owned())), ("mode".to_owned(), None)]);
    }

    #[test]
    fn a_place_that_takes_nothing_is_told_when_it_does_again() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("later/audit.log");
        let mut audit = Audit::start(&path, None).unwrap();
        audit.command(command(1, "done"));
        let begun = Instant::now();
        while audit.state().trouble.is_none() {
            assert!(begun.elapsed() < Duration::from_secs(30));
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(audit.state().lost, 1);
        std::fs::create_dir(directory.path().join("later")).unwrap();
        while audit.state().last_n == 0 {
            assert!(begun.elapsed() < Duration::from_secs(30));
            std::thread::sleep(Duration::from_millis(5));
        }
        audit.command(command(1, "done"));
        audit.end(Duration::from_secs(30));
        let all = lines(&path);
        assert_eq!((all[0].what.as_str(), all[0].times, all.len()), ("lost", Some(1), 2));
        assert!(all[0].text.contains("No such file"), "{}", all[0].text);
    }
}
