//! Three axes, or another number, on a card in memory.
//! Benchmarks time this work, and count its instructions.

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::link_messages::{CorrectorStatus, RequestToRt};

/// Axes of the workload, as many as LinuxCNC's counter is measured with.
pub const AXES: u8 = 3;

/// Motion of the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// No line changes.
    Still,
    /// Every look finds an edge on each of the three axes; no correction is pending.
    Moving,
    /// An edge on each axis every 32 looks, 3.2 µs, and each opens an insertion.
    Correcting,
}

impl Motion {
    /// All motions, with the names that benchmarks print.
    pub const ALL: [(&'static str, Self); 3] =
        [("still", Self::Still), ("moving", Self::Moving), ("correcting", Self::Correcting)];

    /// Time between two looks, ns, and looks between two edges.
    const fn pace(self) -> (u64, u64) {
        match self {
            Self::Still => (100, u64::MAX),
            // No gap is longer than an insertion needs, or it would latch a poll gap.
            Self::Moving => (1000, 1),
            Self::Correcting => (100, 32),
        }
    }
}

/// The three axes with an engine on them, homed and enabled.
#[derive(Debug)]
pub struct Workload {
    engine: Engine,
    wires: Wires,
}

#[derive(Debug)]
struct Wires {
    inputs: u64,
    /// Mask of the lines of the axes in use.
    wired: u64,
    outputs: u64,
    t_ns: u64,
    step_ns: u64,
    looks: u64,
    looks_per_edge: u64,
}

impl Card for Wires {
    #[inline]
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        self.t_ns += self.step_ns;
        self.looks += 1;
        if self.looks == self.looks_per_edge {
            self.looks = 0;
            // Gray code of all axes at once. It needs no table or loop, so that the counted instructions are the
            // engine's.
            let edge = if (self.inputs ^ self.inputs >> 1) & 1 == 0 { 0x11_1111 } else { 0x22_2222 };
            self.inputs ^= edge & self.wired;
        }
        Ok(CardInputSample::level(self.t_ns, self.inputs))
    }

    #[inline]
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

impl Workload {
    /// Three homed axes.
    /// With [`Motion::Correcting`] each has an endless correction.
    ///
    /// # Errors
    /// When the engine does not start.
    pub fn new(motion: Motion) -> Result<Self, StartError> {
        Self::of(motion, AXES)
    }

    /// The same with another number of axes, six at most.
    ///
    /// # Errors
    /// When the engine does not start.
    pub fn of(motion: Motion, axes: u8) -> Result<Self, StartError> {
        let axis = |n| AxisConfig {
            lines: AxisLines::standard(n, false),
            max_correction_counts: i64::MAX,
            ..AxisConfig::default()
        };
        let configured: Vec<AxisConfig> = (0..axes).map(axis).collect();
        let (step_ns, looks_per_edge) = motion.pace();
        let wired = (1_u64 << (4 * u32::from(axes))) - 1;
        let mut wires = Wires { inputs: 0, wired, outputs: 0, t_ns: 1, step_ns, looks: 0, looks_per_edge };
        let machine = MachineConfig { lines: MachineLines::standard(), may_arm: true };
        let mut engine = Engine::new(&mut wires, &configured, machine, &[])?;
        let report = &mut |_| true;
        engine.start_homed(&mut wires, report)?;
        if motion == Motion::Correcting {
            for axis in 0..axes {
                let request = RequestToRt::Correct { axis, total_counts: i64::MAX / 2, large: true };
                engine.take(request, &mut wires, report)?;
            }
        }
        Ok(Self { engine, wires })
    }

    /// Makes `n` looks of the engine.
    ///
    /// # Errors
    /// None on this card.
    #[inline]
    pub fn looks(&mut self, n: u64) -> Result<(), CardError> {
        for _ in 0..n {
            self.engine.poll(&mut self.wires, u64::MAX, &mut |_| true)?;
        }
        Ok(())
    }

    /// The engine's status.
    pub fn status(&self) -> CorrectorStatus {
        self.engine.status()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_motion_is_what_it_says() {
        for (axes, (name, motion)) in [1, AXES, 6].into_iter().flat_map(|n| Motion::ALL.map(|m| (n, m))) {
            let mut work = Workload::of(motion, axes).unwrap();
            work.looks(32_000).unwrap();
            let status = work.status();
            assert!(status.balanced() && !status.faults.any(), "{name}");
            assert_eq!(status.axes().len(), usize::from(axes));
            for axis in status.axes() {
                assert!(!axis.faults.any() && axis.illegal == 0, "{name}: {axis:?}");
                let (counts, insertions) = (axis.position_counts.unsigned_abs(), axis.insertions);
                match motion {
                    Motion::Still => assert_eq!((counts, insertions), (0, 0)),
                    Motion::Moving => assert_eq!((counts, insertions), (32_000, 0)),
                    // The first edges open no insertion, because there is no period yet.
                    Motion::Correcting => {
                        assert!(counts >= 999 && insertions >= 990, "{counts}, {insertions}");
                    }
                }
            }
        }
    }
}
