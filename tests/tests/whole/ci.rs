//! `.ci/run`, its stages and the hosted workflows.
//! The declarations in a stage's head hold, and the runner follows them.

use rtec_tests::root;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

fn read(path: impl AsRef<Path>) -> String {
    std::fs::read_to_string(root().join(path.as_ref())).unwrap()
}

fn stages() -> BTreeSet<String> {
    let names = std::fs::read_dir(root().join(".ci/stages")).unwrap();
    names.map(|f| f.unwrap().file_name().into_string().unwrap()).collect()
}

/// The value of a key in the head of a stage.
fn head(stage: &str, key: &str) -> Option<String> {
    let (text, key) = (read(format!(".ci/stages/{stage}")), format!("# {key}: "));
    text.lines().take_while(|l| l.starts_with('#')).find_map(|l| l.strip_prefix(&key)).map(str::to_owned)
}

#[test]
fn every_stage_is_small_and_has_its_place() {
    assert!(read(".ci/run").lines().count() <= 150);
    let mut places = BTreeSet::new();
    for stage in stages() {
        let (text, when) = (read(format!(".ci/stages/{stage}")), head(&stage, "when"));
        assert!(text.lines().count() <= 60, "{stage}: {} lines", text.lines().count());
        let when = when.unwrap_or_else(|| panic!("{stage}: no line `# when: ` in its head"));
        let numbered = when.starts_with("beside ") || when.starts_with("meanwhile ");
        assert!(numbered || ["first", "test", "request"].contains(&&*when), "{stage}: # when: {when}");
        assert!(!numbered || places.insert(when.clone()), "{stage}: another stage has `{when}` too");
        for before in head(&stage, "after").unwrap_or_default().split_whitespace() {
            // A stage outside the whole run would be waited for endlessly.
            assert!(head(before, "when").is_some_and(|w| w != "request"), "{stage}: # after: {before}");
        }
    }
    let listed = Command::new("bash").arg(root().join(".ci/run")).arg("--list").output().unwrap();
    let listed: BTreeSet<_> = String::from_utf8(listed.stdout).unwrap().lines().map(str::to_owned).collect();
    assert_eq!(listed, stages(), "`.ci/run --list` names them all");
}

/// A folder with the runner and stages that a test defines.
fn planted(stages: &[(&str, &str, &str)]) -> (tempfile::TempDir, impl Fn(&[&str]) -> (i32, String)) {
    let folder = tempfile::tempdir().unwrap();
    let ci = folder.path().join(".ci");
    std::fs::create_dir_all(ci.join("stages")).unwrap();
    for file in ["run", "lib"] {
        std::fs::copy(root().join(".ci").join(file), ci.join(file)).unwrap();
    }
    for (name, head, body) in stages {
        let text =
            format!("#!/usr/bin/env bash\n{head}\n. \"$(dirname \"${{BASH_SOURCE[0]}}\")/../lib\"\n{body}\n");
        std::fs::write(ci.join("stages").join(name), text).unwrap();
    }
    let run = move |arguments: &[&str]| {
        let out = Command::new("bash").arg(ci.join("run")).args(arguments).output().unwrap();
        (out.status.code().unwrap(), String::from_utf8_lossy(&out.stdout).into_owned())
    };
    (folder, run)
}

/// The row of a stage in the table at the end.
fn row<'a>(said: &'a str, stage: &str) -> &'a str {
    let table = said.split_once("==== summary").unwrap().1;
    table.lines().find(|l| l.split_whitespace().next() == Some(stage)).unwrap_or_else(|| panic!("{said}"))
}

#[test]
fn runner_says_what_became_of_each_stage() {
    let (_folder, run) = planted(&[
        ("good", "# when: beside 1", "echo all well"),
        ("bad", "# when: beside 2", "false\necho never said"),
        ("absent", "# when: beside 3", "cannot no such machine"),
        ("spared", "# when: beside 4", "excused nothing to do"),
        ("partly", "# when: beside 5", "without the far half"),
    ]);
    let (code, said) = run(&["good", "spared", "partly"]);
    assert_eq!(code, 0, "{said}");
    assert!(row(&said, "good").ends_with("passed") && row(&said, "total").ends_with("passed"), "{said}");
    assert!(row(&said, "spared").ends_with("EXCUSED: nothing to do"), "{said}");
    assert!(row(&said, "partly").ends_with("passed, without the far half"), "{said}");
    for (stage, end) in [("bad", "FAILED (exit 1)"), ("absent", "NOT RUN: no such machine")] {
        let (code, said) = run(&["good", stage]);
        assert_eq!(code, 1, "{said}");
        assert!(row(&said, stage).ends_with(end) && row(&said, "total").ends_with("FAILED"), "{said}");
        assert!(!said.contains("never said"), "{said}");
    }
    assert_eq!(run(&["nowhere"]).0, 2);
}

