//! Recorded quadrature: traces as CSV (`t_ns,a,b`) and VCD (IEEE 1364), and the CSV of requested totals.
//!
//! Readers stream: memory stays flat for a file of any length. A trace has one row per change and strictly rising
//! times; a row in which both signals change is passed on, because an illegal transition is the engine's to report.

use crate::csv;
use crate::file_kind::FileKind;
use crate::input::InputError;
use crate::lines::BUFFER;
use crate::numbers::Marks;
use crate::text::opened;
use crate::vcd::Vcd;
use crate::write::WholeFile;
use rtec_driver::quadrature::State;
use rtec_driver::replay::{RequestedTotal, TracePoint};
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

/// Longest plain row, `18446744073709551615,1,1\r\n`, rounded up.
const PLAIN_ROW: usize = 32;

/// So many bytes tell what a file is.
const BEGIN: usize = 4096;

/// How a trace is written down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TraceFormat {
    /// `t_ns,a,b`, one row per change.
    Csv,
    /// Value change dump, IEEE 1364, signals `a` and `b`.
    Vcd,
}

impl TraceFormat {
    /// The format that a file's extension names.
    ///
    /// # Errors
    /// The extension is neither `.csv` nor `.vcd`.
    pub fn of(file: &Path) -> Result<Self, InputError> {
        let extension = file.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match extension.as_str() {
            "csv" => Ok(Self::Csv),
            "vcd" => Ok(Self::Vcd),
            "" => Err(InputError::whole(file, "no extension", "a trace ending in .csv or .vcd")),
            other => {
                Err(InputError::whole(file, format!("extension .{other}"), "a trace ending in .csv or .vcd"))
            }
        }
    }
}

/// Reads a trace point by point; after an error it yields nothing more.
#[derive(Debug)]
pub struct TraceReader<R> {
    rows: csv::Reader<R>,
    last: Option<TracePoint>,
    vcd: Option<Vcd>,
    done: bool,
}

impl TraceReader<File> {
    /// Opens a trace; its extension tells the format.
    ///
    /// # Errors
    /// The file cannot be read, its extension is unknown, or its header is wrong.
    pub fn open(file: &Path) -> Result<Self, InputError> {
        let format = TraceFormat::of(file)?;
        Self::new(format, file, opened(file)?)
    }
}

impl<R: Read> TraceReader<R> {
    /// Reads a trace from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(format: TraceFormat, file: &Path, input: R) -> Result<Self, InputError> {
        let mut rows = csv::Reader::new(file, input)?;
        let vcd = match format {
            TraceFormat::Csv => {
                rows.expect_header(COLUMNS)?;
                None
            }
            TraceFormat::Vcd => {
                let begin = rows.lines.unread();
                let begin = String::from_utf8_lossy(&begin[..begin.len().min(BEGIN)]).into_owned();
                let vcd = Vcd::definitions(&mut rows.lines);
                Some(vcd.map_err(|e| FileKind::instead_of(Some(FileKind::Vcd), &begin, e))?)
            }
        };
        Ok(Self { rows, last: None, vcd, done: false })
    }

    /// How the file is written where it is not as formats.md has it: UTF-16, another separator.
    #[must_use]
    pub fn written(&self) -> Option<String> {
        self.vcd.is_none().then(|| written(&self.rows))?
    }

    /// The next point, or `None` at the end.
    ///
    /// # Errors
    /// The first row that is not as the format wants it.
    #[inline]
    pub fn next_point(&mut self) -> Result<Option<TracePoint>, InputError> {
        if self.vcd.is_none()
            && let Some(last) = self.last
            && let Some(row) = self.rows.lines.ahead::<PLAIN_ROW>()
            && let Some((point, length)) = plain_row(row)
            && point.t_ns > last.t_ns
            && point.state != last.state
        {
            self.rows.lines.take_line(length, 0);
            self.last = Some(point);
            return Ok(Some(point));
        }
        self.next_slowly()
    }

    #[cold]
    #[inline(never)]
    fn next_slowly(&mut self) -> Result<Option<TracePoint>, InputError> {
        if self.done {
            return Ok(None);
        }
        let next = match &mut self.vcd {
            Some(vcd) => vcd.next(&mut self.rows.lines, self.last),
            None => csv_row(&mut self.rows, self.last),
        };
        match next {
            Ok(Some(point)) => {
                self.last = Some(point);
                Ok(Some(point))
            }
            Ok(None) if self.last.is_none() => {
                self.done = true;
                Err(InputError::whole(
                    &self.rows.lines.file,
                    "a trace without a point",
                    "at least the initial state of a and b",
                ))
            }
            end => {
                self.done = true;
                end
            }
        }
    }
}

