//! The designs compared on the same motion, and their waveforms.

use crate::computer_timing::ComputerTiming;
use crate::insertion_design_bench::{
    BenchResult, BenchRun, Edge, InsertionDesign, constant, insert_at_rest, there_and_back,
};
use rtec_driver::quadrature::State;
#[cfg(feature = "clap")]
use rtec_files::cli_option_parsers::number;
use rtec_rt::axis::AxisConfig;
use serde::Serialize;
use std::fmt::Write as _;

// The documentation of the fields is the help of `rtecctl designs`. At the slow end a motion takes hours; no real edge
// is faster than the other end.
/// The motion on which all designs are compared
///
/// It goes from rest up to speed and back to rest, in both directions, with corrections of both signs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct TestMotion {
    /// Speed of the motion, as encoder frequency in Hz (a quarter of the count rate)
    #[cfg_attr(feature = "clap", arg(long, value_name = "HZ", default_value_t = Self::default().encoder_hz,
        value_parser = number(|v| (0.1..=1e8).contains(&v), "expected a number from 1e-1 to 1e8 Hz")))]
    pub encoder_hz: f64,
    /// Acceleration of the motion, counts/s²
    #[cfg_attr(feature = "clap", arg(long = "accel", value_name = "A", default_value_t = Self::default().accel_counts_s2,
        value_parser = number(|v| (1.0..=1e12).contains(&v), "expected a number from 1e0 to 1e12 counts/s²")))]
    pub accel_counts_s2: f64,
    /// Length of each way of the motion, counts
    #[cfg_attr(feature = "clap", arg(long, value_name = "N", default_value_t = Self::default().counts,
        value_parser = clap::value_parser!(u64).range(100..=10_000_000)))]
    pub counts: u64,
    /// Rest before each way, ns.
    #[cfg_attr(feature = "clap", arg(skip = Self::default().rest_ns))]
    pub rest_ns: u64,
    /// Largest requested correction, counts.
    #[cfg_attr(feature = "clap", arg(skip = Self::default().correction_counts))]
    pub correction_counts: i64,
}

impl Default for TestMotion {
    /// The report's turning centre: 1 µm counts, rapid traverse at 7 m/min.
    /// That is "about 30 kHz" (NISTIR 4832, Altering the Position Signal).
    fn default() -> Self {
        Self {
            encoder_hz: 7e6 / 60.0 / 4.0,
            accel_counts_s2: 1e6,
            counts: 20_000,
            rest_ns: 20_000_000,
            correction_counts: 60,
        }
    }
}

impl TestMotion {
    /// The scale's edges during this motion.
    pub fn edges(&self) -> Vec<Edge> {
        there_and_back(self.encoder_hz, self.accel_counts_s2, self.counts, self.rest_ns)
    }

    /// Totals that rise and fall in steps of twelve counts throughout the motion.
    fn totals(&self, edges: &[Edge]) -> Vec<(u64, i64)> {
        let last_ns = edges.last().map_or(0, |e| e.0);
        let steps = 5 * self.correction_counts / 12;
        let down = 2 * (self.correction_counts / 12);
        let mut total = 0;
        (1..=steps)
            .map(|n| {
                total += if n % (down + 1) < down / 2 { 12 } else { -12 };
                (
                    last_ns * n as u64 / (steps as u64 + 1),
                    total.clamp(-self.correction_counts, self.correction_counts),
                )
            })
            .collect()
    }
}

/// Effects at the MTC when the computer stops at a moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ComputerStopEffects {
    /// Best moment: MTC counts per scale count after the stop.
    pub best_follows: f64,
    /// Worst moment: MTC counts per scale count after the stop.
    pub worst_follows: f64,
    /// Counts lost at the MTC during the rest of the motion, at the worst moment.
    pub worst_count_error: i64,
    /// Share of moments in the motion after which the MTC still follows the scale.
    pub share_harmless: f64,
}

