//! `[control]`: sockets with their users, and files that outlive the process.

use super::{Config, ConfigFindings, INSTALLED, beside, keys};
use crate::client_role::ClientRole;
use crate::owner_only_directory::directory_owner;
use nix::unistd::{Group, Uid};
use rtec_files::toml_section_keys::{FileWithFindings, TomlSection};
use std::path::{Path, PathBuf};

/// Longest path of a Unix socket, bytes (unix(7): 108 with the zero at its end).
pub const LONGEST_SOCKET: usize = 107;

/// The control sockets and what belongs to them: the keys of `[control]`.
/// A key that is `None` has a default, which the methods give.
#[derive(Debug, Clone, PartialEq, Eq)]
#[allow(missing_docs)] // the table of keys describes them
pub struct ControlConfig {
    pub socket: PathBuf,
    pub group: Option<String>,
    pub mode: Option<u32>,
    pub operate: RoleSocketConfig,
    pub view: RoleSocketConfig,
    pub state_file: Option<PathBuf>,
    pub log_file: Option<PathBuf>,
    pub log_anchor: bool,
    /// Folder in which finished records are kept for the shop; none without one.
    pub spool: Option<PathBuf>,
    pub spool_mb: u64,
    pub stale_ms: u64,
}

/// A socket of a lesser role, as configured.
/// Without a group only the daemon's own user may use it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
#[allow(missing_docs)] // the table of keys describes them
pub struct RoleSocketConfig {
    pub socket: Option<PathBuf>,
    pub group: Option<String>,
    pub mode: Option<u32>,
}

/// A socket that the daemon creates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfiguredSocket {
    /// Role of its connections.
    pub role: ClientRole,
    /// Its path.
    pub path: PathBuf,
    /// The group that may use it.
    pub group: Option<String>,
    /// Its mode: 0660 with a group, 0600 without, unless configured.
    pub mode: u32,
}

/// Directory of the records of an installed daemon, made by its service.
const INSTALLED_LOGS: &str = "/var/log/rtec";
/// Directory of an installed daemon's socket and state, made by its service.
const INSTALLED_RUN: &str = "/run/rtec";

impl ControlConfig {
    /// The daemon at this socket, or of this configuration, or the installed one.
    ///
    /// # Errors
    /// The findings in the configuration that is named.
    pub fn of(config: Option<&Path>, socket: Option<&Path>) -> Result<Self, ConfigFindings> {
        if let Some(socket) = socket {
            // Another daemon than that of the file: everything is derived from this socket.
            return Ok(Self { socket: socket.to_owned(), ..Config::embedded().control });
        }
        match config {
            Some(file) => Ok(Config::load(file)?.control),
            // Not named by the user: if the file has mistakes, the daemon has reported them.
            None => Ok(Config::load(Path::new(INSTALLED)).unwrap_or_else(|_| Config::embedded()).control),
        }
    }

    /// Path of the state file: as configured, else beside the socket.
    pub fn state_path(&self) -> PathBuf {
        self.state_file.clone().unwrap_or_else(|| self.socket.with_file_name("state"))
    }

    /// Path of the record of every command: as configured.
    /// Otherwise it is in `/var/log/rtec` for an installed daemon, else beside the state file.
    pub fn log_path(&self) -> PathBuf {
        let state = self.state_path();
        let installed =
            state.parent() == Some(Path::new(INSTALLED_RUN)) && Path::new(INSTALLED_LOGS).is_dir();
        let beside = || state.with_file_name("audit.log");
        let usual = || if installed { Path::new(INSTALLED_LOGS).join("audit.log") } else { beside() };
        self.log_file.clone().unwrap_or_else(usual)
    }

    /// The sockets, one for each role, the most powerful first.
    pub fn sockets(&self) -> [ConfiguredSocket; 3] {
        let at = |role, path: PathBuf, group: &Option<String>, mode: Option<u32>| ConfiguredSocket {
            role,
            path,
            mode: mode.unwrap_or(if group.is_some() { 0o660 } else { 0o600 }),
            group: group.clone(),
        };
        let socket_at = |role, named: &RoleSocketConfig| {
            let path = named.socket.clone().unwrap_or_else(|| derived(&self.socket, role));
            at(role, path, &named.group, named.mode)
        };
        [
            at(ClientRole::SetUp, self.socket.clone(), &self.group, self.mode),
            socket_at(ClientRole::Operate, &self.operate),
            socket_at(ClientRole::View, &self.view),
        ]
    }
}

