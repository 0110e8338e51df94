//! Changes and writes `machine.toml` without losing anything that the user wrote.

use super::Machine;
use super::fit_note::{EffectWithProvenance, FitNote, Provenance, SourceRecord, ValidTemperatureRange};
use super::relative_paths::{folder_of, named_from, whole};
use crate::effect::{Dictionary, Effect, ParameterValueError, ReferenceTemperature, TemperatureDifference};
use rtec_files::InputError;
use rtec_files::file_format_stamp;
use std::path::{Path, PathBuf};
use toml_edit::{Array, InlineTable, Item, TableLike, Value, value};

impl Machine {
    /// Writes the format and the writer into the file, once the program changes it.
    fn stamp(&mut self) {
        self.doc["format"] = value(i64::from(file_format_stamp::FORMAT));
        self.doc["by"] = value(file_format_stamp::writer());
    }

    /// Adds the note of a fit.
    /// It replaces the note of an earlier fit of the same response.
    pub fn note_fit(&mut self, note: FitNote) {
        self.stamp();
        let mut t = toml_edit::Table::new();
        t["response"] = value(&note.response);
        t["date"] = value(&note.date);
        t["valid_until"] = value(&note.valid_until);
        let [rms, half_width, by_kind] = FitNote::keys_of(&note.response);
        t[rms] = value(note.rms_um);
        t[half_width] = value(note.half_width_um);
        let valid = |v: &ValidTemperatureRange| {
            let mut t = InlineTable::new();
            put_difference(&mut t, &v.difference);
            t.insert("range_K", pair(&v.range_k));
            t.insert("um_per_K", v.um_per_k.into());
            t
        };
        if !note.valid.is_empty() {
            let mut valid: Array = note.valid.iter().map(valid).collect();
            valid.iter_mut().for_each(|v| v.decor_mut().set_prefix("\n    "));
            valid.set_trailing("\n");
            valid.set_trailing_comma(true);
            t["valid"] = value(valid);
        }
        if let Some(at) = &note.at_mm {
            t["at_mm"] = value(at.iter().map(|(axis, range)| (axis, pair(range))).collect::<InlineTable>());
        }
        if !note.by_kind_um.is_empty() {
            t[by_kind] = value(note.by_kind_um.iter().map(|(kind, um)| (kind, *um)).collect::<InlineTable>());
        }
        t["from"] = sources(&note.from);
        let item =
            self.doc.entry("fit").or_insert_with(|| Item::ArrayOfTables(toml_edit::ArrayOfTables::new()));
        if let Some(list) = item.as_array_of_tables_mut() {
            list.retain(|t| t.get("response").and_then(Item::as_str) != Some(&note.response));
            list.push(t);
        }
        self.fits.retain(|f| f.response != note.response);
        self.fits.push(note);
    }

    /// Adds laws to its dictionary and returns the text of the whole dictionary.
    /// The caller writes that text, which includes the model's earlier own laws, to `file` beside the model.
    /// From now on the model names that file.
    ///
    /// # Errors
    /// The laws are refused, or its present dictionary cannot be read.
    pub fn add_project_laws(&mut self, file: &str, laws: &str) -> Result<String, InputError> {
        let mut text = match self.doc.get("dictionary").and_then(Item::as_str) {
            Some(own) => {
                rtec_files::text_file::read(&self.path.parent().unwrap_or(Path::new("")).join(own))? + "\n"
            }
            None => String::new(),
        };
        text += laws;
        let mut dictionary = self.given.clone();
        dictionary.add_own(Path::new(file), &text)?;
        self.dictionary = dictionary;
        self.adopted = true;
        self.doc["dictionary"] = value(file);
        Ok(text)
    }

    /// Appends an effect.
    ///
    /// # Errors
    /// The model already has it.
    pub fn push(&mut self, effect: Effect, provenance: Provenance) -> Result<(), ParameterValueError> {
        let next = EffectWithProvenance { effect, provenance };
        if self.listed.iter().any(|l| l.identity() == next.identity()) {
            let found = format!("`{}` a second time", next.effect.name());
            return Err(ParameterValueError::new("name", found, "one of a name"));
        }
        self.stamp();
        let table = effect_table(&next.effect, &next.provenance);
        self.tables().push(table);
        self.listed.push(next);
        Ok(())
    }

