//! Records, evaluations, imports and their mistakes from outside.
//! One program: what takes long runs beside the rest.

mod air;
mod ballbar;
mod ballbar_arcs;
mod ballbar_one_way;
mod circles;
mod derive;
mod evaluations;
mod field;
mod history;
mod imports;
mod own_form;
mod plan;
mod plausible;
mod plots;
mod positioning;
mod prediction;
mod steps;
