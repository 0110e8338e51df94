//! `[[axis]]`: one axis, its limits, and whether they let it correct anything.

use super::card::{CardBackend, CardSection, read_lines};
use super::{ConfiguredAxis, SimulatedAxisDeviations, beside, keys};
use rtec_files::toml_section_keys::{FileWithFindings, TomlSection};
use rtec_model::record::Axis;
use rtec_rt::axis::{AxisConfig, INCREMENT_COUNTS, InsertionAtRestPolicy};
use std::path::PathBuf;

#[allow(clippy::too_many_lines)] // The keys in order.
/// Reads one `[[axis]]` with the recording of a replay; none if it has a mistake.
pub(super) fn read(
    source: &mut FileWithFindings<'_>,
    mut s: TomlSection<'_>,
    n: u8,
    card: &mut CardSection,
    latency: &AxisConfig,
    notes: &mut Vec<String>,
) -> Option<(ConfiguredAxis, Option<PathBuf>)> {
    let before = source.findings.len();
    let name = s.text(source, "name");
    let owner = name.map_or_else(|| format!("axis {n}"), |name| format!("axis {}", name.value));
    let turns = |name: &str| Axis::new(name).is_some_and(|a| a.is_rotary());
    let by_name = name.as_ref().filter(|n| turns(n.value)).map(|n| n.offset);
    let other_kind = refuse_other_kinds(source, &mut s, &owner, by_name);
    // A key given in degrees is not reported as missing in millimetres.
    let needed = |key| if other_kind && !s.has(key) { None } else { s.number(source, key) };
    let [count_um, travel_mm] = ["count_um", "travel_mm"].map(needed);
    read_design(source, &mut s);
    let max = s.whole(source, "max_correction_counts");
    let window = s.whole(source, "window_counts");
    let window_given = s.has("window_counts");
    let separation = s.whole(source, "min_separation_ns");
    let accel_mm = s.number(source, "max_accel_mm_s2");
    let accel_counts = s.number(source, "max_accel_counts_s2");
    if let (Some(_), Some(at)) = (accel_mm, accel_counts) {
        source.finding(at.offset, "max_accel_mm_s2 and max_accel_counts_s2", "one of the two");
    }
    if card.is_real() && !s.has("max_accel_mm_s2") && !s.has("max_accel_counts_s2") {
        s.missing(source, "max_accel_mm_s2");
    }
    let rapid = s.number(source, "rapid_mm_min");
    let hysteresis = s.number_or_default(source, "hysteresis_counts");
    let warn = s.whole(source, "warn_counts");
    let error = s.whole(source, "error_counts");
    let (warns, errs) = (("warn_counts", warn), ("error_counts", error));
    let most = ("max_correction_counts", max);
    for ((lower, low), (upper, high), expected) in [
        (warns, errs, "the warning before the error"),
        (errs, most, "a limit that a request can reach: beyond the maximum it is refused"),
        (
            ("window_counts", window),
            most,
            "a belief window within the largest total: else everything is believed",
        ),
    ] {
        if let (Some(low), Some(high)) = (low, high)
            && low.value > high.value
        {
            let found = format!("{lower} = {} above {upper} = {}", low.value, high.value);
            source.finding(low.offset, found, expected);
        }
    }
    let rate = s.number(source, "max_rate_counts_s");
    let rest = s.pick(source, "rest_policy", &[false, true]);
    let quiet_ms = s.number(source, "rest_quiet_ms");
    let insert = rest.is_some_and(|r| r.value);
    match (insert, quiet_ms, rest) {
        (true, None, Some(at)) if !s.has("rest_quiet_ms") => {
            source.finding(
                at.offset,
                "rest_policy = \"insert\" alone",
                "rest_quiet_ms too: after how many ms",
            );
        }
        (false, Some(at), _) => {
            let expected = "rest_policy = \"insert\" beside it, or no rest_quiet_ms";
            source.finding(at.offset, "rest_quiet_ms with rest_policy = \"wait\"", expected);
        }
        _ => {}
    }
    let (simulated_um, simulated) = read_simulated(source, &mut s, card.kind);
    let budget = s.whole(source, "reference_budget_counts");
    for (key, limit) in [("max_correction_counts", max), ("reference_budget_counts", budget)] {
        if let Some(at) = limit.filter(|at| at.value < INCREMENT_COUNTS) {
            let found = format!("{key} = {} with insertions of {INCREMENT_COUNTS} counts", at.value);
            source.finding(
                at.offset,
                found,
                "room for one insertion at least: nothing would ever be corrected",
            );
        }
    }
    let home_mm = s.number_or_default(source, "home_mm");
    let lines = read_lines(source, &mut s, n, card, &owner);
    let mut trace = None;
    if card.kind == Some(CardBackend::Replay) {
        let path = s.text(source, "trace");
        trace = s.required(source, "trace", path).map(|at| beside(source.file, at.value));
    }
    if let (Some(max), Some(um), Some(mm)) = (max, count_um, travel_mm)
        && max.value as f64 * um.value > mm.value * 1000.0
    {
        let found = format!("max_correction_counts = {} on a travel of {} mm", max.value, mm.value);
        source.finding(max.offset, found, "a correction smaller than the travel");
    }
    let offset = s.offset;
    if card.kind.is_none() {
        // Without a card it is not known whether these keys belong here.
        let _ = (s.has("lines"), s.has("trace"));
    }
    s.finish(source);
    if source.findings.len() > before {
        return None;
    }

    let (count_um, max, name) = (count_um?.value, max?, name?.value);
    if let Some(budget) = budget
        && budget.value < max.value
    {
        notes.push(format!(
            "{owner}: max_correction_counts = {} is capped at {}, the budget that the MTC leaves between reference \
             marks or encoders",
            max.value, budget.value
        ));
    }
    let max_accel_counts_s2 = match (accel_mm, accel_counts) {
        (Some(mm), _) => mm.value * 1000.0 / count_um,
        (None, Some(counts)) => counts.value,
        (None, None) => latency.max_accel_counts_s2,
    };
    let slowest_ms = 2e3 * (2.0 / max_accel_counts_s2).sqrt();
    if let Some(ms) = quiet_ms.map(|at| at.value).filter(|ms| insert && *ms <= slowest_ms) {
        notes.push(format!(
            "{owner}: rest_quiet_ms = {ms} is not longer than {slowest_ms:.2} ms, in which the axis may be within one count as it \
             turns: an edge may meet the insertion"
        ));
    }
    let window_counts = match window {
        Some(window) => window.value,
        None if window_given => return None,
        None => rtec_correct::belief_window_counts(count_um, 0.0).min(max.value),
    };
    let engine = AxisConfig {
        lines: lines?,
        max_correction_counts: budget.map_or(max.value, |b| b.value.min(max.value)),
        window_counts,
        warn_counts: warn.map_or(i64::MAX, |w| w.value),
        error_counts: error.map_or(i64::MAX, |e| e.value),
        max_rate_counts_s: rate.map_or(f64::INFINITY, |r| r.value),
        min_separation_ns: separation?.value as u64,
        max_accel_counts_s2,
        hysteresis_counts: hysteresis,
        rest: match quiet_ms {
            Some(ms) if insert => InsertionAtRestPolicy::Insert { after_ns: (ms.value * 1e6) as u64 },
            _ => InsertionAtRestPolicy::Wait,
        },
        ..*latency
    };
    if engine.gate().is_none() {
        let found = format!("{owner}: no speed leaves time for an insertion");
        let expected =
            "a lower max_accel, detect_ns, write_ns, guard_ns or min_separation_ns, or more hysteresis";
        source.finding(offset, found, expected);
    }
    let axis = ConfiguredAxis {
        name: name.to_owned(),
        count_um,
        travel_mm: travel_mm?.value,
        home_counts: (home_mm * 1000.0 / count_um).round() as i64,
        rapid_mm_min: rapid.map(|r| r.value),
        counted: card
            .profile
            .iter()
            .flat_map(|p| &p.counters)
            .any(|c| c.lines == (engine.lines.a, engine.lines.b)),
        reference_budget_counts: budget.map(|b| b.value),
        engine,
        simulated: SimulatedAxisDeviations { count_um: simulated_um.unwrap_or(count_um), ..simulated },
    };
    Some((axis, trace))
}

