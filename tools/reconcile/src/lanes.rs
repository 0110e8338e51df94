//! Sums of products, and waves, over many numbers at once: in several lanes, in a fixed order of summation, so that every machine comes
//! to the same digits.

/// Lanes of a dot product: enough for the additions not to wait for one another.
const LANES: usize = 8;

/// A function for any processor, and the same again for one with registers of 256 bits: the same digits, as no products
/// and sums are fused.
macro_rules! wide {
    ($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty $body:block) => {
        $(#[$doc])*
        $vis fn $name($($arg: $type),*) -> $out {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn wide($($arg: $type),*) -> $out $body
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has what the function is compiled for.
                    return unsafe { wide($($arg),*) };
                }
            }
            $body
        }
    };
}

/// Dot product in several lanes, in a fixed order of summation.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    if a.len() < LANES { a.iter().zip(b).map(|(x, y)| x * y).sum() } else { long_dot(a, b) }
}

wide! {
    fn long_dot(a: &[f64], b: &[f64]) -> f64 {
        let mut lanes = [0.0; LANES];
        let (ca, cb) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
        let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| x * y).sum();
        for (x, y) in ca.zip(cb) {
            for k in 0..LANES {
                lanes[k] += x[k] * y[k];
            }
        }
        fold(lanes) + tail
    }
}

wide! {
    /// `[a·c, b·c]` in one run through the memory.
    pub(crate) fn dots(a: &[f64], b: &[f64], c: &[f64]) -> [f64; 2] {
        let (mut first, mut second) = ([0.0; LANES], [0.0; LANES]);
        let (ca, cb, cc) = (a.chunks_exact(LANES), b.chunks_exact(LANES), c.chunks_exact(LANES));
        let mut tail = [0.0; 2];
        for ((x, y), z) in ca.remainder().iter().zip(cb.remainder()).zip(cc.remainder()) {
            tail[0] += x * z;
            tail[1] += y * z;
        }
        for ((x, y), z) in ca.zip(cb).zip(cc) {
            for k in 0..LANES {
                first[k] += x[k] * z[k];
                second[k] += y[k] * z[k];
            }
        }
        [fold(first) + tail[0], fold(second) + tail[1]]
    }
}

wide! {
    /// `[[a·c, b·c], [a·d, b·d]]` in one run through the memory, each to the last digit as [`dots`] has it.
    pub(crate) fn dots_of_two(a: &[f64], b: &[f64], c: &[f64], d: &[f64]) -> [[f64; 2]; 2] {
        let mut lanes = [[[0.0; LANES]; 2]; 2];
        let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
        let ((c, c_rest), (d, d_rest)) = (c.as_chunks::<LANES>(), d.as_chunks::<LANES>());
        for ((x, y), (z, w)) in a.iter().zip(b).zip(c.iter().zip(d)) {
            for k in 0..LANES {
                lanes[0][0][k] += x[k] * z[k];
                lanes[0][1][k] += y[k] * z[k];
                lanes[1][0][k] += x[k] * w[k];
                lanes[1][1][k] += y[k] * w[k];
            }
        }
        let tail = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let [[ac, bc], [ad, bd]] = lanes.map(|two| two.map(fold));
        [
            [ac + tail(a_rest, c_rest), bc + tail(b_rest, c_rest)],
            [ad + tail(a_rest, d_rest), bd + tail(b_rest, d_rest)],
        ]
    }
}

wide! {
    /// The same with c in single precision; all arithmetic is done in full.
    pub(crate) fn dots_with(a: &[f64], b: &[f64], c: &[f32]) -> [f64; 2] {
        let (mut first, mut second) = ([0.0; LANES], [0.0; LANES]);
        let (ca, cb, cc) = (a.chunks_exact(LANES), b.chunks_exact(LANES), c.chunks_exact(LANES));
        let mut tail = [0.0; 2];
        for ((x, y), z) in ca.remainder().iter().zip(cb.remainder()).zip(cc.remainder()) {
            tail[0] += x * f64::from(*z);
            tail[1] += y * f64::from(*z);
        }
        for ((x, y), z) in ca.zip(cb).zip(cc) {
            for k in 0..LANES {
                let z = f64::from(z[k]);
                first[k] += x[k] * z;
                second[k] += y[k] * z;
            }
        }
        [fold(first) + tail[0], fold(second) + tail[1]]
    }
}

