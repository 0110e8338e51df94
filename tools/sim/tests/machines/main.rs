//! Simulated machines from outside, a file a question.
//! One program: what takes long runs beside the rest.

mod designs;
mod ecc;
mod experiment;
mod machine;
mod turning;
