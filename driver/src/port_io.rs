//! Port I/O: a parallel port, or any I/O ports of a PC.
//! A parallel port is reached through the kernel's `ppdev`, other ports by the processor's own instructions.
//!
//! Each access costs about a microsecond on an old bus, so a write that changes nothing is not made
//! ([`RegisterCard::write`](crate::register_card::RegisterCard)).

use crate::card::CardError;
use crate::card_profile::Width;
use crate::register_card::RegisterAccess;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Reason why ports could not be opened.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)] // the messages say what they are
pub enum PortError {
    #[error(
        "I/O ports {base:#x} to {last:#x}: {source}; it takes CAP_SYS_RAWIO, a kernel without lockdown, and a processor \
         that has port I/O"
    )]
    Refused { base: u16, last: usize, source: io::Error },
    #[error("{op} {}: {source}{hint}", path.display())]
    Parport { op: &'static str, path: PathBuf, source: io::Error, hint: &'static str },
}

/// I/O ports by the instructions `in` and `out`, without system calls.
#[derive(Debug)]
pub struct IoPorts {
    base: u16,
    len: usize,
}

impl IoPorts {
    /// Takes `len` ports from `base`, for this thread and those that it starts later.
    ///
    /// # Errors
    /// When the kernel refuses, or the processor has no ports.
    pub fn open(base: u16, len: usize) -> Result<Self, PortError> {
        let last = usize::from(base) + len.max(1) - 1;
        let permitted =
            if last > 0xffff { Err(io::ErrorKind::InvalidInput.into()) } else { permit(base, len) };
        permitted.map_err(|source| PortError::Refused { base, last, source })?;
        Ok(Self { base, len })
    }

    /// The port of a register.
    #[inline]
    fn at(&self, offset: usize, width: Width) -> u16 {
        assert!(offset + width.bits() as usize / 8 <= self.len, "register outside the ports");
        self.base + offset as u16
    }
}

