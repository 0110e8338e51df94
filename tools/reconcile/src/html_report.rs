//! `report.html`: the answer as one page with plots.

use crate::gap::ResidualTrace;
use crate::residual_localisation::{LEAST_P, ResidualStructure};
use crate::verdict::{ReconciliationResult, Verdict};
use rtec_estimate::rows_and_noise::{MeasuredRows, ResponseSegment};
use rtec_files::message_text::escaped;
use rtec_measure::plot::{Chart, Colour, PlotSpec, Series, Style};
use rtec_measure::report::{ReportedRecord, STYLE, signed_line};
use rtec_model::effect::{Effect, ParameterFitMethod};
use rtec_model::machine::NORMAL_95;
use rtec_model::record::span;
use std::fmt::Write as _;

/// Size of a plot, px.
const PLOT_PX: (u32, u32) = (900, 330);
/// Most explanations and most places that are shown.
const RANKED: usize = 16;
const PLACES: usize = 14;
/// Stretches of a plot's axis; from each the least and the largest row is drawn.
const STRETCHES: usize = 250;

/// The report: findings, records, figures of the fit, and a line for a signature.
/// It prints on A4.
#[must_use]
pub fn html(r: &ReconciliationResult, machine: &str) -> String {
    let mut h = String::new();
    let _ = write!(
        h,
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Reconciliation of {0}</title><style>{STYLE}\
         .verdict{{font-size:1.15em}}.tag{{display:inline-block;padding:.1em .6em;border-radius:.3em;color:#fff;background:{1}}}\
         small{{color:#5b6b7b}}.bar{{background:#0072b2;height:.8em}}.no{{background:#c3ccd6}}</style>\
         <h1>Reconciliation of {0}</h1><p class=\"verdict\"><span class=\"tag\">{2}</span> {3}</p>",
        escaped(machine),
        match r.verdict {
            Verdict::Named => "#2a7d46",
            Verdict::NothingMissing => "#5b6b7b",
            Verdict::NotSeparable => "#b36b00",
            Verdict::UnknownEffect => "#a33",
        },
        r.verdict.name().replace('_', " "),
        escaped(&[Some(headline(r)), r.reservation()].into_iter().flatten().collect::<Vec<_>>().join("; ")),
    );
    facts(&mut h, r);
    gap(&mut h, r);
    effects(&mut h, r);
    refined(&mut h, r);
    for chart in maps(r) {
        figure(&mut h, &chart);
    }
    if !r.traces.is_empty() {
        h.push_str("<h2>Measured minus simulated, before and after</h2>");
    }
    for t in &r.traces {
        figure(&mut h, &chart(t, STRETCHES));
    }
    contributions(&mut h, r);
    budget(&mut h, r);
    set_up(&mut h, r);
    places(&mut h, r);
    ranking(&mut h, r);
    doubts(&mut h, r);
    if !r.advice.is_empty() {
        let _ = write!(h, "<h2>Next experiment</h2><p>{}</p>", escaped(&r.advice));
    }
    let mut days: Vec<&str> = r.records.iter().filter_map(|x| x.date.as_deref()).collect();
    days.sort_unstable();
    days.dedup();
    h.push_str(&signed_line("", "", &days.join(", ")));
    let _ = write!(
        h,
        "<p><small>{}, reconcile; false-alarm rate {}; block permutation, seed {}; noise autocorrelation from row to row {}. \
         Intervals hold 95 %.</small></p></html>",
        rtec_files::file_format_stamp::writer(),
        r.level,
        crate::SEED,
        number(r.phi)
    );
    h
}

fn figure(h: &mut String, chart: &Chart) {
    // A chart without a finite value has nothing to draw.
    if let Ok(svg) = chart.svg(PLOT_PX.0, PLOT_PX.1) {
        let _ = write!(h, "<figure>{svg}</figure>");
    }
}

/// The records of the verdict.
fn facts(h: &mut String, r: &ReconciliationResult) {
    h.push_str("<table class=\"facts\">");
    for x in &r.records {
        let run = ReportedRecord::of(x);
        let date = run.date.map(|d| format!(", {d}")).unwrap_or_default();
        let note = run.note.map(|n| format!(", {n}")).unwrap_or_default();
        let hash = run.sha256.get(..12).map(|s| format!(", SHA-256 {s}…")).unwrap_or_default();
        let text = format!("{}, {} rows{date}{hash}{note}", run.name, run.rows);
        let _ = write!(h, "<tr><td>record</td><td>{}</td></tr>", escaped(&text));
    }
    h.push_str("</table>");
}

fn unit_of(response: &str) -> &'static str {
    if response.starts_with("force") { "N" } else { "µm" }
}

/// Maps and straightness found or corrected, with the band of their intervals.
fn maps(r: &ReconciliationResult) -> Vec<Chart> {
    let found = r.effects.iter().map(|(f, half)| (&f.effect, half));
    let all = found.chain(r.refined.iter().map(|x| (&x.after.0, &x.after.1)));
    all.filter_map(|(effect, half)| map(effect, half)).collect()
}

fn map(effect: &Effect, half: &[f64]) -> Option<Chart> {
    let (law, width) = (effect.description(), effect.width());
    let knots = law.parameters.iter().position(|p| p.array && p.search == ParameterFitMethod::Chosen)?;
    let values = law.parameters.iter().position(|p| p.array && p.search != ParameterFitMethod::Chosen)?;
    let (x, y) = (effect.get(knots), effect.get(values));
    let half = half.get(values * width..(values + 1) * width)?;
    let edge = |sign: f64| y.iter().zip(half).map(|(y, h)| y + sign * h).collect::<Vec<_>>();
    let along = effect.axes().last().map_or_else(String::new, |a| format!("position of {a} (mm)"));
    let name = effect.name();
    let line = x.iter().copied().zip(y.iter().copied()).collect::<Vec<_>>();
    let chart = Chart::new(
        &format!("{name}, with its 95 % band"),
        &along,
        &micrometres(&law.parameters[values].unit),
    )
    .with(Series::band("95 %", x, &edge(-1.0), &edge(1.0)))
    .with(Series::new(&name, Style::Line, line.clone()).coloured(Colour::Up));
    Some(chart.with(Series::new("", Style::Dots, line).coloured(Colour::Up)))
}

/// The contribution of every effect of the better model, largest first.
/// It is the effect's range in the run that shows it most.
fn contributions(h: &mut String, r: &ReconciliationResult) {
    let rows = MeasuredRows::new(&r.records);
    let mut all: Vec<(String, &str, &str, f64)> = Vec::new();
    // A constant is the zero of a gauge or the centre of a circle, and no error of the machine.
    for effect in r.model.effects().filter(|e| !e.description().may_be_set_up()) {
        let predicted = rows.predict(effect);
        let range = |s: &ResponseSegment| {
            let [l, u] = span(&predicted[s.rows.clone()]);
            (u - l, unit_of(&rows.responses[s.response].to_string()))
        };
        let Some((range, unit)) = rows.segments.iter().map(range).max_by(|a, b| a.0.total_cmp(&b.0)) else {
            continue;
        };
        let is = |e: &Effect| e.identity() == effect.identity();
        let how = if r.effects.iter().any(|(f, _)| is(&f.effect)) {
            "found"
        } else if r.refined.iter().any(|x| is(&x.after.0)) {
            "corrected"
        } else {
            "known"
        };
        let sensor = effect.delta.as_ref().map_or_else(String::new, |d| format!(" ({d})"));
        all.push((effect.name() + &sensor, how, unit, range));
    }
    all.retain(|c| c.3 > 0.0);
    all.sort_by(|a, b| b.3.total_cmp(&a.3));
    if all.is_empty() {
        return;
    }
    h.push_str(
        "<h2>Contributions, ranked: range that each makes in the run that shows it most, share of their sum</h2>\
         <table><thead><tr><th class=n>rank<th>effect<th>model<th class=n>makes<th class=n>share<th></thead>",
    );
    for (i, (name, how, unit, range)) in all.iter().enumerate() {
        let sum: f64 = all.iter().filter(|c| c.2 == *unit).map(|c| c.3).sum();
        let share = 100.0 * range / sum;
        let _ = write!(
            h,
            "<tr><td class=n>{}<td>{}<td>{how}<td class=n>{} {unit}<td class=n>{share:.0} %<td width=\"30%\">\
             <div class=\"bar\" style=\"width:{:.0}%\"></div>",
            i + 1,
            escaped(name),
            number(*range),
            share.max(1.0)
        );
    }
    h.push_str("</table>");
}

/// The uncertainty of one predicted reading.
/// It combines the noise and each value that was found or corrected.
fn budget(h: &mut String, r: &ReconciliationResult) {
    let rows = MeasuredRows::new(&r.records);
    let found = r.effects.iter().map(|(f, half)| (&f.effect, half));
    let values: Vec<(&Effect, &Vec<f64>)> =
        found.chain(r.refined.iter().map(|x| (&x.after.0, &x.after.1))).collect();
    for g in &r.gap {
        let unit = if g.unit == "um" { "µm" } else { &g.unit };
        let own = |s: &&ResponseSegment| unit_of(&rows.responses[s.response].to_string()) == unit;
        let count: usize = rows.segments.iter().filter(own).map(|s| s.rows.len()).sum();
        let mut parts = vec![("noise of one reading".to_owned(), g.floor)];
        for (effect, half) in &values {
            let mut squares = 0.0;
            for (slope, half) in rows.slopes(effect).iter().zip(half.iter()) {
                let rows = rows.segments.iter().filter(own).flat_map(|s| &slope[s.rows.clone()]);
                squares += (half / NORMAL_95).powi(2) * rows.map(|v| v * v).sum::<f64>();
            }
            parts.push((
                format!("what is not known of {}", effect.name()),
                (squares / count.max(1) as f64).sqrt(),
            ));
        }
        let (where_left, left) = match (g.holdout, g.blocked) {
            (Some(p), _) => ("on the hold-out", p[1]),
            (None, Some(p)) => ("in blocks left out in turn", p[1]),
            (None, None) => ("on these runs", g.train[1]),
        };
        // The model's residual beyond the noise is as real as the noise.
        let beyond = (left * left - g.floor * g.floor).max(0.0).sqrt();
        parts.push((format!("left beyond the noise {where_left}"), beyond));
        parts.retain(|(_, u)| *u > 0.0);
        let together = parts.iter().map(|(_, u)| u * u).sum::<f64>().sqrt();
        if !together.is_finite() || together == 0.0 {
            continue;
        }
        let _ = write!(
            h,
            "<h2>Uncertainty of one reading that the better model predicts, mean over these runs</h2>\
             <table><thead><tr><th>contributor<th class=n>standard uncertainty ({unit})<th class=n>share of the variance</thead>"
        );
        for (name, u) in &parts {
            let share = 100.0 * (u / together).powi(2);
            let _ = write!(h, "<tr><td>{}<td class=n>{}<td class=n>{share:.0} %", escaped(name), number(*u));
        }
        let _ = write!(
            h,
            "<tr><td>together<td class=n>{}<td class=n>100 %<tr><td>expanded, k = 2<td class=n>{}<td></table>\
             <p><small>Without what the records cannot show: the instrument's calibration, its alignment, the air. \
             <code>characterise evaluate --conditions</code> reckons with these. Values found together are taken as independent.</small></p>",
            number(together),
            number(2.0 * together)
        );
    }
}

/// The set-up found for each record.
fn set_up(h: &mut String, r: &ReconciliationResult) {
    let all = || r.set_up.iter().filter(|s| !s.terms.is_empty());
    if all().next().is_none() {
        return;
    }
    h.push_str(
        "<h2>Set-up found, record by record: in no model</h2>\
         <table><thead><tr><th>record<th>term<th class=n>value<th class=n>interval</thead>",
    );
    for s in all() {
        let name = s.record.rsplit('/').next().unwrap_or_default();
        for (term, value, half) in &s.terms {
            let (what, unit) = term_of(term);
            let _ = write!(
                h,
                "<tr><td>{}<td>{}<td class=n>{} {unit}<td class=n>{}",
                escaped(name),
                escaped(&what),
                self::value(*value, *half),
                if *half > 0.0 { within(*value, *half) } else { String::new() }
            );
        }
    }
    h.push_str("</table>");
}

/// A set-up term in words, and its unit.
fn term_of(term: &str) -> (String, &'static str) {
    match term.split_once('.') {
        Some(("zero_um", response)) => (format!("zero of {response}"), "µm"),
        Some(("centre_um", "0")) => ("centre, first axis of the plane".to_owned(), "µm"),
        Some(("centre_um", _)) => ("centre, second axis of the plane".to_owned(), "µm"),
        Some(("line_um_per_h", response)) => (format!("line in time of {response}"), "µm/h"),
        _ if term == "bar_um" => ("length of the bar, less nominal".to_owned(), "µm"),
        _ if term == "jump_um" => ("jump at a pause".to_owned(), "µm"),
        _ => (term.to_owned(), ""),
    }
}

/// The data of the report's plots.
/// They are the residuals before and after, maps with their bands, means over the variables that matter, and
/// the names that were tried.
#[must_use]
pub fn pictures(r: &ReconciliationResult) -> Vec<PlotSpec> {
    let place = |p: &ResidualStructure| {
        let unit = unit_of(&p.response);
        let mean = p.profile.iter().map(|v| (v[0], v[1])).collect();
        let title = format!("{} against {}: {:.1} %", p.response, p.against, 100.0 * p.statistic);
        Chart::new(&title, &p.against, unit).with(Series::new("mean", Style::Line, mean))
    };
    let mut all: Vec<PlotSpec> = r.traces.iter().map(|t| chart(t, usize::MAX).into()).collect();
    all.extend(maps(r).into_iter().map(PlotSpec::from));
    all.extend(found(r).map(|p| PlotSpec::from(place(p))));
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

/// The places that are not due to chance, as many as a page shows.
fn found(r: &ReconciliationResult) -> impl Iterator<Item = &ResidualStructure> {
    r.places.iter().filter(|p| p.q_value <= 0.05).take(PLACES)
}

fn doubts(h: &mut String, r: &ReconciliationResult) {
    for (title, lines) in [
        ("What looks like a mistake", r.suspicions.iter().map(ToString::to_string).collect()),
        ("Left out", r.left_out.clone()),
    ] {
        let lines: Vec<String> = lines;
        if !lines.is_empty() {
            let _ = write!(h, "<h2>{title}</h2><ul>");
            for line in &lines {
                let _ = write!(h, "<li>{}", escaped(line));
            }
            h.push_str("</ul>");
        }
    }
}

fn refined(h: &mut String, r: &ReconciliationResult) {
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
                escaped(&x.before.name()),
                p.name,
                micrometres(&p.unit),
                number(b),
                value(a, half),
                if half > 0.0 { within(a, half) } else { "held".into() }
            );
        }
    }
    h.push_str("</table>");
}

fn headline(r: &ReconciliationResult) -> String {
    let names = r.effects.iter().map(|(f, _)| f.effect.name()).collect::<Vec<_>>().join(", ");
    match r.verdict {
        Verdict::Named => format!("missing: {names}"),
        Verdict::NotSeparable => {
            format!("something is missing; likeliest {names}, but this data cannot tell it from its rivals")
        }
        Verdict::UnknownEffect => r
            .unexplained
            .iter()
            .map(|s| match (&s.response, s.against.join(" and "), &s.manner) {
                // Nothing was judged.
                (response, against, why) if against.is_empty() => format!("{response}: {why}"),
                (response, against, manner) => {
                    format!(
                        "{response} has structure against {against} ({manner}) that no known effect explains"
                    )
                }
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

fn gap(h: &mut String, r: &ReconciliationResult) {
    h.push_str("<h2>The gap</h2><table><tr><th>records<th class=n>RMS before<th class=n>after<th class=n>floor<th class=n>closed");
    for g in &r.gap {
        let mut row = |name: &str, pair: [f64; 2], unseen: bool| {
            let share = g.closed_by(pair).map_or_else(|| "–".to_owned(), |c| format!("{:.1} %", 100.0 * c));
            let closed = if unseen { share } else { String::new() };
            let _ = write!(
                h,
                "<tr><td>{name}<td class=n>{} {u}<td class=n>{} {u}<td class=n>{} {u}<td class=n>{closed}",
                number(pair[0]),
                number(pair[1]),
                number(g.floor),
                u = if g.unit == "um" { "µm" } else { &g.unit }
            );
        };
        row("training", g.train, false);
        if let Some(p) = g.holdout {
            row("hold-out, never used before", p, true);
        }
        if let Some(p) = g.blocked {
            row("training, blocks left out in turn", p, true);
        }
    }
    h.push_str("</table>");
}

fn effects(h: &mut String, r: &ReconciliationResult) {
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
                (format!("{} values, drawn below", f.effect.width()), String::new())
            } else {
                let (v, w) = (f.effect.scalar(i), half[i]);
                (self::value(v, w), if w > 0.0 { within(v, w) } else { "held".into() })
            };
            let (name, law, rivals) = if i == 0 {
                (escaped(&f.effect.name()) + &escaped(&sensor), escaped(&description.law), rivals.clone())
            } else {
                Default::default()
            };
            let _ = write!(
                h,
                "<tr><td>{name}<td><small>{law}</small><td>{} ({})<td class=n>{value}<td class=n>{interval}<td>{rivals}",
                p.name,
                micrometres(&p.unit)
            );
        }
        let p = if f.p_value <= LEAST_P { "below 0.001".to_owned() } else { number(f.p_value) };
        let _ = write!(
            h,
            "<tr><td colspan=6><small>{}: {}. Probability that chance alone explains as much: {p}.</small>",
            escaped(&f.effect.name()),
            escaped(&description.cause)
        );
    }
    h.push_str("</table>");
}

/// A trace over position, angle or time.
/// Before is grey, after is coloured; up and down are separate.
fn chart(t: &ResidualTrace, stretches: usize) -> Chart {
    let unit = unit_of(&t.response);
    let held = if t.holdout { ", hold-out" } else { "" };
    let style = if t.over.in_order { Style::Line } else { Style::Dots };
    let of = |data: &[f64], sign: f64| {
        let rows = t.over.values.iter().copied().zip(data.iter().copied()).enumerate();
        let way = |i: usize| t.over.direction.get(i).copied().unwrap_or(0.0);
        let own = rows.filter(|(i, _)| sign == 0.0 || way(*i) * sign > 0.0);
        of_stretches(own.map(|(_, p)| p).collect(), stretches)
    };
    let title = format!("{}, {}{held}: measured minus simulated", t.file, t.response);
    let chart = Chart::new(&title, &t.over.name, &format!("{} ({unit})", t.response))
        .with(Series::new("before", Style::Dots, of(&t.before, 0.0)).coloured(Colour::Grey));
    if t.over.direction.is_empty() {
        return chart.with(Series::new("after", style, of(&t.after, 0.0)).coloured(Colour::Up));
    }
    let ways = [("after, up", 1.0, Colour::Up), ("after, down", -1.0, Colour::Down)];
    ways.into_iter().fold(chart, |chart, (name, sign, colour)| {
        chart.with(Series::new(name, style, of(&t.after, sign)).coloured(colour))
    })
}

/// The least and the largest point of each stretch of an axis.
/// They keep their order.
fn of_stretches(points: Vec<(f64, f64)>, stretches: usize) -> Vec<(f64, f64)> {
    if points.len() / 2 <= stretches {
        return points;
    }
    let [l, u] = span(points.iter().map(|p| p.0));
    let mut ends: Vec<Option<(usize, usize)>> = vec![None; stretches];
    for (i, p) in points.iter().enumerate() {
        let at = ((p.0 - l) / (u - l).max(f64::MIN_POSITIVE) * stretches as f64) as usize;
        let end = ends[at.min(stretches - 1)].get_or_insert((i, i));
        *end = (if p.1 < points[end.0].1 { i } else { end.0 }, if p.1 > points[end.1].1 { i } else { end.1 });
    }
    let mut kept: Vec<usize> = ends.into_iter().flatten().flat_map(|(a, b)| [a, b]).collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|i| points[i]).collect()
}

fn places(h: &mut String, r: &ReconciliationResult) {
    h.push_str("<h2>What it goes with</h2><table><tr><th>response<th>against<th class=n>share explained<th class=n>p<th>mean over it");
    for p in found(r) {
        let [lo, hi] = span(p.profile.iter().map(|v| v[1]));
        let [a, b] = [p.profile.first(), p.profile.last()].map(|v| v.map_or(0.0, |v| v[0]));
        let mut line = String::new();
        for v in &p.profile {
            let x = 70.0 + 160.0 * (v[0] - a) / (b - a).max(1e-300);
            let y = 4.0 + 28.0 * (hi - v[1]) / (hi - lo).max(1e-300);
            let _ = write!(line, "{}{x:.1} {y:.1}", if line.is_empty() { "M" } else { "L" });
        }
        let _ = write!(
            h,
            "<tr><td>{}<td>{}<td class=n>{:.1} %<td class=n>{}<td><svg viewBox=\"0 0 240 36\" width=\"240\" style=\"margin:0\"><text x=\"64\" y=\"12\" font-size=\"10\" text-anchor=\"end\">{}</text><text x=\"64\" y=\"34\" font-size=\"10\" text-anchor=\"end\">{}</text><path d=\"{line}\" fill=\"none\" stroke=\"#0072b2\" stroke-width=\"1.5\"/></svg>",
            escaped(&p.response),
            escaped(&p.against),
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

fn ranking(h: &mut String, r: &ReconciliationResult) {
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
            escaped(&t.label),
            t.odds
        );
    }
    h.push_str("</table>");
}

/// A unit as people write it.
fn micrometres(unit: &str) -> String {
    unit.replace("um", "µm")
}

/// Decimals that half an interval justifies.
fn decimals(half: f64) -> usize {
    (1.0 - half.log10().floor()).clamp(0.0, 12.0) as usize
}

/// An interval, with the digits that its half width justifies.
fn within(v: f64, half: f64) -> String {
    let decimals = decimals(half);
    format!("{:.decimals$} … {:.decimals$}", v - half, v + half)
}

/// A value, with the digits of its interval; four significant ones without it.
fn value(v: f64, half: f64) -> String {
    if half > 0.0 { format!("{v:.0$}", decimals(half)) } else { number(v) }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_has_the_digits_of_its_interval() {
        assert_eq!((value(10.000_37, 4.3e-4), value(0.0, 0.16)), ("10.00037".into(), "0.00".into()));
        assert_eq!((value(44.947_06, 2.5e-4), value(44.947_06, 0.0)), ("44.94706".into(), "44.95".into()));
        assert_eq!(within(10.000_37, 4.3e-4), "9.99994 … 10.00080");
    }

    #[test]
    fn many_rows_keep_their_peaks_and_their_order() {
        let mut points: Vec<(f64, f64)> =
            (0..100_000).map(|i| (f64::from(i % 1000), f64::from(i % 7))).collect();
        points[54_321].1 = 99.0;
        points[12_345].1 = -99.0;
        let kept = of_stretches(points.clone(), STRETCHES);
        assert!(
            kept.len() <= 2 * STRETCHES && kept.contains(&points[54_321]) && kept.contains(&points[12_345])
        );
        let few = points[..400].to_vec();
        assert_eq!(of_stretches(few.clone(), STRETCHES), few);
        // Points at one place form no stretches.
        assert_eq!(of_stretches(vec![(3.0, 1.0); 1000], STRETCHES).len(), 1);
    }
}
