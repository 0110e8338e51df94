//! Recorded quadrature: traces as CSV (`t_ns,a,b`) and VCD (IEEE 1364), and the CSV of requested totals.
//!
//! Readers stream: memory stays flat for a file of any length. A trace has one row per change and strictly rising
//! times; a row in which both signals change is passed on, because an illegal transition is the engine's to report.

use crate::input::InputError;
use crate::quadrature::State;
use std::fs::File;
use std::io::{self, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Bytes held of the input; also the longest line or VCD word that is read.
const BUFFER: usize = 128 * 1024;
/// Longest plain row, `18446744073709551615,1,1\r\n`, rounded up.
const PLAIN_ROW: usize = 32;

/// The state that the two signals take at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TracePoint {
    /// Time of the change in ns; in the first point the time from which the initial state is known.
    pub t_ns: u64,
    /// The levels from this time on.
    pub state: State,
}

/// A requested total and the time at which it is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Time in ns.
    pub t_ns: u64,
    /// Requested total in counts since homing.
    pub requested: i64,
}

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
    source: Source<R>,
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
        Self::new(format, file, open(file)?)
    }
}

impl<R: Read> TraceReader<R> {
    /// Reads a trace from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(format: TraceFormat, file: &Path, input: R) -> Result<Self, InputError> {
        let mut source = Source::new(file, input)?;
        let vcd = match format {
            TraceFormat::Csv => {
                source.header(["t_ns", "a", "b"])?;
                None
            }
            TraceFormat::Vcd => Some(Vcd::definitions(&mut source)?),
        };
        Ok(Self { source, last: None, vcd, done: false })
    }

    /// The next point, or `None` at the end.
    ///
    /// # Errors
    /// The first row that is not as the format wants it.
    #[inline]
    pub fn next_point(&mut self) -> Result<Option<TracePoint>, InputError> {
        if self.vcd.is_none()
            && let Some(last) = self.last
            && let Some(row) = self.source.ahead::<PLAIN_ROW>()
            && let Some((point, length)) = plain_row(row)
            && point.t_ns > last.t_ns
            && point.state != last.state
        {
            self.source.start += length;
            self.source.line += 1;
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
            Some(vcd) => vcd.next(&mut self.source, self.last),
            None => csv_row(&mut self.source, self.last),
        };
        match next {
            Ok(Some(point)) => {
                self.last = Some(point);
                Ok(Some(point))
            }
            Ok(None) if self.last.is_none() => {
                self.done = true;
                Err(InputError::whole(
                    &self.source.file,
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

impl<R: Read> Iterator for TraceReader<R> {
    type Item = Result<TracePoint, InputError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        self.next_point().transpose()
    }
}

/// Reads requested totals (`t_ns,requested`), times never falling; after an error it yields nothing more.
#[derive(Debug)]
pub struct RequestReader<R> {
    source: Source<R>,
    last_ns: u64,
    done: bool,
}

impl RequestReader<File> {
    /// Opens a file of requests.
    ///
    /// # Errors
    /// The file cannot be read or its header is wrong.
    pub fn open(file: &Path) -> Result<Self, InputError> {
        Self::new(file, open(file)?)
    }
}

impl<R: Read> RequestReader<R> {
    /// Reads requests from `input`; `file` is its name in error messages.
    ///
    /// # Errors
    /// The header is missing or wrong.
    pub fn new(file: &Path, input: R) -> Result<Self, InputError> {
        let mut source = Source::new(file, input)?;
        source.header(["t_ns", "requested"])?;
        Ok(Self { source, last_ns: 0, done: false })
    }

    fn row(&mut self) -> Result<Option<Request>, InputError> {
        let Some(range) = self.source.row()? else { return Ok(None) };
        let finding = match split(&self.source.buffer[range], ["t_ns", "requested"]) {
            Ok([t, requested]) => time(t).and_then(|t_ns| {
                if t_ns < self.last_ns {
                    let expected = format!("a time not before the last one, {} ns", self.last_ns);
                    return Err(t.finding(&expected));
                }
                let requested = requested.number("a whole number of counts")?;
                Ok(Request { t_ns, requested })
            }),
            Err(finding) => Err(finding),
        };
        let request = finding.map_err(|f| self.source.error(f))?;
        self.last_ns = request.t_ns;
        Ok(Some(request))
    }
}

impl<R: Read> Iterator for RequestReader<R> {
    type Item = Result<Request, InputError>;

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
pub struct TraceFile {
    writer: TraceWriter<tempfile::NamedTempFile>,
    file: PathBuf,
}

impl TraceFile {
    /// Starts a trace in the format that the extension of `file` names.
    ///
    /// # Errors
    /// The extension is unknown, or the directory of `file` cannot be written to.
    pub fn create(file: &Path) -> Result<Self, InputError> {
        let format = TraceFormat::of(file)?;
        let unwritable =
            |e: io::Error| InputError::whole(file, e.to_string(), "a place that can be written to");
        let directory = file.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666)); // less the umask, as any file
        let temporary = builder.prefix(".rtec-trace-").tempfile_in(directory).map_err(unwritable)?;
        let writer = TraceWriter::new(format, temporary).map_err(unwritable)?;
        Ok(Self { writer, file: file.to_owned() })
    }

    /// Writes one point; see [`TraceWriter::write`].
    ///
    /// # Errors
    /// What the file system reports.
    #[inline]
    pub fn write(&mut self, point: TracePoint) -> io::Result<()> {
        self.writer.write(point)
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// What the file system reports; nothing is left behind then.
    pub fn finish(self) -> io::Result<()> {
        self.writer.finish()?.persist(&self.file).map_err(|e| e.error)?;
        Ok(())
    }
}

const fn level(high: bool) -> u8 {
    b'0' + high as u8
}

fn open(file: &Path) -> Result<File, InputError> {
    File::open(file).map_err(|e| InputError::whole(file, e.to_string(), "a file that can be read"))
}

/// What is wrong at a column of the present line, from 1.
#[derive(Debug)]
struct Finding {
    column: usize,
    found: String,
    expected: String,
}

/// Buffered input that knows its line.
#[derive(Debug)]
struct Source<R> {
    file: PathBuf,
    input: R,
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    exhausted: bool,
    /// Lines taken so far: the number of the present line, from 1.
    line: usize,
    /// Characters of the present line that are in the buffer no more.
    gone: usize,
}

impl<R: Read> Source<R> {
    fn new(file: &Path, input: R) -> Result<Self, InputError> {
        let buffer = vec![0; BUFFER].into_boxed_slice();
        let mut source = Self {
            file: file.to_owned(),
            input,
            buffer,
            start: 0,
            end: 0,
            exhausted: false,
            line: 0,
            gone: 0,
        };
        while source.end < 3 && source.fill()? {}
        if source.buffer[..source.end].starts_with(b"\xEF\xBB\xBF") {
            source.buffer.copy_within(3..source.end, 0);
            source.end -= 3;
        }
        Ok(source)
    }

    fn error(&self, finding: Finding) -> InputError {
        InputError::at(&self.file, self.line, finding.column, finding.found, finding.expected)
    }

    /// The next `N` bytes where the buffer holds them.
    #[inline]
    fn ahead<const N: usize>(&self) -> Option<&[u8; N]> {
        self.buffer[..self.end].get(self.start..)?.first_chunk()
    }

    /// Reads on; `false` at the end of the input.
    fn fill(&mut self) -> Result<bool, InputError> {
        if self.exhausted {
            return Ok(false);
        }
        let read = &self.buffer[..self.start];
        let newline = read.iter().rposition(|&byte| byte == b'\n');
        let tail = String::from_utf8_lossy(&read[newline.map_or(0, |at| at + 1)..]).chars().count();
        self.gone = if newline.is_some() { tail } else { self.gone + tail };
        self.buffer.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        if self.end == self.buffer.len() {
            let found = format!("{BUFFER} bytes without an end of line");
            return Err(InputError::at(&self.file, self.line + 1, 0, found, "a text file of short lines"));
        }
        let read = loop {
            match self.input.read(&mut self.buffer[self.end..]) {
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                other => break other,
            }
        };
        let read = read.map_err(|e| {
            InputError::at(&self.file, self.line + 1, 0, e.to_string(), "a file that can be read")
        })?;
        self.end += read;
        self.exhausted = read == 0;
        Ok(read > 0)
    }

    /// The next line without its end, as a range of the buffer.
    fn line(&mut self) -> Result<Option<Range<usize>>, InputError> {
        let mut searched = 0;
        let length = loop {
            let unread = &self.buffer[self.start..self.end];
            if let Some(at) = unread[searched..].iter().position(|&byte| byte == b'\n') {
                break searched + at;
            }
            searched = unread.len();
            if !self.fill()? {
                break searched;
            }
        };
        if length == 0 && self.start == self.end {
            return Ok(None);
        }
        let range = self.start..self.start + length;
        self.start = (range.end + 1).min(self.end);
        self.line += 1;
        Ok(Some(range))
    }

    /// The next line that is neither blank nor a comment only, without its comment.
    fn row(&mut self) -> Result<Option<Range<usize>>, InputError> {
        while let Some(range) = self.line()? {
            let text = &self.buffer[range.clone()];
            let text = &text[..text.iter().position(|&byte| byte == b'#').unwrap_or(text.len())];
            if !text.trim_ascii().is_empty() {
                return Ok(Some(range.start..range.start + text.trim_ascii_end().len()));
            }
        }
        Ok(None)
    }

    fn header<const N: usize>(&mut self, names: [&str; N]) -> Result<(), InputError> {
        let expected = format!("the header {}", names.join(","));
        let Some(range) = self.row()? else {
            return Err(InputError::whole(&self.file, "no header", expected));
        };
        let text = String::from_utf8_lossy(&self.buffer[range]).into_owned();
        if text.split(',').map(str::trim).eq(names) {
            return Ok(());
        }
        Err(self.error(Finding { column: 1, found: quoted(&text), expected }))
    }

    /// The next word between white space, as a range of the buffer.
    fn word(&mut self) -> Result<Option<Range<usize>>, InputError> {
        loop {
            let Some(&byte) = self.buffer[..self.end].get(self.start) else {
                if self.fill()? {
                    continue;
                }
                return Ok(None);
            };
            if !byte.is_ascii_whitespace() {
                break;
            }
            self.line += usize::from(byte == b'\n');
            self.start += 1;
        }
        let mut searched = 0;
        let length = loop {
            let unread = &self.buffer[self.start..self.end];
            if let Some(at) = unread[searched..].iter().position(u8::is_ascii_whitespace) {
                break searched + at;
            }
            searched = unread.len();
            if !self.fill()? {
                break searched;
            }
        };
        let range = self.start..self.start + length;
        self.start = range.end;
        Ok(Some(range))
    }
}

/// A field of a row, with its column.
#[derive(Debug, Clone, Copy)]
struct Field<'a> {
    text: &'a str,
    column: usize,
}

impl Field<'_> {
    fn finding(self, expected: &str) -> Finding {
        let found = if self.text.is_empty() { "nothing".to_owned() } else { quoted(self.text) };
        Finding { column: self.column, found, expected: expected.to_owned() }
    }

    fn number<T: std::str::FromStr>(self, expected: &str) -> Result<T, Finding> {
        self.text.parse().map_err(|_| self.finding(expected))
    }
}

/// Text as an error message shows it: quoted, cut where it is long.
fn quoted(text: &str) -> String {
    if text.chars().count() <= 60 {
        return format!("'{text}'");
    }
    format!("'{}…'", text.chars().take(60).collect::<String>())
}

fn split<'a, const N: usize>(row: &'a [u8], names: [&str; N]) -> Result<[Field<'a>; N], Finding> {
    let row = std::str::from_utf8(row).map_err(|e| Finding {
        column: String::from_utf8_lossy(&row[..e.valid_up_to()]).chars().count() + 1,
        found: format!("byte 0x{:02x}", row[e.valid_up_to()]),
        expected: "text in UTF-8".to_owned(),
    })?;
    let mut fields = [Field { text: "", column: 0 }; N];
    let (mut n, mut column) = (0, 1);
    for text in row.split(',') {
        let indent = text.chars().take_while(char::is_ascii_whitespace).count();
        let field = Field { text: text.trim_ascii(), column: column + indent };
        let Some(place) = fields.get_mut(n) else {
            return Err(field.finding(&format!("the end of the row after {}", names.join(","))));
        };
        *place = field;
        n += 1;
        column += text.chars().count() + 1;
    }
    if n < N {
        let (found, expected) =
            (format!("the end of the row after {n} of {N} fields"), format!("the field {}", names[n]));
        return Err(Finding { column: column - 1, found, expected });
    }
    Ok(fields)
}

fn time(field: Field<'_>) -> Result<u64, Finding> {
    field.number("a time in whole ns, from 0 to 18446744073709551615")
}

fn csv_row<R: Read>(
    source: &mut Source<R>,
    last: Option<TracePoint>,
) -> Result<Option<TracePoint>, InputError> {
    let Some(range) = source.row()? else { return Ok(None) };
    let row = split(&source.buffer[range], ["t_ns", "a", "b"]).and_then(|[t, a, b]| {
        let t_ns = time(t)?;
        let level = |field: Field<'_>| match field.text {
            "0" => Ok(false),
            "1" => Ok(true),
            _ => Err(field.finding("the level 0 or 1")),
        };
        let state = State::new(level(a)?, level(b)?);
        if let Some(last) = last {
            if t_ns <= last.t_ns {
                return Err(t.finding(&format!("a time after the row before, {} ns", last.t_ns)));
            }
            if state == last.state {
                let found = format!("the state {},{} again", a.text, b.text);
                let expected = "a change of a or b: one row per change".to_owned();
                return Err(Finding { column: a.column, found, expected });
            }
        }
        Ok(TracePoint { t_ns, state })
    });
    row.map(Some).map_err(|f| source.error(f))
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

/// What the definitions of a VCD say, and where in its changes we are.
#[derive(Debug)]
struct Vcd {
    /// ns per time unit as a fraction: 1 µs is (1000, 1), 100 ps is (1, 10).
    ns_per_unit: (u64, u64),
    /// Identifier codes of a and b.
    codes: [Vec<u8>; 2],
    /// Present time in units.
    now: u64,
    levels: [Option<bool>; 2],
    /// A level was written since `now`.
    touched: bool,
}

impl Vcd {
    fn definitions<R: Read>(source: &mut Source<R>) -> Result<Self, InputError> {
        source.line = 1;
        let (mut ns_per_unit, mut codes) = (None, [None, None]);
        loop {
            let Some(keyword) = word(source)? else {
                return Err(here(source, "the end of the file", "$enddefinitions"));
            };
            match keyword.as_str() {
                "$enddefinitions" => {
                    skip_to_end(source)?;
                    break;
                }
                "$timescale" => {
                    let text = until_end(source)?.concat();
                    ns_per_unit = Some(timescale(source, &text)?);
                }
                "$var" => {
                    let body = until_end(source)?;
                    variable(source, &body, &mut codes)?;
                }
                "$comment" | "$date" | "$version" | "$scope" | "$upscope" => skip_to_end(source)?,
                other => {
                    let expected = "a VCD definition: $timescale, $scope, $var, $upscope, $enddefinitions";
                    return Err(here(source, &quoted(other), expected));
                }
            }
        }
        let Some(ns_per_unit) = ns_per_unit else {
            return Err(here(source, "no $timescale", "for example $timescale 1 ns $end"));
        };
        let [Some(a), Some(b)] = codes else {
            let missing = if codes[0].is_none() { "a" } else { "b" };
            let expected = "two variables of one bit named a and b";
            return Err(here(source, &format!("no variable named {missing}"), expected));
        };
        Ok(Self { ns_per_unit, codes: [a, b], now: 0, levels: [None; 2], touched: false })
    }

    /// Reads to the end of the next time step in which a or b changed.
    fn next<R: Read>(
        &mut self,
        source: &mut Source<R>,
        last: Option<TracePoint>,
    ) -> Result<Option<TracePoint>, InputError> {
        loop {
            let Some(range) = source.word()? else { return self.step(source, last) };
            let word = &source.buffer[range];
            match word[0] {
                b'#' => {
                    let text = std::str::from_utf8(&word[1..]).unwrap_or_default();
                    let Ok(time) = text.parse::<u64>() else {
                        let found = quoted(&String::from_utf8_lossy(word));
                        return Err(here(source, &found, "a time in whole units, as #1000"));
                    };
                    if time < self.now {
                        let expected = format!("a time not before #{}", self.now);
                        return Err(here(source, &format!("#{time}"), &expected));
                    }
                    let step = if time > self.now { self.step(source, last)? } else { None };
                    self.now = time;
                    if step.is_some() {
                        return Ok(step);
                    }
                }
                value @ (b'0' | b'1' | b'x' | b'X' | b'z' | b'Z') => {
                    if let Some(signal) = self.codes.iter().position(|code| *code == word[1..]) {
                        self.set(source, signal, value)?;
                    }
                }
                // A vector of one bit is written `b1 !`; only its last bit counts.
                b'b' | b'B' | b'r' | b'R' | b's' | b'S' => {
                    let (kind, value) = (word[0], word[word.len() - 1]);
                    let Some(code) = source.word()? else {
                        return Err(here(source, "the end of the file", "the identifier of a value"));
                    };
                    let signal = self.codes.iter().position(|own| *own == source.buffer[code.clone()]);
                    if let Some(signal) = signal {
                        if !kind.eq_ignore_ascii_case(&b'b') {
                            let expected = "a level 0 or 1 of a and b";
                            return Err(here(source, "a real number or a string", expected));
                        }
                        self.set(source, signal, value)?;
                    }
                }
                b'$' => match word {
                    b"$comment" => skip_to_end(source)?,
                    b"$dumpvars" | b"$dumpall" | b"$dumpon" | b"$dumpoff" | b"$end" => {}
                    _ => {
                        let found = quoted(&String::from_utf8_lossy(word));
                        return Err(here(
                            source,
                            &found,
                            "$dumpvars, $dumpall, $dumpon, $dumpoff or $comment",
                        ));
                    }
                },
                _ => {
                    let found = quoted(&String::from_utf8_lossy(word));
                    return Err(here(source, &found, "a time (#1000) or a value change (1!)"));
                }
            }
        }
    }

    fn set<R: Read>(&mut self, source: &Source<R>, signal: usize, value: u8) -> Result<(), InputError> {
        self.levels[signal] = match value {
            b'0' => Some(false),
            b'1' => Some(true),
            other => {
                let found = format!("{} for signal {}", char::from(other), ["a", "b"][signal]);
                return Err(here(
                    source,
                    &found,
                    "the level 0 or 1: unknown and open lines cannot be counted",
                ));
            }
        };
        self.touched = true;
        Ok(())
    }

    /// The point that the present time step makes, if a or b changed in it.
    fn step<R: Read>(
        &mut self,
        source: &Source<R>,
        last: Option<TracePoint>,
    ) -> Result<Option<TracePoint>, InputError> {
        if !std::mem::take(&mut self.touched) {
            return Ok(None);
        }
        let [Some(a), Some(b)] = self.levels else {
            let missing = if self.levels[0].is_none() { "a" } else { "b" };
            let found = format!("no value of {missing} at #{}", self.now);
            return Err(here(source, &found, "a value of a and b at the first change of either"));
        };
        let state = State::new(a, b);
        let Some(scaled) = self.now.checked_mul(self.ns_per_unit.0) else {
            return Err(here(source, &format!("#{}", self.now), "a time below 18446744073709551616 ns"));
        };
        let t_ns = scaled / self.ns_per_unit.1;
        match last {
            Some(last) if last.state == state => Ok(None),
            Some(last) if last.t_ns >= t_ns => {
                let found = format!("two changes within the nanosecond {t_ns}");
                Err(here(source, &found, "changes at least 1 ns apart"))
            }
            _ => Ok(Some(TracePoint { t_ns, state })),
        }
    }
}

/// An error at the word that was just read. VCD has no lines of its own: the line number says where to look.
fn here<R>(source: &Source<R>, found: &str, expected: &str) -> InputError {
    let before = &source.buffer[..source.start];
    let newline = before.iter().rposition(|&byte| byte == b'\n');
    let line_start = newline.map_or(0, |at| at + 1);
    let word_start = before.iter().rposition(u8::is_ascii_whitespace).map_or(0, |at| at + 1);
    let gone = if newline.is_some() { 0 } else { source.gone };
    let column = gone + String::from_utf8_lossy(&before[line_start..word_start]).chars().count() + 1;
    InputError::at(&source.file, source.line, column, found, expected)
}

fn word<R: Read>(source: &mut Source<R>) -> Result<Option<String>, InputError> {
    Ok(source.word()?.map(|range| String::from_utf8_lossy(&source.buffer[range]).into_owned()))
}

/// The words up to `$end`.
fn until_end<R: Read>(source: &mut Source<R>) -> Result<Vec<String>, InputError> {
    let mut words = Vec::new();
    while let Some(word) = word(source)? {
        if word == "$end" {
            return Ok(words);
        }
        if words.len() > 16 {
            break;
        }
        words.push(word);
    }
    Err(here(source, "no $end", "$end after a definition"))
}

/// Free text, of any length, up to `$end`.
fn skip_to_end<R: Read>(source: &mut Source<R>) -> Result<(), InputError> {
    while let Some(range) = source.word()? {
        if source.buffer[range] == *b"$end" {
            return Ok(());
        }
    }
    Err(here(source, "the end of the file", "$end"))
}

fn timescale<R>(source: &Source<R>, text: &str) -> Result<(u64, u64), InputError> {
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (magnitude, unit) = text.split_at(digits);
    let magnitude = match magnitude {
        "1" => 1,
        "10" => 10,
        "100" => 100,
        _ => 0,
    };
    let (mul, div) = match unit {
        "s" => (1_000_000_000, 1),
        "ms" => (1_000_000, 1),
        "us" => (1_000, 1),
        "ns" => (1, 1),
        "ps" => (1, 1_000),
        "fs" => (1, 1_000_000),
        _ => (0, 1),
    };
    if magnitude * mul == 0 {
        return Err(here(source, &quoted(text), "1, 10 or 100 of s, ms, us, ns, ps or fs"));
    }
    Ok((magnitude * mul, div))
}

/// Takes the identifier of a or b out of a `$var TYPE SIZE CODE NAME [RANGE] $end`.
fn variable<R>(
    source: &Source<R>,
    body: &[String],
    codes: &mut [Option<Vec<u8>>; 2],
) -> Result<(), InputError> {
    let [_kind, size, code, name, ..] = body else {
        return Err(here(source, &quoted(&body.join(" ")), "$var TYPE SIZE CODE NAME $end"));
    };
    let signal = match name.as_str() {
        "a" | "A" => 0,
        "b" | "B" => 1,
        _ => return Ok(()),
    };
    if size != "1" {
        return Err(here(source, &format!("{name} of {size} bits"), "one bit"));
    }
    let code = code.as_bytes().to_vec();
    if codes[signal].as_ref().is_some_and(|known| *known != code) {
        return Err(here(
            source,
            &format!("a second variable named {name}"),
            "one a and one b in all scopes",
        ));
    }
    codes[signal] = Some(code);
    Ok(())
}
