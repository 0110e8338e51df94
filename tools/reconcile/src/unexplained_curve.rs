//! A bounded stand-in for a shape that no effect of the dictionary explains.
//! It is a broken line over the shape's variable, constant beyond the range that was seen. It is a law of the
//! project's own file, marked as unexplained.

use rtec_estimate::UnnamedShape;
use rtec_model::effect::{Effect, ReferenceTemperature, STANDARD_DEGC, TemperatureDifference};
use rtec_model::machine::Machine;
use rtec_model::record::{Record, Role};
use std::fmt::Write as _;

/// The file for the laws of stand-ins, beside the model.
pub const LAWS_FILE: &str = "unexplained.toml";

/// A stand-in with its heights at zero.
#[derive(Debug, Clone)]
pub(crate) struct UnexplainedCurveLaw {
    pub(crate) effect: Effect,
    /// The text of the whole file of laws.
    pub(crate) laws: String,
}

/// The key in a law's terms for a label of a shape, and its role.
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

/// The variable of a stand-in, in the keys of a law's terms.
struct CurveVariable {
    /// The axis of its response.
    axis: String,
    /// The variable's label, and its name after the role.
    over: String,
    name: String,
    key: &'static str,
    role: Role,
    /// The key of a factor of the line.
    factor: Option<&'static str>,
    sensor: Option<String>,
}

impl CurveVariable {
    /// `None` for a shape over a variable that no law reads.
    fn of(shape: &UnnamedShape) -> Option<Self> {
        let axis = shape.response.split('.').nth(1)?.to_owned();
        let mut along: Vec<&str> = shape.against.iter().map(String::as_str).collect();
        if along.last().and_then(|l| Role::parse(l)) == Some(Role::Coolant) {
            along.reverse();
        }
        let over = (*along.last()?).to_owned();
        let (key, role) = quantity(&over, &axis)?;
        let factor = match along[..] {
            [first, _] => Some(match quantity(first, &axis)?.0 {
                "v" if shape.manner.contains("sign") => "dir",
                key => key,
            }),
            _ => None,
        };
        let name = over.split_once('.').map_or_else(String::new, |(_, n)| n.to_owned());
        let sensor = along.iter().find_map(|l| l.strip_prefix("temperature.")).map(str::to_owned);
        Some(Self { axis, over, name, key, role, factor, sensor })
    }

    /// The variable's range in the records, in a law's unit; `None` if it is constant.
    fn range(&self, train: &[Record]) -> Option<[f64; 2]> {
        let (mut lo, mut hi) = (f64::MAX, f64::MIN);
        for r in train {
            let data = match self.role {
                Role::Time => Some(r.time_s()),
                Role::Temperature => r.temperature(&self.name),
                Role::Channel => r.channel(&self.name),
                _ => r.data(&self.role),
            };
            for x in data? {
                (lo, hi) = (lo.min(*x), hi.max(*x));
            }
        }
        let shift = if self.role == Role::Temperature { STANDARD_DEGC } else { 0.0 };
        (hi > lo).then_some([lo - shift, hi - shift])
    }

    /// What follows the law's name in general, and in this one.
    fn naming(&self) -> (&'static str, String) {
        match self.key {
            "channel" => ("A.NAME", format!(".{}", self.name)),
            "p_B" => ("A.B", format!(".{}", self.name)),
            _ => ("A", String::new()),
        }
    }

