//! What may be missing: every effect of the dictionary that these runs could show, over a grid of its non-linear
//! parameters, and shapes of no name that stand for "something else".

use crate::bank::Bank;
use crate::cause::Cause;
use crate::extent::resolution;
use crate::gram::Products;
use crate::problem::Stack;
use crate::threads;
use crate::waves::Wave;
use rtec_model::effect::{self, Description, Dictionary, Difference, Effect, Point, Quantity};
use rtec_model::record::Role;
use std::ops::Range;

/// An explanation with its columns.
#[derive(Debug, Clone)]
pub(crate) struct Atom {
    pub(crate) cause: Cause,
    /// Columns in the bank.
    pub(crate) columns: Vec<usize>,
    /// Which hypothesis it is a grid point of.
    pub(crate) hypothesis: usize,
    /// log of the number of distinguishable grid points (times the share of its family): the price of searching.
    pub(crate) cost: f64,
}

/// One hypothesis: one name with its sensors.
#[derive(Debug, Clone)]
pub(crate) struct Hypothesis {
    pub(crate) name: String,
    /// The effect with its sensors; none for a shape.
    pub(crate) effect: Option<Effect>,
}

impl Hypothesis {
    /// Whether it is an effect of the dictionary.
    pub(crate) fn named(&self) -> bool {
        self.effect.is_some()
    }

    /// Its law, where it has one.
    pub(crate) fn law(&self) -> Option<&Description> {
        self.effect.as_ref().map(Effect::description)
    }

    /// The temperature difference that it reads.
    pub(crate) fn sensor(&self) -> Option<&Difference> {
        self.effect.as_ref()?.delta.as_ref()
    }

    /// Whether it is the zero of an axis.
    pub(crate) fn is_offset(&self) -> bool {
        self.law().is_some_and(|l| l.constant && l.quantity == Quantity::Error)
    }

    /// Name and sensors, as one text.
    pub(crate) fn label(&self) -> String {
        match self.sensor() {
            Some(d) => format!("{} ({d})", self.name),
            None => self.name.clone(),
        }
    }
}

/// All explanations that are tried over a grid.
#[derive(Debug, Default)]
pub(crate) struct Hypotheses {
    pub(crate) list: Vec<Hypothesis>,
    pub(crate) atoms: Vec<Atom>,
    pub(crate) bank: Bank,
    /// Products among the columns of each atom, packed by rows of the lower triangle.
    pub(crate) own: Vec<Vec<Products>>,
    /// Of these, per column what is known beforehand of its coefficient; none but of a map's.
    pub(crate) known: Vec<Vec<f64>>,
    /// Price of the family choice alone, per law and per shape.
    pub(crate) family_cost: f64,
}

impl Hypotheses {
    pub(crate) fn new(stack: &Stack<'_>, dictionary: &Dictionary) -> (Self, Vec<Wave>) {
        let mut all = Self { bank: Bank::new(&stack.ranges), ..Self::default() };
        let mut waves = Vec::new();
        let mut candidates: Vec<Effect> = Vec::new();
        for record in stack.records {
            for effect in dictionary.candidates(&[record]) {
                let effect = effect.in_order();
                // What stands beside another law is looked for by the estimator alone.
                if effect.description().searched.beside.is_some() {
                    continue;
                }
                if !candidates.iter().any(|c| c.name() == effect.name() && c.delta == effect.delta) {
                    candidates.push(effect);
                }
            }
        }
        let laws: Vec<String> = candidates.iter().map(|c| c.description().name.clone()).collect();
        let mut families = laws.clone();
        families.sort();
        families.dedup();
        all.family_cost = (families.len().max(1) as f64).ln();
        let mut shapes =
            Self { bank: Bank::new(&stack.ranges), family_cost: all.family_cost, ..Self::default() };
        let mut waves_of_shapes: Vec<Wave> = Vec::new();
        // Some hundreds of grid points, and as many shapes.
        threads::both(
            stack.n << 10,
            || {
                for effect in &candidates {
                    // Without movement of what it reads an effect is a constant, or nothing.
                    let share = laws.iter().filter(|l| **l == effect.description().name).count() as f64;
                    let cost = all.family_cost + share.ln();
                    all.effect(stack, effect, cost, &mut waves);
                }
                all.square(stack);
            },
            || {
                shapes.shapes(stack, &mut waves_of_shapes);
                shapes.square(stack);
            },
        );
        for w in &mut waves_of_shapes {
            w.hypothesis += all.list.len();
        }
        waves.extend(waves_of_shapes);
        all.append(shapes);
        (all, waves)
    }

