//! `rtecctl trace`: converts quadrature traces, and makes them from positions.
//! The positions are from a measured record.

use crate::document::say_line;
use anyhow::Context;
use clap::Subcommand;
use rtec_driver::quadrature::State;
use rtec_driver::replay::TracePoint;
use rtec_files::clock::{self, Moments};
use rtec_files::csv::{Header, Reader};
use rtec_files::text::{open_regular, short};
use rtec_files::trace::{TraceFile, TraceReader, trace_columns};
use rtec_files::{InputError, TableMarks, units};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Convert quadrature traces, or make one from a measured position record
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: TraceAction,
}

#[derive(Debug, Subcommand)]
enum TraceAction {
    /// Rewrite a trace; the extensions tell the formats (.csv: `t_ns,a,b`; .vcd: IEEE 1364, signals a and b)
    Convert {
        /// The trace to read
        input: PathBuf,
        /// The trace to write
        #[arg(value_parser = crate::verbs::output())]
        output: PathBuf,
        /// Columns or signals that have other names, or none, each by its name or number from 1; `t_us`, `t_ms` and `t_s` for
        /// times that are not in ns
        #[arg(long, value_name = "NAME=COLUMN", value_delimiter = ',')]
        columns: Vec<String>,
        /// Print the summary as one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Make the trace that a scale gives along a measured position record (CSV: `t_s` and a position column)
    FromPosition(FromPosition),
}

#[derive(Debug, clap::Args)]
struct FromPosition {
    /// The record: a header, a time column `t_s` (or `t_ms`, `t_us`, `t_ns`) and a position column
    input: PathBuf,
    /// What one count is worth, in µm
    #[arg(long, value_name = "UM", value_parser = positive)]
    count_um: f64,
    /// The trace to write (.csv or .vcd)
    #[arg(long, value_name = "FILE", value_parser = crate::verbs::output())]
    out: PathBuf,
    /// The position column, by its name or number from 1 [default: the one whose name begins with "position"]
    #[arg(long, value_name = "NAME")]
    column: Option<String>,
    /// The time column, by its name or number from 1 [default: `t_s`, `t_ms`, `t_us` or `t_ns`]
    #[arg(long, value_name = "NAME")]
    time_column: Option<String>,
    /// The time's unit, d for days [default: of the column's name, `t_ms`; else s]
    #[arg(long, value_parser = TIMES.map(|(unit, _)| unit), requires = "time_column")]
    time_unit: Option<String>,
    /// The position's unit [default: of the column's name, `x_mm` or `X [mm]`; else m]
    #[arg(long, value_parser = LENGTHS.map(|(unit, _)| unit))]
    unit: Option<String>,
    /// Way back, in counts, before a count edge is undone, as in a scale's interpolator: noise at rest below
    /// this gives no edges
    #[arg(long, value_name = "COUNTS", default_value_t = 0.25, value_parser = not_negative)]
    hysteresis_counts: f64,
    /// The position is a counter of so many bits that begins again at zero; 0: it is none [default: found in the record]
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(0..=48))]
    counter_bits: Option<u32>,
    /// Refuse a record whose trace would have more edges
    #[arg(long, value_name = "EDGES", default_value_t = 50_000_000)]
    most_edges: u64,
    /// Print the summary as one JSON document
    #[arg(long)]
    json: bool,
}

/// Units of a position, and µm of each.
const LENGTHS: [(&str, f64); 5] = [("m", 1e6), ("mm", 1e3), ("um", 1.0), ("nm", 1e-3), ("in", 25_400.0)];

fn number(text: &str, good: fn(f64) -> bool, expected: &str) -> Result<f64, String> {
    text.parse().ok().filter(|&n| good(n)).ok_or_else(|| format!("expected {expected}"))
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, |n| n.is_finite() && n > 0.0, "a number above 0")
}

fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |n| n.is_finite() && n >= 0.0, "a number from 0")
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    match &args.what {
        TraceAction::Convert { input, output, columns, json } => {
            convert(input, output, columns)?.print(output, *json)
        }
        TraceAction::FromPosition(args) => from_position(args)?.print(&args.out, args.json),
    }
}

/// Figures of the trace that was written.
#[derive(Debug, Default, PartialEq)]
struct Summary {
    points: u64,
    illegal: u64,
    net_counts: i64,
    first: TracePoint,
    last: TracePoint,
    shortest_ns: Option<u64>,
}

impl Summary {
    fn add(&mut self, point: TracePoint) {
        if self.points == 0 {
            self.first = point;
        } else {
            match self.last.state.step_to(point.state) {
                Some(step) => self.net_counts += i64::from(step),
                None => self.illegal += 1,
            }
            let interval = point.t_ns - self.last.t_ns;
            self.shortest_ns = Some(self.shortest_ns.map_or(interval, |s| s.min(interval)));
        }
        self.last = point;
        self.points += 1;
    }

