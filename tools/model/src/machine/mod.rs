//! `machine.toml`: a named list of effects.
//!
//! | module | what |
//! |---|---|
//! | `read_machine_toml` | strict reading; every finding has its line |
//! | `edit_machine_toml` | changing and writing without losing anything that the user wrote |
//! | `fit_note` | a fit's own record: sources, dates, intervals, ranges |
//! | `record_prediction` | a model's prediction of a record, and its interval |
//! | `warnings_before_use` | warnings before a model is used |
//! | `json_export` | a model as JSON
//! | `places` | the path of a file from another file's folder |

mod edit_machine_toml;
mod fit_note;
mod json_export;
mod read_machine_toml;
mod record_prediction;
mod relative_paths;
#[cfg(test)]
mod test_machine;
mod warnings_before_use;

pub use fit_note::{
    EffectWithProvenance, FitNote, NORMAL_95, Provenance, RecordRanges, SourceRecord, ValidTemperatureRange,
    unknown_um,
};
pub use record_prediction::{ChunkedHalfWidthPredictor, ChunkedRecordPredictor, RecordPrediction};
pub use warnings_before_use::FitRangeCheck;

use crate::effect::{Dictionary, Effect, TemperatureDifference};
use crate::kinematic_chain::KinematicChain;
use std::path::PathBuf;
use toml_edit::{DocumentMut, value};

/// A machine model: the content of one `machine.toml`.
#[derive(Debug, Clone)]
pub struct Machine {
    /// The file, as the user named it.
    pub path: PathBuf,
    sha256: String,
    name: String,
    listed: Vec<EffectWithProvenance>,
    fits: Vec<FitNote>,
    chain: Option<KinematicChain>,
    /// The laws given by the calling program; those of the model's own file are added.
    given: Dictionary,
    dictionary: Dictionary,
    /// Whether the dictionary will be written beside the model, wherever that is.
    adopted: bool,
    doc: DocumentMut,
}

impl Machine {
    /// An ideal machine: no effects.
    pub fn ideal(name: &str) -> Self {
        let mut doc = DocumentMut::new();
        doc["name"] = value(name);
        Self {
            path: PathBuf::from("machine.toml"),
            sha256: String::new(),
            name: name.to_owned(),
            listed: Vec::new(),
            fits: Vec::new(),
            chain: None,
            given: Dictionary::default(),
            dictionary: Dictionary::default(),
            adopted: false,
            doc,
        }
    }

    /// SHA-256 of the file as read, followed by its dictionary and its chain.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// The machine's name, from the key `name`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The effects with their provenance, in the file's order.
    pub fn listed(&self) -> &[EffectWithProvenance] {
        &self.listed
    }

    /// The effects, in the file's order.
    pub fn effects(&self) -> impl Iterator<Item = &Effect> {
        self.listed.iter().map(|l| &l.effect)
    }

    /// The kinematic chain, whose errors are added to those of the effects.
    pub fn chain(&self) -> Option<&KinematicChain> {
        self.chain.as_ref()
    }

    /// The same machine with another chain, or none.
    /// A written file still names the chain file that was read.
    #[must_use]
    pub fn with_chain(&self, chain: Option<KinematicChain>) -> Self {
        Self { chain, ..self.clone() }
    }

    /// The notes of the fits.
    pub fn fits(&self) -> &[FitNote] {
        &self.fits
    }

    /// The dictionary that the model was read with.
    pub fn dictionary(&self) -> &Dictionary {
        &self.dictionary
    }

    /// The sensors that its effects and its chain read.
    pub fn sensors(&self) -> Vec<String> {
        let chain = self.chain.iter().flat_map(KinematicChain::deltas);
        let deltas = self.effects().filter_map(|e| e.delta.as_ref()).chain(chain);
        let mut names: Vec<String> =
            deltas.flat_map(TemperatureDifference::sensors).map(str::to_owned).collect();
        names.sort();
        names.dedup();
        names
    }
}
