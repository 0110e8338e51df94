//! HTTP/1.1 server for a few readers on this computer.
//! It serves one request per connection and each connection in its own thread, within limits of size and
//! time. A slow client delays no other. A body is read only after its head was accepted. If all connections
//! are in use, a new one replaces the oldest whose request is not complete.
//!
//! `httparse` reads the heads and needs no other crate. `hyper` needs a run time (seventeen crates) and
//! cannot drop a slow client. `tiny_http` reads bodies on the thread that accepts, so that one slow sender
//! stops all.

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest head and longest body, bytes.
const LONGEST_HEAD: usize = 8192;
const LONGEST_BODY: usize = 4096;
const MOST_HEADERS: usize = 64;
/// Longest time for a head, and for a body.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest number of connections at a time.
const AT_ONCE: usize = 128;
/// Interval of checks whether the server must end, ms.
const LOOK_MS: u8 = 50;
/// Time of reading after the answer, which an earlier close could discard.
const AFTER: Duration = Duration::from_millis(200);

#[derive(Debug, Default)]
pub(crate) struct HttpRequest {
    pub method: String,
    pub path: String,
    headers: Vec<(String, String)>,
    /// Empty until the head was accepted.
    pub body: Vec<u8>,
}

impl HttpRequest {
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, v)| v.as_str())
    }

    /// Length of the body, bytes; none unless given once, in plain digits.
    fn length(&self) -> Option<usize> {
        let said = |name: &str| self.headers.iter().filter(|(n, _)| n.eq_ignore_ascii_case(name)).count();
        if said("Transfer-Encoding") > 0 || said("Content-Length") > 1 {
            return None;
        }
        let text = self.header("Content-Length").unwrap_or("0");
        text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok()).flatten()
    }

    /// Reads a head and returns its length; none while it is incomplete.
    fn parse(bytes: &[u8]) -> Result<Option<(Self, usize)>, httparse::Error> {
        let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
        let mut found = httparse::Request::new(&mut headers);
        let httparse::Status::Complete(length) = found.parse(bytes)? else { return Ok(None) };
        let (method, path) = (found.method.unwrap_or_default(), found.path.unwrap_or_default());
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let headers = found.headers.iter().map(|h| (h.name.to_owned(), text(h.value))).collect();
        let (method, path) = (method.to_owned(), path.to_owned());
        Ok(Some((Self { method, path, headers, body: Vec::new() }, length)))
    }
}

#[derive(Debug)]
pub(crate) struct HttpResponse {
    pub status: u16,
    pub kind: &'static str,
    pub body: String,
}

impl HttpResponse {
    /// An answer that is one line of text.
    pub(crate) fn plain(status: u16, text: &str) -> Self {
        Self { status, kind: "text/plain", body: format!("{text}\n") }
    }
}

pub(crate) trait HttpRequestHandler: Send + Sync {
    /// Whether the rest of a request with this head is read.
    ///
    /// # Errors
    /// The answer that is sent instead.
    fn check_head(&self, head: &HttpRequest) -> Result<(), HttpResponse>;

    fn answer(&self, request: &HttpRequest) -> HttpResponse;
}

enum TcpOrUnixListener {
    Tcp(TcpListener),
    Unix(UnixListener),
}

pub(crate) struct HttpServer(TcpOrUnixListener);

impl HttpServer {
    /// Listens at a port; 0 takes a free one.
    pub(crate) fn tcp(at: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(at)?;
        listener.set_nonblocking(true)?;
        Ok(Self(TcpOrUnixListener::Tcp(listener)))
    }

