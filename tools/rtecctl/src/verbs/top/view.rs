//! The screen of `rtecctl top`: status, components of the totals, last events.

use ratatui_core::layout::{Constraint, Layout, Margin, Rect};
use ratatui_core::style::{Color, Modifier, Style};
use ratatui_core::terminal::Frame;
use ratatui_core::text::{Line, Span, Text};
use rtec_control::protocol::{
    AxisCorrectionComponents, AxisReport, CorrectionComponent, DaemonSnapshot, DaemonStatus, NumberedEvent,
    SensorStateReport, TimeDistribution, word,
};
use rtec_model::record::span;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Number of looks in the trend: five minutes at two per second.
const TREND: usize = 600;
/// Smallest screen that shows anything useful, columns and lines.
const NEEDS: (u16, u16) = (60, 16);

/// Levels of the trend, lowest first.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

#[derive(Default)]
pub(super) struct TopScreenState {
    pub help: bool,
    colour: bool,
    every: Duration,
    status: Option<DaemonStatus>,
    explained: Vec<AxisCorrectionComponents>,
    events: Vec<NumberedEvent>,
    /// Total of each axis, µm, oldest first.
    trend: Vec<VecDeque<f64>>,
    gone: Option<(Instant, String)>,
    /// Time of the daemon's last answer.
    heard: Option<Instant>,
}

/// Age above which the state is marked as old.
const FRESH: Duration = Duration::from_secs(2);

impl TopScreenState {
    pub(super) fn new(colour: bool, every: Duration) -> Self {
        Self { colour, every, ..Self::default() }
    }

    pub(super) fn take(&mut self, seen: DaemonSnapshot) {
        let DaemonSnapshot { status, explained, events, .. } = seen;
        // Another machine or a restarted daemon: the old trend is not its own.
        if self.status.as_ref().is_some_and(|s| s.uptime_s > status.uptime_s || s.machine != status.machine) {
            self.trend.clear();
        }
        self.trend.resize_with(explained.len(), VecDeque::new);
        for (trend, axis) in self.trend.iter_mut().zip(&explained) {
            if trend.len() == TREND {
                trend.pop_front();
            }
            trend.push_back(axis.total_um);
        }
        (self.status, self.explained, self.events, self.gone) = (Some(status), explained, events, None);
        self.heard = Some(Instant::now());
    }

    /// Time since the daemon's last answer, if longer than expected.
    fn silent(&self) -> Option<Duration> {
        let since = self.heard.or(self.gone.as_ref().map(|(since, _)| *since))?.elapsed();
        (self.gone.is_some() || since > FRESH.max(self.every * 3)).then_some(since)
    }

    pub(super) fn gone(&mut self, why: String) {
        let since = self.gone.take().map_or_else(Instant::now, |(since, _)| since);
        self.gone = Some((since, why));
    }

    fn style(&self, colour: Color, modifier: Modifier) -> Style {
        let style = Style::new().add_modifier(modifier);
        if self.colour { style.fg(colour) } else { style }
    }

    fn good(&self) -> Style {
        self.style(Color::Green, Modifier::empty())
    }

    fn doubtful(&self) -> Style {
        self.style(Color::Yellow, Modifier::BOLD)
    }

    fn wrong(&self) -> Style {
        self.style(Color::Red, Modifier::BOLD | Modifier::REVERSED)
    }

