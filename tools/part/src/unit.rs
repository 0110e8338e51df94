//! Units of drawings and paths.

/// What one unit of a file is, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit(pub f64);

impl Unit {
    /// Millimetres.
    pub const MM: Self = Self(1.0);
    /// Inches.
    pub const INCH: Self = Self(25.4);
}
