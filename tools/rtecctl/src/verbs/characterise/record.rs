//! `rtecctl characterise record`: records temperatures, positions and gauges.
//! It shows its progress.

use crate::daemon_connection::{self, status};
use crate::prelude::*;
use crate::verbs::input_notices;
use nix::sys::signal::Signal;
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{ClientRequest, DaemonStatus};
use rtec_files::strict_toml::Document;
use rtec_files::text_file::open_regular;
use rtec_files::toml_section_keys::{FileWithFindings, TomlSection};
use rtec_measure::run_record_files;
use rtec_model::record::{Column, LINEAR, Record, Role, RunKind, check};
use rtec_sensors::sensor_bank::SensorBank;
use rtec_sensors::sensor_text_stream::SensorTextStream;
use rtec_sensors::{SensorConfig, SensorUsability};
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Record temperatures and a gauge feed into a run record
///
/// For as long as --duration says, or until Ctrl-C: what was recorded by then is kept.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The run record to write; its CSV stands beside it
    #[arg(long, value_name = "NAME.run.toml", value_parser = crate::verbs::output())]
    out: PathBuf,
    /// Put the finished record into this folder too, for `rtecctl ship`; without a folder the daemon keeps it, in its
    /// configuration's `[control] spool`
    #[arg(long, value_name = "DIR")]
    #[allow(clippy::option_option)] // a folder, the daemon's, or none
    spool: Option<Option<PathBuf>>,
    #[command(flatten)]
    recorder: RecorderArgs,
}

/// What is recorded, and for how long.
#[derive(Debug, clap::Args)]
pub(crate) struct RecorderArgs {
    /// What kind of run it is [default: drift]
    #[arg(long)]
    kind: Option<String>,
    /// File of `[[sensor]]` tables
    #[arg(long, value_name = "FILE")]
    sensors: Option<PathBuf>,
    /// Record the daemon's positions and sensors too, and add the correction in effect back to each error, so that the
    /// record shows the uncorrected machine; without a path, or without --sensors and --feed, by the configuration's
    /// socket
    #[arg(long, value_name = "PATH")]
    #[allow(clippy::option_option)] // a path, the configuration's, or none of it
    socket: Option<Option<PathBuf>>,
    /// Gauges and positions: lines NAME VALUE from host:port or a serial device
    #[arg(long, value_name = "host:port|/dev/tty…")]
    feed: Option<String>,
    /// Columns of the feed with their roles, as gz=error.z,y=position.y
    #[arg(long, value_delimiter = ',', value_name = "NAME=ROLE", requires = "feed")]
    columns: Vec<String>,
    /// Time between rows, s [default: 1]
    #[arg(long, value_parser = seconds)]
    period: Option<f64>,
    /// How long to record, s
    #[arg(long, value_parser = seconds)]
    duration: Option<f64>,
    #[command(flatten)]
    circle: super::BallbarCircleOptions,
    /// Where /sys is found
    #[arg(long, default_value = "/", hide = true)]
    root: PathBuf,
}

impl RecorderArgs {
    /// The first option of the recorder that was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        let given = [
            (self.kind.is_some(), "--kind"),
            (self.circle.radius_mm.is_some(), "--radius-mm"),
            (self.sensors.is_some(), "--sensors"),
            (self.socket.is_some(), "--socket"),
            (self.feed.is_some(), "--feed"),
            (!self.columns.is_empty(), "--columns"),
            (self.period.is_some(), "--period"),
            (self.duration.is_some(), "--duration"),
        ];
        given.into_iter().find_map(|(is, name)| is.then_some(name))
    }

    /// The daemon, if it is named or there is no other source.
    /// It has no response.
    fn corrector(&self, with_response: bool) -> anyhow::Result<Option<DaemonTotalsReader>> {
        let alone = !with_response && self.sensors.is_none() && self.feed.is_none();
        self.socket.clone().or(alone.then_some(None)).map(DaemonTotalsReader::connect).transpose()
    }

    fn gauges(&self) -> Result<Vec<Column>, InputError> {
        let parsed = |text: &String| {
            let parsed = text.split_once('=').and_then(|(n, r)| Some((n, Role::parse(r)?)));
            let (name, role) =
                parsed.ok_or_else(|| usage(format!("--columns {text}"), "NAME=ROLE, as gz=error.z"))?;
            let column = Column::new(name, role, Vec::new());
            if column.role.is_rotary(&column.unit) {
                return Err(usage(format!("--columns {text}: of a rotary axis"), LINEAR));
            }
            Ok(column)
        };
        self.columns.iter().map(parsed).collect()
    }

    /// Checks before the run that the record can be written.
    fn check(&self, out: &Path, kind: RunKind, columns: &[Column], response: bool) -> Result<(), InputError> {
        if response && !columns.iter().any(|c| c.role.is_response()) {
            return Err(usage("no response".into(), "--columns with an error.AXIS or force.AXIS"));
        }
        if let Some(found) = twice(columns) {
            return Err(usage(found, "each column once"));
        }
        if self.circle.circle()?.is_some() {
            let one_row = columns.iter().map(|c| Column { data: vec![0.0], ..c.clone() }).collect();
            self.circle.apply(Record::of_checked(out, kind, one_row))?;
        }
        if columns.len() == 1 {
            return Err(usage("nothing to record".into(), "--sensors, --socket, or --feed with --columns"));
        }
        Ok(())
    }
}

