//! The simulated machine, for the unchanged engine to run against, and every insertion design side by side.
//!
//! | module | what |
//! |---|---|
//! | [`computer`] | computing hardware as a timing model: 8051, DSP, this PC as measured |
//! | [`ecc`] | the Error Correction Circuit of CMTI (2014) |
//! | [`mod@bench`] | one axis in motion, any design on any computer, and what the MTC made of it |
//! | [`through`] | Design B: the signals pass through the computer |
//! | [`replay`] | the engine over a recording, and what the MTC would have counted |
//! | [`designs`] | the designs compared: increments, times, highest safe frequency, death of the computer; waveforms |
//! | [`path`], [`gcode`] | the controller's trajectories and programs |
//! | [`axis`], [`machine`] | the machine as a card: drives, scales, decoders, probe |
//! | [`heat`] | a thermal network and its sensors |
//! | [`sim`] | machine, engine and corrector together: runs programs, probes, tells where the tool is |
//! | [`experiment`] | the experiments that characterise a machine, without and with compensation |
//! | [`noise`] | seeded noise |

pub mod axis;
pub mod bench;
pub mod computer;
pub mod designs;
pub mod ecc;
pub mod experiment;
pub mod gcode;
pub mod heat;
pub mod machine;
pub mod noise;
pub mod path;
pub mod replay;
pub mod sim;
pub mod through;
