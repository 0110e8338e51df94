//! `rtecctl commission` on a simulated machine that is as configured, and on those that are not.

use rtec_tests::daemon::Daemon;
use serde_json::Value;

/// The axis as configured, 1 µm a count; `simulated` says what it is really like.
fn config(simulated: &str) -> String {
    format!(
        "[machine]\nname = 'bench'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 100\n\
         max_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\nmax_accel_mm_s2 = 1000\n{simulated}\n"
    )
}

#[test]
fn right_and_everything_that_can_be_wrong_is_named() {
    for (simulated, verdict) in [
        ("", "right"),
        ("simulated = { count_um = -1.0 }", "wrong_sign"),
        ("simulated = { count_um = 2.0 }", "wrong_unit"),
        ("simulated = { compensates_ppm = 1000 }", "controller_compensates"),
        ("simulated = { feedback = 'ignored' }", "controller_ignores"),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let file = directory.path().join("rtec.toml");
        std::fs::write(&file, config(simulated)).unwrap();
        let daemon = Daemon::start(&directory.path().join("s"), Some(&file));
        let guided = ["commission", "x", "--jog-mm", "2", "--far-mm", "12", "--json"];
        assert!(daemon.expect(1, &guided).contains("not homed"));
        daemon.expect(0, &["home"]);
        daemon.expect(0, &["enable"]);
        let run = daemon.user(&guided);
        let text = String::from_utf8_lossy(&run.stderr);
        let found: Value = serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {text}"));
        println!("{found}");
        assert_eq!(found["verdict"], verdict, "{simulated}: {found} {text}");
        assert_eq!(run.status.code(), Some(i32::from(verdict != "right")), "{text}");
        if verdict == "right" {
            let moved = found["scale_moved_counts"].as_i64().unwrap();
            assert_eq!(found["inserted_counts"], 20);
            assert!((moved + 20).abs() <= 2, "{moved}");
        }
        // Whatever was found, nothing of it is left requested.
        let status = daemon.status();
        assert_eq!((&status["axes"][0]["requested"], &status["balanced"]), (&0.into(), &true.into()));
    }
}
