//! `machine.toml`: a named list of effects, read strictly; written so that nothing the user wrote is lost.

use crate::chain::Chain;
use crate::date;
use crate::effect::{Against, Dictionary, Difference, Effect, Heat, Need, Parameter, ValueError};
use crate::record::{Record, Role, hex};
use rtec_files::InputError;
use rtec_files::text::short;
use rtec_files::toml::{Document, Entry, Table};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml_edit::{Array, DocumentMut, InlineTable, Item, Value, value};

/// Half width of a 95 % interval in standard deviations.
const NORMAL_95: f64 = 1.96;

/// What an effect of a temperature difference may be off by at a row, µm, beyond what the fit itself leaves: the slope at
/// the bound times what was asked beyond it, and, `elapsed_s` after a start, its part of an unknown state of the lag.
#[must_use]
pub fn unknown_um(
    gain: f64,
    bend: f64,
    asked_k: f64,
    held_k: f64,
    start_k: f64,
    tau_s: f64,
    elapsed_s: f64,
) -> f64 {
    let slope = gain.abs().max((gain + 2.0 * bend * held_k).abs());
    let start = if tau_s > 0.0 { NORMAL_95 * start_k * (-elapsed_s / tau_s).exp() } else { 0.0 };
    slope * (asked_k - held_k).hypot(start)
}

/// A record that something was fitted on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Name of the record's CSV.
    pub file: String,
    /// SHA-256 of it, in hexadecimal.
    pub sha256: String,
    /// Where it lies; none for beside the model.
    pub folder: Option<PathBuf>,
}

impl Source {
    /// The source that a record is.
    #[must_use]
    pub fn of(record: &Record) -> Self {
        let folder = Some(folder_of(&record.path));
        Self { file: record.file.clone(), sha256: record.sha256.clone(), folder }
    }
}

/// The folder that a file stands in, whole where it exists.
fn folder_of(path: &Path) -> PathBuf {
    let parent = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    whole(parent)
}

/// A folder's path from the root on, without `..`.
fn whole(folder: &Path) -> PathBuf {
    folder.canonicalize().unwrap_or_else(|_| {
        // It is not there: by its name.
        let mut plain = PathBuf::new();
        for part in std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()).components() {
            if part == std::path::Component::ParentDir {
                plain.pop();
            } else {
                plain.push(part);
            }
        }
        plain
    })
}

/// A path as it is named from a folder; both whole.
fn named_from(folder: &Path, path: &Path) -> PathBuf {
    let (mut here, mut there) = (folder.components().peekable(), path.components().peekable());
    if here.peek() != there.peek() {
        return path.to_owned();
    }
    while here.peek().is_some() && here.peek() == there.peek() {
        here.next();
        there.next();
    }
    here.map(|_| Path::new("..").as_os_str()).chain(there.map(std::path::Component::as_os_str)).collect()
}

/// Where an effect comes from. All of it may be absent, as in what a person writes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Provenance {
    /// The program or person that added the effect.
    pub added_by: Option<String>,
    /// The date, as ISO 8601.
    pub date: Option<String>,
    /// The records it was fitted on.
    pub from: Vec<Source>,
    /// Interval of each parameter, one pair per value.
    pub interval: BTreeMap<String, Vec<[f64; 2]>>,
}

/// An effect of a machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// The effect with its parameters.
    pub effect: Effect,
    /// Records, dates and intervals that the effect comes with.
    pub provenance: Provenance,
}

/// The range of a temperature difference in which a fit is valid.
#[derive(Debug, Clone, PartialEq)]
pub struct Validity {
    /// The difference, one that the model reads or not.
    pub difference: Difference,
    /// From where to where it was seen, K.
    pub range_k: [f64; 2],
    /// How much the response moved with it, µm/K.
    pub um_per_k: f64,
}

impl Validity {
    /// What being so far outside may cost, µm.
    #[must_use]
    pub fn outside_um(&self, delta_k: f64) -> f64 {
        self.um_per_k * (delta_k - self.range_k[1]).max(self.range_k[0] - delta_k).max(0.0)
    }
}

/// What a fit says about itself: which response, when, on what, how good, how long it may be trusted.
#[derive(Debug, Clone, PartialEq)]
pub struct FitNote {
    /// The response that was fitted, as `error.z`.
    pub response: String,
    /// The date of the fit, as ISO 8601.
    pub date: String,
    /// The last day on which it may be used without being looked at again.
    pub valid_until: String,
    /// RMS on blocks of time that the fit had not seen, µm.
    pub rms_um: f64,
    /// Half width of the 95 % prediction interval, µm.
    pub half_width_um: f64,
    /// Where it is valid: outside of these, the interval is wider.
    pub valid: Vec<Validity>,
    /// Where each axis was while it was seen, mm; axes that are not named stood still. Elsewhere there is no interval: what
    /// the machine does there no record has shown. None in a model that does not say.
    pub at_mm: Option<BTreeMap<String, [f64; 2]>>,
    /// The records that it was fitted on.
    pub from: Vec<Source>,
}

/// An axis that moves by less stands still, mm.
const STILL_MM: f64 = 1.0;

