//! The machines described in the sources, as files within the program.
//! `rtec-papers` and the experiments of the sources use them. Files of the same names in a folder replace
//! them.

use rtec_files::InputError;
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Files of the experiments with the machining centre of WO 97/43703.
macro_rules! wo97_of {
    ($machine:literal) => {
        concat!(
            "# The five-axis machining centre of WO 97/43703, spindle horizontal, and the tests that it was put through.\n",
            "machine = \"",
            $machine,
            "\"\n",
            include_str!("../papers/wo97-equations.toml")
        )
    };
}
#[cfg(feature = "experiments")]
pub(crate) use wo97_of;

/// Every file: name and text.
pub const FILES: [(&str, &str); 9] = [
    ("4832.toml", include_str!("../papers/4832.toml")),
    ("4832-machine.toml", include_str!("../papers/4832-machine.toml")),
    ("4854.toml", include_str!("../papers/4854.toml")),
    ("4854-machine.toml", include_str!("../papers/4854-machine.toml")),
    ("4854-chain.toml", include_str!("../papers/4854-chain.toml")),
    ("cmti.toml", include_str!("../papers/cmti.toml")),
    ("wo97.toml", wo97_of!("wo97-machine.toml")),
    ("wo97-machine.toml", WO97_MACHINE),
    ("wo97-chain.toml", WO97_CHAIN),
];

/// The machining centre of WO 97/43703.
pub(crate) const WO97_MACHINE: &str = include_str!("../papers/wo97-machine.toml");
/// The tilt of its spindle, to which its model refers.
pub(crate) const WO97_CHAIN: &str = include_str!("../papers/wo97-chain.toml");

/// Source of the descriptions.
#[derive(Debug, Default)]
pub struct MachineDescriptions {
    /// A folder with the user's files; for a missing one the program's is used.
    folder: Option<PathBuf>,
    /// Files that were missing there.
    missing: Mutex<BTreeSet<&'static str>>,
}

impl MachineDescriptions {
    /// The descriptions of a folder, or the program's.
    pub fn of(folder: Option<PathBuf>) -> Self {
        Self { folder, ..Self::default() }
    }

    /// Files that the folder lacked since the last call.
    /// The program's were used instead.
    pub fn take_missing(&self) -> BTreeSet<&'static str> {
        std::mem::take(&mut *self.missing.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Text of a file, and the path that messages use for it.
    ///
    /// # Errors
    /// No such file.
    fn text(&self, name: &str) -> Result<(PathBuf, String), InputError> {
        if let Some(file) = self.folder.as_ref().map(|f| f.join(name)).filter(|f| f.exists()) {
            let text = rtec_files::text_file::read(&file)?;
            return Ok((file, text));
        }
        let path = PathBuf::from(name);
        let (name, text) = FILES.iter().find(|f| f.0 == name).ok_or_else(|| {
            let names = FILES.map(|f| f.0).join(", ");
            InputError::whole(&path, "no such description", format!("one of {names}"))
        })?;
        if self.folder.is_some() {
            self.missing.lock().unwrap_or_else(PoisonError::into_inner).insert(name);
        }
        Ok((path, (*text).to_owned()))
    }

    /// Reads a description.
    ///
    /// # Errors
    /// The file is not such a description: file, line, column, what was found and expected.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> Result<T, InputError> {
        let (path, text) = self.text(name)?;
        rtec_files::strict_toml::from_str(&path, &text, "keys of this description, see `rtec-papers --write`")
    }

    /// The error for a wrong value of a description: file, line, found and expected.
    pub fn refuse(&self, name: &str, key: &str, found: String, expected: String) -> InputError {
        let (path, text) = match self.text(name) {
            Ok(read) => read,
            Err(error) => return error,
        };
        let is_key = |line: &str| line.split_once('=').is_some_and(|(k, _)| k.trim() == key);
        let line = text.lines().position(is_key).map_or(0, |n| n + 1);
        InputError::at(&path, line, 0, found, expected)
    }

    /// Reads a machine model with its chain.
    ///
    /// # Errors
    /// As [`Machine::read`].
    pub fn machine(&self, name: &str) -> Result<Machine, InputError> {
        let (path, text) = self.text(name)?;
        let beside = |file: &Path| {
            let name = file.file_name().and_then(|n| n.to_str()).unwrap_or_default();
            self.text(name).map(|t| t.1)
        };
        Machine::parse_from(&path, &text, Dictionary::default(), &beside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_machine_can_be_read_and_a_folder_stands_for_the_program() {
        for (name, _) in FILES.iter().filter(|f| f.0.ends_with("-machine.toml")) {
            let machine = MachineDescriptions::default().machine(name).unwrap();
            assert!(machine.effects().next().is_some() || machine.chain().is_some(), "{name}");
        }
        assert!(MachineDescriptions::default().machine("wo97-machine.toml").unwrap().chain().is_some());
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("4832-machine.toml");
        std::fs::write(&file, "name = \"mine\"\n").unwrap();
        let own = MachineDescriptions::of(Some(dir.path().to_owned()));
        assert_eq!(own.machine("4832-machine.toml").unwrap().name(), "mine");
        assert_eq!(own.machine("4854-machine.toml").unwrap().name(), "turning centre of NISTIR 4854");
        assert!(own.machine("none.toml").is_err());
        assert_eq!(Vec::from_iter(own.take_missing()), ["4854-chain.toml", "4854-machine.toml"]);
        assert!(own.take_missing().is_empty());
    }
}
