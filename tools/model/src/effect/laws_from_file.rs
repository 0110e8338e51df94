//! A project's own effects: laws given by a file instead of code.
//!
//! Each parameter is linear. It multiplies a sum of products of the inputs, each to a whole power. A product
//! may have the sine or cosine of a multiple of the angle.
//! A product may also have a hat over one input: `hat = [20.0, 25.0, 30.0], of = "t"` is 0 at the ends and 1
//! in the middle. Two equal numbers at a side mean 1 from there on.
//! That covers a machine's usual cross terms. Such a law is fitted like any built-in law, and cannot fail at
//! run time.
//!
//! ```toml
//! [[law]]
//! name = "quill_droop"
//! naming = "A.B"                # A, A.B, A.B.C or A.NAME
//! acts_on = "error"             # or "force"
//! law = "e_A = um·(p_B/100)²"   # for people
//! cause = "the quill bends under its own weight"
//! experiment = "a straightedge read at several depths"
//! parameters = [{ name = "um", unit = "um", plausible = 50.0, terms = [{ factor = 1e-4, p_B = 2 }] }]
//! ```

use super::{
    AffectedQuantity, Dictionary, Effect, EffectMemory, EffectNameAxes, Input, Law, LawDescription,
    LawParameter, Out, RequiredInput, laws,
};
use rtec_files::InputError;
use rtec_files::strict_toml::{Document, Table, TomlKeyValue};
use std::path::Path;
use std::sync::Arc;

type Read = fn(&Input) -> f64;

/// The inputs that a term may read, by key.
const QUANTITIES: [(&str, RequiredInput, Read); 13] = [
    ("p", RequiredInput::Position(0), |i| i.p_mm[0]),
    ("p_B", RequiredInput::Position(1), |i| i.p_mm[1]),
    ("p_C", RequiredInput::Position(2), |i| i.p_mm[2]),
    ("t", RequiredInput::Time, |i| i.t_s),
    ("dir", RequiredInput::Direction, |i| i.dir),
    ("v", RequiredInput::Velocity, |i| i.v_mm_s),
    ("a", RequiredInput::Acceleration, |i| i.a_mm_s2),
    ("load", RequiredInput::Load, |i| i.load_n),
    ("dT", RequiredInput::Delta, |i| i.delta_k),
    ("rpm", RequiredInput::SpindleSpeed, |i| i.rpm),
    ("wet", RequiredInput::Coolant, |i| f64::from(i.coolant > 0.5)),
    ("angle", RequiredInput::Angle, |i| i.angle_rad),
    ("channel", RequiredInput::Channel, |i| i.channel),
];

#[derive(Debug)]
struct InputPower {
    read: Read,
    power: i32,
}

#[derive(Debug)]
struct ProductTerm {
    factor: f64,
    powers: Vec<InputPower>,
    /// cos(n·angle) or sin(n·angle): n, and whether it is the cosine.
    harmonic: Option<(f64, bool)>,
    hat: Option<(Read, [f64; 3])>,
}

#[derive(Debug)]
struct FileLaw {
    description: LawDescription,
    /// Terms of each parameter.
    terms: Vec<Vec<ProductTerm>>,
}

impl Law for FileLaw {
    fn describe(&self) -> &LawDescription {
        &self.description
    }

    fn basis(&self, _: &Effect, now: &Input, _: usize, _: &mut EffectMemory, out: Out<'_>) {
        for (o, terms) in out.iter_mut().zip(&self.terms) {
            *o = terms.iter().map(|t| t.value(now)).sum();
        }
    }
}

impl ProductTerm {
    fn value(&self, now: &Input) -> f64 {
        let product: f64 = self.powers.iter().map(|f| (f.read)(now).powi(f.power)).product();
        let wave = self.harmonic.map_or(1.0, |(n, cosine)| {
            let angle = n * now.angle_rad;
            if cosine { angle.cos() } else { angle.sin() }
        });
        let hat = self.hat.map_or(1.0, |(read, [from, top, to])| {
            let x = read(now);
            if x < top {
                if from < top { ((x - from) / (top - from)).max(0.0) } else { 1.0 }
            } else if top < to {
                ((to - x) / (to - top)).max(0.0)
            } else {
                1.0
            }
        });
        self.factor * product * wave * hat
    }
}

impl Dictionary {
    /// Adds the laws of a project's own file, from its text; `path` is for messages.
    ///
    /// # Errors
    /// The first finding, with file, line and column: a name that is taken, a quantity that does not suit the naming,
    /// an unknown key.
    pub fn add_own(&mut self, path: &Path, text: &str) -> Result<(), InputError> {
        let doc = Document::parse(path, text)?;
        let root = doc.root();
        root.only(&["law"])?;
        for t in root.required("law", "[[law]] tables")?.tables("[[law]] tables")? {
            let name = t.required("name", "the law's name")?;
            let law = read_law(t, &name)?;
            self.insert(Arc::new(law)).map_err(|e| name.error(e.found, e.expected))?;
        }
        Ok(())
    }
}

