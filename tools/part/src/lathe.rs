//! A simulated turning centre for the unchanged engine: two axes under a controller that counts what the gates send
//! it, a tool that cuts what it reaches, a touch probe. NISTIR 4854's experiment runs on it. What the machine does wrong
//! are the effects of a `machine.toml`, under the heat of `rtec-sim`; they move whatever the turret carries, tool and
//! probe alike.

use crate::contour::Segment;
use crate::errors::PointError;
use crate::fit::Zx;
use crate::table::{AxisCounts, Cut, Holding, Table};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample};
use rtec_driver::mock::Wires;
use rtec_driver::quadrature::{Decoder, State};
use rtec_files::InputError;
use rtec_files::Sheet;
use rtec_model::effect::Missing;
use rtec_model::live::{AxisNow, Frame, Layout, Live};
use rtec_model::machine::Machine;
use rtec_model::record::Axis;
use rtec_rt::axis::{AxisConfig, Design};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{Event, Request, Status};
use rtec_sim::heat::{Heat, SENSORS};
use serde::Deserialize;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The machine, its tool and its probe.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bench {
    /// What one count of either axis is worth.
    pub count_um: f64,
    /// Radius of the tool's nose.
    pub nose_mm: f64,
    /// Ground off the nose: the depth of the flat.
    pub flat_um: f64,
    /// The surface angle that the middle of the flat cuts.
    pub flat_rad: f64,
    /// Repeatability of the probe, one standard deviation.
    pub probe_sd_um: f64,
    /// Roughness of the cut, one standard deviation.
    pub cut_sd_um: f64,
    /// Spindle speed while cutting, and while the machine warms up.
    pub rpm: f64,
    /// Temperature of the hall, and of the machine when it is started.
    pub ambient_degc: f64,
    /// Acceleration along the path.
    pub accel_mm_s2: f64,
    /// Deceleration along the path.
    pub decel_mm_s2: f64,
    /// Gain of the position loop, 1/s.
    pub gain: f64,
    /// Between two looks of the corrector, ns.
    pub poll_ns: f64,
    /// Between two totals from the control side, ms.
    pub control_ms: f64,
}

impl Default for Bench {
    /// Like the machine of NISTIR 4854: 1 µm counts, 25 µm ground off a 1/32 in nose just above the centre line.
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

impl Bench {
    /// Is every value one that a machine can have?
    ///
    /// # Errors
    /// The first key that is out of range and what is expected of it.
    pub fn check(&self) -> Result<(), (&'static str, &'static str)> {
        let positive = [
            ("count_um", self.count_um),
            ("nose_mm", self.nose_mm),
            ("accel_mm_s2", self.accel_mm_s2),
            ("decel_mm_s2", self.decel_mm_s2),
            ("gain", self.gain),
            ("poll_ns", self.poll_ns),
            ("control_ms", self.control_ms),
        ];
        if let Some((key, _)) = positive.iter().find(|(_, v)| !(v.is_finite() && *v > 0.0)) {
            return Err((key, "a positive number"));
        }
        let sizes = [
            ("flat_um", self.flat_um),
            ("probe_sd_um", self.probe_sd_um),
            ("cut_sd_um", self.cut_sd_um),
            ("rpm", self.rpm),
        ];
        if let Some((key, _)) = sizes.iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
            return Err((key, "0 or more"));
        }
        let finite = [("flat_rad", self.flat_rad), ("ambient_degc", self.ambient_degc)];
        if let Some((key, _)) = finite.iter().find(|(_, v)| !v.is_finite()) {
            return Err((key, "a finite number"));
        }
        if self.flat_um * 1e-3 >= self.nose_mm {
            return Err(("flat_um", "less than the nose's radius"));
        }
        if self.gain * TICK_NS * 1e-9 > 0.5 {
            return Err(("gain", "at most 500 1/s: the position loop turns every millisecond"));
        }
        Ok(())
    }
}

/// One move of the part program.
#[derive(Debug, Clone)]
pub struct Move {
    /// Where along, in part coordinates of the tool's nose centre or the probe's tip centre.
    pub segment: Segment,
    /// At which feed.
    pub feed_mm_s: f64,
    /// Material is cut.
    pub cutting: bool,
    /// The probe touches.
    pub touching: bool,
}

/// The workpiece: its radius about the arc's centre by angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Workpiece {
    /// Centre of the arc in part coordinates.
    pub centre: Zx,
    radius_mm: Vec<f64>,
}

/// Angles of the workpiece: a little beyond the quadrant on both sides.
const LOW_RAD: f64 = -0.03;
const STEP_RAD: f64 = 5e-4;
const STEPS: usize = 3263;

impl Workpiece {
    /// A raw part.
    #[must_use]
    pub fn raw(centre: Zx, radius_mm: f64) -> Self {
        Self { centre, radius_mm: vec![radius_mm; STEPS] }
    }

