//! The table of record: the figures that README and guide quote.
//!
//! It has the required value of each figure of the main suite, its newest run on seeds never run before, and every
//! other quoted figure. `rtec-blind` judges by it, and a test compares the pages with it. A newer run goes in here
//! first.

/// The command of the newest run.
pub const COMMAND: &str = "rtec-blind --bare --from 129000000";
/// Number of its cases.
pub const CASES: usize = 482;

/// One figure: a share of cases, in percent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The share, as `rtec-blind` prints it.
    pub what: &'static str,
    /// The required value, %.
    pub asked: f64,
    /// Whether the requirement is a minimum; otherwise it is a maximum.
    pub at_least: bool,
    /// Cases that count, and all cases, of the newest run.
    pub newest: (usize, usize),
}

/// One effect hidden at twice the noise or more: named rightly.
pub const ONE_CLEAR: Figure = at_least("right, effect/noise >= 2", 98.0, (135, 136));
/// One effect hidden at 0.7 to 10 times the noise: named rightly.
pub const ONE: Figure = at_least("right, 0.7 to 10", 97.0, (230, 232));
/// One or two effects hidden: a wrong name.
pub const WRONG: Figure = at_most("wrong name", 0.5, (0, 312));
/// Nothing hidden: something found.
pub const NOTHING: Figure = at_most("cries wolf on nothing", 1.0, (0, 110));
/// A shape outside the dictionary: called unknown.
pub const UNKNOWN: Figure = at_least("shape of no dictionary called unknown", 90.0, (55, 60));
/// A shape outside the dictionary: given a name.
pub const UNKNOWN_NAMED: Figure = at_most("shape of no dictionary given a name", 5.0, (0, 60));
/// Two effects hidden, each at three times the noise or more: both named rightly.
pub const BOTH: Figure = at_least("both of two, effect/noise >= 3", 97.0, (80, 80));

const fn at_least(what: &'static str, asked: f64, newest: (usize, usize)) -> Figure {
    Figure { what, asked, at_least: true, newest }
}

const fn at_most(what: &'static str, asked: f64, newest: (usize, usize)) -> Figure {
    Figure { what, asked, at_least: false, newest }
}

/// Binomial standard error of a share of cases, %.
/// It is that of half a case more on each side, so that all of a hundred are not certain.
fn error((yes, of): (usize, usize)) -> f64 {
    let share = (yes as f64 + 0.5) / (of as f64 + 1.0);
    100.0 * (share * (1.0 - share) / of.max(1) as f64).sqrt()
}

/// Probability of at least `count` of `of` cases that each have this share.
fn at_least_so_many(count: usize, of: usize, share: f64) -> f64 {
    let mut of_exactly = (1.0 - share).powi(i32::try_from(of).unwrap_or(i32::MAX));
    let mut fewer = 0.0;
    for k in 0..count {
        fewer += of_exactly;
        of_exactly *= (of - k) as f64 / (k + 1) as f64 * share / (1.0 - share);
    }
    1.0 - fewer
}

impl Figure {
    /// Whether a share meets the requirement.
    pub fn reached(&self, (yes, of): (usize, usize)) -> bool {
        let percent = 100.0 * yes as f64 / of.max(1) as f64;
        of == 0 || if self.at_least { percent >= self.asked } else { percent <= self.asked }
    }

    /// Whether chance explains the distance of a share from the requirement.
    /// It does if the required share, taken as true, gives so few (or so many) cases at least once in a thousand times.
    pub fn within_chance(&self, (yes, of): (usize, usize)) -> bool {
        let bad = if self.at_least { of.saturating_sub(yes) } else { yes };
        let share = if self.at_least { 1.0 - self.asked / 100.0 } else { self.asked / 100.0 };
        self.reached((yes, of)) || at_least_so_many(bad, of, share) >= 1e-3
    }

    /// The newest run as the guide quotes it: `138 of 142`.
    pub fn counts(&self) -> String {
        format!("{} of {}", self.newest.0, self.newest.1)
    }

