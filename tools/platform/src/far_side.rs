//! The other end of the wires, for the self-test.
//! It is a moving scale, a counting MTC, and the control side.

use rand_xoshiro::rand_core::RngCore;
use rtec_driver::card::AxisLines;
use rtec_driver::card_profile::Width;
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::mapped_registers::MappedRegisterFile;
use rtec_driver::mock_card::SharedWires;
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::latency_histogram::Recorder;
use rtec_rt::link::ControlEnd;
use rtec_rt::link_messages::{CorrectorMode, RequestToRt};
use serde::Serialize;
use std::sync::atomic::Ordering::{Acquire, Release};
use std::time::Duration;

/// The axis's wires on the test cards.
const LINES: AxisLines = AxisLines::standard(0, false);
/// Shortest and longest wait between an insertion and the next edge, ns.
/// The wait is random, so it is not in step with the loop.
const DWELL_NS: (u64, u64) = (20_000, 40_000);
/// Longest gap between two looks of the far side for a valid sample, ns.
/// A longer gap is a delay of the far side itself, and the sample is not counted.
const RESOLUTION_NS: u64 = 1_000;
/// Interval of the control side's looks at the engine, ns. It is long on purpose.
const CONTROL_INTERVAL_NS: u64 = 2_000_000;
/// Time without an effect after which a request is sent again, ns.
const ASK_AGAIN_NS: u64 = 20_000_000;
/// Extra time of the loop until the first insertion has been timed, ns.
const PATIENCE_NS: u64 = 10_000_000_000;
const SECOND_NS: u64 = 1_000_000_000;
/// The total that is always pending.
const WITHOUT_END: RequestToRt = RequestToRt::Correct { axis: 0, total_counts: i64::MAX / 2, large: true };

/// Counts of the far side.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct MachineSideCounts {
    /// Number of edges given to the scale's lines.
    pub edges: u64,
    /// Edges that no insertion followed: the first one, and those seen too late.
    pub without_insertion: u64,
    /// Insertions that were not timed, because the far side could not look in time.
    pub unresolved: u64,
    /// Counts of the MTC minus those of the scale.
    pub mtc_minus_scale: i64,
    /// Illegal transitions at the MTC.
    pub illegal: u64,
}

/// The other end of a card's wires.
pub(crate) trait FarSideWires {
    fn drive(&mut self, inputs: u64);
    fn outputs(&mut self) -> u64;
}

impl FarSideWires for SharedWires {
    fn drive(&mut self, inputs: u64) {
        self.inputs.store(inputs, Release);
    }

    fn outputs(&mut self) -> u64 {
        self.outputs.load(Acquire)
    }
}

/// The registers of the shared-memory test card, from the machine's side.
impl FarSideWires for MappedRegisterFile {
    fn drive(&mut self, inputs: u64) {
        self.write(0, Width::Bits32, inputs as u32);
    }

    fn outputs(&mut self) -> u64 {
        u64::from(self.read(4, Width::Bits32))
    }
}

/// The control side: it always requests a correction, and homes after a fault.
pub(crate) struct SelftestControlSide<'a> {
    link: &'a mut ControlEnd,
    /// Requests are sent as fast as the link takes them.
    streaming: bool,
    homed: HomingState,
    /// Number of faults; after each the axis was homed again.
    pub faults: u64,
    /// Number of requests sent.
    pub requests: u64,
    /// Time of the engine's last known look, ns.
    looked_ns: u64,
    /// Time of the control side's next look at the engine, ns.
    due_ns: u64,
    end_ns: u64,
    /// Time of the next call of `progress`, ns; it gets the seconds that are left.
    progress_ns: u64,
    progress: &'a mut dyn FnMut(u64),
}

#[derive(Debug)]
enum HomingState {
    /// Not requested yet.
    Never,
    /// Requested at this look of the engine, ns.
    Asked { at_ns: u64 },
    /// Homed and correcting.
    Done,
}

