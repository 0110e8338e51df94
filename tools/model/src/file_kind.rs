//! Which of the program's files a text is, for the message where another one was asked for.

use rtec_files::InputError;
use std::path::Path;

/// Files that people hand over in place of each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// `NAME.run.toml`
    RunRecord,
    /// `machine.toml`
    Model,
    /// `rtec.toml`
    Configuration,
    /// A table, the CSV beside a run record for one.
    Table,
}

impl FileKind {
    /// By the tables that only this file has; nothing where none is there.
    #[must_use]
    pub fn of(text: &str) -> Option<Self> {
        let lines = || text.trim_start_matches('\u{feff}').lines().map(str::trim);
        let heads = |names: &[&str]| lines().any(|l| names.iter().any(|n| l.starts_with(n)));
        if heads(&["[columns]"]) {
            return Some(Self::RunRecord);
        }
        if heads(&["[[effect]]", "[[fit]]", "effect ="]) {
            return Some(Self::Model);
        }
        if heads(&["[[axis]]", "[card]"]) {
            return Some(Self::Configuration);
        }
        let first = lines().find(|l| !l.is_empty() && !l.starts_with('#'))?;
        (first.contains([',', ';', '\t']) && !first.contains(['=', '['])).then_some(Self::Table)
    }

    fn name(self) -> &'static str {
        match self {
            Self::RunRecord => "a run record: it has [columns]",
            Self::Model => "a machine model: it lists effects",
            Self::Configuration => "a configuration: it has axes or a card",
            Self::Table => "a table of values",
        }
    }

    fn expected(self) -> &'static str {
        match self {
            Self::RunRecord => {
                "a run record, NAME.run.toml: the sidecar that says what the columns of its CSV are"
            }
            Self::Model => "a machine model, machine.toml: a name and [[effect]] tables",
            Self::Configuration => "a configuration, rtec.toml: [machine], [card] and [[axis]] tables",
            Self::Table => "a table of values",
        }
    }

    /// That a file is an `other` one than this.
    #[must_use]
    pub fn instead(self, path: &Path, other: Self) -> InputError {
        InputError::whole(path, other.name(), self.expected())
    }

    /// The finding of a reader of `self`: that it is another of the program's files, where it is one.
    #[must_use]
    pub fn finding(self, path: &Path, text: &str, finding: InputError) -> InputError {
        match Self::of(text) {
            Some(other) if other != self => self.instead(path, other),
            _ => finding,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_told_apart() {
        for (text, kind) in [
            (
                "file = \"a.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\" }\n",
                Some(FileKind::RunRecord),
            ),
            ("name = \"m\"\n\n[[effect]]\nname = \"scale.x\"\nppm = 1.0\n", Some(FileKind::Model)),
            ("# mine\n[machine]\nname = \"m\"\n[card]\nbackend = \"mock\"\n", Some(FileKind::Configuration)),
            ("t,x,e\n0,1,2\n", Some(FileKind::Table)),
            ("name = \"ideal\"\n", None),
            ("", None),
        ] {
            assert_eq!(FileKind::of(text), kind, "{text}");
        }
    }
}
