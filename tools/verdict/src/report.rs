//! `report.html`: the answer for a person, in one file, plots inside.

use crate::gap::Trace;
use crate::verdict::{Reconciliation, Verdict};
use crate::where_found::{LEAST_P, Place};
use rtec_measure::plot::{Chart, Colour, Picture, Series, Style};
use std::fmt::Write as _;

const WIDTH: f64 = 860.0;
/// So many explanations are shown, and so many places.
const RANKED: usize = 16;
const PLACES: usize = 14;
/// So many rows, or groups of them, a plot on the page has.
const ON_PAGE: usize = 500;

/// The report.
#[must_use]
pub fn html(r: &Reconciliation, machine: &str) -> String {
    let mut h = String::new();
    let _ = write!(
        h,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Reconciliation of {0}</title><style>\
         body{{font:15px/1.45 system-ui,sans-serif;color:#1c2733;max-width:{WIDTH}px;margin:2em auto;padding:0 1em}}\
         h1{{font-size:1.5em;margin-bottom:.2em}}h2{{font-size:1.1em;margin:1.8em 0 .4em;border-bottom:1px solid #ccd5de}}\
         table{{border-collapse:collapse;width:100%}}td,th{{text-align:left;padding:.25em .6em .25em 0;border-bottom:1px solid #e6ebf0;\
         vertical-align:top}}td.n,th.n{{text-align:right;font-variant-numeric:tabular-nums}}.verdict{{font-size:1.15em}}\
         .tag{{display:inline-block;padding:.1em .6em;border-radius:.3em;color:#fff;background:{1}}}\
         svg{{display:block;margin:.6em 0}}small{{color:#5b6b7b}}.bar{{background:#0072b2;height:.8em}}.no{{background:#c3ccd6}}</style>\
         <h1>Reconciliation of {0}</h1><p class=\"verdict\"><span class=\"tag\">{2}</span> {3}</p>",
        escape(machine),
        match r.verdict {
            Verdict::Named => "#2a7d46",
            Verdict::NothingMissing => "#5b6b7b",
            Verdict::NotSeparable => "#b36b00",
            Verdict::UnknownEffect => "#a33",
        },
        r.verdict.name().replace('_', " "),
        escape(&[Some(headline(r)), r.unsaid()].into_iter().flatten().collect::<Vec<_>>().join("; ")),
    );
    gap(&mut h, r);
    effects(&mut h, r);
    refined(&mut h, r);
    h.push_str("<h2>Measured minus simulated, before and after</h2>");
    for t in &r.traces {
        trace(&mut h, t);
    }
    places(&mut h, r);
    ranking(&mut h, r);
    doubts(&mut h, r);
    if !r.advice.is_empty() {
        let _ = write!(h, "<h2>Next experiment</h2><p>{}</p>", escape(&r.advice));
    }
    let _ = write!(
        h,
        "<p><small>False-alarm rate {}; block permutation, seed {}; noise autocorrelation from row to row {}. Intervals hold 95 %.</small></p></html>",
        r.level,
        crate::SEED,
        number(r.phi)
    );
    h
}

/// What the report's plots show, as data: what is left before and after, the means over what it depends on, and what
/// was tried.
#[must_use]
pub fn pictures(r: &Reconciliation) -> Vec<Picture> {
    let place = |p: &Place| {
        let unit = if p.response.starts_with("force") { "N" } else { "µm" };
        let mean = p.profile.iter().map(|v| (v[0], v[1])).collect();
        let title = format!("{} against {}: {:.1} %", p.response, p.against, 100.0 * p.statistic);
        Chart::new(&title, &p.against, unit).with(Series::new("mean", Style::Line, mean))
    };
    let mut all: Vec<Picture> = r.traces.iter().map(|t| chart(t, usize::MAX).into()).collect();
    all.extend(found(r).map(|p| Picture::from(place(p))));
    let tried: Vec<_> = r.ranking.iter().take(RANKED).collect();
    if !tried.is_empty() {
        let bars = |accepted: bool| {
            let own = tried.iter().enumerate().filter(|(_, t)| t.accepted == accepted);
            own.map(|(i, t)| (i as f64, t.odds)).collect::<Vec<_>>()
        };
        let mut chart = Chart::new("What was tried", "explanation", "log odds against the best");
        chart.x_names = tried.iter().map(|t| t.label.clone()).collect();
        for (name, accepted, colour) in [("accepted", true, Colour::Up), ("not", false, Colour::Grey)] {
            chart = chart.with(Series::new(name, Style::Bars, bars(accepted)).coloured(colour));
        }
        all.push(chart.into());
    }
    all
}

/// The places that are no chance, as many as a page shows.
fn found(r: &Reconciliation) -> impl Iterator<Item = &Place> {
    r.places.iter().filter(|p| p.q_value <= 0.05).take(PLACES)
}

fn doubts(h: &mut String, r: &Reconciliation) {
    for (title, lines) in [
        ("What looks like a mistake", r.suspicions.iter().map(ToString::to_string).collect()),
        ("Left out", r.left_out.clone()),
    ] {
        let lines: Vec<String> = lines;
        if !lines.is_empty() {
            let _ = write!(h, "<h2>{title}</h2><ul>");
            for line in &lines {
                let _ = write!(h, "<li>{}", escape(line));
            }
            h.push_str("</ul>");
        }
    }
}

fn refined(h: &mut String, r: &Reconciliation) {
    if r.refined.is_empty() {
        return;
    }
    h.push_str("<h2>What the model had slightly wrong</h2><table><tr><th>effect<th>parameter<th class=n>model<th class=n>data<th class=n>interval");
    for x in &r.refined {
        for (i, p) in x.before.description().parameters.iter().enumerate().filter(|(_, p)| !p.array) {
            let (b, a, half) = (x.before.scalar(i), x.after.0.scalar(i), x.after.1[i]);
            let _ = write!(
                h,
                "<tr><td>{}<td>{} ({})<td class=n>{}<td class=n>{}<td class=n>{}",
                escape(&x.before.name()),
                p.name,
                p.unit,
                number(b),
                number(a),
                if half > 0.0 { within(a, half) } else { "held".into() }
            );
        }
    }
    h.push_str("</table>");
}

fn headline(r: &Reconciliation) -> String {
    let names = r.effects.iter().map(|(f, _)| f.effect.name()).collect::<Vec<_>>().join(", ");
    match r.verdict {
        Verdict::Named => format!("missing: {names}"),
        Verdict::NotSeparable => {
            format!("something is missing; likeliest {names}, but this data cannot tell it from its rivals")
        }
        Verdict::UnknownEffect => r
            .unexplained
            .iter()
            .map(|s| {
                format!(
                    "{} has structure against {} ({}) that no known effect explains",
                    s.response,
                    s.against.join(" and "),
                    s.manner
                )
            })
            .chain(r.curve.iter().map(|(e, _)| {
                format!("the model has {} in its place: a bounded curve, marked as unexplained", e.name())
            }))
            .collect::<Vec<_>>()
            .join("; "),
        Verdict::NothingMissing if r.refined.is_empty() => "model and measurement agree".to_owned(),
        Verdict::NothingMissing => "no effect is missing; parameters of the model were corrected".to_owned(),
    }
}

fn gap(h: &mut String, r: &Reconciliation) {
    h.push_str("<h2>The gap</h2><table><tr><th>records<th class=n>RMS before<th class=n>after<th class=n>floor<th class=n>closed");
    for g in &r.gap {
        let closed = g.closed().map_or_else(|| "–".to_owned(), |c| format!("{:.1} %", 100.0 * c));
        let mut row = |name: &str, pair: [f64; 2], closed: &str| {
            let _ = write!(
                h,
                "<tr><td>{name}<td class=n>{} {u}<td class=n>{} {u}<td class=n>{} {u}<td class=n>{closed}",
                number(pair[0]),
                number(pair[1]),
                number(g.floor),
                u = if g.unit == "um" { "µm" } else { &g.unit }
            );
        };
        row("training", g.train, "");
        if let Some(p) = g.holdout {
            row("hold-out, never used before", p, &closed);
        }
        if let Some(p) = g.blocked {
            row("training, blocks left out in turn", p, &closed);
        }
    }
    h.push_str("</table>");
}

fn effects(h: &mut String, r: &Reconciliation) {
    if r.effects.is_empty() {
        return;
    }
    h.push_str("<h2>What is missing</h2><table><tr><th>effect<th>law<th>parameter<th class=n>value<th class=n>interval<th>what else it might be");
    for (f, half) in &r.effects {
        let description = f.effect.description();
        let sensor = f.effect.delta.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        let rivals = f
            .rivals
            .iter()
            .map(|v| format!("{}, odds 1:{:.1}", v.label(), v.margin.exp()))
            .collect::<Vec<_>>()
            .join("<br>");
        for (i, p) in description.parameters.iter().enumerate() {
            let (value, interval) = if p.array {
                (format!("{} values", f.effect.width()), String::new())
            } else {
                let (v, w) = (f.effect.scalar(i), half[i]);
                (number(v), if w > 0.0 { within(v, w) } else { "held".into() })
            };
            let (name, law, rivals) = if i == 0 {
                (escape(&f.effect.name()) + &escape(&sensor), escape(&description.law), rivals.clone())
            } else {
                Default::default()
            };
            let _ = write!(
                h,
                "<tr><td>{name}<td><small>{law}</small><td>{} ({})<td class=n>{value}<td class=n>{interval}<td>{rivals}",
                p.name, p.unit
            );
        }
        let p = if f.p_value <= LEAST_P { "below 0.001".to_owned() } else { number(f.p_value) };
        let _ = write!(
            h,
            "<tr><td colspan=6><small>{}: {}. Probability that chance alone explains as much: {p}.</small>",
            escape(&f.effect.name()),
            escape(&description.cause)
        );
    }
    h.push_str("</table>");
}

/// A trace with its rows along, before as dots, after as a line; of more rows than this the least and the largest of groups.
fn chart(t: &Trace, most: usize) -> Chart {
    let unit = if t.response.starts_with("force") { "N" } else { "µm" };
    let held = if t.holdout { ", hold-out" } else { "" };
    let series = |name: &str, style: Style, data: &[f64]| {
        let group = data.len().div_ceil(most).max(1);
        let points = data.chunks(group).enumerate().flat_map(|(g, part)| {
            let (l, u) = part.iter().fold((f64::MAX, f64::MIN), |(l, u), v| (l.min(*v), u.max(*v)));
            let both = if group == 1 { vec![l] } else { vec![l, u] };
            both.into_iter().map(move |v| ((g * group + 1) as f64, v))
        });
        Series::new(name, style, points.collect())
    };
    let title = format!("{}, {}{held}: measured minus simulated", t.file, t.response);
    Chart::new(&title, "row", &format!("{} ({unit})", t.response))
        .with(series("before", Style::Dots, &t.before).coloured(Colour::Grey))
        .with(series("after", Style::Line, &t.after).coloured(Colour::Up))
}

fn trace(h: &mut String, t: &Trace) {
    // A trace without a finite value has nothing to draw.
    if let Ok(svg) = chart(t, ON_PAGE).svg(WIDTH as u32, 300) {
        h.push_str(&svg);
    }
}

fn places(h: &mut String, r: &Reconciliation) {
    h.push_str("<h2>What it goes with</h2><table><tr><th>response<th>against<th class=n>share explained<th class=n>p<th>mean over it");
    for p in found(r) {
        let (lo, hi) = p.profile.iter().fold((f64::MAX, f64::MIN), |(l, u), v| (l.min(v[1]), u.max(v[1])));
        let (a, b) = (p.profile[0][0], p.profile[p.profile.len() - 1][0]);
        let mut line = String::new();
        for v in &p.profile {
            let x = 70.0 + 160.0 * (v[0] - a) / (b - a).max(1e-300);
            let y = 4.0 + 28.0 * (hi - v[1]) / (hi - lo).max(1e-300);
            let _ = write!(line, "{}{x:.1} {y:.1}", if line.is_empty() { "M" } else { "L" });
        }
        let _ = write!(
            h,
            "<tr><td>{}<td>{}<td class=n>{:.1} %<td class=n>{}<td><svg viewBox=\"0 0 240 36\" width=\"240\" style=\"margin:0\"><text x=\"64\" y=\"12\" font-size=\"10\" text-anchor=\"end\">{}</text><text x=\"64\" y=\"34\" font-size=\"10\" text-anchor=\"end\">{}</text><path d=\"{line}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\"/></svg>",
            escape(&p.response),
            escape(&p.against),
            100.0 * p.statistic,
            if p.p_value <= LEAST_P { "&lt; 0.001".to_owned() } else { number(p.p_value) },
            number(hi),
            number(lo)
        );
    }
    h.push_str("</table>");
    if !r.places.iter().any(|p| p.q_value <= 0.05) {
        h.push_str("<p>Nowhere beyond chance (false-discovery rate 5 %).</p>");
    }
}

fn ranking(h: &mut String, r: &Reconciliation) {
    h.push_str("<h2>What was tried</h2><table><tr><th>explanation<th class=n>log odds<th>margin<th>why");
    let worst = r.ranking.iter().map(|t| t.odds).fold(-1.0, f64::min);
    for t in r.ranking.iter().take(RANKED) {
        let (why, class) = if t.accepted {
            ("accepted", "bar")
        } else if r.effects.is_empty() {
            ("no better than chance, for the freedom it takes", "bar no")
        } else if t.odds > -3.0 {
            ("cannot be told from what was accepted", "bar no")
        } else {
            ("explains less, or needs more freedom", "bar no")
        };
        let width = 100.0 * (1.0 - t.odds / worst.min(-1.0)).clamp(0.02, 1.0);
        let _ = write!(
            h,
            "<tr><td>{}<td class=n>{:.1}<td width=\"30%\"><div class=\"{class}\" style=\"width:{width:.0}%\"></div><td><small>{why}</small>",
            escape(&t.label),
            t.odds
        );
    }
    h.push_str("</table>");
}

/// A value and its interval, with as many digits as the interval's half leaves.
fn within(v: f64, half: f64) -> String {
    let decimals = (1.0 - half.log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{:.decimals$} … {:.decimals$}", v - half, v + half)
}

/// Four significant digits.
fn number(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return format!("{v}");
    }
    let digits = 3 - v.abs().log10().floor() as i32;
    if (-3..=8).contains(&digits) {
        let text = format!("{:.*}", digits.max(0) as usize, v);
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    } else {
        format!("{v:.3e}")
    }
}

fn escape(s: &str) -> String {
    s.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
