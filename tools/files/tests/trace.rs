//! Reading and writing of traces and requests.
//! The tests also check the messages about bad files.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use proptest::prelude::*;
use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::{RequestedTotal, TracePoint};
use rtec_files::InputError;
use rtec_files::quadrature_trace::{
    AtomicTraceFile, RequestedTotalReader, TraceFormat, TraceReader, TraceWriter,
};
use std::io::Read;
use std::path::Path;

const GOLDEN_CSV: &str = include_str!("golden/quadrature.csv");
const GOLDEN_VCD: &str = include_str!("golden/quadrature.vcd");

fn point(t_ns: u64, a: u8, b: u8) -> TracePoint {
    TracePoint { t_ns, state: State::new(a == 1, b == 1) }
}

/// The golden files' points.
/// They have an ordinary start, an illegal transition 1 ns later, and the last possible time.
fn golden() -> Vec<TracePoint> {
    vec![point(0, 0, 0), point(1000, 1, 0), point(1500, 1, 1), point(1501, 0, 0), point(u64::MAX, 0, 1)]
}

fn read(format: TraceFormat, text: impl AsRef<[u8]>) -> Result<Vec<TracePoint>, InputError> {
    TraceReader::new(format, Path::new("t"), text.as_ref())?.collect()
}

fn csv(text: &str) -> Result<Vec<TracePoint>, InputError> {
    read(TraceFormat::Csv, text)
}

fn vcd(text: &str) -> Result<Vec<TracePoint>, InputError> {
    read(TraceFormat::Vcd, text)
}

fn write(format: TraceFormat, points: &[TracePoint]) -> Vec<u8> {
    let mut writer = TraceWriter::new(format, Vec::new()).unwrap();
    for &point in points {
        writer.write(point).unwrap();
    }
    writer.finish().unwrap()
}

/// Gives one byte at a time, so that every row meets the end of the buffer.
struct Drip<'a>(&'a [u8]);

impl Read for Drip<'_> {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let Some((&first, rest)) = self.0.split_first() else { return Ok(0) };
        self.0 = rest;
        out[0] = first;
        Ok(1)
    }
}

#[test]
fn text_written_is_the_golden_text() {
    assert_eq!(String::from_utf8(write(TraceFormat::Csv, &golden())).unwrap(), GOLDEN_CSV);
    assert_eq!(String::from_utf8(write(TraceFormat::Vcd, &golden())).unwrap(), GOLDEN_VCD);
}

#[test]
fn golden_text_reads_back() {
    assert_eq!(csv(GOLDEN_CSV).unwrap(), golden());
    assert_eq!(vcd(GOLDEN_VCD).unwrap(), golden());
}

#[test]
fn bom_crlf_comments_blank_lines_and_spaces_are_no_matter() {
    let text = "\u{feff}# from the bench\r\n\r\nt_ns, a, b\r\n0,0,0\r\n# turn\r\n 5 , 1 , 0 # up\r\n7,1,1\r\n\r\n8,0,1";
    assert_eq!(csv(text).unwrap(), [point(0, 0, 0), point(5, 1, 0), point(7, 1, 1), point(8, 0, 1)]);
    assert_eq!(csv(&GOLDEN_CSV.replace('\n', "\r\n")).unwrap(), golden());
}

