//! Tests of simulated machines through their interface, one file per question.
//! They are one program, so that long tests run in parallel with the others.

mod designs;
mod ecc;
mod experiment;
mod machine;
mod turning;
