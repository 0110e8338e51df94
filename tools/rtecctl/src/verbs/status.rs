//! `rtecctl status`: what the corrector does, and if nothing, why.

use crate::daemon_connection::{explained, status};
use crate::json_output::line;
use crate::prelude::*;
use crate::terminal::{self, ColourMeaning, toned};
use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{
    AxisReport, ClientRequest, DaemonResponse, DaemonStatus, PartTable, PartTableState, TimeDistribution,
};
use rtec_correct::explain::AxisCorrectionComponents;

/// Show what the corrector is doing; exit 4 while a fault is latched
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Show it again and again, every half second, until interrupted; with --json one document a line
    #[arg(long)]
    watch: bool,
    /// With --watch: another time between two looks, as 1s
    #[arg(long, value_name = "TIME", requires = "watch", value_parser = rtec_files::cli_option_parsers::duration)]
    every: Option<Duration>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

const EVERY: Duration = Duration::from_millis(500);
/// Shortest interval; the daemon has other work.
const FASTEST: Duration = Duration::from_millis(20);

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if args.watch {
        return watch(&args.daemon, args.every.unwrap_or(EVERY).max(FASTEST));
    }
    let DaemonResponse::Status(status) = args.daemon.ask(&ClientRequest::Status {})? else { return Ok(()) };
    if !args.daemon.json {
        let way =
            args.daemon.view().map_or_else(|_| Vec::new(), |mut client| on_their_way(&mut client, &status));
        print!("{}", table(&status, &way, TerminalStyle::here()));
    }
    ensure!(status.mode != "fault", Fault, "a fault is latched");
    Ok(())
}

fn watch(daemon: &DaemonArgs, every: Duration) -> anyhow::Result<()> {
    let mut client = daemon.view()?;
    loop {
        let status = status(&mut client)?;
        let text = if daemon.json {
            line(&status)?
        } else {
            table(&status, &on_their_way(&mut client, &status), TerminalStyle::here())
        };
        if !terminal::redraw(&text, !daemon.json)? {
            return Ok(());
        }
        std::thread::sleep(every);
    }
}

/// An axis whose correction ramps, and the rest of its ramp, µm.
type RampingAxis = (String, f64);

/// The ramps under way, as `explain` reports them; none without an answer.
fn on_their_way(client: &mut DaemonConnection, status: &DaemonStatus) -> Vec<RampingAxis> {
    if status.mode != "run" {
        return Vec::new();
    }
    explained(client).map_or_else(|_| Vec::new(), |axes| still_to_go(&axes))
}

fn still_to_go(axes: &[AxisCorrectionComponents]) -> Vec<RampingAxis> {
    let of =
        |a: &AxisCorrectionComponents| a.parts.iter().find(|p| p.name == "on its way").map_or(0.0, |p| -p.um);
    let ramps = axes.iter().filter(|a| a.holds.is_none()).map(|a| (a.axis.clone(), of(a)));
    // Smaller rests are not shown.
    ramps.filter(|(_, um)| um.abs() >= 0.05).collect()
}

fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// The output of the status.
#[derive(Debug, Clone, Copy)]
struct TerminalStyle {
    colour: bool,
    /// Columns; none without a terminal, when lines are not wrapped.
    width: Option<u16>,
}

const WHOLE: u16 = 118;

impl TerminalStyle {
    fn here() -> Self {
        Self { colour: terminal::colour(), width: terminal::width() }
    }

    /// Whether the table of axes omits its less important columns.
    fn narrow(self) -> bool {
        self.width.is_some_and(|width| width < WHOLE)
    }

    fn fit(self, text: String) -> String {
        match self.width {
            Some(width) => terminal::wrapped(&text, usize::from(width)),
            None => text,
        }
    }
}

fn table(s: &DaemonStatus, way: &[RampingAxis], screen: TerminalStyle) -> String {
    screen.fit(head(s, screen)) + &axes(s, screen) + &screen.fit(below(s, way, screen))
}

fn head(s: &DaemonStatus, screen: TerminalStyle) -> String {
    let tone = |text: &str, tone| toned(text, tone, screen.colour);
    let ledger = if !s.ledger_known() {
        tone("not known", ColourMeaning::Doubtful)
    } else if s.balanced {
        tone("balances", ColourMeaning::Good)
    } else {
        tone("DOES NOT BALANCE", ColourMeaning::Wrong)
    };
    let mode = match s.mode.as_str() {
        "run" => ColourMeaning::Good,
        "fault" => ColourMeaning::Wrong,
        _ => ColourMeaning::Doubtful,
    };
    // Hold and probing hide whether corrections resume when they end.
    let disabled = if matches!(s.mode.as_str(), "hold" | "probe") && !s.enabled { ", DISABLED" } else { "" };
    let DaemonStatus { machine, uptime_s, .. } = s;
    let (mode, homed) = (tone(&s.mode.to_uppercase(), mode), yes(s.homed));
    format!(
        "machine \"{machine}\"   mode {mode}{disabled}   homed {homed}   up {uptime_s:.1} s   ledger {ledger}\n"
    )
}

