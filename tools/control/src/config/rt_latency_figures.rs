//! The latency figures of `[rt]`.
//! Checks where they were measured, whether they are possible, and which speeds they allow.

use super::{CardConfig, Config, ConfiguredAxis, RegisterPlace, keys};
use crate::protocol::SpeedLimits;
use rtec_driver::card_profile::AddressSpace;
use rtec_files::date;
use rtec_files::toml_section_keys::{FileWithFindings, LocatedValue, TomlSection};
use rtec_rt::realtime_setup::SystemRoot;
use std::fmt;
use std::path::Path;

/// The age in days after which a figure must be measured again.
/// Disks, firmware and cards change.
const OLDEST_DAYS: i64 = 366;

/// Where and when latencies were measured: `measured` in `[rt]`.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct LatencyTestConditions {
    /// The card, as [`CardConfig::named`] names it.
    pub card: String,
    /// The kernel's release, as `uname -r` prints it.
    pub kernel: String,
    /// The processor's model, and the CPU of the real-time thread.
    pub cpu: String,
    /// The day, as 2026-11-26.
    pub date: String,
}

impl LatencyTestConditions {
    /// A measurement today on this computer with this card and CPU.
    pub fn here(card: &CardConfig, cpu: usize, system: &SystemRoot) -> Self {
        let read = |file: &str| system.read(file).unwrap_or_default();
        let info = read("proc/cpuinfo");
        let model = |key: &str| {
            let line = info.lines().find(|line| line.split(':').next().is_some_and(|k| k.trim() == key))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        };
        let model = ["model name", "Hardware", "Model", "CPU part"].into_iter().find_map(model);
        Self {
            card: card.named(),
            kernel: read("proc/sys/kernel/osrelease").trim().to_owned(),
            cpu: format!("{}, CPU {cpu}", model.unwrap_or_else(|| std::env::consts::ARCH.to_owned())),
            date: date::format(date::today()),
        }
    }

    /// Differences from this computer, if any; `today` in days since 1970-01-01.
    fn doubt(&self, here: &Self, today: i64) -> Option<String> {
        for (what, then, now) in [
            ("card", &self.card, &here.card),
            ("kernel", &self.kernel, &here.kernel),
            ("CPU", &self.cpu, &here.cpu),
        ] {
            if then != now {
                return Some(format!("with {what} \"{then}\", and this is \"{now}\""));
            }
        }
        let age_days = today - date::parse(&self.date).unwrap_or(i64::MAX / 2);
        match age_days {
            ..0 => Some(format!("on {}, which is still to come", self.date)),
            0..=OLDEST_DAYS => None,
            _ => Some(format!("on {}, more than a year ago", self.date)),
        }
    }
}

/// The form in which it is written below `[rt]`.
impl fmt::Display for LatencyTestConditions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let quoted = |text: &str| text.replace(['\\', '\u{22}'], "'");
        write!(
            f,
            "measured = {{ card = \"{}\", kernel = \"{}\", cpu = \"{}\", date = \"{}\" }}",
            quoted(&self.card),
            quoted(&self.kernel),
            quoted(&self.cpu),
            quoted(&self.date)
        )
    }
}

/// Reads `measured`.
pub(super) fn read_measured(
    source: &mut FileWithFindings<'_>,
    rt: &mut TomlSection<'_>,
) -> Option<LatencyTestConditions> {
    if !rt.has("measured") {
        return None;
    }
    let mut table = rt.table(source, "measured", "measured").with(keys::MEASURED);
    let [card, kernel, cpu, day] = ["card", "kernel", "cpu", "date"].map(|key| table.text(source, key));
    table.finish(source);
    if let Some(at) = day.as_ref().filter(|at| date::parse(at.value).is_none()) {
        source.finding(at.offset, format!("date = \"{}\"", at.value), "a day, as \"2026-11-26\"");
    }
    let text = |at: Option<LocatedValue<&str>>| Some(at?.value.to_owned());
    Some(LatencyTestConditions {
        card: text(card)?,
        kernel: text(kernel)?,
        cpu: text(cpu)?,
        date: text(day)?,
    })
}