    pub(super) fn draw(&self, frame: &mut Frame) {
        let area = frame.area();
        if area.width < NEEDS.0 || area.height < NEEDS.1 {
            let text = format!(
                "terminal {}x{}, needs {}x{}\nor `rtecctl status`\nq quits",
                area.width, area.height, NEEDS.0, NEEDS.1
            );
            return frame.render_widget(Text::from(text), area);
        }
        let axes = self.status.as_ref().map_or(0, |s| s.axes.len()) as u16;
        let [head, table, middle, thread, why, events, foot] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(axes + 2),
            Constraint::Fill(2),
            Constraint::Length(1),
            Constraint::Length(self.why().len().min(3) as u16),
            Constraint::Fill(1),
            Constraint::Length(1),
        ])
        .areas(area);
        match &self.status {
            None => frame.render_widget("waiting for the daemon", head),
            Some(s) => {
                frame.render_widget(self.head(s), head);
                self.axes(frame, s, table);
                let [effects, sensors] =
                    Layout::horizontal([Constraint::Percentage(56), Constraint::Percentage(44)])
                        .areas(middle);
                draw_framed(frame, effects, " error taken out, µm ", self.effects());
                let title = format!(" sensors, {} ", s.sensors.len());
                draw_framed(frame, sensors, &title, self.sensors(&s.sensors));
                frame.render_widget(thread_line(s), thread);
                let room = why.height as usize;
                frame.render_widget(Text::from(self.why().into_iter().take(room).collect::<Vec<_>>()), why);
                let room = usize::from(events.height.saturating_sub(2));
                draw_framed(frame, events, " last events ", self.events(s, room));
            }
        }
        frame.render_widget(self.foot(), foot);
        if self.help {
            Self::draw_help(frame, area);
        }
    }

    fn head(&self, s: &DaemonStatus) -> Line<'static> {
        let mode = match s.mode.as_str() {
            "run" => self.good(),
            "fault" => self.wrong(),
            _ => self.doubtful(),
        };
        let homed = if s.homed { "homed" } else { "not homed" };
        let ledger = if !s.ledger_known() {
            Span::styled("ledger not known", self.doubtful())
        } else if s.balanced {
            Span::styled("ledger balances", self.good())
        } else {
            Span::styled("LEDGER DOES NOT BALANCE", self.wrong())
        };
        Line::from(vec![
            Span::styled(format!(" {} ", s.machine), Modifier::BOLD),
            Span::raw(" "),
            Span::styled(s.mode.to_uppercase(), mode),
            Span::raw(format!("  {homed}  up {}  ", lasted(s.uptime_s))),
            ledger,
            match self.silent() {
                Some(old) => Span::styled(format!("  OLD: {}", lasted(old.as_secs_f64())), self.wrong()),
                None => Span::raw(""),
            },
        ])
    }

    fn axes(&self, frame: &mut Frame, s: &DaemonStatus, area: Rect) {
        let minutes = (self.every * TREND as u32).as_secs_f64() / 60.0;
        let [numbers, _, trend] = Layout::horizontal([
            Constraint::Length(82.min(area.width)),
            Constraint::Length(1),
            Constraint::Fill(1),
        ])
        .areas(area);
        let head = "axis      position/mm requested completed in effect  edges/s  state       ";
        let mut lines = vec![Line::styled(head, Modifier::UNDERLINED)];
        lines.extend(s.axes.iter().map(|a| self.axis(a)));
        frame.render_widget(Text::from(lines), numbers);
        if trend.width < 8 {
            return;
        }
        let title = format!("total, µm, last {minutes:.0} min");
        frame.render_widget(Line::styled(title, Modifier::UNDERLINED), Rect { height: 1, ..trend });
        for (n, values) in self.trend.iter().enumerate() {
            let row = Rect { y: trend.y + 1 + n as u16, height: 1, ..trend };
            if row.y < trend.bottom() {
                let levels = squeezed(values, usize::from(row.width)).into_iter();
                let bars: String = levels.map(|level| BARS[level - 1]).collect();
                frame.render_widget(Line::styled(bars, self.good()), row);
            }
        }
    }

    fn axis(&self, a: &AxisReport) -> Line<'static> {
        let AxisReport { position_mm, requested, completed, in_effect, edge_rate_hz, .. } = a;
        let name = shortened(&a.name, 8);
        let text = format!(
            "{name:<8} {position_mm:>12.4} {requested:>9} {completed:>9} {in_effect:>9} {edge_rate_hz:>8.0}  "
        );
        let state = if let Some(fault) = a.faults.first() {
            Span::styled(word(fault).replace('_', " "), self.wrong())
        } else if !a.homed {
            Span::styled("not homed", self.doubtful())
        } else {
            Span::raw(a.gate.replace('_', " "))
        };
        Line::from(vec![Span::raw(text), state])
    }

    /// Each axis's total and its components, the largest first.
    fn effects(&self) -> Vec<Line<'static>> {
        let mut lines = Vec::new();
        for axis in &self.explained {
            lines.push(Line::styled(format!("{:<28} {:>+9.2}", axis.axis, axis.total_um), Modifier::BOLD));
            let mut parts: Vec<_> = axis.parts.iter().filter(|p| p.um != 0.0).collect();
            parts.sort_by(|a, b| b.um.abs().total_cmp(&a.um.abs()));
            let line = |p: &CorrectionComponent| format!("  {:<26} {:>+9.2}", shortened(&p.name, 26), p.um);
            lines.extend(parts.into_iter().map(|p| Line::raw(line(p))));
            if let Some(why) = &axis.holds {
                lines.push(Line::styled(format!("  holds: {why}"), self.doubtful()));
            }
        }
        lines
    }

    fn sensors(&self, sensors: &[SensorStateReport]) -> Vec<Line<'static>> {
        let line = |r: &SensorStateReport| {
            let value = r.degc.map_or("-".to_owned(), |v| format!("{v:.2}"));
            let age = r.age_s.map_or("never".to_owned(), |a| format!("{a:.0} s"));
            let style = if r.state == "good" { Style::new() } else { self.doubtful() };
            Line::styled(format!("{:<8} {value:>7} °C {age:>6} {}", shortened(&r.sensor, 8), r.state), style)
        };
        // Sensors that are not good come first, since there may be more than lines.
        let (good, other): (Vec<_>, Vec<_>) = sensors.iter().partition(|r| r.state == "good");
        other.into_iter().chain(good).map(line).collect()
    }

    /// Reasons why nothing is corrected, faults of the machine first.
    fn why(&self) -> Vec<Line<'static>> {
        let Some(s) = &self.status else { return Vec::new() };
        let style = if s.mode == "fault" { self.wrong() } else { self.doubtful() };
        let why = s.why_not.iter().map(|w| Line::styled(format!("not correcting: {w}"), style));
        let record = s.record_trouble.iter().map(|w| format!("record of commands not written: {w}"));
        why.chain(record.map(|text| Line::styled(text, self.doubtful()))).collect()
    }

    fn events(&self, s: &DaemonStatus, room: usize) -> Vec<Line<'static>> {
        let line = |e: &NumberedEvent| {
            let axis = e.event.axis.as_ref().map_or(String::new(), |a| format!("axis {a}: "));
            let style = match e.event.kind.as_str() {
                "fault" => self.wrong(),
                "refused" | "warning" | "control_stale" => self.doubtful(),
                _ => Style::new(),
            };
            let of_day = e.at_s.rem_euclid(86_400.0) as u64;
            let (h, min, sec) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
            Line::styled(format!("{h:02}:{min:02}:{sec:02} UTC  {axis}{}", e.event.text), style)
        };
        let mut lines: Vec<_> = self.events.iter().rev().take(room).map(line).collect();
        if s.rt.events_lost > 0 && !lines.is_empty() {
            lines[0] = Line::styled(format!("{} events were lost", s.rt.events_lost), self.doubtful());
        }
        lines
    }

    fn foot(&self) -> Line<'static> {
        let Some(silent) = self.silent() else { return Line::styled(" ? help   q quit", Modifier::DIM) };
        let why = self.gone.as_ref().map_or(String::new(), |(_, why)| format!("; tried every second: {why}"));
        Line::styled(format!(" NO ANSWER for {}{why}", lasted(silent.as_secs_f64())), self.wrong())
    }

    fn draw_help(frame: &mut Frame, area: Rect) {
        let text = "\
            ? or h     this help, on and off\n\
            q, Ctrl-C  quit\n\
            \n\
            requested  total that was accepted, counts since homing\n\
            completed  inserted so far; in effect: really in the controller's count\n\
            state      of the speed gate, or what is latched\n\
            error      taken out, by effect; the axis moves by the opposite\n\
            trend      of each axis's total between its least and its most\n\
            \n\
            Nothing is commanded from here.";
        let (width, height) = (area.width.min(76), area.height.min(12));
        let at = Rect { x: (area.width - width) / 2, y: (area.height - height) / 2, width, height };
        draw_framed(frame, at, " rtecctl top ", text);
    }
}

