//! One axis in motion with any design on any computer, and the count at the MTC.

use crate::computer_timing::ComputerTiming;
use crate::corrected_axis::{CorrectedAxis, GateInsertionDesign, MtcDecoder, homed_engine};
use crate::engine_replay::{ReplayError, ReplayOutcome, replay, replay_with};
use crate::error_correction_circuit::{ErrorCorrectionCircuitAxis, PllFrequencyLimits};
use crate::full_cycle_insertion::FullCycleCorrector;
use crate::noise::NoiseGenerator;
use crate::pass_through_design_b::PassThroughDesignB;
use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_driver::quadrature::{Decoder, State};
use rtec_driver::trace_replay::{DirectOutputs, MtcSignalListener, ScaleToMtcGates, XorGates};
use rtec_driver::trace_replay::{RequestedTotal, TracePoint};
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::StartError;
use rtec_rt::link_messages::{Event, EventKind};
use serde::{Deserialize, Serialize};

/// Every insertion design of the sources.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InsertionDesign {
    /// NISTIR 4832, the "Original RTEC": pulses through OR gates.
    Original,
    /// NISTIR 4832, Design A.
    A,
    /// NISTIR 4832, Design B: the signals pass through the computer.
    B,
    /// NISTIR 4832, Design C: two inversions.
    C,
    /// CMTI (2014): the Error Correction Circuit.
    Ecc,
}

impl InsertionDesign {
    /// All designs, the oldest first.
    pub const ALL: [Self; 5] = [Self::Original, Self::A, Self::B, Self::C, Self::Ecc];

    /// The design's name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Original => "original",
            Self::A => "a",
            Self::B => "b",
            Self::C => "c",
            Self::Ecc => "ecc",
        }
    }

    /// The design of this name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|d| d.name() == name)
    }

    /// Counts of one insertion.
    pub const fn increment_counts(self) -> i64 {
        match self {
            Self::Original | Self::A | Self::Ecc => 4,
            Self::B => 1,
            Self::C => 2,
        }
    }

    /// Whether A and B reach the MTC only through the computer.
    pub const fn through_computer(self) -> bool {
        matches!(self, Self::B)
    }
}

/// Plays a recorded trace to any design; [`replay`] does so for XOR gates only.
///
/// # Errors
/// At the first bad row, or when the axis cannot be corrected as configured.
pub fn replay_any<T, R, L, E>(
    design: InsertionDesign,
    config: AxisConfig,
    trace: T,
    totals: R,
    large: bool,
    to: L,
) -> Result<(ReplayOutcome, L), ReplayError<E>>
where
    T: Iterator<Item = Result<TracePoint, E>>,
    R: Iterator<Item = Result<RequestedTotal, E>>,
    L: MtcSignalListener,
{
    let config = AxisConfig { lines: AxisLines::standard(0, false), ..config };
    match design {
        InsertionDesign::C => replay(config, trace, totals, large, to),
        InsertionDesign::Original => replay_with(
            XorGates,
            |card| full_cycle(GateInsertionDesign::Original, config, card),
            trace,
            totals,
            large,
            to,
        ),
        InsertionDesign::A => replay_with(
            XorGates,
            |card| full_cycle(GateInsertionDesign::A, config, card),
            trace,
            totals,
            large,
            to,
        ),
        InsertionDesign::B => replay_with(
            DirectOutputs,
            |card| PassThroughDesignB::new(config, card)?.ok_or(StartError::NoGate(0)),
            trace,
            totals,
            large,
            to,
        ),
        InsertionDesign::Ecc => {
            let accel = config.max_accel_counts_s2;
            let start = |card: &mut _| {
                Ok(ErrorCorrectionCircuitAxis::new(PllFrequencyLimits::default(), 1, card)?.guarded(accel))
            };
            replay_with(DirectOutputs, start, trace, totals, large, to)
        }
    }
}

