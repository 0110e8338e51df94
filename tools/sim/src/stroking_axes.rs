//! Axes that move to and fro in real time until they are jogged.
//! Each is a machine of one axis at the mock card's wires.

use crate::attended_machine::AttendedMachine;
use crate::axis::AxisSpec;
use crate::machine::{ControllerLimits, SimMachine};
use crate::machines_on_mock_card::MachinesOnMockCard;
use crate::nc_block::Block;
use crate::trajectory::AXES;
use rtec_driver::card::{AxisLines, MachineLines};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

/// Motion of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StrokeMotion {
    /// Length of a stroke, counts.
    pub stroke_counts: f64,
    /// Feed between the ends, counts/s.
    pub feed_counts_s: f64,
    /// Pause at either end, s.
    pub dwell_s: f64,
    /// Whether the controller closes its loop on the signals from the gates.
    /// If not, it uses an encoder of its own.
    pub on_feedback: bool,
}

/// Data of an axis that can be read at any time.
/// The card's thread writes it; any thread may read it.
#[derive(Debug)]
pub struct TrueAxisState {
    commanded: AtomicU64,
    /// Deviation of the axis from the command.
    /// It changes slowly, so a command read slightly too early is accurate enough.
    deviation_counts: AtomicU64,
    mtc_count: AtomicI64,
    illegal: AtomicU64,
    /// Target of a jog, counts; NaN while it runs its cycle.
    /// The operator writes it; the card's thread reads it.
    jog: AtomicU64,
}

impl Default for TrueAxisState {
    fn default() -> Self {
        Self {
            commanded: AtomicU64::default(),
            deviation_counts: AtomicU64::default(),
            mtc_count: AtomicI64::default(),
            illegal: AtomicU64::default(),
            jog: AtomicU64::new(f64::NAN.to_bits()),
        }
    }
}

impl TrueAxisState {
    /// Position that the controller commands, counts.
    pub fn commanded_counts(&self) -> f64 {
        f64::from_bits(self.commanded.load(Ordering::Relaxed))
    }

    /// Deviation of the axis's scale position from the command, counts.
    pub fn off_counts(&self) -> f64 {
        f64::from_bits(self.deviation_counts.load(Ordering::Relaxed))
    }

    /// Position of the axis by its scale, counts.
    pub fn position_counts(&self) -> f64 {
        self.commanded_counts() + self.off_counts()
    }

    /// The controller's count, decoded independently from A' and B'.
    pub fn mtc_counts(&self) -> i64 {
        self.mtc_count.load(Ordering::Relaxed)
    }

    /// Leaves the cycle, moves to a commanded position, counts, at the motion's feed.
    /// It stays there until [`TrueAxisState::go_on`].
    pub fn jog_to(&self, commanded_counts: f64) {
        self.jog.store(commanded_counts.to_bits(), Ordering::Relaxed);
    }

    /// Takes up the cycle again once a jog is done.
    pub fn go_on(&self) {
        self.jog_to(f64::NAN);
    }

    /// Illegal transitions that the controller has seen.
    pub fn illegal(&self) -> u64 {
        self.illegal.load(Ordering::Relaxed)
    }
}

/// The operator, who sees the true state of the axes and presses cycle start.
#[derive(Debug)]
pub struct Operator {
    /// True state of each axis, in their order.
    pub truth: Vec<Arc<TrueAxisState>>,
    go: Arc<AtomicBool>,
}

impl Operator {
    /// Starts the axes.
    pub fn cycle_start(&self) {
        self.feed(true);
    }

    /// Lets the axes continue their cycle, or stops them at its end.
    pub fn feed(&self, on: bool) {
        self.go.store(on, Ordering::Relaxed);
    }
}

/// An axis and its operator.
#[derive(Debug)]
pub struct StrokingAxis {
    machine: SimMachine,
    motion: StrokeMotion,
    truth: Arc<TrueAxisState>,
    /// Cycle start.
    /// The operator writes it; the card's thread reads it.
    go: Arc<AtomicBool>,
    /// The last jog taken, as the bits that the operator wrote.
    jogged: u64,
}

/// Axes that move to and fro, on one card.
pub type MovingAxes = MachinesOnMockCard<StrokingAxis>;

/// Size of one count, mm.
/// These machines have only the first of the controller's axes.
const MM_PER_COUNT: f64 = 1e-3;
/// Gain of an axis that follows commands and insertions in milliseconds, 1/s.
const GAIN_PER_S: f64 = 300.0;
/// Time to reach the feed, s; 20 mm/s needs less than the 1 m/s² of such axes.
const RAMP_S: f64 = 0.03;
/// Part of that time at rising acceleration, s.
const RISE_S: f64 = 0.006;

