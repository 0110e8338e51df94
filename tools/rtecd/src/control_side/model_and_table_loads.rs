//! Models and part tables: the loader reads them, and the session takes them.

use super::{ControlSide, RequestContext, RequestOutcome};
use crate::request_file_loader::{self, FileSource, LoadRequest, LoadedFiles, PATIENCE, Ticket};
use crate::stderr_journal_log::{self, SyslogLevel};
use rtec_control::protocol::{DaemonResponse, ModelChangePreview, PartTable};
use rtec_correct::corrector::PreparedModel;
use rtec_files::InputError;
use rtec_model::machine::Machine;
use rtec_part::error_cor_file::FeatureErrors;
use rtec_rt::link::ControlEnd;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// File beside the state file that names the model that was loaded last.
/// Only that model runs after a restart. It has the hash, the file, and [`MEANT`] if the model was taken although its
/// validity had ended.
const TAKEN: &str = "model.taken";
const MEANT: &str = "although expired";
/// The same for the model that was unloaded last.
/// It does not run after a restart; `model_again` loads it.
const UNLOADED: &str = "model.unloaded";
/// Prefix of the machine's name in these files.
const FOR: &str = "for ";
/// Remedy for a model whose validity has ended.
pub(super) const LOOK_AGAIN: &str = "`rtecctl model validate` it on a new record and fit again where it is no longer true; `rtecctl model \
                          load --expired` takes it as it is, `rtecctl model unload` goes on without";
/// Remedy for a model that was unloaded.
const AGAIN: &str = "the model was unloaded: `rtecctl model again` takes it up as it was";
/// File with the texts of that model's files as they were read.
/// So a restart does not read files that have changed since.
const KEPT: &str = "model.kept";

/// Purpose of a model's load.
pub(crate) struct ModelLoadOptions {
    /// Take the model if it has this hash; otherwise show what it changes.
    pub(crate) take: Option<String>,
    /// Take it even if its validity has ended.
    pub(crate) expired: bool,
}

/// Purpose of a load.
pub(crate) enum LoadPurpose {
    Model(ModelLoadOptions),
    Table,
    Keep,
}

/// Refusal of a request that only names its files.
/// The daemon may read files that its caller may not.
fn by_name(file: &Path) -> DaemonResponse {
    let file = file.display();
    let text = format!(
        "{file}: found a name alone, expected the open file with it (SCM_RIGHTS), as `rtecctl` sends it: a file is read with \
         its caller's rights"
    );
    DaemonResponse::refused("no_descriptor", text)
}

/// The stored entry of a loaded model.
#[derive(Default)]
struct RememberedModel {
    sha256: String,
    file: Option<PathBuf>,
    /// It was taken although its validity had ended.
    accepted_expired: bool,
    /// Name of the machine for which it was loaded.
    machine: Option<String>,
}

impl RememberedModel {
    fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        let mut lines = text.lines();
        let (sha256, file) = (lines.next().unwrap_or_default().to_owned(), lines.next().map(PathBuf::from));
        let further: Vec<&str> = lines.collect();
        let machine = further.iter().find_map(|line| line.strip_prefix(FOR)).map(str::to_owned);
        Self { sha256, file, accepted_expired: further.first() == Some(&MEANT), machine }
    }

    /// Why the model is not for this machine, if so.
    fn of_another(&self, name: &str) -> Option<String> {
        let then = self.machine.as_ref().filter(|then| *then != name)?;
        let file = self.file.as_deref().unwrap_or(Path::new("")).display();
        Some(format!(
            "the model {file} was loaded for the machine \"{then}\", and this is \"{name}\": `rtecctl model load` shows what it changes"
        ))
    }
}

