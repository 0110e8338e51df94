//! The controller's trajectory: jerk-limited motion along lines and arcs.

/// Limits of the motion along a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathMotionLimits {
    /// Highest speed, mm/s.
    pub speed_mm_s: f64,
    /// Highest acceleration, mm/s².
    pub accel_mm_s2: f64,
    /// Highest deceleration, mm/s².
    pub decel_mm_s2: f64,
    /// Highest jerk, mm/s³.
    pub jerk_mm_s3: f64,
}

/// Path length, speed and acceleration along the path at one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PathState {
    /// Distance from the start, mm.
    pub s_mm: f64,
    /// Speed along the path, mm/s.
    pub v_mm_s: f64,
    /// Acceleration along the path, mm/s².
    pub a_mm_s2: f64,
}

/// A ramp from rest to a speed with rising, constant and falling acceleration.
/// Run backwards it goes from the speed to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SpeedRamp {
    /// Duration of the rising acceleration, and of the whole ramp, s.
    rise_s: f64,
    whole_s: f64,
}

impl SpeedRamp {
    fn new(v_mm_s: f64, a_mm_s2: f64, j_mm_s3: f64) -> Self {
        if v_mm_s * j_mm_s3 < a_mm_s2 * a_mm_s2 {
            let rise_s = (v_mm_s / j_mm_s3).sqrt();
            Self { rise_s, whole_s: 2.0 * rise_s }
        } else {
            Self { rise_s: a_mm_s2 / j_mm_s3, whole_s: a_mm_s2 / j_mm_s3 + v_mm_s / a_mm_s2 }
        }
    }

    /// State `t_s` after rest, at a jerk of `j_mm_s3`.
    fn at(&self, t_s: f64, j_mm_s3: f64) -> PathState {
        let (j, tj, ta) = (j_mm_s3, self.rise_s, self.whole_s);
        let peak_a = j * tj;
        let peak_v = peak_a * (ta - tj);
        if t_s < tj {
            let (s_mm, v_mm_s) = (j * t_s * t_s * t_s / 6.0, j * t_s * t_s / 2.0);
            PathState { s_mm, v_mm_s, a_mm_s2: j * t_s }
        } else if t_s < ta - tj {
            let u = t_s - tj;
            let v0 = peak_a * tj / 2.0;
            PathState {
                s_mm: peak_a * tj * tj / 6.0 + v0 * u + peak_a * u * u / 2.0,
                v_mm_s: v0 + peak_a * u,
                a_mm_s2: peak_a,
            }
        } else {
            let w = ta - t_s;
            PathState {
                s_mm: peak_v * ta / 2.0 - peak_v * w + j * w * w * w / 6.0,
                v_mm_s: peak_v - j * w * w / 2.0,
                a_mm_s2: j * w,
            }
        }
    }
}

/// Jerk-limited motion from rest to rest over a length (seven phases).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedProfile {
    length_mm: f64,
    jerk_mm_s3: f64,
    speed_mm_s: f64,
    up: SpeedRamp,
    cruise_s: f64,
    down: SpeedRamp,
}

impl FeedProfile {
    /// The fastest motion within the limits.
    pub fn new(length_mm: f64, limits: PathMotionLimits) -> Self {
        let jerk_mm_s3 = limits.jerk_mm_s3;
        let ramps =
            |v: f64| [limits.accel_mm_s2, limits.decel_mm_s2].map(|a| SpeedRamp::new(v, a, jerk_mm_s3));
        let both_s = |v: f64| ramps(v).iter().map(|r| r.whole_s).sum::<f64>();
        let mut speed_mm_s = limits.speed_mm_s;
        if speed_mm_s * both_s(speed_mm_s) / 2.0 > length_mm {
            // Too short for the full speed: takes the speed at which the ramps meet.
            let (mut low, mut high) = (0.0, speed_mm_s);
            for _ in 0..64 {
                let v = f64::midpoint(low, high);
                *if v * both_s(v) / 2.0 > length_mm { &mut high } else { &mut low } = v;
            }
            speed_mm_s = low;
        }
        let [up, down] = ramps(speed_mm_s);
        let cruise_s = (length_mm / speed_mm_s - f64::midpoint(up.whole_s, down.whole_s)).max(0.0);
        Self { length_mm, jerk_mm_s3, speed_mm_s, up, cruise_s, down }
    }

