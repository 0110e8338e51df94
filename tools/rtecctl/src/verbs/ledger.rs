//! `rtecctl ledger`: what each axis was asked for and what was inserted, as files that `rtecctl replay` plays.

use crate::Outcome;
use crate::daemon::{Daemon, NO_EVENTS, check, observe, unreachable};
use crate::document::{line, pretty};
use crate::say;
use anyhow::Context;
use clap::Subcommand;
use rtec_control::client::Client;
use rtec_control::protocol::{AxisReport, ClientRequest, LedgerPage, LedgerRow, Response};
use rtec_driver::quadrature::State;
use rtec_driver::replay::TracePoint;
use rtec_files::trace::{RequestReader, TraceFile, TraceReader};
use rtec_rt::axis::AxisConfig;
use rtec_sim::bench::{AnyDesign, replay_any};
use serde_json::json;
use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What each axis was asked for, and every insertion
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: LedgerAction,
}

#[derive(Debug, Subcommand)]
enum LedgerAction {
    /// Write counts, totals and every insertion with its time since homing, for `rtecctl replay`
    ///
    /// For each axis it writes `AXIS_trace.csv`, `AXIS_requests.csv` and `AXIS_insertions.csv`. Trace and requests are
    /// replayed at once; exit 1 if the replay gives other totals. The insertions are every change of the ledger between
    /// two looks of the daemon, with position and totals. The daemon looks every 10 ms and keeps the last 8192 changes.
    /// Positions are right at the looks before and after a change, and now. Between two changes the trace is one
    /// straight line: it is no record of the motion. Replaying the exported requests gives the same totals. The
    /// requests that were made are in the column `requested` of the insertions.
    Export {
        /// The folder to write to; it is made where it is not there
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// This axis only
        #[arg(long, value_name = "NAME")]
        axis: Option<String>,
        /// The last changes only, as 60s
        #[arg(long, value_name = "TIME")]
        last: Option<humantime::Duration>,
        #[command(flatten)]
        daemon: Daemon,
    },
}

/// More edges than this in one trace are nobody's wish.
const MOST_EDGES: u64 = 50_000_000;
/// What stands in front of a trace.
const TRACE_IS: [&str; 2] = [
    "made from a ledger: positions are right at the looks at which the ledger changed (since_ns, t_ns of the insertions) and at the end;",
    "between two changes it is one even, straight way, whatever the axis did there: no record of the motion",
];
/// What stands in front of the requests.
const REQUESTS_ARE: &str = "# totals that lead to the ledger's insertions when they are replayed; what was asked for: requested of the insertions\n";
/// Time for an edge that was never seen, where an insertion needs one.
const EDGE_NS: u64 = 100_000;

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let LedgerAction::Export { out, axis, last, daemon } = &args.what;
    let mut client = daemon.view()?;
    let status = observe(&mut client, NO_EVENTS)?.status;
    let wanted = |a: &&AxisReport| axis.as_ref().is_none_or(|name| *name == a.name);
    let axes: Vec<_> = status.axes.iter().filter(wanted).collect();
    if axes.is_empty() {
        let names: Vec<_> = status.axes.iter().map(|a| a.name.as_str()).collect();
        let text = format!(
            "--axis: found {:?}, expected one of {}",
            axis.as_deref().unwrap_or(""),
            names.join(", ")
        );
        return Err(Outcome::Bad(text).into());
    }
    let not_homed: Vec<_> = axes.iter().filter(|a| !a.homed).map(|a| a.name.clone()).collect();
    std::fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    let (mut all, mut other) = (Vec::new(), Vec::new());
    for axis in axes {
        let mut kept = fetch(&mut client, &axis.name)?;
        if let Some(last) = last {
            shorten(&mut kept, Duration::from(*last));
        }
        let files = |what| out.join(format!("{}_{what}.csv", axis.name));
        let told = LedgerExport::of(&kept, axis.window_counts);
        if told.edges > MOST_EDGES {
            let text = format!(
                "axis {}: {} edges since {} ns, more than {MOST_EDGES}: --last TIME for fewer",
                axis.name, told.edges, told.whole_from_ns
            );
            return Err(Outcome::No(text).into());
        }
        told.write(&kept, &files("trace"), &files("requests"), &files("insertions"))?;
        let again = replayed(&files("trace"), &files("requests"))?;
        let same = (again.counts_in, again.requested, again.completed)
            == (told.counts, told.requested, told.completed);
        if !same {
            other.push(axis.name.clone());
        }
        if !daemon.json {
            println!(
                "axis {}: {} counts, requested {:+}, completed {:+}, {} insertions in {:.3} s; replayed: {}",
                axis.name,
                told.counts,
                told.requested,
                told.completed,
                told.insertions,
                (kept.now_ns - told.whole_from_ns) as f64 * 1e-9,
                if same { told.compared(again.insertions) } else { "NOT the same".to_owned() }
            );
            if told.before != 0 || kept.dropped > 0 {
                println!(
                    "  whole from {} ns on the card's clock; {:+} counts were inserted before, they stand as one request; \
                     {} older changes are no longer kept",
                    told.whole_from_ns, told.before, kept.dropped
                );
            }
        }
        all.push(json!({
            "axis": axis.name, "counts": told.counts, "requested": told.requested, "completed": told.completed,
            "insertions": told.insertions, "whole_from_ns": told.whole_from_ns, "completed_before": told.before,
            "changes_dropped": kept.dropped, "until_ns": kept.now_ns, "replays": same,
            "insertions_in_shadow": told.shadow,
            "replayed": {
                "counts_in": again.counts_in, "requested": again.requested, "completed": again.completed,
                "insertions": again.insertions,
            },
        }));
    }
    let document = json!({ "machine": status.machine, "axes": all });
    let file = out.join("ledger.json");
    rtec_files::write::whole(&file, pretty(&document)?.as_bytes())
        .with_context(|| format!("writing {}", file.display()))?;
    if daemon.json {
        say(&line(&document)?);
    } else if !not_homed.is_empty() {
        eprintln!(
            "rtecctl: axis {} not homed: counted from the daemon's start; `rtecctl home` begins the ledger",
            not_homed.join(", ")
        );
    }
    if other.is_empty() {
        return Ok(());
    }
    let text = format!("axis {}: replayed, the files do not give the totals of the daemon", other.join(", "));
    Err(Outcome::No(text).into())
}

