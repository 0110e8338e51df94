//! A small moving machine at the other end of the mock card's wires: axes that go to and fro under a controller which
//! closes its loop on what it counts, so that inserted counts move them as they would move a real one.

use crate::card::AxisLines;
use crate::mock::Wires;
use crate::quadrature::{Decoder, State};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

/// How an axis moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Length of a stroke, counts.
    pub stroke_counts: f64,
    /// Feed, counts/s.
    pub feed_counts_s: f64,
    /// Pause at either end, s.
    pub dwell_s: f64,
    /// The controller closes its loop on what it is sent; if not, on an encoder of its own.
    pub on_feedback: bool,
}

/// What the outside may know of an axis at any time. Written by the card's thread, read by anyone.
#[derive(Debug)]
pub struct Truth {
    commanded: AtomicU64,
    position: AtomicU64,
    mtc_count: AtomicI64,
    illegal: AtomicU64,
    /// Where it shall go, counts; no number while it runs its cycle. Written by the operator, read by the card's thread.
    jog: AtomicU64,
}

impl Default for Truth {
    fn default() -> Self {
        Self {
            commanded: AtomicU64::default(),
            position: AtomicU64::default(),
            mtc_count: AtomicI64::default(),
            illegal: AtomicU64::default(),
            jog: AtomicU64::new(f64::NAN.to_bits()),
        }
    }
}

impl Truth {
    /// Where the controller wants the axis, counts.
    pub fn commanded_counts(&self) -> f64 {
        f64::from_bits(self.commanded.load(Ordering::Relaxed))
    }

    /// Where the axis is on its scale, counts.
    pub fn position_counts(&self) -> f64 {
        f64::from_bits(self.position.load(Ordering::Relaxed))
    }

    /// What the controller has counted, decoded from A' and B' on its own.
    pub fn mtc_counts(&self) -> i64 {
        self.mtc_count.load(Ordering::Relaxed)
    }

    /// Leaves the cycle and goes to a commanded place, counts, at the motion's feed; stays there.
    pub fn jog_to(&self, commanded_counts: f64) {
        self.jog.store(commanded_counts.to_bits(), Ordering::Relaxed);
    }

    /// Illegal transitions that the controller has seen.
    pub fn illegal(&self) -> u64 {
        self.illegal.load(Ordering::Relaxed)
    }
}

/// Who stands at the machine: sees the axes as they are, and presses cycle start.
#[derive(Debug)]
pub struct Operator {
    /// One per axis.
    pub truth: Vec<Arc<Truth>>,
    go: Arc<AtomicBool>,
}

impl Operator {
    /// Sets the axes going.
    pub fn cycle_start(&self) {
        self.go.store(true, Ordering::Relaxed);
    }
}

#[derive(Debug)]
struct MovingAxis {
    lines: AxisLines,
    motion: Motion,
    x: f64,
    /// Commanded place while it is jogged.
    jogged: Option<f64>,
    scale: i64,
    mtc: Decoder,
    truth: Arc<Truth>,
}

/// Axes that go to and fro.
#[derive(Debug)]
pub struct MovingAxes {
    axes: Vec<MovingAxis>,
    /// Cycle start. Written by whoever has the machine's other end, read by the card's thread.
    go: Arc<AtomicBool>,
    start_ns: Option<u64>,
    last_ns: u64,
    step_limit_ns: u64,
}

/// The controller's position gain, 1/s: an axis follows its command with a lag of a few milliseconds.
const GAIN_PER_S: f64 = 300.0;
/// The scale's hysteresis on reversal, counts.
const HYSTERESIS_COUNTS: f64 = 0.1;

impl Motion {
    /// Where the axis shall be after `t_s` seconds, counts, and how fast, counts/s.
    fn at(&self, t_s: f64) -> (f64, f64) {
        let stroke_s = self.stroke_counts / self.feed_counts_s;
        let phase = t_s % (2.0 * (stroke_s + self.dwell_s));
        if phase < stroke_s {
            (phase * self.feed_counts_s, self.feed_counts_s)
        } else if phase < stroke_s + self.dwell_s {
            (self.stroke_counts, 0.0)
        } else if phase < 2.0 * stroke_s + self.dwell_s {
            let back = phase - stroke_s - self.dwell_s;
            (self.stroke_counts - back * self.feed_counts_s, -self.feed_counts_s)
        } else {
            (0.0, 0.0)
        }
    }
}

impl MovingAxes {
    /// Axes on these lines, at rest at zero until cycle start.
    #[must_use]
    pub fn new(axes: &[(AxisLines, Motion)]) -> (Self, Operator) {
        // At most a quarter of a count between two looks, also while an axis makes good an insertion of two.
        let fastest = axes.iter().map(|(_, m)| m.feed_counts_s + 4.0 * GAIN_PER_S).fold(1.0, f64::max);
        let axes: Vec<_> = axes
            .iter()
            .map(|&(lines, motion)| MovingAxis {
                lines,
                motion,
                x: 0.5,
                jogged: None,
                scale: 0,
                mtc: Decoder::new(State::default()),
                truth: Arc::default(),
            })
            .collect();
        let truth = axes.iter().map(|a| Arc::clone(&a.truth)).collect();
        let go = Arc::new(AtomicBool::new(false));
        let operator = Operator { truth, go: Arc::clone(&go) };
        (Self { axes, go, start_ns: None, last_ns: 0, step_limit_ns: (0.25e9 / fastest) as u64 }, operator)
    }
}

