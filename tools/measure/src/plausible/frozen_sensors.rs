//! Frozen sensors, found by their own noise and course and by other sensors.

use super::robust_stats::{longest_run, quantum, range, steps};
use super::sensor_regression::{SensorRegression, sensor_regression};
use super::{MistakeKind, Suspicion};
use rtec_model::effect::sign;
use rtec_model::record::{Column, Record, Role, span};
use statrs::distribution::{ContinuousCDF, Normal};

/// Shortest run of equal readings that is examined, rows.
const SHORTEST: usize = 12;
/// Rows needed to estimate a sensor's noise or a regression.
const ENOUGH: usize = 30;
/// Least ratio of the predicted change in the run to the error beside it.
const NEAR: f64 = 5.0;
/// Usual resolutions of sensors and loggers, K.
const RESOLUTIONS_K: [f64; 13] =
    [1.0, 0.5, 0.25, 0.2, 0.125, 0.1, 0.0625, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];
/// Rows before the run in which the sensor must move in one direction.
const COURSE: usize = 8;
/// Least mean step of these rows, in steps of the resolution.
const FAST: f64 = 3.0;
/// Probability below which noise does not explain the run.
const CHANCE: f64 = 1e-4;

pub(super) fn look(records: &[Record], out: &mut Vec<Suspicion>) {
    for k in 0..records.len() {
        let (record, before) = (&records[k], out.len());
        for c in record.temperatures() {
            let known: Vec<&Suspicion> = out[..before].iter().filter(|s| s.is_of(record, c)).collect();
            if known.iter().any(|s| s.rows.is_empty() || s.what == MistakeKind::Jump) {
                continue;
            }
            if let Some((start, end)) = stands_still(records, k, c) {
                let first = record.first_row();
                let is_there = |row: usize| (first + start..first + end).contains(&row);
                if known.iter().any(|s| s.row_list().into_iter().any(is_there)) {
                    continue;
                }
                let all = end - start == c.data.len();
                let rows: Vec<usize> = if all { Vec::new() } else { (start..end).collect() };
                let stretch =
                    if all { "every row".to_owned() } else { format!("{} rows on end", end - start) };
                let text =
                    format!("reads {} degC in {stretch}, as a sensor that is alive does not", c.data[start]);
                out.push(Suspicion::new(record, &c.name, MistakeKind::Stuck, &rows, text));
            }
        }
    }
}

/// One line per temperature that is constant and has no suspicion.
/// The sensor may not be read, or be coarse in a calm room.
pub(super) fn still(records: &[Record], found: &[Suspicion]) -> Vec<String> {
    let of = |record: &Record| {
        let is_doubted = |c: &Column| found.iter().any(|s| s.is_of(record, c));
        let still = |c: &&Column| c.data.len() >= ENOUGH && range(&c.data) <= 0.0 && !is_doubted(c);
        let line = |c: &Column| {
            let (path, name, degc) = (record.path.display(), &c.name, c.data[0]);
            format!("{path}: {name} reads {degc} degC in every row: is it read? It explains nothing")
        };
        record.temperatures().filter(still).map(line).collect::<Vec<_>>()
    };
    records.iter().flat_map(of).collect()
}

/// Standard deviation of a sensor's row-to-row noise, and its resolution.
/// Uses second differences without their largest tenth, which the machine causes. Only rows where the reading
/// turns back count, because steps in one direction may be rounding on a slope.
fn noise(pieces: &[&[f64]]) -> (f64, f64) {
    let turn = |w: &[f64]| {
        let (before, behind) = (w[1] - w[0], w[2] - w[1]);
        if before * behind < 0.0 { (behind - before).powi(2) } else { 0.0 }
    };
    let mut squares: Vec<f64> = pieces.iter().flat_map(|p| p.windows(3).map(turn)).collect();
    squares.sort_by(f64::total_cmp);
    squares.truncate(squares.len() * 9 / 10);
    // Without the largest tenth, the mean of a normal variable's squares is 0.623 of the variance.
    let variance = squares.iter().sum::<f64>() / squares.len().max(1) as f64 / 0.623 / 6.0;
    let step = quantum(&pieces.concat());
    ((variance - step * step / 12.0).max(0.0).sqrt(), step)
}

