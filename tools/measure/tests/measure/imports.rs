//! Other programs' files as run records.
//! Each structure written down here by hand, with what it means.

#![allow(clippy::unwrap_used, clippy::float_cmp)] // a test's own helpers; directions are 1 or -1

use rtec_files::InputError;
use rtec_measure::compensation_export::linuxcnc::LinuxcncLinearUnit;
use rtec_measure::import::{self, ImportColumn, Sampling, TableSyntax, UserTableFormat};
use rtec_model::record::{Axis, Record, Role, RunKind};
use std::path::Path;

const TO: &str = "g.run.toml";

fn axis() -> Axis {
    Axis::new("x").unwrap()
}

fn data(record: &Record, role: &str) -> Vec<f64> {
    record.data(&Role::parse(role).unwrap()).unwrap().iter().map(|v| (v * 1e6).round() / 1e6).collect()
}

fn columns(columns: &[&str]) -> Vec<ImportColumn> {
    columns.iter().map(|c| ImportColumn::parse(c).unwrap()).collect()
}

#[track_caller]
fn refused(result: Result<Record, InputError>, line: usize, says: &str) {
    let e = result.unwrap_err();
    assert!(e.line == line && e.to_string().contains(says), "{e}");
}

#[test]
fn a_csv_comes_in_with_its_own_names_units_and_commas() {
    let text = "\u{feff}Zeit;T1;\"Luft\";Weg\r\n0;20,0;68,0;0,0000\r\n1;20,5;69,8;-0,0010\r\n";
    let text = text.trim_start_matches('\u{feff}');
    let wanted = |columns: &[&str]| {
        columns.iter().map(|c| import::ImportColumn::parse(c).unwrap()).collect::<Vec<_>>()
    };
    let read = |text: &str, columns: &[&str]| {
        let (file, to) = (Path::new("g.csv"), Path::new("g.run.toml"));
        import::table(file, text, &wanted(columns), &TableSyntax::default(), RunKind::Drift, to)
    };
    let all = ["Zeit=time:min", "T1=temperature", "Luft=temperature:degF", "Weg=error.z:mm"];
    let record = read(text, &all).unwrap();
    assert_eq!(record.time_s(), [0.0, 60.0]);
    assert_eq!(record.temperature("T1").unwrap(), [20.0, 20.5]);
    assert!(record.temperature("Luft").unwrap().iter().zip([20.0, 21.0]).all(|(a, b)| (a - b).abs() < 1e-12));
    assert_eq!(record.data(&Role::parse("error.z").unwrap()).unwrap(), [0.0, -1.0]);
    let plain = "t\tx\te\n0\t1\t2\n1\t1\t3\n";
    assert_eq!(read(plain, &["t=time", "x=position.x:in", "e=error.x"]).unwrap().rows(), 2);
    for (text, line, column, found) in [
        ("", 0, 0, "no header"),
        ("t,e\n", 2, 0, "no rows"),
        ("t,f\n0,1\n", 1, 1, "no column e"),
        ("t,e,e\n0,1,1\n", 1, 5, "column 'e' a second time"),
        ("t,e\n0,1\n1\n", 3, 2, "after 1 of 2 fields"),
        ("t,e\n0,1\n1, ,\n", 3, 4, "nothing in column e"),
        ("t,e\n0,1\n1, x\n", 3, 4, "'x' in column e"),
        ("t,e\n0,1\n1,\n", 3, 3, "nothing in column e"),
        ("t,e\n0,inf\n", 2, 3, "'inf'"),
    ] {
        let e = read(text, &["t=time", "e=error.x"]).unwrap_err();
        assert_eq!((e.line, e.column), (line, column), "{text:?}: {e}");
        assert!(e.found.contains(found), "{text:?}: {e}");
    }
    let e = read("t;e\n1,5;2.100\n2,5;2.500\n", &["t=time", "e=error.x"]).unwrap_err();
    let says = e.found.contains("'2.100' in column e") && e.expected.contains("part thousands");
    assert!(e.line == 2 && says, "{e}");
    assert!(read("t,e\n1,1\n0,1\n", &["t=time", "e=error.x"]).is_err(), "time runs backwards");
    for (text, expected) in [
        ("t", "NAME=ROLE"),
        ("t=zeit", "a role"),
        ("v=force.x:V*x=N", "a factor"),
        ("v=force.x:V*0=N", "a factor"),
        ("v=force.x:V*2", "the unit that the factor leads to"),
        ("v=force.x:V*2=mm", "a unit of force.x: N, kN, lbf"),
        ("t=time:day", "s, ns, 100ns, us, ms, min, h"),
        ("t=cycle:s", "a unit of cycle: 1"),
    ] {
        let (_, wants) = import::ImportColumn::parse(text).unwrap_err();
        assert!(wants.contains(expected), "{text}: {wants}");
    }
}

