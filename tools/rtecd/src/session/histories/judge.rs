//! The world around the daemon, and the judge of what the daemon says.

use super::*;

/// The loop of the process that lives now, and who watches it.
pub(super) struct World {
    pub(super) base: Instant,
    pub(super) machine: Rc<RefCell<Machine>>,
    pub(super) turns: RefCell<Option<Turns<Wires>>>,
    pub(super) judge: RefCell<Judge>,
}

impl Time for World {
    fn now(&self) -> Instant {
        self.base + Duration::from_nanos(self.machine.borrow().t_ns)
    }

    fn now_s(&self) -> f64 {
        self.machine.borrow().t_ns as f64 * 1e-9
    }

    fn sleep(&self, duration: Duration) {
        self.run(duration.as_nanos() as u64);
    }
}

impl World {
    /// The machine moves, and the loop, where it lives, turns.
    pub(super) fn run(&self, ns: u64) {
        let until_ns = self.machine.borrow().t_ns + ns;
        let mut turns = self.turns.borrow_mut();
        while self.machine.borrow().t_ns < until_ns {
            let Some(alive) = turns.as_mut() else {
                let mut m = self.machine.borrow_mut();
                let t_ns = until_ns.min(m.t_ns + 100_000);
                m.run_to(t_ns);
                continue;
            };
            let before = (alive.engine().mode(), alive.engine().at_rest());
            let ended = alive.turn();
            self.judge.borrow_mut().look(before, alive.engine(), &self.machine.borrow());
            if let ControlFlow::Break(error) = ended
                && let Some(turns) = turns.take()
            {
                turns.end(error);
            }
        }
    }
}

/// Compares what the daemon says with what the MTC has counted.
pub(super) struct Judge {
    pub(super) seed: u64,
    /// Per axis, what to subtract from its counts: their values when the MTC was homed.
    pub(super) base: [[i64; 2]; 2],
    /// The MTC has been homed, and nothing has put its count in doubt since.
    pub(super) trusted: [bool; 2],
    /// What people have asked for since nothing was under way.
    pub(super) asked: Asked,
    /// At the last look: holder of feed hold, faults, corrections on.
    pub(super) held: bool,
    pub(super) latched: Vec<(Option<usize>, Fault)>,
    pub(super) enabled: bool,
    /// Looks since the process started, and since the MTC was switched off.
    pub(super) looks: u64,
    pub(super) off_looks: u64,
    /// Masked glitches, and insertions begun, when it was last homed.
    pub(super) masked: [(usize, u64); 2],
    /// Shortest time of a reversal over an edge, less that of the looks, ns.
    pub(super) turn_back_ns: u64,
    /// Counts lost through glitches that nobody could see, by reason.
    /// A glitch looked like an allowed reversal, came before any insertion, or was among several edges in a late
    /// look.
    pub(super) unseen: [u64; 3],
    /// A count was lost, and how many edges have come since: nobody knows of it yet.
    pub(super) lost: [Option<u64>; 2],
    pub(super) begun: u64,
    /// The control side is silent since then, ns.
    pub(super) silent_ns: Option<u64>,
    pub(super) turns: u64,
    pub(super) checks: u64,
    pub(super) digest: u64,
    pub(super) wrong: Vec<String>,
}

impl Judge {
    pub(super) fn look(&mut self, (before, at_rest): (Mode, bool), engine: &Engine, m: &Machine) {
        let begun = m.axes.iter().map(|a| a.begun).sum();
        if begun != self.begun {
            self.begun = begun;
            // A full-cycle design goes on with what it has begun.
            if at_rest && before != Mode::Run && engine.mode() != Mode::Run {
                self.wrong(&format!("an insertion began in {before:?}"), m);
            }
            let patience_ns = STALE_MS * 1_000_000 + 12_000_000;
            if self.silent_ns.is_some_and(|since| m.t_ns > since + patience_ns) {
                self.wrong("an insertion began, and the control side is silent", m);
            }
        }
        self.turns += 1;
        if self.turns.is_multiple_of(8) {
            self.keeps(engine, m);
        }
        if self.turns.is_multiple_of(64) {
            self.check(engine, m);
        }
    }

