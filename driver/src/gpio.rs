//! GPIO lines through the Linux character device (uapi v2).
//!
//! Inputs are requested either as edges or as levels. *Edges*: the kernel stamps each edge in its interrupt and
//! queues it. The thread sleeps until one comes. A, B and the read-back of an axis share one request. The kernel then
//! numbers their edges together, and a merged pair shows as a gap. *Levels*: each look reads a chip's lines in one
//! call, and the thread never sleeps.
//!
//! Outputs are one request per chip. The request changes no level. An output keeps its level, and any other line
//! becomes an output at the level it is read at. Another process may keep the request's descriptor
//! ([`GpioCard::kept`]) and give it to the next daemon ([`GpioCard::open`]). When the last descriptor is closed, the
//! lines may fall.

use crate::card::{Card, CardError, CardFault, CardFaultKind, CardInputSample};
use crate::clock::Clock;
use gpiocdev::Chip;
pub use gpiocdev::line::{Bias, Drive};
use gpiocdev_uapi::v2::{
    LineConfig, LineEdgeEvent, LineFlags, LineRequest, LineValues, Offsets, get_line, get_line_values,
    set_line_config, set_line_values,
};
use gpiocdev_uapi::{Error as UapiError, Name};
use std::collections::BTreeSet;
use std::fmt;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::path::PathBuf;

/// Name under which `gpioinfo` shows this program as a line's consumer.
const CONSUMER: &str = "rtec";
/// Edges that the kernel may hold for us, per request: its maximum.
/// A stall then costs late insertions, not counts.
const KERNEL_QUEUE: u32 = 1024;
/// Edges taken from the kernel at once.
const BATCH: usize = 64;
/// Words of one edge.
const EDGE_WORDS: usize = size_of::<LineEdgeEvent>() / 8;
/// A line that differs from its edges for this long has lost one, ns.
/// The request must have had no edge meanwhile. Before that, the edge may still be on its way through the interrupt's
/// thread.
const MISSED_AFTER_NS: u64 = 20_000_000;
/// The thread yields for this long while an edge is on its way, ns.
/// The interrupt's thread may need this CPU.
const GIVE_WAY_NS: u64 = 50_000;

/// A line as a person names it: by its name or its number on a chip.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum GpioLineId {
    /// The name that firmware or device tree gives it.
    Name(String),
    /// Its offset on the chip.
    Offset(u32),
}

impl fmt::Display for GpioLineId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => write!(f, "\"{name}\""),
            Self::Offset(offset) => write!(f, "{offset}"),
        }
    }
}

/// One line and how it is to be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GpioLineSettings {
    /// The chip: `gpiochip0`, a path, or its label.
    /// `None` looks for the line's name on every chip.
    pub chip: Option<String>,
    /// The line on its chip, by name or offset.
    pub line: GpioLineId,
    /// Active is low.
    pub active_low: bool,
    /// Bias; `None` leaves it as it is.
    pub bias: Option<Bias>,
    /// Drive, of an output; `None` is push-pull.
    pub drive: Option<Drive>,
}

/// An input line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GpioInputConfig {
    /// The line, and how it is requested.
    pub line: GpioLineSettings,
    /// Its bit in the input word.
    pub bit: u8,
    /// Lines of the same group are one request: their edges are numbered together.
    pub group: u8,
    /// Its edges count; without, only its level is read.
    pub edges: bool,
}

/// An output line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GpioOutputConfig {
    /// The line, and how it is requested.
    pub line: GpioLineSettings,
    /// Its bit in the output word.
    pub bit: u8,
}

/// All lines of a card.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GpioCardConfig {
    /// Every input that the profile of the axes and the machine needs.
    pub inputs: Vec<GpioInputConfig>,
    /// Every output, inverters and feed hold.
    pub outputs: Vec<GpioOutputConfig>,
    /// Sleeps until an edge comes; otherwise levels are read as fast as possible.
    pub events: bool,
}

