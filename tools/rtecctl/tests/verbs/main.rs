//! `rtecctl` as a user meets it, a file for each family of verbs.
//! One program: what waits for LinuxCNC runs beside what calculates.

#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "helpers of tests")]

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