    /// Sets a parameter of the n-th effect, and its interval.
    /// The file keeps its comments and order.
    ///
    /// # Errors
    /// Unknown parameter, a value outside its bounds.
    ///
    /// # Panics
    /// When there is no n-th effect.
    pub fn set(
        &mut self,
        n: usize,
        parameter: &str,
        values: &[f64],
        interval: Option<&[[f64; 2]]>,
    ) -> Result<(), ParameterValueError> {
        let listed = &mut self.listed[n];
        listed.effect.set(parameter, values)?;
        let array = listed.effect.description().parameters.iter().any(|p| p.name == parameter && p.array);
        if let Some(interval) = interval {
            listed.provenance.interval.insert(parameter.to_owned(), interval.to_vec());
        }
        let Some(table) = self.tables().get_mut(n) else { return Ok(()) };
        replace(table, parameter, numbers(values, array));
        if let Some(interval) = interval {
            if let Some(t) = table.get_mut("interval").and_then(Item::as_table_like_mut) {
                t.insert(parameter, value(pairs(interval, array)));
            } else {
                let mut t = InlineTable::new();
                t.insert(parameter, pairs(interval, array));
                table.insert("interval", value(t));
            }
        }
        Ok(())
    }

    /// The file's effects as tables.
    /// An empty or inline array becomes one of `[[effect]]`.
    fn tables(&mut self) -> &mut toml_edit::ArrayOfTables {
        let item = &mut self.doc["effect"];
        if !item.is_array_of_tables() {
            let inline = std::mem::take(item);
            let mut tables = toml_edit::ArrayOfTables::new();
            if let Ok(Value::Array(array)) = inline.into_value() {
                for v in array {
                    if let Value::InlineTable(t) = v {
                        tables.push(t.into_table());
                    }
                }
            }
            *item = Item::ArrayOfTables(tables);
        }
        item.as_array_of_tables_mut().expect("an array of tables was put there just above")
    }

    /// The file's text, for the folder that it was read from.
    pub fn to_text(&self) -> String {
        self.doc.to_string()
    }

    /// The file's text for another folder.
    /// The paths of its chain, dictionary and records are changed to start from there.
    pub fn text_at(&self, path: &Path) -> String {
        let (from, to) = (folder_of(&self.path), folder_of(path));
        let mut moved = self.clone();
        for key in ["chain", "dictionary"] {
            if key == "dictionary" && self.adopted {
                continue;
            }
            let Some(file) = moved.doc.get(key).and_then(Item::as_str).map(PathBuf::from) else { continue };
            if file.is_relative() && from != to {
                let lies = from.join(&file);
                let name = file.file_name().map_or_else(PathBuf::new, PathBuf::from);
                let named = named_from(&to, &folder_of(&lies).join(name));
                replace(moved.doc.as_table_mut(), key, named.display().to_string().into());
            }
        }
        let place = |s: &SourceRecord| {
            let lies = s.folder.as_ref().map_or_else(|| from.clone(), |f| whole(&from.join(f)));
            let folder = named_from(&to, &lies);
            (!folder.as_os_str().is_empty()).then_some(folder)
        };
        let rename = |table: &mut toml_edit::Table, old: &[SourceRecord]| {
            let new: Vec<SourceRecord> =
                old.iter().map(|s| SourceRecord { folder: place(s), ..s.clone() }).collect();
            if new != old {
                table["from"] = sources(&new);
            }
        };
        let effects = moved.listed.clone();
        for (table, l) in moved.tables().iter_mut().zip(&effects) {
            rename(table, &l.provenance.from);
        }
        let notes = moved.doc.get_mut("fit").and_then(Item::as_array_of_tables_mut);
        for (table, fit) in notes.into_iter().flat_map(|t| t.iter_mut()).zip(&self.fits) {
            rename(table, &fit.from);
        }
        moved.to_text()
    }

    /// The file's text for another folder, checked by reading it back.
    /// `beside`: names and texts of files that will be written beside it and do not exist yet.
    ///
    /// # Errors
    /// A value that no machine has, for example from a fit to a record in the wrong unit.
    pub fn readable_text_at(&self, path: &Path, beside: &[(&str, &str)]) -> Result<String, InputError> {
        let text = self.text_at(path);
        let read = |file: &Path| {
            let own = beside.iter().find(|(name, _)| path.with_file_name(name) == file);
            own.map_or_else(|| rtec_files::text_file::read(file), |(_, text)| Ok((*text).to_owned()))
        };
        Self::parse_from(path, &text, Dictionary::default(), &read).map_err(|e| InputError {
            found: format!("a model that could not be loaded, and is not written: {}", e.found),
            expected: format!("{}; look at the records' units and columns", e.expected),
            ..e
        })?;
        Ok(text)
    }

