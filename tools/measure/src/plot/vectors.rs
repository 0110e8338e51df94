//! Small displacements on a plane, as enlarged arrows.
//! Both axes have one scale, the displacements another; both are stated.

use super::Colour;
use super::polar::{head, round_up};
use rtec_files::message_text::escaped;
use rtec_model::record::span;
use std::fmt::Write as _;

/// Displacements at positions on a plane.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct VectorPlot {
    /// Title above the plot.
    pub title: String,
    /// Names of both axes.
    pub axes: [String; 2],
    /// Positions, mm, with their displacement, µm.
    pub at: Vec<([f64; 2], [f64; 2])>,
}

const PLOT_PX: f64 = 460.0;
const LEFT_PX: f64 = 80.0;
const TOP_PX: f64 = 45.0;

impl VectorPlot {
    /// The plot as an SVG document.
    pub fn svg(&self) -> String {
        let bounds = |n: usize| span(self.at.iter().map(|(p, _)| p[n]).filter(|v| v.is_finite()));
        let (x, y) = (bounds(0), bounds(1));
        let span = (x[1] - x[0]).max(y[1] - y[0]).max(1e-6);
        // Room for the longest arrow.
        let margin = 0.13 * span;
        let per_mm = PLOT_PX / (span + 2.0 * margin);
        let middle = [f64::midpoint(x[0], x[1]), f64::midpoint(y[0], y[1])];
        let place = |p: [f64; 2]| {
            let half = PLOT_PX / 2.0;
            (LEFT_PX + half + (p[0] - middle[0]) * per_mm, TOP_PX + half - (p[1] - middle[1]) * per_mm)
        };
        // The longest arrow is at most a tenth of the plot; the factor is round for measuring.
        let longest = self.at.iter().map(|(_, e)| e[0].hypot(e[1])).fold(0.0, f64::max).max(1e-6);
        let times = round_up(0.1 * PLOT_PX / longest * 1000.0 / per_mm / 2.5);
        let px_per_um = times * per_mm / 1000.0;
        let (red, grey) = (Colour::Down.hex(0), Colour::Grey.hex(0));
        let tip = format!(
            "<defs><marker id=\"tip\" viewBox=\"0 0 6 6\" refX=\"5\" refY=\"3\" \
             markerWidth=\"5\" markerHeight=\"5\" orient=\"auto\"><path d=\"M0 0L6 3L0 6z\" fill=\"{red}\"/></marker></defs>"
        );
        let mut out = head(&tip, LEFT_PX + PLOT_PX / 2.0, &self.title);
        let _ = write!(
            out,
            "<rect x=\"{LEFT_PX}\" y=\"{TOP_PX}\" width=\"{PLOT_PX}\" height=\"{PLOT_PX}\" fill=\"none\" stroke=\"#999999\"/>"
        );
        self.grid(&mut out, span + 2.0 * margin, middle, &place);
        for (p, e) in &self.at {
            let (px, py) = place(*p);
            let (dx, dy) = (e[0] * px_per_um, -e[1] * px_per_um);
            let _ = write!(
                out,
                "<circle cx=\"{px:.2}\" cy=\"{py:.2}\" r=\"2.2\" fill=\"{grey}\"/><path d=\"M{px:.2} {py:.2}l{dx:.2} {dy:.2}\" \
                 stroke=\"{red}\" stroke-width=\"1.5\" marker-end=\"url(#tip)\"/>"
            );
        }
        let unit_um = round_up(longest / 2.0);
        let length = unit_um * px_per_um;
        let x0 = LEFT_PX + PLOT_PX + 30.0;
        let _ = write!(
            out,
            "<circle cx=\"{x0}\" cy=\"80\" r=\"2.2\" fill=\"{grey}\"/><text x=\"{}\" y=\"84\">hole</text>\
             <path d=\"M{x0} 108h{length:.2}\" stroke=\"{red}\" stroke-width=\"1.5\" marker-end=\"url(#tip)\"/>\
             <text x=\"{x0}\" y=\"130\">this arrow is {unit_um} µm</text>\
             <text x=\"{x0}\" y=\"150\">arrows {times:.0} times enlarged</text>\
             <text x=\"{x0}\" y=\"170\">longest: {longest:.1} µm</text></svg>",
            x0 + 10.0
        );
        out
    }

    fn grid(&self, out: &mut String, span: f64, middle: [f64; 2], place: &dyn Fn([f64; 2]) -> (f64, f64)) {
        let step = round_up(span / 7.0);
        let ticks = |n: usize| {
            let first = ((middle[n] - span / 2.0) / step).ceil() as i64;
            let last = ((middle[n] + span / 2.0) / step).floor() as i64;
            (first..=last).map(move |k| k as f64 * step)
        };
        let (bottom, right) = (TOP_PX + PLOT_PX, LEFT_PX + PLOT_PX);
        for v in ticks(0) {
            let (x, _) = place([v, middle[1]]);
            let _ = write!(
                out,
                "<path d=\"M{x:.2} {TOP_PX}V{bottom}\" stroke=\"#eeeeee\"/>\
                 <text x=\"{x:.2}\" y=\"{}\" text-anchor=\"middle\">{v}</text>",
                bottom + 18.0
            );
        }
        for v in ticks(1) {
            let (_, y) = place([middle[0], v]);
            let _ = write!(
                out,
                "<path d=\"M{LEFT_PX} {y:.2}H{right}\" stroke=\"#eeeeee\"/>\
                 <text x=\"{}\" y=\"{:.2}\" text-anchor=\"end\">{v}</text>",
                LEFT_PX - 6.0,
                y + 4.0
            );
        }
        let (x, y) = (LEFT_PX + PLOT_PX / 2.0, TOP_PX + PLOT_PX / 2.0);
        let ([a, b], below) = (self.axes.each_ref().map(|name| escaped(name)), bottom + 40.0);
        let _ = write!(
            out,
            "<text x=\"{x}\" y=\"{below}\" text-anchor=\"middle\">{a} (mm)</text>\
             <text x=\"22\" y=\"{y}\" text-anchor=\"middle\" transform=\"rotate(-90 22 {y})\">{b} (mm)</text>"
        );
    }
}
