//! Dashes and markers that distinguish series without colour.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::RGBColor;

/// Dash and gap of a line, px; `None` is a solid line.
const DASHES: [Option<(i32, i32)>; 4] = [None, Some((9, 4)), Some((3, 3)), Some((16, 5))];

/// The dash of the series at an index.
pub(super) fn dash(place: usize) -> Option<(i32, i32)> {
    DASHES[place % DASHES.len()]
}

type Drawn<DB> = Result<(), DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

/// Draws the marker of a series' index at a pixel: disc, triangle, square or cross.
pub(super) fn marker<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    place: usize,
    (x, y): (i32, i32),
    size: i32,
    colour: RGBColor,
) -> Drawn<DB> {
    match place % 4 {
        0 => area.draw(&Circle::new((x, y), size, colour.filled())),
        1 => area.draw(&TriangleMarker::new((x, y), size + 2, colour.filled())),
        2 => area.draw(&Rectangle::new([(x - size, y - size), (x + size, y + size)], colour.stroke_width(1))),
        _ => area.draw(&Cross::new((x, y), size, colour.stroke_width(1))),
    }
}

/// Draws a sample of a line for the legend.
pub(super) fn sample<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    place: usize,
    [from, to]: [i32; 2],
    y: i32,
    colour: RGBColor,
) -> Drawn<DB> {
    let (on, off) = dash(place).unwrap_or((to - from, 1));
    for x in (from..to).step_by((on + off) as usize) {
        area.draw(&PathElement::new(vec![(x, y), ((x + on).min(to), y)], colour.stroke_width(2)))?;
    }
    Ok(())
}

/// Draws text at a pixel.
pub(super) fn words<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    text: &str,
    at: (i32, i32),
    style: &TextStyle<'_>,
) -> Drawn<DB> {
    area.draw(&Text::new(text, at, style.clone()))
}