/// The rows in which a sensor of record `k` is frozen, if any.
fn stands_still(records: &[Record], k: usize, c: &Column) -> Option<(usize, usize)> {
    let (record, n) = (&records[k], c.data.len());
    let (start, end) = longest_run(&c.data);
    if end - start < SHORTEST || n < 20 {
        return None;
    }
    let others = records.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, r)| r);
    let elsewhere: Vec<&Record> =
        others.filter(|r| r.temperature(&c.name).is_some_and(|t| range(t) > 0.0)).collect();
    let found = freezes_while_changing(record, c, start)
        || by_noise(record, c, (start, end), &elsewhere)
        || by_the_others(record, c, (start, end), &elsewhere)
        || (end - start == n && elsewhere.is_empty() && among_lively_ones(record, c));
    found.then_some((start, end))
}

/// The largest of [`RESOLUTIONS_K`] that all readings are multiples of; 0 if none.
/// The smallest difference of readings would be too large for a sensor that moves in one direction.
fn resolution(v: &[f64]) -> f64 {
    let whole = |step: f64| v.iter().all(|x| (x / step - (x / step).round()).abs() < 1e-4);
    RESOLUTIONS_K.into_iter().find(|step| whole(*step)).unwrap_or(0.0)
}

/// Detects a sensor that freezes abruptly while it warms or cools.
/// A real body slows down, or turns back where its heat source ends.
fn freezes_while_changing(record: &Record, c: &Column, start: usize) -> bool {
    let Some(first) = start.checked_sub(COURSE) else { return false };
    let own = steps(&c.data[first..=start]);
    let step = resolution(&c.data);
    let time = steps(&record.time_s()[first..(start + COURSE).min(c.data.len())]);
    let even = time.iter().all(|dt| *dt < 3.0 * time[0] && *dt > 0.3 * time[0]);
    let way = sign(own[0]);
    let mean = own.iter().sum::<f64>() * way / own.len() as f64;
    // A body that comes to rest makes ever smaller steps.
    let half: f64 = own[own.len() / 2..].iter().sum::<f64>() * way / (own.len() - own.len() / 2) as f64;
    even && own.iter().all(|s| s * way >= 0.9 * step) && mean > FAST * step && half > 0.7 * mean
}

/// Detects a run that is too long for the sensor's noise at other times.
fn by_noise(record: &Record, c: &Column, (start, end): (usize, usize), elsewhere: &[&Record]) -> bool {
    let mut pieces: Vec<&[f64]> = vec![&c.data[..start], &c.data[end..]];
    pieces.extend(elsewhere.iter().filter_map(|r| r.temperature(&c.name)));
    pieces.retain(|p| p.len() >= 3);
    let rows: usize = pieces.iter().map(|p| p.len()).sum();
    let length = end - start;
    // A logger that writes faster than it reads repeats every reading.
    let usual = pieces.iter().map(|p| longest_run(p)).map(|(a, b)| b - a).max().unwrap_or(0);
    if rows < ENOUGH.min(2 * length) || length < 3 * usual {
        return false;
    }
    let (sigma, step) = noise(&pieces);
    // A logger may write fewer digits of the sensor in this record than in others.
    let step = step.max(resolution(&c.data));
    if sigma <= 0.1 * step || sigma <= 0.0 {
        return false;
    }
    // Toggling between two neighbouring steps does not tell the size of the noise.
    let to_and_fro =
        |w: &[f64]| (w[1] - w[0]) * (w[2] - w[1]) < 0.0 && (w[2] - 2.0 * w[1] + w[0]).abs() > 2.5 * step;
    if !pieces.iter().any(|p| p.windows(3).any(to_and_fro)) {
        return false;
    }
    // Largest probability that a reading repeats: the true value lies in the middle of a step.
    let stays = Normal::standard().cdf(0.5 * step / sigma) * 2.0 - 1.0;
    let chance = (length - 1) as f64 * stays.max(0.05).ln() + (record.rows() as f64).ln();
    // Noise that the spindle causes stops with the spindle, for all sensors at once.
    let outside = |o: &[f64]| [o[..start].to_vec(), o[end..].to_vec()].concat();
    let noisy = record.temperatures().filter(|o| o.name != c.name).filter(|o| {
        let rest = outside(&o.data);
        let (s, q) = noise(&[&rest]);
        rest.len() >= ENOUGH && s > 0.3 * q
    });
    let changes = |o: &Column| steps(&o.data[start..end]).iter().filter(|d| **d != 0.0).count() * 10 > length;
    let noisy: Vec<&Column> = noisy.collect();
    let awake = noisy.is_empty() || noisy.into_iter().any(changes);
    chance < CHANCE.ln() && awake
}

