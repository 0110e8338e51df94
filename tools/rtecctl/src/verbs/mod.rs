//! One file per verb: its options and one function.

pub(crate) mod characterise;
pub(crate) mod completions;
pub(crate) mod designs;
pub(crate) mod man;
pub(crate) mod model;
pub(crate) mod simulate;