/// Lowest possible `detect_ns` and `write_ns` on such a card, ns, with the reason.
/// None for a simulated card.
pub fn floors_ns(card: &CardConfig) -> Option<(u64, u64, &'static str)> {
    Some(match card {
        CardConfig::Mock | CardConfig::Replay { .. } => return None,
        CardConfig::Gpio(_) => (1000, 500, "a system call or an interrupt takes longer"),
        CardConfig::Registers { place, .. } => match place {
            RegisterPlace::File(file) if !file.starts_with("/sys") => {
                (20, 1, "two reads of memory take longer")
            }
            RegisterPlace::Parport(_) => (2000, 1000, "two system calls with an I/O port each take longer"),
            place if place.space() == AddressSpace::Io => (1000, 400, "two reads of an I/O port take longer"),
            _ => (800, 200, "two reads over a PCI bus take longer"),
        },
    })
}

/// Refuses figures that no such card can reach; they were copied wrongly.
pub(super) fn check_floors(
    source: &mut FileWithFindings<'_>,
    card: &CardConfig,
    detect_ns: Option<LocatedValue<i64>>,
    write_ns: Option<LocatedValue<i64>>,
) {
    let Some((least_detect, least_write, why)) = floors_ns(card) else { return };
    for (key, at, least) in [("detect_ns", detect_ns, least_detect), ("write_ns", write_ns, least_write)] {
        if let Some(at) = at.filter(|at| (at.value as u64) < least) {
            let found = format!("{key} = {} on a card of backend \"{}\"", at.value, card.backend());
            let expected =
                format!("{least} ns or more, as `rtecctl selftest latency --config FILE` measures it: {why}");
            source.finding(at.offset, found, expected);
        }
    }
}

impl CardConfig {
    /// The card in words: its backend, its place and its profile.
    pub fn named(&self) -> String {
        match self {
            Self::Mock | Self::Replay { .. } => self.backend().to_owned(),
            Self::Gpio(setup) => {
                let lines = setup.inputs.iter().map(|i| &i.line).chain(setup.outputs.iter().map(|o| &o.line));
                let mut chips: Vec<_> = lines.map(|l| l.chip.as_deref().unwrap_or("any chip")).collect();
                chips.sort_unstable();
                chips.dedup();
                let mode = if setup.events { "edges" } else { "levels" };
                format!("gpio {}, {mode}", chips.join(" and "))
            }
            Self::Registers { place, profile } => format!("{} {place}, {}", self.backend(), profile.name),
        }
    }
}

impl ConfiguredAxis {
    /// Edge rate at a speed of `mm_min`, Hz.
    pub fn hz(&self, mm_min: f64) -> f64 {
        mm_min / 60.0 * 1000.0 / self.count_um
    }

    /// Speed at which the scale gives this edge rate, mm/min.
    pub fn mm_min(&self, hz: f64) -> f64 {
        hz * 60.0 * self.count_um / 1000.0
    }

    /// The highest edge rate that can be followed, Hz.
    /// No two edges may come within the longest time between two looks, even if the axis accelerates. `None` if
    /// nothing limits it: a card with its own counters, or a simulated one.
    pub fn followed_hz(&self) -> Option<f64> {
        let looks_s = self.engine.detect_ns as f64 * 1e-9;
        let limited = !self.counted && looks_s > 0.0;
        limited.then(|| (1.0 / looks_s - self.engine.max_accel_counts_s2 * looks_s / 2.0).max(0.0))
    }

    /// The highest edge rate at which an insertion still has time, Hz.
    /// None if there is no such rate.
    pub fn corrected_hz(&self) -> Option<f64> {
        self.engine.gate().map(|gate| 1e9 / gate.min_period_ns() as f64)
    }

    /// The axis's speeds: rapid, followed and corrected.
    pub fn rates(&self) -> SpeedLimits {
        SpeedLimits {
            rapid_mm_min: self.rapid_mm_min,
            followed_mm_min: self.followed_hz().map(|hz| self.mm_min(hz)),
            corrected_mm_min: self.corrected_hz().map(|hz| self.mm_min(hz)),
        }
    }

