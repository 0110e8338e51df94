//! Advises the experiment that would separate what these data cannot.

use crate::findings_from_estimate::FoundEffect;
use crate::period_aliases_on_grid::{self, GRID_SHARE};
use crate::verdict::Verdict;
use rtec_estimate::UnnamedShape;
use rtec_model::effect::{Dictionary, Effect, PeriodicLawSettings};
use rtec_model::record::{Axis, Column, Record, Role, span};

/// All positions of an axis, in rising order.
fn places(axis: &Axis, train: &[Record]) -> Vec<f64> {
    let role = Role::Position(axis.clone());
    let mut places: Vec<f64> = train.iter().filter_map(|r| r.data(&role)).flatten().copied().collect();
    places.sort_by(f64::total_cmp);
    places
}

/// Leads of screws that targets on a grid cannot distinguish from a constant.
/// Every target is at the same angle of such a screw.
fn hidden_leads(effect: &Effect, train: &[Record], dictionary: &Dictionary) -> Option<String> {
    let axis = effect.axes().first().filter(|_| effect.description().constant)?;
    let screw = dictionary.effect(&format!("screw_periodic.{axis}")).ok()?;
    let leads_mm = screw.description().searched.wave?.usual_mm;
    let shortest = leads_mm.iter().copied().fold(f64::INFINITY, f64::min);
    let pitch = period_aliases_on_grid::pitch(&places(axis, train), GRID_SHARE * shortest)?;
    let whole = |lead: &&f64| {
        let turns = pitch / **lead;
        turns > 0.5 && (turns - turns.round()).abs() < GRID_SHARE
    };
    let leads: Vec<String> = leads_mm.iter().filter(whole).map(ToString::to_string).collect();
    (!leads.is_empty()).then(|| {
        format!(
            "the targets of {} lie on a grid of {pitch:.4} mm, on which the wave of a screw with a lead of {} mm looks the same \
             as a constant: targets at uneven distances tell",
            effect.name(),
            leads.join(", ")
        )
    })
}

/// Periods that a grid of targets cannot distinguish from the found one.
fn other_periods(effect: &Effect, train: &[Record]) -> Option<String> {
    let law = effect.description();
    let PeriodicLawSettings { unit_mm, usual_mm, .. } = law.searched.wave?;
    let places = places(&effect.axes()[0], train);
    let period_mm = effect.scalar(0) * unit_mm;
    let pitch = period_aliases_on_grid::pitch(&places, GRID_SHARE * period_mm)?;
    let [lo, hi] = law.parameters[0].bounds;
    let range = [1.0 / (hi * unit_mm), 1.0 / (lo * unit_mm)];
    let others: Vec<String> = period_aliases_on_grid::aliases(1.0 / period_mm, pitch, range, 7, usual_mm)
        .iter()
        .map(|f| 1.0 / (f * unit_mm))
        .filter(|p| (p / effect.scalar(0) - 1.0).abs() > 1e-3)
        .map(|p| format!("{p:.4}"))
        .collect();
    let unit = &law.parameters[0].unit;
    (!others.is_empty()).then(|| {
        format!(
            "the targets of {} lie on a grid of {pitch:.4} mm, on which a period of {:.4} {unit} looks the same as {} {unit} \
             and more: targets at uneven distances (or the lead by the screw's data sheet) tell which it is",
            effect.name(),
            effect.scalar(0),
            others.join(", ")
        )
    })
}

/// Other periods that explain as much at targets that are not on a grid.
fn as_good(f: &FoundEffect) -> Option<String> {
    let others: Vec<String> =
        f.rivals.iter().filter_map(|r| Some(format!("{:.4}", r.differs.as_ref()?.1))).collect();
    let parameters = &f.effect.description().parameters;
    let at = parameters.iter().position(|p| p.tells_apart && !p.array)?;
    let (key, unit) = (&parameters[at].name, &parameters[at].unit);
    (!others.is_empty()).then(|| {
        format!(
            "{key} = {:.4} {unit} of {} explains no more than {} {unit}: more places, at uneven distances, tell which it is",
            f.effect.scalar(at),
            f.effect.name(),
            others.join(", ")
        )
    })
}

/// The advice: what to do next.
pub(crate) fn advice(
    verdict: Verdict,
    effects: &[(FoundEffect, Vec<f64>)],
    shapes: &[UnnamedShape],
    train: &[Record],
    dictionary: &Dictionary,
) -> String {
    let mut parts: Vec<String> = match verdict {
        Verdict::NotSeparable => effects.iter().flat_map(|(f, _)| separating(f, dictionary)).collect(),
        Verdict::UnknownEffect => shapes.iter().map(|s| isolating(s, train)).collect(),
        Verdict::Named => {
            let narrow = |f: &Effect| format!("to narrow {}: {}", f.name(), f.description().experiment);
            effects.iter().map(|(f, _)| narrow(&f.effect)).collect()
        }
        Verdict::NothingMissing => Vec::new(),
    };
    parts.extend(effects.iter().filter_map(|(f, _)| other_periods(&f.effect, train).or_else(|| as_good(f))));
    parts.extend(effects.iter().filter_map(|(f, _)| hidden_leads(&f.effect, train, dictionary)));
    // Each experiment once.
    let mut said: Vec<&String> = Vec::new();
    for part in &parts {
        if !said.contains(&part) {
            said.push(part);
        }
    }
    said.into_iter().map(String::as_str).collect::<Vec<_>>().join("; ")
}

