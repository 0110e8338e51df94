//! CMTI (2014): the Error Correction Circuit.

use crate::ecc_board::{Board, Order, run as run_board};
use crate::rows::Agreement::{Share, Within};
use crate::rows::{Rows, shown};
use crate::{PaperError, Progress};
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::error_correction_circuit::{MAX_PULSES, PllFrequencyLimits};
use rtec_sim::insertion_design_bench::{BenchResult, BenchRun, Edge, InsertionDesign, constant};
use serde::Deserialize;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Circuit {
    pulses_per_revolution: f64,
    pitch_mm: f64,
    fastest_m_min: f64,
    shown_pulses: u8,
    shown_encoder_hz: f64,
    pll: PllFrequencyLimits,
}

impl Circuit {
    /// The circuit within its own limits: four bits (section 2.2.7), the loop's range (section 2.2.2).
    fn read(described: &MachineDescriptions) -> Result<Self, PaperError> {
        let file = "cmti.toml";
        let circuit: Self = described.read(file)?;
        let refuse = |key: &str, found: String, expected: String| {
            Err(described.refuse(file, key, format!("{key} = {found}"), expected).into())
        };
        let pll = circuit.pll;
        if !(1..=MAX_PULSES).contains(&i64::from(circuit.shown_pulses)) {
            let expected = format!("1 to {MAX_PULSES} pulses: the compensation value has four bits");
            return refuse("shown_pulses", circuit.shown_pulses.to_string(), expected);
        }
        let range = [
            ("lock_from_hz", pll.lock_from_hz),
            ("clean_from_hz", pll.clean_from_hz),
            ("clean_to_hz", pll.clean_to_hz),
            ("lock_to_hz", pll.lock_to_hz),
        ];
        let mut below = 0.0;
        for (key, hz) in range {
            if !hz.is_finite() || hz <= below {
                let expected = format!(
                    "more than {} Hz: frequencies rise from lock_from_hz to lock_to_hz",
                    shown(below)
                );
                return refuse(key, shown(hz), expected);
            }
            below = hz;
        }
        let encoder = [pll.lock_from_hz / 2.0, pll.lock_to_hz / 2.0];
        if !(encoder[0]..=encoder[1]).contains(&circuit.shown_encoder_hz) {
            let expected = format!(
                "{} to {} Hz: the loop locks to twice the encoder's frequency, from lock_from_hz to lock_to_hz",
                shown(encoder[0]),
                shown(encoder[1])
            );
            return refuse("shown_encoder_hz", shown(circuit.shown_encoder_hz), expected);
        }
        for (key, v) in [
            ("pulses_per_revolution", circuit.pulses_per_revolution),
            ("pitch_mm", circuit.pitch_mm),
            ("fastest_m_min", circuit.fastest_m_min),
            ("follow_ns", pll.follow_ns),
        ] {
            if !(v.is_finite() && v > 0.0) {
                return refuse(key, shown(v), "a number above 0".to_owned());
            }
        }
        Ok(circuit)
    }
}

fn cannot(what: &str) -> PaperError {
    PaperError::Cannot(format!("CMTI: {what} cannot be run on the circuit as described"))
}

pub(crate) fn run(
    described: &MachineDescriptions,
    seed: u64,
    progress: Progress<'_>,
) -> Result<Rows, PaperError> {
    let circuit = Circuit::read(described)?;
    let mut rows = Rows::default();
    progress("CMTI: control lines, subtraction and addition");
    let board = figures(&circuit, seed)?;
    table_1(&mut rows, &circuit, seed)?;
    lines(&mut rows, &board);
    shown_pulses(&mut rows, &board);
    for (n, what) in ["subtraction", "addition"].into_iter().enumerate() {
        let title = format!("Figure {}: {what}, compensation value {}", 8 + n, circuit.shown_pulses);
        let svg = board.svg(n, &title).ok_or_else(|| cannot(what))?;
        rows.figures.push((format!("figure-{}.svg", 8 + n), svg));
    }
    rows.figures.push(("cmti.vcd".to_owned(), board.to_vcd()));
    progress("CMTI: the PLL's range");
    frequencies(&mut rows, &circuit, seed)?;
    fifteen(&mut rows, &circuit, seed)?;
    Ok(rows)
}

/// Both axes at the same speed; X is spoken to, then Z.
fn both(circuit: &Circuit, orders: &[Order], seed: u64) -> Result<(Board, u64), PaperError> {
    let hz = circuit.shown_encoder_hz;
    let period_ns = (1e9 / hz) as u64;
    let edges: Vec<Edge> = constant(1_000_000, hz, 4 * (40 + 120 * orders.len() as u64), 1);
    let times = (1_000_000 + 20 * period_ns, 40 * period_ns);
    let board =
        run_board(circuit.pll, [&edges, &edges], orders, times, seed).map_err(|_| cannot("the board"))?;
    Ok((board, period_ns))
}

