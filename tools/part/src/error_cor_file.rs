//! `error.cor`: the file of a feature's errors.
//! Errors of an arc are by angle, those of a straight feature by place.

use crate::geometric_fit::Zx;
use rtec_files::InputError;
use rtec_files::file_kind::FileKind;
use rtec_model::record::span;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::path::Path;

/// The error of one point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PointError {
    /// Direction of the surface normal from the part's +Z axis, in rad.
    /// Along an arc it continues past ±π.
    pub angle_rad: f64,
    /// Deviation along that normal, in µm.
    /// Positive: the surface is further out than nominal, so there is too much material. In a hollow arc,
    /// whose normal points into the part, there is too little.
    pub error_um: f64,
    /// Place along a straight feature, in mm from the points' centroid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub along_mm: Option<f64>,
}

/// Largest error of a part, µm.
/// A form that is 10 mm off is another part (the same bound as of `form_bump`).
pub(crate) const MOST_UM: f64 = 10_000.0;
/// A whole turn, rounded up: larger angles are degrees.
pub(crate) const MOST_RAD: f64 = 6.3;
/// A kilometre: the bounds of every position, mm.
pub(crate) const MOST_MM: f64 = 1e6;
/// Largest distance of a straight feature's places from the line of its normal.
/// It is a share of the feature's length.
const ASKEW: f64 = 0.01;

/// A gap between angles that no arc has; it shows that the ends are out of order.
const NO_ARC_RAD: f64 = PI;

/// The same direction, at most half a turn from another one.
pub(crate) fn turned_near(angle_rad: f64, to_rad: f64) -> f64 {
    let off = angle_rad - to_rad;
    if off.abs() <= PI { angle_rad } else { to_rad + (off + PI).rem_euclid(TAU) - PI }
}

/// A feature's errors from an `error.cor`.
#[derive(Debug, Clone, PartialEq)]
pub enum FeatureErrors {
    /// Errors of an arc, angles ascending.
    Arc(Vec<PointError>),
    /// Errors of a straight feature, places ascending.
    Line(Vec<StraightFeaturePointError>),
}

/// One line of a straight feature's `error.cor`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StraightFeaturePointError {
    /// Direction of the surface normal from the part's +Z axis, in rad.
    pub angle_rad: f64,
    /// Deviation along that normal, in µm.
    /// Positive: the surface is further out than nominal, so there is too much material. In a hollow arc,
    /// whose normal points into the part, there is too little.
    pub error_um: f64,
    /// Place along the feature, in mm from the points' centroid.
    pub along_mm: f64,
    /// The surface there, in part coordinates.
    pub place: Zx,
}

impl FeatureErrors {
    /// Reads an `error.cor`: an arc has two numbers per line, a straight feature five.
    /// Blanks or a comma separate them. A spreadsheet's file is accepted too: semicolons or tabs, decimal
    /// commas, quotes, a line `sep=`. `#` starts a comment.
    ///
    /// # Errors
    /// A line with another count of numbers, or with numbers that no part has. Angles or places that do not
    /// ascend, or are not along the feature. No line at all.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        let (text, _) = rtec_files::text_file::decode_western(file, &rtec_files::text_file::bytes(file)?)?;
        Self::parse(file, &text)
    }

    /// As [`FeatureErrors::read`], from text; `file` is for messages.
    ///
    /// # Errors
    /// As [`FeatureErrors::read`].
    pub fn parse(file: &Path, text: &str) -> Result<Self, InputError> {
        units_said(file, text)?;
        let rows = rows(text);
        match rows.first() {
            None => Err(InputError::whole(file, "no line at all", ARC)),
            Some(first) if first.is_names() => {
                let expected = "numbers from the first line on: take the line of names out, once they are";
                Err(InputError::at(file, first.line, 1, first.text(), format!("{expected} {ARC}")))
            }
            Some(first) if first.words.len() == 5 => lines_of(file, &rows).map(Self::Line),
            Some(_) => arc_of(file, &rows).map(Self::Arc),
        }
        .map_err(|e| FileKind::instead_of(None, text, e))
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        match self {
            Self::Arc(errors) => errors.len(),
            Self::Line(errors) => errors.len(),
        }
    }

    /// Least and largest error, µm.
    pub fn range_um(&self) -> [f64; 2] {
        match self {
            Self::Arc(errors) => span(errors.iter().map(|e| e.error_um)),
            Self::Line(errors) => span(errors.iter().map(|e| e.error_um)),
        }
    }

    /// Always false: a file without a line is refused.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Checks the comments before the first line for other units.
