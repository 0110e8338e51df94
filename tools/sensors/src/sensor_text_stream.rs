//! A feed of lines, as a PLC, a microcontroller or a gateway sends them.

use nix::fcntl::OFlag;
use nix::sys::socket::{setsockopt, sockopt};
use rtec_files::message_text::quoted;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Read};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::time::Duration;

/// A feed of lines `NAME VALUE` or `NAME=VALUE`.
/// It comes from `host:port` (TCP) or a serial device.
#[derive(Debug, Default)]
pub struct SensorTextStream {
    pub(crate) from: String,
    stream: Option<TcpOrSerialStream>,
    partial: Vec<u8>,
    /// Keys to be read; if not given, the first [`KEYS`] keys of the feed.
    keys: Option<BTreeSet<String>>,
    values: BTreeMap<String, f64>,
    /// Reason why there is no connection.
    trouble: String,
    /// The time of each key's last value, and the last unreadable line since then.
    came: BTreeMap<String, (f64, Option<String>)>,
    /// Lines that could not be read, until [`SensorTextStream::odd_lines`] takes them.
    /// At most [`ODD_LINES`] are kept.
    odd: Vec<String>,
    /// Total number of lines that could not be read.
    refused: u64,
    /// Time of connection, and of the last data, s.
    connected_at: f64,
    bytes_at: f64,
    /// Time without data after which the connection is closed, s.
    idle_s: f64,
    /// Time of the last poll, s.
    now_s: f64,
    retry_at: f64,
    /// Time of the next check that the device is still the opened one, s.
    check_at: f64,
}

/// Largest number of keys of a feed whose keys are not given.
const KEYS: usize = 256;
/// Largest amount that one poll reads, bytes.
/// A poll comes every few tens of milliseconds, and a sensor's line has some tens of bytes.
const MOST: usize = 256 << 10;
/// Number of unreadable lines whose text is kept.
const ODD_LINES: usize = 16;
/// Longest line that a sensor can send, bytes.
const LONGEST_LINE: usize = 4096;

/// Largest possible reading, °C; larger ones and NaN are refused.
const LARGEST: f64 = 1e6;

/// Default time without data after which a connection is closed, s.
const IDLE_S: f64 = 30.0;
/// Time between two attempts to connect, or two checks for a device, s.
const RETRY_S: f64 = 5.0;

#[derive(Debug)]
enum TcpOrSerialStream {
    Tcp(TcpStream),
    Serial(fs::File),
}

impl SensorTextStream {
    /// A feed that connects at its first poll.
    pub fn new(from: &str) -> Self {
        Self {
            from: from.to_owned(),
            trouble: "not connected yet".to_owned(),
            connected_at: f64::NEG_INFINITY,
            bytes_at: f64::NEG_INFINITY,
            idle_s: IDLE_S,
            now_s: f64::NEG_INFINITY,
            retry_at: f64::NEG_INFINITY,
            check_at: f64::NEG_INFINITY,
            ..Self::default()
        }
    }

    /// A feed from which only these keys are read and kept.
    pub fn of(from: &str, keys: impl IntoIterator<Item = String>) -> Self {
        Self { keys: Some(keys.into_iter().collect()), ..Self::new(from) }
    }

    /// Sets the time without data after which a connection is closed, s.
    #[must_use]
    pub fn idle_after(self, idle_s: f64) -> Self {
        Self { idle_s: idle_s.max(RETRY_S), ..self }
    }

    fn connect(&self) -> io::Result<TcpOrSerialStream> {
        if self.from.starts_with('/') {
            let file = fs::OpenOptions::new()
                .read(true)
                .custom_flags((OFlag::O_NONBLOCK | OFlag::O_NOCTTY).bits())
                .open(&self.from)?;
            return Ok(TcpOrSerialStream::Serial(file));
        }
        let none = || io::Error::new(io::ErrorKind::NotFound, "no such host");
        let address = self.from.to_socket_addrs()?.next().ok_or_else(none)?;
        let stream = TcpStream::connect_timeout(&address, Duration::from_millis(200))?;
        stream.set_nonblocking(true)?;
        // The other side may lose its power without notice; the kernel then probes the connection.
        setsockopt(&stream, sockopt::KeepAlive, &true)?;
        setsockopt(&stream, sockopt::TcpKeepIdle, &10)?;
        setsockopt(&stream, sockopt::TcpKeepInterval, &5)?;
        setsockopt(&stream, sockopt::TcpKeepCount, &3)?;
        Ok(TcpOrSerialStream::Tcp(stream))
    }

    /// The value of a key that came with the last poll.
    ///
    /// # Errors
    /// The reason why there is no such value.
    pub fn value(&self, key: &str) -> Result<f64, String> {
        self.values.get(key).copied().ok_or_else(|| self.why_not(key))
    }