fn below(s: &DaemonStatus, way: &[RampingAxis], screen: TerminalStyle) -> String {
    let mut text = String::new();
    let tone = |text: &str, tone| toned(text, tone, screen.colour);
    let thread = match (s.rt.cpu, s.rt.priority) {
        (Some(cpu), Some(priority)) => format!("CPU {cpu}, SCHED_FIFO {priority}"),
        _ => "ordinary thread".to_owned(),
    };
    let (card, lost) = (&s.rt.card, s.rt.events_lost);
    let (gap, done) = (times(&s.rt.poll_gap_ns), times(&s.rt.edge_to_done_ns));
    let _ = writeln!(text, "card {card}, {thread}; poll gap {gap}; edge to done {done}; {lost} events lost");
    for a in s.axes.iter().filter(|a| a.rates.rapid_mm_min.is_some()) {
        let _ = writeln!(text, "  {}: {}", a.name, a.rates);
    }
    for missing in &s.rt.missing {
        let _ = writeln!(text, "{} {missing}", tone("missing:", ColourMeaning::Doubtful));
    }
    if let Some(m) = &s.model {
        let _ = writeln!(text, "model \"{}\", {}", m.name, m.file);
        for line in m.fits.iter().chain(&m.notes) {
            let _ = writeln!(text, "  {line}");
        }
    }
    if let Some(part) = &s.table {
        text.push_str(&part_table(part, s.table_now.as_ref()));
    }
    if !s.sensors.is_empty() {
        let good = s.sensors.iter().filter(|r| r.state == "good").count();
        let _ = writeln!(text, "sensors: {good} of {} good", s.sensors.len());
        for r in s.sensors.iter().filter(|r| r.state != "good") {
            let value = r.degc.map_or("never read".to_owned(), |v| format!("last good value {v:.2} °C"));
            let age = r.age_s.map_or(String::new(), |a| format!(" of {a:.0} s ago"));
            let fault = r.fault.as_ref().map_or(String::new(), |f| format!(": {f}"));
            let state = tone(&r.state, ColourMeaning::Doubtful);
            let _ = writeln!(text, "  {} {state}{fault}; {value}{age}", r.sensor);
        }
    }
    for file in &s.edited {
        let _ = writeln!(text, "{} {file}", tone("not what runs:", ColourMeaning::Doubtful));
    }
    if let Some(why) = &s.record_trouble {
        let _ = writeln!(text, "{} {why}", tone("record of commands not written:", ColourMeaning::Wrong));
    }
    // One axis may hold while another corrects, and a total may be in effect without the model.
    let some = s.mode == "run" && s.axes.iter().any(|a| a.requested != 0 || a.in_effect != 0);
    let what = if some { "in part only:" } else { "not correcting:" };
    let what = tone(what, if s.mode == "fault" { ColourMeaning::Wrong } else { ColourMeaning::Doubtful });
    for why in &s.why_not {
        let _ = writeln!(text, "{what} {why}");
    }
    if some || s.mode == "run" && s.why_not.is_empty() {
        let _ = writeln!(text, "{}", correcting(s, way));
    }
    let left = s.axes.iter().filter(|a| a.in_effect != 0);
    let left = list(left.map(|a| format!("{} {:+}", a.name, a.in_effect)));
    if s.mode != "run" && !left.is_empty() {
        let what = tone("still in the controller's count:", ColourMeaning::Doubtful);
        let _ = writeln!(text, "{what} {left} counts");
    }
    text
}

