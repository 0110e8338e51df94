//! One axis of the machine: drive, screw with backlash, friction, and scale.

use rtec_driver::quadrature::{Decoder, Signal, State};

/// Properties of an axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisSpec {
    /// `x`, `y` or `z`.
    pub name: &'static str,
    /// Lowest and highest position, mm.
    pub travel_mm: [f64; 2],
    /// Size of one count of the scale, µm.
    pub count_um: f64,
    /// Signal period of the scale, µm.
    pub signal_period_um: f64,
    /// Interpolation error within the signal period, amplitude, µm.
    pub interpolation_um: f64,
    /// Hysteresis of the scale's edges on reversal, counts.
    pub hysteresis_counts: f64,
    /// Fastest speed, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration, mm/s².
    pub accel_mm_s2: f64,
    /// Deceleration, mm/s².
    pub decel_mm_s2: f64,
    /// Jerk, mm/s³.
    pub jerk_mm_s3: f64,
    /// Play between screw and table, µm. The scale is on the table.
    pub backlash_um: f64,
    /// Moved mass, including the motor's inertia, kg.
    pub mass_kg: f64,
    /// Force of Coulomb friction, N.
    pub coulomb_n: f64,
    /// Viscous friction, N per m/s.
    pub viscous_n_s_per_m: f64,
    /// Largest force of the drive, N.
    pub max_force_n: f64,
    /// Gain of the position loop, 1/s.
    pub position_gain_per_s: f64,
    /// Bandwidth of the speed loop, 1/s.
    pub speed_gain_per_s: f64,
    /// Dither of the servo at rest, counts from one side to the other.
    /// It is zero for a good servo. (NISTIR 4832, The "Original RTEC": "servo gain or some amplifier
    /// zero-offset" altered)
    pub dither_counts: f64,
    /// Share of the commanded speed that is fed forward.
    /// The rest becomes following error: (1 − share)·v/gain.
    pub feed_forward: f64,
    /// Whether the position loop is closed on the signals from the gates.
    /// If not, it is closed on an encoder of the motor.
    pub on_feedback: bool,
}

impl AxisSpec {
    /// A ball-screw axis with a glass scale of 1 µm, rapid traverse 10 m/min.
    pub fn new(name: &'static str, travel_mm: f64) -> Self {
        Self {
            name,
            travel_mm: [-travel_mm / 2.0, travel_mm / 2.0],
            count_um: 1.0,
            signal_period_um: 20.0,
            interpolation_um: 0.0,
            hysteresis_counts: 0.1,
            speed_mm_s: 10_000.0 / 60.0,
            accel_mm_s2: 1000.0,
            decel_mm_s2: 1000.0,
            jerk_mm_s3: 20_000.0,
            backlash_um: 2.0,
            mass_kg: 300.0,
            coulomb_n: 60.0,
            viscous_n_s_per_m: 400.0,
            max_force_n: 4000.0,
            position_gain_per_s: 60.0,
            speed_gain_per_s: 600.0,
            dither_counts: 0.0,
            feed_forward: 1.0,
            on_feedback: true,
        }
    }
}

/// An axis in motion.
/// Lengths inside are in counts; position 0 is the middle of count 0.
#[derive(Debug, Clone)]
pub(crate) struct AxisSim {
    pub spec: AxisSpec,
    /// Positions of the screw's motor side and of the table, counts.
    /// Edges of the scale are at whole numbers.
    motor: f64,
    table: f64,
    /// Speed of the motor side, counts/s.
    speed: f64,
    /// Integral of the speed loop, counts/s².
    integral: f64,
    /// Force of the drive, N.
    pub force_n: f64,
    pub accel_mm_s2: f64,
    /// Commanded speed, counts/s, and feed-forward acceleration, counts/s².
    commanded: (f64, f64),
    /// Friction in addition to the spec's, N, at −v and at +v.
    /// Viscous friction that differs by direction, N·s/m, and a constant force, N.
    pub asymmetric_n_s_per_m: f64,
    pub offset_n: f64,
    pub scale: Decoder,
    /// The MTC's counter.
    pub mtc: Decoder,
    /// Scale count at the machine's zero; the scale starts at count `origin`.
    pub origin: i64,
    /// Time of the next edge within the present step, ns; `u64::MAX` if none.
    pub next_ns: u64,
    next: f64,
    per_count: f64,
    up: bool,
    /// The signal that changes at that edge.
    signal: Signal,
    /// The signal's lines at the card and at the gate.
    signal_lines: u64,
    /// All lines of the axis at the card.
    lines: u64,
    /// Counts that this edge adds to the scale's and to the MTC's counter.
    /// The MTC's is mirrored while one inverter is on.
    counts: (i8, i8),
    step: (u64, f64, f64),
    /// Shortest time between two edges at the MTC, ns.
    pub min_separation_ns: u64,
    pub last_out_ns: u64,
    /// Direction of the last motion of more than a few counts.
    pub direction: f64,
    turned_at: f64,
    interpolation: Vec<f64>,
    /// Number of servo periods at rest.
    rested: u32,
}