/// Reason why lines could not be requested.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum GpioError {
    #[error("GPIO chip {chip}: {source}; found {found}")]
    Chip { chip: String, source: io::Error, found: String },
    #[error("there is no line {line} on {place}; `rtecctl card probe` lists what is there")]
    NoLine { place: String, line: GpioLineId },
    #[error("line {line} is on {first} and on {second}: name the chip too")]
    Ambiguous { line: GpioLineId, first: String, second: String },
    #[error("line {line} of {chip} is taken by \"{consumer}\": free it there, or use another line")]
    Taken { chip: String, line: GpioLineId, consumer: String },
    #[error(
        "line {line} is on {chip}, the others of its axis are on {other}: A, B and their read-back need one chip"
    )]
    Apart { line: GpioLineId, chip: String, other: String },
    #[error(
        "the kept line request holds {found}, the configuration wants {wanted}: start with the configuration it was \
         made for, or switch the MTC off and remove it from the service manager's store"
    )]
    Kept { found: String, wanted: String },
    #[error("{op} {chip}: {source}")]
    Io { op: &'static str, chip: String, source: io::Error },
}

/// A line found: its chip and offset.
#[derive(Debug, Clone)]
struct LocatedLine {
    chip: PathBuf,
    offset: u32,
}

fn path_of(chip: &Chip) -> String {
    chip.path().display().to_string()
}

fn errno_of(error: &UapiError) -> i32 {
    match error {
        UapiError::Os(errno) => errno.0,
        UapiError::UnderRead(_) => libc::EIO,
    }
}

fn io_of(error: &gpiocdev::Error) -> io::Error {
    match error {
        gpiocdev::Error::Os(errno) | gpiocdev::Error::Uapi(_, UapiError::Os(errno)) => {
            io::Error::from_raw_os_error(errno.0)
        }
        other => io::Error::other(other.to_string()),
    }
}

/// Opens a chip by path, by name as `gpiochip0`, or by label.
fn open_chip(named: &str) -> Result<Chip, GpioError> {
    let opened = if named.contains('/') { Chip::from_path(named) } else { Chip::from_name(named) };
    opened.or_else(|error| {
        let all = gpiocdev::chip::chips().unwrap_or_default();
        let mut labels = Vec::new();
        for chip in all.iter().filter_map(|path| Chip::from_path(path).ok()) {
            let label = chip.info().map_or_else(|_| "?".to_owned(), |info| info.label);
            if label == named {
                return Ok(chip);
            }
            labels.push(format!("{} \"{label}\"", chip.name()));
        }
        let found =
            if labels.is_empty() { "no chip that can be opened".to_owned() } else { labels.join(", ") };
        Err(GpioError::Chip { chip: named.to_owned(), source: io_of(&error), found })
    })
}

/// The chips that the lines are on, as `gpiochip0`.
///
/// # Errors
/// When a line is not found, or a chip may not be opened.
pub fn chip_names(setup: &GpioCardConfig) -> Result<BTreeSet<String>, GpioError> {
    let lines = setup.inputs.iter().map(|i| &i.line).chain(setup.outputs.iter().map(|o| &o.line));
    lines
        .map(|line| {
            let chip = find(line)?.chip;
            Ok(chip.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()))
        })
        .collect()
}

fn find(line: &GpioLineSettings) -> Result<LocatedLine, GpioError> {
    let chips = if let Some(chip) = &line.chip {
        vec![open_chip(chip)?]
    } else {
        let all = gpiocdev::chip::chips().unwrap_or_default();
        all.iter().filter_map(|path| Chip::from_path(path).ok()).collect()
    };
    let mut found: Option<LocatedLine> = None;
    for chip in &chips {
        let offset = match &line.line {
            GpioLineId::Offset(offset) => {
                let lines = chip.info().map_or(0, |info| info.num_lines);
                (*offset < lines).then_some(*offset)
            }
            GpioLineId::Name(name) => chip.find_line_info(name).map(|info| info.offset),
        };
        let Some(offset) = offset else { continue };
        if let Some(first) = &found {
            return Err(GpioError::Ambiguous {
                line: line.line.clone(),
                first: first.chip.display().to_string(),
                second: path_of(chip),
            });
        }
        found = Some(LocatedLine { chip: chip.path().to_owned(), offset });
    }
    let place = || chips.first().filter(|_| line.chip.is_some()).map_or("any chip".to_owned(), path_of);
    found.ok_or_else(|| GpioError::NoLine { place: place(), line: line.line.clone() })
}

/// The chips that can be opened: name, label, number of lines.
pub fn chips() -> Vec<(String, String, u32)> {
    let all = gpiocdev::chip::chips().unwrap_or_default();
    let chips = all.iter().filter_map(|path| Chip::from_path(path).ok());
    chips.filter_map(|chip| chip.info().ok().map(|info| (info.name, info.label, info.num_lines))).collect()
}