impl<'a> SelftestControlSide<'a> {
    pub(crate) fn new(
        link: &'a mut ControlEnd,
        streaming: bool,
        time: Duration,
        progress: &'a mut dyn FnMut(u64),
    ) -> Self {
        let now_ns = Monotonic.now_ns();
        Self {
            link,
            streaming,
            homed: HomingState::Never,
            faults: 0,
            requests: 0,
            looked_ns: 0,
            due_ns: now_ns,
            end_ns: now_ns + time.as_nanos() as u64,
            progress_ns: now_ns,
            progress,
        }
    }

    /// Does what is due, and sends up to `requests` requests if they shall stream.
    #[inline]
    fn attend(&mut self, now_ns: u64, requests: u64) {
        if self.streaming && matches!(self.homed, HomingState::Done) {
            self.requests += (0..requests).take_while(|_| self.link.send(WITHOUT_END).is_ok()).count() as u64;
        }
        if now_ns >= self.due_ns {
            self.due_ns = now_ns + CONTROL_INTERVAL_NS;
            self.look_after();
            if now_ns >= self.progress_ns {
                self.progress_ns += SECOND_NS;
                (self.progress)(self.end_ns.saturating_sub(now_ns).div_ceil(SECOND_NS));
            }
        }
    }

    fn look_after(&mut self) {
        self.link.beat();
        while self.link.event().is_some() {}
        let status = self.link.status();
        self.looked_ns = status.t_ns;
        match self.homed {
            HomingState::Never => self.home_and_enable(),
            HomingState::Asked { .. } if status.mode == CorrectorMode::Run => self.homed = HomingState::Done,
            // The request was refused, because an insertion was under way.
            HomingState::Asked { at_ns } if self.looked_ns > at_ns + ASK_AGAIN_NS => self.home_and_enable(),
            HomingState::Done if status.mode == CorrectorMode::Fault => {
                self.faults += 1;
                self.home_and_enable();
            }
            _ => {}
        }
    }

    fn home_and_enable(&mut self) {
        for request in [
            RequestToRt::Clear,
            RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true },
            RequestToRt::ConfirmHome { axis: 0, position_counts: 0 },
            RequestToRt::Enable,
            WITHOUT_END,
        ] {
            // The ring is full: the request is repeated when it has emptied.
            let _ = self.link.send(request);
        }
        self.homed = HomingState::Asked { at_ns: self.looked_ns };
    }

    /// Whether the time is up.
    ///
    /// On a busy machine it continues until one insertion has been `timed`.
    fn over(&self, now_ns: u64, timed: bool) -> bool {
        now_ns >= self.end_ns && (timed || now_ns >= self.end_ns + PATIENCE_NS) || self.link.ended()
    }
}

/// The scale and the MTC of a self-test.
struct ScaleAndMtc<'a, 'c, F> {
    far: &'a mut F,
    control: &'a mut SelftestControlSide<'c>,
    done: &'a mut Recorder,
    clock: Monotonic,
    scale: Decoder,
    mtc: Decoder,
    /// The inverters at the last look.
    inverters: u8,
    seen: MachineSideCounts,
    last_done_ns: Option<u64>,
}

/// Moves the scale edge by edge and counts as the MTC, until the time is up.
/// The times from edge to second inversion go to `done`. Returns the counts, and the last of those times, ns.
pub(crate) fn play(
    far: &mut impl FarSideWires,
    control: &mut SelftestControlSide,
    done: &mut Recorder,
    random: &mut impl RngCore,
) -> (MachineSideCounts, u64) {
    let inverters = LINES.inverters(far.outputs());
    let scale = Decoder::new(LINES.scale(0));
    let mtc = Decoder::new(scale.state().inverted(inverters));
    let (clock, seen) = (Monotonic, MachineSideCounts::default());
    let mut player =
        ScaleAndMtc { far, control, done, clock, scale, mtc, inverters, seen, last_done_ns: None };
    loop {
        let now_ns = player.clock.now_ns();
        if player.control.over(now_ns, player.last_done_ns.is_some()) {
            break;
        }
        player.dwell_until(now_ns + DWELL_NS.0 + random.next_u64() % (DWELL_NS.1 - DWELL_NS.0));
        player.edge();
    }
    player.seen.mtc_minus_scale = player.mtc.count() - player.scale.count();
    player.seen.illegal = player.mtc.illegal();
    (player.seen, player.last_done_ns.unwrap_or(0))
}

