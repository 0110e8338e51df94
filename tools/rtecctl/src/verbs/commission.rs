//! `rtecctl commission`: checks sign and unit of an axis by a guided jog.
//! It also checks that the controller does not compensate already.
//!
//! Three numbers are compared: the display of the controller, an indicator at the axis, and the count of the
//! scale. Indicator against scale shows sign and unit. Display against feedback shows the compensation by the
//! controller itself.
//!
//! Then counts are inserted and the axis is jogged back. The display shows the old position; the scale must
//! differ by exactly the inserted total.
//!
//! However it ends (an answer, a signal, no answer), the total is requested back to zero. Any part that still
//! waits for a motion of the axis is reported.

use crate::daemon_connection::{self, expected};
use crate::prelude::*;
use nix::sys::signal::Signal;
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{AxisReport, ClientRequest, DaemonResponse, DaemonStatus};
use rtec_correct::jog_check::{
    JogFinding, JogReading, compensation_um, judge_compensation, judge_insertion, judge_jog, largest_step_um,
};
use rtec_model::machine::Machine;
use serde_json::Map;
use std::io::Write;
use std::time::{Duration, Instant};

/// Prove sign and unit of an axis, and that its controller does not compensate already, by a guided jog
///
/// Put an indicator at the axis. It is taken off before the long jog, and put back after it, when that is asked for. A simulated
/// axis (mock card) is jogged and read by itself.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Args {
    /// The axis
    axis: String,
    /// How far to jog with the indicator, mm; negative to the other side
    #[arg(long, default_value_t = 10.0, allow_negative_numbers = true)]
    jog_mm: f64,
    /// How far to jog without it, mm: display against scale
    #[arg(long, default_value_t = 50.0, allow_negative_numbers = true)]
    far_mm: f64,
    /// Total to insert, counts; within the belief window [default: 20, or the window where it is smaller]
    #[arg(long)]
    counts: Option<i64>,
    /// How well display and indicator can be read, µm
    #[arg(long, default_value_t = 5.0)]
    tolerance_um: f64,
    /// Propose a belief window for this model: three of its largest steps, as NISTIR 4832 has three corrections
    #[arg(long, value_name = "machine.toml")]
    model: Option<PathBuf>,
    /// Ask for the readings of a simulated axis too, which a program has to jog
    #[arg(long)]
    by_hand: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Time without a change after which the scale is at rest.
const REST: Duration = Duration::from_millis(300);
/// Longest wait for an axis to come to rest; after it the axis is running.
const PATIENCE: Duration = Duration::from_secs(60);

/// Default number of inserted counts, limited by the belief window.
const USUAL_COUNTS: i64 = 20;
struct GuidedJogSession<'a> {
    client: DaemonConnection,
    args: &'a Args,
    simulated: bool,
    /// The indicator is at the axis.
    indicator: bool,
    /// The total to insert, counts.
    counts: i64,
    /// Largest step of the model for which a belief window is proposed, µm.
    step_um: Option<f64>,
}

impl<'a> GuidedJogSession<'a> {
    fn connect(args: &'a Args) -> anyhow::Result<Self> {
        let client = args.daemon.connect()?;
        Ok(Self { client, args, simulated: false, indicator: true, counts: 0, step_um: None })
    }

    fn ask(&mut self, request: &ClientRequest) -> anyhow::Result<DaemonResponse> {
        daemon_connection::ask(&mut self.client, request)
    }

    fn status(&mut self) -> anyhow::Result<(DaemonStatus, AxisReport)> {
        let status = daemon_connection::status(&mut self.client)?;
        let name = &self.args.axis;
        let axis = status.axes.iter().find(|a| a.name == *name).cloned().ok_or_else(|| {
            let names = list(status.axes.iter().map(|a| &a.name));
            CommandFailure::Bad(format!("found axis {name:?}, expected one of {names}"))
        })?;
        Ok((status, axis))
    }

