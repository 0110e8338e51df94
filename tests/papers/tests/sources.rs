//! The sources beside the simulated machines.
//!
//! Tests of what agrees, what another machine changes, and what is refused.

#![allow(clippy::unwrap_used)]

use rtec_papers::{Compared, Paper, Row, Verdict};
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::error_correction_circuit::PllFrequencyLimits;
use std::path::Path;
use std::process::{Command, Output};

fn rtec_papers(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtec-papers")).args(arguments).output().unwrap()
}

/// Compares a source and checks that every row is complete.
fn compared(paper: &str, from: Option<&Path>, seed: u64) -> Compared {
    let described = MachineDescriptions::of(from.map(Path::to_owned));
    let compared = Paper::find(paper).unwrap().compare(&described, seed, &mut |_| ()).unwrap();
    for row in &compared.rows {
        assert!(![&row.place, &row.what, &row.says, &row.gets].contains(&&String::new()), "{row:?}");
        assert!(row.verdict == Verdict::Agrees || !row.why.is_empty(), "{row:?}");
    }
    assert_eq!(compared.counts.iter().map(|c| c.agree + c.differ).sum::<usize>(), compared.rows.len());
    compared
}

/// The page on sources quotes these counts.
fn check_quoted(paper: &Compared, source: &str) {
    let page = include_str!("../../../tools/guide/contributor/sources.md");
    let [compared, fitted, given] = paper.counts;
    let line = format!(
        "| {source} | {} | {} | {fitted} | {given} | {} |",
        compared.agree, compared.differ, paper.too_small
    );
    assert!(page.contains(&line), "sources.md does not have `{line}`");
}

fn row<'a>(paper: &'a Compared, place: &str, what: &str) -> &'a Row {
    let found = paper.rows.iter().find(|r| r.place.contains(place) && r.what.contains(what));
    found.unwrap_or_else(|| panic!("{place}: {what}"))
}

fn we(paper: &Compared, place: &str, what: &str) -> f64 {
    row(paper, place, what).we.unwrap()
}

fn agrees(paper: &Compared, place: &str, what: &str) {
    let row = row(paper, place, what);
    assert_eq!(row.verdict, Verdict::Agrees, "{row:?}");
}

