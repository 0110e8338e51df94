//! A simulated turning centre for the unchanged engine: two axes under a controller that counts what the gates send
//! it, a tool that cuts what it reaches, a touch probe. NISTIR 4854's experiment runs on it.

use crate::contour::Segment;
use crate::errors::PointError;
use crate::fit::Zx;
use crate::table::{AxisCounts, Cut, Holding, Table};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};
use rtec_driver::card::{AxisLines, Card, CardError, MachineLines, Sample};
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::{AxisConfig, Design};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{Event, Request, Status};
use serde::Deserialize;
use std::f64::consts::{FRAC_PI_2, TAU};

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
    /// A machine error that moves whatever the turret carries, tool and probe alike: amplitude of a lobed shape about
    /// the arc's centre.
    pub lobe_um: f64,
    /// Lobes of it in a whole turn.
    pub lobes: f64,
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
            lobe_um: 0.0,
            lobes: 6.0,
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
        let sizes =
            [("flat_um", self.flat_um), ("probe_sd_um", self.probe_sd_um), ("cut_sd_um", self.cut_sd_um)];
        if let Some((key, _)) = sizes.iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
            return Err((key, "0 or more"));
        }
        let finite = [("flat_rad", self.flat_rad), ("lobe_um", self.lobe_um), ("lobes", self.lobes)];
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

    /// Angles and radii, to be kept between sessions.
    #[must_use]
    pub fn radii_mm(&self) -> &[f64] {
        &self.radius_mm
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
}

/// The scale's hysteresis, counts.
const HYSTERESIS: f64 = 0.1;

impl Slide {
    fn new(at: f64) -> Self {
        let (scale, count) = (State::default(), at.floor() as i64);
        Self { at, velocity: 0.0, count, scale, inverters: 0, mtc: Decoder::new(scale), mtc_zero: count }
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

/// The machine as the engine sees it: a card.
#[derive(Debug)]
struct Lathe<'a> {
    bench: &'a Bench,
    moves: &'a [Move],
    origin: Zx,
    part: &'a Workpiece,
    tip_mm: f64,
    slides: [Slide; 2],
    t_ns: f64,
    tick_ns: f64,
    look_ns: f64,
    second_look_ns: Option<f64>,
    /// The running move and when it began.
    at_move: usize,
    began_ns: f64,
    tripped: bool,
    trip_ns: Option<f64>,
    trip_noise_mm: f64,
    /// Tool places while cutting, part coordinates.
    cut: Vec<Zx>,
    /// Where the tip's centre truly was on the scales at each trip.
    trips: Vec<Zx>,
    noise: Noise,
}

/// Period of the controller's position loop, ns.
const TICK_NS: f64 = 1e6;
const PROBE_LINE: u8 = 28;

impl Lathe<'_> {
    fn mm(&self, slide: usize) -> f64 {
        self.slides[slide].at * self.bench.count_um * 1e-3
    }

    /// The turret's place on the scales, part coordinates.
    fn on_scale(&self) -> Zx {
        Zx::new(self.mm(0), self.mm(1)) - self.origin
    }

    /// Where it truly is: the machine's own error moves it.
    fn truly(&self, on_scale: Zx) -> Zx {
        let n = (on_scale - self.part.centre).unit().unwrap_or(Zx::new(1.0, 0.0));
        on_scale + n * (self.bench.lobe_um * 1e-3 * (self.bench.lobes * n.angle_rad()).cos())
    }

    /// Distance from the tip to the surface.
    fn off_surface_mm(&self, on_scale: Zx) -> f64 {
        let p = self.truly(on_scale) - self.part.centre;
        p.norm() - self.part.radius_mm(p.angle_rad()) - self.tip_mm - self.trip_noise_mm
    }

