//! The Error Correction Circuit with its controller's lines (CMTI 2014, section 2).
//! It is judged by the pulses counted in the trace.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_papers::ecc_board::{Board, Order, SIGNALS, run};
use rtec_sim::error_correction_circuit::{ACK_NS, PllFrequencyLimits};
use rtec_sim::insertion_design_bench::{Edge, constant};

fn board(orders: &[Order], direction: i64) -> Board {
    let edges: Vec<Edge> = constant(1_000_000, 10_000.0, 4000, direction);
    run(PllFrequencyLimits::default(), [&edges, &edges], orders, (3_000_000, 4_000_000), 1).unwrap()
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

/// In the first cycle of a motion the loop has not followed yet.
/// Lines set by hand do not wait for it: the VCO then sends its missing ticks later.
#[test]
fn lines_set_by_hand_send_one_edge_at_a_time_from_the_first_cycle_on() {
    for hz in [500.0, 2000.0, 10_000.0, 60_000.0, 79_000.0] {
        let edges = constant(1_000_000, hz, 4000, 1);
        let order = Order { x: true, s1: true, s0: true, value: 15 };
        let board = run(PllFrequencyLimits::default(), [&edges, &edges], &[order], (0, 0), 1).unwrap();
        assert_eq!((board.illegal, board.mtc_minus_scale), ([0; 2], [60, 0]), "{hz} Hz");
    }
}