    pub(crate) fn unix(path: &Path) -> io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self(TcpOrUnixListener::Unix(listener)))
    }

    /// Its address, if it listens at a port.
    pub(crate) fn address(&self) -> io::Result<SocketAddr> {
        match &self.0 {
            TcpOrUnixListener::Tcp(listener) => listener.local_addr(),
            TcpOrUnixListener::Unix(_) => Err(ErrorKind::Unsupported.into()),
        }
    }

    /// Answers until `done` is set.
    ///
    /// # Errors
    /// The listening socket failed.
    pub(crate) fn serve<H: HttpRequestHandler + 'static>(
        &self,
        handler: &Arc<H>,
        done: &AtomicBool,
    ) -> io::Result<()> {
        let seats = Arc::<ConnectionSlots>::default();
        while !done.load(Ordering::Acquire) {
            let fd = match &self.0 {
                TcpOrUnixListener::Tcp(listener) => listener.as_fd(),
                TcpOrUnixListener::Unix(listener) => listener.as_fd(),
            };
            poll(&mut [PollFd::new(fd, PollFlags::POLLIN)], PollTimeout::from(LOOK_MS)).ok();
            // Only calls that every socket knows are made on it, so a TCP connection goes as one of the other kind.
            let accepted = match &self.0 {
                TcpOrUnixListener::Tcp(listener) => {
                    listener.accept().map(|(s, _)| UnixStream::from(OwnedFd::from(s)))
                }
                TcpOrUnixListener::Unix(listener) => listener.accept().map(|(s, _)| s),
            };
            let stream = match accepted {
                Ok(stream) => stream,
                Err(e) if e.kind() == ErrorKind::InvalidInput => return Err(e),
                Err(e) if e.kind() == ErrorKind::WouldBlock => continue,
                Err(_) => {
                    // The client is gone, or no descriptor is free; open connections end in time.
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
            };
            let Ok(other) = stream.try_clone() else { continue };
            let close = Box::new(move || drop(other.shutdown(Shutdown::Both)));
            let Some(seat) = ConnectionSlots::take(&seats, close) else { continue };
            let handler = Arc::clone(handler);
            let started = std::thread::Builder::new().name("http".into()).spawn(move || {
                // A client may close early; that needs no report.
                let _ = converse(stream, &*handler, &seat);
            });
            // If no thread can start, the connection is closed.
            drop(started);
        }
        Ok(())
    }
}

/// Ends a connection from outside its thread.
type CloseConnection = Box<dyn Fn() + Send>;

/// Open connections, and how to close incomplete ones, the oldest first.
#[derive(Default)]
struct ConnectionSlots(Mutex<(u64, usize, BTreeMap<u64, CloseConnection>)>);

/// A connection's slot, until it is dropped.
struct ConnectionSlot {
    of: Arc<ConnectionSlots>,
    number: u64,
}

impl ConnectionSlots {
    /// Takes a slot; if none is free, closes the oldest with an incomplete request.
    /// None if the requests of all are complete.
    fn take(of: &Arc<Self>, hand: CloseConnection) -> Option<ConnectionSlot> {
        let mut seats = of.lock();
        let (next, taken, silent) = &mut *seats;
        if *taken >= AT_ONCE {
            let (_, oldest) = silent.pop_first()?;
            oldest();
        }
        *next += 1;
        *taken += 1;
        silent.insert(*next, hand);
        Some(ConnectionSlot { of: Arc::clone(of), number: *next })
    }

    fn lock(&self) -> MutexGuard<'_, (u64, usize, BTreeMap<u64, CloseConnection>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl ConnectionSlot {
    /// Marks the request as complete, so that it will be answered.
    fn has_asked(&self) {
        self.of.lock().2.remove(&self.number);
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut seats = self.of.lock();
        seats.1 -= 1;
        seats.2.remove(&self.number);
    }
}

fn converse(
    mut stream: UnixStream,
    handler: &dyn HttpRequestHandler,
    seat: &ConnectionSlot,
) -> io::Result<()> {
    let mut bytes = Vec::new();
    let answer = |request: &mut HttpRequest,
                  stream: &mut UnixStream,
                  bytes: &mut Vec<u8>|
     -> io::Result<HttpResponse> {
        let deadline = Instant::now() + PATIENCE;
        let (head, end) = loop {
            match HttpRequest::parse(bytes) {
                Ok(Some(found)) => break found,
                Ok(None) if bytes.len() > LONGEST_HEAD => {
                    return Ok(HttpResponse::plain(431, "the head of the request is too long"));
                }
                Ok(None) => more(stream, bytes, deadline)?,
                Err(why) => return Ok(HttpResponse::plain(400, &format!("this is no HTTP/1.1: {why}"))),
            }
        };
        *request = head;
        bytes.drain(..end);
        if let Err(refusal) = handler.check_head(request) {
            return Ok(refusal);
        }
        let Some(length) = request.length().filter(|length| *length <= LONGEST_BODY) else {
            return Ok(HttpResponse::plain(413, "a body of known and small length was expected"));
        };
        if request.header("Expect").is_some() {
            stream.write_all(b"HTTP/1.1 100 Continue\r\n\r\n")?;
        }
        let deadline = Instant::now() + PATIENCE;
        while bytes.len() < length {
            more(stream, bytes, deadline)?;
        }
        bytes.truncate(length);
        request.body = std::mem::take(bytes);
        seat.has_asked();
        Ok(handler.answer(request))
    };
    let mut request = HttpRequest::default();
    let found = answer(&mut request, &mut stream, &mut bytes)?;
    send(&mut stream, &found, request.method == "HEAD")?;
    stream.shutdown(Shutdown::Write)?;
    let deadline = Instant::now() + AFTER;
    while more(&mut stream, &mut bytes, deadline).is_ok() {
        bytes.clear();
    }
    Ok(())
}