/// Properties of one design: a row of the comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DesignComparisonRow {
    /// The design of this row.
    pub design: InsertionDesign,
    /// Counts of one insertion.
    pub increment_counts: i64,
    /// Measured time from the opening edge until the hardware is free, ns.
    /// For the ECC it is that of one pulse at the motion's speed.
    pub insertion_time_ns: Option<u64>,
    /// Highest encoder frequency at which corrections are served without a fault, Hz.
    /// It is 0 if there is none.
    pub max_safe_encoder_hz: f64,
    /// Lowest such frequency, Hz (ECC: below it the PLL does not lock).
    pub min_safe_encoder_hz: f64,
    /// Whether corrections are served at rest in each of the four states.
    pub works_at_rest: bool,
    /// Number of the four states in which corrections are served at rest.
    pub states_served_at_rest: u8,
    /// Whether A and B reach the MTC only through the computer.
    pub signals_pass_through_computer: bool,
    /// Illegal transitions at the MTC during the motion.
    pub illegal_states: u64,
    /// Largest error left in the MTC's count after the motion.
    pub worst_count_error: i64,
    /// Whether the last total was reached at the end, to within one increment.
    pub served: bool,
    /// Effects of a stopped computer in words, from the runs.
    pub when_computer_dies: String,
    /// Effects of a stopped computer in figures.
    pub death: ComputerStopEffects,
}

/// The comparison, as `rtecctl designs --json` prints it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InsertionDesignComparison {
    /// One row per design.
    pub designs: Vec<DesignComparisonRow>,
    /// The motion on which they were compared.
    pub motion: TestMotion,
    /// The computer that they ran on.
    pub timing: ComputerTiming,
}

/// Runs every design on the same motion and computer.
pub fn compare(computer: &ComputerTiming, motion: TestMotion, seed: u64) -> InsertionDesignComparison {
    let designs = InsertionDesign::ALL.map(|d| row(d, computer, &motion, seed)).into();
    InsertionDesignComparison { designs, motion, timing: computer.clone() }
}

fn row(
    design: InsertionDesign,
    computer: &ComputerTiming,
    motion: &TestMotion,
    seed: u64,
) -> DesignComparisonRow {
    let edges = motion.edges();
    let totals = motion.totals(&edges);
    let config = AxisConfig { max_accel_counts_s2: motion.accel_counts_s2, ..AxisConfig::default() };
    let run = BenchRun { config, edges: &edges, totals: &totals, seed, ..BenchRun::new(design, computer) };
    let (mut illegal, mut worst, mut served) = (0, 0_i64, true);
    let mut insertion_ns: Option<u64> = None;
    for start in 0..4 {
        let run = BenchRun { start: State::from_bits(start), seed: seed + u64::from(start), ..run.clone() };
        let Some(seen) = run.run() else {
            served = false;
            continue;
        };
        illegal += seen.illegal;
        worst = if seen.error_counts().abs() > worst.abs() { seen.error_counts() } else { worst };
        served &= (seen.requested - seen.completed).abs() < design.increment_counts();
        insertion_ns = match (insertion_ns, seen.edge_to_done_ns) {
            (Some(a), Some((b, _))) => Some(a.min(b)),
            (a, b) => a.or(b.map(|b| b.0)),
        };
    }
    let still = BenchRun { config, ..BenchRun::new(design, computer) };
    let (low, high) = BenchRun { seed, ..still.clone() }.safe_range();
    let states = (0..4).filter(|&s| still.served_at_rest(State::from_bits(s))).count() as u8;
    let death = death(&run);
    DesignComparisonRow {
        design,
        increment_counts: design.increment_counts(),
        insertion_time_ns: insertion_ns,
        max_safe_encoder_hz: high,
        min_safe_encoder_hz: low,
        works_at_rest: states == 4,
        states_served_at_rest: states,
        signals_pass_through_computer: design.through_computer(),
        illegal_states: illegal,
        worst_count_error: worst,
        served,
        when_computer_dies: death.in_words(),
        death,
    }
}