impl ControlSide {
    /// Runs the last model again after a restart, as it was read then.
    /// If the configuration names it, its file must be unchanged. This happens before any client is served, because it
    /// waits for the files.
    pub(crate) fn take_up_model(&mut self) {
        let taken = RememberedModel::read(&self.directory().join(TAKEN));
        let RememberedModel { sha256, accepted_expired: meant, .. } = &taken;
        let configured = self.config.model.file.clone();
        let kept = self.kept();
        let unloaded = self.directory().join(UNLOADED).exists();
        let Some(file) = configured.clone().or(taken.file.clone()) else {
            if unloaded {
                self.model_refused = Some(AGAIN.to_owned());
            }
            return;
        };
        let source = if configured.is_none() && kept.contains_key(&file) {
            FileSource::Kept(kept)
        } else {
            FileSource::Named
        };
        let why = match request_file_loader::work(
            self.model_job(file.clone(), source),
            &request_file_loader::LoadFlags::default(),
        ) {
            Err(error) => error.to_string(),
            Ok(LoadedFiles::Table { .. } | LoadedFiles::Kept(_)) => return,
            Ok(LoadedFiles::Model { prepared, .. }) => {
                let machine = prepared.machine();
                match (taken.of_another(&self.config.machine), self.ended(machine).filter(|_| !meant)) {
                    (Some(another), _) => another,
                    (_, Some(ended)) if machine.sha256() == sha256 => ended,
                    _ if machine.sha256() == sha256 => {
                        self.corrector.day_is((self.today)());
                        self.corrector.take(*prepared);
                        self.model_refused = None;
                        return stderr_journal_log::say(
                            SyslogLevel::Notice,
                            &format!("machine model {}", file.display()),
                        );
                    }
                    _ if unloaded => AGAIN.to_owned(),
                    _ if sha256.is_empty() => {
                        let file = file.display();
                        format!(
                            "the model {file} has not been loaded yet: `rtecctl model load` shows what it changes"
                        )
                    }
                    _ => format!(
                        "the model {} is not the one that was loaded last (its hash is another): `rtecctl model load` shows \
                         what it changes",
                        file.display()
                    ),
                }
            }
        };
        stderr_journal_log::say(SyslogLevel::Warning, &format!("no machine model: {why}"));
        self.model_refused = Some(why);
    }

    fn kept(&self) -> BTreeMap<PathBuf, String> {
        let kept = std::fs::read(self.directory().join(KEPT)).unwrap_or_default();
        serde_json::from_slice(&kept).unwrap_or_default()
    }

    /// Loads the model that was unloaded last, as it was read then.
    /// A user who may load models has checked it at that time.
    pub(super) fn model_again(&mut self) -> RequestOutcome {
        let model = RememberedModel::read(&self.directory().join(UNLOADED));
        let kept = self.kept();
        let Some(file) = model.file.clone().filter(|file| kept.contains_key(file)) else {
            let text = "no model was unloaded: there is nothing to take up again; `rtecctl model load FILE` loads one";
            return RequestOutcome::Now(DaemonResponse::refused("no_model", text));
        };
        if let Some(another) = model.of_another(&self.config.machine) {
            return RequestOutcome::Now(DaemonResponse::refused("other_machine", another));
        }
        self.corrector.day_is((self.today)());
        let job = self.model_job(file, FileSource::Kept(kept));
        self.begin(
            job,
            LoadPurpose::Model(ModelLoadOptions {
                take: Some(model.sha256),
                expired: model.accepted_expired,
            }),
        )
    }

    /// Why no model runs, and what to load.
    /// `None` where a part table was loaded without a model.
    pub(super) fn no_model(&self) -> Option<String> {
        if self.corrector.running_model().is_some() {
            return None;
        }
        let none = "no model is loaded and no part table: only `rtecctl correct` moves an axis; `rtecctl model load FILE` loads one";
        let unloaded = || self.directory().join(UNLOADED).exists().then(|| AGAIN.to_owned());
        match self.model_refused.clone().or_else(unloaded) {
            Some(why) => Some(format!("no model is loaded: {why}")),
            None => self.corrector.table_shown().is_none().then(|| none.to_owned()),
        }
    }

