//! `rtec.toml`: machine, card, axes, real-time thread and control sockets.
//!
//! `keys` lists the keys of each table with allowed values, default and meaning; the guide's reference is made from it.
//!
//! A controller that checks counts between reference marks, or compares two encoders, sees a correction as an
//! error. `reference_budget_counts` says how much of it the controller tolerates, and limits
//! `max_correction_counts`.

mod axis;
mod card;
mod control;
mod keys;
mod local_resource_checks;
mod rt_latency_figures;

pub use control::{
    ConfiguredSocket, ControlConfig, LONGEST_SOCKET, RoleSocketConfig, default_directory, derived,
};
pub use keys::reference;
pub use rt_latency_figures::{LatencyTestConditions, floors_ns};

use card::CardBackend;
use rtec_driver::card::MachineLines;
use rtec_driver::card_profile::{AddressSpace, CardProfile};
use rtec_driver::gpio::GpioCardConfig;
use rtec_driver::pci::PciFunctionSelector;
use rtec_files::strict_toml::Document;
use rtec_files::toml_section_keys::{FileWithFindings, LocatedValue, TomlSection};
use rtec_files::{InputError, nearest};
use rtec_model::file_kind::FileKind;
use rtec_rt::axis::{AxisConfig, INCREMENT_COUNTS};
use rtec_rt::link_messages::MAX_AXES;
use rtec_sensors::SensorConfig;
use std::fmt;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// A machine's configuration, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The machine's name, as `status` shows it.
    pub machine: String,
    /// The card and what its backend needs (`[card]`).
    pub card: CardConfig,
    /// The machine's own lines: probe, disable switch, MTC ready, hold.
    pub lines: MachineLines,
    /// Feed hold is on while the MTC is off.
    pub hold_without_mtc: bool,
    /// The axes, in order.
    pub axes: Vec<ConfiguredAxis>,
    /// The real-time thread (`[rt]`).
    pub rt: RtConfig,
    /// The control socket and what belongs to it (`[control]`).
    pub control: ControlConfig,
    /// The machine model and how it is evaluated (`[model]`).
    pub model: ModelConfig,
    /// The temperature sensors (`[[sensor]]`).
    pub sensors: Vec<SensorConfig>,
    /// Settings that are allowed but deserve attention.
    pub notes: Vec<String>,
}

/// A card and its backend's settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CardConfig {
    /// Simulated axes in the daemon's own process.
    Mock,
    /// GPIO lines through the kernel's character device.
    Gpio(GpioCardConfig),
    /// Registers, mapped into memory or as I/O ports.
    Registers {
        /// Location of the registers.
        place: RegisterPlace,
        /// Meaning of each register and bit.
        profile: CardProfile,
    },
    /// Recorded traces in real time, one per axis.
    Replay {
        /// The trace of each axis.
        traces: Vec<PathBuf>,
    },
}

/// Location of registers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RegisterPlace {
    /// A file that is mapped: shared memory, a resource in sysfs.
    File(PathBuf),
    /// A UIO device, and the number of its map.
    Uio(PathBuf, u8),
    /// A parallel port's device.
    Parport(PathBuf),
    /// The address of the first I/O port.
    Io(u16),
    /// A BAR of a PCI card.
    Pci(PciFunctionSelector, u8, AddressSpace),
}

impl RegisterPlace {
    /// Whether the registers are in memory or are I/O ports.
    pub const fn space(&self) -> AddressSpace {
        match self {
            Self::File(_) | Self::Uio(..) => AddressSpace::Memory,
            Self::Parport(_) | Self::Io(_) => AddressSpace::Io,
            Self::Pci(_, _, space) => *space,
        }
    }
}

impl fmt::Display for RegisterPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(file) | Self::Parport(file) => write!(f, "{}", file.display()),
            Self::Uio(file, map) => write!(f, "{} map {map}", file.display()),
            Self::Io(base) => write!(f, "{base:#x}"),
            Self::Pci(id, bar, _) => write!(f, "{id} BAR {bar}"),
        }
    }
}

/// The backend of registers in an address space.
const fn backend_of(space: AddressSpace) -> &'static str {
    match space {
        AddressSpace::Memory => "mapped",
        AddressSpace::Io => "port",
    }
}