fn clean(seen: &BenchResult, separation_ns: u64) -> bool {
    seen.completed == seen.requested
        && seen.error_counts() == 0
        && seen.illegal == 0
        && seen.faults == 0
        && seen.overlaps == 0
        && seen.min_separation_ns >= separation_ns.min(500)
        && seen.worst_phase_deg < 20.0
}

impl BenchRun<'_> {
    /// Whether the design is safe at this encoder frequency.
    /// Corrections of both signs must be served in full in both directions. The MTC must see no illegal
    /// transition, no edge closer than its separation, no wrong count, and phases of 90°.
    pub fn safe_at(&self, encoder_hz: f64) -> bool {
        let counts = 3000;
        (0..4_u8).all(|phase| {
            [1, -1].into_iter().all(|direction| {
                let edges = constant(1_000_000 + 137 * u64::from(phase), encoder_hz, counts, direction);
                let at = |share: u64| edges[(counts * share / 100) as usize].0;
                let totals = [(at(20), 12), (at(60), -12)];
                let (start, seed) = (State::from_bits(phase), self.seed + u64::from(phase));
                let run = BenchRun { start, edges: &edges, totals: &totals, seed, ..self.clone() };
                run.run().is_some_and(|seen| clean(&seen, run.config().min_separation_ns))
            })
        })
    }

    /// Lowest and highest encoder frequency at which the design is safe, Hz.
    /// Found by bisection to 0.1 %; (0, 0) if there is none.
    pub fn safe_range(&self) -> (f64, f64) {
        // From the lowest frequency of interest upwards; the ECC is not safe at the slow end.
        let from = [100.0, 10_000.0].into_iter().find(|&hz| self.safe_at(hz));
        let Some(from) = from else { return (0.0, 0.0) };
        let bisect = |mut good: f64, mut bad: f64| {
            while (good - bad).abs() > 1e-3 * good.max(bad) {
                let middle = (good * bad).sqrt();
                *if self.safe_at(middle) { &mut good } else { &mut bad } = middle;
            }
            good
        };
        let high = if self.safe_at(10e6) { 10e6 } else { bisect(from, 10e6) };
        let low = if from > 100.0 { bisect(from, 100.0) } else { 0.0 };
        (low, high)
    }

    /// Whether corrections are exact and legal at rest in this state.
    pub fn served_at_rest(&self, start: State) -> bool {
        let totals = [(2_000_000, 12), (40_000_000, -12), (80_000_000, -12)];
        let run = BenchRun { config: insert_at_rest(self.config), start, totals: &totals, ..self.clone() };
        run.run().is_some_and(|s| s.completed == -12 && s.error_counts() == 0 && s.illegal == 0)
    }
}

/// Stops the computer at many moments, including every stage of the insertions.
fn death(run: &BenchRun<'_>) -> ComputerStopEffects {
    let mut death = ComputerStopEffects::default();
    let Some(whole) = (BenchRun { keep_log: true, ..run.clone() }).run() else { return death };
    death.worst_follows = 1.0;
    // Just after changes of A' and B', and moments spread over the motion.
    let changes: Vec<u64> = whole.log.windows(2).filter(|w| w[0].1 == w[1].1).map(|w| w[1].0).collect();
    let end_ns = run.edges.last().map_or(0, |e| e.0);
    let spread: Vec<u64> = (1..60).map(|n| end_ns * n / 66).collect();
    let chosen = changes.iter().step_by(changes.len().div_ceil(60).max(1)).map(|t| t + 1);
    let mut harmless = 0;
    let stop = |die_ns: u64| -> Option<(f64, i64)> {
        // Judged by the longest travel that follows: the way back would undo the error of a mirrored count.
        let alive = run.edges.partition_point(|e| e.0 <= die_ns);
        let (mut travel, mut longest, mut upto) = (0_i64, 0_i64, alive);
        for (n, (_, step)) in run.edges.iter().enumerate().skip(alive) {
            travel += step;
            if travel.abs() > longest {
                (longest, upto) = (travel.abs(), n + 1);
            }
        }
        let seen = BenchRun { die_ns, edges: &run.edges[..upto], ..run.clone() }.run()?;
        let (scale, mtc) = seen.at_death?;
        let (moved, counted) = (seen.scale - scale, seen.mtc - mtc);
        (moved != 0).then(|| (counted as f64 / moved as f64, counted - moved))
    };
    for die_ns in spread.iter().copied() {
        let Some((follows, error)) = stop(die_ns) else { continue };
        if death.best_follows == 0.0 || (follows - 1.0).abs() < (death.best_follows - 1.0).abs() {
            death.best_follows = follows;
        }
        harmless += usize::from(error.abs() <= 2);
    }
    for die_ns in spread.iter().copied().chain(chosen) {
        let Some((follows, error)) = stop(die_ns) else { continue };
        if error.abs() > death.worst_count_error.abs() {
            (death.worst_follows, death.worst_count_error) = (follows, error);
        }
    }
    death.share_harmless = harmless as f64 / spread.len() as f64;
    death
}