    /// The same with its share and the binomial standard error.
    /// For example `138 of 142 (97 ± 1 %)`.
    pub fn quoted(&self) -> String {
        let percent = 100.0 * self.newest.0 as f64 / self.newest.1.max(1) as f64;
        format!("{} ({percent:.0} ± {:.0} %)", self.counts(), error(self.newest))
    }

    /// The requirement as the guide quotes it: `≥ 98 %`.
    pub fn asks(&self) -> String {
        format!("{} {} %", if self.at_least { "≥" } else { "≤" }, self.asked)
    }
}

/// A figure that README and guide quote from another run.
#[derive(Debug, Clone, Copy)]
pub struct Quoted {
    /// The command, or the test's name.
    pub by: &'static str,
    /// The sample: cases, seeds, edges, minutes.
    pub on: &'static str,
    /// The figures with unit and error, as the pages quote them.
    /// For a share (`17 of 19`) the number of cases gives the error.
    pub figures: &'static [&'static str],
    /// The pages that quote all or some of these figures, and no others.
    pub pages: &'static [&'static str],
}

/// Marks a figure that a page of the guide prints and other pages quote.
pub const PRINTED: &str = "printed by one of its pages";
const README: &str = "README.md";
const FIGURES: &str = "tools/guide/contributor/figures.md";
const FIT: &str = "tools/guide/metrologist/fit.md";
const PART: &str = "tools/guide/metrologist/part.md";
const WO97: &str = "tools/guide/metrologist/wo97.md";
const SOURCES: &str = "tools/guide/contributor/sources.md";
const BUMPS: &str = "cargo test -p rtec-part --test fit";
const LOBE: &str = "cargo test -p rtec-sim --test machines lobe";
const RUN: &str = "rtecctl part run --seed 1";
const ORIGINAL: &str = "rtecctl part run --design original --seed 1";
const NISTIR4854: &str = "rtec-papers nistir4854";
const LATENCY: &str = "cargo bench --workspace --bench latency";
const EDGES: &str = "cargo bench --workspace --bench edge_rate";
const HISTORIES: &str = "RTEC_HISTORIES=1000 RTEC_SEED=4007";
const KILLS: &str = "RTEC_KILLS=1000 RTEC_SEED=2711";
const REAL: &str = "cargo test -p rtec-fit --test fits real_data";
const DRILLING: &str = "rtecctl simulate drilling";
const WARM: &str = "rtecctl simulate drilling-warm";
const TWO_STEPS: &str = "cargo test -p rtec-part --test fit two_steps";
const SELFTEST: &str = "tools/guide/integrator/latency.md";
const SHOP: &str = "tests/judges/shop.py --from 10741 --count 40";
const CLEAN: &str = "rtec-blind --bare --class null --from 124000000 --count 1000";
const ELSEWHERE: &str = "tests/judges/elsewhere.py all --count 20 --at-least";
const FITS: &str = "cargo test -p rtec-fit --test fits random_machines";
const MUTANTS: &str = "tests/mutants.py";

const fn quoted(
    by: &'static str,
    on: &'static str,
    figures: &'static [&'static str],
    pages: &'static [&'static str],
) -> Quoted {
    Quoted { by, on, figures, pages }
}