#[test]
fn factors_names_and_times_as_they_are_written() {
    let table = |text: &str, wanted: &[&str], form: &TableSyntax| {
        import::table(Path::new("g.csv"), text, &columns(wanted), form, RunKind::Dynamics, Path::new(TO))
    };
    let text = "t,a=b,F\n2022-08-08T13:51:37.2515150Z,2,1\n2022-08-08T13:51:37.5Z,4,2\n2022-08-09 15:51:37.5+02:00,5,3\n";
    let wanted = ["t=time", "a=b=position.x:inch", "F=force.x:V*35.1507=N"];
    let record = table(text, &wanted, &TableSyntax::default()).unwrap();
    assert_eq!(data(&record, "time"), [0.0, 0.248_485, 86_400.248_485]);
    assert_eq!(data(&record, "position.x"), [50.8, 101.6, 127.0]);
    assert_eq!(data(&record, "force.x"), [35.1507, 70.3014, 105.4521]);
    assert_eq!(record.date.as_deref(), Some("2022-08-08"));
    assert!(record.note.unwrap().contains("time 0 is 2022-08-08T13:51:37.2515150Z"));
    // Times of the day go on past midnight.
    let record = table(
        "t,F\n23:59:50,1\n00:00:05,2\n0:00:06.5,3\n",
        &["t=time", "F=force.x"],
        &TableSyntax::default(),
    );
    let record = record.unwrap();
    assert_eq!(data(&record, "time"), [0.0, 15.0, 16.5]);
    assert_eq!((record.date, record.note.as_deref()), (None, Some("time 0 is 23:59:50")));
    // A factor, then the unit's own.
    let record = table("t,F\n0,1\n", &["t=time", "F=force.x:V*2=kN"], &TableSyntax::default()).unwrap();
    assert_eq!(data(&record, "force.x"), [2000.0]);
    // A channel keeps whatever unit it has.
    let record = table("p,F\n1,1\n", &["p=channel:V*2.5=bar", "F=force.x"], &TableSyntax::default()).unwrap();
    assert_eq!((record.columns[0].unit.as_str(), record.columns[0].data[0]), ("bar", 2.5));
    for (text, line, says) in [
        ("t,F\n2022-08-08T13:51:37Z,1\n12,1\n", 3, "a time as in the rows before"),
        ("t,F\n2022-08-08T13:51:37Z,1\n2022-08-08T13:51:36Z,1\n", 3, "time that never decreases"),
        ("t,F\n2022-13-08T13:51:37Z,1\n", 2, "a time as ISO 8601 writes it"),
        ("t\tF\n0\t1,5x\n", 2, "'1,5x' in column F, expected a finite number"),
        ("t,F\n0,0,1,5\n", 2, "4 fields in 2 columns: decimal commas between commas?"),
        ("t;F\n0;12.34,5\n", 2, "'12.34,5' in column F"),
        ("t,F\n1767700000123,1\n", 2, "as t=time:ms"),
        ("t,F\n8/7/2022 13:51:37,1\n8/8/2022 13:51:37,2\n", 3, "no day above 12 tells which"),
        ("t,F\n8/7/22 13:51:37,1\n", 2, "has a year of four digits"),
        ("t,F\n23:59:50,1\n23:60:00,1\n", 3, "a time as in the rows before"),
        ("t,F\n12:00:10,1\n12:00:00,1\n", 3, "time that never decreases"),
    ] {
        refused(table(text, &["t=time", "F=force.x"], &TableSyntax::default()), line, says);
    }
    let comma = TableSyntax { decimal_comma: Some(true), ..TableSyntax::default() };
    let record = table("t\tF\n0\t1,5\n1\t2\n", &["t=time", "F=force.x"], &comma).unwrap();
    assert_eq!(data(&record, "force.x"), [1.5, 2.0]);
    refused(
        table("t\tF\n0\t1.5\n", &["t=time", "F=force.x"], &comma),
        2,
        "a decimal comma, as the numbers beside it",
    );
    for text in [
        "sep=;\nt;F\n0;1,5\n1;1.000,25\n",
        "t\tF\n0\t1,5\n1\t1.000,25\n",
        "t,F\n0,1.5\n1,\"1,000.25\"\n",
        "t;F\n1767700000;1.5\n1767700001;1000.25\n",
        "t;F\n23.1.2021 10:23:57;1,5\n23.1.2021 10:23:58;1000,25\n",
    ] {
        let record = table(text, &["t=time", "F=force.x"], &TableSyntax::default()).unwrap();
        assert_eq!(
            (data(&record, "time"), data(&record, "force.x")),
            (vec![0.0, 1.0], vec![1.5, 1000.25]),
            "{text}"
        );
    }
    let record = table(
        "t,F\n1767700000123,1\n1767700000623,2\n",
        &["t=time:ms", "F=force.x"],
        &TableSyntax::default(),
    );
    let record = record.unwrap();
    assert_eq!((data(&record, "time"), record.date.as_deref()), (vec![0.0, 0.5], Some("2026-01-06")));
    // A log has no response, and is asked for as one.
    refused(table("t,T\n0,20\n", &["t=time", "T=temperature"], &TableSyntax::default()), 0, "no response");
    let log = TableSyntax { log: true, ..TableSyntax::default() };
    let record = table("t,T\n0,20\n", &["t=time", "T=temperature"], &log).unwrap();
    assert_eq!((record.columns.len(), record.temperature("T").unwrap()), (2, &[20.0][..]));
}

