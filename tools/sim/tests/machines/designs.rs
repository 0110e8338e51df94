//! Statements of the papers about their designs, each with report and section.

#![allow(clippy::unwrap_used)]

use rtec_driver::quadrature::State;
use rtec_rt::axis::AxisConfig;
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::insertion_design_bench::{BenchResult, BenchRun, InsertionDesign, constant, there_and_back};
use rtec_sim::insertion_design_comparison::{InsertionDesignComparison, TestMotion, compare, waveforms};

fn comparison(computer: &ComputerTiming) -> InsertionDesignComparison {
    compare(computer, TestMotion { counts: 4000, ..TestMotion::default() }, 1)
}

/// NISTIR 4832, The "Original RTEC", Designs A to C.
/// CMTI 2014: the whole table, on the 8051 and on a DSP.
#[test]
fn the_table_is_what_the_papers_say() {
    if !test_needs::long() {
        return;
    }
    for (computer, b_serves) in [(ComputerTiming::i8051(), false), (ComputerTiming::dsp(), true)] {
        let table = comparison(&computer);
        println!("{}", table.to_table());
        for row in &table.designs {
            assert_eq!((row.illegal_states, row.worst_count_error), (0, 0), "{row:?}");
            assert_eq!(row.signals_pass_through_computer, row.design == InsertionDesign::B);
            let states = match row.design {
                InsertionDesign::Original => 1,
                InsertionDesign::Ecc => 0,
                _ => 4,
            };
            assert_eq!(row.states_served_at_rest, states, "{row:?}");
            let words = row.when_computer_dies.as_str();
            match row.design {
                InsertionDesign::B => assert_eq!(words, "at any moment: the MTC sees an axis at rest"),
                InsertionDesign::Ecc => assert_eq!(words, "at any moment: the MTC goes on seeing the scale"),
                _ => assert!(
                    words.starts_with("between insertions: the MTC goes on seeing the scale"),
                    "{words}"
                ),
            }
            if row.design == InsertionDesign::B && b_serves {
                assert!(row.max_safe_encoder_hz > 40_000.0, "{row:?}");
            }
        }
    }
}

/// NISTIR 4832, The "Original RTEC": 4 µs + 3 µs + 2 µs = 9 µs.
/// At 30 kHz A and B are low for about 8 µs, which is too short. Design C takes somewhat less time.
#[test]
fn at_30_khz_nine_microseconds_no_longer_fit() {
    let computer = ComputerTiming::i8051();
    let run = |design, hz: f64| {
        let edges = constant(1_000_000, hz, 4000, 1);
        let totals = [(edges[500].0, 40), (edges[2000].0, -40)];
        BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(design, &computer) }.run().unwrap()
    };
    let slow = run(InsertionDesign::Original, 10_000.0);
    assert_eq!((slow.completed, slow.edge_to_done_ns), (-40, Some((9000, 9000))));
    assert_eq!(run(InsertionDesign::C, 10_000.0).edge_to_done_ns, Some((7000, 7000)));
    let rapid = run(InsertionDesign::Original, 30_000.0);
    assert_eq!((rapid.completed, rapid.error_counts()), (0, 0));
    assert!(rapid.waited_for_gate > 0);
    for design in [InsertionDesign::Original, InsertionDesign::A] {
        let (_, high) = BenchRun::new(design, &computer).safe_range();
        // A quarter of a cycle must hold 9 µs.
        assert!((27_000.0..27_800.0).contains(&high), "{design:?}: {high} Hz");
    }
    let (_, high) = BenchRun::new(InsertionDesign::C, &computer).safe_range();
    assert!((35_000.0..35_720.0).contains(&high), "{high} Hz");
}

/// Without its timer "the routine may run into the next signal transition".
/// (NISTIR 4832, The "Original RTEC")
#[test]
fn without_the_speed_gate_it_runs_into_the_next_transition() {
    let computer = ComputerTiming::i8051();
    let run = |hz: f64| {
        let edges = constant(1_000_000, hz, 4000, 1);
        let totals = [(edges[500].0, 40), (edges[2000].0, -40)];
        BenchRun {
            edges: &edges,
            totals: &totals,
            ungated: true,
            ..BenchRun::new(InsertionDesign::Original, &computer)
        }
        .run()
        .unwrap()
    };
    let wrong = |seen: &BenchResult| {
        seen.overlaps > 0 || seen.illegal > 0 || seen.error_counts() != 0 || seen.faults > 0
    };
    assert!(!wrong(&run(25_000.0)));
    assert!(wrong(&run(40_000.0)));
}

