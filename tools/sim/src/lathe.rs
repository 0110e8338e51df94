//! A simulated turning centre at work, on which NISTIR 4854's experiment runs.
//! It has two axes, a worn tool or a touch probe in its turret, and a workpiece. The machine's errors move
//! tool and probe alike.

use crate::attended_machine::AttendedMachine;
use crate::axis::AxisSpec;
use crate::corrected_axis::GateInsertionDesign;
use crate::machine::{ControllerLimits, SERVO_NS, SimMachine};
use crate::nc_block::Block;
use crate::noise::NoiseGenerator;
use crate::thermal_network::{SENSORS, ThermalNetwork};
use crate::trajectory::AXES;
use crate::true_machine_errors::{TrueMachineErrors, layout, probe_delay_ns, set_friction};
use crate::workpiece::{ToolNose, Workpiece};
use rtec_model::effect::MissingInput;
use rtec_model::live_evaluation::LiveModel;
use rtec_model::machine::Machine;
use rtec_part::arc_finish_cut_table::AxisCountConversion;
use rtec_part::contour::Segment;
use rtec_part::geometric_fit::Zx;
use rtec_part::probe_path::{PathPoint, PathPointRole};
use serde::Deserialize;
use std::f64::consts::FRAC_PI_2;
use std::sync::{Arc, Mutex, PoisonError};

/// The machine, its tool and its probe.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatheSpec {
    /// Size of one count of either axis, µm.
    pub count_um: f64,
    /// Radius of the tool's nose, mm.
    pub nose_mm: f64,
    /// Depth of the flat ground off the nose, µm.
    pub flat_um: f64,
    /// Surface angle at which the middle of the flat cuts, rad.
    pub flat_rad: f64,
    /// Repeatability of the probe, one standard deviation, µm.
    pub probe_sd_um: f64,
    /// Roughness of the cut, one standard deviation, µm.
    pub cut_sd_um: f64,
    /// Spindle speed while cutting and while the machine warms up, rpm.
    pub rpm: f64,
    /// Temperature of the hall, and of the machine at its start, °C.
    pub ambient_degc: f64,
    /// Acceleration along the path, mm/s².
    pub accel_mm_s2: f64,
    /// Deceleration along the path, mm/s².
    pub decel_mm_s2: f64,
    /// Gain of the position loop, 1/s.
    pub gain: f64,
    /// Time between two polls of the corrector, ns.
    pub poll_ns: f64,
    /// Time between two totals from the control side, ms.
    pub control_ms: f64,
}

impl Default for LatheSpec {
    /// Like the machine of NISTIR 4854, with 1 µm counts.
    /// 25 µm are ground off a 1/32 in nose just above the centre line.
    fn default() -> Self {
        Self {
            count_um: 1.0,
            nose_mm: 0.794,
            flat_um: 25.0,
            flat_rad: 0.258,
            probe_sd_um: 0.25,
            cut_sd_um: 0.15,
            rpm: 2000.0,
            ambient_degc: 20.0,
            accel_mm_s2: 217.0,
            decel_mm_s2: 578.7,
            gain: 30.0,
            poll_ns: 1000.0,
            control_ms: 10.0,
        }
    }
}

