//! Clocks: the source of a card's time.

/// Monotonic time in nanoseconds.
pub trait Clock {
    /// Nanoseconds since an arbitrary start; never runs back.
    fn now_ns(&mut self) -> u64;
}

/// The kernel's `CLOCK_MONOTONIC`, the clock that GPIO edge time stamps use too.
/// Read through the vDSO: no system call.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    #[inline]
    fn now_ns(&mut self) -> u64 {
        let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `t` is a valid, writable timespec for the duration of the call.
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut t) };
        t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
    }
}

/// A clock that a test or a simulation moves by hand.
#[derive(Debug, Clone, Copy, Default)]
pub struct Virtual {
    /// The present time.
    pub now_ns: u64,
}

impl Clock for Virtual {
    #[inline]
    fn now_ns(&mut self) -> u64 {
        self.now_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn monotonic_does_not_run_back() {
        let mut clock = Monotonic;
        let mut last = clock.now_ns();
        for _ in 0..1000 {
            let now = clock.now_ns();
            assert!(now >= last);
            last = now;
        }
    }
}
