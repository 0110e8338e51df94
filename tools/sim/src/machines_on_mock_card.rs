//! Machines at the other end of a mock card's wires, in real time.
//! The card's time advances at most to the next change of a line, and by a sixteenth of a count at the axes'
//! highest speed. After a late poll the machine has waited. An insertion takes a few polls, and no count
//! overtakes it if the process is not scheduled in the middle of it.

use crate::attended_machine::AttendedMachine;
use rtec_driver::card::{AxisLines, MachineLines};
use rtec_driver::mock_card::Wires;

/// A machine, and its axes' lines at the card.
#[derive(Debug)]
struct MachineOnMockCard<A> {
    attended: A,
    lines: Vec<AxisLines>,
}

/// Several machines on one card.
#[derive(Debug)]
pub struct MachinesOnMockCard<A> {
    stations: Vec<MachineOnMockCard<A>>,
    probe: u64,
    hold: u64,
    /// Card time at which the machines' time begins, ns.
    start_ns: Option<u64>,
    now_ns: u64,
    /// Time until which the inputs stay if the outputs do, ns.
    quiet_until_ns: u64,
    /// Longest advance of the machines at one poll, ns.
    patience_ns: u64,
    outputs: u64,
    inputs: u64,
}

/// A machine's own lines: axis n has A, B, A', B' from bit 4n, inverters from 2n.
/// Probe and hold are as on a mock card.
const OWN: MachineLines = MachineLines::standard();

fn bit(line: Option<u8>) -> u64 {
    line.map_or(0, |b| 1 << b)
}

impl<A: AttendedMachine> MachineOnMockCard<A> {
    fn set_outputs(&mut self, outputs: u64, hold: u64) {
        let mut own = if outputs & hold == 0 { 0 } else { bit(OWN.hold) };
        for (n, lines) in self.lines.iter().enumerate() {
            own |= u64::from(lines.inverters(outputs)) << (2 * n);
        }
        self.attended.machine_mut().set_outputs(own);
    }

    fn inputs(&self, probe: u64) -> u64 {
        let own = self.attended.machine().inputs();
        let mut inputs = if own & bit(OWN.probe) == 0 { 0 } else { probe };
        for (n, lines) in self.lines.iter().enumerate() {
            let of = |bit: usize| own >> (4 * n + bit) & 1;
            inputs |= of(0) << lines.a | of(1) << lines.b;
            if let Some((a, b)) = lines.read_back {
                inputs |= of(2) << a | of(3) << b;
            }
        }
        inputs
    }
}

impl<A: AttendedMachine> MachinesOnMockCard<A> {
    /// Machines, each with the card's lines of its axes.
    /// Feed hold and probe are common to all.
    pub fn new(machines: impl IntoIterator<Item = (A, Vec<AxisLines>)>, lines: MachineLines) -> Self {
        let stations: Vec<_> =
            machines.into_iter().map(|(attended, lines)| MachineOnMockCard { attended, lines }).collect();
        let fastest = stations.iter().map(|s| s.attended.machine().fastest_counts_s()).fold(1.0, f64::max);
        Self {
            stations,
            patience_ns: (1e9 / 16.0 / fastest) as u64,
            probe: bit(lines.probe),
            hold: bit(lines.hold),
            start_ns: None,
            now_ns: 0,
            quiet_until_ns: 0,
            outputs: 0,
            inputs: 0,
        }
    }
}

impl<A: AttendedMachine> Wires for MachinesOnMockCard<A> {
    #[inline]
    fn levels(&mut self, t_ns: u64, outputs: u64) -> u64 {
        self.now_ns = t_ns - *self.start_ns.get_or_insert(t_ns);
        if self.now_ns < self.quiet_until_ns && outputs == self.outputs {
            return self.inputs;
        }
        self.outputs = outputs;
        (self.inputs, self.quiet_until_ns) = (0, u64::MAX);
        for station in &mut self.stations {
            station.attended.run_to(self.now_ns);
            station.set_outputs(outputs, self.hold);
            let (quiet_until_ns, _) = station.attended.machine_mut().quiet_until_ns();
            station.attended.changed();
            self.quiet_until_ns = self.quiet_until_ns.min(quiet_until_ns);
            self.inputs |= station.inputs(self.probe);
        }
        self.inputs
    }

    #[inline]
    fn step_limit_ns(&self) -> u64 {
        self.quiet_until_ns.saturating_sub(self.now_ns).clamp(1, self.patience_ns.max(1))
    }
}

#[cfg(test)]
impl<A> MachinesOnMockCard<A> {
    pub(crate) fn attended(&self, n: usize) -> &A {
        &self.stations[n].attended
    }

    pub(crate) const fn now_ns(&self) -> u64 {
        self.now_ns
    }
}
