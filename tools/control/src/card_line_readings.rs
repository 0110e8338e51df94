//! Readings of a card's wired lines, and whether its outputs switch.

use crate::card_opening::{self, CardAccess, CardOpenError, CardOperation, LocatedRegisters};
use crate::config::{CardConfig, Config};
use rtec_driver::card::{Card, CardError};
use rtec_driver::card_profile::{CardProfile, Register};
use rtec_driver::gpio::{self, GpioCardConfig};
use rtec_driver::port_io::{IoPorts, Parport};
use rtec_driver::register_card::RegisterAccess;
use serde::Serialize;
use std::time::Duration;

/// A wired line.
#[derive(Debug, Clone)]
pub struct WiredLine {
    /// Its axis and its key in the configuration.
    pub name: String,
    /// Its bit in the card's inputs or outputs.
    pub bit: u8,
    /// Whether it is an output.
    pub output: bool,
}

/// The lines that a configuration names.
pub fn wires(config: &Config) -> Vec<WiredLine> {
    let of_axes = config.axes.iter().flat_map(|axis| {
        let l = &axis.engine.lines;
        let (back_a, back_b) = l.read_back.unzip();
        let lines = [
            ("a", Some(l.a), false),
            ("b", Some(l.b), false),
            ("read_back_a", back_a, false),
            ("read_back_b", back_b, false),
            ("invert_a", Some(l.invert_a), true),
            ("invert_b", Some(l.invert_b), true),
        ];
        lines.map(|(key, bit, output)| (format!("{}.{key}", axis.name), bit, output))
    });
    let l = config.lines;
    let machine = [
        ("probe", l.probe, false),
        ("disable", l.disable, false),
        ("mtc_ready", l.mtc_ready, false),
        ("hold", l.hold, true),
    ];
    let of_machine = machine.map(|(key, bit, output)| (key.to_owned(), bit, output));
    let wired = |(name, bit, output)| Some(WiredLine { name, bit: bit?, output });
    of_axes.chain(of_machine).filter_map(wired).collect()
}

/// Readings of a card's registers and wired lines.
#[derive(Debug, Serialize)]
pub struct CardReading {
    /// The profile's name; GPIO lines have none.
    pub card: Option<String>,
    /// The wired lines.
    pub lines: Vec<LineReading>,
    /// The registers.
    pub registers: Vec<RegisterReading>,
}

/// A register as it was read.
#[derive(Debug, Serialize)]
pub struct RegisterReading {
    /// Its width, bits.
    pub bits: u32,
    /// Meaning of the value; often empty.
    pub means: String,
    /// Byte offset.
    pub offset: usize,
    /// Purpose of the register in the profile.
    #[serde(rename = "use")]
    pub purpose: &'static str,
    /// The value read.
    pub value: u32,
}

/// A wired line as it was read.
#[derive(Debug, Serialize)]
pub struct LineReading {
    /// Its bit, if registers were read.
    pub bit: Option<u8>,
    /// `input` or `output`.
    pub direction: &'static str,
    /// The kernel's description of a GPIO line.
    pub kernel: Option<String>,
    /// Its logical level (active low already inverted).
    pub level: Option<u8>,
    /// Its axis and its key.
    pub line: String,
}

impl LineReading {
    fn of(wire: WiredLine, level: Option<u8>, kernel: Option<String>) -> Self {
        let direction = if wire.output { "output" } else { "input" };
        Self { line: wire.name, direction, bit: level.map(|_| wire.bit), level, kernel }
    }
}

/// Reads every line without requesting, enabling or setting up anything.
///
/// # Errors
/// When the card cannot be opened or does not answer, or has no lines outside the daemon.
pub fn read(config: &Config) -> Result<CardReading, CardOpenError> {
    match &config.card {
        CardConfig::Mock | CardConfig::Replay { .. } => Err(CardOpenError::NoLines(config.card.backend())),
        CardConfig::Gpio(setup) => read_gpio(config, setup),
        CardConfig::Registers { place, profile } => {
            match card_opening::find(place, profile, CardAccess::Read)? {
                LocatedRegisters::Map(file, map) => {
                    read_registers(config, &card_opening::open_map(&file, map, profile)?, profile)
                }
                LocatedRegisters::Parport(file) => read_registers(config, &Parport::open(&file)?, profile),
                LocatedRegisters::Ports(base) => {
                    read_registers(config, &IoPorts::open(base, profile.size())?, profile)
                }
            }
        }
    }
}

