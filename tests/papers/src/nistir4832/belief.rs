//! General considerations: the signed byte, the belief window, the switches.

use super::{Bench, cannot};
use crate::PaperError;
use crate::rows::Agreement::Within;
use crate::rows::Rows;
use rtec_driver::card::AxisLines;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{ReplayCard, RequestedTotal, TracePoint, XorGates};
use rtec_files::InputError;
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::link_messages::{EventKind, RequestToRt};
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::corrected_axis::{CorrectedAxis as _, homed_engine};
use rtec_sim::engine_replay::{ReplayOutcome, replay};
use rtec_sim::insertion_design_bench::{BenchRun, InsertionDesign, constant};

/// The signed byte of the Original RTEC: the largest total that it takes.
pub(super) fn range(rows: &mut Rows, bench: &Bench, computer: &ComputerTiming) -> Result<(), PaperError> {
    let place = "General Considerations";
    let most = (1_i64 << (bench.correction_bits - 1)) - 1;
    let step = InsertionDesign::Original.increment_counts();
    let config = AxisConfig { max_correction_counts: most * step, ..AxisConfig::default() };
    let edges = constant(1_000_000, 5000.0, 40_000, 1);
    let mut taken = [0; 2];
    for (sign, taken) in [1, -1].into_iter().zip(&mut taken) {
        // One correction more each time, far beyond the byte.
        let totals: Vec<(u64, i64)> =
            (1..=most + 40).map(|n| (edges[(100 + 200 * n) as usize].0, sign * n * step)).collect();
        let run = BenchRun {
            config,
            edges: &edges,
            totals: &totals,
            ..BenchRun::new(InsertionDesign::Original, computer)
        };
        let seen = run.run().ok_or_else(|| cannot("the Original's insertions"))?;
        *taken = seen.requested;
        if seen.completed != seen.requested || seen.error_counts() != 0 {
            return Err(cannot("the whole range of the signed byte"));
        }
    }
    let other = "the machine file has another width of the byte, or another count";
    let gets = (taken[0] / step) as f64;
    rows.given().number((place, "corrections in one signed byte, ±", ""), 127.0, gets, Within(0.0), other);
    let um = taken[0].min(-taken[1]) as f64 * bench.count_um;
    rows.given().number((place, "largest correction, ±", "µm"), 508.0, um, Within(0.0), other);
    rows.given().number((place, "the same", "mil"), 20.0, um / 25.4, Within(0.05), other);
    let gets = step as f64 * bench.count_um;
    rows.given().number((place, "one correction", "µm"), 4.0, gets, Within(0.0), other);
    Ok(())
}

fn recording() -> impl Iterator<Item = Result<TracePoint, InputError>> {
    let mut state = State::default();
    (0..40_000_u64).map(move |n| {
        if n > 0 {
            state = state.next(true);
        }
        Ok(TracePoint { t_ns: n * 50_000, state })
    })
}

/// Totals given every 20 ms to an axis with this belief window.
fn believe(window_counts: i64, totals: &[i64], large: bool) -> Result<ReplayOutcome, PaperError> {
    let config = AxisConfig { window_counts, ..AxisConfig::default() };
    let given: Vec<Result<RequestedTotal, InputError>> = totals
        .iter()
        .enumerate()
        .map(|(n, t)| Ok(RequestedTotal { t_ns: 20_000_000 * (n as u64 + 1), requested: *t }))
        .collect();
    Ok(replay(config, recording(), given.into_iter(), large, |_, _: State| {})?.0)
}

pub(super) fn belief(rows: &mut Rows, bench: &Bench) -> Result<(), PaperError> {
    let place = "General Considerations";
    let step = InsertionDesign::Original.increment_counts();
    let window = bench.window_corrections * step;
    let believed =
        |n: i64| -> Result<bool, PaperError> { Ok(believe(window, &[n * step], false)?.refused.is_empty()) };
    let mut widest = 0;
    while widest < 20 && believed(widest + 1)? {
        widest += 1;
    }
    let what = "belief window, corrections at once, ±";
    let gets = widest as f64;
    rows.given().number((place, what, ""), 3.0, gets, Within(0.0), "the machine file has another window");
    let wild = (widest + 50) * step;
    let once = believe(window, &[step, wild, 2 * step], false)?;
    rows.holds(
        (place, "one reading beyond it: \"I Don't Believe You\"; back in range it is accepted"),
        "accepted within the next two readings",
        &format!(
            "{} refused, {} requested, {} faults",
            once.refused.len(),
            once.requested,
            once.faults.len()
        ),
        once.refused.len() == 1 && once.requested == 2 * step && once.faults.is_empty(),
        "the same in our words",
    );
    let mut fatal = 0;
    for n in 1..10 {
        let mut totals = vec![step];
        totals.extend(vec![wild; n]);
        if !believe(window, &totals, false)?.faults.is_empty() {
            fatal = n;
            break;
        }
    }
    let what = "readings beyond it until \"I Still Don't Believe You\" is fatal: the first and two more";
    rows.number((place, what, ""), 3.0, fatal as f64, Within(0.0), "");
    let large = believe(window, &[wild], true)?;
    let what = "\"Large Correction\" has it accepted";
    let gets = if large.requested == wild { "accepted" } else { "refused" };
    rows.holds((place, what), "accepted", gets, large.requested == wild, "");
    Ok(())
}

/// The disable switch and probing mode refuse what is asked.
pub(super) fn switches(rows: &mut Rows) -> Result<(), PaperError> {
    let place = "General Considerations";
    let config = AxisConfig {
        rest: InsertionAtRestPolicy::Insert { after_ns: 1_000_000 },
        lines: AxisLines::standard(0, false),
        ..AxisConfig::default()
    };
    for (what, request) in [
        ("corrections disabled, a nonzero request: an error message", RequestToRt::Disable),
        ("probing mode: no compensation", RequestToRt::Probe(true)),
    ] {
        let mut card = ReplayCard::new(XorGates, recording(), |_, _: State| {})?;
        let mut refused = Vec::new();
        let mut report = |e: rtec_rt::link_messages::Event| {
            if let EventKind::Refused { why, .. } = e.kind {
                refused.push(format!("{why:?}"));
            }
            true
        };
        let cannot = |_| cannot("an engine");
        let mut engine =
            homed_engine(config, &mut card, &mut |_| true).map_err(|_| super::cannot("an engine"))?;
        engine.take(request, &mut card, &mut report).map_err(cannot)?;
        engine.correct(4, true, &mut card, &mut report).map_err(cannot)?;
        let inserted = engine.status().axes[0].insertions;
        let why = "the engine's own words";
        let gets = format!("{inserted} inserted, refused: {}", refused.join(", "));
        rows.holds((place, what), "nothing inserted", &gets, inserted == 0 && refused.len() == 1, why);
    }
    Ok(())
}
