//! The Error Correction Circuit behind a controller that knows the acceleration.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{DirectOutputs, RequestedTotal, TracePoint};
use rtec_sim::engine_replay::replay_with;
use rtec_sim::error_correction_circuit::{ErrorCorrectionCircuitAxis, PllFrequencyLimits};
use rtec_sim::insertion_design_bench::there_and_back;

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
            let start = |card: &mut _| {
                Ok(ErrorCorrectionCircuitAxis::new(PllFrequencyLimits::default(), 1, card)?.guarded(accel))
            };
            let (outcome, _) = replay_with::<_, _, _, _, _, std::convert::Infallible>(
                DirectOutputs,
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
