//! Records of gauges that read in coarse steps.
//! The intervals include the steps, and a message reports them.

use rtec_fit::least::fit_named;
use rtec_model::machine::Machine;
use rtec_model::record::{Column, Kind, Record, Role};
use std::path::Path;

/// Five times both ways over nine targets.
/// The error is a constant and a reversal, read in steps.
fn run(offset: f64, reversal: f64, step: f64, wobble: f64) -> Record {
    let (mut p, mut dir, mut e) = (vec![], vec![], vec![]);
    for n in 0..10_u32 {
        let way = if n % 2 == 0 { 1.0 } else { -1.0 };
        for k in 0..9_u32 {
            let noise = wobble * (f64::from(7 * n + 3 * k) * 1.7).sin();
            p.push(50.0 * f64::from(if way > 0.0 { k } else { 8 - k }));
            dir.push(way);
            e.push(((offset + reversal * way / 2.0 + noise) / step).round() * step);
        }
    }
    let column = |name: &str, role: &str, data: Vec<f64>| {
        let role = Role::parse(role).expect("a role");
        Column { name: name.into(), unit: role.unit().unwrap_or("1").into(), role, data }
    };
    let columns =
        vec![column("x", "position.x", p), column("d", "direction.x", dir), column("e", "error.x", e)];
    Record::new(Path::new("x.run.toml"), Kind::Positioning, columns).expect("a record")
}

#[test]
fn intervals_hold_the_truth_at_every_step() {
    let base = Machine::parse(Path::new("m.toml"), "name = \"m\"\neffect = []\n").expect("a machine");
    for step in [10.0, 5.0, 2.0] {
        let mut held = 0;
        for n in 0..25_u32 {
            let (offset, truth) = (0.37 * f64::from(n), 2.0 + 0.4 * f64::from(n));
            let record = run(offset, truth, step, 0.4);
            let (_, report) = fit_named(&base, &["reversal.x".to_owned()], &[&record], "2026-01-01", 30)
                .expect("a fit of one effect");
            if report.warnings.iter().any(|w| w.contains("every reading is")) {
                held += 1; // nothing is claimed of what is below a step
                continue;
            }
            let found = report.effects[0].parameters["um"];
            held += u32::from(found.low <= truth && truth <= found.high);
            // Two readings that are two steps apart look like one step of twice the size.
            let coarse = report.warnings.iter().any(|w| w.contains("readings in steps of"));
            assert!(coarse || step < 5.0, "{step}: {:?}", report.warnings);
        }
        assert!(held >= 23, "{held} of 25 in steps of {step} µm");
    }
}