impl LatheSpec {
    /// Checks that every value is possible for a machine.
    ///
    /// # Errors
    /// The first key that is out of range, and the range.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        type Holds = fn(f64) -> bool;
        let (positive, size, finite): (Holds, Holds, Holds) = (|v| v > 0.0, |v| v >= 0.0, |_| true);
        let keys = [
            ("count_um", self.count_um, positive, "a positive number"),
            ("nose_mm", self.nose_mm, positive, "a positive number"),
            ("accel_mm_s2", self.accel_mm_s2, positive, "a positive number"),
            ("decel_mm_s2", self.decel_mm_s2, positive, "a positive number"),
            ("gain", self.gain, positive, "a positive number"),
            ("poll_ns", self.poll_ns, positive, "a positive number"),
            ("control_ms", self.control_ms, positive, "a positive number"),
            ("flat_um", self.flat_um, size, "0 or more"),
            ("probe_sd_um", self.probe_sd_um, size, "0 or more"),
            ("cut_sd_um", self.cut_sd_um, size, "0 or more"),
            ("rpm", self.rpm, size, "0 or more"),
            ("flat_rad", self.flat_rad, finite, "a finite number"),
            ("ambient_degc", self.ambient_degc, finite, "a finite number"),
        ];
        if let Some((key, .., range)) = keys.iter().find(|(_, v, holds, _)| !(v.is_finite() && holds(*v))) {
            return Err((key, range));
        }
        if self.flat_um * 1e-3 >= self.nose_mm {
            return Err(("flat_um", "less than the nose's radius"));
        }
        if self.gain * SERVO_NS as f64 * 1e-9 > 0.5 {
            return Err(("gain", "at most 500 1/s: the position loop turns every millisecond"));
        }
        Ok(())
    }

    fn axis(&self, name: &'static str) -> AxisSpec {
        AxisSpec {
            count_um: self.count_um,
            speed_mm_s: RAPID_MM_S,
            accel_mm_s2: self.accel_mm_s2,
            decel_mm_s2: self.decel_mm_s2,
            jerk_mm_s3: JERK_MM_S3,
            position_gain_per_s: self.gain,
            // A speed loop well above the position loop, as far as the drive's time step allows.
            speed_gain_per_s: (8.0 * self.gain).clamp(600.0, 2000.0),
            // The screws are preloaded.
            backlash_um: 0.0,
            ..AxisSpec::new(name, 1000.0)
        }
    }

    fn nose(&self) -> ToolNose {
        ToolNose { radius_mm: self.nose_mm, flat_um: self.flat_um, flat_rad: self.flat_rad }
    }
}

/// Rapid traverse of the report's machine: 7 m/min.
pub const RAPID_MM_S: f64 = 116.7;
/// Jerk that lets a probing path's ramps reach their accelerations, mm/s³.
const JERK_MM_S3: f64 = 100_000.0;

/// A machine with its errors, some time after it was switched on.
#[derive(Debug, Clone, Copy)]
pub struct LatheSetup<'a> {
    /// Machine, tool and probe.
    pub bench: &'a LatheSpec,
    /// The machine's errors.
    /// They are effects of Z and X by position and temperature, and of the probe.
    pub machine: &'a Machine,
    /// Time for which the spindle has run when the program starts, s.
    pub begin_s: f64,
    /// Insertion design of the corrector.
    pub design: GateInsertionDesign,
    /// Highest count rate of the controller's decoder, Hz.
    pub decoder_hz: f64,
    /// Seed of all noise.
    pub seed: u64,
}

/// One move of the part program.
#[derive(Debug, Clone)]
pub struct ProgramMove {
    /// Path of the centre of the tool's nose or the probe's tip, in part coordinates.
    pub segment: Segment,
    /// Feed along it, mm/s.
    pub feed_mm_s: f64,
    /// The tool cuts material on this move.
    pub cutting: bool,
}

/// The probe's path as moves of the machine.
pub fn probing_moves(records: &[PathPoint], feed_mm_s: f64) -> Vec<ProgramMove> {
    records
        .windows(2)
        .filter(|w| (w[1].at - w[0].at).norm() > 1e-9)
        .map(|w| ProgramMove {
            segment: Segment::Line { a: w[0].at, b: w[1].at },
            feed_mm_s: if matches!(w[1].role, PathPointRole::Touch(_) | PathPointRole::Finish) {
                feed_mm_s
            } else {
                RAPID_MM_S
            },
            cutting: false,
        })
        .collect()
}

/// Angle by which a cut around the nose continues beyond both ends, at full speed.
pub const BEYOND_RAD: f64 = 0.025;

/// One pass around the nose with a single arc, as by `G02`.
pub fn arc_moves(centre: Zx, radius_mm: f64, feed_mm_s: f64) -> Vec<ProgramMove> {
    let segment =
        Segment::Arc { centre, radius_mm, start_rad: -BEYOND_RAD, sweep_rad: FRAC_PI_2 + 2.0 * BEYOND_RAD };
    vec![ProgramMove { segment, feed_mm_s, cutting: true }]
}

/// Names of the sensors on the machine, in the order of their readings.
pub fn sensors() -> impl Iterator<Item = &'static str> {
    SENSORS.iter().map(|s| s.0)
}

/// A position of the machine, Z and X, as X, Y, Z.
fn xyz(p: Zx) -> [f64; AXES] {
    [p.x, 0.0, p.z]
}

