//! A metrologist's commands, from a machine's characterisation to its correction.

mod drilling;
mod fit;

use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A machining centre with drilling errors as large as the patent's table 7.
/// These are 0.0044 in, 0.0053 in and 0.0059 in. A fit cannot choose its laws: two sources per axis, one
/// bent, one late, and a step with the coolant.
const TRUE_MACHINE: &str = r#"
name = "machining centre"
effect = [
    { name = "scale.x", ppm = 54.0 },
    { name = "scale.y", ppm = -21.0 },
    { name = "scale.z", ppm = 44.0 },
    { name = "reversal.x", um = 4.0 },
    { name = "squareness.x.y", urad = 30.0 },
    { name = "thermal_lag.x", sensor = "T9", minus = "T20", um_per_K = 6.0, tau_s = 1500.0 },
    { name = "thermal_growth.x", sensor = "T6", minus = "T18", um_per_K = 5.0, um_per_K2 = 0.1 },
    { name = "thermal_growth.y", sensor = "T12", minus = "T18", um_per_K = 12.0, um_per_K2 = 0.1 },
    { name = "thermal_growth.y", sensor = "T9", minus = "T8", um_per_K = 18.0 },
    { name = "thermal_lag.z", sensor = "T13", minus = "T18", um_per_K = -22.0, tau_s = 900.0 },
    { name = "thermal_growth.z", sensor = "T9", minus = "T8", um_per_K = -8.0 },
    { name = "coolant.z", um = -5.0 },
]
"#;

fn rtecctl(dir: &Path, words: &str) -> Value {
    let out =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).current_dir(dir).args(words.split(' ')).output().unwrap();
    assert!(out.status.success(), "rtecctl {words}: {}", String::from_utf8_lossy(&out.stderr));
    if words.contains("--json") { crate::document(&out.stdout) } else { Value::Null }
}

/// Characterises a machine: geometry cold, then the spindle cycle dry and wet.
/// Returns the report of its model.
fn characterise(dir: &Path) -> Value {
    std::fs::write(dir.join("true.toml"), TRUE_MACHINE).unwrap();
    std::fs::write(dir.join("ideal.toml"), "name = \"centre\"\n").unwrap();
    for experiment in ["linear-displacement", "plate", "drift"] {
        rtecctl(
            dir,
            &format!("simulate {experiment} --machine true.toml --model ideal.toml --seed 5 --out ch"),
        );
    }
    rtecctl(
        dir,
        "model fit --effects scale.x,reversal.x,scale.y,reversal.y,scale.z,squareness.x.y \
         --record ch/linear-displacement-x.run.toml --record ch/linear-displacement-y.run.toml \
         --record ch/linear-displacement-z.run.toml --record ch/plate.run.toml --out geometry.toml --plot left.svg --date 2026-05-01",
    );
    // Three axes, and the two responses of the plate.
    for (file, response) in [("left.svg", "error.x"), ("left.3.svg", "error.z"), ("left.5.svg", "error.y")] {
        let svg = std::fs::read_to_string(dir.join(file)).unwrap();
        assert!(svg.contains(&format!("{response} before and after the fit")), "{file}");
    }
    rtecctl(
        dir,
        "model fit --base geometry.toml --record ch/drift-dry.run.toml --record ch/drift-wet.run.toml \
         --out machine.toml --date 2026-05-01 --json",
    )
}
