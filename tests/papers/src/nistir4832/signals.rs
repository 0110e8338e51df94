//! Position feedback signals, and the Original RTEC's pulses.

use super::{Bench, Change, cannot};
use crate::PaperError;
use crate::rows::Agreement::{AtLeast, AtMost, Share, Within};
use crate::rows::{Rows, shown};
use rtec_driver::quadrature::State;
use rtec_model::machine::Machine;
use rtec_sim::axis::AxisSpec;
use rtec_sim::compensation_experiments::one_metre;
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::insertion_design_bench::{BenchResult, BenchRun, Edge, InsertionDesign, constant};
use rtec_sim::nc_block::Block;
use std::path::Path;

/// The axis over its travel at rapid traverse: how far it counts, how fast.
pub(super) fn signals(rows: &mut Rows, bench: &Bench, seed: u64) -> Result<(), PaperError> {
    let place = "Position Feedback Signals";
    let slow = constant(1_000_000, 1000.0, 4000, 1);
    let computer = ComputerTiming::dsp();
    let plain = |edges: &[Edge]| {
        let run = BenchRun { edges, keep_log: true, ..BenchRun::new(InsertionDesign::C, &computer) };
        run.run().ok_or_else(|| cannot("a plain motion"))
    };
    let seen = plain(&slow)?;
    let cycles = rising(&seen.log, |s| s.a());
    let what = "resolution against the encoder's square wave";
    rows.number((place, what, "times"), 4.0, seen.mtc as f64 / cycles as f64, Within(1e-6), "");
    let rapid = traverse(bench.count_um, bench.rapid_mm_min, bench.travel_mm, seed)?;
    let place = "Altering the Position Signal";
    let why = "the travel or the resolution of the machine file is another";
    let what = "bits for an axis of one metre at 1 µm";
    let gets = f64::from(64 - (rapid.counts.unsigned_abs() - 1).leading_zeros());
    rows.given().number((place, what, "bits"), 20.0, gets, Within(0.0), why);
    let why = "the axis stops within a count of either end";
    rows.given().number((place, "counts of that axis", ""), 1e6, rapid.counts as f64, Share(0.001), why);
    let what = "encoder frequency at rapid traverse, 7 m/min";
    let why =
        "the report says \"about\": 7 m/min are 116 667 counts/s, a quarter of it is the encoder's frequency";
    rows.given().number((place, what, "kHz"), 30.0, rapid.encoder_hz / 1e3, Share(0.05), why);
    let coming = traverse(bench.count_um / 10.0, 2.0 * bench.rapid_mm_min, 60.0, seed)?;
    let what = "twice the speed at nearly a tenth of the resolution: up to";
    let why = "the report rounds: resolutions \"approaching\" a tenth; exactly a tenth gives this";
    rows.given().number((place, what, "kHz"), 500.0, coming.encoder_hz / 1e3, Share(0.2), why);
    for (hz, width_us) in [(100e3, 5.0), (1e6, 0.5)] {
        let seen = plain(&constant(1_000_000, hz, 400, 1))?;
        let what = format!("pulse width of a square wave of {} kHz", shown(hz / 1e3));
        let gets = high_ns(&seen.log, |s| s.a()) / 1e3;
        rows.given().number((place, &what, "µs"), width_us, gets, Within(0.002), "");
    }
    let what = "rapid traverse over cutting speed: an order of magnitude";
    let gets = bench.rapid_mm_min / bench.cutting_mm_min;
    rows.given().number(("The \"Original RTEC\"", what, "times"), 10.0, gets, AtLeast, "");
    Ok(())
}

struct Traverse {
    counts: i64,
    encoder_hz: f64,
}

