//! `rtec.toml`: one machine, its card, its axes, the real-time thread and the control socket.
//!
//! | table | key | unit | default | meaning |
//! |---|---|---|---|---|
//! | `[machine]` | `name` | – | must be there | the machine, as `status` shows it |
//! | `[card]` | `backend` | – | must be there | `mock`, `gpio`, `mapped`, `port` or `replay` |
//! | | `file` | – | – | `mapped`: the file of registers |
//! | | `uio`, `map` | – | –, 0 | `mapped`: a UIO device, as `/dev/uio0`, and which of its maps |
//! | | `pci`, `bar` | – | the profile's | `mapped`, `port`: the card, as `vendor:device` or by its address, and which BAR |
//! | | `parport`, `io` | – | – | `port`: a parallel port through `ppdev`, or the first of its I/O ports |
//! | | `profile` | – | `shared-memory`, `parallel-port` | `mapped`, `port`: what the registers mean; `rtecctl card list` |
//! | | `mode` | – | `edges` | `gpio`: sleep until an edge comes, or read `levels` as fast as it goes |
//! | | `chip`, `bias`, `drive` | – | –, as it is, `push-pull` | `gpio`: of every line that does not say otherwise |
//! | | `probe`, `disable`, `hold` | line | not wired | `gpio`, `mapped`, `port`: the machine's own lines |
//! | `[[axis]]` | `name`, `count_um`, `travel_mm` | µm, mm | must be there | |
//! | | `design` | – | `c` | insertion design (NISTIR 4832): `c`, `original`, `a` |
//! | | `max_correction_counts`, `window_counts` | counts | must be there | largest total; largest believed change |
//! | | `min_separation_ns` | ns | must be there | what the MTC's decoder needs between two edges |
//! | | `max_accel_mm_s2` or `max_accel_counts_s2` | | 1e6 counts/s² (mock, replay) | acceleration limit of the axis |
//! | | `hysteresis_counts` | counts | 0.05 | the scale's, on reversal |
//! | | `warn_counts`, `error_counts` | counts | none | a request of this size warns; faults and holds |
//! | | `max_rate_counts_s` | counts/s | none | fastest change of the correction |
//! | | `rest_policy`, `rest_quiet_ms` | –, ms | `wait` | at rest: `wait` for an edge, or `insert` after a quiet time |
//! | | `reference_budget_counts` | counts | none | what the MTC tolerates between reference marks, or between two encoders |
//! | | `home_mm` | mm | 0 | position of the known place where the axis is homed |
//! | | `lines` | line | – | `gpio`, `mapped`, `port`: `a`, `b`, `invert_a`, `invert_b`, `read_back_a`, `read_back_b` |
//! | | `simulated` | – | as configured | `mock`: what the machine is really like: `count_um` (negative: it counts backwards), `compensates_ppm`, `feedback = "ignored"` |
//! | | `trace` | – | – | `replay`: the recorded trace |
//! | `[rt]` | `cpu`, `priority` | – | isolated or last, 80 | of the real-time thread |
//! | | `detect_ns`, `write_ns`, `guard_ns` | ns | 0 (mock, replay) | measured worst latencies and a reserve |
//! | `[control]` | `socket`, `group` | – | see [`default_directory`] | the control socket and who may use it |
//! | | `state_file` | – | beside the socket | what a restart takes over |
//! | | `stale_ms` | ms | 500 | silence of the control side after which no insertion begins |
//! | `[model]` | `file` | – | none | the machine model that shall run, once `rtecctl model load` has taken it |
//! | | `period_ms` | ms | 10 | how often it is evaluated, 10 to 20 |
//! | | `ramp_um_s` | µm/s | 5 | how fast a correction goes to a new place that no motion of the axis asks for |
//! | | `lead_ms` | ms | 0 | how long before the axes are there it is evaluated: one `period_ms` and the lag of the position loop |
//! | | `log_s` | s | 5 | how often temperatures are logged (beside the state file), for lags after a restart |
//! | `[[sensor]]` | | | | a temperature, see [`rtec_correct::sensors`] and [`crate::sources`] |
//!
//! A controller that checks counts between reference marks, or compares two encoders, sees a correction as an error:
//! `reference_budget_counts` says how much it bears, and caps `max_correction_counts`.

use crate::lines::{BIASES, DRIVES, LineName, gpio_line, line};
use crate::profile;
use rtec_correct::sensors;
use rtec_driver::card::{AxisLines, MachineLines};
use rtec_driver::gpio::{GpioInput, GpioLine, GpioOutput, GpioSetup, LineId};
use rtec_driver::pci::PciId;
use rtec_driver::profile::{Place, Profile, Space, Width};
use rtec_files::toml::{At, Document, Section, SourceFile, Table};
use rtec_files::{InputError, nearest};
use rtec_rt::axis::{AxisConfig, Design, RestPolicy};
use rtec_rt::event::MAX_AXES;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// A machine's configuration, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The machine's name, as `status` shows it.
    pub machine: String,
    /// The card and what its backend needs (`[card]`).
    pub card: CardConfig,
    /// The machine's own lines: probe, disable switch, hold.
    pub lines: MachineLines,
    /// The axes, in order.
    pub axes: Vec<ConfiguredAxis>,
    /// The real-time thread (`[rt]`).
    pub rt: RtConfig,
    /// The control socket and what belongs to it (`[control]`).
    pub control: ControlConfig,
    /// The machine model and how it is evaluated (`[model]`).
    pub model: ModelConfig,
    /// The temperature sensors (`[[sensor]]`).
    pub sensors: Vec<sensors::SensorConfig>,
    /// What is allowed but worth knowing.
    pub notes: Vec<String>,
}