fn usage(found: String, expected: &str) -> InputError {
    InputError::whole(Path::new("recording"), found, expected)
}

fn seconds(text: &str) -> Result<f64, String> {
    rtec_files::cli_option_parsers::duration(text).map(|t| t.as_secs_f64())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let daemon = DaemonArgs::at(args.recorder.socket.clone().flatten());
    let keeps = matches!(args.spool, Some(None));
    if keeps {
        // Asked before the run, not after it.
        daemon.ask(&ClientRequest::Keep { files: Vec::new() })?;
    }
    record(&args.out, &args.recorder, false)?;
    if let Some(Some(spool)) = &args.spool {
        rtec_measure::spool::add(&args.out, spool)
            .with_context(|| format!("writing to {}", spool.display()))?;
    }
    if keeps {
        let csv = rtec_measure::run_record_files::read_log(&args.out)?.file;
        let files = [args.out.clone(), args.out.with_file_name(csv)];
        let open = [open_regular(&files[0])?, open_regular(&files[1])?];
        let files = files.map(|f| daemon_connection::absolute(&f)).to_vec();
        let written = || format!("the record is in {}, and not in the daemon's spool", args.out.display());
        daemon.ask_with(&ClientRequest::Keep { files }, &open).with_context(written)?;
    }
    Ok(())
}

