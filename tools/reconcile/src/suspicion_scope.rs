//! The subject of a suspicion: a record, a column, the clock.

use rtec_measure::plausible::{MistakeKind, Suspicion};
use rtec_model::record::{Column, Record, Role};

/// Whether the suspicion is about this record.
pub(crate) fn about(s: &Suspicion, record: &Record) -> bool {
    s.record == record.path.display().to_string()
}

/// Whether a column of this name is a sensor's.
pub(crate) fn is_sensor(record: &Record, name: &str) -> bool {
    let sensor = |c: &Column| c.name == name && matches!(c.role, Role::Temperature | Role::Channel);
    record.columns.iter().any(sensor)
}

/// Whether a record without a constant column has no information left.
/// The column is then neither a sensor nor one of several errors.
fn is_dead(record: &Record, name: &str) -> bool {
    !is_sensor(record, name) && !is_one_of_several(record, name)
}

/// Whether the column is a response, and there are other responses.
pub(crate) fn is_one_of_several(record: &Record, name: &str) -> bool {
    record.responses().any(|c| c.name == name) && record.responses().any(|c| c.name != name)
}

/// Whether it doubts the unit of the record's time.
pub(crate) fn is_of_clock(s: &Suspicion, record: &Record) -> bool {
    let time = |c: &Column| c.name == s.column && c.role == Role::Time;
    s.what == MistakeKind::Unit && record.columns.iter().any(time)
}

/// Whether it is about the whole record, whose meaning is then unknown.
pub(crate) fn whole(s: &Suspicion, record: &Record) -> bool {
    match s.what {
        // A wrong unit of time leaves positions, sensors and errors valid. Only lags depend on it.
        MistakeKind::Unit if is_of_clock(s, record) => false,
        MistakeKind::Unit | MistakeKind::Sign | MistakeKind::Direction | MistakeKind::OtherMachine => {
            !is_sensor(record, &s.column)
        }
        MistakeKind::Swapped => true,
        // A gauge that was never read has no error to explain.
        MistakeKind::Stuck => s.rows.is_empty() && is_dead(record, &s.column),
        MistakeKind::Doubled => s.column.is_empty() && s.rows.is_empty(),
        MistakeKind::Range => !is_sensor(record, &s.column) && s.rows.is_empty(),
        _ => false,
    }
}
