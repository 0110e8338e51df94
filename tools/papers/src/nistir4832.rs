//! NISTIR 4832: the Original RTEC and the alternative Designs A, B and C.

use crate::PaperError;
use crate::rows::{Is, Rows, shown};
use rtec_driver::card::AxisLines;
use rtec_driver::quadrature::State;
use rtec_driver::replay::{ReplayCard, RequestedTotal, TracePoint, Xor};
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_model::record::Role;
use rtec_rt::axis::{AxisConfig, Design, RestPolicy};
use rtec_rt::event::{EventKind, Request};
use rtec_sim::axis::AxisSpec;
use rtec_sim::bench::{AnyDesign, BenchResult, BenchRun, constant, insert_at_rest};
use rtec_sim::computer::Computer;
use rtec_sim::described::Described;
use rtec_sim::designs::{safe_at, safe_range, served_at_rest};
use rtec_sim::experiment::{Setting, one_metre, over_a_part};
use rtec_sim::gcode::Block;
use rtec_sim::replay::{CorrectedAxis as _, ReplayOutcome, homed_engine, replay};
use rtec_sim::sim::{Sim, Spec};
use serde::Deserialize;
use std::path::Path;

/// The machine as its file describes it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Bench {
    machine: String,
    count_um: f64,
    travel_mm: f64,
    rapid_mm_min: f64,
    cutting_mm_min: f64,
    probing_mm_min: f64,
    slower_probing: f64,
    part_share: f64,
    correction_bits: u32,
    window_corrections: i64,
    update_every_mm: f64,
    dither_counts: f64,
    computer: Timing,
    faster_computer: Timing,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Timing {
    name: String,
    react_ns: u64,
    step_ns: u64,
    after_ns: u64,
    pass_ns: u64,
}

impl Timing {
    fn computer(&self) -> Computer {
        let Self { name, react_ns, step_ns, after_ns, pass_ns } = self.clone();
        Computer { name, react_ns, step_ns, after_ns, pass_ns, looks: Vec::new(), write_ns: 0 }
    }
}

/// A look of a run: time, scale, MTC, its count.
type Change = (u64, State, State, i64);

pub(crate) fn run(
    described: &Described,
    seed: u64,
    progress: &mut dyn FnMut(&str),
) -> Result<Rows, PaperError> {
    let bench: Bench = described.read("4832.toml")?;
    let machine = described.machine(&bench.machine)?;
    let (computer, faster) = (bench.computer.computer(), bench.faster_computer.computer());
    let mut rows = Rows::default();
    progress("NISTIR 4832: the axis over its travel, the pulses");
    introduction(&mut rows, &bench);
    signals(&mut rows, &bench, seed)?;
    pulses(&mut rows, &bench, &computer)?;
    progress("NISTIR 4832: the linear error over a part");
    linear(&mut rows, &bench, &machine, seed)?;
    progress("NISTIR 4832: at rest, and with dither");
    at_rest(&mut rows, &bench, &computer, seed)?;
    progress("NISTIR 4832: Designs A, B and C");
    design_b(&mut rows, &computer, &faster);
    design_c(&mut rows, &computer)?;
    progress("NISTIR 4832: range, belief window, switches");
    range(&mut rows, &bench, &computer)?;
    belief(&mut rows, &bench)?;
    switches(&mut rows)?;
    diagrams(&mut rows);
    Ok(rows)
}

fn cannot(what: &str) -> PaperError {
    PaperError::Cannot(format!("NISTIR 4832: {what} cannot be run on the machine as described"))
}

fn introduction(rows: &mut Rows, bench: &Bench) {
    let place = "Introduction";
    rows.not(
        (place, "probing feed", "m/min"),
        "2.5",
        &shown(bench.probing_mm_min / 1e3),
        "a choice, put in; what it costs and saves is measured in 4854",
    );
    rows.not(
        (place, "faster than the rate commonly used", "times"),
        "20",
        &shown(bench.slower_probing),
        "put in; NISTIR 4854 says 10 to 20 and is run at both feeds",
    );
}