/// Describes a line as the kernel reports it: place, direction, holder.
/// Requests nothing.
///
/// # Errors
/// When it is not there.
pub fn look(line: &GpioLineSettings) -> Result<String, GpioError> {
    let found = find(line)?;
    let chip = open_chip(&found.chip.display().to_string())?;
    let info = chip.line_info(found.offset).map_err(|e| GpioError::Io {
        op: "reading line information of",
        chip: path_of(&chip),
        source: io_of(&e),
    })?;
    let way = if info.direction == gpiocdev::line::Direction::Output { "an output" } else { "an input" };
    let holder = match (info.used, info.consumer.as_str()) {
        (false, _) => "free".to_owned(),
        (true, "") => "taken by the kernel".to_owned(),
        (true, consumer) => format!("taken by \"{consumer}\""),
    };
    Ok(format!("{} line {} \"{}\", {way} now, {holder}", chip.name(), info.offset, info.name))
}

fn flags(line: &GpioLineSettings, output: bool, edges: bool) -> LineFlags {
    let mut flags = if output { LineFlags::OUTPUT } else { LineFlags::INPUT };
    flags.set(LineFlags::ACTIVE_LOW, line.active_low);
    flags.set(LineFlags::EDGE_RISING | LineFlags::EDGE_FALLING, edges);
    flags |= match line.bias {
        None => LineFlags::empty(),
        Some(Bias::PullUp) => LineFlags::BIAS_PULL_UP,
        Some(Bias::PullDown) => LineFlags::BIAS_PULL_DOWN,
        Some(Bias::Disabled) => LineFlags::BIAS_DISABLED,
    };
    match line.drive {
        Some(Drive::OpenDrain) if output => flags | LineFlags::OPEN_DRAIN,
        Some(Drive::OpenSource) if output => flags | LineFlags::OPEN_SOURCE,
        _ => flags,
    }
}

/// The configuration of a request's lines.
/// It sets the first line's flags for all, then grouped exceptions, then output levels. The kernel takes ten
/// exceptions. Two polarities, three biases and three drives need fewer on any real machine.
fn line_config(flags: &[LineFlags], levels: Option<u64>) -> LineConfig {
    let mut config = LineConfig { flags: flags[0], ..LineConfig::default() };
    let mut others: Vec<(LineFlags, u64)> = Vec::new();
    for (n, f) in flags.iter().enumerate().filter(|(_, f)| **f != flags[0]) {
        match others.iter_mut().find(|(known, _)| known == f) {
            Some((_, mask)) => *mask |= 1 << n,
            None => others.push((*f, 1 << n)),
        }
    }
    for (f, mask) in others {
        config.add_flags(f, mask);
    }
    if let Some(bits) = levels {
        config.add_values(&LineValues { bits, mask: all(flags.len()) });
    }
    config
}

/// A mask of `n` ones.
const fn all(n: usize) -> u64 {
    if n >= 64 { u64::MAX } else { (1 << n) - 1 }
}

/// Requests lines of one chip.
/// If another process holds a line, the error names its holder.
fn request(
    chip: &Chip,
    offsets: &[u32],
    names: &[GpioLineId],
    config: LineConfig,
) -> Result<File, GpioError> {
    let io = |op, source| GpioError::Io { op, chip: path_of(chip), source };
    for (offset, name) in offsets.iter().zip(names) {
        let info = chip.line_info(*offset).map_err(|e| io("reading line information of", io_of(&e)))?;
        if info.used {
            return Err(GpioError::Taken {
                chip: path_of(chip),
                line: name.clone(),
                consumer: if info.consumer.is_empty() { "the kernel".to_owned() } else { info.consumer },
            });
        }
    }
    let file = File::options().read(true).write(true).open(chip.path()).map_err(|e| io("opening", e))?;
    let wanted = LineRequest {
        offsets: Offsets::from_slice(offsets),
        consumer: Name::from_bytes(CONSUMER.as_bytes()),
        config,
        num_lines: offsets.len() as u32,
        event_buffer_size: KERNEL_QUEUE,
        ..LineRequest::default()
    };
    get_line(&file, wanted).map_err(|e| io("requesting lines of", io::Error::from_raw_os_error(errno_of(&e))))
}

fn read_levels(file: &File, lines: usize) -> Result<u64, CardError> {
    let mut values = LineValues { bits: 0, mask: all(lines) };
    match get_line_values(file, &mut values) {
        Ok(()) => Ok(values.bits),
        Err(e) => Err(CardError::Io { op: "reading GPIO lines", errno: errno_of(&e) }),
    }
}