/// A card and what it needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CardConfig {
    /// Simulated axes in the daemon's own process.
    Mock,
    /// GPIO lines through the kernel's character device.
    Gpio(GpioSetup),
    /// Registers mapped into memory.
    Mapped {
        /// Where the registers are.
        place: MappedPlace,
        /// What each register and bit means.
        profile: Profile,
    },
    /// Registers that are I/O ports.
    Port {
        /// Where the ports are.
        place: PortPlace,
        /// What each register and bit means.
        profile: Profile,
    },
    /// Recorded traces in real time, one per axis.
    Replay {
        /// The trace of each axis.
        traces: Vec<PathBuf>,
    },
}

/// Where mapped registers are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MappedPlace {
    /// A file: shared memory, a resource in sysfs.
    File(PathBuf),
    /// A UIO device, and which of its maps.
    Uio(PathBuf, u8),
    /// A BAR of a PCI card.
    Pci(PciId, u8),
}

/// Where I/O ports are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortPlace {
    /// A parallel port's device.
    Parport(PathBuf),
    /// The address of the first port.
    Io(u16),
    /// A BAR of a PCI card.
    Pci(PciId, u8),
}

impl CardConfig {
    /// The name in `[card] backend`.
    #[must_use]
    pub const fn backend(&self) -> &'static str {
        match self {
            Self::Mock => "mock",
            Self::Gpio(_) => "gpio",
            Self::Mapped { .. } => "mapped",
            Self::Port { .. } => "port",
            Self::Replay { .. } => "replay",
        }
    }

    /// Something outside this process hangs on the lines.
    #[must_use]
    pub const fn is_real(&self) -> bool {
        matches!(self, Self::Gpio(_) | Self::Mapped { .. } | Self::Port { .. })
    }
}

/// One axis as `[[axis]]` configures it.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfiguredAxis {
    /// The axis's name.
    pub name: String,
    /// What one count is worth, µm.
    pub count_um: f64,
    /// Length of its travel, mm.
    pub travel_mm: f64,
    /// Position of the place where it is homed, counts.
    pub home_counts: i64,
    /// What the MTC tolerates between reference marks or encoders, counts.
    pub reference_budget_counts: Option<i64>,
    /// What the engine needs to know.
    pub engine: AxisConfig,
    /// The mock card: what the simulated machine is really like.
    pub simulated: Simulated,
}

/// A simulated axis that may differ from what its configuration says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Simulated {
    /// What a count is really worth, µm; negative where it counts backwards.
    pub count_um: f64,
    /// What its controller compensates by itself.
    pub compensates_ppm: f64,
    /// Its controller does not use the feedback that it is sent.
    pub ignores: bool,
}

/// Settings of the real-time thread (`[rt]`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RtConfig {
    /// Its CPU; `None` leaves the choice to the machine.
    pub cpu: Option<usize>,
    /// Its `SCHED_FIFO` priority, 1 to 99.
    pub priority: u8,
    /// The machine's latency has been measured (`detect_ns` and `write_ns` stand in the file).
    pub latency_measured: bool,
}

/// The control socket and what belongs to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ControlConfig {
    /// Path of the Unix socket.
    pub socket: PathBuf,
    /// The group that may use it.
    pub group: Option<String>,
    /// What a restart takes over; `None` is beside the socket.
    pub state_file: Option<PathBuf>,
    /// Silence of the control side after which no insertion begins, ms.
    pub stale_ms: u64,
}

/// The machine model, live.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelConfig {
    /// The model that shall run; none where the file names none.
    pub file: Option<PathBuf>,
    /// Time between two evaluations, ms.
    pub period_ms: u64,
    /// How fast a correction goes to a new place that no motion of the axis asks for, µm/s.
    pub ramp_um_s: f64,
    /// How long before the axes are there it is evaluated, ms.
    pub lead_ms: f64,
    /// Time between two logged sets of temperatures, s.
    pub log_s: f64,
}

impl ControlConfig {
    /// Path of the state file: as configured, else beside the socket.
    #[must_use]
    pub fn state_path(&self) -> PathBuf {
        self.state_file.clone().unwrap_or_else(|| self.socket.with_file_name("state"))
    }
}

/// Everything that is wrong with a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigFindings(pub Vec<InputError>);

impl fmt::Display for ConfigFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (n, finding) in self.0.iter().enumerate() {
            if n > 0 {
                writeln!(f)?;
            }
            write!(f, "{finding}")?;
        }
        Ok(())
    }
}

impl std::error::Error for ConfigFindings {}

