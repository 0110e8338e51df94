//! `position_map.A` and `straightness.A.B`: a smooth function of one position, linear between knots, constant beyond.

use super::{Card, Effect, Input, Law, Naming, Need, Out, Parameter, Quantity, Search, State, ValueError};
use std::sync::Arc;

#[derive(Debug)]
struct Knots {
    card: Card,
    /// Which axis of the name the knots lie on.
    along: usize,
}

const KNOTS: usize = 0;
const UM: usize = 1;

impl Law for Knots {
    fn card(&self) -> &Card {
        &self.card
    }

    fn basis(&self, effect: &Effect, now: &Input, _: usize, _: &mut State, out: Out<'_>) {
        out.fill(0.0);
        let knots = effect.get(KNOTS);
        let p = now.p_mm[self.along];
        let after = knots.partition_point(|k| *k <= p);
        if after == 0 {
            out[0] = 1.0;
        } else if after == knots.len() {
            out[after - 1] = 1.0;
        } else {
            let w = (p - knots[after - 1]) / (knots[after] - knots[after - 1]);
            out[after - 1] = 1.0 - w;
            out[after] = w;
        }
    }

    fn slopes(&self, effect: &Effect, now: &Input, component: usize, state: &mut State, out: Out<'_>) {
        let n = effect.width();
        self.basis(effect, now, component, state, &mut out[n * UM..]);
    }

    /// What a constant and a straight line over the knots explain is left to offset, scale and squareness.
    fn constraints(&self, effect: &Effect) -> Vec<Vec<f64>> {
        let knots = effect.get(KNOTS);
        let middle = knots.iter().sum::<f64>() / knots.len() as f64;
        vec![vec![1.0; knots.len()], knots.iter().map(|k| k - middle).collect()]
    }

    fn check(&self, effect: &Effect) -> Result<(), ValueError> {
        if effect.get(KNOTS).windows(2).all(|w| w[0] < w[1]) {
            return Ok(());
        }
        Err(ValueError::new("knots_mm", format!("{:?}", effect.get(KNOTS)), "knots that increase strictly"))
    }
}

pub(super) fn laws(laws: &mut Vec<Arc<dyn Law>>) {
    let parameters = || {
        vec![
            Parameter::new("knots_mm", "mm", [-1e4, 1e4], Search::Chosen).array(),
            Parameter::linear("um", "um", 500.0).array(),
        ]
    };
    let card = |name: &str, law: &str, naming, along, cause: &str, experiment: &str| Card {
        name: name.to_owned(),
        law: law.to_owned(),
        cause: cause.to_owned(),
        naming,
        quantity: Quantity::Error,
        parameters: parameters(),
        needs: vec![Need::Position(along)],
        experiment: experiment.to_owned(),
    };
    laws.push(Arc::new(Knots {
        card: card(
            "position_map",
            "e = smooth, repeatable function of p beyond scale: linear between knots, constant beyond",
            Naming::One,
            0,
            "graduation of the scale, lead variation of the screw, bending of the guideway",
            "linear displacement with closely spaced targets (ISO 230-2), several cycles",
        ),
        along: 0,
    }));
    laws.push(Arc::new(Knots {
        card: card(
            "straightness",
            "e_A = smooth non-linear function of p_B: linear between knots, constant beyond",
            Naming::Two,
            1,
            "a guideway that is not straight",
            "straightedge or laser along B read across it, forward and turned over (ISO 230-1)",
        ),
        along: 1,
    }));
}
