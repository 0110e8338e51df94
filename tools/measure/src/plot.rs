//! Plots as SVG text: what a report shows, small and without fonts or scripts of its own. The legend stands beside the data.

mod polar;
mod vectors;

pub use polar::Polar;
pub use vectors::Vectors;

use plotters::prelude::*;
use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use serde::Serialize;

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Style {
    /// A line through the points.
    Line,
    /// One dot per point.
    Dots,
    /// A bar from zero to each point.
    Bars,
    /// A shaded band: the first half of the points is its lower edge, the second half its upper edge.
    Band,
}

/// What a series' colour means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Colour {
    /// Nothing: the next of the palette.
    #[default]
    Next,
    /// Approached upwards, or counter-clockwise.
    Up,
    /// Approached downwards, or clockwise.
    Down,
    /// A reference.
    Grey,
}

impl Colour {
    fn rgb(self, place: usize) -> RGBColor {
        match self {
            Self::Next => COLOURS[place % COLOURS.len()],
            Self::Up => COLOURS[0],
            Self::Down => COLOURS[1],
            Self::Grey => COLOURS[6],
        }
    }

    /// As an SVG attribute has it.
    fn hex(self, place: usize) -> String {
        let RGBColor(r, g, b) = self.rgb(place);
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// One series of points.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Series {
    /// Name in the legend; empty for none.
    pub label: String,
    /// (x, y), in the chart's units.
    pub points: Vec<(f64, f64)>,
    /// Line, dots, bars or band.
    pub style: Style,
    /// What its colour means.
    pub colour: Colour,
}

impl Series {
    /// A series of points.
    #[must_use]
    pub fn new(label: &str, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.to_owned(), points, style, colour: Colour::Next }
    }

    /// With a colour that means something.
    #[must_use]
    pub fn coloured(self, colour: Colour) -> Self {
        Self { colour, ..self }
    }

    /// A band between two edges over the same x.
    #[must_use]
    pub fn band(label: &str, x: &[f64], lower: &[f64], upper: &[f64]) -> Self {
        let edge = |y: &[f64]| x.iter().copied().zip(y.iter().copied()).collect::<Vec<_>>();
        Self::new(label, Style::Band, [edge(lower), edge(upper)].concat())
    }
}

/// A chart with its axes' labels (with units).
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Chart {
    /// What stands above the plot.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x: String,
    /// Label of the y axis, with its unit.
    pub y: String,
    /// Ticks of the x axis by name instead of number: tick i stands at x = i.
    pub x_names: Vec<String>,
    /// The series, drawn in order.
    pub series: Vec<Series>,
    /// Places on the x axis where something begins, each with its name.
    pub marks: Vec<(f64, String)>,
}

/// A plot as data: a page shows it as SVG, another program draws it by its own means.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Picture {
    /// Series over an axis.
    Chart(Chart),
    /// Deviations from a circle.
    Polar(Polar),
    /// Displacements on a plane.
    Vectors(Vectors),
}

impl Picture {
    /// As an SVG document; a chart of this size in pixels, the others of their own.
    ///
    /// # Errors
    /// A chart without a finite point.
    pub fn svg(&self, width: u32, height: u32) -> Result<String, PlotError> {
        match self {
            Self::Chart(chart) => chart.svg(width, height),
            Self::Polar(polar) => Ok(polar.svg()),
            Self::Vectors(vectors) => Ok(vectors.svg()),
        }
    }
}

impl From<Chart> for Picture {
    fn from(chart: Chart) -> Self {
        Self::Chart(chart)
    }
}

impl From<Polar> for Picture {
    fn from(polar: Polar) -> Self {
        Self::Polar(polar)
    }
}

impl From<Vectors> for Picture {
    fn from(vectors: Vectors) -> Self {
        Self::Vectors(vectors)
    }
}

/// Colours that colour-blind readers tell apart (Okabe and Ito).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(80, 80, 80),
];

type Area<'t> = DrawingArea<SVGBackend<'t>, plotters::coord::Shift>;

/// A drawing that failed; the back end writes into memory, so only a chart without any finite point does.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the chart `{title}` could not be drawn: {reason}")]
pub struct PlotError {
    title: String,
    reason: String,
}

impl Chart {
    /// A chart without series.
    #[must_use]
    pub fn new(title: &str, x: &str, y: &str) -> Self {
        Self { title: title.to_owned(), x: x.to_owned(), y: y.to_owned(), ..Self::default() }
    }

    /// Adds a series.
    #[must_use]
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// The chart as an SVG document of this size in pixels.
    ///
    /// # Errors
    /// No finite point in any series.
    pub fn svg(&self, width: u32, height: u32) -> Result<String, PlotError> {
        let mut text = String::new();
        self.draw(&mut text, width, height)
            .map_err(|reason| PlotError { title: self.title.clone(), reason: reason.to_string() })?;
        Ok(text)
    }

