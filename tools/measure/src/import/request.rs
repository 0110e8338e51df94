//! Options of an import: the file, its format and contents.

use super::{ImportColumn, Sampling, TableSyntax, UserTableFormat, add_note};
use super::{any_text, cmm_plate, ecmc_dat, etalon, halsampler, linuxcnc_comp, rtl, shdr, table};
use crate::Sink;
use crate::compensation_export::linuxcnc::LinuxcncLinearUnit;
use crate::motion_from_positions::derive;
#[cfg(feature = "clap")]
use rtec_files::cli_option_parsers::one_of;
use rtec_files::file_kind::FileKind;
use rtec_files::{InputError, InputNotice, Result};
use rtec_model::ballbar_circle::Circle;
use rtec_model::record::{Axis, Record, RunKind};
use std::path::{Path, PathBuf};

rtec_files::choice! {
    /// The formats and their names.
    pub enum ImportFormat {
        EcmcDat = "ecmc-dat", "ecmc's ISO 230-2 data: `TGT_DATA`, `REF_DATA_FWD`, `REF_DATA_BWD`";
        LinuxcncComp0 = "linuxcnc-comp0",
            "LinuxCNC compensation file of type 0: nominal, forward, backward position";
        LinuxcncComp1 = "linuxcnc-comp1",
            "LinuxCNC compensation file of type 1: nominal, forward, backward correction";
        Csv = "csv",
            "A table with a header line, parted by commas, semicolons or tabs; --columns says what is in it";
        Own = "own", "A table as a file of your own describes it: --form";
        CmmPlate = "cmm-plate",
            "Coordinate measuring machine's table of holes: Meas X, Meas Y, Nom X, Nom Y, Nom D";
        Rtl = "rtl", "Renishaw .rtl of linear targets, as other programs read it";
        Etalon = "etalon", "Etalon exchange format: `[EXX] Gridpoints = { … }`";
        Halsampler = "halsampler", "What LinuxCNC's halsampler prints";
        Shdr = "shdr", "A log of `MTConnect`'s SHDR lines: TIME|KEY|VALUE";
    }
}

impl ImportFormat {
    /// The kind of file that content recognition reports for this format.
    fn kind(self) -> Option<FileKind> {
        match self {
            Self::EcmcDat => Some(FileKind::Ecmc),
            Self::Rtl => Some(FileKind::Laser),
            Self::Etalon => Some(FileKind::Etalon),
            Self::Shdr => Some(FileKind::Shdr),
            Self::LinuxcncComp0 | Self::LinuxcncComp1 | Self::Halsampler | Self::Own => {
                Some(FileKind::Numbers)
            }
            Self::Csv | Self::CmmPlate => None,
        }
    }
}

// The documentation of the fields is the help of `rtecctl characterise import`.
/// Options of an import
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct ImportRequest {
    /// The file to import
    pub file: PathBuf,
    /// What it is
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&ImportFormat::ALL, &[])))]
    pub format: ImportFormat,
    /// The axis that was measured (not for plates and tables)
    #[cfg_attr(feature = "clap", arg(long))]
    pub axis: Option<String>,
    /// csv, halsampler, shdr: columns with their roles, and the unit where it is not the role's own, as
    /// t=time:min,gz=error.z:mm; with a factor as volt=force.x:V*35.15=N. Columns of halsampler go by number, from 1
    #[cfg_attr(
        feature = "clap",
        arg(
            long,
            value_delimiter = ',',
            value_name = "NAME=ROLE[:UNIT]",
            required_if_eq_any([("format", "csv"), ("format", "halsampler"), ("format", "shdr")])
        )
    )]
    pub columns: Vec<String>,
    /// csv, halsampler, shdr: what kind of run it is
    #[cfg_attr(feature = "clap", arg(long, default_value = "drift"))]
    pub kind: String,
    /// csv: how numbers are written [default: a point; either where semicolons part the columns]
    #[cfg_attr(feature = "clap", arg(long = "decimal", value_name = "DECIMAL",
        value_parser = one_of(&POINT_OR_COMMA, &[])))]
    pub decimal_comma: Option<bool>,
    /// csv, halsampler, shdr: a log, which need not have a response
    #[cfg_attr(feature = "clap", arg(long))]
    pub log: bool,
    /// halsampler: seconds a sample
    #[cfg_attr(feature = "clap", arg(long, required_if_eq("format", "halsampler")))]
    pub period_s: Option<f64>,
    /// halsampler: written with -t, the sample's number in front
    #[cfg_attr(feature = "clap", arg(long))]
    pub numbered: bool,
    /// linuxcnc-comp: the machine's `LINEAR_UNITS`
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&LinuxcncLinearUnit::ALL, &[]), default_value = "mm"))]
    pub unit: LinuxcncLinearUnit,
    /// own: the file that describes the table
    #[cfg_attr(feature = "clap", arg(long, value_name = "FORM.toml", required_if_eq("format", "own")))]
    pub form: Option<PathBuf>,
    /// Add velocity and acceleration from the positions, where there are none
    #[cfg_attr(feature = "clap", arg(long))]
    pub derive: bool,
}

/// How numbers are written, and whether that is with a comma.
#[cfg(feature = "clap")]
const POINT_OR_COMMA: [(&str, bool, &str); 2] = [("point", false, ""), ("comma", true, "")];

