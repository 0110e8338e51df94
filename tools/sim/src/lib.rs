//! The simulated machine for the unchanged engine, in virtual and real time.
//! Every experiment runs on it, and it compares every insertion design.
//!
//! Each part of the machine that moves, counts, grows warm, cuts or touches is here, once.
//!
//! | module | contents |
//! |---|---|
//! | [`computer_timing`] | computing hardware as a timing model: 8051, DSP, this PC as measured |
//! | [`error_correction_circuit`] | the Error Correction Circuit of CMTI (2014) |
//! | [`insertion_design_bench`] | one axis in motion with any design on any computer, and the count at the MTC |
//! | [`corrected_axis`] | the interface of every insertion design, and the designs for a whole machine |
//! | [`full_cycle_insertion`] | the Original RTEC and Design A: four counts an insertion |
//! | [`pass_through_design_b`] | Design B: the signals pass through the computer |
//! | [`engine_replay`] | the engine on a recording, and the resulting count of the MTC |
//! | [`insertion_design_comparison`] | the designs compared: increments, times, highest safe frequency, death of the computer; waveforms |
//! | [`described_machines`] | the machines described in the sources, as files within the program |
//! | [`trajectory`], [`nc_block`] | the controller's trajectories and programs |
//! | [`axis`], [`machine`] | the one machine, as a card: drives, scales, decoders, probe |
//! | [`thermal_network`] | a thermal network and its sensors |
//! | [`corrected_machine_sim`] | machine, engine and corrector together: runs programs, probes, reports the tool's position |
//! | [`attended_machine`], `polled_card` | events at the machine in every period; the card that polls it |
//! | [`machines_on_mock_card`], [`stroking_axes`], [`machining_task`] | machines at a mock card's wires in real time: strokes, the lathe's task |
//! | [`workpiece`], [`lathe`], [`lathe_program_run`] | a workpiece, a tool and a probe on the machine; a program on it under the engine |
//! | [`turning_experiment`] | NISTIR 4854's loop: semi-finish cut, probing, table, finish cut, inspection |
//! | [`example_machines`] | example machines: models, runs, hold-outs, configuration, drawings |
//! | [`compensation_experiments`] | the experiments that characterise a machine, without and with compensation |
//! | [`noise`] | seeded noise |
//! | `corrector_with_sensors`, `true_errors` | the control side above the engine; the true machine's errors and friction |
//!
//! A part's shape belongs to `rtec-part`, a machine's errors to `rtec-model`, another control law to
//! `rtec-correct`; the daemon is not here either.
//!
//! Example: `cargo run -p rtec-sim --example corrected_move`, which the tests run too.

pub mod attended_machine;
pub mod axis;
#[cfg(feature = "experiments")]
pub mod compensation_experiments;
pub mod computer_timing;
pub mod corrected_axis;
pub mod corrected_machine_sim;
mod corrector_with_sensors;
pub mod described_machines;
pub mod engine_replay;
pub mod error_correction_circuit;
#[cfg(feature = "experiments")]
pub mod example_machines;
pub mod full_cycle_insertion;
mod gate_corrected_axes;
pub mod insertion_design_bench;
pub mod insertion_design_comparison;
pub mod lathe;
mod lathe_on_polled_card;
pub mod lathe_program_run;
pub mod machine;
pub mod machines_on_mock_card;
pub mod machining_task;
pub mod nc_block;
pub mod noise;
pub mod pass_through_design_b;
pub mod stroking_axes;
pub mod thermal_network;
pub mod trajectory;
mod true_machine_errors;
pub mod turning_experiment;
pub mod workpiece;
