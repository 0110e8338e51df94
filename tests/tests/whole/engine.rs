//! The engine, judged by counters of other programs.
//! At the MTC they count the scale's counts plus the completed ones.

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{RequestedTotal, TracePoint};
use rtec_rt::axis::AxisConfig;
use rtec_sim::engine_replay::{ReplayOutcome, replay};
use rtec_tests::judge::{LINUXCNC, LinuxCnc, SIGROK, available, sigrok};
use rtec_tests::ledger::{self, Totals};
use std::convert::Infallible;
use std::f64::consts::TAU;

/// Sine strokes with reversals, at 7 rad/s just within the axis's 1e6 counts/s².
fn strokes(amplitude_counts: i64, strokes: u32) -> Vec<TracePoint> {
    let amplitude = amplitude_counts as f64 + 0.5;
    let mut at = TracePoint::default();
    let mut points = vec![at];
    for stroke in 0..strokes {
        let up = stroke % 2 == 0;
        for place in -amplitude_counts..=amplitude_counts {
            let rise = (place as f64 / amplitude).asin();
            let t_ns = ((TAU * f64::from(stroke + 1) / 2.0 + rise) / 7.0 * 1e9).round() as u64;
            at = TracePoint { t_ns, state: at.state.next(up) };
            points.push(at);
        }
    }
    points
}

/// A new total every `every_ns` ns, within ±400 counts.
fn totals(end_ns: u64, every_ns: u64) -> Vec<RequestedTotal> {
    let total = |n: u64| 2 * (200.0 * (n as f64 / 9.0).sin()) as i64;
    (1..end_ns / every_ns).map(|n| RequestedTotal { t_ns: n * every_ns, requested: total(n) }).collect()
}

fn corrected(scale: &[TracePoint], every_ns: u64) -> (ReplayOutcome, Vec<(TracePoint, i64)>, Totals) {
    let mut mtc = Vec::new();
    let requests = totals(scale.last().unwrap().t_ns, every_ns);
    let seen = |t_ns: u64, state: State| mtc.push(TracePoint { t_ns, state });
    let trace = scale.iter().map(|p| Ok::<_, Infallible>(*p));
    let (outcome, _) =
        replay(AxisConfig::default(), trace, requests.into_iter().map(Ok), true, seen).unwrap();
    let mut due = Vec::new();
    let totals = ledger::walk(scale.iter().map(|p| Ok(*p)), mtc.into_iter().map(Ok), |point, count| {
        due.push((point, count));
        Ok(())
    });
    (outcome, due, totals.unwrap())
}

#[test]
fn linuxcnc_counts_scale_plus_completed_at_every_state() {
    if !available(LINUXCNC) {
        return;
    }
    let scale = strokes(20_000, 12);
    let (outcome, due, totals) = corrected(&scale, 10_000_000);
    assert!(outcome.balanced() && outcome.faults.is_empty() && outcome.illegal_out == 0, "{outcome:?}");
    assert_eq!((totals.inserted, totals.scale_counts), (outcome.completed, outcome.counts_in));
    assert!(outcome.insertions > 1000, "{outcome:?}");

    let mut judge = LinuxCnc::new().unwrap();
    for (point, due) in &due {
        judge.show(point.state, *due).unwrap();
    }
    let verdict = judge.verdict().unwrap();
    assert_eq!((verdict.judged, verdict.first_wrong), (due.len() as u64, None));
}

#[test]
fn sigrok_counts_scale_plus_completed_at_every_state() {
    if !available(SIGROK) {
        return;
    }
    let scale = strokes(100, 6);
    let (outcome, due, _) = corrected(&scale, 5_000_000);
    assert!(outcome.balanced() && outcome.insertions > 100, "{outcome:?}");
    let verdict = sigrok(&due).unwrap();
    assert_eq!((verdict.judged, verdict.first_wrong), (due.len() as u64, None));
}
