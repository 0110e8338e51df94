//! `rtecctl designs`: every insertion design on the same motion and computer.
//! The designs are those of the sources.

use crate::prelude::*;
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::insertion_design_bench::InsertionDesign;
use rtec_sim::insertion_design_comparison::{TestMotion, compare, waveforms};

/// Compare the insertion designs: increment, time, safe speed, rest, what happens when the computer dies
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The computer that does the insertions
    #[arg(long, value_enum, default_value = "8051")]
    computer: ComputerModel,
    /// Instead: this PC, as `rtecctl selftest latency --json` measured it
    #[arg(long, value_name = "FILE", conflicts_with = "computer")]
    latency: Option<PathBuf>,
    #[command(flatten)]
    motion: TestMotion,
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
    eprintln!("rtecctl: running five designs on: {}", computer.name);
    let comparison = compare(&computer, args.motion, args.seed);
    if let Some(dir) = &args.plot {
        std::fs::create_dir_all(dir).with_context(|| format!("making {}", dir.display()))?;
        for design in InsertionDesign::ALL {
            let file = dir.join(format!("design-{}.svg", design.name()));
            let svg = waveforms(design, &computer, 3);
            crate::json_output::write(&file, &svg)?;
            eprintln!("rtecctl: wrote {}", file.display());
        }
    }
    answer(args.json, &comparison, || comparison.to_table())
}
