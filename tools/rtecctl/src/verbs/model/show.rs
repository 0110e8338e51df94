//! `rtecctl model show` and `compare`: contents and differences of models.

use crate::prelude::*;
use crate::uncertainty_rounding::alike;
use crate::verbs::input_notices;
use rtec_files::date;
use rtec_measure::plausible;
use rtec_model::effect::Effect;
use rtec_model::kinematic_chain::{self, COMPONENTS, KinematicChain, PolynomialTerm};
use rtec_model::machine::{FitNote, Machine};
use std::collections::BTreeMap;

/// Show a model: effects, parameters, intervals, where they come from, how long they hold
#[derive(Debug, clap::Args)]
pub(crate) struct ShowArgs {
    /// The machine model
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Compare two models, effect by effect, and on a record what they predict
#[derive(Debug, clap::Args)]
pub(crate) struct CompareArgs {
    /// The first model
    first: PathBuf,
    /// The second model
    second: PathBuf,
    /// Compare their predictions on this record too
    #[arg(long, value_name = "NAME.run.toml")]
    record: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn show(args: &ShowArgs) -> anyhow::Result<()> {
    let machine = match Machine::read(&args.machine) {
        Ok(machine) => machine,
        Err(error) => {
            // The file may be a chain itself, which models name as `chain`.
            let Ok(chain) = KinematicChain::read(&args.machine) else { return Err(error.into()) };
            if args.json {
                return say_pretty(&json!({"chain": chain.to_json()}));
            }
            print!("{}", chain_text(&chain));
            return Ok(());
        }
    };
    for warning in machine.doubts(date::today()) {
        eprintln!("warning: {}: {warning}", args.machine.display());
    }
    if args.json {
        return say_pretty(&machine.to_json());
    }
    println!("{}", machine.name());
    if machine.listed().is_empty() && machine.chain().is_none() {
        let next = "`rtecctl model fit` or `rtecctl reconcile` find them";
        eprintln!("rtecctl: no effects: an ideal machine; {next}");
    }
    for l in machine.listed() {
        let delta = l.effect.delta.as_ref().map_or(String::new(), |d| format!(" ({})", d.in_full()));
        println!("{}{delta}", l.effect.name());
        println!("    {}", l.effect.description().law);
        for (i, p) in l.effect.description().parameters.iter().enumerate() {
            let interval = l.provenance.interval.get(&p.name);
            for (k, v) in l.effect.get(i).iter().enumerate() {
                let name = if k == 0 { p.name.as_str() } else { "" };
                println!("    {name:14} {}", parameter(*v, &p.unit, interval.map(|i| i[k])));
            }
        }
        if let Some([lo, hi]) = l.effect.range_k {
            println!("    fitted on ΔT from {lo:.2} to {hi:.2} K");
        }
        if l.provenance.set_up {
            println!(
                "    the zero of the gauges in these records: predicted for runs of their kind and place, never corrected live"
            );
        }
        if let Some(by) = &l.provenance.added_by {
            let from = list(l.provenance.from.iter().map(|s| &s.file));
            println!("    by {by} {} from {from}", l.provenance.date.as_deref().unwrap_or(""));
        }
    }
    if let Some(chain) = machine.chain() {
        print!("{}", chain_text(chain));
    }
    for FitNote { response, date, valid_until, rms_um, half_width_um, by_kind_um, .. } in machine.fits() {
        let unit = FitNote::unit_of(response);
        println!(
            "{response}: fitted {date}, good until {valid_until}; {rms_um:.3} {unit} RMS on unseen blocks, 95 % within \
             ±{half_width_um:.3} {unit}"
        );
        if by_kind_um.len() > 1 {
            let of = |(kind, width): (&String, &f64)| format!("{kind} ±{width:.3} {unit}");
            println!("    by kind of run: {}", list(by_kind_um.iter().map(of)));
        }
    }
    Ok(())
}

/// A value with its unit and the bounds of its interval, rounded accordingly.
fn parameter(v: f64, unit: &str, interval: Option<[f64; 2]>) -> String {
    match interval {
        Some([low, high]) if high > low => {
            let [v, low, high] = alike([v, low, high]);
            format!("{v} {unit}  [{low}, {high}]")
        }
        Some([low, high]) => format!("{} {unit}  [{}, {}]", short(v), short(low), short(high)),
        None => format!("{} {unit}", short(v)),
    }
}

/// A chain: its joints in order from the bed, with their components.
/// Components that are not zero are written term by term.
fn chain_text(chain: &KinematicChain) -> String {
    let [x, y, z] = chain.tool_mm.map(short);
    let mut text = format!("chain to a tool point at {x}, {y}, {z} mm of the last frame\n");
    for joint in &chain.joints {
        let [x, y, z] = joint.offset_mm.map(short);
        let _ = write!(text, "{} ({}), offset {x}, {y}, {z} mm", joint.name, joint.branch.name());
        if let Some((axis, along)) = &joint.axis {
            let [x, y, z] = along.map(short);
            let _ = write!(text, ", moved by {axis} along {x}, {y}, {z}");
        }
        text.push('\n');
        for c in &joint.components {
            let (kind, unit) = (COMPONENTS[c.kind], kinematic_chain::unit(c.kind));
            let terms = c.terms.iter().map(term).collect::<Vec<_>>().join(" ");
            let delta = c.delta.as_ref().map_or(String::new(), |d| format!("   ΔT = {}", d.in_full()));
            let _ = writeln!(text, "    {kind} = {terms} {unit}{delta}");
        }
    }
    text
}

/// One term, as +1.15·(p/100 mm)·ΔT.
fn term(t: &PolynomialTerm) -> String {
    let power = |what: &str, n: u8| match n {
        0 => String::new(),
        1 => format!("·{what}"),
        n => format!("·{what}^{n}"),
    };
    let sign = if t.coefficient < 0.0 { '-' } else { '+' };
    let size = short(t.coefficient.abs());
    format!("{sign}{size}{}{}", power("(p/100 mm)", t.position), power("ΔT", t.temperature))
}

pub(crate) fn compare(args: &CompareArgs) -> anyhow::Result<()> {
    let (a, b) = (Machine::read(&args.first)?, Machine::read(&args.second)?);
    // Only values differ within one identity: effects of one identity are the same effect.
    let of = |m: &Machine| m.effects().map(|e| (e.identity(), e.clone())).collect::<BTreeMap<_, _>>();
    let (left, right) = (of(&a), of(&b));
    let mut rows = Vec::new();
    for (id, e) in &left {
        match right.get(id) {
            None => rows.push(json!({"effect": id, "change": "only in the first"})),
            Some(f) if f == e => {}
            Some(f) => {
                for (i, p) in e.description().parameters.iter().enumerate() {
                    if e.get(i) != f.get(i) {
                        rows.push(json!({"effect": id, "change": "parameter", "parameter": p.name,
                                         "first": e.get(i), "second": f.get(i)}));
                    }
                }
                if e.range_k != f.range_k || e.delta != f.delta {
                    rows.push(json!({"effect": id, "change": "range or reference"}));
                }
            }
        }
    }
    let only_second = right.keys().filter(|id| !left.contains_key(*id));
    rows.extend(only_second.map(|id| json!({"effect": id, "change": "only in the second"})));
    let mut predictions = Vec::new();
    if let Some(path) = &args.record {
        let record =
            plausible::only_good(rtec_measure::run_record_files::read(path)?, &mut input_notices::say);
        let of = |m: &Machine| {
            rtec_measure::motion_from_positions::predict(m, &record).map(|(prediction, _)| prediction)
        };
        let (pa, pb) = (of(&a)?, of(&b)?);
        for (column, ((name, x), (_, y))) in record.responses().zip(pa.columns.iter().zip(&pb.columns)) {
            let rms =
                |v: &mut dyn Iterator<Item = f64>| (v.map(|d| d * d).sum::<f64>() / x.len() as f64).sqrt();
            let left = |p: &[f64]| rms(&mut column.data.iter().zip(p).map(|(m, p)| m - p));
            let apart = x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
            predictions.push(json!({
                "response": column.role.to_string(), "column": name, "rms_first": left(x), "rms_second": left(y),
                "rms_apart": rms(&mut x.iter().zip(y).map(|(x, y)| x - y)), "most_apart": apart,
            }));
        }
    }
    if args.json {
        return say_pretty(&json!({"differences": rows, "predictions": predictions}));
    }
    if rows.is_empty() {
        println!("the same effects with the same parameters");
    }
    for r in &rows {
        let values = match (&r["first"], &r["second"]) {
            (Value::Null, _) => String::new(),
            (a, b) => format!(": {} -> {}", figures(a), figures(b)),
        };
        let what = r["parameter"].as_str().or(r["change"].as_str()).unwrap_or_default();
        let id = r["effect"].as_str().unwrap_or_default();
        let name = left.get(id).or_else(|| right.get(id)).map_or_else(String::new, named);
        println!("{name:40} {what}{values}");
    }
    if let Some(record) = args.record.as_ref().filter(|_| !predictions.is_empty()) {
        println!("on {}, RMS in the response's unit:", record.display());
        println!("                  left by 1st  left by 2nd        apart   most apart");
    }
    for p in &predictions {
        let [first, second, apart, most] = ["rms_first", "rms_second", "rms_apart", "most_apart"]
            .map(|key| p[key].as_f64().unwrap_or_default());
        let response = p["response"].as_str().unwrap_or_default();
        println!("{response:16} {first:12.3} {second:12.3} {apart:12.3} {most:12.3}");
    }
    Ok(())
}

/// An effect's identity for people, with few digits.
fn named(effect: &Effect) -> String {
    let apart = effect.description().parameters.iter().enumerate().filter(|(_, p)| p.tells_apart);
    apart.fold(effect.identity(), |id, (i, p)| {
        let values: Vec<String> = effect.get(i).iter().map(|v| short(*v)).collect();
        id.replace(&format!("{}={:?}", p.name, effect.get(i)), &format!("{}={}", p.name, values.join(" ")))
    })
}

/// Numbers in a form for people.
fn figures(value: &Value) -> String {
    match value {
        Value::Array(all) => all.iter().map(figures).collect::<Vec<_>>().join(" "),
        Value::Number(n) => n.as_f64().map_or_else(|| n.to_string(), short),
        other => other.to_string(),
    }
}

/// Five significant digits, or a whole number's own; without trailing zeros.
fn short(v: f64) -> String {
    if v != 0.0 && !(1e-4..1e7).contains(&v.abs()) {
        return format!("{v:.4e}");
    }
    let before = if v == 0.0 { 0 } else { v.abs().log10().floor() as i32 };
    let digits = (4 - before).clamp(0, 8) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_digits_that_they_are_known_to() {
        assert_eq!(
            parameter(-0.000_812_345, "um/K2", Some([-0.000_83, -0.000_79])),
            "-0.000812 um/K2  [-0.000830, -0.000790]"
        );
        assert_eq!(parameter(12.345_678, "ppm", Some([12.1, 12.6])), "12.35 ppm  [12.10, 12.60]");
        assert_eq!(parameter(25_100.4, "s", Some([21_000.0, 29_000.0])), "25100 s  [21000, 29000]");
        assert_eq!(parameter(0.001_234_56, "um/K", None), "0.0012346 um/K");
        for (v, text) in [
            (0.0, "0"),
            (54.0, "54"),
            (-7.25, "-7.25"),
            (3.45 / 3.0, "1.15"),
            (3.0e-7, "3.0000e-7"),
            (123_456.7, "123457"),
        ] {
            assert_eq!(short(v), text);
        }
    }

    /// A coefficient that came out of a fit, and one typed by a person.
    #[test]
    fn a_chain_s_terms_are_short() {
        let term = |coefficient| super::term(&PolynomialTerm { position: 1, temperature: 0, coefficient });
        assert_eq!(term(0.123_456_789_012_345_6), "+0.12346·(p/100 mm)");
        assert_eq!(term(-1.15), "-1.15·(p/100 mm)");
    }
}
