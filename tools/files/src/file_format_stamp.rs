//! The stamp in each file that the program writes: format number and writer.
//!
//! The number rises if an existing part changes, not if a part is added. A file without a number has the
//! first format.

use crate::InputError;
use crate::strict_toml::Table;
use std::sync::OnceLock;

/// The version of this workspace.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The format of run records, machine models and verdicts that this version uses.
pub const FORMAT: u32 = 1;

static COMMIT: OnceLock<&str> = OnceLock::new();

/// States the commit that the running program was built from, empty if unknown.
///
/// A program calls it before it writes, with the `RTEC_COMMIT` of its build script `commit.rs`.
pub fn built_from(commit: &'static str) {
    let _ = COMMIT.set(commit);
}

/// The writer: `rtec 0.1.0`.
/// A release adds its commit: `rtec 0.1.0 (c7e189b04e)`.
pub fn writer() -> String {
    match COMMIT.get() {
        Some(commit) if !commit.is_empty() => format!("rtec {VERSION} ({commit})"),
        _ => format!("rtec {VERSION}"),
    }
}

/// Checks that a file is of a format that this version can read.
///
/// # Errors
/// It is of a later one.
pub fn check(root: &Table<'_>) -> Result<(), InputError> {
    if let Some(by) = root.get("by") {
        by.str("the program that wrote the file")?;
    }
    let Some(format) = root.get("format") else { return Ok(()) };
    let expected = format!("format = {FORMAT}: a later version wrote this file, read it with that one");
    match format.integer::<u32>(&expected)? {
        FORMAT => Ok(()),
        _ => Err(format.mismatch(expected)),
    }
}

/// A JSON document with its format and its writer as the last keys.
/// A JSON list stays unchanged, because it has no keys.
pub fn signed(mut json: String) -> String {
    if !json.starts_with('{') || !json.ends_with('}') {
        return json;
    }
    json.pop();
    let (before, after) = if json.contains('\n') { ("\n  ", "\n") } else { ("", "") };
    json.truncate(json.trim_end().len());
    let (comma, space) = (if json == "{" { "" } else { "," }, if after.is_empty() { "" } else { " " });
    let stamp = format!("{before}\"format\":{space}{FORMAT},{before}\"by\":{space}\"{}\"", writer());
    format!("{json}{comma}{stamp}{after}}}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::strict_toml::Document;
    use std::path::Path;

    #[test]
    fn a_document_ends_with_its_writer() {
        let signed = |json: &str| super::signed(json.to_owned());
        let by = writer();
        assert_eq!(signed("{\"a\":1}"), format!("{{\"a\":1,\"format\":1,\"by\":\"{by}\"}}"));
        let pretty = format!("{{\n  \"a\": 1,\n  \"format\": 1,\n  \"by\": \"{by}\"\n}}");
        assert_eq!(signed("{\n  \"a\": 1\n}"), pretty);
        assert_eq!(signed("{}"), format!("{{\"format\":1,\"by\":\"{by}\"}}"));
        assert_eq!(signed("[1]"), "[1]");
    }

    #[test]
    fn a_later_format_is_refused_and_none_is_the_first() {
        let read = |text: &str| {
            let doc = Document::parse(Path::new("m.toml"), text).unwrap();
            check(&doc.root()).map_err(|e| e.to_string())
        };
        assert_eq!(read("name = \"a\"\n"), Ok(()));
        assert_eq!(read("format = 1\nby = \"rtec 0.1.0\"\n"), Ok(()));
        for later in ["format = 2\n", "format = \"1\"\n", "format = -1\n", "format = 1.5\n"] {
            let said = read(later).unwrap_err();
            assert!(said.starts_with("m.toml:1:") && said.contains("expected format = 1"), "{said}");
        }
        assert!(read("by = 3\n").is_err());
    }
}
