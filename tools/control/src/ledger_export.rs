//! An axis's ledger as files that a replay plays: trace, requests, insertions.

use crate::protocol::{LedgerPage, LedgerRow};
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use rtec_files::quadrature_trace::AtomicTraceFile;
use std::fmt::Write as _;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Heading comment of a trace.
const TRACE_IS: [&str; 2] = [
    "made from a ledger: positions are right at the looks at which the ledger changed (since_ns, t_ns of the insertions) and at the end;",
    "between two changes it is one even, straight way, whatever the axis did there: no record of the motion",
];
/// Heading comment of the requests.
const REQUESTS_ARE: &str = "# totals that lead to the ledger's insertions when they are replayed; what was asked for: requested of the insertions\n";
/// Time allowed for an unrecorded edge at which an insertion can begin, ns.
const EDGE_NS: u64 = 100_000;

impl LedgerPage {
    /// Keeps the changes of the last `last`, and the one before them as their start.
    pub fn shorten(&mut self, last: Duration) {
        let from = self.now_ns.saturating_sub(last.as_nanos().min(u128::from(u64::MAX)) as u64);
        let older = self.rows.partition_point(|r| r.t_ns < from).saturating_sub(1);
        self.rows.drain(..older);
        self.first += older as u64;
    }
}

/// Summary of the files that an axis's ledger is written to.
#[derive(Debug)]
pub struct LedgerExportSummary {
    /// The belief window, counts.
    window: i64,
    /// Time from which every change is known, ns on the card's clock.
    pub whole_from_ns: u64,
    /// Total completed before that time, counts.
    pub before: i64,
    /// The scale's counts since then.
    pub counts: i64,
    /// The last total requested, counts.
    pub requested: i64,
    /// The last total completed, counts.
    pub completed: i64,
    /// Insertions since then.
    pub insertions: u64,
    /// Insertions among these in shadow mode, in which nothing is written.
    pub shadow: u64,
    /// Edges of the trace.
    pub edges: u64,
}

impl LedgerExportSummary {
    /// Summarises the kept changes; `window` is the belief window, counts.
    pub fn of(kept: &LedgerPage, window: i64) -> Self {
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

    /// Compares the number of insertions of a replay that gives the same totals.
    pub fn compared(&self, insertions: u64) -> String {
        if insertions == self.insertions {
            return "the same".to_owned();
        }
        let why = match self.shadow {
            0 => "what took each other back between two looks, or was not inserted one by one, is not told apart".to_owned(),
            n => format!("{n} of the {} in shadow mode, which the MTC did not see", self.insertions),
        };
        format!("the same totals, by {insertions} insertions ({why})")
    }

    /// Reports every edge and every request after the first row, in order of time.
    fn tell(
        &self,
        kept: &LedgerPage,
        edge: &mut dyn FnMut(u64, i64) -> io::Result<()>,
        request: &mut dyn FnMut(u64, i64),
    ) -> io::Result<()> {
        let Some(first) = kept.rows.first() else { return Ok(()) };
        let mut at = ReconstructedAxisPosition { t_ns: Self::start_ns(first), counts: first.position_counts };
        // The total before the first row is requested at once, with edges to insert it at.
        self.ask(at.t_ns, 0, first.completed, request);
        at.go(first.t_ns, first.position_counts, lead_edges(first), &mut |_, t, p| edge(t, p))?;
        let mut before = *first;
        for row in &kept.rows[1..] {
            at.go(row.since_ns, row.since_counts, 0, &mut |_, t, p| edge(t, p))?;
            let change = row.completed - before.completed;
            let made = row.insertions.saturating_sub(before.insertions);
            // Insertions that cancelled each other: first the way there, then the way back.
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

    /// Requests a total in steps that the belief window accepts.
    fn ask(&self, t_ns: u64, from: i64, to: i64, request: &mut dyn FnMut(u64, i64)) {
        let mut total = from;
        while total != to {
            total += (to - total).clamp(-self.window, self.window);
            request(t_ns, total);
        }
    }

    /// Writes the trace, the requests and the table of insertions.
    ///
    /// # Errors
    /// The file that cannot be written, and why.
    pub fn write(&self, kept: &LedgerPage, [trace, requests, insertions]: [&Path; 3]) -> io::Result<()> {
        let mut rows = REQUESTS_ARE.to_owned() + "t_ns,requested\n";
        let first = kept.rows.first().copied().unwrap_or_default();
        let of = |file: &Path| {
            let name = file.display().to_string();
            move |e: io::Error| io::Error::new(e.kind(), format!("writing {name}: {e}"))
        };
        let mut file = AtomicTraceFile::create_noted(trace, &TRACE_IS).map_err(io::Error::other)?;
        file.write(TracePoint { t_ns: Self::start_ns(&first), state: state(0) }).map_err(of(trace))?;
        let mut point =
            |t_ns, counts: i64| file.write(TracePoint { t_ns, state: state(counts - first.position_counts) });
        // Writing to a String does not fail.
        let mut request = |t_ns, total| {
            let _ = writeln!(rows, "{t_ns},{total}");
        };
        self.tell(kept, &mut point, &mut request).map_err(of(trace))?;
        file.finish().map_err(of(trace))?;
        rtec_files::atomic_write::write_atomically(requests, rows.as_bytes()).map_err(of(requests))?;
        let mut table =
            "since_ns,since_counts,t_ns,position_counts,requested,completed,in_effect,insertions\n"
                .to_owned();
        for r in &kept.rows {
            let _ = write!(table, "{},{},{},{},", r.since_ns, r.since_counts, r.t_ns, r.position_counts);
            let _ = writeln!(table, "{},{},{},{}", r.requested, r.completed, r.in_effect, r.insertions);
        }
        rtec_files::atomic_write::write_atomically(insertions, table.as_bytes()).map_err(of(insertions))
    }
}

/// Insertions that changed the total but not the counts in effect.
fn in_shadow(rows: &[LedgerRow]) -> u64 {
    let pairs =
        rows.windows(2).filter(|w| w[0].completed != w[1].completed && w[0].in_effect == w[1].in_effect);
    pairs.map(|w| w[1].insertions.saturating_sub(w[0].insertions)).sum()
}

/// Largest number of turns in a stretch: no insertion begins at a turn.
const TURNS: u64 = 3;

/// Edges before the first row, for what had been inserted by then.
fn lead_edges(first: &LedgerRow) -> u64 {
    if first.completed == 0 { 0 } else { first.completed.unsigned_abs() / 2 + 3 + TURNS }
}

/// The reconstructed axis: time and position.
struct ReconstructedAxisPosition {
    t_ns: u64,
    counts: i64,
}

impl ReconstructedAxisPosition {
    /// Moves evenly to a position, with an overshoot if too few edges lie on the way.
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
            // Two looks never have the same time; times must rise all the same.
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
