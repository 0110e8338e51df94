//! What a person sees who made a mistake in rtec.toml.
//! `RTEC_BLESS=1 cargo test` writes the golden files anew.

use rtec_control::config::{CardConfig, Config, EMBEDDED, MappedPlace, PortPlace};
use rtec_correct::Corrector;
use rtec_driver::card::{Card, CardError, Sample};
use rtec_driver::gpio::{Bias, Drive, LineId};
use rtec_rt::axis::RestPolicy;
use rtec_rt::engine::{Engine, MachineConfig};
use rtec_rt::event::Request;
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
    // The budget caps the maximum, and says so.
    assert_eq!((engine.max_correction_counts, config.notes.len()), (400, 2));
    assert!(config.notes[1].contains("view has no group"), "{:?}", config.notes);
    assert_eq!(engine.rest, RestPolicy::Insert { after_ns: 2_500_000 });
    assert_eq!((engine.detect_ns, engine.write_ns, engine.guard_ns), (2000, 300, 200));
    assert_eq!((axis.home_counts, axis.rapid_mm_min), (-20_000, Some(10_000.0)));
    // 2 µs a look, 0.5 µm a count: 500 000 edges/s less what 10⁶ counts/s² add in 1 µs.
    assert_eq!(axis.followed_hz().map(f64::round), Some(499_998.0));
    assert!(axis.corrected_hz() < axis.followed_hz() && axis.outruns().is_none());
    assert_eq!((engine.lines.a, engine.lines.invert_b, engine.lines.read_back), (4, 3, Some((6, 7))));
    assert_eq!((config.lines.probe, config.lines.hold), (Some(28), None));
    assert_eq!(config.control.socket, Path::new("/etc/rtec/run/s"));
    assert_eq!(config.control.state_path(), Path::new("/etc/rtec/run/state"));
    assert_eq!((config.rt.cpu, config.rt.priority, config.rt.latency_measured), (Some(3), 90, true));
    assert!(
        matches!(&config.card, CardConfig::Mapped { place: MappedPlace::File(file), .. } if file == Path::new("/etc/rtec/regs"))
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
    // No latency, and no rapid, are notes.
    assert!(setup.events && config.card.is_real() && config.notes.len() == 2);
    // A and B are one request, the machine's own lines another.
    let (a, b, probe) = (&setup.inputs[1], &setup.inputs[2], &setup.inputs[0]);
    assert!(a.group == b.group && a.group != probe.group);
    assert_eq!(a.line.line, LineId::Name("X_A".into()));
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
        Ok(CardConfig::Mapped { place: MappedPlace::Pci(id, bar), .. }) => {
            format!("memory of {id}, BAR {bar}")
        }
        Ok(CardConfig::Mapped { place: MappedPlace::File(file), .. }) => format!("file {}", file.display()),
        Ok(CardConfig::Mapped { place: MappedPlace::Uio(file, map), .. }) => {
            format!("map {map} of {}", file.display())
        }
        Ok(CardConfig::Port { place: PortPlace::Pci(id, bar), .. }) => format!("ports of {id}, BAR {bar}"),
        Ok(CardConfig::Port { place: PortPlace::Parport(file), .. }) => format!("parport {}", file.display()),
        Ok(CardConfig::Port { place: PortPlace::Io(base), .. }) => format!("ports {base:#x}"),
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

#[test]
fn what_this_computer_lacks_is_found_on_it_and_nowhere_else() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    let text = CONTRACT
        .replace("file = \"regs\"", "uio = \"/dev/null-and-void\"")
        .replace("group = \"rtec\"", "group = \"nobody-has-this\"\nview = { group = \"nor-this\" }");
    std::fs::write(&file, format!("{text}[model]\nfile = \"missing.toml\"\n")).unwrap();
    assert!(Config::load(&file).is_ok());
    let found = Config::check_here(&file).unwrap_err().to_string();
    for wants in ["/dev/null-and-void", "nobody-has-this", "nor-this", "missing.toml"] {
        assert!(found.contains(wants), "no {wants} in {found}");
    }
    // One more: a CPU that a small computer does not have.
    let cpus = usize::from(found.contains("cpu = 3"));
    let findings = found.lines().filter(|line| !line.starts_with("note: "));
    assert_eq!(findings.count(), 4 + cpus, "{found}");
}