/// The orders of figures 8 and 9, on X and then on Z.
fn figures(circuit: &Circuit, seed: u64) -> Result<Board, PaperError> {
    let value = circuit.shown_pulses;
    let order = |x, s0| Order { x, s1: true, s0, value };
    Ok(both(circuit, &[order(true, false), order(true, true), order(false, true)], seed)?.0)
}

/// The trace of figures 8 and 9 with the controller's lines, as a value change dump.
///
/// # Errors
/// A description that is not right.
pub fn trace(described: &MachineDescriptions, seed: u64) -> Result<String, PaperError> {
    Ok(figures(&Circuit::read(described)?, seed)?.to_vcd())
}

fn table_1(rows: &mut Rows, circuit: &Circuit, seed: u64) -> Result<(), PaperError> {
    let n = f64::from(circuit.shown_pulses);
    let per_pulse = 4.0;
    for (s1, s0, says, pulses) in [
        (false, false, "only encoder pulses", 0.0),
        (false, true, "only encoder pulses", 0.0),
        (true, false, "subtraction", -n),
        (true, true, "addition", n),
    ] {
        let (board, _) = both(circuit, &[Order { x: true, s1, s0, value: circuit.shown_pulses }], seed)?;
        let came = board.mtc_minus_scale[0] as f64;
        let what = format!("S1 = {}, S0 = {}: {says}", u8::from(s1), u8::from(s0));
        let why = "the PLL of the machine file does not lock at the speed shown";
        rows.number(("Table 1", &what, "counts"), per_pulse * pulses, came, Within(0.0), why);
    }
    Ok(())
}

/// X/Z, the acknowledgement, and what the other axis saw of it.
fn lines(rows: &mut Rows, board: &Board) {
    let place = "Section 2";
    let what = "X/Z: 1 for the X axis, 0 for Z, as the orders were given";
    let gets = board
        .changes
        .iter()
        .filter(|c| c.1 == "xz")
        .map(|c| u8::from(c.2).to_string())
        .collect::<Vec<_>>()
        .join(" ");
    rows.given().words((place, what), "1 1 0", &gets, "");
    let gets = board.mtc_minus_scale[0] as f64;
    rows.number((place, "counts on X of one subtraction and one addition", ""), 0.0, gets, Within(0.0), "");
    let gets = format!("{} and {}", board.acknowledged[0], board.acknowledged[1]);
    rows.words((place, "acknowledgements from the X board and the Z board"), "2 and 1", &gets, "");
    let on = |name: &str, is: bool| board.changes.iter().filter(|c| c.1 == name && c.2 == is).count();
    let what = "acknowledgement pulses in the trace of three compensations";
    rows.number(("Section 2.3", what, ""), 3.0, on("ack", true) as f64, Within(0.0), "");
}

fn shown_pulses(rows: &mut Rows, board: &Board) {
    let place = "Figures 8 and 9";
    let other = "the machine file shows another number of pulses";
    // The first order subtracts on X, the third adds on Z alone.
    let [scale, mtc] = board.pulses[1];
    let gets = mtc as f64 - scale as f64;
    rows.number((place, "pulses added for a value of 3", ""), 3.0, gets, Within(0.0), other);
    let mut before = 0;
    let mut blocked = 0;
    // Rising edges of the scale's A while the MTC's stays low: up to the first acknowledgement.
    for c in board.changes.iter().take_while(|c| c.1 != "ack") {
        match (c.1, c.2) {
            ("x_a", true) => before += 1,
            ("x_a_mtc", true) => blocked += 1,
            _ => {}
        }
    }
    let gets = f64::from(before - blocked);
    rows.number((place, "pulses subtracted for a value of 3", ""), 3.0, gets, Within(0.0), other);
    let why = "the PLL of the machine file is not clean at the speed shown";
    let gets = board.worst_phase_mdeg as f64 / 1e3;
    rows.number((place, "the 90° between A and B, largest deviation", "°"), 0.0, gets, Within(0.5), why);
    let gets = (board.illegal[0] + board.illegal[1]) as f64;
    rows.number((place, "illegal states at the controller", ""), 0.0, gets, Within(0.0), "");
}

