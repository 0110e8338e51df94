//! Requests to the real-time thread, and its answers.

use super::{ControlSide, model_and_table_loads};
use rtec_control::config::ConfiguredAxis;
use rtec_control::protocol::{
    DaemonResponse, EnableJump, explain_fault, explain_not_homed, explain_refusal, explain_unknown, word,
};
use rtec_rt::axis::INCREMENT_COUNTS;
use rtec_rt::link::{ControlEnd, REQUESTS};
use rtec_rt::link_messages::{
    AxisStatus, CorrectorMode, CorrectorStatus, Event, EventKind, Refusal, RequestToRt,
};
use std::time::Duration;

/// Edge rate below which an axis counts as at rest, Hz.
/// It then moves by less than half a count in the milliseconds between setting its counter and reading it back.
const STANDSTILL_HZ: f64 = 50.0;

/// The events of a request, or its refusal.
type EventsOrRefusal = Result<Vec<Event>, DaemonResponse>;

/// What to do when the real-time thread has ended.
pub(super) const ENDED: &str = "the real-time thread has ended: see the log, then restart the daemon";

impl ControlSide {
    /// Sends a request and waits until it is completed.
    /// Returns the events of the meantime.
    pub(super) fn send(&mut self, request: RequestToRt, control: &mut ControlEnd) -> EventsOrRefusal {
        let silent =
            "the real-time thread does not answer: see `rtecctl platform` for what else runs on its CPU";
        // No look since a request was last left unanswered, so this one is not waited for.
        let stuck = self.unanswered == Some(control.status().polls);
        let deadline = self.time.now() + self.patience;
        // Waits for the corrector's requests, so that their events do not answer this one.
        let waits = |now| !stuck && now < deadline;
        while (1..REQUESTS).contains(&control.pending()) && waits(self.time.now()) && !control.ended() {
            control.beat();
            self.time.sleep(Duration::from_micros(200));
        }
        self.drain(control);
        control.send(request).map_err(|full| DaemonResponse::refused("ring_full", full.to_string()))?;
        if stuck {
            // It takes the request when it looks again.
            return Err(DaemonResponse::refused("no_answer", silent));
        }
        self.unanswered = None;
        let mut events = Vec::new();
        // The request is taken when the ring is empty. It is completed when a later status is newer than the one at
        // that time. Its events come before that status.
        let mut taken_at = None;
        loop {
            control.beat();
            let status = control.status();
            let worked = taken_at.is_some_and(|polls| polls != status.polls);
            if taken_at.is_none() && control.pending() == 0 {
                taken_at = Some(control.status().polls);
            }
            while let Some(event) = control.event() {
                self.note(&event);
                events.push(event);
            }
            if worked {
                return Ok(events);
            }
            if control.ended() {
                return Err(DaemonResponse::refused("ended", ENDED));
            }
            if self.time.now() > deadline {
                self.unanswered = Some(status.polls);
                return Err(DaemonResponse::refused("no_answer", silent));
            }
            self.time.sleep(Duration::from_micros(200));
        }
    }

    /// Sends a request and makes an answer from the events.
    pub(super) fn carry_out(&mut self, request: RequestToRt, control: &mut ControlEnd) -> EventsOrRefusal {
        let events = self.send(request, control)?;
        for event in &events {
            let text = match event.kind {
                EventKind::Refused { why: why @ Refusal::FaultLatched, .. } => {
                    explain_refusal(why).to_owned()
                }
                EventKind::Refused { why, .. } => return Err(self.refused(why, request, &control.status())),
                EventKind::Fault(fault) => format!("{}: {}", word(fault), explain_fault(fault)),
                _ => continue,
            };
            return Err(DaemonResponse::Fault { text });
        }
        Ok(events)
    }