/// The commonest mistakes are found.
/// They are a wrong record or column name, a model of missing sensors, and a card in another computer. A sensor may
/// be plugged in later.
#[test]
fn what_sensors_model_and_card_name_is_looked_for() {
    let directory = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| std::fs::write(directory.path().join(name), text).unwrap();
    let file = directory.path().join("rtec.toml");
    let check = |more: &str| {
        put("rtec.toml", &format!("{EMBEDDED}\n{more}"));
        Config::check_here(&file).map(|c| c.notes).map_err(|e| e.to_string())
    };
    let usual = check("").unwrap();
    put(
        "day.run.toml",
        "file = \"day.csv\"\nkind = \"drift\"\n[columns]\nT1 = { role = \"temperature\", unit = \"degC\" }\n",
    );
    put("day.csv", "T1\n20\n21\n");
    let replayed = |record: &str, column: &str| {
        format!("[[sensor]]\nname = \"T1\"\nsource = \"csv\"\nrecord = \"{record}\"\ncolumn = \"{column}\"\n")
    };
    assert_eq!(check(&replayed("day.run.toml", "T1")), Ok(usual.clone()));
    let found = check(&replayed("night.run.toml", "T1")).unwrap_err();
    assert!(found.contains("night.run.toml") && found.lines().count() == 1, "{found}");
    let found = check(&replayed("day.run.toml", "T9")).unwrap_err();
    assert!(
        found.contains("found column 'T9', expected a column of") && found.ends_with("day.run.toml: T1"),
        "{found}"
    );

    let notes =
        check("[[sensor]]\nname = \"T1\"\nsource = \"one_wire\"\nid = \"28-0123456789ab\"\n").unwrap();
    assert!(
        notes.len() == usual.len() + 1
            && notes.last().unwrap().contains("[[sensor]] T1: nothing is read from it now"),
        "{notes:?}"
    );

    put(
        "machine.toml",
        "name = \"m\"\n[[effect]]\nname = \"thermal_growth.x\"\nsensor = \"T7\"\nreference_degC = 20.0\num_per_K = 2.0\n",
    );
    let found = check("[model]\nfile = \"machine.toml\"\n").unwrap_err();
    assert!(found.contains("T7 (read by thermal_growth.x)"), "{found}");
    put("machine.toml", "name = \"m\"\n[[effect]]\nname = \"scale.w\"\nppm = 2.0\n");
    let notes = check("[model]\nfile = \"machine.toml\"\n").unwrap();
    assert!(
        notes.last().unwrap().starts_with("[model] no axis w in the daemon's configuration"),
        "{notes:?}"
    );

    let card =
        CONTRACT.replace("file = \"regs\"", "pci = \"dead:beef\"\nbar = 0").replace("group = \"rtec\"", "");
    std::fs::write(&file, &card).unwrap();
    let found = Config::check_here(&file).unwrap_err().to_string();
    assert!(found.contains("no PCI card dead:beef"), "{found}");
    assert!(Config::load(&file).is_ok());
}

/// Three corrections of 4 µm (NISTIR 4832), at least one insertion, at most the largest total.
#[test]
fn a_window_that_is_not_given_is_12_um() {
    for (count_um, max, counts) in
        [("1.0", 1000, 12), ("0.1", 1000, 120), ("5.0", 1000, 2), ("20.0", 1000, 2), ("1.0", 9, 9)]
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
    // A line that is no line, anywhere in the embedded default.
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

/// Every key that is read stands in the document, in the table of its section.
#[test]
fn the_document_names_every_key() {
    let text = include_str!("../../guide/reference/rtec-toml.md");
    let table = |section: &str| {
        let head = format!("| `{section}` | meaning |");
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
            let table = table(if section == "view" { "[control]" } else { section });
            for key in known.split(", ") {
                let named = [format!("`{key}`"), format!("{key}`"), format!(" {key},"), format!(" {key} }}")];
                assert!(named.iter().any(|n| table.contains(n.as_str())), "{key} of {section}");
                keys += 1;
            }
            sections.insert(section.to_owned());
        }
    }
    assert!(sections.len() >= 8 && keys > 150, "{sections:?} {keys}");
}