fn zx(p: [f64; AXES]) -> Zx {
    Zx::new(p[2], p[0])
}

/// The moves as an NC program, each with an exact stop.
/// Also returns the range of its cutting blocks, counted from 1.
fn program(
    bench: &LatheSpec,
    moves: &[ProgramMove],
    origin: Zx,
    rpm: f64,
) -> (Vec<Block>, std::ops::RangeInclusive<usize>) {
    let mut blocks = vec![Block::Spindle { rpm }];
    let (mut first, mut last) = (usize::MAX, 0);
    for m in moves {
        let (to, feed_mm_s) = (xyz(m.segment.at(1.0) + origin), m.feed_mm_s);
        blocks.push(match m.segment {
            Segment::Arc { centre, sweep_rad, .. } => {
                let centre = centre + origin;
                Block::Arc {
                    to,
                    plane: (2, 0),
                    centre: (centre.z, centre.x),
                    clockwise: sweep_rad < 0.0,
                    feed_mm_s,
                }
            }
            _ => Block::Feed { to, feed_mm_s },
        });
        if m.cutting {
            (first, last) = (first.min(blocks.len()), blocks.len());
        }
        blocks.push(Block::Dwell { seconds: 4.0 / bench.gain });
    }
    (blocks, first..=last)
}

/// A cut at one position of the nose's centre (part coordinates).
/// The second value is the part's own form there, µm.
pub(crate) type Cut = (Zx, f64);

/// The machine at work on one program.
#[derive(Debug)]
pub struct Lathe {
    machine: SimMachine,
    errors: TrueMachineErrors,
    bench: LatheSpec,
    origin: Zx,
    centre: Zx,
    /// Radius of the probe's tip; `None` with a tool in the turret.
    tip_mm: Option<f64>,
    begin_s: f64,
    /// The program, while it waits for cycle start (the release of feed hold).
    waiting: Option<Vec<Block>>,
    held: bool,
    cutting: std::ops::RangeInclusive<usize>,
    block: usize,
    /// The cuts so far; a user of the shared list takes them from it.
    pub(crate) cuts: Arc<Mutex<Vec<Cut>>>,
    last_cut: Option<Zx>,
    /// The tip's centre by the scales (part coordinates) and the sensors at each trip.
    pub(crate) trips: Vec<(Zx, Vec<f64>)>,
    noise: NoiseGenerator,
    touch_mm: f64,
    /// The sensors while the machine warmed up: time since its start, s, and °C.
    pub(crate) past: Vec<(f64, Vec<f64>)>,
}

impl Lathe {
    /// A machine at rest at `start` (machine mm), after the stand's warm-up time.
    /// Its program is for a probe with `tip_mm`, or for the tool.
    pub(crate) fn new(
        stand: &LatheSetup,
        start: Zx,
        origin: Zx,
        moves: &[ProgramMove],
        tip_mm: Option<f64>,
        part: &Workpiece,
    ) -> Result<Self, MissingInput> {
        let bench = stand.bench;
        let controller = ControllerLimits { decoder_hz: stand.decoder_hz, ..ControllerLimits::default() };
        let mut machine = SimMachine::new(&[bench.axis("z"), bench.axis("x")], controller, xyz(start));
        set_friction(&mut machine, &stand.machine.effects().collect::<Vec<_>>());
        if tip_mm.is_some() {
            let shape = part.clone();
            let surface = move |tip| shape.distance_mm(zx(tip) - origin);
            machine.set_surface(Some(Box::new(surface)), probe_delay_ns(stand.machine.effects()));
        }
        // The spindle is at rest while the machine probes.
        let rpm = if tip_mm.is_some() { 0.0 } else { bench.rpm };
        let (blocks, cutting) = program(bench, moves, origin, rpm);
        let truth = LiveModel::of(stand.machine, layout(Vec::new()))?;
        let errors = TrueMachineErrors::new(
            truth,
            ThermalNetwork::cold(bench.ambient_degc, 0.0, stand.seed),
            stand.seed,
        );
        let mut lathe = Self {
            machine,
            errors,
            bench: bench.clone(),
            origin,
            centre: part.centre,
            tip_mm,
            begin_s: stand.begin_s,
            waiting: Some(blocks),
            held: false,
            cutting,
            block: 0,
            cuts: Arc::default(),
            last_cut: None,
            trips: Vec::new(),
            noise: NoiseGenerator::new(stand.seed, 0x1A7E),
            touch_mm: 0.0,
            past: Vec::new(),
        };
        lathe.warm_up();
        Ok(lathe)
    }

