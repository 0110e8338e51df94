//! The polling loop on the card that will do the work.
//! It times reads with the outputs held, and writes where that is allowed.
//!
//! Nothing moves the machine here. Reads are timed as the engine makes them. Writes are insertions at rest, without an
//! edge. As many counts are added as are removed, so the outputs end as they were found.

use crate::selftest_results::{
    CardWriteTestResults, LatencyDistribution, PollingLoopResults, SelftestError, SelftestOptions, tid_of,
};
use rtec_driver::card::{Card, CardError, CardInputSample, MachineLines};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{CorrectorMode, RequestToRt};
use rtec_rt::pinned_rt_thread::{RtThreadHandle, ThreadExit, ThreadOptions, spawn};
use std::time::{Duration, Instant};

/// Rest of an axis between two insertions, ns.
const REST_NS: u64 = 50_000;
/// Interval of this thread's looks at the engine's status.
const LOOK: Duration = Duration::from_millis(1);
/// Time within which all inserted counts must be removed again.
const BACK_AGAIN: Duration = Duration::from_secs(5);
const SECOND: Duration = Duration::from_secs(1);

/// A card whose writes have no effect, so that its outputs stay as they are.
struct WriteSuppressingCard<C>(C);

impl<C: Card> Card for WriteSuppressingCard<C> {
    const SLEEPS: bool = C::SLEEPS;

    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.0.sample(wake_ns)
    }

    fn write(&mut self, _mask: u64, _value: u64) -> Result<Option<u64>, CardError> {
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.0.outputs()
    }
}

/// Times the loop on `card` with all outputs held, for a third of the time.
pub(crate) fn reads<C: Card + Send + 'static>(
    card: C,
    axes: &[AxisConfig],
    options: SelftestOptions,
    progress: &mut impl FnMut(&str, u64),
) -> Result<(PollingLoopResults, C), SelftestError> {
    let (running, tid) = start(WriteSuppressingCard(card), axes, options)?;
    let start = Instant::now();
    let third = options.run / 3;
    let mut next = start;
    while start.elapsed() < third && !running.control.ended() {
        if Instant::now() >= next {
            progress("reads of the card, outputs held", third.saturating_sub(start.elapsed()).as_secs() + 1);
            next += SECOND;
        }
        std::thread::sleep(LOOK);
    }
    let (polling, ended) = stopped(running, tid)?;
    Ok((polling, ended.card.0))
}

/// Inserts and removes counts on every axis, for a third of the time.
pub(crate) fn writes<C: Card + Send + 'static>(
    mut card: C,
    axes: &[AxisConfig],
    options: SelftestOptions,
    progress: &mut impl FnMut(&str, u64),
) -> Result<CardWriteTestResults, SelftestError> {
    let before = card.outputs()?;
    let at_rest = axes
        .iter()
        .map(|axis| AxisConfig { rest: InsertionAtRestPolicy::Insert { after_ns: REST_NS }, ..idle(axis) });
    let axes: Vec<AxisConfig> = at_rest.collect();
    let (mut running, tid) = start(card, &axes, options)?;
    let control = &mut running.control;
    let mut ask = |request| {
        while control.send(request).is_err() {
            std::thread::sleep(LOOK);
        }
    };
    for axis in 0..axes.len() as u8 {
        ask(RequestToRt::Home { axis, position_counts: 0, controller_homed: true });
        ask(RequestToRt::ConfirmHome { axis, position_counts: 0 });
    }
    ask(RequestToRt::Enable);
    let mut totals = vec![0; axes.len()];
    let (start, third) = (Instant::now(), options.run / 3);
    let (mut next, mut ended_by) = (start, None);
    loop {
        let (over, late) = (start.elapsed() >= third, start.elapsed() >= third + BACK_AGAIN);
        let status = control.status();
        control.beat();
        while control.event().is_some() {}
        if status.mode == CorrectorMode::Fault {
            ended_by =
                status.axes().iter().find_map(|a| a.faults.iter().next()).or(status.faults.iter().next());
        }
        let back = status.axes().iter().all(|a| a.in_effect == 0 && a.requested == 0)
            && totals.iter().all(|t| *t == 0);
        if ended_by.is_some() || control.ended() || over && back || late {
            break;
        }
        for (axis, (total, now)) in totals.iter_mut().zip(status.axes()).enumerate() {
            if now.in_effect == *total && status.mode == CorrectorMode::Run && (!over || *total != 0) {
                *total = if *total == 0 { 2 } else { 0 };
                let request = RequestToRt::Correct { axis: axis as u8, total_counts: *total, large: true };
                if control.send(request).is_err() {
                    *total = now.in_effect;
                }
            }
        }
        if Instant::now() >= next {
            progress("writes of the card", third.saturating_sub(start.elapsed()).as_secs() + 1);
            next += SECOND;
        }
        std::thread::sleep(LOOK);
    }
    let (polling, mut ended) = stopped(running, tid)?;
    let after = ended.card.outputs()?;
    if after != before {
        // A fault ended it with counts inserted. The outputs are restored one after the other, in the engine's order.
        let changed = after ^ before;
        for bit in (0..64).filter(|bit| changed >> bit & 1 != 0) {
            ended.card.write(1 << bit, before & 1 << bit)?;
        }
    }
    let restored = ended.card.outputs()? == before;
    Ok(CardWriteTestResults { polling, ended_by, restored })
}

/// An axis without limits other than its separation.
fn idle(axis: &AxisConfig) -> AxisConfig {
    AxisConfig {
        lines: axis.lines,
        min_separation_ns: axis.min_separation_ns,
        max_accel_counts_s2: 0.0,
        ..AxisConfig::default()
    }
}

/// Starts the engine's own thread; returns it with its number.
pub(crate) fn start<C: Card + Send + 'static>(
    mut card: C,
    axes: &[AxisConfig],
    options: SelftestOptions,
) -> Result<(RtThreadHandle<C>, i32), SelftestError> {
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: false };
    let engine = Engine::new(&mut card, axes, machine, &[])?;
    let thread = ThreadOptions { wanted: Some(options.wanted()), real: false, stale_after_ns: u64::MAX };
    Ok((spawn(engine, card, thread)?, tid_of("rtec-rt")))
}

/// Stops it; returns what it measured.
pub(crate) fn stopped<C: Card>(
    running: RtThreadHandle<C>,
    tid: i32,
) -> Result<(PollingLoopResults, ThreadExit<C>), SelftestError> {
    let timing = running.timing.clone();
    let (ended, _) = running.stop();
    if let Some(error) = ended.error {
        return Err(error.into());
    }
    let (poll_gap, done) = (timing.poll_gap_ns.snapshot(), timing.edge_to_done_ns.snapshot());
    let axes = ended.status.axes();
    let polling = PollingLoopResults {
        poll_gap: LatencyDistribution { last_ns: poll_gap.p50(), ns: poll_gap, tid },
        seen_to_done: done,
        completed: axes.iter().map(|a| a.in_effect).sum(),
        insertions: axes.iter().map(|a| a.insertions).sum(),
        ..PollingLoopResults::default()
    };
    Ok((polling, ended))
}