/// Draws a text in a frame with a title, over whatever was there.
fn draw_framed<'t>(frame: &mut Frame, area: Rect, title: &str, text: impl Into<Text<'t>>) {
    let width = usize::from(area.width.saturating_sub(2));
    let inside = format!("│{:width$}│", "");
    let mut lines = vec![inside; usize::from(area.height).max(2)];
    let last = lines.len() - 1;
    lines[0] = format!("┌{title:─<width$.width$}┐");
    lines[last] = format!("└{:─<width$}┘", "");
    let border: Text = lines.into_iter().map(|line| Line::styled(line, Style::reset())).collect();
    frame.render_widget(border, area);
    frame.render_widget(text.into(), area.inner(Margin::new(1, 1)));
}

fn thread_line(s: &DaemonStatus) -> Line<'static> {
    let rt = &s.rt;
    let card = if rt.alive { &rt.card } else { "REAL-TIME THREAD ENDED" };
    let (gap, done) = (times(&rt.poll_gap_ns), times(&rt.edge_to_done_ns));
    let unarmed = if rt.may_arm { "" } else { "  may not be armed" };
    Line::raw(format!(" {card}  poll gap {gap}  edge to done {done}{unarmed}"))
}

fn times(d: &TimeDistribution) -> String {
    if d.samples == 0 {
        return "-".to_owned();
    }
    format!("p50 {}, p99.99 {}, max {}", time(d.p50), time(d.p9999), time(d.max))
}

