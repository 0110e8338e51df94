//! An export: format, axis, and messages about the written table.

use super::linuxcnc::{LinuxcncCompFileFormat, LinuxcncLinearUnit};
use super::user_format::UserFormat;
use super::{
    CompensationCsvFormat, CompensationFormat, CompensationTable, FormatRequirements, LookupPosition,
    StaticErrors, TableRange, TableResidual, beckhoff, siemens_cec, siemens_enc_comp, usage,
};
use rtec_files::Result;
#[cfg(feature = "clap")]
use rtec_files::cli_option_parsers::one_of;
use rtec_files::date;
use rtec_model::machine::{FitNote, Machine};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

rtec_files::choice! {
    /// The formats and their names.
    pub enum ExportFormat {
        Linuxcnc = "linuxcnc", "`COMP_FILE` of type 0: nominal, forward and reverse position";
        LinuxcncType1 = "linuxcnc-type1", "`COMP_FILE` of type 1: nominal, forward and reverse trim";
        Ssfk = "ssfk",
            "Beckhoff TF5200 and ISG kernel: leadscrew error compensation `kw.ssfk.*`, both directions";
        Siemens = "siemens", "SINUMERIK: `$AA_ENC_COMP`, the mean of both directions";
        SiemensCec = "siemens-cec", "SINUMERIK: `$AN_CEC`, what the position of --along does to --axis";
        Csv = "csv", "`position_mm,error_up_um,error_down_um`";
        Own = "own", "A form of your own: --form";
    }
}

/// Options of an export.
#[derive(Debug, Clone)]
pub struct ExportRequest {
    /// The axis.
    pub axis: String,
    /// Range and accuracy.
    pub wanted: TableRange,
    /// Temperatures that the table is for, °C; other sensors are at 20 °C.
    pub temperatures_degc: Vec<(String, f64)>,
    /// Positions of the other axes, mm; axes not listed are at 0.
    pub at_mm: Vec<(String, f64)>,
    /// The format.
    pub to: ControllerTableFormat,
}

// The documentation of the fields is the help of `rtecctl model export`.
/// A format, and what its controller needs to know
#[derive(Debug, Clone)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
pub struct ControllerTableFormat {
    /// What to write
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&ExportFormat::ALL, &[]), default_value = "linuxcnc"))]
    pub format: ExportFormat,
    /// linuxcnc: the machine's `LINEAR_UNITS`
    #[cfg_attr(feature = "clap", arg(long, value_parser = one_of(&LinuxcncLinearUnit::ALL, &[]), default_value = "mm"))]
    pub unit: LinuxcncLinearUnit,
    /// The axis that the table goes along, where it is another: what squareness, straightness and sag make of `--axis`
    #[cfg_attr(feature = "clap", arg(long))]
    pub along: Option<String>,
    /// siemens-cec: that axis as the controller names it, as X1
    #[cfg_attr(feature = "clap", arg(long))]
    pub along_name: Option<String>,
    /// siemens-cec: number of the table
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 0))]
    pub table: u16,
    /// siemens-cec: which way a positive value moves the axis, as tried on the machine
    #[cfg_attr(feature = "clap", arg(long = "positive-moves", value_name = "POSITIVE_MOVES",
        value_parser = one_of(&UP_OR_DOWN, &[])))]
    pub positive_moves_up: Option<bool>,
    /// siemens, siemens-cec: the machine axis as the controller names it, as X1
    #[cfg_attr(feature = "clap", arg(long, required_if_eq("format", "siemens")))]
    pub axis_name: Option<String>,
    /// siemens: number of the encoder
    #[cfg_attr(feature = "clap", arg(long, default_value_t = 0))]
    pub encoder: u8,
    /// siemens, siemens-cec, and forms that want a zero there: the reference point, mm
    #[cfg_attr(feature = "clap", arg(long, required_if_eq("format", "siemens")))]
    pub reference_mm: Option<f64>,
    /// ssfk: the controller's logical axis number
    #[cfg_attr(feature = "clap", arg(long, required_if_eq("format", "ssfk")))]
    pub axis_number: Option<u16>,
    /// own: the file that describes the form
    #[cfg_attr(feature = "clap", arg(long, value_name = "FORM.toml", required_if_eq("format", "own")))]
    pub form: Option<PathBuf>,
}

/// Which way a positive value moves an axis, and whether that is up.
#[cfg(feature = "clap")]
const UP_OR_DOWN: [(&str, bool, &str); 2] = [("up", true, ""), ("down", false, "")];

/// An exported table.
#[derive(Debug, Clone)]
pub struct ExportedTable {
    /// The file's text.
    pub text: String,
    /// `{"axis", "points", …}`, as `rtecctl model export --json` prints it.
    pub document: Value,
    /// Warnings about its use.
    pub warnings: Vec<String>,
    /// What was written and its residual, one line each; the first names the file.
    pub notes: Vec<String>,
}