fn read_law(t: Table<'_>, name: &TomlKeyValue<'_>) -> Result<FileLaw, InputError> {
    t.only(&["name", "naming", "acts_on", "law", "cause", "experiment", "parameters"])?;
    let id = name.str("the law's name")?;
    if id.is_empty() || id.contains(['.', ' ']) {
        return Err(name.error(format!("`{id}`"), "a name without points and spaces"));
    }
    let text =
        |key: &str, expected: &str| Ok::<_, InputError>(t.required(key, expected)?.str(expected)?.to_owned());
    let naming_entry = t.required("naming", "naming = \"A\", \"A.B\", \"A.B.C\" or \"A.NAME\"")?;
    let (naming, axes) = match naming_entry.str("a naming")? {
        "A" => (EffectNameAxes::One, 1),
        "A.B" => (EffectNameAxes::Two, 2),
        "A.B.C" => (EffectNameAxes::Three, 3),
        "A.NAME" => (EffectNameAxes::Channel, 1),
        other => return Err(naming_entry.error(format!("`{other}`"), "A, A.B, A.B.C or A.NAME")),
    };
    let quantity = match t.get("acts_on").map(|e| (e, e.str("error or force"))) {
        None | Some((_, Ok("error"))) => AffectedQuantity::Error,
        Some((_, Ok("force"))) => AffectedQuantity::Force,
        Some((e, _)) => return Err(e.error(e.text(), "\"error\" or \"force\"")),
    };
    let mut needs: Vec<RequiredInput> = Vec::new();
    let mut parameters = Vec::new();
    let mut terms = Vec::new();
    let form = "parameters = [{ name, unit, plausible, terms = [{ factor, p = 1, … }] }]";
    for p in t.required("parameters", form)?.tables(form)? {
        p.only(&["name", "unit", "plausible", "bounds", "terms"])?;
        let word = |key: &str| Ok::<_, InputError>(p.required(key, form)?.str(form)?.to_owned());
        let plausible =
            p.get("plausible").map_or(Ok(f64::INFINITY), |e| e.positive("the largest plausible value"))?;
        let parameter = LawParameter::linear(&word("name")?, &word("unit")?, plausible);
        parameters.push(match p.get("bounds") {
            Some(e) => parameter.within(e.pair("bounds = [lowest, highest]")?, "the law's own bounds"),
            // A hundred times the plausible value means another unit.
            None if plausible.is_finite() => {
                parameter.within([-100.0 * plausible, 100.0 * plausible], "a hundred times what is plausible")
            }
            None => parameter.within([-1e12, 1e12], "no law of a machine is that steep"),
        });
        let mut own = Vec::new();
        for term in p.required("terms", form)?.tables(form)? {
            own.push(read_term(term, naming, axes, &mut needs)?);
        }
        terms.push(own);
    }
    if parameters.is_empty() {
        return Err(name.error(format!("law `{id}` without parameters"), form));
    }
    let companion = needs.contains(&RequiredInput::Delta).then_some(laws::offset::NAME);
    let description = LawDescription {
        name: id.to_owned(),
        law: text("law", "the formula, for people")?,
        cause: text("cause", "what stands behind it in the machine")?,
        naming,
        quantity,
        parameters,
        needs,
        experiment: text("experiment", "the run that shows it")?,
        companion,
        ..LawDescription::default()
    };
    Ok(FileLaw { description, terms })
}

fn read_term(
    t: Table<'_>,
    naming: EffectNameAxes,
    axes: usize,
    needs: &mut Vec<RequiredInput>,
) -> Result<ProductTerm, InputError> {
    let mut term = ProductTerm { factor: 1.0, powers: Vec::new(), harmonic: None, hat: None };
    let (mut corners, mut over) = (None, None);
    for e in t.entries() {
        match e.key() {
            "factor" => term.factor = e.number("a number")?,
            key @ ("cos" | "sin") => {
                term.harmonic = Some((e.number("a multiple of the angle")?, key == "cos"));
                if !needs.contains(&RequiredInput::Angle) {
                    needs.push(RequiredInput::Angle);
                }
            }
            "hat" => {
                let v = e.numbers("hat = [from, top, to]")?;
                corners = match v[..] {
                    [from, top, to] if from <= top && top <= to && from < to => Some((e, [from, top, to])),
                    _ => {
                        return Err(
                            e.error(format!("{v:?}"), "three numbers that do not fall, as [0.0, 1.0, 2.0]")
                        );
                    }
                };
            }
            "of" => over = Some(read_quantity(&e, e.str("what the hat is over")?, naming, axes, needs)?),
            key => {
                let read = read_quantity(&e, key, naming, axes, needs)?;
                let power = e.number("a whole power from 1 to 8")?;
                if power.fract() != 0.0 || !(1.0..=8.0).contains(&power) {
                    return Err(e.error(power.to_string(), "a whole power from 1 to 8"));
                }
                term.powers.push(InputPower { read, power: power as i32 });
            }
        }
    }
    term.hat = match (corners, over) {
        (Some((_, corners)), Some(read)) => Some((read, corners)),
        (None, None) => None,
        (Some((e, _)), None) => {
            return Err(e.key_error("`hat` alone", "of = \"t\" or another quantity beside it"));
        }
        (None, Some(_)) => return Err(t.error("`of` alone", "hat = [from, top, to] beside it")),
    };
    Ok(term)
}

/// Finds a quantity by its key and adds what it needs to `needs`.
fn read_quantity(
    e: &TomlKeyValue<'_>,
    key: &str,
    naming: EffectNameAxes,
    axes: usize,
    needs: &mut Vec<RequiredInput>,
) -> Result<Read, InputError> {
    let Some((_, need, read)) = QUANTITIES.iter().find(|q| q.0 == key) else {
        let known = QUANTITIES.map(|q| q.0).join(", ");
        return Err(e.unknown_key(&format!("factor, cos, sin, hat with of, or one of {known}")));
    };
    let suits = match need {
        RequiredInput::Position(n) => *n < axes,
        RequiredInput::Channel => naming == EffectNameAxes::Channel,
        _ => true,
    };
    if !suits {
        return Err(e.key_error(format!("`{key}`"), "what the law's naming provides"));
    }
    if !needs.contains(need) {
        needs.push(*need);
    }
    Ok(*read)
}
