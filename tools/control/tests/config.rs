//! Messages for mistakes in rtec.toml.
//! `RTEC_BLESS=1 cargo test` rewrites the golden files.

#[path = "config/here.rs"]
mod here;
#[path = "config/numbers.rs"]
mod numbers;

use rtec_control::config::{CardConfig, Config, EMBEDDED, RegisterPlace, reference};
use rtec_correct::Corrector;
use rtec_driver::card::{Card, CardError, CardInputSample};
use rtec_driver::card_profile::AddressSpace;
use rtec_driver::gpio::{Bias, Drive, GpioLineId};
use rtec_rt::axis::InsertionAtRestPolicy;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::link_messages::RequestToRt;
use std::collections::BTreeMap;
use std::path::Path;

#[test]
fn every_finding_has_its_line_and_its_remedy() {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/config");
    let mut files: Vec<_> = std::fs::read_dir(&directory).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "toml"));
    files.sort();
    assert!(files.len() > 8);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let name = Path::new(file.file_name().unwrap());
        let found = format!("{}\n", Config::parse(name, &text).expect_err("a file with mistakes"));
        test_needs::golden(&file.with_extension("txt"), &found);
        if name == Path::new("syntax.toml") {
            continue;
        }
        // CRLF and a BOM change nothing.
        let windows = format!("\u{feff}{}", text.replace('\n', "\r\n"));
        let again = format!("{}\n", Config::parse(name, &windows).expect_err("the same mistakes"));
        assert_eq!(again.lines().count(), found.lines().count(), "{again}");
    }
}

#[test]
fn the_embedded_default_is_three_simulated_axes() {
    let config = Config::embedded();
    assert_eq!(config.card, CardConfig::Mock);
    assert_eq!(config.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>(), ["x", "y", "z"]);
    assert!(!config.card.is_real() && config.notes.is_empty());
    assert_eq!(config.axis("z"), Some(2));
    assert!(EMBEDDED.is_ascii());
}

const CONTRACT: &str = r#"
[machine]
name = "lathe"
[card]
backend = "mapped"
file = "regs"
probe = 28
[[axis]]
name = "x"
count_um = 0.5
travel_mm = 400
max_correction_counts = 1000
window_counts = 50
min_separation_ns = 1000
max_accel_mm_s2 = 1000
rapid_mm_min = 10000
reference_budget_counts = 400
rest_policy = "insert"
rest_quiet_ms = 2.5
home_mm = -10
lines = { a = "in4", b = 5, invert_a = "out2", invert_b = "out3", read_back_a = 6, read_back_b = 7 }
[rt]
cpu = 3
priority = 90
detect_ns = 2000
write_ns = 300
guard_ns = 200
[control]
socket = "run/s"
group = "rtec"
"#;

#[test]
fn values_arrive_where_they_belong() {
    let config = Config::parse(Path::new("/etc/rtec/rtec.toml"), CONTRACT).unwrap();
    let axis = &config.axes[0];
    let engine = &axis.engine;
    assert!((engine.max_accel_counts_s2 - 2e6).abs() < 1e-6);
    // The budget limits the maximum, with a note.
    assert_eq!((engine.max_correction_counts, config.notes.len()), (400, 2));
    assert!(config.notes[1].contains("view has no group"), "{:?}", config.notes);
    assert_eq!(engine.rest, InsertionAtRestPolicy::Insert { after_ns: 2_500_000 });
    assert_eq!((engine.detect_ns, engine.write_ns, engine.guard_ns), (2000, 300, 200));
    assert_eq!((axis.home_counts, axis.rapid_mm_min), (-20_000, Some(10_000.0)));
    // 2 µs per look, 0.5 µm per count: 500 000 edges/s less what 10⁶ counts/s² adds in 1 µs.
    assert_eq!(axis.followed_hz().map(f64::round), Some(499_998.0));
    assert!(axis.corrected_hz() < axis.followed_hz() && axis.outruns().is_none());
    assert_eq!((engine.lines.a, engine.lines.invert_b, engine.lines.read_back), (4, 3, Some((6, 7))));
    assert_eq!((config.lines.probe, config.lines.hold), (Some(28), None));
    assert_eq!(config.control.socket, Path::new("/etc/rtec/run/s"));
    assert_eq!(config.control.state_path(), Path::new("/etc/rtec/run/state"));
    assert_eq!((config.rt.cpu, config.rt.priority, config.rt.latency_measured), (Some(3), 90, true));
    assert!(
        matches!(&config.card, CardConfig::Registers { place: RegisterPlace::File(file), .. } if file == Path::new("/etc/rtec/regs"))
    );
}