/// The value of an option that a format needs.
fn needed<T>(value: Option<T>, option: &str) -> Result<T> {
    value.ok_or_else(|| usage(format!("no --{option}"), format!("--{option} with this format")))
}

impl ControllerTableFormat {
    /// The format; it takes at most so many positions.
    fn format(&self, most: Option<usize>) -> Result<Box<dyn CompensationFormat>> {
        let linuxcnc = matches!(self.format, ExportFormat::Linuxcnc | ExportFormat::LinuxcncType1);
        if self.unit == LinuxcncLinearUnit::Inch && !linuxcnc {
            return Err(usage("--unit inch", "--unit with LinuxCNC's tables only; the others are in mm"));
        }
        let reference_mm = self.reference_mm.unwrap_or(0.0);
        if !reference_mm.is_finite() {
            return Err(usage(format!("--reference-mm {reference_mm}"), "a position in mm"));
        }
        let cannot_along = match self.format {
            ExportFormat::Linuxcnc | ExportFormat::LinuxcncType1 => Some(
                "COMP_FILE of LinuxCNC is looked up at the joint's own position: it cannot hold what another axis does to this one",
            ),
            ExportFormat::Ssfk => Some("kw.ssfk is looked up at the axis' own position"),
            ExportFormat::Siemens => Some("$AA_ENC_COMP is looked up at the axis' own position"),
            ExportFormat::SiemensCec | ExportFormat::Csv | ExportFormat::Own => None,
        };
        if let Some((along, why)) = self.along.as_ref().zip(cannot_along) {
            let expected = format!("--format siemens-cec, csv or own, or no --along: {why}");
            return Err(usage(format!("--along {along} with this format"), expected));
        }
        Ok(match self.format {
            ExportFormat::Linuxcnc | ExportFormat::LinuxcncType1 => Box::new(LinuxcncCompFileFormat {
                trims: self.format == ExportFormat::LinuxcncType1,
                unit: self.unit,
            }),
            ExportFormat::Ssfk => Box::new(beckhoff::BeckhoffSsfkFormat {
                axis_number: needed(self.axis_number, "axis-number")?,
                most: most.unwrap_or(beckhoff::MOST),
            }),
            ExportFormat::Siemens => Box::new(siemens_enc_comp::EncoderCompensationFormat {
                axis: needed(self.axis_name.clone(), "axis-name")?,
                reference_mm: needed(self.reference_mm, "reference-mm")?,
                encoder: self.encoder,
                most: most.unwrap_or(siemens_enc_comp::MOST),
            }),
            ExportFormat::SiemensCec => {
                needed(self.along.as_ref(), "along")?;
                let axis = needed(self.axis_name.clone(), "axis-name")?;
                let along = needed(self.along_name.clone(), "along-name")?;
                needed(self.reference_mm, "reference-mm")?;
                let Some(positive_moves_up) = self.positive_moves_up else {
                    let expected = "--positive-moves up or down, as tried on the machine: load a table of one value, say 0.05, and see; no \
                                    public manual says which";
                    return Err(usage("no --positive-moves", expected));
                };
                let (table, most) = (self.table, most.unwrap_or(siemens_cec::MOST));
                Box::new(siemens_cec::SagCompensationFormat {
                    axis,
                    along,
                    table,
                    reference_mm,
                    most,
                    positive_moves_up,
                })
            }
            ExportFormat::Csv => Box::new(CompensationCsvFormat),
            ExportFormat::Own => {
                let form = needed(self.form.as_deref(), "form")?;
                Box::new(UserFormat::parse(form, &rtec_files::text_file::read(form)?, reference_mm)?)
            }
        })
    }
}

