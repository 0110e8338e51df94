//! Registers in memory: a file that can be mapped.
//! Examples are shared memory, a PCI BAR in sysfs, and UIO.

use crate::card::CardError;
use crate::card_profile::{CardProfile, Width};
use crate::clock::Clock;
use crate::register_card::{RegisterAccess, RegisterCard, SetUpError};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::c_void;
use std::fs::File;
use std::num::NonZeroUsize;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::ptr::NonNull;

/// Reason why registers could not be mapped.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum MapError {
    #[error("{op} {}: {source}", path.display())]
    Io { op: &'static str, path: PathBuf, source: std::io::Error },
    #[error(
        "{}: found {found} bytes, expected at least {expected} for the registers of profile \"{profile}\"; \
         is this the right file or BAR?", path.display()
    )]
    TooSmall { path: PathBuf, found: u64, expected: u64, profile: String },
    #[error(
        "{}: found a device without map {map}, expected a file of registers, a PCI resource in sysfs, or a UIO device \
         with that map (/sys/class/uio)", path.display()
    )]
    NoSize { path: PathBuf, map: u8 },
    #[error(transparent)]
    SetUp(#[from] SetUpError),
}

/// A mapped file of registers.
/// Accesses are volatile, of the register's own width, aligned and inside the file.
#[derive(Debug)]
pub struct MappedRegisterFile {
    base: NonNull<c_void>,
    /// Offset of the registers in the mapping, and their length, bytes.
    start: usize,
    len: usize,
}

/// Offset of the registers in a UIO map's first page, and their size, bytes.
fn uio_map(device: &str, map: u8) -> Option<(usize, u64)> {
    let number = |file: &str| {
        let text = std::fs::read_to_string(format!("/sys/class/uio/{device}/maps/map{map}/{file}")).ok()?;
        u64::from_str_radix(text.trim().trim_start_matches("0x"), 16).ok()
    };
    Some((number("offset")? as usize, number("size")?))
}

// SAFETY: the mapping belongs to this value alone and is released only when it is dropped, whichever thread holds it.
unsafe impl Send for MappedRegisterFile {}

impl MappedRegisterFile {
    /// Maps the first `len` bytes of `path`, shared, for reading and writing.
    /// For a UIO device it maps the first map.
    ///
    /// # Errors
    /// As [`MappedRegisterFile::open_map`].
    pub fn open(path: &Path, len: usize, profile: &str) -> Result<Self, MapError> {
        Self::open_map(path, 0, len, profile)
    }

    /// Maps the first `len` bytes of a UIO device's map number `map`.
    ///
    /// # Errors
    /// When the file cannot be opened or mapped, or is shorter than `len` bytes.
    pub fn open_map(path: &Path, map: u8, len: usize, profile: &str) -> Result<Self, MapError> {
        let io = |op| move |source| MapError::Io { op, path: path.to_owned(), source };
        let file = File::options().read(true).write(true).custom_flags(libc::O_SYNC).open(path);
        let file = file.map_err(io("opening"))?;
        let metadata = file.metadata().map_err(io("measuring"))?;
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let (start, found) = if !metadata.file_type().is_char_device() {
            (0, metadata.len())
        } else if let Some(found) = uio_map(name, map) {
            found
        } else {
            return Err(MapError::NoSize { path: path.to_owned(), map });
        };
        let size = NonZeroUsize::new(start + len).filter(|_| len > 0 && found >= len as u64);
        let Some(size) = size else {
            return Err(MapError::TooSmall {
                path: path.to_owned(),
                found,
                expected: len as u64,
                profile: profile.to_owned(),
            });
        };
        // For a UIO device the offset is the map's number in pages (the kernel's UIO howto, mmap).
        // SAFETY: sysconf only reads a constant of the system.
        let page = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
        let at = i64::from(map) * page;
        // SAFETY: a new shared mapping at an address of the kernel's choice disturbs no other memory of the process.
        let base = unsafe {
            mmap(None, size, ProtFlags::PROT_READ | ProtFlags::PROT_WRITE, MapFlags::MAP_SHARED, &file, at)
        };
        let base = base.map_err(|e| io("mapping")(std::io::Error::from_raw_os_error(e as i32)))?;
        Ok(Self { base, start, len })
    }

    #[inline]
    fn at<T>(&self, offset: usize) -> *mut T {
        assert!(
            offset + size_of::<T>() <= self.len && offset.is_multiple_of(size_of::<T>()),
            "register outside the mapping"
        );
        self.base.as_ptr().wrapping_byte_add(self.start + offset).cast()
    }

    /// Reads a register of 8, 16 or 32 bits at a byte offset.
    ///
    /// # Panics
    /// When the offset is outside the mapping or not aligned to the width; a checked [`CardProfile`] never is.
    #[inline]
    pub fn read(&self, offset: usize, width: Width) -> u32 {
        // SAFETY: `at` has checked that the register lies inside the live mapping and is aligned.
        unsafe {
            match width {
                Width::Bits8 => u32::from(self.at::<u8>(offset).read_volatile()),
                Width::Bits16 => u32::from(self.at::<u16>(offset).read_volatile()),
                Width::Bits32 => self.at::<u32>(offset).read_volatile(),
            }
        }
    }

