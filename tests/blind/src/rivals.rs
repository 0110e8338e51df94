//! What the data of a case can distinguish.
//! True effects are compared with each other, and with other laws that would do as well.

use crate::linear::{Basis, dot, length};
use crate::run::Run;
use crate::source::Source;

/// Values of a source over all responses of all runs, one after the other.
pub fn column(s: &Source, runs: &[Run]) -> Vec<f64> {
    runs.iter().flat_map(|r| r.responses.iter().flat_map(|resp| s.on(r, resp)).collect::<Vec<_>>()).collect()
}

/// Columns whose sums give every size of a source.
/// They are sine and cosine of a wave, and both terms of a parabola.
pub fn span(s: &Source, runs: &[Run]) -> Vec<Vec<f64>> {
    let with = |pairs: &[(&str, f64)]| {
        let mut one = s.clone();
        for (key, v) in &mut one.num {
            if let Some((_, x)) = pairs.iter().find(|(k, _)| k == key) {
                *v = *x;
            }
        }
        column(&one, runs)
    };
    let has = |key: &str| s.num.iter().any(|(k, _)| *k == key);
    let two: [[(&str, f64); 2]; 2] = if has("phase_rad") {
        [[("um", 1.0), ("phase_rad", 0.0)], [("um", 1.0), ("phase_rad", std::f64::consts::FRAC_PI_2)]]
    } else if has("um_per_K2") {
        [[("um_per_K", 1.0), ("um_per_K2", 0.0)], [("um_per_K", 0.0), ("um_per_K2", 1.0)]]
    } else if has("um_per_krpm2") {
        [[("um_per_krpm", 1.0), ("um_per_krpm2", 0.0)], [("um_per_krpm", 0.0), ("um_per_krpm2", 1.0)]]
    } else {
        return vec![column(s, runs)];
    };
    two.iter().map(|p| with(p)).collect()
}

/// Basis of the other effects, from which a law has to differ.
/// With `constants` it has a constant for every response.
fn beside(others: &[&Source], runs: &[Run], constants: bool) -> Basis {
    let mut basis = Basis::default();
    let rows: usize = runs.iter().map(|r| r.n * r.responses.len()).sum();
    let mut at = 0;
    let mut shared: Vec<(String, Vec<f64>)> = Vec::new();
    for r in runs {
        for resp in &r.responses {
            let key = format!("{resp} {:?}", r.zero);
            // In a record with a zero of its own the constant is no finding. The common constant is an offset.
            if constants || r.zero.is_some() {
                let at_key = shared.iter().position(|(k, _)| *k == key).unwrap_or_else(|| {
                    shared.push((key, vec![0.0; rows]));
                    shared.len() - 1
                });
                shared[at_key].1[at..at + r.n].fill(1.0);
            }
            at += r.n;
        }
    }
    for (_, c) in &shared {
        basis.add(c);
    }
    for c in others.iter().flat_map(|o| span(o, runs)) {
        basis.add(&c);
    }
    basis
}

/// Share of a source's square that the other effects do not explain.
/// Zeros of their own records count among these effects.
pub fn own_share(s: &Source, others: &[&Source], runs: &[Run]) -> f64 {
    let c = column(s, runs);
    let basis = beside(others, runs, false);
    let left = basis.rest(&c);
    dot(&left, &left) / dot(&c, &c).max(1e-300)
}

/// Names of laws with their columns.
pub type Laws = Vec<(String, Vec<Vec<f64>>)>;

/// Other laws that these runs could show, with their columns.
pub fn laws(runs: &[Run]) -> Laws {
    let mut out: Laws = Vec::new();
    let mut axes: Vec<String> = Vec::new();
    let mut places: Vec<String> = Vec::new();
    for r in runs {
        axes.extend(r.responses.iter().filter_map(|x| x.strip_prefix("error.")).map(str::to_owned));
        places.extend(r.cols.iter().filter_map(|c| c.role.strip_prefix("position.")).map(str::to_owned));
    }
    for v in [&mut axes, &mut places] {
        v.sort();
        v.dedup();
    }
    axes.retain(|a| a != "r");
    let sensors = runs.iter().flat_map(|r| r.names("temperature")).collect::<std::collections::BTreeSet<_>>();
    let channels = runs.iter().flat_map(|r| r.names("channel")).collect::<std::collections::BTreeSet<_>>();
    let end = runs.iter().flat_map(Run::time).fold(0.0, f64::max);
    let mut add = |s: Source| {
        let columns: Vec<Vec<f64>> =
            span(&s, runs).into_iter().filter(|c| c.iter().any(|v| *v != 0.0)).collect();
        if !columns.is_empty() {
            out.push((s.name, columns));
        }
    };
    for a in &axes {
        let new = |law: &str| Source::new(format!("{law}.{a}"));
        add(new("offset").p("um", 1.0));
        add(new("scale").p("ppm", 1.0));
        add(new("reversal").p("um", 1.0));
        add(new("following_error").p("ms", 1.0));
        add(new("acceleration_error").p("um_per_m_s2", 1.0));
        add(new("stiffness").p("um_per_N", 1.0));
        add(new("coolant").p("um", 1.0));
        add(new("spindle_speed").p("um_per_krpm", 1.0).p("um_per_krpm2", 0.0));
        for b in places.iter().filter(|b| *b != a) {
            add(Source::new(format!("squareness.{a}.{b}")).p("urad", 1.0));
        }
        for z in &channels {
            add(Source::new(format!("channel.{a}.{z}")).p("gain", 1.0));
        }
        for t in &sensors {
            let with = |mut s: Source| {
                s.text = vec![("sensor", t.clone())];
                s
            };
            add(with(new("thermal_growth").p("um_per_K", 1.0).p("um_per_K2", 0.0)));
            add(with(new("thermal_expansion").p("ppm_per_K", 1.0)));
            for k in 0..5 {
                let lag = new("thermal_lag").p("um_per_K", 1.0).p("um_per_K2", 0.0);
                add(with(lag.p("tau_s", end * 0.02 * 2.2_f64.powi(k))));
            }
        }
        for k in 0..6 {
            add(new("warm_up").p("um", 1.0).p("tau_s", end * 0.03 * 2.0_f64.powi(k)));
        }
        for k in 1..20 {
            add(new("lost_counts").p("um", 1.0).p("at_s", end * f64::from(k) / 20.0));
        }
    }
    for a in &axes {
        for b in &places {
            let values: Vec<f64> =
                runs.iter().filter_map(|r| r.get(&format!("position.{b}"))).flatten().copied().collect();
            if let Some(hats) = hats(&values) {
                let name = if a == b { format!("position_map.{a}") } else { format!("straightness.{a}.{b}") };
                let columns: Vec<Vec<f64>> = hats
                    .iter()
                    .map(|(knots, um)| {
                        let mut s = Source::new(name.clone());
                        s.arr = vec![("knots_mm", knots.clone()), ("um", um.clone())];
                        column(&s, runs)
                    })
                    .collect();
                // A map has no constant and no straight line.
                let line = if a == b {
                    Source::new(format!("scale.{a}")).p("ppm", 1.0)
                } else {
                    Source::new(format!("squareness.{a}.{b}")).p("urad", 1.0)
                };
                let mut straight = Basis::default();
                straight.add(&column(&Source::new(format!("offset.{a}")).p("um", 1.0), runs));
                straight.add(&column(&line, runs));
                out.push((name, columns.iter().map(|c| straight.rest(c)).collect()));
            }
        }
    }
    out
}