/// One axis with two pairs of inversions per insertion, homed at its position.
fn full_cycle<C: Card>(
    design: GateInsertionDesign,
    config: AxisConfig,
    card: &mut C,
) -> Result<FullCycleCorrector, StartError> {
    FullCycleCorrector::new(design, card, &[config], MachineLines::default(), |_| 0)
}

/// The Original RTEC's gates, which OR a pulse into the signal.
/// At A = B = low this equals an inversion. Elsewhere a level that is already high hides it (NISTIR 4832, The
/// "Original RTEC").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OriginalRtecOrGates;

impl ScaleToMtcGates for OriginalRtecOrGates {
    fn out(self, scale: State, outputs: u8) -> State {
        State::from_bits(scale.bits() | outputs)
    }

    fn transparent(self, _scale: State) -> u8 {
        0
    }
}

/// A scale's edge: time, ns, and +1 or −1 count.
pub type Edge = (u64, i64);

/// Constant speed for `counts` counts in one direction, starting at `from_ns`.
pub fn constant(from_ns: u64, encoder_hz: f64, counts: u64, direction: i64) -> Vec<Edge> {
    let period_ns = 0.25e9 / encoder_hz;
    (0..counts).map(|n| (from_ns + (n as f64 * period_ns) as u64, direction)).collect()
}

/// A move of `counts` counts and back, with `rest_ns` in between.
/// Each way starts from rest, reaches `encoder_hz`, and ends at rest. The acceleration is in counts/s².
pub fn there_and_back(encoder_hz: f64, accel_counts_s2: f64, counts: u64, rest_ns: u64) -> Vec<Edge> {
    let mut edges = Vec::new();
    let mut from_ns = rest_ns;
    for direction in [1, -1] {
        let (v, a, s) = (4.0 * encoder_hz, accel_counts_s2, counts as f64 + 0.5);
        let ramp = (v * v / (2.0 * a)).min(s / 2.0);
        let peak = (2.0 * a * ramp).sqrt();
        let total_s = 2.0 * peak / a + (s - 2.0 * ramp) / peak;
        for n in 1..=counts {
            let x = n as f64;
            let t = if x < ramp {
                (2.0 * x / a).sqrt()
            } else if x <= s - ramp {
                peak / a + (x - ramp) / peak
            } else {
                total_s - (2.0 * (s - x) / a).sqrt()
            };
            edges.push((from_ns + (t * 1e9) as u64, direction));
        }
        from_ns += (total_s * 1e9) as u64 + rest_ns;
    }
    edges
}

/// A computer that corrects one axis.
/// It polls when it has time, and its writes take effect later.
struct CorrectingComputer<'a, G> {
    gates: G,
    run: &'a BenchRun<'a>,
    next: usize,
    end_ns: u64,
    scale: Decoder,
    /// State of the scale at the last poll.
    seen: State,
    outputs: u64,
    t_ns: u64,
    /// Time until which the computer is busy with an edge, ns.
    busy_ns: u64,
    /// Time of the last change of the outputs; the next comes a step later.
    wrote_ns: Option<u64>,
    noise: NoiseGenerator,
    mtc: MtcDecoder,
    sent: State,
    /// Every change: time, scale, MTC, MTC's count.
    log: Option<Vec<(u64, State, State, i64)>>,
    /// Scale and MTC counts when the computer stopped.
    at_death: Option<(i64, i64)>,
}