#[test]
fn csv_errors_say_where_and_what() {
    let long = format!("t_ns,a,b\n0,0,0\n{}", "9".repeat(200_000));
    let table: &[(&str, &str)] = &[
        (
            "",
            "t: found no header, expected the header t_ns,a,b, or --columns with the columns' names or numbers",
        ),
        ("t_ns,a,b\n", "t: found a trace without a point, expected at least the initial state of a and b"),
        (
            "0,0,0\n",
            "t:1:1: found numbers ('0,0,0') in the first line, expected the header t_ns,a,b in front of them, or --columns with the columns' names or numbers",
        ),
        (
            "t_ns,requested\n0,4\n",
            "t:1:1: found requested totals: it has columns t_ns, requested, expected the header t_ns,a,b, or --columns with the columns' names or numbers",
        ),
        (
            "t_us,a,b\n0,0,0\n",
            "t:1:1: found 't_us,a,b', expected the header t_ns,a,b, or --columns with the columns' names or numbers",
        ),
        ("t_ns,a,b\n0,0,0\n5,1,0\n4,1,1\n", "t:4:1: found '4', expected a time after the row before, 5 ns"),
        ("t_ns,a,b\n0,0,0\n5,1,0\n5,1,1\n", "t:4:1: found '5', expected a time after the row before, 5 ns"),
        (
            "t_ns,a,b\n0,0,0\n5,0,0\n",
            "t:3:3: found the state 0,0 again, expected a change of a or b: one row per change",
        ),
        ("t_ns,a,b\n0,0,0\n50,2,0\n", "t:3:4: found '2', expected the level 0 or 1"),
        ("t_ns,a,b\n0,0,0\n50,1,\n", "t:3:6: found nothing, expected the level 0 or 1"),
        (
            "t_ns,a,b\n0,0,0\n50,1",
            "t:3:5: found the end of the row after 2 of 3 fields, expected the field b",
        ),
        ("t_ns,a,b\n0,0,0,7\n", "t:2:7: found '7', expected the end of the row after t_ns,a,b"),
        (
            "t_ns,a,b\n 1.5,0,0\n",
            "t:2:2: found '1.5', expected a time in whole ns, from 0 to 18446744073709551615",
        ),
        (
            "t_ns,a,b\n18446744073709551616,0,0\n",
            "t:2:1: found '18446744073709551616', expected a time in whole ns, from 0 to 18446744073709551615",
        ),
        ("t_ns,a,b\n0,0,nan\n", "t:2:5: found 'nan', expected the level 0 or 1"),
        (&long, "t:3: found 131072 bytes without an end of line, expected a text file of short lines"),
    ];
    for (text, message) in table {
        assert_eq!(csv(text).unwrap_err().to_string(), *message, "{}", &text[..text.len().min(60)]);
    }
    assert_eq!(
        read(TraceFormat::Csv, b"t_ns,a,b\n0,0,\xff\n").unwrap_err().to_string(),
        "t:2:5: found 'ÿ', expected the level 0 or 1"
    );
}

#[test]
fn vcd_with_scopes_other_signals_and_any_timescale() {
    let text = |scale: &str| {
        format!(
            "$date today $end $version bench $end\n$timescale {scale} $end\n$scope module top $end\n\
             $var wire 8 % bus [7:0] $end $var real 64 & volts $end $var reg 1 aa A $end\n$scope module in $end\n\
             $var wire 1 bb b [0] $end $upscope $end $upscope $end\n$enddefinitions $end\n\
             $comment noise of any length $end\n#10 $dumpvars bxz % r1.5 & 0aa 0bb $end\n#20 b11 % 1aa 0aa 1aa\n\
             #30 r2 &\n#40 b1 bb\n#50 $dumpall 1aa 1bb $end\n#60 0aa 0bb\n"
        )
    };
    for (scale, ns) in
        [("1ns", 1), ("100 ns", 100), ("10 us", 10_000), ("1 ms", 1_000_000), ("1 s", 1_000_000_000)]
    {
        let want = [point(10 * ns, 0, 0), point(20 * ns, 1, 0), point(40 * ns, 1, 1), point(60 * ns, 0, 0)];
        assert_eq!(vcd(&text(scale)).unwrap(), want, "{scale}");
    }
    assert_eq!(vcd(&text("100 ps")).unwrap()[1], point(2, 1, 0));
    assert_eq!(
        vcd(&text("10 ps")).unwrap_err().to_string(),
        "t:11:1: found two changes within the nanosecond 0, expected changes at least 1 ns apart"
    );
    assert_eq!(vcd(&text("100 fs")).unwrap_err().to_string(), vcd(&text("10 ps")).unwrap_err().to_string());
}

#[test]
fn takes_the_nine_levels_of_vhdl() {
    let head = "$timescale 1 ns $end\n$var reg 1 ! a $end\n$var reg 1 \" b $end\n$var reg 1 # err $end\n\
                $var reg 4 $ state[3:0] $end\n$enddefinitions $end\n";
    let others = "#0\nU#\nbUUUU $\nL!\n0\"\n#5\nW#\n-#\nb01-Z $\nH!\n#9\n1\"\n";
    assert_eq!(read(TraceFormat::Vcd, format!("{head}{others}")).unwrap().len(), 3);
    let undefined = format!("{head}#0\nU!\nU\"\n#5\n0!\n0\"\n");
    assert_eq!(read(TraceFormat::Vcd, &undefined).unwrap(), [point(5, 0, 0)]);
    let error = read(TraceFormat::Vcd, undefined + "#7\nU!\n").unwrap_err();
    assert_eq!((error.line, error.found.as_str()), (14, "U for signal a"));
}

#[test]
fn vcd_changes_under_one_time_are_one_change_wherever_it_stands() {
    let head = "$timescale 1 ns $end\n$var wire 1 ! a $end\n$var wire 1 \" b $end\n$enddefinitions $end\n";
    let text = format!("{head}#5 0! 0\"\n#9 1!\n#9 1\"\n#12 0!\n");
    assert_eq!(vcd(&text).unwrap(), [point(5, 0, 0), point(9, 1, 1), point(12, 0, 1)]);
}

