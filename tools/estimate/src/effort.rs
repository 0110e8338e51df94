//! How far the search goes: each number bounds its work, and was chosen by time.
//! Where one is too small something is not found; that a larger one changes no answer was not measured for each. What decides stands in
//! [`priors`](crate::priors).

/// Families that are tried exactly at each step of the search, and sets that are kept.
pub const TRIED: usize = 30;
/// Sets that grow side by side.
pub const KEPT: usize = 3;
/// A family so much below the best is not refined, nats.
pub const HOPELESS: f64 = 8.0;
/// A family of such odds is not looked at exactly, nats.
pub const WORTHLESS: f64 = -5.0;
/// A member without which the rows are so much less likely is not exchanged together with another, nats.
pub const STRONG: f64 = 40.0;
/// Most shapes of one response.
/// What takes more is not understood, and more of them say no more.
pub const MOST_SHAPES: usize = 2;
/// Most members of a set.
pub const MOST_MEMBERS: usize = 14;
/// So many directions of what the air does are followed.
pub const AIR_DIRECTIONS: usize = 8;
/// So many of the usual periods are tried exactly, beside the largest of all.
pub const USUAL_TRIED: usize = 3;
/// So many frequencies of a wave are tried exactly.
pub const PEAKS: usize = 12;
/// So many temperature differences of a law are tried exactly.
pub const DIFFERENCES: usize = 4;
/// Waves whose columns are kept.
pub const WAVES_KEPT: usize = 400;
/// Rounds of search and noise.
pub const ROUNDS: usize = 6;
/// The noise has settled when its size changes by less than this share, and its memory by less than this.
pub const SETTLED: (f64, f64) = (0.1, 0.08);
/// Steps of the noise of one set.
pub const NOISE_STEPS: usize = 3;
/// Hypotheses that are tried under their own noise.
pub const UNDER_NOISE: usize = 4;
/// Rows on either side of a step at which it may have been as well.
pub const MOMENT_ROWS: usize = 30;
/// Times that rounding is taken out as the fit predicts it.
pub const ROUNDING_STEPS: usize = 3;
/// Harmonics of a gauge's saw.
pub const ROUNDING_HARMONICS: i32 = 12;
/// Steps of the last fit.
pub const LAST_STEPS: usize = 4;
/// Autocorrelation of what the noise model left whitened, beyond which rows are too close together.
pub const REMEMBERS: f64 = 0.15;
/// A wave is out of step by more than this, in turns over the travel.
pub const OUT_OF_STEP: f64 = 0.01;
/// Rows differ by little as one: share of the whole range.
pub const ONE_PLACE: f64 = 1.0 / 300.0;
/// Time constants that are tried.
pub const TIME_CONSTANTS: usize = 14;
/// A memory from which on it may be an effect.
pub const MUCH_MEMORY: f64 = 0.3;
/// Variances of a walk, in the noise's, that are tried; each as likely.
pub const WALK_SIZES: [f64; 7] = [0.02, 0.05, 0.15, 0.4, 1.0, 3.0, 10.0];
/// Memories of a walk, in rows, that are tried; each as likely.
pub const WALK_MEMORIES: [f64; 6] = [6.0, 12.0, 25.0, 50.0, 100.0, 200.0];
/// Shorter segments show no walk.
pub const WALK_FEWEST_ROWS: usize = 48;
/// Most columns of a walk.
pub const WALK_RANK: usize = 60;
/// Grid points of a spectrum to the shortest period.
pub const PER_PERIOD: f64 = 6.0;
/// The longest grid of a spectrum.
pub const LONGEST: usize = 1 << 18;
/// Frequency steps in shares of one turn over the whole range.
pub const FREQUENCY_STEP: f64 = 0.35;
/// What sine and cosine show of their power at least, to be told from a constant.
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
/// Places that a millimetre has: closer together they are one.
pub const PLACES_PER_MM: f64 = 20.0;
/// Angles closer than this are one.
pub const PLACE_RAD: f64 = std::f64::consts::TAU / 7200.0;
/// Fewer rows have no shape.
pub const SHAPE_FEWEST_ROWS: usize = 12;
/// Most sensors whose products are tried.
pub const MOST_SENSORS: usize = 6;
/// A run that pauses more often than this is a run in steps.
pub const MOST_PAUSES: usize = 12;
/// More places have no error each of their own.
pub const MOST_PLACES: usize = 150;
