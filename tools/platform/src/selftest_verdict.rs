//! Edge rates that the measured latency allows, and the verdict of a self-test.

use crate::far_side::MachineSideCounts;
use crate::latency_test::{CardTestExtent, LatencyTestResult};
use crate::selftest_results::{LatencyDistribution, SelftestOptions};
use rtec_control::config::{Config, ConfiguredAxis, LatencyTestConditions, floors_ns};
use rtec_control::protocol::{SpeedLimits, explain_fault, word};
use rtec_rt::axis::AxisConfig;
use rtec_rt::latency_histogram::HistogramSnapshot;
use serde::Serialize;
use std::collections::BTreeMap;

/// Edge rates of one axis under the measured latency.
#[derive(Debug)]
pub struct SafeAxisEdgeRates {
    /// Its name.
    pub name: String,
    /// Highest edge rate at which an insertion has time, by the worst delay, Hz.
    /// `None` if there is none.
    pub safe_hz: Option<f64>,
    /// The same without the worst delay in ten thousand.
    pub usual_hz: Option<f64>,
    /// The same as speeds.
    pub rates: SpeedLimits,
    /// Why its rapid is too fast for the card, if it is.
    outruns: Option<String>,
}

/// Whether this machine may correct, and how fast each axis may move.
#[derive(Debug)]
pub struct SelftestVerdict {
    /// The axes, in order.
    pub axes: Vec<SafeAxisEdgeRates>,
    /// Findings that forbid corrections; empty if it passes.
    pub reasons: Vec<String>,
}

impl SelftestVerdict {
    /// Judges a measurement for the axes of a configuration.
    /// Without a configuration it takes one axis of 1 µm a count with default limits.
    pub fn new(measured: &LatencyTestResult, config: Option<&Config>) -> Self {
        let axes = match config {
            Some(config) => config.axes.clone(),
            None => Config::embedded().axes.iter().take(1).map(default_axis).collect(),
        };
        let axes: Vec<SafeAxisEdgeRates> = axes.into_iter().map(|axis| axis_rate(axis, measured)).collect();
        let card = config.filter(|_| measured.how != CardTestExtent::Simulated);
        let reasons = reasons(measured, &axes, card.and_then(|c| floors_ns(&c.card)));
        Self { axes, reasons }
    }

    /// The JSON document of a self-test.
    pub fn document<'a>(
        &'a self,
        measured: &'a LatencyTestResult,
        options: &SelftestOptions,
        provenance: &'a LatencyTestConditions,
        backend: &'a str,
    ) -> SelftestDocument<'a> {
        let of_axes =
            |hz: fn(&SafeAxisEdgeRates) -> Option<f64>| self.axes.iter().map(|r| (&*r.name, hz(r))).collect();
        SelftestDocument {
            wakeup_ns: &measured.wakeup,
            poll_gap_ns: &measured.quiet.poll_gap,
            edge_to_done_ns: &measured.quiet.edge_to_done,
            seen_to_done_ns: &measured.quiet.seen_to_done,
            poll_gap_with_requests_ns: &measured.with_requests.poll_gap,
            edge_to_done_with_requests_ns: &measured.with_requests.edge_to_done,
            seen_to_done_with_requests_ns: &measured.with_requests.seen_to_done,
            requests: measured.with_requests.requests,
            max_safe_edge_rate_hz: of_axes(|r| r.safe_hz),
            edge_rate_at_p9999_hz: of_axes(|r| r.usual_hz),
            rates: self.axes.iter().map(|r| (&*r.name, r.rates)).collect(),
            rt: RtLatencyKeys {
                detect_ns: measured.detect_ns().0,
                write_ns: measured.timed().then(|| measured.write_ns()),
                measured: provenance,
            },
            backend,
            card: &provenance.card,
            how: measured.how,
            verdict: if self.reasons.is_empty() { "pass" } else { "fail" },
            reason: self.reasons.join("; "),
            separations_ns: measured.separations_ns(),
            duration_s: options.run.as_secs_f64(),
            cpu: options.cpu,
            priority: options.priority,
            emulated: measured.setup.emulated.as_deref(),
            ledger_balanced: measured.balanced(),
            poll_gap_faults: measured.faults(),
            far_side: measured.far(),
            missing_to_arm: measured.setup.missing().map(|f| f.name).collect(),
        }
    }
}

/// The JSON document of a self-test.
#[derive(Debug, Serialize)]
pub struct SelftestDocument<'a> {
    wakeup_ns: &'a LatencyDistribution,
    poll_gap_ns: &'a LatencyDistribution,
    edge_to_done_ns: &'a LatencyDistribution,
    /// Time from the look that saw the edge to the order of the second inversion.
    seen_to_done_ns: &'a HistogramSnapshot,
    /// The same three with requests as fast as the link takes them.
    poll_gap_with_requests_ns: &'a LatencyDistribution,
    edge_to_done_with_requests_ns: &'a LatencyDistribution,
    seen_to_done_with_requests_ns: &'a HistogramSnapshot,
    /// Number of requests sent.
    requests: u64,
    /// Highest safe edge rate for each axis, by the worst delay.
    /// Null where no speed leaves time for an insertion.
    max_safe_edge_rate_hz: BTreeMap<&'a str, Option<f64>>,
    /// The same without the worst look in ten thousand.
    edge_rate_at_p9999_hz: BTreeMap<&'a str, Option<f64>>,
    /// The same as speeds, mm/min, and the speed up to which every count is seen.
    rates: BTreeMap<&'a str, SpeedLimits>,
    /// The keys for `[rt]` of the configuration.
    rt: RtLatencyKeys<'a>,
    backend: &'a str,
    /// The card of the test.
    card: &'a str,
    /// The manner: `simulated`, `reads` (outputs held), `reads_and_writes`.
    how: CardTestExtent,
    verdict: &'static str,
    reason: String,
    separations_ns: u64,
    duration_s: f64,
    cpu: usize,
    priority: u8,
    emulated: Option<&'a str>,
    ledger_balanced: bool,
    poll_gap_faults: u64,
    far_side: Option<MachineSideCounts>,
    missing_to_arm: Vec<&'static str>,
}

