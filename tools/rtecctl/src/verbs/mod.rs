//! One file per verb: its options and one function.

pub(crate) mod characterise;
pub(crate) mod clear;
pub(crate) mod commission;
pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod correct;
pub(crate) mod demo;
pub(crate) mod designs;
pub(crate) mod disable;
pub(crate) mod enable;
pub(crate) mod explain;
pub(crate) mod hold;
pub(crate) mod home;
pub(crate) mod man;
pub(crate) mod model;
pub(crate) mod park;
pub(crate) mod part;
pub(crate) mod platform;
pub(crate) mod probe;
pub(crate) mod reconcile;
pub(crate) mod replay;
pub(crate) mod selftest;
pub(crate) mod shadow;
pub(crate) mod simulate;
pub(crate) mod status;
pub(crate) mod trace;