    /// Writes the model in one step; the files that it names stay unchanged.
    ///
    /// # Errors
    /// The text could not be read back, or the directory cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), InputError> {
        let text = self.readable_text_at(path, &[])?;
        rtec_files::atomic_write::write_atomically(path, text.as_bytes())
            .map_err(|e| InputError::whole(path, e.to_string(), "a file that can be written"))
    }
}

/// Replaces a value and keeps the comment after it.
fn replace(table: &mut toml_edit::Table, key: &str, mut new: Value) {
    match table.get_mut(key).and_then(Item::as_value_mut) {
        Some(old) => {
            *new.decor_mut() = old.decor().clone();
            *old = new;
        }
        None => {
            table.insert(key, value(new));
        }
    }
}

fn numbers(values: &[f64], array: bool) -> Value {
    if array { values.iter().copied().collect::<Array>().into() } else { values[0].into() }
}

fn pair(pair: &[f64; 2]) -> Value {
    pair.iter().copied().collect::<Array>().into()
}

/// Puts the keys of a temperature difference into a table.
fn put_difference(table: &mut dyn TableLike, difference: &TemperatureDifference) {
    table.insert("sensor", value(&difference.sensor));
    match &difference.against {
        ReferenceTemperature::Sensor(minus) => drop(table.insert("minus", value(minus))),
        ReferenceTemperature::Reference(degc) => drop(table.insert("reference_degC", value(*degc))),
        ReferenceTemperature::Standard => {}
    }
}

fn pairs(interval: &[[f64; 2]], array: bool) -> Value {
    if array { interval.iter().map(pair).collect::<Array>().into() } else { pair(&interval[0]) }
}

/// One source becomes a table, several become an array of tables.
fn sources(from: &[SourceRecord]) -> Item {
    let source = |s: &SourceRecord| {
        let mut t = InlineTable::new();
        t.insert("file", s.file.as_str().into());
        t.insert("sha256", s.sha256.as_str().into());
        if let Some(folder) = &s.folder {
            t.insert("folder", folder.display().to_string().into());
        }
        t
    };
    match from {
        [one] => value(source(one)),
        many => value(many.iter().map(source).collect::<Array>()),
    }
}

fn effect_table(effect: &Effect, provenance: &Provenance) -> toml_edit::Table {
    let mut t = toml_edit::Table::new();
    t["name"] = value(effect.name());
    if let Some(d) = &effect.delta {
        put_difference(&mut t, d);
    }
    for (i, p) in effect.description().parameters.iter().enumerate() {
        t[&p.name] = value(numbers(effect.get(i), p.array));
    }
    if let Some(range_k) = &effect.range_k {
        t["range_K"] = value(pair(range_k));
    }
    if let Some(k) = effect.start_k {
        t["start_K"] = value(k);
    }
    if let Some(by) = &provenance.added_by {
        t["added_by"] = value(by);
    }
    if let Some(date) = &provenance.date {
        t["date"] = value(date);
    }
    if provenance.set_up {
        t["set_up"] = value(true);
    }
    if !provenance.from.is_empty() {
        t["from"] = sources(&provenance.from);
    }
    if !provenance.interval.is_empty() {
        let is_array = |name: &str| effect.description().parameters.iter().any(|p| p.name == name && p.array);
        let intervals = provenance.interval.iter().map(|(name, of)| (name, pairs(of, is_array(name))));
        t["interval"] = value(intervals.collect::<InlineTable>());
    }
    t
}

#[cfg(test)]
mod tests {
    use super::super::test_machine::{LATHE, parse};
    use super::*;
    use crate::record::{Record, hex};
    use sha2::{Digest, Sha256};
    use std::collections::BTreeMap;