#[derive(Debug, Serialize)]
struct RtLatencyKeys<'a> {
    detect_ns: u64,
    /// `None` where no write was measured.
    write_ns: Option<u64>,
    measured: &'a LatencyTestConditions,
}

/// The axis of a test without a configuration.
/// It has 1 µm a count and the limits of a replay.
fn default_axis(axis: &ConfiguredAxis) -> ConfiguredAxis {
    ConfiguredAxis {
        name: "default".to_owned(),
        count_um: 1.0,
        engine: AxisConfig::default(),
        rapid_mm_min: None,
        ..axis.clone()
    }
}

/// Edge rates of an axis under the measured latency.
fn axis_rate(axis: ConfiguredAxis, measured: &LatencyTestResult) -> SafeAxisEdgeRates {
    let (worst, usual) = measured.detect_ns();
    let (safe_hz, usual_hz) =
        (edge_rate_hz(axis.engine, measured, worst), edge_rate_hz(axis.engine, measured, usual));
    let mut as_measured = axis;
    (as_measured.engine.detect_ns, as_measured.engine.write_ns) = (worst, measured.write_ns());
    let rates =
        SpeedLimits { corrected_mm_min: safe_hz.map(|hz| as_measured.mm_min(hz)), ..as_measured.rates() };
    SafeAxisEdgeRates { outruns: as_measured.outruns(), name: as_measured.name, safe_hz, usual_hz, rates }
}

/// Highest edge rate at which an insertion has time on an axis, Hz.
fn edge_rate_hz(axis: AxisConfig, measured: &LatencyTestResult, detect_ns: u64) -> Option<f64> {
    if !measured.timed() {
        return None; // nothing was measured
    }
    let axis = AxisConfig { detect_ns, write_ns: measured.write_ns(), ..axis };
    axis.gate().map(|gate| 1e9 / gate.min_period_ns() as f64)
}

/// The findings that forbid corrections on this machine.
fn reasons(
    measured: &LatencyTestResult,
    rates: &[SafeAxisEdgeRates],
    floors: Option<(u64, u64, &'static str)>,
) -> Vec<String> {
    let mut reasons = Vec::new();
    if let Some(emulator) = &measured.setup.emulated {
        reasons.push(format!("emulated by {emulator}: emulated time is no evidence for any machine"));
    }
    reasons.extend(measured.setup.missing().map(|f| {
        let errno = f.errno.as_ref().map(|e| format!(" ({e})")).unwrap_or_default();
        format!("{} is {}, wanted {}{errno}: {}", f.name, f.got, f.wanted, f.remedy)
    }));
    if let CardTestExtent::ReadsAndWrites { ended_by, restored } = measured.how {
        reasons.extend(ended_by.map(|fault| {
            format!("{} was latched while the card was written to: {}", word(fault), explain_fault(fault))
        }));
        if !restored {
            reasons.push(
                "the outputs are not as they were found: switch the card off before the MTC is switched on"
                    .into(),
            );
        }
    }
    if measured.how != CardTestExtent::Simulated && !measured.looked() {
        let why = if measured.quiet.poll_gap.tid == 0 {
            "a polling loop needs a second CPU"
        } else {
            "a card that sleeps until an edge comes is measured by its edges, and none came: with the drives off push an axis \
             by hand while the test runs"
        };
        reasons.push(format!("reads were not measured: {why}"));
        return reasons;
    }
    if !measured.timed() {
        let why = match measured.how {
            CardTestExtent::Reads => {
                "reads only: writes were not measured, so this never passes; with the MTC off, --drive measures them"
            }
            CardTestExtent::ReadsAndWrites { .. } => "writes were not measured: no insertion was made",
            CardTestExtent::Simulated if measured.far().is_some() => {
                "edge to done was not measured: no insertion was seen"
            }
            CardTestExtent::Simulated => "edge to done was not measured: a polling loop needs a second CPU",
        };
        reasons.push(why.to_owned());
        reasons.extend(rates.iter().filter_map(|axis| axis.outruns.clone()));
        return reasons;
    }
    if !measured.balanced() {
        reasons.push("the ledger does not balance".into());
    }
    if let Some((detect_ns, write_ns, why)) = floors
        && (measured.detect_ns().0 < detect_ns || measured.write_ns() < write_ns)
    {
        reasons.push(format!(
            "detect_ns = {} and write_ns = {} are less than such a card takes ({detect_ns} and {write_ns}): {why}. Is this the \
             card?",
            measured.detect_ns().0,
            measured.write_ns()
        ));
    }
    reasons.extend(rates.iter().filter_map(|axis| axis.outruns.clone()));
    for axis in rates.iter().filter(|axis| axis.safe_hz.is_none()) {
        let (worst_us, usual_us) = (measured.detect_ns().0 as f64 / 1e3, measured.detect_ns().1 as f64 / 1e3);
        let usual = axis.usual_hz.map_or_else(String::new, |hz| {
            format!(" (the {usual_us:.1} µs that 99.99 % keep to would do, up to {hz:.0} edges/s)")
        });
        let name = &axis.name;
        reasons.push(format!(
            "the longest delay, {worst_us:.1} µs, leaves axis {name} no time for an insertion at any speed{usual}"
        ));
    }
    reasons
}
