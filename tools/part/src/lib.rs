//! From a drawing to a probed, compensated part: the loops of NISTIR 4854.
//!
//! | module | content |
//! |---|---|
//! | [`contour`], [`mod@unit`], `drawing` | the part's features in probing order; read from DXF |
//! | [`probe_path`] | probing points, the probe's path, collisions |
//! | [`probing_program`] | the NC probing program: template, parameters, dialects |
//! | [`trip_check`] | captured trips compared with the plan |
//! | [`geometric_fit`], [`part_errors`] | circle and line through points; probed points to errors and whiskers |
//! | [`error_determination`] | errors from probed points as users give them
//! | [`error_cor_file`] | `error.cor`, read and written |
//! | [`finish_table`], [`straight_table`] | the finish cut's corrections, or the same as G01 moves |
//! | [`batch`] | the post-process loop: a batch measured off the machine |
//! | [`svg`] | drawings as SVG |
//! | [`comparison_page`] | two probing sessions side by side |
//!
//! Only geometry belongs here: no machine that moves (`rtec-sim`), no engine, no control law, no server.
//!
//! All lengths are in mm, all errors in µm. `z` is along the part's axis, `x` is the distance from it (a
//! radius).
//!
//! An example: `cargo run -p rtec-part --example fit_nose`. The tests run it too.

pub mod batch;
pub mod comparison_page;
pub mod contour;
pub mod drawing;
mod dxf;
mod edge_tree;
pub mod error_cor_file;
pub mod error_determination;
pub mod finish_table;
pub mod geometric_fit;
pub mod part_errors;
pub mod probe_path;
pub mod probing_program;
mod repeats;
pub mod straight_table;
pub mod svg;
pub mod trip_check;
pub mod unit;
mod written_step;
