//! All axes of one machine: looks at the card, lets each axis act, writes once.

use crate::axis::{
    AxisConfig, AxisEngine, AxisSample, InitialAxisState, InsertionPermit, InversionCommand,
    TotalRequestResult,
};
use crate::journal::{AxisStateRecord, HoldAndFaultsRecord, Journal};
use crate::latency_histogram::{Reader, Recorder, histogram};
use crate::link_messages::{
    AxisStatus, CorrectorMode, CorrectorStatus, DisableReason, Event, EventKind, Fault, FaultSet,
    FeedHoldSource, InsertionStatus, MAX_AXES, Refusal, RequestToRt,
};
use crate::state_file_watch::StateFileWatch;
use rtec_driver::card::{Card, CardError, CardFault, CardInputSample, MachineLines};

/// Configuration of the machine as a whole, fixed before the engine starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MachineConfig {
    /// The machine's own lines.
    pub lines: MachineLines,
    /// Corrections may be enabled.
    /// The card is a mock, or every real-time setting has been verified.
    pub may_arm: bool,
}

/// Why an engine cannot start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum StartError {
    /// The card could not be read.
    #[error(transparent)]
    Card(#[from] CardError),
    /// More axes than the engine holds, or none.
    #[error("found {0} axes, expected 1 to {MAX_AXES}")]
    Axes(usize),
    /// The axis's limits leave no time for an insertion.
    /// The limits are acceleration, hysteresis, separation and latency.
    #[error("axis {0}: no speed leaves time for an insertion; lower max_accel or the time it needs")]
    NoGate(usize),
    /// The inverters of an axis differ, but its total is not that of half an insertion.
    /// The total is odd in the middle of an insertion, and only there.
    #[error("axis {0}: its two inverters are not equal")]
    HalfInverted(usize),
}

/// Histograms of the loop's times; any thread may read them at any moment.
#[derive(Debug, Clone)]
pub struct LoopHistograms {
    /// Time between two looks, ns.
    /// On a card that sleeps it is the time from an edge to the look that shows it.
    pub poll_gap_ns: Reader,
    /// From the look that saw an edge to the look that ordered the last inversion, ns.
    pub edge_to_done_ns: Reader,
}

#[allow(clippy::struct_excessive_bools)] // each is one switch of the machine
/// The engine of all axes of one machine.
/// It is generic over the card at each look, and owns no thread, no file and no clock.
#[derive(Debug)]
pub struct Engine {
    axes: Box<[AxisEngine]>,
    machine: MachineConfig,
    watched: u64,
    inputs: u64,
    look_ns: u64,
    wake_ns: u64,
    polls: u64,
    events_lost: u64,
    enabled: bool,
    shadow: bool,
    probing: bool,
    off_because: DisableReason,
    held: Option<FeedHoldSource>,
    stale: bool,
    switch_off: bool,
    mtc_ready: bool,
    hold_without_mtc: bool,
    hold_out: Option<bool>,
    faults: FaultSet,
    mode: CorrectorMode,
    journal: Option<Journal>,
    /// What the mode allows every axis.
    permit: InsertionPermit,
    /// The mode must be computed again.
    /// It is set at the start, and after a fault that was found outside an axis's own look.
    mode_due: bool,
    /// Masks of the machine's own inputs; 0 where not wired.
    probe_mask: u64,
    disable_mask: u64,
    mtc_mask: u64,
    /// Mask of all of them together.
    own_mask: u64,
    /// A longer gap between two looks may have missed counts of some axis, ns.
    late_ns: u64,
    /// Times of the last late look and of the look before it, ns.
    /// A late look may have read its lines long before the time that it reports.
    late_look: (u64, u64),
    poll_gap_ns: Recorder,
    edge_to_done_ns: Recorder,
    timing: LoopHistograms,
}

