//! Text files read whole: UTF-8, a byte-order mark dropped.

use crate::input::InputError;
use std::path::Path;

/// Reads a text file.
///
/// # Errors
/// It cannot be read or is not UTF-8.
pub fn read(file: &Path) -> Result<String, InputError> {
    decode(file, &std::fs::read(file).map_err(|e| unreadable(file, &e))?)
}

/// UTF-8 text without its byte-order mark; `file` is its name in error messages.
///
/// # Errors
/// The place of the first byte that is not UTF-8.
pub fn decode(file: &Path, bytes: &[u8]) -> Result<String, InputError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(e) => {
            let at = e.valid_up_to();
            let good = String::from_utf8_lossy(&bytes[..at]);
            Err(InputError::at_offset(file, &good, good.len(), not_utf8(bytes[at]), UTF8))
        }
    }
}

/// A number as a person reads it: as it is, or with a power of ten where it would be a row of zeros.
#[must_use]
pub fn short(v: f64) -> String {
    if v == 0.0 || (1e-6..1e12).contains(&v.abs()) { v.to_string() } else { format!("{v:e}") }
}

/// A file that the system does not let us read.
#[must_use]
pub fn unreadable(file: &Path, error: &std::io::Error) -> InputError {
    InputError::whole(file, error.to_string(), "a file that can be read")
}

pub(crate) const UTF8: &str = "text in UTF-8";

pub(crate) fn not_utf8(byte: u8) -> String {
    format!("byte 0x{byte:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_dropped_and_a_strange_byte_has_its_place() {
        let file = Path::new("a.toml");
        assert_eq!(decode(file, b"\xef\xbb\xbfa = 1\n").unwrap(), "a = 1\n");
        let error = decode(file, "µ = 1\nb = '\u{e9}'".replace('\u{e9}', "\u{1}").as_bytes());
        assert!(error.is_ok());
        let error = decode(file, b"\xc2\xb5 = 1\nb = '\xe9'\n").unwrap_err();
        assert_eq!(error.to_string(), "a.toml:2:6: found byte 0xe9, expected text in UTF-8");
        assert!(read(Path::new("/nonexistent/a.toml")).unwrap_err().expected.contains("can be read"));
    }
}
