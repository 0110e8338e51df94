//! Calendar days: ISO 8601 and days since 1970-01-01.

/// Days since 1970-01-01 of a day in ISO 8601 (`2026-05-01`).
/// `None` if the text is not a day.
pub fn parse(text: &str) -> Option<i64> {
    let (head, tail) = (text.get(..10)?, text.get(10..)?);
    if !(tail.is_empty() || tail.starts_with(['T', ' '])) {
        return None;
    }
    let mut parts = head.splitn(3, '-');
    let (y, m, d) = (parts.next()?, parts.next()?, parts.next()?);
    let (y, m, d): (i64, i64, i64) = (y.parse().ok()?, m.parse().ok()?, d.parse().ok()?);
    // Civil from days and back (proleptic Gregorian calendar, years that start in March).
    let shifted = if m <= 2 { y - 1 } else { y };
    let era = shifted.div_euclid(400);
    let of_era = shifted.rem_euclid(400);
    let of_year = (153 * ((m + 9) % 12) + 2) / 5 + d - 1;
    let days = era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468;
    (format(days) == head).then_some(days)
}

/// A day as ISO 8601, from days since 1970-01-01.
pub fn format(days: i64) -> String {
    let z = days + 719_468;
    let era = z.div_euclid(146_097);
    let of_era = z.rem_euclid(146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = era * 400 + year + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

/// Today (UTC) in days since 1970-01-01.
pub fn today() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.map_or(0, |d| (d.as_secs() / 86_400) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_and_dates() {
        for (text, days) in
            [("1970-01-01", 0), ("2000-02-29", 11_016), ("2026-11-21", 20_778), ("1969-12-31", -1)]
        {
            assert_eq!((parse(text), format(days).as_str()), (Some(days), text));
        }
        assert_eq!(parse("2026-05-01T12:00:00"), parse("2026-05-01"));
        for bad in ["", "2026-02-30", "2026-13-01", "01.05.2026", "2026-05-01x", "2026-5-1"] {
            assert_eq!(parse(bad), None, "{bad}");
        }
        for d in -200_000..200_000 {
            assert_eq!(parse(&format(d)), (format(d).len() == 10).then_some(d));
        }
    }
}
