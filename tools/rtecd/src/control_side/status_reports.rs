//! The status and all other reports.

use super::ControlSide;
use crate::start::OTHER_BOOT;
use rtec_control::protocol::{
    AuditLogState, AxisCorrectionComponents, AxisReport, DaemonResponse, DaemonSnapshot, DaemonStatus,
    FeedHoldReport, LatchedFault, PROTOCOL, RoleConnectionCounts, RtLoopHistograms, RtStatus,
    TimeDistribution, explain_fault, explain_refusal, word,
};
use rtec_rt::latency_histogram::Reader;
use rtec_rt::link::ControlEnd;
use rtec_rt::link_messages::{CorrectorMode, CorrectorStatus, DisableReason, FeedHoldSource, Refusal};
use rtec_rt::realtime_setup::SetupReport;
use std::path::PathBuf;

impl ControlSide {
    /// All reports at once, with the events after a known one.
    pub(crate) fn observed(
        &mut self,
        events_after: Option<u64>,
        log: AuditLogState,
        clients: Vec<RoleConnectionCounts>,
        control: &mut ControlEnd,
    ) -> DaemonResponse {
        let known = events_after.unwrap_or(0);
        let events: Vec<_> = self.events.iter().filter(|e| e.n > known).cloned().collect();
        let first = events.first().map_or(self.event_count + 1, |e| e.n);
        let timing = &self.set_up.timing;
        let [(poll_gap_ns, poll_gap_sum_ns), (edge_to_done_ns, edge_to_done_sum_ns)] =
            [&timing.poll_gap_ns, &timing.edge_to_done_ns].map(buckets);
        let histograms =
            RtLoopHistograms { poll_gap_ns, edge_to_done_ns, poll_gap_sum_ns, edge_to_done_sum_ns };
        let explained = self.explained(None, control);
        DaemonResponse::Observed(Box::new(DaemonSnapshot {
            status: DaemonStatus { record_trouble: log.in_words(), ..self.status(control) },
            explained,
            events_missed: events_after.map_or(0, |known| first.saturating_sub(known.saturating_add(1))),
            events,
            histograms,
            log,
            clients,
        }))
    }

    fn explained(&self, only: Option<usize>, control: &mut ControlEnd) -> Vec<AxisCorrectionComponents> {
        let status = control.status();
        let wanted = (0..self.config.axes.len()).filter(|n| only.is_none_or(|o| o == *n));
        wanted.map(|n| self.corrector.explain(n, &status.axes[n])).collect()
    }

    pub(super) fn explain(
        &self,
        axis: Option<&str>,
        control: &mut ControlEnd,
    ) -> Result<DaemonResponse, DaemonResponse> {
        let only = axis.map(|name| self.number(name)).transpose()?;
        Ok(DaemonResponse::Explained { axes: self.explained(only, control) })
    }

