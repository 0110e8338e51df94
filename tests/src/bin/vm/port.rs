//! The parallel port, and a card of I/O ports.

use super::{AXIS, EDGE, agreed, armed, corrected, daemon, refused};
use anyhow::{Context, ensure};
use rtec_driver::card_profile::{AddressSpace, Width};
use rtec_driver::pci::{self, PciFunctionSelector};
use rtec_driver::port_io::IoPorts;
use rtec_driver::quadrature::State;
use rtec_driver::register_card::RegisterAccess;
use rtec_tests::daemon::{Daemon, Lines, Machine};
use std::fs;
use std::path::Path;
use std::process::Command;

/// Writes to the data lines by each way to the port.
/// They are +4 counts (A and B equal: A first), then −2 counts (B first).
const PORT_WRITES: [(&str, &[u8]); 2] = [("ppdev", &[1, 3, 2, 0]), ("ioperm", &[2, 3])];

pub(super) fn port() -> anyhow::Result<Vec<String>> {
    // The inputs cannot be driven here, so the axis is at rest and is corrected at rest.
    let axis = AXIS.replace("min_separation_ns = 160000000", "min_separation_ns = 1000000")
        + "rest_policy = 'insert'\nrest_quiet_ms = 5\n\
           lines = { a = 'nerror', b = 'select', invert_a = 'd0', invert_b = 'd1' }\n";
    let mut said = Vec::new();
    for (place, way, counts) in [("parport = '/dev/parport0'", "ppdev", 4), ("io = 0x378", "ioperm", -2)] {
        let (corrector, _held) = daemon(&format!("backend = 'port'\n{place}\n"), &axis)?;
        armed(&corrector);
        corrected(&corrector, counts);
        said.push(format!("{way}: {counts:+} counts at rest, ledger balances"));
    }
    let (code, text) = refused(
        "backend = 'port'\nprofile = '8255-pci'\n",
        &axis.replace(
            "'nerror', b = 'select', invert_a = 'd0', invert_b = 'd1'",
            "'pa0', b = 'pa1', invert_a = 'pc0', invert_b = 'pc1'",
        ),
    )?;
    ensure!(code == Some(3) && text.contains("no PCI card 144a:7224"), "{code:?}: {text}");
    said.extend(io_bar()?);
    Ok(said)
}

/// A PCI card of I/O ports: QEMU's `pci-serial`.
/// It is a 16550 looped back on itself: its modem outputs are its modem inputs, and the machine sets A and B there. Its
/// scratch register holds the inverters. Its line control must be set up once.
const UART: &str = "name = 'a 16550 as a card'\nsource = 'PC16550D datasheet: line control at 3, modem control at 4, modem status \
    at 6, scratch at 7; bit 4 of modem control loops back'\n\
    inputs = [{ register = 6, width = 8 }]\noutputs = [{ register = 7, width = 8 }]\n\
    [lines]\ncts = { input = 4 }\ndsr = { input = 5 }\ns0 = { output = 0 }\ns1 = { output = 1 }\n\
    [pci]\nid = '1b36:0002'\nbar = 0\nspace = 'io'\n\
    [[setup]]\nregister = 3\nwidth = 8\nvalue = 0x03\nafter_reset = 0x00\n";
const LINE_CONTROL: usize = 3;
const MODEM_CONTROL: usize = 4;
const SCRATCH: usize = 7;

/// The machine's side of that card.
struct Uart(IoPorts);

impl Uart {
    fn set(&self, register: usize, value: u32) -> anyhow::Result<()> {
        Ok(self.0.write(register, Width::Bits8, value)?)
    }

    fn get(&self, register: usize) -> anyhow::Result<u32> {
        Ok(self.0.read(register, Width::Bits8)?)
    }
}

impl Lines for Uart {
    fn outputs(&mut self) -> u64 {
        u64::from(self.get(SCRATCH).unwrap_or(0))
    }

    fn show(&mut self, scale: State) {
        // DTR comes back as DSR, and RTS as CTS. A write to a port that this thread may use cannot fail.
        let _ = self.set(MODEM_CONTROL, 0x10 | u32::from(scale.bits()));
    }
}

