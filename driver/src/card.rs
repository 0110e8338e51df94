//! The interface of an I/O card: read all input lines with a time, or write some.

use crate::quadrature::State;

/// Which bits of a card's input and output words one axis is wired to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisLines {
    /// Input bit of the scale's A.
    pub a: u8,
    /// Input bit of the scale's B.
    pub b: u8,
    /// Output bit that drives the XOR gate of A.
    pub invert_a: u8,
    /// Output bit that drives the XOR gate of B.
    pub invert_b: u8,
    /// Input bits of A' and B' as the MTC sees them, if they are wired back.
    pub read_back: Option<(u8, u8)>,
}

impl AxisLines {
    /// The layout of the mock and shared-memory test cards.
    /// Axis `n` has inputs A, B, A', B' from bit 4n and outputs from bit 2n.
    pub const fn standard(n: u8, read_back: bool) -> Self {
        let back = if read_back { Some((4 * n + 2, 4 * n + 3)) } else { None };
        Self { a: 4 * n, b: 4 * n + 1, invert_a: 2 * n, invert_b: 2 * n + 1, read_back: back }
    }

    /// The scale's state in an input word.
    #[inline]
    pub const fn scale(&self, inputs: u64) -> State {
        State::from_bits((inputs >> self.a & 1 | (inputs >> self.b & 1) << 1) as u8)
    }

    /// The inverters in an output word: bit 0 inverts A, bit 1 inverts B.
    #[inline]
    pub const fn inverters(&self, outputs: u64) -> u8 {
        (outputs >> self.invert_a & 1 | (outputs >> self.invert_b & 1) << 1) as u8
    }

    /// A' and B' in an input word, if wired back.
    #[inline]
    pub fn back(&self, inputs: u64) -> Option<State> {
        self.read_back.map(|(a, b)| State::from_bits((inputs >> a & 1 | (inputs >> b & 1) << 1) as u8))
    }

    /// Mask of A and B (and A', B') in the input word.
    pub const fn input_mask(&self) -> u64 {
        let back = match self.read_back {
            Some((a, b)) => 1 << a | 1 << b,
            None => 0,
        };
        1 << self.a | 1 << self.b | back
    }
}

/// The lines that belong to the machine as a whole. Absent lines are not wired.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MachineLines {
    /// Input: the probe has tripped.
    pub probe: Option<u8>,
    /// Input: the hardware switch that forbids corrections.
    pub disable: Option<u8>,
    /// Input: the MTC is on and counts. While it is off, the MTC's count is not known.
    pub mtc_ready: Option<u8>,
    /// Output: feed hold.
    pub hold: Option<u8>,
}

impl MachineLines {
    /// The layout of the mock and shared-memory test cards.
    pub const fn standard() -> Self {
        Self { probe: Some(28), disable: Some(29), mtc_ready: None, hold: Some(28) }
    }
}

/// One look at a card: the levels of all input lines, and their time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CardInputSample {
    /// Time at or after the moment the lines were read, ns.
    pub t_ns: u64,
    /// Levels of the input lines; active-low lines are already inverted.
    pub inputs: u64,
    /// The time of the change itself, ns, on cards that stamp edges.
    /// Such a card shows one change per look.
    pub edge_ns: Option<u64>,
    /// Lines on which no count can have been missed since the last look.
    /// This holds however late the look was.
    /// Their edges wait in a queue, or the card counts them itself.
    pub complete: u64,
    /// The card already knows a further change and shows it at the next look.
    /// The engine must not act on this state.
    pub more: bool,
    /// Mask of the lines whose level was read at this look.
    /// A card with queued edges shows the last known level of the others.
    pub fresh: u64,
    /// Fault that the card found since the previous look.
    pub trouble: Option<CardFault>,
    /// Delay of a late look, during which the card's time did not advance, ns.
    /// A simulated machine waits for a process that was not scheduled.
    pub waited_ns: u64,
}

impl CardInputSample {
    /// A look that reads every line, as a polled card does.
    #[inline]
    pub const fn level(t_ns: u64, inputs: u64) -> Self {
        let (complete, more, fresh) = (0, false, u64::MAX);
        Self { t_ns, inputs, edge_ns: None, complete, more, fresh, trouble: None, waited_ns: 0 }
    }

    /// Sample of a card that stamps and shows every change, with `edge_ns` as its time.
    #[inline]
    pub const fn stamped(t_ns: u64, inputs: u64, edge_ns: Option<u64>) -> Self {
        Self { edge_ns, complete: u64::MAX, ..Self::level(t_ns, inputs) }
    }
}

/// Fault that a card found, and the input lines concerned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CardFault {
    /// The kind of fault.
    pub kind: CardFaultKind,
    /// Mask of the input lines concerned.
    pub lines: u64,
}

/// Kinds of faults that a card can find in what it read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CardFaultKind {
    /// The kernel's numbering of edges jumps: two of them were merged into one.
    SequenceGap,
    /// The kernel's queue of edges was full, and the oldest were dropped.
    QueueOverflow,
    /// A line's level disagrees with its edges.
    /// An edge was not reported, or was reported with the wrong polarity.
    EdgeMissed,
    /// The card's own counter reports that it has overflowed.
    CounterOverflow,
    /// The card's decoder reports an illegal transition, or disagrees with the lines.
    CounterError,
}

/// An I/O card.
/// The engine is generic over it; nothing here may allocate, lock or log.
pub trait Card {
    /// The card sleeps until a line changes.
    /// Latency is then the age of an edge when it is seen, not the time between two looks.
    const SLEEPS: bool = false;

    /// Looks at all lines.
    /// The engine has nothing to do before `wake_ns` unless a line changes. A card that can sleep, or whose time is
    /// virtual, may wait until then. A polled card ignores it.
    ///
    /// # Errors
    /// When the lines cannot be read, or a recording has ended.
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError>;

    /// Sets the output lines of `mask` to `value`, the others stay.
    /// Returns a time after which the change is certainly in effect, if the card knows it; otherwise the next look
    /// is that time.
    ///
    /// # Errors
    /// When the lines cannot be written.
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError>;

    /// Reads back the output lines; a restart takes them over.
    ///
    /// # Errors
    /// When the lines cannot be read back.
    fn outputs(&mut self) -> Result<u64, CardError>;
}

/// Reason why a card could not be read or written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum CardError {
    #[error("the recording has ended")]
    Ended,
    #[error("{op}: {}", std::io::Error::from_raw_os_error(*errno))]
    Io { op: &'static str, errno: i32 },
}
