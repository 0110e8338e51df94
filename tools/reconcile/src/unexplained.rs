//! A bounded stand-in for a shape that no effect of the dictionary explains: a broken line over what the shape runs
//! along, constant beyond the range that was seen. It is a law of the project's own file, marked as unexplained.

use crate::hypotheses::Shape;
use rtec_model::effect::{Against, Difference, Effect, STANDARD_DEGC};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};
use std::fmt::Write as _;

/// File that the laws of stand-ins are written to, beside the model.
pub const LAWS_FILE: &str = "unexplained.toml";

/// A stand-in, its heights at zero.
#[derive(Debug, Clone)]
pub(crate) struct StandIn {
    pub(crate) effect: Effect,
    /// The whole file of laws.
    pub(crate) laws: String,
}

/// What a law's term calls a label of a shape, and the role behind it.
fn quantity(label: &str, axis: &str) -> Option<(&'static str, Role)> {
    let head = label.split_once('.').map_or(label, |(head, _)| head);
    let role = Role::parse(label).or_else(|| Role::parse(head))?;
    let key = match &role {
        Role::Time => "t",
        Role::Temperature => "dT",
        Role::Channel => "channel",
        Role::Position(of) if of.as_str() == axis => "p",
        Role::Position(_) => "p_B",
        Role::Direction(_) => "dir",
        Role::Velocity(_) => "v",
        Role::Acceleration(_) => "a",
        Role::Load(_) => "load",
        Role::SpindleSpeed => "rpm",
        Role::Coolant => "wet",
        Role::Angle => "angle",
        _ => return None,
    };
    Some((key, role))
}

/// A stand-in for a shape with so many knots; the model adopts its law. None for a shape along what no law reads (the
/// cycle), or where the model has a law of this name.
pub(crate) fn stand_in(
    shape: &Shape,
    knots: usize,
    train: &[Record],
    model: &mut Machine,
) -> Option<StandIn> {
    let axis = shape.response.split('.').nth(1)?;
    let force = shape.response.starts_with("force");
    let mut along: Vec<&str> = shape.against.iter().map(String::as_str).collect();
    if along.last().and_then(|l| Role::parse(l)) == Some(Role::Coolant) {
        along.reverse();
    }
    let over = *along.last()?;
    let (key, role) = quantity(over, axis)?;
    let factor = match along[..] {
        [first, _] => Some(match quantity(first, axis)?.0 {
            "v" if shape.manner.contains("sign") => "dir",
            key => key,
        }),
        _ => None,
    };
    let name = over.split_once('.').map_or("", |(_, n)| n);
    let mut lo_hi = (f64::MAX, f64::MIN);
    for r in train {
        let data = match role {
            Role::Time => Some(r.time_s()),
            Role::Temperature => r.temperature(name),
            Role::Channel => r.channel(name),
            _ => r.data(&role),
        };
        for x in data? {
            lo_hi = (lo_hi.0.min(*x), lo_hi.1.max(*x));
        }
    }
    let shift = if key == "dT" { STANDARD_DEGC } else { 0.0 };
    let (lo, hi) = (lo_hi.0 - shift, lo_hi.1 - shift);
    if hi <= lo {
        return None;
    }
    let (naming, rest) = match key {
        "channel" => ("A.NAME", format!(".{name}")),
        "p_B" => ("A.B", format!(".{name}")),
        _ => ("A", String::new()),
    };
    let law = format!("unexplained_{}", shape.against.join("_").replace('.', "_"));
    let (unit, acts_on) = if force { ("N", "force") } else { ("um", "error") };
    let with = factor.map_or_else(String::new, |f| format!(", {f} = 1"));
    let at = |i: usize| lo + (hi - lo) * i.min(knots - 1) as f64 / (knots - 1) as f64;
    let mut parameters = String::new();
    for i in 0..knots {
        let hat = [at(i.saturating_sub(1)), at(i), at(i + 1)];
        // Writing to a String does not fail.
        let _ = writeln!(
            parameters,
            "  {{ name = \"{unit}_{i}\", unit = \"{unit}\", terms = [{{ hat = {hat:?}, of = \"{key}\"{with} }}] }},"
        );
    }
    let laws = format!(
        "# Unexplained: a bounded curve that stands for structure which no effect explains.\n[[law]]\nname = \"{law}\"\n\
         naming = \"{naming}\"\nacts_on = \"{acts_on}\"\nlaw = \"unexplained: a broken line over {over}, constant beyond \
         its ends\"\ncause = \"unexplained ({})\"\nexperiment = \"repeat the run with {over} varied by itself\"\n\
         parameters = [\n{parameters}]\n",
        shape.manner
    );
    let laws = model.adopt(LAWS_FILE, &laws).ok()?;
    let mut effect = model.dictionary().effect(&format!("{law}.{axis}{rest}")).ok()?;
    let sensor = along.iter().find_map(|l| l.strip_prefix("temperature."));
    effect.delta = sensor.map(|s| Difference { sensor: s.to_owned(), against: Against::Standard });
    Some(StandIn { effect, laws })
}
