//! Units of drawings and paths.

/// The length of a file's unit, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit(pub f64);

impl Unit {
    /// Lengths in mm.
    pub const MM: Self = Self(1.0);
    /// Lengths in inches of 25.4 mm.
    pub const INCH: Self = Self(25.4);
}