/// What LinuxCNC reads, and what it would silently leave out.
#[test]
fn linuxcnc_files_of_both_types_mean_the_same_errors() {
    let read = |text: &str, trims: bool, unit: LinuxcncLinearUnit| {
        import::linuxcnc_comp(Path::new("x.comp"), text, &axis(), trims, unit, Path::new(TO))
    };
    // At 10 mm it reached 10.004 going up and 9.998 coming down.
    let positions = read("0 0 0\n10 10.004 9.998\n\n", false, LinuxcncLinearUnit::Mm).unwrap();
    let trims = read("0 0 0\n10 -0.004 0.002 ; trim\n", true, LinuxcncLinearUnit::Mm).unwrap();
    assert_eq!(data(&positions, "error.x"), [0.0, 4.0, -2.0, 0.0]);
    assert_eq!(data(&trims, "error.x")[1..3], [4.0, -2.0]);
    // One type read as the other makes errors as large as the travel.
    for (text, trims) in [("0 0 0\n10 10.004 9.998\n", true), ("0 0 0\n10 -0.004 0.002\n", false)] {
        let e = read(text, trims, LinuxcncLinearUnit::Mm).unwrap_err();
        assert!(e.expected.contains("choose the other type"), "{e}");
    }
    let inches = read("0 0 0\n1 1.0001 0.9999\n", false, LinuxcncLinearUnit::Inch).unwrap();
    assert_eq!(data(&inches, "error.x"), [0.0, 2.54, -2.54, 0.0]);
    assert_eq!(data(&inches, "position.x"), [0.0, 25.4, 25.4, 0.0]);
    refused(
        read("# x\n0 0 0\n10 10 10\n", false, LinuxcncLinearUnit::Mm),
        1,
        "LinuxCNC stops at this line without a word and has no point at all",
    );
    refused(
        read("0 0 0\n5 5 5\n\n10 10 10\n", false, LinuxcncLinearUnit::Mm),
        3,
        "has only the 2 points before it",
    );
    refused(read("0 0 0\n1 2\n3 3 3\n", false, LinuxcncLinearUnit::Mm), 2, "`1 2`");
    refused(read("0 0 0\n1 2\n", false, LinuxcncLinearUnit::Mm), 2, "two points at least");
    refused(read("0 0 0\n0 1 1\n", false, LinuxcncLinearUnit::Mm), 2, "positions that rise");
    let many: String = (0..257).map(|i| [format!("{i} {i} {i}"), String::new()].join("\n")).collect();
    refused(read(&many, false, LinuxcncLinearUnit::Mm), 257, "at most 256 points");
}

