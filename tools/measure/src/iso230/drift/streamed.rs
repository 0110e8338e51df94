//! A drift test of any number of rows in bounded memory.
//! It reads the file three times; leaving rows out takes three more.

use super::heat_phases::{HeatPhase, HeatPhaseCollector};
use super::scatter::Scatter;
use super::two_pass_figures::{FirstPassSums, Row, SecondPassSums};
use super::{DriftFigures, DriftPhaseResult, DriftResult, charts_of, displaced};
use crate::plausible::{DEGC, Suspicion, every_row, rows_left_out};
use crate::plot::{Chart, Series, Style};
use crate::run_record_files::RecordPieceReader;
use rtec_files::{InputError, Result};
use rtec_model::disconnected_sensor_codes::disconnected;
use rtec_model::record::{Column, Record, Role, median, span};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Rows in memory at a time.
const PIECE_ROWS: usize = 4096;

/// A drift test on file after its first pass.
pub(crate) struct StreamedDriftTest {
    path: PathBuf,
    pieces: RecordPieceReader,
    /// The record with its first rows only.
    pub(crate) head: Record,
    pub(crate) rows: usize,
    spans: Vec<HeatPhase>,
    errors: Vec<DecimatedCurve>,
    degc: Vec<DecimatedCurve>,
    usual: UsualTemperatures,
    /// Suspicions against its rows.
    doubts: Vec<Suspicion>,
    /// Rows left out of all figures, from 0.
    left_out: BTreeSet<usize>,
}

/// Usual temperature of each sensor in the first rows, to recognise error codes.
#[derive(Default)]
struct UsualTemperatures(Vec<f64>);

impl UsualTemperatures {
    /// Readings of each temperature; NaN where the sensor took none.
    fn taken(&mut self, record: &Record) -> Vec<Vec<f64>> {
        let columns: Vec<&Column> = record.temperatures().collect();
        let possible = |v: f64| v > DEGC[0] && v < DEGC[1] && disconnected(v).is_none();
        if self.0.is_empty() {
            let middle = |c: &&Column| {
                let good: Vec<f64> = c.data.iter().copied().filter(|v| possible(*v)).collect();
                if good.is_empty() { f64::NAN } else { median(good) }
            };
            self.0 = columns.iter().map(middle).collect();
        }
        let of = |(c, usual): (&&Column, &f64)| {
            // Kelvin and other units are out of range as a whole; they are reported and stay.
            let is_code = |v: f64| match disconnected(v) {
                Some((_, certain)) => certain || (v - usual).abs() > UNUSUAL_K,
                None => usual.is_finite() && !possible(v),
            };
            c.data.iter().map(|v| if is_code(*v) { f64::NAN } else { *v }).collect()
        };
        columns.iter().zip(&self.0).map(of).collect()
    }
}

/// Distance from usual at which 85 or 0 °C is an error code, K.
const UNUSUAL_K: f64 = 15.0;

impl StreamedDriftTest {
    /// Reads a record of more than `more_than` rows; `None` for a shorter one.
    /// Also `None` if an axis moves, because its positions are grouped over all rows.
    pub(crate) fn of(path: &Path, more_than: usize) -> Result<Option<Self>> {
        let Some(mut pieces) = RecordPieceReader::of(path)?.filter(|p| p.most_rows() > more_than as u64)
        else {
            return Ok(None);
        };
        let (mut spans, mut rows, mut head) = (HeatPhaseCollector::default(), 0, None);
        let (mut errors, mut degc): (Vec<DecimatedCurve>, Vec<DecimatedCurve>) = (Vec::new(), Vec::new());
        let (mut before, mut usual) = (Vec::new(), UsualTemperatures::default());
        while let Some(record) = pieces.next_record(PIECE_ROWS)? {
            let is_still = !moves(&record, &mut before);
            let Some(t) = record.data(&Role::Time).filter(|_| is_still) else { return Ok(None) };
            let rpm = record.data(&Role::SpindleSpeed);
            for (row, t) in t.iter().enumerate() {
                spans.see(&[], *t, rpm.map_or(0.0, |r| r[row]));
            }
            errors.resize_with(displaced(&record.columns).count(), DecimatedCurve::default);
            for (outline, c) in errors.iter_mut().zip(displaced(&record.columns)) {
                outline.see(rows, t, &c.data);
            }
            let sensors = usual.taken(&record);
            degc.resize_with(sensors.len(), DecimatedCurve::default);
            for (outline, data) in degc.iter_mut().zip(&sensors) {
                outline.see(rows, t, data);
            }
            rows += record.rows();
            head.get_or_insert(record);
        }
        let head = head.filter(|head| rows > more_than && displaced(&head.columns).next().is_some());
        let spans = spans.phases();
        let path = path.to_owned();
        let (doubts, left_out) = (Vec::new(), BTreeSet::new());
        Ok(head.map(|head| Self { path, pieces, head, rows, spans, errors, degc, usual, doubts, left_out }))
    }