    /// Checks what no look and no restart may change by itself.
    /// That is feed hold, faults, corrections that are off, and an MTC that is off.
    pub(super) fn keeps(&mut self, engine: &Engine, m: &Machine) {
        self.looks += 1;
        let status = engine.status();
        let held = status.held.is_some();
        if self.held && !held && !self.asked.hold_off {
            self.wrong("feed hold ended by itself", m);
        }
        self.held = held;
        let own = status.faults.iter().map(|f| (None, f));
        let axes = status.axes().iter().enumerate();
        let latched: Vec<_> =
            own.chain(axes.flat_map(|(n, a)| a.faults.iter().map(move |f| (Some(n), f)))).collect();
        if let Some(gone) = self.latched.iter().find(|f| !latched.contains(f)).filter(|_| !self.asked.clear) {
            self.wrong(&format!("{gone:?} ended by itself"), m);
        }
        self.latched = latched;
        if status.enabled && !self.enabled && !self.asked.enable {
            self.wrong("corrections were enabled by nobody", m);
        }
        self.enabled = status.enabled;
        let wanted = held || !self.latched.is_empty();
        if self.looks > 2 && !m.write_fails && m.hold().is_some_and(|on| on != wanted) {
            self.wrong(&format!("feed hold on {} and wanted {wanted}", !wanted), m);
        }
        self.off_looks = if m.mtc_off { self.off_looks + 1 } else { 0 };
        let known = status.axes().iter().any(|a| a.homed || a.mtc_known);
        if self.off_looks > 1 && (known || status.enabled) {
            self.wrong("the MTC is off, and its count is taken as known", m);
        }
        for n in 0..2 {
            let (axis, place) = (&status.axes[n], &m.axes[n]);
            if m.mtc_off || axis.faults.iter().any(Fault::loses_home) {
                (self.trusted[n], self.lost[n]) = (false, None);
            }
            if self.asked.mtc_homed && axis.mtc_known && axis.in_effect == 0 && m.settled(n) {
                // The MTC is homed with us: what it has counted beyond the scale is what we say from here on.
                let offsets = [place.ours, place.mtc - place.scale];
                (self.base[n], self.trusted[n], self.lost[n]) = (offsets, true, None);
                self.masked[n] = (place.masked.len(), place.begun);
            }
        }
    }

    /// A process begins: nothing is enabled, and all else is as the one before left it.
    pub(super) fn begins(&mut self) {
        (self.enabled, self.looks, self.silent_ns) = (false, 0, None);
    }

    /// Nothing is left of the process before, and nobody can know what was.
    pub(super) fn forget(&mut self) {
        (self.trusted, self.held) = ([false; 2], false);
        self.latched.clear();
    }

    pub(super) fn check(&mut self, engine: &Engine, m: &Machine) {
        let status = engine.status();
        self.checks += 1;
        for n in 0..2 {
            let axis = &status.axes[n];
            let known = engine.in_effect(n).unwrap().1;
            // Before it is homed the axis knows what was inserted, not whether every edge was seen.
            let place = &m.axes[n];
            let offsets = [place.ours, place.mtc - place.scale];
            for part in [m.t_ns, m.axes[n].mtc as u64, known as u64, status.mode as u64] {
                self.digest = (self.digest ^ part).wrapping_mul(0x100_0000_01b3).rotate_left(17);
            }
            if !axis.mtc_known {
                (self.trusted[n], self.lost[n]) = (false, None);
            }
            if !self.trusted[n] || !m.settled(n) || !engine.at_rest() {
                continue;
            }
            let offset = offsets[usize::from(axis.homed)] - self.base[n][usize::from(axis.homed)];
            if offset == known {
                self.lost[n] = None;
                continue;
            }
            let since = *self.lost[n].get_or_insert(m.axes[n].edges);
            if m.axes[n].edges > since + 50 {
                self.trusted[n] = false;
                let (before, begun) = self.masked[n];
                let excuse = place.masked[before..].iter().find_map(|m| {
                    if m.begun == begun {
                        Some(1)
                    } else if m.edges > 1 {
                        Some(2)
                    } else {
                        (m.after_ns >= self.turn_back_ns).then_some(0)
                    }
                });
                if let Some(why) = excuse {
                    self.unseen[why] += 1;
                    continue;
                }
                let text = format!("axis {n}: the MTC has {offset} beyond the scale, and {known} is said");
                self.wrong(&text, m);
            }
        }
    }

    pub(super) fn wrong(&mut self, what: &str, m: &Machine) {
        self.wrong.push(format!("RTEC_SEED={} at {} ns: {what}", self.seed, m.t_ns));
    }
}

/// What people have asked for.
#[allow(clippy::struct_excessive_bools)] // Each is asked for without any other.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Asked {
    pub(super) hold_off: bool,
    pub(super) clear: bool,
    pub(super) enable: bool,
    /// The MTC has been homed, and that was said.
    pub(super) mtc_homed: bool,
}

/// Faults that the judge must find: of the corrector, or of whatever it stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Planted {
    /// A count more at the MTC than anybody has made.
    Count,
    /// A start that finds the state file of some insertions ago.
    OldFile,
    /// A loop that does not mind a silent control side.
    NeverStale,
    /// Homing that forgets what the MTC counts, though it has not been homed.
    HomeForgets,
    /// A start that finds no feed hold and no fault of the machine.
    HoldForgotten,
    /// A start that finds no state file.
    FileForgotten,
    /// Something enables corrections, and nobody asked for it.
    EnablesItself,
    /// A line that tells nothing of an MTC that restarts.
    DeafToMtc,
    /// Nobody looks whether the state file is still the one that is written.
    FileUnwatched,
}

impl Planted {
    pub(super) const ALL: [Self; 9] = [
        Self::Count,
        Self::OldFile,
        Self::NeverStale,
        Self::HomeForgets,
        Self::HoldForgotten,
        Self::FileForgotten,
        Self::EnablesItself,
        Self::DeafToMtc,
        Self::FileUnwatched,
    ];
}