/// Made here after the structure that seven programs read alike.
/// No file of the maker's was at hand.
const RTL: &str = "HEADER::\r\nFile type: Linear\r\nOwner: Renishaw\r\nVersion no: 5\r\n\r\nTARGET DATA::\r\nFiletype: 1\r\n\
    Target-count: 6\r\nTargets : \r\n -100.0  -60.0  -20.0  20.0  60.0 \r\n 100.0 \r\nFlags: 0 0 2 0\r\n\r\nUSER-TEXT::\r\n\
    Machine: M\u{fc}ller 3\r\nSerial No: 17\r\nDate: 08/11/2022\r\nBy: me\r\nAxis: X\r\nLocation: \r\nTITLE: cold\r\n\r\n\
    RUNS::\r\nRun-count: 4\r\n\r\nDEVIATIONS::\r\nRun Target Data:\r\n\
    1 1 0.1\r\n1 2 0.2\r\n1 3 0.3\r\n1 4 0.4\r\n1 5 0.5\r\n1 6 0.6\r\n2 6 -0.6\r\n2 5 -0.5\r\n2 4 -0.4\r\n2 3 -0.3\r\n2 2 -0.2\r\n2 1 -0.1\r\n\
    3 1 1.1\r\n3 2 1.2\r\n3 3 1.3\r\n3 4 1.4\r\n3 5 1.5\r\n3 6 1.6\r\n4 6 -1.6\r\n4 5 -1.5\r\n4 4 -1.4\r\n4 3 -1.3\r\n4 2 -1.2\r\n4 1 -1.1\r\n\
    \r\nENVIRONMENT::\r\nAir temp: 20.1\r\nEOF::\r\n";

