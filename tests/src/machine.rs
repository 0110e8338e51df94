//! A two-axis machine with LinuxCNC as its controller.
//! It has drives, axes with a known error, scales, the engine on a card with virtual time, and the counter card. It
//! runs one servo period at a time, in step with the controller.

use anyhow::{Context, ensure};
use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_driver::card_profile::Width;
use rtec_driver::mapped_registers::MappedRegisterFile;
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{Event, RequestToRt};
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::process::{Command, Stdio};
use std::sync::atomic::{Ordering, fence};
use std::time::Duration;

/// Axes: 0 is X, 1 is Z.
pub const AXES: usize = 2;
/// One count of either scale, µm.
pub const COUNT_UM: f64 = 1.0;

const SERVO_PERIOD_NS: u64 = 1_000_000;
/// The drive's speed follows its command with this first-order lag.
const DRIVE_LAG_S: f64 = 0.002;
/// Motion is computed in steps of this length, with constant speed within a step.
const STEP_NS: u64 = 50_000;
/// Hysteresis of a scale's interpolator, counts.
const HYSTERESIS_COUNTS: f64 = 0.25;

/// The error of an axis: the tool's position minus the scale's.
/// It depends on the scale's position p (effects `scale` and `screw_periodic` with phase 0).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AxisError {
    /// Scale error, µm per m.
    pub ppm: f64,
    /// Amplitude of the periodic error, µm.
    pub periodic_um: f64,
    /// Period of the periodic error, mm.
    pub period_mm: f64,
}

impl AxisError {
    /// The error at a position, µm.
    pub fn at(&self, p_mm: f64) -> f64 {
        let periodic = if self.periodic_um == 0.0 {
            0.0
        } else {
            self.periodic_um * (TAU * p_mm / self.period_mm).sin()
        };
        self.ppm * p_mm / 1000.0 + periodic
    }
}

/// A round part for a touch probe.
/// The tip's centre is on this circle when it touches, (X, Z) in mm.
#[derive(Debug, Clone, Copy)]
pub struct Round {
    /// Centre of the circle, mm.
    pub centre_mm: [f64; AXES],
    /// Radius of the part and of the tip together.
    pub reach_mm: f64,
}

impl Round {
    fn off_mm(&self, p: [f64; AXES]) -> f64 {
        (p[0] - self.centre_mm[0]).hypot(p[1] - self.centre_mm[1]) - self.reach_mm
    }
}

/// What LinuxCNC does on the machine.
#[derive(Debug, Clone, Copy)]
pub enum Job {
    /// Follow a path without correction.
    Plain,
    /// Follow a path with a corrector that knows the machine's error.
    Correct,
    /// Probe a part; the probe is wired to the corrector and to the controller.
    Probe(Round),
}

/// Results of a run on the machine.
#[derive(Debug, Default)]
pub struct Run {
    /// Tool position at the end of each servo period, mm, from the first motion on.
    pub tool_mm: Vec<[f64; AXES]>,
    /// The controller's commanded position at the same times, mm.
    pub command_mm: Vec<[f64; AXES]>,
    /// Insertions made, both axes.
    pub insertions: u64,
    /// Counts of the scales at the end.
    pub scale_counts: [i64; AXES],
    /// Counts of the counter card at the end.
    pub mtc_counts: [i64; AXES],
    /// Counts that the corrector reports as completed.
    pub completed: [i64; AXES],
    /// Illegal transitions at the counter card.
    pub illegal: u64,
    /// Requests that the engine refused and faults that it latched, as text.
    pub complaints: Vec<String>,
    /// Number of LinuxCNC's servo periods.
    pub periods: u64,
    /// All events of the engine.
    pub events: Vec<Event>,
    /// Positions of the scales at each trip of the probe, mm.
    pub trips_mm: Vec<[f64; AXES]>,
    /// Positions that LinuxCNC measured by G38 (#5061 and #5063), mm.
    /// They are filled where the program opens [`PROBE_LOG`].
    pub controller_trips_mm: Vec<[f64; AXES]>,
}

#[derive(Debug, Clone, Copy)]
struct Edge {
    t_ns: u64,
    what: Change,
}

