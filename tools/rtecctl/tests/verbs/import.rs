//! `characterise import` as typed: real files and files of other programs.

use std::path::Path;
use std::process::{Command, Output};

fn rtecctl(dir: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words).output().unwrap()
}

fn import(dir: &Path, words: &str) -> String {
    let words: Vec<&str> = ["characterise", "import"].into_iter().chain(words.split(' ')).collect();
    let out = rtecctl(dir, &words);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(out.status.success(), "{words:?}: {said}");
    said
}

fn rows(file: &Path) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = std::fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let names = lines.next().unwrap().split(',').map(str::to_owned).collect();
    (names, lines.map(|l| l.split(',').map(|w| w.parse().unwrap()).collect()).collect())
}

/// One command imports the log of a real axis.
/// Volts become newtons and metres millimetres; velocity and acceleration are derived.
#[test]
fn a_real_axis_comes_in_with_force_velocity_and_acceleration() {
    if !test_needs::long() {
        return;
    }
    let Some(path) = test_needs::shared("data/axis_dynamics/identification.csv") else { return };
    let dir = tempfile::tempdir().unwrap();
    let said = import(
        dir.path(),
        &format!(
            "{} --format csv --kind dynamics --derive --out emps.run.toml \
             --columns t_s=time,position_m=position.x:m,motor_voltage_V=force.x:V*35.1507=N",
            path.display()
        ),
    );
    assert!(said.contains("velocity.x derived from position: local cubic, zero phase"), "{said}");
    let (names, data) = rows(&dir.path().join("emps.csv"));
    assert_eq!(names, ["t_s", "position_m", "motor_voltage_V", "velocity_x", "acceleration_x"]);
    assert_eq!(data.len(), 24_841);
    assert!((data[0][2] - 35.1507 * 2.53863).abs() < 1e-9);
    let sidecar = std::fs::read_to_string(dir.path().join("emps.run.toml")).unwrap();
    assert!(sidecar.contains("zero phase") && sidecar.contains("role = \"acceleration.x\""), "{sidecar}");
    // Velocity and acceleration sum up to the positions, by the trapezium rule.
    for (from, of) in [(1, 3), (3, 4)] {
        let (mut sum, mut worst) = (0.0, 0.0f64);
        for pair in data.windows(2) {
            sum += (pair[1][0] - pair[0][0]) * f64::midpoint(pair[0][of], pair[1][of]);
            worst = worst.max((pair[1][from] - data[0][from] - sum).abs());
        }
        println!("column {of} summed up is at most {worst:.4} off column {from}");
        assert!(worst < [0.0, 0.05, 0.0, 1.0][from], "{worst}");
    }
}

/// A file of LinuxCNC's own halsampler: a sawtooth of known slope.
#[test]
fn what_halsampler_writes_comes_in() {
    if !test_needs::installed("halsampler", "linuxcnc-uspace") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/linuxcnc/sample");
    let out = Command::new(script).arg(dir.path()).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    for (file, flag) in [("samples", ""), ("numbered", " --numbered")] {
        import(
            dir.path(),
            &format!(
                "{file} --format halsampler --period-s 0.001 --columns 1=position.x,2=channel,3=error.x --kind dynamics \
                 --out s.run.toml{flag}"
            ),
        );
        let (names, data) = rows(&dir.path().join("s.csv"));
        assert_eq!(names, ["t", "1", "2", "3"]);
        assert!(data.len() >= 299, "{}", data.len());
        let mut slopes = 0;
        for pair in data.windows(2) {
            let (dt, dp) = (pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
            // 5 mm in a fifth of a second, then back.
            if dp > 0.0 {
                slopes += 1;
                assert!((dp / dt - 25.0).abs() < 0.01, "{file}: {dp} mm in {dt} s");
            }
        }
        assert!(slopes > 290, "{file}: {slopes}");
    }
}

#[test]
fn what_cannot_be_read_is_named_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("g.csv", "t,e\n0,0,1,5\n");
    write("x.comp", "# old\n0 0 0\n10 10 10\n");
    write("s", "1 2 \noverrun\n");
    write("f.toml", "kind = \"drift\"\nseparator = \",\"\n[columns]\nt = { role = \"tim\" }\n");
    for (words, says) in [
        ("g.csv --format csv --columns t=time,e=error.x", "decimal commas between commas?"),
        ("g.csv --format csv --columns t=time,e=error.x:V*0=um", "a factor that is no zero"),
        ("g.csv --format csv", "--columns"),
        (
            "x.comp --format linuxcnc-comp0 --axis x",
            "x.comp:1:1: found `# old`, expected three numbers: LinuxCNC stops",
        ),
        ("x.comp --format linuxcnc-comp0", "no --axis"),
        ("s --format halsampler --period-s 0.001 --columns 1=error.x", "s:2:1: found `overrun`"),
        ("s --format halsampler --columns 1=error.x", "--period-s"),
        ("s --format halsampler --period-s -1 --columns 1=error.x", "seconds a sample"),
        ("g.csv --format own --form f.toml", "f.toml:4:14: found role `tim`"),
        ("g.csv --format own", "--form"),
        ("/dev/zero --format rtl --axis x", "a regular file"),
        ("x.comp --format rtl --axis x", "as a compensation table of LinuxCNC"),
    ] {
        let words: Vec<&str> = ["characterise", "import"].into_iter().chain(words.split(' ')).collect();
        let out = rtecctl(dir.path(), &[&words[..], &["--out", "o.run.toml"]].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{words:?}: {said}");
        assert!(said.contains(says), "{words:?}: {said}");
        assert!(!dir.path().join("o.run.toml").exists() && !dir.path().join("o.csv").exists());
    }
}

/// A compensation file does not state its unit, so the unit taken is reported.
#[test]
fn the_unit_of_a_compensation_file_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let lines: Vec<String> = (0..12).map(|k| format!("{k} {k}.0001 {k}.0002\n")).collect();
    std::fs::write(dir.path().join("x.comp"), lines.concat()).unwrap();
    let words = "x.comp --format linuxcnc-comp0 --axis x --out x.run.toml";
    assert!(import(dir.path(), words).contains("were read in mm: --unit"));
    assert!(
        import(dir.path(), &format!("{words} --unit inch"))
            .contains("were read in inches, written in mm and µm")
    );
    let (_, data) = rows(&dir.path().join("x.csv"));
    assert!(data.iter().any(|r| r.iter().any(|v| (v - 11.0 * 25.4).abs() < 1e-6)), "{data:?}");
}
