//! The PCI card in memory, and the machine at its other end on the host.

use super::{AXIS, EDGE, armed, corrected, daemon, refused};
use anyhow::{Context, ensure};
use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_driver::card_profile::{AddressSpace, CardProfile, Width};
use rtec_driver::clock::Clock;
use rtec_driver::mapped_registers::{MappedCard, MappedRegisterFile};
use rtec_driver::pci::{self, PciFunctionSelector};
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::RequestToRt;
use rtec_tests::daemon::{Machine, until};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Words of the card's memory beside its registers.
/// The profile `shared-memory` has the inputs at 0 and the outputs at 4.
const TICK: usize = 0x10;
const SEEN: usize = 0x14;
const PHASE: usize = 0x18;
const AT: usize = 0x1c;
const OFFSET: usize = 0x20;
const ILLEGAL: usize = 0x24;
const SCALE: usize = 0x28;
const BUSY: usize = 0x2c;
const BYTES: usize = 0x40;
/// Commands to the far side.
const SLOW: u32 = 1;
const STEPPED: u32 = 2;
const END: u32 = 3; // the host says it when the machine is off

/// Counts of the stepped run.
/// A count takes six steps, some 40 000 counts/s. An insertion takes four of them; the last one shows that the second
/// inversion is in effect.
const COUNTS: u32 = 1_000_000;
const COUNT_STEPS: u32 = 6;
const STEP_NS: u64 = 4_000;

/// The machine at the card's other end, on the host.
/// It does what the guest asks for until it is told to end.
pub(super) fn far_side(file: &Path) -> anyhow::Result<()> {
    let words = MappedRegisterFile::open(file, BYTES, "far side")?;
    let phase = || words.read(PHASE, Width::Bits32);
    let say = |offset: i64, illegal: u64| {
        words.write(OFFSET, Width::Bits32, offset as u32);
        words.write(ILLEGAL, Width::Bits32, illegal as u32);
    };
    let (mut illegal, mut counts) = (0, 0);
    loop {
        let now = phase();
        match now {
            SLOW => {
                let machine = Machine::paced(MappedRegisterFile::open(file, 8, "machine")?, EDGE);
                machine.move_axis(true);
                words.write(AT, Width::Bits32, now);
                while phase() == now {
                    say(machine.offset(), machine.illegal());
                    std::thread::sleep(Duration::from_millis(1));
                }
                illegal += machine.illegal();
            }
            STEPPED => {
                let (scale, mtc) = in_step(&words, &say, &phase);
                println!(
                    "far side, in step: scale {scale}, controller {}, {} illegal",
                    mtc.count(),
                    mtc.illegal()
                );
                illegal += mtc.illegal();
                counts += scale;
            }
            END => break,
            _ => std::thread::sleep(Duration::from_millis(1)),
        }
    }
    println!("far side of the PCI card: {counts} counts in step, {illegal} illegal transitions in all");
    ensure!(illegal == 0 && counts >= i64::from(COUNTS), "not what was asked for");
    Ok(())
}

/// Runs in step with the guest: time advances only when the guest has acted.
/// It advances by one step while the guest has something to do, else to two steps before the next edge. An edge right
/// after a late look may be as old as that look, and has no period.
fn in_step(words: &MappedRegisterFile, say: &impl Fn(i64, u64), phase: &impl Fn() -> u32) -> (i64, Decoder) {
    let lines = AxisLines::standard(0, false);
    let (mut state, mut mtc, mut scale, mut tick) =
        (State::default(), Decoder::new(State::default()), 0_i64, 0_u32);
    words.write(0, Width::Bits32, 0);
    words.write(AT, Width::Bits32, STEPPED);
    while phase() == STEPPED {
        let outputs = || u64::from(words.read(4, Width::Bits32));
        let idle = words.read(BUSY, Width::Bits32) == 0;
        tick += if idle { (COUNT_STEPS - 2).saturating_sub(tick % COUNT_STEPS).max(1) } else { 1 };
        // The axis moves on beyond the counted run, so that the last request can still be served.
        if tick.is_multiple_of(COUNT_STEPS) {
            state = state.next(true);
            scale += 1;
            words.write(0, Width::Bits32, u32::from(state.bits()));
            mtc.update(state.inverted(lines.inverters(outputs())));
        }
        words.write(TICK, Width::Bits32, tick);
        let mut spins = 0_u64;
        while words.read(SEEN, Width::Bits32) != tick && phase() == STEPPED {
            spins += 1;
            // The guest may need this CPU to go on.
            if spins.is_multiple_of(4096) {
                std::thread::yield_now();
            }
        }
        mtc.update(state.inverted(lines.inverters(outputs())));
        say(mtc.count() - scale, mtc.illegal());
        words.write(SCALE, Width::Bits32, scale as u32);
    }
    (scale, mtc)
}

/// A clock that shows the far side's time.
struct FarTime(MappedRegisterFile);

impl Clock for FarTime {
    fn now_ns(&mut self) -> u64 {
        u64::from(self.0.read(TICK, Width::Bits32)) * STEP_NS
    }
}

/// The card under test, which looks once at every step of the far side.
struct InStep {
    card: MappedCard<FarTime>,
    words: MappedRegisterFile,
    tick: u32,
}

impl Card for InStep {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let now_ns = u64::from(self.tick) * STEP_NS;
        let busy = wake_ns < now_ns + u64::from(COUNT_STEPS) * STEP_NS;
        self.words.write(BUSY, Width::Bits32, u32::from(busy));
        self.words.write(SEEN, Width::Bits32, self.tick);
        while self.words.read(TICK, Width::Bits32) == self.tick {
            std::hint::spin_loop();
        }
        self.tick = self.words.read(TICK, Width::Bits32);
        self.card.sample(wake_ns)
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.card.write(mask, value)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        self.card.outputs()
    }
}

