//! A card of registers, reached by memory, port I/O or a driver's calls.

use crate::card::{Card, CardError, CardFault, CardFaultKind, CardInputSample};
use crate::card_profile::{
    CardProfile, Counter, Register, RegisterBit, RegisterPreset, RegisterWrite, Width,
};
use crate::clock::Clock;

/// Access to registers.
/// An implementation that cannot fail costs nothing.
pub trait RegisterAccess {
    /// Reads a register at a byte offset.
    ///
    /// # Errors
    /// When the card does not answer.
    fn read(&self, offset: usize, width: Width) -> Result<u32, CardError>;

    /// Writes a register at a byte offset.
    ///
    /// # Errors
    /// When the card does not answer.
    fn write(&self, offset: usize, width: Width, value: u32) -> Result<(), CardError>;
}

/// Reason why a card cannot be used as its profile states.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum SetUpError {
    #[error(transparent)]
    Card(#[from] CardError),
    #[error(
        "register {offset:#x} reads {found:#x}, expected {value:#x} (set up) or {after_reset:#x} (after a reset): is this \
         the card of profile \"{profile}\"? Nothing was written"
    )]
    Unexpected { offset: usize, found: u32, value: u32, after_reset: u32, profile: String },
    #[error("register {offset:#x} reads {found:#x} after {value:#x} was written to it")]
    NotTaken { offset: usize, found: u32, value: u32 },
}

/// One register's part of the 64-bit word that the engine sees.
#[derive(Debug, Clone, Copy)]
struct RegisterInIoWord {
    offset: usize,
    width: Width,
    shift: u32,
}

/// Largest jump between two looks that can be motion, counts.
const MAX_JUMP_COUNTS: i64 = 1 << 16;
/// States of a scale in the order of its counts.
const CYCLE: [u64; 4] = [0b00, 0b01, 0b11, 0b10];

/// A counter of the card's own.
/// The engine sees it as quadrature states, one count per look. The ledger thus follows the card's count, and
/// no look contains two counts.
#[derive(Debug)]
struct CounterState {
    counter: Counter,
    /// As last read.
    raw: u32,
    /// A and B as last read.
    lines: u64,
    /// The card's count, and the count shown to the engine so far.
    target: i64,
    shown: i64,
    /// State at a count that is divisible by four, as an index into [`CYCLE`].
    phase: i64,
}

impl CounterState {
    /// A and B in an input word, bit 0 and bit 1.
    fn lines_of(&self, inputs: u64) -> u64 {
        let (a, b) = self.counter.lines;
        inputs >> a & 1 | (inputs >> b & 1) << 1
    }

    fn mask(&self) -> u64 {
        1 << self.counter.lines.0 | 1 << self.counter.lines.1
    }

    /// Writes the state of the shown count into an input word, as logical levels.
    fn show(&self, inputs: u64) -> u64 {
        let state = CYCLE[(self.shown + self.phase).rem_euclid(4) as usize];
        let (a, b) = self.counter.lines;
        inputs & !self.mask() | (state & 1) << a | (state >> 1) << b
    }

    /// Aligns the count with the present lines.
    fn align(&mut self, lines: u64) {
        let index = CYCLE.iter().position(|s| *s == lines).unwrap_or(0) as i64;
        self.phase = (index - self.target).rem_euclid(4);
        self.shown = self.target;
        self.lines = lines;
    }

    /// Takes one reading of lines, count and flags.
    fn take(&mut self, inputs: u64, raw: u32, overflow: bool, error: bool) -> Option<CardFaultKind> {
        let bits = self.counter.count.width.bits();
        let delta = i64::from((raw.wrapping_sub(self.raw) << (32 - bits)) as i32 >> (32 - bits));
        let lines = self.lines_of(inputs);
        let still = delta == 0 && lines == self.lines;
        self.raw = raw;
        self.target += delta;
        self.lines = lines;
        if delta.abs() > MAX_JUMP_COUNTS {
            self.align(lines);
            return Some(CardFaultKind::CounterError);
        }
        // Lines and count are two readings. They must agree only if neither has changed since the previous
        // look.
        if still && CYCLE[(self.target + self.phase).rem_euclid(4) as usize] != lines {
            self.align(lines);
            return Some(CardFaultKind::CounterError);
        }
        if overflow {
            return Some(CardFaultKind::CounterOverflow);
        }
        error.then_some(CardFaultKind::CounterError)
    }
}