wide! {
    /// Dot product of two columns in single precision; all arithmetic is done in full.
    pub(crate) fn dot_of_singles(a: &[f32], b: &[f32]) -> f64 {
        let mut lanes = [0.0; LANES];
        let (ca, cb) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
        let both = |x: f32, y: f32| f64::from(x) * f64::from(y);
        let tail: f64 = ca.remainder().iter().zip(cb.remainder()).map(|(x, y)| both(*x, *y)).sum();
        for (x, y) in ca.zip(cb) {
            for k in 0..LANES {
                lanes[k] += both(x[k], y[k]);
            }
        }
        fold(lanes) + tail
    }
}

wide! {
    /// `b - by·a` in place of b.
    fn long_minus(b: &mut [f64], by: f64, a: &[f64]) -> () {
        for (b, a) in b.iter_mut().zip(a) {
            *b -= by * a;
        }
    }
}

/// `b - by·a` in place of b.
pub(crate) fn minus(b: &mut [f64], by: f64, a: &[f64]) {
    // What acts on different responses has nothing in common.
    if by == 0.0 {
        return;
    }
    if a.len() < LANES {
        b.iter_mut().zip(a).for_each(|(b, a)| *b -= by * a);
    } else {
        long_minus(b, by, a);
    }
}

wide! {
    /// Where in a turn so many turns are: the same digits as a remainder, in a fraction of its time.
    pub(crate) fn in_a_turn(turns: &mut [f64]) -> () {
        for x in turns {
            *x -= x.floor();
        }
    }
}

wide! {
    /// Single into double precision.
    pub(crate) fn widen(from: &[f32], to: &mut [f64]) -> () {
        for (o, x) in to.iter_mut().zip(from) {
            *o = f64::from(*x);
        }
    }
}

fn fold(lanes: [f64; LANES]) -> f64 {
    let mut half = LANES;
    let mut lanes = lanes;
    while half > 1 {
        half /= 2;
        for k in 0..half {
            lanes[k] += lanes[k + half];
        }
    }
    lanes[0]
}

wide! {
    /// [`wave`] of so many turns per unit at some places.
    pub(crate) fn waves(turns: f64, places: &[f64], sines: &mut [f64], cosines: &mut [f64]) -> () {
        for ((place, sine), cosine) in places.iter().zip(sines).zip(cosines) {
            (*sine, *cosine) = wave(turns * place);
        }
    }
}

/// Sine and cosine of so many turns, to the last digit or two, the same on every machine and quick over many values:
/// polynomials over an eighth of a turn either way.
#[inline]
pub(crate) fn wave(turns: f64) -> (f64, f64) {
    // Adding this puts the nearest whole number into the last bits.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let quarters = turns * 4.0;
    let shifted = quarters + ROUND;
    let quadrant = shifted.to_bits() & 3;
    let x = (quarters - (shifted - ROUND)) * std::f64::consts::FRAC_PI_2;
    let y = x * x;
    let sin = x
        * (1.0
            + y * (-1.0 / 6.0
                + y * (1.0 / 120.0
                    + y * (-1.0 / 5040.0
                        + y * (1.0 / 362_880.0
                            + y * (-1.0 / 39_916_800.0
                                + y * (1.0 / 6_227_020_800.0 - y / 1_307_674_368_000.0)))))));
    let cos = 1.0
        + y * (-0.5
            + y * (1.0 / 24.0
                + y * (-1.0 / 720.0
                    + y * (1.0 / 40_320.0
                        + y * (-1.0 / 3_628_800.0
                            + y * (1.0 / 479_001_600.0
                                + y * (-1.0 / 87_178_291_200.0 + y / 20_922_789_888_000.0)))))));
    let (s, c) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let sign = |value: f64, minus: u64| f64::from_bits(value.to_bits() ^ (minus << 63));
    (sign(s, quadrant >> 1), sign(c, (quadrant ^ (quadrant >> 1)) & 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wave_is_sine_and_cosine() {
        for i in -4000..4000 {
            let turns = f64::from(i) * 0.000_731;
            let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
            let (s, c) = wave(turns);
            assert!((s - sin).abs() < 1e-14 && (c - cos).abs() < 1e-14, "{turns}: {s} {c}");
        }
    }
}
