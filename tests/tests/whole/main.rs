//! The whole, a file for each question.
//!
//! One program: what waits for a daemon, a disk or a broker runs beside what calculates.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

mod cards;
mod ci;
mod commission;
mod daemon;
mod data;
mod engine;
mod journal;
mod judges;
mod metrics;
mod model;
mod mqtt;
mod part;
mod readers;
mod real_motion;
mod reconcile_loop;
mod reference;
mod restart;
mod roles;
mod spool;
mod survival;
mod top;
mod trust;
