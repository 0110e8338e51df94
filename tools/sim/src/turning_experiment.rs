//! The experiment of NISTIR 4854 (section 2), step by step.
//! Semi-finish cut, probing, errors, table, finish cut and inspection on the simulated machine.

use crate::corrected_axis::GateInsertionDesign;
use crate::lathe::{self, BEYOND_RAD, LatheSetup, LatheSpec, ProgramMove, arc_moves, probing_moves};
use crate::lathe_program_run::{ProgramPurpose, ProgramResult, ProgramRunError, captured, run};
use crate::machine::ControllerLimits;
use crate::thermal_network::SENSORS;
use crate::trajectory::AXES;
use crate::true_machine_errors::{layout, of_the_probe};
use crate::workpiece::Workpiece;
use rtec_files::InputError;
use rtec_files::message_text::escaped;
use rtec_model::effect::{Effect, RequiredInput, STANDARD_DEGC};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, span};
use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, FinishCutArc, csv};
use rtec_part::batch_evaluation::{self, BatchEvaluation, SignificanceLimits};
use rtec_part::contour::{Segment, nose};
use rtec_part::error_cor_file::PointError;
use rtec_part::error_cor_file::error_cor;
use rtec_part::geometric_fit::{Zx, sd};
use rtec_part::length_unit::LengthUnit;
use rtec_part::part_errors::{NominalShape, PartErrorReport, ProbedPoints};
use rtec_part::probe_path::{PathPoint, ProbeGeometry, ProbingMotion, ProbingPlan};
use rtec_part::probe_trip_check::{GaugingPointTrip, ProbeTripFault, assign, probed_csv, run_record};
use rtec_part::probing_program::{self, DialectWithTemplate, VariableValues};
use rtec_part::session_comparison_html::{logged, side_by_side};
use serde::Serialize;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write as _;
use std::path::Path;

/// Inputs of the experiment.
#[derive(Debug, Clone)]
pub struct TurningExperimentInputs {
    /// Machine, tool and probe.
    pub bench: LatheSpec,
    /// The machine's errors.
    pub machine: Machine,
    /// The known model of those errors.
    /// It is corrected live while cutting, and off line in the probed results.
    pub model: Option<Machine>,
    /// Time for which the spindle has run before the first program, s.
    pub begin_s: f64,
    /// Name of the corrector's design on the command line.
    pub design: String,
    /// Centre of the nose in part coordinates.
    /// In figure 7 of the report it is 5 in along the axis.
    pub centre: Zx,
    /// Radius of the finished nose: 38.1 mm in the report.
    pub radius_mm: f64,
    /// Semi-finish allowance on the radius: 0.254 mm in the report.
    pub allowance_mm: f64,
    /// Points on the quadrant: 20 in the report.
    pub points: usize,
    /// Radius of the probe's tip.
    pub tip_mm: f64,
    /// The motion of probing.
    pub motion: ProbingMotion,
    /// Feed of the cuts.
    pub cut_feed_mm_min: f64,
    /// Lead by which corrections are requested, s.
    /// It is one control period plus the lag of the position loop.
    pub lead_s: f64,
    /// Largest distance of a trip from its expected position, mm.
    pub window_mm: f64,
    /// Seed of all noise.
    pub seed: u64,
}

impl Default for TurningExperimentInputs {
    /// NISTIR 4854 with the Original RTEC: 4 µm a correction on 1 µm counts.
    fn default() -> Self {
        let bench = LatheSpec::default();
        Self {
            lead_s: bench.control_ms * 1e-3 + 1.0 / bench.gain,
            bench,
            machine: Machine::ideal("ideal lathe"),
            model: None,
            begin_s: 0.0,
            design: "original".into(),
            centre: Zx::new(127.0, 0.0),
            radius_mm: 38.1,
            allowance_mm: 0.254,
            points: 20,
            tip_mm: 2.5,
            motion: ProbingMotion::REPORT,
            cut_feed_mm_min: 120.0,
            window_mm: 1.0,
            seed: 1,
        }
    }
}

