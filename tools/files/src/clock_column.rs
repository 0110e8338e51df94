//! Reads clocks whose zero is not the start of the run.
//! Times are in ISO 8601, as a German spreadsheet writes them, times of the day, or Unix times.

use crate::date;

/// The length of a day, ns.
pub const DAY_NS: i128 = 86_400_000_000_000;

/// Whether the first number of a date with slashes is the day or the month.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlashDateOrder {
    /// `13/8/2022`.
    DayFirst,
    /// `8/13/2022`.
    MonthFirst,
}

/// Nanoseconds since 1970-01-01 UTC of a date with its time of the day.
///
/// It is in ISO 8601, `20260304T101530Z`, `2022/8/13 10:23:57`, `23.1.2021 10:23:57` or `23.1.21 10:23` (day,
/// month, year), or with the month's name, `04-Mar-2026 10:15:30`. A date that ends with its year after
/// slashes or dashes has two readings. The first value has the day first, the second the month.
pub fn absolute_ns(text: &str) -> [Option<i128>; 2] {
    if let Some(ns) = iso8601_ns(text).or_else(|| basic_ns(text)) {
        return [Some(ns); 2];
    }
    let read = || {
        let (date, clock) = clock_behind_date(text.trim())?;
        let clock = clock_of_24_hours(clock)?;
        Some(days_of(date)?.map(|day| iso8601_ns(&format!("{}T{clock}", day?))))
    };
    read().unwrap_or_default()
}

/// Splits a text into a date and the time of the day after it.
/// The time begins with the hour before the first `:` or `h`.
fn clock_behind_date(text: &str) -> Option<(&str, &str)> {
    let is_digit = |c: char| c.is_ascii_digit();
    let mark = text.match_indices([':', 'h']).map(|(at, _)| at).find(|at| text[..*at].ends_with(is_digit))?;
    let (date, clock) = text.split_at(text[..mark].trim_end_matches(is_digit).len());
    date.ends_with([' ', ',', 'T', '_']).then(|| (date.trim_end_matches([' ', ',', 'T', '_']), clock))
}

/// English and German months, by the beginnings of their names.
const MONTHS: &str = "jan feb mar/m\u{e4}r/mrz apr may/mai jun jul aug sep oct/okt nov dec/dez";

/// The number of a month from its name, from 1.
fn month_of(name: &str) -> Option<usize> {
    let name = name.to_lowercase();
    MONTHS.split(' ').position(|of| of.split('/').any(|begin| name.starts_with(begin))).map(|place| place + 1)
}

/// A date in ISO 8601: read with the day first, and with the month first.
fn days_of(date: &str) -> Option<[Option<String>; 2]> {
    let parts: Vec<&str> = date.split(['/', '.', '-', ' ', ',']).filter(|part| !part.is_empty()).collect();
    // A weekday may precede the date.
    let parts =
        if parts.len() == 4 && parts[0].chars().all(char::is_alphabetic) { &parts[1..] } else { &parts[..] };
    let [first, second, third] = *parts else { return None };
    let day = |year: &str, month: &str, day: &str, short: bool| {
        // A year of two digits is of this century, because no log of a machine tool here is older.
        let year = if short && year.len() == 2 { format!("20{year}") } else { year.to_owned() };
        (year.len() == 4).then(|| format!("{year}-{month:0>2}-{day:0>2}"))
    };
    let one = |found: Option<String>| Some([found.clone(), found]);
    if let Some(at) = parts.iter().position(|part| part.starts_with(char::is_alphabetic)) {
        let month = month_of(parts[at])?.to_string();
        let (own, year) = match (at, first.len()) {
            (0, _) => (second, third),
            (1, 4) => (third, first),
            (1, _) => (first, third),
            _ => return None,
        };
        return one(day(year, &month, own, true));
    }
    match (date.chars().find(|c| !c.is_ascii_digit())?, first.len()) {
        (_, 4) => one(day(first, second, third, false)),
        ('.', _) => one(day(third, second, first, true)),
        ('/' | '-', _) => Some([day(third, second, first, false), day(third, first, second, false)]),
        _ => None,
    }
}

