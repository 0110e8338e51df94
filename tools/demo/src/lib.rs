//! Corrects a simulated axis in real time: no hardware, no root, no configuration.
//!
//! The real engine runs on a thread of its own, against a mock card. Behind the card are a moving axis and a controller
//! that counts what it is sent. The axis has an error of 240 µm per metre and a periodic one of its screw.
//!
//! `rtecctl demo` runs it with options; the program `rtec-demo` has none and needs few crates, so it is built quickly.

use anyhow::Context as _;
use rtec_correct::{AxisCorrectionSettings, Corrector, RAMP_UM_S};
use rtec_driver::card::{AxisLines, MachineLines};
use rtec_driver::clock::Monotonic;
use rtec_driver::mock_card::MockCard;
use rtec_files::file_format_stamp::signed;
use rtec_model::machine::Machine;
use rtec_rt::axis::{AxisConfig, INCREMENT_COUNTS};
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::{
    AxisStatus, CorrectorMode, CorrectorStatus, Event, EventKind, Fault, RequestToRt,
};
use rtec_rt::pinned_rt_thread::{RtThreadHandle, ThreadOptions, spawn};
use rtec_sim::stroking_axes::{MovingAxes, StrokeMotion, TrueAxisState, moving_axes};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

// The documentation of the fields is the help of `rtecctl demo`.
/// What `rtecctl demo` can be asked for
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct Options {
    /// How long to run
    #[cfg_attr(feature = "clap", arg(long, default_value = "10s", value_parser = rtec_files::cli_option_parsers::duration))]
    pub duration: Duration,
    /// Print one JSON document at the end instead of the live view
    #[cfg_attr(feature = "clap", arg(long))]
    pub json: bool,
    /// Write the tool's error every 10 ms into this CSV file, without and with correction
    #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
    pub errors: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self { duration: Duration::from_secs(10), json: false, errors: None }
    }
}

/// Why a demo ended without success.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The MTC's count is not the scale's count and the completed total.
    #[error("the ledger does not balance")]
    Unbalanced,
    /// The engine latched a fault.
    #[error("fault latched: {0:?}")]
    Fault(Vec<Fault>),
}

const COUNT_UM: f64 = 1.0;
const STROKE_MM: f64 = 60.0;
const FEED_MM_S: f64 = 30.0;

/// Model of the axis: a linear error and a ball screw's error once per turn.
///
/// 240 µm per metre is the largest error to be expected on a one-metre axis (NISTIR 4832).
const MODEL: &str = r#"
name = "demo axis"
[[effect]]
name = "scale.x"
ppm = 240.0
[[effect]]
name = "screw_periodic.x"
period_mm = 5.0
um = 3.0
phase_rad = 0.0
"#;
/// Period of the control law, s.
const TICK_S: f64 = 0.01;
/// Delay of the axis's motion after an insertion, s.
const FOLLOWS_S: f64 = 0.006;

/// Error of the axis at a position, µm.
/// It repeats the formula of `MODEL`, as an independent judge.
fn error_um(position_mm: f64) -> f64 {
    let (ppm, period_mm, periodic_um) = (240.0, 5.0, 3.0);
    ppm * position_mm / 1000.0 + periodic_um * (TAU * position_mm / period_mm).sin()
}

/// Sums of squares of the tool's error, µm².
#[derive(Debug, Default)]
struct SquaredErrors {
    without: f64,
    with: f64,
    samples: u32,
}

impl SquaredErrors {
    fn add(&mut self, without_um: f64, with_um: f64) {
        self.without += without_um * without_um;
        self.with += with_um * with_um;
        self.samples += 1;
    }

    fn rms_um(&self) -> (f64, f64) {
        let n = f64::from(self.samples.max(1));
        ((self.without / n).sqrt(), (self.with / n).sqrt())
    }
}

type Card = MockCard<MovingAxes, Monotonic>;

