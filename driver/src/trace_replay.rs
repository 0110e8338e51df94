//! A recorded trace of one axis, on a virtual clock that jumps from event to event.

use crate::card::{AxisLines, Card, CardError, CardInputSample};
use crate::quadrature::State;

/// A change of a trace: the state of the two signals from a time on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TracePoint {
    /// Time of the change in ns.
    /// In the first point the time from which the initial state is known.
    pub t_ns: u64,
    /// The levels from this time on.
    pub state: State,
}

/// A requested total and the time at which it is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RequestedTotal {
    /// Time in ns.
    pub t_ns: u64,
    /// Requested total in counts since homing.
    pub requested: i64,
}

/// Receives every change that the MTC sees, in order.
pub trait MtcSignalListener {
    /// A' and B' at `t_ns`.
    /// The first call gives the initial state, each later one a change.
    fn changed(&mut self, t_ns: u64, state: State);
}

impl<F: FnMut(u64, State)> MtcSignalListener for F {
    #[inline]
    fn changed(&mut self, t_ns: u64, state: State) {
        self(t_ns, state);
    }
}

/// The gates between scale and MTC.
/// They form A' and B' from A and B and the two output lines of an axis.
pub trait ScaleToMtcGates: Copy {
    /// A' and B'. `outputs`: bit 0 the line of A, bit 1 the line of B.
    fn out(self, scale: State, outputs: u8) -> State;

    /// The output lines with which A' = A and B' = B.
    fn transparent(self, scale: State) -> u8;
}

/// An XOR gate per signal (NISTIR 4832, Design C).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct XorGates;

impl ScaleToMtcGates for XorGates {
    #[inline]
    fn out(self, scale: State, outputs: u8) -> State {
        scale.inverted(outputs)
    }

    fn transparent(self, _scale: State) -> u8 {
        0
    }
}

/// No gate: the output lines are A' and B' themselves (NISTIR 4832, Design B).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DirectOutputs;

impl ScaleToMtcGates for DirectOutputs {
    #[inline]
    fn out(self, _scale: State, outputs: u8) -> State {
        State::from_bits(outputs)
    }

    fn transparent(self, scale: State) -> u8 {
        scale.bits()
    }
}

/// Plays a trace to the engine, and reports A' and B' to a listener.
/// The engine sees it as axis 0 of the standard layout. The caller chooses where the points come from, and the error
/// `E` that ends them.
///
/// Changes carry their own times. Writes take effect at the time of the look before them. The order of edges and
/// inversions is therefore always certain.
#[derive(Debug)]
pub struct ReplayCard<T, L, E, G = XorGates> {
    gates: G,
    trace: T,
    listener: L,
    next: Option<TracePoint>,
    error: Option<E>,
    t_ns: u64,
    scale: State,
    /// Present levels of A' and B'.
    sent: State,
    outputs: u64,
    edges: u64,
}

impl<T: Iterator<Item = Result<TracePoint, E>>, L: MtcSignalListener, E, G: ScaleToMtcGates>
    ReplayCard<T, L, E, G>
{
    /// Reads the initial state.
    /// An empty trace means an axis at rest at A = B = low.
    ///
    /// # Errors
    /// When the first row is bad.
    pub fn new(gates: G, mut trace: T, mut listener: L) -> Result<Self, E> {
        let first = trace.next().transpose()?.unwrap_or(TracePoint { t_ns: 0, state: State::default() });
        listener.changed(first.t_ns, first.state);
        let mut card = Self {
            gates,
            trace,
            listener,
            next: None,
            error: None,
            t_ns: first.t_ns,
            scale: first.state,
            sent: first.state,
            outputs: u64::from(gates.transparent(first.state)),
            edges: 0,
        };
        card.advance();
        Ok(card)
    }

    #[inline]
    fn advance(&mut self) {
        self.next = match self.trace.next() {
            Some(Ok(point)) => Some(point),
            Some(Err(error)) => {
                self.error = Some(error);
                None
            }
            None => None,
        };
    }

    /// The bad row that ended the replay, if one did.
    pub fn take_error(&mut self) -> Option<E> {
        self.error.take()
    }

    /// Changes of the scale played so far.
    pub fn edges(&self) -> u64 {
        self.edges
    }

    /// Returns the listener.
    pub fn into_listener(self) -> L {
        self.listener
    }

    #[inline]
    fn out(&self) -> State {
        self.gates.out(self.scale, AxisLines::standard(0, false).inverters(self.outputs))
    }
}