/// Directory of socket and state file unless the configuration names others: `/run/rtec` where it exists (made by
/// tmpfiles when installed), else the user's run-time directory, else one of the user's own in `/tmp`.
#[must_use]
pub fn default_directory() -> PathBuf {
    let installed = Path::new("/run/rtec");
    if installed.is_dir() {
        return installed.to_owned();
    }
    if let Some(directory) = std::env::var_os("XDG_RUNTIME_DIR").filter(|d| !d.is_empty()) {
        return Path::new(&directory).join("rtec");
    }
    Path::new("/tmp").join(format!("rtec-{}", std::env::var("USER").unwrap_or_else(|_| "user".to_owned())))
}

/// Path of an installed machine's configuration.
pub const INSTALLED: &str = "/etc/rtec/rtec.toml";

/// The configuration without a file: the mock card with three simulated axes.
pub const EMBEDDED: &str = include_str!("default.toml");

impl Config {
    /// The embedded default, [`EMBEDDED`].
    #[must_use]
    pub fn embedded() -> Self {
        match Self::parse(Path::new("embedded default"), EMBEDDED) {
            Ok(config) => config,
            // A constant of this program, covered by a test: it parses.
            Err(findings) => unreachable!("{findings}"),
        }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn load(file: &Path) -> Result<Self, ConfigFindings> {
        let text = rtec_files::text::read(file).map_err(|finding| ConfigFindings(vec![finding]))?;
        Self::parse(file, &text)
    }

    /// Checks the text of a file; paths in it are relative to the file's directory.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(file: &Path, text: &str) -> Result<Self, ConfigFindings> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let (document, findings) = Document::parse_all(file, text);
        let mut source = SourceFile { file, text, findings };
        let config = if source.findings.is_empty() { read(&mut source, &document) } else { None };
        source.findings.sort_by_key(|f| (f.line, f.column));
        match config {
            Some(config) if source.findings.is_empty() => Ok(config),
            _ => Err(ConfigFindings(source.findings)),
        }
    }

    /// What the engine needs to know of each axis.
    #[must_use]
    pub fn engine_axes(&self) -> Vec<AxisConfig> {
        self.axes.iter().map(|axis| axis.engine).collect()
    }

    /// Number of the axis of that name.
    #[must_use]
    pub fn axis(&self, name: &str) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }

    /// The axis that was probably meant.
    #[must_use]
    pub fn nearest_axis(&self, name: &str) -> Option<&str> {
        nearest(name, &self.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>())
    }
}

impl ConfiguredAxis {
    /// What the control law needs to know of it.
    #[must_use]
    pub fn law(&self) -> rtec_correct::AxisSetup {
        rtec_correct::AxisSetup {
            name: self.name.clone(),
            count_um: self.count_um,
            increment_counts: self.engine.design.increment_counts(),
            window_counts: self.engine.window_counts,
            max_counts: self.engine.max_correction_counts,
        }
    }
}

impl Card {
    /// Something outside this process hangs on the lines.
    fn is_real(&self) -> bool {
        matches!(self.kind, Some(Kind::Gpio | Kind::Mapped | Kind::Port))
    }
}

/// What `[card]` says; `None` fields were reported.
struct Card {
    kind: Option<Kind>,
    mapped: Option<MappedPlace>,
    port: Option<PortPlace>,
    profile: Option<Profile>,
    gpio: Gpio,
    lines: MachineLines,
    /// Who has taken which line: direction, bit.
    taken: BTreeMap<(bool, u8), String>,
}

/// GPIO lines as they are read, and what holds for those that say no more.
struct Gpio {
    setup: GpioSetup,
    default: GpioLine,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Mock,
    Gpio,
    Mapped,
    Port,
    Replay,
}