    /// Why a model may not be used any more, if its validity has ended.
    fn ended(&self, machine: &Machine) -> Option<String> {
        let ended = machine.expired((self.today)());
        let file = machine.path.display();
        (!ended.is_empty()).then(|| format!("the model {file}: {}: {LOOK_AGAIN}", ended.join("; ")))
    }

    /// Shows what a model would change, or takes the one that was shown.
    /// It answers once the model has been read.
    pub(super) fn model_load(
        &mut self,
        file: Option<&str>,
        names: &[String],
        wanted: ModelLoadOptions,
        beside: RequestContext,
    ) -> RequestOutcome {
        let bad = |text: String| RequestOutcome::Now(DaemonResponse::Bad { text });
        let (came, named) = (beside.files.len(), names.len());
        if came != named {
            let found = format!("found {came} descriptors with the request");
            return bad(format!("{found}, expected {named}, one per name in files"));
        }
        let configured = self.config.model.file.clone();
        let own = file.is_none();
        let Some(file) = names.first().map(PathBuf::from).or(file.map(PathBuf::from)).or(configured) else {
            return bad("found no file; expected one, or [model] file in the configuration".to_owned());
        };
        let source = if !names.is_empty() {
            FileSource::Handed(names.iter().map(PathBuf::from).zip(beside.files).collect())
        } else if own || beside.trusted {
            FileSource::Named
        } else {
            return RequestOutcome::Now(by_name(&file));
        };
        self.corrector.day_is((self.today)());
        let job = self.model_job(file, source);
        self.begin(job, LoadPurpose::Model(wanted))
    }

    /// Puts a finished record into the spool folder, once it has been read.
    /// Without files it only answers whether it would.
    pub(super) fn keep(&mut self, names: &[String], beside: RequestContext) -> RequestOutcome {
        let Some(spool) = self.record_spool.spool().cloned() else {
            let text = "this daemon keeps no records: `spool = \"/var/spool/rtec\"` in [control] of its configuration names \
                        the folder";
            return RequestOutcome::Now(DaemonResponse::refused("no_spool", text));
        };
        match (self.record_spool.trouble(), names, beside.files.len()) {
            (Some(trouble), ..) => RequestOutcome::Now(DaemonResponse::refused("not_kept", trouble)),
            (None, [], 0) => RequestOutcome::Now(DaemonResponse::done()),
            (None, [sidecar, csv], 2) => {
                let files = [sidecar, csv].map(PathBuf::from);
                let source = FileSource::Handed(files.iter().cloned().zip(beside.files).collect());
                self.begin(LoadRequest::Keep { files, source, spool }, LoadPurpose::Keep)
            }
            (None, names, came) => {
                let found = format!("found {} names with {came} descriptors", names.len());
                let text = format!("{found}, expected two of each: a record's sidecar, then its CSV");
                RequestOutcome::Now(DaemonResponse::Bad { text })
            }
        }
    }

    fn model_job(&self, file: PathBuf, source: FileSource) -> LoadRequest {
        LoadRequest::Model {
            file,
            source,
            preparer: Box::new(self.corrector.preparer()),
            log: self.directory(),
            period: Duration::from_millis(self.config.model.period_ms),
        }
    }

    /// Whether a load is under way.
    pub(crate) fn loads(&self) -> bool {
        self.loader.busy().is_some()
    }

    fn begin(&mut self, job: LoadRequest, wish: LoadPurpose) -> RequestOutcome {
        if let Some(why) = self.loader.busy() {
            return RequestOutcome::Now(DaemonResponse::refused("loading", why.to_owned()));
        }
        match self.loader.start(job) {
            Err(e) => RequestOutcome::Now(DaemonResponse::refused(
                "no_thread",
                format!("no thread to load it: {e}"),
            )),
            Ok(ticket) => {
                self.load_purpose = Some(wish);
                RequestOutcome::Later(ticket)
            }
        }
    }