/// The axis over its travel at rapid traverse: how far it counts, how fast.
fn signals(rows: &mut Rows, bench: &Bench, seed: u64) -> Result<(), PaperError> {
    let place = "Position Feedback Signals";
    let slow = constant(1_000_000, 1000.0, 4000, 1);
    let computer = Computer::dsp();
    let seen = BenchRun { edges: &slow, keep_log: true, ..BenchRun::new(AnyDesign::C, &computer) }
        .run()
        .ok_or_else(|| cannot("a plain motion"))?;
    let cycles = rising(&seen.log, |s| s.a());
    rows.number(
        (place, "resolution against the encoder's square wave", "times"),
        4.0,
        seen.mtc as f64 / cycles as f64,
        Is::Within(1e-6),
        "",
    );
    let rapid = traverse(bench.count_um, bench.rapid_mm_min, bench.travel_mm, seed)?;
    let place = "Altering the Position Signal";
    rows.number(
        (place, "bits for an axis of one metre at 1 µm", "bits"),
        20.0,
        f64::from(64 - (rapid.counts.unsigned_abs() - 1).leading_zeros()),
        Is::Within(0.0),
        "the travel or the resolution of the machine file is another",
    );
    rows.number(
        (place, "counts of that axis", ""),
        1e6,
        rapid.counts as f64,
        Is::Share(0.001),
        "the axis stops within a count of either end",
    );
    rows.number(
        (place, "encoder frequency at rapid traverse, 7 m/min", "kHz"),
        30.0,
        rapid.encoder_hz / 1e3,
        Is::Share(0.05),
        "the report says \"about\": 7 m/min are 116 667 counts/s, a quarter of it is the encoder's frequency",
    );
    let coming = traverse(bench.count_um / 10.0, 2.0 * bench.rapid_mm_min, 60.0, seed)?;
    rows.number(
        (place, "twice the speed at nearly a tenth of the resolution: up to", "kHz"),
        500.0,
        coming.encoder_hz / 1e3,
        Is::Share(0.2),
        "the report rounds: resolutions \"approaching\" a tenth; exactly a tenth gives this",
    );
    for (hz, width_us) in [(100e3, 5.0), (1e6, 0.5)] {
        let edges = constant(1_000_000, hz, 400, 1);
        let seen = BenchRun { edges: &edges, keep_log: true, ..BenchRun::new(AnyDesign::C, &computer) }
            .run()
            .ok_or_else(|| cannot("a plain motion"))?;
        rows.number(
            (place, &format!("pulse width of a square wave of {} kHz", shown(hz / 1e3)), "µs"),
            width_us,
            high_ns(&seen.log, |s| s.a()) / 1e3,
            Is::Within(0.002),
            "",
        );
    }
    rows.number(
        ("The \"Original RTEC\"", "rapid traverse over cutting speed: an order of magnitude", "times"),
        10.0,
        bench.rapid_mm_min / bench.cutting_mm_min,
        Is::AtLeast,
        "",
    );
    Ok(())
}

struct Traverse {
    counts: i64,
    encoder_hz: f64,
}

