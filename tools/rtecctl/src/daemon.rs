//! How the verbs that need the daemon reach it, and what its answers mean for the exit code.

use crate::Outcome;
use crate::document::line;
use crate::say;
use nix::sys::signal::{SigSet, Signal};
use rtec_control::client::{Client, ClientError};
use rtec_control::config::{Config, ControlConfig, INSTALLED};
use rtec_control::protocol::{ClientRequest, DaemonStatus, Jump, Observed, Response};
use rtec_files::InputError;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Which daemon, and in which form its answer is printed.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct Daemon {
    /// The daemon's control socket [default: the configuration's]
    #[arg(long, value_name = "PATH", global = true)]
    socket: Option<PathBuf>,
    /// The daemon's configuration [default: /etc/rtec/rtec.toml where it exists, else the embedded one]
    #[arg(long, value_name = "FILE", conflicts_with = "socket", global = true)]
    config: Option<PathBuf>,
    /// Print the answer as one JSON document
    #[arg(long, global = true)]
    pub json: bool,
}

impl Daemon {
    /// The daemon at this socket, or the installed one, for a verb that has a `--json` of its own.
    pub(crate) fn at(socket: Option<PathBuf>) -> Self {
        Self { socket, config: None, json: false }
    }

    /// The configuration that was named.
    pub(crate) fn config_file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// Names of the axes: of the daemon that runs, else as configured.
    pub(crate) fn axes(&self) -> Vec<String> {
        let status = self.view().ok().and_then(|mut client| client.ask(&ClientRequest::Status {}).ok());
        if let Some(Response::Status(status)) = status {
            return status.axes.into_iter().map(|axis| axis.name).collect();
        }
        let config = Config::load(Path::new(INSTALLED)).unwrap_or_else(|_| Config::embedded());
        config.axes.into_iter().map(|axis| axis.name).collect()
    }

    /// Where the daemon is to be found, as configured.
    fn control(&self) -> anyhow::Result<ControlConfig> {
        let mut control = match &self.config {
            Some(file) => Config::load(file)?.control,
            // Somebody else's file, and not named by the user: where it is not right the daemon has said so.
            None => Config::load(Path::new(INSTALLED)).unwrap_or_else(|_| Config::embedded()).control,
        };
        if let Some(socket) = &self.socket {
            // Another daemon than that of the file: what is not derived from the socket is not its.
            control = ControlConfig { socket: socket.clone(), ..Config::embedded().control };
        }
        Ok(control)
    }

    /// Connects by the socket for everything, or, where this user may not use it, by one that allows less.
    pub(crate) fn connect(&self) -> anyhow::Result<Client> {
        let sockets = self.control()?.sockets();
        Client::connect_to(&[&sockets[0].path, &sockets[1].path, &sockets[2].path]).map_err(unreachable)
    }

    /// Connects by the socket that only shows.
    /// Where this user may not use it, by another.
    pub(crate) fn view(&self) -> anyhow::Result<Client> {
        let sockets = self.control()?.sockets();
        Client::connect_to(&[&sockets[2].path, &sockets[1].path, &sockets[0].path]).map_err(unreachable)
    }

    /// The record of every command: where a running daemon says, else where it is configured.
    pub(crate) fn log_path(&self) -> anyhow::Result<PathBuf> {
        let told = self.connect().ok().and_then(|mut client| {
            let latest = ClientRequest::Observe { events_after: Some(u64::MAX) };
            match client.ask(&latest) {
                Ok(Response::Observed(all)) => Some(PathBuf::from(all.log.file)),
                _ => None,
            }
        });
        told.map_or_else(|| Ok(self.control()?.log_path()), Ok)
    }

    /// Asks, and prints the answer where JSON is wanted.
    /// Anything but "done" is an error with its exit code.
    pub(crate) fn ask(&self, request: &ClientRequest) -> anyhow::Result<Response> {
        self.ask_with(request, &[])
    }

