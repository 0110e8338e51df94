//! Reports of evaluations for people.
//! Conditions, tables and plots in the standard's order, as text and as one HTML file for A4.

mod evaluation_reports;

pub(crate) use evaluation_reports::{
    ballbar, diagonals, drift, history, plate, positioning, repeatability, short, straightness,
};

use crate::iso230::TestConditions;
use crate::plot::{PlotError, PlotSpec};
use rtec_files::message_text::escaped;
use rtec_model::record::{Column, Record, span};
use std::fmt::Write as _;

/// A table; columns whose name starts with `#` hold numbers and are right-aligned.
#[derive(Debug, Clone, PartialEq, Default)]
struct ReportTable {
    title: String,
    /// Names of the columns, with units.
    head: Vec<String>,
    /// Cells as displayed.
    rows: Vec<Vec<String>>,
}

impl ReportTable {
    fn numeric(&self, column: usize) -> bool {
        self.head.get(column).is_some_and(|h| h.starts_with('#'))
    }

    fn name(&self, column: usize) -> &str {
        self.head.get(column).map_or("", |h| h.trim_start_matches('#'))
    }
}

/// Size of a chart, px.
const PLOT_PX: (u32, u32) = (900, 480);

/// Style sheet of a page, for screen and A4 print.
pub const STYLE: &str = "@page{size:A4;margin:14mm 15mm}\
    body{font:14px/1.4 system-ui,sans-serif;color:#1c2733;max-width:820px;margin:1.5em auto;padding:0 1em}\
    h1{font-size:1.45em;margin:0 0 .5em}h2{font-size:1.08em;margin:1.5em 0 .35em;border-bottom:1px solid #ccd5de;\
    break-after:avoid}\
    table{border-collapse:collapse;width:100%}\
    td,th{text-align:left;padding:.2em .7em .2em 0;border-bottom:1px solid #e6ebf0;vertical-align:top}\
    th{font-weight:600;border-bottom-color:#9aa7b3}\
    td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}\
    thead{display:table-header-group}table,tr,figure,.signed{break-inside:avoid}\
    .facts td:first-child{color:#5b6b7b;width:14em}\
    .warn{background:#fff6e5;border-left:4px solid #e69f00;padding:.4em .8em;margin:.6em 0}\
    .signed{margin-top:3em}.signed td{border:0;border-top:1px solid #5b6b7b;padding:.2em .7em 0 0;color:#5b6b7b;width:25%}\
    .signed .given td{border:0;color:#1c2733;height:1.6em;vertical-align:bottom}\
    figure{margin:1.2em 0}figure svg{display:block;width:100%;height:auto}\
    @media print{body{font-size:10.5pt;max-width:none;margin:0;padding:0}\
    *{print-color-adjust:exact;-webkit-print-color-adjust:exact}figure{margin:.8em 0}figure svg{max-height:105mm}}";

/// The line at the end of a page that makes it a certificate.
/// Instrument, name, day and signature; unknown fields stay blank.
pub fn signed_line(instrument: &str, name: &str, date: &str) -> String {
    format!(
        "<table class=\"signed\"><tr class=\"given\"><td>{}</td><td>{}</td><td>{}</td><td></td></tr>\
         <tr><td>instrument, serial number</td><td>measured by</td><td>date</td><td>signature</td></tr></table>",
        escaped(instrument),
        escaped(name),
        escaped(date)
    )
}

/// A section: a table, or a plot with its data.
#[derive(Debug, Clone, PartialEq)]
enum ReportSection {
    Table(ReportTable),
    Plot { svg: String, picture: PlotSpec },
}

/// Facts about a record in a report.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportedRecord {
    /// The sidecar's name.
    pub name: String,
    /// Number of rows.
    pub rows: usize,
    /// The day of the run, as ISO 8601.
    pub date: Option<String>,
    /// Free text about it.
    pub note: Option<String>,
    /// SHA-256 of its CSV, in hexadecimal; empty if it has no file.
    pub sha256: String,
    /// Range of each temperature, °C.
    pub ranges_degc: Vec<(String, [f64; 2])>,
}

impl ReportedRecord {
    /// Facts about this record.
    pub fn of(record: &Record) -> Self {
        let range = |c: &Column| (c.name.clone(), span(&c.data));
        let temperatures = record.temperatures();
        Self {
            name: record.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned()),
            rows: record.rows(),
            date: record.date.clone(),
            note: record.note.clone(),
            sha256: record.sha256.clone(),
            ranges_degc: temperatures.map(range).collect(),
        }
    }
}

/// A report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// What was evaluated, and by which standard.
    pub title: String,
    /// Records, conditions and instrument, as pairs of name and value.
    facts: Vec<(String, String)>,
    /// Warnings about its use.
    warnings: Vec<String>,
    /// Number of warnings that are suspicions against the input.
    doubts: usize,
    sections: Vec<ReportSection>,
    /// The verb that makes the page.
    by: &'static str,
    /// Days of the runs, each once.
    days: Vec<String>,
    /// Whether the page ends with a signature line: pages of one test.
    is_signed: bool,
}

