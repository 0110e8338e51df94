//! People's mistakes, before anything is explained: what the records show by themselves (`rtec_measure::plausible`), and what
//! shows beside the model, a record that agrees with it only with another sign, unit, direction or sensor. What is doubted
//! is left out of the analysis and said; it is never named as an effect.

use crate::answer::Answer;
use crate::gap::{self, Gap, Trace};
use crate::lanes;
use crate::problem::{Stack, rms};
use crate::suspected::{ALIKE, about, centred, is_of_clock, is_one_of_several, is_sensor, simulated, whole};
use crate::swapped::{exchanged, swapped_alike, with_exchanged};
use crate::undone::{exchanged_columns, is_as_told, is_of_round_mm, other_units, slopes, times};
use crate::verdict::Unsaid;
use crate::weighed::{Mistake, weighed};
use rtec_measure::plausible::{self, Suspicion, What};
use rtec_model::effect::{Effect, Heat};
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Record, Role};

/// Nor is a mistake believed where the model explains more than this as the record stands.
const UNLIKE: f64 = 0.3;
/// The same for the other sign, where the model makes the record far worse.
const OPPOSITE: f64 = 0.45;
/// The same for what changes the model's side alone: so much of the variance that was left is left.
const BETTER: f64 = 0.2;
/// Positions are in another unit only where straight lines over them leave so many times the variance that the unit leaves; no
/// machine has lines steeper than this, µm/mm (the bound of a scale and of a squareness).
const NO_PLAINER: f64 = 1.2;
const STEEPEST: f64 = 1.0;
/// A row is wild that is so many robust standard deviations off; more than this share of them are no wild rows.
const WILD: f64 = 20.0;
const MOST_WILD: f64 = 0.12;
/// Fewer rows tell nothing.
const FEWEST: usize = 12;
/// A hold-out that the better model leaves so many times the training's remainder of is of another machine, or state.
const OTHER: f64 = 4.0;

/// What is doubted, and the records to analyse.
pub(crate) struct Doubts {
    pub(crate) said: Vec<Suspicion>,
    /// The training records without what is doubted; none where all of it is.
    pub(crate) train: Vec<Record>,
    /// Of each of them, the numbers that its rows had as measured.
    pub(crate) rows: Vec<Vec<usize>>,
    /// What was left out of the training, a line each.
    pub(crate) left_out: Vec<String>,
    holdout: Vec<Record>,
    of_holdout: Vec<Suspicion>,
}

/// Looks at all records beside each other and beside the model. What a hold-out shows changes nothing of the training.
/// `looked_at`: what an analysis of records comes to.
pub(crate) fn doubts(
    train: &[Record],
    holdout: &[Record],
    machine: &Machine,
    looked_at: &dyn Fn(&[Record]) -> Option<Answer>,
) -> Doubts {
    let all: Vec<&Record> = train.iter().chain(holdout).collect();
    let twice = plausible::repeated(&all);
    let again = |(first, k): &(usize, usize)| Suspicion::again(all[*first], all[*k]);
    let mut left_out: Vec<String> =
        twice.iter().map(|(_, k)| format!("{}: given twice", all[*k].path.display())).collect();
    let mut said: Vec<Suspicion> = twice.iter().map(again).collect();
    let once = |from: usize, records: &[Record]| -> Vec<Record> {
        let new = |k: &usize| twice.iter().all(|(_, again)| *again != from + k);
        (0..records.len()).filter(new).map(|k| records[k].clone()).collect()
    };
    let (train, holdout) = (once(0, train), once(train.len(), holdout));
    let against_model = |records: &[Record], said: &mut Vec<Suspicion>| {
        // Without what is off by itself: an open input's code is no sign of anything else.
        let left = records.iter().filter_map(|r| without(r, said, machine).map(|(r, _)| r));
        let left: Vec<Record> = left.collect();
        let mistakes = left.iter().map(|r| beside_the_model(r, machine)).collect();
        let found = weighed(&left, mistakes, machine, looked_at);
        said.extend(swapped_alike(&left, &found, machine));
        said.extend(found);
    };
    let mut of_train = plausible::suspicions(&train);
    against_model(&train, &mut of_train);
    let mut together =
        if holdout.is_empty() { Vec::new() } else { plausible::suspicions(&[&train[..], &holdout].concat()) };
    together.retain(|s| !of_train.contains(s));
    // What only the hold-outs' side of a pair shows of a training record is said, and no more.
    let (mut of_holdout, beside): (Vec<_>, Vec<_>) =
        together.into_iter().partition(|s| holdout.iter().any(|r| about(s, r)));
    // Of two that are each other's opposite the training is it, where the model says so.
    let turned = |s: &Suspicion| {
        s.what == What::Sign && of_train.iter().any(|t| (t.what, &t.column) == (s.what, &s.column))
    };
    of_holdout.retain(|s| !turned(s));
    against_model(&holdout, &mut of_holdout);
    said.extend(of_train.iter().chain(&beside).chain(&of_holdout).cloned());
    let (left, rows): (Vec<Record>, Vec<Vec<usize>>) =
        train.iter().filter_map(|r| without(r, &of_train, machine)).unzip();
    left_out.extend(lines(&train, &left, &of_train));
    Doubts { said, train: left, rows, left_out, holdout, of_holdout }
}

