//! A time column that does not begin with the run.

use rtec_model::date;
use rtec_model::record::{Record, Role};

/// Units of a clock, and how many make a second.
const UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)];

/// From 2000 to 2100, s since 1970: no counter of a machine's own has run for thirty years.
const UNIX_S: [f64; 2] = [946_684_800.0, 4_102_444_800.0];

/// The unit of a Unix time between 2000 and 2100, and its day; `None` for what is none.
pub(crate) fn unix(time: f64) -> Option<(&'static str, String)> {
    let (unit, per_s) = UNITS.into_iter().find(|(_, per_s)| {
        let s = time / per_s;
        (UNIX_S[0]..UNIX_S[1]).contains(&s)
    })?;
    Some((unit, date::format((time / per_s / 86_400.0).floor() as i64)))
}

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

#[cfg(test)]
mod tests {
    use super::unix;

    #[test]
    fn knows_unix_times_and_no_others() {
        for (time, unit) in [
            (1_767_700_000.0, Some("s")),
            (1_767_700_000_123.0, Some("ms")),
            (1.7677e15, Some("us")),
            (1.7677e18, Some("ns")),
            (0.0, None),
            (86_400.0 * 365.0, None),
            (-1.7677e9, None),
            (1e10, None),
        ] {
            assert_eq!(unix(time).map(|u| u.0), unit, "{time}");
        }
        assert_eq!(unix(1_767_700_000.0).unwrap().1, "2026-01-06");
    }
}