fn written<R: Read>(rows: &csv::Reader<R>) -> Option<String> {
    Marks::new(rows).written(&rows.lines.file)
}

impl<R: Read> Iterator for TraceReader<R> {
    type Item = Result<TracePoint, InputError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        self.next_point().transpose()
    }
}

/// A trace whose times are worked with: a player adds to them, and a time that leaves no room for that is a bad row.
#[derive(Debug)]
pub struct Playable<R>(TraceReader<R>);

impl<R: Read> TraceReader<R> {
    /// The same trace, to be played.
    pub const fn playable(self) -> Playable<R> {
        Playable(self)
    }
}

impl<R: Read> Iterator for Playable<R> {
    type Item = Result<TracePoint, InputError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        match self.0.next_point().transpose()? {
            Ok(point) if point.t_ns > LATEST_PLAYED_NS => {
                self.0.done = true;
                let lines = &self.0.rows.lines;
                let found = format!("the time {} ns", point.t_ns);
                let expected = format!("a time of at most {LATEST_PLAYED_NS} ns in a trace that is played");
                Some(Err(InputError::at(&lines.file, lines.line, 0, found, expected)))
            }
            next => Some(next),
        }
    }
}

/// Reads requested totals (`t_ns,requested`), times never falling; after an error it yields nothing more.
#[derive(Debug)]
pub struct RequestReader<R> {
    rows: csv::Reader<R>,
    last_ns: u64,
    done: bool,
}

impl RequestReader<File> {
    /// Opens a file of requests.
    ///
    /// # Errors
    /// The file cannot be read or its header is wrong.
    pub fn open(file: &Path) -> Result<Self, InputError> {
        Self::new(file, opened(file)?)
    }
}

impl<R: Read> RequestReader<R> {
    /// Reads requests from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(file: &Path, input: R) -> Result<Self, InputError> {
        let mut rows = csv::Reader::new(file, input)?;
        rows.expect_header(["t_ns", "requested"])?;
        Ok(Self { rows, last_ns: 0, done: false })
    }

    /// As [`TraceReader::written`].
    #[must_use]
    pub fn written(&self) -> Option<String> {
        written(&self.rows)
    }

    fn row(&mut self) -> Result<Option<RequestedTotal>, InputError> {
        let Some(row) = self.rows.row()? else { return Ok(None) };
        let [t, requested] = row.exactly(["t_ns", "requested"])?;
        let t_ns = t.number(TIME)?;
        if t_ns < self.last_ns {
            return Err(t.finding(format!("a time not before the last one, {} ns", self.last_ns)));
        }
        let requested = requested.number("a whole number of counts")?;
        self.last_ns = t_ns;
        Ok(Some(RequestedTotal { t_ns, requested }))
    }
}

impl<R: Read> Iterator for RequestReader<R> {
    type Item = Result<RequestedTotal, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let row = self.row().transpose();
        self.done = !matches!(row, Some(Ok(_)));
        row
    }
}

/// Writes a trace point by point, buffered. The caller gives strictly rising times and one point per change.
#[derive(Debug)]
pub struct TraceWriter<W: Write> {
    out: io::BufWriter<W>,
    format: TraceFormat,
    last: Option<State>,
}

impl<W: Write> TraceWriter<W> {
    /// A writer that has written its header.
    ///
    /// # Errors
    /// What `out` reports.
    pub fn new(format: TraceFormat, out: W) -> io::Result<Self> {
        let mut out = io::BufWriter::with_capacity(BUFFER, out);
        out.write_all(match format {
            TraceFormat::Csv => b"t_ns,a,b\n".as_slice(),
            TraceFormat::Vcd => {
                b"$timescale 1 ns $end\n$var wire 1 ! a $end\n$var wire 1 \" b $end\n$enddefinitions $end\n"
            }
        })?;
        Ok(Self { out, format, last: None })
    }