    /// Adds what others explain.
    fn append(&mut self, mut others: Self) {
        for atom in &mut others.atoms {
            atom.hypothesis += self.list.len();
            atom.columns.iter_mut().for_each(|c| *c += self.bank.len());
        }
        self.list.extend(others.list);
        self.atoms.extend(others.atoms);
        self.bank.append(others.bank);
        self.own.extend(others.own);
        self.known.extend(others.known);
    }

    fn square(&mut self, stack: &Stack<'_>) {
        self.own = self.atoms.iter().map(|a| self.bank.own(&a.columns)).collect();
        self.known = vec![Vec::new(); self.atoms.len()];
        self.know_heights(stack);
    }

    /// What is known beforehand of maps' heights, into the products of their columns with themselves.
    fn know_heights(&mut self, stack: &Stack<'_>) {
        for ((atom, own), known) in self.atoms.iter().zip(&mut self.own).zip(&mut self.known) {
            if !atom.cause.is_map() {
                continue;
            }
            known.resize(atom.columns.len(), 0.0);
            for (r, (c, known)) in atom.columns.iter().zip(known).enumerate() {
                let now = stack.height_known(&self.bank.covered(*c)) / self.bank.scale[*c].powi(2);
                let diagonal = &mut own[r * (r + 3) / 2];
                *diagonal = diagonal.and(now - *known);
                *known = now;
            }
        }
    }

    /// The same for responses of which each is now weighed so many times as much.
    pub(crate) fn weigh(&mut self, stack: &Stack<'_>, by: &[f64]) {
        let by: Vec<f64> = stack.segments.iter().map(|s| by[s.response]).collect();
        self.bank.weigh(&by);
        for ((atom, own), known) in self.atoms.iter().zip(&mut self.own).zip(&mut self.known) {
            // Columns of one response are of unit size, as they were.
            if atom.columns.iter().any(|c| self.bank.differs(*c, &by)) {
                *own = self.bank.own(&atom.columns);
                known.clear();
            }
        }
        self.know_heights(stack);
    }

    /// Only the periods near a periodic effect's own: 3 % either way.
    pub(crate) fn periods(stack: &Stack<'_>, effect: &Effect) -> (Self, Vec<Wave>) {
        let mut all = Self { bank: Bank::new(&stack.ranges), ..Self::default() };
        let mut waves = Vec::new();
        all.effect(stack, effect, 0.0, &mut waves);
        for w in &mut waves {
            let own = 1.0 / (effect.scalar(0) * w.unit);
            (w.from, w.to) = (own * 0.97, own * 1.03);
        }
        all.square(stack);
        (all, waves)
    }

    /// Per hypothesis: the bank's columns from the first of its grid points to the last.
    pub(crate) fn columns_of(&self) -> Vec<Range<usize>> {
        let mut out = vec![0..0; self.list.len()];
        for atom in &self.atoms {
            let of = &mut out[atom.hypothesis];
            for c in &atom.columns {
                let from = if of.end == 0 { *c } else { of.start.min(*c) };
                *of = from..of.end.max(c + 1);
            }
        }
        out
    }

