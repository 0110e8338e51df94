//! What a machine model says about a record, said with what was taken for granted.

use rtec_files::{InputError, Said};
use rtec_model::machine::Machine;
use rtec_model::record::Record;

/// The sum of the model's effects at every row, by the response's column; what the record does not log, and where it is
/// beyond what the model was fitted on, goes to `say`.
///
/// # Errors
/// An effect reads a sensor or channel that the record does not have.
pub fn predict(
    machine: &Machine,
    record: &Record,
    say: &mut dyn FnMut(Said),
) -> Result<Vec<(String, Vec<f64>)>, InputError> {
    let prediction = machine.predict(record)?;
    let file = record.path.display();
    for (effect, role) in &prediction.taken_as_zero {
        say(Said::Warning(format!("{file}: no {role} in the record, taken as zero for {effect}")));
    }
    for warning in machine.out_of_range(record) {
        say(Said::Warning(format!("{file}: {warning}")));
    }
    Ok(prediction.columns)
}

/// The record's rows with a column `predicted_RESPONSE` for each response; with its 95 % interval where that is asked for.
///
/// # Errors
/// As [`predict`]; no interval is known; the record's CSV has changed.
pub fn csv(
    machine: &Machine,
    record: &Record,
    interval: bool,
    say: &mut dyn FnMut(Said),
) -> Result<String, InputError> {
    let mut columns = Vec::new();
    for (response, (name, data)) in record.responses().zip(predict(machine, record, say)?) {
        if interval {
            let Some(width) = machine.half_widths_um(record, &response.role) else {
                let found = format!("no fit of {}", response.role);
                let expected = "a [[fit]] that states its interval, as `model fit` writes it";
                return Err(InputError::whole(&machine.path, found, expected));
            };
            let bound = |sign: f64| data.iter().zip(&width).map(|(p, w)| p + sign * w).collect::<Vec<f64>>();
            let (low, high) = (bound(-1.0), bound(1.0));
            columns.push((format!("low_{name}"), low));
            columns.push((format!("high_{name}"), high));
        }
        columns.push((format!("predicted_{name}"), data));
    }
    crate::record::csv_with(record, &columns)
}
