//! Part errors from probed points (NISTIR 4854, section 3).
//! The steps are probe tip, geometric-thermal correction, fit, `error.cor` and whiskers.

use crate::contour::folded_deg;
use crate::error_cor_file::{PointError, error_cor, turned_near};
use crate::geometric_fit::{
    self, FitError, FitShape, FittedShape, OutlierRejectionFit, RobustFit, Zx, sequence,
};
use crate::probe_path::{PathPoint, touches};
use crate::reading_resolution::written_step_mm;
use crate::repeated_touches::{self, RepeatedTouches};
use crate::turning_plane_svg::SvgDrawing;
use rtec_files::{ColumnAssignment, CsvTable, InputError};
use rtec_model::effect::{Effect, RequiredInput};
use rtec_model::live_evaluation::{AxisMotionState, LiveModel, MachineState, MachineStateLayout};
use rtec_model::machine::Machine;
use rtec_model::record::{Axis, span};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

/// Magnification of drawn error bars: 4 µm become 1 mm.
/// Source: NISTIR 4854, "CAD error display".
pub const MAGNIFICATION: f64 = 250.0;

/// The recorded points: the centre of the probe's tip at each trip.
#[derive(Debug, Clone)]
pub struct ProbedPoints {
    sheet: CsvTable,
    /// Centre of the tip, in mm.
    pub tip_centre: Vec<Zx>,
    /// Unit direction of motion at the trip, if recorded.
    pub approach: Option<Vec<Zx>>,
}

const COLUMNS: [&str; 8] =
    ["z_mm", "x_mm", "approach_z", "approach_x", "point", "t_s", "uncertainty_um", "feature"];

/// Finest step that a probe can resolve, µm.
const LEAST_STEP_UM: f64 = 0.1;

/// The nominal feature that was probed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NominalShape {
    /// A circle (hemisphere, fillet) of this radius.
    Circle {
        /// Nominal radius, in mm.
        radius_mm: f64,
    },
    /// A straight feature.
    /// It has a nominal inclination to the part's axis if a taper is requested.
    Line {
        /// Nominal angle to the Z axis, in degrees.
        taper_deg: Option<f64>,
    },
}

/// The robust fit beside the report's own.
#[derive(Debug, Clone, Serialize)]
pub struct RobustFitSummary {
    /// Centre of the circle `[z, x]` or centroid of the line, in mm.
    pub centre_mm: [f64; 2],
    /// Radius of the surface, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
    /// The robust fit's radius minus the nominal one, in µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_error_um: Option<f64>,
    /// Robust scale of the deviations of the points that belong to the shape, in µm.
    pub scale_um: f64,
    /// Points (rows from 0) with weight below one half.
    pub down_weighted: Vec<usize>,
    /// Deviations from the robust fit, in µm, in the order of the rows.
    pub errors_um: Vec<f64>,
}

/// The result of the fit. SDs are sample standard deviations (divisor n − 1).
#[derive(Debug, Clone, Serialize)]
pub struct PartErrorReport {
    /// The fitted shape: `circle` or `line`.
    pub feature: &'static str,
    /// Number of probed points.
    pub points: usize,
    /// Subtracted radius of the probe's tip, in mm.
    /// 0 means that the points were taken as on the surface.
    pub tip_mm: f64,
    /// Centre of the circle `[z, x]`, or centroid of the line, in mm.
    pub centre_mm: [f64; 2],
    /// Radius of the surface, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_mm: Option<f64>,
    /// Fitted minus nominal radius, in µm.
    /// For a straight feature it is the distance outside its expected points, if those were given. `errors`
    /// are without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_error_um: Option<f64>,
    /// Inclination of a straight feature to the Z axis, in degrees, −90 < angle ≤ 90.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inclination_deg: Option<f64>,
    /// Fitted minus nominal inclination, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inclination_error_deg: Option<f64>,
    /// Standard errors of the centre along Z and X, in µm.
    /// For a straight feature both are along its normal. `None` if the points do not determine them. All
    /// standard errors here use the scatter of all points. The second fit still holds the flanks of a form
    /// error, so its own scatter is too small.
    pub centre_standard_error_um: Option<[f64; 2]>,
    /// Standard error of the radius, in µm.
    /// For a straight feature it is that of its place along its normal.
    pub size_standard_error_um: Option<f64>,
    /// Standard error of the inclination, in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inclination_standard_error_deg: Option<f64>,
    /// Centre of the plain fit through all points, in mm.
    pub plain_centre_mm: [f64; 2],
    /// Radius of the plain fit through all points, in mm; circles only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plain_radius_mm: Option<f64>,
    /// Standard error of the plain fit's size, in µm.
    /// `None` if the points do not determine it.
    pub plain_size_standard_error_um: Option<f64>,
    /// Step in which the points are written, µm, if the points scatter by less.
    /// The standard errors include it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_um: Option<f64>,
    /// Places that were touched several times.
    /// The standard errors then count places, not touches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeats: Option<RepeatedTouches>,
    /// SD of all points about the plain fit, in µm.
    pub sd_before_um: f64,
    /// SD of the kept points about the second fit, in µm.
    pub sd_after_um: f64,
    /// Rows (from 0) that the second fit left out.
    pub rejected: Vec<usize>,
    /// Largest minus smallest error, in µm.
    pub form_um: f64,
    /// A robust fit as a check.
    pub robust: RobustFitSummary,
    /// Errors of all points about the second fit, in the order of the rows.
    pub errors: Vec<PointError>,
    /// Whether it was touched from inside: a fillet or a groove.
    /// The tool's nose then runs inside it.
    #[serde(skip)]
    pub hollow: bool,
    #[serde(skip)]
    outline: FittedShape,
}