#[test]
fn runner_keeps_the_order_that_stages_declare() {
    let (folder, run) = planted(&[
        ("prepare", "# when: first", "echo prepare >>order"),
        ("test", "# when: test", "sleep 0.2; echo test >>order"),
        ("aside", "# when: meanwhile 1", "echo aside >>order-aside"),
        ("needy", "# when: beside 1\n# after: slow", "echo needy >>order"),
        ("slow", "# when: beside 2", "sleep 0.5; echo slow >>order"),
        ("never", "# when: request", "echo never >>order"),
    ]);
    let (code, said) = run(&[]);
    assert_eq!(code, 0, "{said}");
    let order = std::fs::read_to_string(folder.path().join("order")).unwrap();
    assert_eq!(order, "prepare\ntest\nslow\nneedy\n");
    assert!(folder.path().join("order-aside").exists());
}

/// The commands of the workflows and the action.
/// Every value of a matrix is filled in.
fn workflow_steps() -> Vec<(PathBuf, String)> {
    let github = root().join(".github");
    let workflows = std::fs::read_dir(github.join("workflows")).unwrap().map(|f| f.unwrap().path());
    let mut steps = Vec::new();
    for file in workflows.chain([github.join("actions/prepare/action.yml")]) {
        let text = std::fs::read_to_string(&file).unwrap();
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        let matrix: Vec<&str> = match lines.iter().position(|l| l.starts_with("stages: [") || *l == "stages:")
        {
            Some(n) if lines[n].ends_with(']') => {
                lines[n].trim_start_matches("stages: [").trim_end_matches(']').split(", ").collect()
            }
            Some(_) => {
                lines.iter().filter_map(|l| l.strip_prefix("- ")).filter(|l| !l.contains(':')).collect()
            }
            None => Vec::new(),
        };
        for line in lines {
            let Some(command) = line.strip_prefix("- run: ").or_else(|| line.strip_prefix("run: ")) else {
                continue;
            };
            if command.contains("matrix.stages") {
                assert!(!matrix.is_empty(), "{}: no matrix for {command}", file.display());
                let each = matrix.iter().map(|s| command.replace("${{ matrix.stages }}", s));
                steps.extend(each.map(|c| (file.clone(), c)));
            } else {
                steps.push((file.clone(), command.to_owned()));
            }
        }
    }
    steps
}

#[test]
fn workflows_call_stages_that_exist_and_all_of_them() {
    let mut called = BTreeSet::new();
    for (file, command) in workflow_steps() {
        let parsed = Command::new("bash").args(["-n", "-c", &command]).output().unwrap();
        assert!(parsed.status.success(), "{}: {command}: {parsed:?}", file.display());
        if let Some(names) = command.strip_prefix("bash .ci/run ") {
            called.extend(names.split_whitespace().map(str::to_owned));
        }
    }
    let unknown: Vec<_> = called.difference(&stages()).cloned().collect();
    assert!(unknown.is_empty(), "workflows call {unknown:?}, which .ci/stages has not");
    let left: Vec<_> = stages().difference(&called).cloned().collect();
    assert_eq!(left, ["figures"], "judged by no workflow; figures judge nothing");
}

/// Checks that the steps are there in a fresh clone, without anything built.
///
/// The cheapest stage runs there, and the script of every step exists.
#[test]
fn steps_are_there_in_an_empty_clone() {
    if !test_needs::long() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let clone = folder.path().join("rtec");
    let cloned = Command::new("git").args(["clone", "-q"]).arg(root()).arg(&clone).output().unwrap();
    if !cloned.status.success() {
        return test_needs::skipped("no git repository around the sources");
    }
    for (file, command) in workflow_steps() {
        for stage in command.strip_prefix("bash .ci/run ").into_iter().flat_map(str::split_whitespace) {
            let there = clone.join(".ci/stages").join(stage).exists();
            assert!(there, "{}: {command}: .ci/stages/{stage} is not committed", file.display());
        }
    }
    let run = Command::new("bash").args([".ci/run", "fmt", "real"]).current_dir(&clone).output().unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success() && row(&said, "fmt").ends_with("passed"), "{said}");
    assert!(row(&said, "real").contains("EXCUSED: no measured data beside this clone"), "{said}");
}

