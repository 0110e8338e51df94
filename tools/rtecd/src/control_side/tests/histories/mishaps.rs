//! Events around a running daemon: sensors, failures, people.

use super::*;

impl Life {
    /// Damages the newest record of an axis, as a store that was cut short does.
    pub(super) fn tear(&mut self) {
        const WORD: usize = 8;
        const PAGE: usize = 4096;
        // The head has eight words. Each axis has two slots of four words: sequence number, inverters, completed, sum.
        let slot = |axis: usize, n: usize| (8 + axis * 8 + n * 4) * WORD;
        let m = self.world.machine.borrow();
        let Ok(mut bytes) = fs::read(&m.state_file) else { return };
        let sequence = |bytes: &[u8], at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        // A record that disagrees with the present inverters was just being noted.
        for (axis, lines) in self.lines.iter().enumerate() {
            let newest = usize::from(sequence(&bytes, slot(axis, 1)) > sequence(&bytes, slot(axis, 0)));
            let at = slot(axis, newest);
            if bytes[at + WORD] & 3 == lines.inverters(m.outputs) {
                continue;
            }
            match self.dice.within(0, 3) {
                // The first copy is cut short. The second copy has a record older than that of the other slot.
                0 => {
                    bytes[at + 3 * WORD..at + 4 * WORD].fill(0);
                    let old = m.state_before.get(PAGE + at..PAGE + at + 32);
                    if let Some(old) = old.filter(|old| old.iter().any(|byte| *byte != 0)) {
                        bytes[PAGE + at..PAGE + at + 32].copy_from_slice(old);
                    }
                }
                1 => bytes[PAGE + at + 3 * WORD..PAGE + at + 4 * WORD].fill(0),
                2 => bytes[PAGE + at..PAGE + at + 32].fill(0),
                _ => bytes[at..at + 32].fill(0),
            }
        }
        fs::write(&m.state_file, bytes).unwrap();
    }

    /// Kills the process now, or at the next inversion.
    pub(super) fn die(&mut self) -> bool {
        let when = [None, Some(AtWrite::Before), Some(AtWrite::After)][self.dice.within(0, 2) as usize];
        // If no inversion comes, the process dies between two looks.
        self.kill_ns = Some(self.now_ns() + 80_000_000);
        let waited = self.world.machine.borrow().die.is_some();
        self.world.machine.borrow_mut().die = when.filter(|_| !waited);
        when.is_none() || waited
    }

    pub(super) fn sense(&mut self, session: &mut ControlSide) {
        for degc in &mut self.heat {
            *degc += 0.02 * self.dice.normal();
        }
        let t_s = self.now_ns() as f64 * 1e-9;
        for (watch, degc) in session.sensors.look().iter_mut().zip(&self.heat[..self.speaks]) {
            watch.offer(t_s, Ok(*degc));
        }
    }

    pub(super) fn mishaps(&mut self) {
        let before = self.shown();
        self.mishap();
        if self.shown() != before {
            self.tell(&self.shown());
        }
    }

    /// Removes the state file, or puts an older one in its place.
    /// The daemon notices before it dies.
    pub(super) fn lose_state_file(
        &mut self,
        session: &mut ControlSide,
        control: &mut ControlEnd,
        tally: &mut Tally,
    ) {
        let rarely = if self.planted == Some(Planted::FileUnwatched) { 10 } else { 150 };
        if !self.dice.one_in(rarely) || self.world.machine.borrow().die.is_some() {
            return;
        }
        {
            let m = self.world.machine.borrow();
            if self.dice.one_in(2) && !m.state_before.is_empty() {
                fs::write(&m.state_file, &m.state_before).unwrap();
            } else {
                let _ = fs::remove_file(&m.state_file);
            }
        }
        self.tell("the state file is lost");
        tally.lost_files += 1;
        session.look_after_state_file(control);
    }

    /// The state of the failures, as text.
    pub(super) fn shown(&self) -> String {
        let m = self.world.machine.borrow();
        format!(
            "late by {} ns, glitches {:?}, writes fail: {}, switch: {}, MTC off: {}, sensors {}",
            m.late_ns,
            [0, 1].map(|n| m.axes[n].glitches),
            m.write_fails,
            m.disable_switch,
            m.mtc_off,
            self.speaks
        )
    }

    pub(super) fn mishap(&mut self) {
        let dice = &mut self.dice;
        let mut m = self.world.machine.borrow_mut();
        if dice.one_in(60) {
            m.late_ns = dice.within(20_000, 8_000_000);
        }
        if dice.one_in(400) {
            m.glitch(dice.within(0, 1) as usize);
        }
        if self.planted == Some(Planted::Count) && dice.one_in(50) {
            m.axes[0].mtc += 2;
        }
        if dice.one_in(600) {
            m.write_fails = true;
        }
        if dice.one_in(if m.disable_switch { 4 } else { 60 }) {
            m.disable_switch ^= true;
        }
        if dice.one_in(if m.mtc_off { 3 } else { 250 }) {
            let off = !m.mtc_off;
            m.switch_mtc(off);
            self.mtc_restarts += u64::from(off);
            if self.planted == Some(Planted::DeafToMtc) {
                m.switch_mtc(false);
            }
        }
        if dice.one_in(40) {
            self.speaks = dice.within(0, 2) as usize;
        }
        if dice.one_in(100) {
            self.heat[0] += 5.0;
        }
        if dice.one_in(100) {
            DAY.set(DAY.get() + dice.within(0, 8000) as i64 - 4000);
        }
    }

