//! Folders, and how a file is named from another one's.

use std::path::{Path, PathBuf};

/// The folder that a file stands in, whole where it exists.
pub(super) fn folder_of(path: &Path) -> PathBuf {
    let parent = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    whole(parent)
}

/// A folder's path from the root on, without `..`.
pub(super) fn whole(folder: &Path) -> PathBuf {
    folder.canonicalize().unwrap_or_else(|_| {
        // It is not there: by its name.
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

/// A path as it is named from a folder; both whole.
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
