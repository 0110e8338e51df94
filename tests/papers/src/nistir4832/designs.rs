//! Designs A, B and C, and what an axis at rest can be corrected by.

use super::{Bench, cannot};
use crate::PaperError;
use crate::rows::Agreement::{AtLeast, Within};
use crate::rows::Rows;
use rtec_driver::quadrature::State;
use rtec_model::machine::Machine;
use rtec_rt::axis::AxisConfig;
use rtec_sim::compensation_experiments::one_metre;
use rtec_sim::computer_timing::ComputerTiming;
use rtec_sim::corrected_machine_sim::CorrectedMachineSim;
use rtec_sim::insertion_design_bench::{BenchRun, Edge, InsertionDesign, constant, insert_at_rest};
use rtec_sim::nc_block::Block;
use std::path::Path;

/// Which of the four places at rest can be corrected, with and without dither.
pub(super) fn at_rest(
    rows: &mut Rows,
    bench: &Bench,
    computer: &ComputerTiming,
    seed: u64,
) -> Result<(), PaperError> {
    let served = |design| {
        let run = BenchRun::new(design, computer);
        (0..4).filter(|s| run.served_at_rest(State::from_bits(*s))).count() as f64
    };
    let what = "states at rest in which the Original corrects: A and B low";
    rows.number(
        ("The \"Original RTEC\"", what, "of 4"),
        1.0,
        served(InsertionDesign::Original),
        Within(0.0),
        "",
    );
    let gets = served(InsertionDesign::A);
    rows.number(("Design A", "states at rest in which it corrects", "of 4"), 4.0, gets, Within(0.0), "");
    let gets = served(InsertionDesign::C);
    rows.number(("Design C", "states at rest in which it corrects", "of 4"), 4.0, gets, Within(0.0), "");
    let place = "The \"Original RTEC\"";
    let without = dithering(bench, 0.0, seed)?;
    let what = "a good servo at rest, no dither: places corrected";
    let why = "without an edge nothing tells the corrector that A and B are low: it waits";
    rows.number((place, what, "of 4"), 0.0, without as f64, Within(0.0), why);
    let one = dithering(bench, bench.dither_counts, seed)?;
    let what = "dither of one count may not include the A&B low state";
    let why = "the two of four places whose one count touches A and B low";
    rows.holds((place, what), "not in every place", &format!("{one} of 4 places corrected"), one < 4, why);
    let full = dithering(bench, 4.0, seed)?;
    let what = "servo gain or zero-offset altered until it dithers by a whole cycle: places corrected";
    rows.number((place, what, "of 4"), 4.0, full as f64, Within(0.0), "");
    Ok(())
}

/// How many of four places of rest, a count apart, the Original corrects by one increment, the servo dithering.
fn dithering(bench: &Bench, dither_counts: f64, seed: u64) -> Result<usize, PaperError> {
    let mut served = 0;
    let counts = 4.0 * bench.count_um;
    let text = format!("name = \"k\"\n[[effect]]\nname = \"offset.x\"\num = {counts}\n");
    let offset = Machine::parse(Path::new("k.toml"), &text)?;
    let mut spec = one_metre(bench.count_um, bench.travel_mm);
    spec.axes[0].dither_counts = dither_counts;
    // Play would hide a dither of a count.
    spec.axes[0].backlash_um = 0.0;
    for place in 0..4 {
        let at = f64::from(place) * bench.count_um / 1e3;
        // The scale counts from where it starts: it stands at A and B low there, so one count further for each place.
        let mut sim = CorrectedMachineSim::new(&spec, &offset, None, [0.0; 3], seed)?;
        sim.run([Block::Feed { to: [at, 0.0, 0.0], feed_mm_s: 1.0 }])?;
        sim.know(&spec, &offset)?;
        sim.advance(5.0)?;
        served += usize::from(sim.status().axes[0].completed == 4);
    }
    Ok(served)
}

