//! Conditions of a test, from a file beside the records, and its uncertainty.
//!
//! ```toml
//! machine = "machining centre 12"       # free words: machine, axis, place, operator, date
//! operator = "N. N."
//! [instrument]                           # free words
//! name = "laser interferometer"
//! serial = "123"
//! [test]                                 # free words and numbers: feed, dwell, warm-up, tool offset, travel
//! feed_mm_per_min = 1000
//! [thermal]                              # lengths are reduced to 20 °C with these sensors and coefficients
//! scale = { sensor = "T3", ppm_per_K = 8.5 }
//! workpiece = { sensor = "T5", ppm_per_K = 11.5 }
//! [air]                                  # a laser's path; left out, the lengths are as the instrument compensated them
//! sensor = "T18"                         # or degC = 21.3
//! kPa = 99.8
//! rh_percent = 45
//! assumed_degC = 20.0                    # what the instrument compensated for
//! assumed_kPa = 101.325
//! assumed_rh_percent = 50
//! dead_path_mm = 250.0
//! [uncertainty]                          # what is left out contributes nothing
//! device_um_per_m = 0.8                  # the calibration's, k = 2
//! misalignment_mm = 1.0
//! drift_um = 1.7
//! ```

use super::air_refraction::LaserPathAir;
use rtec_files::Result;
use rtec_files::strict_toml::{Document, Table, TomlKeyValue};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// The reference temperature of lengths, °C (ISO 1).
pub(crate) const REFERENCE_DEGC: f64 = 20.0;

/// A body that grows with its temperature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExpandingBody {
    /// The sensor on it.
    pub sensor: String,
    /// Its coefficient of linear expansion, ppm/K.
    #[serde(rename = "ppm_per_K")]
    pub ppm_per_k: f64,
}

/// Conditions of a test.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct TestConditions {
    /// Words about machine, place and people, and about the test, in the file's order.
    pub words: Vec<(String, String)>,
    /// Words about the instrument.
    pub instrument: Vec<(String, String)>,
    /// The machine's scale, for the reduction to 20 °C.
    pub scale: Option<ExpandingBody>,
    /// The body it was measured against: work piece or artefact.
    pub workpiece: Option<ExpandingBody>,
    /// The air along a laser's path.
    pub air: Option<LaserPathAir>,
    /// Half widths and expanded values by key; see [`PositioningUncertainty`].
    pub stated: BTreeMap<String, f64>,
}

/// The keys of `[uncertainty]` with their meaning.
const KEYS: [(&str, &str); 13] = [
    ("device_um", "the device's calibration, k = 2"),
    ("device_um_per_m", "the device's calibration in proportion to the length, k = 2"),
    ("misalignment_mm", "the device's offset from the axis' direction over the travel"),
    ("machine_temperature_K", "± of the machine's temperature"),
    ("machine_ppm_per_K", "the machine's expansion, as it was compensated"),
    ("machine_off_20_K", "the machine's largest distance from 20 °C"),
    ("machine_expansion_ppm_per_K", "± of the machine's coefficient of expansion"),
    ("device_temperature_K", "± of the device's temperature"),
    ("device_ppm_per_K", "the device's expansion, as it was compensated"),
    ("device_off_20_K", "the device's largest distance from 20 °C"),
    ("device_expansion_ppm_per_K", "± of the device's coefficient of expansion"),
    ("drift_um", "range of a drift test as long as the measurement (E_VE)"),
    ("set_up_um", "the set-up, k = 2"),
];

/// Keys that are needed together: a coefficient and its factor.
const PAIRS: [(&str, &str); 4] = [
    ("machine_temperature_K", "machine_ppm_per_K"),
    ("machine_off_20_K", "machine_expansion_ppm_per_K"),
    ("device_temperature_K", "device_ppm_per_K"),
    ("device_off_20_K", "device_expansion_ppm_per_K"),
];

impl TestConditions {
    /// Reads a file of conditions.
    ///
    /// # Errors
    /// The first finding, with file, line and column.
    pub fn read(path: &Path) -> Result<Self> {
        let text = rtec_files::text_file::read(path)?;
        Self::parse(path, &text)
    }

