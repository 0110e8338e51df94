//! Recognises a file's kind, for messages if another kind was expected.
//!
//! Each kind has a mark: a magic number, the first words of an exchange format, the tables of a TOML file, or
//! the names of a CSV's columns.

use crate::input_error::InputError;
use std::path::Path;

/// Kinds of files that people may confuse; [`FileKind::name`] describes each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum FileKind {
    RunRecord,
    Model,
    Chain,
    Configuration,
    Profile,
    Form,
    Trace,
    Requests,
    Points,
    Batch,
    /// Any other table, for example the CSV of a run record.
    Table,
    Drawing,
    Vcd,
    Laser,
    Ecmc,
    Etalon,
    Shdr,
    Numbers,
    Workbook,
    Pdf,
    Compressed,
    Markup,
    Json,
    Picture,
    Program,
    ControllerTable,
    /// A drawing or a solid of another program, with the program's name.
    Cad(&'static str),
}

/// The first bytes of files that are not text.
const MAGIC: [(&[u8], FileKind); 8] = [
    (b"\x89PNG", FileKind::Picture),
    (b"\xff\xd8\xff", FileKind::Picture),
    (b"PK\x03\x04", FileKind::Workbook),
    (b"\xd0\xcf\x11\xe0", FileKind::Workbook),
    (b"%PDF-", FileKind::Pdf),
    (b"\x1f\x8b", FileKind::Compressed),
    (b"AutoCAD Binary DXF", FileKind::Drawing),
    (b"AC10", FileKind::Cad("an AutoCAD drawing (DWG)")),
];

const STL: FileKind = FileKind::Cad("triangles of a solid (STL)");

/// Whether bytes are a binary STL: 80 bytes of header, a count, 50 per triangle.
fn is_binary_stl(bytes: &[u8]) -> bool {
    let number = bytes.get(80..84).and_then(|n| n.try_into().ok()).map(u32::from_le_bytes);
    number.is_some_and(|n| n > 0 && bytes.len() as u64 == 84 + 50 * u64::from(n))
}

/// Number of lines that are examined: the beginning of a file shows its kind.
const LINES: usize = 2000;

/// Number of lines among which a controller's program has a block.
const BLOCKS: usize = 30;

/// Whether a line is a block of a program: `N10 G0 X5`, `G1X9`, `G21`.
/// A row of a table has a separator instead.
fn is_block(line: &str) -> bool {
    let word = |text: &str, letter: char| -> Option<usize> {
        let rest = text.strip_prefix(letter)?;
        let digits = rest.bytes().take_while(|b| b.is_ascii_digit() || *b == b'.').count();
        (digits > 0).then_some(1 + digits)
    };
    let numbered = word(line, 'N').map_or(line, |length| line[length..].trim_start());
    let behind = word(numbered, 'G').map(|length| numbered[length..].trim_start());
    behind.is_some_and(|rest| rest.is_empty() || rest.starts_with(|c: char| c.is_ascii_uppercase()))
        && !line.contains([',', ';', '\t', '|'])
}