    /// The file of a law: one parameter for the height of each knot.
    fn law(&self, name: &str, shape: &UnnamedShape, knots: usize, [lo, hi]: [f64; 2]) -> String {
        let force = shape.response.starts_with("force");
        let (unit, acts_on) = if force { ("N", "force") } else { ("um", "error") };
        let with = self.factor.map_or_else(String::new, |f| format!(", {f} = 1"));
        let at = |i: usize| lo + (hi - lo) * i.min(knots - 1) as f64 / (knots - 1) as f64;
        let mut parameters = String::new();
        for i in 0..knots {
            let hat = [at(i.saturating_sub(1)), at(i), at(i + 1)];
            // Writing to a String does not fail.
            let _ = writeln!(
                parameters,
                "  {{ name = \"{unit}_{i}\", unit = \"{unit}\", terms = [{{ hat = {hat:?}, of = \"{}\"{with} }}] }},",
                self.key
            );
        }
        let (over, naming) = (&self.over, self.naming().0);
        format!(
            "# Unexplained: a bounded curve that stands for structure which no effect explains.\n[[law]]\nname = \"{name}\"\n\
             naming = \"{naming}\"\nacts_on = \"{acts_on}\"\nlaw = \"unexplained: a broken line over {over}, constant beyond \
             its ends\"\ncause = \"unexplained ({})\"\nexperiment = \"repeat the run with {over} varied by itself\"\n\
             parameters = [\n{parameters}]\n",
            shape.manner
        )
    }
}

/// A stand-in for a shape, with this number of knots; the model adopts its law.
pub(crate) fn stand_in(
    shape: &UnnamedShape,
    knots: usize,
    train: &[Record],
    model: &mut Machine,
) -> Option<UnexplainedCurveLaw> {
    let along = CurveVariable::of(shape)?;
    let range = along.range(train)?;
    let name = format!("unexplained_{}", shape.against.join("_").replace('.', "_"));
    let laws = model.add_project_laws(LAWS_FILE, &along.law(&name, shape, knots, range)).ok()?;
    let mut effect = model.dictionary().effect(&format!("{name}.{}{}", along.axis, along.naming().1)).ok()?;
    effect.delta =
        along.sensor.map(|sensor| TemperatureDifference { sensor, against: ReferenceTemperature::Standard });
    Some(UnexplainedCurveLaw { effect, laws })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::{axis, record};
    use rtec_model::record::span;

    fn shape(against: &[&str], manner: &str) -> UnnamedShape {
        let against = against.iter().map(|a| (*a).to_owned()).collect();
        UnnamedShape { response: "error.x".into(), against, manner: manner.into() }
    }

    /// With heights at its knots, a stand-in is a broken line, constant beyond.
    /// The model reads it back.
    #[test]
    fn a_stand_in_is_a_broken_line_that_the_model_reads_again() {
        let train = [record(200, |i| i)];
        let mut model = Machine::ideal("m");
        let mut stand_in = stand_in(&shape(&["position.x"], "smooth"), 3, &train, &mut model).unwrap();
        stand_in.effect.set_values(&[1.0, -2.0, 4.0]).unwrap();
        let p = train[0].data(&Role::Position(axis())).unwrap();
        let [lo, hi] = span(p);
        let mut sum = vec![0.0; p.len()];
        stand_in.effect.add(&train[0], &Role::Error(axis()), &mut sum).unwrap();
        for (p, e) in p.iter().zip(&sum) {
            let u = 2.0 * (p - lo) / (hi - lo);
            let want = if u < 1.0 { 1.0 - 3.0 * u } else { -2.0 + 6.0 * (u - 1.0) };
            assert!((e - want).abs() < 1e-9, "at {p}: {e}, not {want}");
        }
        assert!(stand_in.laws.contains("unexplained_position_x"));
    }

    #[test]
    fn the_sign_of_a_velocity_is_a_direction_and_the_cycle_is_read_by_no_law() {
        let signed =
            CurveVariable::of(&shape(&["velocity.x", "position.x"], "sign of the velocity times position"));
        assert_eq!(signed.map(|a| (a.key, a.factor)), Some(("p", Some("dir"))));
        let wet =
            CurveVariable::of(&shape(&["spindle_speed", "coolant"], "spindle speed while the coolant is on"))
                .unwrap();
        assert_eq!((wet.key, wet.factor), ("rpm", Some("wet")));
        assert!(CurveVariable::of(&shape(&["cycle"], "smooth")).is_none());
        let warm = CurveVariable::of(&shape(&["position.x", "temperature.T3"], "in proportion")).unwrap();
        assert_eq!((warm.key, warm.factor, warm.sensor.as_deref()), ("dT", Some("p"), Some("T3")));
    }
}
