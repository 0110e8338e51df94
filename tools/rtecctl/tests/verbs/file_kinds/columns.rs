//! Columns by name and number, separators at rows' ends, and interrupted verbs.

use super::{column, run, words};
use std::process::Command;

/// Separators at the end of every row are ignored.
/// At the end of only some rows they are reported.
#[test]
fn separators_at_the_end_of_some_rows_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let says = "2 rows end with a separator behind the last column (line 3 first), 3 do not: is a cell missing there?";
    for (text, said) in [
        ("t,e\n1,2,\n2,3,\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e,\n1,2,\n2,3,\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e,\n1,2\n2,3\n3,4\n4,5\n5,6\n", false),
        ("t,e,note\n1,2,\n2,3,late\n3,4,\n4,5,\n5,6,\n", false),
        ("t,e\n1,2\n2,3,\n3,4\n4,5,,\n5,6\n", true),
        ("t;e\n1;2\n2;3;\n3;4\n4;5;\n5;6\n", true),
    ] {
        std::fs::write(at.join("in.csv"), text).unwrap();
        let line = "characterise import in.csv --format csv --columns t=time,e=error.x --out o.run.toml";
        let imported = run(at, &words(line));
        assert_eq!((imported.exit, column(at, "o.csv", "e")), (0, vec![2.0, 3.0, 4.0, 5.0, 6.0]), "{text}");
        assert_eq!(imported.says(says), said, "{text}: {}", imported.err);
    }
    // A further value is not a separator.
    std::fs::write(at.join("in.csv"), "t,e\n1,2,\n2,3,late\n").unwrap();
    let line = "characterise import in.csv --format csv --columns t=time,e=error.x --out o.run.toml";
    let refused = run(at, &words(line));
    assert!(refused.exit == 2 && refused.says("in.csv:3:5: found 'late'"), "{}", refused.err);
}

/// A verb that a signal ends while it writes leaves no file, not even a hidden one.
#[test]
fn an_interrupted_verb_leaves_no_file() {
    use std::io::Write as _;
    use std::os::unix::process::ExitStatusExt;
    for line in [
        "trace convert in.csv out.csv",
        "trace convert in.csv out.vcd",
        "trace from-position in.csv --count-um 1 --out out.csv",
        "replay --trace in.csv --requests totals.csv --out out.csv --vcd out.vcd",
    ] {
        for (name, signal) in [("INT", 2), ("TERM", 15)] {
            let folder = tempfile::tempdir().unwrap();
            let at = folder.path();
            std::fs::write(at.join("totals.csv"), "t_ns,requested\n0,0\n").unwrap();
            std::fs::write(at.join("out.csv"), "kept\n").unwrap();
            let made = Command::new("mkfifo").arg(at.join("in.csv")).status().unwrap();
            assert!(made.success());
            // A shell starts what runs in the background with Ctrl-C ignored.
            let mut verb = Command::new("env")
                .args(["--default-signal=INT,TERM", env!("CARGO_BIN_EXE_rtecctl")])
                .current_dir(at)
                .args(line.split(' '))
                .stdout(std::process::Stdio::null())
                .stderr(std::process::Stdio::null())
                .spawn()
                .unwrap();
            let mut rows = std::fs::OpenOptions::new().write(true).open(at.join("in.csv")).unwrap();
            let is_record = line.contains("from-position");
            rows.write_all(if is_record { b"t_s,position_mm\n" } else { b"t_ns,a,b\n" }).unwrap();
            // More than the pipe and the reader's buffer hold, so that rows have been written once it is
            // read. The pipe stays open.
            let many: String = (0..100_000_u32)
                .map(|i| match i % 4 {
                    _ if is_record => format!("{i}.0,0.0{}\n", i % 2),
                    0 => format!("{},0,0\n", 1000 * i),
                    1 => format!("{},1,0\n", 1000 * i),
                    2 => format!("{},1,1\n", 1000 * i),
                    _ => format!("{},0,1\n", 1000 * i),
                })
                .collect();
            rows.write_all(many.as_bytes()).unwrap();
            let sent =
                Command::new("kill").args([&format!("-{name}"), &verb.id().to_string()]).status().unwrap();
            assert!(sent.success());
            let ended = verb.wait().unwrap();
            assert_eq!(ended.signal(), Some(signal), "{line}");
            drop(rows);
            let mut left: Vec<_> = std::fs::read_dir(at)
                .unwrap()
                .map(|e| e.unwrap().file_name().into_string().unwrap())
                .collect();
            left.sort();
            assert_eq!(left, ["in.csv", "out.csv", "totals.csv"], "{line} after SIG{name}");
            assert_eq!(std::fs::read_to_string(at.join("out.csv")).unwrap(), "kept\n", "{line}");
        }
    }
}