/// Runs the demo and prints its progress and its result.
///
/// # Errors
/// A [`DemoError`], or what the engine, the file of errors or standard output refused.
pub fn run(options: &Options) -> anyhow::Result<()> {
    let lines = AxisLines::standard(0, true);
    let motion = StrokeMotion {
        stroke_counts: STROKE_MM * 1000.0 / COUNT_UM,
        feed_counts_s: FEED_MM_S * 1000.0 / COUNT_UM,
        dwell_s: 0.2,
        on_feedback: true,
    };
    let (axes, operator) = moving_axes(&[(lines, motion)], MachineLines::default());
    let mut card = MockCard::new(axes, Monotonic);
    let axis = AxisConfig {
        lines,
        max_correction_counts: 100,
        window_counts: 10,
        max_accel_counts_s2: 1e7,
        detect_ns: 4_000,
        ..AxisConfig::default()
    };
    let machine = MachineConfig { lines: MachineLines::default(), may_arm: true };
    let engine = Engine::new(&mut card, &[axis], machine, &[])?;
    let thread = ThreadOptions { wanted: None, real: false, stale_after_ns: 500_000_000 };
    let mut running = spawn(engine, card, thread)?;
    start(&mut running)?;
    let truth = &operator.truth;
    operator.cycle_start();

    let mut law = build_corrector(&axis, MODEL)?;
    let live = !options.json && std::io::stdout().is_terminal();
    let (begun, mut drawn) = (Instant::now(), Duration::ZERO);
    let mut squares = SquaredErrors::default();
    let mut errors = "t_s,without_um,with_um\n".to_owned();
    let mut view = ProgressView { live, lines: 0 };
    if !options.json {
        print(&format!(
            "axis X: {STROKE_MM} mm strokes at {FEED_MM_S} mm/s, {COUNT_UM} µm per count, mock card, simulated MTC\n"
        ))?;
    }
    while begun.elapsed() < options.duration && !running.control.ended() {
        std::thread::sleep(Duration::from_secs_f64(TICK_S));
        running.control.beat();
        let status = running.control.status();
        if let Some(total_counts) = law.tick(begun.elapsed().as_secs_f64(), &status, &[])[0] {
            running.control.send(RequestToRt::Correct { axis: 0, total_counts, large: false })?;
        }
        let (without, with) = tool_error_um(&truth[0]);
        squares.add(without, with);
        if options.errors.is_some() {
            writeln!(errors, "{:.3},{without:.3},{with:.3}", begun.elapsed().as_secs_f64())?;
        }
        let every = Duration::from_millis(if live { 100 } else { 1000 });
        if !options.json && begun.elapsed() >= drawn + every {
            drawn = begun.elapsed();
            view.draw(drawn, &status, without, with)?;
        }
    }
    if let Some(file) = &options.errors {
        rtec_files::atomic_write::write_atomically(file, errors.as_bytes())
            .with_context(|| format!("writing {}", file.display()))?;
    }
    let (ended, mut control) = running.stop();
    let status = ended.status;
    let events = std::iter::from_fn(|| control.event());
    let fault = |event: Event| if let EventKind::Fault(fault) = event.kind { Some(fault) } else { None };
    let faults: Vec<Fault> = events.filter_map(fault).collect();
    let AxisStatus { position_counts, requested, completed, insertions, .. } = status.axes[0];
    let (mtc_counts, illegal, polls) = (truth[0].mtc_counts(), truth[0].illegal(), status.polls);
    let mtc_minus_scale = mtc_counts - position_counts;
    let balanced = mtc_minus_scale == completed && illegal == 0 && status.balanced();
    let (without_um, with_um) = squares.rms_um();
    if options.json {
        let document = serde_json::json!({
            "position_counts": position_counts, "mtc_counts": mtc_counts, "requested": requested,
            "completed": completed, "insertions": insertions, "illegal_out": illegal, "faults": faults,
            "balanced": balanced, "rms_without_um": without_um, "rms_with_um": with_um,
        });
        print(&(signed(document.to_string()) + "\n"))?;
    } else {
        let ledger = if balanced { "balanced" } else { "NOT BALANCED" };
        print(&format!(
            "tool error, RMS over the run: {without_um:.2} µm without, {with_um:.2} µm with correction\n\
             ledger: MTC {mtc_counts} − scale {position_counts} = {mtc_minus_scale:+}, completed {completed:+}: {ledger}\n\
             {insertions} insertions, {illegal} illegal states at the MTC, {polls} looks at the card\n"
        ))?;
    }
    if !faults.is_empty() {
        return Err(DemoError::Fault(faults).into());
    }
    if !balanced {
        return Err(DemoError::Unbalanced.into());
    }
    Ok(())
}

/// Prints to standard output.
/// A reader that has gone away (`| head`) is not an error: the demo goes on.
fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(e).context("writing to standard output"),
        _ => Ok(()),
    }
}

/// Control law of the axis with a model.
fn build_corrector(axis: &AxisConfig, model: &str) -> anyhow::Result<Corrector> {
    let setup = AxisCorrectionSettings {
        name: "x".to_owned(),
        count_um: COUNT_UM,
        increment_counts: INCREMENT_COUNTS,
        window_counts: axis.window_counts,
        max_counts: axis.max_correction_counts,
    };
    let mut law = Corrector::new(vec![setup], RAMP_UM_S, TICK_S + FOLLOWS_S, 0.0);
    law.load(Machine::parse(Path::new("demo"), model)?, &|_| Vec::new())?;
    Ok(law)
}

/// Homes the axis, reads the home position back, then enables corrections.
fn start(running: &mut RtThreadHandle<Card>) -> anyhow::Result<()> {
    let control = &mut running.control;
    control.send(RequestToRt::Home { axis: 0, position_counts: 0, controller_homed: true })?;
    loop {
        let Some(event) = control.event() else {
            anyhow::ensure!(!control.ended(), "the real-time thread has ended");
            std::thread::sleep(Duration::from_millis(1));
            continue;
        };
        match event.kind {
            EventKind::HomeSet { .. } => {
                // A status from before the zeroing contains the old position.
                while control.status().t_ns <= event.t_ns && !control.ended() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                let position_counts = control.status().axes[0].position_counts;
                control.send(RequestToRt::ConfirmHome { axis: 0, position_counts })?;
            }
            EventKind::Homed { .. } => control.send(RequestToRt::Enable)?,
            EventKind::Mode(CorrectorMode::Run) => return Ok(()),
            EventKind::Refused { why, .. } => anyhow::bail!("the corrector was not enabled: {why:?}"),
            _ => {}
        }
    }
}

