//! Compares the probe's trips with the plan.
//! Each point needs one trip, at the expected place.

use crate::geometric_fit::Zx;
use crate::part_errors::sensor_column;
use rtec_model::record::{Axis, Column, Record, Role, RunKind};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

/// The captured position of one gauging point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct GaugingPointTrip {
    /// Gauging point, from 1.
    pub point: usize,
    /// The tip's centre at the trip, in part coordinates.
    pub tip_centre: Zx,
    /// Half width of the position's uncertainty, µm.
    /// It is the time between two polls times the speed, or a count if an axis stood still.
    pub uncertainty_um: f64,
    /// Time of the trip on the corrector's clock.
    pub t_s: f64,
}

/// The faults of a probing session; each has its gauging point, from 1.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ProbeTripFault {
    /// No trip, although one was due.
    #[error("point {point}: missed, no trip within {window_mm} mm of its place")]
    Missed {
        /// Number of the gauging point, from 1.
        point: usize,
        /// Largest distance of a trip from its place.
        window_mm: f64,
    },
    /// A second trip at the same point.
    #[error("point {point}: tripped twice")]
    Double {
        /// Number of the gauging point, from 1.
        point: usize,
    },
    /// The probe's contact bounced.
    #[error("point {point}: the probe bounced")]
    Bounce {
        /// Number of the gauging point, from 1.
        point: usize,
    },
    /// A trip far from its place with all axes at exactly zero.
    #[error(
        "point {point}: tripped with every axis at exactly 0: was no position captured, or nothing homed?"
    )]
    Zero {
        /// Number of the gauging point, from 1.
        point: usize,
    },
    /// A trip at another place.
    #[error("point {point}: tripped {off_mm:.3} mm from its place, outside {window_mm} mm")]
    Outside {
        /// The gauging point that was due.
        point: usize,
        /// Distance of the trip from the expected place.
        off_mm: f64,
        /// Largest distance of a trip from its place.
        window_mm: f64,
    },
}

/// The captured trips in order.
/// Each has both axes' positions, their half width and the time. `bounces` are the numbers of trips (from 1)
/// during which the contact bounced.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CapturedTrips {
    /// Position on the scales in counts `[z, x]`, half width in counts, time in s.
    pub trips: Vec<([f64; 2], f64, f64)>,
    /// Trips with a bounce.
    pub bounces: Vec<usize>,
}

/// Assigns each trip to its gauging point.
/// `expected` are the tip's centres at the nominal part. Positions are converted to part coordinates by
/// `count_um` and the machine's `origin`.
///
/// # Errors
/// The first point that was missed, tripped twice, bounced or tripped elsewhere.
pub fn assign(
    captured: &CapturedTrips,
    expected: &[Zx],
    count_um: f64,
    origin: Zx,
    window_mm: f64,
) -> Result<Vec<GaugingPointTrip>, ProbeTripFault> {
    let near = |p: Zx, k: usize| expected.get(k).is_some_and(|e| (p - *e).norm() <= window_mm);
    let mut trips: Vec<GaugingPointTrip> = Vec::new();
    for (n, (counts, half, t_s)) in captured.trips.iter().enumerate() {
        let p = Zx::new(counts[0], counts[1]) * (count_um * 1e-3) - origin;
        let due = trips.len();
        if !near(p, due) {
            if counts.iter().all(|c| *c == 0.0) && due < expected.len() {
                return Err(ProbeTripFault::Zero { point: due + 1 });
            }
            if due > 0 && near(p, due - 1) {
                return Err(ProbeTripFault::Double { point: due });
            }
            if due < expected.len() && (due + 1..expected.len()).any(|k| near(p, k)) {
                return Err(ProbeTripFault::Missed { point: due + 1, window_mm });
            }
            let off_mm = expected.get(due).map_or(f64::INFINITY, |e| (p - *e).norm());
            return Err(ProbeTripFault::Outside { point: due + 1, off_mm, window_mm });
        }
        if captured.bounces.contains(&(n + 1)) {
            return Err(ProbeTripFault::Bounce { point: due + 1 });
        }
        trips.push(GaugingPointTrip {
            point: due + 1,
            tip_centre: p,
            uncertainty_um: half * count_um,
            t_s: *t_s,
        });
    }
    if trips.len() < expected.len() {
        return Err(ProbeTripFault::Missed { point: trips.len() + 1, window_mm });
    }
    Ok(trips)
}

/// The record that `part errors` reads, as CSV.
/// `approach` are the directions of motion of each touch. `degc` are the sensors' readings at each trip, for
/// the off-line geometric-thermal correction.
pub fn probed_csv(
    trips: &[GaugingPointTrip],
    approach: &[Zx],
    sensors: &[&str],
    degc: &[Vec<f64>],
) -> String {
    let mut text = "z_mm,x_mm,approach_z,approach_x,point,t_s,uncertainty_um".to_owned();
    for sensor in sensors {
        text.extend([",", &sensor_column(sensor)]);
    }
    text.push('\n');
    for (n, (t, d)) in trips.iter().zip(approach).enumerate() {
        let p = t.tip_centre;
        let _ = write!(
            text,
            "{:.6},{:.6},{:.6},{:.6},{},{:.6},{:.3}",
            p.z, p.x, d.z, d.x, t.point, t.t_s, t.uncertainty_um
        );
        for v in degc.get(n).into_iter().flatten().take(sensors.len()) {
            let _ = write!(text, ",{v:.3}");
        }
        text.push('\n');
    }
    text
}

/// The session as a run record of the machine (`probing.run.toml`).
/// It has axis positions, directions and temperatures, and the distance of each trip beyond the nominal part
/// along its touch. `origin` is the machine's position at the part's zero.
/// `None` for a session without a trip.
pub fn run_record(
    trips: &[GaugingPointTrip],
    expected: &[Zx],
    approach: &[Zx],
    origin: Zx,
    sensors: &[&str],
    degc: &[Vec<f64>],
) -> Option<Record> {
    let (z, x) = (Axis::new("z")?, Axis::new("x")?);
    let column = |name: &str, role: Role, value: &dyn Fn(usize) -> f64| {
        Column::new(name, role, (0..trips.len()).map(value).collect())
    };
    let sign = |v: f64| if v.abs() < 1e-9 { 0.0 } else { v.signum() };
    let off = |n: usize| (trips[n].tip_centre - expected[n]).dot(approach[n] * -1.0) * 1e3;
    let mut columns = vec![
        column("t", Role::Time, &|n| trips[n].t_s),
        column("z", Role::Position(z.clone()), &|n| trips[n].tip_centre.z + origin.z),
        column("x", Role::Position(x.clone()), &|n| trips[n].tip_centre.x + origin.x),
        column("dir_z", Role::Direction(z), &|n| sign(approach[n].z)),
        column("dir_x", Role::Direction(x), &|n| sign(approach[n].x)),
        column("angle", Role::Angle, &|n| (approach[n] * -1.0).angle_rad()),
        column("e", Role::Error(Axis::new("r")?), &|n| off(n)),
    ];
    if degc.len() == trips.len() {
        columns.extend(
            sensors.iter().enumerate().map(|(s, name)| column(name, Role::Temperature, &|n| degc[n][s])),
        );
    }
    Record::new(Path::new("probing.run.toml"), RunKind::Probing, columns).ok()
}
