//! HTTP/1.1 for a few readers on this computer: one request a connection, each connection in a thread of its own, all within
//! limits of size and time. Whoever is slow holds up nobody else; a body is read once its head was found good. Where all places
//! are taken, the connection that has kept its request to itself longest gives way to a new one.
//!
//! Heads are read by `httparse`, which needs nothing else. `hyper` needs a run time (seventeen crates) and cannot drop
//! a slow client. `tiny_http` reads bodies on the thread that accepts, so one slow sender stops all.

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsFd;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A head, and a body, are no longer, bytes.
const LONGEST_HEAD: usize = 8192;
const LONGEST_BODY: usize = 4096;
/// A head has no more headers.
const MOST_HEADERS: usize = 64;
/// A head, and a body, take no longer to come.
const PATIENCE: Duration = Duration::from_secs(5);
/// Connections at one time.
const AT_ONCE: usize = 128;
/// How often is looked whether the server is to end, ms.
const LOOK_MS: u8 = 50;
/// What still comes after the answer is taken off so long, so that closing does not take the answer with it.
const AFTER: Duration = Duration::from_millis(200);

/// What was asked.
#[derive(Debug, Default)]
pub(crate) struct Request {
    pub method: String,
    pub path: String,
    headers: Vec<(String, String)>,
    /// Empty until the head was found good.
    pub body: Vec<u8>,
}

impl Request {
    /// A header's value.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, v)| v.as_str())
    }

    /// Length of the body, bytes; none where it is not said in plain digits, once.
    fn length(&self) -> Option<usize> {
        let said = |name: &str| self.headers.iter().filter(|(n, _)| n.eq_ignore_ascii_case(name)).count();
        if said("Transfer-Encoding") > 0 || said("Content-Length") > 1 {
            return None;
        }
        let text = self.header("Content-Length").unwrap_or("0");
        text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok()).flatten()
    }

    /// Reads a head and says how long it is; none while there is not all of it.
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

/// What is answered.
#[derive(Debug)]
pub(crate) struct Answer {
    pub status: u16,
    pub kind: &'static str,
    pub body: String,
}

impl Answer {
    /// A line for people.
    pub(crate) fn plain(status: u16, text: &str) -> Self {
        Self { status, kind: "text/plain", body: format!("{text}\n") }
    }
}

/// Who answers.
pub(crate) trait Handler: Send + Sync {
    /// Whether a request with this head is to be read on.
    ///
    /// # Errors
    /// What is answered instead.
    fn may(&self, head: &Request) -> Result<(), Answer>;

    /// The answer to a whole request.
    fn answer(&self, request: &Request) -> Answer;
}

enum Listener {
    Tcp(TcpListener),
    Unix(UnixListener),
}

/// A listening server.
pub(crate) struct Server(Listener);

impl Server {
    /// At a port; 0 takes a free one.
    pub(crate) fn tcp(at: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(at)?;
        listener.set_nonblocking(true)?;
        Ok(Self(Listener::Tcp(listener)))
    }

