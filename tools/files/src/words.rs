//! Words in messages: the one that was probably meant, and text as it is shown.

/// The word that was probably meant: a few letters away, or begun with all of the other's letters.
#[must_use]
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

/// Text as an error message shows it: quoted, cut where it is long.
#[must_use]
pub fn quoted(text: &str) -> String {
    format!("'{}'", cut(text))
}

/// What stands in a place, as an error message shows it.
pub(crate) fn shown(text: &str) -> String {
    if text.is_empty() { "nothing".to_owned() } else { quoted(text) }
}

/// Text cut where it is long.
pub(crate) fn cut(text: &str) -> String {
    const SHOWN: usize = 60;
    match text.char_indices().nth(SHOWN) {
        None => text.to_owned(),
        Some((at, _)) => format!("{}…", &text[..at]),
    }
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
    fn long_text_is_cut_between_characters() {
        assert_eq!(quoted("µ"), "'µ'");
        assert_eq!(quoted(&"µ".repeat(61)), format!("'{}…'", "µ".repeat(60)));
    }
}