#[test]
fn an_rtl_goes_by_the_targets_number_and_keeps_the_order() {
    let read = |text: &str| import::rtl(Path::new("x.rtl"), text, &axis(), Path::new(TO));
    let latin1: Vec<u8> = RTL.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    let text = import::any_text(Path::new("x.rtl"), &latin1).unwrap();
    assert_eq!(text, RTL, "a name in Latin-1 is no obstacle");
    assert_eq!(import::any_text(Path::new("x.rtl"), format!("\u{feff}{RTL}").as_bytes()).unwrap(), RTL);
    assert_eq!(import::any_text(Path::new("x.rtl"), b"\xff\xfeH\0").unwrap(), "H");
    // What the file says of itself holds: its axis, its day, its kind in any spelling.
    assert_eq!(read(&text.replace("08/11/2022", "2022-11-08")).unwrap().date.as_deref(), Some("2022-11-08"));
    refused(read(&text.replace("Axis: X", "Axis:Y")), 19, "`Axis: Y` with --axis x");
    refused(read(&text.replace("File type: Linear", "File-type: RTA")), 2, "angular targets");
    let record = read(&text).unwrap();
    let (p, d, e) = (data(&record, "position.x"), data(&record, "direction.x"), data(&record, "error.x"));
    assert_eq!(record.rows(), 24);
    assert_eq!(p[..7], [-100.0, -60.0, -20.0, 20.0, 60.0, 100.0, 100.0]);
    assert!(
        d[..6].iter().chain(&d[12..18]).all(|d| *d == 1.0)
            && d[6..12].iter().chain(&d[18..]).all(|d| *d == -1.0)
    );
    assert_eq!((e[0], e[5], e[6], e[11], e[23]), (0.1, 0.6, -0.6, -0.1, -1.1));
    assert_eq!(data(&record, "cycle")[..13], [1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 1., 2.]);
    assert!(
        record.note.as_ref().unwrap().contains("Machine: M\u{fc}ller 3; Serial No: 17; Date: 08/11/2022"),
        "{:?}",
        record.note
    );
    // ISO 230-2 on it, by hand: up the means are 0.1·target + 0.5, down their negatives.
    let eval = rtec_measure::iso230::positioning(&record).unwrap().remove(0).B.unwrap();
    let largest = (1..=6).map(|t| 2.0 * (f64::from(t) * 0.1 + 0.5)).fold(0.0, f64::max);
    assert!((eval - largest).abs() < 1e-9, "{eval}");
    // Targets listed downwards: the first run falls.
    let mut numbers = ["-100.0", "-60.0", "-20.0", "20.0", "60.0", "100.0"];
    numbers.reverse();
    let falling = RTL.replace("-100.0  -60.0  -20.0  20.0  60.0 \r\n 100.0", &numbers.join("  "));
    assert_eq!(data(&read(&falling).unwrap(), "direction.x")[..7], [-1., -1., -1., -1., -1., -1., 1.]);
    // One direction only: writers fill the other with zeros.
    let mut one = RTL.to_owned();
    for k in 1..=6 {
        for (run, v) in [(2, format!("-0.{k}")), (4, format!("-1.{k}"))] {
            one = one.replace(&format!("{run} {k} {v}"), &format!("{run} {k} 0"));
        }
    }
    let record = read(&one).unwrap();
    assert!(record.rows() == 12 && data(&record, "direction.x").iter().all(|d| *d == 1.0));
    assert!(record.note.unwrap().contains("run 2 is all zeros and was left out"));
    for (from, to, line, says) in [
        ("DEVIATIONS::", "DEVIATION::", 0, "no section DEVIATIONS::"),
        ("Target-count: 6", "Target-count: 7", 0, "6 targets, Target-count 7"),
        ("Target-count: 6", "Targets-count: 6", 0, "no `Target-count:`"),
        ("Run-count: 4", "Run-count: 5", 0, "0 deviations in run 5"),
        ("Run-count: 4", "Run-count: 3", 46, "run 4, target 6"),
        ("3 2 1.2", "3 3 1.2", 42, "target 3 of run 3 a second time"),
        ("3 2 1.2", "3 7 1.2", 41, "target 7"),
        ("3 2 1.2", "3 2 1,2", 41, "with a decimal point"),
        ("3 2 1.2", "3 2", 41, "`3 2`"),
        ("1 1 0.1\r\n1 2 0.2", "1 2 0.2\r\n1 1 0.1", 29, "run 1 turns back at target 1"),
        ("File type: Linear", "File type: Angular", 2, "linear targets"),
        (" -60.0", " -60,0", 10, "a target in mm"),
    ] {
        refused(read(&RTL.replace(from, to)), line, says);
    }
}