/// Advice about rows left out.
pub const LEFT_OUT: &str =
    "these rows are in no figure; look at them, then measure again or take them out of the file";

impl Report {
    /// Inserts a suspicion before the other warnings; `rows`: with [`LEFT_OUT`].
    pub fn doubt(&mut self, text: &str, rows: bool) {
        let at = self.doubts;
        self.doubts += 1;
        self.warnings.insert(at, if rows { format!("{text}; {LEFT_OUT}") } else { text.to_owned() });
    }

    /// Adds a warning after the others.
    pub fn warn(&mut self, text: &str) {
        self.warnings.push(text.to_owned());
    }

    fn new(title: &str, records: &[Record], conditions: &TestConditions) -> Self {
        Self::of_runs(title, &records.iter().map(ReportedRecord::of).collect::<Vec<_>>(), conditions)
    }

    fn of_runs(title: &str, runs: &[ReportedRecord], conditions: &TestConditions) -> Self {
        let mut facts = Vec::new();
        for r in runs {
            let date = r.date.as_ref().map(|d| format!(", {d}")).unwrap_or_default();
            let note = r.note.as_ref().map(|n| format!(", {n}")).unwrap_or_default();
            let hash = r.sha256.get(..12).map(|h| format!(", SHA-256 {h}…")).unwrap_or_default();
            facts.push(("record".to_owned(), format!("{}, {} rows{date}{hash}{note}", r.name, r.rows)));
        }
        facts.extend(conditions.words.iter().cloned());
        facts.extend(conditions.instrument.iter().map(|(k, v)| (format!("instrument {k}"), v.clone())));
        let mut ranges: Vec<(&str, [f64; 2])> = Vec::new();
        for (name, [low, high]) in runs.iter().flat_map(|r| &r.ranges_degc) {
            match ranges.iter_mut().find(|(known, _)| known == name) {
                Some((_, [l, h])) => (*l, *h) = (l.min(*low), h.max(*high)),
                None => ranges.push((name, [*low, *high])),
            }
        }
        if !ranges.is_empty() {
            let each = ranges.iter().map(|(name, [lo, hi])| format!("{name} {lo:.2} to {hi:.2}"));
            facts.push(("temperatures (°C)".to_owned(), each.collect::<Vec<_>>().join("; ")));
        }
        let mut days: Vec<String> = runs.iter().filter_map(|r| r.date.clone()).collect();
        days.sort_unstable();
        days.dedup();
        let (title, by) = (title.to_owned(), "characterise evaluate");
        Self { title, facts, by, days, is_signed: !runs.is_empty(), ..Self::default() }
    }

    /// Adds a table of these rows, if there are any.
    fn table<C: IntoIterator<Item: Into<String>>>(
        &mut self,
        title: &str,
        head: &[&str],
        rows: impl IntoIterator<Item = C>,
    ) {
        let head = head.iter().map(|h| (*h).to_owned()).collect();
        let cells = |row: C| row.into_iter().map(Into::into).collect();
        let rows: Vec<Vec<String>> = rows.into_iter().map(cells).collect();
        if !rows.is_empty() {
            self.sections.push(ReportSection::Table(ReportTable { title: title.to_owned(), head, rows }));
        }
    }

    /// Adds the warnings about one part of a report.
    fn warn_of(&mut self, part: &str, warnings: &[String]) {
        self.warnings.extend(warnings.iter().map(|w| format!("{part}: {w}")));
    }

    fn plot(&mut self, picture: impl Into<PlotSpec>) -> Result<(), PlotError> {
        let picture = picture.into();
        let svg = picture.svg(PLOT_PX.0, PLOT_PX.1)?;
        self.sections.push(ReportSection::Plot { svg, picture });
        Ok(())
    }

    /// Its plots, as SVG documents.
    pub fn plots(&self) -> impl Iterator<Item = &str> {
        self.drawn().map(|(svg, _)| svg)
    }

    /// Its plots as data, in the order of [`Report::plots`].
    pub fn pictures(&self) -> impl Iterator<Item = &PlotSpec> {
        self.drawn().map(|(_, picture)| picture)
    }

    fn drawn(&self) -> impl Iterator<Item = (&str, &PlotSpec)> {
        self.sections.iter().filter_map(|s| match s {
            ReportSection::Plot { svg, picture } => Some((svg.as_str(), picture)),
            ReportSection::Table(_) => None,
        })
    }

