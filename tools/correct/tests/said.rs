//! Reports of the law about itself.
//! It reports what a model would change, the parts of a total, whether a total is on its way, and why it cannot
//! follow a model.

#![allow(clippy::unwrap_used)] // a test's own helpers

mod bench;

use bench::{Bench, GROWTH, LAG, SCALE, TICK_S, machine, part, part_errors, sensor};
use rtec_correct::part_table::PartTable;
use rtec_correct::{AxisCorrectionSettings, Corrector};
use rtec_model::effect::Dictionary;
use rtec_model::machine::Machine;
use rtec_model::record::Role;
use rtec_rt::link_messages::CorrectorMode;
use std::path::Path;
use std::time::Duration;

const SCALE_Z: &str = "[[effect]]\nname = \"scale.z\"\nppm = 100.0\n";
/// 63 % of 100 µm after 100 s.
const WARM_UP: &str = "[[effect]]\nname = \"warm_up.y\"\num = 100.0\ntau_s = 100.0\n";
const FIT: &str = "[[fit]]\nresponse = \"error.z\"\ndate = \"1970-01-01\"\nvalid_until = \"1970-01-11\"\n\
                   rms_um = 0.1\nhalf_width_um = 0.2\n";

/// Counts of half a micrometre, so that counts and micrometres cannot be confused.
fn fine(lead_s: f64) -> Bench {
    let axis = |name: &str| AxisCorrectionSettings {
        name: name.to_owned(),
        count_um: 0.5,
        increment_counts: 2,
        window_counts: 50,
        max_counts: 1000,
    };
    let mut bench = Bench::new();
    bench.corrector = Corrector::new(["x", "y", "z"].map(axis).to_vec(), 5.0, lead_s, bench.now_s);
    bench
}

fn settled(bench: &Bench, n: usize) -> bool {
    bench.corrector.settled(n, &bench.status.axes[n])
}

fn goal(bench: &Bench, n: usize) -> i64 {
    bench.corrector.goal(n, &bench.status.axes[n])
}

/// The parts of an axis's total by name, µm.
fn parts(bench: &Bench, n: usize) -> Vec<(String, f64)> {
    let explained = bench.corrector.explain(n, &bench.status.axes[n]);
    let sum: f64 = explained.parts.iter().map(|p| p.um).sum();
    assert!((sum - explained.total_um).abs() < 1e-9, "{explained:?}");
    explained.parts.into_iter().map(|p| (p.name, p.um)).collect()
}

fn names(bench: &Bench, n: usize) -> Vec<String> {
    parts(bench, n).into_iter().map(|(name, _)| name).collect()
}

/// A part of an axis's total, µm; 0 if there is none of that name.
fn of(bench: &Bench, n: usize, name: &str) -> f64 {
    parts(bench, n).into_iter().find(|p| p.0 == name).map_or(0.0, |p| p.1)
}

