//! How a file is read and written.
//! Everything that a person or another program wrote comes in through here, and every finding about it is one [`InputError`]: file, line,
//! column, what was found, what was expected.
//!
//! | module | what |
//! |---|---|
//! | [`input`] | the one shape of error for a file that a person wrote; what is said about one that is taken all the same |
//! | [`text`] | a text file read whole: UTF-8 or UTF-16, without its byte-order mark |
//! | [`mod@csv`] | CSV: rows of cells with their places, columns by name |
//! | [`date`] | calendar days |
//! | [`file_kind`] | what a file says that it is, where another kind was asked for |
//! | [`Sheet`] | a CSV whose columns are known, read whole |
//! | [`Numbers`] | how the numbers of a column are written: decimal point or comma, thousands |
//! | [`mod@keys`] | one table of keys per section of a TOML file: it reads, checks and describes |
//! | [`mod@toml`] | TOML read strictly: the first finding, or all of them |
//! | [`units`] | units that the name of a column states |
//! | [`clock`], [`date`] | clocks that do not begin with the run: ISO 8601, DD.MM.YYYY, times of the day, Unix times |
//! | [`trace`] | recorded quadrature, as CSV and VCD, and requested totals |
//! | [`mod@write`] | files that appear whole or not at all |
//! | [`folder`] | a folder that others write to as well: nothing in it is followed through a link |
//! | [`stamp`] | the format and the writer of what is written |
//! | [`words`] | the word that was probably meant |
//! | [`watch`] | a long computation that somebody waits for |
//!
//! Private: `decimal` makes a number of digits, `lines` reads a file line by line through one buffer, `vcd` is the VCD half of [`trace`].
//!
//! Formats of the crates above (records, models, configurations) must not be here, only their building blocks. This crate does not know
//! engine, machine or laws.
//!
//! At work: `cargo run -p rtec-files --example read_trace`, which the tests run too.

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

pub use input::{InputError, Said};
pub use numbers::{Marks, Numbers};
pub use sheet::{Columns, Sheet};
pub use words::nearest;
