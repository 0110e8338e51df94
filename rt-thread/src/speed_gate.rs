//! The speed gate: can the next edge come before an insertion is done?
//!
//! It decides from the last period *and* the axis's acceleration limit. With the period T between the last two edges
//! the axis is now at most as fast as
//!
//! | when | v |
//! |---|---|
//! | T < √(2/a) | 1/T + aT/2: one count in T at full acceleration |
//! | otherwise, at most | √(2a(1 + H)): back from the last edge by the hysteresis H without an edge, then forth |
//!
//! From there the next edge in the same direction takes at least τ with vτ + aτ²/2 = 1. An axis that turns back must
//! first cross the scale's hysteresis h, which takes √(2h/a) from standstill. h is the least hysteresis of the scale.
//! H is the larger of h and one count. The smaller of the two times is the time after an edge in which no other can
//! come. (NISTIR 4832 uses the last period alone.)

/// Earliest time of the next real edge, for one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedGate {
    accel_counts_ns2: f64,
    turn_back_ns: f64,
    /// The same in whole ns, computed once.
    turn_back_whole_ns: u64,
    /// Highest speed at an edge before which the axis was at rest, counts/ns.
    from_rest_counts_ns: f64,
    /// Shortest time of a count that begins at that speed, ns.
    from_rest_ns: f64,
    need_ns: u64,
    min_period_ns: u64,
}

/// Inputs of the gate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedGateConfig {
    /// The axis's acceleration limit, counts/s².
    /// Zero means that the axis cannot accelerate.
    pub max_accel_counts_s2: f64,
    /// The least hysteresis of the scale on reversal, counts.
    /// Any real scale has more than zero.
    pub hysteresis_counts: f64,
    /// The longest time from an edge until its insertion is over for the MTC, ns.
    pub need_ns: u64,
}

impl SpeedGate {
    /// A gate, or `None` where no period of this axis is long enough.
    /// Then the acceleration limit contradicts the time needed.
    pub fn new(input: SpeedGateConfig) -> Option<Self> {
        let need = input.need_ns as f64;
        let a = input.max_accel_counts_s2 * 1e-18;
        let turn_back_ns = if a > 0.0 { (2.0 * input.hysteresis_counts / a).sqrt() } else { f64::INFINITY };
        // The highest speed at which one count still takes the time needed, and the shortest period that excludes more.
        let v = (1.0 - a * need * need / 2.0) / need;
        let from_rest_counts_ns = (2.0 * a * (1.0 + input.hysteresis_counts.max(1.0))).sqrt();
        if v <= 0.0 || v < from_rest_counts_ns || turn_back_ns < need {
            return None;
        }
        let min_period_ns = (2.0 / (v + (v * v - 2.0 * a).sqrt())).ceil() as u64;
        let from_rest_ns = travel_ns(from_rest_counts_ns, a, 1.0);
        Some(Self {
            accel_counts_ns2: a,
            turn_back_ns,
            turn_back_whole_ns: turn_back_ns as u64,
            from_rest_counts_ns,
            from_rest_ns,
            need_ns: input.need_ns,
            min_period_ns,
        })
    }

    /// The shortest last period at which an insertion may begin, ns.
    pub const fn min_period_ns(&self) -> u64 {
        self.min_period_ns
    }

    /// Worst-case time from the edge that opens an insertion until its end, ns.
    pub const fn need_ns(&self) -> u64 {
        self.need_ns
    }

    /// The highest speed at an edge after a period of at least `period_ns`, counts/ns.
    fn speed_counts_ns(&self, period_ns: u64) -> f64 {
        // Signed, because that conversion takes one instruction and the unsigned one six. No period is that long.
        let (t, a) = (period_ns.clamp(1, i64::MAX as u64) as i64 as f64, self.accel_counts_ns2);
        let v = 1.0 / t + a * t / 2.0;
        if a * t * t < 2.0 { v } else { v.min(self.from_rest_counts_ns) }
    }

    /// Time after an edge in which no other can come, ns.
    /// The period before the edge was at least `period_ns`.
    pub fn quiet_ns(&self, period_ns: u64) -> u64 {
        let travel_ns = self.travel_ns(period_ns, 1.0);
        (if travel_ns < self.turn_back_ns { travel_ns } else { self.turn_back_ns }) as i64 as u64
    }

    /// Whether an edge in the same direction breaks the acceleration limit.
    /// It came `after_ns` after an edge with the given period before it. The condition is vτ + aτ²/2 < 1 with v = 1/T +
    /// aT/2, multiplied by T.
    #[inline]
    pub fn too_soon(&self, period_ns: u64, after_ns: u64) -> bool {
        // An edge no sooner than the period before is always within the limit.
        after_ns < period_ns && self.beyond_limit(period_ns, after_ns)
    }

    fn beyond_limit(&self, period_ns: u64, after_ns: u64) -> bool {
        let (t, tau, a) = (period_ns as f64, after_ns as f64, self.accel_counts_ns2);
        tau + a / 2.0 * tau * t * (t + tau) < t || tau < self.from_rest_ns && a * t * t >= 2.0
    }

    /// The shortest time in which the axis can turn back over its last edge, ns.
    pub const fn turn_back_ns(&self) -> u64 {
        self.turn_back_whole_ns
    }

    /// The shortest time in which the axis can travel `counts`, ns.
    /// It starts at an edge with the given period before it.
    pub fn travel_ns(&self, period_ns: u64, counts: f64) -> f64 {
        travel_ns(self.speed_counts_ns(period_ns), self.accel_counts_ns2, counts)
    }
}