    /// Per hypothesis: the responses that it acts on, each with the share of its coefficients that it has to find, by the rows that
    /// each of them shows in. A straightness over a circle larger than a plate is mostly the circle's to find, however many rows the
    /// plate has.
    pub(crate) fn acts_on(&self, stack: &Stack<'_>, waves: &[Wave]) -> Vec<Vec<(usize, f64)>> {
        let mut longest: Vec<&[usize]> = vec![&[]; self.list.len()];
        for a in &self.atoms {
            if a.columns.len() > longest[a.hypothesis].len() {
                longest[a.hypothesis] = &a.columns;
            }
        }
        let responses: Vec<Range<usize>> = (0..stack.responses.len()).map(|j| stack.rows(j)).collect();
        let mut shares = vec![vec![0.0; responses.len()]; self.list.len()];
        let add = |shares: &mut Vec<f64>, rows: Vec<usize>| {
            let all = rows.iter().sum::<usize>().max(1) as f64;
            shares.iter_mut().zip(rows).for_each(|(share, n)| *share += n as f64 / all);
        };
        for (shares, longest) in shares.iter_mut().zip(&longest) {
            for column in longest.iter().map(|c| self.bank.column(*c)) {
                let shown = |own: &Range<usize>| column[own.clone()].iter().filter(|x| **x != 0.0).count();
                add(shares, responses.iter().map(shown).collect());
            }
        }
        for w in waves {
            let rows_in = |own: &Range<usize>| {
                w.parts().filter(|(rows, ..)| own.contains(&rows.start)).map(|(rows, ..)| rows.len()).sum()
            };
            add(&mut shares[w.hypothesis], responses.iter().map(rows_in).collect());
        }
        let of = |shares: Vec<f64>| {
            let all: f64 = shares.iter().sum();
            let shown = shares.into_iter().enumerate().filter(|(_, share)| *share > 0.0);
            shown.map(|(j, share)| (j, share / all)).collect()
        };
        shares.into_iter().map(of).collect()
    }

    fn hypothesis(&mut self, effect: &Effect) -> usize {
        self.list.push(Hypothesis { name: effect.name(), effect: Some(effect.clone()) });
        self.list.len() - 1
    }

    pub(crate) fn push(&mut self, stack: &Stack<'_>, mut column: Vec<f64>) -> usize {
        for s in &stack.segments {
            // To as many digits as the bank keeps no other than divided, in less time.
            let by = 1.0 / stack.sigma[s.response];
            column[s.rows.clone()].iter_mut().for_each(|x| *x *= by);
        }
        self.bank.push(&column)
    }

    fn effect(&mut self, stack: &Stack<'_>, effect: &Effect, cost: f64, waves: &mut Vec<Wave>) {
        if let Some(facts) = effect.description().searched.wave {
            waves.extend(self.wave(stack, effect, &facts));
            return;
        }
        let hypothesis = self.hypothesis(effect);
        let mut level = None;
        for Point { effect, price } in effect.grid(stack) {
            let cost = cost + effect.description().searched.price + price;
            self.point(stack, hypothesis, &effect, cost, &mut level);
        }
    }

