//! `rtecctl example`: the same files each time, and nothing overwritten.
//! The first commands of its README work.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn rtecctl(dir: &Path, words: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rtecctl"));
    command.current_dir(dir).args(words.split_whitespace()).output().unwrap()
}

/// Every file below a folder.
fn files(below: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(below).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            found.extend(
                files(&path).into_iter().map(|(name, text)| (Path::new(&entry.file_name()).join(name), text)),
            );
        } else {
            found.insert(PathBuf::from(entry.file_name()), std::fs::read(&path).unwrap());
        }
    }
    found
}

#[test]
fn the_same_files_each_time_and_never_over_somebody_elses() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    for name in ["one", "two"] {
        let done = rtecctl(dir, &format!("example spindle {name}"));
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    let (one, two) = (files(&dir.join("one")), files(&dir.join("two")));
    for wanted in [
        "README.md",
        "machine.toml",
        "true.toml",
        "rtec.toml",
        "records/drift-wet.csv",
        "holdout/production-cycle.csv",
    ] {
        assert!(one.contains_key(Path::new(wanted)), "{wanted}: {:?}", one.keys());
    }
    assert!(one == two);
    // Existing files stay, even a single one.
    std::fs::create_dir(dir.join("mine")).unwrap();
    std::fs::write(dir.join("mine/machine.toml"), "name = \"mine\"\n").unwrap();
    for name in ["mine", "one", "mine/machine.toml"] {
        let refused = rtecctl(dir, &format!("example spindle {name}"));
        let said = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(
            said.contains(&format!("rtecctl: {name}: ")) && said.contains("expected an empty folder"),
            "{said}"
        );
    }
    assert_eq!(std::fs::read_to_string(dir.join("mine/machine.toml")).unwrap(), "name = \"mine\"\n");
    // An existing empty folder is accepted.
    std::fs::create_dir(dir.join("empty")).unwrap();
    assert!(rtecctl(dir, "example spindle empty").status.success());
}

/// A source's example ends with the command of the whole experiment.
/// The package contains that program.
#[test]
fn a_sources_example_names_its_whole_experiment() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["nistir4854", "nistir4832", "cmti"] {
        let done = rtecctl(dir.path(), &format!("example {name} {name}"));
        let said = String::from_utf8(done.stdout).unwrap();
        let command = format!("cd {name} && rtec-papers {name} --from . --out figures");
        assert!(said.lines().last().is_some_and(|l| l.ends_with(&command)), "{said}");
    }
    let sources = rtec_sim::example_machines::EXAMPLES.iter().filter(|e| e.experiment().is_some());
    assert_eq!(sources.count(), 4);
    let package = include_str!("../../../rtecd/Cargo.toml");
    assert!(package.contains("target/release/rtec-papers\""));
}

#[test]
fn without_a_verb_it_says_where_to_begin() {
    let said = rtecctl(Path::new("."), "");
    let text = String::from_utf8(said.stdout).unwrap();
    assert!(said.status.success() && said.stderr.is_empty());
    assert!(text.starts_with("Where to begin:\n") && text.contains("rtecctl example mill mill"), "{text}");
    // An unknown verb is still bad usage.
    assert_eq!(rtecctl(Path::new("."), "begin").status.code(), Some(2));
}

#[test]
fn its_configuration_has_no_findings_and_the_effect_that_the_lathe_lacks_is_named() {
    if !test_needs::long() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    assert!(rtecctl(dir, "example lathe lathe").status.success());
    let folder = dir.join("lathe");
    let checked = rtecctl(&folder, "config check rtec.toml");
    let said = String::from_utf8(checked.stdout).unwrap();
    assert!(checked.status.success() && said.contains("no findings"), "{said}");
    let words = "reconcile records/ballbar-zx-10.run.toml records/ballbar-zx-50.run.toml records/ballbar-zx-100.run.toml \
                 --model machine.toml --json";
    let verdict: serde_json::Value = serde_json::from_slice(&rtecctl(&folder, words).stdout).unwrap();
    let named: Vec<&str> =
        verdict["effects"].as_array().unwrap().iter().map(|e| e["name"].as_str().unwrap()).collect();
    assert!(named.contains(&"reversal.z") && named.contains(&"following_error.x"), "{named:?}");
    let um = verdict["effects"].as_array().unwrap().iter().find(|e| e["name"] == "reversal.z").unwrap();
    // The value of `true.toml`.
    assert!((um["parameters"]["um"]["value"].as_f64().unwrap() - 6.2).abs() < 0.1, "{um}");
    let points = rtecctl(&folder, "part points drawings/nose.dxf --feature F1:20 --tip-mm 2.5 --out semi");
    assert!(points.status.success() && folder.join("semi/pathfin.cdl").exists());
}