    /// Warnings about its use.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Text without the plots.
    pub fn text(&self) -> String {
        let mut out = format!("{}\n", self.title);
        for s in &self.sections {
            let ReportSection::Table(t) = s else { continue };
            let _ = write!(out, "\n{}\n", t.title);
            let width = |c: usize| {
                let cells = t.rows.iter().filter_map(|r| r.get(c)).map(|x| x.chars().count());
                cells.chain([t.name(c).chars().count()]).max().unwrap_or(0)
            };
            let widths: Vec<usize> = (0..t.head.len()).map(width).collect();
            let mut line = |cells: &mut dyn Iterator<Item = &str>| {
                let mut text = String::new();
                for (c, cell) in cells.enumerate() {
                    let pad = " ".repeat(widths.get(c).map_or(0, |w| w.saturating_sub(cell.chars().count())));
                    let _ = if t.numeric(c) {
                        write!(text, "  {pad}{cell}")
                    } else {
                        write!(text, "  {cell}{pad}")
                    };
                }
                out.push_str(text.trim_end());
                out.push('\n');
            };
            line(&mut (0..t.head.len()).map(|c| t.name(c)));
            for row in &t.rows {
                line(&mut row.iter().map(String::as_str));
            }
        }
        out
    }

    /// One HTML file that loads nothing and prints to A4.
    pub fn html(&self) -> String {
        let mut h = String::new();
        let _ = write!(
            h,
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{STYLE}\
             </style></head><body><h1>{0}</h1>",
            escaped(&self.title)
        );
        if !self.facts.is_empty() {
            h.push_str("<table class=\"facts\">");
            for (name, value) in &self.facts {
                let _ = write!(h, "<tr><td>{}</td><td>{}</td></tr>", escaped(name), escaped(value));
            }
            h.push_str("</table>");
        }
        for w in &self.warnings {
            let _ = write!(h, "<p class=\"warn\">{}</p>", escaped(w));
        }
        for s in &self.sections {
            match s {
                ReportSection::Plot { svg, .. } => h.extend(["<figure>", svg, "</figure>"]),
                ReportSection::Table(t) => table_html(&mut h, t),
            }
        }
        if self.is_signed {
            let all = |keys: &[&str]| {
                let own = self.facts.iter().filter(|f| keys.contains(&f.0.as_str()));
                own.map(|f| f.1.as_str()).collect::<Vec<_>>().join(", ")
            };
            let instrument = all(&["instrument kind", "instrument name", "instrument serial"]);
            h.push_str(&signed_line(&instrument, &all(&["operator"]), &self.days.join(", ")));
        }
        let stamp = rtec_files::file_format_stamp::writer();
        let _ = writeln!(h, "<p><small>{stamp}, {}</small></p></body></html>", self.by);
        h
    }
}

fn table_html(h: &mut String, t: &ReportTable) {
    let class = |c: usize| if t.numeric(c) { " class=\"n\"" } else { "" };
    let _ = write!(h, "<h2>{}</h2><table><thead><tr>", escaped(&t.title));
    for c in 0..t.head.len() {
        let _ = write!(h, "<th{}>{}</th>", class(c), escaped(t.name(c)));
    }
    h.push_str("</tr></thead><tbody>");
    for row in &t.rows {
        h.push_str("<tr>");
        for (c, cell) in row.iter().enumerate() {
            let _ = write!(h, "<td{}>{}</td>", class(c), escaped(cell));
        }
        h.push_str("</tr>");
    }
    h.push_str("</tbody></table>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_s_page_ends_with_a_line_to_be_signed() {
        let run = |date: &str| ReportedRecord {
            name: "a.run.toml".into(),
            rows: 9,
            date: Some(date.into()),
            note: None,
            sha256: String::new(),
            ranges_degc: Vec::new(),
        };
        let conditions = TestConditions {
            words: vec![("operator".into(), "N. <N>".into())],
            instrument: ["kind", "ballbar", "name", "B2", "serial", "12", "calibrated", "2026-01-15"]
                .chunks(2)
                .map(|c| (c[0].to_owned(), c[1].to_owned()))
                .collect(),
            ..TestConditions::default()
        };
        let runs = [run("2026-05-04"), run("2026-05-05"), run("2026-05-04")];
        let page = Report::of_runs("Circles", &runs, &conditions).html();
        let line = "<td>ballbar, B2, 12</td><td>N. &lt;N&gt;</td><td>2026-05-04, 2026-05-05</td><td></td>";
        assert!(page.contains(line) && page.contains("signature"), "{page}");
    }

    #[test]
    fn text_and_page_hold_the_same_cells() {
        let mut report = Report { title: "Axis <y>".into(), ..Report::default() };
        let rows = [["A", "12.30"], ["mean B", "-1.05"]];
        report.table("Figures", &["figure", "#value (µm)"], rows);
        report.table::<[&str; 1]>("nothing in it", &["a"], []);
        assert_eq!(
            report.text(),
            "Axis <y>\n\nFigures\n  figure  value (µm)\n  A            12.30\n  mean B       -1.05\n"
        );
        let html = report.html();
        for words in [
            "<h1>Axis &lt;y&gt;</h1>",
            "<th class=\"n\">value (µm)</th>",
            "<td class=\"n\">-1.05</td>",
            "@page{size:A4",
        ] {
            assert!(html.contains(words), "{words}: {html}");
        }
        assert!(!html.contains("class=\"signed\""), "nothing was measured");
        assert!(!html.contains("nothing in it") && !html.contains("http://") && !html.contains("https://"));
    }
}