fn time(ns: u64) -> String {
    match ns {
        0..1000 => format!("{ns} ns"),
        1000..1_000_000 => format!("{:.1} µs", ns as f64 / 1e3),
        1_000_000.. => format!("{:.1} ms", ns as f64 / 1e6),
    }
}

fn lasted(seconds: f64) -> String {
    let s = seconds as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        3600.. => format!("{} h {} min", s / 3600, s / 60 % 60),
    }
}

fn shortened(name: &str, to: usize) -> String {
    if name.chars().count() <= to {
        return name.to_owned();
    }
    name.chars().take(to - 1).chain(['…']).collect()
}

/// The last values in a number of columns, from 1 (the least) to 8 (the most).
/// A constant value is in the middle.
fn squeezed(values: &VecDeque<f64>, columns: usize) -> Vec<usize> {
    let [least, most] = span(values);
    let level =
        |v: f64| if most > least { (1.0 + (v - least) / (most - least) * 7.0).round() as usize } else { 4 };
    let n = columns.min(values.len());
    (0..n).map(|i| level(values[(i + 1) * values.len() / n - 1])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui_core::backend::TestBackend;
    use ratatui_core::terminal::Terminal;
    use serde_json::Value;

    /// The screen as text, and its cells' colours.
    fn screen(view: &TopScreenState, width: u16, height: u16) -> (String, Vec<Color>) {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| view.draw(frame)).unwrap();
        let buffer = terminal.backend().buffer();
        let row = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
        let rows: Vec<String> = (0..height).map(|y| row(y).trim_end().to_owned() + "\n").collect();
        (rows.concat(), buffer.content().iter().map(|c| c.fg).collect())
    }

    /// The status of the golden files, with other data to match.
    fn view(colour: bool) -> TopScreenState {
        let json = |text| serde_json::from_str::<Value>(text).unwrap();
        let mut seen = json(include_str!("../../../tests/golden/top.json"));
        seen["status"] = json(include_str!("../../../tests/golden/status.json"));
        seen["status"]["uptime_s"] = 4000.into();
        let mut view = TopScreenState::new(colour, Duration::from_millis(500));
        for n in 0..40 {
            seen["explained"][0]["total_um"] = (n - 20).into();
            view.take(serde_json::from_value(seen.clone()).unwrap());
        }
        view
    }

    #[test]
    fn everything_on_a_wide_screen_and_the_most_on_a_small_one() {
        let mut view = view(true);
        crate::golden("top_120x30.txt", &screen(&view, 120, 30).0);
        crate::golden("top_80x24.txt", &screen(&view, 80, 24).0);
        view.help = true;
        crate::golden("top_help.txt", &screen(&view, 80, 24).0);
    }

    #[test]
    fn no_size_is_too_small_to_be_answered() {
        let view = view(true);
        assert!(screen(&view, 59, 16).0.contains("terminal 59x16, needs 60x16"));
        for (width, height) in [(1, 1), (20, 3), (60, 16), (75, 17), (300, 90)] {
            screen(&view, width, height);
        }
        assert!(
            screen(&TopScreenState::new(true, Duration::from_millis(500)), 80, 24)
                .0
                .contains("waiting for the daemon")
        );
    }

    #[test]
    fn a_daemon_that_is_gone_is_said_over_what_was_known_last() {
        let mut view = view(true);
        view.gone("cannot reach rtecd".into());
        let (text, _) = screen(&view, 100, 24);
        assert!(text.contains("NO ANSWER for 0 s; tried every second: cannot reach rtecd"), "{text}");
        assert!(text.contains("position/mm"), "{text}");
        assert!(text.contains("OLD: 0 s"), "{text}");
        view.gone = None;
        assert!(!screen(&view, 100, 24).0.contains("NO ANSWER"));
        // A daemon that no longer answers but is still connected.
        view.heard = Instant::now().checked_sub(Duration::from_secs(5));
        let (text, _) = screen(&view, 80, 24);
        assert!(text.contains("OLD: 5 s") && text.contains("NO ANSWER for 5 s"), "{text}");
    }

    #[test]
    fn colours_are_left_out_where_they_are_not_wanted() {
        let any = |colour| screen(&view(colour), 80, 24).1.iter().any(|c| *c != Color::Reset);
        assert!(any(true));
        assert!(!any(false));
    }

    #[test]
    fn a_trend_is_squeezed_into_its_columns() {
        let rising: VecDeque<f64> = (0..100).map(f64::from).collect();
        let columns = squeezed(&rising, 10);
        assert_eq!((columns.len(), columns[9]), (10, 8));
        assert!(columns.is_sorted());
        assert_eq!(squeezed(&VecDeque::from([3.0, 3.0]), 10), [4, 4]);
        assert!(squeezed(&VecDeque::new(), 10).is_empty());
    }
}