type Knots = (Vec<f64>, Vec<f64>);

/// Hat functions over the places, at most a dozen.
fn hats(values: &[f64]) -> Option<Vec<Knots>> {
    let mut places: Vec<i64> = values.iter().map(|p| (p * 20.0).round() as i64).collect();
    places.sort_unstable();
    places.dedup();
    if places.len() < 4 {
        return None;
    }
    let k = places.len().min(12);
    let (lo, hi) = (places[0] as f64 / 20.0, places[places.len() - 1] as f64 / 20.0);
    let knots: Vec<f64> = (0..k).map(|i| lo + (hi - lo) * i as f64 / (k - 1) as f64).collect();
    Some((0..k).map(|j| (knots.clone(), (0..k).map(|i| f64::from(u8::from(i == j))).collect())).collect())
}

/// Evidence needed to tell a source from another law, in units of the noise.
/// It is the squared residual of the source under the other law. Below this value the law is an alias.
pub const TELLS: f64 = 40.0;

/// The name of another law that these data cannot tell from a source, if any.
pub fn alias(s: &Source, others: &[&Source], runs: &[Run], laws: &Laws, sd: f64) -> Option<String> {
    let c = column(s, runs);
    let base = beside(others, runs, !s.name.starts_with("offset"));
    let left = base.rest(&c);
    if dot(&left, &left) < TELLS * sd * sd {
        return Some("what is known".into());
    }
    // The same law with another sensor, time or constant has the same name.
    let mut rivals = laws.iter().filter(|(name, _)| *name != s.name);
    rivals.find(|(_, columns)| against(&base, columns, &left) < TELLS * sd * sd).map(|(name, _)| name.clone())
}

/// Squared residual of `left` under the columns, beside a basis.
fn against(base: &Basis, columns: &[Vec<f64>], left: &[f64]) -> f64 {
    let mut own = Basis::default();
    for c in columns {
        let r = base.rest(c);
        if length(&r) > 1e-4 * length(c) {
            own.add(&r);
        }
    }
    let rest = own.rest(left);
    dot(&rest, &rest)
}

/// The law that explains most of a shape, and the share that it explains.
/// Laws in `skip` are left out. With `waves`, a wave of any period over the position is tried too.
pub fn best_law(s: &Source, others: &[&Source], runs: &[Run], waves: bool, skip: &[&str]) -> (f64, String) {
    let c = column(s, runs);
    let base = beside(others, runs, true);
    let left = base.rest(&c);
    let whole = dot(&left, &left).max(1e-300);
    let mut best = (0.0, String::new());
    let mut see = |name: String, columns: &[Vec<f64>]| {
        let share = 1.0 - against(&base, columns, &left) / whole;
        if share > best.0 {
            best = (share, name);
        }
    };
    for (name, columns) in laws(runs) {
        if !skip.iter().any(|s| name.starts_with(s)) {
            see(name, &columns);
        }
    }
    let axis = s.name.split('.').nth(1).unwrap_or_default();
    let at: Vec<f64> =
        runs.iter().filter_map(|r| r.get(&format!("position.{axis}"))).flatten().copied().collect();
    let (lo, hi) = at.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    if waves && hi > lo {
        let n = ((hi - lo) / 0.5 * 4.0).min(1200.0) as usize;
        for k in 2..n {
            let period = (hi - lo) * 4.0 / k as f64;
            if (0.5..=60.0).contains(&period) {
                let wave = Source::new(format!("screw_periodic.{axis}"))
                    .p("period_mm", period)
                    .p("um", 1.0)
                    .p("phase_rad", 0.0);
                see(wave.name.clone(), &span(&wave, runs));
            }
        }
    }
    best
}
