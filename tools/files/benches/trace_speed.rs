//! Prints the time per row for reading and writing a trace.
//! Run it with `cargo bench -p rtec-files --bench trace_speed [-- ROWS]`.

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use rtec_files::quadrature_trace::{TraceFormat, TraceReader, TraceWriter};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let rows: u64 = std::env::args().skip(1).find_map(|n| n.parse().ok()).unwrap_or(20_000_000);
    for (format, rows) in [(TraceFormat::Csv, rows), (TraceFormat::Vcd, rows / 4)] {
        let mut writer = TraceWriter::new(format, Vec::with_capacity(20 * rows as usize))?;
        let mut point = TracePoint { t_ns: 1_000_000_000, state: State::default() };
        let start = Instant::now();
        for n in 0..rows {
            writer.write(point)?;
            point = TracePoint { t_ns: point.t_ns + 1500 + n % 977, state: point.state.next(n & 4096 == 0) };
        }
        let text = writer.finish()?;
        let written = start.elapsed();

        let start = Instant::now();
        let (mut read, mut check) = (0_u64, 0_u64);
        let mut reader = TraceReader::new(format, Path::new("memory"), text.as_slice())?;
        while let Some(point) = reader.next_point()? {
            read += 1;
            check ^= point.t_ns + u64::from(point.state.bits());
        }
        let spent = start.elapsed();
        println!(
            "{format:?}: {read} rows of {:.1} bytes, write {:.2} ns/row, read {:.2} ns/row ({:.1} million rows/s), check {check:x}",
            text.len() as f64 / rows as f64,
            written.as_nanos() as f64 / rows as f64,
            spent.as_nanos() as f64 / read as f64,
            read as f64 / spent.as_secs_f64() / 1e6,
        );
    }
    Ok(())
}