#[test]
fn a_card_without_measured_latency_is_noted() {
    let text = CONTRACT.replace("detect_ns = 2000\n", "");
    let config = Config::parse(Path::new("rtec.toml"), &text).unwrap();
    assert!(!config.rt.latency_measured);
    assert!(config.notes.iter().any(|n| n.contains("selftest latency")), "{:?}", config.notes);
}

const LINES: &str = r#"
[machine]
name = "lathe"
[card]
backend = "gpio"
chip = "gpiochip0"
bias = "pull-down"
probe = { line = 4, active_low = true, bias = "disabled" }
hold = "HOLD"
[[axis]]
name = "x"
count_um = 1
travel_mm = 400
max_correction_counts = 1000
window_counts = 50
min_separation_ns = 1000
max_accel_mm_s2 = 1000
lines = { a = "X_A", b = 1, invert_a = { line = 2, chip = "gpiochip1", drive = "open-drain" }, invert_b = 3 }
"#;

#[test]
fn gpio_lines_are_named_or_numbered_and_inherit_what_the_card_says() {
    let config = Config::parse(Path::new("rtec.toml"), LINES).unwrap();
    let CardConfig::Gpio(setup) = &config.card else { panic!("{:?}", config.card) };
    // A missing latency and a missing rapid are notes.
    assert!(setup.events && config.card.is_real() && config.notes.len() == 2);
    // A and B are one request, the machine's own lines another.
    let (a, b, probe) = (&setup.inputs[1], &setup.inputs[2], &setup.inputs[0]);
    assert!(a.group == b.group && a.group != probe.group);
    assert_eq!(a.line.line, GpioLineId::Name("X_A".into()));
    assert_eq!((a.line.chip.as_deref(), a.line.bias), (Some("gpiochip0"), Some(Bias::PullDown)));
    assert_eq!((probe.line.active_low, probe.line.bias), (true, Some(Bias::Disabled)));
    let invert_a = &setup.outputs[1].line;
    assert_eq!((invert_a.chip.as_deref(), invert_a.drive), (Some("gpiochip1"), Some(Drive::OpenDrain)));
    let lines = config.axes[0].engine.lines;
    assert_eq!((lines.a, lines.b, lines.invert_a, lines.invert_b), (1, 2, 1, 2));
    assert_eq!((config.lines.probe, config.lines.hold), (Some(0), Some(0)));
}

/// The card that a `[card]` table names.
fn card_of(card: &str) -> Result<CardConfig, String> {
    let axis =
        LINES.split("[[axis]]").nth(1).and_then(|axes| axes.split("lines =").next()).unwrap_or_default();
    let lines = "lines = { a = 3, b = 4, invert_a = 0, invert_b = 1 }";
    let text = format!("[machine]\nname = \"lathe\"\n[card]\n{card}\n[[axis]]{axis}{lines}");
    Config::parse(Path::new("rtec.toml"), &text).map(|c| c.card).map_err(|e| e.to_string())
}

#[test]
fn registers_are_where_the_file_or_else_the_profile_says() {
    let place = |card: &str| match card_of(card) {
        Ok(CardConfig::Registers { place: RegisterPlace::Pci(id, bar, AddressSpace::Memory), .. }) => {
            format!("memory of {id}, BAR {bar}")
        }
        Ok(CardConfig::Registers { place: RegisterPlace::File(file), .. }) => {
            format!("file {}", file.display())
        }
        Ok(CardConfig::Registers { place: RegisterPlace::Uio(file, map), .. }) => {
            format!("map {map} of {}", file.display())
        }
        Ok(CardConfig::Registers { place: RegisterPlace::Pci(id, bar, AddressSpace::Io), .. }) => {
            format!("ports of {id}, BAR {bar}")
        }
        Ok(CardConfig::Registers { place: RegisterPlace::Parport(file), .. }) => {
            format!("parport {}", file.display())
        }
        Ok(CardConfig::Registers { place: RegisterPlace::Io(base), .. }) => format!("ports {base:#x}"),
        other => format!("{other:?}"),
    };
    let mapped = |rest: &str| place(&format!("backend = \"mapped\"\n{rest}"));
    let port = |rest: &str| place(&format!("backend = \"port\"\n{rest}"));
    assert_eq!(mapped("profile = \"shared-memory\""), "memory of 1af4:1110, BAR 2");
    assert_eq!(mapped("uio = \"/dev/uio0\"\nmap = 1"), "map 1 of /dev/uio0");
    assert_eq!(mapped("file = \"regs\""), "file regs");
    assert_eq!(mapped("pci = \"0000:00:04.0\"\nbar = 0"), "memory of 0000:00:04.0, BAR 0");
    assert_eq!(port("parport = \"/dev/parport0\""), "parport /dev/parport0");
    assert_eq!(port("io = 0x378"), "ports 0x378");
    assert_eq!(port("profile = \"8255-pci\""), "ports of 144a:7224, BAR 2");
    assert_eq!(port("profile = \"8255-pci\"\npci = \"1307:0028\""), "ports of 1307:0028, BAR 2");
}