/// From one end of the travel to the other.
fn traverse(count_um: f64, rapid_mm_min: f64, travel_mm: f64, seed: u64) -> Result<Traverse, PaperError> {
    let axis = AxisSpec { count_um, speed_mm_s: rapid_mm_min / 60.0, ..AxisSpec::new("x", travel_mm) };
    let mut spec = Spec::new(vec![axis]);
    // A decoder that bears what is coming.
    spec.controller.decoder_hz = 1e8;
    let ideal = Machine::ideal("axis");
    let mut sim = Sim::new(&spec, &ideal, None, [-travel_mm / 2.0, 0.0, 0.0], seed)?;
    sim.machine.load([Block::Rapid { to: [travel_mm / 2.0, 0.0, 0.0] }]);
    let mut counts_s: f64 = 0.0;
    // At speed: over the middle half of the way.
    let (mut middle, every_s) = (None, 0.05_f64.min(travel_mm / 20.0 / (rapid_mm_min / 60.0)));
    while !sim.machine.finished() {
        sim.advance(every_s)?;
        let (at, count) = (sim.moment().position_mm[0], sim.machine.mtc_counts(0));
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
fn pulses(rows: &mut Rows, bench: &Bench, computer: &Computer) -> Result<(), PaperError> {
    let go = |design, hz: f64, total: i64| -> Result<BenchResult, PaperError> {
        let edges = constant(1_000_000, hz, 4000, 1);
        let totals = [(edges[500].0, total)];
        BenchRun { edges: &edges, totals: &totals, keep_log: true, ..BenchRun::new(design, computer) }
            .run()
            .ok_or_else(|| cannot("an insertion"))
    };
    let place = "Figure 2";
    for (what, says, design, total) in [
        ("b: a pair of pulses, A leading B, adds", 4.0, AnyDesign::Original, 4),
        ("d: a pair of pulses, B leading A, subtracts", -4.0, AnyDesign::Original, -4),
        ("c: a pair of pulses left out (the ECC does it) subtracts", -4.0, AnyDesign::Ecc, -4),
    ] {
        let seen = go(design, 10_000.0, total)?;
        let why = "the insertion was not made on the computer as described";
        rows.number((place, what, "counts"), says, (seen.mtc - seen.scale) as f64, Is::Within(0.0), why);
    }
    // Where the machine goes with four counts more.
    let known = Machine::parse(
        Path::new("four.toml"),
        &format!("name = \"four counts\"\n[[effect]]\nname = \"offset.x\"\num = {}\n", 4.0 * bench.count_um),
    )?;
    let mut sim = Sim::new(
        &one_metre(bench.count_um, bench.travel_mm),
        &Machine::ideal("m"),
        Some(&known),
        [0.0; 3],
        1,
    )?;
    sim.run([Block::Feed { to: [20.0, 0.0, 0.0], feed_mm_s: bench.cutting_mm_min / 60.0 }])?;
    sim.advance(0.5)?;
    let place = "Altering the Position Signal";
    rows.number(
        (place, "four counts added: the axis stops from the programmed position by", "counts"),
        -4.0,
        ((sim.moment().position_mm[0] - 20.0) * 1e3 / bench.count_um).round(),
        Is::Within(0.0),
        "the servo is in position within a count",
    );
    let slow = go(AnyDesign::Original, 10_000.0, 4)?;
    let inserted: Vec<Change> = inserted(&slow.log);
    rows.number(
        (place, "width of an added pulse", "µs"),
        2.0,
        high_ns(&slow.log, |s| s.a()) / 1e3,
        Is::Within(0.01),
        "the computer of the machine file steps at another pace",
    );
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
        rows.number((place, what, "µs"), says, ns as f64 / 1e3, Is::Within(0.01), other);
    }
    let edges = constant(1_000_000, 30_000.0, 4000, 1);
    let low: Vec<u64> = edges.chunks(4).take(900).map(|c| c[1].0 - c[0].0).collect();
    rows.number(
        (place, "at 30 kHz A and B are low for", "µs"),
        8.0,
        low.iter().sum::<u64>() as f64 / low.len() as f64 / 1e3,
        Is::Within(0.5),
        "\"about\": a quarter of the period of 33.3 µs",
    );
    let rapid = go(AnyDesign::Original, 30_000.0, 40)?;
    rows.holds(
        (place, "at 30 kHz the nine microseconds run into the next transition"),
        "they may",
        &format!(
            "held back {} times by the timer; the count {} off",
            rapid.waited_for_gate,
            rapid.error_counts()
        ),
        rapid.waited_for_gate > 0 && rapid.error_counts() == 0,
        "the timer between two \"A&B low\" holds insertions back, as the report's does",
    );
    let (_, high) = safe_range(AnyDesign::Original, computer, AxisConfig::default(), 1);
    rows.not(
        (place, "highest encoder frequency at which corrections go in", "kHz"),
        "below 30",
        &shown(high / 1e3),
        "the report gives no figure; a quarter of the period must hold the nine microseconds",
    );
    let quicker = go(AnyDesign::C, 10_000.0, 2)?.edge_to_done_ns.map_or(0, |t| t.0);
    rows.number(
        ("Design C", "time of an insertion: somewhat less than the Original's", "µs"),
        done as f64 / 1e3,
        quicker as f64 / 1e3,
        Is::AtMost,
        "two inversions instead of four changes",
    );
    let a = go(AnyDesign::A, 10_000.0, 4)?.edge_to_done_ns.map_or(0, |t| t.0);
    rows.number(
        ("Design A", "time of an insertion: the same as the Original's", "µs"),
        done as f64 / 1e3,
        a as f64 / 1e3,
        Is::Within(0.01),
        "",
    );
    for (design, says) in [(AnyDesign::Original, 4), (AnyDesign::A, 4), (AnyDesign::B, 1), (AnyDesign::C, 2)]
    {
        // Design B needs the faster computer; what it inserts is the same on any.
        let quick = Computer::dsp();
        let with = if design == AnyDesign::B { &quick } else { computer };
        let edges = constant(1_000_000, 10_000.0, 4000, 1);
        let totals = [(edges[500].0, 8)];
        let seen = BenchRun { edges: &edges, totals: &totals, ..BenchRun::new(design, with) }
            .run()
            .ok_or_else(|| cannot("an insertion"))?;
        let step = (seen.mtc - seen.scale) as f64 / (seen.insertions as f64).max(1.0);
        rows.number(
            ("Designs", &format!("correction resolution of {}", design.name()), "counts"),
            f64::from(says),
            step,
            Is::Within(0.0),
            "the insertions were not made",
        );
    }
    Ok(())
}

/// The changes at the MTC that the scale did not make.
fn inserted(log: &[Change]) -> Vec<Change> {
    log.windows(2).filter(|w| w[0].1 == w[1].1 && w[0].2 != w[1].2).map(|w| w[1]).collect()
}

/// 240 µm over one metre, one correction every 16 700 µm, fifteen over a quarter of the travel.
fn linear(rows: &mut Rows, bench: &Bench, machine: &Machine, seed: u64) -> Result<(), PaperError> {
    let place = "The \"Original RTEC\"";
    let setting = Setting { truth: machine, known: machine, seed, out: Path::new("") };
    let spec = one_metre(bench.count_um, bench.travel_mm);
    let length_mm = bench.part_share * bench.travel_mm;
    let found = over_a_part(&setting, &spec, length_mm, bench.cutting_mm_min)?;
    let data = |n: usize| -> (Vec<f64>, Vec<f64>) {
        let record = &found.records[n];
        let x = record.columns.iter().find(|c| matches!(c.role, Role::Position(_)));
        let e = record.responses().next();
        (x.map_or_else(Vec::new, |c| c.data.clone()), e.map_or_else(Vec::new, |c| c.data.clone()))
    };
    let ((x, e), (cx, ce)) = (data(0), data(1));
    let whole = e.last().copied().unwrap_or(0.0) / (x.last().copied().unwrap_or(1.0) / bench.travel_mm);
    let other = "the machine file has another error";
    rows.number((place, "error over one metre", "µm"), 240.0, whole, Is::Within(1.0), other);
    let half_um = 2.0 * bench.count_um;
    let steps: Vec<f64> =
        (1..ce.len()).filter(|&k| (ce[k - 1] - ce[k]).abs() > half_um).map(|k| cx[k]).collect();
    let spacing = match (steps.first(), steps.last()) {
        (Some(a), Some(b)) if steps.len() > 1 => (b - a) / (steps.len() - 1) as f64,
        _ => 0.0,
    };
    rows.number((place, "one correction every", "mm"), 16.7, spacing, Is::Within(0.2), other);
    rows.number(
        (place, "corrections over a quarter of the travel", ""),
        15.0,
        found.summary.get("insertions").and_then(serde_json::Value::as_f64).unwrap_or(0.0),
        Is::Within(0.0),
        other,
    );
    let worst = |e: &[f64]| e.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
    rows.not(
        (place, "largest error of the part, corrected", "µm"),
        "-",
        &shown(worst(&ce)),
        "the report gives none; half a correction of 4 µm is the least",
    );
    // A new value only every so often.
    let place = "Alternate Configurations";
    let mut sim = Sim::new(&spec, machine, Some(machine), [0.0; 3], seed)?;
    let v_mm_s = bench.cutting_mm_min / 60.0;
    sim.set_control_period((bench.update_every_mm / v_mm_s * 1e9) as u64);
    sim.machine.load([Block::Feed { to: [length_mm, 0.0, 0.0], feed_mm_s: v_mm_s }]);
    let mut late: f64 = 0.0;
    while !sim.machine.finished() {
        sim.advance(0.12)?;
        late = late.max(sim.moment().off_um(0).abs());
    }
    rows.number(
        (place, "a new value every 1 to 2 mm is sufficient: the error stays below one correction", "µm"),
        4.0 * bench.count_um,
        late,
        Is::AtMost,
        "with a value every 2 mm",
    );
    let every_ms = rtec_sim::sim::CONTROL_NS as f64 / 1e6;
    rows.number(
        (place, "a new value every 10 to 20 ms: our control period", "ms"),
        20.0,
        every_ms,
        Is::AtMost,
        "10 ms",
    );
    Ok(())
}

/// Which of the four places at rest can be corrected, with and without dither.
fn at_rest(rows: &mut Rows, bench: &Bench, computer: &Computer, seed: u64) -> Result<(), PaperError> {
    let served = |design| {
        let all =
            (0..4).filter(|s| served_at_rest(design, computer, AxisConfig::default(), State::from_bits(*s)));
        all.count() as f64
    };
    rows.number(
        ("The \"Original RTEC\"", "states at rest in which the Original corrects: A and B low", "of 4"),
        1.0,
        served(AnyDesign::Original),
        Is::Within(0.0),
        "",
    );
    rows.number(
        ("Design A", "states at rest in which it corrects", "of 4"),
        4.0,
        served(AnyDesign::A),
        Is::Within(0.0),
        "",
    );
    rows.number(
        ("Design C", "states at rest in which it corrects", "of 4"),
        4.0,
        served(AnyDesign::C),
        Is::Within(0.0),
        "",
    );
    let place = "The \"Original RTEC\"";
    let without = dithering(bench, 0.0, seed)?;
    rows.number(
        (place, "a good servo at rest, no dither: places corrected", "of 4"),
        0.0,
        without as f64,
        Is::Within(0.0),
        "without an edge nothing tells the corrector that A and B are low: it waits",
    );
    let one = dithering(bench, bench.dither_counts, seed)?;
    rows.holds(
        (place, "dither of one count may not include the A&B low state"),
        "not in every place",
        &format!("{one} of 4 places corrected"),
        one < 4,
        "the two of four places whose one count touches A and B low",
    );
    let full = dithering(bench, 4.0, seed)?;
    rows.number(
        (
            place,
            "servo gain or zero-offset altered until it dithers by a whole cycle: places corrected",
            "of 4",
        ),
        4.0,
        full as f64,
        Is::Within(0.0),
        "",
    );
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
        let mut sim = Sim::new(&spec, &offset, None, [0.0; 3], seed)?;
        sim.run([Block::Feed { to: [at, 0.0, 0.0], feed_mm_s: 1.0 }])?;
        sim.know(&spec, &offset)?;
        sim.advance(5.0)?;
        served += usize::from(sim.status().axes[0].completed == 4);
    }
    Ok(served)
}

