//! Folders, and the path of one file from another file's folder.

use std::path::{Path, PathBuf};

/// The folder of a file, as an absolute path if it exists.
pub(super) fn folder_of(path: &Path) -> PathBuf {
    let parent = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    whole(parent)
}

/// The absolute path of a folder, without `..`.
pub(super) fn whole(folder: &Path) -> PathBuf {
    folder.canonicalize().unwrap_or_else(|_| {
        // The folder does not exist, so only its name is used.
        let mut plain = PathBuf::new();
        for part in std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()).components() {
            if part == std::path::Component::ParentDir {
                plain.pop();
            } else {
                plain.push(part);
            }
        }
        plain
    })
}

/// The path from a folder to a path; both are absolute.
pub(super) fn named_from(folder: &Path, path: &Path) -> PathBuf {
    let (mut here, mut there) = (folder.components().peekable(), path.components().peekable());
    if here.peek() != there.peek() {
        return path.to_owned();
    }
    while here.peek().is_some() && here.peek() == there.peek() {
        here.next();
        there.next();
    }
    here.map(|_| Path::new("..").as_os_str()).chain(there.map(std::path::Component::as_os_str)).collect()
}