/// Reason why an experiment stopped.
#[derive(Debug, thiserror::Error)]
pub enum TurningExperimentError {
    /// A trip differs from the plan.
    #[error(transparent)]
    Trip(#[from] ProbeTripFault),
    /// The machine could not run.
    #[error(transparent)]
    Run(#[from] ProgramRunError),
    /// The probed points give no errors.
    #[error(transparent)]
    Points(#[from] InputError),
    /// The corrector latched a fault.
    #[error("the corrector latched a fault: {0}")]
    Fault(String),
    /// No such design.
    #[error(
        "design '{0}': the experiment knows original, a and c; b and ecc pass the scale's signals through the \
             computer and have no probe capture"
    )]
    Design(String),
}

/// Results of one probing session.
#[derive(Debug, Clone)]
pub struct ProbingSessionResult {
    /// The captured trips.
    pub trips: Vec<GaugingPointTrip>,
    /// The record for `part errors`, with the temperatures at each trip.
    pub csv: String,
    /// The same as a run record of the machine.
    pub record: Option<Record>,
    /// Largest distance of a capture from the truth along the touch, µm.
    pub worst_um: f64,
    /// Root mean square of that distance, µm.
    pub rms_um: f64,
    /// Time on the machine, s.
    pub seconds: f64,
}

/// Performance of probing at one feed.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ProbingPerformance {
    /// Probing feed, mm/min.
    pub feed_mm_min: f64,
    /// Time on the machine for all points, s.
    pub seconds: f64,
    /// Captured minus true position of the tip: root mean square.
    pub capture_rms_um: f64,
    /// Captured minus true position of the tip: the largest.
    pub capture_worst_um: f64,
    /// Largest half width that the corrector states for an axis in motion.
    pub stated_um: f64,
    /// Error of a capture that is 25 µs late at this feed.
    pub late_25us_um: f64,
    /// Error of a controller that notices the trip once per millisecond.
    pub late_1ms_um: f64,
}

/// Errors of a cut, by probing and in truth.
#[derive(Debug, Clone, Serialize)]
pub struct CutErrors {
    /// Largest error by its size.
    pub largest_um: f64,
    /// Largest error minus the error at the part's axis (the report's height of bump).
    pub bump_um: f64,
    /// SD of all points about the plain circle.
    pub sd_before_um: f64,
    /// SD about the second fit.
    pub sd_after_um: f64,
    /// Form of the true surface.
    /// It is the largest minus the smallest deviation from its own circle at the probed angles.
    pub true_form_um: f64,
    /// SD of the true surface about its circle.
    pub true_sd_um: f64,
}

