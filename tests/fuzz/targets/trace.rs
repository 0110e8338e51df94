//! Recorded quadrature as CSV, and requested totals.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_files::quadrature_trace::{RequestedTotalReader, TraceFormat, TraceReader, TraceWriter};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new(rtec_fuzz::NAME);
    let Some(_) = rtec_fuzz::text(data) else { return };
    if let Some(requests) = rtec_fuzz::checked(RequestedTotalReader::new(file, data)) {
        rtec_fuzz::checked(requests.collect::<Result<Vec<_>, _>>());
    }
    let Some(points) = rtec_fuzz::checked(TraceReader::new(TraceFormat::Csv, file, data)) else { return };
    let Some(points) = rtec_fuzz::checked(points.collect::<Result<Vec<_>, _>>()) else { return };
    for format in [TraceFormat::Csv, TraceFormat::Vcd] {
        let mut out = TraceWriter::new(format, Vec::new()).expect("memory can be written to");
        points.iter().for_each(|point| out.write(*point).expect("memory can be written to"));
        let written = out.finish().expect("memory can be written to");
        let again = TraceReader::new(format, file, written.as_slice()).expect("what is written is read");
        assert_eq!(again.collect::<Result<Vec<_>, _>>().expect("what is written is read"), points);
    }
});