/// The preview gives, in counts and µm, what then happens and its parts.
/// One axis has a table, an operator's total and a model's error; the other depends on time.
#[test]
fn what_a_preview_says_comes_to_pass() {
    let mut bench = fine(0.0);
    bench.corrector.day_is(5);
    bench.corrector.load_table(part(["z", "x"]), part_errors()).unwrap();
    bench.status.axes[2].position_counts = 80_000;
    bench.corrector.operator_is(2, 6);
    bench.run(100.0, 2, |_| None);
    assert_eq!(bench.z(), 26, "10 µm of the table and 3 of the operator");
    let table = bench.corrector.table_now(&bench.status).unwrap();
    assert!(table.off_mm < 1e-9 && table.state == "in_force", "{table:?}");

    let model = [SCALE_Z, WARM_UP, FIT].concat();
    let preparer = bench.corrector.preparer();
    let prepared = || preparer.prepare(machine(&model), &|_| Vec::new()).unwrap();
    assert!(prepared().evaluation_time(&preparer) > Duration::ZERO);
    let preview = bench.corrector.preview(prepared(), &bench.status);
    let fit = "error.z: fitted 1970-01-01, good until 1970-01-11, 95 % within ±0.20 µm";
    assert_eq!((preview.name.as_str(), &preview.fits[..]), ("m", &[fit.to_owned()][..]));
    assert_eq!(preview.axes.len(), 3);
    let [x, y, z] = [0, 1, 2].map(|n| &preview.axes[n]);
    assert_eq!((x.then_counts, x.then_um), (0, 0.0));
    assert!((y.then_um - 63.2).abs() < 0.05 && (y.now_counts, y.then_counts) == (0, 126), "{y:?}");
    assert_eq!((z.axis.as_str(), z.now_counts, z.now_um), ("z", 26, 13.0));
    assert!(z.then_counts == 34 && (z.then_um - 17.0).abs() < 1e-9 && z.holds.is_none(), "{z:?}");

    bench.load(&model);
    bench.run(0.1, 2, |_| None);
    assert!(goal(&bench, 2) == 34 && bench.z() < 30 && !settled(&bench, 2));
    assert!(of(&bench, 2, "on its way") < -3.0, "{:?}", parts(&bench, 2));
    bench.run(5.0, 2, |_| None);
    assert!(bench.z() == 34 && settled(&bench, 2), "{}", bench.z());
    assert_eq!(names(&bench, 2), ["scale.z", "part table", "operator"]);
    for (name, um) in [("scale.z", 4.0), ("part table", 10.0), ("operator", 3.0)] {
        assert!((of(&bench, 2, name) - um).abs() < 1e-9, "{:?}", parts(&bench, 2));
    }
    // The remainder below a whole insertion is reported, and that no axis follows while corrections are
    // off.
    bench.run(30.0, 1, |_| None);
    assert_eq!(names(&bench, 1), ["warm_up.y", "rounding"]);
    bench.status.mode = CorrectorMode::Disabled;
    bench.tick();
    assert_eq!(names(&bench, 1), ["warm_up.y", "not followed now"]);
    assert_eq!(bench.corrector.running_model().unwrap().fits, [fit]);
}

/// The promise of a fit includes the reversal that a correction at rest may leave.
#[test]
fn a_promise_names_the_reversal_that_a_correction_leaves() {
    let mut bench = fine(0.0);
    let said = |um: f64| format!("{SCALE_Z}{FIT}[[effect]]\nname = \"reversal.z\"\num = {um}\n");
    for um in [3.0, -3.0] {
        bench.load(&said(um));
        let fits = bench.corrector.running_model().unwrap().fits;
        assert!(
            fits[0].ends_with("; a correction at rest may leave 3.00 µm of the reversal beside that"),
            "{fits:?}"
        );
    }
}

#[test]
fn an_axis_has_settled_when_nothing_is_on_its_way_any_more() {
    let mut bench = Bench::new();
    let stands = &mut bench.status.axes[0];
    (stands.requested, stands.completed) = (7, 0);
    assert!(!settled(&bench, 0), "not completed");
    bench.status.axes[0].completed = 7;
    assert!(settled(&bench, 0) && goal(&bench, 0) == 7, "nobody asks for anything else");
    assert_eq!(bench.tick(), [None; 6]);

    let mut bench = Bench::new();
    bench.load(&[SCALE, GROWTH].concat());
    bench.status.axes[0].position_counts = 400_000;
    (bench.status.axes[2].requested, bench.status.axes[2].completed) = (6, 6);
    bench.run(1.0, 0, |_| None);
    assert!(!settled(&bench, 0) && goal(&bench, 0) == 40);
    bench.run(9.0, 0, |_| None);
    assert!(settled(&bench, 0) && goal(&bench, 0) == 40);
    bench.status.axes[0].completed = 38;
    assert!(!settled(&bench, 0), "the engine has not");
    // Its sensors were never read: it stays where it is, and is not reported as settled.
    assert_eq!(bench.corrector.holds(0), None);
    assert_eq!(bench.corrector.holds(2), Some("sensor T1: not read yet"));
    assert!(!settled(&bench, 2) && goal(&bench, 2) == 6 && bench.z() == 6);
}

