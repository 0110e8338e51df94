//! One file per verb: its options and one function.

pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod demo;
pub(crate) mod man;
pub(crate) mod model;
pub(crate) mod platform;
pub(crate) mod reconcile;
pub(crate) mod replay;
pub(crate) mod selftest;
pub(crate) mod trace;
