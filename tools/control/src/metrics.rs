//! The status as `OpenMetrics` 1.0 text and Prometheus text 0.0.4.
//!
//! Names are `rtec_…`, in base units (seconds, metres, degrees Celsius) and in counts where the machine
//! counts. A value that is one of several (mode, fault, state of a sensor) has one series for each, 0 or 1. A
//! rule thus needs no text. The two formats differ in the names of counters' families, in the type `info` and
//! in the last line.

use crate::protocol::{AuditLogState, AxisReport, DaemonSnapshot, DaemonStatus, RtStatus, word};
use rtec_rt::link_messages::Fault;
use std::fmt::Write as _;

/// A text format for metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MetricsFormat {
    /// `OpenMetrics` 1.0.
    OpenMetrics,
    /// Prometheus' own format, 0.0.4, which textfile collectors read.
    Prometheus,
}

impl MetricsFormat {
    /// Content type of an HTTP answer in this form.
    pub const fn content_type(self) -> &'static str {
        match self {
            Self::OpenMetrics => "application/openmetrics-text; version=1.0.0; charset=utf-8",
            Self::Prometheus => "text/plain; version=0.0.4; charset=utf-8",
        }
    }

    /// The form that an HTTP request's `Accept` asks for.
    pub fn accepted(accept: &str) -> Self {
        if accept.contains("application/openmetrics-text") { Self::OpenMetrics } else { Self::Prometheus }
    }
}

const MODES: [&str; 6] = ["run", "shadow", "probe", "hold", "fault", "disabled"];
const SENSOR_STATES: [&str; 3] = ["good", "frozen", "hold"];
/// Units that a family's name may end in, as `OpenMetrics` names them.
const UNITS: [&str; 4] = ["seconds", "meters", "celsius", "hertz"];

/// Metrics of an observation of the daemon.
/// Without one they state that the daemon does not answer. `by` is the version of the program that writes
/// them.
pub fn text(seen: Option<&DaemonSnapshot>, form: MetricsFormat, by: &str) -> String {
    let mut out = MetricsText { text: String::new(), form };
    out.gauge("rtec_up", "1 while the daemon answers", [(vec![], flag(seen.is_some()))]);
    out.info("rtec_exporter", "The program that wrote these metrics", &[("version", by)]);
    if let Some(seen) = seen {
        let s = &seen.status;
        machine(&mut out, s);
        axes(&mut out, s);
        faults(&mut out, s);
        thread(&mut out, s);
        times(&mut out, seen);
        sensors(&mut out, s);
        model(&mut out, s);
        record(&mut out, &seen.log);
        let clients = seen.clients.iter().map(|c| (vec![("role", c.role.word())], c.connected as f64));
        out.gauge("rtec_clients", "Connections to the daemon, by role", clients);
    }
    if form == MetricsFormat::OpenMetrics {
        out.text.push_str("# EOF\n");
    }
    out.text
}

type Labels<'a> = Vec<(&'a str, &'a str)>;

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

fn machine(out: &mut MetricsText, s: &DaemonStatus) {
    let protocol = s.protocol.to_string();
    out.info(
        "rtec_build",
        "The daemon: its version, its protocol, its card",
        &[("version", &s.version), ("protocol", &protocol), ("card", &s.rt.card)],
    );
    out.info("rtec_machine", "The machine, as the configuration names it", &[("name", &s.machine)]);
    out.gauge("rtec_uptime_seconds", "Time since the daemon's start", [(vec![], s.uptime_s)]);
    let modes = MODES.map(|m| (vec![("mode", m)], flag(s.mode == m)));
    out.gauge("rtec_mode", "1 for the mode that the corrector is in", modes);
    out.gauge("rtec_homed", "1 when every axis is homed", [(vec![], flag(s.homed))]);
    let help =
        "1 while counts to the controller minus counts of the scale are what was completed, on every axis";
    // Absent while there is no ledger, so that an alert on 0 means counts that do not balance.
    let ledger = s.ledger_known().then(|| (vec![], flag(s.balanced)));
    out.gauge("rtec_ledger_balanced", help, ledger);
    out.gauge(
        "rtec_part_table_loaded",
        "1 while a part table is loaded",
        [(vec![], flag(s.table.is_some()))],
    );
}

