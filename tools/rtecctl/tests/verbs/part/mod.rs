//! `rtecctl part`: the contract of `part errors`, exit codes, and all steps.
//! The steps run one after the other through their files.

mod contract;
mod loop_of_files;
mod servers;
