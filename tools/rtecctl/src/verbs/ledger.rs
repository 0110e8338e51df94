//! `rtecctl ledger`: requests and insertions of each axis, as files for a replay.

use crate::daemon_connection::{NO_EVENTS, ask, expected, observe};
use crate::prelude::*;
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::ledger_export::LedgerExportSummary;
use rtec_control::protocol::{AxisReport, ClientRequest, DaemonResponse, LedgerPage};
use rtec_driver::quadrature::State;
use rtec_files::ColumnAssignment;
use rtec_files::quadrature_trace::{RequestedTotalReader, TraceReader};
use rtec_rt::axis::AxisConfig;
use rtec_sim::engine_replay::ReplayOutcome;
use rtec_sim::insertion_design_bench::{InsertionDesign, replay_any};

super::verbs_below! {
    /// What each axis was asked for, and every insertion
    Args;
    Export ExportArgs => export;
}

/// Write counts, totals and every insertion with its time since homing, for `rtecctl replay`
///
/// For each axis it writes `AXIS_trace.csv`, `AXIS_requests.csv` and `AXIS_insertions.csv`. Trace and requests are
/// replayed at once; exit 1 if the replay gives other totals. The insertions are every change of the ledger between
/// two looks of the daemon, with position and totals. The daemon looks every 10 ms and keeps the last 8192 changes.
/// Positions are right at the looks before and after a change, and now. Between two changes the trace is one
/// straight line: it is no record of the motion. Replaying the exported requests gives the same totals. The
/// requests that were made are in the column `requested` of the insertions.
#[derive(Debug, clap::Args)]
struct ExportArgs {
    /// The folder to write to; it is made where it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// This axis only
    #[arg(long, value_name = "NAME")]
    axis: Option<String>,
    /// The last changes only, as 60s
    #[arg(long, value_name = "TIME", value_parser = rtec_files::cli_option_parsers::duration)]
    last: Option<Duration>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Largest number of edges in one trace; more is taken for a mistake.
const MOST_EDGES: u64 = 50_000_000;

fn export(args: &ExportArgs) -> anyhow::Result<()> {
    let ExportArgs { out, axis, last, daemon } = args;
    let mut client = daemon.view()?;
    let status = observe(&mut client, NO_EVENTS)?.status;
    let wanted = |a: &&AxisReport| axis.as_ref().is_none_or(|name| *name == a.name);
    let axes: Vec<_> = status.axes.iter().filter(wanted).collect();
    let (found, names) = (axis.as_deref().unwrap_or(""), list(status.axes.iter().map(|a| &a.name)));
    ensure!(!axes.is_empty(), Bad, "--axis: found {found:?}, expected one of {names}");
    let not_homed = list(axes.iter().filter(|a| !a.homed).map(|a| &a.name));
    std::fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    let (mut all, mut other) = (Vec::new(), Vec::new());
    for axis in axes {
        let mut kept = fetch(&mut client, &axis.name)?;
        if let Some(last) = last {
            kept.shorten(*last);
        }
        let files = |what| out.join(format!("{}_{what}.csv", axis.name));
        let told = LedgerExportSummary::of(&kept, axis.window_counts);
        let LedgerExportSummary { edges, counts, requested, completed, insertions, before, .. } = told;
        let (name, whole_from_ns) = (&axis.name, told.whole_from_ns);
        if edges > MOST_EDGES {
            let much = format!("{edges} edges since {whole_from_ns} ns, more than {MOST_EDGES}");
            fail!(No, "axis {name}: {much}: --last TIME for fewer");
        }
        let [trace, requests, table] = ["trace", "requests", "insertions"].map(files);
        told.write(&kept, [&trace, &requests, &table])?;
        let again = replayed(&trace, &requests)?;
        let same = (again.counts_in, again.requested, again.completed) == (counts, requested, completed);
        if !same {
            other.push(name.clone());
        }
        let dropped = kept.dropped;
        if !daemon.json {
            let seconds = (kept.now_ns - whole_from_ns) as f64 * 1e-9;
            let replay = if same { told.compared(again.insertions) } else { "NOT the same".to_owned() };
            println!(
                "axis {name}: {counts} counts, requested {requested:+}, completed {completed:+}, {insertions} insertions in \
                 {seconds:.3} s; replayed: {replay}"
            );
            if before != 0 || dropped > 0 {
                println!(
                    "  whole from {whole_from_ns} ns on the card's clock; {before:+} counts were inserted before, they stand as one \
                     request; {dropped} older changes are no longer kept"
                );
            }
        }
        all.push(json!({
            "axis": name, "counts": counts, "requested": requested, "completed": completed,
            "insertions": insertions, "whole_from_ns": whole_from_ns, "completed_before": before,
            "changes_dropped": dropped, "until_ns": kept.now_ns, "replays": same,
            "insertions_in_shadow": told.shadow,
            "replayed": {
                "counts_in": again.counts_in, "requested": again.requested, "completed": again.completed,
                "insertions": again.insertions,
            },
        }));
    }
    let document = json!({ "machine": status.machine, "axes": all });
    let file = out.join("ledger.json");
    crate::json_output::write(&file, &pretty(&document)?)?;
    if daemon.json {
        say_line(&document)?;
    } else if !not_homed.is_empty() {
        let begins = "counted from the daemon's start; `rtecctl home` begins the ledger";
        eprintln!("rtecctl: axis {not_homed} not homed: {begins}");
    }
    let other = other.join(", ");
    ensure!(other.is_empty(), No, "axis {other}: replayed, the files do not give the totals of the daemon");
    Ok(())
}

/// Fetches all kept changes of an axis's ledger.
fn fetch(client: &mut DaemonConnection, axis: &str) -> anyhow::Result<LedgerPage> {
    let mut whole: Option<LedgerPage> = None;
    loop {
        let from = whole.as_ref().map_or(0, |w| w.first + w.rows.len() as u64);
        let request = ClientRequest::Ledger { axis: axis.to_owned(), from };
        let page = expected!(ask(client, &request)?, DaemonResponse::Ledger(page) => page);
        // If the axis was homed meanwhile, or rows were dropped, it begins again.
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

/// Replays the files through the engine.
fn replayed(trace: &Path, requests: &Path) -> anyhow::Result<ReplayOutcome> {
    let trace = TraceReader::open(trace)?;
    let requests = RequestedTotalReader::open_beside(requests, &ColumnAssignment::default(), &trace)?;
    let trace = trace.playable();
    let config = AxisConfig { max_correction_counts: i64::MAX, ..AxisConfig::default() };
    let (outcome, _) = replay_any(InsertionDesign::C, config, trace, requests, true, |_, _: State| {})
        .map_err(|e| anyhow::anyhow!("replaying what was written: {e}"))?;
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_control::protocol::LedgerRow;

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
        let told = LedgerExportSummary::of(kept, 50);
        told.write(kept, [&file("t.csv"), &file("r.csv"), &file("i.csv")]).unwrap();
        let again = replayed(&file("t.csv"), &file("r.csv")).unwrap();
        assert_eq!(
            (again.counts_in, again.requested, again.completed),
            (counts, requested, completed),
            "{}",
            std::fs::read_to_string(file("r.csv")).unwrap()
        );
        assert_eq!((told.counts, told.requested, told.completed), (counts, requested, completed));
        // The head of each file says what it is.
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
        // Forwards; an axis that turned between two looks; one at rest between them.
        let rows = vec![
            zero,
            row((200, 1500), (210, 1700), 40, 40, 20),
            row((300, 900), (310, 900), 60, 44, 22),
            row((320, 900), (330, 899), 60, 60, 30),
        ];
        replays(&page(rows.clone(), (900, -50)), -50, 60, 60);
        // There and back between two looks; a large jump; all counts withdrawn.
        let mut more = rows;
        more.push(row((400, 800), (410, 800), 60, 60, 36));
        more.push(row((500, 0), (520, 60), 400, 400, 206));
        more.push(row((600, 0), (620, 2), 0, 0, 406));
        replays(&page(more, (1000, 10)), 10, 0, 0);
    }

    /// In shadow mode a total comes and goes without an insertion at the MTC.
    #[test]
    fn other_numbers_of_insertions_do_not_stand_beside_the_same_without_a_word() {
        let shadow = |r: LedgerRow| LedgerRow { in_effect: 0, ..r };
        let rows = vec![
            row((100, 0), (100, 0), 0, 0, 0),
            shadow(row((200, 100), (210, 110), 2, 2, 1)),
            row((300, 200), (310, 210), 0, 0, 1),
            row((400, 300), (410, 320), 4, 4, 3),
        ];
        let told = LedgerExportSummary::of(&page(rows, (500, 400)), 50);
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
        kept.shorten(Duration::from_millis(300));
        assert_eq!((kept.rows.len(), kept.rows[0].completed), (2, 2));
        kept.shorten(Duration::from_secs(3600));
        assert_eq!(kept.rows.len(), 2);
    }
}
