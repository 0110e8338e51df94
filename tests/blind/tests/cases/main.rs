//! A small part of the blind suite, in one program whose cases run in parallel.

mod clean;
mod field;
mod quick;
mod real;
mod record;
mod wide;