    /// Where the program wants the axes, part coordinates; `None` once it is at its end.
    fn wanted(&self, at_ns: f64) -> Option<Zx> {
        let m = self.moves.get(self.at_move)?;
        let t = (at_ns - self.began_ns) * 1e-9;
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
        if self.at_move < self.moves.len() && (self.t_ns - self.began_ns) * 1e-9 >= self.move_s() {
            self.at_move += 1;
            self.began_ns = self.t_ns;
            self.trip_noise_mm = self.bench.probe_sd_um * 1e-3 * self.noise.normal();
        }
        let (Some(now), Some(next)) = (self.wanted(self.t_ns), self.wanted(self.t_ns + TICK_NS)) else {
            return false;
        };
        let (now, next) = (now + self.origin, next + self.origin);
        for (slide, (now, next)) in self.slides.iter_mut().zip([(now.z, next.z), (now.x, next.x)]) {
            let per_count_mm = self.bench.count_um * 1e-3;
            let seen_mm = (slide.mtc_count() as f64 + 0.5) * per_count_mm;
            let mm_s = (next - now) / (TICK_NS * 1e-9) + self.bench.gain * (now - seen_mm);
            slide.velocity = mm_s / per_count_mm * 1e-9;
        }
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

impl Card for Lathe<'_> {
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
        let [z, x] = [0, 1].map(|i| u64::from(self.slides[i].scale.bits()));
        let inputs = z | x << 4 | u64::from(self.tripped) << PROBE_LINE;
        self.look_ns = look_ns;
        Ok(Sample::level(look_ns.ceil() as u64, inputs))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        for (i, slide) in self.slides.iter_mut().enumerate() {
            for (signal, bit) in [(1_u8, 2 * i), (2, 2 * i + 1)] {
                if mask >> bit & 1 != 0 {
                    slide.inverters =
                        slide.inverters & !signal | if value >> bit & 1 != 0 { signal } else { 0 };
                    slide.tell_mtc();
                }
            }
        }
        Ok(Some(self.look_ns.ceil() as u64))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(u64::from(self.slides[0].inverters) | u64::from(self.slides[1].inverters) << 2)
    }
}

/// What a program on the machine is run for.
#[derive(Debug, Clone, Copy)]
pub enum Job<'a> {
    /// Cut without corrections.
    Cut,
    /// Cut with the corrections of a table, totals asked this long ahead, s.
    Corrected(&'a Table, f64),
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
}

/// Run a program on the machine with the engine between scales and controller. The workpiece is what is left.
///
/// # Errors
/// The engine refuses the configuration, or there is no move.
pub fn run(
    bench: &Bench,
    design: Design,
    cut: &Cut,
    moves: &[Move],
    job: Job,
    part: &mut Workpiece,
    seed: u64,
) -> Result<Ran, RunError> {
    let first = moves.first().ok_or(RunError::NoMove)?.segment.at(0.0) + cut.origin;
    let counts = |mm: f64| mm * 1e3 / bench.count_um;
    let slides = [Slide::new(counts(first.z)), Slide::new(counts(first.x))];
    let before = part.clone();
    let homes = [slides[0].count, slides[1].count];
    let mut lathe = Lathe {
        bench,
        moves,
        origin: cut.origin,
        part: &before,
        tip_mm: if let Job::Probe(tip_mm) = job { tip_mm } else { 0.0 },
        slides,
        t_ns: 0.0,
        tick_ns: TICK_NS,
        look_ns: 0.0,
        second_look_ns: None,
        at_move: 0,
        began_ns: 0.0,
        tripped: false,
        trip_ns: None,
        trip_noise_mm: 0.0,
        cut: Vec::new(),
        trips: Vec::new(),
        noise: Noise(Xoshiro256PlusPlus::seed_from_u64(seed)),
    };
    let axis = |n: u8| AxisConfig {
        lines: AxisLines::standard(n, false),
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
        let Job::Corrected(table, lead_s) = job else { continue };
        let status = engine.status();
        let mm = |n: usize| (status.axes[n].position_counts as f64 + 0.5) * bench.count_um * 1e-3;
        let (t_s, place) = (now_ns as f64 * 1e-9, Zx::new(mm(0), mm(1)));
        let velocity = last.map_or(Zx::new(0.0, 0.0), |(t, p)| (place - p) * (1.0 / (t_s - t)));
        last = Some((t_s, place));
        let wanted = table.components_um(place, velocity, lead_s);
        for (n, error_um) in [wanted.z, wanted.x].into_iter().enumerate() {
            let total_counts = held[n].request(&table.axes[n], error_um);
            let order = Request::Correct { axis: n as u8, total_counts, large: false };
            engine.take(order, &mut lathe, &mut tell).map_err(StartError::Card)?;
        }
    }
    let status = engine.status();
    let mtc_minus_scale = [0, 1].map(|n: usize| lathe.slides[n].mtc_count() - lathe.slides[n].count);
    let (seconds, trips, places, mut noise) = (lathe.t_ns * 1e-9, lathe.trips, lathe.cut, lathe.noise);
    for place in places {
        let rough_um = bench.cut_sd_um * noise.normal();
        part.cut(bench, place, rough_um);
    }
    Ok(Ran { events, status, seconds, mtc_minus_scale, trips })
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
