//! Two signals in quadrature: the state table and a decoder.
//!
//! A leads B is positive: (A,B) runs 00 → 10 → 11 → 01 → 00, one count per state (x4). NISTIR 4832, state table
//! of Design B.

/// The levels of A (bit 0) and B (bit 1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct State(u8);

/// One of the two signals, as a mask over [`State`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Signal {
    /// Signal A.
    A = 1,
    /// Signal B.
    B = 2,
}

impl Signal {
    /// The other signal.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::A => Self::B,
            Self::B => Self::A,
        }
    }
}

impl State {
    /// The state with these levels.
    pub const fn new(a: bool, b: bool) -> Self {
        Self(a as u8 | (b as u8) << 1)
    }

    /// The state from bit 0 (A) and bit 1 (B); higher bits are ignored.
    pub const fn from_bits(bits: u8) -> Self {
        Self(bits & 3)
    }

    /// Bit 0 is A, bit 1 is B.
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// Level of A.
    pub const fn a(self) -> bool {
        self.0 & 1 != 0
    }

    /// Level of B.
    pub const fn b(self) -> bool {
        self.0 & 2 != 0
    }

    /// Whether A = B, which decides what is inverted first (NISTIR 4832, Design C).
    pub const fn equal(self) -> bool {
        self.0 == 0 || self.0 == 3
    }

    /// The state with one signal inverted.
    #[must_use]
    pub const fn flipped(self, signal: Signal) -> Self {
        Self(self.0 ^ signal as u8)
    }

    /// The state with the signals of `mask` inverted, as the XOR gates do it.
    /// In `mask`, bit 0 is A and bit 1 is B.
    #[must_use]
    pub const fn inverted(self, mask: u8) -> Self {
        Self((self.0 ^ mask) & 3)
    }

    /// Mask of the signals that differ: bit 0 is A, bit 1 is B.
    #[inline]
    pub const fn changed(self, other: Self) -> u8 {
        self.0 ^ other.0
    }

    /// Counts of the transition to `next`: −1, 0 or +1.
    /// `None` when both signals changed.
    #[inline]
    pub const fn step_to(self, next: Self) -> Option<i8> {
        match self.changed(next) {
            0 => Some(0),
            3 => None,
            _ => Some(self.step_to_neighbour(next)),
        }
    }

    /// Counts of the transition to a state in which exactly one signal differs.
    /// The step is +1 if the present A differs from the previous B.
    #[inline]
    pub const fn step_to_neighbour(self, next: Self) -> i8 {
        2 * ((next.0 ^ self.0 >> 1) & 1) as i8 - 1
    }

    /// Counts of inverting `signal` in this state.
    /// A gives +1 when A = B and −1 otherwise. B gives the opposite.
    pub const fn step_of(self, signal: Signal) -> i8 {
        self.step_to_neighbour(self.flipped(signal))
    }

    /// The signal that changes from here to `next`, a neighbouring state.
    pub const fn signal_to(self, next: Self) -> Signal {
        if (self.0 ^ next.0) & 1 != 0 { Signal::A } else { Signal::B }
    }

    /// The neighbouring state in the positive (`true`) or negative direction.
    #[must_use]
    pub const fn next(self, positive: bool) -> Self {
        self.flipped(self.signal_towards(positive))
    }

    /// The signal whose change moves one count in the given direction from here.
    pub const fn signal_towards(self, positive: bool) -> Signal {
        if self.equal() == positive { Signal::A } else { Signal::B }
    }
}

/// Counts one pair of signals.
/// An illegal transition is only counted as illegal; the count stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Decoder {
    state: State,
    count: i64,
    illegal: u64,
}

impl Decoder {
    /// A decoder at zero, in the given state.
    pub const fn new(state: State) -> Self {
        Self { state, count: 0, illegal: 0 }
    }

    /// Takes the next state.
    /// Returns the step, or `None` for an illegal transition (the count then stays).
    #[inline]
    pub fn update(&mut self, next: State) -> Option<i8> {
        let step = self.state.step_to(next);
        self.state = next;
        match step {
            Some(s) => self.count += i64::from(s),
            None => self.illegal += 1,
        }
        step
    }

    /// Takes the next state, whose step is already known.
    /// The step is that of [`State::step_to`]: −1, 0 or +1.
    #[inline]
    pub fn take_step(&mut self, next: State, step: i8) {
        debug_assert_eq!(self.state.step_to(next), Some(step));
        self.state = next;
        self.count += i64::from(step);
    }

