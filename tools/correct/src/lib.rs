//! The control law: the total that each axis should have now.
//!
//! requested = model + part table + operator, in micrometres until the last step. The daemon, the simulator,
//! the rehearsal of a shift, the part loop and the demo all use this law only.
//!
//! These do not belong here: sockets, devices, the reading of sensors (`rtec-sensors`), anything of a
//! simulated machine.
//!
//! At work: `cargo run -p rtec-correct --example totals`, which the tests run too.

mod axis_motion; // position, velocity and direction of the axes from the engine's status
mod correction_total;
pub mod corrector; // all axes: the sources' sum becomes totals
pub mod explain; // components of a correction, for people
pub mod jog_check; // judges a guided jog: sign, unit, compensation by the controller itself
mod model_evaluator; // the machine model as a source: sensors in, errors out, or why they are not known
pub mod part_table; // a part's errors as a source
pub mod rehearse; // runs a recorded shift through the law with another model // ramp, hysteresis, limits, belief window

pub use corrector::Corrector;

/// Default rate for changes of a total that no motion causes, µm/s.
pub const RAMP_UM_S: f64 = 5.0;

/// Smallest belief window, µm: three corrections of 4 µm.
/// (NISTIR 4832, General Considerations)
const LEAST_BELIEVED_UM: f64 = 12.0;

/// The belief window of an axis: three of its largest steps, at least 12 µm.
/// It is given in counts.
/// `step_um` is the largest change of its model at once. A window never refuses a single insertion.
pub fn belief_window_counts(count_um: f64, step_um: f64) -> i64 {
    let counts = (3.0 * step_um).max(LEAST_BELIEVED_UM) / count_um;
    (counts.ceil() as i64).max(rtec_rt::axis::INCREMENT_COUNTS)
}

/// An axis's settings for the control law.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisCorrectionSettings {
    /// The axis's name, as models name it.
    pub name: String,
    /// Size of one count, µm.
    pub count_um: f64,
    /// Counts of one insertion of its design.
    pub increment_counts: i64,
    /// Largest change that the engine believes at once, counts.
    pub window_counts: i64,
    /// Largest total that is ever requested, counts.
    pub max_counts: i64,
}
