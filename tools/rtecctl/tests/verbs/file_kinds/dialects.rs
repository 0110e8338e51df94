//! Tables of many programs, and files of another kind.

use super::{column, inputs, run, words};

#[test]
fn files_of_another_kind_are_refused_by_what_they_say() {
    let folder = inputs();
    let at = folder.path();
    std::fs::write(at.join("book.xlsx"), b"PK\x03\x04\x14\0\x06\0\x08\0\0\0!\0b\xee\x9dh\n").unwrap();
    std::fs::write(at.join("page.html"), "<!DOCTYPE html>\n<html></html>\n").unwrap();
    std::fs::write(at.join("degrees.cor"), "# deg um\n0.1 1.5\n0.2 1.0\n").unwrap();
    for (line, found) in [
        (
            "characterise import angular-table.rta --format rtl --axis x --out o.run.toml",
            "File type `rta` (angular",
        ),
        (
            "characterise import book.xlsx --format csv --columns t=time,e=error.x --out o.run.toml",
            "a spreadsheet's own",
        ),
        ("characterise import ghdl.vcd --format ecmc-dat --axis x --out o.run.toml", "a value change dump"),
        (
            "characterise import speck-1e-7.dxf --format linuxcnc-comp0 --axis x --out o.run.toml",
            "a DXF drawing",
        ),
        ("characterise import forty.csv --format etalon --axis x --out o.run.toml", "requested totals"),
        ("characterise import batch-point.csv --format rtl --axis x --out o.run.toml", "a batch of parts"),
        ("characterise import angular-table.rta --format cmm-plate --out o.run.toml", "data of a laser"),
        ("characterise evaluate inch-backlash.machine.toml", "a machine model"),
        ("part errors --points batch-point.csv --radius-mm 10", "a batch of parts"),
        ("part errors --points book.xlsx --radius-mm 10", "a spreadsheet's own"),
        ("part post-process --batch six-points.csv", "probed points"),
        ("part post-process --batch page.html", "XML or HTML"),
        ("part post-process --batch batch-point.csv --inspected degrees.cor", "'# deg um'"),
        ("part post-process --batch batch-point.csv --inspected ghdl.vcd", "a value change dump"),
        ("part features six-points.csv", "probed points"),
        ("part features ghdl.vcd", "a value change dump"),
        ("replay --trace forty.csv --requests forty.csv", "requested totals"),
        ("replay --trace b-broken.csv --requests b-broken.csv", "a quadrature trace"),
        ("model show --machine dial10.run.toml", "a run record"),
        ("model show --machine speck-1e-7.dxf", "a DXF drawing"),
        ("config check inch-backlash.machine.toml", "a machine model"),
    ] {
        let refused = run(at, &words(line));
        assert!(
            refused.exit == 2 && refused.err.contains(&format!("found {found}")),
            "{line}: {}",
            refused.err
        );
        assert!(!at.join("o.run.toml").exists() && !at.join("o.csv").exists(), "{line}");
    }
    // A chain and a card's profile, each in the other's place.
    let chain = "tool_mm = [0, 0, 0]\n[[joint]]\nname = \"spindle\"\n";
    std::fs::write(at.join("chain.toml"), chain).unwrap();
    std::fs::write(at.join("m.toml"), "name = \"m\"\nchain = \"profile.toml\"\n").unwrap();
    let profile =
        "name = \"c\"\ninputs = [{ register = 0, width = 8 }]\noutputs = []\n[lines]\na = { input = 0 }\n";
    std::fs::write(at.join("profile.toml"), profile).unwrap();
    let shown = run(at, &words("model show --machine m.toml"));
    assert!(shown.exit == 2 && shown.says("found a card's profile"), "{}", shown.err);
    let config = std::fs::read_to_string(at.join("absent-chip.rtec.toml")).unwrap();
    let config = config
        .replace("\"gpio\"", "\"mapped\"\nfile = \"/dev/null\"\nprofile = \"chain.toml\"")
        .replace("chip = \"gpiochip0\"\n", "");
    std::fs::write(at.join("c.rtec.toml"), config).unwrap();
    let checked = run(at, &words("config check --elsewhere c.rtec.toml"));
    assert!(checked.exit == 2 && checked.says("found a kinematic chain"), "{}", checked.err);
}