    /// Waits until the axis is at rest and nothing is left to be inserted.
    fn at_rest(&mut self) -> anyhow::Result<AxisReport> {
        let (begun, mut told) = (Instant::now(), self.simulated);
        let (mut last, mut since) = (None, Instant::now());
        loop {
            let (status, axis) = self.status()?;
            ensure!(status.mode == "run", No, "the mode is {} now", status.mode);
            if last != Some(axis.position_counts) {
                (last, since) = (Some(axis.position_counts), Instant::now());
            }
            if since.elapsed() > REST {
                return Ok(axis);
            }
            if begun.elapsed() > REST && !std::mem::replace(&mut told, true) {
                let simulated = status.rt.card == "mock";
                let jogged = if simulated { "; without --by-hand it is jogged to each place" } else { "" };
                eprintln!("{} moves: waiting {} s for it to stand{jogged}", axis.name, PATIENCE.as_secs());
            }
            ensure!(begun.elapsed() <= PATIENCE, No, "the axis does not come to rest");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn jog_simulated(&mut self, display_mm: Option<f64>) -> anyhow::Result<(f64, f64)> {
        let request = ClientRequest::Jog { axis: self.args.axis.clone(), display_mm, go_on: false };
        Ok(
            expected!(self.ask(&request)?, DaemonResponse::Stands { display_mm, indicator_mm } => (display_mm, indicator_mm)),
        )
    }

    /// Sends the axis to a displayed position, and reads all three there.
    /// Without a position it stays where it is.
    fn jog_and_read(&mut self, to_mm: Option<f64>) -> anyhow::Result<JogReading> {
        let name = self.args.axis.clone();
        let (display_mm, indicator_mm) = if self.simulated {
            let to_mm = to_mm.map_or_else(|| self.jog_simulated(None).map(|s| s.0.round()), Ok)?;
            eprintln!("jogging {name} to {:.4} mm", rounded(to_mm));
            self.jog_simulated(Some(to_mm))?;
            // It must first begin to move, then come to rest at the target.
            while (self.jog_simulated(None)?.0 - to_mm).abs() > 1e-6 {
                std::thread::sleep(Duration::from_millis(20));
            }
            self.at_rest()?;
            self.jog_simulated(None)?
        } else {
            match to_mm {
                Some(mm) => {
                    let mm = rounded(mm);
                    eprint!("jog {name} to {mm:.4} mm on the display, always from the same side. ");
                }
                None => eprint!("let {name} stand, with an indicator at it. "),
            }
            eprint!(
                "Enter {}, mm: ",
                if self.indicator { "display and indicator" } else { "the display only" }
            );
            std::io::stderr().flush()?;
            let mut lines = std::io::stdin().lock();
            if self.indicator {
                let [display_mm, indicator_mm] = numbers(&mut lines, "two numbers, as 10.000 9.998")?;
                (display_mm, indicator_mm)
            } else {
                let [display_mm] = numbers(&mut lines, "one number, as 10.000")?;
                (display_mm, f64::NAN)
            }
        };
        let axis = self.at_rest()?;
        let count_um = 1000.0 * axis.position_mm / axis.position_counts as f64;
        Ok(JogReading {
            display_mm,
            indicator_mm,
            scale_counts: axis.position_counts,
            in_effect: axis.in_effect,
            count_um: if count_um.is_finite() { count_um } else { f64::NAN },
        })
    }

    /// Asks for the indicator to be removed or set; a simulated one cannot be hit.
    fn indicator(&mut self, on: bool, text: &str) {
        self.indicator = on;
        if !self.simulated {
            eprintln!("{text}");
        }
    }

    fn insert(&mut self, total_counts: i64) -> anyhow::Result<()> {
        let request = ClientRequest::Correct { axis: self.args.axis.clone(), total_counts, large: false };
        self.ask(&request).map(drop)
    }

    fn prove(&mut self, figures: &mut Map<String, Value>) -> anyhow::Result<JogFinding> {
        let (args, tolerance_um) = (self.args, self.args.tolerance_um);
        let mut note = |key: &str, value: Value| figures.insert(key.to_owned(), value);
        let start = self.jog_and_read(None)?;
        let there = self.jog_and_read(Some(start.display_mm + args.jog_mm))?;
        // At zero, position and counts give no unit, so the other reading's unit is taken.
        let count_um = if there.count_um.is_nan() { start.count_um } else { there.count_um };
        let [start, there] = [start, there].map(|p| JogReading { count_um, ..p });
        if let Some(step_um) = self.step_um {
            note("largest_step_of_the_model_um", rounded(step_um).into());
            note("window_counts_proposed", rtec_correct::belief_window_counts(count_um, step_um).into());
        }
        note("display_mm", rounded(there.display_mm - start.display_mm).into());
        note("indicator_mm", rounded(there.indicator_mm - start.indicator_mm).into());
        note("scale_mm", rounded(there.scale_mm() - start.scale_mm()).into());
        if let Some(finding) = judge_jog(&start, &there, tolerance_um) {
            return Ok(finding);
        }
        let far_mm = start.display_mm + args.far_mm;
        let off = format!("take the indicator off first: the next jog goes to {:.4} mm", rounded(far_mm));
        self.indicator(false, &off);
        let far = JogReading { count_um, ..self.jog_and_read(Some(far_mm))? };
        note("controller_compensates_um", rounded(compensation_um(&start, &far)).into());
        if let Some(finding) = judge_compensation(&start, &far, tolerance_um) {
            return Ok(finding);
        }
        let before = self.jog_and_read(Some(start.display_mm))?;
        self.indicator(true, "put the indicator back now: the axis stays near it");
        eprintln!("inserting {:+} counts", self.counts);
        self.insert(self.counts)?;
        // Away and back: at rest there is no edge at which to insert.
        self.jog_and_read(Some(start.display_mm + args.jog_mm))?;
        let after = self.jog_and_read(Some(start.display_mm))?;
        self.insert(0)?;
        let (total, moved) = (after.in_effect - before.in_effect, after.scale_counts - before.scale_counts);
        note("inserted_counts", total.into());
        note("scale_moved_counts", moved.into());
        if total == 0 {
            let text = "nothing was inserted: see the gate in `rtecctl status`".to_owned();
            return Ok(JogFinding { verdict: "not_inserted", text });
        }
        if let Some(finding) = judge_insertion(&before, &after, total) {
            return Ok(finding);
        }
        self.jog_and_read(Some(start.display_mm + args.jog_mm))?;
        let back = self.jog_and_read(Some(start.display_mm))?;
        if let Some(finding) = judge_insertion(&after, &back, back.in_effect - after.in_effect) {
            return Ok(finding);
        }
        let text = format!(
            "sign and unit are right; {total:+} counts moved the axis by {moved:+}, and it came back; the controller does not \
             compensate by itself"
        );
        Ok(JogFinding { verdict: "right", text })
    }
}

/// Rounded to the four decimals that are shown, zero without a sign.
fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}

/// Reads the numbers of a line.
/// Anything else is asked for again; the end of the input is an error.
fn numbers<const N: usize>(from: &mut impl std::io::BufRead, expected: &str) -> anyhow::Result<[f64; N]> {
    loop {
        let mut line = String::new();
        if from.read_line(&mut line)? == 0 {
            eprintln!();
            fail!(No, "nobody answers; nothing is proved");
        }
        let found: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        if let Ok(found) = found
            && let Ok(found) = <[f64; N]>::try_from(found)
            && found.iter().all(|v| v.is_finite())
        {
            return Ok(found);
        }
        eprint!("found {:?}, expected {expected}: ", line.trim());
    }
}

/// Withdraws the inserted counts, and reports what the controller still has.
/// A simulated axis that was jogged goes on to and fro.
fn take_back(args: &Args, simulated: bool) -> anyhow::Result<()> {
    let mut guide = GuidedJogSession::connect(args)?;
    guide.insert(0)?;
    let axis = guide.status()?.1;
    if axis.in_effect != 0 {
        eprintln!(
            "axis {}: 0 counts are requested; {:+} are still in the controller's count and go out as soon as the axis moves: \
             jog it, then see `rtecctl status`",
            axis.name, axis.in_effect
        );
    }
    if simulated {
        guide.ask(&ClientRequest::Jog { axis: axis.name, display_mm: None, go_on: true })?;
    }
    Ok(())
}

/// From now on a signal ends the run after the inserted counts are withdrawn.
/// The main thread cannot do that while it waits for answers.
fn on_signal(args: &Args, simulated: bool) -> anyhow::Result<()> {
    let ends = daemon_connection::block_end_signals()?;
    let args = args.clone();
    std::thread::spawn(move || {
        let signal = ends.wait();
        eprintln!("\n{}: nothing is proved", signal.map_or("interrupted", Signal::as_str));
        let code = match take_back(&args, simulated) {
            Ok(()) => 1,
            Err(error) => {
                eprintln!("rtecctl: not taken back: {error:#}; `rtecctl correct {} 0`", args.axis);
                i32::from(crate::exit_code(&error))
            }
        };
        std::process::exit(code);
    });
    Ok(())
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let small = args.jog_mm.abs() * 1000.0 <= 10.0 * args.tolerance_um;
    if small || !args.jog_mm.is_finite() || !args.far_mm.is_finite() || args.counts == Some(0) {
        let counts = args.counts.map_or_else(String::new, |counts| format!(" --counts {counts}"));
        let found = format!("--jog-mm {} --far-mm {}{counts}", args.jog_mm, args.far_mm);
        let expected = "a jog beyond ten times the tolerance, and counts that are not 0";
        fail!(Bad, "found {found}, expected {expected}");
    }
    let model = args.model.as_deref().map(Machine::read).transpose()?;
    let mut guide = GuidedJogSession::connect(args)?;
    let (status, axis) = guide.status()?;
    let places_mm = [0.0, args.jog_mm, args.far_mm];
    guide.step_um = model.map(|m| largest_step_um(&m, &args.axis, places_mm)).transpose()?;
    guide.counts = args.counts.unwrap_or_else(|| USUAL_COUNTS.min(axis.window_counts));
    ensure!(status.mode != "fault", Fault, "{}", status.why_not.join("; "));
    if let Some(why) = in_the_way(&status, &axis) {
        fail!(No, "{why}");
    }
    guide.simulated = status.rt.card == "mock" && !args.by_hand;
    on_signal(args, guide.simulated)?;
    let mut figures = Map::new();
    let found = guide.prove(&mut figures);
    let back = take_back(args, guide.simulated);
    let found = found?;
    back?;
    if args.daemon.json {
        figures.insert("axis".to_owned(), args.axis.clone().into());
        figures.insert("verdict".to_owned(), found.verdict.into());
        figures.insert("text".to_owned(), found.text.clone().into());
        say_line(&figures)?;
    } else {
        for (key, value) in &figures {
            println!("{key:28} {value}");
        }
        println!("axis {}: {}", args.axis, found.text);
    }
    ensure!(found.verdict == "right", No, "axis {}: {}", args.axis, found.verdict.replace('_', " "));
    Ok(())
}

/// Why the axis cannot be commissioned now.
/// Any other source that moves it would be mistaken for the inserted counts.
fn in_the_way(status: &DaemonStatus, axis: &AxisReport) -> Option<String> {
    let AxisReport { name, requested, in_effect, .. } = axis;
    if status.mode != "run" || !axis.homed {
        // An axis is commissioned without a model.
        let why = status.why_not.iter().filter(|why| status.model_refused.as_ref() != Some(why));
        let why: Vec<&str> = why.map(String::as_str).collect();
        return Some(format!("corrections are not on: {}", why.join("; ")));
    }
    let other = |what: &str, verb: &str| {
        format!(
            "{what}, which moves the axis too: `rtecctl {verb} unload`, prove the axis, then `rtecctl {verb} load`"
        )
    };
    if status.model.is_some() {
        return Some(other("a model is running", "model"));
    }
    if status.table.is_some() {
        return Some(other("a part table is loaded", "part"));
    }
    if *requested != 0 {
        let what = format!("axis {name}: {requested:+} counts are requested already");
        return Some(format!("{what}: `rtecctl correct {name} 0`"));
    }
    (*in_effect != 0).then(|| {
        format!(
            "axis {name}: {in_effect:+} counts of an earlier request are still on their way out: jog it until `rtecctl status` \
             says 0 in effect"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Examples have the window that `commission` proposes for their model.
    #[test]
    fn every_example_has_the_window_proposed_for_its_model() {
        let mut axes = 0;
        for example in rtec_sim::example_machines::EXAMPLES {
            let Some((_, text)) = example.files.iter().find(|f| f.0 == "rtec.toml") else { continue };
            let model =
                example.files.iter().find(|f| f.0 == "machine.toml").map_or("name = \"m\"\n", |f| f.1);
            let machine = Machine::parse(Path::new("machine.toml"), model).unwrap();
            let config = rtec_control::config::Config::parse(Path::new("rtec.toml"), text).unwrap();
            for axis in &config.axes {
                let places_mm = [0.0, axis.travel_mm / 2.0, axis.travel_mm];
                let step_um = largest_step_um(&machine, &axis.name, places_mm).unwrap_or(0.0);
                let proposed = rtec_correct::belief_window_counts(axis.count_um, step_um);
                assert_eq!(axis.engine.window_counts, proposed, "{}: {}", example.name, axis.name);
                axes += 1;
            }
        }
        assert!(axes > 8, "{axes}");
    }

    #[test]
    fn zero_is_shown_without_a_sign() {
        let shown = [-0.0, -0.000_04, -0.000_06, 12.345_67].map(|v| format!("{:.4}", rounded(v)));
        assert_eq!(shown, ["0.0000", "0.0000", "-0.0001", "12.3457"]);
    }

    #[test]
    fn answers_are_asked_for_until_they_are_as_many_numbers() {
        let mut lines = "ten\n10.0\n10.0 nan\n 10.000 9.998 \n".as_bytes();
        assert_eq!(
            numbers(&mut lines, "two numbers").unwrap().map(f64::to_bits),
            [10.0_f64, 9.998].map(f64::to_bits)
        );
        assert_eq!(
            numbers(&mut "10.0 9.998\n10.0\n".as_bytes(), "one number").unwrap().map(f64::to_bits),
            [10.0_f64].map(f64::to_bits)
        );
        assert!(numbers::<2>(&mut "".as_bytes(), "two numbers").is_err());
    }
}
