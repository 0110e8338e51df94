//! What a source's rows give with many seeds.

use crate::{Basis, Compared, Row, Verdict};
use std::fmt::Write as _;

/// What one row gave, seed by seed.
#[derive(Debug)]
struct Each {
    row: Row,
    gets: Vec<f64>,
    agrees: usize,
    seen: usize,
}

/// A source's rows over many seeds.
#[derive(Debug, Default)]
pub struct Spread {
    rows: Vec<Each>,
    /// Per seed, by basis: rows that agree and differ.
    counts: Vec<[[usize; 2]; 3]>,
}

impl Spread {
    /// Adds what one seed gave.
    pub fn add(&mut self, compared: Compared) {
        self.counts.push(compared.counts.map(|c| [c.agree, c.differ]));
        for row in compared.rows {
            let same = |e: &Each| e.row.place == row.place && e.row.what == row.what;
            let at = self.rows.iter().position(same).unwrap_or_else(|| {
                self.rows.push(Each { row: row.clone(), gets: Vec::new(), agrees: 0, seen: 0 });
                self.rows.len() - 1
            });
            let each = &mut self.rows[at];
            each.gets.extend(row.we);
            each.agrees += usize::from(row.verdict == Verdict::Agrees);
            each.seen += 1;
        }
    }

    /// How many rows agree and differ, and the rows that vary.
    pub fn table(&self) -> String {
        let mut text = String::new();
        for (k, basis) in Basis::ALL.into_iter().enumerate() {
            let range = |which: usize| {
                let all = || self.counts.iter().map(|c| c[k][which]);
                let (least, most) = (all().min().unwrap_or(0), all().max().unwrap_or(0));
                if least == most { least.to_string() } else { format!("{least} to {most}") }
            };
            let name = if basis == Basis::Compared { "compared" } else { basis.mark() };
            // Writing to a String does not fail.
            let _ = writeln!(text, "{name}: {} agree, {} differ", range(0), range(1));
        }
        let seeds = self.counts.len();
        let mut same = 0;
        let (mut place, mut lines) = ("", String::new());
        for Each { row, gets, agrees, seen } in &self.rows {
            let mut gets = gets.clone();
            gets.sort_by(f64::total_cmp);
            let ends = gets.first().zip(gets.last());
            let varies = ends.is_some_and(|(a, b)| crate::rows::shown(*a) != crate::rows::shown(*b));
            if !varies && (*agrees == 0 || agrees == seen) && *seen == seeds {
                same += 1;
                continue;
            }
            if place != row.place {
                let head = ["paper says", "least", "median", "most"].map(|h| format!("{h:>12}")).concat();
                let _ = writeln!(lines, "\n{}\n  {:<84}{head}  agrees", row.place, "");
                place = &row.place;
            }
            let at = |share: f64| gets.get((share * (gets.len().max(1) - 1) as f64).round() as usize);
            let each =
                [0.0, 0.5, 1.0].map(|q| at(q).map_or_else(|| "-".to_owned(), |v| crate::rows::shown(*v)));
            let each = [row.says.clone()].into_iter().chain(each).map(|v| format!("{v:>12}"));
            let what = format!("{} {}", row.what, row.unit);
            let line = format!(
                "  {:<84}{}  {agrees} of {seen} {}",
                what.trim_end(),
                each.collect::<String>(),
                row.basis.mark()
            );
            let _ = writeln!(lines, "{}", line.trim_end());
        }
        let others = if lines.is_empty() { "" } else { "; the others:" };
        let _ = writeln!(text, "{same} rows are the same with every seed{others}");
        text + &lines
    }
}
