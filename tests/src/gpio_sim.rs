//! The kernel's gpio-sim from outside: pulls lines and reads levels.

use crate::daemon::Lines;
use anyhow::Context;
use rtec_driver::quadrature::State;
use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Makes a simulated chip whose lines have these names.
/// Returns its name (`gpiochip0`) and its directory below `/sys/devices/platform`.
///
/// # Errors
/// When the module or its configfs is missing.
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

/// How a line is pulled now: `pull-up` or `pull-down`.
///
/// # Errors
/// When there is no such line.
pub fn pulled(directory: &Path, line: u32) -> anyhow::Result<String> {
    let path = directory.join(format!("sim_gpio{line}/pull"));
    let text = fs::read_to_string(&path).with_context(|| format!("{}", path.display()))?;
    Ok(text.trim().to_owned())
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
    /// Pulls of A' and B' and their present state, where they are wired back.
    back: Option<([File; 2], Option<State>)>,
    active_low: bool,
}

impl GpioSim {
    /// The axis on the lines A, B, inverter of A, inverter of B.
    ///
    /// # Errors
    /// When there are no such lines.
    pub fn open(directory: &Path, lines: &[u32]) -> anyhow::Result<Self> {
        let pulls = [attribute(directory, lines[0], "pull")?, attribute(directory, lines[1], "pull")?];
        let values = [attribute(directory, lines[2], "value")?, attribute(directory, lines[3], "value")?];
        Ok(Self { pulls, values, shown: None, back: None, active_low: false })
    }

    /// The same with A' and B' wired back to these lines.
    ///
    /// # Errors
    /// When there are no such lines.
    pub fn wired_back(mut self, directory: &Path, lines: [u32; 2]) -> anyhow::Result<Self> {
        self.back =
            Some(([attribute(directory, lines[0], "pull")?, attribute(directory, lines[1], "pull")?], None));
        Ok(self)
    }

    /// The same with every line active low.
    #[must_use]
    pub fn active_low(mut self) -> Self {
        self.active_low = true;
        self
    }
}

fn attribute(directory: &Path, line: u32, name: &str) -> anyhow::Result<File> {
    let path = directory.join(format!("sim_gpio{line}/{name}"));
    let file = File::options().read(true).write(name == "pull").open(&path);
    file.with_context(|| format!("{}", path.display()))
}

/// Pulls two lines to a state, where it differs from the present one.
fn pull_to(pulls: &[File; 2], shown: &mut Option<State>, state: State) {
    let before = shown.replace(state);
    for (n, pull) in pulls.iter().enumerate() {
        let high = |s: State| s.bits() >> n & 1 == 1;
        if before.is_none_or(|b| high(b) != high(state)) {
            let text: &[u8] = if high(state) { b"pull-up" } else { b"pull-down" };
            let _ = pull.write_at(text, 0); // a missing edge shows as a jump
        }
    }
}

impl Lines for GpioSim {
    fn outputs(&mut self) -> u64 {
        let mut outputs = 0;
        for (n, value) in self.values.iter().enumerate() {
            let mut text = [0];
            // A line that cannot be read counts as off: the trial ends with a jump, as it should.
            let read = value.read_at(&mut text, 0).is_ok();
            let on = if self.active_low { b'0' } else { b'1' };
            outputs |= u64::from(read && text[0] == on) << n;
        }
        outputs
    }

    fn show(&mut self, scale: State) {
        let levels = if self.active_low { scale.inverted(3) } else { scale };
        pull_to(&self.pulls, &mut self.shown, levels);
    }

    fn show_mtc(&mut self, mtc: State) {
        if let Some((pulls, shown)) = &mut self.back {
            pull_to(pulls, shown, mtc);
        }
    }
}