impl ProbedPoints {
    /// Reads `z_mm,x_mm[,approach_z,approach_x]`.
    /// Other columns may be `point`, `t_s`, `uncertainty_um` and temperatures (`T8`, or `temperature.NAME`)
    /// for the off-line correction.
    ///
    /// # Errors
    /// As [`CsvTable::read`]; a direction without length; one approach column without the other.
    pub fn read(file: &Path) -> Result<Self, InputError> {
        Self::of(CsvTable::read(file, &COLUMNS, is_sensor)?)
    }

    /// As [`ProbedPoints::read`], with columns that the user has assigned.
    /// Words are such as `z_mm=3` or `x_mm=Radius`. Without words the columns have their own names.
    ///
    /// # Errors
    /// As [`ProbedPoints::read`]; an invalid word, a column that is missing.
    pub fn read_columns(file: &Path, columns: &[String]) -> Result<Self, InputError> {
        let columns = ColumnAssignment::parse(columns, &COLUMNS, is_sensor)?;
        Self::of(CsvTable::read_columns(file, &COLUMNS, is_sensor, &columns)?)
    }

    /// As [`ProbedPoints::read`], from text already in memory; `file` only names it.
    ///
    /// # Errors
    /// As [`ProbedPoints::read`].
    pub fn parse(file: &Path, text: &str) -> Result<Self, InputError> {
        Self::of(CsvTable::parse(file, text, &COLUMNS, is_sensor)?)
    }

    fn of(sheet: CsvTable) -> Result<Self, InputError> {
        let pair = |z: &str, x: &str| -> Result<Vec<Zx>, InputError> {
            Ok(sheet.numbers(z)?.into_iter().zip(sheet.numbers(x)?).map(|(z, x)| Zx::new(z, x)).collect())
        };
        let tip_centre = pair("z_mm", "x_mm")?;
        let has = |name: &str| sheet.names().iter().any(|n| n == name);
        if has("feature") {
            // One call has one radius, one tip and one side, so all points must be of one feature.
            let names = sheet.words("feature")?;
            if let Some(row) = names.iter().position(|n| *n != names[0]) {
                let found = format!("a point of {} among those of {}", names[row], names[0]);
                return Err(sheet.finding(row, found, "the points of one feature: a file for each"));
            }
        }
        let approach = if has("approach_z") || has("approach_x") {
            let mut unit = Vec::with_capacity(sheet.len());
            for (row, d) in pair("approach_z", "approach_x")?.into_iter().enumerate() {
                unit.push(d.unit().ok_or_else(|| {
                    sheet.finding(row, "an approach of length 0", "the direction of motion at the trip")
                })?);
            }
            Some(unit)
        } else {
            None
        };
        Ok(Self { sheet, tip_centre, approach })
    }

    /// How the file's format differs from the usual one.
    pub fn written(&self) -> Option<String> {
        self.sheet.written()
    }