/// The axes, in lines of 80 columns if the terminal is not wide enough for all.
fn axes(s: &DaemonStatus, screen: TerminalStyle) -> String {
    // Each column with its width, and whether it stays on a narrow screen.
    const COLUMNS: [(&str, usize, bool); 9] = [
        ("position/mm", 13, true),
        ("counts", 12, false),
        ("requested", 10, true),
        ("completed", 10, true),
        ("in effect", 10, true),
        ("inverted", 9, false),
        ("edges/s", 9, false),
        ("gate", 17, true),
        ("insertions", 11, false),
    ];
    let row = |name: &str, cells: [String; 9]| {
        let kept = cells.iter().zip(COLUMNS).filter(|(_, column)| !screen.narrow() || column.2);
        kept.fold(format!("{name:<8}"), |row, (cell, (_, width, _))| format!("{row} {cell:>width$}"))
    };
    let mut text = row("axis", COLUMNS.map(|(head, ..)| head.to_owned())) + "\n";
    for a in &s.axes {
        let row = row(
            &a.name,
            [
                format!("{:.4}", a.position_mm),
                a.position_counts.to_string(),
                a.requested.to_string(),
                a.completed.to_string(),
                a.in_effect.to_string(),
                yes(a.inverted).to_owned(),
                format!("{:.0}", a.edge_rate_hz),
                a.gate.replace('_', " "),
                a.insertions.to_string(),
            ],
        );
        let row = if a.faults.is_empty() { row } else { toned(&row, ColourMeaning::Wrong, screen.colour) };
        text = text + &row + "\n";
    }
    text
}

/// The present corrections, if nothing prevents them.
fn correcting(s: &DaemonStatus, way: &[RampingAxis]) -> String {
    let ramps = list(way.iter().map(|(axis, um)| format!("{axis} {um:+.1} µm")));
    let way = (!way.is_empty()).then(|| format!("ramping, still to go: {ramps}"));
    let axis = |AxisReport { name, requested, in_effect, gate, .. }: &AxisReport| {
        if in_effect == requested {
            return format!("{name} {in_effect:+}");
        }
        let why = match gate.as_str() {
            "done" => format!("{:+} left, less than one insertion", requested - in_effect),
            gate => gate.replace('_', " "),
        };
        format!("{name} {in_effect:+} of {requested:+} ({why})")
    };
    let asked = s.axes.iter().filter(|a| a.requested != 0 || a.in_effect != 0);
    let asked = list(asked.map(axis));
    if !asked.is_empty() {
        let way = way.map_or_else(String::new, |way| format!("; {way}"));
        return format!("correcting: {asked} counts{way}");
    }
    if s.model.is_none() && s.table.is_none() {
        return "correcting nothing: no model, no part table, no total of the operator: `rtecctl model load`"
            .to_owned();
    }
    format!("correcting: {}", way.unwrap_or_else(|| "nothing to take out now".to_owned()))
}

fn part_table(part: &PartTable, now: Option<&PartTableState>) -> String {
    let PartTable { errors, axes: [along, across], centre_mm, radius_mm, lead_ms, .. } = part;
    let mut text = format!("part table {errors}");
    if let Some(now) = now {
        let _ = write!(text, ", {} points", now.points);
    }
    if let (Some([z, x]), Some(radius_mm)) = (centre_mm, radius_mm) {
        let _ = write!(text, "; radius {radius_mm} mm about {z}, {x} mm");
    }
    let _ = writeln!(text, "; axes {along}, {across}; {lead_ms} ms ahead");
    let feature = if radius_mm.is_some() { "arc" } else { "feature" };
    let Some(PartTableState { state, off_mm, acts_within_mm, um: [um_z, um_x], why, .. }) = now else {
        return text;
    };
    let _ = match (why, state.as_str()) {
        (Some(why), _) => writeln!(text, "  not in force: {why}"),
        (None, "ready") => writeln!(
            text,
            "  ready: the tool is {off_mm:.1} mm off the {feature}, in force within {acts_within_mm} mm of it"
        ),
        (None, _) => {
            writeln!(text, "  in force: takes out {um_z:+.2} µm in {along}, {um_x:+.2} µm in {across}")
        }
    };
    text
}