///
/// # Errors
/// Angles in degrees, errors in mm.
fn units_said(file: &Path, text: &str) -> Result<(), InputError> {
    for (i, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() {
            continue;
        }
        let Some(comment) = line.strip_prefix('#') else { return Ok(()) };
        let comment = comment.to_lowercase();
        let has = |units: &[&str]| {
            comment.split(|c: char| !c.is_alphanumeric() && c != '°').any(|word| units.contains(&word))
        };
        let other = has(&["deg", "degree", "degrees", "°"]) && !has(&["rad"])
            || has(&["mm", "inch", "in"]) && !has(&["um", "µm", "μm"]);
        if other {
            return Err(InputError::at(file, i + 1, 1, format!("'{line}'"), ARC));
        }
    }
    Ok(())
}

/// The content of a line of an arc's file.
const ARC: &str = "angle in rad and error in µm";

/// A line that is not empty: its number and its words.
/// Numbers have decimal points.
struct LineWords {
    line: usize,
    words: Vec<String>,
}

impl LineWords {
    fn text(&self) -> String {
        format!("'{}'", self.words.join(" "))
    }

    /// Whether all words begin with a letter, so that the line has names.
    fn is_names(&self) -> bool {
        self.words.iter().all(|word| word.starts_with(char::is_alphabetic))
    }

