//! From a drawing to a probed, compensated part: the loops of NISTIR 4854.
//!
//! | module | content |
//! |---|---|
//! | [`contour`], [`length_unit`], `drawing` | the part's features in probing order; read from DXF |
//! | [`probe_path`] | probing points, the probe's path, collisions |
//! | [`probing_program`] | the NC probing program: template, parameters, dialects |
//! | [`probe_trip_check`] | captured trips compared with the plan |
//! | [`geometric_fit`], [`part_errors`] | circle and line through points; probed points to errors and whiskers |
//! | [`part_error_request`] | errors from probed points as users give them
//! | [`error_cor_file`] | `error.cor`, read and written |
//! | [`arc_finish_cut_table`], [`straight_finish_cut_table`] | the finish cut's corrections, or the same as G01 moves |
//! | [`batch_evaluation`] | the post-process loop: a batch measured off the machine |
//! | [`turning_plane_svg`] | drawings as SVG |
//! | [`session_comparison_html`] | two probing sessions side by side |
//!
//! Only geometry belongs here: no machine that moves (`rtec-sim`), no engine, no control law, no server.
//!
//! All lengths are in mm, all errors in µm. `z` is along the part's axis, `x` is the distance from it (a
//! radius).
//!
//! An example: `cargo run -p rtec-part --example fit_nose`. The tests run it too.

pub mod arc_finish_cut_table;
pub mod batch_evaluation;
pub mod contour;
pub mod contour_from_dxf;
mod dxf;
mod edge_tree;
pub mod error_cor_file;
pub mod geometric_fit;
pub mod length_unit;
pub mod part_error_request;
pub mod part_errors;
pub mod probe_path;
pub mod probe_trip_check;
pub mod probing_program;
mod reading_resolution;
mod repeated_touches;
pub mod session_comparison_html;
pub mod straight_finish_cut_table;
pub mod turning_plane_svg;
