//! Buffered input of any length that knows its line number.
//! It serves rows of a CSV and words of a VCD.

use crate::input_error::InputError;
use crate::text_file::{BROKEN_UTF16, UTF8, unreadable, utf16};
use encoding_rs::{Decoder, DecoderResult};
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Bytes held of the input; also the longest line or word that is read.
pub(crate) const BUFFER: usize = 128 * 1024;

/// A decoder from UTF-16 input to the buffer's UTF-8.
struct Utf16Decoder {
    decoder: Decoder,
    /// Bytes of the input that are not yet decoded.
    raw: Vec<u8>,
    ended: bool,
}

impl std::fmt::Debug for Utf16Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Utf16").field("raw", &self.raw.len()).finish_non_exhaustive()
    }
}

/// The input and the part of it that is in the buffer.
#[derive(Debug)]
pub(crate) struct LineReader<R> {
    pub(crate) file: PathBuf,
    input: R,
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    exhausted: bool,
    utf16: Option<Utf16Decoder>,
    /// Lines taken so far: the number of the present line, from 1.
    pub(crate) line: usize,
    /// Characters of the present line that have already left the buffer.
    gone: usize,
    /// Where the present line begins in the buffer.
    line_start: usize,
}

impl<R: Read> LineReader<R> {
    /// Begins to read; a byte-order mark is dropped.
    pub(crate) fn new(file: &Path, input: R) -> Result<Self, InputError> {
        let buffer = vec![0; BUFFER].into_boxed_slice();
        let file = file.to_owned();
        let mut lines = Self {
            file,
            input,
            buffer,
            start: 0,
            end: 0,
            exhausted: false,
            utf16: None,
            line: 0,
            gone: 0,
            line_start: 0,
        };
        // Four bytes are enough to recognise UTF-16 without a mark.
        while lines.end < 4 && lines.fill()? {}
        if let Some((encoding, mark)) = utf16(&lines.buffer[..lines.end]) {
            let raw = lines.buffer[mark..lines.end].to_vec();
            let decoder = encoding.new_decoder_without_bom_handling();
            lines.utf16 = Some(Utf16Decoder { decoder, raw, ended: lines.exhausted });
            (lines.end, lines.exhausted) = (0, false);
        }
        if lines.buffer[..lines.end].starts_with(b"\xEF\xBB\xBF") {
            lines.buffer.copy_within(3..lines.end, 0);
            lines.end -= 3;
        }
        Ok(lines)
    }

    #[inline]
    pub(crate) fn bytes(&self, range: Range<usize>) -> &[u8] {
        &self.buffer[range]
    }

    /// The next `N` bytes, if the buffer has them.
    #[inline]
    pub(crate) fn ahead<const N: usize>(&self) -> Option<&[u8; N]> {
        self.buffer[..self.end].get(self.start..)?.first_chunk()
    }

    /// The unread bytes in the buffer; more may follow.
    #[inline]
    pub(crate) fn unread(&self) -> &[u8] {
        &self.buffer[self.start..self.end]
    }

    /// Consumes a line whose length a look ahead has found.
    /// Returns its first `text` bytes.
    #[inline]
    pub(crate) fn take_line(&mut self, length: usize, text: usize) -> &[u8] {
        let start = self.start;
        self.start += length;
        self.line += 1;
        &self.buffer[start..start + text]
    }

    /// Reads more into the buffer; `false` at the end of the input.
    fn fill(&mut self) -> Result<bool, InputError> {
        if self.exhausted {
            return Ok(false);
        }
        let read = &self.buffer[..self.start];
        let newline = read.iter().rposition(|&byte| byte == b'\n');
        let tail = String::from_utf8_lossy(&read[newline.map_or(0, |at| at + 1)..]).chars().count();
        self.gone = if newline.is_some() { tail } else { self.gone + tail };
        self.buffer.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        if self.end == self.buffer.len() {
            if self.line == 0 && self.buffer.contains(&b'\r') {
                return Err(self.carriage_returns());
            }
            // The buffer is emptied, so that a further read makes progress.
            self.end = 0;
            return Err(self.too_long());
        }
        if self.utf16.is_some() {
            return self.fill_decoded();
        }
        let read = read_some(&mut self.input, &mut self.buffer[self.end..]);
        let line = self.line + 1;
        self.exhausted = read.is_err();
        let read = read.map_err(|e| InputError { line, ..unreadable(&self.file, &e) })?;
        self.end += read;
        self.exhausted = read == 0;
        Ok(read > 0)
    }