fn frequencies(rows: &mut Rows, circuit: &Circuit, seed: u64) -> Result<(), PaperError> {
    let place = "Section 2.2.2";
    let hz = circuit.fastest_m_min * 1e3 / 60.0 / circuit.pitch_mm * circuit.pulses_per_revolution;
    // Counted, not only reckoned: over a tenth of a second.
    let edges = constant(0, hz, (4.0 * hz / 10.0) as u64, 1);
    let computer = ComputerTiming::dsp();
    let seen = BenchRun { edges: &edges, keep_log: true, ..BenchRun::new(InsertionDesign::C, &computer) };
    let seen = seen.run().ok_or_else(|| cannot("the fastest motion"))?;
    let (mut a, mut xor) = (0_u64, 0_u64);
    for w in seen.log.windows(2) {
        a += u64::from(!w[0].1.a() && w[1].1.a());
        xor += u64::from(w[0].1.a() == w[0].1.b() && w[1].1.a() != w[1].1.b());
    }
    let about = "the paper says \"about\" and rounds 83.3 kHz down to 80";
    let what = "encoder at 10 m/min, 2500 pulses a turn of 5 mm";
    rows.given().number((place, what, "kHz"), 80.0, a as f64 / 100.0, Share(0.05), about);
    let gets = xor as f64 / 100.0;
    rows.given().number((place, "XOR of A and B at that speed", "kHz"), 160.0, gets, Share(0.05), about);
    let dsp = ComputerTiming::dsp();
    let run = BenchRun { pll: circuit.pll, seed, ..BenchRun::new(InsertionDesign::Ecc, &dsp) };
    let (low, high) = run.safe_range();
    let put_in = "what the paper measured of its PLL is put into the model; here it is found again from what reaches the \
                  controller, by bisection";
    let gets = 2.0 * low / 1e3;
    rows.given().number((place, "doubling is perfect from (XOR)", "kHz"), 2.3, gets, Share(0.01), put_in);
    rows.given().number((place, "to (XOR)", "kHz"), 125.0, 2.0 * high / 1e3, Share(0.01), put_in);
    let edge_of_range = "put in as the loop's lock range, and found again by bisection: beyond it the controller asks for no addition";
    // Doubling at all: the right number, whatever the phase.
    let counts = |xor_hz: f64| {
        let edges = constant(1_000_000, xor_hz / 2.0, 6000, 1);
        compensated(circuit, &edges, 2000, 12, seed).is_some_and(|s| s.illegal == 0)
    };
    let middle = (2.3e3_f64 * 125e3).sqrt();
    let edge = |mut good: f64, mut bad: f64| {
        if counts(bad) {
            return bad;
        }
        while (good / bad).max(bad / good) > 1.003 {
            let between = (good * bad).sqrt();
            *if counts(between) { &mut good } else { &mut bad } = between;
        }
        good
    };
    let gets = edge(middle, 100.0) / 1e3;
    rows.given().number((place, "it begins to double at (XOR)", "kHz"), 0.7, gets, Share(0.2), edge_of_range);
    let gets = edge(middle, 1e6) / 1e3;
    rows.given().number((place, "it goes on to (XOR)", "kHz"), 160.0, gets, Share(0.05), edge_of_range);
    Ok(())
}

/// A total asked at an edge of a motion, if all of it was inserted.
fn compensated(circuit: &Circuit, edges: &[Edge], at: usize, total: i64, seed: u64) -> Option<BenchResult> {
    let (dsp, totals) = (ComputerTiming::dsp(), [(edges[at].0, total)]);
    let new = BenchRun::new(InsertionDesign::Ecc, &dsp);
    let seen = BenchRun { edges, totals: &totals, pll: circuit.pll, seed, ..new }.run();
    seen.filter(|s| s.completed == total && s.error_counts() == 0)
}

/// Four bits: more than fifteen pulses take another compensation.
fn fifteen(rows: &mut Rows, circuit: &Circuit, seed: u64) -> Result<(), PaperError> {
    let place = "Section 2.2.7";
    let edges = constant(1_000_000, circuit.shown_encoder_hz, 4000, 1);
    let at_once = |n: &i64| compensated(circuit, &edges, 500, 4 * n, seed).is_some_and(|s| s.insertions == 1);
    let most = (1..40).take_while(at_once).last().unwrap_or(0);
    let what = "largest compensation value, pulses: four bits";
    let why = "the PLL of the machine file does not lock at the speed shown";
    rows.given().number((place, what, ""), 15.0, most as f64, Within(0.0), why);
    let (board, _) = both(circuit, &[Order { x: true, s1: true, s0: true, value: MAX_PULSES as u8 }], seed)?;
    // While it compensates, pulses of the MTC from the beginning of S1 to the acknowledgement.
    let began = board.changes.iter().position(|c| c.1 == "s1" && c.2).unwrap_or(0);
    let ended = board.changes.iter().position(|c| c.1 == "ack" && c.2).unwrap_or(0);
    let during = board.changes.get(began..ended).unwrap_or_default();
    let scale = during.iter().filter(|c| c.1 == "x_a" && c.2).count() as f64;
    let mtc = during.iter().filter(|c| c.1 == "x_a_mtc" && c.2).count() as f64;
    let what = "pulses passed while 15 are added, twice the value: the full adder's sum";
    let why = "counted from S1, which comes up to a cycle before the first split pulse";
    rows.number((place, what, ""), 30.0, mtc - (scale - 15.0).max(0.0), Within(1.0), why);
    Ok(())
}