/// All that is kept of an axis's ledger.
fn fetch(client: &mut Client, axis: &str) -> anyhow::Result<LedgerPage> {
    let mut whole: Option<LedgerPage> = None;
    loop {
        let from = whole.as_ref().map_or(0, |w| w.first + w.rows.len() as u64);
        let request = ClientRequest::Ledger { axis: axis.to_owned(), from };
        let page = match check(client.ask(&request).map_err(unreachable)?)? {
            Response::Ledger(page) => page,
            other => anyhow::bail!("rtecd answered {other:?}; are rtecctl and rtecd of the same version?"),
        };
        // Homed in the meantime, or overtaken: from the start.
        if page.first != from && whole.is_some() {
            whole = None;
            continue;
        }
        let done = page.first + page.rows.len() as u64 >= page.end;
        match &mut whole {
            None => whole = Some(page),
            Some(whole) => {
                whole.rows.extend(page.rows);
                (whole.end, whole.now_ns, whole.now_counts) = (page.end, page.now_ns, page.now_counts);
            }
        }
        if let Some(whole) = whole.take_if(|_| done) {
            return Ok(whole);
        }
    }
}

/// Leaves the changes of the last time, and the one before them as where they begin.
fn shorten(kept: &mut LedgerPage, last: Duration) {
    let from = kept.now_ns.saturating_sub(last.as_nanos().min(u128::from(u64::MAX)) as u64);
    let older = kept.rows.partition_point(|r| r.t_ns < from).saturating_sub(1);
    kept.rows.drain(..older);
    kept.first += older as u64;
}

/// A ledger's story: what the files will say.
struct LedgerExport {
    window: i64,
    /// From here on every change is known.
    whole_from_ns: u64,
    /// Completed before that.
    before: i64,
    counts: i64,
    requested: i64,
    completed: i64,
    insertions: u64,
    /// Of these, in shadow mode: nothing was written.
    shadow: u64,
    edges: u64,
}