/// The controller's own line, and what its fall does.
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

/// No number of a configuration causes a panic.
/// It is refused, or engine and control law run with it. Arithmetic that overflows panics in tests.
#[test]
fn extreme_numbers_are_refused_or_run() {
    const KEYS: [&str; 27] = [
        "axis.count_um",
        "axis.travel_mm",
        "axis.max_correction_counts",
        "axis.window_counts",
        "axis.min_separation_ns",
        "axis.max_accel_mm_s2",
        "axis.max_accel_counts_s2",
        "axis.hysteresis_counts",
        "axis.warn_counts",
        "axis.error_counts",
        "axis.max_rate_counts_s",
        "axis.rest_quiet_ms",
        "axis.reference_budget_counts",
        "axis.home_mm",
        "rt.cpu",
        "rt.priority",
        "rt.detect_ns",
        "rt.write_ns",
        "rt.guard_ns",
        "control.stale_ms",
        "model.period_ms",
        "model.ramp_um_s",
        "model.lead_ms",
        "model.log_s",
        "sensor.timeout_s",
        "sensor.freeze_s",
        "sensor.max_rate_K_per_min",
    ];
    const VALUES: [&str; 20] = [
        "0",
        "1",
        "-1",
        "2",
        "4",
        "20",
        "99",
        "0.001",
        "0.0001",
        "0.05",
        "1e-308",
        "1000",
        "1000000",
        "1000000000",
        "1e9",
        "1e15",
        "1e308",
        "nan",
        "inf",
        "9223372036854775807",
    ];
    let mut dice = test_needs::dice::Dice::new(38);
    let (mut ran, mut refused) = (0, 0);
    for n in 0..4000 {
        let mut values = BTreeMap::from([
            ("axis.count_um", "1"),
            ("axis.travel_mm", "400"),
            ("axis.max_correction_counts", "1000"),
            ("axis.window_counts", "50"),
            ("axis.min_separation_ns", "500"),
            ("control.stale_ms", "500"),
        ]);
        // Each key with each value alone, then several at once.
        let alone = n < KEYS.len() * VALUES.len();
        if alone {
            values.insert(KEYS[n / VALUES.len()], VALUES[n % VALUES.len()]);
        } else {
            for _ in 0..dice.within(2, 6) {
                let (key, value) = (dice.within(0, 26), dice.within(0, 19));
                values.insert(KEYS[key as usize], VALUES[value as usize]);
            }
        }
        let of = |table: &str| -> String {
            let own = values.iter().filter_map(|(key, value)| Some((key.strip_prefix(table)?, value)));
            let lines: Vec<String> =
                own.map(|(key, value)| format!("{} = {value}\n", key.trim_start_matches('.'))).collect();
            lines.concat()
        };
        let rest = if values.contains_key("axis.rest_quiet_ms") { "rest_policy = 'insert'\n" } else { "" };
        let text = format!(
            "[machine]\nname = 'm'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\n{rest}{}[rt]\n{}[control]\n{}[model]\n{}\
             [[sensor]]\nname = 'T1'\nsource = 'line'\nfrom = '/dev/null'\n{}",
            of("axis"),
            of("rt"),
            of("control"),
            of("model"),
            of("sensor")
        );
        match Config::parse(Path::new("rtec.toml"), &text) {
            Ok(config) => {
                ran += 1;
                runs(&config);
            }
            Err(_) => refused += 1,
        }
    }
    assert!(ran > 200 && refused > 1000, "{ran} ran, {refused} refused");
}