impl FitNote {
    /// Where the axes of records are: from where to where each moves, mm.
    #[must_use]
    pub fn places(records: &[&Record]) -> BTreeMap<String, [f64; 2]> {
        let mut found: BTreeMap<String, [f64; 2]> = BTreeMap::new();
        for record in records {
            for axis in record.axes(Role::Position) {
                let p = record.data(&Role::Position(axis.clone())).unwrap_or_default();
                let own =
                    p.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], p| [l.min(*p), h.max(*p)]);
                let all = found.entry(axis.to_string()).or_insert(own);
                *all = [all[0].min(own[0]), all[1].max(own[1])];
            }
        }
        found.retain(|_, [l, h]| *h - *l > STILL_MM);
        found
    }

    /// The interval was seen wherever this record's axes go: a tenth of its range beyond is as good.
    #[must_use]
    pub fn covers(&self, record: &Record) -> bool {
        let Some(at) = &self.at_mm else { return true };
        Self::places(&[record]).iter().all(|(axis, [l, h])| {
            at.get(axis).is_some_and(|[from, to]| {
                let margin = 0.1 * (to - from);
                *l >= from - margin && *h <= to + margin
            })
        })
    }

    /// This fit on top of an earlier one of the same response: what neither knows adds up, and both ranges were seen.
    pub fn on(&mut self, earlier: &Self) {
        self.half_width_um = self.half_width_um.hypot(earlier.half_width_um);
        self.rms_um = self.rms_um.hypot(earlier.rms_um);
        let new = |v: &&Validity| self.valid.iter().all(|o| o.difference != v.difference);
        let further: Vec<Validity> = earlier.valid.iter().filter(new).cloned().collect();
        self.valid.extend(further);
        if let (Some(own), Some(at)) = (&mut self.at_mm, &earlier.at_mm) {
            for (axis, [l, h]) in at {
                let all = own.entry(axis.clone()).or_insert([*l, *h]);
                *all = [all[0].min(*l), all[1].max(*h)];
            }
        }
        let known: Vec<String> = self.from.iter().map(|s| s.sha256.clone()).collect();
        self.from.extend(earlier.from.iter().filter(|s| !known.contains(&s.sha256)).cloned());
    }

    /// Where it was seen, in words; empty where it does not say.
    #[must_use]
    pub fn place_text(&self) -> String {
        match &self.at_mm {
            None => String::new(),
            Some(at) if at.is_empty() => " at the place of the fit".to_owned(),
            Some(at) => {
                let of = |(axis, [l, h]): (&String, &[f64; 2])| format!("{axis} {l:.0} to {h:.0} mm");
                format!(" for {}", at.iter().map(of).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

/// A machine model: the content of one `machine.toml`.
#[derive(Debug, Clone)]
pub struct Machine {
    /// The file, as the user named it.
    pub path: PathBuf,
    sha256: String,
    name: String,
    listed: Vec<Listed>,
    fits: Vec<FitNote>,
    chain: Option<Chain>,
    /// The laws that a program gave it; its file's own come on top.
    given: Dictionary,
    dictionary: Dictionary,
    /// The dictionary will stand beside the model wherever that is written.
    adopted: bool,
    doc: DocumentMut,
}

impl Machine {
    /// An ideal machine: no effects.
    #[must_use]
    pub fn ideal(name: &str) -> Self {
        let mut doc = DocumentMut::new();
        doc["name"] = value(name);
        Self {
            path: PathBuf::from("machine.toml"),
            sha256: String::new(),
            name: name.to_owned(),
            listed: Vec::new(),
            fits: Vec::new(),
            chain: None,
            given: Dictionary::default(),
            dictionary: Dictionary::default(),
            adopted: false,
            doc,
        }
    }

    /// Reads a machine model with the built-in effects, and with those of the file that its key `dictionary` names.
    ///
    /// # Errors
    /// The first finding, with file, line and column: syntax, unknown key or effect, a parameter that is missing, not
    /// a finite number or outside its bounds, `minus` together with `reference_degC`, one effect twice.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text::read(path)?;
        Self::parse(path, &text)
    }

    /// As [`Machine::read`], from text; `path` is for messages and for what the file refers to.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        Self::parse_with(path, text, Dictionary::default())
    }

    /// As [`Machine::parse`], with the laws of a program that has more than the built-in ones.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse_with(path: &Path, text: &str, given: Dictionary) -> Result<Self, InputError> {
        Self::parse_from(path, text, given, &|beside| rtec_files::text::read(beside))
    }

    /// As [`Machine::parse_with`]; `read` gives the text of the chain that it names: for files that a program holds in itself.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse_from(
        path: &Path,
        text: &str,
        given: Dictionary,
        read: &dyn Fn(&Path) -> Result<String, InputError>,
    ) -> Result<Self, InputError> {
        let doc = Document::parse(path, text)?;
        let root = doc.root();
        root.only(&["name", "note", "dictionary", "chain", "fit", "effect"])?;
        let name = root.required("name", "the machine's name, as name = \"…\"")?.str("the machine's name")?;
        if let Some(note) = root.get("note") {
            note.str("free text")?;
        }
        let mut hash = Sha256::new_with_prefix(text);
        // The files it names are part of it.
        let mut beside = |file: &str| {
            let path = path.parent().unwrap_or(Path::new("")).join(file);
            read(&path).map(|text| {
                hash.update(&text);
                (path, text)
            })
        };
        let mut dictionary = given.clone();
        if let Some(own) = root.get("dictionary") {
            dictionary.read_own(&beside(own.str("a file of the project's own laws")?)?.0)?;
        }
        let chain = match root.get("chain") {
            Some(e) => {
                let (file, text) = beside(e.str("a file with a kinematic chain")?)?;
                Some(Chain::parse(&file, &text)?)
            }
            None => None,
        };
        let sha256 = hex(&hash.finalize());
        let fits = root.get("fit").map(|e| e.tables("[[fit]] tables")).transpose()?.unwrap_or_default();
        let fits = fits.into_iter().map(read_fit).collect::<Result<Vec<_>, _>>()?;
        let mut listed: Vec<Listed> = Vec::new();
        let tables =
            root.get("effect").map(|e| e.tables("[[effect]] tables")).transpose()?.unwrap_or_default();
        for table in tables {
            let next = read_effect(table, &dictionary)?;
            if listed.iter().any(|l| l.effect.identity() == next.effect.identity()) {
                let found = format!("effect `{}` a second time", next.effect.name());
                let expected = "one of a name, unless sensors, periods, knots or times differ";
                return Err(table.required("name", "")?.error(found, expected));
            }
            listed.push(next);
        }
        let name = name.to_owned();
        // For writing it back with its comments; the same text was read above.
        let doc = text.parse::<DocumentMut>().map_err(|e| {
            let at = e.span().map_or(0, |s| s.start);
            InputError::at_offset(path, text, at, e.message(), "TOML")
        })?;
        let (path, adopted) = (path.to_owned(), false);
        Ok(Self { path, sha256, name, listed, fits, chain, given, dictionary, adopted, doc })
    }

    /// SHA-256 of the file as it was read, with the dictionary and the chain that it names behind it.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The machine's name, as `name` has it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The effects with where they come from, in the file's order.
    #[must_use]
    pub fn listed(&self) -> &[Listed] {
        &self.listed
    }

    /// The effects, in the file's order.
    pub fn effects(&self) -> impl Iterator<Item = &Effect> {
        self.listed.iter().map(|l| &l.effect)
    }

    /// The kinematic chain whose errors add to the effects'.
    #[must_use]
    pub fn chain(&self) -> Option<&Chain> {
        self.chain.as_ref()
    }

    /// The same machine with another chain, or none; what is written of it goes on naming the file that it was read from.
    #[must_use]
    pub fn with_chain(&self, chain: Option<Chain>) -> Self {
        Self { chain, ..self.clone() }
    }

    /// What fits say about themselves.
    #[must_use]
    pub fn fits(&self) -> &[FitNote] {
        &self.fits
    }

    /// Half width of the 95 % prediction interval of a response, µm, where a fit has said it.
    #[must_use]
    pub fn half_width_um(&self, response: &str) -> Option<f64> {
        self.fits.iter().find(|f| f.response == response).map(|f| f.half_width_um)
    }

    /// Half width of the 95 % prediction interval at every row of a record, µm, where a fit of the response has said
    /// it and has seen the axes where they are in the record: wider just after the record's start, by what is not known of the lags, and where a difference is held at
    /// the bound of the range it was fitted on.
    #[must_use]
    pub fn half_widths_um(&self, record: &Record, response: &Role) -> Option<Vec<f64>> {
        let note = self.fits.iter().find(|f| f.response == response.to_string())?;
        if !note.covers(record) {
            return None;
        }
        let h = note.half_width_um;
        let mut squares = vec![h * h; record.rows()];
        let t = record.time_s();
        let valid = self.fits.iter().filter(|f| f.response == response.to_string()).flat_map(|f| &f.valid);
        let mut outside = vec![0.0_f64; record.rows()];
        for v in valid {
            // A sensor that the model does not read may be missing here.
            let Some(u) = record.temperature(&v.difference.sensor) else { continue };
            let minus = |row: usize| match &v.difference.against {
                Against::Sensor(m) => record.temperature(m).map(|m| m[row]),
                Against::Reference(degc) => Some(*degc),
                Against::Standard => Some(crate::effect::STANDARD_DEGC),
            };
            for (row, (o, u)) in outside.iter_mut().zip(u).enumerate() {
                *o = minus(row).map_or(*o, |m| o.max(v.outside_um(u - m)));
            }
        }
        squares.iter_mut().zip(&outside).for_each(|(s, o)| *s += o * o);
        for effect in self.effects().filter(|e| e.axes().first() == response.axis()) {
            let (Some(range), Some(asked)) = (effect.range_k, differences(effect, record)) else { continue };
            let of = |name: &str| effect.value(name).map_or(0.0, |v| v[0]);
            let (gain, bend, tau_s) = (of("um_per_K"), of("um_per_K2"), of("tau_s"));
            for (row, (square, asked)) in squares.iter_mut().zip(&asked).enumerate() {
                let held = asked.clamp(range[0], range[1]);
                let (start_k, elapsed_s) = (effect.start_k.unwrap_or(0.0), t[row] - t[0]);
                *square += unknown_um(gain, bend, *asked, held, start_k, tau_s, elapsed_s).powi(2);
            }
        }
        Some(squares.into_iter().map(f64::sqrt).collect())
    }

    /// The record with its errors less what this machine predicts of them.
    ///
    /// # Errors
    /// As [`Machine::predict`].
    pub fn beyond(&self, record: &Record) -> Result<Record, InputError> {
        let mut left = record.clone();
        let predicted = self.predict(record)?.columns;
        let responses = left.columns.iter_mut().filter(|c| c.role.is_response());
        for (column, (_, says)) in responses.zip(predicted) {
            column.data.iter_mut().zip(says).for_each(|(e, p)| *e -= p);
        }
        Ok(left)
    }

    /// Adds what a fit says about itself; it stands for what an earlier fit of the same response said.
    pub fn note_fit(&mut self, note: FitNote) {
        let mut t = toml_edit::Table::new();
        t["response"] = value(&note.response);
        t["date"] = value(&note.date);
        t["valid_until"] = value(&note.valid_until);
        t["rms_um"] = value(note.rms_um);
        t["half_width_um"] = value(note.half_width_um);
        let valid = |v: &Validity| {
            let mut t = InlineTable::new();
            t.insert("sensor", v.difference.sensor.as_str().into());
            match &v.difference.against {
                Against::Sensor(m) => drop(t.insert("minus", m.as_str().into())),
                Against::Reference(degc) => drop(t.insert("reference_degC", (*degc).into())),
                Against::Standard => {}
            }
            t.insert("range_K", Value::from(v.range_k.into_iter().collect::<Array>()));
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
            let mut places = InlineTable::new();
            for (axis, range) in at {
                places.insert(axis, Value::from(range.iter().copied().collect::<Array>()));
            }
            t["at_mm"] = value(places);
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

    /// The dictionary it was read with.
    #[must_use]
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// Adds laws to its dictionary. The text that comes back, with the laws it had of its own, belongs into `file`
    /// beside the model: the model names it from now on.
    ///
    /// # Errors
    /// The laws are refused, or its present dictionary cannot be read.
    pub fn adopt(&mut self, file: &str, laws: &str) -> Result<String, InputError> {
        let mut text = match self.doc.get("dictionary").and_then(Item::as_str) {
            Some(own) => {
                rtec_files::text::read(&self.path.parent().unwrap_or(Path::new("")).join(own))? + "\n"
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
    /// It is there already.
    pub fn push(&mut self, effect: Effect, provenance: Provenance) -> Result<(), ValueError> {
        if self.listed.iter().any(|l| l.effect.identity() == effect.identity()) {
            return Err(ValueError::new(
                "name",
                format!("`{}` a second time", effect.name()),
                "one of a name",
            ));
        }
        let table = effect_table(&effect, &provenance);
        self.tables().push(table);
        self.listed.push(Listed { effect, provenance });
        Ok(())
    }

    /// Sets a parameter of the n-th effect, and its interval; comments and order of the file stay.
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
    ) -> Result<(), ValueError> {
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

    /// The file's effects as tables; an empty or inline array becomes one of `[[effect]]`.
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

    /// The file's text, for the place that it was read from.
    #[must_use]
    pub fn to_text(&self) -> String {
        self.doc.to_string()
    }

    /// The file's text for another place: the chain, the dictionary and the records that it names are named from there.
    #[must_use]
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
        let place = |s: &Source| {
            let lies = s.folder.as_ref().map_or_else(|| from.clone(), |f| whole(&from.join(f)));
            let folder = named_from(&to, &lies);
            (!folder.as_os_str().is_empty()).then_some(folder)
        };
        let rename = |table: &mut toml_edit::Table, old: &[Source]| {
            let new: Vec<Source> = old.iter().map(|s| Source { folder: place(s), ..s.clone() }).collect();
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

    /// Writes the model, whole or not at all; what it names stays what it was.
    ///
    /// # Errors
    /// The directory cannot be written.
    pub fn write(&self, path: &Path) -> std::io::Result<()> {
        rtec_files::write::whole(path, self.text_at(path).as_bytes())
    }

    /// The sum of the effects at every row of a record, for each response in the record's order; and what the record
    /// does not log and was taken as zero (effect, role).
    ///
    /// # Errors
    /// An effect reads a sensor or channel that the record does not have.
    pub fn predict(&self, record: &Record) -> Result<Prediction, InputError> {
        let mut columns: Vec<(String, Vec<f64>)> =
            record.responses().map(|c| (c.name.clone(), vec![0.0; record.rows()])).collect();
        let mut taken_as_zero = Vec::new();
        for effect in self.effects() {
            let acts = effect.acts_on(record);
            if acts.is_empty() {
                continue;
            }
            let bound = effect.bind(record).map_err(|m| {
                let expected = format!("a column of role {}", m.what);
                InputError::whole(&record.path, m.to_string(), expected)
            })?;
            for (role, component) in acts {
                let place = record.responses().position(|c| c.role == role);
                if let Some((_, out)) = place.and_then(|p| columns.get_mut(p)) {
                    bound.add(effect, component, out);
                }
            }
            taken_as_zero.extend(bound.taken_as_zero().iter().map(|r| (effect.name(), r.to_string())));
        }
        if let Some(chain) = &self.chain {
            let acts = |r: &Role| matches!(r, Role::Error(a) if ["x", "y", "z"].contains(&a.as_str()));
            if record.responses().any(|c| acts(&c.role)) {
                let zero = chain.taken_as_zero(record).into_iter();
                taken_as_zero.extend(zero.map(|role| ("chain".to_owned(), role.to_string())));
            }
            for (column, (_, out)) in record.responses().zip(&mut columns) {
                chain.add(record, &column.role, out).map_err(|m| {
                    InputError::whole(&record.path, m.to_string(), format!("a column of role {}", m.what))
                })?;
            }
        }
        Ok(Prediction { columns, taken_as_zero })
    }
}

impl Machine {
    /// What to know before trusting it on a day (days since 1970-01-01): parameters outside what a sound machine
    /// shows, fits past their date.
    #[must_use]
    pub fn doubts(&self, today: i64) -> Vec<String> {
        let mut found = Vec::new();
        for e in self.effects() {
            for (i, p) in e.description().parameters.iter().enumerate() {
                let [lo, hi] = p.plausible;
                if let Some(v) = e.get(i).iter().find(|v| **v < lo || **v > hi) {
                    found.push(format!(
                        "{}: {} = {v} {} is outside {lo} to {hi}, unlikely",
                        e.name(),
                        p.name,
                        p.unit
                    ));
                }
            }
        }
        found.extend(self.expired(today));
        let early = self.fits().iter().filter(|f| date::parse(&f.date).is_some_and(|d| d > today));
        found.extend(early.map(|f| {
            let now = date::format(today);
            format!(
                "{}: fitted on {}, and it is {now} by this machine's clock: is the clock right?",
                f.response, f.date
            )
        }));
        found
    }

    /// Fits whose validity has ended before a day (days since 1970-01-01).
    #[must_use]
    pub fn expired(&self, today: i64) -> Vec<String> {
        let ended = self.fits.iter().filter(|f| date::parse(&f.valid_until).is_some_and(|d| d < today));
        ended.map(|f| format!("{}: the fit's validity ended on {}", f.response, f.valid_until)).collect()
    }

    /// Records it was fitted on that stand beside it and are no longer what they were.
    #[must_use]
    pub fn changed_sources(&self) -> Vec<String> {
        let fits = self.fits.iter().flat_map(|f| &f.from);
        let mut found = Vec::new();
        for source in fits.chain(self.listed.iter().flat_map(|l| &l.provenance.from)) {
            let folder = source.folder.clone().unwrap_or_default();
            let path = folder_of(&self.path).join(folder).join(&source.file);
            if let Ok(bytes) = rtec_files::text::bytes(&path)
                && hex(&Sha256::digest(bytes)) != source.sha256
            {
                found.push(format!("{} has changed since the model was fitted on it", source.file));
            }
        }
        found.dedup();
        found
    }

    /// The sensors that its effects and its chain read.
    #[must_use]
    pub fn sensors(&self) -> Vec<String> {
        let chain = self.chain.iter().flat_map(Chain::deltas);
        let deltas = self.effects().filter_map(|e| e.delta.as_ref()).chain(chain);
        let mut names: Vec<String> = deltas.flat_map(Difference::sensors).map(str::to_owned).collect();
        names.sort();
        names.dedup();
        names
    }

    /// Where a record asks the model beyond the range it was fitted on, effect by effect: the differences are held
    /// at the bound there.
    #[must_use]
    pub fn out_of_range(&self, record: &Record) -> Vec<String> {
        let mut found = Vec::new();
        for effect in self.effects() {
            let (Some([lo, hi]), Some(delta)) = (effect.range_k, &effect.delta) else { continue };
            let Some(asked) = differences(effect, record) else { continue };
            let outside = asked.iter().filter(|d| **d < lo || **d > hi).count();
            if outside > 0 {
                let share = 100.0 * outside as f64 / record.rows() as f64;
                found.push(format!(
                    "{} {delta}: {share:.1} % of the rows outside {lo:.2} to {hi:.2} K, held at the bound",
                    effect.name()
                ));
            }
        }
        found
    }
}

/// The (lagged) temperature difference that growth or lag asks for at every row, not held at any bound; `None` where the
/// record lacks it, and for other laws.
fn differences(effect: &Effect, record: &Record) -> Option<Vec<f64>> {
    if effect.delta.is_none() || effect.description().heat != Heat::Growth {
        return None;
    }
    let n = effect.coefficient_count();
    let bound = effect.bind(record).ok()?;
    let mut free = effect.clone();
    free.range_k = None;
    let mut basis = vec![0.0; n * bound.rows()];
    bound.basis(&free, 0, &mut basis);
    // The first basis column of growth and lag is the (lagged) difference itself.
    basis.truncate(bound.rows());
    Some(basis)
}

/// What a model says about a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Per response: its column's name and the sum of the effects at every row.
    pub columns: Vec<(String, Vec<f64>)>,
    /// Effects that read a quantity the record does not log: effect and role. It was taken as zero.
    pub taken_as_zero: Vec<(String, String)>,
}

const PROVENANCE: [&str; 4] = ["added_by", "date", "from", "interval"];

fn read_effect(table: Table<'_>, dictionary: &Dictionary) -> Result<Listed, InputError> {
    let entry = table.required("name", "the effect's name, as name = \"scale.x\"")?;
    let mut effect =
        dictionary.effect(entry.str("the effect's name")?).map_err(|e| entry.error(e.found, e.expected))?;
    let parameters: Vec<Parameter> = effect.description().parameters.clone();
    let thermal = effect.description().needs.contains(&Need::Delta);
    let mut known: Vec<&str> = vec!["name"];
    known.extend(parameters.iter().map(|p| p.name.as_str()));
    if thermal {
        known.extend(["sensor", "minus", "reference_degC", "range_K"]);
        if effect.description().lag.is_some() {
            known.push("start_K");
        }
    }
    known.extend(PROVENANCE);
    table.only(&known)?;

    if thermal {
        effect.delta = Some(read_difference(table)?);
        let range = "a pair [lowest, highest] of temperature differences in K";
        effect.range_k = table.get("range_K").map(|r| range_k(r, range)).transpose()?;
        effect.start_k =
            table.get("start_K").map(|e| e.within([0.0, MOST_K], "K, not below zero")).transpose()?;
    }

    let mut values: Vec<f64> = Vec::new();
    let mut width: Option<usize> = None;
    for p in &parameters {
        let given = match (table.get(&p.name), p.default) {
            (Some(e), _) if p.array => {
                let v = e.numbers(&format!("an array of numbers in {}", p.unit))?;
                if v.is_empty() || width.is_some_and(|w| w != v.len()) {
                    let expected =
                        width.map_or("at least one".to_owned(), |w| format!("{w}, as the other array has"));
                    return Err(e.error(format!("{} values in `{}`", v.len(), p.name), expected));
                }
                v
            }
            (Some(e), _) => vec![e.number(&format!("a number in {}", p.unit))?],
            (None, Some(default)) => vec![default],
            (None, None) => {
                let form = if p.array { "[…]" } else { "…" };
                let expected = format!("{} = {form} ({})", p.name, p.unit);
                return Err(entry.error(format!("no `{}` in effect `{}`", p.name, entry.text()), expected));
            }
        };
        width = Some(given.len());
        values.extend(given);
    }
    effect.set_values(&values).map_err(|e| {
        let place = table.get(&e.parameter).unwrap_or(entry);
        place.error(format!("{} = {}", e.parameter, e.found), e.expected)
    })?;

    let provenance = read_provenance(table, &effect)?;
    Ok(Listed { effect, provenance })
}

fn read_sources(table: Table<'_>) -> Result<Vec<Source>, InputError> {
    let Some(from) = table.get("from") else { return Ok(Vec::new()) };
    let form = "{ file = \"…\", sha256 = \"…\" }, or an array of them";
    let tables = from.table(form).map(|t| vec![t]).or_else(|_| from.tables(form))?;
    let read = |t: Table<'_>| {
        t.only(&["file", "sha256", "folder"])?;
        let get =
            |key: &str| -> Result<String, InputError> { Ok(t.required(key, form)?.str(form)?.to_owned()) };
        let folder = t.get("folder").map(|e| e.str("a folder, as seen from the model")).transpose()?;
        Ok(Source { file: get("file")?, sha256: get("sha256")?, folder: folder.map(PathBuf::from) })
    };
    tables.into_iter().map(read).collect()
}

const VALID: &str = "{ sensor = \"…\", minus = \"…\", range_K = [low, high], um_per_K = … }";

fn read_validity(t: Table<'_>) -> Result<Validity, InputError> {
    t.only(&["sensor", "minus", "reference_degC", "range_K", "um_per_K"])?;
    Ok(Validity {
        difference: read_difference(t)?,
        range_k: range_k(t.required("range_K", VALID)?, "a pair [lowest, highest] in K")?,
        um_per_k: t.required("um_per_K", VALID)?.within([-MOST_UM, MOST_UM], "µm/K")?,
    })
}

/// A temperature difference on a machine is no larger, K.
const MOST_K: f64 = 1000.0;
/// What is left of an error, or unknown of it, is no larger, µm.
const MOST_UM: f64 = 1e5;

fn range_k(entry: Entry<'_>, form: &str) -> Result<[f64; 2], InputError> {
    let pair = entry.pair(form)?;
    if pair.iter().all(|k| k.abs() <= MOST_K) {
        return Ok(pair);
    }
    Err(entry
        .error(format!("[{}, {}]", short(pair[0]), short(pair[1])), format!("{form}, within ±{MOST_K} K")))
}

/// A reference temperature: of a place where machines stand.
pub(crate) fn reference_degc(entry: Entry<'_>) -> Result<f64, InputError> {
    entry.within([-40.0, 150.0], "a reference temperature in degC")
}

/// `sensor` with `minus`, with `reference_degC`, or alone.
fn read_difference(table: Table<'_>) -> Result<Difference, InputError> {
    let sensor = table.required("sensor", "the sensor's name, as sensor = \"T8\"")?.str("a sensor's name")?;
    let against = match (table.get("minus"), table.get("reference_degC")) {
        (Some(_), Some(r)) => {
            return Err(r.key_error("`minus` and `reference_degC` both", "one of the two, or neither"));
        }
        (Some(m), None) => Against::Sensor(m.str("a sensor's name")?.to_owned()),
        (None, Some(r)) => Against::Reference(reference_degc(r)?),
        (None, None) => Against::Standard,
    };
    Ok(Difference { sensor: sensor.to_owned(), against })
}

fn read_fit(t: Table<'_>) -> Result<FitNote, InputError> {
    t.only(&["response", "date", "valid_until", "rms_um", "half_width_um", "valid", "at_mm", "from"])?;
    let text = |key: &str| Ok::<_, InputError>(t.required(key, "text")?.text());
    // A date that is none would never be past.
    let day = |key: &str| {
        let entry = t.required(key, "a day as YYYY-MM-DD")?;
        let text = entry.text();
        match date::parse(&text) {
            Some(_) => Ok(text),
            None => Err(entry.error(format!("`{text}`"), "a day as YYYY-MM-DD")),
        }
    };
    Ok(FitNote {
        response: text("response")?,
        date: day("date")?,
        valid_until: day("valid_until")?,
        rms_um: t.required("rms_um", "µm")?.within([0.0, MOST_UM], "µm")?,
        half_width_um: t
            .required("half_width_um", "µm")?
            .within([f64::MIN_POSITIVE, MOST_UM], "µm, above zero")?,
        valid: match t.get("valid") {
            Some(e) => e.tables(VALID)?.into_iter().map(read_validity).collect::<Result<_, _>>()?,
            None => Vec::new(),
        },
        at_mm: t.get("at_mm").map(read_places).transpose()?,
        from: read_sources(t)?,
    })
}

/// `{ x = [0.0, 300.0] }`.
fn read_places(entry: Entry<'_>) -> Result<BTreeMap<String, [f64; 2]>, InputError> {
    let form = "a range in mm for each axis, as at_mm = { x = [0.0, 300.0] }";
    let table = entry.table(form)?;
    let of = |e: Entry<'_>| {
        let [l, h] = e.pair(form)?;
        if l.abs().max(h.abs()) <= 1e6 {
            return Ok((e.key().to_owned(), [l, h]));
        }
        Err(e.error(format!("[{}, {}]", short(l), short(h)), "positions within ±1e6 mm"))
    };
    table.entries().map(of).collect()
}

fn read_provenance(table: Table<'_>, effect: &Effect) -> Result<Provenance, InputError> {
    let text = |key: &str| table.get(key).map(|e| e.str("text").map(str::to_owned)).transpose();
    let mut provenance = Provenance { added_by: text("added_by")?, ..Provenance::default() };
    // A date may be TOML's own or a string.
    provenance.date = table.get("date").map(|e| e.text());
    provenance.from = read_sources(table)?;
    if let Some(interval) = table.get("interval") {
        let form = "[low, high] per parameter, as interval = { um = [5.8, 6.4] }";
        for e in interval.table(form)?.entries() {
            let known = effect.value(e.key()).ok_or_else(|| e.unknown_key("a parameter of the effect"))?;
            let pairs = e.pairs(form)?;
            if pairs.len() != known.len() {
                return Err(
                    e.error(format!("{} intervals", pairs.len()), format!("{}, one per value", known.len()))
                );
            }
            provenance.interval.insert(e.key().to_owned(), pairs);
        }
    }
    Ok(provenance)
}

/// Replaces a value and keeps the comment behind it.
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

fn pairs(interval: &[[f64; 2]], array: bool) -> Value {
    let pair = |p: &[f64; 2]| Value::from(p.iter().copied().collect::<Array>());
    if array { interval.iter().map(pair).collect::<Array>().into() } else { pair(&interval[0]) }
}

/// One source as a table, several as an array of tables.
fn sources(from: &[Source]) -> Item {
    let source = |s: &Source| {
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
        t["sensor"] = value(&d.sensor);
        match &d.against {
            Against::Sensor(m) => t["minus"] = value(m),
            Against::Reference(degc) => t["reference_degC"] = value(*degc),
            Against::Standard => {}
        }
    }
    for (i, p) in effect.description().parameters.iter().enumerate() {
        t[&p.name] = value(numbers(effect.get(i), p.array));
    }
    if let Some([lo, hi]) = effect.range_k {
        t["range_K"] = value([lo, hi].into_iter().collect::<Array>());
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
    if !provenance.from.is_empty() {
        t["from"] = sources(&provenance.from);
    }
    if !provenance.interval.is_empty() {
        let mut interval = InlineTable::new();
        for (name, of) in &provenance.interval {
            let array = effect.description().parameters.iter().any(|p| p.name == *name && p.array);
            interval.insert(name, pairs(of, array));
        }
        t["interval"] = value(interval);
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    const LATHE: &str = "# my lathe\nname = \"demo lathe\"\n\n[[effect]]\nname = \"scale.x\"\nppm = 12.0 # measured in May\n\n\
                         [[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T8\"\nminus = \"T18\"\num_per_K = 0.114\n\
                         um_per_K2 = -0.0008\n";

    fn parse(text: &str) -> Result<Machine, InputError> {
        Machine::parse(Path::new("m.toml"), text)
    }

    /// Values that no machine has are refused where they stand, in few words.
    #[test]
    fn what_no_machine_has_is_refused_with_its_line() {
        for (line, found) in [
            ("name = \"scale.x\"\nppm = 1e300", "ppm = 1e300"),
            ("name = \"channel.x.z9\"\ngain = 1e300", "gain = 1e300"),
            ("name = \"screw_periodic.x\"\nperiod_mm = 10\num = 1\nphase_rad = 1e300", "phase_rad = 1e300"),
            ("name = \"position_map.x\"\nknots_mm = [0.0, 1e300]\num = [0, 1]", "knots_mm = 1e300"),
            ("name = \"form_bump\"\num = 1\nwidth_rad = 1\ncentre_rad = -1e300", "centre_rad = -1e300"),
            (
                "name = \"thermal_growth.x\"\num_per_K = 1\nsensor = \"T1\"\nreference_degC = 1e300",
                "reference_degC = 1e300",
            ),
            (
                "name = \"thermal_growth.x\"\num_per_K = 1\nsensor = \"T1\"\nrange_K = [0, 1e300]",
                "[0, 1e300]",
            ),
        ] {
            let text = format!("name = \"m\"\n[[effect]]\n{line}\n");
            let e = Machine::parse(Path::new("m.toml"), &text).unwrap_err();
            let last = text.lines().count();
            assert!(e.line > 2 && e.line <= last && e.found.contains(found), "{line}: {e}");
            assert!(e.to_string().len() < 300, "{e}");
        }
    }

    #[test]
    fn example_of_the_formats_reads() {
        let m = parse(LATHE).unwrap();
        assert_eq!(m.name(), "demo lathe");
        let names: Vec<String> = m.effects().map(Effect::name).collect();
        assert_eq!(names, ["scale.x", "thermal_growth.z"]);
        let growth = m.effects().nth(1).unwrap();
        assert_eq!(growth.delta, Some(Difference::pair("T8", "T18")));
        assert_eq!(growth.values(), [0.114, -0.0008]);
    }

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
            from: vec![Source { file: "y.csv".into(), sha256: "ab".into(), folder: None }],
            interval: [("um".to_owned(), vec![[5.8, 6.4]])].into(),
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
    fn findings_carry_their_place() {
        let head = "name = \"m\"\n[[effect]]\n";
        for (body, line, column, found) in [
            ("name = \"scale.x\"\n", 3, 8, "no `ppm`"),
            ("name = \"scales.x\"\nppm = 1\n", 3, 8, "`scales.x`"),
            ("name = \"scale\"\nppm = 1\n", 3, 8, "`scale`"),
            ("name = \"scale.x.y\"\nppm = 1\n", 3, 8, "`scale.x.y`"),
            ("name = \"squareness.x.x\"\nurad = 1\n", 3, 8, "`squareness.x.x`"),
            ("name = \"scale.x\"\nppm = nan\n", 4, 7, "ppm = nan"),
            ("name = \"scale.x\"\nppm = \"1\"\n", 4, 7, "ppm = \"1\""),
            ("name = \"scale.x\"\nppm = 1\npmp = 2\n", 5, 1, "unknown key pmp"),
            ("name = \"scale.x\"\nppm = 1\nsensor = \"T1\"\n", 5, 1, "unknown key sensor"),
            ("name = \"thermal_growth.x\"\num_per_K = 1\n", 2, 1, "no sensor"),
            (
                "name = \"thermal_growth.x\"\num_per_K = 1\nsensor = \"T1\"\nminus = \"T2\"\nreference_degC = 20\n",
                7,
                1,
                "both",
            ),
            ("name = \"screw_periodic.x\"\num = 1\nperiod_mm = 0.1\n", 5, 13, "period_mm = 0.1"),
            ("name = \"position_map.x\"\nknots_mm = [0, 0]\num = [1, 2]\n", 4, 12, "knots_mm"),
            ("name = \"position_map.x\"\nknots_mm = [0, 1]\num = [1]\n", 5, 6, "1 values"),
            ("name = \"probe_lobing\"\num = 1\nlobes = 2.5\n", 5, 9, "lobes = 2.5"),
            ("name = \"scale.x\"\nppm = 1\n[[effect]]\nname = \"scale.x\"\nppm = 2\n", 6, 8, "second time"),
            ("name = \"scale.x\"\nppm = 1\ninterval = { ppm = [2, 1] }\n", 5, 20, "ppm"),
            ("name = \"scale.x\"\nppm = = 1\n", 4, 7, "found"),
        ] {
            let e = parse(&format!("{head}{body}")).unwrap_err();
            assert_eq!((e.line, e.column), (line, column), "{body}: {e}");
            assert!(e.to_string().contains(found), "{body}: {e}");
        }
        assert!(parse("[[effect]]\nname = \"scale.x\"\nppm = 1\n").unwrap_err().found.contains("no name"));
        assert_eq!(parse("nam = \"x\"\n").unwrap_err().line, 1);
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
            crate::record::Kind::Positioning,
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
                Validity { difference: Difference::pair("T8", "T18"), range_k: [0.5, 9.0], um_per_k: 3.0 },
                Validity { difference: Difference::single("T9"), range_k: [-1.0, 2.0], um_per_k: 1.0 },
            ],
            at_mm: Some(BTreeMap::from([("x".to_owned(), [-10.0, 200.5])])),
            from: vec![Source { file: "a.csv".into(), sha256: "00".into(), folder: None }],
        });
        let again = Machine::parse(&dir.path().join("m.toml"), &m.to_text()).unwrap();
        assert_eq!(again.fits(), m.fits());
        assert_eq!(again.half_width_um("error.x"), Some(0.8));
        write("own.toml", &law.replace("quill_droop", "scale"));
        let e = Machine::read(&dir.path().join("m.toml")).unwrap_err();
        assert!(e.file.ends_with("own.toml") && e.line == 2, "{e}");
        write("own.toml", &law.replace("p_B", "p_C"));
        assert!(Machine::read(&dir.path().join("m.toml")).unwrap_err().found.contains("p_C"));
    }

    /// A model written into another folder goes on with the same chain, laws and records.
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
        let record = |file: &str| Source { file: file.into(), sha256: hash.clone(), folder: Some(at("a")) };
        let note = |from| FitNote {
            response: "error.x".into(),
            date: "2026-05-01".into(),
            valid_until: "2027-05-01".into(),
            rms_um: 0.4,
            half_width_um: 0.8,
            valid: Vec::new(),
            at_mm: None,
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
        // And home again.
        there.write(&at("a/again.toml")).unwrap();
        let text = std::fs::read_to_string(at("a/again.toml")).unwrap();
        assert!(text.contains("dictionary = \"own.toml\" # mine\nchain = \"parts/chain.toml\"\n"), "{text}");
        assert_eq!(text.matches("folder").count(), 0, "{text}");
    }

    #[test]
    fn a_fit_has_days_and_ends() {
        let fit = |date: &str, until: &str| {
            parse(&format!(
                "name = \"m\"\n[[fit]]\nresponse = \"error.x\"\ndate = {date}\nvalid_until = {until}\nrms_um = 1\n\
                 half_width_um = 2\n"
            ))
        };
        let day = |text: &str| date::parse(text).unwrap();
        let m = fit("2026-05-01", "\"2027-05-01\"").unwrap();
        assert!(m.expired(day("2027-05-01")).is_empty() && m.doubts(day("2026-05-01")).is_empty());
        assert_eq!(m.expired(day("2027-05-02")), ["error.x: the fit's validity ended on 2027-05-01"]);
        assert_eq!(m.doubts(day("2027-05-02")), m.expired(day("2027-05-02")));
        assert!(m.doubts(0)[0].contains("1970-01-01 by this machine's clock"), "{:?}", m.doubts(0));
        // What is no day would never end.
        let e = fit("\"2026-05-01\"", "\"soon\"").unwrap_err();
        assert_eq!((e.line, e.found.as_str(), e.expected.as_str()), (5, "`soon`", "a day as YYYY-MM-DD"));
        assert!(fit("\"1. Mai 2026\"", "\"2027-05-01\"").is_err());
    }

    #[test]
    fn one_name_twice_needs_another_sensor_period_knot_or_time() {
        let two =
            |a: &str, b: &str| parse(&format!("name = \"m\"\n[[effect]]\n{a}\n[[effect]]\n{b}\n")).is_ok();
        let growth = |s: &str| format!("name = \"thermal_growth.z\"\num_per_K = 1\n{s}");
        assert!(two(&growth("sensor = \"T1\""), &growth("sensor = \"T2\"")));
        assert!(two(&growth("sensor = \"T1\""), &growth("sensor = \"T1\"\nminus = \"T2\"")));
        assert!(!two(&growth("sensor = \"T1\""), &growth("sensor = \"T1\"\nreference_degC = 21")));
        let screw = |p: f64| format!("name = \"screw_periodic.z\"\num = 1\nperiod_mm = {p}");
        assert!(two(&screw(5.0), &screw(10.0)) && !two(&screw(5.0), &screw(5.0)));
        let lost = |t: f64| format!("name = \"lost_counts.z\"\num = 1\nat_s = {t}");
        assert!(two(&lost(5.0), &lost(10.0)) && !two(&lost(5.0), &lost(5.0)));
        let bump = |c: f64| format!("name = \"form_bump\"\num = 1\nwidth_rad = 0.5\ncentre_rad = {c}");
        assert!(two(&bump(1.0), &bump(2.0)) && !two(&bump(1.0), &bump(1.0)));
        let rotation = |n: &str| format!("name = \"rotation.{n}\"\nurad = 1");
        assert!(!two(&rotation("x.y"), &rotation("y.x")));
        let angular = |n: &str| format!("name = \"angular.{n}\"\nurad_per_m = 1");
        assert!(!two(&angular("x.y.z"), &angular("x.z.y")) && two(&angular("x.y.z"), &angular("y.x.z")));
    }
}
