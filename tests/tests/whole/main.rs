//! Tests of the whole, one file for each question.
//!
//! They are one program, so that tests that wait for a daemon, a disk or a broker run beside those that calculate.

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