/// Enables the card's BAR and maps it; also returns its file in sysfs.
fn bar() -> anyhow::Result<(MappedRegisterFile, PathBuf)> {
    let profile = CardProfile::shared_memory();
    let place = profile.pci.context("the profile's place on the bus")?;
    let card = pci::find(&PciFunctionSelector::Card(place.id.0, place.id.1))?;
    let file = card.prepare(place.bar, AddressSpace::Memory, BYTES)?.file;
    Ok((MappedRegisterFile::open(&file, BYTES, "vm")?, file))
}

fn phase(words: &MappedRegisterFile, phase: u32) {
    words.write(PHASE, Width::Bits32, phase);
    until("the far side follows", || words.read(AT, Width::Bits32) == phase);
}

pub(super) fn mapped() -> anyhow::Result<Vec<String>> {
    let mut said = Vec::new();
    let (words, file) = bar()?;
    said.push(through_rtecd(&words, "pci = '1af4:1110'\nbar = 2", "PCI 1af4:1110, BAR 2 by sysfs")?);
    let (code, text) = refused("backend = 'mapped'\npci = '1af4:1110'\nbar = 1\n", &on_card())?;
    ensure!(code == Some(3) && text.contains("BAR 1: found none"), "{code:?}: {text}");
    said.push(a_million(&words, &file)?);
    drop(words);

    // A driver that maps the BARs by UIO takes the card, and the mapping by sysfs is then invalid. The override that
    // the README names keeps other drivers away until it is removed.
    let device = file.parent().context("a directory")?;
    fs::write(device.join("driver_override"), "pci-stub")?;
    fs::write("/sys/bus/pci/drivers/hilscher/new_id", "1af4 1110")?;
    ensure!(!device.join("driver").exists(), "a driver took the card in spite of driver_override");
    said.push("driver_override keeps other drivers away".to_owned());
    fs::write(device.join("driver_override"), "\n")?;
    let address = device.file_name().and_then(|n| n.to_str()).context("an address")?;
    fs::write("/sys/bus/pci/drivers/hilscher/bind", address)?;
    let uio = Path::new("/dev/uio0");
    until("the UIO device", || uio.exists());
    let words = MappedRegisterFile::open_map(uio, 1, BYTES, "vm")?;
    said.push(through_rtecd(&words, "uio = '/dev/uio0'\nmap = 1", "the same BAR by UIO")?);
    Ok(said)
}

fn on_card() -> String {
    format!("{AXIS}lines = {{ a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }}\n")
}

/// Makes a few counts through the daemon, with a slow machine at the other end.
fn through_rtecd(words: &MappedRegisterFile, card: &str, way: &str) -> anyhow::Result<String> {
    phase(words, SLOW);
    let (corrector, _held) = daemon(&format!("backend = 'mapped'\n{card}\n"), &on_card())?;
    armed(&corrector);
    for counts in [4, 0] {
        corrected(&corrector, counts);
        until("the controller counts it", || {
            assert_eq!(words.read(ILLEGAL, Width::Bits32), 0, "illegal transitions at the controller");
            i64::from(words.read(OFFSET, Width::Bits32) as i32) == counts
        });
    }
    Ok(format!("{way}: +4 counts and back through rtecd, ledger balances"))
}

/// Counts a million with the engine itself, in step with the machine.
fn a_million(words: &MappedRegisterFile, file: &Path) -> anyhow::Result<String> {
    phase(words, STEPPED);
    let clock = FarTime(MappedRegisterFile::open(file, BYTES, "vm")?);
    let card = MappedCard::open(file, &CardProfile::shared_memory(), clock)?;
    let mut card = InStep { card, words: MappedRegisterFile::open(file, BYTES, "vm")?, tick: 0 };
    let axis = AxisConfig {
        max_correction_counts: 100_000,
        detect_ns: STEP_NS,
        write_ns: STEP_NS,
        ..AxisConfig::default()
    };
    let config = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let mut engine = Engine::new(&mut card, &[axis], config, &[])?;
    let report = &mut |_| true;
    engine.start_homed(&mut card, report)?;
    let (mut requests, mut looks) = (0, 0_u64);
    loop {
        engine.poll(&mut card, u64::MAX, report)?;
        looks += 1;
        if !looks.is_multiple_of(500) {
            continue;
        }
        let axis = engine.status().axes[0];
        ensure!(!axis.faults.any(), "{:?}", axis.faults.iter().collect::<Vec<_>>());
        let last = words.read(SCALE, Width::Bits32) >= COUNTS;
        if last && axis.completed == 0 && axis.requested == 0 && engine.at_rest() {
            break;
        }
        requests += 1;
        let total_counts = if last { 0 } else { 2 * ((f64::from(requests) / 40.0).sin() * 200.0) as i64 };
        engine.take(RequestToRt::Correct { axis: 0, total_counts, large: true }, &mut card, report)?;
    }
    let (axis, balanced) = (engine.status().axes[0], engine.status().balanced());
    let counted = i64::from(words.read(OFFSET, Width::Bits32) as i32);
    ensure!(balanced && counted == axis.completed, "{counted}, {axis:?}");
    ensure!(words.read(ILLEGAL, Width::Bits32) == 0, "illegal transitions at the controller");
    ensure!(axis.insertions > 1000, "{} insertions only", axis.insertions);
    Ok(format!(
        "{} counts of the scale, {requests} requests, {} insertions; ledger balances, controller minus scale {counted}",
        words.read(SCALE, Width::Bits32),
        axis.insertions,
    ))
}
