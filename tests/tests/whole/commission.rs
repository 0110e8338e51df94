//! `rtecctl commission` on simulated machines, as configured and not.

use rtec_tests::daemon::{Daemon, among_others, program, until};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};

/// The axis as configured, 1 µm a count; `simulated` gives its real properties.
fn config(simulated: &str) -> String {
    format!(
        "[machine]\nname = 'bench'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 100\n\
         max_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\nmax_accel_mm_s2 = 1000\n{simulated}\n"
    )
}

#[test]
fn right_and_everything_that_can_be_wrong_is_named() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
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
        // Nothing is left requested, whatever was found.
        let status = daemon.status();
        assert_eq!((&status["axes"][0]["requested"], &status["balanced"]), (&0.into(), &true.into()));
        // The axis goes to and fro as before, so that nothing is left in effect either.
        until("the axis moves again", || {
            let axis = daemon.status()["axes"][0].clone();
            axis["edge_rate_hz"] != 0.0 && axis["in_effect"] == 0
        });
    }
}

/// A daemon with its simulated axis homed and corrections on.
/// Its socket is `s` in the directory.
fn enabled() -> (tempfile::TempDir, Daemon) {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("rtec.toml");
    std::fs::write(&file, config("")).unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), Some(&file));
    daemon.expect(0, &["home"]);
    daemon.expect(0, &["enable"]);
    (directory, daemon)
}

/// `--by-hand` asks at a simulated axis that nobody stops.
#[test]
fn says_what_it_waits_for_by_hand() {
    let _room = among_others();
    let (directory, _daemon) = enabled();
    let socket = directory.path().join("s");
    let mut guided = Command::new(program("rtecctl"))
        .args(["commission", "x", "--by-hand", "--socket"])
        .arg(&socket)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    writeln!(guided.stdin.as_mut().unwrap(), "0 0").unwrap();
    let mut said = BufReader::new(guided.stderr.take().unwrap()).lines();
    let asked = said.next().unwrap().unwrap();
    let waits = "x moves: waiting 60 s for it to stand; without --by-hand it is jogged to each place";
    assert!(asked.ends_with(&format!("mm: {waits}")), "{asked}");
    Command::new("kill").arg(guided.id().to_string()).status().unwrap();
    assert_eq!(guided.wait().unwrap().code(), Some(1));
}

/// An axis is commissioned without a model, and its name is what matters first.
#[test]
fn refuses_by_what_commissioning_needs() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let (file, model) = (directory.path().join("rtec.toml"), directory.path().join("machine.toml"));
    std::fs::write(&file, config("[model]\nfile = 'machine.toml'")).unwrap();
    std::fs::write(&model, "name = 'bench'\n[[effect]]\nname = 'scale.x'\nppm = 10.0\n").unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), Some(&file));
    assert!(daemon.expect(0, &["status"]).contains("has not been loaded yet"));
    let said = daemon.expect(1, &["commission", "x"]);
    assert!(said.contains("not homed: x") && !said.contains("model"), "{said}");
    let said = daemon.expect(2, &["commission", "a", "--model", model.to_str().unwrap()]);
    assert!(said.contains("found axis \"a\", expected one of x"), "{said}");
}

/// Jogs the simulated machine to `to_mm`; returns display and indicator, mm.
fn jog(socket: &Path, to_mm: f64) -> [f64; 2] {
    let ask = |request: Value| {
        let mut stream = UnixStream::connect(socket).unwrap();
        writeln!(stream, "{request}").unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        let stands = serde_json::from_str::<Value>(&line).unwrap()["stands"].clone();
        ["display_mm", "indicator_mm"].map(|key| stands[key].as_f64().unwrap())
    };
    ask(json!({"do": "jog", "axis": "x", "display_mm": to_mm}));
    until("the axis is there", || (ask(json!({"do": "jog", "axis": "x"}))[0] - to_mm).abs() < 1e-6);
    let mut before = ask(json!({"do": "jog", "axis": "x"}));
    until("the axis stands", || {
        std::thread::sleep(std::time::Duration::from_millis(100));
        let now = ask(json!({"do": "jog", "axis": "x"}));
        let moved = (now[1] - std::mem::replace(&mut before, now)[1]).abs();
        moved < 1e-6
    });
    before
}

/// A person who leaves in the middle leaves nothing requested.
/// They answer, wrongly at first, and then go away. Inserted counts are taken back, and what is still in the
/// controller's count is reported.
#[test]
fn whoever_leaves_in_the_middle_leaves_nothing_requested() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let (directory, daemon) = enabled();
    let socket = directory.path().join("s");
    let places = [5.0, 6.0, 9.0, 5.0, 6.0, 5.0, 6.0, 5.0];
    for (answers, leaves) in [(8, "proved"), (1, "TERM"), (5, "INT"), (5, "nobody")] {
        jog(&socket, 5.0);
        let mut guided = Command::new(program("rtecctl"))
            .args(["commission", "x", "--by-hand", "--jog-mm", "1", "--far-mm", "4", "--socket"])
            .arg(&socket)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut said = guided.stderr.take().unwrap();
        let (mut hands, mut text) = (guided.stdin.take().unwrap(), String::new());
        let mut asked = |text: &mut String| {
            let mut byte = [0];
            while !(text.ends_with("mm: ") || text.ends_with("9.998: ")) {
                assert_eq!(said.read(&mut byte).unwrap(), 1, "{text}");
                text.push(byte[0] as char);
            }
            text.push('\n');
        };
        for (n, place) in places.iter().take(answers).enumerate() {
            asked(&mut text);
            if n == 1 {
                writeln!(hands, "6,000 6,000").unwrap();
                asked(&mut text);
            }
            let [display, indicator] = jog(&socket, *place);
            // The indicator is off for the long jog and the way back.
            let off = matches!(n, 2 | 3);
            let last = text.lines().last().unwrap();
            assert_eq!(last.ends_with("Enter the display only, mm: "), off, "{n}: {text}");
            let told =
                ["take the indicator off first", "put the indicator back now"].map(|t| text.contains(t));
            assert_eq!(told, [n >= 2, n >= 4], "{n}: {text}");
            if off {
                writeln!(hands, "{display:.4}").unwrap();
            } else {
                writeln!(hands, "{display:.4} {indicator:.4}").unwrap();
            }
        }
        match leaves {
            "proved" => {}
            "nobody" => {
                asked(&mut text);
                drop(hands);
            }
            signal => {
                asked(&mut text);
                Command::new("kill").args([format!("-{signal}"), guided.id().to_string()]).status().unwrap();
            }
        }
        let code = guided.wait().unwrap().code();
        said.read_to_string(&mut text).unwrap();
        assert_eq!(code, Some(i32::from(leaves != "proved")), "{text}");
        assert!(text.contains("found \"6,000 6,000\", expected two numbers") || answers == 1, "{text}");
        let axis = daemon.status()["axes"][0].clone();
        assert_eq!(axis["requested"], 0, "{leaves} after {answers}: {text}");
        let left = axis["in_effect"] != 0;
        assert_eq!(left, answers == 5, "{leaves} after {answers}: {axis} {text}");
        assert_eq!(left, text.contains("+20 are still in the controller's count"), "{text}");
        assert!(leaves == "proved" || text.contains("nothing is proved"), "{text}");
        if left {
            assert!(daemon.expect(1, &["commission", "x"]).contains("still on their way out"));
        }
        jog(&socket, 6.0);
        jog(&socket, 5.0);
        assert_eq!(daemon.status()["axes"][0]["in_effect"], 0);
    }
}
