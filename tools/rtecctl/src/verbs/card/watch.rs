//! `rtecctl card probe --watch`: the input lines live.
//! It shows levels, edges and rates, as halscope and gpiomon do, and whether both edges of each line were
//! seen.

use super::{ProbeArgs, refused, unreachable};
use crate::prelude::*;
use crate::terminal::redraw;
use rtec_control::card_line_readings::{WiredLine, wires};
use rtec_control::card_opening::{self, CardAccess, CardOperation};
use rtec_control::config::Config;
use rtec_driver::card::{AxisLines, Card, CardInputSample};
use rtec_driver::quadrature::{Decoder, Signal, State};

/// Changes of one channel alone after which the other is reported as silent.
/// An axis pushed back and forth across one boundary by hand makes a few.
const ALONE: u64 = 8;

/// Observations of one input line.
#[derive(Debug)]
struct InputLine {
    name: String,
    bit: u8,
    level: bool,
    rises: u64,
    falls: u64,
    /// Edges at the last refresh, and their rate since then.
    before: u64,
    rate_hz: f64,
}

impl InputLine {
    const fn edges(&self) -> u64 {
        self.rises + self.falls
    }

    const fn seen(&self) -> &'static str {
        match (self.rises > 0, self.falls > 0) {
            (true, true) => "both",
            (true, false) => "rose only",
            (false, true) => "fell only",
            (false, false) => "none",
        }
    }
}

/// The two channels of an axis.
#[derive(Debug)]
struct AxisQuadratureChannels {
    name: String,
    lines: AxisLines,
    scale: Decoder,
    up: u64,
    down: u64,
    /// The channel that changed last, and its changes since the other changed.
    alone: Option<(Signal, u64)>,
}

impl AxisQuadratureChannels {
    fn look(&mut self, state: State) {
        let before = self.scale.state();
        if state == before {
            return;
        }
        match self.scale.update(state) {
            Some(step) => {
                *(if step > 0 { &mut self.up } else { &mut self.down }) += 1;
                let signal = before.signal_to(state);
                self.alone = Some(match self.alone {
                    Some((same, times)) if same == signal => (same, times + 1),
                    _ => (signal, 1),
                });
            }
            None => self.alone = None,
        }
    }

    /// A finding about the axis as a whole.
    fn finding(&self) -> String {
        let silent = |signal| if signal == Signal::A { ("a", "b") } else { ("b", "a") };
        match self.alone {
            None if self.scale.illegal() == 0 => "nothing has changed: push the axis by hand".to_owned(),
            Some((signal, times)) if times >= ALONE => {
                let (lively, dead) = silent(signal);
                format!("{lively} has changed {times} times and {dead} has not: look at the wires of {dead}")
            }
            _ if self.scale.illegal() > 0 => {
                "a and b changed at once: too fast for these looks, or noise".to_owned()
            }
            _ => "a and b take turns".to_owned(),
        }
    }
}

/// Observations of a card's inputs.
#[derive(Debug)]
struct InputMonitor {
    card: String,
    lines: Vec<InputLine>,
    axes: Vec<AxisQuadratureChannels>,
    start_ns: u64,
    last_ns: u64,
    shown_ns: u64,
    looks: u64,
    longest_ns: u64,
}

impl InputMonitor {
    fn new(config: &Config, first: &CardInputSample) -> Self {
        let on = |bit: u8| first.inputs >> bit & 1 == 1;
        let line = |WiredLine { name, bit, .. }: WiredLine| {
            let level = on(bit);
            InputLine { name, bit, level, rises: 0, falls: 0, before: 0, rate_hz: 0.0 }
        };
        let inputs = wires(config).into_iter().filter(|w| !w.output);
        let axes = config.axes.iter().map(|axis| {
            let lines = axis.engine.lines;
            let scale = Decoder::new(lines.scale(first.inputs));
            AxisQuadratureChannels { name: axis.name.clone(), lines, scale, up: 0, down: 0, alone: None }
        });
        Self {
            card: config.card.named(),
            lines: inputs.map(line).collect(),
            axes: axes.collect(),
            start_ns: first.t_ns,
            last_ns: first.t_ns,
            shown_ns: first.t_ns,
            looks: 1,
            longest_ns: 0,
        }
    }

    fn look(&mut self, sample: &CardInputSample) {
        self.looks += 1;
        self.longest_ns = self.longest_ns.max(sample.t_ns - self.last_ns);
        self.last_ns = sample.t_ns;
        for line in &mut self.lines {
            let level = sample.inputs >> line.bit & 1 == 1;
            if level != line.level {
                *(if level { &mut line.rises } else { &mut line.falls }) += 1;
                line.level = level;
            }
        }
        for axis in &mut self.axes {
            axis.look(axis.lines.scale(sample.inputs));
        }
    }

    /// Computes the rates since the last refresh.
    fn rate(&mut self) {
        let seconds = (self.last_ns - self.shown_ns) as f64 * 1e-9;
        self.shown_ns = self.last_ns;
        for line in &mut self.lines {
            let edges = line.edges();
            line.rate_hz = if seconds > 0.0 { (edges - line.before) as f64 / seconds } else { 0.0 };
            line.before = edges;
        }
    }