/// Checks the key `design`: the daemon inserts by Design C only.
fn read_design(source: &mut FileWithFindings<'_>, s: &mut TomlSection<'_>) {
    if s.has_unoffered("design") {
        let expected = "\"c\", or no such key: every axis inserts by Design C (the other designs are simulated: rtecctl \
                        designs, rtecctl replay --design)";
        s.value(source, "design", expected, |e| e.as_str().filter(|design| *design == "c"));
    }
}

/// Keys of unsupported kinds of axis, and the kind of each.
const OTHER_KINDS: [(&str, &str); 8] = [
    ("count_deg", ROTARY),
    ("count_arcsec", ROTARY),
    ("travel_deg", ROTARY),
    ("rapid_deg_min", ROTARY),
    ("coupled_with", COUPLED),
    ("gantry", COUPLED),
    ("master", COUPLED),
    ("slave", COUPLED),
];
const ROTARY: &str = "a linear axis: rotary axes are not supported, since models and limits are in µm and mm. Leave the axis out: \
                      its scale goes straight to the MTC";
const COUPLED: &str = "an axis of its own: two scales of one axis (a gantry) are not supported, since unequal corrections would \
                       rack it. Leave both scales out: they go straight to the MTC";

/// Refuses a rotary or coupled axis by its kind, not by an unknown key.
/// `by_name`: its name marks it as rotary (ISO 841). Returns `true` if it was refused.
fn refuse_other_kinds(
    source: &mut FileWithFindings<'_>,
    s: &mut TomlSection<'_>,
    owner: &str,
    by_name: Option<usize>,
) -> bool {
    let mut refused = None;
    if s.has_unoffered("kind") {
        let kinds = [("linear", None), ("rotary", Some(ROTARY)), ("gantry", Some(COUPLED))];
        refused = s.choice(source, "kind", 1, &kinds).and_then(|at| Some((at.offset, at.value?)));
    }
    for (key, why) in OTHER_KINDS {
        if s.has_unoffered(key) && refused.is_none() {
            refused = s.value(source, key, "a linear axis", |_| Some(())).map(|at| (at.offset, why));
        }
    }
    if let Some((offset, why)) = refused.or(by_name.map(|offset| (offset, ROTARY))) {
        let what = if why == ROTARY { "rotary" } else { "coupled to another" };
        source.finding(offset, format!("{owner}, which is {what}"), why);
    }
    refused.is_some() || by_name.is_some()
}

/// The count of `simulated`, if it has one, and its other values.
fn read_simulated(
    source: &mut FileWithFindings<'_>,
    s: &mut TomlSection<'_>,
    kind: Option<CardBackend>,
) -> (Option<f64>, SimulatedAxisDeviations) {
    let mut found = SimulatedAxisDeviations { count_um: 1.0, compensates_ppm: 0.0, ignores: false };
    if !s.has("simulated") {
        return (None, found);
    }
    let mut table = s.table(source, "simulated", "simulated").with(keys::SIMULATED);
    if kind != Some(CardBackend::Mock) {
        source.finding(
            table.offset,
            "simulated",
            "backend = \"mock\": no other card has a simulated machine",
        );
    }
    let expected = "a number from 0.0001 to 1000, or the same below zero where it counts backwards";
    let count_um = table
        .value(source, "count_um", expected, |v| {
            v.as_number().filter(|um| (1e-4..=1000.0).contains(&um.abs()))
        })
        .map(|at| at.value);
    found.compensates_ppm = table.number_or_default(source, "compensates_ppm");
    let ignores = table.pick(source, "feedback", &[false, true]);
    found.ignores = ignores.is_some_and(|i| i.value);
    table.finish(source);
    (count_um, found)
}