/// Servo periods from one side of a dither to the other.
const DITHER_TICKS: u32 = 200;

impl AxisSim {
    /// The n-th axis, with the lines of [`rtec_driver::card::AxisLines::standard`].
    pub(crate) fn new(spec: AxisSpec, n: usize, at_mm: f64) -> Self {
        let counts = at_mm * 1000.0 / spec.count_um;
        let table = counts + 0.5;
        let origin = table.floor() as i64;
        let state = State::default();
        let per_period = (spec.signal_period_um / spec.count_um).round().max(1.0) as usize;
        let interpolation = if spec.interpolation_um == 0.0 {
            Vec::new()
        } else {
            let turn = 2.0 * std::f64::consts::PI / per_period as f64;
            (0..per_period)
                .map(|n| spec.interpolation_um / spec.count_um * libm::sin(turn * n as f64))
                .collect()
        };
        Self {
            spec,
            motor: table,
            table,
            speed: 0.0,
            integral: 0.0,
            force_n: 0.0,
            accel_mm_s2: 0.0,
            commanded: (0.0, 0.0),
            asymmetric_n_s_per_m: 0.0,
            offset_n: 0.0,
            scale: Decoder::new(state),
            mtc: Decoder::new(state),
            origin,
            next_ns: u64::MAX,
            next: 0.0,
            per_count: 0.0,
            up: true,
            signal: Signal::A,
            signal_lines: 0,
            lines: 0xF << (4 * n),
            counts: (0, 0),
            step: (0, 0.0, 0.0),
            min_separation_ns: u64::MAX,
            last_out_ns: 0,
            direction: 0.0,
            turned_at: table,
            interpolation,
            rested: 0,
        }
    }

    fn count_mm(&self) -> f64 {
        self.spec.count_um / 1000.0
    }

    /// Position of the table by the scale at `t_ns` within the present step, mm.
    /// It is not quantised.
    pub(crate) fn position_mm(&self, t_ns: u64) -> f64 {
        let (from_ns, from, per_ns) = self.step;
        (from + per_ns * t_ns.saturating_sub(from_ns) as f64 - 0.5) * self.count_mm()
    }

    pub(crate) fn velocity_mm_s(&self) -> f64 {
        self.step.2 * 1e9 * self.count_mm()
    }

    /// Position by the count that the controller uses, mm.
    pub(crate) fn counted_mm(&self) -> f64 {
        let counted = if self.spec.on_feedback { &self.mtc } else { &self.scale };
        (self.origin + counted.count()) as f64 * self.count_mm()
    }

    /// Runs the position loop, once per servo tick; it uses the controller's count.
    pub(crate) fn servo(&mut self, p_mm: f64, v_mm_s: f64, a_mm_s2: f64) {
        let count = self.count_mm();
        let error = (p_mm - self.counted_mm()) / count;
        let rests = v_mm_s == 0.0 && a_mm_s2 == 0.0;
        let mut error = error;
        self.rested = if rests { self.rested.wrapping_add(1) } else { 0 };
        if self.spec.dither_counts > 0.0 && (self.rested / DITHER_TICKS) % 2 == 1 {
            error += self.spec.dither_counts;
        }
        // Within its resolution the axis is in position: a good servo does not dither.
        let error = if rests && error.abs() <= 0.6 { 0.0 } else { error };
        self.commanded = (
            self.spec.position_gain_per_s * error + self.spec.feed_forward * v_mm_s / count,
            self.spec.feed_forward * a_mm_s2 / count,
        );
    }

    /// Switches the drive off (servo fault): the axis coasts against friction.
    pub(crate) fn switch_off(&mut self) {
        self.commanded = (0.0, 0.0);
    }

    /// Advances the axis by one step and finds the scale's edges in it.
    pub(crate) fn advance(&mut self, from_ns: u64, step_ns: u64) {
        let dt = step_ns as f64 * 1e-9;
        let mass = self.spec.mass_kg;
        let m_per_count = self.spec.count_um * 1e-6;
        // Speed loop of the drive: PI with the commanded acceleration fed forward.
        let error = self.commanded.0 - self.speed;
        let k = self.spec.speed_gain_per_s;
        let limit = self.spec.max_force_n / mass / m_per_count;
        // The integral compensates friction and is at most as large.
        self.integral = (self.integral + 0.2 * k * k * error * dt).clamp(-limit, limit);
        let drive = (self.commanded.1 + k * error + self.integral).clamp(-limit, limit);
        let v_m = self.speed * m_per_count;
        let viscous = self.spec.viscous_n_s_per_m * v_m + self.asymmetric_n_s_per_m * v_m.abs();
        let linear = viscous + self.offset_n;
        let free = self.speed + (drive - linear / mass / m_per_count) * dt;
        let brake = self.spec.coulomb_n / mass / m_per_count * dt;
        let speed = if free.abs() <= brake { 0.0 } else { free - brake.copysign(free) };
        if speed == 0.0 && self.commanded == (0.0, 0.0) {
            self.integral = 0.0;
        }
        self.accel_mm_s2 = (speed - self.speed) / dt * self.count_mm();
        self.force_n = drive * mass * m_per_count;
        let before = self.table;
        self.motor += f64::midpoint(speed, self.speed) * dt;
        self.speed = speed;
        let play = self.spec.backlash_um / self.spec.count_um / 2.0;
        self.table = self.table.clamp(self.motor - play, self.motor + play);
        let per_ns = (self.table - before) / step_ns as f64;
        self.step = (from_ns, before, per_ns);
        // A reversal counts only after more travel than any overshoot.
        if (self.table - self.turned_at) * self.direction > 0.0 {
            self.turned_at = self.table;
        }
        if (self.table - self.turned_at).abs() > 3.0 {
            self.direction = if self.table > self.turned_at { 1.0 } else { -1.0 };
            self.turned_at = self.table;
        }
        self.find_edge(from_ns, step_ns);
    }

