//! A case of the wider classes: runs, truth, model and files.

use crate::bench::Bench;
use crate::case::{Case, Hides, Noise, physical, rms, write_run};
use crate::dice::Dice;
use crate::plan::Manner;
use crate::rivals;
use crate::run::Run;
use crate::source::Source;
use std::path::Path;

/// Share of a shape above which a law of the dictionary explains it.
/// The shape then is a bad draw of that law.
const LIKE: f64 = 0.7;

/// The whole truth of a case.
pub struct Scene {
    /// Training runs.
    pub runs: Vec<Run>,
    /// Hold-outs.
    pub held: Vec<Run>,
    /// Effects that the model lacks.
    pub hidden: Vec<Source>,
    /// True effects that the model has too.
    pub known: Vec<Source>,
    /// The same effects with the model's values.
    pub model: Vec<Source>,
    /// The noise: standard deviation, autocorrelation, step of the gauge.
    pub(crate) noise: Noise,
    /// Growth of the noise over a run, and its wander, both as a share.
    pub uneven: [f64; 2],
    /// Responses as measured, by run: training, then hold-outs.
    pub measured: Vec<Vec<Vec<f64>>>,
    /// The noise alone, likewise.
    pub noise_alone: Vec<Vec<Vec<f64>>>,
    /// Number and kind of the hidden effects.
    pub hides: Hides,
    /// Other sets of names that are accepted.
    pub also: Vec<Vec<String>>,
    /// Kind of the case, in a word.
    pub design: &'static str,
    /// Other laws that the runs could show.
    laws: std::cell::OnceCell<rivals::Laws>,
}

impl Scene {
    /// A scene of these benches, with nothing hidden yet.
    pub fn new(dice: &mut Dice, design: &'static str, benches: &[Bench]) -> Self {
        let runs: Vec<Run> = benches.iter().map(|b| b.run(0)).collect();
        let held = if dice.chance(0.6) { vec![dice.pick(benches).run(77)] } else { vec![] };
        let sd = dice.log(0.1, 3.0);
        let phi = if dice.chance(0.5) { dice.within(0.1, 0.7) } else { 0.0 };
        let quantum = dice.chance(0.3).then(|| sd * dice.log(0.1, 1.0));
        let noise = Noise { sd, phi, phi2: 0.0, quantum };
        let rows = runs.iter().map(|r| r.n).max().unwrap_or(1) as f64;
        Self {
            runs,
            held,
            hidden: vec![],
            known: vec![],
            model: vec![],
            noise,
            uneven: [dice.within(0.0, 0.4), dice.unit() / rows.sqrt()],
            measured: vec![],
            noise_alone: vec![],
            hides: Hides::Nothing,
            also: vec![],
            design,
            laws: std::cell::OnceCell::new(),
        }
    }

    fn laws(&self) -> &rivals::Laws {
        self.laws.get_or_init(|| rivals::laws(&self.runs))
    }

    /// The noise's standard deviation, µm or N.
    pub fn sd(&self) -> f64 {
        self.noise.sd
    }

    /// Largest ratio of a source's RMS to the noise over the responses.
    pub fn ratio(&self, s: &Source) -> f64 {
        let mut largest = 0.0_f64;
        for r in &self.runs {
            for resp in &r.responses {
                let v = s.on(r, resp);
                // In a record with a zero of its own the constant shows nothing.
                let mean = if r.zero.is_some() { v.iter().sum::<f64>() / r.n as f64 } else { 0.0 };
                largest = largest.max(rms(&v.iter().map(|x| x - mean).collect::<Vec<_>>()));
            }
        }
        largest / self.noise.sd
    }

    /// Scales a source to `ratio` times the noise.
    /// Returns false where no machine can have that size.
    pub fn sized(&self, s: &mut Source, ratio: f64) -> bool {
        s.level(&self.runs);
        let now = self.ratio(s);
        if now <= 0.0 {
            return false;
        }
        s.scale(ratio / now);
        if let (true, Some(q)) = (s.name.starts_with("lost_counts"), self.noise.quantum) {
            let v = s.val("um");
            s.scale((v / q).round().abs().max(1.0) * q / v.abs());
        }
        physical(s)
    }

    /// Hides a source; returns false where these data cannot tell it by name.
    pub fn hide(&mut self, s: Source) -> bool {
        if self.hidden.iter().chain(&self.known).any(|h| h.name == s.name) {
            return false;
        }
        let others: Vec<&Source> = self.hidden.iter().chain(&self.known).collect();
        if rivals::alias(&s, &others, &self.runs, self.laws(), self.noise_for_telling()).is_some() {
            return false;
        }
        self.hidden.push(s);
        true
    }

    /// Hides a shape outside the dictionary.
    /// Returns false where a law other than the accepted ones would do almost as well, or these data could not show the
    /// shape.
    pub fn hide_shape(&mut self, s: Source, right: &[&str], waves: bool) -> bool {
        let others: Vec<&Source> = self.known.iter().collect();
        let (share, _) = rivals::best_law(&s, &others, &self.runs, waves, right);
        let c = rivals::column(&s, &self.runs);
        let square = self.noise_for_telling().powi(2);
        let told = c.iter().map(|x| x * x).sum::<f64>() * (1.0 - share) > rivals::TELLS * square;
        self.hidden.push(s);
        share < LIKE && told
    }