    pub(super) fn status(&self, control: &mut ControlEnd) -> DaemonStatus {
        let now = control.status();
        let alive = !control.ended();
        let verified = self.set_up.missing.as_ref().is_some_and(SetupReport::can_arm);
        let may_arm = !self.set_up.real || verified && self.unfit.is_empty();
        let missing = self.set_up.missing.iter().flat_map(SetupReport::missing);
        let missing =
            missing.map(|f| format!("{}: wanted {}, found {}; {}", f.name, f.wanted, f.got, f.remedy));
        let rt = RtStatus {
            alive,
            card: self.config.card.backend().to_owned(),
            may_arm,
            cpu: self.set_up.wanted.map(|w| w.cpu),
            priority: self.set_up.wanted.map(|w| w.priority),
            missing: missing.collect(),
            polls: now.polls,
            events_lost: now.events_lost,
            control_stale: now.control_stale,
            disable_switch: now.disable_switch,
            mtc_ready: now.mtc_ready,
            poll_gap_ns: distribution(&self.set_up.timing.poll_gap_ns),
            edge_to_done_ns: distribution(&self.set_up.timing.edge_to_done_ns),
        };
        let axes = self.config.axes.iter().zip(now.axes()).map(|(axis, s)| AxisReport {
            name: axis.name.clone(),
            position_counts: s.position_counts,
            position_mm: s.position_counts as f64 * axis.count_um / 1000.0,
            requested: s.requested,
            completed: s.completed,
            in_effect: s.in_effect,
            mtc_minus_scale: s.mtc_minus_scale,
            inverted: s.inverted,
            homed: s.homed,
            mtc_known: s.mtc_known,
            gate: word(s.gate),
            edge_rate_hz: s.edge_rate_hz,
            faults: s.faults.iter().collect(),
            max_correction_counts: axis.engine.max_correction_counts,
            window_counts: axis.engine.window_counts,
            insertions: s.insertions,
            waited_for_gate: s.waited_for_gate,
            overlaps: s.overlaps,
            late: s.late,
            illegal: s.illegal,
            beyond_limits: s.beyond_limits,
            rates: axis.rates(),
        });
        DaemonStatus {
            version: rtec_files::file_format_stamp::VERSION.to_owned(),
            protocol: PROTOCOL,
            latched: self.history.latched().clone(),
            record_trouble: None,
            machine: self.config.machine.clone(),
            mode: word(now.mode),
            homed: now.axes().iter().all(|a| a.homed),
            enabled: now.enabled,
            hold: self.hold(&now),
            latched_faults: self.latched_faults(&now),
            uptime_s: self.started.elapsed().as_secs_f64(),
            balanced: now.balanced() && now.axes().iter().all(|a| a.mtc_known),
            faults: now.faults.iter().collect(),
            why_not: self.why_not(&now, alive, may_arm),
            model_refused: self.model_refused.clone(),
            rt,
            edited: self.edited(),
            model: self.corrector.running_model(),
            table: self.corrector.table_shown(),
            table_now: self.corrector.table_now(&now),
            sensors: self.corrector.readings(),
            axes: axes.collect(),
        }
    }

    /// A time of the card's clock in seconds since 1970.
    fn at_s(&self, t_ns: u64, now: &CorrectorStatus) -> f64 {
        self.time.now_s() - now.t_ns.saturating_sub(t_ns) as f64 * 1e-9
    }

    /// Who asked for feed hold.
    fn hold(&self, now: &CorrectorStatus) -> Option<FeedHoldReport> {
        let by = match now.held {
            Some(FeedHoldSource::User(uid)) if uid == self.holder.0 && !self.holder.1.is_empty() => {
                format!("user {}", self.holder.1)
            }
            Some(FeedHoldSource::User(uid)) => format!("user {uid}"),
            Some(FeedHoldSource::Controller) => "the controller".to_owned(),
            Some(FeedHoldSource::FoundOn) => "unknown".to_owned(),
            None if now.hold_output => "fault".to_owned(),
            None => return None,
        };
        let first = self.latched_faults(now).iter().filter_map(|f| f.at_s).reduce(f64::min);
        let at_s = if now.held.is_some() { self.held_ns.map(|t| self.at_s(t, now)) } else { first };
        Some(FeedHoldReport { by, at_s })
    }

    pub(super) fn latched_faults(&self, now: &CorrectorStatus) -> Vec<LatchedFault> {
        let own = now.faults.iter().map(|f| (None, f));
        let axes = now.axes().iter().enumerate();
        let all = own.chain(axes.flat_map(|(n, s)| s.faults.iter().map(move |f| (Some(n), f))));
        all.map(|(axis, fault)| {
            let at_s = self.latched_ns.get(&(axis, fault as u8)).map(|t| self.at_s(*t, now));
            LatchedFault { axis: axis.map(|n| self.config.axes[n].name.clone()), fault, at_s }
        })
        .collect()
    }

    /// Messages on files that differ from what runs.
    fn edited(&self) -> Vec<String> {
        let model = self.corrector.running_model().map(|m| (PathBuf::from(m.file), m.sha256));
        self.edited_files.as_ref().map_or_else(Vec::new, |files| files.edited(model))
    }