/// The file's whole content; findings are in the source, `None` where there is no way on.
fn read(source: &mut SourceFile<'_>, document: &Document<'_>) -> Option<Config> {
    let mut root = Section::root(document);
    let mut notes = Vec::new();

    let mut machine = root.table(source, "machine", "[machine]");
    let name = machine.string(source, "name", "the machine's name, in quotes");
    let name = machine.required(source, "name", "the machine's name, in quotes", name);
    machine.finish(source);

    let mut rt_table = root.table(source, "rt", "[rt]");
    let cpu = rt_table.integer(source, "cpu", 0..=4095);
    let priority = rt_table.integer(source, "priority", 1..=99);
    let detect_ns = rt_table.integer(source, "detect_ns", 0..=1_000_000_000);
    let write_ns = rt_table.integer(source, "write_ns", 0..=1_000_000_000);
    let guard_ns = rt_table.integer(source, "guard_ns", 0..=1_000_000_000);
    rt_table.finish(source);
    let ns = |at: Option<At<i64>>| at.map_or(0, |at| at.value as u64);
    let rt = RtConfig {
        cpu: cpu.map(|c| c.value as usize),
        priority: priority.map_or(80, |p| p.value as u8),
        latency_measured: detect_ns.is_some() && write_ns.is_some(),
    };
    let latency = AxisConfig {
        detect_ns: ns(detect_ns),
        write_ns: ns(write_ns),
        guard_ns: ns(guard_ns),
        ..AxisConfig::default()
    };

    let mut card = read_card(source, &mut root);
    if card.is_real() && !rt.latency_measured {
        notes.push(
            "[rt] has no detect_ns and write_ns: corrections cannot be enabled on this card before \
             `rtecctl selftest latency` has measured them and they stand here"
                .to_owned(),
        );
    }

    let tables = root.tables(source, "axis", "[[axis]]");
    if tables.is_empty() || tables.len() > MAX_AXES {
        let found = format!("{} [[axis]] tables", tables.len());
        source.finding(tables.last().map_or(0, |t| t.offset), found, format!("1 to {MAX_AXES} axes"));
    }
    let (mut axes, mut traces): (Vec<ConfiguredAxis>, Vec<PathBuf>) = (Vec::new(), Vec::new());
    for (n, table) in tables.into_iter().enumerate() {
        let offset = table.offset;
        if let Some((axis, trace)) = read_axis(source, table, n as u8, &mut card, &latency, &mut notes) {
            if let Some(first) = axes.iter().find(|a| a.name == axis.name) {
                let found = format!("a second axis named {}", first.name);
                source.finding(offset, found, "a name of its own for every axis");
            }
            axes.push(axis);
            traces.extend(trace);
        }
    }

    let mut control_table = root.table(source, "control", "[control]");
    let socket = control_table.string(source, "socket", "the path of the control socket");
    let group = control_table.string(source, "group", "the group that may use the socket");
    let state_file = control_table.string(source, "state_file", "the path of the state file");
    let stale_ms = control_table.integer(source, "stale_ms", 10..=60_000);
    control_table.finish(source);
    let model = read_model(source, &mut root);
    let sensors = if root.has("sensor") { read_sensors(source, &document.root()) } else { Vec::new() };
    root.finish(source);

    let relative = |path: &str| source.file.parent().unwrap_or(Path::new("")).join(path);
    let control = ControlConfig {
        state_file: state_file.map(|s| relative(s.value)),
        socket: socket.map_or_else(|| default_directory().join("control.sock"), |s| relative(s.value)),
        group: group.map(|g| g.value.to_owned()),
        stale_ms: stale_ms.map_or(500, |s| s.value as u64),
    };
    let kind = match card.kind? {
        Kind::Mock => CardConfig::Mock,
        Kind::Gpio => CardConfig::Gpio(card.gpio.setup),
        Kind::Mapped => CardConfig::Mapped { place: card.mapped?, profile: card.profile? },
        Kind::Port => CardConfig::Port { place: card.port?, profile: card.profile? },
        Kind::Replay => CardConfig::Replay { traces },
    };
    Some(Config {
        machine: name?.value.to_owned(),
        card: kind,
        lines: card.lines,
        axes,
        rt,
        control,
        model,
        sensors,
        notes,
    })
}

fn read_model(source: &mut SourceFile<'_>, root: &mut Section<'_>) -> ModelConfig {
    let mut table = root.table(source, "model", "[model]");
    let file = table.string(source, "file", "the path of the machine model");
    let period_ms = table.integer(source, "period_ms", 10..=20);
    let ramp_um_s = table.positive(source, "ramp_um_s", 1000.0);
    let lead_ms = table.positive(source, "lead_ms", 1000.0);
    let log_s = table.positive(source, "log_s", 60.0);
    table.finish(source);
    ModelConfig {
        file: file.map(|f| source.file.parent().unwrap_or(Path::new("")).join(f.value)),
        period_ms: period_ms.map_or(10, |p| p.value as u64),
        ramp_um_s: ramp_um_s.map_or(rtec_correct::RAMP_UM_S, |r| r.value),
        lead_ms: lead_ms.map_or(0.0, |l| l.value),
        log_s: log_s.map_or(5.0, |l| l.value),
    }
}

/// The `[[sensor]]` tables, as the model's library reads them; recordings to replay are beside the configuration.
fn read_sensors(source: &mut SourceFile<'_>, root: &Table<'_>) -> Vec<sensors::SensorConfig> {
    let file = source.file;
    let mut all = source.keep(sensors::read_tables(root)).unwrap_or_default();
    for sensor in &mut all {
        if let sensors::SensorSource::Csv { record, .. } = &mut sensor.source {
            *record = file.parent().unwrap_or(Path::new("")).join(&*record);
        }
    }
    all
}