    /// Noise for comparisons: correlated noise counts for more.
    fn noise_for_telling(&self) -> f64 {
        self.noise.sd * ((1.0 + self.noise.phi) / (1.0 - self.noise.phi)).sqrt()
    }

    /// Whether each hidden effect can still be told from all the others.
    pub fn all_told(&self) -> bool {
        (0..self.hidden.len()).all(|k| {
            let others: Vec<&Source> = self
                .hidden
                .iter()
                .enumerate()
                .filter(|(j, _)| *j != k)
                .map(|(_, s)| s)
                .chain(&self.known)
                .collect();
            rivals::alias(&self.hidden[k], &others, &self.runs, self.laws(), self.noise_for_telling())
                .is_none()
        })
    }

    /// Gives the model a true effect whose amplitude is off by a share.
    pub fn know(&mut self, dice: &mut Dice, s: Source, off: f64) {
        let mut seen = s.clone();
        if s.arr.is_empty() {
            seen.off(dice, off);
        } else {
            seen.scale(1.0 + off * dice.normal());
        }
        // A model states only values that a machine can have.
        if !physical(&seen) {
            seen = s.clone();
        }
        self.known.push(s);
        self.model.push(seen);
    }

    /// Measures all runs: adds the noise to the truth.
    pub fn measure(&mut self, dice: &mut Dice) {
        let zeros: Vec<(String, f64)> = self
            .runs
            .iter()
            .chain(&self.held)
            .filter_map(|r| r.zero.clone())
            .map(|z| (z, dice.within(-40.0, 40.0) * self.noise.sd))
            .collect();
        for run in self.runs.iter().chain(&self.held) {
            let [grows, wanders] = self.uneven;
            let zero = run
                .zero
                .as_ref()
                .and_then(|z| zeros.iter().find(|(name, _)| name == z))
                .map_or(0.0, |(_, v)| *v);
            let mut here = Vec::new();
            let mut alone = Vec::new();
            for (k, resp) in run.responses.iter().enumerate() {
                let mut walk = 0.0;
                let mut noise = self.noise.series(run.n, dice);
                for (i, x) in noise.iter_mut().enumerate() {
                    walk += wanders * self.noise.sd * dice.normal() / (run.n as f64).sqrt();
                    *x = *x * (1.0 + grows * (i as f64 / run.n as f64 - 0.5)) + walk;
                }
                let zero = zero * (1.0 - 0.6 * k as f64);
                let mut e: Vec<f64> = noise.iter().map(|x| x + zero).collect();
                let clean = e.clone();
                for s in self.known.iter().chain(&self.hidden) {
                    e.iter_mut().zip(s.on(run, resp)).for_each(|(e, c)| *e += c);
                }
                if let Some(q) = self.noise.quantum {
                    let before = e.clone();
                    e.iter_mut().for_each(|e| *e = (*e / q).round() * q);
                    noise =
                        clean.iter().zip(e.iter().zip(&before)).map(|(c, (a, b))| c - zero + a - b).collect();
                }
                here.push(e);
                alone.push(noise);
            }
            self.measured.push(here);
            self.noise_alone.push(alone);
        }
    }

    /// Writes the case.
    ///
    /// # Errors
    /// When the directory cannot be written.
    pub fn write(&self, seed: u64, dir: &Path) -> anyhow::Result<Case> {
        std::fs::create_dir_all(dir)?;
        let model = dir.join("machine.toml");
        let text: String = self.model.iter().map(Source::toml).collect();
        std::fs::write(&model, format!("name = \"blind\"\n\n{text}"))?;
        let mut files = Vec::new();
        for (k, run) in self.runs.iter().chain(&self.held).enumerate() {
            let stem = if k < self.runs.len() {
                format!("train{k}")
            } else {
                format!("later{}", k - self.runs.len())
            };
            files.push(write_run(dir, &stem, run, &self.measured[k], self.noise.quantum, Manner::First)?);
        }
        let holdout = files.split_off(self.runs.len());
        let story = format!(
            "rows {:?} noise {:.2} phi {:.2} known {:?} hidden {}",
            self.runs.iter().map(|r| format!("{} {}", r.kind, r.n)).collect::<Vec<_>>(),
            self.noise.sd,
            self.noise.phi,
            self.known.iter().map(|k| k.name.as_str()).collect::<Vec<_>>(),
            self.hidden.iter().map(Source::in_words).collect::<String>(),
        );
        Ok(Case {
            seed,
            hides: self.hides,
            truth: self.hidden.iter().map(|h| h.name.clone()).collect(),
            snr: self.hidden.iter().map(|h| self.ratio(h)).collect(),
            also: self.also.clone(),
            design: self.design,
            story,
            train: files,
            holdout,
            model,
        })
    }
}
