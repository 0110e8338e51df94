//! Permissions and interrupts that a card's devices need.
//! The daemon's user must be able to open them, and their interrupts must land on the right CPU. It reads
//! `/etc/passwd`, `/etc/group`, `/dev`, `/proc/irq` and `/sys`, and changes nothing.
//!
//! | finding | wanted |
//! |---|---|
//! | user | the user `rtec` |
//! | group | the caller may speak to the daemon: root, or in the group `rtec` |
//! | `card_access` | per device: the user `rtec` may read and write it |
//! | `io_ports` | `CAP_SYS_RAWIO` in the service, where I/O ports are used |
//! | `card_irq` | on the real-time CPU for a card that wakes the thread, elsewhere for one that is polled |

use rtec_driver::pci::{PciFunction, PciFunctionSelector};
use rtec_rt::realtime_setup::{OsError, SetupFinding, SystemRoot, cpu_list};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The daemon's user, and the group whose members may connect to it.
const USER: &str = "rtec";
/// The group of the devices, whose only member is the daemon's user.
const DEVICES: &str = "rtec-dev";
/// Folder of drop-ins: additions to the service's unit file.
const DROP_INS: &str = "etc/systemd/system/rtecd.service.d";

/// A device that a card's backend opens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CardDevice {
    /// A GPIO chip, by the name of its character device.
    Gpio(String),
    /// A UIO device, by the name of its character device.
    Uio(String),
    /// A parallel port, by the name of its character device.
    Parport(String),
    /// A memory BAR of a PCI card.
    Bar(PciFunctionSelector, u8),
    /// x86 I/O ports, of a PCI card or at fixed addresses.
    Ports(Option<PciFunctionSelector>),
    /// A file that is no device: shared memory, a resource in sysfs.
    File(PathBuf),
}

impl CardDevice {
    /// The device behind a file's name.
    pub fn of_file(file: &Path) -> Self {
        let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let of = |prefix| file.parent() == Some(Path::new("/dev")) && name.starts_with(prefix);
        match () {
            () if of("gpiochip") => Self::Gpio(name),
            () if of("uio") => Self::Uio(name),
            () if of("parport") => Self::Parport(name),
            () => Self::File(file.to_owned()),
        }
    }
}

/// A user in `/etc/passwd` and `/etc/group`.
struct PasswdUser {
    uid: u32,
    gids: Vec<u32>,
}

/// The findings about a card with these devices.
/// With `events`, interrupts of the card wake the real-time thread on `cpu`.
pub fn card(system: &SystemRoot, devices: &[CardDevice], events: bool, cpu: usize) -> Vec<SetupFinding> {
    let tree = PermissionAndIrqFiles { system };
    let user = tree.user(USER);
    let uid = user.as_ref().map_or("none".to_owned(), |user| format!("uid {}", user.uid));
    let mut findings = vec![
        SetupFinding::new("user", format!("a user {USER}"), uid, user.is_some())
            .remedy("install the package, or: systemd-sysusers udev/rtec.sysusers"),
        tree.group(),
    ];
    findings.extend(devices.iter().map(|device| match device {
        CardDevice::Ports(_) => tree.io_ports(),
        other => tree.card_access(other, user.as_ref()),
    }));
    if !devices.is_empty() {
        findings.push(tree.card_irq(devices, events, cpu));
    }
    findings
}

/// The system's files about permissions and interrupts.
struct PermissionAndIrqFiles<'a> {
    system: &'a SystemRoot,
}

