//! Phases of a drift test: stretches of rows with one source of heat.

use super::{DriftFigures, DriftPhaseResult};
use rtec_model::record::{Column, Role};
use std::ops::Range;

/// Shortest phase, s, or a twentieth of the test if that is less.
const SHORTEST_S: f64 = 900.0;
/// The spindle turns from this speed on, rpm.
const TURNS_RPM: f64 = 0.5;

/// The source of heat at a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum HeatSource {
    Rest,
    Spindle,
    Moves(String),
}

/// A stretch of rows in one state.
#[derive(Debug, Clone)]
pub(super) struct HeatPhase {
    pub(super) state: HeatSource,
    pub(super) rows: Range<usize>,
    /// Time of its first row, s.
    pub(super) start_s: f64,
    /// Lowest and highest spindle speed, rpm.
    speed_rpm: [f64; 2],
    /// Whether an earlier phase made heat.
    after_heat: bool,
}

/// Phases so far, from rows in order.
#[derive(Debug, Default)]
pub(super) struct HeatPhaseCollector {
    spans: Vec<HeatPhase>,
    last_s: f64,
}

impl HeatPhaseCollector {
    /// Adds the next row, in which these axes move.
    pub(super) fn see(&mut self, moving: &[&str], t_s: f64, rpm: f64) {
        let state = match moving {
            _ if rpm.abs() > TURNS_RPM => HeatSource::Spindle,
            [] => HeatSource::Rest,
            axes => HeatSource::Moves(axes.join(", ")),
        };
        let row = self.spans.last().map_or(0, |s| s.rows.end);
        self.last_s = t_s;
        match self.spans.last_mut() {
            Some(s) if s.state == state => s.rows.end = row + 1,
            _ => {
                let (rows, speed_rpm) = (row..row + 1, [f64::INFINITY, 0.0]);
                self.spans.push(HeatPhase { state, rows, start_s: t_s, speed_rpm, after_heat: false });
            }
        }
        if let Some(s) = self.spans.last_mut().filter(|_| rpm.abs() > TURNS_RPM) {
            s.speed_rpm = [s.speed_rpm[0].min(rpm.abs()), s.speed_rpm[1].max(rpm.abs())];
        }
    }

    /// The phases of the test; short pauses belong to the phase that they interrupt.
    pub(super) fn phases(self) -> Vec<HeatPhase> {
        let Self { mut spans, last_s } = self;
        let Some(start_s) = spans.first().map(|s| s.start_s) else { return spans };
        let shortest_s = SHORTEST_S.min((last_s - start_s) / 20.0);
        let length_s = |spans: &[HeatPhase], i: usize| {
            spans.get(i + 1).map_or(last_s, |next| next.start_s) - spans[i].start_s
        };
        while let Some(i) = (0..spans.len())
            .filter(|i| spans.len() > 1 && length_s(&spans, *i) < shortest_s)
            .min_by(|a, b| length_s(&spans, *a).total_cmp(&length_s(&spans, *b)))
        {
            let short = spans.remove(i);
            if i == 0 {
                spans[0].rows.start = short.rows.start;
                spans[0].start_s = short.start_s;
                spans[0].turned(short.speed_rpm);
            } else {
                spans[i - 1].takes(&short);
                if spans.get(i).is_some_and(|next| next.state == spans[i - 1].state) {
                    let next = spans.remove(i);
                    spans[i - 1].takes(&next);
                }
            }
        }
        let mut heat = false;
        for s in &mut spans {
            s.after_heat = heat;
            heat |= s.state != HeatSource::Rest;
        }
        spans
    }
}

impl HeatPhase {
    fn takes(&mut self, next: &Self) {
        self.rows.end = next.rows.end;
        self.turned(next.speed_rpm);
    }

    fn turned(&mut self, [slowest, fastest]: [f64; 2]) {
        self.speed_rpm = [self.speed_rpm[0].min(slowest), self.speed_rpm[1].max(fastest)];
    }

    /// Name of the phase in one word and in several.
    pub(super) fn name(&self, columns: &[Column]) -> (&'static str, String) {
        match &self.state {
            HeatSource::Rest if self.after_heat => ("cooling", "at rest after heat".to_owned()),
            HeatSource::Rest if columns.iter().all(|c| c.role != Role::SpindleSpeed) => {
                let what = "no axis moves, spindle_speed not recorded: environment (ETVE) only if it stood";
                ("environment", what.to_owned())
            }
            HeatSource::Rest => ("environment", "environment (ETVE), at rest".to_owned()),
            HeatSource::Moves(axes) => ("movement", format!("movement of {axes}")),
            HeatSource::Spindle => {
                let [lo, hi] = self.speed_rpm;
                let speed =
                    if hi - lo > 0.02 * hi { format!("{lo:.0} to {hi:.0}") } else { format!("{hi:.0}") };
                ("spindle", format!("spindle rotation, {speed} rpm"))
            }
        }
    }

    /// The phase with the figures of a displacement.
    pub(super) fn phase(
        &self,
        columns: &[Column],
        from_min: f64,
        at_mm: Option<f64>,
        figures: DriftFigures,
    ) -> DriftPhaseResult {
        let (phase, what) = self.name(columns);
        DriftPhaseResult { phase, what, from_min, at_mm, figures }
    }
}