/// A card of registers.
#[derive(Debug)]
pub struct RegisterCard<B, K> {
    bus: B,
    inputs: Box<[RegisterInIoWord]>,
    outputs: Box<[RegisterInIoWord]>,
    counters: Box<[CounterState]>,
    input_invert: u64,
    output_invert: u64,
    /// The output registers as last written.
    /// A masked write needs no read over the bus, and a write that changes nothing is left out.
    written: u64,
    /// Input lines as last read, of a card with counters.
    levels: u64,
    clock: K,
}

impl<B: RegisterAccess, K: Clock> RegisterCard<B, K> {
    /// Opens a card without changing it.
    /// Only registers that the profile sets up after a reset are written.
    ///
    /// # Errors
    /// When a register cannot be read, or is not what the profile states.
    pub fn new(bus: B, profile: &CardProfile, clock: K) -> Result<Self, SetUpError> {
        for RegisterPreset {
            order: RegisterWrite { register: Register { offset, width }, value },
            after_reset,
        } in &profile.setup
        {
            let (offset, width, value, after_reset) = (*offset, *width, *value, *after_reset);
            let found = bus.read(offset, width)?;
            if found == value {
                continue;
            }
            if found != after_reset {
                let profile = profile.name.clone();
                return Err(SetUpError::Unexpected { offset, found, value, after_reset, profile });
            }
            bus.write(offset, width, value)?;
            let found = bus.read(offset, width)?;
            if found != value {
                return Err(SetUpError::NotTaken { offset, found, value });
            }
        }
        let parts = |registers: &[Register]| {
            let mut shift = 0;
            let mut parts = Vec::new();
            for r in registers {
                parts.push(RegisterInIoWord { offset: r.offset, width: r.width, shift });
                shift += r.width.bits();
            }
            parts.into_boxed_slice()
        };
        let start =
            |c: &Counter| CounterState { counter: *c, raw: 0, lines: 0, target: 0, shown: 0, phase: 0 };
        let mut card = Self {
            bus,
            inputs: parts(&profile.inputs),
            outputs: parts(&profile.outputs),
            counters: profile.counters.iter().map(start).collect(),
            input_invert: profile.input_invert,
            output_invert: profile.output_invert,
            written: 0,
            levels: 0,
            clock,
        };
        card.written = card.gather(&card.outputs)?;
        for n in 0..card.counters.len() {
            let raw = card.count_of(n)?;
            card.counters[n].raw = raw;
            let levels = card.levels_now()?;
            let lines = card.counters[n].lines_of(levels);
            card.counters[n].align(lines);
        }
        card.levels = card.levels_now()?;
        Ok(card)
    }

    #[inline]
    fn gather(&self, parts: &[RegisterInIoWord]) -> Result<u64, CardError> {
        let mut word = 0;
        for p in parts {
            word |= u64::from(self.bus.read(p.offset, p.width)?) << p.shift;
        }
        Ok(word)
    }

    #[inline]
    fn levels_now(&self) -> Result<u64, CardError> {
        Ok(self.gather(&self.inputs)? ^ self.input_invert)
    }

    fn order(&self, order: Option<RegisterWrite>) -> Result<(), CardError> {
        order.map_or(Ok(()), |o| self.bus.write(o.register.offset, o.register.width, o.value))
    }

    fn flag(&self, flag: Option<RegisterBit>) -> Result<bool, CardError> {
        flag.map_or(Ok(false), |f| Ok(self.bus.read(f.register.offset, f.register.width)? >> f.bit & 1 != 0))
    }

    /// Reads the count of a counter, latched first if possible.
    fn count_of(&self, n: usize) -> Result<u32, CardError> {
        let counter = &self.counters[n].counter;
        self.order(counter.latch)?;
        self.bus.read(counter.count.offset, counter.count.width)
    }