impl StrokeMotion {
    fn axis(&self) -> AxisSpec {
        let feed_mm_s = self.feed_counts_s * MM_PER_COUNT;
        let accel_mm_s2 = feed_mm_s / (RAMP_S - RISE_S);
        AxisSpec {
            speed_mm_s: feed_mm_s,
            accel_mm_s2,
            decel_mm_s2: accel_mm_s2,
            jerk_mm_s3: accel_mm_s2 / RISE_S,
            position_gain_per_s: GAIN_PER_S,
            speed_gain_per_s: 6.0 * GAIN_PER_S,
            backlash_um: 0.0,
            on_feedback: self.on_feedback,
            ..AxisSpec::new("x", 2.0 * self.stroke_counts * MM_PER_COUNT)
        }
    }

    fn feed_block_to(&self, counts: f64) -> Block {
        let mut to = [0.0; AXES];
        to[0] = counts * MM_PER_COUNT;
        Block::Feed { to, feed_mm_s: self.feed_counts_s * MM_PER_COUNT }
    }
}

/// Axes on these lines, at rest at zero until cycle start.
/// A probe is in the middle of the first axis's stroke.
pub fn moving_axes(axes: &[(AxisLines, StrokeMotion)], lines: MachineLines) -> (MovingAxes, Operator) {
    // Such a controller accepts any feedback, at any rate and with any deviation.
    let controller = ControllerLimits { decoder_hz: f64::INFINITY, max_following_mm: f64::INFINITY };
    let (go, mut truth) = (Arc::<AtomicBool>::default(), Vec::new());
    let stroking = axes.iter().enumerate().map(|(n, &(lines, motion))| {
        let mut machine = SimMachine::new(&[motion.axis()], controller.clone(), [0.0; AXES]);
        if n == 0 {
            let middle_mm = motion.stroke_counts / 2.0 * MM_PER_COUNT;
            machine.set_surface(Some(Box::new(move |p| middle_mm - p[0])), 0);
        }
        truth.push(Arc::<TrueAxisState>::default());
        let (truth, go) = (Arc::clone(&truth[n]), Arc::clone(&go));
        let jogged = f64::NAN.to_bits();
        (StrokingAxis { machine, motion, truth, go, jogged }, vec![lines])
    });
    let wires = MachinesOnMockCard::new(stroking.collect::<Vec<_>>(), MachineLines { hold: None, ..lines });
    (wires, Operator { truth, go })
}

impl AttendedMachine for StrokingAxis {
    fn machine(&self) -> &SimMachine {
        &self.machine
    }

    fn machine_mut(&mut self) -> &mut SimMachine {
        &mut self.machine
    }

    fn tick(&mut self) {
        let jog = self.truth.jog.load(Ordering::Relaxed);
        let cycles = f64::from_bits(jog).is_nan();
        if std::mem::replace(&mut self.jogged, jog) != jog && !cycles {
            self.machine.jog(self.motion.feed_block_to(f64::from_bits(jog)));
        } else if cycles && self.machine.finished() && self.go.load(Ordering::Relaxed) {
            let seconds = self.motion.dwell_s;
            let stroke = self.motion.feed_block_to(self.motion.stroke_counts);
            self.machine.load([
                stroke,
                Block::Dwell { seconds },
                self.motion.feed_block_to(0.0),
                Block::Dwell { seconds },
            ]);
        }
        let commanded_mm = self.machine.command.p_mm[0];
        let off_mm = self.machine.position_mm(0) - commanded_mm;
        self.truth.commanded.store((commanded_mm / MM_PER_COUNT).to_bits(), Ordering::Relaxed);
        self.truth.deviation_counts.store((off_mm / MM_PER_COUNT).to_bits(), Ordering::Relaxed);
    }