/// A metric of `T`: kind, name, help, value.
type Metric<T> = (&'static str, &'static str, &'static str, fn(&T) -> f64);

#[rustfmt::skip] // a metric a line
const AXIS: [Metric<AxisReport>; 13] = [
    ("gauge", "rtec_axis_homed", "1 when the axis is homed", |a| flag(a.homed)),
    ("gauge", "rtec_position_meters", "Position by the scale since homing", |a| a.position_mm / 1000.0),
    ("gauge", "rtec_requested_counts", "Total correction that was accepted, counts since homing", |a| a.requested as f64),
    ("gauge", "rtec_completed_counts", "Inserted, counts since homing; in shadow mode what would have been", |a| a.completed as f64),
    ("gauge", "rtec_in_effect_counts", "What is really in the controller's count, counts", |a| a.in_effect as f64),
    ("gauge", "rtec_max_correction_counts", "Largest total that is accepted, counts", |a| a.max_correction_counts as f64),
    ("gauge", "rtec_edge_rate_hertz", "Edges of the scale a second", |a| a.edge_rate_hz),
    ("counter", "rtec_insertions_total", "Insertions since the daemon's start", |a| a.insertions as f64),
    ("counter", "rtec_gate_waits_total", "Edges at which a correction was pending and the speed gate shut", |a| a.waited_for_gate as f64),
    ("counter", "rtec_overlaps_total", "Edges that fell into an insertion, with a certain outcome", |a| a.overlaps as f64),
    ("counter", "rtec_late_total", "Insertions given up because the process looked too late", |a| a.late as f64),
    ("counter", "rtec_illegal_transitions_total", "Illegal transitions of the scale", |a| a.illegal as f64),
    ("counter", "rtec_beyond_limits_total", "Edges that came sooner than the axis's limits allow, on a polled card", |a| a.beyond_limits as f64),
];

fn axes(out: &mut MetricsText, s: &DaemonStatus) {
    for (kind, name, help, value) in AXIS {
        out.family(kind, name, help, s.axes.iter().map(|a| (vec![("axis", a.name.as_str())], value(a))));
    }
}

fn faults(out: &mut MetricsText, s: &DaemonStatus) {
    let words = Fault::ALL.map(word);
    let mut latched = Vec::new();
    for (fault, word) in Fault::ALL.iter().zip(&words) {
        // Faults of the machine have an empty axis label, which counts as none.
        latched.push((vec![("axis", ""), ("fault", word.as_str())], flag(s.faults.contains(fault))));
        for axis in &s.axes {
            let labels = vec![("axis", axis.name.as_str()), ("fault", word.as_str())];
            latched.push((labels, flag(axis.faults.contains(fault))));
        }
    }
    out.gauge("rtec_fault_latched", "1 while this fault is latched; the machine's own have no axis", latched);
    let count = |word: &String| s.latched.get(word).copied().unwrap_or(0) as f64;
    let counts = words.iter().map(|w| (vec![("fault", w.as_str())], count(w)));
    let help = "How often each fault was latched since the daemon's start";
    out.family("counter", "rtec_faults_total", help, counts);
}

#[rustfmt::skip] // a metric a line
const THREAD: [Metric<RtStatus>; 8] = [
    ("gauge", "rtec_thread_alive", "1 while the real-time thread runs", |rt| flag(rt.alive)),
    ("gauge", "rtec_may_arm", "1 when corrections may be enabled on this card with this set-up", |rt| flag(rt.may_arm)),
    ("gauge", "rtec_control_stale", "1 while the control side is silent and corrections are frozen", |rt| flag(rt.control_stale)),
    ("gauge", "rtec_disable_switch", "1 while the hardware disable switch is on", |rt| flag(rt.disable_switch)),
    ("gauge", "rtec_settings_missing", "Real-time settings that are not as they should be", |rt| rt.missing.len() as f64),
    ("counter", "rtec_looks_total", "Looks at the card", |rt| rt.polls as f64),
    ("counter", "rtec_events_lost_total", "Events that found the ring full", |rt| rt.events_lost as f64),
    ("gauge", "rtec_poll_gap_max_seconds", "Longest time between two looks", |rt| rt.poll_gap_ns.max as f64 * 1e-9),
];

fn thread(out: &mut MetricsText, s: &DaemonStatus) {
    for (kind, name, help, value) in THREAD {
        out.family(kind, name, help, [(vec![], value(&s.rt))]);
    }
}

fn times(out: &mut MetricsText, seen: &DaemonSnapshot) {
    let h = &seen.histograms;
    let help = "Time between two looks at the card";
    out.histogram("rtec_poll_gap_seconds", help, &h.poll_gap_ns, h.poll_gap_sum_ns);
    let help = "Time from an edge to the end of the insertion that it opened";
    out.histogram("rtec_edge_to_done_seconds", help, &h.edge_to_done_ns, h.edge_to_done_sum_ns);
}

/// Metrics of the record of commands.
fn record(out: &mut MetricsText, log: &AuditLogState) {
    let lost = [(vec![], log.lost as f64)];
    out.family("counter", "rtec_commands_not_recorded_total", "Commands that could not be recorded", lost);
    let trouble = [(vec![], flag(log.trouble.is_some()))];
    out.gauge("rtec_record_trouble", "1 while the record of commands cannot be written", trouble);
}

fn sensors(out: &mut MetricsText, s: &DaemonStatus) {
    if s.sensors.is_empty() {
        return;
    }
    let named = |value: fn(&crate::protocol::SensorStateReport) -> Option<f64>| {
        let all = s.sensors.iter().filter_map(move |r| Some((r, value(r)?)));
        all.map(|(r, v)| (vec![("sensor", r.sensor.as_str())], v))
    };
    out.gauge("rtec_sensor_celsius", "A sensor's last good value", named(|r| r.degc));
    out.gauge("rtec_sensor_age_seconds", "The age of a sensor's last good value", named(|r| r.age_s));
    let states = s.sensors.iter().flat_map(|r| {
        let of = |state| (vec![("sensor", r.sensor.as_str()), ("state", state)], flag(r.state == state));
        SENSOR_STATES.map(of)
    });
    let help = "1 for the state of a sensor: good, frozen (its last good value is used instead), hold";
    out.gauge("rtec_sensor_state", help, states);
}

fn model(out: &mut MetricsText, s: &DaemonStatus) {
    let loaded = flag(s.model.is_some());
    out.gauge("rtec_model_loaded", "1 while a machine model runs", [(vec![], loaded)]);
    let Some(m) = &s.model else { return };
    let labels = [("name", m.name.as_str()), ("sha256", m.sha256.as_str())];
    out.info("rtec_model", "The machine model that runs: its name, and the hash of its file", &labels);
    let seconds = |days: Option<i64>| days.map(|d| (vec![], d as f64 * 86_400.0));
    out.gauge("rtec_model_age_seconds", "Time since its oldest fit, whole days", seconds(m.age_days));
    let help = "Time until the first of its fits ends, whole days; below zero when it has";
    out.gauge("rtec_model_validity_seconds", help, seconds(m.days_left));
}

struct MetricsText {
    text: String,
    form: MetricsFormat,
}

impl MetricsText {
    fn gauge<'a>(&mut self, name: &str, help: &str, samples: impl IntoIterator<Item = (Labels<'a>, f64)>) {
        self.family("gauge", name, help, samples);
    }

    /// Writes a family of gauges or counters; one without samples is left out.
    fn family<'a>(
        &mut self,
        kind: &str,
        name: &str,
        help: &str,
        samples: impl IntoIterator<Item = (Labels<'a>, f64)>,
    ) {
        let mut samples = samples.into_iter().peekable();
        if samples.peek().is_none() {
            return;
        }
        self.head(name, kind, help);
        for (labels, value) in samples {
            self.sample(name, &labels, &number(value));
        }
    }

    fn info(&mut self, name: &str, help: &str, labels: &[(&str, &str)]) {
        let sample = format!("{name}_info");
        match self.form {
            MetricsFormat::OpenMetrics => self.head(name, "info", help),
            MetricsFormat::Prometheus => self.head(&sample, "gauge", help),
        }
        self.sample(&sample, labels, "1");
    }

    /// Writes a histogram from buckets `[low, high, count]`, ns.
    fn histogram(&mut self, name: &str, help: &str, buckets: &[[u64; 3]], sum_ns: u64) {
        self.head(name, "histogram", help);
        let bucket = format!("{name}_bucket");
        for (le_ns, count) in cumulative(buckets) {
            self.sample(&bucket, &[("le", &number(le_ns as f64 / 1e9))], &count.to_string());
        }
        let all: u64 = buckets.iter().map(|[_, _, count]| count).sum();
        self.sample(&bucket, &[("le", "+Inf")], &all.to_string());
        self.sample(&format!("{name}_sum"), &[], &number(sum_ns as f64 / 1e9));
        self.sample(&format!("{name}_count"), &[], &all.to_string());
    }

    fn head(&mut self, name: &str, kind: &str, help: &str) {
        let open = self.form == MetricsFormat::OpenMetrics;
        let family = if open && kind == "counter" { name.trim_end_matches("_total") } else { name };
        // Writing to a String does not fail.
        let _ = writeln!(self.text, "# HELP {family} {help}");
        let _ = writeln!(self.text, "# TYPE {family} {kind}");
        let unit = UNITS.iter().find(|u| family.strip_suffix(**u).is_some_and(|rest| rest.ends_with('_')));
        if let Some(unit) = unit.filter(|_| open) {
            let _ = writeln!(self.text, "# UNIT {family} {unit}");
        }
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: &str) {
        self.text.push_str(name);
        for (n, (label, text)) in labels.iter().enumerate() {
            let text = text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
            let _ = write!(self.text, "{}{label}=\"{text}\"", if n == 0 { '{' } else { ',' });
        }
        let _ = writeln!(self.text, "{} {value}", if labels.is_empty() { "" } else { "}" });
    }
}