/// Numbers of the latest edges, as the kernel counts them; a gap is a lost edge.
#[derive(Debug, Clone, PartialEq, Eq)]
struct EdgeSequenceNumbers {
    /// Edges of the request so far.
    /// The kernel counts them in its interrupt, so that a merged one leaves a gap.
    all: u32,
    /// Edges of each line so far, as numbered in the queue.
    /// An edge dropped from the queue leaves a gap.
    line: Box<[u32]>,
}

impl EdgeSequenceNumbers {
    /// Takes the numbers of an edge of line `n`; returns what a gap before it means.
    fn next(&mut self, n: usize, all: u32, line: u32) -> Option<CardFaultKind> {
        let merged = all != self.all.wrapping_add(1);
        let dropped = line != self.line[n].wrapping_add(1);
        self.all = all;
        self.line[n] = line;
        if dropped {
            Some(CardFaultKind::QueueOverflow)
        } else if merged {
            Some(CardFaultKind::SequenceGap)
        } else {
            None
        }
    }
}

/// One input request.
#[derive(Debug)]
struct InputLineRequest {
    chip: String,
    file: File,
    /// Offset and bit of each line, in the request's order.
    lines: Box<[(u32, u8)]>,
    /// Bits of the input word that are ours.
    mask: u64,
    /// Bits whose edges are queued.
    edges: u64,
    /// Those of `edges` whose level an edge has already set.
    /// The next edge of such a line must change its level.
    known: u64,
    numbering: EdgeSequenceNumbers,
    /// Edges read from the kernel: `queued` of them, of which `shown` are shown.
    queue: Box<[u64]>,
    queued: usize,
    shown: usize,
    /// The last batch filled the queue: the kernel may hold more.
    more: bool,
    /// Lines whose levels differ from their edges, and since when, ns.
    differs: Option<(u64, u64)>,
}

impl InputLineRequest {
    /// The lines' levels in the input word.
    fn levels(&self) -> Result<u64, CardError> {
        let bits = read_levels(&self.file, self.lines.len())?;
        Ok(self.lines.iter().enumerate().fold(0, |word, (n, (_, bit))| word | (bits >> n & 1) << bit))
    }

    /// The next queued edge, not yet taken.
    fn head(&self) -> Option<&LineEdgeEvent> {
        let words = self.queue.get(self.shown * EDGE_WORDS..self.queued * EDGE_WORDS)?;
        LineEdgeEvent::from_slice(words).ok()
    }

    /// Takes what the kernel has.
    fn fill(&mut self) -> Result<(), CardError> {
        let words = gpiocdev_uapi::read_event(&self.file, &mut self.queue)
            .map_err(|e| CardError::Io { op: "reading GPIO edges", errno: errno_of(&e) })?;
        self.queued = words / EDGE_WORDS;
        self.shown = 0;
        self.more = self.queued == BATCH;
        Ok(())
    }

    /// Shows one edge: its time, its bit and level, and what is wrong with it.
    fn take(&mut self, levels: u64) -> Option<(u64, u64, Option<CardFaultKind>)> {
        let edge = self.head()?;
        let (time_ns, rising) = (edge.timestamp_ns, edge.kind == 1);
        let (offset, all, line) = (edge.offset, edge.seqno, edge.line_seqno);
        self.shown += 1;
        self.differs = None;
        let n = self.lines.iter().position(|(o, _)| *o == offset)?;
        let bit = 1 << self.lines[n].1;
        let trouble = self.numbering.next(n, all, line);
        // An edge to the level that the line already has: the edge between them was missed.
        let idle = self.known & bit != 0 && rising == (levels & bit != 0);
        let trouble = trouble.or(idle.then_some(CardFaultKind::EdgeMissed));
        self.known = if trouble.is_some() { bit } else { self.known | bit };
        Some((time_ns, if rising { levels | bit } else { levels & !bit }, trouble))
    }
}

/// One output request.
#[derive(Debug)]
struct OutputLineRequest {
    chip: String,
    file: File,
    bits: Box<[u8]>,
    mask: u64,
}

/// A card of GPIO lines.
#[derive(Debug)]
pub struct GpioCard<K> {
    inputs: Box<[InputLineRequest]>,
    outputs: Box<[OutputLineRequest]>,
    /// The descriptors of `inputs`, in the same order; none in level mode.
    waits: Box<[libc::pollfd]>,
    /// The input word.
    levels: u64,
    clock: K,
}

