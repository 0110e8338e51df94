//! People's mistakes, before anything is explained: what the records show by themselves (`rtec_measure::plausible`), and what
//! shows beside the model, a record that agrees with it only with another sign, unit, direction or sensor. What is doubted
//! is left out of the analysis and said; it is never named as an effect.

use crate::answer::Answer;
use crate::gap::Gap;
use crate::problem::{Stack, rms};
use rtec_measure::plausible::{self, Suspicion, What};
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role};

/// A mistake is believed where with it undone the model explains so much of the record's variance, and as the record stands
/// no more than [`UNLIKE`].
const ALIKE: f64 = 0.8;
const UNLIKE: f64 = 0.3;
/// The same for what changes the model's side alone: so much of the variance that was left is left.
const BETTER: f64 = 0.2;
/// A row is wild that is so many robust standard deviations off; more than this share of them are no wild rows.
const WILD: f64 = 20.0;
const MOST_WILD: f64 = 0.06;
/// Fewer rows tell nothing.
const FEWEST: usize = 12;
/// A hold-out that the better model leaves so many times the training's remainder of is of another machine, or state.
const OTHER: f64 = 4.0;

/// What is doubted, and the records to analyse.
pub(crate) struct Doubts {
    pub(crate) said: Vec<Suspicion>,
    /// The training records without what is doubted; none where all of it is.
    pub(crate) train: Vec<Record>,
    /// The same of the hold-outs.
    pub(crate) holdout: Vec<Record>,
}

/// Looks at all records beside each other and beside the model.
pub(crate) fn doubts(train: &[Record], holdout: &[Record], machine: &Machine) -> Doubts {
    let all: Vec<Record> = train.iter().chain(holdout).cloned().collect();
    let mut said = plausible::suspicions(&all);
    for record in &all {
        let doubted = said.iter().any(|s| about(s, record) && whole(s, record));
        if !doubted {
            said.extend(beside_the_model(record, machine));
        }
    }
    let left = |records: &[Record]| records.iter().filter_map(|r| without(r, &said, machine)).collect();
    let (train, holdout) = (left(train), left(holdout));
    Doubts { said, train, holdout }
}

fn about(s: &Suspicion, record: &Record) -> bool {
    s.record == record.path.display().to_string()
}

fn is_sensor(record: &Record, name: &str) -> bool {
    let sensor = |c: &Column| c.name == name && matches!(c.role, Role::Temperature | Role::Channel);
    record.columns.iter().any(sensor)
}

/// Whether it is about the whole record: what it means all along is not known.
fn whole(s: &Suspicion, record: &Record) -> bool {
    match s.what {
        What::Unit | What::Sign | What::Direction | What::OtherMachine => !is_sensor(record, &s.column),
        What::Swapped => true,
        What::Range => !is_sensor(record, &s.column) && s.rows.is_empty(),
        _ => false,
    }
}

/// The record without what is doubted of it; none where nothing is left that could be trusted.
fn without(record: &Record, said: &[Suspicion], machine: &Machine) -> Option<Record> {
    if said.iter().any(|s| about(s, record) && whole(s, record)) {
        return None;
    }
    let read = |name: &str| {
        let reads = |e: &rtec_model::effect::Effect| {
            e.channel() == Some(name) || e.delta.as_ref().is_some_and(|d| d.sensors().any(|n| n == name))
        };
        machine.effects().any(reads)
    };
    let of_rows: Vec<Suspicion> = said.iter().filter(|s| !is_sensor(record, &s.column)).cloned().collect();
    let mut rows = plausible::unusable(&of_rows).rows(record);
    let mut sensors: Vec<&str> = Vec::new();
    for s in said.iter().filter(|s| is_sensor(record, &s.column)) {
        if !read(&s.column) {
            // Doubted in one record, it is no cause in any.
            sensors.push(&s.column);
        } else if about(s, record) {
            let own = s.row_list();
            if own.is_empty() {
                return None;
            }
            rows.extend(own);
        }
    }
    rows.sort_unstable();
    rows.dedup();
    let keep: Vec<usize> = (0..record.rows()).filter(|i| rows.binary_search(i).is_err()).collect();
    if keep.len() < FEWEST.min(record.rows()) {
        return None;
    }
    let mut left = if keep.len() < record.rows() { record.select(&keep) } else { record.clone() };
    left.columns.retain(|c| !sensors.contains(&c.name.as_str()) || !is_sensor(record, &c.name));
    Some(left)
}

/// Minus its mean.
fn centred(x: &[f64]) -> Vec<f64> {
    let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
    x.iter().map(|x| x - mean).collect()
}

fn simulated(record: &Record, role: &Role, machine: &Machine) -> Vec<f64> {
    let mut sum = vec![0.0; record.rows()];
    for e in machine.effects() {
        let _absent = e.add(record, role, &mut sum);
    }
    centred(&sum)
}

