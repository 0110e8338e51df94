//! The built-in effects, one file each.
//!
//! A new one needs its file and a line in this list.

use super::Law;
use std::sync::{Arc, LazyLock};

/// Declares the module of each law and lists the laws.
macro_rules! dictionary {
    ($($law:ident,)*) => {
        $(pub mod $law;)*

        /// The built-in laws, in the order in which a search lists them.
        pub(super) static BUILT_IN: LazyLock<Vec<Arc<dyn Law>>> = LazyLock::new(|| vec![$($law::law()),*]);
    };
}

dictionary! {
    offset,
    scale,
    reversal,
    reversal_slope,
    squareness,
    rotation,
    angular,
    coolant,
    spindle_speed,
    following_error,
    acceleration_error,
    stiffness,
    probe_latency,
    channel,
    inertia,
    friction_viscous,
    friction_coulomb,
    friction_asymmetric,
    force_offset,
    position_map,
    straightness,
    screw_periodic,
    screw_slope,
    subdivision,
    probe_lobing,
    thermal_expansion,
    thermal_growth,
    thermal_lag,
    reversal_spike,
    warm_up,
    lost_counts,
    form_bump,
}
