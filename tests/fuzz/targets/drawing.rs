//! DXF drawings, and the probing path along their contours.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_part::contour_from_dxf::{self, DxfOptions};

fuzz_target!(|data: &[u8]| {
    let file = rtec_fuzz::put("a.dxf", data);
    let Some((contour, unit)) = rtec_fuzz::checked(contour_from_dxf::read(&file, &DxfOptions::default()))
    else {
        return;
    };
    assert!(unit.0 > 0.0 && unit.0.is_finite());
    assert!(
        contour.chords().iter().flat_map(|(_, chords)| chords).all(|p| p.z.is_finite() && p.x.is_finite())
    );
    let reach = contour.reach();
    assert!(reach.z.is_finite() && reach.x.is_finite());
});