/// From one end of the travel to the other.
fn traverse(count_um: f64, rapid_mm_min: f64, travel_mm: f64, seed: u64) -> Result<Traverse, PaperError> {
    let axis = AxisSpec { count_um, speed_mm_s: rapid_mm_min / 60.0, ..AxisSpec::new("x", travel_mm) };
    let mut spec = MachineSpec::new(vec![axis]);
    // A decoder that bears what is coming.
    spec.controller.decoder_hz = 1e8;
    let ideal = Machine::ideal("axis");
    let mut sim = CorrectedMachineSim::new(&spec, &ideal, None, [-travel_mm / 2.0, 0.0, 0.0], seed)?;
    sim.machine.load([Block::Rapid { to: [travel_mm / 2.0, 0.0, 0.0] }]);
    let mut counts_s: f64 = 0.0;
    // At speed: over the middle half of the way.
    let (mut middle, every_s) = (None, 0.05_f64.min(travel_mm / 20.0 / (rapid_mm_min / 60.0)));
    while !sim.machine.finished() {
        sim.advance(every_s)?;
        let (at, count) = (sim.moment().axes[0].position_mm, sim.machine.mtc_counts(0));
        if at.abs() < travel_mm / 4.0 {
            if let Some(before) = middle {
                counts_s = counts_s.max((count - before) as f64 / every_s);
            }
            middle = Some(count);
        }
    }
    sim.finish()?;
    Ok(Traverse { counts: sim.machine.mtc_counts(0), encoder_hz: counts_s / 4.0 })
}

fn rising(log: &[Change], level: fn(&State) -> bool) -> usize {
    log.windows(2).filter(|w| !level(&w[0].2) && level(&w[1].2)).count()
}

/// How long a signal at the MTC is high, the shortest in the log, ns.
fn high_ns(log: &[Change], level: fn(&State) -> bool) -> f64 {
    let (mut began, mut shortest) = (None, f64::INFINITY);
    for w in log.windows(2) {
        match (level(&w[0].2), level(&w[1].2)) {
            (false, true) => began = Some(w[1].0),
            (true, false) => {
                if let Some(t) = began.take() {
                    shortest = shortest.min((w[1].0 - t) as f64);
                }
            }
            _ => {}
        }
    }
    shortest
}

/// The Original RTEC's pulses at 10 kHz, and what does not fit at 30 kHz.
pub(super) fn pulses(rows: &mut Rows, bench: &Bench, computer: &ComputerTiming) -> Result<(), PaperError> {
    let go = |design, hz, total| insert(computer, design, hz, total);
    let place = "Figure 2";
    for (what, says, design, total) in [
        ("b: a pair of pulses, A leading B, adds", 4.0, InsertionDesign::Original, 4),
        ("d: a pair of pulses, B leading A, subtracts", -4.0, InsertionDesign::Original, -4),
        ("c: a pair of pulses left out (the ECC does it) subtracts", -4.0, InsertionDesign::Ecc, -4),
    ] {
        let seen = go(design, 10_000.0, total)?;
        let why = "the insertion was not made on the computer as described";
        rows.number((place, what, "counts"), says, (seen.mtc - seen.scale) as f64, Within(0.0), why);
    }
    // Where the machine goes with four counts more.
    let known = Machine::parse(
        Path::new("four.toml"),
        &format!("name = \"four counts\"\n[[effect]]\nname = \"offset.x\"\num = {}\n", 4.0 * bench.count_um),
    )?;
    let mut sim = CorrectedMachineSim::new(
        &one_metre(bench.count_um, bench.travel_mm),
        &Machine::ideal("m"),
        Some(&known),
        [0.0; 3],
        1,
    )?;
    sim.run([Block::Feed { to: [20.0, 0.0, 0.0], feed_mm_s: bench.cutting_mm_min / 60.0 }])?;
    sim.advance(0.5)?;
    let place = "Altering the Position Signal";
    let why = "the servo is in position within a count";
    let what = "four counts added: the axis stops from the programmed position by";
    let gets = ((sim.moment().axes[0].position_mm - 20.0) * 1e3 / bench.count_um).round();
    rows.given().number((place, what, "counts"), -4.0, gets, Within(0.0), why);
    times(rows, computer)
}

/// One correction on the way, at an encoder frequency.
fn insert(
    computer: &ComputerTiming,
    design: InsertionDesign,
    hz: f64,
    total: i64,
) -> Result<BenchResult, PaperError> {
    let edges = constant(1_000_000, hz, 4000, 1);
    let totals = [(edges[500].0, total)];
    BenchRun { edges: &edges, totals: &totals, keep_log: true, ..BenchRun::new(design, computer) }
        .run()
        .ok_or_else(|| cannot("an insertion"))
}

