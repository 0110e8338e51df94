//! One blind case: the files for the reconciler, and the truth.

use crate::bounds::beyond;
use crate::dice::Dice;
use crate::plan::{DESIGNS, Manner, Plan};
use crate::run::Run;
use crate::source::Source;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Number and kind of the hidden effects.
#[derive(Clone, Copy, PartialEq, Eq, Debug, PartialOrd, Ord)]
pub enum Hides {
    /// Nothing is hidden: the model is complete.
    Nothing,
    /// One effect of the dictionary.
    One,
    /// Two effects of the dictionary.
    Two,
    /// A shape outside the dictionary.
    Stranger,
    /// Three effects or more.
    Many,
}

/// The laws that a case can hide.
pub const LAWS: [&str; 30] = [
    "offset",
    "scale",
    "position_map",
    "screw_periodic",
    "subdivision",
    "reversal",
    "reversal_spike",
    "straightness",
    "squareness",
    "rotation",
    "angular",
    "thermal_expansion",
    "thermal_growth",
    "thermal_lag",
    "warm_up",
    "coolant",
    "spindle_speed",
    "following_error",
    "acceleration_error",
    "stiffness",
    "lost_counts",
    "probe_latency",
    "probe_lobing",
    "form_bump",
    "channel",
    "inertia",
    "friction_viscous",
    "friction_coulomb",
    "friction_asymmetric",
    "force_offset",
];

/// A case with its files.
pub struct Case {
    /// Seed that makes the same case again.
    pub seed: u64,
    /// Number and kind of the hidden effects.
    pub hides: Hides,
    /// Names that the answer must give.
    pub truth: Vec<String>,
    /// Ratio of each hidden effect's RMS to the noise.
    pub snr: Vec<f64>,
    /// Other sets of names that are accepted.
    pub also: Vec<Vec<String>>,
    /// Name of the experiment, one of [`crate::plan::DESIGNS`].
    pub design: &'static str,
    /// One line on noise, model and size.
    pub story: String,
    /// Sidecars of the training records.
    pub train: Vec<PathBuf>,
    /// Sidecars of the hold-outs.
    pub holdout: Vec<PathBuf>,
    /// The model without the hidden effects.
    pub model: PathBuf,
}

pub(crate) struct Noise {
    pub(crate) sd: f64,
    pub(crate) phi: f64,
    pub(crate) phi2: f64,
    pub(crate) quantum: Option<f64>,
}

impl Noise {
    pub(crate) fn series(&self, n: usize, dice: &mut Dice) -> Vec<f64> {
        let (mut a, mut b) = (0.0, 0.0);
        let mut raw: Vec<f64> = (0..n + 200)
            .map(|_| {
                let x = self.phi * a + self.phi2 * b + dice.normal();
                b = a;
                a = x;
                x
            })
            .collect();
        raw.drain(..200);
        // Scaled by the theoretical variance, so a short run may be quieter or louder.
        let var = (1.0 - self.phi2) / ((1.0 + self.phi2) * ((1.0 - self.phi2).powi(2) - self.phi * self.phi));
        raw.into_iter().map(|x| x * self.sd / var.sqrt()).collect()
    }
}

pub(crate) fn rms(v: &[f64]) -> f64 {
    (v.iter().map(|x| x * x).sum::<f64>() / v.len().max(1) as f64).sqrt()
}

/// Slope of a straight line in time that is put down to the instrument, µm/h.
const LINE_UM_PER_H: f64 = 2.0;

/// An error without the part that belongs to the record's set-up.
/// That part is the instrument's zero, the centre of a circle, and a slow line in time.
fn beside_set_up(run: &Run, v: &[f64]) -> Vec<f64> {
    let mut terms = vec![vec![1.0; v.len()]];
    if let Some(angle) = run.get("angle") {
        terms.push(angle.iter().map(|a| a.cos()).collect());
        terms.push(angle.iter().map(|a| a.sin()).collect());
    }
    let mut beside: Vec<Vec<f64>> = Vec::new();
    for mut term in terms {
        for other in &beside {
            take_out(&mut term, other, f64::MAX);
        }
        beside.push(term);
    }
    let mut left = v.to_vec();
    for term in &beside {
        take_out(&mut left, term, f64::MAX);
    }
    if let Some(t) = run.get("time") {
        let mut line = t.to_vec();
        for term in &beside {
            take_out(&mut line, term, f64::MAX);
        }
        take_out(&mut left, &line, LINE_UM_PER_H / 3600.0);
    }
    left
}

