//! `rtecctl designs`: every insertion design on the same motion and computer.
//! The designs are those of the sources.

use crate::prelude::*;
use rtec_files::options::number;
use rtec_sim::bench::InsertionDesign;
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::insertion_designs::{TestMotion, compare, waveforms};

/// Compare the insertion designs: increment, time, safe speed, rest, what happens when the computer dies
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The computer that does the insertions
    #[arg(long, value_enum, default_value = "8051")]
    computer: ComputerModel,
    /// Instead: this PC, as `rtecctl selftest latency --json` measured it
    #[arg(long, value_name = "FILE", conflicts_with = "computer")]
    latency: Option<PathBuf>,
    // At the slow end a motion takes hours; no real edge is faster than the other end.
    /// Speed of the motion, as encoder frequency in Hz (a quarter of the count rate)
    #[arg(long, value_name = "HZ", default_value_t = TestMotion::default().encoder_hz, value_parser = number(|v| (0.1..=1e8).contains(&v), "expected a number from 1e-1 to 1e8 Hz"))]
    encoder_hz: f64,
    /// Acceleration of the motion, counts/s²
    #[arg(long, value_name = "A", default_value_t = TestMotion::default().accel_counts_s2, value_parser = number(|v| (1.0..=1e12).contains(&v), "expected a number from 1e0 to 1e12 counts/s²"))]
    accel: f64,
    /// Length of each way of the motion, counts
    #[arg(long, value_name = "N", default_value_t = TestMotion::default().counts,
          value_parser = clap::value_parser!(u64).range(100..=10_000_000))]
    counts: u64,
    /// Seed of all noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Draw the waveforms (A, B, A', B', count) of every design into this directory
    #[arg(long, value_name = "DIR", num_args = 0..=1, default_missing_value = ".")]
    plot: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum ComputerModel {
    /// 8051 at 12 MHz (NISTIR 4832)
    #[value(name = "8051")]
    I8051,
    /// A digital signal processor, 100 ns an instruction
    Dsp,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let computer = match (&args.latency, args.computer) {
        (Some(file), _) => ComputerTiming::measured(file)?,
        (None, ComputerModel::I8051) => ComputerTiming::i8051(),
        (None, ComputerModel::Dsp) => ComputerTiming::dsp(),
    };
    let motion = TestMotion {
        encoder_hz: args.encoder_hz,
        accel_counts_s2: args.accel,
        counts: args.counts,
        ..TestMotion::default()
    };
    eprintln!("rtecctl: running five designs on: {}", computer.name);
    let comparison = compare(&computer, motion, args.seed);
    if let Some(dir) = &args.plot {
        std::fs::create_dir_all(dir).with_context(|| format!("making {}", dir.display()))?;
        for design in InsertionDesign::ALL {
            let file = dir.join(format!("design-{}.svg", design.name()));
            let svg = waveforms(design, &computer, 3);
            crate::document::write(&file, &svg)?;
            eprintln!("rtecctl: wrote {}", file.display());
        }
    }
    answer(args.json, &comparison, || comparison.to_table())
}
