//! A card whose wires are in this process.
//! A test, another thread or a simulated machine drives them.

use crate::card::{Card, CardError, CardInputSample};
use crate::clock::Clock;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The machine at the other end of a mock card's wires.
pub trait Wires {
    /// The levels of the input lines at `t_ns`, with the output lines as given.
    /// The card calls it once per look, and once after every write with the same time. The wires thus see
    /// each change of the outputs in order.
    fn levels(&mut self, t_ns: u64, outputs: u64) -> u64;

    /// The longest step of the machine's time between two looks, ns.
    /// Within it at most one line of a pair changes.
    fn step_limit_ns(&self) -> u64 {
        u64::MAX
    }
}

/// A card in the same process.
///
/// Its time follows the clock but never takes a step longer than the wires allow. A process without real-time
/// priority is sometimes not scheduled. The mock machine then waits for it; a real machine does not.
#[derive(Debug)]
pub struct MockCard<W, K> {
    wires: W,
    clock: K,
    outputs: u64,
    t_ns: u64,
    seen_ns: u64,
}

impl<W: Wires, K: Clock> MockCard<W, K> {
    /// A card on these wires, all outputs low.
    pub fn new(wires: W, mut clock: K) -> Self {
        let now = clock.now_ns();
        Self { wires, clock, outputs: 0, t_ns: now, seen_ns: now }
    }

    /// The other end of the wires.
    pub fn wires(&self) -> &W {
        &self.wires
    }
}

impl<W: Wires, K: Clock> Card for MockCard<W, K> {
    #[inline]
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        let (now, limit_ns) = (self.clock.now_ns(), self.wires.step_limit_ns());
        let since_ns = now - std::mem::replace(&mut self.seen_ns, now);
        let waited_ns = since_ns.saturating_sub(limit_ns);
        self.t_ns += since_ns - waited_ns;
        // A machine that waits shows every change, however late the look.
        let complete = if limit_ns == u64::MAX { 0 } else { u64::MAX };
        let inputs = self.wires.levels(self.t_ns, self.outputs);
        Ok(CardInputSample { complete, waited_ns, ..CardInputSample::level(self.t_ns, inputs) })
    }

    #[inline]
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.wires.levels(self.t_ns, self.outputs);
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Wires that another thread, or a test, drives and watches.
#[derive(Debug, Clone, Default)]
pub struct SharedWires {
    /// Levels of the inputs, written by the simulated machine and read by the card.
    pub inputs: Arc<AtomicU64>,
    /// Levels of the outputs, written by the card and read by the simulated machine.
    pub outputs: Arc<AtomicU64>,
}

impl Wires for SharedWires {
    #[inline]
    fn levels(&mut self, _t_ns: u64, outputs: u64) -> u64 {
        self.outputs.store(outputs, Ordering::Release);
        self.inputs.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Virtual;

    struct Slow;

    impl Wires for Slow {
        fn levels(&mut self, _t_ns: u64, _outputs: u64) -> u64 {
            0
        }

        fn step_limit_ns(&self) -> u64 {
            100
        }
    }

    #[test]
    fn the_machine_waits_for_a_process_that_was_kept_away() {
        struct Jumpy(u64);
        impl Clock for Jumpy {
            fn now_ns(&mut self) -> u64 {
                self.0 += 1_000_000;
                self.0
            }
        }
        let mut card = MockCard::new(Slow, Jumpy(0));
        let first = card.sample(0).unwrap();
        let second = card.sample(0).unwrap();
        assert_eq!(second.t_ns - first.t_ns, 100);
        assert_eq!(second.waited_ns, 1_000_000 - 100, "who was late is not hidden");
        assert_eq!(first.complete, u64::MAX, "no count can pass unseen");
    }

    #[test]
    fn shared_wires_carry_both_ways() {
        let wires = SharedWires::default();
        let mut card = MockCard::new(wires.clone(), Virtual { now_ns: 5 });
        wires.inputs.store(6, Ordering::Release);
        let sample = card.sample(0).unwrap();
        assert_eq!((sample.inputs, sample.complete), (6, 0), "whoever drives them does not wait");
        card.write(0b11, 0b10).unwrap();
        assert_eq!(wires.outputs.load(Ordering::Acquire), 0b10);
        assert_eq!(card.outputs().unwrap(), 0b10);
    }
}
