//! Plots as SVG text without fonts or scripts; the legend is beside the data.

mod point_thinning;
mod polar;
mod series_style;
mod vectors;

pub use polar::PolarPlot;
pub use vectors::VectorPlot;

use plotters::prelude::*;
use plotters::style::RGBColor;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use rtec_model::record::span;
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
    /// A shaded band.
    /// The first half of the points is its lower edge, the second half its upper edge.
    Band,
}

/// Meaning of a series' colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Colour {
    /// None: the next colour of the palette.
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

    /// The place whose dash and marker it uses.
    fn place(self, place: usize) -> usize {
        match self {
            Self::Next => place,
            Self::Up | Self::Grey => 0,
            Self::Down => 1,
        }
    }

    /// The colour as an SVG attribute.
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
    pub fn new(label: &str, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { label: label.to_owned(), points, style, colour: Colour::Next }
    }

    /// The series with a colour that has a meaning.
    #[must_use]
    pub fn coloured(self, colour: Colour) -> Self {
        Self { colour, ..self }
    }

    /// A band between two edges over the same x values.
    pub fn band(label: &str, x: &[f64], lower: &[f64], upper: &[f64]) -> Self {
        let edge = |y: &[f64]| x.iter().copied().zip(y.iter().copied()).collect::<Vec<_>>();
        Self::new(label, Style::Band, [edge(lower), edge(upper)].concat())
    }
}

/// A chart.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Chart {
    /// Title above the plot.
    pub title: String,
    /// Label of the x axis, with its unit.
    pub x: String,
    /// Label of the y axis, with its unit.
    pub y: String,
    /// Names of ticks on the x axis in place of numbers; tick i is at x = i.
    pub x_names: Vec<String>,
    /// The series, drawn in order.
    pub series: Vec<Series>,
    /// Positions on the x axis where something begins, with names.
    pub marks: Vec<(f64, String)>,
}

/// A plot as data, for SVG or for other programs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum PlotSpec {
    /// Series over an axis.
    Chart(Chart),
    /// Deviations from a circle.
    Polar(PolarPlot),
    /// Displacements on a plane.
    Vectors(VectorPlot),
}

impl PlotSpec {
    /// An SVG document; the size in pixels applies to charts only.
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

impl From<Chart> for PlotSpec {
    fn from(chart: Chart) -> Self {
        Self::Chart(chart)
    }
}

/// Colours that colour-blind readers can distinguish (Okabe and Ito).
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

/// A plot that failed: a chart without a finite point.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the chart `{title}` could not be drawn: {reason}")]
pub struct PlotError {
    title: String,
    reason: String,
}

impl Chart {
    /// A chart without series.
    pub fn new(title: &str, x: &str, y: &str) -> Self {
        Self { title: title.to_owned(), x: x.to_owned(), y: y.to_owned(), ..Self::default() }
    }

    /// Adds a series.
    #[must_use]
    pub fn with(mut self, series: Series) -> Self {
        self.series.push(series);
        self
    }

    /// Adds a side of approach: a line through its points and a dot at each.
    pub(crate) fn with_side(self, label: &str, points: Vec<(f64, f64)>, colour: Colour) -> Self {
        if points.is_empty() {
            return self;
        }
        let line = Series::new(label, Style::Line, points.clone()).coloured(colour);
        self.with(line).with(Series::new("", Style::Dots, points).coloured(colour))
    }

    /// An SVG document of this size in pixels.
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
        let points = || self.series.iter().flat_map(|s| point_thinning::finite(&s.points));
        let zeros = self.series.iter().filter(|s| s.style == Style::Bars).map(|_| 0.0);
        let (mut x, mut y) = (span(points().map(|p| p.0)), span(points().map(|p| p.1).chain(zeros)));
        if !self.x_names.is_empty() {
            x = [-0.7, self.x_names.len() as f64 - 0.3];
        }
        let pad = |[lo, hi]: [f64; 2], by: f64| {
            let size = if hi > lo { hi - lo } else { hi.abs().max(1.0) };
            [lo - by * size, hi + by * size]
        };
        // The numbers of marks are above the data.
        let room = if self.marks.is_empty() { 0.0 } else { 0.05 * (y[1] - y[0]) };
        y[1] += if room.is_finite() { room } else { 0.0 };
        x[0].is_finite().then(|| (pad(x, if self.x_names.is_empty() { 0.02 } else { 0.0 }), pad(y, 0.06)))
    }

