//! `rtecctl metrics`: the status as metrics.
//! They are printed, written for a collector, or served.

use crate::daemon_connection::{NO_EVENTS, observe};
use crate::http_server::{HttpRequest, HttpRequestHandler, HttpResponse, HttpServer};
use crate::prelude::*;
use rtec_control::metrics::{MetricsFormat, text};
use rtec_control::protocol::DaemonSnapshot;
use rtec_files::file_format_stamp::VERSION;
use std::fs::{Permissions, remove_file};
use std::net::SocketAddr;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::UnixStream;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Print the corrector's state as metrics; or write them for a collector, or serve them
///
/// Without a daemon --textfile and --listen say so by the metric `rtec_up`. Served are /metrics in the form that is asked
/// for (`OpenMetrics` or 0.0.4), and nothing else; nothing can be commanded.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// `OpenMetrics` text instead of Prometheus' 0.0.4, where the reader does not choose
    #[arg(long, conflicts_with_all = ["textfile", "listen"])]
    openmetrics: bool,
    /// Write them whole to this file, which ends in .prom, for `node_exporter`'s textfile collector
    #[arg(long, value_name = "FILE.prom")]
    textfile: Option<PathBuf>,
    /// Write the file again and again, as 15s
    #[arg(long, value_name = "TIME", requires = "textfile", value_parser = rtec_files::cli_option_parsers::duration)]
    every: Option<Duration>,
    /// Serve them at this address, as 127.0.0.1:9837, or at a Unix socket, as /run/rtec-metrics/socket
    #[arg(long, value_name = "ADDRESS", conflicts_with = "textfile")]
    listen: Option<String>,
    /// An address that others can reach is meant: nothing there asks who reads
    #[arg(long, requires = "listen")]
    beyond_loopback: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    ensure!(!args.daemon.json, Bad, "metrics are text: `rtecctl status --json` has the same as JSON");
    if let Some(address) = &args.listen {
        return serve(&args.daemon, address, args.beyond_loopback);
    }
    if let Some(file) = &args.textfile {
        return write(&args.daemon, file, args.every);
    }
    let form = if args.openmetrics { MetricsFormat::OpenMetrics } else { MetricsFormat::Prometheus };
    print!("{}", text(Some(&seen(&args.daemon)?), form, VERSION));
    Ok(())
}

fn seen(daemon: &DaemonArgs) -> anyhow::Result<DaemonSnapshot> {
    observe(&mut daemon.view()?, NO_EVENTS)
}

fn write(daemon: &DaemonArgs, file: &Path, every: Option<Duration>) -> anyhow::Result<()> {
    if file.extension().is_none_or(|e| e != "prom") {
        let found = format!("the name {}", file.display());
        let expected = "a name that ends in .prom: collectors read no other";
        return Err(InputError::whole(file, found, expected).into());
    }
    loop {
        let seen = seen(daemon);
        let metrics = text(seen.as_ref().ok(), MetricsFormat::Prometheus, VERSION);
        crate::json_output::write(file, &metrics)?;
        // The collector runs as another user.
        std::fs::set_permissions(file, Permissions::from_mode(0o644))?;
        match (every, seen) {
            (None, seen) => return seen.map(drop),
            (Some(every), _) => std::thread::sleep(every),
        }
    }
}

fn serve(daemon: &DaemonArgs, address: &str, beyond_loopback: bool) -> anyhow::Result<()> {
    let server =
        if address.contains('/') { at_path(Path::new(address))? } else { at_port(address, beyond_loopback)? };
    eprintln!("metrics at {address}");
    let handler = Arc::new(MetricsHttpHandler { daemon: daemon.clone(), last: Mutex::default() });
    server.serve(&handler, &AtomicBool::new(false)).with_context(|| format!("listening at {address}"))
}

fn at_port(address: &str, beyond_loopback: bool) -> anyhow::Result<HttpServer> {
    let Ok(at) = address.parse::<SocketAddr>() else {
        let expected = "ADDRESS:PORT as 127.0.0.1:9837, or the path of a socket";
        fail!(Bad, "--listen: found {address:?}, expected {expected}");
    };
    if !at.ip().is_loopback() && !beyond_loopback {
        let expected = format!("a loopback address as 127.0.0.1:{}", at.port());
        let found = format!("--listen: found {at}, which others can reach");
        fail!(Bad, "{found}; expected {expected}, or --beyond-loopback beside it");
    }
    HttpServer::tcp(at).map_err(|e| CommandFailure::No(format!("cannot listen at {at}: {e}")).into())
}

/// Creates a Unix socket, also in place of one at which nothing listens.
fn at_path(path: &Path) -> anyhow::Result<HttpServer> {
    let no =
        |e: &dyn std::fmt::Display| CommandFailure::No(format!("cannot listen at {}: {e}", path.display()));
    if let Ok(found) = std::fs::symlink_metadata(path) {
        if !found.file_type().is_socket() {
            return Err(no(&"found something that is no socket").into());
        }
        if UnixStream::connect(path).is_ok() {
            return Err(no(&"somebody else listens there").into());
        }
        remove_file(path).map_err(|e| no(&e))?;
    }
    let server = HttpServer::unix(path).map_err(|e| no(&e))?;
    std::fs::set_permissions(path, Permissions::from_mode(0o660)).map_err(|e| no(&e))?;
    Ok(server)
}

/// Asks the daemon once for all clients that wait at a time.
struct MetricsHttpHandler {
    daemon: DaemonArgs,
    /// Its last answer, and the time of that.
    last: Mutex<Option<(Instant, Option<DaemonSnapshot>)>>,
}

impl HttpRequestHandler for MetricsHttpHandler {
    fn check_head(&self, head: &HttpRequest) -> Result<(), HttpResponse> {
        if !["GET", "HEAD"].contains(&head.method.as_str()) {
            return Err(HttpResponse::plain(405, "GET or HEAD"));
        }
        if head.path.split('?').next() != Some("/metrics") {
            return Err(HttpResponse::plain(404, "metrics are at /metrics"));
        }
        Ok(())
    }

    fn answer(&self, request: &HttpRequest) -> HttpResponse {
        let form = MetricsFormat::accepted(request.header("Accept").unwrap_or_default());
        let came = Instant::now();
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if last.as_ref().is_none_or(|(at, _)| *at < came) {
            let seen = seen(&self.daemon).ok();
            *last = Some((Instant::now(), seen));
        }
        let body = text(last.as_ref().and_then(|(_, seen)| seen.as_ref()), form, VERSION);
        drop(last);
        HttpResponse { status: 200, kind: form.content_type(), body }
    }
}
