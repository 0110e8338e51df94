//! A time column that does not begin with the run.

use rtec_files::clock_column::{EpochTime, recognise_epoch_time, spreadsheet_in_s};
use rtec_model::record::{Record, Role};

/// Warning if the time is the same in every row.
pub(super) fn stands_still(record: &Record) -> Option<String> {
    let times = record.data(&Role::Time).filter(|times| times.len() > 2)?;
    times.windows(2).all(|w| w[0].to_bits() == w[1].to_bits()).then(|| {
        format!(
            "{}: the time is the same in every row: a date whose time of the day was cut off, or too few decimals? Times are written with \
             them, or the column is left out",
            record.path.display()
        )
    })
}

/// Warning if the time does not count from the run's start.
pub(super) fn absolute(record: &Record) -> Option<String> {
    let times = record.data(&Role::Time)?;
    let first = *times.first()?;
    let name = record.columns.iter().find(|c| c.role == Role::Time).map_or("time", |c| c.name.as_str());
    if let Some(day) = spreadsheet_in_s(times) {
        return Some(format!(
            "{}: {name} begins at {first} s: a spreadsheet's date ({day}) in days? `characterise import --format csv --columns \
             {name}=time:d,…` takes those",
            record.path.display()
        ));
    }
    let EpochTime { unit, what, day } = recognise_epoch_time(first)?;
    let what = match unit {
        "100ns" => format!("{what}, steps of 100 ns"),
        _ if what == "Unix time" => format!("{what} in {unit}"),
        _ => what.to_owned(),
    };
    Some(format!(
        "{}: {name} begins at {first}: {what} ({day}); warm_up and lost_counts take 0 for the run's start: subtract the \
         first time from all, or let `characterise import --format csv --columns {name}=time:{unit},…` do it",
        record.path.display()
    ))
}