/// The tool's error without and with correction, µm.
fn tool_error_um(truth: &TrueAxisState) -> (f64, f64) {
    let (commanded_mm, off_um) =
        (truth.commanded_counts() * COUNT_UM / 1000.0, truth.off_counts() * COUNT_UM);
    (error_um(commanded_mm), off_um + error_um(commanded_mm + off_um / 1000.0))
}

/// The printed progress.
/// On a terminal its rows are redrawn; otherwise there is one line per second.
struct ProgressView {
    live: bool,
    lines: usize,
}

impl ProgressView {
    fn draw(
        &mut self,
        at: Duration,
        status: &CorrectorStatus,
        without_um: f64,
        with_um: f64,
    ) -> anyhow::Result<()> {
        let AxisStatus { position_counts, requested, completed, insertions, edge_rate_hz, .. } =
            status.axes[0];
        let (seconds, mm) = (at.as_secs_f64(), position_counts as f64 * COUNT_UM / 1000.0);
        if !self.live {
            return print(&format!(
                "{seconds:5.1} s  X {mm:8.3} mm  requested {requested:+4}  completed {completed:+4}  error {without_um:+6.2} µm \
                 without, {with_um:+6.2} µm with\n"
            ));
        }
        // Back to the first row.
        let mut text = if self.lines > 0 { format!("\x1b[{}A", self.lines) } else { String::new() };
        let rows = [
            format!("{seconds:5.1} s   X {mm:8.3} mm   {edge_rate_hz:>6.0} counts/s"),
            format!("  requested {requested:+4}   completed {completed:+4}   insertions {insertions}"),
            format!("  without {without_um:+6.2} µm  {}", bar(without_um)),
            format!("  with    {with_um:+6.2} µm  {}", bar(with_um)),
        ];
        self.lines = rows.len();
        for row in rows {
            writeln!(text, "\x1b[2K{row}")?;
        }
        print(&text)
    }
}

/// ±20 µm as a line of 41 characters.
fn bar(um: f64) -> String {
    let at = (um.clamp(-20.0, 20.0) + 20.0).round() as usize;
    let mark = |n| match n {
        n if n == at => '●',
        20 => '│',
        _ => '·',
    };
    (0..=40).map(mark).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_files::csv::{Cell, Reader};

    /// The demo's law gives the totals of the law itself on a recorded shift.
    /// The shift is that of `rtec-correct`'s tests, with effects of the demo's axis only. The other law has
    /// all axes, but nothing else to correct.
    #[test]
    fn a_recorded_shift_gets_the_totals_of_the_law() {
        let known = "name = \"m\"\n[[effect]]\nname = \"scale.x\"\nppm = 120.0\n[[effect]]\nname = \"screw_periodic.x\"\n\
                     period_mm = 10.0\num = 4.0\nphase_rad = 0.3\n";
        let axis = AxisConfig { window_counts: 50, max_correction_counts: 1000, ..AxisConfig::default() };
        let mut demo = build_corrector(&axis, known).unwrap();
        let setup = |name: &str| AxisCorrectionSettings {
            name: name.to_owned(),
            count_um: COUNT_UM,
            increment_counts: 2,
            window_counts: 50,
            max_counts: 1000,
        };
        let mut all = Corrector::new(vec![setup("x")], RAMP_UM_S, TICK_S + FOLLOWS_S, 0.0);
        all.load(Machine::parse(Path::new("m"), known).unwrap(), &|_| Vec::new()).unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../correct/tests/shift/shift.csv");
        let mut reader = Reader::open(&file).unwrap();
        let header = reader.header("t_s, positions, sensors, operator, totals").unwrap();
        let mut both =
            [CorrectorStatus { mode: CorrectorMode::Run, axes_used: 1, ..CorrectorStatus::default() }; 2];
        both[0].axes[0].homed = true;
        both[1].axes[0].homed = true;
        let mut asked = 0;
        while let Some(row) = reader.row().unwrap() {
            let mut at = Vec::new();
            header.each(row, |_, cell: Cell<'_>| cell.finite().map(|v| at.push(v))).unwrap();
            for (status, law) in both.iter_mut().zip([&mut demo, &mut all]) {
                status.t_ns = (at[0] * 1e9).round() as u64;
                status.axes[0].position_counts = at[1] as i64;
                let total = law.tick(at[0], status, &[])[0];
                asked += usize::from(total.is_some());
                let axis = &mut status.axes[0];
                let total = total.unwrap_or(axis.requested);
                (axis.requested, axis.completed, axis.in_effect) = (total, total, total);
            }
            assert_eq!(both[0].axes[0].requested, both[1].axes[0].requested, "at {} s", at[0]);
        }
        assert!(asked > 60, "{asked}");
    }
}
