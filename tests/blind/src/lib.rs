//! Blind cases: random machines with hidden effects, and marks of answers.
//!
//! The code that makes the cases ([`plan`], [`source`], [`case`]) and marks the answers ([`score`]) shares no code and
//! no formula with the reconciler.

// Experiments and formulas are long lists with switches, and texts are built in the simplest way.
#![allow(
    clippy::needless_for_each,
    clippy::too_many_lines,
    clippy::format_push_string,
    clippy::match_same_arms,
    clippy::struct_excessive_bools
)]

pub mod baseline;
pub mod bench;
pub(crate) mod bounds;
pub mod case;
pub mod changing;
pub mod choose;
pub mod class;
pub mod dice;
pub mod fast;
pub mod heat;
pub mod judge;
pub mod linear;
pub mod many;
pub mod maps;
pub mod mistakes;
pub mod oracle;
pub mod outcome;
pub mod pairs;
pub mod plan;
pub mod record;
pub mod rivals;
pub mod run;
pub mod scene;
pub mod score;
pub mod source;
pub mod strange;
pub mod strangers;
pub mod table;

pub use judge::judge;