    /// Reason why a key has no value now.
    fn why_not(&self, key: &str) -> String {
        if self.stream.is_none() {
            return self.trouble.clone();
        }
        let since = |s: f64| (self.now_s - s).max(0.0);
        match self.came.get(key) {
            Some((_, Some(odd))) => odd.clone(),
            Some((at, None)) if self.bytes_at >= self.connected_at => {
                format!("connected, no line {key} for {:.0} s", since(at.max(self.connected_at)))
            }
            None if self.bytes_at >= self.connected_at => {
                format!("connected, no line {key} for {:.0} s", since(self.connected_at))
            }
            _ => format!("connected, nothing came for {:.0} s", since(self.connected_at)),
        }
    }

    /// Takes the lines that could not be read since the last call, in words.
    pub fn odd_lines(&mut self) -> Vec<String> {
        std::mem::take(&mut self.odd)
    }

    /// Number of lines that could not be read.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Reason why an earlier connection is lost.
    /// `None` while it is open, or if there never was one.
    pub fn lost(&self) -> Option<&str> {
        (self.stream.is_none() && self.connected_at.is_finite()).then_some(self.trouble.as_str())
    }

    fn refuse(&mut self, odd: String) {
        self.refused += 1;
        if self.odd.len() < ODD_LINES {
            self.odd.push(odd);
        }
    }