    /// Warms the machine up from cold, with the spindle running.
    fn warm_up(&mut self) {
        for second in 0..self.begin_s as u64 {
            let t_s = second as f64;
            self.errors.heat.advance(t_s, self.bench.rpm, false);
            self.errors.act(t_s, &mut self.machine, &[0.0; AXES], 0.0);
            self.past.push((t_s, self.errors.heat.readings_degc().to_vec()));
        }
        self.act();
    }

    pub(crate) fn readings(&self) -> impl Iterator<Item = f64> {
        self.errors.readings(&self.machine, [0.0; AXES])
    }

    /// Time since the machine was switched on, s.
    pub(crate) fn t_s(&self) -> f64 {
        self.begin_s + self.machine.now_ns() as f64 * 1e-9
    }

    /// Position of the turret by the scales, part coordinates.
    fn on_scale(&self) -> Zx {
        Zx::new(self.machine.position_mm(0), self.machine.position_mm(1)) - self.origin
    }

    /// Applies the errors at the machine's present position.
    fn act(&mut self) {
        let angle_rad = (self.on_scale() - self.centre).angle_rad();
        self.errors.act(self.t_s(), &mut self.machine, &[0.0; AXES], angle_rad);
        let (_, probe_um) = self.errors.radial_um();
        self.machine.probe_reach_mm = self.tip_mm.unwrap_or(0.0) + self.touch_mm + probe_um * 1e-3;
    }

    /// Cycle start: loads the program, which runs from its first block.
    pub(crate) fn start(&mut self) {
        self.machine.load(self.waiting.take().into_iter().flatten());
    }

    pub(crate) fn finished(&self) -> bool {
        self.waiting.is_none() && self.machine.finished()
    }

    fn cut(&mut self) {
        let place = zx(self.machine.tool_mm()) - self.origin;
        if self.last_cut.is_none_or(|p| (p - place).norm() > 0.02) {
            self.last_cut = Some(place);
            let (form_um, _) = self.errors.radial_um();
            self.cuts.lock().unwrap_or_else(PoisonError::into_inner).push((place, form_um));
        }
    }
}

impl AttendedMachine for Lathe {
    fn machine(&self) -> &SimMachine {
        &self.machine
    }

    fn machine_mut(&mut self) -> &mut SimMachine {
        &mut self.machine
    }

    fn tick(&mut self) {
        self.errors.heat.advance(self.t_s(), self.machine.rpm, false);
        if self.block != self.machine.begun {
            self.block = self.machine.begun;
            self.touch_mm = self.bench.probe_sd_um * 1e-3 * self.noise.normal();
        }
        self.act();
        if self.cutting.contains(&self.block) {
            self.cut();
        }
        let (trips, at_mm) = self.machine.trips;
        if trips > self.trips.len() {
            self.trips.push((zx(at_mm) - self.origin, self.errors.heat.readings_degc().to_vec()));
        }
        let held = std::mem::replace(&mut self.held, self.machine.hold);
        if held && !self.held && self.waiting.is_some() {
            self.start();
        }
    }
}

/// Removes the tool's cuts from a part, including roughness.
pub(crate) fn cut_away(part: &mut Workpiece, bench: &LatheSpec, cuts: &[Cut], seed: u64) {
    let mut noise = NoiseGenerator::new(seed, 0xC07);
    for &(place, form_um) in cuts {
        part.cut(bench.nose(), place, bench.cut_sd_um * noise.normal() - form_um);
    }
}

/// The design of this name, if it can correct the lathe: `original`, `a` or `c`.
pub fn design(name: &str) -> Option<GateInsertionDesign> {
    match name {
        "original" => Some(GateInsertionDesign::Original),
        "a" => Some(GateInsertionDesign::A),
        "c" => Some(GateInsertionDesign::C),
        _ => None,
    }
}

/// Counts of Z and of X on this bench, for a design's increment.
pub fn axes(bench: &LatheSpec, design: GateInsertionDesign) -> [AxisCountConversion; 2] {
    [AxisCountConversion { count_um: bench.count_um, increment: design.increment_counts(), sign: 1.0 }; 2]
}
