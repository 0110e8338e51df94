//! How far the search goes. Each number bounds its work and was chosen by run time.
//! If a number is too small, something is not found. Whether a larger one changes an answer was not measured for each. The numbers that
//! decide an answer are in [`priors`](crate::priors).

/// Families tried exactly at each step of the search; also the sets that are kept.
pub const TRIED: usize = 30;
/// Sets that grow side by side.
pub const KEPT: usize = 3;
/// A family this far below the best is not refined, nats.
pub const HOPELESS: f64 = 8.0;
/// A family with log odds below this is not looked at exactly, nats.
pub const WORTHLESS: f64 = -5.0;
/// A member with more evidence than this is not exchanged in a pair, nats.
pub const STRONG: f64 = 40.0;
/// Most shapes of one response.
/// A response that needs more is not understood, and further shapes would not explain it.
pub const MOST_SHAPES: usize = 2;
/// Most members of a set.
pub const MOST_MEMBERS: usize = 14;
/// Directions of the air's influence that are followed.
pub const AIR_DIRECTIONS: usize = 8;
/// Usual periods tried exactly, beside the largest of all.
pub const USUAL_TRIED: usize = 3;
/// Frequencies of a wave that are tried exactly.
pub const PEAKS: usize = 12;
/// Temperature differences of a law that are tried exactly.
pub const DIFFERENCES: usize = 4;
/// Waves whose columns are kept.
pub const WAVES_KEPT: usize = 400;
/// Rounds of search and noise.
pub const ROUNDS: usize = 6;
/// The noise has settled if its size and its memory change by less than this.
/// The size as a share, the autocorrelation as a difference.
pub const SETTLED: (f64, f64) = (0.1, 0.08);
/// Steps of the noise of one set.
pub const NOISE_STEPS: usize = 3;
/// Hypotheses that are tried under their own noise.
pub const UNDER_NOISE: usize = 4;
/// Rows on either side of a step at which it may have been as well.
pub const MOMENT_ROWS: usize = 30;
/// Times that rounding is taken out as the fit predicts it.
pub const ROUNDING_STEPS: usize = 3;
/// Steps of the last fit.
pub const LAST_STEPS: usize = 4;
/// Largest autocorrelation of the whitened residual.
/// Above it the rows are too close together.
pub const REMEMBERS: f64 = 0.15;
/// A wave is out of step by more than this, in turns over the travel.
pub const OUT_OF_STEP: f64 = 0.01;
/// Rows differ by little as one: share of the whole range.
pub const ONE_PLACE: f64 = 1.0 / 300.0;
/// Time constants that are tried.
pub const TIME_CONSTANTS: usize = 14;
/// Autocorrelation from which a slow signal may be an effect, not noise.
pub const MUCH_MEMORY: f64 = 0.3;
/// Variances of a walk, in the noise's, that are tried; each as likely.
pub const WALK_SIZES: [f64; 7] = [0.02, 0.05, 0.15, 0.4, 1.0, 3.0, 10.0];
/// Memories of a walk, in rows, that are tried; each as likely.
pub const WALK_MEMORIES: [f64; 6] = [6.0, 12.0, 25.0, 50.0, 100.0, 200.0];
/// Fewest rows of a segment in which a walk is looked for.
pub const WALK_FEWEST_ROWS: usize = 48;
/// Most columns of a walk.
pub const WALK_RANK: usize = 60;
/// Grid points of a spectrum to the shortest period.
pub const PER_PERIOD: f64 = 6.0;
/// The longest grid of a spectrum.
pub const LONGEST: usize = 1 << 18;
/// Frequency steps in shares of one turn over the whole range.
pub const FREQUENCY_STEP: f64 = 0.35;
/// Least share of power that tells sine and cosine from a constant.
pub const ALONE: f64 = 0.01;
/// Most directions of one smooth shape.
pub const SHAPE_RANK: usize = 12;
/// Most directions along each of two axes of what is dented over their plane.
pub const PLANE_RANK: usize = 5;
/// Most directions of how the size of a wave changes.
pub const CHANGING: usize = 8;
/// Most harmonics of what repeats in time.
pub const HARMONICS: usize = 5;
/// Times at which creep begins, in shares of a run.
pub const CREEPS: [f64; 3] = [3e-3, 0.02, 0.1];
/// Places per millimetre: positions closer together count as one.
pub const PLACES_PER_MM: f64 = 20.0;
/// Angles closer than this count as one, rad.
pub const PLACE_RAD: f64 = std::f64::consts::TAU / 7200.0;
/// Fewest rows for which a shape is tried.
pub const SHAPE_FEWEST_ROWS: usize = 12;
/// Most sensors whose products are tried.
pub const MOST_SENSORS: usize = 6;
/// A run that pauses more often than this is a run in steps.
pub const MOST_PAUSES: usize = 12;
/// Most places that may each have an error of its own.
pub const MOST_PLACES: usize = 150;