/// Reads ISO 8601 without dashes and colons, `20260304T101530.25Z`.
fn basic_ns(text: &str) -> Option<i128> {
    let (day, clock) = text.trim().split_once('T').filter(|(day, _)| day.len() == 8 && day.is_ascii())?;
    let digits = clock.find(|c: char| !c.is_ascii_digit()).unwrap_or(clock.len());
    let (clock, rest) = clock.split_at(digits);
    let seconds = match digits {
        4 => String::new(),
        6 => format!(":{}", &clock[4..]),
        _ => return None,
    };
    let (year, month, day) = (&day[..4], &day[4..6], &day[6..]);
    iso8601_ns(&format!("{year}-{month}-{day}T{}:{}{seconds}{rest}", &clock[..2], &clock[2..4]))
}

/// The order of dates with slashes, if one of them has a day above 12.
pub fn slash_order<'t>(texts: impl IntoIterator<Item = &'t str>) -> Option<SlashDateOrder> {
    // A date may have a column of its own.
    let of =
        |text: &str| if is_day(text) { absolute_ns(&format!("{text} 00:00:00")) } else { absolute_ns(text) };
    texts.into_iter().find_map(|text| match of(text) {
        [Some(_), None] => Some(SlashDateOrder::DayFirst),
        [None, Some(_)] => Some(SlashDateOrder::MonthFirst),
        _ => None,
    })
}

/// A time of the day in the form of the 24-hour clock, `HH:MM:SS`.
/// `9:05:07 PM` gives 21:05:07, `14h05` 14:05, and `10:00:00:123` 10:00:00.123.
fn clock_of_24_hours(text: &str) -> Option<String> {
    let text = text.trim();
    let two_digits =
        |text: &str| if text.find(':') == Some(1) { format!("0{text}") } else { text.to_owned() };
    if text.contains('h') {
        let colons = text.replace(['h', 'm'], ":").replace("in", "");
        return Some(two_digits(colons.trim_end_matches(['s', ':', ' '])));
    }
    if let Some((clock, thousandths)) =
        text.rsplit_once(':').filter(|(clock, _)| clock.matches(':').count() == 2)
    {
        let is_fraction = matches!(thousandths.len(), 3 | 6 | 9);
        return is_fraction
            .then(|| two_digits(&format!("{clock}.{thousandths}")))
            .filter(|_| !has_zone(clock));
    }
    let Some((clock, half)) = text.split_once(' ') else { return Some(two_digits(text)) };
    let clock = two_digits(clock);
    let hour = clock.get(..2)?.parse::<u32>().ok().filter(|hour| (1..=12).contains(hour))? % 12;
    let hour = match half.trim().replace('.', "").to_ascii_uppercase().as_str() {
        "AM" => hour,
        "PM" => hour + 12,
        _ => return None,
    };
    Some(format!("{hour:02}{}", &clock[2..]))
}

/// A column of dates or of times of the day: nanoseconds since its first row.
/// Times of the day continue past midnight.
#[derive(Debug, Default)]
pub struct ClockColumn {
    /// The first row's time as written, and in both readings of [`absolute_ns`].
    /// A reading is dropped when a row rules it out.
    start: Option<([Option<i128>; 2], String)>,
    /// For times of the day: midnights so far, and the last time.
    of_day: Option<(i128, i128)>,
    order: Option<SlashDateOrder>,
}

impl ClockColumn {
    /// A column whose dates have this order of day and month.
    pub fn of_order(order: Option<SlashDateOrder>) -> Self {
        Self { order, ..Self::default() }
    }