/// Subtracts the projection on a term, with a factor of at most `most`.
fn take_out(v: &mut [f64], term: &[f64], most: f64) {
    let along: f64 = v.iter().zip(term).map(|(x, t)| x * t).sum();
    let square: f64 = term.iter().map(|t| t * t).sum();
    if square > 1e-12 {
        let share = (along / square).clamp(-most, most);
        v.iter_mut().zip(term).for_each(|(x, t)| *x -= share * t);
    }
}

/// RMS of a source over the responses it changes, without the set-up's part.
/// The RMS of a constant includes its mean.
fn size(s: &Source, runs: &[Run]) -> f64 {
    let mut all = vec![];
    for r in runs {
        for resp in &r.responses {
            let v = s.on(r, resp);
            if v.iter().any(|x| *x != 0.0) {
                all.extend(if s.name.contains("offset") { v } else { beside_set_up(r, &v) });
            }
        }
    }
    rms(&all)
}

pub(crate) fn write_run(
    dir: &Path,
    stem: &str,
    run: &Run,
    responses: &[Vec<f64>],
    quantum: Option<f64>,
    manner: Manner,
) -> anyhow::Result<PathBuf> {
    let names: Vec<String> = run
        .responses
        .iter()
        .enumerate()
        .map(|(i, r)| {
            if manner == Manner::Second {
                format!("meas-{i}")
            } else {
                r.replace("error.", "e_").replace("force.", "f_")
            }
        })
        .collect();
    let logged: Vec<_> = run.cols.iter().filter(|c| c.logged).collect();
    let mut side = format!("file = \"{stem}.csv\"\nkind = \"{}\"\n", run.kind);
    if let Some(q) = quantum {
        writeln!(side, "count_um = {q:?}")?;
    }
    if let Some(zero) = &run.zero {
        writeln!(side, "zero = \"{zero}\"")?;
    }
    if run.kind == "positioning" {
        // These runs turn where they read. One that does not say so shows no spike at its first target.
        side += "turns = \"at_target\"\n";
    }
    if let Some((length, [a, b])) = &run.bar {
        writeln!(side, "radius_mm = {length:?}\nplane = [\"{a}\", \"{b}\"]")?;
    }
    side += "[columns]\n";
    for c in &logged {
        writeln!(side, "\"{}\" = {{ role = \"{}\", unit = \"{}\" }}", c.name, c.role, c.unit)?;
    }
    for (n, r) in names.iter().zip(&run.responses) {
        let unit = if r.starts_with("force") { "N" } else { "um" };
        writeln!(side, "\"{n}\" = {{ role = \"{r}\", unit = \"{unit}\" }}")?;
    }
    let mut csv = logged.iter().map(|c| c.name.clone()).chain(names).collect::<Vec<_>>().join(",") + "\n";
    for i in 0..run.n {
        let row = logged
            .iter()
            .map(|c| format!("{}", c.v[i]))
            .chain(responses.iter().map(|r| format!("{:.5}", r[i])));
        csv += &(row.collect::<Vec<_>>().join(",") + "\n");
    }
    std::fs::write(dir.join(format!("{stem}.csv")), csv)?;
    let path = dir.join(format!("{stem}.run.toml"));
    std::fs::write(&path, side)?;
    Ok(path)
}

/// Whether a machine can have this source.
pub(crate) fn physical(s: &Source) -> bool {
    let law = s.name.split('.').next().unwrap_or_default();
    let plausible = |(of, key, lo, hi): &(&str, &str, f64, f64)| {
        *of != law || !s.has(key) || (*lo..=*hi).contains(&s.val(key).abs())
    };
    beyond(&s.name, &|key| s.has(key).then(|| s.val(key))).is_empty() && PLAUSIBLE.iter().all(plausible)
}

