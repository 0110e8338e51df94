//! The last lines of `cargo test --workspace`: tests that were not run, and why.
//!
//! It is a program without a test harness, which would hide its output.

use test_needs::{note, take_notes};

fn main() {
    let noted = take_notes();
    // A planted note must be found, or the list could be empty for a wrong reason.
    assert!(note("planted").is_some() && take_notes() == [("planted".to_owned(), "main".to_owned())]);
    if noted.is_empty() {
        println!("\nNothing was left out: all counterparts and data were there.");
        return;
    }
    println!(
        "\nNOT RUN, or not all of it, {} tests (RTEC_REQUIRE=1 runs what takes long, and fails where something else is missing):",
        noted.len()
    );
    for (why, test) in &noted {
        println!("  {test}: {why}");
    }
}