    /// The search of a wave's period.
    fn wave(&mut self, stack: &Stack<'_>, effect: &Effect, facts: &effect::Wave) -> Option<Wave> {
        let axis = effect.axes()[0].clone();
        let own = Role::Error(axis.clone());
        let radial =
            |r: &Role| stack.records.iter().any(|rec| effect.acts_on(rec).iter().any(|(on, _)| on == r));
        let response = stack
            .responses
            .iter()
            .position(|r| *r == own)
            .or_else(|| stack.responses.iter().position(radial))?;
        let along = stack
            .column(Some(response), |r, row| r.data(&Role::Position(axis.clone())).map_or(0.0, |p| p[row]));
        let h = self.hypothesis(effect);
        let [lo, hi] = effect.description().parameters[0].bounds;
        let (from, to) = (1.0 / (hi * facts.unit_mm), 1.0 / (lo * facts.unit_mm));
        let mut wave = Wave::new(stack, h, response, &along, from, to);
        // What is constant on the axis shows its share in the radial error.
        let dictionary = Dictionary::default();
        let constant = dictionary.laws().find(|l| l.describe().constant)?;
        let constant = dictionary.effect(&format!("{}.{axis}", constant.describe().name)).ok()?;
        let share = stack.basis(&constant).into_iter().next()?;
        if stack.responses[response] != own {
            wave.share = share[wave.rows.clone()].to_vec();
        }
        for other in (0..stack.responses.len()).filter(|r| *r != response && radial(&stack.responses[*r])) {
            let rows = stack.rows(other);
            let along = stack
                .column(Some(other), |r, row| r.data(&Role::Position(axis.clone())).map_or(0.0, |p| p[row]));
            wave.push(stack, rows.clone(), along[rows.clone()].to_vec(), share[rows].to_vec());
        }
        if let (Some(steps), Some(step)) = (facts.steps, resolution(&wave.places)) {
            // What is finer than the positions are read cannot be told from something coarser.
            let finest = 1.0 / (steps * step);
            wave.to = if finest > from { to.min(finest) } else { to };
        }
        Some(Wave { effect: Some(effect.clone()), unit: facts.unit_mm, ..wave })
    }

    /// A grid point: one atom for each choice of free coefficients. `level`: the column of a free reference temperature, the same at
    /// every grid point.
    fn point(
        &mut self,
        stack: &Stack<'_>,
        hypothesis: usize,
        effect: &Effect,
        cost: f64,
        level: &mut Option<usize>,
    ) {
        let columns: Vec<usize> = stack.basis(effect).into_iter().map(|c| self.push(stack, c)).collect();
        let pair = effect.delta.as_ref().is_some_and(Difference::is_pair);
        for choice in &effect.description().searched.choices {
            if choice.reference && pair {
                continue;
            }
            let free: Vec<usize> = (0..choice.coefficients.unwrap_or(columns.len())).collect();
            let mut own = columns[..free.len()].to_vec();
            if choice.reference {
                own.push(*level.get_or_insert_with(|| self.push(stack, reference_column(stack, effect))));
            }
            let cause = Cause::Effect { effect: effect.clone(), free, reference: choice.reference };
            self.atoms.push(Atom { cause, columns: own, hypothesis, cost: cost + choice.price });
        }
    }
}

