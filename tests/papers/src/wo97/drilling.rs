//! Table 7 and figures 21 to 23: the drilling tests.

use super::{AXES, INCH_UM, Run, error_of, record};
use crate::PaperError;
use crate::rows::{Agreement, Rows, shown};
use rtec_model::machine::Machine;
use rtec_sim::experiment::Findings;

/// Table 7, inches ·10⁻⁴: hole (and counterbore) by hole (and counterbore), X, Y, Z.
const TABLE_7: [(u32, [[f64; 3]; 2]); 11] = [
    (2, [[3.0, 12.0, 1.0], [0.0, 13.0, 1.0]]),
    (3, [[-3.0, 9.0, -1.0], [-5.0, 1.0, -1.0]]),
    (4, [[10.0, 9.0, 20.0], [5.0, 0.0, 20.0]]),
    (5, [[21.0, 19.0, 57.0], [18.0, 19.0, 57.0]]),
    (6, [[12.0, 18.0, 63.0], [8.0, 19.0, 63.0]]),
    (7, [[6.0, 16.0, 48.0], [3.0, 19.0, 48.0]]),
    (8, [[20.0, 17.0, 44.0], [18.0, 19.0, 44.0]]),
    (9, [[43.0, 53.0, 59.0], [40.0, 53.0, 59.0]]),
    (10, [[38.0, 52.0, 42.0], [36.0, 51.0, 42.0]]),
    (11, [[34.0, 49.0, 42.0], [32.0, 49.0, 42.0]]),
    (12, [[44.0, 50.0, 57.0], [42.0, 51.0, 57.0]]),
];

/// Rows of a cycle: two passes of four holes, each with its counterbore.
const CYCLE_ROWS: usize = 16;

pub(super) fn drilling(
    rows: &mut Rows,
    run: &Run<'_>,
    model: &Machine,
    (scale, positioning, thermal): ([f64; 3], [f64; 3], [[f64; 3]; 2]),
) -> Result<(), PaperError> {
    let mut cold = run.experiment("drilling", Some(model))?;
    let mut warm = run.experiment("drilling-warm", Some(model))?;
    rows.figures.append(&mut cold.plots);
    rows.figures.append(&mut warm.plots);
    let deviations = |found: &Findings, name: &str| -> Result<[Vec<f64>; 3], PaperError> {
        let record = record(found, name)?;
        Ok([0, 1, 2].map(|p| {
            let e = error_of(record, p);
            e.iter().map(|v| (v - e[0]) / INCH_UM).collect()
        }))
    };
    let test_1 = deviations(&cold, "drilling")?;
    let test_3 = deviations(&cold, "drilling-compensated")?;
    let test_2 = deviations(&warm, "drilling-warm-compensated")?;
    let sizes = "the paper drilled two months after the characterisation and gives sizes with reference to hole 1 only; ours is the \
                 machine of tables 1 to 5 in between, sign as the tool is off. Sizes are compared";
    for (hole, both) in TABLE_7 {
        for (k, name) in [(0, "hole"), (1, "counterbore")] {
            for p in 0..3 {
                // Table 7's test drilled the first pass of each cycle alone.
                let (cycle, n) = ((hole as usize - 1) / 4, (hole as usize - 1) % 4);
                let at = CYCLE_ROWS * cycle + 2 * n + k;
                let ours = test_1[p].get(at).copied().unwrap_or(0.0);
                rows.number(
                    ("Table 7 (test 1)", &format!("{name} {hole}, {}", AXES[p]), "in"),
                    both[k][p].abs() * 1e-4,
                    ours.abs(),
                    Agreement::Within(0.003),
                    if hole == 6 && k == 1 && p == 0 {
                        "0.008 in is printed, ten times its hole's 0.0012: read as 0.0008"
                    } else {
                        sizes
                    },
                );
            }
        }
    }
    let worst = |d: &[Vec<f64>; 3], p: usize, rows: std::ops::Range<usize>| {
        d[p].get(rows).unwrap_or_default().iter().map(|e| e.abs()).fold(0.0, f64::max)
    };
    for (p, says) in [0.0044, 0.0053, 0.0059].into_iter().enumerate() {
        rows.number(
            ("Text after table 7", &format!("errors of the machining test in {}", AXES[p]), "in"),
            says,
            worst(&test_1, p, 0..3 * CYCLE_ROWS),
            Agreement::Within(0.002),
            sizes,
        );
    }
    for (p, says) in [0.0033, 0.0042, 0.0045].into_iter().enumerate() {
        let rss = (scale[p].powi(2) + positioning[p].powi(2) + thermal[1][p].powi(2)).sqrt() / INCH_UM;
        rows.number(
            ("Text after table 7", &format!("uncertainty from the characterisation in {}", AXES[p]), "in"),
            says,
            rss,
            Agreement::Within(0.0008),
            "root sum of squares of table 6's scale, positioning and wet thermal errors, which gives the paper's figures of its own",
        );
    }
    for (test, name) in [(&test_2, "2, warm"), (&test_3, "3, cold")] {
        for (p, axis) in AXES.iter().enumerate() {
            let (with, without) = (worst(test, p, 0..3 * CYCLE_ROWS), worst(&test_1, p, 0..3 * CYCLE_ROWS));
            rows.holds(
                (
                    "Figures 22 and 23",
                    &format!("test {name}: errors in {axis} substantially reduced against test 1"),
                ),
                "substantially reduced",
                &format!("{} in of {} in", shown(with), shown(without)),
                with <= 0.25 * without,
                "at most 25 % counts as substantial; the model was fitted on the wet runs alone, and never saw a hole",
            );
        }
    }
    Ok(())
}