    /// Why nothing is corrected now, each reason with its remedy.
    fn why_not(&self, now: &CorrectorStatus, alive: bool, may_arm: bool) -> Vec<String> {
        let mut why = Vec::new();
        if !alive {
            why.push(super::rt_requests::ENDED.to_owned());
        }
        for fault in now.faults.iter() {
            why.push(format!("{}: {}", word(fault), explain_fault(fault)));
        }
        for (axis, s) in self.config.axes.iter().zip(now.axes()) {
            for fault in s.faults.iter() {
                why.push(format!("axis {}: {}: {}", axis.name, word(fault), explain_fault(fault)));
            }
        }
        if now.disable_switch {
            why.push(explain_refusal(Refusal::DisableSwitch).to_owned());
        }
        if now.control_stale {
            why.push("the control side is silent".to_owned());
        }
        if !may_arm {
            why.push(explain_refusal(Refusal::NotArmable).to_owned());
            why.extend(self.unfit.iter().cloned());
        }
        if !now.mtc_ready {
            why.push(explain_refusal(Refusal::ControllerNotReady).to_owned());
        }
        let axes = || self.config.axes.iter().zip(now.axes());
        let unknown = self.unknown(now);
        why.extend(unknown.iter().filter(|_| self.set_up.before.other_boot).map(|_| OTHER_BOOT.to_owned()));
        why.extend(unknown);
        let away = axes().filter(|(_, s)| !s.homed && s.mtc_known).map(|(a, _)| a.name.as_str());
        let away: Vec<&str> = away.collect();
        if !away.is_empty() {
            why.push(format!("not homed: {}; move there, then `rtecctl home`", away.join(", ")));
        }
        match now.mode {
            CorrectorMode::Shadow => {
                why.push("shadow mode: everything is computed, nothing is written".to_owned());
            }
            CorrectorMode::Probe => why.push("probing mode: `rtecctl probe off`".to_owned()),
            CorrectorMode::Hold => {
                let by = self.hold(now).map_or(String::new(), |h| h.by);
                why.push(format!("feed hold by {by}: `rtecctl hold off`"));
            }
            CorrectorMode::Fault => {
                why.push("when mended: `rtecctl clear`".to_owned());
                if let Some(hold) = self.hold(now).filter(|_| now.held.is_some()) {
                    why.push(format!("feed hold by {} stays after it: `rtecctl hold off`", hold.by));
                }
            }
            CorrectorMode::Run | CorrectorMode::Disabled => {}
        }
        if matches!(now.mode, CorrectorMode::Disabled | CorrectorMode::Probe | CorrectorMode::Hold)
            && !now.enabled
        {
            why.push(format!("corrections are off{}: `rtecctl enable`", off_because(now.off_because)));
        }
        if matches!(now.mode, CorrectorMode::Disabled | CorrectorMode::Fault) {
            why.extend(
                self.corrector
                    .expired()
                    .iter()
                    .map(|e| format!("{e}: {}", super::model_and_table_loads::LOOK_AGAIN)),
            );
        }
        why.extend(self.model_refused.iter().cloned());
        why.extend(self.corrector.holding());
        why
    }
}

/// The reason that follows "corrections are off".
const fn off_because(because: DisableReason) -> &'static str {
    match because {
        DisableReason::Start | DisableReason::Asked => "",
        DisableReason::Switch => " since the disable switch was on",
        DisableReason::Controller => " since the controller was off",
        DisableReason::ControlStale => " since the control side was silent",
        DisableReason::Fault => " since the fault",
    }
}

fn distribution(reader: &Reader) -> TimeDistribution {
    let s = reader.snapshot();
    if s.samples() == 0 {
        return TimeDistribution::default();
    }
    let (p50, p99, p9999) = (s.p50(), s.p99(), s.p9999());
    TimeDistribution { min: s.min(), p50, p99, p9999, max: s.max(), samples: s.samples() }
}

/// The buckets of a histogram, and the sum of its values, ns.
fn buckets(reader: &Reader) -> (Vec<[u64; 3]>, u64) {
    let s = reader.snapshot();
    (s.buckets().map(|b| [b.low, b.high.min(s.max()), b.count]).collect(), s.sum())
}
