//! JSON documents, as every verb prints and writes them.
//! Each ends with its format and the program that wrote it; a list has neither.

use anyhow::Context;
use rtec_files::file_format_stamp::signed;
use serde::Serialize;
use std::path::Path;

/// The document over several lines.
pub(crate) fn pretty(document: &impl Serialize) -> anyhow::Result<String> {
    Ok(signed(serde_json::to_string_pretty(document)?) + "\n")
}

/// The document on one line.
pub(crate) fn line(document: &impl Serialize) -> anyhow::Result<String> {
    Ok(signed(serde_json::to_string(document)?) + "\n")
}

pub(crate) fn say_pretty(document: &impl Serialize) -> anyhow::Result<()> {
    crate::say(&pretty(document)?);
    Ok(())
}

pub(crate) fn say_line(document: &impl Serialize) -> anyhow::Result<()> {
    crate::say(&line(document)?);
    Ok(())
}

/// Prints the document over several lines, or a text for people.
pub(crate) fn answer(
    json: bool,
    document: &impl Serialize,
    text: impl FnOnce() -> String,
) -> anyhow::Result<()> {
    crate::say(&if json { pretty(document)? } else { text() });
    Ok(())
}

/// The items with commas between.
pub(crate) fn list(items: impl IntoIterator<Item = impl ToString>) -> String {
    items.into_iter().map(|item| item.to_string()).collect::<Vec<_>>().join(", ")
}

/// Writes a text as a file, whole or not at all.
pub(crate) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    rtec_files::atomic_write::write_atomically(path, text.as_bytes())
        .with_context(|| format!("writing {}", path.display()))
}
