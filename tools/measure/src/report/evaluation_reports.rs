//! The reports of the evaluations, each in its standard's order.

use super::{Report, ReportedRecord};
use crate::ballbar::{BallbarResult, ByAxis, ContourResult};
use crate::compensation_export::number;
use crate::drilled_plate::DrilledPlateFit;
use crate::figure_history::{FigureHistory, MachineHistory};
use crate::iso230::{
    CircleAndDriftUncertainty, DiagonalResult, DiagonalTestResult, DriftFigures, DriftResult,
    PositioningResult, ReturnRepeatability, StraightnessResult, TargetResult, TestConditions,
};
use crate::plot::{Chart, Colour, PlotError, PlotSpec, PolarPlot, Series, Style};
use rtec_model::record::Record;
use std::collections::BTreeMap;

/// A report with its plots, or the plot that failed.
type Drawn = Result<Report, PlotError>;

/// µm (or µrad) with two decimals, or one from 100 up; `None` is a dash.
fn um(v: impl Into<Option<f64>>) -> String {
    v.into().map_or_else(|| "–".to_owned(), |v| number(v, if v.abs() >= 99.95 { 1 } else { 2 }))
}

/// A length in mm to 0.1 µm, without trailing zeros.
pub(crate) fn short(v: f64) -> String {
    number(v, 4).trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn interval(of: Option<&[f64; 2]>, decimals: usize) -> String {
    let words = |[lo, hi]: &[f64; 2]| format!("{} … {}", number(*lo, decimals), number(*hi, decimals));
    of.map_or_else(|| "–".to_owned(), words)
}

/// Symbols of ISO 230-2 and their meanings, in the order of the figures.
const MEANINGS: [(&str, &str); 12] = [
    ("A", "accuracy of positioning, both ways"),
    ("A↑", "accuracy of positioning upwards"),
    ("A↓", "accuracy of positioning downwards"),
    ("E", "systematic deviation, both ways"),
    ("E↑", "systematic deviation upwards"),
    ("E↓", "systematic deviation downwards"),
    ("M", "range of the mean deviation"),
    ("R", "repeatability, both ways"),
    ("R↑", "repeatability upwards"),
    ("R↓", "repeatability downwards"),
    ("B", "reversal, the largest"),
    ("mean B", "reversal, the mean (up minus down)"),
];

/// Positioning: figures with their uncertainty, targets, contributors.
pub(crate) fn positioning(
    all: &[PositioningResult],
    records: &[Record],
    conditions: &TestConditions,
) -> Drawn {
    let axes: Vec<&str> = all.iter().map(|p| p.axis.as_str()).collect();
    let tilts = all.iter().filter(|p| p.unit == "urad").count();
    let what = match tilts {
        0 => "Positioning of",
        n if n == all.len() => "Tilts while moving",
        _ => "Positioning and tilts of",
    };
    let title = format!("{what} {} ({}ISO 230-2)", axes.join(", "), if tilts > 0 { "as " } else { "" });
    let mut report = Report::new(&title, records, conditions);
    for p in all {
        report.warn_of(&p.response, &p.warnings);
        add_positioning(&mut report, p)?;
    }
    Ok(report)
}

fn add_positioning(report: &mut Report, p: &PositioningResult) -> Result<(), PlotError> {
    let unit = if p.unit == "urad" { "µrad" } else { "µm" };
    let title = format!("{}: {} over {:.1} mm, {} targets", p.response, p.test, p.travel_mm, p.targets.len());
    let (value, u) = (format!("#value ({unit})"), format!("#U, k = 2 ({unit})"));
    let mut head = vec!["symbol", "figure", value.as_str()];
    if p.uncertainty.is_some() {
        head.push(&u);
    }
    if p.arcsec.is_some() {
        head.push("#arcsec");
    }
    let without = p.changes_by().map(|change| format!("#without the {change} ({unit})"));
    head.extend(without.as_deref());
    let row = |((symbol, v), (short, words)): ((&str, Option<f64>), (&str, &str))| {
        // The figure of a tilt is not one of positioning.
        let words = if p.unit == "urad" { words.replace(" of positioning", "") } else { words.to_owned() };
        let mut row = vec![short.to_owned(), words, um(v)];
        if let Some(u) = &p.uncertainty {
            row.push(um(u.of(symbol).filter(|u| v.is_some() && *u > 0.0)));
        }
        if let Some(arcsec) = &p.arcsec {
            row.push(um(arcsec.get(symbol).copied().flatten()));
        }
        if without.is_some() {
            row.push(um(p.without_change(symbol)));
        }
        row
    };
    report.table(&title, &head, p.figures().into_iter().zip(MEANINGS).map(row));
    report.plot(p.chart())?;
    let title = format!("{}: targets, values in {unit}", p.response);
    let head = ["#i", "#position (mm)", "#n↑", "#n↓", "#mean ↑", "#s ↑", "#mean ↓", "#s ↓", "#B", "#R"];
    let row = |(i, t): (usize, &TargetResult)| {
        let counts = t.approaches.map(|n| n.to_string());
        let figures = [t.mean_up, t.s_up, t.mean_down, t.s_down, t.reversal, t.repeatability].map(um);
        let start = [(i + 1).to_string(), format!("{:.3}", t.position_mm)];
        start.into_iter().chain(counts).chain(figures)
    };
    report.table(&title, &head, p.targets.iter().enumerate().map(row));
    if let Some(u) = &p.uncertainty {
        let by = "by the GUM; meant as in ISO/TR 230-9, not compared with its text";
        let title = format!("Uncertainty over {:.0} mm ({by})", u.length_mm);
        let rows = u.contributors.iter().map(|c| [c.name.clone(), um(c.u_um)]);
        report.table(&title, &["contributor", "#U, k = 2 (µm)"], rows);
    }
    Ok(())
}

/// Straightness of one axis's motion, across it.
pub(crate) fn straightness(
    all: &[StraightnessResult],
    record: &Record,
    conditions: &TestConditions,
) -> Drawn {
    let symbols: Vec<&str> = all.iter().map(|s| s.symbol.as_str()).collect();
    let title = format!("Straightness {} (ISO 230-1)", symbols.join(", "));
    let mut report = Report::new(&title, std::slice::from_ref(record), conditions);
    for s in all {
        report.warn_of(&s.symbol, &s.warnings);
        let StraightnessResult { symbol, across, axis, travel_mm, places, .. } = s;
        let count = places.len();
        let title =
            format!("{symbol}: error in {across} while {axis} moves over {travel_mm:.1} mm, {count} places");
        let figures = [
            ("straightness, about the least-squares line", Some(s.straightness_um), "µm"),
            ("the same moving upwards alone", s.straightness_up_um, "µm"),
            ("the same moving downwards alone", s.straightness_down_um, "µm"),
            ("reversal across the motion, mean", s.reversal_um, "µm"),
            ("largest range of readings at a place, from one side", s.repeatability_um, "µm"),
            ("slope of the line: straightedge and axis together", Some(s.slope_urad), "µrad"),
            ("its standard error", Some(s.slope_standard_error_urad), "µrad"),
        ];
        let rows = figures.map(|(words, value, unit)| [words.to_owned(), um(value), unit.to_owned()]);
        report.table(&title, &["figure", "#value", "unit"], rows);
        report.plot(s.chart())?;
        let head = ["#i", "#position (mm)", "#readings", "#up ↑ (µm)", "#down ↓ (µm)", "#mean (µm)"];
        let rows = s.places.iter().enumerate().map(|(i, p)| {
            let start = [(i + 1).to_string(), format!("{:.3}", p.position_mm), p.readings.to_string()];
            start.into_iter().chain([p.up_um, p.down_um, Some(p.mean_um)].map(um))
        });
        report.table(&format!("{}: places, about the line", s.symbol), &head, rows);
    }
    Ok(report)
}

/// Contributors in one reading, then the figures' uncertainties.
fn budget(report: &mut Report, of: &str, b: &CircleAndDriftUncertainty, figures: &[(&str, Option<f64>)]) {
    let title = format!("Uncertainty budget{of} (GUM alone; no standard's budget)");
    let contributors = b.contributors.iter().map(|c| [c.name.clone(), um(c.u_um)]);
    let rows = contributors.chain(figures.iter().map(|(words, u)| [(*words).to_owned(), um(*u)]));
    report.table(&title, &["contributor or figure", "#U, k = 2 (µm)"], rows);
}

/// Circular tests: contours, and causes of their deviations.
pub(crate) fn ballbar(planes: &[BallbarResult], records: &[Record], conditions: &TestConditions) -> Drawn {
    let names: Vec<&str> = planes.iter().map(|b| b.plane.as_str()).collect();
    let title = format!("Circular test in plane {} (ISO 230-4)", names.join(", "));
    let mut report = Report::new(&title, records, conditions);
    for b in planes {
        report.warn_of(&b.plane, &b.warnings);
        let radius = b.radius_mm.map(|r| format!(", radius {} mm", short(r))).unwrap_or_default();
        let figures = [
            ("G ccw", "circular deviation, counter-clockwise", b.g_ccw),
            ("G cw", "circular deviation, clockwise", b.g_cw),
            ("G(b)", "bi-directional circular deviation", b.g_b),
            ("F max", "largest radial deviation", Some(b.f_max)),
            ("F min", "smallest radial deviation", Some(b.f_min)),
            ("D", "mean bi-directional radial deviation", b.d),
            ("H", "hysteresis, largest difference of both ways", b.h),
        ];
        let rows = figures.map(|(symbol, words, v)| [symbol.to_owned(), words.to_owned(), um(v)]);
        let title = format!("Plane {}{radius}", b.plane);
        report.table(&title, &["symbol", "figure", "#value (µm)"], rows);
        diagnosis(&mut report, b);
        for plot in circles(b) {
            report.plot(PlotSpec::Polar(plot))?;
        }
        let (first, second) = b.plane.split_once('-').unwrap_or(("first", "second"));
        let (cx, cy) = (format!("#centre {first}"), format!("#centre {second}"));
        let head =
            ["record", "way", "#feed (mm/min)", "#turned (°)", "#G", "#F max", "#F min", &cx, &cy, "#radius"];
        let title = format!("Contours in plane {}, values in µm, ± their standard errors", b.plane);
        let rows = b.contours.iter().map(|c| {
            let feed = c.feed_mm_per_min.map_or_else(|| "–".to_owned(), |f| format!("{f:.0}"));
            let circle = [c.centre_um[0], c.centre_um[1], c.radius_um].into_iter().zip(c.standard_error_um);
            let circle = circle.map(|(v, e)| format!("{} ± {}", um(v), um(e)));
            let figures = [c.g, c.f_max, c.f_min].map(um).into_iter().chain(circle);
            let start = [c.record.clone(), c.direction.to_owned(), feed, format!("{:.0}", c.turned_deg)];
            start.into_iter().chain(figures)
        });
        report.table(&title, &head, rows);
        if let Some(u) = &b.uncertainty {
            let figures = [
                ("together, of G and H: a difference of two readings", Some(u.difference_um)),
                ("together, of F and D: the bar's length", u.length_um),
            ];
            let figures = &figures[..if u.length_um.is_some() { 2 } else { 1 }];
            budget(&mut report, &format!(", plane {}{radius}", b.plane), u, figures);
        }
    }
    Ok(report)
}

fn diagnosis(report: &mut Report, b: &BallbarResult) {
    let d = &b.diagnosis;
    let head = ["cause", "#value", "unit", "#95 % interval", "#makes (µm)"];
    let mut rows = Vec::new();
    let share = |cause: &str| um(d.contributions.iter().find(|c| c.cause == cause).map(|c| c.um));
    let mut add = |cause: &str, key: &str, v: Option<f64>, unit: &str, decimals: usize| {
        if let Some(v) = v {
            let shown = interval(d.interval_95.get(key), decimals);
            rows.push([cause.to_owned(), number(v, decimals), unit.to_owned(), shown, share(cause)]);
        }
    };
    add("scale mismatch", "scale_mismatch_ppm", d.scale_mismatch_ppm, "ppm", 1);
    add("squareness", "squareness_urad", d.squareness_urad, "µrad", 1);
    for (axis, v) in &d.reversal {
        add(&format!("reversal {axis}"), &format!("reversal.{axis}"), Some(*v), "µm", 2);
    }
    for (axis, s) in &d.spike {
        add(&format!("reversal spike {axis}"), &format!("spike.{axis}.um"), Some(s.um), "µm", 2);
        add("its length", &format!("spike.{axis}.length_mm"), Some(s.length_mm), "mm", 2);
    }
    add("servo mismatch", "servo_mismatch_ms", d.servo_mismatch_ms, "ms", 3);
    for (axis, c) in &d.cyclic {
        add(&format!("cyclic error {axis}"), &format!("cyclic.{axis}.um"), Some(c.um), "µm", 2);
        add("its period", &format!("cyclic.{axis}.period_mm"), Some(c.period_mm), "mm", 3);
    }
    for (axis, c) in &d.form {
        add(&format!("form that repeats {axis}"), &format!("form.{axis}.um"), Some(c.um), "µm", 2);
        add("it repeats every", &format!("form.{axis}.period_mm"), Some(c.period_mm), "mm", 3);
    }
    for (axis, um) in b.plane.split_once('-').into_iter().flat_map(|(a, c)| [a, c]).zip(d.centre_um) {
        add(&format!("centre {axis}"), &format!("centre_um.{axis}"), um, "µm", 2);
    }
    add("mean radius", "radius_um", d.radius_um, "µm", 2);
    add("not explained, the same both ways (RMS)", "", d.unexplained_um, "µm", 2);
    add("left over (RMS)", "", Some(d.rms).filter(|_| !d.interval_95.is_empty()), "µm", 2);
    if let Some(n) = &d.not_separable {
        let cause = format!("{}, not separable one way at one feed", n.causes.join(" or "));
        let shown = interval(Some(&n.interval_95), 2);
        rows.push([cause, number(n.um, 2), "µm".to_owned(), shown, um(Some(n.um))]);
    }
    report.table(&format!("What makes it, plane {}", b.plane), &head, rows);
    let of = "range of the radius that each makes, share of their sum";
    let title = format!("Contributions in plane {}, ranked: {of}", b.plane);
    let rows = d.contributions.iter().enumerate().map(|(i, c)| {
        let (rank, share) = match c.percent {
            Some(share) => ((i + 1).to_string(), format!("{share:.0}")),
            None => ("–".to_owned(), "not told".to_owned()),
        };
        [rank, c.cause.clone(), um(c.um), share]
    });
    report.table(&title, &["#rank", "cause", "#makes (µm)", "#share (%)"], rows);
}

/// One plot per feed.
fn circles(b: &BallbarResult) -> Vec<PolarPlot> {
    let mut feeds: BTreeMap<i64, Vec<&ContourResult>> = BTreeMap::new();
    for c in &b.contours {
        // Feeds within about 10 % are one.
        let feed = c.feed_mm_per_min.map_or(0, |f| (f.max(1e-9).ln() * 10.0).round() as i64);
        feeds.entry(feed).or_default().push(c);
    }
    let (a, c) = b.plane.split_once('-').unwrap_or(("", ""));
    let of = |contours: Vec<&ContourResult>| {
        let feed = contours[0].feed_mm_per_min.map(|f| format!(" at {f:.0} mm/min")).unwrap_or_default();
        let series = contours.iter().map(|c| {
            let (name, colour) = match c.direction {
                "ccw" => ("counter-clockwise", Colour::Up),
                _ => ("clockwise", Colour::Down),
            };
            Series::new(name, Style::Line, c.trace.clone()).coloured(colour)
        });
        PolarPlot {
            title: format!("Plane {}{feed}: deviation from the circle", b.plane),
            axes: [a.to_owned(), c.to_owned()],
            radius_mm: b.radius_mm,
            series: series.collect(),
        }
    };
    feeds.into_values().map(of).collect()
}

/// Sort key that puts T2 before T10: the name without its number, and the number.
fn natural(name: &str) -> (String, u64) {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    (stem.to_owned(), name[stem.len()..].parse().unwrap_or(0))
}

/// Thermal drift: the whole test, then phase by phase, each sensor.
pub(crate) fn drift(
    all: &[DriftResult],
    run: &ReportedRecord,
    charts: Vec<Chart>,
    conditions: &TestConditions,
) -> Drawn {
    let mut report = Report::of_runs("Thermal effects (ISO 230-3)", std::slice::from_ref(run), conditions);
    if let Some(short) = all.iter().map(|d| d.whole.t_min).reduce(f64::min).filter(|t| *t < 59.5) {
        report.warnings.push(format!(
            "the run lasts {short:.1} min: d60 and the last hour are of all of it; or is its time in another unit than stated?"
        ));
    }
    let head = "response|unit|#time (min)|#d60|#dt|#last hour|#end − start|#per h|#most per h";
    let head: Vec<&str> = head.split('|').collect();
    // The units are um, urad and arcsec.
    let unit =
        |d: &DriftResult| d.unit.strip_prefix('u').map_or_else(|| d.unit.clone(), |of| format!("µ{of}"));
    let cells = |f: &DriftFigures| {
        let own = [f.d_60, f.d_t, f.d_last_60, f.end, f.rate_per_h].map(um);
        std::iter::once(format!("{:.0}", f.t_min)).chain(own).chain([um(f.max_rate_per_h)])
    };
    let title = "The whole test; d60, dt, last hour: range of the readings within the first hour, all the time, the last hour; end − start: \
                 mean of the last hundredth of the rows minus that of the first; per h: slope of the straight line through all rows; \
                 most per h: largest change from one reading to another an hour later, up or down (– in less than an hour)";
    let row = |d: &DriftResult, f: &DriftFigures| [d.response.clone(), unit(d)].into_iter().chain(cells(f));
    report.table(title, &head, all.iter().map(|d| row(d, &d.whole)));
    for chart in charts {
        report.plot(chart)?;
    }
    for (i, p) in all.iter().take(1).flat_map(|d| d.phases.iter().enumerate()) {
        let at = p.at_mm.map(|mm| format!(", read at {mm:.1} mm")).unwrap_or_default();
        let title = format!("Phase from {:.0} min: {}{at}", p.from_min, p.what);
        let rows = all.iter().filter_map(|d| Some(row(d, &d.phases.get(i)?.figures)));
        report.table(&title, &head, rows);
        let gammas: Vec<String> = all.iter().map(|d| format!("#γ {}", d.response)).collect();
        let mut head = vec!["sensor", "#range (K)", "#end − start (K)", "#K/h"];
        head.extend(gammas.iter().map(String::as_str));
        let mut sensors: Vec<_> = p.figures.temperatures.iter().collect();
        sensors.sort_by_key(|(name, _)| natural(name));
        let rows = sensors.into_iter().map(|(sensor, s)| {
            let own =
                [format!("{:.2}", s.range_k), format!("{:+.2}", s.end_k), format!("{:+.2}", s.rate_k_per_h)];
            let gammas = all.iter().map(|d| {
                let s = d.phases.get(i).and_then(|p| p.figures.temperatures.get(sensor));
                s.map_or_else(|| "–".to_owned(), |s| format!("{:+.3}", s.gamma))
            });
            std::iter::once(sensor.clone()).chain(own).chain(gammas)
        });
        report.table(&format!("Sensors in that phase ({})", p.what), &head, rows);
    }
    for (d, u) in all.iter().filter_map(|d| Some((d, d.uncertainty.as_ref()?))) {
        let figures =
            [("together, of a range or of end − start: a difference of two readings", Some(u.difference_um))];
        budget(&mut report, &format!(" of {}", d.response), u, &figures);
    }
    Ok(report)
}

/// Diagonals: the box's figures, then each diagonal's.
pub(crate) fn diagonals(d: &DiagonalTestResult, records: &[Record], conditions: &TestConditions) -> Drawn {
    let title = format!("Positioning on {} diagonals (ISO 230-6)", d.kind);
    let mut report = Report::new(&title, records, conditions);
    report.warnings.clone_from(&d.warnings);
    let stated: Vec<_> = d.diagonals.iter().filter_map(|x| x.along.uncertainty.as_ref()).collect();
    let head = ["figure", "#value", "unit", "#U, k = 2 (µm)"];
    let columns = if stated.is_empty() { 3 } else { 4 };
    let mut rows: Vec<[String; 4]> = Vec::new();
    for (words, value, symbol) in [
        ("largest systematic deviation E of a diagonal", d.e_d, "E"),
        ("largest accuracy A of a diagonal", d.a_d, "A"),
        ("largest reversal B of a diagonal", d.b_d, "B"),
    ] {
        let u = um(stated.iter().filter_map(|u| u.of(symbol)).reduce(f64::max));
        rows.push([words.to_owned(), um(value), "µm".to_owned(), u]);
    }
    let with = |v: f64, error: Option<f64>| {
        error.map_or_else(|| format!("{v:.1}"), |error| format!("{v:.1} ± {error:.1} (standard error)"))
    };
    let scale = with(d.scale_ppm, d.scale_standard_error_ppm);
    rows.push(["mean scale along the diagonals".to_owned(), scale, "ppm".to_owned(), String::new()]);
    for (pair, v) in &d.squareness_urad {
        let error = d.squareness_standard_error_urad.get(pair).copied().flatten();
        rows.push([format!("squareness.{pair}"), with(*v, error), "µrad".to_owned(), String::new()]);
    }
    let rows = rows.into_iter().map(|row| row.into_iter().take(columns));
    report.table("The diagonals together", &head[..columns], rows);
    let head = ["diagonal", "axes", "#length (mm)", "#A", "#E", "#M", "#R", "#B", "#mean B", "#end to end"];
    let row = |x: &DiagonalResult| {
        let p = &x.along;
        let own = [p.A, p.E, p.M, p.R, p.B, p.B_mean, Some(x.slope_um)].map(um);
        [x.sense.clone(), x.axes.join(" "), format!("{:.1}", p.travel_mm)].into_iter().chain(own)
    };
    report.table("Each diagonal, values in µm", &head, d.diagonals.iter().map(row));
    let mut chart =
        Chart::new("Mean deviation along each diagonal", "distance along it (mm)", "deviation (µm)");
    for x in &d.diagonals {
        chart = chart.with(Series::new(&x.sense, Style::Line, x.along.means().collect()));
    }
    report.plot(chart)?;
    for x in &d.diagonals {
        let mut chart = x.along.chart();
        chart.title = format!("Diagonal {} of {} (ISO 230-6)", x.sense, x.axes.join(", "));
        "distance along it (mm)".clone_into(&mut chart.x);
        report.plot(chart)?;
    }
    Ok(report)
}

/// A plate of holes.
pub(crate) fn plate(p: &DrilledPlateFit, record: &Record, conditions: &TestConditions) -> Drawn {
    let mut report = Report::new("Plate of holes", std::slice::from_ref(record), conditions);
    // A scale within its uncertainty implies no temperature of the plate.
    if p.is_scale_beyond_chance() {
        report.warnings.push(p.remark.clone());
    }
    let (j, je, pe) = (&p.joint.terms, &p.joint.standard_error, &p.standard_error);
    let none = || "–".to_owned();
    let row = |name: &str, value: f64, error: f64, decimals: usize, unit: &str| {
        [name.to_owned(), number(value, decimals), number(error, decimals), unit.to_owned()]
    };
    let angle = |name: &str, deg: f64, error: Option<f64>| match error {
        Some(error) => row(name, deg, error, 1, "°"),
        None => [name.to_owned(), none(), none(), "°".to_owned()],
    };
    let left = |name: &str, rms_um: f64| [name.to_owned(), um(rms_um), none(), "µm".to_owned()];
    let head = ["figure", "#value", "#standard error", "unit"];
    let aluminium = "mean scale as a temperature of aluminium";
    let quadrupole = "quadrupole: longer along its angle, shorter across";
    let rotation = "rotation from x towards y, of rows along x, or the plate's set-up";
    let rows = [
        row("offset x", j.offset_mm[0], je.offset_mm[0], 4, "mm"),
        row("offset y", j.offset_mm[1], je.offset_mm[1], 4, "mm"),
        row("scale x", j.scale_x_ppm, je.scale_x_ppm, 1, "ppm"),
        row("scale y", j.scale_y_ppm, je.scale_y_ppm, 1, "ppm"),
        row(aluminium, p.scale_as_aluminium_k, pe.scale_as_aluminium_k, 2, "K"),
        row("squareness", j.squareness_urad, je.squareness_urad, 1, "µrad"),
        row(rotation, j.rotation_urad, je.rotation_urad, 1, "µrad"),
        row(quadrupole, j.quadrupole_ppm, je.quadrupole_ppm, 1, "ppm"),
        angle("angle of the quadrupole from x", j.quadrupole_deg, je.quadrupole_deg),
        left("left over after these (RMS length)", p.joint.rms_um),
    ];
    report.table(&format!("{} holes, measured against nominal", p.holes), &head, rows);
    let title = "One after another, as owners of drilled plates publish it: one scale and rotation, then a radial quadrupole";
    let rotation = "rotation from x towards y, mean of rows along x and y";
    let rows = [
        row("offset x", p.offset_mm[0], pe.offset_mm[0], 4, "mm"),
        row("offset y", p.offset_mm[1], pe.offset_mm[1], 4, "mm"),
        row("scale", p.scale_ppm, pe.scale_ppm, 1, "ppm"),
        row(rotation, p.rotation_urad, pe.rotation_urad, 1, "µrad"),
        left("left over after these (RMS length)", p.rms_um),
        row("quadrupole r·m·cos 2(θ − φ) along the radius: m", p.quadrupole_ppm, pe.quadrupole_ppm, 1, "ppm"),
        angle("its angle φ from x", p.quadrupole_deg, pe.quadrupole_deg),
        left("left over after the quadrupole too", p.rms_quadrupole_um),
    ];
    let by_diameter = p.rms_um_by_diameter.iter();
    let by_diameter = by_diameter.map(|(d, v)| left(&format!("left over, holes of {d} mm"), *v));
    report.table(title, &head, rows.into_iter().chain(by_diameter));
    report.plot(PlotSpec::Vectors(p.plot(record)))?;
    Ok(report)
}

/// One machine's figures over time.
/// A table, and each figure with its limit and trend.
pub(crate) fn history(h: &MachineHistory) -> Drawn {
    let title = format!("History of {}", h.machine);
    let mut report = Report { by: "history", ..Report::new(&title, &[], &TestConditions::default()) };
    for f in h.beyond() {
        report.warn(&format!("{} is beyond its limit", f.name));
    }
    for (f, day) in h.figures.iter().filter_map(|f| Some((f, f.reaches.as_ref()?))) {
        report.warn(&format!("{} reaches its limit on {day} by its trend", f.name));
    }
    for left in &h.left_out {
        report.warn(&format!("{}: left out: {}", left.record, left.why));
    }
    for figure in h.with_every_row() {
        report.warn(&figure);
    }
    let head = "figure|unit|#records|first|#first|last|#last|#limit|#trend a year|95 %|reaches";
    let head: Vec<&str> = head.split('|').collect();
    let row = |f: &FigureHistory| {
        let (first, last) = (f.points.first()?, f.points.last()?);
        let trend = f.trend.map_or_else(String::new, |t| um(t.per_year));
        let interval = f.trend.map_or_else(String::new, |t| interval(Some(&t.interval), 2));
        Some([
            f.sensor.as_ref().map_or_else(|| f.name.clone(), |s| format!("{} ({s})", f.name)),
            f.written_unit(),
            f.points.len().to_string(),
            first.date.clone(),
            um(first.value),
            last.date.clone(),
            um(last.value),
            um(f.limit),
            trend,
            interval,
            f.reaches.clone().unwrap_or_default(),
        ])
    };
    report.table("Figures over time", &head, h.figures.iter().filter_map(row));
    for f in &h.figures {
        let (points, unit) = (f.over_days(), f.written_unit());
        let from = f.points.first().map_or("", |p| p.date.as_str());
        let end = points.last().map_or(0.0, |p| p.0);
        let mut chart = Chart::new(&f.name, &format!("days since {from}"), &unit);
        if let Some(limit) = f.limit {
            for (name, sign) in [("limit", 1.0), ("", -1.0)] {
                // The opposite limit is shown only if the figure has that sign.
                if sign > 0.0 || points.iter().any(|p| p.1 < 0.0) {
                    let ends = vec![(0.0, sign * limit), (end, sign * limit)];
                    chart = chart.with(Series::new(name, Style::Line, ends).coloured(Colour::Grey));
                }
            }
        }
        if let Some(line) = f.line() {
            chart = chart.with(Series::new("trend", Style::Line, line.to_vec()).coloured(Colour::Down));
        }
        report.plot(chart.with(Series::new("records", Style::Dots, points).coloured(Colour::Up)))?;
    }
    Ok(report)
}

/// Returning to one position: standard deviation and range.
pub(crate) fn repeatability(
    axes: &ByAxis<ReturnRepeatability>,
    record: &Record,
    conditions: &TestConditions,
) -> Drawn {
    let mut report = Report::new("Returning to one position", std::slice::from_ref(record), conditions);
    let head = "axis|#returns|#standard deviation s (µm)|#4 s (µm)|#range (µm)|#trend (µm a return)|#s about it (µm)";
    let head: Vec<&str> = head.split('|').collect();
    let rows = axes.iter().map(|(axis, of)| {
        let figures = [of.s_um, 4.0 * of.s_um, of.range_um, of.trend_um_per_return].map(um);
        let start = [axis.clone(), of.returns.to_string()].into_iter();
        start.chain(figures).chain([um(of.s_about_trend_um)])
    });
    report.table("Repeatability per axis", &head, rows);
    let mut chart = Chart::new("Returning to one position", "return (number)", "error (µm)");
    for c in record.responses() {
        let points = c.data.iter().enumerate().map(|(i, e)| (i as f64 + 1.0, *e)).collect();
        chart = chart.with(Series::new(&c.role.to_string(), Style::Dots, points));
    }
    report.plot(chart)?;
    Ok(report)
}
