//! Roles: which requests each role may send, and the record of commands.
//! Every role tries every verb as another user. The record is read, verified and tampered with.

use rtec_tests::daemon::{Daemon, among_others, program, until};
use rtec_tests::skipped;
use serde_json::Value;
use std::io::{BufRead, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output};

const NOBODY: u32 = 65_534;

const CONFIG: &str = "[machine]\nname='m'\n[card]\nbackend='mock'\n[[axis]]\nname='z'\ncount_um=1\ntravel_mm=40\n\
                      max_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n[[axis]]\nname='x'\ncount_um=1\n\
                      travel_mm=40\nmax_correction_counts=100\nwindow_counts=50\nmin_separation_ns=500\n";

fn root() -> bool {
    std::fs::metadata("/proc/self").unwrap().uid() == 0
}

/// A directory with the command line that another user can reach.
fn place() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    std::fs::set_permissions(directory.path(), std::fs::Permissions::from_mode(0o755)).unwrap();
    let copy = directory.path().join("rtecctl");
    std::fs::copy(program("rtecctl"), &copy).unwrap();
    std::fs::set_permissions(&copy, std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::write(directory.path().join("m.toml"), "name = \"m\"\n").unwrap();
    std::fs::write(directory.path().join("e.cor"), "0.0 1.0\n0.5 2.0\n1.0 1.0\n").unwrap();
    directory
}

/// Runs the command line as `nobody`.
fn nobody(directory: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(directory.join("rtecctl"));
    command
        .args(args)
        .arg("--socket")
        .arg(directory.join("s"))
        .current_dir(directory)
        .uid(NOBODY)
        .gid(NOBODY);
    command.output().unwrap()
}

fn said(run: &Output) -> String {
    String::from_utf8_lossy(&[run.stdout.clone(), run.stderr.clone()].concat()).into_owned()
}

const TABLE: [&str; 9] = [
    "part",
    "load",
    "--errors",
    "e.cor",
    "--centre-z-mm=10",
    "--radius-mm=5",
    "--nose-mm=0.5",
    "--tool-z-mm=0",
    "--tool-x-mm=0",
];