fn read_card(source: &mut SourceFile<'_>, root: &mut Section<'_>) -> Card {
    let mut section = root.table(source, "card", "[card]");
    let meaning = "\"mock\" or \"gpio\" or \"mapped\" or \"port\" or \"replay\"";
    let kind = section.choice(
        source,
        "backend",
        5,
        &[
            ("mock", Kind::Mock),
            ("gpio", Kind::Gpio),
            ("mapped", Kind::Mapped),
            ("port", Kind::Port),
            ("replay", Kind::Replay),
        ],
    );
    let kind = section.required(source, "backend", meaning, kind);
    let mut card = Card {
        kind: kind.map(|k| k.value),
        mapped: None,
        port: None,
        profile: None,
        gpio: Gpio {
            setup: GpioSetup { inputs: Vec::new(), outputs: Vec::new(), events: true },
            default: GpioLine {
                chip: None,
                line: LineId::Offset(0),
                active_low: false,
                bias: None,
                drive: None,
            },
        },
        lines: MachineLines::standard(),
        taken: BTreeMap::new(),
    };
    match kind.map(|k| k.value) {
        Some(kind @ (Kind::Mapped | Kind::Port)) => {
            read_registers(source, &mut section, &mut card, kind == Kind::Port);
            card.lines = machine_lines(source, &mut section, &mut card);
            section.finish(source);
        }
        Some(Kind::Gpio) => {
            let mode = section.choice(source, "mode", 2, &[("edges", true), ("levels", false)]);
            card.gpio.setup.events = mode.is_none_or(|m| m.value);
            let chip = section.string(source, "chip", "a chip's name, path or label, as \"gpiochip0\"");
            card.gpio.default.chip = chip.map(|c| c.value.to_owned());
            card.gpio.default.bias = section.choice(source, "bias", 3, &BIASES).map(|b| b.value);
            card.gpio.default.drive = section.choice(source, "drive", 3, &DRIVES).map(|d| d.value);
            card.lines = machine_lines(source, &mut section, &mut card);
            section.finish(source);
        }
        // Without a backend nobody knows which keys belong to it.
        None => {}
        Some(Kind::Mock | Kind::Replay) => section.finish(source),
    }
    card
}

/// Where the registers are, and what they mean.
fn read_registers(source: &mut SourceFile<'_>, section: &mut Section<'_>, card: &mut Card, port: bool) {
    let directory = source.file.parent().unwrap_or(Path::new("")).to_owned();
    let named = section.string(source, "profile", "a profile's name or path");
    let default = if port { "parallel-port" } else { "shared-memory" };
    card.profile = match named {
        None => profile::shipped(default),
        Some(at) => profile::shipped(at.value)
            .or_else(|| load_profile(source, &directory.join(at.value), at.value, at.offset)),
    };
    let pci_at = section.string(source, "pci", "a card as \"1af4:1110\", or its address \"0000:00:04.0\"");
    let pci = pci_at.and_then(|at| {
        let id = PciId::parse(at.value);
        if id.is_none() {
            let expected =
                "vendor:device as \"1af4:1110\", or an address as \"0000:00:04.0\": lspci -nD shows both";
            source.finding(at.offset, format!("pci = \"{}\"", at.value), expected);
        }
        id
    });
    let bar = section.integer(source, "bar", 0..=5);
    // A card is looked for on the bus only when somebody has named it, or its profile.
    let place = card.profile.as_ref().filter(|_| named.is_some()).and_then(|p| p.pci);
    let bar_of = bar.map(|b| b.value as u8).or(place.map(|p| p.bar));
    let mut places = usize::from(pci_at.is_some());
    let path = |at: At<&str>| directory.join(at.value);
    if port {
        let parport = section.string(source, "parport", "a parallel port, as \"/dev/parport0\"");
        let io = section.integer(source, "io", 0..=0xffff);
        places += usize::from(parport.is_some()) + usize::from(io.is_some());
        card.port = parport.map(|at| PortPlace::Parport(path(at)));
        card.port = card.port.take().or(io.map(|io| PortPlace::Io(io.value as u16)));
        if let (Some(at), Some(profile)) = (parport, &card.profile)
            && profile.registers().any(|r| r.offset > 2 || r.width != Width::Bits8)
        {
            let found = format!("profile \"{}\" at {}", profile.name, at.value);
            let expected =
                "the registers of a parallel port (data, status, control); io or pci for other cards";
            source.finding(at.offset, found, expected);
        }
    } else {
        let file = section.string(source, "file", "the path of the file of registers");
        let uio = section.string(source, "uio", "a UIO device, as \"/dev/uio0\"");
        let map = section.integer(source, "map", 0..=4);
        places += usize::from(file.is_some()) + usize::from(uio.is_some());
        card.mapped = file.map(|at| MappedPlace::File(path(at)));
        let uio_map = map.map_or(0, |m| m.value as u8);
        card.mapped = card.mapped.take().or(uio.map(|at| MappedPlace::Uio(path(at), uio_map)));
        if let (Some(at), None) = (map, uio) {
            source.finding(at.offset, "map without uio", "uio = \"/dev/uio0\" beside it");
        }
    }
    let space = if port { Space::Io } else { Space::Memory };
    if let Some(place) = place.filter(|p| p.space != space) {
        let name = card.profile.as_ref().map_or("", |p| &p.name);
        let (found, backend) = match place.space {
            Space::Io => ("I/O ports", "port"),
            Space::Memory => ("mapped registers", "mapped"),
        };
        let found = format!("profile \"{name}\" of {found}");
        source.finding(named.map_or(section.offset, |p| p.offset), found, format!("backend = \"{backend}\""));
    }
    let of_profile = place.map(|p| PciId::Card(p.id.0, p.id.1)).filter(|_| places == 0);
    if let Some(id) = pci.or(of_profile) {
        match bar_of {
            Some(bar) if port => card.port = Some(PortPlace::Pci(id, bar)),
            Some(bar) => card.mapped = Some(MappedPlace::Pci(id, bar)),
            None => section.missing(source, "bar", "which base address register, 0 to 5"),
        }
    } else if places == 0 && card.profile.is_some() {
        let (key, meaning) = if port {
            (
                "parport, io or pci",
                "where the ports are: \"/dev/parport0\", 0x378, or a card's \"vendor:device\"",
            )
        } else {
            (
                "file, uio or pci",
                "where the registers are: a path, \"/dev/uio0\", or a card's \"vendor:device\"",
            )
        };
        section.missing(source, key, meaning);
    }
    if places > 1 {
        let found =
            if port { "more than one of parport, io and pci" } else { "more than one of file, uio and pci" };
        source.finding(section.offset, found, "one place where the registers are");
    }
    let no_pci = pci_at.is_none() && (places > 0 || place.is_none());
    if let Some(at) = bar.filter(|_| no_pci) {
        source.finding(at.offset, "bar without pci", "pci = \"vendor:device\" beside it");
    }
}

