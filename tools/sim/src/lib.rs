//! The simulated machine that the unchanged engine runs against.
//! It runs in virtual time and in real time. Every experiment runs on it, and it compares every insertion design.
//!
//! What moves, counts, grows warm, cuts or touches is here, once.
//!
//! | module | what |
//! |---|---|
//! | [`computer`] | computing hardware as a timing model: 8051, DSP, this PC as measured |
//! | [`ecc`], [`ecc_board`] | the Error Correction Circuit of CMTI (2014); two of them behind one controller |
//! | [`mod@bench`] | one axis in motion, any design on any computer, and what the MTC made of it |
//! | [`insertion`] | what every insertion design offers, and the designs that a whole machine can have |
//! | [`full_cycle`] | the Original RTEC and Design A: four counts an insertion |
//! | [`through`] | Design B: the signals pass through the computer |
//! | [`replay`] | the engine over a recording, and what the MTC would have counted |
//! | [`designs`] | the designs compared: increments, times, highest safe frequency, death of the computer; waveforms |
//! | [`described`] | the machines that the sources describe, as files within the program |
//! | [`path`], [`gcode`] | the controller's trajectories and programs |
//! | [`axis`], [`machine`] | the one machine, as a card: drives, scales, decoders, probe |
//! | [`heat`] | a thermal network and its sensors |
//! | [`sim`] | machine, engine and corrector together: runs programs, probes, reports where the tool is |
//! | [`attended`], `polled` | what goes on at the machine once in a period; the card that polls it |
//! | [`wires`], [`strokes`], [`duty`] | machines at a mock card's wires in real time: axes to and fro, the lathe's duty |
//! | [`workpiece`], [`lathe`], [`job`] | a workpiece, a tool and a probe on the machine; a program on it under the engine |
//! | [`turning`] | NISTIR 4854's loop: semi-finish cut, probing, table, finish cut, inspection |
//! | [`example`] | example machines: models, runs, hold-outs, configuration, drawings |
//! | [`experiment`] | the experiments that characterise a machine, without and with compensation |
//! | [`noise`] | seeded noise |
//! | `control`, `errors` | the control side over the engine; the true machine's errors and friction, acting |
//!
//! What must not live here: what a part looks like (`rtec-part`), what a machine does wrong (`rtec-model`), a control law
//! of its own (`rtec-correct`), the daemon.
//!
//! At work: `cargo run -p rtec-sim --example corrected_move`, which the tests run too.

pub mod attended;
pub mod axis;
pub mod bench;
pub mod computer;
mod control;
mod corrected;
pub mod described;
pub mod designs;
pub mod duty;
pub mod ecc;
pub mod ecc_board;
mod errors;
#[cfg(feature = "experiments")]
pub mod example;
#[cfg(feature = "experiments")]
pub mod experiment;
pub mod full_cycle;
pub mod gcode;
pub mod heat;
pub mod insertion;
pub mod job;
pub mod lathe;
pub mod machine;
pub mod noise;
pub mod path;
mod polled;
pub mod replay;
pub mod sim;
pub mod strokes;
pub mod through;
pub mod turning;
pub mod wires;
pub mod workpiece;