    /// A sentence with the figures if the rapid is too fast for the card's looks.
    pub fn outruns(&self) -> Option<String> {
        let (rapid, followed) = (self.rapid_mm_min?, self.mm_min(self.followed_hz()?));
        (rapid > followed).then(|| {
            format!(
                "axis {}: rapid_mm_min = {rapid} is {:.0} edges/s, and with detect_ns = {} the card is followed up to \
                 {followed:.1} mm/min: a quicker card or computer, or a slower rapid",
                self.name,
                self.hz(rapid),
                self.engine.detect_ns
            )
        })
    }
}

impl Config {
    /// Reasons why corrections may not be enabled here, each with its remedy.
    /// Reasons are latencies not measured here, or an axis too fast for the card. A card that drives no machine needs
    /// neither.
    pub fn unfit(&self, here: &LatencyTestConditions) -> Vec<String> {
        self.unfit_on(here, date::today())
    }

    fn unfit_on(&self, here: &LatencyTestConditions, today: i64) -> Vec<String> {
        if !self.card.is_real() {
            return Vec::new();
        }
        let mut unfit = Vec::new();
        let remedy = "run `rtecctl selftest latency --drive --config FILE` and put its lines into [rt]";
        if !self.rt.latency_measured {
            unfit.push(format!("[rt] has no detect_ns and write_ns: {remedy}"));
        } else if let Some(measured) = &self.rt.measured {
            let doubt = measured.doubt(here, today);
            unfit.extend(doubt.map(|why| format!("[rt] was measured {why}: {remedy}")));
        } else {
            unfit.push(format!("[rt] does not say where its figures were measured: {remedy}"));
        }
        for axis in &self.axes {
            match axis.rapid_mm_min {
                Some(_) => unfit.extend(axis.outruns()),
                None => unfit.push(format!(
                    "axis {}: rapid_mm_min is not set, so nobody knows whether the card follows it: set the axis's rapid",
                    axis.name
                )),
            }
        }
        unfit
    }
}

