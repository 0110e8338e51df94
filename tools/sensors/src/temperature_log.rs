//! The log of temperatures, which a restart reads back for the model's lags.

use rtec_files::csv;
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;

/// File names of the log and of the previous one.
pub const NAMES: [&str; 2] = ["temperatures.csv", "temperatures.old.csv"];
/// Size at which the log becomes the old one, bytes: some days of twenty sensors.
const FULL: u64 = 16 << 20;

/// Adds a row; values of sensors that are not good are left empty.
pub(crate) fn append(
    directory: &Path,
    names: &[String],
    now_s: f64,
    values: &[Option<f64>],
) -> io::Result<()> {
    let [path, old] = NAMES.map(|n| directory.join(n));
    let header = format!("t,{}\n", csv::header_line(names.iter().map(String::as_str)));
    let mut begun = String::new();
    if let Ok(file) = File::open(&path) {
        let size = file.metadata()?.len();
        BufReader::new(file).read_line(&mut begun)?;
        if size > FULL || begun != header {
            std::fs::rename(&path, old)?;
            begun.clear();
        }
    }
    let mut row = if begun.is_empty() { header } else { String::new() };
    let cell = |v: &Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let cells: Vec<String> = values.iter().map(cell).collect();
    row += &[format!("{now_s:.3}"), cells.join(",")].join(",");
    row.push('\n');
    // One write: a row is whole, or torn at the file's end, where the reader drops it.
    OpenOptions::new().append(true).create(true).open(path)?.write_all(row.as_bytes())
}

/// The logged rows of these sensors, oldest first: time and temperatures, °C.
/// Rows with an unknown value are left out, as are torn rows and times that the clock passed twice.
pub fn history(directory: &Path, names: &[String], now_s: f64) -> Vec<(f64, Vec<f64>)> {
    let mut rows: Vec<(f64, Vec<f64>)> = Vec::new();
    for name in NAMES.iter().rev() {
        let file = directory.join(name);
        let Ok(mut bytes) = std::fs::read(&file) else { continue };
        // A line without an end was torn.
        bytes.truncate(bytes.iter().rposition(|b| *b == b'\n').map_or(0, |end| end + 1));
        let Ok(mut reader) = csv::Reader::new(&file, bytes.as_slice()) else { continue };
        let Ok(header) = reader.header("the sensors' names") else { continue };
        let places: Option<Vec<usize>> = names.iter().map(|n| header.find(n)).collect();
        let Some(places) = places else { continue };
        loop {
            let row = match reader.row() {
                Ok(Some(row)) => row,
                Ok(None) => break,
                Err(_) => continue,
            };
            let Ok(cells) = header.cells(row) else { continue };
            let values: Result<Vec<f64>, _> = places.iter().map(|k| cells[*k].finite()).collect();
            if let (Ok(t_s), Ok(values)) = (cells[0].finite(), values)
                && t_s <= now_s
                && rows.last().is_none_or(|(before, _)| *before < t_s)
            {
                rows.push((t_s, values));
            }
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_log_comes_back_and_what_is_torn_or_unknown_does_not() {
        let directory = tempfile::tempdir().unwrap();
        let names = |n: &[&str]| n.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>();
        let put = |n: &[&str], t, v: &[Option<f64>]| append(directory.path(), &names(n), t, v).unwrap();
        put(&["T1", "T2"], 1.0, &[Some(20.0), Some(21.5)]);
        put(&["T1", "T2"], 2.0, &[Some(20.1), None]);
        put(&["T1", "T2"], 3.0, &[Some(20.2), Some(21.7)]);
        // Other sensors give a new log; the old one is still read.
        put(&["T2", "T1", "T3"], 4.0, &[Some(21.8), Some(20.3), None]);
        put(&["T2", "T1", "T3"], 3.5, &[Some(21.8), Some(20.3), None]);
        put(&["T2", "T1", "T3"], 99.0, &[Some(21.8), Some(20.3), None]);
        let path = directory.path().join(NAMES[0]);
        OpenOptions::new().append(true).open(path).unwrap().write_all(b"5.0,21.9,2").unwrap();
        let found = history(directory.path(), &names(&["T1", "T2"]), 50.0);
        let want = [(1.0, vec![20.0, 21.5]), (3.0, vec![20.2, 21.7]), (4.0, vec![20.3, 21.8])];
        assert_eq!(found, want);
        assert_eq!(history(directory.path(), &names(&["T1"]), 50.0).len(), 4);
        assert!(history(directory.path(), &names(&["T9"]), 50.0).is_empty());
    }
}