    /// Radius at an angle.
    #[must_use]
    pub fn radius_mm(&self, angle_rad: f64) -> f64 {
        let at = ((angle_rad - LOW_RAD) / STEP_RAD - 0.5).clamp(0.0, (STEPS - 2) as f64);
        let (k, part) = (at as usize, at.fract());
        self.radius_mm[k] * (1.0 - part) + self.radius_mm[k + 1] * part
    }

    /// Errors of the surface against the nominal circle, as a measuring machine off the machine would find them.
    #[must_use]
    pub fn truth(&self, radius_mm: f64, number: usize) -> Vec<PointError> {
        (0..number)
            .map(|k| {
                let angle_rad = FRAC_PI_2 * k as f64 / (number - 1) as f64;
                PointError {
                    angle_rad,
                    error_um: (self.radius_mm(angle_rad) - radius_mm) * 1e3,
                    along_mm: None,
                }
            })
            .collect()
    }

    /// A workpiece on file: radii at even steps of angle about one centre.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = "centre_z_mm,centre_x_mm,radius_mm\n".to_owned();
        for r in &self.radius_mm {
            let _ = writeln!(text, "{},{},{r:.7}", self.centre.z, self.centre.x);
        }
        text
    }

    /// Reads such a file.
    ///
    /// # Errors
    /// As [`Sheet::read`]; not a workpiece's number of radii.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let sheet = Sheet::read(file, &["centre_z_mm", "centre_x_mm", "radius_mm"], |_| false)?;
        let (z, x) = (sheet.numbers("centre_z_mm")?, sheet.numbers("centre_x_mm")?);
        let centre = z.first().zip(x.first()).map_or(Zx::new(0.0, 0.0), |(&z, &x)| Zx::new(z, x));
        let radii = sheet.numbers("radius_mm")?;
        let found = format!("{} radii", radii.len());
        Self::from_radii(centre, radii)
            .ok_or_else(|| InputError::whole(file, found, "a workpiece as `part finish` writes it"))
    }

    /// A workpiece from kept radii; `None` where their number is not a workpiece's.
    #[must_use]
    pub fn from_radii(centre: Zx, radius_mm: Vec<f64>) -> Option<Self> {
        (radius_mm.len() == STEPS && radius_mm.iter().all(|r| r.is_finite()))
            .then_some(Self { centre, radius_mm })
    }

    /// Take away what the nose reaches from one place of its centre.
    fn cut(&mut self, bench: &Bench, nose_centre: Zx, rough_um: f64) {
        let facing = (nose_centre - self.centre).angle_rad();
        let nose = bench.nose_mm + rough_um * 1e-3;
        for k in -175..=175 {
            let angle = facing + f64::from(k) * 2e-3;
            let flat = (bench.nose_mm - bench.flat_um * 1e-3) / (angle - bench.flat_rad).cos();
            let reach = if flat > 0.0 { nose.min(flat) } else { nose };
            let p = nose_centre - Zx::at_angle(angle) * reach - self.centre;
            let at = (p.angle_rad() - LOW_RAD) / STEP_RAD;
            if at >= 0.0
                && let Some(radius) = self.radius_mm.get_mut(at as usize)
            {
                *radius = radius.min(p.norm());
            }
        }
    }
}

/// Seeded normal deviates.
#[derive(Debug)]
struct Noise(Xoshiro256PlusPlus);

impl Noise {
    fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        let (u, v) = (self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }
}

/// Names of the sensors on the machine, in the order of [`Ran::degc`].
pub fn sensors() -> impl Iterator<Item = &'static str> {
    SENSORS.iter().map(|s| s.0)
}

/// A machine's errors as time goes on: the effects of its model, fed by the heat.
#[derive(Debug)]
struct Errors {
    live: Live,
    heat: Heat,
    rpm: f64,
    direction: [f64; 2],
}

impl Errors {
    /// Switched on cold, the spindle running until `begin_s`; from then on at `rpm`.
    fn new(stand: &Stand, machine: &Machine, rpm: f64, place: Zx) -> Result<Self, Missing> {
        let axes = ["z", "x"].into_iter().filter_map(Axis::new).collect();
        let layout = Layout { axes, sensors: sensors().map(str::to_owned).collect(), channels: Vec::new() };
        let live = Live::of(machine, layout)?;
        let heat = Heat::cold(stand.bench.ambient_degc, 0.0, stand.seed);
        let mut errors = Self { live, heat, rpm: stand.bench.rpm, direction: [0.0; 2] };
        for second in 0..stand.begin_s as u64 {
            errors.at(second as f64, place, Zx::new(0.0, 0.0), 0.0);
        }
        errors.rpm = rpm;
        Ok(errors)
    }