    /// Nanoseconds from the first time to this one.
    /// `None` if its form differs from the first one's, or if it has two readings that no row decides.
    pub fn since_start(&mut self, text: &str) -> Option<i128> {
        if self.start.is_none() {
            let mut first = self.read(text);
            if first == [None; 2] {
                let ns = of_day_ns(text)?;
                (self.of_day, first) = (Some((0, ns)), [Some(ns); 2]);
            }
            self.start = Some((first, text.trim().to_owned()));
            return Some(0);
        }
        let now = match &mut self.of_day {
            Some((days, last_ns)) => {
                let ns = of_day_ns(text)?;
                // A step from late evening to early morning passes midnight. Any other step back is an error.
                if ns + DAY_NS / 2 < *last_ns {
                    *days += 1;
                }
                *last_ns = ns;
                [Some(*days * DAY_NS + ns); 2]
            }
            None => self.read(text),
        };
        let (start, _) = self.start.as_mut()?;
        let since = [0, 1].map(|n| Some(now[n]? - start[n]?));
        match since {
            [Some(a), Some(b)] => (a == b).then_some(a),
            [None, None] => None,
            [a, b] => {
                // What this time cannot be read as was not meant by the first either.
                *start = [0, 1].map(|n| start[n].filter(|_| since[n].is_some()));
                a.or(b)
            }
        }
    }

    fn read(&self, text: &str) -> [Option<i128>; 2] {
        let [day_first, month_first] = absolute_ns(text);
        match self.order {
            None => [day_first, month_first],
            Some(SlashDateOrder::DayFirst) => [day_first; 2],
            Some(SlashDateOrder::MonthFirst) => [month_first; 2],
        }
    }

    /// Nanoseconds since 1970-01-01 UTC of a date.
    /// For a time of the day: since midnight before the first row.
    /// `None` as in [`ClockColumn::since_start`], and if the first row's day has two readings.
    pub fn absolute(&mut self, text: &str) -> Option<i128> {
        let since = self.since_start(text)?;
        let (start, _) = self.start.as_ref()?;
        Some(only(*start)? + since)
    }

    /// The first time, as the file has it.
    pub fn start(&self) -> Option<&str> {
        self.start.as_ref().map(|(_, text)| text.as_str())
    }

    /// The first row's day, if the column has dates with one reading.
    pub fn first_day(&self) -> Option<String> {
        let (start, _) = self.start.as_ref().filter(|_| self.of_day.is_none())?;
        only(*start).map(day)
    }
}

/// The one reading of a time that has two at most.
fn only([one, other]: [Option<i128>; 2]) -> Option<i128> {
    if one.is_some() && other.is_some() && one != other { None } else { one.or(other) }
}

/// What to write instead of a cell that resembles a time but cannot be read.
pub fn expected_instead(text: &str) -> Option<&'static str> {
    if has_two_days(text) {
        return Some(
            "a time as ISO 8601 writes it, 2022-08-08T13:51:37.25Z, or a number: 08/07/2022 is a day of July or of August, and no \
             day above 12 tells which",
        );
    }
    if is_day(text) {
        return Some(
            "a time of the day too: where it has a column of its own, both columns are the time: Date=time,Time=time",
        );
    }
    let is_part = |c: char| c.is_ascii_digit() || ":/.-+ TZtzAPMapm,".contains(c);
    let is_clock = text.contains([':', '/'])
        && text.starts_with(|c: char| c.is_ascii_digit())
        && text.chars().all(is_part);
    is_clock.then_some(if text.contains('/') {
        "a time as ISO 8601 writes it, 2022-08-08T13:51:37.25Z, or a number; a date with slashes has a year of four digits"
    } else {
        "a time as ISO 8601 writes it, 2022-08-08T13:51:37.25Z, or a number"
    })
}

/// Whether a time names its zone: Z, or an offset after the time.
pub fn has_zone(text: &str) -> bool {
    let clock = text.trim().split_once(['T', 't', ' ']).map_or(text, |(_, clock)| clock);
    clock.contains(['Z', 'z', '+', '-'])
}