    /// A refusal with its axis and figures.
    fn refused(&self, why: Refusal, request: RequestToRt, status: &CorrectorStatus) -> DaemonResponse {
        let axis = match request {
            RequestToRt::Correct { axis, .. }
            | RequestToRt::Home { axis, .. }
            | RequestToRt::ConfirmHome { axis, .. } => {
                self.config.axes.get(usize::from(axis)).zip(status.axes().get(usize::from(axis)))
            }
            _ => None,
        };
        let known = axis.is_some_and(|(_, now)| now.mtc_known);
        if let (Refusal::NotHomed, Some(text)) = (why, self.unknown(status).filter(|_| !known)) {
            return DaemonResponse::refused(word(why), text);
        }
        let about = match (why, request, axis) {
            (Refusal::NotBelieved, RequestToRt::Correct { total_counts, .. }, Some((axis, now))) => {
                let window = axis.engine.window_counts;
                format!("{}, window {window}", asked(axis, total_counts, now.requested))
            }
            (Refusal::AboveMaximum, RequestToRt::Correct { total_counts, .. }, Some((axis, now))) => {
                let max = axis.engine.max_correction_counts;
                format!("{}, at most {max} either way", asked(axis, total_counts, now.requested))
            }
            (_, _, Some((axis, _))) => format!("axis {}", axis.name),
            (Refusal::NotHomed, ..) => {
                let text = explain_not_homed(&self.not_homed(status));
                return DaemonResponse::refused(word(why), text);
            }
            _ => return refused(why),
        };
        let text = format!("{about}: {}", explain_refusal(why));
        DaemonResponse::refused(word(why), text)
    }

    /// The axes with an unknown count of the controller, and a remedy.
    pub(super) fn unknown(&self, status: &CorrectorStatus) -> Option<String> {
        let all = self.config.axes.iter().zip(status.axes());
        let unknown: Vec<&str> = all.filter(|(_, s)| !s.mtc_known).map(|(a, _)| a.name.as_str()).collect();
        (!unknown.is_empty()).then(|| explain_unknown(&unknown))
    }

    /// The axes that are not homed.
    pub(super) fn not_homed(&self, status: &CorrectorStatus) -> Vec<&str> {
        let all = self.config.axes.iter().zip(status.axes());
        all.filter(|(_, now)| !now.homed).map(|(axis, _)| axis.name.as_str()).collect()
    }

    pub(super) fn number(&self, axis: &str) -> Result<usize, DaemonResponse> {
        self.config.axis(axis).ok_or_else(|| {
            let names: Vec<&str> = self.config.axes.iter().map(|a| a.name.as_str()).collect();
            let mut text = format!("found axis {axis:?}, expected one of {}", names.join(", "));
            if let Some(near) = self.config.nearest_axis(axis) {
                text = format!("{text}; did you mean {near}?");
            }
            DaemonResponse::Bad { text }
        })
    }

    /// Requests the operator's total, beside those of the other sources.
    pub(super) fn correct(
        &mut self,
        axis: &str,
        operator_counts: i64,
        large: bool,
        control: &mut ControlEnd,
    ) -> Result<DaemonResponse, DaemonResponse> {
        let n = self.number(axis)?;
        let total_counts = self.corrector.with_operator(n, operator_counts);
        let others_counts = total_counts - operator_counts;
        let before = control.status().axes[n].requested;
        let request = RequestToRt::Correct { axis: n as u8, total_counts, large };
        let events = self.carry_out(request, control).map_err(|refusal| match refusal {
            // The refused total includes the other sources, so the text names it.
            DaemonResponse::Refused { why, text, jumps } if others_counts != 0 => {
                let text =
                    format!("{text} (asked {operator_counts:+}, model and part table {others_counts:+})");
                DaemonResponse::Refused { why, text, jumps }
            }
            other => other,
        })?;
        self.corrector.operator_is(n, operator_counts);
        let config = &self.config.axes[n];
        let warnings = events.iter().filter_map(|event| match event.kind {
            // The corrector's own requests differ in their total.
            EventKind::Warning { total_counts: of } if event.axis == Some(n as u8) && of == total_counts => {
                Some(format!(
                    "{}, warning from {} on (warn_counts): it is carried out; check that so much is meant",
                    asked(config, of, before),
                    config.engine.warn_counts
                ))
            }
            _ => None,
        });
        let warnings =
            warnings.take(1).chain(leftover_note(config, total_counts, control.status().axes[n].in_effect));
        Ok(DaemonResponse::done_with(warnings.collect()))
    }

