//! Where measured and simulated disagree: structure of the residual against every channel, each with a p-value that
//! holds for autocorrelated noise, and which of them survive a false-discovery rate.

use crate::gram::dot;
use crate::problem::{Segment, Stack};
use rtec_model::effect::Effect;
use rtec_model::record::Role;
use serde_json::{Value, json};

/// Structure of a response against one thing.
#[derive(Debug, Clone)]
pub struct Place {
    /// The response.
    pub response: String,
    /// A role, `temperature.T3`, `channel.z9`.
    pub against: String,
    /// Share of the residual's mean square that a smooth function of it explains.
    pub statistic: f64,
    /// Probability of as much by chance.
    pub p_value: f64,
    /// Smallest false-discovery rate at which it counts.
    pub q_value: f64,
    /// Mean residual over stretches of it: middle of the stretch, mean, number of rows.
    pub profile: Vec<[f64; 3]>,
}

impl Place {
    /// As in `where`.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({
            "response": self.response,
            "against": self.against,
            "statistic": self.statistic,
            "p_value": self.p_value,
            "q_value": self.q_value,
            "profile": self.profile,
        })
    }
}

/// Stretches of a channel that a smooth function is made of.
const STRETCHES: usize = 8;
/// Differences of more temperatures than these are too many to look at.
const PAIRED_TEMPERATURES: usize = 6;

/// Every response against every channel, strongest first: what the model as it was leaves, beside noise.
pub(crate) fn places(stack: &Stack<'_>, file: &[Effect], noise: &[Vec<f64>]) -> Vec<Place> {
    let mut before = stack.missing(file);
    stack.weigh(&mut before);
    let mut out = Vec::new();
    for response in 0..stack.responses.len() {
        let segments: Vec<&Segment> = stack.segments.iter().filter(|s| s.response == response).collect();
        let pick = |all: &[f64]| -> Vec<f64> {
            segments.iter().flat_map(|s| all[s.rows.clone()].iter().copied()).collect()
        };
        let residual = pick(&before);
        let draws: Vec<Vec<f64>> = noise.iter().map(|d| pick(d)).collect();
        let sigma = stack.sigma[response];
        for (against, x) in channels(stack, &segments) {
            let response = stack.responses[response].to_string();
            out.extend(place(response, against, &x, &residual, &draws, sigma));
        }
    }
    out.sort_by(|a, b| a.p_value.total_cmp(&b.p_value).then(b.statistic.total_cmp(&a.statistic)));
    rate(&mut out);
    out
}

/// False-discovery rates, of places that are sorted by their p-values (Benjamini and Hochberg, J. R. Statist. Soc. B 57
/// (1995) 289).
fn rate(places: &mut [Place]) {
    let m = places.len() as f64;
    let mut least = 1.0_f64;
    for (i, place) in places.iter_mut().enumerate().rev() {
        least = least.min(place.p_value * m / (i as f64 + 1.0));
        place.q_value = least;
    }
}

/// What a response's segments all log, with labels, and the differences of a few temperatures.
fn channels(stack: &Stack<'_>, segments: &[&Segment]) -> Vec<(String, Vec<f64>)> {
    let Some(first) = segments.first().map(|s| stack.record(s)) else { return Vec::new() };
    let mut channels: Vec<(String, Vec<f64>)> = Vec::new();
    for column in first.columns.iter().filter(|c| !c.role.is_measured()) {
        let of = |s: &&Segment| match column.role {
            Role::Temperature => stack.record(s).temperature(&column.name),
            Role::Channel => stack.record(s).channel(&column.name),
            _ => stack.record(s).data(&column.role),
        };
        let parts: Option<Vec<&[f64]>> = segments.iter().map(of).collect();
        channels.extend(parts.map(|parts| (column.label(), parts.concat())));
    }
    if first.column(&Role::Time).is_none() {
        let rows = segments.iter().flat_map(|s| (0..s.rows.len()).map(|r| r as f64)).collect();
        channels.push(("time".into(), rows));
    }
    let temperatures: Vec<(String, Vec<f64>)> =
        channels.iter().filter(|(l, _)| l.starts_with("temperature.")).cloned().collect();
    if temperatures.len() <= PAIRED_TEMPERATURES {
        for (i, (a, x)) in temperatures.iter().enumerate() {
            for (b, y) in &temperatures[i + 1..] {
                let b = b.trim_start_matches("temperature.");
                channels.push((format!("{a}-{b}"), x.iter().zip(y).map(|(x, y)| x - y).collect()));
            }
        }
    }
    channels
}