/// Reads every register, and the wired lines as logical levels.
fn read_registers(
    config: &Config,
    bus: &impl RegisterAccess,
    profile: &CardProfile,
) -> Result<CardReading, CardOpenError> {
    let mut registers = Vec::new();
    let mut read = |r: Register, purpose, means: &dyn Fn(u32) -> String| -> Result<u32, CardError> {
        let value = bus.read(r.offset, r.width)?;
        let (bits, means) = (r.width.bits(), means(value));
        registers.push(RegisterReading { offset: r.offset, bits, purpose, value, means });
        Ok(value)
    };
    let nothing = &|_| String::new();
    let mut words = [0, 0];
    for (word, (registers, purpose)) in
        words.iter_mut().zip([(&profile.inputs, "input"), (&profile.outputs, "output")])
    {
        let mut shift = 0;
        for r in registers {
            *word |= u64::from(read(*r, purpose, nothing)?) << shift;
            shift += r.width.bits();
        }
    }
    for s in &profile.setup {
        let is = |value| match value {
            value if value == s.order.value => "set up",
            value if value == s.after_reset => "after a reset: rtecd sets it up",
            _ => "neither set up nor after a reset: is this the card?",
        };
        read(s.order.register, "set-up", &|value| is(value).to_owned())?;
    }
    for c in &profile.counters {
        let latched = if c.latch.is_some() { "as last latched" } else { "as it is" };
        read(c.count, "count", &|_| format!("of inputs {} and {}, {latched}", c.lines.0, c.lines.1))?;
        for (purpose, flag) in [("overflow", c.overflow), ("error", c.error)] {
            let Some(flag) = flag else { continue };
            let is = |value: u32| if value >> flag.bit & 1 == 1 { "SET" } else { "clear" };
            read(flag.register, purpose, &|value| format!("bit {} is {}", flag.bit, is(value)))?;
        }
    }
    let words = [words[0] ^ profile.input_invert, words[1] ^ profile.output_invert];
    let level = |w: &WiredLine| (words[usize::from(w.output)] >> w.bit & 1) as u8;
    let lines = wires(config).into_iter().map(|w| {
        let level = level(&w);
        LineReading::of(w, Some(level), None)
    });
    Ok(CardReading { card: Some(profile.name.clone()), lines: lines.collect(), registers })
}

/// The kernel's description of the lines.
/// They are not requested, because a request can turn a line into an output.
fn read_gpio(config: &Config, setup: &GpioCardConfig) -> Result<CardReading, CardOpenError> {
    let mut lines = Vec::new();
    for wire in wires(config) {
        let line = if wire.output {
            setup.outputs.iter().find(|o| o.bit == wire.bit).map(|o| &o.line)
        } else {
            setup.inputs.iter().find(|i| i.bit == wire.bit).map(|i| &i.line)
        };
        let kernel = line.map(gpio::look).transpose()?;
        lines.push(LineReading::of(wire, None, kernel));
    }
    Ok(CardReading { card: None, registers: Vec::new(), lines })
}

/// An output that was switched over and back.
#[derive(Debug, Serialize)]
pub struct OutputSwitchResult {
    /// Inputs that changed with it.
    pub followed_by: Vec<String>,
    /// Its axis and its key.
    pub line: String,
    /// The card read back what was written, both times.
    pub reads_back: bool,
}

/// Time for gates, receivers and the card's input filter.
const SETTLED: Duration = Duration::from_millis(20);

/// Switches each output over and back.
/// `told` is called after each. The MTC must be off.
///
/// # Errors
/// When the card cannot be opened or does not answer, or has no lines outside the daemon.
pub fn switch_outputs(config: &Config, told: impl FnMut(OutputSwitchResult)) -> Result<(), CardOpenError> {
    let mut named = config.card.clone();
    if let CardConfig::Gpio(setup) = &mut named {
        // Level mode reads the present levels; with edges it would have to wait for them.
        setup.events = false;
    }
    Ok(card_opening::with(&named, CardAccess::Drive, OutputSwitchTest { config, on_switched: told })??)
}

struct OutputSwitchTest<'a, T> {
    config: &'a Config,
    on_switched: T,
}

impl<T: FnMut(OutputSwitchResult)> CardOperation for OutputSwitchTest<'_, T> {
    type Output = Result<(), CardError>;

    fn on<C: Card + Send + 'static>(mut self, mut card: C) -> Self::Output {
        let wires = wires(self.config);
        for wire in wires.iter().filter(|w| w.output) {
            let mask = 1 << wire.bit;
            let before = card.outputs()?;
            let inputs = card.sample(0)?.inputs;
            card.write(mask, !before & mask)?;
            std::thread::sleep(SETTLED);
            let (switched, followed) = (card.outputs(), card.sample(0));
            // The line is switched back first, whatever was read.
            card.write(mask, before & mask)?;
            std::thread::sleep(SETTLED);
            let back = card.outputs()?;
            let changed = followed?.inputs ^ inputs;
            let reads_back = switched? == before ^ mask && back == before;
            let follows = wires.iter().filter(|w| !w.output && changed >> w.bit & 1 == 1);
            let followed_by = follows.map(|w| w.name.clone()).collect();
            (self.on_switched)(OutputSwitchResult { line: wire.name.clone(), reads_back, followed_by });
        }
        Ok(())
    }
}
