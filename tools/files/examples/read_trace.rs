//! Reads a recorded quadrature trace and counts its edges.
//! A wrong row is reported with its place.
use rtec_files::quadrature_trace::{TraceFormat, TraceReader};
use std::path::Path;

const TRACE: &str = "t_ns,a,b\n0,0,0\n1000,1,0\n2500,1,1\n4000,0,1\n5200,1,1\n";

#[cfg_attr(test, test)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = Path::new("scale.csv");
    let mut trace = TraceReader::new(TraceFormat::Csv, file, TRACE.as_bytes())?;
    let mut before = trace.next_point()?.ok_or("a trace without its initial state")?;
    let (mut counts, mut shortest_ns) = (0_i64, u64::MAX);
    while let Some(point) = trace.next_point()? {
        counts += if point.state == before.state.next(true) { 1 } else { -1 };
        shortest_ns = shortest_ns.min(point.t_ns - before.t_ns);
        before = point;
    }
    println!("{counts} counts, edges no closer than {shortest_ns} ns");
    assert_eq!((counts, shortest_ns), (2, 1000)); // three counts forwards, one back

    let wrong = TRACE.replace("4000", "400");
    let mut trace = TraceReader::new(TraceFormat::Csv, file, wrong.as_bytes())?;
    let finding = std::iter::from_fn(|| trace.next_point().transpose()).find_map(Result::err);
    println!("{}", finding.ok_or("time that runs backwards was not seen")?);
    Ok(())
}
