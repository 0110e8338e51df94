//! One figure of a source beside what came out.

use serde::Serialize;

/// How a figure compares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Within what is stated.
    Agrees,
    /// Not, for a reason that is stated.
    Differs,
}

/// Where what came out comes from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Basis {
    /// From a run. Nothing in the machine was taken from this figure.
    #[default]
    Compared,
    /// The figure is set in the machine's file or the program.
    /// Or it is arithmetic of such figures. Agreement shows that nothing was lost on the way, and no more.
    Given,
    /// Parameters of the machine were chosen so that it comes out.
    Fitted,
}

impl Basis {
    /// All of them, in the order of a summary.
    pub const ALL: [Self; 3] = [Self::Compared, Self::Fitted, Self::Given];

    /// As a table marks it; empty for a figure that is compared.
    pub fn mark(self) -> &'static str {
        match self {
            Self::Compared => "",
            Self::Given => "given",
            Self::Fitted => "fitted",
        }
    }
}

/// One table entry, figure, or figure in the text.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Table, figure or section.
    pub place: String,
    /// What it is a figure of.
    pub what: String,
    /// Its unit; empty for words and plain numbers.
    pub unit: &'static str,
    /// What the paper says, as it is shown.
    pub says: String,
    /// The same as a number, where it is one.
    pub paper: Option<f64>,
    /// What came out, as it is shown.
    pub gets: String,
    /// The same as a number, where it is one.
    pub we: Option<f64>,
    /// What counts as agreement.
    pub agreement: String,
    /// How the two compare.
    pub verdict: Verdict,
    /// Where what came out comes from.
    pub basis: Basis,
    /// Why they are not the same; empty where they are.
    pub why: String,
}

/// What counts as agreement.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Agreement {
    /// As many units apart at most.
    Within(f64),
    /// As large a share of the paper's figure apart at most.
    Share(f64),
    /// At most the paper's figure.
    AtMost,
    /// At least the paper's figure.
    AtLeast,
}

impl Agreement {
    fn met(self, says: f64, gets: f64) -> bool {
        // What is equal but for rounding is equal.
        let hair = 1e-9 * (1.0 + says.abs());
        match self {
            Self::Within(apart) => (gets - says).abs() <= apart + hair,
            Self::Share(share) => (gets - says).abs() <= share * says.abs() + hair,
            Self::AtMost => gets <= says + hair,
            Self::AtLeast => gets >= says - hair,
        }
    }

    /// Zero or the other sign would agree as well.
    /// A source's zero is compared all the same.
    fn cannot_tell(self, says: f64) -> bool {
        matches!(self, Self::Within(apart) if says != 0.0 && apart >= says.abs())
    }

    fn words(self, unit: &str) -> String {
        match self {
            Self::Within(0.0) => "equal".to_owned(),
            Self::Within(apart) => format!("within {} {unit}", shown(apart)).trim_end().to_owned(),
            Self::Share(share) => format!("within {} %", shown(100.0 * share)),
            Self::AtMost => "at most".to_owned(),
            Self::AtLeast => "at least".to_owned(),
        }
    }
}

/// Rows in the making, and the figures drawn on the way: file name and text.
#[derive(Debug, Default)]
pub(crate) struct Rows {
    pub(crate) list: Vec<Row>,
    pub(crate) figures: Vec<(String, String)>,
    /// What a source draws without printing its values, as tables to read.
    pub(crate) tables: Vec<String>,
    /// Figures no larger than their tolerance: agreement would tell nothing.
    pub(crate) too_small: usize,
    /// Of the next row.
    next: Basis,
}