fn load_profile(source: &mut SourceFile<'_>, path: &Path, named: &str, offset: usize) -> Option<Profile> {
    let text = match rtec_files::text::read(path) {
        Ok(text) => text,
        Err(error) => {
            let found = format!("profile {}: {}", path.display(), error.found);
            source.finding(offset, found, profile::names_for(named));
            return None;
        }
    };
    source.keep(profile::parse(path, &text))
}

/// The lines that belong to no axis.
fn machine_lines(source: &mut SourceFile<'_>, section: &mut Section<'_>, card: &mut Card) -> MachineLines {
    let mut wire = |key, output| wire(source, section, card, key, output, (MAX_AXES as u8, "the machine"));
    MachineLines { probe: wire("probe", false), disable: wire("disable", false), hold: wire("hold", true) }
}

/// The bit of a GPIO line: the next that is free.
fn wire_gpio(
    source: &mut SourceFile<'_>,
    section: &mut Section<'_>,
    gpio: &mut Gpio,
    key: &'static str,
    output: bool,
    (group, owner): (u8, &str),
) -> Option<u8> {
    let At { value: line, offset } = gpio_line(section, source, key, &gpio.default)?;
    if line.chip.is_none() && matches!(line.line, LineId::Offset(_)) {
        let expected = "a name, or a chip too: chip = \"gpiochip0\" in [card], or in the line's own table";
        source.finding(offset, format!("{key} = {} on no chip", line.line), expected);
        return None;
    }
    let setup = &mut gpio.setup;
    let known = setup.inputs.iter().map(|i| &i.line).chain(setup.outputs.iter().map(|o| &o.line));
    if known.into_iter().any(|l| l.line == line.line && l.chip == line.chip) {
        let found = format!("{key} of {owner} on line {}, which is wired already", line.line);
        source.finding(offset, found, "a line of its own");
        return None;
    }
    // A' and B' are looked at when an inversion is in effect; their edges are of no use.
    let edges = !key.starts_with("read_back");
    let bit = if output { setup.outputs.len() } else { setup.inputs.len() } as u8;
    if output {
        setup.outputs.push(GpioOutput { line, bit });
    } else {
        setup.inputs.push(GpioInput { line, bit, group, edges });
    }
    Some(bit)
}

/// The bit of one line, checked against the profile and against who has it already.
fn wire(
    source: &mut SourceFile<'_>,
    section: &mut Section<'_>,
    card: &mut Card,
    key: &'static str,
    output: bool,
    (group, owner): (u8, &str),
) -> Option<u8> {
    if card.kind == Some(Kind::Gpio) {
        return wire_gpio(source, section, &mut card.gpio, key, output, (group, owner));
    }
    let at = line(section, source, key)?;
    let profile = card.profile.as_ref()?;
    let direction = if output { "an output" } else { "an input" };
    let bit = match at.value {
        LineName::Name(name) => match (profile.lines.get(name), output) {
            (Some(Place::Input(bit)), false) | (Some(Place::Output(bit)), true) => *bit,
            (found, _) => {
                let what = if found.is_some() { ", which goes the other way" } else { "" };
                let names: Vec<&str> = profile.lines.keys().map(String::as_str).collect();
                let hint = match nearest(name, &names) {
                    Some(near) if near != name => format!("; did you mean \"{near}\"?"),
                    _ => String::new(),
                };
                let expected = format!("{direction} line of profile \"{}\"{hint}", profile.name);
                source.finding(at.offset, format!("{key} = \"{name}\"{what}"), expected);
                return None;
            }
        },
        LineName::Bit(bit) => {
            let registers = if output { &profile.outputs } else { &profile.inputs };
            let bits: u32 = registers.iter().map(|r| r.width.bits()).sum();
            if u32::from(bit) >= bits {
                let expected = format!("{direction} bit of profile \"{}\", 0 to {}", profile.name, bits - 1);
                source.finding(at.offset, format!("{key} = {bit}"), expected);
                return None;
            }
            bit
        }
    };
    let owner = format!("{key} of {owner}");
    if let Some(first) = card.taken.get(&(output, bit)) {
        source.finding(at.offset, format!("{owner} on bit {bit}, which is {first}"), "a line of its own");
        return None;
    }
    card.taken.insert((output, bit), owner);
    Some(bit)
}

