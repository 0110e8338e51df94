//! The highest edge rate at which insertions are made and no count is lost.
//! Run it by `cargo bench -p rtec-rt --bench edge_rate [-- EDGES]`.
//!
//! First this machine polls a mapped card for two seconds and notes the time between looks. Then the engine runs on a
//! virtual card at a constant edge rate. The times between its looks are drawn from that measurement, up to its 99.9th
//! percentile. Longer ones are the host's; they are printed, and would be latched as a poll gap.
//!
//! The rate is found by bisection over 100 000 edges each, and the highest one is confirmed over EDGES (default 10⁸).
//! For comparison it prints the rate that the MTC's separations alone allow: three separations an insertion, and no
//! late look.

use rtec_driver::card::{AxisLines, Card, CardError, CardInputSample, MachineLines};
use rtec_driver::card_profile::CardProfile;
use rtec_driver::clock::{Clock, Monotonic};
use rtec_driver::mapped_registers::MappedCard;
use rtec_driver::quadrature::{Decoder, State};
use rtec_rt::axis::AxisConfig;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{Event, RequestToRt};
use rtec_rt::realtime_setup::{RtSettings, SystemRoot, apply};
use std::time::Instant;

const SEPARATIONS_NS: [u64; 3] = [500, 200, 100];

/// Times between looks at a mapped card on this machine, ns, sorted.
fn measure() -> Result<Vec<u32>, Box<dyn std::error::Error>> {
    let system = SystemRoot::live();
    let (_held, report) = apply(&system, RtSettings { cpu: system.default_cpu(), priority: 80 });
    for missing in report.missing() {
        println!("measured without {}: {}", missing.name, missing.got);
    }
    let file = tempfile::NamedTempFile::new_in("/dev/shm")?;
    file.as_file().set_len(4096)?;
    let mut card = MappedCard::open(file.path(), &CardProfile::shared_memory(), Monotonic)?;
    let mut gaps = Vec::with_capacity(40_000_000);
    let end_ns = Monotonic.now_ns() + 2_000_000_000;
    let mut last_ns = card.sample(0)?.t_ns;
    while last_ns < end_ns && gaps.len() < gaps.capacity() {
        let now_ns = card.sample(0)?.t_ns;
        gaps.push((now_ns - last_ns).min(u64::from(u32::MAX)) as u32);
        last_ns = now_ns;
    }
    gaps.sort_unstable();
    Ok(gaps)
}

/// A card with a scale at constant speed, an MTC, and looks at the measured times.
struct Steady<'a> {
    gaps: &'a [u32],
    random: u64,
    t_ns: u64,
    period_ns: u64,
    next_edge_ns: u64,
    edges_left: u64,
    scale: Decoder,
    mtc: Decoder,
    outputs: u64,
}

impl Steady<'_> {
    fn send(&mut self) {
        self.mtc.update(self.scale.state().inverted((self.outputs & 3) as u8));
    }
}