    /// Time from rest to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.up.whole_s + self.cruise_s + self.down.whole_s
    }

    /// State of the motion `t_s` after its start.
    pub fn at(&self, t_s: f64) -> PathState {
        let total_s = self.duration_s();
        let up_s = self.up.whole_s;
        if t_s >= total_s {
            PathState { s_mm: self.length_mm, ..PathState::default() }
        } else if t_s < up_s {
            self.up.at(t_s.max(0.0), self.jerk_mm_s3)
        } else if t_s <= up_s + self.cruise_s {
            let v_mm_s = self.speed_mm_s;
            PathState { s_mm: v_mm_s * (up_s / 2.0 + (t_s - up_s)), v_mm_s, a_mm_s2: 0.0 }
        } else {
            let back = self.down.at(total_s - t_s, self.jerk_mm_s3);
            PathState { s_mm: self.length_mm - back.s_mm, v_mm_s: back.v_mm_s, a_mm_s2: -back.a_mm_s2 }
        }
    }
}

/// Axes that a controller moves together: X, Y, Z.
pub const AXES: usize = 3;
/// Their names, in the order of all arrays.
pub(crate) const AXIS_NAMES: [&str; AXES] = ["x", "y", "z"];

/// Position, speed and acceleration of every axis, mm and s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Setpoint {
    /// Position of X, Y, Z, mm.
    pub p_mm: [f64; AXES],
    /// Velocity of X, Y, Z, mm/s.
    pub v_mm_s: [f64; AXES],
    /// Acceleration of X, Y, Z, mm/s².
    pub a_mm_s2: [f64; AXES],
}

/// The shape of one move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MoveShape {
    /// A straight line (G00, G01).
    Line {
        /// Start point, mm.
        from: [f64; AXES],
        /// End point, mm.
        to: [f64; AXES],
    },
    /// An arc in the plane of two axes (G02, G03), the third moving along evenly.
    Arc {
        /// Start point, mm.
        from: [f64; AXES],
        /// The plane's first and second axis.
        plane: (usize, usize),
        /// Centre in the plane, mm.
        centre: (f64, f64),
        /// Radius of the arc, mm.
        radius_mm: f64,
        /// Angle of the start, rad.
        start_rad: f64,
        /// Angle swept, rad; positive from the first axis towards the second.
        sweep_rad: f64,
        /// Travel of the third axis, mm.
        third_mm: f64,
    },
}

impl MoveShape {
    /// Length of the path, mm.
    pub fn length_mm(&self) -> f64 {
        match self {
            Self::Line { from, to } => {
                from.iter().zip(to).map(|(a, b)| (b - a) * (b - a)).sum::<f64>().sqrt()
            }
            Self::Arc { radius_mm, sweep_rad, third_mm, .. } => {
                let round = radius_mm * sweep_rad;
                (round * round + third_mm * third_mm).sqrt()
            }
        }
    }

    /// Speed at which an arc's centripetal acceleration is at a limit, mm/s.
    pub fn speed_limit_mm_s(&self, accel_mm_s2: f64) -> f64 {
        match self {
            Self::Line { .. } => f64::INFINITY,
            Self::Arc { radius_mm, .. } => (accel_mm_s2 * radius_mm).sqrt(),
        }
    }