/// The run in which sensors differ, and the runs that show each rival.
pub(crate) fn separating(f: &FoundEffect, dictionary: &Dictionary) -> Vec<String> {
    let name = f.effect.name();
    let same = f.rivals.iter().filter(|r| r.name == name).filter_map(|r| r.sensor.as_ref());
    let same: Vec<String> = same.map(ToString::to_string).collect();
    let mut parts: Vec<String> = Vec::new();
    if !same.is_empty() {
        parts.push(format!(
            "{name}: sensors {} and {} saw the same here; a run in which they part (heat one place only, or \
             let the machine cool while the surroundings warm) would tell them apart",
            f.effect.delta.as_ref().map_or_else(String::new, ToString::to_string),
            same.join(", ")
        ));
    }
    let mut seen = vec![name.clone()];
    for r in &f.rivals {
        if seen.contains(&r.name) {
            continue;
        }
        seen.push(r.name.clone());
        if let Ok(e) = dictionary.effect(&r.name) {
            parts.push(format!("{name} or {}: {}", r.name, e.description().experiment));
        }
    }
    parts
}

fn isolating(s: &UnnamedShape, train: &[Record]) -> String {
    let over = &s.against[0];
    let columns = || train.iter().flat_map(|r| &r.columns).filter(|c| is_of(c, over));
    let range = span(columns().flat_map(|c| &c.data));
    let far = match columns().next() {
        Some(c) if range[0] < range[1] => {
            format!(" at least from {:.4} to {:.4} {}", range[0], range[1], c.unit)
        }
        _ => String::new(),
    };
    format!(
        "{} has structure against {} ({}) that no effect of the dictionary explains: repeat the run with {over} varied by itself{far}, \
         all else held",
        s.response,
        s.against.join(" and "),
        s.manner,
    )
}

/// Whether a column is meant by the label of a place.
/// The label is a role, or `temperature.NAME`.
fn is_of(c: &Column, over: &str) -> bool {
    let role = c.role.to_string();
    role == over || over.strip_prefix(&role).and_then(|rest| rest.strip_prefix('.')) == Some(&c.name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::axis;
    use rtec_estimate::RivalExplanation;
    use rtec_model::effect::TemperatureDifference;
    use rtec_model::record::RunKind;
    use std::path::Path;

    #[test]
    fn sensors_that_saw_the_same_and_rivals_are_told_apart() {
        let dictionary = Dictionary::default();
        let mut effect = dictionary.effect("thermal_growth.z").unwrap();
        effect.delta = Some(TemperatureDifference::single("T1"));
        let rival = |name: &str, sensor: Option<&str>| RivalExplanation {
            name: name.into(),
            sensor: sensor.map(TemperatureDifference::single),
            differs: None,
            margin: 0.5,
        };
        let rivals =
            vec![rival("thermal_growth.z", Some("T2")), rival("warm_up.z", None), rival("warm_up.z", None)];
        let finding = FoundEffect {
            effect,
            held: Vec::new(),
            p_value: 0.0,
            evidence: 9.0,
            name_mass: 0.6,
            mode_mass: 1.0,
            rivals,
        };
        let text = advice(Verdict::NotSeparable, &[(finding, Vec::new())], &[], &[], &dictionary);
        assert!(text.contains("sensors T1 and T2 saw the same"), "{text}");
        assert_eq!(
            text.matches("thermal_growth.z or warm_up.z: drift from a cold start").count(),
            1,
            "{text}"
        );
        assert_eq!(advice(Verdict::NothingMissing, &[], &[], &[], &dictionary), "");
    }

    #[test]
    fn on_a_grid_the_other_periods_are_said() {
        let p: Vec<f64> = (0..60).map(|i| 20.0 * f64::from(i % 30)).collect();
        let columns = vec![
            Column::new("p", Role::Position(axis()), p.clone()),
            Column::new("e", Role::Error(axis()), vec![0.0; p.len()]),
        ];
        let train = [Record::new(Path::new("r.run.toml"), RunKind::Positioning, columns).unwrap()];
        let mut wave = Dictionary::default().effect("screw_periodic.x").unwrap();
        wave.set("period_mm", &[12.0]).unwrap();
        let text = other_periods(&wave, &train).unwrap();
        assert!(text.contains("grid of 20.0000 mm") && text.contains("30.0000"), "{text}");
        assert_eq!(other_periods(&Dictionary::default().effect("scale.x").unwrap(), &train), None);
    }

    /// Seen at steps of 20 mm, a screw of 10 mm is a constant.
    #[test]
    fn a_constant_on_a_grid_may_be_a_screw_and_this_is_said() {
        let train = |pitch: f64, off: f64| {
            let p: Vec<f64> = (0..60).map(|i| pitch * f64::from(i % 30) + off * f64::from(i % 7)).collect();
            let e = Column::new("e", Role::Error(axis()), vec![2.0; p.len()]);
            let columns = vec![Column::new("p", Role::Position(axis()), p), e];
            [Record::new(Path::new("r.run.toml"), RunKind::Positioning, columns).unwrap()]
        };
        let dictionary = Dictionary::default();
        let of = |name: &str, pitch: f64, off: f64| {
            hidden_leads(&dictionary.effect(name).unwrap(), &train(pitch, off), &dictionary)
        };
        let text = of("offset.x", 20.0, 0.0).unwrap();
        assert!(text.contains("grid of 20.0000 mm") && text.contains("5, 10, 20 mm"), "{text}");
        assert_eq!(of("offset.x", 20.0, 1.3), None, "uneven");
        assert_eq!(of("offset.x", 20.7, 0.0), None, "no lead");
        assert_eq!(of("scale.x", 20.0, 0.0), None);
    }
}