impl MovingAxis {
    /// Moves for `dt_s` towards where the controller, by its own count, believes it should be.
    fn run(&mut self, t_s: Option<f64>, dt_s: f64) {
        let goal = f64::from_bits(self.truth.jog.load(Ordering::Relaxed));
        let (wanted, feed) = if goal.is_nan() {
            t_s.map_or((0.0, 0.0), |t| self.motion.at(t))
        } else {
            let from = self.jogged.unwrap_or_else(|| self.truth.commanded_counts());
            let step = self.motion.feed_counts_s * dt_s;
            let to = from + (goal - from).clamp(-step, step);
            self.jogged = Some(to);
            (to, (to - from) / dt_s)
        };
        let inserted = if self.motion.on_feedback { self.mtc.count() - self.scale } else { 0 };
        let believed = self.x - 0.5 + inserted as f64;
        self.x += (feed + GAIN_PER_S * (wanted - believed)) * dt_s;
        if self.x >= (self.scale + 1) as f64 + HYSTERESIS_COUNTS / 2.0 {
            self.scale += 1;
        } else if self.x < self.scale as f64 - HYSTERESIS_COUNTS / 2.0 {
            self.scale -= 1;
        }
        self.truth.commanded.store(wanted.to_bits(), Ordering::Relaxed);
        self.truth.position.store((self.x - 0.5).to_bits(), Ordering::Relaxed);
    }

    fn scale_state(&self) -> State {
        // Gray code of the count: 00 → 10 → 11 → 01.
        State::from_bits([0, 1, 3, 2][self.scale.rem_euclid(4) as usize])
    }

    fn send(&mut self, outputs: u64) -> u64 {
        let scale = self.scale_state();
        let out = scale.inverted(self.lines.inverters(outputs));
        if out != self.mtc.state() {
            self.mtc.update(out);
            self.truth.mtc_count.store(self.mtc.count(), Ordering::Relaxed);
            self.truth.illegal.store(self.mtc.illegal(), Ordering::Relaxed);
        }
        let mut inputs = u64::from(scale.a()) << self.lines.a | u64::from(scale.b()) << self.lines.b;
        if let Some((a, b)) = self.lines.read_back {
            inputs |= u64::from(out.a()) << a | u64::from(out.b()) << b;
        }
        inputs
    }
}

impl Wires for MovingAxes {
    fn levels(&mut self, t_ns: u64, outputs: u64) -> u64 {
        if self.start_ns.is_none() && self.go.load(Ordering::Relaxed) {
            self.start_ns = Some(t_ns);
        }
        let dt_ns = if self.last_ns == 0 { 0 } else { t_ns - self.last_ns };
        self.last_ns = t_ns;
        let t_s = self.start_ns.map(|start| (t_ns - start) as f64 / 1e9);
        let dt_s = dt_ns as f64 / 1e9;
        let mut inputs = 0;
        for axis in &mut self.axes {
            if dt_ns > 0 {
                axis.run(t_s, dt_s);
            }
            inputs |= axis.send(outputs);
        }
        inputs
    }

    fn step_limit_ns(&self) -> u64 {
        self.step_limit_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: AxisLines = AxisLines::standard(0, true);

    fn run(axes: &mut MovingAxes, from_ns: u64, to_ns: u64, outputs: u64) {
        let mut t = from_ns;
        while t < to_ns {
            t += axes.step_limit_ns();
            axes.levels(t, outputs);
        }
    }

    #[test]
    fn an_inserted_pair_moves_the_axis_back_by_two_counts() {
        let motion =
            Motion { stroke_counts: 1000.0, feed_counts_s: 10_000.0, dwell_s: 10.0, on_feedback: true };
        let (mut axes, operator) = MovingAxes::new(&[(LINES, motion)]);
        operator.cycle_start();
        let truth = &operator.truth;
        axes.levels(1, 0);
        run(&mut axes, 1, 1_000_000_000, 0);
        let before = truth[0].position_counts();
        assert!((before - 1000.0).abs() < 1.0, "{before}");
        // Add two counts as Design C does: A first where A and B are equal.
        let equal = axes.axes[0].scale_state().equal();
        let now = axes.last_ns;
        axes.levels(now, if equal { 1 } else { 2 });
        run(&mut axes, now, now + 1_000_000_000, 3);
        assert!((truth[0].position_counts() - (before - 2.0)).abs() < 0.6);
        assert_eq!((truth[0].mtc_counts() - axes.axes[0].scale, truth[0].illegal()), (2, 0));
    }

    #[test]
    fn a_jog_leaves_the_cycle_and_stays() {
        let motion =
            Motion { stroke_counts: 1000.0, feed_counts_s: 10_000.0, dwell_s: 0.1, on_feedback: true };
        let (mut axes, operator) = MovingAxes::new(&[(LINES, motion)]);
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
    }

    #[test]
    fn read_back_shows_what_the_controller_gets() {
        let motion = Motion { stroke_counts: 1.0, feed_counts_s: 1.0, dwell_s: 1.0, on_feedback: true };
        let (mut axes, _) = MovingAxes::new(&[(LINES, motion)]);
        assert_eq!(axes.levels(1, 0) & 0b1100, 0);
        assert_eq!(axes.levels(1, 0b01) & 0b1100, 0b0100);
    }
}
