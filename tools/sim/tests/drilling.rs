//! The drilling test of WO 97/43703.
//! Also a corrector switched on at a warm machine.

#![allow(clippy::unwrap_used)] // a test's own helpers

use rtec_model::machine::Machine;
use rtec_sim::compensation_experiments::{Experiment, ExperimentInputs, PROMISED, UNSEEN};
use rtec_sim::corrected_machine_sim::{CorrectedMachineSim, MachineSpec};
use rtec_sim::described_machines::MachineDescriptions;
use rtec_sim::nc_block::Block;
use std::path::Path;

/// Four holes, and four more an inch further in X, in each of three cycles.
/// (WO 97/43703, p. 25)
#[test]
fn drills_two_passes_an_inch_apart() {
    if !test_needs::long() {
        return;
    }
    let truth = MachineDescriptions::default().machine("wo97-machine.toml").unwrap();
    let spec = MachineSpec::machining_centre();
    // A fit that saw T1 10 K below any hall, and one that saw the present range.
    let fit = |axis: &str, range: &str| {
        format!(
            "[[fit]]\nresponse = \"error.{axis}\"\ndate = 2026-05-01\nvalid_until = \"2027-05-01\"\nrms_um = 1.0\nhalf_width_um = 2.0\n\
             valid = [{{ sensor = \"T1\", reference_degC = 20.0, range_K = {range}, um_per_K = 3.0 }}]\n"
        )
    };
    let reversal =
        "[[effect]]\nname = \"reversal.x\"\num = 10.0\n[[effect]]\nname = \"reversal.z\"\num = -5.0\n";
    let known = format!("name = \"m\"\n{}{}{reversal}", fit("x", "[-11, -10]"), fit("z", "[-50, 50]"));
    let known = Machine::parse(Path::new("m.toml"), &known).unwrap();
    let setting =
        ExperimentInputs { spec: &spec, truth: &truth, known: Some(&known), seed: 1, out: Path::new("") };
    let found = Experiment::find("drilling").unwrap().run(&setting).unwrap();
    // A correction at rest may leave the reversal, whichever sign it has.
    assert_eq!(found.summary[PROMISED], serde_json::json!({ "error.x_um": 12.0, "error.z_um": 7.0 }));
    let unseen = found.summary[UNSEEN].as_object().unwrap();
    let um = unseen["error.x_um"].as_f64().unwrap();
    assert!(unseen.len() == 1 && (um - 30.0).abs() < 3.0, "{unseen:?}");
    let text = |name: &str| &found.plots.iter().find(|p| p.0 == name).unwrap().1;
    let table = text("drilling-holes.csv");
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|l| l.split(',').collect()).collect();
    assert_eq!(rows.len(), 48, "24 holes, each with its counterbore");
    let of = |cycle: &str, pass: &str| rows.iter().filter(|r| r[0] == cycle && r[1] == pass).count();
    assert!(["1", "2", "3"].iter().all(|c| of(c, "1") == 8 && of(c, "2") == 8), "{table}");
    // The first hole is the reference.
    assert!(rows[0][4..].iter().all(|cell| cell.parse::<f64>().unwrap() == 0.0), "{:?}", rows[0]);
    // The second pass is an inch further in X.
    let record = &found.records[0];
    let x = record.columns.iter().find(|c| c.name == "x").unwrap();
    for row in 0..8 {
        assert!((x.data[row + 8] - x.data[row] - 25.4).abs() < 0.05, "{row}: {:?}", x.data);
    }
    for axis in ["x", "y", "z"] {
        let plot = text(&format!("drilling-holes-{axis}.svg"));
        assert!(plot.contains("cycle III") && plot.contains("deviation from hole 1"), "{axis}");
    }
}

/// On a warm machine without past temperatures the lags are unknown.
/// The corrector holds and reports it.
#[test]
fn holds_and_says_so_on_a_warm_machine_without_a_past() {
    let truth = MachineDescriptions::default().machine("wo97-machine.toml").unwrap();
    let spec = MachineSpec::machining_centre();
    let started = |soaked_s: f64| {
        let mut sim = CorrectedMachineSim::new(&spec, &truth, None, [0.0; 3], 1).unwrap();
        sim.set_control_period(100_000_000);
        sim.machine.load([Block::Coolant { on: true }, Block::Spindle { rpm: 5000.0 }]);
        sim.advance(soaked_s).unwrap();
        sim.know(&spec, &truth).unwrap();
        sim.advance(60.0).unwrap();
        let asked: Vec<i64> = sim.status().axes().iter().map(|a| a.requested).collect();
        (sim.holding(), asked)
    };
    let (cold, _) = started(1.0);
    assert!(cold.is_empty(), "{cold:?}");
    let (warm, asked) = started(2.0 * 3600.0);
    assert!(warm.len() == 3 && warm.iter().all(|why| why.contains("hold")), "{warm:?}");
    // The part that does not depend on heat is a few micrometres; heat has moved Z by more than 50 µm.
    assert!(asked.iter().all(|counts| counts.abs() < 20), "{asked:?}: {warm:?}");
}