/// Every verb that asks the daemon, with the least role that may use it.
/// They are in an order in which each succeeds.
fn verbs() -> Vec<(Vec<&'static str>, usize)> {
    let of = |verb: &[&'static str], role| (verb.to_vec(), role);
    vec![
        of(&["status"], 0),
        of(&["explain"], 0),
        of(&["whoami"], 0),
        of(&["home"], 1),
        of(&["shadow"], 1),
        of(&["enable", "--accept-jump"], 1),
        of(&["hold", "on"], 1),
        of(&["hold", "off"], 1),
        of(&["probe", "on", "--captures", "0"], 1),
        of(&["probe", "off"], 1),
        of(&["correct", "x", "2"], 2),
        of(&["model", "load", "m.toml", "--yes"], 2),
        of(&["model", "unload"], 2),
        of(&TABLE, 2),
        of(&["part", "unload"], 2),
        of(&["clear"], 2),
        of(&["disable"], 1),
    ]
}

#[test]
fn each_role_may_do_what_it_is_for_and_nothing_else() {
    if !root() {
        return skipped("to be another user takes root");
    }
    let _room = among_others();
    let group = Command::new("id").args(["-gn", "nobody"]).output().unwrap();
    let group = String::from_utf8(group.stdout).unwrap();
    let group = group.trim();
    let roles = ["view", "operate", "set_up"];
    for (has, role) in roles.into_iter().enumerate() {
        let directory = place();
        let at = |name: &str| directory.path().join(name);
        let key =
            if has == 2 { format!("group = '{group}'") } else { format!("{role} = {{ group = '{group}' }}") };
        std::fs::write(at("rtec.toml"), format!("{CONFIG}[control]\n{key}\n")).unwrap();
        let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
        let run = nobody(directory.path(), &["whoami", "--json"]);
        let me: Value = serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {}", said(&run)));
        assert_eq!((&me["uid"], &me["user"], &me["role"]), (&NOBODY.into(), &"nobody".into(), &role.into()));
        assert!(me["exe"].as_str().unwrap().ends_with("rtecctl"), "{me}");
        for (verb, needs) in verbs() {
            let run = nobody(directory.path(), &verb);
            let text = said(&run);
            if needs <= has {
                assert_eq!(run.status.code(), Some(0), "{role}: {verb:?}: {text}\n{}", daemon.log());
            } else {
                assert_eq!(run.status.code(), Some(1), "{role}: {verb:?}: {text}");
                assert!(text.contains("this connection may") && text.contains("whoami"), "{text}");
            }
        }
        // Refused requests changed nothing, and all of them are in the record.
        let status = daemon.status();
        assert_eq!(status["homed"], has >= 1);
        assert_eq!(status["axes"][1]["requested"], if has == 2 { 2 } else { 0 });
        let lines = || -> Vec<Value> {
            let run = daemon.user(&["log", "--json"]);
            let all: Value = serde_json::from_slice(&run.stdout).unwrap_or_default();
            all["lines"].as_array().cloned().unwrap_or_default()
        };
        let of = |result: &str| {
            let of_nobody = |l: &&Value| l["by"]["uid"] == NOBODY && l["result"] == result;
            lines().iter().filter(of_nobody).count()
        };
        // `model load` asks twice, to show and to load, where the role permits it.
        let (done, refused) = [(0, 14), (8, 6), (15, 0)][has];
        until("the record", || (of("done"), of("refused")) == (done, refused));
        assert_eq!(daemon.user(&["log", "--verify"]).status.code(), Some(0));
        // A user who may see the status may read the record, whatever the daemon's umask.
        if has == 0 {
            let run = nobody(directory.path(), &["log"]);
            assert!(run.status.success() && said(&run).contains("refused"), "{}", said(&run));
            let mode = std::fs::metadata(at("audit.log")).unwrap().mode();
            assert_eq!(mode & 0o777, 0o640, "{mode:o}");
        }
    }
}

#[test]
fn who_has_no_group_reaches_nothing() {
    if !root() {
        return skipped("to be another user takes root");
    }
    let _room = among_others();
    let directory = place();
    let _daemon = Daemon::start(&directory.path().join("s"), None);
    let run = nobody(directory.path(), &["status"]);
    assert_eq!(run.status.code(), Some(3));
    assert!(said(&run).contains("ask for a group"), "{}", said(&run));
}

/// Sends one line as `nobody`, without a descriptor, and returns the answer.
fn line_of_nobody(socket: &Path, line: &str) -> Option<String> {
    let program = "import socket,sys\ns=socket.socket(socket.AF_UNIX)\ns.connect(sys.argv[1])\n\
                   s.sendall(sys.argv[2].encode()+b'\\n')\nprint(s.makefile().readline())";
    let mut python = Command::new("python3");
    let run = python.args(["-c", program]).arg(socket).arg(line).uid(NOBODY).gid(NOBODY).output().ok()?;
    Some(String::from_utf8_lossy(&run.stdout).into_owned())
}

#[test]
fn what_the_caller_cannot_read_is_not_read_for_him() {
    if !root() {
        return skipped("to be another user takes root");
    }
    let _room = among_others();
    let directory = place();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("secret"), "the combination is 4 8 15\n").unwrap();
    std::fs::set_permissions(at("secret"), std::fs::Permissions::from_mode(0o600)).unwrap();
    let group = Command::new("id").args(["-gn", "nobody"]).output().unwrap();
    let group = String::from_utf8(group.stdout).unwrap();
    std::fs::write(at("rtec.toml"), format!("{CONFIG}[control]\ngroup = '{}'\n", group.trim())).unwrap();
    let daemon = Daemon::start(&at("s"), Some(&at("rtec.toml")));
    let secret = at("secret").display().to_string();
    let by_name = format!(
        "{{\"do\":\"table_load\",\"errors\":\"{secret}\",\"axes\":[\"z\",\"x\"],\"centre_mm\":[0,0],\"radius_mm\":5,\
         \"nose_mm\":1,\"origin_mm\":[0,0],\"lead_ms\":0}}"
    );
    for line in [by_name.clone(), format!("{{\"do\":\"model_load\",\"file\":\"{secret}\"}}")] {
        let Some(answer) = line_of_nobody(&at("s"), &line) else { return skipped("no python3") };
        assert!(answer.contains("no_descriptor"), "{answer}");
        assert!(!answer.contains("combination"), "{answer}");
    }
    let mut table = TABLE;
    table[3] = "secret";
    let run = nobody(directory.path(), &table);
    assert!(run.status.code() == Some(2) && said(&run).contains("ermission denied"), "{}", said(&run));
    // A model names another file, which the caller must be able to read too.
    std::fs::write(at("m.toml"), "name = \"m\"\ndictionary = \"secret\"\n").unwrap();
    let run = nobody(directory.path(), &["model", "load", "m.toml", "--yes"]);
    assert!(run.status.code() == Some(2) && !said(&run).contains("combination"), "{}", said(&run));
    assert!(!daemon.log().contains("combination"), "{}", daemon.log());
    // A caller who can read the file sees its text. Readers of the record do not.
    let mut line = std::io::BufReader::new(std::os::unix::net::UnixStream::connect(at("s")).unwrap());
    writeln!(line.get_mut(), "{by_name}").unwrap();
    let mut answer = String::new();
    line.read_line(&mut answer).unwrap();
    assert!(answer.contains("combination"), "{answer}");
    let record = || std::fs::read_to_string(at("audit.log.refused")).unwrap_or_default();
    until("the record", || record().contains("secret:1:1: found something else, expected "));
    assert!(!record().contains("combination"), "{}", record());
}