/// Runs engine and control law for some hundred edges there and back, with the largest totals.
fn runs(config: &Config) {
    let mut card = Strokes::default();
    let machine = MachineConfig { lines: config.lines, may_arm: true };
    let Ok(mut engine) = Engine::new(&mut card, &config.engine_axes(), machine, &[]) else { return };
    engine.start_homed_at(&mut card, |n| config.axes[n].home_counts, &mut |_| true).expect("an engine");
    let law = config.axes.iter().map(rtec_control::config::ConfiguredAxis::law).collect();
    let mut corrector = Corrector::new(law, config.model.ramp_um_s, config.model.lead_ms * 1e-3, 0.0);
    for n in 0..600_u32 {
        if n % 100 == 0 {
            let max = config.axes[0].engine.max_correction_counts;
            for total_counts in [max, -max, 0] {
                let request = Request::Correct { axis: 0, total_counts, large: true };
                engine.take(request, &mut card, &mut |_| true).expect("taken");
            }
        }
        engine.poll(&mut card, u64::MAX, &mut |_| true).expect("told");
        corrector.tick(f64::from(n) * 0.01, &engine.status(), &[]);
    }
}

/// A card whose axis goes there and back, an edge a look, slower and slower.
#[derive(Default)]
struct Strokes {
    t_ns: u64,
    looks: u64,
    outputs: u64,
}

impl Card for Strokes {
    fn sample(&mut self, _wake_ns: u64) -> Result<Sample, CardError> {
        self.looks += 1;
        self.t_ns += 1 << (self.looks % 34);
        let place = if self.looks % 200 < 100 { self.looks } else { 400 - self.looks % 200 };
        Ok(Sample::level(self.t_ns, [0, 1, 3, 2][place as usize % 4]))
    }

    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        self.outputs = self.outputs & !mask | value & mask;
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.outputs)
    }
}

/// Names that this computer lacks are reported with their lines: chip, CPU, group, file.
#[test]
fn names_what_this_computer_does_not_have() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    let field = "[machine]\nname = \"pi lathe\"\n[card]\nbackend = \"gpio\"\nchip = \"gpiochip77\"\n[[axis]]\nname = \"x\"\n\
        count_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\n\
        max_accel_mm_s2 = 1000.0\nlines = { a = 0, b = 1, invert_a = 2, invert_b = 3 }\n[rt]\ncpu = 4000\ndetect_ns = 5000\n\
        write_ns = 1000\n[control]\ngroup = \"no-such-group\"\n";
    let mapped = CONTRACT.replace("group = \"rtec\"\n", "");
    let parport = mapped.replace(
        "backend = \"mapped\"\nfile = \"regs\"\nprobe = 28",
        "backend = \"port\"\nparport = \"none\"",
    );
    let lines = "lines = { a = 3, b = 4, invert_a = 0, invert_b = 1 }\n[rt]";
    let parport = parport.replace("write_ns = 300", "write_ns = 1000").replace("lines = { a = \"in4\", b = 5, invert_a = \"out2\", invert_b = \"out3\", read_back_a = 6, read_back_b = 7 }\n[rt]", lines);
    for (text, says) in [
        (field, &["5:", "gpiochip77", "cpu = 4000", "no-such-group", "--elsewhere"][1..]),
        (&mapped, &["\"regs\", which cannot be looked at: No such file"][..]),
        (&parport, &["\"none\", which cannot be looked at: No such file"][..]),
    ] {
        std::fs::write(&file, text).unwrap();
        assert!(Config::load(&file).is_ok(), "{}", Config::load(&file).unwrap_err());
        let found = Config::check_here(&file).unwrap_err().to_string();
        for text in says {
            assert!(found.contains(text), "no {text} in {found}");
        }
        // Four lines on one absent chip are one finding.
        assert!(found.matches("gpiochip77").count() <= 1, "{found}");
    }
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
    // A, B and C turn by their names: no other verb takes them for linear.
    let text = CONTRACT.replacen("name = \"x\"", "name = \"b\"", 1);
    let said = Config::parse(Path::new("rtec.toml"), &text).unwrap_err().to_string();
    assert!(said.contains("axis b, which is rotary"), "{said}");
    let linear = CONTRACT.replace("[[axis]]\n", "[[axis]]\nkind = \"linear\"\n");
    assert!(Config::parse(Path::new("rtec.toml"), &linear).is_ok());
}