#[test]
fn halsampler_has_its_times_from_the_period() {
    let read = |text: &str, wanted: &[&str], numbered: bool| {
        let sampling = Sampling { period_s: 0.001, numbered };
        import::halsampler(
            Path::new("s"),
            text,
            &columns(wanted),
            &sampling,
            &TableSyntax::default(),
            RunKind::Dynamics,
            Path::new(TO),
        )
    };
    let plain = "1.000000 0 -0.500000 \n1.500000 1 -0.250000 \n";
    let record = read(plain, &["1=position.x", "3=error.x:mm", "2=coolant"], false).unwrap();
    assert_eq!(data(&record, "time"), [0.0, 0.001]);
    assert_eq!(data(&record, "error.x"), [-500.0, -250.0]);
    assert_eq!(data(&record, "coolant"), [0.0, 1.0]);
    let numbered = "17 1.0 0 2.0 \n18 1.5 1 3.0 \noverrun\n25 2.0 1 4.0 \n";
    let record = read(numbered, &["1=position.x", "3=error.x"], true).unwrap();
    assert_eq!(data(&record, "time"), [0.0, 0.001, 0.008]);
    assert_eq!(data(&record, "position.x"), [1.0, 1.5, 2.0]);
    assert!(record.note.unwrap().contains("samples lost at line 3"));
    // The samples' numbers taken for the first quantity: the axis would run at a millimetre a sample.
    let forgotten = (0..40).fold(String::new(), |text, n| text + &format!("{} {}.5 0.1 \n", 17 + n, n));
    refused(read(&forgotten, &["1=position.x", "2=error.x"], false), 1, "say --numbered");
    assert!(read(&forgotten, &["2=position.x", "3=error.x"], false).is_ok());
    refused(read("1 2 \noverrun\n1 2 \n", &["1=position.x", "2=error.x"], false), 2, "samples are lost here");
    refused(read("5 1 2 \n5 1 2 \n", &["1=position.x", "2=error.x"], true), 0, "numbers that rise");
    refused(read("1 2 \n", &["1=position.x", "4=error.x"], false), 1, "2 fields, expected a field 4");
    refused(read("1 x \n", &["1=position.x", "2=error.x"], false), 1, "'x' in column 2");
    refused(read("1 2 \n", &["p=position.x", "2=error.x"], false), 0, "a column's number, from 1");
    refused(read("", &["1=position.x", "2=error.x"], false), 0, "no rows");
    refused(read("1 2 \n", &["1=time", "2=error.x"], false), 0, "none: the samples' period");
    let zero = Sampling { period_s: 0.0, numbered: false };
    let form = TableSyntax::default();
    refused(
        import::halsampler(
            Path::new("s"),
            plain,
            &columns(&["1=error.x"]),
            &zero,
            &form,
            RunKind::Dynamics,
            Path::new(TO),
        ),
        0,
        "seconds a sample, above 0",
    );
}

#[test]
fn etalons_blocks_are_errors_over_an_axis() {
    let read = |text: &str| import::etalon(Path::new("x.txt"), text, &axis(), Path::new(TO));
    let text = "// head\n[C0B]\nVALUE = 0.000022355737\n[EXX]\nGridpoints = {\n-10.0 -0.001 // mm\n0.0 0.0\n10.0 0.0025\n}\n\
                [EYX]\nGridpoints = {\n -10.0 0.1\n 0.0 0.2\n 10.0 0.3\n} // end of EYX\n[EAX]\nGridpoints = {\n0 0.00001\n}\n";
    let record = read(text).unwrap();
    assert_eq!(data(&record, "position.x"), [-10.0, 0.0, 10.0]);
    assert_eq!(data(&record, "error.x"), [-1.0, 0.0, 2.5]);
    assert_eq!(data(&record, "error.y"), [100.0, 200.0, 300.0]);
    assert!(record.note.unwrap().contains("left out: C0B, EAX"));
    for (from, to, line, says) in [
        ("[EXX]", "[EXZ]", 0, ""),
        ("-10.0 -0.001", "-10.0", 6, "position and value"),
        ("-10.0 -0.001", "10.0 -0.001", 4, "positions that do not rise"),
        (" -10.0 0.1", " -11.0 0.1", 10, "other positions"),
        ("0.0 0.0\n", "0.0 nan\n", 7, "a number"),
        ("}\n[EYX]", "[EYX]", 9, "before the } of line 5"),
        ("[EAX]", "[EXX]", 16, "a second time"),
        ("VALUE =", "VALUE", 3, "VALUE"),
        ("// head", "head", 1, "a block as [EXX] first"),
        ("0.00001\n}", "0.00001", 17, "Gridpoints without an end"),
    ] {
        let result = read(&text.replace(from, to));
        if says.is_empty() {
            assert!(result.unwrap().data(&Role::parse("error.x").unwrap()).is_none());
        } else {
            refused(result, line, says);
        }
    }
    refused(read("[C0B]\nVALUE = 1\n"), 0, "gridpoints of EXX, EYX or EZX");
    // Keys and comments of other programs are passed over.
    let others = text.replace("[EXX]\n", "[EXX]\n; made by another program\nUnit = mm\n");
    assert_eq!(data(&read(&others).unwrap(), "error.x"), [-1.0, 0.0, 2.5]);
}