    fn changed(&mut self) {
        self.truth.mtc_count.store(self.machine.mtc_counts(0), Ordering::Relaxed);
        self.truth.illegal.store(self.machine.illegal(0), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_driver::clock::Clock;
    use rtec_driver::mock_card::{MockCard, Wires};
    use rtec_rt::axis::AxisConfig;
    use rtec_rt::engine::{Engine, MachineConfig};
    use rtec_rt::link_messages::{Event, EventKind, RequestToRt};

    const LINES: AxisLines = AxisLines::standard(0, true);
    const MOTION: StrokeMotion =
        StrokeMotion { stroke_counts: 1000.0, feed_counts_s: 10_000.0, dwell_s: 0.1, on_feedback: true };

    fn axes(motion: StrokeMotion) -> (MovingAxes, Operator) {
        moving_axes(&[(LINES, motion)], MachineLines::default())
    }

    fn run(axes: &mut MovingAxes, from_ns: u64, to_ns: u64, outputs: u64) {
        let mut t = from_ns;
        while t < to_ns {
            t += axes.step_limit_ns();
            axes.levels(t, outputs);
        }
    }

    #[test]
    fn an_inserted_pair_moves_only_an_axis_on_feedback_back() {
        for (on_feedback, back_counts, within) in [(true, 2.0, 0.6), (false, 0.0, 0.1)] {
            let (mut axes, operator) = axes(StrokeMotion { dwell_s: 10.0, on_feedback, ..MOTION });
            operator.cycle_start();
            let truth = &operator.truth[0];
            axes.levels(1, 0);
            run(&mut axes, 1, 1_000_000_000, 0);
            let before = truth.position_counts();
            assert!((before - 1000.0).abs() < 1.0, "{before}");
            // Adds two counts as Design C does: A first if A = B.
            let now = axes.now_ns() + 1;
            let equal = LINES.scale(axes.levels(now, 0)).equal();
            axes.levels(now, if equal { 1 } else { 2 });
            run(&mut axes, now, now + 1_000_000_000, 3);
            let after = truth.position_counts();
            assert!((after - (before - back_counts)).abs() < within, "{before}, {after}");
            assert_eq!((axes.attended(0).machine.mtc_minus_scale(0), truth.illegal()), (2, 0));
        }
    }

    #[test]
    fn a_jog_leaves_the_cycle_until_it_goes_on() {
        let (mut axes, operator) = axes(MOTION);
        operator.cycle_start();
        axes.levels(1, 0);
        run(&mut axes, 1, 50_000_000, 0);
        operator.truth[0].jog_to(-700.0);
        run(&mut axes, 50_000_000, 1_000_000_000, 0);
        let at = operator.truth[0].position_counts();
        assert!(
            (at + 700.0).abs() < 1.0 && (operator.truth[0].commanded_counts() + 700.0).abs() < 1e-9,
            "{at}"
        );
        // Released during a jog, it completes the jog first, then continues its cycle.
        operator.truth[0].jog_to(-300.0);
        run(&mut axes, 1_000_000_000, 1_010_000_000, 0);
        operator.truth[0].go_on();
        let (mut least, mut most) = (f64::MAX, f64::MIN);
        for k in 0..2000 {
            run(&mut axes, 1_010_000_000 + k * 1_000_000, 1_011_000_000 + k * 1_000_000, 0);
            let at = operator.truth[0].commanded_counts();
            (least, most) = (if k < 500 { f64::MAX } else { least.min(at) }, most.max(at));
        }
        assert!(least.abs() < 1.0 && (most - 1000.0).abs() < 1.0, "{least} to {most}");
    }

    #[test]
    fn the_probe_is_in_the_middle_of_the_first_stroke() {
        let lines = [0, 1].map(|n| (AxisLines::standard(n, true), MOTION));
        let (mut axes, operator) =
            moving_axes(&lines, MachineLines { probe: Some(40), ..MachineLines::default() });
        operator.cycle_start();
        let (mut t, mut tripped_at) = (1, None);
        while t < 100_000_000 && tripped_at.is_none() {
            if axes.levels(t, 0) >> 40 & 1 != 0 {
                tripped_at = Some(axes.attended(0).machine.position_mm(0));
            }
            t += axes.step_limit_ns();
        }
        assert!((tripped_at.unwrap() - 0.5).abs() < 1e-4, "{tripped_at:?}");
    }

    /// The process is not scheduled between any two polls.
    /// For an insertion the machine has not moved meanwhile.
    #[test]
    fn a_process_that_is_kept_away_overtakes_no_insertion() {
        struct Away(u64);
        impl Clock for Away {
            fn now_ns(&mut self) -> u64 {
                self.0 += 20_000_000;
                self.0
            }
        }
        let motion =
            StrokeMotion { stroke_counts: 2000.0, feed_counts_s: 30_000.0, dwell_s: 0.001, ..MOTION };
        let (axes, operator) = axes(motion);
        let mut card = MockCard::new(axes, Away(0));
        let config =
            AxisConfig { lines: LINES, detect_ns: 4_000, max_accel_counts_s2: 1e7, ..AxisConfig::default() };
        let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
        let mut engine = Engine::new(&mut card, &[config], machine, &[]).unwrap();
        let mut faults = Vec::new();
        let mut report = |event: Event| {
            faults.extend(if let EventKind::Fault(fault) = event.kind { Some(fault) } else { None });
            true
        };
        engine.start_homed(&mut card, &mut report).unwrap();
        operator.cycle_start();
        for k in 0..60_i64 {
            let request = RequestToRt::Correct { axis: 0, total_counts: 2 * (k % 7), large: true };
            engine.take(request, &mut card, &mut report).unwrap();
            for _ in 0..2000 {
                engine.poll(&mut card, 0, &mut report).unwrap();
            }
        }
        let status = engine.status();
        assert!(status.axes[0].insertions > 50 && status.balanced(), "{status:?}");
        assert_eq!((faults, operator.truth[0].illegal()), (vec![], 0));
    }

    #[test]
    fn read_back_shows_what_the_controller_gets() {
        let (mut axes, _) = axes(MOTION);
        assert_eq!(axes.levels(1, 0) & 0b1100, 0);
        assert_eq!(axes.levels(1, 0b01) & 0b1100, 0b0100);
    }
}
