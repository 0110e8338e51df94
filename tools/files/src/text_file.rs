//! Reads whole text files: UTF-8 or UTF-16, a byte-order mark dropped.
//! A pipe or a device is refused, because it may never end.

use crate::file_kind::FileKind;
use crate::input_error::InputError;
use encoding_rs::{Encoding, UTF_16BE, UTF_16LE};
use std::borrow::Cow;
use std::fs::{File, OpenOptions};
use std::io::Read as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

/// The longest file that is read whole, bytes.
pub const LONGEST: u64 = 1 << 30;

/// Reads a text file.
///
/// # Errors
/// As [`bytes`], or it is neither UTF-8 nor UTF-16.
pub fn read(file: &Path) -> Result<String, InputError> {
    decode(file, &bytes(file)?)
}

/// Reads a file whole.
///
/// # Errors
/// It cannot be read, is no regular file (a folder, a pipe, a device), or is longer than [`LONGEST`].
pub fn bytes(file: &Path) -> Result<Vec<u8>, InputError> {
    let mut content = Vec::new();
    let opened = open_regular(file)?;
    opened.take(LONGEST + 1).read_to_end(&mut content).map_err(|e| unreadable(file, &e))?;
    if content.len() as u64 > LONGEST {
        return Err(InputError::whole(file, format!("more than {LONGEST} bytes"), "a shorter file"));
    }
    Ok(content)
}

/// Opens a regular file, and nothing else.
///
/// # Errors
/// It cannot be opened, or is no regular file.
pub fn open_regular(file: &Path) -> Result<File, InputError> {
    // Non-blocking, because opening a pipe without a writer would wait before its kind could be checked.
    let opened = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(file);
    let opened = opened.map_err(|e| unreadable(file, &e))?;
    let is = opened.metadata().map_err(|e| unreadable(file, &e))?;
    let found = if is.is_file() {
        crate::atomic_write::is_input(&opened);
        return Ok(opened);
    } else if is.is_dir() {
        "a folder"
    } else {
        "a pipe, socket or device"
    };
    Err(InputError::whole(file, found, "a regular file"))
}

/// Opens a file, or a pipe, that will be read once from beginning to end.
pub(crate) fn opened(file: &Path) -> Result<File, InputError> {
    let opened = File::open(file).map_err(|e| unreadable(file, &e))?;
    crate::atomic_write::is_input(&opened);
    Ok(opened)
}

/// Decodes UTF-8 or UTF-16 text without its byte-order mark.
/// `file` is its name in error messages.
///
/// # Errors
/// The place of the first byte that is not UTF-8; UTF-16 with half a character in it.
pub fn decode(file: &Path, bytes: &[u8]) -> Result<String, InputError> {
    if let Some((encoding, mark)) = utf16(bytes) {
        let text = encoding.decode_without_bom_handling_and_without_replacement(&bytes[mark..]);
        return text.map(Cow::into_owned).ok_or_else(|| InputError::whole(file, BROKEN_UTF16, UTF8));
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_owned()),
        Err(e) => {
            if let Some(kind) = FileKind::of_bytes(bytes) {
                return Err(InputError::whole(file, kind.name(), kind.as_text()));
            }
            let at = e.valid_up_to();
            let good = String::from_utf8_lossy(&bytes[..at]);
            Err(InputError::at_offset(file, &good, good.len(), not_utf8(bytes[at]), UTF8))
        }
    }
}

/// Decodes text in UTF-8 or UTF-16, or else in Windows-1252.
/// Many loggers write a degree sign in Windows-1252. The second value names the encoding if it is not UTF-8.
///
/// # Errors
/// As [`decode`], if the bytes are not text of Windows-1252 either.
pub fn decode_western(file: &Path, bytes: &[u8]) -> Result<(String, Option<&'static str>), InputError> {
    let error = match decode(file, bytes) {
        Ok(text) => return Ok((text, utf16(bytes).map(|_| "UTF-16"))),
        Err(error) => error,
    };
    if utf16(bytes).is_some() || !is_western(bytes) {
        return Err(error);
    }
    Ok((western(bytes), Some(WESTERN)))
}

/// The message for text that is neither UTF-8 nor UTF-16.
pub(crate) const WESTERN: &str = "Windows-1252: it is no UTF-8";

/// Whether bytes may be text in Windows-1252: printable characters only.
pub(crate) fn is_western(bytes: &[u8]) -> bool {
    bytes.iter().all(|byte| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0xa0..))
}

/// Decodes Windows-1252.
pub(crate) fn western(bytes: &[u8]) -> String {
    encoding_rs::WINDOWS_1252.decode_without_bom_handling(bytes).0.into_owned()
}

/// A number rounded to fifteen digits, which a float keeps of any decimal number.
/// 0.1 + 0.2 gives 0.3.
pub fn rounded(v: f64) -> f64 {
    format!("{v:.14e}").parse().unwrap_or(v)
}

/// A number in a form for people.
/// It has a power of ten if it would otherwise have many zeros.
pub fn short(v: f64) -> String {
    let v = rounded(v);
    if v == 0.0 || (1e-6..1e12).contains(&v.abs()) { v.to_string() } else { format!("{v:e}") }
}

/// The finding that the system refuses to read a file.
pub fn unreadable(file: &Path, error: &std::io::Error) -> InputError {
    InputError::whole(file, error.to_string(), "a file that can be read")
}

/// The encoding of UTF-16 text, and the length of its byte-order mark.
/// Spreadsheets save such text. Without a mark, the zeros beside the first letters show it.
pub(crate) fn utf16(bytes: &[u8]) -> Option<(&'static Encoding, usize)> {
    match bytes {
        [0xff, 0xfe, ..] => Some((UTF_16LE, 2)),
        [0xfe, 0xff, ..] => Some((UTF_16BE, 2)),
        [1..=0x7f, 0, 1..=0x7f, 0, ..] => Some((UTF_16LE, 0)),
        [0, 1..=0x7f, 0, 1..=0x7f, ..] => Some((UTF_16BE, 0)),
        _ => None,
    }
}

pub(crate) const BROKEN_UTF16: &str = "text in UTF-16 with half a character in it";

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
        for bytes in [b"\xff\xfet\0,\0".as_slice(), b"\xfe\xff\0t\0,", b"t\0,\0", b"\0t\0,"] {
            assert_eq!(decode(file, bytes).unwrap(), "t,");
        }
        assert_eq!(decode(file, b"\xff\xfet\0,").unwrap_err().found, BROKEN_UTF16);
        assert_eq!(decode_western(file, b"T (\xb0C)\n").unwrap(), ("T (°C)\n".to_owned(), Some(WESTERN)));
        assert_eq!(decode_western(file, b"t\0\n\0").unwrap(), ("t\n".to_owned(), Some("UTF-16")));
        assert_eq!(decode_western(file, "T (°C)".as_bytes()).unwrap(), ("T (°C)".to_owned(), None));
        assert!(decode_western(file, b"\x89PNG\0").is_err());
        for (special, found) in [("/dev/zero", "a pipe, socket or device"), ("/tmp", "a folder")] {
            assert_eq!(read(Path::new(special)).unwrap_err().found, found);
        }
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        // It returns at once, with the reason.
        assert_eq!(read(&pipe).unwrap_err().expected, "a regular file");
        assert!(read(Path::new("/nonexistent/a.toml")).unwrap_err().expected.contains("can be read"));
    }
}
