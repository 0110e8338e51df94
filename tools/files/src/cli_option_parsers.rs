//! Parsers of command-line options.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::time::Duration;

/// Parser of a time with its unit, or in seconds.
///
/// # Errors
/// What was expected.
pub fn duration(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().and_then(|s| Duration::try_from_secs_f64(s).ok());
    seconds
        .or_else(|| humantime::parse_duration(text).ok())
        .ok_or_else(|| "expected a time: 90 (seconds), 500ms, 90s, 5min, 1h".to_owned())
}

/// Parser of an option that takes one of a library's values.
/// Each has its name, itself, and its meaning where the name does not say it.
/// `also` are other names: each with the name that it stands for.
pub fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [(&'static str, T, &'static str)],
    also: &'static [(&'static str, &'static str)],
) -> impl TypedValueParser<Value = T> {
    let values = all.iter().map(|(name, _, meaning)| {
        let aliases = also.iter().filter(|(_, of)| of == name).map(|(alias, _)| *alias);
        PossibleValue::new(*name).aliases(aliases).help((!meaning.is_empty()).then_some(*meaning))
    });
    PossibleValuesParser::new(values).try_map(move |given| {
        let name = also.iter().find(|(alias, _)| *alias == given).map_or(given.as_str(), |(_, name)| name);
        all.iter().find(|value| value.0 == name).map(|value| value.1).ok_or("expected one of these values")
    })
}

/// Parser of a number for which a condition holds.
pub fn number(
    good: fn(f64) -> bool,
    expected: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync {
    move |text| text.parse().ok().filter(|&n| good(n)).ok_or_else(|| expected.to_owned())
}

#[cfg(test)]
mod tests {
    use super::duration;

    #[test]
    fn a_number_is_seconds() {
        let ms = |text: &str| duration(text).map(|t| t.as_millis());
        assert_eq!(["2", "2s", "0.5", "500ms", "5min"].map(ms), [2000, 2000, 500, 500, 300_000].map(Ok));
        for text in ["soon", "-1", "nan", "inf", "1e300", "", "2 parsecs"] {
            let said = ms(text).unwrap_err();
            assert!(said.starts_with("expected a time: 90 (seconds), 500ms"), "{text}: {said}");
        }
    }
}