/// Detects a frozen sensor from the others.
/// Their regression predicts a change far above its own error.
fn by_the_others(record: &Record, c: &Column, (start, end): (usize, usize), elsewhere: &[&Record]) -> bool {
    let own: Vec<usize> = (0..record.rows()).filter(|i| *i < start || *i >= end).collect();
    let own = (own.len() >= ENOUGH).then(|| record.select(&own));
    if end - start < 15 {
        return false;
    }
    let asked = record.select(&(start..end).collect::<Vec<_>>());
    own.iter().chain(elsewhere.iter().copied().filter(|r| r.rows() >= ENOUGH)).any(|known| {
        let common = |n: &&str| *n != c.name && known.temperature(n).is_some();
        let rest: Vec<&str> = record.names(&Role::Temperature).filter(common).collect();
        let Some(y) = known.temperature(&c.name).filter(|_| !rest.is_empty()) else { return false };
        let told = sensor_regression(known, y, &rest);
        // Prediction error where the sensor still moves, near the run.
        let wrong = beside_the_run(record, c, (start, end), &rest);
        // Predict only within the range of temperatures that the regression was fitted on.
        let seen = |n: &&str| {
            let (Some(a), Some(b)) = (known.temperature(n), asked.temperature(n)) else { return false };
            let ([l, h], [from, to]) = (span(a), span(b));
            from > l - 0.5 * (h - l) - 0.5 && to < h + 0.5 * (h - l) + 0.5
        };
        let moved = moves_on(told.predict(&asked, &rest));
        // A regression of another record must hold beside this run too.
        let wrong = wrong.unwrap_or(0.0).max(wrong_beside(record, c, (start, end), &told, &rest));
        told.left < 0.1 * range(y)
            && moved > (8.0 * quantum(y)).max(10.0 * told.left).max(1.0)
            && moved > NEAR * wrong
            && rest.iter().all(seen)
    })
}

/// Robust range of the values.
/// Twice the interquartile range, which is the range of a straight line. A step in the last rows does not
/// count, because heat arrives late.
fn moves_on(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = |share: usize| values[(values.len() - 1) * share / 4];
    2.0 * (at(3) - at(1))
}

/// The rows on either side of a run, as many on each side as the run has.
fn rows_beside(record: &Record, (start, end): (usize, usize)) -> Vec<usize> {
    let length = end - start;
    let near = start.saturating_sub(length)..(end + length).min(record.rows());
    near.filter(|i| *i < start || *i >= end).collect()
}

/// RMS error of a regression in the rows beside a run, K.
fn wrong_beside(
    record: &Record,
    c: &Column,
    run: (usize, usize),
    told: &SensorRegression,
    rest: &[&str],
) -> f64 {
    let rows = rows_beside(record, run);
    let off: Vec<f64> =
        rows.iter().zip(told.predict(&record.select(&rows), rest)).map(|(i, s)| c.data[*i] - s).collect();
    (off.iter().map(|x| x * x).sum::<f64>() / off.len().max(1) as f64).sqrt()
}

/// RMS error beside a run of a regression on the rows farther away, K.
/// `None` if too few rows are farther away.
fn beside_the_run(record: &Record, c: &Column, (start, end): (usize, usize), rest: &[&str]) -> Option<f64> {
    let length = end - start;
    let near = start.saturating_sub(length)..(end + length).min(record.rows());
    let far: Vec<usize> = (0..record.rows()).filter(|i| !near.contains(i)).collect();
    let beside = rows_beside(record, (start, end));
    if far.len() < ENOUGH || beside.is_empty() {
        return None;
    }
    let known = record.select(&far);
    let told = sensor_regression(&known, known.temperature(&c.name)?, rest);
    Some(wrong_beside(record, c, (start, end), &told, rest))
}

/// Detects a sensor frozen in every row while all others change in most rows.
/// At least one of the others must move by more than 1 K: a coarse sensor may stay constant in a calm room.
fn among_lively_ones(record: &Record, c: &Column) -> bool {
    let others: Vec<&Column> = record.temperatures().filter(|o| o.name != c.name).collect();
    let changes = |o: &Column| steps(&o.data).iter().filter(|d| **d != 0.0).count() as f64;
    let lively = |o: &&&Column| changes(o) > 0.5 * (o.data.len() - 1) as f64;
    let moving = others.iter().any(|o| range(&o.data) > 1.0);
    let enough = others.len() >= 2 || others.len() == 1 && fine(c.data[0]);
    enough && record.rows() >= ENOUGH && moving && others.iter().filter(lively).count() == others.len()
}

