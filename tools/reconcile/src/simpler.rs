//! The same told with less: sets in which fewer names say as much, and names that only together take the place of others.

use crate::hypotheses::Atom;
use crate::problem::leaves_a_line;
use crate::search::{Found, Search, Set};
use rtec_model::effect::Effect;

/// Log odds below which the data do not decide between two explanations.
pub(crate) const DECISIVE: f64 = 3.0;
/// A member that is worth less than this, nats, may be there only for what another one's values miss.
const WEAK: f64 = 30.0;
/// One explanation does what two do together where it is so much of the same: square of the cosine between them.
pub(crate) const ALIKE: f64 = 0.98;

/// The set without members that are worth little beside the others, where those then find better values: two half truths may
/// hold the place of a whole one.
pub(crate) fn slimmed(search: &mut Search<'_, '_>, set: Set) -> Set {
    let mut best = set;
    loop {
        let weak: Vec<Set> = (0..best.members.len())
            .map(|i| search.without(&best, i))
            .filter(|rest| best.score - rest.score < WEAK)
            .collect();
        let mut better = None;
        for rest in weak {
            let rest = rechosen(search, rest);
            let rest = search.polish(rest);
            if rest.score > better.as_ref().map_or(best.score, |b: &Set| b.score) {
                better = Some(rest);
            }
        }
        match better {
            Some(set) => best = set,
            None => return best,
        }
    }
}

/// The set with each member at the best grid point of its hypothesis, the others in place: what was chosen beside a member
/// that is gone may have left a value out.
fn rechosen(search: &mut Search<'_, '_>, set: Set) -> Set {
    let mut set = set;
    for i in 0..set.members.len() {
        let rest = search.without(&set, i);
        let offer = search.offer_of(&rest, set.members[i].hypothesis);
        if let Some(offer) = offer.filter(|o| o.score > set.score + 1e-6) {
            let joined = search.take(&rest, &offer);
            set = search.in_place_of(joined, i);
        }
    }
    set
}

/// A constant beside a member may make another explanation of that member better than itself: a step that a search
/// by single steps does not take.
pub(crate) fn with_offset(search: &mut Search<'_, '_>, set: &Set) -> Set {
    let offsets: Vec<usize> = (0..search.all.list.len())
        .filter(|h| search.all.list[*h].law().is_some_and(|l| l.constant))
        .collect();
    let thermal = |i: usize| search.all.list[set.members[i].hypothesis].sensor().is_some();
    let n = set.members.len();
    let mut rests: Vec<(Vec<usize>, Set)> = (0..n).map(|i| (vec![i], search.without(set, i))).collect();
    // Two sensors with a constant between them may be their difference.
    for i in (0..n).filter(|i| thermal(*i)) {
        for j in (i + 1..n).filter(|j| thermal(*j)) {
            rests.push((vec![i, j], search.without(&search.without(set, j), i)));
        }
    }
    let all = search.all;
    let axes = |h: usize| all.list[h].effect.as_ref().map_or(&[][..], Effect::axes);
    // A constant of an axis on which nothing was taken out changes nothing there.
    let beside = |out: &[usize], h: usize| {
        out.iter().any(|i| axes(set.members[*i].hypothesis).iter().any(|a| axes(h).contains(a)))
    };
    let mut best = set.clone();
    for (out, rest) in rests {
        for h in offsets.iter().filter(|h| beside(&out, **h)) {
            if set.members.iter().any(|m| m.hypothesis == *h) {
                continue;
            }
            let Some(offset) = search.offer_of(&rest, *h) else { continue };
            let level = search.take(&rest, &offset);
            let Some(offer) = search.offers(&level, 1, 0, false).into_iter().next() else { continue };
            if offer.score > best.score + 1e-6 {
                let next = search.take(&level, &offer);
                best = search.polish(next);
            }
        }
    }
    best
}

/// The set, or one that the data cannot tell from it and that does without a constant: a constant that another explanation
/// of the rest makes needless is no finding.
pub(crate) fn plainer(search: &mut Search<'_, '_>, found: &Found, set: Set) -> Set {
    let constant = |h: usize| search.all.list[h].law().is_some_and(|l| l.constant);
    let Some(at) = set.members.iter().position(|m| constant(m.hypothesis)) else { return set };
    let least = set.score - DECISIVE;
    // A map that is straight is no plainer than a constant and a slope.
    let is_map = |h: usize| search.all.list[h].effect.as_ref().is_some_and(leaves_a_line);
    let maps = |s: &Set| s.members.iter().filter(|m| is_map(m.hypothesis)).count();
    let most = maps(&set);
    let fewer = |s: &Set| s.score > least && s.members.len() < set.members.len() && maps(s) <= most;
    let own = set.members[at].hypothesis;
    let mut best: Option<Set> = None;
    let lacks = |s: &Set| s.members.iter().all(|m| m.hypothesis != own);
    let mut meet = |s: Set| {
        if best.as_ref().is_none_or(|b| s.score > b.score) {
            best = Some(s);
        }
    };
    found.visited.iter().filter(|s| fewer(s) && lacks(s) && search.physical(s)).cloned().for_each(&mut meet);
    let level = search.without(&set, at);
    for i in 0..level.members.len() {
        let rest = search.without(&level, i);
        let ranking = search.ranking(&rest);
        let offers = ranking.iter().take(3).map(|r| r.offers[0].clone());
        for offer in offers.filter(|o| o.score > least && o.hypothesis != own).collect::<Vec<_>>() {
            let joined = search.take(&rest, &offer);
            let instead = search.polish(joined);
            if fewer(&instead) && search.physical(&instead) {
                meet(instead);
            }
        }
    }
    best.unwrap_or(set)
}

/// The set with two members in one another's place taken by the one explanation that does what both do together: of two that
/// lean on each other no single step leads there.
pub(crate) fn merged(search: &mut Search<'_, '_>, set: &Set) -> Set {
    let all = search.all;
    let n = set.members.len();
    if n < 2 {
        return set.clone();
    }
    // What each member does, and its products with the bank's columns: a pair's are their sums.
    let does: Vec<Vec<f64>> = (0..n).map(|i| search.does(set, i)).collect();
    let against: Vec<Vec<f64>> = (0..n).map(|i| search.does_against_bank(set, i)).collect();
    let mut best = set.clone();
    for (i, j) in (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))) {
        let squares: f64 = does[i].iter().zip(&does[j]).map(|(a, b)| (a + b) * (a + b)).sum();
        let alike = |a: &Atom| match a.columns[..] {
            [c] if all.list[a.hypothesis].named() => {
                (against[i][c] + against[j][c]).powi(2) / (squares * all.bank.square(c).at(0.0))
            }
            _ => 0.0,
        };
        let nearest = all.atoms.iter().map(|a| (alike(a), a)).max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, atom)) = nearest.filter(|(share, _)| *share > ALIKE) else { continue };
        let rest = search.without(&search.without(set, j), i);
        if rest.members.iter().any(|m| m.hypothesis == atom.hypothesis) {
            continue;
        }
        let instead = search.take_atom(&rest, atom);
        if instead.score > best.score {
            best = search.polish(instead);
        }
    }
    best
}
