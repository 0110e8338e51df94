//! A table in a format of the user's own.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_measure::compensation_export::user_format::UserFormat;
use std::path::Path;

/// The number of the last point must be one, too.
#[test]
fn points_are_counted_from_a_number_that_has_others_behind_it() {
    let form = |first: i64| {
        format!(
            "line = \"{{n}};{{position}};{{mean}}\"\nvalue = \"error\"\nvalue_unit = \"um\"\nposition_decimals = 3\n\
             value_decimals = 1\nmax_points = 128\nfirst_index = {first}\n"
        )
    };
    let parse = |first| UserFormat::parse(Path::new("f.toml"), &form(first), 0.0);
    assert!(parse(1).is_ok() && parse(-5).is_ok());
    let e = parse(i64::MAX).unwrap_err();
    assert_eq!((e.line, e.found.as_str()), (7, "first_index = 9223372036854775807"));
}