    /// Takes the finished load; returns its answer and its line in the record.
    /// The line is given only where it differs, because a file's content is for its reader alone. With `waits` false
    /// nobody waits, and the load is not taken.
    pub(crate) fn loaded(
        &mut self,
        waits: impl FnOnce(Ticket) -> bool,
        control: &mut ControlEnd,
    ) -> Option<(Ticket, DaemonResponse, Option<String>)> {
        if let Some(ticket) = self.loader.give_up()
            && let Some(wish) = self.load_purpose.take()
        {
            let s = PATIENCE.as_secs();
            let text = match wish {
                LoadPurpose::Keep => format!(
                    "keeping took longer than {s} s and is given up: the record is not kept, unless an event record_kept \
                     follows"
                ),
                LoadPurpose::Model(_) | LoadPurpose::Table => {
                    format!("loading took longer than {s} s: nothing is loaded")
                }
            };
            return Some((ticket, DaemonResponse::refused("too_long", text), None));
        }
        let ((ticket, result), given_up) = self.loader.done()?;
        let wish = if given_up { None } else { self.load_purpose.take() };
        if let Ok(LoadedFiles::Kept(kept)) = result {
            // The record is there or not, whether or not the caller waits.
            let response = match &kept {
                Ok(_) => DaemonResponse::done(),
                Err(text) => DaemonResponse::refused("not_kept", text.clone()),
            };
            self.tell_kept(kept, control.status().t_ns);
            return Some((ticket, response, None));
        }
        let wish = wish?;
        if !waits(ticket) {
            return None;
        }
        let response = match (result, wish) {
            (Err(error), _) => {
                let place = InputError { found: "something else".to_owned(), ..error.clone() };
                return Some((
                    ticket,
                    DaemonResponse::Bad { text: error.to_string() },
                    Some(place.to_string()),
                ));
            }
            (Ok(LoadedFiles::Table { table, errors }), _) => self.take_table(table, errors),
            (Ok(LoadedFiles::Model { prepared, warnings, files }), LoadPurpose::Model(wanted)) => {
                self.model_ready(*prepared, warnings, &files, &wanted, control)
            }
            (Ok(LoadedFiles::Model { .. } | LoadedFiles::Kept(_)), _) => return None,
        };
        Some((ticket, response, None))
    }

    fn model_ready(
        &mut self,
        prepared: PreparedModel,
        mut warnings: Vec<String>,
        files: &BTreeMap<PathBuf, String>,
        wanted: &ModelLoadOptions,
        control: &mut ControlEnd,
    ) -> DaemonResponse {
        let machine = prepared.machine();
        let (sha256, file) = (machine.sha256().to_owned(), machine.path.clone());
        let Some(shown) = &wanted.take else {
            let preview = self.corrector.preview(prepared, &control.status());
            warnings.extend(preview.warnings);
            return DaemonResponse::ModelPreview(Box::new(ModelChangePreview { warnings, ..preview }));
        };
        if *shown != sha256 {
            let file = file.display();
            let text = format!(
                "{file} has changed since it was shown: nothing is loaded; `rtecctl model load` again"
            );
            return DaemonResponse::refused("changed", text);
        }
        let ended = self.ended(machine);
        if let Some(text) = ended.clone().filter(|_| !wanted.expired) {
            return DaemonResponse::refused("expired", text);
        }
        self.corrector.take(prepared);
        self.model_refused = None;
        let meant = ended.map_or(String::new(), |_| format!("{MEANT}\n"));
        let taken = format!("{sha256}\n{}\n{meant}{FOR}{}\n", file.display(), self.config.machine);
        let warnings = self.remember(&taken, files);
        let text = format!("machine model {} loaded, SHA-256 {sha256}", file.display());
        stderr_journal_log::record(
            SyslogLevel::Notice,
            "model_loaded",
            &text,
            &[("RTEC_MODEL_SHA256", &sha256)],
        );
        DaemonResponse::done_with(warnings)
    }