    fn bounds(&self) -> Option<([f64; 2], [f64; 2])> {
        let mut x = [f64::INFINITY, f64::NEG_INFINITY];
        let mut y = x;
        for s in &self.series {
            for &(px, py) in s.points.iter().filter(|p| p.0.is_finite() && p.1.is_finite()) {
                x = [x[0].min(px), x[1].max(px)];
                y = [y[0].min(py), y[1].max(py)];
            }
            if s.style == Style::Bars {
                y = [y[0].min(0.0), y[1].max(0.0)];
            }
        }
        if !self.x_names.is_empty() {
            x = [-0.7, self.x_names.len() as f64 - 0.3];
        }
        let pad = |[lo, hi]: [f64; 2], by: f64| {
            let span = if hi > lo { hi - lo } else { hi.abs().max(1.0) };
            [lo - by * span, hi + by * span]
        };
        // Names of marks stand above the data.
        let room = 0.05 * self.marks.len().min(4) as f64 * (y[1] - y[0]);
        y[1] += if room.is_finite() { room } else { 0.0 };
        x[0].is_finite().then(|| (pad(x, if self.x_names.is_empty() { 0.02 } else { 0.0 }), pad(y, 0.06)))
    }

    /// The area of the plot, and beside it that of the legend, as wide as its longest name.
    fn split<'t>(&self, area: &Area<'t>, width: u32) -> (Area<'t>, Option<Area<'t>>) {
        let longest = self.series.iter().map(|s| s.label.chars().count()).max().unwrap_or(0) as u32;
        if longest == 0 {
            return (area.clone(), None);
        }
        let (plot, legend) = area.split_horizontally(width - (36 + 9 * longest).min(width / 3));
        (plot, Some(legend))
    }

    fn draw(&self, text: &mut String, width: u32, height: u32) -> Result<(), Box<dyn std::error::Error>> {
        let ([x0, x1], [y0, y1]) = self.bounds().ok_or("no finite point")?;
        let area = SVGBackend::with_string(text, (width, height)).into_drawing_area();
        area.fill(&WHITE)?;
        let (plot, legend) = self.split(&area, width);
        let mut chart = ChartBuilder::on(&plot)
            .caption(&self.title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(42)
            .y_label_area_size(64)
            .build_cartesian_2d(x0..x1, y0..y1)?;
        let names = &self.x_names;
        let name_of = |v: &f64| {
            let i = v.round();
            let near = (v - i).abs() < 1e-6 && i >= 0.0;
            names.get(i as usize).filter(|_| near).cloned().unwrap_or_default()
        };
        let number_of = |v: &f64| plain(*v, x1 - x0);
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(&self.x)
            .y_desc(&self.y)
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12));
        if names.is_empty() {
            mesh.x_label_formatter(&number_of).draw()?;
        } else {
            mesh.x_labels(names.len() * 2 + 1).x_label_formatter(&name_of).draw()?;
        }
        let width_of_bar = if names.is_empty() { (x1 - x0) / 400.0 } else { 0.35 };
        for (i, s) in self.series.iter().enumerate() {
            let colour = s.colour.rgb(i);
            let points = s.points.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite());
            match s.style {
                Style::Line => {
                    chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
                }
                Style::Dots => {
                    chart.draw_series(points.map(|p| Circle::new(p, 2, colour.filled())))?;
                }
                Style::Bars => {
                    chart.draw_series(points.map(|(x, y)| {
                        Rectangle::new(
                            [(x - width_of_bar, 0.0), (x + width_of_bar, y)],
                            colour.mix(0.8).filled(),
                        )
                    }))?;
                }
                Style::Band => {
                    let (lower, upper) = s.points.split_at(s.points.len() / 2);
                    let around: Vec<_> = lower.iter().chain(upper.iter().rev()).copied().collect();
                    chart.draw_series(std::iter::once(Polygon::new(around, colour.mix(0.2).filled())))?;
                }
            }
        }
        let small = ("sans-serif", 14).into_font().color(&BLACK.mix(0.6));
        for (i, (x, name)) in self.marks.iter().enumerate() {
            chart.draw_series(LineSeries::new([(*x, y0), (*x, y1)], BLACK.mix(0.3)))?;
            // One below the other, so that short phases do not write over each other.
            let y = y1 - (y1 - y0) * (0.01 + 0.045 * (i % 4) as f64);
            // Far on the right a name stands left of its line, so that it does not run into the legend.
            let right = *x > x0 + 0.6 * (x1 - x0);
            let anchor = Pos::new(if right { HPos::Right } else { HPos::Left }, VPos::Top);
            let text = if right { format!("{name} ") } else { format!(" {name}") };
            chart.draw_series([Text::new(text, (*x, y), small.clone().pos(anchor))])?;
        }
        if let Some(legend) = legend {
            let named = self.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty());
            for (line, (i, s)) in (0..).zip(named) {
                let (colour, y) = (s.colour.rgb(i), 52 + 20 * line);
                let swatch = if s.style == Style::Band { colour.mix(0.25) } else { colour.mix(1.0) };
                legend.draw(&Rectangle::new([(2, y - 4), (18, y + 4)], swatch.filled()))?;
                let style =
                    ("sans-serif", 15).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
                legend.draw(&Text::new(s.label.clone(), (24, y), style))?;
            }
        }
        area.present()?;
        Ok(())
    }
}

/// A tick's number with as many decimals as the axis' span asks for.
fn plain(v: f64, span: f64) -> String {
    let decimals = (1.0 - span.log10()).ceil().clamp(0.0, 6.0) as usize;
    format!("{v:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
