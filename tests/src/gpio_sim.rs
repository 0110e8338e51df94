//! The kernel's gpio-sim from outside: lines that are pulled, and levels that are read.

use crate::daemon::Lines;
use anyhow::Context;
use rtec_driver::quadrature::State;
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Makes a simulated chip whose lines have these names; gives its name (`gpiochip0`) and its directory below
/// `/sys/devices/platform`.
///
/// # Errors
/// When the module or its configfs is not there.
pub fn make_chip(label: &str, lines: &[&str]) -> anyhow::Result<(String, PathBuf)> {
    let device = Path::new("/sys/kernel/config/gpio-sim").join(label);
    let bank = device.join("bank0");
    fs::create_dir_all(&bank).with_context(|| format!("{}", bank.display()))?;
    fs::write(bank.join("num_lines"), lines.len().to_string())?;
    for (n, name) in lines.iter().enumerate() {
        let line = bank.join(format!("line{n}"));
        fs::create_dir_all(&line)?;
        fs::write(line.join("name"), name)?;
    }
    fs::write(device.join("live"), "1")?;
    let text = |file: PathBuf| fs::read_to_string(file).map(|t| t.trim().to_owned());
    let (chip, name) = (text(bank.join("chip_name"))?, text(device.join("dev_name"))?);
    let directory = Path::new("/sys/devices/platform").join(name).join(&chip);
    Ok((chip, directory))
}

/// Pulls a line up or down.
///
/// # Errors
/// When there is no such line.
pub fn pull(directory: &Path, line: u32, up: bool) -> anyhow::Result<()> {
    let path = directory.join(format!("sim_gpio{line}/pull"));
    fs::write(&path, if up { "pull-up" } else { "pull-down" }).with_context(|| format!("{}", path.display()))
}

/// The level of a line.
///
/// # Errors
/// When there is no such line.
pub fn level(directory: &Path, line: u32) -> anyhow::Result<bool> {
    let path = directory.join(format!("sim_gpio{line}/value"));
    let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
    Ok(text.trim() == "1")
}

/// One axis on a simulated chip.
#[derive(Debug)]
pub struct GpioSim {
    pulls: [File; 2],
    values: [File; 2],
    shown: Option<State>,
}

impl GpioSim {
    /// The axis on the lines A, B, inverter of A, inverter of B.
    ///
    /// # Errors
    /// When there are no such lines.
    ///
    /// # Panics
    /// With fewer than four lines.
    pub fn open(directory: &Path, lines: &[u32]) -> anyhow::Result<Self> {
        let open = |line: u32, name: &str| {
            let path = directory.join(format!("sim_gpio{line}/{name}"));
            let file = File::options().read(true).write(name == "pull").open(&path);
            file.with_context(|| format!("{}", path.display()))
        };
        let pulls = [open(lines[0], "pull")?, open(lines[1], "pull")?];
        let values = [open(lines[2], "value")?, open(lines[3], "value")?];
        Ok(Self { pulls, values, shown: None })
    }
}

impl Lines for GpioSim {
    fn outputs(&mut self) -> u64 {
        let mut outputs = 0;
        for (n, value) in self.values.iter().enumerate() {
            let mut text = [0];
            // A line that cannot be read is not on: the trial ends with a jump, as it should.
            let read = value.read_at(&mut text, 0).is_ok();
            outputs |= u64::from(read && text[0] == b'1') << n;
        }
        outputs
    }

    fn show(&mut self, scale: State) {
        let before = self.shown.replace(scale);
        for (n, pull) in self.pulls.iter().enumerate() {
            let high = |s: State| s.bits() >> n & 1 == 1;
            if before.is_none_or(|b| high(b) != high(scale)) {
                let text: &[u8] = if high(scale) { b"pull-up" } else { b"pull-down" };
                let _ = pull.write_at(text, 0); // an edge that does not come shows as a jump
            }
        }
    }
}