/// Writes the machines' files into a folder and changes one of them.
fn changed(folder: &Path, file: &str, from: &str, to: &str) {
    let output = rtec_papers(&["--write", folder.to_str().unwrap()]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = std::fs::read_to_string(folder.join(file)).unwrap();
    assert!(text.contains(from), "{file}: {from}");
    std::fs::write(folder.join(file), text.replace(from, to)).unwrap();
}

#[test]
fn nistir_4832() {
    if !test_needs::long() {
        return;
    }
    let paper = compared("4832", None, 1);
    check_quoted(&paper, "NISTIR 4832");
    for (place, what) in [
        ("Figure 2", "adds"),
        ("Figure 2", "subtracts"),
        ("Altering", "bits for an axis"),
        ("Altering", "rapid traverse, 7 m/min"),
        ("Original", "total"),
        ("Original", "at 30 kHz A and B are low"),
        ("Original", "one correction every"),
        ("Original", "corrections over a quarter"),
        ("Original", "dithers by a whole cycle"),
        ("Original", "dither of one count"),
        ("Design B", "the same with corrections"),
        ("second table", "two counts added"),
        ("third table", "two counts subtracted"),
        ("General", "one signed byte"),
        ("General", "largest correction"),
        ("General", "belief window"),
        ("General", "fatal"),
    ] {
        agrees(&paper, place, what);
    }
    // The report's own figures, not the program's: 4 + 3 + 2 µs, 127 · 4 µm, 240 µm / 4 µm over a quarter.
    assert!((we(&paper, "Original", "total") - 9.0).abs() < 0.01);
    assert!((we(&paper, "General", "largest correction") - 127.0 * 4.0).abs() < 1e-9);
    // Another error, another byte, a slower computer: other figures.
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().to_str().unwrap();
    changed(folder.path(), "4832-machine.toml", "ppm = 240.0", "ppm = 480.0");
    let file = folder.path().join("4832.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    let text = text
        .replace("correction_bits = 8", "correction_bits = 7")
        .replace("after_ns = 2000", "after_ns = 5000");
    std::fs::write(&file, text).unwrap();
    let other = compared("4832", Some(folder.path()), 1);
    assert!((we(&other, "Original", "corrections over a quarter") - 30.0).abs() < 1e-9);
    assert!((we(&other, "General", "largest correction") - 63.0 * 4.0).abs() < 1e-9);
    assert!((we(&other, "Original", "total") - 12.0).abs() < 0.01);
    assert_eq!(row(&other, "Original", "corrections over a quarter").verdict, Verdict::Differs);
    std::fs::write(&file, "count_um = 1\nnonsense = 2\n").unwrap();
    let output = rtec_papers(&["4832", "--from", from]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("4832.toml:2"), "{output:?}");
}

#[test]
fn nistir_4854() {
    if !test_needs::long() {
        return;
    }
    let paper = compared("4854", None, 1);
    check_quoted(&paper, "NISTIR 4854");
    for (place, what) in [
        ("On-Machine", "constant velocity"),
        ("The RTEC", "25 µs late"),
        ("figure 5", "height of the bump"),
        ("figure 5", "largest error bar"),
        ("Compensating", "corrections for the largest error"),
        ("Figure 6", "longest error bar"),
        ("Figure 6", "SD of the circle fit"),
        ("Compensating", "G01 lines"),
        ("Figure 7", "start of point 1, Z"),
        ("Figure 7", "touch of point 1, X"),
        ("Requirements", "file of the first"),
        ("G-T", "error components"),
        ("G-T", "about every"),
        ("G-T", "longest error bar"),
    ] {
        agrees(&paper, place, what);
    }
    let folder = tempfile::tempdir().unwrap();
    changed(folder.path(), "4854.toml", "flat_um = 25.0", "flat_um = 12.0");
    let other = compared("4854", Some(folder.path()), 1);
    let bump = we(&other, "figure 5", "height of the bump");
    assert!((9.0..13.0).contains(&bump), "{bump}");
    assert_eq!(row(&other, "figure 5", "height of the bump").verdict, Verdict::Differs);
}

#[test]
fn tool_offset_corrects_size_and_table_corrects_form() {
    if !test_needs::long() {
        return;
    }
    let left = rtec_papers::nistir4854::size_and_form(&MachineDescriptions::default(), 1).unwrap();
    let [offset, table, _, sized] = left.map(|(_, um)| um.map(f64::abs));
    assert!(offset[0] < 2.0 && offset[1] > 18.0, "{left:?}");
    assert!(table[0] > 8.0 && table[1] < 4.0, "{left:?}");
    assert!(sized[0] < 2.5 && sized[1] < 4.0, "{left:?}");
    let page = include_str!("../../../tools/guide/metrologist/nistir4854.md");
    for (way, [size, form]) in left {
        let line = format!("| {way} | {:.1} µm | {form:.1} µm |", size.abs());
        assert!(page.contains(&line), "nistir4854.md does not have `{line}`");
    }
}

#[test]
fn cmti() {
    let paper = compared("cmti", None, 1);
    check_quoted(&paper, "CMTI");
    for (place, what) in [
        ("Table 1", "S1 = 0, S0 = 0"),
        ("Table 1", "S1 = 0, S0 = 1"),
        ("Table 1", "S1 = 1, S0 = 0"),
        ("Table 1", "S1 = 1, S0 = 1"),
        ("Section 2", "X/Z"),
        ("Section 2.3", "acknowledgement pulses"),
        ("Figures 8", "pulses added"),
        ("Figures 8", "pulses subtracted"),
        ("Section 2.2.2", "doubling is perfect"),
        ("Section 2.2.7", "largest compensation"),
    ] {
        agrees(&paper, place, what);
    }
    let folder = tempfile::tempdir().unwrap();
    changed(folder.path(), "cmti.toml", "clean_to_hz = 125000.0", "clean_to_hz = 60000.0");
    let trace = std::fs::read_to_string(folder.path().join("cmti.vcd")).unwrap();
    for signal in [" xz ", " s1 ", " s0 ", " ack "] {
        assert!(trace.contains(signal), "{signal}");
    }
    let other = compared("cmti", Some(folder.path()), 1);
    let to = other.rows.iter().find(|r| r.what == "to (XOR)").unwrap();
    assert!((to.we.unwrap() - 60.0).abs() < 0.2, "{to:?}");
}

#[test]
fn circuit_refuses_settings_beyond_its_limits() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to, line, expected) in [
        (
            "shown_pulses = 3 ",
            "shown_pulses = 16 ",
            5,
            "1 to 15 pulses: the compensation value has four bits",
        ),
        ("shown_pulses = 3 ", "shown_pulses = 0 ", 5, "1 to 15 pulses"),
        ("shown_encoder_hz = 10000.0", "shown_encoder_hz = 81000.0", 6, "350 to 80000 Hz"),
        ("shown_encoder_hz = 10000.0", "shown_encoder_hz = 300.0", 6, "350 to 80000 Hz"),
        ("lock_to_hz = 160000.0", "lock_to_hz = 120000.0", 12, "more than 125000 Hz"),
        ("pitch_mm = 5.0", "pitch_mm = 0.0", 3, "a number above 0"),
    ] {
        changed(folder.path(), "cmti.toml", from, to);
        let output = rtec_papers(&["cmti", "--from", folder.path().to_str().unwrap()]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{to}: {said}");
        assert!(said.contains(&format!("cmti.toml:{line}: ")) && said.contains(expected), "{to}: {said}");
        assert!(output.stdout.is_empty(), "{to}");
    }
    // At the limits themselves it runs, and adds no pulse too many.
    changed(folder.path(), "cmti.toml", "shown_pulses = 3 ", "shown_pulses = 15 ");
    let full = compared("cmti", Some(folder.path()), 1);
    assert!((we(&full, "Figures 8", "pulses added") - 15.0).abs() < 1e-9);
}

/// The circuit's ranges are those of the program, in the same words everywhere.
#[test]
fn circuit_has_one_range() {
    #[derive(serde::Deserialize)]
    struct Circuit {
        pll: PllFrequencyLimits,
    }
    let pll = PllFrequencyLimits::default();
    for text in [
        include_str!("../../../tools/guide/integrator/cmti.md"),
        include_str!("../../../tools/sim/machines/cmti/README.md"),
    ] {
        assert!(text.contains(&pll.to_string()), "no `{pll}`");
    }
    assert_eq!(MachineDescriptions::default().read::<Circuit>("cmti.toml").unwrap().pll, pll);
}

/// The loop doubles from 0.7 to 160 kHz and not beyond (section 2.2.2).
#[test]
fn circuit_adds_only_within_its_lock_range() {
    for seed in 1..=3 {
        let paper = compared("cmti", None, seed);
        let (from, to) =
            (we(&paper, "Section 2.2.2", "begins to double"), we(&paper, "Section 2.2.2", "goes on to"));
        assert!((0.69..0.71).contains(&from) && (159.0..160.1).contains(&to), "{seed}: {from} to {to} kHz");
    }
}

#[test]
fn draws_the_figures_of_each_source() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for (paper, files) in [
        ("nistir4832", &["figure-2-original.svg", "figure-2-ecc.svg", "linear-error-240um.svg"][..]),
        ("nistir4854", &["figure-5.svg", "figure-6.svg", "figure-7.svg"]),
        ("cmti", &["figure-8.svg", "figure-9.svg", "cmti.vcd"]),
    ] {
        let out = folder.path().join(paper);
        let output = rtec_papers(&[paper, "--out", out.to_str().unwrap()]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        for file in files {
            let text = std::fs::read_to_string(out.join(file)).unwrap();
            assert!(text.len() > 500, "{paper}: {file}");
        }
    }
    let output = rtec_papers(&["--out", folder.path().to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn wo_97() {
    if !test_needs::long() {
        return;
    }
    let paper = compared("wo97", None, 1);
    check_quoted(&paper, "WO 97/43703");
    for table in ["Table 1", "Table 2", "Table 3", "Table 4", "Table 5", "Table 6", "Table 7"] {
        assert!(row(&paper, table, "").place.starts_with(table));
    }
    for (place, what) in [
        ("Table 2", "X axis: largest scale"),
        ("Table 2", "Z axis: reversal"),
        ("Table 4", "5500 rpm, 3 h: drift in X"),
        ("Table 4", "5500 rpm, 3 h: drift in Z"),
        ("Table 4", "5500 rpm, 3 h: tilt in X"),
        ("Table 4", "5500 rpm, 3 h: tilt in Y"),
        ("Table 5", "5500 rpm, 3 h: drift in Y"),
        ("Table 5", "1 h cooling: drift in Y"),
        ("Table 6", "thermal, wet, Y"),
        ("Equation 2", "alike"),
        ("Equation 3", "alike"),
        ("Equation 4", "alike"),
        ("Figures 13 and 14", "gradient"),
        ("CASC", "13 and 10"),
        ("Text after table 7", "uncertainty from the characterisation in Z"),
        ("Figures 22 and 23", "test 3, cold: errors in Y"),
        ("Figures 22 and 23", "test 3, cold: errors in Z"),
    ] {
        agrees(&paper, place, what);
    }
    // Of tables 4 and 5, nine in ten of the figures above the tolerance agree.
    let drift: Vec<&Row> = paper.rows.iter().filter(|r| r.what.contains(": drift in")).collect();
    let good = drift.iter().filter(|r| r.verdict == Verdict::Agrees).count();
    let bad = drift.len() - good;
    assert!(good >= 12 && good >= 9 * bad, "{good}, {bad}");
    // Zero or the other sign never agrees.
    for r in paper.rows.iter().filter(|r| r.verdict == Verdict::Agrees) {
        let (Some(says), Some(gets)) = (r.paper, r.we) else { continue };
        let bound = r.says.starts_with(['≤', '≥']);
        assert!(bound || says == 0.0 || says * gets > 0.0, "{r:?}");
    }
}

#[test]
fn refuses_an_unknown_source_and_a_missing_folder() {
    for arguments in [&["4711"][..], &["4832", "--from", "/nonexistent"]] {
        let output = rtec_papers(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty());
    }
    let said = String::from_utf8(rtec_papers(&["cmt"]).stderr).unwrap();
    assert!(said.contains("4832, 4854, cmti, wo97 (nistir4832 and nistir4854 too)"), "{said}");
}

/// A file under a wrong name changes nothing, and nobody would know why.
#[test]
fn names_each_file_that_the_folder_does_not_have() {
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().to_str().unwrap();
    let lines = |output: Output| {
        let said = String::from_utf8(output.stderr).unwrap();
        said.lines().filter(|l| l.contains("built in")).map(str::to_owned).collect::<Vec<_>>()
    };
    let missing = format!("rtec-papers: no {from}/cmti.toml: the one built in was taken");
    assert_eq!(lines(rtec_papers(&["cmti", "--from", from])), [missing]);
    changed(folder.path(), "cmti.toml", "", "");
    assert_eq!(lines(rtec_papers(&["cmti", "--from", from])), [""; 0]);
    assert_eq!(lines(rtec_papers(&["cmti"])), [""; 0]);
}
