//! The record of commands, written by its own thread.
//! The control side never waits for a disk, and a full or missing disk stops nothing. Entries that could not be
//! written are counted, and the next line that can be written reports them.
//!
//! | what keeps users from filling the record | by |
//! |---|---|
//! | each line is short | texts of a request are cut (`rtec_control::audit_log`) |
//! | refusals displace no command | they have files of their own |
//! | a user's refusals do not displace those of others, nor commands to operate those to set up | each user has a [`RateLimit`]; beyond it verbs are counted |

use nix::unistd::Gid;
use rtec_control::audit_log::{AuditLogWriter, ChainAnchor, Entry, FILES_REFUSED, refused_path};
use rtec_control::protocol::{AuditLogState, ClientProcess, EventReport};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Largest number of lines that wait for the disk.
const WAITING: usize = 1024;
/// Time in which the same refusal to the same caller becomes one line.
const TOGETHER: Duration = Duration::from_secs(1);
/// Time in which a caller's repeated question becomes one line.
/// Clients ask for a position many times a second.
const LOOKING: Duration = Duration::from_secs(60);
/// Number of kinds of refusal of one user that are distinguished at a time.
/// Otherwise a user who varies the requests could fill the record and push out its content.
const KINDS: usize = 16;
/// Initial lines of a user for refusals and for commands to operate.
/// `BUDGET_PER_S` lines a second are added again.
const BUDGET: f64 = 500.0;
const BUDGET_PER_S: f64 = 0.1;
/// Time in which a user beyond its budget gets one line for each verb.
const COUNTED: Duration = Duration::from_secs(600);
/// Number of users with a known budget; full budgets are dropped first.
const USERS: usize = 4096;
/// The longest time between two anchors of the record's end, if lines were added.
const ANCHOR_EVERY: Duration = Duration::from_secs(24 * 3600);
/// Time after a line that could not be written until the next try.
const RETRY: Duration = Duration::from_secs(1);

/// Totals of each axis: requested and in effect, counts.
pub(crate) type Totals = BTreeMap<String, [i64; 2]>;

/// A command with its answer.
pub(crate) struct AnsweredCommand {
    pub by: ClientProcess,
    pub request: Value,
    pub result: &'static str,
    pub text: String,
    pub before: Totals,
    pub after: Totals,
    pub model: Option<String>,
}

struct RepeatedLogLine {
    since: Instant,
    last: Instant,
    entry: Entry,
    times: u64,
    /// The command is a jog, whose repetitions are one line for longer.
    looks: bool,
    /// Time after which the line is written.
    after: Duration,
}

/// Kind of the lines in a budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum RateLimitedLineKind {
    Refused,
    Done,
    /// Changes of mode, which belong to the machine and not to a user.
    Mode,
}

/// The lines that a user may still write one by one.
struct RateLimit {
    left: f64,
    since: Instant,
}

impl RateLimit {
    fn now(&self, now: Instant) -> f64 {
        (self.left + now.duration_since(self.since).as_secs_f64() * BUDGET_PER_S).min(BUDGET)
    }

    fn takes(&mut self, now: Instant) -> bool {
        (self.left, self.since) = (self.now(now), now);
        let has = self.left >= 1.0;
        self.left -= f64::from(u8::from(has));
        has
    }
}

impl RepeatedLogLine {
    fn is_due(&self, now: Instant) -> bool {
        if self.looks {
            return now.duration_since(self.last) >= TOGETHER || now.duration_since(self.since) >= LOOKING;
        }
        now.duration_since(self.since) >= self.after
    }
}

/// State of the writing thread, for the control side.
#[derive(Default)]
struct AuditThreadState {
    state: AuditLogState,
    /// Number and hash of the last refusal.
    refused: (u64, String),
    /// Files that were rotated, and files that others removed or renamed.
    rotated: u64,
    moved: u64,
}

/// The anchor that was published last.
struct LastPublishedAnchor {
    at: Instant,
    rotated: u64,
    text: String,
}

/// The control side's end of the record.
pub(crate) struct AuditLogSender {
    lines: Option<SyncSender<Entry>>,
    shared: Arc<Mutex<AuditThreadState>>,
    /// Repeated lines by user and key.
    repeated: BTreeMap<(u32, String), RepeatedLogLine>,
    budgets: BTreeMap<(u32, RateLimitedLineKind), RateLimit>,
    anchored: Option<LastPublishedAnchor>,
    /// Removed or renamed files that were reported already.
    moved: u64,
    /// Lines that did not fit into the queue; the next line reports them to the writer.
    lost: u64,
}