    /// Errors of Z and X where the machine is, in mm; the probe's own, radially, in µm.
    fn at(&mut self, t_s: f64, machine: Zx, velocity_mm_s: Zx, angle_rad: f64) -> (Zx, f64) {
        self.heat.advance(t_s, self.rpm, false);
        let mut axes = [(machine.z, velocity_mm_s.z), (machine.x, velocity_mm_s.x)]
            .map(|(position_mm, velocity_mm_s)| AxisNow::moving(position_mm, velocity_mm_s));
        for (axis, last) in axes.iter_mut().zip(&mut self.direction) {
            // At rest an axis keeps the direction of its last motion.
            axis.direction = if axis.direction == 0.0 { *last } else { axis.direction };
            *last = axis.direction;
        }
        self.live.evaluate(&Frame {
            t_s,
            axes: &axes,
            temperatures_degc: self.heat.readings_degc(),
            rpm: self.rpm,
            angle_rad,
            ..Frame::default()
        });
        let &[z, x] = self.live.errors_um() else { return (Zx::new(0.0, 0.0), 0.0) };
        (Zx::new(z, x) * 1e-3, self.live.radial_um())
    }
}

/// One axis: the slide's true place on the scale, and what the controller counts.
#[derive(Debug)]
struct Slide {
    /// Place in counts.
    at: f64,
    /// Counts per ns.
    velocity: f64,
    /// The scale's count.
    count: i64,
    scale: State,
    inverters: u8,
    mtc: Decoder,
    /// The MTC's count at its decoder's zero.
    mtc_zero: i64,
    lines: AxisLines,
}

/// The scale's hysteresis, counts.
const HYSTERESIS: f64 = 0.1;

impl Slide {
    fn new(at: f64, lines: AxisLines) -> Self {
        let (scale, count) = (State::default(), at.floor() as i64);
        Self {
            at,
            velocity: 0.0,
            count,
            scale,
            inverters: 0,
            mtc: Decoder::new(scale),
            mtc_zero: count,
            lines,
        }
    }

    /// The gates' second inputs are now these.
    fn set_inverters(&mut self, outputs: u64) {
        let inverters = self.lines.inverters(outputs);
        if inverters != self.inverters {
            self.inverters = inverters;
            self.tell_mtc();
        }
    }

    fn inputs(&self) -> u64 {
        let mut inputs =
            u64::from(self.scale.a()) << self.lines.a | u64::from(self.scale.b()) << self.lines.b;
        if let Some((a, b)) = self.lines.read_back {
            let out = self.scale.inverted(self.inverters);
            inputs |= u64::from(out.a()) << a | u64::from(out.b()) << b;
        }
        inputs
    }

    /// Time until the next edge, ns.
    fn edge_in(&self) -> f64 {
        let target =
            if self.velocity > 0.0 { self.count as f64 + 1.0 } else { self.count as f64 - HYSTERESIS };
        if self.velocity == 0.0 { f64::INFINITY } else { ((target - self.at) / self.velocity).max(0.0) }
    }

    fn cross(&mut self) {
        let up = self.velocity > 0.0;
        self.count += if up { 1 } else { -1 };
        self.scale = self.scale.next(up);
        self.tell_mtc();
    }

    fn tell_mtc(&mut self) {
        self.mtc.update(State::from_bits(self.scale.bits() ^ self.inverters));
    }

    fn mtc_count(&self) -> i64 {
        self.mtc_zero + self.mtc.count()
    }
}

/// The machine as the engine sees it: a card on a virtual clock.
#[derive(Debug)]
struct Lathe {
    bench: Bench,
    moves: Vec<Move>,
    origin: Zx,
    part: Workpiece,
    tip_mm: f64,
    slides: [Slide; 2],
    errors: Errors,
    /// Machine time at the start, and what the errors are now.
    begin_s: f64,
    off_mm: Zx,
    lobing_mm: f64,
    outputs: u64,
    t_ns: f64,
    tick_ns: f64,
    look_ns: f64,
    second_look_ns: Option<f64>,
    /// The running move, how far into it the controller is, and how fast its time goes: feed hold brings it to zero.
    at_move: usize,
    into_ns: f64,
    pace: f64,
    held: bool,
    tripped: bool,
    trip_ns: Option<f64>,
    trip_noise_mm: f64,
    /// Tool places while cutting, part coordinates.
    cut: Vec<Zx>,
    /// Where the tip's centre truly was on the scales at each trip.
    trips: Vec<Zx>,
    /// What the sensors read then.
    degc: Vec<Vec<f64>>,
    noise: Noise,
}

/// Period of the controller's position loop, ns.
const TICK_NS: f64 = 1e6;
const PROBE_LINE: u8 = 28;
/// Feed hold brings the path to rest, and lets it go, in so many turns of the position loop.
const HOLD_TURNS: f64 = 50.0;

