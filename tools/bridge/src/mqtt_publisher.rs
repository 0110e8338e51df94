//! The part of MQTT 3.1.1 (OASIS, 2014) that a publisher needs.
//! It is CONNECT with a last will, PUBLISH of `QoS` 0, PINGREQ and DISCONNECT.
//!
//! It subscribes to nothing. The broker answers a PINGREQ after everything that was sent before it (one ordered TCP
//! stream). An answered ping therefore confirms what was published, without the bookkeeping of `QoS` 1.

use std::io::{self, Error, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Silence after which the broker counts as gone.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest remaining length (section 2.2.3).
const LONGEST: usize = 268_435_455;

/// Identity of the client, and its last will.
pub(crate) struct ConnectOptions<'a> {
    pub client_id: &'a str,
    /// Name and password.
    pub user: Option<(&'a str, &'a [u8])>,
    pub keep_alive: Duration,
    /// Topic and payload of the last will, which is retained.
    pub will: (&'a str, &'a [u8]),
}

/// A connection to a broker.
pub(crate) struct BrokerConnection(TcpStream);

impl BrokerConnection {
    /// Connects to the broker at `HOST:PORT`.
    pub(crate) fn open(broker: &str, login: &ConnectOptions<'_>) -> io::Result<Self> {
        let mut last = Error::new(ErrorKind::NotFound, "the name has no address");
        for at in broker.to_socket_addrs()? {
            match TcpStream::connect_timeout(&at, PATIENCE) {
                Ok(stream) => return Self::over(stream, login),
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    fn over(stream: TcpStream, login: &ConnectOptions<'_>) -> io::Result<Self> {
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        let mut connection = Self(stream);
        connection.0.write_all(&packet(0x10, &connect(login)?)?)?;
        let mut answer = [0; 4];
        connection.0.read_exact(&mut answer)?;
        // CONNACK, section 3.2.
        match answer {
            [0x20, 2, _, 0] => Ok(connection),
            [0x20, 2, _, code] => Err(Error::other(refusal(code))),
            other => Err(Error::other(format!("it answered {other:02x?}: is it an MQTT broker?"))),
        }
    }

    /// Publishes a message; only the next ping confirms it.
    pub(crate) fn publish(&mut self, topic: &str, payload: &[u8], retain: bool) -> io::Result<()> {
        let mut body = text(topic)?;
        body.extend_from_slice(payload);
        self.0.write_all(&packet(0x30 | u8::from(retain), &body)?)
    }

    /// Waits until the broker has everything that was published so far.
    pub(crate) fn ping(&mut self) -> io::Result<()> {
        self.0.write_all(&[0xc0, 0])?;
        let mut answer = [0; 2];
        self.0.read_exact(&mut answer)?;
        if answer == [0xd0, 0] {
            Ok(())
        } else {
            Err(Error::other(format!("it answered {answer:02x?} to a ping")))
        }
    }
}

fn refusal(code: u8) -> String {
    let why = match code {
        1 => "it does not speak MQTT 3.1.1",
        2 => "it does not take this client id",
        3 => "it is not available",
        4 => "user or password is wrong",
        5 => "this user is not allowed",
        _ => return format!("refused with code {code}"),
    };
    format!("refused: {why}")
}

/// Variable header and payload of CONNECT, section 3.1.
fn connect(login: &ConnectOptions<'_>) -> io::Result<Vec<u8>> {
    let mut body = text("MQTT")?;
    // Clean session, will retained.
    let flags = 0x02 | 0x04 | 0x20 | if login.user.is_some() { 0xc0 } else { 0 };
    body.extend_from_slice(&[4, flags]);
    let keep_alive_s = u16::try_from(login.keep_alive.as_secs()).unwrap_or(u16::MAX);
    body.extend_from_slice(&keep_alive_s.to_be_bytes());
    body.extend(text(login.client_id)?);
    body.extend(text(login.will.0)?);
    body.extend(field(login.will.1)?);
    if let Some((name, password)) = login.user {
        body.extend(text(name)?);
        body.extend(field(password)?);
    }
    Ok(body)
}

fn text(text: &str) -> io::Result<Vec<u8>> {
    field(text.as_bytes())
}

/// A field with its length before it, section 1.5.3.
fn field(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let length = u16::try_from(bytes.len()).map_err(|_| {
        Error::new(ErrorKind::InvalidInput, format!("{} bytes in a field, at most 65535", bytes.len()))
    })?;
    Ok([&length.to_be_bytes()[..], bytes].concat())
}

fn packet(kind: u8, body: &[u8]) -> io::Result<Vec<u8>> {
    if body.len() > LONGEST {
        return Err(Error::new(ErrorKind::InvalidInput, format!("{} bytes in a packet", body.len())));
    }
    let mut bytes = vec![kind];
    let mut left = body.len();
    loop {
        let more = left > 127;
        bytes.push((left % 128) as u8 | if more { 0x80 } else { 0 });
        left /= 128;
        if !more {
            break;
        }
    }
    bytes.extend_from_slice(body);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The standard's examples: table 2.4, and figure 1.1 of section 1.5.3.
    #[test]
    fn lengths_and_fields_are_those_of_the_standard() {
        for (length, wanted) in [
            (0, vec![0]),
            (127, vec![0x7f]),
            (128, vec![0x80, 1]),
            (16_383, vec![0xff, 0x7f]),
            (16_384, vec![0x80, 0x80, 1]),
        ] {
            let bytes = packet(0x30, &vec![0; length]).unwrap();
            assert_eq!(&bytes[1..=wanted.len()], wanted, "{length}");
            assert_eq!(bytes.len(), 1 + wanted.len() + length);
        }
        assert_eq!(text("A\u{2a6d4}").unwrap(), [0, 5, 0x41, 0xf0, 0xaa, 0x9b, 0x94]);
        assert!(field(&vec![0; 65_536]).is_err());
    }
}
