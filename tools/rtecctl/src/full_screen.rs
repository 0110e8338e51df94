//! The whole terminal: raw mode, alternate screen, cells and keys.
//! Cells are written with ECMA-48 sequences.

use crate::terminal::signs;
use nix::poll::PollFlags;
use nix::sys::termios::{SetArg, Termios, cfmakeraw, tcgetattr, tcsetattr};
use ratatui_core::backend::{Backend, ClearType, WindowSize};
use ratatui_core::buffer::Cell;
use ratatui_core::layout::{Position, Size};
use ratatui_core::style::{Color, Modifier};
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::os::fd::AsFd;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Key {
    Letter(char),
    Escape,
    /// Ctrl-C, which raw mode does not turn into a signal.
    Interrupt,
}

/// The terminal in raw mode, until this is dropped.
pub(crate) struct RawModeScreen {
    before: Termios,
    /// Text to be written at the next flush.
    out: String,
}

/// Sequences for the alternate screen without a cursor, and back.
const ENTER: &str = "\x1b[?1049h\x1b[?25l";
const LEAVE: &str = "\x1b[0m\x1b[?25h\x1b[?1049l";

impl RawModeScreen {
    /// # Errors
    /// Standard input is not a terminal.
    pub(crate) fn take() -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut raw = before.clone();
        cfmakeraw(&mut raw);
        tcsetattr(io::stdin(), SetArg::TCSANOW, &raw)?;
        Ok(Self { before, out: ENTER.to_owned() })
    }
}

impl Drop for RawModeScreen {
    /// A terminal that has gone needs no restoring.
    fn drop(&mut self) {
        let _ = io::stdout().write_all(LEAVE.as_bytes()).and_then(|()| io::stdout().flush());
        let _ = tcsetattr(io::stdin(), SetArg::TCSANOW, &self.before);
    }
}

/// The keys pressed since the last call; it does not wait.
///
/// # Errors
/// The terminal cannot be read.
pub(crate) fn keys() -> io::Result<Vec<Key>> {
    let stdin = io::stdin();
    let mut pressed = Vec::new();
    while signs(stdin.as_fd(), PollFlags::POLLIN)?.contains(PollFlags::POLLIN) {
        let mut bytes = [0; 64];
        match nix::unistd::read(stdin.as_fd(), &mut bytes)? {
            0 => break,
            n => pressed.extend(keys_of(&bytes[..n])),
        }
    }
    Ok(pressed)
}

/// The keys that a terminal sent.
/// Arrows and function keys begin with an escape sequence, which is skipped.
fn keys_of(bytes: &[u8]) -> Vec<Key> {
    let text = String::from_utf8_lossy(bytes);
    let mut letters = text.chars().peekable();
    let mut keys = Vec::new();
    while let Some(letter) = letters.next() {
        match letter {
            '\x03' => keys.push(Key::Interrupt),
            '\x1b' if letters.next_if(|next| matches!(next, '[' | 'O')).is_some() => {
                // Parameters, then one letter.
                while letters.next_if(|next| matches!(next, '0'..='?' | ' '..='/')).is_some() {}
                letters.next();
            }
            '\x1b' => keys.push(Key::Escape),
            letter if !letter.is_control() => keys.push(Key::Letter(letter)),
            _ => {}
        }
    }
    keys
}

/// The sequence for a cell's style, with the eight colours of every terminal.
fn look_of(cell: &Cell) -> String {
    let mut codes = vec!["0"];
    let marks = [
        (Modifier::BOLD, "1"),
        (Modifier::DIM, "2"),
        (Modifier::ITALIC, "3"),
        (Modifier::UNDERLINED, "4"),
        (Modifier::REVERSED, "7"),
    ];
    codes.extend(marks.iter().filter(|(mark, _)| cell.modifier.contains(*mark)).map(|(_, code)| code));
    codes.extend(match cell.fg {
        Color::Black => Some("30"),
        Color::Red => Some("31"),
        Color::Green => Some("32"),
        Color::Yellow => Some("33"),
        Color::Blue => Some("34"),
        Color::Magenta => Some("35"),
        Color::Cyan => Some("36"),
        Color::Gray | Color::White => Some("37"),
        _ => None,
    });
    format!("\x1b[{}m", codes.join(";"))
}