#[test]
fn shdr_values_hold_until_the_next_is_told() {
    let read = |text: &str| {
        let wanted = columns(&["Xpos=position.x", "e=error.x:mm", "Xtemp=temperature"]);
        import::shdr(Path::new("l"), text, &wanted, RunKind::Drift, false, Path::new(TO))
    };
    let text = "* PING\n2022-08-08T13:51:37.2515150Z|Xpos|1|e|0.001\n2022-08-08T13:51:37.5Z|Xload|55\n\
                2022-08-08T13:51:37.5Z|Xtemp|20\n2022-08-08T13:51:38.5Z|Xpos|2\n2022-08-08T13:51:38.5Z|e|0.002\n\
                2022-08-08T13:51:39Z|sys|FAULT|1|2|text\n2022-08-08T13:51:40Z|Xtemp|UNAVAILABLE\n2022-08-08T13:51:41Z|Xpos|3\n\
                2022-08-08T13:51:42.5Z@12.5|Xtemp|21\n";
    let record = read(text).unwrap();
    assert_eq!(data(&record, "time"), [0.0, 1.0, 5.0]);
    assert_eq!(data(&record, "position.x"), [1.0, 2.0, 3.0]);
    assert_eq!(data(&record, "error.x"), [1.0, 2.0, 2.0]);
    assert_eq!(record.temperature("Xtemp").unwrap(), [20.0, 20.0, 21.0]);
    assert_eq!(record.date.as_deref(), Some("2022-08-08"));
    // Documents between the lines, older than they; conditions; texts that are empty: as an Okuma's log has them.
    let asset = "2022-08-08T10:33:04.97Z|@ASSET@|123456.2201|CuttingTool|--multiline--ABCD\n<CuttingTool toolId=\"1\">\n--multiline--ABCD\n\
                 2022-08-08T13:51:34.7167146Z|system|NORMAL||||\n2022-08-08T13:51:34.7167146Z|p1block||Xpos||e|UNAVAILABLE\n";
    assert_eq!(data(&read(&format!("{asset}{text}")).unwrap(), "position.x"), [1.0, 2.0, 3.0]);
    refused(read(&asset.replace("\n--multi", "\n--multy")), 1, "the same mark at the end");
    // Relative times, as a simulator replays them.
    let record = read("1|Xpos|1|e|0|Xtemp|20\n2.5|Xpos|2\n").unwrap();
    assert_eq!((data(&record, "time"), record.date), (vec![0.0, 1.5], None));
    refused(read("yesterday|Xpos|1\n"), 1, "a time as");
    refused(read("1|Xpos|one\n"), 1, "`one` of Xpos");
    refused(read("1|Xpos|1\n"), 0, "no `e`");
    refused(read("1|Xpos|1|e|1|Xtemp|UNAVAILABLE\n"), 0, "no time at which all");
    refused(read("2|Xpos|1|e|0|Xtemp|20\n1|Xpos|2\n"), 2, "times that never decrease");
}