#[test]
fn a_place_that_cannot_be_is_explained() {
    for (card, wants) in [
        ("backend = \"mapped\"\nfile = \"x\"\nmap = 2", "found map without uio"),
        (
            "backend = \"port\"",
            "no parport, io or pci in [card], expected parport, io or pci: where the ports are",
        ),
        (
            "backend = \"mapped\"\nprofile = \"counter-card\"",
            "no file, uio or pci in [card], expected file, uio or pci",
        ),
        ("backend = \"mapped\"\nprofile = \"8255-pci\"", "of I/O ports, expected backend = \"port\""),
        (
            "backend = \"port\"\nprofile = \"shared-memory\"",
            "of mapped registers, expected backend = \"mapped\"",
        ),
        ("backend = \"mapped\"\nprofile = \"shard-memory\"", "did you mean \"shared-memory\"?"),
        (
            "backend = \"mapped\"\npci = \"1af4\"",
            "found pci = \"1af4\", expected vendor:device as \"1af4:1110\"",
        ),
        (
            "backend = \"mapped\"\npci = \"1af4:1110\"\nfile = \"x\"",
            "found more than one of file, uio and pci",
        ),
        ("backend = \"mapped\"\nfile = \"x\"\nbar = 2", "found bar without pci"),
        (
            "backend = \"port\"\nio = 0x378\nparport = \"/dev/parport0\"",
            "more than one of parport, io and pci",
        ),
        (
            "backend = \"port\"\nprofile = \"8255-pci\"\nparport = \"/dev/parport0\"",
            "expected the registers of a parallel port (data, status, control)",
        ),
        (
            "backend = \"port\"\npci = \"1307:0028\"",
            "no bar in [card], expected bar: which base address register",
        ),
    ] {
        let found = card_of(card).unwrap_err();
        assert!(found.contains(wants), "{found}\n  wants {wants}");
    }
}

/// Three corrections of 4 µm (NISTIR 4832), within one insertion and the maximum.
#[test]
fn a_window_that_is_not_given_is_12_um() {
    for (count_um, max, counts) in
        [("1.0", 1000, 12), ("0.1", 1000, 120), ("5.0", 1000, 3), ("20.0", 1000, 2), ("1.0", 9, 9)]
    {
        let text = format!(
            "[machine]\nname = 'm'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = {count_um}\ntravel_mm = 900\n\
             max_correction_counts = {max}\nmin_separation_ns = 500\n"
        );
        let config = Config::parse(Path::new("rtec.toml"), &text).unwrap();
        assert_eq!(config.axes[0].engine.window_counts, counts, "{count_um} {max}");
    }
}

#[test]
fn a_name_without_end_and_a_broken_line_are_one_finding() {
    let long = CONTRACT.replace("name = \"lathe\"", &format!("name = \"{}\"", "x".repeat(1 << 20)));
    let found = Config::parse(Path::new("rtec.toml"), &long).unwrap_err().to_string();
    assert!(found.lines().count() == 1 && found.len() < 300, "{}", &found[..300]);
    // A broken line at any place of the embedded default.
    let lines: Vec<&str> = EMBEDDED.lines().collect();
    for n in 0..lines.len() {
        for broken in ["lines = { a = 'in0',", "x = \"\"\"", "name = \"", "[[axis", "= = =", "a = [1, 2"] {
            let text: Vec<&str> =
                lines[..n].iter().copied().chain([broken]).chain(lines[n + 1..].iter().copied()).collect();
            let found = Config::parse(Path::new("rtec.toml"), &text.join("\n")).unwrap_err();
            assert!(found.0.len() <= 5, "line {n} {broken}: {} findings\n{found}", found.0.len());
        }
    }
}

/// The reference page is generated from the tables of keys.
#[test]
fn the_reference_page_shows_the_tables_of_keys() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../guide/reference/rtec-toml.md");
    let text = std::fs::read_to_string(&page).unwrap();
    let intro = text.split("| `[machine]` |").next().unwrap();
    test_needs::golden(&page, &[intro, &reference()].concat());
}