/// Records a run into `out`.
/// A shift's log needs a response only on request.
pub(crate) fn record(out: &Path, args: &RecorderArgs, with_response: bool) -> anyhow::Result<()> {
    let kind = args.kind.as_deref().unwrap_or("drift");
    let kind = RunKind::parse(kind).ok_or_else(|| usage(format!("--kind {kind}"), "a kind of run"))?;
    let period = args.period.unwrap_or(1.0);
    let duration = args.duration.ok_or_else(|| usage("no --duration".into(), "how long to record, s"))?;
    if !(period >= 0.001 && duration >= period && duration.is_finite()) {
        let found = format!("--period {period} --duration {duration}");
        return Err(usage(found, "a period of at least 1 ms and a duration of at least a period").into());
    }
    let ended = on_signal()?;
    let mut columns = vec![Column::new("t", Role::Time, Vec::new())];
    let sensors = read_sensors(args.sensors.as_deref())?;
    let mut bank = SensorBank::new(sensors, &args.root, run_record_files::read_log)?;
    columns
        .extend(bank.sensors().iter().map(|w| Column::new(&w.config().name, Role::Temperature, Vec::new())));
    let (own, mut corrector) = (columns.len(), args.corrector(with_response)?);
    if let Some(c) = &corrector {
        columns.extend(c.columns(&columns)?);
    }
    let gauges = columns.len();
    columns.extend(args.gauges()?);
    args.check(out, kind, &columns, with_response)?;
    let mut feed = args.feed.as_deref().map(SensorTextStream::new);
    let (part, mut file) = rows_apart(out, &columns)?;
    let (start, begun) = (Instant::now(), rtec_files::date::format(rtec_files::date::today()));
    let rows = (duration / period).floor() as u64 + 1;
    let (mut last, mut came_s) = (vec![None::<f64>; columns.len()], vec![0.0; columns.len()]);
    let (mut taken, mut left_out, mut incomplete, mut shown_s) = (0_u64, 0_u64, 0_u64, 0.0);
    let (mut said, mut lost, mut looked) = (String::new(), false, 0);
    for row in 0..rows {
        if !wait_until(start, row as f64 * period, &ended) {
            let now = start.elapsed().as_secs_f64();
            eprintln!("interrupted at {now:.0} of {duration:.0} s: {taken} rows are kept");
            break;
        }
        looked = row + 1;
        let now = start.elapsed().as_secs_f64();
        bank.poll(now);
        if let Some(c) = &mut corrector {
            c.ask()?;
            for (value, col) in last[own..gauges].iter_mut().zip(&columns[own..gauges]) {
                *value = c.value(col);
            }
        }
        if let Some(feed) = &mut feed {
            take(feed, now, &columns[gauges..], &mut last[gauges..], &mut came_s[gauges..]);
            say_odd_lines(feed, now, &mut said);
            say_lost(feed, now, &mut lost);
        }
        last[0] = Some(now);
        last[1..own].iter_mut().zip(bank.sensors()).for_each(|(value, w)| *value = w.value_degc());
        let silent = silent(&bank, now, &last[own..], &columns[own..]);
        // A row has all its values or is left out.
        let whole = last.iter().zip(&columns).map(|(value, c)| {
            Some((*value)? + corrector.as_ref().map_or(Some(0.0), |r| r.in_effect_um(&c.role))?)
        });
        let whole = whole.collect::<Option<Vec<f64>>>();
        if let Some((place, what)) = whole.as_ref().and_then(|values| impossible(values, &columns)) {
            // An invalid reading costs its own row, not the run, and is not used for the next row.
            eprintln!("warning: row {} at {now:.3} s left out: {what}", row + 1);
            left_out += 1;
            last[place] = None;
        } else if let Some(values) = whole {
            let words: Vec<String> = values.iter().map(f64::to_string).collect();
            writeln!(file, "{}", words.join(",")).with_context(|| format!("writing {}", part.display()))?;
            columns.iter_mut().zip(values).for_each(|(c, v)| c.data.push(v));
            taken += 1;
            // A gauge's reading makes one row; a silent gauge makes no more.
            let read = last.iter_mut().zip(&columns).skip(gauges);
            read.filter(|(_, c)| !stays(&c.role)).for_each(|(value, _)| *value = None);
        } else {
            incomplete += 1;
        }
        if now - shown_s >= 2.0 || row + 1 == rows {
            shown_s = now;
            let trouble = if silent.is_empty() { String::new() } else { format!("; {}", silent.join(", ")) };
            eprintln!("{now:.0} of {duration:.0} s, {taken} rows{trouble}");
        }
    }
    if taken == 0 {
        std::fs::remove_file(&part).ok();
        let quiet = || silent(&bank, duration, &last[own..], &columns[own..]).join(", ");
        let trouble = |f: &SensorTextStream| columns[gauges..].iter().find_map(|c| f.value(&c.name).err());
        let what = feed.as_ref().map_or_else(quiet, |f| trouble(f).unwrap_or_default());
        let faulty = match left_out {
            0 => String::new(),
            rows => format!(", {rows} with a reading that is none"),
        };
        fail!(Unreachable, "no complete row in {duration:.0} s ({what}{faulty})");
    }
    if let Some(refused) = feed.as_ref().map(SensorTextStream::refused).filter(|n| *n > 0) {
        eprintln!("warning: lines of the feed that were no readings: {refused}");
    }
    if left_out > 0 {
        eprintln!("warning: {left_out} of {looked} rows left out");
    }
    if incomplete > 0 {
        eprintln!("warning: {incomplete} of {looked} rows are missing: not everything had a new reading");
    }
    // Every value was checked when it came.
    let mut record = args.circle.apply(Record::of_checked(out, kind, columns))?;
    record.date = Some(begun);
    run_record_files::write(&mut record).with_context(|| format!("writing {}", out.display()))?;
    input_notices::warn(std::slice::from_ref(&record));
    std::fs::remove_file(&part).with_context(|| format!("removing {}", part.display()))
}