impl Doubts {
    /// The hold-outs without what is doubted, for a model: what it does not read may be off. And what was left out.
    pub(crate) fn holdouts(&self, model: &Machine) -> (Vec<Record>, Vec<String>) {
        let left = self.holdout.iter().filter_map(|r| without(r, &self.of_holdout, model));
        let left: Vec<Record> = left.map(|(r, _)| r).collect();
        let lines = lines(&self.holdout, &left, &self.of_holdout);
        (left, lines)
    }

    /// Leaves out the training records whose clock is doubted: no lag is told by them. Whether there were any.
    pub(crate) fn without_clocks(&mut self) -> bool {
        let before = self.train.len();
        for (k, record) in std::mem::take(&mut self.train).into_iter().enumerate().rev() {
            if self.said.iter().any(|s| about(s, &record) && is_of_clock(s, &record)) {
                self.rows.remove(k);
                self.left_out.push(format!("{}: all of it ({})", record.path.display(), What::Unit));
            } else {
                self.train.insert(0, record);
            }
        }
        self.train.len() < before
    }

    /// Of the given records those that nothing is learned from, nor judged by, and why.
    pub(crate) fn unsaid(&self, train: &[Record], holdout: &[Record], model: &Machine) -> Vec<Unsaid> {
        let held = self.holdouts(model).0;
        let of = |all: &[Record], left: &[Record]| -> Vec<Unsaid> {
            let gone = all.iter().filter(|r| left.iter().all(|l| l.path != r.path));
            // What is given twice is said once.
            let own = |r: &&Record| self.said.iter().filter(|s| about(s, r)).collect::<Vec<&Suspicion>>();
            let again = |r: &&Record| own(r).iter().any(|s| s.what == What::Doubled && whole(s, r));
            let unsaid = |r: &Record| {
                let mut why: Vec<&str> = own(&r).iter().map(|s| s.what.name()).collect();
                why.dedup();
                Unsaid { record: r.path.display().to_string(), why: why.join(", ") }
            };
            gone.filter(|r| !again(r)).map(unsaid).collect()
        };
        [of(train, &self.train), of(holdout, &held)].concat()
    }

    /// More that is doubted of whole records of the training.
    pub(crate) fn also(&mut self, more: Vec<Suspicion>) {
        for (k, record) in std::mem::take(&mut self.train).into_iter().enumerate().rev() {
            match more.iter().find(|s| about(s, &record)) {
                Some(s) => {
                    self.rows.remove(k);
                    self.left_out.push(format!("{}: all of it ({})", record.path.display(), s.what.name()));
                }
                None => self.train.insert(0, record),
            }
        }
        self.said.extend(more);
    }
}

/// What is missing of the records afterwards, a line each.
fn lines(before: &[Record], after: &[Record], said: &[Suspicion]) -> Vec<String> {
    let mut out = Vec::new();
    for record in before {
        let path = record.path.display();
        let mut why: Vec<&str> = said.iter().filter(|s| about(s, record)).map(|s| s.what.name()).collect();
        why.dedup();
        let why = if why.is_empty() { "in another record".to_owned() } else { why.join(", ") };
        let Some(left) = after.iter().find(|r| r.path == record.path) else {
            out.push(format!("{path}: all of it ({why})"));
            continue;
        };
        let rows = record.rows() - left.rows();
        if rows > 0 {
            out.push(format!("{path}: {rows} of {} rows ({why})", record.rows()));
        }
        let gone = |c: &&Column| left.columns.iter().all(|o| o.name != c.name);
        out.extend(record.columns.iter().filter(gone).map(|c| format!("{path}: {} ({why})", c.name)));
    }
    out
}

