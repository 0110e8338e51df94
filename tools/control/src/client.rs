//! The client's end of the control socket.

use crate::protocol::{ClientRequest, Response};
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// An answer takes milliseconds; a daemon that takes longer than this is not well.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why the daemon gave no answer.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody is at the socket.
    #[error("cannot reach rtecd at {}: {source}; is it running? (systemctl status rtecd, or start rtecd)", socket.display())]
    Unreachable {
        /// Path of the socket that was tried.
        socket: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The connection broke, or the answer took too long.
    #[error("no answer from rtecd: {0}")]
    Io(#[from] io::Error),
    /// The answer is not one.
    #[error("rtecd answered {found:?}: {why}; are rtecctl and rtecd of the same version?")]
    Answer {
        /// The line that came instead of an answer, or why none came.
        found: String,
        /// What is wrong with it.
        why: serde_json::Error,
    },
}

/// A connection to the daemon.
#[derive(Debug)]
pub struct Client {
    stream: BufReader<UnixStream>,
}

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// When nobody listens.
    pub fn connect(socket: &Path) -> Result<Self, ClientError> {
        let stream = UnixStream::connect(socket)
            .map_err(|source| ClientError::Unreachable { socket: socket.to_owned(), source })?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        Ok(Self { stream: BufReader::new(stream) })
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// When there is none.
    pub fn ask(&mut self, request: &ClientRequest) -> Result<Response, ClientError> {
        let mut line = serde_json::to_string(request).map_err(io::Error::other)?;
        line.push('\n');
        self.stream.get_mut().write_all(line.as_bytes())?;
        self.answer()
    }

    /// Waits for as long as it takes: after `watch`, events come when they come.
    ///
    /// # Errors
    /// What the system reports.
    pub fn be_patient(&mut self) -> io::Result<()> {
        self.stream.get_ref().set_read_timeout(None)
    }

    /// Waits so long at most; then the answer is an error of kind `WouldBlock` or `TimedOut`.
    ///
    /// # Errors
    /// What the system reports.
    pub fn wait_at_most(&mut self, time: Duration) -> io::Result<()> {
        self.stream.get_ref().set_read_timeout(Some(time))
    }

    /// The next answer.
    ///
    /// # Errors
    /// When there is none.
    pub fn answer(&mut self) -> Result<Response, ClientError> {
        let mut line = String::new();
        if self.stream.read_line(&mut line)? == 0 {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "it closed the connection").into());
        }
        serde_json::from_str(&line).map_err(|why| ClientError::Answer { found: line.trim().to_owned(), why })
    }
}