impl ComputerStopEffects {
    /// The same in words, for the table.
    pub fn in_words(&self) -> String {
        let after = |follows: f64| {
            if (follows - 1.0).abs() < 0.01 {
                "the MTC goes on seeing the scale"
            } else if (follows + 1.0).abs() < 0.01 {
                "the MTC counts mirrored"
            } else if follows.abs() < 0.01 {
                "the MTC sees an axis at rest"
            } else {
                "the MTC sees part of the counts"
            }
        };
        let (best, worst) = (after(self.best_follows), after(self.worst_follows));
        if best == worst {
            format!("at any moment: {worst}")
        } else {
            format!("between insertions: {best}; inside one: {worst}")
        }
    }
}

impl InsertionDesignComparison {
    /// The comparison as a table.
    pub fn to_table(&self) -> String {
        let m = &self.motion;
        let mut s = format!(
            "motion: {} counts there and back at {:.1} kHz (encoder), {:.3e} counts/s², corrections to ±{} counts\n\
             computer: {}\n\n",
            m.counts,
            m.encoder_hz / 1e3,
            m.accel_counts_s2,
            m.correction_counts,
            self.timing.name
        );
        let _ = writeln!(
            s,
            "design    counts  time/insertion  safe encoder frequency     at rest  through PC  illegal  count error  \
             when the computer dies"
        );
        for r in &self.designs {
            let time = r.insertion_time_ns.map_or("—".into(), |t| format!("{:.2} µs", t as f64 / 1e3));
            let range = match (r.min_safe_encoder_hz, r.max_safe_encoder_hz) {
                (_, 0.0) => "none".into(),
                (0.0, hi) => format!("to {:.2} kHz", hi / 1e3),
                (lo, hi) => format!("{:.2} to {:.2} kHz", lo / 1e3, hi / 1e3),
            };
            let _ = writeln!(
                s,
                "{:<9} {:>6}  {time:>14}  {range:<25}  {:<7}  {:<10}  {:>7}  {:>11}  {}",
                r.design.name(),
                format!("±{}", r.increment_counts),
                if r.works_at_rest { "yes".into() } else { format!("{} of 4", r.states_served_at_rest) },
                if r.signals_pass_through_computer { "yes" } else { "no" },
                r.illegal_states,
                r.worst_count_error,
                r.when_computer_dies
            );
        }
        s
    }
}

/// Waveforms of one design as an SVG: A, B, A', B' and the MTC's count.
/// The design adds `pulses` increments, then removes them (NISTIR 4832, figure 2; CMTI 2014, figures 8 and 9).
pub fn waveforms(design: InsertionDesign, computer: &ComputerTiming, pulses: i64) -> String {
    let increments = pulses * design.increment_counts();
    let counts = 8 * (increments as u64) + 40;
    let edges = constant(100_000, 5000.0, counts, 1);
    let at = |share: u64| edges[(counts * share / 100) as usize].0 - 1;
    let totals = [(at(12), increments), (at(55), 0)];
    let run = BenchRun { edges: &edges, totals: &totals, keep_log: true, ..BenchRun::new(design, computer) };
    let Some(seen) = run.run() else { return String::new() };
    draw(design, &seen.log, &totals)
}

