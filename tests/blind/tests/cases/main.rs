//! The blind suite judged in small. One program: its cases run beside each other.

mod clean;
mod field;
mod quick;
mod real;
mod record;
mod wide;
