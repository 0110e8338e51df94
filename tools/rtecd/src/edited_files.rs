//! Finds files that were edited since they were read.
//! The running configuration or model then differs from the disk.

use rtec_model::machine::Machine;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

/// Interval of the checks.
const EVERY: Duration = Duration::from_secs(1);

/// Content of a file when it was read.
#[derive(Debug, Clone, PartialEq, Eq)]
enum ContentWhenRead {
    /// A configuration, byte by byte.
    Configuration(Vec<u8>),
    /// A model, by its SHA-256.
    Model(String),
}

impl ContentWhenRead {
    /// A message with a remedy, if the file's content has changed.
    fn differs(&self, file: &Path) -> Option<String> {
        let shown = file.display();
        match self {
            Self::Configuration(text) => match std::fs::read(file) {
                Ok(now) if now == *text => None,
                Ok(_) => Some(format!(
                    "{shown} was edited since the start: `rtecctl config check {shown}`, then `systemctl restart rtecd` takes it"
                )),
                Err(error) => Some(format!("{shown} cannot be read any more: {error}; a restart would fail")),
            },
            Self::Model(sha256) => match Machine::read(file) {
                Ok(now) if now.sha256() == sha256 => None,
                Ok(_) => {
                    Some(format!("{shown} was edited since it was loaded: `rtecctl model load` takes it"))
                }
                Err(error) => {
                    Some(format!("{shown} was edited since it was loaded, and cannot be loaded: {error}"))
                }
            },
        }
    }
}

#[derive(Debug, Default)]
struct SharedFileList {
    files: Vec<(PathBuf, ContentWhenRead)>,
    edited: Vec<String>,
}

/// Checks the files from its own thread, so that a hanging disk blocks nobody.
#[derive(Debug)]
pub(crate) struct EditedFilesChecker {
    configuration: Option<(PathBuf, ContentWhenRead)>,
    shared: Arc<Mutex<SharedFileList>>,
}

fn lock(shared: &Mutex<SharedFileList>) -> MutexGuard<'_, SharedFileList> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl EditedFilesChecker {
    /// Watches the configuration's file, if any, from its present content on.
    pub(crate) fn watch(configuration: Option<&Path>) -> Self {
        let read =
            |file: &Path| Some((file.to_owned(), ContentWhenRead::Configuration(std::fs::read(file).ok()?)));
        let shared = Arc::new(Mutex::new(SharedFileList::default()));
        let seen = Arc::downgrade(&shared);
        // Without the thread no edit is noticed, which is no reason not to start.
        let _ = std::thread::Builder::new().name("on-disk".into()).spawn(move || {
            let mut last = LastFileCheck::default();
            while let Some(shared) = seen.upgrade() {
                let files = lock(&shared).files.clone();
                if let Some(edited) = last.look(&files) {
                    lock(&shared).edited = edited;
                }
                drop(shared);
                std::thread::sleep(EVERY);
            }
        });
        Self { configuration: configuration.and_then(read), shared }
    }

    /// Messages on files that differ from what runs, as last checked.
    /// `model` is the file and SHA-256 of the running model.
    pub(crate) fn edited(&self, model: Option<(PathBuf, String)>) -> Vec<String> {
        let model = model.map(|(file, sha256)| (file, ContentWhenRead::Model(sha256)));
        let files: Vec<_> = self.configuration.iter().cloned().chain(model).collect();
        let mut shared = lock(&self.shared);
        if shared.files != files {
            shared.files = files;
        }
        shared.edited.clone()
    }
}

/// The files at the last check.
#[derive(Debug, Default)]
struct LastFileCheck {
    files: Vec<(PathBuf, ContentWhenRead)>,
    stamps: Vec<Option<(SystemTime, u64)>>,
}

impl LastFileCheck {
    /// The messages, if anything has changed since the last check.
    /// Most checks read no file.
    fn look(&mut self, files: &[(PathBuf, ContentWhenRead)]) -> Option<Vec<String>> {
        let stamp = |file: &Path| {
            let now = std::fs::metadata(file).ok()?;
            Some((now.modified().ok()?, now.len()))
        };
        let stamps: Vec<_> = files.iter().map(|(file, _)| stamp(file)).collect();
        if self.files == files && self.stamps == stamps {
            return None;
        }
        (self.files, self.stamps) = (files.to_vec(), stamps);
        Some(files.iter().filter_map(|(file, known)| known.differs(file)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_which_file_was_edited_and_what_takes_it() {
        let directory = tempfile::tempdir().unwrap();
        let [config, model] = ["rtec.toml", "machine.toml"].map(|name| directory.path().join(name));
        let put = |file: &Path, text: &str| std::fs::write(file, text).unwrap();
        put(&config, "# one\n");
        put(&model, "name = \"m\"\n");
        let sha256 = Machine::read(&model).unwrap().sha256().to_owned();
        let files = [
            (config.clone(), ContentWhenRead::Configuration(b"# one\n".to_vec())),
            (model.clone(), ContentWhenRead::Model(sha256)),
        ];
        let mut last = LastFileCheck::default();
        assert_eq!(last.look(&files), Some(vec![]));
        assert_eq!(last.look(&files), None, "nothing has changed");
        put(&config, "# another\n");
        let said = last.look(&files).unwrap();
        assert!(
            said.len() == 1 && said[0].contains("rtec.toml was edited") && said[0].contains("restart"),
            "{said:?}"
        );
        put(&model, "name = \"mill\"\n");
        let said = last.look(&files).unwrap();
        assert!(said.len() == 2 && said[1].contains("model load"), "{said:?}");
        put(&model, "name = \n");
        assert!(last.look(&files).unwrap()[1].contains("cannot be loaded"));
        std::fs::remove_file(&config).unwrap();
        assert!(last.look(&files).unwrap()[0].contains("a restart would fail"));
        // The old content is back, so there is no message.
        put(&config, "# one\n");
        put(&model, "name = \"m\"\n");
        assert_eq!(last.look(&files), Some(vec![]));
    }
}
