//! The air in a laser interferometer's path.
//! Its refractive index, and the length error if the instrument assumed another one.
//!
//! The index is Edlén's equation as revised by Birch and Downs (Metrologia 30, 1993, 155; 31, 1994, 315),
//! from −40 to 100 °C. The water vapour's term is by Stone and Zimmerman (NIST Engineering Metrology Toolbox,
//! "Index of Refraction of Air", appendix A-IV). The pressure of saturated vapour is that of IAPWS R7-97 over
//! water, and of Wagner and others (1994) over ice (A-I there).

use super::no_temperature;
use rtec_files::Result;
use rtec_files::strict_toml::Table;
use rtec_model::record::Record;
use serde::Serialize;

/// The vacuum wavelength of a helium-neon laser, nm.
const HELIUM_NEON_NM: f64 = 632.991;
const KELVIN: f64 = 273.15;

/// The state of the air that determines its refractive index.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AirState {
    /// Temperature, °C.
    #[serde(rename = "degC")]
    pub degc: f64,
    /// Pressure, kPa.
    #[serde(rename = "kPa")]
    pub kpa: f64,
    /// Relative humidity, %.
    pub rh_percent: f64,
}

impl AirState {
    /// Refractive index minus one for this vacuum wavelength.
    pub fn refractivity(&self, wavelength_nm: f64) -> f64 {
        let (t, p) = (self.degc, 1000.0 * self.kpa);
        let per_square_um = (1000.0 / wavelength_nm).powi(2);
        let standard =
            1e-8 * (8342.54 + 2_406_147.0 / (130.0 - per_square_um) + 15_998.0 / (38.9 - per_square_um));
        let density = (1.0 + 1e-8 * (0.601 - 0.009_72 * t) * p) / (1.0 + 0.003_661 * t);
        let vapour = 0.01 * self.rh_percent * saturated_pa(t);
        let wet = 1e-10 * 292.75 / (t + KELVIN) * (3.7345 - 0.0401 * per_square_um) * vapour;
        p * standard * density / 96_095.43 - wet
    }
}

/// Pressure of saturated water vapour, Pa.
fn saturated_pa(degc: f64) -> f64 {
    let t = degc + KELVIN;
    if degc < 0.0 {
        let theta = t / 273.16;
        let exponent = -13.928_169 * (1.0 - theta.powf(-1.5)) + 34.707_823_8 * (1.0 - theta.powf(-1.25));
        return 611.657 * exponent.exp();
    }
    let omega = t - 0.238_555_575_678 / (t - 650.175_348_448);
    let a = omega * omega + 1_167.052_145_28 * omega - 724_213.167_032;
    let b = -17.073_846_940_1 * omega * omega + 12_020.824_702_5 * omega - 3_232_555.032_23;
    let c = 14.915_108_613_5 * omega * omega - 4_823.265_736_16 * omega + 405_113.405_421;
    let x = -b + (b * b - 4.0 * a * c).sqrt();
    1e6 * (2.0 * c / x).powi(4)
}

/// Temperature of the air: a number, or a sensor of the record.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum AirTemperatureSource {
    /// °C, constant.
    Degc(f64),
    /// The readings of this sensor, row by row.
    Sensor(String),
}

/// The air along the laser's path, and the air that the instrument assumed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LaserPathAir {
    /// Its temperature.
    pub temperature: AirTemperatureSource,
    /// Its pressure, kPa.
    #[serde(rename = "kPa")]
    pub kpa: f64,
    /// Its relative humidity, %.
    pub rh_percent: f64,
    /// The air that the instrument compensated for.
    pub assumed: AirState,
    /// Path between interferometer and reflector at the zero of the reading, mm.
    pub dead_path_mm: f64,
    /// Axis position of that zero, mm; `None`: the first row.
    /// From there the reflector moves away.
    pub zero_mm: Option<f64>,
    /// Vacuum wavelength, nm.
    pub wavelength_nm: f64,
}

const KEYS: &str = "degC sensor kPa rh_percent assumed_degC assumed_kPa assumed_rh_percent dead_path_mm zero_mm \
                    wavelength_nm";

/// Range of the equation: °C, kPa, %.
const DEGC: [f64; 2] = [-40.0, 100.0];
const KPA: [f64; 2] = [10.0, 140.0];
const PERCENT: [f64; 2] = [0.0, 100.0];

