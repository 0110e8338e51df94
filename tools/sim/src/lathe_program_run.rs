//! A program on the lathe, with the unchanged engine between scales and controller.
//! A corrector uses the probed errors and the machine's known model.

use crate::attended_machine::AttendedMachine;
use crate::corrected_axis::{EventSink, GateInsertionDesign};
use crate::corrected_machine_sim::keep;
use crate::corrector_with_sensors::{CorrectorWithSensors, WINDOW_COUNTS};
use crate::gate_corrected_axes::GateCorrectedAxes;
use crate::lathe::{Lathe, LatheSetup, ProgramMove, axes, cut_away};
use crate::lathe_on_polled_card::PolledLatheCard;
use crate::machine::ControllerFault;
use crate::workpiece::Workpiece;
use rtec_correct::AxisCorrectionSettings;
use rtec_correct::part_table::PartTable;
use rtec_driver::card::{AxisLines, CardError, MachineLines};
use rtec_files::InputError;
use rtec_model::effect::MissingInput;
use rtec_model::machine::Machine;
use rtec_part::arc_finish_cut_table::{ArcFinishCutTable, FinishCutArc};
use rtec_part::geometric_fit::Zx;
use rtec_part::probe_trip_check::CapturedTrips;
use rtec_rt::axis::{AxisConfig, InsertionAtRestPolicy};
use rtec_rt::engine::StartError;
use rtec_rt::link_messages::{CorrectorStatus, Event, EventKind, RequestToRt};

/// Purpose of a program on the machine.
#[derive(Debug, Clone, Copy)]
pub enum ProgramPurpose<'a> {
    /// Cut without corrections.
    Cut,
    /// Cut with the corrections of a table, of a machine model, or of both.
    /// The third value is the lead by which totals are requested, s.
    Corrected(Option<&'a ArcFinishCutTable>, Option<&'a Machine>, f64),
    /// Probe with a tip of this radius, mm.
    Probe(f64),
}

/// Results of a program.
#[derive(Debug, Clone)]
pub struct ProgramResult {
    /// Events that the engine reported, in order.
    pub events: Vec<Event>,
    /// The engine at the end.
    pub status: CorrectorStatus,
    /// Time on the machine, s.
    pub seconds: f64,
    /// The controller's count minus the scale's, Z and X.
    /// The machine's decoders give it, not the engine.
    pub mtc_minus_scale: [i64; 2],
    /// Position of the tip's centre by the scales at each trip, in part coordinates.
    /// Captures are compared with this truth.
    pub trips: Vec<Zx>,
    /// Readings of the sensors at each trip, °C.
    pub degc: Vec<Vec<f64>>,
}