/// Nine microseconds at 10 kHz, which do not fit at 30 kHz; the other designs beside it.
fn times(rows: &mut Rows, computer: &ComputerTiming) -> Result<(), PaperError> {
    let go = |design, hz, total| insert(computer, design, hz, total);
    let place = "Altering the Position Signal";
    let slow = go(InsertionDesign::Original, 10_000.0, 4)?;
    let inserted: Vec<Change> = inserted(&slow.log);
    let why = "the computer of the machine file steps at another pace";
    let gets = high_ns(&slow.log, |s| s.a()) / 1e3;
    rows.given().number((place, "width of an added pulse", "µs"), 2.0, gets, Within(0.01), why);
    let place = "The \"Original RTEC\"";
    let (first, last) = match (inserted.first(), inserted.last()) {
        (Some(a), Some(b)) => (a.0, b.0),
        _ => return Err(cannot("an insertion")),
    };
    let edge = slow.log.iter().rev().find(|l| l.0 < first && l.0 > 0).map_or(first, |l| l.0);
    let done = slow.edge_to_done_ns.map_or(0, |t| t.0);
    let other = "the computer of the machine file has other times";
    for (what, says, ns) in [
        ("from recognising A and B low until a pulse can be added", 4.0, first - edge),
        ("for the pulses", 3.0, last - first),
        ("after the pulses", 2.0, done.saturating_sub(last - edge)),
        ("total", 9.0, done),
    ] {
        rows.number((place, what, "µs"), says, ns as f64 / 1e3, Within(0.01), other);
    }
    let edges = constant(1_000_000, 30_000.0, 4000, 1);
    let low: Vec<u64> = edges.chunks(4).take(900).map(|c| c[1].0 - c[0].0).collect();
    let why = "\"about\": a quarter of the period of 33.3 µs";
    let gets = low.iter().sum::<u64>() as f64 / low.len() as f64 / 1e3;
    rows.given().number((place, "at 30 kHz A and B are low for", "µs"), 8.0, gets, Within(0.5), why);
    let rapid = go(InsertionDesign::Original, 30_000.0, 40)?;
    let why = "the timer between two \"A&B low\" holds insertions back, as the report's does";
    let what = "at 30 kHz the nine microseconds run into the next transition";
    let gets = format!(
        "held back {} times by the timer; the count {} off",
        rapid.waited_for_gate,
        rapid.error_counts()
    );
    rows.holds((place, what), "they may", &gets, rapid.waited_for_gate > 0 && rapid.error_counts() == 0, why);
    let quicker = go(InsertionDesign::C, 10_000.0, 2)?.edge_to_done_ns.map_or(0, |t| t.0);
    let what = "time of an insertion: somewhat less than the Original's";
    let why = "two inversions instead of four changes";
    rows.number(("Design C", what, "µs"), done as f64 / 1e3, quicker as f64 / 1e3, AtMost, why);
    let a = go(InsertionDesign::A, 10_000.0, 4)?.edge_to_done_ns.map_or(0, |t| t.0);
    let what = "time of an insertion: the same as the Original's";
    rows.number(("Design A", what, "µs"), done as f64 / 1e3, a as f64 / 1e3, Within(0.01), "");
    for (design, says) in [
        (InsertionDesign::Original, 4),
        (InsertionDesign::A, 4),
        (InsertionDesign::B, 1),
        (InsertionDesign::C, 2),
    ] {
        // Design B needs the faster computer; what it inserts is the same on any.
        let quick = ComputerTiming::dsp();
        let with = if design == InsertionDesign::B { &quick } else { computer };
        let seen = insert(with, design, 10_000.0, 8)?;
        let step = (seen.mtc - seen.scale) as f64 / (seen.insertions as f64).max(1.0);
        let what = format!("correction resolution of {}", design.name());
        let why = "the insertions were not made";
        rows.number(("Designs", &what, "counts"), f64::from(says), step, Within(0.0), why);
    }
    Ok(())
}

/// The changes at the MTC that the scale did not make.
fn inserted(log: &[Change]) -> Vec<Change> {
    log.windows(2).filter(|w| w[0].1 == w[1].1 && w[0].2 != w[1].2).map(|w| w[1]).collect()
}