/// The socket of a role, from the path of the main one.
/// `control.sock` gives `control-view.sock`.
pub fn derived(socket: &Path, role: ClientRole) -> PathBuf {
    if role == ClientRole::SetUp {
        return socket.to_owned();
    }
    let mut name = socket.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{}", role.word()));
    if let Some(extension) = socket.extension() {
        name.push(".");
        name.push(extension);
    }
    socket.with_file_name(name)
}

/// Default directory of sockets and state file.
/// It is the one of `RTEC_RUN_DIR`. Otherwise it is `/run/rtec` for root, or if that exists (an installed
/// daemon's). Otherwise it is the user's run-time directory, then the user's state directory. It is never one
/// that others can write to.
pub fn default_directory() -> PathBuf {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    if let Some(directory) = absolute("RTEC_RUN_DIR") {
        return directory;
    }
    let installed = Path::new(INSTALLED_RUN);
    if installed.is_dir() || Uid::effective().is_root() {
        return installed.to_owned();
    }
    if let Some(directory) = absolute("XDG_RUNTIME_DIR") {
        return directory.join("rtec");
    }
    let home = || absolute("HOME").map(|home| home.join(".local/state"));
    // A user without a home has no directory. The error then names the missing session's directory.
    let none = || PathBuf::from(format!("/run/user/{}", Uid::effective()));
    absolute("XDG_STATE_HOME").or_else(home).unwrap_or_else(none).join("rtec")
}

/// Reads `[control]`; `here` if this is the computer that it is meant for.
pub(super) fn read(
    source: &mut FileWithFindings<'_>,
    root: &mut TomlSection<'_>,
    here: bool,
) -> ControlConfig {
    let mut table = root.table(source, "control", "[control]").with(keys::CONTROL);
    let own = read_role_socket(source, &mut table, here);
    let [operate, view] = ["operate", "view"].map(|role| {
        if !table.has(role) {
            return RoleSocketConfig::default();
        }
        let mut inner = table.table(source, role, role).with(keys::SOCKET);
        let socket_at = read_role_socket(source, &mut inner, here);
        inner.finish(source);
        socket_at
    });
    let state_file = table.text(source, "state_file").map(|at| beside(source.file, at.value));
    let log_file = table.text(source, "log_file");
    let config = ControlConfig {
        socket: own.socket.unwrap_or_else(|| default_directory().join("control.sock")),
        group: own.group,
        mode: own.mode,
        operate,
        view,
        state_file,
        log_file: log_file.map(|at| beside(source.file, at.value)),
        log_anchor: table.flag(source, "log_anchor"),
        spool: table.text(source, "spool").map(|at| beside(source.file, at.value)),
        spool_mb: table.whole_or_default(source, "spool_mb") as u64,
        stale_ms: table.whole_or_default(source, "stale_ms") as u64,
    };
    let offset = table.offset;
    table.finish(source);
    if let Some(at) = log_file.filter(|_| config.log_path() == config.state_path()) {
        let found = format!("log_file = \"{}\", which is the state file", at.value);
        source.finding(at.offset, found, "a file of its own for each");
    }
    if let Some(at) = log_file.filter(|_| here)
        && let Some(folder) = config.log_path().parent().filter(|d| !d.as_os_str().is_empty() && !d.is_dir())
    {
        let found = format!("log_file = \"{}\" in {}, which is no folder here", at.value, folder.display());
        source.finding(at.offset, found, "a folder that is there and that the daemon may write to");
    }
    let sockets = config.sockets();
    if let Some(long) = sockets.iter().find(|s| s.path.as_os_str().len() > LONGEST_SOCKET) {
        let found = format!(
            "the socket of role \"{}\" with a path of {} bytes",
            long.role,
            long.path.as_os_str().len()
        );
        source.finding(
            offset,
            found,
            format!("at most {LONGEST_SOCKET} bytes (unix(7)): a shorter directory"),
        );
    }
    for (n, socket) in sockets.iter().enumerate() {
        if sockets[..n].iter().any(|s| s.path == socket.path) {
            let found = format!("the socket of role \"{}\" at the path of another role", socket.role);
            source.finding(offset, found, "a path of its own for each role");
        }
    }
    config
}