fn times(d: &TimeDistribution) -> String {
    if d.samples == 0 {
        return "-".to_owned();
    }
    format!("p50 {} ns, p99.99 {} ns, max {} ns", d.p50, d.p9999, d.max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_correct::explain::CorrectionComponent;
    use rtec_rt::link_messages::Fault;

    const PLAIN: TerminalStyle = TerminalStyle { colour: false, width: None };

    /// A machine that corrects with a model, and a sensor replaced by its last value.
    fn corrects() -> DaemonStatus {
        serde_json::from_str(include_str!("../../tests/golden/status_corrects.json")).unwrap()
    }

    #[test]
    fn a_machine_that_corrects_says_what_with_its_model_and_sensors() {
        crate::golden("status_corrects.txt", &table(&corrects(), &[], PLAIN));
    }

    #[test]
    fn a_machine_that_does_not_says_why_and_what_to_do() {
        let mut status = corrects();
        status.mode = "fault".into();
        status.balanced = false;
        status.axes[1].faults = vec![Fault::PollGap];
        status.axes[1].gate = "fault".into();
        status.rt.cpu = None;
        status.rt.missing =
            vec!["rt_throttling: wanted -1, found 950000; sysctl kernel.sched_rt_runtime_us=-1".into()];
        status.why_not = vec![
            format!("axis z: poll_gap: {}", rtec_control::protocol::explain_fault(Fault::PollGap)),
            "when mended: `rtecctl clear`".into(),
            "axis z: thermal corrections hold: sensor T18: silent; its last good value is 42 s old".into(),
        ];
        crate::golden("status_fault.txt", &table(&status, &[], PLAIN));
    }

    #[test]
    fn why_nothing_is_homed_is_what_the_daemon_says() {
        let mut status = corrects();
        assert_eq!(status.not_homed(), None);
        status.axes[0].homed = false;
        let name = status.axes[0].name.clone();
        let text = format!("axis {name}: not homed: move to the home position, then `rtecctl home`");
        assert_eq!(status.not_homed(), Some(text));
        status.axes[0].mtc_known = false;
        let text = status.not_homed().unwrap();
        assert!(text.starts_with(&format!("the controller's count is not known: {name}; ")), "{text}");
        assert!(text.ends_with("`rtecctl home --controller-homed`"), "{text}");
    }

    /// Colours only repeat the words, and nothing is wider than 80 columns.
    #[test]
    fn on_a_terminal_it_has_colours_and_keeps_to_its_width() {
        let mut status = corrects();
        status.mode = "fault".into();
        status.axes[1].faults = vec![Fault::PollGap];
        status.why_not = vec!["when mended: `rtecctl clear`".into()];
        status.edited =
            vec!["/etc/rtec/rtec.toml was edited since the start: `systemctl restart rtecd`".into()];
        status.record_trouble = Some("/var/log/rtec/audit.log: No space left on device".into());
        let coloured = table(&status, &[], TerminalStyle { colour: true, width: Some(80) });
        crate::golden("status_terminal.txt", &coloured.replace('\x1b', "␛"));
        let mut bare = coloured;
        for code in ["32", "33", "1;31", "0"] {
            bare = bare.replace(&format!("\x1b[{code}m"), "");
        }
        assert_eq!(bare, table(&status, &[], TerminalStyle { colour: false, width: Some(80) }));
        assert!(bare.lines().all(|row| row.chars().count() <= 80), "{bare}");
    }

    #[test]
    fn a_machine_that_nobody_asks_anything_of_says_so() {
        let mut status = corrects();
        status.axes.iter_mut().for_each(|a| (a.requested, a.in_effect) = (0, 0));
        assert_eq!(correcting(&status, &[]), "correcting: nothing to take out now");
        let part = |name: &str, um| CorrectionComponent {
            name: name.to_owned(),
            um,
            sensors: Vec::new(),
            outside_k: None,
            weight: None,
        };
        // The model wants 12.4 µm and none of it is inserted, so all of it is left.
        let explained = |axis: &str, parts, holds| AxisCorrectionComponents {
            axis: axis.to_owned(),
            requested: 0,
            total_um: 0.0,
            parts,
            holds,
        };
        let parts = vec![part("scale.x", 12.4), part("on its way", -12.4)];
        let axes = [
            explained("x", parts.clone(), None),
            explained("y", vec![part("on its way", 0.01)], None),
            explained("z", parts, Some("a sensor is silent".to_owned())),
        ];
        let way = still_to_go(&axes);
        assert_eq!(correcting(&status, &way), "correcting: ramping, still to go: x +12.4 µm");
        status.axes[0].requested = 2;
        assert!(correcting(&status, &way).ends_with(" counts; ramping, still to go: x +12.4 µm"));
        status.axes[0].requested = 0;
        status.model = None;
        assert!(correcting(&status, &[]).contains("`rtecctl model load`"));
    }

    #[test]
    fn everything_that_is_known_and_what_the_part_table_does() {
        let mut status: DaemonStatus =
            serde_json::from_str(include_str!("../../tests/golden/status.json")).unwrap();
        let mut text = table(&status, &[], PLAIN);
        let now = status.table_now.take().unwrap();
        let mut also = |now: Option<PartTableState>| {
            text.push_str("---\n");
            text.push_str(&part_table(status.table.as_ref().unwrap(), now.as_ref()));
        };
        also(Some(PartTableState { state: "ready".into(), off_mm: 84.25, um: [0.0; 2], ..now.clone() }));
        let why = Some("axis x: is not homed".to_owned());
        also(Some(PartTableState { state: "off".into(), why, ..now }));
        also(None);
        crate::golden("status.txt", &text);
        status.table = None;
        assert!(!table(&status, &[], PLAIN).contains("part table"));
    }
}