    /// Leaves the rows of these suspicions out of all figures and plots.
    /// As [`crate::plausible::in_figures`] does; it reads the file once.
    pub(crate) fn leave_out(&mut self, doubts: &[Suspicion]) -> Result<()> {
        doubts.clone_into(&mut self.doubts);
        self.left_out = rows_left_out(doubts).into_values().flatten().collect();
        // A phase that would lose all rows keeps them.
        for span in &self.spans {
            if span.rows.clone().all(|row| self.left_out.contains(&row)) {
                self.left_out.retain(|row| !span.rows.contains(row));
            }
        }
        let mut errors = vec![DecimatedCurve::default(); self.errors.len()];
        let mut degc = vec![DecimatedCurve::default(); self.degc.len()];
        let mut place = 0;
        self.walk(PIECE_ROWS, &mut |_: &Record| (), |_, response, (t, e, sensors, row)| {
            place += usize::from(response == 0);
            errors[response].see_one((place, t, e));
            if response == 0 {
                for (outline, data) in degc.iter_mut().zip(sensors).filter(|(_, data)| data[row].is_finite())
                {
                    outline.see_one((place, t, data[row]));
                }
            }
        })?;
        (self.errors, self.degc) = (errors, degc);
        Ok(())
    }

    /// Lowest and highest value of each temperature, °C.
    pub(crate) fn ranges_degc(&self) -> impl Iterator<Item = (&str, [f64; 2])> {
        self.head.temperatures().map(|c| c.name.as_str()).zip(self.degc.iter().map(DecimatedCurve::range))
    }

    /// The same result as [`super::drift`], to the last bit.
    /// Reads the file twice; `each` gets its rows in pieces of `rows_at_once`.
    pub(crate) fn drift(
        &mut self,
        rows_at_once: usize,
        mut each: impl FnMut(&Record),
    ) -> Result<Vec<DriftResult>> {
        let (responses, sensors) = (self.errors.len(), self.degc.len());
        let none = vec![FirstPassSums::new(sensors); responses];
        let (mut whole, mut by_span) = (none.clone(), vec![none; self.spans.len()]);
        self.walk(rows_at_once, &mut each, |span, response, row| {
            whole[response].see(row);
            by_span[span][response].see(row);
        })?;
        let start_s = self.spans.first().map_or(0.0, |s| s.start_s);
        let looks = |of: Vec<FirstPassSums>| of.into_iter().map(SecondPassSums::at).collect::<Vec<_>>();
        let (mut whole, mut now) = (looks(whole), Vec::new());
        let mut scatters = vec![Scatter::default(); responses];
        let mut phases: Vec<Vec<DriftFigures>> = vec![Vec::new(); responses];
        let head = self.head.clone();
        let figures = |look: &SecondPassSums| look.figures(head.temperatures().map(|c| c.name.as_str()));
        let mut by_span = by_span.into_iter();
        let mut present = None;
        let mut close = |looks: Vec<SecondPassSums>| {
            phases.iter_mut().zip(&looks).for_each(|(phases, look)| phases.push(figures(look)));
        };
        self.walk(PIECE_ROWS, &mut |_: &Record| (), |span, response, row| {
            if present != Some(span) {
                present = Some(span);
                let next = looks(by_span.next().unwrap_or_default());
                close(std::mem::replace(&mut now, next));
                scatters.iter_mut().for_each(Scatter::begin);
            }
            whole[response].see(row);
            now[response].see(row);
            scatters[response].see(row.0, row.1);
        })?;
        close(now);
        let phase = |(of, figures): (&HeatPhase, DriftFigures)| -> DriftPhaseResult {
            of.phase(&head.columns, (of.start_s - start_s) / 60.0, None, figures)
        };
        let all = displaced(&self.head.columns).zip(whole).zip(phases).zip(&scatters);
        Ok(all
            .map(|(((column, whole), phases), scatter)| DriftResult {
                phases: self.spans.iter().zip(phases).map(&phase).collect(),
                ..DriftResult::of(column, figures(&whole), scatter)
            })
            .collect())
    }

