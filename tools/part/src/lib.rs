//! From a drawing to a probed, compensated part: the process-intermittent and the post-process loop of NISTIR 4854.
//!
//! | module | what lives there |
//! |---|---|
//! | [`sheet`] | CSV files of numbers, with findings by line and column |
//! | [`fit`] | circle and line through points: least squares, the report's two steps, robust |
//! | [`errors`] | probed points to part errors: `error.cor`, whiskers |
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
pub mod sheet;
pub mod svg;
pub mod table;
pub mod web;