/// Number of values up to each bound: 31 ns to 0.8 s, two bounds an octave.
/// Each bound is the highest value of one of the engine's buckets, so the counts are exact.
fn cumulative(buckets: &[[u64; 3]]) -> impl Iterator<Item = (u64, u64)> {
    let bounds = (5..30).flat_map(|octave| [(1_u64 << octave) - 1, (3_u64 << (octave - 1)) - 1]);
    bounds.map(|le| (le, buckets.iter().filter(|[_, high, _]| *high <= le).map(|[_, _, count]| count).sum()))
}

/// A number for both formats: the shortest text that reads back equal.
/// Small numbers have an exponent of two digits.
fn number(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-4 {
        let text = format!("{value:e}");
        if let Some((mantissa, exponent)) = text.split_once("e-") {
            return format!("{mantissa}e-{exponent:0>2}");
        }
    }
    format!("{value}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_back() {
        for (value, text) in [
            (0.0, "0"),
            (1.27e-7, "1.27e-07"),
            (-3.1e-8, "-3.1e-08"),
            (12.5, "12.5"),
            (1e21, "1000000000000000000000"),
        ] {
            assert_eq!(number(value), text);
            assert_eq!(text.parse::<f64>(), Ok(value));
        }
    }

    /// Counted one by one, in the buckets of the engine's own histogram.
    #[test]
    fn cumulative_counts_are_exact() {
        let values: Vec<u64> = (0..4000).map(|n| n * n * 71 % 3_000_017).collect();
        let (mut recorder, reader) = rtec_rt::latency_histogram::histogram();
        for v in &values {
            recorder.record(*v);
        }
        let buckets: Vec<_> = reader.snapshot().buckets().map(|b| [b.low, b.high, b.count]).collect();
        let found: Vec<_> = cumulative(&buckets).collect();
        assert_eq!((found.len(), found[0].0, found[49].0), (50, 31, (3 << 28) - 1));
        assert!(found.is_sorted());
        for (le, count) in found {
            assert_eq!(count, values.iter().filter(|v| **v <= le).count() as u64, "up to {le} ns");
        }
    }

    #[test]
    fn a_silent_daemon_is_a_metric_too() {
        let text = text(None, MetricsFormat::OpenMetrics, "0.1.0");
        assert!(text.contains("\nrtec_up 0\n") && text.ends_with("# EOF\n"), "{text}");
    }

    #[test]
    fn labels_are_quoted() {
        let mut out = MetricsText { text: String::new(), form: MetricsFormat::Prometheus };
        out.info("rtec_machine", "h", &[("name", "a \"b\"\\\nc")]);
        assert!(out.text.ends_with("rtec_machine_info{name=\"a \\\"b\\\"\\\\\\nc\"} 1\n"), "{}", out.text);
    }
}