    #[test]
    fn nothing_the_user_wrote_is_lost() {
        let mut m = parse(LATHE).unwrap();
        assert_eq!(m.to_text(), LATHE);
        m.set(0, "ppm", &[12.9], Some(&[[12.5, 13.3]])).unwrap();
        let mut added = m.dictionary().effect("reversal.y").unwrap();
        added.set("um", &[6.1]).unwrap();
        let provenance = Provenance {
            added_by: Some("reconcile".into()),
            date: Some("2026-05-01".into()),
            from: vec![SourceRecord { file: "y.csv".into(), sha256: "ab".into(), folder: None }],
            interval: [("um".to_owned(), vec![[5.8, 6.4]])].into(),
            set_up: false,
        };
        m.push(added, provenance.clone()).unwrap();
        let text = m.to_text();
        assert!(
            text.starts_with("# my lathe\n") && text.contains("ppm = 12.9 # measured in May\n"),
            "{text}"
        );
        assert!(text.contains("interval = { um = [5.8, 6.4] }"), "{text}");
        let again = parse(&text).unwrap();
        assert_eq!(again.listed(), m.listed());
        assert_eq!(again.listed()[2].provenance, provenance);
    }

    #[test]
    fn an_ideal_machine_may_be_written_in_every_way() {
        for text in ["name = \"m\"\n", "name = \"m\"\neffect = []\n"] {
            let mut m = parse(text).unwrap();
            assert_eq!(m.listed().len(), 0);
            let offset = m.dictionary().effect("offset.z").unwrap();
            m.push(offset, Provenance::default()).unwrap();
            assert_eq!(parse(&m.to_text()).unwrap().listed(), m.listed(), "{}", m.to_text());
        }
        let m = parse("name = \"m\"\neffect = [{ name = \"scale.x\", ppm = 1 }]\n").unwrap();
        assert_eq!(m.effects().next().unwrap().values(), [1.0]);
    }

