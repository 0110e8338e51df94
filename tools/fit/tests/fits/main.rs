//! Fits from outside, a file a question.
//! One program: what takes long runs beside the rest.

mod chain;
mod coarse;
mod left;
mod random_machines;
mod real_data;
mod thermal;
mod whole_model;