    /// Conditions from text; `path` is for messages.
    ///
    /// # Errors
    /// As [`TestConditions::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let doc = Document::parse(path, text)?;
        let root = doc.root();
        let mut found = Self::default();
        for entry in root.entries() {
            match (entry.key(), entry.as_table()) {
                ("instrument", Some(t)) => found.instrument = words(&t)?,
                ("test", Some(t)) => found.words.extend(words(&t)?),
                ("thermal", Some(t)) => {
                    t.only(&["scale", "workpiece"])?;
                    found.scale = t.get("scale").map(expansion).transpose()?;
                    found.workpiece = t.get("workpiece").map(expansion).transpose()?;
                }
                ("air", Some(t)) => found.air = Some(LaserPathAir::read(&t)?),
                ("uncertainty", Some(t)) => {
                    t.only(&KEYS.map(|k| k.0))?;
                    for (key, meaning) in KEYS {
                        let Some(e) = t.get(key) else { continue };
                        let v = e.number(meaning)?;
                        if v < 0.0 {
                            return Err(e.mismatch(format!("{meaning}: not below zero")));
                        }
                        // No device and no solid has such a value: it is in another unit.
                        if key.contains("_per_") && v != 0.0 && !(1e-3..=100.0).contains(&v) {
                            let expected = format!("{meaning}: 0.001 to 100, in the key's unit, or 0");
                            return Err(e.mismatch(expected));
                        }
                        let most = if key.ends_with("_mm") { LARGEST_MM } else { LARGEST_UM };
                        if !key.contains("_per_") && v > most {
                            return Err(e.mismatch(format!("{meaning}: at most {most}, in the key's unit")));
                        }
                        found.stated.insert(key.to_owned(), v);
                    }
                    for (one, other) in PAIRS.into_iter().flat_map(|(a, b)| [(a, b), (b, a)]) {
                        if let (Some(e), None) = (t.get(one), t.get(other)) {
                            let why = "the contributor is the product of both (0 where there is none)";
                            return Err(e.mismatch(format!("{other} beside it: {why}")));
                        }
                    }
                }
                (_, Some(_)) => {
                    let known = "instrument, test, thermal, air or uncertainty, or words as machine = \"…\"";
                    return Err(entry.unknown_key(known));
                }
                (key, None) => found.words.push((plain(key), word(&entry)?)),
            }
        }
        Ok(found)
    }

    /// Expanded uncertainties (k = 2) of a positioning test.
    /// `approaches` is the number from each side.
    pub fn uncertainty(&self, length_mm: f64, approaches: usize) -> Option<PositioningUncertainty> {
        (!self.stated.is_empty()).then(|| PositioningUncertainty::new(&self.stated, length_mm, approaches))
    }

    /// Uncertainty of the figures of a circle, if any contributor is stated.
    /// `scatter_um` is the standard deviation of one reading. Without a radius no length has an uncertainty.
    pub fn circle_budget(
        &self,
        radius_mm: Option<f64>,
        scatter_um: f64,
    ) -> Option<CircleAndDriftUncertainty> {
        self.budget(true, radius_mm, 0.0, scatter_um)
    }

    /// Uncertainty of the figures of a drift test, if any contributor is stated.
    /// `scatter_um` is the standard deviation of one reading.
    pub fn drift_budget(&self, scatter_um: f64) -> Option<CircleAndDriftUncertainty> {
        self.budget(false, None, get(&self.stated, "set_up_um"), scatter_um)
    }

    /// The budget of a circle, or else of a drift test.
    /// `set_up_um` is the contribution of the set-up to a difference.
    fn budget(
        &self,
        circle: bool,
        radius_mm: Option<f64>,
        set_up_um: f64,
        scatter_um: f64,
    ) -> Option<CircleAndDriftUncertainty> {
        let mut stated = self.stated.clone();
        stated.retain(|key, _| is_in_budget(key, circle));
        if stated.is_empty() {
            return None;
        }
        let mut contributors = along(&stated, radius_mm.unwrap_or(0.0));
        let square = |all: &[UncertaintyContributor]| all.iter().map(|c| c.u_um * c.u_um).sum::<f64>();
        let fixed = square(&contributors);
        let scatter =
            UncertaintyContributor { name: "scatter of a reading".to_owned(), u_um: 2.0 * scatter_um };
        let each: Vec<UncertaintyContributor> =
            [drift_of(&stated), scatter].into_iter().filter(|c| c.u_um > 0.0).collect();
        let anew = square(&each);
        contributors.extend(each);
        let difference = get(&stated, "device_um").powi(2) + set_up_um * set_up_um + 2.0 * anew;
        let length_um = radius_mm.map(|_| (fixed + anew).sqrt());
        Some(CircleAndDriftUncertainty { k: 2.0, contributors, difference_um: difference.sqrt(), length_um })
    }

    /// Keys of `[uncertainty]` that a circle, or else a drift test, does not use.
    pub(crate) fn not_in_budget(&self, circle: bool) -> Vec<&str> {
        self.stated.keys().map(String::as_str).filter(|key| !is_in_budget(key, circle)).collect()
    }
}