    fn print(&self, out: &Path, json: bool) -> anyhow::Result<()> {
        let Self { net_counts, illegal, shortest_ns, .. } = self;
        let (edges, start_ns, end_ns) = (self.points.saturating_sub(1), self.first.t_ns, self.last.t_ns);
        if json {
            return say_line(&serde_json::json!({
                "out": out, "edges": edges, "net_counts": net_counts, "illegal": illegal,
                "start_ns": start_ns, "end_ns": end_ns, "min_edge_separation_ns": shortest_ns,
            }));
        }
        let (out, s) = (out.display(), (end_ns - start_ns) as f64 / 1e9);
        let apart = shortest_ns.map_or_else(|| "-".to_owned(), |ns| ns.to_string());
        println!(
            "{out}: {edges} edges, {net_counts:+} counts net, {illegal} illegal, {s:.6} s, edges at least {apart} ns apart"
        );
        Ok(())
    }
}

/// A trace being written; it reports its progress every two seconds.
struct Output<'a> {
    path: &'a Path,
    file: TraceFile,
    summary: Summary,
    shown_at: Instant,
}

impl<'a> Output<'a> {
    fn create(path: &'a Path) -> anyhow::Result<Self> {
        let (file, summary) = (TraceFile::create(path)?, Summary::default());
        Ok(Self { path, file, summary, shown_at: Instant::now() })
    }

    fn write(&mut self, point: TracePoint) -> anyhow::Result<()> {
        self.summary.add(point);
        if self.summary.points.is_multiple_of(1 << 20) && self.shown_at.elapsed() > Duration::from_secs(2) {
            self.shown_at = Instant::now();
            eprintln!("{} edges, at {:.3} s", self.summary.points, point.t_ns as f64 / 1e9);
        }
        self.file.write(point).with_context(|| format!("writing {}", self.path.display()))
    }

    fn finish(self) -> anyhow::Result<Summary> {
        self.file.finish().with_context(|| format!("writing {}", self.path.display()))?;
        Ok(self.summary)
    }
}

fn convert(input: &Path, output: &Path, columns: &[String]) -> anyhow::Result<Summary> {
    let mut reader = TraceReader::open_columns(input, &trace_columns(columns)?)?;
    if let Some(written) = reader.written() {
        eprintln!("note: {written}");
    }
    let mut out = Output::create(output)?;
    while let Some(point) = reader.next_point()? {
        out.write(point)?;
    }
    let summary = out.finish()?;
    for said in [reader.said(), reader.sampled()].into_iter().flatten() {
        eprintln!("note: {said}");
    }
    Ok(summary)
}

fn from_position(args: &FromPosition) -> anyhow::Result<Summary> {
    // Before anything is written. A pipe, which cannot be read twice, is limited below.
    let mut bits = args.counter_bits.unwrap_or(0);
    if args.input.is_file() {
        let mut jumps = Jumps::default();
        let mut way = walk(args, bits, |t_ns, counts, line| jumps.see(t_ns, counts * args.count_um, line))?;
        if args.counter_bits.is_none()
            && let Some((of, said)) = jumps.counter(args)
        {
            eprintln!("note: {said}");
            bits = of;
            way = walk(args, bits, |_, _, _| ())?;
        } else if let Some(warning) = jumps.said(args).filter(|_| args.counter_bits != Some(0)) {
            eprintln!("warning: {warning}");
        }
        way.is_short_enough(args)?;
        for warning in [jumps.coarse(args), jumps.dead(), jumps.dates()].into_iter().flatten() {
            eprintln!("warning: {}: {warning}", args.input.display());
        }
    }
    let (mut record, mut way) = (Record::open(args, bits)?, TravelledCounts::default());
    let mut out = Output::create(&args.out)?;
    let Some((t_ns, counts)) = record.next()? else {
        let expected = "a header and at least one row";
        return Err(InputError::whole(&args.input, "no rows", expected).into());
    };
    let counted = record.start.as_ref().map(|(_, start)| start.as_str()).filter(|start| !start.is_empty());
    if let Some(start) = record.moments.start().or(counted) {
        eprintln!("note: {}: time 0 of the trace is {start}", args.input.display());
    }
    if let Some(written) = record.marks.as_ref().and_then(|marks| marks.written(&args.input)) {
        eprintln!("note: {written}");
    }
    let mut scale = Scale::new(t_ns, counts, args.hysteresis_counts);
    out.write(scale.at)?;
    way.goes_on(counts, record.line, args);
    while let Some((t_ns, counts)) = record.next()? {
        way.goes_on(counts, record.line, args);
        way.is_short_enough(args)?;
        if !scale.move_to(t_ns, counts, |point| out.write(point))? {
            let expected =
                "a motion of at most one count a nanosecond (is --count-um, or the unit, too small?)";
            return Err(InputError::at(&args.input, record.line, 0, "a faster motion", expected).into());
        }
    }
    out.finish()
}

