//! Builds the card that the configuration names.

use crate::DaemonStartFailure;
use nix::sys::statfs::{SYSFS_MAGIC, statfs};
use rtec_control::config::{Config, ConfiguredAxis, SimulatedAxisDeviations};
use rtec_driver::card::AxisLines;
use rtec_driver::clock::Monotonic;
use rtec_driver::mock_card::{MockCard, Wires};
use rtec_driver::trace_replay::TracePoint;
use rtec_files::InputError;
use rtec_files::quadrature_trace::TraceReader;
use rtec_part::geometric_fit::Zx;
use rtec_sim::lathe::Lathe;
use rtec_sim::machines_on_mock_card::MachinesOnMockCard;
use rtec_sim::machining_task::{CutRecorder, MachiningTask};
use rtec_sim::stroking_axes::{MovingAxes, Operator, StrokeMotion, TrueAxisState, moving_axes};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Feed of the simulated axes, mm/s.
/// It is slow enough for a process without real-time priority.
const FEED_MM_S: f64 = 20.0;
const FEED_COUNTS_S: f64 = 50_000.0;
/// Largest number of points of all recorded traces; each takes 16 bytes of memory.
const MAX_POINTS: usize = 50_000_000;

/// The person at the simulated machine, who jogs axes and reads displays.
pub(crate) struct SimulatedOperator {
    axes: Vec<(Arc<TrueAxisState>, SimulatedAxisDeviations)>,
    operator: Operator,
}

impl SimulatedOperator {
    /// Lets the axes move to and fro, or stops them at the end of their cycle.
    pub(crate) fn feed(&self, on: bool) {
        self.operator.feed(on);
    }

    /// Sends an axis to a place of the controller's display, mm.
    pub(crate) fn jog_to(&self, n: usize, display_mm: f64) {
        let (truth, simulated) = &self.axes[n];
        let own = 1.0 + simulated.compensates_ppm * 1e-6;
        truth.jog_to(display_mm * 1000.0 / simulated.count_um * own);
    }

    /// Lets a jogged axis go on to and fro.
    pub(crate) fn go_on(&self, n: usize) {
        self.axes[n].0.go_on();
    }

    /// Readings of the controller's display and of an indicator at the axis, mm.
    pub(crate) fn read_mm(&self, n: usize) -> (f64, f64) {
        let (truth, simulated) = &self.axes[n];
        let mm = |counts: f64| counts * simulated.count_um / 1000.0;
        let own = 1.0 + simulated.compensates_ppm * 1e-6;
        (mm(truth.commanded_counts()) / own, mm(truth.position_counts()))
    }
}

/// Simulated axes that are at rest until they are homed.
/// They then move to and fro over a quarter of their travel, with a probe in the middle of the first one's stroke.
pub(crate) fn mock(config: &Config) -> (MockCard<MovingAxes, Monotonic>, SimulatedOperator) {
    let motion = |axis: &ConfiguredAxis| StrokeMotion {
        stroke_counts: (axis.travel_mm / 4.0 * 1000.0 / axis.count_um).max(1.0),
        feed_counts_s: (FEED_MM_S * 1000.0 / axis.count_um).min(FEED_COUNTS_S),
        dwell_s: 0.2,
        on_feedback: !axis.simulated.ignores,
    };
    let motions: Vec<_> = config.axes.iter().map(|axis| (axis.engine.lines, motion(axis))).collect();
    let (axes, operator) = moving_axes(&motions, config.lines);
    let both = operator.truth.iter().cloned().zip(config.axes.iter().map(|a| a.simulated));
    let stand = SimulatedOperator { axes: both.collect(), operator };
    (MockCard::new(axes, Monotonic), stand)
}

/// The simulated turning centre of a file, with axes z and x, and its part.
pub(crate) fn lathe(
    config: &Config,
    file: &Path,
) -> Result<(MockCard<MachinesOnMockCard<Lathe>, Monotonic>, CutRecorder), InputError> {
    let axis = |name: &str| {
        let missing = || InputError::whole(file, format!("a configuration without axis {name}"), "z and x");
        config.axes.iter().find(|a| a.name == name).ok_or_else(missing)
    };
    let (z, x) = (axis("z")?, axis("x")?);
    let mut task = MachiningTask::read(file)?;
    if z.count_um.to_bits() != x.count_um.to_bits() {
        return Err(InputError::whole(file, "axes of unequal count_um", "one count_um for z and x"));
    }
    task.bench.count_um = z.count_um;
    let home = Zx::new(z.home_counts as f64, x.home_counts as f64) * (z.count_um * 1e-3);
    let (wires, cuts) = task.machine([z.engine.lines, x.engine.lines], config.lines, home)?;
    Ok((MockCard::new(wires, Monotonic), cuts))
}

