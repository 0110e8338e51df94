//! Tables 4 to 6, figures 9 to 11, 13 to 15 and 18, equations 2 to 4: drift and tilt, dry and wet.

use super::{AXES, Centre, INCH_UM, PHASES, TABLE_4, TABLE_5, error_of, record};
use crate::rows::Agreement::{AtMost, Within};
use crate::rows::{Rows, shown};
use rtec_model::record::Record;
use rtec_sim::compensation_experiments::{ExperimentResult, MandrelGaugeReadings};
use rtec_sim::thermal_network::FIGURE_9;

/// What the five gauges showed in a record.
fn gauges<'f>(found: &'f ExperimentResult, name: &str) -> &'f [MandrelGaugeReadings] {
    found.gauges.iter().find(|g| g.0 == name).map_or(&[], |g| &g.1)
}

/// Tables 4 and 5 by phase, and how heating compares with cooling.
/// Gives the drift of the wet three hours, µm.
pub(super) fn drifts(rows: &mut Rows, found: &ExperimentResult) -> [[f64; 3]; 2] {
    let mut three_hours = [[0.0; 3]; 2];
    let gets = FIGURE_9.iter().map(|c| c.1).sum();
    rows.given().number(("Figure 9", "length of the cycle", "min"), 435.0, gets, Within(0.0), "");
    for (w, (name, table, place)) in
        [("drift-dry", TABLE_4, "Table 4 (dry)"), ("drift-wet", TABLE_5, "Table 5 (wet)")]
            .into_iter()
            .enumerate()
    {
        let seen = gauges(found, name);
        // A mean over three minutes: what a gauge shows at one instant has noise.
        let at = |minute: usize, f: &dyn Fn(&MandrelGaugeReadings) -> f64| {
            let near = &seen[minute.saturating_sub(1)..(minute + 2).min(seen.len())];
            near.iter().map(f).sum::<f64>() / near.len().max(1) as f64
        };
        if seen.len() < 436 {
            continue;
        }
        for ((phase, from, to), says) in PHASES.iter().zip(table) {
            for p in 0..3 {
                let gauge = [1, 0, 2][p];
                let um = at(*to, &|g| g.um[gauge]) - at(*from, &|g| g.um[gauge]);
                if *from == 0 {
                    three_hours[w][p] = um;
                }
                let what = format!("{phase}: drift in {}", AXES[p]);
                let why = "growth of four terms per axis, on the sensors of a simulated thermal network, fitted to all sixteen phases at \
                    once: what such a model cannot follow stays";
                rows.fitted().number((place, &what, "in"), says[p], um / INCH_UM, Within(0.0008), why);
            }
            for p in 0..2 {
                let got = at(*to, &|g| g.tilt_arcsec[p]) - at(*from, &|g| g.tilt_arcsec[p]);
                let what = format!("{phase}: tilt in {}", AXES[p]);
                let why = "four terms without lag in the chain; the table's short phases repeat to some seconds of arc only, and our \
                    gauges' 0.1 µm over 100 mm are 0.3″";
                rows.fitted().number((place, &what, "″"), says[3 + p], got, Within(8.0), why);
            }
        }
        let back = |p: usize| {
            let gauge = [1, 0, 2][p];
            let grown = at(180, &|g| g.um[gauge]) - at(0, &|g| g.um[gauge]);
            let cooled = at(240, &|g| g.um[gauge]) - at(180, &|g| g.um[gauge]);
            -cooled / grown
        };
        for p in 0..3 {
            let says = -table[1][p] / table[0][p];
            let what = format!("{} axis: share of the growth that an hour's rest takes back", AXES[p]);
            let why = "from the two phases above; below zero it goes on growing at rest";
            rows.fitted().number((place, &what, ""), says, back(p), Within(0.2), why);
        }
    }
    three_hours
}

/// Marks the next row.
type Mark = fn(&mut Rows) -> &mut Rows;

/// Table 6, and the uncertainties that its errors add up to.
pub(super) fn table_6(rows: &mut Rows, scale: [f64; 3], positioning: [f64; 3], thermal: [[f64; 3]; 2]) {
    let place = "Table 6";
    let from = "the largest of the rows above";
    for (mark, what, says, ours, tolerance) in [
        (Rows::given as Mark, "scale error", [0.0013, 0.0006, 0.0027], scale, 0.0003),
        (|rows| rows, "positioning error", [0.0004, 0.0004, 0.0002], positioning, 0.0006),
        (Rows::fitted, "thermal, dry", [0.0027, 0.0017, 0.0048], thermal[0].map(f64::abs), 0.0008),
        (Rows::fitted, "thermal, wet", [0.0029, 0.0041, 0.0036], thermal[1].map(f64::abs), 0.0008),
    ] {
        for p in 0..3 {
            let what = format!("{what}, {} axis", AXES[p]);
            mark(rows).number((place, &what, "in"), says[p], ours[p] / INCH_UM, Within(tolerance), from);
        }
    }
}