    /// Jogs a simulated axis or lets it go on.
    /// Reports what display and indicator show.
    pub(super) fn jog(
        &self,
        axis: &str,
        display_mm: Option<f64>,
        go_on: bool,
    ) -> Result<DaemonResponse, DaemonResponse> {
        let n = self.number(axis)?;
        let Some(stand) = &self.simulated_operator else {
            let text = "only a simulated machine can be jogged from here";
            return Err(DaemonResponse::refused("not_simulated", text));
        };
        if let Some(mm) = display_mm {
            let travel_mm = self.config.axes[n].travel_mm;
            if mm.abs() > travel_mm {
                let text = format!("found {mm} mm, expected a place within the travel of {travel_mm} mm");
                return Err(DaemonResponse::Bad { text });
            }
            stand.jog_to(n, mm);
        }
        if go_on {
            stand.go_on(n);
        }
        let (display_mm, indicator_mm) = stand.read_mm(n);
        Ok(DaemonResponse::Stands { display_mm, indicator_mm })
    }

    /// Homes one axis or all.
    /// It sets the counter and reads it back, and only the expected value completes the homing.
    pub(super) fn home(
        &mut self,
        axis: Option<&str>,
        controller_homed: Option<bool>,
        control: &mut ControlEnd,
    ) -> Result<DaemonResponse, DaemonResponse> {
        let axes = match axis {
            Some(name) => {
                let n = self.number(name)?;
                n..n + 1
            }
            None => 0..self.config.axes.len(),
        };
        let status = control.status();
        for n in axes.clone() {
            let (name, rate_hz) = (&self.config.axes[n].name, status.axes[n].edge_rate_hz);
            if rate_hz > STANDSTILL_HZ {
                let text = format!(
                    "axis {name} moves at {rate_hz:.0} edges/s: its counter would be set somewhere on the way. Home it at \
                     a standstill, at its known place"
                );
                return Err(DaemonResponse::refused("moving", text));
            }
        }
        if let Some(refusal) = self.still_counted(axes.clone(), controller_homed, &status) {
            return Err(refusal);
        }
        let controller_homed = controller_homed == Some(true);
        for n in axes {
            let (axis, position_counts) = (n as u8, self.config.axes[n].home_counts);
            let request = RequestToRt::Home { axis, position_counts, controller_homed };
            let events = self.carry_out(request, control)?;
            let read_back = events.iter().find_map(|e| match e.kind {
                EventKind::HomeSet { position_counts } if e.axis == Some(axis) => Some(position_counts),
                _ => None,
            });
            if read_back != Some(position_counts) {
                let found = format!("axis {}: read back {read_back:?}", self.config.axes[n].name);
                let text = format!("{found}, expected {position_counts} counts: not homed");
                return Err(DaemonResponse::refused("home_read_back", text));
            }
            self.carry_out(RequestToRt::ConfirmHome { axis, position_counts }, control)?;
        }
        Ok(DaemonResponse::done())
    }