impl<T: Iterator<Item = Result<TracePoint, E>>, L: MtcSignalListener, E, G: ScaleToMtcGates> Card
    for ReplayCard<T, L, E, G>
{
    // Inlined into the engine: the compiler then knows most fields of the sample and does not store them.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let mut edge_ns = None;
        match self.next {
            Some(point) if point.t_ns <= wake_ns => {
                self.t_ns = point.t_ns;
                edge_ns = Some(point.t_ns);
                self.scale = point.state;
                self.edges += 1;
                let before = self.sent;
                self.sent = self.out();
                if self.sent != before {
                    self.listener.changed(point.t_ns, self.sent);
                }
                self.advance();
            }
            // A bad row ends the replay at once, not at the engine's next wake time.
            None if wake_ns == u64::MAX || self.error.is_some() => return Err(CardError::Ended),
            _ => self.t_ns = self.t_ns.max(wake_ns),
        }
        Ok(CardInputSample::stamped(self.t_ns, u64::from(self.scale.bits()), edge_ns))
    }

    #[inline]
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let before = self.sent;
        self.outputs = self.outputs & !mask | value & mask;
        self.sent = self.out();
        if self.sent != before {
            self.listener.changed(self.t_ns, self.sent);
        }
        Ok(Some(self.t_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    #[test]
    fn time_jumps_to_edges_and_appointments_and_the_listener_hears_all() {
        let points = [(10, 0), (20, 1), (30, 3)]
            .map(|(t_ns, bits)| Ok::<_, Infallible>(TracePoint { t_ns, state: State::from_bits(bits) }));
        let mut heard = Vec::new();
        let mut card =
            ReplayCard::new(XorGates, points.into_iter(), |t, s: State| heard.push((t, s.bits()))).unwrap();
        assert_eq!(card.sample(u64::MAX).unwrap().edge_ns, Some(20));
        assert_eq!(card.sample(25).unwrap(), CardInputSample::stamped(25, 1, None));
        assert_eq!(card.write(1, 1).unwrap(), Some(25));
        assert_eq!(card.sample(40).unwrap(), CardInputSample::stamped(30, 3, Some(30)));
        assert_eq!(card.sample(u64::MAX), Err(CardError::Ended));
        drop(card);
        assert_eq!(heard, [(10, 0), (20, 1), (25, 0), (30, 2)]);
    }

    fn point(t_ns: u64, bits: u8) -> Result<TracePoint, &'static str> {
        Ok(TracePoint { t_ns, state: State::from_bits(bits) })
    }

    /// Without gates, A' and B' are the output lines.
    /// They begin as A and B, and each write changes only its own line.
    #[test]
    fn without_gates_the_outputs_are_what_the_mtc_sees() {
        let mut heard = Vec::new();
        let points = [point(10, 2), point(20, 3), point(40, 1)];
        let mut card =
            ReplayCard::new(DirectOutputs, points.into_iter(), |t, s: State| heard.push((t, s.bits())))
                .unwrap();
        assert_eq!((card.outputs(), card.edges()), (Ok(2), 0));
        card.sample(25).unwrap();
        card.write(0b01, 0b01).unwrap();
        assert_eq!((card.outputs(), card.edges()), (Ok(3), 1));
        card.sample(30).unwrap();
        // Lines outside the mask keep their level, whatever `value` says. A write of the same levels is no
        // change.
        card.write(0b10, 0b01).unwrap();
        card.write(0b01, 0b11).unwrap();
        assert_eq!(card.outputs(), Ok(1));
        card.sample(50).unwrap();
        assert_eq!(card.edges(), 2);
        assert_eq!(card.sample(60).unwrap(), CardInputSample::stamped(60, 1, None), "at rest after the last");
        drop(card);
        assert_eq!(heard, [(10, 2), (20, 3), (30, 1)]);
    }

    #[test]
    fn a_bad_row_ends_the_replay_where_it_stands() {
        let points = [point(10, 0), point(20, 1), Err("bad")];
        let mut card = ReplayCard::new(XorGates, points.into_iter(), |_, _: State| {}).unwrap();
        assert_eq!(card.sample(100).unwrap().t_ns, 20);
        assert_eq!(card.sample(100), Err(CardError::Ended), "not at the appointment");
        assert_eq!((card.take_error(), card.take_error(), card.edges()), (Some("bad"), None, 1));
        assert_eq!(
            ReplayCard::new(XorGates, std::iter::once(Err("bad")), |_, _: State| {}).err(),
            Some("bad")
        );
    }
}