    /// Whether the axis is at rest and not commanded to move.
    pub(crate) fn rests(&self) -> bool {
        self.speed == 0.0 && self.commanded == (0.0, 0.0)
    }

    /// Keeps the axis at rest from `from_ns` on.
    pub(crate) fn hold_at_rest(&mut self, from_ns: u64) {
        self.integral = 0.0;
        self.accel_mm_s2 = 0.0;
        self.step = (from_ns, self.table, 0.0);
        self.next_ns = u64::MAX;
    }

    fn find_edge(&mut self, from_ns: u64, step_ns: u64) {
        let (_, before, per_ns) = self.step;
        self.next_ns = u64::MAX;
        if per_ns == 0.0 {
            return;
        }
        self.up = per_ns > 0.0;
        self.signal = self.scale.state().signal_towards(self.up);
        // A and A' are the even lines, B and B' the odd ones.
        self.signal_lines =
            self.lines & if self.signal == Signal::A { u64::MAX / 3 } else { u64::MAX / 3 * 2 };
        self.see_counts();
        self.per_count = 1.0 / per_ns.abs();
        let count = self.origin + self.scale.count();
        let half = self.spec.hysteresis_counts / 2.0;
        let edge = if self.up { (count + 1) as f64 + half } else { count as f64 - half };
        let edge = edge + self.interpolation_at(if self.up { count + 1 } else { count });
        self.next = (edge - before) / per_ns;
        self.book(from_ns, step_ns);
    }

    fn interpolation_at(&self, boundary: i64) -> f64 {
        if self.interpolation.is_empty() {
            0.0
        } else {
            self.interpolation[boundary.rem_euclid(self.interpolation.len() as i64) as usize]
        }
    }

    #[inline]
    fn book(&mut self, from_ns: u64, step_ns: u64) {
        self.next_ns = if self.next < step_ns as f64 {
            // No step is longer than 32 bits can express. A threshold passed just before the step gives a
            // negative number, and is crossed at the step's beginning.
            from_ns + u64::from(self.next as u32)
        } else {
            u64::MAX
        };
    }

    /// Passes the scale's edge at `next_ns` to both counters.
    /// Returns the lines that change.
    #[inline]
    pub(crate) fn edge(&mut self, step_ns: u64) -> u64 {
        let (signal, (scale, mtc)) = (self.signal, self.counts);
        self.scale.take_step(self.scale.state().flipped(signal), scale);
        self.mtc.take_step(self.mtc.state().flipped(signal), mtc);
        self.next += self.per_count;
        if !self.interpolation.is_empty() {
            self.interpolate();
        }
        self.book(self.step.0, step_ns);
        // A and B alternate while the direction stays, as it does within a step.
        self.signal = signal.other();
        let changed = self.signal_lines;
        self.signal_lines ^= self.lines;
        changed
    }

    /// Shifts the next edge by the difference of interpolation errors.
    /// Not inlined, so that the code of a scale without them stays short.
    #[inline(never)]
    fn interpolate(&mut self) {
        let count = self.origin + self.scale.count();
        let (last, coming) = if self.up { (count, count + 1) } else { (count + 1, count) };
        let shift = self.interpolation_at(coming) - self.interpolation_at(last);
        self.next += shift * if self.up { self.per_count } else { -self.per_count };
    }

    /// Sets the counts that the next edge adds to the two counters.
    fn see_counts(&mut self) {
        let mirrored = matches!(self.scale.state().changed(self.mtc.state()), 1 | 2);
        let step = if self.up { 1 } else { -1 };
        self.counts = (step, if mirrored { -step } else { step });
    }

    /// Applies a change of the inverters.
    /// Returns whether the MTC's decoder sees an illegal transition, and the time since its last edge, ns.
    pub(crate) fn invert(&mut self, inverters: u8, t_ns: u64) -> (bool, u64) {
        let illegal = self.mtc.update(self.scale.state().inverted(inverters)).is_none();
        self.see_counts();
        let since_ns = t_ns - std::mem::replace(&mut self.last_out_ns, t_ns);
        self.min_separation_ns = self.min_separation_ns.min(since_ns);
        (illegal, since_ns)
    }
}
