//! `supervisor`: a service manager that keeps file descriptors, a machine on a card, and `kill -9` in between.
//!
//! ```text
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --card FILE
//! supervisor --rtecd PATH --config rtec.toml --socket PATH --gpio-sim DIR --lines A,B,INVERT_A,INVERT_B
//! ```
//!
//! Exit 1 at the first illegal transition or jump at the MTC, or unlatched imbalance.

use clap::Parser;
use rtec_tests::daemon::Machine;
use rtec_tests::gpio_sim::GpioSim;
use rtec_tests::supervisor::Trial;
use std::path::PathBuf;
use std::time::Duration;

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
    /// Time between two edges of the axis, ms
    #[arg(long, default_value_t = 400)]
    edge_ms: u64,
    /// How often it is killed
    #[arg(long, default_value_t = 20)]
    kills: u32,
    /// Of the random moments and totals
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