    /// As [`LineReader::fill`], for input in UTF-16.
    fn fill_decoded(&mut self) -> Result<bool, InputError> {
        const CHUNK: usize = 8192;
        let line = self.line + 1;
        let Some(Utf16Decoder { decoder, raw, ended }) = &mut self.utf16 else { return Ok(false) };
        loop {
            if raw.is_empty() && !*ended {
                raw.resize(CHUNK, 0);
                let read = read_some(&mut self.input, raw);
                raw.truncate(*read.as_ref().unwrap_or(&0));
                let read = read.map_err(|e| {
                    self.exhausted = true;
                    InputError { line, ..unreadable(&self.file, &e) }
                })?;
                *ended = read == 0;
            }
            let room = &mut self.buffer[self.end..];
            let (result, used, written) = decoder.decode_to_utf8_without_replacement(raw, room, *ended);
            raw.drain(..used);
            self.end += written;
            match result {
                DecoderResult::Malformed(..) => {
                    self.exhausted = true;
                    return Err(InputError::at(&self.file, line, 0, BROKEN_UTF16, UTF8));
                }
                DecoderResult::InputEmpty if *ended => {
                    self.exhausted = true;
                    return Ok(written > 0);
                }
                _ if written > 0 => return Ok(true),
                DecoderResult::OutputFull => {
                    // One more character does not fit, and the line has not ended.
                    (self.end, self.exhausted) = (0, true);
                    return Err(self.too_long());
                }
                DecoderResult::InputEmpty => {}
            }
        }
    }

    /// Reads until the buffer holds so many lines, or all, or is half full.
    pub(crate) fn fill_lines(&mut self, lines: usize) -> Result<(), InputError> {
        let newlines = |bytes: &[u8]| memchr::memchr_iter(b'\n', bytes).count();
        while newlines(self.unread()) < lines
            && self.end - self.start < self.buffer.len() / 2
            && self.fill()?
        {}
        Ok(())
    }

    /// Length of the unread text up to an end, or to the end of the input.
    fn length_to(&mut self, end: impl Fn(&[u8]) -> Option<usize>) -> Result<usize, InputError> {
        let mut searched = 0;
        loop {
            if let Some(at) = end(&self.unread()[searched..]) {
                return Ok(searched + at);
            }
            searched = self.unread().len();
            if !self.fill()? {
                return Ok(searched);
            }
        }
    }

    /// The next line without its end, as a range of the buffer.
    pub(crate) fn line(&mut self) -> Result<Option<Range<usize>>, InputError> {
        let length = self.length_to(|unread| memchr::memchr(b'\n', unread))?;
        if length == 0 && self.start == self.end {
            return Ok(None);
        }
        let range = self.start..self.start + length;
        self.line_start = range.start;
        self.start = (range.end + 1).min(self.end);
        self.line += 1;
        if self.line == 1 && self.bytes(range.clone()).trim_ascii_end().contains(&b'\r') {
            return Err(self.carriage_returns());
        }
        Ok(Some(range))
    }

    /// Puts back the line that [`LineReader::line`] returned last.
    pub(crate) fn unread_line(&mut self) {
        self.start = self.line_start;
        self.line -= 1;
    }

    /// The next word between white space, as a range of the buffer.
    pub(crate) fn word(&mut self) -> Result<Option<Range<usize>>, InputError> {
        loop {
            let Some(&byte) = self.buffer[..self.end].get(self.start) else {
                if self.fill()? {
                    continue;
                }
                return Ok(None);
            };
            if !byte.is_ascii_whitespace() {
                break;
            }
            self.line += usize::from(byte == b'\n');
            self.start += 1;
        }
        let length = self.length_to(|unread| unread.iter().position(u8::is_ascii_whitespace))?;
        let range = self.start..self.start + length;
        self.start = range.end;
        Ok(Some(range))
    }
}

/// Reads once, and again after each signal that interrupts.
fn read_some(input: &mut impl Read, into: &mut [u8]) -> io::Result<usize> {
    loop {
        match input.read(into) {
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            other => return other,
        }
    }
}

impl<R> LineReader<R> {
    pub(crate) fn is_utf16(&self) -> bool {
        self.utf16.is_some()
    }

    fn too_long(&self) -> InputError {
        let found = format!("{BUFFER} bytes without an end of line");
        InputError::at(&self.file, self.line + 1, 0, found, "a text file of short lines")
    }

    /// The finding that a line without end contains carriage returns.
    fn carriage_returns(&self) -> InputError {
        let expected = "lines that end in LF or CRLF, as `tr '\\r' '\\n' < FILE > NEW` writes them";
        InputError::at(&self.file, 1, 0, "lines that end in CR alone", expected)
    }

    /// A finding at the word that was just read.
    pub(crate) fn at_word(&self, found: &str, expected: &str) -> InputError {
        let before = &self.buffer[..self.start];
        let newline = before.iter().rposition(|&byte| byte == b'\n');
        let line_start = newline.map_or(0, |at| at + 1);
        let word_start = before.iter().rposition(u8::is_ascii_whitespace).map_or(0, |at| at + 1);
        let gone = if newline.is_some() { 0 } else { self.gone };
        let column = gone + String::from_utf8_lossy(&before[line_start..word_start]).chars().count() + 1;
        InputError::at(&self.file, self.line, column, found, expected)
    }
}
