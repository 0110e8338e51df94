//! Words and text for messages: suggestions, and printable text.

use std::borrow::Cow;

/// Whether a line is a comment: it begins with `#`, `;`, `%` or `//`.
pub fn is_comment(line: &str) -> bool {
    let line = line.trim_start();
    line.starts_with(['#', ';', '%']) || line.starts_with("//")
}

/// The word that was probably meant.
/// It differs by a few letters, or one word begins with the other.
pub fn nearest<'w>(word: &str, words: &[&'w str]) -> Option<&'w str> {
    let length = word.chars().count();
    let lower = word.to_lowercase();
    let scored = words.iter().map(|w| (strsim::damerau_levenshtein(&lower, &w.to_lowercase()), *w));
    let (distance, near) = scored.min_by_key(|(d, _)| *d)?;
    if distance < length && distance <= 1 + length / 4 {
        return Some(near);
    }
    let begun = |w: &&&str| length > 2 && (w.starts_with(word) || w.len() > 2 && word.starts_with(**w));
    words.iter().find(begun).copied()
}

/// Whether a character is invisible and changes how the text around it is shown.
pub const fn is_hidden(c: char) -> bool {
    matches!(c, '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
        | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

/// The first character that is invisible or that a terminal would obey.
pub fn unseen(text: &str) -> Option<char> {
    text.chars().find(|c| c.is_control() || is_hidden(*c))
}

/// Text that a terminal can show safely.
/// Invisible characters (controls, directions, marks without width) are escaped.
pub fn printable(text: &str) -> Cow<'_, str> {
    let seen = |c: char| c == ' ' || c.is_alphanumeric() || c.is_ascii_punctuation();
    if text.chars().all(seen) {
        return Cow::Borrowed(text);
    }
    let each = text.chars().map(|c| match c {
        '\'' | '"' | '\\' => c.to_string(),
        _ => c.escape_debug().to_string(),
    });
    Cow::Owned(each.collect())
}

/// Text with the special characters of HTML and XML replaced.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Text for an error message: quoted, printable, cut if long.
pub fn quoted(text: &str) -> String {
    format!("'{}'", printable(&cut(text)))
}

/// The content of a place for an error message.
pub(crate) fn shown(text: &str) -> String {
    if text.is_empty() { "nothing".to_owned() } else { quoted(text) }
}

pub(crate) fn cut(text: &str) -> String {
    cut_at(text, 60)
}

pub(crate) fn cut_at(text: &str, characters: usize) -> String {
    match text.char_indices().nth(characters) {
        None => text.to_owned(),
        Some((at, _)) => format!("{}…", &text[..at]),
    }
}

/// An error with its causes, each once: many errors already contain their cause.
pub fn error_with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let said = error.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
        }
        cause = error.source();
    }
    text
}

/// As the standard library's, but a closed standard error is no reason to stop.
#[macro_export]
macro_rules! eprintln {
    ($($what:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), $($what)*);
    }};
}

/// Declares an enum whose values users name on a command line.
/// Each value has its name and its meaning. `ALL` lists name, value and meaning in this order.
#[macro_export]
macro_rules! choice {
    ($(#[$about:meta])* pub enum $name:ident { $($value:ident = $written:literal, $meaning:literal;)+ }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum $name {
            $(#[doc = $meaning] $value,)+
        }

        impl $name {
            /// All values: name, value and meaning.
            pub const ALL: [(&'static str, Self, &'static str); [$($written),+].len()] =
                [$(($written, Self::$value, $meaning)),+];
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_that_was_meant() {
        let words = ["backend", "profile", "count_um", "um"];
        assert_eq!(nearest("bakcend", &words), Some("backend"));
        assert_eq!(nearest("Profile", &words), Some("profile"));
        assert_eq!(nearest("count", &words), Some("count_um"));
        assert_eq!(nearest("count_um_per_mm", &words), Some("count_um"));
        assert_eq!(nearest("spindle", &words), None);
        assert_eq!(nearest("u", &words), None);
        assert_eq!(nearest("x", &[]), None);
    }

    #[test]
    fn what_cannot_be_seen_is_written_out() {
        let plain = "found 'x' = 5.0 \"µm\", a\\b";
        assert_eq!(printable(plain), plain);
        assert_eq!(printable("20 °C ±1…"), "20 °C ±1…");
        assert_eq!(printable("a\u{1b}[2J\r\nb\t\u{7f}\u{9b}"), "a\\u{1b}[2J\\r\\nb\\t\\u{7f}\\u{9b}");
        // A right-to-left override would turn the rest of the line around.
        assert_eq!(printable("\u{202e}gnorw\u{200b}"), "\\u{202e}gnorw\\u{200b}");
        assert_eq!(["µ 日本", "a\u{1b}", "\u{202e}a"].map(unseen), [None, Some('\u{1b}'), Some('\u{202e}')]);
    }

    #[test]
    fn long_text_is_cut_between_characters() {
        assert_eq!(quoted("µ"), "'µ'");
        assert_eq!(quoted(&"µ".repeat(61)), format!("'{}…'", "µ".repeat(60)));
    }

    #[test]
    fn a_cause_is_said_once() {
        use std::fmt;
        #[derive(Debug)]
        struct Outer(String, fmt::Error);
        impl fmt::Display for Outer {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
        impl std::error::Error for Outer {
            fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
                Some(&self.1)
            }
        }
        let cause = fmt::Error.to_string();
        assert_eq!(error_with_causes(&fmt::Error), cause);
        assert_eq!(
            error_with_causes(&Outer("opening it".to_owned(), fmt::Error)),
            format!("opening it: {cause}")
        );
        let says_it = format!("opening it: {cause}; is it there?");
        assert_eq!(error_with_causes(&Outer(says_it.clone(), fmt::Error)), says_it);
    }
}