    /// Writes one point.
    ///
    /// # Errors
    /// What the output reports.
    #[inline]
    pub fn write(&mut self, point: TracePoint) -> io::Result<()> {
        match self.format {
            TraceFormat::Csv => self.csv(point),
            TraceFormat::Vcd => self.vcd(point),
        }
    }

    #[inline]
    fn csv(&mut self, TracePoint { t_ns, state }: TracePoint) -> io::Result<()> {
        let mut row = [0; PLAIN_ROW];
        let mut digits = itoa::Buffer::new();
        let digits = digits.format(t_ns).as_bytes();
        let end = digits.len();
        row[..end].copy_from_slice(digits);
        row[end..end + 5].copy_from_slice(&[b',', level(state.a()), b',', level(state.b()), b'\n']);
        self.out.write_all(&row[..end + 5])
    }

    fn vcd(&mut self, TracePoint { t_ns, state }: TracePoint) -> io::Result<()> {
        let mut digits = itoa::Buffer::new();
        self.out.write_all(b"#")?;
        self.out.write_all(digits.format(t_ns).as_bytes())?;
        let Some(last) = self.last.replace(state) else {
            let (a, b) = (u8::from(state.a()), u8::from(state.b()));
            return write!(self.out, "\n$dumpvars\n{a}!\n{b}\"\n$end\n");
        };
        if state.a() != last.a() {
            self.out.write_all(&[b'\n', level(state.a()), b'!'])?;
        }
        if state.b() != last.b() {
            self.out.write_all(&[b'\n', level(state.b()), b'"'])?;
        }
        self.out.write_all(b"\n")
    }

    /// Writes out what is still held and gives the output back.
    ///
    /// # Errors
    /// What the output reports.
    pub fn finish(self) -> io::Result<W> {
        self.out.into_inner().map_err(io::IntoInnerError::into_error)
    }
}

/// A trace file that appears under its name only when it is whole: until [`TraceFile::finish`] it is a temporary
/// file beside it, which is removed when dropped.
#[derive(Debug)]
pub struct TraceFile(TraceWriter<WholeFile>);

impl TraceFile {
    /// Starts a trace in the format that the extension of `file` names.
    ///
    /// # Errors
    /// The extension is unknown, or the directory of `file` cannot be written to.
    pub fn create(file: &Path) -> Result<Self, InputError> {
        Self::create_noted(file, &[])
    }

    /// As [`TraceFile::create`], with lines of comment in front that say what it is.
    ///
    /// # Errors
    /// As [`TraceFile::create`].
    pub fn create_noted(file: &Path, notes: &[&str]) -> Result<Self, InputError> {
        let format = TraceFormat::of(file)?;
        let noted = WholeFile::create(file).and_then(|mut out| {
            for note in notes {
                match format {
                    TraceFormat::Csv => writeln!(out, "# {note}")?,
                    TraceFormat::Vcd => writeln!(out, "$comment {note} $end")?,
                }
            }
            TraceWriter::new(format, out)
        });
        Ok(Self(noted.map_err(|e| InputError::whole(file, e.to_string(), "a place that can be written to"))?))
    }

    /// Writes one point; see [`TraceWriter::write`].
    ///
    /// # Errors
    /// What the file system reports.
    #[inline]
    pub fn write(&mut self, point: TracePoint) -> io::Result<()> {
        self.0.write(point)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// What the file system reports; nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        self.0.finish()?.finish()
    }
}
/// Columns of a trace.
const COLUMNS: [&str; 3] = ["t_ns", "a", "b"];
/// Every time that a player adds to one of the trace is below it too.
const LATEST_PLAYED_NS: u64 = i64::MAX as u64;
const TIME: &str = "a time in whole ns, from 0 to 18446744073709551615";

const fn level(high: bool) -> u8 {
    b'0' + high as u8
}

fn csv_row<R: Read>(
    rows: &mut csv::Reader<R>,
    last: Option<TracePoint>,
) -> Result<Option<TracePoint>, InputError> {
    let Some(row) = rows.row()? else { return Ok(None) };
    let [t, a, b] = row.exactly(COLUMNS)?;
    let t_ns = t.number(TIME)?;
    let level = |cell: &csv::Cell<'_>| match cell.text() {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err(cell.finding("the level 0 or 1")),
    };
    let state = State::new(level(&a)?, level(&b)?);
    if let Some(last) = last {
        if t_ns <= last.t_ns {
            return Err(t.finding(format!("a time after the row before, {} ns", last.t_ns)));
        }
        if state == last.state {
            let found = format!("the state {},{} again", a.text(), b.text());
            return Err(a.said(found, "a change of a or b: one row per change"));
        }
    }
    Ok(Some(TracePoint { t_ns, state }))
}