    /// At a path.
    pub(crate) fn unix(path: &Path) -> io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self(Listener::Unix(listener)))
    }

    /// Where it listens, when at a port.
    pub(crate) fn address(&self) -> io::Result<SocketAddr> {
        match &self.0 {
            Listener::Tcp(listener) => listener.local_addr(),
            Listener::Unix(_) => Err(ErrorKind::Unsupported.into()),
        }
    }

    /// Answers until `done` says so.
    ///
    /// # Errors
    /// The listening socket failed.
    pub(crate) fn serve<H: Handler + 'static>(&self, handler: &Arc<H>, done: &AtomicBool) -> io::Result<()> {
        let seats = Arc::<Seats>::default();
        while !done.load(Ordering::Acquire) {
            let fd = match &self.0 {
                Listener::Tcp(listener) => listener.as_fd(),
                Listener::Unix(listener) => listener.as_fd(),
            };
            poll(&mut [PollFd::new(fd, PollFlags::POLLIN)], PollTimeout::from(LOOK_MS)).ok();
            let accepted = match &self.0 {
                Listener::Tcp(listener) => listener.accept().map(|(s, _)| Box::new(s) as Box<dyn Stream>),
                Listener::Unix(listener) => listener.accept().map(|(s, _)| Box::new(s) as Box<dyn Stream>),
            };
            let stream = match accepted {
                Ok(stream) => stream,
                Err(e) if e.kind() == ErrorKind::InvalidInput => return Err(e),
                Err(e) if e.kind() == ErrorKind::WouldBlock => continue,
                Err(_) => {
                    // Gone again, or no descriptor left: those that are connected end in time.
                    std::thread::sleep(Duration::from_millis(5));
                    continue;
                }
            };
            let Some(seat) = stream.end_both().ok().and_then(|hand| Seats::take(&seats, hand)) else {
                continue;
            };
            let handler = Arc::clone(handler);
            let started = std::thread::Builder::new().name("http".into()).spawn(move || {
                // Whoever goes away early is his own affair.
                let _ = converse(stream, &*handler, &seat);
            });
            // Without a thread the connection is closed again.
            drop(started);
        }
        Ok(())
    }
}

/// Ends a connection from outside its thread.
type CloseConnection = Box<dyn Fn() + Send>;

/// The connections that there are, and of those whose request is not all there, how to end them: the oldest first.
#[derive(Default)]
struct Seats(Mutex<(u64, usize, BTreeMap<u64, CloseConnection>)>);

/// A connection's place, until it is dropped.
struct Seat {
    of: Arc<Seats>,
    number: u64,
}

impl Seats {
    /// A place; where there is none the one who has kept its request to itself longest gives way. None where all have asked.
    fn take(of: &Arc<Self>, hand: CloseConnection) -> Option<Seat> {
        let mut seats = of.lock();
        let (next, taken, silent) = &mut *seats;
        if *taken >= AT_ONCE {
            let (_, oldest) = silent.pop_first()?;
            oldest();
        }
        *next += 1;
        *taken += 1;
        silent.insert(*next, hand);
        Some(Seat { of: Arc::clone(of), number: *next })
    }

    fn lock(&self) -> MutexGuard<'_, (u64, usize, BTreeMap<u64, CloseConnection>)> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Seat {
    /// The request is all there: it is answered, whoever comes.
    fn has_asked(&self) {
        self.of.lock().2.remove(&self.number);
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        let mut seats = self.of.lock();
        seats.1 -= 1;
        seats.2.remove(&self.number);
    }
}

trait Stream: Read + Write + Send {
    fn patience(&self, time: Duration) -> io::Result<()>;
    fn end(&self) -> io::Result<()>;
    /// What ends both directions, from wherever it is called.
    fn end_both(&self) -> io::Result<CloseConnection>;
}

macro_rules! stream {
    ($($kind:ty),*) => {$(
        impl Stream for $kind {
            fn patience(&self, time: Duration) -> io::Result<()> {
                // An accepted socket may wait, whatever its listener does.
                self.set_nonblocking(false)?;
                self.set_read_timeout(Some(time.max(Duration::from_millis(1))))?;
                self.set_write_timeout(Some(PATIENCE))
            }

            fn end(&self) -> io::Result<()> {
                self.shutdown(Shutdown::Write)
            }

            fn end_both(&self) -> io::Result<CloseConnection> {
                let other = self.try_clone()?;
                Ok(Box::new(move || drop(other.shutdown(Shutdown::Both))))
            }
        }
    )*};
}
stream!(TcpStream, UnixStream);

