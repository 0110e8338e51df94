//! Corrected traces made without the engine, right and wrong ones.
//! They test the judges.

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use test_needs::dice::Dice;

/// The mistake in a planted trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlantedFault {
    /// The trace is right.
    None,
    /// One insertion is left out: two counts too few or too many.
    Missing,
    /// One insertion is made in the wrong order: four counts off.
    WrongOrder,
    /// One insertion turns both inverters at once: an illegal transition.
    BothAtOnce,
}

/// Motion with strokes, reversals and a dither at each end.
/// It starts at rest in state 00.
pub fn motion(edges: usize) -> Vec<TracePoint> {
    let mut at = TracePoint::default();
    let (mut points, mut dice) = (vec![at], Dice::new(0));
    for n in 0..edges {
        // 3000 counts up and 2500 down. In each 16th group of 16 edges every edge is a reversal.
        let dither = n % 256 < 16;
        let up = if dither { n % 2 == 0 } else { n % 5500 < 3000 };
        at.t_ns += 1100 + dice.bits() % 3000;
        at.state = at.state.next(up);
        points.push(at);
    }
    points
}

/// Inserts ±2 counts after every `every`-th edge with a long enough pause.
/// The order of signs looks random. Returns the states at the MTC, with the count due at each.
/// It is written from the three count tables of NISTIR 4832, Design C, and not from the engine. Where A and B are
/// equal, A first adds and B first subtracts; elsewhere the opposite. The second inversion follows `separation_ns`
/// after the first.
pub fn corrected(
    scale: &[TracePoint],
    every: usize,
    separation_ns: u64,
    fault: PlantedFault,
) -> Vec<(TracePoint, i64)> {
    let first = scale[0];
    let mut out = vec![(first, 0_i64)];
    let (mut mask, mut scale_counts, mut inserted, mut insertions) = (0_u8, 0_i64, 0_i64, 0_usize);
    let wrong_one = scale.len() / every / 2;
    let mut dice = Dice::new(0);
    for (n, pair) in scale.windows(2).enumerate() {
        let (edge, add) = (pair[1], dice.bits() & 1 == 0);
        scale_counts += up_table(pair[0].state, edge.state);
        let see = |mask| State::from_bits(edge.state.bits() ^ mask);
        out.push((TracePoint { t_ns: edge.t_ns, state: see(mask) }, scale_counts + inserted));
        let pause = scale.get(n + 2).map_or(u64::MAX, |next| next.t_ns - edge.t_ns);
        if n % every != 0 || pause < 2 * separation_ns + 100 {
            continue;
        }
        insertions += 1;
        let equal = edge.state.a() == edge.state.b();
        let fault = if insertions == wrong_one { fault } else { PlantedFault::None };
        let a_first = (equal == add) != (fault == PlantedFault::WrongOrder);
        let (one, two) = if a_first { (1, 2) } else { (2, 1) };
        let step = if add { 1 } else { -1 };
        let due = scale_counts + inserted;
        let (early, late) = (edge.t_ns + 50, edge.t_ns + 50 + separation_ns);
        match fault {
            PlantedFault::Missing => {}
            PlantedFault::BothAtOnce => {
                out.push((TracePoint { t_ns: late, state: see(mask ^ 3) }, due + 2 * step));
                mask ^= 3;
            }
            _ => {
                out.push((TracePoint { t_ns: early, state: see(mask ^ one) }, due + step));
                out.push((TracePoint { t_ns: late, state: see(mask ^ one ^ two) }, due + 2 * step));
                mask ^= 3;
            }
        }
        inserted += 2 * step;
    }
    out
}

/// +1 along the report's cycle 00 → 10 → 11 → 01 → 00, else −1.
fn up_table(from: State, to: State) -> i64 {
    let place = |s: State| {
        [(false, false), (true, false), (true, true), (false, true)].iter().position(|&c| c == (s.a(), s.b()))
    };
    if place(to).map(|p| (p + 3) % 4) == place(from) { 1 } else { -1 }
}