impl Engine {
    /// Takes over a card as it is: inverters and feed hold.
    /// `completed` gives each axis's total as [`Engine::in_effect`] returned it (zero at a first start). Nothing is
    /// written, and corrections are off. The MTC is assumed to count what `completed` says, until
    /// [`Engine::lose_controller`] is called.
    /// An axis that was left between two inversions is latched as [`Fault::Interrupted`]; the second one follows from
    /// [`Engine::poll`].
    ///
    /// # Errors
    /// When the card cannot be read, or an axis cannot be corrected as configured.
    pub fn new<C: Card>(
        card: &mut C,
        axes: &[AxisConfig],
        machine: MachineConfig,
        completed: &[i64],
    ) -> Result<Self, StartError> {
        if axes.is_empty() || axes.len() > MAX_AXES {
            return Err(StartError::Axes(axes.len()));
        }
        let sample = card.sample(0)?;
        let outputs = card.outputs()?;
        let mut watched = 0;
        let mut all = Vec::with_capacity(axes.len());
        for (n, config) in axes.iter().enumerate() {
            let inverters = config.lines.inverters(outputs);
            let completed = completed.get(n).copied().unwrap_or(0);
            // Every insertion is an even number of counts: halfway through, and only there, the total is odd.
            if matches!(inverters, 1 | 2) != (completed % 2 != 0) {
                return Err(StartError::HalfInverted(n));
            }
            let scale = config.lines.scale(sample.inputs);
            let found = InitialAxisState { scale, inverters, completed, t_ns: sample.t_ns };
            all.push(AxisEngine::new(*config, found).ok_or(StartError::NoGate(n))?);
            watched |= config.lines.input_mask();
        }
        let lines = machine.lines;
        let mask = |bit: Option<u8>| bit.map_or(0, |b| 1_u64 << b);
        let [probe_mask, disable_mask, mtc_mask] = [lines.probe, lines.disable, lines.mtc_ready].map(mask);
        let own_mask = probe_mask | disable_mask | mtc_mask;
        watched |= own_mask;
        let (poll_gap_ns, gap_reader) = histogram();
        let (edge_to_done_ns, done_reader) = histogram();
        let late_ns = all.iter().map(AxisEngine::need_ns).min().unwrap_or(u64::MAX);
        let mut engine = Self {
            axes: all.into_boxed_slice(),
            machine,
            watched,
            inputs: sample.inputs,
            look_ns: sample.t_ns,
            wake_ns: 0,
            polls: 0,
            events_lost: 0,
            enabled: false,
            shadow: false,
            probing: false,
            off_because: DisableReason::Start,
            held: (outputs & mask(lines.hold) != 0).then_some(FeedHoldSource::FoundOn),
            stale: false,
            switch_off: sample.inputs & disable_mask != 0,
            mtc_ready: true,
            hold_without_mtc: false,
            hold_out: None,
            faults: FaultSet::NONE,
            mode: CorrectorMode::Disabled,
            journal: None,
            permit: InsertionPermit { insert: false, shadow: false },
            mode_due: true,
            probe_mask,
            disable_mask,
            mtc_mask,
            own_mask,
            late_ns,
            late_look: (0, 0),
            poll_gap_ns,
            edge_to_done_ns,
            timing: LoopHistograms { poll_gap_ns: gap_reader, edge_to_done_ns: done_reader },
        };
        engine.look_after_mtc(sample.inputs, &mut |_| true);
        Ok(engine)
    }

    /// Homes every axis at zero in its present place and enables corrections.
    /// Replays and simulations start this way.
    ///
    /// # Errors
    /// When the hold line cannot be written.
    pub fn start_homed<C: Card>(
        &mut self,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        self.start_homed_at(card, |_| 0, report)
    }

    /// Homes the axes at these positions, counts, and enables corrections.
    /// Otherwise it is [`Engine::start_homed`].
    ///
    /// # Errors
    /// When the card cannot be written.
    pub fn start_homed_at<C: Card>(
        &mut self,
        card: &mut C,
        position_counts: impl Fn(usize) -> i64,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        for n in 0..self.axes.len() {
            let (axis, position_counts) = (n as u8, position_counts(n));
            self.take(RequestToRt::Home { axis, position_counts, controller_homed: true }, card, report)?;
            self.take(RequestToRt::ConfirmHome { axis, position_counts }, card, report)?;
        }
        self.take(RequestToRt::Enable, card, report)
    }

