//! The files of a machine's set-up: its configuration, and the files it names.

use crate::config::{CardConfig, Config};
use rtec_files::InputError;
use rtec_files::strict_toml::Document;
use rtec_model::machine::Machine;
use rtec_sensors::{SensorSource, temperature_log};
use std::path::{Path, PathBuf};

/// A file that belongs to a machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SetupFile {
    /// `configuration`, `profile`, `model`, `trace`, `recording` or `devices`.
    pub kind: &'static str,
    /// Its path.
    pub path: PathBuf,
}

/// The files of a machine; the first is its configuration.
/// Files that it names are listed whether they exist or not.
///
/// # Errors
/// The configuration, or the model that it names, cannot be read.
pub fn of(file: &Path, config: &Config) -> Result<Vec<SetupFile>, InputError> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut all = vec![SetupFile { kind: "configuration", path: file.to_owned() }];
    let mut add = |kind, path: PathBuf| {
        if all.iter().all(|b| b.path != path) {
            all.push(SetupFile { kind, path });
        }
    };
    let text = rtec_files::text_file::read(file)?;
    let document = Document::parse(file, &text)?;
    let card = document.root().get("card").and_then(|e| e.table("[card]").ok());
    // A profile is given by its name or its file.
    if let Some(named) = card.and_then(|t| t.get("profile")).and_then(|e| e.str("a profile").ok())
        && crate::card_profile_file::shipped(named).is_none()
    {
        add("profile", folder.join(named));
    }
    if let CardConfig::Replay { traces } = &config.card {
        for trace in traces {
            add("trace", trace.clone());
        }
    }
    for sensor in &config.sensors {
        if let SensorSource::Csv { record, .. } = &sensor.source {
            add("recording", record.clone());
            let text = rtec_files::text_file::read(record)?;
            let sidecar = Document::parse(record, &text)?;
            if let Some(csv) = sidecar.root().get("file").and_then(|e| e.str("a CSV").ok()) {
                add("recording", record.parent().unwrap_or(Path::new("")).join(csv));
            }
        }
    }
    if let Some(model) = &config.model.file {
        let files = if model.exists() { Machine::read_with_files(model)?.1 } else { vec![model.clone()] };
        for path in files {
            add("model", path);
        }
    }
    add("devices", file.with_file_name("devices"));
    Ok(all)
}

/// Files beside the state file of a daemon, each with its kind.
/// The first is the state itself: counts in effect, faults, hold.
pub fn state(config: &Config) -> Vec<(&'static str, PathBuf)> {
    let state = config.control.state_path();
    let [now, old] = temperature_log::NAMES;
    let beside = ["model.taken", "model.unloaded", "model.kept", now, old]
        .map(|name| ("loaded", state.with_file_name(name)));
    [("state", state.clone())].into_iter().chain(beside).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_that_a_configuration_names_belongs_to_it() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let put = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
        put("m.toml", "name = 'm'\ndictionary = 'own.toml'\n");
        let law = "[[law]]\nname = 'quill_droop'\nnaming = 'A.B'\nacts_on = 'error'\nlaw = 'e_A = um·(p_B/100)²'\n\
            cause = 'the quill bends'\nexperiment = 'a straightedge at several depths'\n\
            parameters = [{ name = 'um', unit = 'um', plausible = 50.0, terms = [{ factor = 1e-4, p_B = 2 }] }]\n";
        put("own.toml", law);
        put("r.run.toml", "file = 'r.csv'\nkind = 'drift'\n");
        let text = "[machine]\nname='m'\n[card]\nbackend='replay'\n[[axis]]\nname='x'\ncount_um=1\ntravel_mm=40\ntrace='x.csv'\n\
                    max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[model]\nfile='m.toml'\n\
                    [[sensor]]\nname='T1'\nplace='bed'\nsource='csv'\nrecord='r.run.toml'\n";
        put("rtec.toml", text);
        let config = Config::load(&at("rtec.toml")).unwrap();
        let found = of(&at("rtec.toml"), &config).unwrap();
        let found: Vec<_> =
            found.iter().map(|b| (b.kind, b.path.file_name().unwrap().to_str().unwrap())).collect();
        let expected = [
            ("configuration", "rtec.toml"),
            ("trace", "x.csv"),
            ("recording", "r.run.toml"),
            ("recording", "r.csv"),
            ("model", "m.toml"),
            ("model", "own.toml"),
            ("devices", "devices"),
        ];
        assert_eq!(found, expected);
    }
}