/// The same table as programs and spreadsheets of several countries write it.
fn dialects(table: &str) -> Vec<(&'static str, Vec<u8>)> {
    let german = |by: &str| table.replace(',', by).replace('.', ",");
    let rows = |text: &str, row: &dyn Fn(&str) -> String| text.lines().map(row).collect::<String>();
    let cells = |line: &str| {
        line.split(',').map(|cell| format!("\"{}\"", cell.replace('.', ","))).collect::<Vec<_>>()
    };
    let utf16 =
        |text: &str| -> Vec<u16> { format!("\u{feff}{text}").replace('\n', "\r\n").encode_utf16().collect() };
    vec![
        ("semicolons", german(";").into_bytes()),
        ("tabs", german("\t").into_bytes()),
        ("bars", table.replace(',', "|").into_bytes()),
        ("a line sep=", format!("sep=;\n{}", german(";")).into_bytes()),
        ("quotes", rows(table, &|line| cells(line).join(",") + "\n").into_bytes()),
        ("UTF-16, little end first", utf16(&german(";")).into_iter().flat_map(u16::to_le_bytes).collect()),
        ("UTF-16, big end first", utf16(table).into_iter().flat_map(u16::to_be_bytes).collect()),
        ("a byte-order mark", format!("\u{feff}{}", table.replace('\n', "\r\n")).into_bytes()),
        ("separators at the end", rows(&german(";"), &|line| format!("{line};;\n")).into_bytes()),
        ("blanks", table.replace(',', " , ").into_bytes()),
        ("comments", format!("# bench 3\n\n{table}\n# end\n").into_bytes()),
        (
            "comments of other programs",
            format!("; CSV, made by a scope\n% bench 3\n// of May\n{table}; end\n% end\n// end\n")
                .into_bytes(),
        ),
        ("lines in front", format!("Scope 3\nSerial,0815\n\nMade; by, x\n{table}").into_bytes()),
        (
            "a further column",
            rows(table, &|line| {
                let is_row = line.starts_with(|c: char| c.is_ascii_digit());
                format!(
                    "{line},{}\n",
                    if is_row { "seen, \"so\"".replace([',', '"'], "") } else { "remark".to_owned() }
                )
            })
            .into_bytes(),
        ),
    ]
}

#[test]
fn every_reader_takes_every_dialect() {
    if !test_needs::long() {
        return;
    }
    let record = "file = \"in.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\", unit = \"s\" }\ne = { role = \"error.z\", unit = \"um\" }\n";
    for (table, line) in [
        (
            "t,e\n0,1.5\n10,2.25\n20,3.125\n30,2.5\n",
            "characterise import in.csv --format csv --columns t=time,e=error.z --out o.run.toml",
        ),
        ("t,e\n0,1.5\n600,2.25\n1200,3.125\n1800,2.5\n", "characterise evaluate in.run.toml --json"),
        (
            "z_mm,x_mm\n110.0,0.0\n108.0,6.0\n106.0,8.0\n100.0,10.0\n94.0,8.0\n",
            "part errors --points in.csv --radius-mm 10 --tip-mm 0 --json",
        ),
        (
            "part,feature,error_um\n1,D1,11.5\n2,D1,12.25\n3,D1,11.75\n",
            "part post-process --batch in.csv --json",
        ),
        (
            "t_s,position_mm\n0.0,0.0\n0.001,0.0015\n0.002,0.0035\n",
            "trace from-position in.csv --count-um 1 --out o.csv --json",
        ),
        (
            "t_ns,a,b\n0,0,0\n10000,1,0\n20000,1,1\n30000,0,1\n",
            "replay --trace in.csv --requests totals.csv --json",
        ),
        ("t_ns,requested\n0,0\n15000,2\n", "replay --trace trace.csv --requests in.csv --json"),
    ] {
        let read = |bytes: &[u8]| {
            let folder = tempfile::tempdir().unwrap();
            let put = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
            put("in.csv", bytes);
            put("in.run.toml", record.as_bytes());
            put("totals.csv", b"t_ns,requested\n0,0\n15000,2\n");
            put("trace.csv", b"t_ns,a,b\n0,0,0\n10000,1,0\n20000,1,1\n30000,0,1\n");
            let done = run(folder.path(), &words(line));
            let written = std::fs::read_to_string(folder.path().join("o.csv")).unwrap_or_default();
            assert_eq!(done.exit, 0, "{line}: {}{}", String::from_utf8_lossy(bytes), done.err);
            (done.out, written)
        };
        let plain = read(table.as_bytes());
        for (dialect, bytes) in dialects(table) {
            assert_eq!(read(&bytes), plain, "{dialect}: {line}");
        }
    }
}

