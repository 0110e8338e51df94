//! The guide's page of effects, made from the dictionary.
//! `RTEC_BLESS=1` writes it again.

#![allow(clippy::unwrap_used)]

use rtec_model::effect::{
    AffectedQuantity, Dictionary, EffectNameAxes, EffectOwner, LawDescription, LawParameter,
    MechanicalParameter, ProbingDependence, RequiredInput, ThermalDependence,
};
use std::fmt::Write as _;
use std::path::Path;

const HEAD: &str = "# Effects\n\n\
    What a machine may do wrong, as [`machine.toml`](machine-toml.md) names it. The measured error is the sum of the effects: e in µm, p in\n\
    mm, ΔT in K, t in s, v in mm/s, a in mm/s², dir = ±1. A, B and C stand for the letters of linear axes, as in `scale.x`. Outside its bounds no\n\
    value is read, loaded or fitted; outside what is plausible there is a warning. *Shown by*: the run that separates an effect from similar ones.\n\n";

#[test]
fn the_page_of_effects_is_what_the_dictionary_says() {
    let dictionary = Dictionary::default();
    let mut page = HEAD.to_owned();
    page += "| effect | law | parameters |\n|---|---|---|\n";
    for law in dictionary.laws().map(rtec_model::effect::Law::describe) {
        let parameters = law.parameters.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ");
        let sensors =
            if law.needs.contains(&RequiredInput::Delta) { "sensor, minus or reference_degC, " } else { "" };
        let _ = writeln!(page, "| [`{}`](#{}) | {} | {sensors}{parameters} |", name(law), law.name, law.law);
    }
    let mut laws = 0;
    for law in dictionary.laws() {
        describe(&mut page, law.describe());
        laws += 1;
    }
    assert_eq!(laws, 32);
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../guide/reference/effects.md");
    test_needs::golden(&file, &page);
}

fn name(law: &LawDescription) -> String {
    let rest = match law.naming {
        EffectNameAxes::Plain => "",
        EffectNameAxes::One => ".A",
        EffectNameAxes::Two | EffectNameAxes::Pair => ".A.B",
        EffectNameAxes::Three => ".A.B.C",
        EffectNameAxes::Channel => ".A.NAME",
    };
    format!("{}{rest}", law.name)
}

