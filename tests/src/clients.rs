//! Load on a daemon: clients that poll its status, and a scraper of its metrics.

use crate::daemon::{program, until};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Clients, each of which asks for the status every 100 ms.
#[derive(Debug)]
pub struct Clients {
    stop: Arc<AtomicBool>,
    answers: Arc<AtomicU64>,
    threads: Vec<JoinHandle<()>>,
}

impl Clients {
    /// Starts `n` clients on a socket.
    pub fn start(n: usize, socket: &Path) -> Self {
        let (stop, answers) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
        let threads = (0..n)
            .map(|_| {
                let (stop, answers, socket) = (Arc::clone(&stop), Arc::clone(&answers), socket.to_owned());
                std::thread::spawn(move || ask(&socket, &stop, &answers))
            })
            .collect();
        Self { stop, answers, threads }
    }

    /// Number of answers to all clients so far.
    pub fn answers(&self) -> u64 {
        self.answers.load(Ordering::Relaxed)
    }
}

impl Drop for Clients {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            drop(thread.join());
        }
    }
}

fn ask(socket: &Path, stop: &AtomicBool, answers: &AtomicU64) {
    let Ok(stream) = UnixStream::connect(socket) else { return };
    let mut stream = BufReader::new(stream);
    let mut line = String::new();
    while !stop.load(Ordering::Relaxed) {
        line.clear();
        let asked = stream.get_mut().write_all(b"{\"do\":\"status\"}\n");
        if asked.is_err() || stream.read_line(&mut line).is_ok_and(|n| n == 0) {
            return;
        }
        answers.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// `rtecctl metrics --listen`, until it is dropped.
#[derive(Debug)]
pub struct Exporter {
    server: Child,
    port: u16,
}

impl Exporter {
    /// Serves the metrics of a socket's daemon, and waits until it does.
    ///
    /// # Errors
    /// When there is no port, or the program cannot be run.
    pub fn start(socket: &Path) -> std::io::Result<Self> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let mut command = Command::new(program("rtecctl"));
        command.args(["metrics", "--listen", &format!("127.0.0.1:{port}"), "--socket"]).arg(socket);
        let exporter = Self { server: command.stderr(Stdio::null()).spawn()?, port };
        until("served", || exporter.scrape().is_ok());
        Ok(exporter)
    }

    /// Reads the metrics now, with the head of the answer.
    ///
    /// # Errors
    /// When the server does not answer.
    pub fn scrape(&self) -> std::io::Result<String> {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port))?;
        stream.write_all(b"GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
        let mut text = String::new();
        stream.read_to_string(&mut text)?;
        Ok(text)
    }
}

impl Drop for Exporter {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
