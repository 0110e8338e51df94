//! `rtecctl trace`: converts quadrature traces, and makes them from positions.
//! The positions are from a measured record.

use crate::prelude::*;
use rtec_driver::trace_replay::TracePoint;
use rtec_files::cli_option_parsers::number;
use rtec_files::quadrature_trace::{AtomicTraceFile, TraceReader, trace_columns};
use rtec_files::trace_from_positions::{PositionRecord, PositionRecordOptions};
use std::time::{Duration, Instant};

super::verbs_below! {
    /// Convert quadrature traces, or make one from a measured position record
    Args;
    Convert ConvertArgs => convert;
    FromPosition FromPositionArgs => from_position;
}

/// Rewrite a trace; the extensions tell the formats (.csv: `t_ns,a,b`; .vcd: IEEE 1364, signals a and b)
#[derive(Debug, clap::Args)]
struct ConvertArgs {
    /// The trace to read
    input: PathBuf,
    /// The trace to write
    #[arg(value_parser = crate::verbs::output())]
    output: PathBuf,
    /// Columns or signals that have other names, or none, each by its name or number from 1; `t_us`, `t_ms` and `t_s` for
    /// times that are not in ns
    #[arg(long, value_name = "NAME=COLUMN", value_delimiter = ',')]
    columns: Vec<String>,
    /// Print the summary as one JSON document
    #[arg(long)]
    json: bool,
}

/// Make the trace that a scale gives along a measured position record (CSV: `t_s` and a position column)
#[derive(Debug, clap::Args)]
struct FromPositionArgs {
    /// The record: a header, a time column `t_s` (or `t_ms`, `t_us`, `t_ns`) and a position column
    input: PathBuf,
    /// What one count is worth, in µm
    #[arg(long, value_name = "UM",
          value_parser = number(|n| n.is_finite() && n > 0.0, "expected a number above 0"))]
    count_um: f64,
    /// The trace to write (.csv or .vcd)
    #[arg(long, value_name = "FILE", value_parser = crate::verbs::output())]
    out: PathBuf,
    #[command(flatten)]
    options: PositionRecordOptions,
    /// Print the summary as one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Default, PartialEq)]
struct TraceSummary {
    points: u64,
    illegal: u64,
    net_counts: i64,
    first: TracePoint,
    last: TracePoint,
    shortest_ns: Option<u64>,
}

impl TraceSummary {
    fn add(&mut self, point: TracePoint) {
        if self.points == 0 {
            self.first = point;
        } else {
            match self.last.state.step_to(point.state) {
                Some(step) => self.net_counts += i64::from(step),
                None => self.illegal += 1,
            }
            let interval = point.t_ns - self.last.t_ns;
            self.shortest_ns = Some(self.shortest_ns.map_or(interval, |s| s.min(interval)));
        }
        self.last = point;
        self.points += 1;
    }

    fn print(&self, out: &Path, json: bool) -> anyhow::Result<()> {
        let Self { net_counts, illegal, shortest_ns, .. } = self;
        let (edges, start_ns, end_ns) = (self.points.saturating_sub(1), self.first.t_ns, self.last.t_ns);
        if json {
            return say_line(&serde_json::json!({
                "out": out, "edges": edges, "net_counts": net_counts, "illegal": illegal,
                "start_ns": start_ns, "end_ns": end_ns, "min_edge_separation_ns": shortest_ns,
            }));
        }
        let (out, s) = (out.display(), (end_ns - start_ns) as f64 / 1e9);
        let apart = shortest_ns.map_or_else(|| "-".to_owned(), |ns| ns.to_string());
        println!(
            "{out}: {edges} edges, {net_counts:+} counts net, {illegal} illegal, {s:.6} s, edges at least {apart} ns apart"
        );
        Ok(())
    }
}

/// A trace being written; it reports its progress every two seconds.
struct TraceFileWriter<'a> {
    path: &'a Path,
    file: AtomicTraceFile,
    summary: TraceSummary,
    shown_at: Instant,
}

impl<'a> TraceFileWriter<'a> {
    fn create(path: &'a Path) -> anyhow::Result<Self> {
        let (file, summary) = (AtomicTraceFile::create(path)?, TraceSummary::default());
        Ok(Self { path, file, summary, shown_at: Instant::now() })
    }

