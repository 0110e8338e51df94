//! A soak: the daemon on a mapped card with a moving axis.
//!
//! A model whose sensor never stops changing, a part table, clients and a scrape load it. Memory, descriptors, threads
//! and latencies over time are printed, as CSV and as plots.
//!
//! `cargo bench -p rtec-tests --bench soak [-- MINUTES]`, three minutes by default. `target/soak/` gets `soak.csv` and
//! the plots. It fails where a count is lost, the MTC sees an illegal state, a fault is latched or the daemon ends.
//! Growth of memory and descriptors is left to the reader to judge.

use anyhow::{Context, ensure};
use rtec_measure::plot::{Chart, Series, Style};
use rtec_tests::clients::{Clients, Exporter};
use rtec_tests::daemon::{Bench, Daemon, until};
use rtec_tests::sensors::Sensors;
use std::fmt::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

const CLIENTS: usize = 10;
/// Rows of the table, whatever the soak's length.
const ROWS: u32 = 60;
/// An axis at rest, which gives a part its place.
const Z: &str = "[[axis]]\nname = 'z'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\nwindow_counts = 50\n\
    min_separation_ns = 40000000\nmax_accel_counts_s2 = 9\nhysteresis_counts = 0.2\n\
    lines = { a = 'in4', b = 'in5', invert_a = 'out2', invert_b = 'out3' }\n";
/// Errors of a cylinder at the machine's place: 3 µm at X.
const CYLINDER: &str = "1.570796 3 -10 -10 0\n1.570796 3 0 0 0\n1.570796 3 10 10 0\n";

fn main() -> anyhow::Result<()> {
    let minutes = std::env::args().skip(1).find_map(|a| a.parse::<f64>().ok()).unwrap_or(3.0);
    let length = Duration::from_secs_f64(60.0 * minutes);
    let out = rtec_tests::root().join("target/soak");
    std::fs::create_dir_all(&out)?;
    let out = out.canonicalize()?;

    let sensors = Sensors::start(20.0);
    let more = format!("{Z}[model]\nfile = 'machine.toml'\nramp_um_s = 5\nlog_s = 5\n{}", sensors.config());
    let bench = Bench::with(&more);
    let model = "name = \"bench\"\n[[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T1\"\nminus = \"T2\"\num_per_K = 5.0\n";
    std::fs::write(bench.at("machine.toml"), model)?;
    std::fs::write(bench.at("error.cor"), CYLINDER)?;
    let daemon = bench.daemon();
    bench.go();
    until("both sensors", || daemon.expect(0, &["status"]).contains("sensors: 2 of 2 good"));
    daemon.expect(0, &["model", "load", "--yes"]);
    daemon.expect(0, &["part", "load", "--errors", &bench.at("error.cor").display().to_string()]);

    let clients = Clients::start(CLIENTS, &bench.at("s-view"));
    let exporter = Exporter::start(&bench.at("s"))?;

    let mut soak = Soak { rows: Vec::new(), gaps: gaps(&exporter)? };
    let head = "minutes,resident_kB,descriptors,threads,looks,insertions,gap_p50_ns,gap_p999_ns,answers";
    println!("{}", head.replace(',', "  "));
    let begun = Instant::now();
    for row in 1..=ROWS {
        while begun.elapsed() < length * row / ROWS {
            // Up and down by 3 K in ten minutes, without a rest.
            let turns = begun.elapsed().as_secs_f64() / 600.0;
            sensors.set(20.0 + 3.0 * (std::f64::consts::TAU * turns).sin());
            std::thread::sleep(Duration::from_millis(200));
        }
        let row = soak.row(&daemon, &exporter, begun.elapsed(), clients.answers())?;
        println!("{}", row.replace(',', "  "));
    }
    let status = daemon.status();
    std::fs::write(out.join("soak.csv"), format!("{head}\n{}", soak.csv()))?;
    soak.draw(&out)?;
    drop((clients, exporter));

    let x = &status["axes"][0];
    for found in [&status["faults"], &x["faults"]] {
        ensure!(found.as_array().is_some_and(Vec::is_empty), "a fault is latched: {found}");
    }
    ensure!(status["balanced"] == true, "the ledger does not balance: {x}");
    bench.machine.move_axis(false);
    bench.balances();
    println!(
        "{minutes} min: {} looks, {} insertions, balanced at the MTC, nothing illegal; {}",
        soak.last(4),
        soak.last(5),
        out.display()
    );
    println!("first tenth against last tenth: {}", soak.growth());
    Ok(())
}