/// Traces and requests may have other programs' column names.
/// The result is that of the contract's names.
#[test]
fn traces_and_requests_take_columns_by_name_and_number() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let put = |name: &str, text: &str| std::fs::write(at.join(name), text).unwrap();
    put("trace.csv", "t_ns,a,b\n0,0,0\n10000,1,0\n1200000,1,1\n2300000,0,1\n");
    put("totals.csv", "t_ns,requested\n0,0\n1500000,2\n");
    let good = run(at, &words("replay --trace trace.csv --requests totals.csv --json")).out;
    assert!(good.contains("\"counts_in\":3"), "{good}");
    for (trace, text, columns) in [
        (
            "named.csv",
            "Zeit;Kanal A;Kanal B\n0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n",
            "t_ns=Zeit,a=Kanal A,b=Kanal B",
        ),
        ("other.csv", "b;t;a\n0;0;0\n0;10000;1\n1;1200000;1\n1;2300000;0\n", "t_ns=2,a=3,b=1"),
        ("rows.csv", "0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n", "t_ns=1,a=2,b=3"),
        ("sep.csv", "sep=;\n0;0;0\n10000;1;0\n1200000;1;1\n2300000;0;1\n", "t_ns=1,a=2,b=3"),
        // The other cells of the column show the meaning of a single mark.
        ("thousands.csv", "t;a;b\n0;0;0\n10.000;1;0\n1.200.000;1;1\n2.300.000;0;1\n", "t_ns=t,a=a,b=b"),
        (
            "quoted.csv",
            "t,a,b\n0,0,0\n\"10,000\",1,0\n\"1,200,000\",1,1\n\"2,300,000\",0,1\n",
            "t_ns=t,a=a,b=b",
        ),
        // A logic analyser in seconds; its third channel changes on its own.
        (
            "saleae.csv",
            "Time [s],Channel 0,Channel 1,Channel 2\n0.000000000,0,0,0\n0.000004000,0,0,1\n0.000010000,1,0,1\n\
             0.0012000000,1,1,1\n2.3e-3,0,1,0\n",
            "t_s=Time [s],a=Channel 0,b=Channel 1",
        ),
        ("german.csv", "t;a;b\n0,000000;0;0\n0,010000;1;0\n1,2;1;1\n2,3;0;1\n", "t_ms=t,a=a,b=b"),
        ("us.csv", "0|0|0\n10|1|0\n1200|1|1\n2300|0|1\n", "t_us=1,a=2,b=3"),
        (
            "d.vcd",
            "$timescale 1 us $end\n$var wire 1 ! D0 $end\n$var wire 4 # bus $end\n$var wire 1 % D1 $end\n\
             $enddefinitions $end\n#0 0! 0%\n#10 1!\n#1200 1%\n#2300 0!\n",
            "a=D0,b=2",
        ),
    ] {
        put(trace, text);
        let played = run(
            at,
            &["replay", "--trace", trace, "--columns", columns, "--requests", "totals.csv", "--json"],
        );
        assert_eq!((played.exit, &played.out), (0, &good), "{trace}: {}", played.err);
        let converted = run(at, &["trace", "convert", trace, "c.csv", "--columns", columns]);
        assert_eq!(converted.exit, 0, "{trace}: {}", converted.err);
        let text = |name: &str| std::fs::read_to_string(at.join(name)).unwrap();
        assert_eq!(text("c.csv"), text("trace.csv"), "{trace}");
    }
    for (totals, text, columns) in [
        ("r1.csv", "wann;Soll\n0;0\n1500000;2\n", "t_ns=wann,requested=Soll"),
        ("r2.csv", "0;0\n2;1500000\n", "t_ns=2,requested=1"),
        ("r3.csv", "when\ttotal\n0\t0\n0,0015\t2\n", "t_s=1,requested=2"),
        ("r4.csv", "note;t;n\nstart;0;0\nup;1.500.000;2\n", "t_ns=t,requested=n"),
    ] {
        put(totals, text);
        let played = run(
            at,
            &["replay", "--trace", "trace.csv", "--requests", totals, "--request-columns", columns, "--json"],
        );
        assert_eq!((played.exit, &played.out), (0, &good), "{totals}: {}", played.err);
    }
    for (columns, says) in [
        ("t_ns=Zeit,a=Kanal A", "--columns: found no b"),
        ("a=Kanal A,b=Kanal B", "--columns: found no time, expected one of t_ns, t_us, t_ms, t_s"),
        ("t_ns=Zeit,t_s=Zeit,a=Kanal A,b=Kanal B", "--columns: found two times"),
        ("t_ns=Zeit,a=Kanal A,b=Kanal A", "found one column for two names"),
        (
            "t_ns=Zeit,a=Kanal A,b=Kanal C",
            "found no column Kanal C, expected a column Kanal C among Zeit, Kanal A, Kanal B",
        ),
        ("t_ns=Zeit,a=Kanal A,z=Kanal B", "one of t_ns, t_us, t_ms, t_s, a, b in front of ="),
    ] {
        let refused =
            run(at, &["replay", "--trace", "named.csv", "--columns", columns, "--requests", "totals.csv"]);
        assert!(refused.exit == 2 && refused.says(says), "{columns}: {}", refused.err);
    }
    let refused = run(at, &words("replay --trace named.csv --requests totals.csv"));
    assert!(
        refused.exit == 2 && refused.says("or --columns with the columns' names or numbers"),
        "{}",
        refused.err
    );
    let refused = run(at, &words("replay --trace d.vcd --requests totals.csv"));
    assert!(
        refused.exit == 2 && refused.says("or --columns a=NAME,b=NAME with two of D0, D1"),
        "{}",
        refused.err
    );
    // A total is a whole number.
    put("half.csv", "t_ns,requested\n0,0\n1500000,1.4\n");
    let refused = run(at, &words("replay --trace trace.csv --requests half.csv"));
    assert!(refused.exit == 2 && refused.says("half.csv:3:9: found '1.4'"), "{}", refused.err);
    // A single mark has two meanings, and no other cell decides.
    put("lone.csv", "t;a;b\n0;0;0\n10.000;1;0\n");
    let refused = run(at, &words("replay --trace lone.csv --columns t_ns=t,a=a,b=b --requests totals.csv"));
    assert!(refused.exit == 2 && refused.says("lone.csv:3:1: found '10.000'"), "{}", refused.err);
}