impl CardConfig {
    /// The name in `[card] backend`.
    pub const fn backend(&self) -> &'static str {
        match self {
            Self::Mock => "mock",
            Self::Gpio(_) => "gpio",
            Self::Registers { place, .. } => backend_of(place.space()),
            Self::Replay { .. } => "replay",
        }
    }

    /// Whether the lines lead out of this process.
    pub const fn is_real(&self) -> bool {
        matches!(self, Self::Gpio(_) | Self::Registers { .. })
    }

    /// Whether a machine may be connected to the lines.
    /// Only an existing plain file of registers rules it out. Corrections then need measured latencies.
    pub fn may_drive_a_machine(&self) -> bool {
        match self {
            Self::Registers { place: RegisterPlace::File(file), .. } => {
                !file.is_file() || file.starts_with("/sys")
            }
            _ => self.is_real(),
        }
    }
}

/// One axis as `[[axis]]` configures it.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfiguredAxis {
    /// The axis's name.
    pub name: String,
    /// Size of one count, µm.
    pub count_um: f64,
    /// Length of its travel, mm.
    pub travel_mm: f64,
    /// Position at which it is homed, counts.
    pub home_counts: i64,
    /// Rapid: its highest speed, mm/min.
    pub rapid_mm_min: Option<f64>,
    /// The card counts its edges in hardware, at any rate.
    pub counted: bool,
    /// Difference that the MTC tolerates between marks or encoders, counts.
    pub reference_budget_counts: Option<i64>,
    /// The engine's configuration of the axis.
    pub engine: AxisConfig,
    /// With the mock card: the simulated machine's real properties.
    pub simulated: SimulatedAxisDeviations,
}

/// Properties of a simulated axis that may differ from its configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedAxisDeviations {
    /// Real size of one count, µm; negative if it counts backwards.
    pub count_um: f64,
    /// Compensation by its own controller, ppm.
    pub compensates_ppm: f64,
    /// Its controller ignores the corrected feedback.
    pub ignores: bool,
}

/// Settings of the real-time thread (`[rt]`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RtConfig {
    /// Its CPU; `None` leaves the choice to the machine.
    pub cpu: Option<usize>,
    /// Its `SCHED_FIFO` priority, 1 to 99.
    pub priority: u8,
    /// The file gives measured latencies of the machine (`detect_ns` and `write_ns`).
    pub latency_measured: bool,
    /// Where and when they were measured; none if the file does not say.
    pub measured: Option<LatencyTestConditions>,
}

/// The machine model that runs in the daemon: the keys of `[model]`.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // the table of keys describes them
pub struct ModelConfig {
    pub file: Option<PathBuf>,
    pub period_ms: u64,
    pub ramp_um_s: f64,
    pub lead_ms: f64,
    pub log_s: f64,
}

/// All mistakes of a configuration.
/// With them the notes about what it names on this computer, if that was checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigFindings(pub Vec<InputError>, pub Vec<String>);

impl fmt::Display for ConfigFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (n, finding) in self.0.iter().enumerate() {
            if n > 0 {
                writeln!(f)?;
            }
            write!(f, "{finding}")?;
        }
        for note in &self.1 {
            write!(f, "\nnote: {note}")?;
        }
        Ok(())
    }
}

impl std::error::Error for ConfigFindings {}

/// Path of an installed machine's configuration.
pub const INSTALLED: &str = "/etc/rtec/rtec.toml";

/// The configuration without a file: the mock card with three simulated axes.
pub const EMBEDDED: &str = include_str!("default.toml");

