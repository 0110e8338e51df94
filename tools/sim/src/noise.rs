//! Seeded noise, the same on every machine.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{RngCore, SeedableRng};

/// A stream of pseudo-random numbers.
#[derive(Debug, Clone)]
pub struct NoiseGenerator(Xoshiro256PlusPlus);

impl NoiseGenerator {
    /// The stream of a seed; `stream` separates several uses of one seed.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed ^ stream.wrapping_mul(0x9E37_79B9_7F4A_7C15)))
    }

    /// The next number, uniform in 0..1.
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A normal variate with mean 0 and standard deviation 1.
    /// It is the sum of twelve uniforms, whose arithmetic is exact on every machine.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}
