//! Plots as SVG documents.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::plot::{Chart, Colour, PolarPlot, Series, Style, VectorPlot};

#[test]
fn a_chart_is_an_svg_with_its_words() {
    let chart = Chart::new("Growth <z>", "t (min)", "e (µm)")
        .with(Series::band("95 %", &[0.0, 1.0], &[-1.0, -1.0], &[1.0, 2.0]))
        .with(Series::new("measured", Style::Dots, vec![(0.0, 0.0), (1.0, f64::NAN), (1.0, 1.0)]))
        .with(Series::new("model", Style::Line, vec![(0.0, 0.1), (1.0, 0.9)]));
    let svg = chart.svg(640, 400).unwrap();
    for word in ["<svg", "measured", "t (min)", "e (µm)", "Growth &lt;z&gt;"] {
        assert!(svg.contains(word), "{word}");
    }
    assert!(!svg.contains("NaN"));
    assert!(Chart::new("empty", "x", "y").svg(100, 100).is_err());
}

#[test]
fn a_circle_is_round_and_says_its_scale() {
    let points: Vec<(f64, f64)> =
        (0..360).map(|d| f64::from(d).to_radians()).map(|a| (a, 4.0 * (2.0 * a).cos())).collect();
    let plot = PolarPlot {
        title: "Plane <x-y>".into(),
        axes: ["x".into(), "y".into()],
        radius_mm: Some(150.0),
        series: vec![Series::new("ccw", Style::Line, points).coloured(Colour::Up)],
    };
    let svg = plot.svg();
    // 80 px for 4 µm, 150 px for 150 mm.
    for word in ["Plane &lt;x-y&gt;", "one division is 1 µm", "20000 times", "+X", "−Y", "#0072b2"] {
        assert!(svg.contains(word), "{word}: {svg}");
    }
    // At 0° 4 µm outwards, at 90° 4 µm inwards.
    assert!(svg.contains("M510.00 300.00"), "{svg}");
    assert!(svg.contains("L280.00 230.00"), "{svg}");
}

#[test]
fn arrows_say_how_long_they_are() {
    let plot = VectorPlot {
        title: "Plate".into(),
        axes: ["x".into(), "y".into()],
        at: vec![([0.0, 0.0], [10.0, 0.0]), ([100.0, 50.0], [0.0, -5.0])],
    };
    let svg = plot.svg();
    for word in ["Plate", "x (mm)", "y (mm)", "this arrow is 5 µm", "longest: 10.0 µm"] {
        assert!(svg.contains(word), "{word}: {svg}");
    }
    // One scale for both axes: 460 px are 126 mm, so 36.51 px for 10 µm are 1000 times enlarged.
    assert!(svg.contains("1000 times") && svg.contains("l36.51 -0.00"), "{svg}");
}