impl Card for Steady<'_> {
    #[inline]
    fn sample(&mut self, wake_ns: u64) -> Result<CardInputSample, CardError> {
        // Skips most looks that neither see an edge nor reach the engine's wake time, because they change nothing.
        let worst_ns = u64::from(self.gaps[self.gaps.len() - 1]);
        let skip_to_ns = self.next_edge_ns.min(wake_ns).saturating_sub(2 * worst_ns);
        self.t_ns = self.t_ns.max(skip_to_ns);
        // xorshift64 draws the next measured gap.
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.t_ns += u64::from(self.gaps[(self.random % self.gaps.len() as u64) as usize]);
        while self.next_edge_ns <= self.t_ns {
            if self.edges_left == 0 {
                return Err(CardError::Ended);
            }
            self.edges_left -= 1;
            self.next_edge_ns += self.period_ns;
            self.scale.update(self.scale.state().next(true));
            self.send();
        }
        Ok(CardInputSample::level(self.t_ns, u64::from(self.scale.state().bits())))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        self.send();
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Number of insertions over `edges` edges at this period.
/// `None` where a count was lost or a fault was latched.
fn run(
    gaps: &[u32],
    separation_ns: u64,
    period_ns: u64,
    edges: u64,
) -> Result<Option<u64>, Box<dyn std::error::Error>> {
    let worst_ns = u64::from(gaps[gaps.len() - 1]);
    let mut card = Steady {
        gaps,
        random: 0x9E37_79B9_7F4A_7C15,
        t_ns: 1,
        period_ns,
        next_edge_ns: 100_000,
        edges_left: edges,
        scale: Decoder::new(State::default()),
        mtc: Decoder::new(State::default()),
        outputs: 0,
    };
    let config = AxisConfig {
        lines: AxisLines::standard(0, false),
        min_separation_ns: separation_ns,
        max_accel_counts_s2: 1e7,
        // An edge is seen one look late, and acted on one look late.
        detect_ns: 2 * worst_ns,
        ..AxisConfig::default()
    };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let Ok(mut engine) = Engine::new(&mut card, &[config], machine, &[]) else { return Ok(None) };
    let mut tell = |_: Event| true;
    engine.start_homed(&mut card, &mut tell)?;
    let mut total_counts = 0;
    let mut next_ns = 0;
    loop {
        if engine.now_ns() >= next_ns {
            next_ns = engine.now_ns() + 1000 * period_ns;
            total_counts = 2 - total_counts;
            engine.take(RequestToRt::Correct { axis: 0, total_counts, large: true }, &mut card, &mut tell)?;
        }
        match engine.poll(&mut card, u64::MAX, &mut tell) {
            Ok(()) => {}
            Err(CardError::Ended) => break,
            Err(error) => return Err(error.into()),
        }
    }
    let axis = engine.status().axes[0];
    // The recording may end inside an insertion. The engine is then not at rest, or the ledger does not have the pair
    // yet.
    let ended_inside = !engine.at_rest();
    let kept = axis.position_counts == card.scale.count()
        && card.mtc.count() - card.scale.count() == axis.mtc_minus_scale
        && (ended_inside || axis.mtc_minus_scale == axis.completed)
        && card.mtc.illegal() == 0
        && !axis.faults.any();
    Ok(kept.then_some(axis.insertions))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let edges: u64 = std::env::args().skip(1).find_map(|n| n.parse().ok()).unwrap_or(100_000_000);
    // A thread of its own, because the priority ends with it.
    let measured = std::thread::spawn(|| measure().map_err(|e| e.to_string())).join();
    let mut gaps = measured.map_err(|_| "the measuring thread panicked")??;
    let at = |q: f64| gaps[((gaps.len() - 1) as f64 * q) as usize];
    println!(
        "looks at a mapped card: {} in 2 s, {} ns median, {} ns p99.9, {} ns p99.99, {} ns at the worst",
        gaps.len(),
        at(0.5),
        at(0.999),
        at(0.9999),
        at(1.0)
    );
    gaps.truncate((gaps.len() as f64 * 0.999) as usize);
    let mut all_kept = true;
    for separation_ns in SEPARATIONS_NS {
        let (mut works_ns, mut fails_ns) = (10_000, separation_ns);
        while works_ns - fails_ns > 1 {
            let middle = u64::midpoint(works_ns, fails_ns);
            // Every request but the last must have been served.
            if run(&gaps, separation_ns, middle, 100_000)?.is_some_and(|n| n >= 90) {
                works_ns = middle;
            } else {
                fails_ns = middle;
            }
        }
        let begun = Instant::now();
        let kept = run(&gaps, separation_ns, works_ns, edges)?;
        println!(
            "highest rate with {separation_ns} ns separation: {} counts/s ({works_ns} ns a count), {:.1} % of what the \
             separations allow; over {edges} edges: {} in {:.0} s",
            1_000_000_000 / works_ns,
            100.0 * (3 * separation_ns) as f64 / works_ns as f64,
            kept.map_or("A COUNT WAS LOST".into(), |n| format!("{n} insertions, no count lost")),
            begun.elapsed().as_secs_f64(),
        );
        all_kept &= kept.is_some();
    }
    if !all_kept {
        std::process::exit(1);
    }
    Ok(())
}