impl Config {
    /// The embedded default, [`EMBEDDED`].
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
        Self::parse(file, &text_of(file)?)
    }

    /// As [`Config::load`], and checks on this computer what the file names.
    /// It looks for groups, cards, devices, recordings and the model.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn check_here(file: &Path) -> Result<Self, ConfigFindings> {
        Self::parse_for(file, &text_of(file)?, true)
    }

    /// Checks the text of a file; paths in it are relative to the file's directory.
    ///
    /// # Errors
    /// Everything that is wrong with it.
    pub fn parse(file: &Path, text: &str) -> Result<Self, ConfigFindings> {
        Self::parse_for(file, text, false)
    }

    fn parse_for(file: &Path, text: &str, here: bool) -> Result<Self, ConfigFindings> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        if let Some(other) = FileKind::of(text).filter(|k| *k != FileKind::Configuration) {
            let finding = FileKind::Configuration.instead(file, other);
            return Err(ConfigFindings(vec![finding], Vec::new()));
        }
        let (document, findings) = Document::parse_all(file, text);
        let mut source = FileWithFindings { file, text, findings: first_causes(text, findings) };
        let config = if source.findings.is_empty() { read(&mut source, &document, here) } else { None };
        source.findings.sort_by_key(|f| (f.line, f.column));
        match config {
            Some(config) if source.findings.is_empty() => Ok(config),
            config => {
                let notes = config.filter(|_| here).map_or_else(Vec::new, |config| config.notes);
                Err(ConfigFindings(source.findings, notes))
            }
        }
    }

    /// The engine's configuration of each axis.
    pub fn engine_axes(&self) -> Vec<AxisConfig> {
        self.axes.iter().map(|axis| axis.engine).collect()
    }

    /// Identity of machine, card and lines, as text; a state file belongs to one.
    pub fn identity(&self) -> String {
        let card = match &self.card {
            CardConfig::Mock | CardConfig::Replay { .. } => self.card.backend().to_owned(),
            CardConfig::Gpio(setup) => {
                let inputs = setup.inputs.iter().map(|i| (&i.line, i.bit));
                let outputs = setup.outputs.iter().map(|o| (&o.line, o.bit));
                let lines = inputs.chain(outputs).map(|(line, bit)| {
                    let chip = line.chip.as_deref().unwrap_or("any chip");
                    let low = if line.active_low { " active low" } else { "" };
                    format!("{bit} {chip} {}{low}", line.line)
                });
                format!("gpio ({})", lines.collect::<Vec<_>>().join(", "))
            }
            CardConfig::Registers { place, profile } => {
                format!("{} {place} ({})", self.card.backend(), profile.name)
            }
        };
        let mut text = format!("machine \"{}\" on card {card}", self.machine);
        for axis in &self.axes {
            let lines = axis.engine.lines;
            // Writing to a String does not fail.
            let _ = write!(
                text,
                "; axis {} on a {} b {} inverters {} {}",
                axis.name, lines.a, lines.b, lines.invert_a, lines.invert_b
            );
        }
        text
    }

    /// Number of the axis of that name.
    pub fn axis(&self, name: &str) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }

    /// The axis of that name for a replay, or the first; `file` is the configuration.
    ///
    /// # Errors
    /// There is no such axis.
    pub fn replayed_axis(&self, file: &Path, name: Option<&str>) -> Result<AxisConfig, InputError> {
        let Some(name) = name else { return Ok(self.axes[0].engine) };
        let axis = self.axes.iter().find(|axis| axis.name == name).ok_or_else(|| {
            let names: Vec<&str> = self.axes.iter().map(|a| a.name.as_str()).collect();
            InputError::whole(file, format!("no axis {name}"), names.join(" or "))
        })?;
        Ok(axis.engine)
    }

    /// The axis whose name is most similar.
    pub fn nearest_axis(&self, name: &str) -> Option<&str> {
        nearest(name, &self.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>())
    }
}

impl ConfiguredAxis {
    /// The axis's settings for the control law.
    pub fn axis_setup(&self) -> rtec_correct::AxisCorrectionSettings {
        rtec_correct::AxisCorrectionSettings {
            name: self.name.clone(),
            count_um: self.count_um,
            increment_counts: INCREMENT_COUNTS,
            window_counts: self.engine.window_counts,
            max_counts: self.engine.max_correction_counts,
        }
    }
}

/// Reads a configuration's text; if there is none, says how to get one.
fn text_of(file: &Path) -> Result<String, ConfigFindings> {
    rtec_files::text_file::read(file).map_err(|mut finding| {
        if !file.exists() {
            "a configuration: `rtecctl config default > rtec.toml` begins one"
                .clone_into(&mut finding.expected);
        }
        ConfigFindings(vec![finding], Vec::new())
    })
}

