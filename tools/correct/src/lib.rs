//! The control law: which total should each axis have now?
//!
//! requested = model + part table + operator, in micrometres until the last step. The daemon, the simulator, the
//! rehearsal of a shift, the part loop and the demo all use this law, and no other.
//!
//! | module | what |
//! |---|---|
//! | [`commission`] | a guided jog judged: sign, unit, what the controller compensates by itself |
//! | [`corrector`] | all axes: the sources' sum becomes totals |
//! | `source` | the machine model as a source: sensors in, errors out, or why nothing can be said |
//! | [`part_table`] | a part's errors as a source |
//! | `motion` | position, velocity and direction of the axes from the engine's status |
//! | `total` | ramp, hysteresis, limits, belief window |
//! | [`explain`] | what a correction is made of, for people |
//! | [`rehearse`] | a recorded shift run through the law with another model |
//!
//! What must not live here: sockets, devices, the reading of sensors (`rtec-sensors`), anything of a simulated machine.
//!
//! At work: `cargo run -p rtec-correct --example totals`, which the tests run too.

pub mod commission;
pub mod corrector;
pub mod explain;
mod motion;
pub mod part_table;
pub mod rehearse;
mod source;
mod total;

pub use corrector::Corrector;

/// Default rate, µm/s, for a change of total that no motion asks for.
pub const RAMP_UM_S: f64 = 5.0;

/// One axis, as the law needs to know it.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisSetup {
    /// The axis's name, as models name it.
    pub name: String,
    /// What one count is worth, µm.
    pub count_um: f64,
    /// Counts of one insertion of its design.
    pub increment_counts: i64,
    /// Largest change that the engine believes at once, counts.
    pub window_counts: i64,
    /// Largest total that is ever requested, counts.
    pub max_counts: i64,
}
