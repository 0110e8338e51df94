//! A program that states its commit. It does so once: a process of its own.

use rtec_files::file_format_stamp::{built_from, signed, writer};

#[test]
fn documents_name_the_commit() {
    built_from("c7e189b04e");
    assert!(writer().ends_with(" (c7e189b04e)"), "{}", writer());
    assert!(signed("{}".to_owned()).ends_with(" (c7e189b04e)\"}"));
}