impl<K: Clock> GpioCard<K> {
    /// Requests the lines.
    /// `kept` are descriptors of output requests that outlived their process: those lines are taken over without
    /// being touched.
    ///
    /// # Errors
    /// When a chip or line is not there, is taken, or a kept descriptor holds other lines than those wanted.
    pub fn open(setup: &GpioCardConfig, kept: Vec<OwnedFd>, clock: K) -> Result<Self, GpioError> {
        let outputs = open_outputs(setup, kept)?;
        let inputs = open_inputs(setup)?;
        let mut levels = 0;
        for r in &inputs {
            levels |= r.levels().map_err(|e| {
                let CardError::Io { op, errno } = e else { unreachable!("only a recording ends: {e}") };
                GpioError::Io { op, chip: r.chip.clone(), source: io::Error::from_raw_os_error(errno) }
            })?;
        }
        let wait =
            |r: &InputLineRequest| libc::pollfd { fd: r.file.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        let waits = if setup.events { inputs.iter().map(wait).collect() } else { Box::default() };
        Ok(Self { inputs: inputs.into(), outputs: outputs.into(), waits, levels, clock })
    }

    /// Output requests: the name and the descriptor of each.
    /// The lines keep their levels after this process dies if another process holds a duplicate of each
    /// descriptor.
    pub fn kept(&self) -> impl Iterator<Item = (String, BorrowedFd<'_>)> {
        self.outputs.iter().map(|r| (format!("outputs-{}", r.chip), r.file.as_fd()))
    }

    /// Sleeps until an edge comes or `wait_ns` have passed, then reads the edges.
    /// Nothing is allocated.
    fn wait(&mut self, wait_ns: u64) -> Result<(), CardError> {
        let time = libc::timespec {
            tv_sec: (wait_ns / 1_000_000_000) as i64,
            tv_nsec: (wait_ns % 1_000_000_000) as i64,
        };
        let (fds, n) = (self.waits.as_mut_ptr(), self.waits.len() as libc::nfds_t);
        // SAFETY: `fds` points to `n` live entries, `time` lives through the call, and the mask may be null.
        let ready = unsafe { libc::ppoll(fds, n, &raw const time, std::ptr::null()) };
        if ready < 0 {
            let errno = io::Error::last_os_error().raw_os_error().unwrap_or(libc::EIO);
            if errno == libc::EINTR {
                return Ok(());
            }
            return Err(CardError::Io { op: "waiting for GPIO edges", errno });
        }
        for (r, wait) in self.inputs.iter_mut().zip(&self.waits) {
            if wait.revents != 0 {
                r.fill()?;
            }
        }
        Ok(())
    }

    /// The request that holds the earliest edge not yet shown.
    fn earliest(&self) -> Option<usize> {
        let heads = self.inputs.iter().enumerate().filter_map(|(n, r)| Some((n, r.head()?.timestamp_ns)));
        heads.min_by_key(|(_, t)| *t).map(|(n, _)| n)
    }

    /// Look without an edge: takes the levels of requests that agree with their edges.
    /// A line that differs has an edge on its way. If it differs for long, the edge was missed.
    fn levels_now(&mut self) -> Result<CardInputSample, CardError> {
        let (mut fresh, mut more, mut trouble) = (0, false, None);
        for r in &mut self.inputs {
            let now = r.levels()?;
            let differs = (now ^ self.levels) & r.edges;
            // A' and B' follow A and B. Only two equal readings show that all levels are of one moment.
            if differs == 0 && (r.edges == r.mask || r.levels()? == now) {
                self.levels = self.levels & !r.mask | now;
                fresh |= r.mask;
                r.differs = None;
            } else if differs != 0 {
                let t_ns = self.clock.now_ns();
                match r.differs {
                    Some((how, since_ns)) if how == differs && t_ns > since_ns + MISSED_AFTER_NS => {
                        trouble = Some(CardFault { kind: CardFaultKind::EdgeMissed, lines: differs });
                        self.levels ^= differs;
                        r.differs = None;
                    }
                    Some((how, _)) if how == differs => more = true,
                    _ => {
                        r.differs = Some((differs, t_ns));
                        more = true;
                    }
                }
            }
        }
        let t_ns = self.clock.now_ns();
        Ok(CardInputSample {
            complete: u64::MAX,
            more,
            fresh,
            trouble,
            ..CardInputSample::level(t_ns, self.levels)
        })
    }
}

impl<K: Clock> Card for GpioCard<K> {
    const SLEEPS: bool = true;

    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        if self.waits.is_empty() {
            let mut inputs = 0;
            for r in &self.inputs {
                inputs |= r.levels()?;
            }
            return Ok(CardInputSample::level(self.clock.now_ns(), inputs));
        }
        if self.earliest().is_none() {
            let under_way = self.inputs.iter().any(|r| r.differs.is_some());
            let wait_ns = wake_ns.saturating_sub(self.clock.now_ns());
            self.wait(if under_way { GIVE_WAY_NS } else { wait_ns })?;
        }
        let Some(n) = self.earliest() else { return self.levels_now() };
        let r = &mut self.inputs[n];
        let (edge_ns, trouble) = match r.take(self.levels) {
            Some((edge_ns, levels, trouble)) => {
                self.levels = levels;
                (Some(edge_ns), trouble)
            }
            // An edge of a line that was not requested.
            None => (None, Some(CardFaultKind::EdgeMissed)),
        };
        let trouble = trouble.map(|kind| CardFault { kind, lines: r.mask });
        let more = self.inputs.iter().any(|r| r.more || r.head().is_some());
        let sample = CardInputSample::stamped(self.clock.now_ns(), self.levels, edge_ns);
        Ok(CardInputSample { complete: u64::MAX, more, fresh: 0, trouble, ..sample })
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        for r in self.outputs.iter().filter(|r| r.mask & mask != 0) {
            let mut values = LineValues::default();
            for (n, bit) in r.bits.iter().enumerate().filter(|(_, bit)| mask >> *bit & 1 != 0) {
                values.set(n, value >> bit & 1 != 0);
            }
            set_line_values(&r.file, &values)
                .map_err(|e| CardError::Io { op: "setting GPIO lines", errno: errno_of(&e) })?;
        }
        Ok(Some(self.clock.now_ns()))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        let mut word = 0;
        for r in &self.outputs {
            let bits = read_levels(&r.file, r.bits.len())?;
            word |= r.bits.iter().enumerate().fold(0, |word, (n, bit)| word | (bits >> n & 1) << bit);
        }
        Ok(word)
    }
}