/// The lines of an axis: where `lines` says, or those of the standard layout.
fn read_lines(
    source: &mut SourceFile<'_>,
    section: &mut Section<'_>,
    n: u8,
    card: &mut Card,
    owner: &str,
) -> Option<AxisLines> {
    if !card.is_real() {
        if card.kind.is_some() && section.has("lines") {
            let expected = "no lines: the mock and the replay have theirs in fixed places";
            source.finding(section.offset, format!("lines of {owner}"), expected);
        }
        return Some(AxisLines::standard(n, card.kind == Some(Kind::Mock)));
    }
    let meaning = "{ a = \"in0\", b = \"in1\", invert_a = \"out0\", invert_b = \"out1\" }";
    if !section.has("lines") {
        section.missing(source, "lines", meaning);
        return None;
    }
    let mut lines = section.table(source, "lines", "lines");
    let mut place = |source: &mut SourceFile<'_>, key, output, needed| {
        let bit = wire(source, &mut lines, card, key, output, (n, owner));
        if needed { lines.required(source, key, "the line it is wired to", bit) } else { bit }
    };
    let a = place(source, "a", false, true);
    let b = place(source, "b", false, true);
    let invert_a = place(source, "invert_a", true, true);
    let invert_b = place(source, "invert_b", true, true);
    let back = (place(source, "read_back_a", false, false), place(source, "read_back_b", false, false));
    let read_back = match back {
        (Some(a), Some(b)) => Some((a, b)),
        (None, None) => None,
        _ => {
            source.finding(lines.offset, "one of read_back_a and read_back_b", "both, or neither");
            None
        }
    };
    lines.finish(source);
    Some(AxisLines { a: a?, b: b?, invert_a: invert_a?, invert_b: invert_b?, read_back })
}

