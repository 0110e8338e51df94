//! A table described by the user's TOML file:
//!
//! ```toml
//! kind = "drift"
//! separator = ";"       # "," ";" "tab" "blank"
//! decimal = ","         # "." where it is not given
//! skip_lines = 3        # in front of the names; 0 where it is not given
//! names = true          # a line of names follows; otherwise columns go by number, from 1
//! comment = "//"        # beside #
//! log = false           # a log need not have a response
//! [columns]             # the names they get in the record
//! t  = { column = "Zeit", role = "time" }
//! T1 = { column = 4, role = "temperature", unit = "degF" }
//! e  = { column = "U", role = "error.z", factor = 12.5, add = -3.0, unit = "um" }  # unit: after factor and add
//! ```

use super::table::{ImportColumn, TableSyntax, table};
use rtec_files::Result;
use rtec_files::strict_toml::Document;
use rtec_model::record::{Record, Role, RunKind};
use std::path::Path;

/// A description of a table, read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct UserTableFormat {
    form: TableSyntax,
    columns: Vec<ImportColumn>,
    kind: RunKind,
}

impl UserTableFormat {
    /// Reads a description.
    ///
    /// # Errors
    /// The first finding, with its place.
    pub fn parse(file: &Path, text: &str) -> Result<Self> {
        let document = Document::parse(file, text)?;
        let root = document.root();
        root.only(&["kind", "separator", "decimal", "skip_lines", "names", "comment", "log", "columns"])?;
        let kinds = RunKind::ALL.map(|(name, _)| name).join(", ");
        let kind = root.required("kind", "the kind of run, as kind = \"drift\"")?;
        let kind = RunKind::parse(kind.str("a kind of run")?)
            .ok_or_else(|| kind.error(format!("kind `{}`", kind.text()), format!("one of {kinds}")))?;
        let expected = "separator = \",\", \";\", \"tab\" or \"blank\"";
        let separator = root.required("separator", expected)?;
        let by = match separator.as_str() {
            Some(",") => ',',
            Some(";") => ';',
            Some("tab" | "\t") => '\t',
            Some("blank" | " ") => ' ',
            _ => return Err(separator.mismatch(expected)),
        };
        let decimal_comma = match root.get("decimal").map(|entry| (entry, entry.as_str())) {
            None | Some((_, Some("."))) => false,
            Some((_, Some(","))) if by != ',' => true,
            Some((entry, _)) => {
                return Err(entry.mismatch("decimal = \".\", or \",\" where no commas part the columns"));
            }
        };
        let flag = |key: &str, default| root.get(key).map_or(Ok(default), |e| e.bool("true or false"));
        let skip = root.get("skip_lines").map_or(Ok(0), |e| e.integer("a number of lines"))?;
        let comment = root.get("comment").map(|entry| match entry.str("what comments begin with")? {
            "" => Err(entry.mismatch("what comments begin with")),
            text => Ok(text.to_owned()),
        });
        let comment = comment.transpose()?;
        let names = flag("names", true)?;
        let (by, decimal_comma, log) = (Some(by), Some(decimal_comma), flag("log", false)?);
        let form = TableSyntax { by, decimal_comma, skip, nameless: !names, comment, log };
        let listed =
            root.required("columns", "a table [columns] of what is wanted")?.table("a table [columns]")?;
        let mut columns: Vec<ImportColumn> = Vec::new();
        for entry in listed.entries() {
            let t = entry.table("{ column = \"NAME\", role = \"…\" }")?;
            t.only(&["column", "role", "unit", "factor", "add"])?;
            let expected =
                if names { "the column's name in the table" } else { "the column's number, from 1" };
            let column = match t.get("column") {
                None if names => entry.key().to_owned(),
                None => return Err(t.error("no column", expected)),
                Some(c) => match (c.as_integer(), c.as_str()) {
                    (Some(n), _) if n > 0 && !names => n.to_string(),
                    (None, Some(n)) if !names && n.parse::<usize>().is_ok_and(|n| n > 0) => n.to_owned(),
                    (None, Some(name)) if names => name.to_owned(),
                    _ => return Err(c.mismatch(expected)),
                },
            };
            let role = t.required("role", "a role, as role = \"position.y\"")?;
            let parsed = Role::parse(role.str("a role")?);
            let expected = "a role, as time, position.y, temperature, error.z";
            let parsed = parsed.ok_or_else(|| role.error(format!("role `{}`", role.text()), expected))?;
            let unit = t.get("unit").map(|u| u.str("a unit")).transpose()?;
            let number = |key: &str, default: f64| t.get(key).map_or(Ok(default), |e| e.number("a number"));
            let factor = number("factor", 1.0)?;
            if let Some(entry) = t.get("factor").filter(|_| factor == 0.0) {
                return Err(entry.mismatch("a factor that is no zero"));
            }
            let made = ImportColumn::of(&column, entry.key(), parsed, unit, factor, number("add", 0.0)?);
            let place = t.get("unit").unwrap_or(role);
            let made = made.map_err(|(found, expected)| place.error(found, expected))?;
            // After a factor the unit is not the file's.
            let unit_said =
                made.unit_said.clone().filter(|_| t.get("factor").is_none() && t.get("add").is_none());
            columns.push(ImportColumn { unit_said, ..made });
        }
        if columns.is_empty() {
            return Err(listed.error("no columns", "at least one"));
        }
        Ok(Self { form, columns, kind })
    }

    /// Reads a table of this description.
    ///
    /// # Errors
    /// As [`table`].
    pub fn read(&self, from: &Path, text: &str, to: &Path) -> Result<Record> {
        table(from, text, &self.columns, &self.form, self.kind, to)
    }
}