#[derive(Debug, Clone, Copy)]
enum Change {
    Scale(usize, State),
    Probe(bool),
}

/// File that a program opens by `(PROBEOPEN …)` for LinuxCNC's results.
pub const PROBE_LOG: &str = "probed.txt";
/// The corrector's input for the probe.
const PROBE: u8 = 29;
/// Distance from the surface at which the probe's contact opens again, mm.
const RELEASE_MM: f64 = 0.05;

/// An axis with its drive.
#[derive(Debug, Default)]
struct Axis {
    speed_mm_s: f64,
    scale_mm: f64,
    count: i64,
    state: State,
}

impl Axis {
    /// Moves for one servo period and gives the scale's edges in order of time.
    /// Returns the position at the end of each step, mm.
    fn period(&mut self, start_ns: u64, command_mm_s: f64, mut edge: impl FnMut(u64, State)) -> Vec<f64> {
        let mut way = vec![self.scale_mm];
        let step_s = STEP_NS as f64 / 1e9;
        let mut last_ns = start_ns;
        for step in 0..SERVO_PERIOD_NS / STEP_NS {
            self.speed_mm_s += (command_mm_s - self.speed_mm_s) * step_s / DRIVE_LAG_S;
            let from = self.scale_mm * 1000.0 / COUNT_UM;
            self.scale_mm += self.speed_mm_s * step_s;
            let to = self.scale_mm * 1000.0 / COUNT_UM;
            let up = to > from;
            loop {
                let half = HYSTERESIS_COUNTS / 2.0;
                let boundary = if up { (self.count + 1) as f64 + half } else { self.count as f64 - half };
                if (up && to < boundary) || (!up && to >= boundary) {
                    break;
                }
                let part = (boundary - from) / (to - from);
                let step_ns = start_ns + step * STEP_NS;
                last_ns = (step_ns + (part * STEP_NS as f64) as u64).max(last_ns + 1);
                self.count += if up { 1 } else { -1 };
                self.state = self.state.next(up);
                edge(last_ns, self.state);
            }
            way.push(self.scale_mm);
        }
        way
    }
}

/// Scales, XOR gates and counters on a virtual clock.
#[derive(Debug)]
struct MachineCard {
    now_ns: u64,
    edges: VecDeque<Edge>,
    scale: [State; AXES],
    outputs: u64,
    probe: bool,
    counters: [Decoder; AXES],
}

impl MachineCard {
    fn count(&mut self) {
        for (n, counter) in self.counters.iter_mut().enumerate() {
            let seen = self.scale[n].inverted(AxisLines::standard(n as u8, false).inverters(self.outputs));
            if seen != counter.state() {
                counter.update(seen);
            }
        }
    }
}

