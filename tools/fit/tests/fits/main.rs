//! Fits through the public interface, one file per question.
//! They form one program, so that long tests run in parallel with the others.

mod chain;
mod coarse;
mod left;
mod random_machines;
mod real_data;
mod thermal;
mod whole_model;