    /// Starts to note every inversion in `journal` before it is made.
    /// Returns the watch over the journal's file.
    ///
    /// # Errors
    /// When a new file cannot be given its name ([`Journal::place`]).
    pub fn keep_journal(&mut self, journal: Journal) -> std::io::Result<Option<StateFileWatch>> {
        self.journal = Some(journal);
        self.note();
        let placed = |journal: &mut Journal| journal.place().and_then(|()| StateFileWatch::watch(journal));
        self.journal.as_mut().map(placed).transpose()
    }

    /// Notes the state in effect of every axis and of the machine.
    /// The file never shows feed hold without its reason: the fault of an axis is noted before the hold and removed
    /// after it.
    fn note(&mut self) {
        let hold_output = self.wants_hold();
        if !hold_output {
            self.note_machine(hold_output);
        }
        self.note_axes();
        if hold_output {
            self.note_machine(hold_output);
        }
    }

    fn note_machine(&mut self, hold_output: bool) {
        let (held, faults) = (self.held, self.faults);
        if let Some(journal) = &mut self.journal {
            journal.record_machine(HoldAndFaultsRecord { held, hold_output, faults }, self.look_ns);
        }
    }

    fn note_axes(&mut self) {
        if let Some(journal) = &mut self.journal {
            for (n, axis) in self.axes.iter().enumerate() {
                let (inverters, completed) = axis.in_effect();
                let (faults, mtc_known) = (axis.faults(), axis.mtc_known());
                journal.record(n, AxisStateRecord { inverters, completed, faults, mtc_known }, self.look_ns);
            }
        }
    }

    /// Marks the MTC's count of this axis as unknown.
    /// The MTC and the axis must then be homed.
    pub fn lose_controller(&mut self, axis: usize) {
        if let Some(axis) = self.axes.get_mut(axis) {
            axis.lose_controller();
        }
    }

    /// Takes over feed hold from the process before.
    /// It replaces the state found on the card.
    pub fn take_over_hold(&mut self, held: Option<FeedHoldSource>) {
        self.held = held.or(self.held.filter(|by| *by == FeedHoldSource::Controller));
    }

    /// Sets whether corrections may be enabled.
    /// The card must be a mock, or every real-time setting must have been verified.
    pub fn set_may_arm(&mut self, may_arm: bool) {
        self.machine.may_arm = may_arm;
    }

    /// Asserts feed hold whenever the MTC is off. It stays on afterwards.
    pub fn hold_without_mtc(&mut self) {
        self.hold_without_mtc = true;
        self.hold_for_mtc();
    }

    /// No axis has an insertion under way: its two inverters are equal.
    pub fn at_rest(&self) -> bool {
        self.axes.iter().all(AxisEngine::idle)
    }

    /// Latches every axis because the card has failed. Nothing more can be written.
    pub fn card_failed(&mut self, error: CardError, report: &mut impl FnMut(Event) -> bool) {
        if error != CardError::Ended {
            self.fail(Fault::Card, report);
        }
    }

    /// Ends the loop with this fault.
    /// Corrections are switched off, and the state for a restart is noted.
    fn fail(&mut self, fault: Fault, report: &mut impl FnMut(Event) -> bool) {
        if self.faults.latch(fault) {
            self.mode = CorrectorMode::Fault;
            self.switch_off(DisableReason::Fault);
            self.emit(None, EventKind::Fault(fault), report);
            self.note();
        }
    }

    /// Latches the fault of a panic in the loop and writes feed hold.
    /// Inverters stay as they are.
    pub fn panicked<C: Card>(&mut self, card: &mut C, report: &mut impl FnMut(Event) -> bool) {
        self.fail(Fault::ThreadLost, report);
        // If the card refuses this write too, nothing more can be done. The fault is latched already.
        let _ = self.write_hold(card);
    }