/// Time counts from the daemon's start, however early the model is evaluated.
/// The same holds for a captured position.
#[test]
fn a_models_clock_begins_with_the_daemon() {
    for lead_s in [0.0, 0.02] {
        let mut bench = fine(lead_s);
        bench.load(&[WARM_UP, "[[effect]]\nname = \"squareness.x.y\"\nurad = 50.0\n"].concat());
        bench.run(100.0, 1, |_| None);
        let y = bench.status.axes[1].requested;
        assert!((124..=128).contains(&y), "{y}");
        bench.status.mode = CorrectorMode::Probe;
        bench.status.axes[1].position_counts = 200_000;
        bench.tick();
        let at = |n: usize| bench.corrector.error_um_at(n, bench.status.t_ns, 20.0).unwrap();
        assert!((at(1) - 63.2).abs() < 0.05, "{}", at(1));
        assert!((at(0) - 5.0).abs() < 1e-9, "50 µrad of 100 mm: {}", at(0));
        let notes = bench.corrector.running_model().unwrap().notes;
        assert_eq!(notes, ["warm_up.y: its time counts from the daemon's start"]);
    }
}

/// Without a lead the model is evaluated at the measured speed.
#[test]
fn without_a_lead_an_axis_that_slows_down_has_the_speed_that_was_seen() {
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"following_error.x\"\nms = 1.0\n");
    // From 100 mm/s, by 1 m/s².
    let place_um = |k: i64| 1000 * k - 50 * k * k;
    for k in 0..8 {
        bench.status.axes[0].position_counts = place_um(k);
        bench.tick();
    }
    let mm_s = (place_um(7) - place_um(4)) as f64 / 1000.0 / (3.0 * TICK_S);
    let um = of(&bench, 0, "following_error.x");
    assert!(mm_s > 30.0 && (um - mm_s).abs() < 1e-9, "{um} at {mm_s} mm/s");
}

/// An error of the probe alone does not count as an error of the cut.
#[test]
fn an_effect_of_the_probe_is_taken_out_of_captures_and_of_nothing_else() {
    let mut bench = Bench::new();
    bench.load("[[effect]]\nname = \"probe_latency.x\"\nus = 1000.0\n");
    let moves = |bench: &mut Bench| {
        for _ in 0..20 {
            bench.status.axes[0].position_counts += 200;
            bench.tick();
        }
    };
    moves(&mut bench);
    assert_eq!((bench.status.axes[0].requested, of(&bench, 0, "probe_latency.x")), (0, 0.0));
    bench.status.mode = CorrectorMode::Probe;
    moves(&mut bench);
    let um = bench.corrector.error_um_at(0, bench.status.t_ns, 4.0).unwrap();
    assert!((um - 20.0).abs() < 1e-9, "20 mm/s for a millisecond: {um}");
}

#[test]
fn effects_of_two_axes_act_where_their_law_says() {
    let mut bench = Bench::new();
    bench.load(
        "[[effect]]\nname = \"squareness.x.y\"\nurad = 50.0\n[[effect]]\nname = \"rotation.x.y\"\nurad = 200.0\n",
    );
    bench.status.axes[0].position_counts = 100_000;
    bench.status.axes[1].position_counts = 50_000;
    bench.tick();
    for (n, all) in [(0, &["squareness.x.y", "rotation.x.y"][..]), (1, &["rotation.x.y"]), (2, &[])] {
        let names: Vec<String> = names(&bench, n).into_iter().filter(|n| n.contains(".x.y")).collect();
        assert_eq!(names, all);
    }
    let um = [(0, "squareness.x.y"), (0, "rotation.x.y"), (1, "rotation.x.y")].map(|(n, e)| of(&bench, n, e));
    for (um, wanted) in um.into_iter().zip([2.5, -10.0, 20.0]) {
        assert!((um - wanted).abs() < 1e-9, "{um} for {wanted}");
    }
}