impl ExportRequest {
    /// Exports the table of a model.
    ///
    /// # Errors
    /// The model has no such axis or lacks what the table needs; the format cannot hold it.
    pub fn of(&self, machine: &Machine) -> Result<ExportedTable> {
        let format = self.to.format(self.wanted.most)?;
        let errors = self.errors(machine)?;
        let mut rules = format.rules();
        if self.to.along.is_some() {
            // The table does not move the axis that it is looked up at.
            rules = FormatRequirements { lookup: LookupPosition::Encoder, both: false, ..rules };
        }
        let table = CompensationTable::of(&errors, &self.wanted, &rules)?;
        let text = format.text(&table)?;
        let mut warnings = machine.doubts(date::today());
        warnings.extend(errors.doubts()?);
        let along = self.to.along.as_ref().unwrap_or(&self.axis);
        warnings.extend(range_warnings(machine, &self.axis, along, [self.wanted.from_mm, self.wanted.to_mm]));
        warnings.extend(self.coarse(&table, rules.both));
        let (left, points, held) = (table.left, table.points.len(), errors.temperatures_degc()?);
        let spike_um = errors.behind_turn_um(f64::midpoint(self.wanted.from_mm, self.wanted.to_mm))?;
        let beside =
            format!("; right behind a turn up to {spike_um:.2} um more, which no table of positions holds");
        let beside = if spike_um > 0.0 { &beside } else { "" };
        let TableResidual { max_up_um: up, max_down_um: down, rms_um: rms } = left;
        let (axis, step_mm, [start, end]) =
            (&table.axis, table.step_mm, [table.start_mm(), table.end_mm()].map(short));
        let across = self.to.along.as_ref().map_or(String::new(), |along| format!(" along {along}"));
        let most = format!("{up:.2} um moving up and {down:.2} um moving down, {rms:.2} um RMS");
        let mut notes = vec![
            format!("axis {axis}{across}, {points} positions, {step_mm:.4} mm apart, {start} to {end} mm"),
            format!("it leaves of the model at most {most}{beside}"),
        ];
        if !held.is_empty() {
            let of = |(name, degc): &(&str, f64)| format!("{name} {degc}");
            let all = held.iter().map(of).collect::<Vec<_>>().join(", ");
            notes.push(format!("it holds at these temperatures: {all} degC; --temperatures states others"));
        }
        if table.constant_um != 0.0 {
            let um = table.constant_um;
            notes.push(format!("{um:+.2} um were taken out to make it zero at the reference point"));
        }
        notes.extend(format.advice(&table));
        let document = json!({
            "axis": table.axis.as_str(), "along": along, "points": points, "step_mm": table.step_mm,
            "from_mm": table.start_mm(), "to_mm": table.end_mm(),
            "max_up_um": left.max_up_um, "max_down_um": left.max_down_um, "rms_um": left.rms_um,
            "between_um": table.between_um, "behind_turn_um": spike_um, "constant_um": table.constant_um, "warnings": warnings,
            "temperatures_degC": held.iter().copied().collect::<BTreeMap<&str, f64>>(),
        });
        Ok(ExportedTable { text, document, warnings, notes })
    }

    /// The model's errors along the axis, or along `along`.
    fn errors<'m>(&self, machine: &'m Machine) -> Result<StaticErrors<'m>> {
        let Some(along) = &self.to.along else {
            return StaticErrors::of(machine, &self.axis, &self.temperatures_degc, &self.at_mm);
        };
        let (own, others): (Vec<_>, Vec<_>) = self.at_mm.iter().cloned().partition(|(a, _)| *a == self.axis);
        if others.iter().any(|(a, _)| a == along) {
            return Err(usage(format!("--at {along} beside --along {along}"), "the place of other axes"));
        }
        StaticErrors::of(machine, &self.axis, &self.temperatures_degc, &others)?
            .across(along, own.first().map_or(0.0, |(_, mm)| *mm))
    }

    /// Warnings about a table that is coarser than asked for.
    fn coarse(&self, table: &CompensationTable, both: bool) -> Vec<String> {
        let (limit_um, to_mm, mut found) = (self.wanted.limit_um, self.wanted.to_mm, Vec::new());
        if table.between_um > limit_um {
            let no_more = "the format takes no more positions";
            let finer = self.wanted.step_mm.map_or(no_more, |_| "a smaller --step, or none");
            found.push(format!(
                "between its positions the table is up to {:.2} um off the model, more than the limit of {limit_um} um: {finer}",
                table.between_um
            ));
        }
        if table.end_mm() > to_mm + 1e-9 {
            let (end, step) = (short(table.end_mm()), table.step_mm);
            let why = format!("equal steps of {step:.4} mm do not end there");
            found.push(format!("its last position, {end} mm, is past --to {to_mm} mm: {why}"));
        }
        if table.left.max_um() > table.between_um + limit_um {
            let most = table.points.iter().map(|p| p.up_um.abs().max(p.down_um.abs())).fold(0.0, f64::max);
            let left = format!("up to {:.2} um", table.left.max_um());
            found.push(if both {
                format!("applied, it leaves {left}: the table moves the drive by up to {most:.0} um, and the error there is another")
            } else {
                format!("one value serves both directions: what they differ by stays, {left} in each")
            });
        }
        found
    }
}

/// Warnings about a table beyond the range that the model was stated or fitted on.
fn range_warnings(machine: &Machine, axis: &str, along: &str, [from, to]: [f64; 2]) -> Vec<String> {
    let mut found = machine.beyond_stated(|a| {
        (a.as_str() == along).then(|| (0..=100).map(|k| from + (to - from) * f64::from(k) / 100.0).collect())
    });
    let seen = machine.fits().iter().filter(|f| f.response == format!("error.{axis}"));
    for [lo, hi] in seen.filter_map(|f| f.at_mm.as_ref()?.get(along).copied()) {
        if !FitNote::reaches([lo, hi], [from, to]) {
            found.push(format!(
                "the model was fitted from {lo:.1} to {hi:.1} mm of {along}, and the table goes from {from} to {to} mm: no record has shown what the \
                 axis does there"
            ));
        }
    }
    found
}

/// A position in mm to the nanometre: 203.2, not 203.200 000 000 000 02.
fn short(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}