/// The column that a free reference temperature adds: the effect of one kelvin, the same at all times.
pub(crate) fn reference_column(stack: &Stack<'_>, effect: &Effect) -> Vec<f64> {
    let level = effect.companion().and_then(|level| stack.basis(&level).into_iter().next());
    level.unwrap_or_else(|| vec![0.0; stack.n])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{axis, circle, column, noise, record};
    use rtec_model::record::{Axis, Kind, Record};
    use std::path::Path;

    fn hypotheses(record: rtec_model::record::Record) -> (Vec<String>, Vec<usize>) {
        let records = [record];
        let stack = Stack::new(&records);
        let (all, _) = Hypotheses::new(&stack, &Dictionary::default());
        let named = |h: usize| all.list[h].named();
        let points = (0..all.list.len()).filter(|h| named(*h));
        let count = |h: usize| all.atoms.iter().filter(|a| a.hypothesis == h).count();
        (points.clone().map(|h| all.list[h].name.clone()).collect(), points.map(count).collect())
    }

    /// What the records can show is listed, each with the grid points that its law gives.
    #[test]
    fn every_law_that_the_records_show_is_tried() {
        let (names, points) = hypotheses(record(120, |i| i));
        let at = |name: &str| names.iter().position(|n| n == name).map(|i| points[i]);
        assert_eq!(at("offset.x"), Some(1));
        assert_eq!(at("scale.x"), Some(1));
        assert_eq!(at("warm_up.x"), Some(14));
        assert_eq!(at("screw_periodic.x"), Some(0), "its period is searched over frequencies");
        assert!(at("position_map.x").is_some_and(|n| n >= 10));
        assert_eq!((at("thermal_growth.x"), at("coolant.x")), (None, None));
    }

    #[test]
    fn a_free_reference_is_the_companion_s_column() {
        let records = [record(30, |i| i)];
        let stack = Stack::new(&records);
        let dictionary = Dictionary::default();
        let column = |name: &str| reference_column(&stack, &dictionary.effect(name).unwrap());
        assert!(column("thermal_growth.x").iter().all(|v| (v - 1.0).abs() < 1e-15));
        let p = records[0].data(&Role::Position(crate::testing::axis())).unwrap();
        assert!(column("thermal_expansion.x").iter().zip(p).all(|(v, p)| (v - p / 1000.0).abs() < 1e-15));
    }

    /// Maps at places that do not tell their heights apart: what is known beforehand is beside their columns, in a grid point as in
    /// a fit, and stays there when responses are weighed anew. Nothing is beside other laws' columns.
    #[test]
    fn heights_are_known_beforehand() {
        let records = [record(120, |i| 40.0 * (i / 9.0).sin())];
        let mut stack = Stack::new(&records);
        let (mut all, _) = Hypotheses::new(&stack, &Dictionary::default());
        for sigma in [1.0, 4.0] {
            if sigma > 1.0 {
                stack.sigma = vec![sigma];
                all.weigh(&stack, &[1.0 / sigma]);
            }
            let size = crate::problem::rms(&stack.measured);
            for (atom, own) in all.atoms.iter().zip(&all.own) {
                let bare = all.bank.own(&atom.columns);
                for (r, c) in atom.columns.iter().enumerate() {
                    let at = r * (r + 3) / 2;
                    let known = (own[at].at(0.0) - bare[at].at(0.0)) * all.bank.scale[*c].powi(2);
                    let wanted = if atom.cause.is_map() { (5.0 * size).powi(-2) } else { 0.0 };
                    assert!((known - wanted).abs() < 1e-9 + 1e-6 * wanted, "{known}, not {wanted}");
                }
            }
        }
        assert!(all.atoms.iter().any(|a| a.cause.is_map()));
    }

    /// A plate of 196 holes over 180 mm and a circle of 60 rows over 600 mm: knots of a straightness from end to end are mostly the
    /// circle's to find. Counted by rows they were three quarters the plate's, and two such curves explained any circle.
    #[test]
    fn knots_are_counted_where_they_are_found() {
        let y = Axis::new("y").unwrap();
        let of = |f: &dyn Fn(usize) -> f64| (0..196).map(f).collect::<Vec<f64>>();
        let plate = vec![
            column("x", Role::Position(axis()), of(&|i| (i % 14) as f64 * 13.8 - 90.0)),
            column("y", Role::Position(y.clone()), of(&|i| (i / 14) as f64 * 13.8 - 90.0)),
            column("ex", Role::Error(axis()), noise(3, 196)),
            column("ey", Role::Error(y), noise(4, 196)),
        ];
        let plate = Record::new(Path::new("plate.run.toml"), Kind::Plate, plate).unwrap();
        let records = [plate, circle(60, 300.0, f64::sin)];
        let stack = Stack::new(&records);
        let (all, waves) = Hypotheses::new(&stack, &Dictionary::default());
        let shares = all.acts_on(&stack, &waves);
        let radial = |name: &str| {
            let of = all.list.iter().position(|h| h.name == name).unwrap();
            let by_response = |(j, _): &&(usize, f64)| stack.responses[*j].to_string() == "error.r";
            shares[of].iter().find(by_response).map(|(_, share)| *share).unwrap()
        };
        let straightness = radial("straightness.x.y");
        assert!((0.5..0.95).contains(&straightness), "{straightness}");
        // One coefficient is found by all rows alike.
        assert!((radial("scale.x") - 60.0 / 256.0).abs() < 1e-9, "{}", radial("scale.x"));
        assert!(shares.iter().all(|of| (of.iter().map(|s| s.1).sum::<f64>() - 1.0).abs() < 1e-9));
    }
}