impl LaserPathAir {
    /// Reads the table `[air]`.
    pub(super) fn read(table: &Table<'_>) -> Result<Self> {
        table.only(&KEYS.split_whitespace().collect::<Vec<_>>())?;
        let number = |key: &str, [low, high]: [f64; 2], what: &str| {
            let expected = format!("{what}, {low} to {high}");
            table.required(key, &expected)?.within([low, high], &expected)
        };
        let or = |key: &str, otherwise: f64, range: [f64; 2], what: &str| {
            if table.get(key).is_some() { number(key, range, what) } else { Ok(otherwise) }
        };
        let temperature = match (table.get("sensor"), table.get("degC")) {
            (Some(e), None) => {
                AirTemperatureSource::Sensor(e.str("the name of a temperature sensor")?.to_owned())
            }
            (Some(e), Some(_)) => {
                let expected = "one of them: the air's sensor, or its temperature";
                return Err(e.error("sensor beside degC", expected));
            }
            _ => {
                let what = "the air's temperature in °C (or sensor = \"T18\")";
                AirTemperatureSource::Degc(number("degC", DEGC, what)?)
            }
        };
        let waves_nm = [300.0, 1700.0];
        Ok(Self {
            temperature,
            kpa: number("kPa", KPA, "the air's pressure in kPa")?,
            rh_percent: number("rh_percent", PERCENT, "the air's relative humidity in %")?,
            assumed: AirState {
                degc: number("assumed_degC", DEGC, "the temperature that the laser took, °C")?,
                kpa: number("assumed_kPa", KPA, "the pressure that the laser took, kPa")?,
                rh_percent: number("assumed_rh_percent", PERCENT, "the humidity that the laser took, %")?,
            },
            dead_path_mm: or("dead_path_mm", 0.0, [0.0, 1e5], "the path at the laser's zero in mm")?,
            zero_mm: table.get("zero_mm").map(|e| e.within([-1e6, 1e6], "mm on the axis")).transpose()?,
            wavelength_nm: or("wavelength_nm", HELIUM_NEON_NM, waves_nm, "the vacuum wavelength in nm")?,
        })
    }

