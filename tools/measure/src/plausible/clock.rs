//! A time column that does not begin with the run.

use rtec_model::clock::unix;
use rtec_model::record::{Record, Role};

/// What to know of a record whose clock counts from elsewhere than its run's start.
pub(super) fn absolute(record: &Record) -> Option<String> {
    let first = *record.data(&Role::Time)?.first()?;
    let (unit, day) = unix(first)?;
    let name = record.columns.iter().find(|c| c.role == Role::Time).map_or("time", |c| c.name.as_str());
    Some(format!(
        "{}: {name} begins at {first}: Unix time in {unit} ({day}); warm_up and lost_counts take 0 for the run's start: subtract the \
         first time from all, or let `characterise import --format csv --columns {name}=time:{unit},…` do it",
        record.path.display()
    ))
}
