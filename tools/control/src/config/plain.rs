//! Checks well-formed values that make no sense.
//! Examples are names with terminal controls and absurd numbers.

use rtec_files::toml::{At, Section, SourceFile};
use rtec_files::words::unseen;

/// Longest name of a machine, an axis, a sensor, characters.
const LONGEST_NAME: usize = 64;
/// Longest line of text, bytes.
const LONGEST_LINE: usize = 256;

/// What is wrong with a name, if anything: found, expected.
pub(super) fn bad_name(key: &str, name: &str, one_word: bool) -> Option<(String, &'static str)> {
    // What cannot be seen is written out; what is endless is cut.
    let shown: String = name.chars().take(24).flat_map(char::escape_debug).collect();
    let shown = if name.chars().nth(24).is_some() { format!("{shown}…") } else { shown };
    let found = format!("{key} = \"{shown}\"");
    if let Some(c) = unseen(name) {
        return Some((
            format!("{found} with the character U+{:04X}", u32::from(c)),
            "characters that can be seen",
        ));
    }
    let length = name.chars().count();
    if length > LONGEST_NAME {
        return Some((format!("{found} of {length} characters"), "at most 64 characters"));
    }
    if name.starts_with('-') {
        return Some((found, "a name that does not begin as an option does"));
    }
    if name.trim() != name || one_word && name.contains(char::is_whitespace) {
        let expected = if one_word { "a name without blanks" } else { "no blank at its beginning or end" };
        return Some((found, expected));
    }
    None
}

/// The value of a name that can be shown and typed; else a finding.
pub(super) fn name<'a>(
    source: &mut SourceFile<'_>,
    key: &str,
    at: Option<At<&'a str>>,
    one_word: bool,
) -> Option<At<&'a str>> {
    let at = at?;
    let Some((found, expected)) = bad_name(key, at.value, one_word) else { return Some(at) };
    source.finding(at.offset, found, expected);
    None
}

/// A one-line text without terminal controls, or a finding.
/// It is shown as it is.
pub(super) fn line<'a>(
    source: &mut SourceFile<'_>,
    key: &str,
    at: Option<At<&'a str>>,
) -> Option<At<&'a str>> {
    let at = at?;
    if at.value.len() <= LONGEST_LINE && unseen(at.value).is_none() {
        return Some(at);
    }
    let shown: String = at.value.chars().take(24).flat_map(char::escape_debug).collect();
    source.finding(at.offset, format!("{key} = \"{shown}…\""), "at most 256 characters that can be seen");
    None
}

/// A number from `low` to `high`, both above zero.
pub(super) fn within(
    section: &mut Section<'_>,
    source: &mut SourceFile<'_>,
    key: &'static str,
    low: f64,
    high: f64,
) -> Option<At<f64>> {
    section.value(source, key, format!("a number from {low} to {high}"), |v| {
        v.as_number().filter(|n| (low..=high).contains(n))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_a_terminal_or_a_shell_would_obey_are_found() {
        for bad in [
            "a\nb",
            "a\u{1b}[31m",
            "a\u{202e}b",
            "--help",
            "-x",
            " x",
            "x ",
            "\u{200b}",
            &"x".repeat(1 << 20),
        ] {
            let (found, expected) = bad_name("name", bad, false).unwrap();
            assert!(found.len() < 200 && unseen(&found).is_none(), "{found}");
            assert!(!expected.is_empty());
        }
        for good in ["x", "lathe 7", "Drehmaschine Süd", "X1", "日本", "a-b"] {
            assert_eq!(bad_name("name", good, false), None);
        }
        assert!(bad_name("name", "lathe 7", true).is_some());
    }
}