fn words(table: &Table<'_>) -> Result<Vec<(String, String)>> {
    table.entries().map(|e| Ok((plain(e.key()), word(&e)?))).collect()
}

/// A key as text: `feed_mm_per_min` becomes "feed (mm/min)".
fn plain(key: &str) -> String {
    const UNITS: [(&str, &str); 9] = [
        ("_mm_per_min", "mm/min"),
        ("_ppm_per_K", "ppm/K"),
        ("_degC", "°C"),
        ("_rpm", "rpm"),
        ("_min", "min"),
        ("_mm", "mm"),
        ("_um", "µm"),
        ("_h", "h"),
        ("_s", "s"),
    ];
    let in_unit =
        |(end, unit): &(&str, &str)| Some(format!("{} ({unit})", key.strip_suffix(end)?.replace('_', " ")));
    UNITS.iter().find_map(in_unit).unwrap_or_else(|| key.replace('_', " "))
}

fn word(entry: &TomlKeyValue<'_>) -> Result<String> {
    let number = entry.as_number().map(|n| n.to_string()).or(entry.as_bool().map(|b| b.to_string()));
    let text = entry.as_str().map(str::to_owned).or(number);
    // A date is written without quotes.
    let text = text.or_else(|| rtec_files::date::parse(&entry.text()).map(|_| entry.text()));
    text.ok_or_else(|| entry.mismatch("text or a number"))
}

/// Lowest coefficient of expansion of fibres and glass ceramics, ppm/K.
const SHRINKS_PPM_PER_K: f64 = -2.0;
/// Largest contributor in µm; a larger number is in another unit.
const LARGEST_UM: f64 = 500.0;
/// Largest contributor in mm.
const LARGEST_MM: f64 = 100.0;

fn expansion(entry: TomlKeyValue<'_>) -> Result<ExpandingBody> {
    const FORM: &str = "{ sensor = \"T3\", ppm_per_K = 8.5 }";
    let t = entry.table(FORM)?;
    t.only(&["sensor", "ppm_per_K"])?;
    let value = t.required("ppm_per_K", FORM)?;
    let ppm_per_k = value.number("the coefficient of expansion, ppm/K")?;
    // No solid expands by more; a smaller number than that of glass ceramics is in another unit.
    let size = ppm_per_k.abs();
    if ppm_per_k != 0.0 && !(1e-3..=100.0).contains(&size) || ppm_per_k < SHRINKS_PPM_PER_K {
        let expected = "a coefficient of 0.001 to 100 ppm/K, as steel's 11.5, or 0; below zero to -2 for what shrinks as it warms";
        return Err(value.mismatch(expected));
    }
    Ok(ExpandingBody { sensor: t.required("sensor", FORM)?.str("the sensor's name")?.to_owned(), ppm_per_k })
}

/// One contributor to an uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct UncertaintyContributor {
    /// Its name.
    pub name: String,
    /// Its expanded uncertainty (k = 2) over the travel, µm.
    #[serde(rename = "U_um")]
    pub u_um: f64,
}