/// Nanoseconds since midnight of a time without a day, `13:51:37.25`.
/// The hour 24 is allowed, because some clocks use it for the first hour of the next day.
pub fn of_day_ns(text: &str) -> Option<i128> {
    iso8601_ns(&format!("1970-01-01T{}Z", clock_of_24_hours(text)?))
}

/// Whether a text is a date without a time of the day.
/// Such a date may have a column of its own.
pub fn is_day(text: &str) -> bool {
    absolute_ns(&format!("{} 00:00:00", text.trim())) != [None; 2]
}

/// Whether a date ends with its year, so that day or month may be first.
pub fn has_two_days(text: &str) -> bool {
    let read = absolute_ns(text);
    read[0] != read[1] || text.contains('/') && read != [None; 2]
}

/// Nanoseconds since 1970-01-01 UTC of `2022-08-08T13:51:37.2515150Z`.
///
/// A blank may replace the T. The time ends with Z, an offset or nothing (UTC), and has up to nine decimals
/// of a second.
pub fn iso8601_ns(text: &str) -> Option<i128> {
    let text = text.trim();
    let (day, clock) = text.split_once(['T', 't', ' '])?;
    let days = date::parse(day)?;
    let (clock, offset_min) = match clock.rfind(['Z', 'z', '+', '-']) {
        None => (clock, 0),
        Some(at) => {
            let (clock, zone) = clock.split_at(at);
            (clock, offset(zone)?)
        }
    };
    let mut parts = clock.split(':');
    let (hour, minute) = (digits(parts.next()?, 2)?, digits(parts.next()?, 2)?);
    let (second, ns) = match parts.next() {
        None => (0, 0),
        Some(seconds) => match seconds.split_once(['.', ',']) {
            None => (digits(seconds, 2)?, 0),
            Some((whole, fraction)) => {
                let n = fraction.len();
                let value = if n <= 9 { digits(fraction, n)? } else { return None };
                (digits(whole, 2)?, value * 10i128.pow(9 - n as u32))
            }
        },
    };
    if parts.next().is_some() || hour > 24 || minute > 59 || second > 60 {
        return None;
    }
    let minutes = i128::from(days) * 1440 + hour * 60 + minute - offset_min;
    Some(minutes * (DAY_NS / 1440) + second * 1_000_000_000 + ns)
}

/// Units of a clock, each with its number per second.
const UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)];

/// From 2000 to 2100, s since 1970.
/// A machine's own counter has never run for thirty years.
const UNIX_S: [f64; 2] = [946_684_800.0, 4_102_444_800.0];

/// Seconds from 1904-01-01, the zero of `LabVIEW`, to 1970-01-01.
/// Old Macintoshes have the same zero.
const SINCE_1904_S: f64 = 2_082_844_800.0;

/// Steps of Windows' FILETIME in a second.
const FILETIME_PER_S: f64 = 1e7;
/// Time from the zero of FILETIME, 1601-01-01, to 1970-01-01, s.
const FILETIME_ZERO_S: f64 = 11_644_473_600.0;

/// From 2000 to 2100, days since 1899-12-30, the zero of spreadsheets.
const SPREADSHEET_D: [f64; 2] = [36_526.0, 73_051.0];
/// Days from 1899-12-30 to 1970-01-01.
const SPREADSHEET_ZERO_D: f64 = 25_569.0;

/// A time counted from a zero long before the run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpochTime {
    /// The unit that it is counted in.
    pub unit: &'static str,
    /// The kind of clock that counts like this.
    pub what: &'static str,
    /// The day, as 2026-01-06.
    pub day: String,
}