/// Opens a separate file for the rows as they come.
/// A long run then survives a loss of power, and the next run.
fn rows_apart(out: &Path, columns: &[Column]) -> anyhow::Result<(PathBuf, std::fs::File)> {
    let part = out.with_extension("csv.part");
    if part.metadata().is_ok_and(|m| m.len() > 0) {
        let expected = "it under another name, or removed, before the next run";
        return Err(InputError::whole(&part, "rows of a run that was cut off", expected).into());
    }
    let mut file = std::fs::File::create(&part).with_context(|| format!("creating {}", part.display()))?;
    let names: Vec<&str> = columns.iter().map(|c| c.name.as_str()).collect();
    writeln!(file, "{}", rtec_files::csv::header_line(names.iter().copied()))?;
    Ok((part, file))
}

/// Reports lines of the feed that cannot be read, a repeated one once.
fn say_odd_lines(feed: &mut SensorTextStream, now_s: f64, said: &mut String) {
    for odd in feed.odd_lines() {
        if odd != *said {
            eprintln!("warning: at {now_s:.3} s: {odd}");
            *said = odd;
        }
    }
}

/// Reports a lost connection, and its return.
fn say_lost(feed: &SensorTextStream, now_s: f64, lost: &mut bool) {
    match feed.lost() {
        Some(why) if !*lost => {
            eprintln!("warning: at {now_s:.3} s: the feed is lost: {why}; it is tried again");
        }
        None if *lost => eprintln!("warning: at {now_s:.3} s: the feed is there again"),
        _ => {}
    }
    *lost = feed.lost().is_some();
}

/// Columns and sensors without a value now, with the reason.
fn silent(bank: &SensorBank, now_s: f64, last: &[Option<f64>], columns: &[Column]) -> Vec<String> {
    let faults = bank.sensors().iter().filter(|w| w.usable(now_s) != SensorUsability::Good).map(|w| {
        let why = w.fault().map_or("no reading yet".to_owned(), ToString::to_string);
        format!("{} {why}", w.config().name)
    });
    let missing = last.iter().zip(columns).filter(|(value, _)| value.is_none());
    let since = |c: &Column| if c.data.is_empty() { "no reading yet" } else { "no new reading" };
    faults.chain(missing.map(|(_, c)| format!("{} {}", c.name, since(c)))).collect()
}

/// Longest time for which a slow quantity keeps its last value, s.
/// Such a quantity is often sent seldom; every other one needs a new value for each row.
const HELD_S: f64 = 180.0;

/// Takes the feed's values since the last poll, and their times, s.
fn take(
    feed: &mut SensorTextStream,
    now_s: f64,
    columns: &[Column],
    last: &mut [Option<f64>],
    came_s: &mut [f64],
) {
    feed.poll(now_s);
    for ((value, came), c) in last.iter_mut().zip(came_s).zip(columns) {
        if let Ok(new) = feed.value(&c.name) {
            (*value, *came) = (Some(new), now_s);
        } else if now_s - *came > HELD_S {
            *value = None;
        }
    }
}

fn stays(role: &Role) -> bool {
    matches!(role, Role::Temperature | Role::Channel | Role::Coolant | Role::SpindleSpeed)
}

/// Index of the first value that its column cannot contain, and why.
fn impossible(values: &[f64], columns: &[Column]) -> Option<(usize, String)> {
    values.iter().zip(columns).enumerate().find_map(|(place, (v, c))| {
        let (found, expected) = check(&c.role, *v, c.data.last().copied()).err()?;
        Some((place, format!("{} ({}) is {found}, expected {expected}", c.name, c.role)))
    })
}

/// Finds two columns of one name, or of a role that may not repeat.
fn twice(columns: &[Column]) -> Option<String> {
    columns.iter().enumerate().find_map(|(i, c)| {
        let before = &columns[..i];
        if before.iter().any(|d| d.name == c.name) {
            return Some(format!("two columns named {}", c.name));
        }
        let again = !c.role.may_repeat() && before.iter().any(|d| d.role == c.role);
        again.then(|| format!("two columns of role {}", c.role))
    })
}

