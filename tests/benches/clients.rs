//! The real-time thread's latencies, quiet and with clients and a scrape.
//!
//! `cargo bench -p rtec-tests --bench clients [-- SECONDS]`, ten seconds a column. It prints and asserts nothing. Each
//! column has a daemon of its own on the embedded simulated axes, with corrections on. The record of commands is on, as
//! always.

use rtec_tests::clients::{Clients, Exporter};
use rtec_tests::daemon::Daemon;
use serde_json::Value;
use std::time::{Duration, Instant};

const CLIENTS: usize = 30;

/// Clients that read the daemon during a measurement.
struct Load {
    name: &'static str,
    clients: usize,
    scraped: bool,
}

const LOADS: [Load; 3] = [
    Load { name: "quiet", clients: 0, scraped: false },
    Load { name: "scraped", clients: 0, scraped: true },
    Load { name: "30 clients, scraped", clients: CLIENTS, scraped: true },
];

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|a| a.parse::<u64>().ok()).unwrap_or(10);
    let found = LOADS.iter().map(|load| measured(load, Duration::from_secs(seconds)));
    let found = found.collect::<anyhow::Result<Vec<_>>>()?;
    let busy = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    println!(
        "{seconds} s each, ns; card mock, ordinary thread; scraped every second, each client a status each 100 ms"
    );
    println!("load of this computer at the end: {}", busy.split(' ').next().unwrap_or("unknown"));
    row("", LOADS.map(|load| load.name.to_owned()));
    for (what, key) in [("poll gap", "poll_gap_ns"), ("edge to done", "edge_to_done_ns")] {
        for (name, part) in
            [("p50", "p50"), ("p99", "p99"), ("p99.99", "p9999"), ("max", "max"), ("samples", "samples")]
        {
            row(
                &format!("{what}, {name}"),
                found.iter().map(|(status, _)| status["rt"][key][part].to_string()),
            );
        }
    }
    row("answers to clients", found.iter().map(|(_, answers)| answers.to_string()));
    Ok(())
}

fn row(name: &str, cells: impl IntoIterator<Item = String>) {
    print!("{name:<22}");
    for cell in cells {
        print!("{cell:>22}");
    }
    println!();
}

/// The status at the end, and the number of answers to the clients.
fn measured(load: &Load, time: Duration) -> anyhow::Result<(Value, u64)> {
    let directory = tempfile::tempdir()?;
    let socket = directory.path().join("s");
    let view = directory.path().join("s-view");
    let daemon = Daemon::enabled(&socket);
    let clients = Clients::start(load.clients, &view);
    let exporter = load.scraped.then(|| Exporter::start(&socket)).transpose()?;
    let (begun, mut total) = (Instant::now(), 0);
    while begun.elapsed() < time {
        // Always something to insert.
        total = if total == 0 { 40 } else { 0 };
        daemon.expect(0, &["correct", "x", &total.to_string()]);
        if let Some(exporter) = &exporter {
            exporter.scrape()?;
        }
        std::thread::sleep(Duration::from_secs(1));
    }
    let status = daemon.status();
    Ok((status, clients.answers()))
}
