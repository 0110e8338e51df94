//! Text files read whole: UTF-8, a byte-order mark dropped. Whoever names a pipe or a device is told so: nobody waits for what
//! never ends.

use crate::input::InputError;
use std::fs::{File, OpenOptions};
use std::io::Read as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

/// Nothing longer is read whole, bytes.
pub const LONGEST: u64 = 1 << 30;

/// Reads a text file.
///
/// # Errors
/// As [`bytes`], or it is not UTF-8.
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
    // Without waiting: a pipe that nobody writes to would hold us up before we could ask what it is.
    let opened = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(file);
    let opened = opened.map_err(|e| unreadable(file, &e))?;
    let is = opened.metadata().map_err(|e| unreadable(file, &e))?;
    let found = if is.is_file() {
        crate::write::is_input(&opened);
        return Ok(opened);
    } else if is.is_dir() {
        "a folder"
    } else {
        "a pipe, socket or device"
    };
    Err(InputError::whole(file, found, "a regular file"))
}

/// Opens what is there, a pipe too, to be read from its beginning to its end.
pub(crate) fn opened(file: &Path) -> Result<File, InputError> {
    let opened = File::open(file).map_err(|e| unreadable(file, &e))?;
    crate::write::is_input(&opened);
    Ok(opened)
}

/// UTF-8 text without its byte-order mark; `file` is its name in error messages.
///
/// # Errors
/// The place of the first byte that is not UTF-8.
pub fn decode(file: &Path, bytes: &[u8]) -> Result<String, InputError> {
    if let Some((found, expected)) = utf16(bytes) {
        return Err(InputError::at(file, 1, 1, found, expected));
    }
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

/// Text in UTF-16, as spreadsheets save it, by its mark or, without one, by the zero beside its first letter: what was found,
/// and how to mend it.
pub(crate) fn utf16(bytes: &[u8]) -> Option<(String, String)> {
    let (found, from) = match bytes {
        [0xff, 0xfe, ..] => ("text in UTF-16 (its mark 0xff 0xfe)", "UTF-16"),
        [0xfe, 0xff, ..] => ("text in UTF-16 (its mark 0xfe 0xff)", "UTF-16"),
        [1..=0x7f, 0, 1..=0x7f, 0, ..] => ("text in UTF-16 without its mark", "UTF-16LE"),
        [0, 1..=0x7f, 0, 1..=0x7f, ..] => ("text in UTF-16 without its mark", "UTF-16BE"),
        _ => return None,
    };
    Some((found.to_owned(), format!("{UTF8}, as `iconv -f {from} -t UTF-8 FILE > NEW` writes it")))
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
        for (bytes, says) in [
            (
                b"\xff\xfet\0,\0".as_slice(),
                "text in UTF-16 (its mark 0xff 0xfe), expected text in UTF-8, as `iconv -f UTF-16 -t UTF-8 FILE > NEW` writes it",
            ),
            (
                b"\xfe\xff\0t\0,",
                "text in UTF-16 (its mark 0xfe 0xff), expected text in UTF-8, as `iconv -f UTF-16 -t UTF-8 FILE > NEW` writes it",
            ),
            (
                b"t\0,\0",
                "text in UTF-16 without its mark, expected text in UTF-8, as `iconv -f UTF-16LE -t UTF-8 FILE > NEW` writes it",
            ),
        ] {
            assert_eq!(decode(file, bytes).unwrap_err().to_string(), format!("a.toml:1:1: found {says}"));
        }
        for (special, found) in [("/dev/zero", "a pipe, socket or device"), ("/tmp", "a folder")] {
            assert_eq!(read(Path::new(special)).unwrap_err().found, found);
        }
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        // Returns, and says why.
        assert_eq!(read(&pipe).unwrap_err().expected, "a regular file");
        assert!(read(Path::new("/nonexistent/a.toml")).unwrap_err().expected.contains("can be read"));
    }
}
