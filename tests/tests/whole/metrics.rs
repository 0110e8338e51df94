//! Metrics of a real `rtecd`, judged by other programs.
//!
//! The judges are promtool, the Python client's strict `OpenMetrics` parser, and a Prometheus that scrapes them and
//! fires our rules.

use rtec_tests::daemon::{Daemon, among_others, program, until};
use rtec_tests::{root, skipped};
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A program that runs beside the test and ends with it.
struct ChildProgram(Child);

impl ChildProgram {
    fn spawn(command: &mut Command) -> Self {
        Self(command.spawn().unwrap_or_else(|e| panic!("{command:?}: {e}")))
    }
}

impl Drop for ChildProgram {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn there(program: &str, package: &str) -> bool {
    let there = Command::new(program).arg("--version").output().is_ok();
    if !there {
        skipped(&format!("no {program} (Debian: {package})"));
    }
    there
}

/// A free port.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// The head (status line and headers) and the body of an answer.
fn exchange(mut stream: impl Read + Write, request: &str) -> std::io::Result<(String, String)> {
    stream.write_all(request.as_bytes())?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    Ok((head.to_owned(), body.to_owned()))
}

fn get(port: u16, path: &str, accept: &str) -> std::io::Result<(String, String)> {
    let request =
        format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nAccept: {accept}\r\nConnection: close\r\n\r\n");
    exchange(TcpStream::connect(("127.0.0.1", port))?, &request)
}

fn fed(command: &mut Command, text: &str) -> (bool, String) {
    let mut child =
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let out = child.wait_with_output().unwrap();
    let said = [out.stdout, out.stderr].concat();
    (out.status.success(), String::from_utf8(said).unwrap())
}

/// The strict parser of Prometheus' own Python client.
/// It prints every family's name, and every sample as `NAME{LABELS} VALUE`.
const PARSE: &str = "
import sys
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse
for family in parse(sys.stdin.read()):
    print('family', family.name, family.type, family.unit)
    for s in family.samples:
        labels = ','.join(f'{k}={v}' for k, v in sorted(s.labels.items()))
        print(f'{s.name}{{{labels}}} {float(s.value)}')
";

fn metrics(socket: &Path) -> Command {
    let mut command = Command::new(program("rtecctl"));
    command.arg("metrics").arg("--socket").arg(socket);
    command
}

#[test]
fn judges_read_both_forms_and_find_the_same_as_in_the_status() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    daemon.expect(0, &["correct", "x", "-12"]);
    until("completed", || daemon.status()["axes"][0]["completed"] == -12);
    let plain = daemon.expect(0, &["metrics"]);
    let open = daemon.expect(0, &["metrics", "--openmetrics"]);
    let status = daemon.status();

    if there("promtool", "prometheus") {
        assert_eq!(
            fed(Command::new("promtool").args(["check", "metrics"]), &plain),
            (true, String::new()),
            "{plain}"
        );
        // The judge finds a mistake.
        let (good, said) = fed(
            Command::new("promtool").args(["check", "metrics"]),
            &plain.replace("# HELP rtec_insertions_total", "# nothing"),
        );
        assert!(!good && said.contains("rtec_insertions_total"), "{said}");
    }
    let python = "/usr/bin/python3";
    if fed(Command::new(python).args(["-c", PARSE]), "# EOF\n").0 {
        let (good, read) = fed(Command::new(python).args(["-c", PARSE]), &open);
        assert!(good, "{read}");
        for wanted in [
            "family rtec_insertions counter ",
            "family rtec_poll_gap_seconds histogram seconds",
            "family rtec_build info ",
            "rtec_mode{mode=run} 1.0",
            "rtec_mode{mode=fault} 0.0",
            "rtec_requested_counts{axis=x} -12.0",
            "rtec_completed_counts{axis=x} -12.0",
            "rtec_insertions_total{axis=x} 6.0",
            "rtec_beyond_limits_total{axis=x} 0.0",
            "rtec_fault_latched{axis=x,fault=still_not_believed} 0.0",
            "rtec_fault_latched{axis=,fault=poll_gap} 0.0",
            "rtec_model_loaded{} 0.0",
            "rtec_up{} 1.0",
        ] {
            assert!(read.lines().any(|l| l == wanted), "no {wanted:?} in {read}");
        }
        // Buckets are cumulative, and the last one holds all values. Edge to done was measured once an insertion.
        let value = |line: &str| line.rsplit(' ').next().unwrap().parse::<f64>().unwrap();
        let done: Vec<f64> =
            (read.lines()).filter(|l| l.starts_with("rtec_edge_to_done_seconds_bucket")).map(value).collect();
        assert!(done.is_sorted() && done.len() > 40, "{done:?}");
        let insertions = status["axes"][0]["insertions"].as_f64().unwrap();
        assert!(done.last().is_some_and(|all| (1.0..=insertions).contains(all)), "{done:?}");
        // The strict parser accepts only one of the two forms.
        assert!(!fed(Command::new(python).args(["-c", PARSE]), &plain).0, "0.0.4 read as OpenMetrics");
    } else {
        skipped("no Python client (Debian: python3-prometheus-client)");
    }
    drop(daemon);
    assert_eq!(metrics(&socket).output().unwrap().status.code(), Some(3));
}