/// Structure of a residual against one channel; none for a constant one.
fn place(
    response: String,
    against: String,
    x: &[f64],
    residual: &[f64],
    draws: &[Vec<f64>],
    sigma: f64,
) -> Option<Place> {
    let bins = stretches(x)?;
    let explained = |r: &[f64]| -> f64 {
        let all = r.iter().sum::<f64>() / r.len() as f64;
        bins.iter().map(|b| (b.iter().map(|i| r[*i] - all).sum::<f64>()).powi(2) / b.len() as f64).sum()
    };
    let own = explained(residual);
    let chance: Vec<f64> = draws.iter().map(|d| explained(d)).collect();
    let n = chance.len().max(1) as f64;
    let mean = chance.iter().sum::<f64>() / n;
    let var = chance.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let p_value = if mean > 0.0 && var > 0.0 { gamma_tail(mean * mean / var, own * mean / var) } else { 1.0 };
    let mean_of = |b: &[usize], v: &[f64]| b.iter().map(|i| v[*i]).sum::<f64>() / b.len() as f64;
    let profile =
        bins.iter().map(|b| [mean_of(b, x), mean_of(b, residual) * sigma, b.len() as f64]).collect();
    let statistic = own / dot(residual, residual).max(1e-300);
    Some(Place { response, against, statistic, p_value, q_value: 1.0, profile })
}

/// Rows by stretch: by value where there are few, by equal numbers of rows otherwise; none for a constant.
fn stretches(x: &[f64]) -> Option<Vec<Vec<usize>>> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut distinct: Vec<f64> = order.iter().map(|i| x[*i]).collect();
    distinct.dedup();
    if distinct.len() < 2 {
        return None;
    }
    if distinct.len() <= STRETCHES {
        let of = |v: f64| order.iter().copied().filter(|i| x[*i].to_bits() == v.to_bits()).collect();
        return Some(distinct.iter().map(|v| of(*v)).collect());
    }
    let n = order.len();
    let bins = STRETCHES.min(n / 4).max(2);
    Some((0..bins).map(|b| order[n * b / bins..n * (b + 1) / bins].to_vec()).collect())
}

/// Upper tail of the gamma distribution of unit scale (Abramowitz and Stegun 6.5.29 and 6.5.31).
fn gamma_tail(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let front = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut k) = (1.0 / a, 1.0 / a, a);
        for _ in 0..1000 {
            k += 1.0;
            term *= x / k;
            sum += term;
            if term < sum * 1e-14 {
                break;
            }
        }
        return (1.0 - front * sum).max(0.0);
    }
    let mut b = x + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut h = d;
    for i in 1..1000 {
        let an = -f64::from(i) * (f64::from(i) - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        h *= d * c;
        if (d * c - 1.0).abs() < 1e-14 {
            break;
        }
    }
    front * h
}

/// Logarithm of the gamma function, Stirling's series after shifting the argument above 8.
fn ln_gamma(mut x: f64) -> f64 {
    let mut shift = 0.0;
    while x < 8.0 {
        shift += x.ln();
        x += 1.0;
    }
    let z = 1.0 / (x * x);
    let series = (1.0 / 12.0 - z * (1.0 / 360.0 - z * (1.0 / 1260.0 - z / 1680.0))) / x;
    (x - 0.5) * x.ln() - x + 0.5 * std::f64::consts::TAU.ln() + series - shift
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{noise, record};

    #[test]
    fn gamma_tail_matches_tables() {
        // Upper 5 % and 1 % points of chi-square (NIST/SEMATECH handbook, 1.3.6.7.4): 1, 5, 20 degrees.
        for (k, x, p) in [(1.0, 3.841, 0.05), (5.0, 11.070, 0.05), (20.0, 37.566, 0.01), (10.0, 23.209, 0.01)]
        {
            assert!((gamma_tail(k / 2.0, x / 2.0) - p).abs() < 2e-5, "{k} {x}");
        }
    }

    #[test]
    fn an_error_along_the_position_is_found_there() {
        let dice = noise(5, 240);
        let mut run = record(240, |i| dice[i as usize]);
        let p = run.columns[1].data.clone();
        for (e, p) in run.columns[2].data.iter_mut().zip(&p) {
            *e += (p / 25.0).powi(2);
        }
        let records = [run];
        let stack = Stack::new(&records);
        let draws: Vec<Vec<f64>> = (10..30).map(|seed| noise(seed, 240)).collect();
        let found = places(&stack, &[], &draws);
        assert_eq!((found[0].against.as_str(), found.len()), ("position.x", 2));
        assert!(found[0].q_value < 1e-6 && found[0].profile.len() == STRETCHES, "{:?}", found[0]);
    }

    /// The example of the paper: of fifteen p-values four are below the line at 5 %.
    #[test]
    fn false_discoveries_are_rated_as_in_the_paper() {
        let p = [
            0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719,
            0.6528, 0.7590, 1.0,
        ];
        let of = |p_value: f64| Place {
            response: String::new(),
            against: String::new(),
            statistic: 0.0,
            p_value,
            q_value: 1.0,
            profile: Vec::new(),
        };
        let mut all: Vec<Place> = p.map(of).into();
        rate(&mut all);
        assert_eq!(all.iter().filter(|p| p.q_value <= 0.05).count(), 4);
    }
}