impl<F: FarSideWires> ScaleAndMtc<'_, '_, F> {
    fn inverters_now(&mut self) -> u8 {
        LINES.inverters(self.far.outputs())
    }

    /// Keeps the axis at rest until `until_ns`; late insertions are counted.
    fn dwell_until(&mut self, until_ns: u64) {
        loop {
            let now_ns = self.clock.now_ns();
            self.control.attend(now_ns, 16);
            if now_ns >= until_ns {
                break;
            }
        }
        let mut late = self.inverters_now();
        while (late ^ self.inverters).is_power_of_two() && !self.control.link.ended() {
            late = self.inverters_now();
        }
        if late != self.inverters {
            self.seen.without_insertion -= 1;
            self.seen.unresolved += 1;
            self.mtc.update(self.mtc.state().next(true));
            self.mtc.update(self.scale.state().inverted(late));
            self.inverters = late;
        }
    }

    /// Makes one edge of the scale, and waits for the insertion that follows.
    fn edge(&mut self) {
        let next = self.scale.state().next(true);
        let edge_ns = self.clock.now_ns();
        self.far.drive(u64::from(next.a()) << LINES.a | u64::from(next.b()) << LINES.b);
        let driven_ns = self.clock.now_ns();
        self.seen.edges += 1;
        self.scale.update(next);
        self.mtc.update(next.inverted(self.inverters));

        let mut resolved = driven_ns - edge_ns <= RESOLUTION_NS;
        let (mut before_ns, mut looked_ns) = (edge_ns, driven_ns);
        let mut known_ns = None;
        let mut left = 2;
        while left > 0 {
            let now = self.inverters_now();
            let now_ns = self.clock.now_ns();
            if now == self.inverters {
                if left == 2 && self.passed_over(driven_ns, &mut known_ns) || self.control.link.ended() {
                    self.seen.without_insertion += 1;
                    return;
                }
            } else {
                // The lines changed after the look before, at a time between two readings of the clock.
                resolved &= now_ns - before_ns <= RESOLUTION_NS;
                left -= self.inverted(next, now);
            }
            (before_ns, looked_ns) = (looked_ns, now_ns);
            self.control.attend(now_ns, 1);
        }
        if resolved {
            let done_ns = looked_ns - edge_ns;
            self.done.record(done_ns);
            self.last_done_ns = Some(done_ns);
        } else {
            self.seen.unresolved += 1;
        }
    }

    /// Enters inversions into the MTC's count; returns their number.
    fn inverted(&mut self, scale: State, now: u8) -> u32 {
        let inversions = (now ^ self.inverters).count_ones();
        if inversions == 2 {
            // Both inversions came between two looks. They still came one after the other, the adding one first.
            self.mtc.update(self.mtc.state().next(true));
        }
        self.mtc.update(scale.inverted(now));
        self.inverters = now;
        inversions
    }

    /// Whether the engine saw the edge of `driven_ns` without acting on it.
    /// A second known look of the engine must follow the first one after the edge.
    fn passed_over(&mut self, driven_ns: u64, known_ns: &mut Option<u64>) -> bool {
        let looked_ns = self.control.looked_ns;
        looked_ns > driven_ns
            && *known_ns.get_or_insert(looked_ns) < looked_ns
            // One more look, because this thread may have been interrupted since the last one.
            && self.inverters_now() == self.inverters
    }
}