impl<'a, G: ScaleToMtcGates> CorrectingComputer<'a, G> {
    /// The computer, if the corrector is one.
    fn computer(&self) -> Option<&'a ComputerTiming> {
        (!self.run.is_circuit()).then_some(self.run.computer)
    }

    fn out(&mut self, t_ns: u64) {
        let lines = AxisLines::standard(0, false);
        let out = self.gates.out(self.scale.state(), lines.inverters(self.outputs));
        if out != self.sent {
            self.sent = out;
            self.mtc.update(t_ns, out);
        }
        if let Some(log) = &mut self.log {
            log.push((t_ns, self.scale.state(), out, self.mtc.decoder().count()));
        }
    }

    fn run_to(&mut self, t_ns: u64) {
        while let Some(&(edge_ns, step)) = self.run.edges.get(self.next).filter(|e| e.0 <= t_ns) {
            if self.at_death.is_none() && edge_ns > self.run.die_ns {
                self.at_death = Some((self.scale.count(), self.mtc.decoder().count()));
            }
            self.next += 1;
            let state = self.scale.state().next(step > 0);
            self.scale.update(state);
            self.out(edge_ns);
        }
        self.t_ns = self.t_ns.max(t_ns);
    }

    fn next_edge_ns(&self) -> u64 {
        self.run.edges.get(self.next).map_or(u64::MAX, |e| e.0)
    }
}

impl<G: ScaleToMtcGates> Card for CorrectingComputer<'_, G> {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        // Time of the next poll. A circuit, or a computer that waits for an edge, polls at once.
        let waits = |rig: &Self| rig.next_edge_ns().min(wake_ns);
        let (computer, passes) = (self.computer(), self.run.design.through_computer());
        let mut look_ns = match computer {
            None => waits(self).max(self.t_ns),
            Some(c) if passes => self.t_ns + c.pass_ns.max(1),
            Some(c) if c.looks.is_empty() => {
                if self.seen == self.scale.state() { waits(self) } else { self.t_ns }.max(self.t_ns)
            }
            Some(c) => self.t_ns + c.next_look_ns(&mut self.noise).max(1),
        };
        look_ns = look_ns.max(self.busy_ns);
        if let (Some(c), Some(wrote)) = (computer, self.wrote_ns)
            && !passes
            && self.seen == self.scale.state()
            && wake_ns <= wrote + c.step_ns
        {
            look_ns = look_ns.max(wrote + c.step_ns);
        }
        if look_ns > self.run.die_ns && !self.run.is_circuit() || look_ns >= self.end_ns {
            let end_ns = self.end_ns;
            self.run_to(end_ns);
            return Err(CardError::Ended);
        }
        self.run_to(look_ns);
        self.t_ns = look_ns;
        if self.scale.state() != self.seen {
            self.seen = self.scale.state();
            if let (Some(c), false) = (computer, passes) {
                self.busy_ns = look_ns + c.react_ns;
            }
        }
        // A circuit, or a computer that waits for the edge, knows its time.
        let waits = computer.is_none_or(|c| c.looks.is_empty() && !passes);
        let edge_ns =
            (waits && self.next > 0 && self.run.edges[self.next - 1].0 == look_ns).then_some(look_ns);
        Ok(CardInputSample::stamped(look_ns, u64::from(self.seen.bits()), edge_ns))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let delay_ns = match self.computer() {
            Some(c) if c.write_ns > 0 => c.next_look_ns(&mut self.noise).min(c.write_ns),
            _ => 0,
        };
        // A write under way when the computer stops still takes effect: it was on the bus.
        let landed_ns = self.t_ns + delay_ns;
        self.run_to(landed_ns);
        self.outputs = self.outputs & !mask | value & mask;
        self.out(landed_ns);
        self.wrote_ns = Some(landed_ns);
        Ok(Some(landed_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// A run on the bench.
#[derive(Debug, Clone)]
pub struct BenchRun<'a> {
    /// The insertion design.
    pub design: InsertionDesign,
    /// The computer. The ECC is a circuit and needs none.
    pub computer: &'a ComputerTiming,
    /// The axis; its times are replaced by the computer's.
    pub config: AxisConfig,
    /// The scale's state before the first edge.
    pub start: State,
    /// The scale's edges, which are the motion.
    pub edges: &'a [Edge],
    /// Requested totals with their times, ns.
    pub totals: &'a [(u64, i64)],
    /// Time at which the computer stops, ns.
    pub die_ns: u64,
    /// Whether every insertion is tried, without a speed gate.
    /// The report's computer would do so without its timer.
    pub ungated: bool,
    /// Seed of the computer's and the PLL's noise.
    pub seed: u64,
    /// Whether every change is kept for a plot.
    pub keep_log: bool,
    /// The ECC's PLL.
    pub pll: PllFrequencyLimits,
}

/// Result of a run on the bench.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchResult {
    /// Counts of the scale.
    pub scale: i64,
    /// Counts of the MTC.
    pub mtc: i64,
    /// Counts inserted, as the corrector reports.
    pub completed: i64,
    /// Requested total, counts.
    pub requested: i64,
    /// Number of insertions made.
    pub insertions: u64,
    /// Illegal transitions at the MTC: A and B at once.
    pub illegal: u64,
    /// Shortest time between two edges at the MTC, ns.
    pub min_separation_ns: u64,
    /// Real edges during an insertion.
    pub overlaps: u64,
    /// Edges at which an insertion was due but the axis was too fast.
    pub waited_for_gate: u64,
    /// Number of latched faults.
    pub faults: usize,
    /// Shortest and longest time from an edge to the end of its insertion, ns.
    pub edge_to_done_ns: Option<(u64, u64)>,
    /// Scale and MTC counts when the computer stopped.
    pub at_death: Option<(i64, i64)>,
    /// Largest deviation from 90° of a split pulse, degrees (ECC).
    pub worst_phase_deg: f64,
    /// Every change, if kept: time, scale, MTC, MTC's count.
    pub log: Vec<(u64, State, State, i64)>,
}