/// One signal of a timing diagram, with its name, from left to right.
/// Low is at `base`, and changes are (x, level).
pub fn trace(
    (name, colour): (&str, &str),
    (left, right, base): (f64, f64, f64),
    changes: impl Iterator<Item = (f64, bool)>,
) -> String {
    let y = |high: bool| if high { base - 26.0 } else { base };
    let (mut points, mut last) = (String::new(), None);
    for (x, level) in changes {
        let before = *last.get_or_insert(level);
        if points.is_empty() {
            let _ = write!(points, "{left:.1},{:.1}", y(level));
        }
        if level != before {
            let _ = write!(points, " {x:.1},{:.1} {x:.1},{:.1}", y(before), y(level));
            last = Some(level);
        }
    }
    let _ = write!(points, " {right:.1},{:.1}", y(last.unwrap_or(false)));
    format!(
        "<text x=\"16\" y=\"{base:.0}\">{name}</text><polyline fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.2\" \
         points=\"{points}\"/>\n"
    )
}

type Level = fn(&(u64, State, State, i64)) -> bool;

fn draw(design: InsertionDesign, log: &[(u64, State, State, i64)], totals: &[(u64, i64)]) -> String {
    let (from, to) = match (log.first(), log.last()) {
        (Some(_), Some(last)) => (90_000_u64, last.0 + 20_000),
        _ => return String::new(),
    };
    let (left, width, row) = (60.0, 1180.0, 44.0);
    let x = |t: u64| left + width * (t.max(from) - from) as f64 / (to - from) as f64;
    let mut s = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1280 400\" font-family=\"sans-serif\" \
         font-size=\"14\">\n<rect width=\"1280\" height=\"400\" fill=\"white\"/>\n<text x=\"{left}\" y=\"22\">Design \
         {}: A and B of the scale, A' and B' at the MTC, and its count</text>\n",
        design.name()
    );
    let signals: [(&str, &str, Level); 4] = [
        ("A", "#505050", |l| l.1.a()),
        ("B", "#505050", |l| l.1.b()),
        ("A'", "#0072b2", |l| l.2.a()),
        ("B'", "#0072b2", |l| l.2.b()),
    ];
    for (n, (name, colour, level)) in signals.into_iter().enumerate() {
        let base = 80.0 + row * n as f64;
        s += &trace((name, colour), (left, left + width, base), log.iter().map(|l| (x(l.0), level(l))));
    }
    let max = log.iter().map(|l| l.3).max().unwrap_or(1).max(1);
    let y = |count: i64| 370.0 - 110.0 * count as f64 / max as f64;
    let mut points = format!("{left:.1},{:.1}", y(0));
    let mut count = 0;
    for l in log {
        if l.3 != count {
            let _ = write!(points, " {:.1},{:.1} {:.1},{:.1}", x(l.0), y(count), x(l.0), y(l.3));
            count = l.3;
        }
    }
    let _ = write!(points, " {:.1},{:.1}", left + width, y(count));
    let _ = writeln!(
        s,
        "<text x=\"10\" y=\"372\">0</text><text x=\"10\" y=\"268\">{max}</text><text x=\"10\" y=\"320\">counts</text>\
         <text x=\"{left}\" y=\"394\">{:.3} ms</text><text x=\"1240\" y=\"394\" text-anchor=\"end\">{:.3} ms</text><polyline fill=\"none\" \
         stroke=\"#d55e00\" stroke-width=\"1.2\" points=\"{points}\"/>",
        from as f64 * 1e-6,
        to as f64 * 1e-6
    );
    for &(t, total) in totals {
        let _ = writeln!(
            s,
            "<line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"40\" y2=\"372\" stroke=\"#009e73\" stroke-dasharray=\"4 3\"/>\
             <text x=\"{1:.1}\" y=\"40\" fill=\"#009e73\">requested {total} counts</text>",
            x(t),
            x(t) + 3.0
        );
    }
    s + "</svg>\n"
}