impl Lathe {
    fn new(
        stand: &Stand,
        lines: [AxisLines; 2],
        start: Zx,
        origin: Zx,
        moves: Vec<Move>,
        probing: Option<f64>,
        part: Workpiece,
    ) -> Result<Self, Missing> {
        let counts = |mm: f64| mm * 1e3 / stand.bench.count_um;
        // The spindle stands while the machine probes.
        let rpm = if probing.is_some() { 0.0 } else { stand.bench.rpm };
        Ok(Self {
            bench: stand.bench.clone(),
            moves,
            origin,
            part,
            tip_mm: probing.unwrap_or(0.0),
            slides: [Slide::new(counts(start.z), lines[0]), Slide::new(counts(start.x), lines[1])],
            errors: Errors::new(stand, stand.machine, rpm, start)?,
            begin_s: stand.begin_s,
            off_mm: Zx::new(0.0, 0.0),
            lobing_mm: 0.0,
            outputs: 0,
            t_ns: 0.0,
            tick_ns: TICK_NS,
            look_ns: 0.0,
            second_look_ns: None,
            at_move: 0,
            into_ns: 0.0,
            pace: 1.0,
            held: false,
            tripped: false,
            trip_ns: None,
            trip_noise_mm: 0.0,
            cut: Vec::new(),
            trips: Vec::new(),
            degc: Vec::new(),
            noise: Noise(Xoshiro256PlusPlus::seed_from_u64(stand.seed)),
        })
    }

    fn set_outputs(&mut self, outputs: u64) {
        self.outputs = outputs;
        self.slides.iter_mut().for_each(|s| s.set_inverters(outputs));
    }

    fn inputs(&self) -> u64 {
        self.slides.iter().map(Slide::inputs).sum()
    }

    /// The errors where the machine is now.
    fn feel(&mut self) {
        let per_count_mm = self.bench.count_um * 1e-3;
        let [z, x] = [0, 1].map(|n| self.slides[n].velocity * per_count_mm * 1e9);
        let here = self.on_scale();
        let angle_rad = (here - self.part.centre).angle_rad();
        let t_s = self.begin_s + self.t_ns * 1e-9;
        let (off_mm, lobing_um) = self.errors.at(t_s, here + self.origin, Zx::new(z, x), angle_rad);
        self.off_mm = off_mm;
        self.lobing_mm = lobing_um * 1e-3;
    }

    fn mm(&self, slide: usize) -> f64 {
        self.slides[slide].at * self.bench.count_um * 1e-3
    }

    /// The turret's place on the scales, part coordinates.
    fn on_scale(&self) -> Zx {
        Zx::new(self.mm(0), self.mm(1)) - self.origin
    }

    /// Where it truly is: the machine's own error moves it.
    fn truly(&self, on_scale: Zx) -> Zx {
        on_scale + self.off_mm
    }

    /// Distance from the tip to the surface.
    fn off_surface_mm(&self, on_scale: Zx) -> f64 {
        let p = self.truly(on_scale) - self.part.centre;
        p.norm() - self.part.radius_mm(p.angle_rad()) - self.tip_mm - self.trip_noise_mm - self.lobing_mm
    }

    /// Where the program wants the axes, part coordinates; `None` once it is at its end.
    fn wanted(&self, into_ns: f64) -> Option<Zx> {
        let m = self.moves.get(self.at_move)?;
        let t = into_ns * 1e-9;
        let (a, d, length) = (self.bench.accel_mm_s2, self.bench.decel_mm_s2, m.segment.length_mm());
        // A short move does not reach its feed.
        let v = m.feed_mm_s.min((2.0 * length / (1.0 / a + 1.0 / d)).sqrt());
        let (up_s, down_s) = (v / a, v / d);
        let cruise_s = (length - v * (up_s + down_s) / 2.0).max(0.0) / v;
        let s = if t < up_s {
            a * t * t / 2.0
        } else if t < up_s + cruise_s {
            v * (t - up_s / 2.0)
        } else {
            let left_s = (up_s + cruise_s + down_s - t).max(0.0);
            length - d * left_s * left_s / 2.0
        };
        Some(m.segment.at((s / length).clamp(0.0, 1.0)))
    }

    /// The move is over and the axes have come to rest.
    fn move_s(&self) -> f64 {
        let m = &self.moves[self.at_move];
        let (a, d, length) = (self.bench.accel_mm_s2, self.bench.decel_mm_s2, m.segment.length_mm());
        let v = m.feed_mm_s.min((2.0 * length / (1.0 / a + 1.0 / d)).sqrt());
        let ramps_s = v / a + v / d;
        // A little longer for the position loop to settle.
        ramps_s + (length - v * ramps_s / 2.0).max(0.0) / v + 4.0 / self.bench.gain
    }