/// Notes about settings that allow more than may be intended.
/// `here`: this is the computer that it is meant for.
pub(super) fn notes(control: &ControlConfig, here: bool) -> Vec<String> {
    let mut notes = Vec::new();
    if let Some(spool) = control.spool.as_ref().filter(|s| here && !s.is_dir()) {
        notes.push(format!(
            "[control] spool: {} is no folder here: no record is kept until it is one that the daemon may write to",
            spool.display()
        ));
    }
    let sockets = control.sockets();
    for s in &sockets {
        if s.role > ClientRole::View && s.mode & 0o006 != 0 {
            notes.push(format!(
                "[control]: every user of this computer may use the socket of role \"{}\" (mode 0{:o})",
                s.role, s.mode
            ));
        }
    }
    for (n, s) in sockets.iter().enumerate() {
        if let Some(more) = sockets[..n].iter().find(|m| s.group.is_some() && m.group == s.group) {
            let group = s.group.as_deref().unwrap_or_default();
            notes.push(format!(
                "[control]: group {group} may \"{}\", so that its socket of role \"{}\" takes nothing away",
                more.role, s.role
            ));
        }
    }
    let others = sockets.iter().any(|s| s.group.is_some() || s.mode & 0o066 != 0);
    if others && control.view.group.is_none() && sockets[2].mode & 0o066 == 0 {
        notes.push(
            "[control] view has no group: nobody but the daemon's user may see without being able to do more"
                .to_owned(),
        );
    }
    if others && let Err(Some(open)) = directory_owner(&control.socket) {
        notes.push(format!(
            "[control] socket: everybody can write to {}: another user's `rtecctl` will not trust a daemon there that is not \
             root's",
            open.display()
        ));
    }
    notes
}

fn read_role_socket(
    source: &mut FileWithFindings<'_>,
    table: &mut TomlSection<'_>,
    here: bool,
) -> RoleSocketConfig {
    let socket = table.text(source, "socket");
    let group = table.text(source, "group");
    if let Some(at) = group
        && here
        && matches!(Group::from_name(at.value), Ok(None))
    {
        let found = format!("group = \"{}\", which does not exist on this computer", at.value);
        source.finding(at.offset, found, "a group that exists: `groupadd --system NAME`, or another name");
    }
    let meaning = "the socket's mode, as \"0660\"";
    let mode = table.value(source, "mode", meaning, |v| {
        let digits = v.as_str().and_then(|s| u32::from_str_radix(s.trim_start_matches("0o"), 8).ok());
        digits.or_else(|| u32::try_from(v.as_integer()?).ok()).filter(|m| *m <= 0o777)
    });
    // To connect to a socket is to write to it: who may only read may do nothing.
    if let Some(at) = mode.filter(|at| ![0o600, 0o660, 0o666].contains(&at.value)) {
        let found = format!("mode = 0{:o}", at.value);
        source.finding(at.offset, found, "0600, 0660 or 0666: whoever uses a socket reads and writes it");
    }
    RoleSocketConfig {
        socket: socket.map(|at| beside(source.file, at.value)),
        group: group.map(|g| g.value.to_owned()),
        mode: mode.map(|m| m.value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_role_has_a_path_of_its_own() {
        let at = |p: &str, role| derived(Path::new(p), role).display().to_string();
        assert_eq!(at("/run/rtec/control.sock", ClientRole::View), "/run/rtec/control-view.sock");
        assert_eq!(at("s", ClientRole::Operate), "s-operate");
        assert_eq!(at("s", ClientRole::SetUp), "s");
    }

    #[test]
    fn what_opens_more_than_was_meant_is_noted() {
        let with = |control: &str| {
            let text = format!("{}\n[control]\n{control}\n", crate::config::EMBEDDED);
            crate::config::Config::parse(Path::new("/etc/rtec/rtec.toml"), &text).unwrap().notes.join("; ")
        };
        let three = "group = 'a'\noperate = { group = 'b' }\nview = { group = 'c' }";
        assert_eq!(with("stale_ms = 400"), "");
        assert_eq!(with(three), "");
        for (control, wanted) in [
            (
                "mode = '0666'\nview = { mode = '0666' }",
                "every user of this computer may use the socket of role \"set up\"",
            ),
            (&three.replace("'b'", "'a'"), "group a may \"set up\", so that its socket of role \"operate\""),
            ("operate = { group = 'b' }", "view has no group"),
            (&format!("socket = '/tmp/s'\n{three}"), "everybody can write to /tmp"),
        ] {
            assert!(with(control).contains(wanted), "{control}: {}", with(control));
        }
    }
}
