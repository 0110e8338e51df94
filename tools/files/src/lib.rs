//! Reads and writes files.
//! All input from users and other programs is read here. Every finding about it is one [`InputError`]: file,
//! line, column, what was found, what was expected.
//!
//! | module | contents |
//! |---|---|
//! | [`input`] | the error type for a file that a person wrote; messages about input that is accepted |
//! | [`text`] | a text file read whole: UTF-8 or UTF-16, without its byte-order mark |
//! | [`mod@csv`] | CSV: rows of cells with their places, columns by name |
//! | [`date`] | calendar days |
//! | [`file_kind`] | the kind of a file that was given in place of another |
//! | [`Sheet`] | a CSV whose columns are known, read whole |
//! | [`Numbers`] | the format of a column's numbers: decimal point or comma, thousands |
//! | [`mod@keys`] | one table of keys per section of a TOML file, to read, check and document it |
//! | [`mod@toml`] | strict reading of TOML: the first finding, or all of them |
//! | [`units`] | units that the name of a column states |
//! | [`clock`], [`date`] | clocks whose zero is not the start of the run: ISO 8601, DD.MM.YYYY, times of the day, Unix times |
//! | [`trace`] | recorded quadrature, as CSV and VCD, and requested totals |
//! | [`mod@write`] | files that appear whole or not at all |
//! | [`folder`] | a folder that other users may write to: no link in it is followed |
//! | [`stamp`] | the format and the writer in each written file |
//! | [`words`] | the word that was probably meant |
//! | [`watch`] | a long computation that another thread waits for |
//!
//! Private: `decimal` parses numbers, `lines` reads a file line by line through one buffer, `vcd` is the VCD
//! half of [`trace`].
//!
//! Formats of the crates above (records, models, configurations) must not be here, only their building
//! blocks. This crate does not know engine, machine or laws.
//!
//! An example: `cargo run -p rtec-files --example read_trace`. The tests run it too.

pub mod clock;
pub mod csv;
pub mod date;
mod decimal;
pub mod file_kind;
pub mod folder;
pub mod input;
pub mod keys;
mod lines;
mod numbers;
mod sheet;
pub mod stamp;
pub mod text;
pub mod toml;
pub mod trace;
pub mod units;
mod vcd;
pub mod watch;
pub mod words;
pub mod write;

pub use input::{InputError, Result, Said};
pub use numbers::{Numbers, TableMarks};
pub use sheet::{Columns, Sheet};
pub use words::nearest;
