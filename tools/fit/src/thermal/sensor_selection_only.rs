//! Selection of sensors without a fit, for comparison with another selection.

use super::ThermalFitOptions;
use super::fit_candidates::TermSelectionProblem;
use super::term::pair_of;
use crate::temperature_denoising;
use rtec_files::InputError;
use rtec_model::effect::TemperatureDifference;
use rtec_model::record::{Record, Role};

/// The temperature differences that [`super::fit`] selects for a response.
/// They are those before blocks of time are left out to test them. Empty if the temperatures explain no more
/// than chance.
///
/// # Errors
/// As [`super::fit`].
pub fn select_differences(
    train: &[&Record],
    response: &Role,
    options: &ThermalFitOptions,
) -> Result<Vec<TemperatureDifference>, InputError> {
    let quiet: Vec<Record> = train.iter().map(|r| temperature_denoising::temperatures(r)).collect();
    let problem = TermSelectionProblem::new(&quiet.iter().collect::<Vec<_>>(), response, options)?;
    let all: Vec<usize> = (0..problem.folds).collect();
    let terms = problem.select(&all).map_or_else(Vec::new, |s| s.structure.terms);
    let mut out: Vec<TemperatureDifference> = Vec::new();
    for pair in terms.iter().filter_map(|t| pair_of(*t)) {
        let difference = problem.difference(pair);
        if !out.contains(&difference) {
            out.push(difference);
        }
    }
    Ok(out)
}