/// Whether the value is neither a multiple of 1/16 K nor of 0.1 K.
fn fine(v: f64) -> bool {
    let whole = |v: f64| (v - v.round()).abs() < 1e-6;
    !(whole(16.0 * v) || whole(10.0 * v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_builders::{column, record};
    use rtec_model::record::RunKind;

    /// A step at the end of a run has not reached other sensors yet.
    #[test]
    fn a_step_at_the_end_of_a_run_is_no_moving_on() {
        let even: Vec<f64> = (0..20).map(|i| 0.1 * f64::from(i)).collect();
        assert!((moves_on(even) - 1.9).abs() < 0.15);
        let late: Vec<f64> = (0..20).map(|i| if i < 16 { 20.0 } else { 23.0 }).collect();
        assert!(moves_on(late) < 1e-9);
    }

    /// A noiseless sensor that freezes while it warms is found.
    /// Sensors that settle, are heated in steps or turn back are not.
    #[test]
    fn what_freezes_in_full_course_is_stuck() {
        let rounded = |v: f64| (v * 100.0).round() / 100.0;
        let body = |tau: f64, end: usize| {
            move |i: usize| {
                let warm = 8.0 * (1.0 - (-(i.min(end) as f64) / tau).exp());
                rounded(20.0 + warm * (-(i.saturating_sub(end) as f64) / tau).exp())
            }
        };
        let made = |near: &dyn Fn(usize) -> f64| {
            let made = |name: &str, role: &str, of: &dyn Fn(usize) -> f64| {
                column(name, role, (0..300).map(of).collect())
            };
            let columns = vec![
                made("t", "time", &|i| 60.0 * i as f64),
                made("T1", "temperature", near),
                made("T2", "temperature", &body(200.0, 300)),
                made("e", "error.x", &|i| 0.01 * i as f64),
            ];
            record("run.run.toml", RunKind::Drift, columns)
        };
        let said = |near: &dyn Fn(usize) -> f64| {
            let mut out = Vec::new();
            look(&[made(near)], &mut out);
            out.into_iter().map(|s| (s.column.clone(), s.rows)).collect::<Vec<_>>()
        };
        let alive = body(90.0, 300);
        assert_eq!(said(&|i| alive(i.min(60))), [("T1".to_owned(), "61-300".to_owned())]);
        assert_eq!(said(&alive), []);
        assert_eq!(said(&body(12.0, 300)), []);
        assert_eq!(said(&body(60.0, 70)), []);
        assert_eq!(said(&|i| 20.0 + 2.0 * (i / 40) as f64), []);
    }

    /// Toggling between two steps of 0.1 K does not tell the noise.
    /// Larger noise shows that the constant record is stuck.
    #[test]
    fn to_and_fro_between_two_steps_is_no_noise_that_is_known() {
        let said = |sigma: f64| {
            let mut dice = test_needs::dice::Dice::new(3);
            let mut read = |middle: f64, sigma: f64| {
                let of = |_| ((middle + sigma * dice.normal()) * 10.0).round() / 10.0;
                (0..300).map(of).collect::<Vec<f64>>()
            };
            let (lively, calm) = (read(20.05, sigma), vec![20.3; 300]);
            let made = |name: &str, t: Vec<f64>| {
                let e = (0..300).map(|i| f64::from(i).sin()).collect();
                record(
                    name,
                    RunKind::Ballbar,
                    vec![column("T1", "temperature", t), column("e", "error.x", e)],
                )
            };
            let mut out = Vec::new();
            look(&[made("a", lively), made("b", calm)], &mut out);
            out.len()
        };
        assert_eq!((said(0.02), said(0.2)), (0, 1));
    }

    /// A regression that is wrong beside the run does not prove a stuck sensor.
    #[test]
    fn a_law_of_another_record_has_to_hold_beside_the_run() {
        let made = |name: &str, near: Vec<f64>, far: Vec<f64>| {
            let e = column("e", "error.x", near.iter().map(|v| 0.1 * v).collect());
            let near = column("T1", "temperature", near);
            record(name, RunKind::Drift, vec![near, column("T2", "temperature", far), e])
        };
        let ramp = |i: i32| 20.0 + 0.05 * f64::from(i);
        let other = made("a", (0..100).map(ramp).collect(), (0..100).map(ramp).collect());
        // In this record the second sensor hardly follows the first.
        let slow = |i: i32| 22.0 + (f64::from(i) / 30.0).floor() * 0.0625;
        let this = made("b", (0..100).map(ramp).collect(), (0..100).map(slow).collect());
        let c = this.columns[1].clone();
        let run = (30, 60);
        assert!(!by_the_others(&this, &c, run, &[&other]));
        // Here the regression holds beside the run, and in the run the sensor is frozen.
        let stuck = |i: i32| ramp(if (30..60).contains(&i) { 30 } else { i });
        let this = made("c", (0..100).map(ramp).collect(), (0..100).map(stuck).collect());
        assert!(by_the_others(&this, &this.columns[1].clone(), run, &[&other]));
    }
}
