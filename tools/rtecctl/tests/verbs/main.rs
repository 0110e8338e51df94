//! `rtecctl` as a user sees it, with a file for each family of verbs.
//! It is one program, so that tests that wait for LinuxCNC run in parallel with those that calculate.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of tests")]

use serde_json::Value;

/// A document as a verb prints it, with its format and writer at the end.
/// A list has neither.
#[track_caller]
fn document(text: &[u8]) -> Value {
    let found: Value = serde_json::from_slice(text).expect("one JSON document");
    let end = String::from_utf8_lossy(text).replace([' ', '\n'], "");
    let stamped = end.contains(",\"format\":1,\"by\":\"rtec0") && end.ends_with("\"}");
    assert!(found.is_array() || stamped, "no format and writer at its end: {found}");
    found
}

mod backup;
mod card;
mod characterise;
mod example;
mod export;
mod field;
mod file_kinds;
mod import;
mod linuxcnc_tables;
mod model;
mod part;
mod part_mistakes;
mod parts;
mod platform;
mod reconcile;
mod replay;
mod selftest;
mod suspicions;
mod texts;
mod trace;