/// Travel of a record in counts; it has at most as many edges.
#[derive(Default)]
struct TravelledCounts {
    counts: f64,
    last: Option<f64>,
    /// The line at which it becomes too long, and its length there.
    too_long: Option<(usize, f64)>,
}

impl TravelledCounts {
    fn goes_on(&mut self, counts: f64, line: usize, args: &FromPosition) {
        self.counts += (counts - self.last.replace(counts).unwrap_or(counts)).abs();
        if self.counts > args.most_edges as f64 {
            self.too_long.get_or_insert((line, self.counts));
        }
    }

    fn is_short_enough(&self, args: &FromPosition) -> Result<(), InputError> {
        let Some((line, counts)) = self.too_long else { return Ok(()) };
        let (found, most) = (format!("a way of {counts:.0} counts so far"), args.most_edges);
        let expected =
            format!("at most {most} edges (--most-edges takes more; is --count-um, or the unit, too small?)");
        Err(InputError::at(&args.input, line, 0, found, expected))
    }
}

/// Reads a record whose counter has this number of bits.
/// `see` receives time, counts and line of each row.
fn walk(
    args: &FromPosition,
    bits: u32,
    mut see: impl FnMut(u64, f64, usize),
) -> Result<TravelledCounts, InputError> {
    let (mut record, mut way) = (Record::open(args, bits)?, TravelledCounts::default());
    while let Some((t_ns, counts)) = record.next()? {
        way.goes_on(counts, record.line, args);
        see(t_ns, counts, record.line);
    }
    Ok(way)
}

/// Speed that no axis of a machine tool exceeds, m/s.
const FASTEST_M_S: f64 = 10.0;
/// Bits of counters that wrap around.
const COUNTER_BITS: [u32; 4] = [16, 20, 24, 32];
/// Share of the range within which a jump is a wrap-around.
const NEAR_RANGE: f64 = 0.02;

/// Times that are kept to see what their clock is.
const FIRST_TIMES: usize = 1000;
/// Changes of the position from which its resolution is known.
const COARSE_CHANGES: usize = 5;

/// Greatest common step of two lengths, µm; 0 below a nanometre.
fn common_step(mut a: f64, mut b: f64) -> f64 {
    const NOTHING_UM: f64 = 1e-3;
    while b > NOTHING_UM {
        let rest = a % b;
        (a, b) = (b, if b - rest < NOTHING_UM { 0.0 } else { rest });
    }
    a
}

/// Range of a counter with this number of bits, counts.
fn range_of(bits: u32) -> f64 {
    2_f64.powi(i32::try_from(bits).unwrap_or(0))
}

/// Steps from row to row that are impossible for a machine.
#[derive(Default)]
struct Jumps {
    last: Option<(u64, f64)>,
    found: usize,
    /// The first jump: line, step in µm, speed in m/s.
    first: Option<(usize, f64, f64)>,
    /// Largest and smallest jump, and largest ordinary step, µm.
    largest_jump_um: f64,
    smallest_jump_um: f64,
    largest_step_um: f64,
    /// Resolution of the written positions, µm, and number of changes.
    written_um: f64,
    changes: usize,
    /// The first times, s, and the number of rows.
    times_s: Vec<f64>,
    rows: usize,
}

impl Jumps {
    fn see(&mut self, t_ns: u64, at_um: f64, line: usize) {
        self.rows += 1;
        if self.times_s.len() < FIRST_TIMES {
            self.times_s.push(t_ns as f64 / 1e9);
        }
        let Some((from_ns, from_um)) = self.last.replace((t_ns, at_um)) else { return };
        let step_um = at_um - from_um;
        if step_um != 0.0 {
            self.changes += 1;
            self.written_um = common_step(self.written_um, step_um.abs());
        }
        // µm/ns are thousands of m/s.
        let m_s = step_um.abs() / (t_ns - from_ns) as f64 * 1e3;
        if m_s <= FASTEST_M_S {
            self.largest_step_um = self.largest_step_um.max(step_um.abs());
            return;
        }
        if self.first.is_none() {
            (self.first, self.smallest_jump_um) = (Some((line, step_um, m_s)), step_um.abs());
        }
        self.found += 1;
        self.largest_jump_um = self.largest_jump_um.max(step_um.abs());
        self.smallest_jump_um = self.smallest_jump_um.min(step_um.abs());
    }

