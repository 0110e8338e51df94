//! The Error Correction Circuit with its controller's lines (CMTI 2014, section 2).
//! It is judged by the pulses counted in the trace.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_driver::quadrature::State;
use rtec_driver::replay::{RequestedTotal, Through, TracePoint};
use rtec_sim::bench::{Edge, constant, there_and_back};
use rtec_sim::ecc::{ACK_NS, Ecc, Pll};
use rtec_sim::ecc_board::{Board, Order, SIGNALS, run};
use rtec_sim::replay::replay_with;

fn board(orders: &[Order], direction: i64) -> Board {
    let edges: Vec<Edge> = constant(1_000_000, 10_000.0, 4000, direction);
    run(Pll::default(), [&edges, &edges], orders, (3_000_000, 4_000_000), 1).unwrap()
}

/// Number of rising edges of a signal, counted independently.
fn pulses(board: &Board, name: &str) -> i64 {
    board.changes.iter().filter(|c| c.1 == name && c.2).count() as i64
}

/// Table 1: the output for each S1 and S0, in both directions.
/// It acts on the selected axis and never on the other.
#[test]
fn table_1_on_either_axis() {
    for direction in [1, -1] {
        for x in [true, false] {
            for (s1, s0, says) in [(false, false, 0), (false, true, 0), (true, false, -5), (true, true, 5)] {
                let seen = board(&[Order { x, s1, s0, value: 5 }], direction);
                let (mine, other) = if x { ("x", "z") } else { ("z", "x") };
                let more = |axis: &str| {
                    pulses(&seen, &format!("{axis}_a_mtc")) - pulses(&seen, &format!("{axis}_a"))
                };
                assert_eq!((more(mine), more(other)), (says, 0), "{direction} {x} {s1} {s0}");
                let counts = seen.mtc_minus_scale[usize::from(!x)];
                assert_eq!(counts, 4 * says * direction, "{direction} {x} {s1} {s0}");
                assert_eq!(pulses(&seen, "ack"), i64::from(s1));
                assert_eq!(pulses(&seen, "xz"), i64::from(x));
                assert_eq!(seen.illegal, [0, 0]);
                assert!(seen.ack_ns().iter().all(|ns| *ns == ACK_NS));
            }
        }
    }
}

/// The next order waits for the acknowledgement, and the trace contains every line.
#[test]
fn orders_wait_for_the_acknowledgement() {
    let orders = [
        Order { x: true, s1: true, s0: true, value: 3 },
        Order { x: false, s1: true, s0: false, value: 3 },
        Order { x: true, s1: true, s0: false, value: 3 },
    ];
    let seen = board(&orders, 1);
    assert_eq!((seen.acknowledged, seen.mtc_minus_scale), ([2, 1], [0, -12]));
    let order: Vec<&str> =
        seen.changes.iter().filter(|c| (c.1 == "s1" || c.1 == "ack") && c.2).map(|c| c.1).collect();
    assert_eq!(order, ["s1", "ack", "s1", "ack", "s1", "ack"]);
    let vcd = seen.to_vcd();
    for name in SIGNALS {
        assert!(vcd.contains(&format!(" {name} $end")), "{name}");
    }
    let times: Vec<u64> = vcd.lines().filter_map(|l| l.strip_prefix('#')?.parse().ok()).collect();
    assert!(times.windows(2).all(|w| w[0] < w[1]) && times.len() > 1000);
}

/// A controller that knows the axis's acceleration makes no error at a reversal.
/// The reversals are those that this acceleration allows.
#[test]
fn guarded_it_balances_over_every_reversal() {
    for accel in [2e5, 2e6] {
        for hz in [600.0, 5000.0, 40_000.0] {
            let edges = there_and_back(hz, accel, 4000, 1_000_000);
            let mut state = State::default();
            let mut points = vec![TracePoint { t_ns: 0, state }];
            points.extend(edges.iter().map(|(t_ns, step)| {
                state = state.next(*step > 0);
                TracePoint { t_ns: *t_ns, state }
            }));
            let last = edges.last().unwrap().0;
            let totals = (0..60).map(|n| RequestedTotal {
                t_ns: last * n / 60,
                requested: if n % 2 == 0 { 60 } else { -60 },
            });
            let start = |card: &mut _| Ok(Ecc::new(Pll::default(), 1, card)?.guarded(accel));
            let (outcome, _) = replay_with::<_, _, _, _, _, std::convert::Infallible>(
                Through,
                start,
                points.into_iter().map(Ok),
                totals.map(Ok),
                true,
                |_, _: State| {},
            )
            .unwrap();
            assert!(outcome.balanced() && outcome.illegal_out == 0, "{accel} {hz}: {outcome:?}");
            assert!(outcome.insertions > 0 || hz < 1000.0, "{accel} {hz}");
        }
    }
}
