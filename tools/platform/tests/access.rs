//! Access to a card's devices, on trees of files that look like a system.
#![allow(clippy::unwrap_used)] // a test may
use rtec_driver::pci::PciFunctionSelector;
use rtec_platform::device_access_check::{CardDevice, card};
use rtec_rt::realtime_setup::{SetupFinding, SystemRoot};
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::Path;

fn put(root: &Path, path: &str, text: &str) {
    let path = root.join(path);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

/// A machine with two CPUs, no interrupt on CPU 1, and a user rtec.
/// It has a GPIO chip, a UIO device, a parallel port and a PCI card, and the user may use all their files.
fn installed() -> tempfile::TempDir {
    let tree = tempfile::tempdir().unwrap();
    let root = tree.path();
    let mine = fs::metadata(root).unwrap();
    put(root, "etc/passwd", &format!("root:x:4242:4242::/:\nrtec:x:{}:{}::/:\n", mine.uid(), mine.gid()));
    put(root, "etc/group", &format!("rtec:x:{}:\n", mine.gid()));
    put(
        root,
        "proc/self/status",
        &format!("Uid:\t7\t7\t7\t7\nGid:\t7\t7\t7\t7\nGroups:\t4 {} \n", mine.gid()),
    );
    put(root, "sys/devices/system/cpu/online", "0-1\n");
    put(root, "sys/devices/platform/fe200000.gpio/gpiochip0/dev", "254:0\n");
    fs::create_dir_all(root.join("sys/bus/gpio/devices")).unwrap();
    symlink("../../../devices/platform/fe200000.gpio/gpiochip0", root.join("sys/bus/gpio/devices/gpiochip0"))
        .unwrap();
    put(root, "sys/class/uio/uio0/name", "my-card\n");
    let card = "sys/bus/pci/devices/0000:00:04.0";
    for (file, text) in [("vendor", "0x1af4\n"), ("device", "0x1110\n"), ("irq", "11\n"), ("resource2", "")] {
        put(root, &format!("{card}/{file}"), text);
    }
    for (irq, action) in [(11, "other"), (20, "my-card"), (30, "rtec")] {
        put(root, &format!("proc/irq/{irq}/{action}/.keep"), "");
        put(root, &format!("proc/irq/{irq}/effective_affinity_list"), "0\n");
    }
    for device in ["gpiochip0", "uio0", "parport0"] {
        put(root, &format!("dev/{device}"), "");
    }
    tree
}

fn find(root: &Path, device: &CardDevice, events: bool) -> Vec<SetupFinding> {
    card(&SystemRoot::at(root), std::slice::from_ref(device), events, 1)
}

fn not_ok(findings: &[SetupFinding]) -> Vec<&str> {
    findings.iter().filter(|f| !f.ok).map(|f| f.name).collect()
}

/// Every kind of device, its file, and its line in `/etc/rtec/devices`.
fn devices() -> [(CardDevice, &'static str, &'static str); 4] {
    [
        (CardDevice::Gpio("gpiochip0".into()), "dev/gpiochip0", "`gpio fe200000.gpio`"),
        (CardDevice::Uio("uio0".into()), "dev/uio0", "`uio my-card`"),
        (CardDevice::Parport("parport0".into()), "dev/parport0", "`parport parport0`"),
        (
            CardDevice::Bar(PciFunctionSelector::Card(0x1af4, 0x1110), 2),
            "sys/bus/pci/devices/0000:00:04.0/resource2",
            "`pci 1af4:1110`",
        ),
    ]
}

#[test]
fn a_machine_that_is_set_up_has_no_remedy() {
    let tree = installed();
    for (device, ..) in devices() {
        let findings = find(tree.path(), &device, false);
        assert_eq!(not_ok(&findings), Vec::<&str>::new(), "{device:?}");
        assert!(findings.iter().all(|f| f.remedy.is_empty()));
        assert!(findings.iter().any(|f| f.name == "card_access" && f.needed_to_arm));
    }
}

#[test]
fn a_device_that_is_closed_is_named_with_the_line_that_opens_it() {
    for (device, file, line) in devices() {
        let tree = installed();
        fs::set_permissions(tree.path().join(file), fs::Permissions::from_mode(0o400)).unwrap();
        let findings = find(tree.path(), &device, false);
        assert_eq!(not_ok(&findings), ["card_access"], "{device:?}");
        let access = findings.iter().find(|f| f.name == "card_access").unwrap();
        assert!(access.remedy.contains(line), "{}", access.remedy);
        assert_eq!(access.got, "rtec:rtec 0400");
    }
}

#[test]
fn the_bits_that_count_are_those_of_owner_group_or_others() {
    let device = CardDevice::Uio("uio0".into());
    for (uid_is_rtec, gid_is_rtec, mode, ok) in [
        (true, true, 0o060, false),
        (true, true, 0o600, true),
        (false, true, 0o600, false),
        (false, true, 0o060, true),
        (false, true, 0o040, false),
        (false, false, 0o660, false),
        (false, false, 0o006, true),
    ] {
        let tree = installed();
        let mine = fs::metadata(tree.path()).unwrap();
        let id = |same, own: u32| if same { own } else { own + 1 };
        let (uid, gid) = (id(uid_is_rtec, mine.uid()), id(gid_is_rtec, mine.gid()));
        put(tree.path(), "etc/passwd", &format!("rtec:x:{uid}:{gid}::/:\n"));
        fs::set_permissions(tree.path().join("dev/uio0"), fs::Permissions::from_mode(mode)).unwrap();
        let findings = find(tree.path(), &device, false);
        let access = findings.iter().find(|f| f.name == "card_access").unwrap();
        assert_eq!(access.ok, ok, "{mode:o} {}", access.got);
    }
}

#[test]
fn what_is_not_there_is_said() {
    let tree = installed();
    for (device, file, _) in devices() {
        let path = tree.path().join(file);
        if path.starts_with(tree.path().join("dev")) {
            fs::remove_file(&path).unwrap();
            let findings = find(tree.path(), &device, false);
            let access = findings.iter().find(|f| f.name == "card_access").unwrap();
            assert_eq!(access.errno.as_ref().unwrap().errno, libc::ENOENT);
            assert!(access.remedy.starts_with("no such device: "), "{}", access.remedy);
        }
    }
    let findings = find(tree.path(), &CardDevice::Bar(PciFunctionSelector::Card(1, 2), 0), false);
    let access = findings.iter().find(|f| f.name == "card_access").unwrap();
    assert_eq!((access.wanted.as_str(), access.got.as_str()), ("PCI card 0001:0002", "not on the bus"));
}

#[test]
fn a_polled_card_s_interrupts_stay_off_the_cpu_and_a_waking_one_s_are_on_it() {
    let put_on = |irq: u32, cpus: &str, device: &CardDevice, events: bool| {
        let tree = installed();
        put(tree.path(), &format!("proc/irq/{irq}/effective_affinity_list"), cpus);
        let findings = find(tree.path(), device, events);
        findings.into_iter().find(|f| f.name == "card_irq").unwrap()
    };
    let pci = CardDevice::Bar(PciFunctionSelector::Address("0000:00:04.0".into()), 2);
    let gpio = CardDevice::Gpio("gpiochip0".into());
    assert!(put_on(20, "0\n", &CardDevice::Uio("uio0".into()), false).ok);
    let here = put_on(11, "0-1\n", &pci, false);
    assert_eq!((here.ok, here.got.as_str()), (false, "11 on CPU 0,1"));
    assert!(here.remedy.contains("echo 0 > ") && here.remedy.ends_with("11"), "{}", here.remedy);
    assert!(put_on(30, "1\n", &gpio, true).ok);
    let elsewhere = put_on(30, "0\n", &gpio, true);
    assert!(!elsewhere.ok && elsewhere.remedy.contains("echo 1 > "), "{elsewhere:?}");
}

#[test]
fn the_lines_of_a_card_that_wakes_the_thread_are_no_strangers_on_its_cpu() {
    let tree = installed();
    put(tree.path(), "proc/irq/30/effective_affinity_list", "1\n");
    assert!(SystemRoot::at(tree.path()).inspect(1, 80).finding("irq_affinity").unwrap().ok);
    put(tree.path(), "proc/irq/20/effective_affinity_list", "1\n");
    assert_eq!(
        SystemRoot::at(tree.path()).inspect(1, 80).finding("irq_affinity").unwrap().got,
        "1: 20 my-card"
    );
}

#[test]
fn io_ports_need_the_addition_to_the_service() {
    let tree = installed();
    let device = CardDevice::Ports(None);
    assert_eq!(not_ok(&find(tree.path(), &device, false)), ["io_ports"]);
    let addition = include_str!("../../../udev/drop-ins/port.conf");
    put(tree.path(), "etc/systemd/system/rtecd.service.d/port.conf", addition);
    assert_eq!(not_ok(&find(tree.path(), &device, false)), Vec::<&str>::new());
}

#[test]
fn who_may_speak_to_the_daemon() {
    let tree = installed();
    put(tree.path(), "proc/self/status", "Uid:\t7\t7\t7\t7\nGid:\t7\t7\t7\t7\nGroups:\t\n");
    let none: [CardDevice; 0] = [];
    let findings = |root| card(&SystemRoot::at(root), &none, false, 1);
    // Where root runs the test, the tree's user has group 0. So group 7 is never the right one.
    assert_eq!(not_ok(&findings(tree.path())), ["group"]);
    put(tree.path(), "proc/self/status", "Uid:\t7\t0\t0\t0\nGroups:\t\n");
    assert_eq!(not_ok(&findings(tree.path())), Vec::<&str>::new());
    fs::remove_file(tree.path().join("etc/passwd")).unwrap();
    assert_eq!(not_ok(&findings(tree.path())), ["user"]);
}

#[test]
fn a_file_s_name_tells_what_it_is() {
    let of = |file: &str| CardDevice::of_file(Path::new(file));
    assert_eq!(of("/dev/uio1"), CardDevice::Uio("uio1".into()));
    assert_eq!(of("/dev/parport0"), CardDevice::Parport("parport0".into()));
    assert_eq!(of("/dev/gpiochip2"), CardDevice::Gpio("gpiochip2".into()));
    assert_eq!(of("/dev/shm/uio1"), CardDevice::File("/dev/shm/uio1".into()));
}