fn io_bar() -> anyhow::Result<Vec<String>> {
    let directory = tempfile::tempdir()?;
    let profile = directory.path().join("uart.toml");
    fs::write(&profile, UART)?;
    let card = format!("backend = 'port'\nprofile = '{}'\n", profile.display());
    let axis = format!("{AXIS}lines = {{ a = 'dsr', b = 'cts', invert_a = 's0', invert_b = 's1' }}\n");
    let uart = pci::find(&PciFunctionSelector::Card(0x1b36, 2))?;

    // The kernel's own driver holds the card.
    let (code, text) = refused(&card, &axis)?;
    let held = format!("PCI card {} is in the hands of the kernel's driver serial", uart.address);
    ensure!(code == Some(3) && text.contains(&held), "{code:?}: {text}");
    // The remedy as printed.
    let remedy =
        text.split("free the card: ").nth(1).context("no remedy")?.lines().next().unwrap_or("").trim();
    let freed = Command::new("/bin/sh").args(["-ec", remedy]).output()?;
    ensure!(freed.status.success(), "{remedy}: {}", String::from_utf8_lossy(&freed.stderr));

    let base = uart.prepare(0, AddressSpace::Io, 8)?.start as u16;
    let far = Uart(IoPorts::open(base, 8)?);
    let look = Uart(IoPorts::open(base, 8)?);
    for (register, value) in [(LINE_CONTROL, 0x1b), (SCRATCH, 0), (MODEM_CONTROL, 0x10)] {
        far.set(register, value)?;
    }
    let (code, text) = refused(&card, &axis)?;
    ensure!(
        code == Some(3) && text.contains("register 0x3 reads 0x1b, expected 0x3 (set up)"),
        "{code:?}: {text}"
    );
    ensure!(look.get(LINE_CONTROL)? == 0x1b, "it was written to all the same");
    far.set(LINE_CONTROL, 0)?;
    let machine = Machine::paced(far, EDGE);
    let (corrector, held) = daemon(&card, &axis)?;
    ensure!(look.get(LINE_CONTROL)? == 3, "not set up");
    armed(&corrector);
    machine.move_axis(true);
    for counts in [4, 0] {
        corrected(&corrector, counts);
        agreed(&machine, counts);
    }
    // Killed with the inverters on: they stay on, and the next daemon takes them over.
    corrected(&corrector, 2);
    agreed(&machine, 2);
    corrector.end("KILL");
    ensure!(look.get(SCRATCH)? == 3, "the inverters are {:#x}", look.get(SCRATCH)?);
    let corrector = Daemon::start(&held.path().join("s"), Some(&held.path().join("rtec.toml")));
    ensure!(corrector.status()["axes"][0]["completed"] == 2, "{}", corrector.status());
    agreed(&machine, 2);
    let probed = corrector.expect(0, &["status"]);
    ensure!(probed.contains("ledger balances"), "{probed}");
    Ok(vec![
        "a PCI card that the kernel's driver has is refused, and freed by the command that is printed"
            .to_owned(),
        "I/O BAR by in and out: set up once, +4 counts and back, killed with inverters on and taken over"
            .to_owned(),
    ])
}

/// Compares the emulated port's log with the data writes that are due.
/// They are the last writes of each way, in order, one line at a time.
pub(super) fn port_seen(log: &Path, console: &Path) -> anyhow::Result<()> {
    let console = fs::read_to_string(console)?;
    ensure!(
        console.lines().filter(|l| l.starts_with("ITEM 3: ") && l.contains("at rest")).count() == 2,
        "the port was not driven"
    );
    let text = fs::read_to_string(log).with_context(|| format!("{}", log.display()))?;
    let hex = |word: &str| u8::from_str_radix(word.trim_start_matches("0x"), 16).ok();
    let data: Vec<u8> = text
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace().skip_while(|w| *w != "addr").skip(1);
            let (address, _, value) = (words.next()?, words.next()?, words.next()?);
            // The two bits of the inverters; the third bit is feed hold.
            (hex(address)? % 8 == 0).then(|| hex(value).map(|v| v & 3))?
        })
        .collect();
    let mut from = 0;
    for (way, wanted) in PORT_WRITES {
        let found = data[from..].windows(wanted.len()).position(|w| w == wanted);
        let at = found.with_context(|| {
            format!("{way}: no {wanted:02x?} among the data writes {:02x?}", &data[from..])
        })?;
        from += at + wanted.len();
        println!("the emulated port saw, by {way}: {wanted:02x?}");
    }
    ensure!(from == data.len(), "writes that change nothing, or nobody asked for: {:02x?}", &data[from..]);
    Ok(())
}