    /// A note if the resolution of the positions is more than a count.
    fn coarse(&self, args: &FromPosition) -> Option<String> {
        let counts = self.written_um / args.count_um;
        let step_um = short(1e-6 * (1e6 * self.written_um).round());
        (self.changes >= COARSE_CHANGES && counts > 1.5).then(|| {
            format!(
                "positions in steps of {step_um} µm, {counts:.0} counts: the edges within a step are spread evenly over the time between \
                 two rows, where the axis may have moved otherwise"
            )
        })
    }

    /// A note if the position never changes.
    fn dead(&self) -> Option<String> {
        let rows = self.rows;
        (self.changes == 0 && rows > 1).then(|| {
            format!(
                "the position is the same in all {rows} rows, so the trace has no edge: did the axis stand, or is the channel dead?"
            )
        })
    }

    /// A note if times in seconds are rather the days of a spreadsheet.
    fn dates(&self) -> Option<String> {
        let (day, first_s) = (clock::spreadsheet_in_s(&self.times_s)?, self.times_s[0]);
        Some(format!(
            "the time begins at {first_s} s: a spreadsheet's date ({day}) in days? --time-unit d takes those"
        ))
    }

    /// Bits of the counter whose range is near all jumps.
    fn bits(&self, args: &FromPosition) -> Option<u32> {
        let near = |um: f64, bits: u32| (um / args.count_um / range_of(bits) - 1.0).abs() < NEAR_RANGE;
        let all = |bits: &u32| near(self.largest_jump_um, *bits) && near(self.smallest_jump_um, *bits);
        COUNTER_BITS.into_iter().find(|bits| self.found > 0 && all(bits))
    }

    /// Bits of a counter that wraps around, and a note about it.
    /// None if the wrap would leave a step that is unusual in this record.
    fn counter(&self, args: &FromPosition) -> Option<(u32, String)> {
        let (line, ..) = self.first?;
        let bits = self.bits(args)?;
        let range_um = range_of(bits) * args.count_um;
        let left = (self.largest_jump_um - range_um).abs().max((range_um - self.smallest_jump_um).abs());
        (left <= 2.0 * self.largest_step_um + args.count_um).then(|| {
            let times = if self.found > 1 { format!(", {} times in all", self.found) } else { String::new() };
            let said = format!(
                "{}:{line}: a counter of {bits} bits begins again here{times}, and the trace goes on by what is left, as in the rows \
                 beside; --counter-bits 0 follows the file as it stands",
                args.input.display()
            );
            (bits, said)
        })
    }

    fn said(&self, args: &FromPosition) -> Option<String> {
        let (line, step_um, m_s) = self.first?;
        let why = match self.bits(args) {
            Some(bits) => format!("a counter of {bits} bits that began again? Then --counter-bits {bits}."),
            None => "was a counter set anew? Then take the rows before it out. Is the unit another? Then --unit or --count-um."
                .to_owned(),
        };
        let more =
            if self.found > 1 { format!(", and at {} rows more", self.found - 1) } else { String::new() };
        let (file, mm) = (args.input.display(), step_um / 1e3);
        Some(format!(
            "{file}:{line}: the position jumps by {mm:+.3} mm, {m_s:.1} m/s{more}: {why} The trace goes along with it"
        ))
    }
}

/// A scale with its interpolator, on straight lines between samples.
struct Scale {
    hysteresis: f64,
    /// Time in ns and position in counts of the last sample.
    from: (u64, f64),
    /// The present count and the state at it, with the time of its edge.
    count: i64,
    at: TracePoint,
}

impl Scale {
    fn new(t_ns: u64, counts: f64, hysteresis: f64) -> Self {
        let count = counts.floor() as i64;
        // The state depends on the count only: 0 is 00, 1 is 10, 2 is 11, 3 is 01.
        let state = (0..count.rem_euclid(4)).fold(State::default(), |state, _| state.next(true));
        Self { hysteresis, from: (t_ns, counts), count, at: TracePoint { t_ns, state } }
    }

    /// Reports each edge on the way to a sample.
    /// `false` if they do not fit into whole nanoseconds.
    fn move_to(
        &mut self,
        t_ns: u64,
        counts: f64,
        mut edge: impl FnMut(TracePoint) -> anyhow::Result<()>,
    ) -> anyhow::Result<bool> {
        let (from_ns, from) = std::mem::replace(&mut self.from, (t_ns, counts));
        let span_ns = (t_ns - from_ns) as f64;
        let up = counts > from;
        loop {
            let half = self.hysteresis / 2.0;
            let boundary = if up { (self.count + 1) as f64 + half } else { self.count as f64 - half };
            if (up && counts < boundary) || (!up && counts >= boundary) {
                return Ok(true);
            }
            // The first sample may already be beyond the boundary; its edge is then due at once.
            let part = ((boundary - from) / (counts - from)).clamp(0.0, 1.0);
            let at_ns = (from_ns + (part * span_ns).round() as u64).max(self.at.t_ns + 1);
            if at_ns > t_ns {
                return Ok(false);
            }
            self.count += if up { 1 } else { -1 };
            self.at = TracePoint { t_ns: at_ns, state: self.at.state.next(up) };
            edge(self.at)?;
        }
    }
}

