//! Every figure in README and guide is in the table of record.

use rtec_blind::record::{
    BOTH, CASES, COMMAND, Figure, NOTHING, ONE, ONE_CLEAR, PRINTED, QUOTED, UNKNOWN, UNKNOWN_NAMED, WRONG,
};
use std::path::{Path, PathBuf};

const MAIN_SUITE: [Figure; 7] = [ONE_CLEAR, ONE, WRONG, NOTHING, UNKNOWN, UNKNOWN_NAMED, BOTH];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn page(name: &str) -> String {
    let text = std::fs::read_to_string(root().join(name)).expect("a file of the repository");
    // A sentence may continue on the next line.
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn quoted_figures_are_those_of_the_newest_run() {
    let none = |f: Figure| format!("none in {}", f.newest.1);
    let quotes = [
        (
            "README.md",
            vec![
                format!("{CASES} cases of never-run seeds"),
                ONE_CLEAR.quoted().replace(" (", " named rightly ("),
                format!("a wrong name in {}", WRONG.counts()),
                none(NOTHING),
            ],
        ),
        (
            "tools/guide/contributor/figures.md",
            vec![
                format!("{CASES} cases of seeds never run before (`{COMMAND}`"),
                format!(
                    "| {}; {} | {}; {} |",
                    ONE_CLEAR.quoted(),
                    ONE.quoted(),
                    ONE_CLEAR.asks(),
                    ONE.asks()
                ),
                format!("| {} | {} |", WRONG.counts(), WRONG.asks()),
                format!("| {} | {} |", NOTHING.counts(), NOTHING.asks()),
                format!(
                    "| {}; {} | {}; {} |",
                    UNKNOWN.quoted(),
                    UNKNOWN_NAMED.newest.0,
                    UNKNOWN.asks(),
                    UNKNOWN_NAMED.asks()
                ),
                format!("| {} | {} |", BOTH.quoted(), BOTH.asks()),
            ],
        ),
        (
            "tools/guide/metrologist/reconcile.md",
            vec![
                format!("it named {} rightly, and both of two in {}", ONE_CLEAR.counts(), BOTH.counts()),
                format!("it named {} wrongly, and nothing in {}", WRONG.counts(), NOTHING.newest.1),
            ],
        ),
    ];
    for (name, wanted) in quotes {
        let text = page(name);
        for quote in wanted {
            assert!(text.contains(&quote), "{name} does not say `{quote}`, which the table of record does");
        }
    }
}

#[test]
fn the_newest_run_is_within_chance_of_what_is_asked() {
    for figure in MAIN_SUITE {
        assert!(figure.within_chance(figure.newest), "{figure:?}");
    }
    assert!(!ONE_CLEAR.reached((138, 142)) && ONE_CLEAR.within_chance((138, 142)));
    assert!(
        !ONE_CLEAR.within_chance((130, 142))
            && !WRONG.within_chance((8, 312))
            && WRONG.within_chance((3, 312))
    );
    assert!(BOTH.reached((0, 0)));
}

/// Paths of README and every page of the guide in the repository.
fn pages() -> Vec<String> {
    let mut folders = vec![root().join("tools/guide")];
    let mut pages = vec!["README.md".to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of the guide") {
            let path = entry.expect("an entry of a folder").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                let name = path.strip_prefix(root()).expect("a path below the root");
                pages.push(name.display().to_string());
            }
        }
    }
    pages
}

/// The shares that a text quotes: `17 of 19`, `19 of the 20`.
///
/// Blocks are left out, because the output of a command is checked where it runs.
fn shares(text: &str) -> Vec<String> {
    let prose: String = text.split("```").step_by(2).collect();
    let words: Vec<&str> =
        prose.split_whitespace().map(|w| w.trim_matches(|c: char| ",;:.()|".contains(c))).collect();
    let whole = |w: &str| !w.is_empty() && w.chars().all(|c| c.is_ascii_digit());
    let share = |k: usize| match words.get(k..) {
        Some([n, "of", m, ..]) if whole(n) && whole(m) => Some(format!("{n} of {m}")),
        Some([n, "of", "the", m, ..]) if whole(n) && whole(m) => Some(format!("{n} of the {m}")),
        _ => None,
    };
    (0..words.len()).filter_map(share).collect()
}

/// Every share that a page quotes is in the table of record.
/// It finds a page that a newer run left behind, and a figure that nobody ran.
#[test]
fn every_share_that_a_page_quotes_is_in_the_table() {
    let mut missing = Vec::new();
    for name in pages() {
        let text = page(&name);
        let known = |share: &String| {
            MAIN_SUITE.iter().any(|f| f.counts() == *share)
                || QUOTED
                    .iter()
                    .any(|q| q.pages.contains(&name.as_str()) && q.figures.contains(&share.as_str()))
        };
        missing.extend(shares(&text).into_iter().filter(|s| !known(s)).map(|s| format!("{name}: {s}")));
    }
    assert!(missing.is_empty(), "quoted, and no run of the table of record: {missing:#?}");
}

#[test]
fn every_figure_of_the_table_stands_on_its_pages() {
    for q in QUOTED {
        for name in q.pages {
            let text = page(name);
            for figure in q.figures {
                assert!(text.contains(figure), "{name} does not say `{figure}` ({}, {})", q.by, q.on);
            }
        }
        let with_command = |name: &&str| page(name).contains(q.by);
        assert!(q.pages.iter().any(with_command), "no page of {:?} has the command `{}`", q.pages, q.by);
    }
}

