//! The Error Correction Circuit on both axes behind one embedded controller.
//! X/Z selects the axis, S1 and S0 give the operation, and four bits give its number. A short acknowledgement
//! ends it (CMTI 2014, section 2).

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample};
use rtec_driver::quadrature::{Decoder, State};
use rtec_sim::corrected_axis::{CorrectedAxis, MtcDecoder};
use rtec_sim::error_correction_circuit::{
    EccControlLines, ErrorCorrectionCircuitAxis, PllFrequencyLimits, PulseCountTooLarge,
};
use rtec_sim::insertion_design_bench::Edge;
use rtec_sim::insertion_design_comparison::trace;
use std::fmt::Write as _;

/// A compensation that the embedded controller requests, one after another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// X/Z: the X axis, otherwise the Z axis.
    pub x: bool,
    /// S1: a compensation is required.
    pub s1: bool,
    /// S0: addition, otherwise subtraction.
    pub s0: bool,
    /// The compensation value, pulses.
    pub value: u8,
}

/// Results for both axes, and the signals.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Board {
    /// Counts to the MTC minus counts of the scale, X and Z.
    pub mtc_minus_scale: [i64; 2],
    /// Pulses (rising edges of A) of the scale and at the MTC, X and Z.
    pub pulses: [[u64; 2]; 2],
    /// Acknowledgements on X and Z.
    pub acknowledged: [u64; 2],
    /// Illegal transitions at the MTC, X and Z.
    pub illegal: [u64; 2],
    /// Largest deviation from 90° between two edges of a split pulse, 0.001°.
    pub worst_phase_mdeg: u64,
    /// Every change: time, ns; signal; level.
    pub changes: Vec<(u64, &'static str, bool)>,
}

/// Signals of a board's trace.
pub const SIGNALS: [&str; 12] =
    ["x_a", "x_b", "x_a_mtc", "x_b_mtc", "z_a", "z_b", "z_a_mtc", "z_b_mtc", "xz", "s1", "s0", "ack"];

/// One axis's wires: the scale's edges in, A' and B' out.
#[derive(Debug)]
struct Wires<'a> {
    edges: &'a [Edge],
    next: usize,
    t_ns: u64,
    scale: Decoder,
    mtc: MtcDecoder,
    pulses: [u64; 2],
    names: [&'static str; 4],
    changes: Vec<(u64, &'static str, bool)>,
}

impl Wires<'_> {
    fn changed(&mut self, from: State, to: State, which: usize) {
        self.pulses[which] += u64::from(to.a() && !from.a());
        for (name, was, is) in
            [(self.names[2 * which], from.a(), to.a()), (self.names[2 * which + 1], from.b(), to.b())]
        {
            if was != is {
                self.changes.push((self.t_ns, name, is));
            }
        }
    }
}

impl Card for Wires<'_> {
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        let edge = self.edges.get(self.next).copied().filter(|e| e.0 <= wake_ns);
        let mut edge_ns = None;
        if let Some((t_ns, step)) = edge {
            self.next += 1;
            self.t_ns = t_ns;
            let (from, to) = (self.scale.state(), self.scale.state().next(step > 0));
            self.scale.update(to);
            self.changed(from, to, 0);
            edge_ns = Some(t_ns);
        } else {
            self.t_ns = self.t_ns.max(wake_ns);
        }
        Ok(CardInputSample::stamped(self.t_ns, u64::from(self.scale.state().bits()), edge_ns))
    }

    fn write(&mut self, _mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let lines = AxisLines::standard(0, false);
        let (from, to) = (self.mtc.decoder().state(), State::from_bits(lines.inverters(value)));
        if from != to {
            self.mtc.update(self.t_ns, to);
            self.changed(from, to, 1);
        }
        Ok(Some(self.t_ns))
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(u64::from(self.mtc.decoder().state().bits()))
    }
}