    /// Writes a register of 8, 16 or 32 bits at a byte offset.
    ///
    /// # Panics
    /// As [`MappedRegisterFile::read`].
    #[inline]
    pub fn write(&self, offset: usize, width: Width, value: u32) {
        // SAFETY: `at` has checked that the register lies inside the live mapping and is aligned.
        unsafe {
            match width {
                Width::Bits8 => self.at::<u8>(offset).write_volatile(value as u8),
                Width::Bits16 => self.at::<u16>(offset).write_volatile(value as u16),
                Width::Bits32 => self.at::<u32>(offset).write_volatile(value),
            }
        }
    }
}

impl Drop for MappedRegisterFile {
    fn drop(&mut self) {
        // SAFETY: base and length are those of the mapping made in `open`, and nothing refers to it any more.
        let _ = unsafe { munmap(self.base, self.start + self.len) };
    }
}

impl RegisterAccess for MappedRegisterFile {
    #[inline]
    fn read(&self, offset: usize, width: Width) -> Result<u32, CardError> {
        Ok(MappedRegisterFile::read(self, offset, width))
    }

    #[inline]
    fn write(&self, offset: usize, width: Width, value: u32) -> Result<(), CardError> {
        MappedRegisterFile::write(self, offset, width, value);
        Ok(())
    }
}

/// A card of memory-mapped registers.
pub type MappedCard<K> = RegisterCard<MappedRegisterFile, K>;

impl<K: Clock> MappedCard<K> {
    /// Maps `path` as the profile states.
    /// Only registers that the profile sets up after a reset are written. The outputs keep their levels.
    ///
    /// # Errors
    /// As [`MappedRegisterFile::open_map`] and [`RegisterCard::new`].
    pub fn open(path: &Path, profile: &CardProfile, clock: K) -> Result<Self, MapError> {
        Self::open_map(path, 0, profile, clock)
    }

    /// Maps map number `map` of a UIO device; otherwise as [`MappedCard::open`].
    ///
    /// # Errors
    /// As [`MappedRegisterFile::open_map`] and [`RegisterCard::new`].
    pub fn open_map(path: &Path, map: u8, profile: &CardProfile, clock: K) -> Result<Self, MapError> {
        Ok(Self::new(
            MappedRegisterFile::open_map(path, map, profile.size(), &profile.name)?,
            profile,
            clock,
        )?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::card::{Card, CardInputSample};
    use crate::clock::Virtual;

    fn card(bytes: usize) -> (tempfile::NamedTempFile, Result<MappedCard<Virtual>, MapError>) {
        let file = tempfile::NamedTempFile::new().unwrap();
        file.as_file().set_len(bytes as u64).unwrap();
        let card = MappedCard::open(file.path(), &CardProfile::shared_memory(), Virtual { now_ns: 7 });
        (file, card)
    }

    #[test]
    fn inputs_and_outputs_are_the_registers() {
        let (file, card) = card(4096);
        let mut card = card.unwrap();
        let outside = MappedRegisterFile::open(file.path(), 16, "outside").unwrap();
        outside.write(0, Width::Bits32, 0x8000_0005);
        assert_eq!(card.sample(0).unwrap(), CardInputSample::level(7, 0x8000_0005));
        card.write(0b11, 0b01).unwrap();
        card.write(0b1000, 0b1000).unwrap();
        assert_eq!(outside.read(4, Width::Bits32), 0b1001);
        assert_eq!(card.outputs().unwrap(), 0b1001);
    }

    #[test]
    fn outputs_left_on_by_a_dead_process_are_taken_over() {
        let (file, first) = card(4096);
        first.unwrap().write(3, 3).unwrap();
        let mut again =
            MappedCard::open(file.path(), &CardProfile::shared_memory(), Virtual::default()).unwrap();
        again.write(4, 4).unwrap();
        assert_eq!(again.outputs().unwrap(), 7);
    }

    #[test]
    fn a_file_too_small_is_refused_before_the_first_access() {
        let (_file, card) = card(7);
        let text = card.unwrap_err().to_string();
        assert!(text.contains("found 7 bytes, expected at least 8"), "{text}");
    }

    #[test]
    fn a_device_without_a_size_is_refused() {
        let card =
            MappedCard::open(Path::new("/dev/null"), &CardProfile::shared_memory(), Virtual::default());
        assert!(matches!(card.unwrap_err(), MapError::NoSize { .. }));
    }

    #[test]
    fn a_missing_file_is_named() {
        let e = MappedCard::open(
            Path::new("/nonexistent/card"),
            &CardProfile::shared_memory(),
            Virtual::default(),
        );
        assert!(e.unwrap_err().to_string().contains("/nonexistent/card"));
    }
}