    fn write(&mut self, point: TracePoint) -> anyhow::Result<()> {
        self.summary.add(point);
        if self.summary.points.is_multiple_of(1 << 20) && self.shown_at.elapsed() > Duration::from_secs(2) {
            self.shown_at = Instant::now();
            eprintln!("{} edges, at {:.3} s", self.summary.points, point.t_ns as f64 / 1e9);
        }
        self.file.write(point).with_context(|| format!("writing {}", self.path.display()))
    }

    fn finish(self) -> anyhow::Result<TraceSummary> {
        self.file.finish().with_context(|| format!("writing {}", self.path.display()))?;
        Ok(self.summary)
    }
}

fn convert(args: &ConvertArgs) -> anyhow::Result<()> {
    let mut reader = TraceReader::open_columns(&args.input, &trace_columns(&args.columns)?)?;
    if let Some(written) = reader.written() {
        eprintln!("note: {written}");
    }
    let mut out = TraceFileWriter::create(&args.output)?;
    while let Some(point) = reader.next_point()? {
        out.write(point)?;
    }
    let summary = out.finish()?;
    for said in [reader.notes(), reader.sampled()].into_iter().flatten() {
        eprintln!("note: {said}");
    }
    summary.print(&args.output, args.json)
}

fn from_position(args: &FromPositionArgs) -> anyhow::Result<()> {
    made(args)?.print(&args.out, args.json)
}