impl LedgerExport {
    fn of(kept: &LedgerPage, window: i64) -> Self {
        let first = kept.rows.first().copied().unwrap_or_default();
        let last = kept.rows.last().copied().unwrap_or_default();
        let mut told = Self {
            window: window.max(2) / 2 * 2,
            whole_from_ns: first.t_ns,
            before: first.completed,
            counts: kept.now_counts - first.position_counts,
            requested: last.requested,
            completed: last.completed,
            insertions: last.insertions - first.insertions,
            shadow: in_shadow(&kept.rows),
            edges: 0,
        };
        let mut edges = 0;
        // Counting does not fail.
        let _ = told.tell(
            kept,
            &mut |_, _| {
                edges += 1;
                Ok(())
            },
            &mut |_, _| {},
        );
        told.edges = edges;
        told
    }

    /// How a replay that gives the same totals compares.
    fn compared(&self, insertions: u64) -> String {
        if insertions == self.insertions {
            return "the same".to_owned();
        }
        let why = match self.shadow {
            0 => "what took each other back between two looks, or was not inserted one by one, is not told apart".to_owned(),
            n => format!("{n} of the {} in shadow mode, which the MTC did not see", self.insertions),
        };
        format!("the same totals, by {insertions} insertions ({why})")
    }

    /// Gives every edge (time, position) after the first row and every request (time, total), in order of time.
    fn tell(
        &self,
        kept: &LedgerPage,
        edge: &mut dyn FnMut(u64, i64) -> io::Result<()>,
        request: &mut dyn FnMut(u64, i64),
    ) -> io::Result<()> {
        let Some(first) = kept.rows.first() else { return Ok(()) };
        let mut at = Stretch { t_ns: Self::start_ns(first), counts: first.position_counts };
        // What was there before: asked for at once, and edges to insert it at.
        self.ask(at.t_ns, 0, first.completed, request);
        at.go(first.t_ns, first.position_counts, lead_edges(first), &mut |_, t, p| edge(t, p))?;
        let mut before = *first;
        for row in &kept.rows[1..] {
            at.go(row.since_ns, row.since_counts, 0, &mut |_, t, p| edge(t, p))?;
            let change = row.completed - before.completed;
            let made = row.insertions.saturating_sub(before.insertions);
            // Insertions that took each other back: there first, and back.
            let back = (made as i64 - change.abs() / 2).max(0) / 2;
            let far = row.completed + 2 * back * if change < 0 { -1 } else { 1 };
            self.ask(at.t_ns, before.completed, far, request);
            let turn = (far - before.completed).unsigned_abs() / 2 + 1 + TURNS;
            at.go(row.t_ns, row.position_counts, made + 2 + 2 * TURNS, &mut |n, t, p| {
                if n == turn && back > 0 {
                    self.ask(t, far, row.completed, request);
                }
                edge(t, p)
            })?;
            before = *row;
        }
        at.go(kept.now_ns, kept.now_counts, 0, &mut |_, t, p| edge(t, p))?;
        if before.requested != before.completed {
            self.ask(at.t_ns, before.completed, before.requested, request);
        }
        Ok(())
    }

    fn start_ns(first: &LedgerRow) -> u64 {
        first.t_ns.saturating_sub((lead_edges(first) + 1) * EDGE_NS)
    }

    /// A total, in steps that the belief window lets through.
    fn ask(&self, t_ns: u64, from: i64, to: i64, request: &mut dyn FnMut(u64, i64)) {
        let mut total = from;
        while total != to {
            total += (to - total).clamp(-self.window, self.window);
            request(t_ns, total);
        }
    }

    fn write(
        &self,
        kept: &LedgerPage,
        trace: &Path,
        requests: &Path,
        insertions: &Path,
    ) -> anyhow::Result<()> {
        let mut file = TraceFile::create_noted(trace, &TRACE_IS)?;
        let mut rows = REQUESTS_ARE.to_owned() + "t_ns,requested\n";
        let first = kept.rows.first().copied().unwrap_or_default();
        let writing = |file: &Path| format!("writing {}", file.display());
        file.write(TracePoint { t_ns: Self::start_ns(&first), state: state(0) })
            .with_context(|| writing(trace))?;
        let mut point =
            |t_ns, counts: i64| file.write(TracePoint { t_ns, state: state(counts - first.position_counts) });
        // Writing to a String does not fail.
        let mut request = |t_ns, total| {
            let _ = writeln!(rows, "{t_ns},{total}");
        };
        self.tell(kept, &mut point, &mut request).with_context(|| writing(trace))?;
        file.finish().with_context(|| writing(trace))?;
        rtec_files::write::whole(requests, rows.as_bytes()).with_context(|| writing(requests))?;
        let mut table =
            "since_ns,since_counts,t_ns,position_counts,requested,completed,in_effect,insertions\n"
                .to_owned();
        for r in &kept.rows {
            let LedgerRow {
                since_ns,
                since_counts,
                t_ns,
                position_counts,
                requested,
                completed,
                in_effect,
                insertions,
            } = r;
            let _ = writeln!(
                table,
                "{since_ns},{since_counts},{t_ns},{position_counts},{requested},{completed},{in_effect},{insertions}"
            );
        }
        rtec_files::write::whole(insertions, table.as_bytes()).with_context(|| writing(insertions))
    }
}

