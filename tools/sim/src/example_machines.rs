//! Example machines, each with the files for a first day.
//! They are the known model, runs that characterise the machine, later runs that judge a model, configuration and
//! drawings. Texts are in `machines/`. The runs are simulated from fixed seeds.

use crate::axis::AxisSpec;
use crate::compensation_experiments::{Experiment, ExperimentError, ExperimentInputs};
use crate::corrected_machine_sim::MachineSpec;
use crate::described_machines::{self, wo97_of};
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use rtec_model::record::Record;
use std::path::Path;

/// Seeds of the characterisation and of the hold-out runs.
const SEEDS: [u64; 2] = [1, 2];

/// An example machine.
#[derive(Debug, Clone, Copy)]
pub struct ExampleMachine {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its description in one line.
    pub what: &'static str,
    /// Files written unchanged: path below the example's folder, and text.
    /// `true.toml` is among them.
    pub files: &'static [(&'static str, &'static str)],
    spec: fn() -> MachineSpec,
    /// Experiments that characterise it, and hold-out experiments.
    /// None if `rtec-papers` runs the whole.
    runs: [&'static [&'static str]; 2],
}

/// Every example machine.
pub const EXAMPLES: [ExampleMachine; 7] = [
    ExampleMachine {
        name: "lathe",
        what: "X and Z, circles, spindle cycles, a part to be probed; its model lacks two effects and its growth",
        files: &[
            ("README.md", include_str!("../machines/lathe/README.md")),
            ("machine.toml", include_str!("../machines/lathe/machine.toml")),
            ("true.toml", include_str!("../machines/lathe/true.toml")),
            ("rtec.toml", include_str!("../machines/lathe/rtec.toml")),
            ("drawings/nose.dxf", include_str!("../machines/lathe/nose.dxf")),
        ],
        spec: MachineSpec::turning_centre,
        runs: [&["linear-displacement", "ballbar", "drift"], &["linear-displacement", "production-cycle"]],
    },
    ExampleMachine {
        name: "mill",
        what: "X, Y and Z, a plate, circles in three planes, spindle cycles; its model lacks two effects and its growth",
        files: &[
            ("README.md", include_str!("../machines/mill/README.md")),
            ("machine.toml", include_str!("../machines/mill/machine.toml")),
            ("true.toml", include_str!("../machines/mill/true.toml")),
            ("rtec.toml", include_str!("../machines/mill/rtec.toml")),
        ],
        spec: three_axes,
        runs: [
            &["linear-displacement", "plate", "ballbar", "drift"],
            &["linear-displacement", "plate", "production-cycle"],
        ],
    },
    ExampleMachine {
        name: "wo97",
        what: "the machining centre of WO 97/43703: its characterisation, its growth to be fitted",
        files: &[
            ("README.md", include_str!("../machines/wo97/README.md")),
            ("machine.toml", include_str!("../machines/wo97/machine.toml")),
            ("true.toml", described_machines::WO97_MACHINE),
            ("wo97-chain.toml", described_machines::WO97_CHAIN),
            ("wo97.toml", wo97_of!("true.toml")),
            ("rtec.toml", include_str!("../machines/wo97/rtec.toml")),
        ],
        spec: MachineSpec::machining_centre,
        runs: [
            &[
                "linear-displacement",
                "ballbar",
                "drift",
                "wet-runs",
                "production-cycle",
                "tool-change-repeatability",
            ],
            &["linear-displacement", "drilling", "drilling-warm"],
        ],
    },
    ExampleMachine {
        name: "nistir4854",
        what: "the turning centre of NISTIR 4854: a worn tool, the part probed, its error corrected by a table",
        files: &[
            ("README.md", include_str!("../machines/nistir4854/README.md")),
            ("4854.toml", include_str!("../papers/4854.toml")),
            ("4854-machine.toml", include_str!("../papers/4854-machine.toml")),
            ("4854-chain.toml", include_str!("../papers/4854-chain.toml")),
        ],
        spec: MachineSpec::turning_centre,
        runs: [&[], &[]],
    },
    ExampleMachine {
        name: "nistir4832",
        what: "the Original RTEC of NISTIR 4832 and its Designs A, B and C: signals, insertions, belief window",
        files: &[
            ("README.md", include_str!("../machines/nistir4832/README.md")),
            ("4832.toml", include_str!("../papers/4832.toml")),
            ("4832-machine.toml", include_str!("../papers/4832-machine.toml")),
        ],
        spec: MachineSpec::turning_centre,
        runs: [&[], &[]],
    },
    ExampleMachine {
        name: "cmti",
        what: "the Error Correction Circuit of CMTI: pulses blocked and split, by a controller's lines",
        files: &[
            ("README.md", include_str!("../machines/cmti/README.md")),
            ("cmti.toml", include_str!("../papers/cmti.toml")),
        ],
        spec: MachineSpec::turning_centre,
        runs: [&[], &[]],
    },
    ExampleMachine {
        name: "spindle",
        what: "a spindle that grows, dry and wet: sensors to be chosen, a first model to be fitted",
        files: &[
            ("README.md", include_str!("../machines/spindle/README.md")),
            ("machine.toml", include_str!("../machines/spindle/machine.toml")),
            ("true.toml", include_str!("../machines/spindle/true.toml")),
            ("rtec.toml", include_str!("../machines/spindle/rtec.toml")),
        ],
        spec: three_axes,
        runs: [&["drift"], &["production-cycle"]],
    },
];

