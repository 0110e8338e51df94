//! Limits of the search's work; each was chosen by run time.
//! If a limit is too small, something is not found. Whether a larger one changes an answer was not measured
//! for each. The numbers that decide an answer are in [`priors`](crate::priors).

/// Number of families computed exactly per step, and of equivalent waves kept.
pub const TRIED: usize = 30;
/// Number of sets that grow in parallel.
pub const KEPT: usize = 3;
/// A family this far below the best is not refined, nats.
pub const HOPELESS: f64 = 8.0;
/// A family with log odds below this is not computed exactly, nats.
pub const WORTHLESS: f64 = -5.0;
/// A member with more evidence than this is not exchanged in a pair, nats.
pub const STRONG: f64 = 40.0;
/// Largest number of shapes of one response.
/// A response that needs more is not understood, and further shapes would not explain it.
pub const MOST_SHAPES: usize = 2;
/// Largest number of members of a set.
pub const MOST_MEMBERS: usize = 14;
/// Number of directions kept of the influence of air.
pub const AIR_DIRECTIONS: usize = 8;
/// Number of usual periods tried exactly, in addition to the strongest.
pub const USUAL_TRIED: usize = 3;
/// Number of frequencies of a wave tried exactly.
pub const PEAKS: usize = 12;
/// Number of temperature differences of a law tried exactly.
pub const DIFFERENCES: usize = 4;
/// Number of waves whose columns are cached.
pub const WAVES_KEPT: usize = 400;
/// Largest number of rounds of search and noise.
pub const ROUNDS: usize = 6;
/// The noise has settled if its size and its autocorrelation change by less.
/// The size changes by a share, the autocorrelation by a difference.
pub const SETTLED: (f64, f64) = (0.1, 0.08);
/// Iterations of the noise of one set.
pub const NOISE_STEPS: usize = 3;
/// Number of hypotheses tried under their own noise.
pub const UNDER_NOISE: usize = 4;
/// Rows on either side of a step in time that are tried as its moment.
pub const MOMENT_ROWS: usize = 30;
/// Number of times that rounding is removed as the fit predicts it.
pub const ROUNDING_STEPS: usize = 3;
/// Iterations of the last fit.
pub const LAST_STEPS: usize = 4;
/// Largest autocorrelation of the whitened residual.
/// Above it the rows are too close together.
pub const REMEMBERS: f64 = 0.15;
/// Phase error over the travel from which a wave is out of step, turns.
pub const OUT_OF_STEP: f64 = 0.01;
/// Rows that differ by less are at one position, as a share of the range.
pub const ONE_PLACE: f64 = 1.0 / 300.0;
/// Number of places at which a circle of unknown centre may lie on a map.
pub const CIRCLE_PLACES: usize = 32;
/// Steps in which a response's noise and that of its segments agree.
pub const SIZE_STEPS: usize = 8;
/// Number of time constants tried.
pub const TIME_CONSTANTS: usize = 14;
/// Autocorrelation from which a slow signal may be an effect, not noise.
pub const MUCH_MEMORY: f64 = 0.3;
/// Variances of a walk that are tried, in the noise's variance; all equally likely.
pub const WALK_SIZES: [f64; 7] = [0.02, 0.05, 0.15, 0.4, 1.0, 3.0, 10.0];
/// Correlation lengths of a walk that are tried, in rows; all equally likely.
pub const WALK_MEMORIES: [f64; 6] = [6.0, 12.0, 25.0, 50.0, 100.0, 200.0];
/// Fewest rows of a segment in which a walk is searched.
pub const WALK_FEWEST_ROWS: usize = 48;
/// Largest number of columns of a walk.
pub const WALK_RANK: usize = 60;
/// Grid points of a spectrum per shortest period.
pub const PER_PERIOD: f64 = 6.0;
/// Largest number of grid points of a spectrum.
pub const LONGEST: usize = 1 << 18;
/// Frequency step, as a share of one turn over the whole range.
pub const FREQUENCY_STEP: f64 = 0.35;
/// Least share of power by which sine and cosine differ from a constant.
pub const ALONE: f64 = 0.01;
/// Largest number of directions of one smooth shape.
pub const SHAPE_RANK: usize = 12;
/// Largest number of directions along each axis of a shape over a plane.
pub const PLANE_RANK: usize = 5;
/// Largest number of directions of a wave's changing size.
pub const CHANGING: usize = 16;
/// Largest number of harmonics of a shape that repeats in time.
pub const HARMONICS: usize = 5;
/// Number of moments tried at which a saw-tooth falls back, per period.
pub const SAW_PHASES: i32 = 24;
/// Times at which creep begins, as shares of a run.
pub const CREEPS: [f64; 3] = [3e-3, 0.02, 0.1];
/// Grid of positions, per mm: positions closer together count as one.
pub const PLACES_PER_MM: f64 = 20.0;
/// Angles closer than this count as one, rad.
pub const PLACE_RAD: f64 = std::f64::consts::TAU / 7200.0;
/// Fewest rows for which a shape is tried.
pub const SHAPE_FEWEST_ROWS: usize = 12;
/// Largest number of sensors whose products are tried.
pub const MOST_SENSORS: usize = 6;
/// A run that pauses more often than this is a run in steps.
pub const MOST_PAUSES: usize = 12;
/// Fewest cycles that may each have their own level.
/// Two levels are one step in time.
pub const FEWEST_CYCLES: usize = 3;
/// Largest number of positions that may each have their own error.
pub const MOST_PLACES: usize = 150;