    /// Errors (µm) at these positions corrected for the real air, and a message.
    pub(super) fn corrected(
        &self,
        record: &Record,
        position_mm: &[f64],
        error_um: &[f64],
    ) -> Result<(Vec<f64>, String)> {
        let degc: Vec<f64> = match &self.temperature {
            AirTemperatureSource::Degc(degc) => vec![*degc; position_mm.len()],
            AirTemperatureSource::Sensor(sensor) => {
                let expected = "the sensor that [air] of the conditions names";
                let read = record.temperature(sensor);
                read.ok_or_else(|| no_temperature(record, sensor, "air", expected))?.to_vec()
            }
        };
        let n = |degc: f64| {
            let now = AirState { degc, kpa: self.kpa, rh_percent: self.rh_percent };
            1.0 + now.refractivity(self.wavelength_nm)
        };
        let assumed = 1.0 + self.assumed.refractivity(self.wavelength_nm);
        let (Some(first_mm), Some(first_degc)) = (position_mm.first(), degc.first()) else {
            return Ok((Vec::new(), String::new()));
        };
        let (zero_mm, at_zero) = (self.zero_mm.unwrap_or(*first_mm), n(*first_degc));
        let middle_mm = position_mm.iter().sum::<f64>() / position_mm.len() as f64;
        let away = if middle_mm < zero_mm { -1.0 } else { 1.0 };
        let rows = position_mm.iter().zip(error_um).zip(&degc);
        let corrected = rows.map(|((p, e), degc)| {
            let shown_mm = away * (p + e / 1000.0 - zero_mm);
            // Wavelengths counted since the zero: n·(dead path + travel) − n₀·dead path.
            let way_mm = (assumed * shown_mm + at_zero * self.dead_path_mm) / n(*degc) - self.dead_path_mm;
            e + away * (way_mm - shown_mm) * 1000.0
        });
        let corrected = corrected.collect();
        let mean = degc.iter().sum::<f64>() / degc.len() as f64;
        let AirState { degc, kpa, rh_percent } = self.assumed;
        let (now_kpa, now_rh, dead_mm) = (self.kpa, self.rh_percent, self.dead_path_mm);
        let ppm = (assumed / n(mean) - 1.0) * 1e6;
        let words = format!(
            "air at {mean:.2} °C, {now_kpa} kPa, {now_rh} % against {degc} °C, {kpa} kPa, {rh_percent} % as the laser took it: {ppm:+.2} ppm; dead \
             path {dead_mm} mm (Edlén, NIST)"
        );
        Ok((corrected, words))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_builders::{column, record};
    use rtec_files::strict_toml::Document;
    use rtec_model::record::RunKind;
    use std::path::Path;

    /// IAPWS R7-97, table 35: 300 K; and the triple point, from ice.
    #[test]
    fn the_pressure_of_vapour_is_the_published_one() {
        assert!((saturated_pa(26.85) - 3_536.589_41).abs() < 1e-3);
        assert!((saturated_pa(-1e-9) - 611.0).abs() < 1.0);
    }

    fn air(text: &str) -> Result<LaserPathAir> {
        let whole = format!("[air]\n{text}");
        let doc = Document::parse(Path::new("c.toml"), &whole)?;
        let entry = doc.root().get("air").unwrap();
        LaserPathAir::read(&entry.as_table().unwrap())
    }

    const SAID: &str = "sensor = \"T1\"\nkPa = 95.0\nrh_percent = 30\nassumed_degC = 20\nassumed_kPa = 101.325\n\
                        assumed_rh_percent = 50\ndead_path_mm = 800\n";

    /// A laser in warming air: the corrected reading is the position.
    #[test]
    fn what_a_laser_shows_in_any_air_is_corrected() {
        let rows = 60;
        let warm = |i: usize| 18.0 + 6.0 * i as f64 / rows as f64;
        for (away, zero_mm) in [(1.0, -50.0), (-1.0, 900.0)] {
            let air = air(&format!("{SAID}zero_mm = {zero_mm:?}\n")).unwrap();
            let n = |degc: f64| 1.0 + AirState { degc, kpa: 95.0, rh_percent: 30.0 }.refractivity(632.991);
            let taken = 1.0 + AirState { degc: 20.0, kpa: 101.325, rh_percent: 50.0 }.refractivity(632.991);
            let at: Vec<f64> = (0..rows).map(|i| (i % 30) as f64 * 25.0 + 10.0).collect();
            let true_um: Vec<f64> = at.iter().map(|p| 3.0 + 0.02 * p).collect();
            let shown: Vec<f64> = (0..rows)
                .map(|i| {
                    let way = away * (at[i] + true_um[i] / 1000.0 - zero_mm);
                    let shown = (n(warm(i)) * (800.0 + way) - n(warm(0)) * 800.0) / taken;
                    (away * shown + zero_mm - at[i]) * 1000.0
                })
                .collect();
            let columns = vec![
                column("x", "position.x", at.clone()),
                column("T1", "temperature", (0..rows).map(warm).collect()),
                column("e", "error.x", shown.clone()),
            ];
            let record = record("r.run.toml", RunKind::Positioning, columns);
            let (found, words) = air.corrected(&record, &at, &shown).unwrap();
            assert!(shown.iter().zip(&true_um).any(|(s, t)| (s - t).abs() > 5.0), "nothing to correct");
            for (found, want) in found.iter().zip(&true_um) {
                assert!((found - want).abs() < 1e-6, "{found} and {want}");
            }
            assert!(words.contains("95 kPa") && words.contains("dead path 800 mm"), "{words}");
        }
    }

    #[test]
    fn air_that_no_shop_has_is_refused() {
        for (from, to, said) in [
            ("kPa = 95.0", "kPa = 950", "kPa = 950"),
            ("rh_percent = 30", "rh_percent = 130", "rh_percent = 130"),
            ("kPa = 95.0\n", "", "kPa"),
            ("sensor = \"T1\"", "sensor = \"T1\"\ndegC = 20", "one of them"),
            ("sensor = \"T1\"", "degC = 293", "degC = 293"),
            ("dead_path_mm", "deadpath_mm", "deadpath_mm"),
        ] {
            let e = air(&SAID.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(e.contains(said), "{said}: {e}");
        }
    }
}
