//! The machine as a [`Card`], on a virtual nanosecond clock.
//! It has axes, controller, decoders and probe.
//!
//! It is event driven: [`Card::sample`] jumps to the scale's next edge, the probe's trip or the engine's wake
//! time, whichever comes first. Between events the axes move in steps of constant speed. Every edge has the
//! time at which the moving table crosses it.

use crate::axis::{AxisSim, AxisSpec};
use crate::nc_block::Block;
use crate::trajectory::{AXES, FeedProfile, MoveShape, PathMotionLimits, PathState, Setpoint};
use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample};
use rtec_model::live_evaluation::AxisMotionState;
use rtec_rt::link_messages::MAX_AXES;

/// Time step of the axes, ns.
pub const STEP_NS: u64 = 250_000;
/// Period of the controller's position loop, ns.
pub const SERVO_NS: u64 = 1_000_000;

/// Reason why a controller stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ControllerFault {
    /// Both signals of an axis changed at once.
    /// (NISTIR 4832, Design B: "typically a *servo fault* message")
    IllegalState {
        /// Index of the axis.
        axis: usize,
    },
    /// Two edges closer together than its decoder can follow.
    TooFast {
        /// Index of the axis.
        axis: usize,
    },
    /// The axis is too far from its command: its feedback is lost or mirrored.
    FollowingError {
        /// Index of the axis.
        axis: usize,
    },
}

/// Limits of the controller (MTC).
#[derive(Debug, Clone, PartialEq)]
pub struct ControllerLimits {
    /// Highest count rate of its decoder, Hz.
    /// Edges closer than the inverse are a servo fault.
    pub decoder_hz: f64,
    /// Following error at which it stops, mm.
    pub max_following_mm: f64,
}

impl Default for ControllerLimits {
    /// A decoder for square waves of 500 kHz.
    fn default() -> Self {
        Self { decoder_hz: 2e6, max_following_mm: 2.0 }
    }
}

/// Signed distance from the probe's tip to the part's surface, mm.
/// The argument is the tip's centre in X, Y, Z (mm). Contact is at zero.
pub type Surface = Box<dyn Fn([f64; AXES]) -> f64 + Send>;

#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum ActiveMove {
    #[default]
    Idle,
    Move {
        shape: MoveShape,
        profile: FeedProfile,
        t_s: f64,
    },
    Dwell {
        left_s: f64,
    },
}

/// Bits of an event's word that hold its source; the rest is its time.
const SOURCE_BITS: u32 = 3;
const SOURCE: u64 = (1 << SOURCE_BITS) - 1;
/// Source number of the probe; axes follow from 1.
/// Of simultaneous events the probe's line comes first, then the axes in order.
const PROBE: usize = 0;

/// An event's time (ns) and source in one word, so that the earlier is the smaller.
/// An event that does not happen has a time later than any step.
#[inline]
const fn event_key(t_ns: u64, source: usize) -> u64 {
    t_ns << SOURCE_BITS | source as u64
}

/// The simulated machine behind a card's lines: axes, scales, decoders and probe.
#[derive(Default)]
pub struct SimMachine {
    pub(crate) axes: Vec<AxisSim>,
    /// The controller's axis (0 X, 1 Y, 2 Z) of each axis of the machine.
    pub(crate) place: Vec<usize>,
    lines: Vec<AxisLines>,
    controller: ControllerLimits,
    min_separation_ns: u64,
    program: std::collections::VecDeque<Block>,
    job: ActiveMove,
    pub(crate) command: Setpoint,
    /// Share of the programmed speed at which the path is run.
    /// Feed hold reduces it to zero and back.
    feed_override: f64,
    pub(crate) hold: bool,
    /// The operator's jog; it runs instead of the program once the path is at rest.
    jog: Option<Block>,
    /// Blocks begun so far.
    pub(crate) begun: usize,
    fault: Option<ControllerFault>,
    pub(crate) rpm: f64,
    pub(crate) coolant: bool,
    t_ns: u64,
    step_end_ns: u64,
    outputs: u64,
    inputs: u64,
    /// The next event of every axis within the step, and the first of all.
    /// The first may be the probe's. Both are in the form of [`event_key`].
    axis_events: [u64; MAX_AXES],
    next_event: u64,
    surface: Option<Surface>,
    /// Tool minus scale, mm: the true machine's errors.
    pub(crate) tool_offset_mm: [f64; AXES],
    /// Time from contact to the probe's line, ns.
    probe_delay_ns: u64,
    /// Distance of the tip's centre at which the probe detects the part, mm.
    /// It is the tip's radius plus its present error.
    pub(crate) probe_reach_mm: f64,
    trip_ns: u64,
    /// Number of the probe's trips, and the axes' positions at the last trip.
    /// Positions are X, Y, Z by the scales, mm.
    pub(crate) trips: (usize, [f64; AXES]),
    edges: u64,
}

