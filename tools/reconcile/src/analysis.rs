//! From runs and a model to the answer: the search is done again with better values of the model's own parameters and of
//! the noise's size until neither changes, then what it found is named.

use crate::answer::Answer;
use crate::hypotheses::Hypotheses;
use crate::naming;
use crate::problem::{Known, Stack, known, rms};
use crate::search::{Found, Search};
use crate::tuning::{bend, is_wave, moved, retune};
use rtec_model::effect::Effect;
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// How often the search is done again with better values of the model's own parameters and of the noise's size.
const PASSES: usize = 3;
/// The noise's size is right when what is left is so much of it.
const SIZED: std::ops::Range<f64> = 0.75..1.35;
/// Changes of the model's parameters are small when they are so far from linear, in units of the noise.
const STRAIGHT: f64 = 0.1;

fn noise_guess(stack: &Stack<'_>, missing: &[f64]) -> Vec<f64> {
    (0..stack.responses.len())
        .map(|j| {
            let (mut all, mut steps) = (Vec::new(), Vec::new());
            for s in stack.segments.iter().filter(|s| s.response == j) {
                let m = &missing[s.rows.clone()];
                all.extend_from_slice(m);
                steps.extend(m.windows(2).map(|w| w[1] - w[0]));
            }
            let size = rms(&all).max(1e-9);
            (rms(&steps) / 2f64.sqrt()).clamp(0.1 * size, size)
        })
        .collect()
}

/// The answer where nothing is looked for: the model as it is, and what it leaves.
pub(crate) fn nothing_learned(records: &[Record], machine: &Machine) -> Answer {
    let mut stack = Stack::new(records);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    let mut residual = stack.missing(&file);
    stack.without_zeros(&mut residual);
    stack.sigma = noise_guess(&stack, &residual);
    stack.weigh(&mut residual);
    Answer {
        findings: Vec::new(),
        unexplained: Vec::new(),
        present: file.clone(),
        anchor: file.clone(),
        file,
        ranking: Vec::new(),
        residual,
        phi: 0.0,
        sigma: stack.sigma,
        evidence: 0.0,
    }
}

/// Finds and names what is missing. With `thinnable`, `None` when the rows are too close together for that: fewer of
/// them say more.
pub(crate) fn analyse(records: &[Record], machine: &Machine, level: f64, thinnable: bool) -> Option<Answer> {
    let mut stack = Stack::new(records);
    let file: Vec<Effect> = machine.effects().cloned().collect();
    let mut missing = stack.missing(&file);
    stack.without_zeros(&mut missing);
    stack.sigma = noise_guess(&stack, &missing);
    let mut model = Model { anchor: file.clone(), now: file.clone(), noise: 1.0 };
    retune(&stack, model.noise, &mut model.anchor, &mut model.now, &[]);
    let mut passes = PASSES;
    let (mut all, waves) = Hypotheses::new(&stack, machine.dictionary());
    loop {
        let mut search = Search::new(&stack, &all, &waves);
        let change: Vec<f64> = loop {
            let parameters = model.begin(&mut search);
            let found = search.run();
            if thinnable && search.oversampled(&found.any) {
                return None;
            }
            let pass = model.next(&search, &found, &parameters, passes == 0);
            let Some(pass) = pass else {
                let answer = naming::conclude(&mut search, &found, &model.now, level);
                return Some(model.scaled(Answer { file, ..answer }));
            };
            passes -= 1;
            model.now = pass.moved;
            if stack.responses.len() != 1 {
                break pass.change;
            }
        };
        let less: Vec<f64> = change.iter().map(|c| 1.0 / c).collect();
        all.weigh(&stack, &less);
        stack.sigma.iter_mut().zip(&change).for_each(|(sigma, c)| *sigma *= c);
    }
}

/// The model's effects while the search goes on.
struct Model {
    /// As the file has them, but for periods that were found by a search.
    anchor: Vec<Effect>,
    /// As the data have them so far.
    now: Vec<Effect>,
    /// Size of the noise in units of the stack's; of one response it need not be weighed anew.
    noise: f64,
}

/// What a search asks to be done again with.
struct Pass {
    moved: Vec<Effect>,
    /// Per response: by how much the noise is larger than was thought.
    change: Vec<f64>,
}

impl Model {
    /// Begins a search for what the model leaves; the model's parameters beside it.
    fn begin(&self, search: &mut Search<'_, '_>) -> Vec<Known> {
        let mut missing = search.stack.missing(&self.now);
        search.stack.weigh(&mut missing);
        search.stack.without_zeros(&mut missing);
        let parameters = known(search.stack, self.noise, &self.anchor, &self.now);
        search.begin(self.noise, parameters.clone(), missing);
        parameters
    }

    /// What to search again with after a search that found this; none where nothing would change.
    fn next(
        &mut self,
        search: &Search<'_, '_>,
        found: &Found,
        parameters: &[Known],
        last: bool,
    ) -> Option<Pass> {
        let stack = search.stack;
        let beta = found.any.coefficients();
        let mut moved = moved(&self.now, parameters, &beta);
        let bent = bend(stack, &self.now, &moved, parameters, &beta) / self.noise;
        let (residual, _) = search.residual(&found.any);
        let change = self.change(stack, &residual);
        let alone = stack.responses.len() == 1;
        let off = change.iter().any(|c| !SIZED.contains(c));
        if alone && off {
            self.noise *= change[0];
        }
        let tuned = !last && self.tuned(search, found, &mut moved);
        // Only beside the model's parameters does it matter how large the noise of one response is.
        let weigh = off && !(alone && parameters.is_empty());
        (!last && (weigh || bent > STRAIGHT || tuned)).then_some(Pass { moved, change })
    }

    fn change(&self, stack: &Stack<'_>, residual: &[f64]) -> Vec<f64> {
        let of = |j: usize| {
            let segments = stack.segments.iter().filter(|s| s.response == j);
            let rows: Vec<f64> = segments.flat_map(|s| &residual[s.rows.clone()]).copied().collect();
            (rms(&rows) / self.noise).clamp(0.02, 50.0)
        };
        (0..stack.responses.len()).map(of).collect()
    }

    /// A wave beside a wave of the model may be the model's own, out of tune: seen now that the rest is explained.
    /// Whether it was.
    fn tuned(&mut self, search: &Search<'_, '_>, found: &Found, moved: &mut Vec<Effect>) -> bool {
        let mut beside: Vec<Effect> = search.effects(&found.any).into_iter().flatten().collect();
        let same = |e: &Effect| self.now.iter().any(|n| is_wave(n) && n.name() == e.name());
        if !beside.iter().any(&same) {
            return false;
        }
        beside.retain(|e| !same(e));
        let mut trial = moved.clone();
        let tuned = retune(search.stack, self.noise, &mut self.anchor, &mut trial, &beside);
        if tuned {
            *moved = trial;
        }
        tuned
    }

    /// The answer in the responses' own units.
    fn scaled(self, answer: Answer) -> Answer {
        let mut answer = Answer { anchor: self.anchor, ..answer };
        for s in &mut answer.sigma {
            *s *= self.noise;
        }
        for r in &mut answer.residual {
            *r /= self.noise;
        }
        answer
    }
}