/// Reason why a program did not run.
#[derive(Debug, thiserror::Error)]
pub enum ProgramRunError {
    /// The engine refused to start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The program has no move.
    #[error("the program has no move")]
    NoMove,
    /// An effect reads what this machine does not have.
    #[error("effect {} reads {}; the simulated lathe has the axes z and x and the sensors T1 to T20", .0.effect, .0.what)]
    Missing(#[from] MissingInput),
    /// The corrector's model reads something that this machine does not have.
    #[error(transparent)]
    Model(#[from] InputError),
    /// The part table is invalid.
    #[error("{0}")]
    Table(String),
    /// The corrections did not take effect in time.
    #[error("the corrections are not in force after {SETTLES_S} s at rest")]
    Unsettled,
    /// The controller stopped.
    #[error("the controller stopped: {0:?}")]
    Servo(ControllerFault),
}

/// The control law with its inputs, and with lags known since the machine's start.
fn control(
    stand: &LatheSetup,
    table: Option<&ArcFinishCutTable>,
    model: Option<&Machine>,
    lead_s: f64,
    past: &[(f64, Vec<f64>)],
) -> Result<CorrectorWithSensors, ProgramRunError> {
    let setups = ["z", "x"].into_iter().zip(axes(stand.bench, stand.design)).map(|(name, counts)| {
        AxisCorrectionSettings {
            name: name.to_owned(),
            count_um: counts.count_um,
            increment_counts: counts.increment,
            window_counts: WINDOW_COUNTS,
            max_counts: MAX_COUNTS,
        }
    });
    let mut control = CorrectorWithSensors::new(setups.collect(), &[], lead_s);
    if let Some(model) = model {
        control.load(model, past)?;
    }
    if let Some(table) = table {
        let cut = &table.cut;
        let shown = PartTable {
            errors: String::new(),
            axes: ["z", "x"].map(str::to_owned),
            centre_mm: Some([cut.centre.z, cut.centre.x]),
            radius_mm: Some(cut.radius_mm),
            nose_mm: cut.nose_mm.abs(),
            hollow: cut.nose_mm < 0.0,
            origin_mm: [cut.origin.z, cut.origin.x],
            lead_ms: lead_s * 1e3,
        };
        control.load_table(shown, table.errors().to_vec()).map_err(ProgramRunError::Table)?;
    }
    Ok(control)
}

/// Largest total of either axis, counts.
const MAX_COUNTS: i64 = 1000;
/// Longest wait at rest for the corrections to take effect, s.
const SETTLES_S: f64 = 600.0;

const LINES: [AxisLines; 2] = [AxisLines::standard(0, true), AxisLines::standard(1, true)];

/// The corrected axes: homed, enabled, and in probing mode if `probing`.
fn corrected(
    card: &mut PolledLatheCard,
    stand: &LatheSetup,
    probing: bool,
    report: &mut impl EventSink,
) -> Result<GateCorrectedAxes, StartError> {
    let poll_ns = stand.bench.poll_ns as u64;
    let configs = LINES.map(|lines| AxisConfig {
        lines,
        window_counts: WINDOW_COUNTS,
        max_correction_counts: MAX_COUNTS,
        min_separation_ns: 500,
        // At either end of the arc an axis nearly rests, and must be right there too.
        rest: InsertionAtRestPolicy::Insert { after_ns: 5_000_000 },
        detect_ns: 2 * poll_ns,
        write_ns: poll_ns,
        ..AxisConfig::default()
    });
    let lines = MachineLines { probe: MachineLines::standard().probe, ..MachineLines::default() };
    let origins = [0, 1].map(|n| card.attended.machine().axes[n].origin);
    // While the machine probes, nothing is inserted, and the engine captures for every design.
    let design = if probing { GateInsertionDesign::C } else { stand.design };
    let mut corrected = GateCorrectedAxes::new(design, card, &configs, lines, &origins, report)?;
    if probing {
        corrected.take(RequestToRt::Probe(true), card, report)?;
    }
    Ok(corrected)
}

/// Runs a program on the machine with the engine between scales and controller.
/// The workpiece is changed by the cuts.
///
/// # Errors
/// The engine refuses the configuration, there is no move, or the controller gave up.
pub fn run(
    stand: &LatheSetup,
    cut: &FinishCutArc,
    moves: &[ProgramMove],
    job: ProgramPurpose,
    part: &mut Workpiece,
) -> Result<ProgramResult, ProgramRunError> {
    let start = moves.first().ok_or(ProgramRunError::NoMove)?.segment.at(0.0) + cut.origin;
    let tip_mm = if let ProgramPurpose::Probe(tip_mm) = job { Some(tip_mm) } else { None };
    let lathe = Lathe::new(stand, start, cut.origin, moves, tip_mm, part)?;
    let mut law = match job {
        ProgramPurpose::Corrected(table, model, lead_s) => {
            Some(control(stand, table, model, lead_s, &lathe.past)?)
        }
        ProgramPurpose::Cut | ProgramPurpose::Probe(_) => None,
    };
    let mut card = PolledLatheCard::new(lathe, stand.bench.poll_ns, stand.seed);
    let mut events = Vec::new();
    let mut report = |event: Event| keep(&mut events, event);
    let mut corrected = corrected(&mut card, stand, tip_mm.is_some(), &mut report)?;
    let (mut control_ns, period_ns) = (0_u64, (stand.bench.control_ms * 1e6) as u64);
    let mut waiting = true;
    loop {
        match corrected.poll(&mut card, control_ns.max(1), &mut report) {
            Ok(()) => {}
            Err(CardError::Ended) => break,
            Err(error) => return Err(StartError::Card(error).into()),
        }
        let now_ns = corrected.now_ns();
        if now_ns < control_ns {
            continue;
        }
        control_ns = now_ns + period_ns;
        let (t_s, status) = (card.attended.t_s(), corrected.status());
        if let Some(law) = &mut law {
            let requests = law.requests(t_s, &status, &mut card.attended.readings());
            for request in requests {
                corrected.take(request, &mut card, &mut report).map_err(StartError::Card)?;
            }
        }
        // Before cycle start the operator waits until the known corrections are in effect.
        let mut status = corrected.status();
        if stand.design == GateInsertionDesign::Original {
            // It inserts only where A and B are low, at rest perhaps never. It catches up on the way to the
            // part (NISTIR 4832).
            for axis in &mut status.axes {
                axis.completed = axis.requested;
            }
        }
        if waiting && law.as_ref().is_none_or(|law| law.settled(&status)) {
            waiting = false;
            card.attended.start();
        } else if waiting && now_ns as f64 * 1e-9 > SETTLES_S {
            return Err(ProgramRunError::Unsettled);
        }
    }
    let (status, lathe) = (corrected.status(), card.attended);
    let machine = lathe.machine();
    if let Some(fault) = machine.fault() {
        return Err(ProgramRunError::Servo(fault));
    }
    let cuts = lathe.cuts.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    cut_away(part, stand.bench, &cuts, stand.seed);
    let (trips, degc) = lathe.trips.iter().cloned().unzip();
    Ok(ProgramResult {
        events,
        status,
        seconds: machine.now_ns() as f64 * 1e-9,
        mtc_minus_scale: [0, 1].map(|n| machine.mtc_minus_scale(n)),
        trips,
        degc,
    })
}

/// Pairs the trips of axis 0 (Z) and 1 (X) by their time.
/// Positions are of the scale's edges: a whole number is the boundary below a count.
pub fn captured(events: &[Event]) -> CapturedTrips {
    struct AxisTripPair {
        trip_ns: (u64, u64),
        /// Position and half width of Z and X, counts.
        both: [Option<(f64, f64)>; 2],
    }
    let mut open: Vec<AxisTripPair> = Vec::new();
    let mut bounces = Vec::new();
    for event in events {
        let Some(axis @ 0..=1) = event.axis else { continue };
        match event.kind {
            EventKind::Trip(c) => {
                let seen = Some(c.position_counts());
                let at = open.iter().position(|o| o.trip_ns == c.trip_ns).unwrap_or_else(|| {
                    open.push(AxisTripPair { trip_ns: c.trip_ns, both: [None; 2] });
                    open.len() - 1
                });
                open[at].both[usize::from(axis)] = seen;
            }
            EventKind::Bounce => bounces.push(open.len().max(1)),
            _ => {}
        }
    }
    bounces.dedup();
    let trips = open
        .into_iter()
        .filter_map(|AxisTripPair { trip_ns: (low, high), both }| {
            let [Some((z, dz)), Some((x, dx))] = both else { return None };
            Some(([z, x], dz.hypot(dx), (low + high) as f64 / 2e9))
        })
        .collect();
    CapturedTrips { trips, bounces }
}