#[cfg(target_arch = "x86_64")]
fn permit(base: u16, len: usize) -> io::Result<()> {
    // SAFETY: the call changes only which ports this thread may touch.
    match unsafe { libc::ioperm(u64::from(base), len as u64, 1) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn permit(_base: u16, _len: usize) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(target_arch = "x86_64")]
impl RegisterAccess for IoPorts {
    #[inline]
    fn read(&self, offset: usize, width: Width) -> Result<u32, CardError> {
        use std::arch::asm;
        let port = self.at(offset, width);
        let value: u32;
        // SAFETY: `open` has got this thread the ports, `at` has checked that this is one; reading touches no memory.
        unsafe {
            match width {
                Width::Bits8 => {
                    asm!("in al, dx", in("dx") port, inout("eax") 0 => value, options(nomem, nostack));
                }
                Width::Bits16 => {
                    asm!("in ax, dx", in("dx") port, inout("eax") 0 => value, options(nomem, nostack));
                }
                Width::Bits32 => asm!("in eax, dx", in("dx") port, out("eax") value, options(nomem, nostack)),
            }
        }
        Ok(value)
    }

    #[inline]
    fn write(&self, offset: usize, width: Width, value: u32) -> Result<(), CardError> {
        use std::arch::asm;
        let port = self.at(offset, width);
        // SAFETY: `open` has got this thread the ports, `at` has checked that this is one; writing touches no memory.
        unsafe {
            match width {
                Width::Bits8 => asm!("out dx, al", in("dx") port, in("eax") value, options(nomem, nostack)),
                Width::Bits16 => asm!("out dx, ax", in("dx") port, in("eax") value, options(nomem, nostack)),
                Width::Bits32 => asm!("out dx, eax", in("dx") port, in("eax") value, options(nomem, nostack)),
            }
        }
        Ok(())
    }
}

#[cfg(not(target_arch = "x86_64"))]
impl RegisterAccess for IoPorts {
    fn read(&self, _offset: usize, _width: Width) -> Result<u32, CardError> {
        Err(CardError::Io { op: "reading an I/O port", errno: libc::ENOSYS })
    }

    fn write(&self, _offset: usize, _width: Width, _value: u32) -> Result<(), CardError> {
        Err(CardError::Io { op: "writing an I/O port", errno: libc::ENOSYS })
    }
}

/// The calls of `linux/ppdev.h`.
mod call {
    nix::ioctl_read!(read_status, b'p', 0x81, u8);
    nix::ioctl_read!(read_control, b'p', 0x83, u8);
    nix::ioctl_write_ptr!(write_control, b'p', 0x84, u8);
    nix::ioctl_read!(read_data, b'p', 0x85, u8);
    nix::ioctl_write_ptr!(write_data, b'p', 0x86, u8);
    nix::ioctl_none!(claim, b'p', 0x8b);
    nix::ioctl_none!(exclusive, b'p', 0x8f);
}

/// A parallel port through `/dev/parportN`.
/// Offsets are those of its I/O ports: data 0, status 1, control 2. Each access is a system call. [`IoPorts`] avoids
/// system calls.
#[derive(Debug)]
pub struct Parport {
    file: File,
}

impl Parport {
    /// Opens the port and claims it exclusively for this process.
    ///
    /// # Errors
    /// It does not exist, or another driver holds it.
    pub fn open(path: &Path) -> Result<Self, PortError> {
        let failed = |op, hint| {
            let path = path.to_owned();
            move |source| PortError::Parport { op, path, source, hint }
        };
        let file = File::options().read(true).write(true).open(path);
        let hint = "; it takes the modules parport_pc and ppdev, and the group of the device";
        let file = file.map_err(failed("opening", hint))?;
        let fd = file.as_raw_fd();
        // SAFETY: the descriptor is open, and the calls have no argument.
        let claimed = unsafe { call::exclusive(fd).and_then(|_| call::claim(fd)) };
        let hint = "; another driver has it (lp, or a second rtecd): unload or stop that one";
        claimed.map_err(|e| failed("claiming", hint)(e.into()))?;
        Ok(Self { file })
    }
}

impl RegisterAccess for Parport {
    fn read(&self, offset: usize, _width: Width) -> Result<u32, CardError> {
        let (fd, mut value) = (self.file.as_raw_fd(), 0_u8);
        // SAFETY: the descriptor is open, and each call writes the one byte that it is given.
        let read = unsafe {
            match offset {
                0 => call::read_data(fd, &raw mut value),
                1 => call::read_status(fd, &raw mut value),
                2 => call::read_control(fd, &raw mut value),
                _ => Err(nix::errno::Errno::EINVAL),
            }
        };
        read.map_err(|e| CardError::Io { op: "reading the parallel port", errno: e as i32 })?;
        Ok(u32::from(value))
    }

    fn write(&self, offset: usize, _width: Width, value: u32) -> Result<(), CardError> {
        let (fd, value) = (self.file.as_raw_fd(), value as u8);
        // SAFETY: the descriptor is open, and each call reads the one byte that it is given.
        let written = unsafe {
            match offset {
                0 => call::write_data(fd, &raw const value),
                2 => call::write_control(fd, &raw const value),
                _ => Err(nix::errno::Errno::EINVAL),
            }
        };
        written.map_err(|e| CardError::Io { op: "writing the parallel port", errno: e as i32 })?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_that_are_refused_say_what_it_takes() {
        let text = IoPorts::open(0xfffe, 4).unwrap_err().to_string();
        assert!(
            text.starts_with("I/O ports 0xfffe to 0x10001: ") && text.contains("CAP_SYS_RAWIO"),
            "{text}"
        );
    }

    #[test]
    fn a_device_that_is_no_parallel_port_is_not_claimed() {
        let text = Parport::open(Path::new("/dev/null")).unwrap_err().to_string();
        assert!(text.starts_with("claiming /dev/null: Inappropriate ioctl"), "{text}");
        let text = Parport::open(Path::new("/dev/parport99")).unwrap_err().to_string();
        assert!(text.starts_with("opening /dev/parport99: ") && text.contains("ppdev"), "{text}");
    }
}