/// Replaces every number of a full configuration by every extreme.
/// It is refused, or the results are finite and an engine accepts them.
#[test]
fn no_number_reaches_arithmetic_unbounded() {
    const ALL: &str = "[machine]\nname = 'm'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 500.0\n\
        max_correction_counts = 300\nwindow_counts = 50\nwarn_counts = 100\nerror_counts = 200\nmin_separation_ns = 500\n\
        max_accel_mm_s2 = 1000.0\nrapid_mm_min = 10000.0\nhysteresis_counts = 0.1\nmax_rate_counts_s = 1000.0\n\
        rest_policy = 'insert'\nrest_quiet_ms = 5.0\nreference_budget_counts = 400\nhome_mm = 10.0\n\
        simulated = { count_um = 2.0, compensates_ppm = 5.0 }\n[rt]\ncpu = 0\npriority = 80\ndetect_ns = 1000\n\
        write_ns = 300\nguard_ns = 100\n[control]\nstale_ms = 500\n[model]\nperiod_ms = 10\nramp_um_s = 5.0\nlead_ms = 20.0\n\
        log_s = 5.0\n[[sensor]]\nname = 'T1'\nsource = 'iio'\ndevice = 'd'\nchannel = 1\nperiod_s = 1.0\n\
        range_degC = [ -20.0, 120.0]\nmax_rate_K_per_min = 10.0\ntimeout_s = 5.0\nstuck_s = 600.0\nfreeze_s = 60.0\n";
    let accel = ALL.replace("max_accel_mm_s2", "max_accel_counts_s2");
    let mut tried = 0;
    for all in [ALL, &accel] {
        Config::parse(Path::new("rtec.toml"), all).unwrap();
        let begins = |before: &str| [" = ", ", "].iter().any(|b| before.ends_with(b));
        let numbers = all.char_indices().filter(|(n, _)| begins(&all[..*n]));
        for (at, _) in numbers.filter(|(_, c)| c.is_ascii_digit()) {
            let end = at + all[at..].find(|c: char| !c.is_ascii_digit() && c != '.').unwrap();
            for extreme in [
                "1e-308",
                "-1e-308",
                "1e308",
                "-1e308",
                "0",
                "-1",
                "inf",
                "-inf",
                "nan",
                "9223372036854775807",
            ] {
                let text = format!("{}{extreme}{}", &all[..at], &all[end..]);
                tried += 1;
                let Ok(config) = Config::parse(Path::new("rtec.toml"), &text) else { continue };
                let axis = &config.axes[0];
                let travel_counts = axis.travel_mm * 1000.0 / axis.simulated.count_um;
                let numbers =
                    [travel_counts, axis.engine.max_accel_counts_s2, axis.count_um, config.model.lead_ms];
                assert!(numbers.iter().all(|n| n.is_finite() && n.abs() < 1e16), "{text}");
                assert!(axis.home_counts.abs() < 1 << 52 && axis.engine.gate().is_some(), "{text}");
                assert!(
                    axis.corrected_hz().unwrap().is_finite() && axis.followed_hz().is_none_or(f64::is_finite)
                );
            }
        }
    }
    assert!(tried > 400, "{tried}");
}