impl BenchResult {
    /// Counts of the MTC beyond scale and completed total: zero, or an error.
    pub const fn error_counts(&self) -> i64 {
        self.mtc - self.scale - self.completed
    }
}

impl BenchRun<'_> {
    /// A run with the axis at rest at A = B = low, no requests, no stop, speed gate on.
    pub fn new(design: InsertionDesign, computer: &ComputerTiming) -> BenchRun<'_> {
        BenchRun {
            design,
            computer,
            config: AxisConfig::default(),
            start: State::default(),
            edges: &[],
            totals: &[],
            die_ns: u64::MAX,
            ungated: false,
            seed: 1,
            keep_log: false,
            pll: PllFrequencyLimits::default(),
        }
    }

    /// The axis's configuration for this design and computer.
    pub fn config(&self) -> AxisConfig {
        let config = self.computer.configure(self.config);
        let config = match self.design {
            // One pass sees the edge and writes it, at the latest one pass after it came. Steps have their
            // own passes.
            InsertionDesign::B => {
                AxisConfig { detect_ns: 2 * self.computer.pass_ns, write_ns: self.computer.pass_ns, ..config }
            }
            _ => config,
        };
        if self.ungated {
            let rest = InsertionAtRestPolicy::Insert { after_ns: self.computer.react_ns };
            AxisConfig { detect_ns: 0, write_ns: 0, guard_ns: 0, max_accel_counts_s2: 0.0, rest, ..config }
        } else {
            config
        }
    }

    fn is_circuit(&self) -> bool {
        self.design == InsertionDesign::Ecc
    }

    /// Runs it. `None` if the computer is too slow for this axis at any speed.
    pub fn run(&self) -> Option<BenchResult> {
        let config = AxisConfig { lines: AxisLines::standard(0, false), ..self.config() };
        match self.design {
            InsertionDesign::Original => self.run_with_gates(OriginalRtecOrGates, |card| {
                full_cycle(GateInsertionDesign::Original, config, card).ok()
            }),
            InsertionDesign::A => {
                self.run_with_gates(XorGates, |card| full_cycle(GateInsertionDesign::A, config, card).ok())
            }
            InsertionDesign::B => self
                .run_with_gates(DirectOutputs, |card| PassThroughDesignB::new(config, card).ok().flatten()),
            InsertionDesign::C => {
                self.run_with_gates(XorGates, |card| homed_engine(config, card, &mut |_| true).ok())
            }
            InsertionDesign::Ecc => self.run_with_gates(DirectOutputs, |card| {
                ErrorCorrectionCircuitAxis::new(self.pll, self.seed, card).ok()
            }),
        }
    }

    fn run_with_gates<'s, G: ScaleToMtcGates, M: CorrectedAxis>(
        &'s self,
        gates: G,
        start: impl FnOnce(&mut CorrectingComputer<'s, G>) -> Option<M>,
    ) -> Option<BenchResult> {
        let last_ns = self.edges.last().map_or(0, |e| e.0).max(self.totals.last().map_or(0, |t| t.0));
        let mut rig = CorrectingComputer {
            gates,
            run: self,
            next: 0,
            end_ns: last_ns + 5_000_000,
            scale: Decoder::new(self.start),
            seen: self.start,
            outputs: u64::from(gates.transparent(self.start)),
            t_ns: 0,
            busy_ns: 0,
            wrote_ns: None,
            noise: NoiseGenerator::new(self.seed, 0xBE),
            mtc: MtcDecoder::new(self.start),
            sent: self.start,
            log: self.keep_log.then(Vec::new),
            at_death: None,
        };
        rig.out(0);
        let mut corrector = start(&mut rig)?;
        let mut faults = 0;
        let mut report = |e: Event| {
            faults += usize::from(matches!(e.kind, EventKind::Fault(_)));
            true
        };
        let mut totals = self.totals.iter().filter(|t| t.0 <= self.die_ns).copied().peekable();
        let mut edge_to_done: Option<(u64, u64)> = None;
        let (mut insertions, mut last_edge_ns) = (0, 0);
        loop {
            while let Some((_, total)) = totals.next_if(|t| t.0 <= corrector.now_ns()) {
                corrector.correct(total, true, &mut rig, &mut report).ok()?;
            }
            let by_ns = totals.peek().map_or(u64::MAX, |t| t.0);
            let seen = rig.seen;
            match corrector.poll(&mut rig, by_ns, &mut report) {
                Ok(()) => {}
                Err(CardError::Ended) => break,
                Err(CardError::Io { .. }) => return None,
            }
            if rig.seen != seen {
                last_edge_ns = self.edges[rig.next - 1].0;
            }
            let axis = corrector.axis();
            let made = axis.insertions > insertions && axis.mtc_minus_scale == axis.completed;
            if made && rig.next > 0 {
                insertions = axis.insertions;
                // The last change, plus the time until the hardware is free.
                let done =
                    rig.wrote_ns.unwrap_or(rig.t_ns).max(rig.t_ns) - last_edge_ns + self.computer.after_ns;
                edge_to_done =
                    Some(edge_to_done.map_or((done, done), |(lo, hi)| (lo.min(done), hi.max(done))));
            }
        }
        let axis = corrector.axis();
        let (worst_phase_deg, pulse_ns) = corrector.split_pulses();
        Some(BenchResult {
            scale: rig.scale.count(),
            mtc: rig.mtc.decoder().count(),
            completed: axis.completed,
            requested: axis.requested,
            insertions: axis.insertions,
            illegal: rig.mtc.decoder().illegal(),
            min_separation_ns: rig.mtc.min_separation_ns,
            overlaps: axis.overlaps,
            waited_for_gate: axis.waited_for_gate,
            faults,
            edge_to_done_ns: if self.is_circuit() { pulse_ns } else { edge_to_done },
            at_death: rig.at_death,
            worst_phase_deg,
            log: rig.log.unwrap_or_default(),
        })
    }
}

/// The configuration, changed so that an axis at rest is corrected too.
pub fn insert_at_rest(config: AxisConfig) -> AxisConfig {
    AxisConfig { rest: InsertionAtRestPolicy::Insert { after_ns: 1_000_000 }, ..config }
}