/// A joint that grows along Z and X, and other effects.
fn chained(sensor: &str, effects: &str) -> Machine {
    let chain = format!(
        "tool_mm = [0.0, 0.0, 0.0]\n[[joint]]\nname = \"head\"\nbranch = \"tool\"\n\
         [[joint.component]]\nof = \"dz\"\nsensor = \"{sensor}\"\nminus = \"T2\"\nterms = [{{ dT = 1, value = 10.0 }}]\n\
         [[joint.component]]\nof = \"dx\"\nsensor = \"{sensor}\"\nminus = \"T2\"\nterms = [{{ dT = 1, value = 3.0 }}]\n"
    );
    let text = format!("name = \"m\"\nchain = \"chain.toml\"\n{effects}");
    Machine::parse_from(Path::new("m.toml"), &text, Dictionary::default(), &|_| Ok(chain.clone())).unwrap()
}

#[test]
fn a_chain_that_grows_warm_is_a_ramp_on_each_axis_and_a_part_of_its_own() {
    let mut bench = Bench::new();
    bench.warm(20.0, 20.0);
    bench.corrector.load(chained("T1", ""), &|_| Vec::new()).unwrap();
    bench.run(1.0, 2, |_| Some((20.0, 20.0)));
    assert!(bench.run(1.0, 2, |_| Some((24.0, 20.0))) <= 2, "no jump");
    assert!(bench.run(10.0, 2, |_| Some((24.0, 20.0))) <= 2);
    // Within the dead band.
    assert!((39..=40).contains(&bench.z()) && (11..=12).contains(&bench.status.axes[0].requested));
    let um = [0, 1, 2].map(|n| of(&bench, n, "chain"));
    assert!(um.iter().zip([12.0, 0.0, 40.0]).all(|(um, wanted)| (um - wanted).abs() < 1e-9), "{um:?}");
}

#[test]
fn whoever_reads_a_sensor_that_is_not_there_is_named_and_nobody_else() {
    let mut bench = Bench::new();
    let growth = |axis: &str, sensor: &str| {
        let name = format!("thermal_growth.{axis}");
        format!("[[effect]]\nname = \"{name}\"\nsensor = \"{sensor}\"\nminus = \"T2\"\num_per_K = 1.0\n")
    };
    let found = bench.try_load(&[growth("z", "T9"), growth("x", "T8")].concat()).unwrap_err().found;
    let said = "no temperature T8 (read by thermal_growth.x), T9 (read by thermal_growth.z) in the daemon's configuration";
    assert_eq!(found, said);
    let channel =
        |axis: &str, name: &str| format!("[[effect]]\nname = \"channel.{axis}.{name}\"\ngain = 1.0\n");
    let found = bench.try_load(&[channel("x", "flow"), channel("y", "damp")].concat()).unwrap_err().found;
    let said = "no channel flow (read by channel.x.flow), damp (read by channel.y.damp) in the daemon's configuration";
    assert_eq!(found, said);
    let found = bench.corrector.load(chained("T7", ""), &|_| Vec::new()).unwrap_err().found;
    assert_eq!(found, "no temperature T7 (read by the chain) in the daemon's configuration");
    let beside = [growth("z", "T9"), growth("x", "T1")].concat();
    let found = bench.corrector.load(chained("T1", &beside), &|_| Vec::new()).unwrap_err().found;
    assert_eq!(found, "no temperature T9 (read by thermal_growth.z) in the daemon's configuration");
}

