//! Files as people have them: each stands for a kind that was read wrongly once.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_part::batch::{self, Judgement};
use rtec_part::errors::{Nominal, Probed};
use std::path::PathBuf;

fn field(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/field").join(name)
}

#[test]
fn a_spreadsheet_is_one_batch_however_it_is_saved() {
    let judgement = Judgement { alpha: 0.01, least_um: 1.0 };
    for (name, written) in [
        ("batch-point.csv", None),
        ("batch-comma.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-sep-line.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-thousands.csv", Some("columns parted by semicolons, decimal commas")),
        ("batch-utf16.csv", Some("UTF-16, columns parted by semicolons, decimal commas")),
    ] {
        let batch = batch::evaluate(&field(name), None, judgement).unwrap();
        assert!((batch.places[0].mean_um - 11.55).abs() < 0.005, "{name}: {}", batch.places[0].mean_um);
        assert_eq!(
            batch.written.as_deref().map(|w| w.contains(written.unwrap_or("-"))),
            written.map(|_| true)
        );
    }
}

#[test]
fn a_size_below_its_standard_error_is_not_told() {
    let probed = Probed::read(&field("six-points.csv")).unwrap();
    let report = probed.errors(Nominal::Circle { radius_mm: 27.3504 }, 0.0).unwrap();
    assert!(!report.is_size_known());
    assert!(report.size_standard_error_um.unwrap() > 57.0, "{:?}", report.size_standard_error_um);
}

#[cfg(feature = "dxf")]
mod drawings {
    use super::field;
    use rtec_part::contour::{Contour, FeatureKind};
    use rtec_part::drawing::{self, Options};

    fn contour(name: &str) -> Contour {
        drawing::read(&field(name), &Options::default()).unwrap().0
    }

    #[test]
    fn nearly_straight_arcs_are_straight_and_said() {
        for name in ["speck-1e-7.dxf", "speck-1e-13.dxf"] {
            let contour = contour(name);
            let cylinders =
                contour.features.iter().filter(|f| matches!(f.kind, FeatureKind::Cylinder { .. })).count();
            assert_eq!((contour.features.len(), cylinders), (3, 1), "{name}");
            assert!(contour.cleaned[0].contains("took 1 arc as straight: within 0.00001 mm"), "{name}");
        }
    }

    #[test]
    fn a_vertex_given_twice_is_one() {
        let contour = contour("vertex-twice.dxf");
        assert_eq!(contour.features.len(), 3);
        assert!(contour.cleaned[0].contains("left out 1 vertex within 0.001 mm"), "{:?}", contour.cleaned);
    }

    #[test]
    fn a_fitted_curve_is_taken_without_its_frame() {
        let (with_frame, alone) = (contour("spline-fit.dxf"), contour("fitted-only.dxf"));
        let kinds = |c: &Contour| c.features.iter().map(|f| f.kind).collect::<Vec<_>>();
        assert_eq!(kinds(&with_frame), kinds(&alone));
        assert!(with_frame.cleaned[0].contains("the fitted curve was taken"), "{:?}", with_frame.cleaned);
        assert!(alone.cleaned.is_empty());
    }
}
