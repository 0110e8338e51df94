//! One file per verb: its options and one function.
//! `suspicions` prints the libraries' messages about records, for several verbs.

pub(crate) mod backup;
pub(crate) mod bugreport;
pub(crate) mod card;
pub(crate) mod characterise;
pub(crate) mod clear;
pub(crate) mod commission;
pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod correct;
pub(crate) mod demo;
pub(crate) mod designs;
pub(crate) mod disable;
pub(crate) mod enable;
pub(crate) mod example;
pub(crate) mod explain;
pub(crate) mod get;
pub(crate) mod history;
pub(crate) mod hold;
pub(crate) mod home;
pub(crate) mod input_notices;
pub(crate) mod ledger;
pub(crate) mod log;
pub(crate) mod man;
pub(crate) mod metrics;
pub(crate) mod model;
pub(crate) mod park;
pub(crate) mod part;
pub(crate) mod platform;
pub(crate) mod probe;
pub(crate) mod reconcile;
pub(crate) mod replay;
pub(crate) mod restore;
pub(crate) mod selftest;
pub(crate) mod shadow;
pub(crate) mod ship;
pub(crate) mod simulate;
pub(crate) mod status;
pub(crate) mod top;
pub(crate) mod trace;
pub(crate) mod whoami;

// A verb with verbs below it, one per line: the variant, its arguments, the function that runs it.
macro_rules! verbs_below {
    ($(#[$of_all:meta])* Args; $($(#[$about:meta])* $verb:ident $args:ty => $run:path;)*) => {
        #[derive(Debug, clap::Args)]
        $(#[$of_all])*
        pub(crate) struct Args {
            #[command(subcommand)]
            verb: Verb,
        }

        #[derive(Debug, clap::Subcommand)]
        enum Verb {
            $($(#[$about])* $verb($args),)*
        }

        pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
            match &args.verb {
                $(Verb::$verb(args) => $run(args),)*
            }
        }
    };
}
pub(crate) use verbs_below;

use crate::prelude::*;
use clap::builder::{PathBufValueParser, TypedValueParser};
use nix::unistd::{AccessFlags, access};
use rtec_model::record::Record;

pub(crate) fn read_records(paths: &[PathBuf]) -> Result<Vec<Record>, InputError> {
    paths.iter().map(|p| rtec_measure::run_record_files::read(p)).collect()
}

/// Reads the values of an option as a name and a number each, `x=500`.
pub(crate) fn pairs(
    verb: &str,
    option: &str,
    given: &[String],
    expected: &str,
) -> Result<Vec<(String, f64)>, InputError> {
    let pair = |text: &String| {
        let parsed = text.split_once('=').and_then(|(n, v)| Some((n.to_owned(), v.parse().ok()?)));
        parsed.ok_or_else(|| InputError::whole(Path::new(verb), format!("{option} {text}"), expected))
    };
    given.iter().map(pair).collect()
}

/// Parser of a file to write, which is checked before the work.
pub(crate) fn output() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|file| can_be_written(&file).map(|()| file))
}

/// Parser of an option that names a drawing, which is always SVG.
pub(crate) fn drawing() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new()
        .try_map(|file| is_drawing(&file).and_then(|()| can_be_written(&file)).map(|()| file))
}

fn is_drawing(file: &Path) -> Result<(), String> {
    let Some(extension) = file.extension().map(|e| e.to_string_lossy().into_owned()) else { return Ok(()) };
    if extension.eq_ignore_ascii_case("svg") {
        return Ok(());
    }
    Err(format!("drawings are SVG, not {extension}: name it {}", file.with_extension("svg").display()))
}

fn can_be_written(file: &Path) -> Result<(), String> {
    let folder = file.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match std::fs::metadata(file) {
        Ok(there) if there.is_dir() => return Err("it is a folder, a file is to be written".to_owned()),
        // Pipes and terminals are written directly.
        Ok(there) if !there.is_file() => return Ok(()),
        _ => {}
    }
    if !folder.is_dir() {
        return Err(format!("no folder {} (make it first)", folder.display()));
    }
    access(folder, AccessFlags::W_OK)
        .map_err(|e| format!("nothing can be written into {}: {}", folder.display(), e.desc()))
}

#[cfg(test)]
mod tests {
    use super::{can_be_written, is_drawing};

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

    #[test]
    fn a_drawing_is_not_written_under_the_name_of_another_kind() {
        let said = |name: &str| is_drawing(std::path::Path::new(name));
        for good in ["a.svg", "A.SVG", "plot", "/dev/stdout"] {
            assert_eq!(said(good), Ok(()), "{good}");
        }
        assert_eq!(said("p/a.png").unwrap_err(), "drawings are SVG, not png: name it p/a.svg");
        // Every --plot that writes a file.
        let mut asked = 0;
        let mut places = vec![(Vec::<String>::new(), crate::help::command())];
        while let Some((path, command)) = places.pop() {
            let is_file = |a: &clap::Arg| a.get_value_names().is_some_and(|names| names[0] == "FILE.svg");
            if command.get_arguments().any(|a| a.get_long() == Some("plot") && is_file(a)) {
                let words = path.iter().map(String::as_str).chain(["--plot", "a.png"]);
                let error = crate::help::command().try_get_matches_from(["rtecctl"].into_iter().chain(words));
                let said = error.unwrap_err().to_string();
                assert!(said.contains("drawings are SVG, not png: name it a.svg"), "{path:?}: {said}");
                asked += 1;
            }
            let below = command
                .get_subcommands()
                .map(|c| ([&path[..], &[c.get_name().to_owned()]].concat(), c.clone()));
            places.extend(below);
        }
        assert!(asked >= 5, "{asked}");
    }

    #[test]
    fn a_file_that_cannot_be_written_is_refused_first() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("old.csv"), "t").unwrap();
        for name in ["new.csv", "old.csv"] {
            assert_eq!(can_be_written(&at(name)), Ok(()), "{name}");
        }
        assert_eq!(can_be_written(std::path::Path::new("/dev/null")), Ok(()));
        assert!(can_be_written(&at("none/new.csv")).unwrap_err().starts_with("no folder "));
        assert!(can_be_written(&at("old.csv/new.csv")).unwrap_err().starts_with("no folder "));
        assert!(can_be_written(folder.path()).unwrap_err().contains("is a folder"));
    }
}