/// Each row of README's figures is a run in the table.
#[test]
fn every_row_of_the_readme_is_a_run_of_the_table() {
    let text = std::fs::read_to_string(root().join("README.md")).expect("README.md");
    let section =
        text.split("## Figures in short").nth(1).and_then(|t| t.split("\n## ").next()).expect("its section");
    let rows: Vec<&str> = section.lines().filter(|l| l.starts_with("| ")).skip(1).collect();
    assert!(rows.len() > 5, "README has a table of figures");
    for row in rows {
        let of_main = row.contains(&ONE_CLEAR.counts());
        let of = |q: &&rtec_blind::record::Quoted| {
            q.pages.contains(&"README.md") && q.figures.iter().any(|f| row.contains(f))
        };
        assert!(of_main || QUOTED.iter().any(|q| of(&q)), "no run of the table: {row}");
    }
}

/// The decimal numbers of a text.
fn decimals(text: &str) -> impl Iterator<Item = &str> {
    let bare = |w: &'_ str| w.trim_matches(|c: char| !c.is_ascii_digit()).len();
    text.split(|c: char| c.is_whitespace() || "`|()±+−=;".contains(c))
        .map(|w| w.trim_matches(|c: char| ",:.-".contains(c)))
        .filter(move |w| bare(w) == w.len() && w.contains('.') && w.parse::<f64>().is_ok())
}

/// The measured figures that a page quotes in its prose.
///
/// They are decimal numbers of µm or per cent, and all of three decimals or more.
///
/// A range has its unit behind the last number: `0.9 to 1.8 µm`. Commands in the prose are left out.
fn measured(prose: &str) -> Vec<&str> {
    let spans = prose.split('`').enumerate().filter(|(n, span)| n % 2 == 0 || !span.contains("--"));
    let mut found = Vec::new();
    for (_, span) in spans {
        let mut open = Vec::new();
        for word in span.split_whitespace() {
            let numbers: Vec<&str> = decimals(word).collect();
            found.extend(numbers.iter().filter(|n| n.split('.').nth(1).is_some_and(|d| d.len() > 2)));
            let unit = word.trim_matches(|c: char| ",;:.()|".contains(c));
            if ["µm", "um", "%"].contains(&unit) {
                found.append(&mut open);
            } else if numbers.is_empty() && !["to", "and", "→", "->", "±"].contains(&unit) {
                open.clear();
            }
            open.extend(numbers);
        }
    }
    found
}

/// The numbers that the commands of a page print, and its prose.
fn printed_and_prose(name: &str) -> (Vec<f64>, String) {
    let text = std::fs::read_to_string(root().join(name)).expect("a page");
    let blocks: Vec<&str> = text.split("```").collect();
    let outputs: String = blocks.iter().filter(|b| b.starts_with("console")).copied().collect();
    let numbers = outputs.split(|c: char| !c.is_ascii_digit() && c != '.');
    let printed = numbers.filter_map(|n| n.trim_matches('.').parse().ok()).collect();
    (printed, blocks.iter().step_by(2).copied().collect())
}

/// Whether a figure is among numbers, rounded to its decimals.
fn is_among(printed: &[f64], figure: &str) -> bool {
    let digits = figure.split('.').nth(1).map_or(0, str::len);
    printed.iter().any(|n| format!("{n:.digits$}") == figure)
}

/// A page with outputs quotes figures from them, or from the table of record.
#[test]
fn every_measured_figure_beside_an_output_is_printed_or_in_the_table() {
    let mut missing = Vec::new();
    for name in pages() {
        let (printed, prose) = printed_and_prose(&name);
        let of_table = |figure: &str| {
            let mut own = QUOTED.iter().filter(|q| q.on != PRINTED && q.pages.contains(&name.as_str()));
            own.any(|q| q.figures.iter().any(|f| decimals(f).any(|d| d == figure)))
        };
        let known = |figure: &str| is_among(&printed, figure) || of_table(figure);
        let quoted = measured(&prose).into_iter().filter(|f| !printed.is_empty() && !known(f));
        missing.extend(quoted.map(|f| format!("{name}: {f}")));
    }
    assert!(missing.is_empty(), "neither printed on the page nor in the table of record: {missing:#?}");
}

/// Other pages quote a printed figure as it is printed.
#[test]
fn every_figure_printed_by_a_page_is_printed_there() {
    for q in QUOTED.iter().filter(|q| q.on == PRINTED) {
        let printed: Vec<f64> = q.pages.iter().flat_map(|name| printed_and_prose(name).0).collect();
        for figure in q.figures.iter().flat_map(|f| decimals(f)) {
            assert!(is_among(&printed, figure), "no page of {:?} prints {figure}", q.pages);
        }
    }
}

#[test]
fn a_measured_figure_is_told_from_others() {
    let text = "a nose of 38.1 mm, version 1.88, left 0.9 to 1.8 µm (4.2 %), `x = 7.484 ± 0.015` and `--nose-mm 0.794` of 2.5 m/min";
    assert_eq!(measured(text), ["0.9", "1.8", "4.2", "7.484", "0.015"]);
}