impl std::fmt::Debug for SimMachine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimMachine")
            .field("t_ns", &self.t_ns)
            .field("axes", &self.axes)
            .finish_non_exhaustive()
    }
}

impl SimMachine {
    /// A machine at rest at `at_mm` (X, Y, Z).
    /// Its axes are `x`, `y` or `z`, in any order.
    pub fn new(axes: &[AxisSpec], controller: ControllerLimits, at_mm: [f64; AXES]) -> Self {
        let place: Vec<usize> =
            axes.iter().map(|a| ["x", "y", "z"].iter().position(|n| *n == a.name).unwrap_or(0)).collect();
        let each = axes.iter().zip(&place).enumerate();
        let sims = each.map(|(n, (a, &p))| AxisSim::new(a.clone(), n, at_mm[p])).collect();
        let lines: Vec<AxisLines> = (0..axes.len() as u8).map(|n| AxisLines::standard(n, true)).collect();
        let min_separation_ns = (1e9 / controller.decoder_hz) as u64;
        let mut machine = Self {
            axes: sims,
            place,
            lines,
            controller,
            min_separation_ns,
            program: std::collections::VecDeque::with_capacity(8),
            command: Setpoint { p_mm: at_mm, ..Setpoint::default() },
            feed_override: 1.0,
            axis_events: [u64::MAX; MAX_AXES],
            next_event: u64::MAX,
            trip_ns: u64::MAX,
            trips: (0, at_mm),
            ..Self::default()
        };
        for axis in &mut machine.axes {
            axis.last_out_ns = 0;
            axis.advance(0, 1);
        }
        machine
    }

    /// Highest count rate of its scales, counts/s.
    pub fn fastest_counts_s(&self) -> f64 {
        let speeds = self.axes.iter().map(|a| a.spec.speed_mm_s * 1000.0 / a.spec.count_um);
        speeds.fold(1.0, f64::max)
    }

    /// The card's lines of every axis, with A' and B' read back.
    pub fn lines(&self) -> &[AxisLines] {
        &self.lines
    }

    /// Appends blocks to the program.
    pub fn load(&mut self, blocks: impl IntoIterator<Item = Block>) {
        self.program.extend(blocks);
    }

    /// Leaves the program: the path comes to rest, then this block runs.
    pub fn jog(&mut self, block: Block) {
        self.jog = Some(block);
    }

    /// Whether no block is under way or waiting.
    pub fn finished(&self) -> bool {
        self.program.is_empty() && self.jog.is_none() && self.job == ActiveMove::Idle
    }

    /// Time of the simulation, ns.
    pub const fn now_ns(&self) -> u64 {
        self.t_ns
    }

    /// Edges of all scales so far.
    pub const fn edges(&self) -> u64 {
        self.edges
    }

    /// Reason why the controller stopped, if it did.
    pub const fn fault(&self) -> Option<ControllerFault> {
        self.fault
    }

    /// Position of an axis's table by its scale, not quantised, mm.
    pub(crate) fn position_mm(&self, axis: usize) -> f64 {
        self.axes[axis].position_mm(self.t_ns)
    }

    /// Motion of an axis's table, without its load.
    pub(crate) fn motion(&self, axis: usize) -> AxisMotionState {
        let sim = &self.axes[axis];
        AxisMotionState {
            position_mm: self.position_mm(axis),
            velocity_mm_s: sim.velocity_mm_s(),
            acceleration_mm_s2: sim.accel_mm_s2,
            direction: sim.direction,
            load_n: 0.0,
        }
    }

    /// Counts to the MTC minus counts of the scale, since the start.
    pub fn mtc_minus_scale(&self, axis: usize) -> i64 {
        self.axes[axis].mtc.count() - self.axes[axis].scale.count()
    }

    /// The MTC's count since the start.
    pub fn mtc_counts(&self, axis: usize) -> i64 {
        self.axes[axis].mtc.count()
    }