/// Reason why a board could not be run.
#[derive(Debug, thiserror::Error)]
pub enum BoardError {
    /// The wires failed.
    #[error(transparent)]
    Card(#[from] CardError),
    /// An order has too large a value.
    #[error(transparent)]
    Order(#[from] PulseCountTooLarge),
}

/// Time between two steps of the controller's program, ns.
const STEP_NS: u64 = 1000;

/// Runs both axes over their edges (X, Z) while the controller executes its orders.
/// The first order begins at `from_ns`. An order without S1 waits for `idle_ns`.
///
/// # Errors
/// An order of more than four bits; these wires never fail.
pub fn run(
    pll: PllFrequencyLimits,
    edges: [&[Edge]; 2],
    orders: &[Order],
    (from_ns, idle_ns): (u64, u64),
    seed: u64,
) -> Result<Board, BoardError> {
    let mut wires = [0, 1].map(|n| Wires {
        edges: edges[n],
        next: 0,
        t_ns: 0,
        scale: Decoder::default(),
        mtc: MtcDecoder::new(State::default()),
        pulses: [0; 2],
        names: [0, 1, 2, 3].map(|k| SIGNALS[4 * n + k]),
        changes: Vec::new(),
    });
    let [x, z] = &mut wires;
    let mut circuits =
        [ErrorCorrectionCircuitAxis::new(pll, seed, x)?, ErrorCorrectionCircuitAxis::new(pll, seed + 1, z)?];
    for circuit in &mut circuits {
        circuit.set_lines(false, false, 0)?;
    }
    let end_ns = edges.iter().filter_map(|e| e.last()).map(|e| e.0).max().unwrap_or(0);
    let (mut orders, mut under_way) = (orders.iter(), None::<(Order, u64, u64)>);
    let mut board = Board::default();
    let mut now_ns = 0;
    while now_ns < end_ns {
        now_ns += STEP_NS;
        for (circuit, wires) in circuits.iter_mut().zip(&mut wires) {
            while wires.t_ns < now_ns {
                circuit.poll(wires, now_ns, &mut |_| true)?;
            }
        }
        if now_ns < from_ns {
            continue;
        }
        // The program needs one step to see that an order is over, and another to begin the next.
        under_way = match under_way {
            Some((order, since_ns, before)) => {
                let acknowledged = circuits[usize::from(!order.x)].acknowledged() > before;
                let over = if order.s1 { acknowledged } else { now_ns >= since_ns + idle_ns };
                (!over).then_some((order, since_ns, before))
            }
            None => match orders.next() {
                None => None,
                Some(order) => {
                    for (n, circuit) in circuits.iter_mut().enumerate() {
                        circuit.select((n == 0) == order.x);
                    }
                    board.changes.push((now_ns, "xz", order.x));
                    let circuit = &mut circuits[usize::from(!order.x)];
                    circuit.set_lines(order.s1, order.s0, order.value)?;
                    Some((*order, now_ns, circuit.acknowledged()))
                }
            },
        };
    }
    for (n, (circuit, wires)) in circuits.iter().zip(&mut wires).enumerate() {
        board.mtc_minus_scale[n] = wires.mtc.decoder().count() - wires.scale.count();
        board.pulses[n] = wires.pulses;
        board.acknowledged[n] = circuit.acknowledged();
        board.illegal[n] = wires.mtc.decoder().illegal();
        board.worst_phase_mdeg = board.worst_phase_mdeg.max((circuit.worst_phase_deg() * 1e3) as u64);
        board.changes.append(&mut wires.changes);
        // One set of lines: to the selected axis, and its answer.
        let mut was = EccControlLines::default();
        for (t_ns, is) in circuit.lines_log() {
            for (name, was, is) in [("s1", was.s1, is.s1), ("s0", was.s0, is.s0), ("ack", was.ack, is.ack)] {
                if was != is {
                    board.changes.push((*t_ns, name, is));
                }
            }
            was = *is;
        }
    }
    board.changes.sort_by_key(|c| c.0);
    Ok(board)
}

impl Board {
    /// Duration of each acknowledgement, ns.
    pub fn ack_ns(&self) -> Vec<u64> {
        let mut on = None;
        let acks = self.changes.iter().filter(|c| c.1 == "ack");
        acks.filter_map(|&(t_ns, _, is)| {
            let began = std::mem::replace(&mut on, is.then_some(t_ns));
            (!is).then_some(t_ns - began?)
        })
        .collect()
    }

    /// The timing diagram of the n-th compensation, as in figures 8 and 9 of the paper.
    /// It begins before S1 rises and ends after the acknowledgement, each by half the compensation's
    /// duration. `None` if there is no such compensation.
    pub fn svg(&self, n: usize, title: &str) -> Option<String> {
        let (at, begin) = self.changes.iter().enumerate().filter(|(_, c)| c.1 == "s1" && c.2).nth(n)?;
        let end_ns = self.changes[at..].iter().find(|c| c.1 == "ack" && c.2)?.0;
        let beside_ns = (end_ns - begin.0) / 2;
        let (from_ns, to_ns) = (begin.0.saturating_sub(beside_ns), end_ns + beside_ns);
        let x_selected = self.changes[..at].iter().rev().find(|c| c.1 == "xz").is_some_and(|c| c.2);
        let own = if x_selected { &SIGNALS[..4] } else { &SIGNALS[4..8] };
        let (left, right) = (90.0, 1240.0);
        let x = |t_ns: u64| left + (right - left) * (t_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1280 430\" font-family=\"sans-serif\" \
             font-size=\"14\">\n<rect width=\"1280\" height=\"430\" fill=\"white\"/>\n<text x=\"{left}\" \
             y=\"22\">{title}</text>\n"
        );
        let names = ["s1", "s0"].iter().chain(own).chain(&["ack"]);
        for (row, name) in names.enumerate() {
            let before =
                self.changes.iter().rev().find(|c| c.1 == *name && c.0 < from_ns).is_some_and(|c| c.2);
            let within = self
                .changes
                .iter()
                .filter(|c| c.1 == *name && (from_ns..=to_ns).contains(&c.0))
                .map(|c| (x(c.0), c.2));
            let colour = match *name {
                "s1" | "s0" | "ack" => "#009e73",
                name if name.ends_with("mtc") => "#0072b2",
                _ => "#505050",
            };
            let place = (left, right, 80.0 + 52.0 * row as f64);
            text += &trace((name, colour), place, std::iter::once((left, before)).chain(within));
        }
        let ms = |t_ns: u64| t_ns as f64 * 1e-6;
        let _ = writeln!(
            text,
            "<text x=\"{left}\" y=\"422\">{:.3} ms</text><text x=\"{right}\" y=\"422\" text-anchor=\"end\">{:.3} ms</text>",
            ms(from_ns),
            ms(to_ns)
        );
        Some(text + "</svg>\n")
    }

    /// The board's signals as a value change dump (IEEE 1364).
    /// They are [`SIGNALS`], all low at the start.
    pub fn to_vcd(&self) -> String {
        let code = |n: usize| char::from(b'!' + n as u8);
        let mut text = "$timescale 1 ns $end\n$scope module ecc $end\n".to_owned();
        for (n, name) in SIGNALS.iter().enumerate() {
            let _ = writeln!(text, "$var wire 1 {} {name} $end", code(n));
        }
        text += "$upscope $end\n$enddefinitions $end\n#0\n";
        for n in 0..SIGNALS.len() {
            let _ = writeln!(text, "0{}", code(n));
        }
        let (mut last_ns, mut levels) = (0, [false; SIGNALS.len()]);
        for &(t_ns, name, is) in &self.changes {
            let n = SIGNALS.iter().position(|s| *s == name).unwrap_or_default();
            if std::mem::replace(&mut levels[n], is) == is {
                continue;
            }
            if t_ns != last_ns {
                let _ = writeln!(text, "#{t_ns}");
                last_ns = t_ns;
            }
            let _ = writeln!(text, "{}{}", u8::from(is), code(n));
        }
        text
    }
}
