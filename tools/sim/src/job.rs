//! A program on the lathe with the unchanged engine between scales and controller, and a corrector that is told what
//! probing has found and what is known of the machine.

use crate::attended::Attended;
use crate::errors::layout;
use crate::lathe::{Lathe, Move, Stand, axes, cut_away};
use crate::machine::ServoFault;
use crate::path::AXES;
use crate::polled::Polled;
use crate::workpiece::Workpiece;
use rtec_driver::card::{AxisLines, CardError, MachineLines};
use rtec_model::effect::Missing;
use rtec_model::live::{AxisNow, Live};
use rtec_model::machine::Machine as Model;
use rtec_part::fit::Zx;
use rtec_part::probe::Captured;
use rtec_part::table::{AxisCounts, Cut, Holding, Table};
use rtec_rt::axis::{AxisConfig, RestPolicy};
use rtec_rt::engine::{Engine, MachineConfig, StartError};
use rtec_rt::event::{Event, EventKind, Request, Status};

/// What a program on the machine is run for.
#[derive(Debug, Clone, Copy)]
pub enum Job<'a> {
    /// Cut without corrections.
    Cut,
    /// Cut with the corrections of a table, of a machine model, or of both: totals asked this long ahead, s.
    Corrected(Option<&'a Table>, Option<&'a Model>, f64),
    /// Probe with a tip of this radius, mm.
    Probe(f64),
}

/// What came of a program.
#[derive(Debug, Clone)]
pub struct Ran {
    /// Everything the engine said.
    pub events: Vec<Event>,
    /// The engine at the end.
    pub status: Status,
    /// How long it took.
    pub seconds: f64,
    /// The controller's own count minus the scale's, Z and X, by the machine's decoders, not the engine's.
    pub mtc_minus_scale: [i64; 2],
    /// Where the tip's centre was on the scales at each trip, part coordinates: the truth to hold captures against.
    pub trips: Vec<Zx>,
    /// What the sensors read at each trip, °C.
    pub degc: Vec<Vec<f64>>,
}

/// Why a program did not run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The engine refused to start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// No move at all.
    #[error("the program has no move")]
    NoMove,
    /// An effect reads what this machine does not have.
    #[error("effect {} reads {}; the simulated lathe has the axes z and x and the sensors T1 to T20", .0.effect, .0.what)]
    Missing(#[from] Missing),
    /// The controller gave up.
    #[error("the controller stopped: {0:?}")]
    Servo(ServoFault),
}

/// What the corrector is told, and what it asks for.
struct Law<'a> {
    table: Option<&'a Table>,
    known: Option<Live>,
    lead_s: f64,
    axes: [AxisCounts; 2],
    held: [Holding; 2],
    /// Time and place of the last look, and which way the axes went.
    last: Option<(f64, Zx)>,
    direction: [f64; 2],
}

impl Law<'_> {
    /// The totals that Z and X should have now, by what the engine counts.
    fn totals(&mut self, t_s: f64, status: &Status, lathe: &Lathe) -> [Request; 2] {
        let mm = |n: usize| status.axes[n].position_counts as f64 * self.axes[n].count_um * 1e-3;
        let place = Zx::new(mm(0), mm(1));
        let velocity = self.last.map_or(Zx::new(0.0, 0.0), |(t, p)| (place - p) * (1.0 / (t_s - t)));
        let first = self.last.replace((t_s, place)).is_none();
        let mut wanted =
            self.table.map_or(Zx::new(0.0, 0.0), |t| t.components_um(place, velocity, self.lead_s));
        if let Some(known) = &mut self.known {
            let due = place + velocity * self.lead_s;
            let mut axes = [AxisNow::default(); AXES];
            for (n, (p, position_mm, mm_s)) in
                [(2, due.z, velocity.z), (0, due.x, velocity.x)].into_iter().enumerate()
            {
                axes[p] = AxisNow::moving(position_mm, mm_s);
                if axes[p].direction == 0.0 {
                    // At rest an axis keeps the direction of its last motion.
                    axes[p].direction = self.direction[n];
                }
                self.direction[n] = axes[p].direction;
            }
            known.evaluate(&lathe.frame(lathe.t_s(), &axes));
            let errors_um = known.errors_um();
            wanted = wanted + Zx::new(errors_um[2], errors_um[0]);
        }
        let wanted_um = [wanted.z, wanted.x];
        [0, 1].map(|n| {
            let total_counts = self.held[n].request(&self.axes[n], wanted_um[n]);
            // The first total of a machine that is off already is meant, however large.
            Request::Correct { axis: n as u8, total_counts, large: first }
        })
    }
}

const LINES: [AxisLines; 2] = [AxisLines::standard(0, true), AxisLines::standard(1, true)];