#[test]
fn a_vcd_definition_has_seventeen_words_at_most() {
    for (words, whole) in [(17, true), (18, false)] {
        let more = vec!["w"; words - 4].join(" ");
        let text = format!(
            "$timescale 1 ns $end\n$var wire 1 ! a {more} $end\n$var wire 1 \" b $end\n$enddefinitions $end\n#0 0! 0\"\n"
        );
        assert_eq!(vcd(&text).is_ok(), whole, "{words} words");
    }
}

/// A wrong row far from the buffer's end is found on the fast path too.
#[test]
fn a_row_far_from_the_end_is_judged_as_the_last_one_is() {
    let rest: Vec<_> = (0..10).map(|n| format!("{},{},0\n", 1000 + n, (n + 1) % 2)).collect();
    let rest = rest.concat();
    for (row, message) in [
        ("10,0,1\n", "t:4:1: found '10', expected a time after the row before, 10 ns"),
        ("9,0,1\n", "t:4:1: found '9', expected a time after the row before, 10 ns"),
        ("11,0,0\n", "t:4:4: found the state 0,0 again, expected a change of a or b: one row per change"),
    ] {
        for behind in ["", rest.as_str()] {
            let text = format!("t_ns,a,b\n0,1,0\n10,0,0\n{row}{behind}");
            assert_eq!(csv(&text).unwrap_err().to_string(), message, "{row}");
        }
    }
}

#[test]
fn vcd_errors_say_where_and_what() {
    let head = "$timescale 1 ns $end\n$var wire 1 ! a $end\n$var wire 1 \" b $end\n$enddefinitions $end\n";
    let table: &[(String, &str)] = &[
        (String::new(), "t:1:1: found the end of the file, expected $enddefinitions"),
        (
            "t_ns,a,b\n".into(),
            "t:1:1: found a quadrature trace: it has columns t_ns, a, b, expected a VCD definition: $timescale, $scope, $var, $upscope, $enddefinitions",
        ),
        (
            head.replace("1 ns", "2 ns"),
            "t:1:17: found '2ns', expected 1, 10 or 100 of s, ms, us, ns, ps or fs",
        ),
        (
            head.replace("$timescale 1 ns $end", ""),
            "t:4:17: found no $timescale, expected for example $timescale 1 ns $end",
        ),
        (
            head.replace(" b ", " c "),
            "t:4:17: found no variable named b, expected two variables of one bit named a and b, or --columns a=NAME,b=NAME with two of c",
        ),
        (
            head.replace("\" b", "! b"),
            "t:4:17: found a and b as one variable, '!', expected two variables: a and b of one scale never change together",
        ),
        (head.replace("1 \" b", "2 \" b"), "t:3:17: found b of 2 bits, expected one bit"),
        (
            head.replace("$enddef", "$var wire 1 # a $end\n$enddef"),
            "t:4:17: found a second variable named a, a beside a, expected one a, or --columns a=NUMBER: its place among the variables of one bit",
        ),
        (head.to_owned(), "t: found a trace without a point, expected at least the initial state of a and b"),
        (
            format!("{head}#0 0!\n#5 0\"\n"),
            "t:6:1: found no value of b at #0, expected a value of a and b at the first change of either",
        ),
        (
            format!("{head}#0 0! 0\"\n#9 x!\n"),
            "t:6:4: found x for signal a, expected the level 0 or 1: unknown and open lines cannot be counted",
        ),
        (
            format!("{head}$dumpvars x! x\" $end\n#5 0!\n"),
            "t: found a trace without a point, expected at least the initial state of a and b",
        ),
        (format!("{head}#9 0! 0\"\n#8 1!\n"), "t:6:1: found #8, expected a time not before #9"),
        (
            format!("{head}#0 0! 0\"\n#-1 1!\n"),
            "t:6:1: found '#-1', expected a time in whole units, as #1000",
        ),
        (format!("{head}#0 0! 0\"\nq\n"), "t:6:1: found 'q', expected a time (#1000) or a value change (1!)"),
    ];
    for (text, message) in table {
        assert_eq!(vcd(text).unwrap_err().to_string(), *message, "{text}");
    }
}

#[test]
fn a_reader_ends_after_its_error() {
    let mut reader =
        TraceReader::new(TraceFormat::Csv, Path::new("t"), b"t_ns,a,b\n0,0,0\n0,1,0\n9,0,1\n".as_slice())
            .unwrap();
    assert_eq!(reader.next(), Some(Ok(point(0, 0, 0))));
    assert!(reader.next().unwrap().is_err());
    assert_eq!(reader.next(), None);
}