    /// The same, with open files for the daemon to read.
    pub(crate) fn ask_with(&self, request: &ClientRequest, files: &[File]) -> anyhow::Result<Response> {
        let mut client = self.connect()?;
        let response = client.ask_with(request, files).map_err(unreachable)?;
        if self.json {
            match &response {
                // Documents stand bare.
                Response::Status(status) => say(&line(status)?),
                Response::Explained { axes } => say(&line(&serde_json::json!({ "axes": axes }))?),
                Response::Whoami(caller) => say(&line(caller)?),
                other => say(&line(other)?),
            }
        }
        check(response)
    }

    /// Asks for something to be done and says so.
    pub(crate) fn order(&self, request: &ClientRequest, done: &str) -> anyhow::Result<()> {
        self.ask(request)?;
        if !self.json {
            println!("{done}");
        }
        Ok(())
    }
}

/// A file that the daemon is to read, opened with this user's rights.
pub(crate) fn open(file: &Path) -> Result<File, InputError> {
    rtec_files::text::open_regular(file)
}

/// A user's file as the daemon finds it, which has a directory of its own.
/// One that is not there is the daemon's to refuse, by the name as it was given.
pub(crate) fn absolute(file: &Path) -> String {
    file.canonicalize().unwrap_or_else(|_| file.to_owned()).display().to_string()
}

/// No event is later than this one.
pub(crate) const NO_EVENTS: Option<u64> = Some(u64::MAX);

/// Asks; a refusal is an error.
pub(crate) fn ask(client: &mut Client, request: &ClientRequest) -> anyhow::Result<Response> {
    check(client.ask(request).map_err(unreachable)?)
}

/// An answer that this request does not have.
pub(crate) fn unexpected(answer: &Response) -> anyhow::Error {
    let text = format!("rtecd answered {answer:?}; are rtecctl and rtecd of the same version?");
    Outcome::Unreachable(text).into()
}

/// Everything that the daemon shows, with the events after one that is known already.
pub(crate) fn observe(client: &mut Client, events_after: Option<u64>) -> anyhow::Result<Observed> {
    match ask(client, &ClientRequest::Observe { events_after })? {
        Response::Observed(seen) => Ok(*seen),
        other => Err(unexpected(&other)),
    }
}

/// The daemon's status.
pub(crate) fn status(client: &mut Client) -> anyhow::Result<DaemonStatus> {
    match ask(client, &ClientRequest::Status {})? {
        Response::Status(status) => Ok(*status),
        other => Err(unexpected(&other)),
    }
}

/// Blocks the signals that end a program in this thread and those it starts.
pub(crate) fn block_end_signals() -> nix::Result<SigSet> {
    let ends = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter().collect::<SigSet>();
    ends.thread_block()?;
    Ok(ends)
}

/// "Done", a status or an event; anything else as the error that it is.
/// What is not as it was meant is said.
pub(crate) fn check(response: Response) -> anyhow::Result<Response> {
    if let Response::Done { warnings, .. } = &response {
        for warning in warnings {
            eprintln!("warning: {warning}");
        }
    }
    match response {
        Response::Refused { text, jumps, .. } => {
            let lines: Vec<String> = std::iter::once(text).chain(jumps.iter().map(describe)).collect();
            Err(Outcome::No(lines.join("\n  ")).into())
        }
        Response::Fault { text } => Err(Outcome::Fault(text).into()),
        Response::Bad { text } => Err(Outcome::Bad(text).into()),
        good => Ok(good),
    }
}

/// A jump, for people.
pub(crate) fn describe(jump: &Jump) -> String {
    let Jump { axis, counts, um, window_counts } = jump;
    format!("axis {axis}: {counts:+} counts ({um:+.3} µm), belief window {window_counts} counts")
}

#[allow(clippy::needless_pass_by_value)] // As `map_err` gives it.
pub(crate) fn unreachable(error: ClientError) -> anyhow::Error {
    let said = error.to_string();
    if matches!(error, ClientError::TooLong { .. }) { Outcome::Bad(said) } else { Outcome::Unreachable(said) }
        .into()
}