impl AuditLogSender {
    /// Starts the thread; `group` may read the record.
    pub(crate) fn start(path: &Path, group: Option<Gid>) -> std::io::Result<Self> {
        let shared = Arc::new(Mutex::new(AuditThreadState::default()));
        lock(&shared).state.file = path.display().to_string();
        let (lines, waiting) = sync_channel(WAITING);
        let (path, state) = (path.to_owned(), Arc::clone(&shared));
        // The thread may wait for a disk, and nobody waits for it.
        std::thread::Builder::new()
            .name("audit".into())
            .spawn(move || write(&path, group, &waiting, &state))?;
        let (repeated, budgets) = (BTreeMap::new(), BTreeMap::new());
        Ok(Self { lines: Some(lines), shared, repeated, budgets, anchored: None, moved: 0, lost: 0 })
    }

    /// Records an event that is no command.
    pub(crate) fn note(&mut self, what: &str, text: String, after: Totals) {
        self.send(Entry { text, after, ..Entry::now(what) });
    }

    /// Records an event of the machine that somebody may ask for later.
    pub(crate) fn happened(&mut self, happened: &EventReport, after: Totals) {
        let EventReport { axis, kind, text, .. } = happened;
        let asked_for_later = ["mode", "fault", "homed", "control_stale", "stood_still", "record_not_kept"];
        if asked_for_later.contains(&kind.as_str()) {
            let entry = Entry { axis: axis.clone(), text: text.clone(), after, ..Entry::now(kind) };
            if kind == "mode" && !self.may(u32::MAX, RateLimitedLineKind::Mode) {
                return self.send_or_count_repeat((u32::MAX, "mode".to_owned()), entry, COUNTED, false);
            }
            self.send(entry);
        }
    }

    /// Takes a line from a user's budget; returns whether there was one.
    fn may(&mut self, uid: u32, kind: RateLimitedLineKind) -> bool {
        let now = Instant::now();
        if self.budgets.len() >= USERS {
            self.budgets.retain(|_, budget| budget.now(now) < BUDGET);
        }
        let whole = RateLimit { left: BUDGET, since: now };
        self.budgets.entry((uid, kind)).or_insert(whole).takes(now)
    }

    /// Records a command.
    /// A repeated refusal is one line with its number. So is a jog that asks for nothing new: a simulated axis's
    /// position, or a target already set.
    pub(crate) fn command(&mut self, command: AnsweredCommand) {
        let AnsweredCommand { by, request, result, text, before, after, model } = command;
        let looks = result == "done" && request["do"] == "jog" && request["go_on"].is_null();
        let uid = by.uid;
        let mut key =
            (looks || result != "done").then(|| (uid, format!("{} {} {result} {request}", by.pid, by.role)));
        // An earlier question is written before this command; other questions change nothing.
        let new = key.as_ref().is_none_or(|key| !self.repeated.contains_key(key));
        if new && result == "done" && !(looks && request["display_mm"].is_null()) {
            self.release_if(|r| r.looks);
        }
        // Too many kinds: they are counted by verb only, and verbs are few.
        let of_user = || self.repeated.range((uid, String::new())..=(uid, char::MAX.to_string())).count();
        if let Some(key) =
            key.as_mut().filter(|key| !looks && !self.repeated.contains_key(*key) && of_user() >= KINDS)
        {
            key.1 = format!("{result} {}", request["do"]);
        }
        let mut after_at_least = TOGETHER;
        if key.as_ref().is_none_or(|key| !self.repeated.contains_key(key)) && !looks {
            let kind =
                if result == "done" { RateLimitedLineKind::Done } else { RateLimitedLineKind::Refused };
            // A user who may set up can write anything anyway.
            if (result != "done" || by.role == "operate") && !self.may(uid, kind) {
                key = Some((uid, format!("beyond {result} {}", request["do"])));
                after_at_least = COUNTED;
            }
        }
        let (by, request, result) = (Some(by), Some(request), result.to_owned());
        let entry = Entry { by, request, result, text, before, after, model, ..Entry::now("command") };
        match key {
            Some(key) => self.send_or_count_repeat(key, entry.bounded(), after_at_least, looks),
            None => self.send(entry.bounded()),
        }
    }

