//! Checks on this computer what a configuration names.
//! `rtecctl config check` does so without `--elsewhere`.

use super::{CardConfig, Config};
use rtec_correct::Corrector;
use rtec_files::message_text::quoted;
use rtec_files::quadrature_trace::TraceReader;
use rtec_files::strict_toml::{Document, Table};
use rtec_files::toml_section_keys::FileWithFindings;
use rtec_model::machine::Machine;
use rtec_sensors::{SensorMonitor, SensorSource, sensor_bank};
use std::path::Path;

/// Findings and notes about what the configuration names.
/// Findings are unusable files, or a model that this machine does not take. Notes are things that may come later,
/// such as a sensor, and parts of a model without effect.
pub(super) fn look(source: &mut FileWithFindings<'_>, document: &Document<'_>, config: &mut Config) {
    let whole = source.findings.is_empty();
    model(source, document, config, whole);
    traces(source, document, config);
    // After a mistake in a table it is not known which table each sensor belongs to.
    let tables = document.root().get("sensor").and_then(|e| e.tables("[[sensor]] tables").ok());
    if tables.as_ref().is_none_or(|tables| tables.len() != config.sensors.len()) {
        return;
    }
    for (table, sensor) in tables.iter().flatten().zip(&config.sensors) {
        match &sensor.source {
            SensorSource::Csv { record, column } => recording(source, table, record, column),
            other => {
                if let Err(why) = sensor_bank::look(Path::new("/"), other) {
                    config
                        .notes
                        .push(format!("[[sensor]] {}: nothing is read from it now: {why}", sensor.name));
                }
            }
        }
    }
}

/// Prepares the model that runs from the start, as the daemon does.
/// Only if the rest of the configuration is free of mistakes (`whole`).
fn model(source: &mut FileWithFindings<'_>, document: &Document<'_>, config: &mut Config, whole: bool) {
    let Some(file) = &config.model.file else { return };
    let entry = document.root().get("model").and_then(|e| e.as_table()).and_then(|t| t.get("file"));
    let at = entry.map_or(0, |e| e.offset());
    let machine = match Machine::read(file) {
        Ok(machine) => machine,
        Err(error) => {
            let found = format!("a machine model with a mistake: {error}");
            source.finding(at, found, "a machine model (`rtecctl model show` reads it)");
            return;
        }
    };
    if !whole {
        return;
    }
    let setups = config.axes.iter().map(super::ConfiguredAxis::axis_setup).collect();
    let mut law = Corrector::new(setups, config.model.ramp_um_s, config.model.lead_ms * 1e-3, 0.0);
    let watches: Vec<SensorMonitor> = config.sensors.iter().cloned().map(SensorMonitor::new).collect();
    law.sense(0.0, &watches);
    match law.preparer().prepare(machine, &|_| Vec::new()) {
        Ok(prepared) => config.notes.extend(prepared.missing().iter().map(|m| format!("[model] {m}"))),
        Err(error) => source.finding(at, format!("{}: {}", file.display(), error.found), error.expected),
    }
}

/// Checks the traces of a card that replays.
fn traces(source: &mut FileWithFindings<'_>, document: &Document<'_>, config: &Config) {
    let CardConfig::Replay { traces } = &config.card else { return };
    let tables = document.root().get("axis").and_then(|e| e.tables("[[axis]] tables").ok());
    let named = tables.iter().flatten().filter_map(|table| table.get("trace"));
    for (entry, trace) in named.zip(traces) {
        let whole = |mut points: TraceReader<_>| -> Result<(), _> {
            while points.next_point()?.is_some() {}
            Ok(())
        };
        if let Err(error) = TraceReader::open(trace).and_then(whole) {
            source.finding(entry.offset(), format!("trace {error}"), "a recorded trace that can be read");
        }
    }
}

/// Checks a recording to replay: a run record that the daemon can read.
fn recording(source: &mut FileWithFindings<'_>, table: &Table<'_>, record: &Path, column: &str) {
    let at = table.get("record").map_or(0, |e| e.offset());
    let read = match rtec_records::run_record_files::read_log(record) {
        Ok(read) => read,
        Err(error) => {
            let line = if error.line > 0 { format!(":{}", error.line) } else { String::new() };
            let place = format!("{}{line}", error.file.display());
            let found = format!("a recording that cannot be replayed: {place}: {}", error.found);
            source.finding(at, found, error.expected);
            return;
        }
    };
    let names: Vec<&str> = read.columns.iter().map(|c| c.name.as_str()).collect();
    if !names.contains(&column) {
        let at = table.get("column").or_else(|| table.get("name")).map_or(at, |e| e.offset());
        let expected = format!("a column of {}: {}", record.display(), names.join(", "));
        source.finding(at, format!("column {}", quoted(column)), expected);
    }
}
