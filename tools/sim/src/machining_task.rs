//! The simulated turning centre in real time, at a mock card's wires.
//! Its controller runs one program once, from the axes' home positions, and obeys feed hold. Releasing feed
//! hold starts the cycle.

use crate::corrected_axis::GateInsertionDesign;
use crate::lathe::{
    Cut, Lathe, LatheSetup, LatheSpec, ProgramMove, RAPID_MM_S, arc_moves, cut_away, probing_moves,
};
use crate::machines_on_mock_card::MachinesOnMockCard;
use crate::workpiece::Workpiece;
use rtec_driver::card::{AxisLines, MachineLines};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_part::contour::Segment;
use rtec_part::geometric_fit::Zx;
use rtec_part::length_unit::LengthUnit;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// The task of a simulated turning centre, as a TOML file: a probing path or a cut.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachiningTask {
    /// The part file that `part finish` writes; a cut changes it.
    /// The path is relative to this file.
    pub workpiece: PathBuf,
    /// The probe's path, mm.
    pub path: Option<PathBuf>,
    /// The radius to cut to, instead of a path.
    pub cut_radius_mm: Option<f64>,
    /// Feed for probing or cutting, mm/min.
    pub feed_mm_min: f64,
    /// Radius of the probe's tip, mm.
    #[serde(default)]
    pub tip_mm: f64,
    /// Machine position `[z, x]` at the part's origin.
    pub origin_mm: [f64; 2],
    /// Model file of the machine's errors.
    pub machine: Option<PathBuf>,
    /// Time for which the spindle has run before, s.
    #[serde(default)]
    pub begin_s: f64,
    /// Seed of all noise.
    #[serde(default)]
    pub seed: u64,
    /// Machine, tool and probe.
    #[serde(default)]
    pub bench: LatheSpec,
}

/// The cuts of a real-time machine, written to its part at the end.
#[derive(Debug)]
pub struct CutRecorder {
    places: Arc<Mutex<Vec<Cut>>>,
    part: Workpiece,
    bench: LatheSpec,
    seed: u64,
    file: PathBuf,
}

impl CutRecorder {
    /// Writes the part after the cuts; nothing if the tool has not cut.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(mut self) -> std::io::Result<()> {
        let places = std::mem::take(&mut *self.places.lock().unwrap_or_else(PoisonError::into_inner));
        if places.is_empty() {
            return Ok(());
        }
        cut_away(&mut self.part, &self.bench, &places, self.seed);
        rtec_files::atomic_write::write_atomically(&self.file, self.part.to_csv().as_bytes())
    }
}

impl MachiningTask {
    /// Reads the task.
    ///
    /// # Errors
    /// The file is not such a task, or a value is out of range.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text_file::read(file)?;
        let expected = "what the simulated turning centre does";
        let mut task: Self = rtec_files::strict_toml::from_str(file, &text, expected)?;
        let at = |key: &str, found: String, expected: &str| {
            InputError::at_offset(file, &text, text.find(key).unwrap_or(0), found, expected)
        };
        task.bench.check().map_err(|(key, expected)| at(key, format!("{key} out of range"), expected))?;
        let finite = [task.tip_mm, task.begin_s, task.origin_mm[0], task.origin_mm[1]];
        if !finite.iter().all(|v| v.is_finite()) || !(0.0..=1e6).contains(&task.begin_s) || task.tip_mm < 0.0
        {
            return Err(at(
                "",
                "a value out of range".into(),
                "finite numbers; tip_mm and begin_s 0 or more",
            ));
        }
        if !(task.feed_mm_min.is_finite() && task.feed_mm_min > 0.0) {
            return Err(at("feed_mm_min", task.feed_mm_min.to_string(), "a positive feed"));
        }
        match (&task.path, task.cut_radius_mm) {
            (Some(_), None) => {}
            (None, Some(r)) if r.is_finite() && r > 0.0 => {}
            _ => return Err(at("", "neither or both".into(), "path, or a positive cut_radius_mm")),
        }
        let folder = file.parent().unwrap_or(Path::new(""));
        task.workpiece = folder.join(&task.workpiece);
        task.path = task.path.map(|p| folder.join(p));
        task.machine = task.machine.map(|p| folder.join(p));
        Ok(task)
    }

    /// The machine at rest at `home` (machine mm), with its lines and its part.
    ///
    /// # Errors
    /// A file that the task names has a mistake, or an effect reads what this machine lacks.
    pub fn machine(
        &self,
        lines: [AxisLines; 2],
        machine_lines: MachineLines,
        home: Zx,
    ) -> Result<(MachinesOnMockCard<Lathe>, CutRecorder), InputError> {
        let part = Workpiece::read(&self.workpiece)?;
        let origin = Zx::new(self.origin_mm[0], self.origin_mm[1]);
        let feed_mm_s = self.feed_mm_min / 60.0;
        let program = match (&self.path, self.cut_radius_mm) {
            (Some(file), _) => {
                let records = rtec_part::probe_path::read_pathfin(file, LengthUnit::MM)?;
                probing_moves(&records, feed_mm_s)
            }
            (None, radius_mm) => {
                let radius_mm = radius_mm.unwrap_or_default();
                arc_moves(part.centre, radius_mm + self.bench.nose_mm, feed_mm_s)
            }
        };
        let first = program
            .first()
            .ok_or_else(|| {
                InputError::whole(&self.workpiece, "a program without a move", "a path to follow")
            })?
            .segment
            .at(0.0);
        // As the NC program begins: along Z only, then along X only.
        let corner = Zx::new(first.z, home.x - origin.x);
        let ways =
            [(home - origin, corner), (corner, first)].into_iter().filter(|(a, b)| (*b - *a).norm() > 1e-6);
        let mut moves: Vec<ProgramMove> = ways
            .map(|(a, b)| ProgramMove {
                segment: Segment::Line { a, b },
                feed_mm_s: RAPID_MM_S,
                cutting: false,
            })
            .collect();
        moves.extend(program);
        let machine = Machine::read_or_ideal(self.machine.as_deref(), "ideal lathe")?;
        let stand = LatheSetup {
            bench: &self.bench,
            machine: &machine,
            begin_s: self.begin_s,
            design: GateInsertionDesign::C,
            // A mock card's time stops between a poll and the write after it, so a decoder could check
            // nothing.
            decoder_hz: f64::INFINITY,
            seed: self.seed,
        };
        let probing = self.path.is_some().then_some(self.tip_mm);
        let lathe = Lathe::new(&stand, home, origin, &moves, probing, &part).map_err(|m| {
            let file = self.machine.as_deref().unwrap_or(Path::new("machine"));
            let found = format!("effect {} reads {}", m.effect, m.what);
            InputError::whole(file, found, "axes z and x, sensors T1 to T20")
        })?;
        let places = Arc::clone(&lathe.cuts);
        let wires = MachinesOnMockCard::new([(lathe, lines.to_vec())], machine_lines);
        let file = self.workpiece.clone();
        Ok((wires, CutRecorder { places, part, bench: self.bench.clone(), seed: self.seed, file }))
    }
}
