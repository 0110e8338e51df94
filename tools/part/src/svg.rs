//! Drawings of the turning plane as self-contained SVG: Z to the right, X up, in mm.

use crate::fit::Zx;
use std::fmt::Write as _;

/// A drawing that grows its own frame.
#[derive(Debug, Default)]
pub struct Svg {
    body: String,
    low: Option<Zx>,
    high: Option<Zx>,
}

/// Text with the characters that mean something to XML replaced.
#[must_use]
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

impl Svg {
    fn reach(&mut self, p: Zx) {
        let (low, high) = (self.low.unwrap_or(p), self.high.unwrap_or(p));
        self.low = Some(Zx::new(low.z.min(p.z), low.x.min(p.x)));
        self.high = Some(Zx::new(high.z.max(p.z), high.x.max(p.x)));
    }

    /// A line through points; `class` is one of the style's.
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
        let _ = writeln!(
            self.body,
            "<circle class=\"{class}\" cx=\"{:.4}\" cy=\"{:.4}\" r=\"{radius_mm:.4}\"/>",
            at.z, -at.x
        );
    }

    /// Words with their start at a place.
    pub fn text(&mut self, at: Zx, size_mm: f64, words: &str) {
        self.reach(at);
        let _ = writeln!(
            self.body,
            "<text x=\"{:.4}\" y=\"{:.4}\" font-size=\"{size_mm:.3}\">{}</text>",
            at.z,
            -at.x,
            escaped(words)
        );
    }

    /// Lower and upper corner of what was drawn.
    #[must_use]
    pub fn frame(&self) -> (Zx, Zx) {
        let origin = Zx::new(0.0, 0.0);
        (self.low.unwrap_or(origin), self.high.unwrap_or(origin))
    }

    /// The whole SVG document, under a title.
    #[must_use]
    pub fn finish(&self, title: &str) -> String {
        let (low, high) = self.frame();
        let margin = (0.08 * (high - low).norm()).max(1.0);
        let (width, height) = (high.z - low.z + 2.0 * margin, high.x - low.x + 2.0 * margin);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{:.4} {:.4} {width:.4} {height:.4}\" width=\"900\">\n\
             <title>{}</title>\n<style>polyline{{fill:none;stroke-width:1;vector-effect:non-scaling-stroke}}\
             .outline{{stroke:#222;stroke-width:1.6}}.axis{{stroke:#999;stroke-dasharray:8 3 2 3}}\
             .whisker{{stroke:#c00;stroke-width:1.6}}.kept{{fill:#06c}}.dropped{{fill:#c00}}.move{{stroke:#06c}}\
             .bypass{{stroke:#393;stroke-dasharray:4 3}}.hit{{stroke:#f00;stroke-width:3}}\
             text{{font-family:sans-serif}}</style>\n{}</svg>\n",
            low.z - margin,
            -(high.x + margin),
            escaped(title),
            self.body
        )
    }
}
