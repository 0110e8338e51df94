//! The last lines of `cargo test --workspace`: what was not run, and why.
//!
//! A program without a test harness, which would hide them.

use test_needs::{note, take_notes};

fn main() {
    let noted = take_notes();
    // A note must be found again, or the list is empty for the wrong reason.
    assert!(note("planted").is_some() && take_notes() == [("planted".to_owned(), "main".to_owned())]);
    if noted.is_empty() {
        println!("\nNothing that was asked for was left out: all counterparts and data were there.");
        return;
    }
    println!(
        "\nNOT RUN, {} of the tests that were asked for (RTEC_REQUIRE=1 makes each a failure):",
        noted.len()
    );
    for (why, test) in &noted {
        println!("  {test}: {why}");
    }
}