/// Recognises a time counted from a zero long before the run.
/// It is a Unix time between 2000 and 2100 in any unit, or Windows' FILETIME of those years. It may also be
/// seconds since 1904 if the same number as a Unix time is still in the future. `None` for any other number.
pub fn recognise_epoch_time(time: f64) -> Option<EpochTime> {
    let Some((unit, day)) = unix(time) else { return filetime(time) };
    let since_1904 = time - SINCE_1904_S;
    let is_to_come = date::parse(&day)? > date::today() + 1;
    if unit == "s" && is_to_come && since_1904 >= UNIX_S[0] {
        let day = date::format((since_1904 / 86_400.0).floor() as i64);
        return Some(EpochTime { unit, what: "seconds since 1904", day });
    }
    Some(EpochTime { unit, what: "Unix time", day })
}

/// Windows' FILETIME between 2000 and 2100: steps of 100 ns since 1601.
pub fn filetime(time: f64) -> Option<EpochTime> {
    let unix_s = time / FILETIME_PER_S - FILETIME_ZERO_S;
    let day = || date::format((unix_s / 86_400.0).floor() as i64);
    let is_date = (UNIX_S[0]..UNIX_S[1]).contains(&unix_s);
    is_date.then(|| EpochTime { unit: "100ns", what: "Windows FILETIME", day: day() })
}

/// A spreadsheet's date between 2000 and 2100: days since 1899-12-30.
pub fn spreadsheet(time_d: f64) -> Option<EpochTime> {
    let is_date = (SPREADSHEET_D[0]..SPREADSHEET_D[1]).contains(&time_d);
    let day = || date::format((time_d - SPREADSHEET_ZERO_D).floor() as i64);
    is_date.then(|| EpochTime { unit: "d", what: "a spreadsheet's date", day: day() })
}

/// The day of times in seconds that are really dates of a spreadsheet.
///
/// They are from 2000 to 2100, span less than two months, and have more decimals than a clock in seconds.
pub fn spreadsheet_in_s(times: &[f64]) -> Option<String> {
    let (first, last) = (*times.first()?, *times.last()?);
    let fine = times.iter().filter(|t| ((*t * 1e4).round() - *t * 1e4).abs() > 1e-3).count();
    let dates = last - first < 60.0 && times.len() > 2 && 2 * fine > times.len();
    spreadsheet(first).filter(|_| dates).map(|c| c.day)
}

/// The unit of a Unix time between 2000 and 2100, and its day.
/// `None` for any other number.
pub fn unix(time: f64) -> Option<(&'static str, String)> {
    let (unit, per_s) = UNITS.into_iter().find(|(_, per_s)| {
        let s = time / per_s;
        (UNIX_S[0]..UNIX_S[1]).contains(&s)
    })?;
    Some((unit, date::format((time / per_s / 86_400.0).floor() as i64)))
}

fn digits(text: &str, n: usize) -> Option<i128> {
    (n > 0 && text.len() == n && text.bytes().all(|b| b.is_ascii_digit())).then(|| text.parse().ok())?
}

fn offset(zone: &str) -> Option<i128> {
    if zone.eq_ignore_ascii_case("z") {
        return Some(0);
    }
    let (sign, rest) = (if zone.starts_with('-') { -1 } else { 1 }, zone.get(1..)?);
    let (hours, minutes) = match rest.split_once(':') {
        Some((h, m)) => (digits(h, 2)?, digits(m, 2)?),
        None if rest.len() == 4 => (digits(rest.get(..2)?, 2)?, digits(rest.get(2..)?, 2)?),
        None => (digits(rest, 2)?, 0),
    };
    (hours <= 18 && minutes < 60).then_some(sign * (60 * hours + minutes))
}

