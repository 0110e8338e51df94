//! The loop of NISTIR 4854: a nose turned and probed.

use super::runs::{Done, ExperimentRun, SUFFIXES, digits, seed_of};
use crate::turning_experiment::TurningExperimentInputs;
use rtec_files::InputError;
use rtec_model::record::{Record, Role, RunKind, span};
use serde_json::{Map, Value, json};
use std::path::Path;

/// A probing session as a record of the part.
/// Rows have the angle and, last, the radial error. Time, position and temperatures are those at the end,
/// because the position at each trip adds nothing to the angle.
fn part_record(session: Record, path: &Path) -> Result<Record, InputError> {
    let mut columns = session.columns;
    columns.sort_by_key(|c| match c.role {
        Role::Time | Role::Position(_) | Role::Direction(_) => 0,
        Role::Temperature => 1,
        _ => 2,
    });
    for column in &mut columns {
        let last = column.data.last().copied().unwrap_or(0.0);
        let per = if matches!(column.role, Role::Error(_)) { 1e4 } else { 1e9 };
        for v in &mut column.data {
            *v = match column.role {
                Role::Angle | Role::Error(_) => digits(*v, per),
                _ => digits(last, 1e6),
            };
        }
        if matches!(column.role, Role::Error(_)) {
            "e_r".clone_into(&mut column.name);
        }
    }
    Record::new(path, RunKind::Probing, columns)
}

/// The loop of NISTIR 4854 without and with correction.
/// It corrects by the known form of the part, or otherwise by the errors probed after the semi-finish cut.
pub(super) fn hemisphere(experiment: &mut ExperimentRun<'_>) -> Done {
    let setting = experiment.setting;
    let setup = TurningExperimentInputs {
        machine: setting.truth.clone(),
        design: "c".to_owned(),
        ..TurningExperimentInputs::default()
    };
    let (mut records, mut figures) = (Vec::new(), Map::new());
    let knows = std::iter::once(None).chain(setting.known.map(Some));
    for ((suffix, label), known) in SUFFIXES.into_iter().zip(["without", "with"]).zip(knows) {
        let seed = seed_of(setting, &format!("hemisphere{suffix}"));
        let setup = TurningExperimentInputs { model: known.cloned(), seed, ..setup.clone() };
        let turned = setup.turn_nose(!suffix.is_empty())?;
        let path = setting.out.join(format!("hemisphere{suffix}.run.toml"));
        // Only a session with all its trips has a record.
        let Some(record) = turned.record else { continue };
        let record = part_record(record, &path)?;
        let errors = record.responses().flat_map(|c| c.data.iter());
        let [lo, hi] = span(errors);
        figures.insert(format!("form_{label}_um"), json!(digits(hi - lo, 1e3)));
        let angles =
            record.columns.iter().find(|c| c.role == Role::Angle).map_or_else(Vec::new, |c| c.data.clone());
        records.push((record, angles));
    }
    experiment.publish_records("hemisphere", records, "angle from Z, rad")?;
    experiment.findings.summary.insert("form".to_owned(), Value::Object(figures));
    Ok(())
}
