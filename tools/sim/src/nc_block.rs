//! Blocks of an NC program, as the simulated controller runs them.

use crate::trajectory::AXES;

/// One block, all positions absolute, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Block {
    /// G00: rapid positioning.
    Rapid {
        /// End point, mm.
        to: [f64; AXES],
    },
    /// G01: a straight line at a feed.
    Feed {
        /// End point, mm.
        to: [f64; AXES],
        /// Feed along the path, mm/s.
        feed_mm_s: f64,
    },
    /// G02, G03: an arc at a feed.
    Arc {
        /// End point, mm.
        to: [f64; AXES],
        /// The plane's first and second axis.
        plane: (usize, usize),
        /// Centre in the plane, mm.
        centre: (f64, f64),
        /// Clockwise (G02), else counter-clockwise (G03).
        clockwise: bool,
        /// Feed along the path, mm/s.
        feed_mm_s: f64,
    },
    /// G04: a dwell.
    Dwell {
        /// Duration, s.
        seconds: f64,
    },
    /// M03 S…, M05: spindle on at a speed, or off.
    Spindle {
        /// Speed, rpm; 0 stops it.
        rpm: f64,
    },
    /// M08, M09: coolant on or off.
    Coolant {
        /// The coolant flows (M08).
        on: bool,
    },
}