    /// Switches corrections off. Only [`RequestToRt::Enable`] switches them on again.
    fn switch_off(&mut self, because: DisableReason) {
        if self.enabled {
            (self.enabled, self.off_because) = (false, because);
        }
    }

    /// Histograms of the loop's times, readable at any time from any thread.
    pub fn timing(&self) -> LoopHistograms {
        self.timing.clone()
    }

    /// Looks at the card once and does everything that follows.
    /// A card that can wait does so until `by_ns` at the latest. `report` takes an event and returns whether it was
    /// kept.
    ///
    /// # Errors
    /// When the card fails; every axis is then latched, and the outputs stay as they are.
    #[inline]
    pub fn poll<C: Card>(
        &mut self,
        card: &mut C,
        by_ns: u64,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        let sample = card.sample(self.wake_ns.min(by_ns))?;
        let since_ns = std::mem::replace(&mut self.look_ns, sample.t_ns);
        self.polls += 1;
        // The first look follows the thread's set-up, so its gap is no latency.
        match sample.edge_ns {
            Some(edge_ns) if C::SLEEPS => self.poll_gap_ns.record(sample.t_ns.saturating_sub(edge_ns)),
            None if !C::SLEEPS && self.polls > 1 => {
                self.poll_gap_ns.record(sample.t_ns - since_ns + sample.waited_ns);
                if sample.t_ns - since_ns > self.late_ns {
                    self.check_late_look(sample.inputs, sample.complete, since_ns, report);
                }
            }
            _ => {}
        }
        if let Some(trouble) = sample.trouble {
            self.latch_trouble(trouble, report);
        }
        let changed = (sample.inputs ^ self.inputs) & self.watched;
        if sample.t_ns < self.wake_ns
            && sample.trouble.is_none()
            && (changed == 0 || self.count_regular_edges(&sample, changed, since_ns))
        {
            return Ok(());
        }
        let look = AxisSample::new(&sample, self.edge_since_ns(since_ns), self.permit);
        self.work(card, &look, changed, report)
    }

    /// Counts the edges of a look at which every changed axis has a regular edge.
    /// Nothing must be due. Returns `false` where more has to be checked. Edges already counted are not counted again.
    #[inline]
    fn count_regular_edges(&mut self, sample: &CardInputSample, changed: u64, since_ns: u64) -> bool {
        if changed & self.own_mask != 0 || self.mode_due {
            return false;
        }
        let look = AxisSample::new(sample, self.edge_since_ns(since_ns), self.permit);
        for axis in &mut self.axes {
            if changed & axis.input_mask() != 0 && !axis.count_regular_edge(&look) {
                return false;
            }
        }
        self.inputs = sample.inputs;
        true
    }

    /// Earliest time of an edge that this look shows, ns.
    /// It is the time of the look before, or of the one before that if the look before came late.
    #[inline]
    fn edge_since_ns(&self, since_ns: u64) -> u64 {
        if since_ns == self.late_look.0 { self.late_look.1 } else { since_ns }
    }

    /// Checks axes after a late look.
    /// An axis that was moving and shows no change may have moved by whole cycles.
    #[cold]
    fn check_late_look(
        &mut self,
        inputs: u64,
        complete: u64,
        since_ns: u64,
        report: &mut impl FnMut(Event) -> bool,
    ) {
        if complete == 0 {
            self.late_look = (self.look_ns, since_ns);
        }
        let changed = inputs ^ self.inputs;
        for n in 0..self.axes.len() {
            let axis = &mut self.axes[n];
            if changed & axis.input_mask() == 0
                && axis.may_have_missed_a_cycle(complete, since_ns, self.look_ns)
                && axis.latch(Fault::PollGap)
            {
                self.mode_due = true;
                self.emit(Some(n as u8), EventKind::Fault(Fault::PollGap), report);
                // The mode is computed again at this look.
                self.wake_ns = 0;
            }
        }
    }