/// Results of the whole experiment.
#[derive(Debug, Serialize)]
pub struct TurningExperimentResult {
    /// Design of the corrector.
    pub design: String,
    /// One correction, in µm.
    pub increment_um: f64,
    /// Seed of all noise.
    pub seed: u64,
    /// The semi-finish cut with the worn tool.
    pub semi_finish: CutErrors,
    /// Largest number of corrections on one axis.
    pub corrections: i64,
    /// The finish cut with the table.
    pub finish: CutErrors,
    /// Insertions by the engine in the finish cut, Z and X.
    pub insertions: [u64; 2],
    /// The controller's count in the finish cut minus the scales', Z and X, counts.
    pub mtc_minus_scale: [i64; 2],
    /// Completed totals at the end of the finish cut.
    pub completed: [i64; 2],
    /// Number of lines of a program that compensates instead of the engine.
    pub program_lines: usize,
    /// The part cut by that program.
    pub program: CutErrors,
    /// Fast and slow probing.
    pub probing: [ProbingPerformance; 2],
    /// Errors that an external measuring machine sees and probing cannot.
    /// Only if the machine has errors.
    pub off_machine: Option<BatchEvaluation>,
    /// Decisions with their reasons, in order.
    pub decisions: Vec<String>,
    /// Files of every step.
    #[serde(skip)]
    pub files: Vec<(String, Vec<u8>)>,
    /// Error reports of both probings, each with the step that its files belong to.
    #[serde(skip)]
    pub reports: [(&'static str, PartErrorReport); 2],
}

impl TurningExperimentResult {
    /// Whether the controller's count minus the scales' equals the completed totals.
    pub fn balanced(&self) -> bool {
        self.mtc_minus_scale == self.completed
    }
}

/// Machine position at the part's origin.
pub const ORIGIN: Zx = Zx::new(300.0, 100.0);
/// Time between two programs, for tool change, setting and reading, s.
const PAUSE_S: f64 = 120.0;

impl TurningExperimentInputs {
    fn gate_design(&self) -> Result<GateInsertionDesign, TurningExperimentError> {
        lathe::design(&self.design).ok_or_else(|| TurningExperimentError::Design(self.design.clone()))
    }

    /// The cut to a radius.
    pub fn cut(&self, radius_mm: f64) -> FinishCutArc {
        FinishCutArc { centre: self.centre, radius_mm, nose_mm: self.bench.nose_mm, origin: ORIGIN }
    }

    /// A part before the semi-finish cut.
    pub fn raw(&self) -> Workpiece {
        Workpiece::raw(self.centre, self.radius_mm + self.allowance_mm + 1.0)
    }

    /// Cuts a part to a radius, with a table's corrections if one is given.
    ///
    /// # Errors
    /// The machine does not run, or the corrector latched a fault.
    pub fn turn(
        &self,
        part: &mut Workpiece,
        radius_mm: f64,
        table: Option<&ArcFinishCutTable>,
        seed: u64,
    ) -> Result<ProgramResult, TurningExperimentError> {
        let path_mm = radius_mm + self.bench.nose_mm;
        let moves = arc_moves(self.centre, path_mm, self.cut_feed_mm_min / 60.0);
        self.run_program(part, radius_mm, &moves, self.job(table), seed)
    }

    /// A cut with the known errors.
    fn job<'a>(&'a self, table: Option<&'a ArcFinishCutTable>) -> ProgramPurpose<'a> {
        match (table, &self.model) {
            (None, None) => ProgramPurpose::Cut,
            (table, model) => ProgramPurpose::Corrected(table, model.as_ref(), self.lead_s),
        }
    }

    fn run_program(
        &self,
        part: &mut Workpiece,
        radius_mm: f64,
        moves: &[ProgramMove],
        job: ProgramPurpose,
        seed: u64,
    ) -> Result<ProgramResult, TurningExperimentError> {
        let (bench, machine, design) = (&self.bench, &self.machine, self.gate_design()?);
        let decoder_hz = ControllerLimits::default().decoder_hz;
        let stand = LatheSetup { bench, machine, begin_s: self.begin_s, design, decoder_hz, seed };
        let ran = run(&stand, &self.cut(radius_mm), moves, job, part)?;
        let faults = ran.status.axes[..2].iter().any(|a| a.faults.any()) || ran.status.faults.any();
        if faults {
            return Err(TurningExperimentError::Fault(format!("{:?}", ran.status.axes[0].faults)));
        }
        Ok(ran)
    }

    /// The plan of a probing session on the nose.
    pub fn plan(&self, radius_mm: f64) -> ProbingPlan {
        let contour = nose(self.centre, radius_mm);
        let mut plan = ProbingPlan::new(ProbeGeometry {
            tip_mm: self.tip_mm,
            stand_off_mm: self.motion.stand_off_mm(),
            over_travel_mm: self.motion.over_travel_mm(),
            stem: None,
        });
        plan.add_number(&contour, 0, self.points, 0.0);
        plan
    }

    /// Probes the nose.
    ///
    /// # Errors
    /// A trip differs from the plan and names its point, or the corrector latched a fault.
    pub fn probe(
        &self,
        part: &Workpiece,
        plan: &ProbingPlan,
        feed_mm_min: f64,
        seed: u64,
    ) -> Result<ProbingSessionResult, TurningExperimentError> {
        let approach: Vec<Zx> = plan.points.iter().map(|p| p.place.normal * -1.0).collect();
        self.probe_path(part, &plan.records(), &plan.expected(), &approach, feed_mm_min, seed)
    }

    /// Probes along any path.
    /// `expected` are the tip's centres at the trips, `approach` the directions of the touches.
    ///
    /// # Errors
    /// As [`TurningExperimentInputs::probe`].
    pub fn probe_path(
        &self,
        part: &Workpiece,
        records: &[PathPoint],
        expected: &[Zx],
        approach: &[Zx],
        feed_mm_min: f64,
        seed: u64,
    ) -> Result<ProbingSessionResult, TurningExperimentError> {
        let moves = probing_moves(records, feed_mm_min / 60.0);
        let mut part = part.clone();
        let ran =
            self.run_program(&mut part, self.radius_mm, &moves, ProgramPurpose::Probe(self.tip_mm), seed)?;
        // An axis is in the middle of a count; the scale's edges are half a count from there.
        let half_mm = self.bench.count_um * 5e-4;
        let edges = ORIGIN + Zx::new(half_mm, half_mm);
        let trips = assign(&captured(&ran.events), expected, self.bench.count_um, edges, self.window_mm)?;
        // Along the touch, where the error arises. An axis at rest is known only to a count and does not
        // contribute.
        let off: Vec<f64> = trips
            .iter()
            .zip(&ran.trips)
            .zip(approach)
            .map(|((t, truth), along)| (t.tip_centre - *truth).dot(*along).abs() * 1e3)
            .collect();
        let sensors: Vec<&str> = lathe::sensors().collect();
        Ok(ProbingSessionResult {
            csv: probed_csv(&trips, approach, &sensors, &ran.degc),
            record: run_record(&trips, expected, approach, ORIGIN, &sensors, &ran.degc),
            worst_um: off.iter().copied().fold(0.0, f64::max),
            rms_um: (off.iter().map(|o| o * o).sum::<f64>() / off.len().max(1) as f64).sqrt(),
            seconds: ran.seconds,
            trips,
        })
    }

    /// Errors of a probing session, corrected off line by the machine's known model.
    ///
    /// # Errors
    /// The points give no circle.
    pub fn errors(
        &self,
        session: &ProbingSessionResult,
        radius_mm: f64,
    ) -> Result<PartErrorReport, TurningExperimentError> {
        let mut probed = ProbedPoints::parse(Path::new("probed.csv"), &session.csv)?;
        if let Some(model) = &self.model {
            probed.correct_geometric_thermal(model, ORIGIN)?;
        }
        Ok(probed.errors_by_report(NominalShape::Circle { radius_mm }, self.tip_mm)?)
    }

    /// The machine after further seconds.
    #[must_use]
    pub fn later(&self, seconds: f64) -> Self {
        Self { begin_s: self.begin_s + seconds, ..self.clone() }
    }

    /// Errors of the part as a measuring machine would find them.
    /// It measures the true surface at the probed angles about its own circle.
    ///
    /// # Errors
    /// The points give no circle.
    pub fn measured(
        &self,
        part: &Workpiece,
        radius_mm: f64,
    ) -> Result<PartErrorReport, TurningExperimentError> {
        let text = part.truth(radius_mm, self.points).iter().fold("z_mm,x_mm\n".to_owned(), |mut t, e| {
            let p = self.centre + Zx::at_angle(e.angle_rad) * (radius_mm + e.error_um * 1e-3);
            let _ = writeln!(t, "{:.9},{:.9}", p.z, p.x);
            t
        });
        Ok(ProbedPoints::parse(Path::new("truth"), &text)?
            .errors_by_report(NominalShape::Circle { radius_mm }, 0.0)?)
    }

    fn result(
        &self,
        report: &PartErrorReport,
        part: &Workpiece,
        radius_mm: f64,
    ) -> Result<CutErrors, TurningExperimentError> {
        let errors: Vec<f64> = report.errors.iter().map(|e| e.error_um).collect();
        let truth: Vec<f64> = self.measured(part, radius_mm)?.errors.iter().map(|e| e.error_um).collect();
        let range = |v: &[f64]| {
            let [least, most] = span(v);
            most - least
        };
        Ok(CutErrors {
            largest_um: errors.iter().map(|e| e.abs()).fold(0.0, f64::max),
            bump_um: errors.iter().copied().fold(f64::MIN, f64::max) - errors.first().copied().unwrap_or(0.0),
            sd_before_um: report.sd_before_um,
            sd_after_um: report.sd_after_um,
            true_form_um: range(&truth),
            true_sd_um: sd(&truth, |_| true),
        })
    }

    /// The table of a finish cut.
    /// It comes from the known form of the part if the model has one, otherwise from probed errors.
    fn table(&self, probed: &[PointError]) -> Result<ArcFinishCutTable, TurningExperimentError> {
        let known = self.model.as_ref().map(|m| known_form(m, self.points)).transpose()?.flatten();
        let axes = lathe::axes(&self.bench, self.gate_design()?);
        Ok(ArcFinishCutTable::new(self.cut(self.radius_mm), axes, known.unwrap_or_else(|| probed.to_vec())))
    }

    /// The loop: semi-finish cut, probing, finish cut (corrected or not), inspection.
    /// Returns the session of the inspection.
    ///
    /// # Errors
    /// The first step that cannot be done.
    pub fn turn_nose(&self, corrected: bool) -> Result<ProbingSessionResult, TurningExperimentError> {
        let semi_mm = self.radius_mm + self.allowance_mm;
        let (mut part, mut now) = (self.raw(), self.clone());
        let ran = now.turn(&mut part, semi_mm, None, self.seed)?;
        now = now.later(ran.seconds + PAUSE_S);
        let session = now.probe(&part, &self.plan(semi_mm), self.motion.feed_mm_min, self.seed + 1)?;
        now = now.later(session.seconds + PAUSE_S);
        let table = if corrected { Some(self.table(&self.errors(&session, semi_mm)?.errors)?) } else { None };
        let ran = now.turn(&mut part, self.radius_mm, table.as_ref(), self.seed + 2)?;
        now = now.later(ran.seconds + PAUSE_S);
        let plan = self.plan(self.radius_mm);
        let mut session = now.probe(&part, &plan, self.motion.feed_mm_min, self.seed + 3)?;
        self.correct_off_line(&mut session, &plan)?;
        Ok(session)
    }

    /// Removes the machine's known errors from the session's record.
    /// Probing runs uncorrected, so a correct part shows the machine's errors (NISTIR 4832, probing mode).
    fn correct_off_line(
        &self,
        session: &mut ProbingSessionResult,
        plan: &ProbingPlan,
    ) -> Result<(), TurningExperimentError> {
        let (Some(model), Some(record)) = (&self.model, &mut session.record) else { return Ok(()) };
        let mut probed = ProbedPoints::parse(Path::new("probed.csv"), &session.csv)?;
        let read = probed.tip_centre.clone();
        probed.correct_geometric_thermal(model, ORIGIN)?;
        for column in record.columns.iter_mut().filter(|c| c.role.is_response()) {
            for (row, e) in column.data.iter_mut().enumerate() {
                *e += (probed.tip_centre[row] - read[row]).dot(plan.points[row].place.normal) * 1e3;
            }
        }
        Ok(())
    }

    /// Runs all steps, one after the other.
    ///
    /// # Errors
    /// The first step that cannot be done.
    pub fn run(
        &self,
        progress: &mut dyn FnMut(&str),
    ) -> Result<TurningExperimentResult, TurningExperimentError> {
        let design = self.gate_design()?;
        let mut files: Vec<(String, Vec<u8>)> = Vec::new();
        let mut decisions = Vec::new();
        let semi_mm = self.radius_mm + self.allowance_mm;
        let axes = lathe::axes(&self.bench, design);

        progress("semi-finish cut");
        let mut part = self.raw();
        let mut now = self.clone();
        let ran = now.turn(&mut part, semi_mm, None, self.seed)?;
        now = now.later(ran.seconds + PAUSE_S);
        progress("probing");
        let plan = self.plan(semi_mm);
        let session = now.probe(&part, &plan, self.motion.feed_mm_min, self.seed + 1)?;
        let slow_feed = self.motion.feed_mm_min / 20.0;
        progress("probing at a twentieth of the feed, to compare");
        let slow = now.probe(&part, &plan, slow_feed, self.seed + 1)?;
        now = now.later(session.seconds + PAUSE_S);
        let report = self.errors(&session, semi_mm)?;
        let semi_finish = self.result(&report, &part, semi_mm)?;
        self.add(&mut files, "semi_finish", semi_mm, &session, &report)?;
        decisions.push(format!(
            "{} of {} points left out of the second fit: SD {:.2} -> {:.2} µm",
            report.rejected.len(),
            report.points,
            report.sd_before_um,
            report.sd_after_um
        ));
        let table = self.table(&report.errors)?;
        let rows = table.rows(9);
        let corrections = rows.iter().flat_map(|r| r.requested).map(i64::abs).max().unwrap_or(0)
            / design.increment_counts();
        let lead_mm = self.cut_feed_mm_min / 60.0 * self.lead_s;
        files.push(("finish/table.csv".into(), csv(&table, &rows, lead_mm, false).into_bytes()));
        decisions.push(format!(
            "table of {} entries, at most {corrections} corrections of {:.1} µm, sent {lead_mm:.3} mm ahead",
            rows.len(),
            axes[0].increment_um()
        ));

        progress("finish cut with the table");
        let before_finish = part.clone();
        let ran = now.turn(&mut part, self.radius_mm, Some(&table), self.seed + 2)?;
        let after = now.later(ran.seconds + PAUSE_S);
        progress("inspection");
        let plan = self.plan(self.radius_mm);
        let inspection = after.probe(&part, &plan, self.motion.feed_mm_min, self.seed + 3)?;
        let inspected = self.errors(&inspection, self.radius_mm)?;
        let finish = self.result(&inspected, &part, self.radius_mm)?;
        self.add(&mut files, "inspection", self.radius_mm, &inspection, &inspected)?;

        progress("the same by G01 lines");
        let mut other = before_finish;
        let moves = self.program_moves(&table);
        // As with the arc, the move beyond each end does not count as a line of the program.
        let program_lines = moves.len().saturating_sub(2);
        now.run_program(&mut other, self.radius_mm, &moves, self.job(None), self.seed + 4)?;
        let by_program = self
            .errors(&after.probe(&other, &plan, self.motion.feed_mm_min, self.seed + 5)?, self.radius_mm)?;
        let program = self.result(&by_program, &other, self.radius_mm)?;
        decisions.push(format!(
            "corrector: {:.2} µm left at most; program of {} lines: {:.2} µm",
            finish.largest_um, program_lines, program.largest_um
        ));
        let off_machine = if self.machine.effects().next().is_none() {
            None
        } else {
            let (batch, csv) = now.off_machine(&table, &inspected, progress)?;
            files.push(("post_process/batch.csv".into(), csv.into_bytes()));
            Some(batch)
        };
        if let Some(batch) = &off_machine {
            decisions.extend(batch.offers.iter().map(|o| format!("offered, not applied: {o}")));
        }
        let mut outcome = TurningExperimentResult {
            design: self.design.clone(),
            increment_um: axes[0].increment_um(),
            seed: self.seed,
            semi_finish,
            corrections,
            finish,
            insertions: [0, 1].map(|n| ran.status.axes[n].insertions),
            mtc_minus_scale: ran.mtc_minus_scale,
            completed: [0, 1].map(|n| ran.status.axes[n].completed),
            program_lines,
            program,
            probing: [compare(self.motion.feed_mm_min, &session), compare(slow_feed, &slow)],
            off_machine,
            decisions,
            files,
            reports: [("semi_finish", report), ("inspection", inspected)],
        };
        let html = page(&outcome);
        outcome.files.push(("report.html".into(), html.into_bytes()));
        Ok(outcome)
    }

    /// The finish cut with the table's corrections in its G01 lines.
    /// It runs from beyond one end to beyond the other. A cut begun at rest in the first point would show the
    /// direction from which the axes came.
    fn program_moves(&self, table: &ArcFinishCutTable) -> Vec<ProgramMove> {
        let mut corners = table.straight_moves(0.0015, 4);
        // The ends continue along the same arc as the single arc move, so that the axes reverse at the same
        // positions.
        if let [first, .., last] = corners[..] {
            let beyond = |end: Zx, by_rad: f64| {
                let from = end - table.cut.centre;
                table.cut.centre + Zx::at_angle(from.angle_rad() + by_rad) * from.norm()
            };
            corners.insert(0, beyond(first, -BEYOND_RAD));
            corners.push(beyond(last, BEYOND_RAD));
        }
        let line = |w: &[Zx]| ProgramMove {
            segment: Segment::Line { a: w[0], b: w[1] },
            feed_mm_s: self.cut_feed_mm_min / 60.0,
            cutting: true,
        };
        corners.windows(2).map(line).collect()
    }

    /// A batch measured off the machine, compared with the probing on it.
    fn off_machine(
        &self,
        table: &ArcFinishCutTable,
        inspected: &PartErrorReport,
        progress: &mut dyn FnMut(&str),
    ) -> Result<(BatchEvaluation, String), TurningExperimentError> {
        let mut text = "part,feature,angle_rad,error_um\n".to_owned();
        for k in 0..4 {
            progress("a further part for the measuring machine");
            let seed = self.seed + 100 * (k + 1);
            let mut part = self.raw();
            self.turn(&mut part, self.radius_mm + self.allowance_mm, None, seed)?;
            self.turn(&mut part, self.radius_mm, Some(table), seed + 1)?;
            for (e, nominal) in self.measured(&part, self.radius_mm)?.errors.iter().zip(&inspected.errors) {
                let _ = writeln!(text, "{k},nose,{:.6},{:.4}", nominal.angle_rad, e.error_um);
            }
        }
        let judgement = SignificanceLimits { alpha: 0.01, least_um: 1.0 };
        Ok((
            batch_evaluation::evaluate_text(
                Path::new("batch.csv"),
                &text,
                Some(&inspected.errors),
                judgement,
            )?,
            text,
        ))
    }

    /// Adds the files of a probing session.
    /// They are its plan, its NC program, the captured positions and the errors.
    fn add(
        &self,
        files: &mut Vec<(String, Vec<u8>)>,
        step: &str,
        radius_mm: f64,
        session: &ProbingSessionResult,
        report: &PartErrorReport,
    ) -> Result<(), TurningExperimentError> {
        let (plan, unit) = (self.plan(radius_mm), LengthUnit::MM);
        let mut push = |name: &str, content: Vec<u8>| files.push((format!("{step}/{name}"), content));
        for (name, text) in plan.files(&nose(self.centre, radius_mm), unit) {
            push(name, text.into_bytes());
        }
        let (name, program) = self.program(&plan, if step == "inspection" { "4" } else { "2" })?;
        push(&name, program.into_bytes());
        push("probed.csv", session.csv.clone().into_bytes());
        if let Some(record) = &session.record {
            push("probing.csv", rtec_records::run_record_files::to_csv(record).into_bytes());
            push("probing.run.toml", rtec_records::run_record_files::to_sidecar(record).into_bytes());
        }
        push("error.cor", error_cor(&report.errors).into_bytes());
        push("whisker.svg", report.whisker_svg().into_bytes());
        Ok(())
    }

    /// The probing program of the report's controller, and its name.
    fn program(&self, plan: &ProbingPlan, segment: &str) -> Result<(String, String), TurningExperimentError> {
        let template = Path::new("template.prb");
        let bad = |(found, expected)| InputError::whole(template, found, expected);
        let mut parameters = VariableValues::default();
        let (feed, tip) = (self.motion.feed_mm_min.to_string(), (2.0 * self.tip_mm).to_string());
        for (name, value) in
            [("segment", segment), ("title", "NOSE"), ("feed", &feed), ("tip_diameter", &tip)]
        {
            parameters.set(name, value).map_err(bad)?;
        }
        for (name, mm) in [
            ("probing_start_z", ORIGIN.z + self.centre.z + self.radius_mm + 50.0),
            ("reference_z", self.centre.z + self.radius_mm + 50.0),
            ("reference_x", 0.0),
        ] {
            parameters.set(name, &mm.to_string()).map_err(bad)?;
        }
        let controller = DialectWithTemplate::built_in("report").transpose()?.ok_or_else(|| {
            InputError::whole(template, "no dialect report", "a dialect that comes with the program")
        })?;
        let (records, made) = (plan.records(), "BY PART RUN");
        let job = probing_program::ProbingProgramInputs {
            controller: &controller,
            parameters: &parameters,
            records: &records,
            unit: LengthUnit::MM,
            comments: true,
            made,
        };
        Ok((parameters.file_name(), job.text(template)?))
    }
}

/// Radial errors of the part by angle that a model states, µm.
/// `None` if it states no form.
fn known_form(model: &Machine, points: usize) -> Result<Option<Vec<PointError>>, ProgramRunError> {
    let form: Vec<&Effect> = model
        .effects()
        .filter(|e| e.description().needs.contains(&RequiredInput::Angle) && !of_the_probe(e))
        .collect();
    if form.is_empty() {
        return Ok(None);
    }
    let mut live = LiveModel::new(form, layout(Vec::new()))?;
    // Finer than the probed points, since a bump may lie between two of them.
    let steps = 20 * points;
    let errors = (0..=steps).map(|k| {
        let angle_rad = FRAC_PI_2 * k as f64 / steps as f64;
        let degc = [STANDARD_DEGC; SENSORS.len()];
        let axes = [AxisMotionState::default(); AXES];
        live.evaluate(&MachineState {
            axes: &axes,
            temperatures_degc: &degc,
            angle_rad,
            ..MachineState::default()
        });
        PointError { angle_rad, error_um: live.radial_um(), along_mm: None }
    });
    Ok(Some(errors.collect()))
}

fn compare(feed_mm_min: f64, session: &ProbingSessionResult) -> ProbingPerformance {
    let um_per_us = feed_mm_min / 60.0 * 1e-3;
    ProbingPerformance {
        feed_mm_min,
        seconds: session.seconds,
        capture_rms_um: session.rms_um,
        capture_worst_um: session.worst_um,
        // At the two ends one axis is at rest and is known only to a count.
        stated_um: session.trips.iter().map(|t| t.uncertainty_um).filter(|u| *u < 0.9).fold(0.0, f64::max),
        late_25us_um: 25.0 * um_per_us,
        late_1ms_um: 1000.0 * um_per_us,
    }
}

/// The report page of a whole experiment.
fn page(o: &TurningExperimentResult) -> String {
    let [(_, before), (_, after)] = &o.reports;
    let mut text = side_by_side(before, after);
    let _ = write!(
        text,
        "<p>Simulated machine, design {}, {:.0} µm a correction, seed {}: at most {} corrections, {} insertions in Z and \
         {} in X.</p><h2>The true surface</h2><table><tr><th>µm<th>form<th>SD",
        escaped(&o.design),
        o.increment_um,
        o.seed,
        o.corrections,
        o.insertions[0],
        o.insertions[1]
    );
    let program = format!("finish cut by {} G01 lines instead", o.program_lines);
    for (name, r) in [
        ("semi-finish cut", &o.semi_finish),
        ("finish cut, corrected", &o.finish),
        (program.as_str(), &o.program),
    ] {
        let _ = write!(text, "<tr><td>{name}<td>{:.2}<td>{:.2}", r.true_form_um, r.true_sd_um);
    }
    text.push_str(
        "</table><h2>Probing</h2><table><tr><th>m/min<th>s<th>capture RMS µm<th>worst µm<th>25 µs late µm<th>1 ms late µm",
    );
    for p in &o.probing {
        let _ = write!(
            text,
            "<tr><td>{:.3}<td>{:.1}<td>{:.2}<td>{:.2}<td>{:.2}<td>{:.1}",
            p.feed_mm_min / 1e3,
            p.seconds,
            p.capture_rms_um,
            p.capture_worst_um,
            p.late_25us_um,
            p.late_1ms_um
        );
    }
    text + "</table>" + &logged(&o.decisions)
}
