//! Requests to the daemon.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_control::protocol::ClientRequest;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let Some(request) = rtec_fuzz::checked(ClientRequest::parse(&text)) else { return };
    let line = serde_json::to_string(&request).expect("a request is JSON");
    assert_eq!(ClientRequest::parse(&line).expect("what is written is read"), request, "{line}");
});