impl Card for MachineCard {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let mut edge_ns = None;
        if let Some(edge) = self.edges.front().copied().filter(|edge| edge.t_ns <= wake_ns) {
            self.edges.pop_front();
            self.now_ns = self.now_ns.max(edge.t_ns);
            edge_ns = Some(edge.t_ns);
            match edge.what {
                Change::Scale(axis, state) => self.scale[axis] = state,
                Change::Probe(tripped) => self.probe = tripped,
            }
            self.count();
        } else {
            self.now_ns = self.now_ns.max(wake_ns);
        }
        let scales: u64 = self.scale.iter().enumerate().map(|(n, s)| u64::from(s.bits()) << (4 * n)).sum();
        let inputs = scales | u64::from(self.probe) << PROBE;
        Ok(CardInputSample::stamped(self.now_ns, inputs, edge_ns))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.count();
        Ok(Some(self.now_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Offsets in the card's file, as in `linuxcnc/rtec_machine.c`.
mod place {
    pub(super) const ASKED: usize = 0x00;
    pub(super) const ANSWERED: usize = 0x04;
    pub(super) const SPEED: usize = 0x08;
    pub(super) const COMMAND: usize = 0x10;
    pub(super) const COUNTS: usize = 0x18;
    pub(super) const LINES: usize = 0x20;
    pub(super) const BYTES: usize = 0x40;
}

/// Lets LinuxCNC run a program on a machine with `error`.
///
/// # Errors
/// When LinuxCNC did not run, or did not get to the program's end.
pub fn run(program: &str, error: [AxisError; AXES], job: Job) -> anyhow::Result<Run> {
    let directory = tempfile::tempdir()?;
    let card_file = directory.path().join("card");
    std::fs::write(directory.path().join("part.ngc"), program)?;
    std::fs::write(&card_file, [0; place::BYTES])?;
    let words = MappedRegisterFile::open(&card_file, place::BYTES, "LinuxCNC's machine")?;
    let mut linuxcnc = Command::new(crate::root().join("tests/linuxcnc/run-linuxcnc"))
        .arg(directory.path())
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("tests/linuxcnc/run-linuxcnc")?;
    let mut machine = Machine::new(error, job)?;
    while let Some(asked) = asked(&words, &mut linuxcnc)? {
        machine.period(&words)?;
        fence(Ordering::SeqCst);
        words.write(place::ANSWERED, Width::Bits32, asked);
    }
    let ended = linuxcnc.wait_with_output()?;
    ensure!(ended.status.success(), "LinuxCNC: {}", String::from_utf8_lossy(&ended.stderr));
    let mut run = machine.finish();
    let log = directory.path().join(PROBE_LOG);
    if log.exists() {
        run.controller_trips_mm = probe_log(&std::fs::read_to_string(log)?)?;
    }
    Ok(run)
}

/// LinuxCNC's log of straight probes: a line each, X Y Z A B C U V W.
fn probe_log(text: &str) -> anyhow::Result<Vec<[f64; AXES]>> {
    let line = |line: &str| {
        let words: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        match words?.as_slice() {
            [x, _, z, ..] => Ok([*x, *z]),
            _ => anyhow::bail!("LinuxCNC's probe log: '{line}'"),
        }
    };
    text.lines().map(line).collect()
}

/// Waits for the controller's next period; `None` when it has ended.
fn asked(words: &MappedRegisterFile, linuxcnc: &mut std::process::Child) -> anyhow::Result<Option<u32>> {
    let answered = words.read(place::ANSWERED, Width::Bits32);
    for n in 0_u32.. {
        let asked = words.read(place::ASKED, Width::Bits32);
        if asked != answered {
            fence(Ordering::SeqCst);
            return Ok(Some(asked));
        }
        if n % 64 != 63 {
            std::hint::spin_loop();
            continue;
        }
        if n % 65536 == 65535 && linuxcnc.try_wait()?.is_some() {
            break;
        }
        std::thread::sleep(Duration::from_micros(20));
    }
    Ok(None)
}

struct Machine {
    axes: [Axis; AXES],
    error: [AxisError; AXES],
    job: Job,
    probe_out: bool,
    card: MachineCard,
    engine: Engine,
    run: Run,
}

impl Machine {
    fn new(error: [AxisError; AXES], job: Job) -> anyhow::Result<Self> {
        let mut card = MachineCard {
            now_ns: 0,
            edges: VecDeque::new(),
            scale: [State::default(); AXES],
            outputs: 0,
            probe: false,
            counters: [Decoder::default(); AXES],
        };
        let axis = |n| AxisConfig {
            lines: AxisLines::standard(n, false),
            max_correction_counts: 500,
            window_counts: 20,
            hysteresis_counts: HYSTERESIS_COUNTS,
            ..AxisConfig::default()
        };
        let lines = MachineConfig {
            lines: MachineLines { probe: Some(PROBE), hold: Some(28), ..MachineLines::default() },
            may_arm: true,
        };
        let mut engine = Engine::new(&mut card, &[axis(0), axis(1)], lines, &[])?;
        engine.start_homed(&mut card, &mut |_| true)?;
        if matches!(job, Job::Probe(_)) {
            engine.take(RequestToRt::Probe(true), &mut card, &mut |_| true)?;
        }
        Ok(Self { axes: Default::default(), error, job, probe_out: false, card, engine, run: Run::default() })
    }

    fn period(&mut self, words: &MappedRegisterFile) -> anyhow::Result<()> {
        let word = |place, n| words.read(place + 4 * n, Width::Bits32) as i32;
        let start_ns = self.run.periods * SERVO_PERIOD_NS;
        let end_ns = start_ns + SERVO_PERIOD_NS;
        let mut ways = Vec::new();
        for (n, axis) in self.axes.iter_mut().enumerate() {
            let edges = &mut self.card.edges;
            ways.push(axis.period(start_ns, f64::from(word(place::SPEED, n)) / 1e6, |t_ns, state| {
                edges.push_back(Edge { t_ns, what: Change::Scale(n, state) });
            }));
        }
        if let Job::Probe(part) = self.job {
            self.touch(part, start_ns, &ways);
        }
        self.card.edges.make_contiguous().sort_by_key(|edge| edge.t_ns);

        let (complaints, events) = (&mut self.run.complaints, &mut self.run.events);
        let mut report = |event: Event| {
            use rtec_rt::link_messages::EventKind::{Fault, Refused};
            if matches!(event.kind, Fault(_) | Refused { .. }) {
                complaints.push(format!("{event:?}"));
            }
            events.push(event);
            true
        };
        if matches!(self.job, Job::Correct) {
            for (n, error) in self.error.iter().enumerate() {
                // The control side knows the error and the scale's position, and requests the nearest whole insertion.
                let p_mm = self.engine.status().axes[n].position_counts as f64 * COUNT_UM / 1000.0;
                let total_counts = 2 * (error.at(p_mm) / COUNT_UM / 2.0).round() as i64;
                let request = RequestToRt::Correct { axis: n as u8, total_counts, large: false };
                self.engine.take(request, &mut self.card, &mut report)?;
            }
        }
        while self.card.now_ns < end_ns || !self.card.edges.is_empty() {
            self.engine.poll(&mut self.card, end_ns, &mut report)?;
        }

        let mut illegal = 0;
        for (n, counter) in self.card.counters.iter().enumerate() {
            words.write(place::COUNTS + 4 * n, Width::Bits32, counter.count() as u32);
            illegal += counter.illegal();
        }
        let hold = (self.card.outputs >> 28 & 1) as u32;
        let lines = hold | u32::from(illegal > 0) << 1 | u32::from(self.card.probe) << 2;
        words.write(place::LINES, Width::Bits32, lines);
        self.run.illegal = illegal;
        self.run.periods += 1;

        let moved = self.axes.iter().any(|axis| axis.count != 0) || !self.run.tool_mm.is_empty();
        if moved {
            let each = |f: &dyn Fn(usize) -> f64| std::array::from_fn(f);
            let tool = |n: usize| {
                let p_mm = self.axes[n].scale_mm;
                p_mm + self.error[n].at(p_mm) / 1000.0
            };
            self.run.tool_mm.push(each(&tool));
            self.run.command_mm.push(each(&|n| f64::from(word(place::COMMAND, n)) / 1e6));
        }
        Ok(())
    }

    /// Finds the probe's contact along the way of one period.
    fn touch(&mut self, part: Round, start_ns: u64, ways: &[Vec<f64>]) {
        let at = |step: usize| [0, 1].map(|n| ways[n][step]);
        for step in 1..ways[0].len() {
            let (from, to) = (part.off_mm(at(step - 1)), part.off_mm(at(step)));
            let begin_ns = start_ns + (step as u64 - 1) * STEP_NS;
            if !self.probe_out && from > 0.0 && to <= 0.0 {
                let share = from / (from - to);
                let place = |n: usize| ways[n][step - 1] + (ways[n][step] - ways[n][step - 1]) * share;
                self.run.trips_mm.push([place(0), place(1)]);
                let t_ns = begin_ns + (share * STEP_NS as f64) as u64;
                self.card.edges.push_back(Edge { t_ns, what: Change::Probe(true) });
                self.probe_out = true;
            } else if self.probe_out && to > RELEASE_MM {
                self.card.edges.push_back(Edge { t_ns: begin_ns, what: Change::Probe(false) });
                self.probe_out = false;
            }
        }
    }

    fn finish(mut self) -> Run {
        let status = self.engine.status();
        for n in 0..AXES {
            self.run.scale_counts[n] = self.axes[n].count;
            self.run.mtc_counts[n] = self.card.counters[n].count();
            self.run.completed[n] = status.axes[n].completed;
            self.run.insertions += status.axes[n].insertions;
        }
        self.run
    }
}