    /// Latches the card's trouble for every axis concerned, or else for the machine.
    #[cold]
    fn latch_trouble(&mut self, trouble: CardFault, report: &mut impl FnMut(Event) -> bool) {
        let fault = Fault::from(trouble.kind);
        self.mode_due = true;
        let mut of_an_axis = false;
        for n in 0..self.axes.len() {
            if self.axes[n].input_mask() & trouble.lines != 0 {
                of_an_axis = true;
                if self.axes[n].latch(fault) {
                    self.emit(Some(n as u8), EventKind::Fault(fault), report);
                }
            }
        }
        if !of_an_axis && self.faults.latch(fault) {
            self.emit(None, EventKind::Fault(fault), report);
        }
    }

    /// Lets each axis act on what this look found, and writes their outputs together.
    /// It is not inlined, so that the values that nearly every look needs stay in registers.
    #[inline(never)]
    fn work<C: Card>(
        &mut self,
        card: &mut C,
        look: &AxisSample,
        changed: u64,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        let AxisSample { t_ns, inputs, .. } = *look;
        self.inputs = inputs;
        let lost = &mut self.events_lost;
        // No look clears a fault. A new one is reported.
        let mut new_fault = false;
        let mut emit = |axis, kind| {
            new_fault |= matches!(kind, EventKind::Fault(_));
            *lost += u64::from(!report(Event { t_ns, axis, kind }));
        };

        if changed & inputs & self.probe_mask != 0 {
            for (n, axis) in self.axes.iter_mut().enumerate() {
                if self.probing && !axis.trip(look.edge_ns()) {
                    emit(Some(n as u8), EventKind::Bounce);
                }
                axis.wake();
            }
        }
        // Output lines to toggle, and their levels.
        let (mut mask, mut value) = (0, 0);
        let mut wake_ns = u64::MAX;
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let moved = changed & axis.input_mask() != 0;
            if moved || t_ns >= axis.wake_ns() {
                let inversion = axis.look(look, moved, &mut |kind| emit(Some(n as u8), kind));
                if let Some(InversionCommand { inverter, edge_to_done_ns }) = inversion {
                    if let Some(ns) = edge_to_done_ns {
                        self.edge_to_done_ns.record(ns);
                    }
                    let (line, level) = axis.output(inverter);
                    mask |= line;
                    value |= level;
                }
            }
            wake_ns = wake_ns.min(axis.wake_ns());
        }
        self.wake_ns = wake_ns;
        if new_fault || self.mode_due || self.mode == CorrectorMode::Fault {
            self.note();
        } else if mask != 0 && !look.permit.shadow {
            self.note_axes();
        }
        if mask != 0 {
            let done_ns = if look.permit.shadow { Some(t_ns) } else { card.write(mask, value)? };
            // Where the card does not report it, the next look does.
            if let Some(done_ns) = done_ns {
                for axis in self.axes.iter_mut().filter(|a| a.output_mask() & mask != 0) {
                    axis.written(done_ns);
                    self.wake_ns = self.wake_ns.min(axis.wake_ns());
                }
            }
        }
        if changed & (self.disable_mask | self.mtc_mask) != 0 || new_fault || self.mode_due {
            self.switch_off = inputs & self.disable_mask != 0;
            self.look_after_mtc(inputs, report);
            self.update_mode(card, report)?;
        }
        Ok(())
    }

    /// Follows the MTC's ready line.
    /// Once the MTC was off, its count is unknown.
    fn look_after_mtc(&mut self, inputs: u64, report: &mut impl FnMut(Event) -> bool) {
        let ready = inputs & self.mtc_mask == self.mtc_mask;
        if ready == self.mtc_ready {
            return;
        }
        self.mtc_ready = ready;
        if !ready {
            self.axes.iter_mut().for_each(AxisEngine::lose_controller);
            self.switch_off(DisableReason::Controller);
            self.hold_for_mtc();
            self.note();
        }
        self.emit(None, EventKind::ControllerReady(ready), report);
    }

    fn hold_for_mtc(&mut self) {
        if self.hold_without_mtc && !self.mtc_ready {
            self.held.get_or_insert(FeedHoldSource::Controller);
        }
    }

    /// Computes the mode, and writes the hold line accordingly.
    fn update_mode<C: Card>(
        &mut self,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        let faulted = self.faults.any() || self.axes.iter().any(|a| a.faults().any());
        self.mode_due = false;
        // Corrections never come on again by themselves; somebody must enable them.
        if faulted {
            self.switch_off(DisableReason::Fault);
        }
        if self.switch_off {
            self.switch_off(DisableReason::Switch);
        }
        let mode = if faulted {
            CorrectorMode::Fault
        } else if self.held.is_some() {
            CorrectorMode::Hold
        } else if self.probing {
            CorrectorMode::Probe
        } else if self.switch_off || !self.enabled && !self.shadow {
            CorrectorMode::Disabled
        } else if self.shadow {
            CorrectorMode::Shadow
        } else {
            CorrectorMode::Run
        };
        self.write_hold(card)?;
        if mode != self.mode {
            self.mode = mode;
            self.emit(None, EventKind::Mode(mode), report);
            self.wake_all();
        }
        self.set_permit();
        Ok(())
    }

    /// A user or a fault asks for feed hold.
    fn wants_hold(&self) -> bool {
        self.held.is_some() || self.faults.any() || self.axes.iter().any(|a| a.faults().any())
    }

    fn write_hold<C: Card>(&mut self, card: &mut C) -> Result<(), CardError> {
        let hold = self.wants_hold();
        if self.hold_out != Some(hold) {
            if let Some(bit) = self.machine.lines.hold {
                card.write(1 << bit, u64::from(hold) << bit)?;
            }
            self.hold_out = Some(hold);
        }
        Ok(())
    }

    fn set_permit(&mut self) {
        let insert = matches!(self.mode, CorrectorMode::Run | CorrectorMode::Shadow) && !self.stale;
        self.permit = InsertionPermit { insert, shadow: self.shadow };
    }

    /// Wakes every axis, because a pending correction at rest has no edge to wake it.
    fn wake_all(&mut self) {
        self.wake_ns = 0;
        self.axes.iter_mut().for_each(AxisEngine::wake);
    }

    fn emit(&mut self, axis: Option<u8>, kind: EventKind, report: &mut impl FnMut(Event) -> bool) {
        self.events_lost += u64::from(!report(Event { t_ns: self.look_ns, axis, kind }));
    }

    /// Takes one request from the control side.
    ///
    /// # Errors
    /// When the hold line cannot be written.
    pub fn take<C: Card>(
        &mut self,
        request: RequestToRt,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        let (axis, total_counts) = match request {
            RequestToRt::Correct { axis, total_counts, .. } => (Some(axis), total_counts),
            RequestToRt::Home { axis, .. } | RequestToRt::ConfirmHome { axis, .. } => (Some(axis), 0),
            _ => (None, 0),
        };
        if let Err(why) = self.try_take(request, report) {
            self.emit(axis, EventKind::Refused { total_counts, why }, report);
        }
        let only_a_total = matches!(request, RequestToRt::Correct { .. }) && !self.mode_due;
        if !only_a_total {
            self.axes.iter_mut().for_each(AxisEngine::take_care);
            self.note();
        }
        self.wake_ns = self.axes.iter().map(AxisEngine::wake_ns).min().unwrap_or(0);
        // A total that latches no fault changes neither what is in effect nor the mode.
        if only_a_total { Ok(()) } else { self.update_mode(card, report) }
    }

    fn try_take(
        &mut self,
        request: RequestToRt,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), Refusal> {
        match request {
            RequestToRt::Correct { axis, total_counts, large } => {
                self.correct(axis, total_counts, large, report)?;
            }
            RequestToRt::Home { axis, position_counts, controller_homed } => {
                let a = self.axes.get_mut(usize::from(axis)).ok_or(Refusal::NoSuchAxis)?;
                if a.faults().any() {
                    return Err(Refusal::FaultLatched);
                }
                if !self.mtc_ready {
                    return Err(Refusal::ControllerNotReady);
                }
                if !controller_homed && !a.mtc_known() {
                    return Err(Refusal::ControllerUnknown);
                }
                if !a.idle() {
                    return Err(Refusal::Busy);
                }
                a.home(position_counts, controller_homed);
                self.emit(Some(axis), EventKind::HomeSet { position_counts }, report);
            }
            RequestToRt::ConfirmHome { axis, position_counts } => {
                let a = self.axes.get_mut(usize::from(axis)).ok_or(Refusal::NoSuchAxis)?;
                if !a.confirm_home(position_counts) {
                    return Err(Refusal::NotHomed);
                }
                let kept_counts = a.in_effect().1;
                self.emit(Some(axis), EventKind::Homed { kept_counts }, report);
            }
            RequestToRt::Enable | RequestToRt::Shadow => {
                let shadow = request == RequestToRt::Shadow;
                self.armable(shadow)?;
                if self.axes.iter().any(|a| !a.idle()) {
                    return Err(Refusal::Busy);
                }
                if shadow {
                    self.switch_off(DisableReason::Asked);
                }
                (self.enabled, self.shadow) = (!shadow, shadow);
                self.axes.iter_mut().for_each(|a| a.set_shadow(shadow));
            }
            RequestToRt::Disable => {
                if self.shadow && self.axes.iter().any(|a| !a.idle()) {
                    return Err(Refusal::Busy);
                }
                self.shadow = false;
                self.switch_off(DisableReason::Asked);
                self.axes.iter_mut().for_each(|a| a.set_shadow(false));
            }
            RequestToRt::Probe(on) => self.probing = on,
            // The first user who asked holds the machine.
            RequestToRt::Hold { on: true, by } => {
                self.held.get_or_insert(FeedHoldSource::User(by));
            }
            RequestToRt::Hold { on: false, .. } => self.held = None,
            RequestToRt::StateFileLost => {
                if let Some(journal) = &mut self.journal {
                    journal.note_again();
                }
                if self.faults.latch(Fault::StateFileLost) {
                    self.emit(None, EventKind::Fault(Fault::StateFileLost), report);
                }
            }
            RequestToRt::Clear => {
                self.faults = FaultSet::NONE;
                self.axes.iter_mut().for_each(AxisEngine::clear);
            }
        }
        Ok(())
    }

    /// Whether corrections may be enabled, or why not.
    /// That takes no fault, no disable switch, every axis homed, and on a real card a verified set-up.
    fn armable(&self, shadow: bool) -> Result<(), Refusal> {
        if self.mode == CorrectorMode::Fault {
            Err(Refusal::FaultLatched)
        } else if self.held.is_some() {
            // Otherwise corrections would come on by themselves when feed hold ends.
            Err(Refusal::Held)
        } else if self.probing {
            Err(Refusal::Probing)
        } else if self.switch_off {
            Err(Refusal::DisableSwitch)
        } else if !self.mtc_ready {
            Err(Refusal::ControllerNotReady)
        } else if self.axes.iter().any(|a| !a.homed()) {
            Err(Refusal::NotHomed)
        } else if !shadow && !self.machine.may_arm {
            Err(Refusal::NotArmable)
        } else {
            Ok(())
        }
    }

    fn correct(
        &mut self,
        axis: u8,
        total_counts: i64,
        large: bool,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), Refusal> {
        let a = self.axes.get_mut(usize::from(axis)).ok_or(Refusal::NoSuchAxis)?;
        if self.mode == CorrectorMode::Fault {
            return Err(Refusal::FaultLatched);
        }
        if !a.homed() {
            return Err(Refusal::NotHomed);
        }
        if self.probing {
            return Err(Refusal::Probing);
        }
        if self.held.is_some() {
            return Err(Refusal::Held);
        }
        if self.switch_off {
            return Err(Refusal::DisableSwitch);
        }
        if !self.enabled && !self.shadow {
            return Err(Refusal::Disabled);
        }
        match a.request(total_counts, large) {
            TotalRequestResult::Accepted => {}
            TotalRequestResult::AcceptedWithWarning => {
                self.emit(Some(axis), EventKind::Warning { total_counts }, report);
            }
            TotalRequestResult::Refused(why) => return Err(why),
            TotalRequestResult::Fault(fault) => {
                self.mode_due = true;
                if a.latch(fault) {
                    self.emit(Some(axis), EventKind::Fault(fault), report);
                }
            }
        }
        Ok(())
    }

    /// Sets whether the control side is silent (`stale`).
    /// It switches corrections off; its return does not enable them.
    pub fn set_control_stale(&mut self, stale: bool, report: &mut impl FnMut(Event) -> bool) {
        if stale != self.stale {
            self.stale = stale;
            self.emit(None, EventKind::ControlStale(stale), report);
            if stale {
                self.switch_off(DisableReason::ControlStale);
            }
            // No new insertion begins from here on; the next look computes the mode.
            self.set_permit();
            self.mode_due = true;
            self.wake_all();
        }
    }

    /// Latches a fault, of the machine or of one axis, that was found outside the loop.
    ///
    /// # Errors
    /// When the hold line cannot be written.
    pub fn latch<C: Card>(
        &mut self,
        axis: Option<u8>,
        fault: Fault,
        card: &mut C,
        report: &mut impl FnMut(Event) -> bool,
    ) -> Result<(), CardError> {
        let new = match axis.and_then(|n| self.axes.get_mut(usize::from(n))) {
            Some(a) => a.latch(fault),
            None => self.faults.latch(fault),
        };
        if new {
            self.emit(axis, EventKind::Fault(fault), report);
            self.note();
        }
        self.update_mode(card, report)
    }

    /// Time of the last look on the card's clock, ns.
    pub const fn now_ns(&self) -> u64 {
        self.look_ns
    }

    /// Mode of the engine.
    pub const fn mode(&self) -> CorrectorMode {
        self.mode
    }

    /// Real inverters of an axis and the total in the MTC's count, for a restart.
    /// Bit 0 is A, bit 1 is B. The total is odd halfway through an insertion.
    pub fn in_effect(&self, axis: usize) -> Option<(u8, i64)> {
        self.axes.get(axis).map(AxisEngine::in_effect)
    }

    /// Status of the whole corrector at this moment.
    pub fn status(&self) -> CorrectorStatus {
        let blocked = match self.mode {
            CorrectorMode::Run | CorrectorMode::Shadow | CorrectorMode::Disabled if self.stale => {
                Some(InsertionStatus::ControlStale)
            }
            CorrectorMode::Run | CorrectorMode::Shadow => None,
            CorrectorMode::Fault => Some(InsertionStatus::Fault),
            CorrectorMode::Disabled | CorrectorMode::Hold | CorrectorMode::Probe => {
                Some(InsertionStatus::Off)
            }
        };
        let mut axes = [AxisStatus::default(); MAX_AXES];
        for (status, axis) in axes.iter_mut().zip(&self.axes) {
            *status = axis.status(self.look_ns, blocked);
        }
        CorrectorStatus {
            t_ns: self.look_ns,
            mode: self.mode,
            control_stale: self.stale,
            disable_switch: self.switch_off,
            mtc_ready: self.mtc_ready,
            enabled: self.enabled,
            off_because: self.off_because,
            held: self.held,
            hold_output: self.hold_out == Some(true),
            polls: self.polls,
            events_lost: self.events_lost,
            faults: self.faults,
            axes_used: self.axes.len() as u8,
            axes,
        }
    }
}

#[cfg(test)]
mod tests;