    /// One turn of the controller's position loop. `false` at the program's end.
    fn servo(&mut self) -> bool {
        self.into_ns += TICK_NS * self.pace;
        let wish = if self.held { 0.0 } else { 1.0 };
        self.pace += (wish - self.pace).clamp(-1.0 / HOLD_TURNS, 1.0 / HOLD_TURNS);
        if self.at_move < self.moves.len() && self.into_ns * 1e-9 >= self.move_s() {
            self.at_move += 1;
            self.into_ns = 0.0;
            self.trip_noise_mm = self.bench.probe_sd_um * 1e-3 * self.noise.normal();
        }
        let (Some(now), Some(next)) =
            (self.wanted(self.into_ns), self.wanted(self.into_ns + TICK_NS * self.pace))
        else {
            self.slides.iter_mut().for_each(|s| s.velocity = 0.0);
            return false;
        };
        let (now, next) = (now + self.origin, next + self.origin);
        for (slide, (now, next)) in self.slides.iter_mut().zip([(now.z, next.z), (now.x, next.x)]) {
            let per_count_mm = self.bench.count_um * 1e-3;
            let seen_mm = (slide.mtc_count() as f64 + 0.5) * per_count_mm;
            let mm_s = (next - now) / (TICK_NS * 1e-9) + self.bench.gain * (now - seen_mm);
            slide.velocity = mm_s / per_count_mm * 1e-9;
        }
        self.feel();
        let m = &self.moves[self.at_move];
        if m.cutting {
            let place = self.truly(self.on_scale());
            if self.cut.last().is_none_or(|p| (*p - place).norm() > 0.02) {
                self.cut.push(place);
            }
        }
        self.trip_ns = None;
        let here = self.on_scale();
        if self.tripped {
            self.tripped = self.off_surface_mm(here) < 0.05;
        } else if m.touching {
            let velocity =
                Zx::new(self.slides[0].velocity, self.slides[1].velocity) * (self.bench.count_um * 1e-3);
            let off_at = |ns: f64| self.off_surface_mm(here + velocity * ns);
            if off_at(0.0) > 0.0 && off_at(TICK_NS) <= 0.0 {
                let (mut low, mut high) = (0.0, TICK_NS);
                for _ in 0..60 {
                    let middle = f64::midpoint(low, high);
                    if off_at(middle) > 0.0 { low = middle } else { high = middle }
                }
                self.trip_ns = Some(self.t_ns + high);
            }
        }
        true
    }

    /// The next change of a line before the loop's next turn.
    fn next_change_ns(&self) -> f64 {
        let edge = self.slides.iter().map(Slide::edge_in).fold(f64::INFINITY, f64::min) + self.t_ns;
        edge.min(self.trip_ns.unwrap_or(f64::INFINITY))
    }

    /// Let time pass. `false` at the program's end.
    fn advance(&mut self, to_ns: f64) -> bool {
        while self.t_ns < to_ns {
            let edges = [0, 1].map(|i| self.t_ns + self.slides[i].edge_in());
            let trip = self.trip_ns.unwrap_or(f64::INFINITY);
            let next = edges[0].min(edges[1]).min(trip).min(self.tick_ns).min(to_ns);
            for slide in &mut self.slides {
                slide.at += slide.velocity * (next - self.t_ns);
            }
            self.t_ns = next;
            for (slide, edge) in self.slides.iter_mut().zip(edges) {
                if edge <= next {
                    slide.cross();
                }
            }
            if trip <= next {
                self.trip_ns = None;
                self.tripped = true;
                self.trips.push(self.on_scale());
                self.degc.push(self.errors.heat.readings_degc().to_vec());
            }
            if self.tick_ns <= next {
                self.tick_ns += TICK_NS;
                if !self.servo() {
                    return false;
                }
            }
        }
        true
    }
}

impl Card for Lathe {
    /// A polled card: of all looks only the one before a change and the one that sees it are shown.
    fn sample(&mut self, wake_ns: u64) -> Result<Sample, CardError> {
        let look_ns = if let Some(look_ns) = self.second_look_ns.take() {
            look_ns
        } else {
            let wake_ns = (wake_ns as f64).max(self.look_ns + self.bench.poll_ns);
            while self.next_change_ns() > self.tick_ns && self.tick_ns < wake_ns {
                if !self.advance(self.tick_ns) {
                    return Err(CardError::Ended);
                }
            }
            let change_ns = self.next_change_ns();
            if change_ns > wake_ns {
                wake_ns
            } else {
                let before_ns = change_ns - self.bench.poll_ns * self.noise.uniform();
                // Nothing has changed since the last look: one just before the change may lie in the past.
                if before_ns > self.look_ns + 1.0 {
                    self.second_look_ns = Some(before_ns + self.bench.poll_ns);
                    before_ns
                } else {
                    self.look_ns + self.bench.poll_ns
                }
            }
        };
        if !self.advance(look_ns) {
            return Err(CardError::Ended);
        }
        let inputs = self.inputs() | u64::from(self.tripped) << PROBE_LINE;
        self.look_ns = look_ns;
        Ok(Sample { complete: u64::MAX, ..Sample::level(look_ns.ceil() as u64, inputs) })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.set_outputs(self.outputs & !mask | value & mask);
        Ok(Some(self.look_ns.ceil() as u64))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// What a program on the machine is run for.
#[derive(Debug, Clone, Copy)]
pub enum Job<'a> {
    /// Cut without corrections.
    Cut,
    /// Cut with the corrections of a table, of a machine model, or of both: totals asked this long ahead, s.
    Corrected(Option<&'a Table>, Option<&'a Machine>, f64),
    /// Probe with a tip of this radius, mm.
    Probe(f64),
}

/// What came of a program.
#[derive(Debug, Clone)]
pub struct Ran {
    /// Everything the engine said.
    pub events: Vec<Event>,
    /// The engine at the end.
    pub status: Status,
    /// How long it took.
    pub seconds: f64,
    /// The controller's own count minus the scale's, Z and X, by the machine's decoders, not the engine's.
    pub mtc_minus_scale: [i64; 2],
    /// Where the tip's centre was on the scales at each trip, part coordinates: the truth to hold captures against.
    pub trips: Vec<Zx>,
    /// What the sensors read at each trip, °C.
    pub degc: Vec<Vec<f64>>,
}

/// A machine with its errors, switched on so long ago.
#[derive(Debug, Clone, Copy)]
pub struct Stand<'a> {
    /// Machine, tool and probe.
    pub bench: &'a Bench,
    /// What it does wrong: effects of Z and X by position and temperature, and of the probe.
    pub machine: &'a Machine,
    /// The spindle has run for so long when the program starts.
    pub begin_s: f64,
    /// The corrector's design.
    pub design: Design,
    /// Seed of everything that is random.
    pub seed: u64,
}

