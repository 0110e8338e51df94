//! The world around the daemon, and the judge of the daemon's statements.

use super::*;

/// The loop of the present process, and the judge.
pub(super) struct World {
    pub(super) base: Instant,
    pub(super) machine: Rc<RefCell<Machine>>,
    pub(super) turns: RefCell<Option<SteppedLoop<Wires>>>,
    pub(super) judge: RefCell<Judge>,
}

impl ControlClock for World {
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
    /// Runs the machine, and the loop if there is one, for `ns`.
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

/// Compares the daemon's statements with the MTC's counts.
pub(super) struct Judge {
    pub(super) seed: u64,
    /// Values of each axis's two counts when the MTC was homed, to be subtracted.
    pub(super) base: [[i64; 2]; 2],
    /// The MTC has been homed, and nothing has put its count in doubt since.
    pub(super) trusted: [bool; 2],
    /// Requests of people since the ring of requests was last empty.
    pub(super) asked: Asked,
    /// At the last look: feed hold, faults, corrections on.
    pub(super) held: bool,
    pub(super) latched: Vec<(Option<usize>, Fault)>,
    pub(super) enabled: bool,
    /// Looks since the process started, and since the MTC was switched off.
    pub(super) looks: u64,
    pub(super) off_looks: u64,
    /// Number of masked glitches and of insertions at the last homing.
    pub(super) masked: [(usize, u64); 2],
    /// Shortest time of a reversal over an edge, without the looks' delays, ns.
    pub(super) turn_back_ns: u64,
    /// Counts lost through glitches that nobody could see, by reason.
    /// The glitch looked like an allowed reversal, came before any insertion, or was among several edges in a late
    /// look.
    pub(super) unseen: [u64; 3],
    /// Number of edges when a count was lost that nobody has noticed yet.
    pub(super) lost: [Option<u64>; 2],
    pub(super) begun: u64,
    /// Time since which the control side is silent, ns.
    pub(super) silent_ns: Option<u64>,
    pub(super) turns: u64,
    pub(super) checks: u64,
    pub(super) digest: u64,
    pub(super) wrong: Vec<String>,
}

impl Judge {
    pub(super) fn look(&mut self, (before, at_rest): (CorrectorMode, bool), engine: &Engine, m: &Machine) {
        let begun = m.axes.iter().map(|a| a.begun).sum();
        if begun != self.begun {
            self.begun = begun;
            // An insertion under way is finished in any mode.
            if at_rest && before != CorrectorMode::Run && engine.mode() != CorrectorMode::Run {
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

    /// Checks the state that no look and no restart may change by itself.
    /// It is feed hold, faults, corrections that are off, and an MTC that is off.
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
                // The MTC is homed with the axis. From here on the daemon must report what it counts beyond the scale.
                let offsets = [place.ours, place.mtc - place.scale];
                (self.base[n], self.trusted[n], self.lost[n]) = (offsets, true, None);
                self.masked[n] = (place.masked.len(), place.begun);
            }
        }
    }

    /// Begins a process: nothing is enabled, and all else is as the one before left it.
    pub(super) fn begins(&mut self) {
        (self.enabled, self.looks, self.silent_ns) = (false, 0, None);
    }

    /// Forgets the process before, whose state is lost.
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
            // Before homing the axis knows what was inserted, but not whether every edge was seen.
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

/// Requests of people.
#[allow(clippy::struct_excessive_bools)] // each is requested independently of the others
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Asked {
    pub(super) hold_off: bool,
    pub(super) clear: bool,
    pub(super) enable: bool,
    /// The MTC has been homed, and the daemon was told.
    pub(super) mtc_homed: bool,
}

/// Planted faults that the judge must find.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Planted {
    /// The MTC gets an extra count.
    Count,
    /// The start finds the state file of some insertions ago.
    OldFile,
    /// The loop ignores a silent control side.
    NeverStale,
    /// Homing forgets the MTC's count, although the MTC was not homed.
    HomeForgets,
    /// The start finds no feed hold and no fault of the machine.
    HoldForgotten,
    /// The start finds no state file.
    FileForgotten,
    /// Something enables corrections without a request.
    EnablesItself,
    /// The ready line does not show an MTC that restarts.
    DeafToMtc,
    /// Nobody checks the state file in use.
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
