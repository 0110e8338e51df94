//! The quadrature trace that a scale gives along a measured position record.

mod impossible_jumps;
mod rows;
mod simulated_scale;

use crate::InputError;
use impossible_jumps::PositionJumps;
use rows::PositionRows;
use rtec_driver::trace_replay::TracePoint;
use simulated_scale::SimulatedScale;
use std::path::PathBuf;

/// Units of a position, and µm of each.
pub const LENGTHS: [(&str, f64); 5] = [("m", 1e6), ("mm", 1e3), ("um", 1.0), ("nm", 1e-3), ("in", 25_400.0)];
/// Units of a time, and ns of each.
pub const TIMES: [(&str, f64); 5] = [("s", 1e9), ("ms", 1e6), ("us", 1e3), ("ns", 1.0), ("d", 86_400e9)];

/// A position record, and the scale that follows it.
/// The record is a CSV with a time and a position column.
#[derive(Debug, Clone)]
pub struct PositionRecord {
    /// The file.
    pub file: PathBuf,
    /// What one count is worth, µm.
    pub count_um: f64,
    /// Its columns, and how they are read.
    pub options: PositionRecordOptions,
}

// The documentation of the fields is the help of `rtecctl trace from-position`.
/// Columns of a position record, and how they are read
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct PositionRecordOptions {
    /// The position column, by its name or number from 1 [default: the one whose name begins with "position"]
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
    pub column: Option<String>,
    /// The time column, by its name or number from 1 [default: `t_s`, `t_ms`, `t_us` or `t_ns`]
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME"))]
    pub time_column: Option<String>,
    /// The time's unit, d for days [default: of the column's name, `t_ms`; else s]
    #[cfg_attr(feature = "clap", arg(long, value_parser = TIMES.map(|(unit, _)| unit), requires = "time_column"))]
    pub time_unit: Option<String>,
    /// The position's unit [default: of the column's name, `x_mm` or `X [mm]`; else m]
    #[cfg_attr(feature = "clap", arg(long, value_parser = LENGTHS.map(|(unit, _)| unit)))]
    pub unit: Option<String>,
    /// Way back, in counts, before a count edge is undone, as in a scale's interpolator: noise at rest below
    /// this gives no edges
    #[cfg_attr(feature = "clap", arg(long, value_name = "COUNTS", default_value_t = 0.25,
        value_parser = crate::cli_option_parsers::number(|n| n.is_finite() && n >= 0.0, "expected a number from 0")))]
    pub hysteresis_counts: f64,
    /// The position is a counter of so many bits that begins again at zero; 0: it is none [default: found in the record]
    #[cfg_attr(feature = "clap", arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(0..=48)))]
    pub counter_bits: Option<u32>,
    /// Refuse a record whose trace would have more edges
    #[cfg_attr(feature = "clap", arg(long, value_name = "EDGES", default_value_t = 50_000_000))]
    pub most_edges: u64,
}

impl PositionRecord {
    /// Gives the first point and each edge of the trace.
    /// It says what is unusual in the record.
    ///
    /// # Errors
    /// A file that cannot be read, a cell that is no number, times that do not rise, too many edges. A motion of
    /// more than one count a nanosecond. What `edge` returns.
    pub fn trace<E: From<InputError>>(
        &self,
        say: &mut dyn FnMut(&str),
        edge: &mut dyn FnMut(TracePoint) -> Result<(), E>,
    ) -> Result<(), E> {
        let bits = self.checked(say)?;
        let (mut rows, mut travel) = (PositionRows::open(self, bits)?, DistanceTravelled::default());
        let Some((t_ns, counts)) = rows.next()? else {
            return Err(InputError::whole(&self.file, "no rows", "a header and at least one row").into());
        };
        if let Some(note) = &rows.without_unit {
            say(note);
        }
        let counted = rows.start.as_ref().map(|(_, start)| start.as_str()).filter(|start| !start.is_empty());
        if let Some(start) = rows.moments.start().or(counted) {
            say(&format!("note: {}: time 0 of the trace is {start}", self.file.display()));
        }
        if let Some(written) = rows.marks.as_ref().and_then(|marks| marks.written(&self.file)) {
            say(&format!("note: {written}"));
        }
        let mut scale = SimulatedScale::new(t_ns, counts, self.options.hysteresis_counts);
        edge(scale.at)?;
        travel.add_sample(counts, rows.line, self);
        while let Some((t_ns, counts)) = rows.next()? {
            travel.add_sample(counts, rows.line, self);
            travel.is_short_enough(self)?;
            if !scale.move_to(t_ns, counts, edge)? {
                let expected =
                    "a motion of at most one count a nanosecond (is --count-um, or the unit, too small?)";
                return Err(InputError::at(&self.file, rows.line, 0, "a faster motion", expected).into());
            }
        }
        Ok(())
    }

    /// Reads the whole record before its trace is made.
    /// Returns the bits of its counter. A pipe, which cannot be read twice, is not checked.
    fn checked(&self, say: &mut dyn FnMut(&str)) -> Result<u32, InputError> {
        let mut bits = self.options.counter_bits.unwrap_or(0);
        if !self.file.is_file() {
            return Ok(bits);
        }
        let mut jumps = PositionJumps::default();
        let see = &mut |t_ns, counts, line| jumps.see(t_ns, counts * self.count_um, line);
        let mut travel = self.read(bits, see)?;
        if self.options.counter_bits.is_none()
            && let Some((of, said)) = jumps.counter(self)
        {
            say(&format!("note: {said}"));
            bits = of;
            travel = self.read(bits, &mut |_, _, _| ())?;
        } else if let Some(warning) = jumps.jump_note(self).filter(|_| self.options.counter_bits != Some(0)) {
            say(&format!("warning: {warning}"));
        }
        travel.is_short_enough(self)?;
        for warning in [jumps.coarse(self), jumps.no_motion_note(), jumps.dates()].into_iter().flatten() {
            say(&format!("warning: {}: {warning}", self.file.display()));
        }
        Ok(bits)
    }

    /// Travel of the rows with a counter of so many bits.
    /// `see` gets each row's time, counts and line.
    fn read(&self, bits: u32, see: &mut dyn FnMut(u64, f64, usize)) -> Result<DistanceTravelled, InputError> {
        let (mut rows, mut travel) = (PositionRows::open(self, bits)?, DistanceTravelled::default());
        while let Some((t_ns, counts)) = rows.next()? {
            travel.add_sample(counts, rows.line, self);
            see(t_ns, counts, rows.line);
        }
        Ok(travel)
    }
}

/// Travel of a record in counts; it has at most as many edges.
#[derive(Default)]
struct DistanceTravelled {
    counts: f64,
    last: Option<f64>,
    /// The line at which it becomes too long, and its length there.
    too_long: Option<(usize, f64)>,
}

impl DistanceTravelled {
    fn add_sample(&mut self, counts: f64, line: usize, record: &PositionRecord) {
        self.counts += (counts - self.last.replace(counts).unwrap_or(counts)).abs();
        if self.counts > record.options.most_edges as f64 {
            self.too_long.get_or_insert((line, self.counts));
        }
    }

    fn is_short_enough(&self, record: &PositionRecord) -> Result<(), InputError> {
        let Some((line, counts)) = self.too_long else { return Ok(()) };
        let (found, most) = (format!("a way of {counts:.0} counts so far"), record.options.most_edges);
        let expected =
            format!("at most {most} edges (--most-edges takes more; is --count-um, or the unit, too small?)");
        Err(InputError::at(&record.file, line, 0, found, expected))
    }
}