/// `model load` and `status` name a thermal state that no run of the fit has shown.
/// No effect reads it: the hall is warmer than in any run.
#[test]
fn says_at_load_that_the_fit_never_saw_this_state() {
    let saw = "valid = [{ sensor = \"T1\", minus = \"T2\", range_K = [-1.0, 5.0], um_per_K = 3.0 }]\n";
    let model = [SCALE_Z, FIT, saw].concat();
    let said = "error.z: T1-T2 is 8.0 K, and the fit saw -1.0 to 5.0 K: up to 9 µm may be left, not ±0.2 µm";
    for (t1, notes) in [(24.0, &[][..]), (28.0, &[said][..])] {
        let mut bench = Bench::new();
        bench.corrector.day_is(5);
        bench.warm(t1, 20.0);
        let prepared = bench.corrector.preparer().prepare(machine(&model), &|_| Vec::new()).unwrap();
        let preview = bench.corrector.preview(prepared, &bench.status);
        assert_eq!(preview.warnings, notes);
        bench.load(&model);
        bench.tick();
        assert_eq!(bench.corrector.running_model().unwrap().notes, notes);
    }
}

/// An input that no sensor gives is noted; one that a sensor gives is not.
#[test]
fn what_is_taken_as_zero_is_said() {
    let mut bench = Bench::of(5.0, 1000.0, vec![sensor("wet", Role::Coolant)]);
    bench.load("[[effect]]\nname = \"coolant.z\"\num = 5.0\n");
    assert_eq!(bench.corrector.running_model().unwrap().notes, [""; 0]);
    bench.load("[[effect]]\nname = \"form_bump\"\num = 5.0\ncentre_rad = 0.0\nwidth_rad = 1.0\n");
    let said = "form_bump: is over the angle of a circle, which a machine at work does not have: without effect here";
    assert_eq!(bench.corrector.running_model().unwrap().notes, [said]);
}

/// Regression: a curve over the angle of a circle was corrected as a constant.
/// It was its value at angle 0.
#[test]
fn an_effect_over_an_angle_corrects_nothing_at_work() {
    let law = "[[law]]\nname = \"bend\"\nnaming = \"A\"\nacts_on = \"error\"\nlaw = \"a line over angle\"\ncause = \"unknown\"\n\
               experiment = \"a circle\"\nparameters = [{ name = \"um\", unit = \"um\", terms = [{ hat = [0.0, 0.0, 3.0], of = \"angle\" }] }]\n";
    let text = "name = \"m\"\ndictionary = \"own.toml\"\n[[effect]]\nname = \"bend.y\"\num = 40.0\n[[effect]]\nname = \"offset.y\"\n\
                um = 4.0\n";
    let read = |_: &Path| Ok(law.to_owned());
    let machine = Machine::parse_from(Path::new("m.toml"), text, Dictionary::default(), &read).unwrap();
    let mut bench = Bench::new();
    bench.corrector.load(machine, &|_| Vec::new()).unwrap();
    bench.run(20.0, 1, |_| None);
    // The other effect of the axis is corrected.
    assert_eq!(bench.status.axes[1].requested, 4);
    assert_eq!(names(&bench, 1), ["offset.y"]);
    let notes = bench.corrector.running_model().unwrap().notes;
    assert!(notes.len() == 1 && notes[0].starts_with("bend.y: is over the angle of a circle"), "{notes:?}");
}

/// An axis waits for each sensor that it reads, and for no other.
#[test]
fn an_axis_waits_for_its_own_sensors_only() {
    let others = vec![sensor("T0", Role::Temperature), sensor("rpm", Role::SpindleSpeed)];
    let mut bench = Bench::of(5.0, 1000.0, others);
    bench.load(
        &[GROWTH, "[[effect]]\nname = \"spindle_speed.x\"\num_per_krpm = 2.0\num_per_krpm2 = 0.0\n"].concat(),
    );
    let mut heard = |names: &[&str], s: f64| {
        for _ in 0..(s as usize) {
            for watch in bench.watches.iter_mut().filter(|w| names.contains(&w.config().name.as_str())) {
                watch.offer(bench.now_s, Ok(23.0));
            }
            bench.run(1.0, 2, |_| None);
            bench.corrector.enabled();
        }
        bench.corrector.holding().collect::<Vec<String>>()
    };
    assert_eq!(heard(&["T1", "T2", "rpm"], 30.0), [""; 0], "T0 is read by nobody");
    let lost = |why: &[String], axis: &str, sensor: &str| {
        let said = format!("axis {axis}: thermal corrections hold: sensor {sensor}: silent");
        why.len() == 1 && why[0].starts_with(&said)
    };
    let why = heard(&["T1", "rpm"], 30.0);
    assert!(lost(&why, "z", "T2"), "{why:?}");
    let why = heard(&["T1", "T2"], 30.0);
    assert!(lost(&why, "x", "rpm"), "{why:?}");
}

