//! The listening sockets, one for each role, open to its group only.

use crate::DaemonStartFailure;
use anyhow::Context;
use nix::sys::stat::{Mode, umask};
use nix::unistd::{Gid, Group, Uid, chown};
use rtec_control::client_role::ClientRole;
use rtec_control::config::{ConfiguredSocket, ControlConfig, LONGEST_SOCKET};
use rtec_control::single_process_lock;
use std::fs::{DirBuilder, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

/// A listening socket.
pub(crate) struct ListeningSocket {
    pub role: ClientRole,
    pub path: PathBuf,
    /// The group that may use it.
    pub group: Option<String>,
    pub listener: UnixListener,
}

/// All listening sockets, and the lock on their names, until it is dropped.
pub(crate) struct ListeningSockets {
    pub all: Vec<ListeningSocket>,
    /// The group of viewers, which may read the record of commands too.
    pub viewers: Option<Gid>,
    _lock: single_process_lock::LockGuard,
}

impl Drop for ListeningSockets {
    fn drop(&mut self) {
        // The lock is still held, so no other process has sockets of these names.
        for socket in &self.all {
            let _ = std::fs::remove_file(&socket.path);
        }
    }
}

/// Opens the sockets.
pub(crate) fn listen(control: &ControlConfig) -> anyhow::Result<ListeningSockets> {
    let sockets = control.sockets();
    let groups: Vec<Option<Gid>> = sockets.iter().map(group).collect::<Result<_, _>>()?;
    let open = groups.iter().any(Option::is_some) || sockets.iter().any(|s| s.mode & 0o066 != 0);
    for socket in &sockets {
        let bytes = socket.path.as_os_str().len();
        if bytes > LONGEST_SOCKET {
            let found = format!("socket {}: found a path of {bytes} bytes", socket.path.display());
            return Err(
                DaemonStartFailure::Taken(format!("{found}, expected at most {LONGEST_SOCKET}")).into()
            );
        }
        directory(&socket.path, open)?;
    }
    let lock = single_process_lock::socket(&control.socket).map_err(DaemonStartFailure::from)?;
    let mut listening = ListeningSockets { all: Vec::new(), viewers: groups[2], _lock: lock };
    for (socket, group) in sockets.into_iter().zip(groups) {
        let listener = bind(&socket, group)?;
        let ConfiguredSocket { role, path, group, .. } = socket;
        listening.all.push(ListeningSocket { role, path, group, listener });
    }
    Ok(listening)
}

fn group(socket: &ConfiguredSocket) -> anyhow::Result<Option<Gid>> {
    let Some(name) = &socket.group else { return Ok(None) };
    let found = Group::from_name(name).with_context(|| format!("looking up group {name}"))?;
    let key = if socket.role == ClientRole::SetUp { "group" } else { socket.role.word() };
    Ok(Some(found.with_context(|| format!("there is no group {name} (found in [control] {key})"))?.gid))
}

/// Makes the socket's directory where it is missing.
/// Only the daemon can use it, unless a group uses a socket in it. A directory that everybody can write to is refused,
/// because others could replace our files.
fn directory(socket: &Path, open: bool) -> anyhow::Result<()> {
    let Some(directory) = socket.parent().filter(|d| !d.as_os_str().is_empty()) else { return Ok(()) };
    if !directory.exists() {
        let mode = if open { 0o711 } else { 0o700 };
        // Directories above it are open to everybody, as the system's own are.
        if let Some(above) = directory.parent().filter(|d| !d.as_os_str().is_empty() && !d.exists()) {
            let made = DirBuilder::new().recursive(true).mode(0o755).create(above);
            made.with_context(|| format!("creating {}", above.display()))?;
        }
        let made = DirBuilder::new().mode(mode).create(directory);
        made.with_context(|| format!("creating {}", directory.display()))?;
        // Whatever the process's umask is.
        std::fs::set_permissions(directory, Permissions::from_mode(mode))?;
    }
    let (found, directory) = (std::fs::metadata(directory), directory.display());
    let found = found.with_context(|| format!("looking at {directory}"))?;
    let (owner, mode) = (found.uid(), found.mode() & 0o7777);
    if mode & 0o002 != 0 || owner != 0 && owner != Uid::effective().as_raw() {
        let why = format!(
            "directory {directory}: found mode {mode:o} and owner {owner}, expected one of our own that not everybody can write \
             to ([control] socket, --socket)"
        );
        return Err(DaemonStartFailure::Taken(why).into());
    }
    Ok(())
}

fn bind(socket: &ConfiguredSocket, group: Option<Gid>) -> anyhow::Result<UnixListener> {
    let path = &socket.path;
    clear_stale(path)?;
    // Created without access for others. The group gets access before the first client can be served.
    let before = umask(Mode::from_bits_truncate(0o177));
    let listener = UnixListener::bind(path);
    umask(before);
    let listener = listener.with_context(|| format!("binding {}", path.display()))?;
    if group.is_some() {
        chown(path, None, group).with_context(|| format!("giving {} to its group", path.display()))?;
    }
    std::fs::set_permissions(path, Permissions::from_mode(socket.mode))?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Removes a socket that no process listens on.
fn clear_stale(socket: &Path) -> anyhow::Result<()> {
    let Ok(found) = std::fs::symlink_metadata(socket) else { return Ok(()) };
    let shown = socket.display();
    if !found.file_type().is_socket() {
        let why = format!("{shown}: found something that is no socket, expected nothing or an old socket");
        return Err(DaemonStartFailure::Taken(why).into());
    }
    match UnixStream::connect(socket) {
        Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
            std::fs::remove_file(socket).with_context(|| format!("removing the old socket {shown}"))
        }
        Err(error) => Err(error).with_context(|| format!("trying the socket {shown}")),
        Ok(_) => {
            Err(DaemonStartFailure::Taken(format!("socket {shown} is in use: another program listens at it"))
                .into())
        }
    }
}