/// A number as people read it: four digits that count.
pub(crate) fn shown(v: f64) -> String {
    if v == 0.0 {
        return "0".to_owned();
    }
    if v.fract() == 0.0 && v.abs() < 1e7 {
        return format!("{v}");
    }
    let digits = (3 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

impl Rows {
    /// Marks the next row: its figure is an input.
    pub(crate) fn given(&mut self) -> &mut Self {
        self.next = Basis::Given;
        self
    }

    /// Marks the next row: the machine was fitted to its figure.
    pub(crate) fn fitted(&mut self) -> &mut Self {
        self.next = Basis::Fitted;
        self
    }

    /// Compares a number.
    /// `why` is shown where the two differ. A figure within its own tolerance of zero is only counted.
    pub(crate) fn number(
        &mut self,
        (place, what, unit): (&str, &str, &'static str),
        says: f64,
        gets: f64,
        is: Agreement,
        why: &str,
    ) {
        let basis = std::mem::take(&mut self.next);
        let met = is.met(says, gets);
        let same = shown(says) == shown(gets);
        if met && is.cannot_tell(says) {
            self.too_small += 1;
            return;
        }
        self.list.push(Row {
            place: place.to_owned(),
            what: what.to_owned(),
            unit,
            says: match is {
                Agreement::AtMost => format!("≤ {}", shown(says)),
                Agreement::AtLeast => format!("≥ {}", shown(says)),
                _ => shown(says),
            },
            paper: Some(says),
            gets: shown(gets),
            we: Some(gets),
            agreement: is.words(unit),
            verdict: if met { Verdict::Agrees } else { Verdict::Differs },
            basis,
            why: if same { String::new() } else { why.to_owned() },
        });
    }

    /// Words, or a whole sequence: the same or not.
    pub(crate) fn words(&mut self, (place, what): (&str, &str), says: &str, gets: &str, why: &str) {
        self.holds((place, what), says, gets, says == gets, why);
    }

    /// A statement that holds or does not.
    pub(crate) fn holds(
        &mut self,
        (place, what): (&str, &str),
        says: &str,
        gets: &str,
        holds: bool,
        why: &str,
    ) {
        self.list.push(Row {
            place: place.to_owned(),
            what: what.to_owned(),
            unit: "",
            says: says.to_owned(),
            paper: None,
            gets: gets.to_owned(),
            we: None,
            agreement: "holds".to_owned(),
            verdict: if holds { Verdict::Agrees } else { Verdict::Differs },
            basis: std::mem::take(&mut self.next),
            why: if holds && says == gets { String::new() } else { why.to_owned() },
        });
    }
}

#[cfg(test)]
mod tests {
    use super::Agreement::{AtLeast, AtMost, Share, Within};
    use super::*;

    #[test]
    fn numbers_are_shown_short_and_judged_as_stated() {
        for (v, text) in
            [(0.0048, "0.0048"), (29166.666, "29167"), (23.46, "23.46"), (-0.0001, "-0.0001"), (4.0, "4")]
        {
            assert_eq!(shown(v), text);
        }
        assert!(Within(0.5).met(8.0, 8.333) && !Within(0.1).met(8.0, 8.333));
        assert!(Share(0.05).met(30.0, 29.167) && !Share(0.01).met(30.0, 29.167));
        assert!(AtMost.met(4.0, 2.9) && !AtMost.met(4.0, 4.1) && AtLeast.met(10.0, 14.0));
        let mut rows = Rows::default();
        rows.number(("t", "w", ""), 1.0, 1.0, Within(0.0), "never shown");
        rows.number(("t", "w", ""), 1.0, 2.0, Within(0.0), "shown");
        assert_eq!((rows.list[0].why.as_str(), rows.list[0].verdict), ("", Verdict::Agrees));
        // As far off as the figure is large: zero and the other sign would agree too.
        rows.number(("t", "w", "in"), 0.0002, -0.0001, Within(0.0003), "");
        assert_eq!((rows.list.len(), rows.too_small), (2, 1));
        rows.number(("t", "w", "in"), 0.0002, 0.0009, Within(0.0003), "");
        rows.number(("t", "w", "in"), 0.0004, 0.0003, Within(0.0003), "");
        rows.number(("t", "w", "in"), 0.0, 0.0001, Within(0.0003), "");
        let verdicts: Vec<Verdict> = rows.list[2..].iter().map(|r| r.verdict).collect();
        assert_eq!(verdicts, [Verdict::Differs, Verdict::Agrees, Verdict::Agrees]);
        assert_eq!((rows.list[1].why.as_str(), rows.list[1].verdict), ("shown", Verdict::Differs));
    }

    #[test]
    fn a_mark_is_of_one_row_alone() {
        let mut rows = Rows::default();
        // Too small to be listed, and marked all the same.
        rows.given().number(("t", "w", "in"), 0.0002, -0.0001, Within(0.0003), "");
        rows.words(("t", "w"), "a", "a", "");
        rows.fitted().words(("t", "w"), "a", "a", "");
        rows.given().number(("t", "w", ""), 1.0, 1.0, Within(0.0), "");
        rows.number(("t", "w", ""), 1.0, 1.0, Within(0.0), "");
        let marks: Vec<&str> = rows.list.iter().map(|r| r.basis.mark()).collect();
        assert_eq!(marks, ["", "fitted", "given", ""]);
    }
}