    /// Adds the prediction of the machine's model to the recorded positions.
    /// The scale read nominal while the machine was off by the error. Probing itself runs uncorrected (NISTIR
    /// 4832, probing mode). The record's columns T0, T1, … are the sensors, `t_s` is the time, and its
    /// approach is the direction. `origin` is the machine's position at the part's zero.
    ///
    /// # Errors
    /// A sensor or channel that the model needs and the record does not have.
    pub fn correct_geometric_thermal(&mut self, machine: &Machine, origin: Zx) -> Result<(), InputError> {
        let sensors: Vec<String> = self.sheet.names().iter().filter(|n| is_sensor(n)).cloned().collect();
        let temperatures = sensors.iter().map(|n| self.sheet.numbers(n)).collect::<Result<Vec<_>, _>>()?;
        let bare = |n: String| n.strip_prefix(TEMPERATURE).map_or(n.clone(), str::to_owned);
        let sensors = sensors.into_iter().map(bare).collect();
        let times = self.sheet.optional("t_s")?;
        let axes = ["z", "x"].into_iter().filter_map(Axis::new).collect();
        let layout = MachineStateLayout { axes, sensors, channels: Vec::new() };
        let mut live = LiveModel::of(machine, layout).map_err(|m| {
            let found = format!("{} reads {}, the record has: {}", m.effect, m.what, m.has);
            InputError::whole(self.sheet.file(), found, "a column for every sensor of the model")
        })?;
        for row in 0..self.tip_centre.len() {
            let place = self.tip_centre[row] + origin;
            let approach = self.approach.as_ref().map_or(Zx::new(0.0, 0.0), |a| a[row]);
            let axis = |position_mm: f64, towards: f64| AxisMotionState {
                position_mm,
                direction: if towards.abs() < 1e-9 { 0.0 } else { towards.signum() },
                ..AxisMotionState::default()
            };
            let degc: Vec<f64> = temperatures.iter().map(|t| t[row]).collect();
            live.evaluate(&MachineState {
                t_s: times.as_ref().map_or(row as f64, |t| t[row]),
                axes: &[axis(place.z, approach.z), axis(place.x, approach.x)],
                temperatures_degc: &degc,
                ..MachineState::default()
            });
            if let [z_um, x_um] = *live.errors_um() {
                self.tip_centre[row] = self.tip_centre[row] + Zx::new(z_um, x_um) * 1e-3;
            }
        }
        Ok(())
    }

    /// Effects that are evaluated beyond the range that their values were stated on.
    pub fn beyond_stated(&self, machine: &Machine, origin: Zx) -> Vec<String> {
        let places = |of: fn(&Zx) -> f64| Some(self.tip_centre.iter().map(|p| of(&(*p + origin))).collect());
        machine.beyond_stated(|axis| match axis.as_str() {
            "z" => places(|p| p.z),
            "x" => places(|p| p.x),
            _ => None,
        })
    }

    /// Effects of a model whose inputs the points do not record.
    /// Such an input counts as zero; for the time it is the row's number.
    pub fn read_blind(&self, machine: &Machine) -> Vec<String> {
        let timed = self.sheet.names().iter().any(|n| n == "t_s");
        let blind = |need: &RequiredInput| match need {
            RequiredInput::Position(_) | RequiredInput::Delta | RequiredInput::Channel => false,
            RequiredInput::Direction => self.approach.is_none(),
            RequiredInput::Time => !timed,
            _ => true,
        };
        machine.effects().filter(|e| e.description().needs.iter().any(blind)).map(Effect::name).collect()
    }

    /// Line of the first point at exactly 0, 0.
    /// Such a point shows that no position was captured.
    pub fn at_zero(&self) -> Option<usize> {
        let row = self.tip_centre.iter().position(|p| p.z == 0.0 && p.x == 0.0)?;
        Some(self.sheet.line(row))
    }

    /// Checks that each trip is where it was expected.
    /// `expected` are the tip's centres at the nominal part.
    ///
    /// # Errors
    /// A missing or surplus point, or the first trip further than `window_mm` from its place; both name the
    /// point. If another reading of the numbers puts all trips into their places, the finding names it.
    pub fn check_expected(&self, expected: &[Zx], window_mm: f64) -> Result<(), InputError> {
        if self.tip_centre.len() != expected.len() {
            let away = self.tip_centre.iter().zip(expected).position(|(p, e)| (*p - *e).norm() > window_mm);
            let point = away.unwrap_or(self.tip_centre.len().min(expected.len())) + 1;
            let trips = self.tip_centre.len();
            let found = format!("{trips} trips, the first that is not in its place is point {point}");
            let expected = format!("{} trips: one was missed or doubled", expected.len());
            return Err(InputError::whole(self.sheet.file(), found, expected));
        }
        for (row, (&p, &e)) in self.tip_centre.iter().zip(expected).enumerate() {
            let off_mm = (p - e).norm();
            if off_mm > window_mm {
                let found = format!("point {} tripped {off_mm:.3} mm from its expected place", row + 1);
                let hint = self.otherwise(expected, window_mm).map_or_else(String::new, |h| format!(": {h}"));
                return Err(self.sheet.finding(row, found, format!("a trip within {window_mm} mm{hint}")));
            }
        }
        Ok(())
    }