/// Every other figure that is quoted.
/// It is a share of cases, or is in README's "Figures in short".
pub const QUOTED: &[Quoted] = &[
    quoted(LATENCY, "one self-test, quiet", &["303 ns"], &[README, FIGURES]),
    quoted(EDGES, "10⁸ edges", &["628 000 counts/s"], &[README, FIGURES]),
    quoted(HISTORIES, "1000 runs", &["no count lost in silence"], &[README, FIGURES]),
    quoted(KILLS, "1000 kills", &["no jump, no illegal state"], &[README, FIGURES]),
    quoted(REAL, "2341 minutes", &["0.67 µm RMS"], &[README, FIGURES, FIT]),
    quoted(RUN, "seeds 1 to 20", &["0.9 to 1.8 µm"], &[README, PART]),
    quoted(ORIGINAL, "seeds 1 to 20", &["22.5 to 23.8 µm"], &[README, PART]),
    quoted(ORIGINAL, "seeds 1 to 20", &["2.3 to 3.2 µm", "0.82 to 0.98 µm"], &[PART]),
    quoted(RUN, "seeds 1 to 20", &["19 of the 20", "0.33 to 0.54 µm"], &[PART]),
    quoted(
        BUMPS,
        "1000 random bumps",
        &["999 of 1000", "5.75 → 1.85 µm", "19.6 → 4.2 µm", "2.2 µm"],
        &[PART],
    ),
    quoted(BUMPS, "900 sizes of white noise", &["847 of 900"], &[PART]),
    quoted(LOBE, "one lobe", &["11.3 µm"], &[PART]),
    quoted("model fit", "the mill's drift runs", &["2.9 µm"], &["tools/guide/metrologist/reconcile.md"]),
    quoted(NISTIR4854, "1000 random bumps", &["2.3 µm"], &[SOURCES]),
    quoted("rtec-papers wo97", "the example's runs", &["0.9 %", "2.5 µm", "1.5 µm"], &[SOURCES]),
    quoted("--seeds 20", "20 seeds", &["46 to 48 agree", "17 to 23 differ", "19 of 20"], &[WO97]),
    quoted(
        "cargo run --profile quick -p rtec-papers --example starts",
        "360 cases on 20 drawn machines",
        &["37 of 300", "38 of 60", "0.7 ± 0.5 %"],
        &[WO97],
    ),
    quoted(
        "--example starts -- 121 140",
        "300 cases on 20 drawn machines",
        &["37 of 300", "2 of 37", "70 of 263", "35 of 105", "193 of 195", "259 of 300"],
        &[SOURCES],
    ),
    quoted("rtecctl part run", "G01 moves", &["1.5 µm", "1.1 to 2.4 µm"], &[PART]),
    quoted("bash .ci/run controller", "a whole LinuxCNC", &["0.18 µm", "39.9", "0.1 to 2.9 µm"], &[PART]),
    quoted("part load", "an example of an answer", &["12.38 µm"], &[PART]),
    quoted(
        NISTIR4854,
        "one nose, compared by the tests of rtec-papers",
        &["0.9 µm | 21.4 µm", "10.1 µm | 2.8 µm", "0.9 µm | 2.9 µm", "1.1 µm | 3.3 µm"],
        &["tools/guide/metrologist/nistir4854.md"],
    ),
    quoted(DRILLING, PRINTED, &["83.9, 87.7, 83.5 µm", "5.0, 18.4, 8.9 µm"], &[FIGURES, WO97]),
    quoted(WARM, PRINTED, &["45.0, 31.3, 57.5 µm", "8.5, 8.2, 2.7 µm"], &[FIGURES, WO97]),
    quoted(TWO_STEPS, "1000 random bumps", &["9.1 µm off, on one side 4.2 µm"], &[SOURCES]),
    quoted("rtecctl selftest latency", "a share of all samples", &["99.99 %"], &[SELFTEST]),
    quoted(LOBE, "20 places", &["18 of 20"], &[PART]),
    quoted(FITS, "200 machines", &["0 of 66", "0 of 63"], &[FIGURES]),
    quoted("`model fit`; `reconcile`", "the real spindle", &["1170 of 2341"], &[FIGURES]),
    quoted(MUTANTS, "23 files", &["2205 of 2215", "16 of 18"], &[FIGURES]),
    quoted(CLEAN, "1000 clean cases", &["1 of 1000"], &[FIGURES]),
    quoted(
        SHOP,
        "40 cases a class",
        &["37 of 40", "38 of 40", "35 of 40", "24 of 40", "96 ± 2 %", "89 ± 2 %"],
        &[FIGURES],
    ),
    quoted(
        ELSEWHERE,
        "20 cases a class",
        &["17 of 19", "0 of 20", "20 of 20", "19 of 20", "104 of 108", "104 of 104"],
        &[FIGURES],
    ),
];
