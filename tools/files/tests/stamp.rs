//! A program that states its commit. It does so once: a process of its own.

use rtec_files::format_stamp::{built_from, by, signed};

#[test]
fn documents_name_the_commit() {
    built_from("c7e189b04e");
    assert!(by().ends_with(" (c7e189b04e)"), "{}", by());
    assert!(signed("{}".to_owned()).ends_with(" (c7e189b04e)\"}"));
}