#[test]
fn the_record_tells_who_did_what_and_shows_what_was_done_to_it() {
    let _room = among_others();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("s");
    let daemon = Daemon::enabled(&socket);
    daemon.expect(0, &["correct", "x", "12"]);
    until("the correction", || daemon.status()["axes"][0]["in_effect"] == 12);
    daemon.expect(1, &["correct", "y", "900"]);
    let file = directory.path().join("audit.log");
    let refused = directory.path().join("audit.log.refused");
    until("the record", || std::fs::read_to_string(&refused).is_ok_and(|t| t.contains("total +900")));
    let text = daemon.expect(0, &["log", "--axis", "x"]);
    assert!(
        text.contains("correct")
            && text.contains("x requested +0 to +12")
            && !text.contains("axis=\"y\"")
            && !text.contains("+900"),
        "{text}"
    );
    assert!(daemon.expect(0, &["log", "--since", "1h"]).contains("900"));
    assert!(!daemon.expect(0, &["log", "--since", "2100-01-01"]).contains("900"));
    // One client asks for commands while another goes on reading.
    let (code, _) = daemon.end("TERM");
    assert_eq!(code, Some(0));
    let log = |args: &[&str]| {
        let run =
            Command::new(program("rtecctl")).args(["log", "--file"]).arg(&file).args(args).output().unwrap();
        (run.status.code(), said(&run))
    };
    assert_eq!(log(&["--verify"]).0, Some(0), "{}", log(&["--verify"]).1);
    let whole = std::fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = whole.lines().collect();
    let all = lines.len();
    assert!(
        lines[0].contains("\"what\":\"start\"") && lines[all - 1].contains("\"what\":\"stop\""),
        "{whole}"
    );
    let short = format!("ends with line number 4, and should with {all}");
    let joined = |lines: &[&str]| lines.join("\n") + "\n";
    let mut swapped = lines.clone();
    swapped.swap(2, 3);
    for (what, content, wants) in [
        ("cut", joined(&[&lines[..2], &lines[3..]].concat()), "lines are missing"),
        ("cut at its end", joined(&lines[..4]), short.as_str()),
        ("changed", whole.replace("\"total_counts\":12", "\"total_counts\":10"), "was changed"),
        ("reordered", joined(&swapped), "in another place"),
    ] {
        std::fs::write(&file, content).unwrap();
        let (code, text) = log(&["--verify"]);
        assert!(code == Some(1) && text.contains(wants), "{what}: {code:?} {text}");
    }
    std::fs::write(&file, &whole).unwrap();
    assert_eq!(log(&["--verify"]).0, Some(0));
    assert_eq!(log(&["--since", "some day"]).0, Some(2));
    // Refused commands have a chain of their own.
    let kept = std::fs::read_to_string(&refused).unwrap();
    std::fs::write(&refused, kept.replace("900", "600")).unwrap();
    let (code, text) = log(&["--verify"]);
    assert!(code == Some(1) && text.contains("audit.log.refused:1: it was changed"), "{text}");
    std::fs::write(&refused, kept).unwrap();
    // The end of both chains, as the journal has it, matches. The end of another record does not.
    let hash =
        |text: &str| text.trim_end().rsplit_once("\"hash\":\"").unwrap().1.trim_end_matches("\"}").to_owned();
    let anchor = directory.path().join("anchor");
    std::fs::write(&anchor, format!("x rtecd: record of commands: line {all} {}\n", hash(&whole))).unwrap();
    let anchor = anchor.display().to_string();
    assert_eq!(log(&["--verify", "--anchors", &anchor]).0, Some(0));
    std::fs::write(&anchor, format!("record of commands: line {all} {}\n", hash(lines[0]))).unwrap();
    let (code, text) = log(&["--verify", "--anchors", &anchor]);
    assert!(code == Some(1) && text.contains("another one than the anchor says"), "{text}");
    std::fs::write(&anchor, "nothing\n").unwrap();
    assert_eq!(log(&["--verify", "--anchors", &anchor]).0, Some(2));
    std::fs::remove_file(&file).unwrap();
    assert_eq!(log(&[]).0, Some(2));
}
