//! The output: a terminal with colours and a width, a file, or a closed pipe.

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::io::{self, IsTerminal, Write as _};
use std::os::fd::AsFd;

/// Meaning of a colour, one of the eight that every terminal has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Tone {
    /// As it should be.
    Good,
    /// Deserves attention.
    Doubtful,
    /// Wrong.
    Wrong,
}

/// Whether colours are allowed (`NO_COLOR`, no-color.org) and available.
pub(crate) fn colours_are_wanted() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|v| !v.is_empty());
    !set("NO_COLOR") && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Whether standard output shows colours.
pub(crate) fn colour() -> bool {
    io::stdout().is_terminal() && colours_are_wanted()
}

/// Columns of the terminal on standard output; none if they are not known.
pub(crate) fn width() -> Option<u16> {
    let terminal = io::stdout().is_terminal();
    let size = terminal.then(terminal_size::terminal_size).flatten();
    size.and_then(|(width, _)| readable(width.0))
}

/// A width in which text can be read. A serial console and `script` report 0.
fn readable(columns: u16) -> Option<u16> {
    const LEAST: u16 = 20;
    (columns >= LEAST).then_some(columns)
}

/// A text in a tone, if `colour` is set.
pub(crate) fn toned(text: &str, tone: Tone, colour: bool) -> String {
    if !colour {
        return text.to_owned();
    }
    let code = match tone {
        Tone::Good => "32",
        Tone::Doubtful => "33",
        Tone::Wrong => "1;31",
    };
    format!("\x1b[{code}m{text}\x1b[0m")
}

/// Shows a text, with `clears` in place of the one before on a terminal.
/// `false` if the reader of standard output has gone.
pub(crate) fn redraw(text: &str, clears: bool) -> io::Result<bool> {
    let mut out = io::stdout();
    // Home, then clear to the end: no flicker, and no rest of a longer view.
    let clear = if clears && out.is_terminal() { "\x1b[H\x1b[J" } else { "" };
    match write!(out, "{clear}{text}").and_then(|()| out.flush()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true),
    }
}

/// Whether the reader of standard output has gone: endless commands then end.
pub(crate) fn reader_has_gone() -> bool {
    let stdout = io::stdout();
    let mut fds = [PollFd::new(stdout.as_fd(), PollFlags::empty())];
    poll(&mut fds, PollTimeout::ZERO).is_ok()
        && fds[0].revents().is_some_and(|found| found.contains(PollFlags::POLLERR))
}

/// Wraps a text between words at a number of columns.
/// Continuation lines are indented by four columns. A word longer than a line stays whole. The sequences of a
/// tone take no columns.
pub(crate) fn wrapped(text: &str, width: usize) -> String {
    let mut out = String::new();
    for line in text.lines() {
        let begin = line.len() - line.trim_start_matches(' ').len();
        let (indent, words) = line.split_at(begin);
        let mut at = 0;
        for word in words.split(' ') {
            let columns = columns(word);
            if at == 0 {
                out += indent;
                at = begin;
            } else if at + 1 + columns > width {
                out = out + "\n    " + indent;
                at = begin + 4;
            } else {
                out.push(' ');
                at += 1;
            }
            out += word;
            at += columns;
        }
        out.push('\n');
    }
    out
}

/// Columns of a word without the sequences of its tones.
fn columns(word: &str) -> usize {
    let codes = word.split('\x1b').skip(1);
    let hidden: usize = codes.map(|rest| 1 + rest.find('m').map_or(0, |m| m + 1)).sum();
    word.chars().count() - hidden
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_that_does_not_know_its_columns_has_none() {
        assert_eq!([0, 1, 19, 20, 80].map(readable), [None, None, None, Some(20), Some(80)]);
    }

    #[test]
    fn lines_are_broken_between_words_and_go_on_further_in() {
        assert_eq!(wrapped("one two three\n", 13), "one two three\n");
        assert_eq!(wrapped("one two three\n", 12), "one two\n    three\n");
        assert_eq!(wrapped("  a bc def\n\nx\n", 6), "  a bc\n      def\n\nx\n");
        assert_eq!(wrapped("ab /a/long/path c\n", 8), "ab\n    /a/long/path\n    c\n");
        // Two words in a tone are as wide as without it.
        let red = toned("not so:", Tone::Wrong, true) + " µm µm";
        assert_eq!(wrapped(&red, 13), format!("{red}\n"));
        assert_eq!(wrapped(&red, 12), "\x1b[1;31mnot so:\x1b[0m µm\n    µm\n");
    }
}