#[test]
fn a_collector_finds_a_whole_file_even_when_the_daemon_is_gone() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let file = directory.path().join("rtec.prom");
    let name = file.to_str().unwrap().to_owned();
    let daemon = Daemon::start(&socket, None);
    daemon.expect(0, &["metrics", "--textfile", &name]);
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains("\nrtec_up 1\n") && text.ends_with('\n'), "{text}");
    assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o644);
    assert_eq!(
        std::fs::read_dir(directory.path())
            .unwrap()
            .filter(|f| { f.as_ref().unwrap().file_name().to_string_lossy().starts_with("rtec.prom") })
            .count(),
        1
    );
    let said = daemon.expect(2, &["metrics", "--textfile", "/tmp/rtec.txt"]);
    assert!(said.contains("ends in .prom"), "{said}");
    drop(daemon);
    let run = metrics(&socket).args(["--textfile", &name]).output().unwrap();
    assert_eq!(run.status.code(), Some(3));
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains("\nrtec_up 0\n") && !text.contains("rtec_mode"), "{text}");
}

#[test]
fn served_is_metrics_only_on_loopback_or_a_socket() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::start(&socket, None);
    let port = free_port();
    let said = daemon.expect(2, &["metrics", "--listen", &format!("0.0.0.0:{port}")]);
    assert!(said.contains("--beyond-loopback") && said.contains("0.0.0.0"), "{said}");
    assert!(daemon.expect(2, &["metrics", "--listen", "localhost"]).contains("expected ADDRESS:PORT"));
    assert!(daemon.expect(2, &["metrics", "--json"]).contains("rtecctl status --json"));
    let _server = ChildProgram::spawn(metrics(&socket).args(["--listen", &format!("127.0.0.1:{port}")]));
    until("served", || get(port, "/metrics", "*/*").is_ok());
    let (head, body) = get(port, "/metrics", "application/openmetrics-text;version=1.0.0,*/*").unwrap();
    assert!(head.starts_with("HTTP/1.1 200") && head.contains("application/openmetrics-text; version=1.0.0"));
    assert!(body.contains("# EOF"), "{body}");
    let (head, body) = get(port, "/metrics", "text/plain").unwrap();
    assert!(head.contains("text/plain; version=0.0.4") && !body.contains("# EOF"), "{head}");
    assert!(get(port, "/", "*/*").unwrap().0.starts_with("HTTP/1.1 404"));
    let post = "POST /metrics HTTP/1.1\r\nHost: x\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
    let (head, _) = exchange(TcpStream::connect(("127.0.0.1", port)).unwrap(), post).unwrap();
    assert!(head.starts_with("HTTP/1.1 405"), "{head}");
    // Slow clients, and a client that announces a long request, hold nobody up.
    let slow: Vec<_> = (0..300)
        .map(|n| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            let heads =
                ["GET /metrics HTT", "POST /metrics HTTP/1.1\r\nContent-Length: 999999999999999\r\n\r\n{"];
            stream.write_all(heads[n % 2].as_bytes()).unwrap();
            stream
        })
        .collect();
    assert!(get(port, "/metrics", "text/plain").unwrap().1.contains("\nrtec_up 1\n"));
    drop(slow);
    // A port in use gives exit code 1. A socket works like a port, and replaces an old one.
    daemon.expect(1, &["metrics", "--listen", &format!("127.0.0.1:{port}")]);
    let at = directory.path().join("metrics.sock");
    let listen = || ChildProgram::spawn(metrics(&socket).arg("--listen").arg(&at));
    let request = "GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n";
    let read = || UnixStream::connect(&at).and_then(|s| exchange(s, request));
    drop({
        let first = listen();
        until("served at a socket", || read().is_ok());
        first
    });
    let _again = listen();
    until("served again", || read().is_ok());
    assert!(read().unwrap().1.contains("\nrtec_up 1\n"));
    assert_eq!(std::fs::metadata(&at).unwrap().permissions().mode() & 0o777, 0o660);
    // The daemon restarts, and its readers stay connected.
    drop(daemon);
    assert!(get(port, "/metrics", "*/*").unwrap().1.contains("\nrtec_up 0\n"));
    let _daemon = Daemon::start(&socket, None);
    assert!(get(port, "/metrics", "*/*").unwrap().1.contains("\nrtec_up 1\n"));
}