/// Limits of hidden effects: law, parameter, lowest and highest size.
/// They hold even where the noise would show more.
const PLAUSIBLE: [(&str, &str, f64, f64); 5] = [
    // A servo that deviates by 50 µm at a tenth of g.
    ("acceleration_error", "um_per_m_s2", 0.0, 50.0),
    // A guideway that turns by a milliradian per metre.
    ("angular", "urad_per_m", 0.0, 1000.0),
    // A drive is wound up within some millimetres.
    ("reversal_spike", "length_mm", 0.0, 10.0),
    // Warming takes minutes.
    ("warm_up", "tau_s", 60.0, f64::MAX),
    ("thermal_lag", "tau_s", 60.0, f64::MAX),
];

/// Makes a case and writes it into `dir`.
/// `law` chooses the effect where the case hides one.
///
/// # Errors
/// When the directory cannot be written.
pub fn make(seed: u64, hides: Hides, law: Option<&str>, manner: Manner, dir: &Path) -> anyhow::Result<Case> {
    let mut dice = Dice::new(seed);
    loop {
        let design = *dice.pick(&DESIGNS);
        let plan = Plan::new(&mut dice, design, manner);
        let records = if dice.chance(0.15) { 2 } else { 1 };
        let runs: Vec<Run> = (0..records).map(|k| plan.run(k)).collect();
        let held: Vec<Run> = if dice.chance(0.6) { vec![plan.run(77)] } else { vec![] };
        let mut hidden: Vec<Source> = vec![];
        match hides {
            Hides::Nothing => {}
            Hides::Many => anyhow::bail!("many effects come from the class `many`"),
            Hides::One => hidden.extend(plan.source(
                &mut dice,
                &runs[0],
                law.unwrap_or_else(|| LAWS[seed as usize % LAWS.len()]),
            )),
            Hides::Two => {
                let first = law.unwrap_or_else(|| LAWS[seed as usize % LAWS.len()]);
                let second = *dice.pick(&LAWS);
                hidden.extend(plan.source(&mut dice, &runs[0], first));
                hidden.extend(plan.source(&mut dice, &runs[0], second));
                if hidden.len() < 2 || hidden[0].name == hidden[1].name || too_alike(&hidden, &runs) {
                    continue;
                }
            }
            Hides::Stranger => hidden.extend(plan.stranger(&mut dice, &runs[0])),
        }
        if hidden.is_empty() && hides != Hides::Nothing {
            continue;
        }
        let noise = Noise {
            sd: dice.log(0.15, 4.0),
            phi: if dice.chance(0.45) { dice.within(0.2, 0.7) } else { 0.0 },
            phi2: if manner == Manner::Second && dice.chance(0.3) { -0.15 } else { 0.0 },
            quantum: None,
        };
        let noise = Noise { quantum: dice.chance(0.35).then(|| noise.sd * dice.log(0.1, 1.2)), ..noise };
        let floor = if hides == Hides::Two { 3.0 } else { 0.7 };
        let mut snr = vec![];
        let mut good = true;
        for s in &mut hidden {
            s.level(&runs);
            let ratio = dice.log(floor, 10.0);
            let now = size(s, &runs);
            good &= now > 0.0;
            s.scale(ratio * noise.sd / now.max(1e-12));
            if s.name.starts_with("lost_counts") && noise.quantum.is_some() {
                let q = noise.quantum.unwrap_or(1.0);
                let v = s.val("um");
                let whole = (v / q).round().abs().max(1.0) * q * v.signum();
                s.scale(whole / v);
            }
            snr.push(size(s, &runs) / noise.sd);
            good &= physical(s);
        }
        // A rival of the same name with other sensors is possible, but would ask the same name twice.
        if !good || snr.iter().any(|s| *s > 12.0 || *s < 0.9 * floor) {
            continue;
        }
        let mut known: Vec<Source> = vec![];
        for _ in 0..dice.int(0, 4) {
            let law = *dice.pick(&LAWS);
            if ["lost_counts", "channel", "form_bump"].contains(&law) {
                continue;
            }
            let Some(mut s) = plan.source(&mut dice, &runs[0], law) else { continue };
            s.level(&runs);
            let clash = hidden.iter().chain(&known).any(|h| h.name == s.name);
            let now = size(&s, &runs);
            if clash || now == 0.0 {
                continue;
            }
            s.scale(dice.log(1.0, 15.0) * noise.sd / now);
            if !physical(&s) {
                continue;
            }
            let mut with = hidden.clone();
            with.push(s.clone());
            // If the model's own effect looks like the hidden one, nothing would be missing.
            if with.len() > 1 && too_alike(&with, &runs) {
                continue;
            }
            known.push(s);
        }
        let mut model = String::from("name = \"blind\"\n\n");
        let share = *dice.pick(&[0.0, 0.02, 0.08]);
        for k in &known {
            let mut seen = k.clone();
            if dice.chance(0.7) {
                seen.off(&mut dice, share);
            }
            // A model states only values that a machine can have.
            model += &if physical(&seen) { seen } else { k.clone() }.toml();
        }
        let model_path = dir.join("machine.toml");
        std::fs::write(&model_path, &model)?;
        let mut put = |stem: &str, run: &Run| -> anyhow::Result<PathBuf> {
            let out: Vec<Vec<f64>> = run
                .responses
                .iter()
                .map(|resp| {
                    let mut e = noise.series(run.n, &mut dice);
                    for s in known.iter().chain(&hidden) {
                        e.iter_mut().zip(s.on(run, resp)).for_each(|(e, c)| *e += c);
                    }
                    if let Some(q) = noise.quantum {
                        e.iter_mut().for_each(|e| *e = (*e / q).round() * q);
                    }
                    e
                })
                .collect();
            write_run(dir, stem, run, &out, noise.quantum, manner)
        };
        let train = runs
            .iter()
            .enumerate()
            .map(|(k, r)| put(&format!("train{k}"), r))
            .collect::<Result<Vec<_>, _>>()?;
        let holdout = held.iter().map(|r| put("later", r)).collect::<Result<Vec<_>, _>>()?;
        let story = format!(
            "n {}x{} phi {:.2} q {:.2} known {:?} off {share} hidden {}",
            runs[0].n,
            records,
            noise.phi,
            noise.quantum.map_or(0.0, |q| q / noise.sd),
            known.iter().map(|k| k.name.as_str()).collect::<Vec<_>>(),
            hidden.iter().map(Source::in_words).collect::<String>(),
        );
        let truth_text: String = hidden.iter().chain(&known).map(Source::toml).collect();
        let names = hidden.iter().map(|h| &h.name).collect::<Vec<_>>();
        let told = serde_json::json!({ "hidden": names, "snr": snr, "story": story, "machine": truth_text });
        std::fs::write(dir.join("truth.json"), told.to_string())?;
        let truth = hidden.iter().map(|h| h.name.clone()).collect();
        return Ok(Case {
            seed,
            hides,
            truth,
            snr,
            also: vec![],
            design,
            story,
            train,
            holdout,
            model: model_path,
        });
    }
}

/// Whether two sources' shapes nearly coincide over these runs.
fn too_alike(sources: &[Source], runs: &[Run]) -> bool {
    let flat = |s: &Source| -> Vec<f64> {
        runs.iter()
            .flat_map(|r| r.responses.iter().flat_map(|resp| s.on(r, resp)).collect::<Vec<_>>())
            .collect()
    };
    let shapes: Vec<Vec<f64>> = sources.iter().map(flat).collect();
    (0..shapes.len()).any(|i| {
        (0..i).any(|j| {
            let (a, b) = (&shapes[i], &shapes[j]);
            let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
            let len = rms(a) * rms(b) * a.len() as f64;
            len == 0.0 || (dot / len).abs() > 0.9
        })
    })
}
