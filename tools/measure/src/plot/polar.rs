//! Polar plot of small deviations around a circle, enlarged, with a scale.

use super::{Series, series_style};
use rtec_files::message_text::escaped;
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Deviations from a circle.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct PolarPlot {
    /// Title above the plot.
    pub title: String,
    /// The two axes of its plane; the angle runs from the first towards the second.
    pub axes: [String; 2],
    /// The circle's radius, mm, if known.
    pub radius_mm: Option<f64>,
    /// Series of angle (rad) and deviation (µm).
    pub series: Vec<Series>,
}

/// Radius of zero deviation, px.
const BASE_PX: f64 = 150.0;
/// Largest distance of a deviation from that radius, px.
const MOST_PX: f64 = 80.0;
const CENTRE_PX: (f64, f64) = (280.0, 300.0);
const SIZE_PX: (u32, u32) = (800, 590);

/// The next value of 1, 2 or 5 times a power of ten that is not below.
pub(super) fn round_up(v: f64) -> f64 {
    let power = 10_f64.powf(v.max(1e-9).log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|n| *n >= v * (1.0 - 1e-9)).unwrap_or(power)
}

/// Head of an SVG document: definitions, white ground, and a title about `x`.
pub(super) fn head(definitions: &str, x: f64, title: &str) -> String {
    let ((w, h), title) = (SIZE_PX, escaped(title));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" \
         font-family=\"sans-serif\" font-size=\"13\">{definitions}<rect width=\"{w}\" height=\"{h}\" fill=\"white\"/>\
         <text x=\"{x}\" y=\"26\" font-size=\"18\" text-anchor=\"middle\">{title}</text>"
    )
}

/// The dash of a series, as an SVG attribute.
fn dash(series: &Series, place: usize) -> String {
    series_style::dash(series.colour.place(place))
        .map_or_else(String::new, |(on, off)| format!(" stroke-dasharray=\"{on} {off}\""))
}

impl PolarPlot {
    /// The plot as an SVG document.
    pub fn svg(&self) -> String {
        let deviations = self.series.iter().flat_map(|s| &s.points).map(|p| p.1.abs());
        let largest = deviations.filter(|d| d.is_finite()).fold(0.0, f64::max).max(1e-3);
        let division_um = round_up(largest / 4.0);
        let rings = (largest / division_um).ceil().clamp(1.0, 4.0) as i32;
        let px_per_um = MOST_PX / (division_um * f64::from(rings));
        let (cx, cy) = CENTRE_PX;
        let at = |angle: f64, um: f64| {
            let r = BASE_PX + um * px_per_um;
            (cx + r * angle.cos(), cy - r * angle.sin())
        };
        let mut out = head("", cx, &self.title);
        for ring in -rings..=rings {
            let r = BASE_PX + f64::from(ring) * division_um * px_per_um;
            let (width, colour) = if ring == 0 { (1.5, "#505050") } else { (1.0, "#dddddd") };
            let _ = write!(
                out,
                "<circle cx=\"{cx}\" cy=\"{cy}\" r=\"{r:.2}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>"
            );
        }
        let reach = BASE_PX + MOST_PX + 14.0;
        let (left, right, top, bottom) = (cx - reach, cx + reach, cy - reach, cy + reach);
        let _ = write!(out, "<path d=\"M{left} {cy}H{right}M{cx} {top}V{bottom}\" stroke=\"#bbbbbb\"/>");
        for (n, (dx, dy)) in [(0, (1.0, 0.0)), (1, (0.0, -1.0))] {
            for (sign, s) in [("+", 1.0), ("−", -1.0)] {
                let (x, y) = (cx + s * dx * (reach + 14.0), cy + s * dy * (reach + 12.0) + 4.0);
                let name = escaped(&self.axes[n].to_uppercase());
                let _ = write!(out, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"middle\">{sign}{name}</text>");
            }
        }
        for (place, series) in self.series.iter().enumerate() {
            let mut line = String::new();
            let mut last: Option<f64> = None;
            for (angle, um) in series.points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                let (x, y) = at(*angle, *um);
                // A jump of more than a sixth of a turn is a gap.
                let near = |l: f64| {
                    let d = (angle - l).rem_euclid(TAU);
                    d.min(TAU - d) < TAU / 6.0
                };
                let _ = write!(line, "{}{x:.2} {y:.2}", if last.is_some_and(near) { 'L' } else { 'M' });
                last = Some(*angle);
            }
            let (colour, dash) = (series.colour.hex(place), dash(series, place));
            let stroke = format!("stroke=\"{colour}\" stroke-width=\"1.4\"{dash}");
            let _ = write!(out, "<path d=\"{line}\" fill=\"none\" {stroke}/>");
        }
        // Labels of the rings, at 45°.
        for ring in [-rings, 0, rings] {
            let um = f64::from(ring) * division_um;
            let name = if ring == 0 { "0".to_owned() } else { format!("{um:+}") };
            let (x, y) = at(TAU / 8.0, um);
            let _ = write!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"11\" fill=\"#505050\" stroke=\"white\" stroke-width=\"3\" \
                 paint-order=\"stroke\">{name} µm</text>"
            );
        }
        self.legend(&mut out, division_um, px_per_um);
        out.push_str("</svg>");
        out
    }

    fn legend(&self, out: &mut String, division_um: f64, px_per_um: f64) {
        let mut y = 70.0;
        let mut line = |out: &mut String, swatch: Option<(String, f64, String)>, text: &str| {
            if let Some((colour, width, dash)) = swatch {
                let stroke = format!("stroke=\"{colour}\" stroke-width=\"{width}\"{dash}");
                let _ = write!(out, "<path d=\"M550 {y}h25\" {stroke}/>");
            }
            let _ = write!(out, "<text x=\"580\" y=\"{}\">{}</text>", y + 4.0, escaped(text));
            y += 21.0;
        };
        for (place, s) in self.series.iter().enumerate() {
            line(out, Some((s.colour.hex(place), 2.0, dash(s, place))), &s.label);
        }
        line(out, Some(("#505050".to_owned(), 1.5, String::new())), "least-squares circle");
        let division = format!("one division is {division_um} µm");
        line(out, Some(("#dddddd".to_owned(), 1.5, String::new())), &division);
        if let Some(radius_mm) = self.radius_mm {
            // Enlargement relative to the base circle, which has the nominal radius.
            let times = px_per_um * 1000.0 * radius_mm / BASE_PX;
            line(out, None, &format!("radius {} mm,", crate::report::short(radius_mm)));
            line(out, None, "deviations enlarged");
            line(out, None, &format!("{times:.0} times"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn divisions_are_round_numbers() {
        for (v, want) in [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (2.3, 5.0), (7.0, 10.0), (0.013, 0.02)] {
            assert!((round_up(v) - want).abs() < 1e-12, "{v}");
        }
    }
}
