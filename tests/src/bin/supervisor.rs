//! `supervisor`: kills a daemon on a simulated machine again and again.
//! It is the daemon's service manager, and keeps its file descriptors over each `kill -9`.
//!
//! ```text
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --card FILE
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --gpio-sim DIR --lines A,B,INVERT_A,INVERT_B
//! ```
//!
//! It exits with 1 at the first illegal transition or jump at the MTC, or unlatched imbalance.

use clap::Parser;
use rtec_tests::daemon::Machine;
use rtec_tests::gpio_sim::GpioSim;
use rtec_tests::supervisor::Trial;
use std::path::PathBuf;
use std::time::Duration;

/// Kill rtecd at random moments while it corrects a moving axis
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
    /// Shared-memory card of the simulated machine; the file is created
    #[arg(long, value_name = "FILE", required_unless_present = "gpio_sim")]
    card: Option<PathBuf>,
    /// Simulated GPIO chip of the machine: its directory in /sys/devices/platform
    #[arg(long, value_name = "DIR", requires = "lines", conflicts_with = "card")]
    gpio_sim: Option<PathBuf>,
    /// Offsets of A, B and their inverters on the simulated chip
    #[arg(long, value_name = "A,B,IA,IB", value_delimiter = ',', num_args = 4)]
    lines: Vec<u32>,
    /// Time between two edges of the axis, ms
    #[arg(long, default_value_t = 400)]
    edge_ms: u64,
    /// Number of kills
    #[arg(long, default_value_t = 20)]
    kills: u32,
    /// Seed of the random moments and totals
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn main() -> anyhow::Result<()> {
    let Args { rtecd, config, socket, card, gpio_sim, lines, edge_ms, kills, seed } = Args::parse();
    let machine = match (card, gpio_sim) {
        (_, Some(directory)) => {
            Machine::paced(GpioSim::open(&directory, &lines)?, Duration::from_millis(edge_ms))
        }
        (Some(card), None) => Machine::start(&card),
        (None, None) => unreachable!("clap requires one of them"),
    };
    let within = Duration::from_millis(1200);
    let tally = Trial { rtecd, config, socket, kills, seed, within }.run(&machine, std::io::stderr())?;
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