impl FileKind {
    /// The kind of a file that is not text, from its first bytes.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let by_magic = MAGIC.iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, kind)| *kind);
        by_magic.or_else(|| is_binary_stl(bytes).then_some(STL))
    }

    /// The kind of a text, from what only that kind has; `None` if nothing is found.
    pub fn of(text: &str) -> Option<Self> {
        let text = text.trim_start_matches('\u{feff}');
        Self::of_bytes(text.as_bytes())
            .or_else(|| Self::by_first_words(text))
            .or_else(|| Self::by_tables(text))
    }

    fn by_first_words(text: &str) -> Option<Self> {
        let mut words = text.split_whitespace();
        let (first, second) = (words.next()?, words.next().unwrap_or_default());
        let line_1 = text.lines().next().unwrap_or_default();
        let lines = || text.lines().map(str::trim).filter(|l| !l.is_empty()).take(LINES);
        let any = |begins: &[&str]| lines().any(|l| begins.iter().any(|begin| l.starts_with(begin)));
        let is_shdr = |line: &str| {
            let time = line.split(['|', '@']).next().unwrap_or_default();
            line.contains('|') && time.len() >= 19 && time.as_bytes()[10] == b'T'
        };
        Some(match first {
            _ if first.starts_with("ISO-10303-21") => Self::Cad("a STEP file (ISO 10303-21)"),
            "solid" if text.contains("facet") => STL,
            _ if line_1.get(72..80) == Some("S      1") => Self::Cad("an IGES file"),
            _ if first.starts_with('<') && text.contains("<svg") => Self::Cad("a picture in SVG"),
            "0" if second == "SECTION" => Self::Drawing,
            // Comments of a drawing, group 999, may precede its sections.
            "999" if text.lines().map(str::trim).take(LINES).any(|l| l == "SECTION") => Self::Drawing,
            "$date" | "$version" | "$timescale" | "$comment" | "$scope" | "$var" => Self::Vcd,
            _ if first.starts_with("<?xml") || first.eq_ignore_ascii_case("<!doctype") => Self::Markup,
            _ if first.to_ascii_lowercase().starts_with("<html") => Self::Markup,
            _ if first.starts_with('{') || first.starts_with("[{") => Self::Json,
            "[" if second.starts_with('{') => Self::Json,
            "HEADER::" => Self::Laser,
            _ if lines().any(|l| l == "TARGET DATA::") => Self::Laser,
            _ if any(&["TGT_DATA[", "REF_DATA_"]) => Self::Ecmc,
            _ if any(&["Gridpoints"]) => Self::Etalon,
            _ if any(&["$AA_ENC_COMP", "$AN_CEC", "kw.ssfk"]) => Self::ControllerTable,
            _ if line_1.trim() == "%" || lines().take(BLOCKS).any(is_block) => Self::Program,
            _ if lines().find(|l| !l.starts_with('*')).is_some_and(is_shdr) => Self::Shdr,
            _ => return None,
        })
    }

    fn by_tables(text: &str) -> Option<Self> {
        let lines = || text.lines().map(str::trim);
        let heads = |names: &[&str]| lines().any(|l| names.iter().any(|n| l.starts_with(n)));
        let is_form = || heads(&["separator", "names"]) && !heads(&["file =", "file="]);
        let is_profile = || heads(&["[lines]"]) && heads(&["inputs =", "outputs =", "inputs=", "outputs="]);
        let kind = match () {
            () if heads(&["[columns]"]) => Some(if is_form() { Self::Form } else { Self::RunRecord }),
            () if heads(&["[[joint]]"]) => Some(Self::Chain),
            () if heads(&["[[effect]]", "[[fit]]", "effect ="]) => Some(Self::Model),
            () if heads(&["[[axis]]", "[card]"]) => Some(Self::Configuration),
            () if is_profile() => Some(Self::Profile),
            () => None,
        };
        if kind.is_some() {
            return kind;
        }
        let mut rows = lines().filter(|l| !l.is_empty() && !crate::message_text::is_comment(l));
        if are_rising_numbers(rows.clone()) {
            return Some(Self::Numbers);
        }
        let mut first = rows.next()?;
        if first.to_ascii_lowercase().starts_with("sep=") {
            first = rows.next()?;
        }
        if !first.contains([',', ';', '\t', '|']) || first.contains(['=', '[']) {
            return None;
        }
        let names: Vec<&str> =
            first.split([',', ';', '\t', '|']).map(|n| n.trim().trim_matches('"')).collect();
        let has = |kind: &Self| kind.columns().iter().all(|c| names.contains(c));
        let named = [Self::Trace, Self::Requests, Self::Points, Self::Batch].into_iter().find(has);
        Some(named.unwrap_or(Self::Table))
    }

    /// The name of the kind, and what shows it.
    pub fn name(self) -> &'static str {
        match self {
            Self::RunRecord => "a run record: it has [columns]",
            Self::Model => "a machine model: it lists effects",
            Self::Chain => "a kinematic chain: it has joints",
            Self::Configuration => "a configuration: it has axes or a card",
            Self::Profile => "a card's profile: it has inputs, outputs and lines",
            Self::Form => "the form of a table, for characterise import --form",
            Self::Trace => "a quadrature trace: it has columns t_ns, a, b",
            Self::Requests => "requested totals: it has columns t_ns, requested",
            Self::Points => "probed points: it has columns z_mm, x_mm",
            Self::Batch => "a batch of parts: it has columns part, feature",
            Self::Table => "a table of values",
            Self::Drawing => "a DXF drawing",
            Self::Vcd => "a value change dump (VCD)",
            Self::Laser => "data of a laser interferometer (.rtl, .rta)",
            Self::Ecmc => "ecmc's ISO 230-2 data",
            Self::Etalon => "Etalon's exchange format",
            Self::Shdr => "a log of SHDR lines (MTConnect)",
            Self::Numbers => {
                "lines of three numbers, as a compensation table of LinuxCNC: characterise import --format linuxcnc-comp0 reads it"
            }
            Self::Workbook => "a spreadsheet's own file (.xlsx, .ods, .xls) or a zip archive",
            Self::Pdf => "a PDF document",
            Self::Compressed => "a compressed file (gzip)",
            Self::Markup => "XML or HTML",
            Self::Json => "JSON",
            Self::Picture => "a picture",
            Self::Program => "a program for a controller (G-code)",
            Self::Cad(name) => name,
            Self::ControllerTable => "a compensation table that a controller loads (SINUMERIK, ISG)",
        }
    }

    fn expected(self) -> &'static str {
        match self {
            Self::RunRecord => {
                "a run record, NAME.run.toml: the sidecar that says what the columns of its CSV are"
            }
            Self::Model => "a machine model, machine.toml: a name and [[effect]] tables",
            Self::Configuration => "a configuration, rtec.toml: [machine], [card] and [[axis]] tables",
            Self::Profile => "a card's profile: inputs, outputs and [lines]",
            Self::Trace => "a quadrature trace: t_ns,a,b",
            Self::Requests => "requested totals: t_ns,requested",
            other => other.name(),
        }
    }

    /// Whether it is a CSV of any kind: a reader of any table accepts these.
    pub fn is_table(self) -> bool {
        matches!(self, Self::Trace | Self::Requests | Self::Points | Self::Batch | Self::Table)
    }

    /// How to get text from a file that is not text.
    pub(crate) fn as_text(self) -> &'static str {
        match self {
            Self::Workbook => "a text file: save the sheet as CSV",
            Self::Compressed => "a text file: unpack it first",
            Self::Drawing => "an ASCII DXF: save the drawing as one",
            _ => "a text file",
        }
    }

    /// The finding that a file is of kind `other` instead of this one.
    pub fn instead(self, path: &Path, other: Self) -> InputError {
        InputError::whole(path, other.name(), self.expected())
    }

    /// The finding of a reader of `self` that the file is of another kind.
    pub fn finding(self, path: &Path, text: &str, finding: InputError) -> InputError {
        match Self::of(text) {
            Some(other) if other != self && !(self == Self::Table && other.is_table()) => {
                self.instead(path, other)
            }
            _ => finding,
        }
    }

    /// The finding of another format's reader that the text is of a known kind.
    /// `own` is the reader's own kind, if it is one of these.
    pub fn instead_of(own: Option<Self>, text: &str, finding: InputError) -> InputError {
        match Self::of(text).filter(|kind| Some(*kind) != own && *kind != Self::Table) {
            Some(other) => InputError { found: other.name().to_owned(), ..finding },
            None => finding,
        }
    }

    /// Columns that only a table of this kind has.
    pub(crate) fn columns(self) -> &'static [&'static str] {
        match self {
            Self::Trace => &["t_ns", "a", "b"],
            Self::Requests => &["t_ns", "requested"],
            Self::Points => &["z_mm", "x_mm"],
            Self::Batch => &["part", "feature"],
            _ => &[],
        }
    }
}