fn three_axes() -> MachineSpec {
    let axes = [("x", 600.0), ("y", 600.0), ("z", 500.0)];
    MachineSpec::new(axes.into_iter().map(|(name, travel_mm)| AxisSpec::new(name, travel_mm)).collect())
}

/// Folders of the runs, in the order of [`SEEDS`].
const FOLDERS: [&str; 2] = ["records", "holdout"];

impl ExampleMachine {
    /// The example of this name.
    pub fn find(name: &str) -> Option<&'static Self> {
        EXAMPLES.iter().find(|e| e.name == name)
    }

    /// Whether it has its own runs; otherwise `rtec-papers` runs the whole.
    pub fn has_runs(&self) -> bool {
        self.runs.iter().any(|runs| !runs.is_empty())
    }

    /// The command that runs a source's experiment from start to end.
    /// It runs in the example's folder, and README.md names it.
    pub fn experiment(&self) -> Option<&'static str> {
        self.files.iter().flat_map(|f| f.1.lines()).map(str::trim).find(|l| l.starts_with("rtec-papers "))
    }

    /// Reads one of its files as a machine model, with the files that it refers to.
    ///
    /// # Errors
    /// Never: the files are within the program, and a test reads them.
    pub fn machine(&self, file: &str) -> Result<Machine, rtec_files::InputError> {
        let text = |path: &Path| {
            let found = self.files.iter().find(|f| Path::new(f.0) == path).map(|f| f.1.to_owned());
            found.ok_or_else(|| rtec_files::InputError::whole(path, "no such file", "a file of this example"))
        };
        let path = Path::new(file);
        Machine::parse_from(path, &text(path)?, Dictionary::default(), &text)
    }

    /// Its run records, with their future paths below `folder`.
    /// They are not written yet.
    ///
    /// # Errors
    /// As [`Experiment::run`].
    pub fn records(&self, folder: &Path) -> Result<Vec<Record>, ExperimentError> {
        if !self.has_runs() {
            return Ok(Vec::new());
        }
        let (truth, spec) = (self.machine("true.toml")?, (self.spec)());
        let mut records = Vec::new();
        for ((runs, seed), name) in self.runs.into_iter().zip(SEEDS).zip(FOLDERS) {
            let out = folder.join(name);
            let setting = ExperimentInputs { spec: &spec, truth: &truth, known: None, seed, out: &out };
            for experiment in runs.iter().filter_map(|name| Experiment::find(name)) {
                records.append(&mut experiment.run(&setting)?.records);
            }
        }
        Ok(records)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_can_be_read_and_every_run_is_an_experiment() {
        for example in EXAMPLES.into_iter().filter(ExampleMachine::has_runs) {
            let (known, truth) =
                (example.machine("machine.toml").unwrap(), example.machine("true.toml").unwrap());
            // The known model has fewer effects than the true one.
            let laws = |m: &Machine| {
                m.effects()
                    .map(rtec_model::effect::Effect::identity)
                    .collect::<std::collections::BTreeSet<_>>()
            };
            assert!(
                laws(&known).is_subset(&laws(&truth)) && laws(&known) != laws(&truth),
                "{}",
                example.name
            );
            for run in example.runs.into_iter().flatten() {
                let experiment = Experiment::find(run).unwrap_or_else(|| panic!("{run}"));
                assert!(experiment.own.is_none_or(|own| !own.fixed), "{run} has a machine of its own");
            }
        }
    }

    #[test]
    fn its_runs_show_what_the_true_machine_does_and_are_the_same_each_time() {
        let example = ExampleMachine::find("spindle").unwrap();
        let once = example.records(Path::new("s")).unwrap();
        let paths: Vec<_> = once.iter().map(|r| r.path.display().to_string()).collect();
        assert_eq!(
            paths,
            [
                "s/records/drift-dry.run.toml",
                "s/records/drift-wet.run.toml",
                "s/holdout/production-cycle.run.toml"
            ]
        );
        let truth = example.machine("true.toml").unwrap();
        let mut noise: Vec<Vec<f64>> = Vec::new();
        for record in &once {
            let said = truth.predict(record).unwrap();
            for (column, (name, um)) in record.responses().zip(&said.columns) {
                let off = column.data.iter().zip(um).fold(0.0_f64, |w, (e, p)| w.max((e - p).abs()));
                let most = um.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
                assert!(off < 0.8 && most > 2.0, "{name}: {off} µm off, {most} µm at most");
                noise.push(column.data.iter().zip(um).map(|(e, p)| e - p).collect());
            }
        }
        // No two runs share their noise.
        for (k, a) in noise.iter().enumerate() {
            for b in &noise[k + 1..] {
                let same = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() < 1e-3).count();
                assert!(same < a.len().min(b.len()) / 20, "{same} rows alike");
            }
        }
        assert_eq!(once, example.records(Path::new("s")).unwrap());
    }
}