    /// A mistake in reading the numbers that explains every trip, in words.
    fn otherwise(&self, expected: &[Zx], window_mm: f64) -> Option<&'static str> {
        const INCH: f64 = 25.4;
        type Slip = fn(Zx) -> Zx;
        let inches =
            "with 25.4 times the places expected every trip is; are they in inches (--path-units inch)?";
        let slips: [(&str, Slip); 4] = [
            ("with z_mm and x_mm exchanged every trip is", |p| Zx::new(p.x, p.z)),
            ("with half of x_mm every trip is; are these diameters?", |p| Zx::new(p.z, p.x / 2.0)),
            (inches, |p| p * (1.0 / INCH)),
            ("with 25.4 times the points every trip is; are they in inches?", |p| p * INCH),
        ];
        let fits = |slip: Slip| {
            self.tip_centre.iter().zip(expected).all(|(p, e)| (slip(*p) - *e).norm() <= window_mm)
        };
        slips.into_iter().find(|(_, slip)| fits(*slip)).map(|(said, _)| said)
    }

    /// Whether the points are on a straight line rather than on an arc.
    /// A circle that explains them hardly better than a line does not count, because noise determines its
    /// radius. A very flat circle does not count either, unless an arc was `expected`, because straight
    /// features are often bowed.
    ///
    /// # Errors
    /// Too few points to decide, or points that determine no shape.
    pub fn is_straight(&self, expected: bool) -> Result<bool, InputError> {
        let points = &self.tip_centre;
        let spread = |shape: FitShape| {
            geometric_fit::least_squares(shape, points, None)
                .map(|f| geometric_fit::sd(&geometric_fit::deviations_um(&f, points), |_| true))
        };
        if points.len() < 4 {
            return Err(self.undetermined(FitError::TooFew { found: points.len(), needed: 4 }));
        }
        let line_um = spread(FitShape::Line).map_err(|e| self.undetermined(e))?;
        let length_mm = points.iter().map(|p| (*p - points[0]).norm()).fold(0.0, f64::max);
        let bowed = match geometric_fit::least_squares(FitShape::Circle, points, None) {
            Ok(FittedShape::Circle { radius_mm, .. }) => !expected && radius_mm > BOWED * length_mm,
            _ => false,
        };
        // If no circle can be fitted, the points are exactly on a line.
        let straight = spread(FitShape::Circle).map_or(true, |circle_um| circle_um >= STRAIGHT * line_um);
        if straight && expected && points.len() >= ENOUGH_TO_DOUBT {
            // One false trip of millimetres spoils both fits equally, but not the robust fits.
            let of = |shape| geometric_fit::robust(shape, points).map(|r| r.scale_um);
            if let (Ok(circle_um), Ok(line_um)) = (of(FitShape::Circle), of(FitShape::Line)) {
                return Ok(circle_um >= STRAIGHT * line_um);
            }
        }
        Ok(bowed || straight)
    }

    /// Mean distance of the points outside the expected ones, along the normals, µm.
    /// For a straight feature this is its constant error, which its form does not include.
    pub fn outside_um(&self, report: &PartErrorReport, expected: &[Zx]) -> Option<f64> {
        let FittedShape::Line { normal, .. } = report.outline else { return None };
        // Each point's distance less its error is the distance of the fitted line. The mean of all would be
        // shifted by a bump.
        let off = self.tip_centre.iter().zip(expected).map(|(p, e)| (*p - *e).dot(normal) * 1e3);
        let line = off.zip(&report.errors).map(|(off, e)| off - e.error_um);
        Some(line.sum::<f64>() / self.tip_centre.len().min(expected.len()).max(1) as f64)
    }

    /// Part errors of a feature probed with a tip of radius `tip_mm`.
    /// Points beyond noise are left out of the fit ([`geometric_fit::beyond_noise`]).
    /// The tip touches where its surface is normal to the part's, whatever the direction of approach. The
    /// approach only shows the side. So the shape is fitted to the tip's centres and moved by the tip's
    /// radius.
    ///
    /// # Errors
    /// Too few or degenerate points; approaches from both sides of the surface or along it.
    pub fn errors(&self, nominal: NominalShape, tip_mm: f64) -> Result<PartErrorReport, InputError> {
        self.fitted(nominal, tip_mm, |shape, points, robust, repeats| {
            let least_um = written_step_mm(&coordinates(points)).map_or(0.0, |mm| 1e3 * mm / 12f64.sqrt());
            let rejected = match repeats {
                None => geometric_fit::beyond_noise(&robust.fitted, points, least_um),
                // Touches of one place share its form: each place counts once.
                Some(repeats) => match geometric_fit::robust(shape, &repeats.means) {
                    Ok(of_places) => {
                        let places = geometric_fit::beyond_noise(&of_places.fitted, &repeats.means, least_um);
                        repeats.touches(&places)
                    }
                    Err(_) => Vec::new(),
                },
            };
            OutlierRejectionFit::without(shape, points, rejected)
        })
    }

    /// As [`ProbedPoints::errors`], by the report's rule ([`geometric_fit::two_step`]).
    ///
    /// # Errors
    /// As [`ProbedPoints::errors`].
    pub fn errors_by_report(
        &self,
        nominal: NominalShape,
        tip_mm: f64,
    ) -> Result<PartErrorReport, InputError> {
        self.fitted(nominal, tip_mm, |shape, points, _, _| geometric_fit::two_step(shape, points))
    }

    fn fitted(
        &self,
        nominal: NominalShape,
        tip_mm: f64,
        second_fit: impl Fn(
            FitShape,
            &[Zx],
            &RobustFit,
            Option<&RepeatedTouches>,
        ) -> Result<OutlierRejectionFit, FitError>,
    ) -> Result<PartErrorReport, InputError> {
        let shape = match nominal {
            NominalShape::Circle { .. } => FitShape::Circle,
            NominalShape::Line { .. } => FitShape::Line,
        };
        let as_input = |e| self.undetermined(e);
        let points = &self.tip_centre;
        let mut robust = geometric_fit::robust(shape, points).map_err(as_input)?;
        let plain = geometric_fit::least_squares(shape, points, None).map_err(as_input)?;
        let repeats = repeated_touches::find(&plain, points, shape.parameters());
        let mut two = second_fit(shape, points, &robust, repeats.as_ref()).map_err(as_input)?;
        let side = self.side(&two.fitted)?;
        if let FittedShape::Line { normal, .. } = two.fitted {
            // The normal of a straight feature is turned towards the probe in both fits, because a fit may
            // give either sign for a face.
            let outward = normal * side;
            face(outward, &mut two.fitted, &mut two.errors_um);
            face(outward, &mut robust.fitted, &mut robust.errors_um);
        }
        let tip = if shape == FitShape::Line { tip_mm } else { side * tip_mm };
        let surface = moved(&two.fitted, -tip);
        let (centre_mm, radius_mm) = place(&surface);
        let robust_surface = moved(&robust.fitted, -tip);
        let mut errors: Vec<PointError> = points
            .iter()
            .zip(&two.errors_um)
            .map(|(&p, &error_um)| PointError {
                angle_rad: two.fitted.normal_at(p).angle_rad(),
                error_um,
                along_mm: (shape == FitShape::Line).then(|| two.fitted.place(p)),
            })
            .collect();
        if shape == FitShape::Circle {
            unwrap_angles(&mut errors, &sequence(&two.fitted, points));
        }
        let [least_um, most_um] = span(&two.errors_um);
        let inclination_deg = inclination_deg(&surface);
        let (nominal_mm, taper_deg) = match nominal {
            NominalShape::Circle { radius_mm } => (Some(radius_mm), None),
            NominalShape::Line { taper_deg } => (None, taper_deg),
        };
        let off_um = |radius_mm: Option<f64>| radius_mm.zip(nominal_mm).map(|(f, r)| (f - r) * 1e3);
        let off_deg = |(f, t): (f64, f64)| (f - t + 90.0).rem_euclid(180.0) - 90.0;
        let (robust_centre, robust_radius) = place(&robust_surface);
        let kept: Vec<Zx> =
            (0..points.len()).filter(|i| !two.rejected.contains(i)).map(|i| points[i]).collect();
        let (sd_um, step_um) = self.scatter_um(two.sd_before_um, shape);
        let standard_errors = |fitted: &FittedShape, points: &[Zx]| match &repeats {
            None => geometric_fit::standard_errors(fitted, points, sd_um),
            Some(repeats) => {
                let sd_um = repeats.sd_between_um?.hypot(step_um.map_or(0.0, |step| step / 12f64.sqrt()));
                geometric_fit::standard_errors(fitted, &repeats.means, sd_um)
            }
        };
        let known = standard_errors(&two.fitted, &kept);
        Ok(PartErrorReport {
            feature: if shape == FitShape::Circle { "circle" } else { "line" },
            points: points.len(),
            tip_mm,
            centre_mm,
            radius_mm,
            size_error_um: off_um(radius_mm),
            inclination_deg,
            inclination_error_deg: inclination_deg.zip(taper_deg).map(off_deg),
            centre_standard_error_um: known.map(|k| k.centre_um),
            size_standard_error_um: known.map(|k| k.size_um),
            inclination_standard_error_deg: known.and_then(|k| k.inclination_rad).map(f64::to_degrees),
            plain_centre_mm: place(&moved(&two.plain, 0.0)).0,
            plain_radius_mm: place(&moved(&two.plain, -tip)).1,
            plain_size_standard_error_um: standard_errors(&two.plain, points).map(|k| k.size_um),
            step_um,
            repeats,
            sd_before_um: two.sd_before_um,
            sd_after_um: two.sd_after_um,
            rejected: two.rejected,
            form_um: most_um - least_um,
            robust: RobustFitSummary {
                centre_mm: robust_centre,
                radius_mm: robust_radius,
                size_error_um: off_um(robust_radius),
                scale_um: robust.scale_um,
                down_weighted: (0..points.len()).filter(|&i| robust.weights[i] < 0.5).collect(),
                errors_um: robust.errors_um,
            },
            errors,
            hollow: shape == FitShape::Circle && side < 0.0,
            outline: surface,
        })
    }

    fn undetermined(&self, e: FitError) -> InputError {
        InputError::whole(self.sheet.file(), e.to_string(), "points that determine the feature")
    }

    /// Uncertainty of one point, µm, and the step if it is included.
    /// It is the scatter of all points about their plain fit. The step in which the points are written is
    /// added if it is larger.
    fn scatter_um(&self, sd_um: f64, shape: FitShape) -> (f64, Option<f64>) {
        let n = self.tip_centre.len();
        let sd_um = sd_um * ((n - 1) as f64 / (n - shape.parameters()) as f64).sqrt();
        let coarse = |step: &f64| *step > sd_um.max(LEAST_STEP_UM);
        let step_um = written_step_mm(&coordinates(&self.tip_centre)).map(|mm| 1000.0 * mm).filter(coarse);
        (step_um.map_or(sd_um, |step| sd_um.hypot(step / 12f64.sqrt())), step_um)
    }

    /// Takes the directions of motion at the trips from the probe's path.
    /// It serves for points recorded without them.
    ///
    /// # Errors
    /// The numbers of touches and points differ; a direction differs from the recorded one.
    pub fn touched_by(&mut self, path: &[Zx]) -> Result<(), InputError> {
        if path.len() != self.tip_centre.len() {
            let found = format!("{} points for a path of {} touches", self.tip_centre.len(), path.len());
            return Err(InputError::whole(self.sheet.file(), found, "one point for each touch"));
        }
        let recorded = self.approach.get_or_insert_with(|| path.to_vec());
        if let Some(row) = recorded.iter().zip(path).position(|(own, path)| own.dot(*path) < ALONG) {
            let expected = "the direction of the probe's path: is it the path of these points?";
            return Err(self.sheet.finding(row, "an approach in another direction", expected));
        }
        Ok(())
    }

    /// Checks that each point is on the way of its touch.
    ///
    /// # Errors
    /// A point beside the way of its touch or beyond its end. It is then of another path, another side or
    /// another unit.
    pub fn met_on(&self, path: &[PathPoint]) -> Result<(), InputError> {
        for (row, ([start, end], p)) in touches(path).zip(&self.tip_centre).enumerate() {
            let whole = end - start;
            let Some(unit) = whole.unit() else { continue };
            let along = (*p - start).dot(unit);
            let beside = (*p - start - unit * along).norm();
            if beside > OFF_WAY_MM || along < -OFF_WAY_MM || along > whole.norm() + PAST_MM {
                let before = whole.norm() - along;
                let found = format!(
                    "a point {beside:.1} mm beside the way of its touch, {before:.1} mm before its end"
                );
                let expected =
                    "a trip on the way: is it the path of these points, in the unit of --path-units?";
                return Err(self.sheet.finding(row, found, expected));
            }
        }
        Ok(())
    }

    /// +1: probed from outside (against the normal), −1: from inside.
    /// Without approaches it is outside. For a face that cannot be assumed, because its normal's sign would
    /// depend on its tilt.
    fn side(&self, fitted: &FittedShape) -> Result<f64, InputError> {
        let Some(approach) = &self.approach else {
            return match *fitted {
                FittedShape::Line { normal, .. } if normal.x.abs() < FACE => {
                    let found = "the points of a face without the direction of the touches: which side of it is the part's \
                                 cannot be told";
                    let expected = "columns approach_z,approach_x, or the probe's path (--path PATHFIN.CDL)";
                    Err(InputError::whole(self.sheet.file(), found, expected))
                }
                _ => Ok(1.0),
            };
        };
        let mut side = 0.0;
        for (row, (&d, &p)) in approach.iter().zip(&self.tip_centre).enumerate() {
            let against = -d.dot(fitted.normal_at(p));
            if against.abs() < 0.1 {
                return Err(self.sheet.finding(row, "an approach along the surface", "one that meets it"));
            }
            if side * against < 0.0 {
                let found = "an approach from the other side than the rows before";
                return Err(self.sheet.finding(row, found, "one feature, probed from one side"));
            }
            side = against.signum();
        }
        Ok(side)
    }
}

