//! The edges of a scale with its interpolator, on straight lines between positions.

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;

/// A scale with its interpolator, on straight lines between samples.
pub(super) struct SimulatedScale {
    hysteresis: f64,
    /// Time in ns and position in counts of the last sample.
    from: (u64, f64),
    /// The present count and the state at it, with the time of its edge.
    count: i64,
    pub(super) at: TracePoint,
}

impl SimulatedScale {
    pub(super) fn new(t_ns: u64, counts: f64, hysteresis: f64) -> Self {
        let count = counts.floor() as i64;
        // The state depends on the count only: 0 is 00, 1 is 10, 2 is 11, 3 is 01.
        let state = (0..count.rem_euclid(4)).fold(State::default(), |state, _| state.next(true));
        Self { hysteresis, from: (t_ns, counts), count, at: TracePoint { t_ns, state } }
    }

    /// Reports each edge on the way to a sample.
    /// `false` if they do not fit into whole nanoseconds.
    pub(super) fn move_to<E>(
        &mut self,
        t_ns: u64,
        counts: f64,
        edge: &mut dyn FnMut(TracePoint) -> Result<(), E>,
    ) -> Result<bool, E> {
        let (from_ns, from) = std::mem::replace(&mut self.from, (t_ns, counts));
        let span_ns = (t_ns - from_ns) as f64;
        let up = counts > from;
        loop {
            let half = self.hysteresis / 2.0;
            let boundary = if up { (self.count + 1) as f64 + half } else { self.count as f64 - half };
            if (up && counts < boundary) || (!up && counts >= boundary) {
                return Ok(true);
            }
            // The first sample may already be beyond the boundary; its edge is then due at once.
            let part = ((boundary - from) / (counts - from)).clamp(0.0, 1.0);
            let at_ns = (from_ns + (part * span_ns).round() as u64).max(self.at.t_ns + 1);
            if at_ns > t_ns {
                return Ok(false);
            }
            self.count += if up { 1 } else { -1 };
            self.at = TracePoint { t_ns: at_ns, state: self.at.state.next(up) };
            edge(self.at)?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times and counts of the edges along samples (ns, counts).
    fn edges(samples: &[(u64, f64)], hysteresis: f64) -> Option<Vec<(u64, i64)>> {
        let mut scale = SimulatedScale::new(samples[0].0, samples[0].1, hysteresis);
        let (mut count, mut state) = (samples[0].1.floor() as i64, scale.at.state);
        let mut edges = Vec::new();
        for &(t_ns, counts) in &samples[1..] {
            let fits = scale.move_to(t_ns, counts, &mut |point| {
                count += i64::from(state.step_to(point.state).expect("never both signals at once"));
                state = point.state;
                edges.push((point.t_ns, count));
                Ok::<(), ()>(())
            });
            if !fits.unwrap() {
                return None;
            }
        }
        Some(edges)
    }

    #[test]
    fn edges_fall_on_the_straight_line() {
        let there_and_back = [(0, 0.5), (1000, 2.5), (2000, 0.5)];
        let want = [(250, 1), (750, 2), (1250, 1), (1750, 0)];
        assert_eq!(edges(&there_and_back, 0.0).unwrap(), want);
        let late = [(300, 1), (800, 2), (1300, 1), (1800, 0)];
        assert_eq!(edges(&there_and_back, 0.2).unwrap(), late);
        let below_zero = [(0, -0.5), (1000, -2.5)];
        assert_eq!(edges(&below_zero, 0.0).unwrap(), [(250, -2), (750, -3)]);
    }

    #[test]
    fn noise_within_the_hysteresis_gives_no_edge() {
        let noise: Vec<_> =
            (0..100).map(|n| (n * 1000, 7.0 + if n % 2 == 0 { 0.04 } else { -0.04 })).collect();
        assert_eq!(edges(&noise, 0.0).unwrap().len(), 99);
        assert!(edges(&noise, 0.1).unwrap().is_empty());
    }

    #[test]
    fn a_motion_faster_than_a_count_a_nanosecond_is_refused() {
        assert!(edges(&[(0, 0.5), (10, 9.5)], 0.0).is_some());
        assert!(edges(&[(0, 0.5), (10, 30.5)], 0.0).is_none());
    }

    #[test]
    fn an_equal_position_shows_an_equal_state() {
        for counts in [-5.0, -4.0, -1.0, 0.0, 3.0, 4.0] {
            let up = SimulatedScale::new(0, counts + 4.0, 0.0).at.state;
            assert_eq!(SimulatedScale::new(0, counts, 0.0).at.state, up);
            assert_eq!(up.step_to(SimulatedScale::new(0, counts + 1.0, 0.0).at.state), Some(1));
        }
    }
}
