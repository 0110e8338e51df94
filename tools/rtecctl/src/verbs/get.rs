//! `rtecctl get`: one value of the status, for scripts.

use crate::daemon_connection::{DaemonArgs, NO_EVENTS, observe};
use serde_json::{Map, Value};

/// Print one value of the status, as axes.x.completed or mode
///
/// The names are those of `rtecctl status --json`; an axis or a sensor by its name or its number from 0. Text is printed
/// bare, everything else as JSON; with --json text too. Without a name every name is printed, with --json as one list. Exit 1
/// where the status has no such value now, 2 where it never has, 3 without a daemon; a latched fault is no other exit code here.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Which value, as axes.x.completed, `rt.poll_gap_ns.p9999`, sensors.T8.degc
    name: Option<String>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Values that a status may lack, and what to do then.
const SOMETIMES: [(&str, &str); 6] = [
    ("edited", "what runs is what the files say"),
    ("model", "no model is loaded: `rtecctl model load FILE`"),
    ("table", "no part table is loaded: `rtecctl part load`"),
    ("table_now", "no part table is loaded: `rtecctl part load`"),
    ("sensors", "no sensors are configured: `[[sensor]]` in the daemon's rtec.toml"),
    ("record_trouble", "the record is written: no trouble"),
];

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let seen = observe(&mut args.daemon.view()?, NO_EVENTS)?;
    let status = serde_json::to_value(&seen.status)?;
    let Some(name) = &args.name else {
        let mut names = Vec::new();
        all(&status, "", &mut names);
        if args.daemon.json {
            println!("{}", serde_json::json!(names));
        } else {
            println!("{}", names.join("\n"));
        }
        return Ok(());
    };
    match find(&status, name) {
        Ok(Value::String(text)) if !args.daemon.json => println!("{text}"),
        Ok(value) => {
            println!("{value}");
            if is_empty(value) && !args.daemon.json {
                eprintln!("none");
            }
        }
        Err(text) => {
            let first = name.split('.').next().unwrap_or_default();
            match SOMETIMES.iter().find(|(of, _)| *of == first) {
                Some((_, none)) if status.get(first).is_none() => fail!(No, "{none}"),
                Some(_) => fail!(No, "{text}"),
                None => fail!(Bad, "{text}"),
            }
        }
    }
    Ok(())
}

/// Whether a list or a table has no entries.
fn is_empty(value: &Value) -> bool {
    value.as_array().is_some_and(Vec::is_empty) || value.as_object().is_some_and(Map::is_empty)
}

/// The name of an entry in a list.
fn called(entry: &Value) -> Option<&str> {
    entry.get("name").or_else(|| entry.get("sensor")).and_then(Value::as_str)
}

fn find<'a>(status: &'a Value, name: &str) -> Result<&'a Value, String> {
    let mut at = status;
    let mut path = String::new();
    for part in name.split('.') {
        let next = match at {
            Value::Object(fields) => fields.get(part),
            Value::Array(list) => (list.iter().find(|e| called(e) == Some(part)))
                .or_else(|| part.parse().ok().and_then(|n: usize| list.get(n))),
            _ => None,
        };
        at = next.ok_or_else(|| {
            let here = if path.is_empty() { "the status".to_owned() } else { path.clone() };
            format!("found {part:?}, expected one of {here}'s {}", known(at, path.is_empty()))
        })?;
        path = if path.is_empty() { part.to_owned() } else { format!("{path}.{part}") };
    }
    Ok(at)
}

/// The names of the values here.
/// For the whole status they include those that it may lack.
fn known(at: &Value, whole: bool) -> String {
    let names = match at {
        Value::Object(fields) => {
            let mut names: Vec<String> = fields.keys().cloned().collect();
            if whole {
                let now_and_then = SOMETIMES.iter().map(|(name, _)| (*name).to_owned());
                names.extend(now_and_then.filter(|name| !fields.contains_key(name)));
                names.sort();
            }
            names
        }
        Value::Array(list) => {
            list.iter().enumerate().map(|(n, e)| called(e).map_or(n.to_string(), str::to_owned)).collect()
        }
        _ => Vec::new(),
    };
    if names.is_empty() { "values: it has none".to_owned() } else { names.join(", ") }
}

fn all(at: &Value, path: &str, names: &mut Vec<String>) {
    let under = |part: &str| if path.is_empty() { part.to_owned() } else { format!("{path}.{part}") };
    match at {
        Value::Object(fields) if !fields.is_empty() => {
            for (k, v) in fields {
                all(v, &under(k), names);
            }
        }
        Value::Array(list) if list.iter().all(|e| called(e).is_some()) && !list.is_empty() => {
            for e in list {
                all(e, &under(called(e).unwrap_or_default()), names);
            }
        }
        _ => names.push(path.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_by_name_by_number_and_not_at_all() {
        let status: Value = serde_json::from_str(include_str!("../../tests/golden/status.json")).unwrap();
        assert_eq!(find(&status, "mode"), Ok(&"run".into()));
        let x = find(&status, "axes.x.completed").unwrap();
        assert_eq!(find(&status, "axes.1.completed").unwrap(), x);
        assert_eq!(find(&status, "rt.poll_gap_ns.p9999"), Ok(&471.into()));
        assert!(
            find(&status, "axes.w.completed")
                .unwrap_err()
                .starts_with("found \"w\", expected one of axes's z, x")
        );
        assert!(find(&status, "mode.x").unwrap_err().ends_with("it has none"));
        for (name, _) in SOMETIMES {
            let said = find(&status, "part").unwrap_err();
            assert_eq!(said.split(", ").filter(|known| known.ends_with(name)).count(), 1, "{name}: {said}");
        }
        assert!(is_empty(&serde_json::json!([])) && is_empty(&serde_json::json!({})));
        assert!(!is_empty(&Value::Null) && !is_empty(&serde_json::json!([0])) && !is_empty(&"".into()));
        let mut names = Vec::new();
        all(&status, "", &mut names);
        assert!(names.iter().any(|n| n == "axes.x.completed"));
        for name in names {
            find(&status, &name).unwrap();
        }
    }
}
