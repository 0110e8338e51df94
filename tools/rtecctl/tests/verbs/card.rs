//! `rtecctl card`: list, show, probe and `--drive`.
//! They run on the shipped profiles and on files of registers.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

const HERE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/card");

fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
    command.arg("card").args(args).current_dir(HERE);
    command
}

fn card(args: &[&str]) -> Output {
    command(args).output().expect("the binary was built with this test")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

#[track_caller]
fn golden(name: &str, text: &str) {
    test_needs::golden(&Path::new(HERE).join(name), text);
}

/// A file of registers and a configuration that names it.
struct Bench {
    directory: tempfile::TempDir,
}

const LINES: &str = "lines = { a = 'a', b = 'b', invert_a = 'invert_a', invert_b = 'invert_b' }";

impl Bench {
    fn new(profile: &str, hold: &str, lines: &str, registers: &[u8]) -> Self {
        let bench = Self { directory: tempfile::tempdir().expect("a directory") };
        std::fs::write(bench.registers(), registers).expect("registers");
        let config = format!(
            "[machine]\nname = 'bench'\n[card]\nbackend = 'mapped'\nfile = 'registers'\nprofile = '{profile}'\n{hold}\n\
             [[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 100\nwindow_counts = 50\n\
             min_separation_ns = 500\nmax_accel_mm_s2 = 1000.0\n{lines}\n[control]\nsocket = 's'\n"
        );
        std::fs::write(bench.config(), config).expect("a configuration");
        bench
    }

    fn wired_back(registers: &[u8]) -> Self {
        let lines = LINES.replace(" }", ", read_back_a = 'back_a', read_back_b = 'back_b' }");
        Self::new(&format!("{HERE}/follows.toml"), "hold = 'hold'", &lines, registers)
    }

    fn config(&self) -> PathBuf {
        self.directory.path().join("rtec.toml")
    }

    fn registers(&self) -> PathBuf {
        self.directory.path().join("registers")
    }

    fn probe(&self, args: &[&str]) -> Output {
        let config = self.config();
        card(&[&["probe", "--config", config.to_str().expect("UTF-8")], args].concat())
    }

    fn bytes(&self) -> Vec<u8> {
        std::fs::read(self.registers()).expect("registers")
    }
}

#[test]
fn every_profile_is_listed_and_what_is_here_is_looked_for() {
    let out = card(&["list"]);
    assert!(out.status.success() && out.stderr.is_empty());
    let (profiles, here) = text(&out.stdout)
        .split_once("in this machine:\n")
        .map(|(p, h)| (p.to_owned(), h.to_owned()))
        .expect("both");
    golden("list.txt", &profiles);
    // If no card is found, the next step is shown; this computer may have one.
    assert_eq!(here.contains("nothing that this program knows"), here.contains("`rtecctl card show FILE`"));
    assert!(!here.is_empty());
    let out = card(&["list", "--json"]);
    let document = crate::document(&out.stdout);
    let listed: Vec<_> =
        document["profiles"].as_array().expect("a list").iter().map(|p| p["profile"].as_str()).collect();
    assert_eq!(listed, rtec_control::card_profile_file::SHIPPED.map(|(name, _)| Some(name)));
    for kind in ["gpio", "pci", "parport", "uio"] {
        assert!(document["here"][kind].is_array(), "{kind}");
    }
}

#[test]
fn a_profile_is_shown_with_registers_lines_and_its_source() {
    for profile in ["8255-pci", "counter-card", "wch-ch382l"] {
        golden(&format!("{profile}.txt"), &text(&card(&["show", profile]).stdout));
        golden(&format!("{profile}.json"), &text(&card(&["show", profile, "--json"]).stdout));
    }
    let shipped = text(&card(&["show", "shared-memory", "--toml"]).stdout);
    let directory = tempfile::tempdir().expect("a directory");
    let own = directory.path().join("own.toml");
    std::fs::write(&own, shipped).expect("a profile");
    let out = card(&["show", own.to_str().expect("UTF-8")]);
    assert!(out.status.success() && text(&out.stdout).starts_with("shared-memory test card\n"));
}

#[test]
fn a_profile_that_is_not_there_or_is_none_is_named() {
    let says = |args: &[&str]| {
        let out = card(args);
        assert!(out.stdout.is_empty());
        (out.status.code(), text(&out.stderr))
    };
    let (code, error) = says(&["show", "8255-pc"]);
    assert_eq!(code, Some(2));
    assert!(error.contains("found No such file") && error.contains("did you mean \"8255-pci\"?"), "{error}");
    let (code, error) = says(&["show", concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml")]);
    assert!(code == Some(2) && error.contains("Cargo.toml:1:2: found unknown key package"), "{error}");
    assert_eq!(says(&["show", "8255-pci", "--toml", "--json"]).0, Some(2));
    assert_eq!(says(&["probe", "--mtc-is-off"]).0, Some(2));
    let (code, error) = says(&["probe", "--config", "none.toml"]);
    assert!(code == Some(2) && error.contains("none.toml: found No such file"), "{error}");
    assert!(error.contains("expected a configuration: `rtecctl config default > rtec.toml`"), "{error}");
    let (code, error) = says(&["probe"]);
    let installed = Path::new(rtec_control::config::INSTALLED).exists();
    assert!(installed || code == Some(2), "{error}");
    assert!(installed || error.contains("expected --config FILE, or a configuration"), "{error}");
}

#[test]
fn a_probe_reads_and_writes_nothing() {
    let bench = Bench::wired_back(&[0b10, 0b1000_0011]);
    golden("probe.txt", &text(&bench.probe(&[]).stdout));
    golden("probe.json", &text(&bench.probe(&["--json"]).stdout));
    assert_eq!(bench.bytes(), [0b10, 0b1000_0011]);
}

#[test]
fn a_probe_of_a_card_with_counters_shows_counts_and_flags() {
    let mut registers = [0; 24];
    (registers[0], registers[12], registers[13], registers[20]) = (0b11, 0xd2, 0x04, 0b1001);
    let lines = "lines = { a = 'a0', b = 'b0', invert_a = 'invert_a0', invert_b = 'invert_b0' }";
    let bench = Bench::new("counter-card", "", lines, &registers);
    golden("probe-counters.txt", &text(&bench.probe(&[]).stdout));
    assert_eq!(bench.bytes(), registers);
}

#[test]
fn outputs_are_driven_only_when_the_mtc_is_said_to_be_off() {
    let bench = Bench::wired_back(&[0b10, 0b1000_0000]);
    let answered = |answer: &str| {
        let config = bench.config();
        let mut child = command(&["probe", "--drive", "--config", config.to_str().expect("UTF-8")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("rtecctl");
        let mut stdin = child.stdin.take().expect("its standard input");
        std::io::Write::write_all(&mut stdin, answer.as_bytes()).expect("an answer");
        drop(stdin);
        child.wait_with_output().expect("its end")
    };
    for wrong in ["", "yes\n", "MTC is off\n"] {
        let out = answered(wrong);
        let error = text(&out.stderr);
        assert!(out.status.code() == Some(1) && error.ends_with("nothing was written\n"), "{error}");
        assert!(
            error.contains("WARNING") && error.contains("axis MOVES") && out.stdout.is_empty(),
            "{error}"
        );
    }
    let out = answered("the MTC is off\n");
    assert!(out.status.success(), "{}", text(&out.stderr));
    golden("drive.txt", &text(&out.stdout));
    let out = bench.probe(&["--drive", "--mtc-is-off", "--json"]);
    assert!(out.status.success() && out.stderr.is_empty());
    golden("drive.json", &text(&out.stdout));
    assert_eq!(bench.bytes(), [0b10, 0b1000_0000], "as it was before");
}

#[test]
fn an_output_that_does_not_read_back_is_an_answer_of_no() {
    let bench = Bench::new(&format!("{HERE}/twice.toml"), "", LINES, &[0, 0]);
    let out = bench.probe(&["--drive", "--mtc-is-off"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(text(&out.stdout).contains("DOES NOT READ BACK"));
    assert!(text(&out.stderr).contains("2 outputs do not read back"));
}

#[test]
fn a_card_that_is_not_there_is_hardware_that_is_not_reached() {
    let bench = Bench::wired_back(&[0]);
    let out = bench.probe(&[]);
    assert_eq!(out.status.code(), Some(3));
    let error = text(&out.stderr);
    assert!(
        error.contains("found 1 bytes, expected at least 2") && error.contains("is this the right file"),
        "{error}"
    );
    std::fs::remove_file(bench.registers()).expect("the file");
    for args in [&[][..], &["--drive", "--mtc-is-off"]] {
        let out = bench.probe(args);
        assert_eq!(out.status.code(), Some(3), "{}", text(&out.stderr));
        assert!(text(&out.stderr).contains("registers: No such file"), "{}", text(&out.stderr));
    }
    let with = |card: &str, lines: &str| {
        let whole = std::fs::read_to_string(bench.config()).expect("a configuration");
        let (head, tail) =
            (whole.split("[card]").next().unwrap_or(""), whole.split("[[axis]]").nth(1).unwrap_or(""));
        let tail = tail
            .lines()
            .map(|l| if l.starts_with("lines") { lines } else { l })
            .collect::<Vec<_>>()
            .join("\n");
        let file = bench.directory.path().join("other.toml");
        std::fs::write(&file, format!("{head}[card]\n{card}\n[[axis]]{tail}\n")).expect("a configuration");
        let out = card_of(&file);
        (out.status.code(), text(&out.stderr))
    };
    let (code, error) =
        with("backend = 'gpio'\nchip = 'gpiochip99'", "lines = { a = 0, b = 1, invert_a = 2, invert_b = 3 }");
    assert!(code == Some(3) && error.contains("GPIO chip gpiochip99: No such file"), "{error}");
    let ports = "lines = { a = 'nack', b = 'busy', invert_a = 'd0', invert_b = 'd1' }";
    let (code, error) = with("backend = 'port'\nparport = '/dev/parport99'", ports);
    assert!(code == Some(3) && error.contains("opening /dev/parport99"), "{error}");
    let (code, error) = with("backend = 'port'\nprofile = 'wch-ch382l'\npci = 'ffff:fffe'", ports);
    assert!(code == Some(3) && error.contains("no PCI card ffff:fffe"), "{error}");
    let (code, error) = with("backend = 'mock'", "");
    assert!(code == Some(2) && error.contains("nothing to probe; `rtecctl status`"), "{error}");
}

fn card_of(config: &Path) -> Output {
    card(&["probe", "--config", config.to_str().expect("UTF-8")])
}

/// Another program moves the scale while the lines are watched; nothing is written.
#[test]
fn watches_lines_live_and_writes_nothing() {
    use std::os::unix::fs::FileExt;
    let bench = Bench::new(
        "shared-memory",
        "",
        "lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }",
        &[0; 8],
    );
    let before = bench.bytes();
    let config = bench.config();
    let arguments =
        ["probe", "--config", config.to_str().expect("UTF-8"), "--watch", "--json", "--for", "600ms"];
    let mut watching = command(&arguments).stdout(Stdio::piped()).spawn().expect("it starts");
    // A switches on and off, and B never does, for as long as the watch runs.
    let registers = std::fs::OpenOptions::new().write(true).open(bench.registers()).expect("registers");
    for n in (0..=255_u8).cycle() {
        registers.write_all_at(&[n % 2], 0).expect("a level");
        std::thread::sleep(std::time::Duration::from_millis(1));
        if n % 2 == 0 && watching.try_wait().expect("our child").is_some() {
            break;
        }
    }
    let out = watching.wait_with_output().expect("it ends by itself");
    let document = crate::document(&out.stdout);
    assert_eq!(out.status.code(), Some(0));
    assert!(
        document["looks"].as_u64() > Some(1) && document["lines"].as_array().is_some_and(|l| l.len() >= 2)
    );
    assert_eq!(
        (&document["lines"][0]["edges_seen"], &document["lines"][1]["edges_seen"]),
        (&"both".into(), &"none".into())
    );
    let finding = document["axes"][0]["finding"].as_str().expect("a text");
    assert!(finding.contains("and b has not: look at the wires of b"), "{finding}");
    assert_eq!(bench.bytes(), before, "as it was when A was off");
    let out = bench.probe(&["--watch", "--for", "100ms", "--every", "50ms"]);
    let shown = text(&out.stdout);
    assert!(
        out.status.success() && shown.contains("edges seen") && shown.contains("axis x: at +0 counts"),
        "{shown}"
    );
    assert_eq!(bench.probe(&["--watch", "--json"]).status.code(), Some(2), "a document without an end");
    assert_eq!(bench.probe(&["--watch", "--drive"]).status.code(), Some(2));
    assert_eq!(bench.probe(&["--watch", "--every", "1ms"]).status.code(), Some(2));
}