    /// Reads the file once.
    /// `each` gets its rows in pieces; `see` gets each row's phase, response and values.
    fn walk(
        &mut self,
        rows_at_once: usize,
        each: &mut dyn FnMut(&Record),
        mut see: impl FnMut(usize, usize, Row<'_>),
    ) -> Result<()> {
        self.pieces.rewind()?;
        let (mut seen, mut span) = (0, 0);
        while let Some(record) = self.pieces.next_record(rows_at_once)? {
            each(&record);
            let good = every_row(std::slice::from_ref(&record), &self.doubts);
            let (t, errors) = (record.time_s(), displaced(&record.columns).collect::<Vec<_>>());
            let degc = self.usual.taken(&good[0]);
            let degc: Vec<&[f64]> = degc.iter().map(Vec::as_slice).collect();
            for row in
                (0..record.rows().min(self.rows - seen)).filter(|row| !self.left_out.contains(&(seen + row)))
            {
                while self.spans[span].rows.end <= seen + row {
                    span += 1;
                }
                for (response, c) in errors.iter().enumerate() {
                    see(span, response, (t[row], c.data[row], &degc, row));
                }
            }
            seen += record.rows();
            if seen > self.rows {
                break;
            }
        }
        if seen != self.rows {
            let expected = format!("{} rows, as when it was read first", self.rows);
            return Err(InputError::whole(&self.path, "another number of rows", expected));
        }
        Ok(())
    }

    /// The charts of [`super::drift_charts`] from fewer points.
    /// They touch the same pixels, except for some at the edge between two.
    pub(crate) fn charts(&self) -> Vec<Chart> {
        let start_s = self.spans.first().map_or(0.0, |s| s.start_s);
        let line = |name: &str, of: &DecimatedCurve| Series::new(name, Style::Line, of.points(start_s));
        let errors = displaced(&self.head.columns)
            .zip(&self.errors)
            .map(|(c, of)| (c.unit.clone(), line(&c.role.to_string(), of)));
        let degc = self.head.temperatures().zip(&self.degc).map(|(c, of)| line(&c.name, of));
        charts_of(errors.collect(), degc.collect(), &self.spans, &self.head.columns)
    }
}

/// Whether an axis moves; `before` are the positions of the last row.
fn moves(record: &Record, before: &mut Vec<f64>) -> bool {
    let axes: Vec<&[f64]> = record.axes(Role::Position).filter_map(|a| record.position(a)).collect();
    let steps = |(n, p): (usize, &&[f64])| {
        let from = before.get(n).copied().unwrap_or(p[0]);
        std::iter::once(&from).chain(*p).zip(*p).any(|(q, p)| super::is_move(*q, *p))
    };
    let moves = axes.iter().enumerate().any(steps);
    *before = axes.iter().map(|p| p[p.len() - 1]).collect();
    moves
}

/// Most blocks of a line: several per pixel column.
const MOST_BLOCKS: usize = 1 << 13;

/// A row's number, its time (s) and value.
type Point = (usize, f64, f64);

/// First, lowest, highest and last point of a block of rows.
type Block = [Point; 4];

/// A line of any number of points, kept as four points per block of rows.
#[derive(Debug, Clone)]
struct DecimatedCurve {
    blocks: Vec<Block>,
    rows_a_block: usize,
    /// Rows of the last block.
    rows: usize,
}

impl Default for DecimatedCurve {
    fn default() -> Self {
        Self { blocks: Vec::new(), rows_a_block: 1, rows: 0 }
    }
}

impl DecimatedCurve {
    /// The next rows; `first` is the number of the first one.
    fn see(&mut self, first: usize, t: &[f64], v: &[f64]) {
        for (row, (t, v)) in t.iter().zip(v).enumerate().filter(|(_, (_, v))| v.is_finite()) {
            self.see_one((first + row, *t, *v));
        }
    }

