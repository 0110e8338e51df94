//! A first-order lag: its output follows its input late.
//!
//! The recursion is written only here.

/// The decay of a first-order lag over one step of time.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LagStepDecay {
    h_s: f64,
    /// 1 − exp(−h/τ).
    gone: f64,
}

impl LagStepDecay {
    pub(super) fn over(h_s: f64, tau_s: f64) -> Self {
        Self { h_s, gone: -(-h_s / tau_s).exp_m1() }
    }

    /// The lagged value after the step, exact for an input that is linear from u0 to u:
    /// y = u − s·τ·(1 − E) + (y0 − u0)·E, E = exp(−h/τ), s its slope.
    pub(super) fn step(self, tau_s: f64, [y0, u0, u]: [f64; 3]) -> f64 {
        let s = (u - u0) / self.h_s;
        u - s * tau_s * self.gone + (y0 - u0) * (1.0 - self.gone)
    }

    /// The derivative of the lagged value by the time constant, after the step.
    pub(super) fn step_slope(self, tau_s: f64, dy0: f64, [y0, u0, u]: [f64; 3]) -> f64 {
        let e = 1.0 - self.gone;
        let de = e * self.h_s / (tau_s * tau_s);
        let s = (u - u0) / self.h_s;
        -s * self.gone + s * tau_s * de + dy0 * e + (y0 - u0) * de
    }
}

/// The cache place, of eight, for a step of this length.
fn place_of(h_s: f64) -> usize {
    (h_s.to_bits().wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 61) as usize
}

/// An input passed through a first-order lag row by row.
/// It starts in equilibrium at its first row.
#[derive(Debug)]
pub struct Lag(ParallelLags<1>);

impl Lag {
    /// A lag of this time constant, s.
    pub fn new(tau_s: f64) -> Self {
        Self(ParallelLags::new([tau_s]))
    }

    /// A lag that continues from the state of another one.
    pub(super) fn going_on(tau_s: f64, at: Option<[f64; 3]>) -> Self {
        Self(ParallelLags { before: at.map(|[y, u, t_s]| ([y], u, t_s)), ..ParallelLags::new([tau_s]) })
    }

    /// Its state: lagged value, input and time of the last row.
    /// `None` before the first.
    pub(super) fn at(&self) -> Option<[f64; 3]> {
        self.0.before.map(|([y], u, t_s)| [y, u, t_s])
    }

    /// The lagged input at the next row. It stays while time stands still.
    pub fn next(&mut self, t_s: f64, u: f64) -> f64 {
        let [y] = self.0.next(t_s, u);
        y
    }
}

/// An input passed through several lags at once, row by row.
/// It equals as many `Decay::step`s to the last digit and is faster.
#[derive(Debug)]
pub struct ParallelLags<const N: usize> {
    taus_s: [f64; N],
    /// The cached steps, each with 1 − exp(−h/τ) of every lag.
    /// Rows that are one step apart except for rounding have a few different lengths.
    steps: [(f64, [f64; N]); 8],
    /// Lagged values, input and time of the previous row.
    before: Option<([f64; N], f64, f64)>,
}

impl<const N: usize> ParallelLags<N> {
    /// Lags of these time constants, s.
    pub fn new(taus_s: [f64; N]) -> Self {
        Self { taus_s, steps: [(0.0, [0.0; N]); 8], before: None }
    }

    /// The lagged inputs at the next row. They stay while time stands still.
    #[inline]
    pub fn next(&mut self, t_s: f64, u: f64) -> [f64; N] {
        let lagged = match self.before {
            None => [u; N],
            Some((mut y, u0, t0)) if t_s > t0 => {
                let h_s = t_s - t0;
                let (known_s, gone) = &mut self.steps[place_of(h_s)];
                if known_s.to_bits() != h_s.to_bits() {
                    *known_s = h_s;
                    *gone = self.taus_s.map(|tau_s| LagStepDecay::over(h_s, tau_s).gone);
                }
                let s = (u - u0) / h_s;
                for ((y, gone), tau_s) in y.iter_mut().zip(gone).zip(self.taus_s) {
                    *y = u - s * tau_s * *gone + (*y - u0) * (1.0 - *gone);
                }
                y
            }
            Some((y, ..)) => y,
        };
        self.before = Some((lagged, u, t_s));
        lagged
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Several lags at once equal single steps, even, uneven and of no time.
    #[test]
    fn several_lags_at_once_are_each_to_the_last_digit() {
        let taus_s = [0.5, 30.0, 77.0, 4000.0];
        let mut together = ParallelLags::new(taus_s);
        let (mut t_s, mut u0, mut each) = (0.0, 20.0, [20.0; 4]);
        for i in 0..500_u32 {
            let h_s = if i % 50 == 0 { 0.0 } else { 0.1 + f64::from(i * i % 17) };
            let (before_s, u) = (t_s, 20.0 + f64::from(i * 7 % 31));
            t_s += h_s;
            for (y, tau_s) in each.iter_mut().zip(taus_s).filter(|_| h_s > 0.0) {
                *y = LagStepDecay::over(t_s - before_s, tau_s).step(tau_s, [*y, u0, u]);
            }
            u0 = u;
            assert_eq!(together.next(t_s, u).map(f64::to_bits), each.map(f64::to_bits), "row {i}");
        }
    }

    /// After one time constant the rest of a step is 1/e, however many rows there are.
    #[test]
    fn a_step_fades_with_the_time_constant() {
        for rows in [1, 7, 100] {
            let mut lag = Lag::new(50.0);
            assert_eq!((lag.next(0.0, 0.0), lag.next(0.0, 1.0)), (0.0, 0.0));
            let mut y = 0.0;
            for k in 1..=rows {
                y = lag.next(50.0 * f64::from(k) / f64::from(rows), 1.0);
            }
            assert!((y - (1.0 - (-1.0_f64).exp())).abs() < 1e-12, "{rows} rows: {y}");
        }
    }

    /// The derivative by the time constant against a difference quotient.
    #[test]
    fn the_slope_by_the_time_constant_is_the_difference_quotient() {
        let step = |tau: f64| LagStepDecay::over(10.0, tau).step(tau, [2.0, 1.0, 4.0]);
        let slope = LagStepDecay::over(10.0, 30.0).step_slope(30.0, 0.0, [2.0, 1.0, 4.0]);
        assert!((slope - (step(30.001) - step(29.999)) / 0.002).abs() < 1e-8);
    }
}
