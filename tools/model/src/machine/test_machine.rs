//! A machine that the tests of reading and writing share.

use super::Machine;
use rtec_files::InputError;
use std::path::Path;

pub(super) const LATHE: &str = "# my lathe\nname = \"demo lathe\"\n\n[[effect]]\nname = \"scale.x\"\nppm = 12.0 # measured in May\n\n\
                     [[effect]]\nname = \"thermal_growth.z\"\nsensor = \"T8\"\nminus = \"T18\"\num_per_K = 0.114\n\
                     um_per_K2 = -0.0008\n";

pub(super) fn parse(text: &str) -> Result<Machine, InputError> {
    Machine::parse(Path::new("m.toml"), text)
}