/// Design B: how fast must the computer be?
fn design_b(rows: &mut Rows, computer: &Computer, faster: &Computer) {
    let place = "Design B";
    let edges = constant(1_000_000, 100_000.0, 400, 1);
    rows.number(
        (place, "a signal of 100 kHz has a transition every", "µs"),
        2.5,
        (edges[399].0 - edges[0].0) as f64 / 399.0 / 1e3,
        Is::Within(0.01),
        "",
    );
    let with = |pass_ns: u64| Computer {
        pass_ns,
        step_ns: pass_ns.min(computer.step_ns),
        react_ns: pass_ns,
        ..computer.clone()
    };
    let slowest = |ok: &dyn Fn(&Computer) -> bool| {
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
    let passes = |c: &Computer| {
        let seen = BenchRun { edges: &edges, ..BenchRun::new(AnyDesign::B, c) }.run();
        seen.is_some_and(|s| s.mtc == s.scale && s.illegal == 0)
    };
    let passed = slowest(&passes);
    rows.number(
        (place, "faster than the 8051 to pass 100 kHz: at least an order of magnitude", "times"),
        10.0,
        computer.pass_ns as f64 / passed.max(1) as f64,
        Is::AtLeast,
        "to pass the signals alone a pass within the 2.5 µs between two transitions is enough, and the 8051's pass is taken as \
         ten instructions of a microsecond; corrections need more, see the next row",
    );
    let corrects = |c: &Computer| safe_at(AnyDesign::B, c, AxisConfig::default(), 100_000.0, 1);
    let corrected = slowest(&corrects);
    rows.number(
        (place, "the same with corrections inserted between two transitions", "times"),
        10.0,
        if corrected == 0 { f64::INFINITY } else { computer.pass_ns as f64 / corrected as f64 },
        Is::AtLeast,
        "edge, insertion and the MTC's separations within 2.5 µs",
    );
    let serves = |c: &Computer, hz: f64| safe_at(AnyDesign::B, c, AxisConfig::default(), hz, 1);
    rows.holds(
        (place, "the 8051 is not fast enough"),
        "not at 100 kHz",
        if serves(computer, 100_000.0) { "serves 100 kHz" } else { "not at 100 kHz" },
        !serves(computer, 100_000.0),
        "",
    );
    let seen = BenchRun { edges: &edges, ..BenchRun::new(AnyDesign::B, faster) }.run();
    let passed = seen.is_some_and(|s| s.mtc == s.scale && s.illegal == 0);
    rows.holds(
        (place, "signal processors have the speed for 100 kHz"),
        "yes",
        if passed { "yes" } else { "no" },
        passed,
        "",
    );
    let totals = [(edges[500].0, 300), (edges[2500].0, 0)];
    let slow = constant(1_000_000, 5000.0, 8000, 1);
    let late = [(slow[100].0, 300)];
    let run = BenchRun { edges: &slow, totals: &late, ..BenchRun::new(AnyDesign::B, faster) };
    let many = run.run().map_or(0, |s| s.completed);
    rows.number(
        (place, "counts added or subtracted can be in the hundreds", "counts"),
        100.0,
        many as f64,
        Is::AtLeast,
        "300 were asked for",
    );
    let dead = BenchRun { die_ns: edges[1000].0, totals: &totals, edges: &edges, ..run }.run();
    let moved = dead.and_then(|d| d.at_death.map(|(_, mtc)| d.mtc - mtc)).unwrap_or(0);
    rows.number(
        ("General Considerations", "the computer stops: counts that reach the MTC from then on", "counts"),
        0.0,
        moved as f64,
        Is::Within(0.0),
        "",
    );
}

/// The state tables of Design C, line by line.
fn design_c(rows: &mut Rows, computer: &Computer) -> Result<(), PaperError> {
    let states = |start: u8, totals: &[(u64, i64)], edges: u64, config: AxisConfig| {
        let edges = constant(100_000_000, 1000.0, edges, 1);
        let run = BenchRun {
            config,
            start: State::from_bits(start),
            edges: &edges,
            totals,
            keep_log: true,
            ..BenchRun::new(AnyDesign::C, computer)
        };
        run.run().map(|seen| {
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
    let rest = insert_at_rest(AxisConfig::default());
    let plain = states(0, &[], 4, AxisConfig::default()).ok_or_else(|| cannot("a plain motion"))?;
    rows.words(("Design A, state table", "A B : count, forwards"), "00:0 10:1 11:2 01:3 00:4", &plain.0, "");
    let add = states(0, &[(1_000_000, 2)], 4, rest).ok_or_else(|| cannot("an insertion at rest"))?;
    rows.words(
        ("Design C, second table", "at 0,0 invert A, then B: two counts added"),
        "00:0 10:1 11:2 01:3 00:4 10:5 11:6",
        &add.0,
        "the report's table counts on from 2: the same seven states",
    );
    let later = at_one_zero(computer).ok_or_else(|| cannot("an insertion"))?;
    let says = "00:0 10:1 00:0 01:-1 00:0 10:1 11:2";
    rows.words(("Design C, third table", "at 1,0 invert A, then B: two counts subtracted"), says, &later, "");
    let mut right = 0;
    for start in 0..4 {
        for total in [2, -2] {
            let seen = states(start, &[(1_000_000, total)], 8, rest).map(|s| s.1);
            right += usize::from(seen.is_some_and(|s| s.mtc - s.scale == total && s.illegal == 0));
        }
    }
    rows.number(
        ("Design C", "the algorithm, A and B alike or not, adding or subtracting: right in", "of 8"),
        8.0,
        right as f64,
        Is::Within(0.0),
        "",
    );
    Ok(())
}

/// The third table: the axis goes one count, stands, is corrected by −2 at 1,0, and goes on.
fn at_one_zero(computer: &Computer) -> Option<String> {
    let mut edges = vec![(10_000_000_u64, 1_i64)];
    edges.extend(constant(100_000_000, 1000.0, 3, 1));
    let totals = [(20_000_000, -2)];
    let config = insert_at_rest(AxisConfig::default());
    let run = BenchRun {
        config,
        edges: &edges,
        totals: &totals,
        keep_log: true,
        ..BenchRun::new(AnyDesign::C, computer)
    };
    let mut table: Vec<String> = Vec::new();
    for (_, _, out, count) in &run.run()?.log {
        let line = format!("{}{}:{count}", u8::from(out.a()), u8::from(out.b()));
        if table.last() != Some(&line) {
            table.push(line);
        }
    }
    Some(table.join(" "))
}

/// The signed byte of the Original RTEC: the largest total that it takes.
fn range(rows: &mut Rows, bench: &Bench, computer: &Computer) -> Result<(), PaperError> {
    let place = "General Considerations";
    let most = (1_i64 << (bench.correction_bits - 1)) - 1;
    let step = AnyDesign::Original.increment_counts();
    let config = AxisConfig { max_correction_counts: most * step, ..AxisConfig::default() };
    let edges = constant(1_000_000, 5000.0, 40_000, 1);
    let mut taken = [0; 2];
    for (sign, taken) in [1, -1].into_iter().zip(&mut taken) {
        // One correction more each time, far beyond the byte.
        let totals: Vec<(u64, i64)> =
            (1..=most + 40).map(|n| (edges[(100 + 200 * n) as usize].0, sign * n * step)).collect();
        let run = BenchRun {
            config,
            edges: &edges,
            totals: &totals,
            ..BenchRun::new(AnyDesign::Original, computer)
        };
        let seen = run.run().ok_or_else(|| cannot("the Original's insertions"))?;
        *taken = seen.requested;
        if seen.completed != seen.requested || seen.error_counts() != 0 {
            return Err(cannot("the whole range of the signed byte"));
        }
    }
    let other = "the machine file has another width of the byte, or another count";
    rows.number(
        (place, "corrections in one signed byte, ±", ""),
        127.0,
        (taken[0] / step) as f64,
        Is::Within(0.0),
        other,
    );
    let um = taken[0].min(-taken[1]) as f64 * bench.count_um;
    rows.number((place, "largest correction, ±", "µm"), 508.0, um, Is::Within(0.0), other);
    rows.number((place, "the same", "mil"), 20.0, um / 25.4, Is::Within(0.05), other);
    rows.number((place, "one correction", "µm"), 4.0, step as f64 * bench.count_um, Is::Within(0.0), other);
    Ok(())
}

fn recording() -> impl Iterator<Item = Result<TracePoint, InputError>> {
    let mut state = State::default();
    (0..40_000_u64).map(move |n| {
        if n > 0 {
            state = state.next(true);
        }
        Ok(TracePoint { t_ns: n * 50_000, state })
    })
}

/// Totals given every 20 ms to the Original with its belief window.
fn believe(window_counts: i64, totals: &[i64], large: bool) -> Result<ReplayOutcome, PaperError> {
    let config = AxisConfig { design: Design::Original, window_counts, ..AxisConfig::default() };
    let given: Vec<Result<RequestedTotal, InputError>> = totals
        .iter()
        .enumerate()
        .map(|(n, t)| Ok(RequestedTotal { t_ns: 20_000_000 * (n as u64 + 1), requested: *t }))
        .collect();
    Ok(replay(config, recording(), given.into_iter(), large, |_, _: State| {})?.0)
}

fn belief(rows: &mut Rows, bench: &Bench) -> Result<(), PaperError> {
    let place = "General Considerations";
    let step = Design::Original.increment_counts();
    let window = bench.window_corrections * step;
    let believed =
        |n: i64| -> Result<bool, PaperError> { Ok(believe(window, &[n * step], false)?.refused.is_empty()) };
    let mut widest = 0;
    while widest < 20 && believed(widest + 1)? {
        widest += 1;
    }
    rows.number(
        (place, "belief window, corrections at once, ±", ""),
        3.0,
        widest as f64,
        Is::Within(0.0),
        "the machine file has another window",
    );
    let wild = (widest + 50) * step;
    let once = believe(window, &[step, wild, 2 * step], false)?;
    rows.holds(
        (place, "one reading beyond it: \"I Don't Believe You\"; back in range it is accepted"),
        "accepted within the next two readings",
        &format!(
            "{} refused, {} requested, {} faults",
            once.refused.len(),
            once.requested,
            once.faults.len()
        ),
        once.refused.len() == 1 && once.requested == 2 * step && once.faults.is_empty(),
        "the same in our words",
    );
    let mut fatal = 0;
    for n in 1..10 {
        let mut totals = vec![step];
        totals.extend(vec![wild; n]);
        if !believe(window, &totals, false)?.faults.is_empty() {
            fatal = n;
            break;
        }
    }
    rows.number(
        (
            place,
            "readings beyond it until \"I Still Don't Believe You\" is fatal: the first and two more",
            "",
        ),
        3.0,
        fatal as f64,
        Is::Within(0.0),
        "",
    );
    let large = believe(window, &[wild], true)?;
    rows.holds(
        (place, "\"Large Correction\" has it accepted"),
        "accepted",
        if large.requested == wild { "accepted" } else { "refused" },
        large.requested == wild,
        "",
    );
    Ok(())
}

/// The disable switch and probing mode refuse what is asked.
fn switches(rows: &mut Rows) -> Result<(), PaperError> {
    let place = "General Considerations";
    let config = AxisConfig {
        design: Design::Original,
        rest: RestPolicy::Insert { after_ns: 1_000_000 },
        lines: AxisLines::standard(0, false),
        ..AxisConfig::default()
    };
    for (what, request) in [
        ("corrections disabled, a nonzero request: an error message", Request::Disable),
        ("probing mode: no compensation", Request::Probe(true)),
    ] {
        let mut card = ReplayCard::new(Xor, recording(), |_, _: State| {})?;
        let mut refused = Vec::new();
        let mut report = |e: rtec_rt::event::Event| {
            if let EventKind::Refused { why, .. } = e.kind {
                refused.push(format!("{why:?}"));
            }
            true
        };
        let cannot = |_| cannot("an engine");
        let mut engine =
            homed_engine(config, &mut card, &mut |_| true).map_err(|_| self::cannot("an engine"))?;
        engine.take(request, &mut card, &mut report).map_err(cannot)?;
        engine.correct(4, true, &mut card, &mut report).map_err(cannot)?;
        let inserted = engine.status().axes[0].insertions;
        rows.holds(
            (place, what),
            "nothing inserted",
            &format!("{inserted} inserted, refused: {}", refused.join(", ")),
            inserted == 0 && refused.len() == 1,
            "the engine's own words",
        );
    }
    Ok(())
}

fn diagrams(rows: &mut Rows) {
    rows.not(("Figure 1", "system overview", ""), "diagram", "", "no figures in it");
    rows.not(("Figure 3", "generic RTEC: block diagram", ""), "diagram", "", "no figures in it");
    rows.not(
        ("The \"Right Way\"", "response to a probe's trip", ""),
        "microseconds rather than milliseconds",
        "",
        "4854 gives the figure, 25 µs, and is measured there",
    );
}
