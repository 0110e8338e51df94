//! Reads and writes files.
//! All input from users and other programs is read here. Every finding about it is one [`InputError`]: file,
//! line, column, what was found, what was expected.
//!
//! Formats of the crates above (records, models, configurations) must not be here, only their building
//! blocks. This crate does not know engine, machine or laws.
//!
//! An example: `cargo run -p rtec-files --example read_trace`. The tests run it too.

pub mod atomic_write;
pub mod cancellable_computation; // a long computation that another thread waits for
#[cfg(feature = "clap")]
pub mod cli_option_parsers; // parsers of command-line options
pub mod clock_column; // clocks whose zero is not the start of the run: ISO 8601, DD.MM.YYYY, times of the day, Unix times
pub mod column_units; // units that the name of a column states
pub mod csv; // CSV: rows of cells with their places, columns by name
mod csv_table; // a CSV whose columns are known, read whole
pub mod date; // calendar days
mod decimal_parser; // numbers, parsed
pub mod file_format_stamp; // the format and the writer in each written file
pub mod file_kind; // the kind of a file that was given in place of another
pub mod input_error; // the error type for a file that a person wrote; messages about input that is accepted
mod line_reader; // a file line by line through one buffer
pub mod message_text; // text of messages: the word that was probably meant, printable and quoted text
pub mod quadrature_trace; // recorded quadrature, as CSV and VCD, and requested totals
pub mod strict_toml; // strict reading of TOML: the first finding, or all of them
mod table_number_format; // the format of a column's numbers: decimal point or comma, thousands
pub mod text_file; // a text file read whole: UTF-8 or UTF-16, without its byte-order mark
pub mod toml_section_keys; // one table of keys per section of a TOML file, to read, check and document it
pub mod trace_from_positions; // the quadrature trace that a scale gives along measured positions
pub mod untrusted_folder; // a folder that other users may write to: no link in it is followed
mod vcd; // the VCD half of `quadrature_trace` // files that appear whole or not at all

pub use csv_table::{ColumnAssignment, CsvTable};
pub use input_error::{InputError, InputNotice, Result};
pub use message_text::nearest;
pub use table_number_format::{DecimalMarks, TableNumberFormat};
