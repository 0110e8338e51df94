//! The output: a terminal with colours and a width, a file, or a closed pipe.

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use std::io::{self, IsTerminal, Write as _};
use std::os::fd::{AsFd, BorrowedFd};

/// Meaning of a colour, one of the eight that every terminal has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColourMeaning {
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
pub(crate) fn toned(text: &str, tone: ColourMeaning, colour: bool) -> String {
    if !colour {
        return text.to_owned();
    }
    let code = match tone {
        ColourMeaning::Good => "32",
        ColourMeaning::Doubtful => "33",
        ColourMeaning::Wrong => "1;31",
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
    signs(io::stdout().as_fd(), PollFlags::empty()).is_ok_and(|found| found.contains(PollFlags::POLLERR))
}

/// What the system says of a descriptor now.
pub(crate) fn signs(fd: BorrowedFd<'_>, asked: PollFlags) -> nix::Result<PollFlags> {
    let mut fds = [PollFd::new(fd, asked)];
    poll(&mut fds, PollTimeout::ZERO)?;
    Ok(fds[0].revents().unwrap_or(PollFlags::empty()))
}

/// Wraps a text between words at a number of columns.
/// Continuation lines are indented by four columns. A word longer than a line stays whole. The sequences of a
/// tone take no columns.
pub(crate) fn wrapped(text: &str, width: usize) -> String {
    let line = |line: &str| {
        let indent = line.len() - line.trim_start_matches(' ').len();
        format!("{}{}\n", &line[..indent], flowed(&line[indent..], indent, indent + 4, width))
    };
    text.lines().map(line).collect()
}

/// Words from the column `begin` on, wrapped at `width`.
/// Further lines have `indent` blanks.
pub(crate) fn flowed(words: &str, begin: usize, indent: usize, width: usize) -> String {
    let (mut out, mut at) = (String::new(), begin);
    for (n, word) in words.split(' ').enumerate() {
        let columns = columns(word);
        if n > 0 && at + 1 + columns > width {
            out = out + "\n" + &" ".repeat(indent);
            at = indent;
        } else if n > 0 {
            out.push(' ');
            at += 1;
        }
        out += word;
        at += columns;
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
        let red = toned("not so:", ColourMeaning::Wrong, true) + " µm µm";
        assert_eq!(wrapped(&red, 13), format!("{red}\n"));
        assert_eq!(wrapped(&red, 12), "\x1b[1;31mnot so:\x1b[0m µm\n    µm\n");
    }
}
