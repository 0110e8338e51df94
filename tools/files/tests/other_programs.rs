//! Traces and tables in the formats of other programs.
#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use rtec_driver::quadrature::State;
use rtec_driver::trace_replay::TracePoint;
use rtec_files::quadrature_trace::{TraceReader, trace_columns};
use rtec_files::{CsvTable, InputError};
use std::path::Path;

fn point(t_ns: u64, a: u8, b: u8) -> TracePoint {
    TracePoint { t_ns, state: State::new(a == 1, b == 1) }
}

#[test]
fn dates_and_levels_unknown_at_first_are_read_and_said() {
    let columns = trace_columns(&["t_s=when".to_owned(), "a=A".to_owned(), "b=B".to_owned()]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("t.csv");
    let points = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let mut reader = TraceReader::open_columns(&file, &columns)?;
        let points = reader.by_ref().collect::<Result<Vec<_>, _>>()?;
        Ok::<_, InputError>((points, reader.notes().unwrap_or_default()))
    };
    // date -u -d 2026-01-02T03:04:05 +%s
    let at = 1_767_323_045_000_000_000;
    for (when, first, since) in [
        (["2026-01-02T03:04:05Z", "2026-01-02T03:04:05.00001Z"], at, "1970-01-01 UTC"),
        (["2.1.2026 03:04:05", "2.1.2026 03:04:05.00001"], at, "1970-01-01 UTC"),
        (["03:04:05", "03:04:05.00001"], at % 86_400_000_000_000, "midnight"),
        (["1767323045", "1767323045.00001"], at, ""),
    ] {
        let (points, said) = points(&format!("when,A,B\n{},0,0\n{},1,0\n", when[0], when[1])).unwrap();
        assert_eq!(points, [point(first, 0, 0), point(first + 10_000, 1, 0)], "{when:?}");
        assert!(said.contains(since), "{said}");
    }
    for (when, says) in [
        ("1767323045000", "Unix time in ms, expected a time in its own unit: t_ms=COLUMN"),
        ("1/2/2026 03:04:05", "a day of"),
    ] {
        let error = points(&format!("when,A,B\n{when},0,0\n")).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let scopes = "$timescale 1 ns $end $scope module m $end $scope module x $end $var wire 1 ! a $end $var wire 1 \" b $end \
                  $upscope $end $scope module y $end $var wire 1 # a $end $upscope $end $upscope $end $enddefinitions $end\n\
                  $dumpvars x! z\" 0# $end\n#2 1!\n#4 0\"\n#6 1\"\n";
    let file = folder.path().join("t.vcd");
    std::fs::write(&file, scopes).unwrap();
    assert!(TraceReader::open(&file).unwrap_err().expected.contains("a=m.x.a or a=m.y.a selects it"));
    for name in ["x.a", "m.x.a", "1"] {
        let columns = trace_columns(&[format!("a={name}"), "b=b".to_owned()]).unwrap();
        let mut reader = TraceReader::open_columns(&file, &columns).unwrap();
        let points: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
        assert_eq!(points, [point(4, 1, 0), point(6, 1, 1)], "{name}");
        assert!(reader.notes().unwrap().contains("a and b is unknown before #4"), "{:?}", reader.notes());
    }
}

#[test]
fn a_sheet_passes_over_what_is_unrelated() {
    let known = ["z_mm", "x_mm", "point"];
    let read = |text: &str| CsvTable::parse(Path::new("p.csv"), text, &known, |_| false);
    for text in [
        "; made by x; of y\nz_mm,x_mm\n1,2\n; end\n",
        "% of 3, 4\n% 5\nz_mm;x_mm\n1;2\n",
        "// z_mm and x_mm\nz_mm,x_mm\n1,2\n",
        "Program,7\n\nz_mm,x_mm,remark\n1,2,so\n",
        "sep=;\nz_mm;x_mm\n;;\n1;2\n",
    ] {
        let sheet = read(text).unwrap();
        assert_eq!((sheet.len(), sheet.numbers("x_mm").unwrap()[0]), (1, 2.0), "{text}");
    }
    let said = read("Program,7\n\nz_mm,x_mm,remark\n1,2,so\n").unwrap().written().unwrap();
    assert!(said.contains("passed over 2 lines") && said.contains("left out the columns remark"), "{said}");
    // A first cell may be empty, or begin with the mark of a comment, `%`.
    let sheet =
        CsvTable::parse(Path::new("p.csv"), "name;n\n;1\n%RH;2\n", &["name", "n"], |_| false).unwrap();
    assert_eq!(sheet.numbers("n").unwrap(), [1.0, 2.0]);
    // A name nearly equal to a missing one is a mistake.
    let error = read("z_mm,x_mm,piont\n1,2,3\n").unwrap_err();
    assert!(error.expected.contains("did you mean point?"), "{error}");
    assert!(read("z_mm,x_mm,x_mm\n1,2,3\n").is_err());
    assert!(read("a,b\n1,2\n").is_err());
}