/// The record without what is doubted of it; none where nothing is left that could be trusted.
fn without(record: &Record, said: &[Suspicion], machine: &Machine) -> Option<(Record, Vec<usize>)> {
    let clocked = machine.effects().any(reads_clock);
    let useless = |s: &Suspicion| whole(s, record) || clocked && is_of_clock(s, record);
    if said.iter().any(|s| about(s, record) && useless(s)) {
        return None;
    }
    let read = |name: &str| {
        let reads = |e: &Effect| {
            e.channel() == Some(name) || e.delta.as_ref().is_some_and(|d| d.sensors().any(|n| n == name))
        };
        machine.effects().any(reads)
    };
    let of_rows: Vec<Suspicion> = said.iter().filter(|s| !is_sensor(record, &s.column)).cloned().collect();
    let mut rows = plausible::unusable(&of_rows).rows(record);
    let mut sensors: Vec<&str> = Vec::new();
    for s in said.iter().filter(|s| is_sensor(record, &s.column)) {
        let (own, few) = (s.row_list(), s.is_few());
        if few && about(s, record) {
            // A few bad readings cost their rows.
            rows.extend(own);
        } else if !few && !read(&s.column) {
            // Doubted in one record, it is no cause in any.
            sensors.push(&s.column);
        } else if !few && about(s, record) {
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
    let still = |s: &&Suspicion| s.what == What::Stuck && s.rows.is_empty() && about(s, record);
    for gauge in said.iter().filter(still).map(|s| &s.column) {
        if is_one_of_several(&left, gauge) {
            left.columns.retain(|c| c.name != *gauge);
        } else if left.responses().any(|c| c.name == *gauge) {
            return None;
        }
    }
    Some((left, keep))
}

/// An effect that is as long as the clock says.
pub(crate) fn reads_clock(effect: &Effect) -> bool {
    let law = effect.description();
    law.lag.is_some() || law.heat == Heat::FromStart
}

/// The mistakes that the record and the model show together, likeliest first: each leaves far less than the record as it stands.
fn beside_the_model(record: &Record, machine: &Machine) -> Vec<Mistake> {
    if record.rows() < FEWEST || machine.effects().next().is_none() {
        return Vec::new();
    }
    let mut found: Vec<Mistake> = record.responses().flat_map(|c| of_response(record, c, machine)).collect();
    let columns = exchanged_columns(record, machine);
    found.extend(columns.map(|(pair, undone)| Mistake::new(swapped(record, &pair), undone)));
    found
}

/// So many rows that go on have to be there, and this share of them has to go the way that is logged.
const ROWS_THAT_GO: usize = 10;
const AS_TOLD: f64 = 0.9;

/// Whether an axis went from row to row the way that its direction or velocity says: then a reversal that is opposite to the model's is
/// the machine's.
fn goes_as_told(record: &Record) -> bool {
    let told = record.columns.iter().filter_map(|c| match &c.role {
        Role::Direction(axis) | Role::Velocity(axis) => Some((axis, &c.data)),
        _ => None,
    });
    told.filter_map(|(axis, way)| Some((record.data(&Role::Position(axis.clone()))?, way))).any(|(p, way)| {
        let (agree, asked) = plausible::agreement(p, way);
        asked >= ROWS_THAT_GO && agree >= AS_TOLD
    })
}

/// Those that one response shows.
fn of_response(record: &Record, c: &Column, machine: &Machine) -> Vec<Mistake> {
    let (y, s) = (centred(&c.data), simulated(record, &c.role, machine));
    let share = |by: f64, s: &[f64]| {
        let left: Vec<f64> = y.iter().zip(s).map(|(y, s)| by * y - s).collect();
        1.0 - (rms(&left) / (by * rms(&y)).abs().max(1e-300)).powi(2)
    };
    let now = share(1.0, &s);
    let told = |what: What, column: &str, text: String| Suspicion::new(record, column, what, &[], text);
    let missing: Vec<f64> = y.iter().zip(&s).map(|(y, s)| y - s).collect();
    let beside =
        |what: fn(&Role) -> bool| (beside_lines(record, &missing, what) / rms(&y).max(1e-300)).powi(2);
    let mut found = Vec::new();
    for (by, what, text) in RESPONSES {
        // A model turned into its opposite by what is missing is so by an effect of the other sign, and that leaves less.
        let opposite = by < 0.0
            && share(by, &s) > OPPOSITE
            && now < -1.0
            && 1.0 - share(by, &s) < NO_PLAINER * beside(moves);
        if opposite || share(by, &s) > ALIKE && now < UNLIKE {
            let undone = times(record, &|o: &Column| o.name == c.name, by);
            let said = told(what, &c.name, format!("it agrees with the model only {text}"));
            found.push(Mistake { said, undone, larger: by.abs() });
        }
    }
    // Where the model agrees already nothing else is looked for.
    let left = 1.0 - now;
    let better = |other: &Record| {
        let left_then = 1.0 - share(1.0, &simulated(other, &c.role, machine));
        left_then < BETTER * left && left_then < 1.0 - ALIKE
    };
    let direction = |c: &Column| matches!(c.role, Role::Direction(_) | Role::Velocity(_));
    let turned = times(record, &direction, -1.0);
    if better(&turned) && !goes_as_told(record) {
        let text = "the run agrees with the model only with the directions exchanged";
        let first = record.columns.iter().find(|c| direction(c));
        let said = told(What::Direction, first.map_or("", |c| c.name.as_str()), text.to_owned());
        found.push(Mistake::new(said, turned));
    }
    let line = beside(position);
    for (column, alone) in in_units(record) {
        let which = |c: &Column| if alone { c.name == column.name } else { position(&c.role) };
        for (by, unit) in other_units(&column.role) {
            let other = times(record, &which, *by);
            if !better(&other) {
                continue;
            }
            let then = simulated(&other, &c.role, machine);
            // A scale that is farther off than the model says is the plainer answer, but for one by just that much.
            let no_plainer = position(&column.role) && line > NO_PLAINER * (1.0 - share(1.0, &then));
            if no_plainer || !is_of_round_mm(column) && is_as_told(&y, &s, &then) {
                let (name, called) = (&column.name, &column.unit);
                let text = format!(
                    "the run agrees with the model only with {name} {by} times this: given in {unit}, called {called}?"
                );
                found.push(Mistake::new(told(What::Unit, name, text), other));
            }
        }
    }
    let sensors = exchanged(record, c, machine);
    found.extend(sensors.map(|pair| {
        let undone = with_exchanged(record, &pair[0], &pair[1]);
        Mistake::new(swapped(record, &pair), undone)
    }));
    found
}

/// What a response may be given as, how many times larger it is then, and how that is said.
const RESPONSES: [(f64, What, &str); 5] = [
    (-1.0, What::Sign, "with the other sign: nominal minus measured?"),
    (1e3, What::Unit, "1000 times as large: given in mm, called µm?"),
    (25.4, What::Unit, "25.4 times as large: given in thousandths of an inch, called µm?"),
    (25.4e3, What::Unit, "25400 times as large: given in inches, called µm?"),
    (1e-3, What::Unit, "1000 times smaller: given in nm?"),
];

fn swapped(record: &Record, [a, b]: &[String; 2]) -> Suspicion {
    let text = format!("the run agrees with the model only with {a} and {b} exchanged");
    Suspicion::new(record, a, What::Swapped, &[], text)
}

/// The columns that may be in another unit, positions all together first and then one by one (`true`: it alone).
fn in_units(record: &Record) -> Vec<(&Column, bool)> {
    let all = record.columns.iter().find(|c| position(&c.role));
    let each = record.columns.iter().filter(|c| !other_units(&c.role).is_empty());
    all.map(|c| (c, false)).into_iter().chain(each.map(|c| (c, true))).collect()
}

fn position(role: &Role) -> bool {
    matches!(role, Role::Position(_))
}

/// What an axis's place and motion give by themselves: a scale or a squareness, a reversal, a following error.
fn moves(role: &Role) -> bool {
    matches!(role, Role::Position(_) | Role::Direction(_) | Role::Velocity(_))
}

/// RMS of what straight lines over these columns leave of what the model leaves; all of it where a machine has no such lines.
fn beside_lines(record: &Record, missing: &[f64], what: fn(&Role) -> bool) -> f64 {
    let columns: Vec<&Column> = record.columns.iter().filter(|c| what(&c.role)).collect();
    let lines: Vec<Vec<f64>> = columns.iter().map(|c| centred(&c.data)).collect();
    let slopes = slopes(&lines.iter().collect::<Vec<_>>(), missing);
    if columns.iter().zip(&slopes).any(|(c, um_per_mm)| position(&c.role) && um_per_mm.abs() > STEEPEST) {
        return rms(missing);
    }
    let mut left = missing.to_vec();
    for (line, slope) in lines.iter().zip(&slopes) {
        lanes::minus(&mut left, *slope, line);
    }
    rms(&left)
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

/// The hold-outs that the better model describes far worse than the training, and no better than the model as it was, by
/// their numbers: how much of their gap is closed says nothing. `traces` are those of the hold-outs, record by record.
pub(crate) fn other_machines(holdout: &[Record], traces: &[Trace], gap: &[Gap]) -> Vec<(usize, Suspicion)> {
    let mut found = Vec::new();
    for (k, (record, own)) in holdout.iter().zip(gap::by_record(holdout, traces)).enumerate() {
        for g in gap {
            let floor = g.floor.max(g.train[1]);
            let Some([before, after]) = gap::pooled(own, &g.unit, true) else { continue };
            let worse = after > gap::WORSE * before.max(g.floor) && after > 2.0 * floor;
            if worse || (after > OTHER * floor && after > 0.7 * before) {
                let unit = if g.unit == "um" { "µm" } else { g.unit.as_str() };
                let text = format!(
                    "the model that leaves {:.2} {unit} of the training leaves {after:.2} {unit} of this hold-out: another \
                     machine, or another state of it?",
                    g.train[1]
                );
                found.push((k, Suspicion::new(record, "", What::OtherMachine, &[], text)));
                break;
            }
        }
    }
    found
}