/// Checks that the CPU named in `[rt]` exists.
pub(super) fn check_cpu(source: &mut FileWithFindings<'_>, cpu: Option<LocatedValue<i64>>) {
    let Some(at) = cpu else { return };
    let text = SystemRoot::at(Path::new("/")).read("sys/devices/system/cpu/online").unwrap_or_default();
    let online = rtec_rt::realtime_setup::cpu_list(&text);
    if !online.is_empty() && !online.contains(&(at.value as usize)) {
        let found = format!("cpu = {}, which this computer does not have", at.value);
        source.finding(
            at.offset,
            found,
            format!("one of its CPUs, {}; for another computer: --elsewhere", text.trim()),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "[machine]\nname = 'm'\n[card]\nbackend = 'mapped'\nuio = '/dev/uio0'\n[[axis]]\nname = 'x'\ncount_um = 0.1\n\
         travel_mm = 400\nmax_correction_counts = 100\nwindow_counts = 50\nmin_separation_ns = 100\nmax_accel_mm_s2 = 100\n\
         RAPIDlines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }\n[rt]\nRT";

    fn config(rapid: &str, rt: &str) -> Config {
        let text = TEXT.replace("RAPID", rapid).replace("RT", rt);
        Config::parse(Path::new("rtec.toml"), &text).unwrap()
    }

    fn here() -> LatencyTestConditions {
        let [card, kernel, cpu, date] =
            ["mapped /dev/uio0 map 0, shared-memory test card", "6.12.9-rt", "EPYC, CPU 3", "2026-11-26"]
                .map(str::to_owned);
        LatencyTestConditions { card, kernel, cpu, date }
    }

    /// Reasons against enabling corrections, with figures measured here.
    fn unfit(rapid: &str, measured: &LatencyTestConditions) -> Vec<String> {
        let rt = format!("detect_ns = 1000\nwrite_ns = 300\n{measured}\n");
        config(rapid, &rt).unfit_on(&here(), date::parse("2026-11-26").unwrap())
    }

    const SLOW: &str = "rapid_mm_min = 5000\n";

    #[test]
    fn figures_of_this_card_and_computer_may_arm() {
        assert_eq!(unfit(SLOW, &here()), Vec::<String>::new());
        let year_old = LatencyTestConditions { date: "2025-11-25".to_owned(), ..here() };
        assert_eq!(unfit(SLOW, &year_old), Vec::<String>::new());
    }

    #[test]
    fn refuses_figures_from_elsewhere_and_from_long_ago() {
        let other = "other".to_owned();
        for (measured, says) in [
            (LatencyTestConditions { card: other.clone(), ..here() }, "card \"other\""),
            (
                LatencyTestConditions { kernel: other.clone(), ..here() },
                "kernel \"other\", and this is \"6.12.9-rt\"",
            ),
            (LatencyTestConditions { cpu: other, ..here() }, "CPU \"other\""),
            (LatencyTestConditions { date: "2026-11-27".to_owned(), ..here() }, "still to come"),
            (LatencyTestConditions { date: "2025-11-24".to_owned(), ..here() }, "more than a year ago"),
        ] {
            let unfit = unfit(SLOW, &measured);
            assert!(
                unfit.len() == 1 && unfit[0].contains(says) && unfit[0].contains("selftest"),
                "{unfit:?}"
            );
        }
        for (rt, says) in
            [("", "has no detect_ns"), ("detect_ns = 1000\nwrite_ns = 300\n", "does not say where")]
        {
            let unfit = config(SLOW, rt).unfit(&here());
            assert!(unfit[0].contains(says), "{unfit:?}");
        }
    }

    /// Each 1000 ns a look, 0.1 µm a count: 10⁶ edges/s, 6000 mm/min.
    #[test]
    fn refuses_a_rapid_that_outruns_the_card() {
        let figures = here();
        assert!(unfit("rapid_mm_min = 5999\n", &figures).is_empty());
        let outrun = unfit("rapid_mm_min = 30000\n", &figures);
        assert!(
            outrun[0].contains("5000000 edges/s") && outrun[0].contains("up to 6000.0 mm/min"),
            "{outrun:?}"
        );
        assert!(unfit("", &figures)[0].contains("rapid_mm_min is not set"));
    }

    #[test]
    fn what_a_self_test_prints_reads_back() {
        let measured = LatencyTestConditions { card: "a \"b\" \\c".to_owned(), ..here() };
        let rt = format!("detect_ns = 1000\nwrite_ns = 300\n{measured}\n");
        assert_eq!(config("", &rt).rt.measured.unwrap().card, "a 'b' 'c");
    }

    #[test]
    fn every_real_card_has_a_floor_below_which_nothing_is_believed() {
        let lines = "lines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }";
        let gpio = "lines = { a = 'A', b = 'B', invert_a = 'C', invert_b = 'D' }";
        let port = "lines = { a = 0, b = 1, invert_a = 0, invert_b = 1 }";
        for (backend, place, lines) in [
            ("mapped", "uio = '/dev/uio0'", lines),
            ("mapped", "pci = '1af4:1110'\nbar = 2", lines),
            ("mapped", "file = '/sys/bus/pci/devices/0000:00:04.0/resource2'", lines),
            ("mapped", "file = 'registers'", lines),
            ("port", "parport = '/dev/parport0'", port),
            ("port", "io = 0x378", port),
            ("gpio", "chip = 'gpiochip0'", gpio),
        ] {
            let text = TEXT
                .replace("backend = 'mapped'\nuio = '/dev/uio0'", &format!("backend = '{backend}'\n{place}"))
                .replace(
                    "RAPIDlines = { a = 'in0', b = 'in1', invert_a = 'out0', invert_b = 'out1' }",
                    lines,
                );
            let of = |detect_ns: u64, write_ns: u64| {
                let rt = format!("detect_ns = {detect_ns}\nwrite_ns = {write_ns}\n");
                Config::parse(Path::new("rtec.toml"), &text.replace("RT", &rt))
            };
            let (detect_ns, write_ns, _) = floors_ns(&of(100_000, 100_000).unwrap().card).unwrap();
            assert!(of(detect_ns, write_ns).is_ok(), "{place}");
            for (detect, write, key) in
                [(detect_ns - 1, write_ns, "detect_ns"), (detect_ns, write_ns - 1, "write_ns")]
            {
                let found = of(detect, write).unwrap_err().to_string();
                assert!(
                    found.contains(key) && found.contains("takes longer") | found.contains("take longer"),
                    "{found}"
                );
            }
        }
        assert!(floors_ns(&CardConfig::Mock).is_none());
    }
}
