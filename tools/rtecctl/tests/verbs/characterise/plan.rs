//! `characterise plan`: runs that fit machine and verdict.

use super::{rtecctl, said};

/// A plan contains only runs that the machine can do.
#[test]
fn a_plan_fits_the_machine() {
    let dir = tempfile::tempdir().unwrap();
    let plan = |words: &[&str]| said(&rtecctl(dir.path(), &[&["plan", "--axes"], words].concat()));
    for (words, code, what) in [
        (&["x=500,y=400"][..], 0, "ballbar of 150 mm"),
        (&["x=500,y=220"], 0, "ballbar of 100 mm"),
        (&["x=500,y=110"], 0, "ballbar of 50 mm"),
        (&["x=500,y=80"], 0, "no circles"),
        (&["x=500,y=80", "--ballbar-mm", "40"], 0, "ballbar of 40 mm"),
        (&["x=500,y=400", "--ballbar-mm", "900"], 2, "a circle 1800 mm across on an axis of 400 mm"),
        (&["x=500,x=400"], 2, "x a second time"),
        (&["x=500"], 0, "linear_x"),
    ] {
        let (got, out, err) = plan(words);
        assert_eq!(got, Some(code), "{words:?}: {err}");
        assert!(out.contains(what) || err.contains(what), "{words:?}: {out} {err}");
    }
}

#[test]
fn a_verdict_s_rivals_get_the_run_that_tells_them() {
    let dir = tempfile::tempdir().unwrap();
    let verdict = r#"{"verdict":"not_separable","gap":{"unit":"um","floor":0.3},"effects":[
        {"name":"screw_periodic.x","parameters":{"period_mm":{"value":12.0},"um":{"value":1.5},"phase_rad":{"value":0.3}},
         "alternatives":[{"name":"screw_periodic.x","period_mm":16.0,"log_odds":0.4}]},
        {"name":"scale.x","parameters":{"ppm":{"value":8.0}},
         "alternatives":[{"name":"thermal_expansion.x","sensor":"T3","log_odds":0.2}]},
        {"name":"thermal_growth.z","sensor":"T1","parameters":{"um_per_K":{"value":2.0},"um_per_K2":{"value":0.0}},
         "alternatives":[{"name":"thermal_growth.z","sensor":"T2","log_odds":0.2}]}]}"#;
    std::fs::write(dir.path().join("verdict.json"), verdict).unwrap();
    let plan = |more: &[&str]| {
        let all = ["plan", "--axes", "x=600,z=400", "--verdict", "verdict.json"];
        rtecctl(dir.path(), &[&all[..], more].concat())
    };
    let found: serde_json::Value = serde_json::from_slice(&plan(&["--json"]).stdout).unwrap();
    let (steps, tells) = (found["steps"].as_array().unwrap(), found["tells"].as_array().unwrap());
    // One run distinguishes wave and scale; no run of targets separates two sensors.
    assert_eq!((steps.len(), tells.len()), (1, 3), "{found}");
    assert!(tells[0]["log_odds"].as_f64() > Some(20.0) && tells[1]["by"] == steps[0]["record"], "{found}");
    assert!(tells[2]["log_odds"].is_null() && tells[2]["by"].as_str().unwrap().contains("heat one place"));
    let text = String::from_utf8(plan(&[]).stdout).unwrap();
    assert!(text.contains("| screw_periodic.x | screw_periodic.x (period_mm = 16.0000) |"), "{text}");
    std::fs::write(dir.path().join("verdict.json"), verdict.replace("scale.x", "scal.x")).unwrap();
    let refused = plan(&[]);
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(
        refused.status.code() == Some(2) && said.contains("verdict.json: found the effect `scal.x`"),
        "{said}"
    );
}