    /// Stores the model for a restart: its name and hash, and its files as read.
    /// Returns what could not be stored.
    fn remember(&self, text: &str, files: &BTreeMap<PathBuf, String>) -> Vec<String> {
        let named: BTreeMap<String, &String> =
            files.iter().map(|(path, text)| (path.display().to_string(), text)).collect();
        let kept = serde_json::to_vec(&named).unwrap_or_default();
        let at = |name: &str| self.directory().join(name);
        let written = [(KEPT, kept.as_slice()), (TAKEN, text.as_bytes())]
            .map(|(name, content)| (name, rtec_files::atomic_write::write_atomically(&at(name), content)));
        if written.iter().all(|(_, done)| done.is_ok()) {
            // The model runs now, so the unloaded one is not loaded again.
            let _ = std::fs::remove_file(at(UNLOADED));
        }
        self.failed(written, "a restart will not know which model was loaded")
    }

    /// Makes a restart load no model.
    /// Renaming the file needs no room on the disk, and writing would.
    fn forget(&self) -> Vec<String> {
        let at = |name: &str| self.directory().join(name);
        let renamed = match std::fs::rename(at(TAKEN), at(UNLOADED)) {
            Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        };
        self.failed([(TAKEN, renamed)], "a restart may take the model up again")
    }

    /// Logs and returns the failures of files beside the state file, with their effect.
    fn failed<const N: usize>(&self, done: [(&str, std::io::Result<()>); N], means: &str) -> Vec<String> {
        let failed = done.into_iter().filter_map(|(name, done)| {
            let text = format!("{}: {}: {means}", self.directory().join(name).display(), done.err()?);
            stderr_journal_log::say(SyslogLevel::Warning, &text);
            Some(text)
        });
        failed.collect()
    }

    pub(super) fn model_unload(&mut self) -> DaemonResponse {
        // A model that was refused at the start is given up too.
        let given_up = self.model_refused.take_if(|why| why != AGAIN).is_some();
        if !self.corrector.unload() && !given_up {
            let text = "no model is loaded: there is nothing to unload";
            return DaemonResponse::refused("no_model", text);
        }
        let warnings = self.forget();
        self.model_refused = self.directory().join(UNLOADED).exists().then(|| AGAIN.to_owned());
        stderr_journal_log::record(SyslogLevel::Notice, "model_unloaded", "machine model unloaded", &[]);
        DaemonResponse::done_with(warnings)
    }

    pub(super) fn table_load(&mut self, table: &PartTable, beside: RequestContext) -> RequestOutcome {
        let file = PathBuf::from(&table.errors);
        let mut files = beside.files;
        let source = match files.len() {
            1 => FileSource::Handed(files.pop().map(|fd| (file, fd)).into_iter().collect()),
            0 if beside.trusted => FileSource::Named,
            0 => return RequestOutcome::Now(by_name(&file)),
            n => {
                let file = file.display();
                let text = format!("found {n} descriptors with the request, expected one, of {file}");
                return RequestOutcome::Now(DaemonResponse::Bad { text });
            }
        };
        self.begin(LoadRequest::Table { table: table.clone(), source }, LoadPurpose::Table)
    }

    fn take_table(&mut self, table: PartTable, errors: FeatureErrors) -> DaemonResponse {
        let name = table.errors.clone();
        match self.corrector.load_table(table, errors) {
            Ok(()) => {
                stderr_journal_log::record(
                    SyslogLevel::Notice,
                    "table_loaded",
                    &format!("part table {name}"),
                    &[],
                );
                DaemonResponse::done()
            }
            Err(text) => DaemonResponse::Bad { text },
        }
    }

    pub(super) fn table_unload(&mut self) -> DaemonResponse {
        if !self.corrector.unload_table() {
            let text = "no part table is loaded: there is nothing to unload";
            return DaemonResponse::refused("no_table", text);
        }
        stderr_journal_log::record(SyslogLevel::Notice, "table_unloaded", "part table unloaded", &[]);
        DaemonResponse::done()
    }
}