/// The recording of one axis's scale.
struct RecordedAxis {
    lines: AxisLines,
    points: Vec<TracePoint>,
    /// Index of the present point.
    at: usize,
}

/// Recorded axes, played in real time from the first look on.
/// After the last edge they stand still.
pub(crate) struct RecordedAxesPlayback {
    axes: Vec<RecordedAxis>,
    start_ns: Option<u64>,
    now_ns: u64,
}

impl Wires for RecordedAxesPlayback {
    fn levels(&mut self, t_ns: u64, _outputs: u64) -> u64 {
        let start_ns = *self.start_ns.get_or_insert(t_ns);
        self.now_ns = t_ns - start_ns;
        let mut inputs = 0;
        for axis in &mut self.axes {
            let first_ns = axis.points[0].t_ns;
            if axis.points.get(axis.at + 1).is_some_and(|p| p.t_ns - first_ns <= self.now_ns) {
                axis.at += 1;
            }
            let state = axis.points[axis.at].state;
            inputs |= u64::from(state.a()) << axis.lines.a | u64::from(state.b()) << axis.lines.b;
        }
        inputs
    }

    /// Time until the next edge of any axis, ns.
    /// So late looks do not miss recorded edges.
    fn step_limit_ns(&self) -> u64 {
        let next = self.axes.iter().filter_map(|axis| {
            let next = axis.points.get(axis.at + 1)?;
            Some((next.t_ns - axis.points[0].t_ns).saturating_sub(self.now_ns).max(1))
        });
        next.min().unwrap_or(u64::MAX)
    }
}

/// The card that plays recorded traces in real time.
pub(crate) fn replay(
    config: &Config,
    traces: &[PathBuf],
) -> Result<MockCard<RecordedAxesPlayback, Monotonic>, InputError> {
    let mut axes = Vec::new();
    let mut held = 0;
    for (axis, file) in config.axes.iter().zip(traces) {
        // One more than may be held is enough to refuse the file.
        let played = TraceReader::open(file)?.playable().take(MAX_POINTS + 1 - held);
        let points = played.collect::<Result<Vec<_>, _>>()?;
        held += points.len();
        if held > MAX_POINTS {
            let found = format!("more than {MAX_POINTS} points in all traces");
            let expected = "shorter recordings; `rtecctl replay` takes them of any length";
            return Err(InputError::whole(file, found, expected));
        }
        axes.push(RecordedAxis { lines: axis.engine.lines, points, at: 0 });
    }
    Ok(MockCard::new(RecordedAxesPlayback { axes, start_ns: None, now_ns: 0 }, Monotonic))
}

/// Whether the file may drive a machine.
/// A plain file (shared memory) does not: another program plays the card. A device, or a PCI resource in sysfs, does.
pub(crate) fn drives_a_machine(file: &Path) -> Result<bool, DaemonStartFailure> {
    let failed = |e: std::io::Error| DaemonStartFailure::Unreachable(format!("card {}: {e}", file.display()));
    let plain = std::fs::metadata(file).map_err(failed)?.is_file();
    let system = statfs(file).map_err(|e| failed(e.into()))?.filesystem_type();
    Ok(!plain || system == SYSFS_MAGIC)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_driver::quadrature::State;

    #[test]
    fn recordings_show_every_edge_however_late_the_looks_are() {
        let point = |t_ns, bits| TracePoint { t_ns, state: State::from_bits(bits) };
        let points = vec![point(1000, 0), point(1100, 1), point(1150, 3), point(2000, 2)];
        let lines = AxisLines::standard(0, false);
        let mut wires = RecordedAxesPlayback {
            axes: vec![RecordedAxis { lines, points, at: 0 }],
            start_ns: None,
            now_ns: 0,
        };
        assert_eq!(wires.levels(50_000, 0), 0);
        assert_eq!(wires.step_limit_ns(), 100);
        assert_eq!(wires.levels(50_100, 0), 1);
        assert_eq!(wires.levels(60_000, 0), 3);
        assert_eq!(wires.levels(60_001, 0), 2);
        assert_eq!(wires.step_limit_ns(), u64::MAX);
        assert_eq!(wires.levels(99_000_000, 0), 2);
    }

    #[test]
    fn a_plain_file_drives_nothing_and_a_device_does() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(!drives_a_machine(file.path()).unwrap());
        assert!(drives_a_machine(Path::new("/dev/null")).unwrap());
        assert!(drives_a_machine(Path::new("/sys/kernel/notes")).unwrap());
        assert!(drives_a_machine(Path::new("/nonexistent")).is_err());
    }
}