/// Every key that is read is in the table of its section.
#[test]
fn the_tables_have_every_key() {
    let text = reference();
    let table = |section: &str| {
        let head = format!("| `{section}` | takes |");
        let from = text.find(&head).unwrap_or_else(|| panic!("no table of {section}"));
        text[from..].split("\n\n").next().unwrap()
    };
    let (mut sections, mut keys) = (std::collections::BTreeSet::new(), 0);
    for backend in ["mock", "gpio", "mapped", "port", "replay"] {
        let config = format!(
            "[machine]\nqqq=1\n[card]\nbackend='{backend}'\nqqq=1\n[[axis]]\nname='x'\nqqq=1\n[[sensor]]\nname='T'\n\
             source='line'\nfrom='h:1'\nqqq=1\n[rt]\nqqq=1\n[model]\nqqq=1\n[control]\nqqq=1\nview={{qqq=1}}\n"
        );
        let findings = Config::parse(Path::new("q.toml"), &config).unwrap_err();
        for finding in &findings.0 {
            let Some((section, known)) =
                finding.expected.strip_prefix("a key of ").and_then(|e| e.split_once(": "))
            else {
                continue;
            };
            for key in known.split(", ") {
                let section = if section == "view" { "operate, view" } else { section };
                assert!(table(section).contains(&format!("| `{key}` |")), "{key} of {section}");
                keys += 1;
            }
            sections.insert(section.to_owned());
        }
    }
    assert!(sections.len() >= 8 && keys > 150, "{sections:?} {keys}");
}

/// A quiet time within which a turning axis may cross no edge is noted.
/// 1000 mm/s² and 0.5 µm are 2·10⁶ counts/s²: 2 ms at the slowest turn.
#[test]
fn a_quiet_time_shorter_than_a_slow_turn_is_noted() {
    for (ms, noted) in [("1", true), ("2", true), ("2.1", false), ("300", false)] {
        let text = CONTRACT.replace("rest_quiet_ms = 2.5", &format!("rest_quiet_ms = {ms}"));
        let notes = Config::parse(Path::new("rtec.toml"), &text).unwrap().notes.join("; ");
        assert_eq!(notes.contains("is not longer than 2.00 ms"), noted, "{ms}: {notes}");
    }
}

/// The line `mtc_ready`, and the effect of its fall.
#[test]
fn mtc_ready_is_a_line_and_mtc_off_needs_it() {
    let wired = CONTRACT.replace("probe = 28", "probe = 28\nmtc_ready = 30");
    let parse = |text: &str| Config::parse(Path::new("rtec.toml"), text);
    let config = parse(&wired).unwrap();
    assert_eq!((config.lines.mtc_ready, config.hold_without_mtc), (Some(30), false));
    let hold = |text: &str| text.replace("name = \"lathe\"", "name = \"lathe\"\nmtc_off = \"hold\"");
    assert!(parse(&hold(&wired)).unwrap().hold_without_mtc);
    let text = parse(&hold(CONTRACT)).unwrap_err().to_string();
    assert!(
        text.contains("rtec.toml:4:11: found mtc_off without mtc_ready, expected mtc_ready in [card]"),
        "{text}"
    );
}

#[test]
fn rotary_and_coupled_axes_are_refused_by_name() {
    for (key, kind) in [
        ("kind = \"rotary\"", "rotary"),
        ("kind = \"gantry\"", "coupled"),
        ("count_deg = 0.001", "rotary"),
        ("count_arcsec = 1", "rotary"),
        ("travel_deg = 360", "rotary"),
        ("rapid_deg_min = 360", "rotary"),
        ("coupled_with = \"x2\"", "coupled"),
        ("gantry = true", "coupled"),
        ("master = \"x2\"", "coupled"),
        ("slave = \"x2\"", "coupled"),
    ] {
        for kept in ["count_um = 0.5\ntravel_mm = 400\n", ""] {
            let text = CONTRACT.replace("count_um = 0.5\ntravel_mm = 400\n", &format!("{kept}{key}\n"));
            let found = Config::parse(Path::new("rtec.toml"), &text).unwrap_err();
            assert_eq!(found.0.len(), 1, "{found}");
            let said = found.to_string();
            assert!(
                said.contains(&format!("axis x, which is {kind}")) && said.contains("not supported"),
                "{said}"
            );
        }
    }
    // A, B and C are rotary by their names; no other verb takes them for linear.
    let text = CONTRACT.replacen("name = \"x\"", "name = \"b\"", 1);
    let said = Config::parse(Path::new("rtec.toml"), &text).unwrap_err().to_string();
    assert!(said.contains("axis b, which is rotary"), "{said}");
    let linear = CONTRACT.replace("[[axis]]\n", "[[axis]]\nkind = \"linear\"\n");
    assert!(Config::parse(Path::new("rtec.toml"), &linear).is_ok());
}
