//! Reads `machine.toml`, strictly.

use super::Machine;
use super::fit_note::{EffectWithProvenance, FitNote, Provenance, SourceRecord, ValidTemperatureRange};
use crate::effect::{Dictionary, Effect, LawParameter, RequiredInput, read_difference};
use crate::file_kind::FileKind;
use crate::kinematic_chain::KinematicChain;
use crate::record::{RunKind, hex};
use rtec_files::InputError;
use rtec_files::date;
use rtec_files::file_format_stamp;
use rtec_files::strict_toml::{Document, Table, TomlKeyValue};
use rtec_files::text_file::short;
use sha2::{Digest, Sha256};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

impl Machine {
    /// Reads a machine model.
    /// Its laws are the built-in ones and those of the file that its key `dictionary` names.
    ///
    /// # Errors
    /// The first finding, with file, line and column.
    ///
    /// Findings: syntax, unknown key or effect, a parameter that is missing, not finite or outside its
    /// bounds, `minus` together with `reference_degC`, one effect twice.
    pub fn read(path: &Path) -> Result<Self, InputError> {
        let text = rtec_files::text_file::read(path)?;
        Self::parse(path, &text)
    }

    /// As [`Machine::read`], with the files that the model consists of, its own first.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn read_with_files(path: &Path) -> Result<(Self, Vec<PathBuf>), InputError> {
        let text = rtec_files::text_file::read(path)?;
        let files = RefCell::new(vec![path.to_owned()]);
        let machine = Self::parse_from(path, &text, Dictionary::default(), &|beside| {
            files.borrow_mut().push(beside.to_owned());
            rtec_files::text_file::read(beside)
        })?;
        Ok((machine, files.into_inner()))
    }

    /// As [`Machine::read`]; an ideal machine of this name without a file.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn read_or_ideal(path: Option<&Path>, name: &str) -> Result<Self, InputError> {
        path.map_or_else(|| Ok(Self::ideal(name)), Self::read)
    }

    /// As [`Machine::read`], from text.
    /// `path` is for messages and for relative paths in the file.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, InputError> {
        Self::parse_with(path, text, Dictionary::default())
    }

    /// As [`Machine::parse`], with a program's own laws beside the built-in ones.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse_with(path: &Path, text: &str, given: Dictionary) -> Result<Self, InputError> {
        Self::parse_from(path, text, given, &|beside| rtec_files::text_file::read(beside))
    }

    /// As [`Machine::parse_with`], for files that are held elsewhere.
    /// `read` gives the text of the dictionary and of the chain that the model names.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn parse_from(
        path: &Path,
        text: &str,
        given: Dictionary,
        read: &dyn Fn(&Path) -> Result<String, InputError>,
    ) -> Result<Self, InputError> {
        let mistaken = |e: InputError| FileKind::Model.finding(path, text, e);
        let doc = Document::parse(path, text).map_err(mistaken)?;
        let root = doc.root();
        root.only(&["name", "note", "dictionary", "chain", "fit", "effect", "format", "by"])
            .map_err(mistaken)?;
        file_format_stamp::check(&root)?;
        let name = root.required("name", "the machine's name, as name = \"…\"")?.str("the machine's name")?;
        if let Some(note) = root.get("note") {
            note.str("free text")?;
        }
        let mut hash = Sha256::new_with_prefix(text);
        // The files that it names are part of the hash.
        let mut beside = |key: TomlKeyValue, what: &str| {
            let name = key.str(what)?;
            let path = path.parent().unwrap_or(Path::new("")).join(name);
            // Of a file that cannot be read, the line that names it says more than its path.
            let text = read(&path).map_err(|e| match e.line {
                0 => key.error(format!("`{name}` ({})", e.found), e.expected),
                _ => e,
            })?;
            hash.update(&text);
            Ok((path, text))
        };
        let mut dictionary = given.clone();
        if let Some(own) = root.get("dictionary") {
            let (file, text) = beside(own, "a file of the project's own laws")?;
            dictionary.add_own(&file, &text)?;
        }
        let chain = match root.get("chain") {
            Some(e) => {
                let (file, text) = beside(e, "a file with a kinematic chain")?;
                Some(KinematicChain::parse(&file, &text)?)
            }
            None => None,
        };
        let sha256 = hex(&hash.finalize());
        let fits = root.get("fit").map(|e| e.tables("[[fit]] tables")).transpose()?.unwrap_or_default();
        let fits = fits.into_iter().map(read_fit).collect::<Result<Vec<_>, _>>()?;
        let mut listed: Vec<EffectWithProvenance> = Vec::new();
        let mut identities = BTreeSet::new();
        let tables =
            root.get("effect").map(|e| e.tables("[[effect]] tables")).transpose()?.unwrap_or_default();
        for table in tables {
            let next = read_effect(table, &dictionary)?;
            if !identities.insert(next.identity()) {
                let found = format!("effect `{}` a second time", next.effect.name());
                let expected = "one of a name, unless sensors, periods, knots or times differ";
                return Err(table.required("name", "")?.error(found, expected));
            }
            listed.push(next);
        }
        let name = name.to_owned();
        // This copy keeps comments for writing. The same text was parsed above.
        let doc = text.parse::<DocumentMut>().map_err(|e| {
            let at = e.span().map_or(0, |s| s.start);
            InputError::at_offset(path, text, at, e.message(), "TOML")
        })?;
        let (path, adopted) = (path.to_owned(), false);
        Ok(Self { path, sha256, name, listed, fits, chain, given, dictionary, adopted, doc })
    }
}