/// Design B: how fast must the computer be?
pub(super) fn design_b(rows: &mut Rows, computer: &ComputerTiming, faster: &ComputerTiming) {
    let place = "Design B";
    let edges = constant(1_000_000, 100_000.0, 400, 1);
    let what = "a signal of 100 kHz has a transition every";
    let gets = (edges[399].0 - edges[0].0) as f64 / 399.0 / 1e3;
    rows.given().number((place, what, "µs"), 2.5, gets, Within(0.01), "");
    let with = |pass_ns: u64| ComputerTiming {
        pass_ns,
        step_ns: pass_ns.min(computer.step_ns),
        react_ns: pass_ns,
        ..computer.clone()
    };
    let slowest = |ok: &dyn Fn(&ComputerTiming) -> bool| {
        let (mut good, mut bad) = (1_u64, computer.pass_ns.max(2));
        if !ok(&with(good)) {
            return 0;
        }
        while bad - good > 1 {
            let middle = u64::midpoint(good, bad);
            *if ok(&with(middle)) { &mut good } else { &mut bad } = middle;
        }
        good
    };
    let edges = constant(1_000_000, 100_000.0, 4000, 1);
    let passes = |c: &ComputerTiming| {
        let seen = BenchRun { edges: &edges, ..BenchRun::new(InsertionDesign::B, c) }.run();
        seen.is_some_and(|s| s.mtc == s.scale && s.illegal == 0)
    };
    let passed = slowest(&passes);
    let what = "faster than the 8051 to pass 100 kHz: at least an order of magnitude";
    let why = "to pass the signals alone a pass within the 2.5 µs between two transitions is enough, and the 8051's pass is taken as \
        ten instructions of a microsecond; corrections need more, see the next row";
    rows.number((place, what, "times"), 10.0, computer.pass_ns as f64 / passed.max(1) as f64, AtLeast, why);
    let corrects = |c: &ComputerTiming| BenchRun::new(InsertionDesign::B, c).safe_at(100_000.0);
    let corrected = slowest(&corrects);
    let why = "edge, insertion and the MTC's separations within 2.5 µs";
    let what = "the same with corrections inserted between two transitions";
    let gets = if corrected == 0 { f64::INFINITY } else { computer.pass_ns as f64 / corrected as f64 };
    rows.number((place, what, "times"), 10.0, gets, AtLeast, why);
    let serves = |c: &ComputerTiming, hz: f64| BenchRun::new(InsertionDesign::B, c).safe_at(hz);
    let what = "the 8051 is not fast enough";
    let gets = if serves(computer, 100_000.0) { "serves 100 kHz" } else { "not at 100 kHz" };
    rows.holds((place, what), "not at 100 kHz", gets, !serves(computer, 100_000.0), "");
    let seen = BenchRun { edges: &edges, ..BenchRun::new(InsertionDesign::B, faster) }.run();
    let passed = seen.is_some_and(|s| s.mtc == s.scale && s.illegal == 0);
    let gets = if passed { "yes" } else { "no" };
    rows.holds((place, "signal processors have the speed for 100 kHz"), "yes", gets, passed, "");
    let totals = [(edges[500].0, 300), (edges[2500].0, 0)];
    let slow = constant(1_000_000, 5000.0, 8000, 1);
    let late = [(slow[100].0, 300)];
    let run = BenchRun { edges: &slow, totals: &late, ..BenchRun::new(InsertionDesign::B, faster) };
    let many = run.run().map_or(0, |s| s.completed);
    let what = "counts added or subtracted can be in the hundreds";
    rows.number((place, what, "counts"), 100.0, many as f64, AtLeast, "300 were asked for");
    let dead = BenchRun { die_ns: edges[1000].0, totals: &totals, edges: &edges, ..run }.run();
    let moved = dead.and_then(|d| d.at_death.map(|(_, mtc)| d.mtc - mtc)).unwrap_or(0);
    let what = "the computer stops: counts that reach the MTC from then on";
    rows.number(("General Considerations", what, "counts"), 0.0, moved as f64, Within(0.0), "");
}

/// The state tables of Design C, line by line.
pub(super) fn design_c(rows: &mut Rows, computer: &ComputerTiming) -> Result<(), PaperError> {
    let states = |start: u8, totals: &[(u64, i64)], edges: &[Edge], config: AxisConfig| {
        let start = State::from_bits(start);
        let new = BenchRun::new(InsertionDesign::C, computer);
        BenchRun { config, start, edges, totals, keep_log: true, ..new }.run().map(|seen| {
            let mut table: Vec<String> = Vec::new();
            for (_, _, out, count) in &seen.log {
                let line = format!("{}{}:{count}", u8::from(out.a()), u8::from(out.b()));
                if table.last() != Some(&line) {
                    table.push(line);
                }
            }
            (table.join(" "), seen)
        })
    };
    let forwards = |counts| constant(100_000_000, 1000.0, counts, 1);
    let rest = insert_at_rest(AxisConfig::default());
    let plain =
        states(0, &[], &forwards(4), AxisConfig::default()).ok_or_else(|| cannot("a plain motion"))?;
    rows.words(("Design A, state table", "A B : count, forwards"), "00:0 10:1 11:2 01:3 00:4", &plain.0, "");
    let add =
        states(0, &[(1_000_000, 2)], &forwards(4), rest).ok_or_else(|| cannot("an insertion at rest"))?;
    let what = "at 0,0 invert A, then B: two counts added";
    let why = "the report's table counts on from 2: the same seven states";
    rows.words(("Design C, second table", what), "00:0 10:1 11:2 01:3 00:4 10:5 11:6", &add.0, why);
    // The axis goes one count, stands, is corrected by −2 at 1,0, and goes on.
    let stops = [vec![(10_000_000, 1)], forwards(3)].concat();
    let later = states(0, &[(20_000_000, -2)], &stops, rest).ok_or_else(|| cannot("an insertion"))?;
    let says = "00:0 10:1 00:0 01:-1 00:0 10:1 11:2";
    let gets = later.0;
    rows.words(("Design C, third table", "at 1,0 invert A, then B: two counts subtracted"), says, &gets, "");
    let mut right = 0;
    for start in 0..4 {
        for total in [2, -2] {
            let seen = states(start, &[(1_000_000, total)], &forwards(8), rest).map(|s| s.1);
            right += usize::from(seen.is_some_and(|s| s.mtc - s.scale == total && s.illegal == 0));
        }
    }
    let what = "the algorithm, A and B alike or not, adding or subtracting: right in";
    rows.number(("Design C", what, "of 8"), 8.0, right as f64, Within(0.0), "");
    Ok(())
}
