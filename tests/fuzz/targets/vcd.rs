//! Recorded quadrature as VCD.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rtec_files::quadrature_trace::{TraceFormat, TraceReader, TraceWriter};
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let file = Path::new(rtec_fuzz::NAME);
    rtec_fuzz::text(data);
    let Some(points) = rtec_fuzz::checked(TraceReader::new(TraceFormat::Vcd, file, data)) else { return };
    let Some(points) = rtec_fuzz::checked(points.collect::<Result<Vec<_>, _>>()) else { return };
    let mut out = TraceWriter::new(TraceFormat::Csv, Vec::new()).expect("memory can be written to");
    points.iter().for_each(|point| out.write(*point).expect("memory can be written to"));
    let written = out.finish().expect("memory can be written to");
    let again =
        TraceReader::new(TraceFormat::Csv, file, written.as_slice()).expect("what is written is read");
    assert_eq!(again.collect::<Result<Vec<_>, _>>().expect("what is written is read"), points);
});