const PROVENANCE: [&str; 5] = ["added_by", "date", "from", "interval", "set_up"];

fn read_effect(table: Table<'_>, dictionary: &Dictionary) -> Result<EffectWithProvenance, InputError> {
    let entry = table.required("name", "the effect's name, as name = \"scale.x\"")?;
    let mut effect =
        dictionary.effect(entry.str("the effect's name")?).map_err(|e| entry.error(e.found, e.expected))?;
    let parameters: Vec<LawParameter> = effect.description().parameters.clone();
    let thermal = effect.description().needs.contains(&RequiredInput::Delta);
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
    Ok(EffectWithProvenance { effect, provenance })
}

fn read_sources(table: Table<'_>) -> Result<Vec<SourceRecord>, InputError> {
    let Some(from) = table.get("from") else { return Ok(Vec::new()) };
    let form = "{ file = \"…\", sha256 = \"…\" }, or an array of them";
    let tables = from.table(form).map(|t| vec![t]).or_else(|_| from.tables(form))?;
    let read = |t: Table<'_>| {
        t.only(&["file", "sha256", "folder"])?;
        let get =
            |key: &str| -> Result<String, InputError> { Ok(t.required(key, form)?.str(form)?.to_owned()) };
        let folder = t.get("folder").map(|e| e.str("a folder, as seen from the model")).transpose()?;
        Ok(SourceRecord { file: get("file")?, sha256: get("sha256")?, folder: folder.map(PathBuf::from) })
    };
    tables.into_iter().map(read).collect()
}

const VALID: &str = "{ sensor = \"…\", minus = \"…\", range_K = [low, high], um_per_K = … }";

fn read_validity(t: Table<'_>) -> Result<ValidTemperatureRange, InputError> {
    t.only(&["sensor", "minus", "reference_degC", "range_K", "um_per_K"])?;
    Ok(ValidTemperatureRange {
        difference: read_difference(t)?,
        range_k: range_k(t.required("range_K", VALID)?, "a pair [lowest, highest] in K")?,
        um_per_k: t.required("um_per_K", VALID)?.within([-MOST_UM, MOST_UM], "µm/K")?,
    })
}

/// The largest temperature difference that is accepted, K.
const MOST_K: f64 = 1000.0;

/// The largest remaining or unknown error that is accepted, µm.
const MOST_UM: f64 = 1e5;

/// A range whose ends are at most so large.
fn range(entry: TomlKeyValue<'_>, form: &str, most: f64, expected: &str) -> Result<[f64; 2], InputError> {
    let [low, high] = entry.pair(form)?;
    if low.abs().max(high.abs()) <= most {
        return Ok([low, high]);
    }
    Err(entry.error(format!("[{}, {}]", short(low), short(high)), expected))
}

fn range_k(entry: TomlKeyValue<'_>, form: &str) -> Result<[f64; 2], InputError> {
    range(entry, form, MOST_K, &format!("{form}, within ±{MOST_K} K"))
}

fn read_fit(t: Table<'_>) -> Result<FitNote, InputError> {
    let response = t.required("response", "text")?.text();
    let unit = FitNote::unit_of(&response);
    let [rms, half_width, by_kind] = FitNote::keys_of(&response);
    t.only(&["response", "date", "valid_until", rms, half_width, "valid", "at_mm", by_kind, "from"])?;
    // An invalid date would never expire.
    let day = |key: &str| {
        let entry = t.required(key, "a day as YYYY-MM-DD")?;
        let text = entry.text();
        match date::parse(&text) {
            Some(_) => Ok(text),
            None => Err(entry.error(format!("`{text}`"), "a day as YYYY-MM-DD")),
        }
    };
    Ok(FitNote {
        date: day("date")?,
        valid_until: day("valid_until")?,
        rms_um: t.required(rms, unit)?.within([0.0, MOST_UM], unit)?,
        half_width_um: t
            .required(half_width, unit)?
            .within([f64::MIN_POSITIVE, MOST_UM], &format!("{unit}, above zero"))?,
        valid: match t.get("valid") {
            Some(e) => e.tables(VALID)?.into_iter().map(read_validity).collect::<Result<_, _>>()?,
            None => Vec::new(),
        },
        at_mm: t.get("at_mm").map(read_places).transpose()?,
        by_kind_um: t.get(by_kind).map(read_kinds).transpose()?.unwrap_or_default(),
        from: read_sources(t)?,
        response,
    })
}