/// Expanded uncertainties (k = 2) of the figures of ISO 230-2.
///
/// By the GUM: rectangular contributors (half the range over √3 is a standard uncertainty), added in squares,
/// k = 2. Contributors and their use follow ISO/TR 230-9, whose text was not available.
///
/// | contributor | U (k = 2) |
/// |---|---|
/// | device | √(`device_um`² + (`device_um_per_m`·L)²) |
/// | misalignment | (R²/2L)/√3: the cosine error is between zero and this |
/// | temperature of machine, of device | 2·α·L·Δθ/√3 |
/// | expansion of machine, of device | 2·∣θ − 20 °C∣·L·Δα/√3 |
/// | set-up | `set_up_um` |
/// | drift, `U_EVE` | E_VE/√3: a range, independent in every reading |
///
/// | figure | U (k = 2), with the first five as `U_L` |
/// |---|---|
/// | M | √(`U_L`² + `U_EVE`²/n): a difference of two means of both sides |
/// | E, E↑, E↓ | √(`U_L`² + 2·`U_EVE`²/n): a difference of two means |
/// | B, mean B | √(2/n)·`U_EVE` |
/// | R↑, R↓ | 2·`U_EVE`: four standard deviations, each longer by `U_EVE`/2 |
/// | R | √(U(R↑)² + U(B)²) |
/// | A, A↑, A↓ | √(U(E)² + U(R↑)²) |
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(non_snake_case)]
#[allow(missing_docs)] // the standard's own symbols
pub struct PositioningUncertainty {
    /// Coverage factor.
    pub k: f64,
    /// Length that it is for, mm.
    pub length_mm: f64,
    pub contributors: Vec<UncertaintyContributor>,
    pub A: f64,
    pub E: f64,
    pub R: f64,
    pub R_up: f64,
    pub B: f64,
    pub M: f64,
}

/// The stated value of a key; 0 if it is missing.
fn get(stated: &BTreeMap<String, f64>, key: &str) -> f64 {
    stated.get(key).copied().unwrap_or(0.0)
}

/// Contributors along a length that are not zero.
fn along(stated: &BTreeMap<String, f64>, length_mm: f64) -> Vec<UncertaintyContributor> {
    let get = |key: &str| get(stated, key);
    let (metres, root3) = (length_mm / 1000.0, 3.0_f64.sqrt());
    let cosine_um = get("misalignment_mm").powi(2) / (2.0 * length_mm.max(1e-9)) * 1000.0;
    let mut all = vec![
        ("device".to_owned(), get("device_um").hypot(get("device_um_per_m") * metres)),
        ("misalignment".to_owned(), cosine_um / root3),
    ];
    for (of, name) in [("machine", "of the machine"), ("device", "of the device")] {
        let at = |what: &str| get(&format!("{of}_{what}"));
        let grown = 2.0 * at("ppm_per_K") * metres * at("temperature_K") / root3;
        all.push((format!("temperature {name}"), grown));
        let unknown = 2.0 * at("off_20_K") * metres * at("expansion_ppm_per_K") / root3;
        all.push((format!("expansion {name}"), unknown));
    }
    all.push(("set-up".to_owned(), get("set_up_um")));
    let there = all.into_iter().filter(|(_, u_um)| *u_um > 0.0);
    there.map(|(name, u_um)| UncertaintyContributor { name, u_um }).collect()
}

/// Drift of one reading: a range, independent in every reading.
fn drift_of(stated: &BTreeMap<String, f64>) -> UncertaintyContributor {
    UncertaintyContributor { name: "drift (E_VE)".to_owned(), u_um: get(stated, "drift_um") / 3.0_f64.sqrt() }
}

