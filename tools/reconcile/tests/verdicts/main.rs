//! Verdicts from outside, a file a question. One program: what takes long runs beside the rest.

mod ballbar;
mod doubted;
mod nameless;
mod names;
mod next_run;
mod noise;
mod one_room;
mod page;
mod weighed;
mod zeros;