/// A mistake that the record and the model show together.
fn beside_the_model(record: &Record, machine: &Machine) -> Option<Suspicion> {
    if record.rows() < FEWEST || machine.effects().next().is_none() {
        return None;
    }
    record.responses().find_map(|c| {
        let (y, s) = (centred(&c.data), simulated(record, &c.role, machine));
        let share = |by: f64, s: &[f64]| {
            let left: Vec<f64> = y.iter().zip(s).map(|(y, s)| by * y - s).collect();
            1.0 - (rms(&left) / (by * rms(&y)).abs().max(1e-300)).powi(2)
        };
        let now = share(1.0, &s);
        let told = |what: What, column: &str, text: String| Suspicion::new(record, column, what, &[], text);
        for (by, what, text) in [
            (-1.0, What::Sign, "it agrees with the model only with the other sign: nominal minus measured?"),
            (1e3, What::Unit, "it agrees with the model only 1000 times as large: given in mm, called µm?"),
            (1e-3, What::Unit, "it agrees with the model only 1000 times smaller: given in nm?"),
        ] {
            if share(by, &s) > ALIKE && now < UNLIKE {
                return Some(told(what, &c.name, text.to_owned()));
            }
        }
        // Where the model agrees already nothing else is looked for.
        let left = 1.0 - now;
        let better = |other: &Record| {
            let left_then = 1.0 - share(1.0, &simulated(other, &c.role, machine));
            left_then < BETTER * left && left_then < 1.0 - ALIKE
        };
        let changed = |role: &dyn Fn(&Role) -> bool, by: f64| {
            let mut other = record.clone();
            for column in other.columns.iter_mut().filter(|c| role(&c.role)) {
                column.data.iter_mut().for_each(|x| *x *= by);
            }
            other
        };
        let name = |role: &dyn Fn(&Role) -> bool| {
            record.columns.iter().find(|c| role(&c.role)).map_or(String::new(), |c| c.name.clone())
        };
        let direction = |r: &Role| matches!(r, Role::Direction(_) | Role::Velocity(_));
        if better(&changed(&direction, -1.0)) {
            let text = "the run agrees with the model only with the directions exchanged";
            return Some(told(What::Direction, &name(&direction), text.to_owned()));
        }
        let position = |r: &Role| matches!(r, Role::Position(_));
        for (by, unit) in [(1e3, "m"), (1e-3, "µm"), (25.4, "inch")] {
            if better(&changed(&position, by)) {
                let text = format!("the run agrees with the model only with positions {by} times these: given in {unit}, called mm?");
                return Some(told(What::Unit, &name(&position), text));
            }
        }
        let sensors: Vec<&str> = record.names(&Role::Temperature).collect();
        for (i, a) in sensors.iter().enumerate() {
            for b in &sensors[i + 1..] {
                let mut other = record.clone();
                for column in other.columns.iter_mut().filter(|c| c.role == Role::Temperature) {
                    let from = match column.name.as_str() {
                        n if n == *a => b,
                        n if n == *b => a,
                        _ => continue,
                    };
                    if let Some(data) = record.temperature(from) {
                        column.data = data.to_vec();
                    }
                }
                if better(&other) {
                    let text = format!("the run agrees with the model only with {a} and {b} exchanged");
                    return Some(told(What::Swapped, a, text));
                }
            }
        }
        None
    })
}

/// Rows of each record that an answer leaves far off all others: single ones, and few. From 0.
pub(crate) fn wild(records: &[Record], answer: &Answer) -> Vec<Vec<usize>> {
    let stack = Stack::new(records);
    let mut out = vec![Vec::new(); records.len()];
    for s in &stack.segments {
        let left = &answer.residual[s.rows.clone()];
        let median = |mut v: Vec<f64>| {
            v.sort_by(f64::total_cmp);
            v[v.len() / 2]
        };
        if left.len() < FEWEST {
            continue;
        }
        let middle = median(left.to_vec());
        let spread = 1.4826 * median(left.iter().map(|r| (r - middle).abs()).collect());
        let rows: Vec<usize> =
            (0..left.len()).filter(|i| (left[*i] - middle).abs() > WILD * spread.max(1e-9)).collect();
        let single = rows.windows(3).all(|w| w[2] > w[0] + 2);
        if single && !rows.is_empty() && rows.len() as f64 <= MOST_WILD * left.len() as f64 + 1.0 {
            out[s.record].extend(rows);
        }
    }
    for rows in &mut out {
        rows.sort_unstable();
        rows.dedup();
    }
    out
}

/// What is said of them.
pub(crate) fn say_wild(record: &Record, rows: &[usize]) -> Option<Suspicion> {
    let response = record.responses().next()?;
    let text = format!(
        "{} of {} rows are far off all that explains the others: left out",
        rows.len(),
        record.rows()
    );
    Some(Suspicion::new(record, &response.name, What::Outliers, rows, text))
}

/// A record without some rows.
pub(crate) fn without_rows(record: &Record, rows: &[usize]) -> Record {
    let keep: Vec<usize> = (0..record.rows()).filter(|i| rows.binary_search(i).is_err()).collect();
    if rows.is_empty() || keep.is_empty() { record.clone() } else { record.select(&keep) }
}

/// A hold-out that the better model describes far worse than the training, and no better than the model as it was: then how
/// much of its gap is closed says nothing.
pub(crate) fn other_machine(holdout: &[Record], gap: &mut [Gap]) -> Option<Suspicion> {
    let record = holdout.first()?;
    let far = gap.iter_mut().find(|g| {
        let floor = g.floor.max(g.train[1]);
        g.holdout
            .is_some_and(|[before, after]| g.is_wider() || (after > OTHER * floor && after > 0.7 * before))
    })?;
    let [_, after] = far.holdout?;
    far.doubted = true;
    let (unit, train) = (if far.unit == "um" { "µm" } else { far.unit.as_str() }, far.train[1]);
    let text = format!(
        "the model that leaves {train:.2} {unit} of the training leaves {after:.2} {unit} of the hold-out: another machine, \
         or another state of it?"
    );
    Some(Suspicion::new(record, "", What::OtherMachine, &[], text))
}