#[allow(clippy::too_many_lines)] // One key after the other.
fn read_axis(
    source: &mut SourceFile<'_>,
    mut s: Section<'_>,
    n: u8,
    card: &mut Card,
    latency: &AxisConfig,
    notes: &mut Vec<String>,
) -> Option<(ConfiguredAxis, Option<PathBuf>)> {
    let before = source.findings.len();
    let meaning = "the axis's name, in quotes";
    let name = s.string(source, "name", meaning);
    let name = s.required(source, "name", meaning, name);
    let owner = name.map_or_else(|| format!("axis {n}"), |name| format!("axis {}", name.value));
    let count_um = s.positive(source, "count_um", 1000.0);
    let count_um = s.required(source, "count_um", "what one count is worth, µm", count_um);
    let travel_mm = s.positive(source, "travel_mm", 1e6);
    let travel_mm = s.required(source, "travel_mm", "the length of its travel, mm", travel_mm);
    let design = s.choice(
        source,
        "design",
        3,
        &[
            ("c", Some(Design::C)),
            ("original", Some(Design::Original)),
            ("a", Some(Design::A)),
            ("b", None),
            ("ecc", None),
        ],
    );
    if let Some(at) = design.filter(|d| d.value.is_none()) {
        let expected = "\"c\", \"original\" or \"a\": b and ecc pass the signals through the computer, and exist \
                        in simulation only (rtecctl designs)";
        source.finding(at.offset, "a design that cannot drive XOR gates", expected);
    }
    let design = design.map_or(Some(Design::C), |d| d.value);
    let max = s.integer(source, "max_correction_counts", 1..=1_000_000_000);
    let max = s.required(source, "max_correction_counts", "the largest total correction, counts", max);
    let window = s.integer(source, "window_counts", 1..=1_000_000_000);
    let window = s.required(source, "window_counts", "the largest change believed at once, counts", window);
    let separation = s.integer(source, "min_separation_ns", 1..=1_000_000_000);
    let meaning = "what the MTC's decoder needs between two edges, ns";
    let separation = s.required(source, "min_separation_ns", meaning, separation);
    let accel_mm = s.positive(source, "max_accel_mm_s2", 1e9);
    let accel_counts = s.positive(source, "max_accel_counts_s2", 1e15);
    if let (Some(_), Some(at)) = (accel_mm, accel_counts) {
        source.finding(at.offset, "max_accel_mm_s2 and max_accel_counts_s2", "one of the two");
    }
    if card.is_real() && !s.has("max_accel_mm_s2") && !s.has("max_accel_counts_s2") {
        s.missing(
            source,
            "max_accel_mm_s2",
            "the axis's acceleration limit, mm/s²: the speed gate stands on it",
        );
    }
    let hysteresis = s.positive(source, "hysteresis_counts", 1000.0);
    let warn = s.integer(source, "warn_counts", 1..=1_000_000_000);
    let error = s.integer(source, "error_counts", 1..=1_000_000_000);
    if let (Some(warn), Some(error)) = (warn, error)
        && warn.value > error.value
    {
        let found = format!("warn_counts = {} above error_counts = {}", warn.value, error.value);
        source.finding(warn.offset, found, "the warning before the error");
    }
    if let (Some(error), Some(max)) = (error, max)
        && error.value > max.value
    {
        let found = format!("error_counts = {} above max_correction_counts = {}", error.value, max.value);
        source.finding(
            error.offset,
            found,
            "a limit that a request can reach: beyond the maximum it is refused",
        );
    }
    let rate = s.positive(source, "max_rate_counts_s", 1e9);
    let rest = s.choice(source, "rest_policy", 2, &[("wait", false), ("insert", true)]);
    let quiet_ms = s.positive(source, "rest_quiet_ms", 1e6);
    let insert = rest.is_some_and(|r| r.value);
    match (insert, quiet_ms, rest) {
        (true, None, Some(at)) if !s.has("rest_quiet_ms") => {
            source.finding(
                at.offset,
                "rest_policy = \"insert\" alone",
                "rest_quiet_ms too: after how many ms",
            );
        }
        (false, Some(at), _) => {
            let expected = "rest_policy = \"insert\" beside it, or no rest_quiet_ms";
            source.finding(at.offset, "rest_quiet_ms with rest_policy = \"wait\"", expected);
        }
        _ => {}
    }
    let simulated = read_simulated(source, &mut s, card.kind);
    let budget = s.integer(source, "reference_budget_counts", 1..=1_000_000_000);
    let home_mm = s.signed(source, "home_mm", 1e6);
    let lines = read_lines(source, &mut s, n, card, &owner);
    let mut trace = None;
    if card.kind == Some(Kind::Replay) {
        let meaning = "the recorded trace of this axis, .csv or .vcd";
        let path = s.string(source, "trace", meaning);
        trace = s
            .required(source, "trace", meaning, path)
            .map(|p| source.file.parent().unwrap_or(Path::new("")).join(p.value));
    }
    if let (Some(max), Some(um), Some(mm)) = (max, count_um, travel_mm)
        && max.value as f64 * um.value > mm.value * 1000.0
    {
        let found = format!("max_correction_counts = {} on a travel of {} mm", max.value, mm.value);
        source.finding(max.offset, found, "a correction smaller than the travel");
    }
    let offset = s.offset;
    if card.kind.is_none() {
        // Without a card nobody knows whether these belong here.
        let _ = (s.has("lines"), s.has("trace"));
    }
    s.finish(source);
    if source.findings.len() > before {
        return None;
    }

    let (count_um, max, name) = (count_um?.value, max?, name?.value);
    if let Some(budget) = budget
        && budget.value < max.value
    {
        notes.push(format!(
            "{owner}: max_correction_counts = {} is capped at {}, the budget that the MTC leaves between reference \
             marks or encoders",
            max.value, budget.value
        ));
    }
    let max_accel_counts_s2 = match (accel_mm, accel_counts) {
        (Some(mm), _) => mm.value * 1000.0 / count_um,
        (None, Some(counts)) => counts.value,
        (None, None) => latency.max_accel_counts_s2,
    };
    let engine = AxisConfig {
        lines: lines?,
        design: design?,
        max_correction_counts: budget.map_or(max.value, |b| b.value.min(max.value)),
        window_counts: window?.value,
        warn_counts: warn.map_or(i64::MAX, |w| w.value),
        error_counts: error.map_or(i64::MAX, |e| e.value),
        max_rate_counts_s: rate.map_or(f64::INFINITY, |r| r.value),
        min_separation_ns: separation?.value as u64,
        max_accel_counts_s2,
        hysteresis_counts: hysteresis.map_or(latency.hysteresis_counts, |h| h.value),
        rest: match quiet_ms {
            Some(ms) if insert => RestPolicy::Insert { after_ns: (ms.value * 1e6) as u64 },
            _ => RestPolicy::Wait,
        },
        ..*latency
    };
    if engine.gate().is_none() {
        let found = format!("{owner}: no speed leaves time for an insertion");
        let expected =
            "a lower max_accel, detect_ns, write_ns, guard_ns or min_separation_ns, or more hysteresis";
        source.finding(offset, found, expected);
    }
    let axis = ConfiguredAxis {
        name: name.to_owned(),
        count_um,
        travel_mm: travel_mm?.value,
        home_counts: (home_mm.map_or(0.0, |h| h.value) * 1000.0 / count_um).round() as i64,
        reference_budget_counts: budget.map(|b| b.value),
        engine,
        simulated: Simulated { count_um: simulated.count_um.unwrap_or(count_um), ..simulated.rest },
    };
    Some((axis, trace))
}

/// What `simulated` says; as configured where it says nothing.
struct ReadSimulated {
    count_um: Option<f64>,
    rest: Simulated,
}

fn read_simulated(source: &mut SourceFile<'_>, s: &mut Section<'_>, kind: Option<Kind>) -> ReadSimulated {
    let mut found = ReadSimulated {
        count_um: None,
        rest: Simulated { count_um: 1.0, compensates_ppm: 0.0, ignores: false },
    };
    if !s.has("simulated") {
        return found;
    }
    let mut table = s.table(source, "simulated", "simulated");
    if kind != Some(Kind::Mock) {
        source.finding(
            table.offset,
            "simulated",
            "backend = \"mock\": no other card has a simulated machine",
        );
    }
    found.count_um = table.signed(source, "count_um", 1000.0).map(|c| c.value).filter(|c| *c != 0.0);
    found.rest.compensates_ppm = table.signed(source, "compensates_ppm", 1e5).map_or(0.0, |p| p.value);
    let ignores = table.choice(source, "feedback", 2, &[("used", false), ("ignored", true)]);
    found.rest.ignores = ignores.is_some_and(|i| i.value);
    table.finish(source);
    found
}