/// The running daemon, which is asked once per row.
struct DaemonTotalsReader {
    client: DaemonConnection,
    status: DaemonStatus,
    /// µm per count of each axis, once it was away from zero.
    count_um: Vec<Option<f64>>,
}

impl DaemonTotalsReader {
    fn connect(socket: Option<PathBuf>) -> anyhow::Result<Self> {
        let mut client = DaemonArgs::at(socket).view()?;
        let status = status(&mut client)?;
        let count_um = vec![None; status.axes.len()];
        Ok(Self { client, status, count_um })
    }

    fn ask(&mut self) -> anyhow::Result<()> {
        self.status = status(&mut self.client)?;
        for (known, a) in self.count_um.iter_mut().zip(&self.status.axes) {
            if a.position_counts != 0 {
                *known = Some(1000.0 * a.position_mm / a.position_counts as f64);
            }
        }
        Ok(())
    }

    /// Columns for its axes' positions, and for its sensors that have none yet.
    fn columns(&self, there: &[Column]) -> anyhow::Result<Vec<Column>> {
        let mut out = Vec::new();
        for a in &self.status.axes {
            let text = format!("position.{}", a.name);
            let role =
                Role::parse(&text).with_context(|| format!("the daemon's axis {} as {text}", a.name))?;
            out.push(Column::new(&text, role, Vec::new()));
        }
        let new = |name: &str| !there.iter().any(|c| c.name == name);
        let sensors = self.status.sensors.iter().filter(|s| new(&s.sensor));
        out.extend(sensors.map(|s| Column::new(&s.sensor, Role::Temperature, Vec::new())));
        Ok(out)
    }

    fn value(&self, column: &Column) -> Option<f64> {
        if column.role == Role::Temperature {
            return self.status.sensors.iter().find(|s| s.sensor == column.name)?.degc;
        }
        let axis = column.role.axis()?.to_string();
        Some(self.status.axes.iter().find(|a| a.name == axis)?.position_mm)
    }

    /// Correction in effect, by which a response is smaller, µm.
    /// `None` while an axis's resolution is not known.
    fn in_effect_um(&self, role: &Role) -> Option<f64> {
        let Role::Error(axis) = role else { return Some(0.0) };
        let axis = axis.to_string();
        match self.status.axes.iter().zip(&self.count_um).find(|(a, _)| a.name == axis) {
            Some((a, count_um)) if a.in_effect != 0 => count_um.map(|um| um * a.in_effect as f64),
            _ => Some(0.0),
        }
    }
}

/// Waits; `false` if a signal came first.
fn wait_until(start: Instant, due_s: f64, ended: &AtomicBool) -> bool {
    loop {
        let left = due_s - start.elapsed().as_secs_f64();
        if ended.load(Ordering::Relaxed) || left <= 0.0 {
            return !ended.load(Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_secs_f64(left.min(0.05)));
    }
}

/// While the returned value lives, a first signal ends the run and keeps its record.
/// Any other signal ends the program. It must be called before sensors and feed start threads, so that only
/// this thread receives signals.
fn on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let ends = daemon_connection::block_end_signals()?;
    let ended = Arc::new(AtomicBool::new(false));
    let told = Arc::downgrade(&ended);
    std::thread::spawn(move || {
        let mut signal = ends.wait();
        // Only while it records.
        if let Some(told) = told.upgrade() {
            told.store(true, Ordering::Relaxed);
            signal = ends.wait();
        }
        std::process::exit(128 + signal.map_or(Signal::SIGINT, |s| s) as i32);
    });
    Ok(ended)
}

fn read_sensors(path: Option<&Path>) -> Result<Vec<SensorConfig>, InputError> {
    let Some(path) = path else { return Ok(Vec::new()) };
    let text = rtec_files::text_file::read(path)?;
    let document = Document::parse(path, &text)?;
    let mut source = FileWithFindings { file: path, text: &text, findings: Vec::new() };
    let mut root = TomlSection::root(&document);
    if !root.has("sensor") {
        root.say_missing(&mut source, "sensor", "[[sensor]] tables");
    }
    let sensors = rtec_sensors::read_tables(&mut source, &mut root);
    root.finish(&mut source);
    source.findings.into_iter().next().map_or(Ok(sensors), Err)
}