/// Insertions that changed the total and not what is in effect.
fn in_shadow(rows: &[LedgerRow]) -> u64 {
    let pairs =
        rows.windows(2).filter(|w| w[0].completed != w[1].completed && w[0].in_effect == w[1].in_effect);
    pairs.map(|w| w[1].insertions.saturating_sub(w[0].insertions)).sum()
}

/// Times that a stretch turns round at most: no insertion begins at an edge at which the axis turns.
const TURNS: u64 = 3;

/// Edges before the first row, for what had been inserted by then.
fn lead_edges(first: &LedgerRow) -> u64 {
    if first.completed == 0 { 0 } else { first.completed.unsigned_abs() / 2 + 3 + TURNS }
}

/// Where the axis is as the story goes.
struct Stretch {
    t_ns: u64,
    counts: i64,
}

impl Stretch {
    /// Goes evenly to a place, with so many edges at least: those that the way does not have are beyond it and back again.
    fn go(
        &mut self,
        t_ns: u64,
        to: i64,
        at_least: u64,
        edge: &mut dyn FnMut(u64, u64, i64) -> io::Result<()>,
    ) -> io::Result<()> {
        let way = self.counts.abs_diff(to);
        let pairs = at_least.saturating_sub(way).div_ceil(2);
        let edges = way + 2 * pairs;
        let begun = self.t_ns;
        let onward = if to < self.counts { -1 } else { 1 };
        for n in 1..=edges {
            let at = u128::from(t_ns.saturating_sub(begun)) * u128::from(n) / u128::from(edges + 1);
            // Two looks at one moment do not happen; still, times must rise.
            self.t_ns = (begun + at as u64).max(self.t_ns + 1);
            let beyond = n.saturating_sub(way);
            self.counts += match beyond {
                0 => (to - self.counts).signum(),
                _ if beyond <= pairs => onward,
                _ => -onward,
            };
            edge(n, self.t_ns, self.counts)?;
        }
        self.t_ns = self.t_ns.max(t_ns);
        Ok(())
    }
}

/// The state of a count: 00, 10, 11, 01 for 0 to 3.
fn state(counts: i64) -> State {
    let n = counts.rem_euclid(4);
    State::new(n == 1 || n == 2, n == 2 || n == 3)
}

/// What the engine makes of the files.
struct Replayed {
    counts_in: i64,
    requested: i64,
    completed: i64,
    insertions: u64,
}