/// Appends cells at their positions.
/// A sequence is written only where the position or the style changes.
fn write_cells<'a>(out: &mut String, cells: impl Iterator<Item = (u16, u16, &'a Cell)>) {
    let (mut next, mut look) = (None, String::new());
    for (x, y, cell) in cells {
        if next != Some((x, y)) {
            let _ = write!(out, "\x1b[{};{}H", y + 1, x + 1);
        }
        let own = look_of(cell);
        if own != look {
            out.push_str(&own);
            look = own;
        }
        out.push_str(cell.symbol());
        // A wide letter takes two columns, so the next position is set explicitly.
        next = (cell.symbol().len() == 1).then_some((x + 1, y));
    }
    out.push_str("\x1b[0m");
}

impl Backend for RawModeScreen {
    type Error = io::Error;

    fn draw<'a, I: Iterator<Item = (u16, u16, &'a Cell)>>(&mut self, content: I) -> io::Result<()> {
        write_cells(&mut self.out, content);
        Ok(())
    }

    fn hide_cursor(&mut self) -> io::Result<()> {
        self.out.push_str("\x1b[?25l");
        Ok(())
    }

    fn show_cursor(&mut self) -> io::Result<()> {
        self.out.push_str("\x1b[?25h");
        Ok(())
    }

    /// There is no text input, so the cursor is always at the origin.
    fn get_cursor_position(&mut self) -> io::Result<Position> {
        Ok(Position::ORIGIN)
    }

    fn set_cursor_position<P: Into<Position>>(&mut self, position: P) -> io::Result<()> {
        let Position { x, y } = position.into();
        let _ = write!(self.out, "\x1b[{};{}H", y + 1, x + 1);
        Ok(())
    }

    fn clear(&mut self) -> io::Result<()> {
        self.clear_region(ClearType::All)
    }

    fn clear_region(&mut self, region: ClearType) -> io::Result<()> {
        self.out.push_str(match region {
            ClearType::All => "\x1b[2J",
            ClearType::AfterCursor => "\x1b[J",
            ClearType::BeforeCursor => "\x1b[1J",
            ClearType::CurrentLine => "\x1b[2K",
            ClearType::UntilNewLine => "\x1b[K",
        });
        Ok(())
    }

    /// 80 by 24 if the terminal does not know its size: a serial console reports 0.
    fn size(&self) -> io::Result<Size> {
        let known = terminal_size::terminal_size().filter(|(w, h)| w.0 > 0 && h.0 > 0);
        Ok(known.map_or(Size::new(80, 24), |(w, h)| Size::new(w.0, h.0)))
    }

    fn window_size(&mut self) -> io::Result<WindowSize> {
        Ok(WindowSize { columns_rows: self.size()?, pixels: Size::default() })
    }

    fn flush(&mut self) -> io::Result<()> {
        let mut stdout = io::stdout();
        stdout.write_all(self.out.as_bytes())?;
        self.out.clear();
        stdout.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_told_from_sequences() {
        let letters = |text: &str| text.chars().map(Key::Letter).collect::<Vec<_>>();
        assert_eq!(keys_of(b"q?"), letters("q?"));
        assert_eq!(keys_of("ü".as_bytes()), letters("ü"));
        assert_eq!(keys_of(b"\x03"), [Key::Interrupt]);
        assert_eq!(keys_of(b"\x1b"), [Key::Escape]);
        assert_eq!(keys_of(b"\x1b\x1b"), [Key::Escape, Key::Escape]);
        // An arrow, F5, F1 and a mouse report are not letters.
        assert_eq!(keys_of(b"\x1b[A\x1b[15~\x1bOP\x1b[<0;10;5Mq"), letters("q"));
        assert_eq!(keys_of(b"\x1b["), []);
    }

    #[test]
    fn cells_are_placed_and_toned_where_that_changes() {
        let mut red = Cell::new("b");
        red.fg = Color::Red;
        red.modifier = Modifier::BOLD;
        let (plain, mut wide) = (Cell::new("a"), Cell::new("µ"));
        wide.fg = Color::Red;
        wide.modifier = Modifier::BOLD;
        let mut out = String::new();
        write_cells(&mut out, [(2, 1, &plain), (3, 1, &red), (4, 1, &wide), (5, 1, &plain)].into_iter());
        assert_eq!(out, "\x1b[2;3H\x1b[0ma\x1b[0;1;31mbµ\x1b[2;6H\x1b[0ma\x1b[0m");
    }
}
