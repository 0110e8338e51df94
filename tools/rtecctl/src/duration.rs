//! Times on the command line.

use std::time::Duration;

/// A time with its unit, or in seconds.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().and_then(|s| Duration::try_from_secs_f64(s).ok());
    seconds
        .or_else(|| humantime::parse_duration(text).ok())
        .ok_or_else(|| "expected a time: 90 (seconds), 500ms, 90s, 5min, 1h".to_owned())
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

    /// No option of any verb reads a time by a rule of its own.
    #[test]
    fn every_option_takes_both_forms() {
        let command = crate::help::command();
        let mut found = Vec::new();
        for line in [
            "demo --duration",
            "park --to-zero --patience",
            "ledger export --out l --last",
            "card probe --watch --every",
            "card probe --watch --for",
            "top --every",
            "status --watch --every",
            "metrics --textfile m.prom --every",
            "selftest latency --duration",
            "characterise record --out r --duration",
            "characterise record --out r --period",
            "reconcile x --live r --model m --period",
        ] {
            for time in ["2", "2s"] {
                let words = ["rtecctl"].into_iter().chain(line.split(' ')).chain([time]);
                let asked = command.clone().try_get_matches_from(words);
                found.extend(asked.err().map(|e| format!("{line} {time}: {e}")));
            }
        }
        assert_eq!(found, [""; 0]);
    }
}