    /// Reads new data. A value is shown for one poll only, so that silence is seen.
    pub fn poll(&mut self, now_s: f64) {
        self.values.clear();
        self.now_s = now_s;
        let silent_s = now_s - self.bytes_at.max(self.connected_at);
        if matches!(self.stream, Some(TcpOrSerialStream::Tcp(_))) && silent_s > self.idle_s {
            self.lose(format!("nothing came for {silent_s:.0} s: connecting again"), now_s);
            self.retry_at = now_s;
        }
        if let Some(TcpOrSerialStream::Serial(file)) = &self.stream
            && now_s >= self.check_at
        {
            self.check_at = now_s + RETRY_S;
            // A device that was unplugged reads as a silent one, and returns as another file.
            if let Err(gone) = same(file, Path::new(&self.from)) {
                self.trouble = gone.to_string();
                self.stream = None;
            }
        }
        if self.stream.is_none() && now_s >= self.retry_at {
            match self.connect() {
                Ok(s) => {
                    self.stream = Some(s);
                    self.connected_at = now_s;
                }
                Err(e) => {
                    self.trouble = e.to_string();
                    self.retry_at = now_s + RETRY_S;
                }
            }
        }
        let mut buffer = [0; 4096];
        let mut left = MOST;
        while let Some(stream) = &mut self.stream {
            if left == 0 {
                // Its values would be old by the time they are read, without end.
                self.lose(format!("it sends more than {MOST} bytes between two looks"), now_s);
                return;
            }
            let got = match stream {
                TcpOrSerialStream::Tcp(s) => s.read(&mut buffer),
                TcpOrSerialStream::Serial(s) => s.read(&mut buffer),
            };
            match got {
                Ok(0) if matches!(stream, TcpOrSerialStream::Serial(_)) => break,
                Ok(n) if n > 0 => {
                    left = left.saturating_sub(n);
                    self.bytes_at = now_s;
                    self.partial.extend_from_slice(&buffer[..n]);
                    self.take_lines();
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                end => {
                    self.lose(
                        end.err().map_or("closed by the other side".to_owned(), |e| e.to_string()),
                        now_s,
                    );
                }
            }
        }
    }

    /// Closes a connection and discards its data.
    fn lose(&mut self, why: String, now_s: f64) {
        self.trouble = why;
        self.stream = None;
        self.partial.clear();
        self.values.clear();
        self.retry_at = now_s + RETRY_S;
    }

    fn take_lines(&mut self) {
        let mut begin = 0;
        while let Some(end) = self.partial[begin..].iter().position(|b| *b == b'\n') {
            let line = String::from_utf8_lossy(&self.partial[begin..begin + end]).into_owned();
            begin += end + 1;
            let odd = || format!("{} is no line NAME VALUE", quoted(line.trim()));
            let mut words = line.trim().splitn(2, ['=', ' ', '\t', ',']);
            let (key, value) = (words.next().unwrap_or_default(), words.next());
            if let Some(value) = value {
                let key = key.trim();
                let read = self.keys.as_ref().is_none_or(|keys| keys.contains(key));
                if !read || !self.came.contains_key(key) && self.came.len() >= KEYS {
                    continue;
                }
                let came = self.came.entry(key.to_owned()).or_insert((f64::NEG_INFINITY, None));
                let value = value.trim().parse::<f64>().ok();
                if let Some(v) = value.filter(|v| v.abs() <= LARGEST) {
                    self.values.insert(key.to_owned(), v);
                    *came = (self.now_s, None);
                } else {
                    came.1 = Some(odd());
                    self.refuse(odd());
                }
            } else if !key.is_empty() {
                self.refuse(odd());
            }
        }
        self.partial.drain(..begin);
        // A sender that never ends its line is not a sensor.
        if self.partial.len() > LONGEST_LINE {
            self.partial.clear();
            self.refuse(format!("a line longer than {LONGEST_LINE} bytes"));
        }
    }
}

/// Whether a path still names the file that was opened.
fn same(file: &fs::File, path: &Path) -> io::Result<()> {
    let (open, now) = (file.metadata()?, fs::metadata(path)?);
    if (open.dev(), open.ino()) == (now.dev(), now.ino()) {
        return Ok(());
    }
    Err(io::Error::other("it was taken away, and is another one now"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::net::TcpListener;

    /// Hostile network input is bounded: escapes, endless keys, lines and streams.
    #[test]
    fn whatever_comes_over_the_network_stays_within_bounds() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let from = server.local_addr().unwrap().to_string();
        let mut feed = SensorTextStream::of(&from, ["T1".to_owned()]);
        feed.poll(0.0);
        let (mut peer, _) = server.accept().unwrap();
        let until = |feed: &mut SensorTextStream, is: &dyn Fn(&SensorTextStream) -> bool| {
            for _ in 0..20_000 {
                feed.poll(1.0);
                if is(feed) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            panic!("{feed:?}");
        };
        peer.write_all(b"T1 \x1b[2J\x1b]0;owned\x07\n").unwrap();
        let why = |feed: &SensorTextStream| feed.value("T1").unwrap_err();
        until(&mut feed, &|f| why(f).contains("is no line"));
        assert!(!why(&feed).chars().any(char::is_control), "{:?}", why(&feed));
        for wild in ["1e308", "-1e7", "inf", "nan"] {
            peer.write_all(format!("T1 {wild}\n").as_bytes()).unwrap();
            until(&mut feed, &|f| why(f).contains(&format!("'T1 {wild}' is no line")));
            assert_eq!(feed.values.get("T1"), None);
        }
        for n in 0..10_000 {
            writeln!(peer, "K{n} 1").unwrap();
        }
        peer.write_all(b"T1 20.5\n").unwrap();
        until(&mut feed, &|f| f.values.contains_key("T1"));
        assert_eq!(feed.values.len(), 1, "keys that nobody reads are not kept");
        peer.write_all(&[b'x'; LONGEST_LINE + 1]).unwrap();
        until(&mut feed, &|f| f.odd.iter().any(|odd| odd.contains("longer than")));
        assert!(feed.partial.len() <= LONGEST_LINE && feed.odd.len() <= ODD_LINES);
        // A sender without pauses: every poll ends, and soon the connection is closed.
        let flood = std::thread::spawn(move || while peer.write_all(&[b'\n'; 4096]).is_ok() {});
        until(&mut feed, &|f| f.trouble.contains("between two looks"));
        assert!(feed.stream.is_none());
        flood.join().unwrap();
        // If the keys are not given, at most this many are kept.
        let mut feed = SensorTextStream::new(&from);
        for n in 0..10_000 {
            feed.partial.extend_from_slice(format!("K{n} 1\n").as_bytes());
        }
        feed.take_lines();
        assert_eq!(feed.values.len(), KEYS);
    }

    /// Regression: a serial adapter stayed silent after it was plugged in again.
    #[test]
    fn a_device_that_comes_back_is_opened_again() {
        let directory = tempfile::tempdir().unwrap();
        let device = directory.path().join("ttyUSB0");
        fs::write(&device, "T1 20\n").unwrap();
        let mut feed = SensorTextStream::new(device.to_str().unwrap());
        feed.poll(0.0);
        assert_eq!(feed.value("T1"), Ok(20.0));
        fs::remove_file(&device).unwrap();
        feed.poll(6.0);
        assert!(feed.value("T1").is_err_and(|why| why.contains("No such file")), "{:?}", feed.value("T1"));
        fs::write(&device, "T1 21\n").unwrap();
        feed.poll(12.0);
        assert_eq!(feed.value("T1"), Ok(21.0));
        // At once another device in its place.
        let other = directory.path().join("other");
        fs::write(&other, "T1 22\n").unwrap();
        fs::rename(&other, &device).unwrap();
        feed.poll(18.0);
        assert_eq!(feed.value("T1"), Ok(22.0));
    }
}
