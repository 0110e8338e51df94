//! A self-contained page that compares two probing sessions.

use crate::part_errors::PartErrorReport;
use rtec_files::message_text::escaped;
use std::fmt::Write as _;

/// The head of the page and its comparison of two sessions.
pub fn side_by_side(before: &PartErrorReport, after: &PartErrorReport) -> String {
    let row = |name: &str, r: &PartErrorReport| {
        let largest = r.errors.iter().map(|e| e.error_um.abs()).fold(0.0, f64::max);
        let (form, first, second) = (r.form_um, r.sd_before_um, r.sd_after_um);
        format!(
            "<tr><td>{name}<td>{largest:.2}<td>{form:.2}<td>{first:.2}<td>{second:.2}<td>{}",
            r.rejected.len()
        )
    };
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Part errors, before and after</title>\
         <style>body{{font:15px sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}}table{{border-collapse:collapse}}\
         td,th{{border:1px solid #ccc;padding:.2rem .6rem;text-align:right}}td:first-child{{text-align:left}}\
         figure{{display:inline-block;vertical-align:top;width:48%;margin:1rem 0}}svg{{width:100%;height:auto}}</style>\
         <h1>Part errors, before and after</h1>\
         <table><tr><th>µm<th>largest<th>form<th>SD<th>SD of the second fit<th>points left out{}{}</table>\
         <figure><figcaption>Before</figcaption>{}</figure><figure><figcaption>After</figcaption>{}</figure>\n",
        row("before", before),
        row("after", after),
        before.whisker_svg(),
        after.whisker_svg()
    )
}

/// The decisions and the end of the page.
pub fn logged(decisions: &[String]) -> String {
    let items = decisions.iter().fold(String::new(), |mut t, d| {
        let _ = write!(t, "<li>{}", escaped(d));
        t
    });
    format!("<h2>Decisions</h2><ol>{items}</ol></html>\n")
}