/// The Original keeps its ledger, so it begins only at A = B = low.
/// Its gates hide a pulse elsewhere.
#[test]
fn full_cycle_designs_keep_the_ledger() {
    let computer = ComputerTiming::i8051();
    for design in [InsertionDesign::Original, InsertionDesign::A] {
        for n in 0..60_u64 {
            let accel = 1e5 * (1 + n % 7) as f64;
            let edges = there_and_back(2000.0 + 700.0 * n as f64, accel, 1500 + 10 * n, 1_000_000);
            let at = |k: u64| edges[(k * 211 + n * 37) as usize % edges.len()].0;
            let mut totals: Vec<(u64, i64)> =
                (0..12).map(|k| (at(k), (k * 7 + n) as i64 % 41 - 20)).collect();
            totals.sort_unstable();
            let run = BenchRun {
                config: AxisConfig { max_accel_counts_s2: accel, ..AxisConfig::default() },
                start: State::from_bits(n as u8 % 4),
                edges: &edges,
                totals: &totals,
                ..BenchRun::new(design, &computer)
            };
            let seen = run.run().unwrap();
            let wrong = (seen.error_counts(), seen.illegal, seen.faults, seen.overlaps, seen.completed % 4);
            assert_eq!(wrong, (0, 0, 0, 0, 0), "{design:?} {n}: {seen:?}");
            assert!(seen.insertions > 0, "{design:?} {n}");
        }
    }
}

#[test]
fn full_cycle_designs_leave_less_than_four_counts() {
    let computer = ComputerTiming::i8051();
    let edges = constant(1_000_000, 5000.0, 400, 1);
    for design in [InsertionDesign::Original, InsertionDesign::A] {
        for (total, served) in [(7, 4), (3, 0), (-2, 0), (-3, 0), (-7, -4), (8, 8)] {
            let totals = [(edges[20].0, total)];
            let run = BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(design, &computer) };
            let seen = run.run().unwrap();
            assert_eq!((seen.completed, seen.mtc - seen.scale), (served, served), "{design:?} {total}");
        }
    }
}

/// The Original cannot insert at rest outside A = B = low; Design A can anywhere.
/// (NISTIR 4832, The "Original RTEC")
#[test]
fn the_original_cannot_insert_at_rest_outside_low_low() {
    let computer = ComputerTiming::i8051();
    for bits in 0..4 {
        for (design, served) in
            [(InsertionDesign::Original, bits == 0), (InsertionDesign::A, true), (InsertionDesign::C, true)]
        {
            let config = rtec_sim::insertion_design_bench::insert_at_rest(AxisConfig::default());
            let totals = [(1_000_000, 8), (60_000_000, 8)];
            let start = State::from_bits(bits);
            let seen = BenchRun { config, start, totals: &totals, ..BenchRun::new(design, &computer) }
                .run()
                .unwrap();
            assert_eq!(seen.completed, if served { 8 } else { 0 }, "{design:?} in {start:?}");
            assert_eq!(seen.mtc, seen.completed);
        }
    }
}