    /// Writes a line, and counts the lines that follow under the same key.
    fn send_or_count_repeat(&mut self, key: (u32, String), entry: Entry, after: Duration, looks: bool) {
        if let Some(known) = self.repeated.get_mut(&key) {
            (known.times, known.last) = (known.times + 1, Instant::now());
            // The first of these lines has the totals before.
            let before = if known.times == 1 { entry.before.clone() } else { known.entry.before.clone() };
            known.entry = Entry { before, ..entry };
            return;
        }
        self.send(entry.clone());
        let now = Instant::now();
        self.repeated.insert(key, RepeatedLogLine { since: now, last: now, entry, times: 0, looks, after });
    }

    /// Writes the repeated lines that are due.
    pub(crate) fn turn(&mut self) {
        let now = Instant::now();
        self.release_if(|r| r.is_due(now));
    }

    fn release_if(&mut self, is_due: impl Fn(&RepeatedLogLine) -> bool) {
        let (due, held) = std::mem::take(&mut self.repeated).into_iter().partition(|(_, r)| is_due(r));
        self.repeated = held;
        self.release(due);
    }

    fn release(&mut self, due: BTreeMap<(u32, String), RepeatedLogLine>) {
        for RepeatedLogLine { entry, times, .. } in due.into_values().filter(|r| r.times > 0) {
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

    /// State of the record.
    pub(crate) fn state(&self) -> AuditLogState {
        let state = lock(&self.shared).state.clone();
        AuditLogState { lost: state.lost + self.lost, ..state }
    }

    /// The end of the record, if it must be published now.
    /// That is at the start, with each full file, and once a day.
    pub(crate) fn anchor(&mut self) -> Option<String> {
        let shared = lock(&self.shared);
        if shared.state.last_n == 0 {
            return None;
        }
        let holds =
            |last: &LastPublishedAnchor| last.rotated == shared.rotated && last.at.elapsed() < ANCHOR_EVERY;
        if self.anchored.as_ref().is_some_and(holds) {
            return None;
        }
        let refused = Some((shared.refused.0, shared.refused.1.as_str())).filter(|(n, _)| *n > 0);
        let text = ChainAnchor::text((shared.state.last_n, &shared.state.last_hash), refused);
        let new = self.anchored.as_ref().is_none_or(|last| last.text != text);
        self.anchored =
            Some(LastPublishedAnchor { at: Instant::now(), rotated: shared.rotated, text: text.clone() });
        new.then_some(text)
    }

    /// Whether others have removed or renamed a file of it since the last time.
    pub(crate) fn has_moved(&mut self) -> bool {
        let moved = lock(&self.shared).moved;
        std::mem::replace(&mut self.moved, moved) != moved
    }

    /// Writes the rest, but waits at most `patience`.
    pub(crate) fn end(mut self, patience: Duration) {
        let due = std::mem::take(&mut self.repeated);
        self.release(due);
        drop(self.lines.take());
        let deadline = Instant::now() + patience;
        // The thread holds its reference until all is written.
        while Arc::strong_count(&self.shared) > 1 && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// The entry for lines that were not recorded.
fn lost(times: u64, why: &str) -> Entry {
    Entry { times: Some(times), text: format!("not recorded: {why}"), ..Entry::now("lost") }
}

fn lock(shared: &Mutex<AuditThreadState>) -> std::sync::MutexGuard<'_, AuditThreadState> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The chains of the record and of the refusals.
struct CommandAndRefusalLogs {
    record: AuditLogWriter,
    refused: AuditLogWriter,
}

impl CommandAndRefusalLogs {
    fn of(&mut self, entry: &Entry) -> &mut AuditLogWriter {
        if entry.is_refusal() { &mut self.refused } else { &mut self.record }
    }
}

fn write(path: &Path, group: Option<Gid>, waiting: &Receiver<Entry>, shared: &Mutex<AuditThreadState>) {
    let group = group.map(Gid::as_raw);
    let mut writers = CommandAndRefusalLogs {
        record: AuditLogWriter::new(path).readable_by(group),
        refused: AuditLogWriter::new(&refused_path(path)).readable_by(group).keeping(FILES_REFUSED),
    };
    let (mut lost, mut not_before) = (LostLogLines::default(), None::<Instant>);
    loop {
        let mut batch = match waiting.recv_timeout(RETRY) {
            Ok(entry) => vec![entry],
            Err(RecvTimeoutError::Timeout) if lost.lines > 0 => Vec::new(),
            Err(RecvTimeoutError::Timeout) => continue,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        // Lines that came meanwhile are synchronised to the disk together with it.
        batch.extend(waiting.try_iter().take(WAITING));
        let mut trouble = None;
        if not_before.is_some_and(|then| Instant::now() < then) {
            lost.lines += batch.len() as u64;
        } else {
            trouble = write_batch(&mut writers, batch, &mut lost).err().map(|e| e.to_string());
            not_before = trouble.as_ref().map(|_| Instant::now() + RETRY);
        }
        let mut shared = lock(shared);
        let (n, hash) = writers.record.last();
        (shared.state.last_n, shared.state.last_hash) = (n, hash.to_owned());
        let (n, hash) = writers.refused.last();
        shared.refused = (n, hash.to_owned());
        shared.rotated = writers.record.rotated() + writers.refused.rotated();
        shared.moved = writers.record.moved() + writers.refused.moved();
        shared.state.lost = lost.lines;
        if not_before.is_none() || trouble.is_some() {
            shared.state.trouble = trouble;
        }
    }
}

/// Lines that could not be written since the last success.
#[derive(Default)]
struct LostLogLines {
    lines: u64,
    /// Time of the first failure, and its reason.
    began: String,
}

/// Writes lines, after one that reports the lines lost before.
/// It counts the lines that could not be written.
fn write_batch(
    writers: &mut CommandAndRefusalLogs,
    batch: Vec<Entry>,
    so_far: &mut LostLogLines,
) -> std::io::Result<()> {
    let mut left = batch.len() as u64;
    let before = so_far.lines;
    let all = || {
        if so_far.lines > 0 {
            writers.record.append(lost(so_far.lines, &so_far.began))?;
            so_far.lines = 0;
        }
        for entry in batch {
            writers.of(&entry).append(entry)?;
            left -= 1;
        }
        writers.record.sync().and(writers.refused.sync())
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
    use rtec_control::audit_log::{ChainLine, read, verify};
    use std::path::PathBuf;

    fn command(pid: i32, result: &'static str) -> AnsweredCommand {
        AnsweredCommand {
            by: ClientProcess { uid: 7, pid, ..ClientProcess::default() },
            request: serde_json::json!({"do": "enable"}),
            result,
            text: String::new(),
            before: Totals::new(),
            after: Totals::new(),
            model: None,
        }
    }

    fn started() -> (tempfile::TempDir, PathBuf, AuditLogSender) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("audit.log");
        let audit = AuditLogSender::start(&path, None).unwrap();
        (directory, path, audit)
    }

    fn wait_until(is: impl Fn() -> bool) {
        let begun = Instant::now();
        while !is() {
            assert!(begun.elapsed() < Duration::from_secs(30));
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Waits until the lines that found the queue full are recorded.
    fn catch_up(audit: &mut AuditLogSender) {
        let begun = Instant::now();
        while audit.lost > 0 && begun.elapsed() < Duration::from_secs(30) {
            std::thread::sleep(Duration::from_millis(1));
            audit.note("start", String::new(), Totals::new());
        }
    }

    /// The lines of a record that has ended.
    fn ended(audit: AuditLogSender, path: &Path) -> Vec<Entry> {
        audit.end(Duration::from_secs(30));
        let mut all = Vec::new();
        read(path, &mut |line: ChainLine| all.push(line.entry.unwrap())).unwrap();
        all
    }

    #[test]
    fn what_is_refused_again_and_again_is_one_line_with_its_number() {
        let (_directory, path, mut audit) = started();
        for _ in 0..1000 {
            audit.command(command(1, "refused"));
            audit.command(command(2, "refused"));
        }
        audit.command(command(1, "done"));
        let all = ended(audit, &path);
        assert_eq!(all.len(), 5, "{all:?}");
        let repeated: Vec<_> = all.iter().filter_map(|e| e.times).collect();
        assert_eq!(repeated, [999, 999]);
        assert!(verify(&path, &[]).unwrap().broken.is_empty());
    }

    /// Questions of `commission` every 20 ms must not hide commands.
    #[test]
    fn a_jog_that_is_asked_again_and_again_is_one_line_with_its_number_and_every_new_one_its_own() {
        let (_directory, path, mut audit) = started();
        let jog = |mm: Option<f64>| serde_json::json!({"do": "jog", "axis": "x", "display_mm": mm});
        for mm in [1.0, 2.0] {
            audit.command(AnsweredCommand { request: jog(Some(mm)), ..command(1, "done") });
            for _ in 0..400 {
                audit.command(AnsweredCommand { request: jog(None), ..command(1, "done") });
                audit.turn();
            }
            audit.command(command(1, "done"));
        }
        audit.command(AnsweredCommand { request: jog(None), ..command(1, "done") });
        let mut go_on = jog(None);
        go_on["go_on"] = true.into();
        audit.command(AnsweredCommand { request: jog(None), ..command(1, "done") });
        audit.command(AnsweredCommand { request: go_on, ..command(1, "done") });
        // Another user's question is another line.
        audit.command(AnsweredCommand { request: jog(None), ..command(2, "done") });
        let all = ended(audit, &path);
        let told = |e: &Entry| {
            let request = e.request.as_ref().unwrap();
            (request["do"].as_str().unwrap().to_owned(), request["display_mm"].as_f64(), e.times)
        };
        let all: Vec<_> = all.iter().map(told).collect();
        let round = |mm| {
            [("jog", Some(mm), None), ("jog", None, None), ("jog", None, Some(399)), ("enable", None, None)]
        };
        let once = ("jog", None, None);
        let expected = [&round(1.0)[..], &round(2.0), &[once, ("jog", None, Some(1)), once, once]].concat();
        let all: Vec<_> = all.iter().map(|(what, mm, times)| (what.as_str(), *mm, *times)).collect();
        assert_eq!(all, expected);
        assert!(verify(&path, &[]).unwrap().broken.is_empty());
    }

    #[test]
    fn refusals_that_are_never_the_same_do_not_write_the_record_full() {
        let (_directory, path, mut audit) = started();
        audit.note("start", String::new(), Totals::new());
        for n in 0..5000 {
            let request = serde_json::json!({"do": "correct", "total_counts": n});
            audit.command(AnsweredCommand { request, ..command(n, "refused") });
        }
        let by = ClientProcess { uid: 8, ..ClientProcess::default() };
        audit.command(AnsweredCommand { by, ..command(1, "refused") });
        let all = ended(audit, &path);
        let of =
            |uid| all.iter().filter(|e| e.by.as_ref().is_some_and(|by| by.uid == uid)).collect::<Vec<_>>();
        assert_eq!((of(7).len(), of(8).len()), (KINDS + 2, 1));
        assert_eq!(of(7).last().unwrap().times, Some(5000 - KINDS as u64 - 1));
    }

    #[test]
    fn what_happens_is_recorded_with_its_axis() {
        let (_directory, path, mut audit) = started();
        for (kind, axis) in [("fault", Some("x")), ("trip", Some("x")), ("mode", None)] {
            let (axis, text) = (axis.map(str::to_owned), "t".to_owned());
            let happened = EventReport { t_ns: 0, axis, kind: kind.to_owned(), text, trip: None };
            audit.happened(&happened, Totals::new());
        }
        let all: Vec<_> = ended(audit, &path).into_iter().map(|e| (e.what, e.axis)).collect();
        assert_eq!(all, [("fault".to_owned(), Some("x".to_owned())), ("mode".to_owned(), None)]);
    }

    #[test]
    fn a_place_that_takes_nothing_is_told_when_it_does_again() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("later/audit.log");
        let mut audit = AuditLogSender::start(&path, None).unwrap();
        audit.command(command(1, "done"));
        wait_until(|| audit.state().trouble.is_some());
        assert_eq!(audit.state().lost, 1);
        std::fs::create_dir(directory.path().join("later")).unwrap();
        wait_until(|| audit.state().last_n > 0);
        audit.command(command(1, "done"));
        let all = ended(audit, &path);
        assert_eq!((all[0].what.as_str(), all[0].times, all.len()), ("lost", Some(1), 2));
        assert!(all[0].text.contains("No such file"), "{}", all[0].text);
    }

    #[test]
    fn refusals_never_displace_a_command() {
        let (_directory, path, mut audit) = started();
        audit.command(command(1, "done"));
        // Minutes of varied refusals of maximal length, from a user with a budget.
        let refusals = if test_needs::long() { 14 * 60 * 20 } else { 2 * 60 * 20 };
        for n in 0..refusals {
            let request = serde_json::json!({"do": "correct", "axis": format!("{n}{}", "x".repeat(4000))});
            audit.command(AnsweredCommand { request, text: "y".repeat(4000), ..command(n, "refused") });
            if n % 20 == 0 {
                // As if a second had passed.
                for r in audit.repeated.values_mut() {
                    r.since = r.since.checked_sub(TOGETHER).unwrap();
                }
                audit.turn();
            }
            catch_up(&mut audit);
        }
        let all = ended(audit, &path);
        let bytes = |path: &Path| std::fs::metadata(path).unwrap().len();
        assert!(bytes(&path) < 100_000, "{}", bytes(&path));
        // A few hundred lines, and then a count of each verb.
        assert!(bytes(&refused_path(&path)) < 2_000_000, "{}", bytes(&refused_path(&path)));
        assert!(all.iter().any(|e| e.result == "done" && e.n == 1));
        let told: u64 = all.iter().filter(|e| e.result == "refused").map(|e| e.times.unwrap_or(1)).sum();
        assert_eq!(told, u64::try_from(refusals).unwrap());
        assert!(verify(&path, &[]).unwrap().broken.is_empty());
    }

    #[test]
    fn whoever_operates_does_not_write_the_record_full() {
        let (_directory, path, mut audit) = started();
        let by = |role: &str| ClientProcess { uid: 7, role: role.to_owned(), ..ClientProcess::default() };
        let happened =
            EventReport { t_ns: 0, axis: None, kind: "mode".to_owned(), text: "hold".to_owned(), trip: None };
        for n in 0..5000 {
            let request = serde_json::json!({"do": "hold", "on": n % 2 == 0});
            audit.command(AnsweredCommand { by: by("operate"), request, ..command(1, "done") });
            audit.happened(&happened, Totals::new());
            catch_up(&mut audit);
        }
        for _ in 0..3 {
            audit.command(AnsweredCommand { by: by("set_up"), ..command(1, "done") });
        }
        let all = ended(audit, &path);
        let of = |role: &str| all.iter().filter(|e| e.by.as_ref().is_some_and(|by| by.role == role)).count();
        // Each command to set up has its line, whichever budget is used up.
        assert_eq!(of("set_up"), 3);
        assert!((BUDGET as usize..BUDGET as usize + 10).contains(&of("operate")), "{}", of("operate"));
        let counted = |what: &str| -> u64 {
            all.iter()
                .filter(|e| e.what == what && e.by.as_ref().is_none_or(|by| by.role == "operate"))
                .map(|e| e.times.unwrap_or(1))
                .sum()
        };
        assert_eq!((counted("command"), counted("mode")), (5000, 5000));
    }

    #[test]
    fn the_end_of_the_record_is_anchored_at_first_and_once_a_day() {
        let (_directory, path, mut audit) = started();
        assert_eq!(audit.anchor(), None);
        let until = |audit: &AuditLogSender, n: u64| wait_until(|| audit.state().last_n >= n);
        audit.command(command(1, "done"));
        until(&audit, 1);
        let first = audit.anchor().unwrap();
        audit.command(command(1, "done"));
        until(&audit, 2);
        assert_eq!(audit.anchor(), None);
        let a_day_ago = Instant::now().checked_sub(ANCHOR_EVERY);
        if let (Some(last), Some(then)) = (&mut audit.anchored, a_day_ago) {
            last.at = then;
            let second = audit.anchor().unwrap();
            let anchors = ChainAnchor::all(&format!("{first}\n{second}"));
            assert_eq!(anchors.iter().map(|a| a.n).collect::<Vec<_>>(), [1, 2]);
            assert!(verify(&path, &anchors).unwrap().broken.is_empty());
        }
        lock(&audit.shared).rotated = 1;
        let told = audit.anchor();
        // Nothing was written since the last anchor.
        assert_eq!(told.is_none(), a_day_ago.is_some());
        std::fs::remove_file(&path).unwrap();
        audit.command(command(1, "done"));
        until(&audit, 4);
        assert!(audit.has_moved() && !audit.has_moved());
    }
}
