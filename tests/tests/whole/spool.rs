//! Finished records on their way from the daemon to the shop.
//! A probing run is captured by the daemon, and a client hands over a run that it recorded. `rtecctl ship` sends both.
//! A missing or full folder costs a record and is reported, without other effects.

use rtec_control::daemon_client::DaemonConnection;
use rtec_control::protocol::{ClientRequest, DaemonResponse};
use rtec_measure::run_record_files::{read, read_log};
use rtec_tests::daemon::{Daemon, among_others, program, until};
use rtec_tests::disk::SmallDisk;
use rtec_tests::skipped;
use serde_json::Value;
use std::io::Write;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

fn started(directory: &Path, spool: &str) -> Daemon {
    started_with(directory, &format!("spool = '{spool}'"))
}

fn started_with(directory: &Path, control: &str) -> Daemon {
    let text = format!(
        "[machine]\nname = 'mill 7'\n[card]\nbackend = 'mock'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 40\n\
         max_correction_counts = 1000\nwindow_counts = 50\nmin_separation_ns = 500\n[control]\n{control}\n"
    );
    let file = directory.join("rtec.toml");
    std::fs::write(&file, text).unwrap();
    Daemon::start(&directory.join("s"), Some(&file))
}

/// Probes until `trips` trips; returns the number that came.
fn probed(daemon: &Daemon, trips: u32) -> usize {
    let out = daemon.user(&["probe", "on", "--captures", &trips.to_string(), "--json"]);
    serde_json::from_slice::<Value>(&out.stdout).unwrap()["captures"].as_array().unwrap().len()
}

fn sidecars(folder: &Path) -> Vec<PathBuf> {
    let all = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut found: Vec<PathBuf> = all.filter(|p| p.to_string_lossy().ends_with(".run.toml")).collect();
    found.sort();
    found
}

/// Events of one kind that the daemon reports on records, as texts.
fn told(daemon: &Daemon, kind: &str) -> Vec<String> {
    let mut client = DaemonConnection::connect(daemon.socket()).unwrap();
    let request = ClientRequest::Observe { events_after: None };
    let DaemonResponse::Observed(seen) = client.ask(&request).unwrap() else { panic!("no answer") };
    seen.events.into_iter().map(|e| e.event).filter(|e| e.kind == kind).map(|e| e.text).collect()
}

/// A gauge that sends a reading every 10 ms to every client.
fn gauge() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            std::thread::spawn(move || {
                for n in 0.. {
                    if writeln!(stream, "gx {}.25", n % 7).is_err() {
                        return;
                    }
                    std::thread::sleep(Duration::from_millis(10));
                }
            });
        }
    });
    address
}

fn recorded(directory: &Path, out: &str) -> Output {
    let mut command = Command::new(program("rtecctl"));
    command.current_dir(directory).args(["characterise", "record", "--out", out, "--feed", &gauge()]);
    command.args([
        "--columns",
        "gx=error.x",
        "--period",
        "0.05",
        "--duration",
        "0.5",
        "--socket",
        "s",
        "--spool",
    ]);
    command.output().unwrap()
}

fn shipped(directory: &Path) -> Output {
    let mut command = Command::new(program("rtecctl"));
    command.current_dir(directory).args([
        "ship",
        "--spool",
        "spool",
        "--to",
        "shop",
        "--machine",
        "mill-7",
        "--json",
    ]);
    command.output().unwrap()
}

#[test]
fn what_was_probed_and_what_was_recorded_reaches_the_shop_once() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let (spool, shop) = (directory.path().join("spool"), directory.path().join("shop"));
    std::fs::create_dir(&spool).unwrap();
    std::fs::create_dir(&shop).unwrap();
    let daemon = started(directory.path(), "spool");
    daemon.expect(0, &["home"]);
    let trips = probed(&daemon, 3);
    until("the probing run", || !sidecars(&spool).is_empty());
    let probing = read_log(&sidecars(&spool)[0]).unwrap();
    assert_eq!(probing.kind.name(), "probing");
    let names: Vec<&str> = probing.columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["t", "position.x"]);
    assert!(probing.rows() >= trips && probing.count_um == Some(1.0), "{} rows", probing.rows());
    assert!(probing.time_s().windows(2).all(|w| w[0] < w[1]), "{:?}", probing.time_s());

    // A client's record, and a second one of the same name.
    for n in 0..2 {
        let out = recorded(directory.path(), "drift.run.toml");
        assert_eq!(out.status.code(), Some(0), "{n}: {}", String::from_utf8_lossy(&out.stderr));
    }
    let kept = sidecars(&spool);
    assert_eq!(kept.len(), 3, "{kept:?}");
    let record = read(&spool.join("drift-2.run.toml")).unwrap();
    assert_eq!(record.responses().count(), 1);
    assert_eq!(record.columns, read(&directory.path().join("drift.run.toml")).unwrap().columns);
    assert_eq!(told(&daemon, "record_kept").len(), 3);

    // Probing that is on when the daemon ends is written too.
    daemon.expect(0, &["probe", "on", "--captures", "0"]);
    until("trips", || !told(&daemon, "trip").is_empty() && told(&daemon, "trip").len() > trips);
    let (code, log) = daemon.end("TERM");
    assert_eq!(code, Some(0), "{log}");
    assert_eq!(sidecars(&spool).len(), 4, "{log}");

    // The daemon sends nothing. `ship` sends each record once.
    let sent = shipped(directory.path());
    let document: Value = serde_json::from_slice(&sent.stdout).unwrap();
    assert_eq!((document["sent"].as_array().unwrap().len(), &document["kept"]), (4, &serde_json::json!([])));
    assert!(sidecars(&spool).is_empty());
    for place in document["sent"].as_array().unwrap() {
        let there = sidecars(&shop.join(place.as_str().unwrap()));
        assert_eq!(there.len(), 1);
        read_log(&there[0]).unwrap();
    }
    let again: Value = serde_json::from_slice(&shipped(directory.path()).stdout).unwrap();
    assert_eq!(again["sent"], serde_json::json!([]));
}