/// An 8051 is at least ten times too slow for the moderate 100 kHz of Design B.
/// (NISTIR 4832, Design B)
/// A position count and a correction count have the same size. When the computer stops, position feedback is
/// lost.
#[test]
fn design_b_needs_a_faster_computer_and_steps_by_one() {
    let computer = ComputerTiming::dsp();
    assert!(!BenchRun::new(InsertionDesign::B, &ComputerTiming::i8051()).safe_at(10_000.0));
    assert!(BenchRun::new(InsertionDesign::B, &computer).safe_at(40_000.0));
    // "Current generation digital signal processors have the speed capability to handle these signals."
    let edges = constant(1_000_000, 100_000.0, 4000, 1);
    let passed = BenchRun { edges: &edges, ..BenchRun::new(InsertionDesign::B, &computer) }.run().unwrap();
    assert_eq!((passed.mtc, passed.illegal), (4000, 0));
    let edges = constant(1_000_000, 10_000.0, 4000, 1);
    let totals = [(edges[500].0, 7), (edges[2000].0, -3)];
    let run = BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::B, &computer) };
    let seen = run.run().unwrap();
    assert_eq!((seen.completed, seen.error_counts(), seen.insertions, seen.illegal), (-3, 0, 17, 0));
    let dead = BenchRun { die_ns: edges[1000].0, ..run }.run().unwrap();
    let (scale, mtc) = dead.at_death.unwrap();
    assert_eq!((dead.mtc - mtc, dead.illegal), (0, 0));
    assert!(dead.scale - scale > 2900);
    // An 8051 that has to pass 100 kHz loses counts; the MTC may see an illegal state or none.
    let edges = constant(1_000_000, 100_000.0, 4000, 1);
    let lost = BenchRun { edges: &edges, ..BenchRun::new(InsertionDesign::B, &ComputerTiming::i8051()) }
        .run()
        .unwrap();
    assert!(lost.mtc < lost.scale / 2, "{lost:?}");
}

/// Three pulses are subtracted and three added, exactly, with 90° kept.
/// (CMTI 2014, section 3, figures 8 and 9)
#[test]
fn three_pulses_added_and_three_subtracted() {
    let computer = ComputerTiming::dsp();
    for direction in [1, -1] {
        let edges = constant(1_000_000, 10_000.0, 4000, direction);
        for total in [12, -12] {
            let totals = [(edges[500].0, total)];
            let run = BenchRun {
                edges: &edges,
                totals: &totals,
                keep_log: true,
                ..BenchRun::new(InsertionDesign::Ecc, &computer)
            };
            let seen = run.run().unwrap();
            assert_eq!((seen.mtc - seen.scale, seen.completed, seen.illegal), (total, total, 0));
            assert!(seen.worst_phase_deg < 1e-6);
            // Adding splits three cycles into six at twice the frequency; subtracting only leaves pulses out.
            let adds = (total > 0) == (direction > 0);
            let shortest = if adds { 12_500 } else { 25_000 };
            assert!(seen.min_separation_ns.abs_diff(shortest) <= 2, "{} ns", seen.min_separation_ns);
        }
    }
}

/// At most 15 pulses at a time; the next request waits for the acknowledgement.
/// (CMTI 2014, sections 2.2.7 and 2.3)
#[test]
fn more_than_fifteen_pulses_take_two_compensations() {
    let computer = ComputerTiming::dsp();
    let edges = constant(1_000_000, 10_000.0, 4000, 1);
    for (pulses, compensations) in [(15, 1), (16, 2), (45, 3)] {
        let totals = [(edges[500].0, 4 * pulses)];
        let seen =
            BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::Ecc, &computer) }
                .run()
                .unwrap();
        assert_eq!((seen.insertions, seen.completed, seen.error_counts()), (compensations, 4 * pulses, 0));
    }
}

/// The PLL doubles only within its lock range.
/// The XOR signal may have 700 Hz to 160 kHz, cleanly 2.3 to 125 kHz.
/// That is twice the encoder's frequency (CMTI 2014, section 2.2.2).
#[test]
fn the_ecc_works_in_its_lock_range_only() {
    let computer = ComputerTiming::dsp();
    let (low, high) = BenchRun::new(InsertionDesign::Ecc, &computer).safe_range();
    assert!((1150.0..1153.0).contains(&low), "{low} Hz");
    assert!((62_400.0..=62_501.0).contains(&high), "{high} Hz");
    let run = |hz: f64| {
        let edges = constant(1_000_000, hz, 8000, 1);
        let totals = [(edges[2000].0, 12)];
        BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::Ecc, &computer) }
            .run()
            .unwrap()
    };
    // It still doubles between 125 and 160 kHz, and between 700 Hz and 2.3 kHz, but without 90°.
    for hz in [70_000.0, 500.0] {
        let seen = run(hz);
        assert_eq!((seen.error_counts(), seen.illegal), (0, 0));
        assert!(seen.worst_phase_deg > 20.0);
    }
    // Outside that range the VCO runs freely. No addition begins there, so none goes wrong.
    for hz in [85_000.0, 120_000.0, 300.0, 150.0] {
        let seen = run(hz);
        assert_eq!((seen.completed, seen.error_counts(), seen.illegal), (0, 0, 0), "{hz} Hz");
    }
}