/// Whether rows hold three numbers each between blanks, the first ones rising.
fn are_rising_numbers<'t>(rows: impl Iterator<Item = &'t str>) -> bool {
    let (mut last, mut seen) = (f64::NEG_INFINITY, 0);
    for row in rows.take(LINES) {
        let numbers: Option<Vec<f64>> = row.split_whitespace().map(|word| word.parse().ok()).collect();
        match numbers.as_deref() {
            Some([first, _, _]) if *first > last => (last, seen) = (*first, seen + 1),
            _ => return false,
        }
    }
    seen > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knows_a_binary_stl_by_its_length() {
        let mut bytes = vec![b' '; 84];
        bytes[80..].copy_from_slice(&2_u32.to_le_bytes());
        bytes.extend([7; 100]);
        assert_eq!(FileKind::of_bytes(&bytes), Some(STL));
        assert_eq!(FileKind::of_bytes(&bytes[..183]), None);
    }

    #[test]
    fn files_are_told_apart() {
        for (text, kind) in [
            (
                "file = \"a.csv\"\nkind = \"drift\"\n[columns]\nt = { role = \"time\" }\n",
                Some(FileKind::RunRecord),
            ),
            ("kind = \"drift\"\nseparator = \";\"\nnames = true\n[columns]\n", Some(FileKind::Form)),
            ("name = \"m\"\n\n[[effect]]\nname = \"scale.x\"\nppm = 1.0\n", Some(FileKind::Model)),
            ("tool_mm = [0, 0, 0]\n[[joint]]\nname = \"spindle\"\n", Some(FileKind::Chain)),
            ("# mine\n[machine]\nname = \"m\"\n[card]\nbackend = \"mock\"\n", Some(FileKind::Configuration)),
            ("name = \"c\"\ninputs = []\noutputs = []\n[lines]\n", Some(FileKind::Profile)),
            ("t,x,e\n0,1,2\n", Some(FileKind::Table)),
            ("sep=;\nt_ns;a;b\n0;0;1\n", Some(FileKind::Trace)),
            ("t_ns,requested\n0,4\n", Some(FileKind::Requests)),
            ("point,z_mm,x_mm\n", Some(FileKind::Points)),
            ("part;feature;nominal_mm;measured_mm\n", Some(FileKind::Batch)),
            ("  0\nSECTION\n  2\nENTITIES\n", Some(FileKind::Drawing)),
            ("999\nmade by x\n0\nSECTION\n", Some(FileKind::Drawing)),
            ("$timescale 1 ns $end\n$var wire 1 ! a $end\n", Some(FileKind::Vcd)),
            ("HEADER::\nFile type : rta\n", Some(FileKind::Laser)),
            ("UNIT=mm\nTGT_DATA[1]=0\n", Some(FileKind::Ecmc)),
            ("// head\n[EXX]\nGridpoints = {\n", Some(FileKind::Etalon)),
            ("2022-08-08T13:51:37.25Z|x|1.5\n", Some(FileKind::Shdr)),
            ("PK\u{3}\u{4}\n", Some(FileKind::Workbook)),
            ("<?xml version=\"1.0\"?>\n<a/>\n", Some(FileKind::Markup)),
            ("{\n  \"verdict\": \"named\"\n}\n", Some(FileKind::Json)),
            ("[{\"a\": 1}]\n", Some(FileKind::Json)),
            ("%\nO1000\nG0 X10 Z5\nM30\n", Some(FileKind::Program)),
            ("; turn it\nN10 G0 X5.0\nN20 G1 X4 F0.1\n", Some(FileKind::Program)),
            ("G21\nG28.2 Z\n", Some(FileKind::Program)),
            ("CHANDATA(1)\n$AA_ENC_COMP[0,0,AX1]=0.001\nM17\n", Some(FileKind::ControllerTable)),
            ("ISO-10303-21;\nHEADER;\n", Some(FileKind::Cad("a STEP file (ISO 10303-21)"))),
            ("AC1032\0\0", Some(FileKind::Cad("an AutoCAD drawing (DWG)"))),
            (&format!("{:72}S      1\n", "made by x"), Some(FileKind::Cad("an IGES file"))),
            ("solid part\n facet normal 0 0 1\n", Some(STL)),
            ("<?xml version=\"1.0\"?>\n<svg width=\"9\"/>\n", Some(FileKind::Cad("a picture in SVG"))),
            ("G1,G2,e\n0,1,2\n", Some(FileKind::Table)),
            ("M1;M2\n0;1\n", Some(FileKind::Table)),
            ("# mm\n0 0.001 0.002\n100\t0.0 0.0\n", Some(FileKind::Numbers)),
            ("0 0.001 0.002\n0 0.0 0.0\n", None),
            ("0 0.001\n100 0.0\n", None),
            ("t_ns|requested\n0|4\n", Some(FileKind::Requests)),
            ("name = \"ideal\"\n", None),
            ("", None),
        ] {
            assert_eq!(FileKind::of(text), kind, "{text}");
        }
        assert_eq!(FileKind::of_bytes(b"\x1f\x8b\x08\0"), Some(FileKind::Compressed));
        assert_eq!(FileKind::of_bytes(b"\x89PNG\r\n"), Some(FileKind::Picture));
    }

    #[test]
    fn a_reader_of_any_table_takes_those_of_known_names() {
        let (file, finding) =
            (Path::new("a"), || InputError::whole(Path::new("a"), "no column e", "a column e"));
        let of = |kind: FileKind, text: &str| kind.finding(file, text, finding()).found;
        assert_eq!(of(FileKind::Table, "t_ns,a,b\n"), "no column e");
        assert_eq!(
            of(FileKind::Trace, "t_ns,requested\n"),
            "requested totals: it has columns t_ns, requested"
        );
        assert_eq!(of(FileKind::Table, "0\nSECTION\n"), "a DXF drawing");
    }
}
