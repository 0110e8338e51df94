//! The model's own parameters while the search goes on: periods found anew, and the changes that a fit asks for.

use crate::hypotheses::Hypotheses;
use crate::problem::{Known, Stack, known, rms};
use crate::search::Search;
use rtec_model::effect::Effect;

pub(crate) fn is_wave(effect: &Effect) -> bool {
    effect.description().searched.wave.is_some()
}

/// Searches the periods of the model's own periodic effects: over a long travel a period that is a little off is out
/// of step by whole turns, which no linear correction mends. `beside` is what was found missing beside them. What is
/// mended counts as if the file had said so. Whether anything was.
pub(crate) fn retune(
    stack: &Stack<'_>,
    noise: f64,
    anchor: &mut [Effect],
    now: &mut [Effect],
    beside: &[Effect],
) -> bool {
    let mut any = false;
    for e in 0..now.len() {
        if !is_wave(&now[e]) {
            continue;
        }
        let others = now.iter().enumerate().filter(|(i, _)| *i != e).map(|(_, x)| x);
        let mut missing = stack.missing(others.chain(beside));
        stack.weigh(&mut missing);
        stack.without_zeros(&mut missing);
        let others: Vec<Known> =
            known(stack, noise, anchor, now).into_iter().filter(|k| k.effect != Some(e)).collect();
        let (none, waves) = Hypotheses::periods(stack, &now[e]);
        let mut search = Search::new(stack, &none, &waves);
        search.begin(noise, others, missing);
        let empty = search.empty();
        let Some(best) = search.scan(&empty, true).into_iter().next() else { continue };
        let same = search.score_of(&empty, best.hypothesis, &now[e]);
        if best.score > same + 6.0 {
            let set = search.take(&empty, &best);
            let beta = set.coefficients();
            let at = beta.len() - 2;
            let Some(found) = best.cause.effect(stack, &beta[at..]) else { continue };
            // Another amplitude is another effect, not this one with its period mended.
            let ratio = found.scalar(1) / now[e].scalar(1).abs().max(1e-12);
            if (0.4..2.5).contains(&ratio) {
                let [period, phase] = [found.scalar(0), found.scalar(2)];
                let mended = anchor[e].values().to_vec();
                // Both keep the law's bounds: they come from the law itself.
                let _set = anchor[e].set_values(&[period, mended[1], phase]);
                now[e] = found;
                any = true;
            }
        }
    }
    any
}

/// The model's effects with the changes that a fit asks for.
pub(crate) fn moved(now: &[Effect], parameters: &[Known], beta: &[f64]) -> Vec<Effect> {
    let mut out = now.to_vec();
    for (e, effect) in out.iter_mut().enumerate() {
        let mut values = effect.values().to_vec();
        for (k, b) in parameters.iter().zip(beta).filter(|(k, _)| k.effect == Some(e)) {
            for (v, w) in &k.along {
                values[*v] += w * b;
            }
        }
        // A change that leaves the law's bounds is not made.
        let _kept = effect.set_values(&values);
    }
    out
}

/// How far the changes are from linear, in units of the noise.
pub(crate) fn bend(
    stack: &Stack<'_>,
    now: &[Effect],
    moved: &[Effect],
    parameters: &[Known],
    beta: &[f64],
) -> f64 {
    let (a, b) = (stack.predict(now), stack.predict(moved));
    let mut d: Vec<f64> = b.iter().zip(&a).map(|(b, a)| b - a).collect();
    stack.weigh(&mut d);
    // A record's own zero moves no effect.
    for (k, b) in parameters.iter().zip(beta).filter(|(k, _)| k.effect.is_some()) {
        d.iter_mut().zip(&k.column).for_each(|(d, c)| *d -= b * c);
    }
    rms(&d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::record;
    use rtec_model::effect::Dictionary;

    /// Records with a zero of their own, once taken for a bend of the model: each search was done again as often as is allowed.
    #[test]
    fn a_record_s_own_zero_bends_nothing() {
        let mut records = [record(60, |i| i), record(60, |i| 500.0 - i)];
        records[1].zero = Some("another".to_owned());
        let stack = Stack::new(&records);
        let mut scale = Dictionary::default().effect("scale.x").unwrap();
        scale.set_values(&[20.0]).unwrap();
        let now = [scale];
        let parameters = known(&stack, 1.0, &now, &now);
        assert!(parameters.len() > 1 && parameters.iter().any(|k| k.effect.is_none()));
        let beta: Vec<f64> = (0..parameters.len()).map(|i| 300.0 - 7.0 * i as f64).collect();
        let bent = bend(&stack, &now, &moved(&now, &parameters, &beta), &parameters, &beta);
        assert!(bent < 1e-9, "{bent}");
    }
}