    pub(super) fn ask(
        &mut self,
        session: &mut ControlSide,
        request: &ClientRequest,
        control: &mut ControlEnd,
        tally: &mut Tally,
    ) {
        tally.requests += 1;
        let lies = self.planted == Some(Planted::HomeForgets) && self.dice.one_in(2);
        {
            let mut judge = self.world.judge.borrow_mut();
            match request {
                ClientRequest::Hold { on: false } => judge.asked.hold_off = true,
                ClientRequest::Clear {} => judge.asked.clear = true,
                ClientRequest::Enable { .. } => judge.asked.enable = true,
                ClientRequest::Home { controller_homed: Some(true), .. } => judge.asked.mtc_homed = !lies,
                _ => {}
            }
        }
        let kept = matches!(request, ClientRequest::Home { controller_homed: Some(false), .. });
        let in_effect = control.status().axes().iter().any(|a| a.in_effect != 0);
        for _ in 0..20 {
            self.tell(&format!("{request:?}"));
            match session.answer(request, RequestContext::default(), control) {
                RequestOutcome::Again(_) => self.world.run(2_000_000),
                RequestOutcome::Now(response) => {
                    let no = matches!(
                        response,
                        DaemonResponse::Refused { .. }
                            | DaemonResponse::Fault { .. }
                            | DaemonResponse::Bad { .. }
                    );
                    tally.refused += u64::from(no);
                    tally.kept_totals += u64::from(!no && kept && in_effect);
                    return;
                }
                RequestOutcome::Later(_) => unreachable!("nothing is loaded by request here"),
            }
        }
    }

    pub(super) fn people(&mut self, session: &mut ControlSide, control: &mut ControlEnd, tally: &mut Tally) {
        use ClientRequest as R;
        let status = control.status();
        let wants_arming = matches!(status.mode, CorrectorMode::Disabled | CorrectorMode::Fault);
        if wants_arming && self.dice.one_in(3) {
            // The machine is stopped, cleared, homed and enabled again.
            self.world.machine.borrow_mut().stop = true;
            for _ in 0..100 {
                control.beat();
                session.drain(control);
                self.world.run(5_000_000);
                if control.status().axes().iter().all(|a| a.edge_rate_hz < 1.0) {
                    break;
                }
            }
            let controller_homed = self.controller_homed();
            let home = R::Home { axis: None, controller_homed };
            for request in [R::Clear {}, R::Hold { on: false }, home, R::Enable { accept_jump: true }] {
                self.ask(session, &request, control, tally);
            }
            self.world.machine.borrow_mut().stop = false;
            return;
        }
        if self.dice.one_in(3) {
            return;
        }
        let axis = ["x", "y"][self.dice.within(0, 1) as usize].to_owned();
        let total_counts = self.dice.within(0, 120) as i64 - 60;
        let times = if self.dice.one_in(40) { 120 } else { 1 };
        let on = self.dice.one_in(3);
        let request = match self.dice.within(0, 30) {
            0 => R::Disable {},
            1 => R::Hold { on },
            2 => R::Probe { on },
            3 => R::Shadow {},
            4 => R::Home { axis: Some(axis), controller_homed: self.controller_homed() },
            5 => R::Clear {},
            6..10 => R::Enable { accept_jump: on },
            10 => R::Status {},
            11..14 => return self.model(session),
            14 => {
                let mut m = self.world.machine.borrow_mut();
                m.stop ^= true;
                return;
            }
            15..18 => R::Hold { on: false },
            18..20 => R::Probe { on: false },
            _ => R::Correct { axis, total_counts, large: on },
        };
        // As in the server, each connection has a role.
        let role = Caller::ALL[self.dice.within(0, 8).min(2) as usize];
        if request.needs() > role {
            tally.refused += 1;
            return;
        }
        for _ in 0..times {
            self.ask(session, &request, control, tally);
        }
        if self.dice.one_in(12) {
            // The process is stopped with a request pending, and there is no sign of life.
            let axis = ["x", "y"][self.dice.within(0, 1) as usize].to_owned();
            let total_counts = self.dice.within(0, 120) as i64 - 60;
            self.ask(session, &R::Correct { axis, total_counts, large: true }, control, tally);
            let (now_ns, ns) = (self.now_ns(), self.dice.within(1, 300) * 1_000_000);
            self.world.judge.borrow_mut().silent_ns = Some(now_ns);
            self.world.run(ns);
            self.world.judge.borrow_mut().silent_ns = None;
        }
    }

    /// Statements of people on the MTC when they home.
    pub(super) fn controller_homed(&mut self) -> Option<bool> {
        [Some(true), Some(true), Some(false), None][self.dice.within(0, 3) as usize]
    }

    /// Makes the next start find no feed hold, neither in the file nor on the line.
    pub(super) fn forget_hold(&mut self) {
        let mut m = self.world.machine.borrow_mut();
        m.outputs &= !(1 << 28);
        if m.state_file.exists() {
            // A damaged record would be noticed, so a valid one is written.
            let (mut journal, _) = Journal::open(&m.state_file, &self.config.identity()).unwrap();
            journal.record_machine(
                HoldAndFaultsRecord { held: None, hold_output: false, faults: FaultSet::NONE },
                0,
            );
        }
    }

    pub(super) fn model(&mut self, session: &mut ControlSide) {
        if self.dice.one_in(3) {
            session.corrector.unload();
            return;
        }
        let machine = Model::parse(Path::new("machine.toml"), MODEL).unwrap();
        // The model may be refused because a sensor is silent.
        let _ = session.corrector.load(machine, &|_| Vec::new());
    }
}
