//! The machine at the other end of the card, with or without a daemon.
//! Two axes move by themselves. They have scales, XOR gates and an MTC that counts every change in true order.

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use test_needs::dice::Dice;
use test_needs::motion::Motion;

/// The panic's payload of a process that is killed.
pub(super) struct Killed;

/// Levels of A and B at each count of the cycle, in the positive direction.
const CYCLE: [u64; 4] = [0b00, 0b01, 0b11, 0b10];

pub(super) struct Place {
    lines: AxisLines,
    motion: Motion,
    throttle: f64,
    until_ns: f64,
    next: Option<(u64, i64)>,
    pub scale: i64,
    pub mtc: i64,
    mtc_off: bool,
    /// Counts of the MTC that inverters caused.
    pub ours: i64,
    /// Place of the MTC's signals in the cycle of four.
    out: u64,
    /// Number of times that both lines at the MTC changed at once.
    pub illegal: u64,
    pub edges: u64,
    /// Number of times that noise changed both lines at once.
    pub glitches: u64,
    /// Glitches that met an edge within one look.
    /// Such a pair shows one step the other way, as a reversal does.
    pub masked: Vec<Masked>,
    /// Number of glitches and edges at the last look.
    looked: (u64, u64),
    /// Time of the second look before the last edge, ns; the edge came after it.
    edge_since_ns: u64,
    /// Insertions begun: both inverters were equal, and one was ordered to change.
    pub begun: u64,
}

/// A glitch and an edge that one look shows as one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Masked {
    /// Most time to the edge before that the looks allow, ns.
    pub after_ns: u64,
    /// Number of edges within that look.
    pub edges: u64,
    /// Number of insertions begun before.
    pub begun: u64,
}

impl Place {
    fn inverters(&self, outputs: u64) -> u64 {
        outputs >> self.lines.invert_a & 1 | (outputs >> self.lines.invert_b & 1) << 1
    }

    fn half(&self, outputs: u64) -> bool {
        matches!(self.inverters(outputs), 1 | 2)
    }

    fn levels(&self) -> u64 {
        CYCLE[self.scale.rem_euclid(4) as usize]
    }

    /// Lets the MTC count, if it is on; `step` is the scale's motion.
    fn mtc_looks(&mut self, outputs: u64, step: i64) {
        let seen = self.levels() ^ self.inverters(outputs);
        let place = (0..4).find(|&p| CYCLE[p as usize] == seen).unwrap_or(0);
        if self.mtc_off {
            self.out = place;
            return;
        }
        match (place + 4 - self.out) % 4 {
            0 => {}
            1 => {
                self.mtc += 1;
                self.ours += 1 - step;
            }
            3 => {
                self.mtc -= 1;
                self.ours -= 1 + step;
            }
            _ => self.illegal += 1,
        }
        self.out = place;
    }

    /// Makes the next edge, if it comes before `t_ns`.
    fn look_ahead(&mut self, t_ns: u64, stop: bool, dice: &mut Dice) {
        while self.next.is_none() && self.motion.now_ns() < t_ns as f64 {
            if self.motion.now_ns() >= self.until_ns {
                self.throttle = dice.unit() * 2.0 - 1.0;
                self.until_ns = self.motion.now_ns() + 1e5 + dice.unit() * 6e7;
            }
            let v = self.motion.speed_counts_s();
            let braking = (-v / 20.0).clamp(-1.0, 1.0);
            self.next = self.motion.step(if stop { braking } else { self.throttle });
        }
    }
}

/// When the process dies at the next inversion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AtWrite {
    /// After the note, before the write.
    Before,
    /// After the write, which will be in effect.
    After,
}

#[allow(clippy::struct_excessive_bools)] // each is a switch of its own
pub(super) struct Machine {
    pub t_ns: u64,
    pub axes: [Place; 2],
    pub outputs: u64,
    flying: Option<(u64, u64)>,
    next_gap: Option<u64>,
    pub max_gap_ns: u64,
    dice: Dice,
    /// The axes brake to a stop.
    pub stop: bool,
    /// Delay of the next look, ns.
    pub late_ns: u64,
    pub die: Option<AtWrite>,
    pub write_fails: bool,
    pub disable_switch: bool,
    pub mtc_off: bool,
    pub looks: u64,
    /// Times of the two looks before, ns.
    looks_ns: [u64; 2],
    pub state_file: PathBuf,
    /// Content of the state file at the write before.
    pub state_before: Vec<u8>,
}

impl Machine {
    pub(super) fn new(
        seed: u64,
        lines: [AxisLines; 2],
        accel: f64,
        max_gap_ns: u64,
        state_file: PathBuf,
    ) -> Self {
        let place = |lines| Place {
            lines,
            motion: Motion::new(accel, 8000.0, 0.1),
            throttle: 0.0,
            until_ns: 0.0,
            next: None,
            scale: 0,
            mtc: 0,
            mtc_off: false,
            ours: 0,
            out: 0,
            illegal: 0,
            edges: 0,
            glitches: 0,
            masked: Vec::new(),
            looked: (0, 0),
            edge_since_ns: 0,
            begun: 0,
        };
        Self {
            t_ns: 10_000,
            axes: lines.map(place),
            outputs: 0,
            flying: None,
            next_gap: None,
            max_gap_ns,
            dice: Dice::new(seed),
            stop: true,
            late_ns: 0,
            die: None,
            write_fails: false,
            disable_switch: false,
            mtc_off: false,
            looks: 0,
            looks_ns: [0; 2],
            state_file,
            state_before: Vec::new(),
        }
    }

    /// Puts a pending write in effect.
    fn land(&mut self) {
        if let Some((_, outputs)) = self.flying.take() {
            self.outputs = outputs;
            self.axes.iter_mut().for_each(|a| a.mtc_looks(outputs, 0));
        }
    }