/// The engine on the machine: homed, enabled, and probing where it is to.
fn engine(
    card: &mut Polled<Lathe>,
    stand: &Stand,
    probing: bool,
    tell: &mut impl FnMut(Event) -> bool,
) -> Result<Engine, StartError> {
    let poll_ns = stand.bench.poll_ns as u64;
    let configs = LINES.map(|lines| AxisConfig {
        lines,
        design: stand.design,
        window_counts: 64,
        min_separation_ns: 500,
        // An axis stands nearly still at either end of the arc, and must be right there too.
        rest: RestPolicy::Insert { after_ns: 5_000_000 },
        detect_ns: 2 * poll_ns,
        write_ns: poll_ns,
        ..AxisConfig::default()
    });
    let lines = MachineLines { probe: MachineLines::standard().probe, ..MachineLines::default() };
    let mut engine = Engine::new(card, &configs, MachineConfig { lines, may_arm: true }, &[])?;
    let mut orders = Vec::new();
    for n in 0..2 {
        let (axis, position_counts) = (n as u8, card.attended.machine().origin_counts(n));
        orders.push(Request::Home { axis, position_counts });
        orders.push(Request::ConfirmHome { axis, position_counts });
    }
    orders.push(Request::Enable);
    if probing {
        orders.push(Request::Probe(true));
    }
    for order in orders {
        engine.take(order, card, tell)?;
    }
    Ok(engine)
}

/// Run a program on the machine with the engine between scales and controller. The workpiece is what is left.
///
/// # Errors
/// The engine refuses the configuration, there is no move, or the controller gave up.
pub fn run(
    stand: &Stand,
    cut: &Cut,
    moves: &[Move],
    job: Job,
    part: &mut Workpiece,
) -> Result<Ran, RunError> {
    let start = moves.first().ok_or(RunError::NoMove)?.segment.at(0.0) + cut.origin;
    let tip_mm = if let Job::Probe(tip_mm) = job { Some(tip_mm) } else { None };
    let mut law = None;
    if let Job::Corrected(table, model, lead_s) = job {
        let known = model.map(|m| Live::of(m, layout(Vec::new()))).transpose()?;
        let (axes, held) = (axes(stand.bench, stand.design), [Holding::default(); 2]);
        law = Some(Law { table, known, lead_s, axes, held, last: None, direction: [0.0; 2] });
    }
    let known = law.as_mut().and_then(|l| l.known.as_mut());
    let lathe = Lathe::new(stand, start, cut.origin, moves, tip_mm, part, known)?;
    let over = |lathe: &Lathe| lathe.finished() || lathe.machine().fault().is_some();
    let mut card = Polled::new(lathe, over, stand.bench.poll_ns, stand.seed);
    let mut events = Vec::new();
    let mut tell = |event: Event| {
        events.push(event);
        true
    };
    let mut engine = engine(&mut card, stand, tip_mm.is_some(), &mut tell)?;
    card.attended.start();
    let (mut control_ns, period_ns) = (0_u64, (stand.bench.control_ms * 1e6) as u64);
    loop {
        match engine.poll(&mut card, control_ns.max(1), &mut tell) {
            Ok(()) => {}
            Err(CardError::Ended) => break,
            Err(error) => return Err(StartError::Card(error).into()),
        }
        let now_ns = engine.now_ns();
        if now_ns < control_ns {
            continue;
        }
        control_ns = now_ns + period_ns;
        if let Some(law) = &mut law {
            for request in law.totals(now_ns as f64 * 1e-9, &engine.status(), &card.attended) {
                engine.take(request, &mut card, &mut tell).map_err(StartError::Card)?;
            }
        }
    }
    let (status, lathe) = (engine.status(), card.attended);
    let machine = lathe.machine();
    if let Some(fault) = machine.fault() {
        return Err(RunError::Servo(fault));
    }
    let cuts = lathe.cuts().lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    cut_away(part, stand.bench, &cuts, stand.seed);
    let (trips, degc) = lathe.trips().iter().cloned().unzip();
    Ok(Ran {
        events,
        status,
        seconds: machine.now_ns() as f64 * 1e-9,
        mtc_minus_scale: [0, 1].map(|n| machine.mtc_minus_scale(n)),
        trips,
        degc,
    })
}

/// Pairs the trips of axis 0 (Z) and 1 (X) by their time. Positions are those of the scale's edges, whole at the boundary
/// below a count.
#[must_use]
pub fn captured(events: &[Event]) -> Captured {
    struct Open {
        trip_ns: (u64, u64),
        /// Position and half width of Z and X, counts.
        both: [Option<(f64, f64)>; 2],
    }
    let mut open: Vec<Open> = Vec::new();
    let mut bounces = Vec::new();
    for event in events {
        let Some(axis @ 0..=1) = event.axis else { continue };
        match event.kind {
            EventKind::Trip(c) => {
                let seen = Some(c.position_counts());
                let at = open.iter().position(|o| o.trip_ns == c.trip_ns).unwrap_or_else(|| {
                    open.push(Open { trip_ns: c.trip_ns, both: [None; 2] });
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
        .filter_map(|Open { trip_ns: (low, high), both }| {
            let [Some((z, dz)), Some((x, dx))] = both else { return None };
            Some(([z, x], dz.hypot(dx), (low + high) as f64 / 2e9))
        })
        .collect();
    Captured { trips, bounces }
}
