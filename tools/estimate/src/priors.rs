//! Every number that an answer depends on.
//! The typical size of each effect is in the dictionary, with the effect.
//!
//! Sources: *contract* (tools/guide/contributor/estimate.md), *physics* (the sentence beside it), *calibration*
//! (`rtec-blind --class null --count 1000`: the largest value at which at most one clean case in a hundred is given a name).

/// Standard deviation of the model's amplitudes, as a share of each (contract).
pub const KNOWN_SHARE: f64 = 0.1;
/// Probability that a known amplitude is off by any share.
/// The file is of another machine, or a part was replaced (calibration). The amplitude then has the typical
/// size of this effect on any machine.
pub const KNOWN_REPLACED: f64 = 0.01;

/// A gauge's zero, µm, one standard deviation (physics: a dial's travel is 1 mm).
pub const ZERO_UM: f64 = 300.0;
/// Centre of a ballbar's or a ring's circle, µm, one standard deviation.
/// (Physics: set by hand on a magnetic cup.)
pub const CENTRE_UM: f64 = 50.0;
/// Rotation of a plate on the table, µrad, one standard deviation.
/// (Physics: aligned by hand within 0.05 mm over 0.5 m.)
pub const TURN_URAD: f64 = 100.0;
/// Unknown centre of a circle, mm from the axes' zero, one standard deviation.
/// (Physics: axes of 0.5 m.)
pub const PLACE_MM: f64 = 250.0;
/// Typical travel of a measured axis, mm, and the factor of its spread.
/// (Physics: axes of 0.1 to 3 m; signal periods are measured over some mm.) It tells mm from inches and metres.
pub const TRAVEL_MM: [f64; 2] = [500.0, 3.0];
/// Linear drift of a laser's or gauge's reading, µm/h.
/// (Physics: 1 K of air is 1 µm/m.)
pub const LINE_UM_PER_H: f64 = 1.0;
/// Hours for which the drift keeps its direction.
/// (Physics: a shift, a heating, the sun.)
pub const LINE_HOURS: f64 = 3.0;
/// Wander of air and stand around the drift, µm, and its correlation time, s.
/// (Physics: half a metre of air that is 0.3 K warmer for ten minutes.)
pub const AIR_UM_S: (f64, f64) = (0.15, 600.0);
/// A jump at a pause, µm, and its probability.
/// (Physics: somebody touched the stand.)
pub const JUMP_UM_PROBABILITY: (f64, f64) = (3.0, 0.02);
/// A gap in time of this many usual steps is a pause.
pub const PAUSE_STEPS: f64 = 8.0;

/// Levels of an amplitude, in typical sizes, and their prior weights.
/// A heavy tail in four steps (calibration).
pub const LEVELS: [(f64, f64); 4] = [(1.0 / 3.0, 0.25), (1.0, 0.4), (3.0, 0.25), (10.0, 0.1)];
/// Size of a coefficient without shrinkage, in typical sizes.
/// Ten times the largest level.
pub const WIDE: f64 = 10.0 * LEVELS[LEVELS.len() - 1].0;
/// Price of one more effect, nats, apart from the choice of its name (calibration).
pub const PRICE: f64 = 3.0;
/// Prior share of effects with a name; the rest is for shapes (calibration).
pub const NAMED_SHARE: f64 = 0.75;
/// Prior share of pairs among temperature differences.
/// (Physics: growth follows one source, or a source against its surroundings.)
pub const PAIR_SHARE: f64 = 0.5;
/// Price of the same law once more on the same axis, nats (calibration).
pub const AGAIN: f64 = 2.0;
/// Prior share of usual periods among all periods.
/// (Physics: catalogues of leads and gratings.)
pub const USUAL_SHARE: f64 = 0.5;
/// A usual period is met to within this share.
/// (Physics: 40 K of steel and a tenth of a millimetre per metre of lead error.)
pub const USUAL_WITHIN: f64 = 1e-3;
/// Typical wave within the signal period, as a share of the largest one.
/// The largest is the one with which the scale still counts. (Physics: 1 to 2 % of the period, of 25 %.)
pub const OF_MOST: f64 = 0.06;
/// Prior probability that growth has a square of ΔT.
/// (Physics: spindles bend by some per cent.)
pub const BENT_SHARE: f64 = 0.25;
/// Price of a time constant beyond the dictionary's plausible range, nats.
/// (Physics: parts of a machine take minutes to hours.)
pub const IMPLAUSIBLE: f64 = 3.0;
/// Size of a channel's or a shape's contribution, µm or N.
/// (Physics: errors that remain on a machine are some µm.)
pub const CONTRIBUTION: f64 = 3.0;

/// Correlation lengths of maps and smooth shapes, in shares of the range.
/// (Physics: guideways bend over their length, screws and scales over a tenth of it.)
pub const LENGTHS: [f64; 2] = [0.3, 0.1];
/// Largest number of knots of a smooth function; a map's sharpness decides answers.
/// (Calibration: with 80 knots and a rank of 2e-4, three of 482 blind cases were answered differently.)
pub const KNOTS: usize = 40;
/// Least variance of a smooth function's direction, as a share of the largest.
/// Directions with less are left out. (Calibration: at 1e-3, the part of a bow of 12 µm that a map cannot
/// show was named, with noise of 0.2 µm.)
pub const SMOOTH_RANK: f64 = 1e-5;

/// Typical scatter of a reading, µm (forces: N), and the factor of its spread.
/// The factor is one standard deviation. (Physics: from a laser on a quiet axis to a dial on a worn one.) It tells a unit error from noise
/// of a metre.
pub const NOISE: [f64; 2] = [0.5, 5.0];
/// Likeness of one response's noise from record to record, in shared rows.
/// Two shared rows let its size differ by some 60 %. (Physics: another day, another operator, air that is
/// quiet or not.)
pub const ALIKE_ROWS: f64 = 2.0;
/// Largest autocorrelation from row to row that counts as noise (contract).
/// In the prior it is two standard deviations. (Calibration: without that prior, noise with memory replaced a
/// weak map in two of 482 blind cases and one measured axis.)
pub const MOST_PHI: f64 = 0.7;
/// Degrees of freedom of the noise's tails (physics: rare knocks of a gauge).
/// The second number is where they begin, in standard deviations: one of a hundred readings is further away.
pub const TAILS: (f64, f64) = (5.0, 2.5);

/// Deviation of a reference temperature from 20 °C, K, one standard deviation.
pub const REFERENCE_K: f64 = 2.0;
/// Periods of one mode differ by less than this share.
pub const SAME_PERIOD: f64 = 0.02;
/// Error of a period, as a share, one standard deviation.
/// (Contract: as given, with the digits that people write.)
pub const PERIOD_SHARE: f64 = 1e-4;
/// Number of kinds of shapes among which a walk is one (even odds).
pub const WALK_KINDS: f64 = 30.0;
/// Two waves look the same if they share this much of their power.
/// (Physics: what is left of one after the other is a tenth of its size.)
pub const ALIKE: f64 = 0.99;
/// Least posterior share that a name or a mode must have among its candidates.
pub const HELD: f64 = 0.95;
/// Something is missing if the posterior share is above this.
pub const THERE: f64 = 0.5;
/// A rival within these odds is listed, nats (1 to 20).
pub const LISTED: f64 = 3.0;
/// A known effect is corrected if chance is less probable than this.
/// (Contract: "beyond chance".)
pub const CHANCE: f64 = 1e-4;