/// The time to travel `counts` from speed `v` (counts/ns) at full acceleration, ns.
fn travel_ns(v: f64, a: f64, counts: f64) -> f64 {
    2.0 * counts / (v + (v * v + 2.0 * a * counts).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gate(need_ns: u64, accel: f64) -> Option<SpeedGate> {
        SpeedGate::new(SpeedGateConfig { max_accel_counts_s2: accel, hysteresis_counts: 0.05, need_ns })
    }

    #[test]
    fn without_acceleration_the_last_period_decides() {
        let g = gate(1500, 0.0).unwrap();
        assert_eq!((g.need_ns(), g.min_period_ns()), (1500, 1500));
        assert_eq!(g.quiet_ns(2000), 2000);
    }

    #[test]
    fn acceleration_makes_a_long_period_no_promise_for_ever() {
        // 1e6 counts/s²: after any rest the first count takes at least 2/(2+√6) ms, and turning back 316 µs.
        let g = gate(1500, 1e6).unwrap();
        assert_eq!(g.quiet_ns(u64::MAX), 316_227);
        assert!((g.travel_ns(u64::MAX, 1.0) - 449_490.0).abs() < 1.0);
    }

    /// From 10 kHz at 1e6 counts/s² the next count takes at least 99.0 µs.
    /// The speed is at most a little above v = 10 050 counts/s.
    #[test]
    fn an_edge_that_comes_a_little_sooner_is_within_the_limit() {
        let g = gate(1500, 1e6).unwrap();
        assert_eq!(
            [98_900, 99_100, 99_900].map(|after_ns| g.too_soon(100_000, after_ns)),
            [true, false, false]
        );
    }

    /// The run-up through nearly the hysteresis is longer than one count.
    /// An axis that goes back that far has that much more way to accelerate.
    #[test]
    fn a_run_up_through_the_hysteresis_is_within_the_limit() {
        for h in [0.05_f64, 0.3, 0.99, 2.5] {
            let a = 1e6;
            let g = SpeedGate::new(SpeedGateConfig {
                max_accel_counts_s2: a,
                hysteresis_counts: h,
                need_ns: 100,
            })
            .unwrap();
            let (v, next) = ((2.0 * a * (1.0 + h)).sqrt(), (2.0 * a * (2.0 + h)).sqrt());
            let (period_ns, after_ns) = (3e9 * v / a, 1e9 * (next - v) / a);
            assert!(!g.too_soon(period_ns as u64, after_ns as u64 + 1), "h {h}");
            assert!(g.travel_ns(period_ns as u64, 1.0) <= after_ns + 1.0, "h {h}");
        }
    }

    #[test]
    fn several_counts_take_as_long_as_the_fastest_start_takes() {
        // √(4a) is the highest speed after any rest with one count of hysteresis: n = √(4a)·t + a·t²/2, so √a·t = √(4 +
        // 2n) − 2.
        let g = gate(1500, 1e6).unwrap();
        for (counts, ns) in [(3.0, 1_162_277.660), (7.0, 2_242_640.687)] {
            assert!((g.travel_ns(u64::MAX, counts) - ns).abs() < 0.01, "{counts}");
        }
    }

    #[test]
    fn an_axis_that_could_always_be_too_fast_has_no_gate() {
        assert_eq!(gate(1_000_000, 1e7), None);
        assert_eq!(gate(1500, f64::INFINITY), None);
    }

    proptest! {
        /// From the shortest admitted period on, the next edge cannot come too early.
        /// Too early is sooner than the time that an insertion needs.
        #[test]
        fn min_period_is_the_boundary(need in 200_u64..100_000, log_a in 0.0..8.0_f64) {
            let Some(g) = gate(need, 10_f64.powf(log_a)) else { return Ok(()) };
            let min = g.min_period_ns();
            prop_assert!(g.travel_ns(min, 1.0) >= need as f64 - 0.5);
            if min > 2 {
                prop_assert!(g.travel_ns(min - 2, 1.0) < need as f64);
            }
        }

        /// An edge is too soon exactly if it comes before the computed time of travel.
        #[test]
        fn too_soon_is_before_the_promise(a in 0.0..1e8_f64, log_t in 0.0..9.0_f64, part in 0.0..2.0_f64) {
            let Some(g) = gate(1, a) else { return Ok(()) };
            let period = 10_f64.powf(log_t) as u64;
            let travel = g.travel_ns(period, 1.0);
            let after = (travel * part) as u64;
            prop_assume!((after as f64 - travel).abs() > 1e-6 * travel + 1.0);
            prop_assert_eq!(g.too_soon(period.max(1), after), (after as f64) < travel);
        }

        /// Simulated axes within their limit never beat the computed time.
        #[test]
        fn no_motion_within_the_limit_is_faster(
            a in 1e3..1e8_f64, v0 in 0.0..1e6_f64, accel in prop::collection::vec(-1.0..=1.0_f64, 4),
        ) {
            let g = gate(1, a).unwrap();
            // From an edge at speed v0, four pieces of constant acceleration until the next edge, then full throttle.
            let (mut x, mut v, mut t) = (0.0_f64, v0, 0.0_f64);
            let dt = 0.05 / (v0 + a.sqrt());
            for k in 0_usize.. {
                let acc = a * accel[(k / 5).min(3)];
                (x, v, t) = (x + v * dt + acc * dt * dt / 2.0, v + acc * dt, t + dt);
                if !(0.0..1.0).contains(&x) || k > 1000 {
                    break;
                }
            }
            prop_assume!((1.0..1.1).contains(&x) && v > 0.0);
            let tau = 2.0 / (v + (v * v + 2.0 * a).sqrt());
            // The step overshoots the edge by up to a tenth of a count, hence the tolerance.
            prop_assert!(g.travel_ns((t * 1e9) as u64, 1.0) <= tau * 1e9 * 1.15 + 2.0);
        }
    }
}
