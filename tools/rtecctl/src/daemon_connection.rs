//! Connection of verbs to the daemon, and its answers as exit codes.

use crate::CommandFailure;
use crate::json_output::line;
use crate::say;
use nix::sys::signal::{SigSet, Signal};
use rtec_control::config::{Config, ControlConfig, INSTALLED};
use rtec_control::daemon_client::{ClientError, DaemonConnection};
use rtec_control::protocol::{
    AxisCorrectionComponents, ClientRequest, DaemonResponse, DaemonSnapshot, DaemonStatus, EnableJump,
};
use std::fs::File;
use std::path::{Path, PathBuf};

/// Which daemon, and in which form its answer is printed.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct DaemonArgs {
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

impl DaemonArgs {
    /// The daemon at this socket, for verbs that have their own `--json`.
    pub(crate) fn at(socket: Option<PathBuf>) -> Self {
        Self { socket, config: None, json: false }
    }

    /// The configuration file named by the user.
    pub(crate) fn config_file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// Names of the axes, from the running daemon, else from the configuration.
    pub(crate) fn axes(&self) -> Vec<String> {
        if let Some(status) = self.view().ok().and_then(|mut client| status(&mut client).ok()) {
            return status.axes.into_iter().map(|axis| axis.name).collect();
        }
        let config = Config::load(Path::new(INSTALLED)).unwrap_or_else(|_| Config::embedded());
        config.axes.into_iter().map(|axis| axis.name).collect()
    }

    fn control(&self) -> anyhow::Result<ControlConfig> {
        Ok(ControlConfig::of(self.config.as_deref(), self.socket.as_deref())?)
    }

    /// Connects by the socket of the highest role that this user may use.
    pub(crate) fn connect(&self) -> anyhow::Result<DaemonConnection> {
        DaemonConnection::connect_to(&self.control()?.sockets().each_ref().map(|s| &s.path))
            .map_err(unreachable)
    }

    /// Connects by the socket of the role `view`, else by one of the others.
    pub(crate) fn view(&self) -> anyhow::Result<DaemonConnection> {
        let mut sockets = self.control()?.sockets();
        sockets.reverse();
        DaemonConnection::connect_to(&sockets.each_ref().map(|s| &s.path)).map_err(unreachable)
    }

    /// Path of the record of commands: a running daemon's, else as configured.
    pub(crate) fn log_path(&self) -> anyhow::Result<PathBuf> {
        let seen = self.connect().and_then(|mut client| observe(&mut client, NO_EVENTS));
        seen.map_or_else(|_| Ok(self.control()?.log_path()), |seen| Ok(PathBuf::from(seen.log.file)))
    }

    /// Sends a request, and prints the answer if JSON is wanted.
    /// Any answer but "done" is an error with its exit code.
    pub(crate) fn ask(&self, request: &ClientRequest) -> anyhow::Result<DaemonResponse> {
        self.ask_with(request, &[])
    }

    /// As [`Self::ask`], with open files for the daemon to read.
    pub(crate) fn ask_with(&self, request: &ClientRequest, files: &[File]) -> anyhow::Result<DaemonResponse> {
        let mut client = self.connect()?;
        let response = client.ask_with(request, files).map_err(unreachable)?;
        if self.json {
            match &response {
                // Documents are printed without an envelope.
                DaemonResponse::Status(status) => say(&line(status)?),
                DaemonResponse::Explained { axes } => say(&line(&serde_json::json!({ "axes": axes }))?),
                DaemonResponse::Whoami(caller) => say(&line(caller)?),
                other => say(&line(other)?),
            }
        }
        check(response)
    }

    /// Requests an action, and reports when it is done.
    pub(crate) fn order(&self, request: &ClientRequest, done: &str) -> anyhow::Result<()> {
        self.ask(request)?;
        if !self.json {
            println!("{done}");
        }
        Ok(())
    }
}