    fn picture(&self) -> String {
        let Self { card, looks, .. } = self;
        let seconds = (self.last_ns - self.start_ns) as f64 * 1e-9;
        let longest_us = self.longest_ns as f64 / 1e3;
        let mut out = format!("{card}: {seconds:.1} s, {looks} looks, at most {longest_us:.1} µs apart\n");
        out += "line             bit level        edges    edges/s  edges seen\n";
        for line in &self.lines {
            let InputLine { name, bit, rate_hz, .. } = line;
            let (level, edges, seen) = (u8::from(line.level), line.edges(), line.seen());
            let _ = writeln!(out, "{name:<16} {bit:>3} {level:>5} {edges:>12} {rate_hz:>10.0}  {seen}");
        }
        for axis in &self.axes {
            let AxisQuadratureChannels { name, up, down, .. } = axis;
            let (count, illegal, finding) = (axis.scale.count(), axis.scale.illegal(), axis.finding());
            let _ = writeln!(
                out,
                "axis {name}: at {count:+} counts, {up} up, {down} down, {illegal} illegal; {finding}"
            );
        }
        out
    }

    fn document(&self) -> Value {
        let lines = self.lines.iter().map(|l| {
            json!({"line": l.name, "bit": l.bit, "level": u8::from(l.level), "rises": l.rises, "falls": l.falls,
                   "edges_seen": l.seen()})
        });
        let axes = self.axes.iter().map(|a| {
            json!({"axis": a.name, "counts": a.scale.count(), "up": a.up, "down": a.down, "illegal": a.scale.illegal(),
                   "finding": a.finding()})
        });
        json!({
            "card": self.card, "duration_ns": self.last_ns - self.start_ns, "looks": self.looks,
            "longest_gap_ns": self.longest_ns, "lines": lines.collect::<Vec<_>>(), "axes": axes.collect::<Vec<_>>(),
        })
    }
}

/// The watch, for a card of any backend.
struct WatchOperation<'a> {
    config: &'a Config,
    args: &'a ProbeArgs,
}

impl CardOperation for WatchOperation<'_> {
    type Output = anyhow::Result<()>;

    fn on<C: Card + Send + 'static>(self, mut card: C) -> Self::Output {
        let &ProbeArgs { every, during, json, .. } = self.args;
        let first = card.sample(0).map_err(unreachable)?;
        let mut watch = InputMonitor::new(self.config, &first);
        let end_ns = during.map_or(u64::MAX, |d| first.t_ns.saturating_add(d.as_nanos() as u64));
        let every_ns = every.as_nanos() as u64;
        let mut next_ns = first.t_ns + every_ns;
        while watch.last_ns < end_ns {
            let sample = card.sample(next_ns.min(end_ns)).map_err(unreachable)?;
            watch.look(&sample);
            if sample.t_ns < next_ns && sample.t_ns < end_ns {
                continue;
            }
            next_ns = sample.t_ns + every_ns;
            watch.rate();
            if !json && !redraw(&watch.picture(), true)? {
                return Ok(());
            }
        }
        if json { say_pretty(&watch.document()) } else { Ok(()) }
    }
}

/// Watches the inputs of the configured card. Nothing is written.
///
/// # Errors
/// When the card cannot be opened, or has no lines outside the daemon.
pub(super) fn watch(config: &Config, args: &ProbeArgs) -> anyhow::Result<()> {
    card_opening::with(&config.card, CardAccess::Read, WatchOperation { config, args })
        .map_err(|e| refused(config, e))?
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const CONFIG: &str =
        "[machine]\nname = 'm'\n[card]\nbackend = 'mapped'\nfile = 'registers'\nprobe = 'in28'\nAXES";
    const AXIS: &str = "[[axis]]\nname = 'NAME'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 100\nwindow_counts = 50\n\
        min_separation_ns = 500\nmax_accel_mm_s2 = 1000.0\nlines = { a = A, b = B, invert_a = A, invert_b = B }\n";

    fn config() -> Config {
        let axis = |(n, name): (usize, &str)| {
            let (a, b) = (2 * n, 2 * n + 1);
            AXIS.replace("NAME", name).replace("= A", &format!("= {a}")).replace("= B", &format!("= {b}"))
        };
        let axes: String = ["x", "y", "z", "w"].into_iter().enumerate().map(axis).collect();
        Config::parse(Path::new("rtec.toml"), &CONFIG.replace("AXES", &axes)).unwrap()
    }

    /// x moves; y has one channel only; z is at rest; w changes both channels at once.
    /// The probe rises. 1 ms per look, two refreshes.
    #[test]
    fn shows_levels_edges_rates_and_silent_channels() {
        let config = config();
        let at = |n: u64| {
            let x = [0b00, 0b01, 0b11, 0b10][(n % 4) as usize];
            let (y, w) = ((n % 2) << 2, if n > 100 { 0b11 << 6 } else { 0 });
            let probe = if n > 50 { 1 << 28 } else { 0 };
            CardInputSample::level(1_000_000 * (n + 1), x | y | w | probe)
        };
        let mut watch = InputMonitor::new(&config, &at(0));
        let mut pictures = String::new();
        for n in 1..=400 {
            watch.look(&at(n));
            if n % 200 == 0 {
                watch.rate();
                pictures += &watch.picture();
            }
        }
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/card/watch.txt");
        test_needs::golden(&golden, &pictures);
        let document = watch.document();
        assert_eq!((&document["looks"], &document["longest_gap_ns"]), (&401.into(), &1_000_000.into()));
        assert_eq!(document["lines"][0]["edges_seen"], "both");
        assert_eq!(
            document["axes"][1]["finding"],
            "a has changed 400 times and b has not: look at the wires of b"
        );
    }
}