/// The day of a time, as 2022-08-08.
pub fn day(ns: i128) -> String {
    date::format(ns.div_euclid(DAY_NS) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_as_other_programs_count_them() {
        // date -u -d TIME +%s%N
        for (text, ns) in [
            ("2022-08-08T13:51:37.2515150Z", Some(1_659_966_697_251_515_000)),
            ("2022-08-08T13:51:37Z", Some(1_659_966_697_000_000_000)),
            ("2022-08-08 15:51:37+02:00", Some(1_659_966_697_000_000_000)),
            ("2022-08-08T09:21:37.5-0430", Some(1_659_966_697_500_000_000)),
            ("1970-01-01T00:00", Some(0)),
            ("1969-12-31T23:59:59.999999999Z", Some(-1)),
            ("2024-02-29T12:00:00,25", Some(1_709_208_000_250_000_000)),
            ("2023-02-29T12:00:00", None),
            ("2022-08-08", None),
            ("2022-08-08T1:51:37", Some(1_659_923_497_000_000_000)),
            ("2022-08-08T13:61:37", None),
            ("2022-08-08T13:51:37.Z", None),
            ("2022-08-08T13:51:37.1234567890Z", None),
            ("2022-08-08T13:51:37+2", None),
            ("2022-08-08T13:51:37+1é1", None),
            ("8.8.2022 13:51:37", Some(1_659_966_697_000_000_000)),
            ("08.08.2022 9:21:37,5", Some(1_659_950_497_500_000_000)),
            ("31.2.2022 13:51:37", None),
            ("8.8.22 13:51:37", Some(1_659_966_697_000_000_000)),
            ("20220808T135137Z", Some(1_659_966_697_000_000_000)),
            ("20220808T155137.5+0200", Some(1_659_966_697_500_000_000)),
            ("08-Aug-2022 13:51:37", Some(1_659_966_697_000_000_000)),
            ("8 August 2022 1:51:37 p.m.", Some(1_659_966_697_000_000_000)),
            ("Mon Aug 8, 2022 13:51:37", Some(1_659_966_697_000_000_000)),
            ("8. Aug. 22, 13:51:37", Some(1_659_966_697_000_000_000)),
            ("08.08.2022, 13:51:37", Some(1_659_966_697_000_000_000)),
            ("2022-08-08_13:51:37", Some(1_659_966_697_000_000_000)),
            ("2022-08-08 13:51:37:250", Some(1_659_966_697_250_000_000)),
            ("8/8/2022 13:51:37:250", Some(1_659_966_697_250_000_000)),
            ("08-08-2022 13:51:37", Some(1_659_966_697_000_000_000)),
            ("08.08.2022 13h51", Some(1_659_966_660_000_000_000)),
            ("08.08.2022 13h51m37s", Some(1_659_966_697_000_000_000)),
            ("8/8/22 13:51:37", None),
            ("08-Foo-2022 13:51:37", None),
            ("10:00:00:12", None),
            ("2022080T135137Z", None),
            ("x1 Probe 3h2", None),
            ("2022/8/8 13:51:37", Some(1_659_966_697_000_000_000)),
            ("8.8.2022 1:51:37 PM", Some(1_659_966_697_000_000_000)),
            ("8.8.2022 13:51:37 PM", None),
            ("8.8.2022 12:00:00 AM", Some(1_659_916_800_000_000_000)),
            ("12.5", None),
            ("é2022-08-08T1", None),
        ] {
            assert_eq!(absolute_ns(text), [ns; 2], "{text}");
        }
        assert_eq!(of_day_ns("9:21:37.5"), Some(33_697_500_000_000));
        assert_eq!(of_day_ns("13:51:37Z"), None);
        assert_eq!(of_day_ns("24:00:00.5"), Some(DAY_NS + 500_000_000));
        assert_eq!(of_day_ns("14h05"), Some(50_700_000_000_000));
        assert_eq!(of_day_ns("10:00:00:123"), Some(36_000_123_000_000));
        assert!(is_day("04-Mar-2026") && is_day("4.3.26") && !is_day("10:00:00") && !is_day("12.5"));
        assert_eq!(day(1_659_966_697_251_515_000), "2022-08-08");
        assert_eq!(day(-1), "1969-12-31");
        assert!(has_zone("2022-08-08T13:51:37Z") && has_zone("2022-08-08 15:51:37+02:00"));
        assert!(!has_zone("2022-08-08 15:51:37") && !has_zone("15:51:37"));
    }

    #[test]
    fn slashes_are_read_where_one_reading_is_left() {
        let seconds = |texts: &[&str]| {
            let mut moments = ClockColumn::default();
            let read = texts.iter().map(|t| moments.since_start(t).map(|ns| ns / 1_000_000_000)).collect();
            (read, moments.first_day())
        };
        // Python's datetime gives the differences. Within one day both readings give the same.
        for (texts, wants, day) in [
            (["08/07/2022 10:00:00", "08/07/2022 10:00:10"], [Some(0), Some(10)], None),
            (["12/08/2022 23:59:50", "13/08/2022 00:00:00"], [Some(0), Some(10)], Some("2022-08-12")),
            (["8/12/2022 11:59:50 PM", "8/13/2022 12:00:00 AM"], [Some(0), Some(10)], Some("2022-08-12")),
            (["13/8/2022 10:00:00", "1/9/2022 10:00:00"], [Some(0), Some(19 * 86_400)], Some("2022-08-13")),
            (["8/8/2022 10:00:00", "8/8/2022 10:01:00"], [Some(0), Some(60)], Some("2022-08-08")),
            (["08/07/2022 23:59:50", "08/08/2022 00:00:00"], [Some(0), None], None),
            (["13/13/2022 10:00:00", "8/8/2022 10:01:00"], [None, Some(0)], Some("2022-08-08")),
        ] {
            assert_eq!(seconds(&texts), (wants.to_vec(), day.map(str::to_owned)), "{texts:?}");
        }
        // The whole column decides the reading that its first days leave open.
        let column = ["08/11/2022 10:00:00", "08/12/2022 10:00:00", "08/13/2022 10:00:00"];
        let mut moments = ClockColumn::of_order(slash_order(column));
        let days: Vec<_> = column.iter().map(|t| moments.since_start(t).map(|ns| ns / DAY_NS)).collect();
        assert_eq!(days, [Some(0), Some(1), Some(2)]);
        assert_eq!(slash_order(["08/11/2022 10:00:00", "08/12/2022 10:00:00"]), None);
    }

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

    #[test]
    fn knows_seconds_since_1904_and_spreadsheet_dates() {
        // datetime(1904, 1, 1) + timedelta(seconds=3840000000); datetime(1899, 12, 30) + timedelta(45963.5)
        let since_1904 = recognise_epoch_time(3_840_000_000.0).unwrap();
        assert_eq!((since_1904.what, since_1904.day.as_str()), ("seconds since 1904", "2025-09-06"));
        assert_eq!(recognise_epoch_time(1_767_700_000.0).unwrap().what, "Unix time");
        assert_eq!(spreadsheet(45_963.5).unwrap().day, "2025-11-02");
        // (datetime(2025, 11, 2) - datetime(1601, 1, 1)) / timedelta(microseconds=1) * 10
        let windows = recognise_epoch_time(134_065_152_000_000_000.0).unwrap();
        assert_eq!(
            (windows.what, windows.unit, windows.day.as_str()),
            ("Windows FILETIME", "100ns", "2025-11-02")
        );
        assert_eq!((filetime(1.7677e15), filetime(1.7677e18)), (None, None));
        let ten_seconds = |i: i32| 45_963.5 + f64::from(i) * 10.0 / 86_400.0;
        let dates: Vec<f64> = (0..5).map(ten_seconds).collect();
        assert_eq!(spreadsheet_in_s(&dates).as_deref(), Some("2025-11-02"));
        let seconds: Vec<f64> = (0..5).map(|i| 45_963.5 + 0.01 * f64::from(i)).collect();
        assert_eq!(spreadsheet_in_s(&seconds), None);
    }
}