    /// A look at a card with counters, advancing each by at most one count.
    /// The engine then follows the card's count through every state.
    fn sample_counted(&mut self) -> Result<CardInputSample, CardError> {
        let mut trouble = None;
        if self.counters.iter().all(|c| c.shown == c.target) {
            self.levels = self.levels_now()?;
            for n in 0..self.counters.len() {
                let raw = self.count_of(n)?;
                let Counter { overflow, error, clear, .. } = self.counters[n].counter;
                let (overflow, error) = (self.flag(overflow)?, self.flag(error)?);
                if overflow || error {
                    self.order(clear)?;
                }
                if let Some(kind) = self.counters[n].take(self.levels, raw, overflow, error) {
                    trouble = Some(CardFault { kind, lines: self.counters[n].mask() });
                }
            }
        }
        let (mut inputs, mut counted, mut more) = (self.levels, 0, false);
        for c in &mut self.counters {
            c.shown += (c.target - c.shown).signum();
            inputs = c.show(inputs);
            counted |= c.mask();
            more |= c.shown != c.target;
        }
        let sample = CardInputSample::level(self.clock.now_ns(), inputs);
        Ok(CardInputSample { complete: counted, more, trouble, ..sample })
    }
}

impl<B: RegisterAccess, K: Clock> Card for RegisterCard<B, K> {
    #[inline]
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        if !self.counters.is_empty() {
            return self.sample_counted();
        }
        let inputs = self.levels_now()?;
        Ok(CardInputSample::level(self.clock.now_ns(), inputs))
    }

    #[inline]
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let raw = self.written & !mask | (value ^ self.output_invert) & mask;
        let changed = raw ^ self.written;
        self.written = raw;
        for p in &self.outputs {
            if changed >> p.shift & p.width.mask() != 0 {
                self.bus.write(p.offset, p.width, (raw >> p.shift & p.width.mask()) as u32)?;
            }
        }
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.gather(&self.outputs)? ^ self.output_invert)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Virtual;
    use crate::quadrature::{Decoder, State};
    use std::cell::RefCell;
    use std::rc::Rc;

    /// Registers of a test card, and every write as offset and value.
    type Memory = (Vec<u32>, Vec<(usize, u32)>);

    #[derive(Debug, Clone, Default)]
    struct Bench(Rc<RefCell<Memory>>);

    impl Bench {
        fn set(&self, offset: usize, value: u32) {
            self.0.borrow_mut().0[offset / 4] = value;
        }

        fn written(&self) -> Vec<(usize, u32)> {
            std::mem::take(&mut self.0.borrow_mut().1)
        }
    }

    impl RegisterAccess for Bench {
        fn read(&self, offset: usize, _width: Width) -> Result<u32, CardError> {
            Ok(self.0.borrow().0[offset / 4])
        }

        fn write(&self, offset: usize, _width: Width, value: u32) -> Result<(), CardError> {
            let mut bench = self.0.borrow_mut();
            bench.1.push((offset, value));
            bench.0[offset / 4] = value;
            Ok(())
        }
    }

    const STATES: [u32; 4] = [0, 1, 3, 2];

    fn counter_card() -> (Bench, RegisterCard<Bench, Virtual>) {
        let bench = Bench::default();
        bench.0.borrow_mut().0 = vec![0; 8];
        // The scale is in the third state of its cycle; the counter has any value.
        bench.set(0, STATES[2]);
        bench.set(12, 0xffff_fff0);
        let at = |offset| Register { offset, width: Width::Bits32 };
        let counter = |n: u8| Counter {
            lines: (2 * n, 2 * n + 1),
            count: at(12 + 4 * usize::from(n)),
            latch: Some(RegisterWrite { register: at(8), value: 1 << n }),
            overflow: Some(RegisterBit { register: at(20), bit: 2 * n }),
            error: Some(RegisterBit { register: at(20), bit: 2 * n + 1 }),
            clear: Some(RegisterWrite { register: at(20), value: 3 << (2 * n) }),
        };
        let profile = CardProfile { counters: vec![counter(0), counter(1)], ..CardProfile::shared_memory() };
        let card = RegisterCard::new(bench.clone(), &profile, Virtual::default()).unwrap();
        (bench, card)
    }

    /// Holds for any other inputs, and for any count at the time of alignment.
    #[test]
    fn a_count_agreed_with_its_lines_is_shown_as_them() {
        let (_bench, card) = counter_card();
        let counter = Counter { lines: (2, 5), ..card.counters[0].counter };
        let mut counting = CounterState { counter, raw: 0, lines: 0, target: 0, shown: 0, phase: 0 };
        for inputs in 0..=0xff {
            let lines = (inputs >> 2 & 1) + 2 * (inputs >> 5 & 1);
            assert_eq!(counting.lines_of(inputs), lines, "{inputs:#x}");
            for target in -5..5 {
                counting.target = target;
                counting.align(lines);
                assert_eq!(counting.show(!inputs), !inputs & !0b10_0100 | inputs & 0b10_0100);
            }
        }
    }

    #[test]
    fn the_cards_count_is_shown_state_by_state_through_its_wrap() {
        let (bench, mut card) = counter_card();
        let mut decoder = Decoder::new(State::from_bits(card.sample(0).unwrap().inputs as u8));
        let mut count = 0_i64;
        for jump in [1, 5, 17, -3, -40, 2] {
            count += jump;
            bench.set(0, STATES[(2 + count).rem_euclid(4) as usize]);
            bench.set(12, 0xffff_fff0_u32.wrapping_add(count as u32));
            for left in (0..jump.abs()).rev() {
                let sample = card.sample(0).unwrap();
                assert_eq!((sample.more, sample.complete & 3, sample.trouble), (left > 0, 3, None));
                assert_eq!(decoder.update(State::from_bits(sample.inputs as u8)), Some(jump.signum() as i8));
            }
            assert_eq!(decoder.count(), count);
        }
        assert!(bench.written().contains(&(8, 1)), "the count is latched before it is read");
    }

    /// Counters narrower than a word run over and under at their own width.
    #[test]
    fn a_narrow_counter_wraps_at_its_own_width() {
        for (width, bits) in [(Width::Bits8, 8), (Width::Bits16, 16), (Width::Bits32, 32)] {
            let count = Register { offset: 12, width };
            let counter =
                Counter { lines: (0, 1), count, latch: None, overflow: None, error: None, clear: None };
            let mut counting = CounterState { counter, raw: 0, lines: 0, target: 0, shown: 0, phase: 0 };
            let mut now = 0_i64;
            for step in [1, -2, 100, -120, 127, -128] {
                now += step;
                let raw = (now as u64 & ((1 << bits) - 1)) as u32;
                let lines = CYCLE[now.rem_euclid(4) as usize];
                assert_eq!(counting.take(lines, raw, false, false), None);
                assert_eq!(
                    (counting.target, counting.take(lines, raw, false, false)),
                    (now, None),
                    "{bits} bits"
                );
            }
        }
    }

    #[test]
    fn a_jump_of_as_many_counts_as_motion_can_make_is_motion_and_one_more_is_not() {
        for sign in [1_i64, -1] {
            for (more, trouble) in [(0, None), (1, Some(CardFaultKind::CounterError))] {
                let (_bench, card) = counter_card();
                let counter = card.counters[0].counter;
                let mut counting = CounterState { counter, raw: 0, lines: 0, target: 0, shown: 0, phase: 0 };
                let jump = sign * (65_536 + more);
                let lines = CYCLE[jump.rem_euclid(4) as usize];
                assert_eq!(counting.take(lines, jump as u32, false, false), trouble, "{jump} counts");
            }
        }
    }

    #[test]
    fn inputs_that_are_active_low_are_shown_as_what_they_mean() {
        let bench = Bench::default();
        bench.0.borrow_mut().0 = vec![0; 8];
        let profile = CardProfile { input_invert: 0b1010, ..CardProfile::shared_memory() };
        let mut card = RegisterCard::new(bench.clone(), &profile, Virtual::default()).unwrap();
        for (register, shown) in [(0, 0b1010), (0b1111, 0b0101), (0b0011, 0b1001)] {
            bench.set(0, register);
            assert_eq!(card.sample(0).unwrap().inputs, shown);
        }
    }

    #[test]
    fn the_cards_flags_are_reported_and_cleared() {
        let (bench, mut card) = counter_card();
        for (flags, kind) in [(1, CardFaultKind::CounterOverflow), (2, CardFaultKind::CounterError)] {
            bench.set(20, flags);
            bench.written();
            let trouble = card.sample(0).unwrap().trouble.unwrap();
            assert_eq!((trouble.kind, trouble.lines), (kind, 0b11));
            assert!(bench.written().contains(&(20, 3)));
            bench.set(20, 0);
            assert_eq!(card.sample(0).unwrap().trouble, None);
        }
        bench.set(20, 4);
        assert_eq!(card.sample(0).unwrap().trouble.unwrap().lines, 0b1100);
    }

    #[test]
    fn a_count_that_the_lines_contradict_is_reported_once_both_stand_still() {
        let (bench, mut card) = counter_card();
        bench.set(0, STATES[3]);
        assert_eq!(card.sample(0).unwrap().trouble, None, "the lines were read before the count");
        assert_eq!(card.sample(0).unwrap().trouble.unwrap().kind, CardFaultKind::CounterError);
        assert_eq!(card.sample(0).unwrap().trouble, None, "agreed anew");
        bench.set(12, 0x1000_0000);
        assert_eq!(card.sample(0).unwrap().trouble.unwrap().kind, CardFaultKind::CounterError, "no motion");
    }

    #[test]
    fn a_write_that_changes_nothing_is_not_made() {
        let (bench, mut card) = counter_card();
        bench.written();
        card.write(0b11, 0b01).unwrap();
        card.write(0b01, 0b01).unwrap();
        card.write(0b10, 0b00).unwrap();
        assert_eq!(bench.written(), [(4, 0b01)]);
    }

    /// A write changes only the requested lines.
    /// The card has two output registers, with some lines of each inverted. A register is written only where one of
    /// its own lines changes. The levels read back are those written.
    #[test]
    fn every_write_changes_its_own_lines_and_no_others() {
        let output = |offset, width| Register { offset, width };
        let invert = 0b1010_0110_1100;
        let profile = CardProfile {
            outputs: vec![output(4, Width::Bits8), output(8, Width::Bits8)],
            output_invert: invert,
            ..CardProfile::shared_memory()
        };
        let bench = Bench::default();
        bench.0.borrow_mut().0 = vec![0; 8];
        let mut card = RegisterCard::new(bench.clone(), &profile, Virtual::default()).unwrap();
        assert_eq!(card.outputs().unwrap(), invert, "registers at 0");
        bench.written();
        let mut levels = invert;
        let mut dice = 0x9E37_79B9_u64;
        for _ in 0..2000 {
            dice ^= dice << 13;
            dice ^= dice >> 7;
            dice ^= dice << 17;
            let (mask, value) = (dice & 0xffff & dice >> 20, dice >> 40 & 0xffff);
            let expected: u64 = (0..16)
                .map(|bit| if mask >> bit & 1 == 1 { value & 1 << bit } else { levels & 1 << bit })
                .sum();
            card.write(mask, value).unwrap();
            let raw = |levels: u64| levels ^ invert;
            let changed = raw(levels) ^ raw(expected);
            let own = [(4, changed & 0xff, raw(expected) & 0xff), (8, changed >> 8, raw(expected) >> 8)];
            let due: Vec<(usize, u32)> = own.iter().filter(|o| o.1 != 0).map(|o| (o.0, o.2 as u32)).collect();
            assert_eq!(bench.written(), due, "mask {mask:#x}, value {value:#x}");
            assert_eq!(card.outputs().unwrap(), expected);
            levels = expected;
        }
    }

    #[test]
    fn setting_up_is_done_once_and_only_on_the_card_that_was_meant() {
        let order = RegisterWrite { register: Register { offset: 12, width: Width::Bits32 }, value: 0x92 };
        let setup = vec![RegisterPreset { order, after_reset: 0x9b }];
        let profile = CardProfile { setup, ..CardProfile::shared_memory() };
        let bench = Bench::default();
        bench.0.borrow_mut().0 = vec![0; 8];
        let open = || RegisterCard::new(bench.clone(), &profile, Virtual::default());
        bench.set(12, 0x9b);
        open().unwrap();
        assert_eq!(bench.written(), [(12, 0x92)]);
        open().unwrap();
        assert_eq!(bench.written(), []);
        bench.set(12, 0xff);
        let error = open().unwrap_err().to_string();
        assert!(error.starts_with("register 0xc reads 0xff, expected 0x92 (set up) or 0x9b"), "{error}");
        assert_eq!(bench.written(), []);
    }
}
