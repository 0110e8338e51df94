//! A machine's set-up is backed up and restored into another folder.

use rtec_control::single_process_lock;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const CONFIG: &str = "[machine]\nname = 'mill 7'\n[card]\nbackend = 'replay'\n[[axis]]\nname = 'x'\ncount_um = 1.0\ntravel_mm = 40\n\
                      max_correction_counts = 100\nwindow_counts = 50\nmin_separation_ns = 500\ntrace = 'traces/x.csv'\n\
                      [control]\nsocket = 'run/s'\n[model]\nfile = 'm.toml'\n";

/// A folder with a machine in it, whose daemon has run.
fn machine() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &[u8]| {
        let path = directory.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    put("rtec.toml", CONFIG.as_bytes());
    put("m.toml", b"name = 'm'\n");
    put("traces/x.csv", b"t_ns,a,b\n0,0,0\n");
    put("devices", b"uio my-card\n");
    put("run/state", &[7; 100]);
    put("run/model.taken", b"0123\nm.toml\n");
    put("run/audit.log.head", b"{\"n\":12,\"hash\":\"abc\",\"first_n\":1}");
    directory
}

fn rtecctl(directory: &Path, args: &[&str]) -> (Option<i32>, String) {
    let run: Output =
        Command::new(env!("CARGO_BIN_EXE_rtecctl")).args(args).current_dir(directory).output().unwrap();
    (run.status.code(), String::from_utf8([run.stdout, run.stderr].concat()).unwrap())
}

/// Every file below a folder.
fn files(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![directory.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(directory).unwrap().to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn backed_up(from: &Path) -> Value {
    let (code, said) = rtecctl(from, &["backup", "--config", "rtec.toml", "--out", "b.tar", "--json"]);
    assert_eq!(code, Some(0), "{said}");
    crate::document(said.as_bytes())
}

#[test]
fn a_machine_goes_from_one_folder_to_another() {
    let (old, new) = (machine(), tempfile::tempdir().unwrap());
    let manifest = backed_up(old.path());
    assert_eq!(
        (&manifest["machine"], &manifest["record"]),
        (&"mill 7".into(), &serde_json::json!([12, "abc"]))
    );
    let kinds: Vec<_> =
        manifest["files"].as_array().unwrap().iter().map(|f| f["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["configuration", "trace", "model", "devices", "state", "loaded"]);
    // Readable only by its owner, and no existing file is overwritten.
    let mode = std::os::unix::fs::PermissionsExt::mode(
        &std::fs::metadata(old.path().join("b.tar")).unwrap().permissions(),
    );
    assert_eq!(mode & 0o777, 0o600);
    assert_eq!(rtecctl(old.path(), &["backup", "--config", "rtec.toml", "--out", "b.tar"]).0, Some(2));

    let archive = old.path().join("b.tar").display().to_string();
    std::fs::create_dir(new.path().join("run")).unwrap();
    let restore = |more: &[&str]| {
        rtecctl(new.path(), &[&["restore", archive.as_str(), "--config", "rtec.toml"], more].concat())
    };
    let (code, said) = restore(&["--dry-run"]);
    assert!(code == Some(0) && said.contains("rtec.toml: would be written"), "{said}");
    assert!(files(new.path()).is_empty());
    let (code, said) = restore(&[]);
    assert!(
        code == Some(0) && said.contains("state: left out") && said.contains("home scale and controller"),
        "{said}"
    );
    let mut expected = files(old.path());
    for left in ["b.tar", "run/state", "run/audit.log.head"] {
        expected.remove(Path::new(left)).unwrap();
    }
    assert_eq!(files(new.path()), expected);
    // The same restore again changes nothing; files that differ are kept.
    assert_eq!(restore(&[]).0, Some(0));
    std::fs::write(new.path().join("m.toml"), "name = 'other'\n").unwrap();
    let before = files(new.path());
    let (code, said) = restore(&[]);
    assert!(code == Some(1) && said.contains("m.toml is there and differs: nothing is written"), "{said}");
    assert_eq!(files(new.path()), before);
    assert_eq!(restore(&["--replace", "--with-state"]).0, Some(0));
    expected.insert("run/state".into(), vec![7; 100]);
    assert_eq!(files(new.path()), expected);
    // Refused while a daemon runs.
    let held = single_process_lock::socket(&new.path().join("run/s")).unwrap();
    let (code, said) = restore(&["--replace"]);
    assert!(code == Some(1) && said.contains("nothing is written"), "{said}");
    let before = files(new.path());
    let (code, said) = restore(&["--replace", "--dry-run"]);
    assert!(code == Some(0) && said.contains("would be written"), "{said}");
    assert_eq!(files(new.path()), before);
    drop(held);
}

#[test]
fn an_archive_that_is_not_as_it_was_made_writes_nothing() {
    let old = machine();
    backed_up(old.path());
    let good = std::fs::read(old.path().join("b.tar")).unwrap();
    let find = |what: &[u8]| good.windows(what.len()).position(|w| w == what).unwrap();
    let changed = |at: usize, to: &[u8]| {
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to);
        bytes
    };
    // Changed content, a changed hash, a path that leads outside, a missing end, no archive at all.
    let model = find(b"name = 'm'\n");
    let hash = find(b"\"sha256\": \"") + 11;
    let path = find(b"\"path\": \"m.toml\"") + 9;
    for (what, bytes) in [
        ("content", changed(model + 8, b"x")),
        ("hash", changed(hash, if good[hash] == b'0' { b"1" } else { b"0" })),
        ("path", changed(path, b"../m.t")),
        ("end", good[..good.len() / 3].to_vec()),
        ("nothing", b"hello".to_vec()),
        ("empty", Vec::new()),
    ] {
        let new = tempfile::tempdir().unwrap();
        std::fs::write(new.path().join("b.tar"), bytes).unwrap();
        let (code, said) = rtecctl(new.path(), &["restore", "b.tar", "--config", "rtec.toml"]);
        assert_eq!(code, Some(2), "{what}: {said}");
        assert_eq!(files(new.path()).len(), 1, "{what}");
    }
    // Every file that the configuration names must exist to be packed.
    std::fs::remove_file(old.path().join("m.toml")).unwrap();
    let (code, said) = rtecctl(old.path(), &["backup", "--config", "rtec.toml", "--out", "c.tar"]);
    assert!(code == Some(2) && said.contains("m.toml: found no such file"), "{said}");
    assert!(!old.path().join("c.tar").exists());
}
