//! The engine on a recording of one axis, on a virtual clock.
//! It gives the resulting count of the MTC.

use crate::corrected_axis::{CorrectedAxis, MtcDecoder, homed_engine};
use rtec_driver::card::CardError;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{
    MtcSignalListener, ReplayCard, RequestedTotal, ScaleToMtcGates, TracePoint, XorGates,
};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::StartError;
use rtec_rt::link_messages::{Event, EventKind, Fault, Refusal};
use serde::Serialize;

/// Results of a replay.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct ReplayOutcome {
    /// Counts of the scale, first row to last.
    pub counts_in: i64,
    /// Counts of the MTC, decoded from A' and B'.
    pub counts_out: i64,
    /// The last accepted total, counts.
    pub requested: i64,
    /// Inserted counts.
    pub completed: i64,
    /// Number of insertions made.
    pub insertions: u64,
    /// Illegal transitions of the scale.
    pub illegal_in: u64,
    /// Illegal transitions that the MTC saw.
    pub illegal_out: u64,
    /// Shortest time between two edges at the MTC, ns.
    pub min_edge_separation_ns: Option<u64>,
    /// Edges at which a correction was pending but the axis was too fast to insert.
    pub waited_for_gate: u64,
    /// Real edges during an insertion, with a certain outcome.
    pub overlaps: u64,
    /// Number of requests given.
    #[serde(skip)]
    pub requests: u64,
    /// Requests that were not accepted.
    pub refused: Vec<RefusedRequest>,
    /// Faults that the engine latched, in order.
    pub faults: Vec<ReplayFault>,
    /// Rows of the trace after the first.
    pub edges: u64,
    /// The channel that does not change, if a dead one is latched.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dead_channel: Option<&'static str>,
}

impl ReplayOutcome {
    /// Whether the MTC's count minus the scale's equals the completed total.
    pub fn balanced(&self) -> bool {
        self.counts_out - self.counts_in == self.completed
    }
}

/// A request that was not accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RefusedRequest {
    /// Time of the request, ns on the trace's clock.
    pub t_ns: u64,
    /// The total that was requested, counts.
    pub requested: i64,
    /// The engine's reason for the refusal.
    pub why: Refusal,
}

/// A fault that the engine latched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ReplayFault {
    /// Time of the fault, ns on the trace's clock.
    pub t_ns: u64,
    /// The fault.
    pub fault: Fault,
}

/// Reason why a replay could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError<E> {
    /// The error of the trace or the requests, usually a bad row.
    #[error("{0}")]
    Input(E),
    /// The axis cannot be corrected as configured.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// The MTC's side: decodes A' and B', and passes them on.
#[derive(Debug)]
pub struct MtcListener<L> {
    /// The MTC's decoder, from the first state on.
    seen: Option<MtcDecoder>,
    to: L,
}

impl<L: MtcSignalListener> MtcSignalListener for MtcListener<L> {
    #[inline]
    fn changed(&mut self, t_ns: u64, state: State) {
        match &mut self.seen {
            Some(decoder) => decoder.update(t_ns, state),
            None => self.seen = Some(MtcDecoder::new(state)),
        }
        self.to.changed(t_ns, state);
    }
}

/// Replays `trace` with `totals` through the engine as one homed axis.
/// `to` gets every change that the MTC sees. `large` flags every request as intended, whatever its size.
/// Memory does not grow with the trace.
///
/// # Errors
/// At the first bad row, or when the axis cannot be corrected as configured.
pub fn replay<T, R, L, E>(
    config: AxisConfig,
    trace: T,
    totals: R,
    large: bool,
    to: L,
) -> Result<(ReplayOutcome, L), ReplayError<E>>
where
    T: Iterator<Item = Result<TracePoint, E>>,
    R: Iterator<Item = Result<RequestedTotal, E>>,
    L: MtcSignalListener,
{
    let start = |card: &mut ReplayCard<T, MtcListener<L>, E>| homed_engine(config, card, &mut |_| true);
    replay_with(XorGates, start, trace, totals, large, to)
}

/// As [`replay`] with another design.
/// `start` makes its corrector on a card with these gates.
///
/// # Errors
/// At the first bad row, or when `start` fails.
pub fn replay_with<G, M, T, R, L, E>(
    gates: G,
    start: impl FnOnce(&mut ReplayCard<T, MtcListener<L>, E, G>) -> Result<M, StartError>,
    trace: T,
    totals: R,
    large: bool,
    to: L,
) -> Result<(ReplayOutcome, L), ReplayError<E>>
where
    G: ScaleToMtcGates,
    M: CorrectedAxis,
    T: Iterator<Item = Result<TracePoint, E>>,
    R: Iterator<Item = Result<RequestedTotal, E>>,
    L: MtcSignalListener,
{
    let mtc = MtcListener { seen: None, to };
    let mut card = ReplayCard::new(gates, trace, mtc).map_err(ReplayError::Input)?;
    let mut corrector = start(&mut card).map_err(|error| {
        // The recording may already have ended with a bad row.
        card.take_error().map_or_else(|| error.into(), ReplayError::Input)
    })?;
    let mut outcome = ReplayOutcome::default();
    let mut report = |event: Event| {
        match event.kind {
            EventKind::Refused { total_counts, why } => {
                outcome.refused.push(RefusedRequest { t_ns: event.t_ns, requested: total_counts, why });
            }
            EventKind::Fault(fault) => outcome.faults.push(ReplayFault { t_ns: event.t_ns, fault }),
            _ => {}
        }
        true
    };
    let (mut totals, mut requests) = (totals, 0);
    let mut next = totals.next().transpose().map_err(ReplayError::Input)?;
    let due_ns = |next: &Option<RequestedTotal>| next.map_or(u64::MAX, |t| t.t_ns);
    let mut next_ns = due_ns(&next);
    loop {
        while next_ns <= corrector.now_ns()
            && let Some(total) = next
        {
            corrector.correct(total.requested, large, &mut card, &mut report).map_err(StartError::Card)?;
            requests += 1;
            next = totals.next().transpose().map_err(ReplayError::Input)?;
            next_ns = due_ns(&next);
        }
        match corrector.poll(&mut card, next_ns, &mut report) {
            Ok(()) => {}
            Err(CardError::Ended) => break,
            Err(error) => return Err(StartError::Card(error).into()),
        }
    }
    if let Some(error) = card.take_error() {
        return Err(ReplayError::Input(error));
    }
    let axis = corrector.axis();
    outcome.requests = requests;
    outcome.edges = card.edges();
    let mtc = card.into_listener();
    let seen = mtc.seen.unwrap_or(MtcDecoder::new(State::default()));
    let decoder = seen.decoder();
    outcome.counts_in = axis.position_counts;
    outcome.counts_out = decoder.count();
    outcome.illegal_in = axis.illegal;
    outcome.illegal_out = decoder.illegal();
    outcome.min_edge_separation_ns = Some(seen.min_separation_ns).filter(|ns| *ns < u64::MAX);
    outcome.requested = axis.requested;
    outcome.completed = axis.completed;
    outcome.insertions = axis.insertions;
    outcome.waited_for_gate = axis.waited_for_gate;
    outcome.overlaps = axis.overlaps;
    Ok((outcome, mtc.to))
}
