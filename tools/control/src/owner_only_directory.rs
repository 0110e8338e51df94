//! Directories that only their owners can write to.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The owner of a socket's directory, if only owners can write on the way there.
/// Otherwise the error is the directory that is open to everybody.
///
/// # Errors
/// That directory; none if one cannot be examined.
pub(crate) fn directory_owner(socket: &Path) -> Result<u32, Option<PathBuf>> {
    let parent = socket.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let directory = std::fs::canonicalize(parent).map_err(|_| None)?;
    for above in directory.ancestors() {
        if std::fs::metadata(above).map_err(|_| None)?.mode() & 0o002 != 0 {
            return Err(Some(above.to_owned()));
        }
    }
    std::fs::metadata(&directory).map(|found| found.uid()).map_err(|_| None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_directory_that_others_can_write_to_vouches_for_nobody() {
        let open = tempfile::tempdir_in("/tmp").unwrap();
        assert_eq!(
            directory_owner(&open.path().join("s")),
            Err(Some("/tmp".into())),
            "/tmp is for everybody"
        );
        assert_eq!(directory_owner(Path::new("/etc/s")), Ok(0));
    }
}
