//! From a drawing to a probed, compensated part: the process-intermittent and the post-process loop of NISTIR 4854.
//!
//! | module | what lives there |
//! |---|---|
//! | [`contour`], [`drawing`] | the part's features in probing order; read from DXF |
//! | [`path`], [`web`] | probing points, the probe's path, collisions; the page to pick them in |
//! | [`program`] | the NC probing program: template, parameters, dialects |
//! | [`probe`] | captured trips against the plan |
//! | [`fit`], [`errors`] | circle and line through points; probed points to `error.cor` and whiskers |
//! | [`table`] | the finish cut's corrections, or the same as G01 moves |
//! | [`batch`] | the post-process loop: a batch measured off the machine |
//! | [`lathe`], [`experiment`] | a simulated turning centre for the unchanged engine; the report's experiment on it |
//! | [`svg`] | drawings as SVG |
//!
//! All lengths are in mm, all errors in µm. `z` runs along the part's axis, `x` is the distance from it (a radius).

pub mod batch;
pub mod contour;
pub mod drawing;
pub mod errors;
pub mod experiment;
pub mod fit;
pub mod lathe;
pub mod path;
pub mod probe;
pub mod program;
pub mod svg;
pub mod table;
pub mod web;