/// The lines of one request, before it is made.
struct PendingLineRequest<'a, L> {
    chip: PathBuf,
    lines: Vec<(u32, &'a L)>,
}

fn open_inputs(setup: &GpioCardConfig) -> Result<Vec<InputLineRequest>, GpioError> {
    let mut wanted: Vec<(u8, PendingLineRequest<'_, GpioInputConfig>)> = Vec::new();
    for input in &setup.inputs {
        let LocatedLine { chip, offset } = find(&input.line)?;
        // Levels are read chip by chip in one call, whichever axis a line belongs to.
        let same = |g: u8, w: &PendingLineRequest<'_, GpioInputConfig>| {
            if setup.events { g == input.group } else { w.chip == chip }
        };
        match wanted.iter_mut().find(|(g, w)| same(*g, w)) {
            Some((_, w)) if w.chip == chip => w.lines.push((offset, input)),
            Some((_, w)) => {
                return Err(GpioError::Apart {
                    line: input.line.line.clone(),
                    chip: chip.display().to_string(),
                    other: w.chip.display().to_string(),
                });
            }
            None => wanted.push((input.group, PendingLineRequest { chip, lines: vec![(offset, input)] })),
        }
    }
    let mut requests = Vec::new();
    for (_, PendingLineRequest { chip, lines }) in wanted {
        let chip = open_chip(&chip.display().to_string())?;
        let offsets: Vec<u32> = lines.iter().map(|(offset, _)| *offset).collect();
        let names: Vec<GpioLineId> = lines.iter().map(|(_, input)| input.line.line.clone()).collect();
        let flags: Vec<_> =
            lines.iter().map(|(_, i)| flags(&i.line, false, setup.events && i.edges)).collect();
        let file = request(&chip, &offsets, &names, line_config(&flags, None))?;
        let mask = |edges: bool| {
            lines.iter().filter(|(_, i)| i.edges || !edges).fold(0, |mask, (_, i)| mask | 1 << i.bit)
        };
        requests.push(InputLineRequest {
            chip: chip.name(),
            file,
            mask: mask(false),
            edges: if setup.events { mask(true) } else { 0 },
            known: 0,
            numbering: EdgeSequenceNumbers { all: 0, line: vec![0; lines.len()].into() },
            lines: lines.iter().map(|(offset, i)| (*offset, i.bit)).collect(),
            queue: vec![0; if setup.events { BATCH * EDGE_WORDS } else { 0 }].into(),
            queued: 0,
            shown: 0,
            more: false,
            differs: None,
        });
    }
    Ok(requests)
}