    fn see_one(&mut self, now: Point) {
        if let Some(block) = self.blocks.last_mut().filter(|_| self.rows < self.rows_a_block) {
            widen(block, &[now; 4]);
            self.rows += 1;
            return;
        }
        if self.blocks.len() == MOST_BLOCKS {
            // Join pairs of blocks; from here on blocks have twice as many rows.
            let joined = |pair: &[Block]| {
                let mut block = pair[0];
                pair[1..].iter().for_each(|next| widen(&mut block, next));
                block
            };
            self.blocks = self.blocks.chunks(2).map(joined).collect();
            self.rows_a_block *= 2;
        }
        self.blocks.push([now; 4]);
        self.rows = 1;
    }

    /// Its points; minutes count from `start_s`.
    fn points(&self, start_s: f64) -> Vec<(f64, f64)> {
        let mut points: Vec<Point> = self.blocks.iter().flatten().copied().collect();
        points.sort_by_key(|(row, ..)| *row);
        points.dedup_by_key(|(row, ..)| *row);
        points.into_iter().map(|(_, t, v)| ((t - start_s) / 60.0, v)).collect()
    }

    /// Lowest and highest value.
    fn range(&self) -> [f64; 2] {
        span(self.blocks.iter().flat_map(|[_, low, high, _]| [low.2, high.2]))
    }
}

/// Adds the rows of the next block.
fn widen([_, low, high, last]: &mut Block, [_, next_low, next_high, next_last]: &Block) {
    *last = *next_last;
    if next_low.2 < low.2 {
        *low = *next_low;
    }
    if next_high.2 > high.2 {
        *high = *next_high;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The outline has few points, both ends, and each pixel column's extremes.
    #[test]
    fn an_outline_has_what_a_plot_shows() {
        let rows = 20 * MOST_BLOCKS + 77;
        let value = |row: usize| (row as f64 / 9e3).sin() + ((row * row * 7 + row * 3) % 1009) as f64 / 500.0;
        let mut outline = DecimatedCurve::default();
        let all: Vec<(f64, f64)> = (0..rows).map(|row| (60.0 * row as f64, value(row))).collect();
        for (n, piece) in all.chunks(1000).enumerate() {
            let (t, v): (Vec<f64>, Vec<f64>) = piece.iter().copied().unzip();
            outline.see(1000 * n, &t, &v);
        }
        let points = outline.points(0.0);
        assert!(points.len() <= 4 * MOST_BLOCKS && points.is_sorted_by(|a, b| a.0 < b.0), "{}", points.len());
        assert_eq!(points[0], (0.0, value(0)));
        assert_eq!(points[points.len() - 1], ((rows - 1) as f64, value(rows - 1)));
        assert_eq!(outline.rows_a_block, 32);
        assert_eq!(outline.range().map(f64::to_bits), span((0..rows).map(value)).map(f64::to_bits));
        for column in 0..700 {
            let (from, to) = (column * rows / 700, (column + 1) * rows / 700);
            let drawn = points.iter().filter(|(row, _)| (from as f64..to as f64).contains(row)).map(|p| p.1);
            let [low, high] = span(drawn);
            let [inner_low, inner_high] = span((from.next_multiple_of(32)..to / 32 * 32).map(value));
            let [whole_low, whole_high] = span((from..to).map(value));
            assert!(
                whole_low <= low && low <= inner_low && inner_high <= high && high <= whole_high,
                "{column}"
            );
        }
    }
}