fn made(args: &FromPositionArgs) -> anyhow::Result<TraceSummary> {
    let FromPositionArgs { input, count_um, options, .. } = args;
    let record = PositionRecord { file: input.clone(), count_um: *count_um, options: options.clone() };
    let mut out = TraceFileWriter::create(&args.out)?;
    record.trace(&mut |said| eprintln!("{said}"), &mut |point| out.write(point))?;
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run_from(text: &str, options: &[&str]) -> (anyhow::Result<TraceSummary>, String) {
        use clap::Parser;
        #[derive(Parser)]
        struct Cli {
            #[command(flatten)]
            args: FromPositionArgs,
        }
        let directory = tempfile::tempdir().unwrap();
        let (input, out) = (directory.path().join("p.csv"), directory.path().join("t.csv"));
        std::fs::write(&input, text).unwrap();
        let fixed = ["x", input.to_str().unwrap(), "--out", out.to_str().unwrap()];
        let summary = made(&Cli::parse_from(fixed.iter().chain(options)).args);
        let written = std::fs::read_to_string(&out).unwrap_or_default();
        let left = std::fs::read_dir(directory.path()).unwrap().count();
        assert_eq!(
            left,
            if summary.is_ok() { 2 } else { 1 },
            "no output and no temporary file after an error"
        );
        let summary = summary.map_err(|e| {
            anyhow::anyhow!("{}", e.to_string().replace(directory.path().to_str().unwrap(), ""))
        });
        (summary, written)
    }

    #[test]
    fn a_record_whose_trace_has_no_end_is_refused_first() {
        let refused = |text: &str, options: &[&str]| {
            let (summary, written) = run_from(text, options);
            assert!(written.is_empty());
            summary.unwrap_err().to_string()
        };
        let text = "t_s,position_um\n0,0\n1,300000000\n";
        assert!(text.len() <= 33);
        let error = refused(text, &["--count-um", "1"]);
        assert!(
            error.contains(":3: found a way of 300000000 counts so far, expected at most 50000000"),
            "{error}"
        );
        // The way back counts too.
        let back: Vec<String> = (0..100).map(|n| format!("{n},{}", n % 2 * 1000)).collect();
        let text = format!("t_s,position_um\n{}\n", back.join("\n"));
        let error = refused(&text, &["--count-um", "1", "--most-edges", "98999"]);
        assert!(error.contains("found a way of 99000 counts"), "{error}");
        assert!(run_from(&text, &["--count-um", "1", "--most-edges", "99000"]).0.is_ok());
    }

    #[test]
    fn a_record_becomes_a_trace() {
        let text = "\u{feff}# run 3\r\nt_s,reference_m,position_m\r\n0,0,0.0000005\r\n0.001,9,0.0000025\r\n";
        let (summary, written) = run_from(text, &["--count-um", "1", "--hysteresis-counts", "0"]);
        assert_eq!(written, "t_ns,a,b\n0,0,0\n250000,1,0\n750000,1,1\n");
        assert_eq!(summary.unwrap().net_counts, 2);
        let same = "t_ms,x_mm,p\n0,0.5,0\n1,2.5,0\n";
        let options = ["--count-um", "1000", "--hysteresis-counts", "0", "--column", "x_mm"];
        assert_eq!(run_from(same, &options).1, written);
        let bare =
            run_from("t_s,position\n0,0.5\n0.001,2.5\n", &["--count-um", "1e6", "--hysteresis-counts", "0"]);
        assert_eq!(bare.1, written);
    }

    #[test]
    fn units_of_the_names_are_read() {
        let wants = "t_ns,a,b\n0,0,0\n250000,1,0\n750000,1,1\n";
        for (text, options) in [
            (
                "Time [ms],X [mm]\n0,0.0005\n1,0.0025\n",
                &["--time-column", "Time [ms]", "--column", "X [mm]"][..],
            ),
            ("Time (us);position (µm)\n0;0,5\n1000;2,5\n", &[]),
            ("t_ms,pos (in)\n0,0.0000196850394\n1,0.0000984251969\n", &["--column", "pos (in)"]),
            ("scope x\nmade,2026\n; by y\nt_s,note,position_um\n0,a,0.5\n0.001,b,2.5\n", &[]),
        ] {
            let options: Vec<&str> =
                ["--count-um", "1", "--hysteresis-counts", "0"].iter().chain(options).copied().collect();
            let (summary, written) = run_from(text, &options);
            assert_eq!(written, wants, "{text}: {:?}", summary.err());
        }
        let of = |time: &str| format!("Time [{time}],X [furlong]\n0,0\n1,1\n");
        for (time, options, says) in [
            ("min", &[][..], "one of s, ms, us, ns, d, or --time-unit"),
            ("min", &["--time-unit", "s"], "with --time-unit s: its name says min"),
            ("s", &[], "one of m, mm, um, nm, in, or --unit"),
        ] {
            let options: Vec<&str> =
                ["--time-column", "1", "--column", "2"].iter().chain(options).copied().collect();
            let options: Vec<&str> = ["--count-um", "1"].iter().chain(&options).copied().collect();
            let error = run_from(&of(time), &options).0.unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn a_bad_record_is_explained_and_nothing_is_written() {
        let table = [
            ("", "/p.csv: found no header, expected a header such as t_s,position_mm"),
            ("t_s,position_mm\n", "/p.csv: found no rows, expected a header and at least one row"),
            (
                "t,position_mm\n0,0\n",
                "/p.csv:1:1: found the columns t,position_mm, expected a time column: t_s, t_ms, t_us or t_ns, or --time-column",
            ),
            (
                "t_s,position_mm,position_m\n0,0\n",
                "/p.csv:1:1: found the columns t_s,position_mm,position_m, expected one column whose name begins with position (or --column NAME)",
            ),
            (
                "t_s,position_mm\n0,0\n0.1\n",
                "/p.csv:3:4: found the end of the row after 1 of 2 fields, expected the field position_mm",
            ),
            (
                "t_s,position_mm\n0,0\n0.1,inf\n",
                "/p.csv:3:5: found 'inf', expected the position: a finite number",
            ),
            (
                "t_s,position_mm\n0.2,0\n0.1,1\n",
                "/p.csv:3: found the time 0.1 s, expected a time after the row before, 0.2 s",
            ),
            (
                "t_s,position_mm\n0,0\n0.000000001,1\n",
                "/p.csv:3: found a faster motion, expected a motion of at most one count a nanosecond (is --count-um, or the unit, too small?)",
            ),
        ];
        for (text, message) in table {
            let (summary, written) = run_from(text, &["--count-um", "1"]);
            assert_eq!(summary.unwrap_err().to_string(), message);
            assert_eq!(written, "");
        }
    }
}