/// Reads the whole file.
/// Findings go to `source`; `None` if reading cannot continue.
fn read(source: &mut FileWithFindings<'_>, document: &Document<'_>, here: bool) -> Option<Config> {
    let mut root = TomlSection::root(document);
    let mut notes = Vec::new();

    let mut machine = root.table(source, "machine", "[machine]").with(keys::MACHINE);
    let name = machine.text(source, "name");
    let mtc_off = machine.pick(source, "mtc_off", &[false, true]);
    machine.finish(source);

    let mut rt_table = root.table(source, "rt", "[rt]").with(keys::RT);
    let cpu = rt_table.whole(source, "cpu");
    let priority = rt_table.whole_or_default(source, "priority");
    let [detect_ns, write_ns, guard_ns] =
        ["detect_ns", "write_ns", "guard_ns"].map(|key| rt_table.whole(source, key));
    let measured = rt_latency_figures::read_measured(source, &mut rt_table);
    rt_table.finish(source);
    if here {
        rt_latency_figures::check_cpu(source, cpu);
    }
    let ns = |at: Option<LocatedValue<i64>>| at.map_or(0, |at| at.value as u64);
    let rt = RtConfig {
        cpu: cpu.map(|c| c.value as usize),
        priority: priority as u8,
        latency_measured: detect_ns.is_some() && write_ns.is_some(),
        measured,
    };
    let latency = AxisConfig {
        detect_ns: ns(detect_ns),
        write_ns: ns(write_ns),
        guard_ns: ns(guard_ns),
        ..AxisConfig::default()
    };

    let mut card = card::read(source, &mut root, here);
    if let Some(at) = mtc_off.filter(|_| card.lines.mtc_ready.is_none()) {
        source.finding(at.offset, "mtc_off without mtc_ready", "mtc_ready in [card]: the line that tells it");
    }
    let tables = root.tables(source, "axis", "[[axis]]");
    if tables.is_empty() || tables.len() > MAX_AXES {
        let found = format!("{} [[axis]] tables", tables.len());
        source.finding(tables.last().map_or(0, |t| t.offset), found, format!("1 to {MAX_AXES} axes"));
    }
    let (mut axes, mut traces): (Vec<ConfiguredAxis>, Vec<PathBuf>) = (Vec::new(), Vec::new());
    for (n, table) in tables.into_iter().enumerate() {
        let offset = table.offset;
        if let Some((axis, trace)) =
            axis::read(source, table.with(keys::AXIS), n as u8, &mut card, &latency, &mut notes)
        {
            if let Some(first) = axes.iter().find(|a| a.name.eq_ignore_ascii_case(&axis.name)) {
                let found = if first.name == axis.name {
                    format!("a second axis named {}", first.name)
                } else {
                    format!("axis {} beside axis {}", axis.name, first.name)
                };
                source.finding(offset, found, "a name of its own for every axis, and not by its case alone");
            }
            axes.push(axis);
            traces.extend(trace);
        }
    }

    let control = control::read(source, &mut root, here);
    notes.extend(control::notes(&control, here));
    let model = read_model(source, &mut root);
    let sensors = rtec_sensors::read_tables(source, &mut root);
    root.finish(source);

    let kind = match card.kind? {
        CardBackend::Mock => CardConfig::Mock,
        CardBackend::Gpio => CardConfig::Gpio(card.gpio.setup),
        CardBackend::Registers(_) => CardConfig::Registers { place: card.place?, profile: card.profile? },
        CardBackend::Replay => CardConfig::Replay { traces },
    };
    rt_latency_figures::check_floors(source, &kind, detect_ns, write_ns);
    if kind.may_drive_a_machine() {
        if !rt.latency_measured {
            let unmeasured = "[rt] has no detect_ns and write_ns: corrections cannot be enabled on this card before `rtecctl selftest \
                              latency` has measured them and they stand here";
            notes.insert(0, unmeasured.to_owned());
        }
        for axis in &axes {
            let unset = "rapid_mm_min is not set: corrections cannot be enabled before it says how fast the axis moves";
            let unset = axis.rapid_mm_min.is_none().then(|| format!("axis {}: {unset}", axis.name));
            notes.extend(unset.or_else(|| axis.outruns()));
        }
    }
    let mut config = Config {
        machine: name?.value.to_owned(),
        card: kind,
        lines: card.lines,
        hold_without_mtc: mtc_off.is_some_and(|m| m.value),
        axes,
        rt,
        control,
        model,
        sensors,
        notes,
    };
    if here {
        local_resource_checks::look(source, document, &mut config);
    }
    Some(config)
}

fn read_model(source: &mut FileWithFindings<'_>, root: &mut TomlSection<'_>) -> ModelConfig {
    let mut table = root.table(source, "model", "[model]").with(keys::MODEL);
    let file = table.text(source, "file").map(|at| beside(source.file, at.value));
    let model = ModelConfig {
        file,
        period_ms: table.whole_or_default(source, "period_ms") as u64,
        ramp_um_s: table.number_or_default(source, "ramp_um_s"),
        lead_ms: table.number_or_default(source, "lead_ms"),
        log_s: table.number_or_default(source, "log_s"),
    };
    table.finish(source);
    model
}

/// A path of a configuration is relative to its file.
fn beside(file: &Path, path: &str) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(path)
}

/// Keeps the first causes.
/// A line that is not TOML spoils the lines after it, so findings directly after another are dropped.
fn first_causes(text: &str, findings: Vec<InputError>) -> Vec<InputError> {
    let lines: Vec<&str> = text.lines().collect();
    let blank = |line: usize| {
        lines.get(line.wrapping_sub(1)).is_none_or(|l| l.trim().is_empty() || l.trim_start().starts_with('#'))
    };
    let (mut kept, mut last) = (Vec::new(), None::<usize>);
    for finding in findings {
        let follows = last.is_some_and(|last| (last + 1..finding.line).all(blank));
        last = last.max(Some(finding.line));
        if !follows {
            kept.push(finding);
        }
    }
    // Beyond the first few, cause and consequence cannot be told apart.
    kept.truncate(5);
    kept
}