/// One request and its answer.
fn converse(mut stream: Box<dyn Stream>, handler: &dyn Handler, seat: &Seat) -> io::Result<()> {
    let mut bytes = Vec::new();
    let answer =
        |request: &mut Request, stream: &mut dyn Stream, bytes: &mut Vec<u8>| -> io::Result<Answer> {
            let deadline = Instant::now() + PATIENCE;
            let (head, end) = loop {
                match Request::parse(bytes) {
                    Ok(Some(found)) => break found,
                    Ok(None) if bytes.len() > LONGEST_HEAD => {
                        return Ok(Answer::plain(431, "the head of the request is too long"));
                    }
                    Ok(None) => more(stream, bytes, deadline)?,
                    Err(why) => return Ok(Answer::plain(400, &format!("this is no HTTP/1.1: {why}"))),
                }
            };
            *request = head;
            bytes.drain(..end);
            if let Err(refusal) = handler.may(request) {
                return Ok(refusal);
            }
            let Some(length) = request.length().filter(|length| *length <= LONGEST_BODY) else {
                return Ok(Answer::plain(413, "a body of known and small length was expected"));
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
    let mut request = Request::default();
    let found = answer(&mut request, &mut *stream, &mut bytes)?;
    send(&mut *stream, &found, request.method == "HEAD")?;
    stream.end()?;
    let deadline = Instant::now() + AFTER;
    while more(&mut *stream, &mut bytes, deadline).is_ok() {
        bytes.clear();
    }
    Ok(())
}

/// Reads on, until the deadline at most.
fn more(stream: &mut dyn Stream, bytes: &mut Vec<u8>, deadline: Instant) -> io::Result<()> {
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() {
        return Err(ErrorKind::TimedOut.into());
    }
    stream.patience(left)?;
    let mut buffer = [0; 1024];
    match stream.read(&mut buffer)? {
        0 => Err(ErrorKind::UnexpectedEof.into()),
        n => {
            bytes.extend_from_slice(&buffer[..n]);
            Ok(())
        }
    }
}

fn send(stream: &mut dyn Stream, answer: &Answer, head_only: bool) -> io::Result<()> {
    let Answer { status, kind, body } = answer;
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
        let all = |head: &str| Request::parse(format!("{head}\r\n\r\nbody").as_bytes());
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
        // Some send no carriage return; of what is not all there nothing is known.
        assert_eq!(Request::parse(b"GET / HTTP/1.1\n\nbody").unwrap().unwrap().1, 16);
        assert!(Request::parse(b"GET / HTTP/1.1\r\nHost: x\r\n").unwrap().is_none());
        // Two lengths: which of them is meant is nobody's to guess.
        let twice = parse("POST / HTTP/1.1\r\nContent-Length: 1\r\ncontent-length: 2");
        assert_eq!(twice.length(), None);
        assert_eq!(parse("POST / HTTP/1.1\r\nContent-Length: 12").length(), Some(12));
        assert_eq!(parse("POST / HTTP/1.1\r\nContent-Length: +12").length(), None);
        assert_eq!(parse("GET / HTTP/1.1").length(), Some(0));
    }

    #[test]
    fn whoever_is_silent_longest_gives_way() {
        let seats = Arc::<Seats>::default();
        let ended = Arc::<Mutex<Vec<usize>>>::default();
        let hand = |n: usize| -> CloseConnection {
            let ended = Arc::clone(&ended);
            Box::new(move || ended.lock().unwrap().push(n))
        };
        let mut all: Vec<Seat> = (0..AT_ONCE).filter_map(|n| Seats::take(&seats, hand(n))).collect();
        assert_eq!(all.len(), AT_ONCE);
        // The first has asked: it is answered.
        all[0].has_asked();
        for n in 0..3 {
            all.push(Seats::take(&seats, hand(AT_ONCE + n)).unwrap());
        }
        assert_eq!(*ended.lock().unwrap(), [1, 2, 3]);
        // Where all have asked nobody is cut off.
        all.iter().for_each(Seat::has_asked);
        assert!(Seats::take(&seats, hand(0)).is_none());
        all.truncate(AT_ONCE - 1);
        assert!(Seats::take(&seats, hand(0)).is_some());
    }
}
