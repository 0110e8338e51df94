//! Every figure of the main suite that README and guide quote is the table of record's.

use rtec_blind::record::{BOTH, CASES, COMMAND, NOTHING, ONE, ONE_CLEAR, UNKNOWN, UNKNOWN_NAMED, WRONG};
use std::path::Path;

fn page(name: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let text = std::fs::read_to_string(root.join(name)).expect("a file of the repository");
    // A sentence may go on in the next line.
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn quoted_figures_are_those_of_the_newest_run() {
    let none = |f: rtec_blind::record::Figure| format!("none in {}", f.newest.1);
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
    for figure in [ONE_CLEAR, ONE, WRONG, NOTHING, UNKNOWN, UNKNOWN_NAMED, BOTH] {
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
