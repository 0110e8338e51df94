//! Comments in a table, and lines of other programs.

use crate::decimal_parser::number;

/// A line without its comment and the blanks at its end.
/// Empty if it has only separators.
pub(super) fn content(line: &[u8], by: u8, width: Option<usize>) -> &[u8] {
    let comment = if memchr::memchr(b'#', line).is_some() { comment_at(line, by, width) } else { None };
    let text = line[..comment.unwrap_or(line.len())].trim_ascii_end();
    if text.first().is_none_or(|first| first.is_ascii_whitespace() || is_cell_separator(*first, by))
        && text.iter().all(|byte| byte.is_ascii_whitespace() || is_cell_separator(*byte, by))
    {
        return &[];
    }
    text
}

/// Whether a line is another program's comment.
/// A row whose first cell begins in the same way is not. `width`: the number of cells in a row.
pub(super) fn is_foreign_comment(line: &[u8], by: u8, width: Option<usize>) -> bool {
    let (mark, rest) = match line.trim_ascii_start() {
        [b'/', b'/', ..] => return true,
        [mark @ (b';' | b'%'), rest @ ..] => (*mark, rest),
        _ => return false,
    };
    let apart = rest.first().is_none_or(|byte| byte.is_ascii_whitespace() || *byte == mark);
    match width {
        _ if mark == b'%' && apart => true,
        None if mark == b';' => apart || !rest.contains(&mark) && rest.trim_ascii().contains(&b' '),
        None => false,
        Some(_) if mark == b';' && by != mark => true,
        Some(width) => outside_quotes(line).filter(|(_, byte)| *byte == by).count() + 1 != width,
    }
}

/// Whether a byte is a separator; before the header is read, any possible one.
pub(super) fn is_cell_separator(byte: u8, by: u8) -> bool {
    byte == by || by == b',' && matches!(byte, b';' | b'\t' | b'|')
}

/// The texts that spreadsheets write into a cell that they cannot calculate.
const CELL_ERRORS: [&[u8]; 9] =
    [b"#N/A", b"#NV", b"#DIV/0!", b"#VALUE!", b"#WERT!", b"#REF!", b"#NAME?", b"#NUM!", b"#NULL!"];

/// The place where a line's comment begins. `width`: cells per row, if known.
fn comment_at(line: &[u8], by: u8, width: Option<usize>) -> Option<usize> {
    let (mut cells, mut at_cell) = (1, true);
    for (at, byte) in outside_quotes(line) {
        if byte == by {
            (cells, at_cell) = (cells + 1, true);
            continue;
        }
        if byte == b'#' {
            let behind = line.get(at + 1);
            let is_error = at_cell && CELL_ERRORS.iter().any(|error| line[at..].starts_with(error));
            let is_first = line[..at].trim_ascii_start().is_empty();
            let is_blank = |byte: Option<&u8>| byte.is_none_or(u8::is_ascii_whitespace);
            let apart = is_blank(behind) || is_blank(at.checked_sub(1).map(|at| &line[at]));
            let parted = behind.is_some_and(|byte| *byte != b' ' && is_cell_separator(*byte, by));
            let is_whole = width.is_none_or(|width| cells >= width);
            // A line that begins with # is a comment, whatever follows.
            if !is_error && (is_first || apart && !parted && is_whole) {
                return Some(at);
            }
        }
        at_cell &= byte.is_ascii_whitespace() || is_cell_separator(byte, by);
    }
    None
}

/// Whether a comment looks like a row: `#1;2,5;3`, `#1;D1;2,5`.
/// It has as many cells, a word in the first and a number in another.
pub(super) fn looks_like_a_row(line: &[u8], by: u8, width: Option<usize>) -> bool {
    let Some(text) = line.trim_ascii().strip_prefix(b"#").and_then(|text| std::str::from_utf8(text).ok())
    else {
        return false;
    };
    let mut cells = text.split(char::from(by));
    let is_word =
        cells.next().is_some_and(|first| first.starts_with(|c: char| !c.is_whitespace() && c != '#'));
    let numbers = cells.clone().filter(|cell| number(&cell.trim().replace(',', ".")).is_some()).count();
    is_word && numbers > 0 && width == Some(1 + cells.count())
}

/// The number of cells in the next row without `#`, as far as the text goes.
pub(super) fn width_of_rows(ahead: &[u8], by: u8) -> Option<usize> {
    let rows = ahead.split(|byte| *byte == b'\n').filter(|line| memchr::memchr(b'#', line).is_none());
    let row = rows.map(|line| content(line, by, None)).find(|line| !line.is_empty())?;
    Some(1 + outside_quotes(row).filter(|(_, byte)| *byte == by).count())
}

/// The bytes of a line outside quotes, with their positions.
pub(super) fn outside_quotes(line: &[u8]) -> impl Iterator<Item = (usize, u8)> {
    let mut inside = false;
    line.iter().copied().enumerate().filter(move |(_, byte)| {
        inside ^= *byte == b'"';
        !inside
    })
}
