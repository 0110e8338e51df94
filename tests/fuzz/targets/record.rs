//! Run records: the sidecar, and the CSV beside it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_measure::run_record_files;

fuzz_target!(|data: &[u8]| {
    let Some(text) = rtec_fuzz::text(data) else { return };
    let [sidecar, csv] = rtec_fuzz::parts(&text);
    rtec_fuzz::put("a.csv", csv.as_bytes());
    let path = rtec_fuzz::put("a.run.toml", sidecar.as_bytes());
    let Some(mut read) = rtec_fuzz::checked(run_record_files::read_log(&path)) else { return };
    // Beside the sidecar, whatever name the record gives its CSV.
    (read.path, read.file) = (path.with_file_name("b.run.toml"), "b.csv".to_owned());
    run_record_files::write(&mut read).expect("the folder can be written to");
    assert_eq!(run_record_files::read_log(&read.path).expect("what is written is read"), read);
});
