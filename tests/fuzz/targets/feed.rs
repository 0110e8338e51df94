//! Sensor lines, as they come over a wire.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_sensors::sensor_text_stream::SensorTextStream;

fuzz_target!(|data: &[u8]| {
    let path = rtec_fuzz::put("tty", data);
    let from = path.to_str().expect("a path of letters");
    let mut all = SensorTextStream::new(from);
    let mut one = SensorTextStream::of(from, ["T1".to_owned()]);
    for feed in [&mut all, &mut one] {
        feed.poll(0.0);
        match feed.value("T1") {
            Ok(_) => {}
            Err(trouble) => rtec_fuzz::fit(&trouble),
        }
    }
    assert_eq!(all.value("T1").is_ok(), one.value("T1").is_ok());
});