    /// Illegal transitions that the MTC has seen.
    pub fn illegal(&self, axis: usize) -> u64 {
        self.axes[axis].mtc.illegal()
    }

    /// Shortest time between two edges at the MTC so far, ns.
    pub fn min_separation_ns(&self, axis: usize) -> u64 {
        self.axes[axis].min_separation_ns
    }

    /// Sets the part that the probe may touch, and the delay from contact to line, ns.
    /// `None` is a part out of reach.
    pub fn set_surface(&mut self, surface: Option<Surface>, delay_ns: u64) {
        self.surface = surface;
        self.probe_delay_ns = delay_ns;
        self.trip_ns = u64::MAX;
        self.inputs &= !(1 << 28);
        self.find_soonest();
    }

    /// Position of the tool (or the probe's tip) at the present time, X, Y, Z, mm.
    pub fn tool_mm(&self) -> [f64; AXES] {
        self.tool_at(self.t_ns)
    }

    fn tool_at(&self, t_ns: u64) -> [f64; AXES] {
        let mut p = self.command.p_mm;
        for (axis, &place) in self.axes.iter().zip(&self.place) {
            p[place] = axis.position_mm(t_ns) + self.tool_offset_mm[place];
        }
        p
    }

    /// Runs the controller for a new servo period.
    fn servo(&mut self) {
        let dt = SERVO_NS as f64 * 1e-9;
        // Present target of the axes; speed and acceleration are fed forward for the coming period.
        let due_mm = self.command.p_mm;
        // Feed hold: the path slows down within a tenth of a second, and resumes in the same way.
        let rests = self.hold || self.fault.is_some() || self.jog.is_some();
        let target = if rests { 0.0 } else { 1.0 };
        self.feed_override += (target - self.feed_override).clamp(-dt / 0.1, dt / 0.1);
        if (self.feed_override == 0.0 || self.job == ActiveMove::Idle)
            && let Some(block) = self.jog.take()
        {
            self.program.clear();
            self.program.push_back(block);
            self.job = ActiveMove::Idle;
        }
        let mut left = dt * self.feed_override;
        let at_full_pace = self.feed_override;
        while left > 0.0 || self.job == ActiveMove::Idle {
            match &mut self.job {
                ActiveMove::Idle => {
                    let Some(block) = self.program.pop_front() else {
                        self.command.v_mm_s = [0.0; AXES];
                        self.command.a_mm_s2 = [0.0; AXES];
                        break;
                    };
                    self.job = self.begin(block);
                }
                ActiveMove::Dwell { left_s } => {
                    let used = left.min(*left_s);
                    *left_s -= used;
                    left -= used;
                    if *left_s <= 0.0 {
                        self.job = ActiveMove::Idle;
                    }
                }
                ActiveMove::Move { shape, profile, t_s } => {
                    *t_s += left;
                    left = 0.0;
                    let along = profile.at(*t_s);
                    let paced = PathState {
                        v_mm_s: along.v_mm_s * at_full_pace,
                        a_mm_s2: along.a_mm_s2 * at_full_pace * at_full_pace,
                        ..along
                    };
                    self.command = shape.at(paced);
                    if *t_s >= profile.duration_s() {
                        self.job = ActiveMove::Idle;
                        break;
                    }
                }
            }
        }
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let p = self.place[n];
            if self.fault.is_some() {
                axis.switch_off();
                continue;
            }
            if (due_mm[p] - axis.counted_mm()).abs() > self.controller.max_following_mm {
                self.fault = Some(ControllerFault::FollowingError { axis: n });
            }
            axis.servo(due_mm[p], self.command.v_mm_s[p], self.command.a_mm_s2[p]);
        }
    }

    fn begin(&mut self, block: Block) -> ActiveMove {
        self.begun += 1;
        let from = self.command.p_mm;
        let (shape, feed) = match block {
            Block::Spindle { rpm } => {
                self.rpm = rpm;
                return ActiveMove::Idle;
            }
            Block::Coolant { on } => {
                self.coolant = on;
                return ActiveMove::Idle;
            }
            Block::Dwell { seconds } => return ActiveMove::Dwell { left_s: seconds },
            Block::Rapid { to } => (MoveShape::Line { from, to }, f64::INFINITY),
            Block::Feed { to, feed_mm_s } => (MoveShape::Line { from, to }, feed_mm_s),
            Block::Arc { to, plane: (i, j), centre, clockwise, feed_mm_s } => {
                let start_rad = libm::atan2(from[j] - centre.1, from[i] - centre.0);
                let end_rad = libm::atan2(to[j] - centre.1, to[i] - centre.0);
                let way = if clockwise { -1.0 } else { 1.0 };
                let mut sweep_rad = end_rad - start_rad;
                while way * sweep_rad < 1e-9 {
                    sweep_rad += way * std::f64::consts::TAU;
                }
                let radius_mm = libm::hypot(from[i] - centre.0, from[j] - centre.1);
                let k = AXES - i - j;
                let third_mm = to[k] - from[k];
                let arc =
                    MoveShape::Arc { from, plane: (i, j), centre, radius_mm, start_rad, sweep_rad, third_mm };
                (arc, feed_mm_s)
            }
        };
        let length = shape.length_mm();
        if length == 0.0 {
            return ActiveMove::Idle;
        }
        // Each axis stays within its own limits along its direction.
        let share = |n: usize| match shape {
            MoveShape::Line { from, to } => ((to[n] - from[n]) / length).abs(),
            MoveShape::Arc { .. } => 1.0,
        };
        let least = |limit: fn(&AxisSpec) -> f64| {
            self.axes.iter().zip(&self.place).fold(f64::INFINITY, |least, (a, &p)| {
                let s = share(p);
                if s > 0.0 { least.min(limit(&a.spec) / s) } else { least }
            })
        };
        let accel_mm_s2 = least(|a| a.accel_mm_s2);
        let limits = PathMotionLimits {
            speed_mm_s: least(|a| a.speed_mm_s).min(feed).min(shape.speed_limit_mm_s(0.5 * accel_mm_s2)),
            accel_mm_s2,
            decel_mm_s2: least(|a| a.decel_mm_s2),
            jerk_mm_s3: least(|a| a.jerk_mm_s3),
        };
        ActiveMove::Move { shape, profile: FeedProfile::new(length, limits), t_s: 0.0 }
    }

    /// Advances everything by one step.
    /// A machine at rest advances by as many servo periods as fit before `wake_ns`.
    #[inline(never)]
    fn step(&mut self, wake_ns: u64) {
        let from_ns = self.step_end_ns;
        if from_ns.is_multiple_of(SERVO_NS) {
            self.servo();
            let periods = wake_ns.saturating_sub(from_ns) / SERVO_NS;
            let rests = self.job == ActiveMove::Idle
                && self.trip_ns == u64::MAX
                && self.axes.iter().all(AxisSim::rests);
            if rests && periods > 0 && wake_ns < u64::MAX {
                self.step_end_ns = from_ns + periods * SERVO_NS;
                for axis in &mut self.axes {
                    axis.hold_at_rest(from_ns);
                }
                self.find_next();
                return;
            }
        }
        self.step_end_ns = from_ns + STEP_NS;
        for axis in &mut self.axes {
            axis.advance(from_ns, STEP_NS);
        }
        if self.surface.is_some() {
            self.find_contact(from_ns);
        }
        self.find_next();
    }

    /// Finds the time within this step at which the tip touches the part.
    fn find_contact(&mut self, from_ns: u64) {
        let Some(surface) = &self.surface else { return };
        let distance_mm = |t_ns: u64| surface(self.tool_at(t_ns)) - self.probe_reach_mm;
        let (before, after) = (distance_mm(from_ns), distance_mm(from_ns + STEP_NS));
        if before > 0.0 && after <= 0.0 {
            let (mut early, mut late) = (from_ns, from_ns + STEP_NS);
            while late - early > 1 {
                let middle = u64::midpoint(early, late);
                *if distance_mm(middle) > 0.0 { &mut early } else { &mut late } = middle;
            }
            self.trip_ns = late + self.probe_delay_ns;
        } else if after > 0.0 && self.trip_ns == u64::MAX {
            self.inputs &= !(1 << 28);
        }
    }

    /// Finds the next events of axes and probe after a step.
    fn find_next(&mut self) {
        for (n, (due_then, axis)) in self.axis_events.iter_mut().zip(&self.axes).enumerate() {
            *due_then = event_key(axis.next_ns, n + 1);
        }
        self.find_soonest();
    }

    #[inline]
    fn find_soonest(&mut self) {
        self.next_event =
            self.axis_events.iter().fold(event_key(self.trip_ns, PROBE), |soonest, d| soonest.min(*d));
    }

    #[inline]
    const fn next_ns(&self) -> u64 {
        self.next_event >> SOURCE_BITS
    }

    #[cold]
    fn check(&mut self, axis: usize, illegal: bool, separation_ns: u64) {
        if self.fault.is_none() {
            if illegal {
                self.fault = Some(ControllerFault::IllegalState { axis });
            } else if separation_ns < self.min_separation_ns {
                self.fault = Some(ControllerFault::TooFast { axis });
            }
        }
    }

    /// Handles the next event of this step.
    #[allow(clippy::inline_always)] // As `sample`.
    #[inline(always)]
    fn happen(&mut self) {
        let (next_ns, source) = (self.next_ns(), (self.next_event & SOURCE) as usize);
        self.t_ns = self.t_ns.max(next_ns);
        // The probe's source number is below those of the axes.
        let which = source.wrapping_sub(1);
        if let (Some(axis), Some(due_then)) = (self.axes.get_mut(which), self.axis_events.get_mut(which)) {
            self.inputs ^= axis.edge(STEP_NS);
            *due_then = event_key(axis.next_ns, source);
            self.edges += 1;
            let since_ns = next_ns - std::mem::replace(&mut axis.last_out_ns, next_ns);
            // Not less than any separation before, all of which have been checked.
            if since_ns < axis.min_separation_ns {
                axis.min_separation_ns = since_ns;
                self.check(which, false, since_ns);
            }
        } else {
            self.trip(next_ns);
        }
        self.find_soonest();
    }

    /// Switches the probe's line on.
    #[cold]
    fn trip(&mut self, t_ns: u64) {
        self.trip_ns = u64::MAX;
        self.inputs |= 1 << 28;
        let mut at_mm = self.command.p_mm;
        for (axis, &place) in self.axes.iter().zip(&self.place) {
            at_mm[place] = axis.position_mm(t_ns);
        }
        self.trips = (self.trips.0 + 1, at_mm);
    }

    /// Runs the machine until `t_ns`, ns of the simulation's time.
    pub fn run_to(&mut self, t_ns: u64) {
        loop {
            if self.next_ns() <= t_ns.min(self.step_end_ns) {
                self.happen();
            } else if t_ns <= self.step_end_ns {
                self.t_ns = self.t_ns.max(t_ns);
                return;
            } else {
                self.t_ns = self.step_end_ns;
                self.step(t_ns);
            }
        }
    }

    /// Time until which the lines certainly stay, ns, and whether one changes then.
    /// Beyond the present step of the axes nothing is known.
    pub fn quiet_until_ns(&mut self) -> (u64, bool) {
        if self.t_ns >= self.step_end_ns {
            self.step(self.t_ns);
        }
        (self.next_ns().min(self.step_end_ns), self.next_ns() <= self.step_end_ns)
    }

    /// Present levels of the input lines.
    pub const fn inputs(&self) -> u64 {
        self.inputs
    }

    /// Sets all output lines.
    pub fn set_outputs(&mut self, outputs: u64) {
        let before = std::mem::replace(&mut self.outputs, outputs);
        for n in 0..self.axes.len() {
            if (before ^ outputs) >> (2 * n) & 3 != 0 {
                let inverters = (outputs >> (2 * n) & 3) as u8;
                let (illegal, since_ns) = self.axes[n].invert(inverters, self.t_ns);
                self.check(n, illegal, since_ns);
                self.show(n);
            }
        }
        self.hold = outputs >> 28 & 1 != 0;
    }

    fn show(&mut self, axis: usize) {
        let a = &self.axes[axis];
        let bits = u64::from(a.scale.state().bits()) | u64::from(a.mtc.state().bits()) << 2;
        self.inputs = self.inputs & !(0xF << (4 * axis)) | bits << (4 * axis);
    }
}

impl Card for SimMachine {
    // Inlined into the engine: the compiler then knows most fields of the sample and does not store them.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        while self.next_ns() > wake_ns.min(self.step_end_ns) {
            if wake_ns <= self.step_end_ns {
                self.t_ns = self.t_ns.max(wake_ns);
                return Ok(CardInputSample::stamped(self.t_ns, self.inputs, None));
            }
            self.t_ns = self.step_end_ns;
            self.step(wake_ns);
        }
        self.happen();
        Ok(CardInputSample::stamped(self.t_ns, self.inputs, Some(self.t_ns)))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.set_outputs(self.outputs & !mask | value & mask);
        Ok(Some(self.t_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}
