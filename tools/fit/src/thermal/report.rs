//! The report of a fit, as it is printed and written.

use super::jackknife::Intervals;
use crate::statistics::mean_square;
use rtec_model::effect::Effect;
use serde::Serialize;
use std::collections::BTreeMap;

/// A sensor or pair with its correlation to the response.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RankedSensor {
    /// The sensor, or pair as `T8-T18`.
    pub sensor: String,
    /// γ: correlation of the difference with the response, as in the patent.
    pub gamma: f64,
    /// γ of the lagged difference, if a lag is justified.
    pub gamma_lagged: f64,
    /// That lag, s; 0 for none.
    pub tau_s: f64,
    /// Range of the sensor, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
    /// RMS of blocked cross-validation with this difference alone, µm.
    pub cv_rms_um: f64,
}

/// A sensor left out because another one measures the same heat source.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RedundantSensor {
    /// The sensor.
    pub sensor: String,
    /// α: its autocorrelation with the one kept.
    pub alpha: f64,
    /// The sensor that is kept.
    pub with: String,
    /// Its own γ.
    pub gamma: f64,
    /// γ of its lagged difference.
    pub gamma_lagged: f64,
    /// Range of the sensor, K.
    #[serde(rename = "range_K")]
    pub range_k: f64,
}

/// One round of the refit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefitRound {
    /// The added term, or after the refit's rounds the exchange of one for another.
    pub added: String,
    /// R after it.
    #[serde(rename = "R")]
    pub r: f64,
    /// RMS of blocked cross-validation after it, µm.
    pub cv_rms_um: f64,
}

/// A parameter with its 95 % interval (delete-one-block jackknife).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// An effect of the fitted model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedEffect {
    /// `thermal_lag.z`
    pub name: String,
    /// The sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// The sensor that is subtracted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minus: Option<String>,
    /// Its parameters.
    pub parameters: BTreeMap<String, ParameterEstimate>,
}

impl FittedEffect {
    pub(crate) fn of(effect: &Effect, interval: &Intervals) -> Self {
        let minus = effect.delta.as_ref().and_then(|d| d.minus().map(str::to_owned));
        let parameter = |(i, p): (usize, &rtec_model::effect::LawParameter)| {
            let value = effect.scalar(i);
            let [low, high] = interval.get(&p.name).map_or([value, value], |v| v[0]);
            (p.name.clone(), ParameterEstimate { value, low, high })
        };
        Self {
            name: effect.name(),
            sensor: effect.delta.as_ref().map(|d| d.sensor.clone()),
            minus,
            parameters: effect.description().parameters.iter().enumerate().map(parameter).collect(),
        }
    }
}

/// RMS of the residual, µm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CrossValidatedRms {
    /// On the data of the fit.
    pub train: f64,
    /// On every block, with structure and parameters chosen without it.
    pub folds: Vec<f64>,
    /// Over all blocks with equal weights.
    pub folds_rms: f64,
    /// On every hold-out.
    pub holdout: Vec<f64>,
}

impl CrossValidatedRms {
    /// Mean square over the blocks.
    pub(super) fn mean_square(&self) -> f64 {
        mean_square(&self.folds)
    }
}

/// The 95 % prediction interval.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PredictionInterval {
    /// Half width where the model knows most, µm.
    /// It is wider after a start and beyond the range of the fit.
    pub half_width_um: f64,
    /// Share of the rows inside, each block judged by the others' width.
    pub coverage_folds: f64,
    /// Share of one half's rows inside this half width by a fit on the other half.
    /// Both directions are given. It shows what to expect in a state that the records do not contain. `None`
    /// if a half is too short to choose from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage_halves: Option<[f64; 2]>,
    /// Share of the rows inside on every hold-out.
    pub coverage_holdout: Vec<f64>,
    /// Mean half width over the rows of every hold-out, µm.
    pub mean_half_width_holdout_um: Vec<f64>,
}

/// The structure fitted on dry and on wet rows alone, as the patent compares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DryWetComparison {
    /// Growth per kelvin by term, dry.
    pub dry: BTreeMap<String, f64>,
    /// Growth per kelvin by term, wet.
    pub wet: BTreeMap<String, f64>,
    /// Range of the growth on the dry rows, µm.
    pub growth_dry_um: f64,
    /// Range of the growth on the wet rows, µm.
    pub growth_wet_um: f64,
    /// RMS of the dry model on the wet rows, µm.
    /// It is the error of a model from dry runs when cutting wet.
    pub dry_model_on_wet_rms_um: f64,
    /// RMS of the wet model on the wet rows, µm.
    pub wet_model_on_wet_rms_um: f64,
}

/// The result of the fit of one response.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThermalFitReport {
    /// `error.z`
    pub response: String,
    /// The sensor of the environment.
    pub environment: Option<String>,
    /// How that sensor was chosen, in words.
    pub environment_by: String,
    /// Sensors kept, best first.
    pub kept: Vec<RankedSensor>,
    /// Sensors left out as redundant.
    pub dropped: Vec<RedundantSensor>,
    /// The best pairs, best first.
    pub pairs: Vec<RankedSensor>,
    /// The refit, round by round.
    pub rounds: Vec<RefitRound>,
    /// First sensors that the data cannot distinguish from the chosen one.
    pub alternatives: Vec<RankedSensor>,
    /// The fitted effects.
    pub effects: Vec<FittedEffect>,
    /// RMS of the residuals.
    pub rms_um: CrossValidatedRms,
    /// Residual RMS of simpler predictions on the same blocks (mean) and hold-outs.
    pub baselines: BTreeMap<String, CrossValidatedRms>,
    /// The prediction interval.
    pub interval95: PredictionInterval,
    /// Dry against wet, if the data have both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dry_wet: Option<DryWetComparison>,
    /// Messages to read before the model is used.
    pub warnings: Vec<String>,
}