/// The rows of a position record, as time in ns and position in counts.
struct Record {
    rows: Reader<std::fs::File>,
    /// Number format; `None` for decimal points and commas as separators.
    marks: Option<TableMarks>,
    header: Header,
    /// Line of the present row.
    line: usize,
    time: usize,
    ns_per_unit: f64,
    position: usize,
    counts_per_unit: f64,
    last_ns: Option<u64>,
    /// Unit of the time column.
    time_unit: &'static str,
    /// Range of a counter that wraps around, counts; 0 for none.
    /// Below: its last reading, and the sum of its wraps.
    range: f64,
    last_counts: Option<f64>,
    begun_again: f64,
    /// Times that are dates or times of the day.
    moments: Moments,
    /// Offset subtracted from each numeric time, and the first time in words.
    /// The words are empty if nothing is subtracted.
    start: Option<(f64, String)>,
}

/// Units of a time, and ns of each.
const TIMES: [(&str, f64); 5] = [("s", 1e9), ("ms", 1e6), ("us", 1e3), ("ns", 1.0), ("d", 86_400e9)];

/// The unit of a column: the option's, else that of its name.
/// The two must not contradict each other.
/// None if its name has no unit; an unknown one in brackets is refused.
fn unit_of(
    header: &Header,
    place: usize,
    given: Option<&str>,
    units: [(&'static str, f64); 5],
    option: &str,
) -> Result<Option<(&'static str, f64)>, InputError> {
    let name = header.names().nth(place).unwrap_or_default();
    let stated = units::stated(name);
    if let Some((unit, stated)) = given.and_then(|unit| Some((unit, units::contradicted(name, unit)?))) {
        let found = format!("the column {name} with {option} {unit}: its name says {stated}");
        let expected = format!("{option} {stated}, or none; or another name if that is wrong");
        return Err(header.finding(found, expected));
    }
    let unit = given.or(stated.as_ref().map(|stated| stated.unit));
    let known = units.into_iter().find(|(name, _)| unit == Some(*name));
    if let (Some(unit), None, true) = (unit, known, stated.is_some_and(|stated| stated.in_brackets)) {
        let found = format!("the unit {unit} in the name of column {name}");
        return Err(header.finding(found, format!("one of {}, or {option}", units.map(|u| u.0).join(", "))));
    }
    Ok(known)
}

impl Record {
    fn open(args: &FromPosition, counter_bits: u32) -> Result<Self, InputError> {
        let mut rows = Reader::open(&args.input)?;
        let named = [&args.column, &args.time_column].into_iter().flatten().map(String::as_str);
        let named: Vec<&str> = named.collect();
        let expected = "a header such as t_s,position_mm";
        let time_of = |name: &str| {
            let stated = units::stated(name)?;
            let is_time = stated.name == "t" || stated.name.eq_ignore_ascii_case("time");
            TIMES.into_iter().find(|(unit, _)| is_time && *unit == stated.unit)
        };
        let header = if named.is_empty() {
            let has_both = |header: &Header| {
                header.names().any(|name| time_of(name).is_some())
                    && header.names().any(|name| name.starts_with("position"))
            };
            rows.header_where(expected, has_both)?
        } else {
            rows.header_of(expected, &named)?
        };
        let columns = || format!("the columns {}", header.text());
        let (time, (time_unit, ns_per_unit)) = if let Some(column) = &args.time_column {
            let place = header.place_or_number(column)?;
            let unit = unit_of(&header, place, args.time_unit.as_deref(), TIMES, "--time-unit")?;
            (place, unit.unwrap_or(TIMES[0]))
        } else {
            let mut named = header.names().enumerate();
            named.find_map(|(place, name)| Some((place, time_of(name)?))).ok_or_else(|| {
                let expected = "a time column: t_s, t_ms, t_us or t_ns, or --time-column";
                let finding = header.is_missing().unwrap_or_else(|| header.finding(columns(), expected));
                rows.instead_of(&header, finding)
            })?
        };
        let position = if let Some(column) = &args.column {
            header.place_or_number(column)?
        } else {
            let mut matching = header.names().enumerate().filter(|(_, name)| name.starts_with("position"));
            let (Some((position, _)), None) = (matching.next(), matching.next()) else {
                let expected = "one column whose name begins with position (or --column NAME)";
                return Err(rows.instead_of(&header, header.finding(columns(), expected)));
            };
            position
        };
        let length = unit_of(&header, position, args.unit.as_deref(), LENGTHS, "--unit")?;
        let (_, unit_um) = length.unwrap_or_else(|| {
            let name = header.names().nth(position).unwrap_or_default();
            eprintln!("{}: column '{name}' names no unit: taken as m (see --unit)", args.input.display());
            LENGTHS[0]
        });
        // A pipe cannot be read twice, so its numbers must have decimal points.
        let names = || [time, position].into_iter().filter_map(|place| header.names().nth(place)).collect();
        let named: Vec<&str> = if named.is_empty() { names() } else { named };
        let marks = if args.input.is_file() {
            TableMarks::find(&args.input, &mut open_regular(&args.input)?, &named)?
        } else {
            None
        };
        let counts_per_unit = unit_um / args.count_um;
        Ok(Self {
            rows,
            marks,
            header,
            line: 0,
            time,
            time_unit,
            ns_per_unit,
            position,
            counts_per_unit,
            last_ns: None,
            range: if counter_bits > 0 { range_of(counter_bits) } else { 0.0 },
            last_counts: None,
            begun_again: 0.0,
            moments: Moments::default(),
            start: None,
        })
    }

    fn next(&mut self) -> Result<Option<(u64, f64)>, InputError> {
        let Some(row) = self.rows.row()? else { return Ok(None) };
        self.line = row.line();
        let (mut time, mut counts) = (0.0, 0.0);
        self.header.each(row, |place, cell| {
            let numbers = self.marks.as_ref().map(|marks| marks.numbers(place));
            let finite = |name| {
                let number = match numbers {
                    None => cell.finite().ok(),
                    Some(numbers) => numbers.parse(cell.text()),
                };
                let expected = || numbers.map_or("a finite number", |n| n.expected(cell.text()));
                number.ok_or_else(|| cell.finding(format!("the {name}: {}", expected())))
            };
            if place == self.time {
                let first = self.start.is_none();
                if first && let Some(ns) = self.moments.since_start(cell.text()) {
                    time = ns as f64;
                    return Ok(());
                }
                if let Some(start) = self.moments.start() {
                    let slashes =
                        clock::expected_instead(cell.text()).filter(|_| clock::has_two_days(cell.text()));
                    let expected =
                        slashes.map_or_else(|| format!("a time as in the first row, {start}"), str::to_owned);
                    return Err(cell.finding(expected));
                }
                let written = || clock::expected_instead(cell.text()).map(|expected| cell.finding(expected));
                let read = finite("time").map_err(|e| written().unwrap_or(e))?;
                if first && clock::filetime(read).is_some() {
                    let name = self.header.names().nth(place).unwrap_or_default();
                    let found = format!("{read} in column {name}, Windows FILETIME in steps of 100 ns");
                    return Err(cell.said(
                        found,
                        "a time in s, ms, µs or ns since the start: (t - first) / 10 is one in µs",
                    ));
                }
                if first
                    && self.time_unit == "d"
                    && let Some(date) = clock::spreadsheet(read)
                {
                    self.start = Some((read, format!("{read}, {} of {}", date.what, date.day)));
                }
                if first && let Some((unit, day)) = clock::unix(read) {
                    if unit != self.time_unit {
                        let name = self.header.names().nth(place).unwrap_or_default();
                        let found = format!("{read} in column {name}, Unix time in {unit}");
                        return Err(cell.said(
                            found,
                            format!("a time in {}; or the column called t_{unit}", self.time_unit),
                        ));
                    }
                    self.start = Some((read, format!("{read}, Unix time of {day}")));
                }
                // A scope's time is 0 at its trigger.
                let start = || {
                    if read < 0.0 {
                        (read, format!("{read} {}, before a trigger", self.time_unit))
                    } else {
                        (0.0, String::new())
                    }
                };
                let start = self.start.get_or_insert_with(start).0;
                time = (read - start) * self.ns_per_unit;
            }
            if place == self.position {
                counts = finite("position")? * self.counts_per_unit;
            }
            Ok(())
        })?;
        if self.range > 0.0 {
            let step = counts - self.last_counts.replace(counts).unwrap_or(counts);
            self.begun_again -= self.range * (step / self.range).round();
            counts += self.begun_again;
        }
        // Beyond 2^53 a time in ns or a count is no longer exact in a float.
        let exact = 9_007_199_254_740_992.0;
        if !(0.0..exact).contains(&time) {
            return Err(row.finding("a time out of range", "a time from 0 to 104 days"));
        }
        if counts.abs() >= exact {
            return Err(row.finding("a position out of range", "a position below 2^53 counts"));
        }
        let t_ns = time.round() as u64;
        if let Some(last) = self.last_ns
            && t_ns <= last
        {
            let expected = format!("a time after the row before, {} s", last as f64 / 1e9);
            return Err(row.finding(format!("the time {} s", t_ns as f64 / 1e9), expected));
        }
        self.last_ns = Some(t_ns);
        Ok(Some((t_ns, counts)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times and counts of the edges along samples (ns, counts).
    fn edges(samples: &[(u64, f64)], hysteresis: f64) -> Option<Vec<(u64, i64)>> {
        let mut scale = Scale::new(samples[0].0, samples[0].1, hysteresis);
        let (mut count, mut state) = (samples[0].1.floor() as i64, scale.at.state);
        let mut edges = Vec::new();
        for &(t_ns, counts) in &samples[1..] {
            let fits = scale.move_to(t_ns, counts, |point| {
                count += i64::from(state.step_to(point.state).expect("never both signals at once"));
                state = point.state;
                edges.push((point.t_ns, count));
                Ok(())
            });
            if !fits.unwrap() {
                return None;
            }
        }
        Some(edges)
    }

    #[test]
    fn edges_fall_on_the_straight_line() {
        let there_and_back = [(0, 0.5), (1000, 2.5), (2000, 0.5)];
        let want = [(250, 1), (750, 2), (1250, 1), (1750, 0)];
        assert_eq!(edges(&there_and_back, 0.0).unwrap(), want);
        let late = [(300, 1), (800, 2), (1300, 1), (1800, 0)];
        assert_eq!(edges(&there_and_back, 0.2).unwrap(), late);
        let below_zero = [(0, -0.5), (1000, -2.5)];
        assert_eq!(edges(&below_zero, 0.0).unwrap(), [(250, -2), (750, -3)]);
    }

    #[test]
    fn noise_within_the_hysteresis_gives_no_edge() {
        let noise: Vec<_> =
            (0..100).map(|n| (n * 1000, 7.0 + if n % 2 == 0 { 0.04 } else { -0.04 })).collect();
        assert_eq!(edges(&noise, 0.0).unwrap().len(), 99);
        assert!(edges(&noise, 0.1).unwrap().is_empty());
    }

    #[test]
    fn a_motion_faster_than_a_count_a_nanosecond_is_refused() {
        assert!(edges(&[(0, 0.5), (10, 9.5)], 0.0).is_some());
        assert!(edges(&[(0, 0.5), (10, 30.5)], 0.0).is_none());
    }

    #[test]
    fn an_equal_position_shows_an_equal_state() {
        for counts in [-5.0, -4.0, -1.0, 0.0, 3.0, 4.0] {
            let up = Scale::new(0, counts + 4.0, 0.0).at.state;
            assert_eq!(Scale::new(0, counts, 0.0).at.state, up);
            assert_eq!(up.step_to(Scale::new(0, counts + 1.0, 0.0).at.state), Some(1));
        }
    }

    fn run_from(text: &str, options: &[&str]) -> (anyhow::Result<Summary>, String) {
        use clap::Parser;
        #[derive(Parser)]
        struct Cli {
            #[command(flatten)]
            args: FromPosition,
        }
        let directory = tempfile::tempdir().unwrap();
        let (input, out) = (directory.path().join("p.csv"), directory.path().join("t.csv"));
        std::fs::write(&input, text).unwrap();
        let fixed = ["x", input.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let summary = from_position(&Cli::parse_from(fixed.iter().chain(options)).args);
        let written = std::fs::read_to_string(&out).unwrap_or_default();
        let left = std::fs::read_dir(directory.path()).unwrap().count();
        assert_eq!(
            left,
            if summary.is_ok() { 2 } else { 1 },
            "no output and no temporary file after an error"
        );
        let summary = summary.map_err(|e| {
            anyhow::anyhow!("{}", e.to_string().replace(directory.path().to_str().unwrap(), ""))
        });
        (summary, written)
    }

    #[test]
    fn a_record_whose_trace_has_no_end_is_refused_first() {
        let refused = |text: &str, options: &[&str]| {
            let (summary, written) = run_from(text, options);
            assert!(written.is_empty());
            summary.unwrap_err().to_string()
        };
        let text = "t_s,position_um\n0,0\n1,300000000\n";
        assert!(text.len() <= 33);
        let error = refused(text, &["--count-um", "1"]);
        assert!(
            error.contains(":3: found a way of 300000000 counts so far, expected at most 50000000"),
            "{error}"
        );
        // The way back counts too.
        let back: Vec<String> = (0..100).map(|n| format!("{n},{}", n % 2 * 1000)).collect();
        let text = format!("t_s,position_um\n{}\n", back.join("\n"));
        let error = refused(&text, &["--count-um", "1", "--most-edges", "98999"]);
        assert!(error.contains("found a way of 99000 counts"), "{error}");
        assert!(run_from(&text, &["--count-um", "1", "--most-edges", "99000"]).0.is_ok());
    }

    #[test]
    fn a_record_becomes_a_trace() {
        let text = "\u{feff}# run 3\r\nt_s,reference_m,position_m\r\n0,0,0.0000005\r\n0.001,9,0.0000025\r\n";
        let (summary, written) = run_from(text, &["--count-um", "1", "--hysteresis-counts", "0"]);
        assert_eq!(written, "t_ns,a,b\n0,0,0\n250000,1,0\n750000,1,1\n");
        assert_eq!(summary.unwrap().net_counts, 2);
        let same = "t_ms,x_mm,p\n0,0.5,0\n1,2.5,0\n";
        let options = ["--count-um", "1000", "--hysteresis-counts", "0", "--column", "x_mm"];
        assert_eq!(run_from(same, &options).1, written);
        let bare =
            run_from("t_s,position\n0,0.5\n0.001,2.5\n", &["--count-um", "1e6", "--hysteresis-counts", "0"]);
        assert_eq!(bare.1, written);
    }

    #[test]
    fn positions_in_coarse_steps_show_them() {
        for (values, step) in [
            (&[0.01, 0.03, 0.02, 0.07, 0.0, 0.05, 0.06][..], 10.0),
            (&[0.0, 0.0254, 0.0508, 0.0254, 0.1016, 0.127, 0.1016], 25.4),
            (&[0.0, 0.0123, 0.0457, 0.0211, 0.0999, 0.05, 0.0731], 0.1),
        ] {
            let mut jumps = Jumps::default();
            for (n, mm) in values.iter().enumerate() {
                jumps.see(n as u64 * 1_000_000, mm * 1e3, n);
            }
            assert!((jumps.written_um - step).abs() < 1e-6, "{values:?}: {}", jumps.written_um);
        }
    }

    #[test]
    fn units_of_the_names_are_read() {
        let wants = "t_ns,a,b\n0,0,0\n250000,1,0\n750000,1,1\n";
        for (text, options) in [
            (
                "Time [ms],X [mm]\n0,0.0005\n1,0.0025\n",
                &["--time-column", "Time [ms]", "--column", "X [mm]"][..],
            ),
            ("Time (us);position (µm)\n0;0,5\n1000;2,5\n", &[]),
            ("t_ms,pos (in)\n0,0.0000196850394\n1,0.0000984251969\n", &["--column", "pos (in)"]),
            ("scope x\nmade,2026\n; by y\nt_s,note,position_um\n0,a,0.5\n0.001,b,2.5\n", &[]),
        ] {
            let options: Vec<&str> =
                ["--count-um", "1", "--hysteresis-counts", "0"].iter().chain(options).copied().collect();
            let (summary, written) = run_from(text, &options);
            assert_eq!(written, wants, "{text}: {:?}", summary.err());
        }
        let of = |time: &str| format!("Time [{time}],X [furlong]\n0,0\n1,1\n");
        for (time, options, says) in [
            ("min", &[][..], "one of s, ms, us, ns, d, or --time-unit"),
            ("min", &["--time-unit", "s"], "with --time-unit s: its name says min"),
            ("s", &[], "one of m, mm, um, nm, in, or --unit"),
        ] {
            let options: Vec<&str> =
                ["--time-column", "1", "--column", "2"].iter().chain(options).copied().collect();
            let options: Vec<&str> = ["--count-um", "1"].iter().chain(&options).copied().collect();
            let error = run_from(&of(time), &options).0.unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn a_bad_record_is_explained_and_nothing_is_written() {
        let table = [
            ("", "/p.csv: found no header, expected a header such as t_s,position_mm"),
            ("t_s,position_mm\n", "/p.csv: found no rows, expected a header and at least one row"),
            (
                "t,position_mm\n0,0\n",
                "/p.csv:1:1: found the columns t,position_mm, expected a time column: t_s, t_ms, t_us or t_ns, or --time-column",
            ),
            (
                "t_s,position_mm,position_m\n0,0\n",
                "/p.csv:1:1: found the columns t_s,position_mm,position_m, expected one column whose name begins with position (or --column NAME)",
            ),
            (
                "t_s,position_mm\n0,0\n0.1\n",
                "/p.csv:3:4: found the end of the row after 1 of 2 fields, expected the field position_mm",
            ),
            (
                "t_s,position_mm\n0,0\n0.1,inf\n",
                "/p.csv:3:5: found 'inf', expected the position: a finite number",
            ),
            (
                "t_s,position_mm\n0.2,0\n0.1,1\n",
                "/p.csv:3: found the time 0.1 s, expected a time after the row before, 0.2 s",
            ),
            (
                "t_s,position_mm\n0,0\n0.000000001,1\n",
                "/p.csv:3: found a faster motion, expected a motion of at most one count a nanosecond (is --count-um, or the unit, too small?)",
            ),
        ];
        for (text, message) in table {
            let (summary, written) = run_from(text, &["--count-um", "1"]);
            assert_eq!(summary.unwrap_err().to_string(), message);
            assert_eq!(written, "");
        }
    }
}