/// The text between two others.
fn between<'t>(text: &'t str, before: &str, after: &str) -> Option<&'t str> {
    text.split_once(before)?.1.split_once(after).map(|(inside, _)| inside)
}

/// The workspace's version is the version of every file.
///
/// Files that cannot read it from there are compared with it.
#[test]
fn the_version_is_the_workspace_s_everywhere() {
    let workspace = read("Cargo.toml");
    let version = between(&workspace, "\nversion = \"", "\"").unwrap();
    for (file, before, after) in [
        ("tools/python/Cargo.toml", "\nversion = \"", "\""),
        ("CITATION.cff", "\nversion: ", "\n"),
        ("udev/changelog", "rtec (", "-1)"),
    ] {
        assert_eq!(between(&read(file), before, after), Some(version), "{file}: expected {version}");
    }
    let changelog = read("CHANGELOG.md");
    let heads = changelog.lines().filter_map(|line| line.strip_prefix("## "));
    let newest = heads.filter_map(|head| head.split_whitespace().next()).find(|v| *v != "Unreleased");
    assert_eq!(newest, Some(version), "the newest release in the changelog");
    let date = between(&changelog, &format!("\n## {version} ("), ")\n").expect("the release has a date");
    assert!(
        read("CITATION.cff").contains(&format!("\ndate-released: {date}\n")),
        "CITATION.cff: expected {date}"
    );
    let long = ["-u", "-d", date, "+%a, %d %b %Y"];
    let long = Command::new("date").args(long).env("LC_ALL", "C").output().unwrap().stdout;
    let long = String::from_utf8(long).unwrap();
    assert!(read("udev/changelog").contains(long.trim()), "udev/changelog: expected {long}");
    for member in std::fs::read_dir(root().join("tools")).unwrap() {
        let manifest = member.unwrap().path().join("Cargo.toml");
        let own = manifest.exists() && !manifest.ends_with("python/Cargo.toml");
        assert!(!own || read(&manifest).contains("\nversion.workspace = true\n"), "{}", manifest.display());
    }
}

/// The third-party crates that a program links.
fn linked(program: &str) -> BTreeSet<String> {
    let wanted =
        ["tree", "--locked", "--offline", "-e", "normal,no-proc-macro", "--prefix", "none", "-f", "{p}"];
    let tree = Command::new("cargo").args(wanted).args(["-p", program]).current_dir(root()).output().unwrap();
    assert!(tree.status.success(), "{}", String::from_utf8_lossy(&tree.stderr));
    let tree = String::from_utf8(tree.stdout).unwrap();
    let names = tree.lines().filter_map(|l| l.split_whitespace().next());
    names.filter(|name| !name.starts_with("rtec")).map(str::to_owned).collect()
}

#[test]
fn every_crate_has_its_reason_and_they_are_few() {
    let page = read("tools/guide/contributor/dependencies.md");
    let (shared, alone) = page.split_once("## In `rtecctl` alone").unwrap();
    let (rtecctl, rtecd) = (linked("rtecctl"), linked("rtecd"));
    assert!(rtecctl.len() <= 102, "{}: {rtecctl:?}", rtecctl.len());
    assert!(rtecd.len() <= 59, "{}: {rtecd:?}", rtecd.len());
    let unnamed = |crates: &BTreeSet<String>, text: &str| -> Vec<String> {
        crates.iter().filter(|c| !text.contains(&format!("`{c}`"))).cloned().collect()
    };
    assert_eq!(unnamed(&rtecd, shared), [""; 0], "in rtecd, without a reason in dependencies.md");
    assert_eq!(unnamed(&rtecctl, &page), [""; 0], "in rtecctl, without a reason in dependencies.md");
    let named = alone.split("## A new one").next().unwrap().split('`').skip(1).step_by(2);
    let in_both: Vec<_> = named.filter(|n| rtecd.contains(*n)).collect();
    assert_eq!(in_both, [""; 0], "named as rtecctl's alone, and rtecd has it");
}