/// The chip's name and the lines that a descriptor holds, in the request's order.
fn held(fd: BorrowedFd<'_>) -> io::Result<(String, Vec<u32>)> {
    let text = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", fd.as_raw_fd()))?;
    let values = |key: &'static str| text.lines().filter_map(move |l| l.strip_prefix(key).map(str::trim));
    let chip = values("gpio-chip:").next().ok_or_else(|| io::Error::other("it is no GPIO line request"))?;
    Ok((chip.to_owned(), values("gpio-line:").filter_map(|n| n.parse().ok()).collect()))
}

fn open_outputs(setup: &GpioCardConfig, kept: Vec<OwnedFd>) -> Result<Vec<OutputLineRequest>, GpioError> {
    let mut wanted: Vec<PendingLineRequest<'_, GpioOutputConfig>> = Vec::new();
    for output in &setup.outputs {
        let LocatedLine { chip, offset } = find(&output.line)?;
        match wanted.iter_mut().find(|w| w.chip == chip) {
            Some(w) => w.lines.push((offset, output)),
            None => wanted.push(PendingLineRequest { chip, lines: vec![(offset, output)] }),
        }
    }
    let mut store = Vec::new();
    for fd in kept {
        let io =
            |source| GpioError::Io { op: "looking into", chip: "a kept line request".to_owned(), source };
        store.push((held(fd.as_fd()).map_err(io)?, fd));
    }
    let restart = !store.is_empty();
    let found: Vec<String> = store.iter().map(|((chip, lines), _)| format!("{chip} {lines:?}")).collect();
    let (mut requests, mut wants) = (Vec::new(), Vec::new());
    let mut missing = false;
    for PendingLineRequest { chip, lines } in wanted {
        let chip = open_chip(&chip.display().to_string())?;
        let offsets: Vec<u32> = lines.iter().map(|(offset, _)| *offset).collect();
        wants.push(format!("{} {offsets:?}", chip.name()));
        let same = store.iter().position(|((name, held), _)| *name == chip.name() && *held == offsets);
        let file = match same {
            Some(n) => File::from(store.swap_remove(n).1),
            None if restart => {
                missing = true;
                continue;
            }
            None => request_outputs(&chip, &offsets, &lines)?,
        };
        let bits: Box<[u8]> = lines.iter().map(|(_, output)| output.bit).collect();
        let mask = bits.iter().fold(0, |mask, bit| mask | 1 << bit);
        requests.push(OutputLineRequest { chip: chip.name(), file, bits, mask });
    }
    if missing || !store.is_empty() {
        return Err(GpioError::Kept { found: found.join(", "), wanted: wants.join(", ") });
    }
    Ok(requests)
}

