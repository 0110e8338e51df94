//! The daemon's answers, as its clients read them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::daemon_client::read_answer;

fuzz_target!(|data: &[u8]| {
    let Some(_) = rtec_fuzz::text(data) else { return };
    let Some(answer) = rtec_fuzz::checked(read_answer(data)) else { return };
    let line = serde_json::to_string(&answer).expect("an answer is JSON") + "\n";
    assert_eq!(read_answer(line.as_bytes()).expect("what is written is read"), answer, "{line}");
});