#[test]
fn a_table_is_read_as_a_file_of_ones_own_describes_it() {
    let form = "kind = \"drift\"\nseparator = \";\"\ndecimal = \",\"\nskip_lines = 2\ncomment = \"//\"\n[columns]\n\
                t = { column = \"Zeit\", role = \"time\", unit = \"min\" }\nT1 = { role = \"temperature\", unit = \"degF\" }\n\
                e = { column = \"U / V\", role = \"error.z\", factor = 12.5, add = -3.0, unit = \"um\" }\n";
    let table = "Messung 3\n; ; ;\nZeit;T1;U / V;x\n0;68,0;0,24;\n1;69,8;1,0;a // so\n";
    let read = |form: &str, table: &str| {
        UserTableFormat::parse(Path::new("f.toml"), form)
            .and_then(|f| f.read(Path::new("m.txt"), table, Path::new(TO)))
    };
    let record = read(form, table).unwrap();
    assert_eq!(data(&record, "time"), [0.0, 60.0]);
    assert_eq!(data(&record, "error.z"), [0.0, 9.5]);
    assert!(record.temperature("T1").unwrap().iter().zip([20.0, 21.0]).all(|(a, b)| (a - b).abs() < 1e-9));
    refused(read(form, &table.replace("0,24", "0.24")), 4, "a decimal comma, as the numbers beside it");
    // Without names, parted by blanks.
    let bare = "kind = \"dynamics\"\nseparator = \"blank\"\nnames = false\n[columns]\nf = { column = 2, role = \"force.x\" }\n";
    let record = read(bare, "  1.0   2.5  # c\n 2.0\t3.5\n").unwrap();
    assert_eq!(data(&record, "force.x"), [2.5, 3.5]);
    let e = read(bare, "  1.0   2.5\n 2.0   x\n").unwrap_err();
    assert_eq!((e.line, e.column), (2, 8), "{e}");
    for (from, to, line, says) in [
        ("kind = \"drift\"", "kind = \"run\"", 1, "kind `run`"),
        ("separator = \";\"", "separator = \"|\"", 2, "separator"),
        ("separator = \";\"\n", "", 1, "no separator"),
        ("separator = \";\"", "separator = \",\"", 3, "where no commas part the columns"),
        ("skip_lines = 2", "skip_lines = -2", 4, "a number of lines"),
        ("skip_lines", "skiplines", 4, "unknown key skiplines"),
        ("comment = \"//\"", "comment = \"\"", 5, "what comments begin with"),
        ("\"time\"", "\"clock\"", 7, "role `clock`"),
        ("\"min\"", "\"day\"", 7, "a unit of time"),
        ("column = \"Zeit\"", "column = 1", 7, "the column's name"),
        ("factor = 12.5", "factor = 0.0", 9, "a factor that is no zero"),
    ] {
        refused(read(&form.replace(from, to), table), line, says);
    }
}

/// Numbers that a file only claims: they take neither memory nor time.
#[test]
fn counts_that_no_file_holds_are_refused_at_once() {
    let rtl = RTL.replace("Run-count: 4", "Run-count: 18446744073709551615");
    let read = import::rtl(Path::new("x.rtl"), &rtl, &axis(), Path::new(TO));
    refused(read, 0, "Run-count 18446744073709551615");
    let ecmc = |text: &str| import::ecmc_dat(Path::new("x.dat"), text, &axis(), Path::new(TO));
    refused(ecmc("REF_DATA_FWD[1,18446744073709551615]=1\n"), 0, "cycle 18446744073709551615 of 1 readings");
    let whole = "TGT_DATA[1]=1\nREF_DATA_FWD[1,1]=1.001\nREF_DATA_BWD[1,1]=0.999\n";
    assert_eq!(ecmc(whole).unwrap().rows(), 2);
}

/// A zone of four bytes that are not four letters.
#[test]
fn a_time_in_strange_letters_is_no_time() {
    let text = "2022-08-08T13:51:37+1\u{e9}1|e|1\n";
    let read =
        import::shdr(Path::new("l"), text, &columns(&["e=error.x"]), RunKind::Drift, false, Path::new(TO));
    refused(read, 1, "a time as");
}