/// Requests lines unchanged, reads them, then makes them outputs at those levels.
fn request_outputs(
    chip: &Chip,
    offsets: &[u32],
    lines: &[(u32, &GpioOutputConfig)],
) -> Result<File, GpioError> {
    let names: Vec<GpioLineId> = lines.iter().map(|(_, output)| output.line.line.clone()).collect();
    let polarity =
        |l: &GpioLineSettings| if l.active_low { LineFlags::ACTIVE_LOW } else { LineFlags::empty() };
    let as_is: Vec<_> = lines.iter().map(|(_, output)| polarity(&output.line)).collect();
    let file = request(chip, offsets, &names, line_config(&as_is, None))?;
    let failed =
        |op, errno| GpioError::Io { op, chip: path_of(chip), source: io::Error::from_raw_os_error(errno) };
    let mut levels = LineValues { bits: 0, mask: all(lines.len()) };
    get_line_values(&file, &mut levels).map_err(|e| failed("reading the outputs of", errno_of(&e)))?;
    let flags: Vec<_> = lines.iter().map(|(_, output)| flags(&output.line, true, false)).collect();
    set_line_config(&file, line_config(&flags, Some(levels.bits)))
        .map_err(|e| failed("making outputs of lines of", errno_of(&e)))?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: u32 = 4;
    const B: u32 = 5;

    /// A request of A (bit 0) and B (bit 1) on a dummy file that is never read.
    fn request_of(edges: &[(u32, bool, u32, u32)]) -> InputLineRequest {
        let mut queue = vec![0; BATCH * EDGE_WORDS];
        for (n, (offset, rising, all, line)) in edges.iter().enumerate() {
            let kind = if *rising { 1 } else { 2 };
            let words = &mut queue[n * EDGE_WORDS..];
            words[0] = 1000 * (n as u64 + 1);
            words[1] = kind | u64::from(*offset) << 32;
            words[2] = u64::from(*all) | u64::from(*line) << 32;
        }
        InputLineRequest {
            chip: "test".into(),
            file: tempfile::tempfile().unwrap(),
            lines: [(A, 0), (B, 1)].into(),
            mask: 0b11,
            edges: 0b11,
            known: 0,
            numbering: EdgeSequenceNumbers { all: 0, line: [0, 0].into() },
            queue: queue.into(),
            queued: edges.len(),
            shown: 0,
            more: false,
            differs: None,
        }
    }

    fn troubles(edges: &[(u32, bool, u32, u32)]) -> Vec<Option<CardFaultKind>> {
        let (mut r, mut levels, mut found) = (request_of(edges), 0, Vec::new());
        while let Some((_, now, trouble)) = r.take(levels) {
            levels = now;
            found.push(trouble);
        }
        assert_eq!(found.len(), edges.len());
        found
    }

    #[test]
    fn edges_in_order_lead_the_lines_and_carry_their_time() {
        let mut r = request_of(&[(A, true, 1, 1), (B, true, 2, 1), (A, false, 3, 2)]);
        assert_eq!(r.take(0), Some((1000, 0b01, None)));
        assert_eq!(r.take(0b01), Some((2000, 0b11, None)));
        assert_eq!(r.take(0b11), Some((3000, 0b10, None)));
        assert_eq!(r.take(0b10), None);
    }

    #[test]
    fn a_merged_pair_is_a_gap_in_the_request_alone() {
        // A rose and B rose; the kernel saw B twice before its thread ran.
        let found = troubles(&[(A, true, 1, 1), (B, true, 3, 1), (A, false, 4, 2)]);
        assert_eq!(found, [None, Some(CardFaultKind::SequenceGap), None]);
    }

    #[test]
    fn a_dropped_edge_is_a_gap_in_its_line_too() {
        let found = troubles(&[(A, true, 1, 1), (A, false, 5, 3), (B, true, 6, 3)]);
        assert_eq!(found, [None, Some(CardFaultKind::QueueOverflow), Some(CardFaultKind::QueueOverflow)]);
    }

    #[test]
    fn numbers_wrap() {
        let mut n = EdgeSequenceNumbers { all: u32::MAX, line: [u32::MAX, 7].into() };
        assert_eq!(n.next(0, 0, 0), None);
        assert_eq!(n.next(1, 1, 8), None);
    }

    #[test]
    fn an_edge_that_leads_nowhere_was_preceded_by_one_unseen() {
        let found = troubles(&[(A, true, 1, 1), (A, true, 2, 2), (A, false, 3, 3)]);
        assert_eq!(found, [None, Some(CardFaultKind::EdgeMissed), None]);
        // A line's first edge may have come before the levels were read. Then the line already has its level.
        assert_eq!(troubles(&[(A, false, 1, 1), (B, false, 2, 1)]), [None, None]);
    }

    #[test]
    fn configuration_groups_its_exceptions() {
        let (input, output) = (LineFlags::INPUT, LineFlags::OUTPUT | LineFlags::ACTIVE_LOW);
        let config = line_config(&[output, input, output, input], Some(0b0101));
        assert_eq!((config.flags, config.num_attrs), (output, 2));
        assert_eq!((config.attr(0).mask, config.attr(1).mask), (0b1010, 0b1111));
    }

    #[test]
    fn what_is_not_there_is_named() {
        let line = GpioLineSettings {
            chip: Some("no-such-chip".into()),
            line: GpioLineId::Offset(3),
            active_low: false,
            bias: None,
            drive: None,
        };
        let setup =
            GpioCardConfig { inputs: vec![], outputs: vec![GpioOutputConfig { line, bit: 0 }], events: true };
        let error = GpioCard::open(&setup, Vec::new(), crate::clock::Monotonic).unwrap_err().to_string();
        assert!(error.starts_with("GPIO chip no-such-chip: "), "{error}");
    }

    #[test]
    fn a_kept_descriptor_that_is_no_line_request_is_refused() {
        let kept = vec![OwnedFd::from(tempfile::tempfile().unwrap())];
        let setup = GpioCardConfig { inputs: vec![], outputs: vec![], events: true };
        let error = GpioCard::open(&setup, kept, crate::clock::Monotonic).unwrap_err().to_string();
        assert!(error.contains("no GPIO line request"), "{error}");
    }
}