    /// State of all axes at a position along the path.
    pub fn at(&self, along: PathState) -> Setpoint {
        let length = self.length_mm();
        let PathState { s_mm: s, v_mm_s: v, a_mm_s2: a } = along;
        let mut c = Setpoint::default();
        match self {
            Self::Line { from, to } => {
                for n in 0..AXES {
                    let unit = if length > 0.0 { (to[n] - from[n]) / length } else { 0.0 };
                    // Exactly at the end, whatever the rounding on the way.
                    c.p_mm[n] = if s >= length { to[n] } else { from[n] + unit * s };
                    c.v_mm_s[n] = unit * v;
                    c.a_mm_s2[n] = unit * a;
                }
            }
            &Self::Arc { from, plane: (i, j), centre, radius_mm: r, start_rad, sweep_rad, third_mm } => {
                let share = if length > 0.0 { s / length } else { 1.0 };
                let angle = start_rad + sweep_rad * share;
                let (sin, cos) = libm::sincos(angle);
                let turn = if length > 0.0 { sweep_rad / length } else { 0.0 };
                let (w, dw) = (turn * v, turn * a);
                c.p_mm = from;
                c.p_mm[i] = centre.0 + r * cos;
                c.p_mm[j] = centre.1 + r * sin;
                c.v_mm_s[i] = -r * sin * w;
                c.v_mm_s[j] = r * cos * w;
                c.a_mm_s2[i] = -r * (cos * w * w + sin * dw);
                c.a_mm_s2[j] = -r * (sin * w * w - cos * dw);
                let k = AXES - i - j;
                let rise = if length > 0.0 { third_mm / length } else { 0.0 };
                c.p_mm[k] = from[k] + third_mm * share;
                c.v_mm_s[k] = rise * v;
                c.a_mm_s2[k] = rise * a;
            }
        }
        c
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_are_consistent_within_their_limits_and_end_where_they_should() {
        let even = PathMotionLimits {
            speed_mm_s: 100.0,
            accel_mm_s2: 1000.0,
            decel_mm_s2: 1000.0,
            jerk_mm_s3: 20_000.0,
        };
        let lathe = PathMotionLimits { accel_mm_s2: 217.0, decel_mm_s2: 578.7, ..even };
        for (length, limits) in
            [0.001, 0.5, 3.0, 14.9, 15.1, 50.0, 1000.0].iter().flat_map(|l| [(*l, even), (*l, lathe)])
        {
            let p = FeedProfile::new(length, limits);
            let n = 20_000;
            let dt = p.duration_s() / f64::from(n);
            let mut last = p.at(0.0);
            for k in 1..=n {
                let now = p.at(dt * f64::from(k));
                let mean_v = f64::midpoint(now.v_mm_s, last.v_mm_s);
                assert!(
                    (now.s_mm - last.s_mm - mean_v * dt).abs() < 1e-6 * length.max(1.0),
                    "{length} at {k}"
                );
                assert!(
                    (now.a_mm_s2 - last.a_mm_s2).abs() <= 20_000.0 * dt * 1.001 + 1e-6,
                    "{length} at {k}"
                );
                assert!(now.v_mm_s <= 100.0 + 1e-9 && now.a_mm_s2 <= limits.accel_mm_s2 + 1e-6);
                assert!(-now.a_mm_s2 <= limits.decel_mm_s2 + 1e-6);
                last = now;
            }
            assert!((last.s_mm - length).abs() < 1e-9);
        }
    }

    #[test]
    fn an_arc_keeps_its_radius_and_its_derivatives() {
        let arc = MoveShape::Arc {
            from: [10.0, 0.0, 5.0],
            plane: (0, 1),
            centre: (0.0, 0.0),
            radius_mm: 10.0,
            start_rad: 0.0,
            sweep_rad: 3.0,
            third_mm: 0.0,
        };
        let (v, ds) = (50.0, 1e-4);
        let at = |s: f64| arc.at(PathState { s_mm: s, v_mm_s: v, a_mm_s2: 7.0 });
        for s in [0.1, 9.0, 29.0] {
            let (a, b, c) = (at(s - ds), at(s), at(s + ds));
            assert!((libm::hypot(b.p_mm[0], b.p_mm[1]) - 10.0).abs() < 1e-12);
            for n in 0..3 {
                let slope = (c.p_mm[n] - a.p_mm[n]) / (2.0 * ds) * v;
                assert!((slope - b.v_mm_s[n]).abs() < 1e-6);
            }
            let centripetal = libm::hypot(b.a_mm_s2[0], b.a_mm_s2[1]);
            assert!((centripetal - libm::hypot(250.0, 7.0)).abs() < 1e-9);
        }
    }
}
