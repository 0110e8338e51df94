//! The far side of the card, which runs whether a daemon lives or not.
//! Two axes move by themselves. They have scales, XOR gates and an MTC that counts every change in true order.

use rtec_driver::card::{AxisLines, Card, CardError, Sample};
use std::cell::RefCell;
use std::path::PathBuf;
use std::rc::Rc;
use test_needs::dice::Dice;
use test_needs::motion::Motion;

/// What a process that is killed unwinds with.
pub(super) struct Killed;

/// The counts contract's cycle, positive direction: A and B at a count.
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
    /// Counts of the MTC that differ from the scale's through inverters: our own.
    pub ours: i64,
    /// What reaches the MTC: place in the cycle of four.
    out: u64,
    /// Both lines changed at once.
    pub illegal: u64,
    pub edges: u64,
    /// Times that both lines changed at once by noise.
    pub glitches: u64,
    /// Glitches that met an edge within one look.
    /// Such a pair shows one step the other way, as a reversal does.
    pub masked: Vec<Masked>,
    /// Glitches and edges at the last look.
    looked: (u64, u64),
    /// The look before the look before the last edge, ns: the edge came after it.
    edge_since_ns: u64,
    /// Insertions begun: the inverters, equal before, were ordered to differ.
    pub begun: u64,
}

/// A glitch and an edge that one look shows as one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Masked {
    /// The time to the edge before, at the most that the looks allow, ns.
    pub after_ns: u64,
    /// Edges within that look.
    pub edges: u64,
    /// Insertions begun before.
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

    /// The MTC counts, where it is on; `step` is what the scale has moved.
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
    /// Noted, not made.
    Before,
    /// Made, and it will be in effect.
    After,
}

#[allow(clippy::struct_excessive_bools)] // Each is a switch of its own.
pub(super) struct Machine {
    pub t_ns: u64,
    pub axes: [Place; 2],
    pub outputs: u64,
    flying: Option<(u64, u64)>,
    next_gap: Option<u64>,
    pub max_gap_ns: u64,
    dice: Dice,
    /// The axes brake.
    pub stop: bool,
    /// The next look is late by so much, ns.
    pub late_ns: u64,
    pub die: Option<AtWrite>,
    pub write_fails: bool,
    pub disable_switch: bool,
    pub mtc_off: bool,
    pub looks: u64,
    /// The two looks before, ns.
    looks_ns: [u64; 2],
    pub state_file: PathBuf,
    /// The state file as it was at the write before.
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

    /// An order that is on its way takes effect.
    fn land(&mut self) {
        if let Some((_, outputs)) = self.flying.take() {
            self.outputs = outputs;
            self.axes.iter_mut().for_each(|a| a.mtc_looks(outputs, 0));
        }
    }

    pub(super) fn settled(&self, n: usize) -> bool {
        self.flying.is_none() && !self.axes[n].half(self.outputs)
    }

    /// Edges and orders up to this time, in true order.
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

    /// Both lines of an axis change at once: noise, and the MTC sees it too.
    pub(super) fn glitch(&mut self, n: usize) {
        self.axes[n].scale += 2;
        self.axes[n].glitches += 1;
        self.axes[n].mtc_looks(self.outputs, 2);
        // What the MTC makes of two counts at once is anybody's guess; here it takes none.
    }

    /// Switches the MTC off or on.
    /// Switched on again, it counts from zero wherever the axes are.
    pub(super) fn switch_mtc(&mut self, off: bool) {
        self.mtc_off = off;
        for place in &mut self.axes {
            (place.mtc_off, place.mtc) = (off, 0);
        }
    }

    /// Mains failure of the computer alone, and it is back: outputs low, no state file.
    /// The MTC has gone on counting.
    pub(super) fn lose_power(&mut self) {
        self.flying = None;
        self.outputs = 0;
        self.axes.iter_mut().for_each(|a| a.mtc_looks(0, 0));
        let _ = std::fs::remove_file(&self.state_file);
        self.state_before.clear();
    }

    /// Feed hold as the controller sees it; none while an order is on its way.
    pub(super) fn hold(&self) -> Option<bool> {
        self.flying.is_none().then_some(self.outputs >> 28 & 1 == 1)
    }

    /// By hand, with the MTC off: all inverters off.
    /// It is switched on again and counts from here.
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
    fn sample(&mut self, _wake_ns: u64) -> Result<Sample, CardError> {
        let m = &mut *self.0.borrow_mut();
        let gap = m.next_gap.take().unwrap_or_else(|| m.gap_ns()) + std::mem::take(&mut m.late_ns);
        let t_ns = m.t_ns + gap;
        // The lines are read some time before the time is.
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
        Ok(Sample::level(t_ns, inputs))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let m = &mut *self.0.borrow_mut();
        if m.write_fails {
            return Err(CardError::Io { op: "writing the outputs", errno: 5 });
        }
        // The hold line may follow an inversion that is on its way.
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
        // The read of the next look pushes the write out before it.
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