/// Queries Prometheus' API; returns the values that it finds.
fn query(port: u16, expression: &str) -> Vec<String> {
    let encoded = expression.bytes().fold(String::new(), |mut text, b| {
        write!(text, "%{b:02X}").unwrap();
        text
    });
    let Ok((_, body)) = get(port, &format!("/api/v1/query?query={encoded}"), "*/*") else {
        return Vec::new();
    };
    // Chunked or not, the document is the line that begins with a brace.
    let document = body.lines().find(|l| l.starts_with('{')).unwrap_or("{}");
    let answer: Value = serde_json::from_str(document).unwrap_or_default();
    let found = answer["data"]["result"].as_array().cloned().unwrap_or_default();
    found.iter().map(|r| r["value"][1].as_str().unwrap_or_default().to_owned()).collect()
}

/// Names of the shipped alerts, in order.
fn alerts(rules: &str) -> Vec<&str> {
    rules.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).collect()
}

/// Every shipped rule fires with its cause, and is quiet before and after.
/// The samples are in `metrics/alerts.yml`.
#[test]
fn every_shipped_rule_fires_and_is_quiet() {
    if !test_needs::long() {
        return;
    }
    if !there("promtool", "prometheus") {
        return;
    }
    let (shipped, samples) =
        (root().join("udev/plant/rtec-alerts.yml"), root().join("tests/tests/whole/metrics/alerts.yml"));
    let rules = std::fs::read_to_string(&shipped).unwrap();
    let cases = std::fs::read_to_string(&samples).unwrap();
    assert!(alerts(&rules).len() >= 10, "{rules}");
    for alert in alerts(&rules) {
        let quiet = cases.matches(&format!("{{alertname: {alert}, eval_time: ")).count();
        let fires = cases.matches(&format!("- alertname: {alert}\n")).count();
        assert!(quiet >= 2 && fires >= 1, "{alert}: shown to be quiet {quiet} times, to fire {fires} times");
    }
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("alerts.yml"), cases.replace("../../../udev/plant/", "")).unwrap();
    let judge = |rules: &str| {
        std::fs::write(at("rtec-alerts.yml"), rules).unwrap();
        fed(Command::new("promtool").args(["test", "rules"]).arg(at("alerts.yml")), "")
    };
    let (good, said) = judge(&rules);
    assert!(good, "{said}");
    // The samples distinguish every rule from one that never fires, and from one that always fires.
    for always in ["vector(0) > 1", "vector(1)"] {
        let wrong = rules.lines().map(|line| match line.find("expr: ") {
            Some(at) => format!("{}expr: {always}\n", &line[..at]),
            None => format!("{line}\n"),
        });
        let (good, said) = judge(&wrong.collect::<String>());
        assert!(!good, "{always} passes");
        for alert in alerts(&rules) {
            assert!(said.contains(&format!("alertname: {alert}, ")), "{alert}: {always} passes: {said}");
        }
    }
}