/// Why a program did not run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The engine refused to start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// No move at all.
    #[error("the program has no move")]
    NoMove,
    /// An effect reads what this machine does not have.
    #[error("{0}; the simulated lathe has the axes z and x and the sensors T1 to T20")]
    Machine(String),
}

impl From<Missing> for RunError {
    fn from(m: Missing) -> Self {
        Self::Machine(format!("effect {} reads {}", m.effect, m.what))
    }
}

/// Run a program on the machine with the engine between scales and controller. The workpiece is what is left.
///
/// # Errors
/// The engine refuses the configuration, or there is no move.
pub fn run(
    stand: &Stand,
    cut: &Cut,
    moves: &[Move],
    job: Job,
    part: &mut Workpiece,
) -> Result<Ran, RunError> {
    let Stand { bench, design, .. } = *stand;
    let first = moves.first().ok_or(RunError::NoMove)?.segment.at(0.0) + cut.origin;
    let lines = [0, 1].map(|n| AxisLines::standard(n, false));
    let probing = if let Job::Probe(tip_mm) = job { Some(tip_mm) } else { None };
    let mut lathe = Lathe::new(stand, lines, first, cut.origin, moves.to_vec(), probing, part.clone())?;
    let homes = [lathe.slides[0].count, lathe.slides[1].count];
    let mut known = match job {
        Job::Corrected(_, Some(model), _) => Some(Errors::new(stand, model, bench.rpm, first)?),
        _ => None,
    };
    let axes = axes(bench, design);
    let axis = |n: u8| AxisConfig {
        lines: lines[usize::from(n)],
        design,
        window_counts: 64,
        hysteresis_counts: HYSTERESIS / 2.0,
        detect_ns: 2 * bench.poll_ns as u64,
        write_ns: bench.poll_ns as u64,
        ..AxisConfig::default()
    };
    let lines = MachineLines { probe: Some(PROBE_LINE), ..MachineLines::default() };
    let machine = MachineConfig { lines, may_arm: true };
    let mut engine = Engine::new(&mut lathe, &[axis(0), axis(1)], machine, &[])?;
    let mut events = Vec::new();
    let mut tell = |event: Event| {
        events.push(event);
        true
    };
    let mut orders = vec![Request::Enable];
    for (n, &position_counts) in homes.iter().enumerate().rev() {
        let axis = n as u8;
        orders.splice(
            0..0,
            [Request::Home { axis, position_counts }, Request::ConfirmHome { axis, position_counts }],
        );
    }
    if matches!(job, Job::Probe(_)) {
        orders.push(Request::Probe(true));
    }
    for order in orders {
        engine.take(order, &mut lathe, &mut tell).map_err(StartError::Card)?;
    }
    let mut held = [Holding::default(); 2];
    let (mut control_ns, mut last) = (0_u64, None::<(f64, Zx)>);
    let period_ns = (bench.control_ms * 1e6) as u64;
    loop {
        match engine.poll(&mut lathe, control_ns.max(1), &mut tell) {
            Ok(()) => {}
            Err(CardError::Ended) => break,
            Err(error) => return Err(StartError::Card(error).into()),
        }
        let now_ns = engine.now_ns();
        if now_ns < control_ns {
            continue;
        }
        control_ns = now_ns + period_ns;
        let Job::Corrected(table, _, lead_s) = job else { continue };
        let status = engine.status();
        let mm = |n: usize| (status.axes[n].position_counts as f64 + 0.5) * bench.count_um * 1e-3;
        let (t_s, place) = (now_ns as f64 * 1e-9, Zx::new(mm(0), mm(1)));
        let velocity = last.map_or(Zx::new(0.0, 0.0), |(t, p)| (place - p) * (1.0 / (t_s - t)));
        let first = last.replace((t_s, place)).is_none();
        let mut wanted = table.map_or(Zx::new(0.0, 0.0), |t| t.components_um(place, velocity, lead_s));
        if let Some(known) = &mut known {
            let (off_mm, _) = known.at(stand.begin_s + t_s, place + velocity * lead_s, velocity, 0.0);
            wanted = wanted + off_mm * 1e3;
        }
        for (n, error_um) in [wanted.z, wanted.x].into_iter().enumerate() {
            let total_counts = held[n].request(&axes[n], error_um);
            // The first total of a machine that is off already is meant, however large.
            let order = Request::Correct { axis: n as u8, total_counts, large: first };
            engine.take(order, &mut lathe, &mut tell).map_err(StartError::Card)?;
        }
    }
    let status = engine.status();
    let mtc_minus_scale = [0, 1].map(|n: usize| lathe.slides[n].mtc_count() - lathe.slides[n].count);
    let (seconds, trips, degc) = (lathe.t_ns * 1e-9, lathe.trips, lathe.degc);
    let (places, mut noise) = (lathe.cut, lathe.noise);
    for place in places {
        let rough_um = bench.cut_sd_um * noise.normal();
        part.cut(bench, place, rough_um);
    }
    Ok(Ran { events, status, seconds, mtc_minus_scale, trips, degc })
}