impl PermissionAndIrqFiles<'_> {
    /// The lines of `/etc/passwd` or `/etc/group`, with their fields.
    fn table(&self, name: &str) -> Vec<Vec<String>> {
        let text = self.system.read(format!("etc/{name}")).unwrap_or_default();
        text.lines().map(|line| line.split(':').map(str::to_owned).collect()).collect()
    }

    fn user(&self, name: &str) -> Option<PasswdUser> {
        let entry = self.table("passwd").into_iter().find(|f| f[0] == name)?;
        let mut gids = vec![entry.get(3)?.parse().ok()?];
        for line in self.table("group") {
            let member = line.get(3).is_some_and(|members| members.split(',').any(|m| m == name));
            gids.extend(line.get(2).filter(|_| member).and_then(|gid| gid.parse::<u32>().ok()));
        }
        Some(PasswdUser { uid: entry.get(2)?.parse().ok()?, gids })
    }

    /// Whether the caller may connect to the daemon.
    fn group(&self) -> SetupFinding {
        let wanted = format!("root, or in the group {USER}");
        let remedy = format!("usermod -aG {USER} YOU, and log in again");
        let mut own = self.table("group").into_iter().filter(|f| f[0] == USER);
        let gid = own.find_map(|f| f.get(2)?.parse::<u32>().ok());
        let status = match self.system.read("proc/self/status") {
            Ok(text) => text,
            Err(error) => return SetupFinding::unknown("group", wanted, error).remedy(remedy),
        };
        let numbers = |key: &str| -> Vec<u32> {
            let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
            line.split_whitespace().filter_map(|n| n.parse().ok()).collect()
        };
        let (uid, mut groups) = (numbers("Uid:"), numbers("Groups:"));
        groups.extend(numbers("Gid:"));
        let (got, ok) = match gid {
            _ if uid.get(1) == Some(&0) => ("root", true),
            None => ("no such group", false),
            Some(gid) if groups.contains(&gid) => ("in the group", true),
            Some(_) => ("neither", false),
        };
        SetupFinding::new("group", wanted, got, ok).remedy(remedy)
    }

    /// Whether the daemon's user may read and write the device.
    fn card_access(&self, device: &CardDevice, user: Option<&PasswdUser>) -> SetupFinding {
        let found = self.place(device);
        let (file, line, missing) = match &found {
            Ok(place) => place,
            Err(id) => {
                return SetupFinding::new("card_access", format!("PCI card {id}"), "not on the bus", false)
                    .needed()
                    .remedy("is it plugged in? `lspci -n` lists what is");
            }
        };
        let wanted = format!("{USER} may use /{}", file.display());
        let remedy = match line {
            Some(line) => format!(
                "put `{line}` into /etc/rtec/devices, then: udevadm trigger -s gpio -s pci -s uio -s ppdev"
            ),
            None => format!("chgrp {DEVICES} /{} && chmod g+rw /{0}", file.display()),
        };
        match std::fs::metadata(self.system.path(file)) {
            Ok(found) => {
                let (uid, gid, mode) = (found.uid(), found.gid(), found.mode() & 0o777);
                let bits = match user {
                    Some(user) if user.uid == uid => mode >> 6,
                    Some(user) if user.gids.contains(&gid) => mode >> 3,
                    _ => mode,
                };
                let got =
                    format!("{}:{} {mode:04o}", self.name_of("passwd", uid), self.name_of("group", gid));
                SetupFinding::new("card_access", wanted, got, bits & 0o6 == 0o6)
            }
            Err(e) => {
                let error = OsError::of(format!("stat /{}", file.display()), &e);
                let finding = SetupFinding::unknown("card_access", wanted, error);
                return finding
                    .needed()
                    .remedy(missing.map_or("no such file".into(), |d| format!("no such device: {d}")));
            }
        }
        .needed()
        .remedy(remedy)
    }

    /// The device's file below the root, its line in `/etc/rtec/devices`, and a remedy.
    /// The remedy applies where the file is missing.
    fn place(
        &self,
        device: &CardDevice,
    ) -> Result<(PathBuf, Option<String>, Option<&'static str>), PciFunctionSelector> {
        let dev = |name: &String| Path::new("dev").join(name);
        Ok(match device {
            CardDevice::Gpio(name) => {
                // The directory of the device that has the chip, `…/fe200000.gpio/gpiochip0`.
                let parent = self.parents(&format!("sys/bus/gpio/devices/{name}")).next();
                let owner = parent.and_then(|p| Some(format!("gpio {}", p.file_name()?.to_string_lossy())));
                (dev(name), owner, Some("`ls /dev/gpiochip*` lists the chips"))
            }
            CardDevice::Uio(name) => {
                let known = self.system.read(format!("sys/class/uio/{name}/name")).ok();
                (dev(name), known.map(|n| format!("uio {n}")), Some("load uio and the card's driver"))
            }
            CardDevice::Parport(name) => {
                (dev(name), Some(format!("parport {name}")), Some("modprobe -a parport_pc ppdev"))
            }
            CardDevice::Bar(id, bar) => {
                let card = self.function(id).ok_or_else(|| id.clone())?;
                let file = format!("sys/bus/pci/devices/{}/resource{bar}", card.address);
                (PathBuf::from(file), Some(format!("pci {id}")), None)
            }
            CardDevice::Ports(_) => (PathBuf::from("dev/port"), None, None), // the same ports as a file
            CardDevice::File(file) => (file.strip_prefix("/").unwrap_or(file).to_owned(), None, None),
        })
    }

    fn function(&self, id: &PciFunctionSelector) -> Option<PciFunction> {
        rtec_driver::pci::find_in(&self.system.path("sys/bus/pci/devices"), id).ok()
    }

    /// The parent directories of a device in sysfs, nearest first.
    fn parents(&self, path: &str) -> impl Iterator<Item = PathBuf> {
        let device = std::fs::canonicalize(self.system.path(path)).ok();
        let top = std::fs::canonicalize(self.system.path("sys/devices")).unwrap_or_default();
        let all: Vec<_> = device.iter().flat_map(|d| d.ancestors().skip(1)).map(Path::to_owned).collect();
        all.into_iter().take_while(move |p| *p != top && p.starts_with(&top))
    }

    /// The name of a number in `/etc/passwd` or `/etc/group`, else the number.
    fn name_of(&self, table: &str, id: u32) -> String {
        let is = |f: &Vec<String>| f.get(2).is_some_and(|number| number.parse() == Ok(id));
        self.table(table).into_iter().find(is).map_or_else(|| id.to_string(), |mut f| f.swap_remove(0))
    }

    fn io_ports(&self) -> SetupFinding {
        let files = entries_of(&self.system.path(DROP_INS));
        let given = files.filter(|f| f.extension().is_some_and(|x| x == "conf")).any(|file| {
            let text = std::fs::read_to_string(file).unwrap_or_default();
            text.lines()
                .any(|line| line.starts_with("AmbientCapabilities=") && line.contains("CAP_SYS_RAWIO"))
        });
        SetupFinding::new(
            "io_ports",
            "CAP_SYS_RAWIO in the service",
            if given { "there" } else { "not there" },
            given,
        )
        .needed()
        .remedy(format!(
            "install -Dm 644 -t /{DROP_INS} /usr/share/rtec/port.conf && systemctl daemon-reload"
        ))
    }

    /// Whether the card's interrupts land on the right CPUs.
    fn card_irq(&self, devices: &[CardDevice], events: bool, cpu: usize) -> SetupFinding {
        let wanted = format!("{} CPU {cpu}", if events { "on" } else { "not on" });
        let mut numbers: Vec<u32> = devices.iter().flat_map(|device| self.interrupts(device)).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let lists: Vec<(u32, Vec<usize>)> =
            numbers.iter().filter_map(|n| Some((*n, cpu_list(&self.system.irq_cpus(*n)?)))).collect();
        let right = |cpus: &[usize]| if events { cpus == [cpu] } else { !cpus.contains(&cpu) };
        let shown = lists.iter().map(|(n, cpus)| {
            let cpus: Vec<_> = cpus.iter().map(usize::to_string).collect();
            format!("{n} on CPU {}", cpus.join(","))
        });
        let got = if lists.is_empty() { "none".to_owned() } else { shown.collect::<Vec<_>>().join(", ") };
        let ok = lists.iter().all(|(_, cpus)| right(cpus)) && !(events && lists.is_empty());
        let wrong: Vec<_> =
            lists.iter().filter(|(_, cpus)| !right(cpus)).map(|(n, _)| n.to_string()).collect();
        let target = if events { cpu.to_string() } else { self.system.housekeeping(cpu) };
        SetupFinding::new("card_irq", wanted, got, ok).remedy(if wrong.is_empty() {
            "shown while rtecd runs; a chip whose lines share another interrupt has it in /proc/interrupts"
                .into()
        } else {
            format!("echo {target} > /proc/irq/N/smp_affinity_list, N = {}", wrong.join(", "))
        })
    }

    fn interrupts(&self, device: &CardDevice) -> Vec<u32> {
        match device {
            // The lines that the daemon requested are interrupts under its name.
            CardDevice::Gpio(name) => {
                let mut all = self.irqs_of("rtec");
                if let Some(parent) = self.parents(&format!("sys/bus/gpio/devices/{name}")).next() {
                    all.extend(self.pci_interrupts(&parent));
                }
                all
            }
            CardDevice::Uio(name) => {
                let named = self.system.read(format!("sys/class/uio/{name}/name"));
                named.map(|n| self.irqs_of(&n)).unwrap_or_default()
            }
            CardDevice::Parport(name) => self.irqs_of(name),
            CardDevice::Bar(id, _) | CardDevice::Ports(Some(id)) => {
                let card = self.function(id).map(|f| self.system.path("sys/bus/pci/devices").join(f.address));
                card.map(|directory| self.pci_interrupts(&directory)).unwrap_or_default()
            }
            CardDevice::Ports(None) | CardDevice::File(_) => Vec::new(),
        }
    }

    /// Interrupts with a handler of that name.
    fn irqs_of(&self, action: &str) -> Vec<u32> {
        numbers_in(&self.system.path("proc/irq"), |entry| entry.join(action).is_dir())
    }

    /// The interrupts of a PCI function with a handler: its messages, or else its line.
    fn pci_interrupts(&self, directory: &Path) -> Vec<u32> {
        let line = std::fs::read_to_string(directory.join("irq")).ok();
        let mut numbers = numbers_in(&directory.join("msi_irqs"), |_| true);
        if numbers.is_empty() {
            numbers.extend(line.and_then(|text| text.trim().parse::<u32>().ok()));
        }
        numbers.retain(|n| {
            let entries = entries_of(&self.system.path(format!("proc/irq/{n}")));
            entries.into_iter().any(|entry| entry.is_dir())
        });
        numbers
    }
}

fn entries_of(directory: &Path) -> impl Iterator<Item = PathBuf> + use<> {
    std::fs::read_dir(directory).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// The entries of a directory that are numbers, of those that `is` selects.
fn numbers_in(directory: &Path, is: impl Fn(&Path) -> bool) -> Vec<u32> {
    let selected = entries_of(directory).filter(|entry| is(entry));
    selected.filter_map(|entry| entry.file_name()?.to_str()?.parse().ok()).collect()
}
