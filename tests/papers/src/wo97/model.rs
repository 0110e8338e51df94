//! Figure 17 and the choice of sensors: the model that the wet characterisation gives.

use super::{Centre, Run, error_of, record};
use crate::PaperError;
use crate::rows::Agreement::{AtLeast, AtMost, Within};
use crate::rows::Rows;
use rtec_fit::thermal::ThermalFitOptions;
use rtec_fit::workflow::{self, FitRequest, ThermalFitResult};
use rtec_measure::plot::{Chart, Series, Style};
use rtec_model::effect::RequiredInput;
use rtec_model::machine::{Machine, Provenance};
use rtec_model::record::{Record, Role};
use rtec_sim::compensation_experiments::ExperimentResult;
use std::fmt::Write as _;

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len()) as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(x, y)| f(x - ma, y - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// Figure 17 and the choice of sensors; the model that the wet characterisation gives, on top of the geometry.
pub(super) fn wet_model(
    rows: &mut Rows,
    centre: &Centre,
    run: &Run<'_>,
    found: &ExperimentResult,
) -> Result<Machine, PaperError> {
    let wet = record(found, "drift-wet")?;
    let z = error_of(wet, 2);
    let heated = 0..=180_usize;
    let of = |sensor: &str| wet.temperature(sensor).map_or_else(Vec::new, |t| t[heated.clone()].to_vec());
    let z_heated = z[heated.clone()].to_vec();
    let t13 = of("T13");
    let what = "γ of sensor 13 (spindle nose) with the growth in Z";
    let why = "wet, over the three hours of heating; the paper does not say over which run";
    rows.number(("Figure 17", what, ""), 0.97, correlation(&t13, &z_heated).abs(), Within(0.1), why);
    let range =
        |t: &[f64]| t.iter().copied().fold(f64::MIN, f64::max) - t.iter().copied().fold(f64::MAX, f64::min);
    let dry = record(found, "drift-dry")?;
    let dry13 = dry.temperature("T13").map_or_else(Vec::new, |t| t[heated.clone()].to_vec());
    let why = "dry; 16 °C in one place of the text, 15 °C in another";
    let gets = range(&dry13);
    rows.fitted().number(("Figure 17", "temperature change of sensor 13", "K"), 16.0, gets, Within(1.5), why);
    let why = "places of the sensors are those of the simulated network";
    let gets = correlation(&t13, &of("T10"));
    rows.number(("CASC", "autocorrelation α of sensors 13 and 10", ""), 0.985, gets, Within(0.02), why);
    let offered = wet.names(&Role::Temperature).count();
    rows.given().number(("CASC", "sensors to begin with", ""), 20.0, offered as f64, Within(0.0), "");
    let ThermalFitResult { machine: model, reports, .. } = fitted(run, wet)?;
    let mut rounds =
        "CASC, round by round: R, and µm left on blocks of time that the fit has not seen\n".to_owned();
    for report in &reports {
        for (n, round) in report.rounds.iter().enumerate() {
            // Writing to a String does not fail.
            let _ = writeln!(
                rounds,
                "  {} round {}: {:<36} R {:.5}  {:7.3} µm",
                report.response,
                n + 1,
                round.added,
                round.r,
                round.cv_rms_um
            );
        }
        let mut sensors: Vec<String> = Vec::new();
        for e in &report.effects {
            sensors.extend(e.sensor.iter().chain(&e.minus).cloned());
        }
        sensors.sort();
        sensors.dedup();
        let axis = report.response.trim_start_matches("error.").to_uppercase();
        let what = format!("sensors in the end for {axis}: 4 or 5");
        rows.number(("CASC", &what, ""), 5.0, sensors.len() as f64, AtMost, "fewer where fewer do");
        let why = "the program's own limit. It ends sooner where another term takes nothing off blocks of time that the fit has not \
            seen. The patent ends where R improves by 1 % no more: see the contributor's page on sources";
        let what = format!("rounds of the refit for {axis}: seldom more than five");
        let gets = report.rounds.iter().filter(|r| !r.added.contains(" for ")).count() as f64;
        rows.given().number(("CASC", &what, ""), 5.0, gets, AtMost, why);
        let dropped = report.dropped.iter().map(|d| d.alpha.abs()).fold(f64::INFINITY, f64::min);
        if dropped.is_finite() {
            let what = format!("least α at which a sensor was left out for {axis}");
            rows.given().number(("CASC", &what, ""), centre.redundant, dropped, AtLeast, "");
        }
    }
    rows.tables.push(rounds);
    modelled(rows, wet, &model)?;
    Ok(model)
}

/// Figures 18a to 18c: the growth of the wet spindle cycle, measured and modelled.
fn modelled(rows: &mut Rows, wet: &Record, model: &Machine) -> Result<(), PaperError> {
    let minutes: Vec<f64> = wet.data(&Role::Time).unwrap_or_default().iter().map(|s| s / 60.0).collect();
    let from_start = |um: &[f64]| -> Vec<(f64, f64)> {
        let first = um.first().copied().unwrap_or(0.0);
        minutes.iter().copied().zip(um.iter().map(|e| e - first)).collect()
    };
    for (p, (response, modelled)) in model.predict(wet)?.columns.into_iter().enumerate() {
        let chart = Chart::new(&format!("Growth of {response}"), "time (min)", "growth (µm)")
            .with(Series::new("measured", Style::Dots, from_start(error_of(wet, p))))
            .with(Series::new("modelled", Style::Line, from_start(&modelled)));
        rows.figures.push((format!("figure-18{}.svg", ["a", "b", "c"][p.min(2)]), chart.svg(900, 420)?));
    }
    Ok(())
}

/// The fit of the patent's runs, all wet: spindle cycle, warm-up with speeds and cool-down, a shift, a production cycle.
/// It is `rtecctl model fit --no-speed` of the example's records, beside the example's geometry.
fn fitted(run: &Run<'_>, wet: &Record) -> Result<ThermalFitResult, PaperError> {
    let (runs, production) = (run.experiment("wet-runs", None)?, run.experiment("production-cycle", None)?);
    let train =
        [wet, record(&runs, "warm-day")?, record(&runs, "shift")?, record(&production, "production-cycle")?];
    let options =
        ThermalFitOptions { base: Some(geometry(run.truth)?), speed: false, ..ThermalFitOptions::default() };
    let asked = FitRequest { date: Some(20_000), options, ..FitRequest::default() };
    Ok(workflow::fit(train.map(Clone::clone).into(), Vec::new(), &asked, &mut |_| ())?)
}

/// The model that the wet runs give, on top of the geometry.
pub(super) fn from_wet_runs(run: &Run<'_>) -> Result<Machine, PaperError> {
    let drift = run.experiment("drift", None)?;
    Ok(fitted(run, record(&drift, "drift-wet")?)?.machine)
}

/// The true machine without its growth, as the example's `machine.toml`.
fn geometry(truth: &Machine) -> Result<Machine, PaperError> {
    let mut known = Machine::ideal("geometry");
    for effect in truth.effects() {
        if !effect.description().needs.contains(&RequiredInput::Delta) {
            let pushed = known.push(effect.clone(), Provenance::default());
            pushed.map_err(|e| PaperError::Cannot(e.to_string()))?;
        }
    }
    Ok(known)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtec_sim::described_machines::MachineDescriptions;
    use rtec_sim::example_machines::ExampleMachine;

    /// `rtecctl model fit` in the example has the same base.
    #[test]
    fn the_example_knows_the_same_geometry() {
        let truth = MachineDescriptions::default().machine("wo97-machine.toml").unwrap();
        let example = ExampleMachine::find("wo97").unwrap().machine("machine.toml").unwrap();
        let effects = |m: &Machine| m.effects().cloned().collect::<Vec<_>>();
        assert_eq!(effects(&geometry(&truth).unwrap()), effects(&example));
    }
}
