//! Drawings of the turning plane as self-contained SVG.
//! Z is to the right, X up, in mm.

use crate::edge_tree::around;
use crate::geometric_fit::Zx;
use rtec_files::message_text::escaped;
use std::fmt::Write as _;

/// A drawing whose frame grows with its content.
#[derive(Debug, Default)]
pub struct SvgDrawing {
    body: String,
    /// Lower and upper corner.
    frame: Option<[Zx; 2]>,
}

impl SvgDrawing {
    fn reach(&mut self, p: Zx) {
        self.frame = Some(around(self.frame.unwrap_or([p; 2]), [p; 2]));
    }

    /// A line through points; `class` is a class of the style.
    pub fn polyline(&mut self, points: &[Zx], class: &str) {
        let _ = write!(self.body, "<polyline class=\"{class}\" points=\"");
        for &p in points {
            self.reach(p);
            let _ = write!(self.body, "{:.4},{:.4} ", p.z, -p.x);
        }
        self.body.push_str("\"/>\n");
    }

    /// A filled dot.
    pub fn dot(&mut self, at: Zx, radius_mm: f64, class: &str) {
        self.reach(at);
        self.body += &circle(class, at.z, -at.x, radius_mm);
    }

    /// Text that starts at a place.
    pub fn text(&mut self, at: Zx, size_mm: f64, words: &str) {
        self.reach(at);
        self.body += &text(at.z, -at.x, size_mm, "", words);
    }

    /// Lower and upper corner of the drawn content.
    pub fn frame(&self) -> [Zx; 2] {
        self.frame.unwrap_or([Zx::new(0.0, 0.0); 2])
    }

    /// The whole SVG document, with a title and a legend.
    /// The legend gives the meaning of lines and dots by their style.
    pub fn finish(&self, title: &str, legend: &[(&str, &str)]) -> String {
        let [low, high] = self.frame();
        let size = (0.025 * (high - low).norm()).max(0.3);
        let margin = 4.0 * size;
        let (left, top) = (low.z - margin, -(high.x + margin + 1.5 * size));
        let below = 1.5 * size * legend.len() as f64;
        let (width, height) =
            (high.z - low.z + 2.0 * margin, high.x - low.x + 2.0 * margin + 1.5 * size + below);
        let mut words = text(low.z, top + 1.6 * size, size, " font-weight=\"bold\"", title);
        for (row, (class, meaning)) in (0..).map(f64::from).zip(legend) {
            let y = -low.x + margin + 1.5 * size * row;
            words += &if matches!(*class, "kept" | "dropped") {
                circle(class, low.z + size, y, 0.3 * size)
            } else {
                line(class, [low.z, y], [low.z + 2.0 * size, y])
            };
            words += &text(low.z + 2.6 * size, y + 0.3 * size, 0.9 * size, "", meaning);
        }
        // The colours of Okabe and Ito, as in all plots. Dropped points are hollow, for a print in grey. The
        // background is white, for a dark page.
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{left:.4} {top:.4} {width:.4} {height:.4}\" width=\"900\">\n\
             <title>{}</title>\n<style>polyline,circle{{stroke-width:1;vector-effect:non-scaling-stroke}}polyline{{fill:none}}\
             .outline{{stroke:#000;stroke-width:1.6}}.axis{{stroke:#505050;stroke-dasharray:8 3 2 3}}.tick{{stroke:#505050}}\
             .whisker{{stroke:#d55e00;stroke-width:1.6}}.kept{{fill:#0072b2}}\
             .dropped{{fill:#fff;stroke:#d55e00;stroke-width:1.6}}.move{{stroke:#0072b2}}\
             .bypass{{stroke:#009e73;stroke-dasharray:4 3}}.hit{{stroke:#d55e00;stroke-width:3}}\
             text{{font-family:sans-serif;fill:#000}}</style>\n\
             <rect x=\"{left:.4}\" y=\"{top:.4}\" width=\"{width:.4}\" height=\"{height:.4}\" fill=\"#fff\"/>\n{}{}{words}</svg>\n",
            escaped(title),
            ticks(low, high, size),
            self.body
        )
    }
}

