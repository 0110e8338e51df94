//! Timing models of computers: the time from an edge to a change of the outputs.

use crate::noise::NoiseGenerator;
use rtec_files::InputError;
use rtec_rt::axis::AxisConfig;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A computer that corrects one axis. All times in ns.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ComputerTiming {
    /// The hardware, in words.
    pub name: String,
    /// Time from recognising an edge to the first possible change of an output, ns.
    pub react_ns: u64,
    /// Shortest time between two changes of its outputs, ns.
    pub step_ns: u64,
    /// Time after the last change until it is free again, ns.
    pub after_ns: u64,
    /// Time of a loop that reads A and B and writes A' and B' (Design B), ns.
    pub pass_ns: u64,
    /// Times between two polls while it waits: cumulative share and ns.
    /// Empty if an edge is recognised at once; the reaction time then includes everything.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub looks: Vec<(f64, u64)>,
    /// Worst time from a write to the change of the output, ns.
    pub write_ns: u64,
}

/// Quantile of a measured distribution that counts as the worst case.
/// Later values are rarer than any test can show.
const TAIL: f64 = 0.9999;

impl ComputerTiming {
    /// The 8051 family at 12 MHz.
    /// It takes 4 µs from recognising "A&B low" until a pulse can be added. Pulses are 2 µs wide and overlap
    /// by half (3 µs for the pair), with 2 µs after them (NISTIR 4832, The "Original RTEC"). A pass of Design
    /// B is some ten instructions of one microsecond.
    pub fn i8051() -> Self {
        Self {
            name: "8051, 12 MHz".into(),
            react_ns: 4000,
            step_ns: 1000,
            after_ns: 2000,
            pass_ns: 10_000,
            ..Self::default()
        }
    }

    /// A digital signal processor of 1992, ten times as fast as the 8051.
    /// (NISTIR 4832, Design B) It runs at 20 MHz, with 100 ns an instruction and byte-wide I/O that needs
    /// masking. Steps are as long as a 1 MHz decoder needs.
    pub fn dsp() -> Self {
        Self {
            name: "DSP, 100 ns an instruction".into(),
            react_ns: 500,
            step_ns: 500,
            after_ns: 500,
            pass_ns: 1000,
            ..Self::default()
        }
    }

    /// A PC that polls, with the measured distribution of the time between two polls.
    /// `rtecctl selftest latency --json` on that PC gives it (`poll_gap_ns`).
    ///
    /// # Errors
    /// The file cannot be read, or is not such a document.
    pub fn measured(file: &Path) -> Result<Self, InputError> {
        #[derive(Deserialize)]
        struct LatencySelftestJson {
            poll_gap_ns: PollGapHistogram,
        }
        #[derive(Deserialize)]
        struct PollGapHistogram {
            histogram: Vec<(u64, u64, u64)>,
        }
        let expected = "the JSON of `rtecctl selftest latency --json`";
        let text = std::fs::read_to_string(file)
            .map_err(|e| InputError::whole(file, format!("error `{e}`"), "a file that can be read"))?;
        let document: LatencySelftestJson = serde_json::from_str(&text)
            .map_err(|e| InputError::at(file, e.line(), e.column(), e.to_string(), expected))?;
        let buckets = document.poll_gap_ns.histogram;
        let samples: u64 = buckets.iter().map(|b| b.2).sum();
        if samples == 0 || buckets.windows(2).any(|w| w[1].0 < w[0].0) {
            return Err(InputError::whole(file, "an empty or unordered histogram in poll_gap_ns", expected));
        }
        let mut below = 0;
        let looks: Vec<(f64, u64)> = buckets
            .iter()
            .map(|&(_, high, count)| {
                below += count;
                (below as f64 / samples as f64, high.max(1))
            })
            .collect();
        let worst = at_share(&looks, TAIL);
        Ok(Self {
            name: format!("PC, measured ({samples} looks, {TAIL} of them within {worst} ns)"),
            react_ns: 2 * worst,
            step_ns: 500,
            after_ns: 500,
            pass_ns: worst,
            looks,
            write_ns: worst,
        })
    }

    /// The time until the next poll, ns.
    pub(crate) fn next_look_ns(&self, noise: &mut NoiseGenerator) -> u64 {
        at_share(&self.looks, noise.uniform())
    }

    /// Worst time until the next poll, ns.
    pub fn worst_look_ns(&self) -> u64 {
        at_share(&self.looks, TAIL)
    }

    /// An axis's configuration with this computer's times for the speed gate.
    pub fn configure(&self, config: AxisConfig) -> AxisConfig {
        AxisConfig {
            min_separation_ns: self.step_ns,
            detect_ns: self.worst_look_ns() + self.react_ns.saturating_sub(self.step_ns),
            write_ns: 2 * self.worst_look_ns(),
            guard_ns: self.after_ns.saturating_sub(self.step_ns),
            ..config
        }
    }
}

fn at_share(looks: &[(f64, u64)], share: f64) -> u64 {
    let at = looks.partition_point(|l| l.0 < share).min(looks.len().saturating_sub(1));
    looks.get(at).map_or(0, |l| l.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// NISTIR 4832, The "Original RTEC": "a total of 9 µs".
    #[test]
    fn the_8051_needs_nine_microseconds() {
        let computer = ComputerTiming::i8051();
        let config = computer.configure(AxisConfig::default());
        assert_eq!(crate::full_cycle_insertion::gate(&config).unwrap().need_ns(), 9000);
        // Design C: two inversions instead of four.
        assert_eq!(config.gate().unwrap().need_ns(), 7000);
    }

    #[test]
    fn a_measured_histogram_gives_its_tail() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("latency.json");
        let looks = "[[40,41,99990],[80,81,9],[5000,5119,1]]";
        std::fs::write(&file, format!("{{\"poll_gap_ns\":{{\"histogram\":{looks}}},\"verdict\":\"pass\"}}"))
            .unwrap();
        let computer = ComputerTiming::measured(&file).unwrap();
        assert_eq!(computer.worst_look_ns(), 41);
        let mut noise = NoiseGenerator::new(1, 0);
        assert!((0..1000).all(|_| computer.next_look_ns(&mut noise) <= 5119));
        std::fs::write(&file, "{\"poll_gap_ns\":{\"histogram\":[]}}").unwrap();
        assert!(ComputerTiming::measured(&file).unwrap_err().to_string().contains("empty"));
        std::fs::write(&file, "{\n\"poll\":1}").unwrap();
        assert_eq!(ComputerTiming::measured(&file).unwrap_err().line, 2);
    }
}
