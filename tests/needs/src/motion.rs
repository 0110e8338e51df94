//! An axis with an acceleration limit, read by a scale with hysteresis.

/// The axis: position, speed, time, and the count of its scale.
#[derive(Debug, Clone)]
pub struct Motion {
    x: f64,
    v: f64,
    t_ns: f64,
    count: i64,
    accel_counts_s2: f64,
    max_speed_counts_s: f64,
    hysteresis_counts: f64,
}

impl Motion {
    /// An axis at rest between two edges.
    pub fn new(accel_counts_s2: f64, max_speed_counts_s: f64, hysteresis_counts: f64) -> Self {
        Self {
            x: 0.5,
            v: 0.0,
            t_ns: 10_000.0,
            count: 0,
            accel_counts_s2,
            max_speed_counts_s,
            hysteresis_counts,
        }
    }

    /// The present time, ns.
    pub fn now_ns(&self) -> f64 {
        self.t_ns
    }

    /// The present speed, counts/s.
    pub fn speed_counts_s(&self) -> f64 {
        self.v
    }

    /// One short step with `throttle` times the full acceleration (−1 to 1).
    /// Returns the edge within it, if any: the time in ns at which the motion crosses the threshold, and the direction.
    pub fn step(&mut self, throttle: f64) -> Option<(u64, i64)> {
        let dt_s = (0.1 / (self.v.abs() + 1.0)).clamp(1e-7, 1e-5);
        let mut a = self.accel_counts_s2 * throttle;
        if self.v.abs() >= self.max_speed_counts_s && self.v * a > 0.0 {
            a = 0.0;
        }
        let (x0, v0, started_ns) = (self.x, self.v, self.t_ns);
        self.x += v0 * dt_s + a * dt_s * dt_s / 2.0;
        self.v += a * dt_s;
        self.t_ns += dt_s * 1e9;
        let half = self.hysteresis_counts / 2.0;
        let (up, down) = (self.count as f64 + 1.0 + half, self.count as f64 - half);
        let (at, step) = match self.x {
            x if x >= up => (up, 1),
            x if x < down => (down, -1),
            _ => return None,
        };
        self.count += step;
        Some(((started_ns + first_s(v0, a, at - x0).min(dt_s) * 1e9) as u64, step))
    }
}

/// First time at which vt + at²/2 = d, s.
/// Of the two forms of the root it uses the one without a difference of near numbers.
fn first_s(v: f64, a: f64, d: f64) -> f64 {
    let root = (v * v + 2.0 * a * d).max(0.0).sqrt();
    2.0 * d / (v + root.copysign(d))
}