/// In the first cycle of a motion the loop has not followed yet.
/// The controller waits for it.
#[test]
fn the_ecc_sends_one_edge_at_a_time_from_the_first_cycle_on() {
    let computer = ComputerTiming::dsp();
    for hz in [500.0, 2000.0, 10_000.0, 60_000.0, 79_000.0] {
        let edges = constant(1_000_000, hz, 4000, 1);
        let totals = [(0, 60)];
        let run =
            BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::Ecc, &computer) };
        let seen = run.run().unwrap();
        assert_eq!((seen.completed, seen.error_counts(), seen.illegal), (60, 0, 0), "{hz} Hz");
        assert!(seen.min_separation_ns > 1000, "{hz} Hz: {seen:?}");
    }
}

/// A reversal while pulses are blocked or split leaves a wrong count at the MTC.
/// The CMTI paper does not mention it.
#[test]
fn the_ecc_goes_wrong_at_reversal() {
    let computer = ComputerTiming::dsp();
    let edges = there_and_back(5000.0, 2e6, 2000, 0);
    let turn = edges[1999].0;
    let wrong = (0..40).filter(|n| {
        let totals = [(turn - 4_000_000 + n * 100_000, if n % 2 == 0 { 60 } else { -60 })];
        let seen =
            BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::Ecc, &computer) }
                .run()
                .unwrap();
        seen.error_counts() != 0 || seen.illegal > 0
    });
    assert!(wrong.count() > 0);
    // Design C gets the same requests and is never wrong.
    for n in 0..40 {
        let totals = [(turn - 4_000_000 + n * 100_000, if n % 2 == 0 { 60 } else { -60 })];
        let config = AxisConfig { max_accel_counts_s2: 2e6, ..AxisConfig::default() };
        let seen = BenchRun {
            config,
            edges: &edges,
            totals: &totals,
            ..BenchRun::new(InsertionDesign::C, &computer)
        }
        .run()
        .unwrap();
        assert_eq!((seen.error_counts(), seen.illegal, seen.faults), (0, 0, 0));
    }
}

/// A computer that stops between insertions leaves the signals unchanged.
/// (NISTIR 4832, Design C)
/// One that stops between the two inversions leaves the MTC counting mirrored, which the report does not
/// mention.
#[test]
fn when_the_computer_stops() {
    let computer = ComputerTiming::i8051();
    let edges = constant(1_000_000, 10_000.0, 4000, 1);
    let totals = [(edges[500].0, 2)];
    let run = BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(InsertionDesign::C, &computer) };
    let after = |die_ns| {
        let seen = BenchRun { die_ns, ..run.clone() }.run().unwrap();
        let (scale, mtc) = seen.at_death.unwrap();
        (seen.mtc - mtc) as f64 / (seen.scale - scale) as f64
    };
    let opened = edges[501].0;
    for (moment, follows) in [(3000, 1.0), (4500, -1.0), (10_000, 1.0)] {
        assert!((after(opened + moment) - follows).abs() < 1e-9, "{moment} ns after the edge");
    }
}

#[test]
fn same_seed_same_bytes_and_every_design_draws() {
    if !test_needs::long() {
        return;
    }
    let table = |seed| {
        serde_json::to_string(&compare(
            &ComputerTiming::dsp(),
            TestMotion { counts: 400, ..TestMotion::default() },
            seed,
        ))
    };
    assert_eq!(table(3).unwrap(), table(3).unwrap());
    for design in InsertionDesign::ALL {
        let svg = waveforms(design, &ComputerTiming::dsp(), 3);
        assert!(svg.starts_with("<svg") && svg.matches("polyline").count() == 5, "{design:?}");
        assert_eq!(svg, waveforms(design, &ComputerTiming::dsp(), 3));
    }
}
