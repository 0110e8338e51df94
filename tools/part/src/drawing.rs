//! x

/// An empty drawing in mm whose file depends on nothing but its content.
#[must_use]
pub fn new_dxf() -> dxf::Drawing {
    let mut drawing = dxf::Drawing::new();
    drawing.header.version = dxf::enums::AcadVersion::R2000;
    drawing.header.default_drawing_units = dxf::enums::Units::Millimeters;
    let header = &mut drawing.header;
    (header.creation_date, header.update_date) = Default::default();
    (header.creation_date_universal, header.update_date_universal) = Default::default();
    (header.fingerprint_guid, header.version_guid) = Default::default();
    drawing
}