    /// The areas of the plot and of the legend, which is as wide as its longest name.
    fn split<'t>(&self, area: &Area<'t>, width: u32) -> (Area<'t>, Option<Area<'t>>) {
        let names = self.series.iter().map(|s| &s.label).chain(self.marks.iter().map(|m| &m.1));
        let longest = names.map(|n| n.chars().count()).max().unwrap_or(0) as u32;
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
        let longest = self.x_names.iter().map(|n| n.chars().count()).max().unwrap_or(0) as u32;
        let turned = longest * 8 * self.x_names.len() as u32 > plot.dim_in_pixel().0 - 74;
        let below = if turned { 30 + 8 * longest } else { 42 };
        let mut chart = ChartBuilder::on(&plot)
            .caption(&self.title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(below)
            .y_label_area_size(64)
            .build_cartesian_2d(x0..x1, y0..y1)?;
        let (x_number, y_number) = (|v: &f64| plain(*v, x1 - x0), |v: &f64| plain(*v, y1 - y0));
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(&self.x)
            .y_desc(&self.y)
            .label_style(("sans-serif", 15))
            .axis_desc_style(("sans-serif", 16))
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12))
            .y_label_formatter(&y_number);
        if self.x_names.is_empty() {
            mesh.x_label_formatter(&x_number).draw()?;
        } else {
            mesh.disable_x_mesh().x_labels(0).draw()?;
        }
        for (i, name) in self.x_names.iter().enumerate() {
            let (x, y) = chart.plotting_area().map_coordinate(&(i as f64, y0));
            let style = TextStyle::from(("sans-serif", 15).into_font());
            let style = if turned {
                style.transform(FontTransform::Rotate270).pos(Pos::new(HPos::Right, VPos::Center))
            } else {
                style.pos(Pos::new(HPos::Center, VPos::Top))
            };
            series_style::words(&area, name, (x, y + 8), &style)?;
        }
        let half = if self.x_names.is_empty() { (x1 - x0) / 400.0 } else { 0.35 };
        for (i, s) in self.series.iter().enumerate() {
            let (colour, place) = (s.colour.rgb(i), s.colour.place(i));
            let pixel = |p: &(f64, f64)| chart.plotting_area().map_coordinate(p);
            let points = match s.style {
                Style::Line => point_thinning::line(&s.points, pixel),
                Style::Dots => point_thinning::dots(&s.points, pixel),
                Style::Bars | Style::Band => point_thinning::finite(&s.points).collect(),
            }
            .into_iter();
            match (s.style, series_style::dash(place)) {
                (Style::Line, None) => {
                    chart.draw_series(LineSeries::new(points, colour.stroke_width(2)))?;
                }
                (Style::Line, Some((on, off))) => {
                    chart.draw_series(DashedLineSeries::new(points, on, off, colour.stroke_width(2)))?;
                }
                (Style::Dots, _) => {
                    for p in points {
                        series_style::marker(&area, place, pixel(&p), 2, colour)?;
                    }
                }
                (Style::Bars, _) => {
                    let bar =
                        |(x, y)| Rectangle::new([(x - half, 0.0), (x + half, y)], colour.mix(0.8).filled());
                    chart.draw_series(points.map(bar))?;
                }
                (Style::Band, _) => {
                    let (lower, upper) = s.points.split_at(s.points.len() / 2);
                    let (lower, upper) =
                        (point_thinning::line(lower, pixel), point_thinning::line(upper, pixel));
                    let around: Vec<_> = lower.into_iter().chain(upper.into_iter().rev()).collect();
                    chart.draw_series(std::iter::once(Polygon::new(around, colour.mix(0.2).filled())))?;
                }
            }
        }
        // A mark shows its number beside its line; the legend explains it.
        let small = ("sans-serif", 14).into_font().color(&BLACK.mix(0.7));
        for (i, (x, _)) in self.marks.iter().enumerate() {
            chart.draw_series(LineSeries::new([(*x, y0), (*x, y1)], BLACK.mix(0.3)))?;
            let at = chart.plotting_area().map_coordinate(&(*x, y1));
            series_style::words(&area, &(i + 1).to_string(), (at.0 + 4, at.1 + 3), &small)?;
        }
        if let Some(legend) = legend {
            self.legend(&legend)?;
        }
        area.present()?;
        Ok(())
    }

    /// Draws the series with their names, then the marks by number.
    fn legend(&self, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
        let (width, height) = area.dim_in_pixel();
        let fits = (width.saturating_sub(30) / 7).max(8) as usize;
        let marks: Vec<Vec<String>> = self.marks.iter().map(|(_, name)| wrapped(name, fits)).collect();
        // Many series are closer together, so that the marks' names fit below.
        let series = self.series.iter().filter(|s| !s.label.is_empty()).count().max(1) as i32;
        let below = 8 + 16 * marks.iter().map(Vec::len).sum::<usize>() as i32;
        let row = ((height as i32 - 60 - below) / series).clamp(9, 20);
        let size = if row < 16 { row - 1 } else { 15 };
        let style = ("sans-serif", size).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        let mut y = 52;
        for (i, s) in self.series.iter().enumerate().filter(|(_, s)| !s.label.is_empty()) {
            let (colour, place) = (s.colour.rgb(i), s.colour.place(i));
            match s.style {
                Style::Line => series_style::sample(area, place, [0, 20], y, colour)?,
                Style::Dots => series_style::marker(area, place, (10, y), 3, colour)?,
                Style::Bars | Style::Band => {
                    let filled = colour.mix(if s.style == Style::Bars { 1.0 } else { 0.25 }).filled();
                    area.draw(&Rectangle::new([(2, y - 4), (18, y + 4)], filled))?;
                }
            }
            series_style::words(area, &s.label, (26, y), &style)?;
            y += row;
        }
        y += 8;
        let small =
            ("sans-serif", 13).into_font().color(&BLACK.mix(0.7)).pos(Pos::new(HPos::Left, VPos::Center));
        for (i, lines) in marks.iter().enumerate() {
            series_style::words(area, &(i + 1).to_string(), (2, y), &small)?;
            for line in lines {
                series_style::words(area, line, (26, y), &small)?;
                y += 16;
            }
        }
        Ok(())
    }
}