/// The measured rows.
struct Soak {
    rows: Vec<[f64; 9]>,
    gaps: Buckets,
}

/// Number of looks by the upper bound of their gap, ns.
type Buckets = Vec<(f64, f64)>;

impl Soak {
    fn row(
        &mut self,
        daemon: &Daemon,
        exporter: &Exporter,
        after: Duration,
        answers: u64,
    ) -> anyhow::Result<String> {
        let of = format!("/proc/{}", daemon.id());
        let status = std::fs::read_to_string(format!("{of}/status"))?;
        let line = |name: &str| -> f64 {
            let found = status.lines().find_map(|l| l.strip_prefix(name));
            found.and_then(|l| l.split_whitespace().next()?.parse().ok()).unwrap_or(f64::NAN)
        };
        let descriptors = std::fs::read_dir(format!("{of}/fd"))?.count();
        let gaps = gaps(exporter)?;
        let since: Buckets = gaps.iter().zip(&self.gaps).map(|(now, old)| (now.0, now.1 - old.1)).collect();
        let x = &daemon.status()["axes"][0];
        let row = [
            after.as_secs_f64() / 60.0,
            line("VmRSS:"),
            descriptors as f64,
            line("Threads:"),
            gaps.last().map_or(0.0, |b| b.1),
            x["insertions"].as_f64().context("insertions")?,
            percentile(&since, 0.5),
            percentile(&since, 0.999),
            answers as f64,
        ];
        self.gaps = gaps;
        self.rows.push(row);
        Ok(words(&row))
    }

    fn csv(&self) -> String {
        self.rows.iter().fold(String::new(), |mut text, row| {
            let _ = writeln!(text, "{}", words(row));
            text
        })
    }

    fn last(&self, column: usize) -> f64 {
        self.rows.last().map_or(f64::NAN, |row| row[column])
    }

    fn growth(&self) -> String {
        let part = self.rows.len().div_ceil(10);
        let mean = |rows: &[[f64; 9]], column: usize| {
            rows.iter().map(|row| row[column]).sum::<f64>() / rows.len() as f64
        };
        let (first, last) = (&self.rows[..part], &self.rows[self.rows.len() - part..]);
        [(1, "kB resident"), (2, "descriptors"), (3, "threads"), (6, "ns gap p50"), (7, "ns gap p99.9")]
            .map(|(column, what)| format!("{:.0} → {:.0} {what}", mean(first, column), mean(last, column)))
            .join(", ")
    }

    fn draw(&self, out: &Path) -> anyhow::Result<()> {
        let points = |column: usize| self.rows.iter().map(|row| (row[0], row[column])).collect();
        let charts = [
            ("memory", "kB", vec![(1, "resident")]),
            ("descriptors", "", vec![(2, "descriptors"), (3, "threads")]),
            ("latency", "ns", vec![(6, "gap between looks, p50"), (7, "p99.9")]),
        ];
        for (name, unit, columns) in charts {
            let mut chart = Chart::new(&format!("rtecd under load: {name}"), "time (min)", unit);
            for (column, label) in columns {
                chart = chart.with(Series::new(label, Style::Line, points(column)));
            }
            std::fs::write(out.join(format!("{name}.svg")), chart.svg(800, 360)?)?;
        }
        Ok(())
    }
}

fn words(row: &[f64; 9]) -> String {
    row.iter()
        .enumerate()
        .map(|(n, v)| if n == 0 { format!("{v:.1}") } else { format!("{v:.0}") })
        .collect::<Vec<_>>()
        .join(",")
}

/// Upper bound of the gaps below which this share lies, ns.
fn percentile(counts: &Buckets, share: f64) -> f64 {
    let all = counts.last().map_or(0.0, |b| b.1);
    counts.iter().find(|b| b.1 >= share * all).map_or(f64::NAN, |b| b.0)
}

/// Gaps between looks, from the metrics.
fn gaps(exporter: &Exporter) -> anyhow::Result<Buckets> {
    let text = exporter.scrape()?;
    let mut buckets = Buckets::new();
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("rtec_poll_gap_seconds_bucket{le=\"")
            && let Some((le, count)) = rest.split_once("\"} ")
        {
            let le_s = if le == "+Inf" { f64::INFINITY } else { le.parse()? };
            buckets.push((le_s * 1e9, count.parse()?));
        }
    }
    ensure!(!buckets.is_empty(), "no gaps in the metrics: {text}");
    Ok(buckets)
}