/// The machine in real time, at the other end of a mock card's wires: its controller runs one program, once, from the
/// axes' home places, and honours feed hold. Cycle start is the release of feed hold.
#[derive(Debug)]
pub struct LatheWires {
    lathe: Lathe,
    probe: u64,
    hold: u64,
    start_ns: Option<u64>,
    held: bool,
    cuts: Arc<Mutex<Vec<Zx>>>,
}

/// What a simulated turning centre does, as a TOML file: a probing path, or a cut.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Duty {
    /// The part, as `part finish` writes it; a cut changes it. A path is relative to this file.
    pub workpiece: PathBuf,
    /// The probe's path, mm.
    pub path: Option<PathBuf>,
    /// Or the radius to cut to.
    pub cut_radius_mm: Option<f64>,
    /// Probing or cutting feed.
    pub feed_mm_min: f64,
    /// Radius of the probe's tip.
    #[serde(default)]
    pub tip_mm: f64,
    /// Machine position `[z, x]` at the part's origin.
    pub origin_mm: [f64; 2],
    /// What the machine does wrong.
    pub machine: Option<PathBuf>,
    /// The spindle has run for so long.
    #[serde(default)]
    pub begin_s: f64,
    /// Seed of everything that is random.
    #[serde(default)]
    pub seed: u64,
    /// Machine, tool and probe.
    #[serde(default)]
    pub bench: Bench,
}

/// The part that a real-time machine cuts on, to be written when it has ended.
#[derive(Debug)]
pub struct Cuts {
    places: Arc<Mutex<Vec<Zx>>>,
    part: Workpiece,
    bench: Bench,
    seed: u64,
    file: PathBuf,
}

impl Cuts {
    /// Writes the part as the tool has left it; nothing where it has not cut.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(mut self) -> std::io::Result<()> {
        let places = std::mem::take(&mut *self.places.lock().unwrap_or_else(PoisonError::into_inner));
        if places.is_empty() {
            return Ok(());
        }
        let mut noise = Noise(Xoshiro256PlusPlus::seed_from_u64(self.seed));
        for place in places {
            let rough_um = self.bench.cut_sd_um * noise.normal();
            self.part.cut(&self.bench, place, rough_um);
        }
        rtec_files::write::whole(&self.file, self.part.to_csv().as_bytes())
    }
}