/// Splits words into lines of at most this many characters.
fn wrapped(text: &str, fits: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.last_mut().expect("there is a line from the start");
        if last.is_empty() {
            last.push_str(word);
        } else if last.chars().count() + 1 + word.chars().count() <= fits {
            last.push(' ');
            last.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines
}

/// A tick's number with the decimals that the axis's span needs.
fn plain(v: f64, span: f64) -> String {
    let decimals = (1.0 - span.log10()).ceil().clamp(0.0, 6.0) as usize;
    let text = format!("{v:.decimals$}");
    let (sign, size) = text.strip_prefix('-').map_or(("", text.as_str()), |size| ("−", size));
    let size = match size.split_once('.') {
        Some((whole, rest)) if rest.bytes().all(|b| b == b'0') => whole,
        _ => size,
    };
    if size == "0" { size.to_owned() } else { format!("{sign}{size}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Zero has no sign, a whole number no decimals, and a minus is U+2212.
    #[test]
    fn ticks_are_plain_numbers() {
        for (v, span, want) in [
            (-1e-12, 2.0, "0"),
            (1.0, 9.0, "1"),
            (-10.0, 40.0, "−10"),
            (0.5, 3.0, "0.5"),
            (-0.25, 0.8, "−0.25"),
            (20.0, 0.01, "20"),
        ] {
            assert_eq!(plain(v, span), want, "{v} of {span}");
        }
    }

    /// In grey, series differ by dash or marker.
    /// A phase has a number in the plot and a name beside it.
    #[test]
    fn series_and_marks_are_told_apart_without_colour() {
        let line = |k: f64| (0..9).map(|i| (f64::from(i), k * f64::from(i))).collect::<Vec<_>>();
        let chart = Chart::new("drift", "t (min)", "e (µm)")
            .with(Series::new("up", Style::Line, line(1.0)).coloured(Colour::Up))
            .with(Series::new("down", Style::Line, line(2.0)).coloured(Colour::Down))
            .with(Series::new("seen", Style::Dots, line(3.0)));
        let marks =
            vec![(1.0, "at rest after heat".to_owned()), (7.0, "spindle, 1500 to 5500 rpm".to_owned())];
        let svg = Chart { marks, ..chart }.svg(900, 500).unwrap();
        let lines = |colour: &str| svg.matches(&format!("stroke=\"{colour}\"")).count();
        // One polyline and its sample; many dashes of the second series.
        assert_eq!(lines("#0072B2"), 2, "{svg}");
        assert!(lines("#D55E00") > 20, "{svg}");
        for words in ["at rest after heat", "spindle, 1500 to"] {
            assert_eq!(svg.matches(words).count(), 1, "{words}");
        }
        assert_eq!(
            wrapped("spindle rotation, 1500 to 5500 rpm", 18),
            ["spindle rotation,", "1500 to 5500 rpm"]
        );
    }
}
