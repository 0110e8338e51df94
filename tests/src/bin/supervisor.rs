//! `supervisor`: a service manager that keeps file descriptors, a machine on a card, and `kill -9` in between.
//!
//! ```text
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --card FILE
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --gpio-sim DIR --lines A,B,INVERT_A,INVERT_B
//! ```
//!
//! Exit 1 at the first illegal transition or jump at the MTC, or unlatched imbalance.

use anyhow::Context;
use clap::Parser;
use rtec_driver::quadrature::State;
use rtec_tests::daemon::{Lines, Machine};
use rtec_tests::supervisor::Trial;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Kills rtecd at random moments while it corrects a moving axis, and passes its file descriptors on
#[derive(Debug, Parser)]
struct Args {
    /// The daemon
    #[arg(long, value_name = "PATH")]
    rtecd: PathBuf,
    /// Its configuration, with one axis
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Its control socket
    #[arg(long, value_name = "PATH")]
    socket: PathBuf,
    /// The shared-memory card that the machine is played on; it is made anew
    #[arg(long, value_name = "FILE", required_unless_present = "gpio_sim")]
    card: Option<PathBuf>,
    /// The simulated chip that the machine is played on: its directory in /sys/devices/platform
    #[arg(long, value_name = "DIR", requires = "lines", conflicts_with = "card")]
    gpio_sim: Option<PathBuf>,
    /// Offsets of A, B and their inverters on the simulated chip
    #[arg(long, value_name = "A,B,IA,IB", value_delimiter = ',', num_args = 4)]
    lines: Vec<u32>,
    /// How often it is killed
    #[arg(long, default_value_t = 20)]
    kills: u32,
    /// Of the random moments and totals
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Lines of the kernel's gpio-sim, from outside.
struct GpioSim {
    pulls: [File; 2],
    values: [File; 2],
    shown: Option<State>,
}

impl GpioSim {
    fn open(directory: &Path, lines: &[u32]) -> anyhow::Result<Self> {
        let open = |line: u32, name: &str| {
            let path = directory.join(format!("sim_gpio{line}/{name}"));
            let file = File::options().read(true).write(name == "pull").open(&path);
            file.with_context(|| format!("{}", path.display()))
        };
        let pulls = [open(lines[0], "pull")?, open(lines[1], "pull")?];
        let values = [open(lines[2], "value")?, open(lines[3], "value")?];
        Ok(Self { pulls, values, shown: None })
    }
}

impl Lines for GpioSim {
    fn outputs(&mut self) -> u64 {
        let mut outputs = 0;
        for (n, value) in self.values.iter().enumerate() {
            let mut text = [0];
            // A line that cannot be read is not on: the trial ends with a jump, as it should.
            let read = value.read_at(&mut text, 0).is_ok();
            outputs |= u64::from(read && text[0] == b'1') << n;
        }
        outputs
    }

    fn show(&mut self, scale: State) {
        let before = self.shown.replace(scale);
        for (n, pull) in self.pulls.iter().enumerate() {
            let high = |s: State| s.bits() >> n & 1 == 1;
            if before.is_none_or(|b| high(b) != high(scale)) {
                let text: &[u8] = if high(scale) { b"pull-up" } else { b"pull-down" };
                let _ = pull.write_at(text, 0); // an edge that does not come shows as a jump
            }
        }
    }
}

fn main() -> anyhow::Result<()> {
    let Args { rtecd, config, socket, card, gpio_sim, lines, kills, seed } = Args::parse();
    let machine = match (card, gpio_sim) {
        (_, Some(directory)) => Machine::on(GpioSim::open(&directory, &lines)?),
        (Some(card), None) => Machine::start(&card),
        (None, None) => unreachable!("clap requires one of them"),
    };
    let tally = Trial { rtecd, config, socket, kills, seed }.run(&machine, std::io::stderr())?;
    println!(
        "{} kills ({} between two inversions, {} with the inverters on), {} descriptors kept: no illegal transition, no \
         jump, every ledger balanced or latched ({})",
        tally.kills,
        tally.halfway,
        tally.inverted,
        tally.stored,
        if tally.faults.is_empty() { "no fault".to_owned() } else { tally.faults.join(", ") }
    );
    Ok(())
}