#[test]
fn one_csv_front_serves_every_verb() {
    let folder = inputs();
    let at = folder.path();
    for dialect in ["point", "comma", "sep-line", "thousands", "utf16"] {
        let line = format!("part post-process --batch batch-{dialect}.csv --json");
        let judged = run(at, &words(&line));
        assert!((judged.figure("/places/0/mean_um") - 11.55).abs() < 0.005, "{dialect}");
        assert_eq!(judged.says("read as"), dialect != "point", "{dialect}: {}", judged.err);
    }
    let import = |file: &str, columns: &str| {
        let line = format!("characterise import {file} --format csv --columns {columns} --out o.run.toml");
        run(at, &words(&line))
    };
    for (file, at_line) in [("cells-div0.csv", "3:3: found '#DIV/0!'"), ("cells-na.csv", "3:3: found '#N/A'")]
    {
        let refused = import(file, "t=time,e=error.x");
        assert!(refused.exit == 2 && refused.says(at_line), "{file}: {}", refused.err);
    }
    let hash = run(
        at,
        &[
            "characterise",
            "import",
            "cells-hash-header.csv",
            "--format",
            "csv",
            "--columns",
            "Sample #=cycle,t=time,e=error.x",
            "--out",
            "o.run.toml",
        ],
    );
    assert_eq!((hash.exit, column(at, "o.csv", "Sample #")), (0, vec![1.0, 2.0]), "{}", hash.err);
    let parted = import("cells-sep.csv", "t=time,e=error.x");
    assert_eq!((parted.exit, column(at, "o.csv", "e")), (0, vec![1.5, 2.5]), "{}", parted.err);
    assert!(parted.says("read as columns parted by semicolons, decimal commas"), "{}", parted.err);
    let german = import("cells-german-time.csv", "time=time,e=error.x");
    assert_eq!((german.exit, column(at, "o.csv", "time")), (0, vec![0.0, 1.0]), "{}", german.err);
    let own = run(
        at,
        &words("characterise import probe-results.txt --format own --form form-quoted.toml --out o.run.toml"),
    );
    assert_eq!((own.exit, column(at, "o.csv", "x")[0]), (0, -25.4), "{}", own.err);

    // The same points and positions, with and without names, by name and by number.
    let points = std::fs::read_to_string(at.join("six-points.csv")).unwrap();
    let german: String =
        points.lines().skip(1).map(|l| l.replace(',', ";").replace('.', ",") + "\n").collect();
    let utf16: Vec<u8> = "\u{feff}"
        .encode_utf16()
        .chain(format!("Laenge;Radius\r\n{german}").encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(at.join("named.csv"), utf16).unwrap();
    std::fs::write(at.join("nameless.csv"), &german).unwrap();
    for (file, columns) in [
        ("named.csv", "z_mm=Laenge,x_mm=Radius"),
        ("named.csv", "z_mm=1,x_mm=2"),
        ("nameless.csv", "z_mm=1,x_mm=2"),
    ] {
        let line = format!("part errors --points {file} --columns {columns} --radius-mm 27.3504 --json");
        let found = run(at, &words(&line));
        assert!((found.figure("/plain_radius_mm") - 27.350_44).abs() < 5e-6, "{file} {columns}");
    }
    let refused = run(at, &words("part errors --points nameless.csv --radius-mm 27.3504"));
    assert!(refused.exit == 2 && refused.says("the line that names them is missing"), "{}", refused.err);
    let nameless = run(
        at,
        &words(
            "characterise import nameless.csv --format csv --columns 1=position.x,2=error.x --kind probing --out n.run.toml",
        ),
    );
    assert_eq!((nameless.exit, column(at, "n.csv", "1")[0]), (0, 125.451_984), "{}", nameless.err);
    std::fs::write(at.join("p.csv"), "sep=;\nZeit_ms;Weg\n0;0,1\n1000;0,25\n2000;1,5\n").unwrap();
    std::fs::write(at.join("q.csv"), "0;0,1\n1000;0,25\n2000;1,5\n").unwrap();
    for line in [
        "trace from-position p.csv --count-um 1 --column Weg --unit mm --time-column Zeit_ms --out t.csv --json",
        "trace from-position q.csv --count-um 1 --column 2 --unit mm --time-column 1 --time-unit ms --out t.csv --json",
    ] {
        let traced = run(at, &words(line));
        assert!(
            traced.exit == 0 && traced.says("read as columns parted by semicolons, decimal commas"),
            "{}",
            traced.err
        );
        assert!(traced.out.contains("1399"), "{}", traced.out);
    }
    for (file, from) in [("b.csv", "b-broken.csv"), ("f.csv", "forty.csv")] {
        let text = std::fs::read_to_string(at.join(from)).unwrap();
        std::fs::write(at.join(file), text.replace(',', ";")).unwrap();
    }
    let played = run(at, &words("replay --trace b.csv --requests f.csv"));
    assert!(played.exit == 4 && played.says("b.csv: read as columns parted by semicolons"), "{}", played.err);
    let converted = run(at, &words("trace convert b.csv c.csv"));
    assert_eq!(converted.exit, 0, "{}", converted.err);
    let [plain, again] =
        ["b-broken.csv", "c.csv"].map(|f| std::fs::read_to_string(at.join(f)).unwrap().replace('\r', ""));
    assert_eq!(plain, again);
}
