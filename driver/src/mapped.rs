//! A card whose registers are memory: any file that can be mapped (shared memory, a PCI BAR, UIO).

use crate::card::{Card, CardError, Sample};
use crate::clock::Clock;
use crate::profile::{Profile, Register, Width};
use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use std::ffi::c_void;
use std::fs::File;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::ptr::NonNull;

/// Why registers could not be mapped.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file could not be opened, measured or mapped.
    #[error("{op} {}: {source}", path.display())]
    Io {
        /// What was tried.
        op: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file holds fewer bytes than the profile's registers need.
    #[error(
        "{}: found {found} bytes, expected at least {expected} for the registers of profile \"{profile}\"; \
         is this the right file or BAR?", path.display()
    )]
    TooSmall {
        /// The file.
        path: PathBuf,
        /// Its size in bytes.
        found: u64,
        /// What the profile needs, in bytes.
        expected: u64,
        /// The profile's name.
        profile: String,
    },
}

/// A mapped file of registers. Accesses are volatile, of the register's own width, aligned and inside the file.
#[derive(Debug)]
pub struct Registers {
    base: NonNull<c_void>,
    len: usize,
}

// SAFETY: the mapping belongs to this value alone and is released only when it is dropped, whichever thread holds it.
unsafe impl Send for Registers {}

impl Registers {
    /// Maps the first `len` bytes of `path`, shared, for reading and writing.
    ///
    /// # Errors
    /// When the file cannot be opened or mapped, or is shorter than `len` bytes.
    pub fn open(path: &Path, len: usize, profile: &str) -> Result<Self, MapError> {
        let io = |op| move |source| MapError::Io { op, path: path.to_owned(), source };
        let file = File::options().read(true).write(true).open(path).map_err(io("opening"))?;
        let found = file.metadata().map_err(io("measuring"))?.len();
        let size = NonZeroUsize::new(len).filter(|_| found >= len as u64);
        let Some(size) = size else {
            return Err(MapError::TooSmall {
                path: path.to_owned(),
                found,
                expected: len as u64,
                profile: profile.to_owned(),
            });
        };
        // SAFETY: a new shared mapping at an address of the kernel's choice disturbs no other memory of the process.
        let base = unsafe {
            mmap(None, size, ProtFlags::PROT_READ | ProtFlags::PROT_WRITE, MapFlags::MAP_SHARED, &file, 0)
        };
        let base = base.map_err(|e| io("mapping")(std::io::Error::from_raw_os_error(e as i32)))?;
        Ok(Self { base, len })
    }

    #[inline]
    fn at<T>(&self, offset: usize) -> *mut T {
        assert!(
            offset + size_of::<T>() <= self.len && offset.is_multiple_of(size_of::<T>()),
            "register outside the mapping"
        );
        self.base.as_ptr().wrapping_byte_add(offset).cast()
    }

    /// Reads a register of 8, 16 or 32 bits at a byte offset.
    ///
    /// # Panics
    /// When the offset is outside the mapping or not aligned to the width; a checked [`Profile`] never is.
    #[inline]
    #[must_use]
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
    /// As [`Registers::read`].
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

impl Drop for Registers {
    fn drop(&mut self) {
        // SAFETY: base and length are those of the mapping made in `open`, and nothing refers to it any more.
        let _ = unsafe { munmap(self.base, self.len) };
    }
}

/// One register's part of the 64-bit word that the engine sees.
#[derive(Debug, Clone, Copy)]
struct Part {
    offset: usize,
    width: Width,
    shift: u32,
}

/// A card of mapped registers.
#[derive(Debug)]
pub struct MappedCard<K> {
    registers: Registers,
    inputs: Box<[Part]>,
    outputs: Box<[Part]>,
    input_invert: u64,
    output_invert: u64,
    /// The output registers as last written, so that a masked write needs no read over the bus.
    written: u64,
    clock: K,
}

impl<K: Clock> MappedCard<K> {
    /// Maps `path` as the profile says. No register is written; the outputs are taken over as they stand.
    ///
    /// # Errors
    /// As [`Registers::open`].
    pub fn open(path: &Path, profile: &Profile, clock: K) -> Result<Self, MapError> {
        let registers = Registers::open(path, profile.size(), &profile.name)?;
        let parts = |registers: &[Register]| {
            let mut shift = 0;
            let mut parts = Vec::new();
            for r in registers {
                parts.push(Part { offset: r.offset, width: r.width, shift });
                shift += r.width.bits();
            }
            parts.into_boxed_slice()
        };
        let mut card = Self {
            registers,
            inputs: parts(&profile.inputs),
            outputs: parts(&profile.outputs),
            input_invert: profile.input_invert,
            output_invert: profile.output_invert,
            written: 0,
            clock,
        };
        card.written = card.gather(&card.outputs);
        Ok(card)
    }

    #[inline]
    fn gather(&self, parts: &[Part]) -> u64 {
        parts.iter().fold(0, |word, p| word | u64::from(self.registers.read(p.offset, p.width)) << p.shift)
    }
}

impl<K: Clock> Card for MappedCard<K> {
    #[inline]
    fn sample(&mut self, _wake_ns: u64) -> Result<Sample, CardError> {
        let inputs = self.gather(&self.inputs) ^ self.input_invert;
        Ok(Sample::level(self.clock.now_ns(), inputs))
    }

    #[inline]
    fn write(&mut self, mask: u64, value: u64) -> Result<Option<u64>, CardError> {
        let raw = self.written & !mask | (value ^ self.output_invert) & mask;
        let changed = raw ^ self.written;
        self.written = raw;
        for p in &self.outputs {
            if changed >> p.shift & p.width.mask() != 0 {
                self.registers.write(p.offset, p.width, (raw >> p.shift & p.width.mask()) as u32);
            }
        }
        Ok(None)
    }

    fn outputs(&mut self) -> Result<u64, CardError> {
        Ok(self.gather(&self.outputs) ^ self.output_invert)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Virtual;

    fn card(bytes: usize) -> (tempfile::NamedTempFile, Result<MappedCard<Virtual>, MapError>) {
        let file = tempfile::NamedTempFile::new().unwrap();
        file.as_file().set_len(bytes as u64).unwrap();
        let card = MappedCard::open(file.path(), &Profile::shared_memory(), Virtual { now_ns: 7 });
        (file, card)
    }

    #[test]
    fn inputs_and_outputs_are_the_registers() {
        let (file, card) = card(4096);
        let mut card = card.unwrap();
        let outside = Registers::open(file.path(), 16, "outside").unwrap();
        outside.write(0, Width::Bits32, 0x8000_0005);
        assert_eq!(card.sample(0).unwrap(), Sample::level(7, 0x8000_0005));
        card.write(0b11, 0b01).unwrap();
        card.write(0b1000, 0b1000).unwrap();
        assert_eq!(outside.read(4, Width::Bits32), 0b1001);
        assert_eq!(card.outputs().unwrap(), 0b1001);
    }

    #[test]
    fn outputs_left_on_by_a_dead_process_are_taken_over() {
        let (file, first) = card(4096);
        first.unwrap().write(3, 3).unwrap();
        let mut again = MappedCard::open(file.path(), &Profile::shared_memory(), Virtual::default()).unwrap();
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
    fn a_missing_file_is_named() {
        let e =
            MappedCard::open(Path::new("/nonexistent/card"), &Profile::shared_memory(), Virtual::default());
        assert!(e.unwrap_err().to_string().contains("/nonexistent/card"));
    }
}
