//! Options of the simulated machine, for the steps that need a machine.

use super::points::{checked, positive};
use super::{usage, within};
use crate::prelude::*;
use rtec_model::machine::Machine;
use rtec_part::probe_path::ProbingMotion;
use rtec_sim::lathe::{self, LatheSpec};
use rtec_sim::turning_experiment::TurningExperimentInputs;

/// The simulated machine
#[derive(Debug, clap::Args)]
pub(crate) struct SimMachineArgs {
    /// Machine, tool and probe as TOML; by default those of NISTIR 4854
    #[arg(long)]
    bench: Option<PathBuf>,
    /// What the simulated machine does wrong: effects of z and x, by position and by the temperatures T1 to T20
    #[arg(long, value_name = "MACHINE.TOML")]
    true_machine: Option<PathBuf>,
    /// The spindle has run for so long when the step begins, in s
    #[arg(long, default_value_t = 0.0)]
    begin_s: f64,
    /// Insertion design: original, a or c
    #[arg(long, default_value = "c")]
    design: String,
    /// Seed of everything that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Radius of the probe's tip, in mm
    #[arg(long, default_value_t = 2.5)]
    tip_mm: f64,
    /// Feed of the cuts, in mm/min
    #[arg(long, default_value_t = 120.0)]
    cut_feed_mm_min: f64,
    /// How near a trip must be to its expected place, in mm
    #[arg(long, default_value_t = 1.0)]
    trip_window_mm: f64,
    #[command(flatten)]
    motion: ProbingMotion,
}

impl SimMachineArgs {
    pub(crate) fn setup(&self) -> anyhow::Result<TurningExperimentInputs> {
        let bench = match &self.bench {
            None => LatheSpec::default(),
            Some(file) => read_bench(file)?,
        };
        if lathe::design(&self.design).is_none() {
            let expected = "original, a or c: b and ecc pass the scale's signals through the computer and have no \
                            probe capture, see `rtecctl designs`";
            return Err(usage("--design", self.design.clone(), expected));
        }
        let begin_s = within("--begin-s", self.begin_s, 0.0..=1e6, "a time in s, 0 to 1 000 000")?;
        let machine = Machine::read_or_ideal(self.true_machine.as_deref(), "ideal lathe")?;
        Ok(TurningExperimentInputs {
            machine,
            begin_s,
            lead_s: bench.control_ms * 1e-3 + 1.0 / bench.gain,
            bench,
            design: self.design.clone(),
            tip_mm: positive("--tip-mm", self.tip_mm)?,
            motion: checked(self.motion)?,
            cut_feed_mm_min: positive("--cut-feed-mm-min", self.cut_feed_mm_min)?,
            window_mm: positive("--trip-window-mm", self.trip_window_mm)?,
            seed: self.seed,
            ..TurningExperimentInputs::default()
        })
    }
}

fn read_bench(file: &Path) -> anyhow::Result<LatheSpec> {
    let text = rtec_files::text_file::read(file)?;
    let bench: LatheSpec = rtec_files::strict_toml::from_str(file, &text, "keys of the simulated machine")?;
    bench.check().map_err(|(key, expected)| {
        let at = text.find(key).unwrap_or(0);
        InputError::at_offset(file, &text, at, format!("{key} out of range"), expected)
    })?;
    Ok(bench)
}