/// Expanded uncertainties (k = 2) of the figures of a circle or of a drift test.
///
/// By the GUM alone, because no available standard defines a budget of these figures. `U_s` is twice the
/// standard deviation of one reading. D and H of a circle are means of several readings and scatter less.
///
/// | figure | U (k = 2) |
/// |---|---|
/// | G, H of a circle: differences of two readings of one bar | √(`device_um`² + 2·`U_EVE`² + 2·`U_s`²) |
/// | F, D of a circle: a bar's length R against the nominal one | √(`U_L`² + `U_EVE`² + `U_s`²), `U_L` as [`PositioningUncertainty`] has it over R, without misalignment |
/// | ranges and end − start of a drift test: differences of two readings | √(`device_um`² + `set_up_um`² + 2·`U_EVE`² + 2·`U_s`²) |
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CircleAndDriftUncertainty {
    /// Coverage factor.
    pub k: f64,
    /// Contributors in one reading.
    pub contributors: Vec<UncertaintyContributor>,
    /// Expanded uncertainty of a difference of two readings, µm.
    #[serde(rename = "U_difference_um")]
    pub difference_um: f64,
    /// The same for a length, µm; `None` for a drift test or an unknown radius.
    #[serde(rename = "U_length_um", skip_serializing_if = "Option::is_none")]
    pub length_um: Option<f64>,
}

/// Keys of `[uncertainty]` that a budget of differences uses.
const OF_DIFFERENCES: [&str; 3] = ["device_um", "set_up_um", "drift_um"];
/// The only key that a circle does not use.
const NOT_OF_CIRCLES: &str = "misalignment_mm";

/// Whether the budget of a circle, or else of a drift test, uses this key.
fn is_in_budget(key: &str, circle: bool) -> bool {
    if circle { key != NOT_OF_CIRCLES } else { OF_DIFFERENCES.contains(&key) }
}

impl PositioningUncertainty {
    fn new(stated: &BTreeMap<String, f64>, length_mm: f64, approaches: usize) -> Self {
        let mut contributors = along(stated, length_mm);
        let square: f64 = contributors.iter().map(|c| c.u_um * c.u_um).sum();
        let drift = drift_of(stated);
        let eve = drift.u_um;
        contributors.extend(Some(drift).filter(|c| c.u_um > 0.0));
        let n = approaches.max(1) as f64;
        let r_up = 2.0 * eve;
        let b = (2.0 / n).sqrt() * eve;
        let e = (square + 2.0 * eve * eve / n).sqrt();
        Self {
            k: 2.0,
            length_mm,
            contributors,
            A: e.hypot(r_up),
            E: e,
            R: r_up.hypot(b),
            R_up: r_up,
            B: b,
            M: (square + eve * eve / n).sqrt(),
        }
    }