    /// Counts since the start.
    pub const fn count(&self) -> i64 {
        self.count
    }

    /// The present state.
    pub const fn state(&self) -> State {
        self.state
    }

    /// Transitions in which both signals changed.
    pub const fn illegal(&self) -> u64 {
        self.illegal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts of the step from one state to the next, indexed by `from << 2 | to`.
    /// 2 marks an illegal transition.
    const STEP: [i8; 16] = [
        0, 1, -1, 2, // from A=0 B=0: A rises +1, B rises −1, both: illegal
        -1, 0, 2, 1, // from A=1 B=0
        1, 2, 0, -1, // from A=0 B=1
        2, -1, 1, 0, // from A=1 B=1
    ];

    #[test]
    fn every_step_is_that_of_the_state_table() {
        for (n, counts) in STEP.into_iter().enumerate() {
            let (from, to) = (State::from_bits((n >> 2) as u8), State::from_bits(n as u8));
            assert_eq!(from.step_to(to), Some(counts).filter(|c| *c != 2), "{from:?} to {to:?}");
        }
    }

    /// The cycle of tools/guide/reference/traces.md: 00 → 10 → 11 → 01 → 00.
    const CYCLE: [(bool, bool); 4] = [(false, false), (true, false), (true, true), (false, true)];

    #[test]
    fn a_state_is_its_two_levels() {
        for (a, b) in CYCLE {
            let s = State::new(a, b);
            assert_eq!((s.a(), s.b()), (a, b));
            assert_eq!(s.bits(), u8::from(a) + 2 * u8::from(b));
            assert_eq!(State::from_bits(s.bits() | 0xfc), s, "higher bits are ignored");
            assert_eq!((s.flipped(Signal::A).a(), s.flipped(Signal::B).b()), (!a, !b));
            assert_eq!((s.flipped(Signal::A).b(), s.flipped(Signal::B).a()), (b, a));
        }
        assert_eq!((Signal::A.other(), Signal::B.other()), (Signal::B, Signal::A));
    }

    #[test]
    fn positive_cycle_counts_up_and_back_down() {
        let mut d = Decoder::new(State::new(false, false));
        for n in 1..=8_usize {
            let (a, b) = CYCLE[n % 4];
            assert_eq!(d.update(State::new(a, b)), Some(1));
        }
        for n in (0..8_usize).rev() {
            let (a, b) = CYCLE[n % 4];
            assert_eq!(d.update(State::new(a, b)), Some(-1));
        }
        assert_eq!((d.count(), d.illegal()), (0, 0));
    }

    #[test]
    fn a_step_that_is_known_counts_as_one_that_is_looked_up() {
        let [mut known, mut looked_up] = [Decoder::new(State::default()); 2];
        for bits in [1, 3, 3, 2, 3, 1, 0, 2, 3, 1, 0] {
            let next = State::from_bits(bits);
            let step = looked_up.update(next).unwrap();
            known.take_step(next, step);
            assert_eq!(known, looked_up);
        }
        assert_eq!(known.count(), -4);
    }

    #[test]
    fn both_signals_at_once_is_illegal_from_every_state() {
        for bits in 0..4 {
            let s = State::from_bits(bits);
            let mut d = Decoder::new(s);
            assert_eq!(d.update(s.inverted(3)), None);
            assert_eq!((d.count(), d.illegal(), d.state()), (0, 1, s.inverted(3)));
        }
    }

    /// The general algorithm of NISTIR 4832, Design C.
    #[test]
    fn two_inversions_in_the_papers_order_make_two_counts() {
        for bits in 0..4 {
            let s = State::from_bits(bits);
            for add in [true, false] {
                let first = if s.equal() == add { Signal::A } else { Signal::B };
                assert_eq!(s.signal_towards(add), first);
                let mut d = Decoder::new(s);
                d.update(s.flipped(first));
                d.update(s.inverted(3));
                assert_eq!(d.count(), if add { 2 } else { -2 });
            }
        }
    }

    #[test]
    fn steps_agree_with_the_neighbours() {
        for bits in 0..4 {
            let s = State::from_bits(bits);
            assert_eq!(s.step_to(s.next(true)), Some(1));
            assert_eq!(s.step_to(s.next(false)), Some(-1));
            for signal in [Signal::A, Signal::B] {
                assert_eq!(Some(s.step_of(signal)), s.step_to(s.flipped(signal)));
                assert_eq!(s.signal_to(s.flipped(signal)), signal);
                assert_ne!(s.equal(), s.flipped(signal).equal());
            }
        }
    }
}