#[test]
fn a_spool_that_is_gone_or_full_costs_the_record_and_is_said() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let spool = directory.path().join("spool");
    let daemon = started(directory.path(), "spool");
    until("the note", || daemon.log().contains("spool is no folder"));
    daemon.expect(0, &["home"]);
    probed(&daemon, 1);
    until("the event", || told(&daemon, "record_not_kept").len() == 1);
    let text = told(&daemon, "record_not_kept").remove(0);
    assert!(text.contains("trips is not kept") && text.contains("is no folder"), "{text}");
    until("the log", || daemon.log().contains(&text));
    until("the record of commands", || daemon.expect(0, &["log"]).contains("trips is not kept"));
    // The refusal comes before a client's run, not after it.
    let refused = recorded(directory.path(), "drift.run.toml");
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("is no folder"));
    assert!(!directory.path().join("drift.run.toml").exists());

    let Some(disk) = SmallDisk::mount(&spool, 64) else {
        return skipped("nothing can be mounted here (no root)");
    };
    disk.fill();
    probed(&daemon, 1);
    until("the event", || told(&daemon, "record_not_kept").len() == 2);
    let full = recorded(directory.path(), "drift.run.toml");
    let said = String::from_utf8_lossy(&full.stderr).into_owned();
    assert_eq!(full.status.code(), Some(1), "{said}");
    assert!(said.contains("the record is in drift.run.toml") && said.contains("No space left"), "{said}");
    read(&directory.path().join("drift.run.toml")).unwrap();
    // No partial file is left, the loop continues, and with room again the next record is kept.
    assert_eq!(std::fs::read_dir(&spool).unwrap().count(), 1);
    disk.free();
    probed(&daemon, 1);
    until("the record", || sidecars(&spool).len() == 1);
    let status = daemon.status();
    assert_eq!((&status["balanced"], &status["rt"]["events_lost"]), (&true.into(), &0.into()), "{status}");
    let (code, log) = daemon.end("TERM");
    assert_eq!(code, Some(0), "{log}");
}

#[test]
fn a_daemon_without_a_spool_says_how_to_have_one() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(&directory.path().join("s"), None);
    let refused = recorded(directory.path(), "drift.run.toml");
    assert_eq!(refused.status.code(), Some(1));
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(said.contains("spool = \"/var/spool/rtec\""), "{said}");
    drop(daemon);
}

/// Regression: one sidecar of 48 MB took 7 GB of memory and ended the daemon.
/// The number of kept records had no bound either.
#[test]
fn whoever_operates_neither_ends_the_daemon_nor_fills_the_disk() {
    if !test_needs::long() {
        return;
    }
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::create_dir(at("spool")).unwrap();
    let daemon = started_with(directory.path(), "spool = 'spool'\nspool_mb = 1\nlog_anchor = true");
    let sidecar = "file = 'a.csv'\nkind = 'drift'\n[columns]\ne = { role = 'error.x', unit = 'um' }\n";
    std::fs::write(at("a.csv"), "e\n1\n2\n").unwrap();
    let keep = |sidecar: &str| {
        std::fs::write(at("a.run.toml"), sidecar).unwrap();
        let mut client = DaemonConnection::connect(&at("s-operate")).unwrap();
        let files = [at("a.run.toml"), at("a.csv")];
        let open = files.each_ref().map(|f| std::fs::File::open(f).unwrap());
        let files = files.map(|f| f.display().to_string()).to_vec();
        client.ask_with(&ClientRequest::Keep { files }, &open).unwrap()
    };
    for more in ["[[t]]\n", "a = {}\n", "# a comment\n"] {
        let DaemonResponse::Bad { text } =
            keep(&(sidecar.to_owned() + &more.repeat((48 << 20) / more.len())))
        else {
            panic!("{more}")
        };
        assert!(text.contains("found more than 65536 bytes"), "{text}");
    }
    let mut kept = 0;
    let text = loop {
        match keep(sidecar) {
            DaemonResponse::Done { .. } => kept += 1,
            DaemonResponse::Refused { why, text, .. } if why == "not_kept" => break text,
            other => panic!("{other:?}"),
        }
        assert!(kept <= 128, "{kept}");
    };
    assert!(kept >= 100 && text.contains("at most 1 MB may wait ([control] spool_mb)"), "{kept}: {text}");
    let odd = keep(&sidecar.replace("kind", "note = \"\\u001b[2J\"\nkind"));
    assert!(
        matches!(&odd, DaemonResponse::Bad { text } if text.contains("U+001B") && !text.contains('\u{1b}')),
        "{odd:?}"
    );
    assert_eq!(daemon.status()["balanced"], true);
    // The end of the record was logged, and matches.
    until("the anchor", || daemon.log().contains("record of commands: line "));
    std::fs::write(at("journal"), daemon.log()).unwrap();
    daemon.expect(0, &["log", "--verify", "--anchors", &at("journal").display().to_string()]);
    // Once records are sent, there is room again.
    std::fs::create_dir(at("shop")).unwrap();
    assert_eq!(shipped(directory.path()).status.code(), Some(0));
    assert!(matches!(keep(sidecar), DaemonResponse::Done { .. }));
}