    pub(super) fn settled(&self, n: usize) -> bool {
        self.flying.is_none() && !self.axes[n].half(self.outputs)
    }

    /// Makes edges and writes up to this time, in true order.
    pub(super) fn run_to(&mut self, t_ns: u64) {
        loop {
            for place in &mut self.axes {
                place.look_ahead(t_ns, self.stop, &mut self.dice);
            }
            let due = |p: &Place| p.next.map_or(u64::MAX, |(at, _)| at);
            let n = usize::from(due(&self.axes[1]) < due(&self.axes[0]));
            let Some((at, step)) = self.axes[n].next.filter(|(at, _)| *at <= t_ns) else { break };
            if self.flying.is_some_and(|(w, _)| w <= at) {
                self.land();
            }
            let place = &mut self.axes[n];
            place.next = None;
            place.scale += step;
            place.edges += 1;
            place.mtc_looks(self.outputs, step);
        }
        if self.flying.is_some_and(|(w, _)| w <= t_ns) {
            self.land();
        }
        self.t_ns = t_ns;
    }

    /// Changes both lines of an axis at once, by noise that the MTC sees too.
    pub(super) fn glitch(&mut self, n: usize) {
        self.axes[n].scale += 2;
        self.axes[n].glitches += 1;
        self.axes[n].mtc_looks(self.outputs, 2);
        // It is undefined how the MTC counts two changes at once; here it counts none.
    }

    /// Switches the MTC off or on.
    /// Switched on, it counts from zero wherever the axes are.
    pub(super) fn switch_mtc(&mut self, off: bool) {
        self.mtc_off = off;
        for place in &mut self.axes {
            (place.mtc_off, place.mtc) = (off, 0);
        }
    }

    /// Cuts the power of the computer alone, and restores it.
    /// The outputs are low, and there is no state file. The MTC has continued to count.
    pub(super) fn lose_power(&mut self) {
        self.flying = None;
        self.outputs = 0;
        self.axes.iter_mut().for_each(|a| a.mtc_looks(0, 0));
        let _ = std::fs::remove_file(&self.state_file);
        self.state_before.clear();
    }

    /// Feed hold as the controller sees it; `None` while a write is pending.
    pub(super) fn hold(&self) -> Option<bool> {
        self.flying.is_none().then_some(self.outputs >> 28 & 1 == 1)
    }

    /// Switches all inverters off by hand, with the MTC off.
    /// The MTC is then switched on and counts from here.
    pub(super) fn inverters_off(&mut self) {
        self.outputs = 0;
        for place in &mut self.axes {
            place.out = place.scale.rem_euclid(4) as u64;
        }
    }

    fn gap_ns(&mut self) -> u64 {
        self.dice.within(20, self.max_gap_ns)
    }

    fn inputs(&self) -> u64 {
        let mut inputs = u64::from(self.disable_switch) << 29 | u64::from(!self.mtc_off) << 30;
        for place in &self.axes {
            let levels = place.levels();
            inputs |= (levels & 1) << place.lines.a | (levels >> 1) << place.lines.b;
        }
        inputs
    }
}

/// The card of one process.
#[derive(Clone)]
pub(super) struct Wires(pub Rc<RefCell<Machine>>);

impl Card for Wires {
    fn sample(&mut self, _wake_ns: u64) -> Result<CardInputSample, CardError> {
        let m = &mut *self.0.borrow_mut();
        let gap = m.next_gap.take().unwrap_or_else(|| m.gap_ns()) + std::mem::take(&mut m.late_ns);
        let t_ns = m.t_ns + gap;
        // The lines are read some time before the reported time.
        m.run_to(t_ns - gap.min(m.max_gap_ns) / 4);
        let inputs = m.inputs();
        m.t_ns = t_ns;
        m.looks += 1;
        for place in &mut m.axes {
            let now = (place.glitches, place.edges);
            if now.0 > place.looked.0 && now.1 > place.looked.1 {
                let (after_ns, edges) = (t_ns - place.edge_since_ns, now.1 - place.looked.1);
                place.masked.push(Masked { after_ns, edges, begun: place.begun });
            }
            if now != place.looked {
                place.edge_since_ns = m.looks_ns[0];
            }
            place.looked = now;
        }
        m.looks_ns = [m.looks_ns[1], t_ns];
        Ok(CardInputSample::level(t_ns, inputs))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let m = &mut *self.0.borrow_mut();
        if m.write_fails {
            return Err(CardError::Io { op: "writing the outputs", errno: 5 });
        }
        // The write of the hold line may follow a pending inversion.
        let ordered = m.flying.map_or(m.outputs, |(_, outputs)| outputs);
        let outputs = ordered & !mask | value & mask;
        for place in &mut m.axes {
            place.begun += u64::from(!place.half(ordered) && place.half(outputs));
        }
        let inverts = (ordered ^ outputs) & 0xF != 0;
        let die = m.die.filter(|_| inverts);
        if die == Some(AtWrite::Before) {
            std::panic::resume_unwind(Box::new(Killed));
        }
        if inverts && m.die.is_none() && m.dice.one_in(16) {
            m.state_before = std::fs::read(&m.state_file).unwrap_or_default();
        }
        let gap = m.next_gap.take().unwrap_or_else(|| m.gap_ns());
        // The read of the next look forces the write out before it.
        let delay = m.dice.within(1, gap - gap / 4);
        m.flying = Some((m.t_ns + delay, outputs));
        m.next_gap = Some(gap);
        if die == Some(AtWrite::After) {
            std::panic::resume_unwind(Box::new(Killed));
        }
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.0.borrow().outputs)
    }
}