/// While a lag is not known, no part of its axis's model is followed.
/// Once it is known, everything begins as a ramp, including the part by position.
#[test]
fn an_axis_that_may_follow_again_begins_with_a_ramp() {
    let mut bench = Bench::of(5.0, 1300.0, Vec::new());
    bench.warm(32.0, 20.0);
    bench.load(&[LAG, SCALE_Z].concat());
    bench.status.axes[2].position_counts = 400_000;
    bench.run(395.0, 2, |_| Some((32.0, 20.0)));
    assert_eq!(bench.z(), 0);
    assert!(bench.run(60.0, 2, |_| Some((32.0, 20.0))) <= 2, "a ramp");
    assert!(bench.z() > 140, "{}", bench.z());
}

/// A sensor returns: the rest of the ramp is reported as on its way.
#[test]
fn what_a_sensor_asks_for_that_is_back_is_on_its_way() {
    let mut bench = Bench::new();
    bench.load(GROWTH);
    bench.run(20.0, 2, |_| Some((23.0, 20.0)));
    bench.run(60.0, 2, |_| None);
    assert!((29..=30).contains(&bench.z()) && bench.corrector.holding().count() == 1);
    bench.run(0.1, 2, |_| Some((26.0, 20.0)));
    bench.corrector.enabled();
    bench.run(0.5, 2, |_| Some((26.0, 20.0)));
    let left_um = of(&bench, 2, "on its way");
    assert!((-30.0..-20.0).contains(&left_um), "{:?}", parts(&bench, 2));
}

/// The arc's position is the part's origin plus the arc's centre.
/// Between probed points without an error the table is in force, with zero effect.
#[test]
fn a_part_tables_arc_is_where_the_part_is_clamped() {
    let wanted = PartTable { centre_mm: Some([10.0, 20.0]), origin_mm: [100.0, 200.0], ..part(["z", "x"]) };
    let mut bench = Bench::new();
    bench.corrector.load_table(wanted, part_errors()).unwrap();
    let mut seen = |angle_rad: f64| {
        bench.status.axes[2].position_counts = (110_000.0 + 40_000.0 * angle_rad.cos()).round() as i64;
        bench.status.axes[0].position_counts = (220_000.0 + 40_000.0 * angle_rad.sin()).round() as i64;
        bench.run(0.1, 2, |_| None);
        let now = bench.corrector.table_now(&bench.status).unwrap();
        assert!(now.off_mm < 1e-3 && now.state == "in_force", "{now:?}");
        now.um
    };
    assert_eq!((seen(0.0), seen(1.0)), ([10.0, 0.0], [0.0; 2]));
}

/// The table's lead makes it act at the arc while the tool is still 20 mm away.
#[test]
fn a_part_table_acts_before_the_tool_is_there() {
    let mut bench = Bench::new();
    bench.corrector.load_table(PartTable { lead_ms: 20.0, ..part(["z", "x"]) }, part_errors()).unwrap();
    for z_mm in [100, 90, 80, 70, 60] {
        bench.status.axes[2].position_counts = z_mm * 1000;
        bench.tick();
    }
    let now = bench.corrector.table_now(&bench.status).unwrap();
    assert!((now.um[0] - 10.0).abs() < 1e-6 && (now.off_mm - 20.0).abs() < 1e-9, "{now:?}");
}