fn replayed(trace: &Path, requests: &Path) -> anyhow::Result<Replayed> {
    let (trace, requests) = (TraceReader::open(trace)?.playable(), RequestReader::open(requests)?);
    let config = AxisConfig { max_correction_counts: i64::MAX, ..AxisConfig::default() };
    let (outcome, _) = replay_any(AnyDesign::C, config, trace, requests, true, |_, _: State| {})
        .map_err(|e| anyhow::anyhow!("replaying what was written: {e}"))?;
    let rtec_sim::replay::ReplayOutcome { counts_in, requested, completed, insertions, .. } = outcome;
    Ok(Replayed { counts_in, requested, completed, insertions })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(since: (u64, i64), at: (u64, i64), requested: i64, completed: i64, insertions: u64) -> LedgerRow {
        LedgerRow {
            since_ns: since.0 * 1_000_000,
            since_counts: since.1,
            t_ns: at.0 * 1_000_000,
            position_counts: at.1,
            requested,
            completed,
            in_effect: completed,
            insertions,
        }
    }

    fn page(rows: Vec<LedgerRow>, now: (u64, i64)) -> LedgerPage {
        let end = rows.len() as u64;
        LedgerPage { first: 0, rows, end, dropped: 0, now_ns: now.0 * 1_000_000, now_counts: now.1 }
    }

    #[track_caller]
    fn replays(kept: &LedgerPage, counts: i64, requested: i64, completed: i64) {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let told = LedgerExport::of(kept, 50);
        told.write(kept, &file("t.csv"), &file("r.csv"), &file("i.csv")).unwrap();
        let again = replayed(&file("t.csv"), &file("r.csv")).unwrap();
        assert_eq!(
            (again.counts_in, again.requested, again.completed),
            (counts, requested, completed),
            "{}",
            std::fs::read_to_string(file("r.csv")).unwrap()
        );
        assert_eq!((told.counts, told.requested, told.completed), (counts, requested, completed));
        // Whoever opens a file finds in it what it is.
        let trace = std::fs::read_to_string(file("t.csv")).unwrap();
        assert!(
            trace.starts_with("# made from a ledger")
                && trace.contains("no record of the motion\nt_ns,a,b\n")
        );
        let requests = std::fs::read_to_string(file("r.csv")).unwrap();
        assert!(requests.starts_with("# totals that lead to") && requests.contains("\nt_ns,requested\n"));
        let table = std::fs::read_to_string(file("i.csv")).unwrap();
        assert_eq!(table.lines().count(), kept.rows.len() + 1);
    }

    #[test]
    fn the_files_give_the_same_totals() {
        let zero = row((100, 0), (100, 0), 0, 0, 0);
        replays(&page(vec![zero], (200, -300)), -300, 0, 0);
        // Forwards; an axis that turned between two looks; one that stood there.
        let rows = vec![
            zero,
            row((200, 1500), (210, 1700), 40, 40, 20),
            row((300, 900), (310, 900), 60, 44, 22),
            row((320, 900), (330, 899), 60, 60, 30),
        ];
        replays(&page(rows.clone(), (900, -50)), -50, 60, 60);
        // There and back between two looks; a large jump; taken out.
        let mut more = rows;
        more.push(row((400, 800), (410, 800), 60, 60, 36));
        more.push(row((500, 0), (520, 60), 400, 400, 206));
        more.push(row((600, 0), (620, 2), 0, 0, 406));
        replays(&page(more, (1000, 10)), 10, 0, 0);
    }

    /// In shadow mode a total comes and goes without an insertion that the MTC sees.
    #[test]
    fn other_numbers_of_insertions_do_not_stand_beside_the_same_without_a_word() {
        let shadow = |r: LedgerRow| LedgerRow { in_effect: 0, ..r };
        let rows = vec![
            row((100, 0), (100, 0), 0, 0, 0),
            shadow(row((200, 100), (210, 110), 2, 2, 1)),
            row((300, 200), (310, 210), 0, 0, 1),
            row((400, 300), (410, 320), 4, 4, 3),
        ];
        let told = LedgerExport::of(&page(rows, (500, 400)), 50);
        assert_eq!((told.insertions, told.shadow), (3, 1));
        let says = "the same totals, by 4 insertions (1 of the 3 in shadow mode, which the MTC did not see)";
        assert_eq!((told.compared(3), told.compared(4)), ("the same".to_owned(), says.to_owned()));
    }

    #[test]
    fn what_was_there_before_stands_as_a_request() {
        let rows =
            vec![row((100, 777), (100, 777), -120, -120, 500), row((150, 800), (160, 820), -122, -122, 501)];
        replays(&page(rows, (300, 1000)), 223, -122, -122);
    }

    #[test]
    fn the_last_changes_begin_with_the_one_before_them() {
        let zero = row((100, 0), (100, 0), 0, 0, 0);
        let mut kept =
            page(vec![zero, row((200, 5), (210, 6), 2, 2, 1), row((800, 9), (810, 9), 4, 4, 2)], (900, 9));
        shorten(&mut kept, Duration::from_millis(300));
        assert_eq!((kept.rows.len(), kept.rows[0].completed), (2, 2));
        shorten(&mut kept, Duration::from_secs(3600));
        assert_eq!(kept.rows.len(), 2);
    }
}