fn coordinates(points: &[Zx]) -> Vec<f64> {
    points.iter().flat_map(|p| [p.z, p.x]).collect()
}

/// Largest distance of a part from its place in the path, mm.
const OFF_WAY_MM: f64 = 5.0;
/// Largest distance of a trip beyond a touch's end, mm.
const PAST_MM: f64 = 1.0;
/// Largest component of a face's normal across the part's axis.
/// A face is within 10° of square to the axis.
const FACE: f64 = 0.17;
/// Smallest cosine of two directions that count as one: 26°.
/// A path's numbers are rounded, and a recorded direction may be the nominal one.
const ALONG: f64 = 0.9;

/// Turns a line's normal, and the deviations along it, outward.
fn face(outward: Zx, fitted: &mut FittedShape, errors_um: &mut [f64]) {
    if matches!(*fitted, FittedShape::Line { normal, .. } if normal.dot(outward) < 0.0) {
        if let FittedShape::Line { normal, .. } = fitted {
            *normal = *normal * -1.0;
        }
        for e in errors_um {
            *e = -*e;
        }
    }
}

/// Largest share of a line's deviations that a true circle leaves.
const STRAIGHT: f64 = 0.25;
/// Fewest points for this test: some circle fits fewer points nearly always.
const ENOUGH_TO_DOUBT: usize = 8;
/// Ratio of radius to length above which an arc is a bowed straight feature.
/// The bow is then less than 0.13 mm on 100 mm.
const BOWED: f64 = 100.0;