fn describe(page: &mut String, law: &LawDescription) {
    let _ = write!(page, "\n## {}\n\n| | |\n|---|---|\n", law.name);
    let mut row = |what: &str, text: &str| {
        if !text.is_empty() {
            let _ = writeln!(page, "| {what} | {} |", text.replace('|', "\\|"));
        }
    };
    row("name", &format!("`{}`", name(law)));
    row("law", &law.law);
    let on = match (law.quantity, law.naming) {
        (AffectedQuantity::Force, _) => "the drive force of A, N",
        (AffectedQuantity::Error, EffectNameAxes::Plain) => {
            "the radial error (`error.r`), or the record's only error, µm"
        }
        (AffectedQuantity::Error, EffectNameAxes::Pair) => "the errors of A and of B, µm",
        (AffectedQuantity::Error, _) => "the error of A, µm",
    };
    row("acts on", on);
    row("reads", &law.needs.iter().map(|n| need(*n)).collect::<Vec<_>>().join(", "));
    row("cause", &law.cause);
    row("shown by", &law.experiment);
    let mut notes = Vec::new();
    match law.owner {
        EffectOwner::Machine => {}
        EffectOwner::Probe => notes.push("of the probe: in what is probed, not in the part"),
        EffectOwner::Part => notes.push("of the part's own form"),
    }
    match law.probing {
        ProbingDependence::Alike => {}
        ProbingDependence::Only => notes.push("in records of kind `probing` only"),
        ProbingDependence::Displaced => {
            notes.push("in records of kind `probing` another effect takes its place");
        }
    }
    match law.heat {
        ThermalDependence::FromStart => {
            notes.push("grows with the time since the start, with no logged cause");
        }
        ThermalDependence::Growth | ThermalDependence::Expansion => {
            notes.push("a temperature difference drives it");
        }
        ThermalDependence::None | ThermalDependence::StandsIn => {}
    }
    if law.whole_counts {
        notes.push("a multiple of the record's `count_um`");
    }
    if law.symmetric {
        notes.push("the axes behind the first may change places: written alphabetically");
    }
    if law.naming == EffectNameAxes::Pair {
        notes.push("one effect for both orders of its axes: written alphabetically");
    }
    if law.searched.repeats {
        notes.push("several may stand in one model");
    }
    match law.mechanism {
        Some(MechanicalParameter::ProbeDelay) => notes.push("a simulated probe is built with it"),
        Some(_) => notes.push("a simulated axis is built with it"),
        None => {}
    }
    row("note", &notes.join("; "));
    page.push_str("\n| parameter | unit | plausible | bounds | default | where the bounds come from |\n|---|---|---|---|---|---|\n");
    for p in &law.parameters {
        let default = p.default.map(number).unwrap_or_default();
        let array = if p.array { ", one per knot" } else { "" };
        let _ = writeln!(
            page,
            "| `{}` | {}{array} | {} | {} | {default} | {} |",
            p.name,
            p.unit,
            range(p.plausible),
            bounds(p),
            p.source.replace('|', "\\|")
        );
    }
    if law.needs.contains(&RequiredInput::Delta) {
        page.push_str(
            "| `sensor` | name | | | | its temperature is the first of the difference ΔT |\n\
             | `minus` | name | | | | ΔT = sensor − minus; not together with `reference_degC` |\n\
             | `reference_degC` | °C | | | 20 | ΔT = sensor − this |\n\
             | `range_K` | [K, K] | | | | the range of ΔT that it was fitted on; beyond it, ΔT counts as at its end, and live the effect fades out as well |\n",
        );
    }
    if law.lag.is_some() {
        page.push_str("| `start_K` | K | | 0 to 1000 | | how far ΔT may have been from equilibrium at the start of the runs |\n");
    }
}

fn need(need: RequiredInput) -> &'static str {
    match need {
        RequiredInput::Time => "time",
        RequiredInput::Position(0) => "the position of A",
        RequiredInput::Position(1) => "the position of B",
        RequiredInput::Position(_) => "the position of C",
        RequiredInput::Direction => "the direction of A, or the sign of its velocity",
        RequiredInput::Velocity => "the velocity of A",
        RequiredInput::Acceleration => "the acceleration of A",
        RequiredInput::Load => "the load of A",
        RequiredInput::Delta => "a temperature difference",
        RequiredInput::SpindleSpeed => "spindle speed",
        RequiredInput::Coolant => "coolant",
        RequiredInput::Angle => "angle",
        RequiredInput::Channel => "the channel NAME",
    }
}

fn bounds(p: &LawParameter) -> String {
    if p.bounds.iter().all(|b| b.is_infinite()) { "none".to_owned() } else { range(p.bounds) }
}

fn range([low, high]: [f64; 2]) -> String {
    #[allow(clippy::float_cmp)] // the same number written twice
    if low == -high && high.is_finite() {
        format!("±{}", number(high))
    } else {
        format!("{} to {}", number(low), number(high))
    }
}

/// A short form: powers of ten if there would be many digits.
fn number(v: f64) -> String {
    for (turn, name) in [(std::f64::consts::PI, "π"), (std::f64::consts::TAU, "2π")] {
        if (v.abs() - turn).abs() < 1e-9 {
            return format!("{}{name}", if v < 0.0 { "-" } else { "" });
        }
    }
    let plain = format!("{}", (v * 1e9).round() / 1e9);
    if v == 0.0 || (plain != "0" && plain.len() < 9) {
        plain
    } else {
        format!("{v:.3e}").replace(".000e", "e")
    }
}