    /// Refusal to home these axes, if the MTC may still have counts in effect.
    /// A count that is part of its position must not be forgotten.
    fn still_counted(
        &self,
        axes: std::ops::Range<usize>,
        controller_homed: Option<bool>,
        status: &CorrectorStatus,
    ) -> Option<DaemonResponse> {
        if controller_homed == Some(true) || status.mode == CorrectorMode::Fault {
            return None;
        }
        let all = || axes.clone().map(|n| (&self.config.axes[n], &status.axes[n]));
        let names = |which: &dyn Fn(&AxisStatus) -> bool| {
            let names = all().filter(|(_, s)| which(s)).map(|(a, _)| a.name.as_str());
            names.collect::<Vec<_>>().join(", ")
        };
        let unknown = names(&|s| !s.mtc_known);
        if !unknown.is_empty() {
            let text = format!("axis {unknown}: {}", explain_refusal(Refusal::ControllerUnknown));
            return Some(DaemonResponse::refused(word(Refusal::ControllerUnknown), text));
        }
        if controller_homed.is_some() || all().all(|(_, s)| s.in_effect == 0) {
            return None;
        }
        let counted = all().filter(|(_, s)| s.in_effect != 0);
        let counted = counted.map(|(a, s)| {
            format!("axis {}: {:+} counts, {:+.3} µm", a.name, s.in_effect, s.in_effect as f64 * a.count_um)
        });
        let text = format!(
            "{}: still in the controller's count. If it has been homed too, `rtecctl home --controller-homed`; if not, \
             `rtecctl home --controller-not-homed` keeps them",
            counted.collect::<Vec<_>>().join("; ")
        );
        Some(DaemonResponse::refused("still_counted", text))
    }

    /// The counts that enabling would insert, axis by axis.
    pub(super) fn jumps(&self, status: &CorrectorStatus) -> Vec<EnableJump> {
        let all = self.config.axes.iter().zip(status.axes()).enumerate();
        let all = all.map(|(n, (axis, s))| (axis, self.corrector.goal(n, s) - s.in_effect));
        let jump = |(axis, counts): (&ConfiguredAxis, i64)| {
            let (um, window_counts) = (counts as f64 * axis.count_um, axis.engine.window_counts);
            EnableJump { axis: axis.name.clone(), counts, um, window_counts }
        };
        all.filter(|(_, counts)| *counts != 0).map(jump).collect()
    }

    /// Why corrections must not be enabled, as far as this side knows.
    pub(super) fn forbidden(
        &self,
        status: &CorrectorStatus,
        jumps: &[EnableJump],
        accept_jump: bool,
    ) -> Option<DaemonResponse> {
        match status.mode {
            CorrectorMode::Probe => return Some(refused(Refusal::Probing)),
            CorrectorMode::Hold => return Some(refused(Refusal::Held)),
            CorrectorMode::Run | CorrectorMode::Shadow | CorrectorMode::Fault | CorrectorMode::Disabled => {}
        }
        if !self.unfit.is_empty() {
            let (why, text) = (word(Refusal::NotArmable), self.unfit.join("; "));
            return Some(DaemonResponse::refused(why, text));
        }
        let ended = self.corrector.expired();
        if !ended.is_empty() {
            let text = format!("{}: {}", ended.join("; "), model_and_table_loads::LOOK_AGAIN);
            return Some(DaemonResponse::refused("expired", text));
        }
        let large = jumps.iter().any(|j| j.counts.abs() > j.window_counts);
        (large && !accept_jump).then(|| DaemonResponse::Refused {
            why: "jump".to_owned(),
            text: "enabling would move an axis further than its belief window; --accept-jump if it is meant"
                .to_owned(),
            jumps: jumps.to_vec(),
        })
    }
}

/// The rest of a request that is not a whole number of insertions, as text.
fn leftover_note(axis: &ConfiguredAxis, total_counts: i64, in_effect: i64) -> Option<String> {
    let left = (total_counts - in_effect) % INCREMENT_COUNTS;
    (left != 0).then(|| {
        let (name, whole) = (&axis.name, total_counts - left);
        format!(
            "axis {name}: {whole:+} of {total_counts:+} counts will be in effect, {left:+} is left: an insertion is {INCREMENT_COUNTS} counts"
        )
    })
}

/// The figures of a request for a total, as text.
fn asked(axis: &ConfiguredAxis, total_counts: i64, now_counts: i64) -> String {
    format!("axis {}: total {total_counts:+}, now {now_counts:+} counts", axis.name)
}

fn refused(why: Refusal) -> DaemonResponse {
    DaemonResponse::refused(word(why), explain_refusal(why))
}