/// Words of the rules' expressions that name metrics.
fn named(rules: &str) -> Vec<&str> {
    let expressions = rules.lines().filter_map(|line| line.trim().strip_prefix("expr: "));
    let words = expressions.flat_map(|e| e.split(|c: char| !c.is_ascii_alphanumeric() && c != '_'));
    words.filter(|word| word.starts_with("rtec_")).collect()
}

#[test]
fn what_the_rules_ask_for_is_there() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let config = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\n\
                  max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[model]\nfile='m.toml'\n\
                  [[sensor]]\nname='T1'\nplace='bed'\nsource='line'\nfrom='/dev/ttyNONE'\nkey='T1'\n";
    std::fs::write(at("rtec.toml"), config).unwrap();
    let model = "name = 'm'\n[[fit]]\nresponse = 'error.x'\ndate = '2026-01-01'\nvalid_until = '2999-01-01'\n\
                 rms_um = 0.1\nhalf_width_um = 0.2\n";
    std::fs::write(at("m.toml"), model).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    daemon.expect(0, &["model", "load", "--yes"]);
    let rules = std::fs::read_to_string(root().join("udev/plant/rtec-alerts.yml")).unwrap();
    let text = daemon.expect(0, &["metrics"]);
    assert!(named(&rules).len() >= 10, "{rules}");
    for name in named(&rules) {
        assert!(text.lines().any(|l| l.starts_with(&format!("# TYPE {name} "))), "no {name} in {text}");
    }
    // With the labels that the rules query.
    assert!(text.contains("rtec_sensor_state{sensor=\"T1\",state=\"good\"} 0\n"), "{text}");
}

#[test]
fn a_prometheus_scrapes_it_and_fires_on_a_latched_fault() {
    if !test_needs::long() {
        return;
    }
    if !there("prometheus", "prometheus") {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    daemon.expect(0, &["correct", "y", "6"]);
    let (port, own) = (free_port(), free_port());
    let _server = ChildProgram::spawn(metrics(&socket).args(["--listen", &format!("127.0.0.1:{port}")]));
    let rules = root().join("udev/plant/rtec-alerts.yml").canonicalize().unwrap();
    let config = directory.path().join("prometheus.yml");
    let text = format!(
        "global: {{scrape_interval: 1s, evaluation_interval: 1s}}\nrule_files: [{}]\nscrape_configs:\n  - job_name: rtec\n    \
         static_configs: [{{targets: ['127.0.0.1:{port}']}}]\n",
        rules.display()
    );
    std::fs::write(&config, text).unwrap();
    let _prometheus = ChildProgram::spawn(
        Command::new("prometheus")
            .arg(format!("--config.file={}", config.display()))
            .arg(format!("--storage.tsdb.path={}", directory.path().join("tsdb").display()))
            .arg(format!("--web.listen-address=127.0.0.1:{own}"))
            .stdout(Stdio::null())
            .stderr(Stdio::null()),
    );
    until("scraped", || query(own, "rtec_completed_counts{axis=\"y\"}") == ["6"]);
    assert_eq!(query(own, "up{job=\"rtec\"}"), ["1"]);
    assert_eq!(query(own, "rtec_mode == 1"), ["1"]);
    until("a rate of looks", || {
        let p99 = query(own, "histogram_quantile(0.99, rate(rtec_poll_gap_seconds_bucket[30s]))");
        p99.first().and_then(|v| v.parse::<f64>().ok()).is_some_and(|v| v > 1e-9 && v < 1.0)
    });
    let firing = "ALERTS{alertname=\"RtecFaultLatched\",alertstate=\"firing\",axis=\"x\",fault=\"still_not_believed\"}";
    assert!(query(own, firing).is_empty());
    for code in [1, 1, 4] {
        daemon.expect(code, &["correct", "x", "900"]);
    }
    until("the alert", || query(own, firing) == ["1"]);
    assert_eq!(query(own, "rtec_faults_total{fault=\"still_not_believed\"}"), ["1"]);
    daemon.expect(0, &["clear"]);
    until("the alert's end", || query(own, firing).is_empty());
}