/// Reads `{ positioning = 1.5 }`.
fn read_kinds(entry: TomlKeyValue<'_>) -> Result<BTreeMap<String, f64>, InputError> {
    let form = "a half width by kind of run, as by_kind_um = { positioning = 1.5 }";
    let of = |e: TomlKeyValue<'_>| match RunKind::parse(e.key()) {
        Some(_) => Ok((e.key().to_owned(), e.within([f64::MIN_POSITIVE, MOST_UM], "a number above zero")?)),
        None => Err(e.error(format!("`{}`", e.key()), form)),
    };
    entry.table(form)?.entries().map(of).collect()
}

/// Reads `{ x = [0.0, 300.0] }`.
fn read_places(entry: TomlKeyValue<'_>) -> Result<BTreeMap<String, [f64; 2]>, InputError> {
    let form = "a range in mm for each axis, as at_mm = { x = [0.0, 300.0] }";
    let of = |e: TomlKeyValue<'_>| Ok((e.key().to_owned(), range(e, form, 1e6, "positions within ±1e6 mm")?));
    entry.table(form)?.entries().map(of).collect()
}

fn read_provenance(table: Table<'_>, effect: &Effect) -> Result<Provenance, InputError> {
    let text = |key: &str| table.get(key).map(|e| e.str("text").map(str::to_owned)).transpose();
    let mut provenance = Provenance { added_by: text("added_by")?, ..Provenance::default() };
    // A date may be TOML's own or a string.
    provenance.date = table.get("date").map(|e| e.text());
    provenance.from = read_sources(table)?;
    if let Some(e) = table.get("set_up") {
        provenance.set_up = e.bool("true for the zero of a gauge, which is no error of the machine")?;
        if provenance.set_up && !effect.description().may_be_set_up() {
            let found = format!("set_up of `{}`", effect.name());
            return Err(e.error(found, "set_up for a zero alone, as offset.z"));
        }
    }
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

#[cfg(test)]
mod tests {
    use super::super::test_machine::{LATHE, parse};
    use super::*;
    use crate::effect::TemperatureDifference;

    /// Values that no machine has are refused with their line, in few words.
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
    fn a_missing_file_is_named_by_the_line_that_asks_for_it() {
        for key in ["dictionary", "chain"] {
            let text = format!("name = \"m\"\n{key} = \"gone.toml\"\n");
            let said = Machine::parse(Path::new("nowhere/m.toml"), &text).unwrap_err().to_string();
            let begins = format!("nowhere/m.toml:2:{}: found `gone.toml` (No such file", key.len() + 4);
            assert!(said.starts_with(&begins), "{said}");
        }
        // What is wrong within such a file has its own place.
        let read = |_: &Path| Ok("nonsense\n".to_owned());
        let text = "name = \"m\"\nchain = \"c.toml\"\n";
        let e = Machine::parse_from(Path::new("m.toml"), text, Dictionary::default(), &read).unwrap_err();
        assert_eq!((e.file.as_path(), e.line), (Path::new("c.toml"), 1));
    }

    /// A model of so many effects that comparing all pairs would take too long.
    #[test]
    fn a_long_model_is_read_and_one_effect_twice_in_it_is_found() {
        let effect = |n: usize| {
            let period_um = 1.5 + n as f64 * 0.005;
            format!(
                "[[effect]]\nname = \"subdivision.x\"\num = 0.01\nphase_rad = 0\nperiod_um = {period_um}\n"
            )
        };
        let text = "name = \"long\"\n".to_owned() + &(0..20_000).map(effect).collect::<String>();
        assert_eq!(parse(&text).unwrap().effects().count(), 20_000);
        let e = parse(&(text + &effect(7))).unwrap_err();
        assert!(e.line == 100_003 && e.found.contains("`subdivision.x` a second time"), "{e}");
    }

    #[test]
    fn example_of_the_formats_reads() {
        let m = parse(LATHE).unwrap();
        assert_eq!(m.name(), "demo lathe");
        let names: Vec<String> = m.effects().map(Effect::name).collect();
        assert_eq!(names, ["scale.x", "thermal_growth.z"]);
        let growth = m.effects().nth(1).unwrap();
        assert_eq!(growth.delta, Some(TemperatureDifference::pair("T8", "T18")));
        assert_eq!(growth.values(), [0.114, -0.0008]);
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
            (
                "name = \"thermal_growth.x\"\num_per_K = 1\nsensor = \"T1\"\nminus = \"T1\"\n",
                6,
                9,
                "minus itself",
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