/// A row without spaces or comment: the point and the row's length, or `None` for the careful reader to explain.
#[inline]
fn plain_row(row: &[u8; PLAIN_ROW]) -> Option<(TracePoint, usize)> {
    let (mut t_ns, mut at) = (0_u64, 0);
    // Eight digits at a time, then one by one; twenty digits may overflow and go the careful way.
    while at < 16
        && let Some(group) = eight_digits(row, at)
    {
        t_ns = t_ns * 100_000_000 + group;
        at += 8;
    }
    let mut digit = row[at].wrapping_sub(b'0');
    let first = at;
    while digit <= 9 {
        if at == 19 || at == first + 8 {
            return None;
        }
        t_ns = t_ns * 10 + u64::from(digit);
        at += 1;
        digit = row[at].wrapping_sub(b'0');
    }
    if at == 0 {
        return None;
    }
    let tail: [u8; 6] = *row[at..].first_chunk()?;
    let (a, b) = (tail[1] ^ b'0', tail[3] ^ b'0');
    let end = match (tail[4], tail[5]) {
        (b'\n', _) => 5,
        (b'\r', b'\n') => 6,
        _ => return None,
    };
    if tail[0] != b',' || tail[2] != b',' || (a | b) > 1 {
        return None;
    }
    Some((TracePoint { t_ns, state: State::from_bits(a | b << 1) }, at + end))
}

/// The number in eight ASCII digits, all at once; `None` when one of the bytes is no digit.
#[inline]
fn eight_digits(row: &[u8; PLAIN_ROW], at: usize) -> Option<u64> {
    const ZEROS: u64 = u64::from_ne_bytes([b'0'; 8]);
    let value = u64::from_le_bytes(*row.get(at..)?.first_chunk()?) ^ ZEROS;
    // A byte above 9 gets its high bit set by + 0x76, or had it set before.
    if (value.wrapping_add(0x7676_7676_7676_7676) | value) & 0x8080_8080_8080_8080 != 0 {
        return None;
    }
    let pairs = value.wrapping_mul(10).wrapping_add(value >> 8) & 0x00ff_00ff_00ff_00ff;
    let fours = pairs.wrapping_mul(100).wrapping_add(pairs >> 16) & 0x0000_ffff_0000_ffff;
    Some(fours.wrapping_mul(10_000).wrapping_add(fours >> 32) & 0xffff_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quickly(text: &str) -> Option<(TracePoint, usize)> {
        let mut row = [b'x'; PLAIN_ROW];
        row[..text.len()].copy_from_slice(text.as_bytes());
        plain_row(&row)
    }

    #[test]
    fn a_plain_row_of_any_length_is_read_in_one_go() {
        let mut t_ns = 0;
        for digits in 1..=19 {
            t_ns = t_ns * 10 + digits % 10;
            for state in (0..4).map(State::from_bits) {
                for end in ["\n", "\r\n"] {
                    let (a, b) = (u8::from(state.a()), u8::from(state.b()));
                    let text = format!("{t_ns},{a},{b}{end}");
                    assert_eq!(quickly(&text), Some((TracePoint { t_ns, state }, text.len())), "{text}");
                }
            }
        }
        assert_eq!(
            quickly("9999999999999999999,1,0\n").map(|(point, _)| point.t_ns),
            Some(9_999_999_999_999_999_999)
        );
    }

    #[test]
    fn what_is_no_plain_row_is_left_to_the_careful_reader() {
        for text in [
            ",0,1\n",
            "18446744073709551615,0,1\n",
            "12,2,0\n",
            "12,0,2\n",
            "12,2,3\n",
            "12,3,2\n",
            "12;0,1\n",
            "12,0;1\n",
            "12,0,1 \n",
            "12,0,1\rx",
            "12 ,0,1\n",
            " 12,0,1\n",
            "1234567a,0,1\n",
            "1234567/,0,1\n",
            "1234567:,0,1\n",
            "-1,0,1\n",
            "1.5,0,1\n",
            "12,0,1,0\n",
        ] {
            assert_eq!(quickly(text), None, "{text:?}");
        }
    }
}