/// Figures 10, 11 and 13 to 15: housing and spindle, dry and wet.
pub(super) fn dry_against_wet(rows: &mut Rows, found: &ExperimentResult) {
    let (Ok(dry), Ok(wet)) = (record(found, "drift-dry"), record(found, "drift-wet")) else { return };
    let degc = |r: &Record, sensor: &str, minute: usize| r.temperature(sensor).map_or(0.0, |t| t[minute]);
    let (front, middle, rear) = ("T8", "T7", "T9");
    for (place, r) in [("Figure 10", dry), ("Figure 11", wet)] {
        for (what, sensor) in [("front", front), ("middle", middle), ("rear", rear)] {
            let most = (0..=180).map(|m| degc(r, sensor, m)).fold(f64::MIN, f64::max);
            let what =
                format!("spindle housing {what}, hottest in three hours: within the figure's scale to 40 °C");
            let why = "a curve without figures; its scale runs from 20 to 40 °C";
            rows.number((place, &what, "°C"), 40.0, most, AtMost, why);
        }
    }
    let gradient = |r: &Record| degc(r, rear, 180) - degc(r, front, 180);
    let (d, w) = (gradient(dry), gradient(wet));
    let why = "curves without figures";
    let what = "gradient from front to rear of the housing: larger wet than dry";
    let gets = format!("{} K dry, {} K wet after three hours", shown(d), shown(w));
    rows.holds(("Figures 13 and 14; text after table 7", what), "larger wet", &gets, w.abs() > d.abs(), why);
    let growth = |r: &Record, p: usize| {
        let e = error_of(r, p);
        (e.get(140).copied().unwrap_or(0.0) - e.first().copied().unwrap_or(0.0)).abs()
    };
    for (p, says) in [(1, "more wet"), (2, "more wet")] {
        let (d, w) = (growth(dry, p), growth(wet, p));
        let why = "the text says so of Y and Z; tables 4 and 5, which our machine follows, have Z grow less wet (0.0036 in) than dry (0.0048 in) \
            over three hours";
        let what = format!("spindle growth in {} after 140 minutes", AXES[p]);
        let gets = format!("{} µm dry, {} µm wet", shown(d), shown(w));
        rows.holds(("Figure 15; text after table 7", &what), says, &gets, w > d, why);
    }
}

/// Equations 2 to 4 as printed, with all temperatures alike, and at those of the simulated machine.
pub(super) fn equations(rows: &mut Rows, centre: &Centre, found: &ExperimentResult) {
    let says = [("x", 0.4179), ("y", 0.4017), ("z", 0.5248)];
    for (equation, (axis, constant)) in centre.equation.iter().zip(says) {
        let place = format!("Equation {}", 2 + says.iter().position(|s| s.0 == axis).unwrap_or(0));
        let what = format!("E_{axis} with all temperatures alike: the gauge's own reading, mm");
        let why = "the machine file has another constant";
        rows.given().number((&place, &what, "mm"), constant, equation.mm(|_| 20.0), Within(1e-9), why);
        let Ok(wet) = record(found, "drift-wet") else { continue };
        let at = |minute: usize| equation.mm(|s| wet.temperature(s).map_or(20.0, |t| t[minute]));
        let p = says.iter().position(|s| s.0 == equation.axis).unwrap_or(0);
        let growth_in = (at(180) - at(0)) * 1e3 / INCH_UM;
        let what = format!("E_{axis} grows in three wet hours at 5500 rpm (table 5)");
        let why = "the equations belong to the temperatures of that machine, which are not printed: places of the sensors are in figure 8 \
                   only. In equation 2 the printed 0.114 mm/K would be 114 µm/K, which no machine has: a tenth of it suits the other \
                   axes. So these are the published coefficients at our temperatures, in millimetres, in inches here";
        rows.number((&place, &what, "in"), TABLE_5[0][p], growth_in, Within(0.0008), why);
    }
}