    /// The uncertainty of a figure, by its symbol.
    pub fn of(&self, symbol: &str) -> Option<f64> {
        Some(match symbol {
            "A" | "A_up" | "A_down" => self.A,
            "E" | "E_up" | "E_down" => self.E,
            "R" => self.R,
            "R_up" | "R_down" => self.R_up,
            "B" | "B_mean" => self.B,
            "M" => self.M,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "machine = \"m 12\"\ndate = 2026-05-01\n[instrument]\nname = \"laser\"\n[test]\nfeed_mm_per_min = 1000\n\
                        [thermal]\nscale = { sensor = \"T3\", ppm_per_K = 8.5 }\n[uncertainty]\ndevice_um_per_m = 0.8\n\
                        drift_um = 1.7\nmisalignment_mm = 1.0\nmachine_ppm_per_K = 11.0\nmachine_temperature_K = 0.5\n";

    #[test]
    fn conditions_are_read_with_their_places() {
        let c = TestConditions::parse(Path::new("c.toml"), FILE).unwrap();
        assert_eq!(c.words[2], ("feed (mm/min)".to_owned(), "1000".to_owned()));
        assert_eq!(c.scale.as_ref().unwrap().sensor, "T3");
        for (from, to, line, found) in [
            ("drift_um", "drift", 11, "unknown key drift"),
            ("drift_um = 1.7", "drift_um = -1.7", 11, "drift_um = -1.7"),
            ("[test]", "[tests]", 5, "unknown key tests"),
            ("ppm_per_K = 8.5", "ppm = 8.5", 8, "unknown key ppm"),
            ("ppm_per_K = 8.5", "ppm_per_K = 8500.0", 8, "ppm_per_K = 8500"),
            ("ppm_per_K = 8.5", "ppm_per_K = 8.5e-6", 8, "ppm_per_K = "),
            ("ppm_per_K = 8.5", "ppm_per_K = -10.0", 8, "ppm_per_K = -10"),
            ("drift_um = 1.7", "drift_um = 3000.0", 11, "drift_um = 3000"),
            ("misalignment_mm = ", "misalignment_mm = 100", 12, "misalignment_mm = 100"),
            ("sensor = \"T3\"", "sensor = 3", 8, "sensor = 3"),
            ("machine_ppm_per_K = 11.0", "machine_ppm_per_K = 11e-6", 13, "machine_ppm_per_K = "),
            ("device_um_per_m = 0.8", "device_um_per_m = 0.8e-6", 10, "device_um_per_m = "),
            ("machine_ppm_per_K = 11.0\n", "", 13, "machine_temperature_K = 0.5"),
            ("machine_temperature_K = 0.5", "device_off_20_K = 3.0", 13, "machine_ppm_per_K = 11"),
        ] {
            let e = TestConditions::parse(Path::new("c.toml"), &FILE.replacen(from, to, 1)).unwrap_err();
            assert!(e.line == line && e.found.contains(found), "{e}");
        }
    }

    /// Calculated by hand for 1750 mm and five approaches.
    #[test]
    fn uncertainty_by_hand() {
        let c = TestConditions::parse(Path::new("c.toml"), FILE).unwrap();
        let u = c.uncertainty(1750.0, 5).unwrap();
        let root3 = 1.732_050_807_568_877_2;
        let device = 0.8 * 1.75;
        let misalignment = 1000.0 / 3500.0 / root3;
        let temperature = 2.0 * 11.0 * 1.75 * 0.5 / root3;
        let eve = 1.7 / root3;
        let names: Vec<&str> = u.contributors.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["device", "misalignment", "temperature of the machine", "drift (E_VE)"]);
        let square: f64 = device * device + misalignment * misalignment + temperature * temperature;
        let e = (square + 0.4 * eve * eve).sqrt();
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        near(u.E, e);
        near(u.R_up, 2.0 * eve);
        near(u.B, 0.4_f64.sqrt() * eve);
        near(u.A, (e * e + 4.0 * eve * eve).sqrt());
        near(u.M, (square + 0.2 * eve * eve).sqrt());
        // A circle of 150 mm: the same contributors over its radius, without misalignment.
        let b = c.circle_budget(Some(150.0), 0.0).unwrap();
        let (device, temperature) = (0.8 * 0.15, 2.0 * 11.0 * 0.15 * 0.5 / root3);
        near(b.difference_um, 2.0_f64.sqrt() * eve);
        near(b.length_um.unwrap(), (device * device + temperature * temperature + eve * eve).sqrt());
        let names: Vec<&str> = b.contributors.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(names, ["device", "temperature of the machine", "drift (E_VE)"]);
        assert_eq!(c.not_in_budget(true), ["misalignment_mm"]);
        // A scatter of 0.3 µm counts once in a length and twice in a difference, which has no radius.
        let s = c.circle_budget(Some(150.0), 0.3).unwrap();
        assert_eq!(s.contributors.last().unwrap().name, "scatter of a reading");
        near(s.difference_um, b.difference_um.hypot(0.6 * 2.0_f64.sqrt()));
        near(s.length_um.unwrap(), b.length_um.unwrap().hypot(0.6));
        let unknown = c.circle_budget(None, 0.3).unwrap();
        near(unknown.difference_um, s.difference_um);
        assert_eq!(unknown.length_um, None);
        // A drift test is a difference, independent of the length.
        let of = |text: &str| TestConditions::parse(Path::new("c.toml"), text).unwrap().drift_budget(0.3);
        let stated =
            "[uncertainty]\ndevice_um = 0.3\nset_up_um = 0.4\ndrift_um = 1.7\ndevice_um_per_m = 0.8\n";
        let d = of(stated).unwrap();
        near(d.difference_um, (0.09 + 0.16 + 2.0 * eve * eve + 2.0 * 0.36).sqrt());
        assert_eq!(d.length_um, None);
        assert_eq!(of("[uncertainty]\ndevice_um_per_m = 0.8\n"), None);
        assert_eq!(TestConditions::default().uncertainty(100.0, 5), None);
    }
}
