//! Units of drawings and paths.

/// The length of a file's unit, in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LengthUnit(pub f64);

impl LengthUnit {
    /// All of them: name, unit and meaning.
    pub const ALL: [(&'static str, Self, &'static str); 2] =
        [("mm", Self::MM, "Millimetres"), ("inch", Self::INCH, "Inches")];
    /// Lengths in mm.
    pub const MM: Self = Self(1.0);
    /// Lengths in inches of 25.4 mm.
    pub const INCH: Self = Self(25.4);
}