#[test]
fn requests_and_their_errors() {
    let read = |text: &str| {
        RequestedTotalReader::new(Path::new("r"), text.as_bytes())?.collect::<Result<Vec<_>, _>>()
    };
    assert_eq!(
        read("t_ns,requested\n0,2\n5,-40 # back\n5,-42\n").unwrap(),
        [(0, 2), (5, -40), (5, -42)].map(|(t_ns, requested)| RequestedTotal { t_ns, requested })
    );
    assert_eq!(read("t_ns,requested\n").unwrap(), []);
    let table = [
        (
            "t_ns,counts\n",
            "r:1:1: found 't_ns,counts', expected the header t_ns,requested, or --request-columns with the columns' names or numbers",
        ),
        ("t_ns,requested\n5,2\n4,4\n", "r:3:1: found '4', expected a time not before the last one, 5 ns"),
        ("t_ns,requested\n5,inf\n", "r:2:3: found 'inf', expected a whole number of counts"),
        (
            "t_ns,requested\n5\n",
            "r:2:2: found the end of the row after 1 of 2 fields, expected the field requested",
        ),
    ];
    for (text, message) in table {
        assert_eq!(read(text).unwrap_err().to_string(), message);
    }
}

#[test]
fn a_file_appears_whole_or_not_at_all() {
    let directory = tempfile::tempdir().unwrap();
    let names = || {
        let mut names: Vec<_> =
            std::fs::read_dir(directory.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let file = directory.path().join("out.csv");
    let mut out = AtomicTraceFile::create(&file).unwrap();
    out.write(point(0, 0, 0)).unwrap();
    assert!(!file.exists());
    drop(out);
    assert!(names().is_empty(), "an abandoned file stays: {:?}", names());

    let mut out = AtomicTraceFile::create(&file).unwrap();
    for point in golden() {
        out.write(point).unwrap();
    }
    out.finish().unwrap();
    assert_eq!(std::fs::read_to_string(&file).unwrap(), GOLDEN_CSV);
    assert_eq!(names(), ["out.csv"]);
    assert_eq!(TraceReader::open(&file).unwrap().collect::<Result<Vec<_>, _>>().unwrap(), golden());

    let nowhere = directory.path().join("none/out.csv");
    assert!(AtomicTraceFile::create(&nowhere).unwrap_err().to_string().contains("No such file or directory"));
    let odd = AtomicTraceFile::create(Path::new("out.txt")).unwrap_err().to_string();
    assert_eq!(odd, "out.txt: found extension .txt, expected a trace ending in .csv or .vcd");
}

prop_compose! {
    /// Any trace: times anywhere in 64 bits, and some illegal transitions.
    fn any_trace()(
        first in prop_oneof![0..1000_u64, any::<u64>().prop_map(|t| t / 2)],
        bits in 0..4_u8,
        steps in prop::collection::vec((prop_oneof![1..100_u64, 1..1_000_000_000_000_u64], 1..4_u8), 0..400),
    ) -> Vec<TracePoint> {
        let mut at = TracePoint { t_ns: first, state: State::from_bits(bits) };
        let mut points = vec![at];
        for (later, mask) in steps {
            at = TracePoint { t_ns: at.t_ns + later, state: at.state.inverted(mask) };
            points.push(at);
        }
        points
    }
}

proptest! {
    #[test]
    fn what_is_written_reads_back(points in any_trace(), is_csv: bool) {
        let format = if is_csv { TraceFormat::Csv } else { TraceFormat::Vcd };
        let text = write(format, &points);
        prop_assert_eq!(&read(format, &text).unwrap(), &points);
        let dripped: Result<Vec<_>, _> = TraceReader::new(format, Path::new("t"), Drip(&text)).unwrap().collect();
        prop_assert_eq!(&dripped.unwrap(), &points);
    }

    /// After a change of any one byte, the fast and the careful path agree.
    /// Neither panics.
    #[test]
    fn a_damaged_file_reads_the_same_on_both_paths(points in any_trace(), is_csv: bool, at: prop::sample::Index, byte: u8) {
        let format = if is_csv { TraceFormat::Csv } else { TraceFormat::Vcd };
        let mut text = write(format, &points);
        let at = at.index(text.len());
        text[at] = byte;
        let whole = TraceReader::new(format, Path::new("t"), text.as_slice()).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let drip = TraceReader::new(format, Path::new("t"), Drip(&text)).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        prop_assert_eq!(whole, drip);
    }
}
