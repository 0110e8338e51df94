//! Compares the time to read a record with that of the `csv` crate.
//! Prints nanoseconds, each the least of several alternating readings, and asserts nothing. Memory and caches are then as warm as for
//! pandas, which `tests/cost.py records` alternates with this. Run `cargo bench --workspace --bench record_speed -- FILE.run.toml
//! [READINGS]`.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Cargo adds `--bench` of its own.
    let Some(file) = std::env::args().skip(1).find(|a| a != "--bench").map(PathBuf::from) else {
        println!("record_speed: nothing to read without FILE.run.toml");
        return Ok(());
    };
    let readings = std::env::args().find_map(|a| a.parse().ok()).unwrap_or(1_u32).max(1);
    let (mut ours, mut theirs) = (Duration::MAX, Duration::MAX);
    let (mut record, mut columns) = (rtec_measure::run_record_files::read(&file)?, Vec::new());
    for _ in 0..readings {
        let begun = Instant::now();
        record = rtec_measure::run_record_files::read(&file)?;
        ours = ours.min(begun.elapsed());
        let begun = Instant::now();
        columns = by_crate(&file.with_file_name(&record.file))?;
        theirs = theirs.min(begun.elapsed());
    }
    // Both have read the same numbers.
    let sum = |columns: &mut dyn Iterator<Item = &Vec<f64>>| columns.flatten().sum::<f64>();
    let own = sum(&mut record.columns.iter().map(|c| &c.data));
    assert_eq!(own.to_bits(), sum(&mut columns.iter()).to_bits());
    println!("{} {}", ours.as_nanos(), theirs.as_nanos());
    Ok(())
}

/// The columns of a CSV, by the `csv` crate and the standard library's parser.
fn by_crate(file: &Path) -> Result<Vec<Vec<f64>>, Box<dyn std::error::Error>> {
    let mut reader = csv::Reader::from_path(file)?;
    let mut columns = vec![Vec::new(); reader.byte_headers()?.len()];
    let mut row = csv::ByteRecord::new();
    while reader.read_byte_record(&mut row)? {
        for (column, cell) in columns.iter_mut().zip(&row) {
            column.push(std::str::from_utf8(cell)?.parse()?);
        }
    }
    Ok(columns)
}