/// A sensor's column: T and a number, or `temperature.` and its name.
fn is_sensor(name: &str) -> bool {
    name.strip_prefix(TEMPERATURE).is_some_and(|n| !n.is_empty()) || is_numbered(name)
}

const TEMPERATURE: &str = "temperature.";

/// The header of a sensor's column.
pub(crate) fn sensor_column(sensor: &str) -> String {
    if is_numbered(sensor) { sensor.to_owned() } else { format!("{TEMPERATURE}{sensor}") }
}

fn is_numbered(name: &str) -> bool {
    name.strip_prefix('T').is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Makes a fillet's angles continuous where they cross ±π.
/// They follow the arc from one end to the other, in the order of its points.
fn unwrap_angles(errors: &mut [PointError], order: &[usize]) {
    for pair in order.windows(2) {
        let turns = ((errors[pair[0]].angle_rad - errors[pair[1]].angle_rad) / TAU).ceil();
        errors[pair[1]].angle_rad += turns * TAU;
    }
    let middle = f64::midpoint(errors[order[0]].angle_rad, errors[order[order.len() - 1]].angle_rad);
    let back = turned_near(middle, 0.0) - middle;
    for e in errors {
        e.angle_rad += back;
    }
}

/// A straight feature's inclination to the part's axis, degrees.
fn inclination_deg(surface: &FittedShape) -> Option<f64> {
    let FittedShape::Line { normal, .. } = surface else { return None };
    Some(folded_deg((-normal.z).atan2(normal.x).to_degrees()))
}

/// The shape moved outward.
fn moved(fitted: &FittedShape, by_mm: f64) -> FittedShape {
    match *fitted {
        FittedShape::Circle { centre, radius_mm } => {
            FittedShape::Circle { centre, radius_mm: radius_mm + by_mm }
        }
        FittedShape::Line { through, normal } => {
            FittedShape::Line { through: through + normal * by_mm, normal }
        }
    }
}

fn place(fitted: &FittedShape) -> ([f64; 2], Option<f64>) {
    match *fitted {
        FittedShape::Circle { centre, radius_mm } => ([centre.z, centre.x], Some(radius_mm)),
        FittedShape::Line { through, .. } => ([through.z, through.x], None),
    }
}

/// The error bars, from the nominal outline outward by the magnified error.
pub(crate) struct DeviationWhiskers {
    pub outline: Vec<Zx>,
    pub bars: Vec<(Zx, Zx)>,
    rejected: Vec<bool>,
    size_mm: f64,
}

impl PartErrorReport {
    /// The text of `error.cor`.
    /// An arc is by angle, as in the report. A straight feature has one angle and five numbers per line:
    /// angle (rad), error (µm), place along it (mm), and the surface's Z and X there (mm). With `with_size`
    /// the constant error is included.
    pub fn error_cor(&self, with_size: bool) -> String {
        let size_um = self.size_error_um.filter(|_| with_size).unwrap_or(0.0);
        match self.outline {
            FittedShape::Circle { .. } => {
                let sized = |e: &PointError| PointError { error_um: e.error_um + size_um, ..*e };
                error_cor(&self.errors.iter().map(sized).collect::<Vec<_>>())
            }
            FittedShape::Line { through, normal } => {
                let mut sorted = self.errors.clone();
                sorted.sort_by(|a, b| a.along_mm.unwrap_or(0.0).total_cmp(&b.along_mm.unwrap_or(0.0)));
                sorted.iter().fold(String::new(), |mut text, e| {
                    let along = e.along_mm.unwrap_or(0.0);
                    let p = through + normal.along() * along;
                    let error_um = e.error_um + size_um;
                    let _ =
                        writeln!(text, "{:.6} {error_um:.3} {along:.5} {:.5} {:.5}", e.angle_rad, p.z, p.x);
                    text
                })
            }
        }
    }
    /// Half of the size error's 95 % interval, µm (Student's t).
    pub fn size_within_um(&self) -> Option<f64> {
        Some(self.student()? * self.size_standard_error_um?)
    }

    /// Half of the inclination error's 95 % interval, degrees (Student's t).
    pub fn inclination_within_deg(&self) -> Option<f64> {
        Some(self.student()? * self.inclination_standard_error_deg?)
    }

    /// Half of a 95 % interval in standard errors, for this number of points.
    /// Places that were touched several times count once.
    fn student(&self) -> Option<f64> {
        let parameters = if self.radius_mm.is_some() { 3 } else { 2 };
        let places = self.repeats.as_ref().map_or(self.points, |repeats| repeats.places);
        let freedom = places.checked_sub(parameters).filter(|n| *n > 0)? as f64;
        Some(StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975))
    }

    /// Whether the size error is larger than its 95 % interval.
    /// No advice is given on a smaller one.
    pub fn is_size_known(&self) -> bool {
        matches!((self.size_error_um, self.size_within_um()), (Some(off), Some(within)) if off.abs() > within)
    }

    /// Whether the inclination error is larger than its 95 % interval.
    pub fn is_inclination_known(&self) -> bool {
        let both = (self.inclination_error_deg, self.inclination_within_deg());
        matches!(both, (Some(off), Some(within)) if off.abs() > within)
    }

    pub(crate) fn whiskers(&self) -> DeviationWhiskers {
        let foot = |e: &PointError| match self.outline {
            FittedShape::Circle { centre, radius_mm } => {
                let n = Zx::at_angle(e.angle_rad);
                (centre + n * radius_mm, n)
            }
            FittedShape::Line { through, normal } => {
                (through + normal.along() * e.along_mm.unwrap_or(0.0), normal)
            }
        };
        let feet: Vec<(Zx, Zx)> = self.errors.iter().map(foot).collect();
        let places: Vec<Zx> = feet.iter().map(|f| f.0).collect();
        let order = sequence(&self.outline, &places);
        let outline: Vec<Zx> = match self.outline {
            FittedShape::Circle { centre, radius_mm } => {
                let angle = |k: usize| self.errors[order[k]].angle_rad;
                let sweep = (angle(order.len() - 1) - angle(0)).rem_euclid(TAU);
                let at = |k| centre + Zx::at_angle(angle(0) + sweep * f64::from(k) / 180.0) * radius_mm;
                (0..=180).map(at).collect()
            }
            FittedShape::Line { .. } => order.iter().map(|&i| places[i]).collect(),
        };
        let head = |i: usize| feet[i].0 + feet[i].1 * (self.errors[i].error_um * 1e-3 * MAGNIFICATION);
        let bars = order.iter().map(|&i| (feet[i].0, head(i))).collect();
        let rejected = order.iter().map(|i| self.rejected.contains(i)).collect();
        let size_mm = (outline[outline.len() - 1] - outline[0]).norm();
        DeviationWhiskers { outline, bars, rejected, size_mm }
    }

    /// The feature with its error bars, magnified as in figures 5 and 6 of NISTIR 4854.
    pub fn whisker_svg(&self) -> String {
        let w = self.whiskers();
        let mut svg = SvgDrawing::default();
        svg.polyline(&w.outline, "outline");
        for (i, &(foot, head)) in w.bars.iter().enumerate() {
            svg.polyline(&[foot, head], "whisker");
            svg.dot(head, 0.006 * w.size_mm, if w.rejected[i] { "dropped" } else { "kept" });
        }
        let [low, high] = svg.frame();
        let (line, size) = (0.045 * (high - low).norm(), 0.0225 * (high - low).norm());
        let at = |row: f64| Zx::new(low.z, low.x - line * row);
        svg.polyline(&[at(1.0), at(1.0) + Zx::new(MAGNIFICATION * 0.02, 0.0)], "whisker");
        svg.text(at(1.0) + Zx::new(MAGNIFICATION * 0.02 + size, -0.3 * size), size, "20 µm, errors ×250");
        let sds = format!("SD {:.1} µm, after the second fit {:.1} µm", self.sd_before_um, self.sd_after_um);
        svg.text(at(2.2), size, &sds);
        let legend = [
            ("outline", "nominal outline"),
            ("whisker", "error, magnified"),
            ("kept", "point of the second fit"),
            ("dropped", "point left out of the second fit"),
        ];
        svg.finish("Part errors", &legend[..if w.rejected.contains(&true) { 4 } else { 3 }])
    }
}
