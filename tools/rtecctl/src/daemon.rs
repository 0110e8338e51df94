//! How the verbs that need the daemon reach it, and what its answers mean for the exit code.

use crate::Outcome;
use rtec_control::client::{Client, ClientError};
use rtec_control::config::{Config, INSTALLED, default_directory};
use rtec_control::protocol::{ClientRequest, Jump, Response};
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

    fn socket(&self) -> anyhow::Result<PathBuf> {
        if let Some(socket) = &self.socket {
            return Ok(socket.clone());
        }
        match &self.config {
            Some(file) => Ok(Config::load(file)?.control.socket),
            // Somebody else's file, and not named by the user: where it is not right the daemon has said so.
            None => Ok(Config::load(Path::new(INSTALLED))
                .map_or_else(|_| default_directory().join("control.sock"), |c| c.control.socket)),
        }
    }

    pub(crate) fn connect(&self) -> anyhow::Result<Client> {
        Client::connect(&self.socket()?).map_err(unreachable)
    }

    /// Asks, and prints the answer where JSON is wanted. Anything but "done" is an error with its exit code.
    pub(crate) fn ask(&self, request: &ClientRequest) -> anyhow::Result<Response> {
        let mut client = self.connect()?;
        let response = client.ask(request).map_err(unreachable)?;
        if self.json {
            match &response {
                // Documents stand bare.
                Response::Status(status) => println!("{}", serde_json::to_string(status)?),
                Response::Explained { axes } => println!("{}", serde_json::json!({ "axes": axes })),
                other => println!("{}", serde_json::to_string(other)?),
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

/// A user's file as the daemon finds it, which has a directory of its own. One that is not there is the daemon's to
/// refuse, by the name as it was given.
pub(crate) fn absolute(file: &Path) -> String {
    file.canonicalize().unwrap_or_else(|_| file.to_owned()).display().to_string()
}

/// "Done", a status or an event; anything else as the error that it is.
pub(crate) fn check(response: Response) -> anyhow::Result<Response> {
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
    Outcome::Unreachable(error.to_string()).into()
}