impl Duty {
    /// Reads what the machine is to do.
    ///
    /// # Errors
    /// Not such a file, or a value that is out of range.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text::read(file)?;
        let expected = "what the simulated turning centre does";
        let mut duty: Self = rtec_files::toml::from_str(file, &text, expected)?;
        let at = |key: &str, found: String, expected: &str| {
            InputError::at_offset(file, &text, text.find(key).unwrap_or(0), found, expected)
        };
        duty.bench.check().map_err(|(key, expected)| at(key, format!("{key} out of range"), expected))?;
        let finite = [duty.tip_mm, duty.begin_s, duty.origin_mm[0], duty.origin_mm[1]];
        if !finite.iter().all(|v| v.is_finite()) || !(0.0..=1e6).contains(&duty.begin_s) || duty.tip_mm < 0.0
        {
            return Err(at(
                "",
                "a value out of range".into(),
                "finite numbers; tip_mm and begin_s 0 or more",
            ));
        }
        if !(duty.feed_mm_min.is_finite() && duty.feed_mm_min > 0.0) {
            return Err(at("feed_mm_min", duty.feed_mm_min.to_string(), "a positive feed"));
        }
        match (&duty.path, duty.cut_radius_mm) {
            (Some(_), None) => {}
            (None, Some(r)) if r.is_finite() && r > 0.0 => {}
            _ => return Err(at("", "neither or both".into(), "path, or a positive cut_radius_mm")),
        }
        let folder = file.parent().unwrap_or(Path::new(""));
        duty.workpiece = folder.join(&duty.workpiece);
        duty.path = duty.path.map(|p| folder.join(p));
        duty.machine = duty.machine.map(|p| folder.join(p));
        Ok(duty)
    }

    /// The machine at rest at `home` (machine mm), on these lines of Z and X, and the part it cuts on.
    ///
    /// # Errors
    /// A file that the duty names is not right; an effect reads what this machine does not have.
    pub fn machine(
        &self,
        lines: [AxisLines; 2],
        machine_lines: MachineLines,
        home: Zx,
    ) -> Result<(LatheWires, Cuts), InputError> {
        let part = Workpiece::read(&self.workpiece)?;
        let origin = Zx::new(self.origin_mm[0], self.origin_mm[1]);
        let feed_mm_s = self.feed_mm_min / 60.0;
        let program = match (&self.path, self.cut_radius_mm) {
            (Some(file), _) => {
                let records = crate::path::read_pathfin(file, crate::drawing::Unit::MM)?;
                crate::experiment::probing_moves(&records, feed_mm_s)
            }
            (None, radius_mm) => {
                let radius_mm = radius_mm.unwrap_or_default();
                crate::experiment::arc_moves(part.centre, radius_mm + self.bench.nose_mm, feed_mm_s)
            }
        };
        let first = program
            .first()
            .ok_or_else(|| {
                InputError::whole(&self.workpiece, "a program without a move", "a path to follow")
            })?
            .segment
            .at(0.0);
        // As the NC program begins: along Z alone, then along X alone.
        let corner = Zx::new(first.z, home.x - origin.x);
        let ways =
            [(home - origin, corner), (corner, first)].into_iter().filter(|(a, b)| (*b - *a).norm() > 1e-6);
        let mut moves: Vec<Move> = ways
            .map(|(a, b)| Move {
                segment: Segment::Line { a, b },
                feed_mm_s: crate::experiment::RAPID_MM_S,
                cutting: false,
                touching: false,
            })
            .collect();
        moves.extend(program);
        let machine = match &self.machine {
            Some(file) => Machine::read(file)?,
            None => Machine::ideal("ideal lathe"),
        };
        let stand = Stand {
            bench: &self.bench,
            machine: &machine,
            begin_s: self.begin_s,
            design: Design::C,
            seed: self.seed,
        };
        let probing = self.path.is_some().then_some(self.tip_mm);
        let mut lathe =
            Lathe::new(&stand, lines, home, origin, moves, probing, part.clone()).map_err(|m| {
                let file = self.machine.as_deref().unwrap_or(Path::new("machine"));
                let found = format!("effect {} reads {}", m.effect, m.what);
                InputError::whole(file, found, "axes z and x, sensors T1 to T20")
            })?;
        // Feed hold until cycle start.
        (lathe.held, lathe.pace) = (true, 0.0);
        let places = Arc::<Mutex<Vec<Zx>>>::default();
        let bit = |line: Option<u8>| line.map_or(0, |b| 1 << b);
        let wires = LatheWires {
            lathe,
            probe: bit(machine_lines.probe),
            hold: bit(machine_lines.hold),
            start_ns: None,
            held: false,
            cuts: Arc::clone(&places),
        };
        let file = self.workpiece.clone();
        Ok((wires, Cuts { places, part, bench: self.bench.clone(), seed: self.seed, file }))
    }
}

impl Wires for LatheWires {
    fn levels(&mut self, t_ns: u64, outputs: u64) -> u64 {
        let start_ns = *self.start_ns.get_or_insert(t_ns);
        let to_ns = (t_ns - start_ns) as f64;
        // At the program's end each turn of the position loop says so; time goes on.
        while self.lathe.t_ns < to_ns {
            self.lathe.advance(to_ns);
        }
        self.lathe.set_outputs(outputs);
        let held = outputs & self.hold != 0;
        if held != self.held {
            self.held = held;
            self.lathe.held = held;
        }
        let new = &mut self.lathe.cut;
        if new.len() > 1 {
            // The last one stays: the next is measured from it.
            let cut = new.drain(..new.len() - 1);
            self.cuts.lock().unwrap_or_else(PoisonError::into_inner).extend(cut);
        }
        self.lathe.inputs() | if self.lathe.tripped { self.probe } else { 0 }
    }

    /// Up to the next change: late looks find the machine waiting.
    fn step_limit_ns(&self) -> u64 {
        let next = self.lathe.next_change_ns().min(self.lathe.tick_ns);
        (next - self.lathe.t_ns).ceil().max(1.0) as u64
    }
}

/// The engine's design and the axis's counts for a name of the contract.
#[must_use]
pub fn design(name: &str) -> Option<Design> {
    match name {
        "original" => Some(Design::Original),
        "a" => Some(Design::A),
        "c" => Some(Design::C),
        _ => None,
    }
}

/// Both axes' counts on this bench.
#[must_use]
pub fn axes(bench: &Bench, design: Design) -> [AxisCounts; 2] {
    [AxisCounts { count_um: bench.count_um, increment: design.increment_counts(), sign: 1.0 }; 2]
}