/// A name that this computer lacks is a finding, as the guide promises for `config check`.
#[test]
fn check_here_names_what_this_computer_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("rtec.toml");
    let axis = |rest: &str| {
        format!(
            "[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 400\nmax_correction_counts = 1000\nwindow_counts = 50\n\
             min_separation_ns = 500\nmax_accel_mm_s2 = 1000.0\n{rest}\n"
        )
    };
    let lines = "lines = { a = 0, b = 1, invert_a = 2, invert_b = 3 }";
    let memory = "lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }";
    let port = "lines = { a = 'nack', b = 'busy', invert_a = 'd0', invert_b = 'd1' }";
    let mock = |rest: &str| format!("[card]\nbackend = 'mock'\n{}{rest}", axis(""));
    let mapped =
        |key: &str| format!("[card]\nbackend = 'mapped'\nprofile = 'shared-memory'\n{key}\n{}", axis(memory));
    let replayed =
        |name: &str| format!("[[sensor]]\nname = 'T1'\nsource = 'csv'\nrecord = '{name}.run.toml'\n");
    let sidecar = |name: &str| {
        format!(
            "file = \"{name}.csv\"\nkind = \"drift\"\n[columns]\nt = {{ role = \"time\", unit = \"s\" }}\n\
             T1 = {{ role = \"temperature\", unit = \"degC\" }}\n"
        )
    };
    let folder = file.parent().unwrap();
    for (name, csv) in [
        ("beside", None),
        ("document", Some("%PDF-1.7\n%\u{e2}\n")),
        ("absolute", Some("t,T1\n2026-01-02T03:04:05,20\n2026-01-02T03:05:05,21\n")),
    ] {
        std::fs::write(folder.join(format!("{name}.run.toml")), sidecar(name)).unwrap();
        if let Some(csv) = csv {
            std::fs::write(folder.join(format!("{name}.csv")), csv).unwrap();
        }
    }
    for (name, says, config) in [
        (
            "chip",
            "GPIO chip gpiochip4095",
            format!("[card]\nbackend = 'gpio'\nchip = 'gpiochip4095'\n{}", axis(lines)),
        ),
        ("file", "/nonexistent/registers", mapped("file = '/nonexistent/registers'")),
        ("uio", "/dev/uio4095", mapped("uio = '/dev/uio4095'")),
        ("pci", "PCI card fffe:fffe", mapped("pci = 'fffe:fffe'")),
        (
            "parport",
            "/dev/parport4095",
            format!(
                "[card]\nbackend = 'port'\nprofile = 'parallel-port'\nparport = '/dev/parport4095'\n{}",
                axis(port)
            ),
        ),
        ("profile", "gone.toml", mapped("file = '/dev/null'").replace("'shared-memory'", "'gone.toml'")),
        ("trace", "gone.csv", format!("[card]\nbackend = 'replay'\n{}", axis("trace = 'gone.csv'"))),
        ("cpu", "cpu = 4095", mock("[rt]\ncpu = 4095\n")),
        ("group", "nosuchgroup-rtec", mock("[control]\ngroup = 'nosuchgroup-rtec'\n")),
        ("log folder", "/nonexistent", mock("[control]\nlog_file = '/nonexistent/log'\n")),
        ("model", "gone.machine.toml", mock("[model]\nfile = 'gone.machine.toml'\n")),
        (
            "recording",
            "gone.run.toml",
            mock("[[sensor]]\nname = 'T1'\nsource = 'csv'\nrecord = 'gone.run.toml'\n"),
        ),
        ("csv beside it", "beside.csv", mock(&replayed("beside"))),
        ("recording as PDF", "a PDF document", mock(&replayed("document"))),
        ("absolute times", "2026-01-02T03:04:05", mock(&replayed("absolute"))),
    ] {
        let text = format!("[machine]\nname = 'm'\n{config}");
        std::fs::write(&file, &text).unwrap();
        let found = Config::check_here(&file).expect_err(name).to_string();
        assert!(found.contains(says) && found.contains("rtec.toml:"), "{name}: {found}");
        // For another computer it is nobody's business; profiles are part of the configuration.
        if name != "profile" {
            let elsewhere = Config::load(&file).map_err(|e| e.to_string());
            assert!(elsewhere.is_ok(), "{name}: {elsewhere:?}");
        }
    }
    // Notes stand beside findings.
    let silent = "[[sensor]]\nname = 'T2'\nsource = 'one_wire'\nid = '28-000000000000'\n";
    std::fs::write(&file, format!("[machine]\nname = 'm'\n{}", mock(&(replayed("beside") + silent))))
        .unwrap();
    let both = Config::check_here(&file).unwrap_err();
    assert!(both.1[0].contains("[[sensor]] T2") && both.to_string().contains("note: "), "{both}");
    // What may come yet is a note.
    std::fs::write(&file, format!("[machine]\nname = 'm'\n{}", mock("[[sensor]]\nname = 'T1'\nsource = 'one_wire'\nid = '28-000000000000'\n[control]\nspool = '/nonexistent/spool'\n"))).unwrap();
    let notes = Config::check_here(&file).unwrap().notes.join("\n");
    assert!(notes.contains("[[sensor]] T1") && notes.contains("/nonexistent/spool"), "{notes}");
}