    #[test]
    fn a_projects_own_effects_chain_and_fit_notes() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
        let law = "[[law]]\nname = \"quill_droop\"\nnaming = \"A.B\"\nlaw = \"e = um·(p_B/100)²\"\ncause = \"weight\"\n\
                   experiment = \"straightedge\"\nparameters = [{ name = \"um\", unit = \"um\", plausible = 50.0, \
                   terms = [{ factor = 1e-4, p_B = 2 }] }]\n";
        write("own.toml", law);
        write(
            "chain.toml",
            "[[joint]]\nname = \"z\"\nbranch = \"tool\"\naxis = \"z\"\ncomponent = [{ of = \"dx\", \
                             terms = [{ p = 1, value = 2.0 }] }]\n",
        );
        let text = "name = \"m\"\ndictionary = \"own.toml\"\nchain = \"chain.toml\"\n[[effect]]\n\
                    name = \"quill_droop.x.z\"\num = 3.0\n";
        write("m.toml", text);
        let mut m = Machine::read(&dir.path().join("m.toml")).unwrap();
        let axis = |n: &str| crate::record::Axis::new(n).unwrap();
        let column = |name: &str, role: crate::record::Role, data: &[f64]| {
            let unit = role.unit().unwrap().to_owned();
            crate::record::Column { name: name.into(), role, unit, data: data.to_vec() }
        };
        let record = Record::new(
            Path::new("r.run.toml"),
            crate::record::RunKind::Positioning,
            vec![
                column("z", crate::record::Role::Position(axis("z")), &[0.0, 200.0]),
                column("e", crate::record::Role::Error(axis("x")), &[0.0, 0.0]),
            ],
        )
        .unwrap();
        let p = m.predict(&record).unwrap();
        // 3·(200/100)² from the own effect, 2·200/100 from the chain
        assert!(
            (p.columns[0].1[1] - 16.0).abs() < 1e-9 && p.columns[0].1[0].abs() < 1e-12,
            "{:?}",
            p.columns
        );
        m.note_fit(FitNote {
            response: "error.x".into(),
            date: "2026-05-01".into(),
            valid_until: "2027-05-01".into(),
            rms_um: 0.4,
            half_width_um: 0.8,
            valid: vec![
                ValidTemperatureRange {
                    difference: TemperatureDifference::pair("T8", "T18"),
                    range_k: [0.5, 9.0],
                    um_per_k: 3.0,
                },
                ValidTemperatureRange {
                    difference: TemperatureDifference::single("T9"),
                    range_k: [-1.0, 2.0],
                    um_per_k: 1.0,
                },
            ],
            at_mm: Some(BTreeMap::from([("x".to_owned(), [-10.0, 200.5])])),
            by_kind_um: BTreeMap::from([("drift".to_owned(), 0.3)]),
            from: vec![SourceRecord { file: "a.csv".into(), sha256: "00".into(), folder: None }],
        });
        let again = Machine::parse(&dir.path().join("m.toml"), &m.to_text()).unwrap();
        assert_eq!(again.fits(), m.fits());
        write("own.toml", &law.replace("quill_droop", "scale"));
        let e = Machine::read(&dir.path().join("m.toml")).unwrap_err();
        assert!(e.file.ends_with("own.toml") && e.line == 2, "{e}");
        write("own.toml", &law.replace("p_B", "p_C"));
        assert!(Machine::read(&dir.path().join("m.toml")).unwrap_err().found.contains("p_C"));
    }

    /// A model written into another folder still finds its chain, laws and records.
    #[test]
    fn a_model_that_moves_takes_what_it_names_along() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["a/parts", "b"] {
            std::fs::create_dir_all(at(folder)).unwrap();
        }
        std::fs::write(
            at("a/parts/chain.toml"),
            "[[joint]]\nname = \"z\"\nbranch = \"tool\"\naxis = \"z\"\ncomponent = [{ of = \"dx\", \
             terms = [{ p = 1, value = 2.0 }] }]\n",
        )
        .unwrap();
        std::fs::write(
            at("a/own.toml"),
            "[[law]]\nname = \"quill_droop\"\nnaming = \"A.B\"\nlaw = \"e = um·(p_B/100)²\"\ncause = \"weight\"\n\
             experiment = \"straightedge\"\nparameters = [{ name = \"um\", unit = \"um\", plausible = 50.0, \
             terms = [{ factor = 1e-4, p_B = 2 }] }]\n",
        )
        .unwrap();
        std::fs::write(at("a/r.csv"), "z,e\n0,1\n").unwrap();
        let hash = hex(&Sha256::digest("z,e\n0,1\n"));
        let text = format!(
            "name = \"m\"\ndictionary = \"own.toml\" # mine\nchain = \"parts/chain.toml\"\n[[effect]]\n\
             name = \"quill_droop.x.z\"\num = 3.0\nfrom = {{ file = \"r.csv\", sha256 = \"{hash}\" }}\n"
        );
        std::fs::write(at("a/m.toml"), text).unwrap();
        let mut m = Machine::read(&at("a/m.toml")).unwrap();
        let record =
            |file: &str| SourceRecord { file: file.into(), sha256: hash.clone(), folder: Some(at("a")) };
        let note = |from| FitNote {
            response: "error.x".into(),
            date: "2026-05-01".into(),
            valid_until: "2027-05-01".into(),
            rms_um: 0.4,
            half_width_um: 0.8,
            valid: Vec::new(),
            at_mm: None,
            by_kind_um: BTreeMap::new(),
            from,
        };
        m.note_fit(note(vec![record("r.csv")]));
        assert_eq!(
            m.text_at(&at("a/m.toml")).matches("folder").count(),
            0,
            "beside it, nothing is to be said"
        );
        m.write(&at("b/m.toml")).unwrap();
        let text = std::fs::read_to_string(at("b/m.toml")).unwrap();
        assert!(
            text.contains("dictionary = \"../a/own.toml\" # mine\nchain = \"../a/parts/chain.toml\"\n"),
            "{text}"
        );
        let there = Machine::read(&at("b/m.toml")).unwrap();
        assert!(there.chain().is_some() && there.dictionary().effect("quill_droop.x.z").is_ok());
        assert_eq!(there.fits()[0].from[0].folder, Some("../a".into()));
        assert!(there.changed_sources().is_empty());
        std::fs::write(at("a/r.csv"), "z,e\n0,2\n").unwrap();
        assert_eq!(there.changed_sources(), ["r.csv has changed since the model was fitted on it"]);
        // Writing it back into the first folder restores the paths.
        there.write(&at("a/again.toml")).unwrap();
        let text = std::fs::read_to_string(at("a/again.toml")).unwrap();
        assert!(text.contains("dictionary = \"own.toml\" # mine\nchain = \"parts/chain.toml\"\n"), "{text}");
        assert_eq!(text.matches("folder").count(), 0, "{text}");
    }
}