fn circle(class: &str, x: f64, y: f64, radius: f64) -> String {
    format!("<circle class=\"{class}\" cx=\"{x:.4}\" cy=\"{y:.4}\" r=\"{radius:.4}\"/>\n")
}

fn line(class: &str, [x, y]: [f64; 2], [x2, y2]: [f64; 2]) -> String {
    format!("<polyline class=\"{class}\" points=\"{x:.4},{y:.4} {x2:.4},{y2:.4}\"/>\n")
}

/// Text that starts at a place; `more` are further attributes.
fn text(x: f64, y: f64, size: f64, more: &str, words: &str) -> String {
    let words = escaped(words);
    format!("<text x=\"{x:.4}\" y=\"{y:.4}\" font-size=\"{size:.3}\"{more}>{words}</text>\n")
}

/// The scales: Z below, X on the left, in mm.
fn ticks(low: Zx, high: Zx, size: f64) -> String {
    let (bottom, left) = (-low.x + size, low.z - size);
    let mut out = String::new();
    let mut tick = |x: f64, y: f64, dx: f64, dy: f64| out += &line("tick", [x, y], [x + dx, y + dy]);
    tick(low.z, bottom, high.z - low.z, 0.0);
    tick(left, -low.x, 0.0, low.x - high.x);
    let across: Vec<f64> = steps(low.z, high.z).collect();
    let up: Vec<f64> = steps(low.x, high.x).collect();
    for z in &across {
        tick(*z, bottom, 0.0, 0.4 * size);
    }
    for x in &up {
        tick(left, -x, -0.4 * size, 0.0);
    }
    let mut word = |x: f64, y: f64, anchor: &str, words: &str| {
        out += &text(x, y, 0.9 * size, &format!(" text-anchor=\"{anchor}\""), words);
    };
    for z in &across {
        word(*z, bottom + 1.4 * size, "middle", &z.to_string());
    }
    for x in &up {
        word(left - 0.6 * size, 0.3 * size - x, "end", &x.to_string());
    }
    word(f64::midpoint(low.z, high.z), bottom + 2.6 * size, "middle", "Z, mm");
    word(left, -high.x - 1.2 * size, "middle", "X, mm");
    out
}

/// About five round values within a span.
fn steps(low: f64, high: f64) -> impl Iterator<Item = f64> {
    let rough = ((high - low) / 5.0).max(1e-3);
    let ten = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|n| n * ten).into_iter().find(|s| *s >= rough).unwrap_or(rough);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    // Rounded, so that 3 · 0.1 is written 0.3.
    (first..=last).map(move |n| (n as f64 * step * 1e6).round() / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The palette of all plots, on white, with the scales' unit.
    #[test]
    fn a_drawing_has_the_style_of_all_plots() {
        let mut svg = SvgDrawing::default();
        svg.polyline(&[Zx::new(-40.0, 0.0), Zx::new(38.1, 38.1)], "outline");
        let text = svg.finish("a <b>", &[("outline", "the part"), ("kept", "a point")]);
        let style = text.split("<style>").nth(1).unwrap().split("</style>").next().unwrap();
        let colours = style.split('#').skip(1).map(|c| c.split([';', '}']).next().unwrap());
        for colour in colours {
            assert!(["000", "fff", "505050", "0072b2", "d55e00", "009e73"].contains(&colour), "{colour}");
        }
        assert!(
            text.contains(">Z, mm<") && text.contains(">X, mm<") && text.contains("fill=\"#fff\"/>"),
            "{text}"
        );
        assert!(
            text.contains("<title>a &lt;b&gt;</title>") && text.contains(">a &lt;b&gt;</text>"),
            "{text}"
        );
        assert!(text.contains(">the part</text>") && text.contains(">a point</text>"), "{text}");
        assert_eq!(steps(-40.0, 38.1).collect::<Vec<_>>(), [-40.0, -20.0, 0.0, 20.0]);
        assert_eq!(steps(0.0, 0.45).collect::<Vec<_>>(), [0.0, 0.1, 0.2, 0.3, 0.4]);
        // An empty drawing is valid too.
        assert!(SvgDrawing::default().finish("", &[]).ends_with("</svg>\n"));
    }
}