/// Absolute path of a user's file, because the daemon has another directory.
/// A missing file keeps its name, so that the daemon refuses it by that name.
pub(crate) fn absolute(file: &Path) -> String {
    file.canonicalize().unwrap_or_else(|_| file.to_owned()).display().to_string()
}

/// A number above that of every event.
pub(crate) const NO_EVENTS: Option<u64> = Some(u64::MAX);

/// Sends a request; a refusal is an error.
pub(crate) fn ask(client: &mut DaemonConnection, request: &ClientRequest) -> anyhow::Result<DaemonResponse> {
    check(client.ask(request).map_err(unreachable)?)
}

/// Error for an answer that does not belong to the request.
pub(crate) fn unexpected(answer: &DaemonResponse) -> anyhow::Error {
    let text = format!("rtecd answered {answer:?}; are rtecctl and rtecd of the same version?");
    CommandFailure::Unreachable(text).into()
}

/// The value of the expected answer; any other ends the verb.
macro_rules! expected {
    ($answer:expr, $expected:pat => $value:expr) => {
        match $answer {
            $expected => $value,
            other => return Err($crate::daemon_connection::unexpected(&other)),
        }
    };
}
pub(crate) use expected;

/// Everything that the daemon shows, with the events after a known one.
pub(crate) fn observe(
    client: &mut DaemonConnection,
    events_after: Option<u64>,
) -> anyhow::Result<DaemonSnapshot> {
    Ok(
        expected!(ask(client, &ClientRequest::Observe { events_after })?, DaemonResponse::Observed(seen) => *seen),
    )
}

/// The parts of every axis's total.
pub(crate) fn explained(client: &mut DaemonConnection) -> anyhow::Result<Vec<AxisCorrectionComponents>> {
    Ok(
        expected!(ask(client, &ClientRequest::Explain { axis: None })?, DaemonResponse::Explained { axes } => axes),
    )
}

pub(crate) fn status(client: &mut DaemonConnection) -> anyhow::Result<DaemonStatus> {
    Ok(expected!(ask(client, &ClientRequest::Status {})?, DaemonResponse::Status(status) => *status))
}

/// Blocks SIGINT, SIGTERM and SIGHUP in this thread and those it starts.
pub(crate) fn block_end_signals() -> nix::Result<SigSet> {
    let ends = [Signal::SIGINT, Signal::SIGTERM, Signal::SIGHUP].into_iter().collect::<SigSet>();
    ends.thread_block()?;
    Ok(ends)
}

/// Passes on "done", a status or an event; any other answer is an error.
/// Prints the warnings of an answer.
pub(crate) fn check(response: DaemonResponse) -> anyhow::Result<DaemonResponse> {
    if let DaemonResponse::Done { warnings, .. } = &response {
        for warning in warnings {
            eprintln!("warning: {warning}");
        }
    }
    let outcome = match response {
        DaemonResponse::Refused { text, jumps, .. } => {
            let lines: Vec<String> = std::iter::once(text).chain(jumps.iter().map(describe)).collect();
            CommandFailure::No(lines.join("\n  "))
        }
        DaemonResponse::Fault { text } => CommandFailure::Fault(text),
        DaemonResponse::Bad { text } => CommandFailure::Bad(text),
        good => return Ok(good),
    };
    Err(outcome.into())
}

pub(crate) fn describe(jump: &EnableJump) -> String {
    let EnableJump { axis, counts, um, window_counts } = jump;
    format!("axis {axis}: {counts:+} counts ({um:+.3} µm), belief window {window_counts} counts")
}

#[allow(clippy::needless_pass_by_value)] // As `map_err` gives it.
pub(crate) fn unreachable(error: ClientError) -> anyhow::Error {
    let outcome = if let ClientError::TooLong { .. } = error {
        CommandFailure::Bad
    } else {
        CommandFailure::Unreachable
    };
    outcome(error.to_string()).into()
}