    fn numbers<const N: usize>(&self, file: &Path, expected: &str) -> Result<[f64; N], InputError> {
        let numbers: Option<Vec<f64>> =
            self.words.iter().map(|w| w.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        let numbers = numbers.and_then(|n| <[f64; N]>::try_from(n).ok());
        numbers.ok_or_else(|| InputError::at(file, self.line, 1, self.text(), expected))
    }

    fn checked(&self, file: &Path, angle_rad: f64, error_um: f64) -> Result<(), InputError> {
        if angle_rad.abs() <= MOST_RAD && error_um.abs() <= MOST_UM {
            return Ok(());
        }
        let expected = format!(
            "an angle in rad, within ±{MOST_RAD} (are these degrees?), and an error within ±{MOST_UM} µm"
        );
        Err(InputError::at(file, self.line, 1, self.text(), expected))
    }
}

/// The lines with words.
/// A comma separates words, or is the decimal mark if the separator is another: semicolons, tabs, or blanks.
/// With blanks, commas are decimal marks if they are within words and no word has a point.
fn rows(text: &str) -> Vec<LineWords> {
    let contents = || {
        text.lines().enumerate().filter_map(|(i, line)| {
            let content = line.split('#').next().unwrap_or_default().trim();
            let is_empty = content.is_empty() || i == 0 && content.starts_with("sep=");
            (!is_empty).then_some((i + 1, content))
        })
    };
    let parts = |c: char| c == ';' || c == '\t' || c == ' ';
    let has_one_comma =
        |word: &str| word.matches(',').count() == 1 && !word.starts_with(',') && !word.ends_with(',');
    let is_decimal = contents().flat_map(|(_, line)| line.split(parts)).any(has_one_comma)
        && contents().all(|(_, line)| {
            let fits = |word: &str| !word.contains('.') && (!word.contains(',') || has_one_comma(word));
            line.contains(parts) && line.split(parts).all(fits)
        });
    let row = |(line, content): (usize, &str)| {
        let words = content.split(|c| parts(c) || c == ',' && !is_decimal).filter(|w| !w.is_empty());
        let word = |w: &str| {
            let bare = w.strip_prefix('"').and_then(|w| w.strip_suffix('"')).unwrap_or(w);
            bare.replace('\u{2212}', "-").replace(',', ".")
        };
        LineWords { line, words: words.map(word).collect() }
    };
    contents().map(row).collect()
}

fn arc_of(file: &Path, rows: &[LineWords]) -> Result<Vec<PointError>, InputError> {
    let mut errors: Vec<PointError> = Vec::new();
    for row in rows {
        let [angle_rad, error_um] = row.numbers(file, ARC)?;
        row.checked(file, angle_rad, error_um)?;
        if errors.last().is_some_and(|e| e.angle_rad >= angle_rad) {
            let found = format!("angle {angle_rad} after a larger or equal one");
            return Err(InputError::at(file, row.line, 1, found, "ascending angles"));
        }
        if let Some(before) = errors.last().filter(|e| angle_rad - e.angle_rad > NO_ARC_RAD) {
            let found = format!("angle {angle_rad} after {}, more than half a turn", before.angle_rad);
            let expected = "angles that go on along the arc, past 3.1416 where it does";
            return Err(InputError::at(file, row.line, 1, found, expected));
        }
        errors.push(PointError { angle_rad, error_um, along_mm: None });
    }
    Ok(errors)
}

fn lines_of(file: &Path, rows: &[LineWords]) -> Result<Vec<StraightFeaturePointError>, InputError> {
    let mut errors: Vec<StraightFeaturePointError> = Vec::new();
    for row in rows {
        let expected = "angle in rad, error in µm, place along the feature, Z and X in mm";
        let [angle_rad, error_um, along_mm, z, x] = row.numbers(file, expected)?;
        row.checked(file, angle_rad, error_um)?;
        if [along_mm, z, x].iter().any(|v| v.abs() > MOST_MM) {
            let expected = format!("places within ±{MOST_MM} mm");
            return Err(InputError::at(file, row.line, 1, row.text(), expected));
        }
        if errors.last().is_some_and(|e| e.along_mm >= along_mm) {
            let found = format!("place {along_mm} after a larger or equal one");
            return Err(InputError::at(file, row.line, 1, found, "ascending places"));
        }
        let place = Zx::new(z, x);
        if let Some(first) = errors.first() {
            // All are on one line, across one normal, at the stated distances.
            let (way, length_mm) = (place - first.place, along_mm - first.along_mm);
            let off_mm = way.dot(Zx::at_angle(first.angle_rad)).abs().max((way.norm() - length_mm).abs());
            if (angle_rad - first.angle_rad).abs() > ASKEW || off_mm > ASKEW * length_mm + 1e-3 {
                let expected = "one angle, and Z and X that go along the feature, across it";
                return Err(InputError::at(file, row.line, 1, row.text(), expected));
            }
        }
        errors.push(StraightFeaturePointError { angle_rad, error_um, along_mm, place });
    }
    if errors.len() < 2 {
        return Err(InputError::whole(file, "one point", "two points of a straight feature at least"));
    }
    Ok(errors)
}

/// Reads the `error.cor` of an arc.
///
/// # Errors
/// As [`FeatureErrors::read`], and the file of a straight feature.
pub fn read_arc(file: &Path) -> Result<Vec<PointError>, InputError> {
    match FeatureErrors::read(file)? {
        FeatureErrors::Arc(errors) => Ok(errors),
        FeatureErrors::Line(_) => {
            let expected = format!("those of an arc: {ARC}");
            Err(InputError::whole(file, "errors of a straight feature", expected))
        }
    }
}

/// The table of NISTIR 4854, section 5, as text.
/// It has one line per point, angles ascending: angle from the part's +Z axis in rad and error in µm.
pub fn error_cor(errors: &[PointError]) -> String {
    let mut sorted = errors.to_vec();
    sorted.sort_by(|a, b| a.angle_rad.total_cmp(&b.angle_rad));
    sorted.iter().fold(String::new(), |mut text, e| {
        let _ = writeln!(text, "{:.6} {:.3}", e.angle_rad, e.error_um);
        text
    })
}
