//! Blind cases: random machines with something hidden, and the score of an answer. Shares no code and no formula
//! with what it judges.

pub mod case;
pub mod score;
pub mod world;