impl ImportRequest {
    /// Reads the file as a record, with the circle of a ballbar run.
    /// The record is for the path `out` and is not written yet.
    ///
    /// # Errors
    /// The first finding in the file or in the options.
    pub fn read(&self, circle: Option<Circle>, out: &Path, say: Sink<'_>) -> Result<Record> {
        let file = self.file.as_path();
        let bytes = rtec_files::text_file::bytes(file)?;
        let text = if self.format == ImportFormat::Rtl {
            any_text(file, &bytes)?
        } else {
            let (text, encoding) = rtec_files::text_file::decode_western(file, &bytes)?;
            if let Some(encoding) = encoding {
                say(InputNotice::Note(format!("{}: read as {encoding}", file.display())));
            }
            text
        };
        // The record is not written yet, so its findings name the imported file.
        let of_file =
            |e: InputError| if e.file == out { InputError { file: file.to_owned(), ..e } } else { e };
        let instead = |e: InputError| {
            if e.file == file { FileKind::instead_of(self.format.kind(), &text, e) } else { e }
        };
        let mut record = self.of_text(&text, out).map_err(|e| instead(of_file(e)))?;
        // The file that will be written is a plain CSV.
        if let Some(written) = record.written.take() {
            say(InputNotice::Note(written));
        }
        if matches!(self.format, ImportFormat::LinuxcncComp0 | ImportFormat::LinuxcncComp1) {
            let unit =
                if self.unit == LinuxcncLinearUnit::Inch { "inches, written in mm and µm" } else { "mm" };
            let text = format!("positions and corrections were read in {unit}: --unit states another");
            say(InputNotice::Note(text));
        }
        if let Some(circle) = circle {
            record = record.with_circle(circle).map_err(|(found, expected)| {
                InputError::whole(Path::new("--radius-mm, --plane"), found, expected)
            })?;
        }
        if self.derive {
            for note in derive(&mut record) {
                say(InputNotice::Note(note.clone()));
                add_note(&mut record, &note);
            }
        }
        let csv = out.parent().unwrap_or(Path::new("")).join(&record.file);
        if same_file(&csv, file) || same_file(out, file) {
            let found = format!("--out {}: its CSV would be written over the file to import", out.display());
            return Err(InputError::whole(file, found, "another name or folder for --out"));
        }
        Ok(record)
    }

    fn of_text(&self, text: &str, out: &Path) -> Result<Record> {
        let file = self.file.as_path();
        let axis = || -> Result<Axis> {
            let name = self.axis.as_deref().unwrap_or_default();
            let found = if name.is_empty() { "no --axis".to_owned() } else { format!("--axis {name}") };
            Axis::new(name).ok_or_else(|| InputError::whole(file, found, "--axis with the axis' name"))
        };
        let columns = || {
            let usage = |(found, expected): (String, String)| {
                InputError::whole(Path::new("--columns"), found, expected)
            };
            if self.columns.is_empty() {
                return Err(usage(("no --columns".into(), "NAME=ROLE[:UNIT], as t=time:min".into())));
            }
            let of = |c: &String| ImportColumn::parse(c).map_err(usage);
            with_commas(&self.columns).iter().map(of).collect::<Result<Vec<_>, _>>()
        };
        let kind = || {
            let kinds = "positioning, drift, ballbar, plate, dynamics, probing, feed_sweep or part";
            let error = || InputError::whole(Path::new("--kind"), format!("`{}`", self.kind), kinds);
            RunKind::parse(&self.kind).ok_or_else(error)
        };
        let form = TableSyntax { decimal_comma: self.decimal_comma, log: self.log, ..TableSyntax::default() };
        Ok(match self.format {
            ImportFormat::EcmcDat => ecmc_dat(file, text, &axis()?, out)?,
            ImportFormat::LinuxcncComp0 | ImportFormat::LinuxcncComp1 => {
                let trims = self.format == ImportFormat::LinuxcncComp1;
                linuxcnc_comp(file, text, &axis()?, trims, self.unit, out)?
            }
            ImportFormat::Csv => table(file, text, &columns()?, &form, kind()?, out)?,
            ImportFormat::Own => {
                let path = self.form.as_deref().unwrap_or(Path::new("--form"));
                UserTableFormat::parse(path, &rtec_files::text_file::read(path)?)?.read(file, text, out)?
            }
            ImportFormat::CmmPlate => cmm_plate(file, text, out)?,
            ImportFormat::Rtl => rtl(file, text, &axis()?, out)?,
            ImportFormat::Etalon => etalon(file, text, &axis()?, out)?,
            ImportFormat::Halsampler => {
                let sampling =
                    Sampling { period_s: self.period_s.unwrap_or_default(), numbered: self.numbered };
                halsampler(file, text, &columns()?, &sampling, &form, kind()?, out)?
            }
            ImportFormat::Shdr => shdr(file, text, &columns()?, kind()?, self.log, out)?,
        })
    }
}

/// Joins the parts of column names that contain commas.
/// A part without `=` belongs to the next one.
fn with_commas(parts: &[String]) -> Vec<String> {
    let mut whole: Vec<String> = Vec::new();
    let mut is_open = false;
    for part in parts {
        match whole.last_mut().filter(|_| is_open) {
            Some(name) => *name = format!("{name},{part}"),
            None => whole.push(part.clone()),
        }
        is_open = whole.last().is_some_and(|name| !name.contains('='));
    }
    whole
}

/// Whether two paths lead to one existing file.
fn same_file(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}