/// Reads more, until the deadline at most.
fn more(stream: &mut UnixStream, bytes: &mut Vec<u8>, deadline: Instant) -> io::Result<()> {
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() {
        return Err(ErrorKind::TimedOut.into());
    }
    // An accepted socket may block, whatever mode its listener has.
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut buffer = [0; 1024];
    let n = stream.read(&mut buffer)?;
    bytes.extend_from_slice(&buffer[..n]);
    if n > 0 { Ok(()) } else { Err(ErrorKind::UnexpectedEof.into()) }
}

fn send(stream: &mut UnixStream, answer: &HttpResponse, head_only: bool) -> io::Result<()> {
    let HttpResponse { status, kind, body } = answer;
    let reason = match status {
        200 => "OK",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        413 => "Content Too Large",
        431 => "Request Header Fields Too Large",
        _ => "Other",
    };
    let head = format!(
        "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\nReferrer-Policy: \
         no-referrer\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    if !head_only {
        stream.write_all(body.as_bytes())?;
    }
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_read_or_refused() {
        let all = |head: &str| HttpRequest::parse(format!("{head}\r\n\r\nbody").as_bytes());
        let parse = |head: &str| all(head).unwrap().unwrap().0;
        let head = parse("GET /a?b HTTP/1.1\r\nHost: x:1\r\nACCEPT:  y ");
        assert_eq!((head.method.as_str(), head.path.as_str()), ("GET", "/a?b"));
        assert_eq!(
            (head.header("host"), head.header("Accept"), head.header("z")),
            (Some("x:1"), Some("y"), None)
        );
        let many = format!("GET / HTTP/1.1{}", "\r\nA: b".repeat(MOST_HEADERS + 1));
        for bad in [
            "GET",
            "GET /",
            "GET / HTTP/2",
            "GET / x HTTP/1.1",
            "GET / HTTP/1.1\r\nno colon",
            "GET / HTTP/1.1\r\nContent-Length : 1",
            "G\u{1b}T / HTTP/1.1",
            "GET /\u{7} HTTP/1.1",
            "GET / HTTP/1.1\r\nA: \0",
            "\u{16}\u{3}\u{1}",
            &many,
        ] {
            assert!(all(bad).is_err(), "{bad}");
        }
        // Some clients send no carriage return. An incomplete head gives nothing.
        assert_eq!(HttpRequest::parse(b"GET / HTTP/1.1\n\nbody").unwrap().unwrap().1, 16);
        assert!(HttpRequest::parse(b"GET / HTTP/1.1\r\nHost: x\r\n").unwrap().is_none());
        // With two lengths it is not known which is meant.
        let twice = parse("POST / HTTP/1.1\r\nContent-Length: 1\r\ncontent-length: 2");
        assert_eq!(twice.length(), None);
        assert_eq!(parse("POST / HTTP/1.1\r\nContent-Length: 12").length(), Some(12));
        assert_eq!(parse("POST / HTTP/1.1\r\nContent-Length: +12").length(), None);
        assert_eq!(parse("GET / HTTP/1.1").length(), Some(0));
    }

    #[test]
    fn whoever_is_silent_longest_gives_way() {
        let seats = Arc::<ConnectionSlots>::default();
        let ended = Arc::<Mutex<Vec<usize>>>::default();
        let hand = |n: usize| -> CloseConnection {
            let ended = Arc::clone(&ended);
            Box::new(move || ended.lock().unwrap().push(n))
        };
        let mut all: Vec<ConnectionSlot> =
            (0..AT_ONCE).filter_map(|n| ConnectionSlots::take(&seats, hand(n))).collect();
        assert_eq!(all.len(), AT_ONCE);
        // The first request is complete, so it is answered.
        all[0].has_asked();
        for n in 0..3 {
            all.push(ConnectionSlots::take(&seats, hand(AT_ONCE + n)).unwrap());
        }
        assert_eq!(*ended.lock().unwrap(), [1, 2, 3]);
        // If all requests are complete, no connection is closed.
        all.iter().for_each(ConnectionSlot::has_asked);
        assert!(ConnectionSlots::take(&seats, hand(0)).is_none());
        all.truncate(AT_ONCE - 1);
        assert!(ConnectionSlots::take(&seats, hand(0)).is_some());
    }
}
